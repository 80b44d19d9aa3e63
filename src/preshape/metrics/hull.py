"""Epsilon and volume of the grasp wrench space (Ferrari & Canny 1992; Miller & Allen 1999).

L1 bound: the normal forces sum to one, and the space is the convex hull of the contact wrenches. L∞ bound:
each normal force is at most one, and the space is the sum of the contacts' wrench sets. Torques are divided
by ℓ.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..types import Array, one_of
from .closure import force_closure, reached
from .contacts import Contacts, generators
from .face_descent import lower as lower_face
from .force_program import ForceLimits, force_program
from .inscribe import inscribe
from .results import Measure, MetricStatus
from .wrench_space import WrenchSpace

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

NORMS = ("L1", "Linf")
_STARTS = 24


def epsilon(contacts: Contacts, norm: str = "L1", *, edges: int = 8) -> Measure:
    """Radius of the largest ball of wrenches about the origin that the grasp can produce.

    Epsilon is the minimum over unit vectors d of the height of the wrench space along d. The height has a
    closed form with exact friction cones; :mod:`.inscribe` searches for the minimum.

    Args:
        contacts: The contacts of the grasp.
        norm: ``L1`` or ``Linf``.
        edges: Edges of the pyramids that ``lower`` is computed from; 0 leaves ``lower`` out, which is
            quicker.

    Returns:
        Epsilon in units of one normal force, and the direction in which the ball touches; 0 with the statuses
        ``NOT_CLOSED`` and ``RANK_DEFICIENT``. ``lower`` is the radius of the ball in the hull of the
        pyramids, a lower bound of the exact value for both norms.

    Raises:
        InputError: There is no such norm, or :func:`~preshape.metrics.generators` rejects the edges.
    """
    one_of(norm, "norm", NORMS)
    status = force_closure(contacts).status
    if status is not MetricStatus.OK:
        zero = 0.0 if status in (MetricStatus.NOT_CLOSED, MetricStatus.RANK_DEFICIENT) else None
        return Measure(number=zero, status=status)
    lower = None
    if edges:
        # The L∞ space contains the L1 space, so its ball is at least as large.
        lower = max(float(-_hull(generators(contacts, edges).reshape(-1, 6)).equations[:, 6].max()), 0.0)
    space = WrenchSpace(contacts, each=norm == "Linf")
    fit = inscribe(space, np.zeros(6), np.eye(6)[0], math.pi, starts=_STARTS)
    k, worst = fit.k, fit.wrench
    if not fit.settled:
        limits = ForceLimits(each=1.0) if space.each else ForceLimits(total=1.0)
        program = force_program(contacts, limits)
        one = np.array([k])
        k, worst = lower_face(program, np.zeros(6), worst, math.pi, one, worst[None], fit.normal[None])
    return Measure(number=max(k, 0.0), status=MetricStatus.OK, lower=lower, worst=worst)


def volume(contacts: Contacts, *, edges: int = 8) -> Measure:
    """Volume of the L1 wrench space and the origin, in (normal force)⁶, computed with pyramids for cones.

    The number, which is also ``lower``, is computed with pyramids inside the cones; ``upper`` with pyramids
    around them (friction divided by cos(π/edges), hard fingers only). The exact volume lies between the two.
    A grasp that is not closed has a volume too, because the hull includes the origin.
    """
    if contacts.count == 0:
        return Measure(number=None, status=MetricStatus.NO_CONTACTS)
    inside = _volume(contacts, edges)
    if inside is None:
        return Measure(number=0.0, status=MetricStatus.RANK_DEFICIENT)
    upper = None
    if contacts.dimension == 3:
        wider = replace(contacts, friction=contacts.mu / math.cos(math.pi / edges))
        upper = _volume(wider, edges)
    return Measure(number=inside, status=MetricStatus.OK, lower=inside, upper=upper)


def _volume(contacts: Contacts, edges: int) -> float | None:
    points = np.concatenate([np.zeros((1, 6)), generators(contacts, edges).reshape(-1, 6)])
    if reached(points.T) < 6:
        return None
    return float(_hull(points).volume)


def _hull(points: Array) -> ConvexHull:
    from scipy.spatial import ConvexHull

    return ConvexHull(points)
