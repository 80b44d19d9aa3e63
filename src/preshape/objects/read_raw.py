"""The result of every reader: positions, triangles, the counts of the file, and the names of its groups."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..types import Array, BoolArray, IntArray, value
from . import checks

MOST_GROUPS = 500
"""Number of names of groups that are kept of one file; a person has no use for more."""


@value
class RawMesh:
    """The checked content of a file, in its unit.

    Attributes:
        vertices: (n, 3) positions.
        triangles: (m, 3) indices into ``vertices``.
        normals: Number of vertex normals.
        faces: Number of polygons before they were cut into triangles.
        groups: Name of each group, object and material of the file, and the indices of its triangles.
    """

    vertices: Array
    triangles: IntArray
    normals: int
    faces: int
    groups: tuple[tuple[str, IntArray], ...] = ()

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Vertices, vertex normals, faces, triangles (table 2)."""
        return len(self.vertices), self.normals, self.faces, len(self.triangles)


def assemble(
    name: str,
    vertices: Array,
    corners: IntArray,
    sizes: IntArray,
    *,
    normals: int = 0,
    first: int = 0,
    written: IntArray | None = None,
    runs: Iterable[tuple[str, int, int]] = (),
) -> RawMesh:
    """Check the content of a file and cut its polygons into triangles.

    Args:
        name: Name of the file, for messages.
        vertices: (n, 3) positions.
        corners: Vertex indices counted from 0, one polygon after another.
        sizes: (faces,) number of corners of each polygon.
        normals: Number of vertex normals in the file; 0 counts one for each vertex.
        first: Number that the format gives to the first vertex, for messages.
        written: Indices as the file writes them, for messages.
        runs: Name of a group, its first face and the face after its last; a name may occur several times.

    Raises:
        ObjectError: There are no faces, a position is not finite, an index is out of range, or a face has
            fewer than three corners.
    """
    checks.has_faces(name, len(vertices), len(sizes))
    checks.finite(name, vertices, first)
    checks.enough_corners(name, sizes)
    checks.in_range(name, corners, sizes, len(vertices), first, written)
    triangles, faces = triangulate(vertices, corners, sizes)
    return RawMesh(
        vertices=vertices,
        triangles=triangles,
        normals=normals or len(vertices),
        faces=len(sizes),
        groups=_groups(runs, faces),
    )


def _groups(runs: Iterable[tuple[str, int, int]], faces: IntArray) -> tuple[tuple[str, IntArray], ...]:
    """The triangles of each group, from runs of faces and the (m,) face of each triangle in rising order."""
    found: dict[str, list[IntArray]] = {}
    for name, first, after in runs:
        if name and first < after and (name in found or len(found) < MOST_GROUPS):
            low, high = np.searchsorted(faces, [first, after])
            found.setdefault(name, []).append(np.arange(low, high))
    return tuple((name, np.concatenate(own)) for name, own in found.items())


def triangulate(vertices: Array, corners: IntArray, sizes: IntArray) -> tuple[IntArray, IntArray]:
    """Cut polygons, also concave ones, into triangles in the order of the file.

    Args:
        vertices: (n, 3) finite positions.
        corners: Valid vertex indices, one polygon after another.
        sizes: (faces,) number of corners of each polygon, 3 or more.

    Returns:
        (m, 3) indices with the orientation of their polygons, and (m,) the polygon of each, in rising order.
    """
    if (sizes == 3).all():
        return corners.reshape(-1, 3), np.arange(len(sizes))
    starts = np.cumsum(sizes) - sizes
    pieces: list[IntArray] = []
    owners: list[IntArray] = []
    for size in np.unique(sizes):
        faces = np.flatnonzero(sizes == size)
        polygons = corners[starts[faces][:, None] + np.arange(size)]
        fan, simple = _fan(vertices, polygons)
        pieces.append(fan[simple].reshape(-1, 3))
        owners.append(np.repeat(faces[simple], size - 2))
        for face, polygon in zip(faces[~simple], polygons[~simple], strict=True):
            cut = _ears(vertices, polygon)
            pieces.append(cut)
            owners.append(np.full(len(cut), face))
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(pieces)[order], owner[order]


def _fan(vertices: Array, polygons: IntArray) -> tuple[IntArray, BoolArray]:
    """(k, n - 2, 3) fans of (k, n) polygons from their first corners, and (k,) whether each fan is valid."""
    count = polygons.shape[1]
    fan = np.empty((len(polygons), count - 2, 3), dtype=np.int64)
    fan[:, :, 0] = polygons[:, :1]
    fan[:, :, 1] = polygons[:, 1:-1]
    fan[:, :, 2] = polygons[:, 2:]
    a, b, c = (vertices[fan[:, :, k]] for k in range(3))
    with np.errstate(all="ignore"):
        crosses = np.cross(b - a, c - a)
        total = crosses.sum(axis=1, keepdims=True)  # Newell's normal, times twice the area
        return fan, ((crosses * total).sum(axis=2) > 0).all(axis=1)


def _ears(vertices: Array, polygon: IntArray) -> IntArray:
    """Cut one polygon by ear clipping in the plane across its normal, or as a fan if it has no area."""
    import mapbox_earcut

    fan = np.stack([np.full(len(polygon) - 2, polygon[0]), polygon[1:-1], polygon[2:]], axis=1)
    points = vertices[polygon] - vertices[polygon[0]]
    size = np.abs(points).max()
    if not (np.isfinite(size) and size > 0):
        return fan
    points = points / size
    normal = np.cross(points[1:-1], points[2:]).sum(axis=0)
    length = np.linalg.norm(normal)
    if length < 1e-12:
        return fan
    # Dropping the axis nearest to the normal keeps the polygon simple and needs no basis.
    axis = int(np.abs(normal).argmax())
    flat = np.ascontiguousarray(points[:, [(axis + 1) % 3, (axis + 2) % 3]])
    cut = np.asarray(
        mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], dtype=np.uint32)), dtype=np.int64
    ).reshape(-1, 3)
    if not len(cut):
        return fan
    a, b, c = (flat[cut[:, k]] for k in range(3))
    turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    backwards = turn * normal[axis] < 0
    cut[backwards] = cut[backwards][:, ::-1]
    return polygon[cut]


def merge_equal(vertices: Array, triangles: IntArray) -> tuple[Array, IntArray]:
    """Merge vertices with exactly equal positions."""
    unique, inverse = group_rows(vertices + 0.0)  # -0 becomes 0
    return vertices[unique] + 0.0, inverse[triangles]


def group_rows(rows: NDArray[np.float64 | np.float32] | NDArray[np.int64]) -> tuple[IntArray, IntArray]:
    """Group equal rows of three numbers of 4 or 8 bytes.

    Returns:
        (k,) index of the first row of each group, in order of appearance, and (n,) group of each row.
    """
    bits = np.ascontiguousarray(rows).view(f"u{rows.dtype.itemsize}")
    key = np.zeros(len(rows), dtype=np.uint64)
    for column in bits.T:
        key = (key ^ column) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    order = np.argsort(key)
    ordered = key[order]
    if (ordered[1:] != ordered[:-1]).all():
        every = np.arange(len(rows))
        return every, every
    differs = _changes(bits, order)
    if (differs & (ordered[1:] == ordered[:-1])).any():  # two different rows share a key: sort the rows
        order = np.lexsort(bits.T)
        differs = _changes(bits, order)
    new = np.concatenate([[True], differs])
    group = np.empty(len(rows), dtype=np.int64)
    group[order] = np.cumsum(new) - 1
    heads = np.minimum.reduceat(order, np.flatnonzero(new))
    ranks = np.argsort(heads)
    place = np.empty(len(heads), dtype=np.int64)
    place[ranks] = np.arange(len(heads))
    return heads[ranks], place[group]


def _changes(bits: NDArray[Any], order: IntArray) -> BoolArray:
    """(n - 1,) whether each row differs from the row before it, in the given order."""
    ordered = bits[order].T
    x, y, z = (column[1:] != column[:-1] for column in ordered)
    changes: BoolArray = x | y | z
    return changes
