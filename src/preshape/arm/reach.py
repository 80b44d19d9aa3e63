"""Whether an arm can bring its hand to a grasp, in along its way, and up with the object.

1. Inverse kinematics finds different postures for the grasp (:func:`.inverse.branches`), for all grasps at
   once.
2. Each posture is followed back along the way in and up with the lift, way point by way point. A posture is
   usable if all way points are reached, without a jump and without a near-singular posture.
3. For each grasp, the usable postures are tested for collisions, the one farthest from limits and singular
   postures first, until one is free.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from enum import Enum

import numpy as np

from ..hands.compiled import no_mujoco_log
from ..spatial import inverse, pose_from_seven
from ..types import Array, BoolArray, freeze, frozen_array, value
from .collision import ArmScene, Hit
from .inverse import STARTS, Solutions, branches, conditions, follow, random_starts, screw_frames, solve
from .model import Arm

SPACING = 0.02
"""Distance between two way points [m] [C]."""
SINGULAR = 30.0
"""Condition number of the Jacobian [m, rad] from which a posture is near-singular: that at which MoveIt Servo
stops an arm (``hard_stop_singularity_threshold``)."""
JOINT_SPEED, SLIDE_SPEED, TIP_SPEED = 0.5, 0.1, 0.1
"""Largest speeds on a path [rad/s, m/s, m/s] [C]."""
_NEAR_LIMIT = math.radians(0.5)
_ROOM_ENOUGH = math.radians(10.0)
"""Distance from a limit beyond which more counts for nothing [C]."""
_FREE_STARTS = 8  # without limits, for each grasp that no posture within them reaches [C]
_MOST_TESTED = 6  # usable postures of a grasp that are tested for collisions [C]


class ArmStatus(Enum):
    """Whether the arm serves a grasp; the value is a clause for people."""

    REACHED = "the arm reaches it"
    OUT_OF_REACH = "out of the arm's reach"
    JOINT_LIMIT = "beyond a joint limit of the arm"
    SINGULAR = "near a singular posture of the arm"
    COLLISION = "with the arm in collision"
    SELF_COLLISION = "with the arm in collision with itself or the hand"
    NO_POSTURE = "without a posture of the hand"


@value
class HandPath:
    """What the hand does for a grasp, in the frame of the object.

    Attributes:
        palm_pose: (7,) Pose of the palm at the grasp: xyz [m], wxyz.
        way_in: (3,) Unit vector along which the open hand comes in.
        back: Distance at which the way in begins [m].
        up: (3,) Unit vector of the lift.
        height: Length of the lift [m].
        pregrasp: (m,) Angles of the hand's joints on the way in [rad].
        grasp: (m,) Angles of the hand's joints at the grasp and in the lift [rad].
    """

    palm_pose: Array
    way_in: Array
    back: float
    up: Array
    height: float
    pregrasp: Array
    grasp: Array


@value
class ArmReach:
    """The arm for one grasp.

    Attributes:
        status: Whether the arm serves it.
        reason: One clause on it.
        stages: (k,) The stage that each way point belongs to: ``way_in`` up to the grasp, then ``lift``.
        times: (k,) Time of each way point [s]; the fingers close and squeeze between the two stages, which
            takes none here.
        q: (k, n) Positions of the joints [rad or m]; empty if the arm does not serve the grasp.
        limit_room: Least distance of a hinge from its limits on the path [rad]; infinite without limits.
        condition: Largest condition number of the Jacobian on the path.
    """

    status: ArmStatus
    reason: str
    stages: tuple[str, ...]
    times: Array
    q: Array
    limit_room: float = 0.0
    condition: float = 0.0

    def __post_init__(self) -> None:
        freeze(
            self,
            times=frozen_array(self.times, (len(self.stages),), "times"),
            q=frozen_array(self.q, (len(self.stages), None), "arm path"),
        )

    @property
    def reached(self) -> bool:
        """Whether the arm serves the grasp."""
        return self.status is ArmStatus.REACHED


@value
class Ways:
    """Way points of several grasps; all have the same number.

    Attributes:
        poses: (g, k, 4, 4) Poses of the tip in the base [m].
        at_grasp: Index of the way point of the grasp; those before are the way in, those after the lift.
    """

    poses: Array
    at_grasp: int


def refused(status: ArmStatus, reason: str) -> ArmReach:
    """The result for a grasp that the arm does not serve."""
    return ArmReach(status=status, reason=reason, stages=(), times=np.zeros(0), q=np.zeros((0, 0)))


def ways_of(arm: Arm, paths: Sequence[HandPath], T_base_object: Array) -> Ways:
    """The way points of the arm's tip for what the hand does."""
    steps_in = max(1, math.ceil(max(path.back for path in paths) / SPACING))
    steps_up = max(1, math.ceil(max(path.height for path in paths) / SPACING))
    poses = np.empty((len(paths), steps_in + 1 + steps_up, 4, 4))
    T_palm_tip = inverse(arm.hand.T_root_palm) @ inverse(arm.T_tip_root)
    for row, path in enumerate(paths):
        shifts = np.concatenate(
            [
                np.linspace(-path.back, 0.0, steps_in + 1)[:, None] * path.way_in,
                np.linspace(0.0, path.height, steps_up + 1)[1:, None] * path.up,
            ]
        )
        poses[row] = T_base_object @ pose_from_seven(path.palm_pose) @ T_palm_tip
        poses[row, :, :3, 3] += shifts @ T_base_object[:3, :3].T
    return Ways(poses=poses, at_grasp=steps_in)


def reach(
    arm: Arm, scene: ArmScene, paths: Sequence[HandPath], T_base_object: Array, seed: int
) -> tuple[tuple[ArmReach, ...], dict[str, float]]:
    """Whether the arm serves each of several grasps.

    Args:
        arm: The arm.
        scene: The arm among its obstacles.
        paths: What the hand does for each grasp.
        T_base_object: (4, 4) Pose of the object's frame in the base [m].
        seed: Seed of the starts of the inverse kinematics.

    Returns:
        A result for each grasp, and the time of ``kinematics``, which is the inverse kinematics of all way
        points, and of ``total`` [s].
    """
    if not paths:
        return (), {"kinematics": 0.0, "total": 0.0}
    started = time.perf_counter()
    ways = ways_of(arm, paths, T_base_object)
    poses, g = ways.poses, ways.at_grasp
    q_grasp, owner, tried = branches(arm, poses[:, g], seed)
    back, back_reached = follow(arm, q_grasp, poses[owner, :g][:, ::-1])
    up, up_reached = follow(arm, q_grasp, poses[owner, g + 1 :])
    alone = time.perf_counter() - started
    q = np.concatenate([back[:, ::-1], q_grasp[:, None], up], axis=1)
    whole = (back_reached == g) & (up_reached == poses.shape[1] - g - 1)
    condition = np.full(len(q), np.inf)
    if whole.any():
        every = conditions(arm, q[whole].reshape(-1, q.shape[2])).reshape(-1, q.shape[1])
        condition[whole] = every.max(axis=1)
    room = _limit_room(arm, q).min(axis=1)
    lost = sorted(set(range(len(paths))) - set(owner.tolist()))
    why = dict(zip(lost, _unsolved(arm, poses[lost, g], tried, lost, seed), strict=True))
    results = []
    for row, path in enumerate(paths):
        mine = np.flatnonzero(owner == row)
        if not len(mine):
            results.append(why[row])
            continue
        usable = mine[whole[mine] & (condition[mine] < SINGULAR)]
        if not len(usable):
            furthest = mine[np.argmax(back_reached[mine] + up_reached[mine])]
            results.append(
                _broken(arm, path, q[furthest], int(back_reached[furthest]), int(up_reached[furthest]), ways)
            )
            continue
        score = np.minimum(room[usable], _ROOM_ENOUGH) / condition[usable]
        order = usable[np.argsort(-score, kind="stable")][:_MOST_TESTED]
        with no_mujoco_log():
            results.append(_first_free(arm, scene, path, q, order, ways, condition, room))
    return tuple(results), {"kinematics": alone, "total": time.perf_counter() - started}


def reached_from(arm: Arm, targets: Array, seed: int) -> BoolArray:
    """(k,) Whether any posture brings the tip to each target (k, 4, 4), whatever it collides with."""
    count = STARTS // 2
    starts = random_starts(arm, count, np.random.default_rng(seed))
    found = solve(arm, np.repeat(targets, count, axis=0), np.tile(starts, (len(targets), 1)))
    return np.asarray(found.solved.reshape(-1, count).any(axis=1))


def _first_free(
    arm: Arm,
    scene: ArmScene,
    path: HandPath,
    q: Array,
    order: Array,
    ways: Ways,
    condition: Array,
    room: Array,
) -> ArmReach:
    """The first of several usable postures whose path is free of collisions, or why none is."""
    g, k = ways.at_grasp, q.shape[1]
    lifting = np.arange(k) > g
    fingers = np.where((np.arange(k) < g)[:, None], path.pregrasp, path.grasp)
    hits: list[Hit] = []
    for row in order:
        hit = scene.first_hit(q[row], fingers, lifting)
        if hit is None:
            return ArmReach(
                status=ArmStatus.REACHED,
                reason=ArmStatus.REACHED.value,
                stages=("way_in",) * (g + 1) + ("lift",) * (k - g - 1),
                times=_times(arm, q[row]),
                q=q[row],
                limit_room=float(room[row]),
                condition=float(condition[row]),
            )
        hits.append(hit)
    # The posture that came farthest says what is in the way, and none that the arm itself makes impossible.
    hit = max(hits, key=lambda hit: (not hit.itself, hit.at))
    where = _where(path, hit.at, ways)
    status = ArmStatus.SELF_COLLISION if hit.itself else ArmStatus.COLLISION
    return refused(status, f"{where}, {hit.one} would hit {hit.other}")


def _unsolved(arm: Arm, targets: Array, tried: Solutions, rows: Sequence[int], seed: int) -> list[ArmReach]:
    """Why no posture brings the tip to some of the grasps: a limit, or how far the nearest one is off."""
    if not rows:
        return []
    starts = random_starts(arm, _FREE_STARTS, np.random.default_rng(seed))
    free = solve(
        arm, np.repeat(targets, _FREE_STARTS, axis=0), np.tile(starts, (len(rows), 1)), limited=False
    )
    results = []
    for k, row in enumerate(rows):
        mine = slice(k * _FREE_STARTS, (k + 1) * _FREE_STARTS)
        q = free.q[mine][free.solved[mine]]
        if len(q):
            results.append(refused(ArmStatus.JOINT_LIMIT, _beyond(arm, q)))
            continue
        mine = slice(row * STARTS, (row + 1) * STARTS)
        away, turn = tried.away[mine], tried.turned[mine]
        nearest = int(np.argmin(away + 0.1 * turn))
        apart = f"{100 * away[nearest]:.0f} cm" if away[nearest] > 0.005 else ""
        tilt = f"{math.degrees(turn[nearest]):.0f}°" if turn[nearest] > math.radians(1) else ""
        by = " and ".join(part for part in (apart, tilt) if part) or "a little"
        results.append(refused(ArmStatus.OUT_OF_REACH, f"its nearest posture leaves the hand {by} off"))
    return results


def _beyond(arm: Arm, q: Array) -> str:
    """Which joint of postures (b, n) without limits is least beyond its own, and by how much."""
    turns = 2 * np.pi * np.arange(-3, 4)[:, None, None]
    every = np.where(arm.hinges, np.remainder(q, 2 * np.pi) + turns, q)
    over = np.maximum(arm.limits[:, 0] - every, every - arm.limits[:, 1]).min(axis=0)
    least = over[np.argmin(over.max(axis=1))]
    joint = int(least.argmax())
    far = float(least[joint])
    by = f"turn {math.degrees(far):.0f}°" if arm.hinges[joint] else f"slide {1000 * far:.0f} mm"
    return f"{arm.joints[joint]} would have to {by} beyond its limit"


def _broken(arm: Arm, path: HandPath, q: Array, back: int, up: int, ways: Ways) -> ArmReach:
    """Why the best posture of a grasp cannot be followed along the way in and the lift."""
    g, k = ways.at_grasp, len(q)
    if back == g and up == k - g - 1:
        worst = int(np.argmax(conditions(arm, q)))
        where = _where(path, worst, ways)
        return refused(ArmStatus.SINGULAR, f"{where}, the arm would be near a singular posture")
    at = g - back - 1 if back < g else g + up + 1
    where, room = _where(path, at, ways), _limit_room(arm, q[at : at + 1], each=True)[0]
    joint = int(room.argmin())
    if room[joint] < _NEAR_LIMIT:
        return refused(ArmStatus.JOINT_LIMIT, f"{where}, {arm.joints[joint]} would be at its limit")
    before = at + 1 if back < g else at - 1
    if conditions(arm, q[before : before + 1])[0] > SINGULAR:
        return refused(ArmStatus.SINGULAR, f"{where}, the arm would be near a singular posture")
    return refused(ArmStatus.OUT_OF_REACH, f"{where}, the hand would be out of reach")


def _where(path: HandPath, at: int, ways: Ways) -> str:
    """The way point of a path in words."""
    g, k = ways.at_grasp, ways.poses.shape[1]
    if at == g:
        return "at the grasp"
    if at < g:
        return f"{100 * path.back * (g - at) / g:.0f} cm before the grasp"
    return f"{100 * path.height * (at - g) / (k - g - 1):.0f} cm up in the lift"


def _limit_room(arm: Arm, q: Array, *, each: bool = False) -> Array:
    """(...,) Least distance of a hinge from its limits in postures (..., n) [rad], or (..., n) of each."""
    room = np.minimum(q - arm.limits[:, 0], arm.limits[:, 1] - q)
    room = np.where(arm.hinges, room, np.inf)
    return np.asarray(room if each else room.min(axis=-1))


def _times(arm: Arm, q: Array) -> Array:
    """(k,) Times of way points [s], so that joints and tip keep to their speeds."""
    speed = np.where(arm.hinges, JOINT_SPEED, SLIDE_SPEED)
    joints = (np.abs(np.diff(q, axis=0)) / speed).max(axis=1)
    tip = np.linalg.norm(np.diff(screw_frames(arm, q)[1], axis=0), axis=1) / TIP_SPEED
    return np.concatenate([[0.0], np.cumsum(np.maximum(joints, tip))])
