"""A hand from open and far to the squeeze, as poses of its links: what the slider of a scene shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..exceptions import InputError
from ..hands.hand import Hand
from ..hands.kinematics import HandKinematics, LinkShape, pose_matrix
from ..types import Array, freeze, frozen_array, value
from .colours import HAND
from .raycast import Shape
from .shapes import box, capsule

STEPS = 12
"""Frames from one stage to the next."""


@value
class HandMotion:
    """A hand's links and where they are, frame by frame.

    Attributes:
        links: m names.
        shapes: (m) the shape of each link, in the link's own frame [m].
        stages: k names, as ``open``; frame ``STEPS`` · i is the stage i.
        poses: (n, m, 4, 4) where each link is in the scene, n = STEPS · (k - 1) + 1.
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

    def at(self, share: float) -> Array:
        """(m, 4, 4) poses at a share 0..1 of the motion."""
        return np.asarray(self.poses[round(min(1.0, max(0.0, share)) * (len(self.poses) - 1))])

    def stage_at(self, share: float) -> str:
        """Name of the stage that is nearest to a share 0..1."""
        return self.stages[round(min(1.0, max(0.0, share)) * (len(self.stages) - 1))]


def hand_motion(hand: Hand, stages: Sequence[tuple[str, Array, Array]]) -> HandMotion:
    """The hand led through stages.

    Args:
        hand: which hand.
        stages: each a name, the palm's pose (7,) xyz [m] + wxyz, and the joint angles (j,) [rad].

    Raises:
        InputError: no stages.
    """
    if not stages:
        raise InputError("a hand's motion needs at least one stage")
    kinematics = HandKinematics(hand)
    palms = [np.asarray(stages[0][1], dtype=np.float64)]
    joints = [np.asarray(stages[0][2], dtype=np.float64)]
    for _, palm, q in stages[1:]:
        start, begin = palms[-1], joints[-1]
        for share in np.arange(1, STEPS + 1) / STEPS:
            eased = share * share * (3 - 2 * share)
            palms.append(_between(start, np.asarray(palm, dtype=np.float64), eased))
            joints.append(begin + eased * (np.asarray(q, dtype=np.float64) - begin))
    poses: list[list[Array]] = []
    own: list[Shape] = []
    for palm, q in zip(palms, joints, strict=True):
        kinematics.set_posture(q)
        rotation, shift = pose_matrix(palm)
        parts = kinematics.shapes()
        own = own or [_own(part) for part in parts]
        poses.append([_pose(part, rotation, shift) for part in parts])
    return HandMotion(
        links=tuple(f"{i}-{part.link}" for i, part in enumerate(parts)),
        shapes=tuple(own),
        stages=tuple(name for name, _, _ in stages),
        poses=np.array(poses),
    )


def _own(part: LinkShape) -> Shape:
    """A link's shape in its own frame: the middle at the origin, a capsule along z."""
    if part.kind == "box":
        return box(np.zeros(3), part.half, None, HAND)
    half = np.array([0.0, 0.0, float(np.linalg.norm(part.p1 - part.p0)) / 2])
    return capsule(-half, half, part.radius, HAND)


def _pose(part: LinkShape, rotation: Array, shift: Array) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = rotation @ part.rotation
    pose[:3, 3] = rotation @ ((part.p0 + part.p1) / 2) + shift
    return pose


def _between(a: Array, b: Array, share: float) -> Array:
    """(7,) a pose between two: positions on a line, quaternions on the shorter arc."""
    p, q = a[3:] / np.linalg.norm(a[3:]), b[3:] / np.linalg.norm(b[3:])
    cosine = float(p @ q)
    q, cosine = (-q, -cosine) if cosine < 0 else (q, cosine)
    angle = float(np.arccos(min(1.0, cosine)))
    if angle < 1e-6:
        turn = p + share * (q - p)
    else:
        turn = (np.sin((1 - share) * angle) * p + np.sin(share * angle) * q) / np.sin(angle)
    return np.concatenate([a[:3] + share * (b[:3] - a[:3]), turn / np.linalg.norm(turn)])
