"""Many instances of the task benchmark: all cores, progress, and a file from which a stopped run goes on.

Each instance is answered with a fresh memory and tested alone and from rest, so neither the number of
processes nor the order nor a stop in between changes a result.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ...exceptions import InputError
from ...hands.compiled import no_mujoco_log
from ...processes import process_count
from ..hand import PhysicsHand
from ..hold.runner import Progress
from ..pieces import ConvexPieces, load_pieces
from ..pool import Scenes, run_jobs
from .checkpoint import TaskCheckpoint
from .grasps import Answers
from .instances import TaskInstance, instance_to_json
from .protocol import TaskProtocol, TaskResult, TaskStatus, task_test
from .report import TaskReport

CHUNK = 4  # instances of one object that a process takes at once


_Job = tuple[int, TaskInstance]


class _Tester:
    """Answers and tests any instance of the run."""

    def __init__(
        self,
        hand: PhysicsHand,
        pieces: Mapping[str, ConvexPieces],
        protocol: TaskProtocol,
        answers: Answers,
    ) -> None:
        self.answers, self.protocol = answers, protocol
        self.scenes = Scenes(hand, pieces, protocol.hold)

    def test(self, job: _Job) -> TaskResult:
        import mujoco

        row, instance = job
        label = _label(row, instance)
        poses = self.answers.answer(row, instance)
        if isinstance(poses, str):
            return TaskResult(status=TaskStatus.NO_ANSWER, reason=poses, **label)
        planned = poses.rows() if self.answers.planned else None
        try:
            return task_test(
                self.scenes.scene(instance.object_name, instance.scale),
                poses.pregrasp,
                poses.grasp,
                poses.squeeze,
                poses.object_pose,
                instance.motion,
                self.protocol,
                planned=planned,
                **label,
            )
        except InputError as error:
            why = str(error)
        except mujoco.FatalError as error:  # one instance is no reason to lose the others
            self.scenes.clear()
            why = f"MuJoCo gave up: {error}"
        return TaskResult(status=TaskStatus.INVALID, reason=why, planned=planned, **label)


def run_tasks(
    instances: Sequence[TaskInstance],
    hand: PhysicsHand,
    answers: Answers,
    *,
    protocol: TaskProtocol | None = None,
    pieces: Mapping[str, ConvexPieces] | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    preparing: Callable[[str], None] | None = None,
    checkpoint: str | Path | None = None,
) -> TaskReport:
    """Answer and test every instance.

    With more than one process the calling script needs the usual ``if __name__ == "__main__":``.

    Args:
        instances: of :func:`preshape.physics.task.instances.make_instances`.
        hand: in physics.
        answers: a planner's, or a file's.
        protocol: default friction 0.6, 0.1 kg.
        pieces: objects already cut, by name; others are cut, which takes up to two minutes an object once.
        workers: processes; default one for each core.
        progress: called after every instance or few.
        preparing: called with the name of each object before it is cut.
        checkpoint: file of results; a run that was stopped goes on from it.

    Raises:
        InputError: no such number of workers, or the checkpoint is of another run.
        HandError: the hand's model cannot be used.
        EnvironmentFailure: a file cannot be read or written, or a process was killed.
    """
    start = time.perf_counter()
    protocol = protocol or TaskProtocol()
    count = process_count(workers)
    done: dict[int, TaskResult] = {}
    with ExitStack() as stack:
        stack.enter_context(no_mujoco_log())
        hand.spec()  # a hand that cannot be used is an error of the run, not of each instance
        found, reasons = _pieces(instances, pieces or {}, preparing)
        key = _key(instances, hand, found, protocol, answers)
        kept = stack.enter_context(TaskCheckpoint(checkpoint, key)) if checkpoint else None
        if kept is not None:
            done.update(kept.done)
        for row, instance in enumerate(instances):
            if instance.object_name in reasons:
                why = reasons[instance.object_name]
                done[row] = TaskResult(status=TaskStatus.INVALID, reason=why, **_label(row, instance))
        if progress is not None:
            progress(len(done), len(instances))

        def take(results: list[TaskResult]) -> None:
            done.update({result.row: result for result in results})
            if kept is not None:
                kept.add(results)
            if progress is not None:
                progress(len(done), len(instances))

        run_jobs(_chunks(instances, done), _Tester(hand, found, protocol, answers), count, take)
    return TaskReport(
        instances=tuple(instances),
        results=tuple(done[row] for row in range(len(instances))),
        hand=hand,
        seconds=time.perf_counter() - start,
    )


def _label(row: int, instance: TaskInstance) -> dict[str, Any]:
    return {
        "row": row,
        "object_name": instance.object_name,
        "scale": instance.scale,
        "task": instance.task.label,
    }


def _pieces(
    instances: Sequence[TaskInstance],
    given: Mapping[str, ConvexPieces],
    preparing: Callable[[str], None] | None,
) -> tuple[dict[str, ConvexPieces], dict[str, str]]:
    """Every object's pieces, and why there are none of the others."""
    found: dict[str, ConvexPieces] = {}
    reasons: dict[str, str] = {}
    for name in dict.fromkeys(instance.object_name for instance in instances):
        try:
            if name in given:
                found[name] = given[name]
                continue
            if preparing is not None:
                preparing(name)
            found[name] = load_pieces(name)
        except InputError as error:
            reasons[name] = str(error)
    return found, reasons


def _chunks(instances: Sequence[TaskInstance], done: Mapping[int, TaskResult]) -> list[list[_Job]]:
    """The instances still to do, those of one object together."""
    groups: dict[tuple[str, float], list[_Job]] = {}
    for row, instance in enumerate(instances):
        if row not in done:
            groups.setdefault((instance.object_name, instance.scale), []).append((row, instance))
    return [group[k : k + CHUNK] for group in groups.values() for k in range(0, len(group), CHUNK)]


def _key(
    instances: Sequence[TaskInstance],
    hand: PhysicsHand,
    pieces: Mapping[str, ConvexPieces],
    protocol: TaskProtocol,
    answers: Answers,
) -> str:
    """Hash of everything that decides the results."""
    import mujoco

    head = f"{mujoco.__version__} {hand.digest} {protocol!r} {answers.digest}"
    state = hashlib.sha256(head.encode())
    for instance in instances:
        state.update(json.dumps(instance_to_json(instance, protocol.hold.mass)).encode())
    for name in sorted(pieces):
        state.update(pieces[name].digest.encode())
    return state.hexdigest()
