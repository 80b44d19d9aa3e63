"""What physics says of a grip is remembered: what held is taught and recalled, what was lost is neither."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from preshape.closure.analyser import ClosureAnalyser, GripExploration
from preshape.closure.settings import ClosureSettings
from preshape.hands import load_hand
from preshape.hiis.analyser import Aim, Grasp, Grip
from preshape.hiis.controller import Controller
from preshape.hiis.decision import Settings
from preshape.hiis.learning import training_set
from preshape.memory import Memory
from preshape.objects.library import load_library_object
from preshape.planning.controllers import closure_controller, layout_of
from preshape.tasks import parse_task

HAND, TASK = load_hand("allegro"), parse_task("lift")
QUICK = ClosureSettings(everywhere=600, elite=8, rounds=2, finished=4, persistence=1)


@pytest.fixture
def met(
    lesson: Callable[[str], Path], tmp_path: Path
) -> Iterator[tuple[Controller, ClosureAnalyser, list[Grip]]]:
    """A controller that has met a box, and the grips found for it, best first."""
    with Memory.open(shutil.copy(lesson("allegro"), tmp_path / "m.sqlite")) as memory:
        controller = closure_controller(
            memory, HAND, settings=Settings(), closure=QUICK, gravity=TASK.gravity
        )
        element = controller.prepare(load_library_object("box"))
        assert isinstance(element, ClosureAnalyser)
        decision = controller.teach(element, TASK)
        assert decision.grasp is not None
        everything = next(iter(element._cache.values()))
        assert len(everything.grips) >= 2
        yield controller, element, list(everything.grips)


def start(grasp: Grasp | None) -> bytes:
    assert grasp is not None
    assert isinstance(grasp, Grip)
    return grasp.start.tobytes()


def again(controller: Controller, element: ClosureAnalyser) -> tuple[int, Grasp | None]:
    controller.reset()
    decision = controller.run(element, TASK, may_learn=False)
    return decision.mode, decision.grasp


def test_what_is_remembered_is_the_answer_at_once(met) -> None:
    controller, element, _ = met
    element._cache.clear()
    mode, grasp = again(controller, element)
    assert mode == 0
    assert start(grasp) == controller.experiences[-3].grip[8:].tobytes()
    assert element.tried <= 16, "only what is remembered was closed"


def test_what_was_lost_is_not_recalled_nor_taught(met) -> None:
    controller, element, _ = met
    _, first = again(controller, element)
    before = len(training_set(controller.experiences, 0.1, kind="shape")[0])
    controller.knowledge.learn_outcomes(element, TASK, [(first, False)])
    assert [e.outcome for e in controller.experiences[-2:]] == ["", "lost"]
    assert len(training_set(controller.experiences, 0.1, kind="shape")[0]) == before - 1
    _, second = again(controller, element)
    assert second is not None
    assert start(second) != start(first)


def test_a_grip_that_held_stays_taught_when_another_of_its_kind_is_lost(met) -> None:
    controller, element, grasps = met
    a = grasps[0]
    b = next((g for g in grasps[1:] if (g.plane.index, g.fingers) == (a.plane.index, a.fingers)), grasps[1])
    controller.knowledge.learn_outcomes(element, TASK, [(a, True)])
    x, y = training_set(controller.experiences, 0.1, kind="shape")
    controller.knowledge.learn_outcomes(element, TASK, [(b, False), (a, True)])
    again_x, again_y = training_set(controller.experiences, 0.1, kind="shape")
    np.testing.assert_array_equal(again_x, x)
    np.testing.assert_array_equal(again_y, y)


def test_an_answer_is_where_it_was_aimed_at(met) -> None:
    controller, element, grasps = met
    taught = grasps[0]
    controller.knowledge.learn_outcomes(element, TASK, [(taught, True)])
    far = 0.95 if taught.approach_value < 0 else -0.95
    aim = Aim(planes=[taught.plane.index], values=[far], fingers=[2], flips=[not taught.flip])
    found = element.explore(TASK.q, aim)
    assert isinstance(found, GripExploration)
    assert all(start(g) != start(taught) for g in found.grips)


def test_what_held_in_place_of_it_is_the_answer_from_now_on(met) -> None:
    controller, element, grasps = met
    _, first = again(controller, element)
    other = next(g for g in grasps if start(g) != start(first))
    controller.knowledge.learn_outcomes(element, TASK, [(first, False), (other, True)])
    stored = controller.memory.experiences(hand=controller.layout.name)
    assert [e.outcome for e in stored[-2:]] == ["lost", "held"], "both are on disk"
    mode, second = again(controller, element)
    assert mode == 0
    assert second is not None
    assert second.plane.index == other.plane.index
    assert start(second) == start(other)
    controller.knowledge.learn_outcomes(element, TASK, [(second, True)])
    assert len(controller.memory.experiences(hand=controller.layout.name)) == len(stored), "no news"
    x, y = training_set(stored, layout_of(HAND).u, kind="shape")
    assert len(x) == len(y) == len(np.unique(np.round(x, 6), axis=0))


def test_nothing_tried_is_nothing_learnt(met) -> None:
    controller, element, _ = met
    before = controller.experiences
    controller.knowledge.learn_outcomes(element, TASK, [])
    assert controller.experiences is before
