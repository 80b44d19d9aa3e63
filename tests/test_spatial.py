"""Spatial mathematics: round trips exact to 1e-12, near the identity and near a half turn too."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from preshape import spatial
from preshape.exceptions import InputError
from preshape.spatial import MotionKind, WrenchKind

TIGHT = 1e-12


def check(*strategies):
    """A property over the same examples every time, however slow the machine."""
    return lambda test: settings(derandomize=True, deadline=None, max_examples=60)(given(*strategies)(test))


numbers = st.floats(-10, 10, allow_subnormal=False)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
directions = vectors.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))
# Every size from nothing to a half turn, on both sides of each small-angle limit.
angles = st.one_of(
    st.floats(0, np.pi),
    st.integers(-160, 0).map(lambda n: 10.0**n),
    st.integers(-17, 0).map(lambda n: np.pi - 10.0**n),
    st.sampled_from([0.0, 0.5, np.nextafter(0.5, 1), np.pi / 2, np.pi]),
)
rotation_vectors = st.builds(lambda d, a: d * a, directions, angles)
poses = st.builds(lambda r, t: spatial.pose(spatial.rotation_from_vector(r), t), rotation_vectors, vectors)
wrenches = st.tuples(*[numbers] * 6).map(np.array)


def series(matrix, terms=60):
    """The matrix exponential by its definition, the reference for every closed form here."""
    out, term = np.eye(len(matrix)), np.eye(len(matrix))
    for n in range(1, terms):
        term = term @ matrix / n
        out = out + term
    return out


@check(rotation_vectors)
def test_rotation_from_vector_is_the_exponential(r):
    R = spatial.rotation_from_vector(r)
    np.testing.assert_allclose(R, series(spatial.skew(r)), atol=TIGHT)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=TIGHT)
    assert np.linalg.det(R) > 0


def test_rotations_have_the_digits_of_scipy():
    """To the last digit: answers that were computed with SciPy's rotations must stay what they were."""
    rng = np.random.default_rng(0)
    sizes = np.concatenate([[0.0, 1e-3, np.pi], 10.0 ** rng.uniform(-12, 0.49, 2000)])
    vectors = rng.normal(size=(len(sizes), 3))
    vectors *= (sizes / np.linalg.norm(vectors, axis=1))[:, None]
    vectors = np.concatenate([vectors, np.pi * np.eye(3), -np.pi * np.eye(3)])
    for r in (vectors, vectors[7], vectors[:24].reshape(2, 4, 3, 3), vectors[:0]):
        R = Rotation.from_rotvec(np.array(r)).as_matrix()
        np.testing.assert_array_equal(spatial.rotation_from_vector(r), R)
        for near in (R, R + 1e-7 * rng.normal(size=R.shape)):  # the second is only nearly a rotation
            exact = Rotation.from_matrix(near.copy()).as_quat(canonical=True, scalar_first=True)
            np.testing.assert_array_equal(spatial.quaternion_from_rotation(near), exact)
            vector = Rotation.from_quat(exact, scalar_first=True).as_rotvec()
            np.testing.assert_array_equal(spatial.vector_from_rotation(near), vector)


@pytest.mark.parametrize("wrong", [-np.eye(3), np.zeros((3, 3)), np.full((3, 3), np.nan)])
def test_what_is_no_rotation_has_no_quaternion(wrong):
    with pytest.raises(InputError, match="determinant 1"):
        spatial.quaternion_from_rotation(wrong)


@check(rotation_vectors)
def test_vector_rotation_quaternion_round_trips(r):
    R = spatial.rotation_from_vector(r)
    half = np.linalg.norm(r) / 2
    q = np.array([np.cos(half), *(r / 2 * np.sinc(half / np.pi))])
    np.testing.assert_allclose(spatial.rotation_from_quaternion(q), R, atol=TIGHT)
    np.testing.assert_allclose(spatial.rotation_from_vector(spatial.vector_from_rotation(R)), R, atol=TIGHT)
    back = spatial.quaternion_from_rotation(R)
    assert back[0] >= 0
    assert abs(np.linalg.norm(back) - 1) < TIGHT
    assert min(np.abs(back - q).max(), np.abs(back + q).max()) < TIGHT
    recovered = spatial.vector_from_rotation(R)
    if np.linalg.norm(r) < np.pi - 1e-9:  # at a half turn the other sign is the same rotation
        np.testing.assert_allclose(recovered, r, atol=TIGHT)
    assert np.linalg.norm(recovered) <= np.pi + TIGHT


@check(directions, st.integers(-150, -5))
def test_small_rotations_keep_their_relative_accuracy(direction, power):
    r = direction * 10.0**power
    recovered = spatial.vector_from_rotation(spatial.rotation_from_vector(r))
    np.testing.assert_allclose(recovered, r, rtol=0, atol=1e-10 * np.linalg.norm(r))


def test_the_smallest_rotations_are_not_lost():
    for size in (1e-150, 1e-170, 1e-300):  # their squares underflow
        r = np.array([0.6, 0, -0.8]) * size
        np.testing.assert_allclose(
            spatial.vector_from_rotation(spatial.rotation_from_vector(r)), r, rtol=1e-12
        )


@pytest.mark.parametrize("angle", [1e-12, 1e-9, 1e-5])
def test_the_axis_of_a_small_rotation_is_far_and_exact(angle):
    T = spatial.pose(spatial.rotation_from_vector([0, 0, angle]), [1, 0, 0.5])
    screw = spatial.screw_from_displacement(T)
    assert screw.kind is MotionKind.SCREW
    np.testing.assert_allclose(screw.point, [0.5, 0.5 / np.tan(angle / 2), 0], rtol=1e-12)
    np.testing.assert_allclose(spatial.displacement_from_screw(screw), T, rtol=0, atol=1e-15)
    wrench = np.array([0, 0, angle, 1, 0, 0.5])
    assert spatial.screw_from_wrench(wrench).kind is WrenchKind.SCREW
    np.testing.assert_allclose(
        spatial.wrench_from_screw(spatial.screw_from_wrench(wrench)), wrench, atol=1e-15
    )


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, -0.8, 0), (0, 0.6, -0.8)])
def test_half_turn_has_one_standard_vector(axis):
    axis = np.array(axis)
    R = 2 * np.outer(axis, axis) - np.eye(3)  # exactly symmetric: no sign to be had from R - Rᵀ
    np.testing.assert_allclose(spatial.vector_from_rotation(R), np.pi * axis, atol=TIGHT)
    T = spatial.pose(R, [0.1, -0.2, 0.3])
    np.testing.assert_allclose(spatial.twist_log(T)[3:], np.pi * axis, atol=TIGHT)
    np.testing.assert_allclose(spatial.twist_exp(spatial.twist_log(T)), T, atol=TIGHT)


def test_quaternion_is_wxyz_and_right_handed():
    q = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    np.testing.assert_allclose(spatial.rotation_from_quaternion(q) @ [1, 0, 0], [0, 1, 0], atol=TIGHT)
    np.testing.assert_allclose(
        spatial.rotation_from_quaternion(-np.array(q)) @ [1, 0, 0], [0, 1, 0], atol=TIGHT
    )
    turn = spatial.rotation_from_vector([0, 0, np.pi / 2])
    np.testing.assert_allclose(spatial.quaternion_from_rotation(turn), q, atol=TIGHT)


@pytest.mark.parametrize("bad", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_a_quaternion_without_direction_is_refused(bad):
    with pytest.raises(InputError, match="finite and not zero"):
        spatial.rotation_from_quaternion(bad)


def test_many_at_once_equal_one_at_a_time():
    rng = np.random.default_rng(1)
    r = rng.normal(size=(4, 5, 3))
    r[0, 0], r[1] = 0.0, r[1] * 1e-9
    t = rng.normal(size=(4, 5, 3))
    T = spatial.pose(spatial.rotation_from_vector(r), t)
    twists = np.concatenate([t, r], -1)
    for i in np.ndindex(4, 5):
        assert np.array_equal(spatial.rotation_from_vector(r)[i], spatial.rotation_from_vector(r[i]))
        assert np.array_equal(
            spatial.vector_from_rotation(T[..., :3, :3])[i], spatial.vector_from_rotation(T[i][:3, :3])
        )
        np.testing.assert_allclose(spatial.seven_from_pose(T)[i], spatial.seven_from_pose(T[i]), atol=1e-15)
        np.testing.assert_allclose(spatial.inverse(T)[i], spatial.inverse(T[i]), atol=1e-15)
        np.testing.assert_allclose(spatial.twist_exp(twists)[i], spatial.twist_exp(twists[i]), atol=1e-15)
        np.testing.assert_allclose(spatial.twist_log(T)[i], spatial.twist_log(T[i]), atol=1e-14)


@check(poses, vectors)
def test_pose_round_trips(T, p):
    np.testing.assert_allclose(spatial.pose_from_seven(spatial.seven_from_pose(T)), T, atol=TIGHT)
    np.testing.assert_allclose(spatial.inverse(T) @ T, np.eye(4), atol=TIGHT)
    np.testing.assert_allclose(spatial.transform_points(T, p), (T @ [*p, 1])[:3], atol=TIGHT)
    there = spatial.transform_points(T, [p, p])
    np.testing.assert_allclose(spatial.transform_points(spatial.inverse(T), there), [p, p], atol=1e-11)


def test_checked_pose_keeps_the_bits_and_repairs_a_rounded_file():
    T = spatial.pose(spatial.rotation_from_vector([0.3, -1, 2]), [1, 2, 3])
    kept = spatial.checked_pose(T, "T")
    assert np.array_equal(kept, T)
    assert not kept.flags.writeable
    repaired = spatial.checked_pose(np.round(T, 4), "T")
    np.testing.assert_allclose(repaired[:3, :3] @ repaired[:3, :3].T, np.eye(3), atol=TIGHT)
    np.testing.assert_allclose(repaired, T, atol=2e-4)
    assert np.array_equal(spatial.checked_pose(repaired, "T"), repaired)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.eye(3), "T must be 4×4 numbers, got 3×3"),
        (np.full((4, 4), np.nan), "T must be finite"),
        (np.diag([2.0, 1, 1, 1]), "remove scale"),
        (np.diag([-1.0, 1, 1, 1]), "remove scale, shear and mirror"),
        (np.eye(4).T + np.eye(4, k=-3), "must end with the row 0 0 0 1"),
        (np.array([[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]), "shear"),
    ],
)
def test_checked_pose_refuses(bad, message):
    with pytest.raises(InputError, match=message):
        spatial.checked_pose(bad, "T")


@check(wrenches, vectors, vectors, vectors)
def test_wrench_about(w, a, b, c):
    moved = spatial.wrench_about(w, a, b)
    np.testing.assert_allclose(moved[3:], w[3:] + np.cross(a - b, w[:3]), atol=1e-10)
    np.testing.assert_allclose(spatial.wrench_about(moved, b, c), spatial.wrench_about(w, a, c), atol=1e-10)
    np.testing.assert_allclose(spatial.wrench_about(moved, b, a), w, atol=1e-10)


def test_wrench_about_by_hand_and_for_many():
    # A force along +Z at x = 1 turns the origin about -Y.
    assert spatial.wrench_about([0, 0, 1, 0, 0, 0], [1, 0, 0], [0, 0, 0]).tolist() == [0, 0, 1, 0, -1, 0]
    many = spatial.wrench_about(np.tile([0, 0, 1.0, 0, 0, 0], (2, 1)), [[1, 0, 0], [0, 1, 0]], np.zeros(3))
    assert many[:, 3:].tolist() == [[0, -1, 0], [1, 0, 0]]
    one_wrench = spatial.wrench_about([0, 0, 1, 0, 0, 0], [[1, 0, 0], [0, 1, 0]], np.zeros(3))
    assert np.array_equal(many, one_wrench)


@check(vectors, rotation_vectors)
def test_twist_exp_is_the_exponential_and_log_its_inverse(linear, angular):
    twist = np.concatenate([linear, angular])
    hat = np.zeros((4, 4))
    hat[:3, :3], hat[:3, 3] = spatial.skew(angular), linear
    T = spatial.twist_exp(twist)
    np.testing.assert_allclose(T, series(hat), atol=1e-11)
    np.testing.assert_allclose(spatial.twist_exp(spatial.twist_log(T)), T, atol=TIGHT)
    if np.linalg.norm(angular) < np.pi - 1e-6:
        np.testing.assert_allclose(spatial.twist_log(T), twist, atol=1e-9)


@check(poses)
def test_twist_log_inverts_any_pose(T):
    np.testing.assert_allclose(spatial.twist_exp(spatial.twist_log(T)), T, atol=TIGHT)


@check(poses, st.floats(0, 1), st.floats(0, 1))
def test_along_screw_is_one_motion(T, s, t):
    np.testing.assert_allclose(spatial.along_screw(T, 0), np.eye(4), atol=TIGHT)
    np.testing.assert_allclose(spatial.along_screw(T, 1), T, atol=TIGHT)
    both = spatial.along_screw(T, s) @ spatial.along_screw(T, t)
    np.testing.assert_allclose(spatial.along_screw(T, s + t), both, atol=1e-10)
    assert np.array_equal(spatial.along_screw(T, [s, t])[1], spatial.along_screw(T, t))


@check(poses)
def test_screw_of_displacement_round_trip(T):
    screw = spatial.screw_from_displacement(T)
    np.testing.assert_allclose(spatial.displacement_from_screw(screw), T, rtol=0, atol=TIGHT)
    if screw.kind is MotionKind.SCREW:
        a, p = screw.direction, screw.point
        assert abs(np.linalg.norm(a) - 1) < TIGHT
        assert abs(a @ p) <= TIGHT * max(1, np.linalg.norm(p))
        assert 0 < screw.angle <= np.pi + TIGHT
        assert screw.pitch * screw.angle == pytest.approx(screw.translation)
        if screw.angle > 1e-3:  # points of the axis only slide along it
            for q in (p, p + a):
                moved = spatial.transform_points(T, q)
                np.testing.assert_allclose(moved, q + screw.translation * a, atol=1e-9)


@check(poses, poses)
def test_screw_invariants_hold_in_every_frame(T, T_b_a):
    """Angle, translation and the axis itself belong to the motion, not to the frame."""
    here = spatial.screw_from_displacement(T)
    there = spatial.screw_from_displacement(T_b_a @ T @ spatial.inverse(T_b_a))
    if here.kind is MotionKind.SCREW and 1e-2 < here.angle < np.pi - 1e-3:
        assert there.angle == pytest.approx(here.angle, abs=1e-9)
        assert there.translation == pytest.approx(here.translation, abs=1e-7)
        np.testing.assert_allclose(there.direction, T_b_a[:3, :3] @ here.direction, atol=1e-9)
        off = spatial.transform_points(T_b_a, here.point) - there.point
        np.testing.assert_allclose(np.cross(off, there.direction), 0, atol=1e-6)


def test_screw_of_a_known_displacement():
    R = spatial.rotation_from_vector([0, 0, np.pi / 2])
    screw = spatial.screw_from_displacement(spatial.pose(R, [1, 1, 3]))
    assert screw.kind is MotionKind.SCREW
    np.testing.assert_allclose(screw.direction, [0, 0, 1], atol=TIGHT)
    np.testing.assert_allclose(screw.point, [0, 1, 0], atol=TIGHT)
    assert screw.angle == pytest.approx(np.pi / 2, abs=TIGHT)
    assert screw.translation == pytest.approx(3, abs=TIGHT)
    assert screw.pitch == pytest.approx(6 / np.pi, abs=TIGHT)


def test_identity_and_translation_are_kinds():
    still = spatial.screw_from_displacement(np.eye(4))
    assert still.kind is MotionKind.IDENTITY
    assert still.pitch is None
    assert np.array_equal(spatial.displacement_from_screw(still), np.eye(4))
    T = spatial.pose(np.eye(3), [3, 0, -4])
    moved = spatial.screw_from_displacement(T)
    assert moved.kind is MotionKind.TRANSLATION
    assert (moved.angle, moved.translation, moved.pitch) == (0.0, 5.0, None)
    np.testing.assert_allclose(spatial.displacement_from_screw(moved), T, atol=TIGHT)
    spin = spatial.screw_from_displacement(spatial.pose(spatial.rotation_from_vector([1, 0, 0]), np.zeros(3)))
    assert (spin.kind, spin.translation, spin.pitch) == (MotionKind.SCREW, 0.0, 0.0)


@check(wrenches, st.integers(-30, 30))
def test_wrench_screw_round_trip(w, power):
    w = w * 10.0**power
    screw = spatial.screw_from_wrench(w)
    np.testing.assert_allclose(spatial.wrench_from_screw(screw), w, rtol=0, atol=TIGHT * np.abs(w).max())
    if screw.kind is WrenchKind.SCREW:
        about_axis = spatial.wrench_about(w, np.zeros(3), screw.point)
        scale = np.abs(w).max() * max(1, np.linalg.norm(screw.point))
        np.testing.assert_allclose(np.cross(about_axis[3:], screw.direction), 0, atol=1e-11 * scale)
        assert screw.force > 0
        assert screw.magnitude == screw.force
        assert screw.pitch == screw.torque / screw.force


def test_wrench_screw_kinds():
    nothing = spatial.screw_from_wrench(np.zeros(6))
    assert (nothing.kind, nothing.magnitude, nothing.pitch) == (WrenchKind.ZERO, 0.0, None)
    assert not spatial.wrench_from_screw(nothing).any()
    couple = spatial.screw_from_wrench([0, 0, 0, 0, -2, 0])
    assert (couple.kind, couple.magnitude, couple.pitch) == (WrenchKind.COUPLE, 2.0, None)
    assert couple.direction.tolist() == [0, -1, 0]
    assert spatial.wrench_from_screw(couple).tolist() == [0, 0, 0, 0, -2, 0]
    line = spatial.screw_from_wrench([0, 0, 2, 0, -2, 0])  # 2 N along +Z at x = 1
    assert line.kind is WrenchKind.SCREW
    assert (line.force, line.torque, line.pitch) == (2.0, 0.0, 0.0)
    assert line.point.tolist() == [1, 0, 0]


@check(wrenches, vectors)
def test_wrench_invariants_do_not_depend_on_the_reference_point(w, p):
    if np.linalg.norm(w[:3]) < 1e-2:
        return
    here, there = (
        spatial.screw_from_wrench(w),
        spatial.screw_from_wrench(spatial.wrench_about(w, np.zeros(3), p)),
    )
    assert there.force == pytest.approx(here.force)
    assert there.torque == pytest.approx(here.torque, abs=1e-8)
    np.testing.assert_allclose(np.cross(there.point + p - here.point, here.direction), 0, atol=1e-6)
