"""Training of the approach estimator: L-BFGS for use, back-propagation as in the paper (§2.2, §3.5).

The reported error is always the paper's: the squared error, averaged over samples and outputs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..exceptions import InputError
from ..types import Array, NetworkWeights
from .estimator import LAYERS, predict, sigmoid

TARGET_ERROR = 5e-4
"""Mean-square error at which training stops: the smallest of table 4 [P]."""

_DECAYS = (1e-5, 1e-6, 1e-7)
"""Weight decays, tried in this order until the target error is met. A larger decay makes the network more
tolerant of disturbed tasks [C]."""
_SURE = 0.45  # largest distance of an output from its bit; at 0.5 the code would be read wrongly


def initial_weights(seed: int, layers: tuple[int, int, int] = LAYERS) -> NetworkWeights:
    """Random weights: normally distributed, with standard deviation 1 / √fan-in."""
    rng = np.random.default_rng(seed)
    n_in, n_hidden, n_out = layers
    return NetworkWeights(
        w1=rng.normal(0, n_in**-0.5, (n_hidden, n_in)),
        b1=rng.normal(0, n_in**-0.5, n_hidden),
        w2=rng.normal(0, n_hidden**-0.5, (n_out, n_hidden)),
        b2=np.zeros(n_out),
        mean_square_error=1.0,
        trained_on=0,
        epochs=0,
    )


def mean_square_error(weights: NetworkWeights, x: Array, y: Array) -> float:
    """The paper's error: the mean of (output - bit)² over samples and outputs."""
    return float(np.mean((predict(weights, x) - y) ** 2))


def loss_and_gradient(
    theta: Array, x: Array, y: Array, *, loss: str, decay: float = 0.0
) -> tuple[float, Array]:
    """Loss of the network and its exact gradient.

    Args:
        theta: (p,) all weights: w1, b1, w2, b2, flattened.
        x: (n, i) inputs.
        y: (n, 9) bits.
        loss: ``squared`` for the mean-square error, or ``entropy`` for the mean cross-entropy.
        decay: Factor on half the sum of the squared weights.
    """
    n_in, n_out = x.shape[1], y.shape[1]
    w1, b1, w2, b2 = _unpack(theta, n_in, n_out)
    hidden = sigmoid(x @ w1.T + b1)
    z = hidden @ w2.T + b2
    out = sigmoid(z)
    if loss == "squared":
        value = float(np.mean((out - y) ** 2))
        delta2 = 2.0 * (out - y) * out * (1 - out) / y.size
    elif loss == "entropy":
        # log(1 + exp(-|z|)) + max(z, 0) - z·y is the cross-entropy without overflow.
        value = float(np.mean(np.log1p(np.exp(-np.abs(z))) + np.maximum(z, 0) - z * y))
        delta2 = (out - y) / y.size
    else:
        raise InputError(f"a loss must be squared or entropy, got {loss!r}")
    delta1 = (delta2 @ w2) * hidden * (1 - hidden)
    gradient = np.concatenate(
        [(delta1.T @ x).ravel(), delta1.sum(axis=0), (delta2.T @ hidden).ravel(), delta2.sum(axis=0)]
    )
    return value + 0.5 * decay * float(theta @ theta), gradient + decay * theta


def train(
    x: Array, y: Array, *, start: NetworkWeights | None = None, seed: int = 0, target: float = TARGET_ERROR
) -> NetworkWeights:
    """Train for use: L-BFGS on cross-entropy, with the earlier weights as warm start.

    Training stops when the mean-square error meets the target and every output is on the correct side of 0.5.
    If the earlier weights do not lead there, training starts again from fresh weights, up to three times.

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


def back_propagation(
    x: Array,
    y: Array,
    *,
    targets: tuple[float, ...],
    seed: int = 0,
    rate: float = 0.5,
    momentum: float = 0.0,
    max_epochs: int = 200_000,
    progress: Callable[[int, float], None] | None = None,
) -> tuple[list[int | None], NetworkWeights]:
    """Plain back-propagation on the squared error, sample by sample, as for table 4 [P].

    Each epoch uses every sample once, in a new random order.

    Args:
        x: (n, 13) inputs.
        y: (n, 9) bits.
        targets: Mean-square errors, largest first.
        seed: Seed of the initial weights and of the orders.
        rate: Learning rate.
        momentum: Share of the previous step that is added.
        max_epochs: Number of epochs after which training ends in any case.
        progress: Called every 100 epochs with epoch and error.

    Returns:
        The epoch at which each target was reached (``None`` if it was not), and the weights.
    """
    _check_samples(x, y)
    rng = np.random.default_rng(seed)
    begin = initial_weights(seed, (x.shape[1], LAYERS[1], y.shape[1]))
    w1, b1, w2, b2 = (np.array(w) for w in (begin.w1, begin.b1, begin.w2, begin.b2))
    v1, c1, v2, c2 = (np.zeros_like(w) for w in (w1, b1, w2, b2))
    reached: list[int | None] = [None] * len(targets)
    error, epoch = 1.0, 0
    for epoch in range(1, max_epochs + 1):
        total = 0.0
        for i in rng.permutation(len(x)):
            hidden = sigmoid(w1 @ x[i] + b1)
            out = sigmoid(w2 @ hidden + b2)
            wrong = out - y[i]
            total += float(wrong @ wrong)
            delta2 = wrong * out * (1 - out)
            delta1 = (delta2 @ w2) * hidden * (1 - hidden)
            v2 = momentum * v2 - rate * np.outer(delta2, hidden)
            c2 = momentum * c2 - rate * delta2
            v1 = momentum * v1 - rate * np.outer(delta1, x[i])
            c1 = momentum * c1 - rate * delta1
            w1 += v1
            b1 += c1
            w2 += v2
            b2 += c2
        error = total / y.size
        for k, target in enumerate(targets):
            if reached[k] is None and error <= target:
                reached[k] = epoch
        if progress is not None and epoch % 100 == 0:
            progress(epoch, error)
        if all(r is not None for r in reached):
            break
    return reached, _measured(w1, b1, w2, b2, x, y, epoch)


class _Reached(Exception):
    """Stops the optimiser at the target."""

    def __init__(self, theta: Array) -> None:
        self.theta = theta


def _descend(x: Array, y: Array, begin: NetworkWeights, target: float, decay: float) -> NetworkWeights:
    from scipy.optimize import minimize
    from threadpoolctl import threadpool_limits

    n_in, n_out = x.shape[1], y.shape[1]
    iterations = 0

    def pack(theta: Array) -> NetworkWeights:
        return _measured(*_unpack(theta, n_in, n_out), x, y, iterations)

    def check(theta: Array) -> None:
        nonlocal iterations
        iterations += 1
        if iterations % 5 == 0 and _learned(pack(theta), x, y, target):
            raise _Reached(theta.copy())

    theta = np.concatenate([w.ravel() for w in (begin.w1, begin.b1, begin.w2, begin.b2)])
    if _learned(pack(theta), x, y, target):
        return pack(theta)
    try:
        # For matrices this small, a second BLAS thread costs more than it gains.
        with threadpool_limits(1, user_api="blas"):
            theta = minimize(  # type: ignore[call-overload]
                lambda now: loss_and_gradient(now, x, y, loss="entropy", decay=decay),
                theta,
                jac=True,
                method="L-BFGS-B",
                callback=check,
                options={"maxiter": 250, "maxfun": 400, "maxcor": 20, "ftol": 0.0, "gtol": 1e-9},
            ).x
    except _Reached as stop:
        theta = stop.theta
    return pack(theta)


def _measured(w1: Array, b1: Array, w2: Array, b2: Array, x: Array, y: Array, epochs: int) -> NetworkWeights:
    """Weights with their mean-square error on the training set."""
    bare = NetworkWeights(w1=w1, b1=b1, w2=w2, b2=b2, mean_square_error=1.0, trained_on=len(x), epochs=epochs)
    return replace(bare, mean_square_error=mean_square_error(bare, x, y))


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
