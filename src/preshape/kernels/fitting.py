"""Whether a hand that is about to pinch is in place: host side of the fitting kernel.

A pinch fits where the palm is outside the object, each pad is near its surface, and the opened fingers have
room. That costs a hundredth of closing the hand, and few of the pinches that are drawn pass it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..types import Array, BoolArray, IntArray
from .field import DistanceField
from .field_numpy import field_distance
from .kept import FIRST, Launch, Rows


class FittingKernel:
    """The pinches of one hand and one object on a device.

    Args:
        field: the object's, on the device: :attr:`preshape.kernels.closing.ClosingKernel.field`.
        palm: (p, 4) spheres of the palm: centre and radius [m].
        mask: (m,) bit f is set where finger f pinches.
        pads: (m, f, 3) where each finger touches, palm frame [m]; of the others anything.
        links: (m, k, 3) points of the opened hand [m].
        near: how near to the surface each pad is [m].
        room: how far from it each of the points is [m].
        device: ``cpu`` or a CUDA device's name.
        threads: parts of a batch that run side by side on the CPU.
    """

    def __init__(
        self,
        field: Any,
        palm: Array,
        mask: IntArray,
        pads: Array,
        links: Array,
        *,
        near: float,
        room: float,
        device: str,
        threads: int,
    ) -> None:
        from .launch import warp

        wp = warp()
        from . import warp_fitting

        wp.load_module(warp_fitting, device=device)  # before any thread asks for it
        hand = [
            wp.array(np.ascontiguousarray(values, dtype=np.float32), dtype=kind, device=device)
            for values, kind in ((palm, wp.vec4), (np.nan_to_num(pads), wp.vec3), (links, wp.vec3))
        ]
        hand.insert(1, wp.array(mask, dtype=wp.int32, device=device))
        self._in = [Rows(kind, device=device) for kind in (wp.int32, wp.vec3, wp.mat33)]
        self._good = Rows(wp.int32, device=device)
        self._fit = Launch(
            warp_fitting.fit_pinch,
            [field, *hand, near, room, *self._in, FIRST, self._good],
            device=device,
            threads=threads,
        )

    def fits(self, pick: IntArray, place: Array, turn: Array) -> BoolArray:
        """(n,) whether there is object where each finger would meet it, and none where the opened hand is.

        Args:
            pick: (n,) which pinch.
            place: (n, 3) palm frame in the mesh frame [m].
            turn: (n, 3, 3) its rotation.
        """
        with self._fit.lock:
            for rows, values in zip(self._in, (pick, place, turn), strict=True):
                rows.put(values)
            self._fit(len(pick))
            return np.asarray(self._good.get(len(pick)), dtype=bool)


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
    """:meth:`FittingKernel.fits` in plain NumPy; ``mask``, ``pads`` and ``links`` are those of each row."""

    def distances(points: Array) -> Array:
        at = place[:, None] + points @ turn.transpose(0, 2, 1)
        return field_distance(field, at.reshape(-1, 3)).reshape(at.shape[:2])

    outside = (distances(np.broadcast_to(palm[:, :3], (len(place), *palm[:, :3].shape))) > palm[:, 3]).all(1)
    used = mask[:, None] >> np.arange(pads.shape[1]) & 1 == 1
    touching = ((np.abs(distances(np.nan_to_num(pads))) < near) | ~used).all(axis=1)
    return np.asarray(outside & touching & (distances(links) > room).all(axis=1))
