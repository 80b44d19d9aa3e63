"""Engines that make shards: worker processes of this machine, or a Ray cluster.

Both return each shard when it is finished, in any order. Workers write no files, so a killed worker leaves
nothing behind and the machines of a cluster need no shared disk.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from itertools import islice, repeat
from typing import Any, Protocol

from ..exceptions import EnvironmentFailure, PreshapeError
from ..processes import submit_all, worker_pool
from ..types import value
from .making import MadeShard, make_shard, versions
from .settings import DatasetSettings, Shard

MAX_KILLS = 3
"""Largest number of kills of a worker without a finished shard in between; then the run stops."""
SHARDS_PER_CORE = 2
"""Number of shards submitted to a cluster per core: one in progress and one waiting."""

LOOPBACK = "127.0.0.1"
"""Address that only this machine reaches."""

_CONNECT_TIMEOUT = 10.0  # [s] for the connection to a cluster


def _silent(_words: str) -> None:
    """Say nothing."""


class Engine(Protocol):
    """Something that makes shards."""

    def make(self, shards: Sequence[Shard], settings: DatasetSettings) -> Generator[MadeShard, None, None]:
        """Yield each shard as soon as it is finished, in any order.

        Raises:
            PreshapeError: A shard cannot be made.
            EnvironmentFailure: Workers were killed repeatedly.
        """


@value
class LocalEngine:
    """Worker processes of this machine.

    Attributes:
        workers: Number of processes; with 1, the calling process makes the shards.
    """

    workers: int

    def make(self, shards: Sequence[Shard], settings: DatasetSettings) -> Generator[MadeShard, None, None]:
        """See :class:`Engine`. A script needs ``if __name__ == "__main__":`` for more than one process."""
        expected = versions()
        if self.workers == 1:
            for shard in shards:
                yield make_shard(shard, settings, expected)
            return
        left = {shard.name: shard for shard in shards}
        kills = 0
        while left:
            before = len(left)
            try:
                for made in _pooled(list(left.values()), settings, expected, min(self.workers, len(left))):
                    del left[made.name]
                    yield made
            except BrokenProcessPool as error:
                kills = 1 if len(left) < before else kills + 1
                if kills == MAX_KILLS:
                    raise EnvironmentFailure(
                        f"a worker process was killed {MAX_KILLS} times before it finished a shard, perhaps "
                        "because memory ran out; run the same command with fewer --workers, finished shards "
                        "are kept"
                    ) from error


def _pooled(
    shards: list[Shard], settings: DatasetSettings, expected: dict[str, str], workers: int
) -> Generator[MadeShard, None, None]:
    with worker_pool(workers) as pool:
        for future in as_completed(submit_all(pool, make_shard, shards, repeat(settings), repeat(expected))):
            yield future.result()


@value
class RayEngine:
    """A Ray cluster. Each shard uses one core; if its worker or machine is lost, another one makes it.

    Attributes:
        address: Address of the cluster; by default ``RAY_ADDRESS``, else a cluster on this machine, else a
            new one.
        retries: Number of times that a lost shard is made again.
        host: Address that a new cluster listens on. Whoever reaches it can run programs here: Ray asks for
            no password.
        say: Called with one sentence that tells where a new cluster listens.
    """

    address: str | None = None
    retries: int = 5
    host: str = LOOPBACK
    say: Callable[[str], None] = _silent

    def make(self, shards: Sequence[Shard], settings: DatasetSettings) -> Generator[MadeShard, None, None]:
        """See :class:`Engine`."""
        if not shards:
            return
        ray = _ray()
        own = not ray.is_initialized()
        if own:
            self._join(ray)
        task = ray.remote(num_cpus=1, max_retries=self.retries)(make_shard)
        expected, waiting = versions(), iter(shards)
        running: dict[Any, Shard] = {}
        try:
            while True:
                cores = max(1, int(ray.cluster_resources().get("CPU", 1)))
                for shard in islice(waiting, max(0, SHARDS_PER_CORE * cores - len(running))):
                    running[task.remote(shard, settings, expected)] = shard
                if not running:
                    return
                ready, _ = ray.wait(list(running), timeout=1.0)
                for reference in ready:
                    yield _result(ray, reference, running.pop(reference))
        finally:
            for reference in running:
                ray.cancel(reference, force=True)
            if own:
                ray.shutdown()

    def _join(self, ray: Any) -> None:
        where = self.address or os.environ.get("RAY_ADDRESS") or "this machine"
        try:
            _check_address(where)
            quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
            try:
                ray.init(address=self.address or os.environ.get("RAY_ADDRESS") or "auto", **quiet)
            except ConnectionError:
                if self.address or os.environ.get("RAY_ADDRESS"):
                    raise
                self._start(ray, quiet)
        except Exception as error:  # Ray raises many error types here, even a plain Exception
            why = (str(error).strip() or type(error).__name__).splitlines()[0]
            raise EnvironmentFailure(f"no Ray cluster at {where} ({why}); see docs/dataset.md") from error

    def _start(self, ray: Any, quiet: dict[str, Any]) -> None:
        """Start a cluster on this machine; Ray itself would listen on every address of it."""
        if self.host == LOOPBACK:
            # Only where Ray has no clusters of several machines does it take loopback as a node's address. It
            # read this setting when it was imported; the processes that it starts will read it.
            from ray._private import ray_constants

            os.environ[ray_constants.ENABLE_RAY_CLUSTERS_ENV_VAR] = "0"
            ray_constants.ENABLE_RAY_CLUSTER = False
        ray.init(address="local", include_dashboard=False, _node_ip_address=self.host, **quiet)
        (node,) = ray.nodes()
        if self.host == LOOPBACK and node["NodeManagerAddress"] != LOOPBACK:
            ray.shutdown()
            raise OSError(f"it would listen on {node['NodeManagerAddress']}, not on {LOOPBACK}; see --host")
        main = str(ray.get_runtime_context().gcs_address).rpartition(":")[2]
        ports = [main, *(str(node[name]) for name in ("NodeManagerPort", "ObjectManagerPort"))]
        self.say(
            f"a Ray cluster was started; it listens on {self.host}, ports {', '.join(ports)} "
            "and one for each worker"
        )


def _check_address(where: str) -> None:
    """Raise OSError if nothing listens at HOST:PORT; Ray itself would try for minutes."""
    host, _, port = where.rpartition(":")
    if host and port.isdecimal() and "/" not in host:
        socket.create_connection((host, int(port)), timeout=_CONNECT_TIMEOUT).close()


def _ray() -> Any:
    # Turn off Ray's usage reports, unless the user's environment has a setting for them.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as error:
        raise EnvironmentFailure("the engine ray needs the package ray; install preshape[ray]") from error
    return ray


def _result(ray: Any, reference: Any, shard: Shard) -> MadeShard:
    try:
        made: MadeShard = ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, PreshapeError):
            raise error.cause from error
        raise
    except ray.exceptions.RayError as error:
        raise EnvironmentFailure(
            f"the cluster lost {shard.name} several times ({type(error).__name__}), perhaps because memory "
            "ran out; run the same command again, finished shards are kept"
        ) from error
    return made
