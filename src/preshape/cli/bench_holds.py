"""``preshape bench holds``: put grasps from files to the holding test."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from ..exceptions import EnvironmentFailure, InputError
from ..report.terminal import print_table, report_console
from .options import (
    best_option,
    check_folder,
    check_least,
    checkpoint_option,
    json_option,
    kept_results,
    ladder_option,
    probes_option,
    workers_option,
)
from .printing import emit, name_files
from .progress import GOES_ON, duration, steps

if TYPE_CHECKING:
    from ..physics.grasps import GraspSet
    from ..physics.hand import PhysicsHand
    from ..physics.hold.report import HoldReport
    from ..physics.protocol import HoldProtocol
    from ..planning.grasp_sets import GraspFile

MODELS = (".xml", ".mjcf")


class Group(NamedTuple):
    """Grasps of one hand that are tested under the same load.

    Attributes:
        title: Name of the hand, and the load if the hand is tested under several.
        model: The hand.
        grasps: The grasps.
        protocol: Settings of the test.
    """

    title: str
    model: PhysicsHand
    grasps: GraspSet
    protocol: HoldProtocol


@click.command(
    epilog="Example: preshape bench holds grasps.npz --objects objects --probes all --out out/holds"
)
@click.argument("files", metavar="GRASPS...", nargs=-1, required=True)
@best_option
@click.option("--hand", metavar="HAND", help="Name, TOML or MJCF file; default: the hand of GRASPS.")
@click.option("--root", metavar="BODY", help="With an MJCF: body whose poses the grasps give.")
@click.option("--fixed", multiple=True, metavar="JOINT", help="With an MJCF: joint to leave out; repeatable.")
@click.option(
    "--objects", metavar="DIR", help="Folder of the objects: NAME/convex/*.obj or a mesh of that name."
)
@click.option(
    "--friction", type=float, help="Friction coefficient; default: each plan's (arrays: 0.6). Harder: 0.3."
)
@click.option("--mass", type=float, help="Mass of every object [kg]; default: each plan's (arrays: 0.1).")
@probes_option
@ladder_option
@click.option(
    "--position-error",
    type=float,
    default=0.0,
    help="Error of the object's position [m]; harder: 0.005.",
)
@click.option(
    "--turn-error",
    type=float,
    default=0.0,
    help="Error of the object's orientation [degrees]; harder: 5.",
)
@click.option(
    "--size-error",
    type=float,
    default=0.0,
    help="Error of the object's size, as a share; harder: 0.05.",
)
@click.option("--seed", type=int, default=0, help="Seed of these errors.")
@workers_option
@checkpoint_option
@click.option("--out", metavar="DIR", help="Folder for report.json, .md and .html; resumable as well.")
@json_option
def holds(
    files: tuple[str, ...],
    best: bool,
    hand: str | None,
    root: str | None,
    fixed: tuple[str, ...],
    objects: str | None,
    friction: float | None,
    mass: float | None,
    probes: str,
    ladder: bool,
    position_error: float,
    turn_error: float,
    size_error: float,
    seed: int,
    workers: int | None,
    checkpoint: str | None,
    out: str | None,
    as_json: bool,
) -> int:
    """Put the grasps of GRASPS, plans or arrays (docs/grasp-file.md), to the holding test.

    The hand goes from pregrasp to grasp to squeeze, then the object is pushed; a grasp holds if the object
    stays within 50 mm and 15° under every push. The grasps of all files are counted together for each hand
    and each load that they were planned for.

    Exit code 0: all were tested, held or not. 2: some could not be tested; the others were, and are reported.
    """
    from ..physics.hold.runner import run_holds
    from ..physics.protocol import HoldProtocol
    from ..planning.grasp_sets import read_grasp_file
    from ..types import FIELD_MASS, FRICTION

    check_folder(out)
    check_least(1, workers=workers)
    protocol = HoldProtocol(
        mass=FIELD_MASS if mass is None else mass,
        friction=FRICTION if friction is None else friction,
        probes=probes,
        ladder=ladder,
        position_error=position_error,
        turn_error=math.radians(turn_error),
        size_error=size_error,
        seed=seed,
    )
    if objects is not None and not Path(objects).is_dir():
        raise EnvironmentFailure(f"no folder {objects}; --objects is the one that holds the objects")
    read = [(file, read_grasp_file(file, objects=objects, best=best)) for file in files]
    groups = _groups(read, protocol, mass, friction, hand, root, fixed)
    kept = _kept([group.title for group in groups], checkpoint, out)
    start, reports = time.perf_counter(), []
    total = sum(len(group.grasps) for group in groups)
    with steps(GOES_ON if checkpoint or out else "with --out or --checkpoint they would be kept") as shown:
        before = 0

        def progress(done: int, _: int) -> None:
            shown.step("grasps", before + done, total)

        for group, file in zip(groups, kept, strict=True):
            report = run_holds(
                group.grasps,
                group.model,
                protocol=group.protocol,
                objects=objects,
                workers=workers,
                progress=progress,
                checkpoint=file,
            )
            reports.append((group, report))
            before += len(group.grasps)
    seconds = time.perf_counter() - start
    document = _document(reports)
    written = _write(document, reports, out)
    if out is not None and checkpoint is None:  # the report now contains all results
        for file in kept:
            if file is not None:
                file.unlink(missing_ok=True)
    if as_json:
        emit({**document, "files": [str(path) for path in written]})
        return 2 if document["status"] == "error" else 0
    _show(reports, seconds, written)
    if document["status"] == "error":
        raise InputError(document["reason"])
    return 0


def _groups(
    files: list[tuple[str, GraspFile]],
    protocol: HoldProtocol,
    mass: float | None,
    friction: float | None,
    hand: str | None,
    root: str | None,
    fixed: tuple[str, ...],
) -> list[Group]:
    """The grasps of all files grouped by hand and load; groups are in the order of their first grasp.

    Args:
        files: Name and content of each file.
        protocol: Settings of the test; the mass and friction of the plans replace its own.
        mass: Mass of every object [kg]; ``None`` takes the plan's.
        friction: Friction coefficient; ``None`` takes the plan's.
        hand: Hand of all files; ``None`` takes the one that each file names.
        root: For a hand given as MJCF, the body whose poses the grasps give.
        fixed: For a hand given as MJCF, the joints to leave out.

    Raises:
        InputError: A file has no grasp, or does not name its hand.
    """
    from ..physics.grasps import joined

    by_hand: dict[str, list[tuple[str, GraspFile]]] = {}
    for name, file in files:
        if not len(file.grasps):
            raise InputError(f"{name}: no grasp in it")
        if not (hand or file.grasps.hand):
            raise InputError(f"{name} does not name the hand of its grasps; add --hand, see preshape hands")
        by_hand.setdefault(hand or file.grasps.hand, []).append((name, file))
    groups = []
    for hand_name, own in by_hand.items():
        model = _hand(hand_name, root, fixed)
        grasps = joined([(name, file.grasps) for name, file in own], model)
        loads = [
            (planned.mass if mass is None else mass, planned.friction if friction is None else friction)
            for _, file in own
            for planned in file.planned_for
        ]
        for load in dict.fromkeys(loads):
            with_load = f", {load[0]:g} kg, friction {load[1]:g}" if len(set(loads)) > 1 else ""
            rows = [row for row, other in enumerate(loads) if other == load]
            rules = replace(protocol, mass=load[0], friction=load[1])
            groups.append(Group(model.name + with_load, model, grasps.rows(rows), rules))
    return groups


def _hand(name: str, root: str | None, fixed: tuple[str, ...]) -> PhysicsHand:
    from ..hands.load import load_hand
    from ..physics.hand import hand_from_mjcf, physics_hand

    if Path(name).suffix.lower() in MODELS:
        if root is None:
            raise InputError(f"{name} is a model: add --root BODY, the body whose poses the grasps give")
        return hand_from_mjcf(name, root=root, fixed=fixed)
    if root is not None or fixed:
        raise InputError(f"--root and --fixed belong to a model (--hand FILE.xml), got the hand {name!r}")
    return physics_hand(load_hand(name))


def _kept(titles: list[str], checkpoint: str | None, out: str | None) -> list[Path | None]:
    """File for the intermediate results of each group."""
    base = kept_results(checkpoint, out)
    if base is None:
        return [None for _ in titles]
    if len(titles) == 1:
        return [base]
    plain = ["".join(c if c.isalnum() else "_" for c in title) for title in titles]
    return [base.with_name(f"{base.stem}-{name}{base.suffix}") for name in plain]


def _document(reports: list[tuple[Group, HoldReport]]) -> dict[str, Any]:
    """All results except the duration, so that the same input gives the same document."""
    import mujoco

    from .._version import __version__
    from ..physics.hold.tables import warnings

    lines = [line for _, report in reports for line in report.fault_lines()]
    total = sum(len(report.results) for _, report in reports)
    bad = sum(len(report.faults) for _, report in reports)
    reason = None
    if bad:
        reason = f"{bad} of {total} grasps could not be tested, the other {total - bad} were: " + "; ".join(
            lines
        )
    protocols = [asdict(group.protocol) for group, _ in reports]
    shared = {
        key: number if all(p[key] == number for p in protocols) else None
        for key, number in protocols[0].items()
    }
    return {
        "status": "error" if bad else "answer",
        "reason": reason,
        "version": __version__,
        "mujoco": mujoco.__version__,
        "protocol": shared,
        "hands": [
            {
                "hand": group.model.name,
                "mass": group.protocol.mass,
                "friction": group.protocol.friction,
                "warnings": list(warnings(report, group.protocol)),
                **report.to_json(),
            }
            for group, report in reports
        ],
    }


def _write(document: dict[str, Any], reports: list[tuple[Group, HoldReport]], out: str | None) -> list[Path]:
    if out is None:
        return []
    from ..physics.hold.tables import hold_report
    from ..report import write_report

    versions = f"MuJoCo {document['mujoco']}, preshape {document['version']}."
    chapters = [(group.title, group.protocol, report) for group, report in reports]
    return write_report(Path(out), hold_report(chapters, versions), document)


def _show(reports: list[tuple[Group, HoldReport]], seconds: float, written: list[Path]) -> None:
    from rich.text import Text

    from ..physics.hold.tables import ALL, settings_line, tables, warnings

    console = report_console(100)
    for group, report in reports:
        console.print(Text.assemble((f"{group.model.name}: ", "bold"), settings_line(group.protocol)))
        for content in tables(report):
            several = len(content.rows) > 1
            print_table(
                console,
                content,
                unbroken=content.columns[1:],
                bold=lambda row, several=several: several and row[0] == ALL,  # type: ignore[misc]
            )
        for sentence in warnings(report, group.protocol):
            console.print(Text(f"! {sentence}", style="yellow"))
    tested = sum(report.figures().tested for _, report in reports)
    console.print(f"{tested} grasps tested in {duration(seconds)}")
    name_files(written)
