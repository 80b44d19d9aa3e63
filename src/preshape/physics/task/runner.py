"""Runs the task test of many instances on all cores, and resumes a stopped run from a file.

Each instance is answered with an empty memory and tested on its own, from rest. Neither the number of
processes nor the order nor an interruption changes a result.
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
from ..hold.checkpoint import Progress, ResultFile, result_taker
from ..hold.report import result_to_json
from ..pieces import ConvexPieces, load_pieces
from ..pool import Scenes, run_jobs
from .grasps import Answers
from .instances import TaskInstance, instance_to_json
from .protocol import TaskProtocol, TaskResult, TaskStatus, task_test
from .report import TaskReport, result_from_json

CHUNK = 4
"""Number of instances of one object that a process answers and tests in succession."""

_Job = tuple[int, TaskInstance]


class TaskCheckpoint(ResultFile[TaskResult]):
    """Results of the task test."""

    format = "preshape tasks 1"
    kind = "task tests"
    subject = "instances, grasps, hand or settings"
    to_json = staticmethod(result_to_json)
    from_json = staticmethod(result_from_json)


class _TaskTester:
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
                poses,
                instance.motion,
                self.protocol,
                planned=planned,
                **label,
            )
        except InputError as error:
            reason = str(error)
        except mujoco.FatalError as error:  # one instance must not end the whole run
            self.scenes.clear()
            reason = f"MuJoCo gave up: {error}"
        return TaskResult(status=TaskStatus.INVALID, reason=reason, planned=planned, **label)


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
    """Answer and test all instances.

    With more than one process, the calling script needs the guard ``if __name__ == "__main__":``.

    Args:
        instances: The instances (see :func:`preshape.physics.task.instances.make_instances`).
        hand: The hand.
        answers: Answers of a planner or of a file.
        protocol: Settings of the test; by default friction 0.6 and 0.1 kg.
        pieces: Convex pieces by object name; an object that is missing is cut, once, in up to two minutes.
        workers: Number of processes; by default one for each core.
        progress: Called after every few instances.
        preparing: Called with the name of each object before it is cut.
        checkpoint: File of results, from which a stopped run continues.

    Raises:
        InputError: The number of workers is below 1, or the checkpoint belongs to another run.
        HandError: The hand's model cannot be used.
        EnvironmentFailure: A file cannot be read or written, or a process was killed.
    """
    start = time.perf_counter()
    protocol = protocol or TaskProtocol()
    count = process_count(workers)
    with ExitStack() as stack:
        stack.enter_context(no_mujoco_log())
        hand.spec()  # a hand that cannot be used is an error of the run, not of each instance
        found, reasons = _pieces(instances, pieces or {}, preparing)
        key = _key(instances, hand, found, protocol, answers)
        file = stack.enter_context(TaskCheckpoint(checkpoint, key)) if checkpoint else None
        done = dict(file.done) if file else {}
        for row, instance in enumerate(instances):
            if instance.object_name in reasons:
                reason = reasons[instance.object_name]
                done[row] = TaskResult(status=TaskStatus.INVALID, reason=reason, **_label(row, instance))
        chunks = _chunks(instances, done)
        take = result_taker(done, len(instances), file, progress)
        run_jobs(chunks, _TaskTester(hand, found, protocol, answers), count, take)
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
    """The convex pieces of the objects, by name, and the reasons why other objects have none."""
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
    """The instances that are not done, grouped by object and size so that a chunk shares a scene."""
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
    """Hash of everything that the results depend on."""
    import mujoco

    head = f"{mujoco.__version__} {hand.digest} {protocol!r} {answers.digest}"
    state = hashlib.sha256(head.encode())
    for instance in instances:
        state.update(json.dumps(instance_to_json(instance, protocol.hold.mass)).encode())
    for name in sorted(pieces):
        state.update(pieces[name].digest.encode())
    return state.hexdigest()
