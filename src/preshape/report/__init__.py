"""Reports as plain values, and their output as Markdown, as HTML and on a terminal."""

from .page import write_report
from .values import Block, Bullets, Cell, Chapter, Figure, Heading, Report, Table, cell_text

__all__ = [
    "Block",
    "Bullets",
    "Cell",
    "Chapter",
    "Figure",
    "Heading",
    "Report",
    "Table",
    "cell_text",
    "write_report",
]
