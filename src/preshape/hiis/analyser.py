"""The interface of a performance element (§3.3), and the values that such an element returns.

The paper's performance element is the ray analyser (:mod:`preshape.hiis.virtual_grasp`); the closure analyser
closes a real hand. The controller needs only this interface of either.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol, Self

import numpy as np

from ..exceptions import InputError
from ..objects.mesh import TriangleMesh
from ..types import (
    LENGTH_UNIT,
    Array,
    BoolArray,
    ContactCoefficients,
    Experience,
    IntArray,
    quality_text,
    two_digits,
    value,
)
from .planes import PLANES, ApproachPlane

MAX_FINGERS = 4
"""Largest number of virtual fingers, thumb included [P]."""

FingerRule = Literal["up_to", "all"]
FINGER_RULES: tuple[FingerRule, ...] = ("up_to", "all")
"""Two readings of §2.2, where the extent along the transverse axis "determines" the number of fingers: as
many virtual fingers ``up_to`` that number as match the task best, or ``all`` that fit."""


@value
class HandLayout:
    """The dimensions of a hand that an analyser needs.

    Attributes:
        name: Name of the hand.
        u: U, length of the proximal phalanx of the middle finger [m].
        finger_pitch: Distance of neighbouring fingers [m].
        fingertip_width: Least distance of neighbouring fingers [m].
        model: Hash of the hand's model, if an analyser closes that model; empty for the ray analyser.
    """

    name: str
    u: float
    finger_pitch: float
    fingertip_width: float
    model: str = ""

    def owns(self, lesson: Experience) -> bool:
        """Whether a lesson of the hand of this name is of this very model of it.

        A virtual grasp depends on these dimensions only, whatever the model.
        """
        return lesson.grip is None or lesson.model == self.model

    @property
    def length_unit(self) -> float:
        """Unit of length in wrenches, 4U [m]; also the largest extent of an object for the ray analyser."""
        return LENGTH_UNIT * self.u


@value
class GraspContacts:
    """Where the fingers of one grasp touch the object, the thumb first.

    Attributes:
        points: (n, 3) [m], mesh frame.
        normals_in: (n, 3) inward unit normals.
        triangles: (n,) index of the triangle that each contact lies on.
        wrenches: (n, 6) wrench of each contact about the COG, axes x y z, lengths in 4U.
    """

    points: Array
    normals_in: Array
    triangles: IntArray
    wrenches: Array


@value
class Grasp(ABC):
    """One way of holding the object; either a :class:`VirtualGrasp` or a :class:`Grip`.

    Attributes:
        plane: The approach plane.
        flip: Whether the thumb stands on the -o side.
        approach_value: v, -1..1 (§3).
        approach_set: Index of the fuzzy set in which v has the largest membership.
        fingers: Number of virtual fingers, thumb included.
        contacts: Where the fingers touch.
        net_wrench: (6,) about the COG, axes x y z, lengths in 4U (eq. 14).
        adi: (6,) ADI between wrench and task, for each component (eq. 19).
        tfvadi: Sum of the six ADIs (eq. 22).
        stability: rank(WU) - rank(TI), with one wrench per finger (§2.3).
        manipulability: rank(WU).
    """

    plane: ApproachPlane
    flip: bool
    approach_value: float
    approach_set: int
    fingers: int
    contacts: GraspContacts
    net_wrench: Array
    adi: Array
    tfvadi: float
    stability: int
    manipulability: int

    @property
    def thumb_side(self) -> Array:
        """(3,) unit vector from the object towards the thumb; o, or -o when flipped."""
        o = self.plane.opposition_axis
        return -o if self.flip else o

    @property
    @abstractmethod
    def judged(self) -> float:
        """The number that the critic compares with its threshold, 0..6."""

    @property
    @abstractmethod
    def score_text(self) -> str:
        """``judged`` with its name."""

    @property
    @abstractmethod
    def description(self) -> str:
        """Plane, fingers and score of the grasp, as part of a sentence."""

    @abstractmethod
    def same_as(self, other: Grasp) -> bool:
        """Whether two grasps are too similar to count as different answers."""


@value
class VirtualGrasp(Grasp):
    """The paper's grasp: contacts found by ray casting, before any hand has tried it.

    Attributes:
        ray_origins: (n, 3) where each finger's ray starts, in the order of the contacts [m].
    """

    ray_origins: Array

    @property
    def judged(self) -> float:
        """TFVADI."""
        return self.tfvadi

    @property
    def score_text(self) -> str:
        """TFVADI with its name."""
        return f"TFVADI {self.tfvadi:.2f}"

    @property
    def description(self) -> str:
        """Plane, virtual fingers and TFVADI."""
        return f"{self.plane.label}, {self.fingers} fingers, {self.score_text}"

    def same_as(self, other: Grasp) -> bool:
        """Whether plane, thumb side and number of virtual fingers agree."""
        return (self.plane.index, self.flip, self.fingers) == (other.plane.index, other.flip, other.fingers)


PALM = "palm"
"""What a contact of the palm is called where others have the name of their finger."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GripPosture:
    """What the real hand does in a grip, as the closure analyser computed it.

    The class has no slots, so that a subclass can have a second base with slots.

    Attributes:
        approach: (3,) unit vector along which the hand moves in on a straight line, mesh frame.
        palm_pose: (7,) palm frame in the mesh frame, xyz [m] and quaternion wxyz.
        start: (j,) joint angles at the beginning of the closing path [rad].
        mask: Bit f is set where finger f, in the order of the hand's joints, closes.
        pregrasp: (j,) joint angles, open and clear of the object [rad].
        grasp: (j,) joint angles at which every finger in use touches [rad].
        squeeze: (j,) servo targets that press with ``forces`` [rad].
        fingers_touching: Names of the fingers in contact, in the order of the contacts.
        links: Names of the hand's bodies in contact, in the order of the contacts.
        forces: (n, 3) force of each contact on the object in the squeeze, mesh frame [N].
        torques: (j,) joint torques of the squeeze [N m].
        task_margin: Largest load along the task's wrench cone that the squeeze can balance, divided by
            the expected load; 1 is just enough.
        hold_margin: The same margin for forces and torques in any direction.
        quality: Score that the critic judges, 0..6; 3 is just enough.
        clearance: Least distance of the open hand to the object, at the pregrasp and on the approach [m].
        friction_share: Share of the friction with which margins and quality were computed.
        refused: What keeps the hand from executing the grip, as a clause; empty if nothing does. Only the
            best grasp of a plan without an answer may be refused.
        back: Distance by which the opened hand stands back along its approach, for a palm that touches [m].
    """

    __slots__ = ()

    approach: Array
    palm_pose: Array
    start: Array
    mask: int
    pregrasp: Array
    grasp: Array
    squeeze: Array
    fingers_touching: tuple[str, ...]
    links: tuple[str, ...]
    forces: Array
    torques: Array
    task_margin: float
    hold_margin: float
    quality: float
    clearance: float
    friction_share: float
    refused: str = ""
    back: float = 0.0


@value
class Grip(Grasp, GripPosture):
    """A grasp that the real hand can execute, found by closing the hand (closure analyser).

    Attributes:
        pick_probability: How probably it picks the object up from its table, 0..1; ``None`` without a table.
    """

    pick_probability: float | None = None

    @property
    def judged(self) -> float:
        """The grip's quality."""
        return self.quality

    @property
    def score_text(self) -> str:
        """Quality with its name."""
        return f"quality {quality_text(self.quality, 1)}"

    @property
    def description(self) -> str:
        """Plane, fingers in contact, press and margins."""
        parts = set(self.fingers_touching)
        said = f"{len(parts - {PALM})} fingers" + " and the palm" * (PALM in parts)
        return (
            f"{self.plane.label}, {said}: squeezing with {self.press:.0f} N it "
            f"balances {two_digits(self.task_margin)} times the task's load, {two_digits(self.hold_margin)} "
            "times the pushes expected"
        )

    @property
    def press(self) -> float:
        """Sum of the normal forces of the squeeze [N]."""
        return float(np.einsum("ni,ni->", self.forces, self.contacts.normals_in))

    @property
    def whole_hand(self) -> bool:
        """Whether the palm or several links of a finger touch, as in a wrap, and not only fingertips."""
        return PALM in self.fingers_touching or len(set(self.fingers_touching)) < len(self.fingers_touching)

    def same_as(self, other: Grasp) -> bool:
        """Whether the wrists are closer than a :func:`wrist_distance` of 1."""
        if not isinstance(other, Grip):
            return False
        p, r = self.palm_pose, other.palm_pose
        return float(wrist_distance(p[:3], p[3:], r[:3], r[3:])) < 1.0


def wrist_distance(places: Array, turns: Array, place: Array, turn: Array) -> Array:
    """Distance of wrist poses, without unit: position difference / 20 mm plus rotation angle / 0.35 rad [C].

    Args:
        places: (..., 3) positions [m].
        turns: (..., 4) unit quaternions.
        place: (3,) or (..., 3) the other positions [m].
        turn: (4,) or (..., 4) their unit quaternions.
    """
    angle = 2.0 * np.arccos(np.minimum(1.0, np.abs((turns * turn).sum(axis=-1))))
    return np.asarray(np.linalg.norm(places - place, axis=-1) / 0.02 + angle / 0.35)


@value
class Aim:
    """Where an analyser searches: all combinations of planes, values, fingers and thumb sides.

    Attributes:
        planes: Indices of approach planes, 1..12.
        values: Approach values, -1..1.
        fingers: Numbers of virtual fingers, thumb included.
        flips: Thumb sides: True for the -o side, False for the +o side.
        recall: Planes whose stored grips are tried as well, with any approach value and number of fingers;
            used only by analysers that store grips.
    """

    planes: Sequence[int] = tuple(p.index for p in PLANES)
    values: Sequence[float] | Array
    fingers: Sequence[int] = (2, 3, 4)
    flips: Sequence[bool] = (False, True)
    recall: Sequence[int] = ()

    def check(self) -> None:
        """Refuse planes, values and numbers of fingers that do not exist.

        Raises:
            InputError: A plane, an approach value or a number of fingers is out of range.
        """
        planes, values, counts = (
            list(self.planes),
            np.asarray(self.values, dtype=np.float64),
            list(self.fingers),
        )
        if not all(1 <= index <= 12 for index in planes):
            raise InputError(f"approach plane indices must be 1 to 12, got {planes}")
        if not all(2 <= count <= MAX_FINGERS for count in counts):
            raise InputError(f"virtual fingers must be 2 to {MAX_FINGERS}, got {counts}")
        if not (np.abs(values) <= 1).all():
            raise InputError(f"approach values must lie in -1..1, got {values.tolist()!s:.80}")


@value
class Exploration(ABC):
    """Every grasp that an analyser found for an aim and a task; arrays over k grasps, best first.

    Attributes:
        plane: (k,) plane index.
        flip: (k,) whether the thumb stands on the -o side.
        value: (k,) approach value.
        fingers: (k,) virtual fingers.
        wrench: (k, 6) net wrench about the COG, lengths in 4U.
        match: (k,) score that the critic judges, 0..6.
        tried: Number of candidates that were tried.
        reason: Why no grasp was found; empty otherwise.
    """

    plane: IntArray
    flip: BoolArray
    value: Array
    fingers: IntArray
    wrench: Array
    match: Array
    tried: int
    reason: str

    def __len__(self) -> int:
        return len(self.match)

    def best_first(self) -> Self:
        """Sort by match, best first; of equal matches the simpler grasp comes first [C].

        A grasp is simpler if it is aimed nearer to the object's middle; then if it has more fingers; then if
        its thumb is on +o; then if its plane index is lower. Matches closer than 1e-9 count as equal.
        """
        nearness = np.round(np.abs(self.value), 9)
        keys = (self.plane, self.flip, -self.fingers, nearness, -np.round(self.match, 9))
        return self.where(np.lexsort(keys))

    def with_fingers(self, rule: FingerRule) -> Self:
        """The grasps that a finger rule allows: all, or only those with most fingers at their aim."""
        if rule == "up_to":
            return self
        aims = np.stack([self.plane, self.flip, self.value], axis=1)
        _, aim = np.unique(aims, axis=0, return_inverse=True)
        most = np.zeros(len(self) + 1, dtype=np.int64)
        np.maximum.at(most, aim.ravel(), self.fingers)
        return self.where(self.fingers == most[aim.ravel()])

    def where(self, keep: BoolArray | IntArray) -> Self:
        """The grasps selected by a mask or by indices, in that order."""
        columns = ("plane", "flip", "value", "fingers", "wrench", "match")
        return replace(self, **{name: getattr(self, name)[keep] for name in columns})

    @property
    @abstractmethod
    def summary(self) -> str:
        """Number of candidates tried and of grasps found, as part of a sentence."""

    @abstractmethod
    def grasp(self, index: int = 0) -> Grasp:
        """One of the grasps in full; the best by default."""

    @property
    def nearest_miss(self) -> Grasp | None:
        """If no grasp was found, the best one that the hand can at least execute; otherwise ``None``."""
        return None


class Analyser(Protocol):
    """The preshape analyser (PA) of a performance element, prepared for one object."""

    @property
    def mesh(self) -> TriangleMesh:
        """The object."""

    @property
    def layout(self) -> HandLayout:
        """The hand."""

    @property
    def coefficients(self) -> ContactCoefficients:
        """The contact model."""

    @property
    def measure(self) -> str:
        """Name of the quantity that the critic judges, for messages."""

    @property
    def patience(self) -> int:
        """Number of other tasks that task correction (mode 2) tries."""

    def explore(self, q: Array, aim: Aim) -> Exploration:
        """All grasps of an aim, matched with the task, best first."""

    def forget(self) -> None:
        """Clear what was cached of earlier searches; later answers do not depend on them then."""

    def recall(self, q: Array, lessons: Sequence[Experience]) -> Sequence[Grasp]:
        """The stored grasps of this same object and task, evaluated again on the current mesh."""

    def heaviest(self, q: Array, grasp: Grasp) -> float | None:
        """Heaviest mass for which the grasp would still be good enough [kg]; ``None`` for virtual grasps."""

    def shortfall(self, q: Array, grasp: Grasp) -> str:
        """What a weak grasp lacks, and what would help; empty for virtual grasps."""
