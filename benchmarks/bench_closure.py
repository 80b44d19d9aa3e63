"""The closure analyser: time for an unknown and a learnt object, time to prepare one, and memory."""

from __future__ import annotations

import resource
import time
from typing import Any

import numpy as np

from preshape.closure.analyser import ClosureAnalyser
from preshape.hiis.analyser import Aim
from preshape.kernels.field.host import prepare_field
from preshape.planning.controllers import closure_analyser
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session
from preshape.types import FIELD_MASS

from .common import median_of, row, scan

ALL_PLANES = Aim(values=np.linspace(-1.0, 1.0, 71))


def run() -> list[dict[str, Any]]:
    mesh, name = scan()
    request = PlanRequest(source=mesh, task="lift", hand="shadow", mass=FIELD_MASS, table=None)
    q = request.asked.q
    start = time.perf_counter()
    prepare_field(mesh, cache=None)
    filling = time.perf_counter() - start
    with Session(":memory:") as session:
        ready = session.prepare(request)
        element = closure_analyser(request, ready.hand, mesh)
        seeds = iter(range(10_000))
        best: list[float] = []

        def unknown() -> None:
            element.seed = next(seeds)
            element.forget()
            found = element.explore(q, ALL_PLANES)
            best.append(float(found.match[0]) if len(found) else 0.0)

        searching = median_of(unknown, 20)
        controller, known = ready.controller, ready.element
        assert isinstance(known, ClosureAnalyser)
        controller.teach(known, request.asked)
        controller.reset()
        modes: list[int] = []

        def learnt() -> None:
            known.forget()
            decision = controller.run(known, request.asked, may_learn=False)
            modes.append(decision.mode if decision.grasp is not None else -1)

        recalling = median_of(learnt, 50)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return [
        row(f"prepare an object ({name}): distance field", 1e3 * filling, "ms", 1000.0, None, True),
        row(
            f"unknown object ({name}), ranked answer",
            1e3 * searching,
            "ms",
            100.0,
            f"learnt {1e3 * recalling:.3g} ms, ratio {searching / recalling:.1f}",
            min(best) >= 3.0,
        ),
        row(f"learnt object ({name}), mode 0", 1e3 * recalling, "ms", 10.0, None, set(modes) == {0}),
        row("peak memory of this process", peak, "MB", 1000.0, None, True),
    ]
