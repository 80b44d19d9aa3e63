"""Triangles wound alike, so that a winding number means something for a careless scan.

Neighbours across an edge should pass along it in opposite directions. Where they do not,
one of them is turned.
"""

from __future__ import annotations

import numpy as np

from ...objects.mesh import TriangleMesh
from ...types import Array, BoolArray, IntArray


def oriented_triangles(mesh: TriangleMesh) -> IntArray:
    """The mesh's triangles, in the same order, each wound like its neighbours and the whole outward.

    Each connected part keeps the winding of most of its area; a closed part turns outward unless it lies
    within the box of another (then it may be a cavity); the open parts turn together if their volume is
    negative. A part that cannot be wound consistently (a Möbius band) stays as it is.

    Args:
        mesh: any.

    Returns:
        (m, 3) indices into ``mesh.vertices``; the mesh's own array where nothing had to be turned.
    """
    points, same = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = same.ravel()[mesh.triangles]
    count = len(faces)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owner = np.tile(np.arange(count), 3)
    forward = edges[:, 0] < edges[:, 1]
    key = edges.min(axis=1) * len(points) + edges.max(axis=1)
    order = np.argsort(key, kind="stable")
    key, owner, forward = key[order], owner[order], forward[order]
    starts = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    sizes = np.diff(np.r_[starts, len(key)])
    shared = starts[sizes == 2]
    a, b, alike = owner[shared], owner[shared + 1], forward[shared] != forward[shared + 1]
    part, turn = _parts(a, b, alike, mesh.areas)
    open_part = np.zeros(part.max() + 1, dtype=bool)
    open_part[part[owner[starts[sizes == 1]]]] = True
    sixfold = np.einsum("ij,ij->i", mesh.corners[:, 0] - mesh.cog, np.cross(*_sides(mesh)))
    volume = np.bincount(part, weights=np.where(turn, -sixfold, sixfold))
    backward = np.where(open_part, volume[open_part].sum() < 0, volume < 0)
    lone = _not_within_another(mesh, part)
    turn ^= (backward & (open_part | lone))[part]
    if not turn.any():
        return mesh.triangles
    return np.where(turn[:, None], mesh.triangles[:, ::-1], mesh.triangles)


def _sides(mesh: TriangleMesh) -> tuple[Array, Array]:
    corners = mesh.corners
    return corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]


def _parts(a: IntArray, b: IntArray, alike: BoolArray, areas: Array) -> tuple[IntArray, BoolArray]:
    """Connected part of each triangle, and whether it must turn to agree with most of its part's area.

    Every triangle stands twice in the graph, as it is and turned; what is consistent is connected.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(areas)
    rows = np.concatenate([a, a + count])
    columns = np.concatenate([np.where(alike, b, b + count), np.where(alike, b + count, b)])
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(2 * count, 2 * count))
    total, label = connected_components(graph, directed=False)
    straight, turned = label[:count], label[count:]
    weight = np.bincount(straight, weights=areas, minlength=total)
    # A turned triangle's area counts for the opposite winding of its part.
    chosen = weight[straight] >= weight[turned]
    first = np.minimum(straight, turned)
    _, part = np.unique(first, return_inverse=True)
    tied = weight[straight] == weight[turned]
    turn = np.where(tied, straight > turned, ~chosen)
    turn[straight == turned] = False
    return part.ravel(), turn


def _not_within_another(mesh: TriangleMesh, part: IntArray) -> BoolArray:
    """For each part, whether no other part's bounding box holds its own."""
    count = int(part.max()) + 1
    low = np.full((count, 3), np.inf)
    high = np.full((count, 3), -np.inf)
    np.minimum.at(low, part, mesh.corners.min(axis=1))
    np.maximum.at(high, part, mesh.corners.max(axis=1))
    if count > 2000:  # crumbs: too many to compare in pairs, and none is a cavity worth the name
        return np.ones(count, dtype=bool)
    within = np.all((low[:, None] > low[None]) & (high[:, None] < high[None]), axis=2)
    return np.logical_not(within.any(axis=1))
