"""What the app's page does before the viewer's own script: it spares a browser that draws in software.

How many samples a pixel gets is decided when the page makes its canvas, before the server is first heard; so
this stands in the page itself.
"""

from __future__ import annotations

import gzip
from importlib import resources
from typing import Any

HEAD = b"<head>"


def with_script(response: Any) -> Any:
    """A response of the viewer's web server; where it is a page, with the script at its head.

    Args:
        response: a ``websockets`` response, or ``None`` for a request that it does not answer.
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
