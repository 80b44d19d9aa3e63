"""Limits of what a lesson can say of an object, a wrench or a hand; a value outside is no measurement.

A number such as 1e308 is finite, and yet makes every sum that it joins infinite: one such lesson would
disable all others of its hand. The limits are far outside of everything that a hand can meet. A task has
none, because the estimator clips it (:func:`preshape.hiis.estimator.inputs`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError
from ..types import Attributes, Experience, NetworkWeights

LIMITS: dict[str, tuple[float, float]] = {
    "object extents": (1e-12, 1e3),
    "area": (1e-24, 1e6),
    "volume": (-1e9, 1e9),
    "shape": (-1e6, 1e6),
    "net wrench": (-1e9, 1e9),
    "grip": (-1e6, 1e6),
    "weights": (-1e9, 1e9),
}
"""Smallest and largest number of each part, in its own unit [m, m², m³, -, 4U, m and rad, -]."""


def within(experience: Experience) -> None:
    """Refuse an experience with a number outside the limits.

    Raises:
        InputError: The message says which number, and its limits.
    """
    about: Attributes = experience.attributes
    _check("object extents", about.extents)
    _check("area", about.area)
    _check("volume", about.volume)
    _check("net wrench", experience.wrench)
    if about.shape is not None:
        _check("shape", about.shape)
    if experience.grip is not None:
        _check("grip", experience.grip)


def weights_within(weights: NetworkWeights) -> None:
    """Refuse weights outside the limits; their sums would overflow.

    Raises:
        InputError: The message says which number, and its limits.
    """
    for layer in (weights.w1, weights.b1, weights.w2, weights.b2):
        _check("weights", layer)


def usable(weights: NetworkWeights) -> bool:
    """Whether weights are within the limits."""
    try:
        weights_within(weights)
    except InputError:
        return False
    return True


def _check(name: str, content: ArrayLike) -> None:
    low, high = LIMITS[name]
    numbers = np.ravel(content)
    outside = (numbers < low) | (numbers > high)
    if outside.any():
        raise InputError(f"{name} must lie in {low:g}..{high:g}, got {numbers[outside][0]:.6g}")
