"""The bench that every experiment stands on: one hand, the first training, and how a run is noted down."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from ..hands.load import load_hand
from ..hiis.analyser import Analyser, Grasp, HandLayout
from ..hiis.controller import Controller
from ..hiis.critic import recognise
from ..hiis.decision import Decision, Settings
from ..hiis.learning import explore
from ..hiis.virtual_grasp import RayAnalyser
from ..memory import Memory
from ..objects.library import load_library_object
from ..objects.mesh import TriangleMesh
from ..planner import RAY_HAND, layout_of
from ..tasks import Task
from ..types import Array, Experience, NetworkWeights

Data: TypeAlias = dict[str, Any]
"""Plain JSON values. Every time that was measured stands under a key ``seconds``."""


class Bench:
    """Hand, seed, and controllers that know the cube only.

    Args:
        seed: of everything random.
        quick: whether experiments run in their small form.
    """

    def __init__(self, seed: int = 0, *, quick: bool = False) -> None:
        self.seed = seed
        self.quick = quick
        self.hand = load_hand(RAY_HAND)
        self.layout: HandLayout = layout_of(self.hand)
        self._first: dict[int, tuple[tuple[Experience, ...], NetworkWeights]] = {}
        self._analysers: dict[str, Analyser] = {}

    def controller(self, settings: Settings | None = None) -> Controller:
        """A controller with a memory of its own that knows the cube only.

        The first training is done at the default settings, whatever the controller's are, so that a
        change of settings is a change of settings alone.
        """
        chosen = settings or Settings(seed=self.seed)
        if chosen.seed not in self._first:
            first = Controller(Memory.open(":memory:"), self.layout, settings=Settings(seed=chosen.seed))
            self._first[chosen.seed] = first.experiences, first.weights
            first.memory.close()
        memory = Memory.open(":memory:")
        memory.add(*self._first[chosen.seed])
        return Controller(memory, self.layout, settings=chosen)

    def beside(self, controller: Controller, settings: Settings) -> Controller:
        """Another controller on the same memory: what was learnt stays, the settings change."""
        return Controller(controller.memory, self.layout, settings=settings)

    def library(self, name: str) -> Analyser:
        """A library object's performance element at the default settings."""
        if name not in self._analysers:
            self._analysers[name] = RayAnalyser(load_library_object(name), self.layout)
        return self._analysers[name]


def box_mesh(name: str, extents: Array) -> TriangleMesh:
    """A box of 12 triangles, centred, outward by the right-hand rule; extents [m]."""
    corner = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return TriangleMesh(name=name, vertices=corner * extents, triangles=np.array(triangles))


def grasp_data(grasp: Grasp | None) -> Data | None:
    """A virtual grasp as JSON values."""
    if grasp is None:
        return None
    return {
        "plane": grasp.plane.index,
        "flip": grasp.flip,
        "value": round(grasp.approach_value, 6),
        "fingers": grasp.fingers,
        "tfvadi": round(grasp.tfvadi, 6),
        "wrench": [round(float(x), 6) for x in grasp.net_wrench],
    }


def run_case(controller: Controller, element: Analyser, task: Task, *, may_learn: bool = True) -> Data:
    """Run one task and note down what came of it.

    Beside the answer: the match of what was estimated (``estimated_match``, mode 0), the best that the
    estimated plane could do (``searched``, mode 1), the best of all planes (``best``), and how well the
    object was recognised (``recognition``, 0..6).
    """
    known = controller.experiences
    decision: Decision = controller.run(element, task, may_learn=may_learn)
    controller.reset()
    s = controller.settings
    found = explore(element, task.q, s.sets, enough=s.thresholds.estimation)
    # Mode 3 reports no estimate; the one before it is gone with the weights, and not needed.
    estimated_match, searched = None, None
    if decision.estimate is not None:
        named = controller.at_estimate(element, task.q, decision.estimate)
        there = controller.on_plane(element, task.q, decision.estimate)
        estimated_match = round(float(named.match[0]), 6) if len(named) else None
        searched = there.grasp() if len(there) else None
    recognition = recognise(element, known, s.thresholds.recognition, s.sets)
    return {
        "q": [float(x) for x in task.q],
        "mode": decision.mode,
        "status": decision.status.value,
        "estimated_plane": decision.estimate.plane if decision.estimate else None,
        "estimated_match": estimated_match,
        "answer": grasp_data(decision.grasp),
        "searched": grasp_data(searched),
        "best": grasp_data(found.answer if found else None),
        "recognition": recognition.verdict.match,
        "steps": [[t.mode, t.outcome, t.reason] for t in decision.transitions],
    }
