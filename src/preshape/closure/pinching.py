"""Pinches of the hand put where two faces of the object lie opposite each other.

A thin object is lost by almost every hand that only aims at its bounding box: fingertips that stand beside
each other by more than its thickness times the friction turn it instead of holding it. Here pads and faces
are put in line first, and the hand follows from that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..kernels.closing import Candidates
from ..kernels.field import DistanceField
from ..kernels.field_numpy import field_distance
from ..planes import APPROACH_AXES, OPPOSITION_AXES
from ..types import Array, BoolArray, IntArray
from .pinches import Pinches
from .sampling import TILT, Sampled, quaternions, small_rotations
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
SURPLUS = 6
"""Pinches looked at for each that is wanted [C]."""
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


def pinched(
    rng: np.random.Generator,
    pinches: Pinches,
    spots: Spots,
    centre: Array,
    half: Array,
    count: int,
    *,
    planes: Sequence[int] = tuple(range(1, 13)),
    flips: Sequence[bool] = (False, True),
    values: Sequence[float] | None = None,
    fingers: Sequence[int] | None = None,
) -> Sampled:
    """Draw candidates that pinch; the other arguments are those of :func:`preshape.closure.sampling.sample`.

    Args:
        rng: of the draws.
        pinches: of the hand.
        spots: of the object.
        centre: (3,) middle of the object's bounding box [m].
        half: (3,) half its extents [m].
        count: how many at most: fewer where few fit.
        planes: approach planes to draw from.
        flips: thumb sides to draw from.
        values: approach values to stay near; by default anywhere.
        fingers: numbers of fingers to draw from; by default any.
    """
    numbers = np.asarray(planes)
    a, o = APPROACH_AXES[numbers - 1], OPPOSITION_AXES[numbers - 1]
    place = (spots.middle - centre) @ a.T / np.maximum(np.abs(a) @ half, 1e-9)
    weight = np.maximum(np.abs(spots.normal @ o.T) - WITHIN, 0.0)
    weight /= 1.0 + np.linalg.norm(spots.middle - centre, axis=1)[:, None] / CENTRAL
    if values is not None:
        weight *= np.abs(place[:, :, None] - np.asarray(values)).min(axis=2) < AHEAD
    allowed = (
        np.arange(len(pinches)) if fingers is None else np.flatnonzero(np.isin(pinches.fingers, fingers))
    )
    n = SURPLUS * count if weight.any() and len(allowed) else 0
    spot, column = np.divmod(_drawn(rng, weight.ravel(), n), len(numbers))
    flip = np.asarray(flips)[rng.integers(len(flips), size=n)]
    width = spots.width[spot]
    about = np.searchsorted(pinches.width[allowed], width) + rng.integers(-ALIKE // 2, ALIKE // 2, size=n)
    pick = allowed[np.clip(about, 0, len(allowed) - 1)]
    thumb_side = np.where(flip[:, None], -o[column], o[column])
    normal = spots.normal[spot]
    normal = np.where(np.einsum("ni,ni->n", normal, thumb_side)[:, None] < 0, -normal, normal)
    middle, opposition = pinches.at(pick, width)
    tilt = rng.uniform(0.0, TILT, n)
    ahead = np.stack([np.zeros(n), -np.sin(tilt), np.cos(tilt)], axis=1)
    turn = frames(normal, a[column]) @ frames(opposition, ahead).transpose(0, 2, 1)
    slant = np.minimum(SLANT * width / (width + 2.0 * pinches.tip[0]), MOST_SLANT)
    off = rng.normal(0.0, AROUND, n)[:, None] * normal + rng.normal(0.0, slant[:, None], (n, 3))
    turn = small_rotations(off) @ turn
    palm = spots.middle[spot] - np.einsum("nij,nj->ni", turn, middle)
    rows = in_turn(fits(spots.field, pinches, pick, palm, turn), pinches.fingers[pick])[:count]
    return Sampled(
        candidates=Candidates(
            place=palm[rows],
            turn=quaternions(turn[rows]),
            start=pinches.start[pick[rows]],
            mask=pinches.mask[pick[rows]],
        ),
        plane=numbers[column[rows]],
        flip=flip[rows],
        value=np.clip(place[spot[rows], column[rows]], -1.0, 1.0),
        preshape=np.full(len(rows), -1),
    )


def _drawn(rng: np.random.Generator, weight: Array, count: int) -> IntArray:
    """(count,) indices, each as often as its weight says."""
    ends = np.cumsum(weight)
    return np.minimum(
        np.searchsorted(ends, rng.random(count) * ends[-1:].sum(), side="right"), max(len(weight) - 1, 0)
    )


def fits(field: DistanceField, pinches: Pinches, pick: IntArray, palm: Array, turn: Array) -> BoolArray:
    """(n,) whether there is object where each finger would meet it, and none where the opened hand is.

    Args:
        field: of the object.
        pinches: of the hand.
        pick: (n,) which.
        palm: (n, 3) where the palm is [m].
        turn: (n, 3, 3) its rotation.
    """
    good = np.zeros(len(pick), dtype=bool)
    hand = palm[:, None] + pinches.palm[:, :3] @ turn.transpose(0, 2, 1)
    rows = np.flatnonzero((_roughly(field, hand) > pinches.palm[:, 3]).all(axis=1))
    used = np.isfinite(pinches.pads[pick[rows], :, 0])
    pads = palm[rows, None] + np.nan_to_num(pinches.pads[pick[rows]]) @ turn[rows].transpose(0, 2, 1)
    off = np.zeros(used.shape)
    off[used] = np.abs(field_distance(field, pads[used]))
    rows = rows[(off < NEAR).all(axis=1)]
    links = palm[rows, None] + pinches.open[pick[rows]] @ turn[rows].transpose(0, 2, 1)
    good[rows[(_roughly(field, links) > ROOM).all(axis=1)]] = True
    return good


def _roughly(field: DistanceField, points: Array) -> Array:
    """(...) signed distance at points (..., 3), at the nearest node of the grid [m]."""
    node = np.rint((points - field.origin) / field.spacing).astype(np.int64)
    i, j, k = np.moveaxis(np.clip(node, 0, np.array(field.distance.shape) - 1), -1, 0)
    return np.asarray(field.distance[i, j, k])


def in_turn(good: BoolArray, kind: IntArray) -> IntArray:
    """The good rows, one of each kind after the other as long as they last.

    >>> in_turn(np.array([True, True, True, False, True]), np.array([2, 2, 2, 3, 4])).tolist()
    [0, 4, 1, 2]
    """
    turn = np.zeros(len(kind), dtype=np.int64)
    for one in np.unique(kind):
        own = np.flatnonzero(good & (kind == one))
        turn[own] = np.arange(len(own))
    rows = np.flatnonzero(good)
    return rows[np.argsort(turn[rows], kind="stable")]


def frames(first: Array, second: Array) -> Array:
    """(n, 3, 3) rotations whose first column is ``first``, and the second as near to ``second`` as can be.

    Args:
        first: (n, 3) unit vectors.
        second: (n, 3) vectors not parallel to them.
    """
    across = second - np.einsum("ni,ni->n", first, second)[:, None] * first
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return np.stack([first, across, np.cross(first, across)], axis=2)
