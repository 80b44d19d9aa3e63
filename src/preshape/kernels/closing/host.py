"""Closing many hands on one object: host side of the closing kernel.

A candidate is a wrist pose and a preshape. Its fingers move along the closing path, each until one of its
links touches; what they touch, and where, comes back. The kernel is :mod:`preshape.kernels.closing.warp`, on
the CPU and on CUDA; :mod:`preshape.kernels.closing.plain` is its specification.
"""

from __future__ import annotations

import math
from dataclasses import field
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from ...exceptions import InputError
from ...types import Array, IntArray, freeze, frozen_array, value

if TYPE_CHECKING:
    from ..field.host import DistanceField
    from ..tables import HandTables

CONTACTS = 8
"""Room for contacts of one candidate."""
CLOSING_ARRAYS = ("fate", "closing", "sphere", "points", "normals_in", "counts")
"""Everything in :class:`Closings`, one row a candidate."""
_FAR = 1e6
_SETTINGS = 6
"""Place of the clearance among the closing kernel's arguments; the other settings come after it."""


class Fate(IntEnum):
    """What became of a candidate."""

    CLOSED = 0
    PALM_INSIDE = 1
    FINGERS_INSIDE = 2
    THUMB_MISSES = 3
    TOO_FEW = 4


@value
class Candidates:
    """n hands about to close.

    Attributes:
        place: (n, 3) palm frame in the mesh frame [m].
        turn: (n, 4) its orientation, quaternion wxyz.
        start: (n, j) joint angles at the beginning of the closing path [rad].
        mask: (n,) bit f is set where finger f closes.
    """

    place: Array
    turn: Array
    start: Array
    mask: IntArray

    def __len__(self) -> int:
        return len(self.place)

    def take(self, rows: IntArray) -> Candidates:
        """The candidates of these rows, in that order."""
        return Candidates(
            place=self.place[rows], turn=self.turn[rows], start=self.start[rows], mask=self.mask[rows]
        )


@value
class Closings:
    """How n hands closed.

    Attributes:
        fate: (n,) :class:`Fate`.
        closing: (n, f) how far each finger closed, 0..1; 0 where it touches nothing.
        sphere: (n, f) the sphere that touches, -1 for none.
        points: (n, 8, 3) contact points [m], the thumb's first; only the first ``counts`` are filled.
        normals_in: (n, 8, 3) inward unit normals.
        counts: (n,) contacts; 0 unless ``CLOSED``.
    """

    fate: IntArray
    closing: Array
    sphere: IntArray
    points: Array
    normals_in: Array
    counts: IntArray

    def take(self, rows: IntArray) -> Closings:
        """Those of these rows, in that order."""
        return Closings(**{name: getattr(self, name)[rows] for name in CLOSING_ARRAYS})


@value
class Obstacles:
    """What hand and fingers must stay out of, in the mesh frame.

    Attributes:
        planes: (k, 4) half-spaces n·x < d that are solid: unit normal and offset [m].
        boxes: (b, 2, 3) lower and upper corners [m].
    """

    planes: Array = field(default_factory=lambda: np.zeros((0, 4)))
    boxes: Array = field(default_factory=lambda: np.zeros((0, 2, 3)))

    def __post_init__(self) -> None:
        planes = frozen_array(self.planes, (None, 4), "planes to keep out of")
        boxes = frozen_array(self.boxes, (None, 2, 3), "boxes to keep out of")
        lengths = np.linalg.norm(planes[:, :3], axis=1)
        if (np.abs(lengths - 1.0) > 1e-3).any():
            raise InputError(f"a plane's normal must have length 1, got {lengths.tolist()}")
        if not (boxes[:, 0] < boxes[:, 1]).all():
            raise InputError("a box to keep out of is its lower corner, then its upper")
        freeze(self, planes=planes, boxes=boxes)

    def __bool__(self) -> bool:
        return bool(len(self.planes) or len(self.boxes))


class ClosingKernel:
    """One hand and one object on a device, ready to close candidates.

    Args:
        tables: the hand's arrays, :class:`preshape.kernels.tables.HandTables`.
        distances: the object's signed distance.
        device: ``cpu`` or a CUDA device's name.
        threads: parts of a batch that run side by side on the CPU; default one for each core.
    """

    def __init__(
        self, tables: HandTables, distances: DistanceField, *, device: str = "cpu", threads: int | None = None
    ) -> None:
        from ..launch import usable_threads, warp

        self._wp = wp = warp()
        from . import warp as warp_closing
        from . import warp_clearance, warp_hand

        for module in (warp_closing, warp_clearance):
            wp.load_module(module, device=device)  # before any thread asks for it

        self.device, self.threads = device, threads or usable_threads(device)
        self.fingers, self.joints = len(tables.joint_start) - 1, len(tables.axis)
        self._widest = int(np.diff(tables.joint_start).max())
        hand, grid = warp_hand.HandArrays(), warp_hand.FieldArrays()
        for name in ("joint_start", "moving", "group_start", "group_sphere", "palm_group"):
            setattr(hand, name, wp.array(getattr(tables, name), dtype=wp.int32, device=device))
        for name in ("offset", "axis"):
            setattr(hand, name, wp.array(getattr(tables, name), dtype=wp.vec3, device=device))
        for name in ("sphere", "bound", "palm", "palm_bound"):
            setattr(hand, name, wp.array(getattr(tables, name), dtype=wp.vec4, device=device))
        for name in ("speed", "bound_speed"):
            setattr(hand, name, wp.array(getattr(tables, name), dtype=wp.float32, device=device))
        hand.turn = wp.array(_xyzw(tables.turn), dtype=wp.quat, device=device)
        hand.path = wp.array(tables.path, dtype=wp.float32, device=device)
        hand.limits = wp.array(tables.limits, dtype=wp.vec2, device=device)
        hand.fingers, hand.thumb, hand.knots = self.fingers, tables.thumb, len(tables.path)
        grid.distance = wp.array(distances.distance, dtype=wp.float32, device=device)
        grid.origin = wp.vec3(*distances.origin)
        grid.inverse_spacing = 1.0 / distances.spacing
        self.hand, self.field = hand, grid
        self._launches(warp_closing.close_hand, warp_clearance.clearances)

    def _launches(self, close: Any, clear: Any) -> None:
        from ..packed_launch import FIRST, Launch, Rows

        wp, fingers, joints, device = self._wp, self.fingers, self.joints, self.device
        how: Any = {"device": device, "threads": self.threads}

        def rows(dtype: Any, *shape: int) -> Rows:
            return Rows(dtype, *shape, device=device)

        self._in = {
            "place": rows(wp.vec3),
            "turn": rows(wp.quat),
            "start": rows(wp.float32, joints),
            "mask": rows(wp.int32),
        }
        scratch = rows(wp.vec3, self._widest), rows(wp.mat33, self._widest)
        self._out = {
            "fate": rows(wp.int32),
            "closing": rows(wp.float32, fingers),
            "sphere": rows(wp.int32, fingers),
            "points": rows(wp.vec3, CONTACTS),
            "normals_in": rows(wp.vec3, CONTACTS),
            "counts": rows(wp.int32),
        }
        settings = (0.0, 0.0, 1e-4, 3)
        self._close = Launch(
            close,
            [self.hand, self.field, *self._in.values(), *settings, FIRST, *scratch, *self._out.values()],
            **how,
        )
        self._posed = rows(wp.vec3), rows(wp.quat), rows(wp.float32, joints)
        self._to_object, self._to_rest = rows(wp.float32, fingers + 1), rows(wp.float32)
        self._kept_out: Obstacles | None = None
        self._solid = self._solids(Obstacles())
        apart = self._to_object, self._to_rest
        self._clear = Launch(
            clear, [self.hand, self.field, *self._solid.values(), *self._posed, _FAR, FIRST, *apart], **how
        )

    def close(
        self,
        candidates: Candidates,
        *,
        wanted: int = 3,
        clearance: float = 0.0,
        palm_clearance: float = 0.0,
        tolerance: float = 1e-4,
    ) -> Closings:
        """Close every candidate.

        Args:
            candidates: n of them.
            wanted: contacts that a candidate must find, the thumb's included.
            clearance: how far from the surface a finger stops [m].
            palm_clearance: how near the palm may come [m].
            tolerance: to which a finger finds that distance [m].
        """
        with self._close.lock:
            self._run(candidates, (clearance, palm_clearance, tolerance, wanted))
            return self._read(len(candidates))

    def closed(self, candidates: Candidates, *, wanted: int = 3) -> tuple[IntArray, Closings]:
        """(k,) which of the candidates closed, and how these did."""
        with self._close.lock:
            self._run(candidates, (0.0, 0.0, 1e-4, wanted))
            rows = np.flatnonzero(self._out["fate"].get(len(candidates)) == Fate.CLOSED)
            return rows, self._read(rows)

    def _run(self, candidates: Candidates, settings: tuple[float, float, float, int]) -> None:
        for name, values in zip(("place", "turn", "start", "mask"), _arrays(candidates), strict=True):
            self._in[name].put(values)
        self._close(len(candidates), dict(enumerate(settings, _SETTINGS)))

    def _read(self, which: int | IntArray) -> Closings:
        return Closings(**{name: rows.get(which) for name, rows in self._out.items()})

    def clearances(
        self,
        place: Array,
        turn: Array,
        posture: Array,
        obstacles: Obstacles | None = None,
        *,
        enough: float = math.inf,
    ) -> tuple[Array, Array]:
        """How far hands in given postures are from the object and from what is to be kept out of.

        Args:
            place: (n, 3) palm frames [m].
            turn: (n, 4) quaternions wxyz.
            posture: (n, j) joint angles [rad].
            obstacles: a table, boxes.
            enough: what is farther than this [m] is given as so far; the less, the faster.

        Returns:
            (n, f + 1) distance of each finger and, last, of the palm to the object; (n,) of the whole hand
            to the obstacles [m], negative inside.
        """
        n = len(place)
        with self._clear.lock:
            if self._kept_out is not obstacles:
                self._kept_out, self._solid = obstacles, self._solids(obstacles or Obstacles())
            for rows, values in zip(self._posed, (place, _xyzw(turn), posture), strict=True):
                rows.put(values)
            self._clear(n, {**self._solid, 7: min(float(enough), _FAR)})
            return self._to_object.get(n), self._to_rest.get(n)

    def _solids(self, rest: Obstacles) -> dict[int, Any]:
        wp = self._wp
        planes = wp.array(np.reshape(rest.planes, (-1, 4)), dtype=wp.vec4, device=self.device)
        boxes = wp.array(np.reshape(rest.boxes, (-1, 2, 3)), dtype=wp.vec3, device=self.device)
        return {2: planes, 3: boxes}


def _arrays(candidates: Candidates) -> tuple[Array, Array, Array, IntArray]:
    return candidates.place, _xyzw(candidates.turn), candidates.start, candidates.mask


def _xyzw(quaternions: Array) -> Array:
    return np.roll(quaternions, -1, axis=1)
