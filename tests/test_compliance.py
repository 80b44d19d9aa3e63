"""Compliance of a grasp: against the equilibrium that a minimiser finds, and what must not change it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from preshape.closure.finish import SOFT, TOO_SOFT, quality
from preshape.closure.pressing import CONTACT_COMPLIANCE, CONTACT_ERROR, turn_from_contact_error
from preshape.types import Array

Grasp = tuple[Array, Array, Array, list[Array], list[Array]]


def random_grasp(seed: int, fingers: int, press: float = 3.0) -> Grasp:
    """Contacts on a ball of 60 mm, forces that balance, chains of four joints."""
    rng = np.random.default_rng(seed)
    arms = rng.normal(size=(fingers, 3))
    arms -= arms.mean(axis=0)  # then forces towards the middle balance
    arms *= 0.03 / np.linalg.norm(arms, axis=1).max()
    normals = -arms / np.linalg.norm(arms, axis=1, keepdims=True)
    forces = -press * arms / 0.03
    jacobians, compliances = [], []
    for arm in arms:
        axes = rng.normal(size=(4, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        anchors = 3.0 * arm + rng.normal(size=(4, 3)) * 0.02
        jacobians.append(np.concatenate([np.cross(axes, arm - anchors).T, axes.T]))
        compliances.append(rng.uniform(0.1, 0.4, 4))
    return arms, normals, forces, jacobians, compliances


def settled(grasp: Grasp, push: Array) -> Array:
    """(6,) where object and contacts come to rest under a small wrench: all the springs at once.

    Unknown are the object's twist and what each contact passes on (three forces, one torsion) beside the
    squeeze; a contact goes with the object as its joints and its own skin yield.
    """
    arms, normals, forces, jacobians, compliances = grasp

    def wrong(x: Array) -> Array:
        shift, turn, passed = x[:3], x[3:6], x[6:].reshape(-1, 4)
        force, torque, gaps = push[:3].copy(), push[3:].copy(), []
        for arm, n, f, J, c, p in zip(arms, normals, forces, jacobians, compliances, passed, strict=True):
            moved = shift + np.cross(turn, arm)
            joints = c * (J[:3].T @ p[:3] + J[3:].T @ n * p[3])
            skin = np.diag(CONTACT_COMPLIANCE) * p
            gaps.append(1e3 * (moved + J[:3] @ joints + skin[:3]))
            gaps.append([1e1 * (turn @ n + n @ (J[3:] @ joints) + skin[3])])
            force += p[:3]
            torque += np.cross(arm, p[:3]) + n * p[3] + np.cross(np.cross(turn, arm), f)
        return np.concatenate([*gaps, force, 1e2 * torque])

    start = np.zeros(6 + 4 * len(arms))
    found = least_squares(wrong, start, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return np.asarray(found.x[:6])


@pytest.mark.parametrize(("seed", "fingers"), [(0, 3), (1, 4), (2, 5), (3, 3)])
def test_the_turn_is_that_of_springs_at_rest(seed: int, fingers: int) -> None:
    grasp = random_grasp(seed, fingers)
    squares = 0.0
    for force in grasp[2]:
        for axis in np.eye(3):
            push = np.concatenate([np.zeros(3), np.cross(CONTACT_ERROR * axis, force)])
            turn = settled(grasp, push)[3:]
            squares += float(turn @ turn)
    # Internal torques of forces through the middle are symmetric, so nothing is lost by the symmetric part.
    assert turn_from_contact_error(*grasp) == pytest.approx(np.sqrt(squares), rel=1e-5)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), fingers=st.integers(3, 5))
def test_the_frame_does_not_matter(seed: int, fingers: int) -> None:
    arms, normals, forces, jacobians, compliances = random_grasp(seed, fingers)
    R = Rotation.random(random_state=seed).as_matrix()
    turned = [np.concatenate([R @ J[:3], R @ J[3:]]) for J in jacobians]
    there = turn_from_contact_error(arms @ R.T, normals @ R.T, forces @ R.T, turned, compliances)
    assert there == pytest.approx(
        turn_from_contact_error(arms, normals, forces, jacobians, compliances), rel=1e-6
    )


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), fingers=st.integers(3, 5))
def test_softer_servos_never_turn_less(seed: int, fingers: int) -> None:
    arms, normals, forces, jacobians, compliances = random_grasp(seed, fingers)
    stiff = turn_from_contact_error(arms, normals, forces, jacobians, compliances)
    soft = turn_from_contact_error(arms, normals, forces, jacobians, [2.0 * c for c in compliances])
    assert soft >= stiff * (1 - 1e-9)


def test_two_fingers_lose_their_balance_where_they_press_more_than_they_are_stiff() -> None:
    inward = np.array([[-1.0, 0, 0], [1.0, 0, 0]])
    joints = [np.concatenate([0.1 * np.eye(3), np.eye(3)])] * 2
    sideways = 1.0 / (0.2 * 0.1**2 + CONTACT_COMPLIANCE[0, 0])  # [N/m] of each finger
    for half in (0.005, 0.02):
        most = sideways * half  # K (2 h²) against f (2 h): the force that takes all stiffness away
        arms = -half * inward
        held = turn_from_contact_error(arms, inward, 0.9 * most * inward, joints, [np.full(3, 0.2)] * 2)
        lost = turn_from_contact_error(arms, inward, 1.1 * most * inward, joints, [np.full(3, 0.2)] * 2)
        assert np.isfinite(held)
        assert lost == np.inf


@given(margin=st.floats(0, 20), turn=st.floats(0, 10), more=st.floats(0, 10))
def test_where_more_can_be_looked_at_a_soft_grip_is_worth_less(
    margin: float, turn: float, more: float
) -> None:
    there = quality(margin, turn, unexplored=True)
    assert quality(margin) >= there >= quality(margin, turn + more, unexplored=True)
    assert there == pytest.approx(quality(margin / (1 + turn / TOO_SOFT)))
    if there < 3.0 - 1e-9:
        assert there <= quality(margin, turn) + 1e-9


@given(margin=st.floats(0, 20), turn=st.floats(0, 10), more=st.floats(0, 10))
def test_softness_takes_from_what_is_spare_only(margin: float, turn: float, more: float) -> None:
    stiff, soft, softer = quality(margin), quality(margin, turn), quality(margin, turn + more)
    assert stiff >= soft >= softer
    assert (soft >= 3.0) == (stiff >= 3.0)
    if stiff <= 3.0:
        assert softer == stiff
    assert quality(margin, np.inf) == min(stiff, 3.0)
    assert quality(margin, SOFT) == pytest.approx(min(stiff, 3.0 + (stiff - 3.0) / 2))
