"""Shapes as a graphics card takes them: one vertex for each corner normal, sharp edges kept."""

from __future__ import annotations

import numpy as np

from ..types import Array, IntArray
from .raycast import Shape
from .shading import corner_normals


def indexed(shape: Shape) -> tuple[Array, Array, IntArray]:
    """Vertices (n, 3), their unit normals (n, 3), and triangles (m, 3); sharp corners stand apart."""
    vertices = np.asarray(shape.vertices, dtype=np.float32)
    triangles = np.asarray(shape.triangles, dtype=np.int32)
    normals = corner_normals(vertices, triangles, smooth=shape.smooth).reshape(-1, 3)
    # A corner is its place and its normal's direction, to two degrees: finer than anyone sees.
    key = np.column_stack([triangles.reshape(-1), np.round(normals * 30).astype(np.int64)])
    _, first, to = np.unique(key, axis=0, return_index=True, return_inverse=True)
    corners = vertices[triangles.reshape(-1)[first]]
    return corners.astype(np.float64), normals[first].astype(np.float64), to.reshape(-1, 3).astype(np.int64)
