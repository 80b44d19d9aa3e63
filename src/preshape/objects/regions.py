"""Regions of space, and the exact piece of a triangle surface that lies in one.

A region divides a surface in two: every triangle that crosses its border is cut there, so that the pieces
inside and outside cover the surface exactly once. Regions are combined with ``&``, ``|`` and ``-``.

``trimesh.intersections.slice_faces_plane`` cuts triangles too, but keeps one side only and does not say which
triangle a piece comes from, which groups and lids need.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError, shown
from ..types import Array, BoolArray, IntArray, freeze, frozen_array, positive_number, read_only, value

SIDES = 64
"""Number of sides of the prism that stands for a cylinder."""
NEAR = 1e-9
"""Distance from a border within which a corner lies on it [m]."""
LEAST_AREA = 1e-14
"""Pieces with less area come from rounding and are dropped [m²]."""


@value
class Pieces:
    """Triangles that were cut from a surface.

    Attributes:
        corners: (m, 3, 3) corners of each triangle [m].
        owners: (m,) index of the triangle of the surface that each comes from.
    """

    corners: Array
    owners: IntArray

    def of(self, chosen: BoolArray | IntArray) -> Pieces:
        """The pieces of a mask or of indices."""
        return Pieces(corners=self.corners[chosen], owners=self.owners[chosen])

    @property
    def crosses(self) -> Array:
        """(m, 3) normals with twice the areas as lengths [m²]."""
        a, b, c = (self.corners[:, k] for k in range(3))
        return np.asarray(np.cross(b - a, c - a))

    @property
    def area(self) -> float:
        """Total area [m²]."""
        return float(np.linalg.norm(self.crosses, axis=1).sum() / 2)


def joined(parts: Sequence[Pieces]) -> Pieces:
    """All pieces together."""
    return Pieces(
        corners=np.concatenate([part.corners for part in parts]),
        owners=np.concatenate([part.owners for part in parts]),
    )


class SurfaceRegion(ABC):
    """A set of points, or of triangles, of a surface."""

    __slots__ = ()

    @abstractmethod
    def split(self, pieces: Pieces) -> tuple[Pieces, Pieces]:
        """The pieces inside, and those outside."""

    @abstractmethod
    def moved(self, scale: float, offset: ArrayLike) -> SurfaceRegion:
        """The region of the points ``scale`` · p + ``offset`` (3,) [m] of its own points p."""

    def __and__(self, other: SurfaceRegion) -> SurfaceRegion:
        return AllOf(regions=(self, other))

    def __or__(self, other: SurfaceRegion) -> SurfaceRegion:
        return AnyOf(regions=(self, other))

    def __sub__(self, other: SurfaceRegion) -> SurfaceRegion:
        return AllOf(regions=(self, Outside(region=other)))


@value
class HalfSpace(SurfaceRegion):
    """The points p with normal · p ≥ offset.

    Attributes:
        normal: (3,) direction, of any length above zero; it is stored as a unit vector.
        offset: Distance of the border from the origin along the normal [m], times the normal's length.

    Raises:
        InputError: A number is not finite, or the normal has no direction.
    """

    normal: Array
    offset: float

    def __post_init__(self) -> None:
        normal = frozen_array(self.normal, (3,), "the normal of a half-space")
        offset = float(frozen_array(self.offset, (), "the offset of a half-space"))
        length = float(np.linalg.norm(normal))
        if not (np.isfinite(length) and length > 1e-12):
            raise InputError(f"the normal of a half-space needs a direction, got {normal.tolist()}")
        freeze(self, normal=read_only(normal / length), offset=offset / length)

    def split(self, pieces: Pieces) -> tuple[Pieces, Pieces]:
        """Cut at the plane; triangles in the plane are inside."""
        height = pieces.corners @ self.normal - self.offset
        height[np.abs(height) < NEAR] = 0.0
        above: BoolArray = np.asarray((height >= 0).all(axis=1))
        below: BoolArray = ~above & np.asarray((height <= 0).all(axis=1))
        crossing = ~above & ~below
        inside, outside = [pieces.of(above)], [pieces.of(below)]
        if crossing.any():
            h, owners = height[crossing], pieces.owners[crossing]
            single = (h > 0).sum(axis=1) == 1  # one corner is alone above; otherwise one is alone below
            lone = np.where(single, (h > 0).argmax(axis=1), (h < 0).argmax(axis=1))
            order = (lone[:, None] + np.arange(3)) % 3
            rows = np.arange(len(h))[:, None]
            a, b, c = np.moveaxis(pieces.corners[crossing][rows, order], 1, 0)
            ha, hb, hc = h[rows, order].T[:, :, None]
            ab, ac = a + (b - a) * ha / (ha - hb), a + (c - a) * ha / (ha - hc)
            tip = Pieces(corners=np.stack([a, ab, ac], axis=1), owners=owners)
            base = np.concatenate([np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)])
            rest = Pieces(corners=base, owners=np.concatenate([owners, owners]))
            twice = np.concatenate([single, single])
            inside += [tip.of(single), rest.of(~twice)]
            outside += [tip.of(~single), rest.of(twice)]
        return _proper(joined(inside)), _proper(joined(outside))

    def moved(self, scale: float, offset: ArrayLike) -> SurfaceRegion:
        """See :meth:`SurfaceRegion.moved`."""
        shift = float(self.normal @ np.asarray(offset, dtype=np.float64))
        return HalfSpace(normal=self.normal, offset=scale * self.offset + shift)


@value
class AllOf(SurfaceRegion):
    """What lies in each of several regions."""

    regions: tuple[SurfaceRegion, ...]

    def split(self, pieces: Pieces) -> tuple[Pieces, Pieces]:
        """Cut by one region after another."""
        outside = []
        for region in self.regions:
            pieces, out = region.split(pieces)
            outside.append(out)
        return pieces, joined(outside)

    def moved(self, scale: float, offset: ArrayLike) -> SurfaceRegion:
        """See :meth:`SurfaceRegion.moved`."""
        return AllOf(regions=tuple(region.moved(scale, offset) for region in self.regions))


@value
class AnyOf(SurfaceRegion):
    """What lies in any of several regions."""

    regions: tuple[SurfaceRegion, ...]

    def split(self, pieces: Pieces) -> tuple[Pieces, Pieces]:
        """Take what each region adds."""
        inside = []
        for region in self.regions:
            found, pieces = region.split(pieces)
            inside.append(found)
        return joined(inside), pieces

    def moved(self, scale: float, offset: ArrayLike) -> SurfaceRegion:
        """See :meth:`SurfaceRegion.moved`."""
        return AnyOf(regions=tuple(region.moved(scale, offset) for region in self.regions))


@value
class Outside(SurfaceRegion):
    """What does not lie in a region."""

    region: SurfaceRegion

    def split(self, pieces: Pieces) -> tuple[Pieces, Pieces]:
        """The two sides exchanged."""
        inside, outside = self.region.split(pieces)
        return outside, inside

    def moved(self, scale: float, offset: ArrayLike) -> SurfaceRegion:
        """See :meth:`SurfaceRegion.moved`."""
        return Outside(region=self.region.moved(scale, offset))


@value
class TriangleSet(SurfaceRegion):
    """Certain triangles of one mesh, such as those of a group in its file.

    Attributes:
        triangles: (k,) indices of the mesh's triangles.
    """

    triangles: IntArray

    def __post_init__(self) -> None:
        freeze(self, triangles=read_only(np.unique(np.asarray(self.triangles, dtype=np.int64))))

    def split(self, pieces: Pieces) -> tuple[Pieces, Pieces]:
        """Divide by the triangle that each piece comes from."""
        own = np.isin(pieces.owners, self.triangles)
        return pieces.of(own), pieces.of(~own)

    def moved(self, scale: float, offset: ArrayLike) -> SurfaceRegion:
        """The same triangles."""
        return self


@value
class Facing(SurfaceRegion):
    """The triangles that face a direction.

    Attributes:
        direction: (3,) unit vector.
        least: Least cosine between a triangle's normal and the direction.
    """

    direction: Array
    least: float

    def split(self, pieces: Pieces) -> tuple[Pieces, Pieces]:
        """Divide by the normals; no triangle is cut."""
        crosses = pieces.crosses
        facing = crosses @ np.asarray(self.direction) >= self.least * np.linalg.norm(crosses, axis=1)
        return pieces.of(facing), pieces.of(~facing)

    def moved(self, scale: float, offset: ArrayLike) -> SurfaceRegion:
        """The same directions."""
        return self


def box(low: ArrayLike, high: ArrayLike) -> SurfaceRegion:
    """An upright box from its lower and its upper corner, (3,) each [m].

    Raises:
        InputError: A number is not finite, or the lower corner is not below the upper.
    """
    lower, upper = (frozen_array(corner, (3,), "a corner of a box") for corner in (low, high))
    if not (lower < upper).all():
        raise InputError(
            f"a box is its lower corner, then its upper, got {[*lower.tolist(), *upper.tolist()]}"
        )
    axes = np.eye(3)
    sides = [HalfSpace(normal=axes[k], offset=float(lower[k])) for k in range(3)]
    sides += [HalfSpace(normal=-axes[k], offset=-float(upper[k])) for k in range(3)]
    return AllOf(regions=tuple(sides))


def cylinder(start: ArrayLike, end: ArrayLike, radius: float) -> SurfaceRegion:
    """A round bar between the middles of its ends, (3,) each [m]; a prism of 64 sides with the same volume.

    Raises:
        InputError: A number is not finite, the ends are at one point, or the radius is not positive.
    """
    p, q = (frozen_array(end_, (3,), "an end of a cylinder") for end_ in (start, end))
    reach = positive_number(radius, "the radius of a cylinder")
    axis = q - p
    length = float(np.linalg.norm(axis))
    if not length > NEAR:
        raise InputError(f"the ends of a cylinder must be apart, got {shown(p.tolist())} twice")
    axis = axis / length
    across = np.eye(3)[np.abs(axis).argmin()]
    u = np.cross(axis, across)
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    step = 2 * np.pi / SIDES
    flat = reach * np.sqrt(step / 2 / np.tan(step / 2))  # the prism's section has the circle's area
    sides = [HalfSpace(normal=axis, offset=float(axis @ p)), HalfSpace(normal=-axis, offset=-float(axis @ q))]
    for angle in step * np.arange(SIDES):
        inward = -(np.cos(angle) * u + np.sin(angle) * v)
        sides.append(HalfSpace(normal=inward, offset=float(inward @ p) - flat))
    return AllOf(regions=tuple(sides))


def beyond(axis: str, sign: str, limit: float) -> HalfSpace:
    """The half-space ``axis`` > ``limit`` or < ``limit`` [m].

    >>> beyond("z", "<", 0.05).normal.tolist(), beyond("z", "<", 0.05).offset
    ([0.0, 0.0, -1.0], -0.05)
    """
    direction = 1.0 if sign == ">" else -1.0
    normal = np.zeros(3)
    normal["xyz".index(axis)] = direction
    return HalfSpace(normal=normal, offset=direction * limit)


def _proper(pieces: Pieces) -> Pieces:
    """The pieces that have area."""
    kept = np.linalg.norm(pieces.crosses, axis=1) > 2 * LEAST_AREA
    return pieces if kept.all() else pieces.of(kept)
