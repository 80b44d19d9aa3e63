"""A task: what the hand must do with the object, Q = [T; R] about the COG (§2.2, eq. 3)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError, TaskError
from ..spatial import checked_pose, vector_from_rotation
from ..types import Array, freeze, frozen_array, value

# Presence and absence of a translation and of a rotation component (§2.2) [P].
TRANSLATION_PRESENT, TRANSLATION_ABSENT = 1.0, 0.1
ROTATION_PRESENT, ROTATION_ABSENT = 0.8, 0.05
# A smaller translation [m] or rotation [rad] is rounding in a file, not a task [C].
NO_MOTION = 1e-6

COMPONENTS = ("Tx", "Ty", "Tz", "Rx", "Ry", "Rz")
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
_SIX = f"a task is six numbers {' '.join(COMPONENTS)}"


def axis_name(text: str) -> str:
    """One of ``+x -x +y -y +z -z``; a missing sign means plus.

    Raises:
        TaskError: anything else.

    >>> axis_name("Z"), axis_name("-x")
    ('+z', '-x')
    """
    name = text.strip().lower()
    name = f"+{name}" if name in ("x", "y", "z") else name
    if name not in AXES:
        raise TaskError(f"an axis is one of {' '.join(AXES)}, got {text!r}")
    return name


def axis_vector(axis: str | ArrayLike) -> Array:
    """(3,) unit vector of a signed axis name, or of any vector that is not zero.

    Raises:
        TaskError: no such axis, or a vector without a direction.
    """
    if isinstance(axis, str):
        name = axis_name(axis)
        out = np.zeros(3)
        out["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
        return frozen_array(out, (3,), "axis")
    try:
        vector = frozen_array(axis, (3,), "an axis")
    except InputError as error:
        raise TaskError(str(error)) from error
    largest = float(np.abs(vector).max())
    if largest == 0.0:
        raise TaskError("an axis must have a direction, got 0 0 0")
    length = float(np.linalg.norm(vector))
    if abs(length - 1.0) < 1e-15:  # a unit vector is kept bit for bit, so files round-trip
        return vector
    scaled = vector / largest
    return frozen_array(scaled / np.linalg.norm(scaled), (3,), "axis")


@value
class Primitive:
    """One step of a motion: a translation along an axis, or a rotation about one through the COG.

    Attributes:
        kind: ``translate`` or ``rotate``.
        axis: a signed axis name or a (3,) vector in the object's starting frame; kept as a unit vector.
        amount: [m] or [rad]; negative goes the other way.

    Raises:
        TaskError: another kind, no direction, or an amount that is not finite.
    """

    kind: str
    axis: Array | Sequence[float] | str
    amount: float

    def __post_init__(self) -> None:
        if self.kind not in ("translate", "rotate"):
            raise TaskError(f"a primitive is translate or rotate, got {self.kind!r}")
        try:
            amount = float(frozen_array(self.amount, (), f"the amount of a {self.kind} primitive"))
        except InputError as error:
            raise TaskError(str(error)) from error
        freeze(self, axis=axis_vector(self.axis), amount=amount)

    @property
    def vector(self) -> Array:
        """(3,) translation [m] or rotation vector [rad]."""
        return np.asarray(self.axis, dtype=np.float64) * self.amount


@value
class Task:
    """A task, in the object's frame.

    Attributes:
        name: the family's name, or ``custom``.
        q: (6,) Q = [T; R] about the COG, dimensionless presences (§2.2).
        displacement: (4, 4) [R t; 0 1] of x' = R(x - c) + c + t, c the COG [m]; ``None`` where the
            task was made from numbers or a name.
        means: what the task is, one or two sentences.
        gravity: (3,) its unit direction, or zeros for none.
        axis: the signed axis of a named task, else empty.
        primitives: the steps the task was made from, if it was.

    Raises:
        TaskError: wrong shapes, numbers that are not finite, or a displacement that is not rigid.
    """

    name: str
    q: Array
    displacement: Array | None = None
    means: str = ""
    gravity: Array | Sequence[float] = (0.0, 0.0, -1.0)
    axis: str = ""
    primitives: tuple[Primitive, ...] = ()

    def __post_init__(self) -> None:
        try:
            q = frozen_array(self.q, (6,), "task Q")
            gravity = frozen_array(self.gravity, (3,), "gravity")
            moved = self.displacement
            moved = None if moved is None else checked_pose(moved, "a task's displacement")
        except InputError as error:
            raise TaskError(str(error)) from error
        gravity = axis_vector(gravity) if gravity.any() else gravity
        freeze(self, q=q, gravity=gravity, displacement=moved, primitives=tuple(self.primitives))

    @property
    def label(self) -> str:
        """``push:+x`` for a named task, which :func:`~preshape.tasks.parse_task` reads; else the name."""
        return f"{self.name}:{self.axis}" if self.axis else self.name

    def describe(self) -> str:
        """The motion in words, such as ``along +Z, turning about +Z``."""
        motion = _present(self.q)
        parts = []
        for phrase, part in (("along", motion[:3]), ("turning about", motion[3:])):
            names = [f"{'+' if x > 0 else '-'}{letter}" for letter, x in zip("XYZ", part, strict=True) if x]
            if names:
                parts.append(f"{phrase} {' '.join(names)}")
        return ", ".join(parts) or "no motion"


def _present(q: Array) -> Array:
    return np.where(np.abs(q) <= [TRANSLATION_ABSENT] * 3 + [ROTATION_ABSENT] * 3, 0.0, q)


def proportions(displacement: Array) -> Array:
    """(6,) [t; r] of a displacement: the largest |t| component at 1.0, the largest |r| component at 0.8."""
    t, r = displacement[:3, 3], vector_from_rotation(displacement[:3, :3])
    out = np.zeros(6)
    for part, vector, present in ((out[:3], t, TRANSLATION_PRESENT), (out[3:], r, ROTATION_PRESENT)):
        largest = float(np.abs(vector).max())
        if largest > NO_MOTION:
            part[:] = present * (vector / largest)
    return out


def motion_of(task: Task) -> Array:
    """The task as a motion's proportions (6,) = [t; r] about the COG.

    Six numbers: translations up to ±0.1 and rotations up to ±0.05 are read as zero, the others are the
    proportions [C]. A kept displacement: its translation with the largest component at 1.0 and its rotation
    vector with the largest at 0.8. Either way the proportions hold among the translations and among the
    rotations.
    """
    return _present(task.q) if task.displacement is None else proportions(task.displacement)


def task_from_numbers(
    values: Sequence[float] | Array | str,
    *,
    name: str = "custom",
    means: str = "",
    gravity: Sequence[float] | Array = (0.0, 0.0, -1.0),
) -> Task:
    """A task from Tx Ty Tz Rx Ry Rz: any finite values [P]; text is split at spaces and commas.

    Raises:
        TaskError: not six, not numbers or not finite; says which.

    >>> task_from_numbers("1 1 .1 .05 .8 .05").describe()
    'along +X +Y, turning about +Y'
    """
    try:
        items = list(re.split(r"[,\s]+", values.strip(" ,\t\r\n")) if isinstance(values, str) else values)
    except TypeError as error:
        raise TaskError(f"{_SIX}, got {values!r:.80}") from error
    items = [item for item in items if not (isinstance(item, str) and not item)]
    if len(items) != 6:
        raise TaskError(f"{_SIX}, got {len(items)}")
    q = np.zeros(6)
    for i, (item, component) in enumerate(zip(items, COMPONENTS, strict=True)):
        try:
            if isinstance(item, str) and "_" in item:  # Python's own spelling, nobody else's
                raise ValueError
            q[i] = float(item)
        except (TypeError, ValueError, OverflowError) as error:
            raise TaskError(f"{_SIX}; number {i + 1} ({component}) is {item!r:.40}") from error
        if not np.isfinite(q[i]):
            raise TaskError(f"{_SIX}, all finite; number {i + 1} ({component}) is {q[i]}")
    return Task(name=name, q=q, means=means or "The six numbers of Q, as given.", gravity=gravity)


def to_json(task: Task) -> dict[str, Any]:
    """The task as plain numbers, lists and texts; :func:`from_json` gives back the same bits."""
    return {
        "name": task.name,
        "q": task.q.tolist(),
        "displacement": None if task.displacement is None else task.displacement.tolist(),
        "means": task.means,
        "gravity": np.asarray(task.gravity).tolist(),
        "axis": task.axis,
        "primitives": [
            {"kind": step.kind, "axis": np.asarray(step.axis).tolist(), "amount": step.amount}
            for step in task.primitives
        ],
    }


def from_json(data: Mapping[str, Any]) -> Task:
    """The task that :func:`to_json` wrote.

    Raises:
        TaskError: no task, or one that breaks a rule of :class:`Task`.
    """
    if not isinstance(data, Mapping) or not {"name", "q"} <= set(data):
        raise TaskError(f"a stored task has at least name and q, got {data!r:.80}")
    texts = {key: data.get(key, "") for key in ("name", "means", "axis")}
    steps = data.get("primitives", ())
    if not all(isinstance(text, str) for text in texts.values()):
        raise TaskError(f"name, means and axis of a stored task are texts, got {texts!r:.80}")
    if not isinstance(steps, list | tuple) or not all(
        isinstance(step, Mapping) and set(step) == {"kind", "axis", "amount"} for step in steps
    ):
        raise TaskError(f"primitives of a stored task are a list of kind, axis, amount, got {steps!r:.80}")
    return Task(
        q=data["q"],
        displacement=data.get("displacement"),
        gravity=data.get("gravity", (0.0, 0.0, -1.0)),
        primitives=tuple(Primitive(**step) for step in steps),
        **texts,
    )
