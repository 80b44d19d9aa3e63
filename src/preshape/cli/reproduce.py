"""``preshape reproduce``: reproduce the paper's tables and figures."""

from __future__ import annotations

from pathlib import Path

import click

from .options import json_option


@click.command(epilog="Example: preshape reproduce --only fig14 --only fig16 --out out/reproduce")
@click.option(
    "--out", default="reports/reproduce", show_default=True, metavar="DIR", help="Folder of the report."
)
@click.option(
    "--only",
    multiple=True,
    metavar="NAME",
    help="Table or figure to reproduce; repeatable. A wrong name lists all.",
)
@click.option("--quick", is_flag=True, help="Small sample sizes, for a first look.")
@click.option("--fresh", is_flag=True, help="Repeat what an earlier run has finished.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of every random draw.")
@json_option
def reproduce(out: str, only: tuple[str, ...], quick: bool, fresh: bool, seed: int, as_json: bool) -> None:
    """Reproduce table 4 and figures 11 to 18 as report.md, report.html and plots.

    The same command resumes a run that was interrupted.
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
    twentieths = -1
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        step = bar.add_task("starting", total=1.0)

        def progress(fraction: float, label: str) -> None:
            nonlocal twentieths
            bar.update(step, completed=fraction, description=label)
            if not console.is_terminal and int(20 * fraction) > twentieths:  # a line in a log for every 5 %
                twentieths = int(20 * fraction)
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
