"""The residual of six pushes: how well a unit of grip force balances the loads of holding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..exceptions import InputError
from ..types import Array, frozen_array
from .contacts import Contacts, in_space
from .distance import distance
from .results import Measure, MetricStatus
from .wrench_space import WrenchSpace

FRICTION_SHARE = 0.6
"""Share of the friction that the forces may use; the rest is a reserve."""
PUSH = 0.1
"""Force of a push divided by the sum of the normal forces: 1 N against a grip of 10 N [C]."""


def six_pushes(size: float = PUSH) -> Array:
    """(6, 6) forces along the ± axes of the frame without torques, in units of the grip force."""
    return np.concatenate([np.eye(6)[:3], -np.eye(6)[:3]]) * size


def push_residual(
    contacts: Contacts, wrenches: Array | None = None, *, friction_share: float = FRICTION_SHARE
) -> Measure:
    """Distance from each wrench to the nearest wrench that a unit of grip force can produce.

    It is the minimum of ``|Σ w(f) - wrench|`` over contact forces f whose normal parts sum to one and that
    lie in the exact friction cones, reduced by ``friction_share``. It is 0 if the wrench is produced exactly.

    Args:
        contacts: The contacts of the grasp.
        wrenches: (m, 6) wrenches to produce (force; torque over ℓ), in units of the grip force; by default
            the six pushes.
        friction_share: Share of sliding and torsional friction that may be used, above 0 and at most 1.

    Returns:
        The residual of the worst wrench in units of the grip force, the residual of each, and the forces.

    Raises:
        InputError: The wrenches are not m×6 finite numbers, or the share is out of range.
    """
    wanted = frozen_array(six_pushes() if wrenches is None else wrenches, (None, 6), "wrenches")
    if not len(wanted):
        raise InputError("wrenches must be at least one, got none")
    if not 0.0 < friction_share <= 1.0:
        raise InputError(f"the share of friction must be above 0 and at most 1, got {friction_share:g}")
    if contacts.count == 0:
        return Measure(number=None, status=MetricStatus.NO_CONTACTS)
    weaker = replace(
        contacts,
        friction=contacts.mu * friction_share,
        torsion=np.asarray(contacts.torsion) * friction_share,
    )
    space = WrenchSpace(weaker, full=True)
    residuals, forces = [], []
    for wrench in wanted:
        size, exact, force = distance(space, wrench)
        if not exact:
            return Measure(number=None, status=MetricStatus.NOT_CONVERGED)
        residuals.append(size)
        forces.append(force)
    worst = int(np.argmax(residuals))
    return Measure(
        number=residuals[worst],
        status=MetricStatus.OK,
        worst=wanted[worst],
        per_wrench=np.array(residuals),
        forces=in_space(weaker, np.array(forces)),
    )
