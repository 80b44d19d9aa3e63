"""Errors that a real robot makes: the object is not quite where it should be, nor of the size expected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ... import spatial
from ..grasps import GraspSet
from ..pieces import ConvexPieces
from ..protocol import HoldProtocol


def perturbed(grasps: GraspSet, pieces: Mapping[str, ConvexPieces], protocol: HoldProtocol) -> GraspSet:
    """The grasps with the object moved, turned and resized by the protocol's errors, unknown to the hand.

    Each grasp's error depends on the seed and its row only, so any share of a set gets the same ones. Size
    changes by exactly the share given, up or down with equal chance, about the centre of the object's
    bounding box; that centre is moved by exactly the distance given, in any direction alike, and the
    object turned about it by exactly the angle given, about any axis alike [C].

    Args:
        grasps: the grasps as planned.
        pieces: the objects by name; a row without one stays as it is.
        protocol: errors and seed.
    """
    errors = (protocol.position_error, protocol.turn_error, protocol.size_error)
    if not any(errors):
        return grasps
    poses, scale = np.array(grasps.object_pose), np.array(grasps.scale)
    bad = {fault.row for fault in grasps.faults}
    for row, name in enumerate(grasps.objects):
        if row in bad or name not in pieces:
            continue
        random = np.random.default_rng([protocol.seed, row])
        direction, axis = (v / np.linalg.norm(v) for v in random.normal(size=(2, 3)))
        factor = 1.0 + protocol.size_error * random.choice([-1.0, 1.0])
        T = spatial.pose_from_seven(poses[row])
        middle = pieces[name].bounds.mean(axis=0)
        centre = T[:3, :3] @ (middle * scale[row]) + T[:3, 3] + protocol.position_error * direction
        rotation = spatial.rotation_from_vector(protocol.turn_error * axis) @ T[:3, :3]
        scale[row] *= factor
        poses[row] = spatial.seven_from_pose(
            spatial.pose(rotation, centre - rotation @ (middle * scale[row]))
        )
    return replace(grasps, object_pose=poses, scale=scale)
