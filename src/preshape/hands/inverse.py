"""Inverse kinematics of a whole hand: palm pose and joint angles that bring fingertips to given points.

This is a bounded nonlinear least-squares problem, solved by ``scipy.optimize.least_squares`` with an analytic
Jacobian.

- Unknowns: the palm's position (free), its tilt from the nominal orientation (bounded), and the commands of
the
  motors that move the fingers in use (within their ranges).
- Residuals: the errors of the fingertips; with low weights, the tilt and the posture's distance from a
  reference; and one-sided penalties that keep links out of the object and turn the last phalanges so that
  only their caps touch.

The penalties only guide the solver; the exact collision check afterwards decides
(:mod:`preshape.hands.clearance`).
"""

from __future__ import annotations

import numpy as np

from ..spatial import skew
from ..types import Array, IntArray, value
from .collision import ObjectCollision
from .hand import Finger
from .kinematics import HandKinematics, cross

TILT_LIMITS = np.radians([25.0, 11.5, 11.5])
"""Bounds of the tilt's rotation vector about the palm's x (transverse), y and z [rad]; total < 30° [C]."""

_LENGTH = 0.1  # unit of the position unknowns [m], which makes them about as large as the angles
_TIP, _LINK = 1e-3, 2e-3  # errors [m] of a fingertip and of a link that give a residual of 1
_POSTURE, _TILT, _LEAN_WEIGHT = 0.06, 0.4, 6.0  # weights of the other residuals
_LEAN = 0.10  # desired least cosine between last phalanx and inward normal
_MARGIN = 2e-3  # desired clearance of the links [m]


@value
class Reach:
    """Targets of the fingertips, in the mesh frame.

    Attributes:
        fingers: The fingers in use, in the order of the contacts.
        targets: (n, 3) targets of the centres of their spherical tips [m].
        inward: (n, 3) inward unit normals at the contacts.
        orientation: (3, 3) nominal orientation of the palm, its axes as columns.
    """

    fingers: tuple[Finger, ...]
    targets: Array
    inward: Array
    orientation: Array


@value
class Placement:
    """A palm pose and a posture.

    Attributes:
        rotation: (3, 3) rotation of the palm frame in the mesh frame.
        translation: (3,) origin of the palm frame in the mesh frame [m].
        q: (n,) all joint angles [rad].
        errors: (m,) distances of the fingertips in use from their targets [m].
    """

    rotation: Array
    translation: Array
    q: Array
    errors: Array


def rotation_exp(w: Array) -> tuple[Array, Array]:
    """Rotation matrix R (3, 3) of a rotation vector w (3,) [rad], and its right Jacobian J (3, 3).

    R(w + dw) = R(w) exp(J dw) to first order. Below 1e-4 rad a series is used, which is exact to rounding
    there.
    """
    angle = float(np.linalg.norm(w))
    matrix = skew(w)
    square = matrix @ matrix
    if angle < 1e-4:
        sine, cosine, rest = 1 - angle**2 / 6, 0.5 - angle**2 / 24, 1 / 6 - angle**2 / 120
    else:
        sine, cosine = np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2
        rest = (angle - np.sin(angle)) / angle**3
    eye = np.eye(3)
    return eye + sine * matrix + cosine * square, eye - cosine * matrix + rest * square


class InverseKinematics:
    """Solver for one hand that may keep clear of one object.

    Args:
        kinematics: Kinematics of the hand.
        obstacle: The object; with ``None``, links have no penalties.
    """

    def __init__(self, kinematics: HandKinematics, obstacle: ObjectCollision | None) -> None:
        self.kinematics = kinematics
        self.hand = kinematics.hand
        self.obstacle = obstacle
        self._links: dict[frozenset[str], tuple[IntArray, Array, IntArray, Array]] = {}

    def solve(
        self,
        reach: Reach,
        *,
        start: Placement,
        reference: Array,
        move_base: bool = True,
        limits: Array | None = None,
        avoid: bool = True,
        effort: int = 30,
    ) -> Placement:
        """Bring the fingertips to their targets.

        Args:
            reach: Fingers and targets.
            start: Where the solver begins; motors of fingers that are not in use stay there.
            reference: (n,) posture [rad] that attracts the motors with a low weight.
            move_base: Whether the palm may move and tilt; otherwise it stays at ``start``.
            limits: (m, 2) bounds of the motors' commands [rad]; by default those of the hand.
            avoid: Whether the penalties on links act.
            effort: Largest number of evaluations; with 0, only Newton steps are taken, for near targets.

        Returns:
            The best placement that was found; its ``errors`` say whether the targets are reached.
        """
        from scipy.optimize import least_squares

        problem = _Problem(self, reach, start, reference, move_base, avoid)
        bounds = self.hand.ranges() if limits is None else limits
        lower = np.r_[problem.base_lower, bounds[problem.motors, 0]]
        upper = np.r_[problem.base_upper, bounds[problem.motors, 1]]
        z = np.clip(problem.z0, lower + 1e-6, upper - 1e-6)
        if not effort:
            return problem.polish(z, lower, upper)
        z = least_squares(
            problem.residual,
            z,
            problem.jacobian,
            (lower, upper),
            xtol=1e-5,
            ftol=1e-4,
            gtol=1e-6,
            max_nfev=effort,
        ).x
        return problem.polish(z, lower, upper)

    def links(self, fingers: tuple[Finger, ...]) -> tuple[IntArray, Array, IntArray, Array]:
        """Points of the palm and of the fingers in use that the penalties keep out of the object.

        They lie on the axes of the links. The fingertips and the outer half of the last phalanges are left
        out, because they should be near the object.

        Returns:
            (k,) index of the shape, fraction along its axis, index of the body, and radius [m] of each point.
        """
        key = frozenset(finger.name for finger in fingers)
        if key not in self._links:
            self._links[key] = self._choose(fingers)
        return self._links[key]

    def _choose(self, fingers: tuple[Finger, ...]) -> tuple[IntArray, Array, IntArray, Array]:
        model = self.kinematics.model
        joints = {joint for finger in self.hand.fingers if finger not in fingers for joint in finger.joints}
        idle = {int(model.joint(joint).bodyid[0]) for joint in joints}
        last = {model.body(finger.tip_body).id for finger in fingers}
        rows: list[tuple[int, float]] = []
        for geom, body in enumerate(model.geom_bodyid.tolist()):
            if body in idle:
                continue
            fractions: tuple[float, ...] = (0.0, 0.33, 0.67, 1.0)
            if body in last:
                fractions = (0.0, 0.45) if self.kinematics.half_lengths[geom] > 0 else ()
            rows += [(geom, fraction) for fraction in fractions]
        geoms = np.array([geom for geom, _ in rows], dtype=np.int64)
        fraction = np.array([fraction for _, fraction in rows])
        return geoms, fraction, np.array(model.geom_bodyid[geoms]), self.kinematics.radii[geoms]


class _Problem:
    """Residuals and Jacobian of one solve.

    The last evaluation is stored, because the solver asks for both at the same point. The coordinate frame
    has the axes of the nominal palm and its origin at the mean of the targets, so that a rigid motion of the
    whole scene changes only rounding errors.
    """

    def __init__(
        self,
        solver: InverseKinematics,
        reach: Reach,
        start: Placement,
        reference: Array,
        move_base: bool,
        avoid: bool,
    ) -> None:
        self.solver, self.reach, self.start, self.move_base = solver, reach, start, move_base
        self.kinematics = solver.kinematics
        hand = solver.hand
        self.frame, self.centre = reach.orientation, reach.targets.mean(axis=0)
        self.targets = (reach.targets - self.centre) @ self.frame
        self.inward = reach.inward @ self.frame
        self.fixed = self.frame.T @ start.rotation, (start.translation - self.centre) @ self.frame
        used = {joint for finger in reach.fingers for joint in finger.joints}
        self.motors = np.array([k for k, motor in enumerate(hand.motors) if used & set(motor.joints)])
        self.commands = hand.controls(start.q)
        self.reference = hand.controls(reference)[self.motors]
        self.avoid = avoid and solver.obstacle is not None
        self.soft = True
        base = 6 if move_base else 0
        self.base_lower = np.r_[np.full(3, -np.inf), -TILT_LIMITS][:base]
        self.base_upper = -self.base_lower
        self.z0 = np.r_[self._base()[:base], self.commands[self.motors]]
        self._last: Array | None = None

    def _base(self) -> Array:
        from scipy.spatial.transform import Rotation

        tilt = Rotation.from_matrix(self.fixed[0]).as_rotvec()
        return np.concatenate([self.fixed[1] / _LENGTH, np.asarray(tilt)])

    def _place(self, z: Array) -> tuple[Array, Array, Array, Array]:
        if self.move_base:
            rotation, right = rotation_exp(z[3:6])
            translation = z[:3] * _LENGTH
        else:
            (rotation, translation), right = self.fixed, np.eye(3)
        commands = self.commands.copy()
        commands[self.motors] = z[6 if self.move_base else 0 :]
        return rotation, translation, right, self.solver.hand.follow(commands)

    def _by_motor(self, jacobian: Array) -> Array:
        """(k, 3, m) derivatives by the commands of the motors in use, from those by the joints (k, 3, n)."""
        return np.asarray(jacobian @ self.rates)

    def _evaluate(self, z: Array) -> None:
        if self._last is not None and np.array_equal(self._last, z):
            return
        self._last = z.copy()
        rotation, translation, right, q = self._place(z)
        self.kinematics.set_posture(q)
        self.rates = self.solver.hand.rates(q)[:, self.motors]
        fingers = self.reach.fingers
        tips, axes = self.kinematics.tips(fingers)
        tip_slopes, axis_slopes = map(self._by_motor, self.kinematics.tip_jacobians(fingers))
        n, width, joints = len(fingers), len(z), len(self.motors)
        slope = np.zeros((n, 3, width))
        slope[:, :, -joints:] = rotation @ tip_slopes
        if self.move_base:
            slope[:, :, :3] = _LENGTH * np.eye(3)
            slope[:, :, 3:6] = -rotation @ skew(tips) @ right  # d(R p) = -R [p]x J dw
        rows = [((tips @ rotation.T + translation - self.targets) / _TIP).ravel()]
        slopes = [slope.reshape(3 * n, width) / _TIP]
        if self.soft:
            # Only the cap may touch, so the last phalanx must not lean away from the inward normal.
            inward = self.inward @ rotation
            lack = _LEAN - np.einsum("ki,ki->k", axes, inward)
            lean = np.zeros((n, width))
            lean[:, -joints:] = -np.einsum("ki,kij->kj", inward, axis_slopes)
            if self.move_base:
                lean[:, 3:6] = cross(inward, axes) @ right
            lean[lack <= 0] = 0.0
            rows.append(_LEAN_WEIGHT * np.maximum(lack, 0.0))
            slopes.append(_LEAN_WEIGHT * lean)
            self._add_soft(z, rotation, translation, right, rows, slopes)
        self._residual: Array = np.concatenate(rows)
        self._jacobian: Array = np.vstack(slopes)

    def _add_soft(
        self,
        z: Array,
        rotation: Array,
        translation: Array,
        right: Array,
        rows: list[Array],
        slopes: list[Array],
    ) -> None:
        width = len(z)
        rows.append(_POSTURE * (z[-len(self.motors) :] - self.reference))
        slopes.append(_POSTURE * np.eye(width)[-len(self.motors) :])
        if self.move_base:
            rows.append(_TILT * z[3:6])
            slopes.append(_TILT * np.eye(width)[3:6])
        if not self.avoid or self.solver.obstacle is None:
            return
        geoms, fraction, bodies, radii = self.solver.links(self.reach.fingers)
        p0, p1 = self.kinematics.axes()
        points = p0[geoms] + fraction[:, None] * (p1[geoms] - p0[geoms])
        placed = points @ rotation.T + translation
        distance, away = self.solver.obstacle.soft_distance(placed @ self.frame.T + self.centre)
        away = away @ self.frame
        lack = (radii + _MARGIN - distance) / _LINK
        near = np.flatnonzero(lack > 0)
        slope = np.zeros((len(lack), width))
        if len(near):
            push = away[near] @ rotation  # in the palm frame
            by_motor = self._by_motor(self.kinematics.point_jacobians(bodies[near], points[near]))
            slope[near, -len(self.motors) :] = -np.einsum("ki,kij->kj", push, by_motor) / _LINK
            if self.move_base:
                slope[near, :3] = -away[near] * _LENGTH / _LINK
                # -push . d(R p) = push . [p]x J dw = (push x p) . J dw
                slope[near, 3:6] = cross(push, points[near]) @ right / _LINK
        rows.append(np.maximum(lack, 0.0))
        slopes.append(slope)

    def residual(self, z: Array) -> Array:
        """All residuals at the unknowns z."""
        self._evaluate(z)
        return self._residual

    def jacobian(self, z: Array) -> Array:
        """Derivatives of all residuals by the unknowns z."""
        self._evaluate(z)
        return self._jacobian

    def polish(self, z: Array, lower: Array, upper: Array) -> Placement:
        """Remove the fingertip errors that the other residuals left.

        The steps are the shortest Newton steps within the bounds. A step that would leave a bound is solved
        again with that unknown fixed, at most three times.
        """
        self.soft = False
        best, error = z, np.inf
        for _ in range(12):
            self._last = None
            self._evaluate(z)
            worst = float(np.linalg.norm(self._residual.reshape(-1, 3), axis=1).max())
            if worst < error:
                best, error = z, worst
            if worst < 1e-4:  # 0.1 µm
                break
            free = np.ones(len(z), dtype=bool)
            step = np.zeros(len(z))
            for _ in range(3):
                step[:] = 0.0
                jacobian = self._jacobian[:, free]
                gram = jacobian @ jacobian.T
                if not gram.any():  # every unknown stands at a bound
                    break
                gram[np.diag_indices_from(gram)] += 1e-9 * np.trace(gram)
                step[free] = -jacobian.T @ np.linalg.solve(gram, self._residual)
                held = free & ((z + step < lower) | (z + step > upper))
                if not held.any():
                    break
                free &= ~held
            z = np.clip(z + step, lower, upper)
        rotation, translation, _, q = self._place(best)
        if self.move_base:
            rotation, translation = self.frame @ rotation, self.frame @ translation + self.centre
        else:
            rotation, translation = self.start.rotation, self.start.translation
        self.kinematics.set_posture(q)
        tips, _ = self.kinematics.tips(self.reach.fingers)
        errors = np.linalg.norm(tips @ rotation.T + translation - self.reach.targets, axis=1)
        return Placement(rotation=rotation, translation=translation, q=q, errors=errors)
