"""Contact wrenches against closed forms, rigid motions against invariance, screw measures against duality."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from preshape.exceptions import InputError
from preshape.hiis.analyser import Aim, HandLayout
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.hiis.wrench import (
    contact_wrenches,
    grasp_wrenches,
    net_wrench,
    rank,
    reciprocal_twists,
    screw_measures,
    soft_finger_basis,
)
from preshape.objects.library import load_library_object
from preshape.types import ContactCoefficients

Array = NDArray[np.float64]
X, Y, Z = np.eye(3)
PLANES = [(a, o) for i, a in enumerate(np.eye(3)) for j, o in enumerate(np.eye(3)) if i != j]
PLANES += [(-a, o) for a, o in PLANES]
SETS = [(0.45, 0.30, 1.0, 0.80), (0.30, 0.20, 1.0, 0.90), (0.1, 0.7, 2.0, 0.0), (0.0, 0.0, 1.0, 0.5)]
derandomized = settings(derandomize=True, deadline=None, max_examples=60)
seeds = st.integers(0, 2**32 - 1)


def coefficients(four: tuple[float, ...]) -> ContactCoefficients:
    return ContactCoefficients(ka=four[0], ko=four[1], kn=four[2], mn=four[3])


def rotation(seed: int, angle: float) -> Array:
    """Rodrigues about a random axis."""
    k = np.random.default_rng(seed).normal(size=3)
    k /= np.linalg.norm(k)
    K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


angles = st.one_of(
    st.floats(-np.pi, np.pi), st.sampled_from([1e-9, -1e-7, 1e-4, np.pi - 1e-7, np.pi, 1e-9 - np.pi])
)


def scene(rng: np.random.Generator, n: int) -> tuple[Array, Array, Array, Array, Array]:
    """Random contacts: positions, normals, a, t, signs."""
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    frame = rotation(int(rng.integers(2**32)), float(rng.uniform(-3, 3)))
    sign = np.array([-1.0, *rng.choice([-1.0, 0.0, 1.0], n - 1)])
    return rng.normal(size=(n, 3)), normals, frame[0], frame[2], sign


@pytest.mark.parametrize("four", SETS)
@pytest.mark.parametrize("fingers", [1, 2, 3])
@pytest.mark.parametrize("plane", range(12))
def test_net_wrench_of_a_box_in_closed_form(four: tuple[float, ...], fingers: int, plane: int) -> None:
    ka, ko, kn, mn = four
    a, o = PLANES[plane]
    t = np.cross(a, o)
    x, h, spread = 0.17, 0.4, 0.3
    ti = {1: [0.0], 2: [spread, -spread], 3: [spread, 0.0, -spread]}[fingers]
    positions = np.array([x * a + h * o] + [x * a - h * o + u * t for u in ti])
    normals = np.array([-o] + [o] * fingers)
    sign = np.array([-1.0] + [-np.sign(u) for u in ti])
    each = contact_wrenches(positions, normals, a, t, sign, coefficients(four))
    found = net_wrench(each)
    frame = np.column_stack([a, o, t])
    # PAPER.md §5 with the small term x Ko that the thumb's transverse force adds about o.
    n = fingers
    force = [(n + 1) * ka, (n - 1) * kn, -ko]
    torque = [-h * ko, (n - 1) * mn + x * ko, (n - 1) * (x * kn + h * ka)]
    assert each.shape == (n + 1, 6)
    assert frame.T @ found[:3] == pytest.approx(force, abs=1e-12)
    assert frame.T @ found[3:] == pytest.approx(torque, abs=1e-12)


def test_one_oblique_contact_by_hand() -> None:
    # n halfway between a = x and -o = -y: the tangential part of a is (1/2, 1/2, 0), not renormalised.
    n = np.array([1.0, -1.0, 0.0]) / np.sqrt(2)
    r = np.array([0.1, 0.2, 0.3])
    found = contact_wrenches(r[None], n[None], X, Z, np.array([-1.0]), ContactCoefficients())[0]
    force = n + 0.45 * np.array([0.5, 0.5, 0.0]) - 0.30 * Z
    assert found[:3] == pytest.approx(force)
    torque = [
        0.2 * force[2] - 0.3 * force[1],
        0.3 * force[0] - 0.1 * force[2],
        0.1 * force[1] - 0.2 * force[0],
    ]
    assert found[3:] == pytest.approx(0.8 * n + torque)
    # An approach along the normal leaves nothing to push sideways with.
    along = contact_wrenches(r[None], X[None], X, Z, np.array([0.0]), ContactCoefficients())[0]
    assert along[:3] == pytest.approx(X)


def test_batches_equal_loops() -> None:
    rng = np.random.default_rng(1)
    positions, a = rng.normal(size=(4, 5, 3, 3)), rng.normal(size=(4, 1, 3))
    normals, t = rng.normal(size=(4, 5, 3, 3)), rng.normal(size=(4, 1, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    sign = np.array([-1.0, 0.0, 1.0])
    k = ContactCoefficients()
    found = contact_wrenches(positions, normals, a, t, sign, k)
    assert found.shape == (4, 5, 3, 6)
    for i, j in np.ndindex(4, 5):
        one = contact_wrenches(positions[i, j], normals[i, j], a[i, 0], t[i, 0], sign, k)
        assert np.allclose(found[i, j], one, rtol=0, atol=1e-14)
        assert np.allclose(net_wrench(found)[i, j], sum(one), rtol=0, atol=1e-13)


@derandomized
@given(seed=seeds, angle=angles, n=st.integers(1, 4))
def test_a_rotated_scene_has_the_rotated_net_wrench(seed: int, angle: float, n: int) -> None:
    rng = np.random.default_rng(seed)
    r, normals, a, t, sign = scene(rng, n)
    R = rotation(seed + 1, angle)
    k = ContactCoefficients()
    before = net_wrench(contact_wrenches(r, normals, a, t, sign, k))
    after = net_wrench(contact_wrenches(r @ R.T, normals @ R.T, R @ a, R @ t, sign, k))
    assert np.allclose(after, np.concatenate([R @ before[:3], R @ before[3:]]), rtol=0, atol=1e-11)


@derandomized
@given(seed=seeds, n=st.integers(1, 4))
def test_moving_the_point_of_reference_adds_its_cross_product(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    r, normals, a, t, sign = scene(rng, n)
    d = rng.normal(size=3)
    k = ContactCoefficients()
    here = contact_wrenches(r, normals, a, t, sign, k)
    there = contact_wrenches(r - d, normals, a, t, sign, k)  # about the point d
    assert np.allclose(there[:, :3], here[:, :3], rtol=0, atol=1e-12)
    assert np.allclose(there[:, 3:], here[:, 3:] - np.cross(d, here[:, :3]), rtol=0, atol=1e-11)


@derandomized
@given(seed=seeds, k=st.tuples(*[st.floats(-2, 2)] * 4))
def test_each_coefficient_scales_its_own_part(seed: int, k: tuple[float, ...]) -> None:
    r, normals, a, t, sign = scene(np.random.default_rng(seed), 3)
    parts = [contact_wrenches(r, normals, a, t, sign, coefficients(tuple(unit))) for unit in np.eye(4)]
    whole = contact_wrenches(r, normals, a, t, sign, coefficients(k))
    assert np.allclose(whole, sum(c * p for c, p in zip(k, parts, strict=True)), rtol=0, atol=1e-11)
    ka, ko, kn, mn = parts
    assert np.allclose(np.einsum("ij,ij->i", ka[:, :3], normals), 0, atol=1e-12)  # tangential
    assert np.allclose(np.einsum("ij,ij->i", ko[:, :3], normals), 0, atol=1e-12)
    assert np.allclose(kn[:, :3], normals, atol=1e-12)
    assert not mn[:, :3].any()


# --- screw measures ---------------------------------------------------------------------------------


def unions() -> list[tuple[Array, int]]:
    """Wrench unions of known rank."""
    rng = np.random.default_rng(5)
    made: list[tuple[Array, int]] = [(np.zeros((2, 6)), 0), (np.zeros((0, 6)), 0)]
    for n, r in [(1, 1), (2, 2), (3, 3), (4, 4), (6, 6), (9, 6), (5, 2), (8, 5), (4, 1)]:
        made.append((rng.normal(size=(n, r)) @ rng.normal(size=(r, 6)), r))
    return made


@pytest.mark.parametrize(("union", "true_rank"), unions())
def test_every_reciprocal_twist_does_no_work_and_none_is_missing(union: Array, true_rank: int) -> None:
    twists = reciprocal_twists(union)
    assert rank(union) == true_rank
    assert twists.shape == (6 - true_rank, 6)
    assert np.allclose(twists @ twists.T, np.eye(6 - true_rank), atol=1e-12)
    # Twist = (angular, linear): work = force · linear + torque · angular, written without the swap.
    for wrench in union:
        for twist in twists:
            assert abs(wrench[:3] @ twist[3:] + wrench[3:] @ twist[:3]) < 1e-11


def test_a_pure_force_leaves_the_rotation_about_its_line() -> None:
    point, force = np.array([0.3, -0.2, 0.5]), np.array([0.0, 0.0, 2.0])
    wrench = np.concatenate([force, np.cross(point, force)])
    twists = reciprocal_twists(wrench[None])
    assert len(twists) == 5
    about_line = np.concatenate(
        [force, np.cross(point, force)]
    )  # angular along the line, linear at the origin
    about_line /= np.linalg.norm(about_line)
    assert np.linalg.norm(twists @ about_line) == pytest.approx(1.0)  # it lies in their span
    along_force = np.concatenate([np.zeros(3), force / 2])
    assert np.linalg.norm(twists @ along_force) < 1 - 1e-3  # the motion against the force does not


@pytest.mark.parametrize("factor", [1e-9, 1e-3, 1.0, 1e3, 1e9])
def test_rank_does_not_depend_on_the_unit_of_force(factor: float) -> None:
    for union, true_rank in unions():
        assert rank(factor * union) == true_rank
        assert len(reciprocal_twists(factor * union)) == 6 - true_rank
        assert screw_measures(factor * union) == (max(2 * true_rank - 6, 0), true_rank)


def test_rank_tolerance_is_relative() -> None:
    nearly = np.diag([1.0, 1e-4, 1e-12])
    assert rank(nearly) == 2
    assert rank(1e6 * nearly) == 2
    assert rank(nearly, tolerance=1e-3) == 1
    assert rank(nearly, tolerance=1e-13) == 3
    assert screw_measures(np.hstack([nearly, np.zeros((3, 3))]), tolerance=1e-3) == (0, 1)


def test_the_two_readings_differ_where_they_must() -> None:
    # Two opposed fingers on a box: two wrenches as the paper counts, all six with the full soft-finger basis.
    positions, normals = np.array([0.2 * Y, -0.2 * Y]), np.array([-Y, Y])
    wrenches = contact_wrenches(positions, normals, X, Z, np.array([-1.0, 0.0]), ContactCoefficients())
    assert screw_measures(wrenches) == (0, 2)
    assert screw_measures(wrenches, positions, normals, reading="net") == (0, 2)
    assert screw_measures(wrenches, positions, normals, reading="basis") == (6, 6)
    # One soft finger alone: four wrenches, and two freedoms (rolling over the fingertip) that it cannot hold.
    assert screw_measures(wrenches[:1], positions[:1], normals[:1], reading="basis") == (2, 4)
    twists = reciprocal_twists(soft_finger_basis(positions[:1], normals[:1]))
    for angular in (X, Z):
        roll = np.concatenate([angular, -np.cross(angular, positions[0])])  # velocity zero at the contact
        roll /= np.linalg.norm(roll)
        assert np.linalg.norm(twists @ roll) == pytest.approx(1.0)


def test_measures_are_between_0_and_6() -> None:
    assert screw_measures(np.zeros((3, 6))) == (0, 0)
    assert screw_measures(np.eye(6)) == (6, 6)
    assert screw_measures(np.eye(6)[:3]) == (0, 3)
    assert screw_measures(np.eye(6)[:4]) == (2, 4)
    assert screw_measures(np.eye(6)[:5]) == (4, 5)


@derandomized
@given(seed=seeds, n=st.integers(1, 4), angle=angles)
def test_the_soft_finger_basis(seed: int, n: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    r, normals, *_ = scene(rng, n)
    basis = soft_finger_basis(r, normals)
    assert basis.shape == (4 * n, 6)
    for i, four in enumerate(basis.reshape(n, 4, 6)):
        forces = four[:3, :3]
        assert np.allclose(forces @ forces.T, np.eye(3), atol=1e-12)
        assert np.allclose(four[:3, 3:], np.cross(r[i], forces), atol=1e-12)
        assert not four[3, :3].any()
        assert np.allclose(four[3, 3:], normals[i])
    # Every wrench that the contact model can make lies in it.
    made = contact_wrenches(r, normals, normals[0], X, np.full(n, -1.0), ContactCoefficients())
    assert rank(np.vstack([basis[:4], made[:1]]), 1e-8) == 4
    # A rigid motion changes no measure.
    R, d = rotation(seed + 1, angle), rng.normal(size=3)
    moved = r @ R.T + d, normals @ R.T
    assert screw_measures(made, r, normals, reading="basis", tolerance=1e-7) == screw_measures(
        made, *moved, reading="basis", tolerance=1e-7
    )


def test_bad_readings_are_refused() -> None:
    with pytest.raises(InputError, match=r"no reading 'full'; known: net, basis"):
        screw_measures(np.eye(6), reading="full")
    with pytest.raises(InputError, match="positions and normals"):
        screw_measures(np.eye(6), reading="basis")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_coefficients_that_are_not_finite_are_refused(bad: float) -> None:
    with pytest.raises(InputError, match="finite"):
        ContactCoefficients(mn=bad)


def test_default_coefficients_are_those_of_fig_16() -> None:
    k = ContactCoefficients()
    assert (k.ka, k.ko, k.kn, k.mn) == (0.45, 0.30, 1.0, 0.80)


def test_with_a_tolerance_of_zero_only_exact_zeros_are_hidden():
    force = np.array([1.0, 0, 0, 0, 0, 0])
    assert len(reciprocal_twists([force, np.zeros(6)], 0.0)) == 5
    assert len(reciprocal_twists([force, 1e-12 * np.roll(force, 1)], 0.0)) == 4
    assert len(reciprocal_twists([force, 1e-12 * np.roll(force, 1)])) == 5


def test_nothing_is_hidden_from_a_hand_that_exerts_nothing():
    assert reciprocal_twists(np.zeros((2, 6))).shape == (6, 6)
    assert screw_measures(np.zeros((2, 6))) == (0, 0)


def test_the_wrenches_of_a_grasp_are_those_of_its_rays():
    layout = HandLayout(name="some", u=0.043, finger_pitch=0.025, fingertip_width=0.017)
    mesh = load_library_object("mug")
    pa = RayAnalyser(mesh, layout)
    found = pa.explore(np.ones(6), Aim(values=[0.0, 0.25], fingers=[2, 3, 4]))
    for k in range(0, len(found), 7):
        g = found.grasp(k)
        again = grasp_wrenches(
            g.contacts.points,
            g.contacts.normals_in,
            g.plane,
            cog=mesh.cog,
            length_unit=layout.length_unit,
            coefficients=pa.coefficients,
        )
        assert np.allclose(again, g.contacts.wrenches, atol=1e-12)
