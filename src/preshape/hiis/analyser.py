"""What every performance element promises (§3.3), and the values that it answers with.

The ray analyser (:mod:`preshape.hiis.virtual_grasp`) is the paper's. The controller knows only this page.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..objects.mesh import TriangleMesh
from ..types import Array, BoolArray, ContactCoefficients, IntArray, value
from .planes import PLANES, ApproachPlane


@value
class HandLayout:
    """What the analyser must know of a hand.

    Attributes:
        name: the hand's name.
        u: U, length of the proximal phalanx of the middle finger [m].
        finger_pitch: distance of neighbouring fingers [m].
        fingertip_width: [m]; fingers are never drawn closer than this.
    """

    name: str
    u: float
    finger_pitch: float
    fingertip_width: float


@value
class Contacts:
    """Where the fingers of one virtual grasp land, thumb first.

    Attributes:
        points: (n, 3) [m], mesh frame.
        normals_in: (n, 3) inward unit normals.
        triangles: (n,) the triangle of each.
        wrenches: (n, 6) each contact's wrench about the COG, axes x y z, lengths in U.
        ray_origins: (n, 3) where each aiming ray starts [m].
    """

    points: Array
    normals_in: Array
    triangles: IntArray
    wrenches: Array
    ray_origins: Array


@value
class Grip:
    """A grasp that the real hand can execute, found by closing it (the closure analyser).

    Attributes:
        approach: (3,) unit vector along which the hand comes straight in, mesh frame.
        palm_pose: (7,) palm frame in the mesh frame, xyz [m] and quaternion wxyz.
        start: (j,) the preshape: joint angles at the beginning of the closing path [rad].
        mask: bit f is set where finger f, in the order of the hand's joints, closes.
        pregrasp: (j,) joint angles, open and clear of the object [rad].
        grasp: (j,) every finger in use touches [rad].
        squeeze: (j,) targets of the joints that press with ``forces`` [rad].
        fingers: names of the fingers in contact, in the order of the contacts, the thumb first.
        forces: (n, 3) what each contact does to the object in the squeeze [N].
        torques: (j,) joint torques of the squeeze [N m].
        task_margin: largest load along the task's wrench cone that the squeeze can balance, over the
            load expected; 1 is just enough.
        hold_margin: the same for pushes and turns in any direction.
        quality: what the critic judges, 0..6; 3 is just enough.
        clearance: least distance of the hand to the object, opened and on the way in [m].
    """

    approach: Array
    palm_pose: Array
    start: Array
    mask: int
    pregrasp: Array
    grasp: Array
    squeeze: Array
    fingers: tuple[str, ...]
    forces: Array
    torques: Array
    task_margin: float
    hold_margin: float
    quality: float
    clearance: float


@value
class VirtualGrasp:
    """One way of holding the object, before any hand has tried it.

    Attributes:
        plane: the approach plane.
        flip: whether the thumb stands on the -o side.
        approach_value: v, -1..1 (§3).
        approach_set: index of the fuzzy set that v belongs to most.
        fingers: virtual fingers, thumb included.
        contacts: where they land.
        net_wrench: (6,) about the COG, axes x y z, lengths in U (eq. 14).
        adi: (6,) ADI of each component with the task (eq. 19).
        tfvadi: their sum (eq. 22).
        stability: rank(WU) - rank(TI), one wrench a finger (§2.3).
        manipulability: rank(WU).
        grip: the hand on it, where the analyser closed a real one; ``None`` of the ray analyser.
    """

    plane: ApproachPlane
    flip: bool
    approach_value: float
    approach_set: int
    fingers: int
    contacts: Contacts
    net_wrench: Array
    adi: Array
    tfvadi: float
    stability: int
    manipulability: int
    grip: Grip | None = None

    @property
    def judged(self) -> float:
        """What the critic compares with its threshold, 0..6, which is TFVADI or the grip's quality."""
        return self.tfvadi if self.grip is None else self.grip.quality

    @property
    def thumb_side(self) -> Array:
        """(3,) unit vector from the object towards the thumb, o, or -o when flipped."""
        o = self.plane.opposition_axis
        return -o if self.flip else o


def wrist_distance(places: Array, turns: Array, place: Array, turn: Array) -> Array:
    """How far wrists are from one of them: 1 is 20 mm, or a turn of 0.35 rad, or a mixture [C].

    Args:
        places: (..., 3) [m].
        turns: (..., 4) quaternions.
        place: (3,) [m], or as many as of the first.
        turn: (4,) quaternion, or as many.
    """
    angle = 2.0 * np.arccos(np.minimum(1.0, np.abs((turns * turn).sum(axis=-1))))
    return np.asarray(np.linalg.norm(places - place, axis=-1) / 0.02 + angle / 0.35)


def same_grip(a: VirtualGrasp, b: VirtualGrasp) -> bool:
    """Whether two grips are nearly one: their wrists at a distance under 1."""
    if a.grip is None or b.grip is None:
        return False
    p, r = a.grip.palm_pose, b.grip.palm_pose
    return float(wrist_distance(p[:3], p[3:], r[:3], r[3:])) < 1.0


@value
class Aim:
    """Where an analyser looks: all combinations of these.

    Attributes:
        planes: approach plane indices, 1..12.
        values: approach values.
        fingers: virtual fingers, thumb included.
        flips: thumb sides.
        recall: planes of which remembered grips are tried too, whatever else they are; only analysers that
            keep grips look.
    """

    planes: Sequence[int] = tuple(p.index for p in PLANES)
    values: Sequence[float] | Array
    fingers: Sequence[int] = (2, 3, 4)
    flips: Sequence[bool] = (False, True)
    recall: Sequence[int] = ()


@value
class Exploration:
    """Every virtual grasp found for an aim; arrays over k grasps, best match first.

    Attributes:
        plane: (k,) plane index.
        flip: (k,) thumb on the -o side.
        value: (k,) approach value.
        fingers: (k,) virtual fingers.
        wrench: (k, 6) net wrench.
        match: (k,) TFVADI with the task.
        aimed: how many combinations were aimed at.
        why: there is none, where there is none.
    """

    plane: IntArray
    flip: BoolArray
    value: Array
    fingers: IntArray
    wrench: Array
    match: Array
    aimed: int
    why: str = "fingers and thumb never meet the object together"

    def __len__(self) -> int:
        return len(self.match)

    def ranked(self) -> Exploration:
        """The best match first; among equals the plainest [C].

        Plainest = aimed nearest to the object's middle, then more fingers, thumb on +o, lower plane
        index. Matches closer than 1e-9 count as equal.
        """
        nearness = np.round(np.abs(self.value), 9)
        keys = (self.plane, self.flip, -self.fingers, nearness, -np.round(self.match, 9))
        return self.where(np.lexsort(keys))

    def where(self, keep: BoolArray | IntArray) -> Exploration:
        """The grasps picked by a mask or by indices, in that order."""
        return Exploration(
            plane=self.plane[keep],
            flip=self.flip[keep],
            value=self.value[keep],
            fingers=self.fingers[keep],
            wrench=self.wrench[keep],
            match=self.match[keep],
            aimed=self.aimed,
        )


class Analyser(Protocol):
    """A performance element's preshape analyser (PA), prepared for one object."""

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
        """What the critic judges its grasps by, for people."""

    @property
    def patience(self) -> int:
        """How many other tasks are tried before task correction gives up."""

    def explore(self, q: Array, aim: Aim) -> Exploration:
        """All virtual grasps of an aim, matched with the task, best first."""

    def grasp(self, q: Array, found: Exploration, index: int = 0) -> VirtualGrasp:
        """One of them in full."""
