"""The mirror image of a hand: a left hand from a right one, or the reverse.

Every frame F of the model is mirrored across its own plane x = 0, F' = M F M with M = diag(-1, 1, 1). Every
point of the result, in palm coordinates, is then the mirror image of the original's point at the same joint
angles.
"""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from ..exceptions import HandError
from .hand import Finger, Hand

_POINT = np.array([-1.0, 1.0, 1.0])
# The mirror image of a rotation about a by θ is the rotation about det(M) M a by θ.
_SPIN = np.array([1.0, -1.0, -1.0])
_QUATERNION = np.array([1.0, *_SPIN])
_PRODUCTS = np.array([1.0, 1.0, 1.0, -1.0, -1.0, 1.0])  # of inertia, in MJCF order: xx yy zz xy xz yz
_SIGNS = {
    "pos": _POINT,
    "fromto": np.concatenate([_POINT, _POINT]),
    "quat": _QUATERNION,
    "axis": _SPIN,
    "fullinertia": _PRODUCTS,
    "vertex": _POINT,
}
_UNKNOWN = ("euler", "axisangle", "xyaxes", "zaxis")
_NAMES = ("name", "joint", "tendon", "body1", "body2", "site", "body", "geom1", "geom2", "mesh")


def mirrored(hand: Hand, *, rename: tuple[str, str] | None = None) -> Hand:
    """Make the hand of the other side; equal joint angles give mirrored postures.

    Args:
        hand: The hand.
        rename: A prefix of names and its replacement, such as ``("rh_", "lh_")``.

    Raises:
        HandError: The MJCF gives an orientation in another form than a quaternion.
    """
    side = "left" if hand.side == "right" else "right"
    flip = np.diag([*_POINT, 1.0])

    def renamed(word: str) -> str:
        if rename and word.startswith(rename[0]):
            return rename[1] + word[len(rename[0]) :]
        return word

    def on_side(name: str) -> str:
        return f"{name.removesuffix(':left').removesuffix(':right')}:{side}"

    def finger(old: Finger) -> Finger:
        return replace(
            old,
            joints=tuple(renamed(joint) for joint in old.joints),
            tip_body=renamed(old.tip_body),
            tip_site=renamed(old.tip_site),
        )

    root = ElementTree.fromstring(hand.mjcf)
    for element in root.iter():
        _mirror(element, hand.name)
        for key in _NAMES:
            if key in element.attrib:
                element.set(key, renamed(element.attrib[key]))
    _explicit_axes(root)
    return replace(
        hand,
        name=on_side(hand.name),
        title=f"{hand.title}, {side}",
        description=f"Mirror image of: {hand.description}",
        side=side,
        palm_body=renamed(hand.palm_body),
        palm_site=renamed(hand.palm_site),
        T_root_palm=flip @ hand.T_root_palm @ flip,
        fingers=tuple(finger(old) for old in hand.fingers),
        joints=tuple(renamed(joint) for joint in hand.joints),
        motors=tuple(
            motor.renamed(renamed(motor.name), {joint: renamed(joint) for joint in motor.joints})
            for motor in hand.motors
        ),
        mjcf=ElementTree.tostring(root, encoding="unicode"),
        source=on_side(hand.source),
    )


def _mirror(element: ElementTree.Element, hand: str) -> None:
    odd = [key for key in _UNKNOWN if key in element.attrib]
    if odd:
        raise HandError(
            f"hand {hand!r} cannot be mirrored: its MJCF must give orientations by quat, not by {odd[0]}"
        )
    for key, signs in _SIGNS.items():
        if key in element.attrib:
            numbers = np.array([float(x) for x in element.attrib[key].split()])
            signs = np.resize(signs, len(numbers))  # a mesh has many vertices in one attribute
            element.set(key, " ".join(f"{x:.12g}" for x in numbers * signs + 0.0))


def _explicit_axes(root: ElementTree.Element) -> None:
    """Write the axis of joints that rely on the default +z, because its mirror image is -z."""
    with_axis = {
        default.get("class")
        for default in root.iter("default")
        if any("axis" in joint.attrib for joint in default.findall("joint"))
    }
    for joint in root.iter("joint"):
        if "name" in joint.attrib and "axis" not in joint.attrib and joint.get("class") not in with_axis:
            joint.set("axis", "0 0 -1")
