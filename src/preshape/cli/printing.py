"""What several commands print: one JSON document, a list, and the files that were written."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

import click

from ..report.plain import escaped_line
from ..report.terminal import terminal
from . import interrupts


def say(*lines: object, err: bool = False, nl: bool = True) -> None:
    """Print lines with their control characters shown; a line stays one, whatever names it holds.

    Args:
        lines: The lines.
        err: Whether it goes to standard error.
        nl: Whether a new line follows.
    """
    click.echo("\n".join(map(escaped_line, lines)), err=err, nl=nl)


def emit(document: Any) -> None:
    """Print one JSON document; an interrupt waits until it is complete."""
    text = json.dumps(document, allow_nan=False, indent=2)
    with interrupts.output:
        click.echo(text)
        interrupts.answered()


def wait_at(name: str, address: str, host: str) -> NoReturn:
    """Say where a server is, and wait until a signal raises ``KeyboardInterrupt``.

    Args:
        name: The command.
        address: Where to reach it.
        host: The address that it listens on.
    """
    from ..app.gate import WILDCARDS

    say(f"{name} is at {address} (Ctrl-C ends it)", err=True)
    if host in WILDCARDS:
        say("other machines reach it under this machine's name, with the same token", err=True)
    while True:
        time.sleep(3600)


def name_files(written: Iterable[object]) -> None:
    """Name the files that were written, one on each line."""
    for path in written:
        say(f"wrote {path}")


def print_rows(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a list.

    Args:
        columns: Heading of each column. After ``>`` the column is aligned right, and after ``~`` its text may
            be wrapped, in a narrow terminal within words too, so that nothing of it is lost.
        rows: Text of each cell; names and paths are not read as markup.
    """
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, header_style="bold", pad_edge=False)
    for heading in columns:
        wrap = heading[0] == "~"
        table.add_column(
            heading.lstrip(">~"),
            justify="right" if heading[0] == ">" else "left",
            no_wrap=not wrap,
            overflow="fold" if wrap else "ellipsis",
        )
    for row in rows:
        table.add_row(*(Text(escaped_line(cell)) for cell in row))
    terminal().print(table)
