"""``--verify``: run the holding test on planned answers, in their order, until one holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from ..hands.hand import Hand
from ..hiis.analyser import Grasp
from ..objects.mass import object_mass
from ..objects.mesh import TriangleMesh
from ..physics.hand import physics_hand
from ..physics.hold.six_directions import HoldResult, HoldStatus, hold_test
from ..physics.pieces import decompose
from ..physics.protocol import HoldProtocol
from ..physics.scene import build_scene
from ..types import FRICTION
from .answers import Verified, answers_of, chosen
from .grasp_sets import palm_grasps, poses_of
from .hand_simulation import HandResult
from .plan import Plan
from .request import VERIFIED

Progress = Callable[[str, float], None]
"""Called with what is done and the share of the test that is finished, 0..1."""


def _untold(words: str, share: float) -> None:
    """Tell nobody."""


def verified_plan(
    plan: Plan, *, keep: int, progress: Progress = _untold
) -> tuple[Plan, list[tuple[Grasp, bool]]]:
    """The plan with the first of its answers that holds, tested with the plan's own mass and friction.

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
    results = hold_until_held(
        plan.hand, plan.mesh, [a.hand_result for a in answers], protocol=rules, progress=progress
    )
    reached = [k for k, a in enumerate(answers) if a.hand_result.grasp is not None]
    own_mass = object_mass(plan.mesh).kg
    tried = [
        (answers[k].grasp, result.held)
        for k, result in zip(reached, results, strict=False)
        if worth_remembering(result, rules, own_mass)
    ]
    if not results or not results[-1].held:
        why = results[0].reason if results else "the hand reached none of the answers"
        said = Verified(held=False, tried=len(results), reason=f"no answer held in physics: {why}")
        return replace(plan, alternatives=plan.alternatives[: keep - 1], verified=said), tried
    first = reached[len(results) - 1]
    said = Verified(held=True, tried=len(results), reason=results[-1].reason)
    # An answer that was tested and lost the object is not offered as an alternative.
    rest = tuple(answers[first + 1 : first + keep])
    plan = replace(plan, alternatives=rest, verified=said)
    return chosen(plan, answers[first], "the first answer that held in physics"), tried


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
    """Observer of one test, which tells the progress whenever another step of the test begins."""
    steps = ("grasp", "squeeze", *(load.name for load in protocol.loads()))
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
