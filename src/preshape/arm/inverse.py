"""Inverse kinematics of an arm for many targets at once, in NumPy.

Every row of a batch is one target with one start. The step is that of Levenberg and Marquardt whose damping
is half the squared error (T. Sugihara, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt
method", IEEE Transactions on Robotics 27(5), 2011): far from the target it stays stable beside singular
postures, and near the target it converges as Newton's. Joints stay within their limits in every step.
"""

from __future__ import annotations

import numpy as np

from ..types import Array, BoolArray, IntArray, value
from .model import Arm

TOLERANCE = 1e-5
"""Largest error of a solution [m]; an angle counts times ``LEVER``."""
LEVER = 0.2
"""Distance at which an error of angle counts as one of position [m] [C]."""
STARTS, STEPS, FOLLOW_STEPS = 24, 40, 12
"""Starts for each target, and steps from a start and from the way point before [C]."""
_LARGEST_STEP = 1.0  # of a joint in one step [rad or m]
_DAMPING = 1e-8  # damping that is always there [m²]
_FALL, _PATIENCE = 0.9, 8  # a row that has not improved to this share in so many steps is given up


@value
class Solutions:
    """Result of a batch.

    Attributes:
        q: (b, n) Positions of the joints [rad or m].
        solved: (b,) Whether the error is within ``TOLERANCE``.
        away: (b,) Distance of the tip from its target [m].
        turned: (b,) Angle between the tip and its target [rad].
    """

    q: Array
    solved: BoolArray
    away: Array
    turned: Array


def screw_frames(arm: Arm, q: Array) -> tuple[Array, Array, Array, Array]:
    """Forward kinematics of postures.

    Args:
        arm: The arm.
        q: (b, n) Positions of the joints.

    Returns:
        (b, 3, 3) rotation and (b, 3) position of the tip [m]; (b, n, 3) axes of the joints and (b, n, 3)
        points on them [m].
    """
    b, n = q.shape
    K = np.zeros((n, 3, 3))
    x, y, z = arm.axes.T
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -z, y, -x
    K -= K.transpose(0, 2, 1)
    angle = np.where(arm.hinges, q, 0.0)[..., None, None]
    turns = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
    # A hinge leaves its point where it is; a slide moves along its axis.
    shifts = arm.points - np.einsum("bnij,nj->bni", turns, arm.points)
    shifts += np.where(arm.hinges, 0.0, q)[..., None] * arm.axes
    R, p = np.broadcast_to(np.eye(3), (b, 3, 3)), np.zeros((b, 3))
    axes, points = np.empty((b, n, 3)), np.empty((b, n, 3))
    for i in range(n):
        axes[:, i] = R @ arm.axes[i]
        points[:, i] = R @ arm.points[i] + p
        p = p + np.einsum("bij,bj->bi", R, shifts[:, i])
        R = R @ turns[:, i]
    return R @ arm.home[:3, :3], R @ arm.home[:3, 3] + p, axes, points


def jacobian(arm: Arm, position: Array, axes: Array, points: Array) -> Array:
    """(b, 6, n) Jacobians of the tip, its linear velocity [m] first, from :func:`screw_frames`."""
    arms = position[:, None] - points
    J = np.empty((len(position), 6, len(arm.joints)))
    hinges = arm.hinges[None, :, None]
    turning = np.cross(axes, arms)
    J[:, :3] = np.where(hinges, turning, axes).transpose(0, 2, 1)
    J[:, 3:] = np.where(hinges, axes, 0.0).transpose(0, 2, 1)
    return J


def conditions(arm: Arm, q: Array) -> Array:
    """(b,) Condition numbers of the Jacobian [m, rad] in postures (b, n); large near singular ones."""
    _, p, axes, points = screw_frames(arm, q)
    J = jacobian(arm, p, axes, points)
    squares = np.linalg.eigvalsh(J @ J.transpose(0, 2, 1))
    return np.asarray(np.sqrt(squares[:, -1] / np.maximum(squares[:, 0], 1e-18)))


def solve(arm: Arm, targets: Array, starts: Array, steps: int = STEPS, *, limited: bool = True) -> Solutions:
    """Bring the tip to targets.

    Args:
        arm: The arm.
        targets: (b, 4, 4) Poses of the tip [m].
        starts: (b, n) Postures to start from.
        steps: Largest number of steps.
        limited: Whether the joints keep within their limits.
    """
    q = np.array(starts, dtype=np.float64)
    low, high = arm.limits.T if limited else np.array([[-np.inf], [np.inf]])
    away, turned = np.full(len(q), np.inf), np.full(len(q), np.inf)
    least, waited = np.full(len(q), np.inf), np.zeros(len(q), dtype=np.int64)
    rows = np.arange(len(q))
    for step in range(steps + 1):
        R, p, axes, points = screw_frames(arm, q[rows])
        apart = targets[rows, :3, 3] - p
        turn = _rotation_vectors(targets[rows, :3, :3] @ R.transpose(0, 2, 1))
        away[rows], turned[rows] = np.linalg.norm(apart, axis=1), np.linalg.norm(turn, axis=1)
        square = away[rows] ** 2 + (LEVER * turned[rows]) ** 2
        better = square < (_FALL * least[rows]) if step else np.ones(len(rows), dtype=bool)
        least[rows] = np.minimum(least[rows], square)
        waited[rows] = np.where(better, 0, waited[rows] + 1)
        busy = (square > TOLERANCE**2) & (waited[rows] < _PATIENCE)
        if step == steps or not busy.any():
            break
        rows = rows[busy]
        J = jacobian(arm, p[busy], axes[busy], points[busy])
        J[:, 3:] *= LEVER
        error = np.concatenate([apart[busy], LEVER * turn[busy]], axis=1)
        q[rows] = np.clip(q[rows] + _step(J, error, square[busy]), low, high)
    solved = away**2 + (LEVER * turned) ** 2 <= TOLERANCE**2
    return Solutions(q=q, solved=solved, away=away, turned=turned)


def _step(J: Array, error: Array, square: Array) -> Array:
    """(b, n) The damped step of :func:`solve`."""
    A = J.transpose(0, 2, 1) @ J
    n = A.shape[-1]
    A[:, range(n), range(n)] += (0.5 * square + _DAMPING)[:, None]
    dq = np.linalg.solve(A, np.einsum("bij,bi->bj", J, error)[..., None])[..., 0]
    largest = np.abs(dq).max(axis=1, keepdims=True)
    return np.asarray(dq * np.minimum(1.0, _LARGEST_STEP / np.maximum(largest, 1e-12)))


def _rotation_vectors(R: Array) -> Array:
    """(b, 3) Rotation vectors of rotations (b, 3, 3), of length at most π."""
    axis = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    # At a half turn the sine says no axis; any will do for a step.
    axis = np.where(sine[:, None] < 1e-9, [1.0, 0.0, 0.0], axis)
    return np.asarray(axis * (angle / np.where(sine < 1e-9, 1.0, sine))[:, None])


def random_starts(arm: Arm, count: int, rng: np.random.Generator) -> Array:
    """(count, n) Random postures within the limits; joints that turn more than once around take one turn."""
    low, high = np.clip(arm.limits, -np.pi, np.pi).T
    # A range that lies wholly beyond a half turn is taken as it is.
    low, high = np.where(low < high, [low, high], arm.limits.T)
    return np.asarray(rng.uniform(low, high, (count, len(arm.joints))))


def branches(arm: Arm, targets: Array, seed: int) -> tuple[Array, IntArray, Solutions]:
    """Different solutions for each of several targets.

    Args:
        arm: The arm.
        targets: (k, 4, 4) Poses of the tip [m].
        seed: Seed of the starts.

    Returns:
        (b, n) postures, (b,) index of the target of each, and the solutions of all k × ``STARTS`` starts,
        those of one target after another.
    """
    k, n = len(targets), len(arm.joints)
    low, high = arm.limits.T
    starts = random_starts(arm, STARTS, np.random.default_rng(seed))
    found = solve(arm, np.repeat(targets, STARTS, axis=0), np.tile(starts, (k, 1)))
    # A joint that turns more than once around is taken in its middle turn, if its limits allow that.
    once = np.remainder(found.q + np.pi, 2 * np.pi) - np.pi
    q = np.where(arm.hinges & (once >= low) & (once <= high), once, found.q)
    postures: list[Array] = []
    owners: list[int] = []
    for target in range(k):
        mine: list[Array] = []
        for row in range(target * STARTS, (target + 1) * STARTS):
            if found.solved[row] and all(np.abs(q[row] - other).max() > 0.1 for other in mine):
                mine.append(q[row])
        postures += mine
        owners += [target] * len(mine)
    return np.array(postures).reshape(-1, n), np.array(owners, dtype=np.int64), found


def follow(arm: Arm, starts: Array, targets: Array) -> tuple[Array, IntArray]:
    """Follow way points, each from the posture at the one before.

    Args:
        arm: The arm.
        starts: (b, n) Postures near the first way point.
        targets: (b, k, 4, 4) Way points of the tip [m].

    Returns:
        (b, k, n) postures, and (b,) the number of way points that were reached.
    """
    b, k = targets.shape[:2]
    q = np.repeat(starts[:, None], k, axis=1)
    reached = np.zeros(b, dtype=np.int64)
    rows = np.arange(b)
    for step in range(k):
        before = q[rows, step - 1] if step else starts[rows]
        found = solve(arm, targets[rows, step], before, FOLLOW_STEPS)
        q[rows, step] = found.q
        # A jump between near way points means that another branch was met: the arm would not follow.
        near = found.solved & (np.abs(found.q - before).max(axis=1) < LARGEST_JUMP)
        rows = rows[near]
        reached[rows] = step + 1
    return q, reached


LARGEST_JUMP = 0.5
"""Largest motion of a joint between two way points [rad or m] [C]."""
