"""The motion of a hand from open and away to the squeeze, as poses of its links."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..exceptions import InputError
from ..hands.hand import Hand
from ..hands.kinematics import HandKinematics, LinkShape, pose_matrix
from ..types import Array, freeze, frozen_array, value
from .raycast import Shape
from .shapes import link_shape

STEPS = 12
"""Frames from one stage to the next."""


@value
class HandMotion:
    """The links of a hand and their poses in each frame.

    Attributes:
        links: m names.
        shapes: (m) Shape of each link in the link's own frame [m].
        stages: k names, for example ``open``; stage i is frame ``STEPS`` · i.
        poses: (n, m, 4, 4) Pose of each link in the scene; n = ``STEPS`` · (k - 1) + 1.

    Raises:
        InputError: The numbers of links, shapes, stages and poses do not agree.
    """

    links: tuple[str, ...]
    shapes: tuple[Shape, ...]
    stages: tuple[str, ...]
    poses: Array

    def __post_init__(self) -> None:
        n, m = STEPS * (len(self.stages) - 1) + 1, len(self.links)
        freeze(self, poses=frozen_array(self.poses, (n, m, 4, 4), "poses of a hand's links"))
        if len(self.shapes) != m:
            raise InputError(f"a hand's motion needs a shape for each of {m} links, got {len(self.shapes)}")

    def __len__(self) -> int:
        return len(self.poses)

    def at(self, fraction: float) -> Array:
        """(m, 4, 4) Poses of the links at a fraction 0..1 of the motion."""
        return np.asarray(self.poses[round(min(1.0, max(0.0, fraction)) * (len(self.poses) - 1))])

    def stage_at(self, fraction: float) -> str:
        """Name of the stage nearest to a fraction 0..1 of the motion."""
        return self.stages[round(min(1.0, max(0.0, fraction)) * (len(self.stages) - 1))]


def hand_motion(hand: Hand, stages: Sequence[tuple[str, Array, Array]]) -> HandMotion:
    """The motion of a hand through stages, with a smooth start and stop at each.

    Args:
        hand: The hand.
        stages: For each stage its name, the palm pose (7,) as xyz [m] and quaternion wxyz, and the joint
            angles (j,) [rad].

    Raises:
        InputError: There are no stages, or a pose or an angle is not finite, or a quaternion is zero.
    """
    if not stages:
        raise InputError("a hand's motion needs at least one stage")
    kinematics = HandKinematics(hand)
    palms = [frozen_array(palm, (7,), f"palm pose {name!r}") for name, palm, _ in stages]
    joints = [
        frozen_array(angles, (len(hand.joints),), f"joint angles {name!r}") for name, _, angles in stages
    ]
    for (name, _, _), palm in zip(stages, palms, strict=True):
        if not palm[3:].any():
            raise InputError(f"the quaternion of palm pose {name!r} must not be zero")
    kinematics.set_posture(joints[0])
    links = kinematics.shapes()
    frames = [(palms[0], joints[0])]
    time = np.arange(1, STEPS + 1) / STEPS
    eased = time * time * (3 - 2 * time)
    for k in range(1, len(stages)):
        between = _interpolated(palms[k - 1], palms[k], eased)
        frames += [
            (palm, joints[k - 1] + fraction * (joints[k] - joints[k - 1]))
            for palm, fraction in zip(between, eased, strict=True)
        ]
    poses: list[list[Array]] = []
    for palm, angles in frames:
        kinematics.set_posture(angles)
        rotation, shift = pose_matrix(palm)
        poses.append([_link_pose(part, rotation, shift) for part in kinematics.shapes()])
    return HandMotion(
        links=tuple(f"{i}-{part.link}" for i, part in enumerate(links)),
        shapes=tuple(link_shape(part, own_frame=True) for part in links),
        stages=tuple(name for name, _, _ in stages),
        poses=np.array(poses),
    )


def _link_pose(part: LinkShape, rotation: Array, shift: Array) -> Array:
    """(4, 4) Pose of a link in the scene, for a palm with this ``rotation`` and ``shift``."""
    pose = np.eye(4)
    pose[:3, :3] = rotation @ part.rotation
    pose[:3, 3] = rotation @ ((part.p0 + part.p1) / 2) + shift
    return pose


def _interpolated(start: Array, end: Array, fractions: Array) -> Array:
    """(n, 7) Poses between two poses: positions on a line, rotations along the shorter arc."""
    from scipy.spatial.transform import Rotation, Slerp

    turn = Slerp([0.0, 1.0], Rotation.from_quat([start[3:], end[3:]], scalar_first=True))
    positions = start[:3] + fractions[:, None] * (end[:3] - start[:3])
    return np.column_stack([positions, turn(fractions).as_quat(scalar_first=True)])
