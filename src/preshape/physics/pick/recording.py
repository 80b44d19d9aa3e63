"""Records a pick test while it runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...types import value
from ..grasps import HandPoses
from ..hold.recording import Recorder, Recording, both
from ..hold.six_directions import Observer
from ..scene import Scene
from ..task.motion import TaskMotion
from .doing import JOB_STAGES
from .objects import PickAnswer
from .picking import STAGES, pick_test
from .protocol import PickProtocol, PickResult


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
    work: TaskMotion | None = None,
) -> PickRecording:
    """Run the test of an object again and record it; recording does not change its result.

    Args:
        scene: Scene of the test.
        result: Result of the test, with the planned poses.
        protocol: Settings of the test.
        parts: Names of palm and fingers in the order of ``scene.part_of_body``.
        work: Motion and load of the task, if it was done.

    Raises:
        InputError: The number of names is wrong.
    """
    assert result.planned is not None
    assert result.way_in is not None
    assert result.turn is not None
    pregrasp, grasp, squeeze = (np.array(row) for row in result.planned)
    origin = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    poses = HandPoses(pregrasp=pregrasp, grasp=grasp, squeeze=squeeze, object_pose=origin)
    return record_answer(
        scene,
        PickAnswer(poses=poses, way_in=result.way_in, turn=result.turn, work=work),
        protocol,
        parts=parts,
        row=result.row,
        object_name=result.object_name,
        scale=result.scale,
    )


def record_answer(
    scene: Scene,
    answer: PickAnswer,
    protocol: PickProtocol,
    *,
    parts: Sequence[str] = (),
    row: int = 0,
    object_name: str = "",
    scale: float = 1.0,
    observer: Observer | None = None,
) -> PickRecording:
    """Test a grasp and record the test.

    Args:
        scene: Scene of the test.
        answer: The grasp, how the object rests, and the task.
        protocol: Settings of the test.
        parts: Names of palm and fingers in the order of ``scene.part_of_body``.
        row: Row for the result; it also decides the errors.
        object_name: Name of the object for the result.
        scale: Scale for the result.
        observer: Called at every check too, after the recorder.

    Raises:
        InputError: The number of names is wrong.
    """
    stages = (*STAGES, *JOB_STAGES)
    recorder = Recorder(scene, set(stages), parts, one_run=stages)
    result = pick_test(
        scene, *answer.in_world(), protocol,
        row=row, object_name=object_name, scale=scale, work=answer.work, observer=both(recorder, observer),
    )  # fmt: skip
    return PickRecording(result=result, **recorder.fields())
