"""The twelve approach planes, row by row from the table of PAPER.md §3."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from preshape.exceptions import InputError
from preshape.hiis.planes import (
    APPROACH_AXES,
    AXIS_NAMES,
    OPPOSITION_AXES,
    PLANES,
    TRANSVERSE_AXES,
    allowed_planes,
    axis_name,
    axis_vector,
    plane,
)

X, Y, Z = np.eye(3)
# index: a, o, t = a × o worked out by hand.
TABLE = {
    1: (-X, Y, -Z),
    2: (-X, Z, Y),
    3: (-Z, Y, X),
    4: (-Y, Z, -X),
    5: (X, Y, Z),
    6: (Y, X, -Z),
    7: (Z, Y, -X),
    8: (Y, Z, X),
    9: (X, Z, -Y),
    10: (Z, X, Y),
    11: (-Y, X, Z),
    12: (-Z, X, -Y),
}
every_row = pytest.mark.parametrize("index", TABLE)


@every_row
def test_the_row_of_the_table(index: int) -> None:
    a, o, t = TABLE[index]
    p = plane(index)
    assert p is PLANES[index - 1]
    assert p.index == index
    assert np.array_equal(p.approach_axis, a)
    assert np.array_equal(p.opposition_axis, o)
    assert np.array_equal(p.transverse_axis, t)
    assert np.array_equal(APPROACH_AXES[index - 1], a)
    assert np.array_equal(OPPOSITION_AXES[index - 1], o)
    assert np.array_equal(TRANSVERSE_AXES[index - 1], t)


@every_row
def test_each_plane_is_a_right_handed_frame(index: int) -> None:
    p = plane(index)
    frame = np.column_stack([p.approach_axis, p.opposition_axis, p.transverse_axis])
    assert np.array_equal(frame.T @ frame, np.eye(3))
    assert np.linalg.det(frame) == pytest.approx(1.0)


@every_row
def test_the_axes_of_a_plane_cannot_be_written(index: int) -> None:
    for axis in (plane(index).approach_axis, plane(index).opposition_axis):
        with pytest.raises(ValueError, match="read-only"):
            axis[0] = 5.0


@pytest.mark.parametrize("table", [APPROACH_AXES, OPPOSITION_AXES, TRANSVERSE_AXES])
def test_the_shared_tables_cannot_be_written(table: np.ndarray) -> None:
    assert not table.flags.writeable


def test_twelve_planes_are_six_signed_approaches_with_two_oppositions_each() -> None:
    assert len(PLANES) == 12
    pairs = {(axis_name(p.approach_axis), axis_name(p.opposition_axis)) for p in PLANES}
    assert pairs == {(a, o) for a, o in product(AXIS_NAMES, ("+x", "+y", "+z")) if a[1] != o[1]}


def test_label_names_the_axes() -> None:
    assert plane(5).label == "plane 5: approach +X, opposition Y"
    assert plane(12).label == "plane 12: approach -Z, opposition X"


@pytest.mark.parametrize("bad", [0, -1, 13, 100])
def test_an_index_that_does_not_exist_is_refused(bad: int) -> None:
    with pytest.raises(InputError, match=f"1 to 12, got {bad}"):
        plane(bad)


def test_axis_names_and_vectors_are_inverse() -> None:
    for name in AXIS_NAMES:
        assert axis_name(axis_vector(name)) == name
        assert np.array_equal(axis_vector(name.upper()), axis_vector(name))
        assert np.linalg.norm(axis_vector(name)) == 1
    assert np.array_equal(axis_vector("-y"), -Y)


@pytest.mark.parametrize("bad", ["x", "", "+", "+w", "x+", "+xx", "++x", "1"])
def test_a_name_that_is_not_an_axis_is_refused(bad: str) -> None:
    with pytest.raises(InputError, match=r"\+x, -x, \+y, -y, \+z, -z"):
        axis_vector(bad)
    if bad:
        with pytest.raises(InputError):
            allowed_planes(f"+x,{bad}")


def test_allowed_planes_are_those_with_an_allowed_approach() -> None:
    assert allowed_planes(None).tolist() == [True] * 12
    for count in range(1, 7):
        names = AXIS_NAMES[:count]
        wanted = [any(np.array_equal(TABLE[i][0], axis_vector(n)) for n in names) for i in TABLE]
        assert allowed_planes(",".join(names)).tolist() == wanted
    assert allowed_planes(" +Z , -x,").tolist() == allowed_planes("-x,+z").tolist()
    assert np.flatnonzero(allowed_planes("+z")).tolist() == [6, 9]


@pytest.mark.parametrize("bad", ["", " ", ",", " , "])
def test_no_approach_at_all_is_refused(bad: str) -> None:
    with pytest.raises(InputError, match=r"such as \+z,-x"):
        allowed_planes(bad)
