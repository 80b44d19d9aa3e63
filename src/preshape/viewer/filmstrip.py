"""A run on one page: key frames from the pregrasp to the last push, and forces and slip over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..types import Array
from .colours import FAINT, GREEN, INK, PAPER, QUIET, SKY_BOTTOM, VERMILION, Colour
from .film import Film, Stage
from .labels import FONT, text_width, wrap
from .picture_file import Target, check_target, write_png
from .raycast import Image

MOST = 8
"""Key frames on a page."""
COLUMNS = 4
WIDTH, MARGIN, GAP = 1400.0, 30.0, 14.0
HEAD, CAPTION, CHART, BETWEEN = 104.0, 50.0, 150.0, 44.0
TICKS = 46.0  # room for numbers left of the charts


def filmstrip(film: Film, target: Target, *, width: int = 1400) -> None:
    """Draw a run and write it as PNG, whole or not at all.

    Args:
        film: the run.
        target: a path that ends in ``.png``, or a binary file open for writing.
        width: of the page [pixels]; the height follows.

    Raises:
        InputError: a name that does not end in ``.png``.
        EnvironmentFailure: the file cannot be written.
    """
    check_target(target)
    write_png(filmstrip_image(film, width=width), target)


def key_frames(film: Film) -> list[int]:
    """At most ``MOST`` frames: the beginning, the last of each stage; of many probes those that moved most.

    The first stages come first; a probe counts by how far the object ended from where it was squeezed.
    """
    first = [stage for stage in film.stages if stage.good is None]
    rest = [stage for stage in film.stages if stage.good is not None]
    room = MOST - min(len(first), 3)
    if len(rest) > room and len(first) > 2:  # without the grasp: it looks like the squeeze
        first, room = [first[0], first[-1]], room + 1
    if len(rest) > room:
        squeezed = film.centre[first[-1].stop - 1] if first else film.centre[0]
        away = {s.name: float(np.linalg.norm(film.centre[s.stop - 1] - squeezed)) for s in rest}
        kept = sorted(rest, key=lambda s: (s.good, -away[s.name]))[:room]
        rest = [stage for stage in rest if stage in kept]
    return [_telling(film, stage) for stage in [*first, *rest]]


def _telling(film: Film, stage: Stage) -> int:
    """The last frame of a stage; of one that lost the object, the last that still has it in sight."""
    if stage.good is not False or stage.start == 0:
        return stage.stop - 1
    away = np.linalg.norm(film.centre[stage.start : stage.stop] - film.centre[_previous(film, stage)], axis=1)
    near = np.flatnonzero(away < 0.9 * film.size)
    return stage.start + (int(near[-1]) if len(near) else 0)


def filmstrip_image(film: Film, *, width: int = 1400) -> Image:
    """The page of :func:`filmstrip` as an image (h, w, 3)."""
    import matplotlib.style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    frames = key_frames(film)
    columns = min(COLUMNS, len(frames))
    rows = -(-len(frames) // columns)
    cell = (WIDTH - 2 * MARGIN - (COLUMNS - 1) * GAP) / COLUMNS
    charts = len(film) > 1
    below = HEAD + rows * (cell + CAPTION + GAP)
    height = below + (2 * CHART + 2 * BETWEEN + 92 if charts else 10)
    scale = width / WIDTH
    with matplotlib.style.context("default"), matplotlib.rc_context({"font.family": FONT}):
        figure = Figure(figsize=(WIDTH / 100, height / 100), dpi=100 * scale, facecolor=PAPER)
        canvas = FigureCanvasAgg(figure)
        page = _Page(figure, height)
        _heading(page, film)
        camera = film.camera(np.array(frames), 1.0)
        for place, frame in enumerate(frames):
            x = MARGIN + place % columns * (cell + GAP)
            y = HEAD + place // columns * (cell + CAPTION + GAP)
            pixels = (round(cell * scale), round(cell * scale))
            axes = page.axes(x, y, cell, cell)
            axes.imshow(
                film.picture(frame, camera, pixels),
                extent=(0, cell, cell, 0), interpolation="nearest", aspect="auto",
            )  # fmt: skip
            _caption(page, film, frame, place + 1, (x, y + cell), cell)
        if charts:
            normal = [
                ("Normal force of each finger", "N", film.normal),
                ("Slip on the object", "mm", 1e3 * film.slip),
            ]
            for k, (title, unit, series) in enumerate(normal):
                _chart(
                    page,
                    film,
                    (title, unit),
                    series,
                    frames,
                    below + 40 + k * (CHART + BETWEEN + 12),
                    last=k == 1,
                )
        canvas.draw()
        return np.array(np.asarray(canvas.buffer_rgba())[:, :, :3])


class _Page:
    """A figure whose places are given in layout units from the left and from the top."""

    def __init__(self, figure: Any, height: float) -> None:
        self.figure, self.height = figure, height
        self.sheet = self.axes(0, 0, WIDTH, height)

    def axes(self, left: float, top: float, width: float, height: float) -> Any:
        low = 1 - (top + height) / self.height
        axes = self.figure.add_axes((left / WIDTH, low, width / WIDTH, height / self.height))
        axes.set_axis_off()
        axes.set(xlim=(0, width), ylim=(height, 0))
        return axes

    def text(self, x: float, y: float, text: str, points: float, colour: Colour = INK, **style: Any) -> None:
        style = {"ha": "left", "va": "center_baseline"} | style
        self.sheet.text(x, y, text, fontsize=points, color=colour, parse_math=False, **style)

    def badge(self, x: float, y: float, text: str, colour: Colour = INK) -> None:
        self.sheet.plot(x, y, "o", ms=17, color=colour, mec="none", zorder=5, clip_on=False)
        self.text(x, y + 0.5, text, 9.5, PAPER, ha="center", va="center", weight="bold", zorder=6)


def _tone(good: bool | None) -> Colour:
    return INK if good is None else GREEN if good else VERMILION


def _heading(page: _Page, film: Film) -> None:
    width = WIDTH - 2 * MARGIN
    room = width - text_width(film.verdict, 12.5, bold=True) - 30
    for line in wrap(film.title, max(room, 0.3 * width), 20, lines=1, bold=True):
        page.text(MARGIN, 34, line, 20, weight="bold")
    for line in wrap(film.subtitle, width, 11.5, lines=1):
        page.text(MARGIN, 68, line, 11.5, QUIET)
    for line in wrap(film.verdict, 0.68 * width, 12.5, lines=1, bold=True):
        page.text(WIDTH - MARGIN, 34, line, 12.5, _tone(film.good), ha="right", weight="bold")


def _caption(
    page: _Page, film: Film, frame: int, number: int, corner: tuple[float, float], cell: float
) -> None:
    (x, y), stage = corner, film.stage_at(frame)
    page.badge(x + 14, y + 19, str(number), _tone(stage.good))
    page.text(x + 32, y + 17, stage.name, 11.5, weight="bold")
    time = f"{film.times[frame]:.1f} s"
    page.text(x + cell, y + 17, time, 9.5, QUIET, ha="right")
    if stage.note:
        page.text(x + 32, y + 38, wrap(stage.note, cell - 34, 10, lines=1)[0], 10, QUIET)


def _chart(
    page: _Page,
    film: Film,
    heading: tuple[str, str],
    series: Array,
    frames: list[int],
    top: float,
    *,
    last: bool,
) -> None:
    """Lines over time, one a part, over bands that show the stages."""
    left, width = MARGIN + TICKS, WIDTH - 2 * MARGIN - TICKS
    title, unit = heading
    page.text(MARGIN, top - 20, title, 11.5, weight="bold")
    page.text(MARGIN + text_width(title, 11.5, bold=True) + 12, top - 20, f"[{unit}]", 10, QUIET)
    axes = page.axes(left, top, width, CHART)
    peak = float(series.max(initial=0.0))
    usual = 3 * float(np.percentile(series.max(axis=1, initial=0.0), 90))
    highest = max(min(peak, usual) if usual > 0 else peak, 0.1) * 1.12
    if peak > highest:  # one blow would flatten everything else
        words = f"a blow of {peak:.3g} {unit} is off the chart"
        page.text(left + width / 2, top - 20, words, 9, QUIET, ha="center")
    end = float(film.times[-1]) or 1.0
    numbers = {film.stage_at(frame).name: number for number, frame in enumerate(frames, start=1)}
    axes.set(xlim=(0, end), ylim=(0, highest))
    for place, stage in enumerate(film.stages):
        a, b = _edges(film, stage)
        axes.axvspan(a, b, color=SKY_BOTTOM if place % 2 else "#EEF1F5", lw=0, zorder=0)
        if stage.good is False:
            axes.axvspan(a, b, color=VERMILION, alpha=0.10, lw=0, zorder=0)
        if last:
            _band_name(
                page, stage, numbers.get(stage.name), left + a / end * width, left + b / end * width, top
            )
    for tick in _ticks(highest):
        axes.axhline(tick, color=FAINT, lw=0.6, zorder=1)
        axes.text(-0.006 * end, tick, f"{tick:g}", fontsize=9, color=QUIET, ha="right", va="center")
    order = [k for k in range(len(film.parts)) if film.normal[:, k].any()]
    for k in order:
        for stage in film.stages:  # every probe starts again: no line from one to the next
            times = np.append(_edges(film, stage)[0], film.times[stage.start : stage.stop])
            before = 0.0 if last and stage.good is not None else series[_previous(film, stage), k]
            y = np.append(before, series[stage.start : stage.stop, k])
            # A dark rim keeps light colours readable on paper.
            axes.plot(times, y, color=INK, lw=2.6, alpha=0.35, zorder=2)
            axes.plot(times, y, color=film.colours()[k], lw=1.9, zorder=3)
    x = WIDTH - MARGIN
    for k in reversed(order if not last else []):
        x -= text_width(film.parts[k], 10)
        page.text(x, top - 20, film.parts[k], 10)
        page.sheet.plot((x - 24, x - 7), (top - 20, top - 20), color=film.colours()[k], lw=3.2)
        x -= 42
    if last:
        time = "time [s]; every push starts from the squeezed grasp, slip counts from there"
        page.text(left + width, top + CHART + 62, time, 9, QUIET, ha="right")
        for tick in _ticks(end, 8):
            page.text(left + tick / end * width, top + CHART + 42, f"{tick:g}", 9, QUIET, ha="center")


def _band_name(page: _Page, stage: Stage, number: int | None, start: float, end: float, top: float) -> None:
    """A stage's number and, where there is room, its name beneath its band."""
    y, wide = top + CHART + 17, text_width(stage.name, 9)
    named = end - start > wide + 44
    x = (start + end) / 2 - (wide / 2 + 2 if named else 0)
    if number is not None:
        page.badge(x, y, str(number), _tone(stage.good))
    if named:
        page.text(x + (14 if number is not None else 0), y, stage.name, 9, QUIET)


def _previous(film: Film, stage: Stage) -> int:
    """The frame from which a stage began: for every probe the last of the squeeze."""
    if stage.good is None:
        return max(0, stage.start - 1)
    return next((s.stop - 1 for s in reversed(film.stages) if s.good is None), stage.start)


def _edges(film: Film, stage: Stage) -> tuple[float, float]:
    start = film.times[stage.start - 1] if stage.start else 0.0
    return float(start), float(film.times[stage.stop - 1])


def _ticks(highest: float, most: int = 4) -> list[float]:
    """Round numbers from 0 up to ``highest``, at most so many steps."""
    step = 10.0 ** np.floor(np.log10(highest / most))
    step *= next(f for f in (1, 2, 5, 10) if highest / (f * step) <= most)
    return [float(round(k * step, 10)) for k in range(int(highest / step) + 1)]
