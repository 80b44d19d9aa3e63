"""Common parts of the experiments: hand and seed, systems that know only the cube, runs as JSON values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from ..hands.load import load_hand
from ..hiis.analyser import Aim, Analyser, FingerRule, Grasp
from ..hiis.critic import recognise
from ..hiis.decision import Settings
from ..hiis.learning import explore, seed_cube
from ..hiis.planes import plane
from ..hiis.virtual_grasp import RayAnalyser
from ..memory import Memory
from ..objects.mesh import TriangleMesh
from ..planning.controllers import layout_of
from ..planning.request import RAY_HAND, PlanRequest
from ..planning.rules import NONE
from ..planning.session import Prepared, Session
from ..tasks import Task, task_from_numbers
from ..types import Experience, NetworkWeights
from . import printed

Data: TypeAlias = dict[str, Any]
"""Plain JSON values; measured times have the key ``seconds``."""
Q1 = task_from_numbers(printed.Q1)
"""The paper's task Q1."""
CUBE = "cube of the first training"
"""Name of the cube that every system knows; it is no object of the library, whose cube is smaller."""
FINGER_PITCH = 0.14
"""Distance of neighbouring fingers in 4U that fits the torques of figs. 14 and 15 best [R]."""
PITCHES = ("paper", "hand")
"""Distances of neighbouring fingers: the one that the paper's torques fit, and the hand's own."""


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
        own = layout_of(self.hand)
        self.cube = seed_cube(own)
        self.layouts = {
            "paper": replace(own, finger_pitch=FINGER_PITCH * own.length_unit),
            "hand": own,
        }
        self._first: dict[tuple[int, FingerRule], tuple[tuple[Experience, ...], NetworkWeights]] = {}
        self._measured: dict[tuple[str, ...], Any] = {}

    @property
    def seeds(self) -> range:
        """The seeds of experiments that are repeated, from the seed of the experiments on."""
        return range(self.seed, self.seed + (2 if self.quick else 6))

    def once(self, key: tuple[str, ...], measure: Callable[[], Data]) -> Data:
        """What ``measure`` returns; with the same key it is called once, as two experiments may need it."""
        if key not in self._measured:
            self._measured[key] = measure()
        data: Data = self._measured[key]
        return data

    def system(self, seed: int | None = None, finger_rule: FingerRule = "up_to") -> Session:
        """A system that knows only the cube.

        The first training uses the default settings apart from the finger rule, so it does not depend on
        later changes of the settings.

        Args:
            seed: Seed of the training; by default the seed of the experiments.
            finger_rule: Virtual fingers that the first training may use.
        """
        key = (self.seed if seed is None else seed, finger_rule)
        if key not in self._first:
            settings = Settings(seed=key[0], finger_rule=finger_rule)
            with Session(":memory:") as session:
                controller = self.prepare(session, CUBE, settings=settings).controller
                self._first[key] = controller.experiences, controller.weights
        memory = Memory.open(":memory:")
        memory.add(*self._first[key])
        return Session(memory)

    def analyser(self, pitch: str, settings: Settings | None = None) -> RayAnalyser:
        """The ray analyser of the cube, with one of :data:`PITCHES`."""
        s = settings or Settings()
        return RayAnalyser(self.cube, self.layouts[pitch], coefficients=s.coefficients, sets=s.sets)

    def on_cube(self, number: int, coordinate: float, settings: Settings | None = None) -> Data:
        """The virtual grasps for Q1 on the cube at a printed plane and approach value.

        Thumb and two fingers are used, without flip.

        Args:
            number: Index of the approach plane, 1..12.
            coordinate: The printed approach value: coordinate of the fingertips in 4U [R].
            settings: Contact coefficients and membership functions.

        Returns:
            The grasp, or ``None``, for each of :data:`PITCHES`.
        """
        grasps = {}
        for pitch in PITCHES:
            analyser = self.analyser(pitch, settings)
            value = coordinate / half_extent(analyser, number)
            found = analyser.explore(Q1.q, Aim(planes=[number], values=[value], fingers=[3], flips=[False]))
            grasps[pitch] = grasp_data(found.grasp(), analyser) if len(found) else None
        return grasps

    def request(
        self,
        source: str | TriangleMesh,
        task: Task = Q1,
        *,
        scale: float = 1.0,
        settings: Settings | None = None,
    ) -> PlanRequest:
        """A request for an object and a task.

        Args:
            source: Library name, :data:`CUBE`, or mesh [m].
            task: The task.
            scale: Factor on a library object's size.
            settings: Settings of the planner; by default the default settings with the experiments' seed.
        """
        settings = settings or Settings(seed=self.seed)
        mesh = self.cube if source == CUBE else source
        return PlanRequest(
            source=mesh, task=task, hand=self.hand, scale=scale, settings=settings, table=None, rules=NONE
        )

    def prepare(
        self, system: Session, source: str | TriangleMesh, task: Task = Q1, **options: Any
    ) -> Prepared:
        """Prepare a system for a request; see :meth:`request`.

        The system's memory is kept when the settings change.
        """
        return system.prepare(self.request(source, task, **options))


def half_extent(element: Analyser, number: int) -> float:
    """The object's half-extent along the approach axis of a plane, in 4U."""
    half = element.mesh.extents / 2
    return float(np.abs(plane(number).approach_axis) @ half / element.layout.length_unit)


def grasp_data(grasp: Grasp | None, element: Analyser) -> Data | None:
    """A virtual grasp as JSON values; its approach value as a share and as the paper's coordinate in 4U."""
    if grasp is None:
        return None
    return {
        "plane": grasp.plane.index,
        "flip": grasp.flip,
        "value": round(grasp.approach_value, 6),
        "coordinate": round(grasp.approach_value * half_extent(element, grasp.plane.index), 6),
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
    task = task or ready.task
    known = controller.experiences
    decision = controller.run(element, task, may_learn=may_learn)
    controller.reset()
    s = controller.settings
    found = explore(element, task.q, s.sets, enough=s.thresholds.estimation, finger_rule=s.finger_rule)
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
        "answer": grasp_data(decision.grasp, element),
        "searched": grasp_data(searched, element),
        "best": grasp_data(found.answer if found else None, element),
        "recognition": recognition.verdict.match,
        "steps": [[step.mode, step.outcome, step.reason] for step in decision.transitions],
    }


def teach(ready: Prepared, task: Task | None = None) -> str:
    """Teach the object with a task (mode 3); returns the controller's status."""
    decision = ready.controller.teach(ready.element, task or ready.task)
    ready.controller.reset()
    return decision.status.value
