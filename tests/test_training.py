"""Training: exact gradients, the first training of the cube, and learning without forgetting."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from preshape.exceptions import InputError
from preshape.hands.load import load_hand
from preshape.hiis.analyser import HandLayout
from preshape.hiis.estimator import decode, inputs, predict
from preshape.hiis.fuzzy import FuzzySets
from preshape.hiis.lbfgs import minimise
from preshape.hiis.learning import experiences_of, explore, learn, seed_experiences, seed_tasks, training_set
from preshape.hiis.training import (
    TARGET_ERROR,
    WITHIN,
    back_propagation,
    initial_weights,
    loss_and_gradient,
    mean_square_error,
    train,
)
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.objects.library import load_library_object
from preshape.studies.table_4 import reach
from preshape.types import Experience, NetworkWeights

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def layout() -> HandLayout:
    hand = load_hand("utah_mit")
    return HandLayout(
        name=hand.name, u=hand.u, finger_pitch=hand.finger_pitch, fingertip_width=hand.fingertip_width
    )


@pytest.fixture(scope="module")
def seeds(layout: HandLayout) -> list[Experience]:
    analyser = RayAnalyser(load_library_object("cube"), layout)
    return seed_experiences(analyser, FuzzySets(), enough=3.0)


@pytest.fixture(scope="module")
def seed_set(seeds: list[Experience], layout: HandLayout) -> tuple[Array, Array]:
    return training_set(seeds, layout.u)


def small_problem(seed: int, n: int = 5) -> tuple[Array, Array, Array]:
    """Weights in a row, inputs and bits of a small network (4-3-2)."""
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(n, 4)), rng.integers(0, 2, (n, 2)).astype(np.float64)
    return rng.normal(size=3 * 4 + 3 + 2 * 3 + 2), x, y


def same_weights(a: NetworkWeights, b: NetworkWeights) -> bool:
    return all(np.array_equal(getattr(a, k), getattr(b, k)) for k in ("w1", "b1", "w2", "b2"))


# --- gradient -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("decay", [0.0, 1e-6, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_gradient_against_finite_differences(decay: float, seed: int) -> None:
    theta, x, y = small_problem(seed)
    _, gradient = loss_and_gradient(theta, x, y, decay=decay)
    step = 1e-6
    for k, unit in enumerate(np.eye(len(theta))):
        ahead = loss_and_gradient(theta + step * unit, x, y, decay=decay)[0]
        behind = loss_and_gradient(theta - step * unit, x, y, decay=decay)[0]
        assert gradient[k] == pytest.approx((ahead - behind) / (2 * step), rel=1e-5, abs=1e-9)


def test_gradient_of_the_whole_network_along_random_directions() -> None:
    rng = np.random.default_rng(4)
    w = initial_weights(4)
    theta = np.concatenate([p.ravel() for p in (w.w1, w.b1, w.w2, w.b2)])
    x, y = rng.normal(size=(20, 13)), rng.integers(0, 2, (20, 9)).astype(np.float64)
    _, gradient = loss_and_gradient(theta, x, y, decay=0.01)
    for _ in range(10):
        d = rng.normal(size=len(theta))
        ahead, behind = (loss_and_gradient(theta + s * 1e-6 * d, x, y, decay=0.01)[0] for s in (1, -1))
        assert gradient @ d == pytest.approx((ahead - behind) / 2e-6, rel=1e-5)


@pytest.mark.parametrize("samples", [5, 700])
def test_the_loss_by_its_definition(samples: int) -> None:
    theta, x, y = small_problem(7, samples)  # 1400 outputs: more factors than one product can have
    w1, b1, w2, b2 = theta[:12].reshape(3, 4), theta[12:15], theta[15:21].reshape(2, 3), theta[21:]
    hidden = 1 / (1 + np.exp(-(x @ w1.T + b1)))
    out = 1 / (1 + np.exp(-(hidden @ w2.T + b2)))
    entropy = -np.mean(y * np.log(out) + (1 - y) * np.log(1 - out))
    weights = 0.5 * 0.2 * np.sum(theta**2)
    assert loss_and_gradient(theta, x, y)[0] == pytest.approx(entropy, rel=1e-13)
    assert loss_and_gradient(theta, x, y, decay=0.2)[0] == pytest.approx(entropy + weights, rel=1e-13)


def test_cross_entropy_of_saturated_units_is_finite() -> None:
    theta, x, y = small_problem(8)
    value, gradient = loss_and_gradient(1e4 * theta, x, y)
    assert np.isfinite(value)
    assert np.isfinite(gradient).all()


# --- L-BFGS -------------------------------------------------------------------------------------------


def rosenbrock(x: Array) -> tuple[float, Array]:
    a, b = x[1:] - x[:-1] ** 2, 1 - x[:-1]
    gradient = np.zeros_like(x)
    gradient[:-1] = -400 * x[:-1] * a - 2 * b
    gradient[1:] += 200 * a
    return float(np.sum(100 * a**2 + b**2)), gradient


def test_l_bfgs_finds_the_minimum_at_the_end_of_a_curved_valley() -> None:
    start = np.tile([-1.2, 1.0], 10)
    course = [rosenbrock(start)[0]]
    points = []

    def finished(point: Array, iteration: int) -> bool:
        course.append(rosenbrock(point)[0])
        points.append(point)
        assert iteration == len(points)
        return False

    found = minimise(rosenbrock, start, finished=finished)
    assert found == pytest.approx(np.ones(20), abs=1e-7)
    assert all(a > b for a, b in pairwise(course))
    assert 20 < len(points) < 250  # more steps than are remembered
    again = minimise(rosenbrock, start, finished=lambda point, iteration: iteration == 3)
    assert np.array_equal(again, points[2])
    assert np.array_equal(minimise(rosenbrock, np.ones(20), finished=finished), np.ones(20))


def test_directions_of_l_bfgs_are_those_of_the_two_loops() -> None:
    # Each step is accepted as it is where the function decreases enough, so the points show the directions.
    rng = np.random.default_rng(1)
    basis = rng.normal(size=(40, 40))
    hessian = basis @ basis.T + np.eye(40)

    def quadratic(x: Array) -> tuple[float, Array]:
        return float(0.5 * x @ hessian @ x), hessian @ x

    points = [rng.normal(size=40)]
    minimise(quadratic, points[0], finished=lambda point, k: points.append(point) or k == 35)
    steps = [b - a for a, b in pairwise(points)]
    pairs = [(s, hessian @ s) for s in steps]
    for k in (1, 5, 20, 21, 34):
        q, shares = hessian @ points[k], []
        for s, y in reversed(pairs[max(k - 20, 0) : k]):
            shares.append((s @ q) / (s @ y))
            q = q - shares[-1] * y
        s, y = pairs[k - 1]
        q = q * (s @ y) / (y @ y)
        for (s, y), share in zip(pairs[max(k - 20, 0) : k], reversed(shares), strict=True):
            q = q + (share - (y @ q) / (s @ y)) * s
        along = steps[k] @ q / np.linalg.norm(steps[k]) / np.linalg.norm(q)
        assert along == pytest.approx(-1, abs=1e-6)


# --- the first training -------------------------------------------------------------------------------


def test_the_seed_set_is_the_cube_under_tasks_of_both_kinds(
    seeds: list[Experience], seed_set: tuple[Array, Array]
) -> None:
    tasks = seed_tasks()
    assert tasks.shape == (48, 6)
    assert [1.0, 1.0, 0.1, 0.05, 0.8, 0.05] in tasks.tolist()  # Q1
    assert [1.0, 1.0, 0.1, 0.8, 0.05, 0.05] in tasks.tolist()  # Q2
    assert set(np.unique(tasks)) == {-1.0, -0.8, 0.05, 0.1, 0.8, 1.0}
    assert (np.abs(tasks[:, :3]) == 1).sum(axis=1).tolist() == [2] * 48
    assert (np.abs(tasks[:, 3:]) == 0.8).sum(axis=1).tolist() == [1] * 48
    assert len(seeds) == 48
    assert {e.kind for e in seeds} == {"seed"}
    assert {e.object_name for e in seeds} == {"cube"}
    x, y = seed_set
    assert x.shape[1:] == (13,)
    assert y.shape == (len(x), 9)
    assert set(np.unique(y)) == {0.0, 1.0}


def test_the_48_seed_tasks_are_48_samples(seed_set: tuple[Array, Array]) -> None:
    # PAPER.md §4: "the twelve planes' Q1- and Q2-type tasks, both signs (48 samples)".
    assert len(np.unique(seed_tasks(), axis=0)) == 48
    assert len(seed_set[0]) == 48


@pytest.mark.parametrize("seed", [0, 1, 7, 1234])
def test_the_seed_set_is_learnt_with_every_code_read_right(
    seed: int, seeds: list[Experience], seed_set: tuple[Array, Array], layout: HandLayout
) -> None:
    x, y = seed_set
    w = train(x, y, seed=seed)
    assert mean_square_error(w, x, y) <= TARGET_ERROR == 5e-4
    assert w.mean_square_error == pytest.approx(mean_square_error(w, x, y), rel=1e-12)
    assert w.mean_square_error == pytest.approx(np.mean((predict(w, x) - y) ** 2), rel=1e-12)
    assert w.trained_on == len(x)
    assert w.epochs > 0
    assert (np.abs(predict(w, x) - y) < 0.5).all()
    for e in seeds:
        found = decode(predict(w, inputs(e.task, e.attributes, layout.u)))
        assert (found.plane, found.approach_set, found.fingers) == (e.plane, e.approach_set, e.fingers)


def test_initial_weights_spread_by_one_over_the_root_of_the_fan_in() -> None:
    layers = (100, 400, 25)
    w = initial_weights(3, layers)
    for found, fan_in in ((w.w1, 100), (w.b1, 100), (w.w2, 400)):
        error = 4 / np.sqrt(found.size)  # four standard errors of the mean; of the spread it is less
        assert abs(found.mean()) * np.sqrt(fan_in) < error
        assert found.std() * np.sqrt(fan_in) == pytest.approx(1, abs=error)
    assert not w.b2.any()
    assert (w.mean_square_error, w.trained_on, w.epochs) == (1.0, 0, 0)


def test_same_seed_same_weights_bit_for_bit(seed_set: tuple[Array, Array]) -> None:
    x, y = seed_set
    first, second, other = train(x, y, seed=3), train(x, y, seed=3), train(x, y, seed=4)
    assert same_weights(first, second)
    assert not same_weights(first, other)
    assert same_weights(initial_weights(5), initial_weights(5))
    assert not same_weights(initial_weights(5), initial_weights(6))


def test_weights_that_know_it_already_are_returned_as_they_are(seed_set: tuple[Array, Array]) -> None:
    x, y = seed_set
    w = train(x, y)
    again = train(x, y, start=w)
    assert same_weights(again, w)
    assert again.epochs == 0


def test_other_objects_are_learnt_and_nothing_is_forgotten(
    seeds: list[Experience], layout: HandLayout
) -> None:
    known = list(seeds)
    first = len(training_set(known, layout.u)[0])
    weights = learn(known, layout.u, None)
    for name in ("box", "mug", "hammer"):
        analyser = RayAnalyser(load_library_object(name), layout)
        for q in seed_tasks()[:4]:
            discovery = explore(analyser, q, FuzzySets(), enough=3.0)
            assert discovery is not None
            known += experiences_of(analyser, name, q, discovery, FuzzySets())
        before = weights
        weights = learn(known, layout.u, weights)
        assert not same_weights(weights, before)
        x, y = training_set(known, layout.u)
        assert weights.trained_on == len(x)
        assert mean_square_error(weights, x, y) <= TARGET_ERROR
        bits = (predict(weights, x) > 0.5).astype(np.float64)
        assert np.array_equal(bits, y)  # the cube's and everything since
    assert len(x) >= first + 3 * 4


def test_samples_that_contradict_each_other_do_not_hang_or_raise() -> None:
    x = np.zeros((2, 13))
    y = np.array([np.zeros(9), np.ones(9)])
    w = train(x, y)
    assert w.mean_square_error == pytest.approx(0.25, abs=1e-3)
    assert predict(w, x) == pytest.approx(np.full((2, 9), 0.5), abs=0.01)


@pytest.mark.parametrize(
    ("x", "y"), [((0, 13), (0, 9)), ((3, 13), (4, 9)), ((13,), (9,)), ((3, 13), (3,)), ((3, 13, 1), (3, 9))]
)
def test_bad_samples_are_refused(x: tuple[int, ...], y: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="n inputs and n outputs"):
        train(np.zeros(x), np.zeros(y))
    with pytest.raises(InputError, match="n inputs and n outputs"):
        back_propagation(np.zeros(x), np.zeros(y), [initial_weights(0)], seeds=[0], rates=[0.1], epochs=1)


# --- back-propagation ---------------------------------------------------------------------------------


def samples_of(seed: int, n: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, 13)), rng.integers(0, 2, (n, 9)).astype(np.float64)


def back_propagated(
    x: Array, y: Array, seed: int, epochs: int, *, start: NetworkWeights | None = None, rate: float = 0.5
) -> tuple[Array, NetworkWeights]:
    """One network alone: its errors and its weights."""
    begin = initial_weights(seed, within=WITHIN) if start is None else start
    errors, (w,) = back_propagation(x, y, [begin], seeds=[seed], rates=[rate], epochs=epochs)
    return errors[0], w


def flat(w: NetworkWeights) -> Array:
    return np.concatenate([w.w1.ravel(), w.b1, w.w2.ravel(), w.b2])


def with_weights(theta: Array) -> NetworkWeights:
    return NetworkWeights(
        w1=theta[:585].reshape(45, 13), b1=theta[585:630], w2=theta[630:1035].reshape(9, 45), b2=theta[1035:],
        mean_square_error=1.0, trained_on=0, epochs=0,
    )  # fmt: skip


def half_square(theta: Array, x: Array, y: Array) -> float:
    return 0.5 * float(np.sum((predict(with_weights(theta), x) - (0.1 + 0.8 * y)) ** 2))


def test_a_step_is_the_gradient_of_the_samples_error() -> None:
    x, y = samples_of(5, 1)
    begin = initial_weights(6)  # wider than the paper's, so that no derivative is near 0
    _, after = back_propagated(x, y, 6, 1, start=begin, rate=0.3)
    theta = flat(begin)
    for k, step in enumerate(flat(after) - theta):
        ahead, behind = (half_square(theta + s * 1e-5 * np.eye(1, 1044, k)[0], x, y) for s in (1, -1))
        assert step == pytest.approx(-0.3 * (ahead - behind) / 2e-5, rel=1e-5, abs=1e-10)


def test_each_step_starts_from_the_weights_of_the_last_one() -> None:
    x, y = samples_of(2, 2)
    _, found = back_propagated(x, y, 11, 1)
    begin = initial_weights(11, within=WITHIN)
    gaps = []
    for order in ((0, 1), (1, 0)):
        w = begin
        for i in order:
            _, w = back_propagated(x[[i]], y[[i]], 11, 1, start=w)
        gaps.append(np.abs(flat(w) - flat(found)).max())
    assert min(gaps) == 0.0  # one of the two orders
    assert max(gaps) > 1e-6  # and the order matters: sample by sample, not all at once


def test_networks_side_by_side_are_networks_alone_bit_for_bit(seed_set: tuple[Array, Array]) -> None:
    x, y = seed_set
    seeds, rates = [3, 0, 4], [0.04, 0.5, 0.04]
    begin = [initial_weights(seed, within=WITHIN) for seed in seeds]
    errors, networks = back_propagation(x, y, begin, seeds=seeds, rates=rates, epochs=4)
    assert errors.shape == (3, 4)
    for seed, rate, course, w in zip(seeds, rates, errors, networks, strict=True):
        alone, other = back_propagated(x, y, seed, 4, rate=rate)
        assert np.array_equal(course, alone)
        assert same_weights(w, other)
        half, middle = back_propagated(x, y, seed, 2, rate=rate)
        rest, end = back_propagated(x, y, seed, 2, start=middle, rate=rate)
        assert np.array_equal(course, np.concatenate([half, rest]))
        assert same_weights(w, end)
        assert (middle.epochs, end.epochs, end.trained_on) == (2, 4, len(x))
    assert not same_weights(networks[0], networks[2])


def test_orders_are_random_and_each_sample_comes_once(seed_set: tuple[Array, Array]) -> None:
    # At a rate of 0 nothing is learnt, so an epoch's error is that of all samples, each presented once.
    x, y = seed_set
    begin = initial_weights(0, within=WITHIN)
    errors, w = back_propagated(x, y, 0, 3, rate=0.0)
    assert same_weights(w, begin)
    wanted = np.mean((predict(begin, x) - (0.1 + 0.8 * y)) ** 2)
    assert errors == pytest.approx(np.full(3, wanted), rel=1e-12)
    assert w.mean_square_error == pytest.approx(wanted, rel=1e-12)
    assert not same_weights(
        back_propagated(x, y, 0, 1, start=begin)[1], back_propagated(x, y, 1, 1, start=begin)[1]
    )


def test_first_weights_are_within_their_limit() -> None:
    w = initial_weights(3, within=WITHIN)
    assert 0.09 < np.abs(flat(w)).max() <= WITHIN == 0.1
    assert all(np.abs(part).max() > 0 for part in (w.w1, w.b1, w.w2, w.b2))


def test_a_short_training_reaches_a_loose_error_and_continues_where_it_stopped(
    seed_set: tuple[Array, Array], tmp_path: Path
) -> None:
    x, y = (part[:6] for part in seed_set)
    targets, planned = (0.1, 0.01, 0.002), [(0.5, 0), (0.3, 7)]
    labels: list[str] = []

    def reached(part: Path, stop_at: int = -1) -> list[dict[str, Any]]:
        def progress(fraction: float, label: str) -> None:
            labels.append(label)
            if label.startswith(f"back-propagation: epoch {stop_at},"):
                raise KeyboardInterrupt

        return reach(x, y, targets, planned, limit=2000, part=part, progress=progress)["runs"]

    runs = reached(tmp_path / "whole")
    for (rate, seed), run in zip(planned, runs, strict=True):
        assert (run["rate"], run["seed"]) == (rate, seed)
        errors, w = back_propagated(x, y, seed, run["reached"][-1], rate=rate)
        assert run["reached"] == [int(np.argmax(errors <= target)) + 1 for target in targets]
        assert mean_square_error(w, x, 0.1 + 0.8 * y) <= 0.002
        assert all(error == errors[epoch - 1] for epoch, error in run["curve"] if epoch <= len(errors))
        assert run["curve"][0][0] == 1
    with pytest.raises(KeyboardInterrupt):
        reached(tmp_path / "part", stop_at=250)
    begun = len(labels)
    assert reached(tmp_path / "part") == runs
    assert labels[begun].startswith("back-propagation: epoch 250,")


def test_a_target_out_of_reach_is_none(seed_set: tuple[Array, Array], tmp_path: Path) -> None:
    x, y = (part[:4] for part in seed_set)
    (run,) = reach(
        x,
        y,
        (0.9, 1e-12),
        [(0.5, 0)],
        limit=20,
        part=tmp_path / "part",
        progress=lambda fraction, label: None,
    )["runs"]
    assert run["reached"] == [1, None]
    assert run["curve"][-1][0] <= 20


# --- the same weights on every machine ----------------------------------------------------------------

SCRIPT = """
import sys
import numpy as np
from preshape.hiis.training import WITHIN, back_propagation, initial_weights, train

with np.load(sys.argv[1]) as file:
    x, y = file["x"], file["y"]
learnt = train(x, y, seed=1)
errors, networks = back_propagation(
    x, y, [initial_weights(0, within=WITHIN)], seeds=[0], rates=[0.04], epochs=3
)
for w in (learnt, *networks):
    print("weights", *(part.tobytes().hex() for part in (w.w1, w.b1, w.w2, w.b2)))
print("product", (learnt.w1 @ x.T).tobytes().hex())
print("exponential", np.exp(learnt.w1).tobytes().hex())
"""


def kernels() -> list[dict[str, str]]:
    """Settings that make NumPy and its BLAS use other kernels, which this processor has."""
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    wide = [name for name in found if name.startswith(("X86_V4", "AVX512"))]
    middle = [name for name in found if name in ("X86_V3", "AVX2", "FMA3", "AVX", "F16C")]
    settings = [{"OPENBLAS_CORETYPE": "Nehalem"}]
    settings += [
        {"OPENBLAS_CORETYPE": "Haswell"},
        {"NPY_DISABLE_CPU_FEATURES": " ".join(middle + wide)},
    ] * bool(middle)
    settings += [{"OPENBLAS_CORETYPE": "SkylakeX"}, {"NPY_DISABLE_CPU_FEATURES": " ".join(wide)}] * bool(wide)
    return settings if platform.machine() in ("x86_64", "AMD64") else []


@pytest.mark.slow
def test_weights_do_not_depend_on_the_kernels_of_blas_and_numpy(
    seed_set: tuple[Array, Array], tmp_path: Path
) -> None:
    np.savez(tmp_path / "set.npz", x=seed_set[0], y=seed_set[1])
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", SCRIPT, tmp_path / "set.npz"],
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"} | setting,
            stdout=subprocess.PIPE,
            text=True,
        )
        for setting in ({}, *kernels())
    ]
    lines = [run.communicate()[0].splitlines() for run in runs]
    assert [run.returncode for run in runs] == [0] * len(runs)
    assert [len(part) for part in lines] == [4] * len(runs)
    if len({(product, exponential) for *_, product, exponential in lines}) == 1:
        pytest.skip("this machine has one kernel of BLAS and NumPy")
    assert len({(learnt, propagated) for learnt, propagated, *_ in lines}) == 1
