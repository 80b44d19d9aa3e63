"""Training of the approach estimator: L-BFGS for use, back-propagation as in the paper (§2.2, §3.5).

The reported error is always the paper's: the squared error, averaged over samples and outputs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from decimal import Context, Decimal

import numpy as np

from ..exceptions import InputError
from ..types import Array, NetworkWeights
from .estimator import LAYERS, predict, sigmoid, weighted_sums
from .lbfgs import minimise

TARGET_ERROR = 5e-4
"""Mean-square error at which training stops: the smallest of table 4 [P]."""

MOST_SAMPLES = 1500
"""Largest number of samples that are trained on together; up to here, all of them are."""

TARGETS, WITHIN = (0.1, 0.9), 0.1
"""Back-propagation: outputs for the bits 0 and 1, and limit of the first weights [R]."""

_DECAYS = (1e-5, 1e-6, 1e-7)
"""Weight decays, tried in this order until the target error is met. A larger decay makes the network more
tolerant of disturbed tasks [C]."""
_PRECISION = Context(prec=17)
_LN2 = float(_PRECISION.ln(Decimal(2)))
_MANY_WRONG = 0.05  # share of wrongly read codes with which weights count as no good start
_SURE = 0.45  # largest distance of an output from its bit; at 0.5 the code would be read wrongly


def initial_weights(
    seed: int, layers: tuple[int, int, int] = LAYERS, *, within: float | None = None
) -> NetworkWeights:
    """Random weights, uniformly distributed: a normal draw needs logarithms, which differ between machines.

    Args:
        seed: Seed of the draws.
        layers: Numbers of inputs, hidden units and outputs.
        within: Limit of all weights and biases; by default √(3 / fan-in), for a standard deviation of
            1 / √fan-in, and 0 for the biases of the outputs.
    """
    rng = np.random.default_rng(seed)
    n_in, n_hidden, n_out = layers

    def draw(limit: float, *shape: int) -> Array:
        return limit * (2.0 * rng.random(shape) - 1.0)

    first, second = (math.sqrt(3 / n) if within is None else within for n in (n_in, n_hidden))
    return NetworkWeights(
        w1=draw(first, n_hidden, n_in),
        b1=draw(first, n_hidden),
        w2=draw(second, n_out, n_hidden),
        b2=draw(within or 0.0, n_out),
        mean_square_error=1.0,
        trained_on=0,
        epochs=0,
    )


def mean_square_error(weights: NetworkWeights, x: Array, y: Array) -> float:
    """The paper's error: the mean of (output - bit)² over samples and outputs."""
    return float(np.mean((predict(weights, x) - y) ** 2))


def loss_and_gradient(theta: Array, x: Array, y: Array, *, decay: float = 0.0) -> tuple[float, Array]:
    """Mean cross-entropy of the network and its exact gradient, the same on every x86-64 processor.

    Args:
        theta: (p,) all weights: w1, b1, w2, b2, flattened.
        x: (n, i) inputs.
        y: (n, 9) bits.
        decay: Factor on half the sum of the squared weights.
    """
    w1, b1, w2, b2 = _unpack(theta, x.shape[1], y.shape[1])
    # Samples last: the fastest order for einsum.
    inputs, bits = np.ascontiguousarray(x.T), np.ascontiguousarray(y.T)
    hidden = sigmoid(weighted_sums(w1, b1, inputs))
    z = weighted_sums(w2, b2, hidden)
    out = sigmoid(z)
    # log(1 + exp(-|z|)) + max(z, 0) - z·y is the cross-entropy without overflow.
    value = (float(np.sum(np.maximum(z, 0) - z * bits)) - _sum_of_logs(np.maximum(out, 1 - out))) / y.size
    delta2 = (out - bits) / y.size
    delta1 = np.einsum("oh,on->hn", w2, delta2) * hidden * (1 - hidden)
    gradient = np.concatenate(
        [
            np.einsum("hn,in->hi", delta1, inputs).ravel(), delta1.sum(axis=1),
            np.einsum("on,hn->oh", delta2, hidden).ravel(), delta2.sum(axis=1),
        ]
    )  # fmt: skip
    return value + 0.5 * decay * float(np.sum(theta * theta)), gradient + decay * theta


def _sum_of_logs(numbers: Array) -> float:
    """Sum of the logarithms of numbers in 0.5..1, as that of their product, which needs only one logarithm.

    The logarithm is that of ``decimal``, which is rounded correctly; those of NumPy and C are not.
    """
    # A thousand factors do not underflow; between the thousands, the exponents are kept apart.
    products = np.multiply.reduceat(numbers.ravel(), np.arange(0, numbers.size, 1000))
    mantissas, exponents = np.frexp(products)
    mantissa = Decimal(float(np.multiply.reduce(mantissas)))
    return float(_PRECISION.ln(mantissa)) + int(exponents.sum()) * _LN2


def train(
    x: Array, y: Array, *, start: NetworkWeights | None = None, seed: int = 0, target: float = TARGET_ERROR
) -> NetworkWeights:
    """Train for use: L-BFGS on cross-entropy, with the earlier weights as warm start.

    Training stops when the mean-square error meets the target and every output is on the correct side of 0.5.
    If the earlier weights do not lead there, training starts again from fresh weights, up to three times.
    More than ``MOST_SAMPLES`` samples are learnt in rounds (:func:`_train_in_rounds`), so that the work does
    not grow with the memory.

    Args:
        x: (n, i) inputs, 13 in the paper.
        y: (n, 9) bits.
        start: Weights to continue from (incremental learning, §3.5).
        seed: Seed of the fresh weights.
        target: Mean-square error at which training stops.
    """
    _check_samples(x, y)
    layers = (x.shape[1], LAYERS[1], y.shape[1])
    fresh = (initial_weights(seed + i, layers) for i in range(3))
    attempts = [*([start] if start is not None else []), *fresh]
    if len(x) > MOST_SAMPLES:
        return _train_in_rounds(x, y, attempts[:2], target)
    best: NetworkWeights | None = None
    for begin in attempts:
        done = begin
        for decay in _DECAYS:
            done = _descend(x, y, done, target, decay)
            if _learned(done, x, y, target):
                return done
        if best is None or done.mean_square_error < best.mean_square_error:
            best = done
    assert best is not None
    return best


def _train_in_rounds(x: Array, y: Array, attempts: Sequence[NetworkWeights], target: float) -> NetworkWeights:
    """Train on a part of many samples at a time; the work is bounded, however many there are [C].

    1. Each round takes the samples that the network gets wrong, the latest first, as at most half of
       ``MOST_SAMPLES``; the others are spread evenly over all samples and keep it from forgetting.
    2. It descends on these, each round with a smaller decay, until they are learnt.
    3. Rounds end once all samples are learnt. The second attempt is made only if the first ends with more
       than ``_MANY_WRONG`` of all samples wrong. The smallest error over all samples wins.
    """
    best: NetworkWeights | None = None
    for begin in attempts:
        done = begin
        for decay in _DECAYS:
            wrong = np.flatnonzero(_furthest(done, x, y) >= _SURE)[-MOST_SAMPLES // 2 :]
            spread = np.linspace(0, len(x) - 1, MOST_SAMPLES - len(wrong)).astype(np.int64)
            part = np.union1d(wrong, spread)
            found = _descend(x[part], y[part], done, target, decay)
            done = _measured(found.w1, found.b1, found.w2, found.b2, x, y, done.epochs + found.epochs)
            if best is None or done.mean_square_error < best.mean_square_error:
                best = done
            if _learned(done, x, y, target):
                return done
        if np.mean(_furthest(done, x, y) >= 0.5) <= _MANY_WRONG:
            break
    assert best is not None
    return best


def back_propagation(
    x: Array,
    y: Array,
    networks: Sequence[NetworkWeights],
    *,
    seeds: Sequence[int],
    rates: Sequence[float],
    epochs: int,
) -> tuple[Array, list[NetworkWeights]]:
    """Continue the paper's training of several networks at once: online back-propagation, as for table 4 [P].

    Each epoch presents every sample once, in a random order of each network's own, and changes the weights
    after each sample, without momentum. The networks do not influence each other, and it changes nothing how
    the epochs are divided into calls. Targets and first weights (:data:`WITHIN`) are those that reproduce
    table 4 [R]: with targets of 0 and 1, a network can stall with an output saturated at the wrong bit.

    Args:
        x: (n, i) inputs.
        y: (n, 9) bits, for which the outputs are to be 0.1 or 0.9.
        networks: m networks.
        seeds: m seeds of the orders.
        rates: m learning rates: factors on the gradient of half the sum of a sample's squared errors.
        epochs: Number of epochs.

    Returns:
        (m, epochs) mean-square error against 0.1 and 0.9, over the samples as they are presented, and the m
        networks, with their errors after the last epoch.
    """
    _check_samples(x, y)
    wanted = TARGETS[0] + (TARGETS[1] - TARGETS[0]) * y
    # A last input of 1 makes the biases weights like the others.
    inputs = np.column_stack([x, np.ones(len(x))])
    w1 = np.array([np.column_stack([w.w1, w.b1]) for w in networks])
    w2 = np.array([np.column_stack([w.w2, w.b2]) for w in networks])
    rate = np.array(rates)[:, None]
    hidden = np.ones((len(networks), w2.shape[2]))
    units = hidden[:, :-1]
    wrong = np.empty((len(x), len(networks), y.shape[1]))
    errors = np.empty((len(networks), epochs))
    for epoch in range(epochs):
        orders = np.transpose(
            [
                np.random.default_rng([seed, w.epochs + epoch]).permutation(len(x))
                for seed, w in zip(seeds, networks, strict=True)
            ]
        )
        for sample, target, off in zip(inputs[orders], wanted[orders], wrong, strict=True):
            units[:] = sigmoid(np.einsum("mhi,mi->mh", w1, sample))
            out = sigmoid(np.einsum("moh,mh->mo", w2, hidden))
            off[:] = out - target
            delta2 = rate * off * out * (1 - out)
            delta1 = np.einsum("moh,mo->mh", w2[:, :, :-1], delta2) * units * (1 - units)
            w2 -= delta2[:, :, None] * hidden[:, None]
            w1 -= delta1[:, :, None] * sample[:, None]
        errors[:, epoch] = [np.mean(wrong[:, m] ** 2) for m in range(len(networks))]
    done = [
        _measured(a[:, :-1], a[:, -1], b[:, :-1], b[:, -1], x, wanted, w.epochs + epochs)
        for a, b, w in zip(w1, w2, networks, strict=True)
    ]
    return errors, done


def _descend(x: Array, y: Array, begin: NetworkWeights, target: float, decay: float) -> NetworkWeights:
    """L-BFGS from given weights, until the samples are learnt or nothing is left to gain."""
    iterations = 0

    def pack(theta: Array) -> NetworkWeights:
        return _measured(*_unpack(theta, x.shape[1], y.shape[1]), x, y, iterations)

    def finished(theta: Array, iteration: int) -> bool:
        nonlocal iterations
        iterations = iteration
        return iteration % 5 == 0 and _learned(pack(theta), x, y, target)

    theta = np.concatenate([w.ravel() for w in (begin.w1, begin.b1, begin.w2, begin.b2)])
    if _learned(pack(theta), x, y, target):
        return pack(theta)
    return pack(minimise(lambda now: loss_and_gradient(now, x, y, decay=decay), theta, finished=finished))


def _measured(w1: Array, b1: Array, w2: Array, b2: Array, x: Array, y: Array, epochs: int) -> NetworkWeights:
    """Weights with their mean-square error on the training set."""
    bare = NetworkWeights(w1=w1, b1=b1, w2=w2, b2=b2, mean_square_error=1.0, trained_on=len(x), epochs=epochs)
    return replace(bare, mean_square_error=mean_square_error(bare, x, y))


def _furthest(weights: NetworkWeights, x: Array, y: Array) -> Array:
    """(n,) largest distance of an output from its bit, for each sample."""
    distances: Array = np.abs(predict(weights, x) - y).max(axis=1)
    return distances


def _learned(weights: NetworkWeights, x: Array, y: Array, target: float) -> bool:
    off = np.abs(predict(weights, x) - y)
    return float(np.mean(off**2)) <= target and bool(off.max() < _SURE)


def _unpack(theta: Array, n_in: int, n_out: int) -> tuple[Array, Array, Array, Array]:
    hidden = (len(theta) - n_out) // (n_in + 1 + n_out)
    a = hidden * n_in
    b = a + hidden
    c = b + n_out * hidden
    return theta[:a].reshape(hidden, n_in), theta[a:b], theta[b:c].reshape(n_out, hidden), theta[c:]


def _check_samples(x: Array, y: Array) -> None:
    if x.ndim != 2 or y.ndim != 2 or len(x) != len(y) or len(x) == 0:
        raise InputError(f"training needs n inputs and n outputs, n > 0, got shapes {x.shape} and {y.shape}")
