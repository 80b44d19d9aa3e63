"""A sheet of text and pictures, laid out in fixed units and drawn by Matplotlib at any size."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from .colours import INK, PAPER, Colour
from .labels import FONT
from .raycast import Image


class Sheet:
    """A white sheet; positions are in layout units from its left and from its top.

    Attributes:
        base: Matplotlib axes that cover the sheet.
    """

    def __init__(self, width: float, height: float, scale: float) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self.width, self.height, self.scale = width, height, scale
        self._figure = Figure(figsize=(width / 100, height / 100), dpi=100 * scale, facecolor=PAPER)
        self._canvas = FigureCanvasAgg(self._figure)
        self.base = self.axes(0, 0, width, height)

    def axes(self, left: float, top: float, width: float, height: float) -> Any:
        """Matplotlib axes without a frame, in layout units from their left and top."""
        low = 1 - (top + height) / self.height
        axes = self._figure.add_axes((left / self.width, low, width / self.width, height / self.height))
        axes.set_axis_off()
        axes.set(xlim=(0, width), ylim=(height, 0))
        return axes

    def pixels(self, width: float, height: float) -> tuple[int, int]:
        """Width and height of an area, in pixels of the drawn sheet."""
        return round(width * self.scale), round(height * self.scale)

    def picture(self, left: float, top: float, width: float, height: float, image: Image) -> Any:
        """Axes as from :meth:`axes` that show an image of the size given by :meth:`pixels`."""
        axes = self.axes(left, top, width, height)
        axes.imshow(image, extent=(0, width, height, 0), interpolation="nearest", aspect="auto")
        return axes

    def text(self, x: float, y: float, text: str, points: float, colour: Colour = INK, **style: Any) -> None:
        """Write one line, whose middle is at height ``y``."""
        style = {"ha": "left", "va": "center_baseline"} | style
        self.base.text(x, y, text, fontsize=points, color=colour, parse_math=False, **style)

    def image(self) -> Image:
        """The drawn sheet (h, w, 3)."""
        self._canvas.draw()
        return np.array(np.asarray(self._canvas.buffer_rgba())[:, :, :3])


@contextmanager
def new_sheet(width: float, height: float, scale: float) -> Iterator[Sheet]:
    """A sheet drawn with Matplotlib's own defaults instead of the user's settings.

    Args:
        width: Width [layout units].
        height: Height [layout units].
        scale: Pixels for each layout unit.
    """
    import matplotlib.style

    style = {"font.family": FONT, "text.hinting": "none"}
    with matplotlib.style.context("default"), matplotlib.rc_context(style):
        yield Sheet(width, height, scale)
