"""The search: close many candidates, rank them by how well their contacts resist loads, refine the best.

Everything here is arrays over candidates. The search does not know the task's name, the memory or the hand's
file.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from ..hands.hand import Hand
from ..hands.kinematics import HandKinematics
from ..hiis.analyser import Grip
from ..kernels.closing.host import Candidates, ClosingKernel, Closings, Fate
from ..kernels.field.host import DistanceField, SurfaceQuery
from ..kernels.hand_spheres import COARSE
from ..kernels.margin.host import CONTACTS, MarginKernel
from ..kernels.tables import HandTables
from ..objects.mesh import TriangleMesh
from ..types import Array, BoolArray
from .blockers import Blockers
from .candidates import DrawnCandidates, RankedCandidates, Region, concatenated, distinct, merged
from .closed import WRAP, ClosedCandidates, ClosedHands, closed_hands, touching_spheres
from .contact_places import AllowedSurface
from .demand import HOLD, LEVER, Demand
from .hand_tables import hand_tables
from .preshapes import Preshapes, motor_ranges, posture_at, posture_of, preshapes
from .settings import ClosureSettings
from .torque_limits import TorqueLimits
from .wrapping import Wrapper, wraps

_log = logging.getLogger("preshape.search")

MIN_CONTACTS = 2
"""Least number of contacts of a candidate, thumb included; its margin decides whether they are enough."""
STEP, TURN, BEND = 0.006, 0.12, 0.10
"""Standard deviations of the first refinement: wrist position [m], wrist rotation [rad], joints of the
preshape [rad] [C]."""
DECAY = 0.6
"""Factor by which these shrink from round to round [C]."""
WRAP_GAP, WRAP_NEAR, WRAP_BACK = 5e-4, 1.5e-3, 0.012
"""Distance from the surface at which links of a wrap stop in the search, largest distance that counts as
contact, and distance from the object at which a wrap begins to move in [m] [C]."""
CLEAR, CLEAR_SHIFT, CLEAR_TURN = 200, 0.02, 0.3
"""Number of hands that are clear of the obstacles around which more are drawn, and the standard deviations of
the position [m] and rotation [rad] of these [C]."""
LIFTED = 0.02
"""Largest distance by which a hand is lifted off the table [m] [C]."""
WRAP_DRAWS = 6
"""Largest number of wraps drawn for each one wanted, where table or boxes are in the way of some [C]."""


class ClosureSearch:
    """One hand and one object, ready to be searched.

    Args:
        hand: The hand.
        field: Signed distance of the object.
        cog: (3,) point that torques are about [m].
        length: ℓ, half the object's largest extent [m].
        settings: Friction, device, size of the search.
        turns: Torques of plain holding with their levers (:func:`~preshape.closure.demand.turn_levers`),
            instead of torques about the axes of the frame.
        query: The object's surface; without it, contacts on lids are found in the finished grips only.

    Attributes:
        blockers: What may refuse a hand that closed: obstacles and contact rules.
    """

    def __init__(
        self,
        hand: Hand,
        field: DistanceField,
        cog: Array,
        length: float,
        settings: ClosureSettings,
        turns: Sequence[tuple[float, Array]] = (),
        query: SurfaceQuery | None = None,
    ) -> None:
        self.query = query
        self.hand, self.field, self.settings = hand, field, settings
        self.cog, self.length = np.asarray(cog, dtype=np.float64), float(length)
        self.tables: HandTables = hand_tables(hand, COARSE)
        self.kernel = ClosingKernel(self.tables, field, device=settings.device, threads=settings.threads)
        self.blockers = Blockers(hand, self.tables, self.kernel, settings, field.spacing)
        self._kinematics = HandKinematics(hand)
        self.wrapper = Wrapper(self.tables, self.kernel, field, gap=WRAP_GAP, near=WRAP_NEAR)
        lever = min(LEVER, 1.5 * self.length)
        self._pushes = [(lever, HOLD if not turns else HOLD[[0, 1, 2, 6, 7, 8]]), *turns]
        self._hold_kernels = self.holding(settings.friction_share)
        self._task_kernels: dict[bool, tuple[Demand, MarginKernel | None]] = {}
        self._torques = TorqueLimits(
            self.tables,
            hand,
            settings,
            self.cog,
            self.length,
            task=self._task_kernel,
            holding=self._hold_kernels,
            make=self._margin_kernel,
        )

    @cached_property
    def pool(self) -> Preshapes:
        """The hand's preshapes."""
        return preshapes(self.hand)

    @cached_property
    def ranges(self) -> tuple[Array, Array]:
        """(m,), (m,) range that each motor's first command is drawn from [rad]."""
        return motor_ranges(self.hand, self.tables)

    def draw_wraps(
        self,
        rng: np.random.Generator,
        mesh: TriangleMesh,
        count: int,
        region: Region,
        surface: AllowedSurface | None = None,
    ) -> DrawnCandidates:
        """Draw wraps whose open hand, with the palm at its place, is clear of obstacles and kept-off parts.

        A hand that only reaches its place through the table would be closed for nothing. Where few are clear,
        at most ``WRAP_DRAWS`` times as many are drawn.

        Args:
            rng: Random generator.
            mesh: The object.
            count: Number of wraps wanted.
            region: Allowed planes and sides.
            surface: The surface that may be touched; ``None`` for all of it.
        """
        if not len(self.blockers.obstacles) and not len(self.blockers.kept_off):
            return self.wrapper.draw(rng, self.pool, mesh, count, region, surface)
        found: DrawnCandidates | None = None
        for _ in range(WRAP_DRAWS):
            drawn = self.wrapper.draw(rng, self.pool, mesh, count, region, surface)
            clear = self.blockers.clear(self.wrapper.arrived(drawn.candidates))
            drawn = drawn.take(np.flatnonzero(clear))
            found = drawn if found is None else concatenated(found, drawn)
            if len(found) >= count:
                break
        assert found is not None
        return found.take(np.arange(min(count, len(found))))

    def evaluate(
        self, drawn: DrawnCandidates, demand: Demand, *, least: float = 0.0, blocked: int | None = None
    ) -> RankedCandidates:
        """Close candidates and rank those that close on the object.

        1. Close every candidate, and drop those that do not close on the object, or close on a lid.
        2. Lift fingertip grips that reach into the table by little off it, and close them again. Drop those
           that collide with table or boxes, or break a contact rule.
        3. Compute the strengths of their contacts, as far as the motors' torques allow, and sort by score.

        Args:
            drawn: Candidates.
            demand: What the grip must produce.
            least: A score up to this need not be exact; it is then reported as this or less.
            blocked: Index of a blocker: the candidates that it refuses are ranked, and not those that are
                clear of all blockers.
        """
        hands = self._closed(drawn.candidates)
        closed = len(hands.rows)
        hits = self.blockers.refuse(hands.closings, hands.candidates, hands.grasp)
        if blocked is None and len(self.settings.obstacles.planes) == 1 and not wraps(drawn):
            hands, hits = self._lifted(hands, hits)
        hands = hands.take(np.flatnonzero(~hits.any(axis=1) if blocked is None else hits[:, blocked]))
        task, hold = self.strengths(hands.closings, demand, ranking=True, least=max(least, 0.0))
        score = self._torques.score(hands, self.score(task, hold, demand), demand, least=max(least, 0.0))
        if wraps(drawn):
            unbalanced = np.flatnonzero(score <= 0.0)
            score[unbalanced] = -self._torques.imbalance(hands.take(unbalanced), demand)
        found = RankedCandidates(
            drawn=replace(drawn.take(hands.rows), candidates=hands.candidates),
            closings=hands.closings,
            score=score,
            task=task,
            hold=hold,
            tally=np.array([len(drawn), closed, len(hands.rows), (score > 0).sum(), *hits.sum(axis=0)]),
        )
        kind = "wraps" if wraps(drawn) else "candidates"
        best = f"; best margin {score.max():.2f}" if len(score) else ""
        words = f"%d {kind}: %d closed, %d clear of obstacles and rules, %d balance the load{best}"
        _log.info(words, *found.tally[:4])
        return found.take(np.argsort(-score, kind="stable"))

    def _lifted(self, hands: ClosedCandidates, hits: BoolArray) -> tuple[ClosedCandidates, BoolArray]:
        """The hands, those that only the table refuses moved away from it where that makes them clear.

        Contacts on a thin object lie so near to the table that hardly a hand that is drawn around them is
        clear of it.

        Args:
            hands: k hands that closed.
            hits: (k, m) the blockers that refuse each; the table is the first.
        """
        rows = np.flatnonzero(hits[:, 0] & ~hits[:, 1:].any(axis=1))
        low = hands.take(rows)
        shift = self.blockers.above_table(low.candidates, low.grasp)
        near = np.flatnonzero((shift**2).sum(axis=1) < LIFTED**2)
        low, rows = low.take(near), rows[near]
        again = self._closed(replace(low.candidates, place=low.candidates.place + shift[near]))
        refused = self.blockers.refuse(again.closings, again.candidates, again.grasp)
        clear = np.flatnonzero(~refused.any(axis=1))
        again, replaced = again.take(clear), rows[again.rows[clear]]
        again = again._replace(rows=hands.rows[replaced])
        kept = np.setdiff1d(np.arange(len(hits)), replaced)
        return hands.take(kept).joined(again), np.concatenate([hits[kept], refused[clear]])

    def _closed(self, candidates: Candidates) -> ClosedCandidates:
        """The candidates that close on the object, none of whose contacts is on a lid."""
        if len(candidates) and candidates.mask[0] & WRAP:
            return self._wrapped(candidates)
        rows, closings = self.kernel.closed(candidates, wanted=MIN_CONTACTS)
        if self.query is not None and self.query.is_lid.any():
            on_lid = np.arange(closings.points.shape[1]) < closings.counts[:, None]  # those in use, so far
            on_lid[on_lid] = self.query.is_lid[self.query.closest(closings.points[on_lid]).triangle]
            keep = np.flatnonzero(~on_lid.any(axis=1))
            rows, closings = rows[keep], closings.take(keep)
        hands = candidates.take(rows)
        _, links = touching_spheres(self.tables, closings)
        grasp = posture_at(self.tables, hands.start, closings.closing)
        return ClosedCandidates(rows, closings, hands, grasp, links)

    def _wrapped(self, candidates: Candidates) -> ClosedCandidates:
        """The same for wraps; their contacts are exact already."""
        if self.query is None:
            raise ValueError("wraps need the object's surface")
        hands = closed_hands(self.tables, self.query, *self.wrapper.close(candidates, back=WRAP_BACK))
        rows = np.flatnonzero(hands.real)
        rows = rows[[self._links_apart(q) for q in hands.grasp[rows]]] if len(rows) else rows
        hands, n = hands.take(rows), len(rows)
        closings = Closings(
            fate=np.full(n, Fate.CLOSED, dtype=np.int64),
            closing=np.zeros((n, len(self.tables.fingers))),
            sphere=np.full((n, len(self.tables.fingers)), -1, dtype=np.int64),
            points=hands.points,
            normals_in=hands.normals_in,
            counts=hands.counts,
        )
        return ClosedCandidates(rows, closings, hands.candidates, hands.grasp, hands.links)

    def _links_apart(self, q: Array) -> bool:
        """Whether no two links of the hand overlap; fingers that go round an object may meet each other."""
        self._kinematics.set_posture(q)
        return not self._kinematics.collides(WRAP_GAP)

    def strengths(
        self, closings: Closings | ClosedHands, demand: Demand, *, ranking: bool = False, least: float = 0.0
    ) -> tuple[Array, Array]:
        """(n,), (n,) strength along the task's cone and of plain holding, per unit of normal force.

        Args:
            closings: Contacts of candidates that closed.
            demand: What the grip must produce.
            ranking: Whether the strength of plain holding need be exact only where it can lower the score.
            least: Scores up to this need not be exact.
        """
        if not len(closings.counts):
            return np.zeros(0), np.zeros(0)
        contacts = closings.points, closings.normals_in, closings.counts
        kernel = self._task_kernel(demand)
        task, floor = None, least * self.settings.hold
        if kernel is not None:
            unit = demand.unit(self.length)
            task = kernel.strengths(*contacts, unit, self.cog, least=least * demand.load)
        hold: Array | float = math.inf
        if task is not None and ranking:
            hold = task / demand.load * self.settings.hold
        for lever, kernel in self._hold_kernels:
            hold = kernel.strengths(*contacts, lever, self.cog, most=hold, least=floor)
        return np.asarray(hold if task is None else task), np.asarray(hold)

    def thorough_strengths(self, closings: ClosedHands, demand: Demand, press: Array) -> Array:
        """(n,) strength along the task's cone, by a search that takes ten times as long and misses less.

        Args:
            closings: Contacts of candidates that closed.
            demand: What the grip must produce.
            press: (n,) sum of normal forces that carries the weight [N].
        """
        kernel = self._task_kernel(demand, thorough=True)
        if kernel is None:
            return self.strengths(closings, demand)[0]
        strength, unit = np.zeros(len(press)), demand.unit(self.length)
        for carrying in np.unique(press):  # mostly all the same
            rows = np.flatnonzero(press == carrying)
            part = closings.take(rows)
            base = demand.base * (self.settings.middling / carrying)
            strength[rows] = kernel.strengths(
                part.points, part.normals_in, part.counts, unit, self.cog, base=base
            )
        return strength

    def strength_of(self, grip: Grip, demand: Demand, weight: float) -> float:
        """Strength of one grip along the task's cone, per newton of press, by the thorough search.

        Args:
            grip: The grip; only its contacts count.
            demand: What the task asks.
            weight: Weight of the object divided by the press that carries it.
        """
        kernel = self._task_kernel(demand, thorough=True)
        if kernel is None:
            return math.inf
        usual, n = self.settings.weight / self.settings.middling, len(grip.contacts.points)
        points, normals = np.zeros((1, CONTACTS, 3)), np.zeros((1, CONTACTS, 3))
        points[0, :n], normals[0, :n] = grip.contacts.points, grip.contacts.normals_in
        base = np.asarray(demand.base) * (weight / usual)
        unit = demand.unit(self.length)
        return float(kernel.strengths(points, normals, np.array([n]), unit, self.cog, base=base)[0])

    def holding(self, share: float) -> list[tuple[float, MarginKernel]]:
        """Levers [m] and kernels of plain holding with a share of the friction."""
        return [(lever, self._margin_kernel(wrenches, share=share)) for lever, wrenches in self._pushes]

    def cone(
        self, demand: Demand, share: float | None = None, *, thorough: bool = True
    ) -> MarginKernel | None:
        """The kernel of a demand's cone with a share of the friction; ``None`` for plain holding.

        Args:
            demand: What the task asks.
            share: The share; by default the settings'.
            thorough: Whether to search longer and miss less.
        """
        if demand.direction is None:
            return None
        return self._margin_kernel(
            demand.direction[None],
            share=share,
            base=demand.base,
            half_angle=demand.half_angle,
            thorough=thorough,
        )

    def _margin_kernel(self, wrenches: Array, *, share: float | None = None, **cone: Any) -> MarginKernel:
        s = self.settings
        share = s.friction_share if share is None else share
        return MarginKernel(
            wrenches,
            friction=s.friction * share,
            torsion=s.torsion * share,
            device=s.device,
            threads=s.threads,
            **cone,
        )

    def _task_kernel(self, demand: Demand, *, thorough: bool = False) -> MarginKernel | None:
        """The kernel of a demand's cone, ``None`` for plain holding; that of the last demand is cached."""
        if thorough not in self._task_kernels or self._task_kernels[thorough][0] is not demand:
            self._task_kernels[thorough] = demand, self.cone(demand, thorough=thorough)
        return self._task_kernels[thorough][1]

    def score(self, task: Array, hold: Array, demand: Demand) -> Array:
        """(n,) strength divided by expected load; the smaller of the task's and plain holding's ratio."""
        return np.minimum(task / demand.load, hold / self.settings.hold)

    def half_clear(
        self, rng: np.random.Generator, drawn: DrawnCandidates, found: RankedCandidates
    ) -> DrawnCandidates:
        """Where there are obstacles, replace half of new candidates by some around hands clear of them.

        Few hands are clear of a table under a flat object, and those around them often are too.

        Args:
            rng: Random generator.
            drawn: New candidates.
            found: Candidates that are clear, with any score.
        """
        if not len(self.settings.obstacles) or not len(found):
            return drawn
        half = len(drawn) // 2
        clear = found.take(rng.permutation(len(found))[:CLEAR])
        children = max(1, half // len(clear))
        near = self.perturbed(rng, clear, children, 1.0, shift=CLEAR_SHIFT, turn=CLEAR_TURN)
        return concatenated(near, drawn.take(rng.permutation(len(drawn))[:half]))

    def perturbed(
        self,
        rng: np.random.Generator,
        parents: RankedCandidates,
        children: int,
        spread: float,
        *,
        shift: float | None = None,
        turn: float | None = None,
    ) -> DrawnCandidates:
        """Candidates near given ones: wrist and preshape change a little at random.

        Args:
            rng: Random generator.
            parents: Candidates to start from.
            children: Number of candidates near each parent.
            spread: Factor on the standard deviations of the first refinement.
            shift: Standard deviation of the wrist's position [m]; replaces that of the first refinement.
            turn: Standard deviation of the wrist's rotation [rad]; replaces that of the first refinement.
        """
        from scipy.spatial.transform import Rotation

        rows = np.repeat(np.arange(len(parents)), children)
        copies = parents.drawn.take(rows)
        n = len(rows)
        counts = parents.closings.counts[rows]
        points = parents.closings.points[rows]
        valid = np.arange(points.shape[1]) < counts[:, None]
        # The hand turns about its contacts: a small turn about the wrist would already miss the object.
        middle = np.where(valid[:, :, None], points, 0.0).sum(axis=1) / counts[:, None]
        rotation = Rotation.from_rotvec(rng.normal(0.0, TURN * spread if turn is None else turn, (n, 3)))
        place = rotation.apply(copies.candidates.place - middle) + middle
        place += rng.normal(0.0, STEP * spread if shift is None else shift, (n, 3))
        commands = copies.candidates.start @ self.tables.command.T
        commands += rng.normal(0.0, BEND * spread, commands.shape)
        rotation = rotation * Rotation.from_quat(copies.candidates.turn, scalar_first=True)
        return replace(
            copies,
            candidates=Candidates(
                place=place,
                turn=rotation.as_quat(scalar_first=True),
                start=posture_of(self.tables, np.clip(commands, *self.ranges)),
                mask=copies.candidates.mask,
            ),
        )

    def refine(
        self,
        rng: np.random.Generator,
        found: RankedCandidates,
        demand: Demand,
        *,
        elite: int,
        children: int,
        rounds: int,
        decay: float = DECAY,
    ) -> RankedCandidates:
        """Search near the best candidates.

        In each round, the elite set is the best candidates that differ from each other. Random variations of
        them, the children, are evaluated, and the best of parents and children enter the next round. The
        least difference and the spread of the children shrink from round to round.

        Args:
            rng: Random generator.
            found: Candidates, best first.
            demand: What the grip must produce.
            elite: Size of the elite set; four times as many candidates enter the next round.
            children: Number of children of each candidate in the elite set.
            rounds: Number of rounds.
            decay: Factor by which the spread of the children shrinks from round to round.
        """
        best, most = found, 4 * elite
        for k in range(rounds):
            if not len(best):
                break
            parents = best.take(distinct(best, elite, 1.0 / (k + 1)))
            # A child that cannot enter the next round needs no exact score.
            least = float(best.score[most - 1]) if len(best) >= most else 0.0
            nearby = self.perturbed(rng, parents, children, decay**k)
            best = merged(best, self.evaluate(nearby, demand, least=least), most=most)
        return best

    def steady(
        self,
        rng: np.random.Generator,
        found: RankedCandidates,
        demand: Demand,
        *,
        samples: int = 8,
        shift: float = 0.003,
        turn: float = 0.05,
    ) -> RankedCandidates:
        """Rank again under pose errors: a grip whose margin drops under small pose errors ranks lower.

        The new score is half the nominal score and half the mean over the worse half of the samples.

        Args:
            rng: Random generator.
            found: A few dozen candidates.
            demand: What the grip must produce.
            samples: Number of disturbed poses of each candidate.
            shift: Standard deviation of the wrist's position [m].
            turn: Standard deviation of the wrist's rotation [rad].
        """
        if not len(found):
            return found
        moved = self.perturbed(rng, found, samples, 0.0, shift=shift, turn=turn)
        hands, score = self._closed(moved.candidates), np.zeros(len(moved))
        broken = self.blockers.misplaced(hands.closings)
        hands = hands.take(np.flatnonzero(~broken.any(axis=1)))
        nominal = self.score(*self.strengths(hands.closings, demand, ranking=True), demand)
        score[hands.rows] = self._torques.score(hands, nominal, demand)
        sorted_scores = np.sort(score.reshape(len(found), samples), axis=1)
        expected = 0.5 * (found.score + sorted_scores[:, : max(1, samples // 2)].mean(axis=1))
        return replace(found, score=expected).take(np.argsort(-expected, kind="stable"))
