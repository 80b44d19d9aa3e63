"""What the long runs share: rows stored by an earlier run, and a line that shows the progress."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any


def stored_rows(file: Path) -> list[dict[str, Any]]:
    """Rows of a file of JSON lines; an incomplete last line, of an interrupted run, is removed."""
    if not file.is_file():
        return []
    text = file.read_text()
    complete = text[: text.rfind("\n") + 1]
    if complete != text:
        file.write_text(complete)
    return [row for row in map(json.loads, complete.splitlines()) if row]


def show_progress(line: str, *, last: bool = False) -> None:
    """Write a line to standard error; on a terminal it replaces the line before.

    Args:
        line: The text.
        last: Whether the line stays on the terminal.
    """
    live = sys.stderr.isatty()
    end = "" if live and not last else "\n"
    print(f"\r\x1b[K{line}" if live else line, end=end, file=sys.stderr, flush=True)
