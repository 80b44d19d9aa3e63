"""Convex pieces of a link: the hull of a mesh with few corners, or several where one would fill a hollow.

1. The mesh is sampled. If no point of its hull is farther than ``HOLLOW`` from a sample, it is the piece.
2. Else the space round the mesh is flooded from outside on a grid. Inner cavities and narrow slots, of which
   printed parts are full, are not reached by the flood and count as solid.
3. While a hull holds a hollow into which a ball of radius ``HOLLOW`` fits, and which has at least the share
   ``FILLED`` of its volume, its samples are cut by a plane, and each side gets a hull of its own. Of planes
   along the mesh's largest faces and principal axes, the one is taken that leaves the least volume.
4. Of a hull's corners only so many are kept that the others stand out of it by at most ``DEVIATION``.

This is not coacd, as for objects: coacd takes minutes for the printed parts of one hand and returns up to 50
pieces for a link, whose spheres would slow every search. Pieces are cached by the content of the mesh.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from ..files import cache_folder, keep_arrays, read_arrays
from ..types import Array, IntArray, value

DEVIATION = 0.3e-3
"""Distance by which a mesh stands out of its hull of few corners [m], if ``MOST_CORNERS`` suffice [C]."""
MOST_CORNERS = 64
_BATCH = 4
HOLLOW, FILLED = 5e-3, 0.15
"""Radius of a ball that fits into a hollow that matters [m]; its least share of the hull's volume [C]."""
MOST_PIECES = 6
THINNEST = 1e-3
"""Least thickness of a piece [m]; a flat mesh is given it, because a solid must have a volume [C]."""
_CELLS, _LEAST_CELL = 48, 1.5e-3  # cells along the largest extent; least size of a cell [m]
_WAYS, _CUTS = 5, 10  # directions of planes from the mesh's faces; planes in each direction
_ENOUGH = 500  # samples by which cuts are compared
_LEAST_GAIN = 0.02
"""Share of the hull's volume that a cut must save [C]."""
_FEW = 1000
"""Vertices of a mesh whose pieces are not cached, because they are computed as fast as read."""
_VERSION = 3
"""Increased whenever pieces are computed differently."""


@value
class LinkHull:
    """A convex polyhedron.

    Attributes:
        corners: (n, 3) [m].
        faces: (m, 3) triangles, which face outwards.
        planes: (k, 4) outward unit normal and offset [m]: a point x is inside if normal · x <= offset.
    """

    corners: Array
    faces: IntArray
    planes: Array

    @property
    def volume(self) -> float:
        """Volume [m³]."""
        a, b, c = self.corners[self.faces].transpose(1, 0, 2)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def hull(points: Array) -> LinkHull:
    """The convex hull of points (n, 3) [m] that are not in one plane."""
    from scipy.spatial import ConvexHull

    found = ConvexHull(points)
    corners = np.asarray(points, dtype=np.float64)[found.vertices]
    place = np.zeros(len(points), dtype=np.int64)
    place[found.vertices] = np.arange(len(corners))
    faces = place[found.simplices]
    a, b, c = corners[faces].transpose(1, 0, 2)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), found.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    planes = found.equations * [1.0, 1.0, 1.0, -1.0]
    _, first = np.unique(np.round(planes, 6), axis=0, return_index=True)
    return LinkHull(corners=corners, faces=faces, planes=planes[np.sort(first)])


def hulls(clouds: Sequence[Array]) -> list[LinkHull]:
    """The :func:`hull` of each of several point sets, from the cache if these were computed before."""
    state = hashlib.sha256(f"hulls {_VERSION}".encode())
    for points in clouds:
        state.update(repr(points.shape).encode() + np.ascontiguousarray(points).tobytes())
    file = cache_folder() / "hulls" / f"{state.hexdigest()[:40]}.npz"
    names = tuple(field.name for field in fields(LinkHull))
    with suppress(OSError, ValueError, KeyError, TypeError):
        stored = read_arrays(file)
        columns = [np.split(stored[name], stored[f"{name}_ends"]) for name in names]
        found = [LinkHull(**dict(zip(names, one, strict=True))) for one in zip(*columns, strict=True)]
        if len(found) == len(clouds):
            return found
    made = [hull(points) for points in clouds]
    if made:
        ends = {f"{name}_ends": np.cumsum([len(getattr(one, name)) for one in made])[:-1] for name in names}
        keep_arrays(
            file, **{name: np.concatenate([getattr(one, name) for one in made]) for name in names}, **ends
        )
    return made


def few_corners(points: Array) -> Array:
    """(k, 3) corners of a hull inside the hull of points (n, 3); see ``DEVIATION`` and ``MOST_CORNERS``.

    A point set that is thinner than ``THINNEST`` is thickened.
    """
    from scipy.spatial import ConvexHull, QhullError

    points = thickened(points)
    outer = points[ConvexHull(points).vertices]
    middle = outer.mean(axis=0)
    ways = np.concatenate([np.eye(3), -np.eye(3)])
    # The first corners are the extreme points along the principal axes.
    axes = np.linalg.svd(outer - middle, full_matrices=False)[2]
    chosen = list(dict.fromkeys(int(k) for k in (outer @ (ways @ axes).T).argmax(axis=0)))
    while len(chosen) < len(outer):
        try:
            planes = ConvexHull(outer[chosen]).equations
        except QhullError:  # the first corners may lie in one plane; then any corner out of it helps
            chosen.append(next(k for k in range(len(outer)) if k not in chosen))
            continue
        out = outer @ planes[:, :3].T + planes[:, 3]
        # The farthest point beyond each plane; the farthest of these are taken, a few at a time.
        worst = out.argmax(axis=0)
        beyond = out[worst, np.arange(len(planes))]
        order = [int(worst[k]) for k in np.argsort(-beyond, kind="stable") if beyond[k] > DEVIATION]
        fresh = list(dict.fromkeys(order))[: min(_BATCH, MOST_CORNERS - len(chosen))]
        if not fresh:
            break
        chosen += fresh
    return outer[sorted(chosen)]


def thickened(points: Array) -> Array:
    """The points (n, 3), or, if they are thinner than ``THINNEST``, copies of them on both sides."""
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle, full_matrices=False)[2]
    axes = axes if len(axes) == 3 else np.linalg.qr(axes.T, mode="complete")[0].T
    for axis in axes:
        if np.ptp(points @ axis) < THINNEST:
            points = np.concatenate([points + 0.5 * THINNEST * axis, points - 0.5 * THINNEST * axis])
    return points


def round_corners(half: Array, sides: int) -> Array:
    """(n, 3) corners of a prism that lies in a cylinder along z with half sizes (r, r, h) [m].

    >>> round_corners(np.array([1.0, 1.0, 2.0]), 4).shape
    (8, 3)
    """
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([half[0] * np.cos(angle), half[1] * np.sin(angle)], axis=1)
    return np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (-half[2], half[2])])


def ellipsoid_corners(half: Array) -> Array:
    """(``MOST_CORNERS``, 3) points spread evenly over an ellipsoid with half sizes (3,) [m]."""
    k = np.arange(MOST_CORNERS) + 0.5
    z = 1 - 2 * k / MOST_CORNERS
    turn = np.pi * (1 + np.sqrt(5.0)) * k
    flat = np.sqrt(1 - z * z)
    return np.asarray(half * np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1))


def mesh_pieces(vertices: Array, triangles: IntArray) -> tuple[Array, ...]:
    """Convex pieces of a mesh, each (n, 3) corners [m].

    Args:
        vertices: (n, 3) [m].
        triangles: (m, 3) vertex indices; the mesh need not be closed.
    """
    settings = (_VERSION, DEVIATION, MOST_CORNERS, HOLLOW, FILLED, MOST_PIECES)
    state = hashlib.sha256(repr(settings).encode())
    state.update(np.ascontiguousarray(vertices).tobytes() + np.ascontiguousarray(triangles).tobytes())
    file = cache_folder() / "pieces" / f"{state.hexdigest()}.npz"
    try:
        stored = read_arrays(file)
        return tuple(np.split(stored["corners"], stored["ends"].astype(np.int64)[:-1]))
    except (OSError, ValueError, KeyError, IndexError):
        pieces = _pieces(vertices, triangles)
    if len(pieces) > 1 or len(vertices) > _FEW:
        keep_arrays(file, corners=np.concatenate(pieces), ends=np.cumsum([len(p) for p in pieces]))
    return pieces


def _pieces(vertices: Array, triangles: IntArray) -> tuple[Array, ...]:
    from scipy.spatial import cKDTree

    whole = few_corners(vertices)
    outer = hull(whole)
    cell = max(float(np.ptp(vertices, axis=0).max()) / _CELLS, _LEAST_CELL)
    samples = surface_samples(vertices, triangles, cell)
    tree = cKDTree(samples)
    skin = surface_samples(outer.corners, outer.faces, HOLLOW)
    if np.max(tree.query(skin, distance_upper_bound=HOLLOW)[0]) < HOLLOW:
        return (whole,)
    hollow = _Hollow(tree, vertices, cell)
    ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    pairs = np.unique(ends @ [len(vertices), 1])  # numbers are sorted faster than rows
    edges = vertices[np.stack(np.divmod(pairs, len(vertices)), axis=1)]
    part = _Part(points=samples, edges=edges)
    parts = [(hollow.within(part.points), part)]
    ways = _directions(vertices, triangles)
    while len(parts) < MOST_PIECES:
        worst = max(range(len(parts)), key=lambda k: parts[k][0])
        share, part = parts[worst]
        if share == 0:
            break
        plane = _best_cut(part.points, ways, cell)
        if plane is None:
            parts[worst] = (0.0, part)
        else:
            parts[worst : worst + 1] = [(hollow.within(side.points), side) for side in part.cut(*plane)]
    return (whole,) if len(parts) == 1 else tuple(few_corners(part.points) for _, part in parts)


class _Part(NamedTuple):
    """A part of a mesh: points of its surface (n, 3), and what is in it of the mesh's edges (m, 2, 3) [m]."""

    points: Array
    edges: Array

    def cut(self, way: Array, at: float) -> list[_Part]:
        """The parts below and above a plane with normal ``way``; edges that cross it give both a point."""
        along = self.edges @ way - at
        below = along <= 0
        crossing = below[:, 0] != below[:, 1]
        start, end = self.edges[crossing].transpose(1, 0, 2)
        share = along[crossing, 0] / (along[crossing, 0] - along[crossing, 1])
        on = start + share[:, None] * (end - start)
        lower = self.points @ way <= at
        sides = []
        for inside, own in ((below, lower), (~below, ~lower)):
            half = np.where(inside[crossing, :, None], self.edges[crossing], on[:, None])
            sides.append(
                _Part(
                    points=np.concatenate([self.points[own], on]),
                    edges=np.concatenate([self.edges[inside.all(axis=1)], half]),
                )
            )
        return sides


def _directions(vertices: Array, triangles: IntArray) -> Array:
    """(n, 3) unit normals of planes to cut along: principal axes, and the directions of the largest faces."""
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    normal = normal[area > 0] / area[area > 0][:, None]
    area = area[area > 0]
    found = list(np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)[2])
    for _ in range(_WAYS):
        if not area.any():
            break
        # The direction with the most area around it, of those with the largest faces.
        likely = normal[np.argsort(-area, kind="stable")[:50]]
        best = likely[int(((np.abs(likely @ normal.T) > 0.97) @ area).argmax())]
        found.append(best)
        area = np.where(np.abs(normal @ best) > 0.9, 0.0, area)
    return np.array(found)


def _best_cut(points: Array, ways: Array, cell: float) -> tuple[Array, float] | None:
    """Normal and offset of the plane on whose sides the hulls have the least volume together; or none."""
    points = _thinned(points, cell)
    least, plane = (1.0 - _LEAST_GAIN) * _volume(points), None

    def better(way: Array, offsets: Array) -> None:
        nonlocal least, plane
        along = points @ way
        for at in offsets:
            lower = along <= at
            if 4 <= lower.sum() <= len(points) - 4:
                total = _volume(points[lower]) + _volume(points[~lower])
                if total < least:
                    least, plane = total, (way, float(at))

    for way in ways:
        along = points @ way
        better(way, np.linspace(along.min(), along.max(), _CUTS + 2)[1:-1])
    if plane is not None:  # a finer search around it
        way, at = plane
        step = float(np.ptp(points @ way)) / (_CUTS + 1)
        better(way, np.linspace(at - step, at + step, 2 * _CUTS + 1))
    return plane


def _thinned(points: Array, grain: float) -> Array:
    """At most ``_ENOUGH`` of the points, spread evenly."""
    while len(points) > _ENOUGH:
        cells = np.floor(points / grain).astype(np.int64)
        cells -= cells.min(axis=0)
        # Cells as single numbers: rows take ten times as long to sort.
        _, few = np.unique(np.ravel_multi_index(tuple(cells.T), cells.max(axis=0) + 1), return_index=True)
        points, grain = points[few], 1.25 * grain
    return points


def _volume(points: Array) -> float:
    from scipy.spatial import ConvexHull

    return float(ConvexHull(thickened(points)).volume)


class _Hollow:
    """The space round a mesh that one reaches from outside, as points of a grid.

    Args:
        tree: A ``cKDTree`` of samples of the mesh.
        vertices: (n, 3) vertices of the mesh [m].
        cell: Spacing of the grid, and at least that of the samples [m].
    """

    def __init__(self, tree: Any, vertices: Array, cell: float) -> None:
        from scipy.ndimage import label

        low = vertices.min(axis=0) - 2.5 * cell
        counts = np.ceil((np.ptp(vertices, axis=0) + 5 * cell) / cell).astype(int) + 1
        axes = [low[k] + cell * np.arange(counts[k]) for k in range(3)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        distance = np.asarray(tree.query(grid.reshape(-1, 3), distance_upper_bound=1.01 * HOLLOW)[0]).reshape(
            counts
        )
        # Of two neighbours on both sides of the surface, one is nearer than half a cell to it and so less
        # than 3/4 of a cell from a sample. So the flood does not leak.
        parts, _ = label(distance > 0.75 * cell)
        free = (parts == parts[0, 0, 0]) & (distance > cell)
        self.cell = cell
        self.points, self.distance = grid[free], distance[free]

    def within(self, samples: Array) -> float:
        """The share of the hull of samples (n, 3) that is hollow, or 0 if the hollow does not matter."""
        from scipy.spatial import ConvexHull

        around = ConvexHull(thickened(_thinned(samples, self.cell)))
        near = ((self.points > samples.min(axis=0)) & (self.points < samples.max(axis=0))).all(axis=1)
        points, distance = self.points[near], self.distance[near]
        depth = -(points @ around.equations[:, :3].T + around.equations[:, 3]).max(axis=1)
        inside = depth > 0
        fits = (distance > HOLLOW) & (depth > HOLLOW / 2)
        share = float(inside.sum() / max(1.0, around.volume / self.cell**3))
        return share if fits.any() and share > FILLED else 0.0


def surface_samples(vertices: Array, triangles: IntArray, spacing: float) -> Array:
    """(n, 3) points of triangles, none of which is farther than ``spacing`` / 2 from one at any place [m]."""
    corners = vertices[triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.maximum(1, np.ceil(longest / (0.8 * spacing) - 1e-9)).astype(np.int64)
    points = [vertices]
    for k in np.unique(parts[parts > 1]):
        i, j = (grid.ravel() for grid in np.mgrid[: k + 1, : k + 1])
        weights = np.stack([i, j, k - i - j], axis=1)[i + j <= k] / k
        points.append(np.einsum("wc,tcd->twd", weights, corners[parts == k]).reshape(-1, 3))
    return np.concatenate(points)
