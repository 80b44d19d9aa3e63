"""``preshape bench indices``: which index of a grasp predicts its success?

The study has these steps:

1. Draw random grasps of mixed quality (:mod:`preshape.dataset.random_grasps`).
2. Compute every index from the planned contacts (:mod:`preshape.dataset.index_values`).
3. Put each grasp to the holding test, and to the task test of a random named task that suits the object.
4. Compute the figures from the rows (:mod:`.index_figures`).

The results of steps 1 to 3 are stored at once, so an interrupted run can be resumed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from .._version import __version__
from ..dataset.index_values import IndexInput, index_values, planner_score
from ..dataset.outcomes import Row
from ..dataset.random_grasps import PRESS, draw_random_grasps, random_generator, random_grasp_settings
from ..exceptions import EnvironmentFailure, InputError
from ..files import loads, write_json
from ..hands.load import load_hand
from ..objects.load import load_object
from ..physics.grasps import STAGES
from ..physics.hand import PhysicsHand, physics_hand
from ..physics.hold.runner import run_holds
from ..physics.hold.six_directions import HoldStatus
from ..physics.pieces import ConvexPieces, load_pieces
from ..physics.protocol import HoldProtocol
from ..physics.task.grasps import GivenAnswers
from ..physics.task.instances import TaskInstance, make_instances
from ..physics.task.protocol import TaskProtocol, TaskStatus
from ..physics.task.runner import run_tasks
from ..planning.grasp_sets import palm_grasps
from ..types import LENGTH_UNIT, value
from .experiment import Progress

HANDS = ("shadow", "allegro", "leap")
OBJECTS = (
    "cube", "box", "prism", "pyramid", "cylinder", "cone", "sphere", "wedge", "domino", "bolt",
    "flashlight", "light_bulb",
)  # fmt: skip
"""Library objects that can be cut quickly into few convex pieces."""
COUNT = 2000
FORMAT = "preshape indices 2"


@value
class IndexRun:
    """Settings of the study.

    Attributes:
        hands: Names of built-in hands.
        objects: Library names or mesh files.
        count: Total number of grasps, divided evenly among the pairs of hand and object.
        seed: Seed of every random draw; the same seed gives the same result.
        protocol: Settings of the task test; its ``hold`` has the settings of the holding test.
    """

    hands: tuple[str, ...] = HANDS
    objects: tuple[str, ...] = OBJECTS
    count: int = COUNT
    seed: int = 0
    # A holding test ends at the first push that is not held, which does not change the outcome.
    protocol: TaskProtocol = TaskProtocol(hold=HoldProtocol(stop_early=True))

    def __post_init__(self) -> None:
        if not self.hands or not self.objects:
            raise InputError("the index study needs at least one hand and one object")
        if self.count < 1 or self.seed < 0:
            raise InputError(
                f"the count must be 1 or more and the seed 0 or more, got {self.count} and {self.seed}"
            )

    def counts(self) -> list[tuple[str, str, int]]:
        """Hand, object and number of grasps of each pair; the numbers add up to ``count``."""
        pairs = [(hand, name) for hand in self.hands for name in self.objects]
        ends = np.linspace(0, self.count, len(pairs) + 1).round().astype(int)
        return [(*pair, int(n)) for pair, n in zip(pairs, np.diff(ends), strict=True) if n]


@value
class IndexRows:
    """All grasps of the study.

    Attributes:
        run: Settings of the study.
        rows: Plain JSON values of each grasp: ``hand``, ``object``, ``scale``, ``task``, the three postures,
            ``indices`` (value and status of each), ``held`` and ``done`` (outcomes of holding and task test;
            ``None`` if the test was impossible), ``hold_status`` and ``task_status``.
        notes: One sentence for each hand with fewer grasps than requested.
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
    """Draw the grasps, compute their indices and test them.

    A script needs ``if __name__ == "__main__":`` for more than one process.

    Args:
        run: Settings of the study.
        folder: Folder for intermediate results, from which the same call resumes; ``None`` stores nothing.
        workers: Number of processes for the tests; by default one for each core. Indices use one process.
        progress: Called with the completed fraction and the current step.

    Raises:
        InputError: A hand or object is unknown, or the folder holds results of another run.
        EnvironmentFailure: A file cannot be read or written, or a process was killed.
    """
    notes: list[str] = []
    rows: list[Row] = []
    meter = _Meter(progress, run.count)
    hands = {name: physics_hand(load_hand(name)) for name in run.hands}
    with ExitStack() as stack:
        store = folder or Path(stack.enter_context(TemporaryDirectory(prefix="preshape-indices-")))
        instances = {name: make_instances([name], seed=run.seed) for name in run.objects}
        pieces: dict[str, ConvexPieces] = {}
        for name in run.objects:
            meter.report(f"convex pieces of {name}")
            pieces[name] = load_pieces(name)
        for hand, model in hands.items():
            own: list[Row] = []
            counts = {name: count for one, name, count in run.counts() if one == hand}
            for name, count in counts.items():
                meter.report(f"indices of {hand} on {name}")
                own += _indexed(run, hand, name, count, model, instances[name], store)
                meter.done += count
            wanted = sum(counts.values())
            if len(own) < wanted:
                notes.append(f"{hand} gave only {len(own)} of the {wanted} grasps asked for")
            rows += _tested(run, own, model, instances, pieces, store, workers, meter)
            meter.done += 2 * wanted
    return IndexRows(run=run, rows=tuple(rows), notes=tuple(notes))


class _Meter:
    """Progress over three steps of about the same length: indices, holding tests and task tests."""

    def __init__(self, progress: Progress | None, count: int) -> None:
        self.done, self.total, self.progress = 0, 3 * count, progress

    def report(self, label: str, more: int = 0) -> None:
        if self.progress is not None:
            self.progress((self.done + more) / self.total, label)


def _indexed(
    run: IndexRun,
    hand: str,
    object_name: str,
    count: int,
    model: PhysicsHand,
    instances: Sequence[TaskInstance],
    store: Path,
) -> list[Row]:
    """The grasps of one hand on one object with their indices, from the store if they are in it."""
    mesh = load_object(object_name, scale=instances[0].scale)
    state = hashlib.sha256(f"{FORMAT} {__version__} {model.digest} {run.seed} {count}".encode())
    state.update(f"{run.protocol!r} {object_name} {mesh.vertices.tobytes().hex()}".encode())
    key = state.hexdigest()
    file = store / f"{model.name}-{Path(object_name).stem}.json"
    stored = _stored_rows(file, key)
    if stored is not None:
        return stored
    rng = random_generator(run.seed, model.name, object_name)
    own, closure = load_hand(hand), random_grasp_settings()
    drawn = draw_random_grasps(own, mesh, count, rng, closure)
    chosen = [instances[k] for k in rng.integers(len(instances), size=len(drawn.grasps))]
    rows: list[Row] = []
    for one, instance in zip(drawn.grasps, chosen, strict=True):
        grasp = IndexInput(
            points=one.points,
            normals_in=one.normals_in,
            centre=drawn.search.cog,
            cog=mesh.cog,
            length=float(mesh.extents.max()) / 2,
            length_unit=LENGTH_UNIT * own.u,
            plane=one.plane,
        )
        indices = index_values(
            grasp,
            instance.task.q,
            instance.motion,
            mass=run.protocol.hold.mass,
            press=PRESS,
            settings=closure,
            score=partial(planner_score, drawn.search, grasp),
        )
        rows.append(
            {
                "hand": hand,
                "object": object_name,
                "scale": instance.scale,
                "task": instance.task.label,
                **{name: [*one.palm_pose.tolist(), *getattr(one, name).tolist()] for name in STAGES},
                "points": grasp.points.tolist(),
                "normals_in": grasp.normals_in.tolist(),
                "plane": grasp.plane,
                "indices": indices,
            }
        )
    document = {"format": FORMAT, "key": key, "drawn": drawn.drawn, "closed": drawn.closed, "rows": rows}
    write_json(file, document)
    # The stored rows are read back, so that a resumed run has exactly the same numbers and types.
    return _stored_rows(file, key) or []


def _stored_rows(file: Path, key: str) -> list[Row] | None:
    """Rows stored by an earlier run; ``None`` if there is no file.

    Raises:
        InputError: The file is damaged or from another run.
        EnvironmentFailure: The file cannot be read.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise EnvironmentFailure(f"cannot read {file}: {error.strerror}") from error
    try:
        document = loads(text)
        if document["key"] == key:
            rows: list[Row] = document["rows"]
            return rows
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{file} does not hold rows of the index study; remove it, or choose another folder"
        ) from error
    raise InputError(
        f"{file} belongs to a run with another count, seed, hand, object or version; choose another folder"
    )


def _tested(
    run: IndexRun,
    rows: list[Row],
    model: PhysicsHand,
    instances: dict[str, tuple[TaskInstance, ...]],
    pieces: dict[str, ConvexPieces],
    store: Path,
    workers: int | None,
    meter: _Meter,
) -> list[Row]:
    """The rows of one hand with the outcomes of both tests."""
    if not rows:
        return []
    n, hand = len(rows), model.name
    poses = {stage: np.array([row[stage] for row in rows]) for stage in STAGES}
    objects, scale = [row["object"] for row in rows], [row["scale"] for row in rows]
    grasps = palm_grasps(model, objects, scale, poses).for_hand(model)
    used = {name: pieces[name] for name in dict.fromkeys(grasps.objects)}
    holds = run_holds(
        grasps,
        model,
        protocol=run.protocol.hold,
        pieces=used,
        workers=workers,
        progress=lambda done, _: meter.report(f"holding tests of {hand}", done),
        checkpoint=store / f"{hand}.holds.jsonl",
    )
    by_label = {name: {one.task.label: one for one in instances[name]} for name in used}
    tasks = run_tasks(
        [by_label[row["object"]][row["task"]] for row in rows],
        model,
        GivenAnswers(rows=tuple(grasps.poses(k) for k in range(n))),
        protocol=run.protocol,
        pieces=used,
        workers=workers,
        progress=lambda done, _: meter.report(f"task tests of {hand}", n + done),
        checkpoint=store / f"{hand}.tasks.jsonl",
    )
    out = []
    for row, hold, task in zip(rows, holds.results, tasks.results, strict=True):
        untested = task.status in (TaskStatus.INVALID, TaskStatus.NO_ANSWER)
        outcomes = {
            "held": None if hold.status is HoldStatus.INVALID else hold.held,
            "done": None if untested else task.passed,
            "hold_status": hold.status.name.lower(),
            "task_status": task.status.name.lower(),
        }
        out.append({**row, **outcomes})
    return out
