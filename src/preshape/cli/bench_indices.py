"""``preshape bench indices``: how well each metric of a grasp predicts its success."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..report.terminal import print_table, report_console
from .options import check_folder, check_least, json_option, names_in, workers_option
from .printing import emit, name_files
from .progress import GOES_ON, steps

if TYPE_CHECKING:
    from ..studies.indices import IndexRows

PARTS = "parts"
"""Folder for the intermediate results, inside the folder of ``--out``."""


@click.command(
    epilog="Example: preshape bench indices --hand shadow --objects cube,cone --count 60 --out out/indices"
)
@click.option("--hand", default="ALL", metavar="HAND,…", help="ALL: shadow, allegro, leap.")
@click.option(
    "--objects",
    default="ALL",
    metavar="NAME,…",
    help="Built-in objects or mesh files; ALL: twelve that are quick to prepare.",
)
@click.option("--count", type=int, default=2000, metavar="N", help="Total number of grasps.")
@click.option("--seed", type=int, default=0, help="Seed of grasps and tasks.")
@workers_option
@click.option(
    "--checkpoint",
    metavar="DIR",
    help="Folder of results, from which the same command resumes; default: parts in --out.",
)
@click.option(
    "--out", metavar="DIR", help="Folder for report.json, .md and .html, grasps.json and the plots."
)
@json_option
def indices(
    hand: str,
    objects: str,
    count: int,
    seed: int,
    workers: int | None,
    checkpoint: str | None,
    out: str | None,
    as_json: bool,
) -> int:
    """Measure how well each metric of a grasp predicts success in simulated physics.

    The grasps are random closures of the hand, unranked and of mixed quality. Every metric is computed from
    their contacts. Each grasp then goes through the holding test and the task test of a random named task.
    The report has areas under the ROC curve with 95 % intervals, over all grasps and within objects, and
    success rates by tenths of each metric. 2000 grasps take about half an hour on two cores.

    Exit code 0: all were tested, held or not.
    """
    from ..studies.index_figures import index_figures
    from ..studies.index_report import write_index_report
    from ..studies.indices import HANDS, OBJECTS, IndexRun, run_indices

    check_folder(out)
    check_folder(checkpoint, "--checkpoint")
    check_least(1, count=count, workers=workers)
    check_least(0, seed=seed)
    run = IndexRun(
        hands=HANDS if hand.strip().upper() == "ALL" else names_in(hand, "--hand"),
        objects=OBJECTS if objects.strip().upper() == "ALL" else names_in(objects, "--objects"),
        count=count,
        seed=seed,
    )
    parts = Path(checkpoint) if checkpoint is not None else Path(out) / PARTS if out is not None else None
    with steps(GOES_ON if parts is not None else "with --out they would be kept") as shown:
        found = run_indices(
            run,
            folder=parts,
            workers=workers,
            progress=lambda share, label: shown.step("%", share, 1.0, label),
        )
    document = index_figures(found)
    written = write_index_report(document, found.rows, Path(out)) if out is not None else []
    if as_json:
        emit({**document, "files": [str(path) for path in written]})
    else:
        _show(found, document, written)
    return 0


def _show(found: IndexRows, document: dict[str, Any], written: list[Path]) -> None:
    from rich.text import Text

    from ..studies.index_report import findings, index_tables

    console = report_console(120)
    for content in index_tables(document):
        print_table(console, content)
    for sentence in findings(document):
        console.print(Text(sentence))
    for note in found.notes:
        console.print(Text(f"! {note}", style="yellow"))
    name_files(written)
