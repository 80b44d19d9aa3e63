"""The type of a grip in the words of the GRASP taxonomy.

T. Feix, J. Romero, H.-B. Schmiedmayer, A. M. Dollar and D. Kragic, The GRASP taxonomy of human grasp types,
IEEE Transactions on Human-Machine Systems 46, 2016; M. R. Cutkosky, On grasp choice, IEEE Transactions on
Robotics and Automation 5, 1989.
"""

from __future__ import annotations

from collections import Counter
from weakref import WeakKeyDictionary

import numpy as np

from ..hiis.analyser import PALM, Grip
from ..objects.mesh import TriangleMesh
from ..objects.parts import parts_at
from ..types import Array, value

SMALL, LARGE = 0.025, 0.060
"""Opposed widths below which a wrap is of small diameter, and above which it is of large diameter [m] [C]."""
ROUND = 1.4
"""Largest ratio of the object's extents at which a wrap of it is a sphere grasp [C]."""
MOST_KEPT = 256
"""Number of answers on one mesh whose parts are remembered, because learnt grips are asked for again."""
_HELD: WeakKeyDictionary[TriangleMesh, dict[bytes, str]] = WeakKeyDictionary()
_PADS = {1: "palmar pinch", 2: "tripod", 3: "quadpod"}


@value
class GraspType:
    """What a grip is called.

    Attributes:
        name: Name in the taxonomy, such as ``medium wrap``, ``power sphere``, ``tripod`` or ``palmar pinch``.
        power: ``power`` with the palm, ``intermediate`` with several links of a finger, else ``precision``.
        opposition: ``palm`` if the palm is one of the virtual fingers, else ``pad``.
        virtual_fingers: What acts together against the others: the thumb or, if it does not touch, the palm;
            then the fingers; then the palm.
    """

    name: str
    power: str
    opposition: str
    virtual_fingers: tuple[tuple[str, ...], ...]


def grasp_type(grip: Grip, thumb: str, extents: Array) -> GraspType:
    """The type of a grip.

    Args:
        grip: The grip.
        thumb: Name of the thumb.
        extents: (3,) extents of the object [m].
    """
    parts = list(dict.fromkeys(grip.fingers_touching))
    fingers = tuple(part for part in parts if part not in (thumb, PALM))
    palm = (PALM,) * (PALM in parts)
    groups = ((thumb,) * (thumb in parts), fingers, palm)
    several = len(grip.fingers_touching) - grip.fingers_touching.count(PALM) > len(parts) - len(palm)
    power = "power" if palm else "intermediate" if several else "precision"
    if power == "precision":
        name = _PADS.get(len(fingers), "precision disk")
    elif palm and float(np.max(extents) / np.min(extents)) < ROUND and len(fingers) > 1:
        name = "power sphere"
    elif not palm:
        name = "finger wrap"
    else:
        width = _opposed(grip, thumb)
        name = "small diameter" if width < SMALL else "large diameter" if width > LARGE else "medium wrap"
    return GraspType(
        name=name,
        power=power,
        opposition="palm" if palm else "pad",
        virtual_fingers=tuple(group for group in groups if group),
    )


def held_part(mesh: TriangleMesh, points: Array) -> str:
    """The part on which most contacts lie; among equals the first contact's. Empty if they lie on no part.

    Args:
        mesh: The object [m].
        points: (n, 3) contacts in the mesh frame [m].
    """
    if not mesh.parts:
        return ""
    kept = _HELD.setdefault(mesh, {})
    key = points.tobytes()
    if key not in kept:
        if len(kept) >= MOST_KEPT:
            kept.clear()
        names = [name for name in parts_at(mesh, points) if name]
        kept[key] = Counter(names).most_common(1)[0][0] if names else ""
    return kept[key]


def _opposed(grip: Grip, thumb: str) -> float:
    """Distance between the thumb's contacts, or the palm's without it, and those of the others [m]."""
    names = np.array(grip.fingers_touching)
    one = names == (thumb if thumb in names else PALM)
    points = grip.contacts.points
    if one.all() or not one.any():
        return float(np.linalg.norm(np.ptp(points, axis=0)))
    return float(np.linalg.norm(points[one].mean(axis=0) - points[~one].mean(axis=0)))
