"""From a name to a grip in physics: plan() with the closure analyser, its modes, files and memory."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from preshape.closure.settings import ClosureSettings
from preshape.exceptions import InputError
from preshape.files import dumps
from preshape.hands.load import load_hand
from preshape.hiis import knowledge, learning
from preshape.hiis.analyser import Aim, Grip
from preshape.hiis.critic import Thresholds
from preshape.hiis.decision import Settings, Status
from preshape.hiis.planes import axis_name
from preshape.memory import Memory
from preshape.objects.library import load_library_object
from preshape.objects.mesh import TriangleMesh
from preshape.physics.grasps import STAGES, HandPoses
from preshape.physics.hand import physics_hand
from preshape.physics.hold.six_directions import hold_test
from preshape.physics.pieces import ConvexPieces
from preshape.physics.protocol import HoldProtocol
from preshape.physics.scene import build_scene
from preshape.planner import plan
from preshape.planning.controllers import closure_controller
from preshape.planning.document import plan_schema, plan_to_json
from preshape.planning.plan import Plan
from preshape.spatial import inverse, quaternion_from_rotation, rotation_from_quaternion
from preshape.tasks import parse_task
from preshape.types import Array

pytestmark = pytest.mark.usefixtures("session_cache")
QUICK = ClosureSettings(threads=1, everywhere=1000, elite=16, children=4, rounds=1, finished=6)
KNOWN = "shadow+closure"
VALIDATOR = jsonschema.Draft202012Validator(plan_schema())


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A memory that has been taught the cube."""
    path = tmp_path_factory.mktemp("memory") / "taught.sqlite"
    made(path, "cube")
    return path


@pytest.fixture
def memory(taught: Path, tmp_path: Path) -> Path:
    """A copy of it, to be changed."""
    return Path(shutil.copy(taught, tmp_path / "m.sqlite"))


def made(memory: Path, thing: str | TriangleMesh, task: str = "lift", **more: Any) -> Plan:
    given = {"hand": "shadow", "closure": QUICK, "table": None, **more}
    return plan(thing, task, analyser="closure", memory=memory, **given)


def strict(threshold: float) -> Settings:
    return Settings(thresholds=Thresholds(estimation=threshold))


def outcomes(p: Plan) -> str:
    return " ".join(f"{t.mode}:{t.outcome}" for t in p.decision.transitions)


def answers(p: Plan) -> list[Any]:
    return [one.grasp for one in (p.answer, *p.alternatives) if one is not None]


# -- the modes -----------------------------------------------------------------------------------------


def test_an_easy_task_is_answered_by_experience_a_harder_one_by_a_search_of_the_plane(memory: Path) -> None:
    modes = []
    for thing in ("cube", "box", "bowl", "ring"):
        p = made(memory, thing, learn=False)
        assert p.decision.status is Status.ANSWER, thing
        assert p.grasp is not None
        assert p.grasp.judged >= p.settings.thresholds.estimation
        modes.append(p.decision.mode)
        if p.decision.mode == 0 and thing != "cube":  # asked for a little more than that
            harder = made(memory, thing, learn=False, settings=strict(p.grasp.judged + 1e-6))
            assert harder.decision.mode > 0
            modes.append(harder.decision.mode)
            if harder.grasp is not None:
                assert harder.grasp.judged > p.grasp.judged
            if harder.decision.mode == 1 and harder.decision.estimate is not None:
                assert harder.grasp is not None
                assert harder.grasp.plane.index == harder.decision.estimate.plane
    assert 0 in modes
    assert max(modes) > 0


def test_what_modes_0_and_1_miss_mode_3_finds_or_the_controller_is_in_deadlock(memory: Path) -> None:
    hopeless = made(memory, "box", learn=False, settings=strict(6.0))
    assert hopeless.decision.status is Status.DEADLOCK
    assert outcomes(hopeless) == "0:penalty 1:penalty 2:unknown 3:explored 3:deadlock"
    assert hopeless.decision.best is not None
    best = hopeless.decision.best.judged
    assert 3.0 < best < 6.0
    found = made(memory, "box", learn=False, settings=strict(best - 1e-6))
    assert found.decision.status is Status.ANSWER
    assert found.decision.mode in (1, 3)
    assert found.grasp is not None
    assert found.grasp.judged >= best - 1e-6


def test_a_known_object_is_explored_before_a_task_is_refused(memory: Path, monkeypatch: Any) -> None:
    """A task is not refused because another one was taught before: a real hand searches all planes first."""
    from preshape.hiis.controller import Controller

    def nothing(controller: Any, pa: Any, q: Array, *_: Any) -> Any:
        found = pa.explore(q, Aim(planes=[5], values=[0.0]))
        return found.where(np.zeros(len(found), dtype=bool))

    monkeypatch.setattr(Controller, "_offers", lambda *_: ("an offer",))  # they take long
    monkeypatch.setattr(Controller, "at_estimate", nothing)
    monkeypatch.setattr(Controller, "on_plane", nothing)
    found = made(memory, "cube", "turn", learn=False)  # it was taught to be lifted
    assert found.decision.status is Status.ANSWER
    assert outcomes(found) == "0:penalty 1:penalty 2:known 3:explored 3:reward"
    monkeypatch.setattr(Controller, "_explore", lambda *_: None)
    p = made(memory, "cube", "turn")
    assert p.decision.status is Status.CORRECTION
    assert not p.decision.deadlock
    assert p.decision.offers == ("an offer",)
    assert outcomes(p) == "0:penalty 1:penalty 2:known 3:correction"
    assert p.decision.mode == 3


def test_a_deadlock_teaches_nothing_and_comes_again_unchanged(memory: Path) -> None:
    """A grip that is not good enough must not move the estimator, nor make its object known."""
    stored, said = [], []
    for k in range(3):
        p = made(memory, "box", settings=strict(6.0))
        assert p.decision.status is Status.DEADLOCK
        assert outcomes(p) == "0:penalty 1:penalty 2:unknown 3:explored 3:deadlock"
        assert p.best is not None
        said.append((p.decision.reason, p.best.grasp.palm_pose.tobytes()))  # type: ignore[union-attr]
        with Memory.open(memory) as store:
            weights = store.weights(KNOWN)
            assert weights is not None
            stored.append((len(store.experiences()), weights.w1.tobytes()))
        assert "0:penalty 1:penalty 2:unknown" in outcomes(p), k
    assert len(set(said)) == len(set(stored)) == 1


@pytest.mark.parametrize("lesson", [{"table": "auto"}, {"friction": 1.0}, {"mass": 0.05}])
def test_lessons_of_another_scene_stop_no_request(memory: Path, lesson: dict[str, Any]) -> None:
    fresh = made(memory, "mug", learn=False)
    assert fresh.grasp is not None
    made(memory, "mug", **lesson)
    p = made(memory, "mug")
    assert p.decision.status is Status.ANSWER, p.decision.reason
    assert p.grasp is not None
    if p.decision.mode == fresh.decision.mode == 3:
        assert p.grasp.judged >= fresh.grasp.judged - 1e-9


def test_no_hand_holds_what_is_far_too_heavy_and_absurd_sizes_are_refused(memory: Path) -> None:
    p = made(memory, "box", learn=False, closure=replace(QUICK, mass=300.0, persistence=0, wraps=200))
    assert p.decision.status in (Status.NO_GRASP, Status.DEADLOCK)
    assert p.answer is None
    VALIDATOR.validate(plan_to_json(p))
    for scale, words in ((40.0, "far beyond"), (0.002, "far below")):
        with pytest.raises(InputError, match=words):
            made(memory, "box", learn=False, scale=scale)


def test_to_learn_finds_what_to_plan_finds(memory: Path) -> None:
    """The search of all planes is thinner than that of one: teaching uses the better of the two."""
    hand, task = load_hand("shadow"), parse_task("lift")
    for name in ("mug", "bottle"):
        planned = made(memory, name, learn=False)
        with Memory.open(":memory:") as store:
            store.add(Memory.open(memory, read_only=True).experiences())
            controller = closure_controller(
                store, hand, settings=Settings(), closure=QUICK, gravity=task.gravity
            )
            taught = controller.teach(load_library_object(name), task)
        assert (taught.status is Status.ANSWER) >= (planned.decision.status is Status.ANSWER)


def test_learning_keeps_the_grip_and_the_next_run_answers_with_one_as_good(memory: Path) -> None:
    hand, mesh, task = load_hand("shadow"), load_library_object("box"), parse_task("lift")
    with Memory.open(memory) as store:
        controller = closure_controller(store, hand, settings=Settings(), closure=QUICK, gravity=task.gravity)
        first = controller.teach(mesh, task)
    assert [t.outcome for t in first.transitions] == ["explored", "learned", "reward"]
    assert first.grasp is not None
    demanding = strict(first.grasp.judged - 0.3)
    with Memory.open(memory, read_only=True) as store:
        learnt = [e for e in store.experiences(hand=KNOWN) if e.object_name == "box" and e.kind == "task"]
    assert len(learnt) == 1
    assert learnt[0].grip is not None
    assert len(learnt[0].grip) == 8 + len(hand.joints)
    assert learnt[0].quality == pytest.approx(first.grasp.judged, abs=0.5)
    again = made(memory, "box", settings=demanding, learn=False)
    assert again.decision.status is Status.ANSWER
    assert again.decision.mode < 3


# -- the answers ---------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_plan_on_one_thread_and_two(memory: Path) -> None:
    def pose(seed: int, threads: int) -> Array:
        p = made(memory, "box", learn=False, seed=seed, closure=replace(QUICK, threads=threads), count=3)
        return np.array([np.concatenate([g.palm_pose, g.squeeze]) for g in answers(p)])

    first = pose(0, 1)
    assert np.array_equal(first, pose(0, 2))
    assert not np.array_equal(first[0], pose(1, 1)[0])


def test_a_first_lesson_is_the_same_on_any_number_of_threads(taught: Path, monkeypatch: Any) -> None:
    """Other tests of the suite use one lesson for many memories (``conftest.first_lessons``)."""
    monkeypatch.setattr(knowledge, "seed_experiences", learning.seed_experiences)
    hand, gravity, quick = load_hand("shadow"), parse_task("lift").gravity, replace(QUICK, threads=2)
    with Memory.open(taught, read_only=True) as old, Memory.open(":memory:") as new:
        closure_controller(new, hand, settings=Settings(), closure=quick, gravity=gravity)
        before, again = ([e for e in store.experiences() if e.kind == "seed"] for store in (old, new))
    assert len(before) == len(again) > 40
    for a, b in zip(before, again, strict=True):
        assert (a.plane, a.flip, a.fingers) == (b.plane, b.flip, b.fingers)
        assert np.array_equal(a.task, b.task)
        assert np.array_equal(a.grip, b.grip)  # type: ignore[arg-type]


def test_answers_stand_apart(memory: Path) -> None:
    p = made(memory, "box", count=4, learn=False)
    assert len(p.alternatives) == 3
    poses = [g.palm_pose for g in answers(p)]
    for i, a in enumerate(poses):
        for b in poses[:i]:
            angle = 2 * np.arccos(min(1.0, abs(float(a[3:] @ b[3:]))))
            assert np.linalg.norm(a[:3] - b[:3]) / 0.02 + angle / 0.35 > 0.99
    judged = [g.judged for g in answers(p)[1:]]
    assert judged == sorted(judged, reverse=True)


def test_only_allowed_approaches_are_used(memory: Path) -> None:
    for allowed in ("-z", "+x,-x"):
        p = made(memory, "cylinder", approaches=allowed, count=3, learn=False)
        assert p.answer is not None
        for g in answers(p):
            assert axis_name(g.plane.approach_axis) in allowed.split(",")
            # The hand really moves that way, within 45°.
            assert g.approach @ g.plane.approach_axis > 0.7


def test_table_and_boxes_need_the_closure_analyser_and_make_sense(memory: Path) -> None:
    for wrong in ({"table": "wood"}, {"table": float("nan")}, {"avoid": [[0, 0, 0, 1, 1]]}):
        with pytest.raises(InputError):
            made(memory, "cube", learn=False, **wrong)
    with pytest.raises(InputError, match="lower corner"):
        made(memory, "cube", learn=False, avoid=[[1, 1, 1, 0, 0, 0]])
    with pytest.raises(InputError, match="closure"):
        plan("cube", "lift", analyser="rays", memory=memory, learn=False, table="auto", hand="utah_mit")
    for load in (ClosureSettings(mass=50.0), ClosureSettings(friction=0.01)):
        with pytest.raises(InputError, match="closure"):
            plan("cube", "lift", analyser="rays", memory=memory, learn=False, closure=load, hand="utah_mit")


def test_off_a_table_the_hand_stays_above_it(memory: Path) -> None:
    from preshape.hands.kinematics import hand_geometry

    mesh = load_library_object("cylinder")
    p = made(memory, mesh, table="auto", learn=False)
    assert p.decision.status is Status.ANSWER
    grip = p.grasp
    assert isinstance(grip, Grip)
    for q in (grip.pregrasp, grip.grasp):
        for shape in hand_geometry(p.hand, grip.palm_pose, q):
            assert shape.corners[:, 2].min() - shape.radius > mesh.vertices[:, 2].min() - 5e-4


# -- files ---------------------------------------------------------------------------------------------


def test_the_plan_as_json_holds_to_the_schema_and_says_what_the_grip_does(memory: Path) -> None:
    p = made(memory, "box", count=4, learn=False)
    document = plan_to_json(p)
    assert not [f"{e.json_path}: {e.message}" for e in VALIDATOR.iter_errors(document)]
    assert json.loads(dumps(document)) == document
    grip = p.grasp
    assert isinstance(grip, Grip)
    poses = document["hand"]
    assert poses["status"] == "reached"
    assert poses["joints"] == list(p.hand.joints)
    for stage in ("pregrasp", "grasp", "squeeze"):
        assert poses[stage]["palm_pose"] == grip.palm_pose.tolist()
        assert poses[stage]["q"] == getattr(grip, stage).tolist()
    assert [c["finger"] for c in document["contacts"]] == list(grip.fingers_touching)
    assert len(document["alternatives"]) == len(p.alternatives) == 3
    for other, one in zip(document["alternatives"], p.alternatives, strict=True):
        assert other["plane"] == one.grasp.plane.index


# -- physics -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("thing", ["box", "cylinder"])
def test_the_first_answer_is_held_in_all_six_directions(memory: Path, thing: str) -> None:
    p = made(memory, thing, learn=False)
    grip = p.grasp
    assert isinstance(grip, Grip)
    mesh = load_library_object(thing)
    # Both are convex: one piece.
    pieces = ConvexPieces(name=thing, pieces=(np.asarray(mesh.vertices),))
    hand, protocol = physics_hand(p.hand), HoldProtocol()
    scene = build_scene(hand, pieces, 1.0, protocol)
    assert scene.joints == p.hand.joints
    root = root_pose(grip.palm_pose, p.hand.T_root_palm)
    stages = {stage: np.concatenate([root, getattr(grip, stage)]) for stage in STAGES}
    poses = HandPoses(object_pose=np.array([0.0, 0, 0, 1, 0, 0, 0]), **stages)
    result = hold_test(scene, poses, protocol)
    assert result.held, result.reason


def root_pose(palm_pose: Array, T_root_palm: Array) -> Array:
    """(7,) where the hand's root stands when its palm stands there."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_quaternion(palm_pose[3:]), palm_pose[:3]
    T = T @ inverse(T_root_palm)
    return np.concatenate([T[:3, 3], quaternion_from_rotation(T[:3, :3])])
