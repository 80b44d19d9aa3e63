"""``--verify``: physics chooses among the answers, and what it said is remembered."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from preshape.closure.settings import ClosureSettings
from preshape.memory import Memory
from preshape.physics.hold.six_directions import HoldResult, HoldStatus
from preshape.physics.pick import picking
from preshape.physics.pick.protocol import Done, PickResult, PickStatus
from preshape.physics.pieces import ConvexPieces
from preshape.physics.protocol import HoldProtocol
from preshape.planner import plan
from preshape.planning import verify as verifying
from preshape.planning.document import plan_to_json
from preshape.planning.plan import Plan

QUICK = ClosureSettings(everywhere=800, elite=12, rounds=2, finished=4, persistence=1)


@pytest.fixture(autouse=True)
def one_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    """A box is convex: nothing is to be cut."""
    monkeypatch.setattr(
        verifying, "decompose", lambda mesh: ConvexPieces(name=mesh.name, pieces=(mesh.vertices,))
    )


@pytest.fixture
def fresh(lesson: Callable[[str], Path], tmp_path: Path) -> Callable[[], AbstractContextManager[Memory]]:
    """Opens a memory that knows the hand's first lesson only, another one each time."""
    count = iter(range(9))

    @contextmanager
    def opened() -> Iterator[Memory]:
        with Memory.open(shutil.copy(lesson("allegro"), tmp_path / f"{next(count)}.sqlite")) as memory:
            yield memory

    return opened


def planned(memory: Memory, **how: Any) -> Plan:
    given = {"closure": QUICK, "table": None, **how}
    return plan("box", "lift", hand="allegro", memory=memory, verify=True, **given)


def outcomes(memory: Memory) -> list[str]:
    return [e.outcome for e in memory.experiences(hand="allegro+closure") if e.outcome]


def told(monkeypatch: pytest.MonkeyPatch, *answers: bool | None) -> None:
    """Physics that says what it is told."""
    said = iter(answers)

    def hold_test(*args: Any, **kwargs: Any) -> HoldResult:
        status = {True: HoldStatus.HELD, False: HoldStatus.LOST, None: HoldStatus.UNSTABLE}[next(said)]
        return HoldResult(row=0, object_name="box", scale=1.0, status=status, reason=str(status.value))

    monkeypatch.setattr(verifying, "hold_test", hold_test)


def test_real_physics_holds_the_box_and_that_is_remembered(fresh) -> None:
    with fresh() as memory:
        made = planned(memory)
        assert made.verified is not None
        assert made.verified.held
        assert outcomes(memory) == ["lost"] * (made.verified.tried - 1) + ["held"]


def test_the_first_that_holds_is_the_answer(fresh, monkeypatch: pytest.MonkeyPatch) -> None:
    with fresh() as memory:
        told(monkeypatch, True)
        first = planned(memory, count=3, learn=False)
        assert outcomes(memory) == [], "learn=False learns nothing"
    with fresh() as memory:
        told(monkeypatch, False, True)
        second = planned(memory, count=3)
        assert first.answer is not None
        assert second.answer is not None
        assert second.verified is not None
        assert (second.verified.held, second.verified.tried) == (True, 2)
        assert second.answer.grasp is not first.answer.grasp
        last = second.decision.transitions[-1]
        assert last.reason == second.decision.reason
        assert last.reason.startswith(second.answer.grasp.score_text)
        assert len(second.decision.transitions) == len(first.decision.transitions) + 1
        assert outcomes(memory) == ["lost", "held"]


def test_none_holds(fresh, monkeypatch: pytest.MonkeyPatch) -> None:
    with fresh() as memory:
        told(monkeypatch, *[False] * 20)
        made = planned(memory)
        assert made.verified is not None
        assert not made.verified.held
        assert outcomes(memory) == ["lost"] * made.verified.tried


def test_without_an_answer_it_is_said_that_nothing_was_tested(fresh) -> None:
    with fresh() as memory:
        made = planned(memory, mass=40.0, learn=False)
    assert made.answer is None
    assert made.verified is not None
    assert (made.verified.held, made.verified.tried) == (False, 0)
    assert plan_to_json(made)["verified"]["reason"] == "there is no answer to test"
    assert "there is no answer to test" in str(made)


def test_a_simulation_that_broke_says_nothing_of_the_grip(fresh, monkeypatch: pytest.MonkeyPatch) -> None:
    with fresh() as memory:
        told(monkeypatch, None, False, *[None] * 20)
        planned(memory)
        assert outcomes(memory) == ["lost"]


def test_an_outcome_counts_for_its_own_scene(fresh, monkeypatch: pytest.MonkeyPatch) -> None:
    with fresh() as memory:
        told(monkeypatch, *[True] * 3)
        planned(memory, approaches="-z")  # a restriction, which says nothing about the object
        assert outcomes(memory) == []
        planned(memory, avoid=[[0.3, 0.3, 0.3, 0.4, 0.4, 0.4]])
        assert outcomes(memory) == ["held"]
        (lesson,) = (e for e in memory.experiences() if e.outcome)
        assert lesson.scene.startswith("box ")


@pytest.mark.parametrize(
    ("load", "held", "learnt"),
    [
        ({"mass": 0.15}, True, ["held"]),
        ({"friction": 0.4}, True, ["held"]),
        ({"mass": 0.05}, True, []),
        ({"friction": 1.0, "mass": 0.15}, True, []),
        ({"mass": 0.05}, False, ["lost"]),
        ({"mass": 0.15}, False, []),
        ({"friction": 0.4}, False, []),
    ],
)
def test_it_is_tested_with_the_load_that_was_planned_for(
    fresh, monkeypatch: pytest.MonkeyPatch, load: dict[str, float], held: bool, learnt: list[str]
) -> None:
    """And a grip that held something easier than usual, or lost something harder, is not thereby known."""
    used: list[HoldProtocol] = []

    def hold_test(scene: object, *args: Any, **kwargs: Any) -> HoldResult:
        used.append(args[-1])
        status = HoldStatus.HELD if held else HoldStatus.LOST
        return HoldResult(row=0, object_name="box", scale=1.0, status=status, reason=str(status.value))

    monkeypatch.setattr(verifying, "hold_test", hold_test)
    with fresh() as memory:
        planned(memory, closure=replace(QUICK, **load))
        assert {(one.mass, one.friction) for one in used} == {
            (load.get("mass", 0.1), load.get("friction", 0.6))
        }
        assert {*outcomes(memory)} == {*learnt}


def test_on_a_table_the_hand_must_pick_it_up_and_do_the_task(fresh, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verifying, "hold_test", None)  # the free push is no question here
    with fresh() as memory:
        made = planned(memory, table="auto")
        assert made.verified is not None
        if made.verified.held:
            assert "then it moved the object along the task's motion" in made.verified.reason
        assert outcomes(memory) == ["lost"] * (made.verified.tried - made.verified.held) + (
            ["held"] * made.verified.held
        )


def test_picked_but_not_done_is_not_verified(fresh, monkeypatch: pytest.MonkeyPatch) -> None:
    ends = iter([(PickStatus.UNSTABLE, None), (PickStatus.PICKED, False), (PickStatus.PICKED, True)])

    def pick_test(*args: Any, **kwargs: Any) -> PickResult:
        status, done = next(ends)
        job = None if done is None else Done(done=done, reason="moved")
        return PickResult(
            row=0, object_name="box", scale=1.0, mass=0.1, status=status, reason=f"{status.value}", job=job
        )

    monkeypatch.setattr(picking, "pick_test", pick_test)
    with fresh() as memory:
        made = planned(memory, table="auto", count=3)
        assert made.verified is not None
        assert (made.verified.held, made.verified.tried) == (True, 3)
        assert made.decision.reason.endswith("the first answer that did the job in physics")
        assert outcomes(memory) == ["lost", "held"]  # the unstable one says nothing
