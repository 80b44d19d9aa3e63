"""Physics tests of a shard's grasps: the holding test, and the task test if the task suits the object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import InputError
from ..hands.hand import Hand
from ..objects.mesh import TriangleMesh
from ..physics.hand import physics_hand
from ..physics.hold.runner import run_holds
from ..physics.hold.six_directions import HoldResult, HoldStatus
from ..physics.protocol import HoldProtocol
from ..physics.task.grasps import GivenAnswers
from ..physics.task.instances import TaskInstance, suitable
from ..physics.task.protocol import TaskProtocol, TaskResult, TaskStatus
from ..physics.task.runner import run_tasks
from ..planning.answers import Answer
from ..planning.planner_bench import Case, Planned, grasps_of
from ..tasks import Task
from .settings import DatasetSettings, Shard

Row = dict[str, Any]

HOLD_COLUMNS = (
    "hold_status", "hold_reason", "held", "held_directions", "hold_displacement", "hold_rotation",
    "touching_at_grasp", "touching_at_squeeze", "parts_at_grasp", "only_by_squeeze", "clean", "penetration",
    "self_penetration", "contact_distance",
)  # fmt: skip
TASK_COLUMNS = (
    "task_status", "task_reason", "task_done", "task_progress", "task_displacement", "task_rotation",
)  # fmt: skip


def untested(count: int, reason: str | None = None) -> list[Row]:
    """The columns of both tests for grasps that were not tested.

    Args:
        count: Number of grasps.
        reason: Why the tests were impossible; ``None`` if no tests were requested.
    """
    row: Row = dict.fromkeys((*HOLD_COLUMNS, *TASK_COLUMNS))
    if reason is not None:
        row |= {"hold_status": "invalid", "hold_reason": reason}
        row |= {"task_status": "invalid", "task_reason": reason}
    return [dict(row) for _ in range(count)]


def tested(
    shard: Shard,
    hand: Hand,
    mesh: TriangleMesh,
    task: Task,
    answers: tuple[Answer, ...],
    settings: DatasetSettings,
) -> list[Row]:
    """Test the grasps of a shard and return the columns of both tests.

    Args:
        shard: The shard.
        hand: The hand.
        mesh: The object at its scale [m].
        task: The task.
        answers: The grasps.
        settings: Settings of the dataset.

    Raises:
        EnvironmentFailure: The object cannot be cut into convex pieces on this machine.
    """
    folder = Path(shard.pieces) if shard.pieces else None
    case = Case(
        name=f"{shard.object_name}@{shard.scale:g}", source=shard.source, scale=shard.scale, pieces=folder
    )
    planned = Planned(case=case, answers=answers, mode=3, reason="", seconds={})
    grasps = grasps_of([planned], hand)
    if grasps is None:
        return []
    try:
        pieces = {shard.source: case.load_pieces()}
    except InputError as error:
        return untested(len(answers), str(error))
    model = physics_hand(hand)
    protocol = HoldProtocol(friction=settings.friction, mass=settings.mass)
    holds = run_holds(grasps, model, protocol=protocol, pieces=pieces, workers=1)
    rows = [_hold(result) for result in holds.results]
    if not suitable(task, mesh):
        return [row | dict.fromkeys(TASK_COLUMNS) for row in rows]
    instance = TaskInstance(
        object_name=shard.source,
        scale=shard.scale,
        task=task,
        cog=mesh.cog,
        half_extent=float(mesh.extents.max()) / 2,
        gravity=np.asarray(task.gravity),
    )
    own = grasps.for_hand(model)
    poses = tuple(own.poses(k) for k in range(len(own)))
    taken = run_tasks(
        [instance] * len(poses),
        model,
        GivenAnswers(rows=poses),
        protocol=TaskProtocol(hold=protocol),
        pieces=pieces,
        workers=1,
    )
    return [row | _task(result) for row, result in zip(rows, taken.results, strict=True)]


def _hold(result: HoldResult) -> Row:
    row: Row = dict.fromkeys(HOLD_COLUMNS)
    row |= {"hold_status": result.status.name.lower(), "hold_reason": result.reason}
    if result.status is HoldStatus.INVALID:
        return row
    row |= {
        "held": result.held,
        "touching_at_grasp": result.touching_at_grasp,
        "touching_at_squeeze": result.touching_at_squeeze,
        "only_by_squeeze": result.only_by_squeeze,
        "clean": result.clean,
    }
    if result.probes:
        row |= {
            "held_directions": [probe.held for probe in result.probes],
            "hold_displacement": [probe.displacement for probe in result.probes],
            "hold_rotation": [probe.rotation for probe in result.probes],
        }
    if result.at_grasp is not None:
        row |= {
            "parts_at_grasp": result.at_grasp.parts,
            "penetration": result.at_grasp.penetration,
            "self_penetration": result.at_grasp.self_penetration,
            "contact_distance": result.at_grasp.contact_distance,
        }
    return row


def _task(result: TaskResult) -> Row:
    row: Row = dict.fromkeys(TASK_COLUMNS)
    row |= {"task_status": result.status.name.lower(), "task_reason": result.reason}
    if result.status is not TaskStatus.INVALID:
        row |= {
            "task_done": result.passed,
            "task_progress": result.progress,
            "task_displacement": result.displacement,
            "task_rotation": result.rotation,
        }
    return row
