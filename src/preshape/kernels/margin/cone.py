"""Where the search of a task's wrench cone begins."""

from __future__ import annotations

import math

import numpy as np

from ...types import Array

_BETWEEN = np.eye(5) - 0.4
"""Five directions square to each other, none nearer than 53° to the axes."""


def cone_starts(axis: Array, half_angle: float, *, turned: bool = False) -> Array:
    """(11, 6) unit wrenches of a cone that its search starts from: the axis, and ten of the rim.

    Args:
        axis: (6,) unit.
        half_angle: [rad].
        turned: other ten of the rim, as far from the first as can be, and without the axis.
    """
    if half_angle == 0.0:
        return axis[None]
    # Five directions square to the axis and to each other: the columns of a reflection that turns e₀ into it.
    turn = axis - np.eye(6)[0] * (1.0 if axis[0] <= 0.0 else -1.0)
    across = (np.eye(6) - 2.0 * np.outer(turn, turn) / (turn @ turn))[1:]
    if turned:
        across = _BETWEEN @ across
    rim = math.cos(half_angle) * axis + math.sin(half_angle) * np.concatenate([across, -across])
    return rim if turned else np.concatenate([axis[None], rim])
