"""``preshape simulate``: test one planned grasp in simulated physics, with a table and pictures."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..exceptions import InputError
from .options import best_option, check_folder, json_option
from .printing import emit, name_files
from .progress import steps

if TYPE_CHECKING:
    from ..physics.grasps import GraspSet
    from ..physics.hold.recording import HoldRecording
    from ..physics.pick.recording import PickRecording
    from ..physics.protocol import HoldProtocol
    from ..viewer.film import Film


@click.command(epilog="Example: preshape simulate plan.json --out out/simulate")
@click.argument("file", metavar="PLAN")
@click.option(
    "--answer", type=int, metavar="N", help="Of a plan: 0 for the answer, 1 … for the alternatives."
)
@best_option
@click.option("--row", type=int, metavar="N", help="Of grasp arrays (npz): number of the grasp, from 0.")
@click.option("--hand", metavar="HAND", help="Name or TOML file; default: the hand of PLAN.")
@click.option("--objects", metavar="DIR", help="Folder of the objects that are neither files nor built in.")
@click.option(
    "--probes",
    metavar="six|all",
    help="Push the object in free space, also for a plan with a table. six: forces along the axes, the "
    "default without a table. all: 14 forces, 14 torques.",
)
@click.option("--friction", type=float, help="Friction coefficient; default: the plan's (arrays: 0.6).")
@click.option("--mass", type=float, help="Mass of the object [kg]; default: the plan's (arrays: 0.1).")
@click.option("--out", metavar="DIR", help="Also write filmstrip.png and run.gif to this folder.")
@json_option
def simulate(
    file: str,
    answer: int | None,
    best: bool,
    row: int | None,
    hand: str | None,
    objects: str | None,
    probes: str | None,
    friction: float | None,
    mass: float | None,
    out: str | None,
    as_json: bool,
) -> int:
    """Execute a grasp of PLAN in simulated physics.

    PLAN is a plan.json or an npz of grasp arrays (docs/grasp-file.md). For a plan with a table, the hand
    comes in, closes, squeezes, lifts and does the task (docs/pick-test.md). Otherwise it squeezes in free
    space, and a push comes from every side: the grasp holds if the object stays within 50 mm and 15°.

    Exit code 0: held, or done. 1: not. 2: bad input, such as a plan whose hand has no posture.
    """
    from ..export.scene_object import FoundObject, object_parts
    from ..hands.load import load_hand
    from ..physics.hand import physics_hand
    from ..physics.locate import object_pieces
    from ..physics.pick.recording import PickRecording
    from ..physics.protocol import HoldProtocol
    from ..planning.grasp_sets import read_grasp_file
    from ..planning.recorded import passed, recorded_run
    from .simulate_film import film_of_run

    check_folder(out)
    read = read_grasp_file(file, objects=objects, best=best)
    chosen = _chosen(read.grasps, file, answer, row)
    planned = read.planned_for[chosen]
    protocol = HoldProtocol(
        mass=planned.mass if mass is None else mass,
        friction=planned.friction if friction is None else friction,
        probes=probes or "six",
    )
    name = hand or read.grasps.hand
    if not name:
        raise InputError(f"{file} does not name the hand of its grasps; give --hand")
    model = load_hand(name)
    grasps = read.grasps.for_hand(physics_hand(model))
    thing, scale = grasps.objects[chosen], float(grasps.scale[chosen])
    pieces = object_pieces(thing, objects)
    written: list[Path] = []
    run = recorded_run(grasps, chosen, model, pieces, protocol, planned.job if probes is None else None)
    recording = run.recording
    if out is not None:
        mesh, _ = object_parts(FoundObject(name=thing, scale=scale, folder=objects))
        written = _draw(film_of_run(run, mesh), Path(out))
    left_out = _left_out(planned.obstacles, picked=isinstance(recording, PickRecording))
    if as_json:
        emit(
            {
                **_document(recording, written),
                "file": file,
                "hand": model.name,
                "object": thing,
                "mass": protocol.mass,
                "friction": protocol.friction,
                "warnings": [left_out] if left_out else [],
            }
        )
    else:
        _show(recording, protocol, f"{Path(thing).stem} in the hand {model.name}", left_out, written)
    return 0 if passed(recording) else 1


def _left_out(obstacles: str, *, picked: bool) -> str:
    """What of the plan's scene the test does not have, as a sentence; empty for nothing."""
    if picked:  # the table is there
        obstacles = obstacles.removeprefix("the table").removeprefix(" and ")
    if not obstacles:
        return ""
    many = " and " in obstacles or obstacles.endswith("boxes")
    return f"{obstacles} {'are' if many else 'is'} left out of this test"


def _chosen(grasps: GraspSet, file: str, answer: int | None, row: int | None) -> int:
    """Number of the grasp to simulate.

    Raises:
        InputError: The file has no grasp of that number, or it cannot be simulated.
    """
    if answer is not None and row is not None:
        raise InputError("give --answer for a plan or --row for grasp arrays, not both")
    number = answer if answer is not None else row if row is not None else 0
    noun = "row" if answer is None and (row is not None or not file.endswith(".json")) else "answer"
    if not 0 <= number < len(grasps):
        raise InputError(f"--{noun} must be 0 to {len(grasps) - 1} in {file}, got {number}")
    reasons = {fault.row: fault.reason for fault in grasps.faults}
    if number in reasons:
        fit = [k for k in range(len(grasps)) if k not in reasons]
        other = f"; --{noun} {fit[0]} can" if fit else ""
        raise InputError(f"{file}: {noun} {number} cannot be simulated: {reasons[number]}{other}")
    return number


def _draw(film: Film, folder: Path) -> list[Path]:
    from ..files import write_bytes, write_whole
    from ..viewer.animation import animation
    from ..viewer.filmstrip import filmstrip

    strip, run = folder / "filmstrip.png", folder / "run.gif"
    write_whole(strip, lambda path: filmstrip(film, path))
    with steps(f"{strip} is written") as shown:
        write_bytes(run, animation(film, progress=lambda done, of: shown.step("frames drawn", done, of)))
    return [strip, run]


def _document(recording: HoldRecording | PickRecording, written: list[Path]) -> dict[str, Any]:
    from ..physics.pick.protocol import PickResult
    from ..planning.recorded import passed, stage_rows

    result = recording.result
    words, picked = ("held", "not held"), dict[str, Any]()
    if isinstance(result, PickResult):
        words = ("done", "not done")
        picked = {"picked": result.picked, "job": result.job and asdict(result.job)}
    series = ("normal", "tangential", "slip", "torques", "gap", "object_pose")
    return {
        "status": words[0] if passed(recording) else words[1],
        "reason": recording.result.reason,
        "row": recording.result.row,
        "parts": list(recording.parts),
        "joints": list(recording.joints),
        **picked,
        "stages": stage_rows(recording),
        "series": {
            "stage": list(recording.stage),
            "time": recording.times.tolist(),
            **{name: getattr(recording, name).tolist() for name in series},
        },
        "files": [str(path) for path in written],
    }


def _show(
    recording: HoldRecording | PickRecording,
    protocol: HoldProtocol,
    title: str,
    left_out: str,
    written: list[Path],
) -> None:
    from rich.table import Table
    from rich.text import Text

    from ..planning.recorded import passed, stage_rows, verdict
    from ..report.terminal import terminal

    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column("stage", no_wrap=True)
    for heading in ("moved\nmm", "turned\n°", "force\nN", "slip\nmm"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("touching at the end")
    table.add_column("held?", no_wrap=True)
    for row in stage_rows(recording):
        held = row["held"]
        state = Text("") if held is None else Text("yes", "green") if held else Text("no", "bold red")
        table.add_row(
            row["stage"],
            f"{1e3 * row['displacement']:.1f}",
            f"{math.degrees(row['rotation']):.1f}",
            f"{row['largest_force']:.2f}",
            f"{1e3 * row['slip']:.2f}",
            " ".join(row["touching"]) or "nothing",
            state,
        )
    console = terminal()
    console.print(table, highlight=False)
    colour = "green" if passed(recording) else "red"
    console.print(Text(verdict(recording, protocol), style=f"bold {colour}"), highlight=False)
    console.print(f"simulated with {protocol.mass:g} kg and friction {protocol.friction:g}", highlight=False)
    if left_out:
        console.print(left_out, style="yellow", highlight=False)
    console.print(
        "force: the largest normal force of one part; slip: the farthest that one part slid on the object",
        style="dim",
        highlight=False,
    )
    name_files(written)
