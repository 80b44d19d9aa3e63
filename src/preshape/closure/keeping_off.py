"""Distances of a hand from the parts that it must stay away from: by spheres, and exactly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..hands.collision import ObjectCollision
from ..hands.hand import Hand
from ..hands.kinematics import HandKinematics, LinkShape, move_shape, pose_matrix
from ..kernels.closing.host import ClosingKernel
from ..kernels.field.host import prepare_field
from ..kernels.hand_spheres import FINE
from ..types import Array, BoolArray
from .contact_places import PartQuery
from .hand_tables import hand_tables
from .rules import KEEP_OFF
from .settings import ClosureSettings

BY_SPHERES = KEEP_OFF + FINE
"""Least distance of a link's spheres from a part that is kept off [m]: links stand out of their fine spheres
by at most ``FINE``."""
CELL, MOST_NODES = 0.002, 1e6
"""Edge of a cell of a part's distance field [m], and the number of nodes above which cells are larger [C]."""
DOUBT = 0.001
"""Error of a distance by spheres that is allowed for before the shapes themselves are looked at [m] [C]."""
_EXACT = 2e-6  # accuracy of an exact distance [m]


class KeptOff:
    """One hand, and the parts of one object that are kept off.

    Distances are those of fine spheres in the links, read from a distance field of each part. With cells of
    2 mm, the interpolation adds at most 0.4 mm at an edge of a part. :meth:`exactly_near` has neither error.

    Args:
        parts: The parts.
        hand: The hand.
        settings: Device and threads.
    """

    def __init__(self, parts: Sequence[PartQuery], hand: Hand, settings: ClosureSettings) -> None:
        self._parts = parts
        self._exact: list[ObjectCollision] = []
        self._kinematics = HandKinematics(hand)
        self._kernels = []
        tables = hand_tables(hand, FINE)
        # Beyond its margin, a field is only a lower bound: the middle of the thickest link shall be within.
        thickest = max(float(spheres[:, 3].max(initial=0.0)) for spheres in (tables.sphere, tables.palm))
        padding = thickest + 2 * BY_SPHERES
        for part in self._parts:
            size = part.mesh.extents + 2 * padding
            cell = max(CELL, float(np.cbrt(size.prod() / MOST_NODES)))
            field = prepare_field(
                part.mesh,
                cells=int(np.clip(size.max() / cell, 8, 500)) + 1,
                padding=padding,
                signed=part.solid,
            )
            self._kernels.append(
                ClosingKernel(tables, field, device=settings.device, threads=settings.threads)
            )

    def __len__(self) -> int:
        return len(self._parts)

    @property
    def beside(self) -> BoolArray:
        """(m,) which parts stay where they are when the object is lifted."""
        return np.array([part.beside for part in self._parts], dtype=bool)

    def near(self, place: Array, turn: Array, posture: Array) -> BoolArray:
        """Whether the spheres of hands are within ``BY_SPHERES`` of each part.

        Args:
            place: (n, 3) origins of the palm frames in the mesh frame [m].
            turn: (n, 4) orientations of the palm frames, quaternions wxyz.
            posture: (n, j) joint angles [rad].

        Returns:
            (n, m) for each of the m parts.
        """
        return self._within(place, turn, posture, BY_SPHERES)

    def exactly_near(self, place: Array, turn: Array, posture: Array) -> BoolArray:
        """Whether the true shape of a link is within ``KEEP_OFF`` of each part, to about 1 µm.

        Shapes are those of the hand's model: spheres, capsules, boxes and the hulls of meshes. Hands whose
        spheres leave no doubt are clear without a look at the shapes.

        Args:
            place: (n, 3) origins of the palm frames in the mesh frame [m].
            turn: (n, 4) orientations of the palm frames, quaternions wxyz.
            posture: (n, j) joint angles [rad].

        Returns:
            (n, m) for each of the m parts.
        """
        found = self._within(place, turn, posture, BY_SPHERES + DOUBT)
        for row in np.flatnonzero(found.any(axis=1)):
            pose = np.concatenate([place[row], turn[row]])
            found[row] &= self._shapes_near(pose, posture[row])
        return found

    def _within(self, place: Array, turn: Array, posture: Array, distance: float) -> BoolArray:
        """(n, m) whether the spheres of n hands are within a distance [m] of each part."""
        found = np.zeros((len(place), len(self)), dtype=bool)
        for k, kernel in enumerate(self._kernels):
            apart, _ = kernel.clearances(place, turn, posture, enough=1.01 * distance)
            found[:, k] = apart.min(axis=1) < distance
        return found

    def _shapes_near(self, palm_pose: Array, q: Array) -> BoolArray:
        """(m,) whether a shape of the hand at a pose (7,) and joint angles (j,) [rad] is near each part."""
        if not self._exact:
            self._exact = [ObjectCollision(part.mesh) for part in self._parts]
        self._kinematics.set_posture(q)
        rotation, translation = pose_matrix(palm_pose)
        shapes = [move_shape(shape, rotation, translation) for shape in self._kinematics.shapes()]
        ends = [_box(shape) for shape in shapes]
        found = np.zeros(len(self), dtype=bool)
        for k, (part, surface) in enumerate(zip(self._parts, self._exact, strict=True)):
            low, high = part.mesh.bounds[0] - KEEP_OFF, part.mesh.bounds[1] + KEEP_OFF
            likely = [
                s for s, (a, b) in zip(shapes, ends, strict=True) if (a < high).all() and (b > low).all()
            ]
            found[k] = any(surface.distance(shape) < KEEP_OFF + _EXACT for shape in likely)
            if part.solid and likely and not found[k]:  # wholly inside, a shape meets no triangle
                middles = np.array([shape.corners.mean(axis=0) for shape in likely])
                found[k] = bool(part.nearer(middles, KEEP_OFF).any())
        return found


def _box(shape: LinkShape) -> tuple[Array, Array]:
    """(3,), (3,) lower and upper corner of a shape's bounding box [m]."""
    corners = shape.corners
    return corners.min(axis=0) - shape.radius, corners.max(axis=0) + shape.radius
