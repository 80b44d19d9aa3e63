"""Functions that make the shapes of the library objects: sections, solids, and the final arrays.

Lengths in this package are in **millimetres**; :func:`finish` converts a solid to metres. A section is a flat
region (``manifold3d.CrossSection``), a solid is a closed volume (``manifold3d.Manifold``). ``+`` is their
union, ``-`` their difference, ``^`` their intersection.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ...types import Array, IntArray

if TYPE_CHECKING:
    from manifold3d import CrossSection as Section
    from manifold3d import Manifold as Solid

SEGMENTS = 64
"""Default number of straight segments in a full turn."""

_ARC = 24  # segments in a full turn of a rounded corner
_CHORD = 8e-3  # deviation below which points of a section are dropped [mm]
_SLIVER = 5e-3  # deviation below which vertices of a solid are dropped [mm]


def section(points: ArrayLike, rounding: float = 0.0) -> Section:
    """The region inside a closed polygon, with convex and concave corners rounded.

    Args:
        points: (n, 2) corners in either order of rotation [mm].
        rounding: Radius of the corners [mm]; parts thinner than twice the radius vanish.
    """
    from manifold3d import CrossSection, FillRule

    region = CrossSection([np.asarray(points, dtype=np.float64)], FillRule.EvenOdd)
    return rounded(region, rounding)


def rounded(region: Section, radius: float) -> Section:
    """``region`` with rounded corners [mm]: shrink and grow for convex, grow and shrink for concave ones."""
    if radius == 0.0:
        return region
    return grown(grown(grown(region, -radius), 2 * radius), -radius).simplify(_CHORD)


def grown(region: Section, distance: float) -> Section:
    """``region`` with its border moved outward by ``distance`` [mm]; new corners are round."""
    from manifold3d import JoinType

    return region.offset(distance, JoinType.Round, 2.0, _ARC)


def disc(radius: float, centre: tuple[float, float] = (0.0, 0.0), segments: int = SEGMENTS) -> Section:
    """A regular polygon about ``centre`` with its corners at ``radius`` [mm], the first one along +x."""
    angle = 2 * np.pi * np.arange(segments) / segments
    return section(np.column_stack([np.cos(angle), np.sin(angle)]) * radius + np.asarray(centre))


def lobed(radius: float, depth: float, lobes: int, per_lobe: int = 8) -> Section:
    """A disc whose edge has ``lobes`` waves between ``radius - depth`` and ``radius`` [mm], as on a grip."""
    angle = 2 * np.pi * np.arange(lobes * per_lobe) / (lobes * per_lobe)
    r = radius - depth * (1 - np.cos(lobes * angle)) / 2
    return section(np.column_stack([r * np.cos(angle), r * np.sin(angle)]))


def rectangle(width: float, height: float, rounding: float = 0.0) -> Section:
    """A rectangle about the origin [mm]."""
    x, y = width / 2, height / 2
    return section([(-x, -y), (x, -y), (x, y), (-x, y)], rounding)


def curve(points: ArrayLike, per_span: int = 8) -> Array:
    """A smooth curve through points: a centripetal Catmull-Rom spline, which neither loops nor overshoots.

    Args:
        points: (n, d) points in order, with different neighbours [mm].
        per_span: Number of segments between two neighbouring points.

    Returns:
        (m, d) points [mm].
    """
    p = np.asarray(points, dtype=np.float64)
    p = np.vstack([2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]])
    p0, p1, p2, p3 = (p[i : len(p) - 3 + i, None, :] for i in range(4))
    knots = [np.zeros((len(p) - 3, 1, 1))]
    for a, b in ((p0, p1), (p1, p2), (p2, p3)):
        knots.append(knots[-1] + np.sqrt(np.linalg.norm(b - a, axis=-1, keepdims=True)))
    t0, t1, t2, t3 = knots
    t = t1 + (t2 - t1) * (np.arange(per_span) / per_span)[None, :, None]

    def blend(a: Array, b: Array, start: Array, end: Array) -> Array:
        mixed: Array = (a * (end - t) + b * (t - start)) / (end - start)
        return mixed

    a1, a2, a3 = blend(p0, p1, t0, t1), blend(p1, p2, t1, t2), blend(p2, p3, t2, t3)
    smooth = blend(blend(a1, a2, t0, t2), blend(a2, a3, t1, t3), t1, t2).reshape(-1, p.shape[1])
    return np.vstack([smooth, p[-2]])


def revolved(profile: ArrayLike | Section, rounding: float = 0.0, segments: int = SEGMENTS) -> Solid:
    """A solid of revolution about +z.

    Args:
        profile: (n, 2) radius and height of the outline, from one point on the axis to another [mm]; it is
            mirrored, so that corners on the axis stay sharp. Alternatively a section, of which the half with
            x > 0 is used.
        rounding: Radius of the corners of the profile [mm].
        segments: Number of flat segments around the axis.
    """
    if not hasattr(profile, "revolve"):
        half = np.asarray(profile, dtype=np.float64)
        profile = section(np.vstack([half, half[::-1] * (-1, 1)]), rounding)
    return profile.revolve(segments)


def extruded(region: Section, height: float, bevel: float = 0.0) -> Solid:
    """A prism over ``region`` from z = 0 to ``height`` [mm].

    Args:
        region: Section, which may have holes.
        height: Height along +z [mm].
        bevel: Radius of the rounded upper and lower edges [mm]; it must be smaller than the radius of the
            section's convex corners.
    """
    if bevel == 0.0:
        return region.extrude(height)
    from manifold3d import triangulate

    loops = [np.asarray(loop) for loop in region.to_polygons()]
    inward = np.vstack([_miter(loop) for loop in loops])
    angle = np.linspace(0, np.pi / 2, 4)
    inset, drop = bevel * (1 - np.sin(angle)), bevel * (1 - np.cos(angle))
    lower = [(d, z) for d, z in zip(inset, drop, strict=True)]
    levels = [*lower, *[(d, height - z) for d, z in reversed(lower)]]
    flat = np.vstack(loops)
    rings = np.array([np.column_stack([flat + d * inward, np.full(len(flat), z)]) for d, z in levels])
    first = np.cumsum([0, *[len(loop) for loop in loops]])
    tips = [rings[0, a:b, :2] for a, b in pairwise(first)]
    return _skin(rings, np.diff(first), np.asarray(triangulate(tips), dtype=np.int64))


def _miter(loop: Array) -> Array:
    """(n, 2) step of each corner of a counter-clockwise loop that moves both of its sides inward by 1."""
    side = np.roll(loop, -1, axis=0) - loop
    normal = np.column_stack([-side[:, 1], side[:, 0]]) / np.linalg.norm(side, axis=1, keepdims=True)
    both = normal + np.roll(normal, 1, axis=0)
    step: Array = both * 2 / np.maximum((both**2).sum(axis=1, keepdims=True), 0.5)
    return step


def lofted(rings: ArrayLike, *, closed: bool = False) -> Solid:
    """A solid over a sequence of rings, with flat caps at the ends.

    Args:
        rings: (k, n, 3) closed rings [mm]; the end rings must be flat and must not cross themselves.
        closed: Whether the last ring is joined to the first, as in a torus.
    """
    from manifold3d import triangulate

    levels = np.asarray(rings, dtype=np.float64)
    if closed:
        return _skin(np.concatenate([levels, levels[:1]]), [levels.shape[1]], None)
    centred = levels[0] - levels[0].mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    flat = centred @ axes[:2].T
    x, y = flat[:, 0], flat[:, 1]
    if (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() < 0:
        flat[:, 1] *= -1
    return _skin(levels, [levels.shape[1]], np.asarray(triangulate([flat]), dtype=np.int64))


def _skin(levels: Array, counts: Sequence[int] | IntArray, cap: IntArray | None) -> Solid:
    """Join neighbouring levels loop by loop, cap both ends, and orient the triangles outward."""
    from manifold3d import Manifold, Mesh64

    k, n = levels.shape[:2]
    start = np.concatenate(
        [np.arange(c) + s for c, s in zip(counts, np.cumsum(counts) - counts, strict=True)]
    )
    after = np.concatenate(
        [np.roll(np.arange(c), -1) + s for c, s in zip(counts, np.cumsum(counts) - counts, strict=True)]
    )
    a, b = (np.add.outer(n * np.arange(k - 1), ring) for ring in (start, after))
    side = np.stack([np.stack([a, b, b + n], -1), np.stack([a, b + n, a + n], -1)], 2).reshape(-1, 3)
    points = levels.reshape(-1, 3)
    if cap is None:
        points, side = points[:-n], side % ((k - 1) * n)
        triangles = side
    else:
        triangles = np.vstack([side, cap[:, ::-1], cap + n * (k - 1)])
    corners = points[triangles]
    if np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0:
        triangles = triangles[:, ::-1]
    return Manifold(Mesh64(np.ascontiguousarray(points), np.ascontiguousarray(triangles, dtype=np.uint64)))


def tube(path: ArrayLike, radii: ArrayLike, *, up: ArrayLike = (0, 1, 0), segments: int = 24) -> Solid:
    """A round or elliptic rod along a path.

    Args:
        path: (k, 3) points in order [mm].
        radii: One radius, (k,) radii, or (k, 2) radii across and along ``up`` [mm].
        up: Direction that is nowhere tangent to the path; for a flat path its normal.
        segments: Number of segments around the rod.
    """
    p = np.asarray(path, dtype=np.float64)
    r = np.asarray(radii, dtype=np.float64)
    r = np.broadcast_to(r[:, None] if r.ndim == 1 else r, (len(p), 2))
    tangent = np.gradient(p, axis=0)
    across = np.cross(tangent, np.asarray(up, dtype=np.float64))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    rise = np.cross(across, tangent)
    rise /= np.linalg.norm(rise, axis=1, keepdims=True)
    angle = 2 * np.pi * np.arange(segments) / segments
    ring = r[:, None, :] * np.column_stack([np.cos(angle), np.sin(angle)])
    return lofted(p[:, None] + ring[..., :1] * across[:, None] + ring[..., 1:] * rise[:, None])


def ball(radius: float, segments: int = SEGMENTS) -> Solid:
    """A sphere about the origin [mm]."""
    from manifold3d import Manifold

    return Manifold.sphere(radius, segments)


def block(x: float, y: float, z: float) -> Solid:
    """A plain box of 12 triangles about the origin [mm]."""
    from manifold3d import Manifold

    return Manifold.cube([x, y, z], True)


def finish(solid: Solid) -> tuple[Array, IntArray, Array]:
    """The arrays of a solid, centred on its bounding box and without slivers under 5 µm.

    Returns:
        (n, 3) vertices [m], (m, 3) outward triangles, and (3,) their origin in the solid's frame [m].
    """
    mesh = solid.as_original().simplify(_SLIVER).to_mesh64()
    points = np.array(mesh.vert_properties[:, :3], dtype=np.float64)
    triangles = np.array(mesh.tri_verts, dtype=np.int64)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return (points - middle) / 1000.0, triangles, middle / 1000.0
