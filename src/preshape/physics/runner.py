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
from contextlib import ExitStack, contextmanager
from multiprocessing import get_context, parent_process
from multiprocessing.synchronize import Event
from pathlib import Path

from ..exceptions import EnvironmentFailure, InputError
from ..types import Array, value
from .checkpoint import Checkpoint
from .grasps import STAGES, GraspSet
from .hand import PhysicsHand
from .locate import object_pieces
from .perturb import perturbed
from .pieces import ConvexPieces
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
        import mujoco

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
        except mujoco.FatalError as error:
            # One grasp is no reason to lose the others; the scene, as MuJoCo left it, is not used again.
            self._scenes.clear()
            return _invalid(job.row, job.object_name, job.given_scale, f"MuJoCo gave up: {error}")


_bench: _Bench | None = None  # of this worker process
_stop: Event | None = None  # set when the run is interrupted


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
    with ExitStack() as stack:
        stack.enter_context(_no_log())
        hand.spec()  # a hand that cannot be used is an error of the run, not of each grasp
        found, reasons = _objects(given, objects, pieces or {})
        actual = perturbed(given, found, protocol)
        reasons.update({fault.row: fault.reason for fault in given.faults})
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

        def take(results: list[HoldResult]) -> None:
            done.update({result.row: result for result in results})
            if kept is not None:
                kept.add(results)
            if progress is not None:
                progress(len(done), total)

        _run(chunks, bench, min(count, max(1, len(chunks))), take)
    return HoldReport(
        grasps=actual,
        results=tuple(done[row] for row in range(total)),
        seconds=time.perf_counter() - start,
    )


@contextmanager
def _no_log() -> Iterator[None]:
    """No MUJOCO_LOG.TXT in the working folder: the test reads its warnings in ``MjData.warning``."""
    import mujoco

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(_nothing)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _nothing(_: str) -> None:
    pass


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
            found[name] = pieces[name] if name in pieces else object_pieces(name, folder)
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


def _run(
    chunks: list[list[_Job]], bench: _Bench, workers: int, take: Callable[[list[HoldResult]], None]
) -> None:
    if workers == 1:
        for chunk in chunks:
            for job in chunk:
                take(bench.run([job]))
        return
    # Spawned, not forked: the same on every system, and safe beside threads of the caller.
    context = get_context("spawn")
    stop = context.Event()
    pool = ProcessPoolExecutor(
        workers,
        mp_context=context,
        initializer=_begin,
        initargs=(bench.hand, dict(bench.pieces), bench.protocol, stop),
    )
    futures: list[Future[list[HoldResult]]] = []
    taken: set[Future[list[HoldResult]]] = set()
    try:
        futures += [pool.submit(_work, chunk) for chunk in chunks]
        for future in as_completed(futures):
            taken.add(future)
            take(future.result())
    except KeyboardInterrupt:
        # The grasp that each process is at is finished and kept with those before it; what waits is dropped.
        stop.set()
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


def _begin(hand: PhysicsHand, pieces: dict[str, ConvexPieces], protocol: Protocol, stop: Event) -> None:
    global _bench, _stop  # a pool's processes have no other place for what every task needs
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _no_log().__enter__()  # for good: the process does nothing else
    _bench, _stop = _Bench(hand, pieces, protocol), stop


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _work(jobs: list[_Job]) -> list[HoldResult]:
    assert _bench is not None
    assert _stop is not None
    results: list[HoldResult] = []
    for job in jobs:
        if _stop.is_set():
            break
        results += _bench.run([job])
    return results


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
