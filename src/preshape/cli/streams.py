"""Standard streams that never end in a traceback: closed, full, or of a terminal with few characters."""

from __future__ import annotations

import codecs
import io
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import TextIO

_DESCRIPTORS = ((0, os.O_RDONLY), (1, os.O_RDONLY), (2, os.O_WRONLY))
_SIMPLE = {
    "×": "x",
    "·": "-",
    "–": "-",
    "—": "-",
    "°": " deg",
    "…": "...",
    "→": "->",
    "≤": "<=",
    "≥": ">=",
    "²": "2",
    "³": "3",
    "µ": "u",
    "✓": "+",
    "✕": "x",
    "✗": "x",
    "█": "#",
    "░": ".",
}  # fmt: skip
"""Characters of our own texts, and what a terminal without them shows."""


def prepare() -> None:
    """Make the standard streams of this process usable.

    A closed descriptor is opened again, because the next file, perhaps the memory, would take its place. What
    is written to a closed standard output fails as on a full disk; what is written to a standard error that
    is closed or full is lost, since nobody could be told.
    """
    for number, flags in _DESCRIPTORS:
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, flags)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
    prepare_encodings()
    if sys.stdin is None:
        sys.stdin = io.TextIOWrapper(io.BufferedReader(io.FileIO(0, closefd=False)), encoding="utf-8")
    # Whoever has replaced a stream, as a notebook or a test does, keeps it.
    if sys.stdout is sys.__stdout__:
        sys.stdout = _text(_Output(1, "w", closefd=False), sys.stdout)
    if sys.stderr is sys.__stderr__:
        sys.stderr = _text(_Lossy(2, "w", closefd=False), sys.stderr)


def prepare_encodings() -> None:
    """Register ``preshape``, the error handler of encodings that lack a character."""
    codecs.register_error("preshape", _simpler)


def _text(raw: io.FileIO, before: TextIO | None) -> TextIO:
    encoding = "utf-8" if before is None else before.encoding
    lines = raw.isatty() or raw.fileno() == 2
    return io.TextIOWrapper(io.BufferedWriter(raw), encoding, errors="preshape", line_buffering=lines)


def output_failed() -> bool:
    """Whether standard output could not be written; what it still holds is then discarded."""
    if _Output.failed:
        silence_output()
    return _Output.failed


def silence_output() -> None:
    """Discard what standard output still holds, after it has failed, so that Python's end does not fail."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


class _Output(io.FileIO):
    """Standard output, which remembers that it has failed."""

    failed = False

    def write(self, content: object, /) -> int:
        try:
            return super().write(content)  # type: ignore[arg-type]
        except OSError:
            _Output.failed = True
            raise


class _Lossy(io.FileIO):
    """A file whose write errors are ignored."""

    def write(self, content: object, /) -> int:
        try:
            return super().write(content)  # type: ignore[arg-type]
        except OSError:
            return memoryview(content).nbytes  # type: ignore[arg-type]


def _simpler(error: UnicodeError) -> tuple[str, int]:
    """Error handler of codecs: similar characters of ASCII, or escapes."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    return "".join(_SIMPLE.get(c) or c.encode("ascii", "backslashreplace").decode() for c in text), error.end
