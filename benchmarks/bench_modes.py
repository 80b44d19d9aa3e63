"""Modes 0 and 1 of the ray analyser on a learnt object, without loading."""

from __future__ import annotations

from typing import Any

from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session

from .common import median_of, row, scan


def run() -> list[dict[str, Any]]:
    mesh, name = scan()
    with Session(":memory:") as session:
        ready = session.prepare(PlanRequest(source=mesh, task="lift", hand="utah_mit"))
        controller, element, task = ready.controller, ready.element, ready.task
        assert isinstance(element, RayAnalyser)
        controller.teach(element, task)
        controller.reset()

        def mode_0() -> Any:
            element.forget()
            return controller.run(element, task, may_learn=False)

        decision = mode_0()
        right = decision.mode == 0 and decision.grasp is not None
        zero = median_of(mode_0, 50)

        def mode_1() -> Any:
            element.forget()
            return controller.on_plane(element, task.q, decision.estimate)

        found, estimated = mode_1(), controller.at_estimate(element, task.q, decision.estimate)
        one = median_of(mode_1, 30)
        better = bool(len(found)) and bool(found.match[0] >= estimated.match[0] - 1e-9)
    ratio = f"mode 1 {1e3 * one:.2g} ms, ratio {one / zero:.1f}"
    return [
        row(f"mode 0 ({name})", 1e3 * zero, "ms", 2.0, ratio, right),
        row(f"mode 1 ({name})", 1e3 * one, "ms", None, None, better),
    ]
