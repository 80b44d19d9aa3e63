"""``preshape bench tasks``: put a planner to the task test, the open benchmark."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..exceptions import InputError, shown
from ..report.terminal import print_table, report_console
from ..types import FIELD_MASS, FRICTION
from .options import (
    check_least,
    checkpoint_option,
    json_option,
    kept_results,
    names_in,
    numbers_in,
    workers_option,
)
from .printing import emit, name_files, say
from .progress import GOES_ON, steps

if TYPE_CHECKING:
    from ..physics.hand import PhysicsHand
    from ..physics.task.grasps import Answers
    from ..physics.task.instances import TaskInstance
    from ..physics.task.protocol import TaskProtocol
    from ..physics.task.report import TaskReport
    from ..types import Array

SHOWN = 20
"""Largest number of failures shown in the terminal; the report lists all."""


@click.command(
    epilog="Example: preshape bench tasks --objects cube,hammer --tasks lift,strike --out out/tasks"
)
@click.option("--hand", metavar="HAND", help="Name or TOML file; default: that of --grasps, else utah_mit.")
@click.option("--analyser", metavar="NAME", help="rays or closure; default: the hand's own.")
@click.option("--objects", default="ALL", metavar="NAME,…", help="Built-in objects or mesh files.")
@click.option("--tasks", default="ALL", metavar="FAMILY,…", help="See preshape tasks.")
@click.option("--count", type=int, metavar="N", help="Number of instances, drawn evenly over the tasks.")
@click.option("--seed", type=int, default=0, help="Seed of --count and of the planner.")
@click.option(
    "--gravity", metavar="X,Y,Z|none", help="Direction in the object's frame; default: each task's."
)
@click.option("--friction", type=float, default=FRICTION, help="Friction coefficient of the test.")
@click.option("--mass", type=float, default=FIELD_MASS, help="Mass to plan for and test with [kg].")
@click.option(
    "--grasps", metavar="FILE.npz", help="Score these answers instead of planning (docs/task-benchmark.md)."
)
@click.option(
    "--write-instances", metavar="FILE.json", help="Write the instances and their meshes; nothing is tested."
)
@workers_option
@checkpoint_option
@click.option(
    "--out", metavar="DIR", help="Folder for report.json, .md, .html and grasps.npz; resumable as well."
)
@json_option
def tasks(
    hand: str | None,
    analyser: str | None,
    objects: str,
    tasks: str,
    count: int | None,
    seed: int,
    gravity: str | None,
    friction: float,
    mass: float,
    grasps: str | None,
    write_instances: str | None,
    workers: int | None,
    checkpoint: str | None,
    out: str | None,
    as_json: bool,
) -> int:
    """Put a planner to the task test: grasp, then move the object as the task asks, against the task's load.

    An instance is one object with one task. It passes if the object ends within 50 mm and 15° of its target
    and was never farther than that from its path. An instance without an answer fails. The planner's first
    answer is tested, or with --grasps that of another planner. The first run cuts each object into convex
    pieces, which may take a minute or two for each.

    Exit code 0: every instance was tried, passed or not.
    """
    from ..physics.protocol import HoldProtocol
    from ..physics.task.instances import make_instances
    from ..physics.task.protocol import TaskProtocol
    from ..physics.task.runner import run_tasks

    for name, text in (("--out", out), ("--write-instances", write_instances), ("--checkpoint", checkpoint)):
        if text is not None and not text.strip():
            raise InputError(f"{name} needs a name, got an empty one")
    check_least(1, workers=workers, count=count)
    check_least(0, seed=seed)
    if grasps is not None and analyser is not None:
        raise InputError("--grasps brings its own answers; leave out --analyser")
    protocol = TaskProtocol(hold=HoldProtocol(mass=mass, friction=friction))
    instances = make_instances(
        _names(objects, "--objects"),
        _names(tasks, "--tasks"),
        seed=seed,
        count=count,
        gravity=_direction(gravity),
    )
    if write_instances is not None:
        return _write_instances(Path(write_instances), instances, protocol, as_json)
    model, answers, who, notes = _answers(instances, hand, analyser, grasps, mass)
    kept = kept_results(checkpoint, out)
    with steps(GOES_ON if kept else "with --out or --checkpoint they would be kept") as shown:
        report = run_tasks(
            instances,
            model,
            answers,
            protocol=protocol,
            workers=workers,
            progress=lambda done, of: shown.step("instances", done, of),
            preparing=lambda name: shown.prepare(f"convex pieces of {name}"),
            checkpoint=kept,
        )
    document = _document(report, protocol, who, notes)
    written = _write(report, protocol, who, document, out)
    if out is not None and checkpoint is None and kept is not None:  # the report now contains all results
        kept.unlink(missing_ok=True)
    if as_json:
        emit({**document, "files": [str(path) for path in written]})
    else:
        _show(report, protocol, who, notes, written)
    return 0


def _names(text: str, option: str) -> list[str] | None:
    """The names in a comma-separated list; ``None`` for ``ALL``."""
    return None if text.strip().upper() == "ALL" else list(names_in(text, option))


def _direction(text: str | None) -> Array | None:
    """(3,) Unit direction of gravity, zeros for ``none``; ``None`` if the option is not given."""
    import numpy as np

    if text is None:
        return None
    if text.strip().lower() == "none":
        return np.zeros(3)
    found = np.array(numbers_in(text))
    if found.shape != (3,) or not np.isfinite(found).all() or not found.any():
        raise InputError(f"--gravity is a direction X,Y,Z such as 0,0,-1, or none, got {shown(text)}")
    return found / np.linalg.norm(found)


def _answers(
    instances: tuple[TaskInstance, ...],
    hand: str | None,
    analyser: str | None,
    grasps: str | None,
    mass: float,
) -> tuple[PhysicsHand, Answers, str, list[str]]:
    """The hand in physics, the source of the answers and its description, and notes for the report."""
    from ..hands.load import load_hand
    from ..physics.hand import physics_hand
    from ..physics.task.grasps import given_answers, read_task_grasps
    from ..planning.planned_answers import PlannedAnswers
    from ..planning.request import RAY_HAND, analyser_of

    if grasps is None:
        own = load_hand(hand or RAY_HAND)
        model, used = physics_hand(own), analyser_of(analyser, own)
        planner = PlannedAnswers(hand=own, analyser=used, model=model, mass=mass)
        return model, planner, f"{own.name}, {used}", []
    found, labels = read_task_grasps(grasps)
    if not (hand or found.hand):
        raise InputError(f"{grasps} does not name the hand of its grasps; add --hand, see preshape hands")
    model = physics_hand(load_hand(hand or found.hand))
    given = given_answers(instances, found, labels, model)
    notes = []
    if given.unused:
        notes.append(
            f"{given.unused} of {len(found)} grasps of {grasps} were not used: they answer no instance of "
            "this run, or one that has an answer, or cannot be tested"
        )
    return model, given, f"{model.name}, {grasps}", notes


def _document(report: TaskReport, protocol: TaskProtocol, who: str, notes: list[str]) -> dict[str, Any]:
    """All results except the duration, so that the same input gives the same document."""
    import mujoco

    from .._version import __version__

    return {
        "status": "answer",
        "version": __version__,
        "mujoco": mujoco.__version__,
        "planner": who,
        "notes": notes,
        "protocol": protocol.to_json(),
        **report.to_json(),
    }


def _write(
    report: TaskReport, protocol: TaskProtocol, who: str, document: dict[str, Any], out: str | None
) -> list[Path]:
    if out is None:
        return []
    from ..physics.task.grasps import write_task_grasps
    from ..physics.task.tables import task_report
    from ..report import write_report

    folder = Path(out)
    versions = f"MuJoCo {document['mujoco']}, preshape {document['version']}."
    written = write_report(folder, task_report(report, protocol, who, versions), document)
    grasps, labels = report.planned_grasps()
    if len(grasps):
        written.append(folder / "grasps.npz")
        write_task_grasps(written[-1], grasps, labels)
    return written


def _write_instances(
    file: Path, instances: tuple[TaskInstance, ...], protocol: TaskProtocol, as_json: bool
) -> int:
    """Write the list of instances and, in a folder beside it, the mesh of each object at its scale."""
    from ..files import write_json, write_text
    from ..objects.load import load_object
    from ..physics.task.instances import instance_to_json, mesh_text
    from ..physics.task.tables import object_file

    folder = file.with_name(f"{file.stem}_meshes")
    meshes: dict[str, str] = {}
    for instance in instances:
        if instance.object_name not in meshes:
            path = folder / object_file(instance)
            if path.name in {Path(other).name for other in meshes.values()}:
                raise InputError(f"two objects are called {path.stem}; give files of different names")
            text = mesh_text(load_object(instance.object_name, scale=instance.scale))
            write_text(path, text)
            meshes[instance.object_name] = f"{folder.name}/{path.name}"
    mass = protocol.hold.mass
    rows = [
        {"row": row, **instance_to_json(instance, mass), "mesh": meshes[instance.object_name]}
        for row, instance in enumerate(instances)
    ]
    document = {"format": "preshape task instances 1", "protocol": protocol.to_json(), "instances": rows}
    write_json(file, document)
    if as_json:
        emit({"status": "answer", "instances": len(rows), "files": [str(file), str(folder)]})
    else:
        say(f"wrote {file}: {len(rows)} instances, {len(meshes)} meshes in {folder}")
    return 0


def _show(
    report: TaskReport, protocol: TaskProtocol, who: str, notes: list[str], written: list[Path]
) -> None:
    from rich.text import Text

    from ..physics.hold.tables import ALL
    from ..physics.task.tables import failure_table, rate_line, task_settings_line, task_tables

    console = report_console(100)
    failures = report.failures()
    console.print(Text(task_settings_line(protocol, who), style="bold"))
    for content in (*task_tables(report), failure_table(failures[:SHOWN])):
        if not content.rows:
            continue
        words = [heading for heading in content.columns if heading != "reason"]
        print_table(
            console,
            content,
            left=content.columns[-1] == "reason",
            unbroken=words,
            bold=lambda row: row[0] == ALL,
        )
    if len(failures) > SHOWN:
        where = str(written[1]) if written else "the report of --out, or --json"
        console.print(Text(f"{len(failures) - SHOWN} more failures; all are in {where}"))
    for note in notes:
        console.print(Text(f"! {note}", style="yellow"))
    console.print(Text(f"{rate_line(report.score())}, in {report.seconds:.0f} s"))
    name_files(written)
