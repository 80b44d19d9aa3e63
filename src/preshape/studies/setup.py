"""Common parts of the experiments: hand and seed, systems that know only the cube, runs as JSON values."""

from __future__ import annotations

from typing import Any, TypeAlias

from ..hands.load import load_hand
from ..hiis.analyser import Grasp
from ..hiis.critic import recognise
from ..hiis.decision import Settings
from ..hiis.learning import explore
from ..memory import Memory
from ..objects.mesh import TriangleMesh
from ..planning.request import RAY_HAND, PlanRequest
from ..planning.session import Prepared, Session
from ..tasks import Task, task_from_numbers
from ..types import Experience, NetworkWeights
from . import printed

Data: TypeAlias = dict[str, Any]
"""Plain JSON values; measured times have the key ``seconds``."""
Q1 = task_from_numbers(printed.Q1)
"""The paper's task Q1."""


class Setup:
    """Seed and size of the experiments, and systems that know only the cube.

    A system is a session with its own memory, the paper's hand and the ray analyser.

    Args:
        seed: Seed of every random draw.
        quick: Whether experiments run in their small form.
    """

    def __init__(self, seed: int = 0, *, quick: bool = False) -> None:
        self.seed = seed
        self.quick = quick
        self.hand = load_hand(RAY_HAND)
        self._first: dict[int, tuple[tuple[Experience, ...], NetworkWeights]] = {}

    def system(self, seed: int | None = None) -> Session:
        """A system that knows only the cube.

        The first training uses the default settings, so it does not depend on later changes of the settings.

        Args:
            seed: Seed of the training; by default the seed of the experiments.
        """
        seed = self.seed if seed is None else seed
        if seed not in self._first:
            with Session(":memory:") as session:
                controller = self.prepare(session, "cube", settings=Settings(seed=seed)).controller
                self._first[seed] = controller.experiences, controller.weights
        memory = Memory.open(":memory:")
        memory.add(*self._first[seed])
        return Session(memory)

    def prepare(
        self,
        system: Session,
        source: str | TriangleMesh,
        task: Task = Q1,
        *,
        scale: float = 1.0,
        settings: Settings | None = None,
    ) -> Prepared:
        """Prepare a system for an object and a task.

        Args:
            system: The system; its memory is kept when the settings change.
            source: Library name or mesh [m].
            task: The task.
            scale: Factor on a library object's size.
            settings: Settings of the planner; by default the default settings with the experiments' seed.
        """
        settings = settings or Settings(seed=self.seed)
        return system.prepare(
            PlanRequest(source=source, task=task, hand=self.hand, scale=scale, settings=settings)
        )


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


def run_case(ready: Prepared, task: Task | None = None, *, may_learn: bool = True) -> Data:
    """Run one task and record the result as JSON values.

    The record has the answer and, for comparison, the match of the estimated grasp (``estimated_match``,
    mode 0), the best grasp on the estimated plane (``searched``, mode 1), the best grasp on all planes
    (``best``), and the match of the object's recognition (``recognition``, 0..6).

    Args:
        ready: The system with its object.
        task: The task; by default that of the request.
        may_learn: Whether mode 3 may learn.
    """
    controller, element = ready.controller, ready.element
    task = task or ready.request.asked
    known = controller.experiences
    decision = controller.run(element, task, may_learn=may_learn)
    controller.reset()
    s = controller.settings
    found = explore(element, task.q, s.sets, enough=s.thresholds.estimation)
    # After mode 3 there is no estimate, because learning has replaced the weights that gave it.
    estimated_match, searched = None, None
    if decision.estimate is not None:
        estimated = controller.at_estimate(element, task.q, decision.estimate)
        on_plane = controller.on_plane(element, task.q, decision.estimate)
        estimated_match = round(float(estimated.match[0]), 6) if len(estimated) else None
        searched = on_plane.grasp() if len(on_plane) else None
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
        "steps": [[step.mode, step.outcome, step.reason] for step in decision.transitions],
    }


def teach(ready: Prepared, task: Task | None = None) -> str:
    """Teach the object with a task (mode 3); returns the controller's status."""
    decision = ready.controller.teach(ready.element, task or ready.request.asked)
    ready.controller.reset()
    return decision.status.value
