"""A closed surface from a function on a grid, and the triangles of it that were seen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...types import Array, BoolArray, IntArray, freeze, frozen_array, value
from .cleaning import nearest

CELLS = 72
"""Nodes along the longest side of the grid [C]."""
SMOOTH = 0.7
"""Standard deviation of the smoothing of the function, in cells [C]."""
SEEN_SPACINGS = 1.5
"""A triangle counts as seen if its centre is within this many spacings (of points or grid) of a point [C]."""


@value
class Grid:
    """The nodes of a grid of cubes.

    Attributes:
        origin: (3,) position of the first node [m].
        spacing: Edge of a cell [m].
        shape: Number of nodes along each axis.
    """

    origin: Array
    spacing: float
    shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        freeze(self, origin=frozen_array(self.origin, (3,), "grid origin"))

    @property
    def nodes(self) -> Array:
        """(n, 3) positions of all nodes, the last axis fastest [m]."""
        steps = np.stack(np.meshgrid(*map(np.arange, self.shape), indexing="ij"), axis=-1)
        return self.origin + self.spacing * steps.reshape(-1, 3).astype(np.float64)


def grid_round(points: Array, *, cells: int = CELLS, margin: int = 3) -> Grid:
    """A grid around points, with a margin.

    Args:
        points: (n, 3) points [m].
        cells: Nodes along the longest side.
        margin: Cells of the margin on every side.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    spacing = float((high - low).max()) / (cells - 1 - 2 * margin)
    nodes = np.ceil((high - low) / spacing).astype(int) + 1 + 2 * margin
    return Grid(
        origin=(low + high) / 2 - spacing * (nodes - 1) / 2,
        spacing=spacing,
        shape=(int(nodes[0]), int(nodes[1]), int(nodes[2])),
    )


def zero_surface(function: Callable[[Array], Array], grid: Grid) -> tuple[Array, IntArray]:
    """The largest part of the zero surface of a function, as triangles that face outward (right-hand rule).

    Args:
        function: Maps (n, 3) points to (n,) values, negative inside.
        grid: Grid on which the function is evaluated.

    Returns:
        (v, 3) vertices [m] and (t, 3) triangles, both empty if no node is inside.
    """
    return zero_of_values(function(grid.nodes).reshape(grid.shape), grid)


def zero_of_values(values: Array, grid: Grid) -> tuple[Array, IntArray]:
    """:func:`zero_surface` from the values of the function at the nodes."""
    from scipy.ndimage import gaussian_filter, label
    from skimage.measure import marching_cubes

    near = 4 * grid.spacing
    smooth = gaussian_filter(np.clip(values, -near, near), SMOOTH)
    # The rim of the grid is set to outside, so that a body that reaches the rim is closed there.
    for axis in range(3):
        for side in (0, -1):
            rim = np.moveaxis(smooth, axis, 0)[side]
            np.maximum(rim, 0.5 * grid.spacing, out=rim)
    parts, count = label(smooth < 0)
    if count == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    if count > 1:
        largest = 1 + int(np.bincount(parts.ravel())[1:].argmax())
        smooth = np.where((parts > 0) & (parts != largest), 0.5 * grid.spacing, smooth)
    vertices, triangles, _, _ = marching_cubes(smooth, 0.0, gradient_direction="descent")  # type: ignore[no-untyped-call]
    found: IntArray = triangles.astype(np.int64)
    return grid.origin + grid.spacing * vertices.astype(np.float64), found


def seen_triangles(vertices: Array, triangles: IntArray, points: Array, reach: float) -> BoolArray:
    """(t,) whether a point of the cloud is within reach of the centre of each triangle.

    Args:
        vertices: (v, 3) positions [m].
        triangles: (t, 3) vertex indices.
        points: (n, 3) points of the cloud [m].
        reach: Largest distance [m].
    """
    away, _ = nearest(points, 2, vertices[triangles].mean(axis=1))
    seen: BoolArray = away[:, 0] <= reach
    return seen
