"""Tables of reports on a terminal, the same in every bench."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rich.console import Console


class Content(Protocol):
    """What a report's table holds: a caption, headings, and rows of text."""

    @property
    def caption(self) -> str:
        """One line over the table."""

    @property
    def columns(self) -> Sequence[str]:
        """Headings."""

    @property
    def rows(self) -> Sequence[Sequence[str]]:
        """Cells, row by row."""


def report_console(width: int) -> Console:
    """Standard output; where that is no terminal, ``width`` characters wide: a log is read in any window."""
    from rich.console import Console

    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = width
    return console


def draw_table(
    console: Console,
    content: Content,
    *,
    left: bool = False,
    unbroken: Sequence[str] = (),
    bold: Callable[[Sequence[str]], bool] = lambda row: False,
) -> None:
    """Draw a report's table.

    Args:
        console: where.
        content: what.
        left: whether all columns stand on the left, not only the first.
        unbroken: headings of columns whose text stays on one line.
        bold: which rows stand out.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=Text(content.caption), title_justify="left", title_style="dim", box=SIMPLE_HEAD, pad_edge=False
    )
    for index, heading in enumerate(content.columns):
        justify = "left" if left or not index else "right"
        table.add_column(heading, justify=justify, no_wrap=heading in unbroken)  # type: ignore[arg-type]
    for row in content.rows:
        table.add_row(*map(Text, row), style="bold" if bold(row) else "")
    console.print(table)
