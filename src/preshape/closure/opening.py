"""How a hand comes to its grip: opened until it is clear of the object, and straight in from outside."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..hands.kinematics import HandKinematics
from ..hiis.planes import APPROACH_AXES
from ..kernels.chains import rotations
from ..kernels.closing.host import Candidates, ClosingKernel, Obstacles
from ..kernels.tables import HandTables
from ..types import Array, BoolArray, IntArray, value
from .preshapes import posture_at

SELF_DEPTH = 0.001
"""Deeper than this no links may be in each other [m] [C]."""
OPENING = 0.006
"""The pregrasp clears the object by this [m] [C]."""
NEAREST = 0.0008
"""... and by this at least, the palm included [m] [C]."""
ALONG = 0.7
"""Least cosine between the way in and the approach axis of the plane that a grip is counted to."""
STATIONS = np.linspace(0.0, 1.0, 21)
"""Shares of the way back to the open posture at which a pregrasp is looked for."""
WAY_IN, STRIDE = 0.12, 0.006
"""Length of the straight approach that is checked, and the step [m] [C]."""


@value
class Openings:
    """How k hands come to their grips.

    Attributes:
        row: (k,) of the candidates.
        pregrasp: (k, j) opened posture [rad].
        approach: (k, 3) unit vector along which the opened hand comes.
        clearance: (k,) least distance from the object in the pregrasp and on the way [m].
    """

    row: IntArray
    pregrasp: Array
    approach: Array
    clearance: Array

    def __len__(self) -> int:
        return len(self.row)


class Opener:
    """Finds pregrasps and ways in.

    Args:
        tables: the hand's arrays.
        kernel: the hand and the object.
        kinematics: the hand alone.
        obstacles: what is to be kept out of.
    """

    def __init__(
        self, tables: HandTables, kernel: ClosingKernel, kinematics: HandKinematics, obstacles: Obstacles
    ) -> None:
        self.tables, self.kernel, self.kinematics, self.obstacles = tables, kernel, kinematics, obstacles

    def free_of_itself(self, q: Array) -> bool:
        """Whether no links of the hand are in each other."""
        self.kinematics.set_posture(q)
        return not self.kinematics.collides(SELF_DEPTH)

    def find(
        self, candidates: Candidates, closing: Array, rows: IntArray, own: IntArray, planes: Sequence[int]
    ) -> Openings:
        """Pregrasps and ways in of those that have both.

        Args:
            candidates: n of them.
            closing: (n, f) how far each finger is closed.
            rows: (k,) which of them.
            own: (n,) the approach plane that each was drawn for.
            planes: approach planes that the way in may belong to.
        """
        rows, pregrasp, least = self._opened(candidates, closing, rows)
        approach = APPROACH_AXES[own[rows] - 1]
        clearance, free = self._along(candidates, rows, pregrasp, approach)
        # The plane's own direction first; else the fingers' and the palm's, where they are some plane's.
        axes = APPROACH_AXES[np.asarray(planes) - 1]
        R = rotations(candidates.turn[rows])
        for other in (R[:, :, 2], _unit(R[:, :, 2] - R[:, :, 1]), -R[:, :, 1]):
            late = np.flatnonzero(~free & ((other @ axes.T).max(axis=1) > ALONG))
            if len(late):
                found, clear = self._along(candidates, rows[late], pregrasp[late], other[late])
                late, found = late[clear], found[clear]
                approach[late], clearance[late], free[late] = other[late], found, True
        return Openings(
            row=rows[free],
            pregrasp=pregrasp[free],
            approach=approach[free],
            clearance=np.minimum(least, clearance)[free],
        )

    def _opened(
        self, candidates: Candidates, closing: Array, rows: IntArray
    ) -> tuple[IntArray, Array, Array]:
        """Those that open, their postures back along the path that just clear the object, and by how much."""
        k, n = len(rows), len(STATIONS)
        shares = closing[rows, None] * (1.0 - STATIONS[:, None])
        of = np.repeat(rows, n)
        postures = posture_at(self.tables, candidates.start[of], shares.reshape(k * n, closing.shape[1]))
        to_object, to_rest = self.kernel.clearances(
            candidates.place[of], candidates.turn[of], postures, self.obstacles, enough=OPENING
        )
        # Each finger by itself: the station where it has cleared, or where it is clearest.
        fingers = to_object[:, :-1].reshape(k, n, closing.shape[1])
        clear = fingers >= OPENING
        station = np.where(clear.any(axis=1), clear.argmax(axis=1), fingers.argmax(axis=1))
        opened = posture_at(self.tables, candidates.start[rows], closing[rows] * (1.0 - STATIONS[station]))
        reached = np.take_along_axis(fingers, station[:, None], axis=1)[:, 0]
        least = np.minimum(reached.min(axis=1), to_object[:, -1].reshape(k, n)[:, 0])
        blocked = (to_rest.reshape(k, n) <= 0) & (np.arange(n) <= station.max(axis=1)[:, None])
        sound = (least >= NEAREST) & ~blocked.any(axis=1)
        sound[sound] = [self.free_of_itself(q) for q in opened[sound]]
        return rows[sound], opened[sound], least[sound]

    def _along(
        self, candidates: Candidates, rows: IntArray, opened: Array, approach: Array
    ) -> tuple[Array, BoolArray]:
        """(k,) least clearance of opened hands that come straight along ``approach``; whether it is free."""
        steps = np.arange(1, int(WAY_IN / STRIDE) + 1) * STRIDE
        k, n = len(rows), len(steps)
        place = candidates.place[rows, None] - steps[:, None] * approach[:, None]
        to_object, to_rest = self.kernel.clearances(
            place.reshape(k * n, 3),
            np.repeat(candidates.turn[rows], n, axis=0),
            np.repeat(opened, n, axis=0),
            self.obstacles,
            enough=OPENING,
        )
        least = to_object.min(axis=1).reshape(k, n).min(axis=1, initial=np.inf)
        return least, (least > 0.3 * NEAREST) & (to_rest.reshape(k, n) > 0).all(axis=1)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
