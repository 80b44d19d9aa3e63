"""A run in simulated physics on one page: key frames, and contact forces and slip over time."""

from __future__ import annotations

import numpy as np

from ..types import Array
from .colours import FAINT, GREEN, INK, PAPER, QUIET, SKY_BOTTOM, VERMILION, Colour
from .film import Film, FilmStage
from .labels import text_width, wrap
from .picture_file import Target, check_target, write_png
from .raycast import Image
from .sheet import Sheet, new_sheet

MAX_KEY_FRAMES = 8
"""Largest number of key frames on a sheet."""
COLUMNS = 4
WIDTH, MARGIN, GAP = 1400.0, 30.0, 14.0
HEAD, CAPTION, CHART, BETWEEN = 104.0, 50.0, 150.0, 44.0
TICKS = 46.0
"""Width of the numbers left of the charts. All sizes up to here are in layout units."""


def filmstrip(film: Film, target: Target, *, width: int = 1400) -> None:
    """Draw a run and write it as PNG; after a failure, no incomplete file is left.

    Args:
        film: The run.
        target: A path that ends in ``.png``, or a binary file open for writing.
        width: Width of the page [pixels]; the height follows from it.

    Raises:
        InputError: The name does not end in ``.png``.
        EnvironmentFailure: The file cannot be written.
    """
    check_target(target)
    write_png(filmstrip_image(film, width=width), target)


def key_frames(film: Film) -> list[int]:
    """At most ``MAX_KEY_FRAMES`` frames that summarise the run, one for each stage.

    If there are too many probes, those in which the hand lost the object are kept first, then those that
    moved the object most.
    """
    before = [stage for stage in film.stages if stage.passed is None]
    probes = [stage for stage in film.stages if stage.passed is not None]
    free = MAX_KEY_FRAMES - min(len(before), 3)
    if len(probes) > free and len(before) > 2:  # leave out the stage "grasp", which looks like the squeeze
        before, free = [before[0], before[-1]], free + 1
    if len(probes) > free:
        squeezed = film.load_point[before[-1].stop - 1] if before else film.load_point[0]
        moved = {s.name: float(np.linalg.norm(film.load_point[s.stop - 1] - squeezed)) for s in probes}
        worst = sorted(probes, key=lambda s: (s.passed, -moved[s.name]))[:free]
        probes = [stage for stage in probes if stage in worst]
    return [_key_frame(film, stage) for stage in [*before, *probes]]


def _key_frame(film: Film, stage: FilmStage) -> int:
    """The last frame of a stage; if the object was lost, the last frame with the object near the hand."""
    if stage.passed is not False or stage.start == 0:
        return stage.stop - 1
    start = film.load_point[_start_frame(film, stage)]
    moved = np.linalg.norm(film.load_point[stage.start : stage.stop] - start, axis=1)
    near = np.flatnonzero(moved < 0.9 * film.size)
    return stage.start + (int(near[-1]) if len(near) else 0)


def filmstrip_image(film: Film, *, width: int = 1400) -> Image:
    """The page of :func:`filmstrip` as an image (h, w, 3)."""
    frames = key_frames(film)
    columns = min(COLUMNS, len(frames))
    rows = -(-len(frames) // columns)
    cell = (WIDTH - 2 * MARGIN - (COLUMNS - 1) * GAP) / COLUMNS
    has_charts = len(film) > 1
    below = HEAD + rows * (cell + CAPTION + GAP)
    height = below + (2 * CHART + 2 * BETWEEN + 92 if has_charts else 10)
    with new_sheet(WIDTH, height, width / WIDTH) as sheet:
        _heading(sheet, film)
        camera = film.camera(np.array(frames), 1.0)
        for place, frame in enumerate(frames):
            x = MARGIN + place % columns * (cell + GAP)
            y = HEAD + place // columns * (cell + CAPTION + GAP)
            sheet.picture(x, y, cell, cell, film.picture(frame, camera, sheet.pixels(cell, cell)))
            _caption(sheet, film, frame, place + 1, (x, y + cell), cell)
        if has_charts:
            top = below + 40
            title = ("Normal force of each finger", "N")
            _chart(sheet, film, title, film.normal_force, frames, top, last=False)
            top += CHART + BETWEEN + 12
            _chart(sheet, film, ("Slip on the object", "mm"), 1e3 * film.slip, frames, top, last=True)
        return sheet.image()


def _badge(sheet: Sheet, x: float, y: float, text: str, colour: Colour = INK) -> None:
    """A number in a filled circle."""
    sheet.base.plot(x, y, "o", ms=17, color=colour, mec="none", zorder=5, clip_on=False)
    sheet.text(x, y + 0.5, text, 9.5, PAPER, ha="center", va="center", weight="bold", zorder=6)


def _result_colour(passed: bool | None) -> Colour:
    return INK if passed is None else GREEN if passed else VERMILION


def _heading(sheet: Sheet, film: Film) -> None:
    """Title and result on one line, the subtitle beneath."""
    width = WIDTH - 2 * MARGIN
    free = width - text_width(film.verdict, 12.5, bold=True) - 30
    for line in wrap(film.title, max(free, 0.3 * width), 20, lines=1, bold=True):
        sheet.text(MARGIN, 34, line, 20, weight="bold")
    for line in wrap(film.subtitle, width, 11.5, lines=1):
        sheet.text(MARGIN, 68, line, 11.5, QUIET)
    for line in wrap(film.verdict, 0.68 * width, 12.5, lines=1, bold=True):
        sheet.text(WIDTH - MARGIN, 34, line, 12.5, _result_colour(film.passed), ha="right", weight="bold")


def _caption(
    sheet: Sheet, film: Film, frame: int, number: int, corner: tuple[float, float], cell: float
) -> None:
    """Number, stage, time and result beneath a key frame."""
    (x, y), stage = corner, film.stage_at(frame)
    _badge(sheet, x + 14, y + 19, str(number), _result_colour(stage.passed))
    sheet.text(x + 32, y + 17, stage.name, 11.5, weight="bold")
    time = f"{film.times[frame]:.1f} s"
    sheet.text(x + cell, y + 17, time, 9.5, QUIET, ha="right")
    if stage.note:
        sheet.text(x + 32, y + 38, wrap(stage.note, cell - 34, 10, lines=1)[0], 10, QUIET)


def _chart(
    sheet: Sheet,
    film: Film,
    heading: tuple[str, str],
    series: Array,
    frames: list[int],
    top: float,
    *,
    last: bool,
) -> None:
    """A chart over time: one line for each part, over bands that show the stages.

    Args:
        sheet: The sheet.
        film: The run.
        heading: Title and unit.
        series: (n, k) Values of each part.
        frames: The key frames; their numbers are written beneath their stages.
        top: Top of the chart [layout units].
        last: Whether this is the lowest chart, which has the time axis; the upper one has the legend.
    """
    left, width = MARGIN + TICKS, WIDTH - 2 * MARGIN - TICKS
    title, unit = heading
    sheet.text(MARGIN, top - 20, title, 11.5, weight="bold")
    sheet.text(MARGIN + text_width(title, 11.5, bold=True) + 12, top - 20, f"[{unit}]", 10, QUIET)
    axes = sheet.axes(left, top, width, CHART)
    peak = float(series.max(initial=0.0))
    typical = 3 * float(np.percentile(series.max(axis=1, initial=0.0), 90))
    highest = max(min(peak, typical) if typical > 0 else peak, 0.1) * 1.12
    if peak > highest:  # a single peak would flatten everything else
        note = f"a peak of {peak:.3g} {unit} lies outside the chart"
        sheet.text(left + width / 2, top - 20, note, 9, QUIET, ha="center")
    end = float(film.times[-1]) or 1.0
    numbers = {film.stage_at(frame).name: number for number, frame in enumerate(frames, start=1)}
    axes.set(xlim=(0, end), ylim=(0, highest))
    for place, stage in enumerate(film.stages):
        a, b = _edges(film, stage)
        axes.axvspan(a, b, color=SKY_BOTTOM if place % 2 else "#EEF1F5", lw=0, zorder=0)
        if stage.passed is False:
            axes.axvspan(a, b, color=VERMILION, alpha=0.10, lw=0, zorder=0)
        if last:
            _band_name(
                sheet, stage, numbers.get(stage.name), left + a / end * width, left + b / end * width, top
            )
    for tick in _ticks(highest):
        axes.axhline(tick, color=FAINT, lw=0.6, zorder=1)
        axes.text(-0.006 * end, tick, f"{tick:g}", fontsize=9, color=QUIET, ha="right", va="center")
    touching = [k for k in range(len(film.parts)) if film.normal_force[:, k].any()]
    for k in touching:
        for stage in film.stages:  # every probe starts from the squeeze, so no line joins two probes
            times = np.append(_edges(film, stage)[0], film.times[stage.start : stage.stop])
            # Slip counts from the start of a probe.
            start = 0.0 if last and stage.passed is not None else series[_start_frame(film, stage), k]
            y = np.append(start, series[stage.start : stage.stop, k])
            # A dark outline keeps light colours readable on white.
            axes.plot(times, y, color=INK, lw=2.6, alpha=0.35, zorder=2)
            axes.plot(times, y, color=film.colours()[k], lw=1.9, zorder=3)
    x = WIDTH - MARGIN
    for k in reversed([] if last else touching):
        x -= text_width(film.parts[k], 10)
        sheet.text(x, top - 20, film.parts[k], 10)
        sheet.base.plot((x - 24, x - 7), (top - 20, top - 20), color=film.colours()[k], lw=3.2)
        x -= 42
    if last:
        note = "time [s]"
        if any(stage.passed is not None for stage in film.stages):
            note += "; every probe starts from the squeeze, and slip counts from there"
        sheet.text(left + width, top + CHART + 62, note, 9, QUIET, ha="right")
        for tick in _ticks(end, 8):
            sheet.text(left + tick / end * width, top + CHART + 42, f"{tick:g}", 9, QUIET, ha="center")


def _band_name(
    sheet: Sheet, stage: FilmStage, number: int | None, start: float, end: float, top: float
) -> None:
    """The number of a stage beneath its band, and its name if it fits."""
    y, width = top + CHART + 17, text_width(stage.name, 9)
    named = end - start > width + 44
    x = (start + end) / 2 - (width / 2 + 2 if named else 0)
    if number is not None:
        _badge(sheet, x, y, str(number), _result_colour(stage.passed))
    if named:
        sheet.text(x + (14 if number is not None else 0), y, stage.name, 9, QUIET)


def _start_frame(film: Film, stage: FilmStage) -> int:
    """The frame from which a stage started; for every probe the last frame of the squeeze."""
    if stage.passed is None:
        return max(0, stage.start - 1)
    return next((s.stop - 1 for s in reversed(film.stages) if s.passed is None), stage.start)


def _edges(film: Film, stage: FilmStage) -> tuple[float, float]:
    """Start and end of a stage [s]."""
    start = film.times[stage.start - 1] if stage.start else 0.0
    return float(start), float(film.times[stage.stop - 1])


def _ticks(highest: float, most: int = 4) -> list[float]:
    """Round numbers from 0 to ``highest``, with at most ``most`` steps."""
    step = 10.0 ** np.floor(np.log10(highest / most))
    step *= next(f for f in (1, 2, 5, 10) if highest / (f * step) <= most)
    return [float(round(k * step, 10)) for k in range(int(highest / step) + 1)]
