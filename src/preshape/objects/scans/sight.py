"""What a camera saw, as a function of space: free before the surface and beside the outline, unknown behind.

The points are drawn into an image of the camera's own sight: depth along each ray, and the signed distance
to the object's outline. A point in space that is nearer than the depth there, or outside the outline, was
seen to be free (visual hull and depth carving: Curless and Levoy 1996, A volumetric method for building
complex models from range images).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...types import Array, freeze, frozen_array, value
from .cleaning import nearest, spacing_of

PIXELS = 200
"""Pixels of the image along the cloud's longer side [C]."""
HOLE = 2.0
"""Gaps in the image up to this many spacings wide are surface that the camera missed [C]."""
RIM = 0.5
"""The outline runs this many spacings outside the last points: half a pixel, on average [C]."""
STEEPEST = 0.2
"""Least cosine of surface and ray: distances on steeper ones are taken as this [C]."""
HIDDEN, HIDDEN_DEPTH = 0.055, 0.25
"""Points behind others by more than the second (a part of the cloud's depth) are hidden; more of them than
the first (a share) mean that no single camera saw them all [C]."""


@value
class Sight:
    """A camera's view of one object.

    Attributes:
        camera: (3,) its position [m].
        axes: (3, 3) rows: right, down, forward; orthonormal, cloud frame.
        low: (2,) image coordinates (tangents) of the first pixel's middle.
        step: tangent of one pixel.
        depth: (h, w) distance along the forward axis [m].
        outline: (h, w) distance to the outline in tangents, positive outside.
        slant: (h, w) cosine between surface and ray.
        spacing: of the points [m].
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
        """How far points are in the space that was seen to be free [m]; negative behind the surface.

        Args:
            points: (n, 3) [m], cloud frame.

        Returns:
            (n,) roughly the distance to the seen surface or to the cone of the outline.
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
    """The view that a camera had of points.

    Args:
        points: (n, 3) cleaned [m].
        camera: (3,) its position [m], outside them.
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
    """Share of points that stand well behind others, seen from the camera.

    A camera sees no point through another, so a cloud with many such points has another camera, or several.
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
    """Rows right, down, forward of a camera; level with the cloud's z where it does not look along that.

    Args:
        forward: (3,) where it looks, of any length.
    """
    ahead = forward / np.linalg.norm(forward)
    up = np.array([0.0, 0.0, 1.0]) if abs(ahead[2]) < 0.95 else np.array([0.0, 1.0, 0.0])
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead])


def _gap(flat: Array) -> float:
    """Distance of neighbours in the image where the surface faces the camera [tangent]."""
    return float(np.quantile(nearest(flat, 5)[0][:, 4], 0.8))


def _depth(depths: Array, away: Array, jump: float) -> Array:
    """(n,) depth of each pixel from its four nearest points; the nearest alone across a step."""
    weight = 1.0 / np.maximum(away, 1e-12)
    mean = (weight * depths).sum(axis=1) / weight.sum(axis=1)
    return np.where(np.ptp(depths, axis=1) > jump, depths[:, 0], mean)


def _slant(depth: Array, step: float, low: Array) -> Array:
    """(h, w) cosine between ray and surface, from how depth changes."""
    down, right = np.gradient(depth, step)
    x = low[0] + step * np.arange(depth.shape[1])
    y = low[1] + step * np.arange(depth.shape[0])[:, None]
    # Surface point D (x, y, 1); its normal is (-Dx, -Dy, D + x Dx + y Dy) up to length.
    along = depth + x * right + y * down
    length = np.sqrt(right**2 + down**2 + along**2)
    return np.clip(depth / np.maximum(length, 1e-12), STEEPEST, 1.0)
