"""Pregrasp and approach: the hand opens until it clears the object, and comes in on a straight line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..hands.kinematics import HandKinematics
from ..hiis.planes import APPROACH_AXES
from ..kernels.chains import rotations
from ..kernels.closing.host import Candidates, ClosingKernel, Obstacles
from ..kernels.tables import HandTables
from ..types import Array, BoolArray, IntArray, value
from .hand_pinches import unit
from .keeping_off import KeptOff
from .preshapes import posture_of

SELF_DEPTH = 0.001
"""Largest overlap of two links [m] [C]."""
OPENING = 0.006
"""Wanted clearance between an opened finger and the object [m] [C]."""
NEAREST = 0.0008
"""Least clearance between the opened hand, palm included, and the object [m] [C]."""
ALONG = 0.7
"""Least cosine between the approach direction and the approach axis of the plane that a grip belongs to."""
STATIONS = np.linspace(0.0, 1.0, 21)
"""Fractions of the path back to the open posture at which a pregrasp is tested; 1 is fully open."""
BACK = 0.008
"""Distance by which the opened hand of a wrap stands back [m] [C]."""
WAY_IN, STRIDE = 0.12, 0.006
"""Length of the straight approach that is checked, and the step of that check [m] [C]."""
LIFT, RISE = 0.2, 0.01
"""Height to which the closed hand lifts the object off a table, and the step of that check [m] [C]."""

KEPT_OFF = "a part to keep off"
"""What a part that is kept off is called beside the table and the boxes."""


@value
class Openings:
    """Pregrasps and approach directions of k candidates.

    Attributes:
        row: (k,) indices of the candidates.
        pregrasp: (k, j) joint angles of the opened hand [rad].
        approach: (k, 3) unit vector along which the opened hand approaches.
        clearance: (k,) least distance from the object at the pregrasp and on the approach [m].
        refused: (k) what keeps the hand from opening or from coming in, as a clause; empty if nothing does.
    """

    row: IntArray
    pregrasp: Array
    approach: Array
    clearance: Array
    refused: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.row)


class Opener:
    """Finds pregrasps and collision-free approaches.

    Args:
        tables: Tables of the hand.
        kernel: Closing kernel of the hand and the object.
        kinematics: Kinematics of the hand.
        obstacles: Table and boxes to avoid.
        kept_off: Parts of the object to keep off.
    """

    def __init__(
        self,
        tables: HandTables,
        kernel: ClosingKernel,
        kinematics: HandKinematics,
        obstacles: Obstacles,
        kept_off: KeptOff,
    ) -> None:
        self.tables, self.kernel, self.kinematics = tables, kernel, kinematics
        self.obstacles, self.kept_off = obstacles, kept_off
        # The finger of a motor is that of its first joint.
        first = [int(np.flatnonzero(tables.motor == k)[0]) for k in range(len(tables.range))]
        self._finger_of_motor = np.searchsorted(tables.joint_start, first, side="right") - 1

    def links_apart(self, q: Array) -> bool:
        """Whether no two links of the hand overlap at joint angles q (j,) [rad]."""
        self.kinematics.set_posture(q)
        return not self.kinematics.collides(SELF_DEPTH)

    def find(
        self,
        candidates: Candidates,
        grasp: Array,
        rows: IntArray,
        own: IntArray,
        planes: Sequence[int],
        *,
        wrapping: BoolArray | None = None,
        anyway: bool = False,
    ) -> Openings:
        """Pregrasps and approach directions of the candidates that have both.

        1. Move each finger's motors back towards the preshape until the finger clears the object. On the way,
           and in step 2, the links' spheres keep off what the rules name; the opened hand does so exactly.
        2. Test the straight approach along the candidate's approach axis.
        3. If that is blocked, test the directions of fingers and palm that follow an allowed plane.
        4. On a table, test the closed hand on its way up, where boxes or obstacles may be above it.

        Args:
            candidates: n candidates.
            grasp: (n, j) joint angles of the closed hands [rad].
            rows: (k,) indices of the candidates to open.
            own: (n,) approach plane that each was drawn for.
            planes: Approach planes that the approach direction may belong to.
            wrapping: (n,) whether the hand wraps. Its palm arrives last: the opened hand stands back by
                ``BACK``, and comes in the way that the palm faces.
            anyway: Whether to return the other candidates too, with what refused them.
        """
        R = rotations(candidates.turn)
        if wrapping is not None and wrapping.any():
            back = np.where(wrapping[:, None], BACK * R[:, :, 1], 0.0)
            candidates = replace(candidates, place=candidates.place + back)
        else:
            wrapping = np.zeros(len(grasp), dtype=bool)
        pregrasp, least, opens = self._opened(candidates, grasp, rows, wrapping[rows])  # 1.
        if not anyway:
            rows, pregrasp, least, opens = rows[opens], pregrasp[opens], least[opens], opens[opens]
        R, facing = R[rows], wrapping[rows]
        approach = np.where(facing[:, None], -R[:, :, 1], APPROACH_AXES[own[rows] - 1])
        clearance, free = self._way_in(candidates, rows, pregrasp, approach)  # 2.
        axes = APPROACH_AXES[np.asarray(planes) - 1]
        for other in (R[:, :, 2], unit(R[:, :, 2] - R[:, :, 1]), -R[:, :, 1]):  # 3.
            blocked = np.flatnonzero(~free & ~facing & ((other @ axes.T).max(axis=1) > ALONG))
            if len(blocked):
                found, clear = self._way_in(candidates, rows[blocked], pregrasp[blocked], other[blocked])
                blocked, found = blocked[clear], found[clear]
                approach[blocked], clearance[blocked], free[blocked] = other[blocked], found, True
        rises = self._lift(candidates, rows, grasp)  # 4.
        table = "the table, " if len(self.obstacles.planes) else ""
        box = "a box to avoid, " if len(self.obstacles.boxes) else ""
        names = f"{table}{box}{KEPT_OFF + ', ' if len(self.kept_off) else ''}the object"
        names = " or ".join(names.rsplit(", ", 1))
        above = " or ".join(
            filter(None, [box.removesuffix(", "), "an obstacle" if self.kept_off.beside.any() else ""])
        )
        clauses = np.select(
            [~opens, ~free, ~rises],
            [
                f"the hand cannot open clear of {names}",
                f"{names} is in the open hand's way",
                f"{above} is in the closed hand's way when it lifts the object",
            ],
            "",
        )
        free = (free & rises) | anyway
        return Openings(
            row=rows[free],
            pregrasp=pregrasp[free],
            approach=approach[free],
            clearance=np.minimum(least, clearance)[free],
            refused=tuple(clauses[free].tolist()),
        )

    def _opened(
        self, candidates: Candidates, grasp: Array, rows: IntArray, wrapping: BoolArray
    ) -> tuple[Array, Array, BoolArray]:
        """Opened joint angles (k, j) [rad], their clearance (k,) [m], and whether the hand opens (k,)."""
        k, n, f = len(rows), len(STATIONS), len(self.tables.fingers)
        begin, end = (q[rows] @ self.tables.command.T for q in (candidates.start, grasp))
        shares = 1.0 - STATIONS
        of = np.repeat(rows, n)
        commands = begin[:, None] + shares[:, None] * (end - begin)[:, None]
        postures = posture_of(self.tables, commands.reshape(k * n, len(self.tables.range)))
        to_object, to_obstacles = self.kernel.clearances(
            candidates.place[of], candidates.turn[of], postures, self.obstacles, enough=OPENING
        )
        # Each finger opens on its own: to the first station that clears the object, else to the clearest.
        fingers = to_object[:, :-1].reshape(k, n, f)
        clear = fingers >= OPENING
        station = np.where(clear.any(axis=1), clear.argmax(axis=1), fingers.argmax(axis=1))
        station[wrapping] = n - 1  # the preshape, with which the palm came in
        opened = posture_of(self.tables, begin + shares[station][:, self._finger_of_motor] * (end - begin))
        reached = np.take_along_axis(fingers, station[:, None], axis=1)[:, 0]
        least = np.minimum(reached.min(axis=1), to_object[:, -1].reshape(k, n)[:, 0])
        touched = to_obstacles <= 0
        if len(self.kept_off):
            touched |= self.kept_off.near(candidates.place[of], candidates.turn[of], postures).any(axis=1)
        blocked = touched.reshape(k, n) & (np.arange(n) <= station.max(axis=1)[:, None])
        sound = (least >= NEAREST) & ~blocked.any(axis=1)
        sound[sound] = [self.links_apart(q) for q in opened[sound]]
        if len(self.kept_off):
            still = candidates.take(rows[sound])
            sound[sound] = ~self.kept_off.exactly_near(still.place, still.turn, opened[sound]).any(axis=1)
        return opened, least, sound

    def _way_in(
        self, candidates: Candidates, rows: IntArray, opened: Array, approach: Array
    ) -> tuple[Array, BoolArray]:
        """(k,) least clearance of opened hands along ``approach`` [m]; (k,) whether the approach is free."""
        steps = np.arange(1, int(WAY_IN / STRIDE) + 1) * STRIDE
        k, n = len(rows), len(steps)
        hands = _moved(candidates, rows, opened, -steps[:, None] * approach[:, None])
        to_object, to_obstacles = self.kernel.clearances(*hands, self.obstacles, enough=OPENING)
        least = to_object.min(axis=1).reshape(k, n).min(axis=1, initial=np.inf)
        free = to_obstacles > 0
        if len(self.kept_off):
            free &= ~self.kept_off.near(*hands).any(axis=1)
        return least, (least > 0.3 * NEAREST) & free.reshape(k, n).all(axis=1)

    def _lift(self, candidates: Candidates, rows: IntArray, grasp: Array) -> BoolArray:
        """(k,) whether closed hands are free of boxes and obstacles while they lift off a table."""
        k, beside = len(rows), self.kept_off.beside
        if not k or not len(self.obstacles.planes) or not (len(self.obstacles.boxes) or beside.any()):
            return np.ones(k, dtype=bool)
        heights = np.arange(RISE, LIFT + RISE / 2, RISE)
        n, up = len(heights), self.obstacles.planes[0, :3]
        hands = _moved(candidates, rows, grasp[rows], heights[:, None] * up)
        free = np.ones(k * n, dtype=bool)
        if len(self.obstacles.boxes):
            free &= self.kernel.clearances(*hands, Obstacles(boxes=self.obstacles.boxes))[1] > 0
        if beside.any():
            free &= ~self.kept_off.near(*hands)[:, beside].any(axis=1)
        return np.asarray(free.reshape(k, n).all(axis=1))


def _moved(candidates: Candidates, rows: IntArray, postures: Array, by: Array) -> tuple[Array, Array, Array]:
    """Places (k·n, 3) [m], turns (k·n, 4) and postures (k·n, j) [rad] of k hands, each moved by n vectors.

    Args:
        candidates: The candidates.
        rows: (k,) which of them are moved.
        postures: (k, j) joint angles of their hands [rad].
        by: (k, n, 3) vectors, or (n, 3) for all hands [m].
    """
    place = candidates.place[rows, None] + by
    n = place.shape[1]
    turn, posture = (np.repeat(each, n, axis=0) for each in (candidates.turn[rows], postures))
    return place.reshape(-1, 3), turn, posture
