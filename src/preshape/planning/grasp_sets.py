"""Grasps that were planned here, as a set for the tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..hands.hand import Hand
from ..physics.grasps import STAGES, GraspSet
from ..physics.hand import PhysicsHand
from ..types import Array
from .hand_simulation import HandResult


def palm_grasps(
    hand: Hand | PhysicsHand, objects: Sequence[str], scale: Sequence[float], poses: Mapping[str, Array]
) -> GraspSet:
    """Grasps as palm poses in the frames of their objects, which stand at the origin.

    Args:
        hand: whose.
        objects: (n,) names.
        scale: (n,) factor on each object's size.
        poses: of each stage (n, 7 + j) palm pose and joint angles [m, rad].

    Raises:
        InputError: an array of the wrong shape.
    """
    return GraspSet(
        hand=hand.source,
        joints=hand.joints,
        objects=tuple(objects),
        scale=np.array(scale),
        object_pose=np.tile([0.0, 0, 0, 1, 0, 0, 0], (len(objects), 1)),
        frame="palm",
        pregrasp=poses["pregrasp"],
        grasp=poses["grasp"],
        squeeze=poses["squeeze"],
    )


def poses_of(results: Sequence[HandResult]) -> dict[str, Array]:
    """Of each stage (n, 7 + j) palm pose and joint angles, where hands reached their grasps [m, rad]."""
    stages = {stage: [getattr(result, stage) for result in results] for stage in STAGES}
    return {
        stage: np.array([[*pose.palm_pose, *pose.q] for pose in poses]) for stage, poses in stages.items()
    }
