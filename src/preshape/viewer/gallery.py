"""Portraits: one shape alone, such as a hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..types import Array
from .raycast import Camera, Image, Shape, render


def portrait(shape: Shape, size: tuple[int, int], direction: Sequence[float] | Array) -> Image:
    """The picture of a shape that stands on the ground, seen from a direction (3,)."""
    points = shape.vertices[np.unique(shape.triangles)]
    camera = Camera.framing(points, np.asarray(direction), aspect=size[0] / size[1], margin=1.3)
    return render([shape], camera, size, ground=float(points[:, 2].min()))
