"""One planned grasp in recorded physics: the test, its verdict, and a row for each stage."""

from __future__ import annotations

from typing import Any

from ..hands.hand import Hand
from ..physics.grasps import GraspSet
from ..physics.hand import physics_hand
from ..physics.hold.recording import HoldRecording, record_hold
from ..physics.hold.six_directions import HoldResult, Observer
from ..physics.pick.objects import PickAnswer, PickObject
from ..physics.pick.protocol import PickProtocol, PickResult
from ..physics.pick.recording import PickRecording, record_answer
from ..physics.pick.runner import pick_scene
from ..physics.pieces import ConvexPieces
from ..physics.protocol import HoldProtocol
from ..physics.scene import Scene, build_scene
from ..types import value
from .grasp_sets import PlannedJob

AnyRecording = HoldRecording | PickRecording


@value
class RecordedRun:
    """A recorded test of one grasp.

    Attributes:
        recording: The recording, with the result.
        scene: The scene of the test.
        rules: Its settings.
    """

    recording: AnyRecording
    scene: Scene
    rules: HoldProtocol | PickProtocol


def recorded_run(
    grasps: GraspSet,
    row: int,
    hand: Hand,
    pieces: ConvexPieces,
    protocol: HoldProtocol,
    job: PlannedJob | None,
    *,
    name: str = "",
    observer: Observer | None = None,
) -> RecordedRun:
    """Record the test of one grasp: on a table pick the object up and do the job, in free space hold it.

    Args:
        grasps: The grasps in the form for simulation, see :meth:`GraspSet.for_hand`.
        row: Row of the grasp.
        hand: The hand.
        pieces: Convex pieces of the object at scale 1.
        protocol: Settings of the holding test; of a job, mass and friction count only.
        job: How the object rests, and what is to be done with it; ``None`` in free space.
        name: Name of the object; by default the one in ``grasps``.
        observer: Called at every check with the stage and the ``mujoco.MjData``, beside the recorder.
    """
    physical, scale = physics_hand(hand), float(grasps.scale[row])
    more: dict[str, Any] = {
        "row": row, "object_name": name or grasps.objects[row], "scale": scale, "observer": observer,
    }  # fmt: skip
    if job is None:
        scene = build_scene(physical, pieces, scale, protocol)
        held = record_hold(scene, grasps.poses(row), protocol, parts=part_names(scene, hand), **more)
        return RecordedRun(recording=held, scene=scene, rules=protocol)
    rules = PickProtocol(friction=protocol.friction, do=True)
    thing = PickObject(name=grasps.objects[row], mass=protocol.mass, scale=scale)
    scene = pick_scene(physical, pieces, thing, job.turn, rules)
    answer = PickAnswer(poses=grasps.poses(row), way_in=job.way_in, turn=job.turn, work=job.work)
    picked = record_answer(scene, answer, rules, parts=part_names(scene, hand), **more)
    return RecordedRun(recording=picked, scene=scene, rules=rules)


def passed(recording: AnyRecording) -> bool:
    """Whether the hand held the object, and on a table did the job with it."""
    result = recording.result
    return result.done if isinstance(result, PickResult) else result.held


def stage_rows(recording: AnyRecording) -> list[dict[str, Any]]:
    """For each stage, how far the object moved, and the largest force and slip."""
    probes = recording.result.probes if isinstance(recording.result, HoldResult) else ()
    outcome = {probe.name: probe for probe in probes}
    rows = []
    for stage in recording.stages:
        probe, span = outcome.get(stage), recording.span(stage)
        moved, turned = (probe.displacement, probe.rotation) if probe else recording.moved(stage)
        rows.append(
            {
                "stage": stage,
                "start": float(recording.times[span.start]),
                "end": float(recording.times[span.stop - 1]),
                "displacement": moved,
                "rotation": turned,
                "largest_force": recording.largest_force(stage),
                "slip": recording.largest_slip(stage),
                "touching": [
                    name
                    for name, force in zip(recording.parts, recording.normal[span.stop - 1], strict=True)
                    if force > 0
                ],
                "gap": float(recording.gap[span.stop - 1]),
                "held": probe.held if probe else None,
            }
        )
    return rows


def verdict(recording: AnyRecording, protocol: HoldProtocol) -> str:
    """One sentence on the outcome."""
    result = recording.result
    if isinstance(result, PickResult):
        if not result.picked:
            return f"Not picked up, {result.status.value}: {result.reason}."
        return f"{'Done' if result.done else 'Not done'}: {result.reason}."
    if not result.held:
        return f"Not held: {result.reason.removeprefix('lost the object: ')}."
    worst = max(result.probes, key=lambda probe: probe.displacement)
    load = protocol.acceleration * protocol.mass
    return (
        f"Held: {load:g} N from {len(result.probes)} sides moved the object at most "
        f"{1e3 * worst.displacement:.1f} mm ({worst.name})."
        if protocol.probes == "six"
        else f"Held: under {len(result.probes)} forces and torques the object moved at most "
        f"{1e3 * worst.displacement:.1f} mm ({worst.name})."
    )


def part_names(scene: Scene, hand: Hand) -> tuple[str, ...]:
    """``palm`` and the names of the fingers, in the order of ``scene.part_of_body``."""
    names = ["palm", *(f"finger {k + 1}" for k in range(scene.fingers))]
    for finger in hand.fingers:
        if finger.tip_body in scene.body_names:
            part = int(scene.part_of_body[scene.body_names.index(finger.tip_body)])
            if part > 0:
                names[part] = finger.name
    return tuple(names)
