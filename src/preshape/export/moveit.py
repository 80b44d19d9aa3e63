"""Planned grasps as ``moveit_msgs/msg/Grasp``: plain dictionaries that mirror the message field by field.

Frames and signs (see the drawing in ``docs/ros.md``): ``grasp_pose`` is the pose of the end effector's parent
link in the object's frame; approach and retreat are unit vectors in the frame named in their header. The
message has no fields for the table and boxes of a plan.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from ..exceptions import InputError, shown
from ..spatial import inverse, pose, pose_from_seven, seven_from_pose
from ..types import Array, freeze, frozen_array, value
from .forces import contact_forces
from .planned import PlannedGrasp

Message = dict[str, Any]

REACH_SECONDS, SQUEEZE_SECONDS = 1.0, 0.5
"""Time for the fingers to reach a posture, and time from first touch to the squeeze [s] [C]."""
LEAST = 0.5
"""Smallest share of the approach or retreat distance that must be free [C]."""


@value
class MoveItOptions:
    """Names of frames and links on the receiving robot, and the approach and retreat distances.

    Attributes:
        frame: Name of the object's frame, which is that of the mesh file.
        parent_link: The end effector's parent link; empty for the root body of the hand's model.
        mount: (7,) Pose of the hand's root in a parent link that belongs to the robot, xyz [m] and quaternion
            wxyz; ``None`` if the parent link is a body of the hand.
        touch_objects: Names of the objects that may be touched; empty for the object's own name.
        approach_distance: Length of the straight way in, and of the way out after placing [m].
        retreat_distance: Length of the lift after the grasp [m].
        up_frame: Frame along whose +z the object is lifted; empty to lift it against the plan's gravity, in
            ``frame``.

    Raises:
        InputError: A name or a distance cannot be used.
    """

    frame: str = "object"
    parent_link: str = ""
    mount: Array | None = None
    touch_objects: tuple[str, ...] = ()
    approach_distance: float = 0.1
    retreat_distance: float = 0.1
    up_frame: str = ""

    def __post_init__(self) -> None:
        for option, name, needed in (
            ("--frame", self.frame, True),
            ("--parent-link", self.parent_link, False),
            ("--up-frame", self.up_frame, False),
        ):
            if (needed and not name) or name.startswith("/") or " " in name or not name.isprintable():
                raise InputError(
                    f"{option} needs a frame's name without spaces and leading /, in printable characters,"
                    f" got {shown(name)}"
                )
        for name in self.touch_objects:
            if not name.strip() or not name.isprintable():
                raise InputError(f"--object-name needs a name in printable characters, got {shown(name)}")
        for option, distance in (
            ("--approach-distance", self.approach_distance),
            ("--retreat-distance", self.retreat_distance),
        ):
            if not 0 < distance <= 10:
                raise InputError(f"{option} must be more than 0 and at most 10 m, got {distance}")
        if self.mount is not None:
            mount = frozen_array(self.mount, (7,), "--mount")
            if abs(float(np.linalg.norm(mount[3:])) - 1.0) > 1e-3:
                raise InputError(f"--mount must end in a unit quaternion w x y z, got {mount[3:].tolist()}")
            freeze(self, mount=mount)


def moveit_grasps(grasps: tuple[PlannedGrasp, ...], options: MoveItOptions) -> list[Message]:
    """One ``moveit_msgs/msg/Grasp`` for each grasp, in the same order.

    Raises:
        InputError: There is no such parent link; the message lists the possible ones.
    """
    return [_message(grasp, options) for grasp in grasps]


def parent_link(grasp: PlannedGrasp, options: MoveItOptions) -> tuple[str, Array]:
    """Name of the end effector's parent link, and its pose (4, 4) in the palm frame.

    Raises:
        InputError: The link moves with the fingers, or it is not in the hand and ``mount`` is not given.
    """
    import mujoco

    from ..hands.kinematics import compile_hand

    hand, name = grasp.hand, options.parent_link
    model = compile_hand(hand)  # its world frame is the palm frame
    still = [body for body in range(1, model.nbody) if model.body_weldid[body] == 0]
    names = {model.body(body).name: body for body in still}
    if not name or name in names:
        if options.mount is not None and name:
            raise InputError(f"--mount is the hand's pose on a link of the robot, but {name} is the hand's")
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        body = names[name] if name else 1
        T_palm_link = pose(data.xmat[body].reshape(3, 3), data.xpos[body])
        return model.body(body).name, T_palm_link
    if name in {model.body(body).name for body in range(1, model.nbody)}:
        raise InputError(
            f"--parent-link {name} moves with the fingers; links that do not: {', '.join(names)}"
        )
    if options.mount is None:
        raise InputError(
            f"the hand {hand.name} has no link {name!r}, only {', '.join(names)}; if it is a link of the "
            'robot, give the pose of the hand\'s root in it, such as --mount "0 0 0 1 0 0 0" (x y z w x y z)'
        )
    return name, inverse(hand.T_root_palm) @ inverse(pose_from_seven(options.mount))


def messages_yaml(messages: list[Message], heading: str = "") -> str:
    """Messages as a YAML stream, one document each, in the form that ``ros2 topic pub --yaml-file`` reads.

    Args:
        messages: Messages as nested dictionaries and lists.
        heading: Comment lines at the beginning.

    >>> print(messages_yaml([{"id": "a", "p": {"x": 1e-7, "y": 2.0}, "points": [{"t": [1]}]}]), end="")
    id: a
    p: {x: 1.0e-07, 'y': 2.0}
    points:
    - t: [1]
    """
    import yaml

    class Dumper(yaml.SafeDumper):  # type: ignore[misc]
        """PyYAML's dumper that also quotes text which other YAML 1.1 readers take for a bool or float."""

    for kind, pattern, first in (
        ("bool", "[yYnN]", "yYnN"),
        ("float", r"[-+]?\d+[eE][-+]?\d+", "-+0123456789"),
    ):
        Dumper.add_implicit_resolver(f"tag:yaml.org,2002:{kind}", re.compile(f"^{pattern}$"), list(first))
    text = yaml.dump_all(messages, Dumper=Dumper, sort_keys=False, default_flow_style=None, width=math.inf)
    return "".join(f"# {line}\n" for line in heading.splitlines()) + text


def _message(grasp: PlannedGrasp, options: MoveItOptions) -> Message:
    _, T_palm_link = parent_link(grasp, options)
    seven = seven_from_pose(pose_from_seven(grasp.palm_pose) @ T_palm_link)
    forces = contact_forces(grasp) if grasp.forces is None else grasp.forces
    normal = np.einsum("ni,ni->n", forces, grasp.normals_in)
    up = np.array([0.0, 0, 1]) if options.up_frame else grasp.up
    approach = grasp.approach / np.linalg.norm(grasp.approach)
    names = grasp.hand.joints
    # Motion planners refuse targets beyond the limits; the efforts are the torques of the unclipped target.
    inside = np.clip(grasp.squeeze, *grasp.hand.limits.T)
    reach, press = REACH_SECONDS, REACH_SECONDS + SQUEEZE_SECONDS
    return {
        "id": f"{grasp.object_name}/{grasp.task}/{grasp.hand.name}/{grasp.label}",
        "pre_grasp_posture": joint_trajectory(names, [trajectory_point(grasp.pregrasp, None, reach)]),
        "grasp_posture": joint_trajectory(
            names,
            [
                trajectory_point(grasp.grasp, grasp.efforts, reach),
                trajectory_point(inside, grasp.efforts, press),
            ],
        ),
        "grasp_pose": {
            "header": _header(options.frame),
            "pose": {
                "position": dict(zip("xyz", seven[:3].tolist(), strict=True)),
                "orientation": dict(zip("xyzw", seven[[4, 5, 6, 3]].tolist(), strict=True)),
            },
        },
        "grasp_quality": grasp.quality,
        "pre_grasp_approach": _translation(options.frame, approach, options.approach_distance),
        "post_grasp_retreat": _translation(options.up_frame or options.frame, up, options.retreat_distance),
        "post_place_retreat": _translation(options.frame, -approach, options.approach_distance),
        "max_contact_force": float(max(0.0, normal.max(initial=0.0))),
        "allowed_touch_objects": list(options.touch_objects or (grasp.object_name,)),
    }


def _header(frame: str) -> Message:
    # Time zero asks tf2 for the latest transform.
    return {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}


def joint_trajectory(joints: tuple[str, ...], points: list[Message]) -> Message:
    """A ``trajectory_msgs/msg/JointTrajectory``."""
    return {"header": _header(""), "joint_names": list(joints), "points": points}


def trajectory_point(positions: Array, efforts: Array | None, seconds: float) -> Message:
    """A ``JointTrajectoryPoint``: positions and efforts of the joints, and the time from the start [s]."""
    whole = int(seconds)
    return {
        "positions": positions.tolist(),
        "velocities": [],
        "accelerations": [],
        "effort": [] if efforts is None else efforts.tolist(),
        "time_from_start": {"sec": whole, "nanosec": round((seconds - whole) * 1e9)},
    }


def _translation(frame: str, direction: Array, distance: float) -> Message:
    return {
        "direction": {
            "header": _header(frame),
            "vector": dict(zip("xyz", (direction + 0.0).tolist(), strict=True)),
        },
        "desired_distance": distance,
        "min_distance": LEAST * distance,
    }
