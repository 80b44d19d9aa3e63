"""The answers of a plan that its arm serves: ranked, with the reason of those that fell, or advice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from ..arm.collision import ArmScene, Surface
from ..arm.model import Arm, read_arm
from ..arm.reach import ArmReach, ArmStatus, HandPath, reach, reached_from, refused, ways_of
from ..closure.contact_places import part_mesh
from ..closure.opening import LIFT, WAY_IN
from ..hands.hand import Hand
from ..hiis.decision import Transition
from ..objects.mesh import TriangleMesh, box_mesh
from ..spatial import inverse, pose_from_seven
from ..types import Array
from .answers import Answer, ArmOutcome, PlanRecord, answers_of, without_answer
from .request import PlanRequest

P = TypeVar("P", bound=PlanRecord)

_BELOW = 0.01
"""Depth of the base below the table from which the table is taken to end before it [m] [C]."""
_DISTANCES, _HEIGHTS = (0.6, 0.45, 0.75), (0.0, 0.2, -0.2)
"""Places of the base that are tried when it serves nothing: distance from the object, in lengths of the arm,
and height above where it is [m] [C]."""
_ADVISED_ON = 6  # answers for which these are tried


def arm_of(request: PlanRequest, hand: Hand) -> Arm:
    """The arm of a request with its hand.

    Raises:
        ArmError: The file is no arm, or has no such link.
        EnvironmentFailure: The file cannot be read.
    """
    assert request.arm is not None
    assert request.arm_tip is not None
    assert request.mount is not None
    return read_arm(request.arm, request.arm_tip, hand, pose_from_seven(request.mount))


def with_arm(plan: P, arm: Arm, *, keep: int) -> P:
    """The plan with those of its answers that the arm serves, each with its path.

    Args:
        plan: The plan, with all answers to choose from.
        arm: The arm with the plan's hand.
        keep: Number of answers to keep.

    Returns:
        The plan. If the arm serves none, it has no answer, and its ``best`` is the best of those that fell.
    """
    answers = answers_of(plan)
    if not answers:
        if plan.best is not None:
            none = refused(ArmStatus.NO_POSTURE, "the grasp is not good enough, so the arm was not asked")
            plan = replace(plan, best=replace(plan.best, arm=none))
        return replace(plan, arm=_outcome(plan, arm, 0, (), (), {"kinematics": 0.0, "total": 0.0}))
    T_base_object = base_pose(plan)
    scene, notes = _scene(plan, arm, T_base_object)
    reachable = [k for k, answer in enumerate(answers) if answer.hand_result.grasp is not None]
    paths = [hand_path(plan, answers[k]) for k in reachable]
    found, seconds = reach(arm, scene, paths, T_base_object, plan.settings.seed)
    by_answer: dict[int, ArmReach] = dict(zip(reachable, found, strict=True))
    tested = [
        replace(
            answer,
            arm=by_answer.get(k) or refused(ArmStatus.NO_POSTURE, answer.hand_result.reason),
        )
        for k, answer in enumerate(answers)
    ]
    served = [answer for answer in tested if answer.arm is not None and answer.arm.reached]
    fallen = tuple(answer for answer in tested if answer not in served)
    outcome = _outcome(plan, arm, len(tested), fallen, notes, seconds)
    if not served:
        return _unserved(replace(plan, arm=outcome), tested[0])
    best, first = served[0].grasp, plan.decision.grasp
    decision = replace(plan.decision, grasp=best)
    plan = replace(plan, arm=outcome, answer=served[0], alternatives=tuple(served[1:keep]), decision=decision)
    if not fallen:
        return plan
    why = decision.reason if best is first else f"{best.score_text}: the first answer that the arm reaches"
    why = f"{why}; {fallen_words(fallen, len(tested))}"
    steps = (*decision.transitions, Transition(mode=decision.mode, outcome="reward", reason=why))
    return replace(plan, decision=replace(decision, reason=why, transitions=steps))


def advised(plan: P, arm: Arm) -> P:
    """The plan with what would help, if the arm serves none of its answers."""
    if plan.answer is not None or plan.arm is None or not plan.arm.tested:
        return plan
    fallen = plan.arm.refused
    paths = [hand_path(plan, a) for a in fallen if a.hand_result.grasp is not None][:_ADVISED_ON]
    decision = plan.decision
    why = f"{decision.reason}; {_advice(plan, arm, paths, fallen)}"
    steps = (*decision.transitions[:-1], replace(decision.transitions[-1], reason=why))
    return replace(plan, decision=replace(decision, reason=why, transitions=steps))


def base_pose(plan: PlanRecord) -> Array:
    """(4, 4) Pose of the object's frame in the arm's base."""
    assert plan.request.base_pose is not None
    T_world_base = pose_from_seven(plan.request.base_pose)
    return np.asarray(inverse(T_world_base) @ pose_from_seven(plan.standing.pose))


def hand_path(plan: PlanRecord, answer: Answer) -> HandPath:
    """What the hand of an answer does; it has reached its grasp."""
    result = answer.hand_result
    assert result.grasp is not None
    assert result.pregrasp is not None
    return HandPath(
        palm_pose=result.grasp.palm_pose,
        way_in=answer.way_in,
        back=WAY_IN,
        up=plan.standing.up,
        height=LIFT,
        pregrasp=result.pregrasp.q,
        grasp=result.grasp.q,
    )


def failed_axes(answers: Sequence[Answer]) -> frozenset[str]:
    """The approach axes of answers, such as ``+z``."""
    from ..hiis.planes import axis_name

    return frozenset(axis_name(answer.grasp.plane.approach_axis) for answer in answers)


def fallen_words(fallen: Sequence[Answer], tested: int) -> str:
    """How many answers fell to the arm, and why, as a clause."""
    kinds = Counter(answer.arm.status for answer in fallen if answer.arm is not None)
    parts: list[str] = []
    for kind, count in kinds.most_common():
        why = next(a.arm.reason for a in fallen if a.arm is not None and a.arm.status is kind)
        many = f"{count} of {tested} answers {'are' if count > 1 else 'is'}" if not parts else f"{count}"
        parts.append(f"{many} {kind.value}: {why}")
    return "; ".join(parts)


def _outcome(
    plan: PlanRecord,
    arm: Arm,
    tested: int,
    fallen: tuple[Answer, ...],
    notes: Sequence[str],
    seconds: dict[str, float],
) -> ArmOutcome:
    """The outcome, added to that of answers that were tested before."""
    before = plan.arm
    if before is not None:
        tested, fallen = tested + before.tested, (*before.refused, *fallen)
        seconds = {name: seconds[name] + before.seconds[name] for name in seconds}
    said = tuple(dict.fromkeys([*arm.notes, *notes, *(before.notes if before else ())]))
    return ArmOutcome(arm=arm, tested=tested, refused=fallen, notes=said, seconds=seconds)


def _scene(plan: PlanRecord, arm: Arm, T_base_object: Array) -> tuple[ArmScene, list[str]]:
    """The arm among the object, the table, boxes and obstacles of a plan, and what was assumed of them."""
    request, mesh, table = plan.request, plan.mesh, plan.standing.table
    surfaces = [Surface(name="the object", mesh=mesh, hand_too=False, lifted=True)]
    surfaces += [
        Surface(name=part.name, mesh=part_mesh(part))
        for part in request.obstacle_surfaces(mesh, beyond=2 * arm.length)
    ]
    boxes = np.array(request.avoid, dtype=np.float64).reshape(-1, 2, 3)
    surfaces += [Surface(name="a box to avoid", mesh=_box(*box)) for box in boxes]
    notes: list[str] = []
    radius = np.inf
    if table is not None:
        base = inverse(T_base_object)[:3, 3]
        height = float(base @ table[:3] - table[3])
        if height < -_BELOW:
            radius = 0.5 * float(np.linalg.norm(base - (base @ table[:3]) * table[:3]))
            notes.append(
                f"the arm's base is {100 * -height:.0f} cm below the top of the table, so the table is taken "
                f"to end {100 * radius:.0f} cm from the object"
            )
    scene = ArmScene(arm, T_base_object, table=table, table_radius=radius, surfaces=tuple(surfaces))
    return scene, notes


def _box(low: Array, high: Array) -> TriangleMesh:
    """The surface of a box between two corners."""
    box = box_mesh("box", high - low)
    return replace(box, vertices=box.vertices + (low + high) / 2)


def _advice(plan: PlanRecord, arm: Arm, paths: Sequence[HandPath], fallen: Sequence[Answer]) -> str:
    """What would help an arm that serves no answer, as a clause; collisions of other places do not count."""
    assert plan.request.base_pose is not None
    kinds = {answer.arm.status for answer in fallen if answer.arm is not None}
    if kinds <= {ArmStatus.NO_POSTURE} or not paths:
        return "the hand has no posture on them; another hand or approach would help"
    if kinds <= {ArmStatus.COLLISION, ArmStatus.SELF_COLLISION}:
        return "more room, another --base-pose or --mount, or more answers with --count would help"
    T_world_base = pose_from_seven(plan.request.base_pose)
    T_world_object = pose_from_seven(plan.standing.pose)
    ahead = (T_world_object[:3, :3] @ plan.mesh.cog - T_world_base[:3, 3]) * [1, 1, 0]
    length = float(np.linalg.norm(ahead))
    ahead = ahead / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    most, words, place = 0, "", T_world_base
    for height in _HEIGHTS:
        for share in _DISTANCES:
            moved, distance = T_world_base.copy(), share * arm.length
            moved[:2, 3] = (T_world_object[:3, :3] @ plan.mesh.cog - distance * ahead)[:2]
            moved[2, 3] += height
            ways = ways_of(arm, paths, inverse(moved) @ T_world_object)
            ends = ways.poses[:, [0, ways.at_grasp, -1]].reshape(-1, 4, 4)
            count = int(reached_from(arm, ends, plan.settings.seed).reshape(-1, 3).all(axis=1).sum())
            if count > most:
                most, place, words = count, moved, f"{100 * distance:.0f} cm from the object"
                words += (
                    f" and {100 * abs(height):.0f} cm {'higher' if height > 0 else 'lower'}" if height else ""
                )
    if not most:
        return "another --base-pose, --mount or --approach would help"
    x, y, z = place[:3, 3]
    rest = " ".join(f"{part:.6g}" for part in plan.request.base_pose[3:])
    return (
        f'with its base {words}, --base-pose "{x:.3g} {y:.3g} {z:.3g} {rest}", it would reach {most} of '
        f"{len(paths)}, collisions aside"
    )


def _unserved(plan: P, best: Answer) -> P:
    """The plan without an answer, because the arm serves none."""
    assert plan.arm is not None
    return without_answer(plan, best, fallen_words(plan.arm.refused, plan.arm.tested))
