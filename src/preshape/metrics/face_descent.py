"""The smallest reach over a cap of wrenches, through second-order-cone programs.

How far the producible wrenches reach along w, and the face that stops it, is one program; the cap's wrench
that meets this face first is the next w. The reach never grows, and ends where no wrench is worse.
"""

from __future__ import annotations

import numpy as np

from ..types import Array
from .force_program import ForceProgram, reach
from .wrench_space import hardest

_ROUNDS = 40
_SETTLED = 1e-12


def lower(
    program: ForceProgram, base: Array, axis: Array, half_angle: float, k: Array, wrenches: Array, y: Array
) -> tuple[float, Array]:
    """The smallest reach and its wrench.

    Args:
        program: the producible wrenches.
        base: (6,) [N].
        axis: (6,) unit.
        half_angle: of the cap [rad].
        k: (m,) reaches [N] to begin with.
        wrenches: (m, 6) unit wrenches that they are along.
        y: (m, 6) the faces that stop them, y·wrench = 1.
    """
    best, worst = float(k.min()), wrenches[int(k.argmin())]
    for _ in range(_ROUNDS):
        far, following = hardest(axis, half_angle, y)
        # The face that stopped w, y·w = 1, stops the hardest wrench no later.
        promise = k / np.maximum(far, 1.0)
        order = np.argsort(promise)[:3]
        if promise[order[0]] >= best - _SETTLED * (abs(best) + program.unit):
            break
        wrenches = following[order]
        k, y, solution = reach(program, wrenches, base)
        if not solution.converged.all():
            break
        if k.min() < best:
            best, worst = float(k.min()), wrenches[int(k.argmin())]
    return max(best, 0.0), worst
