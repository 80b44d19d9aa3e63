"""``preshape bench clouds``: plan on partial views of objects, test the answers on the whole objects."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..report.terminal import print_table, report_console
from .options import (
    check_folder,
    check_least,
    json_option,
    names_in,
    pieces_option,
    scales_option,
    workers_option,
)
from .printing import emit, name_files
from .progress import GOES_ON, steps


@click.command(epilog="Example: preshape bench clouds box cylinder bottle --hand shadow --out out/clouds")
@click.argument("objects", metavar="OBJECTS...", nargs=-1, required=True)
@click.option("--hand", default="shadow", metavar="HAND,…", help="Names or TOML files.")
@click.option("--views", type=int, default=4, help="Number of views of each object.")
@click.option("--noise", type=float, default=1.0, metavar="MM", help="Noise of the depth [mm].")
@scales_option
@pieces_option
@click.option(
    "--methods",
    default="symmetry,straight,hull",
    metavar="NAME,…",
    help="Ways to complete the far side; the first is planned on.",
)
@click.option("--task", default="lift", metavar="TASK", help="Task to plan for.")
@click.option("--seed", type=int, default=0, help="Seed of views, noise and planner.")
@workers_option
@click.option("--out", metavar="DIR", help="Folder for report.json, .md and .html; resumable.")
@json_option
def clouds(
    objects: tuple[str, ...],
    hand: str,
    views: int,
    noise: float,
    scales: str,
    pieces: str | None,
    methods: str,
    task: str,
    seed: int,
    workers: int | None,
    out: str | None,
    as_json: bool,
) -> int:
    """Take depth images of OBJECTS, plan on their points, and test the answers on the true objects.

    The planner's answer on the whole mesh is tested for comparison. A view without an answer counts as lost.
    With --out the same command resumes a run that was stopped. Exit code 0: the study ran.
    """
    from ..studies.partial_report import cloud_figures, write_cloud_report
    from ..studies.partial_views import CloudRun, run_clouds
    from .bench_planner import cases_of

    check_least(1, workers=workers)
    check_folder(out)
    run = CloudRun(
        hands=names_in(hand, "--hand"),
        cases=tuple(cases_of(objects, scales, pieces)),
        views=views,
        noise=noise / 1000,
        seed=seed,
        task=task,
        methods=names_in(methods, "--methods"),
    )
    folder = None if out is None else Path(out)
    with steps(GOES_ON if folder is not None else "with --out they would be kept") as shown:
        rows = run_clouds(
            run,
            folder=folder,
            workers=workers,
            progress=lambda done, of, last: shown.step("objects", done, of, last),
        )
    document = cloud_figures(run, rows)
    written = [] if folder is None else write_cloud_report(document, folder)
    if as_json:
        emit({**document, "files": [str(path) for path in written]})
    else:
        _show(document, written)
    return 0


def _show(document: dict[str, Any], written: list[Path]) -> None:
    from rich.text import Text

    from ..studies.partial_report import cloud_tables

    console = report_console(140)
    for content in cloud_tables(document):
        print_table(console, content)
    for one in document["refused"]:
        console.print(
            Text(f"! {one['hand']}, {one['case']}, view {one['view']}: {one['reason']}", style="yellow")
        )
    name_files(written)
