"""Metrics of the grasp matrix alone; they ignore the friction."""

from __future__ import annotations

import numpy as np

from .closure import RANK_TOLERANCE
from .contacts import Contacts, grasp_matrix
from .results import Measure, MetricStatus


def smallest_singular_value(contacts: Contacts) -> Measure:
    """σ₆ of the grasp matrix (Li & Sastry 1988), dimensionless; 0 if some wrench is out of reach."""
    return _of(contacts, isotropy=False)


def isotropy(contacts: Contacts) -> Measure:
    """σ₆/σ₁ of the grasp matrix (Kim, Oh & Yi 2001), 0..1; 0 if some wrench is out of reach."""
    return _of(contacts, isotropy=True)


def _of(contacts: Contacts, *, isotropy: bool) -> Measure:
    if contacts.count == 0:
        return Measure(number=None, status=MetricStatus.NO_CONTACTS)
    G = grasp_matrix(contacts)
    # The eigenvalues of the 6×6 G Gᵀ would do, but the SVD of G keeps small values exact.
    left, singular, _ = np.linalg.svd(G)
    small = float(singular[5]) if len(singular) > 5 else 0.0
    if small <= RANK_TOLERANCE * singular[0]:
        return Measure(number=0.0, status=MetricStatus.RANK_DEFICIENT, worst=left[:, 5])
    return Measure(
        number=small / float(singular[0]) if isotropy else small, status=MetricStatus.OK, worst=left[:, 5]
    )
