"""Wraps of the whole hand: drawn, closed, finished and recalled."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

import preshape
from preshape.closure.candidates import DrawnCandidates, Region
from preshape.closure.closed import ON_PALM, WRAP
from preshape.closure.hand_tables import hand_tables
from preshape.closure.preshapes import posture_of, preshapes
from preshape.closure.settings import ClosureSettings
from preshape.closure.torque_limits import PALM_PRESS, normal_bounds
from preshape.closure.wrapping import ClosedWraps, Wrapper, families
from preshape.exceptions import InputError
from preshape.export.planned import planned_grasps
from preshape.hands import load_hand
from preshape.hiis.analyser import PALM
from preshape.hiis.planes import APPROACH_AXES
from preshape.kernels.chains import joint_frames, rotations
from preshape.kernels.closing.host import ClosingKernel
from preshape.kernels.field.host import prepare_field
from preshape.objects.library import load_library_object
from preshape.planning.controllers import closure_analyser
from preshape.planning.document import plan_schema, plan_to_json
from preshape.planning.request import PlanRequest

GAP, NEAR = 5e-4, 1.5e-3


@cache
def wrapper(hand: str, name: str) -> Wrapper:
    tables, field = (
        hand_tables(load_hand(hand)),
        prepare_field(load_library_object(name), cells=48, cache=None),
    )
    return Wrapper(tables, ClosingKernel(tables, field), field, gap=GAP, near=NEAR)


@cache
def closed(hand: str, name: str, count: int = 250) -> ClosedWraps:
    made = wrapper(hand, name)
    rng = np.random.default_rng(4)
    drawn = made.draw(rng, preshapes(load_hand(hand)), load_library_object(name), count, Region())
    return made.close(drawn.candidates)


@pytest.mark.parametrize("hand", ["leap", "shadow"])
def test_links_stop_where_they_touch_and_those_after_them_go_on(hand: str) -> None:
    made, found = wrapper(hand, "bottle"), closed(hand, "bottle")
    tables, rows = made.tables, np.flatnonzero(found.closed)
    assert len(rows) > 25
    hands, grasp = found.candidates.take(rows), found.grasp[rows]
    distance, _ = made.kernel.link_distances(hands.place, hands.turn, grasp)
    assert distance.min() > -GAP  # nothing is inside
    # Every contact is one, and the palm's stand apart from each other.
    used = found.spheres[rows] >= 0
    links = np.where(found.links[rows] == ON_PALM, len(tables.axis), found.links[rows])
    assert np.take_along_axis(distance, links, axis=1)[used].max() <= NEAR + 1e-6
    # A hand that touches with a link before the last has closed the joints after it further than that one.
    begin, end = (q @ tables.command.T for q in (hands.start, grasp))
    share = np.abs(end - begin) / np.maximum(np.abs(tables.path[-1] - tables.path[0]), 1e-9)
    further = 0
    for f in range(len(tables.fingers)):
        a, b = tables.joint_start[f], tables.joint_start[f + 1]
        moving = [k for k in dict.fromkeys(tables.motor[a:b].tolist()) if np.ptp(tables.path[:, k]) > 0]
        early = (found.links[rows] == a + (b - a) // 2).any(axis=1)
        if len(moving) > 1:
            further += int((share[early][:, moving[-1]] > share[early][:, moving[0]] + 0.05).sum())
    assert further > 5
    assert (found.links[rows] == ON_PALM)[used].any()


def test_commands_stay_on_the_closing_path_and_in_range() -> None:
    found, tables = closed("shadow", "bottle"), wrapper("shadow", "bottle").tables
    hand = load_hand("shadow")
    assert np.abs(hand.follow(hand.controls(found.grasp)) - found.grasp).max() < 1e-6
    commands = found.grasp @ tables.command.T
    assert (commands >= tables.range[:, 0] - 1e-9).all()
    assert (commands <= tables.range[:, 1] + 1e-9).all()
    assert np.array_equal(posture_of(tables, commands), found.grasp) or np.allclose(
        posture_of(tables, commands), found.grasp, atol=1e-9
    )


def test_wraps_face_the_surface_along_allowed_planes() -> None:
    mesh = load_library_object("bottle")
    pool = preshapes(load_hand("leap"))
    drawn = wrapper("leap", "bottle").draw(
        np.random.default_rng(1), pool, mesh, 300, Region(planes=(3, 8), flips=(False, True))
    )
    assert 30 < len(drawn) < 300
    assert set(drawn.plane.tolist()) == {3, 8}
    assert (drawn.candidates.mask & WRAP).all()
    facing = -rotations(drawn.candidates.turn)[:, :, 1]
    assert np.einsum("ni,ni->n", facing, APPROACH_AXES[drawn.plane - 1]).min() > 0.7
    assert [len(part) for part in families(drawn)] == [len(drawn)]


def test_on_a_table_every_drawn_wrap_has_room_for_the_open_hand() -> None:
    """Half of all drawn palms would come through the table; as many as are wanted are drawn beside it."""
    request = PlanRequest(source="bottle", task="lift", hand="leap", table="auto")
    analyser = closure_analyser(request, load_hand("leap"), load_library_object("bottle"))
    search, mesh, region = analyser.search, analyser.mesh, Region()
    drawn = search.draw_wraps(np.random.default_rng(0), mesh, 400, region)
    assert len(drawn) == 400

    def clear(wraps: DrawnCandidates) -> Any:
        hands = search.wrapper.arrived(wraps.candidates)
        _, free = search.kernel.clearances(
            hands.place, hands.turn, hands.start, search.settings.obstacles, enough=0.01
        )
        return free > 0.0

    assert clear(drawn).all()
    assert clear(search.wrapper.draw(np.random.default_rng(0), search.pool, mesh, 400, region)).mean() < 0.8
    # Those that balance nothing are ranked by how near they come, so there is something to refine.
    found = search.evaluate(drawn, analyser.demand(request.asked.q))
    assert (np.diff(found.score) <= 0).all()
    assert len(np.unique(found.score[found.score < 0])) > 20


@pytest.mark.parametrize("kind", ["power", "precision"])
def test_only_grips_of_the_asked_type_are_answers(kind: str) -> None:
    plan = preshape.plan(
        "bottle", "lift", hand="leap", grasp_type=kind, memory=":memory:", count=2, table=None
    )
    document = plan_to_json(plan)
    Draft202012Validator(plan_schema()).validate(document)
    given = [document, *document["alternatives"]]
    assert len(given) == 2
    names = {"power": {"power", "intermediate"}, "precision": {"precision"}}[kind]
    assert {answer["grip"]["type"]["power"] for answer in given} <= names
    assert document["request"]["grasp_type"] == kind
    assert PlanRequest.from_json(document["request"]).grasp_type == kind
    assert document["alternatives"][0]["reason"] != document["reason"]


def test_several_answers_are_of_both_types() -> None:
    plan = preshape.plan("bottle", "lift", hand="leap", memory=":memory:", count=3, table=None)
    given = [plan.answer, *plan.alternatives]
    assert {answer.grasp.whole_hand for answer in given if answer is not None} == {True, False}


def test_an_unknown_type_and_a_type_for_rays_are_refused() -> None:
    with pytest.raises(InputError, match="known: any, power, precision"):
        PlanRequest(source="bottle", task="lift", hand="leap", grasp_type="strong", table=None)
    with pytest.raises(InputError, match="grasp type needs a real hand"):
        PlanRequest(source="bottle", task="lift", grasp_type="power", hand="utah_mit")


@pytest.mark.parametrize("hand", ["shadow", "allegro"])
def test_bounds_of_contacts_are_those_of_the_motors_behind_them(hand: str) -> None:
    """Each bound equals that by the exact Jacobian of the squeeze, palm and couples included."""
    model, mesh = load_hand(hand), load_library_object("hammer")
    analyser = closure_analyser(PlanRequest(source="hammer", task="lift", hand=hand, table=None), model, mesh)
    finisher, search = analyser.finisher, analyser.search
    drawn = search.wrapper.draw(np.random.default_rng(0), search.pool, mesh, 200, Region())
    hands = finisher.wrapped(drawn)
    frames = joint_frames(finisher.tables, hands.grasp)
    bounds = normal_bounds(
        finisher.tables, model, hands.candidates, hands.grasp, hands.points, hands.normals_in, hands.links
    )
    rows, palms = np.flatnonzero(hands.real)[:20], 0
    assert len(rows) == 20
    for row in rows.tolist():
        squeeze = finisher.squeezer.squeeze(hands, frames, row)
        for k, (J, motors) in enumerate(zip(squeeze.jacobians, squeeze.motors, strict=True)):
            if not len(motors):
                palms += 1
                assert bounds[row, k] == PALM_PRESS
                continue
            torques = np.abs(J[:3].T @ squeeze.normals_in[k])  # of one newton
            assert bounds[row, k] == pytest.approx(
                min(np.min(model.torque_limits[motors] / np.maximum(torques, 1e-9)), 1e4), rel=1e-5
            )
    assert palms


@pytest.fixture(scope="module")
def memory(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("wraps") / "memory.sqlite")


@pytest.fixture(scope="module")
def hammer(memory: str) -> dict[str, Any]:
    """What fingertips cannot hold: a hammer of 0.6 kg."""
    return json.loads(json.dumps(plan_to_json(asked(memory))))


def asked(memory: str) -> preshape.Plan:
    return preshape.plan("hammer", "lift", hand="leap", mass=0.6, seed=0, memory=memory, table=None)


def test_a_heavy_hammer_is_wrapped(hammer: dict[str, Any]) -> None:
    Draft202012Validator(plan_schema()).validate(hammer)
    assert hammer["status"] == "answer"
    grip, hand = hammer["grip"], hammer["hand"]
    names = [contact["finger"] for contact in hammer["contacts"]]
    assert len(names) > len(set(names)) or PALM in names
    assert grip["type"]["power"] in ("power", "intermediate")
    assert grip["quality"] >= 3.0
    # The forces balance, and the motors can make them; those of the palm need none.
    forces, points = (np.array(x) for x in (grip["forces"], [c["point"] for c in hammer["contacts"]]))
    press = sum(f @ np.array(c["normal_in"]) for f, c in zip(forces, hammer["contacts"], strict=True))
    turning = np.cross(points - points.mean(axis=0), forces).sum(axis=0)
    assert np.linalg.norm(forces.sum(axis=0)) < 0.05 * press
    assert np.linalg.norm(turning) < 0.05 * press * 0.1
    model = load_hand("leap")
    drive = model.rates(np.array(hand["grasp"]["q"])).T @ np.array(grip["torques"])
    assert (np.abs(drive) <= model.torque_limits * (1 + 1e-6)).all()
    # The palm arrives last: the opened hand stands back along its way in.
    back = np.array(hand["grasp"]["palm_pose"]) - np.array(hand["pregrasp"]["palm_pose"])
    assert back[:3] == pytest.approx(0.008 * np.array(grip["approach"]), abs=1e-9)
    assert not back[3:].any()
    # Exports take it as any grip; a force of the palm is the palm's.
    (exported,), faults = planned_grasps(hammer, "plan.json", answer=0)
    assert not faults
    assert exported.fingers == tuple(names)


def test_a_wrap_is_known_the_next_time(hammer: dict[str, Any], memory: str) -> None:
    again = plan_to_json(asked(memory))
    assert (again["mode"], again["known"]) == (0, True)
    assert again["grip"]["quality"] >= 0.9 * hammer["grip"]["quality"]
    assert again["grip"]["type"]["power"] == hammer["grip"]["type"]["power"]


def test_wraps_may_be_switched_off_and_light_things_need_none(memory: str) -> None:
    assert ClosureSettings(wraps=0).wraps == 0
    light = plan_to_json(preshape.plan("cube", "lift", hand="leap", mass=0.05, memory=memory, table=None))
    assert light["grip"]["type"]["power"] == "precision"
    assert light["grip"]["type"]["name"] in ("palmar pinch", "tripod", "quadpod", "precision disk")
