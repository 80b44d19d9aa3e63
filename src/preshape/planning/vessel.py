"""The inside of a vessel and the space over its opening, found by pouring water into any mesh.

A point of the free space is inside if water there cannot flow away: every way from it to the surroundings
rises above it. That is the hull minus the solid as far as it is open upwards, but a dent in the rim or a
spout lowers it, and scans with uneven rims have an inside too.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..kernels.field.host import DistanceField, prepare_field
from ..objects.mesh import TriangleMesh
from ..objects.parts import PartSurface, part_pieces, surface_of
from ..objects.regions import AllOf, HalfSpace
from ..types import Array, BoolArray

CLEAR = 0.0025
"""The volume stays this far inside of the walls [m]: hands are kept 3 mm away from it, and must be able to
touch the outside of a thin wall [C]."""
OVER = 0.10
"""Height of the free space over the opening [m] [C]."""
LEAST_VOLUME, LEAST_DEPTH = 2e-6, 0.006
"""A hollow that holds less [m³], or is less deep [m], makes no vessel [C]."""
RIM_DEPTH, RIM_WIDTH = 0.003, 0.006
"""How far the rim reaches below the water's highest level, and the thickest wall that is a rim [m] [C]."""
_LEVEL = 0.95
"""Value between a node outside (0) and one inside (1) at which the surface of the volume runs."""


class Vessel(NamedTuple):
    """What stays free of a vessel that is poured from.

    Attributes:
        inside: Its inside and the space over its opening, as a solid.
        rim: The surface about its opening; ``None`` if there is none.
    """

    inside: PartSurface
    rim: PartSurface | None


def vessel(mesh: TriangleMesh, up: Array) -> Vessel | None:
    """The inside and the rim of a vessel; ``None`` if the mesh holds no water.

    1. Take the nodes of the distance field that lie farther than ``CLEAR`` from the surface, and farther than
       half a cell, so that no way between two of them leads through a wall.
    2. From the bottom up, mark what drains: in the part up to a height, everything that is connected with the
       border of the field.
    3. The rest is water. Leave out closed cavities and small hollows.
    4. Extend each pool's highest level upwards, over the opening.

    Args:
        mesh: The object [m].
        up: (3,) unit vector against gravity in the mesh frame; the nearest axis of the mesh counts.
    """
    field = prepare_field(mesh)
    axis = int(np.abs(up).argmax())
    flipped = bool(up[axis] < 0)
    distance = np.moveaxis(field.distance, axis, 2)
    free = (distance[:, :, ::-1] if flipped else distance) > max(CLEAR, field.spacing / 2)
    pools = _pools(free, field.spacing)
    if not pools:
        return None
    layers = int(np.ceil(OVER / field.spacing))
    volume = np.zeros((*free.shape[:2], free.shape[2] + layers), dtype=bool)
    rims = []
    for pool in pools:
        top = int(np.flatnonzero(pool.any(axis=(0, 1)))[-1])
        open_ = pool[:, :, top].copy()
        volume[:, :, : free.shape[2]] |= pool
        for k in range(top + 1, top + 1 + layers):
            if k < free.shape[2]:
                open_ &= free[:, :, k]
            volume[:, :, k] |= open_
        rims.append(_rim(mesh, field, pool[:, :, top], top, axis, flipped))
    found = [rim for rim in rims if rim is not None and len(rim)]
    rim = None
    if found:
        pieces = [part.vertices[part.triangles] for part in found]
        starts = np.cumsum([0, *(3 * len(piece) for piece in pieces)])
        rim = PartSurface(
            name="the rim",
            vertices=np.concatenate(pieces).reshape(-1, 3),
            triangles=np.concatenate([np.arange(a, b).reshape(-1, 3) for a, b in pairwise(starts)]),
        )
    return Vessel(inside=_surface(volume, field, axis, flipped), rim=rim)


def _pools(free: BoolArray, spacing: float) -> list[BoolArray]:
    """The pools of water that stay in the free nodes (nx, ny, nz), whose last axis is up."""
    from scipy.ndimage import label

    water = np.zeros_like(free)
    for k in range(free.shape[2]):
        parts, count = label(free[:, :, : k + 1])
        drains = np.zeros(count + 1, dtype=bool)
        for side in (parts[0], parts[-1], parts[:, 0], parts[:, -1], parts[:, :, 0]):
            drains[side] = True
        water[:, :, k] = free[:, :, k] & ~drains[parts[:, :, k]]
    every, _ = label(free)
    water &= every == every[0, 0, -1]  # closed cavities are not reached from above
    parts, count = label(water)
    pools = [parts == one for one in range(1, count + 1)]
    deep = [pool for pool in pools if pool.any(axis=(0, 1)).sum() * spacing >= LEAST_DEPTH]
    return [pool for pool in deep if pool.sum() * spacing**3 >= LEAST_VOLUME]


def _surface(volume: BoolArray, field: DistanceField, axis: int, flipped: bool) -> PartSurface:
    """The surface of a set of nodes, in the mesh frame."""
    from skimage.measure import marching_cubes

    padded = np.pad(volume.astype(np.float32), 1)
    points, triangles, _, _ = marching_cubes(padded, _LEVEL)  # type: ignore[no-untyped-call]
    points = np.asarray(points, dtype=np.float64) - 1
    if flipped:
        points[:, 2] = field.distance.shape[axis] - 1 - points[:, 2]
    vertices = np.insert(points[:, :2], axis, points[:, 2], axis=1) * field.spacing + field.origin
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    if np.einsum("ij,ij->", a, np.cross(b, c)) < 0:
        triangles = triangles[:, ::-1]
    return PartSurface(
        name="the inside and the space over the opening", vertices=vertices, triangles=triangles, solid=True
    )


def _rim(
    mesh: TriangleMesh, field: DistanceField, level: BoolArray, top: int, axis: int, flipped: bool
) -> PartSurface | None:
    """The surface of the object about the highest level of a pool.

    Args:
        mesh: The object [m].
        field: Its distance field.
        level: (nx, ny) nodes of the level.
        top: Index of the level along up.
        axis: The axis that is up or down.
        flipped: Whether it is down.
    """
    from scipy.spatial import ConvexHull, QhullError

    others = [k for k in range(3) if k != axis]
    flat = np.argwhere(level) * field.spacing + field.origin[others]
    try:
        hull = ConvexHull(flat)
    except QhullError:
        return None
    reach = CLEAR + field.spacing + RIM_WIDTH
    sides = []
    for a, b, c in hull.equations:  # a x + b y + c <= 0 within
        normal = np.zeros(3)
        normal[others] = -a, -b
        sides.append(HalfSpace(normal=normal, offset=float(c) - reach))
    sign = -1.0 if flipped else 1.0
    place = field.distance.shape[axis] - 1 - top if flipped else top
    height = sign * (field.origin[axis] + place * field.spacing)
    normal = sign * np.eye(3)[axis]
    sides.append(HalfSpace(normal=normal, offset=float(height) - CLEAR - RIM_DEPTH))
    sides.append(HalfSpace(normal=-normal, offset=-float(height) - CLEAR - RIM_DEPTH))
    return surface_of("the rim", part_pieces(mesh, AllOf(regions=tuple(sides))))
