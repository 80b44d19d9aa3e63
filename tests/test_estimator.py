"""The estimator's code and inputs: every code, every illegal one against brute force, and the scaling."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from preshape.exceptions import InputError
from preshape.hiis.estimator import (
    HIDDEN,
    INPUT_COUNTS,
    INPUTS,
    LAYERS,
    OUTPUTS,
    Estimate,
    decode,
    encode,
    inputs,
    predict,
    sigmoid,
)
from preshape.objects import library
from preshape.objects.shape import LENGTH
from preshape.types import Attributes, NetworkWeights

Array = NDArray[np.float64]
CODES = list(product(range(1, 13), range(7), (2, 3, 4)))
U = 0.043


def bits_of(plane: int, approach_set: int, fingers: int) -> list[int]:
    return [int(c) for c in f"{plane - 1:04b}{approach_set:03b}{fingers - 1:02b}"]


def named(estimate: Estimate) -> tuple[int, int, int]:
    return estimate.plane, estimate.approach_set, estimate.fingers


def by_brute_force(outputs: Array, allowed: Array) -> tuple[list[tuple[int, int, int]], float]:
    """Every legal code that ties for most probable, and the probability of one among all legal ones."""
    chance = {}
    for code in CODES:
        if allowed[code[0] - 1]:
            pairs = zip(bits_of(*code), outputs, strict=True)
            chance[code] = float(np.prod([p if bit else 1 - p for bit, p in pairs]))
    top, total = max(chance.values()), sum(chance.values())
    return [code for code, p in chance.items() if p >= top * (1 - 1e-9)], top / total


def test_the_shape_of_the_network_is_the_papers() -> None:
    assert LAYERS == (INPUTS, HIDDEN, OUTPUTS) == (13, 45, 9)


def test_every_code_is_written_in_binary_and_read_back() -> None:
    seen = set()
    for code in CODES:
        y = encode(*code)
        assert y.tolist() == bits_of(*code)
        assert named(decode(y)) == code
        assert decode(y).confidence == pytest.approx(1, abs=1e-6)
        seen.add(tuple(y))
    assert len(seen) == 12 * 7 * 3


def test_the_papers_example() -> None:
    assert encode(10, 0, 2)[:4].tolist() == [1, 0, 0, 1]


@pytest.mark.parametrize("code", CODES[::17])
@pytest.mark.parametrize("sure", [0.01, 0.2, 0.45])
def test_half_sure_outputs_still_name_their_code(code: tuple[int, int, int], sure: float) -> None:
    y = encode(*code)
    assert named(decode(np.where(y > 0.5, 1 - sure, sure))) == code


probabilities = st.one_of(st.floats(0.001, 0.999), st.sampled_from([0.02, 0.5, 0.98]))


@settings(derandomize=True, deadline=None, max_examples=60)
@given(outputs=st.tuples(*[probabilities] * 9), mask=st.integers(1, 2**12 - 1))
def test_decoding_is_the_most_probable_legal_code(outputs: tuple[float, ...], mask: int) -> None:
    y = np.array(outputs)
    for allowed in (np.ones(12, dtype=bool), np.array([mask >> i & 1 for i in range(12)], dtype=bool)):
        best, confidence = by_brute_force(y, allowed)
        found = decode(y, allowed)
        assert named(found) in best
        assert found.confidence == pytest.approx(confidence, rel=1e-6)
        assert np.array_equal(found.outputs, y)


def test_every_word_of_nine_bits_names_the_nearest_legal_code() -> None:
    words = np.array(list(product((0, 1), repeat=9)))
    legal = np.array([bits_of(*code) for code in CODES])
    fewest = np.abs(words[:, None] - legal[None]).sum(axis=2).min(axis=1)
    for word, least in zip(words, fewest, strict=True):
        found = decode(np.where(word > 0, 0.9, 0.1))  # all equally sure: fewest bits changed
        assert named(found) in CODES
        assert int(np.abs(encode(*named(found)) - word).sum()) == least
        assert 0 < found.confidence <= 1


def test_saturated_outputs_are_read_too() -> None:
    for word in (np.ones(9), np.zeros(9)):
        found = decode(word)
        assert named(found) in CODES
        assert np.isfinite(found.confidence)
    assert named(decode(np.ones(9)))[2] == 4
    # Set 7 is nothing: the least sure of its three bits gives way.
    assert decode(np.array([0, 0, 0, 0, 1, 0.97, 1, 0, 1])).approach_set == 5


@pytest.mark.parametrize("index", range(1, 13))
def test_a_plane_that_is_not_allowed_is_never_named(index: int) -> None:
    only = np.arange(1, 13) == index
    for other in range(1, 13):
        assert decode(encode(other, 3, 2), only).plane == index
        if other != index:
            assert decode(encode(index, 3, 2), ~only).plane != index


def test_no_plane_allowed_is_refused() -> None:
    with pytest.raises(InputError, match="allow at least one"):
        decode(np.full(9, 0.5), np.zeros(12, dtype=bool))


@pytest.mark.parametrize("bad", [(0, 0, 2), (13, 0, 2), (1, -1, 2), (1, 7, 2), (1, 0, 1), (1, 0, 5)])
def test_a_code_that_does_not_exist_is_refused(bad: tuple[int, int, int]) -> None:
    with pytest.raises(InputError, match="no code for plane"):
        encode(*bad)


def test_inputs_in_order_and_scaled() -> None:
    a = Attributes(
        extents=np.array([0.043, 0.086, 0.172]), vertices=10, vertex_normals=100, faces=1000,
        triangles=1_000_000, area=1.0, volume=1.0,
    )  # fmt: skip
    q = np.array([1.0, -1.0, 0.1, 0.05, 0.8, -0.8])
    x = inputs(q, a, U)
    assert x == pytest.approx([*q, 0.25, 0.5, 1.0, 1 / 6, 2 / 6, 3 / 6, 1.0])
    # Twice the object in twice the hand is the same object.
    double = Attributes(
        extents=2 * a.extents, vertices=10, vertex_normals=100, faces=1000, triangles=1_000_000,
        area=4.0, volume=8.0,
    )  # fmt: skip
    assert inputs(q, double, 2 * U) == pytest.approx(x)


def test_tasks_are_clipped_far_beyond_any_task_for_both_kinds_of_inputs() -> None:
    shape = np.linspace(0.0, 1.0, LENGTH)
    a = Attributes(
        extents=np.array([0.043, 0.086, 0.172]), vertices=1, vertex_normals=0, faces=10, triangles=100,
        area=1.0, volume=1.0, shape=shape,
    )  # fmt: skip
    task = np.array([1e9, -1e9, 9.5, -9.5, 10.5, -10.5])
    clipped = [10.0, -10.0, 9.5, -9.5, 10.0, -10.0]
    # A count of one or of none is 0 on the scale of logarithms.
    assert inputs(task, a, U) == pytest.approx([*clipped, 0.25, 0.5, 1.0, 0, 0, 1 / 6, 2 / 6])
    assert inputs(task, a, U, "shape") == pytest.approx([*clipped, 0.25, 0.5, 1.0, *shape])
    assert {kind: len(inputs(task, a, U, kind)) for kind in INPUT_COUNTS} == INPUT_COUNTS  # type: ignore[arg-type]


def test_an_unknown_kind_of_inputs_or_a_missing_descriptor_is_refused() -> None:
    a = library.load_library_object("cube").attributes
    with pytest.raises(InputError, match="no kind of inputs 'size'; known: paper, shape"):
        inputs(np.zeros(6), a, U, "size")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="need a shape descriptor, got none"):
        inputs(np.zeros(6), replace(a, shape=None), U, "shape")


def test_last_bits_do_not_reach_the_inputs() -> None:
    a = library.load_library_object("mug").attributes
    q = np.array([1.0, -0.37, 1 / 3, 0.05, 0.8, -0.8])
    for kind in ("paper", "shape"):
        shaped = replace(a, shape=np.linspace(0.1, 1.0, LENGTH) if a.shape is None else a.shape)
        other = replace(shaped, extents=a.extents * (1 + 4e-16), shape=shaped.shape * (1 - 4e-16))
        x = inputs(q, shaped, U, kind)
        assert np.array_equal(inputs(q * (1 + 4e-16), other, U, kind), x)
        assert not np.array_equal(inputs(q * (1 + 1e-7), shaped, U, kind), x)


def test_a_count_of_zero_is_no_infinity() -> None:
    a = Attributes(
        extents=np.full(3, 0.05), vertices=3, vertex_normals=0, faces=1, triangles=1, area=1.0, volume=0.0
    )
    assert np.isfinite(inputs(np.zeros(6), a, U)).all()


@pytest.mark.parametrize("name", library.names())
def test_library_objects_come_in_about_unit_range(name: str) -> None:
    x = inputs(np.zeros(6), library.load_library_object(name).attributes, U)[6:]
    assert x.shape == (7,)
    assert (x > 0).all()
    assert (x <= 1 + 1e-9).all()
    assert x[:3].max() > 0.1


def test_two_library_objects_never_look_alike() -> None:
    rows = [inputs(np.zeros(6), library.load_library_object(n).attributes, U)[6:] for n in library.names()]
    apart = np.abs(np.array(rows)[:, None] - np.array(rows)[None]).max(axis=2) + np.eye(len(rows))
    assert apart.min() > 0.01


def test_predict_by_hand_and_in_batches() -> None:
    rng = np.random.default_rng(0)
    w = NetworkWeights(
        w1=rng.normal(size=(45, 13)), b1=rng.normal(size=45),
        w2=rng.normal(size=(9, 45)), b2=rng.normal(size=9), mean_square_error=1.0, trained_on=0, epochs=0,
    )  # fmt: skip
    x = rng.normal(size=(4, 13))
    batch = predict(w, x)
    assert batch.shape == (4, 9)
    for i in range(4):
        hidden = [
            1 / (1 + np.exp(-(sum(w.w1[j, k] * x[i, k] for k in range(13)) + w.b1[j]))) for j in range(45)
        ]
        out = [
            1 / (1 + np.exp(-(sum(w.w2[m, j] * hidden[j] for j in range(45)) + w.b2[m]))) for m in range(9)
        ]
        assert batch[i] == pytest.approx(out, abs=1e-12)
        assert predict(w, x[i]) == pytest.approx(batch[i], abs=1e-14)


def test_sigmoid_is_logistic_and_never_overflows() -> None:
    x = np.linspace(-30, 30, 601)
    assert sigmoid(x) == pytest.approx(1 / (1 + np.exp(-x)), abs=1e-15)
    assert sigmoid(np.array([-1e9, 0.0, 1e9])).tolist() == [0.0, 0.5, 1.0]
    assert sigmoid(-x) == pytest.approx(1 - sigmoid(x), abs=1e-15)
