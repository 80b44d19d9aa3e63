"""A hand as a value: fingers, frames, limits and drives. No file and no MuJoCo here."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import HandError
from ..types import Array, freeze, frozen_array, value

POSTURES = ("open", "rest", "closed")


@value
class Finger:
    """One finger of a hand; the joints in order from the palm outwards.

    Attributes:
        name: ``thumb``, ``index`` …
        joints: joint names of the MJCF, palm outwards.
        tip_body: body of the last phalanx.
        tip_site: site at the centre of the spherical fingertip; its z points on along the last phalanx.
        tip_radius: radius of the fingertip [m].
        open: (n,) joint angles [rad], as far from the opposite finger as it goes.
        rest: (n,) joint angles [rad] in the middle of the working space.
        closed: (n,) joint angles [rad] into the palm.
        closing: (k, n) joint angles [rad] at k ≥ 2 evenly spaced points of the closing path, from open (0) to
            closed (1); straight in between.
        preshape: (n, 2) range [rad] in which a preshape may set a joint beforehand; the two are the same,
            the closing path's first value, for a joint that only the path moves.
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
            raise HandError(f"{label} must have two points at least, open and closed")

    def at(self, c: ArrayLike, preshape: ArrayLike | None = None) -> Array:
        """(..., n) joint angles [rad] at ``c`` (...) of the closing path, 0 open to 1 closed (clipped).

        Args:
            c: how far closed.
            preshape: (n,) joint angles [rad] that replace the path's first ones; the path is moved by the
                difference. Default: the path as it is.
        """
        share = np.clip(np.asarray(c, dtype=np.float64), 0.0, 1.0) * (len(self.closing) - 1)
        low = np.minimum(share.astype(np.int64), len(self.closing) - 2)
        part = (share - low)[..., None]
        # Weighed, not start + part * difference: exact at both ends.
        q = (1 - part) * self.closing[low] + part * self.closing[low + 1]
        if preshape is not None:
            q = q + (np.asarray(preshape, dtype=np.float64) - self.closing[0])
        return np.asarray(q)


@value
class Hand:
    """A hand: palm frame, fingers, sizes and limits. The thumb is the first finger.

    The palm frame has +z the way the fingers point, the thumb on the -y side (the palm faces -y) and +x
    towards the index finger of a right hand; of a left hand, away from it.

    Attributes:
        name: short name, unique; a left hand's ends in ``:left``.
        title: name for people.
        description: one sentence.
        licence: of the model.
        source: where the model and its sizes come from.
        side: ``right`` or ``left``.
        u: length of the middle finger's proximal phalanx [m]; the unit of length in wrenches.
        finger_pitch: distance between neighbouring fingers' abduction axes [m].
        fingertip_width: least distance of two neighbouring fingertips' centres [m].
        palm_body: body of the palm in the MJCF; no joint stands between it and the root.
        palm_site: site of the palm frame.
        T_root_palm: (4, 4) the palm frame in the frame of the MJCF's root body (the hand's mount).
        fingers: the thumb, then the others from the index side.
        joints: names of all joints in the order of the MJCF; the order of every posture ``q``.
        limits: (n, 2) lower and upper joint limit [rad], in the order of ``joints``.
        actuator_gain: of the position servos [N m/rad].
        actuator_damping: [N m s/rad].
        torque_limit: [N m], where ``torque_limits`` says nothing else.
        gains: (n,) servo gain of every joint [N m/rad].
        torque_limits: (n,) torque limit of every joint [N m].
        couplings: pairs of joints that one actuator drives; it sets the sum of their angles.
        actuators: joints of each actuator, in the MJCF's order: one, or the two of a coupling.
        mjcf: text of the MJCF: primitives only, nothing beside it is needed.
    """

    name: str
    title: str
    description: str
    licence: str
    source: str
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
    gains: Array
    torque_limits: Array
    couplings: tuple[tuple[str, str], ...]
    actuators: tuple[tuple[str, ...], ...]
    mjcf: str

    def __post_init__(self) -> None:
        count = len(self.joints)
        freeze(
            self,
            limits=frozen_array(self.limits, (count, 2), f"{self.name}: joint limits"),
            gains=frozen_array(self.gains, (count,), f"{self.name}: gains"),
            torque_limits=frozen_array(self.torque_limits, (count,), f"{self.name}: torque limits"),
            T_root_palm=frozen_array(self.T_root_palm, (4, 4), f"{self.name}: palm frame"),
        )

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
        if kind not in POSTURES:
            raise HandError(f"no posture {kind!r}; known: open, rest, closed")
        return self._whole({finger.name: getattr(finger, kind) for finger in self.fingers})

    def at(self, c: float | ArrayLike) -> Array:
        """(n,) joint angles [rad] at ``c`` of the closing path; one number, or (fingers,) one for each."""
        shares = np.broadcast_to(np.asarray(c, dtype=np.float64), (len(self.fingers),))
        return self._whole({f.name: f.at(share) for f, share in zip(self.fingers, shares, strict=True)})

    def controls(self, q: ArrayLike) -> Array:
        """(..., actuators) what the MJCF's actuators are told so that joints go to ``q`` (..., n)."""
        angles = frozen_array(np.atleast_2d(q), (None, len(self.joints)), "joint angles")
        at = {joint: k for k, joint in enumerate(self.joints)}
        drives = np.stack([sum(angles[:, at[j]] for j in group) for group in self.actuators], axis=-1)
        return np.asarray(drives.reshape(*np.shape(q)[:-1], len(self.actuators)))

    def _whole(self, by_finger: dict[str, Array]) -> Array:
        q = np.zeros(len(self.joints))
        for name, angles in by_finger.items():
            q[self.columns(name)] = angles
        return q
