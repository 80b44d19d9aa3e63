"""Where contacts may be: the rules asked about points, and the part of the surface that they leave."""

from __future__ import annotations

import math

import numpy as np

from ..kernels.field.host import SurfaceQuery
from ..objects.mesh import TriangleMesh
from ..objects.parts import PartSurface
from ..types import Array, BoolArray, IntArray, value
from .rules import KEEP_OFF, ContactRules

ON_PART = 0.0005
"""Largest distance from the parts to hold of a point that is on them [m] [C]."""
SAMPLES, MOST_DRAWN = 1500, 60_000
"""Number of allowed points of the surface that are wanted, and of points drawn to find them [C]."""
_FIRST = 4000


class ContactPlaces:
    """The rules about contacts, for points of one object.

    Args:
        rules: The rules.
        device: ``cpu`` or a CUDA device's name.

    Attributes:
        names: Each rule in words, in the order of the columns of :meth:`broken`.
        kept_off: The parts to keep off.
    """

    def __init__(self, rules: ContactRules, device: str = "cpu") -> None:
        self.names = rules.names
        self._hold = [PartQuery(part, device) for part in rules.hold_on]
        self.kept_off = tuple(PartQuery(part, device) for part in rules.keep_off)

    def __len__(self) -> int:
        return len(self.names)

    def broken(self, points: Array, *, slack: float = 0.0) -> BoolArray:
        """Which rules a contact at each point would break.

        Args:
            points: (n, 3) in the mesh frame [m].
            slack: Accuracy of the points: with it, points beside the parts to hold count as on them [m].

        Returns:
            (n, m) for each of the m rules of ``names``.
        """
        columns = []
        if self._hold:
            near = [part.nearer(points, ON_PART + slack) for part in self._hold]
            columns.append(~np.any(near, axis=0))
        columns += [part.nearer(points, KEEP_OFF) for part in self.kept_off]
        return np.stack(columns, axis=1) if columns else np.zeros((len(points), 0), dtype=bool)

    def broken_by(self, points: Array, counts: IntArray, *, slack: float = 0.0) -> BoolArray:
        """(n, m) which rules n hands break; of their contacts (n, c, 3) [m] ``counts`` are in use."""
        found = np.zeros((len(points), len(self)), dtype=bool)
        if len(self) and len(points):
            used = np.arange(points.shape[1]) < counts[:, None]
            rows = np.nonzero(used)[0]
            np.logical_or.at(found, rows, self.broken(points[used], slack=slack))
        return found


class PartQuery:
    """Exact tests of nearness to one part.

    Args:
        part: The part.
        device: ``cpu`` or a CUDA device's name.

    Attributes:
        mesh: The part's triangles.
        solid: Whether its inside belongs to it.
        beside: Whether it stays where it is when the object is lifted.
    """

    def __init__(self, part: PartSurface, device: str = "cpu") -> None:
        self.mesh, self.solid, self.beside = part_mesh(part), part.solid, part.beside
        self._query = SurfaceQuery(self.mesh, device=device)

    def nearer(self, points: Array, than: float) -> BoolArray:
        """(n,) whether points (n, 3) [m] are within ``than`` [m] of the part, or inside a volume."""
        low, high = self.mesh.bounds[0] - than, self.mesh.bounds[1] + than
        near = ((points >= low) & (points <= high)).all(axis=1)
        within = math.inf if self.solid else 1.01 * than
        found = self._query.closest(points[near], within=within).distance
        near[near] = (found if self.solid else np.abs(found)) < than
        return near


def part_mesh(part: PartSurface) -> TriangleMesh:
    """The triangles of a part as a mesh."""
    return TriangleMesh(name="part", vertices=part.vertices, triangles=part.triangles)


@value
class AllowedSurface:
    """The part of an object's surface that the rules leave for contacts, as n points spread by area.

    Attributes:
        points: (n, 3) [m].
        triangle: (n,) triangle of the object that each lies on.
    """

    points: Array
    triangle: IntArray

    def __len__(self) -> int:
        return len(self.points)

    @property
    def box(self) -> Array:
        """(2, 3) lower and upper corner of the points' bounding box [m]."""
        return np.stack([self.points.min(axis=0), self.points.max(axis=0)])


def allowed_surface(mesh: TriangleMesh, places: ContactPlaces, seed: int = 0) -> AllowedSurface:
    """Points of the surface at which contacts may be; none of them on a lid, which nothing can touch.

    Points are drawn by area over the whole surface, and more of them where the rules leave little, so that
    a small part has as many points as a large one, unless it is less than 3 % of the surface.

    Args:
        mesh: The object.
        places: The rules.
        seed: Seed of the draws; the same seed gives the same points.
    """
    rng = np.random.default_rng(seed)
    share = 1.0
    for drawn in (_FIRST, MOST_DRAWN):
        count = min(int(drawn), max(_FIRST, int(1.2 * SAMPLES / share)))
        points, triangle = surface_draws(mesh, rng, count)
        stays = np.flatnonzero(~places.broken(points).any(axis=1))
        if len(stays) >= SAMPLES:
            break
        share = max(len(stays), 1) / count
    stays = rng.permutation(stays)[:SAMPLES]
    return AllowedSurface(points=points[stays], triangle=triangle[stays])


def surface_draws(mesh: TriangleMesh, rng: np.random.Generator, count: int) -> tuple[Array, IntArray]:
    """(count, 3) random points of the surface [m], spread by area, and (count,) their triangles; no lids."""
    ends = np.cumsum(np.where(mesh.is_lid, 0.0, mesh.areas))
    at = (np.arange(count) + rng.random(count)) / count * ends[-1]
    face = np.minimum(np.searchsorted(ends, at, side="right"), len(ends) - 1)
    root, v = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    return np.einsum("nk,nkd->nd", weights, mesh.corners[face]), face
