"""Many instances of the task benchmark: all cores, progress, and a file from which a stopped run goes on.

Each instance is answered with a fresh memory and tested alone and from rest, so neither the number of
processes nor the order nor a stop in between changes a result.
"""

from __future__ import annotations

import hashlib
import json
import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from ..exceptions import EnvironmentFailure, InputError
from ..types import value
from .hand import PhysicsHand
from .pieces import ConvexPieces, load_pieces
from .runner import SCENES, Progress, _end_with_parent, _no_log, usable_cores
from .scene import Scene, build_scene
from .task_checkpoint import TaskCheckpoint
from .task_grasps import Answers
from .task_instances import TaskInstance, instance_to_json
from .task_report import TaskReport
from .task_test import TaskProtocol, TaskResult, TaskStatus, task_test

CHUNK = 4  # instances of one object that a process takes at once


@value
class _Bench:
    """What a process needs for any instance of the run."""

    hand: PhysicsHand
    pieces: Mapping[str, ConvexPieces]
    protocol: TaskProtocol
    answers: Answers

    def __post_init__(self) -> None:
        # A mapping that is no plain dict does not survive the way to a process.
        object.__setattr__(self, "pieces", dict(self.pieces))


class _Worker:
    """One process' work, with the scenes it compiled last."""

    def __init__(self, bench: _Bench) -> None:
        self.bench = bench
        self.scene = lru_cache(maxsize=SCENES)(self._build)

    def _build(self, name: str, scale: float) -> Scene:
        return build_scene(self.bench.hand, self.bench.pieces[name], scale, self.bench.protocol.hold)

    def run(self, row: int, instance: TaskInstance) -> TaskResult:
        """Answer and test one instance."""
        import mujoco

        bench = self.bench
        label = _label(row, instance)
        poses = bench.answers.answer(row, instance)
        if isinstance(poses, str):
            return TaskResult(status=TaskStatus.NO_ANSWER, reason=poses, **label)
        planned = poses.rows() if bench.answers.planned else None
        try:
            result = task_test(
                self.scene(instance.object_name, instance.scale),
                poses.pregrasp,
                poses.grasp,
                poses.squeeze,
                poses.object_pose,
                instance.motion,
                bench.protocol,
                planned=planned,
                **label,
            )
        except InputError as error:
            return TaskResult(status=TaskStatus.INVALID, reason=str(error), planned=planned, **label)
        except mujoco.FatalError as error:
            self.scene.cache_clear()  # as MuJoCo left it, no scene is used again
            why = f"MuJoCo gave up: {error}"
            return TaskResult(status=TaskStatus.INVALID, reason=why, planned=planned, **label)
        return result


_worker: _Worker | None = None  # of this worker process


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
        instances: of :func:`preshape.physics.task_instances.make_instances`.
        hand: in physics.
        answers: a planner's, or a file's.
        protocol: default friction 0.6, 0.1 kg.
        pieces: objects already cut, by name; others are cut, which takes up to a minute an object once.
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
    count = workers if workers is not None else usable_cores()
    if count < 1:
        raise InputError(f"workers must be 1 or more, got {workers!r}")
    done: dict[int, TaskResult] = {}
    with ExitStack() as stack:
        stack.enter_context(_no_log())
        hand.spec()  # a hand that cannot be used is an error of the run, not of each instance
        found, reasons = _pieces(instances, pieces or {}, preparing)
        bench = _Bench(hand=hand, pieces=found, protocol=protocol, answers=answers)
        kept = stack.enter_context(TaskCheckpoint(checkpoint, _key(instances, bench))) if checkpoint else None
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

        chunks = _chunks(instances, done)
        _run(chunks, bench, min(count, max(1, len(chunks))), take)
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


_Chunk = list[tuple[int, TaskInstance]]


def _chunks(instances: Sequence[TaskInstance], done: Mapping[int, TaskResult]) -> list[_Chunk]:
    """The instances still to do, those of one object together."""
    groups: dict[tuple[str, float], _Chunk] = {}
    for row, instance in enumerate(instances):
        if row not in done:
            groups.setdefault((instance.object_name, instance.scale), []).append((row, instance))
    return [group[k : k + CHUNK] for group in groups.values() for k in range(0, len(group), CHUNK)]


def _run(chunks: list[_Chunk], bench: _Bench, workers: int, take: Callable[[list[TaskResult]], None]) -> None:
    if workers == 1:
        worker = _Worker(bench)
        for row, instance in (pair for chunk in chunks for pair in chunk):
            take([worker.run(row, instance)])
        return
    # Spawned, not forked: the same on every system, and safe beside threads of the caller.
    pool = ProcessPoolExecutor(
        workers, mp_context=get_context("spawn"), initializer=_begin, initargs=(bench,)
    )
    futures: list[Future[list[TaskResult]]] = []
    taken: set[Future[list[TaskResult]]] = set()
    try:
        futures += [pool.submit(_work, chunk) for chunk in chunks]
        for future in as_completed(futures):
            taken.add(future)
            take(future.result())
    except KeyboardInterrupt:
        # What is being tested is finished and kept, what waits is dropped.
        pool.shutdown(wait=True, cancel_futures=True)
        for future in futures:
            if future not in taken and not future.cancelled() and future.exception() is None:
                take(future.result())
        raise
    except BrokenProcessPool as error:
        raise EnvironmentFailure(
            "a process of the test was killed, perhaps for memory; run it again with fewer workers "
            "(with a checkpoint it goes on where it was)"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _begin(bench: _Bench) -> None:
    global _worker  # noqa: PLW0603  (a pool's processes have no other place for what every task needs)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _no_log().__enter__()  # for good: the process does nothing else
    _worker = _Worker(bench)


def _work(chunk: _Chunk) -> list[TaskResult]:
    assert _worker is not None
    return [_worker.run(row, instance) for row, instance in chunk]


def _key(instances: Sequence[TaskInstance], bench: _Bench) -> str:
    """Hash of everything that decides the results."""
    import mujoco

    head = f"{mujoco.__version__} {bench.hand.digest} {bench.protocol!r} {bench.answers.digest}"
    state = hashlib.sha256(head.encode())
    for instance in instances:
        state.update(json.dumps(instance_to_json(instance, bench.protocol.hold.mass)).encode())
    for name in sorted(bench.pieces):
        state.update(bench.pieces[name].digest.encode())
    return state.hexdigest()
