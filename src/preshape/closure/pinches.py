"""Pinches of a hand: where thumb and fingers meet each other at some distance.

A preshape's own closing brings thumb and fingers along together, and most of them then miss each other by
more than a thin object. But every finger closes by itself, until it touches. So thumb and fingers are paired
at any two points of their paths; the fingers are brought level, so that they meet a flat face together; and
what then faces each other is kept, by the width of what it can hold.
"""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np

from ..hands.hand import Hand
from ..hands.kinematics import HandKinematics
from ..kernels.chains import fingertips, joint_frames
from ..kernels.fitting.host import PinchRows
from ..kernels.tables import HandTables
from ..types import Array, IntArray, value
from .hand_tables import cached, hand_tables
from .preshapes import SELF_DEPTH, joint_ranges, posture_at

WIDTHS = np.array([0.0, 3, 6, 10, 15, 20, 27, 35, 45, 60, 80, 100]) * 1e-3
"""Between each two of these there are as many pinches, as far as the hand has them [m] [C]."""
EACH = 64
"""Pinches for each [C]."""
FACING = 0.5
"""Least cosine between the way of a closing pad and the direction that it presses in [C]."""
LEVEL = 0.0003
"""Fingers that press together stand this much before or behind each other at most [m] [C]."""
PALM = 10
"""Spheres of the palm that a place is first tried with [C]."""
LONG = 0.01
"""A link is one where the next joint is further than this [m] [C]."""
_DRAWS, _STATIONS = 1024, 15
_MET, _LOOKED = 16, 3  # meetings worked out, and those of them looked at, for one that is kept
_ROUNDS = 4  # in which fingers are brought level
_STEP = 0.01  # of the closing, for rates
_ROWS = (
    "start", "mask", "fingers", "width", "thumb", "others", "thumb_rate", "others_rate", "opposition", "pads",
    "open",
)  # fmt: skip


@value
class Pinches:
    """n pinches, narrowest first.

    Attributes:
        start: (n, j) joint angles at the beginning of the closing [rad].
        mask: (n,) bit f is set where finger f (of the tables' order) closes.
        fingers: (n,) how many close, the thumb included.
        width: (n,) of what is between the pads [m].
        thumb: (n, 3) where the thumb touches it, palm frame [m].
        others: (n, 3) mean of where the others do [m].
        thumb_rate: (n, 3) how ``thumb`` moves when the width grows, half of it on this side.
        others_rate: (n, 3) how ``others`` does.
        opposition: (n, 3) unit vector from the fingers towards the thumb.
        pads: (n, f, 3) where each finger touches [m], NaN where it does not close.
        open: (n, k, 3) tips of the fingers and middles of their links before they close [m].
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
        """Width of the widest [m]."""
        return float(self.width.max(initial=0.0))

    def take(self, rows: IntArray) -> Pinches:
        """The pinches of these rows."""
        return Pinches(**{name: getattr(self, name)[rows] for name in _ROWS}, palm=self.palm, tip=self.tip)

    @property
    def rows(self) -> PinchRows:
        """As the fitting kernel takes them."""
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
    """The hand's pinches, the same for the same seed; none where thumb and fingers never face each other.

    Args:
        hand: which hand.
        seed: of the draws.
    """
    return cached(Pinches, hand, f"pinches 1 {_DRAWS} {EACH} {seed}", lambda: _pinches(hand, seed))


def finger_sets(fingers: int, thumb: int) -> list[int]:
    """Bits of every set of the thumb with neighbouring fingers.

    >>> [f"{mask:04b}" for mask in finger_sets(4, 3)]
    ['1001', '1010', '1100', '1011', '1110', '1111']
    """
    others = [k for k in range(fingers) if k != thumb]
    return [
        (1 << thumb) | sum(1 << k for k in others[first : first + size])
        for size in range(1, len(others) + 1)
        for first in range(len(others) - size + 1)
    ]


def unit(vectors: Array) -> Array:
    """(n, 3) vectors at length one."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12))


def _pinches(hand: Hand, seed: int) -> Pinches:
    from scipy.stats import qmc

    tables = hand_tables(hand)
    f, t = len(tables.fingers), tables.thumb
    rng = np.random.default_rng(seed)
    low, high = joint_ranges(hand, tables)
    start = low + (high - low) * qmc.Sobol(len(hand.joints), rng=rng).random(_DRAWS)
    shares = np.linspace(0.0, 1.0, _STATIONS)
    tips = np.stack([_tips(tables, start, np.full((_DRAWS, f), c)) for c in shares], axis=1)
    radius = np.array([next(x for x in hand.fingers if x.name == name).tip_radius for name in tables.fingers])
    kinematics = HandKinematics(hand)
    sets = finger_sets(f, t)
    each = max(2, EACH // len(sets))
    found = [_meet(tables, start[:0], np.zeros((0, f)), sets[0])[0]]
    for mask in sets:
        others = _others(tables, mask)
        apart = tips[:, :, None, t] - tips[:, None, :, others].mean(axis=-2)
        rough = (np.linalg.norm(apart, axis=-1) - radius[t] - radius[others].mean()).reshape(_DRAWS, -1)
        for narrow, wide in itertools.pairwise(WIDTHS):
            # Of each preshape any meeting of about this width; what comes of it is seen below.
            about = ((rough >= narrow) & (rough < wide)) * rng.random(rough.shape)
            rows = rng.permutation(np.flatnonzero(about.any(axis=1)))[: _MET * each]
            a, b = np.divmod(about[rows].argmax(axis=1), _STATIONS)
            closing = np.zeros((len(rows), f))
            closing[:, others], closing[:, t] = shares[b][:, None], shares[a]
            met, closing = _meet(tables, start[rows], closing, mask)
            right = np.flatnonzero((met.width >= narrow) & (met.width < wide))[: _LOOKED * each]
            closed = posture_at(tables, met.start[right], closing[right])
            clear = [k for k, q in zip(right, closed, strict=True) if _clear(kinematics, met.start[k], q)]
            found.append(met.take(np.array(clear[:each], dtype=np.int64)))
    together = {name: np.concatenate([getattr(one, name) for one in found]) for name in _ROWS}
    order = np.argsort(together["width"], kind="stable")
    return Pinches(
        **{name: rows[order] for name, rows in together.items()},
        palm=_apart(tables.palm, PALM),
        tip=radius.max(keepdims=True),
    )


def _meet(tables: HandTables, start: Array, closing: Array, mask: int) -> tuple[Pinches, Array]:
    """The pinches near these closings (n, f) at which the fingers are level, and their closings."""
    t, others, closing = tables.thumb, _others(tables, mask), closing.copy()
    tips = _tips(tables, start, closing)
    e = unit(tips[:, t] - tips[:, others].mean(axis=1))
    for left in reversed(range(_ROUNDS)):
        pads = _Pads(tables, start, closing, e)
        rate = (pads.at(closing + _STEP) - pads.centre) / _STEP
        thumb, mean = pads.centre[:, t], pads.centre[:, others].mean(axis=1)
        e = unit(thumb - mean)
        speed = np.einsum("nfi,ni->nf", rate, e)
        front = (np.einsum("nfi,ni->nf", pads.centre, e) + pads.radius)[:, others]
        behind = front.mean(axis=1, keepdims=True) - front
        if left:
            own = speed[:, others]
            step = np.where(own > 0, behind / np.maximum(own, 0.02), 0.0)
            closing[:, others] = np.clip(closing[:, others] + np.clip(step, -0.1, 0.1), 0.0, 1.0 - _STEP)
    facing = speed / np.maximum(np.linalg.norm(rate, axis=2), 1e-9)
    facing[:, t] *= -1
    sound = (facing[:, [t, *others]] >= FACING).all(axis=1) & (np.abs(behind) < LEVEL).all(axis=1)
    speed = np.where(np.abs(speed) > 1e-6, speed, 1.0)
    used = (mask >> np.arange(len(tables.fingers))) & 1 == 1
    side = np.where(np.arange(len(tables.fingers)) == t, -1.0, 1.0)
    touch = pads.centre + side[:, None] * pads.radius[:, :, None] * e[:, None]
    mean = mean + pads.radius[:, others].mean(axis=1)[:, None] * e
    met = Pinches(
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
        open=_links(tables, start),
        palm=np.zeros((0, 4)),
        tip=np.zeros(1),
    )
    rows = np.flatnonzero(sound)
    return met.take(rows), closing[rows]


class _Pads:
    """What of each finger's last link stands out furthest towards the other side.

    Attributes:
        centre: (n, f, 3) of the sphere that does, palm frame [m].
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
        """(n, f, 3) where the same spheres are at other closings."""
        return self._placed(*joint_frames(self.tables, posture_at(self.tables, self.start, closing)))

    def _placed(self, places: Array, turns: Array) -> Array:
        turned = np.einsum("nfij,nfj->nfi", turns[:, self._last], self._local)
        return np.asarray(places[:, self._last] + turned)


def _others(tables: HandTables, mask: int) -> list[int]:
    return [k for k in range(len(tables.fingers)) if k != tables.thumb and mask >> k & 1]


def _tips(tables: HandTables, start: Array, closing: Array) -> Array:
    """(n, f, 3) centres of the fingertips, palm frame [m]."""
    return fingertips(tables, posture_at(tables, start, closing))


def _links(tables: HandTables, start: Array) -> Array:
    """(n, k, 3) tips of the fingers and middles of their links [m]."""
    places, turns = joint_frames(tables, start)
    last = tables.joint_start[1:] - 1
    tips = places[:, last] + np.einsum("nfij,fj->nfi", turns[:, last], tables.tip)
    ends = np.concatenate([places[:, 1:], places[:, :1]], axis=1)
    ends[:, last] = tips
    far = np.append(np.linalg.norm(tables.offset[1:], axis=1), 0.0)
    links = np.flatnonzero(np.isin(np.arange(len(far)), last) | (far > LONG))
    return np.concatenate([tips, ((places + ends) / 2)[:, links]], axis=1)


def _apart(spheres: Array, count: int) -> Array:
    """Some of the spheres (n, 4), each far from those before it."""
    chosen: list[int] = []
    gap = spheres[:, 3].copy()
    while len(chosen) < min(count, len(spheres)):
        chosen.append(int(gap.argmax()))
        away = np.linalg.norm(spheres[:, :3] - spheres[chosen[-1], :3], axis=1)
        gap = away if len(chosen) == 1 else np.minimum(gap, away)
    return spheres[chosen]


def _clear(kinematics: HandKinematics, *postures: Array) -> bool:
    """Whether no links are in each other in any of the postures."""
    for q in postures:
        kinematics.set_posture(q)
        if kinematics.self_collisions(SELF_DEPTH):
            return False
    return True
