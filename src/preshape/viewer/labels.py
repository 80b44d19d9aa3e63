"""Text in pictures: width, line breaks, missing characters, and places where a label covers nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from ..types import Array, freeze, frozen_array, value
from .camera import Camera, project
from .canvas import group_of
from .colours import INK, Colour

FONT = "DejaVu Sans"
"""The font comes with Matplotlib, so that a picture looks the same everywhere."""
_GAP = 5.0
"""Free space between labels [pixels at 100 dpi]."""

LETTER_WIDTH, LINE_HEIGHT = 6.6, 17.0
"""Mean width of a letter and height of a label in the browser's scene [pixels]."""
_PADDING = 8.0
"""Width that a label in the browser has in addition to its letters [pixels]."""
_PRIORITY = ("contacts", "axes", "task", "net", "planes", "frame")
"""Groups of labels, the most important first."""


@value
class Label:
    """A text with a pointer to a place in a picture.

    Attributes:
        text: One or more lines.
        anchor: (2,) Place that the label points at [pixels from the left and from the top].
        colour: Colour of frame and pointer.
        hidden: Whether the place lies behind something; the pointer is then dotted.
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
    """The text on one line, with ``?`` for characters that the font lacks.

    >>> plain("  two   words ")
    'two words'
    """
    return "".join(c if ord(c) in _characters() else "?" for c in " ".join(text.split()))


def text_width(text: str, points: float, *, bold: bool = False) -> float:
    """Width of one line of text [pixels at 100 dpi]."""
    return float(_font(bold).getlength(text)) * points / 72


def wrap(text: str, width: float, points: float, *, lines: int, bold: bool = False) -> list[str]:
    """Break text into lines of limited width; a word that is wider than a line is broken too.

    Args:
        text: Any text; it is made :func:`plain` first.
        width: Width of a line [pixels at 100 dpi].
        points: Font size.
        lines: Most lines; text that does not fit is replaced by an ellipsis.
        bold: Whether the text is bold.
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
    """Place each label near its anchor, clear of the other labels, of all anchors and of the border.

    Labels are placed one after the other. For each, candidate places at 24 angles and growing distances are
    compared. The one that covers least is taken; between equal ones, the nearer one that points away from the
    middle of the picture.

    Args:
        anchors: (n, 2) Anchors [pixels from the left and from the top].
        boxes: (n, 2) Width and height of each label [pixels].
        size: Width and height of the picture [pixels].
        keep_clear: (k, 4) Further rectangles to keep clear: left, top, right, bottom [pixels].

    Returns:
        (n, 2) Left and top of each label [pixels]. If a label fits nowhere, it is put where it covers least.
    """
    radius = 9.0
    taken = np.concatenate([anchors - radius, anchors + radius], axis=1)
    if keep_clear is not None:
        taken = np.concatenate([taken, keep_clear])
    angle = np.radians(np.arange(0, 360, 15))
    directions = np.column_stack([np.cos(angle), np.sin(angle)])
    reaches = np.arange(18, 420, 14.0)
    middle = np.asarray(size) / 2
    result = np.zeros((len(anchors), 2))
    for i, (anchor, box) in enumerate(zip(anchors, boxes, strict=True)):
        # The nearest side of the label is `reach` away from the anchor, whatever the label's proportions.
        centre = anchor + directions[None] * (reaches[:, None, None] + np.abs(directions[None]) * box / 2)
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
    """(n,) Area that each candidate rectangle shares with all taken rectangles [pixels²]."""
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
    """Draw labels onto a picture.

    Args:
        axes: Matplotlib axes whose coordinates are pixels from the left and from the top.
        labels: Labels.
        size: Width and height of the picture [pixels at 100 dpi].
        points: Font size.
        keep_clear: (k, 4) Rectangles to keep clear: left, top, right, bottom [pixels].

    Returns:
        (n, 4) Left, top, right and bottom of each label as drawn [pixels].
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


def overlapping_labels(
    labels: Mapping[str, tuple[str, Array]], camera: Camera, size: tuple[int, int]
) -> set[str]:
    """Names of the labels to hide in a browser's scene because they overlap more important ones.

    Args:
        labels: Text and point (3,) [m] of each label by name, for example ``axes/a-name``.
        camera: Camera of the picture.
        size: Width and height of the picture [pixels].
    """
    if not labels:
        return set()
    names = sorted(labels, key=_priority)
    places = project(camera, np.array([labels[name][1] for name in names]), size)
    shown: list[tuple[float, float, float]] = []
    hidden = set()
    for name, (x, y) in zip(names, places, strict=True):
        half = (LETTER_WIDTH * len(labels[name][0]) + _PADDING) / 2
        if any(abs(x - a) < half + other and abs(y - b) < LINE_HEIGHT for a, b, other in shown):
            hidden.add(name)
        else:
            shown.append((float(x), float(y), half))
    return hidden


def _priority(name: str) -> tuple[int, str]:
    group = group_of(name)
    return (_PRIORITY.index(group) if group in _PRIORITY else len(_PRIORITY), name)
