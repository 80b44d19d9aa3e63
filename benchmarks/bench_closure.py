"""The closure analyser end to end: an unknown object, a learnt one, what preparing costs, and memory."""

from __future__ import annotations

import resource
import time
from typing import Any

import numpy as np

from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.settings import ClosureSettings
from preshape.planning.session import closure_controller
from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim
from preshape.hiis.decision import Settings
from preshape.kernels.field.host import prepare_field
from preshape.memory import Memory
from preshape.planning.session import layout_of
from preshape.tasks import parse_task

from .common import median_of, row, scan

EVERYWHERE = Aim(values=np.linspace(-1.0, 1.0, 71))


def run() -> list[dict[str, Any]]:
    mesh, name = scan()
    hand, task = load_hand("shadow"), parse_task("lift")
    start = time.perf_counter()
    prepare_field(mesh, cache=None)
    filling = time.perf_counter() - start
    element = ClosureAnalyser(mesh, hand, layout_of(hand), gravity=task.gravity)
    seeds = iter(range(10_000))
    best: list[float] = []

    def unknown() -> None:
        element.seed = next(seeds)
        element._kept.clear()
        found = element.explore(task.q, EVERYWHERE)
        best.append(float(found.match[0]) if len(found) else 0.0)

    searching = median_of(unknown, 20)
    with Memory.open(":memory:") as memory:
        controller = closure_controller(
            memory,
            hand,
            settings=Settings(),
            closure=ClosureSettings(),
            gravity=task.gravity,
        )
        known = controller.prepare(mesh)
        assert isinstance(known, ClosureAnalyser)
        controller.teach(known, task)
        controller.reset()
        modes: list[int] = []

        def learnt() -> None:
            known._kept.clear()
            decision = controller.run(known, task, may_learn=False)
            modes.append(decision.mode if decision.grasp is not None else -1)

        recalling = median_of(learnt, 50)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    sound = min(best) >= 3.0
    return [
        row(f"preparing an object, {name}: distance field", 1e3 * filling, "ms", 1000.0, None, True),
        row(
            f"unknown object, {name}, to ranked answer",
            1e3 * searching,
            "ms",
            100.0,
            f"learnt {1e3 * recalling:.3g} ms: ratio {searching / recalling:.1f}",
            sound,
        ),
        row(f"learnt object, {name}, mode 0", 1e3 * recalling, "ms", 10.0, None, set(modes) == {0}),
        row("peak memory of this process", peak, "MB", 1000.0, None, True),
    ]
