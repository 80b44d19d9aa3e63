"""Who makes the shards: processes of this machine, or a Ray cluster.

Both hand the shards back as they come, in any order; neither writes a file, so that a process which is killed
leaves nothing behind, and machines share no disk.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import threading
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from itertools import islice
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, Protocol

from ..exceptions import EnvironmentFailure, PreshapeError
from ..types import value
from .making import Made, make_shard, versions
from .settings import DatasetSettings, Shard

TRIES = 3
"""Times that a process may be killed without any shard getting done, before a run gives up."""
AHEAD = 2
"""Shards handed to a cluster for each of its cores: one at work, one waiting."""

_PATIENCE = 10.0  # seconds for a connection to a cluster


class Engine(Protocol):
    """Makes shards."""

    def make(self, shards: Sequence[Shard], settings: DatasetSettings) -> Generator[Made, None, None]:
        """The shards as they get done, in any order.

        Raises:
            PreshapeError: a shard cannot be made.
            EnvironmentFailure: processes were killed again and again.
        """


@value
class LocalEngine:
    """Processes of this machine.

    Attributes:
        workers: how many; one makes the shards in this process.
    """

    workers: int

    def make(self, shards: Sequence[Shard], settings: DatasetSettings) -> Generator[Made, None, None]:
        """See there. With more than one process a script needs ``if __name__ == "__main__":``."""
        have = versions()
        if self.workers == 1:
            for shard in shards:
                yield make_shard(shard, settings, have)
            return
        left = {shard.name: shard for shard in shards}
        tries = 0
        while left:
            before = len(left)
            try:
                for made in _pooled(list(left.values()), settings, have, min(self.workers, len(left))):
                    del left[made.name]
                    yield made
            except BrokenProcessPool as error:
                tries = 1 if len(left) < before else tries + 1
                if tries == TRIES:
                    raise EnvironmentFailure(
                        f"a process was killed {TRIES} times before it finished a shard, perhaps for memory; "
                        "go on with fewer workers: what is finished stands"
                    ) from error


def _pooled(
    shards: list[Shard], settings: DatasetSettings, have: dict[str, str], workers: int
) -> Generator[Made, None, None]:
    # Spawned, not forked: the same on every system, and safe beside threads of the caller.
    context = get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(reader,))
    try:
        with _interrupts_ignored():
            futures: list[Future[Made]] = [pool.submit(make_shard, s, settings, have) for s in shards]
        for future in as_completed(futures):
            yield future.result()
    except BaseException:
        writer.close()  # whatever is not handed over yet is lost; nobody waits for it
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        writer.close()
        reader.close()


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """While processes start: they keep it, so that Ctrl-C reaches only the one that decides."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _begin(lifeline: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    """End this process when the other end is closed: the run was stopped, or its process is no more."""
    with suppress(EOFError, OSError):
        lifeline.recv_bytes()
    os._exit(1)


@value
class RayEngine:
    """A Ray cluster: one core a shard; a shard whose worker or node is lost is made again by another.

    Attributes:
        address: of the cluster; by default ``RAY_ADDRESS``, or one that runs here, or one made for the run.
        retries: times that a shard is made again.
    """

    address: str | None = None
    retries: int = 5

    def make(self, shards: Sequence[Shard], settings: DatasetSettings) -> Generator[Made, None, None]:
        """See there."""
        if not shards:
            return
        ray = _ray()
        own = not ray.is_initialized()
        if own:
            self._join(ray)
        task = ray.remote(num_cpus=1, max_retries=self.retries)(make_shard)
        have, waiting = versions(), iter(shards)
        running: dict[Any, Shard] = {}
        try:
            while True:
                room = AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1))) - len(running)
                for shard in islice(waiting, max(0, room)):
                    running[task.remote(shard, settings, have)] = shard
                if not running:
                    return
                ready, _ = ray.wait(list(running), timeout=1.0)
                for reference in ready:
                    yield _taken(ray, reference, running.pop(reference))
        finally:
            for reference in running:
                ray.cancel(reference, force=True)
            if own:
                ray.shutdown()

    def _join(self, ray: Any) -> None:
        where = self.address or os.environ.get("RAY_ADDRESS") or "this machine"
        try:
            _knock(where)
            ray.init(
                address=self.address,
                log_to_driver=False,
                logging_level=logging.ERROR,
            )
        except Exception as error:  # Ray raises whatever it likes here, a plain Exception too
            why = (str(error).strip() or type(error).__name__).splitlines()[0]
            raise EnvironmentFailure(f"no Ray cluster at {where} ({why}); see docs/dataset.md") from error


def _knock(where: str) -> None:
    """Whether somebody answers at HOST:PORT; Ray itself would try for minutes."""
    host, _, port = where.rpartition(":")
    if host and port.isdecimal() and "/" not in host:
        socket.create_connection((host, int(port)), timeout=_PATIENCE).close()


def _ray() -> Any:
    # Its reports home are for those who start a cluster to decide, not for this program.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as error:
        raise EnvironmentFailure("the engine ray needs the package ray; install preshape[ray]") from error
    return ray


def _taken(ray: Any, reference: Any, shard: Shard) -> Made:
    try:
        made: Made = ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, PreshapeError):
            raise error.cause from error
        raise
    except ray.exceptions.RayError as error:
        raise EnvironmentFailure(
            f"the cluster gave up {shard.name} after several tries ({type(error).__name__}), perhaps for "
            "memory; the same command goes on: what is finished stands"
        ) from error
    return made
