"""First hits of rays with a triangle mesh: Embree for speed, a NumPy twin as the specification.

Embree finds the triangle in single precision; the distance is then computed again in double
precision from that triangle, so both versions return the same numbers.
"""

from __future__ import annotations

import numpy as np

from ..objects.mesh import TriangleMesh
from ..types import Array, IntArray, value

MISS = -1
"""Triangle index of a ray that hits nothing; its distance is infinite."""

GRAZING = 1e-6
"""A surface steeper than this (cosine to the ray) is an edge seen from the side: no area to land on."""


@value
class Hits:
    """First hits of n rays.

    Attributes:
        distance: (n,) along the ray [m], infinite for a miss.
        triangle: (n,) index of the triangle, -1 for a miss.
    """

    distance: Array
    triangle: IntArray


class RayCaster:
    """Rays against one mesh, prepared once.

    Args:
        mesh: the object.

    The mesh is moved to its COG and scaled to unit size for Embree, so that single precision serves a
    screw of a millimetre and an object far from its file's origin equally well.
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
            origins: (n, 3) [m], mesh frame.
            directions: (n, 3) unit vectors.
        """
        start = np.ascontiguousarray((origins - self._mesh.cog) * self._scale, dtype=np.float32)
        aim = np.ascontiguousarray(directions, dtype=np.float32)
        triangle = self._scene.run(start, aim, query="INTERSECT").astype(np.int64)
        self._look_behind(triangle, origins, directions)
        return Hits(distance=distance_to(self._mesh, triangle, origins, directions), triangle=triangle)

    def _look_behind(self, triangle: IntArray, origins: Array, directions: Array) -> None:
        """Where a ray has hit an edge seen from the side, go on to what is behind it."""
        normals = self._mesh.normals
        slope = np.einsum("ij,ij->i", directions, normals[triangle])
        edge = np.flatnonzero((np.abs(slope) <= GRAZING) & (triangle != MISS))
        if not len(edge):
            return
        plain = cast_plain(self._mesh, origins[edge], directions[edge])
        triangle[edge] = plain.triangle


def distance_to(mesh: TriangleMesh, triangle: IntArray, origins: Array, directions: Array) -> Array:
    """Distance along each ray to the plane of its triangle.

    Args:
        mesh: the object.
        triangle: (n,) one for each ray, -1 for none.
        origins: (n, 3) [m].
        directions: (n, 3) unit vectors.

    Returns:
        (n,) [m], infinite without a triangle.
    """
    normal = mesh.normals[triangle]
    slope = np.einsum("ij,ij->i", directions, normal)
    rise = np.einsum("ij,ij->i", mesh.corners[triangle, 0] - origins, normal)
    return np.divide(rise, slope, out=np.full(len(origins), np.inf), where=triangle != MISS)


def cast_plain(mesh: TriangleMesh, origins: Array, directions: Array) -> Hits:
    """The NumPy twin: every ray against every triangle (Möller & Trumbore 1997).

    Same arguments and result as :meth:`RayCaster.cast`.
    """
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
