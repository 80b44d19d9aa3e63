"""The wrenches that contacts can produce, given by their support function.

The support function says how far these wrenches reach along a direction. It gives exact distances and margins
with exact friction cones. Points are projected on a hull of support points by non-negative least squares; the
hull grows where it is still too small.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from ..types import Array, BoolArray
from .contacts import Contacts, cone_matrix, rim

_FIVES = 500  # largest number of sets of five wrenches that give directions
EXACT = 1e-10
"""Distance, in units of the normal force, below which a hull of support points counts as the space itself."""
CROWDED = 100
"""Number of points above which a hull drops those without weight."""


class Hull(NamedTuple):
    """Some wrenches of a space and the forces that produce them.

    Attributes:
        points: (k, 6) wrenches.
        forces: (k, n, d) cone coordinates of every contact.
    """

    points: Array
    forces: Array

    def grown(self, more: Hull) -> Hull:
        """The hull with more points at the end."""
        return Hull(np.concatenate([self.points, more.points]), np.concatenate([self.forces, more.forces]))

    def only(self, which: BoolArray) -> Hull:
        """The hull of some of the points."""
        return Hull(self.points[which], self.forces[which])


class WrenchSpace:
    """All wrenches whose normal forces sum to at most one (L1), or are each at most one (L∞).

    Args:
        contacts: The contacts of the grasp.
        each: Whether to use the L∞ bound instead of the L1 bound.
        full: Whether the normal forces sum to exactly one (L1 only).
    """

    def __init__(self, contacts: Contacts, *, each: bool = False, full: bool = False) -> None:
        self.each, self.full = each, full
        n, d = contacts.count, contacts.dimension
        G = cone_matrix(contacts)
        self._columns, self._shape = np.ascontiguousarray(G.T), (n, d)
        self.by_contact = self._columns.reshape(n, d, 6)
        ring, self._coarse = rim(contacts, 8, halves=False), rim(contacts, 4, halves=False)
        cut = np.einsum("ij,ed->iejd", np.eye(n), ring).reshape(-1, n, d)
        self.hull = self._hull(cut if full else np.concatenate([np.zeros((1, n, d)), cut]))

    def _hull(self, forces: Array) -> Hull:
        return Hull(forces.reshape(len(forces), -1) @ self._columns, forces)

    def faces(self) -> Array:
        """(m, 6) outward normals of faces of the space with four-edged pyramids instead of cones.

        With the L1 bound these are all faces, or none if the space has no volume. With the L∞ bound,
        directions perpendicular to five of the contacts' unit wrenches are added (for at most 500 sets of
        five), because the faces of a sum of flat sets have such normals.
        """
        from scipy.spatial import ConvexHull, QhullError

        cut = np.einsum("ndk,ed->nek", self.by_contact, self._coarse).reshape(-1, 6)
        try:
            normals = ConvexHull(np.concatenate([np.zeros((1, 6)), cut])).equations[:, :6]
        except QhullError:
            return np.zeros((0, 6))
        if not self.each:
            return normals
        fives = np.array(list(itertools.combinations(range(len(self._columns)), 5)))
        if len(fives) > _FIVES:
            fives = fives[np.random.default_rng(0).choice(len(fives), _FIVES, replace=False)]
        _, singular, right = np.linalg.svd(self._columns[fives])
        perpendicular = right[singular[:, 4] > 1e-6 * singular[:, 0], 5]
        return np.concatenate([normals, perpendicular, -perpendicular])

    def heights(self, directions: Array) -> Array:
        """(m,) support of (m, 6) directions: the largest d·w over the space."""
        local = (directions @ self._columns.T).reshape(-1, *self._shape)
        each = local[..., 0] + np.sqrt((local[..., 1:] ** 2).sum(axis=-1))
        if self.each:
            return np.maximum(each, 0.0).sum(axis=1)
        highest = each.max(axis=1)
        return highest if self.full else np.maximum(highest, 0.0)

    def support(self, direction: Array) -> tuple[float, Hull]:
        """The support of one direction (6,), and wrenches of the space that reach far along it."""
        n, d = self._shape
        local = (self._columns @ direction).reshape(n, d)
        rim = local.copy()
        rim[:, 0] = 0.0
        size = np.sqrt((rim * rim).sum(axis=1))
        each = local[:, 0] + size
        rim /= np.where(size > 0.0, size, 1.0)[:, None]
        rim[:, 0] = 1.0
        alone = np.zeros((n, n, d))
        alone[np.arange(n), np.arange(n)] = rim
        if not self.each:
            highest = float(each.max())
            return highest if self.full else max(highest, 0.0), self._hull(alone)
        on = each > 0.0
        best = np.where(on[:, None], rim, 0.0)
        # Adding or removing one contact gives the neighbouring corners.
        corners = best + np.where(on, -1.0, 1.0)[:, None, None] * alone
        return float(each[on].sum()), self._hull(np.concatenate([best[None], corners, alone]))


def project(hull: Array, point: Array) -> tuple[Array, Array]:
    """Project a point on a convex hull.

    The point of least norm of the hull of the columns of Q is Q a / Σ a, where a ≥ 0 is the least-squares
    solution of [Q; 1] a = [0; 1] (Lawson & Hanson's least-distance programming).

    Args:
        hull: (k, 6) points of the hull.
        point: (6,) point to project.

    Returns:
        (6,) point minus its projection, and (k,) weights of the hull's points in the projection.
    """
    from scipy.optimize import nnls

    system = np.ones((7, len(hull)))
    system[:6] = (hull - point).T
    weights, _ = nnls(system, _LAST, maxiter=100 * len(hull))
    weights = weights / weights.sum()
    return -(system[:6] @ weights), weights


_LAST = np.append(np.zeros(6), 1.0)


def hardest(axis: Array, half_angle: float, normals: Array) -> tuple[Array, Array]:
    """The wrench of a cap that reaches farthest along each direction.

    Args:
        axis: (6,) unit axis of the cap.
        half_angle: Half-angle of the cap [rad]; π means all unit wrenches.
        normals: (m, 6) directions.

    Returns:
        (m,) largest y·w along each direction y, and the (m, 6) wrenches w.
    """
    along = normals @ axis
    across = normals - along[:, None] * axis
    width = np.sqrt((across * across).sum(axis=1))
    angle = np.minimum(half_angle, np.arctan2(width, along))
    cosine, sine = np.cos(angle), np.sin(angle)
    wrench = cosine[:, None] * axis + (sine / np.where(width > 0.0, width, 1.0))[:, None] * across
    return cosine * along + sine * width, wrench
