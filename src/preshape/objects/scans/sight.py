"""Which space a camera saw to be free: that in front of the surface and beside the outline.

The points are projected into an image of the camera, which holds the depth along each ray and the signed
distance to the object's outline. A point in space was seen to be free if it is nearer than the depth or
outside the outline; all other space is unknown (visual hull and depth carving: Curless and Levoy 1996, A
volumetric method for building complex models from range images).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...types import Array, freeze, frozen_array, value
from .cleaning import nearest, spacing_of

PIXELS = 200
"""Pixels of the image along the longer side of the cloud [C]."""
HOLE = 2.0
"""Gaps in the image up to this number of spacings count as surface that the camera missed [C]."""
RIM = 0.5
"""Distance of the outline from the outermost points, in spacings; half a pixel on average [C]."""
STEEPEST = 0.2
"""Least cosine of the angle between surface normal and ray; smaller cosines count as this one [C]."""
HIDDEN, HIDDEN_DEPTH = 0.055, 0.25
"""A point is hidden if it is behind others by more than ``HIDDEN_DEPTH`` times the cloud's depth. If the
share of hidden points exceeds ``HIDDEN``, no single camera has seen all points [C]."""


@value
class Sight:
    """A camera's view of one object.

    Attributes:
        camera: (3,) position of the camera [m].
        axes: (3, 3) orthonormal rows right, down, forward in the frame of the cloud.
        low: (2,) image coordinates (tangents) of the centre of the first pixel.
        step: Size of a pixel (tangent).
        depth: (h, w) distance of the surface along the forward axis [m].
        outline: (h, w) distance from the outline (tangent), positive outside.
        slant: (h, w) cosine of the angle between surface normal and ray.
        spacing: Spacing of the points [m].
    """

    camera: Array
    axes: Array
    low: Array
    step: float
    depth: Array
    outline: Array
    slant: Array
    spacing: float

    def __post_init__(self) -> None:
        freeze(
            self,
            camera=frozen_array(self.camera, (3,), "camera"),
            axes=frozen_array(self.axes, (3, 3), "camera axes"),
            low=frozen_array(self.low, (2,), "image corner"),
            depth=frozen_array(self.depth, (None, None), "depth"),
            outline=frozen_array(self.outline, (None, None), "outline"),
            slant=frozen_array(self.slant, (None, None), "slant"),
        )

    @property
    def forward(self) -> Array:
        """(3,) unit vector from the camera to the object."""
        return self.axes[2]

    def free(self, points: Array) -> Array:
        """How far points are inside the space that was seen to be free, negative behind the surface.

        Args:
            points: (n, 3) points in the frame of the cloud [m].

        Returns:
            (n,) approximate distances to the seen surface or to the cone of the outline [m].
        """
        from scipy.ndimage import map_coordinates

        local = (points - self.camera) @ self.axes.T
        deep = np.maximum(local[:, 2], 1e-6)
        place = (local[:, :2] / deep[:, None] - self.low) / self.step
        rows_columns = place[:, ::-1].T

        def at(image: NDArray[np.float64]) -> Array:
            found: Array = map_coordinates(image, rows_columns, order=1, mode="nearest")
            return found

        last = np.array(self.depth.shape[::-1]) - 1.0
        beyond = np.linalg.norm(np.maximum(np.maximum(-place, place - last), 0.0), axis=1) * self.step
        before = (at(self.depth) - deep) * at(self.slant)
        return np.maximum(before, (at(self.outline) + beyond) * deep)


def sight_of(points: Array, camera: Array) -> Sight:
    """The view of a camera on points.

    Args:
        points: (n, 3) cleaned points [m].
        camera: (3,) position of the camera outside the points [m].
    """
    from scipy.ndimage import distance_transform_edt

    axes = level_axes(points.mean(axis=0) - camera)
    local = (points - camera) @ axes.T
    flat = local[:, :2] / local[:, 2:]
    spacing = spacing_of(points)
    gap = _gap(flat)
    margin = 2 * HOLE * gap
    low, high = flat.min(axis=0) - margin, flat.max(axis=0) + margin
    step = float((high - low).max()) / PIXELS
    width, height = np.ceil((high - low) / step).astype(int) + 1
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    pixels = low + step * np.stack([columns, rows], axis=-1).reshape(-1, 2)
    away, near = nearest(flat, 4, pixels)
    inside = (away[:, 0] < HOLE * gap).reshape(height, width)
    grown = np.asarray(distance_transform_edt(~inside)) - np.asarray(distance_transform_edt(inside))
    outline = step * grown + (HOLE - RIM) * gap
    depth = _depth(local[near, 2], away, 4 * spacing).reshape(height, width)
    return Sight(
        camera=camera,
        axes=axes,
        low=low,
        step=step,
        depth=depth,
        outline=outline,
        slant=_slant(depth, step, low),
        spacing=spacing,
    )


def hidden_share(points: Array, camera: Array) -> float:
    """Share of points that are hidden behind others from a camera.

    No camera sees hidden points, so a cloud with many of them comes from another camera or from several.

    Args:
        points: (n, 3) points [m].
        camera: (3,) position of the camera [m].
    """
    axes = level_axes(points.mean(axis=0) - camera)
    local = (points - camera) @ axes.T
    if local[:, 2].min() <= 0:
        return 1.0
    flat = local[:, :2] / local[:, 2:]
    cell = 2 * spacing_of(points) / float(np.median(local[:, 2]))
    _, label = np.unique(np.floor(flat / cell).astype(np.int64), axis=0, return_inverse=True)
    label = label.ravel()
    front = np.full(label.max() + 1, np.inf)
    np.minimum.at(front, label, local[:, 2])
    deep = float(np.subtract(*np.quantile(local[:, 2], [0.98, 0.02])))
    return float((local[:, 2] > front[label] + HIDDEN_DEPTH * deep).mean())


def level_axes(forward: Array) -> Array:
    """(3, 3) rows right, down, forward of a level camera.

    The camera is level with respect to z, or to y if it looks along z.

    Args:
        forward: (3,) direction of the view, of any length.
    """
    ahead = forward / np.linalg.norm(forward)
    up = np.array([0.0, 0.0, 1.0]) if abs(ahead[2]) < 0.95 else np.array([0.0, 1.0, 0.0])
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead])


def _gap(flat: Array) -> float:
    """Distance of neighbours in the image where the surface faces the camera (tangent)."""
    return float(np.quantile(nearest(flat, 5)[0][:, 4], 0.8))


def _depth(depths: Array, away: Array, jump: float) -> Array:
    """(n,) depth of each pixel from its four nearest points, or from the nearest one at a step of depth."""
    weight = 1.0 / np.maximum(away, 1e-12)
    mean = (weight * depths).sum(axis=1) / weight.sum(axis=1)
    return np.where(np.ptp(depths, axis=1) > jump, depths[:, 0], mean)


def _slant(depth: Array, step: float, low: Array) -> Array:
    """(h, w) cosine of the angle between ray and surface normal, from the gradient of the depth."""
    down, right = np.gradient(depth, step)
    x = low[0] + step * np.arange(depth.shape[1])
    y = low[1] + step * np.arange(depth.shape[0])[:, None]
    # The surface point D (x, y, 1) has the normal (-Dx, -Dy, D + x Dx + y Dy), up to its length.
    along = depth + x * right + y * down
    length = np.sqrt(right**2 + down**2 + along**2)
    return np.clip(depth / np.maximum(length, 1e-12), STEEPEST, 1.0)
