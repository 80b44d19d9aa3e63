"""The task margin: how strongly a grasp can drive the object the way the task asks.

The task wrench cone holds every wrench within a half-angle of the task's direction, forces in newtons and
torques over ℓ. The margin is the largest k such that k times every unit wrench of the cone, plus what
balances the load, can be produced within friction, force and joint-torque limits (Borst et al. 2004;
Haschke et al. 2005).
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
_HELD = 1e-7  # unproduced part of the load, over the force limit, that is rounding
_STARTS = 32  # faces that the search in closed form starts from


def task_margin(
    contacts: Contacts,
    direction: ArrayLike,
    limits: ForceLimits,
    *,
    load: ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    half_angle: float = HALF_ANGLE,
) -> Measure:
    """The task margin [N].

    The producible wrenches W are convex, so k is the smallest φ(y) = (height of W over the load along y) /
    (largest y·w of the cone) over all directions y. With one bound on the normal forces both are in closed
    form and :mod:`.inscribe` searches the minimum from several faces of W. With joint torque limits, or both
    bounds, a second-order-cone program finds how far W reaches along a wrench w of the cone, and the face y
    that stops it; the cone's wrench that meets this face first is the next w. This starts along the task and
    at ten wrenches of the rim. Both are searches: a missed minimum makes k too large, never too small.

    Args:
        contacts: the grasp.
        direction: (6,) the task's wrench (force; torque over ℓ); only its direction counts.
        limits: what bounds the forces.
        load: (6,) wrench that acts on the object all the while, such as gravity (force [N]; torque about
            the reference point over ℓ [N]); the contacts balance it.
        half_angle: of the cone [rad], 0..π/2.

    Returns:
        k and the wrench that decided; 0 with ``NO_MARGIN`` and ``RANK_DEFICIENT``.

    Raises:
        InputError: a direction of zeros, a half-angle outside 0..π/2, or arrays of the wrong shape.
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
    """(11, 6) the axis, and the rim either way along the principal wrenches of the grasp across it."""
    if half_angle == 0.0:
        return axis[None]
    across = np.eye(6) - np.outer(axis, axis)
    G = across @ grasp_matrix(contacts)
    # Turning with the scene, unlike world axes; the axis itself comes last, with eigenvalue -1.
    _, vectors = np.linalg.eigh(G @ G.T - np.outer(axis, axis))
    rim = vectors[:, 1:].T
    rim = np.concatenate([rim, -rim])
    return np.concatenate([axis[None], math.cos(half_angle) * axis + math.sin(half_angle) * rim])
