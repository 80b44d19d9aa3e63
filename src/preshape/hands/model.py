"""A hand as a value: what the planner needs to know of it, beside its MJCF.

A hand is two files in ``preshape/hands/data``: ``NAME.toml`` (fingers, U, pitch, postures) and the MJCF it
names. Reading them imports neither MuJoCo nor any other heavy library:

>>> hand = load_hand("utah_mit")
>>> hand.u, len(hand.joints), [finger.name for finger in hand.fingers]
(0.043, 16, ['thumb', 'index', 'middle', 'ring'])
"""

from __future__ import annotations

import tomllib
from functools import cache
from importlib import resources
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..exceptions import EnvironmentFailure, HandError, InputError, UnknownHand
from ..types import Array, freeze, frozen_array, value


@value
class Finger:
    """One finger of a hand; the joints in order from the palm outwards.

    Attributes:
        name: ``thumb``, ``index`` …
        joints: joint names of the MJCF, palm outwards.
        tip_body: body of the last phalanx.
        tip_site: site at the centre of the spherical fingertip.
        tip_radius: radius of the fingertip [m].
        open: (n,) joint angles [rad], as far from the opposite finger as it goes.
        rest: (n,) joint angles [rad] in the middle of the working space.
        closed: (n,) joint angles [rad] into the palm.
    """

    name: str
    joints: tuple[str, ...]
    tip_body: str
    tip_site: str
    tip_radius: float
    open: Array
    rest: Array
    closed: Array

    def __post_init__(self) -> None:
        for posture in ("open", "rest", "closed"):
            label = f"finger {self.name}: {posture}"
            freeze(self, **{posture: frozen_array(getattr(self, posture), (len(self.joints),), label)})


@value
class Hand:
    """A hand: palm frame, fingers, sizes and limits. The thumb is the first finger.

    The palm frame has +z the way the fingers point, the thumb on the -y side and +x towards the index
    finger of a right hand.

    Attributes:
        name: short name, unique.
        title: name for people.
        description: one sentence.
        licence: of the model.
        source: where the model and its sizes come from.
        u: length of the middle finger's proximal phalanx [m]; the unit of length in wrenches.
        finger_pitch: distance between neighbouring fingers' abduction axes [m].
        fingertip_width: least distance of two neighbouring fingertips' centres [m].
        palm_body: body of the palm in the MJCF; its root.
        palm_site: site of the palm frame.
        fingers: the thumb, then the others from the index side.
        joints: names of all joints, finger by finger; the order of every posture ``q``.
        limits: (n, 2) lower and upper joint limit [rad], in the order of ``joints``.
        actuator_gain: of the position servos [N m/rad].
        actuator_damping: [N m s/rad].
        torque_limit: [N m].
        mjcf: text of the MJCF.
    """

    name: str
    title: str
    description: str
    licence: str
    source: str
    u: float
    finger_pitch: float
    fingertip_width: float
    palm_body: str
    palm_site: str
    fingers: tuple[Finger, ...]
    joints: tuple[str, ...]
    limits: Array
    actuator_gain: float
    actuator_damping: float
    torque_limit: float
    mjcf: str

    def __post_init__(self) -> None:
        freeze(self, limits=frozen_array(self.limits, (len(self.joints), 2), f"{self.name}: joint limits"))

    def finger(self, name: str) -> Finger:
        """The finger of that name.

        Raises:
            HandError: the hand has none; lists those it has.
        """
        for finger in self.fingers:
            if finger.name == name:
                return finger
        known = ", ".join(finger.name for finger in self.fingers)
        raise HandError(f"{self.name} has no finger {name!r}; it has {known}")

    def columns(self, name: str) -> slice:
        """Where a finger's joints stand in ``joints`` and in every posture ``q``."""
        finger = self.finger(name)
        start = self.joints.index(finger.joints[0])
        return slice(start, start + len(finger.joints))

    def posture(self, kind: str) -> Array:
        """(n,) joint angles [rad] of the whole hand: ``open``, ``rest`` or ``closed``."""
        if kind not in ("open", "rest", "closed"):
            raise HandError(f"no posture {kind!r}; known: open, rest, closed")
        return np.concatenate([getattr(finger, kind) for finger in self.fingers])


def hand_names() -> tuple[str, ...]:
    """Names of the hands that :func:`load_hand` knows, sorted."""
    folder = resources.files("preshape.hands") / "data"
    return tuple(sorted(file.name[:-5] for file in folder.iterdir() if file.name.endswith(".toml")))


@cache
def load_hand(name: str) -> Hand:
    """Read a hand of the package; the same value at every call.

    Raises:
        UnknownHand: no hand of that name.
        HandError: its files contradict each other.
        EnvironmentFailure: its files cannot be read.
    """
    known = hand_names()
    if name not in known:
        raise UnknownHand(name, known)
    folder = resources.files("preshape.hands") / "data"
    try:
        description = (folder / f"{name}.toml").read_text(encoding="utf-8")
        mjcf_name = tomllib.loads(description).get("mjcf", f"{name}.xml")
        mjcf = (folder / str(mjcf_name)).read_text(encoding="utf-8")
    except OSError as error:
        raise EnvironmentFailure(f"the files of hand {name!r} cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise HandError(f"hand {name!r}: the description is not valid TOML: {error}") from error
    return parse_hand(description, mjcf)


def parse_hand(description: str, mjcf: str) -> Hand:
    """A hand from the text of its TOML description and of its MJCF.

    Raises:
        HandError: a field is missing or of the wrong kind, or description and MJCF contradict each other.
    """
    try:
        data = tomllib.loads(description)
        root = ElementTree.fromstring(mjcf)
    except (tomllib.TOMLDecodeError, ElementTree.ParseError) as error:
        raise HandError(f"the hand's description cannot be read: {error}") from error
    try:
        return _build(data, root, mjcf)
    except KeyError as error:
        raise HandError(f"hand {data.get('name', '?')!r}: the description lacks {error}") from error
    except (TypeError, ValueError) as error:
        raise HandError(f"hand {data.get('name', '?')!r}: {error}") from error
    except InputError as error:
        raise HandError(str(error)) from error


def _build(data: dict[str, Any], root: ElementTree.Element, mjcf: str) -> Hand:
    name = str(data["name"])
    ranges = {joint.get("name", ""): joint.get("range") for joint in root.iter("joint") if joint.get("name")}
    bodies = {body.get("name") for body in root.iter("body")}
    sites = {site.get("name") for site in root.iter("site")}
    fingers = tuple(
        Finger(
            name=str(entry["name"]),
            joints=tuple(str(joint) for joint in entry["joints"]),
            tip_body=str(entry["tip_body"]),
            tip_site=str(entry["tip_site"]),
            tip_radius=float(entry["tip_radius"]),
            open=entry["open"],
            rest=entry["rest"],
            closed=entry["closed"],
        )
        for entry in data["finger"]
    )
    joints = tuple(joint for finger in fingers for joint in finger.joints)
    palm = data["palm"]
    _same(name, "joints", set(joints), set(ranges))
    _named(name, "body", [palm["body"], *(finger.tip_body for finger in fingers)], bodies)
    _named(name, "site", [palm["site"], *(finger.tip_site for finger in fingers)], sites)
    if len(set(joints)) != len(joints) or len({finger.name for finger in fingers}) != len(fingers):
        raise HandError(f"hand {name!r}: a finger or a joint is named twice")
    if len(fingers) < 2:
        raise HandError(f"hand {name!r}: two fingers at least, the thumb first; got {len(fingers)}")
    limits = np.array([[float(bound) for bound in (ranges[joint] or "").split()] for joint in joints])
    hand = Hand(
        name=name,
        title=str(data["title"]),
        description=str(data["description"]),
        licence=str(data["licence"]),
        source=str(data["source"]),
        u=_positive(data, "u"),
        finger_pitch=_positive(data, "finger_pitch"),
        fingertip_width=_positive(data, "fingertip_width"),
        palm_body=str(palm["body"]),
        palm_site=str(palm["site"]),
        fingers=fingers,
        joints=joints,
        limits=limits,
        actuator_gain=_positive(data["actuators"], "gain"),
        actuator_damping=_positive(data["actuators"], "damping"),
        torque_limit=_positive(data["actuators"], "torque_limit"),
        mjcf=mjcf,
    )
    for kind in ("open", "rest", "closed"):
        q = hand.posture(kind)
        outside = (q < hand.limits[:, 0]) | (q > hand.limits[:, 1])
        if outside.any():
            raise HandError(
                f"hand {name!r}: posture {kind} is outside the limits of {joints[outside.argmax()]}"
            )
    return hand


def _positive(data: dict[str, Any], key: str) -> float:
    number = float(data[key])
    if not (np.isfinite(number) and number > 0):
        raise HandError(f"the hand's {key} must be positive, got {number}")
    return number


def _same(hand: str, noun: str, described: set[str], modelled: set[str]) -> None:
    if described != modelled:
        odd = ", ".join(sorted(described ^ modelled))
        raise HandError(f"hand {hand!r}: description and MJCF do not name the same {noun}: {odd}")


def _named(hand: str, noun: str, wanted: list[str], there: set[str | None]) -> None:
    missing = [name for name in wanted if name not in there]
    if missing:
        raise HandError(f"hand {hand!r}: the MJCF has no {noun} {', '.join(missing)}")
