"""How far a wrench is from those that contacts can produce."""

from __future__ import annotations

import numpy as np

from ..types import Array
from .newton import RIMS, finish
from .wrench_space import CROWDED, EXACT, WrenchSpace, project

_ITERATIONS = 100


def distance(space: WrenchSpace, point: Array) -> tuple[float, bool, Array]:
    """How far a wrench is from the space.

    Args:
        space: the producible wrenches.
        point: (6,).

    Returns:
        The distance; whether it is exact to rounding; the (n, d) forces that come nearest (cone coordinates).
    """
    hull = space.hull
    for _ in range(_ITERATIONS):
        away, weights = project(hull.points, point)
        force = np.tensordot(weights, hull.forces, axes=1)
        size = float(np.sqrt(away @ away))
        if size <= EXACT:
            return size, True, force
        height, points = space.support(away / size)
        # The plane across `away` that touches the space bounds the distance from below.
        if size - (float(away @ point) / size - height) <= EXACT:
            return size, True, force
        exact = _polished(space, point, away, force)
        if exact is not None:
            return exact
        if len(hull.points) > CROWDED:
            hull = hull.kept(weights > 0.0)
        hull = hull.grown(points)
    return size, False, force


def _polished(
    space: WrenchSpace, point: Array, away: Array, force: Array
) -> tuple[float, bool, Array] | None:
    """The projection from its first-order conditions, Σ wrenches = point - y, or none."""
    still, rows = -np.eye(6), np.zeros(6)

    def wanted(y: Array, k: float) -> tuple[Array, Array, Array, float, Array, float]:
        return point - y, still, rows, k, rows, 1.0

    for rim in RIMS:
        found = finish(space, force, rim, away, 0.0, wanted)
        if found is None:
            continue
        y, _, forces = found
        size = float(np.sqrt(y @ y))
        # The plane across y must touch the space: then nothing in it is nearer.
        if size > EXACT and size - (float(y @ point) / size - space.support(y / size)[0]) <= EXACT:
            return size, True, forces
    return None
