"""The twelve approach planes (fig. 4).

An approach plane is a signed approach axis a and an opposition axis o; the transverse axis is
t = a × o. "Approach +X" means that the hand moves along +X towards the object.
"""

from __future__ import annotations

import numpy as np

from ..exceptions import InputError, shown
from ..types import Array, BoolArray, frozen_array, read_only, value

AXIS_NAMES = ("+x", "-x", "+y", "-y", "+z", "-z")


@value
class ApproachPlane:
    """One of the twelve approach planes.

    Attributes:
        index: Number of the plane, 1..12.
        approach_axis: (3,) signed unit vector a, along which the hand moves.
        opposition_axis: (3,) unit vector o; thumb and fingers oppose each other along it.
    """

    index: int
    approach_axis: Array
    opposition_axis: Array

    @property
    def transverse_axis(self) -> Array:
        """(3,) t = a × o, signed."""
        a, o = self.approach_axis, self.opposition_axis
        return a[[1, 2, 0]] * o[[2, 0, 1]] - a[[2, 0, 1]] * o[[1, 2, 0]]

    @property
    def label(self) -> str:
        """Short name for messages.

        >>> plane(5).label
        'plane 5: approach +X, opposition Y'
        """
        o = axis_name(self.opposition_axis)[1].upper()
        return f"plane {self.index}: approach {axis_name(self.approach_axis).upper()}, opposition {o}"


def axis_name(axis: Array) -> str:
    """Name, ``+x`` … ``-z``, of a signed unit vector along a coordinate axis."""
    i = int(np.argmax(np.abs(axis)))
    return ("+" if axis[i] > 0 else "-") + "xyz"[i]


def axis_vector(name: str) -> Array:
    """(3,) signed unit vector of a name ``+x`` … ``-z``.

    Raises:
        InputError: The name is not one of the six.
    """
    if name.lower() not in AXIS_NAMES:
        raise InputError(f"an axis must be one of {', '.join(AXIS_NAMES)}, got {shown(name)}")
    vector = np.zeros(3)
    vector["xyz".index(name[1].lower())] = 1.0 if name[0] == "+" else -1.0
    return vector


# The paper's text fixes planes 1, 5, 6 and 7, its tasks 9 and 10; 11 is doubtful, the rest is ours [R].
_TABLE = ("-xy", "-xz", "-zy", "-yz", "+xy", "+yx", "+zy", "+yz", "+xz", "+zx", "-yx", "-zx")

PLANES: tuple[ApproachPlane, ...] = tuple(
    ApproachPlane(
        index=i,
        approach_axis=frozen_array(axis_vector(code[:2]), (3,), "a"),
        opposition_axis=frozen_array(axis_vector("+" + code[2]), (3,), "o"),
    )
    for i, code in enumerate(_TABLE, start=1)
)

APPROACH_AXES: Array = read_only(np.array([p.approach_axis for p in PLANES]))
OPPOSITION_AXES: Array = read_only(np.array([p.opposition_axis for p in PLANES]))
TRANSVERSE_AXES: Array = read_only(np.array([p.transverse_axis for p in PLANES]))


def plane(index: int) -> ApproachPlane:
    """The approach plane with an index.

    Raises:
        InputError: The index is not 1..12.
    """
    if not 1 <= index <= 12:
        raise InputError(f"an approach plane index must be 1 to 12, got {index}")
    return PLANES[index - 1]


def allowed_planes(approaches: str | None) -> BoolArray:
    """Which planes have an allowed approach axis.

    Args:
        approaches: Comma-separated signed axes, as ``+z,-x``; ``None`` allows all.

    Returns:
        (12,) booleans, in the order of :data:`PLANES`.

    Raises:
        InputError: A name is not an axis, or there is no name.

    >>> [p.index for p, ok in zip(PLANES, allowed_planes("+z,-x")) if ok]
    [1, 2, 7, 10]
    """
    if approaches is None:
        return np.ones(12, dtype=bool)
    names = [name.strip() for name in approaches.split(",") if name.strip()]
    if not names:
        raise InputError(f"approaches must be axes such as +z,-x, got {shown(approaches)}")
    wanted = np.array([axis_vector(name) for name in names])
    return (APPROACH_AXES @ wanted.T > 0.5).any(axis=1)
