"""Tasks: stored displacements, derived Q, named families, and the message for each wrong task."""

import json
import pickle
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from preshape import tasks
from preshape.exceptions import TaskError, UnknownTask
from preshape.spatial import (
    along_screw,
    pose,
    quaternion_from_rotation,
    rotation_from_vector,
    screw_from_displacement,
    vector_from_rotation,
)
from preshape.tasks import Primitive

Q1 = [1, 1, 0.1, 0.05, 0.8, 0.05]
Q2 = [1, 1, 0.1, 0.8, 0.05, 0.05]


def check(*strategies):
    """A property over the same examples every time, however slow the machine."""
    return lambda test: settings(derandomize=True, deadline=None, max_examples=60)(given(*strategies)(test))


numbers = st.floats(-2, 2, allow_subnormal=False)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
directions = vectors.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))
angles = st.one_of(
    st.floats(0, np.pi),
    st.integers(-17, 0).map(lambda n: 10.0**n),
    st.integers(-17, 0).map(lambda n: np.pi - 10.0**n),
    st.sampled_from([0.0, np.pi]),
)
rotations = st.builds(lambda d, a: rotation_from_vector(d * a), directions, angles)
translations = st.one_of(vectors, st.just(np.zeros(3)), vectors.map(lambda v: v * 1e-9))
poses = st.builds(pose, rotations, translations)
right_angles = st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi, np.pi / 2 - 1e-9, np.pi / 2 + 1e-15])


# --- numbers -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "given_as",
    [
        "1 1 .1 .05 .8 .05",
        "1,1,.1,.05,.8,.05",
        " 1, 1, .1\t.05  .8,.05\n",
        Q1,
        tuple(Q1),
        np.array(Q1),
        ["1", "1", ".1", ".05", ".8", ".05"],
    ],
)
def test_six_numbers(given_as):
    task = tasks.task_from_numbers(given_as)
    assert task.q.tolist() == Q1
    assert task.q.dtype == np.float64
    assert not task.q.flags.writeable
    assert (task.name, task.label, task.axis, task.displacement) == ("custom", "custom", "", None)
    assert task.gravity.tolist() == [0, 0, -1]
    assert task.describe() == "along +X +Y, turning about +Y"


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ("1 2 3", "a task is six numbers Tx Ty Tz Rx Ry Rz, got 3"),
        ("1 2 3 4 5 6 7", "got 7"),
        ("1,,2,3,4,5", "got 5"),
        ("", "got 0"),
        ([], "got 0"),
        (np.eye(6), r"number 1 \(Tx\) is array"),
        ("1 2 nan 4 5 6", r"all finite; number 3 \(Tz\) is nan"),
        ([1, 2, 3, 4, 5, -np.inf], r"number 6 \(Rz\) is -inf"),
        ("1 2 3 4 1e999 6", r"number 5 \(Ry\) is inf"),
        ("1 two 3 4 5 6", r"number 2 \(Ty\) is 'two'"),
        ([1, None, 3, 4, 5, 6], r"number 2 \(Ty\) is None"),
        ([1, 1j, 3, 4, 5, 6], r"number 2 \(Ty\) is 1j"),
        ("1_0 2 3 4 5 6", r"number 1 \(Tx\) is '1_0'"),
        ([10**400, 2, 3, 4, 5, 6], r"number 1 \(Tx\)"),
        (5, "got 5"),
        (None, "got None"),
    ],
)
def test_wrong_numbers(bad, message):
    with pytest.raises(TaskError, match=message):
        tasks.task_from_numbers(bad)


@check(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=6, max_size=6))
def test_any_finite_numbers_are_a_task(values):
    task = tasks.task_from_numbers(values)
    assert task.q.tolist() == values
    assert tasks.parse_task(" ".join(map(repr, values))).q.tolist() == values
    moved = tasks.full_motion(task)
    assert np.isfinite(moved).all()
    present = np.abs(values) > [0.1] * 3 + [0.05] * 3
    assert np.abs(moved[:3, 3]).max() == pytest.approx(0.1 if present[:3].any() else 0)
    turned = np.abs(vector_from_rotation(moved[:3, :3])).max()
    assert turned == pytest.approx(np.pi / 4 if present[3:].any() else 0)


def test_absence_is_read_as_zero_and_the_rest_as_proportions():
    task = tasks.task_from_numbers([0.1, -0.1, 0.2, 0.05, -0.05, 0.06])
    assert tasks.motion_of(task).tolist() == [0, 0, 0.2, 0, 0, 0.06]
    still = tasks.task_from_numbers([0.1, 0.1, -0.1, 0.05, 0, 0.05])
    assert still.describe() == "no motion"
    assert np.array_equal(tasks.full_motion(still), np.eye(4))
    half = tasks.full_motion(tasks.task_from_numbers([1, -0.5, 0.1, 0.05, 0.4, -0.8]))
    np.testing.assert_allclose(half[:3, 3], [0.1, -0.05, 0], atol=1e-15)
    np.testing.assert_allclose(
        vector_from_rotation(half[:3, :3]), np.pi / 4 * np.array([0, 0.5, -1]), atol=1e-14
    )


# --- displacements -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("axis", "q"), [("y", Q1), ("x", Q2)])
def test_table_1_from_its_displacement(axis, q):
    turn = np.pi / 4 * np.eye(3)["xyz".index(axis)]
    task = tasks.task_from_displacement(rotation=turn, translation=[0.1, 0.1, 0])
    assert task.q.tolist() == q
    from_numbers = tasks.task_from_numbers(q)
    assert tasks.task_from_displacement(tasks.full_motion(from_numbers)).q.tolist() == q
    np.testing.assert_allclose(tasks.full_motion(task), tasks.full_motion(from_numbers), atol=1e-15)


@check(poses)
def test_the_displacement_is_kept_bit_for_bit(T):
    task = tasks.task_from_displacement(T)
    assert np.array_equal(task.displacement, T)
    assert np.array_equal(tasks.displacement_of(task), T)
    assert not task.displacement.flags.writeable
    parts = tasks.task_from_displacement(rotation=T[:3, :3], translation=T[:3, 3])
    assert np.array_equal(parts.displacement, T)
    assert np.array_equal(parts.q, task.q)


@check(vectors, directions, st.floats(0.01, 3))
def test_q_is_proportional_between_presence_and_a_tenth(t, direction, angle):
    r = direction * angle
    q = tasks.task_from_displacement(rotation=r, translation=t).q
    for part, vector, present, absent in ((q[:3], t, 1.0, 0.1), (q[3:], r, 0.8, 0.05)):
        largest = np.abs(vector).max()
        if largest < 2e-6:
            assert largest <= 1e-6 or np.abs(part).max() == present
            continue
        assert np.abs(part).max() == pytest.approx(present)
        for got, component in zip(part, vector, strict=True):
            ratio = component / largest
            if abs(abs(ratio) - 0.1) > 1e-9:
                want = present * ratio if abs(ratio) >= 0.1 else absent
                assert got == pytest.approx(want, abs=1e-9)


@pytest.mark.parametrize(
    ("t", "r", "q"),
    [
        ((0, 0, 0), (0, 0, 0), (0.1, 0.1, 0.1, 0.05, 0.05, 0.05)),
        ((0, 0, -3), (0, 0, 0), (0.1, 0.1, -1, 0.05, 0.05, 0.05)),
        ((0, 0, 0), (-0.2, 0, 0), (0.1, 0.1, 0.1, -0.8, 0.05, 0.05)),
        ((2, -1, 0.19), (0, 0, 0), (1, -0.5, 0.1, 0.05, 0.05, 0.05)),
        ((1e-9, 0, 0), (0, 1e-9, 0), (0.1, 0.1, 0.1, 0.05, 0.05, 0.05)),
        ((1e-5, 0, 0), (0, 0, np.pi), (1, 0.1, 0.1, 0.05, 0.05, 0.8)),
    ],
)
def test_q_of_known_displacements(t, r, q):
    np.testing.assert_allclose(tasks.task_from_displacement(rotation=r, translation=t).q, q, atol=1e-12)


@check(poses, st.floats(1e-2, 100))
def test_q_does_not_depend_on_the_size_of_the_translation(T, factor):
    bigger = T.copy()
    bigger[:3, 3] *= factor
    if min(np.abs(T[:3, 3]).max(), np.abs(bigger[:3, 3]).max()) > 1e-5:
        a, b = tasks.q_of_displacement(T), tasks.q_of_displacement(bigger)
        ratios = np.abs(T[:3, 3]) / np.abs(T[:3, 3]).max()
        if np.abs(ratios - 0.1).min() > 1e-9:
            np.testing.assert_allclose(a, b, atol=1e-12)


def test_rotation_in_three_spellings():
    r = np.array([0.3, -0.2, 1.0])
    a, b, c = (
        tasks.task_from_displacement(rotation=rotation)
        for rotation in (r, quaternion_from_rotation(rotation_from_vector(r)), rotation_from_vector(r))
    )
    np.testing.assert_allclose(a.displacement, b.displacement, atol=1e-15)
    assert np.array_equal(a.displacement, c.displacement)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ({"displacement": np.eye(3)}, "displacement must be 4×4 numbers, got 3×3"),
        ({"displacement": np.diag([2.0, 2, 2, 1])}, "remove scale"),
        ({"displacement": np.diag([1.0, 1, -1, 1])}, "mirror"),
        ({"rotation": [0, 0, 0, 0]}, "not zero"),
        ({"rotation": np.eye(2)}, "rotation must be 3×3"),
        ({"rotation": [0, np.nan, 0]}, "rotation vector must be finite"),
        ({"translation": [1, 2]}, "translation must be 3 numbers, got 2"),
        ({"translation": "up"}, "translation must be numbers"),
        ({}, "either as a 4×4 matrix or as rotation and translation"),
        ({"displacement": np.eye(4), "translation": [0, 0, 1]}, "either as"),
        ({"translation": [0, 0, 1], "gravity": [0, 1]}, "gravity must be 3 numbers"),
    ],
)
def test_wrong_displacements(call, message):
    with pytest.raises(TaskError, match=message):
        tasks.task_from_displacement(**call)


@check(poses, poses, vectors)
def test_pose_pair_round_trip(start, goal, cog):
    task = tasks.task_from_poses(start, goal, cog)
    np.testing.assert_allclose(tasks.goal_pose(task, start, cog), goal, atol=1e-12)
    # x' = R(x - c) + c + t takes every point of the object where the goal pose puts it.
    D, x = task.displacement, cog + np.array([0.1, -0.2, 0.3])
    moved = D[:3, :3] @ (x - cog) + cog + D[:3, 3]
    np.testing.assert_allclose(
        start[:3, :3] @ moved + start[:3, 3], goal[:3, :3] @ x + goal[:3, 3], atol=1e-12
    )


@check(poses, poses, poses, vectors)
def test_a_pose_pair_task_does_not_depend_on_the_world_frame(start, goal, T_other_world, cog):
    here = tasks.task_from_poses(start, goal, cog)
    there = tasks.task_from_poses(T_other_world @ start, T_other_world @ goal, cog)
    np.testing.assert_allclose(there.displacement, here.displacement, atol=1e-11)


def test_turning_in_place_about_the_cog_is_no_translation():
    start = pose(rotation_from_vector([0.4, 0.5, -0.6]), [3, 2, 1])
    cog = np.array([0.1, 0.2, 0.3])
    R = rotation_from_vector([0, 0, 1])
    about_cog = pose(R, cog - R @ cog)
    task = tasks.task_from_poses(start, start @ about_cog, cog)
    np.testing.assert_allclose(task.q, [0.1, 0.1, 0.1, 0.05, 0.05, 0.8], atol=1e-12)
    elsewhere = tasks.task_from_poses(start, start @ about_cog, cog + np.array([1, 0, 0]))
    assert np.abs(elsewhere.q[:3]).max() == 1.0


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ((np.zeros((4, 4)), np.eye(4), np.zeros(3)), "the start pose must end"),
        ((np.eye(4), np.diag([1, 1, -1.0, 1]), np.zeros(3)), "the goal pose must be a rotation"),
        ((np.eye(4), np.eye(4), [0, 0]), "the COG must be 3 numbers, got 2"),
    ],
)
def test_wrong_poses(args, message):
    with pytest.raises(TaskError, match=message):
        tasks.task_from_poses(*args)


@check(poses)
def test_full_motion_of_a_displacement_keeps_its_screw_and_reaches_one_limit(T):
    task = tasks.task_from_displacement(T)
    part = tasks.full_motion(task)
    t, r = np.abs(part[:3, 3]).max(), np.abs(vector_from_rotation(part[:3, :3])).max()
    assert t <= 0.1 + 1e-9
    assert r <= np.pi / 4 + 1e-9
    moves = np.abs(T[:3, 3]).max() > 1e-6
    turns = np.abs(vector_from_rotation(T[:3, :3])).max() > 1e-6
    if not moves and not turns:
        assert np.array_equal(part, np.eye(4))
        return
    assert max(t / 0.1, r / (np.pi / 4)) == pytest.approx(1, abs=1e-6)
    if moves and turns and 0.01 < screw_from_displacement(T).angle < 3:
        whole, small = screw_from_displacement(T), screw_from_displacement(part)
        if small.angle > 1e-3:
            np.testing.assert_allclose(small.direction, whole.direction, atol=1e-6)
            np.testing.assert_allclose(
                small.point, whole.point, atol=1e-5 * (1 + np.linalg.norm(whole.point))
            )
            assert small.pitch == pytest.approx(whole.pitch, abs=1e-5)


def test_full_motion_follows_the_arc():
    """Half a turn about a distant axis: the COG reaches 0.1 m on its arc and never exceeds it."""
    T = pose(rotation_from_vector([0, 0, np.pi]), [2, 0, 0])
    part = tasks.full_motion(tasks.task_from_displacement(T))
    assert np.abs(part[:3, 3]).max() == pytest.approx(0.1, abs=1e-12)
    angle = vector_from_rotation(part[:3, :3])[2]
    np.testing.assert_allclose(along_screw(T, angle / np.pi), part, atol=1e-12)


# --- primitives ----------------------------------------------------------------------------------------


def test_primitives_compose_in_sequence_about_the_carried_cog():
    steps = [
        Primitive(kind="translate", axis="x", amount=0.2),
        Primitive(kind="rotate", axis="+z", amount=np.pi / 2),
        Primitive(kind="rotate", axis="-x", amount=np.pi / 2),
        Primitive(kind="translate", axis=(0, 3, 4), amount=-0.5),
    ]
    task = tasks.task_from_primitives(steps)
    assert task.primitives == tuple(steps)
    want = np.array([[0, -1, 0, 0.2], [0, 0, 1, -0.3], [-1, 0, 0, -0.4], [0, 0, 0, 1.0]])
    np.testing.assert_allclose(task.displacement, want, atol=1e-15)
    assert not np.allclose(tasks.compose([steps[0], steps[2], steps[1], steps[3]]), want)


@check(
    st.one_of(
        poses,
        st.builds(
            lambda x, y, z, t: tasks.compose(
                [Primitive(kind="rotate", axis=a, amount=v) for a, v in (("x", x), ("y", y), ("z", z))]
                + [Primitive(kind="translate", axis=a, amount=v) for a, v in zip("xyz", t, strict=True)]
            ),
            right_angles,
            right_angles,
            right_angles,
            translations,
        ),
    )
)
def test_primitives_of_reproduce_the_displacement(T):
    steps = tasks.primitives_of(tasks.task_from_displacement(T))
    assert len(steps) <= 6
    for step in steps:
        assert sorted(np.abs(step.axis)) == [0, 0, 1]
    back = tasks.compose(steps)
    np.testing.assert_allclose(back[:3, :3], T[:3, :3], rtol=0, atol=1e-12)
    assert np.array_equal(back[:3, 3], T[:3, 3])
    again = tasks.task_from_primitives(steps) if steps else tasks.task_from_displacement(np.eye(4))
    np.testing.assert_allclose(again.displacement, T, rtol=0, atol=1e-12)


@pytest.mark.parametrize("off", [0.0, 1e-15, -1e-12, 1e-9, -1e-6, 1e-3])
@pytest.mark.parametrize("side", [-1, 1])
def test_primitives_of_near_the_right_angle_of_y(side, off):
    for x, z in np.random.default_rng(2).uniform(-np.pi, np.pi, (20, 2)):
        angles = (("x", x), ("y", side * (np.pi / 2 + off)), ("z", z))
        T = tasks.compose([Primitive(kind="rotate", axis=a, amount=v) for a, v in angles])
        T[:3, :3] = rotation_from_vector(vector_from_rotation(T[:3, :3]))  # rounded as any other rotation
        steps = tasks.primitives_of(tasks.task_from_displacement(T))
        np.testing.assert_allclose(tasks.compose(steps), T, rtol=0, atol=1e-14)


def test_primitives_of_one_step_and_of_numbers():
    (step,) = tasks.primitives_of(tasks.task_from_displacement(rotation=[0, 0.5, 0]))
    assert (step.kind, step.axis.tolist()) == ("rotate", [0, 1, 0])
    assert step.amount == pytest.approx(0.5, abs=1e-15)
    task = tasks.task_from_numbers(Q1)
    np.testing.assert_allclose(tasks.compose(tasks.primitives_of(task)), tasks.full_motion(task), atol=1e-15)
    assert tasks.primitives_of(tasks.task_from_displacement(np.eye(4))) == ()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ({"kind": "bend", "axis": "x", "amount": 1}, "no kind of primitive 'bend'; known: translate, rotate"),
        ({"kind": "rotate", "axis": "w", "amount": 1}, r"an axis is one of \+x -x \+y -y \+z -z, got 'w'"),
        ({"kind": "rotate", "axis": (0, 0, 0), "amount": 1}, "must have a direction"),
        ({"kind": "rotate", "axis": (0, 1), "amount": 1}, "an axis must be 3 numbers, got 2"),
        ({"kind": "rotate", "axis": (0, np.inf, 1), "amount": 1}, "an axis must be finite"),
        (
            {"kind": "translate", "axis": "x", "amount": np.nan},
            "amount of a translate primitive must be finite",
        ),
        (
            {"kind": "translate", "axis": "x", "amount": "far"},
            "amount of a translate primitive must be numbers",
        ),
    ],
)
def test_wrong_primitives(call, message):
    with pytest.raises(TaskError, match=message):
        Primitive(**call)


@pytest.mark.parametrize("steps", [[], ["lift"]])
def test_no_primitives(steps):
    with pytest.raises(TaskError, match="at least one primitive"):
        tasks.task_from_primitives(steps)


# --- families ------------------------------------------------------------------------------------------


def test_every_family_parses_along_every_axis_and_no_two_are_the_same():
    named = tasks.all_named_tasks()
    assert len(tasks.family_names()) >= 15
    assert len(named) == 6 * len(tasks.family_names())
    assert len({tuple(task.q) for task in named}) == len(named)
    for task in named:
        again = tasks.parse_task(task.label)
        assert (again.name, again.axis) == (task.name, task.axis)
        assert np.array_equal(again.q, task.q)
        assert task.means.endswith(".")
        assert "Load:" in task.means
        assert "{" not in task.means
        assert "--" not in task.means
        assert task.describe() != "no motion"
        assert np.linalg.norm(task.gravity) == 1
    assert {task.name for task in named} == set(tasks.family_names())


@pytest.mark.parametrize("name", tasks.family_names())
def test_a_family_obeys_its_axis(name):
    """Rotating the axis rotates the whole task, where the rotation keeps the upward side."""
    motions = {axis: tasks.motion_of(tasks.named_task(f"{name}:{axis}")).reshape(2, 3) for axis in tasks.AXES}
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    for axis, turned in (("+x", "+y"), ("+y", "-x"), ("-x", "-y"), ("-y", "+x")):
        np.testing.assert_array_equal(motions[turned], motions[axis] @ quarter.T)
    to_z = np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0.0]])  # x → z, z → x: the axis +z with +x up
    np.testing.assert_array_equal(motions["+z"], motions["+x"] @ to_z.T)
    family = tasks.FAMILIES[name]
    default = tasks.named_task(name)
    assert default.axis == family.axis
    assert np.abs(default.q[:3]).max() in (0.1, *np.abs(family.translation))


@pytest.mark.parametrize(
    ("text", "q", "words"),
    [
        ("lift", [0.1, 0.1, 1, 0.05, 0.05, 0.05], "along +Z"),
        ("push:+x", [1, 0.1, -0.3, 0.05, 0.05, 0.05], "along +X -Z"),
        ("pull", [-1, 0.1, 0.3, 0.05, 0.05, 0.05], "along -X +Z"),
        ("turn:-y", [0.1, 0.1, 0.1, 0.05, -0.8, 0.05], "turning about -Y"),
        ("screw:+z", [0.1, 0.1, 0.5, 0.05, 0.05, 0.8], "along +Z, turning about +Z"),
        ("unscrew:+z", [0.1, 0.1, -0.3, 0.05, 0.05, -1], "along -Z, turning about -Z"),
        ("pour:y", [0.1, 0.1, 0.9, 0.05, 0.8, 0.05], "along +Z, turning about +Y"),
        ("lever:+x", [0.1, 0.1, 1, 0.8, 0.05, 0.05], "along +Z, turning about +X"),
    ],
)
def test_known_families(text, q, words):
    task = tasks.named_task(text)
    assert task.q.tolist() == q
    assert task.describe() == words


@pytest.mark.parametrize("axis", tasks.AXES)
def test_families_move_as_their_sentences_say(axis):
    """Rotation and translation have the right signs in rolling, swinging, prying and threads."""
    parts = {
        name: tasks.motion_of(tasks.named_task(f"{name}:{axis}")).reshape(2, 3) for name in tasks.FAMILIES
    }
    up = -tasks.named_task(f"roll:{axis}").gravity
    a = np.eye(3)["xyz".index(axis[1])] * (1 if axis[0] == "+" else -1)
    moved, turned = parts["roll"]
    assert np.cross(turned, up) @ moved > 0.5  # the centre, above the contact, goes where the turn takes it
    moved, turned = parts["strike"]
    assert moved @ a > 1
    assert np.cross(turned, up) @ a > 0.3  # the upper end goes forward
    moved, turned = parts["lever"]
    assert moved @ turned == 0
    assert moved @ up == 1
    moved, turned = parts["screw"]
    assert moved @ a > 0
    assert turned @ a > 0
    moved, turned = parts["unscrew"]
    assert moved @ a < 0
    assert turned @ a < 0
    assert parts["pour"][0] @ up > 0
    assert tasks.named_task(f"lift:{axis}").gravity @ a == -1


def test_gravity_of_families():
    assert tasks.named_task("lift:+x").gravity.tolist() == [-1, 0, 0]
    assert tasks.named_task("pour:z").gravity.tolist() == [-1, 0, 0]
    assert tasks.named_task("insert").gravity.tolist() == [0, 0, -1]


@pytest.mark.parametrize(
    "text", ["hand_over", "hand-over", "Hand Over", " HAND_OVER ", "hand over:+x", "hand_over: X "]
)
def test_spellings_of_a_name(text):
    assert tasks.parse_task(text).label == "hand_over:+x"


@pytest.mark.parametrize(
    ("said", "label"), [("pick", "lift:+z"), ("Pick-up:+x", "lift:+x"), ("hammer", "strike:+x")]
)
def test_other_words_for_a_task(said, label):
    assert tasks.parse_task(said).label == label


def test_another_word_is_no_name_and_means_a_family():
    names = set(tasks.family_names())
    assert not names & set(tasks.OTHER_NAMES)
    assert set(tasks.OTHER_NAMES.values()) <= names


def test_unknown_name_lists_the_nearest():
    with pytest.raises(UnknownTask) as caught:
        tasks.parse_task("scrw:+z")
    assert caught.value.nearest()[0] == "screw"
    assert str(caught.value).startswith("no task 'scrw'; did you mean screw")
    assert all(name in str(caught.value) for name in tasks.family_names())
    with pytest.raises(UnknownTask):
        tasks.parse_task("lift up")


@pytest.mark.parametrize("text", ["push:", "push:w", "push:+x:+y", "push:++x", "push:up"])
def test_unknown_axis(text):
    with pytest.raises(TaskError, match=r"an axis is one of \+x -x .* write for example push:\+x"):
        tasks.parse_task(text)


@pytest.mark.parametrize("text", ["", "  ", ",", "\n"])
def test_nothing_is_not_a_task(text):
    with pytest.raises(TaskError, match=r"six numbers .* or a name such as lift, got nothing"):
        tasks.parse_task(text)


@pytest.mark.parametrize(("text", "message"), [("1 2", "got 2"), ("nan", "got 1"), ("push 1 2", "got 3")])
def test_text_with_a_number_is_read_as_numbers(text, message):
    with pytest.raises(TaskError, match=message):
        tasks.parse_task(text)


@check(st.text(max_size=30) | st.text("0123456789.,e-+ :xyzpush_", max_size=30))
def test_any_text_is_a_task_or_a_task_error(text):
    try:
        task = tasks.parse_task(text)
    except (TaskError, UnknownTask):
        return
    assert np.isfinite(task.q).all()


# --- values and files ----------------------------------------------------------------------------------


def same(a, b):
    for field in ("name", "means", "axis"):
        assert getattr(a, field) == getattr(b, field)
    assert np.array_equal(a.q, b.q)
    assert np.array_equal(a.gravity, b.gravity)
    assert (a.displacement is None) == (b.displacement is None)
    assert a.displacement is None or np.array_equal(a.displacement, b.displacement)
    assert len(a.primitives) == len(b.primitives)
    for p, q in zip(a.primitives, b.primitives, strict=True):
        assert (p.kind, p.amount) == (q.kind, q.amount)
        assert np.array_equal(p.axis, q.axis)


def through_json(task):
    return tasks.from_json(json.loads(json.dumps(tasks.to_json(task), allow_nan=False)))


@check(poses, vectors, directions, numbers)
def test_json_keeps_the_bits(T, gravity, axis, amount):
    task = tasks.task_from_displacement(T, name="mine", gravity=gravity)
    same(through_json(task), task)
    steps = [Primitive(kind=kind, axis=axis, amount=amount) for kind in ("rotate", "translate")]
    same(through_json(tasks.task_from_primitives(steps)), tasks.task_from_primitives(steps))


def test_json_and_pickle_of_every_named_task():
    for task in tasks.all_named_tasks():
        same(through_json(task), task)
        same(pickle.loads(pickle.dumps(task)), task)  # noqa: S301 - processes hand tasks to each other


def test_json_of_a_rounded_displacement_is_stable():
    T = np.round(pose(rotation_from_vector([0.1, 1, -2]), [0.1, 0.2, 0.3]), 5)
    task = tasks.task_from_displacement(T)
    assert not np.array_equal(task.displacement, T)
    same(through_json(task), task)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({}, "must have name and q"),
        ([], "must have name and q"),
        ({"name": "a", "q": [1, 2]}, "task Q must be 6 numbers, got 2"),
        ({"name": "a", "q": None}, "task Q must be"),
        ({"name": 3, "q": Q1}, "must be text"),
        ({"name": "a", "q": Q1, "displacement": [[1]]}, "displacement must be 4×4"),
        ({"name": "a", "q": Q1, "primitives": [{"kind": "rotate"}]}, "list of kind, axis, amount"),
        ({"name": "a", "q": Q1, "primitives": 3}, "list of kind, axis, amount"),
        (
            {"name": "a", "q": Q1, "primitives": [{"kind": "x", "axis": "x", "amount": 1}]},
            "translate, rotate",
        ),
        ({"name": "a", "q": Q1, "gravity": [0, 0]}, "gravity must be 3 numbers"),
    ],
)
def test_wrong_json(data, message):
    with pytest.raises(TaskError, match=message):
        tasks.from_json(data)


def test_gravity_is_a_direction_or_none():
    assert tasks.task_from_numbers(Q1, gravity=(0, 0, -9.81)).gravity.tolist() == [0, 0, -1]
    assert tasks.task_from_numbers(Q1, gravity=(0, 0, 0)).gravity.tolist() == [0, 0, 0]


def test_means_of_made_tasks():
    assert tasks.task_from_displacement(translation=[0, 0, 1]).means == "Move the object along +Z."
    assert tasks.task_from_displacement(np.eye(4)).means == "Hold the object still."
    assert tasks.task_from_displacement(np.eye(4), means="Wait.").means == "Wait."


def test_a_task_cannot_be_changed():
    task = tasks.named_task("lift")
    with pytest.raises(AttributeError):
        task.name = "drop"
    with pytest.raises(ValueError, match="read-only"):
        task.q[0] = 3


def test_all_names_exist_and_importing_is_cheap():
    assert all(hasattr(tasks, name) for name in tasks.__all__)
    code = "import sys, preshape.tasks; print(sorted({m.split('.')[0] for m in sys.modules} & set(%r)))"
    heavy = ["scipy", "trimesh", "mujoco", "matplotlib", "fcl", "manifold3d", "embreex"]
    out = subprocess.run([sys.executable, "-c", code % heavy], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
