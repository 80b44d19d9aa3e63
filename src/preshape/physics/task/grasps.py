"""Answers to the instances of the task benchmark, from a file of grasps or from a planner.

The file is the npz of :mod:`preshape.physics.grasps` with one more array:

===========  ===========  ==================================================================
array        shape        content
===========  ===========  ==================================================================
task         (n,) text    the task of each grasp, such as ``push`` or ``push:+x``
===========  ===========  ==================================================================

An answer belongs to the instance with the same object, task and scale (to a millionth). If several answers
belong to an instance, the first one counts.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from ...exceptions import InputError
from ...files import read_arrays, write_whole
from ...tasks import parse_task
from ...types import value
from ..grasps import GraspSet, HandPoses, read_grasps, write_grasps
from ..hand import PhysicsHand
from .instances import TaskInstance


class Answers(Protocol):
    """A source of answers; it is sent to worker processes, so it must be picklable."""

    @property
    def planned(self) -> bool:
        """Whether the poses are computed during the run; the results then include them."""

    @property
    def digest(self) -> str:
        """Hash of everything that the answers depend on, except the instances."""

    def answer(self, row: int, instance: TaskInstance) -> HandPoses | str:
        """The poses for an instance, or a sentence that says why there are none."""


@value
class GivenAnswers:
    """Answers from a file.

    Attributes:
        rows: For each instance in order, its poses or the reason why there are none.
        unused: Number of grasps that belong to no instance, or to one that already has a grasp.
    """

    rows: tuple[HandPoses | str, ...]
    unused: int = 0

    @property
    def planned(self) -> bool:
        """False, because the poses are in the file."""
        return False

    @property
    def digest(self) -> str:
        """Hash of the poses."""
        state = hashlib.sha256()
        for row in self.rows:
            content = row if isinstance(row, str) else repr((row.object_pose.tolist(), row.rows()))
            state.update(content.encode() + b"\0")
        return state.hexdigest()

    def answer(self, row: int, instance: TaskInstance) -> HandPoses | str:
        """The answer in the row of the instance."""
        return self.rows[row]


def write_task_grasps(path: str | Path, grasps: GraspSet, tasks: Sequence[str]) -> None:
    """Write grasps with their tasks as npz, atomically.

    Raises:
        InputError: The numbers of tasks and grasps differ.
        EnvironmentFailure: The file cannot be written.
    """
    if len(tasks) != len(grasps):
        raise InputError(f"task must name {len(grasps)} tasks, one for each grasp, got {len(tasks)}")
    member = io.BytesIO()
    np.save(member, np.array(list(tasks), dtype=np.str_), allow_pickle=False)

    def write(target: Path) -> None:
        write_grasps(target, grasps)
        with zipfile.ZipFile(target, "a", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("task.npy", member.getvalue())

    write_whole(Path(path), write)


def read_task_grasps(path: str | Path) -> tuple[GraspSet, tuple[str, ...]]:
    """Grasps from a file, and the label of the task of each.

    Raises:
        InputError: The file is not an npz of grasps, has no array ``task``, or names an unknown task.
        EnvironmentFailure: The file cannot be read.
    """
    grasps = read_grasps(path)
    try:
        texts = read_arrays(Path(path)).get("task")
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: the task test needs an npz of grasps with an array task, not a plan"
        ) from error
    if texts is None:
        raise InputError(f"{path}: no array task; it holds one name for each grasp, such as push or push:+x")
    if texts.shape != (len(grasps),) or texts.dtype.kind not in "US":
        raise InputError(
            f"{path}: task must be {len(grasps)} names as text, got {texts.dtype} with shape {texts.shape}"
        )
    names = [text.decode() if isinstance(text, bytes) else str(text) for text in texts]
    labels: dict[str, str] = {}
    for row, name in enumerate(names):
        if name not in labels:
            try:
                labels[name] = parse_task(name).label
            except InputError as error:
                raise InputError(f"{path}, row {row}: {error}") from error
    return grasps, tuple(labels[name] for name in names)


def given_answers(
    instances: Sequence[TaskInstance], grasps: GraspSet, tasks: Sequence[str], hand: PhysicsHand
) -> GivenAnswers:
    """Find the answer to each instance among grasps in any order.

    Args:
        instances: Instances of the benchmark.
        grasps: Grasps of another planner.
        tasks: Label of the task of each grasp.
        hand: Hand of the grasps.

    Raises:
        InputError: The grasps are for another hand.
    """
    own = grasps.for_hand(hand)
    faults = {fault.row: fault.reason for fault in own.faults}
    rows_of: dict[tuple[str, str], list[int]] = {}
    for row, key in enumerate(zip(own.objects, tasks, strict=True)):
        rows_of.setdefault(key, []).append(row)
    answers: list[HandPoses | str] = []
    for instance in instances:
        rows = rows_of.get((instance.object_name, instance.task.label), [])
        # A row with a fault has lost its scale.
        same = [r for r in rows if r in faults or abs(own.scale[r] / instance.scale - 1.0) < 1e-6]
        if not same:
            other = f" (it has one at scale {own.scale[rows[0]]:g})" if rows else ""
            answers.append(f"the file has no grasp for it at scale {instance.scale:g}{other}")
        elif same[0] in faults:
            answers.append(f"row {same[0]} of the file: {faults[same[0]]}")
        else:
            answers.append(own.poses(same[0]))
    return GivenAnswers(
        rows=tuple(answers), unused=len(own) - sum(not isinstance(answer, str) for answer in answers)
    )
