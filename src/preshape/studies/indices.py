"""``preshape bench indices``: which index of a grasp predicts that it succeeds?

Grasps of mixed quality are drawn (:mod:`preshape.dataset.random_grasps`), every index is computed from
their planned contacts (:mod:`preshape.dataset.index_values`), and each grasp is put to the holding test and,
with a named task drawn at random from those that suit the object, to the task test. The parts are kept in a
folder as they come, so a run that was stopped goes on; the figures (:mod:`.index_figures`) are made from the
rows at the end.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from .._version import __version__
from ..dataset.index_values import GraspContacts, index_values, planner_score
from ..dataset.random_grasps import PRESS, draw_random_grasps, random_generator, random_grasp_settings
from ..exceptions import EnvironmentFailure, InputError
from ..hands.load import load_hand
from ..objects.load import load_object
from ..physics.grasps import STAGES
from ..physics.hand import PhysicsHand, physics_hand
from ..physics.hold.runner import run_holds
from ..physics.hold.six_directions import HoldStatus
from ..physics.pieces import ConvexPieces, load_pieces
from ..physics.protocol import HoldProtocol
from ..physics.task.grasps import GivenAnswers, HandPoses
from ..physics.task.instances import TaskInstance, make_instances
from ..physics.task.protocol import TaskProtocol, TaskStatus
from ..physics.task.runner import run_tasks
from ..planner import layout_of
from ..planning.document import write_json
from ..planning.grasp_sets import palm_grasps
from ..types import value

HANDS = ("shadow", "allegro", "leap")
OBJECTS = (
    "cube", "box", "prism", "pyramid", "cylinder", "cone", "sphere", "wedge", "domino", "bolt",
    "flashlight", "light_bulb",
)  # fmt: skip
"""Shapes that are quick to cut into few convex pieces."""
COUNT = 2000
FORMAT = "preshape indices 1"

Row = dict[str, Any]
Progress = Callable[[float, str], None]
"""Called with the fraction done, 0..1, and what is being done."""


@value
class IndexRun:
    """What is measured.

    Attributes:
        hands: names of hands of the package.
        objects: library names or mesh files.
        count: grasps, spread evenly over hands and objects.
        seed: of everything random.
        protocol: of the task test; its ``hold`` is the holding test's.
    """

    hands: tuple[str, ...] = HANDS
    objects: tuple[str, ...] = OBJECTS
    count: int = COUNT
    seed: int = 0
    # The first push that fails ends a holding test: the verdict is the same.
    protocol: TaskProtocol = TaskProtocol(hold=HoldProtocol(stop_early=True))

    def __post_init__(self) -> None:
        if not self.hands or not self.objects:
            raise InputError("indices need at least one hand and one object")
        if self.count < 1 or self.seed < 0:
            raise InputError(
                f"the count must be 1 or more and the seed 0 or more, got {self.count} and {self.seed}"
            )

    def shares(self) -> list[tuple[str, str, int]]:
        """(hand, object, grasps) of every cell; they sum to the count."""
        cells = [(hand, thing) for hand in self.hands for thing in self.objects]
        ends = np.linspace(0, self.count, len(cells) + 1).round().astype(int)
        return [(*cell, int(n)) for cell, n in zip(cells, np.diff(ends), strict=True) if n]


@value
class IndexRows:
    """Every grasp that was measured.

    Attributes:
        run: what was asked for.
        rows: plain JSON values, one a grasp: ``hand``, ``object``, ``scale``, ``task``, the three postures,
            ``indices`` (number and status of each), ``held`` and ``done`` (``None``: could not be tested),
            ``hold_status`` and ``task_status``.
        notes: one sentence on whatever is not as asked for.
    """

    run: IndexRun
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()


def run_indices(
    run: IndexRun,
    *,
    folder: Path | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> IndexRows:
    """Draw, compute and test.

    With more than one process the calling script needs the usual ``if __name__ == "__main__":``.

    Args:
        run: what to measure.
        folder: where the parts are kept as they come; the same call goes on from them. Default: nowhere.
        workers: processes of the tests; default one for each core. The indices are computed by one.
        progress: see there.

    Raises:
        InputError: an unknown hand or object, or parts of another run.
        EnvironmentFailure: a file cannot be read or written, or a process was killed.
    """
    notes: list[str] = []
    rows: list[Row] = []
    meter = _Meter(progress, run.count)
    hands = {name: physics_hand(load_hand(name)) for name in run.hands}
    with ExitStack() as stack:
        parts = folder or Path(stack.enter_context(TemporaryDirectory(prefix="preshape-indices-")))
        instances = {name: make_instances([name], seed=run.seed) for name in run.objects}
        pieces: dict[str, ConvexPieces] = {}
        for name in run.objects:
            meter.say(f"convex pieces of {name}")
            pieces[name] = load_pieces(name)
        for name, model in hands.items():
            mine: list[Row] = []
            cells = [cell for cell in run.shares() if cell[0] == name]
            for _, thing, count in cells:
                meter.say(f"indices of {name} on {thing}")
                mine += _made(run, name, thing, count, model, instances[thing], parts)
                meter.done += count
            wanted = sum(count for *_, count in cells)
            if len(mine) < wanted:
                notes.append(f"{name} gave only {len(mine)} grasps of the {wanted} asked for")
            rows += _tested(run, mine, model, instances, pieces, parts, workers, meter)
            meter.done += 2 * wanted
    return IndexRows(run=run, rows=tuple(rows), notes=tuple(notes))


class _Meter:
    """Progress over grasps made, held, and taken along their tasks: steps that take about as long."""

    def __init__(self, progress: Progress | None, count: int) -> None:
        self.done, self.total, self.progress = 0, 3 * count, progress

    def say(self, label: str, more: int = 0) -> None:
        if self.progress is not None:
            self.progress((self.done + more) / self.total, label)


def _made(
    run: IndexRun,
    hand: str,
    thing: str,
    count: int,
    model: PhysicsHand,
    instances: Sequence[TaskInstance],
    parts: Path,
) -> list[Row]:
    """The grasps of one hand on one object with their indices, or what an earlier run kept of them."""
    mesh = load_object(thing, scale=instances[0].scale)
    state = hashlib.sha256(f"{FORMAT} {__version__} {model.digest} {run.seed} {count}".encode())
    state.update(f"{run.protocol!r} {thing} {mesh.vertices.tobytes().hex()}".encode())
    key = state.hexdigest()
    file = parts / f"{hand}-{Path(thing).stem}.json"
    kept = _kept(file, key)
    if kept is not None:
        return kept
    rng = random_generator(run.seed, hand, thing)
    own = load_hand(hand)
    closure = random_grasp_settings()
    found = draw_random_grasps(own, mesh, count, rng, closure)
    chosen = [instances[k] for k in rng.integers(len(instances), size=len(found.grasps))]
    length, u = float(mesh.extents.max()) / 2, layout_of(own).u
    rows: list[Row] = []
    for made, instance in zip(found.grasps, chosen, strict=True):
        grasp = GraspContacts(
            points=made.points,
            normals_in=made.normals_in,
            centre=found.search.cog,
            cog=mesh.cog,
            length=length,
            u=u,
            plane=made.plane,
        )
        values = index_values(
            grasp,
            instance.task.q,
            instance.motion,
            mass=run.protocol.hold.mass,
            press=PRESS,
            settings=closure,
            score=partial(planner_score, found.search, grasp),
        )
        postures = {name: [*made.palm_pose.tolist(), *getattr(made, name).tolist()] for name in STAGES}
        place = {"hand": hand, "object": thing, "scale": instance.scale, "task": instance.task.label}
        touched = {"points": grasp.points.tolist(), "normals_in": grasp.normals_in.tolist()}
        rows.append({**place, **postures, **touched, "plane": grasp.plane, "indices": values})
    document = {"format": FORMAT, "key": key, "drawn": found.drawn, "closed": found.closed, "rows": rows}
    write_json(file, document)
    # Read back, so that a run that goes on sees the very same numbers and types.
    return _kept(file, key) or []


def _kept(file: Path, key: str) -> list[Row] | None:
    """Rows of an earlier run; ``None`` where there are none."""
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise EnvironmentFailure(f"cannot read {file}: {error.strerror}") from error
    try:
        document = json.loads(text)
        if document["key"] == key:
            rows: list[Row] = document["rows"]
            return rows
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{file} is not a part of such a run; remove it, or choose another folder"
        ) from error
    raise InputError(
        f"{file} belongs to a run of another count, seed, hand, object or version; choose another folder"
    )


def _tested(
    run: IndexRun,
    rows: list[Row],
    model: PhysicsHand,
    instances: dict[str, tuple[TaskInstance, ...]],
    pieces: dict[str, ConvexPieces],
    parts: Path,
    workers: int | None,
    meter: _Meter,
) -> list[Row]:
    """The rows of one hand with the verdicts of both tests."""
    if not rows:
        return []
    n, name = len(rows), model.name
    poses = {stage: np.array([row[stage] for row in rows]) for stage in STAGES}
    things, scale = [row["object"] for row in rows], [row["scale"] for row in rows]
    grasps = palm_grasps(model, things, scale, poses).for_hand(model)
    used = {thing: pieces[thing] for thing in dict.fromkeys(grasps.objects)}
    held = run_holds(
        grasps,
        model,
        protocol=run.protocol.hold,
        pieces=used,
        workers=workers,
        progress=lambda done, _: meter.say(f"holding tests of {name}", done),
        checkpoint=parts / f"{name}.holds.jsonl",
    )
    by_label = {thing: {i.task.label: i for i in instances[thing]} for thing in used}
    asked = [by_label[row["object"]][row["task"]] for row in rows]
    answers = GivenAnswers(rows=tuple(HandPoses.of(grasps, k) for k in range(n)))
    taken = run_tasks(
        asked,
        model,
        answers,
        protocol=run.protocol,
        pieces=used,
        workers=workers,
        progress=lambda done, _: meter.say(f"task tests of {name}", n + done),
        checkpoint=parts / f"{name}.tasks.jsonl",
    )
    out = []
    for row, hold, task in zip(rows, held.results, taken.results, strict=True):
        verdicts = {
            "held": None if hold.status is HoldStatus.INVALID else hold.held,
            "done": None if task.status in (TaskStatus.INVALID, TaskStatus.NO_ANSWER) else task.passed,
            "hold_status": hold.status.name.lower(),
            "task_status": task.status.name.lower(),
        }
        out.append({**row, **verdicts})
    return out
