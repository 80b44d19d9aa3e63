"""A table in a point cloud: the plane that an object stands on, found and cut off.

Random planes through three points are compared by the number of points near them (Fischler and Bolles 1981,
Random sample consensus). A plane with many points is a table if it extends beyond the rest on all sides and
the rest stands on one side of it; so the flat side of a box is none.
"""

from __future__ import annotations

import numpy as np

from ...types import Array, BoolArray, freeze, frozen_array, value
from .cleaning import LEAST

SHARE = 0.4
"""Least share of the points on a table [C]."""
DRAWS, SAMPLED = 300, 3000
"""Number of random planes, and number of points that they are compared by [C]."""
NEAR, NOISES = 0.01, 4.0
"""Largest distance of the table's points from a random plane, as a share of the cloud's extent, and from the
fitted plane, in standard deviations of its points [C]."""
WIDER, LARGER = 1.25, 2.0
"""Least ratio of the table's sides to those of what stands on it, and of their areas [C]."""
ONE_SIDE = 0.8
"""Least share of the points off the plane that lie on the object's side [C]."""
OUTER = 2.0
"""Share of the points that is left out at each end of a side, because it may be stray [%] [C]."""


@value
class TablePlane:
    """A plane with most of the points of a cloud, and an object on it.

    Attributes:
        share: Share of the points that lie on the plane.
        sides: (2,) sides of the rectangle that they fill [m].
        above: (n,) whether each point of the cloud belongs to what stands on the table.
        plane: (4,) unit normal, towards the object, and offset d of the plane n·x = d [m].
    """

    share: float
    sides: Array
    above: BoolArray
    plane: Array

    def __post_init__(self) -> None:
        freeze(self, plane=frozen_array(self.plane, (4,), "plane of the table"))
        freeze(self, sides=frozen_array(self.sides, (2,), "sides of the table"))


def find_table(points: Array, seed: int = 0) -> TablePlane | None:
    """The table in a cloud; ``None`` if there is none.

    1. Draw planes through three points each, and take the one near most of a sample of the points.
    2. Fit a plane to the points near it, twice, and measure their noise.
    3. Compare the rectangle of the points on the plane with that of the points on its fuller side.

    Args:
        points: (n, 3) finite points [m].
        seed: Seed of the draws.
    """
    rng = np.random.default_rng(seed)
    low, high = np.percentile(points, [OUTER, 100 - OUTER], axis=0)
    near = NEAR * float((high - low).max())
    sample = points[rng.permutation(len(points))[:SAMPLED]]
    if len(points) < LEAST or near <= 0.0:
        return None
    # 1. Draws
    first, normals = random_planes(sample, DRAWS, rng)
    counts = (np.abs(sample @ normals.T - np.einsum("ij,ij->i", normals, first)) < near).sum(axis=0)
    best = int(counts.argmax())
    # 2. Fits
    if (np.abs((points - first[best]) @ normals[best]) < near).mean() < SHARE:
        return None
    middle, axes, near = fitted(points, first[best], normals[best], near)
    heights = (points - middle) @ axes[-1]
    # 3. What stands on it
    on = np.abs(heights) < near
    side = 1.0 if (heights > near).sum() >= (heights < -near).sum() else -1.0
    above = side * heights > near
    if above.sum() < max(LEAST, ONE_SIDE * np.logical_not(on).sum()) or on.mean() < SHARE:
        return None
    flat = (points - middle) @ axes[:2].T
    table, rest = (np.percentile(flat[which], [OUTER, 100 - OUTER], axis=0) for which in (on, above))
    ratios = np.ptp(table, axis=0) / np.maximum(np.ptp(rest, axis=0), near)
    inside = bool((rest[0] > table[0]).all() and (rest[1] < table[1]).all())
    if not inside or ratios.min() < WIDER or ratios.prod() < LARGER:
        return None
    normal = side * axes[-1]
    return TablePlane(
        share=float(on.mean()),
        sides=np.ptp(table, axis=0),
        above=above,
        plane=np.append(normal, middle @ normal),
    )


def random_planes(points: Array, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Planes through three random points each: a point (count, 3) [m] and the unit normal (count, 3)."""
    first, second, third = points[rng.integers(len(points), size=(3, count))]
    normals = np.cross(second - first, third - first)
    return first, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def fitted(points: Array, middle: Array, normal: Array, near: float) -> tuple[Array, Array, float]:
    """A plane fitted, twice, to the points near it.

    Args:
        points: (n, 3) [m].
        middle: (3,) a point of the first plane [m].
        normal: (3,) its unit normal.
        near: Largest distance of the plane's points from it [m]; some of them are.

    Returns:
        (3,) a point of the fitted plane [m]; (3, 3) its axes in rows, the longest first and the normal last;
        and the largest distance of its points from it [m], by their noise.
    """
    axes = normal[None]
    for _ in range(2):
        on = np.abs((points - middle) @ axes[-1]) < near
        middle = points[on].mean(axis=0)
        axes = np.linalg.eigh(np.cov(points[on].T))[1].T[::-1]
        heights = (points - middle) @ axes[-1]
        near = min(near, NOISES * 1.4826 * float(np.median(np.abs(heights[on]))) + 1e-3 * near)
    return middle, axes, near
