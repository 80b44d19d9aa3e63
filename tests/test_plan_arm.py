"""Plans with an arm: the answers that fall, what the document says, and the trajectory of hand and arm."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml

import arm_models
from preshape import plan, spatial
from preshape.exceptions import InputError
from preshape.export.planned import planned_grasps
from preshape.export.trajectory import (
    arm_message,
    motor_trajectory,
    trajectory_arrays,
    trajectory_csv,
    trajectory_message,
)
from preshape.hands.load import load_hand
from preshape.hiis.decision import Status
from preshape.planning.arm import LIFT, WAY_IN
from preshape.planning.document import plan_schema, plan_to_json, request_of
from preshape.planning.plan import Plan
from preshape.planning.request import PlanRequest
from preshape.planning.summary import summary_text
from test_arm import tip_in_mujoco
from test_export import run

HAND = "utah_mit"
MOUNT = arm_models.mount_along(load_hand(HAND))
BASE = [-0.45, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> str:
    return arm_models.written(tmp_path_factory.mktemp("arm"), arm_models.six_joints())


def made(arm: str, base: list[float] = BASE, thing: str = "cube", **options: Any) -> Plan:
    options = {"arm_tip": "tip", "mount": MOUNT, "base_pose": base, **options}
    return plan(thing, "lift", hand=HAND, memory=":memory:", arm=arm, **options)


@pytest.fixture(scope="module")
def served(six: str) -> Plan:
    return made(six, count=4)


@pytest.fixture(scope="module")
def unserved(six: str) -> Plan:
    return made(six, [-1.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def valid(document: dict[str, Any]) -> None:
    jsonschema.Draft202012Validator(plan_schema()).validate(document)


def test_every_answer_has_a_path_to_its_own_pose(served: Plan) -> None:
    assert served.arm is not None
    arm, document = served.arm.arm, json.loads(json.dumps(plan_to_json(served)))
    valid(document)
    answers = [document, *document["alternatives"]]
    assert served.arm.tested >= len(answers) + len(served.arm.refused) - 1
    T_world_object = spatial.pose_from_seven(document["scene"]["T_world_object"])
    T_base_object = spatial.inverse(spatial.pose_from_seven(BASE)) @ T_world_object
    T_tip_palm = spatial.pose_from_seven(MOUNT) @ load_hand(HAND).T_root_palm
    for answer in answers:
        path = answer["arm"]["path"]
        g = path["stages"].count("way_in") - 1
        palm = spatial.pose_from_seven(answer["hand"]["grasp"]["palm_pose"])
        for k, shift in ((0, -WAY_IN * np.array(answer["way_in"])), (g, np.zeros(3)), (-1, [0, 0, LIFT])):
            wanted = palm.copy()
            wanted[:3, 3] += shift
            held = tip_in_mujoco(arm, np.array(path["q"][k])) @ T_tip_palm
            assert spatial.inverse(T_base_object) @ held == pytest.approx(wanted, abs=2e-4)


def test_the_object_stands_in_the_world_of_the_base(six: str) -> None:
    # The same scene, with the mesh frame's y up: base and answer are in the world, whose z is up.
    made_so = made(six, [-0.45, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0], up="y")
    assert made_so.answer is not None
    assert made_so.answer.arm is not None
    assert made_so.arm is not None
    q = made_so.answer.arm.q
    tips = [tip_in_mujoco(made_so.arm.arm, row)[:3, 3] for row in (q[0], q[-1])]
    grasp = tip_in_mujoco(made_so.arm.arm, q[made_so.answer.arm.stages.count("way_in") - 1])[:3, 3]
    assert tips[1] - grasp == pytest.approx([0, 0, LIFT], abs=1e-4)
    way = spatial.pose_from_seven(made_so.standing.pose)[:3, :3] @ made_so.answer.way_in
    assert grasp - tips[0] == pytest.approx(WAY_IN * way, abs=1e-4)


def test_without_an_answer_in_reach_the_best_says_why_and_what_would_help(unserved: Plan) -> None:
    document = plan_to_json(unserved)
    valid(document)
    assert unserved.decision.status is Status.DEADLOCK
    assert document["best"]["executable"] is False
    assert document["best"]["arm"]["path"] is None
    assert document["best"]["arm"]["status"] == "out_of_reach"
    assert len(document["arm"]["refused"]) == document["arm"]["tested"]
    assert f"{document['arm']['tested']} of {document['arm']['tested']} answers are" in document["reason"]
    assert "out of the arm's reach" in document["reason"]
    assert "does not reach it" in " ".join(summary_text(unserved).split())


def test_terminal_and_page_say_what_the_arm_makes_of_it(served: Plan, unserved: Plan) -> None:
    from preshape.viewer.readings import facts

    document, other = plan_to_json(served), plan_to_json(unserved)
    assert "arm reaches it" in " ".join(summary_text(served).split())
    assert "The arm reaches no answer" in summary_text(unserved)
    assert '<div class="step good"><b>Arm</b><br>arm reaches it' in facts(document, document)
    assert '<div class="step bad"><b>Arm</b><br>arm does not reach it' in facts(other, other["best"])


def test_the_advice_is_followed_and_helps(six: str) -> None:
    far = made(six, [-1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert far.answer is None
    advice = far.decision.reason.split('--base-pose "')[1].split('"')[0]
    moved = made(six, [float(x) for x in advice.split()])
    assert moved.answer is not None, moved.decision.reason


def test_the_reason_says_which_answers_fell(six: str) -> None:
    far = made(six, [-0.62, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], count=12)
    assert far.arm is not None
    assert 0 < len(far.arm.refused) < far.arm.tested
    counts = [int(part.split()[0]) for part in far.decision.reason.split("; ") if part[0].isdigit()]
    assert sum(counts) == len(far.arm.refused)
    assert f" of {far.arm.tested} answers " in far.decision.reason
    assert far.decision.reason == far.decision.transitions[-1].reason
    kept = {id(a.grasp) for a in (far.answer, *far.alternatives) if a is not None}
    assert not kept & {id(a.grasp) for a in far.arm.refused}
    assert len(kept) == far.arm.tested - len(far.arm.refused)
    assert far.decision.grasp is far.grasp


def test_the_request_comes_back_from_the_document(served: Plan) -> None:
    document = json.loads(json.dumps(plan_to_json(served)))
    again = request_of(document)
    assert again.to_json() == served.request.to_json()
    assert (again.arm_tip, again.mount, again.base_pose) == ("tip", tuple(MOUNT), tuple(BASE))


def test_a_plan_without_an_arm_has_none_in_its_document() -> None:
    document = plan_to_json(plan("cube", "lift", memory=":memory:"))
    valid(document)
    assert document["arm"] is None
    assert document["request"]["arm"] is None


def test_the_trajectory_has_the_arm_and_waits_while_the_fingers_close(served: Plan) -> None:
    document = json.loads(json.dumps(plan_to_json(served)))
    grasp = planned_grasps(document, "plan.json", answer=0)[0][0]
    path = document["arm"]["path"]
    trajectory = motor_trajectory(grasp)
    assert trajectory.arm == tuple(document["arm"]["joints"])
    g = path["stages"].count("way_in")
    assert trajectory.stages == (
        "pregrasp",
        *["way_in"] * (g - 1),
        "touch",
        "squeeze",
        *["lift"] * (len(path["q"]) - g),
    )
    arm = np.array(trajectory.arm_positions)
    assert arm[:g].tolist() == path["q"][:g]
    assert arm[g + 2 :].tolist() == path["q"][g:]
    assert np.array_equal(arm[g : g + 2], arm[[g - 1, g - 1]])
    assert trajectory.times[-1] == pytest.approx(path["times"][-1] + 1.5)
    hand = grasp.hand
    assert trajectory.positions[:g] == pytest.approx(np.tile(hand.controls(grasp.pregrasp), (g, 1)))
    assert trajectory.positions[g] == pytest.approx(hand.controls(grasp.grasp))
    assert trajectory.positions[g + 1 :] == pytest.approx(
        np.tile(hand.controls(grasp.squeeze), (len(arm) - g - 1, 1))
    )
    slow = motor_trajectory(grasp, duration=20.0)
    assert slow.times == pytest.approx(trajectory.times * 20.0 / trajectory.times[-1])


def test_all_formats_have_the_arms_joints(served: Plan, tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(plan_to_json(served)))
    grasp = planned_grasps(json.loads(file.read_text()), "plan.json", answer=0)[0][0]
    trajectory = motor_trajectory(grasp)
    message, arm = trajectory_message(trajectory), arm_message(trajectory)
    assert arm is not None
    assert arm["joint_names"] == [f"joint_{k}" for k in range(1, 7)]
    stamps = [[p["time_from_start"] for p in each["points"]] for each in (message, arm)]
    assert stamps[0] == stamps[1]
    rows = list(csv.DictReader(io.StringIO(trajectory_csv(trajectory))))
    arrays = trajectory_arrays(trajectory)
    column = [float(row["joint_2"]) for row in rows]
    assert column == pytest.approx(arrays["arm_positions"][:, 1].tolist(), abs=1e-7)
    assert arrays["arm_names"].tolist() == arm["joint_names"]
    code, out, _ = run("export", str(file), "--format", "trajectory")
    assert code == 0
    assert list(yaml.safe_load_all(out)) == [message, arm]
    code, out, _ = run("export", str(file), "--format", "trajectory", "--json")
    assert json.loads(out)["arm_trajectory"] == arm


def test_the_link_of_the_arm_has_the_planned_mount_in_an_export(served: Plan, tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(plan_to_json(served)))
    words = ["export", str(file), "--format", "isaac", "--parent-link", "tip"]
    code, out, _ = run(*words)
    assert code == 0
    assert run(*words, "--mount", " ".join(map(str, MOUNT)))[1] == out
    assert run(*words[:-1], "other")[0] == 2


def test_the_command_plans_with_an_arm(six: str, tmp_path: Path) -> None:
    words = [
        *("plan", "cube", "--task", "lift", "--memory", ":memory:", "--arm", six, "--arm-tip", "tip"),
        *("--mount", " ".join(map(str, MOUNT))),
    ]
    code, out, _ = run(*words, "--base-pose", "-0.45 0 0 1 0 0 0", "--json")
    document = json.loads(out)
    assert code == 0
    assert document["arm"]["status"] == "reached"
    assert document["request"]["base_pose"] == BASE
    code, out, _ = run(*words, "--base-pose", "-1.5 0 0 1 0 0 0")
    assert code == 1
    assert "reach" in out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--arm-tip", "tip"], "--arm-tip belongs to an arm"),
        (["--mount", "0 0 0 1 0 0 0"], "--mount belongs to an arm"),
        (["--arm", "ARM"], "--arm needs --arm-tip, the name of the link"),
        (["--arm", "ARM", "--arm-tip", "tip"], "--arm needs --base-pose"),
        (["--arm", "ARM", "--arm-tip", "tip", "--base-pose", "1 2 3"], "--base-pose must be seven numbers"),
        (["--arm", "ARM", "--arm-tip", "tip", "--base-pose", "a b"], "--base-pose takes seven numbers"),
        (["--arm", "ARM", "--arm-tip", "tip", "--base-pose", "0 0 0 1 1 0 0"], "has the length 1.414"),
        (["--arm", "ARM", "--arm-tip", "tip", "--base-pose", "0 0 0 0 0 0 0"], "has the length 0"),
        (["--arm", "ARM", "--arm-tip", "tip", "--base-pose", "0 0 1e9 1 0 0 0"], "at most 1e+06 m away"),
        (["--arm", "ARM", "--arm-tip", "tp", "--base-pose", "0 0 0 1 0 0 0"], "did you mean tip?"),
        (["--arm", "none.urdf", "--arm-tip", "tip", "--base-pose", "0 0 0 1 0 0 0"], "there is no arm"),
        (["--arm", "", "--arm-tip", "tip", "--base-pose", "0 0 0 1 0 0 0"], "--arm must be the URDF"),
    ],
)
def test_bad_input_is_one_sentence(options: list[str], said: str, six: str) -> None:
    words = [six if word == "ARM" else word for word in options]
    code, out, err = run("plan", "cube", "--task", "lift", "--memory", ":memory:", *words)
    assert code == 2
    assert said in " ".join((out + err).split())
    assert "Traceback" not in err


def test_a_request_keeps_a_rounded_quaternion_as_a_unit_one(six: str) -> None:
    base = [0, 0, 0, 0.7071, 0, 0, 0.7071]
    request = PlanRequest(source="cube", task="lift", arm=six, arm_tip="tip", base_pose=base)
    assert math.dist(request.base_pose[3:], (0, 0, 0, 0)) == pytest.approx(1.0, abs=1e-15)  # type: ignore[index]
    assert request.mount == (0, 0, 0, 1, 0, 0, 0)
    again = PlanRequest.from_json(json.loads(json.dumps(request.to_json())))
    assert again.base_pose == request.base_pose
    with pytest.raises(InputError, match="length"):
        PlanRequest(source="cube", task="lift", arm=six, arm_tip="tip", base_pose=[0, 0, 0, 0.7, 0, 0, 0])
