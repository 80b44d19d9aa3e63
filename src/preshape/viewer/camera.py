"""A pinhole camera: where points appear, and which way each pixel looks."""

from __future__ import annotations

import numpy as np

from ..exceptions import InputError
from ..types import Array, freeze, frozen_array, value


@value
class Camera:
    """A pinhole camera.

    Attributes:
        eye: where it is [m].
        target: the point in the middle of the picture [m].
        up: a direction that points upwards in the picture; also the floor's normal.
        fov: vertical angle of view [degrees].
    """

    eye: Array
    target: Array
    up: Array
    fov: float = 22.0

    def __post_init__(self) -> None:
        freeze(
            self, **{n: frozen_array(getattr(self, n), (3,), f"camera {n}") for n in ("eye", "target", "up")}
        )
        if not 0 < self.fov < 180:
            raise InputError(f"camera fov must be between 0 and 180 degrees, got {self.fov}")
        if np.linalg.norm(np.cross(self.eye - self.target, self.up)) < 1e-12:
            raise InputError("camera up must not point along the line from the eye to the target")

    @property
    def frame(self) -> Array:
        """(3, 3) rows: right, up and forward of the picture."""
        forward = (self.target - self.eye) / np.linalg.norm(self.target - self.eye)
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(right, forward), forward])

    @classmethod
    def framing(
        cls,
        points: Array,
        direction: Array,
        *,
        up: Array | tuple[float, float, float] = (0.0, 0.0, 1.0),
        fov: float = 22.0,
        aspect: float = 1.0,
        margin: float = 1.08,
    ) -> Camera:
        """The nearest camera that has all points in the picture.

        Args:
            points: (n, 3) what must be seen, e.g. the corners of a bounding box [m].
            direction: (3,) from the points towards the eye.
            up: (3,) upwards in the picture.
            fov: vertical angle of view [degrees].
            aspect: width of the picture divided by its height.
            margin: how much larger than the points the picture is; 1 touches its border.
        """
        points = frozen_array(points, (None, 3), "points to frame")
        target = (points.min(axis=0) + points.max(axis=0)) / 2
        slope = np.tan(np.radians(fov) / 2) * np.array([aspect, 1.0]) / margin
        offset = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
        frame = cls(eye=target + offset, target=target, up=np.asarray(up), fov=fov).frame
        local = (points - target) @ frame.T
        for _ in range(8):  # perspective: the middle depends on the distance, the distance on the middle
            reach = np.abs(local[:, :2]) / slope - local[:, 2:]
            distance = max(float(reach.max()), 1e-6)
            seen = local[:, :2] / (local[:, 2:] + distance)
            shift = np.append((seen.min(axis=0) + seen.max(axis=0)) / 2 * distance, 0.0)
            local = local - shift
            target = target + shift @ frame
        distance = max(float((np.abs(local[:, :2]) / slope - local[:, 2:]).max()), 1e-6)
        return cls(eye=target + distance * offset, target=target, up=np.asarray(up), fov=fov)


def project(camera: Camera, points: Array, size: tuple[int, int]) -> Array:
    """Where points appear.

    Args:
        camera: the camera of the picture.
        points: (n, 3) [m]; points behind the camera have no meaning here.
        size: width and height of the picture [pixels].

    Returns:
        (n, 2) pixels from the left and from the top; the middle of the first pixel is (0.5, 0.5).
    """
    local = (np.asarray(points, dtype=np.float64) - camera.eye) @ camera.frame.T
    scale = size[1] / 2 / np.tan(np.radians(camera.fov) / 2)
    flat = local[:, :2] / local[:, 2:] * [scale, -scale]
    return np.asarray(flat + np.array(size) / 2)


def directions(camera: Camera, pixels: Array, size: tuple[int, int]) -> Array:
    """(n, 3) unit directions from the eye through ``pixels``; the inverse of :func:`project`."""
    slope = np.tan(np.radians(camera.fov) / 2) / (size[1] / 2)
    flat = (np.asarray(pixels, dtype=np.float64) - np.array(size) / 2) * [slope, -slope]
    rays = np.column_stack([flat, np.ones(len(flat))]) @ camera.frame
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
