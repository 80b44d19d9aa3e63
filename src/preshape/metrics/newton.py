"""Newton's method for a face of a wrench space: it refines a projection or cap to rounding accuracy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..types import Array
from .wrench_space import WrenchSpace

_STEPS = 10
_SHARE = 1e-4  # share of the normal force below which a contact does not touch the face
RIMS = (0.9, 0.9999, 0.3)
"""A contact touches the face with its whole cone if its tangential force, divided by the largest that the
friction permits, is below such a ratio; callers try the ratios in this order."""

Wanted = Callable[[Array, float], tuple[Array, Array, Array, float, Array, float]]
"""Maps (y, k) to the wanted wrench (6,), its derivatives by y (6, 6) and by k (6,), and the residual of a
further condition with its derivatives by y (6,) and by k."""


def finish(
    space: WrenchSpace, force: Array, rim: float, y: Array, k: float, wanted: Wanted
) -> tuple[Array, float, Array] | None:
    """Solve for the normal y of a face and the forces of the contacts that touch it.

    The unknowns are y, the force (λ, z) of every touching contact, the height H of the face, and k. A contact
    touches the face either with the rim or with the whole of its cone. With the rim, z is λ times the unit
    vector of the rim along y. With the whole cone, y is perpendicular to the contact's tangential wrenches,
    and z is free. The equations are

    - Σ wrenches = wanted(y, k), and the further condition;
    - L1: each touching contact has height H, and Σ λ = 1;
    - L∞: λ = 1, or height 0 where 0 < λ < 1.

    The steps are

    1. choose the touching contacts from the first forces, and for each one rim or whole cone;
    2. at most ``_STEPS`` times: compute the residual, and stop if it vanishes; otherwise take a Newton
       step;
    3. reject the solution if the residual is large, a contact pulls, or a force leaves its cone.

    Args:
        space: The wrench space.
        force: (n, d) forces near the solution, in cone coordinates.
        rim: One of :data:`RIMS`.
        y: (6,) vector near the solution.
        k: Number near the solution.
        wanted: Function of (y, k) that returns the wrench to which the contacts must add up, and its
            derivatives.

    Returns:
        y, k and the (n, d) forces; ``None`` if the method fails.
    """
    # 1. Touching contacts, and how they touch.
    on = np.flatnonzero(force[:, 0] > _SHARE)
    if not len(on):
        return None
    flat = np.sqrt((force[on, 1:] ** 2).sum(axis=1)) < rim * force[on, 0]
    top, side, round_side = space.by_contact[on, 0], space.by_contact[on, 1:], space.by_contact[on[~flat], 1:]
    lam, height = force[on, 0], 0.0 if space.each else space.support(y)[0]
    free = lam < 1.0 - _SHARE if space.each else np.ones(len(on), dtype=bool)
    lam = np.where(free, lam, 1.0)
    loose, z = side[flat].reshape(-1, 6), force[on][flat, 1:].reshape(-1)
    m, f = int(free.sum()), len(loose)
    if m + f > 6:
        return None
    bowl = np.swapaxes(round_side, 1, 2) @ round_side
    sums = 0.0 if space.each else 1.0  # the faces of the L∞ space have no common height
    J = np.zeros((8 + m + f, 8 + m + f))
    J[-2, 6 : 6 + m], J[6 : 6 + m, -2], J[-2, -2] = sums, -1.0, 1.0 - sums
    J[:6, 6 + m : -2], J[6 + m : -2, :6] = loose.T, loose
    touch = top.copy()
    # 2. Newton's method.
    for _ in range(_STEPS):
        target, by_y, by_k, further, row, corner = wanted(y, k)
        along = round_side @ y
        length = np.sqrt((along * along).sum(axis=1))
        if length.size and length.min() < 1e-12:
            return None
        unit = along / length[:, None]
        spread = (unit[:, None] @ round_side)[:, 0]
        touch[~flat] = top[~flat] + spread
        last = lam.sum() - 1.0 if sums else height
        made = lam @ touch + z @ loose - target
        residual = np.concatenate([made, touch[free] @ y - height, loose @ y, [last, further]])
        if np.abs(residual).max() < 1e-14 * (1.0 + abs(k)):
            break
        bend = bowl - spread[:, :, None] * spread[:, None, :]
        J[:6, :6] = ((lam[~flat] / length)[:, None, None] * bend).sum(axis=0) - by_y
        J[:6, 6 : 6 + m], J[6 : 6 + m, :6] = touch[free].T, touch[free]
        J[:6, -1], J[-1, :6], J[-1, -1] = -by_k, row, corner
        try:
            step = np.linalg.solve(J, -residual)
        except np.linalg.LinAlgError:
            return None
        if not np.abs(step).max() < 1e3:  # false for NaN too
            return None
        y, z = y + step[:6], z + step[6 + m : -2]
        lam[free] += step[6 : 6 + m]
        height, k = height + float(step[-2]), k + float(step[-1])
    # 3. Checks.
    if not np.abs(residual).max() < 1e-11 * (1.0 + abs(k)):
        return None
    forces = np.zeros_like(force)
    forces[on, 0] = lam
    forces[on[flat], 1:] = z.reshape(-1, force.shape[1] - 1)
    slides = np.sqrt((forces[:, 1:] ** 2).sum(axis=1)) > forces[:, 0] + 1e-12
    if lam.min() < 0.0 or (space.each and lam.max() > 1.0) or slides.any():
        return None
    forces[on[~flat], 1:] = lam[~flat, None] * unit
    return y, k, forces
