"""What several commands print: one JSON document, a list, and the files that were written."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

import click


def emit(document: Any) -> None:
    """Print one JSON document."""
    click.echo(json.dumps(document, allow_nan=False, indent=2))


def name_files(written: Iterable[object]) -> None:
    """Name the files that were written, one on each line."""
    for path in written:
        click.echo(f"wrote {path}")


def print_rows(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a list.

    Args:
        columns: Heading of each column. After ``>`` the column is aligned right, and after ``~`` its text may
            be wrapped, in a narrow terminal within words too, so that nothing of it is lost.
        rows: Text of each cell; names and paths are not read as markup.
    """
    from rich.console import Console
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
        table.add_row(*map(Text, row))
    Console().print(table, highlight=False)
