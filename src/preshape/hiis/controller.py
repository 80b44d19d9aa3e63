"""The controller: four execution modes, tried in order (§3.6, fig. 9-10).

::

    mode 0  estimate, analyse             ── reward ──> answer
       │ penalty
    mode 1  search the estimated plane    ── reward ──> answer
       │ penalty
    mode 2  is the object known?          ── yes ─────> ask for task correction, offer tasks that fit
       │ no, or with a real hand
    mode 3  explore, learn, self-test     ── reward ──> answer
       │ penalty
    deadlock, until meta control resets it

A real hand explores a known object too, before it says that the task does not fit [C]: exploring costs less
than a second, and a task must not be refused because another one was taught before.

Only this module combines the parts of the system; each of them can be used and tested alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..exceptions import InputError
from ..memory import Memory
from ..objects.mesh import TriangleMesh
from ..objects.shape import described
from ..tasks import Task, all_named_tasks
from ..types import ANSWER_KIND, Array, Attributes, BoolArray, Experience, NetworkWeights
from .analyser import Aim, Analyser, Exploration, Grasp, Grip, HandLayout
from .critic import (
    SLACK,
    Recognition,
    Thresholds,
    Verdict,
    judge,
    of_this_object,
    recognise,
    recognise_shape,
)
from .decision import Decision, Offer, Settings, Status, Transition, decided, different_answers, reached
from .estimator import Estimate, InputKind, decode, inputs, predict
from .knowledge import Knowledge
from .learning import (
    Discovery,
    everywhere,
    explore,
    search_values,
    seed_cube,
)
from .lessons import best_first, of_this_mesh, well_learnt
from .planes import allowed_planes
from .virtual_grasp import RayAnalyser

STORED = 8
"""Largest number of stored grasps of one object and task that are evaluated again, best first."""
OFFERS = 3
"""Number of other tasks offered if no grasp fits the requested one."""


class Controller:
    """Hybrid intelligent inference for one hand and one memory.

    Args:
        memory: The memory; with ``memory.read_only`` nothing is added to it.
        layout: The hand.
        settings: The settings of meta control.
        prepare: Function that makes the performance element for an object; by default the ray analyser.
        prepare_seed: The same for the first lesson; by default ``prepare``.
        seed_object: The cube of the first lesson; by default that of the paper (:func:`.learning.seed_cube`).
        kind: Inputs that describe an object to the estimator and to recognition: ``paper``, or ``shape``,
            which does not depend on the triangulation.
        scene: Scene of the requests, as text. Lessons are stored with this scene, and an object counts as
            known only by lessons of the same scene.
        may_store: Whether the first lesson and newly trained weights are stored when the memory is read;
            False for a request that may not learn.

    Attributes:
        knowledge: What the hand has learnt, in main memory and on disk.
    """

    def __init__(
        self,
        memory: Memory,
        layout: HandLayout,
        *,
        settings: Settings | None = None,
        prepare: Callable[[TriangleMesh], Analyser] | None = None,
        prepare_seed: Callable[[TriangleMesh], Analyser] | None = None,
        seed_object: TriangleMesh | None = None,
        kind: InputKind = "paper",
        scene: str = "",
        may_store: bool = True,
    ) -> None:
        self.memory, self.layout = memory, layout
        self.settings = settings or Settings()
        self.deadlock = False
        self._prepare = prepare or self.ray_analyser
        self._kind: InputKind = kind
        self._described: tuple[TriangleMesh, Attributes] | None = None
        first = prepare_seed or self._prepare
        self.knowledge = Knowledge(
            memory,
            layout,
            self.settings,
            kind=kind,
            scene=scene,
            first_lesson=lambda: first(seed_object or seed_cube(layout)),
            may_store=may_store,
        )

    @property
    def weights(self) -> NetworkWeights:
        """The current weights of the approach estimator."""
        return self.knowledge.weights

    @property
    def experiences(self) -> tuple[Experience, ...]:
        """All experiences of this hand; see :class:`.knowledge.Knowledge`."""
        return self.knowledge.experiences

    def ray_analyser(self, mesh: TriangleMesh) -> RayAnalyser:
        """The paper's performance element for an object."""
        s = self.settings
        return RayAnalyser(mesh, self.layout, coefficients=s.coefficients, sets=s.sets)

    def prepare(self, mesh: TriangleMesh) -> Analyser:
        """The performance element for an object; one element serves several tasks."""
        return self._prepare(mesh)

    def run(
        self,
        target: TriangleMesh | Analyser,
        task: Task,
        *,
        approaches: str | None = None,
        count: int = 1,
        may_learn: bool = True,
    ) -> Decision:
        """Find a preshape: modes 0 to 3, in order, until the critic rewards one.

        Args:
            target: The object, or its prepared performance element.
            task: What the hand is to do with the object.
            approaches: Allowed approach axes, such as ``+z,-x``; all by default.
            count: Number of different answers wanted.
            may_learn: Whether mode 3 may store lessons, and modes 0 and 1 grips of a real hand.

        Raises:
            InputError: An argument is wrong, or an earlier deadlock was not reset.
            ObjectError: The object does not fit the hand.
        """
        if self.deadlock:
            raise InputError("the controller is in deadlock: call reset() and ask for another task or object")
        if count < 1:
            raise InputError(f"the number of answers must be at least 1, got {count}")
        allowed = allowed_planes(approaches)
        pa = self._prepare(target) if isinstance(target, TriangleMesh) else target
        steps: list[Transition] = []

        self.knowledge.renew(pa, may_learn=may_learn)
        stored = self._best_stored(pa, task, allowed)
        estimate, grasp, verdict = self._mode_0(pa, task.q, allowed, stored)
        steps.append(_step(0, verdict))
        if not verdict.reward:
            grasp, verdict = self._mode_1(pa, task.q, estimate)
            grasp, verdict = self._better_of(pa, grasp, stored, verdict)
            if not verdict.reward:
                grasp, verdict = self._where_taught(pa, task, allowed, estimate, grasp, verdict)
            steps.append(_step(1, verdict))
        if verdict.reward and grasp is not None:
            if may_learn and grasp is not stored:
                self.knowledge.store_grip(pa, task, grasp)
            return self._answer(pa, task, len(steps) - 1, grasp, steps, allowed, count, estimate)

        recognition = self._mode_2(pa)
        steps.append(_step(2, recognition.verdict, met="known", missed="unknown"))
        known = recognition.verdict.reward and bool(of_this_object(self._well_learnt(), pa.mesh))
        if known and self._settled(pa, task, allowed):
            limited = f"; approaches allowed: {approaches}" if approaches is not None else ""
            searched = f"on the planes that were searched, {verdict.reason}{limited}"
            steps[-1] = replace(steps[-1], reason=_correction(recognition, searched))
            offers = self._offers(pa, task, allowed)
            return decided(task, 2, Status.CORRECTION, steps, estimate, best=grasp, offers=offers)
        decision = self._mode_3(pa, task, allowed, count, steps, may_learn, stored, grasp)
        if known and decision.grasp is None:
            self.deadlock = False
            reason = _correction(recognition, decision.reason)
            steps[-1] = replace(steps[-1], outcome="correction", reason=reason)
            offers = self._offers(pa, task, allowed)
            return decided(task, 3, Status.CORRECTION, steps, None, best=decision.best, offers=offers)
        return decision

    def teach(
        self, target: TriangleMesh | Analyser, task: Task, *, approaches: str | None = None
    ) -> Decision:
        """Learn an object and a task immediately (mode 3), whether the object is known or not."""
        pa = self._prepare(target) if isinstance(target, TriangleMesh) else target
        allowed = allowed_planes(approaches)
        self.knowledge.renew(pa, may_learn=True)
        return self._mode_3(pa, task, allowed, 1, [], True, self._best_stored(pa, task, allowed))

    def reset(self) -> None:
        """Reset a deadlock, as meta control does; the next run starts at mode 0."""
        self.deadlock = False

    def at_estimate(
        self, pa: Analyser, q: Array, estimate: Estimate, recall: Sequence[int] = ()
    ) -> Exploration:
        """The grasps that mode 0 chooses from, best first.

        They have the estimated plane and approach value, and the estimated number of fingers, or as many as
        fit there. Stored grips of real hands from similar objects, on the planes ``recall``, are added [C].
        """
        value = float(self.settings.sets.crisp()[estimate.approach_set])
        fingers = range(2, estimate.fingers + 1)
        aim = Aim(planes=[estimate.plane], values=[value], fingers=fingers, recall=recall)
        found = pa.explore(q, aim)
        return found.where(found.fingers == found.fingers.max()) if len(found) else found

    def on_plane(self, pa: Analyser, q: Array, estimate: Estimate) -> Exploration:
        """The grasps that mode 1 chooses from: all on the estimated plane, best first."""
        return self._on(pa, q, estimate.plane)

    def _on(self, pa: Analyser, q: Array, number: int) -> Exploration:
        """All grasps on one plane that the finger rule allows, best first."""
        found = pa.explore(q, Aim(planes=[number], values=search_values(self.settings.sets)))
        return found.with_fingers(self.settings.finger_rule)

    # The modes.

    def _best_stored(self, pa: Analyser, task: Task, allowed: BoolArray) -> Grasp | None:
        """The best stored grasp of this object, task and scene, evaluated again on the current mesh.

        A repeated request must never get a worse answer than the memory holds [C]. Grasps that lost the
        object in the physics test are left out.
        """
        own = of_this_mesh(self.knowledge.of_task(task, allowed), pa.mesh.attributes)
        found = pa.recall(task.q, best_first(own)[:STORED])
        return max(found, key=lambda grasp: grasp.judged, default=None)

    def _better_of(
        self, pa: Analyser, grasp: Grasp | None, stored: Grasp | None, verdict: Verdict
    ) -> tuple[Grasp | None, Verdict]:
        """The better of a grasp and the stored one, with the critic's verdict on the better one."""
        if stored is None or (grasp is not None and grasp.judged >= stored.judged - SLACK):
            return grasp, verdict
        found = "" if grasp is None else f"; the search found {grasp.judged:.2f}"
        again = judge(stored.judged, self.settings.thresholds.estimation, subject=f"known: {pa.measure}")
        return stored, replace(again, reason=again.reason + found)

    def _mode_0(
        self, pa: Analyser, q: Array, allowed: BoolArray, stored: Grasp | None = None
    ) -> tuple[Estimate, Grasp | None, Verdict]:
        """AE → PA: the best grasp at the estimate, or a better one that is stored.

        A stored virtual grasp replaces the estimated one only if the estimated one is good enough, so that
        the mode shows how good the estimate was, as in the paper.
        """
        x = inputs(q, self._attributes(pa), self.layout.u, self._kind)
        estimate = decode(predict(self.weights, x), allowed)
        if isinstance(stored, Grip):
            # Closing a hand takes time: the search runs only if the stored grip is not good enough.
            grasp, verdict = self._better_of(pa, None, stored, judge(None, 0.0))
            if verdict.reward:
                return estimate, grasp, verdict
        grasp, verdict = self._criticise(pa, q, self.at_estimate(pa, q, estimate, _indices(allowed)))
        if verdict.reward:
            grasp, verdict = self._better_of(pa, grasp, stored, verdict)
        return estimate, grasp, verdict

    def _mode_1(self, pa: Analyser, q: Array, estimate: Estimate) -> tuple[Grasp | None, Verdict]:
        """Search approach value, fingers and thumb side on the estimated plane."""
        return self._criticise(pa, q, self.on_plane(pa, q, estimate))

    def _where_taught(
        self,
        pa: Analyser,
        task: Task,
        allowed: BoolArray,
        estimate: Estimate,
        grasp: Grasp | None,
        verdict: Verdict,
    ) -> tuple[Grasp | None, Verdict]:
        """The rest of mode 1: search the planes on which this task was taught with this object.

        Mode 2 must never say that a task does not fit which was taught, and which a grasp on the taught plane
        still meets on the current mesh; that may be a finer triangulation of the object.
        """
        planes = {e.plane for e in self._taught(pa, task, allowed)} - {estimate.plane}
        for number in sorted(planes):
            other, found = self._criticise(pa, task.q, self._on(pa, task.q, number))
            if other is not None and (grasp is None or other.judged > grasp.judged + SLACK):
                reason = f"on plane {number}, where this task was taught: {found.reason}"
                grasp, verdict = other, replace(found, reason=reason)
        return grasp, verdict

    def _taught(self, pa: Analyser, task: Task, allowed: BoolArray) -> list[Experience]:
        """The lessons of this task with objects that may be this one, one of each grasp, the best first."""
        return best_first(of_this_object(self.knowledge.of_task(task, allowed), pa.mesh))

    def _well_learnt(self) -> list[Experience]:
        """The lessons that may refuse a task: of this scene, with objects that the hand holds for some task.

        A threshold above the usual one does not make a known object unknown.
        """
        enough = min(self.settings.thresholds.estimation, Thresholds().estimation)
        return well_learnt(self.experiences, self.knowledge.scene, enough)

    def _settled(self, pa: Analyser, task: Task, allowed: BoolArray) -> bool:
        """Whether mode 2 may end the run with a known object: with virtual grasps and a task not taught [R].

        A taught task that its grasp no longer meets is explored again, because a mesh may differ from the
        taught one within the tolerance of recognition.
        """
        threshold = self.settings.thresholds.estimation - SLACK
        return self._kind != "shape" and not any(
            e.judged >= threshold and not e.outdated for e in self._taught(pa, task, allowed)
        )

    def _mode_2(self, pa: Analyser) -> Recognition:
        """Whether the object is known."""
        s = self.settings
        if self._kind != "shape":
            lessons = [e for e in self.experiences if e.kind != ANSWER_KIND]
            return recognise(pa, lessons, s.thresholds.recognition, s.sets)
        here = self._attributes(pa)
        found = recognise_shape(here, self._well_learnt())
        if not found.verdict.reward:
            other = recognise_shape(here, self.experiences)
            if other.verdict.reward:
                reason = (
                    f"the memory knows {other.nearest} only with another load, friction, table, boxes or "
                    "model of the hand, by answers that were not taught, or with grips that are not good "
                    "enough"
                )
                return replace(found, verdict=replace(found.verdict, reason=reason))
        return found

    def _attributes(self, pa: Analyser) -> Attributes:
        """Attributes of the object that the estimator uses."""
        if self._kind == "paper":
            return pa.mesh.attributes
        if self._described is None or self._described[0] is not pa.mesh:
            self._described = (pa.mesh, described(pa.mesh))
        return self._described[1]

    def _mode_3(
        self,
        pa: Analyser,
        task: Task,
        allowed: BoolArray,
        count: int,
        steps: list[Transition],
        may_learn: bool,
        stored: Grasp | None,
        searched: Grasp | None = None,
    ) -> Decision:
        """Explore all allowed planes, learn, and self-test with the user's task: mode 0, then mode 1.

        1. Search all allowed planes; without a grasp, report the nearest miss. With a real hand, prefer a
           better grip that the closer search of one plane (mode 1) has ``searched``, or finds now.
        2. Learn what was found, and let the self-test judge it. If nothing may be learnt, or not all planes
           were allowed, judge the best grasp itself. A grip of a real hand that is not good enough is not
           learnt: it would teach the estimator where not to grasp, and the same request would search again
           from other weights [C].
        3. Prefer a better grasp that is stored for this object and task.
        4. If none is good enough, report a deadlock with the best of all that were found, ``searched`` by
           mode 1 among them.
        """
        threshold = self.settings.thresholds.estimation
        discovery = self._explore(pa, task, allowed)
        if discovery is None:
            found = pa.explore(task.q, everywhere(self.settings.sets, allowed))
            miss = found.nearest_miss
            lacking = "" if miss is None else pa.shortfall(task.q, miss)
            reason = f"no grasp found on any allowed plane: {found.reason}{'; ' if lacking else ''}{lacking}"
            steps.append(reached(3, "no grasp", reason))
            return decided(task, 3, Status.NO_GRASP, steps, None, best=miss)
        steps.append(reached(3, "explored", discovery.summary))
        if isinstance(discovery.answer, Grip) and discovery.answer.judged < threshold - SLACK:
            searched = searched or self._self_test(pa, task.q, allowed)[0]
            if searched is not None and searched.judged > discovery.answer.judged:
                discovery = replace(discovery, answer=searched, taught=searched)
        best = discovery.answer
        verdict = judge(best.judged, threshold, subject=pa.measure)
        if may_learn and not self.memory.read_only and (verdict.reward or not isinstance(best, Grip)):
            # A lesson learnt with restricted approaches would wrongly restrict later plans without them [C].
            whole = None if allowed.all() else self._explore(pa, task, None)
            learnt = self._learn(pa, task, whole or discovery)
            steps.append(reached(3, "learned", learnt))
            if allowed.all():
                own, verdict = self._self_test(pa, task.q, allowed)
                if own is not None and best.judged < threshold:
                    if own.judged > best.judged:
                        best = own
                    elif not verdict.reward:
                        verdict = judge(best.judged, threshold, subject=pa.measure)
        given, verdict = self._better_of(pa, best, stored, verdict)
        best = best if given is None else given
        if not verdict.reward and searched is not None and searched.judged > best.judged + SLACK:
            best = searched
        if verdict.match is None or abs(verdict.match - best.judged) > SLACK:  # it judged another grasp
            judged = judge(best.judged, threshold, subject=pa.measure).reason
            verdict = replace(verdict, reason=f"{judged}; {verdict.reason}")
        if not verdict.reward and (lacking := pa.shortfall(task.q, best)):
            verdict = replace(verdict, reason=f"{verdict.reason}: {lacking}")
        steps.append(_step(3, verdict, missed="deadlock"))
        if not verdict.reward:
            self.deadlock = True
            return decided(task, 3, Status.DEADLOCK, steps, None, best=best)
        if may_learn and not allowed.all():
            # The lesson is of all planes; the answer under the restriction is stored beside it.
            self.knowledge.store_grip(pa, task, best)
        return self._answer(pa, task, 3, best, steps, allowed, count, None)

    def _explore(self, pa: Analyser, task: Task, allowed: BoolArray | None) -> Discovery | None:
        s = self.settings
        enough = s.thresholds.estimation
        return explore(pa, task.q, s.sets, enough=enough, allowed=allowed, finger_rule=s.finger_rule)

    def _criticise(self, pa: Analyser, q: Array, found: Exploration) -> tuple[Grasp | None, Verdict]:
        threshold = self.settings.thresholds.estimation
        if not len(found):
            return None, judge(None, threshold, subject=pa.measure, why=found.reason)
        grasp = found.grasp()
        return grasp, judge(grasp.judged, threshold, subject=pa.measure)

    def _learn(self, pa: Analyser, task: Task, discovery: Discovery) -> str:
        """Incremental learning (§3.5): experiences and new weights are stored together."""
        weights = self.knowledge.learn(pa, task, discovery)
        if weights is None:
            return f"{pa.mesh.name} with this task was learnt before; the memory holds these very lessons"
        return (
            f"{pa.mesh.name} on plane {discovery.taught.plane.index}, with this task and its best possible "
            f"task; {weights.trained_on} samples, "
            f"mean-square error {weights.mean_square_error:.1e}"
        )

    def _self_test(self, pa: Analyser, q: Array, allowed: BoolArray) -> tuple[Grasp | None, Verdict]:
        estimate, grasp, verdict = self._mode_0(pa, q, allowed)
        if verdict.reward:
            return grasp, replace(verdict, reason=f"self-test at mode 0: {verdict.reason}")
        grasp, verdict = self._mode_1(pa, q, estimate)
        return grasp, replace(verdict, reason=f"self-test at modes 0 and 1: {verdict.reason}")

    def _answer(
        self,
        pa: Analyser,
        task: Task,
        mode: int,
        grasp: Grasp,
        steps: list[Transition],
        allowed: BoolArray,
        count: int,
        estimate: Estimate | None,
    ) -> Decision:
        others: tuple[Grasp, ...] = ()
        if count > 1:
            others = self._alternatives(pa, task.q, grasp, allowed, count - 1)
        return decided(task, mode, Status.ANSWER, steps, estimate, grasp=grasp, alternatives=others)

    def _alternatives(
        self, pa: Analyser, q: Array, grasp: Grasp, allowed: BoolArray, count: int
    ) -> tuple[Grasp, ...]:
        """The best other answers; see :func:`~preshape.hiis.decision.different_answers`."""
        found = pa.explore(q, everywhere(self.settings.sets, allowed)).with_fingers(self.settings.finger_rule)
        return different_answers(grasp, found, count, self.settings.thresholds.estimation)

    def _offers(self, pa: Analyser, task: Task, allowed: BoolArray) -> tuple[Offer, ...]:
        """The named tasks nearest to this one that mode 0 or 1 could answer (task correction)."""
        offers: list[Offer] = []
        candidates = sorted(all_named_tasks(), key=lambda t: float(np.linalg.norm(t.q - task.q)))
        for candidate in candidates[: pa.patience]:
            estimate, _, verdict = self._mode_0(pa, candidate.q, allowed)
            mode = 0
            if not verdict.reward:
                _, verdict = self._mode_1(pa, candidate.q, estimate)
                mode = 1
            if verdict.reward and verdict.match is not None:
                distance = float(np.linalg.norm(candidate.q - task.q))
                offers.append(Offer(task=candidate, match=verdict.match, mode=mode, distance=distance))
            if len(offers) == OFFERS:
                break
        return tuple(offers)


def _step(mode: int, verdict: Verdict, *, met: str = "reward", missed: str = "penalty") -> Transition:
    return reached(mode, met if verdict.reward else missed, verdict.reason)


def _correction(recognition: Recognition, failure: str) -> str:
    """The reason of a task correction: what the object is known by, and what fell short."""
    return f"the object is known ({recognition.verdict.reason}); {failure}"


def _indices(allowed: BoolArray) -> Sequence[int]:
    return [int(i) + 1 for i in np.flatnonzero(allowed)]
