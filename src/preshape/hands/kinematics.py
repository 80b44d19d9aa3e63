"""Forward kinematics of a hand by MuJoCo: fingertips, link points, Jacobians, and the shapes of the links.

MuJoCo is imported where it is used. The compiled model of a hand is cached for the process and never changed.
Every :class:`HandKinematics` has a state of its own, so each thread can use one.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from ..exceptions import HandError
from ..spatial import inverse, quaternion_from_rotation, rotation_from_quaternion
from ..types import Array, IntArray, value
from .hand import Finger, Hand
from .hulls import LinkHull, hulls

_SIGNS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_SLENDER = 0.8
"""Radius of the capsule that stands for a hull, in radii of the sphere about its middle [C]."""
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


@value
class LinkShape:
    """One primitive shape of a hand in a given posture.

    Attributes:
        kind: ``capsule``, ``sphere``, ``box`` or ``hull``.
        link: Name of the shape in the MJCF, such as ``index_distal``.
        body: Name of its body.
        p0: (3,) one end of a capsule's axis, or the centre [m]; of a hull, the origin of its frame.
        p1: (3,) the other end of the axis, or the centre [m].
        radius: Radius of a capsule or sphere [m]; 0 otherwise.
        half: (3,) half sizes of a box [m]; zero otherwise.
        rotation: (3, 3) the shape's axes as columns; a capsule lies along the third.
        hull: A hull in its own frame; ``None`` for the other kinds.
    """

    kind: str
    link: str
    body: str
    p0: Array
    p1: Array
    radius: float
    half: Array
    rotation: Array
    hull: LinkHull | None = None

    @property
    def corners(self) -> Array:
        """(n, 3) points whose hull, grown by ``radius``, is the shape [m]."""
        if self.hull is not None:
            return np.asarray(self.hull.corners @ self.rotation.T + self.p0)
        if self.kind == "box":
            return np.asarray((_SIGNS * self.half) @ self.rotation.T + self.p0)
        return np.stack([self.p0, self.p1])


@cache
def compile_hand(hand: Hand) -> Any:
    """The hand's ``mujoco.MjModel``, compiled once per process; do not change it.

    Its root body is placed so that the palm frame is the world frame.

    Raises:
        HandError: MuJoCo cannot read the MJCF, or the joints of the model are not in the hand's order.
    """
    import mujoco

    try:
        model = mujoco.MjModel.from_xml_string(hand.mjcf)
    except ValueError as error:
        raise HandError(f"hand {hand.name!r}: MuJoCo refuses the MJCF: {error}") from error
    names = tuple(model.joint(i).name for i in range(model.njnt))
    if names != hand.joints or model.nq != len(names):
        raise HandError(f"hand {hand.name!r}: the MJCF must have exactly the hinges {', '.join(hand.joints)}")
    if not np.array_equal(hand.T_root_palm, np.eye(4)):
        T_palm_root = inverse(hand.T_root_palm)
        model.body_pos[1], model.body_quat[1] = (
            T_palm_root[:3, 3],
            quaternion_from_rotation(T_palm_root[:3, :3]),
        )
    return model


@cache
def hand_hulls(hand: Hand) -> dict[int, LinkHull]:
    """The hull of each geom of the hand's model that is a mesh, in the geom's frame."""
    import mujoco

    model = compile_hand(hand)
    geoms = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH).tolist()
    clouds = []
    for geom in geoms:
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        clouds.append(model.mesh_vert[first : first + count].astype(np.float64))
    return dict(zip(geoms, hulls(clouds) if geoms else (), strict=True))


def joint_links(hand: Hand) -> tuple[str, ...]:
    """Name of the body that each joint of the hand moves, in the order of the hand's joints."""
    model = compile_hand(hand)
    return tuple(str(model.body(int(body)).name) for body in model.jnt_bodyid)


def cross(a: Array, b: Array) -> Array:
    """Cross product along the last axis; several times faster than ``numpy.cross`` on small arrays."""
    return np.asarray(a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT])


def _moves(model: Any) -> Array:
    """(bodies, joints) 1 if the joint moves the body, else 0."""
    moves = np.zeros((model.nbody, model.njnt))
    for body in range(1, model.nbody):
        moves[body] = moves[model.body_parentid[body]]
        moves[body, model.jnt_bodyid == body] = 1.0
    return moves


def finger_of(hand: Hand, shape: LinkShape) -> str:
    """Name of the finger whose joints move a shape; ``palm`` if no joint moves it."""
    model = compile_hand(hand)
    carried = _moves(model)[model.body(shape.body).id]
    return next((f.name for f in hand.fingers if carried[hand.columns(f.name)].any()), "palm")


class HandKinematics:
    """Positions and Jacobians of one posture, in the palm frame.

    Args:
        hand: The hand.
    """

    def __init__(self, hand: Hand) -> None:
        import mujoco

        self.hand = hand
        self.model = compile_hand(hand)
        self._mujoco = mujoco
        self._data = mujoco.MjData(self.model)
        self._sites = {finger.name: self.model.site(finger.tip_site).id for finger in hand.fingers}
        self._tip_bodies = {finger.name: self.model.body(finger.tip_body).id for finger in hand.fingers}
        capsule = self.model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE
        self.half_lengths = np.where(capsule, self.model.geom_size[:, 1], 0.0)
        # A box counts as the largest sphere in it here; the exact check uses the box.
        box = self.model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
        self.radii = np.where(box, self.model.geom_size.min(axis=1), self.model.geom_size[:, 0])
        # A hull counts as a slender capsule along its third axis, about which its inertia is least.
        self._hulls = hand_hulls(hand)
        for geom, solid in self._hulls.items():
            normals, offsets = solid.planes[:, :3], solid.planes[:, 3]
            self.radii[geom] = _SLENDER * max(float(offsets.min()), 0.0)
            room = (offsets - self.radii[geom]) / np.maximum(np.abs(normals[:, 2]), 1e-9)
            self.half_lengths[geom] = max(float(room.min()), 0.0)
        self._moves = _moves(self.model)

    def set_posture(self, q: Array) -> None:
        """Set the joint angles [rad], in the order of ``hand.joints``."""
        self._data.qpos[:] = q
        self._mujoco.mj_kinematics(self.model, self._data)

    def tips(self, fingers: tuple[Finger, ...]) -> tuple[Array, Array]:
        """(k, 3) centres of the spherical fingertips [m] and (k, 3) unit directions of the last phalanges."""
        sites = [self._sites[finger.name] for finger in fingers]
        axes = self._data.site_xmat.reshape(-1, 3, 3)[sites, :, 2]
        return np.array(self._data.site_xpos[sites]), np.array(axes)

    def tip_jacobians(self, fingers: tuple[Finger, ...]) -> tuple[Array, Array]:
        """(k, 3, n) Jacobians of the tips' centres [m/rad] and directions [1/rad] in the joint angles."""
        bodies = np.array([self._tip_bodies[finger.name] for finger in fingers])
        centres, axes = self.tips(fingers)
        return self.point_jacobians(bodies, centres), cross(self._turns(bodies), axes[:, None]).transpose(
            0, 2, 1
        )

    def point_jacobians(self, bodies: IntArray, points: Array) -> Array:
        """(k, 3, n) Jacobians [m/rad] in the joint angles of points (k, 3) [m] fixed to bodies (k,)."""
        # A hinge that moves the body turns the point about its anchor: dp/dq = axis × (p - anchor).
        arms = points[:, None] - self._data.xanchor
        return cross(self._turns(bodies), arms).transpose(0, 2, 1)

    def _turns(self, bodies: IntArray) -> Array:
        return np.asarray(self._moves[bodies][:, :, None] * self._data.xaxis)

    def shapes(self) -> list[LinkShape]:
        """All collision shapes in the palm frame, the palm first.

        Raises:
            HandError: A shape is not a capsule, a sphere, a box or a mesh.
        """
        return [self._shape(geom) for geom in range(self.model.ngeom)]

    def axes(self) -> tuple[Array, Array]:
        """(m, 3), (m, 3) both ends of every shape's axis [m], in the order of :meth:`shapes`."""
        centre = self._data.geom_xpos
        along = self._data.geom_xmat.reshape(-1, 3, 3)[:, :, 2] * self.half_lengths[:, None]
        return centre - along, centre + along

    def _shape(self, geom: int) -> LinkShape:
        kinds = self._mujoco.mjtGeom
        rotation = np.array(self._data.geom_xmat[geom].reshape(3, 3))
        centre, size = np.array(self._data.geom_xpos[geom]), self.model.geom_size[geom]
        name = self.model.geom(geom).name
        kind = int(self.model.geom_type[geom])
        along, radius, half = np.zeros(3), 0.0, np.zeros(3)
        if kind == kinds.mjGEOM_CAPSULE:
            word, radius, along = "capsule", float(size[0]), rotation[:, 2] * size[1]
        elif kind == kinds.mjGEOM_SPHERE:
            word, radius = "sphere", float(size[0])
        elif kind == kinds.mjGEOM_BOX:
            word, half = "box", np.array(size)
        elif kind == kinds.mjGEOM_MESH:
            word = "hull"
        else:
            raise HandError(f"{self.hand.name}: shape {name} must be a capsule, a sphere, a box or a mesh")
        return LinkShape(
            kind=word,
            link=name,
            body=self.model.body(int(self.model.geom_bodyid[geom])).name,
            p0=centre - along,
            p1=centre + along,
            radius=radius,
            half=half,
            rotation=rotation,
            hull=self._hulls.get(geom),
        )

    def collides(self, depth: float = 0.0) -> bool:
        """Whether two links overlap by more than ``depth`` [m]; see :meth:`self_collisions`."""
        self._mujoco.mj_collision(self.model, self._data)
        return bool((self._data.contact.dist < -depth).any())

    def self_collisions(self, depth: float = 0.0) -> list[tuple[str, str, float]]:
        """Pairs of links that overlap by more than ``depth`` [m]: two names and the overlap [m].

        MuJoCo computes the collisions; pairs that the MJCF excludes are left out.
        """
        self._mujoco.mj_collision(self.model, self._data)
        return [
            (self.model.geom(contact.geom1).name, self.model.geom(contact.geom2).name, -float(contact.dist))
            for contact in self._data.contact
            if -contact.dist > depth
        ]


def pose_matrix(pose: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) [m] of a pose (7,): x y z [m], quaternion w x y z."""
    return rotation_from_quaternion(pose[3:]), np.array(pose[:3], dtype=np.float64)


def pose_vector(rotation: Array, translation: Array) -> Array:
    """(7,) pose x y z w x y z of a rotation (3, 3) and a translation (3,) [m]; w ≥ 0."""
    return np.array([*translation, *quaternion_from_rotation(rotation)])


def move_shape(shape: LinkShape, rotation: Array, translation: Array) -> LinkShape:
    """The shape moved by x → R x + t."""
    return LinkShape(
        kind=shape.kind,
        link=shape.link,
        body=shape.body,
        p0=rotation @ shape.p0 + translation,
        p1=rotation @ shape.p1 + translation,
        radius=shape.radius,
        half=shape.half,
        rotation=rotation @ shape.rotation,
        hull=shape.hull,
    )


def hand_geometry(hand: Hand, palm_pose: Array, q: Array) -> list[LinkShape]:
    """Every shape of a hand in the mesh frame, the palm first.

    Args:
        hand: The hand.
        palm_pose: (7,) x y z w x y z of T_mesh_palm [m].
        q: (n,) joint angles [rad].
    """
    kinematics = HandKinematics(hand)
    kinematics.set_posture(q)
    rotation, translation = pose_matrix(palm_pose)
    return [move_shape(shape, rotation, translation) for shape in kinematics.shapes()]
