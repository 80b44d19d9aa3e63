"""A run in simulated physics as plain values: moving solids, forces over time, and stages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..exceptions import InputError
from ..types import Array, IntArray, freeze, frozen_array, value
from .camera import Camera, project
from .colours import Colour, finger_colour
from .raycast import Image, Shape, render, visible
from .shapes import arrow

VIEWS = 6
"""Number of camera directions around the object; the one that sees most of the fingers is used."""
RISE = 0.46
"""Height of the eye above the object, divided by its horizontal distance."""
LOAD: Colour = (0.78, 0.16, 0.16)
"""Colour of the arrow that shows the load."""
ARROW = 0.85
"""Length of the load's arrow, in half diagonals of the object's bounding box."""
SHOW_THROUGH = 0.3
"""Opacity of the load's arrow where something hides it."""


@value
class FilmStage:
    """A range of a film's frames.

    Attributes:
        name: Name to display, for example ``squeeze`` or ``force +x``.
        start: First frame.
        stop: Last frame plus one.
        note: Result to display, for example ``held · 0.4 mm``; may be empty.
        passed: Whether the hand held the object; ``None`` for a stage before the probes (the applied loads).
    """

    name: str
    start: int
    stop: int
    note: str = ""
    passed: bool | None = None


@value
class Film:
    """A run with n frames, m solids, and k parts of the hand that can touch the object.

    Attributes:
        title: Heading.
        subtitle: Second line of the heading.
        verdict: Result in one sentence.
        passed: Whether the hand held the object.
        times: (n,) Time of each frame [s].
        stages: Stages in order, without gaps.
        solids: (m) Shape of each solid in the frame of its body [m].
        is_object: (m) Whether each solid belongs to the object.
        poses: (n, m, 4, 4) Pose of each solid's body in the world frame.
        load: (n, 6) Force [N] and torque [N m] on the object in the world frame, about ``load_point``.
        load_point: (n, 3) Point at which the load acts [m].
        parts: (k) Names, for example ``thumb``.
        normal_force: (n, k) Normal force of each part [N].
        slip: (n, k) Slip of each part on the object [m].
        table: Height of a table [m]; ``None`` draws a floor below everything in the first frame.

    Raises:
        InputError: An array has the wrong shape, there are no frames, or the stages do not cover all frames.
    """

    title: str
    subtitle: str
    verdict: str
    passed: bool
    times: Array
    stages: tuple[FilmStage, ...]
    solids: tuple[Shape, ...]
    is_object: tuple[bool, ...]
    poses: Array
    load: Array
    load_point: Array
    parts: tuple[str, ...]
    normal_force: Array
    slip: Array
    table: float | None = None

    def __post_init__(self) -> None:
        n, m, k = len(self.times), len(self.solids), len(self.parts)
        shapes: dict[str, tuple[int | None, ...]] = {
            "times": (n,), "poses": (n, m, 4, 4), "load": (n, 6), "load_point": (n, 3),
            "normal_force": (n, k), "slip": (n, k),
        }  # fmt: skip
        for name, shape in shapes.items():
            freeze(self, **{name: frozen_array(getattr(self, name), shape, f"film: {name}")})
        cuts = [0, *(stage.stop for stage in self.stages)]
        if not n or [s.start for s in self.stages] != cuts[:-1] or cuts[-1] != n or cuts != sorted(set(cuts)):
            raise InputError("a film needs frames, and stages that follow each other and cover all of them")
        if len(self.is_object) != m or not any(self.is_object):
            raise InputError("a film needs an object, and must say of each solid whether it belongs to it")

    def __len__(self) -> int:
        return len(self.times)

    def stage_at(self, frame: int) -> FilmStage:
        """The stage of a frame."""
        return next(stage for stage in self.stages if stage.start <= frame < stage.stop)

    @property
    def size(self) -> float:
        """Half the diagonal of the object's bounding box in the first frame [m]."""
        return float(np.linalg.norm(np.ptp(self._points(0, of_object=True), axis=0))) / 2

    def colours(self) -> tuple[Colour, ...]:
        """One colour for each part; the palm has the colour of text."""
        fingers = [name for name in self.parts if name != "palm"]
        return tuple(finger_colour(n, fingers.index(n) if n in fingers else 0) for n in self.parts)

    def shapes(self, frame: int) -> list[Shape]:
        """The shapes of a frame: the solids at their poses, and the arrow of the load."""
        result = [
            replace(solid, vertices=solid.vertices @ T[:3, :3].T + T[:3, 3])
            for solid, T in zip(self.solids, self.poses[frame], strict=True)
        ]
        ends = self.load_arrow(frame, self.load[frame])
        if ends is not None:
            result.append(arrow(*ends, 0.05 * self.size, LOAD))
        return result

    def load_arrow(self, frame: int, load: Array) -> tuple[Array, Array] | None:
        """Start and tip (3,) of a load's arrow [m]; it begins outside the object and points away from it.

        Args:
            frame: Frame that gives the object's pose.
            load: (6,) Force and torque; without a force the arrow shows the torque's axis.

        Returns:
            ``None`` without a load.
        """
        direction = load[:3] if load[:3].any() else load[3:]
        if not direction.any():
            return None
        direction = direction / np.linalg.norm(direction)
        start = self.load_point[frame] + self._reach(frame, direction) * direction
        return start, start + ARROW * self.size * direction

    def camera(self, frames: IntArray, aspect: float) -> Camera:
        """One camera for all pictures of a run.

        1. Collect what the picture must contain: the object in the first frame, the arrows of all loads, and
           the hand in ``frames``; with a table, from which the object is lifted, also the object in them.
        2. Of ``VIEWS`` directions around the object, take the one that sees most of the fingers in the last
           frame before the probes.

        Args:
            frames: Frames in which the hand must be in the picture.
            aspect: Width of the picture divided by its height.
        """
        shown = [0] if self.table is None else [0, *frames]
        seen = np.concatenate([self._points(int(f), of_object=True) for f in shown])
        middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
        size = float(np.linalg.norm(np.ptp(seen, axis=0))) / 2
        around = [middle + 1.3 * size * np.concatenate([np.eye(3), -np.eye(3)])]
        squeezed = max((s.stop - 1 for s in self.stages if s.passed is None), default=0)
        arrows = [self.load_arrow(squeezed, load) for load in np.unique(self.load, axis=0)]
        around += [np.array(ends) for ends in arrows if ends is not None]
        alone = all(self.is_object)
        hand = [] if alone else [self._points(int(f), of_object=False) for f in frames]
        # Only points near the object must be in the picture: a long forearm would make the grasp small.
        near = around + [p[np.linalg.norm(p - middle, axis=1) < 3 * size] for p in hand]
        points = np.concatenate([_outermost(p) for p in near if len(p)])
        angles = np.radians(-49.0) + 2 * np.pi * np.arange(1 if alone else VIEWS) / VIEWS
        directions = np.column_stack([np.cos(angles), np.sin(angles), np.full(len(angles), RISE)])
        cameras = [Camera.framing(points, d, aspect=aspect, margin=1.06) for d in directions]
        if alone:
            return cameras[0]
        shapes = [shape for shape in self.shapes(squeezed) if shape.colour != LOAD]
        fingers = self._points(squeezed, of_object=False)[::11]
        fingers = fingers[np.linalg.norm(fingers - middle, axis=1) < 1.5 * size]
        # Scores are rounded to whole per cent, so that every machine takes the first of equally good views.
        scores = [
            round(100 * float(visible(shapes, c, fingers).mean())) if len(fingers) else 0 for c in cameras
        ]
        return cameras[int(np.argmax(scores))]

    def picture(self, frame: int, camera: Camera, size: tuple[int, int], *, samples: int = 3) -> Image:
        """Draw a frame (h, w, 3); without a table, the floor lies below everything in the first frame."""
        ground = self.table
        if ground is None:
            lowest = min(float(self._points(0, of_object=o).min(axis=0)[2]) for o in set(self.is_object))
            ground = lowest - 0.02 * self.size
        image = render(self.shapes(frame), camera, size, samples=samples, ground=ground)
        ends = self.load_arrow(frame, self.load[frame])
        return image if ends is None else _with_faint_arrow(image, camera, *ends)

    def _points(self, frame: int, *, of_object: bool) -> Array:
        """(v, 3) Vertices of the object's solids, or of the hand's, in the world frame [m]."""
        return np.concatenate(
            [
                solid.vertices @ T[:3, :3].T + T[:3, 3]
                for solid, own, T in zip(self.solids, self.is_object, self.poses[frame], strict=True)
                if own == of_object
            ]
        )

    def _reach(self, frame: int, direction: Array) -> float:
        """Distance from the load's point, along a unit direction, to just outside the object [m]."""
        points = self._points(frame, of_object=True) - self.load_point[frame]
        # Only the surface near the arrow's line counts; a mug's handle beside the line does not.
        beside = np.linalg.norm(points - np.outer(points @ direction, direction), axis=1)
        near = points[beside <= max(0.35 * self.size, float(beside.min()))]
        return max(0.0, float((near @ direction).max())) + 0.12 * self.size


def _outermost(points: Array) -> Array:
    """For each of 80 directions, the farthest point; these points suffice to frame the picture."""
    points = points[:: max(1, len(points) // 4000)]
    k = np.arange(80)  # a spiral that covers the sphere evenly
    height, turn = 1 - (2 * k + 1) / len(k), np.pi * (1 + np.sqrt(5.0)) * k
    flat = np.sqrt(1 - height**2)
    directions = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), height])
    return points[np.unique(np.argmax(points @ directions.T, axis=0))]


def _with_faint_arrow(image: Image, camera: Camera, start: Array, tip: Array) -> Image:
    """The image with the arrow drawn again, faintly, over the parts that hide it."""
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
    opacity = (
        SHOW_THROUGH / 255 * np.asarray(mask.resize(image.shape[1::-1], Pillow.Resampling.BOX))[:, :, None]
    )
    mixed = (1 - opacity) * image + opacity * 255 * np.array(LOAD)
    return np.asarray(np.round(mixed), dtype=np.uint8)
