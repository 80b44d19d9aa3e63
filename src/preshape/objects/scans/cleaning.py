"""Cleaning of point clouds: no stray points, even density, one connected object."""

from __future__ import annotations

import numpy as np

from ...exceptions import ObjectError
from ...types import Array, IntArray, read_only

LEAST = 100
"""Least number of points of a cloud [C]."""
MOST = 200_000
"""Largest number of points; of a larger cloud only every n-th point is used [C]."""
CELLS = 110
"""Cells along the cloud's longest side, in each of which the points are averaged [C]."""
NEIGHBOURS = 8
"""Neighbours that decide whether a point is stray [C]."""
SMOOTHED = 24
"""Neighbours that give the plane to which a point is moved [C]."""
STRAY = 4.0
"""A point is stray if the mean distance of its neighbours exceeds the median by this factor [C]."""
GAP, GAP_SPACINGS = 0.15, 8.0
"""Two parts are separate objects if the gap between them exceeds this share of the cloud's extent and this
number of spacings [C]."""
SHALLOW = 0.25
"""Factor on gaps along the line of sight [C]."""
CRUMB = 0.05
"""Parts with a smaller share of the points are dropped [C]."""
FLAT, FLAT_NOISE = 0.005, 2.5
"""Points lie on a plane if their rms distance from the plane is below the first number times the extent, or
below the second number times the local roughness [C]."""


def cleaned(name: str, points: Array, camera: Array | None = None) -> Array:
    """Clean the points of one object.

    1. Drop points that occur twice, and every n-th point of a large cloud.
    2. Drop stray points, and average the points of each cell.
    3. Keep the largest connected part; a second large part is an error.
    4. Check that the points do not lie on a plane, and smooth them.

    Args:
        name: Name of the file, for messages.
        points: (n, 3) finite positions [m].
        camera: (3,) position of the camera [m], or ``None``. With a camera, gaps along the line of sight
            count less, because a part in front hides its connection to the parts behind it.

    Returns:
        (m, 3) positions [m].

    Raises:
        ObjectError: There are too few points, two objects, or all points lie on a plane.
    """
    check_enough(name, len(points), "points")
    found = np.unique(points[:: -(-len(points) // MOST)], axis=0)
    check_enough(name, len(found), "different points")
    found = _without_strays(found)
    found = _averaged(found, float(np.ptp(found, axis=0).max()) / CELLS)
    found = _one_object(name, found, camera)
    check_enough(name, len(found), "points that belong together")
    _not_on_a_plane(name, found)
    return read_only(_smooth(found))


def nearest(points: Array, count: int, at: Array | None = None) -> tuple[Array, IntArray]:
    """Distances of the nearest points [m] and their indices, nearest first.

    Args:
        points: (n, 3) or (n, 2) points.
        count: Number of neighbours, 2 or more.
        at: (m, ...) places at which neighbours are searched; ``None`` for the points themselves, each of
            which is its own first neighbour.

    Returns:
        (m, count) distances and (m, count) indices.
    """
    from scipy.spatial import cKDTree

    away, index = cKDTree(points).query(points if at is None else at, k=count)
    return np.asarray(away, dtype=np.float64), np.asarray(index, dtype=np.int64)


def spacing_of(points: Array) -> float:
    """Median distance of a point to its fourth neighbour [m]; on a square grid the edge of a cell."""
    return float(np.median(nearest(points, 5)[0][:, 4]))


def check_enough(name: str, count: int, what: str) -> None:
    """Refuse fewer points than ``LEAST``.

    Args:
        name: Name of the file, for messages.
        count: Number of points.
        what: Which points they are, for messages.

    Raises:
        ObjectError: There are too few points.
    """
    if count < LEAST:
        raise ObjectError(
            f"{name}: a point cloud needs at least {LEAST} points, found {count} {what}; "
            "scan from nearer or with more pixels"
        )


def _without_strays(points: Array) -> Array:
    distance, _ = nearest(points, NEIGHBOURS + 1)
    mean = distance[:, 1:].mean(axis=1)
    found: Array = points[mean <= STRAY * np.median(mean)]
    return found


def _averaged(points: Array, cell: float) -> Array:
    """The mean of the points in each cell, which thins the cloud and reduces noise."""
    place = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    _, label, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    sums = [np.bincount(label.ravel(), weights=column) for column in points.T]
    means: Array = np.stack(sums, axis=1) / count[:, None]
    return means


def _smooth(points: Array) -> Array:
    """Each point moved to a plane through its neighbours, nearer ones weighted more, which reduces noise."""
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


def _one_object(name: str, points: Array, camera: Array | None) -> Array:
    part = _parts(points if camera is None else _shallow(points, camera))
    sizes = np.bincount(part)
    order = np.argsort(-sizes, kind="stable")
    if len(order) > 1 and sizes[order[1]] >= CRUMB * len(points):
        first, second = (points[part == k] for k in order[:2])
        raise ObjectError(
            f"{name}: the points are two separate objects of {sizes[order[0]]} and {sizes[order[1]]} points "
            f"after thinning, {_apart(first, second)} apart; cut the cloud down to one object"
        )
    return points[part == order[0]]


def _shallow(points: Array, camera: Array) -> Array:
    """The points with their distances from the camera compressed towards the median."""
    away = np.linalg.norm(points - camera, axis=1, keepdims=True)
    middle = float(np.median(away))
    return camera + (points - camera) / away * (middle + (away - middle) * SHALLOW)


def _parts(points: Array) -> IntArray:
    """(n,) connected part of each point."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    extent = float(np.ptp(points, axis=0).max())
    reach = max(GAP * extent, GAP_SPACINGS * spacing_of(points))
    # Points are linked through cells of a third of the reach, because all pairs would be millions.
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
            "show the depth of the object; scan it from an angle that shows two sides"
        )
