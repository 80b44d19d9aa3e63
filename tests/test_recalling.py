"""Grips that are remembered: what modes 0 and 1 leave, and how they come back."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.recall import MOST_OF_ONE, MOST_RECALLED, recalled
from preshape.closure.settings import ClosureSettings
from preshape.hands import load_hand
from preshape.hiis.analyser import Aim, Grip
from preshape.hiis.controller import Controller
from preshape.hiis.decision import Decision, Settings, Status
from preshape.hiis.fuzzy import FuzzySets
from preshape.hiis.learning import training_set
from preshape.memory import Memory
from preshape.objects.library import load_library_object
from preshape.objects.mesh import TriangleMesh
from preshape.planning.controllers import closure_controller, layout_of
from preshape.tasks import parse_task
from preshape.types import ANSWER_KIND, Experience

HAND, LIFT, TWIST = load_hand("allegro"), parse_task("lift"), parse_task("twist")
SETS = FuzzySets()
QUICK = ClosureSettings(everywhere=600, elite=8, rounds=2, finished=4, persistence=1)
ALL_PLANES = tuple(range(1, 13))


@pytest.fixture
def memory(lesson: Callable[[str], Path], tmp_path: Path) -> Iterator[Memory]:
    """A memory that knows the cube."""
    with Memory.open(shutil.copy(lesson("allegro"), tmp_path / "m.sqlite")) as opened:
        yield opened


def controller_of(memory: Memory) -> Controller:
    return closure_controller(memory, HAND, settings=Settings(), closure=QUICK, gravity=LIFT.gravity)


def ask(memory: Memory, name: str = "box", task: Any = LIFT, **how: Any) -> tuple[Decision, ClosureAnalyser]:
    """A controller that wakes up and is asked."""
    controller = controller_of(memory)
    element = controller.prepare(load_library_object(name))
    assert isinstance(element, ClosureAnalyser)
    return controller.run(element, task, **how), element


def grips(memory: Memory) -> list[Experience]:
    return list(memory.experiences(kinds=[ANSWER_KIND]))


def pose(decision: Decision) -> np.ndarray:
    assert decision.grasp is not None
    assert isinstance(decision.grasp, Grip)
    return decision.grasp.palm_pose


# -- what modes 0 and 1 leave --------------------------------------------------------------------------


def test_the_grip_of_an_answer_is_remembered_and_comes_back(memory: Memory) -> None:
    first, searched = ask(memory)
    assert first.status is Status.ANSWER
    assert first.mode in (0, 1)
    assert searched.tried > 100
    (kept,) = grips(memory)
    assert kept.grip is not None
    np.testing.assert_array_equal(kept.grip[:7], pose(first) - np.append(searched.mesh.cog, np.zeros(4)))
    assert kept.quality == first.grasp.judged  # type: ignore[union-attr]
    again, recalling = ask(memory)
    assert again.mode == 0
    assert recalling.tried == 0, "what is stored is worked out again, and nothing is searched"
    np.testing.assert_allclose(pose(again), pose(first), atol=1e-12)
    assert len(grips(memory)) == 1, "no news"


def test_the_estimator_learns_nothing_of_it(memory: Memory) -> None:
    before = memory.weights(layout_of(HAND).name + "+closure")
    ask(memory)
    assert grips(memory)
    after = memory.weights(layout_of(HAND).name + "+closure")
    assert before is not None
    assert after is not None
    assert before.w1.tobytes() == after.w1.tobytes()
    everything = memory.experiences()
    x, _ = training_set(everything, layout_of(HAND).u, kind="shape")
    fewer, _ = training_set([e for e in everything if e.kind != ANSWER_KIND], layout_of(HAND).u, kind="shape")
    np.testing.assert_array_equal(x, fewer)


def test_it_does_not_make_the_object_a_known_one(memory: Memory) -> None:
    """Mode 2 offers other tasks for objects that were learnt; one that was only held is still explored."""
    ask(memory)
    assert grips(memory)
    controller = controller_of(memory)
    recognition = controller._mode_2(controller.prepare(load_library_object("box")))
    assert not recognition.verdict.reward


def test_what_the_memory_holds_never_makes_a_search_find_less(memory: Memory) -> None:
    """Stored grips are tried beside the candidates and displace none, whatever they are of."""
    for name, task in (("bottle", LIFT), ("brick", TWIST), ("box", TWIST)):
        ask(memory, name, task)
    mesh, lessons = load_library_object("box"), memory.experiences()
    assert sum(e.grip is not None for e in lessons) > 50
    tried = []
    for planes in (ALL_PLANES, (7,), (12,)):
        aim = Aim(planes=planes, values=np.linspace(-0.95, 0.95, 40))
        without, having = (
            ClosureAnalyser(
                mesh, HAND, layout_of(HAND), settings=QUICK, gravity=LIFT.gravity, known=lambda k=known: k
            ).explore(LIFT.q, aim)
            for known in ((), lessons)
        )
        fresh, found = (e.match.tolist() for e in (without, having))
        assert max(found, default=0.0) >= max(fresh, default=0.0) - 1e-12
        tried.append(having.tried - without.tried)
    assert tried[0] > 0


@pytest.mark.parametrize("why", ["not to learn", "read only"])
def test_nothing_is_remembered_where_nothing_may_be(memory: Memory, why: str) -> None:
    if why == "read only":
        with Memory.open(memory.where, read_only=True) as closed:
            decision, _ = ask(closed)
    else:
        decision, _ = ask(memory, may_learn=False)
    assert decision.mode in (0, 1)
    assert grips(memory) == []


def test_another_task_finds_the_grip_on_whatever_plane(memory: Memory) -> None:
    """What the estimator names for a task that it never met need not be where the object was held."""
    first, _ = ask(memory)
    (kept,) = grips(memory)
    controller = controller_of(memory)
    element = controller.prepare(load_library_object("box"))
    elsewhere = next(p for p in ALL_PLANES if p != kept.plane)
    values = [float(SETS.crisp()[3])]
    named = element.explore(TWIST.q, Aim(planes=[elsewhere], values=values))
    asked = element.explore(TWIST.q, Aim(planes=[elsewhere], values=values, recall=ALL_PLANES))
    assert all(plane == elsewhere for plane in named.plane)
    best = asked.grasp()
    assert isinstance(best, Grip)
    assert best.judged >= 3.0
    np.testing.assert_allclose(best.palm_pose, pose(first), atol=1e-12)
    assert asked.tried < named.tried / 5
    known = recalled(
        [kept], element.mesh, TWIST.q, Aim(planes=[elsewhere], values=values, recall=ALL_PLANES),
        hand=HAND, sets=SETS,
    )  # fmt: skip
    assert known is not None
    assert known.aimed.tolist() == [False]
    np.testing.assert_allclose(known.drawn.candidates.place[0], pose(first)[:3], atol=1e-12)


def test_approaches_that_are_not_allowed_are_not_remembered(memory: Memory) -> None:
    first, _ = ask(memory)
    assert first.grasp is not None
    axis = first.grasp.plane.approach_axis
    letter = "xyz"[int(np.argmax(np.abs(axis)))]
    other = next(a for a in "xyz" if a != letter)
    decision, _ = ask(memory, approaches=f"+{other},-{other}")
    assert decision.grasp is not None
    assert abs(decision.grasp.plane.approach_axis["xyz".index(other)]) == pytest.approx(1.0)


# -- which of them come back ---------------------------------------------------------------------------


def remembered(mesh: TriangleMesh, grasp: Grip, mark: float, **changes: Any) -> Experience:
    """A grip like that one, told from others by its first joint's angle."""
    grip = np.concatenate(
        [
            grasp.palm_pose[:3] - mesh.cog,
            grasp.palm_pose[3:],
            [grasp.mask],
            [mark],
            grasp.start[1:],
        ]
    )
    plain = Experience(
        kind="task", object_name="box", hand=HAND.name, attributes=mesh.attributes, task=LIFT.q,
        plane=grasp.plane.index, flip=grasp.flip, approach_value=grasp.approach_value,
        approach_set=grasp.approach_set, fingers=grasp.fingers, wrench=grasp.net_wrench, match=1.0,
        grip=grip, quality=4.0,
    )  # fmt: skip
    return replace(plain, **changes)


@pytest.fixture
def box(memory: Memory) -> tuple[TriangleMesh, Grip]:
    decision, element = ask(memory, may_learn=False)
    assert decision.grasp is not None
    return element.mesh, decision.grasp


def marks(known: list[Experience], mesh: TriangleMesh, **aim: Any) -> tuple[list[float], Any]:
    where = Aim(**{"planes": [12], "values": [0.0], "recall": ALL_PLANES, **aim})
    found = recalled(known, mesh, LIFT.q, where, hand=HAND, sets=SETS)
    assert found is not None
    return found.drawn.candidates.start[:, 0].tolist(), found


def sized(mesh: TriangleMesh, factor: float) -> Any:
    return replace(mesh, vertices=mesh.vertices * factor, counts=None).attributes


def test_the_object_most_alike_and_the_task_that_is_asked_come_first(box) -> None:
    mesh, grasp = box
    known = [
        remembered(mesh, grasp, 0.1, attributes=sized(mesh, 1.1), quality=5.9),
        remembered(mesh, grasp, 0.2, task=TWIST.q, quality=5.5),
        remembered(mesh, grasp, 0.3, quality=3.5),
        remembered(mesh, grasp, 0.4, quality=4.5),
        remembered(mesh, grasp, 0.5, attributes=sized(mesh, 1.4)),  # of another size: says nothing
    ]
    order, found = marks(known, mesh)
    assert order == [0.4, 0.3, 0.2, 0.1]
    assert (found.first, found.best_quality) == (2, 4.5)


def test_one_object_does_not_fill_the_list(box) -> None:
    mesh, grasp = box
    own = [remembered(mesh, grasp, 0.001 * k) for k in range(30)]
    other = [remembered(mesh, grasp, 0.2 + 0.001 * k, attributes=sized(mesh, 1.1)) for k in range(30)]
    order, _ = marks(own + other, mesh)
    assert [mark < 0.2 for mark in order] == [True] * MOST_OF_ONE + [False] * MOST_OF_ONE
    many = [
        remembered(mesh, grasp, 0.01 * k + 0.0001 * i, attributes=sized(mesh, 1 + 0.01 * k))
        for k in range(20)
        for i in range(5)
    ]
    order, _ = marks(many, mesh)
    assert len(order) == MOST_RECALLED
    assert max(order) < 0.01 * (MOST_RECALLED // 5 + 1)


def test_the_same_grip_is_tried_once_and_what_was_lost_not_at_all(box) -> None:
    mesh, grasp = box
    twice = [remembered(mesh, grasp, 0.1), remembered(mesh, grasp, 0.1, kind=ANSWER_KIND, task=TWIST.q)]
    lost = [remembered(mesh, grasp, 0.2), remembered(mesh, grasp, 0.2, outcome="lost")]
    order, _ = marks(twice + lost, mesh)
    assert order == [0.1]
    nothing = recalled(lost, mesh, LIFT.q, Aim(values=[0.0]), hand=HAND, sets=SETS)
    assert nothing is None


def test_without_recall_a_grip_must_lie_where_the_aim_is(box) -> None:
    mesh, grasp = box
    known = [remembered(mesh, grasp, 0.1)]
    value = [float(SETS.crisp()[grasp.approach_set])]
    there = {"planes": [grasp.plane.index], "values": value, "recall": ()}
    assert marks(known, mesh, **there)[0] == [0.1]
    fewer = [2] if min(grasp.fingers, 4) != 2 else [3]
    for elsewhere in (
        {"planes": [grasp.plane.index % 12 + 1]},
        {"flips": [not grasp.flip]},
        {"fingers": fewer},
        {"values": [0.95 if grasp.approach_value < 0 else -0.95]},
    ):
        aim = Aim(**{**there, **elsewhere})
        assert recalled(known, mesh, LIFT.q, aim, hand=HAND, sets=SETS) is None
