"""Signed distance in plain NumPy: the specification of the kernels of :mod:`.warp`.

The package itself also uses :func:`field_distance` and :func:`field_gradient`. The functions
:func:`closest_plain` and :func:`winding_number` compare every point with every triangle; only tests use them.
"""

from __future__ import annotations

import numpy as np

from ...objects.mesh import TriangleMesh
from ...types import Array, IntArray
from .host import Closest, DistanceField


def field_distance(field: DistanceField, points: Array) -> Array:
    """Signed distance at points: trilinear inside the grid, a lower bound outside it.

    Args:
        field: The object's distance field.
        points: (n, 3) in the mesh frame [m].

    Returns:
        (n,) [m].
    """
    low, u, beyond = _cell(field, points)
    value = _blend(field, low, u)
    away = np.linalg.norm(beyond, axis=1) * field.spacing
    return np.where(away > 0, np.hypot(away, np.maximum(value, 0)), value)


def field_gradient(field: DistanceField, points: Array) -> Array:
    """Unit gradient of :func:`field_distance`; zero where the interpolant is flat.

    Args:
        field: The object's distance field.
        points: (n, 3) in the mesh frame [m].

    Returns:
        (n, 3).
    """
    low, u, beyond = _cell(field, points)
    rise = np.empty_like(u)
    for axis in range(3):
        ends = []
        for end in (0.0, 1.0):
            at = u.copy()
            at[:, axis] = end
            ends.append(_blend(field, low, at))
        rise[:, axis] = (ends[1] - ends[0]) / field.spacing
    outside = (beyond != 0).any(axis=1)
    value = np.maximum(_blend(field, low, u), 0)[:, None]
    steady = np.where(beyond != 0, 0.0, value * rise) + beyond * field.spacing
    rise = np.where(outside[:, None], steady, rise)
    length = np.linalg.norm(rise, axis=1, keepdims=True)
    return np.divide(rise, length, out=np.zeros_like(rise), where=length > 0)


def _cell(field: DistanceField, points: Array) -> tuple[IntArray, Array, Array]:
    """Lowest corner of each point's cell, position in the cell (0 to 1), and offset from the grid [cells]."""
    x = (np.asarray(points, dtype=np.float64) - field.origin) / field.spacing
    nodes = np.array(field.distance.shape)
    inside = np.clip(x, 0, nodes - 1)
    low = np.minimum(inside.astype(np.int64), nodes - 2)
    return low, inside - low, x - inside


def _blend(field: DistanceField, low: IntArray, u: Array) -> Array:
    total = np.zeros(len(low))
    for corner in np.ndindex(2, 2, 2):
        i, j, k = (low + corner).T
        weight = np.where(corner, u, 1 - u).prod(axis=1)
        total += weight * field.distance[i, j, k]
    return total


def closest_plain(mesh: TriangleMesh, points: Array) -> Closest:
    """Nearest surface points, by comparing every point with every triangle (Ericson 2005, §5.1.5).

    Args:
        mesh: The object, its triangles wound outward.
        points: (n, 3) in the mesh frame [m].
    """
    a, b, c = (mesh.corners[:, i] for i in range(3))
    point = np.empty((len(points), 3))
    triangle = np.empty(len(points), dtype=np.int64)
    for row, p in enumerate(points):
        candidates = np.stack([_on_face(a, b, c, mesh.normals, p), *_on_edges(a, b, c, p)])
        gap = np.linalg.norm(candidates - p, axis=2)
        which, face = np.unravel_index(np.nanargmin(gap), gap.shape)
        point[row], triangle[row] = candidates[which, face], face
    away = points - point
    sign = np.where(winding_number(mesh, points) > 0.5, -1.0, 1.0)
    normal = mesh.normals[triangle]
    length = np.linalg.norm(away, axis=1)
    behind = np.einsum("ij,ij->i", normal, away) * sign < -0.5 * length
    return Closest(
        distance=sign * length,
        point=point,
        normal_out=np.where(behind[:, None], -normal, normal),
        triangle=triangle,
    )


def _on_face(a: Array, b: Array, c: Array, normal: Array, p: Array) -> Array:
    """Projection of the point onto each triangle's plane; NaN where it is outside the triangle."""
    foot = p - np.einsum("ij,ij->i", p - a, normal)[:, None] * normal
    inside = np.ones(len(a), dtype=bool)
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ij,ij->i", np.cross(end - start, foot - start), normal) >= 0
    return np.where(inside[:, None], foot, np.nan)


def _on_edges(a: Array, b: Array, c: Array, p: Array) -> list[Array]:
    feet = []
    for start, end in ((a, b), (b, c), (c, a)):
        along = end - start
        square = np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
        t = np.clip(np.einsum("ij,ij->i", p - start, along) / square, 0, 1)
        feet.append(start + t[:, None] * along)
    return feet


def winding_number(mesh: TriangleMesh, points: Array) -> Array:
    """Generalised winding number: sum of the solid angles of all triangles (van Oosterom & Strackee 1983).

    Args:
        mesh: The object, its triangles wound outward.
        points: (n, 3) in the mesh frame [m], not on the surface.

    Returns:
        (n,) about 1 inside, about 0 outside, in between near a hole.
    """
    total = np.empty(len(points))
    for row, p in enumerate(points):
        a, b, c = (mesh.corners[:, i] - p for i in range(3))
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        triple = np.einsum("ij,ij->i", a, np.cross(b, c))
        dots = [np.einsum("ij,ij->i", x, y) for x, y in ((a, b), (b, c), (c, a))]
        below = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
        total[row] = np.arctan2(triple, below).sum() / (2 * np.pi)
    return total
