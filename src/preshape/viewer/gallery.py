"""Pictures of an object, of a hand, and of many objects beside each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..exceptions import InputError
from ..hands.kinematics import LinkShape
from ..objects.mesh import TriangleMesh
from ..types import Array
from .colours import HAND, INK, SKY_TOP
from .labels import FONT, wrap
from .picture_file import Target, check_target, write_png
from .raycast import Camera, Image, Shape, render
from .shapes import hand_shape, object_shape

VIEW = (0.62, -0.72, 0.46)
"""From the object towards the eye, unless told otherwise."""


def _portrait(shape: Shape, size: tuple[int, int], direction: Sequence[float] | Array) -> Image:
    points = shape.vertices[np.unique(shape.triangles)]
    camera = Camera.framing(points, np.asarray(direction), aspect=size[0] / size[1], margin=1.3)
    return render([shape], camera, size, ground=float(points[:, 2].min()))


def object_picture(
    mesh: TriangleMesh,
    target: Target,
    size: tuple[int, int] = (900, 900),
    *,
    direction: Sequence[float] | Array = VIEW,
) -> None:
    """Draw an object.

    Args:
        mesh: the object.
        target: a path that ends in ``.png``, or a binary file.
        size: width and height [pixels].
        direction: (3,) from the object towards the eye.

    Raises:
        InputError: a size below 1, or a name that does not end in ``.png``.
        EnvironmentFailure: the file cannot be written.
    """
    check_target(target)
    write_png(_portrait(object_shape(mesh), size, direction), target)


def hand_picture(
    parts: Sequence[LinkShape],
    target: Target,
    size: tuple[int, int] = (900, 900),
    *,
    direction: Sequence[float] | Array = (0.75, -0.55, 0.35),
) -> None:
    """Draw a hand; arguments and errors as for :func:`object_picture`."""
    check_target(target)
    write_png(_portrait(hand_shape(parts, colour=HAND), size, direction), target)


def contact_sheet(
    objects: Sequence[tuple[TriangleMesh, str]], target: Target, columns: int = 4, *, cell: int = 300
) -> None:
    """Draw many objects in rows, each with its label beneath.

    Args:
        objects: objects and their labels.
        target: a path that ends in ``.png``, or a binary file.
        columns: pictures in a row.
        cell: width of one picture [pixels].

    Raises:
        InputError: no objects, no columns, cells under 60 pixels, or a name that does not end in ``.png``.
        EnvironmentFailure: the file cannot be written.
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
    paper = tuple(round(255 * c) for c in SKY_TOP)
    sheet = Pillow.new("RGB", (columns * cell, rows * height), (255, 255, 255))
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.truetype(findfont(FONT), points * 100 / 72)
    for i, ((mesh, _), text) in enumerate(zip(objects, texts, strict=True)):
        x, y = i % columns * cell, i // columns * height
        sheet.paste(Pillow.fromarray(_portrait(object_shape(mesh), (cell, cell), VIEW)), (x, y))
        draw.rectangle([x, y, x + cell - 1, y + height - 1], outline=paper)
        for row, words in enumerate(text):
            at = (x + cell / 2, y + cell + line * (row + 0.75))
            draw.text(at, words, font=font, fill=tuple(round(255 * c) for c in INK), anchor="mm")
    write_png(np.asarray(sheet), target)
