"""The closing kernel in plain NumPy: what :mod:`preshape.kernels.closing.warp` computes, step by step.

In double precision, over all candidates at once. The search uses the kernel; this is its specification.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...types import Array, BoolArray, IntArray
from ..chains import about, rotations
from ..field.host import DistanceField
from ..field.plain import field_distance, field_gradient
from ..tables import HandTables
from .host import CONTACTS, Candidates, Closings, Fate, Obstacles

STEPS = 64
"""Most steps along the closing path."""
RELAXED, EXTRA = 1.96, 1e-4
"""Factor on a step, 2 being as far as could be covered; what it goes further in units of the path."""
FALSE_POSITIONS, HALVINGS = 6, 14
"""Steps that find the touch once it lies between two points."""
FAR = 1e6


class Nearest(NamedTuple):
    """What is nearest to the object of one finger, for n candidates.

    Attributes:
        distance: (n,) of the nearest sphere [m], less the clearance.
        step: (n,) how far the closing may go, or go back, before any sphere can touch; 2 at most.
        centre: (n, 3) of the nearest sphere [m].
        sphere: (n,) its number, -1 where the finger has none.
    """

    distance: Array
    step: Array
    centre: Array
    sphere: IntArray

    def put(self, rows: IntArray | BoolArray, other: Nearest) -> None:
        """These rows replaced by another's."""
        self.distance[rows], self.step[rows] = other.distance, other.step
        self.centre[rows], self.sphere[rows] = other.centre, other.sphere

    def take(self, rows: IntArray) -> Nearest:
        """These rows."""
        return Nearest(self.distance[rows], self.step[rows], self.centre[rows], self.sphere[rows])


def close_plain(
    tables: HandTables,
    field: DistanceField,
    candidates: Candidates,
    *,
    wanted: int = 3,
    clearance: float = 0.0,
    palm_clearance: float = 0.0,
    tolerance: float = 1e-4,
) -> Closings:
    """Close every candidate, as :meth:`preshape.kernels.closing.host.ClosingKernel.close` does."""
    n, fingers = len(candidates), len(tables.joint_start) - 1
    turns = rotations(candidates.turn)
    fate = np.full(n, Fate.CLOSED, dtype=np.int64)
    closing, sphere = np.zeros((n, fingers)), np.full((n, fingers), -1, dtype=np.int64)
    points, normals = np.zeros((n, CONTACTS, 3)), np.zeros((n, CONTACTS, 3))
    found = np.zeros(n, dtype=np.int64)
    palm = _distances(field, _moved(candidates.place, turns, tables.palm), tables.palm)
    fate[palm.min(axis=1, initial=FAR) < palm_clearance] = Fate.PALM_INSIDE
    # The thumb first: most candidates fail on it.
    for finger in [tables.thumb, *(f for f in range(fingers) if f != tables.thumb)]:
        rows = np.flatnonzero(fate == Fate.CLOSED)
        hands = Placed(
            tables, field, finger, candidates.place[rows], turns[rows], candidates.start[rows], clearance
        )
        opened = hands.nearest(np.arange(len(rows)), np.zeros(len(rows)))
        inside = opened.distance < 0.0
        fate[rows[inside]] = Fate.FINGERS_INSIDE
        used = (candidates.mask[rows] >> finger) & 1 == 1
        active = np.flatnonzero(~inside & used)
        c, near = _close(hands, active, opened, tolerance)
        touches = near.distance <= 3.0 * tolerance
        touching, at = rows[active[touches]], found[rows[active[touches]]]
        which = near.sphere[touches]
        slope = field_gradient(field, near.centre[touches])
        reach = tables.sphere[which, 3] + clearance + near.distance[touches]
        closing[touching, finger], sphere[touching, finger] = c[touches], which
        points[touching, at] = near.centre[touches] - slope * reach[:, None]
        normals[touching, at] = -slope
        found[touching] += 1
        if finger == tables.thumb:
            fate[rows[active[~touches]]] = Fate.THUMB_MISSES
    fate[(fate == Fate.CLOSED) & (found < wanted)] = Fate.TOO_FEW
    return Closings(
        fate=fate,
        closing=closing,
        sphere=sphere,
        points=points,
        normals_in=normals,
        counts=np.where(fate == Fate.CLOSED, found, 0),
    )


class Placed:
    """One finger of n hands in place.

    Args:
        tables: of the hand.
        field: the object's.
        finger: which.
        place: (n, 3) palm frames [m].
        turns: (n, 3, 3) their rotations.
        start: (n, j) joint angles at the beginning of the path [rad].
        clearance: how far from the surface a finger stops [m].
    """

    def __init__(
        self,
        tables: HandTables,
        field: DistanceField,
        finger: int,
        place: Array,
        turns: Array,
        start: Array,
        clearance: float,
    ) -> None:
        self.tables, self.field = tables, field
        self.joints = range(int(tables.joint_start[finger]), int(tables.joint_start[finger + 1]))
        self.place, self.turns, self.start, self.clearance = place, turns, start, clearance

    def nearest(self, rows: IntArray, c: Array) -> Nearest:
        """The nearest sphere of these hands at these points (as many) of the closing path."""
        tables = self.tables
        angles = {j: self.start[rows, j] + path_offset(tables, j, c) for j in self.joints}
        return nearest_link(
            tables,
            self.field,
            {j: np.clip(angle, *tables.limits[j]) for j, angle in angles.items()},
            self.place[rows],
            self.turns[rows],
            self.clearance,
        )


def path_offset(tables: HandTables, joint: int, c: Array) -> Array:
    """(n,) joint angles on the closing path, from its first value [rad]."""
    knots = np.linspace(0.0, 1.0, len(tables.path))
    return np.interp(c, knots, tables.path[:, joint]) - tables.path[0, joint]


def nearest_link(
    tables: HandTables,
    field: DistanceField,
    angles: dict[int, Array],
    place: Array,
    turns: Array,
    clearance: float,
) -> Nearest:
    """The nearest sphere of one finger to the object, and how far the closing may go unharmed.

    Args:
        tables: of the hand.
        field: the object's.
        angles: (n,) angle of each of the finger's joints, in their order [rad].
        place: (n, 3) palm frames [m].
        turns: (n, 3, 3) their rotations.
        clearance: taken off every distance [m].
    """
    n = len(place)
    best = Nearest(np.full(n, FAR), np.full(n, 2.0), np.zeros((n, 3)), np.full(n, -1, dtype=np.int64))
    p, R = place, turns
    for joint, angle in angles.items():
        p = p + R @ tables.offset[joint]
        R = R @ rotations(tables.turn[joint]) @ about(tables.axis[[joint]], angle[:, None])[:, 0]
        part = slice(int(tables.sphere_start[joint]), int(tables.sphere_start[joint + 1]))
        if part.start == part.stop:
            continue
        x = _moved(p, R, tables.sphere[part])
        d = _distances(field, x, tables.sphere[part]) - clearance
        k = d.argmin(axis=1)
        closer = d[np.arange(n), k] < best.distance
        best.put(
            closer,
            Nearest(
                distance=d[closer, k[closer]],
                step=best.step[closer],
                centre=x[closer, k[closer]],
                sphere=part.start + k[closer],
            ),
        )
        best.step[:] = np.minimum(best.step, (d / tables.speed[part]).min(axis=1))
    return best


def _close(hands: Placed, rows: IntArray, opened: Nearest, tolerance: float) -> tuple[Array, Nearest]:
    """Close one finger of the hands in these rows: how far, and what is nearest there."""
    c = np.zeros(len(rows))
    near = opened.take(rows)
    trend = np.full(len(rows), -0.5)
    going = np.arange(len(rows))
    for _ in range(STEPS):
        going = going[(near.distance[going] > tolerance) & (c[going] < 1.0)]
        if not len(going):
            break
        before, was = c[going], near.take(going)
        # As far as what is sure here and there, by its trend, will cover (Bán and Valasek 2023).
        c[going] = np.minimum(1.0, before + RELAXED / (1.0 - trend[going]) * was.step + EXTRA)
        near.put(going, hands.nearest(rows[going], c[going]))
        # Where it does not cover the way between: only what is sure (Keinert et al. 2014).
        short = (near.distance[going] >= 0.0) & (
            c[going] - before > was.step + near.step[going] + 2.0 * EXTRA
        )
        back = going[short]
        c[back] = before[short] + was.step[short]
        near.put(back, hands.nearest(rows[back], c[back]))
        trend[going] = np.clip((near.step[going] - was.step) / (c[going] - before), -1.0, 0.5)
        over = near.distance[going] < 0.0
        _refine(hands, rows, going[over], c, near, before[over], was.distance[over], tolerance)
        going = going[~over]
    return c, near


def _refine(
    hands: Placed,
    rows: IntArray,
    over: IntArray,
    c: Array,
    near: Nearest,
    low: Array,
    d_low: Array,
    tolerance: float,
) -> None:
    """Overshot, by a little: the touch lies between ``low`` and c; sets c and what is nearest there."""
    low, high, d_low, d_high = low.copy(), c[over], d_low.copy(), near.distance[over]
    left = np.arange(len(over))
    for k in range(FALSE_POSITIONS + HALVINGS):
        if not len(left):
            return
        share = np.clip((d_low[left] - 0.5 * tolerance) / (d_low[left] - d_high[left]), 0.05, 0.95)
        if k >= FALSE_POSITIONS:
            share[:] = 0.5
        at = over[left]
        c[at] = low[left] + (high[left] - low[left]) * share
        near.put(at, hands.nearest(rows[at], c[at]))
        d, outside = near.distance[at], near.distance[at] >= 0.0
        low[left[outside]], d_low[left[outside]] = c[at[outside]], d[outside]
        high[left[~outside]], d_high[left[~outside]] = c[at[~outside]], d[~outside]
        left = left[~(outside & (d <= tolerance))]
    at = over[left]
    c[at] = low[left]
    near.put(at, hands.nearest(rows[at], c[at]))


def clearances_plain(
    tables: HandTables,
    field: DistanceField,
    place: Array,
    turn: Array,
    posture: Array,
    obstacles: Obstacles | None = None,
) -> tuple[Array, Array]:
    """As :meth:`preshape.kernels.closing.host.ClosingKernel.clearances`."""
    n, fingers = len(place), len(tables.joint_start) - 1
    turns, rest = rotations(turn), obstacles or Obstacles()
    to_object, to_rest = np.full((n, fingers + 1), FAR), np.full(n, FAR)

    def meet(column: int, p: Array, R: Array, spheres: Array) -> None:
        x = _moved(p, R, spheres)
        d = _distances(field, x, spheres).min(axis=1, initial=FAR)
        room = room_of(rest, x.reshape(-1, 3)).reshape(x.shape[:2]) - spheres[:, 3]
        to_object[:, column] = np.minimum(to_object[:, column], d)
        to_rest[:] = np.minimum(to_rest, room.min(axis=1, initial=FAR))

    meet(fingers, place, turns, tables.palm)
    for finger in range(fingers):
        p, R = place, turns
        for joint in range(tables.joint_start[finger], tables.joint_start[finger + 1]):
            p = p + R @ tables.offset[joint]
            R = R @ rotations(tables.turn[joint]) @ about(tables.axis[[joint]], posture[:, [joint]])[:, 0]
            meet(finger, p, R, tables.sphere[tables.sphere_start[joint] : tables.sphere_start[joint + 1]])
    return to_object, to_rest


def room_of(obstacles: Obstacles, x: Array) -> Array:
    """(n,) signed distance from points (n, 3) to the nearest half-space or box [m]."""
    room = np.full(len(x), FAR)
    for plane in np.reshape(obstacles.planes, (-1, 4)):
        room = np.minimum(room, x @ plane[:3] - plane[3])
    for low, high in np.reshape(obstacles.boxes, (-1, 2, 3)):
        out = np.abs(x - (low + high) / 2) - (high - low) / 2
        away = np.linalg.norm(np.maximum(out, 0.0), axis=1)
        room = np.minimum(room, away + np.minimum(out.max(axis=1), 0.0))
    return room


def _moved(p: Array, R: Array, spheres: Array) -> Array:
    """(n, s, 3) centres of spheres (s, 4) that are fixed to frames p (n, 3), R (n, 3, 3)."""
    return np.asarray(p[:, None] + np.einsum("nij,sj->nsi", R, spheres[:, :3]))


def _distances(field: DistanceField, x: Array, spheres: Array) -> Array:
    """(n, s) distance of spheres with their centres at x (n, s, 3) to the object [m]."""
    return np.asarray(field_distance(field, x.reshape(-1, 3)).reshape(x.shape[:2]) - spheres[:, 3])
