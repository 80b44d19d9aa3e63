"""Points of one object, fit to be made a surface: without stray ones, evenly thinned, in one piece."""

from __future__ import annotations

import numpy as np

from ...exceptions import ObjectError
from ...types import Array, IntArray, read_only

LEAST = 100
"""Points that a cloud must have [C]."""
MOST = 200_000
"""Points that are looked at; more are thinned to every n-th first [C]."""
CELLS = 110
"""Cells along the cloud's longest side that points are averaged in [C]."""
NEIGHBOURS = 8
SMOOTHED = 24
"""Neighbours of the plane that a point is moved to [C]."""
STRAY = 4.0
"""A point whose neighbours are this many times farther than the median's is stray [C]."""
GAP, GAP_SPACINGS = 0.15, 8.0
"""Parts farther apart than both, in the cloud's extent and in spacings, are two things [C]."""
SHALLOW = 0.25
"""Gaps along the sight count this much [C]."""
CRUMB = 0.05
"""Parts with a smaller share of the points are left out [C]."""
FLAT, FLAT_NOISE = 0.005, 2.5
"""Points are on a plane if their rms distance to it is under either, in extents or in local roughness [C]."""


def cleaned(name: str, points: Array, camera: Array | None = None) -> Array:
    """Points without stray ones, averaged in cells, of one connected thing.

    Args:
        name: the file, for messages.
        points: (n, 3) finite positions [m].
        camera: (3,) where they were seen from [m]; a part in front hides what joins it to the others, so
            that gaps along the sight count less.

    Returns:
        (m, 3) positions [m].

    Raises:
        ObjectError: too few points, two things, or all points on a plane.
    """
    check_enough(name, len(points), "points")
    kept = np.unique(points[:: -(-len(points) // MOST)], axis=0)
    check_enough(name, len(kept), "different points")
    kept = _without_strays(kept)
    kept = _averaged(kept, float(np.ptp(kept, axis=0).max()) / CELLS)
    kept = _one_thing(name, kept, camera)
    check_enough(name, len(kept), "points that belong together")
    _not_on_a_plane(name, kept)
    return read_only(_smooth(kept))


def nearest(points: Array, count: int, at: Array | None = None) -> tuple[Array, IntArray]:
    """Distances [m] to and indices of the nearest points, nearest first.

    Args:
        points: (n, 3) or (n, 2).
        count: of neighbours, 2 or more.
        at: (m, ...) where; ``None`` for the points themselves, each of which is its own first neighbour.

    Returns:
        (m, count) both.
    """
    from scipy.spatial import cKDTree

    away, index = cKDTree(points).query(points if at is None else at, k=count)
    return np.asarray(away, dtype=np.float64), np.asarray(index, dtype=np.int64)


def spacing_of(points: Array) -> float:
    """Median distance of a point to its fourth neighbour [m]: a cell's edge where points fill a grid."""
    return float(np.median(nearest(points, 5)[0][:, 4]))


def check_enough(name: str, count: int, what: str) -> None:
    """Refuse fewer points than ``LEAST``.

    Raises:
        ObjectError: saying how many of what were found in the file.
    """
    if count < LEAST:
        raise ObjectError(
            f"{name}: a point cloud needs {LEAST} points at least, found {count} {what}; "
            "scan nearer or with more pixels"
        )


def _without_strays(points: Array) -> Array:
    distance, _ = nearest(points, NEIGHBOURS + 1)
    mean = distance[:, 1:].mean(axis=1)
    kept: Array = points[mean <= STRAY * np.median(mean)]
    return kept


def _averaged(points: Array, cell: float) -> Array:
    """The mean of the points of each cell: thinner, and less noisy."""
    place = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    _, label, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    sums = [np.bincount(label.ravel(), weights=column) for column in points.T]
    means: Array = np.stack(sums, axis=1) / count[:, None]
    return means


def _smooth(points: Array) -> Array:
    """Each point moved to the plane through its neighbours, weighted by nearness: noise becomes less."""
    away, near = nearest(points, SMOOTHED)
    weight = np.exp(-0.5 * (away / away[:, -1:] * 2.0) ** 2)
    weight /= weight.sum(axis=1, keepdims=True)
    middle = np.einsum("nk,nki->ni", weight, points[near])
    arms = points[near] - middle[:, None]
    spread = np.einsum("nk,nki,nkj->nij", weight, arms, arms)
    normal = np.linalg.eigh(spread)[1][:, :, 0]
    off = np.einsum("ni,ni->n", normal, points - middle)
    moved: Array = points - off[:, None] * normal
    return moved


def _one_thing(name: str, points: Array, camera: Array | None) -> Array:
    part = _parts(points if camera is None else _shallow(points, camera))
    sizes = np.bincount(part)
    order = np.argsort(-sizes, kind="stable")
    if len(order) > 1 and sizes[order[1]] >= CRUMB * len(points):
        first, second = (points[part == k] for k in order[:2])
        raise ObjectError(
            f"{name}: the points are two separate things, {sizes[order[0]]} and {sizes[order[1]]} points "
            f"after thinning, {_apart(first, second)} apart; cut the cloud down to one object"
        )
    return points[part == order[0]]


def _shallow(points: Array, camera: Array) -> Array:
    """Points with their distances from the camera nearer to the middle one."""
    away = np.linalg.norm(points - camera, axis=1, keepdims=True)
    middle = float(np.median(away))
    return camera + (points - camera) / away * (middle + (away - middle) * SHALLOW)


def _parts(points: Array) -> IntArray:
    """Which connected part each point is of."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    extent = float(np.ptp(points, axis=0).max())
    reach = max(GAP * extent, GAP_SPACINGS * spacing_of(points))
    # Cells of a third of the reach: points are linked through them, where all pairs would be millions.
    cell = reach / 3
    place, label = np.unique(np.floor(points / cell).astype(np.int64), axis=0, return_inverse=True)
    pairs = cKDTree(place.astype(np.float64)).query_pairs(3.5, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(place), len(place)))
    _, part = connected_components(graph, directed=False)
    found: IntArray = part[label.ravel()].astype(np.int64)
    return found


def _apart(first: Array, second: Array) -> str:
    return f"{1000 * float(nearest(first, 2, second)[0].min()):.0f} mm"


def _not_on_a_plane(name: str, points: Array) -> None:
    _, near = nearest(points, 2 * NEIGHBOURS)
    local = np.linalg.svd(points[near] - points[near].mean(axis=1, keepdims=True), compute_uv=False)
    rough = float(np.median(local[:, 2])) / np.sqrt(2 * NEIGHBOURS)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    extent = float(np.ptp(points, axis=0).max())
    if spread[2] < max(FLAT * extent, FLAT_NOISE * rough):
        raise ObjectError(
            f"{name}: all points lie on a plane, within {1000 * spread[2]:.1f} mm: one flat side does not "
            "tell what is behind it; scan the object from an angle that shows two sides"
        )
