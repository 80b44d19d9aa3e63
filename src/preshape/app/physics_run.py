"""One answer in simulated physics, as ``preshape simulate`` runs it, as plain values for a browser."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from .. import spatial
from ..exceptions import InputError
from ..hands.hand import Hand
from ..hands.kinematics import HandKinematics
from ..objects.mesh import TriangleMesh
from ..physics.grasps import STAGES
from ..physics.hand import physics_hand
from ..physics.pick.doing import JOB_STAGES
from ..physics.pick.picking import STAGES as PICK_STAGES
from ..physics.pieces import decompose
from ..physics.protocol import HoldProtocol
from ..planning.grasp_sets import PlannedJob, palm_grasps
from ..planning.recorded import RecordedRun, passed, recorded_run, stage_rows
from ..types import Array
from .wire_format import encoded

Progress = Callable[[str, float], None]
"""Called with the current step and the completed share [%]."""
CUT, BUILT = 10.0, 25.0
"""Shares [%] when the object is being cut into pieces, and when the test begins."""


def answer_run(
    hand: Hand,
    mesh: TriangleMesh,
    posed: dict[str, Any],
    *,
    friction: float,
    mass: float,
    job: PlannedJob | None,
    progress: Progress,
) -> dict[str, Any]:
    """Execute an answer: pick the object up from its table and do the job, or hold it in free space.

    Args:
        hand: The answer's hand.
        mesh: The object of the plan [m].
        posed: The answer's ``hand`` in JSON, with its postures.
        friction: Friction coefficient between hand and object.
        mass: Mass of the object [kg].
        job: How the object rests, and what is done with it; ``None`` for six pushes in free space.
        progress: Called at each step.

    Returns:
        Plain JSON values: the verdict, a row for each stage (in free space for each push), and for each of n
        samples its stage, time [s], load (6,) [N, N m], sum of the normal forces [N], largest slip [m], the
        object's pose (7,) and the poses (m, 7) of the hand's shapes in the order of
        :meth:`~preshape.hands.kinematics.HandKinematics.shapes`. All poses and loads are in the mesh frame of
        the object as it was planned for. Poses are base-64 text.

    Raises:
        InputError: The answer has no grasp of this hand.
        ObjectError: The object encloses no volume.
    """
    if posed.get("grasp") is None or list(posed.get("joints", ())) != list(hand.joints):
        raise InputError("this answer has no grasp of the hand: there is nothing to simulate")
    protocol = HoldProtocol(friction=friction, mass=mass)
    progress("cutting the object into convex pieces (once for an object)", CUT)
    pieces = decompose(mesh)
    poses = {
        stage: np.array([[*posed[stage]["palm_pose"], *posed[stage]["q"]]], dtype=np.float64)
        for stage in STAGES
    }
    grasps = palm_grasps(hand, [mesh.name], [1.0], poses).for_hand(physics_hand(hand))
    steps = (*PICK_STAGES, *JOB_STAGES) if job else ("grasp", "squeeze", *(p.name for p in protocol.loads()))
    run = recorded_run(grasps, 0, hand, pieces, protocol, job, observer=_teller(progress, steps))
    recording = run.recording
    turn = spatial.pose_from_seven(np.array([0.0, 0.0, 0.0, *(job.turn if job else (1.0, 0.0, 0.0, 0.0))]))
    # The weight alone, until the task's load sets in, is no news.
    loaded = ~np.isin(recording.stage, (*PICK_STAGES, JOB_STAGES[0]))
    load = recording.load * loaded[:, None]
    return {
        "job": job is not None,
        "passed": passed(recording),
        "reason": recording.result.reason,
        "note": _note(protocol, job is not None),
        "rows": _rows(run),
        "stage": list(recording.stage),
        "times": recording.times.tolist(),
        "load": np.concatenate([load[:, :3] @ turn[:3, :3], load[:, 3:] @ turn[:3, :3]], axis=1).tolist(),
        "press": recording.normal.sum(axis=1).tolist(),
        "slip": recording.slip.max(axis=1, initial=0.0).tolist(),
        "object": encoded(_seen(recording.object_pose, turn), "<f8"),
        "links": encoded(_links(hand, run, turn), "<f8"),
    }


def _teller(progress: Progress, steps: tuple[str, ...]) -> Callable[[str, Any], None]:
    """Observer of a test, which tells the progress whenever another step begins."""
    told: set[str] = set()

    def observer(step: str, _: Any) -> None:
        if step not in told:
            share = BUILT + (100.0 - BUILT) * len(told) / len(steps)
            told.add(step)
            progress(f"simulating: {step}", share)

    return observer


def _note(protocol: HoldProtocol, job: bool) -> str:
    """What was tested, in words."""
    load = f"{protocol.mass:.3g} kg, friction {protocol.friction:g}"
    if job:
        return f"Picked up from the table, turned, and the task done with it, against its load; {load}."
    push = protocol.acceleration * protocol.mass
    far, turn = 1000 * protocol.displacement_limit, math.degrees(protocol.rotation_limit)
    return (
        f"Each push is {push:g} N for 2 s. The object is held while it stays within {far:.0f} mm and "
        f"{turn:.0f}°; {load}."
    )


def _seen(poses: Array, turn: Array) -> Array:
    """Poses (..., 7) of the test's world in the mesh frame of the object as it was planned for."""
    return spatial.seven_from_pose(spatial.inverse(turn) @ spatial.pose_from_seven(poses))


def _links(hand: Hand, run: RecordedRun, turn: Array) -> Array:
    """(n, m, 7) Pose of each shape of the hand in each sample, in the mesh frame."""
    kinematics, recording = HandKinematics(hand), run.recording
    model = kinematics.model
    bodies = [run.scene.body_names.index(part.body) for part in kinematics.shapes()]
    own = spatial.pose_from_seven(np.concatenate([model.geom_pos, model.geom_quat], axis=1))
    n, m = len(recording), len(bodies)
    places = spatial.pose_from_seven(recording.bodies[:, bodies].reshape(-1, 7)).reshape(n, m, 4, 4) @ own
    return spatial.seven_from_pose(spatial.inverse(turn) @ places)


def _rows(run: RecordedRun) -> list[dict[str, Any]]:
    rows = [
        {
            "name": row["stage"],
            "held": row["held"],
            "moved": row["displacement"],
            "turned": row["rotation"],
            "force": row["largest_force"],
            "slip": row["slip"],
        }
        for row in stage_rows(run.recording)
    ]
    return [row for row in rows if row["held"] is not None] or rows
