"""The distance of a wrench from the wrenches that contacts can produce."""

from __future__ import annotations

import numpy as np

from ..types import Array
from .newton import RIMS, finish
from .wrench_space import CROWDED, EXACT, WrenchSpace, project

_ITERATIONS = 100


def distance(space: WrenchSpace, point: Array) -> tuple[float, bool, Array]:
    """The distance of a wrench from a wrench space.

    In each iteration the wrench is projected on a hull of support points inside the space. The support plane
    perpendicular to the residual bounds the distance from below. If the bound is not yet tight, Newton's
    method is tried; if that fails, the support points of this plane are added to the hull.

    Args:
        space: Wrenches that the grasp can produce.
        point: (6,) wrench.

    Returns:
        The distance; whether it is exact to rounding; the (n, d) nearest forces in cone coordinates.
    """
    hull = space.hull
    for _ in range(_ITERATIONS):
        away, weights = project(hull.points, point)
        force = np.tensordot(weights, hull.forces, axes=1)
        size = float(np.sqrt(away @ away))
        if size <= EXACT:
            return size, True, force
        height, points = space.support(away / size)
        # The touching plane perpendicular to the residual bounds the distance from below.
        if size - (float(away @ point) / size - height) <= EXACT:
            return size, True, force
        exact = _polished(space, point, away, force)
        if exact is not None:
            return exact
        if len(hull.points) > CROWDED:
            hull = hull.only(weights > 0.0)
        hull = hull.grown(points)
    return size, False, force


def _polished(
    space: WrenchSpace, point: Array, away: Array, force: Array
) -> tuple[float, bool, Array] | None:
    """The projection by its first-order conditions, Σ wrenches = point - y; ``None`` if that fails."""
    still, rows = -np.eye(6), np.zeros(6)

    def wanted(y: Array, k: float) -> tuple[Array, Array, Array, float, Array, float]:
        return point - y, still, rows, k, rows, 1.0

    for rim in RIMS:
        found = finish(space, force, rim, away, 0.0, wanted)
        if found is None:
            continue
        y, _, forces = found
        size = float(np.sqrt(y @ y))
        # If the plane perpendicular to y touches the space there, no wrench of the space is nearer.
        if size > EXACT and size - (float(y @ point) / size - space.support(y / size)[0]) <= EXACT:
            return size, True, forces
    return None
