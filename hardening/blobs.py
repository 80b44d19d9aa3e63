"""Random lumpy objects for tests: convex hulls of random points, some of them overlapping."""

from __future__ import annotations

import numpy as np

from preshape.objects.mesh import TriangleMesh
from preshape.types import Array

LUMPS, POINTS = 3, 14


def blob(seed: int, *, size: float = 0.08) -> TriangleMesh:
    """A body of up to three overlapping convex lumps, none of whose faces lies along an axis.

    Args:
        seed: Seed of the shape.
        size: Largest extent [m].
    """
    from scipy.spatial import ConvexHull

    rng = np.random.default_rng(seed)
    vertices, triangles, count = [], [], 0
    for number in range(rng.integers(1, LUMPS + 1)):
        points = rng.normal(size=(POINTS, 3)) * rng.uniform(0.5, 1.5, 3) + (
            rng.uniform(-1, 1, 3) if number else 0.0
        )
        hull = ConvexHull(points)
        corners = points[hull.simplices]
        outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        turned = (outward * hull.equations[:, :3]).sum(axis=1) < 0
        faces = np.where(turned[:, None], hull.simplices[:, ::-1], hull.simplices)
        vertices.append(points)
        triangles.append(faces + count)
        count += len(points)
    used, place = np.unique(np.concatenate(triangles), return_inverse=True)
    points = np.concatenate(vertices)[used]
    points *= size / np.ptp(points, axis=0).max()
    return TriangleMesh(name=f"blob-{seed}", vertices=points, triangles=place.reshape(-1, 3))


def as_obj(vertices: Array, triangles: Array) -> str:
    """Text of an OBJ file; positions may be any numbers, as in a damaged file."""
    rows = [f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in vertices]
    rows += [f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in triangles]
    return "".join(rows)
