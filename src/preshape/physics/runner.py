"""Many grasps: all cores, progress, and a file of results from which a stopped run goes on.

Each grasp is tested alone and from rest, so neither the number of processes nor the order nor a stop in
between changes a result.
"""

from __future__ import annotations

import hashlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from multiprocessing import get_context, parent_process
from pathlib import Path

from ..exceptions import EnvironmentFailure, InputError
from ..types import Array, value
from .checkpoint import Checkpoint
from .grasps import STAGES, GraspSet
from .hand import PhysicsHand
from .perturb import perturbed
from .pieces import ConvexPieces, load_pieces
from .protocol import Protocol
from .report import HoldReport
from .scene import Scene, build_scene
from .six_directions import HoldResult, Status, hold_test

Progress = Callable[[int, int], None]
"""Called with how many grasps are done, and of how many."""

CHUNK = 8  # grasps a task: many enough to share a compiled scene, few enough to spread and to keep
SCENES = 3  # compiled scenes that a process keeps


@value
class _Job:
    """One grasp as a process gets it."""

    row: int
    object_name: str
    given_scale: float
    scale: float
    poses: tuple[Array, Array, Array, Array]


class _Bench:
    """What a process needs for any grasp of the run, and the scenes compiled last."""

    def __init__(self, hand: PhysicsHand, pieces: Mapping[str, ConvexPieces], protocol: Protocol) -> None:
        self.hand, self.pieces, self.protocol = hand, pieces, protocol
        self._scenes: dict[tuple[str, float], Scene] = {}

    def run(self, jobs: list[_Job]) -> list[HoldResult]:
        return [self._one(job) for job in jobs]

    def _scene(self, job: _Job) -> Scene:
        key = job.object_name, job.scale
        scene = self._scenes.pop(key, None) or build_scene(
            self.hand, self.pieces[job.object_name], job.scale, self.protocol
        )
        self._scenes[key] = scene
        while len(self._scenes) > SCENES:
            del self._scenes[next(iter(self._scenes))]
        return scene

    def _one(self, job: _Job) -> HoldResult:
        pregrasp, grasp, squeeze, thing = job.poses
        try:
            return hold_test(
                self._scene(job),
                pregrasp,
                grasp,
                squeeze,
                thing,
                self.protocol,
                row=job.row,
                object_name=job.object_name,
                scale=job.given_scale,
            )
        except InputError as error:
            return _invalid(job.row, job.object_name, job.given_scale, str(error))


_bench: _Bench | None = None  # of this worker process


def run_holds(
    grasps: GraspSet,
    hand: PhysicsHand,
    *,
    protocol: Protocol | None = None,
    objects: str | Path | None = None,
    pieces: Mapping[str, ConvexPieces] | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    checkpoint: str | Path | None = None,
) -> HoldReport:
    """Put grasps to the holding test.

    A grasp that cannot be tested does not stop the others: see ``HoldReport.raise_for_faults``.
    With more than one process the calling script needs the usual ``if __name__ == "__main__":``.

    Args:
        grasps: the set.
        hand: whose grasps they are.
        protocol: default the field's six directions.
        objects: folder of the objects, see :func:`preshape.physics.pieces.load_pieces`.
        pieces: objects already cut, by name; others are looked for.
        workers: processes; default one for each core.
        progress: called after every few grasps.
        checkpoint: file of results; a run that was stopped goes on from it.

    Raises:
        InputError: the grasps are not for this hand, or the checkpoint is of another run.
        HandError: the hand's model cannot be used.
        EnvironmentFailure: a file cannot be read or written, or a process was killed.
    """
    start = time.perf_counter()
    protocol = protocol or Protocol()
    count = workers if workers is not None else usable_cores()
    if count < 1:
        raise InputError(f"workers must be 1 or more, got {workers!r}")
    given = grasps.for_hand(hand)
    hand.spec()  # a hand that cannot be used is an error of the run, not of each grasp
    found, reasons = _objects(given, objects, pieces or {})
    actual = perturbed(given, found, protocol)
    reasons.update({fault.row: fault.reason for fault in given.faults})
    with ExitStack() as stack:
        kept = (
            stack.enter_context(Checkpoint(checkpoint, _key(actual, hand, found, protocol)))
            if checkpoint
            else None
        )
        done = dict(kept.done) if kept else {}
        for row, reason in reasons.items():
            done[row] = _invalid(row, given.objects[row], float(given.scale[row]), reason)
        total = len(given)
        if progress is not None:
            progress(len(done), total)
        chunks = _chunks(given, actual, set(done))
        bench = _Bench(hand, found, protocol)
        for results in _run(chunks, bench, min(count, max(1, len(chunks)))):
            done.update({result.row: result for result in results})
            if kept is not None:
                kept.add(results)
            if progress is not None:
                progress(len(done), total)
    return HoldReport(
        grasps=actual,
        results=tuple(done[row] for row in range(total)),
        seconds=time.perf_counter() - start,
    )


def usable_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _objects(
    grasps: GraspSet, folder: str | Path | None, pieces: Mapping[str, ConvexPieces]
) -> tuple[dict[str, ConvexPieces], dict[int, str]]:
    """Every object's pieces, and why the grasps of the others cannot be tested."""
    found: dict[str, ConvexPieces] = {}
    reasons: dict[str, str] = {}
    bad = {fault.row for fault in grasps.faults}
    for row, name in enumerate(grasps.objects):
        if row in bad or name in found or name in reasons:
            continue
        try:
            found[name] = pieces[name] if name in pieces else load_pieces(name, folder)
        except InputError as error:
            reasons[name] = str(error)
    return found, {row: reasons[name] for row, name in enumerate(grasps.objects) if name in reasons}


def _chunks(given: GraspSet, actual: GraspSet, done: set[int]) -> list[list[_Job]]:
    """The grasps still to test, those of one object and size together."""
    groups: dict[tuple[str, float], list[_Job]] = {}
    for row, name in enumerate(given.objects):
        if row in done:
            continue
        scale = float(actual.scale[row])
        poses = (*(getattr(actual, stage)[row] for stage in STAGES), actual.object_pose[row])
        job = _Job(row=row, object_name=name, given_scale=float(given.scale[row]), scale=scale, poses=poses)
        groups.setdefault((name, scale), []).append(job)
    return [jobs[k : k + CHUNK] for jobs in groups.values() for k in range(0, len(jobs), CHUNK)]


def _run(chunks: list[list[_Job]], bench: _Bench, workers: int) -> Iterator[list[HoldResult]]:
    if workers == 1:
        yield from map(bench.run, chunks)
        return
    # Spawned, not forked: the same on every system, and safe beside threads of the caller.
    pool = ProcessPoolExecutor(
        workers,
        mp_context=get_context("spawn"),
        initializer=_begin,
        initargs=(bench.hand, dict(bench.pieces), bench.protocol),
    )
    try:
        futures: list[Future[list[HoldResult]]] = [pool.submit(_work, chunk) for chunk in chunks]
        for future in as_completed(futures):
            yield future.result()
    except BrokenProcessPool as error:
        raise EnvironmentFailure(
            "a process of the test was killed, perhaps for memory; run it again with fewer workers "
            "(with a checkpoint it goes on where it was)"
        ) from error
    finally:
        # Also on Ctrl-C and when the caller stops: what is running ends, what waits is dropped.
        pool.shutdown(wait=True, cancel_futures=True)


def _begin(hand: PhysicsHand, pieces: dict[str, ConvexPieces], protocol: Protocol) -> None:
    global _bench  # noqa: PLW0603  (a pool's processes have no other place for what every task needs)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _bench = _Bench(hand, pieces, protocol)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _work(jobs: list[_Job]) -> list[HoldResult]:
    assert _bench is not None
    return _bench.run(jobs)


def _invalid(row: int, name: str, scale: float, reason: str) -> HoldResult:
    return HoldResult(row=row, object_name=name, scale=scale, status=Status.INVALID, reason=reason)


def _key(grasps: GraspSet, hand: PhysicsHand, pieces: Mapping[str, ConvexPieces], protocol: Protocol) -> str:
    """Hash of everything that decides the results."""
    import mujoco

    state = hashlib.sha256(f"{mujoco.__version__} {hand.digest} {protocol!r} {grasps.objects!r}".encode())
    for name in sorted(pieces):
        state.update(pieces[name].digest.encode())
    for array in (grasps.scale, grasps.object_pose, *(getattr(grasps, stage) for stage in STAGES)):
        state.update(array.tobytes())
    return state.hexdigest()
