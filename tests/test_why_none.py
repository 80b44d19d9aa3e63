"""Why there is no grip: the reason names what stood in the way."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.grips import GripExploration
from preshape.closure.settings import FRICTION_SHARE, ClosureSettings, table_below
from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim, HandLayout
from preshape.hiis.decision import Status
from preshape.kernels.closing.host import Obstacles
from preshape.objects.load import load_object
from preshape.planner import plan
from preshape.planning.document import plan_to_json
from preshape.tasks import parse_task

QUICK = {"everywhere": 300, "persistence": 0, "rounds": 1, "elite": 8, "bold_share": FRICTION_SHARE}


def none_of(
    name: str, *, scale: float = 1.0, hand_name: str = "shadow", **closure: object
) -> GripExploration:
    hand, task = load_hand(hand_name), parse_task("lift")
    analyser = ClosureAnalyser(
        load_object(name, scale=scale),
        hand,
        HandLayout(name=hand_name, u=0.045, finger_pitch=0.022, fingertip_width=0.016),
        settings=ClosureSettings(**{**QUICK, **closure}),  # type: ignore[arg-type]
    )
    found = analyser.explore(task.q, Aim(planes=range(1, 13), values=np.linspace(-0.8, 0.8, 9)))
    assert not len(found)
    return found


def why(name: str, **closure: object) -> str:
    return none_of(name, **closure).reason  # type: ignore[arg-type]


def test_the_table() -> None:
    found = none_of("domino", obstacles=table_below(-0.005))
    assert re.search(r"(all|\d+) of these in collision with the table; ", found.reason)
    assert "most are refused because of the table" in found.reason
    assert "box" not in found.reason
    assert found.miss is not None
    assert found.miss.refused == "the table is in the closed hand's way"
    assert found.miss.quality > 3  # without the table the hand would hold it


def test_the_costliest_of_several_boxes() -> None:
    """Of three boxes, the first is far away, the second is beside the object and the third is around it."""
    boxes = [[[9.0, 9, 9], [10, 10, 10]], [[0.1, -1, -1], [1, 1, 1]], [[0.03, -0.5, 0.012], [0.5, 0.5, 0.5]]]
    around = Obstacles(
        planes=table_below(-0.012).planes, boxes=np.array([*boxes, [[-1, -1, -1], [1, 1, 0.0]]])
    )
    found = none_of("domino", obstacles=around)
    assert "because of box 4: moving it or making it smaller (--avoid) would help" in found.reason
    assert "box 1" not in found.reason
    assert found.miss is not None
    assert found.miss.refused == "box 4 is in the closed hand's way"


def test_the_way_in() -> None:
    """Walls leave room for the closed hand, and none for the approach."""
    walls = [[[-1, -1, 0.16], [1, 1, 1]], [[0.16, -1, -1], [1, 1, 1]], [[-1, 0.16, -1], [1, 1, 1]]]
    walls += [[(-np.array(high)).tolist(), (-np.array(low)).tolist()] for low, high in walls]
    found = none_of(
        "sphere", hand_name="allegro", friction=1.5, obstacles=Obstacles(boxes=np.array(walls, dtype=float))
    )
    assert "has no free way in; most are refused because of the way in: more room around" in found.reason
    assert found.miss is not None
    assert found.miss.refused == "a box to avoid or the object is in the open hand's way"
    assert "table" not in found.reason.replace("--table", "")


def test_the_load() -> None:
    # Without friction fingers that go round a sphere hold it all the same.
    found = none_of("sphere", friction=0.001, wraps=0)
    assert found.reason.endswith("the load with the planned share of the friction (0.35 of 0.001 = 0.00035)")
    assert "table" not in found.reason
    assert found.miss is not None
    assert not found.miss.refused  # the hand can execute it, but it does not hold


def test_some_in_the_table_and_the_rest_too_weak() -> None:
    said = why("sphere", friction=0.001, obstacles=table_below(0.0))
    assert "of these in collision with the table; none of the others balances the load" in said


def test_no_hand_closes_on_it() -> None:
    assert "none of them closed on the object with the thumb and a finger" in why("sphere", scale=8.0)


def test_what_the_usual_share_of_the_friction_leaves_on_the_table(lesson: Callable[[str], Path]) -> None:
    made = plan("domino", "lift", hand="shadow", memory=lesson("shadow"), learn=False, table="auto")
    told = plan_to_json(made)
    assert made.decision.status is Status.ANSWER
    assert (told["grip"]["quality"], told["grip"]["friction_share"]) == (3.0, ClosureSettings().bold_share)
    assert told["heaviest_mass"] >= made.mass.kg
    assert any("0.35 of the friction; this one is with 0.7" in warning for warning in told["warnings"])


def test_the_answer_says_it(lesson: Callable[[str], Path]) -> None:
    careful = ClosureSettings(bold_share=FRICTION_SHARE)
    made = plan(
        "domino", "lift", hand="shadow", memory=lesson("shadow"), learn=False, table="auto", closure=careful
    )
    last = made.decision.transitions[-1]
    assert (made.decision.status, last.outcome) == (Status.NO_GRASP, "no grasp")
    assert "but the table is in the closed hand's way" in last.reason
    assert made.best is not None
    assert not made.best.hand_result.reached
    assert made.best.heaviest is not None
    best = plan_to_json(made)["best"]
    assert (best["executable"], best["hand"]["status"]) == (False, "blocked")
    assert best["hand"]["reason"] == "the table is in the closed hand's way"
    shown = " ".join(str(made).split())
    assert "refused the table is in the closed hand's way" in shown
    assert "clearance" not in shown
