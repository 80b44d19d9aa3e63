"""Read many rows at once: whole columns are checked and converted, instead of one cell after the other.

Rows are taken in bulk only if every cell of the block passes here. Otherwise they go, one by one, through
:func:`.records.experience_from_row`, which finds the fault and words it. So the checks here may be stricter
than those there, and never decide alone that a row is bad.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ..exceptions import InputError
from ..objects.shape import LENGTH as SHAPE_LENGTH
from ..types import (
    OLD_UNIT_NAME,
    UNIT_NAME,
    Array,
    Attributes,
    BoolArray,
    Experience,
    from_columns,
    read_only,
)
from . import checks
from .failures import one_line
from .limits import LIMITS, within
from .records import EXPERIENCE_COLUMNS, KINDS, MATCH_LIMITS, OUTCOMES, SCENE_LENGTH, Row

BLOCK = 512
"""Rows to read at once: enough for NumPy to be fast, few enough that one bad row slows down little."""

_NUMBERS = (
    *("extent_x", "extent_y", "extent_z", "task_tx", "task_ty", "task_tz", "task_rx", "task_ry", "task_rz"),
    *("wrench_fx", "wrench_fy", "wrench_fz", "wrench_mx", "wrench_my", "wrench_mz"),
    *("area", "volume", "approach_value", "match"),
)
_FINITE = (-np.finfo(np.float64).max, np.finfo(np.float64).max)
_LOW, _HIGH = np.array(
    [LIMITS["object extents"]] * 3
    + [_FINITE] * 6
    + [LIMITS["net wrench"]] * 6
    + [LIMITS["area"], LIMITS["volume"], (-1.0, 1.0), MATCH_LIMITS]
).T
_WHOLE = {
    **dict.fromkeys(("vertices", "vertex_normals", "faces", "triangles"), (0, checks.LARGEST)),
    **{"plane": (1, 12), "flip": (0, 1), "approach_set": (0, 6), "fingers": (2, 4)},
}


def experiences(
    rows: Sequence[Row], one: Callable[[Row], Experience]
) -> tuple[list[Experience], dict[int, str]]:
    """The experiences of rows, and those rows that are malformed or have numbers outside the limits.

    Args:
        rows: At least one row: the number of an experience and its cells, in the order of
            ``EXPERIENCE_COLUMNS``.
        one: Function that reads a single row, or raises an ``InputError``.

    Returns:
        The experiences that can be used, and for the number of each other one what is wrong with it.
    """
    together = _together(dict(zip(("id", *EXPERIENCE_COLUMNS), zip(*rows, strict=True), strict=True)))
    if together is not None:
        return together, {}
    found: list[Experience] = []
    absurd: dict[int, str] = {}
    for number, *row in rows:
        try:
            experience = one(tuple(row))
            within(experience)
        except InputError as error:
            absurd[number] = one_line(error)
        else:
            found.append(experience)
    return found, absurd


def _together(cell: Mapping[str, Sequence[Any]]) -> list[Experience] | None:
    """The experiences of these columns; ``None`` if any cell needs a closer look."""
    try:
        numbers = np.stack([np.frombuffer(array("d", cell[name])) for name in _NUMBERS])
    except TypeError:  # a text, a blob or NULL
        return None
    if not _plain_cells(cell):
        return None
    numbers = read_only(np.ascontiguousarray(numbers.T))
    shapes, grips = _arrays(cell["shape"], _is_shape), _arrays(cell["grip"], _is_grip)
    if shapes is None or grips is None or not ((numbers >= _LOW) & (numbers <= _HIGH)).all():
        return None
    area, volume, approach_value, match = numbers[:, 15:].T.tolist()
    of_object = {"extents": list(numbers[:, 0:3]), "area": area, "volume": volume, "shape": shapes}
    attributes = from_columns(Attributes, cell | of_object)  # type: ignore[operator]
    changed: dict[str, Sequence[Any]] = {
        "attributes": attributes,
        "task": list(numbers[:, 3:9]),
        "wrench": list(numbers[:, 9:15]),
        "approach_value": approach_value,
        "match": match,
        "flip": list(map(bool, cell["flip"])),
        "grip": grips,
        "outcome": [outcome or "" for outcome in cell["outcome"]],
    }
    return from_columns(Experience, cell | changed)  # type: ignore[operator]


def _plain_cells(cell: Mapping[str, Sequence[Any]]) -> bool:
    """Whether all texts, whole numbers and qualities are as they should be."""
    try:
        for name, (low, high) in _WHOLE.items():
            if set(map(type, cell[name])) != {int}:
                return False
            checks.whole(min(cell[name]), name, low, high)
            checks.whole(max(cell[name]), name, low, high)
        for name in ("hand", "object_name"):
            for content in set(cell[name]):
                checks.text(content, name)
        for content in set(cell["created"]):
            checks.utc(content)
        for content in {*cell["quality"]} - {None}:
            checks.number(content, "quality", *MATCH_LIMITS)
    except (InputError, TypeError):
        return False
    return (
        set(map(type, cell["quality"])) <= {float, type(None)}
        and set(cell["kind"]) <= set(KINDS)
        and set(cell["outcome"]) <= {None, *OUTCOMES[1:]}
        and set(cell["length_unit"]) <= {UNIT_NAME, OLD_UNIT_NAME}
        and all(
            type(scene) is str and len(scene) <= SCENE_LENGTH and checks.is_unicode(scene)
            for scene in set(cell["scene"])
        )
        and all(map(checks.is_model, set(cell["model"])))
    )


def _arrays(blobs: Sequence[Any], sound: Callable[[Array], BoolArray]) -> list[Array | None] | None:
    """The arrays in a column of blobs, ``None`` for NULL; ``None`` instead of all if one is not sound."""
    arrays: list[Array | None] = [None] * len(blobs)
    of_length: dict[int, list[int]] = {}
    for place, blob in enumerate(blobs):
        if blob is not None:
            if type(blob) is not bytes or len(blob) % 8:
                return None
            of_length.setdefault(len(blob) // 8, []).append(place)
    for length, places in of_length.items():
        content = np.frombuffer(b"".join([blobs[place] for place in places]), dtype="<f8")
        matrix = read_only(content.reshape(len(places), length).astype(np.float64))
        if not sound(matrix).all():
            return None
        for place, row in zip(places, matrix, strict=True):
            arrays[place] = row
    return arrays


def _is_shape(matrix: Array) -> BoolArray:
    low, high = LIMITS["shape"]
    return ((matrix >= low) & (matrix <= high)).all(axis=1) & (matrix.shape[1] == SHAPE_LENGTH)


def _is_grip(matrix: Array) -> BoolArray:
    """Which rows are grips by :func:`.checks.grip`, and within the limits."""
    if not checks.SHORTEST_GRIP <= matrix.shape[1] <= checks.LONGEST_GRIP:
        return np.zeros(len(matrix), dtype=np.bool_)
    low, high = LIMITS["grip"]
    fingers = matrix[:, 7]
    inside = ((matrix >= low) & (matrix <= high)).all(axis=1)
    inside &= (fingers >= 1) & (fingers < checks.MOST_FINGERS) & (fingers == np.rint(fingers))
    turn = np.where(inside[:, None], matrix[:, 3:7], 0.0)
    return inside & (np.abs(np.sqrt((turn**2).sum(axis=1)) - 1.0) <= checks.UNIT_SLACK)
