"""Small arms for the tests, from the published sizes of two robots; their shapes are ours.

Six joints: the Denavit-Hartenberg parameters that Universal Robots publishes for the UR5. Seven joints: the
link lengths in KUKA's data sheet of the LBR iiwa 7 R800. Sizes are facts; no file of either maker is used.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from preshape.hands.hand import Hand
from preshape.hands.kinematics import HandKinematics
from preshape.spatial import inverse, seven_from_pose

HALF, TURN = np.pi / 2, 2 * np.pi


class Joint(NamedTuple):
    """A joint of a chain: its place in the link before, its axis, limits, and the shape of its link."""

    xyz: Sequence[float]
    rpy: Sequence[float] = (0, 0, 0)
    axis: Sequence[float] = (0, 0, 1)
    limits: Sequence[float] | None = (-TURN, TURN)
    kind: str = "revolute"
    shape: str = ""


def capsule(length: float, radius: float, along: str = "z") -> str:
    """A cylinder from the link's origin along an axis."""
    rpy = {"z": "0 0 0", "x": f"0 {HALF} 0", "y": f"{HALF} 0 0"}[along]
    middle = {"z": f"0 0 {length / 2}", "x": f"{length / 2} 0 0", "y": f"0 {length / 2} 0"}[along]
    return (
        f'<collision><origin xyz="{middle}" rpy="{rpy}"/>'
        f'<geometry><cylinder length="{abs(length)}" radius="{radius}"/></geometry></collision>'
    )


def urdf(name: str, joints: Sequence[Joint], tip: Sequence[float], more: str = "") -> str:
    """A chain of links ``link_0`` … with the joints ``joint_1`` … and the link ``tip``."""

    def origin(xyz: Sequence[float], rpy: Sequence[float] = (0, 0, 0)) -> str:
        return f'<origin xyz="{" ".join(map(str, xyz))}" rpy="{" ".join(map(str, rpy))}"/>'

    inertial = (
        '<inertial><mass value="1"/>'
        '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    parts = [f'<robot name="{name}"><link name="link_0">{capsule(0.05, 0.06)}</link>']
    for k, joint in enumerate(joints, start=1):
        limits = "" if joint.limits is None else f'lower="{joint.limits[0]}" upper="{joint.limits[1]}"'
        parts.append(
            f'<joint name="joint_{k}" type="{joint.kind}">'
            f'<parent link="link_{k - 1}"/><child link="link_{k}"/>'
            f'{origin(joint.xyz, joint.rpy)}<axis xyz="{" ".join(map(str, joint.axis))}"/>'
            f'<limit {limits} effort="1" velocity="1"/></joint>'
            f'<link name="link_{k}">{inertial}{joint.shape}</link>'
        )
    parts.append(
        f'<joint name="flange" type="fixed"><parent link="link_{len(joints)}"/><child link="tip"/>'
        f'{origin(tip)}</joint><link name="tip"/>{more}</robot>'
    )
    return "".join(parts)


def six_joints(**changes: Sequence[float]) -> str:
    """The UR5's kinematics; ``joint_3=(0, 1)`` changes the limits of a joint."""
    joints = [
        Joint((0, 0, 0.089159), shape=capsule(0.05, 0.06)),
        Joint((0, 0, 0), (HALF, 0, 0), shape=capsule(-0.425, 0.05, "x")),
        Joint((-0.425, 0, 0), shape=capsule(-0.39225, 0.045, "x")),
        Joint((-0.39225, 0, 0.10915), shape=capsule(0.05, 0.04)),
        Joint((0, -0.09465, 0), (HALF, 0, 0), shape=capsule(0.05, 0.04)),
        Joint((0, 0.0823, 0), (-HALF, 0, 0)),
    ]
    for name, limits in changes.items():
        k = int(name.removeprefix("joint_")) - 1
        joints[k] = joints[k]._replace(limits=limits)
    return urdf("six", joints, (0, 0, 0))


def seven_joints() -> str:
    """The kinematics of an LBR iiwa 7 R800: shoulder and wrist whose axes meet, and an elbow."""
    limits = np.deg2rad([170, 120, 170, 120, 170, 120, 175])
    offsets = (0.34, 0.0, 0.4, 0.0, 0.4, 0.0, 0.126)
    lengths = (0.0, 0.2, 0.2, 0.2, 0.2, 0.1, 0.02)
    turns = (0, -HALF, HALF, HALF, -HALF, -HALF, HALF)
    joints = []
    for k, (turn, limit, length) in enumerate(zip(turns, limits, lengths, strict=True)):
        # In an even link z runs along the arm, in an odd one y does.
        along = (0.0, 0.0, offsets[k]) if k % 2 == 0 and k == 0 else _offset(k, offsets[k])
        shape = capsule(length, 0.05, "z") if k % 2 == 0 and length else ""
        joints.append(Joint(along, (turn, 0, 0), limits=(-limit, limit), shape=shape))
    return urdf("seven", joints, (0, 0, 0.0))


def _offset(k: int, length: float) -> tuple[float, float, float]:
    """Where joint k + 1 is in the link before, whose own turn has moved the arm's direction to ±y."""
    if k % 2:
        return (0.0, 0.0, length)
    return (0.0, -length if k in (2, 6) else length, 0.0)


def written(folder: Path, text: str, name: str = "arm.urdf") -> str:
    """The path of a file with this text."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return str(path)


def packaged(robot: str) -> str:
    """The URDF of a robot of the package example-robot-data."""
    files = importlib.metadata.files("example-robot-data") or []
    return str(next(f.locate() for f in files if str(f).endswith(f"/{robot}")))


PACKAGED = (
    ("ur5_robot.urdf", "tool0", 6),
    ("panda.urdf", "panda_link8", 7),
    ("xarm7.urdf", "link_eef", 7),
)
"""File, tip and number of joints of three arms."""


def mount_along(hand: Hand, gap: float = 0.01) -> list[float]:
    """The mount that points the fingers of an open hand along the tip's +z, its lowest shape a gap away."""
    kinematics = HandKinematics(hand)
    kinematics.set_posture(hand.posture("open"))
    lowest = min(float((s.corners[:, 2] - s.radius).min()) for s in kinematics.shapes())
    T = np.eye(4)
    T[2, 3] = gap - lowest
    return [float(x) for x in seven_from_pose(T @ inverse(hand.T_root_palm))]
