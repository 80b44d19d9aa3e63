"""What modes 0 and 1 are asked for: the estimate, and in the self-test one after the other."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from preshape.exceptions import InputError
from preshape.hiis.analyser import Aim
from preshape.hiis.controller import Controller
from preshape.hiis.critic import Thresholds
from preshape.hiis.decision import Settings, Status
from preshape.hiis.estimator import Estimate
from preshape.hiis.fuzzy import FuzzySets
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.memory import Memory
from preshape.objects.library import load_library_object
from preshape.objects.mesh import TriangleMesh
from preshape.tasks import parse_task
from test_controller import LAYOUT, prepared

NO_MATTER = {"confidence": 1.0, "outputs": np.zeros(9)}
"""What is irrelevant of an estimate."""


class Deaf:
    """An element that finds nothing when asked for few approach values, such as mode 0's single one."""

    def __init__(self, element: RayAnalyser, fewest: int) -> None:
        self._element, self._fewest = element, fewest

    def __getattr__(self, name):
        return getattr(self._element, name)

    def explore(self, q, aim):
        found = self._element.explore(q, aim)
        few = len(aim.planes) == 1 and len(aim.values) < self._fewest
        return replace(found.where(np.zeros(len(found), dtype=bool)), reason="deaf") if few else found


def test_the_self_test_goes_on_to_mode_1_where_mode_0_fails(tmp_path):
    """Learnt is what the estimator answers, at mode 0 or by searching the estimated plane (fig. 9)."""
    ways = {}
    for fewest in (0, 2, 10**6):  # hears everything; nothing at one approach value; nothing on one plane
        with Memory.open(tmp_path / f"{fewest}.sqlite") as memory:
            c = Controller(memory, LAYOUT)
            decision = c.teach(Deaf(prepared("mug"), fewest), parse_task("pour"))
            assert "mug" in {e.object_name for e in memory.experiences()}
            ways[fewest] = decision
            assert decision.deadlock == c.deadlock
    assert [ways[fewest].status for fewest in ways] == [Status.ANSWER, Status.ANSWER, Status.DEADLOCK]
    said = [ways[fewest].transitions[-1].reason for fewest in ways]
    assert "self-test at mode 0: TFVADI" in said[0]
    assert all("self-test at modes 0 and 1: " in reason for reason in said[1:])
    assert "aims were tried and" in ways[0].transitions[0].reason


def test_mode_0_takes_the_estimated_number_of_fingers_or_as_many_as_fit():
    with Memory.open(":memory:") as memory:
        c = Controller(memory, LAYOUT)
    q, met = parse_task("lift").q, set()
    for name, index, approach_set in product(("mug", "pen", "hammer"), range(1, 13), (1, 3, 5)):
        pa, value = prepared(name), float(FuzzySets().crisp()[approach_set])
        everything = pa.explore(q, Aim(planes=[index], values=[value]))
        for fingers in (2, 3, 4):
            estimate = Estimate(
                plane=index, approach_set=approach_set, fingers=fingers, confidence=1.0, outputs=np.zeros(9)
            )
            found = c.at_estimate(pa, q, estimate)
            most = max((int(n) for n in everything.fingers if n <= fingers), default=None)
            wanted = everything.where(everything.fingers == most)
            assert found.fingers.tolist() == wanted.fingers.tolist(), (name, index, approach_set, fingers)
            assert found.match.tolist() == wanted.match.tolist()
            assert (found.plane == index).all()
            assert (found.value == value).all()
            met.add((fingers, most))
    assert {(2, 2), (3, 3), (4, 4)} <= met
    assert any(most is not None and most < fingers for fingers, most in met), "fewer never had to do"


def finer(mesh: TriangleMesh) -> TriangleMesh:
    """The same surface with four times as many triangles."""
    a, b, c = (mesh.corners[:, k] for k in range(3))
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [np.stack(x, axis=1) for x in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    corners = np.concatenate(parts)
    triangles = np.arange(3 * len(corners)).reshape(-1, 3)
    return TriangleMesh(name=mesh.name, vertices=corners.reshape(-1, 3), triangles=triangles)


@pytest.mark.parametrize(("name", "task"), [("hammer", "strike"), ("wedge", "push"), ("bottle", "lift")])
@pytest.mark.parametrize("scale", [1.0, 1.04])
def test_a_task_that_was_taught_is_never_said_not_to_fit(monkeypatch, name, task, scale):
    """However wrong the estimate is, the planes of the object's own lessons are searched before mode 2."""
    mesh = finer(load_library_object(name))
    mesh = TriangleMesh(name=name, vertices=mesh.vertices * scale, triangles=mesh.triangles)
    pa, asked = RayAnalyser(mesh, LAYOUT), parse_task(task)
    with Memory.open(":memory:") as memory:
        c = Controller(memory, LAYOUT)
        taught = c.teach(prepared(name), asked).grasp
        assert taught is not None
        weak = []
        for number in range(1, 13):
            found = c.on_plane(pa, asked.q, Estimate(plane=number, approach_set=3, fingers=2, **NO_MATTER))
            if not len(found) or found.match[0] < 3.0:
                weak.append(number)
        assert weak, "every plane would do: the estimate cannot be wrong"
        for number in weak[:3]:
            wrong = Estimate(plane=number, approach_set=0, fingers=2, **NO_MATTER)
            monkeypatch.setattr("preshape.hiis.controller.decode", lambda *args, wrong=wrong: wrong)
            decision = c.run(pa, asked, may_learn=False)
            assert decision.status is Status.ANSWER, decision.reason
            assert decision.mode == 1
            assert decision.grasp.tfvadi >= 3.0
            assert decision.grasp.plane.index != number
            if scale != 1.0:  # otherwise the stored grasp itself may be the answer
                assert "where this task was taught" in decision.reason
            # Another task was never taught here, so only the estimated plane counts for it.
            other = c.run(pa, parse_task("0 0 0 0 0 0"), may_learn=False)
            assert "taught" not in other.reason


class Blocked:
    """An element that finds nothing for one task on a single plane, and answers everything else."""

    def __init__(self, element: RayAnalyser, q) -> None:
        self._element, self._q = element, q

    def __getattr__(self, name):
        return getattr(self._element, name)

    def explore(self, q, aim):
        found = self._element.explore(q, aim)
        none = np.zeros(len(found), dtype=bool)
        return found.where(none) if len(aim.planes) == 1 and np.array_equal(q, self._q) else found

    def recall(self, q, lessons):
        return []


def test_a_taught_task_whose_grasp_no_longer_fits_is_explored_and_any_other_is_corrected():
    taught, other = parse_task("pour"), parse_task("turn")
    with Memory.open(":memory:") as memory:
        c = Controller(memory, LAYOUT)
        first = c.teach(prepared("mug"), taught)
        again = c.run(Blocked(prepared("mug"), taught.q), taught, may_learn=False)
        assert [t.outcome for t in again.transitions] == ["penalty", "penalty", "known", "explored", "reward"]
        assert again.grasp.judged == first.grasp.judged
        refused = c.run(Blocked(prepared("mug"), other.q), other, may_learn=False)
        assert (refused.mode, refused.status) == (2, Status.CORRECTION)
        assert "recognition as mug" in refused.reason
        assert "on the planes that were searched, no grasp found" in refused.reason


def test_a_correction_carries_the_best_grasp_that_was_searched():
    with Memory.open(":memory:") as memory:
        Controller(memory, LAYOUT).teach(prepared("mug"), parse_task("pour"))
        strict = Settings(thresholds=Thresholds(estimation=5.9))
        decision = Controller(memory, LAYOUT, settings=strict).run(prepared("mug"), parse_task("lift"))
    assert decision.status is Status.CORRECTION
    assert decision.grasp is None
    assert 0.0 < decision.best.judged < 5.9
    assert f"TFVADI {decision.best.judged:.2f} is below the threshold 5.90" in decision.reason


@pytest.mark.parametrize(("match", "known"), [(3.0, True), (2.9, False)])
def test_only_an_object_that_can_be_held_for_some_task_is_refused_another(match, known):
    """A deadlock leaves a lesson, and so does a migrated grasp; neither may refuse other tasks."""
    with Memory.open(":memory:") as memory:
        Controller(memory, LAYOUT).teach(prepared("mug"), parse_task("pour"))
        lessons = memory.experiences()
    scored = [replace(e, match=match) if (e.kind, e.object_name) == ("task", "mug") else e for e in lessons]
    scored = [e for e in scored if e.kind != "grip"]
    with Memory.open(":memory:") as memory:
        memory.add(scored)
        c = Controller(memory, LAYOUT)
        other = parse_task("turn")
        decision = c.run(Blocked(prepared("mug"), other.q), other, may_learn=False)
    assert decision.transitions[2].outcome == "known"
    assert (decision.mode, decision.status) == ((2, Status.CORRECTION) if known else (3, Status.ANSWER))


def test_a_repeated_lesson_is_not_stored_again():
    with Memory.open(":memory:") as memory:
        c = Controller(memory, LAYOUT)
        c.teach(prepared("mug"), parse_task("pour"))
        before = memory.count()
        again = c.teach(prepared("mug"), parse_task("pour"))
        assert memory.count() == before
        assert "learnt before" in " ".join(t.reason for t in again.transitions)
        c.teach(prepared("mug"), parse_task("lift"))
        assert memory.count() > before
        assert c.knowledge.memory_state == memory.state()


def test_a_real_hand_knows_an_object_only_in_the_scene_and_by_what_was_good_enough(monkeypatch):
    """With inputs of kind ``shape``, lessons of another scene or below the threshold stop no request."""
    task, other = parse_task("pour"), parse_task("turn")
    with Memory.open(":memory:") as memory:
        there = Controller(memory, LAYOUT, kind="shape", scene="table 0 mm under the object")
        assert there.teach(prepared("mug"), task).status is Status.ANSWER
        here = Controller(memory, LAYOUT, kind="shape")
        nothing = prepared("mug").explore(task.q, Aim(planes=[5], values=[0.0]))
        nothing = replace(nothing.where(np.zeros(len(nothing), dtype=bool)), reason="nothing")
        for name in ("at_estimate", "on_plane"):
            monkeypatch.setattr(Controller, name, lambda *args, **more: nothing)
        monkeypatch.setattr(Controller, "_offers", lambda *args: ())
        known, unknown = (c.run(prepared("mug"), other, may_learn=False) for c in (there, here))
        assert [t.outcome for t in known.transitions[:4]] == ["penalty", "penalty", "known", "explored"]
        assert "its shape is that of mug" in known.transitions[2].reason
        assert [t.outcome for t in unknown.transitions[:3]] == ["penalty", "penalty", "unknown"]
        why = unknown.transitions[2].reason
        assert "knows mug only with another load, friction, table, boxes or model of the hand" in why
        new = here.run(prepared("hammer"), other, may_learn=False)
        assert new.transitions[2].reason == "no known object has its size"


def test_a_memory_of_both_units_without_a_first_lesson_gets_one():
    with Memory.open(":memory:") as memory:
        Controller(memory, LAYOUT).teach(prepared("mug"), parse_task("pour"))
        lessons = [e for e in memory.experiences() if e.kind != "seed"]
    old = [replace(e, length_unit="U", object_name="old") for e in lessons]
    for stored, seeds in (([*old, *lessons], 48), (lessons, 0)):
        with Memory.open(":memory:") as memory:
            memory.add(stored)
            Controller(memory, LAYOUT)
            assert sum(e.kind == "seed" for e in memory.experiences()) == seeds


def test_the_finger_rule_keeps_all_or_only_the_grasps_with_most_fingers_at_an_aim():
    found = prepared("hammer").explore(parse_task("lift").q, Aim(values=FuzzySets().crisp()))
    assert found.with_fingers("up_to") is found
    kept = found.with_fingers("all")
    aims = list(zip(found.plane.tolist(), found.flip.tolist(), found.value.tolist(), strict=True))
    most = {
        aim: max(n for n, a in zip(found.fingers.tolist(), aims, strict=True) if a == aim) for aim in aims
    }
    left = list(zip(kept.plane.tolist(), kept.flip.tolist(), kept.value.tolist(), strict=True))
    assert sorted(left) == sorted(most)  # each aim once
    assert [most[aim] for aim in left] == kept.fingers.tolist()
    assert len(kept) < len(found)
    assert (np.diff(kept.match) <= 1e-9).all()
    with pytest.raises(InputError, match="no finger rule 'most'; known: up_to, all"):
        Settings(finger_rule="most")
    with Memory.open(":memory:") as memory:
        c = Controller(memory, LAYOUT, settings=Settings(finger_rule="all"))
        for estimate in (Estimate(plane=p, approach_set=3, fingers=2, **NO_MATTER) for p in (3, 7)):
            on_plane = c.on_plane(prepared("hammer"), parse_task("lift").q, estimate)
            assert len(on_plane) == len(np.unique(np.stack([on_plane.flip, on_plane.value], axis=1), axis=0))


def test_a_deadlock_without_a_grasp_in_its_self_test_shows_what_was_explored():
    with Memory.open(":memory:") as memory:
        decision = Controller(memory, LAYOUT).teach(Deaf(prepared("cone"), 10**6), parse_task("lift"))
    assert decision.status is Status.DEADLOCK
    assert decision.best is not None
    assert 2.0 < decision.best.tfvadi < 3.0


def test_thresholds_are_numbers_whatever_was_given():
    limits = Thresholds(estimation=3, recognition=np.float32(5))
    assert [type(x) for x in (limits.estimation, limits.recognition)] == [float, float]
