"""A script at the head of the app's page that reduces the work of a browser that renders in software.

The page fixes the number of samples per pixel when it creates its canvas, before the server can send
anything. The script must therefore be part of the page.
"""

from __future__ import annotations

import gzip
from importlib import resources
from typing import Any

HEAD = b"<head>"


def with_script(response: Any) -> Any:
    """Insert the script at the head of a response of viser's web server, if the response is a page.

    Args:
        response: A ``websockets`` response, or ``None`` for a request that is not answered here.
    """
    if response is None or not response.headers.get("Content-Type", "").startswith("text/html"):
        return response
    packed = response.headers.get("Content-Encoding") == "gzip"
    page = gzip.decompress(response.body) if packed else response.body
    script = (resources.files("preshape.viewer") / "web" / "start.js").read_bytes()
    page = page.replace(HEAD, HEAD + b"<script>" + script + b"</script>", 1)
    response.body = gzip.compress(page, 6) if packed else page
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))
    return response
