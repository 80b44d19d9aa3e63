"""Kinematics of a foreign model as its file states it: joints, laws, and the geometry of its links.

:mod:`preshape.hands.anatomy` reads the fingers of an unknown model from it. Positions are in the model's
world frame, angles in rad, and every posture obeys the laws (``couples``) of the model.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..exceptions import HandError
from ..spatial import inverse, pose, rotation_from_quaternion
from ..types import Array, value
from .compiled import CompiledModel
from .couples import Table, couple_joints, couple_motor, lawful_limits
from .motors import RIGID, Motor, direct_motor

KNOTS = 9
"""Postures by which the motion of one motor is described."""


@value
class Drive:
    """What one motor moves within one finger.

    Attributes:
        motor: Name of the motor; that of the joint if no law concerns it.
        joints: Names of the joints that it moves.
        knots: (KNOTS, joints) their angles [rad], evenly spaced over the motor's range, lowest first.
    """

    motor: str
    joints: tuple[str, ...]
    knots: Array


class Skeleton:
    """One model, whose posture can be set.

    Args:
        source: The compiled model.
        couples: Laws in the form of ``[[couple]]`` of a description; see docs/your-own-hand.md.
    """

    def __init__(self, source: CompiledModel, couples: Iterable[Table] = ()) -> None:
        import mujoco

        self.source, self.m = source, source.model
        self._mujoco = mujoco
        self._data = mujoco.MjData(self.m)
        turning = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        self._places = {
            joint: int(self.m.joint(joint).qposadr[0])
            for joint in source.joints
            if int(self.m.jnt_type[self.m.joint(joint).id]) in turning
        }
        couples = tuple(couples)
        limits = lawful_limits(
            {joint: source.ranges[joint] for joint in source.hinges}, couples, source.label
        )
        motors = {joint: direct_motor(joint, limits[joint]) for joint in source.hinges}
        for couple in couples:
            for joint in couple_joints(couple):
                if joint not in limits:
                    raise HandError(
                        f"{source.label}: the law of the motor {couple['motor']} names {joint!r}, which is "
                        f"no hinge of the model; its hinges are {', '.join(list(limits)[:12])}"
                    )
            motor = couple_motor(couple, limits, source.label)
            motors |= dict.fromkeys(couple_joints(couple), motor)
        self.motors: dict[str, Motor] = motors
        """The motor of every hinge."""
        self.neutral = {joint: self._nearest_zero(joint) for joint in source.joints}
        self.neutral = self.lawful({})
        self.place({})

    def _nearest_zero(self, joint: str) -> float:
        low, high = sorted(self.source.ranges[joint])
        return float(np.clip(0.0, low, high)) if low < high else 0.0

    def lawful(self, given: Mapping[str, float]) -> dict[str, float]:
        """Angles of all joints: those given, else neutral; the dependents of a rigid law as it says."""
        angles = {**self.neutral, **given}
        for motor in set(self.motors.values()):
            if motor.law == RIGID:
                q = motor.angles(np.clip(angles[motor.name], *motor.range))
                angles |= {joint: float(x) for joint, x in zip(motor.joints, q, strict=True)}
        return angles

    def place(self, given: Mapping[str, float]) -> None:
        """Set the posture; joints that are not given stand at their neutral or lawful angle."""
        self._data.qpos[:] = self.m.qpos0
        for joint, angle in self.lawful(given).items():
            if joint in self._places:
                self._data.qpos[self._places[joint]] = angle
        self._mujoco.mj_kinematics(self.m, self._data)

    def body_of(self, joint: str) -> int:
        """Index of the body that the joint moves."""
        return int(self.m.joint(joint).bodyid[0])

    def anchor(self, joint: str) -> Array:
        """(3,) a point of the joint's axis [m]."""
        return np.array(self._data.xanchor[self.m.joint(joint).id])

    def axis(self, joint: str) -> Array:
        """(3,) unit vector of the joint's axis."""
        return np.array(self._data.xaxis[self.m.joint(joint).id])

    def frame(self, body: int) -> Array:
        """(4, 4) pose of a body."""
        return pose(self._data.xmat[body].reshape(3, 3), self._data.xpos[body])

    def drives(self, joints: tuple[str, ...]) -> tuple[Drive, ...]:
        """The motors that move the joints of a finger, in the order of their first joint."""
        found = []
        for motor in dict.fromkeys(self.motors[joint] for joint in joints):
            own = [k for k, joint in enumerate(motor.joints) if joint in joints]
            low, high = (float(bound) for bound in motor.range)
            found.append(
                Drive(
                    motor=motor.name,
                    joints=tuple(motor.joints[k] for k in own),
                    knots=motor.angles(np.linspace(low, high, KNOTS))[:, own],
                )
            )
        return tuple(found)

    def vertices(self, body: int) -> tuple[Array, bool]:
        """Points (n, 3) [m] of the shapes of a body and of what is welded to it, in the body's frame.

        Those of the shapes that collide; of the others if none does. The second value says which.
        """
        members = np.flatnonzero(self.m.body_weldid == self.m.body_weldid[body])
        mine = np.isin(self.m.geom_bodyid, members)
        solid = mine & ((self.m.geom_contype > 0) | (self.m.geom_conaffinity > 0))
        T_body_world = inverse(self.frame(body))
        parts = []
        for g in np.flatnonzero(solid if solid.any() else mine):
            T = T_body_world @ self.frame(int(self.m.geom_bodyid[g]))
            T = T @ pose(rotation_from_quaternion(self.m.geom_quat[g]), self.m.geom_pos[g])
            points = _geom_points(self.m, int(g))
            parts.append(points @ T[:3, :3].T + T[:3, 3])
        return np.concatenate([np.zeros((0, 3)), *parts]), bool(solid.any())


def _geom_points(m: Any, g: int) -> Array:
    """Points on the surface of a shape, in the shape's frame [m]."""
    import mujoco

    kinds, size = mujoco.mjtGeom, m.geom_size[g]
    kind = int(m.geom_type[g])
    if kind == kinds.mjGEOM_MESH:
        mesh = int(m.geom_dataid[g])
        start, count = int(m.mesh_vertadr[mesh]), int(m.mesh_vertnum[mesh])
        return np.asarray(m.mesh_vert[start : start + count], dtype=np.float64)
    turn = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    height = np.linspace(-1.0, 1.0, 7)
    ring = np.sqrt(1 - height**2)
    ball = np.stack(
        [
            np.outer(np.cos(turn), ring).ravel(),
            np.outer(np.sin(turn), ring).ravel(),
            np.tile(height, len(turn)),
        ],
        axis=1,
    )
    if kind == kinds.mjGEOM_SPHERE:
        return np.asarray(ball * size[0])
    if kind == kinds.mjGEOM_ELLIPSOID:
        return np.asarray(ball * size)
    if kind == kinds.mjGEOM_CAPSULE:
        return np.asarray(
            np.concatenate([ball * size[0] + [0, 0, size[1]], ball * size[0] - [0, 0, size[1]]])
        )
    if kind == kinds.mjGEOM_BOX:
        steps = np.stack(np.meshgrid(*[np.linspace(-1, 1, 5)] * 3), axis=-1).reshape(-1, 3)
        return np.asarray(steps[np.abs(steps).max(axis=1) == 1] * size)
    if kind == kinds.mjGEOM_CYLINDER:
        wall = [
            np.stack([size[0] * np.cos(turn), size[0] * np.sin(turn), np.full(12, z * size[1])], axis=1)
            for z in height
        ]
        return np.concatenate(wall)
    return np.zeros((0, 3))
