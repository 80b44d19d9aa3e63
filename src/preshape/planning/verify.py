"""``--verify``: test planned answers in physics, in their order, until one passes.

In free space that is the holding test. On a table, the hand must pick the object up and do the task with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from ..exceptions import TaskError
from ..hands.hand import Hand
from ..hiis.analyser import Grasp
from ..objects.mass import object_mass
from ..objects.mesh import TriangleMesh
from ..physics.hand import physics_hand
from ..physics.hold.six_directions import HoldResult, HoldStatus, hold_test
from ..physics.pick.protocol import PickStatus
from ..physics.pieces import decompose
from ..physics.protocol import HoldProtocol
from ..physics.scene import build_scene
from ..physics.task.motion import TaskMotion, task_motion
from ..types import FRICTION, value
from .answers import Answer, Verified, answers_of, chosen
from .grasp_sets import palm_grasps, poses_of
from .hand_simulation import HandResult
from .plan import Plan
from .request import VERIFIED, PlanRequest

Progress = Callable[[str, float], None]
"""Called with what is done and the share of the test that is finished, 0..1."""


def _untold(words: str, share: float) -> None:
    """Tell nobody."""


@value
class Tested:
    """What physics said of one answer.

    Attributes:
        passed: Whether it passed.
        reason: One sentence.
        counts: Whether the outcome is evidence about the grasp and the real object.
    """

    passed: bool
    reason: str
    counts: bool


def verified_plan(
    plan: Plan, *, keep: int, progress: Progress = _untold
) -> tuple[Plan, list[tuple[Grasp, bool]]]:
    """The plan with the first of its answers that passes, tested with the plan's own mass and friction.

    Args:
        plan: The plan, with all answers that may be tested.
        keep: Number of answers to keep.
        progress: Called as the test advances; it may raise an exception to stop it.

    Returns:
        The plan, and the grasps whose outcome is worth remembering, each with True if it held.
    """
    answers = list(answers_of(plan)[: max(keep, VERIFIED)])
    if not answers:
        return replace(plan, verified=Verified(held=False, tried=0, reason="there is no answer to test")), []
    rules = HoldProtocol(friction=plan.request.stated_friction, mass=plan.mass.kg, stop_early=True)
    results: list[Tested]
    if plan.standing.table is not None:
        results = pick_until_done(plan, answers, progress=progress)
    else:
        held = hold_until_held(
            plan.hand, plan.mesh, [a.hand_result for a in answers], protocol=rules, progress=progress
        )
        results = [
            Tested(
                passed=r.held, reason=r.reason, counts=worth_remembering(r, rules, object_mass(plan.mesh).kg)
            )
            for r in held
        ]
    reached = [k for k, a in enumerate(answers) if a.hand_result.grasp is not None]
    tried = [
        (answers[k].grasp, result.passed)
        for k, result in zip(reached, results, strict=False)
        if result.counts
    ]
    passes = "held" if plan.standing.table is None else "did the job"
    if not results or not results[-1].passed:
        why = results[0].reason if results else "the hand reached none of the answers"
        said = Verified(held=False, tried=len(results), reason=f"no answer {passes} in physics: {why}")
        return replace(plan, alternatives=plan.alternatives[: keep - 1], verified=said), tried
    first = reached[len(results) - 1]
    said = Verified(held=True, tried=len(results), reason=results[-1].reason)
    # An answer that was tested and lost the object is not offered as an alternative.
    rest = tuple(answers[first + 1 : first + keep])
    plan = replace(plan, alternatives=rest, verified=said)
    return chosen(plan, answers[first], f"the first answer that {passes} in physics"), tried


def work_of(request: PlanRequest, mesh: TriangleMesh) -> TaskMotion | None:
    """Motion, load and gravity of a request's task, in the mesh frame; ``None`` if it asks for no motion."""
    task = request.standing(mesh).task(request.asked)
    try:
        return task_motion(task, mesh.cog, float(mesh.extents.max()) / 2, gravity=request.task_gravity(mesh))
    except TaskError:
        return None


def pick_until_done(plan: Plan, answers: Sequence[Answer], *, progress: Progress = _untold) -> list[Tested]:
    """Pick the object up with answers in their order and do the task, until one does it.

    Args:
        plan: The plan, whose object rests on a table.
        answers: Its answers; those whose hand did not reach the grasp are left out.
        progress: Called as the test advances.

    Returns:
        A result for each answer that was tested; only the last one may have passed.

    Raises:
        ObjectError: The object encloses no volume.
        EnvironmentFailure: The object cannot be cut into pieces.
    """
    from ..physics.pick.doing import JOB_STAGES
    from ..physics.pick.objects import PickAnswer, PickObject
    from ..physics.pick.picking import STAGES, pick_test
    from ..physics.pick.protocol import PickProtocol
    from ..physics.pick.runner import pick_scene

    reached = [answer for answer in answers if answer.hand_result.grasp is not None]
    if not reached:
        return []
    rules = PickProtocol(friction=plan.request.stated_friction, do=True)
    hand, turn = physics_hand(plan.hand), tuple(plan.standing.pose[3:].tolist())
    progress("cutting the object into convex pieces, once for an object", 0.0)
    thing = PickObject(name=plan.mesh.name, mass=plan.mass.kg)
    scene = pick_scene(hand, decompose(plan.mesh), thing, turn, rules)
    n, poses = len(reached), poses_of([answer.hand_result for answer in reached])
    grasps = palm_grasps(plan.hand, [plan.mesh.name] * n, [1.0] * n, poses).for_hand(hand)
    work, own_mass = work_of(plan.request, plan.mesh), object_mass(plan.mesh).kg
    results: list[Tested] = []
    for row, answer in enumerate(reached):
        given = PickAnswer(poses=grasps.poses(row), way_in=tuple(answer.way_in.tolist()), turn=turn)
        told = _told(progress, (*STAGES, *JOB_STAGES), row, n)
        result = pick_test(scene, *given.in_world(), rules, row=row, work=work, observer=told)
        easier = thing.mass < own_mass or rules.friction > FRICTION
        harder = thing.mass > own_mass or rules.friction < FRICTION
        real = result.status not in (PickStatus.UNSTABLE, PickStatus.DOES_NOT_REST)
        counts = real and not (easier if result.done else harder)
        results.append(Tested(passed=result.done, reason=result.reason, counts=counts))
        if result.done:
            break
    return results


def hold_until_held(
    hand: Hand,
    mesh: TriangleMesh,
    answers: Sequence[HandResult],
    *,
    protocol: HoldProtocol,
    progress: Progress = _untold,
) -> list[HoldResult]:
    """Test answers in their order until one holds.

    The object is first cut into convex pieces. For a scan this takes up to two minutes, but only once.

    Args:
        hand: The hand.
        mesh: The object, at the size that planning used.
        answers: The hand on each grasp; hands that did not reach their grasp are left out.
        protocol: Settings of the holding test.
        progress: Called as the test advances.

    Returns:
        A result for each answer that was tested; only the last one may have held.

    Raises:
        ObjectError: The object encloses no volume.
        EnvironmentFailure: The object cannot be cut into pieces.
    """
    reached = [(k, answer) for k, answer in enumerate(answers) if answer.grasp is not None]
    if not reached:
        return []
    physical = physics_hand(hand)
    progress("cutting the object into convex pieces, once for an object", 0.0)
    pieces = decompose(mesh)
    n, poses = len(reached), poses_of([answer for _, answer in reached])
    grasps = palm_grasps(hand, [mesh.name] * n, [1.0] * n, poses).for_hand(physical)
    scene = build_scene(physical, pieces, 1.0, protocol)
    results: list[HoldResult] = []
    for row, (index, _) in enumerate(reached):
        told = _steps(progress, protocol, row, n)
        result = hold_test(
            scene, grasps.poses(row), protocol, row=index, object_name=mesh.name, observer=told
        )
        results.append(result)
        if result.held:
            break
    return results


def _steps(progress: Progress, protocol: HoldProtocol, row: int, of: int) -> Callable[[str, Any], None]:
    """Observer of one holding test."""
    return _told(progress, ("grasp", "squeeze", *(load.name for load in protocol.loads())), row, of)


def _told(progress: Progress, steps: Sequence[str], row: int, of: int) -> Callable[[str, Any], None]:
    """Observer of one test, which tells the progress whenever another step of the test begins."""
    told: set[str] = set()

    def observer(step: str, _: Any) -> None:
        if step not in told:
            share = (row + len(told) / len(steps)) / of
            told.add(step)
            progress(f"trying answer {row + 1} of {of} in simulated physics: {step}", share)

    return observer


def worth_remembering(result: HoldResult, rules: HoldProtocol, own_mass: float) -> bool:
    """Whether a test result is evidence about the grasp and the real object.

    It is not if the grasp held an object lighter or rougher than the real one, if it lost one heavier or
    smoother, or if the simulation broke off.

    Args:
        result: Result of one grasp.
        rules: Settings of the test.
        own_mass: The object's own mass [kg].
    """
    if result.status is HoldStatus.HELD:
        return rules.mass >= own_mass and rules.friction <= FRICTION
    lost = result.status is HoldStatus.LOST
    return lost and rules.mass <= own_mass and rules.friction >= FRICTION
