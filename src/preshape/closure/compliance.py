"""How far a gripped object turns when the contacts press a little beside where they should.

The fingers are springs: a servo yields by its torque over its gain. Seen from a contact that sticks, the
joints behind it are a spring of three forces and the turn about the normal; all of them together are the
stiffness matrix of the grasp (Cutkosky & Kao 1989). The forces of the squeeze themselves take stiffness away,
most from small objects between two fingers: turned a little, their points no longer face each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..spatial import skew
from ..types import Array

BESIDE = 0.002
"""So far beside its place each contact may press: links are not spheres, scans are not the object [m] [C]."""
GROUND = np.diag([1e-5, 1e-5, 1e-5, 1e-2])
"""Compliance of the contacts themselves, skin and surface: forces [m/N], torsion [rad/(N m)] [C]."""


def turn_when_beside(
    arms: Array,
    normals_in: Array,
    forces: Array,
    jacobians: Sequence[Array],
    compliances: Sequence[Array],
) -> float:
    """The object's turn where each force of the squeeze acts :data:`BESIDE` its contact [rad].

    The root of the sum of squares over contacts and directions; infinite where the squeeze pushes the object
    out of its balance, as it does with two fingers that are softer than they press.

    Args:
        arms: (n, 3) contact points from the reference [m].
        normals_in: (n, 3) inward unit normals.
        forces: (n, 3) of the squeeze, on the object [N].
        jacobians: for each contact (6, k): velocity and angular velocity there by the joints behind it.
        compliances: for each contact (k,) of these joints [rad/(N m)].

    >>> arms, inward = np.array([[0.02, 0, 0], [-0.02, 0, 0]]), np.array([[-1.0, 0, 0], [1.0, 0, 0]])
    >>> joints = [np.concatenate([0.1 * np.eye(3), np.eye(3)])] * 2  # three turns, each 0.1 m away
    >>> stiff, soft = ([np.full(3, c)] * 2 for c in (0.02, 1.0))
    >>> [round(turn_when_beside(arms, inward, 5 * inward, joints, c), 3) for c in (stiff, soft)]
    [0.006, inf]
    """
    n, most = len(arms), max(J.shape[1] for J in jacobians)
    # What a contact passes on: forces, and a torque about its normal; there, and seen from the reference.
    passed = np.zeros((n, 6, 4))
    passed[:, :3, :3], passed[:, 3:, 3] = np.eye(3), normals_in
    grasp = passed.copy()
    grasp[:, 3:, :3] = skew(arms)
    motion, yielding = np.zeros((n, 6, most)), np.zeros((n, 1, most))
    for k, (J, compliance) in enumerate(zip(jacobians, compliances, strict=True)):
        motion[k, :, : J.shape[1]], yielding[k, 0, : J.shape[1]] = J, compliance
    at = passed.transpose(0, 2, 1) @ motion
    given = (at * yielding) @ at.transpose(0, 2, 1) + GROUND
    stiffness = (grasp @ np.linalg.solve(given, grasp.transpose(0, 2, 1))).sum(axis=0)
    # The force keeps its direction while its point goes round the reference.
    pressing = skew(forces)
    bending = (pressing @ skew(arms)).sum(axis=0)
    stiffness[3:, 3:] -= (bending + bending.T) / 2
    if np.linalg.eigvalsh(stiffness)[0] <= 0.0:
        return float("inf")
    turns = np.linalg.inv(stiffness)[3:, 3:]  # by a torque
    return float(BESIDE * np.linalg.norm(turns @ pressing))
