"""The task test's motion and load, against their definition."""

from __future__ import annotations

import math

import numpy as np
import pytest

from preshape.exceptions import TaskError
from preshape.physics.task.motion import TaskMotion, ease, task_motion
from preshape.spatial import (
    pose,
    rotation_from_vector,
    screw_from_displacement,
    transform_points,
    vector_from_rotation,
)
from preshape.tasks import FAMILIES, all_named_tasks, named_task, task_from_displacement, task_from_numbers

COG = np.array([0.4, -0.1, 0.25])
HALF = 0.06
MASS = 0.3
named = pytest.mark.parametrize("name", list(FAMILIES))


def motion_of(name: str) -> TaskMotion:
    return task_motion(named_task(name), COG, HALF)


def rates(motion: TaskMotion, f: float) -> tuple[np.ndarray, np.ndarray]:
    """Velocity of the COG and angular velocity by central differences of the path."""
    h = 1e-5
    before, after = motion.path(f - h), motion.path(f + h)
    v = (transform_points(after, COG) - transform_points(before, COG)) / (2 * h)
    return v, vector_from_rotation(after[:3, :3] @ before[:3, :3].T) / (2 * h)


@pytest.mark.parametrize("task", all_named_tasks(), ids=lambda t: t.label)
def test_how_far(task) -> None:
    motion = task_motion(task, COG, HALF)
    assert motion.path(0.0) == pytest.approx(np.eye(4), abs=1e-14)
    end = motion.path(1.0)
    moved = transform_points(end, COG) - COG
    turned = vector_from_rotation(end[:3, :3])
    for amounts, q, absent, largest in (
        (moved, task.q[:3], 0.1, 0.1),
        (turned, task.q[3:], 0.05, math.pi / 4),
    ):
        present = np.where(np.abs(q) > absent, q, 0.0)
        expected = present / np.abs(present).max() * largest if present.any() else np.zeros(3)
        assert amounts == pytest.approx(expected, abs=1e-12)


@named
def test_one_screw_all_the_way(name: str) -> None:
    """Each part of the path has the axis and pitch of the whole displacement, about the COG."""
    motion = motion_of(name)
    whole = screw_from_displacement(motion.displacement)
    for f in (0.2, 0.55, 0.9):
        path = motion.path(f)
        about = pose(path[:3, :3], transform_points(path, COG) - COG)
        part = screw_from_displacement(about)
        assert part.kind is whole.kind
        assert part.direction == pytest.approx(whole.direction, abs=1e-9)
        assert part.point == pytest.approx(whole.point, abs=1e-9)
        assert part.angle == pytest.approx(f * whole.angle, abs=1e-9)
        assert part.translation == pytest.approx(f * whole.translation, abs=1e-9)


def test_pitch_as_demanded() -> None:
    """Screw in along -z: 0.1 m in 45°; unscrew: the same screw backwards."""
    into = screw_from_displacement(motion_of("screw").displacement)
    assert into.direction == pytest.approx([0, 0, -1])
    assert into.pitch == pytest.approx(0.1 / (math.pi / 4))
    out = screw_from_displacement(motion_of("unscrew").displacement)
    assert out.direction == pytest.approx([0, 0, 1])
    assert out.pitch == pytest.approx(into.pitch)


def test_lever_is_an_arc_round_a_fulcrum_on_the_u_side() -> None:
    motion = motion_of("lever")  # about +y, travels along +z: the COG stays on a circle
    screw = screw_from_displacement(motion.displacement)
    assert screw.translation == pytest.approx(0.0, abs=1e-12)
    radius = 0.05 / math.sin(math.pi / 8)
    for f in np.linspace(0, 1, 7):
        away = transform_points(motion.path(f), COG) - COG - screw.point
        assert np.linalg.norm(away) == pytest.approx(radius)
    assert screw.point[0] == pytest.approx(0.1 / (2 * math.tan(math.pi / 8)))


@named
def test_velocity_is_the_path_s(name: str) -> None:
    motion = motion_of(name)
    for f in (0.1, 0.5, 0.95):
        v, w = rates(motion, f)
        assert motion.velocity(f) == pytest.approx(np.concatenate([v, w]), abs=1e-8)
    many = motion.velocity(np.linspace(0, 1, 5))
    assert many.shape == (5, 6)
    assert many[2] == pytest.approx(motion.velocity(0.5), abs=1e-15)


@named
def test_the_load_opposes_the_motion_at_each_instant(name: str) -> None:
    motion = motion_of(name)
    assert motion.translates or motion.rotates
    for f in np.linspace(0.0, 1.0, 11):
        v, w = rates(motion, f)
        force, torque = np.split(motion.load(f, MASS), 2)
        assert np.linalg.norm(force) == pytest.approx(9.8 * MASS if motion.translates else 0.0)
        assert np.linalg.norm(torque) == pytest.approx(9.8 * MASS * HALF / 2 if motion.rotates else 0.0)
        # Straight against: the power is as negative as a force and a torque of that size can make it.
        assert force @ v == pytest.approx(-np.linalg.norm(force) * np.linalg.norm(v), abs=1e-9)
        assert torque @ w == pytest.approx(-np.linalg.norm(torque) * np.linalg.norm(w), abs=1e-9)
        assert force @ v + torque @ w < -1e-3


@named
def test_the_load_is_constant_for_who_rides_along(name: str) -> None:
    motion = motion_of(name)
    first = motion.load(0.0, MASS)
    for f in (0.3, 1.0):
        R = motion.path(f)[:3, :3]
        load = motion.load(f, MASS)
        assert np.concatenate([R.T @ load[:3], R.T @ load[3:]]) == pytest.approx(first, abs=1e-12)


def test_how_strongly_a_motion_is_present_does_not_grade_the_load() -> None:
    weak, strong = (
        task_motion(task_from_numbers(f"{t} 0 0 {r} 0 0"), COG, HALF) for t, r in ((0.3, 0.2), (2, 1))
    )
    assert np.array_equal(weak.displacement, strong.displacement)
    assert np.array_equal(weak.load(0.4, MASS), strong.load(0.4, MASS))
    both = task_motion(task_from_numbers("0.5 -1 0.1 0.05 0 0"), COG, HALF)
    assert both.displacement[:3, 3] == pytest.approx([0.05, -0.1, 0.0])
    assert not both.rotates


def test_no_motion_is_refused() -> None:
    with pytest.raises(TaskError, match="no motion"):
        task_motion(task_from_numbers(".1 .1 -.1 .05 .05 -.05"), COG, HALF)


def test_a_kept_displacement_keeps_its_screw() -> None:
    given = pose(rotation_from_vector([0.0, 0.0, 1.0]), [0.0, 0.0, 0.02])
    motion = task_motion(task_from_displacement(given), COG, HALF)
    assert screw_from_displacement(motion.displacement).pitch == pytest.approx(0.02)
    assert vector_from_rotation(motion.displacement[:3, :3]) == pytest.approx([0, 0, math.pi / 4])


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("lift", None, [0, 0, -1]),
        ("lift:+x", None, [-1, 0, 0]),
        ("pour:+z", None, [-1, 0, 0]),
        ("lift", [0, 3, 4], [0, 0.6, 0.8]),
        ("lift", [0, 0, 0], [0, 0, 0]),
    ],
)
def test_gravity(name: str, given, expected) -> None:
    motion = task_motion(named_task(name), COG, HALF, gravity=given)
    assert motion.gravity == pytest.approx(expected)
    assert motion.weight(MASS) == pytest.approx(9.8 * MASS * np.array(expected))


def test_ease_starts_and_stops_gently() -> None:
    s = np.linspace(0, 1, 1001)
    f = ease(s)
    assert (f[0], f[500], f[-1]) == (0.0, pytest.approx(0.5), pytest.approx(1.0))
    speed = np.diff(f) / np.diff(s)
    assert (speed > 0).all()
    assert max(speed[0], speed[-1]) < 1e-4
    assert speed.max() == pytest.approx(1.875, rel=1e-4)
    assert np.abs(np.diff(speed)[[0, -1]]).max() < 1e-4  # and without a jolt
    assert ease([-1.0, 2.0]).tolist() == [0.0, 1.0]
