"""Contact wrenches, the net wrench, and the screw measures (§2.3).

A soft-finger contact exerts a normal force, two tangential forces and a moment about the normal, scaled by
the contact coefficients (eq. 9-12). The sum of all contact wrenches about the COG is the net wrench
(eq. 13-14), the pattern that represents a virtual grasp.

Lengths are in 4U here (:data:`preshape.types.LENGTH_UNIT`), forces in units of the normal force.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError
from ..types import Array, ContactCoefficients, one_of
from .planes import ApproachPlane

THUMB, FINGER = 1.0, -1.0
"""Sign s of the force along the transverse axis: the paper prints +Ko for the thumb (eq. 11) and states that
the wrenches of all fingers are the same [R]."""

RANK_TOLERANCE = 1e-9
"""Singular values below this fraction of the largest count as zero."""


def contact_wrenches(
    positions: Array,
    normals_in: Array,
    approach_axis: Array,
    transverse_axis: Array,
    transverse_sign: Array,
    coefficients: ContactCoefficients,
) -> Array:
    """The soft-finger wrench of each contact about the COG.

    Args:
        positions: (..., n, 3) contact positions relative to the COG, in 4U (eq. 7).
        normals_in: (..., n, 3) inward unit normals.
        approach_axis: (..., 3) a.
        transverse_axis: (..., 3) t.
        transverse_sign: (..., n) s = +1 for the thumb, -1 for every finger (eq. 11) [R].
        coefficients: Ka, Ko, Kn, Mn.

    Returns:
        (..., n, 6) wrenches (force, torque) about the COG, axes x y z.
    """
    a = np.asarray(approach_axis)[..., None, :]
    t = np.asarray(transverse_axis)[..., None, :]

    def tangential(axis: Array) -> Array:
        along = np.einsum("...i,...i->...", axis, normals_in)[..., None]
        return axis - along * normals_in  # not renormalised [R]

    k = coefficients
    sign = np.asarray(transverse_sign)[..., None]
    force = k.kn * normals_in + k.ka * tangential(a) + k.ko * sign * tangential(t)  # eq. 11-12
    moment = k.mn * normals_in
    return np.concatenate([force, moment + _cross(positions, force)], axis=-1)  # eq. 13


def grasp_wrenches(
    points: Array,
    normals_in: Array,
    plane: ApproachPlane,
    *,
    cog: Array,
    length_unit: float,
    coefficients: ContactCoefficients,
) -> Array:
    """The wrench of each contact of one grasp about the COG.

    Args:
        points: (n, 3) contacts, the thumb's first [m].
        normals_in: (n, 3) inward unit normals.
        plane: The approach plane.
        cog: (3,) the object's COG [m].
        length_unit: 4U of the hand [m].
        coefficients: Ka, Ko, Kn, Mn.

    Returns:
        (n, 6) wrenches, axes x y z, lengths in 4U.
    """
    signs = np.full(len(points), FINGER)
    signs[0] = THUMB
    arms = (points - cog) / length_unit
    return contact_wrenches(arms, normals_in, plane.approach_axis, plane.transverse_axis, signs, coefficients)


def _cross(a: Array, b: Array) -> Array:
    """a × b over the last axis; several times faster than ``np.cross`` for a few vectors."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def net_wrench(wrenches: Array) -> Array:
    """(..., 6) sum of the contact wrenches (..., n, 6), all about the COG (eq. 14)."""
    return wrenches.sum(axis=-2)


def rank(matrix: ArrayLike, tolerance: float = RANK_TOLERANCE) -> int:
    """Rank of a matrix: the number of singular values above ``tolerance`` times the largest."""
    singular = np.linalg.svd(np.atleast_2d(np.asarray(matrix, dtype=np.float64)), compute_uv=False)
    if singular.size == 0 or singular[0] == 0:
        return 0
    return int((singular > tolerance * singular[0]).sum())


def reciprocal_twists(wrench_union: ArrayLike, tolerance: float = RANK_TOLERANCE) -> Array:
    """A basis of the twists reciprocal to a set of wrenches (Adams & Whitney's construction).

    A twist (angular, linear) is reciprocal to a wrench (force, torque) if the wrench does no work on it:
    force · linear + torque · angular = 0. These twists span the null space of the wrench union, with the
    force and torque halves of the wrenches swapped.

    Args:
        wrench_union: (n, 6) wrenches about one point.
        tolerance: Relative tolerance for the singular values.

    Returns:
        (k, 6) orthonormal twists (angular, linear), k = 6 - rank.
    """
    union = np.asarray(wrench_union, dtype=np.float64).reshape(-1, 6)
    swapped = union[:, [3, 4, 5, 0, 1, 2]]
    _, singular, right = np.linalg.svd(swapped, full_matrices=True)
    top = singular[0] if singular.size else 0.0
    nonzero = int((singular > tolerance * top).sum()) if top > 0 else 0
    return right[nonzero:]


def soft_finger_basis(positions: ArrayLike, normals_in: ArrayLike) -> Array:
    """Four unit wrenches for each contact: three forces and the moment about the normal.

    Args:
        positions: (n, 3) contacts relative to the COG, in 4U.
        normals_in: (n, 3) inward unit normals.

    Returns:
        (4n, 6) wrenches about the COG.
    """
    positions, normals = np.atleast_2d(positions), np.atleast_2d(normals_in)
    rows = []
    for r, n in zip(positions, normals, strict=True):
        # The tangents depend on the contact's normal only.
        helper = np.eye(3)[np.argmin(np.abs(n))]
        t1 = np.cross(n, helper)
        t1 /= np.linalg.norm(t1)
        for f in (n, t1, np.cross(n, t1)):
            rows.append(np.concatenate([f, np.cross(r, f)]))
        rows.append(np.concatenate([np.zeros(3), n]))
    return np.array(rows)


READINGS = ("net", "basis")
"""``net`` uses one wrench per finger, as the paper does; ``basis`` the full soft-finger basis."""


def screw_measures(
    wrenches: ArrayLike,
    positions: ArrayLike | None = None,
    normals_in: ArrayLike | None = None,
    *,
    reading: str = "net",
    tolerance: float = RANK_TOLERANCE,
) -> tuple[int, int]:
    """Stability index and manipulability index of a grasp (§2.3).

    manipulability = rank(WU) and stability = rank(WU) - rank(TI), not below 0; both 0..6 [P]. TI is the set
    of twists reciprocal to WU: the freedoms of motion that the grasp does not hold.

    Args:
        wrenches: (n, 6) contact wrenches about the COG, one per finger.
        positions: (n, 3) contacts relative to the COG, in 4U; needed for ``basis``.
        normals_in: (n, 3) inward unit normals; needed for ``basis``.
        reading: With ``net``, WU is the stacked contact wrenches, one per finger [P]; its rank is small for
            few fingers. With ``basis``, WU has all four wrenches that a soft finger can exert; its rank is 6
            for almost any two contacts [C].
        tolerance: Relative tolerance for the singular values.

    Returns:
        (stability, manipulability).

    Raises:
        InputError: The reading is unknown, or it is ``basis`` and the contacts are missing.
    """
    one_of(reading, "reading", READINGS)
    if reading == "basis":
        if positions is None or normals_in is None:
            raise InputError("the basis reading needs contact positions and normals")
        union = soft_finger_basis(positions, normals_in)
    else:
        union = np.asarray(wrenches, dtype=np.float64).reshape(-1, 6)
    hidden = len(reciprocal_twists(union, tolerance))
    manipulability = 6 - hidden  # = rank(WU), as TI is the null space of WU
    return max(manipulability - hidden, 0), manipulability
