"""The NumPy twin of the wrench-margin kernel: the same search in double precision, one at a time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...types import Array

GAP = 3e-3
"""Relative error at which a residual or a strength counts as found."""
GAP_FLOOR = 3e-6
"""The same of a residual near zero, in units of the grip."""
K_FLOOR = 2e-5
"""A strength up to this is zero."""
ROUNDING = 2e-7
"""Distance that is rounding in the kernel's single precision, over the length of the longest wrench."""
TURNS = 60
"""Steps of a search after which it ends where it is."""


class Grip(NamedTuple):
    """The contacts of one candidate: (n, 3) arms over ℓ, (n, 3) inward normals, μ, γ/ℓ."""

    arms: Array
    normals: Array
    mu: float
    gamma: float

    def highest(self, y: Array) -> tuple[float, Array]:
        """The support along y (6,) of what a unit of normal force can produce, and where it is reached."""
        g = y[:3] + np.cross(y[3:], self.arms)
        along = np.einsum("ij,ij->i", self.normals, g)
        across = g - along[:, None] * self.normals
        twist = self.gamma * (self.normals @ y[3:])
        slide = np.sqrt(self.mu**2 * (across * across).sum(axis=1) + twist * twist)
        i = int(np.argmax(along + slide))
        force, moment = self.normals[i], 0.0
        if slide[i] > 1e-12:
            force = force + across[i] * (self.mu**2 / slide[i])
            moment = self.gamma * float(twist[i]) / float(slide[i])
        torque = np.cross(self.arms[i], force) + moment * self.normals[i]
        return float(along[i] + slide[i]), np.concatenate([force, torque])


class NearestPoint:
    """Wolfe's method: the point nearest to a target of the hull of at most seven independent points."""

    def __init__(self, first: Array) -> None:
        self.points, self.weights = first[None], np.ones(1)

    def add(self, point: Array) -> None:
        """One more point; no weight yet."""
        self.points = np.concatenate([self.points, point[None]])
        self.weights = np.append(self.weights, 0.0)

    def settle(self, target: Array, same: bool) -> tuple[Array, bool]:
        """Find the nearest point; drop the points that do not carry it.

        Args:
            target: (6,).
            same: whether the target is where it was before the last point was added.

        Returns:
            (6,) target minus nearest, and whether the last point was of no use: in the span of the others, or
            dropped at once. With another target that means nothing.
        """
        stalled = False
        while True:
            edges, right, dependent = self._basis()
            stalled = stalled or (same and dependent)
            away = target - self.points[0]
            t = edges @ away
            away = away - t @ edges
            away = away - (edges @ away) @ edges  # however short, square to the edges
            part = np.linalg.solve(right, t) if len(t) else t
            c = np.concatenate([[1.0 - part.sum()], part])
            out = np.flatnonzero(c <= 0.0)
            if not len(out):
                self.weights = c
                return away, stalled
            share = self.weights[out] / np.maximum(self.weights[out] - c[out], 1e-30)
            drop = int(out[np.argmin(share)])
            stalled = stalled or (same and drop == len(c) - 1 and self.weights[drop] == 0.0)
            self.weights = np.maximum(self.weights + share.min() * (c - self.weights), 0.0)
            self.weights = np.delete(self.weights, drop)
            self.points = np.delete(self.points, drop, axis=0)

    def _basis(self) -> tuple[Array, Array, bool]:
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


class Answer(NamedTuple):
    """Residual, strength, which wrench decided each (-1: none), and the (6,) wrench that decided strength."""

    residual: float
    strength: float
    residual_worst: int
    strength_worst: int
    worst: Array


def hardest(axis: Array, half_angle: float, y: Array) -> tuple[float, Array]:
    """Of the unit wrenches within the half-angle of the axis the one that goes farthest along y."""
    along = float(y @ axis)
    across = y - along * axis
    width = float(np.linalg.norm(across))
    if width <= 1e-7:
        return along, axis
    angle = min(half_angle, math.atan2(width, along))
    w = math.cos(angle) * axis + math.sin(angle) * across / width
    return float(w @ y), w


def margin_plain(
    grip: Grip,
    wrenches: Array,
    base: Array,
    *,
    bound: float = math.inf,
    cone: tuple[Array, float] | None = None,
    anew: int | None = None,
) -> Answer:
    """Residual and strength of one candidate; see :func:`preshape.kernels.margin.host.margins`.

    Args:
        grip: the contacts.
        wrenches: (m, 6) asked for; with a cone those that the search starts from.
        base: (6,) asked for all the while.
        bound: residual above which the search ends.
        cone: unit axis and half-angle; then there is no residual, and strength is against the whole cone.
        anew: from this one of the wrenches on, each is searched from as if it were the first.
    """
    sizes = np.linalg.norm(wrenches, axis=1)
    units = wrenches / np.where(sizes > 0.0, sizes, 1.0)[:, None]
    if not len(grip.arms):
        return Answer(math.inf, 0.0, -1, -1, units[0])
    size = 1.0 + float(np.linalg.norm(grip.arms, axis=1).max())
    eps = ROUNDING * size
    near = NearestPoint(grip.highest(base + (wrenches[0] if cone is None else 0.0))[1])
    strength = top = float(np.linalg.norm(base)) + math.sqrt(1.0 + grip.mu**2) * size + grip.gamma
    found: list[tuple[float, int, Array]] = []
    residual, residual_worst = 0.0, -1

    for j in range(len(wrenches) if cone is None else 0):
        z = base + wrenches[j]
        for turn in range(TURNS):
            away, stalled = near.settle(z, turn > 0)
            d = float(np.linalg.norm(away))
            if d <= eps or len(near.points) == 7:
                d = 0.0
                break
            y = away / d
            height, q = grip.highest(y)
            gain = height - float(y @ z) + d  # how far q lies beyond the nearest point so far
            if d - gain > bound:
                return Answer(d - gain, 0.0, j, -1, units[0])
            if stalled or d <= residual or gain <= max(GAP * d + GAP_FLOOR, eps):
                break
            near.add(q)
        if d > residual:
            residual, residual_worst = d, j

    strength_worst, worst = -1, units[0]
    if base.any():
        for turn in range(TURNS):
            away, stalled = near.settle(base, turn > 0)
            d = float(np.linalg.norm(away))
            if d <= eps or len(near.points) == 7:
                d = 0.0
                break
            y = away / d
            height, q = _with_nothing(*grip.highest(y))
            if float(y @ base) - height > 10.0 * eps:
                return Answer(residual, 0.0, residual_worst, -1, worst)
            gain = height - float(y @ base) + d
            if stalled or gain <= eps:
                break
            near.add(q)
        if d > 100.0 * eps:
            return Answer(residual, 0.0, residual_worst, -1, worst)

    for j in range(len(units)):
        if strength <= K_FLOOR:
            break
        if anew is not None and j >= anew:
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
            height, q = _with_nothing(*grip.highest(y))
            gain = height - float(y @ z) + d
            before, slope = strength, float(y @ asked)
            if cone is None:
                along = units @ y
                who = int(np.argmax(along))
                far, w = float(along[who]), units[who]
            else:
                who, (far, w) = j, hardest(*cone, y)
            if far > 1e-9 and max(height - float(y @ base), 0.0) / far < strength:
                strength, strength_worst, worst = max(height - float(y @ base), 0.0) / far, who, w
                if cone is not None:
                    asked = w
            same = strength == before
            if d <= max(GAP * before, K_FLOOR) * slope or strength <= K_FLOOR:
                break
            if stalled or (same and gain <= eps):
                break
            if gain > eps:
                near.add(q)
    strength, strength_worst, worst = min([*found, (strength, strength_worst, worst)], key=lambda one: one[0])
    return Answer(residual, 0.0 if strength <= K_FLOOR else strength, residual_worst, strength_worst, worst)


def _with_nothing(height: float, point: Array) -> tuple[float, Array]:
    """The support with normal forces that sum to at most one: no force at all is one more wrench."""
    return (height, point) if height >= 0.0 else (0.0, np.zeros(6))
