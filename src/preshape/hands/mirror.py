"""A left hand from a right one, or the other way round: the mirror image across the plane x = 0.

Every frame of the model is mirrored across its own plane x = 0, F' = M F M with M = diag(-1, 1, 1). Then
every point of the hand, in palm coordinates, is the mirror image of the original's at the same joint angles.
"""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from ..exceptions import HandError
from .hand import Finger, Hand

_POINT = np.array([-1.0, 1.0, 1.0])
# A rotation about a by θ becomes, mirrored, one about det(M) M a by θ.
_SPIN = np.array([1.0, -1.0, -1.0])
_QUATERNION = np.array([1.0, *_SPIN])
_PRODUCTS = np.array([1.0, 1.0, 1.0, -1.0, -1.0, 1.0])  # of inertia: xx yy zz xy xz yz
_SIGNS = {
    "pos": _POINT,
    "fromto": np.concatenate([_POINT, _POINT]),
    "quat": _QUATERNION,
    "axis": _SPIN,
    "fullinertia": _PRODUCTS,
}
_UNKNOWN = ("euler", "axisangle", "xyaxes", "zaxis")
_NAMES = ("name", "joint", "tendon", "body1", "body2", "site", "body", "geom1", "geom2")


def mirrored(hand: Hand, *, rename: tuple[str, str] | None = None) -> Hand:
    """The hand of the other side; joint angles mean the same in both.

    Args:
        hand: which hand.
        rename: a beginning of names and what replaces it, as ``("rh_", "lh_")``.

    Raises:
        HandError: its MJCF turns a frame by other means than a quaternion.
    """
    side = "left" if hand.side == "right" else "right"
    flip = np.diag([*_POINT, 1.0])

    def called(word: str) -> str:
        if rename and word.startswith(rename[0]):
            return rename[1] + word[len(rename[0]) :]
        return word

    def finger(old: Finger) -> Finger:
        return replace(
            old,
            joints=tuple(called(joint) for joint in old.joints),
            tip_body=called(old.tip_body),
            tip_site=called(old.tip_site),
        )

    root = ElementTree.fromstring(hand.mjcf)
    for element in root.iter():
        _mirror(element, hand.name)
        for key in _NAMES:
            if key in element.attrib:
                element.set(key, called(element.attrib[key]))
    _explicit_axes(root)
    return replace(
        hand,
        name=f"{hand.name.removesuffix(':left').removesuffix(':right')}:{side}",
        title=f"{hand.title}, {side}",
        description=f"Mirror image of: {hand.description}",
        side=side,
        palm_body=called(hand.palm_body),
        palm_site=called(hand.palm_site),
        T_root_palm=flip @ hand.T_root_palm @ flip,
        fingers=tuple(finger(old) for old in hand.fingers),
        joints=tuple(called(joint) for joint in hand.joints),
        couplings=tuple((called(a), called(b)) for a, b in hand.couplings),
        actuators=tuple(tuple(called(joint) for joint in group) for group in hand.actuators),
        mjcf=ElementTree.tostring(root, encoding="unicode"),
    )


def _mirror(element: ElementTree.Element, hand: str) -> None:
    odd = [key for key in _UNKNOWN if key in element.attrib]
    if odd:
        raise HandError(f"hand {hand!r}: to be mirrored, its MJCF must turn frames by quat, not by {odd[0]}")
    for key, signs in _SIGNS.items():
        if key in element.attrib:
            numbers = np.array([float(x) for x in element.attrib[key].split()])
            element.set(key, " ".join(f"{x:.12g}" for x in numbers * signs + 0.0))


def _explicit_axes(root: ElementTree.Element) -> None:
    """Joints that say nothing turn about +z, which is -z in the mirror."""
    with_axis = {
        default.get("class")
        for default in root.iter("default")
        if any("axis" in joint.attrib for joint in default.findall("joint"))
    }
    for joint in root.iter("joint"):
        if "name" in joint.attrib and "axis" not in joint.attrib and joint.get("class") not in with_axis:
            joint.set("axis", "0 0 -1")
