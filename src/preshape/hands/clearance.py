"""Exact collision checks that decide whether a placed hand fits.

1. The fingertips in use must touch their contacts.
2. The last phalanges of these fingers may enter the object by ``TOUCH_TOLERANCE`` at most; all other links
   must be clear of it. No link may be near a surface that is kept off; whether one is wholly inside a volume
   is not seen.
3. No two links of the hand may overlap.
4. Each finger that is not in use takes the first posture of a list that is clear.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import numpy as np

from ..types import Array, IntArray, value
from .collision import ObjectCollision
from .hand import Finger
from .inverse import Placement, Reach
from .kinematics import HandKinematics, LinkShape, move_shape

TOUCH_TOLERANCE = 1e-3
"""Largest gap between fingertip and contact, and largest depth of a last phalanx in the object [m] [C]."""

SEAT_SHIFT = 3e-3
"""Largest distance by which fine detail of the surface may push a fingertip from its contact [m] [C]."""

SELF_TOLERANCE = 0.5e-3
"""Largest overlap of two links of the hand [m] [C]."""

_PUSHES, _SNUG = 8, 1e-4  # iterations; overlap that a pushed fingertip keeps [m]


class HandStatus(Enum):
    """Outcome of a hand simulation; the value is a sentence for people."""

    REACHED = "every fingertip touches its contact and the rest of the hand is clear"
    OUT_OF_REACH = "the contacts are further apart or deeper than the fingers are long"
    JOINT_LIMIT = "the contacts could be reached only beyond a joint limit"
    COLLISION = "the contacts can be reached, but a link would be inside the object"
    SELF_COLLISION = "the contacts can be reached, but the hand's links would be in each other"
    BLOCKED = "the fingers can close on the contacts, but something keeps the hand from getting there"


@value
class TouchPoints:
    """Where the fingertips must touch, the thumb first, in the mesh frame.

    Attributes:
        points: (n, 3) [m].
        inward: (n, 3) inward unit normals.
        triangles: (n,) index of the triangle of each point.
    """

    points: Array
    inward: Array
    triangles: IntArray


@value
class Flaw:
    """Why a placement does not fit.

    Attributes:
        status: Kind of flaw.
        reason: One clause that names finger and link.
    """

    status: HandStatus
    reason: str


def spoken(link: str) -> str:
    """The name of a link or joint for a sentence.

    >>> spoken("index_distal"), spoken("ring_flexion_2"), spoken("palm_web")
    ('the index distal link', 'the ring flexion 2', 'the palm')
    """
    if link.startswith(("palm_", "forearm_")):
        return f"the {link.partition('_')[0]}"
    phalanx = link.rpartition("_")[2] in ("proximal", "medial", "distal")
    return f"the {link.replace('_', ' ')}{' link' if phalanx else ''}"


class Clearance:
    """The checks of one hand against one object.

    Args:
        kinematics: Kinematics of the hand.
        obstacle: The object.
        contacts: Where the fingertips must touch.
        kept_off: Surfaces that no link may be near.
        room: Least distance of every link from these surfaces [m].
    """

    def __init__(
        self,
        kinematics: HandKinematics,
        obstacle: ObjectCollision,
        contacts: TouchPoints,
        *,
        kept_off: Sequence[ObjectCollision] = (),
        room: float = 0.0,
    ) -> None:
        self.kinematics, self.hand = kinematics, kinematics.hand
        self.object, self.contacts = obstacle, contacts
        self.kept_off, self.room = kept_off, room
        model = kinematics.model
        self._finger_of = {
            model.body(int(model.joint(joint).bodyid[0])).name: finger.name
            for finger in self.hand.fingers
            for joint in finger.joints
        }

    def seat(self, reach: Reach) -> Reach | Flaw:
        """The reach with its fingertips pushed out of surface detail that is finer than they are.

        On a thread or in a fillet, a round tip cannot touch the contact point itself. It rests on the rims
        around it, at most ``SEAT_SHIFT`` away [C]; if it cannot, the hand does not fit.
        """
        targets = reach.targets.copy()
        for k, finger in enumerate(reach.fingers):
            centre = targets[k].copy()
            depth = 0.0
            for _ in range(_PUSHES):
                distance, hit, _ = self.object.closest(centre, finger.tip_radius - _SNUG)
                if not np.isfinite(distance):
                    break
                depth = max(depth, finger.tip_radius - distance)
                if depth <= TOUCH_TOLERANCE or distance < 1e-6:
                    break
                centre += (centre - hit) / distance * (finger.tip_radius - distance)
            distance, _, _ = self.object.closest(centre, finger.tip_radius - TOUCH_TOLERANCE)
            if np.isfinite(distance) or np.linalg.norm(centre - targets[k]) > SEAT_SHIFT:
                return Flaw(
                    status=HandStatus.COLLISION,
                    reason=f"the {finger.name}'s tip has no room at its contact: another part of the surface "
                    f"would be {1000 * depth:.1f} mm inside it",
                )
            targets[k] = centre
        return Reach(
            fingers=reach.fingers, targets=targets, inward=reach.inward, orientation=reach.orientation
        )

    def inspect(self, fingers: tuple[Finger, ...], placement: Placement) -> tuple[Flaw | None, Placement]:
        """The first flaw, and the placement with the fingers that are not in use moved out of the way."""
        idle = tuple(finger.name for finger in self.hand.fingers if finger not in fingers)
        shapes = [s for s in self.shapes(placement) if self._finger_of.get(s.body) not in idle]
        flaw = (
            self._touch_flaw(fingers, placement)
            or self._link_flaw(fingers, shapes)
            or self._self_flaw(ignore=idle)
        )
        for k, name in enumerate(idle):
            if flaw is None:
                flaw, placement = self._put_aside(self.hand.finger(name), fingers, placement, idle[k + 1 :])
        return flaw, placement

    def clear(self, placement: Placement) -> bool:
        """Whether the whole hand, fingertips included, is clear of the object and of itself."""
        return self._link_flaw((), self.shapes(placement)) is None and self._self_flaw() is None

    def depth(self, fingers: tuple[Finger, ...], placement: Placement) -> float:
        """Largest depth of a fingertip in use in the object [m]."""
        self.kinematics.set_posture(placement.q)
        centres = self.kinematics.tips(fingers)[0] @ placement.rotation.T + placement.translation
        found = [self.object.closest(c, f.tip_radius)[0] for f, c in zip(fingers, centres, strict=True)]
        depths = [f.tip_radius - d for f, d in zip(fingers, found, strict=True) if np.isfinite(d)]
        return float(max(depths, default=0.0))

    def shapes(self, placement: Placement) -> list[LinkShape]:
        """All shapes of the placed hand in the mesh frame."""
        self.kinematics.set_posture(placement.q)
        return [move_shape(s, placement.rotation, placement.translation) for s in self.kinematics.shapes()]

    def _touch_flaw(self, fingers: tuple[Finger, ...], placement: Placement) -> Flaw | None:
        self.kinematics.set_posture(placement.q)
        centres = self.kinematics.tips(fingers)[0] @ placement.rotation.T + placement.translation
        for finger, centre, point, triangle in zip(
            fingers, centres, self.contacts.points, self.contacts.triangles, strict=True
        ):
            radius = finger.tip_radius
            distance, hit, where = self.object.closest(centre, radius + TOUCH_TOLERANCE)
            if distance < radius - TOUCH_TOLERANCE:
                depth = 1000 * (radius - distance)
                reason = f"the {finger.name}'s tip is {depth:.1f} mm inside the object"
                return Flaw(status=HandStatus.COLLISION, reason=reason)
            if where != triangle and not np.linalg.norm(hit - point) <= radius:
                reason = f"the {finger.name}'s tip touches another part of the surface"
                return Flaw(status=HandStatus.COLLISION, reason=reason)
        return None

    def _link_flaw(self, fingers: tuple[Finger, ...], shapes: list[LinkShape]) -> Flaw | None:
        touching = {finger.tip_body for finger in fingers}
        for shape in shapes:
            if any(part.distance(shape) < self.room for part in self.kept_off):
                reason = f"{spoken(shape.link)} would be too near to a part to keep off"
                return Flaw(status=HandStatus.COLLISION, reason=reason)
            if shape.body in touching and shape.kind == "sphere":
                continue
            grow = -TOUCH_TOLERANCE if shape.body in touching else 0.0
            if self.object.touches(shape, grow):
                return Flaw(status=HandStatus.COLLISION, reason=f"{spoken(shape.link)} is inside the object")
        return None

    def _self_flaw(self, ignore: tuple[str, ...] = ()) -> Flaw | None:
        """The first overlap of links in the last posture that was set, without the fingers in ``ignore``."""
        for one, other, depth in self.kinematics.self_collisions(SELF_TOLERANCE):
            if not any(link.startswith(f"{name}_") for name in ignore for link in (one, other)):
                return Flaw(
                    status=HandStatus.SELF_COLLISION,
                    reason=f"{spoken(one)} is {1000 * depth:.1f} mm inside {spoken(other)}",
                )
        return None

    def _put_aside(
        self, finger: Finger, used: tuple[Finger, ...], placement: Placement, ignore: tuple[str, ...]
    ) -> tuple[Flaw | None, Placement]:
        """The placement with the finger in its first posture clear of object and hand, or a flaw."""
        columns = self.hand.columns(finger.name)
        # A motor that also moves another finger stays.
        own = np.array([set(motor.joints) <= set(finger.joints) for motor in self.hand.motors])
        stay = self.hand.controls(placement.q)
        first: Flaw | None = None
        for posture in self._aside(finger, placement.q[self.hand.columns(used[1].name)]):
            q = placement.q.copy()
            q[columns] = posture
            q = self.hand.follow(np.where(own, self.hand.controls(self.hand.lawful(q)), stay))
            moved = Placement(
                rotation=placement.rotation, translation=placement.translation, q=q, errors=placement.errors
            )
            shapes = [s for s in self.shapes(moved) if self._finger_of.get(s.body) == finger.name]
            flaw = self._link_flaw((), shapes) or self._self_flaw(ignore)
            if flaw is None:
                return None, moved
            first = first or flaw
        assert first is not None  # the list is not empty
        reason = f"the {finger.name} finger, not in use, finds no room: {first.reason}"
        return Flaw(status=first.status, reason=reason), placement

    def _aside(self, finger: Finger, neighbour: Array) -> list[Array]:
        """Postures to try: open, half as bent as a finger in use, closed, half closed; each also spread."""
        low, high = self.hand.limits[self.hand.columns(finger.name)].T
        alike = 0.5 * neighbour if len(neighbour) == len(low) else finger.at(0.25)
        bent = [finger.open, alike, finger.closed, 0.5 * (finger.open + finger.closed)]
        bent = [np.clip(posture, low, high) for posture in bent]
        # The finger spreads by its last joint that closing does not move, if there is such a joint.
        still = np.flatnonzero(np.ptp(finger.closing, axis=0) == 0)
        if not len(still):
            return bent
        side = int(still[-1])
        turned = []
        for turn in (0.0, low[side], high[side]):
            for posture in bent:
                turned.append(posture.copy())
                turned[-1][side] = turn
        return turned
