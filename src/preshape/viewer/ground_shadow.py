"""The soft shadow of an object on the ground below it: a small picture that costs a browser one rectangle."""

from __future__ import annotations

import numpy as np

from ..objects.mesh import TriangleMesh
from ..objects.resting import turned_up
from ..types import Array, value
from .raycast import Image

PIXELS = 128
"""Width and height of the picture."""
MARGIN = 0.6
"""Room around the object for the soft edge, in units of the object's larger horizontal extent."""
DARKEST = 0.7
"""Opacity of the shadow under what touches the ground."""
FADES = 0.35
"""Height above the ground at which the shadow is weaker by 1/e, in units of the horizontal extent."""
SOFT = 0.025, 0.09
"""Widths of the blur near the contact and around it, in units of the picture's width."""
INK = 40, 46, 56
"""Colour of the shadow, 0 to 255."""


@value
class GroundShadow:
    """A picture on the ground.

    Attributes:
        picture: (p, p, 4) colour and opacity, 0 to 255; the first row lies farthest along the ground's y.
        width: Its width and height [m].
        place: (4, 4) pose of the picture's middle; its z axis is up [m].
    """

    picture: Image
    width: float
    place: Array


def ground_shadow(mesh: TriangleMesh, up: Array, ground: float) -> GroundShadow:
    """The shadow of an object in light from everywhere above.

    The object's outline is drawn from above, darker where its surface is near the ground, and blurred twice:
    a little for the contact, and more for what the object keeps of the sky.

    Args:
        mesh: The object [m].
        up: (3,) unit vector that is up.
        ground: Height of the ground along up [m].
    """
    from PIL import Image as Pictures
    from PIL import ImageChops, ImageDraw, ImageFilter

    R = turned_up(up)
    points = mesh.vertices @ R.T
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float(np.max((high - low)[:2]))
    width = (1.0 + 2 * MARGIN) * extent
    middle = (low + high) / 2
    spots = (points[:, :2] - middle[:2]) * [1.0, -1.0] * (PIXELS / width) + PIXELS / 2
    heights = points[mesh.triangles, 2].mean(axis=1) - ground
    greys = np.rint(255 * np.exp(-np.maximum(heights, 0.0) / (FADES * extent))).astype(int)
    drawn = Pictures.new("L", (PIXELS, PIXELS), 0)
    pen = ImageDraw.Draw(drawn)
    for k in np.argsort(-heights, kind="stable"):  # what is lowest is drawn last
        pen.polygon([tuple(spot) for spot in spots[mesh.triangles[k]]], fill=int(greys[k]))
    near, far = (drawn.filter(ImageFilter.GaussianBlur(share * PIXELS)) for share in SOFT)
    opacity = DARKEST * np.asarray(ImageChops.lighter(near, far), dtype=np.float64)
    picture = np.empty((PIXELS, PIXELS, 4), dtype=np.uint8)
    picture[..., :3] = INK
    picture[..., 3] = np.rint(opacity)
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = R.T, np.array([middle[0], middle[1], ground]) @ R
    return GroundShadow(picture=picture, width=width, place=place)
