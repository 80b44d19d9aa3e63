"""Pictures of triangles by ray casting on the CPU; neither a display nor a GPU is needed.

The light comes from a soft key light behind the viewer's left shoulder and from a sky with ambient occlusion.
The floor shows shadows; elsewhere it looks like the background. Colours are mixed as linear light and encoded
as sRGB at the end. The same arguments always give the same image.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..exceptions import InputError
from ..types import Array, BoolArray, IntArray, freeze, frozen_array, value
from .camera import Camera, directions, project
from .colours import SKY_BOTTOM, SKY_TOP, Colour
from .shading import corner_normals, guarded_blur, hemisphere, tangents, to_display, to_linear

__all__ = ["Camera", "Image", "Shape", "project", "render", "visible"]

Image: TypeAlias = NDArray[np.uint8]
Rays: TypeAlias = NDArray[np.float32]

LIGHT_RAYS = 4
"""Number of rays to the sky, and of rays to the key light, from each shaded point."""
DIRECTIONS = 256
"""Number of directions in the table; neighbouring points use different ones."""
EDGE = 0.03
"""Difference between neighbouring pixels [display value, 0..1] above which a pixel is supersampled."""
MAX_LAYERS = 40
"""Largest number of translucent surfaces that a ray passes before an opaque one."""


@value
class Shape:
    """Triangles of one material.

    Of a translucent shape (alpha < 1), a ray sees only the first surface. Translucent shapes cast no shadow.

    Attributes:
        vertices: (n, 3) Positions [m].
        triangles: (m, 3) Indices into ``vertices``.
        colour: Red, green and blue, each 0..1, sRGB.
        alpha: Opacity, from 0 (invisible) to 1 (opaque).
        smooth: Whether normals are interpolated across all but sharp edges.
        lit: Whether the shape is shaded and casts shadow; otherwise it shows its plain colour.
        name: Name to display.

    Raises:
        InputError: An array has the wrong shape, an index is out of range, or alpha is not in 0..1.
    """

    vertices: Array
    triangles: IntArray
    colour: Colour
    alpha: float = 1.0
    smooth: bool = False
    lit: bool = True
    name: str = ""

    def __post_init__(self) -> None:
        triangles = np.array(self.triangles, dtype=np.int64)
        vertices = frozen_array(self.vertices, (None, 3), "shape vertices")
        if triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles):
            raise InputError(f"shape triangles must be m×3 with m > 0, got shape {triangles.shape}")
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise InputError(f"shape triangles must index the {len(vertices)} vertices of the shape")
        if not 0 <= self.alpha <= 1:
            raise InputError(f"shape alpha must be 0..1, got {self.alpha}")
        triangles.setflags(write=False)
        freeze(self, vertices=vertices, triangles=triangles)
        freeze(self, colour=tuple(frozen_array(self.colour, (3,), "shape colour").tolist()))


class _Scene:
    """The shapes as Embree geometry: all of them, and the opaque ones, which cast shadow."""

    def __init__(self, shapes: Sequence[Shape], camera: Camera, ground: float | None) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        corners = np.concatenate([s.vertices[s.triangles].reshape(-1, 3) for s in shapes])
        self.scale = float(np.linalg.norm(np.ptp(corners, axis=0))) or 1.0
        self.origin = corners.min(axis=0)
        self.all, self.opaque = EmbreeScene(), EmbreeScene()
        self.has_opaque = any(s.alpha == 1 and s.lit for s in shapes)
        normals = []
        for shape in shapes:
            # Embree computes in float32, so coordinates are relative to the scene's corner and diagonal.
            points = ((shape.vertices - self.origin) / self.scale).astype(np.float32)
            indices = shape.triangles.astype(np.int32)
            normals.append(corner_normals(points, indices, smooth=shape.smooth))
            for scene in [self.all] + [self.opaque] * (shape.alpha == 1 and shape.lit):
                TriangleMesh(scene, points, indices)
        self.first = np.cumsum([0] + [len(n) for n in normals])[:-1]
        self.normals = np.concatenate(normals)
        self.colour = to_linear(np.array([s.colour for s in shapes]))
        self.alpha = np.array([s.alpha for s in shapes], dtype=np.float32)
        self.lit = np.array([s.lit for s in shapes])
        self.up = (camera.up / np.linalg.norm(camera.up)).astype(np.float32)
        self.floor = None if ground is None else (ground - self.origin @ self.up) / self.scale
        self.eye = ((camera.eye - self.origin) / self.scale).astype(np.float32)
        key = camera.frame.T @ [-0.55, 0.55, -0.65] + 0.75 * self.up
        self.key = (key / np.linalg.norm(key)).astype(np.float32)

    def sun(self, normal: Rays) -> Rays:
        """(n,) Share of the key light that each surface receives: Lambert's cosine."""
        return np.asarray(np.maximum(normal @ self.key, 0))

    def shade(self, normal: Rays, rays: Rays, sky: Rays, key: Rays) -> Rays:
        """(n,) Light that each surface sends to the eye; 1 is white."""
        dome = 0.78 + 0.22 * (normal @ self.up)
        facing = np.abs((normal * rays).sum(axis=1))
        return np.asarray(0.56 * dome * sky + 0.52 * self.sun(normal) * key + 0.06 * facing)

    def shine(self, normal: Rays, rays: Rays, key: Rays) -> Rays:
        """(n,) Specular reflection of the key light."""
        half = self.key - rays
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        return np.asarray(0.10 * key * np.maximum((normal * half).sum(axis=1), 0) ** 40)

    def trace(self, rays: Rays) -> dict[str, Any]:
        """Follow rays to their first opaque surface and collect the translucent ones before it.

        Returns:
            ``front`` (n, 3): light from the translucent layers. ``through`` (n,): fraction of light that they
            transmit. ``shape`` (n,): index of the opaque shape, -2 for the floor, -1 for the background.
            ``point`` and ``normal`` (n, 3): point and unit normal of the opaque surface.
        """
        n = len(rays)
        front, through = np.zeros((n, 3), np.float32), np.ones(n, np.float32)
        shape = np.full(n, -1)
        point, normal = np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32)
        covered = np.zeros((n, len(self.alpha)), bool) if (self.alpha < 1).any() else None
        alive, origin = np.arange(n), np.broadcast_to(self.eye, (n, 3)).astype(np.float32)
        for _ in range(MAX_LAYERS):
            hit = self.all.run(origin, rays[alive], query="INTERSECT", output=1)
            found = hit["geomID"] >= 0
            alive, origin = alive[found], origin[found]
            hit = {k: v[found] for k, v in hit.items()}
            which = hit["geomID"]
            origin = origin + hit["tfar"][:, None] * rays[alive]
            u, v = hit["u"][:, None], hit["v"][:, None]
            corners = self.normals[self.first[which] + hit["primID"]]
            across = corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v
            across /= np.linalg.norm(across, axis=1, keepdims=True)
            across *= np.where((hit["Ng"] * rays[alive]).sum(1) > 0, -1, 1)[
                :, None
            ]  # surfaces are lit on both sides
            solid = self.alpha[which] == 1
            done = alive[solid]
            shape[done], point[done], normal[done] = which[solid], origin[solid], across[solid]
            if solid.all() or covered is None:
                break
            alive, origin, which, across = alive[~solid], origin[~solid], which[~solid], across[~solid]
            alpha = np.where(covered[alive, which], 0, self.alpha[which])
            covered[alive, which] = True
            ones = np.ones(len(alive), np.float32)
            light = np.where(self.lit[which], self.shade(across, rays[alive], ones, ones), 1)
            front[alive] += (through[alive] * alpha * light)[:, None] * self.colour[which]
            through[alive] *= 1 - alpha
            origin = origin + 1e-5 * rays[alive]
        if self.floor is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                reach = (self.floor - self.eye @ self.up) / (rays @ self.up)
            floor = (shape == -1) & (reach > 0) & (self.eye @ self.up > self.floor)
            shape[floor] = -2
            point[floor], normal[floor] = self.eye + reach[floor, None] * rays[floor], self.up
        return {"front": front, "through": through, "shape": shape, "point": point, "normal": normal}

    def light(self, hit: dict[str, Any], phase: IntArray) -> Rays:
        """(n, 2) Fractions of sky and key light that opaque shapes let through to each hit."""
        shares = np.ones((len(phase), 2), np.float32)
        shape = hit["shape"]
        at = np.flatnonzero((shape == -2) | ((shape >= 0) & self.lit[np.maximum(shape, 0)]))
        if not (self.has_opaque and len(at)):
            return shares
        table = hemisphere(DIRECTIONS).astype(np.float32)
        normal = hit["normal"][at]
        start = hit["point"][at] + 2e-4 * normal
        x, y = tangents(normal)
        across, along = tangents(self.key[None])
        for j in range(LIGHT_RAYS):
            local = table[(phase[at] * LIGHT_RAYS + j) % DIRECTIONS]
            upward = local[:, :1] * x + local[:, 1:2] * y + local[:, 2:] * normal
            disc = 0.16 * (local[:, :1] * across + local[:, 1:2] * along) + self.key
            for i, ray, reach in ((0, upward, 0.45), (1, disc, 4.0)):
                far = np.full(len(at), reach, np.float32)
                blocked = self.opaque.run(start, ray, dists=far, query="OCCLUDED")
                shares[at, i] -= (blocked >= 0) / np.float32(LIGHT_RAYS)
        return shares

    def mix(self, hit: dict[str, Any], rays: Rays, behind: Rays, light: Rays) -> Rays:
        """(n, 3) Linear light that each ray brings to the eye; ``behind`` (n, 3) is the background's."""
        colour, shape = behind.copy(), hit["shape"]
        floor, solid = shape == -2, shape >= 0
        colour[floor] *= light[floor] @ np.array([[0.315], [0.435]], np.float32) + 0.25
        plain, lit = self.colour[shape[solid]], self.lit[shape[solid], None]
        normal, ray, (sky, key) = hit["normal"][solid], rays[solid], light[solid].T
        shaded = self.shade(normal, ray, sky, key)[:, None] * plain + self.shine(normal, ray, key)[:, None]
        colour[solid] = np.where(lit, shaded, plain)
        return np.asarray(hit["front"] + hit["through"][:, None] * colour, dtype=np.float32)


def visible(shapes: Sequence[Shape], camera: Camera, points: Array) -> BoolArray:
    """(n,) Whether no opaque lit shape hides each point (n, 3); the surface it lies on does not count."""
    scene = _Scene(shapes, camera, None)
    if not scene.has_opaque:
        return np.ones(len(points), dtype=np.bool_)
    rays = (np.asarray(points) - scene.origin) / scene.scale - scene.eye
    reach = np.linalg.norm(rays, axis=1)
    start = np.broadcast_to(scene.eye, rays.shape).astype(np.float32)
    unit = (rays / reach[:, None]).astype(np.float32)
    far = (reach - 0.02).astype(np.float32)  # the surface that a point lies on does not hide it
    return np.asarray(scene.opaque.run(start, unit, dists=far, query="OCCLUDED") < 0)


def render(
    shapes: Sequence[Shape],
    camera: Camera,
    size: tuple[int, int] = (900, 900),
    *,
    samples: int = 3,
    background: tuple[Colour, Colour] = (SKY_TOP, SKY_BOTTOM),
    ground: float | None = None,
) -> Image:
    """Draw shapes.

    1. Every pixel gets one ray, and its light is averaged over neighbours that show the same surface.
    2. Pixels at edges get ``samples`` × ``samples`` rays instead. An edge is where a pixel differs from a
       neighbour in a picture without shadows.

    Args:
        shapes: Shapes to draw; at least one.
        camera: The camera.
        size: Width and height [pixels].
        samples: Rays along each side of a supersampled pixel.
        background: Colours at the picture's top and bottom.
        ground: Height of the floor along the camera's ``up`` [m]; ``None`` for no floor.

    Returns:
        (height, width, 3) Red, green and blue, each 0..255.

    Raises:
        InputError: There are no shapes, or the size or the number of samples is below 1.
    """
    width, height = size
    if not shapes or min(width, height, samples) < 1:
        raise InputError("a picture needs at least one shape, one pixel and one sample")
    scene = _Scene(shapes, camera, ground)
    ends = to_linear(np.array(background))
    y, x = (axis.ravel() for axis in np.mgrid[:height, :width])
    centres = np.column_stack([x, y]) + 0.5

    def cast(pixels: Array) -> tuple[dict[str, Any], Rays, Rays]:
        rays = directions(camera, pixels, size).astype(np.float32)
        share = (pixels[:, 1:] / height).astype(np.float32)
        return scene.trace(rays), rays, ends[0] * (1 - share) + ends[1] * share

    hit, rays, behind = cast(centres)
    # Each of 4 × 4 neighbouring pixels uses other directions; together they cover the hemisphere evenly.
    # 8 × 8 pixels use the whole table.
    light = scene.light(hit, x % 4 + 4 * (y % 4) + 16 * (x // 4 % 2 + 2 * (y // 4 % 2)))
    for stride in (1, 2):
        light = guarded_blur(light, hit["shape"], hit["point"], hit["normal"], (height, width), stride)
    image = scene.mix(hit, rays, behind, light)
    if samples > 1:
        even = to_display(
            scene.mix(hit, rays, behind, np.ones_like(light))
        )  # shadows are soft and need no more samples
        edge = np.flatnonzero(_edges(even.reshape(height, width, 3)))
        total = np.zeros((len(edge), 3), np.float32)
        for k in range(samples**2):
            inside = (np.array([k % samples, k // samples]) + 0.5) / samples - 0.5
            hit, rays, behind = cast(centres[edge] + inside)
            total += scene.mix(hit, rays, behind, scene.light(hit, np.full(len(edge), k)))
        image[edge] = total / samples**2
    return np.round(to_display(image) * 255).astype(np.uint8).reshape(height, width, 3)


def _edges(image: Rays) -> BoolArray:
    """(h, w) Whether a pixel differs visibly from one of its four neighbours."""
    result = np.zeros(image.shape[:2], dtype=np.bool_)
    down = (np.abs(np.diff(image, axis=0)) > EDGE).any(axis=2)
    across = (np.abs(np.diff(image, axis=1)) > EDGE).any(axis=2)
    result[:-1] |= down
    result[1:] |= down
    result[:, :-1] |= across
    result[:, 1:] |= across
    return result
