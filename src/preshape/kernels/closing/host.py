"""Closing many hands on one object: the host side of the closing kernel.

A candidate is a palm pose and a preshape. Each finger in use moves along the closing path until one of its
links touches the object. The results are the contacts. The kernel is :mod:`.warp`, on the CPU and on CUDA;
:mod:`.plain` is its specification.
"""

from __future__ import annotations

import math
from dataclasses import field
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from ...exceptions import InputError
from ...types import Array, BoolArray, IntArray, freeze, frozen_array, value

if TYPE_CHECKING:
    from ..field.host import DistanceField
    from ..tables import HandTables

CONTACTS = 8
"""Largest number of contacts of one candidate."""
CLOSING_ARRAYS = ("fate", "closing", "sphere", "points", "normals_in", "counts")
"""The arrays of :class:`Closings`, one row for each candidate."""
_FAR = 1e6  # FAR of the kernels [m]


class Fate(IntEnum):
    """How the closing of a candidate ended."""

    CLOSED = 0
    PALM_INSIDE = 1
    FINGERS_INSIDE = 2
    THUMB_MISSES = 3
    TOO_FEW = 4


@value
class Candidates:
    """n hands before they close.

    Attributes:
        place: (n, 3) origin of the palm frame in the mesh frame [m].
        turn: (n, 4) orientation of the palm frame in the mesh frame, quaternion wxyz.
        start: (n, j) joint angles of the preshape, at the beginning of the closing path [rad].
        mask: (n,) bit f is set if finger f closes.
    """

    place: Array
    turn: Array
    start: Array
    mask: IntArray

    def __len__(self) -> int:
        return len(self.place)

    def take(self, rows: IntArray) -> Candidates:
        """The candidates ``rows`` (k,), in that order."""
        return Candidates(
            place=self.place[rows], turn=self.turn[rows], start=self.start[rows], mask=self.mask[rows]
        )


@value
class Closings:
    """How n hands closed.

    Attributes:
        fate: (n,) :class:`Fate`.
        closing: (n, f) place of each finger on its closing path, 0 to 1; 0 if it touches nothing.
        sphere: (n, f) index of the touching sphere; -1 for none.
        points: (n, 8, 3) contact points in the mesh frame [m], the thumb's first; only the first ``counts``
            are filled.
        normals_in: (n, 8, 3) inward unit normals.
        counts: (n,) number of contacts; 0 unless ``CLOSED``.
    """

    fate: IntArray
    closing: Array
    sphere: IntArray
    points: Array
    normals_in: Array
    counts: IntArray

    def take(self, rows: IntArray) -> Closings:
        """The closings of candidates ``rows`` (k,), in that order."""
        return Closings(**{name: getattr(self, name)[rows] for name in CLOSING_ARRAYS})


@value
class Obstacles:
    """Solid parts of the scene, in the mesh frame, that the hand must stay out of.

    Attributes:
        planes: (k, 4) solid half-spaces n·x < d: unit normal n and offset d [m].
        boxes: (b, 2, 3) lower and upper corners of solid boxes [m].

    Raises:
        InputError: A normal does not have length 1, or a lower corner is not below the upper one.
    """

    planes: Array = field(default_factory=lambda: np.zeros((0, 4)))
    boxes: Array = field(default_factory=lambda: np.zeros((0, 2, 3)))

    def __post_init__(self) -> None:
        planes = frozen_array(self.planes, (None, 4), "planes to avoid")
        boxes = frozen_array(self.boxes, (None, 2, 3), "boxes to avoid")
        lengths = np.linalg.norm(planes[:, :3], axis=1)
        if (np.abs(lengths - 1.0) > 1e-3).any():
            raise InputError(f"a plane's normal must have length 1, got {lengths.tolist()}")
        if not (boxes[:, 0] < boxes[:, 1]).all():
            raise InputError("a box to avoid is its lower corner, then its upper")
        freeze(self, planes=planes, boxes=boxes)

    def __len__(self) -> int:
        return len(self.planes) + len(self.boxes)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the obstacles in sentences, the table first, then the boxes in their order."""
        boxes = ("the box",) if len(self.boxes) == 1 else [f"box {k + 1}" for k in range(len(self.boxes))]
        return (*["the table"] * len(self.planes), *boxes)

    @property
    def each(self) -> tuple[Obstacles, ...]:
        """Each obstacle alone, in the order of ``names``."""
        planes = [Obstacles(planes=plane[None]) for plane in self.planes]
        return (*planes, *(Obstacles(boxes=box[None]) for box in self.boxes))


class ClosingKernel:
    """One hand and one object on a device.

    Args:
        tables: The hand's arrays.
        distances: The object's signed distance field.
        device: ``cpu`` or a CUDA device's name.
        threads: Number of CPU threads; default one for each core.
    """

    def __init__(
        self, tables: HandTables, distances: DistanceField, *, device: str = "cpu", threads: int | None = None
    ) -> None:
        from ..cache import load_kernels
        from ..launch import usable_threads, warp

        self._wp = wp = warp()
        from . import warp as warp_closing
        from . import warp_clearance, warp_hand

        for module in (warp_closing, warp_clearance):
            load_kernels(module, device)

        self.device, self.threads = device, threads or usable_threads(device)
        self.fingers, self.joints = len(tables.joint_start) - 1, len(tables.axis)
        self._most_joints = int(np.diff(tables.joint_start).max())  # of one finger
        hand, grid = warp_hand.HandArrays(), warp_hand.FieldArrays()
        for name in ("joint_start", "moving", "motor", "bent", "group_start", "group_sphere", "palm_group"):
            setattr(hand, name, wp.array(getattr(tables, name), dtype=wp.int32, device=device))
        for name in ("offset", "axis"):
            setattr(hand, name, wp.array(getattr(tables, name), dtype=wp.vec3, device=device))
        for name in ("sphere", "bound", "palm", "palm_bound"):
            setattr(hand, name, wp.array(getattr(tables, name), dtype=wp.vec4, device=device))
        for name in ("speed", "bound_speed"):
            setattr(hand, name, wp.array(getattr(tables, name), dtype=wp.float32, device=device))
        hand.turn = wp.array(_xyzw(tables.turn), dtype=wp.quat, device=device)
        for name in ("path", "law", "unloaded"):
            setattr(hand, name, wp.array(getattr(tables, name), dtype=wp.float32, device=device))
        hand.range = wp.array(tables.range, dtype=wp.vec2, device=device)
        self._command = tables.command
        hand.fingers, hand.thumb, hand.knots = self.fingers, tables.thumb, len(tables.path)
        grid.distance = wp.array(distances.distance, dtype=wp.float32, device=device)
        grid.origin = wp.vec3(*distances.origin)
        grid.inverse_spacing = 1.0 / distances.spacing
        self.hand, self.field = hand, grid
        self._launches(warp_closing.close_hand, warp_clearance)

    def _launches(self, close: Any, distances: Any) -> None:
        from ..packed_launch import FIRST_ROW, DeviceRows, PackedLaunch

        wp, fingers, joints, device = self._wp, self.fingers, self.joints, self.device

        def rows(dtype: Any, *shape: int) -> DeviceRows:
            return DeviceRows(dtype, *shape, device=device)

        model = {"hand": self.hand, "field": self.field}
        self._in = {
            "place": rows(wp.vec3),
            "turn": rows(wp.quat),
            "start": rows(wp.float32, len(self._command)),
            "mask": rows(wp.int32),
        }
        settings = {
            "clearance": 0.0,
            "palm_clearance": 0.0,
            "tolerance": 1e-4,
            "wanted": 3,
            "first": FIRST_ROW,
        }
        scratch = {
            "joint_place": rows(wp.vec3, self._most_joints),
            "joint_turn": rows(wp.mat33, self._most_joints),
        }
        self._out = {
            "fate": rows(wp.int32),
            "closing": rows(wp.float32, fingers),
            "sphere": rows(wp.int32, fingers),
            "points": rows(wp.vec3, CONTACTS),
            "normals_in": rows(wp.vec3, CONTACTS),
            "counts": rows(wp.int32),
        }
        given = {**model, **self._in, **settings, **scratch, **self._out}
        self._close = PackedLaunch(close, given, device=device, threads=self.threads)
        self._posed = {"place": rows(wp.vec3), "turn": rows(wp.quat), "posture": rows(wp.float32, joints)}
        self._apart = {"to_object": rows(wp.float32, fingers + 1), "to_obstacles": rows(wp.float32)}
        self._obstacles: Obstacles | None = None
        self._solids = self._on_device(Obstacles())
        given = {**model, **self._solids, **self._posed, "enough": _FAR, "first": FIRST_ROW, **self._apart}
        self._clear = PackedLaunch(distances.clearances, given, device=device, threads=self.threads)
        self._linked = {"distance": rows(wp.float32, joints + 1), "sphere": rows(wp.int32, joints + 1)}
        self._link_posed = {
            "place": rows(wp.vec3),
            "turn": rows(wp.quat),
            "posture": rows(wp.float32, joints),
            "asked": rows(wp.bool, joints + 1),
        }
        given = {**model, **self._link_posed, "enough": _FAR, "first": FIRST_ROW, **self._linked}
        self._link = PackedLaunch(distances.link_distances, given, device=device, threads=self.threads)

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
            candidates: The n candidates.
            wanted: Least number of contacts, the thumb's included.
            clearance: Distance from the surface at which a finger stops [m].
            palm_clearance: Least distance of the palm from the surface [m].
            tolerance: Accuracy of the distance at which a finger stops [m].
        """
        with self._close.lock:
            self._run(candidates, wanted, clearance, palm_clearance, tolerance)
            return self._read(len(candidates))

    def closed(self, candidates: Candidates, *, wanted: int = 3) -> tuple[IntArray, Closings]:
        """Close every candidate; return (k,) indices of those that closed, and how these closed."""
        with self._close.lock:
            self._run(candidates, wanted)
            rows = np.flatnonzero(self._out["fate"].get(len(candidates)) == Fate.CLOSED)
            return rows, self._read(rows)

    def _run(
        self,
        candidates: Candidates,
        wanted: int,
        clearance: float = 0.0,
        palm_clearance: float = 0.0,
        tolerance: float = 1e-4,
    ) -> None:
        commands = candidates.start @ self._command.T
        arrays = candidates.place, _xyzw(candidates.turn), commands, candidates.mask
        for rows, values in zip(self._in.values(), arrays, strict=True):
            rows.put(values)
        settings = {"clearance": clearance, "palm_clearance": palm_clearance, "tolerance": tolerance}
        self._close(len(candidates), {**settings, "wanted": wanted})

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
        """Distances of hands in given postures from the object and from obstacles.

        Args:
            place: (n, 3) origins of the palm frames in the mesh frame [m].
            turn: (n, 4) orientations of the palm frames, quaternions wxyz.
            posture: (n, j) joint angles [rad].
            obstacles: Half-spaces and boxes; ``None`` for none.
            enough: Distances above this one are returned as this one [m]; a smaller value is faster.

        Returns:
            (n, f + 1) distances of the fingers and, last, of the palm from the object [m], and (n,) distances
            of the whole hand from the obstacles [m]; negative if a part is inside.
        """
        n = len(place)
        with self._clear.lock:
            if self._obstacles is not obstacles:
                self._obstacles, self._solids = obstacles, self._on_device(obstacles or Obstacles())
            for rows, values in zip(self._posed.values(), (place, _xyzw(turn), posture), strict=True):
                rows.put(values)
            self._clear(n, {**self._solids, "enough": min(float(enough), _FAR)})
            to_object, to_obstacles = self._apart.values()
            return to_object.get(n), to_obstacles.get(n)

    def link_distances(
        self,
        place: Array,
        turn: Array,
        posture: Array,
        *,
        asked: BoolArray | None = None,
        enough: float = math.inf,
    ) -> tuple[Array, IntArray]:
        """Distance from the object of each link of hands in given postures.

        Args:
            place: (n, 3) origins of the palm frames in the mesh frame [m].
            turn: (n, 4) orientations of the palm frames, quaternions wxyz.
            posture: (n, j) joint angles [rad].
            asked: (n, j + 1) which links, and last whether the palm, shall be computed; the distance of the
                others is returned as 1e6. ``None`` for all. The time is almost proportional to their number.
            enough: The distance of a link that is farther is returned as this one, without a sphere [m]; a
                smaller value is faster.

        Returns:
            (n, j + 1) signed distances of the link after each joint and, last, of the palm [m], negative if a
            link is inside, 1e6 if it has no spheres; and (n, j + 1) index of the link's nearest sphere in the
            tables' ``sphere``, for the palm in ``palm``; -1 for none.
        """
        n = len(place)
        which = np.ones((n, self.joints + 1), dtype=bool) if asked is None else asked
        with self._link.lock:
            arrays = place, _xyzw(turn), posture, which
            for rows, values in zip(self._link_posed.values(), arrays, strict=True):
                rows.put(values)
            self._link(n, {"enough": min(float(enough), _FAR)})
            distance, sphere = self._linked.values()
            return distance.get(n), sphere.get(n)

    def _on_device(self, obstacles: Obstacles) -> dict[str, Any]:
        wp = self._wp
        planes = wp.array(np.reshape(obstacles.planes, (-1, 4)), dtype=wp.vec4, device=self.device)
        boxes = wp.array(np.reshape(obstacles.boxes, (-1, 2, 3)), dtype=wp.vec3, device=self.device)
        return {"planes": planes, "boxes": boxes}


def _xyzw(quaternions: Array) -> Array:
    return quaternions[:, [1, 2, 3, 0]]
