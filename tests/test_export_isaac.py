"""Grasp files of Isaac Sim, read as its documentation says, by code that knows nothing of preshape."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from preshape.exceptions import InputError
from preshape.export.isaac import isaac_grasps
from preshape.export.moveit import MoveItOptions
from preshape.hands import load_hand
from test_export import CLOSURE, STORED, both, grasps_of, messages_of, reach, run


def matrix(w: float, xyz: list[float]) -> np.ndarray:
    """The rotation of a quaternion, by its textbook formula."""
    x, y, z = xyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


class GraspSpec:
    """The interface of ``isaacsim.robot_setup.grasp_editor.GraspSpec``, from its documentation."""

    def __init__(self, text: str) -> None:
        self.read: dict[str, Any] = yaml.safe_load(text)
        assert self.read["format"] == "isaac_grasp"
        assert float(self.read["format_version"]) == 1.0

    def get_grasp_names(self) -> list[str]:
        return list(self.read["grasps"])

    def get_grasp_dict_by_name(self, name: str) -> dict[str, Any]:
        return self.read["grasps"][name]

    def compute_gripper_pose_from_rigid_body_pose(
        self, name: str, trans: np.ndarray, R: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        grasp = self.read["grasps"][name]
        at = grasp["orientation"]
        return R @ grasp["position"] + trans, R @ matrix(at["w"], at["xyz"])


def placed(document: dict, spec: GraspSpec, name: str, joints: str, R: np.ndarray, trans: np.ndarray) -> Any:
    """The hand's MJCF with its root at the pose of a grasp."""
    hand = load_hand(document["hand"]["name"])
    model = mujoco.MjModel.from_xml_string(hand.mjcf)
    position, turn = spec.compute_gripper_pose_from_rigid_body_pose(name, trans, R)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, turn.ravel())
    model.body_pos[1], model.body_quat[1] = position, quat
    data = mujoco.MjData(model)
    for joint, angle in spec.get_grasp_dict_by_name(name)[joints].items():
        data.qpos[model.joint(joint).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    return hand, model, data


@both
def test_the_fingers_touch_the_contacts_wherever_the_object_is(document: dict, tmp_path: Path) -> None:
    file, out = tmp_path / "plan.json", tmp_path / "grasps.yaml"
    file.write_text(json.dumps(document))
    assert run("export", str(file), "--format", "isaac", "--out", str(out))[0] == 0
    spec = GraspSpec(out.read_text())
    answers = [document, *document["alternatives"]]
    assert spec.get_grasp_names() == [f"grasp_{k}" for k in range(len(answers))]
    rng = np.random.default_rng(0)
    R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    R *= np.linalg.det(R)
    trans = rng.normal(size=3)
    for name, answer in zip(spec.get_grasp_names(), answers, strict=True):
        for joints, touching in (("cspace_position", True), ("pregrasp_cspace_position", False)):
            hand, model, data = placed(document, spec, name, joints, R, trans)
            for contact in answer["contacts"]:
                own = hand.finger(contact["finger"]).joints
                bodies = {int(model.joint(joint).bodyid[0]) for joint in own}
                off = reach(model, data, R @ contact["point"] + trans, bodies)
                assert abs(off) < 0.0012 if touching else off > 0.0002, (joints, contact["finger"], off)


@both
def test_the_file_says_what_the_message_says(document: dict) -> None:
    made = isaac_grasps(grasps_of(document), MoveItOptions(), "/World/mug")
    for grasp, message in zip(made["grasps"].values(), messages_of(document), strict=True):
        assert grasp["confidence"] == message["grasp_quality"]
        at = message["grasp_pose"]["pose"]
        assert grasp["position"] == [at["position"][k] for k in "xyz"]
        assert grasp["orientation"] == {
            "w": at["orientation"]["w"],
            "xyz": [at["orientation"][k] for k in "xyz"],
        }
        names = message["grasp_posture"]["joint_names"]
        touch = message["grasp_posture"]["points"][0]["positions"]
        assert grasp["cspace_position"] == dict(zip(names, touch, strict=True))
    assert made["object_frame_link"] == "/World/mug"


def test_names_of_frames_and_the_mount() -> None:
    mount = "0 0 0.05 1 0 0 0"
    code, out, _ = run(
        *("export", str(STORED), "--format", "isaac", "--frame", "/World/mug", "--parent-link", "flange"),
        *("--mount", mount, "--answer", "0", "--json"),
    )
    report = json.loads(out)
    assert (code, report["parent_link"], report["frame"]) == (0, "flange", "/World/mug")
    made = report["isaac"]
    assert (made["gripper_frame_link"], list(made["grasps"])) == ("flange", ["grasp_0"])
    at = made["grasps"]["grasp_0"]
    root = isaac_grasps(grasps_of(CLOSURE, answer=0), MoveItOptions())["grasps"]["grasp_0"]
    turn = matrix(at["orientation"]["w"], at["orientation"]["xyz"])
    assert np.array(at["position"]) + turn @ [0, 0, 0.05] == pytest.approx(np.array(root["position"]))
    with pytest.raises(InputError, match="only rh_wrist, rh_forearm, rh_palm"):
        isaac_grasps(grasps_of(CLOSURE), MoveItOptions(parent_link="wrist"))


def test_a_wrong_ending_is_one_sentence(tmp_path: Path) -> None:
    code, _, err = run("export", str(STORED), "--format", "isaac", "--out", str(tmp_path / "grasps.usd"))
    assert code == 2
    assert "isaac has the endings .yaml, .yml" in " ".join(err.split())
