"""How an object was seen: the points of a file, and which part of a surface they show."""

from __future__ import annotations

import numpy as np

from ...exceptions import InputError
from ...types import Array, BoolArray, IntArray, freeze, frozen_array, read_only, value


@value
class RawCloud:
    """The points of a file.

    Attributes:
        points: (n, 3) positions in the file's unit; rows of NaN, or of zeros, are pixels without an echo.
        camera: (3,) position of the camera that the file names, or ``None``.
        labels: (n,) number of what each point shows, or ``None``.
        T: (4, 4) pose of the points' frame [m], if the file has one; ``camera`` is in the points' frame.
    """

    points: Array
    camera: Array | None = None
    labels: IntArray | None = None
    T: Array | None = None

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=np.float64)
        camera = None if self.camera is None else frozen_array(self.camera, (3,), "camera position")
        freeze(self, points=read_only(points), camera=camera)

    @property
    def echoes(self) -> Array:
        """(k, 3) the points without the pixels that have no echo."""
        return self.points[np.isfinite(self.points).all(axis=1) & self.points.any(axis=1)]

    def in_metres(self, factor: float) -> RawCloud:
        """The points at their place: scaled by a factor to metres, then moved by the file's pose.

        Pixels without an echo become rows of NaN, so that they are still told from points at the origin.
        """
        points = factor * self.points
        points[~np.isfinite(points).all(axis=1) | ~points.any(axis=1)] = np.nan
        camera = None if self.camera is None else factor * self.camera
        if self.T is not None:
            points = points @ self.T[:3, :3].T + self.T[:3, 3]
            camera = None if camera is None else self.T[:3, :3] @ camera + self.T[:3, 3]
        return RawCloud(points=points, camera=camera, labels=self.labels, T=self.T)


@value
class Scan:
    """How an object was seen whose surface was made from points.

    Attributes:
        points: Number of points in the file.
        camera: (3,) position of the camera in the frame of the cloud [m]; ``None`` for points from all sides.
        seen: (m,) whether each triangle was seen; the others are guessed.
        seen_share: Share of the surface that was seen, by area.
        guess: How the rest was guessed, for display.
        table: (4,) the table that was cut off, as unit normal, which is up, and offset d of the plane n·x = d
            [m]; ``None`` if none was.
        rest: (k, 3) points of a scene that are in the hand's way [m], or ``None``.
    """

    points: int
    camera: Array | None
    seen: BoolArray
    seen_share: float
    guess: str
    table: Array | None = None
    rest: Array | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.seen_share <= 1.0:
            raise InputError(f"the seen share of a surface must be in 0..1, got {self.seen_share}")
        camera = None if self.camera is None else frozen_array(self.camera, (3,), "camera position")
        table = None if self.table is None else frozen_array(self.table, (4,), "the table")
        rest = None if self.rest is None else frozen_array(self.rest, (None, 3), "the rest of the scene")
        freeze(self, table=table, rest=rest)
        freeze(self, camera=camera, seen=read_only(np.array(self.seen, dtype=bool)))
