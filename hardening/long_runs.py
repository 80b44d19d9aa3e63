"""What long runs share: the rows that an earlier run has kept, and a line that says how far this one is."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any


def kept_rows(kept: Path) -> list[dict[str, Any]]:
    """The rows of a file of JSON lines; a line that was torn when the run was stopped is cut off."""
    if not kept.is_file():
        return []
    text = kept.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        kept.write_text(whole)
    return [row for row in map(json.loads, whole.splitlines()) if row]


def tell(line: str, *, last: bool = False) -> None:
    """Say how far a run is, on standard error: in a terminal over what was said before."""
    live = sys.stderr.isatty()
    end = "" if live and not last else "\n"
    print(f"\r\x1b[K{line}" if live else line, end=end, file=sys.stderr, flush=True)
