"""A run as a GIF: rendered by the CPU, with the stage and the forces of the moment written into it."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np

from ..exceptions import InputError
from ..types import IntArray
from .colours import FAINT, FINGERS, GREEN, INK, PAPER, QUIET, VERMILION, Colour
from .film import LOAD, Film
from .labels import FONT
from .raycast import Image

RATE = 12.5
"""Frames a second; GIF counts in hundredths of a second."""
MOST = 96
"""Frames at most."""
LINGER = 1.2
"""How long the last frame stays [s]."""
BAR = 92
"""Height of the strip beneath the picture [pixels]."""
VIVID = 32
"""Difference of a pixel's largest and smallest channel, 0..255, from which it counts as coloured."""

Progress = Callable[[int, int], None]
"""Called with how many frames are drawn, and of how many."""


def animation(film: Film, *, side: int = 340, progress: Progress | None = None) -> bytes:
    """Draw a run as GIF; the content of the file.

    Args:
        film: the run.
        side: width and height of the picture [pixels]; the strip with the forces comes beneath.
        progress: called after every frame.

    Raises:
        InputError: a side under 120 pixels.
    """
    if side < 120:
        raise InputError(f"an animation must be 120 pixels wide or more, got {side}")
    frames = chosen_frames(film)
    images = []
    camera = film.camera(frames[:: max(1, len(frames) // 8)], 1.0)
    for done, frame in enumerate(frames, start=1):
        scene = film.picture(int(frame), camera, (side, side), samples=2)
        images.append(np.concatenate([scene, _strip(film, int(frame), side)]))
        if progress is not None:
            progress(done, len(frames))
    return _gif(images)


def chosen_frames(film: Film) -> IntArray:
    """(k,) frames of a GIF, k ≤ ``MOST``: every other of approach and squeeze, evenly many of every probe."""
    first = [f for stage in film.stages if stage.good is None for f in range(stage.start, stage.stop)]
    probes = [stage for stage in film.stages if stage.good is not None]
    step = max(2, -(-len(first) // (MOST // 2)))
    first = first[::step] if len(first) > step else first
    each = min(10, max(2, (MOST - len(first)) // max(1, len(probes))))
    probes = probes[: (MOST - len(first)) // each]
    chosen = list(first)
    for stage in probes:
        count = min(each, stage.stop - stage.start)
        chosen += np.linspace(stage.start, stage.stop - 1, count).round().astype(int).tolist()
    return np.array(chosen, dtype=np.int64)


def _strip(film: Film, frame: int, width: int) -> Image:
    """The stage and a bar of normal force for each part."""
    from matplotlib.font_manager import FontProperties, findfont
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    sheet = Pillow.new("RGB", (width, BAR), _bytes(PAPER))
    draw = ImageDraw.Draw(sheet)
    bold = ImageFont.truetype(findfont(FontProperties(family=FONT, weight="bold")), 14)
    plain = ImageFont.truetype(findfont(FONT), 11)
    stage = film.stage_at(frame)
    draw.text((12, 18), stage.name, font=bold, fill=_bytes(INK), anchor="lm")
    if stage.good is not None and frame == stage.stop - 1:
        words = "held" if stage.good else "lost"
        draw.text(
            (width - 12, 18), words, font=bold, fill=_bytes(GREEN if stage.good else VERMILION), anchor="rm"
        )
    else:
        draw.text((width - 12, 18), f"{film.times[frame]:.1f} s", font=plain, fill=_bytes(QUIET), anchor="rm")
    order = [k for k in range(len(film.parts)) if film.normal[:, k].any()]
    highest = float(film.normal.max(initial=0.0)) or 1.0
    wide = (width - 24) / max(1, len(order))
    for place, k in enumerate(order):
        x, room, force = 12 + place * wide, wide - 10, float(film.normal[frame, k])
        draw.text((x, 46), film.parts[k], font=plain, fill=_bytes(QUIET), anchor="lm")
        draw.text((x + room, 46), f"{force:.1f} N", font=plain, fill=_bytes(INK), anchor="rm")
        draw.rectangle([x, 60, x + room, 68], fill=_bytes(FAINT))
        if force > 0:
            draw.rectangle([x, 60, x + room * force / highest, 68], fill=_bytes(film.colours()[k]))
    return np.asarray(sheet)


def _gif(images: list[Image]) -> bytes:
    """All frames with one palette, taken from frames all over the run; without dither, which flickers."""
    from PIL import Image as Pillow

    few = np.concatenate([image.reshape(-1, 3) for image in images[:: max(1, len(images) // 6)]])
    # Fingertips and words are few pixels of many colours, the background is many of few: count them alike.
    vivid = few[np.ptp(few.astype(np.int16), axis=1) > VIVID]
    shown = np.array(
        [_bytes(c) for c in (*FINGERS.values(), LOAD, GREEN, VERMILION, INK, QUIET, PAPER, FAINT)]
    )
    repeats = max(1, len(few) // max(1, len(vivid)))
    counted = np.concatenate([few, np.tile(vivid, (repeats, 1)), np.repeat(shown, len(few) // 100, axis=0)])
    sample = Pillow.fromarray(np.asarray(counted[None], dtype=np.uint8))
    palette = sample.quantize(256, method=Pillow.Quantize.MEDIANCUT, kmeans=2)
    frames = [Pillow.fromarray(i).quantize(palette=palette, dither=Pillow.Dither.NONE) for i in images]
    times = [round(1000 / RATE)] * (len(frames) - 1) + [round(1000 * LINGER)]
    buffer = io.BytesIO()
    frames[0].save(
        buffer, format="GIF", save_all=True, append_images=frames[1:], duration=times, loop=0, optimize=True
    )
    return buffer.getvalue()


def _bytes(colour: Colour) -> tuple[int, int, int]:
    red, green, blue = (round(255 * c) for c in colour)
    return red, green, blue
