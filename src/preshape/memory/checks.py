"""Checks of plain data from JSON or database cells; an error message says what was expected."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from ..exceptions import InputError, shown
from ..types import LONGEST_NAME, Array

LARGEST = 2**63 - 1
Fields = Mapping[str, Any]

SHORTEST_GRIP, LONGEST_GRIP = 9, 1000
"""Numbers of the shortest grip, which are a pose, the finger mask and one joint, and of the longest."""
MODEL_LENGTH = 16
"""Number of hexadecimal digits of the hash of a hand's model."""
LONGEST_TIME = 60
"""Largest number of characters of a time."""
UNIT_SLACK = 1e-6
"""Largest deviation of a quaternion's length from 1."""
MOST_FINGERS = 2**17
"""Finger masks are below this number: 16 fingers, and bit 16 for a wrap of the whole hand."""


def exactly(fields: object, names: Sequence[str], what: str) -> Fields:
    """Return ``fields`` if it is a mapping with exactly these names.

    Raises:
        InputError: It is anything else; the message gives the first missing or unknown name.
    """
    if not isinstance(fields, Mapping):
        raise InputError(f"{what} must be an object with {', '.join(names)}, got {shown(fields)}")
    for name in names:
        if name not in fields:
            raise InputError(f"{what} lacks {name!r}")
    for name in fields:
        if name not in names:
            raise InputError(f"{what} has the unknown field {shown(name)}; known: {', '.join(names)}")
    return fields


def text(data: object, name: str) -> str:
    """Return ``data`` if it is a name: text that is not empty, not too long, and can be encoded as UTF-8.

    Raises:
        InputError: It is anything else.
    """
    if not isinstance(data, str) or not data:
        raise InputError(f"{name} must be text, got {shown(data)}")
    if len(data) > LONGEST_NAME:
        raise InputError(f"{name} must have at most {LONGEST_NAME} characters, got {len(data)}")
    if not is_unicode(data):
        raise InputError(f"{name} must be valid Unicode text, got {shown(data)}")
    return data


def is_unicode(data: str) -> bool:
    """Whether text can be encoded as UTF-8."""
    try:
        data.encode()
    except UnicodeEncodeError:
        return False
    return True


def is_model(data: object) -> bool:
    """Whether ``data`` is the hash of a hand's model, or an empty text."""
    digits = set("0123456789abcdef")
    return isinstance(data, str) and (not data or (len(data) == MODEL_LENGTH and set(data) <= digits))


def whole(data: object, name: str, low: int = 0, high: int = LARGEST) -> int:
    """Return ``data`` as a whole number from ``low`` to ``high``.

    Raises:
        InputError: It is anything else; a truth value is not accepted as a number.
    """
    try:
        number = -1 if isinstance(data, bool) else operator.index(data)  # type: ignore[arg-type]
    except TypeError:
        number = -1
    if not low <= number <= high:
        limits = "not below 0" if (low, high) == (0, LARGEST) else f"{low}..{high}"
        raise InputError(f"{name} must be a whole number {limits}, got {shown(data)}")
    return number


def number(data: object, name: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Return ``data`` as a finite number from ``low`` to ``high``.

    Raises:
        InputError: It is anything else; neither a truth value nor text is a number.
    """
    if type(data) is float and math.isfinite(data) and low <= data <= high:  # the common case, fast
        return data
    result = math.nan
    if isinstance(data, int | float | np.integer | np.floating) and not isinstance(data, bool):
        try:
            result = float(data)
        except OverflowError:
            result = math.inf
    if not (math.isfinite(result) and low <= result <= high):
        limits = "" if math.isinf(low) else f" {low:.3g}..{high:.3g}"
        raise InputError(f"{name} must be a finite number{limits}, got {shown(data)}")
    return result


def numbers(data: object, name: str, depth: int = 1) -> list[Any]:
    """Return ``data`` as a list of finite numbers, or for ``depth`` 2 as a list of such lists.

    Raises:
        InputError: It is anything else.
    """
    if not isinstance(data, list | tuple):
        raise InputError(f"{name} must be a list of numbers, got {shown(data)}")
    if depth > 1:
        return [numbers(part, name, depth - 1) for part in data]
    return [number(part, name) for part in data]


def vector(data: object, name: str, length: int | None = None) -> Array:
    """Return a list of finite numbers as an array, and a one-dimensional array unchanged.

    An array given as input is not checked for finite numbers here; the value that takes it does that.

    Raises:
        InputError: It is anything else, or has another length.
    """
    content = data if isinstance(data, np.ndarray) else np.array(numbers(data, name), dtype=np.float64)
    if content.ndim != 1 or (length is not None and len(content) != length):
        raise InputError(f"{name} must be {length or 'n'} numbers, got {content.size}")
    return content


def grip(data: object) -> Array:
    """Return ``data`` as the grip of an :class:`~preshape.types.Experience`: palm pose, finger mask, angles.

    Raises:
        InputError: It is too short, its quaternion is not of unit length, or its finger mask is not a whole
            number of at least 1.
    """
    content = vector(data, "grip")
    if not SHORTEST_GRIP <= len(content) <= LONGEST_GRIP:
        raise InputError(
            f"grip must be a pose of 7 numbers, the fingers and joint angles, got {len(content)} numbers"
        )
    *quaternion, fingers = content[3:8].tolist()
    if not abs(math.hypot(*quaternion) - 1.0) <= UNIT_SLACK:
        raise InputError(f"the grip's quaternion must have length 1, got {shown(quaternion)}")
    if not (fingers.is_integer() and 1 <= fingers < MOST_FINGERS):
        raise InputError(f"the grip's fingers must be a whole number from 1, got {fingers:.6g}")
    return content


def utc(data: object, name: str = "created") -> str:
    """Return ``data`` if it is an ISO 8601 time in UTC.

    Raises:
        InputError: It is anything else.
    """
    moment = None
    if isinstance(data, str) and data.isascii() and len(data) <= LONGEST_TIME:
        try:
            moment = datetime.fromisoformat(data)
        except ValueError:
            moment = None
    if moment is None or moment.utcoffset() != timedelta(0):
        raise InputError(f"{name} must be an ISO 8601 time in UTC, got {shown(data)}")
    return str(data)
