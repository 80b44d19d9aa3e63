"""Objects that are screwed, turned or locked. Lengths in millimetres."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .shapes import block, curve, disc, extruded, lofted, rectangle, revolved, section, tube

if TYPE_CHECKING:
    from manifold3d import Manifold as Solid


def _thread(radius: float, depth: float, pitch: float, length: float) -> Solid:
    """A rod with a right-handed thread along +z from z = 0, with rounded crest and root [mm]."""
    turn = 2 * np.pi * np.arange(36) / 36
    rings = []
    for z in np.linspace(0, length, round(10 * length / pitch) + 1):
        r = radius - depth * (1 - np.cos(2 * np.pi * z / pitch - turn)) / 2
        rings.append(np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(36, z)]))
    return lofted(rings)


def _hexagon(across_flats: float, height: float) -> Solid:
    """A hexagonal prism with chamfered corners above and below, as on a nut."""
    corner = across_flats / np.sqrt(3)
    edge = 0.35 * (corner - across_flats / 2)
    r = across_flats / 2 * 0.97
    rim = corner + 0.01
    half = [(0, 0), (r, 0), (rim, 3 * edge), (rim, height - 3 * edge), (r, height), (0, height)]
    return extruded(disc(corner, segments=6), height) ^ revolved(half)


def bolt() -> Solid:
    """A hexagon-head bolt, its head at the top."""
    shank = extruded(disc(9), 30).translate([0, 0, 44])
    thread = _thread(9.6, 1.7, 4.0, 46) ^ revolved([(0, 0), (7, 0), (10, 3.4), (10, 46), (0, 46)])
    washer = extruded(disc(15.5), 2, 0.4).translate([0, 0, 73])
    return thread + shank + washer + _hexagon(32, 14).translate([0, 0, 74])


def nut() -> Solid:
    """A hexagon nut, lying flat."""
    bore = revolved([(0, -1), (13, -1), (10, 2.5), (10, 17.5), (13, 21), (0, 21)])
    cut = _thread(11.4, 1.7, 4.0, 28).translate([0, 0, -4])
    return _hexagon(38, 20) - bore - cut


def knob() -> Solid:
    """A door knob on its rose, the axis along z."""
    rose = [(0, 0), (29, 0), (29, 3), (26, 7), (0, 7)]
    neck = curve([(13, 6), (9.5, 14), (9.5, 24), (13, 31)], 6)
    grip = curve([(13, 31), (25, 37), (28, 47), (24, 58), (13, 63), (0, 64)], 8)
    return revolved(rose, 1.5) + revolved(np.vstack([(0, 5), neck, grip[1:]]))


def key() -> Solid:
    """A door key along x, lying flat."""
    bow = disc(1, segments=64).scale([13, 14.5]).translate([-22, 0]) - disc(4, (-28, 0), 32)
    teeth = [(-12, -4.6), (40, -4.6), (44, -1.5), (41, 1.5), (38, 3.6), (35, 1.4), (32, 1.4), (29, 4.6)]
    teeth += [(26, 2), (23, 4.2), (20, 0.8), (16, 0.8), (12, 4.6), (-12, 4.6)]
    groove = block(52, 1.6, 1.6)
    solid = extruded(bow + section(teeth, 0.4), 2.8, 0.35)
    panel = extruded(disc(1, segments=48).scale([5.5, 9.5]).translate([-17, 0]), 1)
    solid -= groove.translate([20, -1.8, 2.8]) + groove.translate([20, -1.8, 0])
    return solid - panel.translate([0, 0, 2.3]) - panel.translate([0, 0, -0.5])


def padlock() -> Solid:
    """A closed padlock, its shackle at the top."""
    body = extruded(rectangle(48, 20, 6), 40, 1.6)
    for z in (8, 32):
        body -= (extruded(rectangle(60, 30), 1.2) - extruded(rectangle(46.4, 18.4, 5.2), 1.2)).translate(
            [0, 0, z]
        )
    bend = np.linspace(0, np.pi, 33)
    arch = np.column_stack([15 * np.cos(bend), np.zeros(33), 56 + 15 * np.sin(bend)])
    shackle = tube(np.vstack([(15, 0, 34), arch, (-15, 0, 34)]), 4.0)
    keyhole = extruded(disc(2.6, (0, 2.5), 24) + rectangle(2.2, 7).translate([0, -1.5]), 8).translate(
        [0, 0, -1]
    )
    cylinder = extruded(disc(7.5, segments=48), 1.5, 0.4).translate([0, 0, -0.8])
    return body + cylinder + shackle - keyhole


def light_bulb() -> Solid:
    """A light bulb, its screw base at the bottom."""
    glass = curve([(13, 24), (14, 34), (20, 48), (28, 62), (30, 78), (25, 94), (13, 104), (0, 107)], 8)
    base = extruded(disc(12.2), 26).translate([0, 0, 4]) + _thread(13.4, 1.8, 4.6, 20).translate([0, 0, 5])
    tip = revolved([(0, 0), (5, 0), (6, 1.5), (12, 5), (0, 5)], 0.4)
    return revolved(np.vstack([(0, 24), glass])) + base + tip


def hand_wheel() -> Solid:
    """A valve's hand wheel, lying flat: rim with finger grips, five spokes, hub."""
    turn = 2 * np.pi * np.arange(120) / 120
    around = 2 * np.pi * np.arange(20) / 20
    tube_radius = 6.5 + 0.9 * np.cos(15 * turn)
    r = 46 + np.outer(tube_radius, np.cos(around))
    rim = lofted(
        np.stack(
            [r * np.cos(turn)[:, None], r * np.sin(turn)[:, None], np.outer(tube_radius, np.sin(around))], -1
        ),
        closed=True,
    )
    hub = extruded(disc(12), 22, 1.5).translate([0, 0, -12]) - extruded(rectangle(9, 9), 40).translate(
        [0, 0, -20]
    )
    spoke = tube(
        curve([(10, 0, -3), (24, 0, -2.5), (36, 0, 0), (46, 0, 0)], 6), (3.4, 4.4) * np.ones((19, 1))
    )
    for i in range(5):
        hub += spoke.rotate([0, 0, 72 * i])
    return rim + (hub - extruded(rectangle(9, 9), 40).translate([0, 0, -20]))
