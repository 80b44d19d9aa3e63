"""Numbers out of text files, a million lines at a time and without trusting one of them."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..exceptions import ObjectError
from ..types import BoolArray, IntArray, value

_NEWLINE, _HASH, _SLASH, _BLANK = 10, 35, 47, 32
_INDENT = (9, 11, 12, 32)
_CHUNK = 1 << 21


def shown(text: object, longest: int = 80) -> str:
    r"""What a file says, fit for a message: one line, printable, not too long.

    >>> shown("a\x1b[31m\nb")
    'a?[31m b'
    """
    words = " ".join(str(text).split())[:longest]
    return "".join(c if c.isprintable() else "?" for c in words)


def plain_text(name: str, data: bytes, kind: str) -> bytes:
    """A text file without byte order mark and carriage returns.

    Args:
        name: the file, for messages.
        data: its content.
        kind: what it should be, for messages ("an OBJ mesh").

    Raises:
        ObjectError: the content is binary.
    """
    if b"\0" in data:
        raise ObjectError(
            f"{name}: expected {kind} as text, found binary data; check that the file is whole "
            "and that its suffix says what it is"
        )
    return data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")


@value
class Table:
    """The numbers of some lines.

    Attributes:
        values: all numbers, one line after another.
        counts: (n,) how many numbers each line has.
        starts: (n,) where the numbers of each line begin in ``values``.
        lines: (n,) line numbers in the file, from 1, for messages.
    """

    values: NDArray[Any]
    counts: IntArray
    starts: IntArray
    lines: IntArray

    def columns(self, first: int, last: int) -> NDArray[Any]:
        """(n, last - first) the numbers of these columns; every line must have them."""
        if len(self.counts) and (self.counts == self.counts[0]).all():
            grid: NDArray[Any] = self.values.reshape(len(self.counts), -1)[:, first:last]
            return grid
        place = self.starts[:, None] + np.arange(first, last)
        found: NDArray[Any] = self.values[place]
        return found


class Lines:
    """A text file cut into lines, without leading blanks, byte order mark or carriage returns.

    Args:
        name: the file, for messages.
        data: its content.
        kind: what it should be, for messages ("an OBJ mesh").

    Raises:
        ObjectError: the content is binary.
    """

    def __init__(self, name: str, data: bytes, kind: str) -> None:
        data = plain_text(name, data, kind)
        if not data.endswith(b"\n"):
            data += b"\n"
        self.name = name
        self._cut(data)
        if np.isin(self.bytes[self.starts], _INDENT).any():
            self._cut(re.sub(rb"(?m)^[ \t\f\v]+", b"", data))

    def _cut(self, data: bytes) -> None:
        self.bytes = np.frombuffer(data, dtype=np.uint8)
        parts = range(0, len(data), _CHUNK)
        ends = np.concatenate([np.flatnonzero(self.bytes[k : k + _CHUNK] == _NEWLINE) + k for k in parts])
        self.starts = np.concatenate([[0], ends[:-1] + 1])
        self.lengths = ends + 1 - self.starts

    def starting_with(self, word: bytes) -> BoolArray:
        """(lines,) which lines have ``word`` as their first word."""
        last = len(self.bytes) - 1
        hit: BoolArray = self.bytes[np.minimum(self.starts + len(word), last)] <= _BLANK
        for k, letter in enumerate(word):
            hit &= self.bytes[np.minimum(self.starts + k, last)] == letter
        return hit

    def text(self, line: int | np.int64) -> str:
        """One line, counted from 0, fit for a message."""
        raw = self.bytes[self.starts[line] : self.starts[line] + min(int(self.lengths[line]), 60)]
        return raw.tobytes().decode("ascii", "replace").strip()

    def table(self, chosen: BoolArray, *, skip: int = 0, integers: bool = False) -> Table:
        """Read the numbers on the chosen lines.

        Args:
            chosen: (lines,) which lines.
            skip: length of the first word, which is no number.
            integers: read integers, of which only what stands before a slash counts (``1/2/3`` is 1).

        Raises:
            ObjectError: something on one of the lines is not a number; the message quotes it.
        """
        lines = np.flatnonzero(chosen)
        kind = np.int64 if integers else np.float64
        values: list[NDArray[Any]] = [np.zeros(0, dtype=kind)]
        counts: list[IntArray] = [np.zeros(0, dtype=np.int64)]
        # A few MB at a time: the work stays in the cache and the masks stay small.
        share = np.cumsum(self.lengths[lines]) // _CHUNK
        for part in np.split(lines, np.flatnonzero(np.diff(share)) + 1):
            if len(part):
                self._part(part, skip, integers, values, counts)
        total = np.concatenate(counts)
        return Table(
            values=np.concatenate(values), counts=total, starts=np.cumsum(total) - total, lines=lines + 1
        )

    def _part(
        self,
        lines: IntArray,
        skip: int,
        integers: bool,
        values: list[NDArray[Any]],
        counts: list[IntArray],
    ) -> None:
        """Read some lines and append what they hold."""
        begin, end = int(self.starts[lines[0]]), int(self.starts[lines[-1]] + self.lengths[lines[-1]])
        text = self.bytes[begin:end].copy()
        if len(lines) < lines[-1] - lines[0] + 1:  # other lines stand between
            chosen = np.zeros(lines[-1] - lines[0] + 1, dtype=bool)
            chosen[lines - lines[0]] = True
            text = text[np.repeat(chosen, self.lengths[lines[0] : lines[-1] + 1])]
        lengths = self.lengths[lines]
        starts = np.cumsum(lengths) - lengths
        for k in range(skip):
            text[starts + k] = _BLANK
        _blank_comments(text)
        found = _parse(text, integers)
        if found is None:
            pieces = (text[start : start + length] for start, length in zip(starts, lengths, strict=True))
            bad = next((k for k, piece in enumerate(pieces) if _parse(piece, integers) is None), 0)
            raise ObjectError(
                f"{self.name}: line {lines[bad] + 1} should hold numbers, found {self.text(lines[bad])!r}; "
                "the file is damaged or not a mesh"
            )
        numbers, words = found
        values.append(numbers)
        counts.append(np.diff(np.searchsorted(words, starts), append=len(words)))


def _blank_comments(text: NDArray[np.uint8]) -> None:
    """Overwrite with blanks, in place, from each # to the end of its line."""
    found = text == _HASH
    if found.any():
        place = np.arange(1, len(text) + 1) * 2
        last = np.maximum.accumulate(np.where(found, place + 1, np.where(text == _NEWLINE, place, 0)))
        text[(last & 1).astype(bool)] = _BLANK


def _parse(text: NDArray[np.uint8], integers: bool) -> tuple[NDArray[Any], IntArray] | None:
    """One number from each word, and where the words begin; nothing if one of them is no number."""
    kind = np.int64 if integers else np.float64
    slash = text == _SLASH if integers else np.zeros(0, dtype=bool)
    words = _starts(text > _BLANK)
    if not slash.any():
        numbers = _numbers(text.tobytes(), kind, len(words))
        return None if numbers is None else (numbers, words)
    parts = _starts((text > _BLANK) & ~slash)
    leading = (parts == 0) | (text[parts - 1] <= _BLANK)
    if leading.sum() != len(words):
        return None
    split = np.where(slash, np.uint8(_BLANK), text)[parts[0] :]
    kept = split[np.repeat(leading, np.diff(parts, append=len(text)))]
    numbers = _numbers(kept.tobytes(), kind, len(words))
    return None if numbers is None else (numbers, words)


def _starts(solid: BoolArray) -> IntArray:
    """Where runs of ``solid`` begin."""
    first = solid.copy()
    first[1:] &= ~solid[:-1]
    return np.flatnonzero(first)


def _numbers(text: bytes, kind: type, count: int) -> NDArray[Any] | None:
    """Exactly ``count`` numbers, or nothing."""
    if count == 0:
        return np.zeros(0, dtype=kind)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found: NDArray[Any] = np.fromstring(text, dtype=kind, sep=" ")
    except (ValueError, DeprecationWarning):
        return None
    return found if len(found) == count else None
