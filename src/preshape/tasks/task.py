"""A task: the motion of the object that the hand must produce, Q = [T; R] about the COG (§2.2, eq. 3)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError, TaskError, shown
from ..spatial import checked_pose, vector_from_rotation
from ..types import Array, freeze, frozen_array, one_of, value

# Values of a component of translation and of rotation that is present or absent (§2.2) [P].
TRANSLATION_PRESENT, TRANSLATION_ABSENT = 1.0, 0.1
ROTATION_PRESENT, ROTATION_ABSENT = 0.8, 0.05
# A smaller translation [m] or rotation [rad] counts as a rounding error of a file [C].
NO_MOTION = 1e-6

COMPONENTS = ("Tx", "Ty", "Tz", "Rx", "Ry", "Rz")
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
_SIX = f"a task is six numbers {' '.join(COMPONENTS)}"


def axis_name(text: str) -> str:
    """One of ``+x -x +y -y +z -z`` for text such as ``Z``; a missing sign means plus.

    Raises:
        TaskError: The text names no axis.

    >>> axis_name("Z"), axis_name("-x")
    ('+z', '-x')
    """
    name = text.strip().lower()
    name = f"+{name}" if name in ("x", "y", "z") else name
    if name not in AXES:
        raise TaskError(f"an axis is one of {' '.join(AXES)}, got {shown(text)}")
    return name


def axis_vector(axis: str | ArrayLike) -> Array:
    """(3,) unit vector of a signed axis name or of a vector (3,) that is not zero.

    Raises:
        TaskError: There is no such axis, or the vector is zero or not finite.
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
    if abs(length - 1.0) < 1e-15:  # unit vectors stay bit for bit, so that files round-trip
        return vector
    scaled = vector / largest
    return frozen_array(scaled / np.linalg.norm(scaled), (3,), "axis")


@value
class Primitive:
    """One step of a motion: a translation along an axis, or a rotation about an axis through the COG.

    Attributes:
        kind: ``translate`` or ``rotate``.
        axis: Signed axis name, or vector (3,) in the object's first frame; stored as a unit vector.
        amount: Distance [m] or angle [rad]; negative in the opposite direction.

    Raises:
        TaskError: There is no such kind, the axis has no direction, or the amount is not finite.
    """

    kind: str
    axis: Array | Sequence[float] | str
    amount: float

    def __post_init__(self) -> None:
        try:
            one_of(self.kind, "kind of primitive", ("translate", "rotate"))
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
        name: Name of the family, or ``custom``.
        q: (6,) Q = [T; R] about the COG, dimensionless presences (§2.2).
        displacement: (4, 4) [R t; 0 1] of x' = R(x - c) + c + t, with the COG c [m]; ``None`` for a task from
            numbers or a name.
        means: Description of the task in one or two sentences.
        gravity: (3,) unit direction of gravity in the object's frame; zeros mean none.
        axis: Signed axis of a named task; otherwise empty.
        primitives: Steps of a task that was made from steps.

    Raises:
        TaskError: An array has the wrong shape or is not finite, or the displacement is not rigid.
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
        texts = {name: getattr(self, name) for name in ("name", "means", "axis")}
        if not all(isinstance(text, str) for text in texts.values()):
            raise TaskError(f"name, means and axis of a task must be text, got {shown(texts)}")
        steps = self.primitives
        if not isinstance(steps, list | tuple) or not all(isinstance(step, Primitive) for step in steps):
            raise TaskError(f"primitives of a task must be a list of Primitive, got {shown(steps)}")
        gravity = axis_vector(gravity) if gravity.any() else gravity
        freeze(self, q=q, gravity=gravity, displacement=moved, primitives=tuple(steps))

    @property
    def label(self) -> str:
        """Label for :func:`~preshape.tasks.parse_task`, such as ``push:+x``; the name of a custom task."""
        return f"{self.name}:{self.axis}" if self.axis else self.name

    def describe(self) -> str:
        """Description of the motion, such as ``along +Z, turning about +Z``."""
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
    """(6,) [t; r] of a displacement, scaled so that the largest |t| is 1.0 and the largest |r| is 0.8."""
    t, r = displacement[:3, 3], vector_from_rotation(displacement[:3, :3])
    out = np.zeros(6)
    for part, vector, present in ((out[:3], t, TRANSLATION_PRESENT), (out[3:], r, ROTATION_PRESENT)):
        largest = float(np.abs(vector).max())
        if largest > NO_MOTION:
            part[:] = present * (vector / largest)
    return out


def motion_of(task: Task) -> Array:
    """(6,) proportions [t; r] of the task's motion about the COG.

    For a task with a displacement they are its :func:`proportions`. For six numbers, translations up to ±0.1
    and rotations up to ±0.05 become zero, and the others are taken as proportions [C]. Translations are
    scaled against translations, and rotations against rotations.
    """
    return _present(task.q) if task.displacement is None else proportions(task.displacement)


def task_from_numbers(
    values: Sequence[float] | Array | str,
    *,
    name: str = "custom",
    means: str = "",
    gravity: Sequence[float] | Array = (0.0, 0.0, -1.0),
) -> Task:
    """A task from Tx Ty Tz Rx Ry Rz, any finite values [P]; text is split at spaces and commas.

    Raises:
        TaskError: There are not six values, or one is not a finite number; the message says which.

    >>> task_from_numbers("1 1 .1 .05 .8 .05").describe()
    'along +X +Y, turning about +Y'
    """
    try:
        items = list(re.split(r"[,\s]+", values.strip(" ,\t\r\n")) if isinstance(values, str) else values)
    except TypeError as error:
        raise TaskError(f"{_SIX}, got {shown(values)}") from error
    items = [item for item in items if not (isinstance(item, str) and not item)]
    if len(items) != 6:
        raise TaskError(f"{_SIX}, got {len(items)}")
    q = np.zeros(6)
    for i, (item, component) in enumerate(zip(items, COMPONENTS, strict=True)):
        try:
            # Python reads 1_0 as 10, and NumPy drops an imaginary part; nobody means either.
            if (isinstance(item, str) and "_" in item) or np.iscomplexobj(item):
                raise ValueError
            q[i] = float(item)
        except (TypeError, ValueError, OverflowError) as error:
            raise TaskError(f"{_SIX}; number {i + 1} ({component}) is {shown(item)}") from error
        if not np.isfinite(q[i]):
            raise TaskError(f"{_SIX}, all finite; number {i + 1} ({component}) is {q[i]}")
    return Task(name=name, q=q, means=means or "Six numbers of Q.", gravity=gravity)


def to_json(task: Task) -> dict[str, Any]:
    """The task as plain JSON values; :func:`from_json` restores it bit for bit."""
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
        TaskError: The data are not a task, or break a rule of :class:`Task`.
    """
    if not isinstance(data, Mapping) or not {"name", "q"} <= set(data):
        raise TaskError(f"a stored task must have name and q, got {shown(data)}")
    texts = {key: data.get(key, "") for key in ("name", "means", "axis")}
    steps = data.get("primitives", ())
    if not isinstance(steps, list | tuple) or not all(
        isinstance(step, Mapping) and set(step) == {"kind", "axis", "amount"} for step in steps
    ):
        raise TaskError(
            f"primitives of a stored task must be a list of kind, axis, amount, got {shown(steps)}"
        )
    return Task(
        q=data["q"],
        displacement=data.get("displacement"),
        gravity=data.get("gravity", (0.0, 0.0, -1.0)),
        primitives=tuple(Primitive(**step) for step in steps),
        **texts,
    )
