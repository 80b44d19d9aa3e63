"""What plain holding asks of a grip: pushes and turns, wherever they may come from, about which point."""

from __future__ import annotations

import numpy as np

from ..kernels.field.host import DistanceField
from ..objects.mesh import TriangleMesh
from ..types import Array

HOLD = np.concatenate([np.eye(6), -np.eye(6)])
"""Wrenches that plain holding is ranked by: pushes along and turns about the axes, torques over ``LEVER``."""
LEVER = 0.05
"""Torque over force of plain holding [m], as in the field's harder test; less on small objects."""
FEWEST_NODES = 50


def turn_levers(mesh: TriangleMesh, cog: Array, length: float) -> list[tuple[float, Array]]:
    """Turns that plain holding asks for about the object's own axes, where it is slender; else none.

    No push on a pen turns it about its long axis with a lever of ``LEVER``: it is as long as the object
    reaches from that axis, and half as long again.

    Args:
        mesh: the object.
        cog: (3,) the point that torques are about [m].
        length: ℓ [m].

    Returns:
        Pairs of a lever [m] and the (k, 6) wrenches that have it; none where all have that of plain holding.
    """
    whole = min(LEVER, 1.5 * length)
    middle = mesh.corners.mean(axis=1) - cog
    _, axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", mesh.areas / mesh.areas.sum(), middle, middle))
    local = (mesh.vertices - cog) @ axes
    reach = [float(np.linalg.norm(np.delete(local, k, axis=1), axis=1).max()) for k in range(3)]
    levers = [min(whole, round(1.5 * one, 6)) for one in reach]
    if min(levers) > 0.999 * whole:
        return []
    turns = np.concatenate([np.zeros((3, 3)), axes]).T
    return [
        (lever, np.concatenate([[turns[k], -turns[k]] for k in range(3) if levers[k] == lever]))
        for lever in sorted(set(levers))
    ]


def inner_centre(field: DistanceField, mesh: TriangleMesh) -> Array:
    """(3,) centre of mass of the solid [m], from the nodes inside; the COG where there are too few.

    Scans need not be watertight: the field's sign is by winding number.
    """
    inside = np.argwhere(field.distance < 0)
    if len(inside) < FEWEST_NODES:
        return mesh.cog
    return np.asarray(field.origin + field.spacing * inside.mean(axis=0))
