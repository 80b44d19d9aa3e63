"""Pinches of the hand placed on antipodal patches: places where two faces of the object oppose each other.

A hand that only aims at the bounding box usually loses a thin object: if the offset between opposing
fingertips exceeds thickness times friction, they turn the object instead of holding it. Here pads are first
aligned with faces of the object, and the pose of the hand follows from that.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..hiis.planes import APPROACH_AXES, OPPOSITION_AXES
from ..kernels.closing.host import Candidates, ClosingKernel
from ..kernels.field.host import DistanceField, SurfaceQuery
from ..kernels.field.plain import field_distance
from ..kernels.fitting.host import FittingKernel, PatchRows, PinchPlacements
from ..kernels.rays import MISS
from ..objects.mesh import TriangleMesh
from ..objects.winding import oriented_triangles
from ..types import Array, IntArray, value
from .candidates import TILT, DrawnCandidates, Region
from .contact_places import SAMPLES, AllowedSurface, ContactPlaces, surface_draws
from .hand_pinches import Pinches

OPPOSITE = 0.9
"""Least cosine between the normal of a face and the reversed normal of the face behind it [C]."""
THINNEST = 0.001
"""Least width of a patch: the distance grid does not resolve thinner parts [m] [C]."""
TIP_DEPTH = 0.002
"""Accepted apparent depth of a fingertip in the object, because the grid blurs the surface [m] [C]."""
PINCHED = 0.5
"""Share of pinches among the candidates, if enough of them fit the object [C]."""
ALIGNED = 0.55
"""Least cosine between a patch's normal and an opposition axis; every normal meets it for some axis [C]."""
VALUE_RANGE = 0.2
"""Largest distance between a patch and the wanted approach value, in half-extents [C]."""
CENTRAL = 0.01
"""A patch at this distance from the object's middle is drawn half as often as one at the middle, because
weight and pushes turn the object less in a central grip [m] [C]."""
SURPLUS, TRIES = 4, 2
"""Number of pinches tested for each candidate wanted, and number of attempts if too few of them fit [C]."""
NEAR = 0.005
"""Largest distance of any pad from the object's surface in the closed pinch [m] [C]."""
ROOM = 0.006
"""Least distance from the object to the middle of each link of the opened fingers [m] [C]."""
ALIKE = 24
"""Number of pinches nearest to the patch's width, one of which is drawn [C]."""
AROUND = 0.4
"""Standard deviation of the rotation about the patch's normal [rad] [C]."""
SLANT, MOST_SLANT = 0.1, 0.02
"""Standard deviation of the tilt off the patch's normal [rad] [C]: the first number times the ratio
thickness / (thickness + fingertips), and at most the second number."""


@value
class AntipodalPatches:
    """n pairs of opposite points of the surface, with room for a fingertip at both.

    Attributes:
        middle: (n, 3) midpoint of the pair [m].
        normal: (n, 3) outward unit normal at the first point.
        width: (n,) distance of the two points [m].
    """

    middle: Array
    normal: Array
    width: Array

    def __len__(self) -> int:
        return len(self.width)


def antipodal_patches(
    mesh: TriangleMesh,
    field: DistanceField,
    tip: float,
    widest: float,
    seed: int = 0,
    *,
    allowed: AllowedSurface | None = None,
    places: ContactPlaces | None = None,
) -> AntipodalPatches:
    """Pairs of surface points at which two fingertips can hold the object between them.

    1. Draw points evenly over the surface; there are none on lids, which nothing can touch.
    2. Cast a ray inward from each and find the face behind it.
    3. Accept pairs whose normals are opposite and whose distance the hand can span, and both of which may be
       touched.
    4. Accept those at which a fingertip has room outside both faces.

    Args:
        mesh: The object; it need not be watertight or wound consistently.
        field: Its signed distance.
        tip: Radius of a fingertip [m].
        widest: Largest width that the hand can pinch [m].
        seed: Seed of the surface points.
        allowed: The points of the surface that may be touched; ``None`` for all.
        places: The rules about contacts, for the points behind these.
    """
    rng = np.random.default_rng(seed)
    triangles = oriented_triangles(mesh)
    normals = np.where((triangles == mesh.triangles).all(axis=1)[:, None], mesh.normals, -mesh.normals)
    # 1. Stratified by area, uniform on each triangle.
    if allowed is not None:
        points, face = allowed.points, allowed.triangle
    else:
        points, face = surface_draws(mesh, rng, SAMPLES)
    out = normals[face]
    # 2. and 3.
    step = 1e-5 * float(mesh.extents.max())
    hits = SurfaceQuery(mesh).cast(points - step * out, -out)  # whose mesh is the field's
    width = hits.distance + step
    facing = -np.einsum("ij,ij->i", normals[hits.triangle], out) > OPPOSITE
    real = (hits.triangle != MISS) & ~mesh.is_lid[hits.triangle] & ~mesh.is_lid[face]
    rows = np.flatnonzero(real & facing & (width > THINNEST) & (width < widest))
    if places is not None and len(rows):
        behind = points[rows] - width[rows, None] * out[rows]
        rows = rows[~places.broken(behind).any(axis=1)]
    points, out, width = points[rows], out[rows], width[rows]
    # 4.
    sides = points + tip * out, points - (width + tip)[:, None] * out
    room = np.all([field_distance(field, centres) > tip - TIP_DEPTH for centres in sides], axis=0)
    middle = points - 0.5 * width[:, None] * out
    return AntipodalPatches(middle=middle[room], normal=out[room], width=width[room])


class Pincher:
    """Draws candidates that put one hand's pinches on one object's antipodal patches.

    Args:
        pinches: Pinches of the hand.
        patches: Antipodal patches of the object.
        centre: (3,) middle of the object's bounding box [m].
        half: (3,) half its extents [m].
        closing: Closing kernel of the same hand and object.
    """

    def __init__(
        self, pinches: Pinches, patches: AntipodalPatches, centre: Array, half: Array, closing: ClosingKernel
    ) -> None:
        self.pinches, self.patches = pinches, patches
        self.centre, self.half = centre, half
        self.kernel = FittingKernel(
            closing.field,
            pinches.palm,
            pinches.rows,
            PatchRows(patches.middle, patches.normal, patches.width),
            near=NEAR,
            room=ROOM,
            device=closing.device,
            threads=closing.threads,
        )

    def draw(self, rng: np.random.Generator, count: int, region: Region) -> DrawnCandidates:
        """Draw candidates that pinch.

        1. Weight every pair of patch and approach plane: the normal must lie along the opposition axis, and
           central patches weigh more.
        2. Draw pairs by weight, and for each pair a thumb side and a pinch of about the patch's width.
        3. Let the kernel place the hand and test whether palm, pads and links fit.
        4. Repeat from 2 if too few fit. Order the results so that the numbers of fingers alternate.

        Args:
            rng: Random generator.
            count: Largest number of candidates; fewer where few fit.
            region: Where to draw; patches lie within ``VALUE_RANGE`` of its approach values.
        """
        pinches, patches = self.pinches, self.patches
        # 1. Weights.
        numbers = np.asarray(region.planes)
        a, o = APPROACH_AXES[numbers - 1], OPPOSITION_AXES[numbers - 1]
        from_centre = patches.middle - self.centre
        values = from_centre @ a.T / np.maximum(np.abs(a) @ self.half, 1e-9)
        weight = np.maximum(np.abs(patches.normal @ o.T) - ALIGNED, 0.0)
        weight /= 1.0 + np.linalg.norm(from_centre, axis=1)[:, None] / CENTRAL
        if region.values is not None and len(patches):
            wanted = np.broadcast_to(np.asarray(region.values), (len(numbers), len(region.values)))
            if region.box is not None:  # a value beyond the surface that may be touched means its end
                ends = values.min(axis=0)[:, None], values.max(axis=0)[:, None]
                wanted = np.clip(wanted, *ends)
            weight *= np.abs(values[:, :, None] - wanted).min(axis=2) < VALUE_RANGE
        allowed = np.arange(len(pinches))
        if region.fingers is not None:
            allowed = allowed[np.isin(pinches.fingers, region.fingers)]
        n = SURPLUS * count if weight.any() and len(allowed) else 0
        sides = np.stack([o, -o])
        parts: list[tuple[Any, ...]] = []
        for _ in range(TRIES):
            # 2. Pairs, thumb sides and pinches.
            patch, column = np.divmod(_weighted_draw(rng, weight.ravel(), n), len(numbers))
            flip = np.asarray(region.flips)[rng.integers(len(region.flips), size=n)]
            placements = self._placements(
                rng, allowed, patch, a[column], sides[flip.astype(np.int64), column]
            )
            # 3. Placed and tested.
            fit, palm, turn = self.kernel.place(placements)
            parts.append((patch[fit], column[fit], flip[fit], placements.pick[fit], palm, turn))
            if sum(len(part[0]) for part in parts) >= count:
                break
        patch, column, flip, pick, palm, turn = (np.concatenate(each) for each in zip(*parts, strict=True))
        # 4. Alternate between the numbers of fingers.
        rows = alternating(pinches.fingers[pick])[:count]
        return DrawnCandidates(
            candidates=Candidates(
                place=palm[rows],
                turn=turn[rows],
                start=pinches.start[pick[rows]],
                mask=pinches.mask[pick[rows]],
            ),
            plane=numbers[column[rows]],
            flip=flip[rows],
            value=np.clip(values[patch[rows], column[rows]], -1.0, 1.0),
            preshape=np.full(len(rows), -1),
        )

    def _placements(
        self, rng: np.random.Generator, allowed: IntArray, patch: IntArray, approach: Array, side: Array
    ) -> PinchPlacements:
        """Draw a pinch for each patch, and its orientation there.

        Args:
            rng: Random generator.
            allowed: Indices of the pinches to draw from.
            patch: (n,) indices of the patches.
            approach: (n, 3) approach axes.
            side: (n, 3) unit vectors towards the thumb's side.
        """
        n, width = len(patch), self.patches.width
        about = np.searchsorted(self.pinches.width[allowed], width)[patch]
        about += rng.integers(-ALIKE // 2, ALIKE // 2, size=n)
        slant = np.minimum(SLANT * width / (width + 2.0 * self.pinches.tip[0]), MOST_SLANT)
        off = rng.normal(0.0, 1.0, (n, 4))
        off[:, 0] *= AROUND
        off[:, 1:] *= slant[patch, None]
        return PinchPlacements(
            pick=allowed[np.clip(about, 0, len(allowed) - 1)],
            patch=patch,
            approach=approach,
            side=side,
            tilt=rng.uniform(0.0, TILT, n),
            off=off,
        )


def _weighted_draw(rng: np.random.Generator, weight: Array, count: int) -> IntArray:
    """(count,) random indices, each with a probability in proportion to its weight."""
    ends = np.cumsum(weight)
    return np.minimum(
        np.searchsorted(ends, rng.random(count) * ends[-1:].sum(), side="right"), max(len(weight) - 1, 0)
    )


def alternating(kind: IntArray) -> IntArray:
    """All indices, ordered so that the kinds alternate as long as they last.

    >>> alternating(np.array([2, 2, 2, 4])).tolist()
    [0, 3, 1, 2]
    """
    turn = np.zeros(len(kind), dtype=np.int64)
    for one in np.unique(kind):
        own = np.flatnonzero(kind == one)
        turn[own] = np.arange(len(own))
    return np.argsort(turn, kind="stable")
