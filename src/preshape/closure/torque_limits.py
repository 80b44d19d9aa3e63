"""What the motors behind each contact can press: the bound on its normal force (ENGINE §6)."""

from __future__ import annotations

import numpy as np

from ..hands.hand import Hand
from ..kernels.chains import joint_frames, rotations
from ..kernels.closing.host import Candidates
from ..kernels.tables import HandTables
from ..types import Array, IntArray
from .closed import ON_PALM

PALM_PRESS = 60.0
"""Largest normal force on the palm, which needs no motor [N] (ENGINE §6)."""


def normal_bounds(
    tables: HandTables,
    hand: Hand,
    hands: Candidates,
    grasp: Array,
    points: Array,
    normals_in: Array,
    links: IntArray,
) -> Array:
    """(n, c) largest normal force that the motors behind each contact could make for it alone [N].

    It is the least of τ / |(Jᵀ n)| over the motors behind the contact, where τ is the motor's torque limit.
    Measured on 5 to 15 contacts, strengths under these bounds rank as those of the program in which the
    contacts of a finger share its torques (rank correlation 0.999).

    Args:
        tables: Tables of the hand.
        hand: The hand.
        hands: (n,) hands.
        grasp: (n, j) their joint angles [rad].
        points: (n, c, 3) contacts [m].
        normals_in: (n, c, 3) inward unit normals.
        links: (n, c) joint that carries each touching link; ``ON_PALM`` for the palm.
    """
    if not len(grasp):
        return np.zeros(points.shape[:2])
    places, turns = joint_frames(tables, grasp)
    axes = np.einsum("njik,jk->nji", turns, tables.axis)
    R = rotations(hands.turn)
    local = np.einsum("nji,ncj->nci", R, points - hands.place[:, None])  # in the palm frame
    inward = np.einsum("nji,ncj->nci", R, normals_in)
    # (axis × arm) · n = axis · (point × n) - axis · (anchor × n)
    by_joint = np.einsum("nji,nci->ncj", axes, np.cross(local, inward))
    by_joint -= np.einsum("nji,nci->ncj", np.cross(axes, places), inward)
    joints = np.arange(len(tables.axis))
    finger = np.searchsorted(tables.joint_start, joints, side="right") - 1
    before = (finger[:, None] == finger) & (joints <= joints[:, None])  # (link, joint)
    behind = before[links] & (links != ON_PALM)[:, :, None]
    rates = hand.rates(grasp[0])
    # A matrix that may be written to holds for its own posture only.
    of = rates[None] if not rates.flags.writeable else np.stack([hand.rates(q) for q in grasp])
    drive = np.abs(np.where(behind, by_joint, 0.0) @ of)
    most = 1.0 / np.maximum((drive / hand.torque_limits).max(axis=2), 1e-9)
    return np.where(links == ON_PALM, PALM_PRESS, np.minimum(most, 1e4))
