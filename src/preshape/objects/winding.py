"""Consistent winding of the triangles of any mesh, which the winding number needs.

Two triangles at an edge are wound consistently if they pass along it in opposite directions. Where they do
not, one of them is reversed.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from ..types import Array, BoolArray, IntArray
from .mesh import TriangleMesh
from .read_raw import group_rows

_ORIENTED: WeakKeyDictionary[TriangleMesh, IntArray] = WeakKeyDictionary()


def oriented_triangles(mesh: TriangleMesh) -> IntArray:
    """The mesh's triangles in the same order, wound consistently and outward.

    1. Each connected part gets the winding that most of its area has.
    2. A closed part is oriented outward, unless it lies in the bounding box of another part, because it may
       then be a cavity.
    3. All open parts are reversed together if their total volume is negative.

    A part that cannot be wound consistently (a Möbius band) is not changed. The result is kept as long as the
    mesh exists, because field, surface query and antipodal pairs need it.

    Args:
        mesh: Any mesh.

    Returns:
        (m, 3) indices into ``mesh.vertices``; the mesh's own array if nothing had to be reversed.
    """
    if mesh not in _ORIENTED:
        same = group_rows(mesh.vertices + 0.0)[1]  # -0 becomes 0
        orient(mesh, turned(same[mesh.triangles], mesh.corners, mesh.crosses, mesh.cog))
    return _ORIENTED[mesh]


def orient(mesh: TriangleMesh, turn: BoolArray) -> None:
    """Keep which triangles (m,) of a mesh :func:`oriented_triangles` reverses, as was found out before."""
    if mesh not in _ORIENTED:
        _ORIENTED[mesh] = with_turned(mesh.triangles, turn)


def reversed_triangles(mesh: TriangleMesh) -> BoolArray:
    """(m,) which triangles of a mesh :func:`oriented_triangles` reverses."""
    return (oriented_triangles(mesh) != mesh.triangles).any(axis=1)


def with_turned(triangles: IntArray, turn: BoolArray) -> IntArray:
    """The triangles, those of a mask reversed; the same array if there are none."""
    return np.where(turn[:, None], triangles[:, ::-1], triangles) if turn.any() else triangles


def turned(faces: IntArray, corners: Array, crosses: Array, middle: Array) -> BoolArray:
    """(m,) whether each triangle must be reversed; see :func:`oriented_triangles`.

    Args:
        faces: (m, 3) place of each corner; corners at one position have the same number.
        corners: (m, 3, 3) positions of the corners [m].
        crosses: (m, 3) normals with twice the areas as lengths [m²].
        middle: (3,) middle of the bounding box [m].
    """
    # Edges that belong to two triangles join them; an edge of one triangle makes its part open.
    places = int(faces.max()) + 1
    key = np.concatenate([_edge_key(faces[:, k], faces[:, (k + 1) % 3], places) for k in range(3)])
    order = np.argsort(key)
    key = key[order]
    starts = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    sizes = np.diff(np.r_[starts, len(key)])
    # An edge between two corners at one position, whose key is a multiple of places + 1, says nothing.
    shared = starts[(sizes == 2) & (key[starts] % (places + 1) != 0)]
    first, second = order[shared], order[shared + 1]
    corner, count = faces.T.ravel(), len(faces)  # the corners at which the edges start
    a, b, alike = first % count, second % count, corner[first] != corner[second]
    alone = order[starts[sizes == 1]] % count
    del key, order, starts, sizes, shared, first, second, corner
    # 1. Winding of each part
    part, turn = _parts(a, b, alike, np.linalg.norm(crosses, axis=1) / 2)
    open_part = np.zeros(part.max() + 1, dtype=bool)
    open_part[part[alone]] = True
    # 2. and 3. Six times the volume under each triangle says which way its part faces.
    sixfold = np.einsum("ij,ij->i", corners[:, 0] - middle, crosses)
    volume = np.bincount(part, weights=np.where(turn, -sixfold, sixfold))
    backward = np.where(open_part, volume[open_part].sum() < 0, volume < 0)
    lone = _not_within_another(corners, part)
    turn ^= (backward & (open_part | lone))[part]
    return turn


def _edge_key(a: IntArray, b: IntArray, count: int) -> IntArray:
    """One number for each edge between two of ``count`` places, the same in both directions."""
    return np.minimum(a, b) * count + np.maximum(a, b)


def _parts(a: IntArray, b: IntArray, alike: BoolArray, areas: Array) -> tuple[IntArray, BoolArray]:
    """Connected part of each triangle, and whether the triangle must be reversed to agree with its part.

    In the graph every triangle is two nodes, as it is and reversed; nodes that agree are connected.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(areas)
    if alike.all():  # wound consistently, as most files are: half the graph does
        graph = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(count, count))
        part = connected_components(graph, directed=False)[1].astype(np.int64)
        return part, np.zeros(count, dtype=bool)
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


def _not_within_another(corners: Array, part: IntArray) -> BoolArray:
    """For each part, whether no other part's bounding box holds its own."""
    count = int(part.max()) + 1
    if count == 1 or count > 2000:  # so many fragments are no cavities, and too many to compare in pairs
        return np.ones(count, dtype=bool)
    order = np.argsort(part, kind="stable")
    starts = np.searchsorted(part[order], np.arange(count))
    low = np.minimum.reduceat(corners.min(axis=1)[order], starts)
    high = np.maximum.reduceat(corners.max(axis=1)[order], starts)
    within = np.all((low[:, None] > low[None]) & (high[:, None] < high[None]), axis=2)
    return np.logical_not(within.any(axis=1))
