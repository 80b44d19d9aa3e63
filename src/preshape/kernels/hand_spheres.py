"""Spheres that fill a rigid link; its distance to an object is then the least distance of a sphere.

No sphere protrudes from the link, and the link protrudes from the spheres by a limited length.

1. A capsule is filled by a row of spheres of its own radius.
2. A box is filled by rows of spheres along the edges of ever smaller boxes inside it: small spheres near its
   edges, larger ones farther inside, the largest in the middle.
3. A convex polyhedron is filled by :mod:`preshape.kernels.hull_spheres`.
4. Spheres are left out if they cover only surface that lies inside another shape of the link. At coarse
   detail, a small subset of the spheres that covers the surface is chosen (greedy set cover).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..types import Array, BoolArray
from .hull_spheres import Polyhedron, polyhedron_spheres, polyhedron_surface

COARSE, FINE = 0.003, 0.0005
"""Largest protrusion of a link from its spheres [m], in the search and in the final answers [C]."""
_CAPSULE = {COARSE: 0.0006, FINE: 0.00012}  # ... of a capsule [m]
_BOX = {
    COARSE: 0.0026,
    FINE: 0.00045,
}  # ... of a box [m]; a reserve is left for the surface between the samples
_HULL, _HULL_SAMPLES = {COARSE: 0.0025, FINE: 0.00036}, {COARSE: 0.0017, FINE: 0.00065}
"""Limit for the spheres of a polyhedron, met at samples that are this far apart [m]."""
_SAMPLES = {COARSE: 0.002, FINE: 0.0008}  # spacing of surface points [m]


class LinkSolid(NamedTuple):
    """A capsule, a sphere (a capsule of no length), a box or a convex polyhedron, in its link's frame.

    Attributes:
        place: (3,) its centre [m].
        facing: (3, 3) its axes as columns; a capsule lies along the third.
        radius: Radius of a capsule [m]; 0 for a box and a polyhedron.
        half: (3,) half sizes of a box, or (0, 0, half length) of a capsule [m].
        hull: The polyhedron in its own frame; ``None`` for the others.
    """

    place: Array
    facing: Array
    radius: float
    half: Array
    hull: Polyhedron | None = None

    @property
    def flat(self) -> bool:
        """Whether it has flat faces with edges: a box or a polyhedron."""
        return self.hull is not None or self.radius == 0.0

    def distance(self, points: Array) -> Array:
        """(n,) signed distance from points (n, 3) to its surface, negative inside [m].

        Outside a polyhedron it is the distance to the farthest of the planes that a point is beyond.
        """
        if self.hull is not None:
            return -self.hull.depth((points - self.place) @ self.facing)
        local = np.abs((points - self.place) @ self.facing)
        out = local - self.half
        inside = np.minimum(out.max(axis=1), 0.0) if self.radius == 0.0 else 0.0
        return np.asarray(np.linalg.norm(np.maximum(out, 0.0), axis=1) + inside - self.radius)

    def moved(self, spheres: Array) -> Array:
        """Spheres (n, 4) or points (n, 3) of the shape's own frame in the link's frame."""
        return np.concatenate([spheres[:, :3] @ self.facing.T + self.place, spheres[:, 3:]], axis=1)


def link_spheres(shapes: list[LinkSolid], detail: float) -> Array:
    """Spheres that represent a link.

    Args:
        shapes: All shapes of the link.
        detail: ``COARSE`` or ``FINE``.

    Returns:
        (n, 4) centre in the link's frame and radius [m].
    """
    if not shapes:
        return np.zeros((0, 4))
    spheres = np.concatenate([shape.moved(_filled(shape, detail)) for shape in shapes])
    points, allowed = exposed(shapes, detail)
    if detail == FINE:
        return spheres[_near(spheres, points, float(allowed.max()))]
    from scipy.spatial.distance import cdist

    gap = cdist(spheres[:, :3], points) - spheres[:, 3:]
    # A point that is not near enough to any sphere counts as covered by the nearest one.
    return spheres[_cover(gap <= np.maximum(allowed, gap.min(axis=0) + 1e-6))]


def exposed(shapes: list[LinkSolid], detail: float, spacing: float | None = None) -> tuple[Array, Array]:
    """(n, 3) points on the surface of a link [m], and (n,) the largest protrusion allowed at each [m]."""
    points, allowed = [], []
    for shape in shapes:
        own = shape.moved(_surface(shape, spacing or _SAMPLES[detail]))
        bare = np.ones(len(own), dtype=bool)
        for other in shapes:
            if other is not shape:
                bare &= other.distance(own) > -1e-9
        points.append(own[bare])
        allowed.append(np.full(int(bare.sum()), _BOX[detail] if shape.flat else _CAPSULE[detail]))
    return np.concatenate(points), np.concatenate(allowed)


def grouped(spheres: Array, most: int) -> list[Array]:
    """Spheres in groups of neighbours, at most ``most`` in each."""
    if len(spheres) <= most:
        return [spheres] if len(spheres) else []
    axis = int(np.ptp(spheres[:, :3], axis=0).argmax())
    order = np.argsort(spheres[:, axis], kind="stable")
    half = len(order) // 2
    return grouped(spheres[order[:half]], most) + grouped(spheres[order[half:]], most)


def bound(spheres: Array) -> Array:
    """(4,) a sphere round all of the spheres (n, 4): centre and radius [m]."""
    low, high = spheres[:, :3] - spheres[:, 3:], spheres[:, :3] + spheres[:, 3:]
    middle = (low.min(axis=0) + high.max(axis=0)) / 2
    return np.append(middle, (np.linalg.norm(spheres[:, :3] - middle, axis=1) + spheres[:, 3]).max())


def _filled(shape: LinkSolid, detail: float) -> Array:
    """(n, 4) spheres of one shape in its own frame."""
    if shape.hull is not None:
        return polyhedron_spheres(shape.hull, _HULL[detail], _HULL_SAMPLES[detail])
    if shape.radius == 0.0:
        return _box_spheres(shape.half, _BOX[detail])
    # Between two spheres of radius r a capsule protrudes by about step²/8r.
    step = float(np.sqrt(8.0 * shape.radius * _CAPSULE[detail]))
    z = _spread(shape.half[2], step)
    return np.stack([np.zeros_like(z), np.zeros_like(z), z, np.full_like(z, shape.radius)], axis=1)


def _spread(half: float, step: float) -> Array:
    """Evenly spaced points from -half to half, at most ``step`` apart."""
    return np.linspace(-half, half, int(np.ceil(2 * half / step - 1e-9)) + 1) if half > 1e-6 else np.zeros(1)


def _box_spheres(half: Array, protrusion: float) -> Array:
    """(n, 4) spheres in a box that protrudes from them by at most about ``protrusion`` [m]."""
    out = []
    largest = float(half.min())
    # A corner protrudes from its sphere by 0.73 radii.
    radius = min(1.5 * protrusion, largest)
    while True:
        # Radius of the part of a face that a sphere of this radius covers.
        covered = float(np.sqrt(2 * radius * protrusion + protrusion * protrusion))
        inner = half - radius
        axes = [_spread(h, 1.2 * covered) for h in inner]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        on = (np.abs(np.abs(grid) - inner) < 1e-9).sum(axis=1)
        centres = grid[on >= (1 if radius == largest else 2)]
        out.append(np.concatenate([centres, np.full((len(centres), 1), radius)], axis=1))
        if radius == largest:
            return np.concatenate(out)
        # Rows with spheres 1.2 of these radii apart cover a strip of 0.8 of them to both sides; the strip of
        # the next row must join this one.
        edge, following = radius + 0.8 * covered, radius
        for _ in range(20):
            following = edge + 0.8 * float(np.sqrt(2 * following * protrusion + protrusion * protrusion))
        radius = min(following, largest)


def _surface(shape: LinkSolid, spacing: float) -> Array:
    """(n, 3) points on the surface of one shape in its own frame, edges and corners included."""
    if shape.hull is not None:
        return polyhedron_surface(shape.hull, spacing)[0]
    if shape.radius == 0.0:
        axes = [_spread(h, spacing) for h in shape.half]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return grid[(np.abs(np.abs(grid) - shape.half) < 1e-9).any(axis=1)]
    r, length = shape.radius, float(shape.half[2])
    bends = _spread(np.pi / 2, spacing / r)
    profile = np.concatenate(
        [
            np.stack([r * np.cos(bends), r * np.sin(bends) + np.sign(bends) * length], axis=1),
            np.stack([np.full(len(z := _spread(length, spacing)), r), z], axis=1),
        ]
    )
    angles = np.linspace(0.0, 2 * np.pi, max(6, int(np.ceil(2 * np.pi * r / spacing))), endpoint=False)
    across, along = profile[:, :1], np.repeat(profile[:, 1:], len(angles), axis=1)
    return np.stack([across * np.cos(angles), across * np.sin(angles), along], axis=2).reshape(-1, 3)


def _near(spheres: Array, points: Array, within: float) -> BoolArray:
    """(n,) which spheres have one of the points within a distance of their surface [m]."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(points).query(spheres[:, :3])
    return np.asarray(distance <= spheres[:, 3] + within)


def _cover(covers: BoolArray) -> list[int]:
    """Rows (spheres) that together cover every column (point), by greedy choice of the row that adds most."""
    chosen: list[int] = []
    left = covers.any(axis=0)
    gains = covers[:, left].sum(axis=1)
    while left.any():
        best = int(gains.argmax())
        fresh = covers[best] & left
        chosen.append(best)
        left &= ~fresh
        gains -= covers[:, fresh].sum(axis=1)
    return sorted(chosen)
