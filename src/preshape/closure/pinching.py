"""Pinches of the hand put where two faces of the object lie opposite each other.

A thin object is lost by almost every hand that only aims at its bounding box: fingertips that stand beside
each other by more than its thickness times the friction turn it instead of holding it. Here pads and faces
are put in line first, and the hand follows from that.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..hiis.planes import APPROACH_AXES, OPPOSITION_AXES
from ..kernels.closing.host import Candidates, ClosingKernel
from ..kernels.fitting.host import FittingKernel, Puts, SpotRows
from ..types import Array, IntArray
from .pinches import Pinches
from .sampling import TILT, Sampled
from .spots import Spots

PINCHED = 0.5
"""Share of the candidates that are pinches, as far as there are any [C]."""
WITHIN = 0.55
"""Least cosine between the faces' normal and a plane's opposition axis: some axis is always nearer [C]."""
AHEAD = 0.2
"""Spots are within this of an approach value that is aimed at, in half-extents [C]."""
CENTRAL = 0.01
"""A spot this far from the middle is drawn half as often as one in it: weight and pushes turn less there
[m] [C]."""
SURPLUS, TWICE = 4, 2
"""Pinches looked at for each that is wanted, and how often where too few of them fit [C]."""
NEAR = 0.005
"""Every pad of a pinch is this near to the object, where the fingers should meet [m] [C]."""
ROOM = 0.006
"""The middles of the opened fingers' links keep this from the object [m] [C]."""
ALIKE = 24
"""Pinches about as wide as the object is at the spot, of which one is taken [C]."""
AROUND = 0.4
"""Spread of a pinch about the faces' normal [rad] [C]."""
SLANT, MOST_SLANT = 0.1, 0.02
"""Spread off the normal, in how far the object is thicker than the fingers; and at most [rad] [C]."""


class Pincher:
    """One hand and one object, between whose faces the hand is put.

    Args:
        pinches: of the hand.
        spots: of the object.
        centre: (3,) middle of the object's bounding box [m].
        half: (3,) half its extents [m].
        closing: the same hand and object, ready to close.
    """

    def __init__(
        self, pinches: Pinches, spots: Spots, centre: Array, half: Array, closing: ClosingKernel
    ) -> None:
        self.pinches, self.spots = pinches, spots
        self.centre, self.half = centre, half
        self.kernel = FittingKernel(
            closing.field,
            pinches.palm,
            pinches.rows,
            SpotRows(spots.middle, spots.normal, spots.width),
            near=NEAR,
            room=ROOM,
            device=closing.device,
            threads=closing.threads,
        )

    def draw(
        self,
        rng: np.random.Generator,
        count: int,
        *,
        planes: Sequence[int] = tuple(range(1, 13)),
        flips: Sequence[bool] = (False, True),
        values: Sequence[float] | None = None,
        fingers: Sequence[int] | None = None,
    ) -> Sampled:
        """Draw candidates that pinch.

        Args:
            rng: of the draws.
            count: how many at most: fewer where few fit.
            planes: approach planes to draw from.
            flips: thumb sides to draw from.
            values: approach values to stay near; by default anywhere.
            fingers: numbers of fingers to draw from; by default any.
        """
        pinches, spots = self.pinches, self.spots
        numbers = np.asarray(planes)
        a, o = APPROACH_AXES[numbers - 1], OPPOSITION_AXES[numbers - 1]
        away = spots.middle - self.centre
        place = away @ a.T / np.maximum(np.abs(a) @ self.half, 1e-9)
        weight = np.maximum(np.abs(spots.normal @ o.T) - WITHIN, 0.0)
        weight /= 1.0 + np.linalg.norm(away, axis=1)[:, None] / CENTRAL
        if values is not None:
            weight *= np.abs(place[:, :, None] - np.asarray(values)).min(axis=2) < AHEAD
        any_of = np.arange(len(pinches))
        allowed = any_of if fingers is None else any_of[np.isin(pinches.fingers, fingers)]
        n = SURPLUS * count if weight.any() and len(allowed) else 0
        sides = np.stack([o, -o])
        parts: list[tuple[Any, ...]] = []
        for _ in range(TWICE):
            spot, column = np.divmod(_drawn(rng, weight.ravel(), n), len(numbers))
            flip = np.asarray(flips)[rng.integers(len(flips), size=n)]
            puts = self._puts(rng, allowed, spot, a[column], sides[flip.astype(np.int64), column])
            fit, palm, turn = self.kernel.put(puts)
            parts.append((spot[fit], column[fit], flip[fit], puts.pick[fit], palm, turn))
            if sum(len(part[0]) for part in parts) >= count:
                break
        spot, column, flip, pick, palm, turn = (np.concatenate(each) for each in zip(*parts, strict=True))
        rows = in_turn(pinches.fingers[pick])[:count]
        return Sampled(
            candidates=Candidates(
                place=palm[rows],
                turn=turn[rows],
                start=pinches.start[pick[rows]],
                mask=pinches.mask[pick[rows]],
            ),
            plane=numbers[column[rows]],
            flip=flip[rows],
            value=np.clip(place[spot[rows], column[rows]], -1.0, 1.0),
            preshape=np.full(len(rows), -1),
        )

    def _puts(
        self, rng: np.random.Generator, allowed: IntArray, spot: IntArray, approach: Array, side: Array
    ) -> Puts:
        """A pinch for each spot, and how it is put there.

        Args:
            rng: of the draws.
            allowed: pinches to draw from.
            spot: (n,) which spots.
            approach: (n, 3) approach axes.
            side: (n, 3) where the thumb is.
        """
        n, width = len(spot), self.spots.width
        about = np.searchsorted(self.pinches.width[allowed], width)[spot]
        about += rng.integers(-ALIKE // 2, ALIKE // 2, size=n)
        slant = np.minimum(SLANT * width / (width + 2.0 * self.pinches.tip[0]), MOST_SLANT)
        off = rng.normal(0.0, 1.0, (n, 4))
        off[:, 0] *= AROUND
        off[:, 1:] *= slant[spot, None]
        return Puts(
            pick=allowed[np.clip(about, 0, len(allowed) - 1)],
            spot=spot,
            approach=approach,
            side=side,
            tilt=rng.uniform(0.0, TILT, n),
            off=off,
        )


def _drawn(rng: np.random.Generator, weight: Array, count: int) -> IntArray:
    """(count,) indices, each as often as its weight says."""
    ends = np.cumsum(weight)
    return np.minimum(
        np.searchsorted(ends, rng.random(count) * ends[-1:].sum(), side="right"), max(len(weight) - 1, 0)
    )


def in_turn(kind: IntArray) -> IntArray:
    """All rows, one of each kind after the other as long as they last.

    >>> in_turn(np.array([2, 2, 2, 4])).tolist()
    [0, 3, 1, 2]
    """
    turn = np.zeros(len(kind), dtype=np.int64)
    for one in np.unique(kind):
        own = np.flatnonzero(kind == one)
        turn[own] = np.arange(len(own))
    return np.argsort(turn, kind="stable")
