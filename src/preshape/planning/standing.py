"""Where the object of a request stands: its pose, the table below it, and the task in the mesh frame.

The mesh is never turned; all poses of a plan stay in its frame. ``up`` says which axis of the mesh is up. The
axes of a task and its gravity are those of the upright mesh, so they follow ``up``. On a table, the object
lies as it comes to rest: as the library, a file beside the mesh or the request says, else as it settles
(:mod:`preshape.objects.resting`). A table that was cut off a point cloud is the table. In free space, and
above a table at a stated height, the object is as modelled. The task ``lift`` raises the object as it lies;
all other tasks keep their axes, and the hand turns the object to their gravity after the lift.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from .. import spatial
from ..exceptions import InputError
from ..objects.mesh import TriangleMesh
from ..objects.resting import settled_up, turned_up, upright
from ..tasks import Task
from ..tasks.task import ROTATION_ABSENT, TRANSLATION_ABSENT, axis_vector
from ..types import Array, value

AUTO = "auto"
"""Value of ``table`` that means a table that the object rests on."""
DEFAULT = "default"
"""Value of ``table`` that leaves the choice between ``auto`` and free space to hand and analyser."""
TURNED = math.radians(5.0)
"""An object that would settle by at most this angle is planned for as it is modelled [C]."""
_STANDING: WeakKeyDictionary[TriangleMesh, tuple[Any, Standing]] = WeakKeyDictionary()  # the last one each
_LIFT, _SAME = "lift:+z", math.radians(1.0)
_ABSENT = np.array([TRANSLATION_ABSENT] * 3 + [ROTATION_ABSENT] * 3)


@value
class Standing:
    """The object in the world of a request, whose z is up.

    Attributes:
        upright: (3, 3) rotation from the mesh frame to the frame of the task's axes.
        R_world_object: (3, 3) rotation from the mesh frame to the world. The origins are the same.
        table: (4,) the table as a solid half-space n·x < d in the mesh frame: unit normal n, which is up, and
            d [m]; ``None`` without one.
        settled: Whether the object was settled here, because nobody says how it rests.
    """

    upright: Array
    R_world_object: Array
    table: Array | None = None
    settled: bool = False

    @property
    def up(self) -> Array:
        """(3,) unit vector against gravity while the object is approached, gripped and lifted, mesh frame."""
        return self.R_world_object[2]

    @property
    def pose(self) -> Array:
        """(7,) pose of the object in the world: xyz [m] and quaternion wxyz."""
        return spatial.seven_from_pose(spatial.pose(self.R_world_object, np.zeros(3)))

    @property
    def turned(self) -> float:
        """Angle between up as the object is modelled and up as it stands [rad]."""
        return math.acos(float(np.clip(self.up @ self.upright[2], -1.0, 1.0)))

    @property
    def warning(self) -> str:
        """What a person should know of an object that was settled here, as a clause; empty otherwise."""
        if not self.settled:
            return ""
        return (
            "does not stand as it is modelled: it settles on the table, turned by "
            f"{math.degrees(self.turned):.0f}°, and is planned for as it then lies; --up, or the table's "
            "height with --table HEIGHT, says how it stands"
        )

    def task(self, task: Task) -> Task:
        """The task in the mesh frame; ``lift`` raises the object as it lies."""
        if task.label != _LIFT or self.turned < _SAME:
            return turned_task(task, self.upright)
        q = np.where(np.abs(self.up) > TRANSLATION_ABSENT, self.up, TRANSLATION_ABSENT)
        direction = ", ".join(f"{round(x, 2) + 0.0:.2f}" for x in self.up.tolist())
        means = f"Raise the object along ({direction}), which is up as it lies, without turning it."
        return replace(task, q=np.append(q, task.q[3:]), gravity=-self.up, means=means)

    def direction(self, vector: Sequence[float] | Array) -> Array:
        """(3,) a direction along the axes of the task, such as its gravity, in the mesh frame."""
        return np.asarray(np.asarray(vector, dtype=np.float64) @ self.upright)


def standing(
    mesh: TriangleMesh,
    *,
    up: str | None = None,
    rest: Sequence[float] | Array | None = None,
    table: float | str | None = None,
) -> Standing:
    """Where an object stands.

    Args:
        mesh: The object [m].
        up: Axis of the mesh that is up; ``None`` for the mesh's own. If it is stated, the rest that the mesh
            states does not count.
        rest: (4,) quaternion wxyz that turns the mesh frame, as the object lies at rest, to the world.
        table: ``auto``, a height along ``up`` [m], or ``None``.

    Raises:
        InputError: The table is above the object's lowest point.
    """
    key = (up, None if rest is None else tuple(np.ravel(rest).tolist()), table)
    kept = _STANDING.get(mesh)
    if kept is None or kept[0] != key:  # a plan asks several times
        _STANDING[mesh] = kept = key, _stands(mesh, up, rest, table)
    return kept[1]


def _stands(
    mesh: TriangleMesh,
    up: str | None,
    rest: Sequence[float] | Array | None,
    table: float | str | None,
) -> Standing:
    R = upright(mesh.up if up is None else up)
    if table is None:
        return Standing(upright=R, R_world_object=R)
    if table != AUTO:
        height, lowest = float(table), lowest_point(mesh, R[2])
        if height > lowest + 1e-6:
            axis = _name_of(R[2]).lower().lstrip("+")
            raise InputError(
                f"the table at {axis} = {height:g} m is above the lowest point of {mesh.name}, {lowest:.4g} "
                "m: the object would stand in it; give a lower height, or --table alone for the lowest point"
            )
        return Standing(upright=R, R_world_object=R, table=np.append(R[2], height))
    seen = mesh.scan.table if mesh.scan is not None and up is None and rest is None else None
    if seen is not None:  # the table was in the cloud, and its normal is up
        return Standing(upright=R, R_world_object=turned_up(R @ seen[:3]) @ R, table=seen)
    known = rest if rest is not None else mesh.rest if up is None else None
    settles = known is None
    if known is None:
        now = settled_up(mesh, R[2])
        settles = math.acos(float(np.clip(now @ R[2], -1.0, 1.0))) > TURNED
        at_rest = turned_up(R @ now) @ R if settles else R
    else:
        at_rest = spatial.rotation_from_quaternion(known)
    plane = np.append(at_rest[2], lowest_point(mesh, at_rest[2]))
    return Standing(upright=R, R_world_object=at_rest, table=plane, settled=settles)


def lowest_point(mesh: TriangleMesh, up: Array) -> float:
    """Least coordinate of a mesh along a direction (3,) [m]."""
    if abs(up[2] - 1.0) < 1e-15:
        return float(mesh.bounds[0, 2])
    return float((mesh.corners.reshape(-1, 3) @ up).min())


def turned_task(task: Task, upright: Array) -> Task:
    """A task whose axes are those of the upright mesh, in the mesh frame.

    Absent components keep their values. Its name and axis stay as they were asked for.

    Args:
        task: The task.
        upright: (3, 3) rotation from the mesh frame to the frame of the task's axes; it permutes axes.
    """
    if np.array_equal(upright, np.eye(3)):
        return task
    present = np.abs(task.q) > _ABSENT
    places = np.abs(upright).argmax(axis=0)  # axis of the task for each axis of the mesh
    signs = upright[places, range(3)]
    order = np.concatenate([places, 3 + places])
    q = task.q[order]
    q = np.where(present[order], q * np.concatenate([signs, signs]), q)
    moved = task.displacement
    if moved is not None:
        moved = spatial.pose(upright.T @ moved[:3, :3] @ upright, upright.T @ moved[:3, 3])
    return replace(
        task,
        q=q,
        displacement=moved,
        gravity=np.asarray(task.gravity) @ upright,
        means=_turned_words(task.means, upright) if task.axis else task.means,
        primitives=tuple(replace(step, axis=np.asarray(step.axis) @ upright) for step in task.primitives),
    )


def _turned_words(words: str, upright: Array) -> str:
    """A text whose signed axes, such as +X, are those of the mesh."""
    return re.sub(r"[+-][XYZ]\b", lambda found: _name_of(axis_vector(found[0]) @ upright), words)


def _name_of(direction: Array) -> str:
    """The signed axis of a direction along an axis, such as ``+Z``."""
    i = int(np.abs(direction).argmax())
    return f"{'+' if direction[i] > 0 else '-'}{'XYZ'[i]}"
