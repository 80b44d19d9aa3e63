"""Contact forces of a planned squeeze, from its joint torques."""

from __future__ import annotations

import numpy as np

from ..hands.kinematics import HandKinematics
from ..spatial import inverse, pose_from_seven, transform_points
from ..types import Array
from .planned import PlannedGrasp


def contact_forces(grasp: PlannedGrasp) -> Array:
    """(n, 3) Force of each contact on the object under the torques of the squeeze [N], mesh frame.

    A contact force f loads the joints between palm and touching link with the torques Jᵀ f, and each motor
    with the sum of its joints' torques times their rates. The result is the least-squares fit to the motors'
    torques
    in the squeeze, and the one of least norm if there are several. Friction in the joints is neglected.
    """
    kinematics = HandKinematics(grasp.hand)
    kinematics.set_posture(grasp.grasp)
    T_mesh_palm = pose_from_seven(grasp.palm_pose)
    points = transform_points(inverse(T_mesh_palm), grasp.points)
    bodies = np.array(
        [_touching(kinematics, name, point) for name, point in zip(grasp.fingers, points, strict=True)],
        dtype=np.int64,
    )
    jacobians = kinematics.point_jacobians(bodies, points)
    rates, drive = grasp.hand.rates(grasp.grasp), grasp.motor_torques
    forces = []
    for J in jacobians:
        loads = rates.T @ J.T
        loaded = np.abs(loads).max(axis=1) > 0
        forces.append(np.linalg.lstsq(loads[loaded], drive[loaded], rcond=1e-9)[0])
    return np.array(forces).reshape(-1, 3) @ T_mesh_palm[:3, :3].T


def _touching(kinematics: HandKinematics, finger: str, point: Array) -> int:
    """The body of a finger whose shape is nearest to a point (3,) in the palm frame [m]."""
    model = kinematics.model
    own = set()
    body = model.body(kinematics.hand.finger(finger).tip_body).id
    while model.body_weldid[body] != 0:
        own.add(int(body))
        body = int(model.body_parentid[body])
    best, nearest = -1, np.inf
    start, end = kinematics.axes()
    for geom in range(model.ngeom):
        if int(model.geom_bodyid[geom]) not in own:
            continue
        along = end[geom] - start[geom]
        length = float(along @ along)
        share = float(np.clip((point - start[geom]) @ along / length, 0, 1)) if length > 0 else 0.0
        distance = float(np.linalg.norm(point - start[geom] - share * along)) - kinematics.radii[geom]
        if distance < nearest:
            best, nearest = int(model.geom_bodyid[geom]), distance
    return best
