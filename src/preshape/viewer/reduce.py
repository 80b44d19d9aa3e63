"""Fewer triangles for the eye: what is sent to a browser; planning always uses the whole mesh."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..exceptions import InputError
from ..types import Array, IntArray

MOST = 20_000
"""Triangles that are sent to a browser at most."""
_FINEST = 512


def reduced(vertices: Array, triangles: IntArray, most: int = MOST) -> tuple[Array, IntArray]:
    """A mesh with at most ``most`` triangles: vertices in one cell of a grid become their mean.

    Args:
        vertices: (n, 3) [m].
        triangles: (m, 3) indices.
        most: triangles wanted at most.

    Returns:
        Vertices and triangles; the given ones where they are few enough.

    Raises:
        InputError: fewer than 100 triangles wanted.
    """
    if most < 100:
        raise InputError(f"a mesh is reduced to 100 triangles or more, got {most}")
    if len(triangles) <= most:
        return vertices, triangles
    low, high = 2, _FINEST
    best = _clustered(vertices, triangles, low)
    while high - low > 1:  # the number of triangles grows with the grid's
        middle = (low + high) // 2
        found = _clustered(vertices, triangles, middle)
        if len(found[1]) <= most:
            low, best = middle, found
        else:
            high = middle
    return best


def _clustered(vertices: Array, triangles: IntArray, cells: int) -> tuple[Array, IntArray]:
    """The mesh on a grid with that many cells along its longest side."""
    low = vertices.min(axis=0)
    step = float(np.ptp(vertices, axis=0).max()) / cells
    place = np.floor((vertices - low) / max(step, 1e-300)).astype(np.int64)
    key = (place[:, 0] * (cells + 1) + place[:, 1]) * (cells + 1) + place[:, 2]
    _, to = np.unique(key, return_inverse=True)
    count = np.bincount(to)
    middle = np.column_stack([np.bincount(to, vertices[:, i]) / count for i in range(3)])
    new = to[triangles]
    a, b, c = new.T
    kept = new[(a != b) & (b != c) & (a != c)]
    return middle, kept[_needed(kept)]


def _needed(triangles: IntArray) -> Any:
    """Rows of the triangles that stay where several have the same corners; what was closed stays closed.

    Thin walls fold onto themselves. Of faces that look the same way as many stay as look that way more often
    than the other; where both are as many, one of each.
    """
    corners = np.sort(triangles, axis=1)
    _, group = np.unique(corners, axis=0, return_inverse=True)
    a, b, c = triangles.T
    way = np.where((a < b).astype(int) + (b < c) + (c < a) == 2, 1, -1)
    more = np.bincount(group, way)
    order = np.lexsort((way, group))
    begins = np.concatenate([[True], np.diff(group[order] * 2 + (way[order] > 0)) != 0])
    starts = np.flatnonzero(begins)
    rank = np.empty(len(triangles), dtype=np.int64)
    rank[order] = np.arange(len(triangles)) - np.repeat(starts, np.diff([*starts, len(triangles)]))
    excess = more[group] * way
    return np.flatnonzero((rank < excess) | ((excess == 0) & (rank == 0)))
