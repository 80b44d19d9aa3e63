"""``--verify``: put planned answers to the holding test, best first, until one holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

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
from .answers import Verified, answers_of
from .grasp_sets import palm_grasps, poses_of
from .hand_simulation import HandResult
from .plan import Plan
from .request import VERIFIED


def verified_plan(plan: Plan, *, keep: int) -> tuple[Plan, list[tuple[Grasp, bool]]]:
    """The plan with the first of its answers that holds, at the plan's own mass and friction.

    Args:
        plan: With all answers that may be tried.
        keep: Number of answers to keep.

    Returns:
        The plan, and the grasps whose outcome is worth remembering, each with whether it held.
    """
    answers = list(answers_of(plan)[: max(keep, VERIFIED)])
    if not answers:
        return plan, []
    rules = HoldProtocol(friction=plan.request.stated_friction, mass=plan.mass.kg, stop_early=True)
    results = hold_until_held(plan.hand, plan.mesh, [a.hand_result for a in answers], protocol=rules)
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
    # An answer that was tried before and lost is no alternative.
    rest = tuple(answers[first + 1 : first + keep])
    return replace(plan, answer=answers[first], alternatives=rest, verified=said), tried


def hold_until_held(
    hand: Hand,
    mesh: TriangleMesh,
    answers: Sequence[HandResult],
    *,
    protocol: HoldProtocol,
    progress: Callable[[int], None] | None = None,
) -> list[HoldResult]:
    """Test answers in their order until one holds.

    The object is cut into convex pieces first, which takes up to two minutes for a scan, once.

    Args:
        hand: The hand.
        mesh: The object, at the size planned for.
        answers: The hand on the object; those that did not reach are left out.
        protocol: The holding test.
        progress: Called with the number of answers tried so far.

    Returns:
        A result for each answer that was tried; only the last one may have held.

    Raises:
        ObjectError: The object encloses no volume.
        EnvironmentFailure: The object cannot be cut into pieces.
    """
    reached = [(k, answer) for k, answer in enumerate(answers) if answer.grasp is not None]
    if not reached:
        return []
    physical = physics_hand(hand)
    pieces = decompose(mesh)
    n, poses = len(reached), poses_of([answer for _, answer in reached])
    grasps = palm_grasps(hand, [mesh.name] * n, [1.0] * n, poses).for_hand(physical)
    scene = build_scene(physical, pieces, 1.0, protocol)
    results: list[HoldResult] = []
    for row, (index, _) in enumerate(reached):
        result = hold_test(
            scene,
            grasps.poses(row),
            protocol,
            row=index,
            object_name=mesh.name,
        )
        results.append(result)
        if progress is not None:
            progress(len(results))
        if result.held:
            break
    return results


def worth_remembering(result: HoldResult, rules: HoldProtocol, own_mass: float) -> bool:
    """Whether a result says something about the grasp as such.

    A grasp that held a lighter or rougher object than the real one says nothing, nor does one that lost a
    heavier or smoother one, or a simulation that broke off.

    Args:
        result: Of one grasp.
        rules: Of the test.
        own_mass: The object's mass where nothing else is said [kg].
    """
    if result.status is HoldStatus.HELD:
        return rules.mass >= own_mass and rules.friction <= FRICTION
    lost = result.status is HoldStatus.LOST
    return lost and rules.mass <= own_mass and rules.friction >= FRICTION
