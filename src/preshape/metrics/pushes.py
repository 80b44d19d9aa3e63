"""The residual of six pushes: how well a unit of grip balances what holding asks for."""

from __future__ import annotations

import numpy as np

from ..exceptions import InputError
from ..types import Array, frozen_array
from .contacts import Contacts, in_space
from .distance import distance
from .results import Measure, MetricStatus
from .wrench_space import WrenchSpace

FRICTION_SHARE = 0.6
"""Share of the friction that the forces may use: room for error."""
PUSH = 0.1
"""A push over the sum of the normal forces: 1 N against a grip of 10 N [C]."""


def six_pushes(size: float = PUSH) -> Array:
    """(6, 6) forces ± along the axes of the frame, in units of the grip; no torque."""
    return np.concatenate([np.eye(6)[:3], -np.eye(6)[:3]]) * size


def push_residual(
    contacts: Contacts, wrenches: Array | None = None, *, friction_share: float = FRICTION_SHARE
) -> Measure:
    """Distance from each wrench asked for to the nearest that a unit of grip can produce.

    minimise ``|Σ w(f) - wrench|`` over contact forces inside the cones (not cut) at ``friction_share`` of the
    friction, with the normal forces summing to one. Zero: balanced exactly.

    Args:
        contacts: the grasp.
        wrenches: (m, 6) to be produced (force; torque over ℓ), in units of the grip; the six pushes if none.
        friction_share: 0 < share ≤ 1, of the sliding and the torsional friction.

    Returns:
        The residual of the worst wrench in units of the grip, each one's, and the forces.

    Raises:
        InputError: wrenches that are not m×6 finite numbers, or a share outside 0..1.
    """
    asked = frozen_array(six_pushes() if wrenches is None else wrenches, (None, 6), "wrenches asked for")
    if not len(asked):
        raise InputError("wrenches asked for must be at least one, got none")
    if not 0.0 < friction_share <= 1.0:
        raise InputError(f"the share of friction must be in 0..1, got {friction_share:g}")
    if contacts.count == 0:
        return Measure(number=None, status=MetricStatus.NO_CONTACTS)
    weaker = Contacts(
        positions=contacts.positions,
        normals_in=contacts.normals_in,
        friction=contacts.mu * friction_share,
        torsion=np.asarray(contacts.torsion) * friction_share,
        reference=contacts.reference,
        length=contacts.length,
    )
    space = WrenchSpace(weaker, full=True)
    residuals, forces = [], []
    for wrench in asked:
        size, exact, force = distance(space, wrench)
        if not exact:
            return Measure(number=None, status=MetricStatus.NOT_CONVERGED)
        residuals.append(size)
        forces.append(force)
    worst = int(np.argmax(residuals))
    return Measure(
        number=residuals[worst],
        status=MetricStatus.OK,
        worst=asked[worst],
        per_wrench=np.array(residuals),
        forces=in_space(weaker, np.array(forces)),
    )
