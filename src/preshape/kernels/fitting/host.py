"""Pinches put between two faces of the object: host side of the fitting kernel.

A pinch fits where the palm is outside the object, each pad is near its surface, and the opened fingers have
room. That costs a hundredth of closing the hand, and few of the pinches that are drawn pass it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...types import Array, BoolArray, IntArray
from ..field.host import DistanceField
from ..field.plain import field_distance
from ..packed_launch import FIRST, Launch, Rows


class PinchRows(NamedTuple):
    """m pinches of a hand, in the palm frame.

    Attributes:
        mask: (m,) bit f is set where finger f pinches.
        pads: (m, f, 3) where each finger touches [m]; of the others anything.
        links: (m, k, 3) points of the opened hand [m].
        width: (m,) of what is between the pads [m].
        thumb: (m, 3) where the thumb touches it [m].
        others: (m, 3) mean of where the others do [m].
        thumb_rate: (m, 3) how ``thumb`` moves when the width grows.
        others_rate: (m, 3) how ``others`` does.
        opposition: (m, 3) unit vector from the fingers towards the thumb.
        tip: radius of a fingertip [m].
    """

    mask: IntArray
    pads: Array
    links: Array
    width: Array
    thumb: Array
    others: Array
    thumb_rate: Array
    others_rate: Array
    opposition: Array
    tip: float


class SpotRows(NamedTuple):
    """s pairs of faces that lie opposite each other, in the mesh frame.

    Attributes:
        middle: (s, 3) half way between them [m].
        normal: (s, 3) unit normal of one of them, outward.
        width: (s,) their distance [m].
    """

    middle: Array
    normal: Array
    width: Array


class Puts(NamedTuple):
    """n pinches to be put somewhere.

    Attributes:
        pick: (n,) which pinch.
        spot: (n,) between which faces.
        approach: (n, 3) unit approach axis.
        side: (n, 3) unit vector to the side where the thumb is to be.
        tilt: (n,) angle from the fingers (+z of the palm) to the approach, towards the palm's side [rad].
        off: (n, 4) turn about the faces' normal, then a rotation vector [rad].
    """

    pick: IntArray
    spot: IntArray
    approach: Array
    side: Array
    tilt: Array
    off: Array


class FittingKernel:
    """The pinches of one hand and one object on a device.

    Args:
        field: the object's, on the device: :attr:`preshape.kernels.closing.host.ClosingKernel.field`.
        palm: (p, 4) spheres of the palm: centre and radius [m].
        pinches: of the hand.
        spots: of the object.
        near: how near to the surface each pad is [m].
        room: how far from it each of the points is [m].
        device: ``cpu`` or a CUDA device's name.
        threads: parts of a batch that run side by side on the CPU.
    """

    def __init__(
        self,
        field: Any,
        palm: Array,
        pinches: PinchRows,
        spots: SpotRows,
        *,
        near: float,
        room: float,
        device: str,
        threads: int,
    ) -> None:
        from ..launch import warp

        wp = warp()
        from . import warp as warp_fitting

        wp.load_module(warp_fitting, device=device)  # before any thread asks for it

        def there(values: Array, kind: Any) -> Any:
            return wp.array(np.ascontiguousarray(values, dtype=np.float32), dtype=kind, device=device)

        hand = warp_fitting.PinchArrays()
        hand.palm, hand.tip = there(palm, wp.vec4), float(pinches.tip)
        hand.mask = wp.array(pinches.mask, dtype=wp.int32, device=device)
        hand.pads, hand.width = there(np.nan_to_num(pinches.pads), wp.vec3), there(pinches.width, wp.float32)
        for name in ("links", "thumb", "others", "thumb_rate", "others_rate", "opposition"):
            setattr(hand, name, there(getattr(pinches, name), wp.vec3))
        object_ = there(spots.middle, wp.vec3), there(spots.normal, wp.vec3), there(spots.width, wp.float32)
        kinds = (wp.int32, wp.int32, wp.vec3, wp.vec3, wp.float32, wp.vec4)
        self._in = [Rows(kind, device=device) for kind in kinds]
        self._out = [Rows(kind, device=device) for kind in (wp.vec3, wp.quat, wp.int32)]
        self._put = Launch(
            warp_fitting.put_pinch,
            [field, hand, near, room, *object_, *self._in, FIRST, *self._out],
            device=device,
            threads=threads,
        )

    def put(self, puts: Puts) -> tuple[IntArray, Array, Array]:
        """Which of them fit: (k,); and of these the palm frames: (k, 3) [m] and (k, 4) quaternions wxyz."""
        n = len(puts.pick)
        with self._put.lock:
            for rows, values in zip(self._in, puts, strict=True):
                rows.put(values)
            self._put(n)
            place, turn, good = self._out
            fit = np.flatnonzero(good.get(n))
            return (
                fit,
                place.get(fit).astype(np.float64),
                np.roll(turn.get(fit).astype(np.float64), 1, axis=1),
            )


def put_plain(pinches: PinchRows, spots: SpotRows, puts: Puts) -> tuple[Array, Array]:
    """The palm frames that :meth:`FittingKernel.put` tries, in plain NumPy: (n, 3) [m] and (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    normal = spots.normal[puts.spot]
    normal = np.where(np.einsum("ni,ni->n", normal, puts.side)[:, None] < 0, -normal, normal)
    middle, facing = between(pinches, puts.pick, spots.width[puts.spot])
    ahead = np.stack([np.zeros(len(normal)), -np.sin(puts.tilt), np.cos(puts.tilt)], axis=1)
    turn = frames(normal, puts.approach) @ frames(facing, ahead).transpose(0, 2, 1)
    turn = Rotation.from_rotvec(puts.off[:, :1] * normal + puts.off[:, 1:]).as_matrix() @ turn
    return spots.middle[puts.spot] - np.einsum("nij,nj->ni", turn, middle), turn


def between(pinches: PinchRows, rows: IntArray, width: Array) -> tuple[Array, Array]:
    """(n, 3) middle between the pads [m] and (n, 3) unit opposition, with something as wide between them.

    Args:
        pinches: of a hand.
        rows: (n,) which of them.
        width: (n,) not much more or less than theirs [m].
    """
    more = (width - pinches.width[rows])[:, None]
    thumb = pinches.thumb[rows] + more * pinches.thumb_rate[rows]
    others = pinches.others[rows] + more * pinches.others_rate[rows]
    # From one pad's centre to the other's: on the pads themselves a thin thing's direction is all noise.
    apart = (width + 2.0 * pinches.tip)[:, None] * pinches.opposition[rows]
    apart += more * (pinches.thumb_rate[rows] - pinches.others_rate[rows] - pinches.opposition[rows])
    return (thumb + others) / 2, apart / np.linalg.norm(apart, axis=1, keepdims=True)


def frames(first: Array, second: Array) -> Array:
    """(n, 3, 3) rotations whose first column is ``first``, and the second as near to ``second`` as can be.

    Args:
        first: (n, 3) unit vectors.
        second: (n, 3) vectors not parallel to them.
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
    """Which of them :meth:`FittingKernel.put` keeps, in plain NumPy.

    Args:
        field: the object's.
        palm: (p, 4) spheres of the palm: centre and radius [m].
        mask: (n,) of the pinches' :attr:`PinchRows.mask`, row by row; so are the next two.
        pads: (n, f, 3).
        links: (n, k, 3).
        place: (n, 3) palm frames in the mesh frame [m].
        turn: (n, 3, 3) their rotations.
        near: how near to the surface each pad is [m].
        room: how far from it each of the points is [m].
    """

    def distances(points: Array) -> Array:
        at = place[:, None] + points @ turn.transpose(0, 2, 1)
        return field_distance(field, at.reshape(-1, 3)).reshape(at.shape[:2])

    outside = (distances(np.broadcast_to(palm[:, :3], (len(place), *palm[:, :3].shape))) > palm[:, 3]).all(1)
    used = mask[:, None] >> np.arange(pads.shape[1]) & 1 == 1
    touching = ((np.abs(distances(np.nan_to_num(pads))) < near) | ~used).all(axis=1)
    return np.asarray(outside & touching & (distances(links) > room).all(axis=1))
