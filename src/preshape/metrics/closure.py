"""Force closure: can the contacts balance every wrench?

Exact for the cones as they are through a second-order-cone program (Han, Trinkle & Li 2000), and for cones
cut into edges through a linear program. Both ask for the same thing: contact forces strictly inside their
cones that balance each other, by contacts that reach every direction (G of rank 6). Such forces can absorb
any push once they are large enough; without them some wrench cannot be balanced (Murray, Li & Sastry 1994).
"""

from __future__ import annotations

import numpy as np

from ..types import Array
from .conic import solve
from .contacts import Contacts, cone_matrix, generators
from .results import ForceClosure, MetricStatus

RANK_TOLERANCE = 1e-9
"""Singular values of G under this fraction of the largest count as zero."""
CLOSED = 1e-8
"""A margin up to this is rounding: the grasp is not closed."""


def reached(matrix: Array) -> int:
    """How many wrench directions the columns of (6, k) span."""
    if not matrix.size:
        return 0
    singular = np.linalg.svd(matrix, compute_uv=False)
    return int((singular > RANK_TOLERANCE * singular[0]).sum())


def force_closure(contacts: Contacts) -> ForceClosure:
    """Force closure with the friction cones as they are.

    maximise t: G u + t G e = 0, u in the cones, Σ uₙ + n t ≤ 1, with e the axis of every cone: forces u + t e
    balance each other and are t deep. 0 < t ≤ 1/n exactly when the grasp is closed.
    """
    early = _early(contacts, cone_matrix(contacts))
    if early is not None:
        return early
    n, d = contacts.count, contacts.dimension
    axis = np.tile(np.eye(d)[0], n)
    G = cone_matrix(contacts)
    # Unknowns: u, t + 1 (so that it cannot be negative), the slack of the sum.
    A = np.zeros((7, n * d + 2))
    A[:6, : n * d], A[:6, n * d] = G, G @ axis
    A[6, : n * d], A[6, n * d], A[6, n * d + 1] = axis, n, 1.0
    b = np.append(G @ axis, 1.0 + n)
    c = np.zeros(n * d + 2)
    c[n * d] = -1.0
    solution = solve(c, A, b, ((n, d), (2, 1)))
    if not solution.converged[0]:
        return ForceClosure(closed=False, status=MetricStatus.NOT_CONVERGED, margin=None)
    return _decided(-float(solution.objective[0]) - 1.0)


def force_closure_linear(contacts: Contacts, edges: int = 8) -> ForceClosure:
    """Force closure with cones cut into ``edges`` edges, through a linear program (HiGHS).

    The edges lie inside the cones: closed here means closed; a grasp that is only just closed may be missed.
    The margin is that of the edges: the share that every edge of a contact carries, times their number.
    """
    from scipy.optimize import linprog

    rays = generators(contacts, edges) if contacts.count else np.zeros((0, 1, 6))
    early = _early(contacts, rays.reshape(-1, 6).T)
    if early is not None:
        return early
    n, k, _ = rays.shape
    P = rays.reshape(-1, 6).T
    # a = weights beyond t/k on every edge
    result = linprog(
        np.append(np.zeros(n * k), -1.0),
        A_ub=np.append(np.ones(n * k), n)[None],
        b_ub=[1.0],
        A_eq=np.column_stack([P, P.sum(axis=1) / k]),
        b_eq=np.zeros(6),
        bounds=[(0.0, None)] * (n * k) + [(0.0, None)],
        method="highs",
    )
    if result.status != 0:
        return ForceClosure(closed=False, status=MetricStatus.NOT_CONVERGED, margin=None)
    return _decided(-float(result.fun or 0.0))


def _early(contacts: Contacts, matrix: Array) -> ForceClosure | None:
    if contacts.count == 0:
        return ForceClosure(closed=False, status=MetricStatus.NO_CONTACTS, margin=None)
    if reached(matrix) < 6:
        return ForceClosure(closed=False, status=MetricStatus.RANK_DEFICIENT, margin=None)
    return None


def _decided(margin: float) -> ForceClosure:
    closed = margin > CLOSED
    status = MetricStatus.OK if closed else MetricStatus.NOT_CLOSED
    return ForceClosure(closed=closed, status=status, margin=max(margin, 0.0))
