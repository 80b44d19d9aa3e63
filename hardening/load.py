"""Load on ``preshape serve``: clients that ask without a pause, errors, times at the client, and memory.

    python -m hardening.load [--clients 8] [--seconds 60] [--out out/load]

The figures of memory are read from /proc, so this needs Linux.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import permutations
from pathlib import Path
from typing import Any

from preshape.files import write_json

OBJECTS = ("box", "mug", "bottle", "cube")
HAND = "shadow"
ORDERS = [",".join(order) for order in permutations(("+x", "-x", "+y", "-y", "+z", "-z"))]
"""All approaches in every order: requests that mean the same and are each computed."""
MOST_GROWTH = 0.03
"""Largest growth of the memory of all processes from the second quarter of the time to the last one."""
MB = 2**20


class Served:
    """One ``preshape serve`` with a memory of its own.

    Args:
        folder: Folder for its memory.
        options: Further options of the command.
    """

    def __init__(self, folder: Path, *options: str) -> None:
        command = [sys.executable, "-m", "preshape", "serve", "--port", "0", "--hand", HAND]
        self.process = subprocess.Popen(
            [*command, "--memory", str(folder / "memory.sqlite"), *options],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "XDG_RUNTIME_DIR": str(folder), "OPENBLAS_NUM_THREADS": "1"},
        )
        assert self.process.stderr is not None
        said = self.process.stderr.readline()
        found = re.search(r"http://localhost:(\d+)", said)
        assert found, said
        self.port = int(found[1])

    def memory(self) -> dict[int, float]:
        """Memory that the server and each of its planners hold [MB], by number of the process."""
        number = self.process.pid
        held = {}
        for one in (number, *map(int, Path(f"/proc/{number}/task/{number}/children").read_text().split())):
            pages = int(Path(f"/proc/{one}/statm").read_text().split()[1])
            held[one] = pages * os.sysconf("SC_PAGE_SIZE") / MB
        return held


@contextmanager
def served(*options: str) -> Iterator[Served]:
    """A server for the length of a ``with`` block, which SIGTERM ends."""
    with tempfile.TemporaryDirectory() as folder:
        server = Served(Path(folder), *options)
        try:
            yield server
        finally:
            server.process.send_signal(signal.SIGTERM)
            assert server.process.wait(timeout=30) == 130


class Client:
    """One connection, which stays open.

    Args:
        port: The server's port.
    """

    def __init__(self, port: int) -> None:
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=300)

    def plan(self, **asked: Any) -> tuple[float, str]:
        """Time of one request [s], and how it ended: the plan's status, or what was wrong."""
        start = time.perf_counter()
        self._connection.request("POST", "/plan", json.dumps({"hand": HAND, "task": "lift", **asked}))
        answer = self._connection.getresponse()
        found = json.loads(answer.read())
        seconds = time.perf_counter() - start
        return seconds, found["status"] if answer.status == 200 else f"{answer.status}: {found['reason']}"


def learnt(server: Served, rounds: int = 3) -> None:
    """Teach the objects, and let every planner prepare them."""

    def ask() -> None:
        client = Client(server.port)
        for _ in range(rounds):
            for name in OBJECTS:
                client.plan(object=name)

    clients = [threading.Thread(target=ask) for _ in range(2 * len(server.memory()))]
    for client in clients:
        client.start()
    for client in clients:
        client.join()


def one_client(server: Served, requests: int = 40) -> dict[str, float]:
    """Times of one client alone: the same request again, and one that must be computed [ms]."""
    client = Client(server.port)
    same = [client.plan(object="box")[0] for _ in range(requests)]
    computed = [client.plan(object="box", approaches=ORDERS[k])[0] for k in range(requests)]
    return {
        "same_ms": round(1e3 * statistics.median(same), 2),
        "same_slowest_ms": round(1e3 * max(same), 2),
        "computed_ms": round(1e3 * statistics.median(computed[requests // 2 :]), 2),
    }


def many_clients(server: Served, clients: int, seconds: float) -> dict[str, Any]:
    """Clients that ask without a pause, every tenth time for something that must be computed."""
    end = time.monotonic() + seconds
    times: list[float] = []
    ended: Counter[str] = Counter()

    def ask(number: int) -> None:
        client, k = Client(server.port), number
        while time.monotonic() < end:
            k += 1
            changed = {"approaches": ORDERS[k % len(ORDERS)]} if k % 10 == 0 else {}
            try:
                took, how = client.plan(object=OBJECTS[k % len(OBJECTS)], **changed)
            except (OSError, http.client.HTTPException, ValueError) as error:
                took, how = 0.0, f"{type(error).__name__}: {error}"
            times.append(took)
            ended[how] += 1

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(clients)]
    for thread in threads:
        thread.start()
    held: list[tuple[float, float]] = []
    while time.monotonic() < end:
        time.sleep(min(0.5, max(0.0, end - time.monotonic())))
        held.append((1 - (end - time.monotonic()) / seconds, sum(server.memory().values())))
    for thread in threads:
        thread.join()
    early = [size for share, size in held if 0.25 <= share < 0.5] or [held[0][1]]
    late = [size for share, size in held if share >= 0.75] or [held[-1][1]]
    growth = statistics.mean(late) / statistics.mean(early) - 1
    faults = [f"{count} × {how}" for how, count in ended.items() if how != "answer"]
    if growth > MOST_GROWTH:
        faults.append(f"the memory grew by {100 * growth:.1f} %")
    times.sort()
    return {
        "clients": clients,
        "seconds": seconds,
        "requests": len(times),
        "median_ms": round(1e3 * times[len(times) // 2], 1),
        "slowest_ms": round(1e3 * times[-1], 1),
        "memory_MB": round(statistics.mean(late)),
        "growth_percent": round(100 * growth, 2),
        "faults": faults,
    }


def study(clients: int, seconds: float, *options: str) -> dict[str, Any]:
    """Run the load on a fresh server and report."""
    with served(*options) as server:
        learnt(server)
        alone = one_client(server)
        many_clients(server, clients, min(5.0, seconds))  # all sizes of arrays have been in use
        return {"one client": alone, "many clients": many_clients(server, clients, seconds)}


def main(arguments: list[str]) -> int:
    """Run from the command line; returns 0 where nothing was found, else 1."""
    parser = argparse.ArgumentParser(prog="python -m hardening.load", description="Load on preshape serve.")
    parser.add_argument("--clients", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--long", action="store_true", help="ten minutes")
    parser.add_argument("--out", type=Path, default=Path("out/load"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    report = study(given.clients, 600.0 if given.long else given.seconds)
    write_json(given.out / "load.json", report)
    for name, found in report.items():
        print(f"{name}: " + ", ".join(f"{key} {value}" for key, value in found.items() if key != "faults"))
    for fault in report["many clients"]["faults"]:
        print(f"  fault: {fault}")
    return int(bool(report["many clients"]["faults"]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
