"""What is out of the hand's reach: objects of absurd size, as files in another unit have, and far boxes."""

from __future__ import annotations

import numpy as np

from ..exceptions import ObjectError
from ..hands.hand import Hand
from ..objects.checks import in_millimetres, other_units
from ..objects.mesh import TriangleMesh
from ..types import LENGTH_UNIT
from .hand_simulation import hand_geometry
from .request import PlanRequest

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


def out_of_reach(request: PlanRequest, mesh: TriangleMesh, hand: Hand) -> list[str]:
    """A warning for each box to avoid that is out of the hand's reach and so has no effect."""
    if not request.avoid:
        return []
    palm, open_hand = np.array([0.0, 0, 0, 1, 0, 0, 0]), np.zeros(len(hand.joints))
    ends = [end for part in hand_geometry(hand, palm, open_hand) for end in part.corners]
    # The checked approach starts about one hand length away from the grasp.
    reach = 2 * max(float(np.linalg.norm(end)) for end in ends) + float(np.linalg.norm(mesh.extents)) / 2
    words = []
    for box in request.avoid:
        lower, upper = np.array(box).reshape(2, 3)
        distance = float(np.linalg.norm(np.maximum(np.maximum(lower - mesh.cog, mesh.cog - upper), 0.0)))
        if distance > reach:
            numbers = " ".join(f"{x:g}" for x in box)
            words.append(
                f'the box to avoid "{numbers}" is {1000 * distance:.0f} mm from the object, out of the '
                f"hand's reach of {1000 * reach:.0f} mm; it changes nothing (boxes are in metres, mesh frame)"
            )
    return words
