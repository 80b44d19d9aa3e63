"""The fitting kernel in plain NumPy and double precision: the specification of :mod:`.warp`.

For each placement of a pinch at a patch:

1. Side. Reverse the patch's normal if it points away from the thumb's side.
2. Pads. Adapt the pads to the patch's width, linearly by their rates.
3. Orientation. Rotate the palm so that the opposition points along the normal and the tilted fingers towards
   the approach axis; then add the deviation.
4. Place. Move the midpoint between the pads to the patch's midpoint.
5. Fit. Check that the opened fingers are clear of the object, each pad is near its surface, and the palm is
   outside it.
"""

from __future__ import annotations

import numpy as np

from ...types import Array, BoolArray, IntArray
from ..field.host import DistanceField
from ..field.plain import field_distance
from .host import PatchRows, PinchPlacements, PinchRows


def place_plain(pinches: PinchRows, patches: PatchRows, placements: PinchPlacements) -> tuple[Array, Array]:
    """Steps 1 to 4: origins (n, 3) [m] and rotations (n, 3, 3) of the palm frames in the mesh frame."""
    from scipy.spatial.transform import Rotation

    # 1. Side
    normal = patches.normal[placements.patch]
    normal = np.where(np.einsum("ni,ni->n", normal, placements.side)[:, None] < 0, -normal, normal)
    # 2. Pads
    middle, facing = between(pinches, placements.pick, patches.width[placements.patch])
    # 3. Orientation
    tilt = placements.tilt
    ahead = np.stack([np.zeros(len(normal)), -np.sin(tilt), np.cos(tilt)], axis=1)
    turn = frames(normal, placements.approach) @ frames(facing, ahead).transpose(0, 2, 1)
    turn = Rotation.from_rotvec(placements.off[:, :1] * normal + placements.off[:, 1:]).as_matrix() @ turn
    # 4. Place
    return patches.middle[placements.patch] - np.einsum("nij,nj->ni", turn, middle), turn


def between(pinches: PinchRows, rows: IntArray, width: Array) -> tuple[Array, Array]:
    """(n, 3) midpoints between the pads [m] and (n, 3) unit opposition, for objects of given widths.

    Args:
        pinches: Pinches of a hand.
        rows: (n,) indices of pinches.
        width: (n,) thickness of the object, near that of the pinch [m].
    """
    more = (width - pinches.width[rows])[:, None]
    thumb = pinches.thumb[rows] + more * pinches.thumb_rate[rows]
    others = pinches.others[rows] + more * pinches.others_rate[rows]
    # The direction is that between the fingertips' centres, because the contact points of a thin object
    # nearly coincide.
    apart = (width + 2.0 * pinches.tip)[:, None] * pinches.opposition[rows]
    apart += more * (pinches.thumb_rate[rows] - pinches.others_rate[rows] - pinches.opposition[rows])
    return (thumb + others) / 2, apart / np.linalg.norm(apart, axis=1, keepdims=True)


def frames(first: Array, second: Array) -> Array:
    """(n, 3, 3) rotations with first column ``first`` and the second as near to ``second`` as possible.

    Args:
        first: (n, 3) unit vectors.
        second: (n, 3) vectors that are not parallel to ``first``.
    """
    across = second - np.einsum("ni,ni->n", first, second)[:, None] * first
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return np.stack([first, across, np.cross(first, across)], axis=2)


def fits_plain(
    field: DistanceField,
    palm: Array,
    mask: IntArray,
    pads: Array,
    links: Array,
    place: Array,
    turn: Array,
    *,
    near: float,
    room: float,
) -> BoolArray:
    """Step 5: (n,) whether each placed pinch fits.

    Args:
        field: The object's distance field.
        palm: (p, 4) spheres of the palm: centre and radius [m].
        mask: (n,) mask of each placed pinch, as in :class:`~preshape.kernels.fitting.host.PinchRows`.
        pads: (n, f, 3) its pads [m].
        links: (n, k, 3) its points of the opened hand [m].
        place: (n, 3) origins of the palm frames in the mesh frame [m].
        turn: (n, 3, 3) their rotations.
        near: Largest distance of a pad from the surface [m].
        room: Least distance of the points of the opened hand from the surface [m].
    """

    def distances(points: Array) -> Array:
        at = place[:, None] + points @ turn.transpose(0, 2, 1)
        return field_distance(field, at.reshape(-1, 3)).reshape(at.shape[:2])

    outside = (distances(np.broadcast_to(palm[:, :3], (len(place), *palm[:, :3].shape))) > palm[:, 3]).all(1)
    used = mask[:, None] >> np.arange(pads.shape[1]) & 1 == 1
    touching = ((np.abs(distances(np.nan_to_num(pads))) < near) | ~used).all(axis=1)
    return np.asarray(outside & touching & (distances(links) > room).all(axis=1))
