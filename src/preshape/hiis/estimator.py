"""The approach estimator (AE): a 13-45-9 multilayer perceptron (§2.2, fig. 5, tables 2-3).

From a task and an object's attributes it estimates where to grasp: the approach plane, the fuzzy set of
the approach value, and the number of virtual fingers, each in binary.
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
from functools import cache
from typing import Literal

import numpy as np

from ..exceptions import InputError
from ..objects.shape import LENGTH
from ..types import LENGTH_UNIT, Array, Attributes, BoolArray, IntArray, NetworkWeights, one_of, value

INPUTS, HIDDEN, OUTPUTS = 13, 45, 9
LAYERS = (INPUTS, HIDDEN, OUTPUTS)

InputKind = Literal["paper", "shape"]
"""Inputs that describe the object: the paper's seven attributes, or extents and shape descriptor [C]."""

INPUT_COUNTS: dict[str, int] = {"paper": INPUTS, "shape": 6 + 3 + LENGTH}
"""Number of inputs of each kind: 13 and 37."""

_COUNT_DECADES = 6.0  # scales counts up to a million to about 1 [C]
_DECIMALS, _FAR = 9, 10.0  # of the inputs, and where they are clipped
_LIMIT, _PARTS = 40, 256  # range and resolution of the table of exponentials


@value
class Estimate:
    """What the estimator estimates.

    Attributes:
        plane: Index of the approach plane, 1..12.
        approach_set: Index of the fuzzy set of the approach value, 0 = RWD-H … 6 = FWD-H.
        fingers: Virtual fingers, thumb included, 2..4.
        confidence: Probability of this code among all legal codes, 0..1.
        outputs: (9,) raw outputs Y0..Y8.
    """

    plane: int
    approach_set: int
    fingers: int
    confidence: float
    outputs: Array


def inputs(task: Array, attributes: Attributes, u: float, kind: InputKind = "paper") -> Array:
    """The input vector IV (eq. 5) of a task and an object; see :func:`inputs_of`.

    Args:
        task: (6,) Q.
        attributes: Attributes of the object [m].
        u: The hand's U [m].
        kind: ``paper`` or ``shape``.

    Returns:
        (13,) Tx Ty Tz Rx Ry Rz | W H D #Vert #VNorm #Faces #Triang, or (37,) Tx … Rz | W H D | descriptor.

    Raises:
        InputError: The kind is unknown, or it is ``shape`` and the attributes have no descriptor.
    """
    vector: Array = inputs_of([task], [attributes], u, kind)[0]
    return vector


def inputs_of(
    tasks: Sequence[Array], attributes: Sequence[Attributes], u: float, kind: InputKind = "paper"
) -> Array:
    """The input vectors of n tasks and objects (eq. 5), scaled to about unit range [C].

    Extents are divided by 4U, and the decimal logarithms of counts by 6. All inputs are clipped at ±10, far
    beyond any value of a task or an object that a hand can hold: one absurd lesson must not spoil the
    training on all others. The kind ``shape`` has the shape descriptor instead of the counts, because
    the counts change with every new triangulation of the object [C]. All inputs are rounded to nine decimals:
    the last bits of logarithms and wrenches differ between processors, and must not reach the weights.

    Args:
        tasks: n times (6,) Q.
        attributes: Attributes of the n objects [m].
        u: The hand's U [m].
        kind: ``paper`` or ``shape``.

    Returns:
        (n, 13) or (n, 37) input vectors.

    Raises:
        InputError: The kind is unknown, or it is ``shape`` and some attributes have no descriptor.
    """
    one_of(kind, "kind of inputs", tuple(INPUT_COUNTS))
    sizes = np.array([a.extents for a in attributes]) / (LENGTH_UNIT * u)
    if kind == "shape":
        shapes = [a.shape for a in attributes if a.shape is not None]
        if len(shapes) < len(attributes):
            raise InputError("inputs of kind shape need a shape descriptor, got none: use described(mesh)")
        described = np.array(shapes)
    else:
        counts = [(a.vertices, a.vertex_normals, a.faces, a.triangles) for a in attributes]
        described = np.log10(np.maximum(counts, 1)) / _COUNT_DECADES
    return np.round(np.clip(np.column_stack([tasks, sizes, described]), -_FAR, _FAR), _DECIMALS)


def encode(plane: int, approach_set: int, fingers: int) -> Array:
    """(9,) the output vector OV (eq. 6, table 3) of a grasp; the inverse of :func:`decode`.

    Y0-Y3 = plane - 1, Y4-Y6 = set, Y7-Y8 = fingers - 1, each most significant bit first [P, C].

    >>> encode(10, 3, 2).astype(int).tolist()
    [1, 0, 0, 1, 0, 1, 1, 0, 1]
    """
    if not (1 <= plane <= 12 and 0 <= approach_set <= 6 and 2 <= fingers <= 4):
        raise InputError(
            f"no code for plane {plane}, set {approach_set}, {fingers} fingers: planes are 1..12, sets 0..6, "
            "fingers 2..4"
        )
    return np.concatenate([_bits(plane - 1, 4), _bits(approach_set, 3), _bits(fingers - 1, 2)])


def decode(outputs: Array, allowed: BoolArray | None = None) -> Estimate:
    """The most probable legal code for nine outputs [C].

    Codes without a meaning (planes 13-16, set 7, one finger) and planes that are not allowed are excluded.

    Args:
        outputs: (9,) probability of each bit to be 1.
        allowed: (12,) which planes are allowed; all by default.

    Raises:
        InputError: No plane is allowed.
    """
    planes = np.arange(12) if allowed is None else np.flatnonzero(allowed)
    if not len(planes):
        raise InputError("no approach plane is allowed: allow at least one approach axis")
    p = _code_probabilities(outputs[0:4], planes)
    s = _code_probabilities(outputs[4:7], np.arange(7))
    f = _code_probabilities(outputs[7:9], np.arange(1, 4))
    return Estimate(
        plane=int(planes[np.argmax(p)]) + 1,
        approach_set=int(np.argmax(s)),
        fingers=int(np.argmax(f)) + 2,
        confidence=float(p.max() * s.max() * f.max()),
        outputs=outputs,
    )


def predict(weights: NetworkWeights, x: Array) -> Array:
    """(..., 9) outputs of the network for inputs (..., n) of the kind that it was trained on."""
    samples = np.ascontiguousarray(x.reshape(-1, x.shape[-1]).T)
    hidden = sigmoid(weighted_sums(weights.w1, weights.b1, samples))
    outputs = sigmoid(weighted_sums(weights.w2, weights.b2, hidden))
    return outputs.T.reshape(*x.shape[:-1], -1)


def weighted_sums(weights: Array, biases: Array, x: Array) -> Array:
    """(h, n) what h units receive from (i, n) inputs, for (h, i) weights and (h,) biases.

    ``einsum`` adds in the same order on every x86-64 processor; the matrix product is BLAS, which does not.
    """
    return np.einsum("hi,in->hn", weights, x) + biases[:, None]


def sigmoid(x: Array) -> Array:
    """Logistic activation 1 / (1 + exp(-x)) [P], without overflow, to the last bit the same on every machine.

    NumPy's ``exp`` and ``tanh`` round differently on different processors. Here, exp(-x) is a table's value
    at the nearest 256th times the Padé approximant n / d of the rest r, which is at most 1/512 in size. Its
    error r⁵/720 is below 4e-17, with d = 12 - 6r + r² and n = d + 12r. This needs only operations that are
    rounded correctly everywhere.
    """
    rest = np.minimum(np.maximum(-_PARTS * x, -_PARTS * _LIMIT), _PARTS * _LIMIT)
    nearest = np.rint(rest)
    rest -= nearest
    exponential = _exponentials()[nearest.astype(np.intp)]
    # d and n times 256², computed in place: this is the most time-consuming part of training.
    below = rest * rest
    below += 12.0 * _PARTS**2
    rest *= 6.0 * _PARTS
    below -= rest
    rest *= 2.0
    rest += below
    exponential *= rest
    exponential += below
    return np.divide(below, exponential, out=exponential)


@cache
def _exponentials() -> Array:
    """(20481,) exp(k / 256) at index k, for k from 0 to 10240 and, as indices from the end, from -10240.

    The two ends are ∞ and 0, because the activation is 0 or 1 there.
    """
    whole = np.array([float(Decimal(k).exp()) for k in range(-_LIMIT, _LIMIT)])
    parts = np.array([float((Decimal(k) / _PARTS).exp()) for k in range(_PARTS)])
    table = np.append(np.outer(whole, parts), np.inf)
    table[0] = 0.0
    return np.roll(table, -_PARTS * _LIMIT)


def _bits(number: int, width: int) -> Array:
    return np.array([(number >> shift) & 1 for shift in range(width - 1, -1, -1)], dtype=np.float64)


@cache
def _patterns(codes: tuple[int, ...], width: int) -> Array:
    return np.array([_bits(code, width) for code in codes])


def _code_probabilities(bits: Array, codes: IntArray) -> Array:
    """Probability of each legal code, normalised over the legal codes."""
    patterns = _patterns(tuple(codes.tolist()), len(bits))
    p = np.clip(bits, 1e-9, 1 - 1e-9)
    log = (patterns * np.log(p) + (1 - patterns) * np.log1p(-p)).sum(axis=1)
    odds = np.exp(log - log.max())
    return odds / odds.sum()
