"""Why there is no grip: the reason names what stood in the way."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.settings import ClosureSettings, table_below
from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim, HandLayout
from preshape.hiis.decision import Status
from preshape.objects.load import load_object
from preshape.planner import plan
from preshape.tasks import parse_task

QUICK = {"everywhere": 300, "persistence": 0, "rounds": 1, "elite": 8}


def why(name: str, *, scale: float = 1.0, **closure: object) -> str:
    hand, task = load_hand("shadow"), parse_task("lift")
    analyser = ClosureAnalyser(
        load_object(name, scale=scale),
        hand,
        HandLayout(name="shadow", u=0.045, finger_pitch=0.022, fingertip_width=0.016),
        settings=ClosureSettings(**{**QUICK, **closure}),  # type: ignore[arg-type]
    )
    found = analyser.explore(task.q, Aim(planes=range(1, 13), values=np.linspace(-0.8, 0.8, 9)))
    assert not len(found)
    return found.reason


def test_the_table() -> None:
    said = why("domino", obstacles=table_below(-0.005))
    assert "all of these in collision with the table or a box to avoid" in said


def test_the_load() -> None:
    said = why("sphere", friction=0.001)
    assert "none balances the load with the planned share of the friction (0.35 of 0.001 = 0.00035)" in said
    assert "table" not in said


def test_some_in_the_table_and_the_rest_too_weak() -> None:
    said = why("sphere", friction=0.001, obstacles=table_below(0.0))
    assert (
        "of these in collision with the table or a box to avoid; none of the others balances the load" in said
    )


def test_no_hand_closes_on_it() -> None:
    assert "none of them closed on the object with the thumb and a finger" in why("sphere", scale=8.0)


def test_the_answer_says_it(lesson: Callable[[str], Path]) -> None:
    made = plan("domino", "lift", hand="shadow", memory=lesson("shadow"), learn=False, table="auto")
    last = made.decision.transitions[-1]
    assert (made.decision.status, last.outcome) == (Status.NO_GRASP, "no grasp")
    assert "in collision with the table" in last.reason
