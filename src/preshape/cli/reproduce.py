"""``preshape reproduce``: reproduce the paper's tables and figures."""

from __future__ import annotations

from pathlib import Path

import click

from .options import json_option
from .printing import emit, name_files
from .progress import GOES_ON, steps


@click.command(epilog="Example: preshape reproduce --only fig14 --only fig16 --out out/reproduce")
@click.option("--out", default="reports/reproduce", metavar="DIR", help="Folder of the report.")
@click.option(
    "--only",
    multiple=True,
    metavar="NAME",
    help="Table or figure to reproduce; repeatable. A wrong name lists all.",
)
@click.option("--quick", is_flag=True, help="Small sample sizes, for a first look.")
@click.option("--fresh", is_flag=True, help="Repeat what an earlier run has finished.")
@click.option("--seed", type=int, default=0, help="Seed of every random draw.")
@json_option
def reproduce(out: str, only: tuple[str, ...], quick: bool, fresh: bool, seed: int, as_json: bool) -> None:
    """Reproduce table 4 and figures 11 to 18 as report.md, report.html and plots.

    The same command resumes a run that was interrupted.
    """
    from ..studies import run_all

    with steps(GOES_ON) as shown:
        result = run_all(
            Path(out),
            only=only or None,
            seed=seed,
            quick=quick,
            resume=not fresh,
            progress=lambda fraction, label: shown.step("%", fraction, 1.0, label),
        )
    files = [str(path) for path in (result.markdown, result.html)]
    if as_json:
        emit({"status": "answer", "files": files})
    else:
        name_files(files)
