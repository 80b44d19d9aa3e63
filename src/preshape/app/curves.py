"""Membership functions and contact coefficients as small SVG pictures with points that can be dragged.

A picture names the text box with its numbers (``data-box``). A drag writes new numbers into the box, as a
user could by hand, and the picture is then redrawn from the box.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib import resources

import numpy as np

from ..hiis.fuzzy import SET_NAMES, FuzzySets
from ..types import ContactCoefficients

WIDE, HIGH = 340, 128
LEFT, RIGHT, TOP, BOTTOM = 14, 8, 10, 20
EDGE = 1.2
"""The pictures of membership functions show values from -EDGE to EDGE."""
CHOSEN, OTHER, INK = "#0072B2", "#A9B2BC", "#59626D"
PARTS = (
    ("ka", "#0072B2", ""),
    ("ko", "#D55E00", "7 3"),
    ("kn", "#22262B", ""),
    ("mn", "#009E73", "2 3"),
)
"""Name, colour and dash pattern of each coefficient."""
CORNERS, COEFFICIENTS = "corners", "ka ko kn mn"
"""Labels of the text boxes that hold the numbers."""
_GRIP = 'style="cursor:grab;touch-action:none"'


def membership_svg(sets: FuzzySets, chosen: int) -> str:
    """The seven sets, one of them in colour with its corners.

    Args:
        sets: The membership functions.
        chosen: Index of the set in colour.
    """
    x = np.unique(np.concatenate([np.linspace(-EDGE, EDGE, 241), sets.corners.ravel()]))
    x = x[np.abs(x) <= EDGE]
    lines = []
    order = [i for i in range(len(SET_NAMES)) if i != chosen] + [chosen]
    for i in order:
        points = " ".join(f"{_x(a):.1f},{_y(b):.1f}" for a, b in zip(x, sets.layers(x)[i], strict=True))
        colour, width = (CHOSEN, 2.6) if i == chosen else (OTHER, 1.3)
        lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width}"/>')
    lines += [
        f'<circle data-i="{i}" cx="{_x(c):.1f}" cy="{_y(h):.1f}" r="5" fill="#fff" stroke="{CHOSEN}" '
        f'stroke-width="2" {_GRIP}/>'
        for i, (c, h) in enumerate(zip(sets.corners[chosen], (0, 1, 1, 0), strict=True))
    ]
    middle = (sets.corners[chosen, 1] + sets.corners[chosen, 2]) / 2
    anchor = "start" if middle < -0.7 else "end" if middle > 0.7 else "middle"
    lines.append(_text(_x(middle), TOP - 2, SET_NAMES[chosen], anchor, CHOSEN))
    return _picture("".join(lines), f"membership functions, {SET_NAMES[chosen]} in colour", (-1, 0, 1))


def coefficient_svg(coefficients: ContactCoefficients, most: float) -> str:
    """Force and moment of a contact plotted against its normal force: one line for each coefficient.

    Args:
        coefficients: Coefficients of the contact model.
        most: Largest coefficient that the picture can show.
    """
    lines = []
    ends: list[float] = []
    for i, (name, colour, dash) in enumerate(PARTS):
        share = min(1.0, float(getattr(coefficients, name)) / most)
        x, y = WIDE - RIGHT - 26, HIGH - BOTTOM - share * (HIGH - TOP - BOTTOM)
        lines.append(
            f'<path d="M{LEFT} {HIGH - BOTTOM}L{x} {y:.1f}" fill="none" stroke="{colour}" '
            f'stroke-width="2.2" stroke-dasharray="{dash}"/><circle data-i="{i}" cx="{x}" cy="{y:.1f}" r="5" '
            f'fill="{colour}" {_GRIP}/>'
        )
        beside = y + 4
        while any(abs(beside - other) < 11 for other in ends):
            beside -= 11
        ends.append(beside)
        lines.append(_text(x + 8, beside, name, "start", colour))
    frame = f'<path d="M{LEFT} {TOP}V{HIGH - BOTTOM}H{WIDE - RIGHT}" fill="none" stroke="{INK}"/>'
    words = _text(WIDE - RIGHT, HIGH - 5, "normal force, 0 to 1", "end", INK)
    drag = _drag(COEFFICIENTS, "y", (HIGH - BOTTOM, TOP), (0.0, most), sort=False)
    return _svg(frame + "".join(lines) + words, "contact force and moment against normal force", drag)


def _picture(inside: str, words: str, ticks: Sequence[float]) -> str:
    frame = f'<path d="M{LEFT} {HIGH - BOTTOM}H{WIDE - RIGHT}" fill="none" stroke="{INK}"/>'
    marks = "".join(_text(_x(t), HIGH - 5, f"{t:g}", "middle", INK) for t in ticks)
    drag = _drag(CORNERS, "x", (LEFT, WIDE - RIGHT), (-EDGE, EDGE), sort=True)
    return _svg(frame + inside + marks, words, drag)


def _drag(
    box: str, axis: str, pixels: tuple[float, float], numbers: tuple[float, float], *, sort: bool
) -> str:
    """Attributes for the drag script: the text box, the axis, and the numbers that match ``pixels``."""
    script = (resources.files("preshape.viewer") / "web" / "drag.js").read_text(encoding="utf-8")
    data = {"box": box, "axis": axis, "from": pixels[0], "to": pixels[1]}
    data |= {"low": numbers[0], "high": numbers[1], "sort": int(sort)}
    attributes = " ".join(f'data-{key}="{content}"' for key, content in data.items())
    return f'id="drag-{box.replace(" ", "-")}" {attributes} onpointerdown="{escape(script)}"'


def _svg(inside: str, words: str, more: str) -> str:
    frame = f'viewBox="0 0 {WIDE} {HIGH}" width="100%" role="img" aria-label="{words}"'
    return f"<svg {frame} {more}>{inside}</svg>"


def _text(x: float, y: float, text: str, anchor: str, colour: str) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="11" fill="{colour}">{text}</text>'
    )


def _x(number: float) -> float:
    return LEFT + (float(number) + EDGE) / (2 * EDGE) * (WIDE - LEFT - RIGHT)


def _y(share: float) -> float:
    return HIGH - BOTTOM - float(share) * (HIGH - TOP - BOTTOM)
