"""Tasks from displacements, pairs of poses and primitives, and the motions of tasks (§2.2).

A displacement here is (4, 4) [R t; 0 1] of x' = R(x - c) + c + t, with the COG c, in the object's first frame
[m]. The task stores the exact displacement, and Q is derived from it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError, TaskError, shown
from ..spatial import (
    along_screw,
    checked_pose,
    inverse,
    pose,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)
from ..types import Array, frozen_array, numbers
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

FULL_TRANSLATION = 0.1
"""Largest component of a translation in the task test [m] (docs/task-benchmark.md)."""
FULL_ROTATION = math.pi / 4
"""Largest component of a rotation vector in the task test [rad] (docs/task-benchmark.md)."""

_DOWN = (0.0, 0.0, -1.0)


def q_of_displacement(displacement: Array) -> Array:
    """(6,) Q of a displacement.

    Translations and rotations are treated separately. Each value is presence × component / largest absolute
    component. It is the absence value if the component is below 10 % of the largest, or if the motion is
    below 1 µm or 1 µrad [C].
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
    """A task from a rigid displacement about the COG, given as a matrix or as rotation and translation.

    Args:
        displacement: (4, 4) [R t; 0 1] of x' = R(x - c) + c + t. For a matrix about another origin use
            :func:`task_from_poses` with the identity as start.
        rotation: (3, 3) rotation, quaternion wxyz (4,) or rotation vector (3,) [rad]; by default none.
        translation: (3,) translation of the COG [m]; by default none.
        name: Name of the task.
        means: Description; by default made from the motion.
        gravity: (3,) direction of gravity in the object's frame; zeros for none.

    Raises:
        TaskError: The displacement is not rigid, or is given twice or not at all.
    """
    parts = rotation is not None or translation is not None
    if parts == (displacement is not None):
        raise TaskError(
            "give the displacement of a task either as a 4×4 matrix or as rotation and translation"
        )
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
    shape = numbers(data, "a rotation").shape
    if shape == (3,):
        return rotation_from_vector(frozen_array(data, (3,), "rotation vector"))
    if shape == (4,):
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
    """A task that moves the object from one pose to another.

    Args:
        T_world_start: (4, 4) pose of the object at the start.
        T_world_goal: (4, 4) pose of the object at the end.
        cog: (3,) COG in the object's frame [m].
        name: Name of the task.
        means: Description; by default made from the motion.
        gravity: (3,) direction of gravity in the object's first frame; zeros for none.

    Raises:
        TaskError: A pose is not rigid, or the COG is not three finite numbers.
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
    """(4, 4) pose of the object after the task; the inverse of :func:`task_from_poses`."""
    moved, c = displacement_of(task), np.asarray(cog, dtype=np.float64)
    rotation = moved[:3, :3]
    T_start_goal = pose(rotation, moved[:3, 3] - rotation @ c + c)
    return np.asarray(T_world_start, dtype=np.float64) @ T_start_goal


def compose(primitives: Iterable[Primitive]) -> Array:
    """(4, 4) displacement of a sequence of primitives.

    All axes are those of the object's first frame, and each rotation is about the COG at its current place
    [C]. A rotation therefore never moves the COG: translations add up, and rotations multiply.
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
    """A task from translations and rotations, which :func:`compose` combines; the task stores the list.

    Raises:
        TaskError: There are no primitives.
    """
    steps = tuple(primitives) if np.iterable(primitives) else ()
    if not steps or not all(isinstance(step, Primitive) for step in steps):
        raise TaskError(f"a task needs at least one primitive, translate or rotate, got {shown(primitives)}")
    moved = compose(steps)
    q = q_of_displacement(moved)
    task = Task(name=name, q=q, displacement=moved, means=means, gravity=gravity, primitives=steps)
    return task if means else _with_means(task)


def primitives_of(task: Task) -> tuple[Primitive, ...]:
    """At most six axial primitives that :func:`compose` to the task's displacement.

    They are rotations about x, y and z (R = Rz Ry Rx), then translations along x, y and z; steps of zero are
    left out [C]. If the rotation about y is a right angle, the rotations about x and z are not unique.
    """
    moved = displacement_of(task)
    r = moved[:3, :3]
    z = math.atan2(r[1, 0], r[0, 0])
    y = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    # x comes from Rzᵀ R, because the last row of R vanishes where y is a right angle.
    s, c = math.sin(z), math.cos(z)
    x = math.atan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1])
    amounts = [("rotate", angle) for angle in (x, y, z)] + [("translate", d) for d in moved[:3, 3].tolist()]
    return tuple(
        Primitive(kind=kind, axis=axis, amount=amount)
        for (kind, amount), axis in zip(amounts, ("+x", "+y", "+z") * 2, strict=True)
        if amount != 0.0
    )


def displacement_of(task: Task) -> Array:
    """(4, 4) exact displacement of the task; for a task from numbers or a name, its :func:`full_motion`."""
    return full_motion(task) if task.displacement is None else task.displacement


def full_motion(task: Task) -> Array:
    """(4, 4) displacement about the COG at the size that the task test uses.

    A task from six numbers or a name keeps its proportions, with the largest translation component at 0.1 m
    and the largest component of the rotation vector at 45°. A task with a displacement follows the screw of
    that displacement up to the first of these two limits, so that translation and rotation stay in proportion
    [C].
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
    while high - low > 1e-15 * high:  # the COG follows an arc, so its displacement is not proportional
        middle = (low + high) / 2
        if not low < middle < high:
            break
        low, high = (middle, high) if reach(middle) <= FULL_TRANSLATION else (low, middle)
    return along_screw(displacement, low)
