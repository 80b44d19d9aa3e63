"""From an object and a task to a plan: load, decide, try it with the hand.

>>> from preshape import plan                                           # doctest: +SKIP
>>> answer = plan("mug", "lift", memory=":memory:")                     # doctest: +SKIP
>>> answer.grasp.plane.label, answer.hand_result.status                 # doctest: +SKIP
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from .closure.settings import ClosureSettings
from .exceptions import InputError
from .hands.load import Hand, load_hand
from .hiis.analyser import Grasp, Grip, HandLayout
from .hiis.controller import Controller
from .hiis.decision import Decision, Settings
from .kernels.closing.host import Obstacles
from .memory import Memory
from .objects.load import load_object
from .objects.mesh import TriangleMesh
from .objects.scans.trust import Trust, trust_of, worth
from .planning.hand_simulation import HandResult, simulate_hand
from .tasks import Task, parse_task, task_from_numbers
from .tasks.task import COMPONENTS
from .types import frozen_array, value

ANALYSERS = ("rays", "closure")
VERIFIED = 6
"""Answers that are tried in physics, where it is asked; with a larger ``count`` all of these."""
ON_CLOUDS = 8
"""Answers looked at on a point cloud, for one with its contacts where the surface was seen."""
RAY_HAND = "utah_mit"
"""The hand whose default analyser is the paper's; any other hand's is closure."""


@value
class Answer:
    """A virtual grasp and what the hand could make of it.

    Attributes:
        grasp: the virtual grasp.
        hand_result: the hand simulation; its status says whether the hand reached it.
    """

    grasp: Grasp
    hand_result: HandResult


@value
class Verified:
    """What the holding test said.

    Attributes:
        held: whether the plan's answer held.
        tried: how many answers were tried until one did.
        reason: one sentence.
    """

    held: bool
    tried: int
    reason: str


@value
class Plan:
    """Everything about one run, for people, files and pictures.

    Attributes:
        mesh: the object as planned with [m].
        source: the file or library name it came from.
        hand: the hand.
        settings: meta control's settings.
        decision: the controller's report.
        answer: the answer with the hand on it; ``None`` without one.
        alternatives: further answers, best first.
        seconds: ``load``, ``prepare``, ``search``, ``total``.
        verified: what simulated physics said of the answers, where it was asked.
    """

    mesh: TriangleMesh
    source: str
    hand: Hand
    settings: Settings
    decision: Decision
    answer: Answer | None
    alternatives: tuple[Answer, ...]
    seconds: dict[str, float]
    verified: Verified | None = None

    @property
    def grasp(self) -> Grasp | None:
        """The answer's virtual grasp."""
        return self.answer.grasp if self.answer else None

    @property
    def hand_result(self) -> HandResult | None:
        """The answer's hand simulation."""
        return self.answer.hand_result if self.answer else None


def plan(
    thing: str | Path | TriangleMesh,
    task: str | Sequence[float] | Task,
    *,
    hand: str = RAY_HAND,
    analyser: str | None = None,
    scale: float = 1.0,
    unit: str = "m",
    memory: str | Path | Memory | None = None,
    learn: bool = True,
    seed: int = 0,
    count: int = 1,
    approaches: str | None = None,
    settings: Settings | None = None,
    closure: ClosureSettings | None = None,
    table: float | str | None = None,
    avoid: Sequence[Sequence[float]] = (),
    verify: bool = False,
    view: Sequence[float] | str | None = None,
) -> Plan:
    """Plan a preshape.

    Args:
        thing: a mesh file, the name of a library object, or a mesh.
        task: a task's name, six numbers, or a task.
        hand: the hand's name.
        analyser: ``rays`` or ``closure``; by default the hand's own.
        scale: factor on the object's size.
        unit: of the file: ``m``, ``cm``, ``mm``, ``in``.
        memory: its file, an open one, ``":memory:"``, or ``None`` for the user's.
        learn: whether a new object is taught to the memory.
        seed: of everything random.
        count: how many different answers are wanted.
        approaches: allowed approach axes, as ``+z,-x``.
        settings: thresholds, membership functions and coefficients.
        closure: friction, load and size of the search, for the closure analyser.
        table: its height along the object's z [m], or ``auto``: under its lowest point; closure only.
        avoid: boxes that hand and fingers stay out of, six numbers each: lower and upper corner in the mesh
            frame [m]; closure only.
        verify: whether the best few go through the holding test in physics; the first that holds is given.
        view: of a point cloud, where the camera was, in the file's frame and unit, or ``all`` for points from
            all round; by default what the file says, else its origin where that can be.

    Raises:
        InputError: any argument that cannot be used; the message says what to change.
        EnvironmentFailure: a file could not be read or written.
    """
    start = time.perf_counter()
    model = load_hand(hand)
    kind = check_analyser(analyser, hand)
    wanted = max(count, VERIFIED) if verify and count > 0 else count
    asked = task if isinstance(task, Task) else _task(task)
    mesh = thing if isinstance(thing, TriangleMesh) else load_object(thing, unit=unit, scale=scale, view=view)
    if mesh.scan is not None and count > 0:
        wanted = max(wanted, ON_CLOUDS)
    loaded = time.perf_counter()
    chosen, usual = settings or Settings(seed=seed), ClosureSettings()
    load = closure or usual
    own = None if isinstance(memory, Memory) else Memory.open(memory, read_only=not learn)
    try:
        store = memory if isinstance(memory, Memory) else own
        assert store is not None
        if kind == "closure":
            from .closure_control import closure_controller

            controller = closure_controller(
                store,
                model,
                layout_of(model),
                settings=chosen,
                closure=with_obstacles(load, mesh, table, avoid, wanted),
                gravity=asked.gravity,
            )
        else:
            if table is not None or len(avoid):
                raise InputError("a table and boxes to avoid need the closure analyser")
            if not verify and (load.friction, load.mass) != (usual.friction, usual.mass):
                raise InputError(
                    "friction and mass need the closure analyser, or a test in physics (--verify)"
                )
            controller = Controller(store, layout_of(model), settings=chosen)
        element = controller.prepare(mesh)
        prepared = time.perf_counter()
        decision = controller.run(element, asked, approaches=approaches, count=wanted, may_learn=learn)
        answer = execute(model, mesh, decision.grasp, seed=seed) if decision.grasp else None
        others = tuple(execute(model, mesh, g, seed=seed) for g in decision.alternatives)
        end = time.perf_counter()
        made = Plan(
            mesh=mesh,
            source=str(thing) if not isinstance(thing, TriangleMesh) else mesh.name,
            hand=model,
            settings=chosen,
            decision=decision,
            answer=answer,
            alternatives=others,
            seconds={
                "load": loaded - start,
                "prepare": prepared - loaded,
                "search": end - prepared,
                "total": end - start,
            },
        )
        if mesh.scan is not None:
            made = seen_first(made, keep=count if not verify else wanted)
        if verify:
            made, tried = verified_plan(made, load, keep=count)
            # What stands in the way today must not become what is known of the object [C].
            free = approaches is None and table is None and not len(avoid)
            if learn and free and not store.read_only:
                controller.learn_outcomes(element, asked, tried)
        return made
    finally:
        if own is not None:
            own.close()


def seen_first(plan: Plan, *, keep: int) -> Plan:
    """The plan of a point cloud with its answers in the order of margin and of what was seen under them.

    Args:
        plan: with all answers that may be chosen.
        keep: how many answers are kept in all.
    """
    scan = plan.mesh.scan
    if plan.answer is None or scan is None:
        return plan
    from .closure.grip import margin_of

    def rank(answer: Answer) -> float:
        g = answer.grasp  # what the critic judges stands for a margin of a grip; else it is the match itself
        return (margin_of(g.judged) if isinstance(g, Grip) else g.judged) * worth(scan, g.contacts.triangles)

    best, *others = sorted((plan.answer, *plan.alternatives), key=lambda answer: -rank(answer))
    return replace(plan, answer=best, alternatives=tuple(others[: keep - 1]))


def scan_trust(plan: Plan, answer: Answer | None) -> Trust | None:
    """How much an answer on a point cloud can be trusted; ``None`` on a mesh."""
    scan = plan.mesh.scan
    if scan is None:
        return None
    return trust_of(scan, answer.grasp.contacts.triangles if answer is not None else None)


def verified_plan(plan: Plan, load: ClosureSettings, *, keep: int) -> tuple[Plan, list[tuple[Grasp, bool]]]:
    """The plan with the first of its answers that holds in the holding test; and what that tells of grasps.

    Args:
        plan: with all answers that may be tried.
        load: friction and mass to test with.
        keep: how many answers are kept in all.
    """
    from .physics.protocol import HoldProtocol
    from .planning.verify import telling, verify

    answers = [a for a in (plan.answer, *plan.alternatives) if a is not None][: max(keep, VERIFIED)]
    if not answers:
        return plan, []
    rules = HoldProtocol(friction=load.friction, mass=load.planned_mass, stop_early=True)
    found = verify(plan.hand, plan.mesh, [a.hand_result for a in answers], protocol=rules)
    reached = [a.grasp for a in answers if a.hand_result.grasp is not None]
    tried = [
        (grasp, result.held)
        for grasp, result in zip(reached, found.results, strict=False)
        if telling(result, rules)
    ]
    if found.held is None:
        why = found.results[0].reason if found.results else "the hand reached none of the answers"
        said = Verified(held=False, tried=len(found.results), reason=f"no answer held in physics: {why}")
        return replace(plan, alternatives=plan.alternatives[: keep - 1], verified=said), tried
    best = answers.pop(found.held)
    said = Verified(held=True, tried=len(found.results), reason=found.results[-1].reason)
    # What was tried before and lost is no alternative.
    rest = tuple(answers[found.held : found.held + keep - 1])
    return replace(plan, answer=best, alternatives=rest, verified=said), tried


def execute(hand: Hand, mesh: TriangleMesh, grasp: Grasp, *, seed: int = 0) -> Answer:
    """Grasp simulation (§4): the hand tries the virtual grasp, or retracts; a grip is executed as it is."""
    if isinstance(grasp, Grip):
        return Answer(grasp=grasp, hand_result=HandResult.of_grip(hand, grasp))
    result = simulate_hand(
        hand,
        mesh,
        approach_axis=grasp.plane.approach_axis,
        opposition_axis=grasp.thumb_side,
        contact_points=grasp.contacts.points,
        normals_in=grasp.contacts.normals_in,
        triangles=grasp.contacts.triangles,
        seed=seed,
    )
    return Answer(grasp=grasp, hand_result=result)


def shortfalls(plan: Plan, answer: Answer) -> tuple[str, ...]:
    """What the task asks for and the grasp does not give: present components with ADI 0.

    TFVADI sums six components, so a grasp can pass without the one that matters most.
    """
    present = np.array([0.1, 0.1, 0.1, 0.05, 0.05, 0.05])
    q, g = plan.decision.task.q, answer.grasp
    return tuple(
        f"{name}: the task asks {asked:+.2f}, the grasp gives {given:+.2f}"
        for name, asked, given, degree, limit in zip(COMPONENTS, q, g.net_wrench, g.adi, present, strict=True)
        if abs(asked) > limit + 1e-9 and degree <= 1e-9
    )


def layout_of(hand: Hand) -> HandLayout:
    """What the analyser must know of a hand."""
    return HandLayout(
        name=hand.name, u=hand.u, finger_pitch=hand.finger_pitch, fingertip_width=hand.fingertip_width
    )


def check_analyser(analyser: str | None, hand: str) -> str:
    """The analyser to be used, by name.

    Raises:
        InputError: no such analyser, or one that this version does not have.
    """
    name = analyser or ("rays" if hand == RAY_HAND else "closure")
    if name not in ANALYSERS:
        raise InputError(f"no analyser {name!r}; known: {', '.join(ANALYSERS)}")
    return name


def with_obstacles(
    closure: ClosureSettings,
    mesh: TriangleMesh,
    table: float | str | None,
    avoid: Sequence[Sequence[float]],
    count: int,
) -> ClosureSettings:
    """The closure settings with a table and boxes, and with enough grips worked out for the answers wanted.

    Raises:
        InputError: a table that is no height, or a box that is not two corners, lower and upper.
    """
    planes = [] if table is None else [[0.0, 0.0, 1.0, _height(table, mesh)]]
    boxes = []
    for box in avoid:
        corners = frozen_array(box, (6,), "a box to avoid")
        if not (corners[:3] < corners[3:]).all():
            raise InputError(f"a box to avoid is its lower corner, then its upper, got {list(box)}")
        boxes.append(corners.reshape(2, 3))
    return replace(
        closure,
        finished=max(closure.finished, count + count // 2 + 2),
        obstacles=Obstacles(planes=np.array(planes).reshape(-1, 4), boxes=np.array(boxes).reshape(-1, 2, 3)),
    )


def _height(table: float | str, mesh: TriangleMesh) -> float:
    if isinstance(table, str) and table == "auto":
        return float(mesh.vertices[:, 2].min())
    try:
        height = float(table)
    except (TypeError, ValueError):
        raise InputError(f"a table is its height in metres or auto, got {table!r}") from None
    if not np.isfinite(height):
        raise InputError(f"a table's height must be finite, got {table!r}")
    return height


def _task(task: str | Sequence[float]) -> Task:
    return parse_task(task) if isinstance(task, str) else task_from_numbers(task)
