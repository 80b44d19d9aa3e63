"""Hand tools and small household objects. Lengths in millimetres."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...types import Array
from .shapes import curve, disc, extruded, grown, lobed, lofted, rectangle, revolved, rounded, section, tube

if TYPE_CHECKING:
    from manifold3d import Manifold as Solid

_TURN = 2 * np.pi * np.arange(32) / 32


def _stations(table: Sequence[tuple[float, ...]], per_span: int = 6) -> Array:
    """Smooth curve through the rows of a table, whose first column is the position along the object."""
    return curve(table, per_span)


def _oval_rod(table: Sequence[tuple[float, ...]], power: float = 1.0) -> Solid:
    """A rod along z through stations (z, half-width x, half-width y); power < 1 makes its section squarer."""
    c, s = np.cos(_TURN), np.sin(_TURN)
    c, s = np.sign(c) * np.abs(c) ** power, np.sign(s) * np.abs(s) ** power
    rows = _stations(table)
    return lofted([np.column_stack([x * c, y * s, np.full(32, z)]) for z, x, y in rows])


def hammer() -> Solid:
    """A claw hammer: handle along z, head at the top, face on +x and claw on -x."""
    grip = [
        (0, 9, 7), (1.5, 11.5, 8.5), (12, 12.5, 9), (40, 10.5, 7.6), (72, 11, 7.8), (100, 8, 6),
        (150, 8, 6),
    ]  # fmt: skip
    handle = _oval_rod(grip, 0.85)
    profile = [(0, 8), (9, 8), (9, 20), (8, 24), (12, 28), (12, 40), (0, 40)]
    poll = revolved(profile, 1.2).rotate([0, 90, 0]).translate([0, 0, 143])
    upper = curve([(12, 153), (-12, 153), (-32, 147), (-48, 130)], 8)
    lower = curve([(-46, 129), (-32, 138), (-12, 134), (12, 133)], 8)
    claw = extruded(section(np.vstack([upper, lower]), 1.1), 22, 0.7).rotate([90, 0, 0]).translate([0, 11, 0])
    slot = section([(-60, -3.6), (-60, 3.6), (-19, 0.9), (-18, 0), (-19, -0.9)])
    return handle + poll + (claw - extruded(slot, 60).translate([0, 0, 110]))


def screwdriver() -> Solid:
    """A flat-blade screwdriver along z, its blade pointing down."""
    ends = [(0, 74), (9, 74), (10.5, 82), (10.5, 92), (14, 102), (14, 146), (10, 158), (0, 158)]
    handle = revolved(ends, 2.5) ^ extruded(lobed(14, 2.2, 6, 12), 90).translate([0, 0, 72])
    c, s = np.cos(_TURN), np.sin(_TURN)
    square = np.minimum(1 / np.maximum(np.abs(c), 1e-9), 1 / np.maximum(np.abs(s), 1e-9))
    blade = [(0, 3.2, 0.5, 1), (8, 4.4, 1.0, 1), (16, 3.2, 2.6, 0.4), (22, 3, 3, 0), (80, 3, 3, 0)]
    rings = []
    for z, x, y, flat in blade:
        r = 1 + flat * (square - 1)
        rings.append(np.column_stack([x * r * c, y * r * s, np.full(32, z)]))
    return lofted(rings) + handle


def wrench() -> Solid:
    """A double open-ended spanner along x."""
    shape = rectangle(112, 15)
    for x, turn, radius, jaw in ((-56, 195, 18, 17), (58, 15, 14.5, 13)):
        mouth = rectangle(40, jaw).translate([22, 0])
        seat = disc(jaw / np.sqrt(3), segments=6).rotate(30)
        shape += disc(radius).translate([x, 0])
        shape -= (mouth + seat).translate([0.15 * radius, 0]).rotate(turn).translate([x, 0])
    flat = extruded(rounded(shape, 1.8), 7, 1.0)
    panel = extruded(rectangle(66, 8, 3.9), 2)
    return flat - panel.translate([0, 0, 6]) - panel.translate([0, 0, -1])


def spoon() -> Solid:
    """A table spoon along x, its bowl on -x, hollow side up."""
    table = [  # x, half-width, height, depth of the hollow, half-thickness
        (0, 0.8, 10, 0.1, 0.5), (2.5, 7, 9.2, 1.6, 0.8), (9, 13, 8, 5, 1.0), (24, 17.5, 7, 8, 1.1),
        (38, 14.5, 7.4, 6, 1.1), (47, 7.5, 9, 2, 1.3), (53, 3.6, 11.5, 0, 1.5), (66, 2.8, 15.5, 0, 1.5),
        (110, 4, 19, 0, 1.4), (140, 7, 17, 0, 1.3), (152, 6.6, 15, 0, 1.2), (156, 3.2, 14.3, 0, 1.0),
    ]  # fmt: skip
    c, s = np.cos(_TURN), np.sin(_TURN)
    s = np.sign(s) * np.abs(s) ** 0.6
    rings = [
        np.column_stack([np.full(32, x), w * c, z + d * (c**2 - 1) + t * s])
        for x, w, z, d, t in _stations(table, 6)
    ]
    return lofted(rings)


def scissors() -> Solid:
    """Household scissors, slightly open, flat on the table, the blades along +x."""
    edge = curve([(80, 0.4), (50, 7.5), (8, 9.5), (-10, 8)], 8)
    shank = curve([(-10, 8), (-22, 2), (-34, -5), (-44, -8)], 6)
    back = curve([(-44, -17), (-32, -14), (-20, -7), (-8, -2), (4, -2)], 6)
    blade = section(np.vstack([[(82, -1.4)], edge, shank[1:], back, [(80, -1.8)]]))
    bow = disc(1).scale([20, 14.5]).rotate(14).translate([-58, -17])
    eye = disc(1).scale([14.2, 9]).rotate(14).translate([-58, -17])
    half = extruded(rounded(blade, 0.5) - grown(eye, 1.5), 3.2, 0.4)
    grip = extruded(rounded(bow - eye, 2.0), 9, 2.2).translate([0, 0, -4.4])
    lower = (half.translate([0, 0, -3.2]) + grip).rotate([0, 0, 9])
    rivet = extruded(disc(5, segments=32), 9, 0.8).translate([0, 0, -4.5])
    upper = (half.mirror([0, 1, 0]) + grip.mirror([0, 1, 0])).rotate([0, 0, -9])
    return lower + upper + rivet


def pen() -> Solid:
    """A marker pen along z, its cap and clip at the top."""
    barrel = revolved([(0, 0), (1.6, 0), (2.2, 5), (4.6, 7), (5.2, 18), (7, 22), (7, 88), (0, 88)], 0.7, 48)
    cap = revolved([(0, 84), (8, 84), (8, 86), (7.6, 88), (7.6, 132), (6.4, 138), (0, 138)], 0.5, 48)
    side = curve([(6, 134), (10.5, 133), (11.2, 128), (10.4, 100), (9.4, 97)], 6)
    inner = curve([(8.6, 98), (9.0, 104), (9.4, 126), (8.6, 129), (6, 129)], 6)
    clip = extruded(section(np.vstack([side, inner])), 5, 0.25).rotate([90, 0, 0]).translate([0, 2.5, 0])
    return barrel + cap + clip


def dumbbell() -> Solid:
    """A hexagonal dumbbell along x."""
    hexagon = rounded(disc(27, segments=6), 4.0)
    head = extruded(hexagon, 34, 3.5)
    bar = revolved(
        [(0, -40), (11, -40), (11, -34), *curve([(11, -34), (14, 0), (11, 34)], 6), (11, 40), (0, 40)], 0.0
    )
    solid = bar + head.translate([0, 0, 36]) + head.translate([0, 0, -70])
    return solid.rotate([0, 0, 30]).rotate([0, 90, 0])


def phone() -> Solid:
    """A mobile phone lying on its back, its camera underneath."""
    body = extruded(rectangle(71, 146, 10), 8.4, 1.8)
    screen = extruded(rectangle(65, 140, 7.5), 2).translate([0, 0, 8.0])
    camera = extruded(rectangle(24, 24, 6), 3, 0.8).translate([-20, 56, -1.8])
    lenses = [
        extruded(disc(4, segments=32), 1).translate([x, y, -2.2]) for x, y in ((-25.5, 61), (-14.5, 51))
    ]
    button = extruded(rectangle(3, 12, 1.2), 2.4, 0.5)
    keys = button.translate([35, 30, 3]) + button.translate([-35, 34, 3]) + button.translate([-35, 18, 3])
    return body + camera + keys - screen - lenses[0] - lenses[1]


def flashlight() -> Solid:
    """A pocket torch along z, its lamp at the top."""
    half = [
        (0, 0), (11, 0), (12.5, 2), (12.5, 12), (11.5, 14), (11.5, 74), (13, 80), (19, 96), (19, 112),
        (15, 112),
    ]  # fmt: skip
    body = revolved([*half, (9, 101), (0, 99)], 0.7)
    knurl = extruded(lobed(12.6, 0.9, 24), 44, 0.4).translate([0, 0, 22])
    button = extruded(rectangle(7, 12, 3), 4, 1.2).rotate([90, 0, 0]).translate([0, -10.5, 73])
    return body + knurl + button


def toothbrush() -> Solid:
    """A toothbrush along x, its bristles up."""
    path = _stations(
        [(0, 0, 0), (10, 0, 0.6), (45, 0, 3), (75, 0, 1), (105, 0, 0.4), (130, 0, 2), (160, 0, 2)]
    )
    x = path[:, 0] / 160
    across = np.interp(
        x, [0, 0.02, 0.06, 0.35, 0.6, 0.74, 0.82, 0.97, 1], [2, 4, 5, 6.2, 3.4, 3, 5.5, 5.5, 3]
    )
    handle = tube(
        path,
        np.column_stack([across, np.interp(x, [0, 0.03, 0.4, 0.7, 1], [2, 3.2, 4, 2.6, 2])]),
        up=(0, 0, 1),
    )
    tuft = extruded(disc(1.4, segments=12), 13)
    for row in (-3.1, 0, 3.1):
        for place in np.arange(134, 157, 3.3):
            handle += tuft.translate([place, row, 2])
    return handle
