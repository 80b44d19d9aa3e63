"""Grips found for an aim, as the controller reads an exploration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..hiis.analyser import Exploration, Grip
from ..types import BoolArray, IntArray, value


@value
class GripExploration(Exploration):
    """The grips that the closure analyser found.

    Attributes:
        grips: Each of them in full, best first.
    """

    grips: tuple[Grip, ...]

    @property
    def summary(self) -> str:
        """How many grips were found."""
        return f"{self.tried} hands closed on the object, {len(self)} grips worked out"

    def where(self, keep: BoolArray | IntArray) -> GripExploration:
        """The grips picked by a mask or by indices, in that order."""
        rows = np.arange(len(self))[keep]
        return grip_exploration([self.grips[i] for i in rows], self.tried, self.reason)

    def grasp(self, index: int = 0) -> Grip:
        """One of the grips; the best by default."""
        return self.grips[index]


def grip_exploration(grips: Sequence[Grip], tried: int, reason: str = "") -> GripExploration:
    """Grips as the controller explores them.

    Args:
        grips: Best first.
        tried: Number of candidates closed for them.
        reason: What became of the candidates.
    """
    return GripExploration(
        plane=np.array([g.plane.index for g in grips], dtype=np.int64),
        flip=np.array([g.flip for g in grips], dtype=bool),
        value=np.array([g.approach_value for g in grips]),
        fingers=np.array([g.fingers for g in grips], dtype=np.int64),
        wrench=np.array([g.net_wrench for g in grips]).reshape(-1, 6),
        match=np.array([g.judged for g in grips]),
        tried=tried,
        reason=reason,
        grips=tuple(grips),
    )
