"""``preshape bench holds``: grasps from files in the holding test."""

from __future__ import annotations

import math
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..exceptions import InputError
from ..report.terminal import print_table, report_console
from .options import check_folder, json_option
from .progress import GOES_ON, duration, steps

if TYPE_CHECKING:
    from ..physics.grasps import GraspSet
    from ..physics.hand import PhysicsHand
    from ..physics.hold.report import HoldReport
    from ..physics.protocol import HoldProtocol

MODELS = (".xml", ".mjcf")
KEPT = "unfinished.jsonl"  # the file of results in --out, while a run goes on


@click.command(
    epilog="Example: preshape bench holds grasps.npz --objects objects --probes all --out out/holds"
)
@click.argument("files", metavar="GRASPS...", nargs=-1, required=True)
@click.option("--hand", metavar="HAND", help="A name, a TOML or an MJCF file; default: what GRASPS say.")
@click.option("--root", metavar="BODY", help="With an MJCF: the body that hand poses are given for.")
@click.option(
    "--fixed", multiple=True, metavar="JOINT", help="With an MJCF: a joint to leave out; repeatable."
)
@click.option(
    "--objects", metavar="DIR", help="Folder of the objects: NAME/convex/*.obj or a mesh of that name."
)
@click.option("--friction", type=float, default=0.6, show_default=True, help="Sliding friction; harder: 0.3.")
@click.option("--mass", type=float, default=0.1, show_default=True, help="Of every object [kg].")
@click.option(
    "--probes", default="six", show_default=True, metavar="six|all", help="all: 14 forces and 14 torques."
)
@click.option(
    "--ladder", is_flag=True, help="Also the last strength held: the probes again, each rung × 1.4."
)
@click.option(
    "--position-error",
    type=float,
    default=0.0,
    show_default=True,
    help="Object off by this much [m]; harder: 0.005.",
)
@click.option(
    "--turn-error", type=float, default=0.0, show_default=True, help="… and turned by [degrees]; harder: 5."
)
@click.option(
    "--size-error",
    type=float,
    default=0.0,
    show_default=True,
    help="… and larger or smaller, a share; harder: 0.05.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Of these errors.")
@click.option("--workers", type=int, metavar="N", help="Processes; default: one for each core.")
@click.option("--checkpoint", metavar="FILE", help="Results as they come; the same command goes on from it.")
@click.option("--out", metavar="DIR", help="Write report.json, .md and .html there; resumable as well.")
@json_option
def holds(
    files: tuple[str, ...],
    hand: str | None,
    root: str | None,
    fixed: tuple[str, ...],
    objects: str | None,
    friction: float,
    mass: float,
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
    stays within 50 mm and 15° under every push. Files for one hand are counted together.

    Exit code 0: all were tested, held or not. 2: some could not be; the others were, and are reported.
    """
    from ..physics.hold.runner import run_holds
    from ..physics.protocol import HoldProtocol

    check_folder(out)
    if workers is not None and workers < 1:
        raise InputError(f"--workers must be 1 or more, got {workers}")
    protocol = HoldProtocol(
        mass=mass,
        friction=friction,
        probes=probes,
        ladder=ladder,
        position_error=position_error,
        turn_error=math.radians(turn_error),
        size_error=size_error,
        seed=seed,
    )
    sets = _read(files, hand, root, fixed, objects)
    kept = _kept([model.name for model, _ in sets], checkpoint, out)
    start, reports = time.perf_counter(), []
    total = sum(len(grasps) for _, grasps in sets)
    with steps(GOES_ON if checkpoint or out else "with --out or --checkpoint they would be kept") as told:
        before = 0

        def progress(done: int, _: int) -> None:
            told.step("grasps", before + done, total)

        for (model, grasps), file in zip(sets, kept, strict=True):
            report = run_holds(
                grasps,
                model,
                protocol=protocol,
                objects=objects,
                workers=workers,
                progress=progress,
                checkpoint=file,
            )
            reports.append((model.name, report))
            before += len(grasps)
    seconds = time.perf_counter() - start
    document = _document(reports, protocol)
    written = _write(document, reports, protocol, out)
    if out is not None and checkpoint is None:  # the report holds everything now
        for file in kept:
            if file is not None:
                file.unlink(missing_ok=True)
    if as_json:
        from .main import emit

        emit({**document, "files": [str(path) for path in written]})
        return 2 if document["status"] == "error" else 0
    _show(reports, protocol, seconds, written)
    if document["status"] == "error":
        raise InputError(document["reason"])
    return 0


def _read(
    files: tuple[str, ...], hand: str | None, root: str | None, fixed: tuple[str, ...], objects: str | None
) -> list[tuple[PhysicsHand, GraspSet]]:
    """The grasps of all files, put together by hand, in the order in which the hands first come."""
    from ..exceptions import EnvironmentFailure
    from ..physics.grasps import joined, read_grasps

    if objects is not None and not Path(objects).is_dir():
        raise EnvironmentFailure(f"no folder {objects}; --objects is the one that holds the objects")
    groups: dict[str, list[tuple[str, GraspSet]]] = {}
    for file in files:
        grasps = read_grasps(file, objects=objects)
        if not len(grasps):
            raise InputError(f"{file}: no grasp in it")
        if not (hand or grasps.hand):
            raise InputError(f"{file} does not say whose grasps they are; add --hand, see preshape hands")
        groups.setdefault(hand or grasps.hand, []).append((file, grasps))
    models = {name: _hand(name, root, fixed) for name in groups}
    return [(models[name], joined(group, models[name])) for name, group in groups.items()]


def _hand(name: str, root: str | None, fixed: tuple[str, ...]) -> PhysicsHand:
    from ..hands.load import load_hand
    from ..physics.hand import hand_from_mjcf, physics_hand

    if Path(name).suffix.lower() in MODELS:
        if root is None:
            raise InputError(
                f"{name} is a model: add --root BODY, the body that the hand poses are given for"
            )
        return hand_from_mjcf(name, root=root, fixed=fixed)
    if root is not None or fixed:
        raise InputError(f"--root and --fixed belong to a model (--hand FILE.xml), got the hand {name!r}")
    return physics_hand(load_hand(name))


def _kept(hands: list[str], checkpoint: str | None, out: str | None) -> list[Path | None]:
    """Where the results of each hand are kept while the run goes on."""
    if checkpoint is not None:
        base = Path(checkpoint)
    elif out is not None:
        base = Path(out) / KEPT
    else:
        return [None for _ in hands]
    if len(hands) == 1:
        return [base]
    plain = ["".join(c if c.isalnum() else "_" for c in hand) for hand in hands]
    return [base.with_name(f"{base.stem}-{name}{base.suffix}") for name in plain]


def _document(reports: list[tuple[str, HoldReport]], protocol: HoldProtocol) -> dict[str, Any]:
    """Everything but the time it took: the same input gives the same document."""
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
    return {
        "status": "error" if bad else "answer",
        "reason": reason,
        "version": __version__,
        "mujoco": mujoco.__version__,
        "protocol": asdict(protocol),
        "hands": [
            {"hand": name, "warnings": list(warnings(report, protocol)), **report.to_json()}
            for name, report in reports
        ],
    }


def _write(
    document: dict[str, Any], reports: list[tuple[str, HoldReport]], protocol: HoldProtocol, out: str | None
) -> list[Path]:
    if out is None:
        return []
    from ..files import write_json
    from ..physics.hold.tables import hold_report
    from ..report import write_report

    versions = f"MuJoCo {document['mujoco']}, preshape {document['version']}."
    write_json(Path(out) / "report.json", document)
    return [Path(out) / "report.json", *write_report(Path(out), hold_report(reports, protocol, versions))]


def _show(
    reports: list[tuple[str, HoldReport]], protocol: HoldProtocol, seconds: float, written: list[Path]
) -> None:
    from rich.text import Text

    from ..physics.hold.tables import ALL, settings_line, tables, warnings

    console = report_console(100)
    for hand, report in reports:
        console.print(Text.assemble((f"{hand}: ", "bold"), settings_line(protocol)))
        for content in tables(report):
            several = len(content.rows) > 1
            print_table(
                console,
                content,
                unbroken=content.columns[1:],
                bold=lambda row, several=several: several and row[0] == ALL,  # type: ignore[misc]
            )
        for sentence in warnings(report, protocol):
            console.print(Text(f"! {sentence}", style="yellow"))
    tested = sum(report.figures().tested for _, report in reports)
    console.print(f"{tested} grasps tested in {duration(seconds)}")
    for path in written:
        console.print(f"wrote {path}", markup=False, soft_wrap=True)
