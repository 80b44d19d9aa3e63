"""Exact collision of a hand's shapes with an object's triangles by FCL, and distances to the object.

The mesh counts as a surface, not as a hull or a solid: a link that crosses no triangle is clear. A link
wholly inside the object is noticed too, because links are connected and another one would cross the surface.
"""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ..exceptions import ObjectError
from ..objects.mesh import TriangleMesh
from ..types import Array, IntArray
from .hulls import LinkHull, hull
from .kinematics import LinkShape

SAMPLES = 6000
"""Surface points for the smooth distances that guide the inverse kinematics."""

_NEAREST = 6
_LINE = 1e-7  # [m] thickness of a line
_THIN = 1e-5  # [m] radius at which a shrunken hull counts as a point

_checkers: WeakKeyDictionary[TriangleMesh, ObjectCollision] = WeakKeyDictionary()


def object_collision(mesh: TriangleMesh) -> ObjectCollision:
    """The :class:`ObjectCollision` of a mesh, built once per mesh."""
    checker = _checkers.get(mesh)
    if checker is None:
        checker = _checkers[mesh] = ObjectCollision(mesh)
    return checker


class ObjectCollision:
    """Collision and distance of one triangle mesh.

    Args:
        mesh: The object. No reference to it is stored, so that the cache can release it.

    Raises:
        ObjectError: The triangles have no area.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        import fcl
        from scipy.spatial import cKDTree

        if not mesh.area > 0:
            raise ObjectError(f"{mesh.name}: the triangles have no area, so nothing can be touched")
        self._fcl = fcl
        self._corners = mesh.corners
        self._lower, self._upper = self._corners.min(axis=1), self._corners.max(axis=1)
        tree = fcl.BVHModel()
        tree.beginModel(len(mesh.triangles), len(mesh.vertices))
        tree.addSubModel(mesh.vertices, mesh.triangles)
        tree.endModel()
        self._object = fcl.CollisionObject(tree, fcl.Transform())
        # With a fixed seed and weights by triangle, the samples move with the object.
        rng = np.random.default_rng(0)
        share = mesh.areas / mesh.areas.sum()
        chosen = rng.choice(len(share), size=SAMPLES, p=share)
        u, v = np.sqrt(rng.random(SAMPLES)), rng.random(SAMPLES)
        weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)
        self._samples = np.einsum("ij,ijk->ik", weights, mesh.corners[chosen])
        self._normals = mesh.normals[chosen]
        self._tree = cKDTree(self._samples)

    def touches(self, shape: LinkShape, grow: float = 0.0) -> bool:
        """Whether the shape, enlarged by ``grow`` [m] on all sides, touches a triangle."""
        fcl = self._fcl
        item = fcl.CollisionObject(self._primitive(shape, grow), self._transform(shape))
        request, result = fcl.CollisionRequest(), fcl.CollisionResult()
        return bool(fcl.collide(item, self._object, request, result))

    def distance(self, shape: LinkShape) -> float:
        """Distance of a shape from the nearest triangle [m], to about 1 µm; 0 or less where they touch."""
        fcl, grown = self._fcl, 0.0
        primitive = self._primitive(shape, 0.0)
        if shape.kind == "capsule":  # FCL finds the distance of its axis 40 times as accurately
            grown = shape.radius
            primitive = fcl.Box(_LINE, _LINE, float(np.linalg.norm(shape.p1 - shape.p0)))
        item = fcl.CollisionObject(primitive, self._transform(shape))
        return float(fcl.distance(item, self._object, fcl.DistanceRequest(), fcl.DistanceResult())) - grown

    def _primitive(self, shape: LinkShape, grow: float) -> Any:
        fcl = self._fcl
        if shape.kind == "sphere":
            return fcl.Sphere(shape.radius + grow)
        if shape.kind == "capsule":
            return fcl.Capsule(shape.radius + grow, float(np.linalg.norm(shape.p1 - shape.p0)))
        if shape.hull is not None:
            corners, faces = _grown(shape.hull, grow)
            return fcl.Convex(corners, len(faces), np.insert(faces, 0, 3, axis=1).ravel())
        return fcl.Box(*(2 * (shape.half + grow)))

    def _transform(self, shape: LinkShape) -> Any:
        return self._fcl.Transform(shape.rotation, (shape.p0 + shape.p1) / 2)

    def closest(self, point: Array, within: float) -> tuple[float, Array, int]:
        """Distance [m], closest point (3,) [m] and its triangle; infinite and -1 beyond ``within`` [m]."""
        near = np.flatnonzero(((self._lower <= point + within) & (self._upper >= point - within)).all(axis=1))
        if not len(near):
            return np.inf, np.full(3, np.inf), -1
        found = closest_on_triangles(self._corners[near], point)
        distance = np.linalg.norm(found - point, axis=1)
        best = int(distance.argmin())
        if distance[best] > within:
            return np.inf, np.full(3, np.inf), -1
        return float(distance[best]), found[best], int(near[best])

    def soft_distance(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (n,) [m] of points (n, 3) from sampled surface points, and its gradient (n, 3).

        It is smooth enough to guide a solver; its error is up to the spacing of the samples.
        """
        found, index = self._tree.query(points, k=_NEAREST)
        distance = np.asarray(found)
        away = points[:, None] - self._samples[index]
        length = np.maximum(distance, 1e-9)
        # The sign is that of the winding number, to which the nearest samples contribute most.
        share = np.einsum("kni,kni->kn", away, self._normals[index]) / length**3
        sign = np.where(share.sum(axis=1) < 0, -1.0, 1.0)
        return sign * distance[:, 0], (sign / length[:, 0])[:, None] * away[:, 0]


def _grown(solid: LinkHull, grow: float) -> tuple[Array, IntArray]:
    """Corners and triangles of a hull whose planes are moved out by ``grow`` [m]; a point if it vanishes."""
    if grow == 0.0:
        return solid.corners, solid.faces
    from scipy.optimize import linprog
    from scipy.spatial import HalfspaceIntersection

    normals, offsets = solid.planes[:, :3], solid.planes[:, 3] + grow
    # The centre of the largest sphere inside is far from every plane.
    found = linprog(
        [0.0, 0.0, 0.0, -1.0], np.column_stack([normals, np.ones(len(normals))]), offsets, bounds=(None, None)
    )
    if found.x is None or found.x[3] < _THIN:
        middle = solid.corners.mean(axis=0)
        grown = hull(middle + _THIN * np.concatenate([np.eye(3), -np.eye(3)]))
    else:
        grown = hull(HalfspaceIntersection(np.column_stack([normals, -offsets]), found.x[:3]).intersections)
    return grown.corners, grown.faces


def closest_on_triangles(corners: Array, point: Array) -> Array:
    """Closest point on each of n triangles.

    Args:
        corners: (n, 3, 3) corners of the triangles [m].
        point: (3,) [m].

    Returns:
        (n, 3) the closest points [m].
    """
    from trimesh.triangles import closest_point

    return np.asarray(closest_point(corners, np.broadcast_to(point, (len(corners), 3))))
