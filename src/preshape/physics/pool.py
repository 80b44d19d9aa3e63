"""Many tests on all cores: processes that prepare once, keep what they finish, and end with their parent."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from multiprocessing.synchronize import Event
from typing import Any, Protocol, TypeVar

from ..exceptions import EnvironmentFailure, InputError
from ..hands.compiled import no_mujoco_log
from .hand import PhysicsHand
from .pieces import ConvexPieces
from .protocol import HoldProtocol
from .scene import Scene, build_scene

KEPT = 3  # compiled scenes that a process keeps

J = TypeVar("J")
J_contra = TypeVar("J_contra", contravariant=True)
R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)


class Tester(Protocol[J_contra, R_co]):
    """Does one job after the other; each process gets a copy from before the first."""

    def test(self, job: J_contra) -> R_co:
        """Do a job."""


class Scenes:
    """Scenes of one hand, of which those used last are kept compiled.

    Args:
        hand: the hand.
        pieces: of each object, by name.
        protocol: of the scenes.
    """

    def __init__(self, hand: PhysicsHand, pieces: Mapping[str, ConvexPieces], protocol: HoldProtocol) -> None:
        # A mapping that is no plain dict does not survive the way to a process.
        self._hand, self._pieces, self._protocol = hand, dict(pieces), protocol
        self._kept: dict[tuple[str, float], Scene] = {}

    def scene(self, name: str, scale: float) -> Scene:
        """The scene of an object at a scale."""
        key = name, scale
        found = self._kept.pop(key, None) or build_scene(
            self._hand, self._pieces[name], scale, self._protocol
        )
        self._kept[key] = found
        while len(self._kept) > KEPT:
            del self._kept[next(iter(self._kept))]
        return found

    def clear(self) -> None:
        """Keep none: as MuJoCo leaves them when it gives up, they are not used again."""
        self._kept.clear()


def process_count(workers: int | None) -> int:
    """How many processes are meant; by default one for each core.

    Raises:
        InputError: fewer than one.
    """
    if workers is not None and workers < 1:
        raise InputError(f"workers must be 1 or more, got {workers!r}")
    return workers or usable_cores()


def usable_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_jobs(
    chunks: Sequence[list[J]], tester: Tester[J, R], workers: int, take: Callable[[list[R]], None]
) -> None:
    """Do all jobs, in any order. At Ctrl-C what is being done is finished and taken, what waits is dropped.

    Args:
        chunks: jobs that one process does in a row.
        tester: who does them.
        workers: processes, at most; one does the jobs in this process.
        take: called with results as they come.

    Raises:
        EnvironmentFailure: a process was killed.
    """
    workers = min(workers, max(1, len(chunks)))
    if workers == 1:
        for job in (job for chunk in chunks for job in chunk):
            take([tester.test(job)])
        return
    # Spawned, not forked: the same on every system, and safe beside threads of the caller.
    context = get_context("spawn")
    stop = context.Event()
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(tester, stop))
    futures: list[Future[list[R]]] = []
    taken: set[Future[list[R]]] = set()
    try:
        futures += [pool.submit(_work, chunk) for chunk in chunks]
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
            "a process of the test was killed, perhaps for memory; run it again with fewer workers "
            "(with a checkpoint it goes on where it was)"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


_tester: Tester[Any, Any] | None = None  # of this worker process
_stop: Event | None = None  # set when the run is interrupted


def _begin(tester: Tester[Any, Any], stop: Event) -> None:
    global _tester, _stop  # a pool's processes have no other place for what every chunk needs
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _tester, _stop = tester, stop


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _work(chunk: list[Any]) -> list[Any]:
    assert _tester is not None
    assert _stop is not None
    results: list[Any] = []
    with no_mujoco_log():
        for job in chunk:
            if _stop.is_set():
                break
            results.append(_tester.test(job))
    return results
