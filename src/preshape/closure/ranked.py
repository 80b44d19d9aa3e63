"""Candidates that closed, best first: taken, put together, and kept apart from each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..hiis.analyser import wrist_distance
from ..kernels.closing.host import CLOSING_ARRAYS, Candidates, Closings
from ..types import Array, IntArray, value
from .sampling import Sampled

AT_ONCE = 64
"""Candidates whose distances are worked out together."""


@value
class Ranked:
    """Candidates that closed, best first.

    Attributes:
        sampled: (n,) what was drawn, row by row as the rest.
        closings: how they closed.
        score: (n,) the margin that they are ranked by: how many times the unit demand a unit of grip serves.
        task: (n,) strength along the task's wrench cone; plain holding's where there is no task.
        hold: (n,) strength of plain holding, as far as the task's leaves it to decide the score.
        tried: how many candidates were closed for it.
        blocked: how many of them held on to the object, but were in the table or a box.
    """

    sampled: Sampled
    closings: Closings
    score: Array
    task: Array
    hold: Array
    tried: int
    blocked: int = 0

    def __len__(self) -> int:
        return len(self.score)

    def take(self, rows: IntArray) -> Ranked:
        """The candidates of these rows, in that order."""
        return Ranked(
            sampled=take(self.sampled, rows),
            closings=self.closings.take(rows),
            score=self.score[rows],
            task=self.task[rows],
            hold=self.hold[rows],
            tried=self.tried,
            blocked=self.blocked,
        )


def take(sampled: Sampled, rows: IntArray) -> Sampled:
    """The drawn candidates of these rows."""
    return Sampled(
        candidates=sampled.candidates.take(rows),
        plane=sampled.plane[rows],
        flip=sampled.flip[rows],
        value=sampled.value[rows],
        preshape=sampled.preshape[rows],
    )


def joined(*several: Sampled) -> Sampled:
    """All drawn candidates together."""
    return Sampled(
        candidates=Candidates(
            **{
                name: np.concatenate([getattr(one.candidates, name) for one in several])
                for name in ("place", "turn", "start", "mask")
            }
        ),
        **{
            name: np.concatenate([getattr(one, name) for one in several])
            for name in ("plane", "flip", "value", "preshape")
        },
    )


def best_of(*several: Ranked, keep: int | None = None) -> Ranked:
    """All of them together, best first."""
    parts = [one for one in several if len(one)] or [several[0]]
    score = np.concatenate([one.score for one in parts])
    together = Ranked(
        sampled=joined(*(one.sampled for one in parts)),
        closings=Closings(
            **{
                name: np.concatenate([getattr(one.closings, name) for one in parts])
                for name in CLOSING_ARRAYS
            }
        ),
        score=score,
        task=np.concatenate([one.task for one in parts]),
        hold=np.concatenate([one.hold for one in parts]),
        tried=sum(one.tried for one in several),
        blocked=sum(one.blocked for one in several),
    )
    order = np.argsort(-score, kind="stable")
    return together.take(order if keep is None else order[:keep])


def apart(found: Ranked, count: int, least: float = 1.0) -> IntArray:
    """Rows of at most ``count`` candidates, best first, that stand apart from each other.

    Args:
        found: best first.
        count: how many are wanted.
        least: distance that they keep: 1 is 20 mm of wrist, or 0.35 rad of its turn, or a mixture.
    """
    place, turn = found.sampled.candidates.place, found.sampled.candidates.turn
    chosen: list[int] = []
    for first in range(0, len(found), AT_ONCE):
        rows = np.arange(first, min(first + AT_ONCE, len(found)))
        others = np.concatenate([np.array(chosen, dtype=np.int64), rows])
        far = wrist_distance(place[rows, None], turn[rows, None], place[others], turn[others]) >= least
        free = np.asarray(far[:, : len(chosen)].all(axis=1))
        far = far[:, len(chosen) :]
        for k in range(len(rows)):
            if len(chosen) == count:
                break
            if free[k]:
                chosen.append(first + k)
                free &= far[k]
        if len(chosen) == count:
            break
    return np.array(chosen, dtype=np.int64)


def beside(found: Ranked, looked_at: Ranked, sound: Sequence[int]) -> Ranked:
    """What is left of candidates when those are taken away that are like one that cannot be executed.

    Args:
        found: candidates.
        looked_at: those that were worked out.
        sound: rows of these that can be executed; a candidate that is nearer to one of them stays.
    """
    if not len(looked_at) or not len(found):
        return found
    one, other = found.sampled.candidates, looked_at.sampled.candidates
    away = np.stack(
        [wrist_distance(one.place, one.turn, *wrist) for wrist in zip(other.place, other.turn, strict=True)],
        axis=1,
    )
    nearest = away.argmin(axis=1)
    bad = ~np.isin(nearest, np.asarray(sound, dtype=np.int64)) & (away.min(axis=1) < 1.0)
    return found.take(np.flatnonzero(~bad))
