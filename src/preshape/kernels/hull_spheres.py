"""Spheres that fill a convex polyhedron: none protrudes, and the polyhedron protrudes by a limited length.

1. The surface is sampled, corners and edges included.
2. For a sample, the largest spheres are found that lie inside and come as near to it as the limit asks. Their
   centres are looked for along the normal of the face, and along the mean normals of all faces near by,
   because a sphere reaches an edge or a corner along its bisector only.
3. Sample by sample, a sphere is chosen that comes near enough to it and to as many others as possible.
4. A few large spheres fill what is left of the interior.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..types import Array, IntArray

_SLACK = (0.3, 0.6, 0.85)
"""Shares of the limit by which a sample protrudes from its spheres; the rest covers its neighbours [C]."""
_ON = 1e-7  # [m] a corner this near to a plane lies on it
_POOL = 12
"""Samples in the neighbourhood whose spheres are compared [C]."""
_VOLUME_SAMPLES, _WORTH = 4000, 0.01
_LEAST_RADIUS = 1e-6  # [m]; below it a sphere is of no use


class Polyhedron(NamedTuple):
    """A convex polyhedron.

    Attributes:
        corners: (n, 3) [m].
        faces: (m, 3) triangles, which face outwards.
        planes: (k, 4) outward unit normal and offset [m]: a point x is inside if normal · x <= offset.
    """

    corners: Array
    faces: IntArray
    planes: Array

    def depth(self, points: Array) -> Array:
        """(n,) distance from points (n, 3) to the nearest plane [m]; negative outside."""
        return np.asarray((self.planes[:, 3] - points @ self.planes[:, :3].T).min(axis=1))


def polyhedron_surface(solid: Polyhedron, spacing: float) -> tuple[Array, Array]:
    """(n, 3) samples of the surface ``spacing`` [m] apart, with corners and edges; (n, 3) outward normals."""
    corners, (normals, offsets) = solid.corners, (solid.planes[:, :3], solid.planes[:, 3])
    on = np.abs(corners @ normals.T - offsets) < _ON
    ends = np.sort(solid.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    ends = np.unique(ends, axis=0)
    # An edge between triangles of one plane is none of the solid's.
    ends = ends[(on[ends[:, 0]] & on[ends[:, 1]]).sum(axis=1) > 1]
    points = [corners]
    length = np.linalg.norm(corners[ends[:, 1]] - corners[ends[:, 0]], axis=1)
    parts = np.maximum(1, np.ceil(length / spacing - 1e-9)).astype(np.int64)
    for k in np.unique(parts[parts > 1]):
        start, end = corners[ends[parts == k]].transpose(1, 0, 2)
        share = (np.arange(1, k) / k)[:, None, None]
        points.append((start + share * (end - start)).reshape(-1, 3))
    for plane, normal in enumerate(normals):
        own = corners[on[:, plane]]
        u = np.cross(normal, np.eye(3)[int(np.abs(normal).argmin())])
        u /= np.linalg.norm(u)
        axes = np.stack([u, np.cross(normal, u)])
        flat = (own - own[0]) @ axes.T
        steps = [
            np.arange(low + spacing / 2, high, spacing)
            for low, high in zip(flat.min(axis=0), flat.max(axis=0), strict=True)
        ]
        grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2) @ axes + own[0]
        points.append(grid[solid.depth(grid) > -_ON] if len(grid) else grid)
    found = np.concatenate(points)
    facing = normals[np.abs(found @ normals.T - offsets).argmin(axis=1)]
    return found, facing


def polyhedron_spheres(solid: Polyhedron, protrusion: float, spacing: float) -> Array:
    """(n, 4) spheres inside, centre and radius [m], from which the surface protrudes by a limit at most.

    Args:
        solid: The polyhedron.
        protrusion: The limit, met at the samples [m].
        spacing: Distance between samples [m].
    """
    from scipy.spatial import cKDTree

    points, normals = polyhedron_surface(solid, spacing)
    parts = zip(_split(points), _split(normals), strict=True)
    found = [_candidates(solid, *part, protrusion) for part in parts]
    # Samples with much room come first: their spheres are large and cover many others.
    own, room = (np.concatenate(each) for each in zip(*found, strict=True))
    tree = cKDTree(points)
    left, chosen = np.ones(len(points), dtype=bool), []
    for sample in np.argsort(-room, kind="stable"):
        if not left[sample]:
            continue
        # The spheres of samples about as far away as one of them covers, which come near enough to this one.
        cover = float(np.sqrt(2 * max(room[sample], protrusion) * protrusion + protrusion**2))
        around = np.array(tree.query_ball_point(points[sample], 2 * cover), dtype=np.int64)
        near = around[np.linalg.norm(points[around] - points[sample], axis=1) < min(cover, 4 * protrusion)]
        few = np.append(near[:: 1 + len(near) // _POOL], sample)
        pool = own[few].transpose(1, 0, 2).reshape(-1, 4)
        away = np.linalg.norm(pool[:, :3] - points[sample], axis=1) - pool[:, 3]
        pool = pool[(pool[:, 3] > _LEAST_RADIUS) & (away <= protrusion)]
        if not len(pool):
            continue
        waiting = points[around[left[around]]]
        gaps = np.linalg.norm(pool[:, None, :3] - waiting, axis=2) - pool[:, 3:]
        best = pool[int((gaps <= protrusion).sum(axis=1).argmax())]
        left[tree.query_ball_point(best[:3], best[3] + protrusion)] = False
        chosen.append(best)
    spheres = np.array(chosen).reshape(-1, 4)
    return np.concatenate([spheres, _interior(solid, spheres)])


def _split(rows: Array) -> list[Array]:
    """The rows in parts whose tables of distances to every plane stay in a processor's cache."""
    return np.array_split(rows, 1 + len(rows) // 1_000)


def _interior(solid: Polyhedron, spheres: Array) -> Array:
    """(n, 4) spheres that add most to the volume of the others, each at least the share ``_WORTH`` of it."""
    low, high = solid.corners.min(axis=0), solid.corners.max(axis=0)
    inside = np.random.default_rng(0).uniform(low, high, (_VOLUME_SAMPLES, 3))
    depth = solid.depth(inside)
    inside, depth = inside[depth > 0], depth[depth > 0]
    left = np.ones(len(inside), dtype=bool)
    for sphere in spheres:
        left &= np.linalg.norm(inside - sphere[:3], axis=1) > sphere[3]
    added: list[Array] = []
    while left.any():
        best = int(np.where(left, depth, -1.0).argmax())
        fresh = left & (np.linalg.norm(inside - inside[best], axis=1) <= depth[best])
        if fresh.sum() < _WORTH * len(inside):
            break
        added.append(np.append(inside[best], depth[best]))
        left &= ~fresh
    return np.array(added).reshape(-1, 4)


def _candidates(solid: Polyhedron, points: Array, normals: Array, protrusion: float) -> tuple[Array, Array]:
    """(n, k, 4) the largest spheres along a few directions from each sample, with a few slacks, and the room.

    The room (n,) is the radius of the largest sphere along the normal, with half of the protrusion as slack.
    """
    gaps = np.maximum(solid.planes[:, 3] - points @ solid.planes[:, :3].T, 0.0)
    slacks = [share * protrusion for share in _SLACK]
    straight = _along(solid, points, normals, gaps, [*slacks, 0.5 * protrusion])
    spheres = [straight[:, :-1]]
    for near in (_ON, protrusion):
        outward = (gaps <= near) @ solid.planes[:, :3]
        outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
        spheres.append(_along(solid, points, outward, gaps, slacks))
    return np.concatenate(spheres, axis=1), straight[:, -1, 3]


def _along(solid: Polyhedron, points: Array, outward: Array, gaps: Array, slacks: Sequence[float]) -> Array:
    """(n, k, 4) for each point, the largest spheres with centres inwards at most k slacks away [m].

    A sphere with centre p - t o has the radius r = min(gap + t n·o) over the planes with normals n, and is
    t - r away from p. So the slack bounds t by (slack + gap) / (1 - n·o) for every plane.
    """
    apart = np.maximum(1.0 - outward @ solid.planes[:, :3].T, 1e-9)
    found = []
    for slack in slacks:
        centre = points - ((slack + gaps) / apart).min(axis=1)[:, None] * outward
        found.append(np.column_stack([centre, solid.depth(centre)]))
    return np.stack(found, axis=1)
