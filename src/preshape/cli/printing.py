"""What several commands print: one JSON document, and the files that were written."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import click


def emit(document: Any) -> None:
    """Print one JSON document."""
    click.echo(json.dumps(document, allow_nan=False, indent=2))


def name_files(written: Iterable[object]) -> None:
    """Name the files that were written, one on each line."""
    for path in written:
        click.echo(f"wrote {path}")
