"""The holding test of one answer in simulated physics, recorded as plain values for playback in a browser."""

from __future__ import annotations

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
from ..physics.hold.recording import HoldRecording, record_hold
from ..physics.pieces import decompose
from ..physics.protocol import HoldProtocol
from ..physics.scene import Scene, build_scene
from ..planning.grasp_sets import palm_grasps
from ..types import Array
from .wire_format import encoded

Progress = Callable[[str, float], None]
"""Called with the current step and the completed share [%]."""


def hold_run(
    hand: Hand,
    mesh: TriangleMesh,
    posed: dict[str, Any],
    *,
    friction: float,
    mass: float,
    progress: Progress,
) -> dict[str, Any]:
    """Grasp, squeeze, and push the object from six sides.

    Args:
        hand: The answer's hand.
        mesh: The object of the plan [m].
        posed: The answer's ``hand`` in JSON, with its postures.
        friction: Friction coefficient between hand and object.
        mass: Mass of the object [kg].
        progress: Called at each step.

    Returns:
        Plain JSON values: the verdict, a row for each push, and for each of n samples its stage, time [s],
        load (6,) [N, N m], the object's pose (7,) and the poses (m, 7) of the hand's shapes in the order of
        :meth:`~preshape.hands.kinematics.HandKinematics.shapes`. Poses are base-64 text.

    Raises:
        InputError: The answer has no grasp of this hand.
        ObjectError: The object encloses no volume.
    """
    if posed.get("grasp") is None or list(posed.get("joints", ())) != list(hand.joints):
        raise InputError("this answer has no grasp of the hand: there is nothing to simulate")
    protocol = HoldProtocol(friction=friction, mass=mass)
    progress("cutting the object into convex pieces (once for an object)", 10)
    pieces = decompose(mesh)
    progress("building the scene", 40)
    physical = physics_hand(hand)
    scene = build_scene(physical, pieces, 1.0, protocol)
    poses = {
        stage: np.array([[*posed[stage]["palm_pose"], *posed[stage]["q"]]], dtype=np.float64)
        for stage in STAGES
    }
    grasps = palm_grasps(hand, [mesh.name], [1.0], poses).for_hand(physical)
    progress("grasping, squeezing, and pushing from six sides", 50)
    recording = record_hold(scene, grasps.poses(0), protocol, object_name=mesh.name)
    return {
        "held": recording.result.held,
        "reason": recording.result.reason,
        "push": protocol.acceleration * protocol.mass,
        "limits": [protocol.displacement_limit, protocol.rotation_limit],
        "rows": _rows(recording),
        "stage": list(recording.stage),
        "times": recording.times.tolist(),
        "load": recording.load.tolist(),
        "object": encoded(recording.object_pose, "<f8"),
        "links": encoded(_links(hand, scene, recording), "<f8"),
    }


def _links(hand: Hand, scene: Scene, recording: HoldRecording) -> Array:
    """(n, m, 7) Pose of each shape of the hand in each sample."""
    kinematics = HandKinematics(hand)
    model = kinematics.model
    bodies = [scene.body_names.index(part.body) for part in kinematics.shapes()]
    own = spatial.pose_from_seven(np.concatenate([model.geom_pos, model.geom_quat], axis=1))
    n, m = len(recording), len(bodies)
    places = spatial.pose_from_seven(recording.bodies[:, bodies].reshape(-1, 7)).reshape(n, m, 4, 4) @ own
    return spatial.seven_from_pose(places)


def _rows(recording: HoldRecording) -> list[dict[str, Any]]:
    return [
        {
            "name": probe.name,
            "held": probe.held,
            "moved": probe.displacement,
            "turned": probe.rotation,
            "force": recording.largest_force(probe.name) if probe.name in recording.stage else None,
            "slip": recording.largest_slip(probe.name) if probe.name in recording.stage else None,
        }
        for probe in recording.result.probes
    ]
