"""``preshape export``: other programs read the numbers of the plan.

``python tests/test_export.py`` rewrites ``tests/data/shadow_mug_lift.json``: a plan of the closure
analyser, whose search takes too long for a test.
"""

from __future__ import annotations

import copy
import hashlib
import io
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from ruamel.yaml import YAML

from preshape import spatial
from preshape.cli import commands, main
from preshape.exceptions import EnvironmentFailure, InputError, ObjectError
from preshape.export import ros_bag
from preshape.export.forces import contact_forces
from preshape.export.mjcf import scene_mjcf
from preshape.export.moveit import MoveItOptions, messages_yaml, moveit_grasps
from preshape.export.planned import planned_grasps
from preshape.export.scene_object import find_object, grasp_set
from preshape.hands.kinematics import HandKinematics
from preshape.hands.load import load_hand
from preshape.objects.library import load_library_object
from preshape.physics.grasps import read_grasps, write_grasps
from preshape.physics.hand import physics_hand
from preshape.physics.pieces import ConvexPieces
from preshape.planner import plan
from preshape.planning.document import lacking, plan_to_json, read_plan
from preshape.planning.grasp_sets import read_grasp_file

commands._COMMANDS.setdefault("export", ("export", "Write a plan for other programs."))

ROOT = Path(__file__).parent.parent
STORED = Path(__file__).parent / "data" / "shadow_mug_lift.json"

if __name__ == "__main__":  # before the old file is read
    STORED.parent.mkdir(exist_ok=True)
    made = plan("mug", "lift", hand="shadow", memory=":memory:", count=3, table=None)
    STORED.write_text(json.dumps(plan_to_json(made), indent=1) + "\n")
    raise SystemExit

RAYS = json.loads((ROOT / "docs" / "plan.example.json").read_text())
CLOSURE = json.loads(STORED.read_text())
PLANS = {"closure": CLOSURE, "rays": RAYS}
both = pytest.mark.parametrize("document", PLANS.values(), ids=PLANS)

# As public code generated from the messages has them.
MD5 = {
    "moveit_msgs/msg/Grasp": "e26c8fb64f589c33c5d5e54bd7b5e4cb",
    "moveit_msgs/msg/GripperTranslation": "b53bc0ad0f717cdec3b0e42dec300121",
}
STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"  # std_msgs/msg/String


def grasps_of(document: dict, **options):
    return planned_grasps(document, "plan.json", **options)[0]


def messages_of(document: dict, **options) -> list[dict]:
    return moveit_grasps(grasps_of(document), MoveItOptions(**options))


def same(read, message, kind: str = ros_bag.GRASP, path: str = "grasp") -> int:
    """Compare an object that was read back with its dictionary, and return the number of leaves."""
    if isinstance(message, dict):
        return sum(same(getattr(read, key), part, key, f"{path}.{key}") for key, part in message.items())
    if isinstance(message, list):
        assert len(read) == len(message), path
        return sum(
            same(a, b, kind, f"{path}[{k}]") for k, (a, b) in enumerate(zip(read, message, strict=True))
        )
    single = kind in ("desired_distance", "min_distance", "max_contact_force")
    assert read == (np.float32(message) if single else message), path
    return 1


def run(*arguments: str) -> tuple[int, str, str]:
    """Exit code, standard output and error of a command."""
    out, err, before = io.StringIO(), io.StringIO(), (sys.stdout, sys.stderr)
    sys.stdout, sys.stderr = out, err
    try:
        code = main.run(list(arguments))
    finally:
        sys.stdout, sys.stderr = before
    return code, out.getvalue(), err.getvalue()


@pytest.fixture
def stored(tmp_path: Path) -> str:
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(CLOSURE))
    return str(file)


# The messages' types


def test_the_field_lists_have_the_hashes_of_the_published_messages() -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    for name, lines in ros_bag.FIELDS.items():
        store.register(get_types_from_msg("\n".join(lines), name))
    assert {name: store.generate_msgdef(name)[1] for name in ros_bag.FIELDS} == MD5
    assert not any("#" in line for lines in ros_bag.FIELDS.values() for line in lines)


def rihs01(schema: str, root: str) -> str:
    """The type hash of ROS 2 (REP 2016), computed from the text of a schema alone."""
    numbers = {"int32": 6, "uint32": 7, "float32": 10, "float64": 11, "string": 17}
    types: dict[str, dict] = {}
    for k, part in enumerate(schema.split("=" * 80 + "\n")):
        head, _, body = part.partition("\n") if k else ("MSG: " + root.replace("/msg", ""), "", part)
        package, name = head.removeprefix("MSG: ").split("/")
        fields = []
        for line in filter(None, body.splitlines()):
            kind, field = line.split()
            base, many = kind.removesuffix("[]"), kind.endswith("[]")
            plain = base in numbers
            full = "" if plain else base.replace("/", "/msg/") if "/" in base else f"{package}/msg/{base}"
            number = (numbers[base] if plain else 1) + (144 if many else 0)
            kind_of = {"type_id": number, "capacity": 0, "string_capacity": 0, "nested_type_name": full}
            fields.append({"name": field, "type": kind_of})
        types[f"{package}/msg/{name}"] = {"type_name": f"{package}/msg/{name}", "fields": fields}
    whole = {
        "type_description": types.pop(root),
        "referenced_type_descriptions": [types[name] for name in sorted(types)],
    }
    return "RIHS01_" + hashlib.sha256(json.dumps(whole).encode()).hexdigest()


def test_the_bag_names_type_and_hash_of_the_message(tmp_path: Path) -> None:
    assert rihs01("string data\n", "std_msgs/msg/String") == STRING
    messages = messages_of(CLOSURE)
    ros_bag.write_mcap(tmp_path / "g.mcap", messages)
    ros_bag.write_bag(tmp_path / "g", messages)
    with (tmp_path / "g.mcap").open("rb") as stream:
        schema = next(iter(make_reader(stream).get_summary().schemas.values()))
    assert (schema.name, schema.encoding) == ("moveit_msgs/msg/Grasp", "ros2msg")
    metadata = YAML(typ="safe").load((tmp_path / "g" / "metadata.yaml").read_text())
    topic = metadata["rosbag2_bagfile_information"]["topics_with_message_count"][0]
    assert topic["message_count"] == len(messages)
    assert topic["topic_metadata"]["type"] == "moveit_msgs/msg/Grasp"
    assert topic["topic_metadata"]["type_description_hash"] == rihs01(schema.data.decode(), schema.name)


# Round trips


@both
def test_mcap_read_by_an_independent_decoder(document: dict, tmp_path: Path) -> None:
    messages = messages_of(document, mount=None, frame="mug_frame", touch_objects=("mug", "table"))
    ros_bag.write_mcap(tmp_path / "grasps.mcap", messages)
    with (tmp_path / "grasps.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        read = list(reader.iter_decoded_messages())
        assert [entry.name for entry in reader.iter_metadata()] == ["rosbag2"]
    assert len(read) == len(messages) > 1
    for (_, channel, _, grasp), message in zip(read, messages, strict=True):
        assert (channel.topic, channel.message_encoding) == ("/preshape/grasps", "cdr")
        assert "durability: 1" in channel.metadata["offered_qos_profiles"]
        leaves = same(grasp, message)
        assert leaves > 6 * len(document["hand"]["joints"])
    times = [record.log_time for _, _, record, _ in read]
    assert times == sorted(set(times))


@both
def test_bag_read_by_the_library_that_knows_nothing_of_us(document: dict, tmp_path: Path) -> None:
    messages = messages_of(document)
    ros_bag.write_bag(tmp_path / "grasps", messages)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["grasps"]
    assert sorted(p.name for p in (tmp_path / "grasps").iterdir()) == ["grasps.db3", "metadata.yaml"]
    with AnyReader([tmp_path / "grasps"]) as reader:  # takes the types from the bag
        read = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()]
    assert len(read) == len(messages)
    for grasp, message in zip(read, messages, strict=True):
        assert grasp.__msgtype__ == "moveit_msgs/msg/Grasp"
        same(grasp, message)
    with Reader(tmp_path / "grasps") as bag:
        raw = [bytes(data) for _, _, data in bag.messages()]
    assert raw == [ros_bag.serialised(message) for message in messages]
    assert all(data[:4] == b"\x00\x01\x00\x00" for data in raw)


def test_the_same_grasps_give_the_same_file(tmp_path: Path) -> None:
    messages = messages_of(CLOSURE)
    for folder in ("a", "b"):
        ros_bag.write_mcap(tmp_path / folder / "g.mcap", messages)
    assert (tmp_path / "a" / "g.mcap").read_bytes() == (tmp_path / "b" / "g.mcap").read_bytes()


def yaml_read(text: str) -> list:
    reader = YAML(typ="safe", pure=True)
    reader.version = (1, 1)  # as PyYAML, which ROS reads with
    return list(reader.load_all(text))


@both
def test_yaml_holds_the_same_messages(document: dict) -> None:
    messages = messages_of(document)
    assert yaml_read(messages_yaml(messages, "one line\nanother")) == messages


@pytest.mark.parametrize(
    "content",
    [
        1e-7, 1e22, -1e-300, 5e-324, 1e16, -0.0, 123456789.125, 0, -3,
        "", "no", "1e5", "a: b # c", 'quote " back \\ slash', "new\nline\ttab", "Töpfe 杯", "- x", "~",
    ],
)  # fmt: skip
def test_yaml_keeps_every_scalar(content: object) -> None:
    message = {
        "a": content,
        "b": {"c": [content, content]},
        "d": [{"e": content, "f": []}, {"e": 1, "f": [2]}],
    }
    (read,) = yaml_read(messages_yaml([message]))
    assert read == message
    assert type(read["a"]) is type(content)


# What the numbers mean


def placed(document: dict, message: dict, stage: str) -> tuple:
    """The hand's MJCF with its root at grasp_pose and the angles of the message, without code of preshape."""
    hand = load_hand(document["hand"]["name"])
    model = mujoco.MjModel.from_xml_string(hand.mjcf)
    at = message["grasp_pose"]["pose"]
    model.body_pos[1] = [at["position"][k] for k in "xyz"]
    model.body_quat[1] = [at["orientation"][k] for k in "wxyz"]
    data = mujoco.MjData(model)
    posture = message[stage]
    for name, angle in zip(posture["joint_names"], posture["points"][0]["positions"], strict=True):
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    return hand, model, data


def reach(model, data, point: np.ndarray, bodies: set[int]) -> float:
    """Distance of a point from the nearest round shape of some bodies [m]."""
    best = np.inf
    for geom in range(model.ngeom):
        if int(model.geom_bodyid[geom]) in bodies:
            half = model.geom_size[geom, 1] if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
            local = data.geom_xmat[geom].reshape(3, 3).T @ (point - data.geom_xpos[geom])
            local[2] -= np.clip(local[2], -half, half)
            best = min(best, float(np.linalg.norm(local)) - model.geom_size[geom, 0])
    return best


@both
def test_the_fingers_touch_the_contacts_when_the_root_stands_at_grasp_pose(document: dict) -> None:
    answers = [document, *document["alternatives"]]
    for answer, message in zip(answers, messages_of(document), strict=True):
        for stage, touching in (("grasp_posture", True), ("pre_grasp_posture", False)):
            hand, model, data = placed(answer, message, stage)
            for contact in answer["contacts"]:
                joints = hand.finger(contact["finger"]).joints
                bodies = {int(model.joint(name).bodyid[0]) for name in joints}
                off = reach(model, data, np.array(contact["point"]), bodies)
                assert abs(off) < 0.0012 if touching else off > 0.0002, (stage, contact["finger"], off)


def test_the_parent_link_may_be_any_link_that_stands_still_or_one_of_the_robot() -> None:
    def pose_of(message: dict) -> np.ndarray:
        at = message["grasp_pose"]["pose"]
        return spatial.pose_from_seven(
            [*(at["position"][k] for k in "xyz"), *(at["orientation"][k] for k in "wxyz")]
        )

    default = messages_of(CLOSURE)[0]
    _, model, data = placed(CLOSURE, default, "grasp_posture")
    palm = messages_of(CLOSURE, parent_link="rh_palm")[0]
    there = data.xpos[model.body("rh_palm").id], data.xmat[model.body("rh_palm").id].reshape(3, 3)
    np.testing.assert_allclose(pose_of(palm), spatial.pose(there[1], there[0]), atol=1e-12)
    np.testing.assert_allclose(
        pose_of(palm), spatial.pose_from_seven(CLOSURE["hand"]["grasp"]["palm_pose"]), atol=1e-12
    )
    assert messages_of(CLOSURE, parent_link="rh_wrist") == messages_of(CLOSURE)
    mount = [
        0.01,
        -0.02,
        0.3,
        *spatial.quaternion_from_rotation(spatial.rotation_from_vector([0.3, -0.2, 1.0])),
    ]
    flange = messages_of(CLOSURE, parent_link="flange", mount=mount)[0]
    np.testing.assert_allclose(pose_of(flange) @ spatial.pose_from_seven(mount), pose_of(default), atol=1e-12)
    with pytest.raises(InputError, match=r"rh_ffdistal moves .*: rh_wrist, rh_forearm, rh_palm"):
        messages_of(CLOSURE, parent_link="rh_ffdistal")
    with pytest.raises(InputError, match=r"no link 'rh_plam', only rh_wrist, rh_forearm, rh_palm; .*--mount"):
        messages_of(CLOSURE, parent_link="rh_plam")
    with pytest.raises(InputError, match="rh_palm is the hand's"):
        messages_of(CLOSURE, parent_link="rh_palm", mount=mount)


def test_efforts_are_the_servos_torques_within_the_limits() -> None:
    """Compared with MuJoCo: torques of the hand's drives at the squeeze's targets with fixed fingers."""
    hand = load_hand("shadow")
    message = messages_of(CLOSURE)[0]
    touch, press = message["grasp_posture"]["points"]
    q = {stage: np.array(CLOSURE["hand"][stage]["q"]) for stage in ("pregrasp", "grasp", "squeeze")}
    assert message["pre_grasp_posture"]["points"][0]["positions"] == q["pregrasp"].tolist()
    assert touch["positions"] == q["grasp"].tolist()
    assert press["positions"] == np.clip(q["squeeze"], *hand.limits.T).tolist()
    assert touch["effort"] == press["effort"]
    for squeeze in (q["squeeze"], q["grasp"] + np.where(np.arange(22) % 3, 2.0, -2.0)):
        document = copy.deepcopy(CLOSURE)
        document["hand"]["squeeze"]["q"] = squeeze.tolist()
        model = mujoco.MjModel.from_xml_string(hand.mjcf)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        data = mujoco.MjData(model)
        data.qpos[:], data.ctrl[:] = q["grasp"], hand.controls(squeeze)
        mujoco.mj_forward(model, data)
        efforts = np.array(messages_of(document)[0]["grasp_posture"]["points"][0]["effort"])
        np.testing.assert_allclose(efforts, data.qfrc_actuator, atol=1e-9)
        most = hand.torque_limits @ hand.command_matrix()
        assert (np.abs(efforts) <= most).all()
    assert (np.abs(efforts) == most).sum() > 10


def test_the_joints_order_of_the_plan_does_not_matter() -> None:
    turned = copy.deepcopy(CLOSURE)
    for answer in [turned, *turned["alternatives"]]:
        answer["hand"]["joints"].reverse()
        for stage in ("pregrasp", "grasp", "squeeze"):
            answer["hand"][stage]["q"].reverse()
    assert messages_of(turned) == messages_of(CLOSURE)


def test_the_contact_forces_worked_out_of_the_efforts_are_those_that_the_search_chose() -> None:
    document = copy.deepcopy(CLOSURE)
    answers = [document, *document["alternatives"]]
    grips = [answer.pop("grip") for answer in answers]
    said = messages_of(CLOSURE)
    for grasp, message, told, grip in zip(
        grasps_of(document), messages_of(document), said, grips, strict=True
    ):
        forces, chosen = contact_forces(grasp), np.array(grip["forces"])
        # Exact where three drives feel the contact; on the first phalanges only two do.
        np.testing.assert_allclose(forces, chosen, atol=0.1 * np.abs(chosen).max())
        hardest = int(np.linalg.norm(chosen, axis=1).argmax())
        np.testing.assert_allclose(forces[hardest], chosen[hardest], atol=1e-6)
        normal = np.einsum("ni,ni->n", grip["forces"], grasp.normals_in)
        assert normal.max() > 1.0
        assert told["max_contact_force"] == pytest.approx(normal.max(), rel=1e-12)
        assert message["max_contact_force"] == pytest.approx(normal.max(), abs=0.02)
        np.testing.assert_allclose(grasp.efforts, grip["torques"], atol=1e-9)


def test_approach_and_retreat() -> None:
    document = copy.deepcopy(CLOSURE)
    document["grip"]["approach"] = [0.6, 0.0, -0.8]
    message = messages_of(document, approach_distance=0.08, retreat_distance=0.2)[0]
    vectors = {
        key: (part["direction"]["header"]["frame_id"], *part["direction"]["vector"].values())
        for key, part in message.items()
        if key.endswith(("approach", "retreat"))
    }
    assert vectors == {
        "pre_grasp_approach": ("object", 0.6, 0.0, -0.8),
        "post_grasp_retreat": ("object", 0.0, 0.0, 1.0),
        "post_place_retreat": ("object", -0.6, 0.0, 0.8),
    }
    distances = [message[key][d] for key in vectors for d in ("desired_distance", "min_distance")]
    assert distances == [0.08, 0.04, 0.2, 0.1, 0.08, 0.04]
    document["grip"] = None  # a plan of the ray analyser: the plane's axis
    vector = messages_of(document)[0]["pre_grasp_approach"]["direction"]["vector"]
    assert list(vector.values()) == CLOSURE["approach_axis"]
    world = messages_of(document, up_frame="world")[0]["post_grasp_retreat"]["direction"]
    assert (world["header"]["frame_id"], world["vector"]) == ("world", {"x": 0.0, "y": 0.0, "z": 1.0})


@pytest.mark.parametrize(
    ("task", "up"),
    [
        ("lift:+x", "+x"),
        ("lift:-y", "-y"),
        ("pour:+x", "+z"),
        ("push:+z", "+x"),
        ("turn:-y", "+z"),
        ("custom", "+z"),
    ],
)
def test_the_lift_is_against_the_gravity_of_the_task(task: str, up: str) -> None:
    want = np.where(np.array(list("xyz")) == up[1], 1.0 if up[0] == "+" else -1.0, 0.0)
    first_version = copy.deepcopy(RAYS)
    first_version["task"]["name"] = task
    del first_version["schema"], first_version["scene"]
    older, document, rested = (copy.deepcopy(RAYS) for _ in range(3))
    del older["scene"]  # the request says the gravity, whatever the task is called
    older["request"]["gravity"] = (-want).tolist()
    document["scene"]["gravity"] = (-want).tolist()
    rested["scene"] |= {"table": [*want.tolist(), -0.1], "up": want.tolist()}  # the task's comes after it
    for each in (first_version, older, document, rested):
        vector = messages_of(each)[0]["post_grasp_retreat"]["direction"]["vector"]
        assert list(vector.values()) == want.tolist()


def test_quality_is_a_share_of_six() -> None:
    document = copy.deepcopy(RAYS)
    assert messages_of(document)[0]["grasp_quality"] == pytest.approx(RAYS["tfvadi"] / 6)
    for judged, share in ((0.0, 0.0), (3.0, 0.5), (6.0, 1.0)):
        graded = copy.deepcopy(CLOSURE)
        graded["grip"]["quality"] = judged
        assert messages_of(graded)[0]["grasp_quality"] == share


def test_names() -> None:
    first, second, *_ = messages_of(CLOSURE)
    assert first["id"] != second["id"] == "mug/lift:+z/shadow/1"
    assert first["allowed_touch_objects"] == ["mug"]
    assert messages_of(CLOSURE, touch_objects=("a", "b"))[0]["allowed_touch_objects"] == ["a", "b"]
    assert messages_of(CLOSURE, frame="m")[0]["grasp_pose"]["header"]["frame_id"] == "m"


# MuJoCo


@pytest.fixture(scope="module")
def prism() -> dict:
    return plan_to_json(plan("prism", "lift", hand="utah_mit", memory=":memory:", scale=1.2))


def test_the_scene_stands_as_the_plan_says_and_holds(prism: dict) -> None:
    (grasp,) = grasps_of(prism)
    found = find_object(prism)
    assert found.scale == pytest.approx(1.2)
    mesh = load_library_object("prism")
    mesh = type(mesh)(name="prism", vertices=1.2 * mesh.vertices, triangles=mesh.triangles)
    text = scene_mjcf(grasp, mesh, ConvexPieces(name="prism", pieces=(mesh.vertices,)))
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    kinematics = HandKinematics(grasp.hand)
    T = spatial.pose_from_seven(grasp.palm_pose)
    for key, q, told in (
        ("pregrasp", grasp.pregrasp, grasp.pregrasp),
        ("grasp", grasp.grasp, grasp.grasp),
        ("squeeze", grasp.grasp, grasp.squeeze),
    ):
        mujoco.mj_resetDataKeyframe(model, data, model.key(key).id)
        mujoco.mj_forward(model, data)
        kinematics.set_posture(q)
        tips, _ = kinematics.tips(grasp.hand.fingers)
        sites = [data.site(finger.tip_site).xpos for finger in grasp.hand.fingers]
        np.testing.assert_allclose(sites, spatial.transform_points(T, tips), atol=1e-9)
        np.testing.assert_allclose(data.ctrl, grasp.hand.controls(told), atol=0)
    for contact in prism["contacts"]:
        finger = grasp.hand.finger(contact["finger"])
        gap = np.linalg.norm(data.site(finger.tip_site).xpos - contact["point"]) - finger.tip_radius
        assert abs(gap) < 0.001
    shape = model.mesh("object")
    start, count = int(shape.vertadr[0]), int(shape.vertnum[0])
    corners = model.mesh_vert[start : start + count].astype(float)
    np.testing.assert_allclose(np.ptp(corners, axis=0).max(), max(prism["object"]["extents"]), rtol=1e-5)
    np.testing.assert_allclose(data.body("object").xpos, 0.0, atol=1e-12)
    assert prism["mass"] > 0.15
    assert model.body("object").mass[0] == pytest.approx(prism["mass"], rel=0.01)
    model.opt.gravity[2] = -9.81
    for _ in range(250):
        mujoco.mj_step(model, data)
    assert np.linalg.norm(data.body("object").xpos) < 0.01
    dropped = mujoco.MjData(model)  # without the squeeze it falls
    for _ in range(100):
        mujoco.mj_step(model, dropped)
    assert dropped.body("object").xpos[2] < -0.03


def test_the_scene_of_a_hand_with_coupled_joints() -> None:
    grasp = grasps_of(CLOSURE)[0]
    mesh = load_library_object("mug")
    text = scene_mjcf(grasp, mesh, ConvexPieces(name="mug", pieces=(mesh.vertices,)))
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("squeeze").id)
    mujoco.mj_forward(model, data)
    names = [model.joint(k).name for k in range(model.njnt)]
    assert names == [*CLOSURE["hand"]["joints"], "object"]
    palm = data.site(grasp.hand.palm_site)
    np.testing.assert_allclose(palm.xpos, grasp.palm_pose[:3], atol=1e-9)
    assert model.nu == len(grasp.hand.motors) < len(grasp.hand.joints)
    np.testing.assert_allclose(data.qfrc_actuator[:22], grasp.efforts, atol=1e-9)
    assert text.startswith("<!-- hand: ")


# Arrays


def test_npz_read_by_the_physics_and_by_plain_numpy(prism: dict, tmp_path: Path) -> None:
    file = tmp_path / "prism.json"
    file.write_text(json.dumps(prism))
    code, out, err = run("export", str(file), "--format", "npz", "--out", str(tmp_path / "g.npz"))
    assert (code, err) == (0, "")
    assert "1 grasp of prism with the hand utah_mit" in out
    read = read_grasps(tmp_path / "g.npz")
    own = physics_hand(load_hand("utah_mit"))
    want = read_grasp_file(file).grasps.for_hand(own)
    got = read.for_hand(own)
    assert (read.hand, read.frame, read.faults, got.objects) == ("utah_mit", "root", (), want.objects)
    for name in ("scale", "object_pose", "pregrasp", "grasp", "squeeze"):
        np.testing.assert_allclose(getattr(got, name), getattr(want, name), atol=1e-12)
    with np.load(tmp_path / "g.npz", allow_pickle=False) as plain:
        assert plain["object"].tolist() == ["prism"]
        assert plain["scale"] == pytest.approx(1.2)
        assert plain["joints"].tolist() == prism["hand"]["joints"]
        assert plain["squeeze"].shape == (1, 23)
        assert plain["squeeze"][0, 7:].tolist() == prism["hand"]["squeeze"]["q"]


def test_npz_has_every_answer_and_says_whose_root(tmp_path: Path) -> None:
    grasps = grasps_of(CLOSURE)
    write_grasps(tmp_path / "g.npz", grasp_set(grasps, find_object(CLOSURE)))
    read = read_grasps(tmp_path / "g.npz")
    hand = load_hand("shadow")
    assert len(read) == len(grasps) > 1
    for row, grasp in zip(read.grasp, grasps, strict=True):
        T = spatial.pose_from_seven(row[:7]) @ hand.T_root_palm
        np.testing.assert_allclose(T, spatial.pose_from_seven(grasp.palm_pose), atol=1e-12)


def test_an_object_that_is_not_here_is_said(tmp_path: Path) -> None:
    document = copy.deepcopy(RAYS)
    document["object"]["source"] = "elsewhere/vase.stl"
    with pytest.raises(ObjectError, match=r"elsewhere/vase.stl.*--objects"):
        find_object(document)


# The command


def test_all_three_at_once(stored: str, tmp_path: Path) -> None:
    files = [str(tmp_path / name) for name in ("g.yaml", "g.mcap", "bag")]
    code, out, err = run("export", stored, "--format", "moveit", *(x for f in files for x in ("--out", f)))
    assert (code, err) == (0, "")
    assert out.splitlines()[:3] == [f"wrote {file}" for file in files]
    assert "grasp_pose is rh_wrist in object, best quality 0.88" in out
    messages = messages_of(CLOSURE)
    text = (tmp_path / "g.yaml").read_text()
    assert yaml_read(text) == messages
    assert "# grasp_pose: rh_wrist in object" in text
    before = sorted((tmp_path / "bag").iterdir())
    code, _, err = run("export", stored, "--format", "moveit", "--out", files[2])
    assert code == 2
    assert "exists already" in err
    assert sorted((tmp_path / "bag").iterdir()) == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bag", "g.mcap", "g.yaml", "plan.json"]


def test_text_on_standard_output_and_json(stored: str) -> None:
    code, out, _ = run("export", stored, "--format", "moveit", "--answer", "1")
    assert code == 0
    assert [message["id"] for message in yaml_read(out)] == ["mug/lift:+z/shadow/1"]
    code, out, _ = run("export", stored, "--format", "moveit", "--json")
    document = json.loads(out)
    assert (code, document["answers"], document["parent_link"]) == (0, [0, 1, 2], "rh_wrist")
    assert document["grasps"] == messages_of(CLOSURE)


def test_a_plan_from_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(json.dumps(CLOSURE).encode())))
    assert read_plan("-") == CLOSURE


def test_mjcf_from_the_command(prism: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path / "cache"))
    file = tmp_path / "prism.json"
    file.write_text(json.dumps(prism))
    code, out, _ = run("export", str(file), "--format", "mjcf", "--out", str(tmp_path / "scene.xml"))
    assert code == 0
    assert f"wrote {tmp_path / 'scene.xml'}" in out
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert model.nkey == 3
    code, out, _ = run("export", str(file), "--format", "mjcf")
    assert out == (tmp_path / "scene.xml").read_text()


def loads_of(text: str) -> tuple[float, float]:
    """Mass and sliding friction of the object in a scene."""
    model = mujoco.MjModel.from_xml_string(text)
    pieces = [k for k in range(model.ngeom) if model.geom(k).name.startswith("object_piece")]
    return float(model.body("object").mass[0]), float(model.geom_friction[pieces[0], 0])


def test_the_scene_has_the_load_that_was_planned_for(
    prism: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path / "cache"))
    file = tmp_path / "plan.json"
    first_version = {key: part for key, part in prism.items() if key not in ("schema", "request", "mass")}
    slippery = {**prism, "mass": 0.25, "request": {**prism["request"], "friction": 0.5}}
    for document, options, load in (
        (prism, (), (prism["mass"], 0.6)),
        (first_version, (), (0.1, 0.6)),
        (slippery, (), (0.25, 0.5)),
        (slippery, ("--mass", "0.4", "--friction", "0.3"), (0.4, 0.3)),
    ):
        file.write_text(json.dumps(document))
        code, out, _ = run("export", str(file), "--format", "mjcf", *options)
        assert code == 0
        assert loads_of(out) == pytest.approx(load, rel=0.01)
    code, _, err = run("export", str(file), "--format", "mjcf", "--mass", "0")
    assert (code, "mass must be above 0" in err) == (2, True)


def test_the_best_grasp_of_a_plan_without_an_answer(tmp_path: Path) -> None:
    best = {**RAYS, "status": "deadlock", "executable": False, "alternatives": []}
    refused = {"status": "deadlock", "reason": "too weak", "plane": None, "alternatives": [], "best": best}
    file = tmp_path / "plan.json"
    file.write_text(json.dumps({**RAYS, **refused}))
    code, _, err = run("export", str(file), "--format", "moveit")
    assert code == 2
    assert "has no grasp (deadlock: too weak); --best takes the best grasp" in err
    code, out, _ = run("export", str(file), "--format", "moveit", "--best")
    assert code == 0
    (message,) = yaml_read(out)
    assert message["id"].endswith("/best")
    assert {**message, "id": ""} == {**messages_of(RAYS)[0], "id": ""}
    why = lacking({**RAYS, **refused})
    assert why.endswith("; too weak")  # after what the critic said of the grasp
    said = f"best grasp of a plan without an answer; executable: false; {why}"
    assert f"# {said}\n" in out
    assert "# grasp_quality: 0 to 1, a sixth of a grip's quality" in out
    report = json.loads(run("export", str(file), "--format", "moveit", "--best", "--json")[1])
    assert (report["best"], report["executable"], report["lacking"]) == (True, False, why)
    assert f"executable: false; {why}" in run("export", str(file), "--format", "moveit", "--best")[2]
    scene = run("export", str(file), "--format", "mjcf", "--best")[1]
    assert f"<!-- {said} -->" in scene
    file.write_text(json.dumps(RAYS))  # a plan with an answer is written as without the option
    assert yaml_read(run("export", str(file), "--format", "moveit", "--best")[1]) == messages_of(RAYS)


def test_what_is_left_out_is_said(tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    box = [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]
    for table, boxes, words in (
        ("auto", [], "left out, though planned with: the table\n"),
        (-0.1, [box, box], "left out, though planned with: the table and 2 boxes\n"),
        (None, [], ""),
    ):
        file.write_text(json.dumps({**RAYS, "request": {**RAYS["request"], "table": table, "avoid": boxes}}))
        assert run("export", str(file), "--format", "moveit")[2] == words


def test_a_hand_from_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The plan names the file of its hand, which could not be found by name."""
    for part in (ROOT / "examples" / "hands").glob("trident.*"):
        shutil.copy(part, tmp_path)
    made = plan(
        "box", "lift", hand=str(tmp_path / "trident.toml"), memory=":memory:", learn=False, table=None
    )
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(plan_to_json(made)))
    monkeypatch.chdir(ROOT)
    code, out, err = run("export", str(file), "--format", "moveit", "--json")
    assert (code, json.loads(out)["hand"]) == (0, "trident"), err


def unreached(document: dict, *which: int) -> dict:
    spoiled = copy.deepcopy(document)
    for k, answer in enumerate([spoiled, *spoiled["alternatives"]]):
        if k in which:
            hand = answer["hand"]
            hand |= {"status": "joint_limit", "reason": "thumb out of reach", "retracted": hand["pregrasp"]}
            hand |= dict.fromkeys(("pregrasp", "grasp", "squeeze"))
    return spoiled


def test_an_answer_without_a_posture_is_left_out_and_said(tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(unreached(CLOSURE, 0)))
    code, out, err = run("export", str(file), "--format", "moveit")
    assert code == 0
    assert [m["id"][-1] for m in yaml_read(out)] == ["1", "2"]
    assert err == "answer 0 is left out, its hand has no posture: thumb out of reach\n"


NOWHERE = {"status": "no_grasp", "reason": "no fingers find it", "plane": None, "alternatives": []}
BAD = {
    "no posture": (unreached(CLOSURE, 0, 1, 2), (), "none of its answers has a posture.*thumb out of reach"),
    "this answer": (unreached(CLOSURE, 1), ("--answer", "1"), "answer 1 has no posture"),
    "no such answer": (CLOSURE, ("--answer", "3"), "--answer must be 0 to 2"),
    "negative": (CLOSURE, ("--answer", "-1"), "--answer must be 0 to 2"),
    "no grasp": ({**CLOSURE, **NOWHERE}, (), "has no grasp .no_grasp: no fingers find it."),
    "error": ({"status": "error", "reason": "bad mesh"}, (), "no plan but an error: bad mesh"),
    "list": ([CLOSURE], (), "not one plan but a list"),
    "another document": ({"a": 1}, (), "is not a plan of this program"),
    "another hand": (CLOSURE, ("--hand", "allegro"), "planned for the joints .*--hand"),
    "no such hand": (CLOSURE, ("--hand", "shadwo"), "no hand 'shadwo'; did you mean shadow"),
    "frame": (CLOSURE, ("--frame", "/map"), "--frame needs a frame's name"),
    "no frame": (CLOSURE, ("--frame", ""), "--frame needs a frame's name"),
    "up": (CLOSURE, ("--up-frame", "a b"), "--up-frame needs a frame's name"),
    "distance": (CLOSURE, ("--approach-distance", "0"), "--approach-distance must be more than 0"),
    "nan": (CLOSURE, ("--retreat-distance", "nan"), "--retreat-distance must be more than 0"),
    "mount": (CLOSURE, ("--mount", "0 0 0"), "--mount must be 7 numbers"),
    "not unit": (CLOSURE, ("--parent-link", "x", "--mount", "0 0 0 2 0 0 0"), "unit quaternion"),
    "object": (CLOSURE, ("--object-name", ""), "--object-name needs a name"),
    "ending": (CLOSURE, ("--out", "g.json"), "the ending says what is written"),
    "no file": (CLOSURE, ("--out", " "), "--out needs a file"),
}  # fmt: skip


@pytest.mark.parametrize(("document", "options", "sentence"), BAD.values(), ids=BAD)
def test_bad_input_is_one_sentence(
    document: object, options: tuple[str, ...], sentence: str, tmp_path: Path
) -> None:
    import re

    file = tmp_path / "plan.json"
    file.write_text(json.dumps(document))
    code, out, err = run("export", str(file), "--format", "moveit", *options)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert re.search(sentence, err), err
    assert [p.name for p in tmp_path.iterdir()] == ["plan.json"]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda d: d["hand"]["grasp"]["q"].__setitem__(0, float("nan")), "grasp angles must be finite"),
        (lambda d: d["hand"]["grasp"]["q"].pop(), "grasp angles must be 22 numbers"),
        (lambda d: d["hand"]["grasp"]["palm_pose"].pop(), "palm pose must be 7 numbers"),
        (lambda d: d["hand"]["grasp"]["palm_pose"].__setitem__(3, 7.0), "quaternion must have length 1"),
        (lambda d: d["contacts"][0].pop("point"), "is not a plan of this program"),
        (lambda d: d["contacts"][0].__setitem__("finger", "sixth"), "has no finger 'sixth'"),
        (lambda d: d["grip"]["forces"].pop(), "contact forces must be"),
        (lambda d: d["grip"].__setitem__("quality", float("nan")), "quality must be finite"),
        (lambda d: d["grip"].__setitem__("approach", [0, 0]), "approach axis must be 3 numbers"),
        (lambda d: d["grip"].__setitem__("approach", [0.0, 0, 0]), r"approach axis .* length 1"),
    ],
)
def test_a_damaged_plan_is_refused(change, sentence: str) -> None:
    document = copy.deepcopy(CLOSURE)
    change(document)
    with pytest.raises(InputError, match=sentence):
        messages_of(document)


def test_files_that_cannot_be_read_or_written(tmp_path: Path, stored: str) -> None:
    assert run("export", str(tmp_path / "none.json"), "--format", "moveit")[0] == 3
    (tmp_path / "bad.json").write_bytes(b"\xff\xfe")
    assert run("export", str(tmp_path / "bad.json"), "--format", "moveit")[0] == 2
    (tmp_path / "text.json").write_text("hello")
    code, _, err = run("export", str(tmp_path / "text.json"), "--format", "moveit", "--json")
    assert (code, err) == (2, "")
    for name in ("g.yaml", "g.mcap", "g"):
        code, _, err = run("export", stored, "--format", "moveit", "--out", f"{stored}/{name}")
        assert code == 3, err
        assert "cannot write" in err
    code, _, err = run("export", stored, "--format", "npz")
    assert code == 2
    code, _, err = run("export", stored, "--format", "stl")
    assert (code, "moveit, trajectory, isaac, usd, mjcf, npz" in err) == (2, True)


def test_without_rosbags_the_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    ros_bag.typestore.cache_clear()
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(EnvironmentFailure, match=r"preshape\[ros\]"):
        ros_bag.typestore()
    monkeypatch.undo()
    assert ros_bag.GRASP in ros_bag.typestore().fielddefs


def test_a_bag_that_fails_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from rosbags.rosbag2 import Writer

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    messages = messages_of(RAYS)
    monkeypatch.setattr(Writer, "write", full)
    for write, name in ((ros_bag.write_bag, "bag"), (ros_bag.write_mcap, "g.mcap")):
        with pytest.raises(EnvironmentFailure, match="No space left"):
            write(tmp_path / name, messages)
    assert list(tmp_path.iterdir()) == []


def test_the_programs_in_the_manual_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stored: str, prism: dict
) -> None:
    blocks = [
        part.split("```")[0] for part in (ROOT / "docs" / "ros.md").read_text().split("```python\n")[1:]
    ]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path / "cache"))
    Path("prism.json").write_text(json.dumps(prism))
    assert run("export", stored, "--format", "moveit", "--out", "grasps.mcap")[0] == 0
    assert run("export", "prism.json", "--format", "mjcf", "--out", "scene.xml")[0] == 0
    said = {}
    for name in ("make_reader", "mj_step"):
        (code,) = (block for block in blocks if name in block)
        out, before = io.StringIO(), sys.stdout
        sys.stdout = out
        try:
            exec(compile(code, "ros.md", "exec"), {})  # noqa: S102
        finally:
            sys.stdout = before
        said[name] = out.getvalue()
    first = said["make_reader"].splitlines()[0]
    assert first.startswith(f"mug/lift:+z/shadow/0 {CLOSURE['grip']['quality'] / 6} object")
    assert np.linalg.norm([float(x) for x in said["mj_step"].strip("[] \n").split()]) < 0.01
    for block in blocks:
        compile(block, "ros.md", "exec")


# Names that no XML, YAML or terminal takes

HOSTILE = "pen\n# \t\0\x1b[2J\x9b\u202e\ud800\ufffe<&"
SHOWN = r"pen\n# \t\x00\x1b[2J\x9b\u202e\ud800\ufffe<&"


def test_a_hostile_name_is_shown_in_every_format(prism: dict, tmp_path: Path, capsys) -> None:
    document = copy.deepcopy(prism)
    document["object"]["name"] = document["task"]["name"] = HOSTILE
    (grasp,) = grasps_of(document)
    assert (grasp.object_name, grasp.task) == (SHOWN, SHOWN)
    file = tmp_path / "a\n\x1b.json"
    file.write_text(json.dumps(document))
    assert main.run(["export", str(file), "--format", "moveit"]) == 0
    said = capsys.readouterr()
    assert r"# from a\n\x1b.json by" in said.out
    (message,) = list(YAML(typ="safe").load_all(said.out))
    assert message["id"].startswith(f"{SHOWN}/{SHOWN}/")
    for ending in ("grasps.mcap", "bag"):
        assert main.run(["export", str(file), "--format", "moveit", "--out", str(tmp_path / ending)]) == 0
    said = capsys.readouterr()
    assert "\x1b" not in said.out + said.err
    assert not any(line.startswith("#") for line in said.out.splitlines())


def test_an_mjcf_scene_with_a_hostile_name_is_xml(prism: dict) -> None:
    (grasp,) = grasps_of(prism)
    mesh = load_library_object("prism")
    hostile = type(mesh)(
        name=HOSTILE.replace("\ud800", ""), vertices=1.2 * mesh.vertices, triangles=mesh.triangles
    )
    hand = replace(grasp.hand, credit="a---b -->\x1b", licence=HOSTILE)
    grasp = replace(grasp, hand=hand)
    text = scene_mjcf(grasp, hostile, ConvexPieces(name="prism", pieces=(hostile.vertices,)))
    tree = ElementTree.fromstring(text)
    assert tree.get("model", "").endswith(" at " + SHOWN.replace(r"\ud800", ""))
    assert text.startswith(r"<!-- hand: a-b ->\x1b; pen\n# \t\x00")


@pytest.mark.parametrize("name", ["a\x1b", "a\nb", "\u202e", "\udc9b"])
def test_frames_and_objects_to_touch_have_printable_names(name: str) -> None:
    for option in ({"frame": name}, {"up_frame": name}, {"touch_objects": (name,)}):
        with pytest.raises(InputError, match="in printable characters"):
            MoveItOptions(**option)
