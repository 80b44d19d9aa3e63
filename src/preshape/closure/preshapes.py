"""Preshapes of a hand: postures from which the hand starts to close, and the pinch point of each."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..hands.hand import Hand
from ..hands.kinematics import HandKinematics
from ..hands.motors import Motor
from ..kernels.chains import fingertips
from ..kernels.tables import HandTables
from ..types import Array, IntArray, value
from .hand_tables import cached, hand_tables

POOL = 512
"""Number of preshapes that the search draws from [C]."""
BENDS = 0.3
"""Largest random offset of a joint from the first angle of its closing path [rad] [C]."""
SELF_DEPTH = 0.002
"""Largest overlap of two links in a preshape, open and a quarter closed [m] [C]."""
_DRAWS = 8  # random postures per preshape wanted, because some collide with themselves
STATIONS = 11
"""Number of points of the closing path at which the pinch is computed."""


@value
class Preshapes:
    """n preshapes and their pinch at stations of the closing path.

    Attributes:
        start: (n, j) joint angles at the beginning of the closing [rad].
        mask: (n,) bit f is set where finger f (in the order of the tables) closes.
        fingers: (n,) number of fingers that close, the thumb included.
        pinch: (n, STATIONS, 3) midpoint of the thumb's tip and the mean of the other tips, palm frame [m].
        opposition: (n, STATIONS, 3) unit vector from that mean towards the thumb's tip.
        aperture: (n, STATIONS) distance of the two [m].
    """

    start: Array
    mask: IntArray
    fingers: IntArray
    pinch: Array
    opposition: Array
    aperture: Array


def posture_at(tables: HandTables, start: Array, closing: Array) -> Array:
    """(n, j) joint angles [rad] of hands that closed from a preshape.

    Args:
        tables: Tables of the hand.
        start: (n, j) joint angles at the beginning of the closing [rad].
        closing: (n, f) closing of each finger along its path, 0..1.
    """
    knots = len(tables.path)
    share = np.clip(closing, 0.0, 1.0) * (knots - 1)
    low = np.minimum(share.astype(np.int64), knots - 2)
    part = share - low
    commands = np.asarray(start, dtype=np.float64) @ tables.command.T
    for f, own in enumerate(finger_motors(tables)):
        along = (1 - part[:, f, None]) * tables.path[low[:, f]][:, own] + part[:, f, None] * tables.path[
            low[:, f] + 1
        ][:, own]
        commands[:, own] += along - tables.path[0, own]
    return posture_of(tables, commands)


def posture_of(tables: HandTables, commands: Array) -> Array:
    """(n, j) joint angles [rad] at the motors' commands (n, m) [rad], which are kept within their ranges."""
    m = np.clip(commands, tables.range[:, 0], tables.range[:, 1])[:, tables.motor]
    q = np.zeros_like(m)
    for coefficients in tables.law.T[::-1]:
        q = q * m + coefficients
    for j in np.flatnonzero(tables.bent):
        knots = np.linspace(
            tables.range[tables.motor[j]][0], tables.range[tables.motor[j]][1], len(tables.unloaded)
        )
        q[:, j] = np.interp(m[:, j], knots, tables.unloaded[:, j])
    return q


@lru_cache(maxsize=16)
def preshapes(hand: Hand, count: int = POOL, seed: int = 0) -> Preshapes:
    """A pool of preshapes, spread evenly over the ranges that the hand's description allows.

    Args:
        hand: The hand.
        count: Number of preshapes.
        seed: Seed of the draws; the same seed gives the same pool.
    """
    return cached(Preshapes, hand, f"preshapes {count} {seed}", lambda: _preshapes(hand, count, seed))


def _preshapes(hand: Hand, count: int, seed: int) -> Preshapes:
    """Compute the pool.

    1. Draw start postures from a Sobol sequence and drop those whose links overlap.
    2. Draw which fingers close.
    3. At each station of the closing path, compute the pinch of thumb and other fingers.
    """
    from scipy.stats import qmc

    tables = hand_tables(hand)
    motors = len(hand.motors)
    low, high = motor_ranges(hand, tables)
    # 1. and 2.
    draws = qmc.Sobol(motors + 2, rng=np.random.default_rng(seed)).random(_DRAWS * count)
    start = posture_of(tables, low + (high - low) * draws[:, :motors])
    sound = _collision_free(hand, tables, start, count)
    start = start[sound]
    mask = _finger_sets(tables, draws[sound, motors], draws[sound, motors + 1])
    # 3.
    n = len(start)
    shares = np.linspace(0.0, 1.0, STATIONS)
    pinch, opposition = np.empty((n, STATIONS, 3)), np.empty((n, STATIONS, 3))
    aperture = np.empty((n, STATIONS))
    used = ((mask[:, None] >> np.arange(len(tables.fingers))) & 1).astype(np.float64)
    used[:, tables.thumb] = 0.0
    weights = used / used.sum(axis=1, keepdims=True)
    for k, share in enumerate(shares):
        tips = fingertips(tables, posture_at(tables, start, np.full((n, len(tables.fingers)), share)))
        others = np.einsum("nf,nfi->ni", weights, tips)
        thumb = tips[:, tables.thumb]
        pinch[:, k] = (others + thumb) / 2
        apart = thumb - others
        aperture[:, k] = np.linalg.norm(apart, axis=1)
        opposition[:, k] = apart / np.maximum(aperture[:, k, None], 1e-9)
    return Preshapes(
        start=start,
        mask=mask,
        fingers=(used.sum(axis=1) + 1).astype(np.int64),
        pinch=pinch,
        opposition=opposition,
        aperture=aperture,
    )


def motor_ranges(hand: Hand, tables: HandTables) -> tuple[Array, Array]:
    """(m,), (m,) lower and upper end of the range that each motor's first command is drawn from [rad]."""
    low, high = tables.path[0].copy(), tables.path[0].copy()
    drawn = np.zeros(len(low), dtype=bool)
    for finger in hand.fingers:
        ends = np.stack([hand.posture("open")] * 2)
        ends[:, hand.columns(finger.name)] = finger.preshape.T
        commands = hand.controls(ends)
        first = hand.columns(finger.name).start
        for k in sorted(set(tables.motor[hand.columns(finger.name)].tolist())):
            # A motor of several fingers takes the range of the first of them that gives one.
            columns = np.flatnonzero(tables.motor == k)
            inside = [j - first for j in columns if 0 <= j - first < len(finger.joints)]
            if not drawn[k] and np.ptp(finger.preshape[inside], axis=1).any():
                low[k], high[k], drawn[k] = commands[:, k].min(), commands[:, k].max(), True
    # A motor that only the closing path moves may start more or less bent than the path.
    moving = ~drawn & (np.ptp(tables.path, axis=0) > 0.1)
    fastest = np.array([_fastest(motor) for motor in hand.motors])
    low -= np.where(moving, BENDS / fastest, 0.0)
    high += np.where(moving, BENDS / fastest, 0.0)
    return np.maximum(low, tables.range[:, 0]), np.minimum(high, tables.range[:, 1])


def _fastest(motor: Motor) -> float:
    """The largest rate of a joint of the motor; at least a small one."""
    return max(
        float(np.abs([motor.rates(m) for m in np.linspace(motor.range[0], motor.range[1], 9)]).max()), 1e-3
    )


def finger_motors(tables: HandTables) -> list[IntArray]:
    """For each finger the motors that move its joints along the closing path."""
    closes = np.ptp(tables.path, axis=0) > 0
    runs = zip(tables.joint_start[:-1], tables.joint_start[1:], strict=True)
    return [np.array([k for k in np.unique(tables.motor[a:b]) if closes[k]], dtype=np.int64) for a, b in runs]


def _finger_sets(tables: HandTables, kind: Array, shift: Array) -> IntArray:
    """(n,) masks of the fingers that close: all in half of the draws, otherwise some neighbouring fingers.

    Args:
        tables: Tables of the hand.
        kind: (n,) random numbers in 0..1 that decide how many close.
        shift: (n,) random numbers in 0..1 that decide which.
    """
    others = [f for f in range(len(tables.fingers)) if f != tables.thumb]
    m = len(others)
    mask = np.full(len(kind), 1 << tables.thumb, dtype=np.int64)
    # Cumulative share of each number of fingers beside the thumb; half of the draws close all of them.
    edges = np.concatenate([np.linspace(0.0, 0.5, m)[1:], [1.0]]) if m > 1 else np.array([1.0])
    size = np.minimum(np.searchsorted(edges, kind, side="right"), m - 1) + 1
    first = np.minimum((shift * (m - size + 1)).astype(np.int64), m - size)
    for k, f in enumerate(others):
        mask |= np.where((k >= first) & (k < first + size), 1 << f, 0)
    return mask


def _collision_free(hand: Hand, tables: HandTables, start: Array, count: int) -> IntArray:
    """Indices of the first ``count`` preshapes whose links do not overlap, open and a quarter closed.

    If all of them overlap, the hand's description is at fault. Then the first ``count`` are returned, and
    later checks decide.
    """
    kinematics = HandKinematics(hand)
    ways = [posture_at(tables, start, np.full((len(start), len(tables.fingers)), c)) for c in (0.0, 0.25)]
    clear: list[int] = []
    for i in range(len(start)):
        for q in (ways[0][i], ways[1][i]):
            kinematics.set_posture(q)
            if kinematics.self_collisions(SELF_DEPTH):
                break
        else:
            clear.append(i)
        if len(clear) == count:
            break
    return np.array(clear or range(count), dtype=np.int64)
