"""The picture of a plan: the grasp in 3D, task and net wrench side by side, and the reasons."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..exceptions import InputError
from ..types import Array
from .canvas import group_of
from .colours import (
    APPROACH,
    AVOID,
    BLACK,
    FAINT,
    INK,
    OPPOSITION,
    PAPER,
    QUIET,
    TASK,
    TRANSVERSE,
    WRENCH,
    Colour,
    finger_colour,
)
from .draw import recorded
from .labels import Label, draw_labels, text_width, wrap
from .picture_file import Target, check_target, write_png
from .plan_scene import (
    PlaneCard,
    PlanScene,
    approach_arrow,
    arrow_segments,
    axis_tips,
    plane_cards,
    view_direction,
)
from .raycast import Camera, Image, Shape, project, render, visible
from .shapes import hand_shape
from .sheet import Sheet, new_sheet

__all__ = ["PlanScene", "PlaneCard", "plan_image", "plan_picture"]

WIDTH, HEIGHT = 1400.0, 900.0
"""Size of the sheet [layout units]; the drawn picture is scaled to the requested size."""
SPACE_WIDTH = 870.0
"""Width of the large picture."""
MARGIN = 0.16
"""Distance from the object up to which the picture must contain the hand [m]; about the length of a hand."""
MOST_LISTED = 6
"""Largest number of fingers in the list of contacts; the palm counts as one."""
COLUMN = (905.0, 1365.0)
"""Left and right edge of the text beside the large picture."""
DIMENSIONS = ("Tx", "Ty", "Tz", "Rx", "Ry", "Rz"), ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
SHOWN = ("object", "axes", "rays", "contacts", "forces", "scene")
"""Groups of the scene's solids that the picture shows."""
FIGURES = ("quality", "task margin", "hold margin", "press")
"""Facts of a grip that are shown in large figures."""


def plan_picture(
    scene: PlanScene, target: Target, *, title: str | None = None, size: tuple[int, int] = (1400, 900)
) -> None:
    """Draw a plan and write it as PNG; after a failure, no incomplete file is left.

    Args:
        scene: The plan.
        target: A path that ends in ``.png``, or a binary file open for writing.
        title: The heading; by default the object's name.
        size: Width and height [pixels], at least 700 × 450.

    Raises:
        InputError: The size is too small, or the name does not end in ``.png``.
        EnvironmentFailure: The file cannot be written.
    """
    check_target(target)
    write_png(plan_image(scene, title=title, size=size), target)


def plan_image(scene: PlanScene, *, title: str | None = None, size: tuple[int, int] = (1400, 900)) -> Image:
    """The picture of :func:`plan_picture` as an image (h, w, 3).

    Raises:
        InputError: The size is under 700 × 450.
    """
    if size[0] < 700 or size[1] < 450:
        raise InputError(f"the picture of a plan must be 700×450 pixels or more, got {size[0]}×{size[1]}")
    with new_sheet(WIDTH, HEIGHT, min(size[0] / WIDTH, size[1] / HEIGHT)) as sheet:
        _space(sheet, scene)
        _heading(sheet, scene, title or scene.mesh.name)
        (_comparison if scene.newtons is None else _decided)(sheet, scene)
        _planes(sheet, scene)
        drawn = sheet.image()
    image = np.full((size[1], size[0], 3), 255, dtype=np.uint8)
    height, width = (min(a, b) for a, b in zip(drawn.shape[:2], image.shape[:2], strict=True))
    top, left = (size[1] - height) // 2, (size[0] - width) // 2
    image[top : top + height, left : left + width] = drawn[:height, :width]
    return image


def _space(sheet: Sheet, scene: PlanScene) -> None:
    """Draw the large picture: the grasp in 3D, with labels."""
    size = sheet.pixels(SPACE_WIDTH, HEIGHT)
    grasp, scenery = _shapes(scene)
    shapes = [*grasp, *scenery]
    points = _in_view(scene, np.concatenate([shape.vertices for shape in grasp]))
    aspect = SPACE_WIDTH / HEIGHT
    camera = Camera.framing(points, view_direction(scene), aspect=aspect, margin=1.12, up=scene.up)
    floor = scene.table
    if floor is None:
        floor = min(float((s.vertices @ scene.up).min()) for s in grasp if s.lit)
    axes = sheet.picture(0, 0, SPACE_WIDTH, HEIGHT, render(shapes, camera, size, ground=floor))

    def at(point: Array) -> Array:
        return np.asarray(project(camera, point[None], size)[0] / sheet.scale)

    pins = _pins(scene)
    avoided = [("box to avoid", box.mean(axis=0)) for box in scene.boxes]
    avoided += [(body.name, body.vertices.mean(axis=0)) for body in scene.obstacles]
    for name, middle in avoided:
        if (abs(at(middle) / (SPACE_WIDTH, HEIGHT) - 0.5) < 0.5).all():  # it may lie outside the picture
            pins.append((name, middle, AVOID))
    seen = visible(shapes, camera, np.array([point for _, point, _ in pins]).reshape(-1, 3))
    labels = [
        Label(text=text, anchor=at(point), colour=colour, hidden=not clear)
        for (text, point, colour), clear in zip(pins, seen, strict=True)
    ]
    for (_, point, colour), clear in zip(pins[:3] if scene.plane else [], seen, strict=False):
        if not clear:  # the end of the axis is hidden, so draw the axis as a dashed line over the picture
            line = np.array([at(scene.cog), at(point)]).T
            axes.plot(*line, color=colour, lw=1.6, ls=(0, (3, 2)), alpha=0.8, zorder=3)
    if scene.aim is not None:
        axes.plot(*at(scene.aim), "+", ms=11, mew=1.6, color=INK, zorder=5)
    along = np.linspace(0.1, 0.9, 9)[:, None]
    dots = [
        at(start * (1 - fraction) + end * fraction)
        for start, end in arrow_segments(scene)
        for fraction in along
    ]
    clear = np.array([[*(dot - 7), *(dot + 7)] for dot in dots]).reshape(-1, 4)
    draw_labels(axes, labels, (SPACE_WIDTH, HEIGHT), points=11, keep_clear=clear)


def _shapes(scene: PlanScene) -> tuple[list[Shape], list[Shape]]:
    """The solids of the grasp, which the picture must contain, and the solids of table and obstacles."""
    canvas = recorded(scene)
    solids = [(group_of(name), shape) for name, shape in canvas.solids.items()]
    grasp = [shape for group, shape in solids if group in SHOWN and group != "scene"]
    if scene.hand:
        grasp.append(hand_shape(scene.hand, alpha=0.55))
    return grasp, [shape for group, shape in solids if group == "scene"]


def _in_view(scene: PlanScene, points: Array) -> Array:
    """The points (k, 3) that the picture must contain: those near the object, without most of a forearm."""
    low, high = scene.mesh.bounds
    middle, half = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    return points[np.linalg.norm(points - middle, axis=1) < half + MARGIN]


def _pins(scene: PlanScene) -> list[tuple[str, Array, Colour]]:
    """Labels as text, point (3,) [m] and colour. With a plane, its three axes come first."""
    pins: list[tuple[str, Array, Colour]] = []
    if scene.plane is not None:
        axes = {"a  approach axis": APPROACH, "o  opposition": OPPOSITION, "t  transverse": TRANSVERSE}
        tips = axis_tips(scene).values()
        pins += [(name, tip, colour) for (name, colour), tip in zip(axes.items(), tips, strict=True)]
        text = f"way in, plane {scene.plane.index}"
        if scene.approach_value is not None and scene.newtons is None:
            name = f" ({scene.approach_set})" if scene.approach_set else ""
            text += f"\napproach value {_number(scene.approach_value, '+.2f')}{name}"
        start, tip = approach_arrow(scene)
        pins.append((text, 0.75 * start + 0.25 * tip, APPROACH))
    for i, name in enumerate(scene.fingers):
        assert scene.points is not None
        pins.append((wrap(name, 150, 11, lines=1)[0], scene.points[i], finger_colour(name, i)))
    if scene.aim is not None:
        pins.append(("aim", scene.aim, INK))
    return pins


def _heading(sheet: Sheet, scene: PlanScene, title: str) -> None:
    """Write title, task and hand, the numbers that decided the plan, its status and its reasons."""
    left, right = COLUMN
    width, y = right - left, 44.0
    for line in wrap(title, width, 20, lines=2, bold=True):
        sheet.text(left, y, line, 20, weight="bold")
        y += 33
    subtitle = f"Task {scene.task_name}  ·  hand {scene.hand_name}"
    for line in wrap(subtitle, width, 11.5, lines=2):
        sheet.text(left, y, line, 11.5, QUIET)
        y += 20
    y += 12
    for x, (name, number) in zip(left + np.arange(4) * width / 4, scene.figures, strict=False):
        sheet.text(x, y + 12, number, 19, weight="bold")
        sheet.text(x, y + 38, name, 9.5, QUIET)
    y += 66
    _rule(sheet, y)
    y += 20
    for line in wrap(scene.status, width, 11.5, lines=2, bold=True):
        sheet.text(left, y, line, 11.5, weight="bold")
        y += 20
    y += 4
    most = max(3, int((392 - y) / 17))
    lines = [line for reason in scene.reasons for line in wrap(reason, width, 10, lines=most)]
    if len(lines) > most:
        lines = [*lines[: most - 1], "…"]
    for line in lines:
        sheet.text(left, y, line, 10)
        y += 17


def _decided(sheet: Sheet, scene: PlanScene) -> None:
    """Write the facts that decided a grip and the assumptions behind it, as rows of text."""
    (left, right), y = COLUMN, 410.0
    _rule(sheet, y - 8)
    sheet.text(left, y + 12, "What decided it", 11.5, weight="bold")
    y += 36
    # The large figures show quality, margins and press already.
    for name, text in [row for row in scene.facts if row[0] not in FIGURES]:
        lines = wrap(text, right - left - 90, 9.5, lines=3)
        if y + 16 * len(lines) > 664:
            break
        sheet.text(left, y, name, 9.5, QUIET)
        for line in lines:
            sheet.text(left + 90, y, line, 9.5)
            y += 16
        y += 5


def _comparison(sheet: Sheet, scene: PlanScene) -> None:
    """Draw bars of task and net wrench in each dimension, with their agreement beneath."""
    (left, right), top = COLUMN, 410.0
    _rule(sheet, top - 8)
    sheet.text(left, top + 12, "Task and net wrench", 11.5, weight="bold")
    series: list[tuple[str, Array, Colour]] = [("task", scene.task, TASK)]
    if scene.net_wrench is not None:
        series.append(("net wrench", scene.net_wrench, WRENCH))
    x = right
    for name, _, colour in reversed(series):
        x -= text_width(name, 10)
        sheet.text(x, top + 12, name, 10, QUIET)
        sheet.base.add_patch(_rectangle(x - 16, top + 7, 10, 10, colour))
        x -= 34
    height, begin = 150.0, top + 34
    axes = sheet.axes(left, begin, right - left, height)
    values = np.concatenate([numbers for _, numbers, _ in series])
    span = max(1.0, float(np.abs(values).max()))
    low = min(0.0, float(values.min())) - 0.17 * span
    high = max(0.0, float(values.max())) + 0.17 * span
    axes.set(xlim=(-0.75, 5.5), ylim=(low, high))
    axes.axhline(0, xmin=0.06, color=INK, lw=0.9, zorder=3)
    step = 10.0 ** np.floor(np.log10(span)) * (1 if span / 10 ** np.floor(np.log10(span)) < 3 else 2)
    for tick in np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step:
        axes.axhline(tick, xmin=0.06, color=FAINT, lw=0.6, zorder=0)
        axes.text(-0.45, tick, _number(tick, ".4g"), fontsize=9, color=QUIET, ha="right", va="center")
    wide = 0.76 / len(series)
    for k, (_, numbers, colour) in enumerate(series):
        at = np.arange(6) + (k - (len(series) - 1) / 2) * wide
        axes.bar(at, numbers, wide * 0.92, color=colour, zorder=2)
        for place, number in zip(at, numbers, strict=True):
            up, text = number >= 0, _number(number, ".2f" if abs(number) < 100 else ".2g")
            offset = (0.02 if up else -0.02) * (high - low)
            axes.text(
                place, number + offset, text, fontsize=8, color=INK,
                ha="center", va="bottom" if up else "top", parse_math=False,
            )  # fmt: skip
    _agreement(sheet, scene, begin + height)


def _agreement(sheet: Sheet, scene: PlanScene, top: float) -> None:
    """Write the agreement of task and net wrench in each dimension."""
    left, right = COLUMN
    unit = (right - left) / 6.25
    for i, (t, f) in enumerate(zip(*DIMENSIONS, strict=True)):
        middle = left + (0.75 + i) * unit
        sheet.text(middle, top + 14, f"{t} / {f}", 9.5, ha="center")
        if scene.adi is None:
            continue
        agreement = float(np.clip(scene.adi[i], 0, 1))
        width = 0.72 * unit
        sheet.base.add_patch(_rectangle(middle - width / 2, top + 30, width, 6, FAINT))
        sheet.base.add_patch(_rectangle(middle - width / 2, top + 30, width * agreement, 6, TRANSVERSE))
        sheet.text(middle, top + 50, f"{scene.adi[i]:.2f}", 9.5, ha="center", weight="bold")
    if scene.adi is not None:
        sheet.text(left, top + 50, "ADI", 9.5, QUIET)


def _rectangle(left: float, top: float, width: float, height: float, colour: Colour) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((left, top), width, height, facecolor=colour, edgecolor="none")


def _planes(sheet: Sheet, scene: PlanScene) -> None:
    """Draw the overview of all planes, with a key beside it."""
    left, right = COLUMN
    top, side = 672.0, 215.0
    _rule(sheet, top - 8)
    x = left
    if scene.planes:
        size = sheet.pixels(side, side)
        shapes, camera, places = plane_cards(scene, size)
        image = render(shapes, camera, size, background=(PAPER, PAPER))
        axes = sheet.picture(left, top, side, side, image)
        for index, place in places.items():
            chosen = scene.plane is not None and index == scene.plane.index
            at = place / size * side
            axes.text(
                *at, str(index), ha="center", va="center", parse_math=False,
                fontsize=11 if chosen else 8, color=APPROACH if chosen else QUIET,
                weight="bold" if chosen else "normal",
            )  # fmt: skip
        x += side + 24
    y = top + 16
    if scene.plane is not None:
        sheet.text(x, y, f"Approach plane {scene.plane.index}", 11.5, weight="bold")
        y += 24
        plane = scene.plane
        rows: Sequence[tuple[str, Array, Colour]] = (
            ("approach a", plane.approach_axis, APPROACH),
            ("opposition o", plane.opposition_axis, OPPOSITION),
            ("transverse t", plane.transverse_axis, TRANSVERSE),
        )
        for name, axis, colour in rows:
            sheet.base.add_patch(_rectangle(x, y - 2, 16, 4, colour))
            sheet.text(x + 24, y, name, 9.5)
            sheet.text(right, y, _axis_text(axis), 9.5, QUIET, ha="right")
            y += 20
        y += 6
    if scene.fingers:
        sheet.text(x, y, "Contacts", 11.5, weight="bold")
        y += 23
        listed = list(dict.fromkeys(scene.fingers))[:MOST_LISTED]
        step = min(20.0, (HEIGHT - 12.0 - y) / max(len(listed) - 1, 1))
        for name in listed:
            own = [k for k, other in enumerate(scene.fingers) if other == name]
            i, label = own[0], name if len(own) == 1 else f"{name}, {len(own)} places"
            sheet.base.plot(x + 8, y, "o", ms=6, color=finger_colour(name, i), mec=BLACK, mew=0.4)
            sheet.text(x + 24, y, wrap(label, 120, 9.5, lines=1)[0], 9.5)
            if scene.newtons is not None:
                sheet.text(right, y, f"{sum(scene.newtons[k] for k in own):.1f} N", 9.5, QUIET, ha="right")
            elif scene.forces is not None:
                strength = float(np.linalg.norm(scene.forces[i]))
                sheet.text(right, y, f"force {strength:.2f}", 9.5, QUIET, ha="right")
            y += step


def _rule(sheet: Sheet, y: float) -> None:
    """Draw a horizontal line across the column."""
    sheet.base.plot(COLUMN, (y, y), color=FAINT, lw=0.8, solid_capstyle="butt")


def _number(number: float, form: str) -> str:
    return f"{number + 0.0:{form}}".replace("-", "−")


def _axis_text(axis: Array) -> str:
    i = int(np.argmax(np.abs(axis)))
    if abs(axis[i]) > 1 - 1e-9:
        return ("+" if axis[i] > 0 else "−") + "XYZ"[i]
    return "  ".join(f"{c:+.2f}" for c in axis)
