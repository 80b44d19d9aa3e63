"""Where the camera of an interactive scene is put first: everything in the picture, across the plane."""

from __future__ import annotations

import numpy as np

from ..types import Array
from .camera import Camera
from .canvas import RecordingCanvas
from .draw import draw_object, draw_plan
from .hand_motion import HandMotion
from .plan_scene import PlanScene

FOV = 32.0
"""Angle of view [degrees]."""
REACH = 3.2
"""How far from the object things count for the picture, in half diagonals of the object."""
PHONE, NARROW = 500, 0.65
"""Pictures of at most this width [pixels] and this share of their height are a phone's."""
COVERED = 0.45
"""Share of a phone's height that the panel covers, from below."""


def fitting(scene: PlanScene, motion: HandMotion | None, size: tuple[int, int]) -> Camera:
    """The camera for a browser's picture of a width and height [pixels]; a phone's panel covers nothing."""
    width, height = size
    aspect = float(np.clip(width / height, 0.4, 3.0))
    covered = COVERED if width <= PHONE and aspect <= NARROW else 0.0
    return above(framing(scene, motion, aspect / (1 - covered)), covered)


def framing(scene: PlanScene, motion: HandMotion | None, aspect: float) -> Camera:
    """A camera that has the object, all plane cards and the closed hand in its picture."""
    taken = RecordingCanvas()
    draw_object(scene, taken)
    draw_plan(scene, taken)
    clouds = [shape.vertices[:: max(1, len(shape.vertices) // 200)] for shape in taken.solids.values()]
    if motion is not None:
        clouds.append(motion.poses[-1][:, :3, 3])
    points = np.concatenate(clouds)
    near = points[np.linalg.norm(points - scene.cog, axis=1) < REACH * scene.size]
    return Camera.framing(near, direction_of(scene), fov=FOV, aspect=aspect, margin=1.08)


def direction_of(scene: PlanScene) -> Array:
    """(3,) from the object to the eye: across the approach plane, from a little above."""
    if scene.plane is None:
        return np.array([0.62, -0.72, 0.42])
    a, o, t = scene.plane.approach_axis, scene.plane.opposition_axis, scene.plane.transverse_axis
    t = t if t @ [0.3, -0.5, 1.0] > 0 else -t
    way = 0.80 * t + 0.30 * a + 0.42 * o
    flat = float(np.hypot(way[0], way[1]))
    return np.array([way[0], way[1], np.clip(way[2], 0.3 * flat, 0.8 * flat)])


def above(camera: Camera, covered: float) -> Camera:
    """The camera whose picture shows the same in its upper part, where its lower part is covered.

    Args:
        camera: of the part that can be seen.
        covered: share 0..1 of the whole height that is covered from below.
    """
    if covered <= 0:
        return camera
    slope = np.tan(np.radians(camera.fov) / 2) / (1 - covered)
    distance = float(np.linalg.norm(camera.eye - camera.target))
    # The middle of what is seen stands this far above the whole picture's middle.
    down = -covered * slope * distance * camera.frame[1]
    fov = float(np.degrees(2 * np.arctan(slope)))
    return Camera(eye=camera.eye + down, target=camera.target + down, up=camera.up, fov=fov)
