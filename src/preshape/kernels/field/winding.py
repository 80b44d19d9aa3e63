"""Consistent winding of the triangles of any mesh, which the winding number needs.

Two triangles at an edge are wound consistently if they pass along it in opposite directions. Where they do
not, one of them is reversed.
"""

from __future__ import annotations

import numpy as np

from ...objects.mesh import TriangleMesh
from ...types import Array, BoolArray, IntArray


def oriented_triangles(mesh: TriangleMesh) -> IntArray:
    """The mesh's triangles in the same order, wound consistently and outward.

    1. Each connected part gets the winding that most of its area has.
    2. A closed part is oriented outward, unless it lies in the bounding box of another part, because it may
       then be a cavity.
    3. All open parts are reversed together if their total volume is negative.

    A part that cannot be wound consistently (a Möbius band) is not changed.

    Args:
        mesh: Any mesh.

    Returns:
        (m, 3) indices into ``mesh.vertices``; the mesh's own array if nothing had to be reversed.
    """
    # Edges that belong to two triangles join them; an edge of one triangle makes its part open.
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
    # 1. Winding of each part
    part, turn = _parts(a, b, alike, mesh.areas)
    open_part = np.zeros(part.max() + 1, dtype=bool)
    open_part[part[owner[starts[sizes == 1]]]] = True
    # 2. and 3. Six times the volume under each triangle says which way its part faces.
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
    """Connected part of each triangle, and whether the triangle must be reversed to agree with its part.

    In the graph every triangle is two nodes, as it is and reversed; nodes that agree are connected.
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
    # The area of a reversed triangle counts for the opposite winding of its part.
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
    if count > 2000:  # too many to compare in pairs; such fragments are no cavities
        return np.ones(count, dtype=bool)
    within = np.all((low[:, None] > low[None]) & (high[:, None] < high[None]), axis=2)
    return np.logical_not(within.any(axis=1))
