"""The task margin: how strongly a grasp can load the object as the task needs.

The task wrench cone is the set of all wrenches within a half-angle of the task's direction (force [N]; torque
divided by ℓ [N]). The margin is the largest k for which k times each unit wrench of the cone, with the
wrench that balances the load, can be produced within the limits of friction, force and joint torque (Borst et
al. 2004; Haschke et al. 2005).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError
from ..types import Array, frozen_array
from .closure import reached
from .contacts import Contacts, cone_matrix, grasp_matrix
from .distance import distance
from .face_descent import lower
from .force_program import PENALTY, ForceLimits, force_program, reach
from .inscribe import NOTHING, inscribe
from .results import Measure, MetricStatus
from .wrench_space import WrenchSpace

HALF_ANGLE = math.radians(15.0)
_HELD = 1e-7  # accepted unbalanced part of the load, divided by the force limit, because of rounding errors
_STARTS = 32  # wrenches that the search in closed form starts from


def task_margin(
    contacts: Contacts,
    direction: ArrayLike,
    limits: ForceLimits,
    *,
    load: ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    half_angle: float = HALF_ANGLE,
) -> Measure:
    """The task margin [N].

    The set W of producible wrenches is convex. Let φ(y) = (height of W along y, measured from the wrench that
    balances the load) / (largest y·w of the cone). Then k is the minimum of φ over all directions y. There
    are two ways to find it:

    1. With one bound on the normal forces, both parts of φ have a closed form, and :mod:`.inscribe` searches
       for the minimum from several faces of W.
    2. With joint torque limits, or both bounds, a second-order-cone program finds how far W reaches along a
       wrench w of the cone, and the face that limits the reach. The wrench of the cone that meets this face
       first is the next w (:mod:`.face_descent`). The search starts at the axis and at ten wrenches of the
       rim.

    Both are searches: a minimum that is missed makes k too large, never too small.

    Args:
        contacts: The contacts of the grasp.
        direction: (6,) wrench of the task (force; torque divided by ℓ), of any length but 0.
        limits: Bounds of the forces.
        load: (6,) constant wrench on the object that the contacts must balance, such as its weight (force
            [N]; torque about the reference point, divided by ℓ [N]).
        half_angle: Half-angle of the cone, 0..π/2 [rad].

    Returns:
        k, and the wrench that limits it; 0 with the statuses ``NO_MARGIN`` and ``RANK_DEFICIENT``.

    Raises:
        InputError: The direction is zero, the half-angle is out of range, or an array has the wrong shape.
    """
    axis = frozen_array(direction, (6,), "task direction")
    size = float(np.linalg.norm(axis))
    if size == 0.0:
        raise InputError("a task direction must not be six zeros")
    if not 0.0 <= half_angle <= math.pi / 2:
        raise InputError(f"the cone's half-angle must be in 0..π/2, got {half_angle:g}")
    axis = axis / size
    base = -frozen_array(load, (6,), "load")
    if contacts.count == 0:
        return Measure(number=None, status=MetricStatus.NO_CONTACTS)
    if limits.jacobian is None and (limits.total is None) != (limits.each is None):
        return _in_closed_form(contacts, axis, limits, base, half_angle)
    return _by_programs(contacts, axis, limits, base, half_angle)


def _in_closed_form(
    contacts: Contacts, axis: Array, limits: ForceLimits, base: Array, half_angle: float
) -> Measure:
    unit = limits.unit
    space = WrenchSpace(contacts, each=limits.total is None)
    if base.any():
        missing, exact, _ = distance(space, base / unit)
        if missing > _HELD:
            status = MetricStatus.LOAD_NOT_HELD if exact else MetricStatus.NOT_CONVERGED
            return Measure(number=None, status=status)
    if reached(cone_matrix(contacts)) < 6:
        return Measure(number=0.0, status=MetricStatus.RANK_DEFICIENT)
    fit = inscribe(space, base / unit, axis, half_angle, starts=_STARTS)
    if fit.settled:
        return _measure(fit.k * unit, unit, fit.wrench)
    program = force_program(contacts, limits)
    y = fit.normal / float(fit.normal @ fit.wrench)
    number, worst = lower(
        program, base, axis, half_angle, np.array([fit.k * unit]), fit.wrench[None], y[None]
    )
    return _measure(number, unit, worst)


def _by_programs(
    contacts: Contacts, axis: Array, limits: ForceLimits, base: Array, half_angle: float
) -> Measure:
    program = force_program(contacts, limits)
    wrenches = _starts(contacts, axis, half_angle)
    k, y, solution = reach(program, np.concatenate([np.zeros((1, 6)), wrenches]), base)
    if not solution.converged.all():
        return Measure(number=None, status=MetricStatus.NOT_CONVERGED)
    if -k[0] > PENALTY * _HELD * program.unit:
        return Measure(number=None, status=MetricStatus.LOAD_NOT_HELD)
    if reached(cone_matrix(contacts)) < 6:
        return Measure(number=0.0, status=MetricStatus.RANK_DEFICIENT)
    number, worst = lower(program, base, axis, half_angle, k[1:], wrenches, y[1:])
    return _measure(number, program.unit, worst)


def _measure(k: float, unit: float, worst: Array) -> Measure:
    if not math.isfinite(k):
        return Measure(number=None, status=MetricStatus.NOT_CONVERGED)
    if k <= NOTHING * unit:
        return Measure(number=0.0, status=MetricStatus.NO_MARGIN, worst=worst)
    return Measure(number=k, status=MetricStatus.OK, worst=worst)


def _starts(contacts: Contacts, axis: Array, half_angle: float) -> Array:
    """(11, 6) unit wrenches to start from: the axis, and the rim along the grasp's ± principal wrenches."""
    if half_angle == 0.0:
        return axis[None]
    across = np.eye(6) - np.outer(axis, axis)
    G = across @ grasp_matrix(contacts)
    # Principal wrenches rotate with the scene, unlike world axes. The axis has the smallest eigenvalue, -1.
    _, vectors = np.linalg.eigh(G @ G.T - np.outer(axis, axis))
    rim = vectors[:, 1:].T
    rim = np.concatenate([rim, -rim])
    return np.concatenate([axis[None], math.cos(half_angle) * axis + math.sin(half_angle) * rim])
