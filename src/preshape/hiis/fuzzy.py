"""Fuzzy matching of a task with a net wrench (§2.4, eq. 17-22).

Seven fuzzy sets divide a quantity from "high in the negative direction" to "high in the positive
direction" (fig. 8, fig. 16). Two numbers match to the degree that they belong to the same sets. A task
and a wrench are matched component by component:

>>> q1 = [1.0, 1.0, 0.1, 0.05, 0.8, 0.05]
>>> float(tfvadi(q1, q1))
5.5
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError
from ..types import Array, an_instance, freeze, frozen_array, numbers, one_of, value

SET_NAMES = ("RWD-H", "RWD-M", "RWD-L", "ZERO", "FWD-L", "FWD-M", "FWD-H")
"""Names of the seven sets, in the order of their index (§2.4, table 5; the paper swaps two descriptions)."""

SHAPES = ("trapezoid", "triangle", "gaussian")

_TRAPEZOIDS = (
    (-1.2, -1.2, -0.9, -0.75),
    (-0.9, -0.8, -0.5, -0.35),
    (-0.5, -0.35, -0.15, -0.05),
    (-0.15, -0.05, 0.05, 0.15),
    (0.05, 0.15, 0.35, 0.5),
    (0.35, 0.5, 0.8, 0.9),
    (0.75, 0.9, 1.2, 1.2),
)  # fig. 16 [P]

CLIP = 0.95
"""Largest crisp approach value; without this limit the two H sets would aim beside the object [C]."""


@value
class FuzzySets:
    """Seven membership functions.

    Attributes:
        corners: (7, 4) a ≤ b ≤ c ≤ d of each trapezoid. A triangle has its peak at the middle of the core
            b..c and its feet at a and d. A Gaussian has the same centre, and is 1/2 where the trapezoid is.
        shape: ``trapezoid`` (the paper's choice), ``triangle`` or ``gaussian`` [P].

    The two outermost sets are shoulders: beyond their core the membership stays 1 [R].
    """

    corners: Array = field(default_factory=lambda: np.array(_TRAPEZOIDS))
    shape: str = "trapezoid"

    def __post_init__(self) -> None:
        corners = frozen_array(self.corners, (7, 4), "fuzzy set corners")
        if (np.diff(corners, axis=1) < 0).any():
            raise InputError(f"fuzzy set corners must not decrease, got {corners.tolist()}")
        freeze(self, corners=corners, shape=one_of(self.shape, "fuzzy set shape", SHAPES))

    def changed(self, sets: Mapping[str, ArrayLike]) -> FuzzySets:
        """A copy with some sets replaced by name, as in fig. 16.

        >>> FuzzySets().changed({"ZERO": [-0.08, -0.03, 0.03, 0.08]}).corners[3]
        array([-0.08, -0.03,  0.03,  0.08])
        """
        an_instance(sets, Mapping, "changed fuzzy sets")
        corners = self.corners.copy()
        for given, four in sets.items():
            name = one_of(given, "fuzzy set", SET_NAMES)
            corners[SET_NAMES.index(name)] = frozen_array(four, (4,), f"fuzzy set {name}")
        return FuzzySets(corners=corners, shape=self.shape)

    def membership(self, x: ArrayLike) -> Array:
        """Membership of numbers in the seven sets.

        Args:
            x: (...) numbers.

        Returns:
            (..., 7) memberships, 0..1.
        """
        return np.moveaxis(self.layers(numbers(x, "what belongs to fuzzy sets")), 0, -1)

    def layers(self, x: ArrayLike) -> Array:
        """(7, ...) as :meth:`membership`, with the sets first, which is faster for many numbers."""
        # Clipped far beyond the shoulders, where nothing changes, because the largest numbers would overflow.
        x = np.clip(np.asarray(x, dtype=np.float64), -_FAR, _FAR)
        a, b, c, d = (corner.reshape(7, *[1] * x.ndim) for corner in self.corners.T)
        if self.shape == "trapezoid":
            # A flank of width 0 is a step that includes its corner.
            inside = np.minimum(_ramp(x - a, b - a), _ramp(d - x, d - c))
            peak_low, peak_high = self.corners[0, 2], self.corners[-1, 1]
        else:
            centre = (b + c) / 2
            if self.shape == "triangle":
                inside = np.minimum(_ramp(x - a, centre - a), _ramp(d - x, d - centre))
            else:
                half = np.maximum((c + d - a - b) / 4, 1e-12)  # where the trapezoid is 1/2
                inside = np.exp2(-(((x - centre) / half) ** 2))
            peak_low, peak_high = centre.flat[0], centre.flat[-1]
        inside[0, ...][x <= peak_low] = 1.0
        inside[6, ...][x >= peak_high] = 1.0
        return inside

    def crisp(self) -> Array:
        """(7,) crisp value of each set: the midpoint of its core, clipped to ±0.95 [C].

        >>> FuzzySets().crisp().tolist()
        [-0.925, -0.65, -0.25, 0.0, 0.25, 0.65, 0.925]
        """
        middle = (self.corners[:, 1] + self.corners[:, 2]) / 2
        middle[0] = (max(self.corners[0, 1], -CLIP) + self.corners[0, 2]) / 2
        middle[6] = (self.corners[6, 1] + min(self.corners[6, 2], CLIP)) / 2
        return np.clip(np.round(middle, 12), -CLIP, CLIP)

    def name_index(self, x: float) -> int:
        """Index of the set to which ``x`` belongs most."""
        return int(np.argmax(self.layers(x)))


_STEP = 1e-12
_FAR = 1e6


def _ramp(rise: Array, width: Array) -> Array:
    """Membership 0..1 on a flank of the given width; a flank of width 0 is a step that includes its foot."""
    step = np.where(width > 0, 0.0, _STEP)
    steep = (rise + step) * (1.0 / np.maximum(width, _STEP))
    return np.clip(steep, 0.0, 1.0, out=steep if steep.ndim else None)


def inner(a: Array, b: Array) -> Array:
    """a • b = maxⱼ min(aⱼ, bⱼ) over the first axis (eq. 20)."""
    return np.minimum(a, b).max(axis=0)


def outer(a: Array, b: Array) -> Array:
    """a ⊗ b = minⱼ max(aⱼ, bⱼ) over the first axis (eq. 21)."""
    return np.maximum(a, b).min(axis=0)


def adi(a: Array, b: Array) -> Array:
    """Fuzzy approaching degree index of two fuzzy vectors, min(a • b, 1 - a ⊗ b), 0..1.

    Eq. 19; the scan lost the complement bar over the outer product [R].

    Args:
        a: (7, ...) memberships.
        b: (7, ...) memberships, broadcast against ``a``.
    """
    return np.minimum(inner(a, b), 1 - outer(a, b))


def approaching_degrees(q: ArrayLike, w: ArrayLike, sets: FuzzySets | None = None) -> Array:
    """ADI of each component of a task and a wrench (eq. 19).

    Args:
        q: (..., 6) task Q.
        w: (..., 6) net wrench about the COG, axes x y z, lengths in 4U.
        sets: Membership functions; the paper's by default.

    Returns:
        (..., 6) degrees, 0..1.
    """
    sets = FuzzySets() if sets is None else sets
    an_instance(sets, FuzzySets, "sets")
    q, w = numbers(q, "a task"), numbers(w, "a net wrench")
    dimensions = max(q.ndim, w.ndim)
    q, w = (x.reshape(*[1] * (dimensions - x.ndim), *x.shape) for x in (q, w))
    return adi(sets.layers(q), sets.layers(w))


def tfvadi(q: ArrayLike, w: ArrayLike, sets: FuzzySets | None = None) -> Array:
    """Total fuzzy vector approaching degree index (eq. 22): the sum of the six ADIs, 0..6.

    It is symmetric in task and wrench; the arguments are those of :func:`approaching_degrees`.

    Raises:
        InputError: The last axis of either is not six numbers.
    """
    for name, pattern in (("task", q), ("wrench", w)):
        shape = numbers(pattern, f"a {name}").shape
        if not shape or shape[-1] != 6:
            raise InputError(f"a {name} must be six numbers, got shape {shape}")
    return approaching_degrees(q, w, sets).sum(axis=-1)
