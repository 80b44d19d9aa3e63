"""The squeeze of a closed hand: balanced contact forces, their joint torques, and the grip's stiffness.

Every finger acts as a spring: a servo yields by its torque divided by its gain. At a contact that sticks, the
motors behind it act as a spring for three forces and the torque about the normal. All contacts together give
the stiffness matrix of the grasp (Cutkosky & Kao 1989). The forces of the squeeze reduce this stiffness, most
strongly for small objects between two fingers: if the object turns a little, the two contacts no longer face
each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..hands.hand import Hand
from ..hands.kinematics import cross
from ..kernels.chains import rotations
from ..kernels.tables import HandTables
from ..spatial import skew
from ..types import Array, IntArray
from .closed import WRAP, ClosedHands, link_chain

EVENNESS = 0.1
"""Weight of an even distribution of the forces; the balance of the forces has weight ten [C]."""
STRAIN, LESS_EVEN, BALANCE = 20.0, 0.3, 5.0
"""Weight of the motors' strain when the forces of a wrap are chosen, and factors on the weights of an even
distribution and of the balance there [C]."""
EDGES = 8
"""Number of edges of the pyramid that stands for a friction cone when forces are chosen."""
MAX_IMBALANCE = 0.03
"""Largest net wrench of a squeeze's forces, divided by the press; torques are divided by ℓ."""
LEAST_MADE = 0.5
"""Least share of a wrap's press that its motors make (:func:`made_by_motors`) [M]: of wraps on bottles, those
with 0.04, 0.32 and 0.37 of it were dropped, those with 0.55 and 0.56 held, and so did most above 0.5."""
CONTACT_ERROR = 0.002
"""Assumed distance between a force and its planned contact [m] [C]: spheres only approximate the links, and a
scan only approximates the object."""
CONTACT_COMPLIANCE = np.diag([1e-5, 1e-5, 1e-5, 1e-2])
"""Compliance of skin and surface: forces [m/N], torque about the normal [rad/(N m)] [C]."""


HOPEFUL, MOST_EXCHANGES = 3, 5000
"""Number of exchanges of all wrong weights that may pass without fewer of them, and of exchanges in all."""
_ROUNDING = 1e-12  # share of the largest value that counts as zero


class UnitSqueeze(NamedTuple):
    """The squeeze of a hand, for normal forces that sum to one newton.

    Attributes:
        points: (n, 3) contacts [m].
        normals_in: (n, 3) inward unit normals.
        forces: (n, 3) forces on the object, per newton.
        imbalance: Norm of the net wrench of the forces (force; torque divided by ℓ).
        jacobians: For each contact, (6, k) linear and angular velocity per speed of the k motors behind it.
        motors: For each contact, (k,) the motors behind it.
        torques: (j,) joint torques per newton [m].
        drive: (m,) motor torques per newton [m].
        max_press: Largest sum of normal forces that the motors' torques allow [N].
    """

    points: Array
    normals_in: Array
    forces: Array
    imbalance: float
    jacobians: list[Array]
    motors: list[IntArray]
    torques: Array
    drive: Array
    max_press: float


class Squeezer:
    """Computes the squeezes of one hand on one object.

    Args:
        hand: The hand.
        tables: Its tables.
        cog: (3,) point that torques are about [m].
        length: Length by which torques are divided [m].
        mu: Friction that the forces may use.
        enough: Sum of normal forces that is hard enough in any case [N].
    """

    def __init__(
        self, hand: Hand, tables: HandTables, cog: Array, length: float, mu: float, enough: float
    ) -> None:
        self.hand, self.tables, self.cog, self.length, self.mu = hand, tables, cog, length, mu
        self.enough = enough
        at = {joint: k for k, joint in enumerate(hand.joints)}
        # For each inequality of a couple: its joints, their weights, and which of them must not be below.
        self._orders = [
            (columns, motor.weights, columns.index(at[high]))
            for motor, columns in zip(hand.motors, hand.motor_columns(), strict=True)
            for _, high in motor.order
        ]

    def squeeze(self, hands: ClosedHands, frames: tuple[Array, Array], row: int) -> UnitSqueeze:
        """The squeeze of one closed hand; a contact on the palm presses without a motor.

        Args:
            hands: Closed hands, with exact contacts.
            frames: (n, j, 3), (n, j, 3, 3) frames of their joints in the palm frame.
            row: Index of the hand.
        """
        n, candidates = int(hands.counts[row]), hands.candidates
        points = hands.points[row, :n].astype(np.float64)
        normals = hands.normals_in[row, :n].astype(np.float64)
        arms = (points - self.cog) / self.length
        # The joints behind a contact are those of its finger up to the link that touches.
        chains = [link_chain(self.tables, int(link)) for link in hands.links[row, :n]]
        R = rotations(candidates.turn[row])
        anchors = candidates.place[row] + frames[0][row] @ R.T
        axes = np.einsum("ij,njk,nk->ni", R, frames[1][row], self.tables.axis)
        by_joint = [
            np.concatenate([cross(axes[chain], point - anchors[chain]).T, axes[chain].T])
            for chain, point in zip(chains, points, strict=True)
        ]
        rates = self.hand.rates(hands.grasp[row])
        pressing = self._pressing(by_joint, chains, rates) if self._orders else None
        strain = [
            (rates[chain] / self.hand.torque_limits).T @ J[:3].T
            for J, chain in zip(by_joint, chains, strict=True)
        ]
        wrapping = bool(candidates.mask[row] & WRAP)
        # A wrap has many ways to press; the one that strains the motors least can press hardest. Fingertips
        # press evenly, unless their motors cannot press hard enough in that way.
        forces = grip_forces(arms, normals, self.mu, pressing, strain if wrapping else None)
        if not wrapping and (hardest := _hardest_press(strain, forces)) < self.enough:
            gentler = grip_forces(arms, normals, self.mu, pressing, strain)
            if _imbalance(arms, gentler) <= MAX_IMBALANCE and _hardest_press(strain, gentler) > hardest:
                forces = gentler
        torques = np.zeros(len(self.hand.joints))
        for J, chain, force in zip(by_joint, chains, forces, strict=True):
            torques[chain] = force @ J[:3]
        # By virtual work; reactions of stops and of inequalities do none.
        drive = torques @ rates
        motors = [np.unique(self.tables.motor[chain]) for chain in chains]
        return UnitSqueeze(
            points=points,
            normals_in=normals,
            forces=forces,
            imbalance=_imbalance(arms, forces),
            jacobians=[
                J @ rates[chain][:, own] for J, chain, own in zip(by_joint, chains, motors, strict=True)
            ],
            motors=motors,
            torques=torques,
            drive=drive,
            max_press=_hardest_press(strain, forces),
        )

    def _pressing(self, jacobians: list[Array], chains: list[slice], rates: Array) -> list[Array]:
        """For each contact, (i, 3) directions along which a force that the couples can make is not negative.

        The motor of a couple puts the torque cᵢ F on its joints. On the unloaded path the joints of an
        inequality stand at it, so it can only add torque to the joint that must not be below the other:
        τ = c F + reaction, with the reaction on that joint at least zero.
        """
        found = []
        for J, chain in zip(jacobians, chains, strict=True):
            rows = []
            for columns, weights, high in self._orders:
                by_joint = np.zeros((len(columns), 3))
                inside = [k for k, column in enumerate(columns) if chain.start <= column < chain.stop]
                if not inside:
                    continue
                by_joint[inside] = J[:3].T[[columns[k] - chain.start for k in inside]]
                motor = int(self.tables.motor[columns[0]])
                rows.append(by_joint[high] - weights[high] * (rates[columns, motor] @ by_joint))
            found.append(np.array(rows).reshape(-1, 3))
        return found


def _imbalance(arms: Array, forces: Array) -> float:
    """Norm of the net wrench of forces (n, 3) at arms (n, 3) divided by ℓ."""
    return float(np.linalg.norm(np.concatenate([forces.sum(axis=0), cross(arms, forces).sum(axis=0)])))


def _hardest_press(strain: Sequence[Array], forces: Array) -> float:
    """Largest sum of normal forces that the motors allow [N]; see :func:`grip_forces` for ``strain``."""
    shares = sum(share @ force for share, force in zip(strain, forces, strict=True))
    return 1.0 / max(float(np.abs(shares).max()), 1e-9)


def grip_forces(
    arms: Array,
    normals_in: Array,
    mu: float,
    pressing: Sequence[Array] | None = None,
    strain: Sequence[Array] | None = None,
) -> Array:
    """(n, 3) forces of a squeeze: balanced, within the friction cones, with normal parts that sum to one.

    Of all balanced forces in pyramids of ``EDGES`` edges, the result is close to the one spread most evenly
    over contacts and edges. It comes from nonnegative least squares with a small penalty on uneven weights.

    Args:
        arms: (n, 3) contact points relative to the reference point, divided by ℓ.
        normals_in: (n, 3) inward unit normals.
        mu: Friction that the forces may use.
        pressing: For each contact, (i, 3) directions along which its force must not be negative.
        strain: For each contact, (m, 3) share of each motor's torque limit that its force takes [1/N]. With
            it, forces that strain the motors less are preferred to even ones.
    """
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
    # Rows: balance of forces and torques, the sum of the weights, and one penalty for each weight.
    rows = np.concatenate([10 * wrenches.T, 10 * np.ones((1, n * EDGES)), penalty * np.eye(n * EDGES)])
    wanted = np.concatenate([np.zeros(6), [10.0], np.full(n * EDGES, penalty / (n * EDGES))])
    if strain is not None:
        loads = np.concatenate([share @ edge.T for share, edge in zip(strain, edges, strict=True)], axis=1)
        rows[:6] *= BALANCE
        rows = np.concatenate([rows, STRAIN * loads])
        wanted = np.append(wanted, np.zeros(len(loads)))
        rows[7 : 7 + n * EDGES] *= LESS_EVEN
        wanted[7 : 7 + n * EDGES] *= LESS_EVEN
    for k, directions in enumerate(pressing or ()):
        # A contact none of whose edges can be pressed keeps them: then the hand is refused by its balance.
        refused = (edges[k] @ directions.T < -1e-9).any(axis=1)
        if not refused.all():
            rows[:, k * EDGES + np.flatnonzero(refused)] = 0.0
    weights = nonnegative_weights(rows, wanted)
    weights /= max(weights.sum(), 1e-9)
    return np.asarray(np.einsum("ne,nei->ni", weights.reshape(n, EDGES), edges))


def nonnegative_weights(rows: Array, wanted: Array) -> Array:
    """(n,) weights x ≥ 0 with the least norm of rows x - wanted; 0 for a column of zeros.

    By block principal pivoting (Portugal, Júdice and Vicente 1994): the weights that are free are computed
    together, and those that turn out to be on the wrong side of zero change sides. SciPy has the same, but
    importing it would take longer than all the rest of a recalled answer.

    Args:
        rows: (m, n) coefficients; the columns that are not zero are linearly independent.
        wanted: (m,) right-hand side.
    """
    square, slope, used = rows.T @ rows, rows.T @ wanted, rows.any(axis=0)
    free, fewest, again = used.copy(), len(slope) + 1, HOPEFUL
    weights = np.zeros(len(slope))
    for _ in range(MOST_EXCHANGES):
        weights[:] = 0.0
        weights[free] = np.linalg.solve(square[np.ix_(free, free)], slope[free])
        rising = slope - square @ weights
        below = weights < -_ROUNDING * np.abs(weights).max()
        wrong = np.where(free, below, used & (rising > _ROUNDING * np.abs(slope).max()))
        count = int(np.count_nonzero(wrong))
        if not count:
            break
        if count < fewest:
            fewest, again = count, HOPEFUL
        elif again:
            again -= 1
        else:  # one at a time always comes to an end
            wrong[: np.flatnonzero(wrong)[-1]] = False
        free ^= wrong
    # The squares of the rows have cost half of the digits.
    weights[free] = np.linalg.lstsq(rows[:, free], wanted, rcond=None)[0]
    return np.maximum(weights, 0.0)


def _contact_maps(arms: Array, normals_in: Array) -> tuple[Array, Array]:
    """(n, 6, 4) wrenches that contacts transmit, at the contacts and about the reference.

    A contact transmits forces and a torque about its normal.
    """
    at_contact = np.zeros((len(arms), 6, 4))
    at_contact[:, :3, :3], at_contact[:, 3:, 3] = np.eye(3), normals_in
    about = at_contact.copy()
    about[:, 3:, :3] = skew(arms)
    return at_contact, about


def made_by_motors(squeeze: UnitSqueeze, cog: Array, compliance: Array) -> float:
    """Share of a squeeze's press that its motors really make; the rest would need a preload from outside.

    Forces along which a hand is rigid need no torque: balanced forces may have a large share of them, such as
    two links on both sides of an object, held by their bones. No motor makes these, so the object lies loose
    between them. What is made follows from the elastic hand (Bicchi 1994, *active internal forces*):

    1. A servo's target moves each contact by u = J c τ, if nothing is there; c is the motors' compliance.
    2. Contacts and motors yield: C = J diag(c) Jᵀ + the contacts' own compliance.
    3. The object goes where the forces C⁻¹ (u - Gᵀ x) balance: x = (G C⁻¹ Gᵀ)⁻¹ G C⁻¹ u.

    Args:
        squeeze: The squeeze.
        cog: (3,) reference point of torques [m].
        compliance: (m,) compliance of the hand's motors [rad/(N m)].
    """
    n, arms = len(squeeze.points), squeeze.points - cog
    transmitted, grasp = _contact_maps(arms, squeeze.normals_in)
    J, G = np.zeros((4 * n, len(compliance))), np.concatenate(grasp, axis=1)
    for k, (motion, motors) in enumerate(zip(squeeze.jacobians, squeeze.motors, strict=True)):
        J[4 * k : 4 * k + 4, motors] = transmitted[k].T @ motion
    free = J @ (squeeze.drive * compliance)
    stiffness = np.linalg.inv(J * compliance @ J.T + np.kron(np.eye(n), CONTACT_COMPLIANCE))
    moved = np.linalg.solve(G @ stiffness @ G.T, G @ stiffness @ free)
    forces = (stiffness @ (free - G.T @ moved)).reshape(n, 4)[:, :3]
    return float(np.maximum((forces * squeeze.normals_in).sum(axis=1), 0.0).sum())


def turn_from_contact_error(
    arms: Array,
    normals_in: Array,
    forces: Array,
    jacobians: Sequence[Array],
    compliances: Sequence[Array],
) -> float:
    """Rotation of the object if each force of the squeeze acts ``CONTACT_ERROR`` beside its contact [rad].

    1. Compute the compliance of each contact: that of the joints behind it plus that of skin and surface.
    2. Compute the stiffness of the grasp: the sum of the contacts' stiffness about the reference point.
    3. Subtract the stiffness that the squeeze removes, because the contacts move with the object.
    4. Compute the rotation by the torques of the displaced forces: the root of the sum of squares over
       contacts and directions. It is infinite if the grasp is unstable, which happens if the fingers press
       too hard for their stiffness.

    Args:
        arms: (n, 3) contact points relative to the reference point [m].
        normals_in: (n, 3) inward unit normals.
        forces: (n, 3) forces of the squeeze on the object [N].
        jacobians: For each contact, (6, k) linear and angular velocity per speed of the k motors behind it.
        compliances: For each contact, (k,) compliance of these motors [rad/(N m)].

    >>> arms, inward = np.array([[0.02, 0, 0], [-0.02, 0, 0]]), np.array([[-1.0, 0, 0], [1.0, 0, 0]])
    >>> joints = [np.concatenate([0.1 * np.eye(3), np.eye(3)])] * 2  # three joints, each 0.1 m away
    >>> stiff, soft = ([np.full(3, c)] * 2 for c in (0.02, 1.0))
    >>> [round(turn_from_contact_error(arms, inward, 5 * inward, joints, c), 3) for c in (stiff, soft)]
    [0.006, inf]
    """
    n, most = len(arms), max(1, *(J.shape[1] for J in jacobians))
    transmitted, grasp = _contact_maps(arms, normals_in)
    # 1.
    motion, yielding = np.zeros((n, 6, most)), np.zeros((n, 1, most))
    for k, (J, compliance) in enumerate(zip(jacobians, compliances, strict=True)):
        motion[k, :, : J.shape[1]], yielding[k, 0, : J.shape[1]] = J, compliance
    at = transmitted.transpose(0, 2, 1) @ motion
    compliance_at = (at * yielding) @ at.transpose(0, 2, 1) + CONTACT_COMPLIANCE
    # 2.
    stiffness = (grasp @ np.linalg.solve(compliance_at, grasp.transpose(0, 2, 1))).sum(axis=0)
    # 3. A force keeps its direction while its contact moves round the reference.
    pressing = skew(forces)
    bending = (pressing @ skew(arms)).sum(axis=0)
    stiffness[3:, 3:] -= (bending + bending.T) / 2
    # 4.
    if np.linalg.eigvalsh(stiffness)[0] <= 0.0:
        return float("inf")
    turns = np.linalg.inv(stiffness)[3:, 3:]
    return float(CONTACT_ERROR * np.linalg.norm(turns @ pressing))
