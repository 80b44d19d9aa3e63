"""Rotations, poses, screws, wrenches and twists: pure functions on arrays.

Conventions: a quaternion is wxyz; a pose ``T_a_b`` (4×4) maps coordinates in frame b to coordinates in
frame a; a pose as seven numbers is x y z w x y z [m]; a wrench is (force, torque) about a stated point; a
twist is (linear, angular) about the frame's origin. ``(...)`` in a shape stands for any leading dimensions.

SciPy computes the screws. It is imported inside the functions, because importing it takes 0.4 s. What a
recalled answer needs, the conversions of rotations, does without; operations and their order are SciPy's, so
that the digits are.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from .exceptions import InputError
from .types import Array, freeze, frozen_array, value

# A rotation [rad], translation [m] or share of force in a wrench below this counts as zero. Rounding errors
# are about 1e-16, and dropping values below this limit keeps every round trip within 1e-12.
_NOTHING = 1e-13
_SMALL = 1e-3  # angle up to which series replace quotients of angle and sine [rad]
_ORTHONORMAL = 1e-12  # deviation of R Rᵀ from 1 up to which a matrix counts as a rotation


def _floats(data: ArrayLike) -> Array:
    return np.asarray(data, dtype=np.float64)


def _writable(data: ArrayLike) -> Array:
    """A copy; SciPy's rotations refuse read-only arrays."""
    return np.array(data, dtype=np.float64)


def _by_libm(function: Callable[..., float], *values: Array) -> Array:
    """A function of :mod:`math` of each value; NumPy's own may differ in the last digit by processor."""
    each = map(function, *(np.ravel(value).tolist() for value in values))
    return np.reshape(np.fromiter(each, dtype=np.float64), np.shape(values[0]))


def _unit(w: Array, x: Array, y: Array, z: Array) -> Array:
    """The components of quaternions, divided by their lengths."""
    return np.array([w, x, y, z]) / np.sqrt(x * x + y * y + z * z + w * w)


def skew(vector: ArrayLike) -> Array:
    """(..., 3, 3) matrix K with K p = vector × p."""
    v = _floats(vector)
    matrix = np.zeros((*v.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[..., i, j], matrix[..., j, i] = -v[..., k], v[..., k]
    return matrix


def rotation_from_vector(vector: ArrayLike) -> Array:
    """(..., 3, 3) rotation about ``vector`` (..., 3) by its length [rad]."""
    v = np.moveaxis(_floats(vector), -1, 0)
    angle = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    small, square = angle <= _SMALL, angle * angle
    series = 0.5 - square / 48 + square * square / 3840
    x, y, z = v * np.where(small, series, _by_libm(math.sin, angle / 2) / np.where(small, 1.0, angle))
    w = _by_libm(math.cos, angle / 2)
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    rows = [
        [xx - yy - zz + ww, 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), -xx + yy - zz + ww, 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), -xx - yy + zz + ww],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def vector_from_rotation(rotation: ArrayLike) -> Array:
    """(..., 3) rotation vector [rad], length 0..π, of a rotation (..., 3, 3).

    A half turn has two such vectors; the one whose first non-zero component is positive is returned.
    """
    w, x, y, z = np.moveaxis(quaternion_from_rotation(rotation), -1, 0)
    w, x, y, z = _unit(w, x, y, z)
    angle = 2 * _by_libm(math.atan2, np.sqrt(x * x + y * y + z * z), w)
    small, square = angle <= _SMALL, angle * angle
    series = 2 + square / 12 + 7 * square * square / 2880
    scale = np.where(small, series, angle / np.where(small, 1.0, _by_libm(math.sin, angle / 2)))
    return np.stack([x, y, z], axis=-1) * scale[..., None]


def rotation_from_quaternion(quaternion: ArrayLike) -> Array:
    """(..., 3, 3) rotation of a quaternion wxyz (..., 4) of any length but zero.

    It does not use SciPy, because loading a hand needs it and must not wait for that import.

    Raises:
        InputError: The quaternion is zero or not finite.
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
    """(..., 4) unit quaternion wxyz of a rotation (..., 3, 3); its first non-zero component is positive.

    A matrix that is orthonormal only to rounding of a text file gives the quaternion of the nearest rotation.

    Raises:
        InputError: The matrix has no positive determinant, or numbers that are not finite.
    """
    R = _floats(rotation)
    if not np.isfinite(R).all() or (np.linalg.det(R) <= 0.0).any():
        raise InputError(f"a rotation must have determinant 1, got {R!s:.80}")
    off = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(-2, -1)) > _ORTHONORMAL
    if off.any():
        left, _, right = np.linalg.svd(R)
        R = np.where(off[..., None, None], left @ right, R)
    # Each row is x y z w times four times one of them; the largest is most accurate.
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(R, (-2, -1), (0, 1))
    trace = xx + yy + zz
    rows = np.array(
        [
            [1 - trace + 2 * xx, yx + xy, zx + xz, zy - yz],
            [yx + xy, 1 - trace + 2 * yy, zy + yz, xz - zx],
            [zx + xz, zy + yz, 1 - trace + 2 * zz, yx - xy],
            [zy - yz, xz - zx, yx - xy, 1 + trace],
        ]
    )
    largest = np.array([xx, yy, zz, trace]).argmax(axis=0)
    x, y, z, w = np.take_along_axis(rows, largest[None, None], axis=0)[0]
    q = np.moveaxis(_unit(w, x, y, z), 0, -1)
    first = np.take_along_axis(q, (q != 0.0).argmax(axis=-1)[..., None], axis=-1)
    quaternion: Array = np.where(first < 0.0, -q, q)
    return quaternion


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
    """(..., 4, 4) pose ``T_b_a`` of a pose ``T_a_b`` (..., 4, 4)."""
    T = _floats(T_a_b)
    rotation = np.swapaxes(T[..., :3, :3], -1, -2)
    return pose(rotation, -(rotation @ T[..., :3, 3:])[..., 0])


def transform_points(T_a_b: ArrayLike, points_b: ArrayLike) -> Array:
    """(..., 3) points in frame a [m] of points (..., 3) in frame b [m], by one pose (4, 4)."""
    T = _floats(T_a_b)
    return _floats(points_b) @ T[:3, :3].T + T[:3, 3]


def checked_pose(T: ArrayLike, name: str) -> Array:
    """A read-only (4, 4) pose, with rounding errors of a text file removed from its rotation part.

    A rotation part that is orthonormal to 1e-9 is not changed at all; one that is orthonormal to 1e-3 is
    replaced by the nearest rotation.

    Raises:
        InputError: ``T`` is not 4×4 finite numbers, its last row is not 0 0 0 1, or its 3×3 part is not a
            rotation.
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
    """(..., 6) the same wrench about ``point_to`` instead of ``point_from`` (eq. 13).

    Wrench and points are in the same frame; the unit of torque is force times the unit of the points.
    """
    wrench = _floats(wrench)
    force = wrench[..., :3]
    torque = wrench[..., 3:] + np.cross(_floats(point_from) - _floats(point_to), force)
    return np.concatenate(np.broadcast_arrays(force, torque), axis=-1)


def twist_exp(twist: ArrayLike) -> Array:
    """(..., 4, 4) displacement reached by following a twist (..., 6) for unit time [m, rad]."""
    from scipy.spatial.transform import RigidTransform

    # SciPy's order is (angular, linear).
    return RigidTransform.from_exp_coords(np.roll(_floats(twist), 3, axis=-1)).as_matrix()


def twist_log(T: ArrayLike) -> Array:
    """(..., 6) twist (linear, angular) whose :func:`twist_exp` is ``T``.

    The angular part is :func:`vector_from_rotation`: a rotation of at most π.
    """
    from scipy.spatial.transform import RigidTransform

    T = _writable(T)
    angular, linear = np.split(RigidTransform.from_matrix(T).as_exp_coords(), 2, axis=-1)
    # SciPy may choose the other vector of a half turn; the linear part then differs by angular × translation.
    standard = vector_from_rotation(T[..., :3, :3])
    other = (angular * standard).sum(axis=-1, keepdims=True) < 0.0
    linear = np.where(other, linear + np.cross(angular, T[..., :3, 3]), linear)
    return np.concatenate([linear, np.where(other, -angular, angular)], axis=-1)


def along_screw(T: ArrayLike, fraction: ArrayLike) -> Array:
    """(..., 4, 4) displacement after a fraction (...) of ``T``, 0 to 1, along the screw of ``T``."""
    return twist_exp(_floats(fraction)[..., None] * twist_log(T))


class MotionKind(enum.Enum):
    """The kinds of rigid displacement."""

    IDENTITY = "no motion, and so no axis"
    TRANSLATION = "a translation along the direction; the axis may lie anywhere"
    SCREW = "a rotation about the axis and a translation along it, which may be zero"


@value
class Screw:
    """A displacement as a screw (Chasles).

    Attributes:
        kind: Kind of displacement. Quantities that this kind does not have are zero.
        direction: (3,) unit vector along the axis.
        point: (3,) point of the axis nearest the origin [m].
        angle: Right-handed rotation about the axis, 0..π [rad].
        translation: Translation along the axis [m].
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
        """Translation per radian [m/rad]; ``None`` without a rotation."""
        return self.translation / self.angle if self.kind is MotionKind.SCREW else None


def screw_from_displacement(T: ArrayLike) -> Screw:
    """The screw of a displacement (4, 4), in the frame of ``T`` and about its origin (Chasles)."""
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
    # Solution of (I - R) p = across for the p that is perpendicular to a.
    point = (across + np.cross(a, across) / np.tan(angle / 2)) / 2
    return Screw(kind=MotionKind.SCREW, direction=a, point=point, angle=angle, translation=along)


def displacement_from_screw(screw: Screw) -> Array:
    """(4, 4) displacement of a screw; the inverse of :func:`screw_from_displacement`."""
    a, p, angle = screw.direction, screw.point, screw.angle
    # R p - p by Rodrigues' formula: for a small angle, p is far away and plain subtraction loses digits.
    turned = np.sin(angle) * np.cross(a, p) + 2 * np.sin(angle / 2) ** 2 * np.cross(a, np.cross(a, p))
    return pose(rotation_from_vector(angle * a), screw.translation * a - turned)


class WrenchKind(enum.Enum):
    """The kinds of wrench."""

    ZERO = "no force and no torque, and so no axis"
    COUPLE = "a torque about the direction; the axis may lie anywhere"
    SCREW = "a force along the axis and a torque about it, which may be zero"


@value
class WrenchScrew:
    """A wrench as a screw (Poinsot).

    Attributes:
        kind: Kind of wrench. Quantities that this kind does not have are zero.
        direction: (3,) unit vector along the axis.
        point: (3,) point of the axis nearest the reference point of the wrench, relative to that point.
        force: Force along the axis, not negative.
        torque: Torque about the axis.
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
        """The force, or the torque of a couple."""
        return self.torque if self.kind is WrenchKind.COUPLE else self.force

    @property
    def pitch(self) -> float | None:
        """Torque per force, a length; ``None`` without a force."""
        return self.torque / self.force if self.kind is WrenchKind.SCREW else None


def screw_from_wrench(wrench: ArrayLike) -> WrenchScrew:
    """Axis, force and torque of a wrench (6,) (Poinsot).

    A force below 1e-13 times the wrench's largest component counts as zero, because its axis would be noise.
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
    """(6,) wrench of a screw, about the origin of ``screw.point``."""
    force = screw.force * screw.direction
    return np.concatenate([force, screw.torque * screw.direction + np.cross(screw.point, force)])
