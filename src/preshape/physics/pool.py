"""Runs tests on several cores: worker processes cache compiled scenes and return each finished result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from typing import Any, Protocol, TypeVar

from ..exceptions import EnvironmentFailure
from ..hands.compiled import no_mujoco_log
from ..processes import submit_all, worker_pool
from .hand import PhysicsHand
from .pieces import ConvexPieces
from .protocol import HoldProtocol
from .scene import Scene, build_scene

CACHED_SCENES = 3
"""Number of compiled scenes that a process keeps."""

J = TypeVar("J")
J_contra = TypeVar("J_contra", contravariant=True)
R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)


class Tester(Protocol[J_contra, R_co]):
    """An object that runs one job after another. Each worker process works on its own copy of it."""

    def test(self, job: J_contra) -> R_co:
        """Run one job."""


class Scenes:
    """Compiled scenes of one hand; the most recently used ones are cached.

    Args:
        hand: The hand.
        pieces: Convex pieces of each object, by its name.
        protocol: Settings of the scenes.
    """

    def __init__(self, hand: PhysicsHand, pieces: Mapping[str, ConvexPieces], protocol: HoldProtocol) -> None:
        # Worker processes receive this object by pickling, which not every mapping supports.
        self._hand, self._pieces, self._protocol = hand, dict(pieces), protocol
        self._cache: dict[tuple[str, float], Scene] = {}

    def scene(self, name: str, scale: float) -> Scene:
        """The scene of an object at a scale."""
        key = name, scale
        scene = self._cache.pop(key, None) or build_scene(
            self._hand, self._pieces[name], scale, self._protocol
        )
        self._cache[key] = scene
        while len(self._cache) > CACHED_SCENES:
            del self._cache[next(iter(self._cache))]
        return scene

    def clear(self) -> None:
        """Empty the cache; a fatal error of MuJoCo leaves its scene in an unknown state."""
        self._cache.clear()


def run_jobs(
    chunks: Sequence[list[J]], tester: Tester[J, R], workers: int, take: Callable[[list[R]], None]
) -> None:
    """Run all jobs, in any order.

    At Ctrl-C each worker finishes its current job. These results are kept; the remaining jobs are dropped.

    Args:
        chunks: Lists of jobs; one process runs a list from its first job to its last.
        tester: Runs the jobs.
        workers: Largest number of processes; with 1 the jobs run in the calling process.
        take: Called with each list of results when it is ready.

    Raises:
        EnvironmentFailure: A worker process was killed.
    """
    workers = min(workers, max(1, len(chunks)))
    if workers == 1:
        for job in (job for chunk in chunks for job in chunk):
            take([tester.test(job)])
        return
    stop = get_context("spawn").Event()
    taken: set[Future[list[R]]] = set()
    try:
        with worker_pool(workers, _prepare, (tester, stop)) as pool:
            futures: list[Future[list[R]]] = submit_all(pool, _run_chunk, chunks)
            try:
                for future in as_completed(futures):
                    taken.add(future)
                    take(future.result())
            except KeyboardInterrupt:
                stop.set()
                pool.shutdown(wait=True, cancel_futures=True)
                for future in futures:
                    if future not in taken and not future.cancelled() and future.exception() is None:
                        take(future.result())
                raise
    except BrokenProcessPool as error:
        raise EnvironmentFailure(
            "a worker process of the test was killed, perhaps because memory ran out; run the test again "
            "with fewer workers (with a checkpoint it continues where it stopped)"
        ) from error


_tester: Tester[Any, Any] | None = None  # of this worker process
_stop: Event | None = None  # set when the run is interrupted


def _prepare(tester: Tester[Any, Any], stop: Event) -> None:
    global _tester, _stop  # a worker process has no other place for data that all its chunks share
    _tester, _stop = tester, stop


def _run_chunk(chunk: list[Any]) -> list[Any]:
    assert _tester is not None
    assert _stop is not None
    results: list[Any] = []
    with no_mujoco_log():
        for job in chunk:
            if _stop.is_set():
                break
            results.append(_tester.test(job))
    return results
