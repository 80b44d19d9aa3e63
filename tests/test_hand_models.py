"""Lessons belong to a hand as it is: under another model of the hand, their grips are starts and no more."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from coupled_hands import coupled_hand
from preshape.cli.memory import show
from preshape.closure import analyser as closing
from preshape.closure.recall import FEW_VALUES, on_object, recalled
from preshape.closure.settings import ClosureSettings
from preshape.closure.wrapping import WRAP
from preshape.hands import load_hand
from preshape.hands.hand import Hand
from preshape.hands.motors import RIGID
from preshape.hiis import learning
from preshape.hiis.analyser import Aim, Grip
from preshape.hiis.controller import Controller
from preshape.hiis.critic import Thresholds
from preshape.hiis.decision import Settings, Status
from preshape.hiis.estimator import encode
from preshape.hiis.fuzzy import FuzzySets
from preshape.hiis.knowledge import OTHER_MODEL
from preshape.hiis.learning import training_set
from preshape.memory import Memory
from preshape.objects.library import load_library_object
from preshape.planning.controllers import closure_analyser, closure_controller, layout_of
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session
from preshape.tasks import parse_task
from preshape.types import Array, Experience

EXAMPLE = Path(__file__).parents[1] / "examples" / "hands"
LIFT, TWIST = parse_task("lift"), parse_task("twist")
QUICK = ClosureSettings(threads=1, everywhere=600, elite=8, children=4, rounds=1, finished=4, persistence=0)
NAME = "trident+closure"


# --- the hash -------------------------------------------------------------------------------------


def changed_finger(hand: Hand, **changes: Any) -> Hand:
    return replace(hand, fingers=(*hand.fingers[:-1], replace(hand.fingers[-1], **changes)))


def changed_motor(hand: Hand, **changes: Any) -> Hand:
    return replace(hand, motors=(replace(hand.motors[0], **changes), *hand.motors[1:]))


SAME: dict[str, Callable[[Hand], Hand]] = {
    "texts": lambda h: replace(h, name="other", title="t", description="d", licence="l", credit="c"),
    "folder": lambda h: replace(h, source="/elsewhere/hand.toml"),
    "drives": lambda h: replace(h, gains=2 * h.gains, torque_limits=h.torque_limits / 2, torque_limit=9.0),
    "actuators": lambda h: replace(h, mjcf=h.mjcf.replace('kp="5"', 'kp="7"')),
    "comments, colours and masses": lambda h: replace(
        h, mjcf=h.mjcf.replace("<worldbody>", "<!-- new --><worldbody>").replace('mass="0.', 'mass="1.')
    ),
    "rounding": lambda h: replace(h, limits=h.limits + 1e-14),
}
OTHER: dict[str, Callable[[Hand], Hand]] = {
    "shape": lambda h: replace(h, mjcf=h.mjcf.replace('size="0.0148"', 'size="0.0158"')),
    "kinematics": lambda h: replace(h, mjcf=h.mjcf.replace('axis="', 'axis="0.1 ', 1)),
    "excluded pairs": lambda h: replace(h, mjcf=h.mjcf.replace("<contact>", '<contact><exclude body1="a"/>')),
    "palm": lambda h: replace(h, T_root_palm=h.T_root_palm + 1e-3),
    "limits": lambda h: replace(h, limits=h.limits + 1e-3),
    "U": lambda h: replace(h, u=1.01 * h.u),
    "closing path": lambda h: changed_finger(h, closing=h.fingers[-1].closing * 0.9),
    "preshape": lambda h: changed_finger(h, preshape=h.fingers[-1].preshape * 0.9),
    "law": lambda h: changed_motor(h, law=RIGID),
    "polynomial": lambda h: changed_motor(h, polynomials=0.9 * h.motors[0].polynomials),
    "range": lambda h: changed_motor(h, range=0.9 * h.motors[0].range),
}


@pytest.mark.parametrize("change", SAME.values(), ids=list(SAME))
def test_the_hash_does_not_change_with_what_grips_do_not_depend_on(change: Callable[[Hand], Hand]) -> None:
    hand = load_hand("shadow")
    assert change(hand).model_hash() == hand.model_hash()


@pytest.mark.parametrize("change", OTHER.values(), ids=list(OTHER))
def test_the_hash_changes_with_what_grips_depend_on(change: Callable[[Hand], Hand]) -> None:
    hand = load_hand("shadow")
    assert change(hand).model_hash() != hand.model_hash()


# --- a hand whose file is changed -----------------------------------------------------------------


def hand_file(folder: Path, name: str = "trident", **changes: str) -> Path:
    """A copy of the example hand under another name of file, with values of its description replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(EXAMPLE / "trident.urdf", folder / f"{name}.urdf")
    lines = (EXAMPLE / "trident.toml").read_text().splitlines()
    for key, content in {"model": f'"{name}.urdf"', **changes}.items():
        lines = [f"{key} = {content}" if line.startswith(f"{key} =") else line for line in lines]
    file = folder / f"{name}.toml"
    file.write_text("\n".join(lines))
    return file


THICKER = {"tip_radius": "0.0105"}
"""Other fingertips, and so another model of the hand."""


def asked(hand: Path, thing: str = "box", threshold: float = 3.0, **more: Any) -> PlanRequest:
    settings = Settings(thresholds=Thresholds(estimation=threshold))
    given = {"task": LIFT, "hand": str(hand), "analyser": "closure", "search": QUICK, "table": None, **more}
    return PlanRequest(source=thing, settings=settings, **given)


@pytest.fixture(scope="module")
def few_seeds() -> Iterator[None]:
    """A first lesson of three tasks instead of 48."""
    tasks = learning.seed_tasks()[::16]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learning, "seed_tasks", lambda: tasks)
        yield


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory, session_cache: None, few_seeds: None) -> Path:
    """A memory in which the example hand has been taught the box."""
    path = tmp_path_factory.mktemp("taught") / "m.sqlite"
    with Session(path) as session:
        session.teach(asked(hand_file(path.parent)))
    return path


@pytest.fixture
def memory(taught: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(taught, tmp_path / "m.sqlite"))


@pytest.fixture
def recalls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[bool, int, int]]:
    """For each search: if it is at the estimate, and how many lessons of its own and of others it may use."""
    calls: list[tuple[bool, int, int]] = []

    def spied(known: Sequence[Experience], mesh: Any, q: Array, aim: Aim, **more: Any) -> Any:
        others = sum(e.scene.endswith(OTHER_MODEL) for e in known)
        calls.append((len(aim.values) <= FEW_VALUES and len(aim.planes) == 1, len(known) - others, others))
        return recalled(known, mesh, q, aim, **more)

    monkeypatch.setattr(closing, "recalled", spied)
    return calls


def test_the_same_hand_in_another_file_knows_what_it_learnt(memory: Path, tmp_path: Path) -> None:
    with Session(memory) as session:
        lessons = session.memory.count()
        answer = session.run(asked(hand_file(tmp_path / "elsewhere", "renamed")))
        assert (answer.decision.status, answer.decision.mode, answer.known) == (Status.ANSWER, 0, True)
        assert session.memory.count() == lessons
        assert session.memory.statistics().models == ((NAME, 1),)
        other = load_hand(hand_file(tmp_path / "drives", gain="7.5", torque_limit="0.5", title='"Another"'))
        controller = closure_controller(
            session.memory, other, settings=Settings(), closure=QUICK, gravity=LIFT.gravity
        )
        assert len(controller.knowledge.own) == len(controller.experiences) == lessons


def test_under_another_model_a_lesson_is_a_start_of_the_search_only(
    memory: Path, tmp_path: Path, recalls: list[tuple[bool, int, int]]
) -> None:
    file = hand_file(tmp_path)
    with Session(memory) as session:
        ready = session.prepare(asked(file))
        taught = [e for e in ready.controller.experiences if e.object_name == "box" and e.grip is not None]
        assert ready.known
        assert taught
        assert ready.controller._mode_2(ready.element).verdict.reward
        hand_file(tmp_path, **THICKER)  # the same file, written again
        ready = session.prepare(asked(file))
        controller, everywhere = ready.controller, np.ones(12, dtype=bool)
        assert not ready.known
        assert controller._best_stored(ready.element, LIFT, everywhere) is None
        assert not controller._taught(ready.element, LIFT, everywhere)
        recognition = controller._mode_2(ready.element)
        assert not recognition.verdict.reward
        assert "model of the hand" in recognition.verdict.reason
        # The wider searches start from the stored grips too, and find no less for them.
        recalls.clear()
        estimate, *_ = controller._mode_0(ready.element, LIFT.q, everywhere)
        controller._mode_1(ready.element, LIFT.q, estimate)
        aim = learning.everywhere(controller.settings.sets)
        found = ready.element.explore(LIFT.q, aim)
        at_estimate, *wider = recalls
        assert at_estimate == (True, len(controller.knowledge.own), 0)
        assert [others for _, _, others in wider] == [3 + len(taught)] * 2
        alone = closure_analyser(ready.request, ready.hand, ready.mesh).explore(LIFT.q, aim)
        assert found.tried > alone.tried
        assert found.match.max() >= alone.match.max() - 1e-12


def test_each_model_learns_for_itself_and_none_forgets(memory: Path, tmp_path: Path) -> None:
    file = hand_file(tmp_path)
    with Session(memory) as session:
        first = session.run(asked(file)).grasp
        hand_file(tmp_path, **THICKER)
        new = session.run(asked(file))
        assert new.decision.status is Status.ANSWER
        assert not new.known
        models = {e.model for e in session.memory.experiences(NAME)}
        assert models == {load_hand(file).model_hash(), load_hand(EXAMPLE / "trident.toml").model_hash()}
        assert session.memory.statistics().models == ((NAME, 2),)
        own = [e for e in session.memory.experiences(NAME) if e.model == load_hand(file).model_hash()]
        assert [e.kind for e in own][:3] == ["seed"] * 3  # its own first lesson
        again = session.run(asked(file))
        assert (again.decision.mode, again.known) == (0, True)
        hand_file(tmp_path)  # and back
        back = session.run(asked(file))
        assert (back.decision.mode, back.known) == (0, True)
        for one, other in ((again.grasp, new.grasp), (back.grasp, first)):
            assert isinstance(one, Grip)
            assert isinstance(other, Grip)
            np.testing.assert_allclose(one.palm_pose, other.palm_pose, atol=1e-12)
    shown = CliRunner().invoke(show, ["--memory", str(memory)]).output
    assert f"{NAME}: the lessons are of 2 models of this hand" in shown


def test_lessons_of_a_memory_from_before_models_are_starts_only(memory: Path, tmp_path: Path) -> None:
    connection = sqlite3.connect(memory, isolation_level=None)
    connection.execute("ALTER TABLE experiences DROP COLUMN model")
    connection.execute("PRAGMA user_version = 5")
    connection.close()
    with Session(memory) as session:
        ready = session.prepare(asked(hand_file(tmp_path)))
        assert not ready.known
        others = [e for e in ready.controller.experiences if e.scene.endswith(OTHER_MODEL)]
        assert {e.object_name for e in others} == {"cube", "box"}
        assert session.run(asked(hand_file(tmp_path))).decision.status is Status.ANSWER
    assert memory.with_name("m.sqlite.v5-backup").exists()


# --- one lesson -----------------------------------------------------------------------------------


@pytest.fixture
def lesson(taught: Path) -> Experience:
    """The lesson of the box."""
    with Memory.open(taught, read_only=True) as memory:
        return next(e for e in memory.experiences(NAME, ["task"]) if e.object_name == "box")


def test_what_one_model_lost_another_one_tries(lesson: Experience) -> None:
    hand, mesh = load_hand(EXAMPLE / "trident.toml"), load_library_object("box")
    aim = Aim(planes=[lesson.plane], values=[lesson.approach_value], recall=range(1, 13))
    lost = replace(lesson, outcome="lost")
    for known, found in (
        ([lesson, lost], 0),
        ([replace(lost, model="b" * 16), lesson], 1),
        ([lesson, replace(lost, model="b" * 16)], 1),
    ):
        drawn = recalled(known, mesh, LIFT.q, aim, hand=hand, sets=FuzzySets())
        assert (0 if drawn is None else len(drawn.drawn)) == found


def test_a_start_of_another_model_is_brought_onto_the_laws_and_limits(lesson: Experience) -> None:
    assert lesson.grip is not None
    hand, mesh = coupled_hand("bent"), load_library_object("box")
    wild = lesson.grip.copy()
    wild[7], wild[8:] = WRAP | 0b11111, [9.0, -9.0, 9.0, 0.2, 0.3, 1.0, 0.1, 9.0, -9.0]
    (drawn,) = [on_object([replace(lesson, grip=wild)], mesh, hand).candidates]
    np.testing.assert_allclose(drawn.start, hand.lawful(drawn.start), atol=1e-9)
    assert ((drawn.start >= hand.limits[:, 0] - 1e-9) & (drawn.start <= hand.limits[:, 1] + 1e-9)).all()
    assert drawn.mask.tolist() == [WRAP | 0b111]
    own = on_object([lesson], mesh, load_hand(EXAMPLE / "trident.toml")).candidates
    assert own.start.tobytes() == lesson.grip[8:].tobytes()  # not a rounding error is added to one's own


def test_the_estimator_learns_from_another_model_only_what_its_own_lessons_leave_open(
    lesson: Experience,
) -> None:
    """Whatever was stored later: the order of the lessons says what counts."""
    layout = replace(layout_of(load_hand(EXAMPLE / "trident.toml")), name=NAME, model="a" * 16)
    own = replace(lesson, model=layout.model, plane=2, scene="table 0", created="")
    other = replace(lesson, model="b" * 16, plane=11, scene="", created="")
    elsewhere = replace(other, task=TWIST.q)
    with Memory.open(":memory:") as memory:
        memory.add([own, other, elsewhere])
        controller = Controller(memory, layout, kind="shape")
        assert [layout.owns(e) for e in controller.experiences] == [False, False, True]
        _, bits = training_set(controller.experiences, layout.u, kind="shape")
        wanted = [encode(e.plane, e.approach_set, e.fingers) for e in (own, elsewhere)]
        assert sorted(bits.tolist()) == sorted(np.array(wanted).tolist())
