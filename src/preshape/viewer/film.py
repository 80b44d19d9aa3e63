"""A run in simulated physics as the viewer takes it: solids that move, numbers over time, and stages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..exceptions import InputError
from ..types import Array, IntArray, freeze, frozen_array, value
from .camera import Camera, project
from .colours import INK, Colour, finger_colour
from .raycast import Image, Shape, render, visible
from .shapes import arrow

VIEWS = 6
"""Directions all around from which the fingers are looked for; the one that sees most of them is taken."""
RISE = 0.46
"""Height of the eye above the object, over its distance on the ground."""
LOAD: Colour = (0.78, 0.16, 0.16)
"""Of the arrow that shows the load."""
ARROW = 0.85
"""Length of the load's arrow, in half diagonals of the object."""
GHOST = 0.3
"""How much of that arrow shows through what hides it."""


@value
class Stage:
    """A stretch of a film.

    Attributes:
        name: as a heading, ``squeeze``, ``force +x``.
        start: its first frame.
        stop: one past its last.
        note: what came of it, as ``held · 0.4 mm``; may be empty.
        good: whether it went well; ``None`` where that is no question.
    """

    name: str
    start: int
    stop: int
    note: str = ""
    good: bool | None = None


@value
class Film:
    """A run: n frames, m solids, k parts of the hand that touch, and the object.

    Attributes:
        title: the heading.
        subtitle: a second line.
        verdict: one sentence on how it ended.
        good: whether it ended well.
        times: (n,) [s].
        stages: in their order, without gaps.
        solids: (m) each in its own body's frame [m].
        is_object: (m,) 1 for the object's solids, 0 for the hand's.
        places: (n, m, 4, 4) pose of each solid's body in the world.
        load: (n, 6) force [N] and torque [N m] on the object.
        centre: (n, 3) where the load acts [m].
        parts: (k) names of what can touch, as ``thumb``.
        normal: (n, k) normal force [N].
        slip: (n, k) [m].

    Raises:
        InputError: arrays of other shapes; no frames, or stages that do not follow each other.
    """

    title: str
    subtitle: str
    verdict: str
    good: bool
    times: Array
    stages: tuple[Stage, ...]
    solids: tuple[Shape, ...]
    is_object: tuple[bool, ...]
    places: Array
    load: Array
    centre: Array
    parts: tuple[str, ...]
    normal: Array
    slip: Array

    def __post_init__(self) -> None:
        n, m, k = len(self.times), len(self.solids), len(self.parts)
        shapes: dict[str, tuple[int | None, ...]] = {
            "times": (n,), "places": (n, m, 4, 4), "load": (n, 6), "centre": (n, 3),
            "normal": (n, k), "slip": (n, k),
        }  # fmt: skip
        for name, shape in shapes.items():
            freeze(self, **{name: frozen_array(getattr(self, name), shape, f"film: {name}")})
        cuts = [0, *(stage.stop for stage in self.stages)]
        if not n or [s.start for s in self.stages] != cuts[:-1] or cuts[-1] != n or cuts != sorted(set(cuts)):
            raise InputError("a film needs frames, and stages that follow each other and cover all of them")
        if len(self.is_object) != m or not any(self.is_object):
            raise InputError("a film needs an object, and whether each solid belongs to it")

    def __len__(self) -> int:
        return len(self.times)

    def stage_at(self, frame: int) -> Stage:
        """The stage that a frame belongs to."""
        return next(stage for stage in self.stages if stage.start <= frame < stage.stop)

    @property
    def size(self) -> float:
        """Half the diagonal of the object where it begins [m]."""
        return float(np.linalg.norm(np.ptp(self._points(0, of_object=True), axis=0))) / 2

    def colours(self) -> tuple[Colour, ...]:
        """One colour for each part; the palm is ink."""
        fingers = [name for name in self.parts if name != "palm"]
        return tuple(INK if n == "palm" else finger_colour(n, fingers.index(n)) for n in self.parts)

    def shapes(self, frame: int) -> list[Shape]:
        """What is to be drawn at a frame."""
        result = [
            replace(solid, vertices=solid.vertices @ T[:3, :3].T + T[:3, 3])
            for solid, T in zip(self.solids, self.places[frame], strict=True)
        ]
        stroke = self.stroke(frame, self.load[frame])
        if stroke is not None:
            result.append(arrow(*stroke, 0.05 * self.size, LOAD))
        return result

    def stroke(self, frame: int, load: Array) -> tuple[Array, Array] | None:
        """Start and tip of a load's arrow: outside the object and away from it, as if it were pulled."""
        way = load[:3] if load[:3].any() else load[3:]
        if not way.any():
            return None
        way = way / np.linalg.norm(way)
        start = self.centre[frame] + self._reach(frame, way) * way
        return start, start + ARROW * self.size * way

    def camera(self, frames: IntArray, aspect: float) -> Camera:
        """One camera for all pictures: it has the hand in these frames, and the object where it begins.

        Args:
            frames: which frames; the fingers are seen best in the one before the first probe.
            aspect: width of the picture divided by its height.
        """
        begins = self._points(0, of_object=True)
        middle, size = (begins.min(axis=0) + begins.max(axis=0)) / 2, self.size
        around = [middle + 1.3 * size * np.concatenate([np.eye(3), -np.eye(3)])]
        held = max((s.stop - 1 for s in self.stages if s.good is None), default=0)
        strokes = [self.stroke(held, load) for load in np.unique(self.load, axis=0)]
        around += [np.array(stroke) for stroke in strokes if stroke is not None]
        alone = all(self.is_object)
        hand = [] if alone else [self._points(int(f), of_object=False) for f in frames]
        # A long forearm, or an object that was thrown away, does not make the grasp small.
        near = around + [p[np.linalg.norm(p - middle, axis=1) < 3 * size] for p in hand]
        points = np.concatenate([_outermost(p) for p in near if len(p)])
        angles = np.radians(-49.0) + 2 * np.pi * np.arange(1 if alone else VIEWS) / VIEWS
        ways = np.column_stack([np.cos(angles), np.sin(angles), np.full(len(angles), RISE)])
        cameras = [Camera.framing(points, way, aspect=aspect, margin=1.06) for way in ways]
        if alone:
            return cameras[0]
        shapes = [shape for shape in self.shapes(held) if shape.colour != LOAD]
        seen = self._points(held, of_object=False)[::11]
        seen = seen[np.linalg.norm(seen - middle, axis=1) < 1.5 * size]
        # Whole per cents: of views that are as good as each other the first is taken, on every machine.
        shares = [round(100 * float(visible(shapes, c, seen).mean())) if len(seen) else 0 for c in cameras]
        return cameras[int(np.argmax(shares))]

    def picture(self, frame: int, camera: Camera, size: tuple[int, int], *, samples: int = 3) -> Image:
        """Draw a frame (h, w, 3); the floor lies under everything at the first frame."""
        floor = min(float(self._points(0, of_object=o).min(axis=0)[2]) for o in set(self.is_object))
        image = render(self.shapes(frame), camera, size, samples=samples, ground=floor - 0.02 * self.size)
        stroke = self.stroke(frame, self.load[frame])
        return image if stroke is None else _through_glass(image, camera, *stroke)

    def _points(self, frame: int, *, of_object: bool) -> Array:
        return np.concatenate(
            [
                solid.vertices @ T[:3, :3].T + T[:3, 3]
                for solid, own, T in zip(self.solids, self.is_object, self.places[frame], strict=True)
                if own == of_object
            ]
        )

    def _reach(self, frame: int, way: Array) -> float:
        points = self._points(frame, of_object=True) - self.centre[frame]
        # Along the arrow's own line, not the bounding box: a mug's handle does not push it away.
        beside = np.linalg.norm(points - np.outer(points @ way, way), axis=1)
        near = points[beside <= max(0.35 * self.size, float(beside.min()))]
        return max(0.0, float((near @ way).max())) + 0.12 * self.size


def _outermost(points: Array) -> Array:
    """The points that lie farthest in many directions: what a camera must have in its picture."""
    points = points[:: max(1, len(points) // 4000)]
    k = np.arange(80)  # spread evenly over the sphere
    height, turn = 1 - (2 * k + 1) / len(k), np.pi * (1 + np.sqrt(5.0)) * k
    flat = np.sqrt(1 - height**2)
    ways = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), height])
    return points[np.unique(np.argmax(points @ ways.T, axis=0))]


def _through_glass(image: Image, camera: Camera, start: Array, tip: Array) -> Image:
    """The arrow once more, faintly, over whatever hides it."""
    from PIL import Image as Pillow
    from PIL import ImageDraw

    fine = 3
    size = (image.shape[1] * fine, image.shape[0] * fine)
    a, b = project(camera, np.array([start, tip]), size)
    mask = Pillow.new("L", size)
    draw = ImageDraw.Draw(mask)
    length = float(np.linalg.norm(b - a))
    if length > 1.0:
        along = (b - a) / length
        across, neck = np.array([-along[1], along[0]]), b - 0.4 * (b - a)
        wide = 0.012 * size[0]
        draw.line([*a, *neck], fill=255, width=round(wide))
        draw.polygon(
            [tuple(p) for p in (b, neck + 1.6 * wide * across, neck - 1.6 * wide * across)], fill=255
        )
    share = GHOST / 255 * np.asarray(mask.resize(image.shape[1::-1], Pillow.Resampling.BOX))[:, :, None]
    mixed = (1 - share) * image + share * 255 * np.array(LOAD)
    return np.asarray(np.round(mixed), dtype=np.uint8)
