"""The dolphin, a complex organic shape: nose on +x, back up, slightly arched. Lengths in millimetres.

The body is lofted over oval rings and the fins over aerofoil sections with flared roots. Eyes, mouth line and
blowhole are added, and the whole animal is bent along an arc, as in a leap.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ...types import Array
from .shapes import ball, curve, lofted, tube

if TYPE_CHECKING:
    from manifold3d import Manifold as Solid

_LENGTH = 160.0
_BEND = 165.0

# distance from the nose, height of the widest line, reach above it, reach below it, half-width
_BODY = (
    (0.0, -3.6, 0.3, 0.3, 0.4), (0.7, -3.6, 1.3, 1.4, 1.9), (2.8, -3.6, 2.1, 2.4, 3.1),
    (8.0, -3.5, 2.5, 3.0, 3.8), (13.0, -3.2, 3.0, 3.9, 4.8), (15.6, -2.9, 4.3, 4.8, 6.1),
    (17.6, -2.4, 7.2, 5.6, 7.6), (21.0, -1.3, 10.0, 7.3, 9.4), (27.0, -0.1, 11.9, 9.7, 11.3),
    (36.0, 0.0, 13.8, 12.4, 13.2), (49.0, 0.0, 16.0, 15.0, 15.0), (63.0, 0.0, 17.2, 16.0, 15.8),
    (79.0, 0.2, 16.4, 15.2, 14.9), (97.0, 0.8, 13.5, 12.2, 12.0), (114.0, 1.4, 10.0, 8.9, 8.2),
    (130.0, 1.8, 7.2, 6.2, 5.0), (142.0, 2.0, 5.2, 4.6, 3.2), (150.0, 2.0, 3.4, 3.2, 2.6),
    (156.0, 2.0, 1.6, 1.6, 2.0), (158.0, 2.0, 0.3, 0.3, 0.5),
)  # fmt: skip

# along the span, leading edge, trailing edge, half-thickness
_DORSAL = (
    (-3.0, 56.0, 101.0, 9.0), (-1.2, 60.0, 96.5, 5.6), (0.2, 63.0, 93.8, 3.7), (2.0, 66.0, 91.6, 2.6),
    (5.0, 69.8, 89.6, 2.0), (10.0, 76.0, 89.0, 1.55), (14.5, 82.0, 90.4, 1.15), (17.8, 87.4, 92.8, 0.8),
    (19.8, 91.8, 95.0, 0.45), (20.5, 94.6, 95.8, 0.2),
)  # fmt: skip
_FLIPPER = (
    (-4.0, -10.5, 11.0, 5.5), (-1.5, -9.0, 9.2, 4.2), (0.5, -7.6, 7.8, 3.0), (3.0, -6.0, 6.7, 2.3),
    (7.0, -3.9, 6.4, 1.9), (14.0, 0.4, 8.4, 1.6), (21.0, 6.4, 12.2, 1.25), (26.5, 12.4, 16.2, 0.85),
    (29.5, 16.6, 18.8, 0.5), (30.6, 18.9, 19.8, 0.2),
)  # fmt: skip
_FLUKE = (
    (0.0, 139.0, 158.5, 3.0), (2.5, 141.5, 161.8, 2.4), (6.0, 145.0, 163.6, 1.9), (12.0, 150.4, 165.4, 1.5),
    (19.0, 157.4, 168.0, 1.15), (25.0, 164.2, 171.0, 0.8), (28.5, 169.0, 173.0, 0.5),
    (29.8, 171.8, 173.6, 0.2),
)  # fmt: skip


def _body() -> Solid:
    angle = 2 * np.pi * np.arange(52) / 52
    c, s = np.cos(angle), np.sin(angle)
    rings = []
    for x, middle, up, down, width in curve(_BODY, 4):
        height = np.where(s > 0, up, down) * s
        rings.append(np.column_stack([np.full(52, x), width * c, middle + height]))
    return lofted(rings)


def _fin(rows: ArrayLike, root: ArrayLike, span: ArrayLike, chord: ArrayLike) -> Solid:
    """A fin over aerofoil sections: ``root`` + span · row[0] + chord · (row[1] … row[2]) [mm]."""
    out, back = (np.asarray(v, dtype=np.float64) / np.linalg.norm(v) for v in (span, chord))
    normal = np.cross(out, back)
    normal /= np.linalg.norm(normal)
    turn = 2 * np.pi * np.arange(32) / 32
    u = (1 - np.cos(turn)) / 2
    profile = np.sign(np.sin(turn)) * 1.55 * np.sqrt(u) * (1 - u**1.3)
    rings = [
        root + s * out + np.outer(lead + (trail - lead) * u, back) + np.outer(half * profile, normal)
        for s, lead, trail, half in np.asarray(rows, dtype=np.float64)
    ]
    return lofted(rings)


def _bent(points: Array) -> Array:
    """Bend the points about an axis along y below the belly, nose and tail down; turn the nose to +x."""
    x, y, z = points.T
    turn = (x - 0.47 * _LENGTH) / _BEND
    reach = _BEND + z
    arch: Array = np.column_stack([-reach * np.sin(turn), -y, reach * np.cos(turn) - _BEND])
    return arch


def dolphin() -> Solid:
    """A bottlenose dolphin, leaping."""
    dorsal = _fin(curve(_DORSAL, 3), (0, 0, 22.7), (0, 0, 1), (1, 0, -0.09))
    half = curve(_FLUKE, 3)
    flukes = _fin(np.vstack([half[:0:-1] * (-1, 1, 1, 1), half]), (0, 0, 2), (0, 1, 0), (1, 0, 0))
    animal = _body() + dorsal + flukes
    flipper = _fin(curve(_FLIPPER, 3), (45, 11.0, -8.4), (0.1, 0.8, -0.6), (1, 0, -0.1))
    eye = ball(1.7, 24).translate([25.8, 10.1, 0.2])
    for side in (flipper, eye):
        animal += side + side.mirror([0, 1, 0])
    lips = [
        (25, 10.6, -2.4), (21, 9.4, -3.6), (16, 6.3, -4.3), (9, 4.0, -4.3), (2.8, 3.1, -4.2),
        (0.5, 1.5, -4.0),
    ]  # fmt: skip
    side = curve(lips, 5)
    mouth = tube(np.vstack([side, (-0.3, 0, -4.0), side[::-1] * (1, -1, 1)]), 0.55, up=(0, 0, 1), segments=10)
    return (animal - mouth - ball(1.1, 20).translate([29, 0, 12.7])).warp_batch(_bent)
