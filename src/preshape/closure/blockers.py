"""What refuses hands that close on the object: table, boxes, and the contact rules."""

from __future__ import annotations

import numpy as np

from ..hands.hand import Hand
from ..kernels.closing.host import Candidates, ClosingKernel, Closings, Obstacles
from ..kernels.tables import HandTables
from ..types import Array, BoolArray
from .contact_places import ContactPlaces
from .keeping_off import KeptOff
from .preshapes import posture_of
from .settings import ClosureSettings

OPENED, ROOM = 0.8, 0.002
"""The hand must be clear of table, boxes and kept-off parts when closed, and when closed by only the first
share. The second number is the least distance from table and boxes [m] [C]."""
ABOVE = 0.0005
"""Distance beyond ``ROOM`` to which a hand is lifted off the table [m] [C]."""
GRID_ERROR = 0.25
"""Largest error of a contact of the search, which is read from the grid of distances, in cells."""


class Blockers:
    """The obstacles and rules of a search, asked about hands.

    Args:
        hand: The hand.
        tables: Its tables.
        kernel: Closing kernel of the hand and the object.
        settings: Obstacles and rules.
        spacing: Edge of a cell of the object's distance field [m].

    Attributes:
        names: The obstacles, then the contact rules, in words.
        places: The rules about contacts.
        kept_off: The rules about links.
    """

    def __init__(
        self, hand: Hand, tables: HandTables, kernel: ClosingKernel, settings: ClosureSettings, spacing: float
    ) -> None:
        self.obstacles, self._tables, self._kernel = settings.obstacles, tables, kernel
        self.names = (*settings.obstacles.names, *settings.rules.names)
        self.places = ContactPlaces(settings.rules, settings.device)
        self.kept_off = KeptOff(self.places.kept_off, hand, settings)
        self._slack = GRID_ERROR * spacing

    def __len__(self) -> int:
        return len(self.names)

    def refuse(self, closings: Closings, hands: Candidates, grasp: Array) -> BoolArray:
        """Which blockers refuse hands: closed or, with their links, a little opened.

        Args:
            closings: Contacts of k hands.
            hands: The hands.
            grasp: (k, j) their joint angles [rad].

        Returns:
            (k, m) for each of the m blockers of ``names``.
        """
        refused = np.concatenate(
            [np.zeros((len(hands), len(self.obstacles)), dtype=bool), self.misplaced(closings)], axis=1
        )
        if not len(hands) or not (len(self.obstacles) or len(self.kept_off)):
            return refused
        for posture in self._closed_and_opened(hands, grasp):
            refused |= self._near(hands, posture)
        return refused

    def misplaced(self, closings: Closings) -> BoolArray:
        """(k, m) which contact rules the contacts of k hands break, as far as the grid of distances tells."""
        return self.places.broken_by(closings.points, closings.counts, slack=self._slack)

    def clear(self, hands: Candidates) -> BoolArray:
        """(k,) whether hands in their preshapes are clear of all obstacles and kept-off parts."""
        clear = np.ones(len(hands), dtype=bool)
        if len(self.obstacles):
            apart = self._kernel.clearances(
                hands.place, hands.turn, hands.start, self.obstacles, enough=2 * ROOM
            )
            clear = apart[1] > ROOM
        if len(self.kept_off):
            clear &= ~self.kept_off.near(hands.place, hands.turn, hands.start).any(axis=1)
        return clear

    def liftable(self, hands: Candidates, most: float) -> BoolArray:
        """(k,) whether hands in their preshapes reach into the table by less than ``most`` [m]."""
        table = Obstacles(planes=self.obstacles.planes[:1])
        apart = self._kernel.clearances(hands.place, hands.turn, hands.start, table, enough=2 * ROOM)
        return np.asarray(apart[1] > -most)

    def above_table(self, hands: Candidates, grasp: Array) -> Array:
        """(k, 3) how far hands must be moved away from the table to be just clear of it [m].

        Args:
            hands: The hands.
            grasp: (k, j) their joint angles when they are closed [rad].
        """
        table = Obstacles(planes=self.obstacles.planes[:1])
        apart = [
            self._kernel.clearances(hands.place, hands.turn, posture, table)[1]
            for posture in self._closed_and_opened(hands, grasp)
        ]
        short = np.maximum(ROOM + ABOVE - np.minimum(*apart), 0.0)
        return np.asarray(short[:, None] * table.planes[0, :3])

    def _closed_and_opened(self, hands: Candidates, grasp: Array) -> list[Array]:
        """Postures (k, j) [rad] of hands that closed to ``grasp`` (k, j): closed, and a little opened."""
        begin, end = (q @ self._tables.command.T for q in (hands.start, grasp))
        return [posture_of(self._tables, begin + share * (end - begin)) for share in (1.0, OPENED)]

    def _near(self, hands: Candidates, posture: Array) -> BoolArray:
        """(k, m) which blockers links of hands in postures (k, j) [rad] collide with or are too near to."""
        found = np.zeros((len(hands), len(self)), dtype=bool)
        if len(self.obstacles):
            apart = self._kernel.clearances(hands.place, hands.turn, posture, self.obstacles)[1]
            near = np.flatnonzero(apart <= ROOM)
            wrist = hands.place[near], hands.turn[near], posture[near]
            for k, one in enumerate(self.obstacles.each):
                only = len(self.obstacles) == 1
                found[near, k] = only or self._kernel.clearances(*wrist, one)[1] <= ROOM
        if len(self.kept_off):
            found[:, -len(self.kept_off) :] = self.kept_off.near(hands.place, hands.turn, posture)
        return found
