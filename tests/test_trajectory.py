"""Trajectories of the motors, and the drivers of hands."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from coupled_hands import coupled_hand
from preshape.exceptions import EnvironmentFailure, InputError
from preshape.export.drivers import DRIVERS, load_driver
from preshape.export.planned import PlannedGrasp
from preshape.export.trajectory import (
    DURATION,
    motor_trajectory,
    trajectory_arrays,
    trajectory_csv,
    trajectory_message,
)
from preshape.files import write_arrays
from preshape.hands import load_hand
from preshape.hands.hand import Hand
from test_export import STORED, run

OWN = """
name = "mine"
unit = "degrees"
[[channel]]
name = "F"
motor = "rh_FFJ3"
"""


def grasp_of(hand: Hand) -> PlannedGrasp:
    """A grasp whose fingers close to the middle of their path; the squeeze leads by 0.1 rad."""
    closed = hand.at(0.5)
    return PlannedGrasp(
        number=0,
        hand=hand,
        object_name="cube",
        task="lift:+z",
        mass=0.1,
        friction=0.6,
        up=np.array([0.0, 0, 1]),
        approach=np.array([0.0, 0, -1]),
        palm_pose=np.array([0.0, 0, 0, 1, 0, 0, 0]),
        pregrasp=hand.at(0.0),
        grasp=closed,
        squeeze=closed + 0.1,
        efforts=np.zeros(len(hand.joints)),
        points=np.zeros((0, 3)),
        normals_in=np.zeros((0, 3)),
        fingers=(),
        quality=0.5,
    )


@pytest.mark.parametrize("name", ["shadow", "allegro", "leap"])
def test_every_motor_of_the_hand_has_its_channel(name: str) -> None:
    hand = load_hand(name)
    grasp = grasp_of(hand)
    plain, driven = motor_trajectory(grasp), motor_trajectory(grasp, load_driver(name))
    assert plain.names == tuple(motor.name for motor in hand.motors)
    assert sorted(driven.positions[0]) == pytest.approx(
        sorted(plain.positions[0] + (math.pi if name == "leap" else 0.0)), abs=1e-5
    )
    assert driven.unit == "rad"
    assert plain.positions[1] == pytest.approx(hand.controls(grasp.grasp))
    assert plain.efforts == pytest.approx(grasp.motor_torques)


def test_the_numbers_of_leap_are_those_of_its_driver() -> None:
    hand = load_hand("leap")
    column = {motor.name: k for k, motor in enumerate(hand.motors)}
    trajectory = motor_trajectory(grasp_of(hand), load_driver("leap"))
    plain = motor_trajectory(grasp_of(hand))
    assert trajectory.names == tuple(str(k) for k in range(16))
    # The driver counts the side motion of a finger first, the model its flexion.
    order = ["if_rot", "if_mcp", "if_pip", "if_dip", "mf_rot", "mf_mcp", "mf_pip", "mf_dip"]
    order += ["rf_rot", "rf_mcp", "rf_pip", "rf_dip", "th_cmc", "th_axl", "th_mcp", "th_ipl"]
    wanted = plain.positions[:, [column[name] for name in order]] + math.pi
    assert trajectory.positions == pytest.approx(wanted, abs=1e-5)
    assert trajectory.cut == ()


def test_a_left_shadow_has_the_names_of_its_side() -> None:
    names = motor_trajectory(grasp_of(load_hand("shadow:left")), load_driver("shadow")).names
    assert {name[:2] for name in names} == {"lh"}
    assert "lh_FFJ0" in names


def test_the_inspire_hand_gets_whole_numbers_from_open_to_closed(reference: Path) -> None:
    hand = load_hand(reference / "hands" / "inspire" / "inspire_hand_right.urdf")
    low, high = hand.ranges().T
    grasp = replace(
        grasp_of(hand),
        pregrasp=hand.follow(low),
        grasp=hand.follow((low + high) / 2),
        squeeze=hand.follow(high),
    )
    trajectory = motor_trajectory(grasp, load_driver("inspire"))
    assert trajectory.names == tuple(f"ANGLE_SET({k})" for k in range(6))
    assert trajectory.positions.tolist() == [[1000] * 6, [500] * 6, [0] * 6, [0] * 6]
    _, positions, _ = trajectory.sampled()
    assert np.array_equal(positions, positions.round())


def test_a_command_beyond_the_drivers_limits_is_cut_and_named() -> None:
    hand = load_hand("leap")
    grasp = grasp_of(hand)
    k = hand.joints.index("if_rot")
    far = replace(grasp, squeeze=grasp.squeeze + 3.0 * (np.arange(len(hand.joints)) == k))
    trajectory = motor_trajectory(far, load_driver("leap"))
    assert trajectory.cut == ("0",)
    assert trajectory.positions[2, 0] == pytest.approx(1.047 + math.pi, abs=1e-3)


def test_stages_and_samples() -> None:
    hand = coupled_hand("tendon")
    grasp = grasp_of(hand)
    trajectory = motor_trajectory(grasp, duration=7.0)
    assert trajectory.times.tolist() == [0.0, 2.0, 3.0, 7.0]
    assert motor_trajectory(grasp).times[-1] == DURATION
    assert np.array_equal(trajectory.positions[2], trajectory.positions[3])
    times, positions, stages = trajectory.sampled()
    assert (np.diff(times) > 0).all()
    assert np.diff(times).max() < 0.0101
    for time, stage, q in zip(trajectory.times, trajectory.stages, trajectory.positions, strict=True):
        k = int(np.abs(times - time).argmin())
        assert (times[k], stages[k]) == (pytest.approx(time), stage)
        assert positions[k] == pytest.approx(q)
    middle = int(np.abs(times - 1.0).argmin())
    assert positions[middle] == pytest.approx(trajectory.positions[:2].mean(axis=0))
    assert stages[middle] == "touch"


def test_the_three_formats_say_the_same(tmp_path: Path) -> None:
    trajectory = motor_trajectory(grasp_of(load_hand("allegro")), load_driver("allegro"), 2.1234)
    message = trajectory_message(trajectory)
    seconds = [
        p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in message["points"]
    ]
    assert seconds == pytest.approx(trajectory.times.tolist(), abs=1e-9)
    assert [p["positions"] for p in message["points"]] == trajectory.positions.tolist()
    rows = list(csv.reader(io.StringIO(trajectory_csv(trajectory))))
    assert rows[0] == ["time", "stage", *trajectory.names]
    write_arrays(tmp_path / "t.npz", **trajectory_arrays(trajectory))
    with np.load(tmp_path / "t.npz", allow_pickle=False) as arrays:
        numbers = np.array([[float(x) for x in (row[0], *row[2:])] for row in rows[1:]])
        assert numbers[:, 0] == pytest.approx(arrays["times"], abs=1e-5)
        assert numbers[:, 1:] == pytest.approx(arrays["positions"], abs=1e-7)
        assert [row[1] for row in rows[1:]] == arrays["stages"].tolist()
        assert arrays["efforts"] == pytest.approx(trajectory.efforts)


def test_the_command_writes_them(tmp_path: Path) -> None:
    files = [str(tmp_path / f"t.{ending}") for ending in ("yaml", "csv", "npz")]
    outs = [word for file in files for word in ("--out", file)]
    code, out, _ = run(
        "export",
        str(STORED),
        "--format",
        "trajectory",
        "--driver",
        "shadow",
        "--duration",
        "7",
        "--json",
        *outs,
    )
    report = json.loads(out)
    assert (code, report["driver"], report["unit"], report["files"]) == (0, "shadow", "rad", files)
    assert report["stages"] == {"pregrasp": 0.0, "touch": 2.0, "squeeze": 3.0, "lift": 7.0}
    assert yaml.safe_load(Path(files[0]).read_text()) == report["trajectory"]
    assert len(Path(files[1]).read_text().splitlines()) == 702
    code, out, _ = run("export", str(STORED), "--format", "trajectory")
    assert code == 0
    assert yaml.safe_load(out)["joint_names"][0] == "rh_FFJ4"


@pytest.mark.parametrize("name", DRIVERS)
def test_each_driver_names_its_source_and_no_motor_twice(name: str) -> None:
    driver = load_driver(name)
    motors = [motor for channel in driver.channels for motor in channel.motors]
    assert driver.name == name
    assert driver.source
    assert len(set(motors)) == len(motors)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("channel = 3", r"needs \[\[channel\]\] tables"),
        ("colour = 1\n" + OWN, "has no key 'colour'; it has channel, name, source, unit, whole"),
        (OWN + "gain = 2", "has no key 'gain'; it has at_lower"),
        (OWN + 'offset = "a"', "offset must be a finite number, got 'a'"),
        (OWN + "at_lower = 1", "give at_lower and at_upper, or offset and factor"),
        (OWN + "at_lower = 1\nat_upper = 2\nfactor = 2", "give at_lower and at_upper, or offset and factor"),
        (OWN.replace('"rh_FFJ3"', "[]"), "motor must be the name of a motor"),
        (OWN.replace('unit = "degrees"', "whole = 3"), "whole must be true or false"),
        (OWN.replace('"degrees"', "3"), "unit must be text of one line, got 3"),
        ("name = ", "is no TOML"),
        (OWN, "leaves out the motor rh_FFJ4 of the hand shadow"),
        (OWN.replace("rh_FFJ3", "spread"), "needs one motor called spread, and the hand shadow has none"),
        (OWN.replace('"rh_FFJ3"', '["FFJ3", "MFJ3"]'), "the hand shadow has rh_FFJ3 and rh_MFJ3"),
        (OWN + "\n" + OWN[OWN.index("[[") :], "every motor needs one channel"),
    ],
)
def test_a_wrong_driver_is_refused_by_what_is_wrong(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    code, _, err = run("export", str(STORED), "--format", "trajectory", "--driver", str(path))
    assert code == 2
    with pytest.raises(InputError, match=said):
        motor_trajectory(grasp_of(load_hand("shadow")), load_driver(str(path)))
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--driver", "shadw"], 2, "no driver 'shadw'; known: leap, allegro, shadow, inspire"),
        (["--driver", "leap"], 2, "needs one motor called if_rot or 0"),
        (["--driver", "missing.toml"], 3, "missing.toml cannot be read"),
        (["--driver", "."], 2, "no driver '.'"),
        (["--duration", "0"], 2, "the duration must be"),
        (["--duration", "1e6"], 2, "the duration must be at most 600 s"),
        (["--out", "t.txt"], 2, "the ending says what is written"),
    ],
)
def test_a_wrong_option_is_one_sentence(options: list[str], code: int, said: str) -> None:
    found, _, err = run("export", str(STORED), "--format", "trajectory", *options)
    assert found == code
    assert said in " ".join(err.split())


def test_options_of_a_trajectory_are_refused_elsewhere() -> None:
    code, _, err = run("export", str(STORED), "--format", "moveit", "--driver", "leap")
    assert code == 2
    assert "--driver belongs to --format trajectory" in " ".join(err.split())


def test_a_driver_that_cannot_be_read_is_a_failure_of_the_environment(tmp_path: Path) -> None:
    with pytest.raises(EnvironmentFailure, match="cannot be read"):
        load_driver(str(tmp_path / "none.toml"))
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(InputError, match="this is a folder"):
        load_driver(str(tmp_path / "folder.toml"))
