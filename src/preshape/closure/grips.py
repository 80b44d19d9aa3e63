"""Grips found for an aim, as the controller reads an exploration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..hiis.analyser import Exploration, VirtualGrasp
from ..types import BoolArray, IntArray, value


@value
class Grips(Exploration):
    """Grips found for an aim.

    Attributes:
        grasps: each of them in full.
    """

    grasps: tuple[VirtualGrasp, ...]

    def where(self, keep: BoolArray | IntArray) -> Grips:
        """The grips picked by a mask or by indices, in that order."""
        rows = np.flatnonzero(keep) if np.asarray(keep).dtype == bool else np.asarray(keep)
        return gathered([self.grasps[i] for i in rows], self.aimed, self.why)


def gathered(grasps: Sequence[VirtualGrasp], tried: int, why: str = "") -> Grips:
    """Grips in full as the controller explores them.

    Args:
        grasps: best first.
        tried: candidates closed for them.
        why: what became of the candidates.
    """
    return Grips(
        plane=np.array([g.plane.index for g in grasps], dtype=np.int64),
        flip=np.array([g.flip for g in grasps], dtype=bool),
        value=np.array([g.approach_value for g in grasps]),
        fingers=np.array([g.fingers for g in grasps], dtype=np.int64),
        wrench=np.array([g.net_wrench for g in grasps]).reshape(-1, 6),
        match=np.array([g.judged for g in grasps]),
        aimed=tried,
        why=why,
        grasps=tuple(grasps),
    )
