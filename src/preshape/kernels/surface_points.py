"""Points spread evenly over an object's surface."""

from __future__ import annotations

import math

import numpy as np

from ..exceptions import InputError, shown
from ..objects.mesh import TriangleMesh
from ..objects.winding import oriented_triangles
from ..types import Array, BoolArray, IntArray, read_only

SHARP = math.cos(math.radians(30.0))
"""An edge is sharp if the cosine of the angle between its faces' normals is below this [C]."""

OVERSAMPLING = 10
NEIGHBOUR = 0.8  # least distance of two points, in spacings; it gives about area / spacing² points
MOST_CANDIDATES = 5_000_000


def surface_points(mesh: TriangleMesh, spacing: float, seed: int = 0) -> tuple[Array, Array]:
    """Sample evenly spread points of the surface, and every vertex of a sharp edge or rim.

    1. Take the vertices of sharp edges and rims.
    2. Draw many more points in proportion to the area.
    3. Of any two points that are closer than 0.8 spacings, remove one (Poisson disk sampling by elimination).
       Every part of the surface is then within about one spacing of a point. The two sides of a thin wall
       keep points of their own.

    Args:
        mesh: The object; it need be neither watertight nor consistently wound.
        spacing: Typical distance between neighbours [m].
        seed: Seed of the draws; the same seed gives the same points.

    Returns:
        (n, 3) points [m] and (n, 3) outward unit normals, the vertices of sharp edges first. A normal on a
        sharp edge is the mean of its faces' normals.

    Raises:
        InputError: ``spacing`` is not positive, or so small that there would be millions of points.
    """
    if not (math.isfinite(spacing) and spacing > 0):
        raise InputError(f"spacing must be a positive length [m], got {shown(spacing)}")
    wanted = OVERSAMPLING * mesh.area / spacing**2
    if wanted > MOST_CANDIDATES:
        least = math.sqrt(OVERSAMPLING * mesh.area / MOST_CANDIDATES)
        raise InputError(f"spacing must be {least:.2g} m or more for this object, got {shown(spacing)}")
    triangles = oriented_triangles(mesh)
    normals = np.where((triangles == mesh.triangles).all(axis=1)[:, None], mesh.normals, -mesh.normals)
    rng = np.random.default_rng(seed)
    # 1. Sharp edges
    sharp, sharp_normals = _sharp_vertices(mesh, normals)
    # 2. Draws
    face = _by_area(mesh, max(math.ceil(wanted), 1), rng)
    points, outward = _within(mesh.corners[face], rng), normals[face]
    # 3. Elimination
    stays = _spread(
        np.concatenate([sharp, points]),
        np.concatenate([sharp_normals, outward]),
        len(sharp),
        NEIGHBOUR * spacing,
        rng,
    )
    return (
        read_only(np.concatenate([sharp, points[stays]])),
        read_only(np.concatenate([sharp_normals, outward[stays]])),
    )


def _by_area(mesh: TriangleMesh, count: int, rng: np.random.Generator) -> IntArray:
    """(count,) indices of triangles, one drawn in each of ``count`` equal shares of the area."""
    ends = np.cumsum(mesh.areas)
    at = (np.arange(count) + rng.random(count)) / count * ends[-1]
    return np.minimum(np.searchsorted(ends, at, side="right"), len(ends) - 1)


def _within(corners: Array, rng: np.random.Generator) -> Array:
    """(n, 3) a uniformly random point of each triangle (n, 3, 3) (Osada et al. 2002, eq. 1)."""
    root, v = np.sqrt(rng.random(len(corners))), rng.random(len(corners))
    weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    return np.einsum("nk,nkd->nd", weights, corners)


def _sharp_vertices(mesh: TriangleMesh, normals: Array) -> tuple[Array, Array]:
    """(k, 3) vertices of sharp edges and rims, and (k, 3) the mean normal of the faces round each."""
    places, same = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = same.ravel()[mesh.triangles]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owner = np.tile(np.arange(len(faces)), 3)
    key = edges.min(axis=1) * len(places) + edges.max(axis=1)
    order = np.argsort(key, kind="stable")
    key, owner, edges = key[order], owner[order], edges[order]
    starts = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    sizes = np.diff(np.r_[starts, len(key)])
    pair = sizes == 2
    first, second = owner[starts[pair]], owner[starts[pair] + 1]
    solid = (mesh.areas[first] > 0) & (mesh.areas[second] > 0)
    flat = np.einsum("ij,ij->i", normals[first], normals[second])
    chosen = np.unique(np.concatenate([edges[starts[pair][solid & (flat < SHARP)]], edges[starts[~pair]]]))
    total = np.zeros((len(places), 3))
    for corner in range(3):
        u, v = (mesh.corners[:, (corner + k) % 3] - mesh.corners[:, corner] for k in (1, 2))
        # Weighted by the angle at the corner, so that the cut of a face into triangles does not matter.
        angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.einsum("ij,ij->i", u, v))
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, corner], angle * normals[:, axis], minlength=len(places))
    length = np.linalg.norm(total[chosen], axis=1)
    chosen, length = chosen[length > 0], length[length > 0]
    return places[chosen], total[chosen] / length[:, None]


def _spread(points: Array, normals: Array, fixed: int, gap: float, rng: np.random.Generator) -> BoolArray:
    """Which points after the first ``fixed`` stay, so that no two on one side are closer than ``gap``.

    Every round keeps the points that precede all their neighbours in a random order, and removes these
    neighbours (Luby 1986). The result equals that of a greedy choice in the same order.
    """
    from scipy.spatial import cKDTree

    count = len(points)
    near = cKDTree(points).query_pairs(gap, output_type="ndarray")
    # Points on opposite sides of a wall are no neighbours; points on the two faces of an edge are.
    near = near[np.einsum("ij,ij->i", normals[near[:, 0]], normals[near[:, 1]]) > -0.5]
    rank = np.concatenate([np.arange(fixed), fixed + rng.permutation(count - fixed)])
    stays, open_points = np.zeros(count, dtype=bool), np.ones(count, dtype=bool)
    stays[:fixed], open_points[:fixed] = True, False
    for a, b in ((near[:, 0], near[:, 1]), (near[:, 1], near[:, 0])):
        open_points[b[a < fixed]] = False
    while open_points.any():
        near = near[open_points[near].all(axis=1)]
        least = np.full(count, count, dtype=np.int64)
        np.minimum.at(least, near[:, 0], rank[near[:, 1]])
        np.minimum.at(least, near[:, 1], rank[near[:, 0]])
        chosen = open_points & (rank < least)
        stays |= chosen
        open_points &= ~chosen
        for a, b in ((near[:, 0], near[:, 1]), (near[:, 1], near[:, 0])):
            open_points[b[chosen[a]]] = False
    return stays[fixed:]
