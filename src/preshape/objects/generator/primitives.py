"""Plain solids, the first objects in training. Lengths in millimetres."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .shapes import ball, block, disc, extruded, lofted, rectangle, section

if TYPE_CHECKING:
    from manifold3d import Manifold as Solid


def cube() -> Solid:
    """The simple cube of the first training: 12 triangles, 36 mm."""
    return block(36, 36, 36)


def box() -> Solid:
    """A carton, 12 triangles."""
    return block(90, 36, 60)


def prism() -> Solid:
    """A hexagonal prism, upright."""
    return extruded(disc(26, segments=6), 70)


def pyramid() -> Solid:
    """A square pyramid."""
    return rectangle(64, 64).extrude(56, 0, 0.0, (0.0, 0.0))


def cylinder() -> Solid:
    """A plain cylinder, upright."""
    return extruded(disc(24), 80)


def cone() -> Solid:
    """A cone with a sharp point, upright."""
    return disc(30).extrude(80, 0, 0.0, (0.0, 0.0))


def sphere() -> Solid:
    """A ball."""
    return ball(30)


def ring() -> Solid:
    """A torus, lying flat."""
    turn = 2 * np.pi * np.arange(72) / 72
    around = 2 * np.pi * np.arange(28) / 28
    radius = 34 + 9 * np.cos(around)
    rings = np.stack(
        [
            np.outer(np.cos(turn), radius),
            np.outer(np.sin(turn), radius),
            np.broadcast_to(9 * np.sin(around), (72, 28)),
        ],
        axis=-1,
    )
    return lofted(rings, closed=True)


def brick() -> Solid:
    """A toy building brick with 2 by 4 studs, hollow below."""
    body = extruded(rectangle(64, 32, 1.2), 19.2, 0.6)
    hollow = extruded(rectangle(58, 26), 16)
    studs = [(x, y) for x in (-24, -8, 8, 24) for y in (-8, 8)]
    stud = extruded(disc(4.8, segments=32), 4.6, 0.4).translate([0, 0, 18.8])
    tube = extruded(disc(6.5, segments=32) - disc(4.8, segments=32), 16.5)
    brick = body - hollow
    for x, y in studs:
        brick += stud.translate([x, y, 0])
    for x in (-16, 0, 16):
        brick += tube.translate([x, 0, 0])
    return brick


def domino() -> Solid:
    """A domino stone, the three and the five, with a bar between them."""
    stone = extruded(rectangle(30, 60, 3), 10, 1.2)
    pip = ball(3.2, 24)
    corners = [(-7, -7), (7, 7), (0, 0)]
    five = [*corners, (-7, 7), (7, -7)]
    for x, y in [*[(x, y + 15) for x, y in corners], *[(x, y - 15) for x, y in five]]:
        stone -= pip.translate([x, y, 11.6])
    return stone - block(22, 1.2, 1.2).translate([0, 0, 10])


def wedge() -> Solid:
    """A door wedge."""
    return extruded(section([(0, 0), (90, 0), (90, 30), (0, 5)], 1.5), 34, 1.0).rotate([90, 0, 0])
