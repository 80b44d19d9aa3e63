"""Settings of a dataset, and the list of its shards."""

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
from ..exceptions import InputError, ObjectError
from ..hands.load import load_hand
from ..objects.load import load_object
from ..objects.mesh import TriangleMesh
from ..physics.task.motion import task_motion
from ..planning.planner_bench import Case, Progress
from ..tasks import Task, parse_task
from ..types import FIELD_MASS, FRICTION, freeze, positive_number, value, whole_number

THRESHOLD = 3.0
"""Smallest quality (0 to 6) of a ranked grasp: the critic's default, at which it just balances the load."""
MAX_SHARDS = 1_000_000
"""Largest number of shards of one dataset."""


@value
class DatasetSettings:
    """All settings that determine the content of the shards, apart from object, scale, hand and task.

    The scene is always free space, without a table and boxes to avoid.

    Attributes:
        per: Number of grasps requested for each combination of object, scale, hand and task.
        per_shard: Largest number of grasps in one shard.
        ranked: If true, the grasps are the planner's answers, best first; otherwise they are random grasps.
        candidates: Number of candidates of the first search for a shard of ranked grasps.
        physics: Whether the grasps go through the holding test and, if the task suits the object, the task
            test.
        friction: Sliding friction in planning, metrics and tests.
        mass: Mass of every object in planning, metrics and tests [kg].
        seed: Seed of every random draw; the same seed gives the same files.

    Raises:
        InputError: A number is out of range.
    """

    per: int = 25
    per_shard: int = 25
    ranked: bool = True
    candidates: int = 2000
    physics: bool = True
    friction: float = FRICTION
    mass: float = FIELD_MASS
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("per", 1), ("per_shard", 1), ("candidates", 1), ("seed", 0)):
            freeze(self, **{name: whole_number(getattr(self, name), name, least)})
        for name in ("friction", "mass"):
            freeze(self, **{name: positive_number(getattr(self, name), name)})

    def to_json(self) -> dict[str, Any]:
        """The settings and the scene as plain JSON values."""
        return {**{field.name: getattr(self, field.name) for field in fields(self)}, **self.conditions()}

    def conditions(self) -> dict[str, Any]:
        """Mass [kg], friction and scene for which the grasps are made, as plain JSON values."""
        return {"mass": self.mass, "friction": self.friction, "table": None, "avoid": []}


@value
class Shard:
    """The description of one file of a dataset; from it and the settings, any process can make the file.

    Attributes:
        name: Name of the file without its suffix.
        object_name: Name of the object.
        source: Mesh file or library name of the object.
        mesh: Hash of the mesh at this scale; empty if the mesh cannot be used.
        scale: Factor on the object's size.
        pieces: Folder with the convex pieces of the objects; ``None`` to cut the object into pieces.
        hand: Name or TOML file, as for :func:`~preshape.hands.load.load_hand`.
        task: The task as text, as for :func:`~preshape.tasks.parse_task`.
        part: Number of this shard among those of the same object, scale, hand and task, from 0.
        count: Number of grasps requested.
        seed: Seed of every random draw in this shard.
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
    """Name of a task in a dataset: its label, or its six numbers if it has no name."""
    return task.label if task.name != "custom" else " ".join(f"{x:g}" for x in task.q)


def usable_object(source: str, scale: float) -> tuple[TriangleMesh | None, str]:
    """The mesh of a source at a scale, or ``None`` and the reason why its file cannot be used.

    Raises:
        UnknownObject: There is no such library object.
        ObjectError: There is no such file.
        EnvironmentFailure: The file cannot be read.
    """
    try:
        return load_object(source, scale=scale), ""
    except ObjectError as error:
        if not Path(source).is_file():
            raise
        return None, str(error)


def mesh_digest(mesh: TriangleMesh | None) -> str:
    """Hash of a mesh; empty for ``None``."""
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
    """List all shards of a dataset so that consecutive shards have different objects.

    The first shard of an object also prepares the object (distance field, convex pieces). With this order,
    several processes prepare different objects at the same time.

    Args:
        cases: Objects at their scales.
        hands: Hand names or TOML files.
        tasks: Task names, or six numbers separated by blanks.
        settings: Settings of the dataset.
        progress: Called after each object.

    Raises:
        InputError: A name is unknown or given twice, or a task has no motion.
    """
    hand_names = {text: load_hand(text).name for text in hands}
    parsed = {text: parse_task(text) for text in tasks}
    for task in parsed.values():
        task_motion(task, [0.0, 0.0, 0.0], 1.0)  # raises for a task without a motion
    _refuse_duplicates([case.name for case in cases], "object")
    _refuse_duplicates(list(hands), "hand")
    _refuse_duplicates(list(tasks), "task")
    _refuse_duplicates(list(hand_names.values()), "hand")
    _refuse_duplicates([task_label(task) for task in parsed.values()], "task")
    parts = math.ceil(settings.per / settings.per_shard)
    total = parts * len(cases) * len(hands) * len(tasks)
    if total > MAX_SHARDS:
        raise InputError(
            f"a dataset has at most {MAX_SHARDS} shards, this one would have {total}; raise --per-shard or "
            "ask for fewer grasps"
        )
    rows: list[list[Shard]] = []
    for number, case in enumerate(cases, start=1):
        mesh = mesh_digest(usable_object(case.source, case.scale)[0])
        rows.append(
            [
                _shard(case, mesh, hand, hand_names[hand], task, parsed[task], part, settings)
                for hand in hands
                for task in tasks
                for part in range(parts)
            ]
        )
        if progress is not None:
            progress("objects read", number, len(cases))
    return [row[k] for k in range(len(rows[0]) if rows else 0) for row in rows]


def _refuse_duplicates(names: list[str], noun: str) -> None:
    duplicates = sorted({name for name in names if names.count(name) > 1})
    if duplicates:
        raise InputError(
            f"every {noun} must be given once and have a name of its own, got {duplicates[0]} twice"
        )


def _shard(
    case: Case,
    mesh: str,
    hand: str,
    hand_name: str,
    task: str,
    parsed: Task,
    part: int,
    settings: DatasetSettings,
) -> Shard:
    key = json.dumps(
        [
            settings.seed,
            case.object_name,
            mesh,
            case.scale,
            hand_name,
            parsed.q.tolist(),
            task_label(parsed),
            part,
        ]
    )
    state = hashlib.sha256(key.encode()).hexdigest()
    plain = "-".join((case.object_name, f"{case.scale:g}", hand_name, task_label(parsed), f"{part:04d}"))
    return Shard(
        name=f"{re.sub('[^A-Za-z0-9.+-]+', '_', plain)}-{state[:8]}",
        object_name=case.object_name,
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
    """Hash of all data that define a hand."""
    return digest(load_hand(name), "dataset")
