"""Hand simulation (§4): bring the real hand's fingertips onto the virtual grasp's contacts, or retract.

The base moves freely in the approach plane, without obstacle avoidance [P]. Inverse kinematics brings each
fingertip onto its contact, and the collision of the fingertip with that surface is checked exactly [P]. In
addition to the paper [C], every other link must be clear of the object and of the hand, the palm may tilt up
to 30° from the approach plane, and unused fingers are moved out of the way. If the hand cannot reach the
grasp, the fingers retract, and the result says why.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError
from ..hands.clearance import TOUCH_TOLERANCE, Clearance, Flaw, HandStatus, TouchPoints, spoken
from ..hands.collision import object_collision
from ..hands.hand import Finger, Hand
from ..hands.inverse import InverseKinematics, Placement, Reach
from ..hands.kinematics import HandKinematics, hand_geometry, pose_vector
from ..hiis.analyser import PALM, Grasp, Grip
from ..objects.mesh import TriangleMesh
from ..types import Array, freeze, frozen_array, two_digits, value

__all__ = [
    "HandPose",
    "HandResult",
    "HandStatus",
    "InverseKinematicsResult",
    "execute",
    "hand_geometry",
    "simulate_hand",
]

OPENING, SQUEEZE = 0.015, 0.003
"""Distance of a pregrasp's fingertips from the contacts, and of a squeeze's targets behind them [m] [C]."""

_STAND_OFF = 0.020  # [m] between the object and the open hand when it has retracted


@value
class HandPose:
    """The whole hand at one moment.

    Attributes:
        palm_pose: (7,) T_mesh_palm, xyz [m] + wxyz.
        q: (n,) joint angles [rad], in the order of the hand's joints.
    """

    palm_pose: Array
    q: Array

    def __post_init__(self) -> None:
        freeze(
            self,
            palm_pose=frozen_array(self.palm_pose, (7,), "palm pose"),
            q=frozen_array(self.q, (None,), "joint angles"),
        )


@value
class HandResult:
    """The real hand on a grasp, or retracted.

    Attributes:
        status: Whether the grasp was reached, or why not.
        reason: One sentence; it names finger and link if one is the cause.
        fingers: Names of the fingers in use, in contact order, the thumb first.
        joints: Names of the joints, in the order of every ``q``.
        grasp: The hand with its fingers on the contacts; ``None`` when retracted.
        pregrasp: The hand opened and clear of the object; ``None`` when retracted.
        squeeze: Servo targets that press on the contacts; ``None`` when retracted.
        retracted: The open hand, backed off along -a; ``None`` when the grasp was reached.
    """

    status: HandStatus
    reason: str
    fingers: tuple[str, ...]
    joints: tuple[str, ...]
    grasp: HandPose | None
    pregrasp: HandPose | None
    squeeze: HandPose | None
    retracted: HandPose | None

    @property
    def reached(self) -> bool:
        """Whether the grasp was reached."""
        return self.status is HandStatus.REACHED

    @classmethod
    def of_grip(cls, hand: Hand, grip: Grip) -> HandResult:
        """The hand on a grip; the closure analyser has already computed all postures.

        The hand of a grip that was refused stands open and backed off.
        """

        def pose(q: Array) -> HandPose:
            return HandPose(palm_pose=grip.palm_pose, q=q)

        free, way = not grip.refused, np.append(grip.approach, np.zeros(4))
        parts = list(dict.fromkeys(grip.fingers_touching))
        said = "the palm and " * (PALM in parts) + f"{len(parts) - (PALM in parts)} fingers"
        return HandResult(
            status=HandStatus.REACHED if free else HandStatus.BLOCKED,
            reason=grip.refused
            or f"{said} closed until they touched; the squeeze balances "
            f"{two_digits(grip.task_margin)} times the task's load and "
            f"{two_digits(grip.hold_margin)} times the pushes expected",
            fingers=grip.fingers_touching,
            joints=hand.joints,
            grasp=pose(grip.grasp) if free else None,
            pregrasp=HandPose(palm_pose=grip.palm_pose - grip.back * way, q=grip.pregrasp) if free else None,
            squeeze=pose(grip.squeeze) if free else None,
            retracted=None
            if free
            else HandPose(palm_pose=grip.palm_pose - _STAND_OFF * way, q=grip.pregrasp),
        )


@value
class InverseKinematicsResult(HandResult):
    """The hand brought onto a virtual grasp by inverse kinematics.

    The pregrasp is opened by 15 mm. The squeeze aims 3 mm behind the contacts, or less at a joint limit.

    Attributes:
        tip_errors: (m,) distance of each fingertip's centre from its wanted position at the contact [m]. When
            retracted, they belong to the attempt that ``reason`` describes.
        penetration: Largest penetration of a fingertip into the object [m]; 0 when retracted.
        attempts: Number of postures tried.
    """

    tip_errors: Array
    penetration: float
    attempts: int

    def __post_init__(self) -> None:
        freeze(self, tip_errors=frozen_array(self.tip_errors, (None,), "tip errors"))


def execute(
    hand: Hand,
    mesh: TriangleMesh,
    grasp: Grasp,
    *,
    seed: int = 0,
    kept_off: Sequence[TriangleMesh] = (),
    room: float = 0.0,
) -> HandResult:
    """The hand on a grasp: it reaches a virtual grasp or retracts (§4); a grip needs no further search.

    Args:
        hand: The hand.
        mesh: The object [m].
        grasp: The grasp.
        seed: Seed of the starting postures of the inverse kinematics.
        kept_off: Surfaces of parts to keep off. A grip does so already. On a virtual grasp, the hand does so
            where it touches and in its pregrasp, but not on its way.
        room: Least distance of every link from these parts [m].
    """
    if isinstance(grasp, Grip):
        return HandResult.of_grip(hand, grasp)
    return simulate_hand(
        hand,
        mesh,
        approach_axis=grasp.plane.approach_axis,
        opposition_axis=grasp.thumb_side,
        contact_points=grasp.contacts.points,
        normals_in=grasp.contacts.normals_in,
        triangles=grasp.contacts.triangles,
        seed=seed,
        kept_off=kept_off,
        room=room,
    )


def simulate_hand(
    hand: Hand,
    mesh: TriangleMesh,
    *,
    approach_axis: ArrayLike,
    opposition_axis: ArrayLike,
    contact_points: ArrayLike,
    normals_in: ArrayLike,
    triangles: ArrayLike,
    seed: int = 0,
    kept_off: Sequence[TriangleMesh] = (),
    room: float = 0.0,
) -> InverseKinematicsResult:
    """Put the hand on a virtual grasp.

    Args:
        hand: The hand.
        mesh: The object; all vectors below are in its frame.
        approach_axis: (3,) unit vector a; the fingers point along +a.
        opposition_axis: (3,) unit vector o with the flip applied: the thumb stands on the +o side.
        contact_points: (n, 3) contacts [m], the thumb's first, the others in any order; n is 2 to the number
            of fingers.
        normals_in: (n, 3) inward normals.
        triangles: (n,) index of the triangle that each contact lies on.
        seed: Seed of the random starting postures.
        kept_off: Surfaces of parts to keep off.
        room: Least distance of every link from these parts, in the grasp and in the pregrasp [m].

    Returns:
        The grasp, or the retracted hand and the reason.

    Raises:
        InputError: An array has the wrong shape, the axes are not perpendicular, or there are more contacts
            than fingers.
    """
    a, o = _axes(approach_axis, opposition_axis)
    contacts = _contacts(hand, mesh, contact_points, normals_in, triangles)
    t = np.cross(a, o)
    clearance = Clearance(
        HandKinematics(hand),
        object_collision(mesh),
        contacts,
        kept_off=[object_collision(part) for part in kept_off],
        room=room,
    )
    # Palm frame: +x transverse, -y towards the thumb, +z as the fingers point.
    return _Simulation(hand, mesh, np.stack([t, -o, a], axis=1), seed, clearance).run()


def _axes(approach: ArrayLike, opposition: ArrayLike) -> tuple[Array, Array]:
    a, o = frozen_array(approach, (3,), "approach axis"), frozen_array(opposition, (3,), "opposition axis")
    lengths = np.linalg.norm(a), np.linalg.norm(o)
    if min(lengths) < 1e-9 or abs(a @ o) > 1e-6 * lengths[0] * lengths[1]:
        raise InputError(f"approach and opposition axis must be perpendicular and not zero, got {a} and {o}")
    return a / lengths[0], o / lengths[1]


def _contacts(
    hand: Hand, mesh: TriangleMesh, points: ArrayLike, normals: ArrayLike, triangles: ArrayLike
) -> TouchPoints:
    where = frozen_array(points, (None, 3), "contact points")
    count = len(where)
    if not 2 <= count <= len(hand.fingers):
        raise InputError(f"{hand.name} needs 2 to {len(hand.fingers)} contacts, got {count}")
    inward = frozen_array(normals, (count, 3), "inward normals")
    length = np.linalg.norm(inward, axis=1, keepdims=True)
    index = frozen_array(triangles, (count,), "contact triangles").astype(np.int64)
    if length.min() < 1e-9:
        raise InputError("inward normals must not be zero")
    if index.min() < 0 or index.max() >= len(mesh.triangles):
        raise InputError(f"contact triangles must be 0 … {len(mesh.triangles) - 1}, got {index}")
    return TouchPoints(points=where, inward=inward / length, triangles=index)


class _Simulation:
    """One call of :func:`simulate_hand`."""

    def __init__(
        self, hand: Hand, mesh: TriangleMesh, orientation: Array, seed: int, clearance: Clearance
    ) -> None:
        self.hand, self.mesh, self.orientation = hand, mesh, orientation
        self.contacts = clearance.contacts
        self.kinematics = clearance.kinematics
        self.solver = InverseKinematics(self.kinematics, object_collision(mesh))
        self.clearance = clearance
        self.rng = np.random.default_rng(seed)
        self.seats: Array | None = None
        self.attempts = 0

    def run(self) -> InverseKinematicsResult:
        """Try assignments and starting postures until one succeeds; otherwise report why none did."""
        assignments = self.assignments()
        seated = self.clearance.seat(self.reach(assignments[0]))
        if isinstance(seated, Flaw):
            return self.retract(seated, assignments[0], None)
        self.seats = seated.targets
        first: tuple[Flaw, tuple[Finger, ...], Placement | None] | None = None
        for fingers, reference, tilt in self.starts(assignments):
            reach = self.reach(fingers)
            placement = self.solver.solve(
                reach, start=self.start(reach, reference, tilt), reference=reference
            )
            self.attempts += 1
            if placement.errors.max() > TOUCH_TOLERANCE:
                continue
            flaw, placement = self.clearance.inspect(fingers, placement)
            if flaw is None:
                return self.success(fingers, reach, placement)
            if first is None:
                first = flaw, fingers, placement
        if first is not None:
            return self.retract(*first)
        return self.diagnose(assignments[0])

    # -- what to try ---------------------------------------------------------------------------------

    def assignments(self) -> list[tuple[Finger, ...]]:
        """Assignments of real fingers to the contacts, best first; no two fingers cross.

        Fingers do not cross if contacts and fingers have the same order along t, which is the palm's +x.
        """
        thumb, others = self.hand.fingers[0], self.hand.fingers[1:]
        self.kinematics.set_posture(self.hand.posture("open"))
        side = self.kinematics.tips(others)[0][:, 0]
        ordered = [others[k] for k in np.argsort(-side, kind="stable")]
        t = self.orientation[:, 0]
        along = self.contacts.points[1:] @ t
        rank = np.argsort(np.argsort(-along, kind="stable"), kind="stable")
        count = len(along)
        middle = (len(ordered) - 1) / 2
        choices = list(combinations(range(len(ordered)), count))
        # Neighbours before gaps, the middle of the hand before its edges.
        choices.sort(key=lambda c: (c[-1] - c[0], abs(sum(c) / count - middle), c[0]))
        if count == 2 and np.ptp(along) > 1.6 * self.hand.finger_pitch:
            choices.sort(key=lambda c: -(c[-1] - c[0]))
        return [(thumb, *(ordered[choice[r]] for r in rank)) for choice in choices]

    def starts(
        self, assignments: list[tuple[Finger, ...]]
    ) -> Iterator[tuple[tuple[Finger, ...], Array, float]]:
        """Fingers, reference posture and tilt about the transverse axis [rad] of each attempt, best first."""
        rest, straight, curled = (self._reference(*bend) for bend in ((0.40, 0.30), (0.15, 0.15), (0.9, 0.7)))
        for reference, tilt in ((rest, 0.0), (straight, 0.0), (curled, 0.0), (rest, 0.25), (rest, -0.25)):
            yield assignments[0], reference, tilt
        for fingers in assignments[1:]:
            yield fingers, rest, 0.0
        for _ in range(2):
            noise = self.rng.uniform(-0.3, 0.3, len(rest))
            reference = self.hand.lawful(np.clip(rest + noise, *self.hand.limits.T))
            yield assignments[0], reference, float(self.rng.uniform(-0.4, 0.4))

    def _reference(self, medial: float, distal: float) -> Array:
        q = self.hand.posture("rest")
        for finger in self.hand.fingers:
            q[self.hand.columns(finger.name)][-2:] = medial, distal
        return self.hand.lawful(q) if self.hand.coupled else q

    def reach(self, fingers: tuple[Finger, ...]) -> Reach:
        """Wanted centres of these fingers' tips: one tip radius outside each contact, or at its seat."""
        radii = np.array([finger.tip_radius for finger in fingers])[:, None]
        centres = self.contacts.points - radii * self.contacts.inward
        return Reach(
            fingers=fingers,
            targets=centres if self.seats is None else self.seats,
            inward=self.contacts.inward,
            orientation=self.orientation,
        )

    def start(self, reach: Reach, reference: Array, tilt: float) -> Placement:
        """The hand in the reference posture, with its fingertips near the contacts."""
        q = self.hand.posture("open")
        for finger in reach.fingers:
            q[self.hand.columns(finger.name)] = reference[self.hand.columns(finger.name)]
        self.kinematics.set_posture(q)
        tips, _ = self.kinematics.tips(reach.fingers)
        c, s = np.cos(tilt), np.sin(tilt)
        rotation = self.orientation @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        middle = (reach.targets[0] + reach.targets[1:].mean(axis=0)) / 2
        translation = middle - rotation @ (tips[0] + tips[1:].mean(axis=0)) / 2
        return Placement(rotation=rotation, translation=translation, q=q, errors=np.zeros(len(tips)))

    # -- how it ends ---------------------------------------------------------------------------------

    def success(self, fingers: tuple[Finger, ...], reach: Reach, grasp: Placement) -> InverseKinematicsResult:
        """The grasp with its pregrasp and squeeze."""
        behind = self._shifted(reach, SQUEEZE)
        squeeze = self.solver.solve(behind, start=grasp, reference=grasp.q, move_base=False, effort=0)
        if squeeze.errors.max() > TOUCH_TOLERANCE:
            squeeze = self.solver.solve(behind, start=grasp, reference=grasp.q, move_base=False, avoid=False)
        return InverseKinematicsResult(
            status=HandStatus.REACHED,
            reason=f"{', '.join(finger.name for finger in fingers)} on their contacts",
            fingers=tuple(finger.name for finger in fingers),
            joints=self.hand.joints,
            grasp=_pose(grasp),
            pregrasp=_pose(self.pregrasp(reach, grasp)),
            squeeze=_pose(squeeze),
            retracted=None,
            tip_errors=grasp.errors,
            penetration=self.clearance.depth(fingers, grasp),
            attempts=self.attempts,
        )

    def _shifted(self, reach: Reach, inward: float) -> Reach:
        return Reach(
            fingers=reach.fingers,
            targets=reach.targets + inward * reach.inward,
            inward=reach.inward,
            orientation=reach.orientation,
        )

    def pregrasp(self, reach: Reach, grasp: Placement) -> Placement:
        """Pregrasp: opened along the outward normals, else towards the open posture, else backed off."""
        away = self._shifted(reach, -OPENING)
        for effort in (0, 15):
            opened = self.solver.solve(away, start=grasp, reference=grasp.q, move_base=False, effort=effort)
            if self.clearance.clear(opened):
                return opened
        target = grasp.q.copy()
        for finger in reach.fingers:
            target[self.hand.columns(finger.name)] = finger.open
        for share in (0.3, 0.6, 1.0):
            opened = Placement(
                rotation=grasp.rotation,
                translation=grasp.translation,
                q=self.hand.follow(self.hand.controls(grasp.q + share * (target - grasp.q))),
                errors=grasp.errors,
            )
            if self.clearance.clear(opened):
                return opened
        return self.backed_off(grasp.rotation)

    def backed_off(self, rotation: Array) -> Placement:
        """The open hand in front of the object, on the side from which the hand approaches."""
        q = self.hand.posture("open")
        self.kinematics.set_posture(q)
        a = self.orientation[:, 2]
        shapes = self.kinematics.shapes()
        front = max(float((rotation @ p) @ a) + s.radius for s in shapes for p in (s.p0, s.p1))
        near = float((self.mesh.corners.reshape(-1, 3) @ a).min())
        centre = self.contacts.points.mean(axis=0)
        translation = centre + a * (near - _STAND_OFF - front - centre @ a)
        return Placement(rotation=rotation, translation=translation, q=q, errors=np.zeros(0))

    def retract(
        self, flaw: Flaw, fingers: tuple[Finger, ...], best: Placement | None
    ) -> InverseKinematicsResult:
        """The result for a retracted hand, with the reason."""
        return InverseKinematicsResult(
            status=flaw.status,
            reason=flaw.reason,
            fingers=tuple(finger.name for finger in fingers),
            joints=self.hand.joints,
            grasp=None,
            pregrasp=None,
            squeeze=None,
            retracted=_pose(self.backed_off(self.orientation)),
            tip_errors=np.zeros(0) if best is None else best.errors,
            penetration=0.0,
            attempts=self.attempts,
        )

    def diagnose(self, fingers: tuple[Finger, ...]) -> InverseKinematicsResult:
        """Why no attempt reached the contacts: the object, the joint limits or the lengths of the links."""
        reach = self.reach(fingers)
        best: Placement | None = None
        for reference in (self._reference(0.4, 0.3), self._reference(0.1, 0.1)):
            start = self.start(reach, reference, 0.0)
            placement = self.solver.solve(reach, start=start, reference=reference, avoid=False)
            if placement.errors.max() <= TOUCH_TOLERANCE:
                flaw, placement = self.clearance.inspect(fingers, placement)
                if flaw is None:
                    return self.success(fingers, reach, placement)
                return self.retract(flaw, fingers, placement)
            if best is None or placement.errors.max() < best.errors.max():
                best = placement
        assert best is not None
        free = np.tile([-np.pi, np.pi], (len(self.hand.motors), 1))
        start = self.start(reach, self.hand.posture("rest"), 0.0)
        loose = self.solver.solve(
            reach, start=start, reference=self.hand.posture("rest"), limits=free, avoid=False, effort=80
        )
        miss = int(best.errors.argmax())
        if loose.errors.max() > TOUCH_TOLERANCE:
            return self.retract(
                Flaw(
                    status=HandStatus.OUT_OF_REACH,
                    reason=f"the {fingers[miss].name} ends "
                    f"{1000 * best.errors[miss]:.0f} mm from its contact",
                ),
                fingers,
                best,
            )
        low, high = self.hand.limits.T
        beyond = np.maximum(low - loose.q, loose.q - high)
        joint = int(beyond.argmax())
        return self.retract(
            Flaw(
                status=HandStatus.JOINT_LIMIT,
                reason=f"{spoken(self.hand.joints[joint])} joint would have to turn "
                f"{np.degrees(beyond[joint]):.0f}° beyond its limit",
            ),
            fingers,
            best,
        )


def _pose(placement: Placement) -> HandPose:
    return HandPose(palm_pose=pose_vector(placement.rotation, placement.translation), q=placement.q)
