"""The closing kernel in plain NumPy and double precision: the specification of :mod:`.warp`.

For each candidate:

1. Palm. If a sphere of the palm is nearer to the object than ``palm_clearance``, the candidate fails.
2. For each finger, the thumb first because most failures are due to it:

   1. Start. If the finger, used or not, is inside the object at the beginning of its path, the candidate
      fails.
   2. Steps. The distance of a sphere divided by its speed bounds how far the path is free in both directions.
      A step is as long as the bounds at both of its ends will probably cover (Bán and Valasek 2023). If they
      do not cover it, the step is shortened to the bound at its beginning (Keinert et al. 2014).
   3. Touch. If a step ends inside the object, it brackets the touch, which false position and bisection find.
   4. Contact. The contact is the surface point nearest to the touching sphere, by the field's gradient. If
      the thumb touches nothing, the candidate fails.
3. Count. A candidate with fewer contacts than ``wanted`` fails; the others have closed.

R. Bán and G. Valasek, Automatic step size relaxation in sphere tracing, Eurographics short papers, 2023.
B. Keinert et al., Enhanced sphere tracing, Smart Tools and Applications in Graphics, 2014.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...types import Array, BoolArray, IntArray
from ..chains import about, joint_frames, rotations
from ..field.host import DistanceField
from ..field.plain import field_distance, field_gradient
from ..tables import HandTables
from .host import CONTACTS, Candidates, Closings, Fate, Obstacles

STEPS = 64
"""Largest number of steps along the closing path."""
RELAXATION, EXTRA = 1.96, 1e-4
"""Factor on a step (the limit is 2), and a length added to every step, in units of the path."""
FALSE_POSITIONS, BISECTIONS = 6, 14
"""Iterations that find a bracketed touch."""
FAR = 1e6
"""Stands for the distance to nothing [m]."""


class TouchingSphere(NamedTuple):
    """The sphere of one finger that is nearest to the object, for n candidates.

    Attributes:
        distance: (n,) distance of the sphere from the object, minus the clearance [m].
        step: (n,) how far the finger may close or open, in units of the path, before any of its spheres can
            touch; at most 2.
        centre: (n, 3) centre of the sphere [m].
        sphere: (n,) index of the sphere; -1 if the finger has none.
    """

    distance: Array
    step: Array
    centre: Array
    sphere: IntArray

    def put(self, rows: IntArray | BoolArray, other: TouchingSphere) -> None:
        """Replace these rows."""
        self.distance[rows], self.step[rows] = other.distance, other.step
        self.centre[rows], self.sphere[rows] = other.centre, other.sphere

    def take(self, rows: IntArray) -> TouchingSphere:
        """A copy of these rows."""
        return TouchingSphere(self.distance[rows], self.step[rows], self.centre[rows], self.sphere[rows])


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
    counts = np.zeros(n, dtype=np.int64)
    # 1. Palm
    palm = _distances(field, _moved(candidates.place, turns, tables.palm), tables.palm)
    fate[palm.min(axis=1, initial=FAR) < palm_clearance] = Fate.PALM_INSIDE
    # 2. Fingers, the thumb first
    for finger in [tables.thumb, *(f for f in range(fingers) if f != tables.thumb)]:
        rows = np.flatnonzero(fate == Fate.CLOSED)
        hands = PlacedFinger(
            tables, field, finger, candidates.place[rows], turns[rows], candidates.start[rows], clearance
        )
        # 2.1 Start
        opened = hands.nearest(np.arange(len(rows)), np.zeros(len(rows)))
        inside = opened.distance < 0.0
        fate[rows[inside]] = Fate.FINGERS_INSIDE
        used = (candidates.mask[rows] >> finger) & 1 == 1
        active = np.flatnonzero(~inside & used)
        # 2.2 Steps, 2.3 Touch
        c, near = _close(hands, active, opened, tolerance)
        # 2.4 Contact
        touches = near.distance <= 3.0 * tolerance
        touching, at = rows[active[touches]], counts[rows[active[touches]]]
        which = near.sphere[touches]
        gradient = field_gradient(field, near.centre[touches])
        reach = tables.sphere[which, 3] + clearance + near.distance[touches]
        closing[touching, finger], sphere[touching, finger] = c[touches], which
        points[touching, at] = near.centre[touches] - gradient * reach[:, None]
        normals[touching, at] = -gradient
        counts[touching] += 1
        if finger == tables.thumb:
            fate[rows[active[~touches]]] = Fate.THUMB_MISSES
    # 3. Count
    fate[(fate == Fate.CLOSED) & (counts < wanted)] = Fate.TOO_FEW
    return Closings(
        fate=fate,
        closing=closing,
        sphere=sphere,
        points=points,
        normals_in=normals,
        counts=np.where(fate == Fate.CLOSED, counts, 0),
    )


class PlacedFinger:
    """One finger of n candidates.

    Args:
        tables: Tables of the hand.
        field: The object's distance field.
        finger: Index of the finger.
        place: (n, 3) origins of the palm frames [m].
        turns: (n, 3, 3) rotations of the palm frames.
        start: (n, j) joint angles at the beginning of the path [rad]; the motors' commands are taken from
            them.
        clearance: Distance from the surface at which the finger stops [m].
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

    def nearest(self, rows: IntArray, c: Array) -> TouchingSphere:
        """The nearest spheres of candidates ``rows`` (m,) at the points ``c`` (m,) of the closing path."""
        tables = self.tables
        commands = self.start[rows] @ tables.command.T
        return nearest_link(
            tables,
            self.field,
            {j: joint_angle(tables, j, commands[:, tables.motor[j]], c) for j in self.joints},
            self.place[rows],
            self.turns[rows],
            self.clearance,
        )


def joint_angle(tables: HandTables, joint: int, command: Array, c: Array) -> Array:
    """(n,) angle of a joint at the points ``c`` (n,) of the closing path [rad].

    Args:
        tables: Tables of the hand.
        joint: Index of the joint.
        command: (n,) the command of its motor at the beginning of the path [rad].
        c: Points of the path, 0..1.
    """
    motor = int(tables.motor[joint])
    knots = np.linspace(0.0, 1.0, len(tables.path))
    m = command + np.interp(c, knots, tables.path[:, motor]) - tables.path[0, motor]
    m = np.clip(m, *tables.range[motor])
    if tables.bent[joint]:
        return np.asarray(
            np.interp(
                m,
                np.linspace(tables.range[motor][0], tables.range[motor][1], len(tables.unloaded)),
                tables.unloaded[:, joint],
            )
        )
    return np.asarray(np.polynomial.polynomial.polyval(m, tables.law[joint]))


def nearest_link(
    tables: HandTables,
    field: DistanceField,
    angles: dict[int, Array],
    place: Array,
    turns: Array,
    clearance: float,
) -> TouchingSphere:
    """The nearest sphere of one finger, and how far the finger may move before any sphere can touch.

    Args:
        tables: Tables of the hand.
        field: The object's distance field.
        angles: (n,) angle of each of the finger's joints, in their order [rad].
        place: (n, 3) origins of the palm frames [m].
        turns: (n, 3, 3) rotations of the palm frames.
        clearance: Length that is subtracted from every distance [m].
    """
    n = len(place)
    best = TouchingSphere(np.full(n, FAR), np.full(n, 2.0), np.zeros((n, 3)), np.full(n, -1, dtype=np.int64))
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
            TouchingSphere(
                distance=d[closer, k[closer]],
                step=best.step[closer],
                centre=x[closer, k[closer]],
                sphere=part.start + k[closer],
            ),
        )
        best.step[:] = np.minimum(best.step, (d / tables.speed[part]).min(axis=1))
    return best


def _close(
    hands: PlacedFinger, rows: IntArray, opened: TouchingSphere, tolerance: float
) -> tuple[Array, TouchingSphere]:
    """Steps 2.2 and 2.3: where the finger of candidates ``rows`` (m,) stops, and its nearest sphere there."""
    c = np.zeros(len(rows))
    near = opened.take(rows)
    trend = np.full(len(rows), -0.5)  # change of the bound per unit of the path
    going = np.arange(len(rows))
    for _ in range(STEPS):
        going = going[(near.distance[going] > tolerance) & (c[going] < 1.0)]
        if not len(going):
            break
        before, last = c[going], near.take(going)
        # The bound at the end of the step is extrapolated by its trend.
        c[going] = np.minimum(1.0, before + RELAXATION / (1.0 - trend[going]) * last.step + EXTRA)
        near.put(going, hands.nearest(rows[going], c[going]))
        # Do the bounds at both ends cover the step?
        uncovered = (near.distance[going] >= 0.0) & (
            c[going] - before > last.step + near.step[going] + 2.0 * EXTRA
        )
        back = going[uncovered]
        c[back] = before[uncovered] + last.step[uncovered]
        near.put(back, hands.nearest(rows[back], c[back]))
        trend[going] = np.clip((near.step[going] - last.step) / (c[going] - before), -1.0, 0.5)
        inside = near.distance[going] < 0.0
        _find_touch(hands, rows, going[inside], c, near, before[inside], last.distance[inside], tolerance)
        going = going[~inside]
    return c, near


def _find_touch(
    hands: PlacedFinger,
    rows: IntArray,
    inside: IntArray,
    c: Array,
    near: TouchingSphere,
    low: Array,
    d_low: Array,
    tolerance: float,
) -> None:
    """Step 2.3: find the touch between ``low`` (outside) and ``c`` (inside); set ``c`` and ``near`` to it."""
    low, high, d_low, d_high = low.copy(), c[inside], d_low.copy(), near.distance[inside]
    left = np.arange(len(inside))
    for k in range(FALSE_POSITIONS + BISECTIONS):
        if not len(left):
            return
        share = np.clip((d_low[left] - 0.5 * tolerance) / (d_low[left] - d_high[left]), 0.05, 0.95)
        if k >= FALSE_POSITIONS:
            share[:] = 0.5
        at = inside[left]
        c[at] = low[left] + (high[left] - low[left]) * share
        near.put(at, hands.nearest(rows[at], c[at]))
        d, outside = near.distance[at], near.distance[at] >= 0.0
        low[left[outside]], d_low[left[outside]] = c[at[outside]], d[outside]
        high[left[~outside]], d_high[left[~outside]] = c[at[~outside]], d[~outside]
        left = left[~(outside & (d <= tolerance))]
    # Not found to the tolerance: the last point outside the object.
    at = inside[left]
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
    """Specification of :meth:`preshape.kernels.closing.host.ClosingKernel.clearances`."""
    n, fingers = len(place), len(tables.joint_start) - 1
    turns, scene = rotations(turn), obstacles or Obstacles()
    to_object, to_obstacles = np.full((n, fingers + 1), FAR), np.full(n, FAR)

    def include(column: int, p: Array, R: Array, spheres: Array) -> None:
        x = _moved(p, R, spheres)
        d = _distances(field, x, spheres).min(axis=1, initial=FAR)
        free = obstacle_distance(scene, x.reshape(-1, 3)).reshape(x.shape[:2]) - spheres[:, 3]
        to_object[:, column] = np.minimum(to_object[:, column], d)
        to_obstacles[:] = np.minimum(to_obstacles, free.min(axis=1, initial=FAR))

    include(fingers, place, turns, tables.palm)
    for finger in range(fingers):
        p, R = place, turns
        for joint in range(tables.joint_start[finger], tables.joint_start[finger + 1]):
            p = p + R @ tables.offset[joint]
            R = R @ rotations(tables.turn[joint]) @ about(tables.axis[[joint]], posture[:, [joint]])[:, 0]
            include(finger, p, R, tables.sphere[tables.sphere_start[joint] : tables.sphere_start[joint + 1]])
    return to_object, to_obstacles


def link_distances_plain(
    tables: HandTables, field: DistanceField, place: Array, turn: Array, posture: Array
) -> tuple[Array, IntArray]:
    """Specification of :meth:`preshape.kernels.closing.host.ClosingKernel.link_distances`."""
    n, joints = posture.shape
    turns = rotations(turn)
    distance, sphere = np.full((n, joints + 1), FAR), np.full((n, joints + 1), -1, dtype=np.int64)

    def include(column: int, p: Array, R: Array, spheres: Array, first: int) -> None:
        if len(spheres):
            d = _distances(field, _moved(p, R, spheres), spheres)
            distance[:, column], sphere[:, column] = d.min(axis=1), first + d.argmin(axis=1)

    include(joints, place, turns, tables.palm, 0)
    places, own = joint_frames(tables, posture)
    for joint, (first, end) in enumerate(pairwise(tables.sphere_start)):
        p = place + np.einsum("nij,nj->ni", turns, places[:, joint])
        include(joint, p, turns @ own[:, joint], tables.sphere[first:end], int(first))
    return distance, sphere


def obstacle_distance(obstacles: Obstacles, x: Array) -> Array:
    """(n,) signed distance from points (n, 3) to the nearest half-space or box [m]."""
    distance = np.full(len(x), FAR)
    for plane in np.reshape(obstacles.planes, (-1, 4)):
        distance = np.minimum(distance, x @ plane[:3] - plane[3])
    for low, high in np.reshape(obstacles.boxes, (-1, 2, 3)):
        out = np.abs(x - (low + high) / 2) - (high - low) / 2
        away = np.linalg.norm(np.maximum(out, 0.0), axis=1)
        distance = np.minimum(distance, away + np.minimum(out.max(axis=1), 0.0))
    return distance


def _moved(p: Array, R: Array, spheres: Array) -> Array:
    """(n, s, 3) centres of spheres (s, 4) in frames with origins p (n, 3) and rotations R (n, 3, 3) [m]."""
    return np.asarray(p[:, None] + np.einsum("nij,sj->nsi", R, spheres[:, :3]))


def _distances(field: DistanceField, x: Array, spheres: Array) -> Array:
    """(n, s) distance of spheres with centres x (n, s, 3) from the object [m]."""
    return np.asarray(field_distance(field, x.reshape(-1, 3)).reshape(x.shape[:2]) - spheres[:, 3])
