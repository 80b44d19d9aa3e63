"""Checks that a mesh can be grasped; each message is one sentence that says what to change."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..exceptions import InputError, ObjectError, shown
from ..types import Array, BoolArray, IntArray, positive_number

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "inch": 0.0254}
"""Length of each unit of a file [m]."""

SMALLEST, LARGEST = 1e-4, 10.0
"""Accepted range of the largest extent [m]; outside it the unit is certainly wrong [C]."""

FLATNESS = 1e-6
"""Least ratio of smallest to largest extent of a solid body [C]."""

GRASPABLE = 0.005, 0.3
"""Largest extents of objects that hands grasp [m], for choosing a unit that fits [C]."""

BLUR = 2e-4
"""Largest accepted spacing of single-precision positions, as a share of the largest extent [C]."""

SLIVER = 1e-12
"""Height below which a triangle counts as having no area, as a share of the largest extent [C]."""


def metres(unit: str, scale: float) -> float:
    """Factor from the numbers of a file to metres.

    Raises:
        InputError: The unit is unknown, or the scale is not a positive, finite number.
    """
    if not isinstance(unit, str) or unit not in UNITS:
        raise InputError(f"unknown unit {shown(unit)}; known: {', '.join(UNITS)}")
    return UNITS[unit] * positive_number(scale, "scale")


def has_faces(name: str, vertices: int, faces: int) -> None:
    """Refuse an empty mesh and a point cloud."""
    if not vertices:
        raise ObjectError(f"{name}: found no vertices; expected a mesh of vertices and faces")
    if not faces:
        raise ObjectError(
            f"{name}: found {vertices} vertices but no faces: this is a point cloud; "
            "give a surface mesh, or the points as PLY, PCD, XYZ or NPY"
        )


def finite(name: str, vertices: NDArray[np.floating[Any]], first: int) -> None:
    """Refuse positions that are NaN or infinite; ``first`` is the number that the format starts at."""
    if not np.isfinite(vertices).all():
        bad = ~np.isfinite(vertices).all(axis=1)
        index = int(bad.argmax())
        raise ObjectError(
            f"{name}: {bad.sum()} of {len(vertices)} vertices are not finite, the first is vertex "
            f"{index + first} at {vertices[index]}; repair or re-export the mesh"
        )


def enough_corners(name: str, sizes: IntArray) -> None:
    """Refuse faces that are points or lines."""
    bad = sizes < 3
    if bad.any():
        index = int(bad.argmax())
        raise ObjectError(
            f"{name}: face {index + 1} of {len(sizes)} has {sizes[index]} corners, a face needs 3 or more; "
            "the file is damaged or cut short"
        )


def in_range(
    name: str, corners: IntArray, sizes: IntArray, count: int, first: int, written: IntArray | None
) -> None:
    """Refuse faces with vertices that do not exist."""
    bad = (corners < 0) | (corners >= count)
    if bad.any():
        index = int(bad.argmax())
        face = int(np.searchsorted(np.cumsum(sizes), index, side="right"))
        vertex = corners[index] + first if written is None else written[index]
        raise ObjectError(
            f"{name}: face {face + 1} of {len(sizes)} refers to vertex {vertex}, the file has vertices "
            f"{first} to {count - 1 + first}; the file is damaged or cut short"
        )


def solid_triangles(name: str, vertices: Array, triangles: IntArray, unit: str = "m") -> BoolArray:
    """(m,) whether each triangle has area.

    Args:
        name: Name of the file, for messages.
        vertices: (n, 3) finite positions [m].
        triangles: (m, 3) valid indices, at least one.
        unit: Unit in which the file was read, for messages.

    Raises:
        ObjectError: No triangle has area, the size is not plausible in metres, or the object is too far from
            the origin.
    """
    # One array for each coordinate of each corner is several times faster than (m, 3, 3) for a million.
    corners = [[np.ascontiguousarray(axis)[column] for axis in vertices.T] for column in triangles.T]
    low = np.array([min(corner[axis].min() for corner in corners) for axis in range(3)])
    high = np.array([max(corner[axis].max() for corner in corners) for axis in range(3)])
    with np.errstate(over="ignore"):
        extents = high - low
    largest = float(extents.max())
    empty = f"{name}: all {len(triangles)} triangles have zero area; give a surface mesh"
    if largest == 0:
        raise ObjectError(empty)
    size(name, extents, unit)
    place(name, low, high)
    a, b, c = corners
    u = [q - p for p, q in zip(a, b, strict=True)]
    v = [q - p for p, q in zip(a, c, strict=True)]
    w = [q - p for p, q in zip(b, c, strict=True)]
    longest = np.sqrt(np.maximum(np.maximum(_dot(u, u), _dot(v, v)), _dot(w, w)))
    cross = [u[i] * v[j] - u[j] * v[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    solid = np.sqrt(_dot(cross, cross)) > SLIVER * largest * longest
    if not solid.any():
        raise ObjectError(empty)
    return np.asarray(solid)


def _dot(a: list[Array], b: list[Array]) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def size(name: str, extents: Array, unit: str = "m") -> None:
    """Refuse a size that is not plausible, and name the units in which a hand could grasp the object.

    Args:
        name: Name of the file, for messages.
        extents: (3,) size as it was read [m].
        unit: Unit in which the file was read.

    Raises:
        ObjectError: The largest extent is under 0.1 mm or over 10 m.
    """
    if not SMALLEST <= float(extents.max()) <= LARGEST:
        sizes = " × ".join(f"{extent:.3g}" for extent in extents)
        fitting = other_units(extents, unit) or (
            "give the file's unit (such as --unit mm) or a factor (--scale)"
        )
        raise ObjectError(
            f"{name}: the object is {sizes} m, its largest extent must lie between {SMALLEST:g} and "
            f"{LARGEST:g} m; {fitting}"
        )


def other_units(extents: Array, unit: str, least: float = GRASPABLE[0], most: float = GRASPABLE[1]) -> str:
    """The units in which an object of absurd size would have a size that a hand can grasp.

    A file that is too small may also have been scaled twice: its factors are the reverse of those units. No
    factor is named for the only reason that the object would then fit the hand.

    Args:
        extents: (3,) size as it was read [m].
        unit: Unit in which the file was read.
        least: Least plausible largest extent [m].
        most: Largest plausible extent [m].

    Returns:
        A sentence fragment such as ``--unit mm makes it 4 × 4 × 9 mm``; empty if no unit fits.

    >>> other_units(np.array([2.4, 2.4, 4.7]), "m")
    'check the unit of the file: --unit cm makes it 24 × 24 × 47 mm, --unit in makes it 61 × 61 × 119 mm'
    """
    tried = [(f"--unit {other}", UNITS[other] / UNITS[unit]) for other in ("mm", "cm", "in", "m")]
    tried += [(f"--scale {1 / UNITS[other]:.6g}", 1 / UNITS[other]) for other in ("mm", "cm", "in")]
    words = []
    for option, factor in tried:
        made = factor * extents
        if factor != 1 and least <= made.max() <= most:
            words.append(f"{option} makes it {in_millimetres(made)}")
    return f"check the unit of the file: {', '.join(words)}" if words else ""


def in_millimetres(extents: Array) -> str:
    """A size for messages.

    >>> in_millimetres(np.array([0.004, 0.0605, 1.0]))
    '4 × 60.5 × 1000 mm'
    """
    return " × ".join(f"{float(f'{1000 * extent:.3g}'):.10g}" for extent in extents) + " mm"


def place(name: str, low: Array, high: Array) -> None:
    """Refuse an object so far from the origin that single precision blurs it, as with UTM coordinates.

    Args:
        name: Name of the file, for messages.
        low: (3,) lower corner of its bounding box [m].
        high: (3,) upper corner of its bounding box [m].

    Raises:
        ObjectError: The spacing of single-precision numbers at the object exceeds ``BLUR`` of its size.
    """
    largest, far = float((high - low).max()), float(np.maximum(np.abs(low), np.abs(high)).max())
    if far * 2.0**-23 > BLUR * largest:
        middle = " ".join(f"{x:.10g}" for x in (low + high) / 2)
        raise ObjectError(
            f"{name}: the object lies at {middle} m, so far from the origin that its {largest:.3g} m cannot "
            "be resolved (map coordinates?); subtract this position from all vertices"
        )


def body(name: str, extents: Array) -> None:
    """Refuse a flat mesh.

    Raises:
        ObjectError: One extent is almost zero.
    """
    if extents.min() < FLATNESS * extents.max():
        axis = "xyz"[int(extents.argmin())]
        size = " × ".join(f"{extent:.3g}" for extent in extents)
        raise ObjectError(
            f"{name}: the mesh is flat, {size} m with no thickness along {axis}; "
            "give a solid body, not a sheet"
        )
