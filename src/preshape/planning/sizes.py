"""Objects whose size is absurd for the hand, as they come from a file in another unit."""

from __future__ import annotations

from ..exceptions import ObjectError
from ..hands.hand import Hand
from ..objects.checks import in_millimetres, other_units
from ..objects.mesh import TriangleMesh
from ..types import LENGTH_UNIT

TOO_SMALL = 0.25
"""An object smaller than this share of a fingertip's width is far below the hand [C]."""
TOO_LARGE = 3.0
"""An object of which every extent exceeds 4U by this factor is far beyond the hand [C]."""
LEAST_FITTING, MOST_FITTING = 0.5, 2.0
"""Least and greatest largest extent of an object in the right unit, as shares of a fingertip's width and of
4U [C]. A hand holds objects that are somewhat longer than its reach."""


def refuse_absurd_size(mesh: TriangleMesh, hand: Hand) -> None:
    """Refuse an object far beyond the hand or far below, and name the units in which it would fit.

    Args:
        mesh: The object [m].
        hand: The hand.

    Raises:
        ObjectError: No part of the object can lie between the fingers, or it is smaller than they can hold.
    """
    width, span = hand.fingertip_width, LENGTH_UNIT * hand.u
    small = float(mesh.extents.max()) < TOO_SMALL * width
    if not small and float(mesh.extents.min()) <= TOO_LARGE * span:
        return
    than = f"its fingertips, {1000 * width:.3g} mm wide" if small else f"its reach, 4U = {1000 * span:.3g} mm"
    side = "far below" if small else "far beyond"
    units = other_units(mesh.extents, mesh.unit, LEAST_FITTING * width, MOST_FITTING * span)
    remedy = units or "check --unit and --scale; no usual unit makes it an object that this hand can grasp"
    raise ObjectError(
        f"{mesh.name} measures {in_millimetres(mesh.extents)}, {side} what the hand {hand.name} can grasp "
        f"(against {than}); {remedy}"
    )
