"""Shapes as a graphics card takes them: one vertex for each corner normal, sharp edges kept."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..types import Array, IntArray
from .raycast import Shape
from .shading import corner_normals


def indexed(shape: Shape) -> tuple[Array, Array, IntArray]:
    """Vertices (n, 3), their unit normals (n, 3), and triangles (m, 3); sharp corners stand apart.

    Triangles that touch follow each other, so that a corner they share is still at hand for the next one.
    """
    vertices = np.asarray(shape.vertices, dtype=np.float32)
    triangles = np.asarray(shape.triangles, dtype=np.int32)
    normals = corner_normals(vertices, triangles, smooth=shape.smooth).reshape(-1, 3)
    # A corner is its place and its normal's direction, to two degrees: finer than anyone sees.
    key = np.column_stack([triangles.reshape(-1), np.round(normals * 30).astype(np.int64)])
    _, first, to = np.unique(key, axis=0, return_index=True, return_inverse=True)
    corners = vertices[triangles.reshape(-1)[first]]
    order = _near_together(vertices[triangles].mean(axis=1))
    faces = to.reshape(-1, 3).astype(np.int64)[order]
    return corners.astype(np.float64), normals[first].astype(np.float64), faces


def _near_together(points: NDArray[np.float32]) -> IntArray:
    """An order of points (n, 3) in which neighbours follow each other: Morton's curve, 64 cells a side."""
    low, side = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-30)
    cells = (63 * (points - low) / side).astype(np.int64)
    key = np.zeros(len(points), dtype=np.int64)
    for bit in range(6):
        for axis in range(3):
            key |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")


Side = Literal["front", "back", "double"]


def outside(shape: Shape) -> Side:
    """Which side of the triangles can be seen from outside: only one, where they close a volume.

    Points at the same place count as one, as files often give each triangle corners of its own.
    """
    vertices, triangles = shape.vertices, shape.triangles
    _, to = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
    a, b, c = to[triangles].T
    kept = (a != b) & (b != c) & (c != a)
    a, b, c = a[kept], b[kept], c[kept]
    begin, end = np.concatenate([a, b, c]), np.concatenate([b, c, a])
    n = len(vertices)
    # Closed: every edge is walked as often one way as the other.
    if not np.array_equal(np.sort(begin * n + end), np.sort(end * n + begin)):
        return "double"
    p, q, r = (vertices[triangles[:, i]] - vertices[0] for i in range(3))
    return "front" if float(np.einsum("ij,ij->", p, np.cross(q, r))) > 0 else "back"
