"""Turn the grasps of plans and of new answers into sets for the tests in physics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import EnvironmentFailure, InputError, TaskError
from ..files import MOST_OF_JSON, loads, read_file
from ..hands.hand import Hand
from ..objects.read_text import printable
from ..physics.grasps import STAGES, Fault, GraspSet, read_grasps
from ..physics.hand import PhysicsHand
from ..physics.locate import object_extent, plan_object
from ..physics.task.motion import TaskMotion
from ..spatial import checked_pose, pose_from_seven, quaternion_from_rotation
from ..types import FIELD_MASS, FRICTION, Array, frozen_array, value
from .document import obstacles_of, planned_load
from .hand_simulation import HandResult

_ORIGIN = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)

LONGEST_SOURCE = 4096
"""Largest number of characters of an object's path in a plan: no file system takes more."""


@value
class PlannedJob:
    """How the object of a grasp rests on its table, and what is to be done with it.

    Attributes:
        turn: Quaternion wxyz from the object's frame to the world in which it rests.
        way_in: Unit vector along which the hand approaches, in the object's frame.
        work: Motion and load of the task, in the object's frame; ``None`` for a task without motion.
    """

    turn: tuple[float, ...]
    way_in: tuple[float, ...]
    work: TaskMotion | None


@value
class PlannedFor:
    """What a grasp was planned for; the defaults are those of grasp arrays.

    Attributes:
        mass: Mass of the object [kg].
        friction: Friction coefficient between hand and object.
        obstacles: Table and boxes of the plan in words, such as ``the table``; empty for free space.
        job: What is done on the table; ``None`` in free space.
    """

    mass: float = FIELD_MASS
    friction: float = FRICTION
    obstacles: str = ""
    job: PlannedJob | None = None


@value
class GraspFile:
    """The grasps of a file.

    Attributes:
        grasps: n grasps.
        planned_for: Mass, friction and obstacles that each grasp was planned for.
    """

    grasps: GraspSet
    planned_for: tuple[PlannedFor, ...]


def read_grasp_file(path: str | Path, *, objects: str | Path | None = None, best: bool = False) -> GraspFile:
    """Read the grasps of a plan JSON (one plan or a list of plans) or of an npz.

    Args:
        path: The file.
        objects: Folder of objects; a plan's object is looked for there first.
        best: Whether a plan without an answer gives the best grasp that was found.

    Raises:
        InputError: The file is neither of the two, or one of its parts is missing or has the wrong shape.
        EnvironmentFailure: The file cannot be read.
    """
    path = Path(path)
    try:
        content = read_file(path, MOST_OF_JSON, "grasp file")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise EnvironmentFailure(f"cannot read {path}: {reason}") from error
    if content[:2] == b"PK":
        grasps = read_grasps(path)
        return GraspFile(grasps=grasps, planned_for=(PlannedFor(),) * len(grasps))
    try:
        document = loads(content)
    except ValueError as error:
        raise InputError(
            f"{path}: neither an npz of grasps nor a plan in JSON ({printable(error)})"
        ) from error
    plans = document if isinstance(document, list) else [document]
    return grasps_from_plans(plans, str(path), folder=objects, beside=path.parent, best=best)


def grasps_from_plans(
    documents: Sequence[Any],
    name: str,
    *,
    folder: str | Path | None = None,
    beside: Path | None = None,
    best: bool = False,
) -> GraspFile:
    """The grasps of plans (``preshape/schema/plan.schema.json``), with the object at the world's origin.

    Every answer and every alternative is one row. If its hand has no posture, the row is marked as faulty.

    Args:
        documents: Parsed plans.
        name: File of the plans, for messages.
        folder: Folder of objects, see :func:`preshape.physics.locate.plan_object`.
        beside: Folder of the plans.
        best: Whether a plan without an answer gives the best grasp that was found.

    Raises:
        InputError: A document is not a plan, the plans are for different hands, or there is no plan.
    """
    rows: list[dict[str, Any]] = []
    hands: list[tuple[str, tuple[str, ...]]] = []
    faults: list[Fault] = []
    planned_for: list[PlannedFor] = []
    extents: dict[str, float] = {}
    for index, document in enumerate(documents):
        try:
            load = _load(document)
            thing, answers = document["object"], [document, *document.get("alternatives", [])]
            if best and document.get("best"):
                answers = [document["best"]]
            stored = str(thing["source"])
            if len(stored) > LONGEST_SOURCE:
                raise ValueError(f"the object's source has {len(stored)} characters")
            source = plan_object(stored, folder, beside)
            if source not in extents:  # a missing object gets an arbitrary extent; the test reports it
                extents[source] = object_extent(source, folder) or 1.0
            scale = float(max(thing["extents"])) / extents[source]
            for answer in answers:
                hand = answer["hand"]
                hands.append((str(hand.get("source") or hand["name"]), tuple(map(str, hand["joints"]))))
                missing = [stage for stage in STAGES if hand[stage] is None]
                if missing:
                    why = hand.get("reason") or document.get("reason")
                    if document.get("best") and not best:
                        why = f"{why}; --best takes the best grasp that was found, which is not good enough"
                    faults.append(Fault(row=len(rows), reason=f"the plan has no {missing[0]}: {why}"))
                rows.append({"object": source, "scale": scale, **_postures(hand)})
                planned_for.append(replace(load, job=_job(document, answer)))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError, OSError) as error:
            raise InputError(
                f"{name}: plan {index} is not a plan of this program "
                f"({type(error).__name__}: {printable(error)})"
            ) from error
    if not rows:
        raise InputError(f"{name}: no plan in it")
    if len(set(hands)) > 1:
        names = printable(", ".join(sorted({hand for hand, _ in hands})))
        raise InputError(f"{name}: plans for different hands ({names}); give the plans of one hand")
    stages: dict[str, Any] = {stage: _matrix([row[stage] for row in rows], stage) for stage in STAGES}
    grasps = GraspSet(
        hand=hands[0][0],
        joints=hands[0][1],
        objects=tuple(row["object"] for row in rows),
        scale=np.array([row["scale"] for row in rows]),
        object_pose=np.tile(_ORIGIN, (len(rows), 1)),
        frame="palm",
        faults=tuple(faults),
        **stages,
    )
    return GraspFile(grasps=grasps, planned_for=tuple(planned_for))


def planned_for(answer: Mapping[str, Any]) -> PlannedFor:
    """What one answer of a plan was planned for.

    Args:
        answer: The plan, or one of its alternatives, as JSON.

    Raises:
        InputError: It does not say so, or a pose or a direction is none.
    """
    return replace(_load(dict(answer)), job=_job(answer, answer))


def _load(document: dict[str, Any]) -> PlannedFor:
    mass, friction = planned_load(document)
    return PlannedFor(mass=mass, friction=friction, obstacles=obstacles_of(document))


def _job(document: Mapping[str, Any], answer: Mapping[str, Any]) -> PlannedJob | None:
    """What an answer is to do on its table; ``None`` without a table.

    Raises:
        InputError: A pose or a direction is none.
    """
    scene = document.get("scene")
    if scene is None or scene["table"] is None or answer["way_in"] is None:
        return None
    turn = checked_pose(
        pose_from_seven(frozen_array(scene["T_world_object"], (7,), "T_world_object")), "rest"
    )
    way_in = frozen_array(answer["way_in"], (3,), "way_in")
    try:
        work = TaskMotion(
            displacement=scene["motion"],
            cog=document["cog"],
            half_extent=max(document["object"]["extents"]) / 2,
            gravity=scene["gravity"],
        )
    except TaskError:
        work = None
    return PlannedJob(
        turn=tuple(quaternion_from_rotation(turn[:3, :3]).tolist()), way_in=tuple(way_in.tolist()), work=work
    )


def palm_grasps(
    hand: Hand | PhysicsHand, objects: Sequence[str], scale: Sequence[float], poses: Mapping[str, Array]
) -> GraspSet:
    """Grasps as palm poses in the frames of their objects, which stand at the origin.

    Args:
        hand: The hand.
        objects: (n,) names of the objects.
        scale: (n,) factor on each object's size.
        poses: For each stage, (n, 7 + j) palm pose and joint angles [m, rad].

    Raises:
        InputError: An array has the wrong shape.
    """
    return GraspSet(
        hand=hand.source,
        joints=hand.joints,
        objects=tuple(objects),
        scale=np.array(scale),
        object_pose=np.tile(_ORIGIN, (len(objects), 1)),
        frame="palm",
        pregrasp=poses["pregrasp"],
        grasp=poses["grasp"],
        squeeze=poses["squeeze"],
    )


def poses_of(results: Sequence[HandResult]) -> dict[str, Array]:
    """For each stage, (n, 7 + j) palm poses and joint angles of hands that reached their grasps [m, rad]."""
    stages = {stage: [getattr(result, stage) for result in results] for stage in STAGES}
    return {
        stage: np.array([[*pose.palm_pose, *pose.q] for pose in poses]) for stage, poses in stages.items()
    }


def poses_with_gains(hand: Hand, result: HandResult, gains: Array | None) -> dict[str, Array]:
    """The poses (1, 7 + j) of each stage of a hand that reached its grasp, for motors with other gains.

    The squeeze aims beyond the grasp by the motor's torque divided by its gain; another gain needs another
    aim for the same torque.

    Args:
        hand: The hand that was planned for.
        result: What the hand made of the grasp.
        gains: (m,) gains of the motors that execute it [N m/rad]; ``None`` for the hand's own.
    """
    poses = poses_of([result])
    if gains is not None:
        touch = hand.controls(poses["grasp"][:, 7:])
        lead = hand.controls(poses["squeeze"][:, 7:]) - touch
        poses["squeeze"][:, 7:] = hand.follow(touch + lead * hand.gains / gains)
    return poses


def _postures(hand: dict[str, Any]) -> dict[str, list[float]]:
    """Palm pose and joint angles of each stage; zeros for a stage that the hand does not have."""
    return {
        stage: [*_ORIGIN, *[0.0] * len(hand["joints"])]
        if hand[stage] is None
        else [*hand[stage]["palm_pose"], *hand[stage]["q"]]
        for stage in STAGES
    }


def _matrix(rows: list[list[float]], name: str) -> Array:
    """Rows of equal length as an array.

    Raises:
        InputError: The rows are not numbers, or differ in length.
    """
    try:
        return np.array(rows, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: no numbers, or different numbers of joint angles in the plans") from error
