"""Triangles in the form that graphics cards take: one vertex for each corner normal, with sharp edges."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..types import Array, IntArray
from .raycast import Shape
from .shading import corner_normals

Side = Literal["front", "back", "double"]


def indexed(shape: Shape) -> tuple[Array, Array, IntArray]:
    """Split the vertices of a shape where its normals differ.

    Neighbouring triangles are near each other in the order of the result. The graphics card then still has
    their shared vertices in its cache.

    Args:
        shape: The shape.

    Returns:
        Vertices (n, 3) [m], their unit normals (n, 3), and triangles (m, 3) as indices.
    """
    vertices = np.asarray(shape.vertices, dtype=np.float32)
    triangles = np.asarray(shape.triangles, dtype=np.int32)
    normals = corner_normals(vertices, triangles, smooth=shape.smooth).reshape(-1, 3)
    # Corners of a vertex are merged if their normals agree to two degrees; no eye sees the difference.
    key = np.column_stack([triangles.reshape(-1), np.round(normals * 30).astype(np.int64)])
    _, first, new_index = np.unique(key, axis=0, return_index=True, return_inverse=True)
    corners = vertices[triangles.reshape(-1)[first]]
    order = _spatial_order(vertices[triangles].mean(axis=1))
    faces = new_index.reshape(-1, 3).astype(np.int64)[order]
    return corners.astype(np.float64), normals[first].astype(np.float64), faces


def _spatial_order(points: NDArray[np.float32]) -> IntArray:
    """An order of points (n, 3) in which neighbours follow each other: a Morton curve of 64 cells a side."""
    low, side = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-30)
    cells = (63 * (points - low) / side).astype(np.int64)
    key = np.zeros(len(points), dtype=np.int64)
    for bit in range(6):
        for axis in range(3):
            key |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")


def visible_side(shape: Shape) -> Side:
    """The visible side of the triangles: one side if they enclose a volume, otherwise both.

    Vertices at the same position count as one, because in many files every triangle has its own vertices.
    """
    vertices, triangles = shape.vertices, shape.triangles
    _, merged = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
    a, b, c = merged[triangles].T
    proper = (a != b) & (b != c) & (c != a)
    a, b, c = a[proper], b[proper], c[proper]
    start, end = np.concatenate([a, b, c]), np.concatenate([b, c, a])
    n = len(vertices)
    # The surface is closed if every edge is used equally often in both directions.
    if not np.array_equal(np.sort(start * n + end), np.sort(end * n + start)):
        return "double"
    p, q, r = (vertices[triangles[:, i]] - vertices[0] for i in range(3))
    volume = float(np.einsum("ij,ij->", p, np.cross(q, r)))  # six times the signed volume
    return "front" if volume > 0 else "back"
