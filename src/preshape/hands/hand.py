"""A hand as a value: fingers, frames, limits and drives. This module reads no file and imports no MuJoCo."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import HandError, shown
from ..types import LONGEST_NAME, Array, IntArray, freeze, frozen_array, value
from .motors import Motor

LONGEST_HAND_NAME = LONGEST_NAME - 55
"""Largest number of characters of a hand's name; the memory adds the analyser's to it."""

POSTURES = ("open", "rest", "closed")

_NO_SHAPE = {"actuator", "option", "inertial", "size", "statistic", "visual", "custom", "keyframe", "sensor"}
"""Elements of an MJCF that say nothing of kinematics and shapes."""
_NO_PLACE = {
    *("mass", "density", "balanceinertia", "damping", "armature", "frictionloss", "actuatorfrcrange"),
    *("stiffness", "springdamper", "solreflimit", "solimplimit", "margin", "gap"),
    *("friction", "condim", "priority", "solref", "solimp", "solmix", "solreffriction", "solimpfriction"),
    *("rgba", "material", "group"),
}
"""Attributes of an MJCF that say nothing of kinematics and shapes."""
_HASH_DIGITS, _HASH_DECIMALS = 16, 9


@value
class Finger:
    """One finger of a hand; its n joints are in order from the palm outwards.

    Attributes:
        name: ``thumb``, ``index`` …
        joints: Joint names of the MJCF.
        tip_body: Body of the last phalanx.
        tip_site: Site at the centre of the spherical fingertip; its +z points along the last phalanx,
            outwards.
        tip_radius: Radius of the fingertip [m].
        open: (n,) joint angles [rad] with the fingertip as far from the opposite finger as possible.
        rest: (n,) joint angles [rad] with the fingertip in the middle of its working space.
        closed: (n,) joint angles [rad] with the finger bent into the palm.
        closing: (k, n) joint angles [rad] at k ≥ 2 evenly spaced points of the closing path, from open (0) to
            closed (1); linear in between.
        preshape: (n, 2) range [rad] in which a preshape may set a joint before the finger closes. For a joint
            that only the closing path moves, both bounds are the path's first angle.
    """

    name: str
    joints: tuple[str, ...]
    tip_body: str
    tip_site: str
    tip_radius: float
    open: Array
    rest: Array
    closed: Array
    closing: Array
    preshape: Array

    def __post_init__(self) -> None:
        count = len(self.joints)
        for posture in POSTURES:
            label = f"finger {self.name}: {posture}"
            freeze(self, **{posture: frozen_array(getattr(self, posture), (count,), label)})
        label = f"finger {self.name}: closing"
        freeze(self, closing=frozen_array(self.closing, (None, count), label))
        freeze(self, preshape=frozen_array(self.preshape, (count, 2), f"finger {self.name}: preshape"))
        if len(self.closing) < 2:
            raise HandError(f"{label} must have at least two points, open and closed")

    def at(self, c: ArrayLike, preshape: ArrayLike | None = None) -> Array:
        """(..., n) joint angles [rad] at ``c`` (...) of the closing path.

        Args:
            c: Place on the path, 0 open to 1 closed; clipped to this range.
            preshape: (n,) joint angles [rad] at which the path begins; the whole path is shifted by the
                difference from its first point. By default the path is not shifted.
        """
        share = np.clip(np.asarray(c, dtype=np.float64), 0.0, 1.0) * (len(self.closing) - 1)
        low = np.minimum(share.astype(np.int64), len(self.closing) - 2)
        part = (share - low)[..., None]
        # A weighted sum is exact at both ends; start + part * difference is not.
        q = (1 - part) * self.closing[low] + part * self.closing[low + 1]
        if preshape is not None:
            q = q + (np.asarray(preshape, dtype=np.float64) - self.closing[0])
        return np.asarray(q)


@value
class Hand:
    """A hand: palm frame, fingers, sizes and limits. The thumb is the first finger.

    In the palm frame the fingers point along +z, the palm faces -y and the thumb is on the -y side; +x points
    to the index side of a right hand, and away from it for a left hand.

    Attributes:
        name: Short name, unique; that of a left hand ends in ``:left``.
        title: Name for people.
        description: One sentence.
        licence: Licence of the model.
        credit: Where the model and its sizes come from (``source`` in the TOML).
        side: ``right`` or ``left``.
        u: Length of the middle finger's proximal phalanx, U [m].
        finger_pitch: Distance between the abduction axes of neighbouring fingers [m].
        fingertip_width: Least distance between the centres of two neighbouring fingertips [m].
        palm_body: Body of the palm in the MJCF; no joint moves it relative to the root body.
        palm_site: Site of the palm frame.
        T_root_palm: (4, 4) the palm frame in the frame of the MJCF's root body, the hand's mount.
        fingers: The thumb, then the other fingers from the index side.
        joints: Names of all joints in the order of the MJCF, which is the order of every posture ``q``.
        limits: (n, 2) lower and upper joint limit [rad].
        actuator_gain: Gain [N m/rad] of the position servos of motors without an entry of their own.
        actuator_damping: Damping of the position servos [N m s/rad].
        torque_limit: Torque limit [N m] of motors without an entry of their own.
        motors: The motors, in the order of their first joints; every joint belongs to one of them. The MJCF
            has one actuator for each, in this order, and no other.
        gains: (m,) servo gain of every motor [N m/rad], about its command.
        torque_limits: (m,) torque limit of every motor [N m].
        mjcf: Text of the MJCF. It has primitive shapes only and needs no other file.
        source: What :func:`~preshape.hands.load.load_hand` takes to load this hand again: a name, or the
            absolute path of its TOML file, with ``:left`` or ``:right`` for a mirror image. Default ``name``.
    """

    name: str
    title: str
    description: str
    licence: str
    credit: str
    side: str
    u: float
    finger_pitch: float
    fingertip_width: float
    palm_body: str
    palm_site: str
    T_root_palm: Array
    fingers: tuple[Finger, ...]
    joints: tuple[str, ...]
    limits: Array
    actuator_gain: float
    actuator_damping: float
    torque_limit: float
    motors: tuple[Motor, ...]
    gains: Array
    torque_limits: Array
    mjcf: str
    source: str = ""

    def __post_init__(self) -> None:
        if len(self.name) > LONGEST_HAND_NAME:
            raise HandError(
                f"a hand's name must have at most {LONGEST_HAND_NAME} characters, got {len(self.name)}"
            )
        count, motors = len(self.joints), len(self.motors)
        if sorted(joint for motor in self.motors for joint in motor.joints) != sorted(self.joints):
            raise HandError(f"{self.name}: every joint must follow exactly one motor")
        freeze(
            self,
            limits=frozen_array(self.limits, (count, 2), f"{self.name}: joint limits"),
            gains=frozen_array(self.gains, (motors,), f"{self.name}: gains"),
            torque_limits=frozen_array(self.torque_limits, (motors,), f"{self.name}: torque limits"),
            T_root_palm=frozen_array(self.T_root_palm, (4, 4), f"{self.name}: palm frame"),
            source=self.source or self.name,
        )

    def model_hash(self) -> str:
        """Hash of what a stored grip depends on: kinematics, shapes, laws, closing paths and preshapes.

        Names and texts about the hand, its folder, gains, torque limits, masses and friction do not matter.

        Returns:
            16 lower-case hexadecimal digits.

        Raises:
            HandError: The MJCF is not XML.
        """
        try:
            tree = ElementTree.fromstring(self.mjcf)
        except ElementTree.ParseError as error:
            raise HandError(f"{self.name}: the MJCF is not XML: {error}") from error
        tree.attrib.clear()  # the model's name
        numbers: list[ArrayLike] = [[self.u], self.T_root_palm, self.limits]
        for finger in self.fingers:
            numbers += [[finger.tip_radius], finger.closing, finger.preshape]
        for motor in self.motors:
            numbers += [motor.weights, motor.polynomials, motor.path, motor.range]
        words: list[Any] = [self.joints, [finger.joints for finger in self.fingers]]
        words += [[motor.joints, motor.law, motor.order, motor.locks] for motor in self.motors]
        state = hashlib.sha256(repr((words, _model_content(tree))).encode())
        for array in numbers:
            # Zero is added to make -0 and 0 alike.
            rounded = np.round(np.asarray(array, dtype=np.float64), _HASH_DECIMALS) + 0.0
            state.update(repr(rounded.shape).encode() + rounded.astype("<f8").tobytes())
        return state.hexdigest()[:_HASH_DIGITS]

    def finger(self, name: str) -> Finger:
        """The finger of that name.

        Raises:
            HandError: The hand has no such finger; the message lists those it has.
        """
        for finger in self.fingers:
            if finger.name == name:
                return finger
        known = ", ".join(finger.name for finger in self.fingers)
        raise HandError(f"{self.name} has no finger {shown(name)}; it has {known}")

    def columns(self, name: str) -> slice:
        """Columns of a finger's joints in ``joints`` and in every posture ``q``."""
        finger = self.finger(name)
        start = self.joints.index(finger.joints[0])
        return slice(start, start + len(finger.joints))

    @property
    def coupled(self) -> bool:
        """Whether a motor moves more than one joint."""
        return len(self.motors) < len(self.joints)

    def motor_columns(self) -> list[list[int]]:
        """For every motor the columns of its joints in ``joints``; do not change them."""
        return _drives(self).columns

    def posture(self, kind: str) -> Array:
        """(n,) joint angles [rad] of the whole hand in the posture ``open``, ``rest`` or ``closed``."""
        if kind not in POSTURES:
            raise HandError(f"no posture {shown(kind)}; known: {', '.join(POSTURES)}")
        return self._whole({finger.name: getattr(finger, kind) for finger in self.fingers})

    def at(self, c: float | ArrayLike) -> Array:
        """(n,) joint angles [rad] at ``c`` (0 open, 1 closed) of the closing path; a number or (fingers,)."""
        shares = np.broadcast_to(np.asarray(c, dtype=np.float64), (len(self.fingers),))
        q = self._whole({f.name: f.at(share) for f, share in zip(self.fingers, shares, strict=True)})
        return self.follow(self.controls(q))

    def command_matrix(self) -> Array:
        """(m, n) matrix W that gives the motors' commands of a posture, m = W q; read-only."""
        return _drives(self).command

    def controls(self, q: ArrayLike) -> Array:
        """(..., m) commands [rad] of the motors in postures ``q`` (..., n) [rad]."""
        angles = frozen_array(np.atleast_2d(q), (None, len(self.joints)), "joint angles")
        commands = angles @ self.command_matrix().T
        return np.asarray(commands.reshape(*np.shape(q)[:-1], len(self.motors)))

    def follow(self, commands: ArrayLike) -> Array:
        """(..., n) postures [rad] taken at commands (..., m) [rad] while nothing touches the hand."""
        m, drives = np.asarray(commands, dtype=np.float64), _drives(self)
        q = np.asarray(m[..., drives.owner] * drives.slope + drives.offset)
        for k in drives.curved:
            q[..., drives.columns[k]] = self.motors[k].angles(m[..., k])
        return q

    def lawful(self, q: ArrayLike) -> Array:
        """(..., n) postures with the commands of ``q``, on the motors' laws and within their ranges."""
        low, high = self.ranges().T
        return self.follow(np.clip(self.controls(q), low, high))

    def rates(self, q: ArrayLike) -> Array:
        """(n, m) derivatives of the joint angles by the motors' commands, in the posture ``q`` (n,) [rad].

        A motor's torque is the sum of the torques of its joints times their rates, by virtual work. If all
        laws are linear, the matrix is the same in every posture, and read-only.
        """
        drives = _drives(self)
        if not drives.curved:
            return drives.rates
        matrix, commands = drives.rates.copy(), self.controls(q)
        for k in drives.curved:
            matrix[drives.columns[k], k] = self.motors[k].rates(float(commands[k]))
        return matrix

    def ranges(self) -> Array:
        """(m, 2) least and largest command of every motor [rad]; read-only."""
        return _drives(self).ranges

    def motor_facts(self) -> list[dict[str, Any]]:
        """What a reader of a plan must know of the motors to send it to other servos; JSON values."""
        return [
            {
                "name": motor.name,
                "law": motor.law,
                "joints": list(motor.joints),
                "weights": motor.weights.tolist(),
                "polynomials": None
                if len(motor.path)
                else [_trimmed(law.tolist()) for law in motor.polynomials],
                "unloaded": motor.path.tolist() if len(motor.path) else None,
                "order": [list(pair) for pair in motor.order],
                "locks": motor.locks or None,
                "range": motor.range.tolist(),
                "gain": float(gain),
                "damping": self.actuator_damping,
                "torque_limit": float(limit),
            }
            for motor, gain, limit in zip(self.motors, self.gains, self.torque_limits, strict=True)
        ]

    def _whole(self, by_finger: dict[str, Array]) -> Array:
        q = np.zeros(len(self.joints))
        for name, angles in by_finger.items():
            q[self.columns(name)] = angles
        return q


class _Drives(NamedTuple):
    """The motors of a hand as arrays; inverse kinematics asks for them at every evaluation.

    Attributes:
        columns: For every motor the columns of its joints.
        command: (m, n) matrix W of :meth:`Hand.command_matrix`.
        ranges: (m, 2) least and largest command of every motor [rad].
        owner: (n,) motor of every joint.
        slope: (n,) derivative of every joint by its motor's command; of no meaning for a curved law.
        offset: (n,) angle of every joint at command 0 [rad]; of no meaning for a curved law.
        rates: (n, m) derivatives by the commands; of no meaning in the columns of curved laws.
        curved: Motors whose joints are not linear functions of the command.
    """

    columns: list[list[int]]
    command: Array
    ranges: Array
    owner: IntArray
    slope: Array
    offset: Array
    rates: Array
    curved: list[int]


@lru_cache(maxsize=64)
def _drives(hand: Hand) -> _Drives:
    at, n, m = {joint: k for k, joint in enumerate(hand.joints)}, len(hand.joints), len(hand.motors)
    columns = [[at[joint] for joint in motor.joints] for motor in hand.motors]
    command, rates = np.zeros((m, n)), np.zeros((n, m))
    owner, slope, offset = np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(n)
    for k, (motor, own) in enumerate(zip(hand.motors, columns, strict=True)):
        command[k, own], owner[own] = motor.weights, k
        offset[own], slope[own] = motor.polynomials[:, 0], motor.polynomials[:, 1]
        rates[own, k] = slope[own]
    ranges = np.array([motor.range for motor in hand.motors])
    for array in (command, ranges, rates):
        array.flags.writeable = False
    curved = [k for k, motor in enumerate(hand.motors) if not motor.affine]
    return _Drives(columns, command, ranges, owner, slope, offset, rates, curved)


def _model_content(element: ElementTree.Element) -> tuple[Any, ...]:
    """What an element of an MJCF says of kinematics and shapes, with everything in it."""
    attributes = sorted((name, text) for name, text in element.attrib.items() if name not in _NO_PLACE)
    return element.tag, attributes, [_model_content(one) for one in element if one.tag not in _NO_SHAPE]


def _trimmed(numbers: list[float]) -> list[float]:
    """The numbers without the zeros at their end."""
    while numbers and numbers[-1] == 0.0:
        numbers.pop()
    return numbers
