"""What is known about how an object was seen, beside its surface."""

from __future__ import annotations

import numpy as np

from ...exceptions import InputError
from ...types import Array, BoolArray, freeze, frozen_array, read_only, value


@value
class RawCloud:
    """A file's points.

    Attributes:
        points: (n, 3) positions in the file's unit; rows of NaN are pixels without an echo.
        camera: (3,) where the file says that they were seen from, or ``None``.
    """

    points: Array
    camera: Array | None = None

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=np.float64)
        camera = None if self.camera is None else frozen_array(self.camera, (3,), "camera position")
        freeze(self, points=read_only(points), camera=camera)


@value
class Scan:
    """What a surface was made from.

    Attributes:
        points: how many the file holds.
        camera: (3,) where they were seen from [m], cloud frame; ``None`` for points from all round.
        seen: (m,) of each triangle, whether it was seen; the others are guessed.
        seen_share: of the surface, by area.
        guess: how the rest was guessed, for people.
    """

    points: int
    camera: Array | None
    seen: BoolArray
    seen_share: float
    guess: str

    def __post_init__(self) -> None:
        if not 0.0 <= self.seen_share <= 1.0:
            raise InputError(f"the share that was seen must lie in 0..1, got {self.seen_share}")
        camera = None if self.camera is None else frozen_array(self.camera, (3,), "camera position")
        freeze(self, camera=camera, seen=read_only(np.array(self.seen, dtype=bool)))
