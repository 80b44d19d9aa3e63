"""Tasks from displacements, pose pairs and primitives, and the motions that tasks stand for (§2.2).

A displacement here is (4, 4) [R t; 0 1] of x' = R(x - c) + c + t, with c the COG, in the object's frame
at the start [m]. The exact displacement is kept; Q is derived from it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError, TaskError
from ..spatial import (
    along_screw,
    checked_pose,
    inverse,
    pose,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)
from ..types import Array, frozen_array
from .task import (
    NO_MOTION,
    ROTATION_ABSENT,
    ROTATION_PRESENT,
    TRANSLATION_ABSENT,
    TRANSLATION_PRESENT,
    Primitive,
    Task,
    motion_of,
    proportions,
)

# The largest components of the task test's motion (ENGINE.md, task test).
FULL_TRANSLATION = 0.1
FULL_ROTATION = math.pi / 4

_DOWN = (0.0, 0.0, -1.0)


def q_of_displacement(displacement: Array) -> Array:
    """Q (6,) derived from a displacement.

    Translations and rotations apart: value = presence × component / size of the largest, with its sign;
    where a component's size is under 10 % of the largest, and where there is no motion at all (below 1 µm,
    1 µrad), the absence value [C].
    """
    q = proportions(displacement)
    for part, present, absent in (
        (q[:3], TRANSLATION_PRESENT, TRANSLATION_ABSENT),
        (q[3:], ROTATION_PRESENT, ROTATION_ABSENT),
    ):
        part[np.abs(part) < 0.1 * present] = absent
    return q


def task_from_displacement(
    displacement: ArrayLike | None = None,
    *,
    rotation: ArrayLike | None = None,
    translation: ArrayLike | None = None,
    name: str = "custom",
    means: str = "",
    gravity: Sequence[float] | Array = _DOWN,
) -> Task:
    """A task from a rigid displacement about the COG.

    Args:
        displacement: (4, 4) [R t; 0 1] of x' = R(x - c) + c + t. For a matrix about another origin use
            :func:`task_from_poses` with the identity as start.
        rotation: instead, (3, 3), a quaternion wxyz (4,) or a rotation vector (3,) [rad].
        translation: (3,) of the COG [m]. Of the two, the one left out is none.
        name: the task's name.
        means: a sentence; made from the motion where empty.
        gravity: (3,) its direction in the object's frame, zeros for none.

    Raises:
        TaskError: not a rigid displacement, or given twice or not at all.
    """
    parts = rotation is not None or translation is not None
    if parts == (displacement is not None):
        raise TaskError("give a task's displacement either as a 4×4 matrix or as rotation and translation")
    try:
        if displacement is None:
            shift = frozen_array(np.zeros(3) if translation is None else translation, (3,), "translation")
            displacement = pose(np.eye(3) if rotation is None else _rotation(rotation), shift)
        moved = checked_pose(displacement, "a task's displacement")
    except InputError as error:
        raise TaskError(str(error)) from error
    task = Task(name=name, q=q_of_displacement(moved), displacement=moved, means=means, gravity=gravity)
    return task if means else _with_means(task)


def _rotation(data: ArrayLike) -> Array:
    if np.shape(data) == (3,):
        return rotation_from_vector(frozen_array(data, (3,), "rotation vector"))
    if np.shape(data) == (4,):
        return rotation_from_quaternion(frozen_array(data, (4,), "rotation quaternion"))
    return frozen_array(data, (3, 3), "rotation")


def _with_means(task: Task) -> Task:
    motion = task.describe()
    means = f"Move the object {motion}." if motion != "no motion" else "Hold the object still."
    return replace(task, means=means)


def task_from_poses(
    T_world_start: ArrayLike,
    T_world_goal: ArrayLike,
    cog: ArrayLike,
    *,
    name: str = "custom",
    means: str = "",
    gravity: Sequence[float] | Array = _DOWN,
) -> Task:
    """A task that takes the object from one pose to another.

    Args:
        T_world_start: (4, 4) pose of the object's frame before.
        T_world_goal: (4, 4) pose after.
        cog: (3,) the COG in the object's frame [m].
        name: the task's name.
        means: a sentence; made from the motion where empty.
        gravity: (3,) its direction in the object's frame at the start, zeros for none.

    Raises:
        TaskError: a pose that is not one, or a COG that is not three numbers.
    """
    try:
        start = checked_pose(T_world_start, "the start pose")
        goal = checked_pose(T_world_goal, "the goal pose")
        c = frozen_array(cog, (3,), "the COG")
    except InputError as error:
        raise TaskError(str(error)) from error
    T_start_goal = inverse(start) @ goal
    rotation = T_start_goal[:3, :3]
    # R x + d = R(x - c) + c + t  gives  t = d + R c - c
    moved = pose(rotation, T_start_goal[:3, 3] + rotation @ c - c)
    return task_from_displacement(moved, name=name, means=means, gravity=gravity)


def goal_pose(task: Task, T_world_start: ArrayLike, cog: ArrayLike) -> Array:
    """(4, 4) where the task takes an object from ``T_world_start``; inverse of :func:`task_from_poses`."""
    moved, c = displacement_of(task), np.asarray(cog, dtype=np.float64)
    rotation = moved[:3, :3]
    T_start_goal = pose(rotation, moved[:3, 3] - rotation @ c + c)
    return np.asarray(T_world_start, dtype=np.float64) @ T_start_goal


def compose(primitives: Iterable[Primitive]) -> Array:
    """(4, 4) displacement of primitives done one after the other.

    All axes are those of the object's starting frame, and a rotation is about the COG where it then is [C]:
    a rotation never moves the COG, so translations add and rotations multiply.
    """
    rotation, translation = np.eye(3), np.zeros(3)
    for step in primitives:
        if step.kind == "rotate":
            rotation = rotation_from_vector(step.vector) @ rotation
        else:
            translation = translation + step.vector
    return pose(rotation, translation)


def task_from_primitives(
    primitives: Sequence[Primitive],
    *,
    name: str = "custom",
    means: str = "",
    gravity: Sequence[float] | Array = _DOWN,
) -> Task:
    """A task from translations and rotations, composed as :func:`compose` does; the list is kept.

    Raises:
        TaskError: no primitives at all.
    """
    steps = tuple(primitives)
    if not steps or not all(isinstance(step, Primitive) for step in steps):
        raise TaskError(f"a task needs at least one primitive, translate or rotate, got {steps!r:.80}")
    moved = compose(steps)
    q = q_of_displacement(moved)
    task = Task(name=name, q=q, displacement=moved, means=means, gravity=gravity, primitives=steps)
    return task if means else _with_means(task)


def primitives_of(task: Task) -> tuple[Primitive, ...]:
    """At most six axial primitives that :func:`compose` to the task's displacement.

    Rotations about x, then y, then z (R = Rz Ry Rx), then translations along x, y, z; zero ones are left
    out [C]. Where y turns by a right angle, x and z share one rotation and any split serves.
    """
    moved = displacement_of(task)
    r = moved[:3, :3]
    z = math.atan2(r[1, 0], r[0, 0])
    y = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    # x from Rzᵀ R and not from R's last row, which vanishes where y is a right angle
    s, c = math.sin(z), math.cos(z)
    x = math.atan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1])
    amounts = [("rotate", angle) for angle in (x, y, z)] + [("translate", d) for d in moved[:3, 3].tolist()]
    return tuple(
        Primitive(kind=kind, axis=axis, amount=amount)
        for (kind, amount), axis in zip(amounts, ("+x", "+y", "+z") * 2, strict=True)
        if amount != 0.0
    )


def displacement_of(task: Task) -> Array:
    """(4, 4) the task's exact displacement; of numbers or a name, its :func:`full_motion`."""
    return full_motion(task) if task.displacement is None else task.displacement


def full_motion(task: Task) -> Array:
    """(4, 4) displacement about the COG of the size that the task test uses.

    Six numbers or a name: the motion's proportions with the largest translation component at 0.1 m and the
    largest rotation vector component at 45°. A kept displacement: along its own screw, as far as the first of
    the two limits, so that translation and rotation keep to each other [C].
    """
    if task.displacement is not None:
        return _along_own_screw(task.displacement)
    motion = motion_of(task)
    t, r = motion[:3], motion[3:]
    t = t / np.abs(t).max() * FULL_TRANSLATION if t.any() else t
    r = r / np.abs(r).max() * FULL_ROTATION if r.any() else r
    return pose(rotation_from_vector(r), t)


def _along_own_screw(displacement: Array) -> Array:
    t = displacement[:3, 3]
    turned = float(np.abs(vector_from_rotation(displacement[:3, :3])).max())
    moved = float(np.abs(t).max())
    if turned <= NO_MOTION:
        return pose(np.eye(3), t / moved * FULL_TRANSLATION if moved > NO_MOTION else np.zeros(3))
    if moved <= NO_MOTION:
        return along_screw(displacement, FULL_ROTATION / turned)
    low, high = 0.0, FULL_ROTATION / turned

    def reach(fraction: float) -> float:
        return float(np.abs(along_screw(displacement, fraction)[:3, 3]).max())

    if reach(high) <= FULL_TRANSLATION * (1 + 1e-12):
        return along_screw(displacement, high)
    while high - low > 1e-15 * high:  # the COG follows an arc, so its way is not proportional
        middle = (low + high) / 2
        if not low < middle < high:
            break
        low, high = (middle, high) if reach(middle) <= FULL_TRANSLATION else (low, middle)
    return along_screw(displacement, low)
