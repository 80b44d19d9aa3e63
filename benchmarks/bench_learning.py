"""Learning one more object (both thumb sides searched) with a memory that already knows many."""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from preshape.hiis.controller import Controller
from preshape.memory import Memory
from preshape.objects.library import entry, names
from preshape.objects.load import load_object
from preshape.tasks import parse_task

from .common import layout, row


def run() -> list[dict[str, Any]]:
    times: list[float] = []
    recalled = 0
    with tempfile.TemporaryDirectory() as folder, Memory.open(Path(folder) / "memory.sqlite") as memory:
        controller = Controller(memory, layout())
        taught = names()[:24]
        for name in taught:
            mesh = load_object(name)
            task = parse_task(entry(name).tasks[0])
            start = time.perf_counter()
            controller.teach(mesh, task)
            times.append(time.perf_counter() - start)
            controller.reset()
        for name in taught:
            decision = controller.run(load_object(name), parse_task(entry(name).tasks[0]), may_learn=False)
            controller.reset()
            recalled += decision.mode <= 1
        samples = controller.weights.trained_on
    base = f"slowest of {len(times)}: {max(times):.2g} s; {samples} samples at the end"
    ok = recalled >= 0.95 * len(times)
    return [row("learning one object, on disk", statistics.median(times), "s", 1.0, base, ok)]
