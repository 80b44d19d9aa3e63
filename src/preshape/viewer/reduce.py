"""Meshes with fewer triangles, for display in a browser; planning always uses the whole mesh."""

from __future__ import annotations

import numpy as np

from ..exceptions import InputError
from ..types import Array, IntArray

MAX_TRIANGLES = 20_000
"""Largest number of triangles that are sent to a browser."""
_FINEST = 512
"""Largest number of cells along the longest side of the grid."""


def reduced(vertices: Array, triangles: IntArray, most: int = MAX_TRIANGLES) -> tuple[Array, IntArray]:
    """Reduce a mesh by vertex clustering: all vertices in one cell of a grid become their mean.

    Args:
        vertices: (n, 3) Vertices [m].
        triangles: (m, 3) Indices of vertices.
        most: Largest number of triangles of the result.

    Returns:
        Vertices and triangles; the given arrays if they have few enough triangles.

    Raises:
        InputError: ``most`` is less than 100.
    """
    if most < 100:
        raise InputError(f"a mesh can be reduced to 100 triangles or more, got {most}")
    if len(triangles) <= most:
        return vertices, triangles
    # Bisection on the grid's resolution, because a finer grid leaves more triangles.
    low, high = 2, _FINEST
    best = _clustered(vertices, triangles, low)
    while high - low > 1:
        middle = (low + high) // 2
        candidate = _clustered(vertices, triangles, middle)
        if len(candidate[1]) <= most:
            low, best = middle, candidate
        else:
            high = middle
    return best


def _clustered(vertices: Array, triangles: IntArray, cells: int) -> tuple[Array, IntArray]:
    """The mesh clustered on a grid with ``cells`` cells along its longest side."""
    low = vertices.min(axis=0)
    step = float(np.ptp(vertices, axis=0).max()) / cells
    cell = np.floor((vertices - low) / max(step, 1e-300)).astype(np.int64)
    key = (cell[:, 0] * (cells + 1) + cell[:, 1]) * (cells + 1) + cell[:, 2]
    _, cluster = np.unique(key, return_inverse=True)
    count = np.bincount(cluster)
    means = np.column_stack([np.bincount(cluster, vertices[:, i]) / count for i in range(3)])
    faces = cluster[triangles]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (a != c)]
    return means, faces[_without_duplicates(faces)]


def _without_duplicates(triangles: IntArray) -> IntArray:
    """Rows to keep so that a closed surface stays closed although its thin walls have collapsed.

    Triangles with the same three corners form a group, and each faces one of two sides. If a of them face one
    side and b < a the other, a - b rows of the first side are kept; if a = b, one row of each side.
    """
    corners = np.sort(triangles, axis=1)
    _, group = np.unique(corners, axis=0, return_inverse=True)
    a, b, c = triangles.T
    facing = np.where((a < b).astype(int) + (b < c) + (c < a) == 2, 1, -1)
    balance = np.bincount(group, facing)
    order = np.lexsort((facing, group))
    is_start = np.concatenate([[True], np.diff(group[order] * 2 + (facing[order] > 0)) != 0])
    starts = np.flatnonzero(is_start)
    rank = np.empty(len(triangles), dtype=np.int64)  # place of a row among the rows of its group and side
    rank[order] = np.arange(len(triangles)) - np.repeat(starts, np.diff([*starts, len(triangles)]))
    excess = balance[group] * facing
    return np.flatnonzero((rank < excess) | ((excess == 0) & (rank == 0)))
