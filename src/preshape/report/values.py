"""The values that a report consists of.

Text may contain ``**strong**``, ``*emphasised*`` and `` `code` `` words, as in Markdown; the rest is plain.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from ..types import value

Cell: TypeAlias = str | int | float | None
"""Content of a table cell; text may have several lines."""


@value
class Table:
    """A table.

    Attributes:
        caption: One line above the table; empty for none.
        columns: Headings, which may have two lines.
        rows: Rows with one cell for each column, written by :func:`cell_text`.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@value
class Figure:
    """A picture with its caption.

    Attributes:
        file: Path of the PNG file, relative to the report.
        caption: What the picture shows, also for readers who cannot see it.
        draw: Function that writes the PNG file to a path.
    """

    file: str
    caption: str
    draw: Callable[[Path], None]


@value
class Heading:
    """A heading within a chapter."""

    text: str


@value
class Bullets:
    """A list of sentences."""

    items: tuple[str, ...]


Block: TypeAlias = str | Heading | Bullets | Table | Figure
"""A part of a chapter; a string is a paragraph."""


@value
class Chapter:
    """A part of a report under a heading.

    Attributes:
        title: Heading.
        blocks: Content of the chapter, in order.
        name: Anchor that the list of chapters links to; empty for none.
        headline: Outcome in one sentence for the list of chapters; empty leaves the chapter out of the list.
    """

    title: str
    blocks: tuple[Block, ...]
    name: str = ""
    headline: str = ""


@value
class Report:
    """A report.

    Attributes:
        title: Title of the page.
        preface: Blocks before the list of chapters.
        chapters: Chapters, in order.
    """

    title: str
    preface: tuple[Block, ...] = ()
    chapters: tuple[Chapter, ...] = ()

    @property
    def figures(self) -> tuple[Figure, ...]:
        """All figures of the report."""
        blocks = (*self.preface, *(block for chapter in self.chapters for block in chapter.blocks))
        return tuple(block for block in blocks if isinstance(block, Figure))


def cell_text(cell: Cell) -> str:
    """Text of a table cell: a float has two decimals, an empty cell is a dash.

    >>> cell_text(3), cell_text(3.14159), cell_text(None)
    ('3', '3.14', '–')
    """
    if cell is None or cell == "":
        return "–"
    return f"{cell:.2f}" if isinstance(cell, float) else str(cell)
