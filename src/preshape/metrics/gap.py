"""A gap between the wrenches a grasp produces and those a task asks for, after Chen et al. 2024.

For every direction asked for, all contacts together go as far along it as friction lets them, each with at
most one unit of normal force (the L∞ bound): a point on the boundary of the grasp wrench space, in closed
form. The gap is how far that wrench points away from the direction, 1 - cos, averaged. It needs no force
closure and no optimisation.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError
from ..types import Array, frozen_array
from .contacts import Contacts, support
from .results import Measure, MetricStatus


def force_directions(count: int = 1000) -> Array:
    """(count, 6) pure forces spread evenly over the sphere (a Fibonacci lattice): what holding asks for."""
    i = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * i / count, math.pi * (1.0 + math.sqrt(5.0)) * i
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z, np.zeros((count, 3))])


def tdg_gap(contacts: Contacts, directions: ArrayLike | None = None) -> Measure:
    """The mean of 1 - cos(direction, boundary wrench), 0 (none) to 2.

    A direction along which no contact helps counts 1.

    Args:
        contacts: the grasp.
        directions: (m, 6) wrenches asked for (force; torque over ℓ) of any length but 0; if none,
            forces all round.

    Returns:
        The gap, each direction's, and the direction served worst.

    Raises:
        InputError: directions that are not m×6 finite numbers, or one of zeros.
    """
    asked = frozen_array(force_directions() if directions is None else directions, (None, 6), "directions")
    sizes = np.linalg.norm(asked, axis=1)
    if not len(asked) or sizes.min() == 0.0:
        raise InputError("directions must be at least one and none of them six zeros")
    if contacts.count == 0:
        return Measure(number=None, status=MetricStatus.NO_CONTACTS)
    asked = asked / sizes[:, None]
    height, wrenches = support(contacts, asked)
    wrench = (wrenches * (height > 0.0)[..., None]).sum(axis=1)
    size = np.linalg.norm(wrench, axis=1)
    cosine = (wrench * asked).sum(axis=1) / np.where(size > 0.0, size, 1.0)
    gap = 1.0 - np.where(size > 0.0, cosine, 0.0)
    return Measure(
        number=float(gap.mean()), status=MetricStatus.OK, per_wrench=gap, worst=asked[int(gap.argmax())]
    )
