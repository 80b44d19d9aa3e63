"""How a closed hand squeezes: forces that balance, and the joint torques that make them (ENGINE §2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..hands.hand import Hand
from ..hands.kinematics import cross
from ..kernels.chains import rotations
from ..kernels.closing.host import Candidates, Closings
from ..kernels.tables import HandTables
from ..types import Array

EVENNESS = 0.1
"""Weight of an even spread of the forces, against ten for their balance [C]."""
EDGES = 8
"""Of a friction cone, where forces are chosen."""


class Pressing(NamedTuple):
    """How a hand squeezes, for one newton of normal forces in all.

    Attributes:
        used: fingers that press, the thumb first.
        points: (n, 3) where they do [m].
        normals_in: (n, 3) inward unit normals.
        forces: (n, 3) on the object.
        left: what of them does not balance: force, and torque over ℓ.
        jacobians: for each contact (6, k) its motion by the joints behind it.
        chains: which of the hand's joints these are.
        torques: (j,) joint torques [m].
        limit: largest sum of normal forces that the joints can make [N].
    """

    used: list[int]
    points: Array
    normals_in: Array
    forces: Array
    left: float
    jacobians: list[Array]
    chains: list[slice]
    torques: Array
    limit: float


class Press:
    """Squeezes of one hand on one object.

    Args:
        hand: which hand.
        tables: its arrays.
        cog: (3,) the point that torques are about [m].
        length: ℓ, half the object's largest extent [m].
        mu: friction that the forces may use.

    Attributes:
        sharing: (j,) into how many parts a joint's drive is shared out: one drive sets the sum of a couple's
            angles, so each of the two takes half of what it is told.
    """

    def __init__(self, hand: Hand, tables: HandTables, cog: Array, length: float, mu: float) -> None:
        self.hand, self.tables, self.cog, self.length, self.mu = hand, tables, cog, length, mu
        joints = list(hand.joints)
        self._couples = [(joints.index(a), joints.index(b)) for a, b in hand.couplings]
        self.sharing = np.ones(len(joints))
        self.sharing[[k for couple in self._couples for k in couple]] = 2.0

    def __call__(
        self, candidates: Candidates, packed: Closings, frames: tuple[Array, Array], row: int
    ) -> Pressing:
        """How one of the hands squeezes.

        Args:
            candidates: hands.
            packed: how they closed, with exact contacts, the thumb's first.
            frames: (n, j, 3), (n, j, 3, 3) of their joints in the palm frame.
            row: which of them.
        """
        n = int(packed.counts[row])
        points = packed.points[row, :n].astype(np.float64)
        normals = packed.normals_in[row, :n].astype(np.float64)
        used = [f for f in finger_order(self.tables) if packed.sphere[row, f] >= 0]
        arms = (points - self.cog) / self.length
        forces = grip_forces(arms, normals, self.mu)
        left = np.concatenate([forces.sum(axis=0), cross(arms, forces).sum(axis=0)])
        where = frames[0][row], frames[1][row]
        jacobians, chains = self._jacobians(candidates, packed, row, where, used, points)
        torques = self._torques(jacobians, chains, forces)
        # A joint that would be too weak for the whole squeeze makes it weaker.
        strain = float((np.abs(torques) / self.hand.torque_limits).max())
        return Pressing(
            used=used,
            points=points,
            normals_in=normals,
            forces=forces,
            left=float(np.linalg.norm(left)),
            jacobians=jacobians,
            chains=chains,
            torques=torques,
            limit=1.0 / max(strain, 1e-9),
        )

    def _jacobians(
        self,
        candidates: Candidates,
        packed: Closings,
        row: int,
        frames: tuple[Array, Array],
        used: list[int],
        points: Array,
    ) -> tuple[list[Array], list[slice]]:
        """For each contact (6, k) its motion by the joints behind it, and which of the hand's these are."""
        places, turns = frames
        R = rotations(candidates.turn[row])
        anchors = candidates.place[row] + places @ R.T
        axes = np.einsum("ij,njk,nk->ni", R, turns, self.tables.axis)
        touching = np.searchsorted(self.tables.sphere_start, packed.sphere[row], side="right") - 1
        chains = [slice(int(self.tables.joint_start[f]), int(touching[f]) + 1) for f in used]
        return [
            np.concatenate([cross(axes[chain], point - anchors[chain]).T, axes[chain].T])
            for chain, point in zip(chains, points, strict=True)
        ], chains

    def _torques(self, jacobians: list[Array], chains: list[slice], forces: Array) -> Array:
        """(j,) joint torques that make the contact forces (n, 3), Jᵀ f."""
        torques = np.zeros(len(self.hand.joints))
        for J, chain, force in zip(jacobians, chains, forces, strict=True):
            torques[chain] = force @ J[:3]
        # One tendon: the same torque on both, the nearest to what each should have.
        for a, b in self._couples:
            torques[[a, b]] = (torques[a] + torques[b]) / 2
        return torques


def finger_order(tables: HandTables) -> list[int]:
    """The thumb, then the others: the order of contacts."""
    t = tables.thumb
    return [t, *(f for f in range(len(tables.fingers)) if f != t)]


def grip_forces(arms: Array, normals_in: Array, mu: float) -> Array:
    """(n, 3) forces of a squeeze that moves nothing: they balance, their normal parts sum to one.

    Of all balanced ones inside the cones (of eight edges) about the one that spreads most evenly over
    contacts and cone: nonnegative least squares with a small penalty.

    Args:
        arms: (n, 3) contact points from the reference, over ℓ.
        normals_in: (n, 3) inward unit normals.
        mu: friction that they may use.
    """
    from scipy.optimize import nnls

    n = len(arms)
    helper = np.where(np.abs(normals_in[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    t1 = cross(normals_in, helper)
    t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
    t2 = cross(normals_in, t1)
    angles = np.arange(EDGES) * 2 * np.pi / EDGES
    edges = normals_in[:, None] + mu * (
        np.cos(angles)[None, :, None] * t1[:, None] + np.sin(angles)[None, :, None] * t2[:, None]
    )
    flat = edges.reshape(-1, 3)
    wrenches = np.concatenate([flat, cross(np.repeat(arms, EDGES, axis=0), flat)], axis=1)
    penalty = EVENNESS * np.sqrt(n * EDGES)
    rows = np.concatenate([10 * wrenches.T, 10 * np.ones((1, n * EDGES)), penalty * np.eye(n * EDGES)])
    wanted = np.concatenate([np.zeros(6), [10.0], np.full(n * EDGES, penalty / (n * EDGES))])
    weights, _ = nnls(rows, wanted)
    weights /= max(weights.sum(), 1e-9)
    return np.asarray(np.einsum("ne,nei->ni", weights.reshape(n, EDGES), edges))
