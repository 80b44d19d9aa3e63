"""What every performance element shares: aims, explorations, and when two grasps are the same."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from preshape.exceptions import InputError
from preshape.hiis.analyser import (
    MAX_FINGERS,
    Aim,
    Exploration,
    Grasp,
    GraspContacts,
    Grip,
    VirtualGrasp,
    wrist_distance,
)
from preshape.hiis.planes import plane

CONTACTS = GraspContacts(
    points=np.array([[0.0, 0.02, 0.0], [0.0, -0.02, 0.0]]),
    normals_in=np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]),
    triangles=np.array([3, 4]),
    wrenches=np.zeros((2, 6)),
)
SHARED: dict[str, Any] = {
    "plane": plane(5),
    "flip": False,
    "approach_value": 0.25,
    "approach_set": 4,
    "fingers": 3,
    "contacts": CONTACTS,
    "net_wrench": np.zeros(6),
    "adi": np.full(6, 0.7),
    "tfvadi": 4.2,
    "stability": 0,
    "manipulability": 6,
}
VIRTUAL = VirtualGrasp(**SHARED, ray_origins=np.zeros((2, 3)))
GRIP = Grip(
    **SHARED,
    approach=np.array([1.0, 0.0, 0.0]),
    palm_pose=np.array([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0]),
    start=np.zeros(4),
    mask=5,
    pregrasp=np.zeros(4),
    grasp=np.ones(4),
    squeeze=np.ones(4),
    fingers_touching=("thumb", "index"),
    links=("th1", "ff1"),
    forces=np.array([[0.0, -6.0, 2.0], [0.0, 7.0, -2.0]]),
    torques=np.zeros(4),
    task_margin=1.25,
    hold_margin=2.5,
    quality=3.5,
    friction_share=0.35,
    clearance=0.004,
)


def turned(axis: Any, angle: float) -> Any:
    """(4,) quaternion wxyz of a rotation."""
    axis = np.asarray(axis, dtype=np.float64)
    return Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_quat(scalar_first=True)


# -- aims ------------------------------------------------------------------------------------------------


def test_an_aim_searches_everywhere_unless_told_otherwise() -> None:
    aim = Aim(values=[0.0])
    assert tuple(aim.planes) == tuple(range(1, 13))
    assert tuple(aim.fingers) == (2, 3, 4)
    assert set(aim.flips) == {False, True}
    assert tuple(aim.recall) == ()
    assert MAX_FINGERS == 4


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"planes": [1, 12]},
        {"fingers": [2, 4]},
        {"values": [-1.0, 1.0]},
        {"values": [1, 0, -1]},
        {"values": ()},
    ],
)
def test_an_aim_at_the_limits_is_accepted(changes: dict[str, Any]) -> None:
    Aim(**{"values": [0.0], **changes}).check()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"planes": [0, 5]}, r"1 to 12, got \[0, 5\]"),
        ({"planes": [5, 13]}, r"1 to 12, got \[5, 13\]"),
        ({"fingers": [1, 3]}, r"2 to 4, got \[1, 3\]"),
        ({"fingers": [3, 5]}, r"2 to 4, got \[3, 5\]"),
        ({"values": [0.0, 1.001]}, r"lie in -1\.\.1, got \[0\.0, 1\.001\]"),
        ({"values": [0.0, -1.001]}, r"lie in -1\.\.1, got"),
        ({"values": [0.0, np.nan]}, r"lie in -1\.\.1, got"),
    ],
)
def test_an_aim_that_does_not_exist_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Aim(**{"values": [0.0], **changes}).check()


# -- explorations ----------------------------------------------------------------------------------------


class Rows(Exploration):
    """An exploration of rows that were written by hand."""

    @property
    def summary(self) -> str:
        return f"{len(self)} of {self.tried}"

    def grasp(self, index: int = 0) -> Grasp:
        return replace(VIRTUAL, tfvadi=float(self.match[index]))


def rows(*each: tuple[int, bool, float, int, float]) -> Rows:
    """Plane, flip, value, fingers and match of each grasp."""
    planes, flips, values, fingers, matches = zip(*each, strict=True)
    return Rows(
        plane=np.array(planes), flip=np.array(flips), value=np.array(values), fingers=np.array(fingers),
        wrench=np.arange(6.0 * len(each)).reshape(-1, 6), match=np.array(matches), tried=9, reason="",
    )  # fmt: skip


BEST_FIRST = [
    (9, True, 0.9, 2, 5.0),  # the match decides first
    (9, True, 0.1, 2, 4.0),  # then the distance from the middle,
    (9, True, -0.2, 4, 4.0),  # on either side, then
    (9, True, 0.2, 3, 4.0),  # the number of fingers,
    (9, True, 0.2, 2, 4.0),
    (8, False, 0.3, 2, 4.0),
    (9, False, 0.3, 2, 4.0),  # the thumb's side, then
    (7, True, 0.3, 2, 4.0),  # the plane
    (8, True, 0.3, 2, 4.0),
    (1, False, 0.0, 4, 3.9),
]


def test_the_best_grasp_is_first_and_of_equal_ones_the_simpler() -> None:
    wanted = rows(*BEST_FIRST)
    for seed in range(20):
        found = wanted.where(np.random.default_rng(seed).permutation(len(wanted))).best_first()
        for name in ("plane", "flip", "value", "fingers", "match", "wrench"):
            assert np.array_equal(getattr(found, name), getattr(wanted, name)), name
        assert (found.tried, found.reason) == (9, "")


def test_rounding_does_not_decide_which_grasp_is_first() -> None:
    one, other = (1, False, 0.5, 3, 4.0), (2, False, 0.5, 3, 4.0)
    for noise in (3e-10, -3e-10):
        noisy = (*other[:4], 4.0 + noise), (2, False, 0.5 + noise, 3, 4.0)
        for second in noisy:
            assert rows(second, one).best_first().plane.tolist() == [1, 2]
    assert rows(one, (*other[:4], 4.0 + 3e-9)).best_first().plane.tolist() == [2, 1]
    assert rows(one, (2, False, 0.5 - 3e-9, 3, 4.0)).best_first().plane.tolist() == [2, 1]


def test_a_selection_keeps_rows_together_and_in_order() -> None:
    everything = rows(*BEST_FIRST)
    for keep in (np.array([4, 0, 7]), everything.match < 4.0, np.zeros(len(everything), dtype=bool)):
        found = everything.where(keep)
        assert len(found) == len(everything.match[keep])
        for name in ("plane", "flip", "value", "fingers", "match", "wrench"):
            assert np.array_equal(getattr(found, name), getattr(everything, name)[keep])
    assert everything.nearest_miss is None


# -- grasps ----------------------------------------------------------------------------------------------


def test_the_thumb_is_on_the_side_of_the_opposition_axis_unless_flipped() -> None:
    assert VIRTUAL.thumb_side.tolist() == [0.0, 1.0, 0.0]
    assert replace(VIRTUAL, flip=True).thumb_side.tolist() == [0.0, -1.0, 0.0]


def test_virtual_grasps_are_the_same_on_one_plane_thumb_side_and_number_of_fingers() -> None:
    assert VIRTUAL.same_as(replace(VIRTUAL, approach_value=-0.9, tfvadi=1.0))
    for change in ({"plane": plane(9)}, {"flip": True}, {"fingers": 2}):
        assert not VIRTUAL.same_as(replace(VIRTUAL, **change)), change


def test_grips_are_the_same_where_the_wrists_are_near() -> None:
    def at(place: Any, turn: Any) -> Grip:
        return replace(GRIP, palm_pose=np.concatenate([place, turn]))

    upright = turned([0, 0, 1], 0.0)
    for axis in np.eye(3):
        assert at(0 * axis, upright).same_as(at(0.019 * axis, upright))
        assert not at(0 * axis, upright).same_as(at(0.021 * axis, upright))
        assert at(axis, turned(axis, 0.34)).same_as(at(axis, upright))
        assert at(axis, -turned(axis, 0.34)).same_as(at(axis, upright))
        assert not at(axis, turned(axis, 0.36)).same_as(at(axis, upright))
        assert not at(0 * axis, turned(axis, 0.2)).same_as(at(0.011 * axis, upright))
    assert not at([0, 0, 0], upright).same_as(at([0.02, 0, 0], upright))  # exactly 1 apart
    assert not GRIP.same_as(VIRTUAL)


def test_the_distance_of_wrists_adds_twenty_millimetres_and_a_third_of_a_radian() -> None:
    rng = np.random.default_rng(5)
    places, angles = rng.uniform(-0.2, 0.2, (30, 3)), rng.uniform(0.05, 3.1, 30)
    base = turned([1, 2, 3], 0.8)
    axes = rng.normal(size=(30, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    turns = Rotation.from_rotvec(angles[:, None] * axes) * Rotation.from_quat(base, scalar_first=True)
    place = np.array([0.01, -0.02, 0.03])
    found = wrist_distance(places, turns.as_quat(scalar_first=True), place, base)
    assert found.shape == (30,)
    assert found == pytest.approx(np.linalg.norm(places - place, axis=1) / 0.02 + angles / 0.35)
    # A product of unit quaternions may be a little over 1.
    assert float(wrist_distance(place, base * (1 + 1e-15), place, base)) == pytest.approx(0.0, abs=1e-6)


def test_grasps_describe_themselves_with_what_the_critic_judges() -> None:
    assert (VIRTUAL.judged, VIRTUAL.score_text) == (4.2, "TFVADI 4.20")
    assert VIRTUAL.description == "plane 5: approach +X, opposition Y, 3 fingers, TFVADI 4.20"
    assert (GRIP.judged, GRIP.score_text) == (3.5, "quality 3.5")
    assert GRIP.press == 13.0
    assert GRIP.description == (
        "plane 5: approach +X, opposition Y, 2 fingers: squeezing with 13 N it balances 1.2 times the task's "
        "load, 2.5 times the pushes expected"
    )
