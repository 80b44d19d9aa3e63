"""Processor time of ``preshape plan`` on a learnt object: by itself, again, and answered by a server."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from hardening.load import learnt, one_client, served

from .common import row

PLAN = ("plan", "mug", "--task", "lift", "--hand", "shadow", "--json")
REPEATS = 5


def processor_time(words: tuple[str, ...], environment: dict[str, str]) -> tuple[float, Any]:
    """Processor time of one process [s], and the document that it prints."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "preshape", *words]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return spent, json.loads(done.stdout) if "--json" in words else None


def untimed(document: Any) -> Any:
    return {**document, "seconds": None}


def run() -> list[dict[str, Any]]:
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        words = (*PLAN, "--memory", str(Path(folder) / "memory.sqlite"))
        alone = {**os.environ, "PRESHAPE_SERVE": "off", "XDG_RUNTIME_DIR": folder, "PRESHAPE_CACHE": folder}
        alone.pop("PYTHONDONTWRITEBYTECODE", None)
        for _ in range(3):  # learnt, and settled
            processor_time(words, alone)
        first, again = [], []
        for _ in range(REPEATS):
            shutil.rmtree(Path(folder) / "answers")
            first.append(processor_time(words, alone))
            again.append(processor_time(words, alone))
        usual = statistics.median(processor_time(("--help",), alone)[0] for _ in range(REPEATS))
        server = subprocess.Popen(
            [sys.executable, "-m", "preshape", "serve", "--port", "0", "--workers", "1", *words[-2:]],
            stderr=subprocess.PIPE,
            text=True,
            env=alone,
        )
        try:
            assert server.stderr is not None
            server.stderr.readline()
            asking = {**alone, "PRESHAPE_SERVE": ""}
            end = time.monotonic() + 120
            while processor_time(words, asking)[0] > 0.25 and time.monotonic() < end:
                time.sleep(1)  # its planner still warms up
            asked = [processor_time(words, asking) for _ in range(REPEATS)]
        finally:
            server.send_signal(signal.SIGTERM)
            server.communicate()
    document = untimed(again[0][1])
    every = [*first, *again, *asked]
    right = document["mode"] == 0 and all(untimed(other) == document for _, other in every)
    baseline = f"--help {usual:.2g} s"
    for what, times, target in (("", first, 0.8), (", again", again, 0.8), (", by a server", asked, 0.25)):
        spent = statistics.median(seconds for seconds, _ in times)
        rows.append(row(f"preshape plan, learnt mug: CPU{what}", spent, "s", target, baseline, right))
    with served("--workers", "1") as load:
        learnt(load)
        found = one_client(load)
    rows.append(row("preshape serve, learnt box, same request", found["same_ms"], "ms", 20.0, None, True))
    rows.append(row("preshape serve, learnt box, computed", found["computed_ms"], "ms", None, None, True))
    return rows
