"""Limited-memory BFGS with the same steps on every machine.

SciPy's L-BFGS-B calls BLAS, which adds in another order, or with fused operations, on another processor.
Training amplifies these last bits until other weights come out. Here, all sums are NumPy's own, whose order
is the same on every x86-64 processor.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..types import Array

_SUFFICIENT, _CURVATURE = 1e-4, 0.9
"""Constants of the weak Wolfe conditions, as usual for quasi-Newton methods."""
_ITERATIONS, _MEMORY, _TOLERANCE = 250, 20, 1e-9
"""Largest number of iterations; number of remembered steps; largest gradient component at a minimum."""
_HALVINGS = 40
"""Longest line search; a direction along which nothing is left to gain ends the descent."""


def minimise(
    function: Callable[[Array], tuple[float, Array]],
    start: Array,
    *,
    finished: Callable[[Array, int], bool],
) -> Array:
    """A point at which a smooth function is small (Liu and Nocedal 1989).

    Each iteration has three steps:

    1. The direction is the gradient times the inverse Hessian that the latest steps suggest, in its
       compact form (Byrd, Nocedal and Schnabel 1994, eq. 3.1).
    2. The step along it is bisected, or doubled, until it meets the weak Wolfe conditions.
    3. The step and the change of the gradient join the memory.

    Args:
        function: Value and (p,) gradient at a (p,) point.
        start: (p,) point to start from.
        finished: Called with the point and the number of iterations after each; ends the descent if true.

    Returns:
        The last point that a line search accepted.
    """
    point = start
    value, gradient = function(point)
    steps, changes = np.empty((2, _ITERATIONS, len(start)))
    # With s the steps and y the changes: the upper triangle of s·y, inverted, and the products y·y. Dropping
    # the oldest step leaves the rest of both as it is, so a window on these tables is the memory.
    inverse, products = np.zeros((2, _ITERATIONS, _ITERATIONS))
    scale = 1 / max(_length(gradient), 1e-300)
    for k in range(_ITERATIONS):
        window = slice(max(k - _MEMORY, 0), k)
        direction = -_times_inverse_hessian(
            gradient, steps[window], changes[window], inverse[window, window], products[window, window], scale
        )
        slope = _dot(gradient, direction)
        if not slope < 0 or np.abs(gradient).max() <= _TOLERANCE:
            break
        # Lewis and Overton: the step stays between the longest that is too short and the shortest too long.
        step, short, long = 1.0, 0.0, np.inf
        for _ in range(_HALVINGS):
            ahead, ahead_gradient = function(point + step * direction)
            if not ahead <= value + _SUFFICIENT * step * slope:
                long = step
            elif _dot(ahead_gradient, direction) < _CURVATURE * slope:
                short = step
            else:
                break
            step = 2 * short if long == np.inf else 0.5 * (short + long)
        else:
            break
        steps[k], changes[k] = step * direction, ahead_gradient - gradient
        point, value, gradient = point + steps[k], ahead, ahead_gradient
        if finished(point, k + 1):
            break
        along = np.einsum("kp,p->k", steps[window.start : k + 1], changes[k])
        across = np.einsum("kp,p->k", changes[window.start : k + 1], changes[k])
        inverse[k, k] = 1 / along[-1]
        inverse[window, k] = -inverse[k, k] * np.einsum("ij,j->i", inverse[window, window], along[:-1])
        products[k, window.start : k + 1] = products[window.start : k + 1, k] = across
        scale = along[-1] / across[-1]
    return point


def _times_inverse_hessian(
    gradient: Array, steps: Array, changes: Array, inverse: Array, products: Array, scale: float
) -> Array:
    """The inverse Hessian times the gradient."""
    along = np.einsum("ij,j->i", inverse, np.einsum("kp,p->k", steps, gradient))
    across = scale * (np.einsum("ij,j->i", products, along) - np.einsum("kp,p->k", changes, gradient))
    weights = np.einsum("ij,i->j", inverse, along / np.diagonal(inverse) + across)
    return (
        scale * gradient + np.einsum("k,kp->p", weights, steps) - np.einsum("k,kp->p", scale * along, changes)
    )


def _dot(a: Array, b: Array) -> float:
    return float(np.einsum("i,i->", a, b))


def _length(a: Array) -> float:
    return float(np.sqrt(_dot(a, a)))
