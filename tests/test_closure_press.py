"""How hard a grip presses: in proportion to the load, as far as joints allow, and firmly as a last resort."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.candidates import RankedCandidates, distinct
from preshape.closure.finish import ENOUGH, FIRM, FinishOptions
from preshape.closure.settings import FRICTION_SHARE, ClosureSettings
from preshape.hands.hand import Hand
from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim, Grip
from preshape.hiis.fuzzy import FuzzySets
from preshape.hiis.learning import experiences_of, explore
from preshape.metrics import Contacts, ForceLimits, task_margin
from preshape.objects.library import load_library_object
from preshape.planning.controllers import layout_of
from preshape.tasks import parse_task
from preshape.types import Experience

pytestmark = pytest.mark.usefixtures("session_cache")
EVERYWHERE = Aim(values=np.linspace(-0.9, 0.9, 19))
SMALL = {
    "wraps": 0,
    "everywhere": 800,
    "elite": 16,
    "children": 4,
    "rounds": 1,
    "finished": 6,
    "threads": 1,
    "bold_share": FRICTION_SHARE,
}
TASK = parse_task("lift")
MOST = 20.0
"""Strongest usual press on 0.1 kg [N]."""
RIGHT = 1.0 + 1e-7  # contacts are of single precision
SLIPPERY, SMOOTH = 0.04, 0.16
"""Friction with which no usual press is enough, and with which it is for some grips."""


def element(hand: Hand, known: Sequence[Experience] = (), **settings: Any) -> ClosureAnalyser:
    made = ClosureSettings(**{**SMALL, **settings})
    box = load_library_object("box")
    return ClosureAnalyser(
        box, hand, layout_of(hand), settings=made, gravity=TASK.gravity, known=lambda: list(known)
    )


def grips(hand: Hand, aim: Aim = EVERYWHERE, **settings: Any) -> list[Grip]:
    analyser = element(hand, **settings)
    found = analyser.explore(TASK.q, aim)
    return list(found.grips)


def press(grip: Grip) -> float:
    """Sum of the normal forces of the squeeze [N]."""
    return float((grip.forces * grip.contacts.normals_in).sum())


def margin(grip: Grip) -> float:
    return min(grip.task_margin, grip.hold_margin)


@pytest.fixture(scope="module")
def strong() -> Hand:
    """A hand whose joints are never too weak."""
    hand = load_hand("shadow")
    return replace(hand, torque_limits=1e3 * hand.torque_limits)


def test_a_heavier_object_is_pressed_in_proportion(strong: Hand) -> None:
    """Forces, weight and loads times five are the same problem: the same hands, five times the press."""
    assert ClosureSettings(mass=0.5).strongest == pytest.approx(5 * ClosureSettings().strongest)
    assert ClosureSettings(mass=0.02).strongest == ClosureSettings().strongest
    light, heavy = (grips(strong, mass=mass, press_least=1e-3, persistence=0) for mass in (0.1, 0.5))
    assert len(light) == len(heavy) == SMALL["finished"]
    by_palm = {one.palm_pose.tobytes(): one for one in heavy}
    for one in light:
        other = by_palm[one.palm_pose.tobytes()]
        assert press(other) == pytest.approx(5.0 * press(one), rel=1e-6)
        for name in ("task_margin", "hold_margin"):
            assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-5)
    assert max(map(press, heavy)) > 20.0 + 1e-6


def test_weak_joints_make_the_press_and_what_it_is_worth_smaller() -> None:
    hand = load_hand("shadow")
    weak = replace(hand, torque_limits=0.2 * hand.torque_limits)
    made = grips(weak, mass=0.5, persistence=0)
    assert made
    for one in made:
        grip = one
        assert (np.abs(grip.torques @ weak.rates(grip.grasp)) <= weak.torque_limits * (1 + 1e-9)).all()
        assert grip.quality < ENOUGH
        assert grip.quality == pytest.approx(6 * (1 - 2 ** -margin(one)), rel=1e-6)


def test_the_margin_of_a_heavy_object_is_that_of_the_press_which_is_used() -> None:
    """By an exact program with the very forces that the joints can make."""
    made = [one for one in grips(load_hand("shadow"), mass=0.5) if one.task_margin > 0]
    assert made
    settings = ClosureSettings(mass=0.5)
    analyser = element(load_hand("shadow"), mass=0.5)
    for one in made:
        contacts = Contacts(
            positions=one.contacts.points,
            normals_in=one.contacts.normals_in,
            friction=settings.mu,
            torsion=settings.gamma,
            reference=analyser.search.cog,
            length=analyser.search.length,
        )
        load = np.append(TASK.gravity, np.zeros(3)) * settings.weight
        demand = analyser.demand(TASK.q)
        assert demand.direction is not None
        exact = task_margin(contacts, demand.direction, ForceLimits(total=press(one)), load=load).number
        assert one.task_margin == pytest.approx((exact or 0.0) / demand.load / settings.weight, rel=0.03)


def test_what_no_usual_press_can_hold_a_firm_one_does_just(strong: Hand) -> None:
    made = grips(strong, friction=SLIPPERY, persistence=0)
    firm = [one for one in made if press(one) > MOST * RIGHT]
    assert firm
    for one in firm:
        assert one.quality == ENOUGH
        assert margin(one) == pytest.approx(1.0, rel=1e-9)
        assert press(one) <= FIRM * MOST * RIGHT
    # Best first, and of those that are just enough the one that presses least.
    assert [one.quality for one in made] == sorted((one.quality for one in made), reverse=True)
    assert [press(one) for one in firm] == sorted(press(one) for one in firm)


def test_where_no_grip_is_good_enough_a_larger_share_of_the_friction_counts() -> None:
    """Twice the share of a friction is the same problem as twice the friction."""
    hand, low = load_hand("shadow"), {"friction": 0.3, "torsion": 0.005, "mass": 0.6}
    usual, twice = grips(hand, **low), grips(hand, **{**low, "friction": 0.6, "torsion": 0.01})
    assert max(one.quality for one in usual) < ENOUGH < twice[0].quality
    analyser = element(hand, **low, bold_share=2 * FRICTION_SHARE)
    made = list(analyser.explore(TASK.q, EVERYWHERE).grips)
    bold = [one for one in made if one.friction_share == 2 * FRICTION_SHARE]
    good = [one for one in twice if one.quality >= ENOUGH]
    assert made[: len(bold)] == bold
    assert [one.palm_pose.tolist() for one in bold] == [one.palm_pose.tolist() for one in good]
    assert [margin(one) for one in bold] == [margin(one) for one in good]
    assert {one.quality for one in bold} == {ENOUGH}
    assert [one.palm_pose.tolist() for one in made[len(bold) :]] == [one.palm_pose.tolist() for one in usual]
    heaviest = analyser.heaviest(TASK.q, bold[0])
    assert heaviest is not None
    assert heaviest >= 0.6
    # Where other planes have not been searched, a better grip may be found there.
    aim = Aim(planes=[bold[0].plane.index], values=EVERYWHERE.values)
    again = element(hand, **low, bold_share=2 * FRICTION_SHARE).explore(TASK.q, aim)
    assert all(one.friction_share == FRICTION_SHARE for one in again.grips)


def test_nobody_presses_firmly_where_a_usual_press_is_enough(strong: Hand) -> None:
    made = grips(strong, friction=SMOOTH, persistence=0)
    assert made[0].quality > ENOUGH
    assert min(margin(one) for one in made) < 1.0  # firmly pressed these would be just enough
    assert max(map(press, made)) <= MOST * RIGHT


def test_a_firm_press_is_no_answer_where_a_better_grip_may_be_found_elsewhere(strong: Hand) -> None:
    aims = [Aim(planes=[plane], values=EVERYWHERE.values) for plane in range(1, 13)]
    made = [one for aim in aims for one in grips(strong, aim, friction=SLIPPERY)]
    short = [one for one in made if margin(one) < 1.0]
    assert short
    assert max(map(press, made)) <= MOST * RIGHT
    assert max(one.quality for one in short) < ENOUGH


@pytest.mark.parametrize("same", [True, False], ids=["taught for this object", "taught for another"])
def test_a_firm_grip_is_recalled_for_the_object_that_it_was_taught_for(strong: Hand, same: bool) -> None:
    low = {"friction": SLIPPERY, "persistence": 0}
    teacher = element(strong, **low)
    found = teacher.explore(TASK.q, EVERYWHERE)
    sets = FuzzySets()
    discovery = explore(teacher, TASK.q, sets, enough=ENOUGH)
    assert discovery is not None
    taught = experiences_of(teacher, "box", TASK.q, discovery, sets)[0]
    if not same:
        bigger = replace(taught.attributes, extents=1.02 * taught.attributes.extents)
        taught = replace(taught, attributes=bigger)
    best = found.grasp()
    assert press(best) > MOST * RIGHT
    pupil = element(strong, [taught], **low)
    value = float(sets.crisp()[taught.approach_set])
    again = pupil.explore(
        TASK.q, Aim(planes=[taught.plane], values=[value], fingers=range(2, taught.fingers + 1))
    )
    grasps = again.grips
    if same:
        assert grasps[0].judged >= ENOUGH
        assert press(grasps[0]) == pytest.approx(press(best), rel=0.05)
        assert pupil.tried < 200  # the stored grip, or the few candidates at the estimate beside it
    else:
        assert max(map(press, grasps), default=0.0) <= MOST * RIGHT


def test_the_ranking_knows_which_contacts_the_motors_can_press() -> None:
    """With a weak thumb, the first by what motors can press are better than the first by contacts alone."""
    hand = load_hand("shadow")
    names = [motor.name for motor in hand.motors]
    weak = replace(hand, torque_limits=np.where(np.char.find(names, "TH") >= 0, 0.3, 1.0))
    analyser = element(weak, mass=0.3, everywhere=1500, persistence=0)
    demand, search = analyser.demand(TASK.q), analyser.search
    found = search.evaluate(analyser.draws.grips(np.random.default_rng(0), EVERYWHERE, 1500), demand)
    alone = search.score(*search.strengths(found.closings, demand), demand)
    assert (found.score <= alone * (1 + 1e-6)).all()
    by_contacts = replace(found, score=alone).take(np.argsort(-alone, kind="stable"))

    def mean_margin(ranked: RankedCandidates) -> float:
        few = ranked.take(distinct(ranked, 60))
        made = analyser.finisher.finish(few, demand, FinishOptions(count=10))
        assert len(made) == 10
        return float(np.mean([grip.margin for grip in made]))

    assert mean_margin(found) > 1.3 * mean_margin(by_contacts)
