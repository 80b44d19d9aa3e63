"""``preshape bench learning``: how much a real hand gains from its memory."""

from __future__ import annotations

from pathlib import Path

import click

from ..report.terminal import print_table, report_console
from .options import check_folder, check_least, json_option
from .printing import emit, name_files
from .progress import steps


@click.command(epilog="Example: preshape bench learning --hand shadow --length 100 --out out/learning")
@click.option("--hand", default="shadow", metavar="HAND", help="Name or TOML file.")
@click.option(
    "--length",
    type=int,
    default=100,
    metavar="N",
    help="Number of pairs of object and task to learn.",
)
@click.option("--held-out", type=int, default=20, metavar="N", help="Number of pairs that are never learnt.")
@click.option("--seed", type=int, default=0, help="Seed of the pairs and of the planner.")
@click.option("--out", metavar="DIR", help="Folder for report.json and the plot.")
@json_option
def learning(hand: str, length: int, held_out: int, seed: int, out: str | None, as_json: bool) -> int:
    """Learn pairs of library objects and tasks one after the other, then ask for them again.

    The report has the share of pairs that mode 0 answers during learning, the learnt pairs that were lost,
    and the number of candidates that new objects need for the margin of a full search.

    Exit code 0: the study ran.
    """
    from ..studies.closure_learning import study, table, write_learning_report

    check_least(1, length=length, held_out=held_out)
    check_least(0, seed=seed)
    check_folder(out)
    with steps("this bench keeps nothing before its end") as shown:
        found = study(
            hand=hand,
            length=length,
            held_out=held_out,
            seed=seed,
            progress=lambda done, of: shown.step("questions", done, of),
        )
    written = [] if out is None else write_learning_report(found, Path(out))
    if as_json:
        emit({"status": "answer", **found.figures(), "files": [str(path) for path in written]})
        return 0
    console = report_console(100)
    print_table(console, table(found))
    name_files(written)
    return 0
