"""The smallest reach over a cap of wrenches, by second-order-cone programs.

Each program computes how far the producible wrenches reach along a wrench w, and the face that limits this
reach. The wrench of the cap that meets this face first is the next w. The reach never grows, and the descent
ends when no wrench of the cap has a smaller reach.
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
    """The smallest reach that the descent finds, and the wrench with this reach.

    Args:
        program: Wrenches that the grasp can produce.
        base: (6,) wrench from which the reach is measured [N].
        axis: (6,) unit axis of the cap.
        half_angle: Half-angle of the cap [rad].
        k: (m,) known reaches to start from [N].
        wrenches: (m, 6) unit wrenches of these reaches.
        y: (m, 6) normals of the faces that limit these reaches, with y·wrench = 1.
    """
    best, worst = float(k.min()), wrenches[int(k.argmin())]
    for _ in range(_ROUNDS):
        far, following = hardest(axis, half_angle, y)
        # The face y·w = 1 that limits w limits the next wrench to the same reach or a smaller one.
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
