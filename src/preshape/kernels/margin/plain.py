"""The wrench-margin kernel in plain NumPy and double precision, one candidate at a time: the specification.

The set of wrenches that the contacts can produce is known by its support function: how far the set reaches
along a direction, and at which wrench. The producible wrench nearest to a target is found by Wolfe's method
(1976). The method keeps a set of support points whose convex hull contains the nearest wrench so far. For one
candidate:

1. Residual. For each demanded wrench w, the target is b + w. The search

   1. settles the set: it finds the point of the hull nearest to the target and drops the points with zero
      weight in it;
   2. takes the support along the direction from the nearest point to the target;
   3. ends if that support lies hardly beyond the nearest point, or if the distance cannot exceed the largest
      so far; otherwise the support point joins the set.

   The set of one target is the warm start for the next target.
2. Base. The same search for the target b, with normal forces that sum to at most one (the zero wrench is then
   a support point too), decides whether b is producible. If not, the strength is 0.
3. Strength. For each wrench w, the target is b + k w with the least k so far. The plane perpendicular to the
   direction from the nearest point to the target bounds k for every wrench (a cutting plane), so k decreases
   until the target is producible. With a cone, w becomes the wrench of the cone with the smallest such bound.
4. Restarts. Over a cone, k can have two local minima, and a search that begins at the bottom of one does not
   find the other. From index ``restart`` on, each search therefore begins at the largest k again; the least
   result counts.

Contacts with bounds of their own differ in the support only: it is the sum over the contacts of how far each
reaches with its largest normal force; a contact that does not reach along the direction gives no force. The
search runs in units of the sum of the bounds, so its tolerances are shares of that sum.

P. Wolfe, Finding the nearest point in a polytope, Mathematical Programming 11, 1976.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...types import Array

GAP = 3e-3
"""Relative error at which the search of a residual or a strength ends."""
GAP_FLOOR = 3e-6
"""Absolute error at which the search of a residual ends, in units of the grip."""
K_FLOOR = 2e-5
"""A strength up to this counts as zero, in units of the grip."""
BOUNDED_FLOOR = 4e-6
"""The same as a share of the sum of the contacts' bounds, of which few contacts' forces are a small part."""
ROUNDING = 2e-7
"""Distance that counts as rounding in single precision, as a share of the longest wrench."""
TURNS = 60
"""Largest number of steps of one search."""


class SoftContacts(NamedTuple):
    """The soft-finger contacts of one candidate.

    Attributes:
        arms: (n, 3) contact points relative to the reference point, divided by ℓ.
        normals: (n, 3) inward unit normals.
        mu: Friction coefficient μ.
        gamma: Torsional friction divided by ℓ, γ/ℓ.
        bounds: (n,) largest normal force of each contact [N]; ``None`` for normal forces that sum to one.
    """

    arms: Array
    normals: Array
    mu: float
    gamma: float
    bounds: Array | None = None

    def support(self, y: Array) -> tuple[float, Array]:
        """How far the producible wrenches reach along y (6,), and the farthest wrench (6,)."""
        g = y[:3] + np.cross(y[3:], self.arms)
        along = np.einsum("ij,ij->i", self.normals, g)
        across = g - along[:, None] * self.normals
        twist = self.gamma * (self.normals @ y[3:])
        slide = np.sqrt(self.mu**2 * (across * across).sum(axis=1) + twist * twist)
        if self.bounds is None:
            i = int(np.argmax(along + slide))
            return float(along[i] + slide[i]), self._farthest(i, across[i], float(twist[i]), float(slide[i]))
        height, wrench = 0.0, np.zeros(6)
        for i in np.flatnonzero(along + slide > 0.0).tolist():
            height += float(self.bounds[i] * (along[i] + slide[i]))
            wrench += self.bounds[i] * self._farthest(i, across[i], float(twist[i]), float(slide[i]))
        return height, wrench

    def _farthest(self, i: int, across: Array, twist: float, slide: float) -> Array:
        """The wrench (6,) of contact i at unit normal force that reaches farthest."""
        force, moment = self.normals[i], 0.0
        if slide > 1e-12:
            force = force + across * (self.mu**2 / slide)
            moment = self.gamma * twist / slide
        torque = np.cross(self.arms[i], force) + moment * self.normals[i]
        return np.concatenate([force, torque])


class NearestPoint:
    """Wolfe's method: the point nearest to a target in the hull of at most seven independent points.

    Args:
        first: (6,) the first point.
    """

    def __init__(self, first: Array) -> None:
        self.points, self.weights = first[None], np.ones(1)

    def add(self, point: Array) -> None:
        """Add a point, with no weight yet."""
        self.points = np.concatenate([self.points, point[None]])
        self.weights = np.append(self.weights, 0.0)

    def settle(self, target: Array, same: bool) -> tuple[Array, bool]:
        """Find the nearest point and drop the points with zero weight in it.

        1. Find the nearest point of the affine hull to the target, and its weights.
        2. If all weights are positive, it is the nearest point of the hull.
        3. Otherwise move towards it up to the hull's boundary, drop the point that has zero weight there, and
           go to 1.

        Args:
            target: (6,).
            same: Whether the target is unchanged since the last point was added.

        Returns:
            (6,) target minus nearest point, and whether the last added point was useless, because it lies in
            the span of the others or was dropped at once. The second value has no meaning if the target has
            changed.
        """
        stalled = False
        while True:
            # 1. Affine hull
            edges, right, dependent = self._basis()
            stalled = stalled or (same and dependent)
            away = target - self.points[0]
            t = edges @ away
            away = away - t @ edges
            away = away - (edges @ away) @ edges  # perpendicular to the edges, however short
            part = np.linalg.solve(right, t) if len(t) else t
            c = np.concatenate([[1.0 - part.sum()], part])
            # 2. Inside
            out = np.flatnonzero(c <= 0.0)
            if not len(out):
                self.weights = c
                return away, stalled
            # 3. Boundary
            share = self.weights[out] / np.maximum(self.weights[out] - c[out], 1e-30)
            drop = int(out[np.argmin(share)])
            stalled = stalled or (same and drop == len(c) - 1 and self.weights[drop] == 0.0)
            self.weights = np.maximum(self.weights + share.min() * (c - self.weights), 0.0)
            self.weights = np.delete(self.weights, drop)
            self.points = np.delete(self.points, drop, axis=0)

    def _basis(self) -> tuple[Array, Array, bool]:
        """Edges from point 0 as orthonormal rows (k, 6) times a triangle (k, k); whether one is dependent."""
        k = len(self.points) - 1
        edges, right, dependent = np.zeros((k, 6)), np.zeros((k, k)), False
        for i in range(k):
            e = self.points[i + 1] - self.points[0]
            long = float(np.linalg.norm(e))
            for _ in range(2):
                along = edges[:i] @ e
                right[:i, i] += along
                e = e - along @ edges[:i]
            rest = float(np.linalg.norm(e))
            if rest > 1e-6 * long:
                edges[i], right[i, i] = e / rest, rest
            else:
                right[i, i], dependent = 1.0, True
        return edges, right, dependent


class CandidateMargin(NamedTuple):
    """Residual and strength of one candidate, as in :class:`~preshape.kernels.margin.host.Margins`.

    Attributes:
        residual: In units of the grip; of contacts with bounds in newtons, as the strength.
        strength: In units of the grip.
        residual_worst: Index of the wrench that decided the residual; -1 if no wrench did.
        strength_worst: Index of the wrench that decided the strength; -1 if no wrench did.
        worst: (6,) the unit wrench that decided the strength.
    """

    residual: float
    strength: float
    residual_worst: int
    strength_worst: int
    worst: Array


def cone_support(axis: Array, half_angle: float, y: Array) -> tuple[float, Array]:
    """How far the unit wrenches within ``half_angle`` of ``axis`` reach along y, and the farthest one."""
    along = float(y @ axis)
    across = y - along * axis
    width = float(np.linalg.norm(across))
    if width <= 1e-7:
        return along, axis
    angle = min(half_angle, math.atan2(width, along))
    w = math.cos(angle) * axis + math.sin(angle) * across / width
    return float(w @ y), w


def margin_plain(
    contacts: SoftContacts,
    wrenches: Array,
    base: Array,
    *,
    bound: float = math.inf,
    cone: tuple[Array, float] | None = None,
    restart: int | None = None,
) -> CandidateMargin:
    """Residual and strength of one candidate; see :func:`preshape.kernels.margin.host.margins`.

    Args:
        contacts: The contacts.
        wrenches: (m, 6) demanded wrenches; with a cone, the wrenches from which the search starts.
        base: (6,) wrench that is demanded all the time.
        bound: The search ends as soon as the residual is known to exceed this.
        cone: (6,) unit axis and half-angle [rad]. With a cone, there is no residual, and the whole cone is
            demanded.
        restart: From this index on, an independent search starts from each wrench.
    """
    if contacts.bounds is None:
        return _margin(contacts, wrenches, base, bound, cone, restart)
    total = float(contacts.bounds.sum())
    if total == 0.0:  # as without contacts
        return _margin(contacts._replace(arms=contacts.arms[:0]), wrenches, base, bound, cone, restart)
    shares = contacts._replace(bounds=contacts.bounds / total)
    found = _margin(shares, wrenches / total, base / total, bound / total, cone, restart)
    return found._replace(residual=found.residual * total, strength=found.strength * total)


def _margin(
    contacts: SoftContacts,
    wrenches: Array,
    base: Array,
    bound: float,
    cone: tuple[Array, float] | None,
    restart: int | None,
) -> CandidateMargin:
    """The search of :func:`margin_plain`; bounds of contacts sum to one."""
    sizes = np.linalg.norm(wrenches, axis=1)
    units = wrenches / np.where(sizes > 0.0, sizes, 1.0)[:, None]
    if not len(contacts.arms):
        return CandidateMargin(math.inf, 0.0, -1, -1, units[0])
    size = 1.0 + float(np.linalg.norm(contacts.arms, axis=1).max())
    eps = ROUNDING * size
    floor = K_FLOOR if contacts.bounds is None else BOUNDED_FLOOR
    near = NearestPoint(contacts.support(base + (wrenches[0] if cone is None else 0.0))[1])
    strength = top = float(np.linalg.norm(base)) + math.sqrt(1.0 + contacts.mu**2) * size + contacts.gamma
    found: list[tuple[float, int, Array]] = []
    residual, residual_worst = 0.0, -1

    # 1. Residual
    for j in range(len(wrenches) if cone is None else 0):
        z = base + wrenches[j]
        for turn in range(TURNS):
            away, stalled = near.settle(z, turn > 0)
            d = float(np.linalg.norm(away))
            if d <= eps or len(near.points) == 7:
                d = 0.0
                break
            y = away / d
            height, q = contacts.support(y)
            gain = height - float(y @ z) + d  # how far q lies beyond the nearest point
            if d - gain > bound:
                return CandidateMargin(d - gain, 0.0, j, -1, units[0])
            if stalled or d <= residual or gain <= max(GAP * d + GAP_FLOOR, eps):
                break
            near.add(q)
        if d > residual:
            residual, residual_worst = d, j

    # 2. Base
    strength_worst, worst = -1, units[0]
    if base.any():
        for turn in range(TURNS):
            away, stalled = near.settle(base, turn > 0)
            d = float(np.linalg.norm(away))
            if d <= eps or len(near.points) == 7:
                d = 0.0
                break
            y = away / d
            height, q = _with_zero(*contacts.support(y))
            if float(y @ base) - height > 10.0 * eps:
                return CandidateMargin(residual, 0.0, residual_worst, -1, worst)
            gain = height - float(y @ base) + d
            if stalled or gain <= eps:
                break
            near.add(q)
        if d > 100.0 * eps:
            return CandidateMargin(residual, 0.0, residual_worst, -1, worst)

    # 3. Strength
    for j in range(len(units)):
        if strength <= floor:
            break
        # 4. Restarts
        if restart is not None and j >= restart:
            found.append((strength, strength_worst, worst))
            strength = top
        asked, same = units[j], False
        for _ in range(TURNS):
            z = base + strength * asked
            away, stalled = near.settle(z, same)
            d = float(np.linalg.norm(away))
            if d <= eps or len(near.points) == 7:
                break
            y = away / d
            height, q = _with_zero(*contacts.support(y))
            gain = height - float(y @ z) + d
            before, slope = strength, float(y @ asked)
            # The plane perpendicular to y bounds first the wrench that reaches farthest along y.
            if cone is None:
                along = units @ y
                index = int(np.argmax(along))
                far, w = float(along[index]), units[index]
            else:
                index, (far, w) = j, cone_support(*cone, y)
            if far > 1e-9 and max(height - float(y @ base), 0.0) / far < strength:
                strength, strength_worst, worst = max(height - float(y @ base), 0.0) / far, index, w
                if cone is not None:
                    asked = w
            same = strength == before
            if d <= max(GAP * before, floor) * slope or strength <= floor:
                break
            if stalled or (same and gain <= eps):
                break
            if gain > eps:
                near.add(q)
    strength, strength_worst, worst = min(
        [*found, (strength, strength_worst, worst)], key=lambda entry: entry[0]
    )
    return CandidateMargin(
        residual, 0.0 if strength <= floor else strength, residual_worst, strength_worst, worst
    )


def _with_zero(height: float, point: Array) -> tuple[float, Array]:
    """The support with normal forces that sum to at most one, which adds the zero wrench."""
    return (height, point) if height >= 0.0 else (0.0, np.zeros(6))
