"""A pinhole camera: projection of points to pixels, and of pixels to viewing directions."""

from __future__ import annotations

import numpy as np

from ..exceptions import InputError
from ..types import Array, freeze, frozen_array, value

UP = np.array([0.0, 0.0, 1.0])
"""Direction that points upwards in a picture."""


@value
class Camera:
    """A pinhole camera.

    Attributes:
        eye: (3,) Position of the camera [m].
        target: (3,) Point in the middle of the picture [m].
        up: (3,) Direction that points upwards in the picture; also the normal of the floor.
        fov: Vertical angle of view [degrees].
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
        """(3, 3) Unit vectors as rows: right, up and forward of the picture."""
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
        fov: float = 22.0,
        aspect: float = 1.0,
        margin: float = 1.08,
        up: Array | None = None,
    ) -> Camera:
        """The nearest camera whose picture contains all points.

        Args:
            points: (n, 3) Points that must be in the picture [m].
            direction: (3,) Direction from the points towards the eye.
            fov: Vertical angle of view [degrees].
            aspect: Width of the picture divided by its height.
            margin: Size of the picture divided by the extent of the points; 1 leaves no border.
            up: (3,) Direction that points upwards in the picture; +z by default.
        """
        points, above = frozen_array(points, (None, 3), "points to frame"), UP if up is None else up
        target = (points.min(axis=0) + points.max(axis=0)) / 2
        slope = np.tan(np.radians(fov) / 2) * np.array([aspect, 1.0]) / margin
        offset = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
        frame = cls(eye=target + offset, target=target, up=above, fov=fov).frame
        local = (points - target) @ frame.T
        # A fixed-point iteration: with perspective, centre and distance depend on each other.
        for _ in range(8):
            reach = np.abs(local[:, :2]) / slope - local[:, 2:]
            distance = max(float(reach.max()), 1e-6)
            seen = local[:, :2] / (local[:, 2:] + distance)
            shift = np.append((seen.min(axis=0) + seen.max(axis=0)) / 2 * distance, 0.0)
            local = local - shift
            target = target + shift @ frame
        distance = max(float((np.abs(local[:, :2]) / slope - local[:, 2:]).max()), 1e-6)
        return cls(eye=target + distance * offset, target=target, up=above, fov=fov)


def project(camera: Camera, points: Array, size: tuple[int, int]) -> Array:
    """Project points into a picture.

    Args:
        camera: The camera.
        points: (n, 3) Points in front of the camera [m].
        size: Width and height of the picture [pixels].

    Returns:
        (n, 2) Pixels from the left and from the top; the centre of the first pixel is (0.5, 0.5).
    """
    local = (np.asarray(points, dtype=np.float64) - camera.eye) @ camera.frame.T
    scale = size[1] / 2 / np.tan(np.radians(camera.fov) / 2)
    flat = local[:, :2] / local[:, 2:] * [scale, -scale]
    return np.asarray(flat + np.array(size) / 2)


def directions(camera: Camera, pixels: Array, size: tuple[int, int]) -> Array:
    """(n, 3) Unit directions from the eye through ``pixels`` (n, 2), which :func:`project` maps back."""
    slope = np.tan(np.radians(camera.fov) / 2) / (size[1] / 2)
    flat = (np.asarray(pixels, dtype=np.float64) - np.array(size) / 2) * [slope, -slope]
    rays = np.column_stack([flat, np.ones(len(flat))]) @ camera.frame
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
