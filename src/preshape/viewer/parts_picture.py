"""The picture of an object's parts: coloured and named, from the front above and from behind below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..types import Array, IntArray, value
from .colours import BLUE, GREEN, INK, OBJECT, ORANGE, PURPLE, QUIET, SKY, VERMILION, YELLOW, Colour
from .labels import Label, draw_labels, text_width
from .picture_file import Target, check_target, write_png
from .raycast import Camera, Shape, project, render, visible
from .sheet import Sheet, new_sheet

WIDTH, HEIGHT, TOP = 1400.0, 760.0, 60.0
"""Size of the sheet, and height of its heading [layout units]."""
VIEWS = np.array([[0.75, -0.75, 0.45], [-0.75, 0.75, -0.35]])
"""Directions towards the eye."""
COLOURS = (VERMILION, BLUE, GREEN, ORANGE, PURPLE, SKY, YELLOW)
"""Colours of the parts in turn."""
LOOKED_AT = 400
"""Number of places of a part that are tried for its label's pointer."""


@value
class PartPiece:
    """The piece of a surface that is drawn in one colour.

    Attributes:
        name: Name of the part; empty for the rest of the surface.
        vertices: (n, 3) positions [m].
        triangles: (m, 3) vertex indices.
    """

    name: str
    vertices: Array
    triangles: IntArray


def parts_picture(pieces: Sequence[PartPiece], target: Target, *, title: str, facts: str = "") -> None:
    """Draw an object in pieces and write it as PNG; after a failure, no incomplete file is left.

    Args:
        pieces: The pieces, which together are the object's surface.
        target: A path that ends in ``.png``, or a binary file open for writing.
        title: The heading.
        facts: A line beside it.

    Raises:
        InputError: The name does not end in ``.png``.
        EnvironmentFailure: The file cannot be written.
    """
    check_target(target)
    named = [piece.name for piece in pieces if piece.name]
    colour = {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(named)}
    shapes = [
        Shape(vertices=p.vertices, triangles=p.triangles, colour=colour.get(p.name, OBJECT), name=p.name)
        for p in pieces
        if len(p.triangles)
    ]
    with new_sheet(WIDTH, HEIGHT, 1.0) as sheet:
        for k, direction in enumerate(VIEWS):
            _view(sheet, shapes, colour, direction, k * WIDTH / 2)
        sheet.text(30, 32, title, 17, INK, weight="bold")
        sheet.text(30 + text_width(title, 17, bold=True) + 24, 33, facts, 12, QUIET)
        image = sheet.image()
    write_png(image, target)


def _view(
    sheet: Sheet, shapes: Sequence[Shape], colour: dict[str, Colour], direction: Array, left: float
) -> None:
    """Draw one view with a label for each part that it shows."""
    width, height = WIDTH / 2, HEIGHT - TOP
    size = sheet.pixels(width, height)
    points = np.concatenate([shape.vertices for shape in shapes])
    camera = Camera.framing(points, direction, aspect=width / height, margin=1.35)
    axes = sheet.picture(left, TOP, width, height, render(shapes, camera, size))
    labels = []
    for shape in shapes:
        if shape.name:
            corners = shape.vertices[shape.triangles][:: max(1, len(shape.triangles) // LOOKED_AT)]
            middles = corners.mean(axis=1)
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            # The inside of a thin wall may pass for visible, but faces away.
            middles = middles[np.einsum("ij,ij->i", normals, camera.eye - middles) > 0]
            seen = middles[visible(shapes, camera, middles)]
            if len(seen):
                flat = project(camera, seen, size) / sheet.scale
                nearest = np.linalg.norm(flat - np.median(flat, axis=0), axis=1).argmin()
                labels.append(Label(text=shape.name, anchor=flat[nearest], colour=colour[shape.name]))
    draw_labels(axes, labels, (width, height), points=12)
