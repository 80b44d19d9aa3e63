"""Force closure: can the contacts balance every wrench?

A second-order-cone program decides this exactly for friction cones (Han, Trinkle & Li 2000); a linear program
decides it for pyramids inside the cones. Both require contacts that reach every wrench direction (G of rank
6), and search for contact forces strictly inside their cones that balance one another. If such forces exist,
they resist any load once they are large enough; if not, some wrench cannot be balanced (Murray, Li & Sastry
1994).
"""

from __future__ import annotations

import numpy as np

from ..types import Array
from .conic import solve
from .contacts import Contacts, cone_matrix, generators
from .results import ForceClosure, MetricStatus

RANK_TOLERANCE = 1e-9
"""Singular values of G below this fraction of the largest one count as zero."""
CLOSED = 1e-8
"""A margin up to this counts as a rounding error; the grasp is then not closed."""


def reached(matrix: Array) -> int:
    """Rank of a (6, k) matrix: how many wrench directions its columns span."""
    if not matrix.size:
        return 0
    singular = np.linalg.svd(matrix, compute_uv=False)
    return int((singular > RANK_TOLERANCE * singular[0]).sum())


def force_closure(contacts: Contacts) -> ForceClosure:
    """Force closure with exact friction cones.

    The program maximises t subject to G u + t G e = 0, u in the cones, Σ uₙ + n t ≤ 1, where e is the axis of
    every cone. The forces u + t e balance one another and lie at depth t inside their cones. The grasp is
    closed exactly when 0 < t ≤ 1/n.
    """
    early = _early(contacts, cone_matrix(contacts))
    if early is not None:
        return early
    n, d = contacts.count, contacts.dimension
    axis = np.tile(np.eye(d)[0], n)
    G = cone_matrix(contacts)
    # Unknowns: u, t + 1 (which cannot be negative), and the slack of the sum.
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
    """Force closure with pyramids of ``edges`` edges inside the cones, by a linear program (HiGHS).

    A positive result is certain, but a grasp that is only just closed may be missed. The margin is the share
    of the normal force that every edge of a contact carries, times the number of edges.
    """
    from scipy.optimize import linprog

    rays = generators(contacts, edges) if contacts.count else np.zeros((0, 1, 6))
    early = _early(contacts, rays.reshape(-1, 6).T)
    if early is not None:
        return early
    n, k, _ = rays.shape
    P = rays.reshape(-1, 6).T
    # The unknowns are t and the weights of the edges beyond t/k.
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
