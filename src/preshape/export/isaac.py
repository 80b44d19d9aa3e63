"""Planned grasps as an ``isaac_grasp`` file, which Isaac Sim's grasp editor and Isaac ROS read.

The format is version 1.0 of NVIDIA's specification ("Isaac Grasp File", Isaac ROS documentation; "Grasp
Editor", Isaac Sim documentation): each grasp has a confidence from 0 to 1, the pose of the gripper's frame in
that of the object [m, scalar and vector part of a quaternion], and the positions of the gripper's joints at
the grasp and before it [rad].
"""

from __future__ import annotations

from typing import Any

from ..exceptions import InputError, shown
from ..spatial import pose_from_seven, seven_from_pose
from .moveit import MoveItOptions, parent_link
from .planned import PlannedGrasp

FORMAT, VERSION = "isaac_grasp", 1.0


def isaac_grasps(
    grasps: tuple[PlannedGrasp, ...], options: MoveItOptions, frame: str = "object"
) -> dict[str, Any]:
    """The document of an ``isaac_grasp`` file.

    Args:
        grasps: Grasps of one plan.
        options: Name of the gripper's frame (``parent_link``), and its ``mount``.
        frame: Name of the object's frame, such as a prim's path ``/World/mug``; it is for people.

    Raises:
        InputError: The frame has no printable name, or there is no such parent link; the message lists the
            possible ones.
    """
    if not frame.strip() or not frame.isprintable():
        raise InputError(f"--frame needs a name in printable characters, got {shown(frame)}")
    link, T_palm_link = parent_link(grasps[0], options)
    entries = {}
    for grasp in grasps:
        seven = seven_from_pose(pose_from_seven(grasp.palm_pose) @ T_palm_link).tolist()
        entries[f"grasp_{grasp.label}"] = {
            "confidence": grasp.quality,
            "position": seven[:3],
            "orientation": {"w": seven[3], "xyz": seven[4:]},
            "cspace_position": dict(zip(grasp.hand.joints, grasp.grasp.tolist(), strict=True)),
            "pregrasp_cspace_position": dict(zip(grasp.hand.joints, grasp.pregrasp.tolist(), strict=True)),
        }
    return {
        "format": FORMAT,
        "format_version": VERSION,
        "object_frame_link": frame,
        "gripper_frame_link": link,
        "grasps": entries,
    }
