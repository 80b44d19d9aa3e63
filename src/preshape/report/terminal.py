"""Tables on a terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from .values import Cell, Table, cell_text

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as Grid
    from rich.text import Text


def report_console(width: int) -> Console:
    """Console on standard output.

    Args:
        width: Width in characters if standard output is no terminal, so that logs look the same everywhere.
    """
    from rich.console import Console

    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = width
    return console


def print_table(
    console: Console,
    table: Table,
    *,
    left: bool = False,
    unbroken: Sequence[str] = (),
    bold: Callable[[tuple[Cell, ...]], bool] = lambda row: False,
) -> None:
    """Print a table.

    Args:
        console: Where to print.
        table: The table.
        left: Whether all columns are aligned left; otherwise only the first one is.
        unbroken: Headings of the columns whose text is not wrapped.
        bold: Returns whether a row is printed bold.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as Grid
    from rich.text import Text

    grid = Grid(
        title=Text(table.caption), title_justify="left", title_style="dim", box=SIMPLE_HEAD, pad_edge=False
    )
    for index, heading in enumerate(table.columns):
        justify = "left" if left or not index else "right"
        grid.add_column(heading, justify=justify, no_wrap=heading in unbroken)  # type: ignore[arg-type]
    for row in table.rows:
        grid.add_row(*(Text(cell_text(cell)) for cell in row), style="bold" if bold(row) else "")
    console.print(grid)


def fact_grid(*rows: tuple[str, str | Text]) -> Grid:
    """Names and values in two columns; a text is not read as markup."""
    from rich.table import Table as Grid
    from rich.text import Text

    grid = Grid.grid(padding=(0, 2))
    grid.add_column(style="bold", no_wrap=True)
    grid.add_column()
    for heading, content in rows:
        grid.add_row(heading, Text(content) if isinstance(content, str) else content)
    return grid
