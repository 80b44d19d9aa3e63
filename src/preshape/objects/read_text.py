"""Fast and checked reading of numbers from large text files."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..exceptions import ObjectError
from ..types import LONGEST_NAME, BoolArray, IntArray, value

_NEWLINE, _HASH, _SLASH, _BLANK = 10, 35, 47, 32
_INDENT = (9, 11, 12, 32)
_CHUNK = 1 << 21
_LONGEST_LINE = 1 << 12


def printable(text: object, longest: int = 80) -> str:
    r"""Make text from a file fit for messages: one printable line of limited length.

    >>> printable("a\x1b[31m\nb")
    'a?[31m b'
    """
    words = " ".join(str(text).split())[:longest]
    return "".join(c if c.isprintable() else "?" for c in words)


def plain_text(name: str, data: bytes, kind: str) -> bytes:
    """The content of a text file without byte order mark and carriage returns.

    Args:
        name: Name of the file, for messages.
        data: Content of the file.
        kind: Expected kind of file, for messages ("an OBJ mesh").

    Raises:
        ObjectError: The content is binary.
    """
    if b"\0" in data:
        raise ObjectError(
            f"{name}: expected {kind} as text, found binary data; check that the file is complete "
            "and has the right suffix"
        )
    return data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def refuse_decimal_commas(name: str, data: bytes) -> None:
    """Refuse a text whose numbers have decimal commas, which would be read as separators or not at all.

    Three words or more between blanks or semicolons, one of which has a comma between digits, are such
    numbers; ``1,2,3`` and ``1, 2, 3`` are not. Only the beginning of the file is looked at.

    Raises:
        ObjectError: A line has decimal commas.
    """
    if b"\0" in data[:_BEGINNING]:
        return
    for line in data[:_BEGINNING].decode("ascii", "replace").splitlines():
        words = [word for word in _BETWEEN.split(line.strip()) if word not in ("v", "vertex")]
        if len(words) >= 3 and all(map(_NUMBER.fullmatch, words)) and any("," in word for word in words):
            raise ObjectError(
                f"{name}: the numbers have decimal commas, as in {line.strip()!r:.60}; write them with "
                "points, as 0.03"
            )


_BEGINNING = 1 << 16
_BETWEEN = re.compile(r"[\s;]+")
_NUMBER = re.compile(r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?(?<!,)")


@value
class NumberRows:
    """The numbers of some lines.

    Attributes:
        values: All numbers, one line after another.
        counts: (n,) number of values in each line.
        starts: (n,) index of the first value of each line in ``values``.
        lines: (n,) line numbers in the file, counted from 1, for messages.
    """

    values: NDArray[Any]
    counts: IntArray
    starts: IntArray
    lines: IntArray

    def columns(self, first: int, last: int) -> NDArray[Any]:
        """(n, last - first) values of these columns, which every line must have."""
        if len(self.counts) and (self.counts == self.counts[0]).all():
            grid: NDArray[Any] = self.values.reshape(len(self.counts), -1)[:, first:last]
            return grid
        place = self.starts[:, None] + np.arange(first, last)
        found: NDArray[Any] = self.values[place]
        return found


class Lines:
    """The lines of a text file, without leading blanks, byte order mark and carriage returns.

    Args:
        name: Name of the file, for messages.
        data: Content of the file.
        kind: Expected kind of file, for messages ("an OBJ mesh").

    Raises:
        ObjectError: The content is binary.
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
        """(lines,) whether ``word`` is the first word of each line."""
        last = len(self.bytes) - 1
        hit: BoolArray = self.bytes[np.minimum(self.starts + len(word), last)] <= _BLANK
        for k, letter in enumerate(word):
            hit &= self.bytes[np.minimum(self.starts + k, last)] == letter
        return hit

    def text(self, line: int | np.int64) -> str:
        """A line, counted from 0, for messages."""
        raw = self.bytes[self.starts[line] : self.starts[line] + min(int(self.lengths[line]), 60)]
        return raw.tobytes().decode("ascii", "replace").strip()

    def after(self, line: int | np.int64, word: bytes) -> str:
        """What stands in a line, counted from 0, after its first word; printable and of limited length."""
        start = int(self.starts[line])
        raw = self.bytes[start + len(word) : start + min(int(self.lengths[line]), _LONGEST_LINE)]
        return printable(raw.tobytes().decode("utf-8", "replace"), LONGEST_NAME)

    def rows(self, chosen: BoolArray, *, skip: int = 0, integers: bool = False) -> NumberRows:
        """Read the numbers of the chosen lines.

        Args:
            chosen: (lines,) whether to read each line.
            skip: Length of the first word, which is not a number.
            integers: Whether to read integers, and only the part before a slash (``1/2/3`` is 1).

        Raises:
            ObjectError: A word of these lines is not a number; the message quotes the line.
        """
        lines = np.flatnonzero(chosen)
        kind = np.int64 if integers else np.float64
        values: list[NDArray[Any]] = [np.zeros(0, dtype=kind)]
        counts: list[IntArray] = [np.zeros(0, dtype=np.int64)]
        # Parts of a few MB keep the work in the processor's cache and the masks small.
        share = np.cumsum(self.lengths[lines]) // _CHUNK
        for part in np.split(lines, np.flatnonzero(np.diff(share)) + 1):
            if len(part):
                self._part(part, skip, integers, values, counts)
        total = np.concatenate(counts)
        return NumberRows(
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
        """Read some lines and append their values and counts."""
        begin, end = int(self.starts[lines[0]]), int(self.starts[lines[-1]] + self.lengths[lines[-1]])
        text = self.bytes[begin:end].copy()
        if len(lines) < lines[-1] - lines[0] + 1:  # there are other lines between them
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
    """Overwrite comments, from # to the end of the line, with blanks in place."""
    found = text == _HASH
    if found.any():
        place = np.arange(1, len(text) + 1) * 2
        last = np.maximum.accumulate(np.where(found, place + 1, np.where(text == _NEWLINE, place, 0)))
        text[(last & 1).astype(bool)] = _BLANK


def _parse(text: NDArray[np.uint8], integers: bool) -> tuple[NDArray[Any], IntArray] | None:
    """A number from each word, and the start index of each word; ``None`` if a word is not a number."""
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
    leads = split[np.repeat(leading, np.diff(parts, append=len(text)))]
    numbers = _numbers(leads.tobytes(), kind, len(words))
    return None if numbers is None else (numbers, words)


def _starts(solid: BoolArray) -> IntArray:
    """Indices at which runs of true values begin."""
    first = solid.copy()
    first[1:] &= ~solid[:-1]
    return np.flatnonzero(first)


def _numbers(text: bytes, kind: type, count: int) -> NDArray[Any] | None:
    """Exactly ``count`` numbers; ``None`` if the text holds anything else."""
    if count == 0:
        return np.zeros(0, dtype=kind)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found: NDArray[Any] = np.fromstring(text, dtype=kind, sep=" ")
    except (ValueError, DeprecationWarning):
        return None
    return found if len(found) == count else None
