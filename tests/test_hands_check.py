"""Hands that are not built in: reading them, and every fault that the check must find, made one by one."""

from __future__ import annotations

import json
import re
import sys
from copy import copy
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from preshape.closure.hand_tables import digest
from preshape.exceptions import EnvironmentFailure, HandError, PreshapeError, UnknownHand
from preshape.hands import load_hand
from preshape.hands.check import check_hand, inspect_hand
from preshape.hands.kinematics import HandKinematics
from preshape.hands.load import recorded_hand
from preshape.hands.mirror import mirrored

EXAMPLE = Path(__file__).parents[1] / "examples" / "hands" / "trident.toml"
TOML, URDF = EXAMPLE.read_text(encoding="utf-8"), EXAMPLE.with_suffix(".urdf").read_text(encoding="utf-8")


def write(folder: Path, toml: str = TOML, urdf: str = URDF) -> Path:
    (folder / "trident.urdf").write_text(urdf, encoding="utf-8")
    path = folder / "hand.toml"
    path.write_text(toml, encoding="utf-8")
    return path


def swap(text: str, *pairs: tuple[str, str], count: int = 1) -> str:
    for old, new in pairs:
        assert old in text, old
        text = text.replace(old, new, count)
    return text


# -- a hand that is not built in --------------------------------------------------------------------


def test_the_example_is_fit_for_use():
    assert check_hand(EXAMPLE) == []
    hand = load_hand(str(EXAMPLE))
    assert hand.name == "trident"
    assert hand.u == 0.05
    assert len(hand.joints) == len(hand.motors) == 9
    assert hand.limits.tolist() == [[-0.6, 0.6], [-0.5, 1.4], [0, 1.5]] * 3
    k = HandKinematics(hand)
    assert k.model.body_mass.sum() == pytest.approx(0.4 + 3 * 0.12, abs=1e-6)
    shapes = k.shapes()
    assert {shape.kind for shape in shapes} == {"box", "hull", "sphere"}
    assert [s.link for s in shapes if s.kind == "sphere"] == [
        "thumb_base",
        "thumb_tip",
        "index_base",
        "index_tip",
        "ring_base",
        "ring_tip",
    ]


def test_the_example_moves_as_its_urdf_says():
    hand = load_hand(EXAMPLE)
    k = HandKinematics(hand)
    q = np.array([0.2, 0.3, 0.4, -0.3, -0.2, 0.5, 0.4, 0.1, 1.2])
    k.set_posture(q)
    tips, axes = k.tips(hand.fingers)
    for i, (x, y, sign) in enumerate(((0, -0.05, -1), (0.025, 0.05, 1), (-0.025, 0.05, 1))):
        spread, one, two = q[3 * i], sign * q[3 * i + 1], sign * (q[3 * i + 1] + q[3 * i + 2])
        side, high = np.sin(spread), np.cos(spread)
        along = 0.005 + 0.05 * np.cos(one) + 0.036 * np.cos(two)
        expected = [x + side * along, y - 0.05 * np.sin(one) - 0.036 * np.sin(two), 0.005 + high * along]
        assert np.allclose(tips[i], expected, atol=1e-8)
        assert np.allclose(axes[i], [side * np.cos(two), -np.sin(two), high * np.cos(two)], atol=1e-8)


def test_a_left_example_is_the_mirror_image():
    right, left = load_hand(EXAMPLE), load_hand(f"{EXAMPLE}:left")
    a, b = HandKinematics(right), HandKinematics(left)
    for q in np.random.default_rng(0).uniform(right.limits[:, 0], right.limits[:, 1], (10, 9)):
        a.set_posture(q)
        b.set_posture(q)
        assert np.allclose(a.tips(right.fingers)[0] * [-1, 1, 1], b.tips(left.fingers)[0], atol=1e-9)
    assert np.allclose(a.model.body_inertia, b.model.body_inertia, rtol=1e-5)


@pytest.mark.parametrize(
    "name", ["shadow", "shadow:left", "shadow:right", "{file}", "{file}:left", "{file}:right"]
)
def test_the_source_of_a_hand_loads_it_again(name, monkeypatch, tmp_path):
    monkeypatch.chdir(EXAMPLE.parent)
    hand = load_hand(name.format(file=EXAMPLE.name))
    monkeypatch.chdir(tmp_path)  # an absolute path means the same file everywhere
    again = load_hand(copy(hand).source)
    assert (again.name, again.source, again.mjcf) == (hand.name, hand.source, hand.mjcf)
    assert mirrored(hand).side == load_hand(mirrored(hand).source).side
    assert digest(replace(hand, source="elsewhere.toml"), "tables") == digest(hand, "tables")


def test_the_hand_of_a_plan_is_found_by_its_source_and_in_older_files_by_its_name():
    assert recorded_hand({"name": "trident", "source": str(EXAMPLE)}).name == "trident"
    assert recorded_hand({"name": "leap"}) is load_hand("leap")
    with pytest.raises(UnknownHand):
        recorded_hand({"name": "trident"})


def test_a_side_of_a_hand_that_is_not_built_in_can_be_checked():
    assert check_hand(f"{EXAMPLE}:left") == []


def test_an_mjcf_with_meshes_degrees_fixed_joints_and_a_root(tmp_path):
    finger = (
        '<body name="{f}1" pos="{x} {y} 0"><joint name="{f}a" axis="{s} 0 0" range="-30 80"/>'
        '<geom type="mesh" mesh="wedge"/><body name="{f}2" pos="0 0 .05">'
        '<joint name="{f}b" axis="{s} 0 0" range="0 90"/>'
        '<geom type="ellipsoid" size=".008 .008 .02" pos="0 0 .02"/>'
        '<site name="{f}s" pos="0 0 .04"/></body></body>'
    )
    fingers = "".join(
        finger.format(f=f, x=x, y=y, s=s)
        for f, x, y, s in (("t", 0, -0.05, -1), ("i", 0.03, 0.05, 1), ("r", -0.03, 0.05, 1))
    )
    mjcf = (
        '<mujoco><compiler angle="degree"/><asset><mesh name="wedge" '
        'vertex="-.009 -.009 0 .009 -.009 0 .009 .009 0 '
        '-.009 .009 0 -.009 -.009 .05 .009 -.009 .05 .009 .009 .05 -.009 .009 .05"/></asset><worldbody>'
        '<body name="arm" pos="1 2 3" euler="10 20 30"><joint name="elbow" axis="0 1 0" range="-90 90"/>'
        '<geom size=".03"/><body name="hand" pos="0 0 .2" euler="0 40 0">'
        '<joint name="wrist" axis="0 0 1" range="-90 90"/>'
        '<geom type="box" size=".05 .07 .01" pos="0 0 -.02"/>'
        f'<geom type="cylinder" size=".05 .01" pos="0 0 -.03" contype="0" conaffinity="0"/>{fingers}'
        "</body></body></worldbody></mujoco>"
    )
    (tmp_path / "m.xml").write_text(mjcf, encoding="utf-8")
    head = TOML[: TOML.index("[[finger]]")]
    toml = swap(
        head,
        ('model = "trident.urdf"', 'model = "m.xml"\nroot = "hand"\ncouplings = [["ia", "ib"]]'),
        ('body = "palm"', 'body = "hand"'),
    )
    for name, letter in (("thumb", "t"), ("index", "i"), ("ring", "r")):
        toml += (
            f'[[finger]]\nname = "{name}"\njoints = ["{letter}a", "{letter}b"]\ntip_body = "{letter}2"\n'
            f'tip_site = "{letter}s"\ntip_radius = 0.009\nclosing = [[-0.4, 0.1], [0.75, 1.1]]\n'
        )
    path = tmp_path / "hand.toml"
    path.write_text(toml, encoding="utf-8")
    assert check_hand(path) == []
    hand = load_hand(path)
    assert hand.joints == ("ta", "tb", "ia", "ib", "ra", "rb")
    assert np.allclose(hand.limits[0], np.radians([-30, 80]))
    assert [motor.joints for motor in hand.motors] == [("ta",), ("tb",), ("ia", "ib"), ("ra",), ("rb",)]
    k = HandKinematics(hand)
    k.set_posture(np.zeros(6))
    assert np.allclose(
        k.tips(hand.fingers)[0], [[0, -0.05, 0.09], [0.03, 0.05, 0.09], [-0.03, 0.05, 0.09]], atol=1e-8
    )
    shapes = {shape.link: shape for shape in k.shapes()}
    assert [s.kind for s in shapes.values() if s.body == "hand"] == ["box"]  # what only shows is left out
    mesh = shapes["index_i1"]
    assert mesh.kind == "hull"  # 18 × 18 × 50 mm
    assert np.allclose(mesh.corners.min(axis=0), [0.021, 0.041, 0.0], atol=1e-6)
    assert np.allclose(mesh.corners.max(axis=0), [0.039, 0.059, 0.05], atol=1e-6)
    # A joint of the hand that no finger lists is fixed by name, not by chance.
    path.write_text(swap(toml, ('root = "hand"', 'root = "arm"')), encoding="utf-8")
    assert [f.code for f in check_hand(path)] == ["joint_left_out"]
    path.write_text(swap(toml, ('root = "hand"', 'root = "arm"\nfixed = { wrist = 0.5 }')), encoding="utf-8")
    assert check_hand(path) == []
    turned = load_hand(path)
    assert np.allclose(turned.T_root_palm[:3, 3], [0, 0, 0.2])
    k = HandKinematics(turned)
    k.set_posture(np.zeros(6))
    assert np.allclose(k.tips(turned.fingers)[0][1], [0.03, 0.05, 0.09], atol=1e-8)


def test_meshes_of_a_package_are_found(tmp_path):
    corners = np.array([[x, y, z] for x in (-0.009, 0.009) for y in (-0.009, 0.009) for z in (0.0, 0.05)])
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    faces += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    obj = "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "".join(
        f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces
    )
    (tmp_path / "urdf").mkdir()
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "link.obj").write_text(obj, encoding="utf-8")
    at = URDF.index('<link name="index_proximal">')
    cylinder = '<origin xyz="0 0 0.025"/>\n      <geometry><cylinder radius="0.009" length="0.05"/>'
    mesh = '<geometry><mesh filename="package://gripper/meshes/link.obj"/>'
    urdf = URDF[:at] + swap(URDF[at:], (cylinder, mesh))
    path = write(tmp_path / "urdf", urdf=urdf)
    assert check_hand(path) == []
    links = {shape.link: shape for shape in HandKinematics(load_hand(path)).shapes()}
    assert links["index_proximal"].kind == "hull"
    assert links["index_proximal"].hull.volume == pytest.approx(0.018 * 0.018 * 0.05, rel=1e-4)
    large = write(tmp_path / "urdf", urdf=swap(urdf, ('link.obj"', 'link.obj" scale="1000 1000 1000"')))
    (found,) = check_hand(large)
    assert found.code == "mesh_size"
    assert re.search(r"the link 'index_proximal' measures 18 × 18 × 50 m, .*millimetres", found.text)
    lost = write(tmp_path / "urdf", urdf=swap(urdf, ("link.obj", "other.obj")))
    with pytest.raises(HandError, match=r'other\.obj is not found in the package "gripper": .*ROS_'):
        check_hand(lost)


# -- faults -----------------------------------------------------------------------------------------

OPEN_CLOSED = "closing = [[0.0, -0.4, 0.1], [0.0, 0.75, 1.1]]"
LIMITS = '<limit lower="-0.5" upper="1.4" effort="1.5" velocity="3"/>'

MIDDLE = '<limit lower="0" upper="1.5" effort="1.5" velocity="3"/>'

SPREAD = '<limit lower="-0.6" upper="0.6" effort="1.5" velocity="3"/>'

DESCRIPTION_FAULTS = [
    # code, (old, new) …, words of the finding
    ("missing", [("u = 0.05 ", "# ")], "lacks 'u'"),
    ("missing", [("gain = 5.0", "")], r"\[actuators\] lacks 'gain'"),
    ("missing", [("tip_radius = 0.009", "")], "thumb lacks 'tip_radius'"),
    ("not_positive", [("u = 0.05 ", "u = 0.0 ")], "U must be a positive number of m, got 0.0"),
    ("not_positive", [("u = 0.05 ", "u = nan ")], "U must be a positive number"),
    ("not_positive", [("u = 0.05 ", "u = 50.0 ")], "another unit"),
    (
        "not_positive",
        [("gain = 5.0", "gain = -5.0")],
        r"actuators.gain must be a positive number of N m/rad, got -5.0",
    ),
    ("not_positive", [("torque_limit = 1.5", "torque_limit = 0")], "torque_limit must be a positive"),
    ("tip_radius", [("tip_radius = 0.009", "tip_radius = 9.0")], "9000 mm; a fingertip has 1 to 30 mm"),
    ("tip_radius", [("tip_radius = 0.009", "tip_radius = -0.009")], "must be a positive number of m"),
    (
        "joint_twice",
        [('"thumb_knuckle", "thumb_middle"', '"thumb_knuckle", "thumb_knuckle"')],
        "thumb_knuckle is listed",
    ),
    ("finger_twice", [('name = "index"', 'name = "ring"')], "the finger ring is listed twice"),
    (
        "unknown_body",
        [('tip_body = "ring_pad"', 'tip_body = "ring_pat"')],
        "no body 'ring_pat', .* for the ring's tip",
    ),
    (
        "unknown_body",
        [('body = "palm"', 'body = "plam"')],
        "no body 'plam', which the description names for the palm",
    ),
    ("unknown_site", [("tip_pos = [0.0, 0.0, 0.0]", 'tip_site = "end"')], "no site 'end'"),
    ("frame", [("tip_pos = [0.0, 0.0, 0.0]", "")], "thumb needs a tip_site, or tip_pos"),
    ("frame", [('points = "+z" ', 'points = "up" ')], "must be an axis"),
    ("frame", [('points = "+z" ', 'points = "+y" ')], "perpendicular"),
    ("unknown_joint", [('"ring_middle"]', '"ring_midle"]')], "no joint 'ring_midle'; it has thumb_spread"),
    (
        "joint_left_out",
        [('"ring_spread", ', "")],
        "'ring_spread' .* belongs to no",
    ),
    (
        "outside_limits",
        [(OPEN_CLOSED, "closing = [[0, -0.4, 0.1], [0, 1.75, 1.1]]")],
        "outside the limits of thumb_knuckle",
    ),
    ("closing", [(OPEN_CLOSED, "closing = [[0, -0.4, 0.1]]")], "two lists or more of 3 angles"),
    ("closing", [(OPEN_CLOSED, "closing = [[0, -0.4, 0.1], [0.5]]")], "two lists or more of 3"),
    ("actuators", [("gain = 5.0", "gain = 5.0\ngains = { elbow = 3.0 }")], "names elbow, which is no motor"),
    (
        "couplings",
        [("u = 0.05 ", 'couplings = [["thumb_knuckle", "elbow"]]\nu = 0.05 ')],
        "names elbow, which is no joint",
    ),
    ("side", [("u = 0.05 ", 'side = "both"\nu = 0.05 ')], "right or left, got 'both'"),
    ("name", [('name = "trident"', 'name = "shadow"')], "a built-in hand is called shadow"),
    (
        "preshape",
        [(OPEN_CLOSED, OPEN_CLOSED + "\npreshape = { thumb_knuckle = [-0.4, 0.0] }")],
        "but the closing path of",
    ),
]


@pytest.mark.parametrize(
    ("code", "changes", "said"), DESCRIPTION_FAULTS, ids=[f"{c}-{s[:24]}" for c, _, s in DESCRIPTION_FAULTS]
)
def test_a_fault_of_the_description_is_found(code, changes, said, tmp_path):
    toml = TOML
    if code == "joint_left_out":
        head, tail = toml.rsplit(OPEN_CLOSED, 1)
        tail = swap(tail, ("preshape = { ring_spread = [-0.3, 0.3] }", ""))
        toml = swap(head, changes[0]) + "closing = [[-0.4, 0.1], [0.75, 1.1]]" + tail
    else:
        toml = swap(toml, *changes)
    path = write(tmp_path, toml)
    found = check_hand(path)
    assert [finding.code for finding in found if finding.code == code], found
    assert any(re.search(said, finding.text) for finding in found), found
    # Exactly the fault that was made, but for what follows from it.
    follows = {"joint_twice": {"joint_left_out", "contradiction"}, "finger_twice": {"contradiction"}}
    follows["unknown_joint"] = {"joint_left_out"}
    assert {finding.code for finding in found} - {code} <= follows.get(code, set()), found
    if code != "preshape":
        with pytest.raises(HandError):
            load_hand(path)


MODEL_FAULTS = [
    (
        "limits_reversed",
        [(LIMITS, LIMITS.replace("-0.5", "2.5"))],
        "'thumb_knuckle' are in the wrong order: 2.5 to 1.4",
    ),
    (
        "limits_missing",
        [('type="revolute"', 'type="continuous"'), (SPREAD, "")],
        "'thumb_spread' has no limits",
    ),
    (
        "couplings",
        [(LIMITS, LIMITS + '<mimic joint="index_knuckle" multiplier="0.5"/>')],
        "the motor index_knuckle closes the thumb and also moves another finger",
    ),
    (
        "mimic",
        [
            (LIMITS, LIMITS + '<mimic joint="thumb_middle" multiplier="0.5"/>'),
            (MIDDLE, MIDDLE + '<mimic joint="thumb_knuckle" multiplier="0.5"/>'),
        ],
        "the joints thumb_knuckle, thumb_middle follow each other in a circle",
    ),
    ("not_a_hinge", [('type="revolute"', 'type="prismatic"')], "'thumb_spread' is no hinge"),
    ("mass_zero", [('<mass value="0.06"/>', '<mass value="0"/>')], "'thumb_proximal' has no mass"),
]


@pytest.mark.parametrize(("code", "changes", "said"), MODEL_FAULTS, ids=[fault[0] for fault in MODEL_FAULTS])
def test_a_fault_of_the_model_is_found(code, changes, said, tmp_path):
    if code == "mass_zero":
        at = URDF.index('<link name="thumb_proximal">')
        urdf = URDF[:at] + swap(
            URDF[at:],
            *changes,
            ('ixx="2e-05"', 'ixx="0"'),
            ('iyy="2e-05"', 'iyy="0"'),
            ('izz="2e-05"', 'izz="0"'),
        )
    else:
        urdf = swap(URDF, *changes)
    path = write(tmp_path, urdf=urdf)
    found = check_hand(path)
    assert [finding.code for finding in found] == [code], found
    assert said in found[0].text
    with pytest.raises(HandError, match="thumb"):
        load_hand(path)


@pytest.mark.parametrize("what", ["limits", "mass"])
def test_mjcf_faults_that_mujoco_would_refuse_are_named(what, tmp_path):
    finger = (
        '<body name="{f}1" pos="0 {y} 0"><joint name="{f}a" axis="{s} 0 0" range="{r}"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 .05" size=".009" {m}/></body>'
    )
    good = [{"f": "t", "y": -0.05, "s": -1}, {"f": "i", "y": 0.05, "s": 1}]
    text = "".join(
        finger.format(
            r="1.4 -.5" if what == "limits" and g["f"] == "i" else "-.5 1.4",
            m='mass="0"' if what == "mass" and g["f"] == "i" else "",
            **g,
        )
        for g in good
    )
    mjcf = (
        '<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom type="box" size=".05 .07 .01" '
        f'pos="0 0 -.02"/>{text}</body></worldbody></mujoco>'
    )
    (tmp_path / "m.xml").write_text(mjcf, encoding="utf-8")
    head = TOML[: TOML.index("[[finger]]")].replace("trident.urdf", "m.xml")
    for f, name in (("t", "thumb"), ("i", "index")):
        head += (
            f'[[finger]]\nname = "{name}"\njoints = ["{f}a"]\ntip_body = "{f}1"\ntip_pos = [0, 0, 0.05]\n'
            "tip_radius = 0.009\nclosing = [[-0.3], [0.7]]\n"
        )
    path = tmp_path / "hand.toml"
    path.write_text(head, encoding="utf-8")
    found = check_hand(path)
    assert [f.code for f in found] == [{"limits": "limits_reversed", "mass": "mass_zero"}[what]]
    assert {"limits": "'ia' are in the wrong order: 1.4 to -0.5", "mass": "'i1' has no mass"}[what] in found[
        0
    ].text


def test_a_closing_path_that_collides_with_itself(tmp_path):
    # The ring finger's knuckle stands where the index finger's does: they close into each other.
    urdf = swap(
        URDF, ('<origin xyz="-0.025 0.05 0.005"/>', '<origin xyz="-0.025 0.05 0.005" rpy="0 0 0.9"/>')
    )
    urdf = swap(urdf, ('<origin xyz="0.025 0.05 0.005"/>', '<origin xyz="0.025 0.05 0.005" rpy="0 0 -0.9"/>'))
    found = check_hand(write(tmp_path, urdf=urdf))
    assert [finding.code for finding in found] == ["closing_collides"]
    assert "on the closing path of the fingers the hand collides with itself at" in found[0].text
    assert "mm inside" in found[0].text


def test_an_open_hand_in_itself(tmp_path):
    # Knuckles close together and turned inwards: open, the fingers lean into each other.
    urdf = swap(
        URDF, ('<origin xyz="-0.025 0.05 0.005"/>', '<origin xyz="-0.012 0.05 0.005" rpy="0 0 -0.6"/>')
    )
    urdf = swap(urdf, ('<origin xyz="0.025 0.05 0.005"/>', '<origin xyz="0.012 0.05 0.005" rpy="0 0 0.6"/>'))
    found = check_hand(write(tmp_path, urdf=urdf))
    assert {finding.code for finding in found} == {"open_collides"}, found
    assert "two links of the open hand overlap" in found[0].text


def test_a_thumb_that_does_not_oppose(tmp_path):
    # The thumb stands beside the fingers and closes the same way.
    urdf = swap(URDF, ('<origin xyz="0 -0.05 0.005"/>', '<origin xyz="0.09 0.05 0.005"/>'))
    urdf = swap(urdf, ('<axis xyz="-1 0 0"/>', '<axis xyz="1 0 0"/>'), count=2)
    assert '"-1 0 0"' not in urdf
    found = check_hand(write(tmp_path, urdf=urdf))
    assert [finding.code for finding in found] == ["thumb_not_opposed"]
    assert "the thumb does not oppose" in found[0].text
    # The real thumb named second: a finger in its place does not oppose its neighbour.
    parts = TOML.split("[[finger]]")
    parts[1], parts[3] = parts[3], parts[1]
    codes = {finding.code for finding in check_hand(write(tmp_path, "[[finger]]".join(parts)))}
    assert codes & {"closes_outward", "thumb_not_opposed"}


def test_fingers_that_close_outward_or_not_at_all(tmp_path):
    found = check_hand(write(tmp_path, swap(TOML, ('faces = "-y"', 'faces = "+y"'))))
    assert {finding.code for finding in found} == {"closes_outward", "side"}
    still = TOML[::-1].replace(OPEN_CLOSED[::-1], "closing = [[0.0, 0.1, 0.1], [0.0, 0.1, 0.1]]"[::-1], 1)[
        ::-1
    ]
    found = check_hand(write(tmp_path, still))
    assert [finding.code for finding in found] == ["does_not_close"]
    assert "the ring's tip" in found[0].text


def test_a_hand_without_shapes(tmp_path):
    at, end = URDF.index("<collision>"), URDF.index("</collision>") + len("</collision>")
    found = check_hand(write(tmp_path, urdf=URDF[:at] + URDF[end:]))
    assert [finding.code for finding in found] == ["no_shape"]
    assert "the palm 'palm'" in found[0].text


def test_many_faults_are_all_listed(tmp_path):
    toml = swap(
        TOML, ("u = 0.05 ", "u = -1.0 "), ("tip_radius = 0.009", "tip_radius = 2.0"), ("ring_pad", "nothing")
    )
    urdf = swap(URDF, (LIMITS, LIMITS.replace("-0.5", "2.5")))
    found, hand = inspect_hand(write(tmp_path, toml, urdf))
    assert hand is None
    assert {finding.code for finding in found} == {
        "not_positive",
        "tip_radius",
        "unknown_body",
        "limits_reversed",
    }
    with pytest.raises(HandError, match=r"and 3 more: preshape hands check"):
        load_hand(tmp_path / "hand.toml")


@pytest.mark.parametrize(
    ("toml", "urdf", "said"),
    [
        ("name = ", URDF, "not valid TOML"),
        (TOML.replace('model = "trident.urdf"', ""), URDF, "lacks 'model'"),
        (TOML.replace("trident.urdf", "other.urdf"), URDF, "there is no model"),
        (TOML, URDF[:-20], "MuJoCo cannot read it"),
        (TOML, URDF.replace('<link name="ring_pad"/>', ""), "MuJoCo cannot read it"),
        (TOML, "", "MuJoCo cannot read it"),
    ],
)
def test_what_cannot_be_read_at_all_is_one_sentence(toml, urdf, said, tmp_path):
    path = write(tmp_path, toml, urdf)
    for attempt in (check_hand, load_hand):
        with pytest.raises(HandError, match=said) as caught:
            attempt(path)
        assert "\n" not in str(caught.value)


def test_files_that_are_no_hand(tmp_path):
    with pytest.raises(HandError, match="there is no file"):
        load_hand(tmp_path / "none.toml")
    with pytest.raises(HandError, match="there is no model"):
        load_hand("shadow_hand.urdf")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(HandError, match="is a folder"):
        load_hand(tmp_path / "folder.toml")


# -- Menagerie --------------------------------------------------------------------------------------


def test_menagerie_without_its_package_is_one_clear_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    with pytest.raises(EnvironmentFailure, match="pip install mujoco-menagerie"):
        load_hand("menagerie:shadow_hand")
    with pytest.raises(UnknownHand, match=r"did you mean menagerie:shadow_hand"):
        load_hand("menagerie:shadow")


def test_menagerie_without_a_network_is_one_clear_sentence(monkeypatch):
    class MenagerieError(Exception):
        pass

    class Package:
        @staticmethod
        def get(name):
            raise Package.MenagerieError("timed out")

    Package.MenagerieError = MenagerieError
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", Package)
    with pytest.raises(
        EnvironmentFailure, match=r"could not be fetched \(timed out\): the first use needs a network"
    ):
        load_hand("menagerie:leap_hand")


# -- command line -----------------------------------------------------------------------------------


def run(*arguments: str) -> tuple[int, str]:
    from preshape.cli.hands import hands

    result = CliRunner().invoke(hands, arguments, standalone_mode=False)
    if isinstance(result.exception, PreshapeError):
        return result.exception.exit_code, str(result.exception)
    if result.exception is not None and not isinstance(result.exception, (SystemExit, click.exceptions.Exit)):
        raise result.exception
    return int(result.return_value or 0), result.output


def test_the_list_names_every_hand_with_joints_u_and_licence(tmp_path):
    code, text = run("--json")
    rows = {row["name"]: row for row in json.loads(text)["hands"]}
    assert code == 0
    assert set(rows) == {"allegro", "leap", "shadow", "utah_mit"}
    assert rows["shadow"]["joints"] == 22
    assert rows["shadow"]["U"] == 0.045
    assert rows["allegro"]["fingertip_radius"] == 0.012
    assert all("Apache-2.0" in row["licence"] and row["source"] for row in rows.values())
    code, text = run()
    assert code == 0
    assert "22 joints, 18 motors" in text
    assert "origin 0 0 34 mm, axes +x +y +z of the root" in text


def test_check_draws_and_says_fit(tmp_path):
    from PIL import Image

    code, text = run("check", str(EXAMPLE), "--out", str(tmp_path / "new"))
    assert code == 0
    assert "fit for use" in text
    with Image.open(tmp_path / "new" / "trident.png") as picture:
        assert picture.size == (3 * 420, 420)
        pixels = np.asarray(picture).astype(int)
    # Three pictures that differ: open, half closed, closed.
    first, second, third = np.split(pixels, 3, axis=1)
    for one, other in ((first, second), (second, third), (first, third)):
        assert (np.abs(one - other).max(axis=2) > 30).mean() > 0.01


def test_check_counts_findings_in_its_exit_code(tmp_path):
    path = write(tmp_path, swap(TOML, ("gain = 5.0", "gain = 0.0")))
    code, text = run("check", str(path))
    assert code == 1
    assert "not_positive: actuators.gain must be a positive number" in text
    code, text = run("check", str(path), "--json", "--out", str(tmp_path))
    document = json.loads(text)
    assert code == 1
    assert (document["status"], document["picture"]) == ("findings", None)
    assert [finding["code"] for finding in document["findings"]] == ["not_positive"]
    assert run("check", str(tmp_path / "none.toml"))[0] == 2
    assert run("check", "shadw") == (
        2,
        "no hand 'shadw'; did you mean shadow? Known: allegro, leap, shadow, utah_mit "
        "(NAME:left for a left hand, or a TOML file of your own)",
    )
    assert json.loads(run("check", "leap:left", "--json")[1])["status"] == "fine"


# -- the page that tells people how -----------------------------------------------------------------

PAGE = (EXAMPLE.parents[2] / "docs" / "your-own-hand.md").read_text(encoding="utf-8")


def test_the_page_lists_every_finding():
    table = PAGE[PAGE.index("| finding |") : PAGE.index("## 3.")]
    listed = {
        code
        for row in table.splitlines()
        for code in re.findall(r"`(\w+)`", row.split("|")[1] if "|" in row else "")
    }
    tested = {fault[0] for fault in (*DESCRIPTION_FAULTS, *MODEL_FAULTS)}
    elsewhere = {
        "mesh_size",
        "fingers",
        "roots",
        "no_shape",
        "open_collides",
        "closing_collides",
        "does_not_close",
        # tests/test_hand_init.py
        "u",
        "finger_pitch",
        "torque",
        "tip_place",
        "tip_points",
        "palm_points",
        "holds_nothing",
        # tests/test_link_pieces.py
        "ignore",
    }
    assert listed == tested | elsewhere | {"closes_outward", "thumb_not_opposed", "contradiction"}


def test_the_pages_toml_is_the_examples():
    import tomllib

    block = tomllib.loads(PAGE.split("```toml\n")[1].split("```")[0])
    example = tomllib.loads(TOML)
    thumb, theirs = block.pop("finger")[0], example["finger"][0]
    assert {key: thumb[key] for key in theirs} == theirs
    assert {key: example[key] for key in block} == block


def test_the_pages_first_grasp_is_reached(monkeypatch, capsys):
    monkeypatch.chdir(EXAMPLE.parents[2])
    code = PAGE.split("```python\n")[1].split("```")[0]
    names: dict[str, object] = {}
    exec(compile(code, "your-own-hand.md", "exec"), names)  # noqa: S102
    assert names["answer"].hand_result.reached
    assert "every fingertip touches its contact" in capsys.readouterr().out


def test_too_few_fingers_and_too_many_roots(tmp_path):
    one = TOML[: TOML.index('[[finger]]\nname = "index"')]
    found = check_hand(write(tmp_path, one))
    assert found[0].code == "fingers"
    assert {finding.code for finding in found[1:]} == {"joint_left_out"}
    (tmp_path / "m.xml").write_text(
        '<mujoco><worldbody><body name="a"/><body name="b"/></worldbody></mujoco>', encoding="utf-8"
    )
    found = check_hand(write(tmp_path, swap(TOML, ("trident.urdf", "m.xml"))))
    assert "the model has 2 root bodies (a, b): name one as root" in [finding.text for finding in found]
