"""Pinches of a hand: postures in which the thumb and some fingers face each other at a known distance.

In most preshapes all fingers close together, and thumb and fingers pass each other at a distance larger than
a thin object. In use, however, each finger closes on its own until it touches. Therefore this module pairs
thumb and fingers at any two points of their closing paths, levels the fingers so that they meet a flat face
together, and stores the pairs that then face each other by the width of the object that they can hold.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from ..hands.hand import Hand
from ..hands.kinematics import HandKinematics
from ..kernels.chains import fingertips, joint_frames
from ..kernels.fitting.host import PinchRows
from ..kernels.tables import HandTables
from ..types import Array, IntArray, value
from .hand_tables import cached, hand_tables
from .preshapes import SELF_DEPTH, motor_ranges, posture_at, posture_of

WIDTHS = np.array([0.0, 3, 6, 10, 15, 20, 27, 35, 45, 60, 80, 100]) * 1e-3
"""Edges of the width classes [m]; each class gets up to :data:`PER_WIDTH` pinches [C]."""
BELOW = (-0.024, -0.018, -0.012, -0.006)
"""Edges of classes of estimated widths below zero: the spheres of flat fingertips overlap where their pads
still stand apart [m] [C]."""
PER_WIDTH = 64
"""Pinches in each width class [C]."""
FACING = 0.5
"""Least cosine between the motion of a closing pad and the direction in which it presses [C]."""
LEVEL = 0.0003
"""Largest distance of a pressing finger from the mean of its group, in the pressing direction [m] [C]."""
PALM_SPHERES = 10
"""Number of palm spheres in the quick test of a pose [C]."""
LONG_LINK = 0.01
"""A joint's body counts as a link if the next joint is further away than this [m] [C]."""
_POSTURES, _STATIONS = 1024, 15  # random postures, and points of the closing path
_LEVELLED, _CHECKED = 48, 6  # pairs levelled, and pairs checked for collisions, for each pinch stored
_ROUNDS = 4  # rounds of levelling
_STEP = 0.01  # step of the closing for finite differences
_ROWS = (
    "start", "mask", "fingers", "width", "thumb", "others", "thumb_rate", "others_rate", "opposition", "pads",
    "open",
)  # fmt: skip


@value
class Pinches:
    """n pinches of a hand, narrowest first; all points in the palm frame.

    Attributes:
        start: (n, j) joint angles at the beginning of the closing [rad].
        mask: (n,) bit f is set where finger f (in the order of the tables) closes.
        fingers: (n,) number of fingers that close, the thumb included.
        width: (n,) thickness of the object between the pads [m].
        thumb: (n, 3) contact point of the thumb [m].
        others: (n, 3) mean of the other fingers' contact points [m].
        thumb_rate: (n, 3) derivative of ``thumb`` by the width, if the thumb takes half of the change.
        others_rate: (n, 3) derivative of ``others`` by the width, likewise.
        opposition: (n, 3) unit vector from the fingers towards the thumb.
        pads: (n, f, 3) contact point of each finger [m]; NaN if the finger does not close.
        open: (n, k, 3) fingertips and middles of the links before closing [m].
        palm: (p, 4) some spheres of the palm: centre and radius [m].
        tip: (1,) radius of the largest fingertip [m].
    """

    start: Array
    mask: IntArray
    fingers: IntArray
    width: Array
    thumb: Array
    others: Array
    thumb_rate: Array
    others_rate: Array
    opposition: Array
    pads: Array
    open: Array
    palm: Array
    tip: Array

    def __len__(self) -> int:
        return len(self.width)

    @property
    def widest(self) -> float:
        """Width of the widest pinch [m]."""
        return float(self.width.max(initial=0.0))

    def take(self, rows: IntArray) -> Pinches:
        """The pinches with these indices."""
        return Pinches(**{name: getattr(self, name)[rows] for name in _ROWS}, palm=self.palm, tip=self.tip)

    @property
    def rows(self) -> PinchRows:
        """The arrays that the fitting kernel reads."""
        return PinchRows(
            mask=self.mask,
            pads=self.pads,
            links=self.open,
            width=self.width,
            thumb=self.thumb,
            others=self.others,
            thumb_rate=self.thumb_rate,
            others_rate=self.others_rate,
            opposition=self.opposition,
            tip=float(self.tip[0]),
        )


@lru_cache(maxsize=16)
def hand_pinches(hand: Hand, seed: int = 0) -> Pinches:
    """The pinches of a hand; empty if thumb and fingers never face each other.

    Args:
        hand: The hand.
        seed: Seed of the random postures; the same seed gives the same pinches.
    """
    label = f"pinches 3 {_POSTURES} {PER_WIDTH} {seed}"
    return cached(Pinches, hand, label, lambda: _find_pinches(hand, seed))


def finger_sets(fingers: int, thumb: int) -> list[int]:
    """Bit masks of all sets that consist of the thumb and some neighbouring fingers.

    >>> [f"{mask:04b}" for mask in finger_sets(4, 3)]
    ['1001', '1010', '1100', '1011', '1110', '1111']
    """
    others = [k for k in range(fingers) if k != thumb]
    return [
        (1 << thumb) | sum(1 << k for k in others[first : first + size])
        for size in range(1, len(others) + 1)
        for first in range(len(others) - size + 1)
    ]


def _find_pinches(hand: Hand, seed: int) -> Pinches:
    """Compute the pinches of a hand.

    1. Draw random postures and compute every fingertip at stations along its closing path.
    2. For each set of fingers and each width class, pair a station of the thumb with a station of the others
       at about that distance.
    3. Level the fingers of each pair and compute the motion of the pads there (:func:`_levelled`).
    4. Accept pairs whose width is in the class and whose links do not collide, neither open nor closed.
    """
    from scipy.stats import qmc

    tables = hand_tables(hand)
    f, t = len(tables.fingers), tables.thumb
    rng = np.random.default_rng(seed)
    # 1. Postures and fingertips.
    low, high = motor_ranges(hand, tables)
    start = posture_of(tables, low + (high - low) * qmc.Sobol(len(low), rng=rng).random(_POSTURES))
    shares = np.linspace(0.0, 1.0, _STATIONS)
    tips = np.stack(
        [fingertips(tables, posture_at(tables, start, np.full((_POSTURES, f), c))) for c in shares], axis=1
    )
    radius = np.array([next(x for x in hand.fingers if x.name == name).tip_radius for name in tables.fingers])
    kinematics = HandKinematics(hand)
    sets = finger_sets(f, t)
    each = max(2, PER_WIDTH // len(sets))
    found = [_levelled(tables, start[:0], np.zeros((0, f)), sets[0])[0]]
    for mask in sets:
        others = _others(tables, mask)
        apart = tips[:, :, None, t] - tips[:, None, :, others].mean(axis=-2)
        rough = (np.linalg.norm(apart, axis=-1) - radius[t] - radius[others].mean()).reshape(_POSTURES, -1)
        # The distance of the tips' spheres only estimates that of the pads, so pinches of one class are drawn
        # for the classes beside it as well.
        levelled, closings = [found[0]], [np.zeros((0, f))]
        for narrow, wide in itertools.pairwise((*BELOW, *WIDTHS)):
            # 2. One random pair of stations of about this width from each posture.
            about = ((rough >= narrow) & (rough < wide)) * rng.random(rough.shape)
            rows = rng.permutation(np.flatnonzero(about.any(axis=1)))[: _LEVELLED * each]
            a, b = np.divmod(about[rows].argmax(axis=1), _STATIONS)
            closing = np.zeros((len(rows), f))
            closing[:, others], closing[:, t] = shares[b][:, None], shares[a]
            # 3.
            pinches, closing = _levelled(tables, start[rows], closing, mask)
            levelled.append(pinches)
            closings.append(closing)
        # 4.
        every = replace(levelled[0], **_rows(levelled))
        closing = np.concatenate(closings)
        for narrow, wide in itertools.pairwise(WIDTHS):
            inside = np.flatnonzero((every.width >= narrow) & (every.width < wide))[: _CHECKED * each]
            closed = posture_at(tables, every.start[inside], closing[inside])
            clear = [
                k
                for k, q in zip(inside, closed, strict=True)
                if _collision_free(kinematics, every.start[k], q)
            ]
            found.append(every.take(np.array(clear[:each], dtype=np.int64)))
    together = _rows(found)
    order = np.argsort(together["width"], kind="stable")
    return Pinches(
        **{name: rows[order] for name, rows in together.items()},
        palm=_spread_out(tables.palm[: tables.palm_spheres], PALM_SPHERES),
        tip=radius.max(keepdims=True),
    )


def _rows(parts: Sequence[Pinches]) -> dict[str, Any]:
    """The rows of several sets of pinches, one after the other."""
    return {name: np.concatenate([getattr(pinches, name) for pinches in parts]) for name in _ROWS}


def _levelled(tables: HandTables, start: Array, closing: Array, mask: int) -> tuple[Pinches, Array]:
    """Adjust given closings until the fingers are level, and return the pinches there.

    1. Find each finger's pad: the sphere of its last link that protrudes furthest towards the other side.
    2. Measure how far each finger stands behind the mean, and how fast closing moves it forward.
    3. Change each finger's closing by the distance divided by that rate, and repeat from 1.
    4. Accept where all pads move towards the other side and the fingers are level.

    Args:
        tables: The hand's tables.
        start: (n, j) postures at the beginning of the closing [rad].
        closing: (n, f) closing of each finger, 0..1.
        mask: Bit f is set where finger f takes part.

    Returns:
        The m ≤ n pinches that were accepted, and their closings (m, f).
    """
    t, others, closing = tables.thumb, _others(tables, mask), closing.copy()
    tips = fingertips(tables, posture_at(tables, start, closing))
    e = unit(tips[:, t] - tips[:, others].mean(axis=1))
    for rounds_left in reversed(range(_ROUNDS)):
        pads = _Pads(tables, start, closing, e)  # 1.
        rate = (pads.at(closing + _STEP) - pads.centre) / _STEP
        thumb, mean = pads.centre[:, t], pads.centre[:, others].mean(axis=1)
        e = unit(thumb - mean)
        speed = np.einsum("nfi,ni->nf", rate, e)
        front = (np.einsum("nfi,ni->nf", pads.centre, e) + pads.radius)[:, others]
        behind = front.mean(axis=1, keepdims=True) - front  # 2.
        if rounds_left:  # 3.
            own = speed[:, others]
            step = np.where(own > 0, behind / np.maximum(own, 0.02), 0.0)
            closing[:, others] = np.clip(closing[:, others] + np.clip(step, -0.1, 0.1), 0.0, 1.0 - _STEP)
    # 4.
    facing = speed / np.maximum(np.linalg.norm(rate, axis=2), 1e-9)
    facing[:, t] *= -1
    accepted = (facing[:, [t, *others]] >= FACING).all(axis=1) & (np.abs(behind) < LEVEL).all(axis=1)
    speed = np.where(np.abs(speed) > 1e-6, speed, 1.0)
    used = (mask >> np.arange(len(tables.fingers))) & 1 == 1
    side = np.where(np.arange(len(tables.fingers)) == t, -1.0, 1.0)
    touch = pads.centre + side[:, None] * pads.radius[:, :, None] * e[:, None]
    mean = mean + pads.radius[:, others].mean(axis=1)[:, None] * e
    pinches = Pinches(
        start=start,
        mask=np.full(len(start), mask),
        fingers=np.full(len(start), len(others) + 1),
        width=np.einsum("ni,ni->n", touch[:, t] - mean, e),
        thumb=touch[:, t],
        others=mean,
        thumb_rate=0.5 * rate[:, t] / speed[:, t, None],
        others_rate=-0.5 * (rate / speed[:, :, None])[:, others].mean(axis=1),
        opposition=e,
        pads=np.where(used[:, None], touch, np.nan),
        open=_tips_and_links(tables, start),
        palm=np.zeros((0, 4)),
        tip=np.zeros(1),
    )
    rows = np.flatnonzero(accepted)
    return pinches.take(rows), closing[rows]


class _Pads:
    """For each finger the sphere of its last link that protrudes furthest towards the other side.

    Attributes:
        centre: (n, f, 3) centre of that sphere, palm frame [m].
        radius: (n, f) its radius [m].
    """

    def __init__(self, tables: HandTables, start: Array, closing: Array, e: Array) -> None:
        self.tables, self.start = tables, start
        n, f = closing.shape
        self._local, self.radius = np.zeros((n, f, 3)), np.zeros((n, f))
        self._last = tables.joint_start[1:] - 1
        places, turns = joint_frames(tables, posture_at(tables, start, closing))
        for k, joint in enumerate(self._last):
            spheres = tables.sphere[tables.sphere_start[joint] : tables.sphere_start[joint + 1]]
            side = -e if k == tables.thumb else e
            out = np.einsum("ni,nij,sj->ns", side, turns[:, joint], spheres[:, :3]) + spheres[:, 3]
            best = out.argmax(axis=1)
            self._local[:, k], self.radius[:, k] = spheres[best, :3], spheres[best, 3]
        self.centre = self._placed(places, turns)

    def at(self, closing: Array) -> Array:
        """(n, f, 3) centres of the same spheres at other closings (n, f) [m]."""
        return self._placed(*joint_frames(self.tables, posture_at(self.tables, self.start, closing)))

    def _placed(self, places: Array, turns: Array) -> Array:
        turned = np.einsum("nfij,nfj->nfi", turns[:, self._last], self._local)
        return np.asarray(places[:, self._last] + turned)


def unit(vectors: Array) -> Array:
    """(n, 3) vectors scaled to unit length."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12))


def _others(tables: HandTables, mask: int) -> list[int]:
    """Fingers of a mask without the thumb."""
    return [k for k in range(len(tables.fingers)) if k != tables.thumb and mask >> k & 1]


def _tips_and_links(tables: HandTables, start: Array) -> Array:
    """(n, k, 3) fingertips and middles of the long links, palm frame [m]."""
    places, turns = joint_frames(tables, start)
    last = tables.joint_start[1:] - 1
    tips = places[:, last] + np.einsum("nfij,fj->nfi", turns[:, last], tables.tip)
    ends = np.concatenate([places[:, 1:], places[:, :1]], axis=1)
    ends[:, last] = tips
    length = np.append(np.linalg.norm(tables.offset[1:], axis=1), 0.0)
    links = np.flatnonzero(np.isin(np.arange(len(length)), last) | (length > LONG_LINK))
    return np.concatenate([tips, ((places + ends) / 2)[:, links]], axis=1)


def _spread_out(spheres: Array, count: int) -> Array:
    """At most ``count`` of the spheres (n, 4), each as far as possible from those before it."""
    chosen: list[int] = []
    gap = spheres[:, 3].copy()
    while len(chosen) < min(count, len(spheres)):
        chosen.append(int(gap.argmax()))
        distance = np.linalg.norm(spheres[:, :3] - spheres[chosen[-1], :3], axis=1)
        gap = distance if len(chosen) == 1 else np.minimum(gap, distance)
    return spheres[chosen]


def _collision_free(kinematics: HandKinematics, *postures: Array) -> bool:
    """Whether no two links overlap in any of the postures."""
    for q in postures:
        kinematics.set_posture(q)
        if kinematics.self_collisions(SELF_DEPTH):
            return False
    return True
