"""Candidates are preshaped hands that pinch at an aim point: drawing, ranking, and removing similar ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..hands.kinematics import cross
from ..hiis.analyser import wrist_distance
from ..hiis.planes import APPROACH_AXES, OPPOSITION_AXES
from ..kernels.closing.host import CLOSING_ARRAYS, Candidates, Closings
from ..spatial import rotation_from_vector
from ..types import Array, BoolArray, IntArray, value
from .preshapes import STATIONS, Preshapes

TILT = 1.2
"""Largest tilt of the fingers (+z of the palm frame) off the approach axis, towards the palm's side [rad]."""
JITTER = 0.2
"""Standard deviation of the random rotation that is added to the plane's orientation [rad]."""
REACH = 0.85
"""Aim points lie within this fraction of the object's half-extents."""
_BATCH = 64
"""Number of candidates whose distances are computed in one batch."""
CANDIDATE_ARRAYS = ("place", "turn", "start", "mask")
"""The arrays of :class:`~preshape.kernels.closing.host.Candidates`, one row for each."""
_DRAWN, _RANKED = ("plane", "flip", "value", "preshape"), ("score", "task", "hold")


@value
class Region:
    """The part of the search space that candidates are drawn from.

    Attributes:
        planes: Approach planes, 1..12.
        flips: Allowed thumb sides: True for the -o side, False for the +o side.
        values: Approach values around which aim points are drawn; ``None`` allows any.
        fingers: Numbers of fingers that close; ``None`` allows any.
        box: (2, 3) bounding box of the surface that may be touched [m]; ``None`` for the whole object.
    """

    planes: Sequence[int] = tuple(range(1, 13))
    flips: Sequence[bool] = (False, True)
    values: Sequence[float] | None = None
    fingers: Sequence[int] | None = None
    box: Array | None = None


@value
class DrawnCandidates:
    """n candidates with their origin.

    Attributes:
        candidates: Wrist poses and preshapes.
        plane: (n,) approach plane, 1..12.
        flip: (n,) whether the thumb stands on the -o side.
        value: (n,) approach value: position of the aim point along the approach axis, in half-extents.
        preshape: (n,) row in the pool of preshapes; -1 if the candidate does not come from the pool.
    """

    candidates: Candidates
    plane: IntArray
    flip: BoolArray
    value: Array
    preshape: IntArray

    def __len__(self) -> int:
        return len(self.plane)

    def take(self, rows: IntArray) -> DrawnCandidates:
        """The candidates with these indices, in that order."""
        own = {name: getattr(self, name)[rows] for name in _DRAWN}
        return DrawnCandidates(candidates=self.candidates.take(rows), **own)


@value
class RankedCandidates:
    """n candidates that closed on the object, best first.

    Attributes:
        drawn: (n,) the candidates.
        closings: How they closed.
        score: (n,) margin for the ranking: strength divided by expected load, per unit of normal force.
        task: (n,) strength along the task's wrench cone, or of plain holding if there is no task.
        hold: (n,) strength of plain holding, exact only where it can lower the score.
        tally: (4 + m,) number of candidates that were tried; that closed on the object; that were clear of
            all obstacles and contact rules too; that balance some of the load too; and for each of these m
            blockers, that closed on the object and were refused because of it. A tally is not reduced by
            ``take``.
    """

    drawn: DrawnCandidates
    closings: Closings
    score: Array
    task: Array
    hold: Array
    tally: IntArray

    def __len__(self) -> int:
        return len(self.score)

    @property
    def tried(self) -> int:
        """Number of candidates that were tried."""
        return int(self.tally[0])

    def take(self, rows: IntArray) -> RankedCandidates:
        """The candidates with these indices, in that order."""
        own = {name: getattr(self, name)[rows] for name in _RANKED}
        return replace(self, drawn=self.drawn.take(rows), closings=self.closings.take(rows), **own)


def draw_candidates(
    rng: np.random.Generator, pool: Preshapes, centre: Array, half: Array, count: int, region: Region
) -> DrawnCandidates:
    """Draw candidates that pinch at random aim points.

    1. Draw a preshape, an approach plane and a thumb side.
    2. Draw an aim point in the bounding box of the object, or of its surface that may be touched, near the
       middle along the opposition axis.
    3. Choose the station of the closing path whose aperture suits the object's width.
    4. Orient the hand for the plane, add a random tilt and rotation, and move the station's pinch point onto
       the aim point.

    Args:
        rng: Random generator.
        pool: Preshapes of the hand.
        centre: (3,) middle of the object's bounding box [m].
        half: (3,) half the extents of that box [m].
        count: Number of candidates.
        region: Where to draw; without approach values, aim points lie anywhere in ±``REACH`` of the box. An
            approach value outside the surface that may be touched means its nearest end.
    """
    rows = np.arange(len(pool.start))
    if region.fingers is not None:
        rows = rows[np.isin(pool.fingers, region.fingers)]
    # 1. Preshape, plane, thumb side.
    pick = rows[rng.integers(len(rows), size=count)]
    plane = np.asarray(region.planes)[rng.integers(len(region.planes), size=count)]
    flip = np.asarray(region.flips)[rng.integers(len(region.flips), size=count)]
    a, o = APPROACH_AXES[plane - 1], OPPOSITION_AXES[plane - 1]
    t = cross(a, o)
    along = np.abs(a) @ half
    if region.box is None:
        middle, shift, share, size = centre, np.zeros(count), np.ones(count), half
    else:
        middle, size = region.box.mean(axis=0), 0.5 * (region.box[1] - region.box[0])
        reach = np.maximum(along, 1e-9)
        shift, share = np.einsum("ni,i->n", a, middle - centre) / reach, (np.abs(a) @ size) / reach
    across, aside = (np.abs(x) @ size for x in (o, t))
    # 2. Aim point.
    if region.values is None:
        v = shift + share * rng.uniform(-REACH, REACH, count)
    else:
        values = np.asarray(region.values)
        v = values[rng.integers(len(values), size=count)] + rng.normal(0.0, 0.1, count)
        if region.box is not None:
            v = np.clip(v, shift - REACH * share, shift + REACH * share)
    u, w = rng.uniform(-REACH, REACH, count), rng.normal(0.0, 0.15, count)
    aim = middle + ((v - shift) * along)[:, None] * a + (u * aside)[:, None] * t + (w * across)[:, None] * o
    # 3. Station.
    station = _station(rng, pool.aperture[pick], 2 * across)
    # 4. Palm pose.
    R = _rotations(rng, pool.opposition[pick, station], a, np.where(flip[:, None], -o, o))
    place = aim - np.einsum("nij,nj->ni", R, pool.pinch[pick, station])
    return DrawnCandidates(
        candidates=Candidates(place=place, turn=quaternions(R), start=pool.start[pick], mask=pool.mask[pick]),
        plane=plane,
        flip=flip,
        value=v,
        preshape=pick,
    )


def _station(rng: np.random.Generator, aperture: Array, width: Array) -> IntArray:
    """(n,) station of the closing path whose aperture fits a random fraction of the object's width."""
    wanted = width * rng.uniform(0.35, 1.15, len(width)) + 0.015
    return np.abs(aperture[:, : STATIONS - 2] - wanted[:, None]).argmin(axis=1)


def _rotations(rng: np.random.Generator, opposition: Array, approach: Array, thumb_side: Array) -> Array:
    """(n, 3, 3) R_mesh_palm: +z near the approach axis, the thumb on its side, plus a random rotation."""
    n = len(opposition)
    tilt = rng.uniform(0.0, TILT, n)
    d = np.stack([np.zeros(n), -np.sin(tilt), np.cos(tilt)], axis=1)
    e = opposition - np.einsum("ni,ni->n", opposition, d)[:, None] * d
    e /= np.maximum(np.linalg.norm(e, axis=1, keepdims=True), 1e-9)
    palm = np.stack([d, e, cross(d, e)], axis=2)
    mesh = np.stack([approach, thumb_side, cross(approach, thumb_side)], axis=2)
    R = mesh @ palm.transpose(0, 2, 1)
    return np.asarray(rotation_from_vector(rng.normal(0.0, JITTER, (n, 3))) @ R)


def quaternions(R: Array) -> Array:
    """(n, 4) unit quaternions wxyz of rotation matrices (n, 3, 3); the matrices are not checked."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(R, assume_valid=True).as_quat(scalar_first=True))


def concatenated(*batches: DrawnCandidates) -> DrawnCandidates:
    """Several batches as one."""
    candidates = [batch.candidates for batch in batches]
    return DrawnCandidates(
        candidates=Candidates(**columns(candidates, CANDIDATE_ARRAYS)),
        **columns(batches, _DRAWN),
    )


def columns(batches: Sequence[object], names: Sequence[str]) -> dict[str, Any]:
    """Each of the named arrays of all batches, one batch after the other."""
    return {name: np.concatenate([getattr(batch, name) for batch in batches]) for name in names}


def merged(*batches: RankedCandidates, most: int | None = None) -> RankedCandidates:
    """Several batches as one, best first; at most ``most`` candidates."""
    parts = [batch for batch in batches if len(batch)] or [batches[0]]
    together = RankedCandidates(
        drawn=concatenated(*(part.drawn for part in parts)),
        closings=Closings(**columns([part.closings for part in parts], CLOSING_ARRAYS)),
        **columns(parts, _RANKED),
        tally=np.sum([batch.tally for batch in batches], axis=0),
    )
    order = np.argsort(-together.score, kind="stable")
    return together.take(order if most is None else order[:most])


def distinct(found: RankedCandidates, count: int, least: float = 1.0) -> IntArray:
    """Indices of at most ``count`` candidates, best first, whose wrists differ from each other.

    Args:
        found: Candidates, best first.
        count: Largest number of indices returned.
        least: Least :func:`~preshape.hiis.analyser.wrist_distance` between any two of them.
    """
    place, turn = found.drawn.candidates.place, found.drawn.candidates.turn
    chosen: list[int] = []
    for first in range(0, len(found), _BATCH):
        rows = np.arange(first, min(first + _BATCH, len(found)))
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


def without_failed(
    found: RankedCandidates, examined: RankedCandidates, executable: Sequence[int]
) -> RankedCandidates:
    """Drop the candidates whose nearest examined neighbour is close and cannot be executed.

    Args:
        found: Candidates to select from.
        examined: Candidates that were checked in full.
        executable: Indices of the examined candidates that the hand can execute.
    """
    if not len(examined) or not len(found):
        return found
    own, other = found.drawn.candidates, examined.drawn.candidates
    distance = np.stack(
        [wrist_distance(own.place, own.turn, *wrist) for wrist in zip(other.place, other.turn, strict=True)],
        axis=1,
    )
    nearest = distance.argmin(axis=1)
    failed = ~np.isin(nearest, np.asarray(executable, dtype=np.int64)) & (distance.min(axis=1) < 1.0)
    return found.take(np.flatnonzero(~failed))
