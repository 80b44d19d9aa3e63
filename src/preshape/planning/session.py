"""The one place where hand, memory, analyser and controller meet.

A session holds one memory and answers requests one after the other. It caches the object, the prepared
analyser and the controller of the last request, because callers often ask several questions about one object.
The answer depends on the request and the memory alone, never on earlier requests.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from ..closure.contact_places import part_mesh
from ..closure.rules import KEEP_OFF
from ..exceptions import Cancelled, EnvironmentFailure, InputError, shown
from ..files import file_place, file_state
from ..hands.hand import Hand
from ..hands.load import load_hand
from ..hiis.analyser import Analyser, Grasp
from ..hiis.controller import Controller
from ..hiis.critic import of_this_object
from ..hiis.decision import Decision
from ..hiis.planes import AXIS_NAMES
from ..memory import Memory, default_path
from ..objects.load import split_part
from ..objects.mass import ObjectMass, object_mass
from ..objects.mesh import TriangleMesh
from ..tasks import Task
from ..types import an_instance, value
from .answer_cache import names_all_files, object_state, obstacle_states
from .answers import Answer, answers_of, seen_first
from .controllers import closure_controller, layout_of, ray_controller
from .hand_simulation import execute
from .plan import Plan
from .request import PlanRequest
from .sizes import misplaced_obstacles, out_of_reach, refuse_absurd_size

if TYPE_CHECKING:
    from ..arm.model import Arm

Progress = Callable[[str, float], None]
"""Called with the name of the current step and the total progress in percent."""
Partial = Callable[[Plan], None]
"""Called with the plan so far: first with the answer alone, then with each further answer."""


ARM_ROUNDS = 2
"""Further searches along other approaches if the arm serves no answer [C]."""


@value
class Prepared:
    """Everything that a request needs, loaded and prepared.

    Attributes:
        request: The request.
        task: Its task in the mesh frame.
        hand: The hand.
        mesh: The object [m].
        mass: The object's mass.
        controller: The paper's controller over the request's analyser.
        element: The analyser, prepared for the object.
        warnings: What the caller should know about the request.
        seconds: Time of ``load`` and ``prepare`` [s].
        known: Whether the memory holds an experience of this object (5 % of scale) and of this model of the
            hand, of any task and scene.
        arm: The arm with the hand; ``None`` without one.
    """

    request: PlanRequest
    task: Task
    hand: Hand
    mesh: TriangleMesh
    mass: ObjectMass
    controller: Controller
    element: Analyser
    warnings: tuple[str, ...]
    seconds: dict[str, float]
    known: bool
    arm: Arm | None = None


class Session:
    """Answers requests over one memory; a context manager.

    Args:
        memory: An open memory, or the file of one (``None`` for the user's, ``":memory:"`` for a transient
            one). The session closes a memory only if it opened that memory itself. It opens such a memory
            again if another file has taken the place of the memory's file since.
        learn: Whether the session may write to a memory that it opens itself.
        progress: Called as the work advances.
        cancel: Event; once it is set, the session stops at its next step and raises ``Cancelled``.

    Raises:
        InputError: The memory is neither an open memory nor a path.
        EnvironmentFailure: The memory cannot be opened.
        MemoryFileError: The file is no memory.
    """

    def __init__(
        self,
        memory: Memory | str | Path | None = None,
        *,
        learn: bool = True,
        progress: Progress | None = None,
        cancel: threading.Event | None = None,
    ) -> None:
        if not isinstance(memory, Memory | str | Path | None):
            raise InputError(f"memory must be a file, an open memory or None, got {shown(memory)}")
        self._own, self._learn = not isinstance(memory, Memory), learn
        self.memory = memory if isinstance(memory, Memory) else Memory.open(memory, read_only=not learn)
        # The path as it was given: a link in it may later lead to another file.
        self._file = Path(default_path() if memory is None else str(memory)).expanduser().absolute()
        self._place = file_place(self._file)
        self.progress, self._cancel = progress, cancel
        self._hand: Hand | None = None
        self._mesh: tuple[Any, TriangleMesh] | None = None
        self._controller: tuple[Any, Controller] | None = None
        self._element: tuple[Any, Analyser] | None = None
        self._arm: tuple[Any, Arm] | None = None
        self._known: tuple[Any, bool] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the memory if the session opened it."""
        if self._own:
            self.memory.close()

    def _open_again(self) -> None:
        """Open the session's own memory again if another file has taken its place."""
        if not self._own or self.memory.where == ":memory:" or file_place(self._file) == self._place:
            return
        self._controller = self._element = None
        self.memory.close()
        self.memory = Memory.open(self._file, read_only=not self._learn)
        self._place = file_place(self._file)

    def prepare(self, request: PlanRequest) -> Prepared:
        """Load hand and object, and make analyser and controller for them.

        Raises:
            InputError: Something in the request cannot be used.
            EnvironmentFailure: A file cannot be read.
        """
        an_instance(request, PlanRequest, "request")
        start = time.perf_counter()
        self._tell("reading object, task and hand", 5)
        self._open_again()
        hand, mesh = self.hand(request), self.mesh(request)
        arm = self.arm(request, hand)
        refuse_absurd_size(mesh, hand)
        mass = object_mass(mesh, request.stated_mass)
        warnings = [*mesh.notes, *([mass.warning] if mass.warning else [])]
        warnings += [*out_of_reach(request, mesh, hand), *misplaced_obstacles(request, mesh)]
        stands = request.standing(mesh)
        warnings += [f"{mesh.name} {stands.warning}"] if stands.warning else []
        loaded = time.perf_counter()
        self._tell("opening the memory; a hand's first time includes the lesson with the cube", 12)
        key = _element_key(request, hand, mesh, mass)
        controller = self._controller_of(request, hand, mesh, mass, key)
        if self.memory.remark:
            warnings.append(self.memory.remark)
        if self._element is None or self._element[0] != (*key, mesh, controller):
            self._element = (*key, mesh, controller), controller.prepare(mesh)
        return Prepared(
            request=request,
            task=stands.task(request.asked),
            hand=hand,
            mesh=mesh,
            mass=mass,
            controller=controller,
            element=self._element[1],
            warnings=tuple(warnings),
            seconds={"load": loaded - start, "prepare": time.perf_counter() - loaded},
            known=self._is_known(controller, mesh),
            arm=arm,
        )

    def run(self, request: PlanRequest, *, partial: Partial | None = None) -> Plan:
        """Answer a request: modes 0 to 3, the hand, and the physics test if the request asks for it.

        Args:
            request: The request.
            partial: Called with the plan so far while further answers are computed.

        Raises:
            InputError: Something in the request cannot be used.
            EnvironmentFailure: A file cannot be read or written.
            Cancelled: ``cancel`` was set.
        """
        ready = self.prepare(request)
        wanted = request.wanted(ready.mesh, by_arm=False)
        started = time.perf_counter()
        self._tell("modes 0 to 3: looking for grasps that serve the task", 35)
        # What an earlier request made the analyser search must not change the answer to this one.
        ready.element.forget()
        decision = ready.controller.run(
            ready.element,
            ready.task,
            approaches=request.approaches,
            count=wanted,
            may_learn=request.learn,
        )
        # A deadlock concerns this request only, not the next one.
        ready.controller.reset()
        chosen_later = ready.mesh.scan is not None or request.verify or ready.arm is not None
        plan = self._executed(ready, decision, started, None if chosen_later else partial)
        keep = request.count if not request.verify else wanted
        if ready.mesh.scan is not None:
            plan = seen_first(plan, keep=keep if ready.arm is None else wanted)
        if ready.arm is not None:
            plan = self._on_arm(ready, ready.arm, plan, keep=keep, started=started)
        if request.verify:
            from .verify import verified_plan

            plan, tried = verified_plan(
                plan, keep=request.count, progress=lambda words, share: self._tell(words, 40 + 60 * share)
            )
            # A lesson that was restricted to some approaches would mislead plans without the restriction.
            if request.learn and request.approaches is None and not self.memory.read_only:
                ready.controller.knowledge.learn_outcomes(ready.element, ready.task, tried)
        if partial is not None and chosen_later:
            partial(plan)
        return plan

    def teach(self, request: PlanRequest) -> Plan:
        """Learn an object with its task at once (mode 3), whether or not it is known.

        Raises:
            InputError: Something in the request cannot be used, or it says ``learn=False``.
            EnvironmentFailure: A file cannot be read or written, or the memory is open for reading only.
            Cancelled: ``cancel`` was set.
        """
        an_instance(request, PlanRequest, "request")
        if not request.learn:
            raise InputError(
                "to teach is to learn, and the request says learn=False; leave it out, or use run"
            )
        self._open_again()
        if self.memory.read_only:
            raise EnvironmentFailure(
                f"nothing can be learnt: the memory {self.memory.where} is open for reading only; "
                "check its permissions or choose another file with --memory OTHER"
            )
        ready = self.prepare(request)
        started = time.perf_counter()
        self._tell("mode 3: exploring all planes and learning", 35)
        ready.element.forget()
        decision = ready.controller.teach(ready.element, ready.task, approaches=request.approaches)
        ready.controller.reset()
        return self._executed(ready, decision, started, None)

    def inputs(self, request: PlanRequest) -> tuple[Any, ...] | None:
        """A value that changes whenever the answer to a request may: the state of memory and files.

        Returns:
            The value, or ``None`` if the answer also depends on files that the request does not name.
        """
        self._open_again()
        if not names_all_files(request):
            return None
        place, thing = (*(self._place or ()), *self.memory.state()), object_state(request)
        return (*place, *thing, *obstacle_states(request))

    def hand(self, request: PlanRequest) -> Hand:
        """The request's hand."""
        if isinstance(request.hand, Hand):
            return request.hand
        from ..closure.hand_tables import digest

        # A named hand comes from a cache. A file is read at every request, because it or a file that it names
        # may have changed; what was prepared for the hand stays if its content is the same.
        hand, last = load_hand(request.hand), self._hand
        if hand is last:
            return hand
        if last is None or last.source != hand.source or digest(last, "") != digest(hand, ""):
            self._hand = last = hand
        return last

    def arm(self, request: PlanRequest, hand: Hand) -> Arm | None:
        """The request's arm with the hand on it; the last one is used again if its file has not changed."""
        if request.arm is None:
            return None
        key = (file_state(request.arm), request.arm, request.arm_tip, request.mount, hand)
        if self._arm is None or self._arm[0] != key:
            from .arm import arm_of

            self._arm = key, arm_of(request, hand)
        return self._arm[1]

    def mesh(self, request: PlanRequest) -> TriangleMesh:
        """The request's object [m]."""
        if isinstance(request.source, TriangleMesh):
            return request.source
        key, last = object_state(request), self._mesh
        # A glTF file may name files with its vertices, which may have changed instead.
        file = split_part(request.source)[0].lower()
        if last is None or last[0] != key or file.endswith((".gltf", ".glb")):
            made = request.load()
            if last is None or last[0] != key or not last[1].same_as(made):
                self._mesh = last = key, made
        return last[1]

    def _executed(self, ready: Prepared, decision: Decision, started: float, partial: Partial | None) -> Plan:
        """The hand on each grasp of a decision."""
        request, before = ready.request, ready.seconds
        found = [decision.grasp] if decision.grasp is not None else []
        found += decision.alternatives
        answers: list[Answer] = []
        best = None
        if decision.grasp is None and decision.best is not None:
            best = self._answer(ready, decision.best)
        plan: Plan | None = None
        for k, grasp in enumerate(found or [None]):
            if grasp is not None:
                first, last = (37, 40) if request.verify else (60, 100)  # the test in physics takes longest
                share = first + (last - first) * k / len(found)
                self._tell(f"the hand tries answer {k + 1} of {len(found)}", share)
                answers.append(self._answer(ready, grasp))
            searched = time.perf_counter() - started
            plan = Plan(
                request=request,
                mesh=ready.mesh,
                hand=ready.hand,
                mass=ready.mass,
                decision=decision,
                answer=answers[0] if answers else None,
                alternatives=tuple(answers[1:]),
                best=best,
                seconds={**before, "search": searched, "total": sum(before.values()) + searched},
                warnings=ready.warnings,
                known=ready.known,
            )
            if partial is not None:
                partial(plan)
        assert plan is not None
        return plan

    def _on_arm(self, ready: Prepared, arm: Arm, plan: Plan, *, keep: int, started: float) -> Plan:
        """The plan with the answers that the arm serves.

        1. The arm tries the first answers, as many as without an arm.
        2. If it does not serve as many as asked for, it chooses among more.
        3. If it serves none of these either, other approaches are searched.

        The further searches teach nothing: a lesson that was restricted to some approaches would mislead
        plans without an arm.
        """
        from .arm import advised, failed_axes, with_arm

        request, first = ready.request, ready.request.wanted(ready.mesh, by_arm=False)
        self._tell(f"the arm {arm.name} tries the answers", 90 if not request.verify else 40)
        plan = with_arm(plan, arm, keep=keep)
        if len(answers_of(plan)) < keep and first < request.wanted(ready.mesh) and plan.arm_tested:
            further = self._further(ready, arm, replace(plan, arm=None), request.approaches, keep, started)
            if further.arm is not None and (further.answer is not None or plan.answer is None):
                plan = further
        for _ in range(ARM_ROUNDS):
            assert plan.arm is not None
            allowed = set((request.approaches or ",".join(AXIS_NAMES)).replace(" ", "").split(","))
            rest = sorted(allowed - failed_axes(plan.arm.refused))
            if plan.answer is not None or not plan.arm_tested or not rest:
                break
            plan = self._further(ready, arm, plan, ",".join(rest), keep, started)
        plan = advised(plan, arm)
        searched = time.perf_counter() - started
        total = sum(ready.seconds.values()) + searched
        return replace(plan, seconds={**plan.seconds, "search": searched, "total": total})

    def _further(
        self, ready: Prepared, arm: Arm, plan: Plan, approaches: str | None, keep: int, started: float
    ) -> Plan:
        """The plan after a further search for answers that the arm serves; the same if nothing is found."""
        from .arm import with_arm

        wanted, before = ready.request.wanted(ready.mesh), plan.decision
        self._tell(f"looking for grasps that the arm {arm.name} reaches", 92)
        decision = ready.controller.run(
            ready.element, ready.task, approaches=approaches, count=wanted, may_learn=False
        )
        ready.controller.reset()
        if decision.grasp is None:
            return plan
        decision = replace(decision, transitions=(*before.transitions, *decision.transitions))
        further = replace(self._executed(ready, decision, started, None), arm=plan.arm)
        if ready.mesh.scan is not None:
            further = seen_first(further, keep=wanted)
        further = with_arm(further, arm, keep=keep)
        if further.answer is None and plan.best is not None:
            return replace(further, best=plan.best, decision=replace(further.decision, best=before.best))
        return further

    def _answer(self, ready: Prepared, grasp: Grasp) -> Answer:
        off = [part_mesh(part) for part in ready.request.rules_for(ready.mesh).contact.keep_off]
        seed = ready.request.settings.seed
        return Answer(
            grasp=grasp,
            hand_result=execute(ready.hand, ready.mesh, grasp, seed=seed, kept_off=off, room=KEEP_OFF),
            heaviest=ready.element.heaviest(ready.task.q, grasp),
        )

    def _controller_of(
        self, request: PlanRequest, hand: Hand, mesh: TriangleMesh, mass: ObjectMass, key: Any
    ) -> Controller:
        """The controller of a request; the last one is used again if the memory has not changed since."""
        scene, known = request.scene(mesh), self.memory.state()
        key = (*key, scene, request.learn)
        if self._controller is not None and self._controller[0] == key:
            controller = self._controller[1]
            if controller.knowledge.memory_state == known:
                return controller
        if request.analyser == "rays":
            controller = ray_controller(
                self.memory, layout_of(hand), request, request.rules_for(mesh).contact, scene
            )
        else:
            controller = closure_controller(
                self.memory,
                hand,
                settings=request.settings,
                closure=request.closure(mesh, mass.kg),
                gravity=request.task_gravity(mesh),
                scene=scene,
                may_store=request.learn,
            )
        self._controller = key, controller
        return controller

    def _is_known(self, controller: Controller, mesh: TriangleMesh) -> bool:
        """Whether the memory holds an experience of the object; looked up once for each state of it."""
        key = (controller, len(controller.knowledge.own), mesh)
        if self._known is None or self._known[0] != key:
            self._known = key, bool(of_this_object(controller.knowledge.own, mesh))
        return self._known[1]

    def _tell(self, words: str, share: float) -> None:
        if self._cancel is not None and self._cancel.is_set():
            raise Cancelled("cancelled; everything that was acknowledged is kept")
        if self.progress is not None:
            self.progress(words, share)


_ELEMENT_KEYS = (
    "analyser", "friction", "table", "avoid", "gravity", "seed", "thresholds", "sets", "finger_rule",
    "coefficients", "up", "rest", "obstacle", "search", "grasp_type",
)  # fmt: skip
"""Keys of a request's JSON that analyser and controller depend on."""


def _element_key(request: PlanRequest, hand: Hand, mesh: TriangleMesh, mass: ObjectMass) -> tuple[Any, ...]:
    """Key of controller and analyser in the cache: everything they depend on besides the object."""
    document, rules = request.to_json(), request.rules_for(mesh).key
    wanted = (request.wanted(mesh), request.count > 1) if request.analyser == "closure" else 0
    values = (repr(document[name]) for name in _ELEMENT_KEYS)
    return (hand, mass.kg, wanted, rules, *values, *obstacle_states(request))
