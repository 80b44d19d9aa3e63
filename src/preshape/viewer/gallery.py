"""Portraits: one shape alone, such as a hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..hands.kinematics import LinkShape
from ..types import Array
from .picture_file import Target, check_target, write_png
from .raycast import Camera, Image, Shape, render
from .shapes import hand_shape


def portrait(shape: Shape, size: tuple[int, int], direction: Sequence[float] | Array) -> Image:
    """The picture of a shape that stands on the ground, seen from a direction (3,)."""
    points = shape.vertices[np.unique(shape.triangles)]
    camera = Camera.framing(points, np.asarray(direction), aspect=size[0] / size[1], margin=1.3)
    return render([shape], camera, size, ground=float(points[:, 2].min()))


def hand_picture(
    parts: Sequence[LinkShape],
    target: Target,
    size: tuple[int, int] = (900, 900),
    *,
    direction: Sequence[float] | Array = (0.75, -0.55, 0.35),
) -> None:
    """Draw a hand.

    Args:
        parts: Links of the hand at their poses.
        target: A path that ends in ``.png``, or a binary file.
        size: Width and height [pixels].
        direction: (3,) Direction from the hand towards the eye.

    Raises:
        InputError: The size is below 1, or the name does not end in ``.png``.
        EnvironmentFailure: The file cannot be written.
    """
    check_target(target)
    write_png(portrait(hand_shape(parts), size, direction), target)
