"""What is out of place: objects of absurd size, as files in another unit have, and misplaced obstacles."""

from __future__ import annotations

import numpy as np

from ..closure.contact_places import PartQuery
from ..exceptions import ObjectError
from ..hands.hand import Hand
from ..objects.checks import in_millimetres, other_units
from ..objects.load import read_content
from ..objects.mesh import TriangleMesh
from ..objects.obstacle import REACH, obstacle_surface, placed_file
from ..objects.read_raw import RawMesh
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
OVERLAPS = 0.2
"""An obstacle in which more than this share of the object's surface lies is not beside the object [C]. Cubes
around points of a table reach into what stands on it, but not that far."""
BELOW = 0.0005
"""Depth under the surface of the points that decide whether an obstacle overlaps the object [m] [C]."""
_POINTS = 500


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


def misplaced_obstacles(request: PlanRequest, mesh: TriangleMesh) -> list[str]:
    """A warning for each obstacle from a file that is too far away to count, or that overlaps the object.

    Raises:
        ObjectError: A file cannot be used.
        EnvironmentFailure: A file cannot be read.
    """
    if not request.obstacle:
        return []
    every = max(1, len(mesh.triangles) // _POINTS)
    inside = (mesh.corners.mean(axis=1) - BELOW * mesh.normals)[::every]
    words = []
    for text in request.obstacle:
        placed = placed_file(text)
        surface, name = obstacle_surface(placed, mesh.bounds), placed.file
        if surface is None:
            raw = read_content(name)
            extents = np.ptp(raw.vertices if isinstance(raw, RawMesh) else raw.in_metres(1.0).echoes, axis=0)
            size = " × ".join(f"{side:.3g}" for side in extents)
            words.append(
                f"the obstacle {name}, {size} m, is more than {1000 * REACH:.0f} mm from the object; it "
                "changes nothing (the file is in metres, as is its pose in the mesh frame)"
            )
        elif (share := float(PartQuery(surface).nearer(inside, 0.1 * BELOW).mean())) > OVERLAPS:
            words.append(
                f"{share:.0%} of the object's surface lies in the obstacle {name}: leave the object out of "
                "the file, or correct the pose (FILE@x,y,z,qw,qx,qy,qz)"
            )
    return words
