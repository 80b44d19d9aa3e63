"""Text that fits: measured, wrapped, free of missing characters, and placed where nothing else is."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from ..types import Array, freeze, frozen_array, value
from .colours import INK, Colour

FONT = "DejaVu Sans"
"""Comes with Matplotlib, so that a picture looks the same everywhere."""

_GAP = 5.0  # [pixels at 100 dpi] kept free between labels


@value
class Label:
    """A text that points at something.

    Attributes:
        text: one or more lines.
        anchor: (2,) what it points at, pixels from the left and from the top.
        colour: of its frame and pointer.
        hidden: what it points at is behind something: the pointer is dotted.
    """

    text: str
    anchor: Array
    colour: Colour
    hidden: bool = False

    def __post_init__(self) -> None:
        freeze(self, anchor=frozen_array(self.anchor, (2,), "label anchor"))


@cache
def _font(bold: bool) -> Any:
    from matplotlib.font_manager import FontProperties, findfont
    from PIL import ImageFont

    return ImageFont.truetype(findfont(FontProperties(family=FONT, weight="bold" if bold else "normal")), 100)


@cache
def _characters() -> frozenset[int]:
    from matplotlib.font_manager import findfont, get_font

    return frozenset(get_font(findfont(FONT)).get_charmap())


def plain(text: str) -> str:
    """The text on one line, with ``?`` for what the font lacks.

    >>> plain("  two   words ")
    'two words'
    """
    return "".join(c if ord(c) in _characters() else "?" for c in " ".join(text.split()))


def text_width(text: str, points: float, *, bold: bool = False) -> float:
    """Width of one line [pixels at 100 dpi]."""
    return float(_font(bold).getlength(text)) * points / 72


def wrap(text: str, width: float, points: float, *, lines: int, bold: bool = False) -> list[str]:
    """Break text into lines that fit; a word longer than a line is broken too.

    Args:
        text: any text; see :func:`plain`.
        width: of a line [pixels at 100 dpi].
        points: font size.
        lines: at most so many; what is left over ends in an ellipsis.
        bold: whether it is bold.
    """
    result, line = [], ""
    words = plain(text).split(" ")
    while words:
        word = words.pop(0)
        trial = f"{line} {word}".strip()
        if text_width(trial, points, bold=bold) <= width:
            line = trial
        elif line:
            result.append(line)
            line, words = "", [word, *words]
        else:
            cut = max(
                (n for n in range(1, len(word)) if text_width(word[:n], points, bold=bold) <= width),
                default=1,
            )
            result.append(word[:cut])
            words = [word[cut:], *words] if word[cut:] else words
    result = [*result, line] if line else result
    if len(result) > lines:
        last = result[lines - 1]
        while last and text_width(last + "…", points, bold=bold) > width:
            last = last[:-1]
        result = [*result[: lines - 1], last.rstrip() + "…"]
    return result


def place(
    anchors: Array, boxes: Array, size: tuple[float, float], *, keep_clear: Array | None = None
) -> Array:
    """Find a place for each label near its anchor, clear of the other labels, all anchors and the border.

    Args:
        anchors: (n, 2) pixels from the left and from the top.
        boxes: (n, 2) width and height of each label [pixels].
        size: width and height of the picture [pixels].
        keep_clear: (k, 4) further rectangles: left, top, right, bottom [pixels].

    Returns:
        (n, 2) left and top of each label. Labels are placed in the order given; one that fits nowhere is
        put where it covers least.
    """
    radius = 9.0
    taken = np.concatenate([anchors - radius, anchors + radius], axis=1)
    if keep_clear is not None:
        taken = np.concatenate([taken, keep_clear])
    angle = np.radians(np.arange(0, 360, 15))
    ways = np.column_stack([np.cos(angle), np.sin(angle)])
    reaches = np.arange(18, 420, 14.0)
    middle = np.asarray(size) / 2
    result = np.zeros((len(anchors), 2))
    for i, (anchor, box) in enumerate(zip(anchors, boxes, strict=True)):
        # the label's nearest side stands `reach` from the anchor, whatever the label's proportions
        centre = anchor + ways[None] * (reaches[:, None, None] + np.abs(ways[None]) * box / 2)
        low = centre.reshape(-1, 2) - box / 2
        low = np.clip(low, _GAP, np.maximum(np.asarray(size) - box - _GAP, _GAP))
        overlap = _overlap(np.concatenate([low - _GAP / 2, low + box + _GAP / 2], axis=1), taken)
        away = np.linalg.norm(low + box / 2 - anchor, axis=1)
        outward = ((low + box / 2 - anchor) * (anchor - middle)).sum(axis=1)
        outward /= np.maximum(away * np.linalg.norm(anchor - middle), 1e-9)
        best = low[np.argmin(overlap * 1e3 + away - 25 * outward)]
        result[i] = best
        taken = np.concatenate([taken, [[*best, *(best + box)]]])
    return result


def _overlap(candidates: Array, taken: Array) -> Array:
    """(n,) area [pixels²] that each candidate shares with all the rectangles taken."""
    low = np.maximum(candidates[:, None, :2], taken[None, :, :2])
    high = np.minimum(candidates[:, None, 2:], taken[None, :, 2:])
    return np.asarray(np.prod(np.clip(high - low, 0, None), axis=2).sum(axis=1))


def draw_labels(
    axes: Any,
    labels: Sequence[Label],
    size: tuple[float, float],
    *,
    points: float,
    keep_clear: Array | None = None,
) -> Array:
    """Draw labels on axes that show pixels (left, top) of a picture of ``size``.

    Args:
        axes: Matplotlib axes.
        labels: what to write.
        size: width and height [pixels at 100 dpi].
        points: font size.
        keep_clear: (k, 4) rectangles that labels should leave free: left, top, right, bottom.

    Returns:
        (n, 4) left, top, right, bottom of each label as drawn [pixels].
    """
    from matplotlib.patches import FancyBboxPatch

    if not labels:
        return np.zeros((0, 4))
    rows = [label.text.split("\n") for label in labels]
    width = [max(text_width(line, points) for line in lines) + 16 for lines in rows]
    boxes = np.column_stack([width, [8 + 1.75 * points * len(lines) for lines in rows]])
    corners = place(np.array([label.anchor for label in labels]), boxes, size, keep_clear=keep_clear)
    for label, low, box in zip(labels, corners, boxes, strict=True):
        end = np.clip(label.anchor, low, low + box)
        line = np.array([label.anchor, end]).T
        inner, rim = ("white", label.colour) if label.hidden else (label.colour, "white")
        axes.plot(*line, color=label.colour, lw=1.4, zorder=4, ls=(0, (1, 1.2)) if label.hidden else "-")
        axes.plot(*label.anchor, "o", ms=4, color=inner, mec=rim, mew=0.8, zorder=5)
        frame = FancyBboxPatch(low, box[0], box[1], boxstyle="round,pad=0,rounding_size=4", zorder=6)
        frame.set(facecolor="white", edgecolor=label.colour, linewidth=1.2, alpha=0.93)
        axes.add_patch(frame)
        style = {"ha": "center", "va": "center", "fontsize": points, "color": INK, "linespacing": 1.25}
        axes.text(*(low + box / 2 + [0, 1]), label.text, zorder=7, parse_math=False, **style)
    return np.concatenate([corners, corners + boxes], axis=1)
