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
        return Hits(distance=_plane_distance(self._mesh, origins, directions, triangle), triangle=triangle)


def _plane_distance(mesh: TriangleMesh, origins: Array, directions: Array, triangle: IntArray) -> Array:
    """Distance along each ray to the plane of its triangle [m], infinite for a miss."""
    normal = mesh.normals[triangle]
    slope = np.einsum("ij,ij->i", directions, normal)
    # A hit at less than a millionth of a right angle is an edge seen from the side: no area to land on.
    triangle[np.abs(slope) <= 1e-6] = MISS
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
    for i, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        p = np.cross(direction, e2)
        determinant = np.einsum("ij,ij->i", e1, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / determinant
            s = origin - a
            u = np.einsum("ij,ij->i", s, p) * inverse
            q = np.cross(s, e1)
            v = q @ direction * inverse
            t = np.einsum("ij,ij->i", e2, q) * inverse
        slack = 1e-7
        inside = (u >= -slack) & (v >= -slack) & (u + v <= 1 + slack) & (t > 0)
        t = np.where(inside & (np.abs(mesh.normals @ direction) > 1e-6), t, np.inf)
        best = int(np.argmin(t))
        if np.isfinite(t[best]):
            distance[i], triangle[i] = t[best], best
    return Hits(distance=distance, triangle=triangle)
