"""What a dataset is made with, and the list of its shards."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from ..closure.hand_tables import digest
from ..closure.settings import ClosureSettings
from ..exceptions import InputError, ObjectError
from ..hands.load import load_hand
from ..objects.load import load_object
from ..objects.mesh import TriangleMesh
from ..physics.task.motion import task_motion
from ..planning.planner_bench import Case, Progress
from ..tasks import Task, parse_task
from ..types import value

THRESHOLD = 3.0
"""Quality (0 to 6) that a ranked grasp has at least: the critic's default, just enough for the load."""


@value
class DatasetSettings:
    """Everything that decides the content of a shard, beside its name.

    Attributes:
        per: grasps wanted of each object, scale, hand and task.
        per_shard: of these in one shard, at most.
        ranked: the planner's answers, best first; else hands closed at random, whatever they are worth.
        candidates: hands closed at first for a shard of ranked grasps.
        physics: whether every grasp is put to the holding test and, where it makes sense, the task test.
        friction: of planning, metrics and tests.
        mass: of every object [kg].
        seed: of everything random.

    Raises:
        InputError: a number out of range.
    """

    per: int = 25
    per_shard: int = 25
    ranked: bool = True
    candidates: int = 2000
    physics: bool = True
    friction: float = 0.6
    mass: float = 0.1
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("per", 1), ("per_shard", 1), ("candidates", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise InputError(f"{name} must be {least} or more, got {getattr(self, name)}")
        for name in ("friction", "mass"):
            number = getattr(self, name)
            if not (math.isfinite(number) and number > 0):
                raise InputError(f"{name} must be a number above 0, got {number!r}")

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def closure(self, count: int) -> ClosureSettings:
        """The planner's settings for a shard of ``count`` grasps."""
        return ClosureSettings(
            friction=self.friction,
            mass=self.mass,
            everywhere=self.candidates,
            finished=max(6, count + count // 2 + 2),
            threads=1,
        )


MOST_SHARDS = 1_000_000
"""Of one dataset."""


@value
class Shard:
    """One part of a dataset; all that a process anywhere needs to make it.

    Attributes:
        name: of its file, without the suffix.
        object_name: the object's.
        source: its file or library name.
        mesh: hash of its mesh at this scale, or empty where it cannot be used.
        scale: factor on its size.
        pieces: folder of objects that are cut already, or ``None``.
        hand: name or TOML, as :func:`~preshape.hands.load.load_hand` takes it.
        task: as :func:`~preshape.tasks.parse_task` takes it.
        part: number of the part, from 0.
        count: grasps wanted.
        seed: of everything random in it.
    """

    name: str
    object_name: str
    source: str
    mesh: str
    scale: float
    pieces: str | None
    hand: str
    task: str
    part: int
    count: int
    seed: int


def task_label(task: Task) -> str:
    """What a task is called in a dataset: its label, or the six numbers of one that has no name."""
    return task.label if task.name != "custom" else " ".join(f"{x:g}" for x in task.q)


def usable_object(source: str, scale: float) -> tuple[TriangleMesh | None, str]:
    """The mesh that a source gives at a scale; or ``None``, and why a file holds none that can be used.

    Raises:
        UnknownObject: no such library object.
        ObjectError: no such file.
        EnvironmentFailure: it cannot be read.
    """
    try:
        return load_object(source, scale=scale), ""
    except ObjectError as error:
        if not Path(source).is_file():
            raise
        return None, str(error)


def mesh_digest(mesh: TriangleMesh | None) -> str:
    """Hash of a mesh; empty where there is none."""
    if mesh is None:
        return ""
    return hashlib.sha256(mesh.vertices.tobytes() + mesh.triangles.tobytes()).hexdigest()


def list_shards(
    cases: Sequence[Case],
    hands: Sequence[str],
    tasks: Sequence[str],
    settings: DatasetSettings,
    progress: Progress | None = None,
) -> list[Shard]:
    """All shards of a dataset, those of different objects in turn.

    In turn, because the first shard of an object also has to prepare it (distance field, convex pieces),
    which many processes then do for many objects, and not for the same one.

    Args:
        cases: objects and scales.
        hands: names or TOML files.
        tasks: names, or six numbers with blanks between.
        settings: the dataset's.
        progress: called after each object.

    Raises:
        InputError: something is not known, given twice, or a task without a motion.
    """
    own = {text: load_hand(text).name for text in hands}
    asked = {text: parse_task(text) for text in tasks}
    for task in asked.values():
        task_motion(task, [0.0, 0.0, 0.0], 1.0)  # refuses one without a motion
    _refuse_twice([case.name for case in cases], "object")
    _refuse_twice(list(hands), "hand")
    _refuse_twice(list(tasks), "task")
    _refuse_twice(list(own.values()), "hand")
    _refuse_twice([task_label(task) for task in asked.values()], "task")
    parts = math.ceil(settings.per / settings.per_shard)
    total = parts * len(cases) * len(hands) * len(tasks)
    if total > MOST_SHARDS:
        raise InputError(
            f"this would be {total} shards, {MOST_SHARDS} are the most; ask for larger ones or fewer"
        )
    rows: list[list[Shard]] = []
    for number, case in enumerate(cases, start=1):
        mesh = mesh_digest(usable_object(case.source, case.scale)[0])
        rows.append(
            [
                _shard(case, mesh, hand, own[hand], task, asked[task], part, settings)
                for hand in hands
                for task in tasks
                for part in range(parts)
            ]
        )
        if progress is not None:
            progress("objects read", number, len(cases))
    return [row[k] for k in range(len(rows[0]) if rows else 0) for row in rows]


def _refuse_twice(names: list[str], noun: str) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"every {noun} must be named once and have a name of its own, got {twice[0]} twice")


def _shard(
    case: Case,
    mesh: str,
    hand: str,
    hand_name: str,
    task: str,
    asked: Task,
    part: int,
    settings: DatasetSettings,
) -> Shard:
    key = json.dumps(
        [settings.seed, case.thing, mesh, case.scale, hand_name, asked.q.tolist(), task_label(asked), part]
    )
    state = hashlib.sha256(key.encode()).hexdigest()
    plain = "-".join((case.thing, f"{case.scale:g}", hand_name, task_label(asked), f"{part:04d}"))
    return Shard(
        name=f"{re.sub('[^A-Za-z0-9.+-]+', '_', plain)}-{state[:8]}",
        object_name=case.thing,
        source=case.source,
        mesh=mesh,
        scale=case.scale,
        pieces=None if case.pieces is None else str(case.pieces),
        hand=hand,
        task=task,
        part=part,
        count=min(settings.per_shard, settings.per - part * settings.per_shard),
        seed=int(state[:16], 16) >> 1,
    )


def hand_digest(name: str) -> str:
    """Hash of all that a hand is."""
    return digest(load_hand(name), "dataset")
