"""Fuzzy matching against the paper's numbers and a scalar implementation written from the definitions."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from preshape.exceptions import InputError
from preshape.hiis.fuzzy import SET_NAMES, SHAPES, FuzzySets, adi, approaching_degrees, inner, outer, tfvadi

Q1 = (1.0, 1.0, 0.1, 0.05, 0.8, 0.05)
Q2 = (1.0, 1.0, 0.1, 0.8, 0.05, 0.05)

# PAPER.md §7, typed again from the page.
CORNERS = {
    "RWD-H": (-1.2, -1.2, -0.9, -0.75),
    "RWD-M": (-0.9, -0.8, -0.5, -0.35),
    "RWD-L": (-0.5, -0.35, -0.15, -0.05),
    "ZERO": (-0.15, -0.05, 0.05, 0.15),
    "FWD-L": (0.05, 0.15, 0.35, 0.5),
    "FWD-M": (0.35, 0.5, 0.8, 0.9),
    "FWD-H": (0.75, 0.9, 1.2, 1.2),
}
EDGES = sorted({corner for four in CORNERS.values() for corner in four})
GRID = sorted(
    {
        *np.linspace(-2.5, 2.5, 1201).tolist(),
        *EDGES,
        *(math.nextafter(corner, math.inf) for corner in EDGES),
        *(math.nextafter(corner, -math.inf) for corner in EDGES),
        1.3, -1.3, 2.1, -2.1, 1e6, -1e6,
    }
)  # fmt: skip

numbers = st.one_of(st.floats(-3, 3), st.sampled_from(EDGES))
vectors = st.tuples(*[numbers] * 6)
shapes = st.sampled_from(SHAPES)
derandomized = settings(derandomize=True, deadline=None, max_examples=100)


def scalar_membership(x: float, index: int, corners: dict[str, tuple[float, ...]], shape: str) -> float:
    """One membership, by cases; the outermost sets are shoulders from their peak outwards."""
    a, b, c, d = list(corners.values())[index]
    if shape == "trapezoid":
        low_peak, high_peak = b, c
    else:
        low_peak = high_peak = (b + c) / 2
    if index == 0 and x <= high_peak:
        return 1.0
    if index == 6 and x >= low_peak:
        return 1.0
    if shape == "gaussian":
        half = ((c + d) / 2 - (a + b) / 2) / 2  # between the two heights of 1/2 of the trapezoid
        return 0.5 ** (((x - low_peak) / half) ** 2)
    if x < a or x > d:
        return 0.0
    if x < low_peak:
        return (x - a) / (low_peak - a)
    if x > high_peak:
        return (d - x) / (d - high_peak)
    return 1.0


def scalar_tfvadi(
    q: Sequence[float], w: Sequence[float], corners: dict[str, tuple[float, ...]], shape: str
) -> float:
    total = 0.0
    for x, y in zip(q, w, strict=True):
        a = [scalar_membership(x, j, corners, shape) for j in range(7)]
        b = [scalar_membership(y, j, corners, shape) for j in range(7)]
        alike = max(min(p, r) for p, r in zip(a, b, strict=True))
        unlike = min(max(p, r) for p, r in zip(a, b, strict=True))
        total += min(alike, 1 - unlike)
    return total


@pytest.mark.parametrize(
    ("wrench", "change", "exact", "tolerance"),
    [
        ((1.3, 1.1, -0.27, 0.06, 0.86, 0.11), {}, 3.700, 1e-9),
        ((1.3, 1.1, -0.27, -0.06, 0.86, 0.11), {"ZERO": (-0.15, -0.08, 0.08, 0.15)}, 3.97142857, 1e-8),
        ((1.3, 1.1, -0.27, -0.06, 0.86, 0.11), {"ZERO": (-0.08, -0.03, 0.03, 0.08)}, 2.800, 1e-9),
        (
            (1.3, 1.1, -0.27, -0.06, 0.86, 0.11),
            {"RWD-M": (-0.95, -0.85, -0.45, -0.35), "FWD-M": (0.35, 0.45, 0.85, 0.95)},
            4.200,
            1e-9,
        ),
        ((0.86, 1.1, -0.22, -0.03, 0.96, 0.06), {}, 3.9 + 1 / 15, 1e-9),
        (Q1, {}, 5.5, 1e-9),
    ],
)
def test_golden_values_of_the_paper(
    wrench: tuple[float, ...], change: dict[str, tuple[float, ...]], exact: float, tolerance: float
) -> None:
    sets = FuzzySets().changed(change)
    assert tfvadi(Q1, wrench, sets) == pytest.approx(exact, abs=tolerance)
    assert tfvadi(wrench, Q1, sets) == tfvadi(Q1, wrench, sets)


def test_golden_values_agree_with_the_paper_as_printed() -> None:
    changed = FuzzySets().changed({"ZERO": (-0.15, -0.08, 0.08, 0.15)})
    assert tfvadi(Q1, (1.3, 1.1, -0.27, 0.06, 0.86, 0.11)) == pytest.approx(3.71, abs=0.02)
    assert tfvadi(Q1, (1.3, 1.1, -0.27, -0.06, 0.86, 0.11), changed) == pytest.approx(3.98, abs=0.02)


def test_the_default_sets_are_those_of_fig_16() -> None:
    assert tuple(CORNERS) == SET_NAMES
    assert np.array_equal(FuzzySets().corners, np.array(list(CORNERS.values())))
    assert FuzzySets().shape == "trapezoid"


@pytest.mark.parametrize("shape", SHAPES)
def test_membership_equals_the_scalar_definition(shape: str) -> None:
    found = FuzzySets(shape=shape).membership(GRID)
    wanted = [[scalar_membership(x, j, CORNERS, shape) for j in range(7)] for x in GRID]
    assert found.shape == (len(GRID), 7)
    assert np.allclose(found, wanted, rtol=0, atol=1e-12)
    assert (found >= 0).all()
    assert (found <= 1).all()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("x", [1.2, 1.3, 2.1, 1e9])
def test_the_outer_sets_are_shoulders(shape: str, x: float) -> None:
    sets = FuzzySets(shape=shape)
    assert sets.membership(x)[6] == 1.0
    assert sets.membership(-x)[0] == 1.0
    assert sets.membership(x)[:5].max() < 1e-3
    # Two numbers beyond every corner are alike whatever lies between them.
    assert approaching_degrees(np.full(6, x), np.full(6, 1.25), sets) == pytest.approx(np.ones(6), abs=1e-3)


@pytest.mark.parametrize("name", SET_NAMES)
def test_triangle_and_gaussian_stand_where_the_trapezoid_stands(name: str) -> None:
    j = SET_NAMES.index(name)
    a, b, c, d = CORNERS[name]
    middle = (b + c) / 2
    triangle, gaussian = FuzzySets(shape="triangle"), FuzzySets(shape="gaussian")
    assert triangle.membership(middle)[j] == pytest.approx(1.0, abs=1e-12)
    assert gaussian.membership(middle)[j] == pytest.approx(1.0, abs=1e-12)
    for x, inward in ((a, 1), (d, -1)):
        if (j == 0 and x == a) or (j == 6 and x == d):
            continue
        assert triangle.membership(x)[j] == pytest.approx(0.0, abs=1e-12)
        assert triangle.membership((x + middle) / 2)[j] == pytest.approx(0.5)
        assert triangle.membership(x + 1e-6 * inward)[j] > 0
    if name == "ZERO":  # symmetric: half its height exactly where the trapezoid has
        assert gaussian.membership([-0.1, 0.1])[:, j] == pytest.approx([0.5, 0.5])
    x = np.linspace(-2, 2, 401)
    for sets in (triangle, gaussian):  # one peak
        height = sets.membership(x)[:, j]
        assert (np.diff(height)[x[1:] <= middle - 1e-9] >= -1e-12).all()
        assert (np.diff(height)[x[:-1] >= middle + 1e-9] <= 1e-12).all()


@pytest.mark.parametrize("shape", SHAPES)
def test_the_sets_are_mirror_images_of_one_another(shape: str) -> None:
    sets = FuzzySets(shape=shape)
    x = np.array(GRID)
    assert np.allclose(sets.membership(-x), sets.membership(x)[:, ::-1], rtol=0, atol=1e-9)


@derandomized
@given(q=vectors, w=vectors, shape=shapes)
def test_tfvadi_equals_the_scalar_definition(q: tuple[float, ...], w: tuple[float, ...], shape: str) -> None:
    sets = FuzzySets(shape=shape)
    found = float(tfvadi(q, w, sets))
    assert found == pytest.approx(scalar_tfvadi(q, w, CORNERS, shape), abs=1e-9)
    assert found == float(tfvadi(w, q, sets))
    assert 0 <= found <= 6
    assert float(approaching_degrees(q, w, sets).sum()) == pytest.approx(found, abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_set_without_width_is_a_spike_and_no_division_by_zero(shape: str) -> None:
    spikes = [[j / 4] * 4 for j in range(-3, 4)]
    sets = FuzzySets(corners=spikes, shape=shape)
    assert sets.membership(np.arange(-3, 4) / 4).tolist() == np.eye(7).tolist()
    assert sets.membership([-0.7, 0.1, 0.7]).tolist() == np.zeros((3, 7)).tolist()
    assert sets.membership([-9.0, 9.0]).tolist() == [np.eye(7)[0].tolist(), np.eye(7)[6].tolist()]


def test_any_legal_corners_even_steps_equal_the_scalar_definition() -> None:
    rng = np.random.default_rng(8)
    for _ in range(300):
        corners = np.sort(rng.integers(-5, 6, (7, 4)), axis=1) / 4  # coarse, so that corners often coincide
        four = {name: tuple(row) for name, row in zip(SET_NAMES, corners.tolist(), strict=True)}
        q, w = (rng.integers(-12, 13, (2, 6)) / 8).tolist()
        found = float(tfvadi(q, w, FuzzySets(corners=corners)))
        assert found == pytest.approx(scalar_tfvadi(q, w, four, "trapezoid"), abs=1e-9)


def cores(x: float) -> set[int]:
    """Which cores (membership 1) of the default sets a number lies in."""
    inside = {j for j, (_, b, c, _) in enumerate(CORNERS.values()) if b <= x <= c}
    return inside | ({6} if x >= 0.9 else set()) | ({0} if x <= -0.9 else set())


@derandomized
@given(st.data())
def test_six_exactly_for_full_agreement(data: st.DataObject) -> None:
    # Numbers that often lie in a core, so that both sides of the equivalence are met.
    either = st.sampled_from([-2.1, -1.0, -0.9, -0.65, -0.3, -0.1, 0.0, 0.05, 0.1, 0.2, 0.6, 0.85, 1.0, 1.3])
    q = data.draw(st.lists(either, min_size=6, max_size=6))
    w = [data.draw(st.one_of(st.just(x), either)) for x in q]
    full = all(cores(x) & cores(y) for x, y in zip(q, w, strict=True))
    assert (tfvadi(q, w) >= 6 - 1e-9) == full


def test_six_is_reached_and_disagreement_is_zero() -> None:
    assert tfvadi([1.3, -2.1, 0.0, 0.25, -0.65, 0.6], [0.95, -1.0, 0.04, 0.3, -0.5, 0.8]) == 6
    assert tfvadi(np.full(6, 1.0), np.full(6, -1.0)) == 0


@pytest.mark.parametrize("shape", SHAPES)
def test_layers_membership_and_broadcasting_agree(shape: str) -> None:
    sets = FuzzySets(shape=shape)
    rng = np.random.default_rng(3)
    x = rng.uniform(-1.5, 1.5, (2, 3, 4))
    assert sets.layers(x).shape == (7, 2, 3, 4)
    assert sets.membership(x).shape == (2, 3, 4, 7)
    for place in np.ndindex(x.shape):
        one = sets.membership(float(x[place]))
        assert one.shape == (7,)
        assert np.array_equal(sets.membership(x)[place], one)
        assert np.array_equal(sets.layers(x)[(slice(None), *place)], one)
    q, w = rng.uniform(-1.5, 1.5, (5, 1, 6)), rng.uniform(-1.5, 1.5, (3, 6))
    table = tfvadi(q, w, sets)
    assert table.shape == (5, 3)
    for i, j in np.ndindex(5, 3):
        assert table[i, j] == pytest.approx(float(tfvadi(q[i, 0], w[j], sets)), abs=1e-12)
    assert tfvadi(Q1, w, sets) == pytest.approx([float(tfvadi(Q1, row, sets)) for row in w])
    assert tfvadi(w, Q1, sets) == pytest.approx([float(tfvadi(Q1, row, sets)) for row in w])
    assert tfvadi(np.zeros((0, 6)), Q1, sets).shape == (0,)


def test_the_arguments_are_left_alone() -> None:
    x = np.array(GRID)
    before = x.copy()
    for shape in SHAPES:
        FuzzySets(shape=shape).membership(x)
    assert np.array_equal(x, before)


def test_inner_outer_and_adi_by_hand() -> None:
    a, b = np.array([0.2, 0.9, 0.0]), np.array([0.7, 0.4, 0.3])
    assert inner(a, b) == 0.4  # max(.2, .4, 0)
    assert outer(a, b) == 0.3  # min(.7, .9, .3)
    assert adi(a, b) == 0.4  # min(.4, .7)
    # Here the complement of the outer product decides: without the bar it would be 0.8.
    assert adi(np.array([0.9, 0.8]), np.array([0.9, 0.8])) == pytest.approx(0.2)


def test_changed_replaces_only_what_it_names() -> None:
    sets = FuzzySets(shape="triangle")
    new = sets.changed({"ZERO": (-0.08, -0.03, 0.03, 0.08)})
    assert new.shape == "triangle"
    assert np.array_equal(new.corners[3], (-0.08, -0.03, 0.03, 0.08))
    others = [j for j in range(7) if j != 3]
    assert np.array_equal(new.corners[others], sets.corners[others])
    assert np.array_equal(sets.corners[3], CORNERS["ZERO"])
    with pytest.raises(InputError, match=r"no fuzzy set 'ZER'; known: RWD-H, RWD-M, .*FWD-H"):
        sets.changed({"ZER": (0, 0, 0, 0)})
    with pytest.raises(InputError, match="ZERO must be 4 numbers, got 3"):
        sets.changed({"ZERO": (0, 0, 0)})
    with pytest.raises(InputError, match="must not decrease"):
        sets.changed({"ZERO": (0.1, 0.0, 0.2, 0.3)})


def test_bad_sets_are_refused_and_good_ones_are_read_only() -> None:
    good = np.array(list(CORNERS.values()))
    for bad in (
        good[:6],
        good[:, :3],
        np.where(good == 0.05, np.nan, good),
        good[:, ::-1],
        "trapezoid",
        None,
    ):
        with pytest.raises(InputError):
            FuzzySets(corners=bad)
    with pytest.raises(InputError, match="trapezoid, triangle, gaussian"):
        FuzzySets(shape="circle")
    sets = FuzzySets(corners=good)
    good[0, 0] = 9
    assert sets.corners[0, 0] == -1.2
    with pytest.raises(ValueError, match="read-only"):
        sets.corners[0, 0] = 0.0


def test_crisp_values_are_those_of_the_page_and_name_their_own_set() -> None:
    sets = FuzzySets()
    assert sets.crisp().tolist() == [-0.925, -0.65, -0.25, 0.0, 0.25, 0.65, 0.925]
    assert [sets.name_index(v) for v in sets.crisp()] == list(range(7))
    assert all(x < y for x, y in pairwise(sets.crisp()))


def test_crisp_is_the_midpoint_of_the_core_clipped_for_changed_sets() -> None:
    crisp = FuzzySets().changed({"FWD-L": (0.1, 0.2, 0.5, 0.6), "FWD-H": (0.6, 0.7, 1.2, 1.2)}).crisp()
    assert crisp[4] == pytest.approx(0.35)
    assert crisp[6] == pytest.approx((0.7 + 0.95) / 2)
    # The cores of the outermost sets end at the limit, not at the feet.
    narrow = {"RWD-H": (-1.2, -0.94, -0.9, -0.75), "FWD-H": (0.75, 0.9, 0.94, 1.2)}
    assert FuzzySets().changed(narrow).crisp()[[0, 6]] == pytest.approx([-0.92, 0.92], abs=1e-12)
    wide = {"RWD-H": (-1.2, -1.2, -1.0, -0.9), "FWD-H": (0.9, 1.0, 1.2, 1.2)}
    assert FuzzySets().changed(wide).crisp()[[0, 6]].tolist() == [-0.95, 0.95]


@pytest.mark.parametrize("bad", [1.0, [], [1.0] * 5, np.ones((6, 7))])
def test_what_is_not_six_numbers_is_refused(bad: object) -> None:
    shape = re.escape(str(np.shape(bad)))
    with pytest.raises(InputError, match=f"a task must be six numbers, got shape {shape}"):
        tfvadi(bad, Q1)
    with pytest.raises(InputError, match=f"a wrench must be six numbers, got shape {shape}"):
        tfvadi(Q1, bad)


@pytest.mark.parametrize("bad", [(1, 1, 1, 1, 1, np.nan), (1, 1, 1, 1, 1, np.inf)])
def test_numbers_that_are_not_finite_never_match_fully(bad: tuple[float, ...]) -> None:
    # A NaN must not come out as a number that looks like a match.
    found = float(tfvadi(bad, Q1))
    assert math.isnan(found) or found < 6
