"""The search: close many candidates, rank them by how well their contacts resist, refine the best.

Everything here is arrays over candidates; nothing knows the task's name, the memory or the hand's file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..hands.hand import Hand
from ..kernels.closing.host import Candidates, ClosingKernel, Closings
from ..kernels.field.host import DistanceField
from ..kernels.hand_spheres import COARSE
from ..kernels.margin.host import MarginKernel
from ..kernels.tables import HandTables
from ..types import Array, BoolArray, IntArray, freeze, frozen_array, value
from .hand_tables import hand_tables
from .holding import HOLD, LEVER
from .preshapes import Preshapes, joint_ranges, posture_at, preshapes
from .ranked import Ranked, apart, best_of, take
from .sampling import Sampled
from .settings import ClosureSettings

STEP, TURN, BEND = 0.006, 0.12, 0.10
"""Spread of the first refinement: wrist [m], its turn [rad], joints of the preshape [rad] [C]."""
OPENED, ROOM = 0.8, 0.002
"""Table and boxes are kept out of by this [m], closed and opened to this share of the closing [C]."""


@value
class Demand:
    """What the grip is asked for, in units of the sum of its normal forces.

    Attributes:
        direction: (6,) the task's wrench (force; torque over ℓ), or ``None`` for plain holding.
        half_angle: of the cone around it [rad].
        base: (6,) what must be produced all the while, as minus the weight.
        load: the task's load that a unit of strength is compared with; plain holding's is one weight.
    """

    direction: Array | None = None
    half_angle: float = float(np.radians(15.0))
    base: Array | tuple[float, ...] = (0.0,) * 6
    load: float = 1.0

    def __post_init__(self) -> None:
        freeze(self, base=frozen_array(self.base, (6,), "base wrench"))
        if self.direction is not None:
            freeze(self, direction=frozen_array(self.direction, (6,), "task direction"))


class ClosureSearch:
    """One hand and one object, ready to be searched.

    Args:
        hand: which hand.
        field: the object's signed distance.
        cog: (3,) the point that torques are about [m].
        length: ℓ, half the object's largest extent [m].
        settings: friction, device, size of the search.
        turns: turns that plain holding asks for in place of those about the frame's axes, and their levers.
    """

    def __init__(
        self,
        hand: Hand,
        field: DistanceField,
        cog: Array,
        length: float,
        settings: ClosureSettings,
        turns: Sequence[tuple[float, Array]] = (),
    ) -> None:
        self.hand, self.field, self.settings = hand, field, settings
        self.cog, self.length = np.asarray(cog, dtype=np.float64), float(length)
        self.tables: HandTables = hand_tables(hand, COARSE)
        self.pool: Preshapes = preshapes(hand)
        self.ranges = joint_ranges(hand, self.tables)
        self.kernel = ClosingKernel(self.tables, field, device=settings.device, threads=settings.threads)
        lever = min(LEVER, 1.5 * self.length)
        asked = [(lever, HOLD if not turns else HOLD[[0, 1, 2, 6, 7, 8]]), *turns]
        self._holding = [(lever, self._margins(wrenches)) for lever, wrenches in asked]
        self._serves: dict[bool, tuple[Demand, MarginKernel]] = {}

    def evaluate(self, sampled: Sampled, demand: Demand, *, wanted: int = 3, least: float = 0.0) -> Ranked:
        """Close the candidates and rank those that hold on to the object.

        Args:
            sampled: candidates.
            demand: what the grip is asked for.
            wanted: contacts that a candidate must find.
            least: scores up to this are not worked out further: they come out as this at most.
        """
        rows, closed = self.kernel.closed(sampled.candidates, wanted=wanted)
        met = len(rows)
        if self.settings.obstacles:
            free = self._out_of_the_way(sampled, closed, rows)
            rows, closed = rows[free], closed.take(np.flatnonzero(free))
        task, hold = self.strengths(closed, demand, ranking=True, least=least)
        score = self.score(task, hold, demand)
        found = Ranked(
            sampled=take(sampled, rows),
            closings=closed,
            score=score,
            task=task,
            hold=hold,
            tried=len(sampled.candidates),
            blocked=met - len(rows),
        )
        return found.take(np.argsort(-score, kind="stable"))

    def _out_of_the_way(self, sampled: Sampled, closings: Closings, rows: IntArray) -> BoolArray:
        """Which of the rows keep out of table and boxes, closed and a little opened."""
        c = sampled.candidates.take(rows)
        free = np.ones(len(rows), dtype=bool)
        for share in (1.0, OPENED):
            posture = posture_at(self.tables, c.start, share * closings.closing)
            free &= self.kernel.clearances(c.place, c.turn, posture, self.settings.obstacles)[1] > ROOM
        return free

    def strengths(
        self, closings: Closings, demand: Demand, *, ranking: bool = False, least: float = 0.0
    ) -> tuple[Array, Array]:
        """(n,), (n,) strength along the task's cone, and of plain holding.

        Args:
            closings: that closed.
            demand: what the grip is asked for.
            ranking: plain holding is looked at only as far as it can change the score.
            least: scores up to this are only known not to be above it.
        """
        if not len(closings.counts):
            return np.zeros(0), np.zeros(0)
        given = closings.points, closings.normals_in, closings.counts
        serving = self._serving(demand)
        task, enough = None, least * self.settings.hold
        if serving is not None:
            task = serving.strengths(*given, self.length, self.cog, least=least * demand.load)
        hold: Array | float = math.inf
        if task is not None and ranking:
            hold = task / demand.load * self.settings.hold
        for lever, kernel in self._holding:
            hold = kernel.strengths(*given, lever, self.cog, most=hold, least=enough)
        return np.asarray(hold if task is None else task), np.asarray(hold)

    def surely(self, closings: Closings, demand: Demand, press: Array) -> Array:
        """(n,) strength along the task's cone, by a search that takes ten times as long and misses less.

        Args:
            closings: that closed.
            demand: what the grip is asked for.
            press: (n,) sum of normal forces that carries the weight [N].
        """
        kernel = self._serving(demand, thorough=True)
        if kernel is None:
            return self.strengths(closings, demand)[0]
        left = np.zeros(len(press))
        for one in np.unique(press):  # mostly all the same
            rows = np.flatnonzero(press == one)
            some = closings.take(rows)
            given = some.points, some.normals_in, some.counts
            base = demand.base * (self.settings.middling / one)
            left[rows] = kernel.strengths(*given, self.length, self.cog, base=base)
        return left

    def _margins(self, wrenches: Array, **cone: Any) -> MarginKernel:
        s = self.settings
        return MarginKernel(
            wrenches, friction=s.mu, torsion=s.gamma, device=s.device, threads=s.threads, **cone
        )

    def _serving(self, demand: Demand, *, thorough: bool = False) -> MarginKernel | None:
        """The kernel of a demand's cone, the last ones kept; ``None`` for plain holding."""
        if demand.direction is None:
            return None
        asked, cone = self._serves.get(thorough, (None, None))
        if cone is None or asked is not demand:
            cone = self._margins(
                demand.direction[None], base=demand.base, half_angle=demand.half_angle, thorough=thorough
            )
            self._serves[thorough] = demand, cone
        return cone

    def score(self, task: Array, hold: Array, demand: Demand) -> Array:
        """(n,) margin over the loads expected, the smaller of the task's and of plain holding's."""
        return np.minimum(task / demand.load, hold / self.settings.hold)

    def near(
        self,
        rng: np.random.Generator,
        elite: Ranked,
        each: int,
        spread: float,
        *,
        shift: float | None = None,
        turn: float | None = None,
    ) -> Sampled:
        """Children of the elite: wrist and preshape moved a little.

        Args:
            rng: of the draws.
            elite: parents.
            each: children of each parent.
            spread: factor on the first refinement's spread.
            shift: of the wrist, in place of the spread's [m].
            turn: of its turn, in place of the spread's [rad].
        """
        from scipy.spatial.transform import Rotation

        rows = np.repeat(np.arange(len(elite)), each)
        parents = take(elite.sampled, rows)
        n = len(rows)
        counts = elite.closings.counts[rows]
        valid = np.arange(elite.closings.points.shape[1]) < counts[:, None]
        # Turned about the contacts, not about the wrist: else a small turn would miss the object.
        middle = np.where(valid[:, :, None], elite.closings.points[rows], 0.0).sum(axis=1) / counts[:, None]
        turned = Rotation.from_rotvec(rng.normal(0.0, TURN * spread if turn is None else turn, (n, 3)))
        place = parents.candidates.place
        moved = turned.apply(place - middle) + middle
        moved += rng.normal(0.0, STEP * spread if shift is None else shift, (n, 3))
        start = parents.candidates.start + rng.normal(0.0, BEND * spread, parents.candidates.start.shape)
        start = np.clip(start, *self.ranges)
        turned = turned * Rotation.from_quat(parents.candidates.turn, scalar_first=True)
        return replace(
            parents,
            candidates=Candidates(
                place=moved,
                turn=turned.as_quat(scalar_first=True),
                start=start,
                mask=parents.candidates.mask,
            ),
        )

    def refine(
        self,
        rng: np.random.Generator,
        found: Ranked,
        demand: Demand,
        *,
        elite: int = 32,
        each: int = 6,
        rounds: int = 3,
        wanted: int = 3,
    ) -> Ranked:
        """The best of them, searched further nearby; the better of parents and children each round."""
        best, keep = found, 4 * elite
        for k in range(rounds):
            if not len(best):
                break
            parents = best.take(apart(best, elite, 1.0 / (k + 1)))
            least = float(best.score[keep - 1]) if len(best) >= keep else 0.0
            nearby = self.near(rng, parents, each, 0.6**k)
            best = best_of(best, self.evaluate(nearby, demand, wanted=wanted, least=least), keep=keep)
        return best

    def steady(
        self,
        rng: np.random.Generator,
        found: Ranked,
        demand: Demand,
        *,
        samples: int = 8,
        shift: float = 0.003,
        turn: float = 0.05,
        wanted: int = 3,
    ) -> Ranked:
        """Ranked again by what is left of the margin when the object is not quite where it should be.

        Args:
            rng: of the draws.
            found: a few dozen candidates.
            demand: as for the ranking.
            samples: poses tried for each.
            shift: standard deviation of the wrist's error [m].
            turn: of its turn [rad].
            wanted: contacts that a candidate must find.
        """
        if not len(found):
            return found
        moved = self.near(rng, found, samples, 0.0, shift=shift, turn=turn)
        rows, closings = self.kernel.closed(moved.candidates, wanted=wanted)
        score = np.zeros(len(moved.candidates))
        score[rows] = self.score(*self.strengths(closings, demand, ranking=True), demand)
        each = np.sort(score.reshape(len(found), samples), axis=1)
        # The worse half of what may happen counts as much as the grasp as planned.
        left = 0.5 * (found.score + each[:, : max(1, samples // 2)].mean(axis=1))
        return replace(found, score=left).take(np.argsort(-left, kind="stable"))
