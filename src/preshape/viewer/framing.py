"""The initial camera of an interactive scene, whose picture contains everything."""

from __future__ import annotations

from itertools import product

import numpy as np

from ..types import Array
from .camera import Camera
from .draw import recorded
from .hand_motion import HandMotion
from .plan_scene import PlanScene, view_direction

FOV = 32.0
"""Angle of view [degrees]."""
REACH = 3.2
"""Distance from the object up to which points must be in the picture, in units of the scene's size."""
RUN_LOOKS = 24
"""Number of samples of a run that decide its camera."""
HAND_REACH = 2.5
"""Distance from the object up to which a run's picture contains the hand, in units of the scene's size."""
PHONE, NARROW = 500, 0.65
"""Largest width [pixels] and largest ratio of width to height of a phone's picture."""
COVERED = 0.45
"""Fraction of a phone's height that the panel covers, from below."""


def fitting(scene: PlanScene, motion: HandMotion | None, size: tuple[int, int]) -> Camera:
    """The camera for a browser's picture of ``size`` [pixels]; on a phone, the panel covers nothing of it."""
    return _for_browser(scene, _seen(scene, motion), size)


def following(scene: PlanScene, object_poses: Array, links: Array, size: tuple[int, int]) -> Camera:
    """The camera for a browser's picture of ``size`` [pixels] that contains a whole run in physics.

    Args:
        scene: The plan.
        object_poses: (n, 4, 4) poses of the object during the run.
        links: (n, m, 4, 4) poses of the hand's shapes.
        size: Width and height [pixels].
    """
    corners = np.array(list(product(*scene.mesh.bounds.T)))
    few = np.linspace(0, len(object_poses) - 1, RUN_LOOKS).astype(int)
    spots = [corners @ object_poses[k, :3, :3].T + object_poses[k, :3, 3] for k in few]
    for k in few:
        away = np.linalg.norm(links[k, :, :3, 3] - object_poses[k, :3, 3], axis=1)
        spots.append(links[k, away < HAND_REACH * scene.size, :3, 3])
    return _for_browser(scene, np.concatenate(spots), size)


def _for_browser(scene: PlanScene, points: Array, size: tuple[int, int]) -> Camera:
    """The camera whose picture contains the points above a phone's panel."""
    width, height = size
    aspect = float(np.clip(width / height, 0.4, 3.0))
    covered = COVERED if width <= PHONE and aspect <= NARROW else 0.0
    return above(_framed(scene, points, aspect / (1 - covered)), covered)


def framing(scene: PlanScene, motion: HandMotion | None, aspect: float) -> Camera:
    """A camera whose picture contains the object, all plane cards and the closed hand.

    Args:
        scene: The plan.
        motion: Motion of the hand; only its last frame counts. ``None`` without a hand.
        aspect: Width of the picture divided by its height.
    """
    return _framed(scene, _seen(scene, motion), aspect)


def _framed(scene: PlanScene, points: Array, aspect: float) -> Camera:
    return Camera.framing(points, view_direction(scene), fov=FOV, aspect=aspect, margin=1.08, up=scene.up)


def _seen(scene: PlanScene, motion: HandMotion | None) -> Array:
    """(k, 3) what a picture of a plan contains."""
    canvas = recorded(scene)
    clouds = [shape.vertices[:: max(1, len(shape.vertices) // 200)] for shape in canvas.solids.values()]
    if motion is not None:
        clouds.append(motion.poses[-1][:, :3, 3])
    points = np.concatenate(clouds)
    return points[np.linalg.norm(points - scene.cog, axis=1) < REACH * scene.size]


def above(camera: Camera, covered: float) -> Camera:
    """Move a camera so that the uncovered upper part of the new picture shows the whole old picture.

    Args:
        camera: Camera whose whole picture must remain visible.
        covered: Fraction 0..1 of the new picture's height that is covered, counted from the bottom.
    """
    if covered <= 0:
        return camera
    slope = np.tan(np.radians(camera.fov) / 2) / (1 - covered)
    distance = float(np.linalg.norm(camera.eye - camera.target))
    # The middle of the visible part lies this far above the middle of the whole picture.
    down = -covered * slope * distance * camera.frame[1]
    fov = float(np.degrees(2 * np.arctan(slope)))
    return Camera(eye=camera.eye + down, target=camera.target + down, up=camera.up, fov=fov)
