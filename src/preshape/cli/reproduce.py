"""``preshape reproduce``: the paper's tables and figures."""

from __future__ import annotations

from pathlib import Path

import click

from .options import json_option


@click.command(epilog="Example: preshape reproduce --only fig14 --only fig16 --out out/reproduce")
@click.option(
    "--out", default="reports/reproduce", show_default=True, metavar="DIR", help="Where the report goes."
)
@click.option(
    "--only", multiple=True, metavar="NAME", help="Only this one (a wrong name lists all); repeatable."
)
@click.option("--quick", is_flag=True, help="A small form of each, for a first look.")
@click.option("--fresh", is_flag=True, help="Do again what an earlier run has finished.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of everything random.")
@json_option
def reproduce(out: str, only: tuple[str, ...], quick: bool, fresh: bool, seed: int, as_json: bool) -> None:
    """Reproduce table 4 and figures 11 to 18: report.md, report.html and a plot of each.

    It can be interrupted at any time; the same command goes on where it stopped.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from ..studies import run_all

    columns = (
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
    )
    console = Console(stderr=True)
    said = [-1]
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        step = bar.add_task("starting", total=1.0)

        def progress(fraction: float, label: str) -> None:
            bar.update(step, completed=fraction, description=label)
            if not console.is_terminal and int(20 * fraction) > said[0]:  # a log gets a line every 5 %
                said[0] = int(20 * fraction)
                click.echo(f"{100 * fraction:3.0f} % {label}", err=True)

        result = run_all(
            Path(out), only=only or None, seed=seed, quick=quick, resume=not fresh, progress=progress
        )
    files = [str(path) for path in (result.markdown, result.html)]
    if as_json:
        from .main import emit

        emit({"status": "answer", "files": files})
    else:
        for path in files:
            click.echo(f"wrote {path}")
