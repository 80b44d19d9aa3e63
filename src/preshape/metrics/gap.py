"""The gap between the wrenches that a grasp produces and those that a task needs, after Chen et al. 2024.

For each direction of the task, every contact presses as far along it as friction permits, with at most one
unit of normal force each (the L∞ bound). The sum is a wrench on the boundary of the grasp wrench space, in
closed form. The gap is 1 - cos of the angle between this wrench and the direction, averaged over the
directions. It needs neither force closure nor an optimisation.
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
    """(count, 6) pure forces spread evenly over the sphere (a Fibonacci lattice): the wrenches of holding."""
    i = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * i / count, math.pi * (1.0 + math.sqrt(5.0)) * i
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z, np.zeros((count, 3))])


def tdg_gap(contacts: Contacts, directions: ArrayLike | None = None) -> Measure:
    """The mean of 1 - cos(direction, boundary wrench), from 0 for no gap to 2.

    A direction along which no contact can press counts as 1.

    Args:
        contacts: The contacts of the grasp.
        directions: (m, 6) wrenches of the task (force; torque divided by ℓ), none of length 0; by default
            :func:`force_directions`.

    Returns:
        The gap, the gap of each direction, and the direction with the largest.

    Raises:
        InputError: The directions are not m×6 finite numbers, or one of them is zero.
    """
    wanted = frozen_array(force_directions() if directions is None else directions, (None, 6), "directions")
    sizes = np.linalg.norm(wanted, axis=1)
    if not len(wanted) or sizes.min() == 0.0:
        raise InputError("directions must be at least one, and none of them six zeros")
    if contacts.count == 0:
        return Measure(number=None, status=MetricStatus.NO_CONTACTS)
    wanted = wanted / sizes[:, None]
    height, wrenches = support(contacts, wanted)
    wrench = (wrenches * (height > 0.0)[..., None]).sum(axis=1)
    size = np.linalg.norm(wrench, axis=1)
    cosine = (wrench * wanted).sum(axis=1) / np.where(size > 0.0, size, 1.0)
    gap = 1.0 - np.where(size > 0.0, cosine, 0.0)
    return Measure(
        number=float(gap.mean()), status=MetricStatus.OK, per_wrench=gap, worst=wanted[int(gap.argmax())]
    )
