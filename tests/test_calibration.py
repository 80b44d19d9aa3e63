"""The calibrated critic: its margins, what it lets through, and the study that it is fitted by."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from preshape import plan
from preshape.cli.main import run
from preshape.closure import finish
from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.calibration import LIKELY, WHOLE, PickCritic, PickModel, odds
from preshape.closure.finish import ENOUGH
from preshape.closure.pressing import UnitSqueeze, made_by_motors
from preshape.closure.settings import FRICTION_SHARE, ClosureSettings, table_below
from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim, Grip
from preshape.hiis.decision import Status
from preshape.metrics import Contacts, ForceLimits, task_margin
from preshape.objects.library import load_library_object
from preshape.planning.controllers import layout_of
from preshape.planning.document import plan_to_json
from preshape.spatial import rotation_from_vector
from preshape.studies import critic_study
from preshape.studies.critic_figures import critic_figures, fitted
from preshape.tasks import parse_task

SMALL: dict[str, Any] = {"everywhere": 400, "wraps": 200, "elite": 8, "rounds": 1, "persistence": 0}
EVERYWHERE = Aim(values=np.linspace(-1.0, 1.0, 5))
TASK = parse_task("lift")


def element(name: str, **settings: Any) -> ClosureAnalyser:
    """A small search of a library object on a table that it stands on."""
    mesh, hand = load_library_object(name), load_hand("leap")
    low = float(mesh.vertices[:, 2].min())
    own = ClosureSettings(**{**SMALL, "threads": 1, "mass": mesh.mass, **settings})
    return ClosureAnalyser(
        mesh, hand, layout_of(hand), settings=replace(own, obstacles=table_below(low)), seed=3
    )


@pytest.fixture(scope="module")
def cone() -> ClosureAnalyser:
    return element("cone", friction_share=WHOLE, bold_share=WHOLE)


@pytest.fixture(scope="module")
def on_cone(cone: ClosureAnalyser) -> list[Grip]:
    """Grips of a cone, which nothing but the whole friction holds."""
    found = list(cone.explore(TASK.q, EVERYWHERE).grips)
    assert found
    return found


def critic_of(analyser: ClosureAnalyser) -> PickCritic:
    assert analyser.critic is not None
    return analyser.critic


def test_margins_are_those_of_an_exact_program(cone: ClosureAnalyser, on_cone: list[Grip]) -> None:
    settings, demand = cone.settings, cone.demand(TASK.q)
    assert demand.direction is not None
    for share in (0.8, WHOLE):
        for grip, (task, _) in zip(
            on_cone, critic_of(cone).margins(on_cone, demand, share).tolist(), strict=True
        ):
            contacts = Contacts(
                positions=grip.contacts.points,
                normals_in=grip.contacts.normals_in,
                friction=settings.friction * share,
                torsion=settings.torsion * share,
                reference=cone.search.cog,
                length=cone.search.length,
            )
            load = np.append(TASK.gravity, np.zeros(3)) * settings.weight
            exact = task_margin(contacts, demand.direction, ForceLimits(total=grip.press), load=load).number
            assert task == pytest.approx((exact or 0.0) / demand.load / settings.weight, rel=0.03, abs=1e-3)


def test_half_the_share_of_twice_the_friction_is_the_same(cone: ClosureAnalyser, on_cone: list[Grip]) -> None:
    own = cone.settings
    twice = element("cone", friction=2 * own.friction, torsion=2 * own.torsion)
    for share in (0.5, WHOLE):
        here = critic_of(cone).margins(on_cone, cone.demand(TASK.q), share)
        there = critic_of(twice).margins(on_cone, twice.demand(TASK.q), share / 2)
        assert there == pytest.approx(here, rel=1e-5)


def test_more_friction_never_lowers_margins_or_probability(
    cone: ClosureAnalyser, on_cone: list[Grip]
) -> None:
    demand, critic = cone.demand(TASK.q), critic_of(cone)
    ladder = [critic.margins(on_cone, demand, share) for share in (FRICTION_SHARE, 0.5, 0.7, WHOLE)]
    for less, more in pairwise(ladder):
        assert (more >= less - 0.03 * np.abs(less) - 1e-6).all()


def test_what_is_let_through_is_likely_or_has_some_reserve(
    cone: ClosureAnalyser, on_cone: list[Grip]
) -> None:
    demand, critic, bold = cone.demand(TASK.q), critic_of(cone), 0.9
    told = [0.5, 1.0, *np.linspace(LIKELY - 0.05, 1.0, len(on_cone))][: len(on_cone)]
    asked = [replace(grip, pick_probability=p) for grip, p in zip(on_cone, told, strict=True)]
    made = critic.with_more_friction(asked, demand, (bold, WHOLE))
    given = [grip for grip in made if grip.quality >= ENOUGH]
    assert 0 < len(given) < len(made)
    with_bold, with_all = (critic.margins(asked, demand, share).min(axis=1) for share in (bold, WHOLE))
    passed = {grip.palm_pose.tobytes(): grip for grip in given}
    for grip, some, most in zip(asked, with_bold, with_all, strict=True):
        share = bold if some >= 1.0 else WHOLE if most >= 1.0 and odds(grip) >= LIKELY else None
        one = passed.get(grip.palm_pose.tobytes())
        assert (one.friction_share if one else None) == share
    for grip in given:
        again = critic.margins([grip], demand, grip.friction_share)[0]
        assert (grip.task_margin, grip.hold_margin) == pytest.approx(again.tolist())
        assert again.min() >= 1.0
        assert grip.quality == ENOUGH
    order = [(odds(grip) < LIKELY, grip.friction_share, -odds(grip)) for grip in made]
    assert order == sorted(order)
    for grip in made[len(given) :]:
        assert grip.friction_share == WHOLE
        assert grip.quality == pytest.approx(ENOUGH * odds(grip) / LIKELY)
        assert f"{odds(grip):.2f} of grips like it" in cone.shortfall(TASK.q, grip)
    assert critic.with_more_friction([], demand, (bold, WHOLE)) == []


def test_a_grip_that_was_refused_has_no_odds(cone: ClosureAnalyser, on_cone: list[Grip]) -> None:
    demand = cone.demand(TASK.q)
    for grip in on_cone:
        assert 0.0 < odds(grip) < 1.0
    refused = replace(on_cone[0], refused="the table is in its way", pick_probability=None)
    assert critic_of(cone).with_odds([refused], demand) == [refused]
    assert critic_of(cone).with_more_friction([refused], demand, (0.7, WHOLE)) == []


def test_a_lower_object_is_less_likely_picked_up(cone: ClosureAnalyser, on_cone: list[Grip]) -> None:
    low = PickCritic(cone.search, 0.01).with_odds(on_cone, cone.demand(TASK.q))
    assert critic_of(cone).height == pytest.approx(0.08, abs=1e-3)
    for grip, flat in zip(on_cone, low, strict=True):
        assert odds(flat) < odds(grip)


def test_a_model_is_found_again() -> None:
    rng = np.random.default_rng(4)
    true = PickModel(constant=1.5, margin=0.6, wrap=-1.2, height=-0.8)
    n = 20_000
    features = PickModel.features(2.0 ** rng.uniform(-5, 4, n), rng.random(n) < 0.4, rng.uniform(0.0, 0.1, n))
    told = true.probability(features)
    found = fitted(features, rng.random(n) < told).probability(features)
    assert np.abs(found - told).max() < 0.04


def test_reliability_is_judged_on_objects_that_were_held_out() -> None:
    """Where an object's outcomes are the opposite of all others', its own grips are predicted wrongly."""
    rows = [
        {
            "hand": "leap", "object": name, "usual": margin, "bold": margin, "whole": margin,
            "wrap": False, "height": 0.05, "status": "picked",
            "picked": (margin > 1.0) != (name == "odd"), "done": True,
        }
        for name in ("a", "b", "c", "d", "odd")
        for margin in (0.1, 0.2, 4.0, 6.0) * 25
    ]  # fmt: skip
    document = critic_figures(rows)
    assert (document["grips"], document["objects"], document["picked"]) == (500, 5, 250)
    assert sum(one["count"] for one in document["bins"]) == 500
    assert (document["given"]["count"], document["given"]["of"]) == (50, 50)  # those of the odd object
    assert (document["refused"]["count"], document["refused"]["of"]) == (250, 250)


def test_a_cone_on_a_table_is_given_by_the_critic(lesson: Callable[[str], Path]) -> None:
    """Its sides slope by 21°: with less than the whole friction, fingertips would slip off."""
    asked: dict[str, Any] = {"hand": "leap", "memory": lesson("leap"), "learn": False}
    made = plan("cone", "lift", closure=ClosureSettings(**SMALL), **asked)
    told = plan_to_json(made)
    assert made.decision.status is Status.ANSWER
    assert (told["grip"]["quality"], told["grip"]["friction_share"]) == (3.0, WHOLE)
    assert told["grip"]["pick_probability"] >= LIKELY
    assert told["heaviest_mass"] >= made.mass.kg
    assert any("this one is with all of it" in warning for warning in told["warnings"])
    assert "of grips like this one pick their object up" in str(made)
    careful = plan("cone", "lift", closure=ClosureSettings(**SMALL, bold_share=FRICTION_SHARE), **asked)
    assert careful.decision.status is not Status.ANSWER


def test_without_a_table_no_probability_is_stated(lesson: Callable[[str], Path]) -> None:
    made = plan("cube", "lift", hand="leap", memory=lesson("leap"), learn=False, table=None)
    assert plan_to_json(made)["grip"]["pick_probability"] is None
    assert "pick-up" not in str(made)


def test_the_study_goes_on_where_it_stopped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, few in (
        ("GRIPS", 200),
        ("WRAPS", 100),
        ("ELITE", 4),
        ("SHARES", {"usual": FRICTION_SHARE, "bold": 0.7, "whole": WHOLE}),
    ):
        monkeypatch.setattr(critic_study, name, few)
    asked = ["bench", "critic", "cube", "--hand", "leap", "--count", "1", "--workers", "1", "--json"]
    asked += ["--out", str(tmp_path)]
    assert run(asked) == 0
    first = json.loads(capsys.readouterr().out)
    rows = json.loads((tmp_path / "grips.json").read_text())["rows"]
    assert first["grips"] == len(rows) > 5
    assert {row["wrap"] for row in rows} == {True, False}
    assert (
        first["picked"]
        == sum(row["picked"] for row in rows)
        == sum(first["statuses"].get("picked", 0) for _ in "1")
    )
    parts = list((tmp_path / "parts").glob("*.json"))
    assert len(parts) == 1
    before = parts[0].read_bytes()
    assert run(asked) == 0
    assert json.loads(capsys.readouterr().out) == first
    assert parts[0].read_bytes() == before
    assert (tmp_path / "reliability.png").stat().st_size > 5000
    parts[0].write_text("{}")
    assert run(asked) == 2
    assert "does not hold rows of this study" in capsys.readouterr().out


def between(*, moved: tuple[int, ...]) -> UnitSqueeze:
    """Two contacts that press an object of 40 mm along x; those named have a motor with a lever of 50 mm."""
    points, normals = np.array([[-0.02, 0, 0], [0.02, 0, 0]]), np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    lever = np.array([[0.05], [0], [0], [0], [0], [1.0]])
    jacobians = [np.sign(normals[k, 0]) * lever if k in moved else np.zeros((6, 0)) for k in (0, 1)]
    drive = np.array([0.025 if k in moved else 0.0 for k in (0, 1)])  # the torque of 0.5 N at that lever
    return UnitSqueeze(
        points=points,
        normals_in=normals,
        forces=0.5 * normals,
        imbalance=0.0,
        jacobians=jacobians,
        motors=[np.array([k] if k in moved else [], dtype=np.int64) for k in (0, 1)],
        torques=drive,
        drive=drive,
        max_press=100.0,
    )


@pytest.mark.parametrize(("moved", "made"), [((0, 1), 1.0), ((0,), 1.0), ((), 0.0)])
def test_motors_make_a_press_and_bones_do_not(moved: tuple[int, ...], made: float) -> None:
    """One motor that presses against a bone makes the whole press; two bones make none."""
    compliance = np.full(2, 0.2)
    assert made_by_motors(between(moved=moved), np.zeros(3), compliance) == pytest.approx(made, abs=0.05)
    # The same hand and object, turned and moved, and with other numbers of motors.
    R = rotation_from_vector(np.array([0.3, -0.5, 0.8]))
    one = between(moved=moved)
    turned = one._replace(
        points=one.points @ R.T + 0.1,
        normals_in=one.normals_in @ R.T,
        jacobians=[np.concatenate([R @ J[:3], R @ J[3:]]) for J in one.jacobians],
    )
    again = made_by_motors(turned, np.full(3, 0.1), compliance)
    assert again == pytest.approx(made_by_motors(one, np.zeros(3), compliance), abs=1e-9)


def test_wraps_that_motors_do_not_press_are_no_grips(monkeypatch: pytest.MonkeyPatch) -> None:
    """The least share decides for wraps, and for them only."""
    assert element("cylinder", grasp_type="power").explore(TASK.q, EVERYWHERE).grips
    monkeypatch.setattr(finish, "LEAST_MADE", 10.0)
    assert not element("cylinder", grasp_type="power").explore(TASK.q, EVERYWHERE).grips
    assert element("cylinder", grasp_type="precision").explore(TASK.q, EVERYWHERE).grips
