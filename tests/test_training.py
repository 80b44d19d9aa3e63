"""Training: exact gradients, the first training of the cube, and learning without forgetting."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from preshape.exceptions import InputError
from preshape.hands.load import load_hand
from preshape.hiis.analyser import HandLayout
from preshape.hiis.estimator import decode, inputs, predict
from preshape.hiis.fuzzy import FuzzySets
from preshape.hiis.learning import experiences_of, explore, learn, seed_experiences, seed_tasks, training_set
from preshape.hiis.training import (
    TARGET_ERROR,
    back_propagation,
    initial_weights,
    loss_and_gradient,
    mean_square_error,
    train,
)
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.objects.library import load_library_object
from preshape.types import Experience, NetworkWeights

Array = NDArray[np.float64]
LOSSES = ("squared", "entropy")


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


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("decay", [0.0, 1e-6, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_gradient_against_finite_differences(loss: str, decay: float, seed: int) -> None:
    theta, x, y = small_problem(seed)
    _, gradient = loss_and_gradient(theta, x, y, loss=loss, decay=decay)
    step = 1e-6
    for k, unit in enumerate(np.eye(len(theta))):
        ahead = loss_and_gradient(theta + step * unit, x, y, loss=loss, decay=decay)[0]
        behind = loss_and_gradient(theta - step * unit, x, y, loss=loss, decay=decay)[0]
        assert gradient[k] == pytest.approx((ahead - behind) / (2 * step), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("loss", LOSSES)
def test_gradient_of_the_whole_network_along_random_directions(loss: str) -> None:
    rng = np.random.default_rng(4)
    w = initial_weights(4)
    theta = np.concatenate([p.ravel() for p in (w.w1, w.b1, w.w2, w.b2)])
    x, y = rng.normal(size=(20, 13)), rng.integers(0, 2, (20, 9)).astype(np.float64)
    _, gradient = loss_and_gradient(theta, x, y, loss=loss, decay=0.01)
    for _ in range(10):
        d = rng.normal(size=len(theta))
        ahead, behind = (
            loss_and_gradient(theta + s * 1e-6 * d, x, y, loss=loss, decay=0.01)[0] for s in (1, -1)
        )
        assert gradient @ d == pytest.approx((ahead - behind) / 2e-6, rel=1e-5)


def test_both_losses_by_their_definitions() -> None:
    theta, x, y = small_problem(7)
    w1, b1, w2, b2 = theta[:12].reshape(3, 4), theta[12:15], theta[15:21].reshape(2, 3), theta[21:]
    hidden = 1 / (1 + np.exp(-(x @ w1.T + b1)))
    out = 1 / (1 + np.exp(-(hidden @ w2.T + b2)))
    squared = np.mean((out - y) ** 2)
    entropy = -np.mean(y * np.log(out) + (1 - y) * np.log(1 - out))
    weights = 0.5 * 0.2 * np.sum(theta**2)
    assert loss_and_gradient(theta, x, y, loss="squared")[0] == pytest.approx(squared)
    assert loss_and_gradient(theta, x, y, loss="entropy")[0] == pytest.approx(entropy)
    assert loss_and_gradient(theta, x, y, loss="squared", decay=0.2)[0] == pytest.approx(squared + weights)
    assert loss_and_gradient(theta, x, y, loss="entropy", decay=0.2)[0] == pytest.approx(entropy + weights)


def test_cross_entropy_of_saturated_units_is_finite() -> None:
    theta, x, y = small_problem(8)
    value, gradient = loss_and_gradient(1e4 * theta, x, y, loss="entropy")
    assert np.isfinite(value)
    assert np.isfinite(gradient).all()


def test_an_unknown_loss_is_not_taken_for_another_one() -> None:
    theta, x, y = small_problem(9)
    with pytest.raises(InputError):
        loss_and_gradient(theta, x, y, loss="square")


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
        back_propagation(np.zeros(x), np.zeros(y), targets=(0.1,))


# --- back-propagation ---------------------------------------------------------------------------------


def epoch_by_hand(
    w: NetworkWeights,
    x: Array,
    y: Array,
    order: tuple[int, ...],
    rate: float,
    momentum: float,
    epochs: int = 1,
) -> list[Array]:
    """Plain loops over samples, units and weights."""
    w1, b1, w2, b2 = (np.array(p) for p in (w.w1, w.b1, w.w2, w.b2))
    last = [np.zeros_like(p) for p in (w1, b1, w2, b2)]
    for _ in range(epochs):
        for i in order:
            hidden = np.array([1 / (1 + np.exp(-(w1[j] @ x[i] + b1[j]))) for j in range(len(b1))])
            out = np.array([1 / (1 + np.exp(-(w2[m] @ hidden + b2[m]))) for m in range(len(b2))])
            local2 = [(out[m] - y[i, m]) * out[m] * (1 - out[m]) for m in range(len(b2))]
            local1 = [
                sum(local2[m] * w2[m, j] for m in range(len(b2))) * hidden[j] * (1 - hidden[j])
                for j in range(len(b1))
            ]
            slopes = [np.outer(local1, x[i]), np.array(local1), np.outer(local2, hidden), np.array(local2)]
            last = [momentum * v - rate * g for v, g in zip(last, slopes, strict=True)]
            w1, b1, w2, b2 = (p + v for p, v in zip((w1, b1, w2, b2), last, strict=True))
    return [w1, b1, w2, b2]


@pytest.mark.parametrize("momentum", [0.0, 0.6])
@pytest.mark.parametrize("rate", [0.5, 0.05])
def test_one_epoch_equals_a_computation_by_hand(rate: float, momentum: float) -> None:
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(2, 13)), rng.integers(0, 2, (2, 9)).astype(np.float64)
    reached, w = back_propagation(x, y, targets=(0.0,), seed=11, rate=rate, momentum=momentum, max_epochs=1)
    assert reached == [None]
    assert (w.epochs, w.trained_on) == (1, 2)
    found = [w.w1, w.b1, w.w2, w.b2]
    begin = initial_weights(11)
    wanted = [epoch_by_hand(begin, x, y, order, rate, momentum) for order in ((0, 1), (1, 0))]
    gaps = [max(np.abs(f - g).max() for f, g in zip(found, other, strict=True)) for other in wanted]
    assert min(gaps) < 1e-13  # in one of the two orders
    assert max(gaps) > 1e-9  # and the order matters: sample by sample, not all at once


def test_several_epochs_of_one_sample_equal_a_computation_by_hand() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(1, 13)), rng.integers(0, 2, (1, 9)).astype(np.float64)
    _, w = back_propagation(x, y, targets=(0.0,), seed=5, rate=0.3, momentum=0.4, max_epochs=7)
    wanted = epoch_by_hand(initial_weights(5), x, y, (0,), 0.3, 0.4, epochs=7)
    for found, other in zip((w.w1, w.b1, w.w2, w.b2), wanted, strict=True):
        assert np.allclose(found, other, rtol=0, atol=1e-12)


def test_back_propagation_goes_down_and_reaches_targets_in_order(seed_set: tuple[Array, Array]) -> None:
    x, y = (part[:6] for part in seed_set)
    targets = (0.1, 0.05, 0.02)
    errors: list[tuple[int, float]] = []
    reached, w = back_propagation(
        x, y, targets=targets, max_epochs=2000, progress=lambda epoch, error: errors.append((epoch, error))
    )
    assert None not in reached
    assert reached == sorted(reached)  # type: ignore[type-var]
    assert w.epochs == reached[-1]  # it stops there
    short, _ = back_propagation(x, y, targets=targets[:1], max_epochs=2000)
    assert short == reached[:1]
    start = initial_weights(0)
    assert mean_square_error(w, x, y) < 0.25 * mean_square_error(start, x, y)
    assert [epoch for epoch, _ in errors] == sorted(epoch for epoch, _ in errors)
    assert all(a[1] >= b[1] for a, b in pairwise(errors))


def test_a_target_out_of_reach_is_none(seed_set: tuple[Array, Array]) -> None:
    x, y = (part[:4] for part in seed_set)
    reached, w = back_propagation(x, y, targets=(0.9, 1e-12), max_epochs=20)
    assert reached == [1, None]
    assert w.epochs == 20


def test_back_propagation_is_the_same_at_every_run(seed_set: tuple[Array, Array]) -> None:
    x, y = (part[:4] for part in seed_set)
    runs = [back_propagation(x, y, targets=(0.0,), seed=seed, max_epochs=5)[1] for seed in (1, 1, 2)]
    assert same_weights(runs[0], runs[1])
    assert not same_weights(runs[0], runs[2])


def test_the_error_kept_with_the_weights_is_theirs(seed_set: tuple[Array, Array]) -> None:
    # NetworkWeights.mean_square_error is "on the training set": of these weights, not of those before them.
    x, y = (part[:6] for part in seed_set)
    _, w = back_propagation(x, y, targets=(0.0,), max_epochs=3)
    assert w.mean_square_error == pytest.approx(mean_square_error(w, x, y), rel=1e-9)
