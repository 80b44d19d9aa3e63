"""From a hand's description (TOML) and MJCF to a :class:`Hand`, without MuJoCo or SciPy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..exceptions import HandError, InputError
from ..objects.read_text import printable
from ..spatial import pose, rotation_from_quaternion
from ..types import Array
from .couples import Table, motors_of, per_motor, positive
from .hand import POSTURES, Finger, Hand
from .motors import ADAPTIVE, Motor

_ROUNDING = 1e-4
"""Largest angle by which a posture may leave the limits because one of them was rounded [rad] [C]."""

LONGEST_MESSAGE = 1200
"""Largest number of characters of a message, because names in a file can be of any length."""


def hand_from(data: Table, mjcf: str) -> Hand:
    """Make a hand from its description and its MJCF.

    Args:
        data: The description, as read from TOML.
        mjcf: Text of the MJCF. Every joint has its own ``range``; frames are given by ``pos`` and ``quat``.

    Raises:
        HandError: A field is missing or of the wrong kind, a number is out of range, or description and MJCF
            contradict each other.
    """
    name = data.get("name", "?")
    try:
        return _hand(data, ElementTree.fromstring(mjcf), mjcf)
    except ElementTree.ParseError as error:
        raise HandError(f"the hand's MJCF cannot be read: {error}") from error
    except KeyError as error:
        raise HandError(
            printable(f"hand {name!r}: the description lacks {error}", LONGEST_MESSAGE)
        ) from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise HandError(printable(f"hand {name!r}: {error}", LONGEST_MESSAGE)) from error
    except InputError as error:
        raise HandError(printable(error, LONGEST_MESSAGE)) from error


def _hand(data: Table, root: ElementTree.Element, mjcf: str) -> Hand:
    name = str(data["name"])
    ranges = {joint.get("name", ""): joint.get("range") for joint in root.iter("joint") if joint.get("name")}
    fingers = tuple(finger_from(entry) for entry in data["finger"])
    named = [joint for finger in fingers for joint in finger.joints]
    palm = data["palm"]
    _require_same_joints(name, set(named), set(ranges))
    bodies = {body.get("name") for body in root.iter("body")}
    sites = {site.get("name") for site in root.iter("site")}
    _require(name, "body", [palm["body"], *(finger.tip_body for finger in fingers)], bodies)
    _require(name, "site", [palm["site"], *(finger.tip_site for finger in fingers)], sites)
    if len(set(named)) != len(named) or len({finger.name for finger in fingers}) != len(fingers):
        raise HandError(f"hand {name!r}: a finger or a joint is named twice")
    if len(fingers) < 2:
        raise HandError(f"hand {name!r}: it needs at least two fingers, the thumb first; got {len(fingers)}")
    joints = tuple(ranges)
    for finger in fingers:
        start = joints.index(finger.joints[0])
        if joints[start : start + len(finger.joints)] != finger.joints:
            raise HandError(
                f"hand {name!r}: the joints of finger {finger.name} must follow each other from the palm "
                f"outwards as in the MJCF, got {', '.join(finger.joints)}"
            )
    drives = data["actuators"]
    limits = np.array([[float(bound) for bound in (ranges[joint] or "").split()] for joint in joints])
    motors = motors_of(data, dict(zip(joints, limits, strict=True)), fingers, name)
    _require_drives(root, motors, name)
    names = tuple(motor.name for motor in motors)
    hand = Hand(
        name=name,
        title=str(data.get("title", name)),
        description=str(data.get("description", "")),
        licence=str(data.get("licence", "not stated")),
        credit=str(data.get("source", "not stated")),
        side=side_of(data, name),
        u=positive(data, "u"),
        finger_pitch=positive(data, "finger_pitch"),
        fingertip_width=_fingertip_width(data, fingers),
        palm_body=str(palm["body"]),
        palm_site=str(palm["site"]),
        T_root_palm=_palm_pose(root, str(palm["site"]), name),
        fingers=fingers,
        joints=joints,
        limits=limits,
        actuator_gain=positive(drives, "gain"),
        actuator_damping=positive(drives, "damping"),
        torque_limit=positive(drives, "torque_limit"),
        motors=motors,
        gains=per_motor(drives, "gain", "gains", names, name),
        torque_limits=per_motor(drives, "torque_limit", "torque_limits", names, name),
        mjcf=mjcf,
    )
    if hand.coupled:
        hand = replace(hand, fingers=tuple(_on_laws(hand, finger) for finger in hand.fingers))
    for label, q in (*((kind, hand.posture(kind)) for kind in POSTURES), *_path_postures(hand)):
        outside = (q < hand.limits[:, 0] - 1e-9) | (q > hand.limits[:, 1] + 1e-9)
        if outside.any():
            raise HandError(
                f"hand {name!r}: posture {label} is outside the limits of {joints[outside.argmax()]}"
            )
    return hand


def finger_from(entry: Table) -> Finger:
    """A finger from its table.

    Without ``closing``, the path is the straight line from the posture ``open`` to ``closed``. Without these
    postures, they are the ends of the path.

    Raises:
        HandError: Neither a closing path nor both postures are given, or a value is out of range.
        KeyError, InputError: A field is missing, or an array has the wrong length.
    """
    name, joints = str(entry["name"]), tuple(str(joint) for joint in entry["joints"])
    if "closing" not in entry and not {"open", "closed"} <= entry.keys():
        raise HandError(f"finger {name}: give closing, or open and closed")
    if not joints:
        raise HandError(f"finger {name}: a finger needs at least one joint")
    path = _numbers(entry.get("closing") or [entry["open"], entry["closed"]])
    if path.ndim != 2 or len(path) < 2 or path.shape[1] != len(joints):
        raise HandError(
            f"finger {name}: the closing path must be two lists or more of {len(joints)} angles each, "
            "one for every joint"
        )
    ranges = np.stack([path[0], path[0]], axis=1)
    for joint, bounds in dict(entry.get("preshape", {})).items():
        if joint not in joints:
            raise HandError(f"finger {name}: preshape names {joint}, which is not one of its joints")
        low, high = (float(bound) for bound in bounds)
        if not low <= high:
            raise HandError(f"finger {name}: the preshape range of {joint} has its bounds in the wrong order")
        ranges[joints.index(joint)] = low, high
    return Finger(
        name=name,
        joints=joints,
        tip_body=str(entry["tip_body"]),
        tip_site=str(entry.get("tip_site", f"{name}_tip")),
        tip_radius=positive(entry, "tip_radius"),
        open=entry.get("open", path[0]),
        rest=entry.get("rest", _middle(path)),
        closed=entry.get("closed", path[-1]),
        closing=path,
        preshape=ranges,
    )


def side_of(data: Table, name: str) -> str:
    """``right`` or ``left`` as the description says; ``right`` by default."""
    side = str(data.get("side", "right"))
    if side not in ("right", "left"):
        raise HandError(f"hand {name!r}: side must be right or left, got {side!r}")
    return side


def _on_laws(hand: Hand, finger: Finger) -> Finger:
    """The finger with postures, path and preshape ranges on the laws of its motors.

    The motor's command decides: of a rigid law the angle of its own joint, of an adaptive one the sum.
    """
    columns = hand.columns(finger.name)

    def lawful(rows: Array) -> Array:
        q = np.zeros((len(rows), len(hand.joints)))
        q[:, columns] = rows
        return hand.lawful(q)[:, columns]

    path, preshape = lawful(finger.closing), finger.preshape.copy()
    still = np.ptp(preshape, axis=1) == 0.0
    preshape[still] = path[0][still, None]
    postures = {kind: lawful(getattr(finger, kind)[None])[0] for kind in POSTURES}
    return replace(finger, closing=path, preshape=preshape, **postures)


def direction(axis: Any, label: str) -> Array:
    """(3,) unit vector of ``+x`` … ``-z``, or of three numbers.

    >>> direction("-y", "palm.faces").tolist()
    [0.0, -1.0, 0.0]

    Raises:
        HandError: It is neither.
    """
    if isinstance(axis, str) and len(axis) == 2 and axis[0] in "+-" and axis[1] in "xyz":
        vector = np.zeros(3)
        vector["xyz".index(axis[1])] = 1.0 if axis[0] == "+" else -1.0
        return vector
    if isinstance(axis, (list, tuple)) and len(axis) == 3:
        try:
            vector = np.array([float(x) for x in axis])
        except (TypeError, ValueError):
            vector = np.zeros(3)
        if np.isfinite(vector).all() and np.linalg.norm(vector) > 0:
            return np.asarray(vector / np.linalg.norm(vector))
    raise HandError(f"{label} must be an axis (+x -x +y -y +z -z) or three numbers, got {axis!r}")


def rounded_to_limits(entry: Table, ranges: dict[str, tuple[float, float]]) -> Table:
    """A finger's table, in which angles that leave their limits by a rounding error are at the limits."""
    limits = np.array([sorted(ranges[str(joint)]) for joint in entry["joints"]])
    low, high = np.where(limits[:, :1] < limits[:, 1:], limits, [-np.inf, np.inf]).T

    def near(q: Any, low: Any, high: Any) -> Any:
        angles = np.asarray(q, dtype=np.float64)
        inside = np.clip(angles, low, high)
        return np.where(np.abs(inside - angles) < _ROUNDING, inside, angles).tolist()

    made = dict(entry)
    for key in ("closing", *POSTURES):
        if key in entry:
            made[key] = near(entry[key], low, high)
    if "preshape" in entry:
        place = {str(joint): k for k, joint in enumerate(entry["joints"])}
        made["preshape"] = {
            joint: near(ends, low[place[joint]], high[place[joint]])
            for joint, ends in entry["preshape"].items()
        }
    return made


def _numbers(rows: Any) -> Array:
    """The rows as an array; an empty array if they are not numbers in rows of equal length."""
    try:
        return np.array(rows, dtype=np.float64)
    except (TypeError, ValueError):
        return np.zeros(0)


def _middle(path: Array) -> Array:
    middle = (len(path) - 1) / 2
    return np.asarray((path[int(np.floor(middle))] + path[int(np.ceil(middle))]) / 2)


def _path_postures(hand: Hand) -> Iterable[tuple[str, Array]]:
    """Every point of every closing path, with the other fingers open, and a label for each."""
    for finger in hand.fingers:
        for k, knot in enumerate(finger.closing):
            q = hand.posture("open")
            q[hand.columns(finger.name)] = knot
            yield f"{k} of the closing path of {finger.name}", q


def _fingertip_width(data: Table, fingers: tuple[Finger, ...]) -> float:
    if "fingertip_width" in data:
        return positive(data, "fingertip_width")
    return 2 * max(finger.tip_radius for finger in fingers) + 1e-3


def _palm_pose(root: ElementTree.Element, site: str, name: str) -> Array:
    """(4, 4) the palm site in the frame of the root body."""
    world = root.find("worldbody")
    tops = [] if world is None else world.findall("body")
    if len(tops) != 1:
        raise HandError(f"hand {name!r}: the MJCF must have one root body, it has {len(tops)}")

    def search(body: ElementTree.Element, T_root_body: Array) -> Array | None:
        for item in body.findall("site"):
            if item.get("name") == site:
                return np.asarray(T_root_body @ _pose_of(item))
        for child in body.findall("body"):
            found = search(child, T_root_body @ _pose_of(child))
            if found is not None:
                if child.findall("joint") or child.findall("freejoint"):
                    raise HandError(f"hand {name!r}: a joint moves the palm frame against the root body")
                return found
        return None

    found = search(tops[0], np.eye(4))
    if found is None:
        raise HandError(f"hand {name!r}: the site of the palm frame, {site}, must be below the root body")
    return found


def _pose_of(element: ElementTree.Element) -> Array:
    position = [float(x) for x in element.get("pos", "0 0 0").split()]
    quaternion = [float(x) for x in element.get("quat", "1 0 0 0").split()]
    return pose(rotation_from_quaternion(quaternion), position)


def _require_drives(root: ElementTree.Element, motors: Sequence[Motor], name: str) -> None:
    """Refuse an MJCF whose actuators are not the motors, in their order."""
    tendons = {
        str(fixed.get("name")): tuple(str(joint.get("joint")) for joint in fixed.findall("joint"))
        for fixed in root.iter("fixed")
    }
    section = root.find("actuator")
    found: list[tuple[str, ...]] = []
    for drive in [] if section is None else section:
        if drive.get("joint"):
            found.append((str(drive.get("joint")),))
        elif drive.get("tendon") in tendons:
            found.append(tendons[str(drive.get("tendon"))])
        else:
            raise HandError(f"hand {name!r}: actuator {drive.get('name')} drives neither joint nor tendon")
    wanted = [motor.joints if motor.law == ADAPTIVE else (motor.name,) for motor in motors]
    if [set(one) for one in found] != [set(one) for one in wanted]:
        raise HandError(
            f"hand {name!r}: the MJCF's actuators are not the motors {', '.join(m.name for m in motors)}, "
            "in the order of their first joints"
        )


def _require_same_joints(hand: str, described: set[str], modelled: set[str]) -> None:
    if described != modelled:
        odd = ", ".join(sorted(described ^ modelled))
        raise HandError(f"hand {hand!r}: description and MJCF do not name the same joints: {odd}")


def _require(hand: str, noun: str, wanted: list[str], there: set[str | None]) -> None:
    missing = [name for name in wanted if name not in there]
    if missing:
        raise HandError(f"hand {hand!r}: the MJCF has no {noun} {', '.join(missing)}")
