"""What the motors behind each contact can press, and what hands can hold under these bounds (ENGINE §6)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..hands.hand import Hand
from ..kernels.chains import joint_frames, rotations
from ..kernels.closing.host import Candidates
from ..kernels.margin.host import MarginKernel
from ..kernels.tables import HandTables
from ..types import Array, IntArray
from .closed import ON_PALM, ClosedCandidates
from .demand import HOLD, LEVER, Demand
from .settings import ClosureSettings

PALM_PRESS = 60.0
"""Largest normal force on the palm, which needs no motor [N] (ENGINE §6)."""


ONE_CONTACT = 0.5
"""Largest share of the press that one contact takes where forces balance."""
LIGHT_PUSH = 0.5
"""Pushes and turns under which unbalanced wraps are compared, in weights of the object [C]."""


class TorqueLimits:
    """Scores of one hand's candidates on one object, with the torques of its motors.

    Args:
        tables: Tables of the hand.
        hand: The hand.
        settings: Presses, mass and plain holding.
        cog: (3,) point that torques are about [m].
        length: ℓ, half the object's largest extent [m].
        task: Gives the kernel of a demand's cone, ``None`` for plain holding.
        holding: Levers [m] and kernels of plain holding.
        make: Makes a kernel for wrenches (m, 6), with ``base`` as a keyword.
    """

    def __init__(
        self,
        tables: HandTables,
        hand: Hand,
        settings: ClosureSettings,
        cog: Array,
        length: float,
        *,
        task: Callable[[Demand], MarginKernel | None],
        holding: Sequence[tuple[float, MarginKernel]],
        make: Callable[..., MarginKernel],
    ) -> None:
        self.tables, self.hand, self.settings = tables, hand, settings
        self.cog, self.length = cog, length
        self._task_kernel, self._holding, self._make = task, holding, make
        self._carrying: tuple[Demand, MarginKernel] | None = None

    def score(self, hands: ClosedCandidates, score: Array, demand: Demand, *, least: float = 0.0) -> Array:
        """(k,) scores lowered to what the hands' motors can press.

        A score is per unit of normal force, so it stands for the strongest press of the settings. Where a
        contact cannot be pressed so hard, the load that forces under the bounds of all contacts balance
        counts instead, divided by that press.

        Args:
            hands: The hands.
            score: (k,) their scores, as if every contact could be pressed as hard as the settings allow.
            demand: What the grip must produce.
            least: Scores up to this need not be exact.
        """
        press, score = self.settings.strongest, score.copy()
        rows = np.flatnonzero(score > least)
        if not len(rows):
            return score
        points, normals, counts, bounds = self._contacts(hands.take(rows))
        used = np.arange(points.shape[1]) < counts[:, None]
        weak = np.flatnonzero((used & (bounds < ONE_CONTACT * press)).any(axis=1))
        rows = rows[weak]
        if not len(rows):
            return score
        given = points[weak], normals[weak], counts[weak]
        bounds = bounds[weak]
        most = score[rows] * press
        kernel = self._task_kernel(demand)
        if kernel is not None:
            base, unit = np.asarray(demand.base) * self.settings.middling, demand.unit(self.length)
            found = kernel.strengths(
                *given,
                unit,
                self.cog,
                most=most * demand.load,
                least=least * press * demand.load,
                base=base,
                bounds=bounds,
            )
            most = np.minimum(most, found / demand.load)
        share = self.settings.hold
        for lever, kernel in self._holding:
            found = kernel.strengths(
                *given, lever, self.cog, most=most * share, least=least * press * share, bounds=bounds
            )
            most = np.minimum(most, found / share)
        score[rows] = most / press
        return score

    def _contacts(self, hands: ClosedCandidates) -> tuple[Array, Array, IntArray, Array]:
        """Contacts of hands, their inward normals, their numbers, and the bounds on their forces [N]."""
        closings = hands.closings
        width = min(closings.points.shape[1], hands.links.shape[1])
        points, normals, links = closings.points[:, :width], closings.normals_in[:, :width], hands.links
        bounds = normal_bounds(
            self.tables, self.hand, hands.candidates, hands.grasp, points, normals, links[:, :width]
        )
        return points, normals, closings.counts, np.minimum(bounds, self.settings.strongest)

    def imbalance(self, hands: ClosedCandidates, demand: Demand) -> Array:
        """(k,) how far hands are from carrying the weight under light pushes, as a share of the press.

        Few drawn wraps balance anything. Those that nearly do are the ones to refine.
        """
        if not len(hands.rows):
            return np.zeros(0)
        if self._carrying is None or self._carrying[0] is not demand:
            wrenches = np.concatenate([np.zeros((1, 6)), LIGHT_PUSH * self.settings.weight * HOLD])
            base = np.asarray(demand.base) * self.settings.middling
            self._carrying = demand, self._make(wrenches, base=base)
        points, normals, counts, bounds = self._contacts(hands)
        unit = min(LEVER, 1.5 * self.length)
        out = self._carrying[1](points, normals, counts, unit, bounds=bounds, reference=self.cog)
        return np.asarray(out["residual"], dtype=np.float64) / self.settings.strongest


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
