"""A hand from its model alone: what is inferred, what is refused, and what the check then finds."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from model_hands import ROW, THUMB, FingerText, hand_urdf
from preshape.cli.commands import app
from preshape.exceptions import HandError
from preshape.hands import load_hand
from preshape.hands.check import check_hand, inspect_hand, opposition
from preshape.hands.compiled import read_model
from preshape.hands.description import direction
from preshape.hands.init import describe
from preshape.hands.kinematics import HandKinematics
from preshape.hands.load import describe_file, is_model, joined, read_description, recorded_hand, source_of
from preshape.hands.toml_text import toml_text
from preshape.hands.trial import trials


def save(folder: Path, text: str, name: str = "unknown.urdf") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def mirrored(finger: FingerText) -> FingerText:
    return replace(finger, xyz=(-finger.xyz[0], *finger.xyz[1:]))


def reversed_axes(finger: FingerText) -> FingerText:
    joints = [
        (" ".join(str(-int(x)) for x in axis.split()), -high, -low, length)
        for axis, low, high, length in finger.joints
    ]
    return replace(finger, joints=joints)


def ring(count: int, joints: list[tuple[str, float, float, float]]) -> list[FingerText]:
    """Equal fingers around a round palm, which point along +z and curl to the middle."""
    turns = [2 * np.pi * k / count for k in range(count)]
    return [
        FingerText(
            f"f{k}", (0.05 * np.cos(turn), 0.05 * np.sin(turn), 0.03), (0, 0, turn - np.pi / 2), joints
        )
        for k, turn in enumerate(turns)
    ]


@pytest.fixture
def runner(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> CliRunner:
    monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path / "cache"))
    return CliRunner()


# -- what is inferred -------------------------------------------------------------------------------

HANDS = {
    "plain": ((THUMB, *ROW), "0 0 0", "right"),
    "turned": ((THUMB, *ROW), "0.7 -1.1 2.2", "right"),
    "left": (tuple(map(mirrored, (THUMB, *ROW))), "0 0 0", "left"),
    "reversed": (tuple(map(reversed_axes, (THUMB, *ROW))), "0 0 3", "right"),
}


@pytest.mark.parametrize("name", HANDS)
def test_a_hand_without_telling_names_is_read_from_its_geometry(name: str, tmp_path: Path) -> None:
    fingers, mount, side = HANDS[name]
    path = save(tmp_path, hand_urdf(fingers, mount=mount))
    made = describe(read_model(path), path)
    data = made.data
    order = [entry["joints"][0][0] for entry in data["finger"]]
    # "c" is the finger beside the thumb, whichever side the hand is.
    assert order == ["b", "c", "a", "d"]
    assert [entry["name"] for entry in data["finger"]] == ["thumb", "index", "middle", "ring"]
    assert data["side"] == side
    assert data["u"] == pytest.approx(0.045, abs=1e-4)
    assert data["finger_pitch"] == pytest.approx(0.022, abs=1e-4)
    model = read_model(path).model
    import mujoco

    state = mujoco.MjData(model)
    mujoco.mj_kinematics(model, state)
    turn = state.xmat[model.body(data["palm"]["body"]).id].reshape(3, 3)
    plate = state.xmat[model.body("plate").id].reshape(3, 3)
    assert np.allclose(turn @ data["palm"]["points"], plate[:, 2], atol=0.05)
    assert np.allclose(turn @ data["palm"]["faces"], -plate[:, 1], atol=0.05)
    for entry in data["finger"]:
        assert entry["tip_body"] == f"l{entry['joints'][-1]}"
        assert np.allclose(entry["tip_points"], [0, 0, 1], atol=0.03)
        # The sphere touches the end of the last link, and is as thick as it.
        length = 0.03 if entry["name"] == "thumb" else 0.025
        assert entry["tip_pos"][2] + entry["tip_radius"] == pytest.approx(length - 0.002, abs=2e-3)
        assert entry["tip_radius"] == pytest.approx(0.006, abs=1e-4)
    assert len(made.lines) == 3


def test_the_inferred_hand_is_fit_and_the_toml_gives_the_same_one(runner: CliRunner, tmp_path: Path) -> None:
    model = save(tmp_path, hand_urdf(effort=None))
    toml = tmp_path / "mine" / "my.toml"
    made = runner.invoke(
        app, ["hands", "init", str(model), "--out", str(toml), "--json"], catch_exceptions=False
    )
    said = json.loads(made.stdout)
    assert said["status"] == "answer"
    assert len(said["guesses"]) == 3
    assert "guessed" in said["guesses"][2]
    assert Path(said["picture"]).stat().st_size > 1000
    assert check_hand(toml) == []
    assert check_hand(model) == []
    written, direct = load_hand(toml), load_hand(str(model))
    assert written.mjcf == direct.mjcf
    assert direct.source == str(model)
    assert np.array_equal(written.at(0.3), direct.at(0.3))
    assert float(opposition(direct, HandKinematics(direct)).max()) > 0.5
    assert all(trial.against for trial in trials(direct))
    again = runner.invoke(app, ["hands", "init", str(model), "--out", str(toml)])
    assert isinstance(again.exception, HandError)
    assert "exists already" in str(again.exception)


def test_the_text_of_a_description_says_all_of_it(tmp_path: Path) -> None:
    path = save(tmp_path, hand_urdf())
    data = describe(read_model(path), path).data
    data["couple"] = [{"law": "rigid", "motor": "a1", "follow": {"a2": [0.0, 1.5], 'odd "name"\n': 2.0}}]
    assert read_description(save(tmp_path, toml_text(data, ("one", "two")), "x.toml")) == data


def test_a_model_is_said_once_and_its_source_loads_it_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path / "cache"))
    path = save(tmp_path, hand_urdf())
    with caplog.at_level(logging.WARNING, logger="preshape.hands"):
        hand = load_hand(path)
        assert len(caplog.records) == 3
        left = load_hand(f"{path}:left")
        assert len(caplog.records) == 3
    assert left.side == "left"
    assert left.source == f"{path}:left"
    assert recorded_hand({"source": left.source}).mjcf == left.mjcf
    assert list((tmp_path / "cache" / "hands").glob("*.json"))
    # Damaged cached guesses are made again.
    for kept in (tmp_path / "cache" / "hands").glob("*.json"):
        kept.write_text('{"data": 3}')
    assert load_hand(path).mjcf == hand.mjcf
    monkeypatch.chdir(tmp_path)
    assert source_of("unknown.urdf#motors=m.toml:left") == f"{path}#motors={tmp_path / 'm.toml'}:left"
    assert joined("a.urdf:left", "m.toml") == "a.urdf#motors=m.toml:left"
    assert is_model("A.URDF")
    assert not is_model("menagerie:x.xml")


@pytest.mark.parametrize("count", [2, 3, 4])
def test_equal_fingers_around_a_palm_oppose_each_other(count: int, tmp_path: Path) -> None:
    joints = [("0 0 1", -0.8, 0.8, 0.01), ("1 0 0", -1.2, 1.2, 0.05), ("1 0 0", -1.5, 1.5, 0.04)]
    palm = '<cylinder radius="0.04" length="0.02"/>'
    path = save(tmp_path, hand_urdf(ring(count, joints), palm=palm))
    made = describe(read_model(path), path)
    assert "no thumb" in made.lines[0]
    assert np.allclose(made.data["palm"]["points"], [0, 0, 1], atol=1e-6)
    assert check_hand(path) == []


def test_fingers_that_point_outwards_face_where_they_close(tmp_path: Path) -> None:
    """As of a Barrett hand: at zero they lie flat around the palm, and close upwards."""
    joints = [("1 0 0", -2.4, 0.0, 0.07), ("1 0 0", -0.8, 0.0, 0.05)]
    around = [(0.0, -0.06, 0.0, 0.0), (0.025, 0.06, 0.0, np.pi), (-0.025, 0.06, 0.0, np.pi)]
    fingers = [
        FingerText(f"f{k}", (x, y, 0.06), (np.pi / 2, 0.0, yaw), joints)
        for k, (x, y, _, yaw) in enumerate(around)
    ]
    path = save(tmp_path, hand_urdf(fingers, palm='<cylinder radius="0.045" length="0.08"/>', effort=0))
    made = describe(read_model(path), path)
    assert made.data["finger"][0]["joints"][0] == "f00"
    assert np.allclose(made.data["palm"]["points"], [0, 0, 1], atol=1e-6)
    assert np.allclose(made.data["palm"]["faces"], [0, -1, 0], atol=1e-6)
    assert check_hand(path) == []


def robot(sides: str = "LR") -> str:
    """A robot with an arm of two joints and a hand on each side."""
    massive = (
        '<inertial><mass value="1"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    parts = ['<robot name="robot"><link name="base"/>']
    for side in sides:
        fingers = [replace(finger, name=f"{side}{finger.name}") for finger in (THUMB, *ROW)]
        text = hand_urdf(fingers if side == "R" else [mirrored(finger) for finger in fingers])
        text = text.removeprefix('<robot name="hand">').removesuffix("</robot>")
        for name in ("mount", "plate", "on"):
            text = text.replace(f'"{name}"', f'"{side}{name}"')
        text = text.replace(f'<link name="{side}mount"/>', f'<link name="{side}mount">{massive}</link>')
        limit = '<limit lower="-2" upper="2" effort="50" velocity="1"/>'
        parts += [
            f'<link name="{side}arm">{massive}</link>',
            f'<joint name="{side}1" type="revolute"><origin xyz="0 {0.3 if side == "L" else -0.3} 1"/>'
            f'<parent link="base"/><child link="{side}arm"/><axis xyz="0 1 0"/>{limit}</joint>',
            f'<joint name="{side}2" type="revolute"><origin xyz="0.3 0 0"/><parent link="{side}arm"/>'
            f'<child link="{side}mount"/><axis xyz="0 1 0"/>{limit}</joint>',
            text,
        ]
    return "".join([*parts, "</robot>"])


def test_of_a_whole_robot_the_hand_is_found_or_asked_for(tmp_path: Path) -> None:
    path = save(tmp_path, robot())
    source = read_model(path)
    with pytest.raises(
        HandError, match=r"2 parts of the model look like a hand; .*--root BODY.*Lmount, Rmount"
    ):
        describe(source, path)
    for root, side in (("Rmount", "right"), ("Lplate", "left")):
        made = describe(source, path, root=root)
        assert made.data["root"] == root
        assert made.data["side"] == side
    alone = save(tmp_path, robot("R"), "one.urdf")
    assert describe(read_model(alone), alone).data["root"] == "Rmount"
    assert check_hand(alone) == []
    with pytest.raises(HandError, match="there is no body 'x'"):
        describe(source, path, root="x")


def test_the_laws_of_the_file_are_kept_and_those_of_a_file_of_motors_are_used(
    tmp_path: Path,
) -> None:
    fingers = [replace(f, follows={len(f.joints) - 1: (len(f.joints) - 2, 0.8)}) for f in (THUMB, *ROW)]
    path = save(tmp_path, hand_urdf(fingers))
    hand = load_hand(path)
    assert len(hand.motors) == 11
    assert check_hand(path) == []
    free = save(tmp_path, hand_urdf(effort=0), "free.urdf")
    couples = [
        f'[[couple]]\nlaw = "rigid"\nmotor = "{f.name}1"\nfollow = {{ {f.name}2 = 1.0 }}\n'
        for f in (THUMB, *ROW)
    ]
    motors = save(tmp_path, "[actuators]\ntorque_limit = 0.7\n" + "\n".join(couples), "motors.toml")
    hand = load_hand(joined(free, motors))
    assert len(hand.motors) == 11
    assert set(hand.torque_limits.tolist()) == {0.7}
    assert load_hand(hand.source).mjcf == hand.mjcf
    toml, _, described = describe_file(str(free), motors=str(motors), out=str(tmp_path / "out.toml"))
    assert load_hand(toml).mjcf == described.mjcf
    assert len(described.motors) == 11
    with pytest.raises(HandError, match="a file of motors contains"):
        load_hand(joined(free, save(tmp_path, "u = 3", "wrong.toml")))
    with pytest.raises(HandError, match="--motors belongs to a model or a TOML file"):
        load_hand("shadow#motors=x.toml")


def test_a_continuous_joint_that_follows_another_gets_the_limits_of_its_law(tmp_path: Path) -> None:
    fingers = [replace(f, follows={len(f.joints) - 1: (len(f.joints) - 2, 0.8)}) for f in (THUMB, *ROW)]
    text = hand_urdf(fingers)
    follower = f"{ROW[0].name}{len(ROW[0].joints) - 1}"
    limited = f'<joint name="{follower}" type="revolute">'
    assert limited in text
    free = load_hand(save(tmp_path, text.replace(limited, limited.replace("revolute", "continuous"))))
    k = free.joints.index(follower)
    leader = free.limits[free.joints.index(f"{ROW[0].name}{len(ROW[0].joints) - 2}")]
    assert free.limits[k] == pytest.approx(0.8 * leader, abs=1e-6)
    assert len(free.motors) == 11


def test_a_long_thumb_does_not_hide_a_wrong_u(tmp_path: Path) -> None:
    axis, low, high, _ = THUMB.joints[0]
    thumb = replace(THUMB, joints=[(axis, low, high, 0.075), *THUMB.joints[1:]])
    path = save(tmp_path, hand_urdf([thumb, *ROW]))
    data = describe(read_model(path), path).data
    wrong = save(tmp_path, toml_text({**data, "u": 3 * data["u"]}), "wrong.toml")
    assert "u" in {finding.code for finding in check_hand(wrong)}
    right = save(tmp_path, toml_text(data), "right.toml")
    assert "u" not in {finding.code for finding in check_hand(right)}


# -- what is refused --------------------------------------------------------------------------------


def test_what_is_no_hand_is_refused_with_the_reason(tmp_path: Path) -> None:
    def refused(text: str) -> str:
        path = save(tmp_path, text)
        with pytest.raises(HandError) as error:
            describe(read_model(path), path)
        return str(error.value)

    jaws = ring(2, [("0 1 0", 0.0, 0.04, 0.05)])
    assert "its fingers slide (joints f00, f10)" in refused(hand_urdf(jaws, joint="prismatic"))
    assert "no part of the model looks like a hand" in refused(hand_urdf(ROW[:1]))
    both = hand_urdf().replace(
        '<axis xyz="1 0 0"/><limit lower="-0.2" upper="1.6" effort="1" velocity="5"/></joint>\n'
        '<link name="la2">',
        '<axis xyz="1 0 0"/><limit lower="-0.2" upper="1.6" effort="1" velocity="5"/>'
        '<mimic joint="c1"/></joint>\n<link name="la2">',
    )
    assert "the motor of 'c1' closes 2 fingers at once" in refused(both)


# -- what the check finds ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fit")
    path = save(folder, hand_urdf())
    save(folder, toml_text(describe(read_model(path), path).data), "fit.toml")
    return folder / "fit.toml"


WRONG = {
    "a tip that points backwards": (
        ("tip_points = [0.0, 0.0, 1.0]", "tip_points = [0.0, 0.0, -1.0]"),
        "tip_points",
    ),
    "a tip at the wrong side": (
        ("tip_points = [0.0, 0.0, 1.0]", "tip_points = [1.0, 0.0, 0.0]"),
        "tip_points",
    ),
    "a tip at the wrong end": (("tip_pos = [-0.0, 0.0, ", "tip_pos = [-0.0, 0.0, -"), "tip_place"),
    "tips 30 mm off": (("tip_pos = [0.0, 0.0, ", "tip_pos = [0.03, 0.0, "), "tip_place"),
    "the wrong side": (('side = "right"', 'side = "left"'), "side"),
    "U and pitch in another unit": (("u = 0.045", "u = 0.135"), "u"),
    "a pitch eight times too large": (("finger_pitch = 0.022", "finger_pitch = 0.176"), "finger_pitch"),
    "motors of 1 mN m": (("torque_limit = 1.0", "torque_limit = 0.001"), "torque"),
    "a palm upside down": (("points = [0.0, 0.0, 1.0]", "points = [0.0, 0.0, -1.0]"), "palm_points"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_consistent_but_wrong_is_a_finding(name: str, fit: Path, tmp_path: Path) -> None:
    (old, new), code = WRONG[name]
    text = fit.read_text()
    if old not in text:
        old, new = old.replace("[-0.0", "[0.0"), new.replace("[-0.0", "[0.0")
    assert old in text
    for file in fit.parent.glob("*.urdf"):
        save(tmp_path, file.read_text(), file.name)
    path = save(tmp_path, text.replace(old, new), "wrong.toml")
    assert code in {finding.code for finding in check_hand(path)}


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            'size="0.014 0.012 0.041"',
            'size="14 12 41"',
            r"the box of the link 'l\w1' measures 14 × 12 × 41 m",
        ),
        (
            'xyz="0 0 0.045"',
            'xyz="0 0 45"',
            "is 45 m from 'l.1', which carries it: is its place in millimetres",
        ),
    ],
)
def test_a_link_in_millimetres_is_named_with_its_size(old: str, new: str, text: str, tmp_path: Path) -> None:
    path = save(tmp_path, hand_urdf().replace(old, new, 1))
    with pytest.raises(HandError, match=text):
        load_hand(path)


def test_a_hand_whose_fingers_pass_the_object_holds_nothing(fit: Path, tmp_path: Path) -> None:
    """Thumb and fingers still move towards each other half closed, but only the last degree."""
    hand = load_hand(fit)
    assert [str(trial) for trial in trials(hand)] == [
        "cylinder of 60 mm: held by index, middle, ring, opposite the thumb",
        "cube of 60 mm: held by index, middle, ring, opposite the thumb",
    ]
    still = replace(
        hand,
        fingers=tuple(
            replace(finger, closing=finger.closing[0] + (finger.closing - finger.closing[0]) * 0.05)
            for finger in hand.fingers
        ),
    )
    assert not any(trial.against for trial in trials(still))


# -- hands that sell --------------------------------------------------------------------------------

BARRETT = """# The four motors of a Barrett hand: the spread, and one for each finger.
[actuators]
torque_limit = 1.2

[[couple]]
law = "rigid"
motor = "finger_1_prox_joint"
follow = { finger_2_prox_joint = -1.0 }
""" + "".join(
    f"""
[[couple]]
law = "adaptive"
motor = "finger_{k}"
sum = {{ finger_{k}_med_joint = -1.0, finger_{k}_dist_joint = -1.0 }}
free = [[0.0, 0.0], [-2.44, -0.785]]
locks = "finger_{k}_med_joint"
"""
    for k in (1, 2, 3)
)

SOLD = {
    "inspire/inspire_hand_right.urdf": (5, 6, "-y", "-x", "right"),
    "linker_l10/linkerhand_l10_right.urdf": (5, 10, "+z", "+x", "right"),
    "dex3/unitree_dex3_right.urdf": (3, 7, "-y", "-x", "right"),
    "barrett/bhand_model.urdf": (3, 4, "+z", "-y", "right"),
}
"""Numbers of fingers and motors, the axes along which fingers point and the palm faces, and the side."""


@pytest.mark.parametrize("name", SOLD)
def test_hands_that_sell_are_fit_without_an_edit(name: str, reference: Path, tmp_path: Path) -> None:
    fingers, motors, points, faces, side = SOLD[name]
    source: Path | str = reference / "hands" / name
    if name.startswith("barrett"):
        source = joined(source, save(tmp_path, BARRETT, "motors.toml"))
    found, hand = inspect_hand(source)
    assert found == []
    assert hand is not None
    assert (len(hand.fingers), len(hand.motors), hand.side) == (fingers, motors, side)
    assert np.allclose(hand.T_root_palm[:3, 2], direction(points, ""), atol=0.02)
    assert np.allclose(-hand.T_root_palm[:3, 1], direction(faces, ""), atol=0.02)
    assert all(trial.against for trial in trials(hand))
