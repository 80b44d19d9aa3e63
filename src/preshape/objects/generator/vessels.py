"""Vessels: hollow solids of revolution with handles and spouts. Lengths in millimetres, up is +z."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .shapes import ball, curve, disc, extruded, grown, lobed, revolved, rounded, section, tube

if TYPE_CHECKING:
    from manifold3d import Manifold as Solid


def _hollow(profile: ArrayLike, wall: float, rounding: float = 0.0, foot: float = 0.0) -> Solid:
    """An open vessel: a hollow solid of revolution with a rounded rim.

    Args:
        profile: Radius and height of the outside, from the axis at the foot up to the rim [mm].
        wall: Thickness of the wall [mm].
        rounding: Radius of the corners of the outside [mm].
        foot: Thickness of the bottom minus that of the wall [mm].
    """
    half = np.asarray(profile, dtype=np.float64)
    radius, top = half[-1]
    beyond = top + 2 * wall + 3 * rounding
    half = np.vstack([half, (radius, beyond), (0, beyond)])
    outside = section(np.vstack([half, half[::-1] * (-1, 1)]), rounding)
    inside = grown(outside, -wall) ^ section(
        [(-500, wall + foot), (500, wall + foot), (500, 500), (-500, 500)]
    )
    above = section([(-500, top), (500, top), (500, 500), (-500, 500)])
    return rounded(outside - inside - above, 0.45 * wall).revolve(72)


def mug() -> Solid:
    """A coffee mug with a handle on +x."""
    cup = _hollow([(0, 0), (36, 0), (40, 6), (40, 92)], 4.0, 5.0, 2.0)
    path = curve([(37, 0, 79), (50, 0, 80), (64, 0, 70), (66, 0, 48), (57, 0, 27), (37, 0, 19)], 8)
    flare = 1 + 0.5 * np.linspace(-1, 1, len(path)) ** 8
    handle = tube(path, flare[:, None] * (4.2, 6.5))
    return cup + (handle - extruded(disc(38), 92))


def bowl() -> Solid:
    """A cereal bowl on a foot ring."""
    wall = curve([(20, 4), (36, 10), (50, 26), (55, 48)], 8)
    shell = _hollow(np.vstack([(0, 4), wall]), 3.4)
    return shell + revolved(section([(18, 0), (23, 0), (24, 7), (19, 8)], 1.2), segments=72)


def plate() -> Solid:
    """A dinner plate with a broad rim."""
    top = curve([(0, 5), (44, 5), (52, 7), (58, 13), (79, 17)], 6)
    bottom = curve([(80, 14.6), (58, 9), (50, 2.5), (46, 0), (42, 0), (38, 1.8), (0, 1.8)], 6)
    half = np.vstack([top, bottom])
    return revolved(rounded(section(np.vstack([half, half[::-1] * (-1, 1)])), 1.0), segments=72)


def wine_glass() -> Solid:
    """A wine glass: bowl, stem and foot."""
    outer = [(0, 0), (32, 0), (32, 1.6), (14, 4), (5, 9), (3.6, 20), (3.6, 58), (5, 70), (14, 78)]
    outer += [(26, 90), (33, 108), (33, 126), (28, 150)]
    inner = curve([(25.8, 150), (30.8, 126), (30.8, 108), (24, 92), (12, 81.5), (0, 78.5)], 6)
    half = np.vstack([outer[:3], curve(outer[3:], 6), inner])
    return revolved(rounded(section(np.vstack([half, half[::-1] * (-1, 1)])), 0.7))


def bottle() -> Solid:
    """A water bottle with a ribbed screw cap and a waist for the label."""
    body = [(0, 0), (31, 0), (31, 30), (28.5, 37), (28.5, 82), (31, 89), (31, 104), (12.5, 136), (12.5, 150)]
    cap = extruded(lobed(15.5, 1.0, 24), 19, 0.8).translate([0, 0, 146])
    collar = extruded(disc(16.5), 3, 1.0).translate([0, 0, 140])
    return revolved([*body, (0, 150)], 6.0) + collar + cap


def jar() -> Solid:
    """A jam jar, its ribbed lid screwed on."""
    glass = revolved([(0, 0), (33, 0), (34, 6), (34, 62), (27, 72), (27, 82), (0, 82)], 5.0)
    lid = extruded(lobed(31, 1.1, 36), 16, 1.0) + extruded(disc(26), 17.2, 1.0)
    return glass + lid.translate([0, 0, 74])


def teapot() -> Solid:
    """A round teapot with its lid on, spout on +x and handle on -x."""
    outline = [(0, 0), (26, 0), (30, 4), (44, 22), (47, 40), (38, 60), (24, 70)]
    body = revolved(np.vstack([outline[:2], curve(outline[2:], 8), (0, 70)]), 2.0, 72)
    rim = revolved(np.vstack([(0, 66), (26, 66), (27, 71), curve([(24, 73), (14, 78), (0, 80)], 6)]), 0.8)
    knob = ball(7).scale([1, 1, 0.85]).translate([0, 0, 86]) + extruded(disc(4, segments=30), 8).translate(
        [0, 0, 77]
    )
    path = curve([(36, 0, 22), (54, 0, 27), (65, 0, 44), (71, 0, 60), (82, 0, 68)], 8)
    spout = tube(path, np.linspace(13, 5.5, len(path)))
    bore = tube(np.add(path[-9:], (0.6, 0, 0.4)), np.linspace(3.0, 4.2, 9))
    path = curve([(-36, 0, 57), (-52, 0, 66), (-70, 0, 62), (-76, 0, 44), (-64, 0, 26), (-42, 0, 20)], 8)
    handle = tube(path, (5.0, 5.5) * np.ones((len(path), 1)))
    return (body + rim + knob + (spout - bore) + handle).scale([0.85, 0.85, 0.85])


def pan() -> Solid:
    """A small frying pan, its handle on +x."""
    dish = _hollow(curve([(34, 0), (40, 4), (46, 20)], 6).tolist(), 2.6, 0.0, 0.6)
    path = curve([(41, 0, 12), (56, 0, 19), (78, 0, 23), (104, 0, 24), (118, 0, 22)], 8)
    along = np.linspace(0, 1, len(path))
    across = 5.5 + 2.5 * along - 1.5 * np.sin(np.pi * along)
    handle = tube(path, np.column_stack([across, np.linspace(3.2, 4.4, len(path))]), up=(0, 1, 0))
    hole = extruded(disc(2.8, segments=32), 60).translate([112, 0, 0])
    return dish + (handle - hole - extruded(disc(42.6), 60))


def spray_bottle() -> Solid:
    """A spray bottle, its nozzle on +x and its trigger below it."""
    half = [(0, 0), (33, 0), (33, 62), (14, 100), (12, 112), (0, 112)]
    flask = revolved(half, 8.0).scale([1, 0.72, 1])
    collar = extruded(lobed(15, 0.9, 28), 14, 0.8).translate([0, 0, 106])
    outline = [(-24, 140), (-20, 152), (30, 158), (38, 158), (38, 146), (26, 144), (12, 134), (9, 118)]
    head = extruded(section([*outline, (-9, 118), (-10, 132)], 2.6), 21, 2.2)
    head = head.rotate([90, 0, 0]).translate([0, 10.5, 0])
    nozzle = extruded(lobed(6.5, 0.7, 12), 9, 0.6).rotate([0, 90, 0]).translate([36, 0, 152])
    orifice = extruded(disc(1.6, segments=16), 6).rotate([0, 90, 0]).translate([41, 0, 152])
    path = curve([(22, 0, 146), (27, 0, 134), (24, 0, 122), (28, 0, 108)], 8)
    trigger = tube(path, (2.6, 5.5) * np.ones((len(path), 1)))
    return flask + collar + head + (nozzle - orifice) + trigger
