"""How hard a grip presses: in proportion to the load, as far as joints allow, and firmly as a last resort."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from preshape.analyser import Aim, Grip
from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.grip import ENOUGH, FIRM
from preshape.closure.settings import ClosureSettings
from preshape.hands.hand import Hand
from preshape.hands.model import load_hand
from preshape.objects.library import load_library_object
from preshape.planner import layout_of
from preshape.tasks import parse_task

pytestmark = pytest.mark.usefixtures("session_cache")
EVERYWHERE = Aim(values=np.linspace(-0.9, 0.9, 19))
SMALL = {"everywhere": 800, "elite": 16, "children": 4, "rounds": 1, "finished": 6, "threads": 1}
TASK = parse_task("lift")


def grips(hand: Hand, aim: Aim = EVERYWHERE, **settings: Any) -> list[Grip]:
    made = ClosureSettings(**{**SMALL, **settings})
    mesh = load_library_object("box")
    analyser = ClosureAnalyser(mesh, hand, layout_of(hand), settings=made, gravity=TASK.gravity)
    found = analyser.explore(TASK.q, aim)
    return [analyser.grasp(TASK.q, found, k).grip for k in range(len(found))]


def press(grip: Grip) -> float:
    """What the servos are told, in newtons of normal force, from the forces that they make."""
    return float(np.linalg.norm(grip.forces, axis=1).sum())


def strength(grip: Grip, mass: float) -> tuple[float, float]:
    """Loads that a newton of press balances [N]."""
    weight = 9.81 * mass
    return grip.task_margin * weight / press(grip), grip.hold_margin * weight / press(grip)


@pytest.fixture(scope="module")
def strong() -> Hand:
    """A hand whose joints are never too weak."""
    hand = load_hand("shadow")
    return replace(hand, torque_limits=1e3 * hand.torque_limits)


def test_a_heavier_object_is_pressed_in_proportion(strong: Hand) -> None:
    """Forces, weight and loads times five are the same problem: the same hands, a newton worth the same."""
    light, heavy = (grips(strong, mass=mass, persistence=0) for mass in (0.1, 0.5))
    assert len(light) == len(heavy) == SMALL["finished"]
    by_palm = {one.palm_pose.tobytes(): one for one in heavy}
    same = [(one, by_palm[one.palm_pose.tobytes()]) for one in light if one.palm_pose.tobytes() in by_palm]
    assert len(same) == len(light)
    for one, other in same:
        np.testing.assert_allclose(strength(one, 0.1), strength(other, 0.5), rtol=1e-6)
        assert press(other) <= 5.0 * press(one) * (1 + 1e-9)  # the least press is the same for both
    assert max(map(press, heavy)) > 20.0


def test_weak_joints_make_the_press_and_what_it_is_worth_smaller() -> None:
    hand = load_hand("shadow")
    weak = replace(hand, torque_limits=0.2 * hand.torque_limits)
    made = grips(weak, mass=0.5)
    assert made
    for one in made:
        assert (np.abs(one.torques) <= weak.torque_limits * (1 + 1e-9)).all()
        assert one.quality < ENOUGH
        margin = min(one.task_margin, one.hold_margin)
        assert one.quality == pytest.approx(6 * (1 - 2**-margin), rel=1e-6)


def test_what_the_usual_press_cannot_hold_a_firm_one_does_just(strong: Hand) -> None:
    made = grips(strong, press_least=0.5, press_most=3.0, persistence=0)
    firm = [one for one in made if press(one) > 3.0 * (1.0 + 0.21)]  # friction adds to the normal forces
    assert firm
    for one in firm:
        assert one.quality == ENOUGH
        assert min(one.task_margin, one.hold_margin) == pytest.approx(1.0, rel=1e-9)
        assert press(one) <= FIRM * 3.0 * np.hypot(1.0, 0.21)
    # Best first, and of those that are just enough the one that presses least.
    assert [one.quality for one in made] == sorted((one.quality for one in made), reverse=True)
    normal = [min(strength(one, 0.1)) for one in firm]
    assert normal == sorted(normal, reverse=True)


def test_a_firm_press_is_no_answer_where_a_better_grip_may_be_found_elsewhere(strong: Hand) -> None:
    aims = [Aim(planes=[plane], values=EVERYWHERE.values) for plane in range(1, 13)]
    made = [one for aim in aims for one in grips(strong, aim, press_least=0.5, press_most=3.0)]
    short = [one for one in made if min(one.task_margin, one.hold_margin) < 1.0]
    assert short
    for one in made:
        assert press(one) <= 3.0 * np.hypot(1.0, 0.21)
    for one in short:
        assert one.quality < ENOUGH
