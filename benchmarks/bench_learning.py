"""Learning one more object, with both thumb sides searched, when the memory knows many already."""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from preshape.objects.library import entry, names
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session

from .common import row

OBJECTS = 24


def run() -> list[dict[str, Any]]:
    times: list[float] = []
    recalled = 0
    requests = [
        PlanRequest(source=name, task=entry(name).tasks[0], hand="utah_mit", learn=False)
        for name in names()[:OBJECTS]
    ]
    with tempfile.TemporaryDirectory() as folder, Session(Path(folder) / "memory.sqlite") as session:
        for request in requests:
            ready = session.prepare(request)
            start = time.perf_counter()
            ready.controller.teach(ready.element, request.asked)
            times.append(time.perf_counter() - start)
            ready.controller.reset()
        for request in requests:
            recalled += session.run(request).decision.mode <= 1
        samples = session.prepare(requests[0]).controller.weights.trained_on
    base = f"slowest of {len(times)}: {max(times):.2g} s; {samples} samples at the end"
    ok = recalled >= 0.95 * len(times)
    return [row("learn one object, on disk", statistics.median(times), "s", 1.0, base, ok)]
