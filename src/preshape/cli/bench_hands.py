"""``preshape bench hands``: the same plans on our models of hands and on the published ones."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from ..exceptions import EnvironmentFailure, InputError
from ..report.terminal import print_table, report_console
from ..types import FRICTION
from .bench_pick import things_of
from .bench_planner import OWN, cases_of
from .options import check_folder, check_least, json_option, workers_option
from .printing import emit, name_files
from .progress import steps

REFERENCE = "PRESHAPE_REFERENCE"
"""Environment variable with the folder of published models."""


@click.command(epilog="Example: preshape bench hands mug box bottle --models ../models --out out/hands")
@click.argument("objects", metavar="OBJECTS...", nargs=-1, required=True)
@click.option("--hands", default="shadow,allegro,leap", metavar="H,H", help="Built-in hands.")
@click.option(
    "--models",
    metavar="DIR",
    help=f"Folder with hands/NAME/right_hand.xml of MuJoCo Menagerie.  [default: {REFERENCE}]",
)
@click.option("--task", default="lift", metavar="TASK", help="Task to plan for.")
@click.option("--mass", default=OWN, metavar="KG|own", help="Mass to plan for and test with [kg].")
@click.option("--masses", metavar="FILE.json", help="Masses by object name [kg]; they replace --mass.")
@click.option("--friction", type=float, default=FRICTION, help="Friction of the tests; harder: 0.3.")
@click.option("--seed", type=int, default=0, help="Seed of the planner.")
@workers_option
@click.option("--out", metavar="DIR", help="Folder for report.json; resumable.")
@json_option
def hands(
    objects: tuple[str, ...],
    hands: str,
    models: str | None,
    task: str,
    mass: str,
    masses: str | None,
    friction: float,
    seed: int,
    workers: int | None,
    out: str | None,
    as_json: bool,
) -> int:
    """Plan OBJECTS (library names, files, or folders of files) and test the plans on both models of each
    hand.

    The tests are the six directions, in free space and with the gain of the field's test, and the pick test,
    on a table and with each model's own gains and torque limits, for which the squeeze is aimed again.

    Exit code 0: the tests ran.
    """
    from ..files import write_json
    from ..hands import menagerie
    from ..hands.load import load_hand
    from ..physics.hand import published_hand
    from ..physics.pick.protocol import PickProtocol
    from ..physics.protocol import HoldProtocol
    from ..planning.model_bench import compare_models

    check_folder(out)
    check_least(1, workers=workers)
    check_least(0, seed=seed)
    folder = _models(models)
    cases = cases_of(objects, "1", None)
    things = things_of(cases, mass, masses, seed)
    hold = HoldProtocol(friction=friction, stop_early=True)
    pick = PickProtocol(friction=friction, seed=seed)
    reports = []
    with steps("with --out the picks would be kept" if out is None else "the picks are kept") as shown:
        for name in [part.strip() for part in hands.split(",")]:
            hand = load_hand(name)
            file = folder / "hands" / menagerie.model_of(hand.name) / "right_hand.xml"
            if out is not None:
                Path(out).mkdir(parents=True, exist_ok=True)
            reports.append(
                compare_models(
                    cases,
                    things,
                    hand,
                    published_hand(hand, file),
                    task=task,
                    hold=hold,
                    pick=pick,
                    seed=seed,
                    workers=workers,
                    folder=None if out is None else Path(out),
                    progress=shown.step,
                )
            )
    document: dict[str, Any] = {
        "status": "answer",
        "task": task,
        "hold": asdict(hold),
        "pick": asdict(pick),
        "hands": [{**r.row(), "pairs": [pair.to_json() for pair in r.pairs]} for r in reports],
    }
    written = []
    if out is not None:
        written = [Path(out) / "report.json"]
        write_json(written[0], document)
    if as_json:
        emit({**document, "files": [str(path) for path in written]})
    else:
        _show(document)
        name_files(written)
    return 0


def _models(given: str | None) -> Path:
    """The folder of the published models.

    Raises:
        InputError: None was given.
        EnvironmentFailure: It is no folder.
    """
    named = given or os.environ.get(REFERENCE)
    if not named:
        raise InputError(
            f"name the folder of the published models with --models, or in {REFERENCE}; it holds "
            "hands/shadow_hand/right_hand.xml and the like, as in MuJoCo Menagerie"
        )
    folder = Path(named)
    if not (folder / "hands").is_dir():
        raise EnvironmentFailure(f"{folder} has no folder hands with the published models")
    return folder


def _show(document: dict[str, Any]) -> None:
    from ..report import Table

    console = report_console(100)
    rows = []
    for hand in document["hands"]:
        for test, words in (("six_directions", "six directions"), ("pick", "pick")):
            result = hand[test]
            rows.append(
                (
                    hand["hand"],
                    words,
                    f"{result['answered']} of {hand['objects']}",
                    str(result["ours"]),
                    str(result["published"]),
                )
            )
    columns = ("hand", "test", "answered", "our model", "published model")
    print_table(console, Table(caption="", columns=columns, rows=tuple(rows)))
    for hand in document["hands"]:
        for pair in hand["pairs"]:
            for text in pair["differences"]:
                console.print(f"  {hand['hand']}, {pair['object']}: {text}", highlight=False, markup=False)
