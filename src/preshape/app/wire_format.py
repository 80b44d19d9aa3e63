"""Arrays as text between the server and a planner process."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np


def encoded(array: Any, kind: str) -> str:
    """The bytes of an array in base 64.

    >>> decoded(encoded([[1.0, 2.0], [3.0, 4.0]], "<f8"), "<f8", 2).tolist()
    [[1.0, 2.0], [3.0, 4.0]]
    """
    return base64.b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode("ascii")


def decoded(text: str, kind: str, width: int) -> Any:
    """The array (n, width) that :func:`encoded` wrote."""
    return np.frombuffer(base64.b64decode(text), dtype=kind).reshape(-1, width)
