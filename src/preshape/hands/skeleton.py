"""Kinematics of a foreign model as its file states it: joints, laws, and the geometry of its links.

:mod:`preshape.hands.anatomy` reads the fingers of an unknown model from it. Positions are in the model's
world frame, angles in rad, and every posture obeys the laws (``couples``) of the model.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..spatial import inverse, pose, rotation_from_quaternion
from ..types import Array, value
from .compiled import CompiledModel
from .description import Table

KNOTS = 9
"""Postures by which the motion of one motor is described."""

_FINE = 257
"""Motor angles that are tried to find the range that all joints of a motor allow."""


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
        self.couples = tuple(couples)
        rigid = [entry for entry in self.couples if "follow" in entry]
        self.follows = {
            str(joint): (str(entry["motor"]), _polynomial(law))
            for entry in rigid
            for joint, law in dict(entry["follow"]).items()
        }
        self.sums = {str(entry["motor"]): entry for entry in self.couples if "sum" in entry}
        self.motor_of = {joint: joint for joint in source.joints}
        self.motor_of |= {joint: motor for joint, (motor, _) in self.follows.items()}
        for motor, entry in self.sums.items():
            self.motor_of |= dict.fromkeys(map(str, entry["sum"]), motor)
        self.neutral = {joint: self._nearest_zero(joint) for joint in source.joints}
        self.neutral = self.lawful({})
        self.place({})

    def _nearest_zero(self, joint: str) -> float:
        low, high = sorted(self.source.ranges[joint])
        return float(np.clip(0.0, low, high)) if low < high else 0.0

    def lawful(self, given: Mapping[str, float]) -> dict[str, float]:
        """Angles of all joints: those given, else neutral; dependents as their rigid laws say."""
        angles = {**self.neutral, **given}
        for joint, (motor, law) in self.follows.items():
            if motor in angles:
                angles[joint] = float(np.polynomial.polynomial.polyval(angles[motor], law))
        return angles

    def place(self, given: Mapping[str, float]) -> None:
        """Set the posture; joints that are not given stand at their neutral or lawful angle."""
        self._data.qpos[:] = self.m.qpos0
        for joint, angle in self.lawful(given).items():
            self._data.qpos[self.m.jnt_qposadr[self.m.joint(joint).id]] = angle
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
        groups: dict[str, list[str]] = {}
        for joint in joints:
            groups.setdefault(self.motor_of[joint], []).append(joint)
        return tuple(
            Drive(motor=motor, joints=tuple(group), knots=self._knots(motor, group))
            for motor, group in groups.items()
        )

    def _knots(self, motor: str, group: list[str]) -> Array:
        if motor not in self.sums:
            low, high = self.motor_range(motor)
            values = np.linspace(low, high, KNOTS)
            laws = [self.follows[joint][1] if joint in self.follows else (0.0, 1.0) for joint in group]
            return np.stack([np.polynomial.polynomial.polyval(values, law) for law in laws], axis=1)
        entry = self.sums[motor]
        names = [str(joint) for joint in entry["sum"]]
        if "free" in entry:
            path = np.array(entry["free"], dtype=np.float64)
        else:
            # Without a stated path every joint of the couple takes the same share of its range.
            path = np.array([sorted(self.source.ranges[joint]) for joint in names]).T
        drive = path @ np.array([float(c) for c in entry["sum"].values()])
        order = np.argsort(drive)
        values = np.linspace(drive.min(), drive.max(), KNOTS)
        columns = [names.index(joint) for joint in group]
        return np.stack([np.interp(values, drive[order], path[order, k]) for k in columns], axis=1)

    def motor_range(self, motor: str) -> tuple[float, float]:
        """Range of a motor [rad] that its own joint and all dependents allow; around its neutral angle."""
        low, high = sorted(self.source.ranges[motor])
        values = np.linspace(low, high, _FINE)
        allowed = np.ones(_FINE, dtype=bool)
        for joint, (driven_by, law) in self.follows.items():
            if driven_by == motor:
                lower, upper = sorted(self.source.ranges[joint])
                angles = np.polynomial.polynomial.polyval(values, law)
                slack = 1e-6 + 2e-3 * abs(upper - lower)
                allowed &= (angles >= lower - slack) & (angles <= upper + slack)
        if not allowed.any():
            return low, high
        start = int(np.abs(np.where(allowed, values - self.neutral.get(motor, 0.0), np.inf)).argmin())
        first = last = start
        while first > 0 and allowed[first - 1]:
            first -= 1
        while last < _FINE - 1 and allowed[last + 1]:
            last += 1
        return float(values[first]), float(values[last])

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


def _polynomial(law: Any) -> tuple[float, ...]:
    """Coefficients, lowest order first, of a multiplier or of a list of coefficients."""
    return tuple(float(c) for c in law) if isinstance(law, (list, tuple)) else (0.0, float(law))


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
