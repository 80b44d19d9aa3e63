"""Which labels of a scene have room in its picture: where two would overlap, the less important one goes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..types import Array
from .camera import Camera, project

LETTER, LINE = 6.6, 17.0
"""Width of a letter and height of a label [pixels]."""
PAD = 8.0
"""A label is wider than its letters by this [pixels]."""
RANKS = ("contacts", "axes", "task", "net", "planes", "frame")
"""Groups of labels, the most important first."""


def crowded_out(labels: Mapping[str, tuple[str, Array]], camera: Camera, size: tuple[int, int]) -> set[str]:
    """Names of the labels that give way.

    Args:
        labels: by name, as ``axes/a-name``, the words and the point (3,) [m].
        camera: of the picture.
        size: its width and height [pixels].
    """
    if not labels:
        return set()
    names = sorted(labels, key=_rank)
    places = project(camera, np.array([labels[name][1] for name in names]), size)
    kept: list[tuple[float, float, float]] = []
    gone = set()
    for name, (x, y) in zip(names, places, strict=True):
        half = (LETTER * len(labels[name][0]) + PAD) / 2
        if any(abs(x - a) < half + other and abs(y - b) < LINE for a, b, other in kept):
            gone.add(name)
        else:
            kept.append((float(x), float(y), half))
    return gone


def _rank(name: str) -> tuple[int, str]:
    group = name.partition("/")[0]
    return (RANKS.index(group) if group in RANKS else len(RANKS), name)
