"""Mode 0 and mode 1 on a learnt object, after loading."""

from __future__ import annotations

from typing import Any

import numpy as np

from preshape.hiis.controller import Controller
from preshape.memory import Memory
from preshape.tasks import parse_task

from .common import layout, median_of, row, scan


def run() -> list[dict[str, Any]]:
    mesh, name = scan()
    task = parse_task("lift")
    with Memory.open(":memory:") as memory:
        controller = Controller(memory, layout())
        element = controller.prepare(mesh)
        controller.teach(element, task)
        controller.reset()

        def mode_0() -> Any:
            element.forget()
            return controller.run(element, task, may_learn=False)

        decision = mode_0()
        right = decision.mode == 0 and decision.grasp is not None
        zero = median_of(mode_0, 50)
        estimate = decision.estimate
        assert estimate is not None

        def mode_1() -> Any:
            element.forget()
            return controller._mode_1(element, task.q, estimate)

        grasp, verdict = mode_1()
        one = median_of(mode_1, 30)
        better = grasp is not None and verdict.reward and grasp.tfvadi >= decision.grasp.tfvadi - 1e-9
    ratio = f"mode 1 {1e3 * one:.2g} ms, ratio {one / zero:.1f}"
    return [
        row(f"mode 0, {name}", 1e3 * zero, "ms", 2.0, ratio, right),
        row(f"mode 1, {name}", 1e3 * one, "ms", None, None, bool(np.all(better))),
    ]
