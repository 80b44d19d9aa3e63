"""Where an object can be taken between fingertips: places of its surface with a face opposite."""

from __future__ import annotations

import numpy as np

from ..kernels.field.host import DistanceField
from ..kernels.field.plain import field_distance
from ..kernels.field.winding import oriented_triangles
from ..kernels.rays import MISS, RayCaster
from ..objects.mesh import TriangleMesh
from ..types import Array, value

PLACES = 1500
"""Places of the surface that are looked at, even by area [C]."""
OPPOSITE = 0.9
"""Least cosine between the normal of a face and that of the one behind it, turned round [C]."""
THINNEST = 0.001
"""What is thinner is not looked for: the grid of distances does not see it [m] [C]."""
INTO = 0.002
"""A fingertip beside the spot may seem this deep in the object, which the grid blurs [m] [C]."""


@value
class Spots:
    """n spots.

    Attributes:
        middle: (n, 3) half way between the two faces [m].
        normal: (n, 3) unit normal of the first face, outward.
        width: (n,) distance of the faces [m].
    """

    middle: Array
    normal: Array
    width: Array

    def __len__(self) -> int:
        return len(self.width)


def find_spots(mesh: TriangleMesh, field: DistanceField, tip: float, widest: float, seed: int = 0) -> Spots:
    """The places where two fingertips can stand opposite each other with the object between them.

    Args:
        mesh: need not be watertight, nor wound consistently.
        field: its signed distance.
        tip: radius of a fingertip [m].
        widest: what the hand can pinch at most [m].
        seed: of the places looked at.
    """
    rng = np.random.default_rng(seed)
    triangles = oriented_triangles(mesh)
    normals = np.where((triangles == mesh.triangles).all(axis=1)[:, None], mesh.normals, -mesh.normals)
    ends = np.cumsum(mesh.areas)
    at = (np.arange(PLACES) + rng.random(PLACES)) / PLACES * ends[-1]
    face = np.minimum(np.searchsorted(ends, at, side="right"), len(ends) - 1)
    root, v = np.sqrt(rng.random(PLACES)), rng.random(PLACES)
    weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    points, out = np.einsum("nk,nkd->nd", weights, mesh.corners[face]), normals[face]
    step = 1e-5 * float(mesh.extents.max())
    hits = RayCaster(mesh).cast(points - step * out, -out)
    width = hits.distance + step
    facing = -np.einsum("ij,ij->i", normals[hits.triangle], out) > OPPOSITE
    rows = np.flatnonzero((hits.triangle != MISS) & facing & (width > THINNEST) & (width < widest))
    points, out, width = points[rows], out[rows], width[rows]
    sides = points + tip * out, points - (width + tip)[:, None] * out
    room = np.all([field_distance(field, centres) > tip - INTO for centres in sides], axis=0)
    return Spots(middle=(points - 0.5 * width[:, None] * out)[room], normal=out[room], width=width[room])
