"""Places pinches at antipodal patches of the object: the host side of the fitting kernel.

A pinch fits at a patch if the palm is outside the object, each pad is near the surface, and the opened
fingers are clear of the object. This test takes a hundredth of the time of closing the hand, and few pinches
pass it. The kernel is :mod:`.warp`, on the CPU and on CUDA; :mod:`.plain` is its specification.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...types import Array, IntArray


class PinchRows(NamedTuple):
    """m pinches of a hand, in the palm frame.

    Attributes:
        mask: (m,) bit f is set if finger f pinches.
        pads: (m, f, 3) contact point of each finger [m]; arbitrary for fingers that do not pinch.
        links: (m, k, 3) points of the opened hand [m].
        width: (m,) thickness of the object between the pads [m].
        thumb: (m, 3) contact point of the thumb [m].
        others: (m, 3) mean of the other fingers' contact points [m].
        thumb_rate: (m, 3) derivative of ``thumb`` with respect to the width.
        others_rate: (m, 3) derivative of ``others`` with respect to the width.
        opposition: (m, 3) unit vector from the fingers towards the thumb.
        tip: Radius of a fingertip [m].
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


class PatchRows(NamedTuple):
    """s antipodal patches of an object, pairs of surface points with opposite normals, in the mesh frame.

    Attributes:
        middle: (s, 3) midpoint of the two points [m].
        normal: (s, 3) outward unit normal at one of them.
        width: (s,) their distance [m].
    """

    middle: Array
    normal: Array
    width: Array


class PinchPlacements(NamedTuple):
    """n pinches, each to be placed at a patch.

    Attributes:
        pick: (n,) index of the pinch.
        patch: (n,) index of the patch.
        approach: (n, 3) unit approach axis.
        side: (n, 3) unit vector towards the thumb's side.
        tilt: (n,) angle from the fingers' direction (+z of the palm) to the approach axis, positive towards
            the side that the palm faces [rad].
        off: (n, 4) deviation of the palm [rad]: an angle about the patch's normal, then a rotation vector.
    """

    pick: IntArray
    patch: IntArray
    approach: Array
    side: Array
    tilt: Array
    off: Array


class FittingKernel:
    """The pinches of one hand and the patches of one object on a device.

    Args:
        field: The object's distance field on the device, ``ClosingKernel.field``.
        palm: (p, 4) spheres of the palm in the palm frame: centre and radius [m].
        pinches: Pinches of the hand.
        patches: Antipodal patches of the object.
        near: Largest distance of a pad from the surface [m].
        room: Least distance of the points of the opened hand from the surface [m].
        device: ``cpu`` or a CUDA device's name.
        threads: Number of CPU threads.
    """

    def __init__(
        self,
        field: Any,
        palm: Array,
        pinches: PinchRows,
        patches: PatchRows,
        *,
        near: float,
        room: float,
        device: str,
        threads: int,
    ) -> None:
        from ..cache import load_kernels
        from ..launch import warp
        from ..packed_launch import FIRST_ROW, DeviceRows, PackedLaunch

        wp = warp()
        from . import warp as warp_fitting

        load_kernels(warp_fitting, device)

        def array(values: Array, kind: Any) -> Any:
            return wp.array(np.ascontiguousarray(values, dtype=np.float32), dtype=kind, device=device)

        def rows(kind: Any) -> DeviceRows:
            return DeviceRows(kind, device=device)

        hand = warp_fitting.PinchArrays()
        hand.palm, hand.tip = array(palm, wp.vec4), float(pinches.tip)
        hand.mask = wp.array(pinches.mask, dtype=wp.int32, device=device)
        hand.pads, hand.width = array(np.nan_to_num(pinches.pads), wp.vec3), array(pinches.width, wp.float32)
        for name in ("links", "thumb", "others", "thumb_rate", "others_rate", "opposition"):
            setattr(hand, name, array(getattr(pinches, name), wp.vec3))
        model = {
            "field": field,
            "pinch": hand,
            "near": near,
            "room": room,
            "middle": array(patches.middle, wp.vec3),
            "normal": array(patches.normal, wp.vec3),
            "width": array(patches.width, wp.float32),
        }
        kinds = (wp.int32, wp.int32, wp.vec3, wp.vec3, wp.float32, wp.vec4)
        self._in = {name: rows(kind) for name, kind in zip(PinchPlacements._fields, kinds, strict=True)}
        self._out = {"place": rows(wp.vec3), "turn": rows(wp.quat), "fit": rows(wp.int32)}
        self._place = PackedLaunch(
            warp_fitting.place_pinch,
            {**model, **self._in, "first": FIRST_ROW, **self._out},
            device=device,
            threads=threads,
        )

    def place(self, placements: PinchPlacements) -> tuple[IntArray, Array, Array]:
        """Place the pinches and keep those that fit.

        Returns:
            (k,) indices of the placements that fit, and for these (k, 3) origins of the palm frames in the
            mesh frame [m] and (k, 4) orientations, quaternions wxyz.
        """
        count = len(placements.pick)
        with self._place.lock:
            for rows, values in zip(self._in.values(), placements, strict=True):
                rows.put(values)
            self._place(count)
            place, turn, fit = self._out.values()
            chosen = np.flatnonzero(fit.get(count))
            return (
                chosen,
                place.get(chosen).astype(np.float64),
                np.roll(turn.get(chosen).astype(np.float64), 1, axis=1),
            )
