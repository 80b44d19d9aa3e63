"""Collisions of an arm with itself, the hand, the table and the surfaces around it, along a path of postures.

MuJoCo finds pairs of convex shapes that overlap. Where one of them is the hull of a mesh, FCL decides on the
mesh's triangles, because hulls of bent links overlap where the links do not. Surfaces, such as the object's,
are tested by FCL triangle by triangle, after the bounding spheres of the shapes have been compared with the
surface's box.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..objects.mesh import TriangleMesh
from ..spatial import inverse, quaternion_from_rotation
from ..types import Array, BoolArray, value
from .model import HAND, TABLE, Arm

ROOM = 0.005
"""Least distance of the arm from the table [m] [C]."""
HAND_DEPTH = 0.002
"""Largest depth of the hand in the table [m]: the planner lets a finger touch it [C]."""


@value
class Surface:
    """A surface that the arm stays clear of.

    Attributes:
        name: What it is, for a sentence.
        mesh: The surface, in the frame of the object.
        hand_too: Whether the hand must stay clear of it as well; the planner has seen to the object.
        lifted: Whether it moves with the hand, and so does not count, once the lift begins.
    """

    name: str
    mesh: TriangleMesh
    hand_too: bool = True
    lifted: bool = False


@value
class Hit:
    """The first collision along a path.

    Attributes:
        at: Index of the posture.
        one: A link of the arm, or of the hand.
        other: What it meets.
        itself: Whether that is the arm or the hand.
    """

    at: int
    one: str
    other: str
    itself: bool


class ArmScene:
    """An arm among table and surfaces.

    Args:
        arm: The arm.
        T_base_object: (4, 4) Pose of the object's frame in the arm's base [m].
        table: (4,) The table as a solid half-space n·x < d in the object's frame; ``None`` without one.
        table_radius: Distance from the origin of the object's frame, along the table, up to which it counts
            [m].
        surfaces: What else is around.
    """

    def __init__(
        self,
        arm: Arm,
        T_base_object: Array,
        *,
        table: Array | None = None,
        table_radius: float = np.inf,
        surfaces: tuple[Surface, ...] = (),
    ) -> None:
        import copy

        import fcl
        import mujoco

        self.arm, self._fcl, self._mujoco = arm, fcl, mujoco
        self.model = model = copy.copy(arm.model)
        self.data = mujoco.MjData(model)
        self.table = model.geom(TABLE).id
        self.origin, self.radius = T_base_object[:3, 3], table_radius
        self.up = np.array([0.0, 0.0, 1.0])
        if table is None:
            model.geom_contype[self.table] = 0
        else:
            self.up = T_base_object[:3, :3] @ table[:3]
            model.geom_pos[self.table] = self.origin + table[3] * self.up
            turn = np.linalg.svd(self.up[None])[2][[1, 2, 0]]
            turn[2] = self.up
            turn[0] *= np.sign(np.linalg.det(turn))
            model.geom_quat[self.table] = quaternion_from_rotation(turn.T)
            model.geom_sameframe[self.table] = 0  # else MuJoCo takes the frame of the world for it
            model.geom_margin[self.table] = ROOM
        self.T_object_base = inverse(T_base_object)
        self.surfaces = [(each, _tree(fcl, each.mesh.vertices, each.mesh.triangles)) for each in surfaces]
        names = [model.body(int(b)).name for b in model.geom_bodyid]
        self.of_hand = np.array([name.startswith(HAND) for name in names])
        self.names = [_spoken(name) for name in names]
        group = model.body_weldid[model.geom_bodyid]
        solid = (model.geom_contype > 0) & (np.arange(model.ngeom) != self.table)
        self.solid: BoolArray = solid
        self.moving: BoolArray = solid & (group > 0)
        self._shapes: dict[int, Any] = {}

    def first_hit(self, q: Array, fingers: Array, lifting: BoolArray) -> Hit | None:
        """The first collision along a path.

        Args:
            q: (k, n) Positions of the arm's joints.
            fingers: (k, m) Angles of the hand's joints [rad].
            lifting: (k,) Whether the object is already lifted.
        """
        places = np.empty((len(q), self.model.ngeom, 3))
        turns = np.empty((len(q), self.model.ngeom, 3, 3))
        for at in range(len(q)):
            self._set(q[at], fingers[at])
            places[at] = self.data.geom_xpos
            turns[at] = self.data.geom_xmat.reshape(-1, 3, 3)
            self._mujoco.mj_collision(self.model, self.data)
            if (hit := self._pair(at)) is not None:
                return hit
        hits = [self._surface_hit(surface, tree, places, turns, lifting) for surface, tree in self.surfaces]
        return min((hit for hit in hits if hit is not None), key=lambda hit: hit.at, default=None)

    def _set(self, q: Array, fingers: Array) -> None:
        self.data.qpos[:] = self.arm.rest
        self.data.qpos[self.arm.columns] = q
        self.data.qpos[self.arm.hand_columns] = fingers
        self._mujoco.mj_kinematics(self.model, self.data)

    def _pair(self, at: int) -> Hit | None:
        """A pair of shapes that overlap in the posture of ``self.data``."""
        contact = self.data.contact
        for (one, other), distance, point in zip(
            contact.geom.tolist(), contact.dist.tolist(), contact.pos, strict=True
        ):
            if self.table in (one, other):
                link = other if one == self.table else one
                room = -HAND_DEPTH if self.of_hand[link] else ROOM
                away = point - self.origin
                if distance < room and np.linalg.norm(away - (away @ self.up) * self.up) < self.radius:
                    return Hit(at=at, one=self.names[link], other="the table", itself=False)
            elif distance < 0 and not self._beside(one, other) and self._meet(one, other):
                one, other = sorted((one, other), key=lambda geom: bool(self.of_hand[geom]))
                return Hit(at=at, one=self.names[one], other=self.names[other], itself=True)
        return None

    def _beside(self, one: int, other: int) -> bool:
        weld = self.model.body_weldid[self.model.geom_bodyid[[one, other]]]
        return (int(weld.min()), int(weld.max())) in self.arm.neighbours

    def _meet(self, one: int, other: int) -> bool:
        """Whether two shapes whose hulls overlap do so themselves."""
        mesh = self._mujoco.mjtGeom.mjGEOM_MESH
        if mesh not in self.model.geom_type[[one, other]]:
            return True
        return self._collide(self._shape(one), self._shape(other))

    def _surface_hit(
        self, surface: Surface, tree: Any, places: Array, turns: Array, lifting: BoolArray
    ) -> Hit | None:
        low, high = surface.mesh.bounds
        centres = places @ self.T_object_base[:3, :3].T + self.T_object_base[:3, 3]
        gap = np.linalg.norm(centres - np.clip(centres, low, high), axis=2)
        # The arm's base may stand on what is around, but not in the object.
        near = (gap < self.model.geom_rbound) & (self.solid if surface.lifted else self.moving)
        if not surface.hand_too:
            near &= ~self.of_hand
        if surface.lifted:
            near &= ~lifting[:, None]
        T = self.T_object_base
        for at, geom in np.argwhere(near):
            shape = self._shape(int(geom))
            shape.setTransform(self._fcl.Transform(T[:3, :3] @ turns[at, geom], centres[at, geom]))
            if self._collide(shape, tree):
                return Hit(at=int(at), one=self.names[geom], other=surface.name, itself=False)
        return None

    def _collide(self, one: Any, other: Any) -> bool:
        fcl = self._fcl
        return bool(fcl.collide(one, other, fcl.CollisionRequest(), fcl.CollisionResult()))

    def _shape(self, geom: int) -> Any:
        """The FCL object of a shape, placed where ``self.data`` has it."""
        fcl, model, kinds = self._fcl, self.model, self._mujoco.mjtGeom
        if geom not in self._shapes:
            size = model.geom_size[geom]
            kind = int(model.geom_type[geom])
            if kind == kinds.mjGEOM_MESH:
                mesh = int(model.geom_dataid[geom])
                first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
                face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
                corners = model.mesh_vert[first : first + count].astype(np.float64)
                self._shapes[geom] = _tree(fcl, corners, model.mesh_face[face : face + faces])
            else:
                made = {
                    int(kinds.mjGEOM_SPHERE): lambda: fcl.Sphere(size[0]),
                    int(kinds.mjGEOM_CAPSULE): lambda: fcl.Capsule(size[0], 2 * size[1]),
                    int(kinds.mjGEOM_CYLINDER): lambda: fcl.Cylinder(size[0], 2 * size[1]),
                    int(kinds.mjGEOM_ELLIPSOID): lambda: fcl.Ellipsoid(*size),
                    int(kinds.mjGEOM_BOX): lambda: fcl.Box(*(2 * size)),
                }[kind]()
                self._shapes[geom] = fcl.CollisionObject(made, fcl.Transform())
        shape, data = self._shapes[geom], self.data
        shape.setTransform(fcl.Transform(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]))
        return shape


def _tree(fcl: Any, vertices: Array, triangles: Any) -> Any:
    """The FCL object of a surface."""
    tree = fcl.BVHModel()
    tree.beginModel(len(triangles), len(vertices))
    tree.addSubModel(np.asarray(vertices), np.asarray(triangles))
    tree.endModel()
    return fcl.CollisionObject(tree, fcl.Transform())


def _spoken(body: str) -> str:
    """The name of a body for a sentence."""
    if not body.startswith(HAND):
        return body
    return f"the hand ({body.removeprefix(HAND)})"
