"""Answers to the benchmark's instances from a file of grasps.

The file is the npz of :mod:`preshape.physics.grasps` with one more array:

===========  ===========  ==================================================================
array        shape        content
===========  ===========  ==================================================================
task         (n,) text    the task of each grasp, as ``push`` or ``push:+x``
===========  ===========  ==================================================================

An answer belongs to the instance of its object, task and scale (to a millionth); of several the first counts.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol as Shape
from typing import Self

import numpy as np

from ...exceptions import InputError
from ...files import read_arrays, write_whole
from ...tasks import parse_task
from ...types import Array, freeze, frozen_array, value
from ..grasps import STAGES, GraspSet, read_grasps, write_grasps
from ..hand import PhysicsHand
from .instances import TaskInstance


@value
class HandPoses:
    """One answer: where the hand goes.

    Attributes:
        object_pose: (7,) in the world.
        pregrasp: (7 + j) root pose in the world and joint angles in the hand's order [m, rad].
        grasp: (7 + j).
        squeeze: (7 + j).
    """

    object_pose: Array
    pregrasp: Array
    grasp: Array
    squeeze: Array

    def __post_init__(self) -> None:
        for name in ("object_pose", *STAGES):
            freeze(self, **{name: frozen_array(getattr(self, name), (None,), name)})

    @classmethod
    def of(cls, grasps: GraspSet, row: int) -> Self:
        """The poses in one row of a set, which is :meth:`~GraspSet.for_hand` of the hand."""
        return cls(object_pose=grasps.object_pose[row], **{s: getattr(grasps, s)[row] for s in STAGES})

    def rows(self) -> tuple[tuple[float, ...], ...]:
        """Pregrasp, grasp and squeeze as plain numbers."""
        return tuple(tuple(getattr(self, stage).tolist()) for stage in STAGES)


class Answers(Shape):
    """Whoever answers instances; sent to processes, so it holds values only."""

    @property
    def planned(self) -> bool:
        """Whether the poses are made here and belong in the results."""

    @property
    def digest(self) -> str:
        """Hash of all that decides the answers, beside the instances."""

    def answer(self, row: int, instance: TaskInstance) -> HandPoses | str:
        """The poses, or a sentence why there are none."""


@value
class GivenAnswers:
    """Answers from a file, one a row of the instances: poses, or why there are none.

    Attributes:
        rows: in the order of the instances.
        unused: how many grasps belong to no instance, or came after the first.
    """

    rows: tuple[HandPoses | str, ...]
    unused: int = 0

    @property
    def planned(self) -> bool:
        """The poses are in the file already."""
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
        """The row's."""
        return self.rows[row]


def write_task_grasps(path: str | Path, grasps: GraspSet, tasks: Sequence[str]) -> None:
    """Write grasps with their tasks as npz, whole or not at all.

    Raises:
        InputError: not one task a grasp.
        EnvironmentFailure: the file cannot be written.
    """
    if len(tasks) != len(grasps):
        raise InputError(f"task must name {len(grasps)} tasks, one a grasp, got {len(tasks)}")
    member = io.BytesIO()
    np.save(member, np.array(list(tasks), dtype=np.str_), allow_pickle=False)

    def write(target: Path) -> None:
        write_grasps(target, grasps)
        with zipfile.ZipFile(target, "a", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("task.npy", member.getvalue())

    write_whole(Path(path), write)


def read_task_grasps(path: str | Path) -> tuple[GraspSet, tuple[str, ...]]:
    """Grasps, and the label of each one's task.

    Raises:
        InputError: not such a file, no ``task``, or a task that is not known.
        EnvironmentFailure: the file cannot be read.
    """
    grasps = read_grasps(path)
    try:
        texts = read_arrays(Path(path)).get("task")
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: the task test needs an npz of grasps with an array task, not a plan"
        ) from error
    if texts is None:
        raise InputError(f"{path}: no array task; give one name a grasp, as push or push:+x")
    if texts.shape != (len(grasps),) or texts.dtype.kind not in "US":
        raise InputError(
            f"{path}: task must be {len(grasps)} names as text, got {texts.dtype} of shape {texts.shape}"
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
    """Each instance's answer among grasps of any order.

    Args:
        instances: of the benchmark.
        grasps: of another planner.
        tasks: label of each one's task.
        hand: whose grasps they are.

    Raises:
        InputError: grasps of another hand.
    """
    own = grasps.for_hand(hand)
    faults = {fault.row: fault.reason for fault in own.faults}
    where: dict[tuple[str, str], list[int]] = {}
    for row, key in enumerate(zip(own.objects, tasks, strict=True)):
        where.setdefault(key, []).append(row)
    answers: list[HandPoses | str] = []
    for instance in instances:
        rows = where.get((instance.object_name, instance.task.label), [])
        fit = [r for r in rows if r in faults or abs(own.scale[r] / instance.scale - 1.0) < 1e-6]
        if not fit:
            other = f" (it has one at scale {own.scale[rows[0]]:g})" if rows else ""
            answers.append(f"the file has no grasp for it at scale {instance.scale:g}{other}")
        elif fit[0] in faults:
            answers.append(f"row {fit[0]} of the file: {faults[fit[0]]}")
        else:
            answers.append(HandPoses.of(own, fit[0]))
    return GivenAnswers(
        rows=tuple(answers), unused=len(own) - sum(not isinstance(answer, str) for answer in answers)
    )
