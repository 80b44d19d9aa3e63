"""The closure analyser: a performance element that closes the real hand instead of casting rays (ENGINE §2).

It has the interface of the ray analyser. An aim is a set of approach planes, approach values and numbers of
fingers. The analyser draws candidates within the aim, closes them, ranks them by their margin for the task
and refines the best. Those that differ from each other are finished, and TFVADI is computed for each.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from ..exceptions import InputError
from ..hands.hand import Hand
from ..hiis.analyser import Aim, Grasp, Grip, HandLayout
from ..hiis.fuzzy import FuzzySets
from ..kernels.field.host import SurfaceQuery, prepare_field
from ..objects.mesh import TriangleMesh
from ..types import ANSWER_KIND, Array, ContactCoefficients, Experience, IntArray, frozen_array
from .aiming import ENOUGH_MARGIN, AimDraws, aim_draws
from .calibration import WHOLE, pick_critic, unlikely
from .candidates import DrawnCandidates, RankedCandidates, distinct, merged, without_failed
from .contact_places import allowed_surface
from .demand import Demand, inner_centre, task_demand, turn_levers
from .finish import ENOUGH, INSIDE, OVERLAP, FinishedGrip, Finisher, FinishOptions
from .grips import GripExploration, described, grip_exploration, of_both_kinds
from .limits import LOAD, costliest, heaviest_mass, nothing_left, remedy, rules_cost, shortfall, why_none
from .pinching import THINNEST
from .recall import FEW_VALUES, on_object, recalled
from .rules import breaks
from .search import ClosureSearch
from .settings import ClosureSettings
from .wrap_search import best_margin, best_wraps
from .wrapping import families, wraps

STILL_GOOD = 0.95
"""Mode 0 answers with a recalled grip that still has this share of its stored quality [C]."""
RECALL_EXAMINED, RECALL_FINISHED = 8, 2
"""Number of recalled grips that are examined, and of the best of these that are finished [C]."""
REFUSED_EXAMINED = 24
"""Number of refused candidates that are examined to show the best of them [C]."""
_CACHED_AIMS = 24


class ClosureAnalyser:
    """Grips of one object with one real hand.

    Args:
        mesh: The object.
        hand: The hand.
        layout: What the controller knows of the hand.
        settings: Friction, load, size of the search.
        coefficients: The paper's contact model, for TFVADI.
        sets: Membership functions.
        gravity: (3,) unit direction of gravity in the mesh frame; zeros mean no gravity.
        seed: Seed of every random draw; the same seed gives the same grips.
        known: Function that returns the experiences of this hand; their grips may be recalled.
        scene: The scene of the request. Mode 0 recalls grips of this scene only; the wider searches try
            stored grips of any scene, those of another model of the hand among them.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        hand: Hand,
        layout: HandLayout,
        *,
        settings: ClosureSettings | None = None,
        coefficients: ContactCoefficients | None = None,
        sets: FuzzySets | None = None,
        gravity: Array | Sequence[float] = (0.0, 0.0, -1.0),
        seed: int = 0,
        known: Callable[[], Sequence[Experience]] = tuple,
        scene: str = "",
    ) -> None:
        self.mesh, self.hand, self.layout = mesh, hand, layout
        self.settings = settings or ClosureSettings()
        self.coefficients = coefficients or ContactCoefficients()
        self.sets = sets or FuzzySets()
        self.gravity = np.asarray(gravity, dtype=np.float64)
        self.seed, self._known, self.scene = seed, known, scene
        self.field = prepare_field(mesh)
        self.query = SurfaceQuery(mesh, device=self.settings.device)
        self.middle = inner_centre(self.field, mesh)
        length = float(mesh.extents.max()) / 2
        self.search = ClosureSearch(
            hand,
            self.field,
            self.middle,
            length,
            self.settings,
            turns=turn_levers(mesh, self.middle, length),
            query=self.query,
        )
        places = self.search.blockers.places
        self.allowed = allowed_surface(mesh, places) if places else None
        self.finisher = Finisher(self.search, self.query)
        self.critic = pick_critic(self.search, mesh)
        self._cache: dict[bytes, GripExploration] = {}
        self._explored: set[bytes] = set()  # tasks for which all allowed planes have been searched
        self._tallies: dict[bytes, IntArray] = {}  # of the searches of all planes, by task
        self._last_demand: tuple[bytes, Demand] | None = None
        self._bold: ClosureAnalyser | None = None

    measure = "the grip's quality (3 is just enough)"
    patience = 8

    @cached_property
    def draws(self) -> AimDraws:
        """Draws candidates. It is made when a search begins, because a recalled answer needs none."""
        return aim_draws(self.search, self.mesh, self.allowed)

    def forget(self) -> None:
        """Clear the cache of aims, so that the next one is searched again."""
        self._cache.clear()
        self._explored.clear()
        self._tallies.clear()
        if self._bold is not None:
            self._bold.forget()

    @property
    def tried(self) -> int:
        """Number of candidates closed for all aims in the cache."""
        return sum(found.tried for found in self._cache.values())

    def demand(self, q: Array) -> Demand:
        """What a task asks of a grip: a wrench, the load along that wrench, and the object's weight.

        The last demand is cached, because the search caches kernels for that very object.
        """
        if self._last_demand is None or self._last_demand[0] != q.tobytes():
            weight = self.gravity * self.settings.weight / self.settings.middling
            self._last_demand = q.tobytes(), task_demand(q, weight)
        return self._last_demand[1]

    def explore(self, q: Array, aim: Aim) -> GripExploration:
        """The best grips of an aim for a task, best first; every one of them can be executed.

        Args:
            q: (6,) task Q.
            aim: Where to look.

        Raises:
            InputError: A plane, finger count or approach value that does not exist.
        """
        task = frozen_array(q, (6,), "task Q")
        aim.check()
        if not all(len(part) for part in (aim.planes, aim.values, aim.fingers, aim.flips)):
            raise InputError(f"an aim needs at least one plane, value, number of fingers and flip, got {aim}")
        key = task.tobytes() + _key(aim)
        one_plane = len(aim.planes) == 1
        unexplored = one_plane and not self._is_explored(task)
        if one_plane:  # stored grips are tried first, and the memory may have grown since the last call
            key += len(self._known()).to_bytes(8, "little") + bytes([unexplored, *aim.recall])
        if key not in self._cache:
            if len(self._cache) >= _CACHED_AIMS:
                del self._cache[next(iter(self._cache))]
            found = self._explore(task, aim, unexplored)
            if not unexplored and _best_quality(found.grips) < ENOUGH:
                found = self._boldly(task, aim, found)
            self._cache[key] = found
        if not one_plane:
            self._explored.add(task.tobytes())
        return self._cache[key]

    def recall(self, q: Array, lessons: Sequence[Experience]) -> list[Grip]:
        """The stored grips of this same object and task, finished again for the current request.

        Args:
            q: (6,) task Q.
            lessons: Experiences of this object and this hand.
        """
        own = [e for e in lessons if e.grip is not None and len(e.grip) == 8 + len(self.hand.joints)]
        if not own:
            return []
        task = frozen_array(q, (6,), "task Q")
        demand, unexplored = self.demand(task), not self._is_explored(task)
        options = FinishOptions(count=len(own), unexplored=unexplored, firm=not unexplored)
        finished = list[FinishedGrip]()
        for family in self._wanted(on_object(own, self.mesh, self.hand)):
            finished += self.finisher.finish(self.search.evaluate(family, demand), demand, options)
        found = self.grips(task, finished)
        if not unexplored and _best_quality(found) < ENOUGH and (bolder := self._bolder) is not None:
            found = [*self._with_more_friction(q, found), *found]
            if _best_quality(found) < ENOUGH:
                found = [*bolder._with_more_friction(q, bolder.recall(q, lessons)), *found]
        return found

    @property
    def _bolder(self) -> ClosureAnalyser | None:
        """The same analyser with a larger share of the friction; ``None`` if the settings' is not larger.

        On a table it is the whole friction, because there the critic knows how probably a grip holds.
        """
        settings = self.settings
        if self._bold is None and settings.bold_share > settings.friction_share:
            share = settings.bold_share if self.critic is None else WHOLE
            self._bold = ClosureAnalyser(
                self.mesh,
                self.hand,
                self.layout,
                settings=replace(settings, friction_share=share),
                coefficients=self.coefficients,
                sets=self.sets,
                gravity=self.gravity,
                seed=self.seed,
                known=self._known,
                scene=self.scene,
            )
        return self._bold

    def _boldly(self, q: Array, aim: Aim, found: GripExploration) -> GripExploration:
        """Where no grip is good enough, the grips that are with the larger share of the friction come first.

        On a table, a grip that was found already may be good enough for the critic. Then nothing is searched.
        """
        if self._bolder is None or (self.allowed is not None and not len(self.allowed)):
            return found
        bold, tried = self._with_more_friction(q, found.grips), found.tried
        if _best_quality(bold) < ENOUGH:
            other = self._bolder._explore(q, aim, unexplored=False)
            bold, tried = self._bolder._with_more_friction(q, other.grips), tried + other.tried
        enough = [grip for grip in bold if grip.quality >= ENOUGH]
        if not enough and (found.grips or not bold):
            return replace(found, tried=tried)
        return grip_exploration([*enough, *found.grips] or bold, tried)

    def _with_more_friction(self, q: Array, grips: Sequence[Grip]) -> list[Grip]:
        """The grips that balance the load with a larger share of the friction than usual.

        Whatever their margins, they are just enough at most: their reserve for errors of friction is smaller.
        """
        if self.critic is not None:
            return self.critic.with_more_friction(grips, self.demand(q), self.settings.bold_share)
        if self.settings.friction_share < self.settings.bold_share:
            return []
        return [replace(grip, quality=ENOUGH) for grip in grips if grip.quality >= ENOUGH]

    def _wanted(self, drawn: DrawnCandidates) -> list[DrawnCandidates]:
        """The families among candidates that the settings' grasp type allows."""
        kind = self.settings.grasp_type
        return [family for family in families(drawn) if kind == "any" or wraps(family) == (kind == "power")]

    def heaviest(self, q: Array, grasp: Grasp) -> float | None:
        """Heaviest mass for which a grip would still be good enough for the task [kg]."""
        if not isinstance(grasp, Grip):
            return None
        if self._bold is not None and grasp.friction_share > self.settings.friction_share:
            return self._bold.heaviest(q, grasp)
        return heaviest_mass(self.search, grasp, self.demand(frozen_array(q, (6,), "task Q")))

    def shortfall(self, q: Array, grasp: Grasp) -> str:
        """What a grip lacks and what would help; an empty text for a virtual grasp."""
        if not isinstance(grasp, Grip):
            return ""
        task = frozen_array(q, (6,), "task Q")
        lacking = unlikely(grasp) or shortfall(self.search, grasp, self.demand(task))
        return lacking + rules_cost(self._tallies.get(task.tobytes()), self.settings)

    def grips(self, q: Array, finished: Sequence[FinishedGrip]) -> list[Grip]:
        """Finished grips with the paper's figures: net wrench, TFVADI and screw measures.

        Args:
            q: (6,) task Q.
            finished: Grips of this analyser's finisher.
        """
        if not finished:
            return []
        triangles = self.query.closest(np.concatenate([grip.points for grip in finished])).triangle
        ends = np.cumsum([len(grip.points) for grip in finished])[:-1]
        made = [
            described(grip, own, q, self.mesh, self.layout, self.coefficients, self.sets)
            for grip, own in zip(finished, np.split(triangles, ends), strict=True)
        ]
        return made if self.critic is None else self.critic.with_odds(made, self.demand(q))

    def _explore(self, q: Array, aim: Aim, unexplored: bool) -> GripExploration:
        """Search an aim.

        1. At an estimate (mode 0), try the stored grips first: those of the most similar object, then the
           others. If a stored grip is still nearly as good as when it was stored, it is the answer.
        2. Draw candidates and rank them. In a search of all planes (mode 3), draw more if too few close or
           the best margin is too small.
        3. Refine the best. Rank those that differ from each other again under pose errors.
        4. Finish the best.
        5. In a search of all planes, while the margin is too small: drop candidates similar to those that
           failed, draw others in their place, and repeat from 3.
        6. If the fingertips are not far stronger than needed, or answers of both kinds are wanted, search
           wraps of the whole hand as well. The settings' grasp type may leave out one of the kinds.
        7. If everything has been searched and no grip is good enough, allow a firm press.
        8. In the wider searches, finish the best stored grips that lie in the aim, too. They stay apart from
           the candidates: what the memory holds must not make a search find less.
        9. Sort by quality. If there is no grip, find the nearest miss, and report why the candidates failed
           and what would help against the rule that refused most of them.
        """
        size = float(self.mesh.extents.max())
        if size < THINNEST:
            return grip_exploration(
                [],
                0,
                f"the object is {1e3 * size:.2g} mm long, and fingers can be placed on "
                f"{1e3 * THINNEST:.0f} mm or more; check its unit",
            )
        if self.allowed is not None and not len(self.allowed):
            return grip_exploration([], 0, nothing_left(self.settings.rules))
        demand, settings, one_plane = self.demand(q), self.settings, len(aim.planes) == 1
        at_estimate = one_plane and len(aim.values) <= FEW_VALUES
        effort = settings.effort(one_plane, at_estimate)
        lessons = [e for e in self._known() if e.scene == self.scene] if at_estimate else self._known()
        known = recalled(lessons, self.mesh, q, aim, hand=self.hand, sets=self.sets)
        # 1. Stored grips.
        remembered, tried = list[FinishedGrip](), 0
        if at_estimate and known is not None:
            for rows in np.split(np.arange(len(known.drawn)), [known.first]):
                tried += len(rows)
                remembered += self._finish_recalled(known.drawn.take(rows), demand, aim, unexplored)
                best_known = max(remembered, key=lambda grip: grip.quality, default=None)
                bar = max(STILL_GOOD * known.best_quality, ENOUGH)
                if best_known is not None and best_known.quality >= bar:
                    return grip_exploration(self.grips(q, [best_known]), tried)
        # 2. Candidates.
        rng = np.random.default_rng([self.seed, zlib.crc32(_key(aim))])
        options = FinishOptions(count=effort.grips, planes=aim.planes, unexplored=unexplored)
        power, precision = (settings.grasp_type == kind for kind in ("power", "precision"))
        drawn = self.draws.grips(rng, aim, 0 if power else effort.candidates)
        found = self.search.evaluate(drawn, demand)
        if not one_plane and not power:
            found = self.draws.more(rng, aim, found, demand, settings.persistence)
        finished, source, pool = list[FinishedGrip](), found, found
        last = -1 if power else 0 if one_plane else settings.persistence
        for k in range(1 + last):
            # 3. Refinement.
            found = self.search.refine(
                rng, found, demand, elite=effort.elite, children=settings.children, rounds=effort.rounds
            )
            examined = found.take(distinct(found, max(8, 4 * effort.grips)))
            examined = self.search.steady(rng, examined, demand, samples=effort.samples)
            # 4. Finish. The ranking ignores the joint limits; after a first failure they decide the order.
            grips = self.finisher.finish(examined, demand, replace(options, by_joints=k > 0))
            if k == 0 or best_margin(grips) > best_margin(finished):
                finished, source = grips, examined
            if best_margin(finished) >= ENOUGH_MARGIN or k == last:
                break
            # 5. Otherwise the search could keep refining one group of candidates that the hand cannot reach.
            if len(grips) < effort.grips:
                executable = [grip.row for grip in grips]
                found = without_failed(found, examined, executable)
                more = self.draws.more(rng, aim, without_failed(pool, examined, executable), demand, 1)
                fresh = replace(more, tally=more.tally - pool.tally)
                found, pool = merged(found, fresh), more
        # 6. Wraps.
        wrapped, tally = list[FinishedGrip](), found.tally
        strong = best_margin(finished) >= ENOUGH_MARGIN and not (settings.both and not one_plane)
        if power or (settings.wraps and not precision and not at_estimate and not strong):
            wrapped, closed = best_wraps(self.search, self.draws, self.finisher, rng, aim, demand, options)
            tally = tally + closed.tally
            if power:
                found = source = closed
            else:
                tried += closed.tried
        # 7. Firm press.
        if not power and not unexplored and max(best_margin(finished), best_margin(wrapped)) < 1.0:
            finished = self.finisher.finish(source, demand, replace(options, by_joints=True, firm=True))
        # 8. Stored grips in the aim.
        if known is not None and not at_estimate:
            aimed = known.drawn.take(np.flatnonzero(known.aimed))
            tried += len(aimed)
            gentle = unexplored or max(best_margin(finished), best_margin(wrapped)) >= 1.0
            remembered += self._finish_recalled(aimed, demand, aim, gentle)
        # 9. Answer.
        every = sorted([*remembered, *finished, *wrapped], key=lambda grip: -grip.margin)
        answers = self.grips(q, every)
        answers.sort(key=lambda grip: -grip.judged)
        if power:
            answers = [grip for grip in answers if grip.whole_hand]
        best = of_both_kinds(answers, effort.grips)
        reason, miss = "" if answers else why_none(found, settings), None
        if not one_plane:
            self._tallies[q.tobytes()] = tally
        if not answers and not one_plane:
            rules = costliest(found, self.search.blockers.names)
            draw = self.draws.any_wraps if power else self.draws.grips
            drawn = draw(rng, aim, effort.candidates)
            miss = self._nearest_miss(q, source, drawn, demand, aim, rules)
            reason += remedy(rules, miss)
        return grip_exploration(best, tried + found.tried, reason, miss)

    def _nearest_miss(
        self,
        q: Array,
        found: RankedCandidates,
        drawn: DrawnCandidates,
        demand: Demand,
        aim: Aim,
        rules: Sequence[str],
    ) -> Grip | None:
        """The best grip that was refused, as an example of what is lacking.

        The rule that refused most candidates selects it: if it is the load, a grip that the hand can execute
        comes first; if it is an obstacle or a contact rule, the grip is one that collides with it or breaks
        it.

        Args:
            q: (6,) task Q.
            found: The best candidates that are clear of the obstacles.
            drawn: Candidates from which colliding ones are selected.
            demand: What the task asks.
            aim: Where the search was.
            rules: What refused candidates, the costliest first.
        """
        options = FinishOptions(count=REFUSED_EXAMINED, planes=aim.planes, anyway=True)
        names = self.search.blockers.names
        for rule in rules:
            likely = found
            if rule in names:
                likely = self.search.evaluate(drawn, demand, blocked=names.index(rule))
            elif rule == LOAD:
                likely = found.take(np.argsort(-found.hold, kind="stable"))
            grips = self.finisher.finish(likely.take(distinct(likely, REFUSED_EXAMINED)), demand, options)
            if rule in names:
                lawless = rule in self.settings.rules.names
                clause = breaks(rule) if lawless else f"{rule} is in the closed hand's way"
                grips = [replace(g, refused=clause) for g in grips if g.refused not in (INSIDE, OVERLAP)]
            if grips:
                best = max(grips, key=lambda g: (not g.refused, g.refused not in (INSIDE, OVERLAP), g.margin))
                return self.grips(q, [best])[0]
        return None

    def _finish_recalled(
        self, known: DrawnCandidates, demand: Demand, aim: Aim, unexplored: bool
    ) -> list[FinishedGrip]:
        """Turn recalled candidates into grips of this object; with a firm press if all has been searched."""
        if not len(known):
            return []
        options = FinishOptions(
            count=RECALL_FINISHED,
            planes=sorted({*aim.planes, *aim.recall}),
            unexplored=unexplored,
            firm=not unexplored,
        )
        finished = list[FinishedGrip]()
        for family in self._wanted(known):
            found = self.search.evaluate(family, demand)
            examined = found.take(distinct(found, RECALL_EXAMINED))
            finished += self.finisher.finish(examined, demand, options)
        return finished

    def _is_explored(self, q: Array) -> bool:
        """Whether all planes have been searched for a task, by this analyser or at teaching."""
        task, extents = q.tobytes(), self.mesh.attributes.extents
        return task in self._explored or any(
            e.kind != ANSWER_KIND
            and e.scene == self.scene
            and e.task.tobytes() == task
            and np.allclose(e.attributes.extents, extents, rtol=1e-6)
            for e in self._known()
        )


def _best_quality(grips: Sequence[Grip]) -> float:
    return max((grip.quality for grip in grips), default=0.0)


def _key(aim: Aim) -> bytes:
    """An aim as bytes; the same bytes draw the same candidates."""
    parts = (aim.planes, np.round(np.asarray(aim.values, dtype=np.float64), 9), aim.fingers, aim.flips)
    return b"|".join(np.asarray(part, dtype=np.float64).tobytes() for part in parts)
