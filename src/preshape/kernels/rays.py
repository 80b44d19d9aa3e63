"""First hits of rays on a triangle mesh, found by Embree and specified by :func:`cast_plain` in NumPy.

Embree finds the triangle in single precision. The distance to that triangle is computed in double precision,
so both versions return the same numbers.
"""

from __future__ import annotations

import numpy as np

from ..objects.mesh import TriangleMesh
from ..types import Array, IntArray, value

MISS = -1
"""Triangle of a ray that hits nothing; its distance is infinite."""

GRAZING = 1e-6
"""Least cosine between ray and triangle normal; below it the triangle is seen edge-on and is not hit."""


@value
class Hits:
    """First hits of n rays.

    Attributes:
        distance: (n,) distance along the ray [m], infinite for a miss.
        triangle: (n,) index of the triangle, -1 for a miss.
    """

    distance: Array
    triangle: IntArray


class RayCaster:
    """Casts rays against one mesh.

    Embree gets the mesh with its COG at the origin and scaled to unit size, so that single precision suffices
    even for a screw of one millimetre or an object far from its file's origin.

    Args:
        mesh: The object.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        from embreex.mesh_construction import TriangleMesh as EmbreeMesh
        from embreex.rtcore_scene import EmbreeScene

        self._mesh = mesh
        self._scale = 1.0 / float(mesh.extents.max())
        vertices = np.ascontiguousarray((mesh.vertices - mesh.cog) * self._scale, dtype=np.float32)
        self._scene = EmbreeScene()
        EmbreeMesh(self._scene, vertices, np.ascontiguousarray(mesh.triangles, dtype=np.int32))

    def cast(self, origins: Array, directions: Array) -> Hits:
        """First hit of each ray.

        Args:
            origins: (n, 3) in the mesh frame [m].
            directions: (n, 3) unit vectors.
        """
        start = np.ascontiguousarray((origins - self._mesh.cog) * self._scale, dtype=np.float32)
        aim = np.ascontiguousarray(directions, dtype=np.float32)
        triangle = self._scene.run(start, aim, query="INTERSECT").astype(np.int64)
        return exact_hits(self._mesh, triangle, origins, directions)


def exact_hits(mesh: TriangleMesh, triangle: IntArray, origins: Array, directions: Array) -> Hits:
    """Hits in double precision, from the triangles that were found in single precision.

    Args:
        mesh: The object.
        triangle: (n,) triangle that each ray meets first, -1 for none. Those seen edge-on are replaced in
            place by the triangle behind them.
        origins: (n, 3) in the mesh frame [m].
        directions: (n, 3) unit vectors.
    """
    slope = np.einsum("ij,ij->i", directions, mesh.normals[triangle])
    edge_on = np.flatnonzero((np.abs(slope) <= GRAZING) & (triangle != MISS))
    if len(edge_on):
        triangle[edge_on] = cast_plain(mesh, origins[edge_on], directions[edge_on]).triangle
    return Hits(distance=distance_to(mesh, triangle, origins, directions), triangle=triangle)


def distance_to(mesh: TriangleMesh, triangle: IntArray, origins: Array, directions: Array) -> Array:
    """Distance along each ray to the plane of its triangle.

    Args:
        mesh: The object.
        triangle: (n,) triangle of each ray, -1 for none.
        origins: (n, 3) in the mesh frame [m].
        directions: (n, 3) unit vectors.

    Returns:
        (n,) [m], infinite without a triangle.
    """
    normal = mesh.normals[triangle]
    slope = np.einsum("ij,ij->i", directions, normal)
    rise = np.einsum("ij,ij->i", mesh.corners[triangle, 0] - origins, normal)
    return np.divide(rise, slope, out=np.full(len(origins), np.inf), where=triangle != MISS)


def cast_plain(mesh: TriangleMesh, origins: Array, directions: Array) -> Hits:
    """Like :meth:`RayCaster.cast`, but test every ray against every triangle (Möller & Trumbore 1997)."""
    a = mesh.corners[:, 0]
    e1, e2 = mesh.corners[:, 1] - a, mesh.corners[:, 2] - a
    distance = np.full(len(origins), np.inf)
    triangle = np.full(len(origins), MISS, dtype=np.int64)
    faced = mesh.normals @ directions.T
    for i, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        p = np.cross(direction, e2)
        determinant = np.einsum("ij,ij->i", e1, p)
        seen = (np.abs(faced[:, i]) > GRAZING) & (determinant != 0)
        inverse = np.divide(1.0, determinant, out=np.zeros_like(determinant), where=seen)
        s = origin - a
        u = np.einsum("ij,ij->i", s, p) * inverse
        q = np.cross(s, e1)
        v = q @ direction * inverse
        t = np.einsum("ij,ij->i", e2, q) * inverse
        slack = 1e-7
        inside = seen & (u >= -slack) & (v >= -slack) & (u + v <= 1 + slack) & (t > 0)
        t = np.where(inside, t, np.inf)
        best = int(np.argmin(t))
        if np.isfinite(t[best]):
            distance[i], triangle[i] = t[best], best
    return Hits(distance=distance, triangle=triangle)
