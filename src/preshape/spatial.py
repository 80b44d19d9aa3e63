"""Rotations, poses, screws, wrenches and twists: pure functions on arrays.

Conventions: quaternions are wxyz; a pose ``T_a_b`` (4×4) maps coordinates in frame b to coordinates in
frame a; a pose as seven numbers is x y z w x y z [m]; a wrench is (force, torque) about a stated point; a
twist is (linear, angular) about the frame's origin. Functions marked (...) take any leading dimensions.
"""

from __future__ import annotations

import enum

import numpy as np
from numpy.typing import ArrayLike

from .exceptions import InputError
from .types import Array, freeze, frozen_array, value

# Below this much rotation [rad], translation [m], or force relative to its wrench, there is none: rounding
# leaves about 1e-16, and dropping this much keeps every round trip within 1e-12.
_NOTHING = 1e-13
# (θ - sin θ) / θ³ as a series in θ², lowest power first; at θ = 0.5 the first term left out is 1e-19.
_SERIES = 1.0 / np.array([6.0, -120.0, 5040.0, -362880.0, 39916800.0, -6227020800.0, 1307674368000.0])


def _floats(data: ArrayLike) -> Array:
    return np.asarray(data, dtype=np.float64)


def skew(vector: ArrayLike) -> Array:
    """(..., 3, 3) matrix K with K p = vector × p."""
    x, y, z = np.moveaxis(_floats(vector), -1, 0)
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)


def _coefficients(angle: Array) -> tuple[Array, Array, Array]:
    """The ratios sin θ/θ, (1 - cos θ)/θ² and (θ - sin θ)/θ³, exact to rounding down to θ = 0."""
    theta = np.where(angle > 0.0, angle, 1.0)
    a = np.where(angle > 0.0, np.sin(theta) / theta, 1.0)
    half = np.where(angle > 0.0, np.sin(theta / 2) / (theta / 2), 1.0)
    large = np.where(angle > 0.5, angle, 1.0)
    series = np.polynomial.polynomial.polyval(np.minimum(angle, 0.5) ** 2, _SERIES)
    c = np.where(angle > 0.5, (large - np.sin(large)) / large**3, series)
    return a, half**2 / 2, c


def rotation_from_vector(vector: ArrayLike) -> Array:
    """(..., 3, 3) rotation about ``vector`` (..., 3) by its length [rad] (Rodrigues)."""
    r = _floats(vector)
    a, b, _ = _coefficients(np.linalg.norm(r, axis=-1)[..., None, None])
    k = skew(r)
    return np.eye(3) + a * k + b * (k @ k)


def quaternion_from_vector(vector: ArrayLike) -> Array:
    """(..., 4) unit quaternion wxyz of a rotation vector (..., 3) [rad]."""
    r = _floats(vector)
    half = np.linalg.norm(r, axis=-1, keepdims=True) / 2
    return np.concatenate([np.cos(half), r * _coefficients(half)[0] / 2], axis=-1)


def _standard_sign(quaternion: Array) -> Array:
    """Of q and -q the one whose first non-zero component is positive."""
    first = np.argmax(quaternion != 0.0, axis=-1)[..., None]
    return np.where(np.take_along_axis(quaternion, first, axis=-1) < 0.0, -quaternion, quaternion)


def vector_from_quaternion(quaternion: ArrayLike) -> Array:
    """(..., 3) rotation vector [rad], length 0..π, of a quaternion wxyz of any non-zero length.

    A half turn has two: the one whose first non-zero component is positive is returned.
    """
    q = _standard_sign(_floats(quaternion))
    w, v = q[..., :1], q[..., 1:]
    n = np.linalg.norm(v, axis=-1, keepdims=True)
    safe_n, safe_w = np.where(n > 0.0, n, 1.0), np.where(w > 0.0, w, 1.0)
    # An n that underflows cancels: both of its uses are the same number.
    return np.where(n > 0.0, v * (2 * np.arctan2(n, w) / safe_n), 2 * v / safe_w)


def rotation_from_quaternion(quaternion: ArrayLike) -> Array:
    """(..., 3, 3) rotation of a quaternion wxyz (..., 4), normalised first.

    Raises:
        InputError: the quaternion is zero or not finite.
    """
    q = _floats(quaternion)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not np.all(np.isfinite(norm) & (norm > 0.0)):
        raise InputError(f"a quaternion wxyz must be finite and not zero, got {q!s:.80}")
    q = q / norm
    w, k = q[..., 0, None, None], skew(q[..., 1:])
    rotation: Array = np.eye(3) + 2 * (w * k + k @ k)
    return rotation


def quaternion_from_rotation(rotation: ArrayLike) -> Array:
    """(..., 4) unit quaternion wxyz, w ≥ 0, of a rotation (..., 3, 3) (Shepperd: exact at every angle)."""
    r = _floats(rotation)
    # Four times the outer product q qᵀ; its row with the largest diagonal element loses no digits.
    outer = np.empty((*r.shape[:-2], 4, 4))
    trace = np.trace(r, axis1=-2, axis2=-1)
    outer[..., 0, 0] = 1 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        outer[..., 0, 1 + i] = outer[..., 1 + i, 0] = r[..., k, j] - r[..., j, k]
        outer[..., 1 + i, 1 + i] = 1 + 2 * r[..., i, i] - trace
        outer[..., 1 + i, 1 + j] = outer[..., 1 + j, 1 + i] = r[..., i, j] + r[..., j, i]
    best = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :]
    return _standard_sign(row / np.linalg.norm(row, axis=-1, keepdims=True))


def vector_from_rotation(rotation: ArrayLike) -> Array:
    """(..., 3) rotation vector [rad], length 0..π, of a rotation (..., 3, 3)."""
    return vector_from_quaternion(quaternion_from_rotation(rotation))


def pose(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """(..., 4, 4) pose from a rotation (..., 3, 3) and a translation (..., 3) [m]."""
    rotation, translation = _floats(rotation), _floats(translation)
    out = np.zeros((*np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1]), 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = rotation, translation, 1.0
    return out


def pose_from_seven(seven: ArrayLike) -> Array:
    """(..., 4, 4) pose from x y z [m] and a quaternion wxyz (..., 7)."""
    seven = _floats(seven)
    return pose(rotation_from_quaternion(seven[..., 3:]), seven[..., :3])


def seven_from_pose(T: ArrayLike) -> Array:
    """(..., 7) x y z [m] and a unit quaternion wxyz, w ≥ 0, of a pose (..., 4, 4)."""
    T = _floats(T)
    return np.concatenate([T[..., :3, 3], quaternion_from_rotation(T[..., :3, :3])], axis=-1)


def inverse(T_a_b: ArrayLike) -> Array:
    """``T_b_a`` of a pose ``T_a_b`` (..., 4, 4)."""
    T = _floats(T_a_b)
    rotation = np.swapaxes(T[..., :3, :3], -1, -2)
    return pose(rotation, -(rotation @ T[..., :3, 3:])[..., 0])


def transform_points(T_a_b: ArrayLike, points_b: ArrayLike) -> Array:
    """(..., 3) points in frame a from points (..., 3) in frame b [m]; one pose (4, 4)."""
    T = _floats(T_a_b)
    return _floats(points_b) @ T[:3, :3].T + T[:3, 3]


def checked_pose(T: ArrayLike, name: str) -> Array:
    """A read-only (4, 4) pose; a rotation rounded in a text file is made a rotation again.

    A rotation that is orthonormal to 1e-9 is kept bit for bit; up to 1e-3 the nearest rotation is taken.

    Raises:
        InputError: not 4×4 finite numbers, a last row other than 0 0 0 1, or no rotation.
    """
    T = frozen_array(T, (4, 4), name)
    if not np.array_equal(T[3], [0.0, 0.0, 0.0, 1.0]):
        raise InputError(f"{name} must end with the row 0 0 0 1, got {T[3]}")
    left, sizes, right = np.linalg.svd(T[:3, :3])
    off = float(np.abs(sizes - 1.0).max())
    if off > 1e-3 or np.linalg.det(T[:3, :3]) < 0.0:
        raise InputError(
            f"{name} must be a rotation and a translation; its 3×3 part has determinant "
            f"{np.linalg.det(T[:3, :3]):.4g} and singular values {sizes}: remove scale, shear and mirror"
        )
    return T if off <= 1e-9 else frozen_array(pose(left @ right, T[:3, 3]), (4, 4), name)


def wrench_about(wrench: ArrayLike, point_from: ArrayLike, point_to: ArrayLike) -> Array:
    """The same wrench (..., 6), about ``point_to`` instead of ``point_from`` (eq. 13).

    All in one frame; torques in force times the points' unit of length.
    """
    wrench = _floats(wrench)
    force = wrench[..., :3]
    torque = wrench[..., 3:] + np.cross(_floats(point_from) - _floats(point_to), force)
    return np.concatenate(np.broadcast_arrays(force, torque), axis=-1)


def twist_exp(twist: ArrayLike) -> Array:
    """(..., 4, 4) displacement reached by following a twist (..., 6) for unit time [m, rad]."""
    twist = _floats(twist)
    linear, angular = twist[..., :3], twist[..., 3:]
    return pose(rotation_from_vector(angular), (_left_jacobian(angular) @ linear[..., None])[..., 0])


def twist_log(T: ArrayLike) -> Array:
    """(..., 6) twist (linear, angular) whose :func:`twist_exp` is ``T``; rotation of at most π."""
    T = _floats(T)
    angular = vector_from_rotation(T[..., :3, :3])
    linear = np.linalg.solve(_left_jacobian(angular), T[..., :3, 3:])[..., 0]
    return np.concatenate([linear, angular], axis=-1)


def _left_jacobian(angular: Array) -> Array:
    _, b, c = _coefficients(np.linalg.norm(angular, axis=-1)[..., None, None])
    k = skew(angular)
    return np.eye(3) + b * k + c * (k @ k)


def along_screw(T: ArrayLike, fraction: ArrayLike) -> Array:
    """(..., 4, 4) the part ``fraction`` (...) of displacement ``T``, along its screw; 0: none, 1: all."""
    return twist_exp(_floats(fraction)[..., None] * twist_log(T))


class MotionKind(enum.Enum):
    """What a displacement is."""

    IDENTITY = "nothing moves: there is no axis"
    TRANSLATION = "a translation along the direction; the axis may be anywhere"
    SCREW = "a rotation about the axis with a translation along it (which may be zero)"


@value
class Screw:
    """A displacement as a screw (Chasles).

    Attributes:
        kind: what it is; the fields that follow hold zeros where the kind has none.
        direction: (3,) unit vector along the axis.
        point: (3,) the axis' point nearest the origin [m].
        angle: rotation about the axis, right-handed, 0..π [rad].
        translation: along the axis [m].
    """

    kind: MotionKind
    direction: Array
    point: Array
    angle: float
    translation: float

    def __post_init__(self) -> None:
        freeze(
            self,
            direction=frozen_array(self.direction, (3,), "screw direction"),
            point=frozen_array(self.point, (3,), "point on the screw axis"),
        )

    @property
    def pitch(self) -> float | None:
        """Translation per radian [m/rad]; ``None`` where nothing turns."""
        return self.translation / self.angle if self.kind is MotionKind.SCREW else None


def screw_from_displacement(T: ArrayLike) -> Screw:
    """The screw of a displacement (4, 4), in the frame and about the origin of ``T`` (Chasles)."""
    T = _floats(T)
    vector, t = vector_from_rotation(T[:3, :3]), T[:3, 3]
    angle, length = float(np.linalg.norm(vector)), float(np.linalg.norm(t))
    zero = np.zeros(3)
    if angle <= _NOTHING and length <= _NOTHING:
        return Screw(kind=MotionKind.IDENTITY, direction=zero, point=zero, angle=0.0, translation=0.0)
    if angle <= _NOTHING:
        kind = MotionKind.TRANSLATION
        return Screw(kind=kind, direction=t / length, point=zero, angle=0.0, translation=length)
    a = vector / angle
    along = float(a @ t)
    across = t - along * a
    # (I - R) p = across, with p perpendicular to a
    point = (across + np.cross(a, across) / np.tan(angle / 2)) / 2
    return Screw(kind=MotionKind.SCREW, direction=a, point=point, angle=angle, translation=along)


def displacement_from_screw(screw: Screw) -> Array:
    """(4, 4) the displacement of a screw, the inverse of :func:`screw_from_displacement`."""
    a, p, angle = screw.direction, screw.point, screw.angle
    # (I - R) p by Rodrigues and not as p - R p: a small angle puts the axis far away.
    turned = np.sin(angle) * np.cross(a, p) + 2 * np.sin(angle / 2) ** 2 * np.cross(a, np.cross(a, p))
    return pose(rotation_from_vector(angle * a), screw.translation * a - turned)


class WrenchKind(enum.Enum):
    """What a wrench is."""

    ZERO = "no force and no torque: there is no axis"
    COUPLE = "a torque about the direction; the axis may be anywhere"
    SCREW = "a force along the axis with a torque about it (which may be zero)"


@value
class WrenchScrew:
    """A wrench as a screw (Poinsot).

    Attributes:
        kind: what it is; the fields that follow hold zeros where the kind has none.
        direction: (3,) unit vector along the axis.
        point: (3,) the axis' point nearest the point the wrench was taken about, relative to it.
        force: along the axis, not negative.
        torque: about the axis.
    """

    kind: WrenchKind
    direction: Array
    point: Array
    force: float
    torque: float

    def __post_init__(self) -> None:
        freeze(
            self,
            direction=frozen_array(self.direction, (3,), "wrench direction"),
            point=frozen_array(self.point, (3,), "point on the wrench axis"),
        )

    @property
    def magnitude(self) -> float:
        """The force; of a couple, the torque."""
        return self.torque if self.kind is WrenchKind.COUPLE else self.force

    @property
    def pitch(self) -> float | None:
        """Torque per force, a length; ``None`` where there is no force."""
        return self.torque / self.force if self.kind is WrenchKind.SCREW else None


def screw_from_wrench(wrench: ArrayLike) -> WrenchScrew:
    """Axis, force and torque of a wrench (6,) (Poinsot).

    A force below 1e-13 of the wrench's largest component is none: its axis would be rounding.
    """
    wrench = _floats(wrench)
    zero = np.zeros(3)
    size = float(np.abs(wrench).max())
    if size == 0.0:
        return WrenchScrew(kind=WrenchKind.ZERO, direction=zero, point=zero, force=0.0, torque=0.0)
    f, m = (wrench / size).reshape(2, 3)
    force = float(np.linalg.norm(f))
    if force <= _NOTHING:
        torque = float(np.linalg.norm(m))
        kind = WrenchKind.COUPLE
        return WrenchScrew(kind=kind, direction=m / torque, point=zero, force=0.0, torque=torque * size)
    a = f / force
    return WrenchScrew(
        kind=WrenchKind.SCREW,
        direction=a,
        point=np.cross(a, m) / force,
        force=force * size,
        torque=float(a @ m) * size,
    )


def wrench_from_screw(screw: WrenchScrew) -> Array:
    """(6,) the wrench of a screw, about the origin of ``screw.point``."""
    force = screw.force * screw.direction
    return np.concatenate([force, screw.torque * screw.direction + np.cross(screw.point, force)])
