"""Metrics: closed forms, laws that must hold, and bad input."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import preshape.metrics as metrics
from preshape.exceptions import InputError
from preshape.metrics import Contacts, ForceLimits, MetricStatus
from preshape.spatial import rotation_from_vector
from preshape.types import Array

UP = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def two_soft(mu: float = 0.6, gamma: float = 0.01, half: float = 0.03, length: float = 0.05) -> Contacts:
    return Contacts(
        positions=[[half, 0, 0], [-half, 0, 0]],
        normals_in=[[-1, 0, 0], [1, 0, 0]],
        friction=mu,
        torsion=gamma,
        length=length,
    )


def three_on_disc(mu: float = 0.5) -> Contacts:
    angles = np.radians([90.0, 210.0, 330.0])
    around = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(3)])
    return Contacts(positions=0.04 * around, normals_in=-around, friction=mu, length=0.04)


def six_on_cube(mu: float = 0.4) -> Contacts:
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    return Contacts(positions=0.05 * faces, normals_in=-faces, friction=mu, length=0.05)


def random_grasp(
    seed: int, count: int | None = None, *, torsion: float | None = None, mu: float = 0.6
) -> Contacts:
    rng = np.random.default_rng(seed)
    count = count or int(rng.integers(3, 6))
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    normals = -out + 0.25 * rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Contacts(
        positions=out * [0.03, 0.04, 0.05] + 0.1,
        normals_in=normals,
        friction=mu,
        torsion=(seed % 2) * 0.01 if torsion is None else torsion,
        reference=[0.1, 0.1, 0.1],
        length=0.05,
    )


def closed_grasp(seed: int, count: int | None = None, **options: float) -> Contacts:
    """The first force-closed grasp among random ones from a seed on."""
    grasps = (random_grasp(seed * 1000 + i * 2 + seed % 2, count, **options) for i in range(200))  # type: ignore[arg-type]
    return next(grasp for grasp in grasps if metrics.force_closure(grasp).closed)


def moved(contacts: Contacts, R: Array, t: Array) -> Contacts:
    return replace(
        contacts,
        positions=contacts.positions @ R.T + t,
        normals_in=contacts.normals_in @ R.T,
        reference=R @ np.asarray(contacts.reference) + t,
    )


def turned(wrenches: Array, R: Array) -> Array:
    """(..., 6) wrenches under a rotation or reflection, which reverses torques."""
    return np.concatenate([wrenches[..., :3] @ R.T, np.linalg.det(R) * wrenches[..., 3:] @ R.T], axis=-1)


def all_numbers(
    contacts: Contacts, R: Array | None = None, *, volume: bool = True
) -> dict[str, float | None]:
    R = np.eye(3) if R is None else R
    task = np.array([0.3, -0.2, 1.0, 0.1, 0.5, -0.2])
    load = np.array([0.1, 0.0, -0.5, 0.0, 0.05, 0.0])
    directions = metrics.force_directions(100)
    ball = metrics.epsilon(contacts, edges=4 if contacts.dimension == 4 else 8)
    out = {
        "closure": metrics.force_closure(contacts).margin,
        "linear closure": metrics.force_closure_linear(contacts).margin,
        "epsilon": ball.number,
        "epsilon lower": ball.lower,
        "epsilon Linf": metrics.epsilon(contacts, "Linf", edges=0).number,
        "isotropy": metrics.isotropy(contacts).number,
        "sigma": metrics.smallest_singular_value(contacts).number,
        "gap": metrics.tdg_gap(contacts, turned(directions, R)).number,
        "pushes": metrics.push_residual(contacts, turned(metrics.six_pushes(), R)).number,
        "margin": metrics.task_margin(
            contacts, turned(task, R), ForceLimits(total=20.0), load=turned(load, R)
        ).number,
        "margin each": metrics.task_margin(
            contacts, turned(task, R), ForceLimits(each=10.0), load=turned(load, R)
        ).number,
    }
    if volume:
        out["volume"] = metrics.volume(contacts, edges=6).number
    return out


def tolerance(name: str) -> float:
    """The L∞ searches converge slowly where many faces meet."""
    return 1e-8 if name in ("epsilon Linf", "margin each") else 1e-9


# --- closed forms ---


def test_two_opposed_soft_fingers():
    mu, gamma, half, length = 0.6, 0.01, 0.03, 0.05
    grasp = two_soft(mu, gamma, half, length)
    m = min(mu, mu * half / length, gamma / length)
    assert metrics.epsilon(grasp).number == pytest.approx(m, abs=1e-9)
    assert metrics.epsilon(grasp, "Linf").number == pytest.approx(2 * m / math.sqrt(1 + m * m), abs=1e-9)
    closure = metrics.force_closure(grasp)
    assert closure.closed
    assert closure.margin == pytest.approx(0.5, abs=1e-8)  # the forces already balance along the normals
    assert metrics.smallest_singular_value(grasp).number == pytest.approx(
        math.sqrt(2) * gamma / length, abs=1e-12
    )
    assert metrics.isotropy(grasp).number == pytest.approx(gamma / length, abs=1e-12)
    # Straight up: half of the grip each, at full friction; nothing else binds along the axis.
    margin = metrics.task_margin(grasp, UP, ForceLimits(total=10.0), half_angle=0.0)
    assert margin.number == pytest.approx(mu * 10.0, abs=1e-7)
    # A push along z of 0.1 needs no more than the friction of half a unit of grip at each finger.
    assert metrics.push_residual(grasp).number == pytest.approx(0.0, abs=1e-9)
    assert metrics.push_residual(grasp, UP[None]).number == pytest.approx(1 - 0.6 * mu, abs=1e-9)


def test_two_opposed_hard_fingers_turn_about_their_line():
    grasp = two_soft(gamma=0.0)
    for result in (metrics.force_closure(grasp), metrics.force_closure_linear(grasp)):
        assert (result.closed, result.status) == (False, MetricStatus.RANK_DEFICIENT)
    for measure in (metrics.epsilon(grasp), metrics.volume(grasp), metrics.isotropy(grasp)):
        assert (measure.number, measure.status) == (0.0, MetricStatus.RANK_DEFICIENT)
    spin = metrics.smallest_singular_value(grasp).worst
    assert spin is not None
    np.testing.assert_allclose(np.abs(spin), [0, 0, 0, 1, 0, 0], atol=1e-9)
    assert metrics.task_margin(grasp, UP, ForceLimits(total=1.0)).status is MetricStatus.RANK_DEFICIENT


def test_three_fingers_on_a_disc():
    grasp = three_on_disc(0.5)
    assert metrics.force_closure(grasp).margin == pytest.approx(1 / 3, abs=1e-8)
    lift = metrics.task_margin(grasp, UP, ForceLimits(total=6.0), half_angle=0.0)
    assert lift.number == pytest.approx(0.5 * 6.0, abs=1e-7)


def test_cube_with_six_contacts():
    grasp = six_on_cube(0.4)
    assert metrics.epsilon(grasp).number == pytest.approx(0.4 * math.sqrt(2 / 3), abs=1e-9)
    assert metrics.smallest_singular_value(grasp).number == pytest.approx(2.0, abs=1e-12)
    # Forces: two normals and four tangential contacts, 6; torques: four contacts, 4.
    assert metrics.isotropy(grasp).number == pytest.approx(math.sqrt(4 / 6), abs=1e-12)


def test_volume_of_a_simplex():
    grasp = random_grasp(3, 6, torsion=0.0, mu=0.0)
    exact = abs(np.linalg.det(metrics.generators(grasp, 4)[:, 0])) / math.factorial(6)
    assert metrics.volume(grasp, edges=4).number == pytest.approx(exact, rel=1e-9)


def test_a_load_that_cannot_be_held_and_a_task_that_cannot_be_done():
    grasp = two_soft()
    heavy = metrics.task_margin(grasp, UP, ForceLimits(total=1.0), load=-2.0 * UP)
    assert (heavy.number, heavy.status) == (None, MetricStatus.LOAD_NOT_HELD)
    palm = Contacts(
        positions=[[0.03, 0, 0], [-0.02, 0.03, 0], [-0.02, -0.03, 0]],
        normals_in=[[0, 0, 1]] * 3,
        friction=0.5,
        length=0.05,
    )
    assert metrics.force_closure(palm).status is MetricStatus.NOT_CLOSED
    limits = ForceLimits(total=10.0)
    assert metrics.task_margin(palm, -UP, limits).status is MetricStatus.NO_MARGIN
    # An open palm lifts without force closure, and a weight on it lets it push sideways.
    assert metrics.task_margin(palm, UP, limits, half_angle=0.1).status is MetricStatus.OK
    side = np.array([1.0, 0, 0, 0, 0, 0])
    assert metrics.task_margin(palm, side, limits, half_angle=0.0).status is MetricStatus.NO_MARGIN
    loaded = metrics.task_margin(palm, side, limits, half_angle=0.0, load=-2.0 * UP)
    assert loaded.status is MetricStatus.OK


def test_nothing_touches():
    grasp = Contacts(positions=np.zeros((0, 3)), normals_in=np.zeros((0, 3)), friction=0.5, length=1.0)
    results = [
        metrics.force_closure(grasp),
        metrics.force_closure_linear(grasp),
        metrics.epsilon(grasp),
        metrics.volume(grasp),
        metrics.isotropy(grasp),
        metrics.smallest_singular_value(grasp),
        metrics.tdg_gap(grasp),
        metrics.push_residual(grasp),
        metrics.task_margin(grasp, UP, ForceLimits(total=1.0)),
    ]
    assert {result.status for result in results} == {MetricStatus.NO_CONTACTS}


# --- laws ---

SCENES = [two_soft(), three_on_disc(), six_on_cube(), *(closed_grasp(seed) for seed in range(5))]


@pytest.mark.parametrize("grasp", SCENES)
@pytest.mark.parametrize("vector", [[1e-8, 0, 2e-8], [1.4, -1.1, 2.55]])
def test_rigid_motion_changes_nothing(grasp: Contacts, vector: list[float]):
    R = rotation_from_vector(vector)
    volume = grasp.dimension == 3
    before, after = (
        all_numbers(grasp, volume=volume),
        all_numbers(moved(grasp, R, np.array([1.0, -2.0, 0.5])), R, volume=volume),
    )
    assert before.keys() == after.keys()
    for name, number in before.items():
        assert number is not None, name
        assert after[name] == pytest.approx(number, rel=tolerance(name), abs=1e-9), name


@pytest.mark.parametrize("grasp", SCENES)
def test_mirrored_scene(grasp: Contacts):
    n = np.array([0.6, -0.48, 0.64])
    mirror = np.eye(3) - 2 * np.outer(n, n)
    volume = grasp.dimension == 3
    before, after = (
        all_numbers(grasp, volume=volume),
        all_numbers(moved(grasp, mirror, np.zeros(3)), mirror, volume=volume),
    )
    for name, number in before.items():
        assert after[name] == pytest.approx(number, rel=tolerance(name), abs=1e-9), name


@pytest.mark.parametrize("grasp", SCENES[1:5])
def test_size_of_the_scene_changes_nothing(grasp: Contacts):
    bigger = replace(
        grasp,
        positions=grasp.positions * 3.0,
        reference=np.asarray(grasp.reference) * 3.0,
        torsion=np.asarray(grasp.torsion) * 3.0,
        length=grasp.length * 3.0,
    )
    before, after = all_numbers(grasp), all_numbers(bigger)
    for name, number in before.items():
        assert after[name] == pytest.approx(number, rel=tolerance(name), abs=1e-9), name


@pytest.mark.parametrize("seed", range(4))
def test_force_scale(seed: int):
    grasp, load = closed_grasp(seed), -0.02 * UP
    one = metrics.task_margin(grasp, UP, ForceLimits(total=1.0), load=load).number
    ten = metrics.task_margin(grasp, UP, ForceLimits(total=10.0), load=10 * load).number
    assert one is not None
    assert ten == pytest.approx(10 * one, rel=1e-9)


def test_torque_length_scales_only_torques():
    grasp = three_on_disc()
    short = metrics.volume(replace(grasp, length=grasp.length / 2)).number
    whole = metrics.volume(grasp).number
    assert whole is not None
    assert short == pytest.approx(8 * whole, rel=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_more_friction_never_hurts(seed: int):
    last: dict[str, float] = {}
    for mu in (0.2, 0.4, 0.6, 0.9):
        grasp = random_grasp(seed, mu=mu, torsion=0.01 * mu)
        residual = metrics.push_residual(grasp).number
        assert residual is not None
        here = {
            "closed": float(metrics.force_closure(grasp).closed),
            "epsilon": metrics.epsilon(grasp, edges=0).number or 0.0,
            "epsilon Linf": metrics.epsilon(grasp, "Linf", edges=0).number or 0.0,
            "margin": metrics.task_margin(grasp, UP, ForceLimits(total=1.0)).number or 0.0,
            "pushes": -residual,
        }
        for name, number in last.items():
            assert here[name] >= number - 1e-9, name
        last = here


@pytest.mark.parametrize("seed", range(8))
def test_one_more_contact_never_hurts(seed: int):
    whole = random_grasp(seed, 5)
    few = replace(
        whole,
        positions=whole.positions[:4],
        normals_in=whole.normals_in[:4],
        friction=whole.mu[:4],
        torsion=np.asarray(whole.torsion)[:4],
    )
    assert metrics.force_closure(whole).closed >= metrics.force_closure(few).closed
    for norm in metrics.NORMS:
        more, less = (metrics.epsilon(grasp, norm, edges=0).number for grasp in (whole, few))
        assert more is not None
        assert less is not None
        assert more >= less - 1e-9
    for limits in (ForceLimits(total=1.0), ForceLimits(each=1.0)):
        more, less = (metrics.task_margin(grasp, UP, limits).number for grasp in (whole, few))
        assert (more or 0.0) >= (less or 0.0) - 1e-9


def test_tangents_are_square_to_the_normals_and_turn_with_the_scene():
    R = rotation_from_vector([0.3, 2.0, -1.0])
    for grasp in SCENES[1:]:
        first, second = metrics.tangents(grasp)
        frames = np.stack([grasp.normals_in, first, second], axis=1)
        np.testing.assert_allclose(
            frames @ np.swapaxes(frames, 1, 2), np.broadcast_to(np.eye(3), frames.shape), atol=1e-12
        )
        after, _ = metrics.tangents(moved(grasp, R, np.ones(3)))
        np.testing.assert_allclose(after, first @ R.T, atol=1e-9)


# --- bad input ---

GOOD = {"positions": np.eye(3), "normals_in": -np.eye(3), "friction": 0.5, "length": 0.1}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"positions": np.eye(3)[:2]}, "contact normals must be 2×3 numbers, got 3×3"),
        ({"positions": np.ones((3, 2))}, "contact positions must be n×3"),
        ({"positions": np.full((3, 3), np.nan)}, "contact positions must be finite"),
        ({"normals_in": -2 * np.eye(3)}, "contact normals must have length 1, got 2"),
        ({"normals_in": np.zeros((3, 3))}, "contact normals must have length 1, got 0"),
        ({"friction": -0.1}, "friction coefficients must not be negative"),
        ({"friction": [0.5, 0.5]}, "friction coefficients must be 3 numbers, got 2"),
        ({"torsion": np.inf}, "torsional friction coefficients must be finite"),
        ({"length": 0.0}, "characteristic length must be positive"),
        ({"reference": [0.0, 0.0]}, "reference point must be 3 numbers"),
        ({"positions": "here"}, "contact positions must be numbers"),
        ({"normals_in": [[1, 2, 3], [1]]}, "contact normals must be numbers"),
        ({"friction": "high"}, "friction coefficients must be numbers"),
    ],
)
def test_bad_contacts(change: dict[str, object], says: str):
    with pytest.raises(InputError, match=says):
        Contacts(**{**GOOD, **change})  # type: ignore[arg-type]


def test_bad_arguments():
    grasp = three_on_disc()
    one = ForceLimits(total=1.0)
    for call, says in (
        (lambda: metrics.epsilon(grasp, "L2"), "no norm 'L2'; known: L1, Linf"),
        (lambda: metrics.epsilon(grasp, edges=7), "an even number of edges"),
        (lambda: metrics.push_residual(grasp, np.zeros((0, 6))), "at least one"),
        (lambda: metrics.push_residual(grasp, np.zeros((2, 5))), "n×6"),
        (lambda: metrics.push_residual(grasp, friction_share=0.0), "share of friction"),
        (lambda: metrics.tdg_gap(grasp, np.zeros((1, 6))), "none of them six zeros"),
        (lambda: metrics.task_margin(grasp, np.zeros(6), one), "six zeros"),
        (lambda: metrics.task_margin(grasp, UP, one, half_angle=2.0), "half-angle"),
        (lambda: metrics.task_margin(grasp, UP, one, load=[1.0]), "load must be 6 numbers"),
        (lambda: ForceLimits(), "need a total or an each"),
        (lambda: ForceLimits(total=-1.0), "total must be positive"),
        (lambda: ForceLimits(each=math.nan), "each must be positive"),
        (lambda: ForceLimits(total=1.0, torque=np.ones(2)), "together"),
        (
            lambda: ForceLimits(total=1.0, torque=np.zeros(2), jacobian=np.zeros((3, 3, 2))),
            "must be positive",
        ),
        (
            lambda: ForceLimits(total=1.0, torque=np.ones(3), jacobian=np.zeros((3, 3, 2))),
            "torque limits must be 2",
        ),
        (lambda: ForceLimits(total=1.0, torque=np.ones(2), jacobian=np.zeros((3, 4, 2))), "n×3×j or n×6×j"),
        (
            lambda: metrics.task_margin(
                grasp, UP, ForceLimits(total=1.0, torque=np.ones(2), jacobian=np.zeros((2, 3, 2)))
            ),
            "of 2 contacts, the grasp has 3",
        ),
    ):
        with pytest.raises(InputError, match=says):
            call()


def test_public_names():
    assert sorted(metrics.__all__) == metrics.__all__ or set(metrics.__all__) <= set(dir(metrics))
    values = [metrics.epsilon(three_on_disc()).worst, metrics.push_residual(three_on_disc()).forces]
    for array in values:
        assert array is not None
        assert not array.flags.writeable
