"""Pictures of a hand, and of many objects in a grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..exceptions import InputError
from ..hands.kinematics import LinkShape
from ..objects.mesh import TriangleMesh
from ..types import Array
from .colours import INK, PAPER, SKY_TOP, to_bytes
from .labels import FONT, wrap
from .picture_file import Target, check_target, write_png
from .raycast import Camera, Image, Shape, render
from .shapes import hand_shape, object_shape

VIEW = (0.62, -0.72, 0.46)
"""Direction from an object towards the eye."""


def _portrait(shape: Shape, size: tuple[int, int], direction: Sequence[float] | Array) -> Image:
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
    write_png(_portrait(hand_shape(parts), size, direction), target)


def contact_sheet(
    objects: Sequence[tuple[TriangleMesh, str]], target: Target, columns: int = 4, *, cell: int = 300
) -> None:
    """Draw a grid of objects, each with its label beneath.

    Args:
        objects: Objects and their labels.
        target: A path that ends in ``.png``, or a binary file.
        columns: Number of pictures in a row.
        cell: Width of one picture [pixels].

    Raises:
        InputError: There are no objects or columns, the cells are under 60 pixels, or the name does not end
            in ``.png``.
        EnvironmentFailure: The file cannot be written.
    """
    from matplotlib.font_manager import findfont
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    if not objects or columns < 1 or cell < 60:
        raise InputError("a contact sheet needs an object, a column, and cells of 60 pixels or more")
    check_target(target)
    columns = min(columns, len(objects))
    points = max(8.0, cell / 30)
    line = round(points * 1.9)
    texts = [wrap(label, cell * 0.9, points, lines=2) for _, label in objects]
    height = cell + line * max(len(text) for text in texts) + line // 2
    rows = -(-len(objects) // columns)
    sheet = Pillow.new("RGB", (columns * cell, rows * height), to_bytes(PAPER))
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.truetype(findfont(FONT), points * 100 / 72)
    for i, ((mesh, _), text) in enumerate(zip(objects, texts, strict=True)):
        x, y = i % columns * cell, i // columns * height
        sheet.paste(Pillow.fromarray(_portrait(object_shape(mesh), (cell, cell), VIEW)), (x, y))
        draw.rectangle([x, y, x + cell - 1, y + height - 1], outline=to_bytes(SKY_TOP))
        for row, words in enumerate(text):
            at = (x + cell / 2, y + cell + line * (row + 0.75))
            draw.text(at, words, font=font, fill=to_bytes(INK), anchor="mm")
    write_png(np.asarray(sheet), target)
