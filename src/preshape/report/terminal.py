"""Tables on a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import IO, TYPE_CHECKING

from .plain import escaped, escaped_line
from .values import Cell, Table, cell_text

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions
    from rich.table import Table as Grid
    from rich.text import Text


def terminal(*, stderr: bool = False, file: IO[str] | None = None, width: int | None = None) -> Console:
    """Console that shows the control characters of texts instead of sending them to the terminal.

    Args:
        stderr: Whether it writes to standard error.
        file: Where it writes instead.
        width: Width in characters; by default the terminal's.
    """
    from rich.console import Console, ConsoleRenderable, RenderHook
    from rich.segment import Segment

    class Escaping(RenderHook):
        def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
            return [Shown(each) for each in renderables]

    class Shown:
        def __init__(self, renderable: ConsoleRenderable) -> None:
            self._renderable = renderable

        def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
            for part in console.render(self._renderable, options):
                yield part if part.control else Segment(escaped(part.text), part.style)

    console = Console(stderr=stderr, file=file, width=width, highlight=False)
    console.push_render_hook(Escaping())
    return console


def report_console(width: int) -> Console:
    """Console on standard output.

    Args:
        width: Width in characters if standard output is no terminal, so that logs look the same everywhere.
    """
    console = terminal()
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
        grid.add_row(
            escaped_line(heading), Text(escaped_line(content)) if isinstance(content, str) else content
        )
    return grid
