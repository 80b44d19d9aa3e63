"""The smallest reach over a cap of wrenches, by second-order-cone programs.

One program gives how far the producible wrenches reach along w, and the face that limits the reach. The
wrench of the cap that meets this face first is the next w. The reach never grows; the descent ends where no
wrench is worse.
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
    """The smallest reach that the descent finds, and its wrench.

    Args:
        program: Wrenches that the grasp can produce.
        base: (6,) wrench from which the reach is measured [N].
        axis: (6,) unit axis of the cap.
        half_angle: Half-angle of the cap [rad].
        k: (m,) known reaches to start from [N].
        wrenches: (m, 6) unit wrenches of these reaches.
        y: (m, 6) normals of the faces that limit them, with y·wrench = 1.
    """
    best, worst = float(k.min()), wrenches[int(k.argmin())]
    for _ in range(_ROUNDS):
        far, following = hardest(axis, half_angle, y)
        # The face that limits w, y·w = 1, limits the cap's wrench that meets it first at least as early.
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
