"""A run in simulated physics as a GIF; beneath the picture are the current stage and the contact forces."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np

from ..exceptions import InputError
from ..types import IntArray
from .colours import FAINT, FINGERS, GREEN, INK, PAPER, QUIET, VERMILION, to_bytes
from .film import LOAD, Film
from .labels import FONT
from .raycast import Image

RATE = 12.5
"""Frames a second; GIF counts time in hundredths of a second."""
MAX_FRAMES = 96
"""Most frames of an animation."""
LINGER = 1.2
"""Time for which the last frame is shown [s]."""
STRIP_HEIGHT = 92
"""Height of the strip beneath the picture [pixels]."""
VIVID = 32
"""Difference between a pixel's largest and smallest channel, 0..255, above which it counts as coloured."""

Progress = Callable[[int, int], None]
"""Called with the number of frames drawn so far and the number of all frames."""


def animation(film: Film, *, side: int = 340, progress: Progress | None = None) -> bytes:
    """Draw a run as a GIF.

    Args:
        film: The run.
        side: Width and height of the picture [pixels]; the strip with the forces is beneath it.
        progress: Called after every frame.

    Returns:
        The content of the file.

    Raises:
        InputError: ``side`` is under 120 pixels.
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
    """(k,) Frames of the GIF, k ≤ ``MAX_FRAMES``: some before the probes, then a few of each probe (load)."""
    before = [f for stage in film.stages if stage.passed is None for f in range(stage.start, stage.stop)]
    probes = [stage for stage in film.stages if stage.passed is not None]
    step = max(2, -(-len(before) // (MAX_FRAMES // 2)))
    before = before[::step] if len(before) > step else before
    each = min(10, max(2, (MAX_FRAMES - len(before)) // max(1, len(probes))))
    probes = probes[: (MAX_FRAMES - len(before)) // each]
    chosen = list(before)
    for stage in probes:
        count = min(each, stage.stop - stage.start)
        chosen += np.linspace(stage.start, stage.stop - 1, count).round().astype(int).tolist()
    return np.array(chosen, dtype=np.int64)


def _strip(film: Film, frame: int, width: int) -> Image:
    """The strip beneath the picture: name of the stage, and a bar of normal force for each hand part."""
    from matplotlib.font_manager import FontProperties, findfont
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    sheet = Pillow.new("RGB", (width, STRIP_HEIGHT), to_bytes(PAPER))
    draw = ImageDraw.Draw(sheet)
    bold = ImageFont.truetype(findfont(FontProperties(family=FONT, weight="bold")), 14)
    plain = ImageFont.truetype(findfont(FONT), 11)
    stage = film.stage_at(frame)
    draw.text((12, 18), stage.name, font=bold, fill=to_bytes(INK), anchor="lm")
    if stage.passed is not None and frame == stage.stop - 1:
        result, colour = ("held", GREEN) if stage.passed else ("lost", VERMILION)
        draw.text((width - 12, 18), result, font=bold, fill=to_bytes(colour), anchor="rm")
    else:
        draw.text(
            (width - 12, 18), f"{film.times[frame]:.1f} s", font=plain, fill=to_bytes(QUIET), anchor="rm"
        )
    touching = [k for k in range(len(film.parts)) if film.normal_force[:, k].any()]
    highest = float(film.normal_force.max(initial=0.0)) or 1.0
    column = (width - 24) / max(1, len(touching))
    for place, k in enumerate(touching):
        x, length, force = 12 + place * column, column - 10, float(film.normal_force[frame, k])
        draw.text((x, 46), film.parts[k], font=plain, fill=to_bytes(QUIET), anchor="lm")
        draw.text((x + length, 46), f"{force:.1f} N", font=plain, fill=to_bytes(INK), anchor="rm")
        draw.rectangle([x, 60, x + length, 68], fill=to_bytes(FAINT))
        if force > 0:
            draw.rectangle([x, 60, x + length * force / highest, 68], fill=to_bytes(film.colours()[k]))
    return np.asarray(sheet)


def _gif(images: list[Image]) -> bytes:
    """Encode all frames with one palette of the whole run, without dithering, which would flicker."""
    from PIL import Image as Pillow

    pixels = np.concatenate([image.reshape(-1, 3) for image in images[:: max(1, len(images) // 6)]])
    # Coloured pixels are rare and the background is not. Repeating them gives both the same weight.
    vivid = pixels[np.ptp(pixels.astype(np.int16), axis=1) > VIVID]
    fixed = np.array(
        [to_bytes(c) for c in (*FINGERS.values(), LOAD, GREEN, VERMILION, INK, QUIET, PAPER, FAINT)]
    )
    repeats = max(1, len(pixels) // max(1, len(vivid)))
    weighted = np.concatenate(
        [pixels, np.tile(vivid, (repeats, 1)), np.repeat(fixed, len(pixels) // 100, axis=0)]
    )
    sample = Pillow.fromarray(np.asarray(weighted[None], dtype=np.uint8))
    palette = sample.quantize(256, method=Pillow.Quantize.MEDIANCUT, kmeans=2)
    frames = [Pillow.fromarray(i).quantize(palette=palette, dither=Pillow.Dither.NONE) for i in images]
    times = [round(1000 / RATE)] * (len(frames) - 1) + [round(1000 * LINGER)]
    buffer = io.BytesIO()
    frames[0].save(
        buffer, format="GIF", save_all=True, append_images=frames[1:], duration=times, loop=0, optimize=True
    )
    return buffer.getvalue()
