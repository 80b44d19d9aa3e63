"""Records a pick test while it runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...types import value
from ..grasps import HandPoses
from ..hold.recording import Recorder, Recording
from ..scene import Scene
from .picking import STAGES, pick_test
from .protocol import PickProtocol, PickResult

ORIGIN = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
"""Pose of the object in a bench, whose world is the object's frame."""


@value
class PickRecording(Recording):
    """A pick test over time.

    Attributes:
        result: Result of the test.
    """

    result: PickResult


def record_pick(
    scene: Scene,
    result: PickResult,
    protocol: PickProtocol,
    *,
    parts: Sequence[str] = (),
) -> PickRecording:
    """Run the test of an object again and record it; recording does not change its result.

    Args:
        scene: Scene of the test.
        result: Result of the test, with the planned poses.
        protocol: Settings of the test.
        parts: Names of palm and fingers in the order of ``scene.part_of_body``.

    Raises:
        InputError: The number of names is wrong.
    """
    assert result.planned is not None
    assert result.way_in is not None
    recorder = Recorder(scene, set(STAGES), parts, one_run=STAGES)
    pregrasp, grasp, squeeze = (np.array(row) for row in result.planned)
    again = pick_test(
        scene,
        HandPoses(pregrasp=pregrasp, grasp=grasp, squeeze=squeeze, object_pose=np.array(ORIGIN)),
        np.array(result.way_in),
        protocol,
        row=result.row,
        object_name=result.object_name,
        scale=result.scale,
        observer=recorder,
    )
    return PickRecording(result=again, **recorder.fields())
