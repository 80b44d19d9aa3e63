"""``preshape bench critic``: how probably grips of every margin are picked up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..files import temporary_folder
from ..report.terminal import print_table, report_console
from .bench_pick import things_of
from .bench_planner import OWN, cases_of
from .options import check_folder, check_least, json_option, names_in, workers_option
from .printing import emit, name_files
from .progress import GOES_ON, steps

PARTS = "parts"
"""Folder of the grips of each hand and object, inside the folder of ``--out``."""


@click.command(epilog="Example: preshape bench critic mug cone box --hand leap --out out/critic")
@click.argument("objects", metavar="OBJECTS...", nargs=-1, required=True)
@click.option("--hand", default="ALL", metavar="HAND,…", help="ALL: shadow, allegro, leap.")
@click.option(
    "--task", metavar="TASK", help="Task of all objects.  [default: an object's first, lift for files]"
)
@click.option("--mass", default=OWN, metavar="KG|own", help="Mass to plan for and test with [kg].")
@click.option("--masses", metavar="FILE.json", help="Masses by object name [kg]; they replace --mass.")
@click.option("--count", type=int, default=2, metavar="N", help="Grips of each kind of candidate.")
@click.option("--seed", type=int, default=0, help="Seed of the draws.")
@workers_option
@click.option(
    "--out",
    metavar="DIR",
    help="Folder for report.json, .md, .html, grips.json and the diagram; resumable as well.",
)
@json_option
def critic(
    objects: tuple[str, ...],
    hand: str,
    task: str | None,
    mass: str,
    masses: str | None,
    count: int,
    seed: int,
    workers: int | None,
    out: str | None,
    as_json: bool,
) -> int:
    """Measure how probably grips of every margin pick OBJECTS up, and fit the critic to it.

    OBJECTS are library names, files, or folders of files; ALL alone stands for the library. Grips of each
    hand are finished before any threshold, fingertips and wraps, and each goes through the pick test with the
    job. The report compares the predicted probabilities with what happened, on objects held out from the fit.
    One grip takes about a second; an object's convex pieces, cut once, up to two minutes.

    Exit code 0: all were tested, picked up or not.
    """
    from ..studies.critic_figures import critic_figures, critic_tables, findings, write_critic_report
    from ..studies.critic_study import HANDS, CriticRun, run_critic

    check_folder(out)
    check_least(1, count=count, workers=workers)
    check_least(0, seed=seed)
    run = CriticRun(
        things=things_of(cases_of(objects, "1", None), mass, masses, seed),
        hands=HANDS if hand.strip().upper() == "ALL" else names_in(hand, "--hand"),
        task=task,
        count=count,
        seed=seed,
    )
    with (
        temporary_folder("critic") as spare,
        steps(GOES_ON if out is not None else "with --out they would be kept") as shown,
    ):
        rows = run_critic(
            run,
            Path(out) / PARTS if out is not None else spare,
            workers=workers,
            progress=lambda share, label: shown.step("%", share, 1.0, label),
        )
    document: dict[str, Any] = critic_figures(rows)
    written = write_critic_report(document, rows, Path(out)) if out is not None else []
    if as_json:
        emit({**document, "files": [str(path) for path in written]})
        return 0
    console = report_console(120)
    for table in critic_tables(document):
        print_table(console, table)
    for sentence in findings(document):
        console.print(sentence, markup=False, highlight=False)
    name_files(written)
    return 0
