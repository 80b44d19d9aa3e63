"""Torque limits and gains of a model's motors: from its file where that is plausible, else guessed.

A URDF that states no effort, or zero, does not know it. A placeholder (an effort of 1000, or one that no
finger of this size has) counts as unknown too.
"""

from __future__ import annotations

import numpy as np

from ..types import value
from .anatomy import Anatomy
from .digits import Digit, tip_of
from .skeleton import Skeleton

WEAKEST, STRONGEST = 0.1, 80.0
"""Plausible forces of a finger at its tip [N] [C]."""

_GUESS = 10.0
"""Force at the fingertip that is guessed for an unknown motor [N] [C]."""

_LEAST, _MOST = 0.1, 2.0
"""Range of guessed torque limits [N m] [C]."""

_STIFFNESS = 5.0
"""Guessed gain per torque limit [1/rad] [C]: the motor reaches its limit at an error of 0.2 rad."""

_SETTLING = 0.02
"""Damping per gain [s] [C]."""


@value
class Motors:
    """Guessed or stated motors.

    Attributes:
        torques: Torque limit of every motor [N m].
        gains: Gain of every motor [N m/rad].
        damping: Damping of all servos [N m s/rad].
        from_file: Names of the motors whose torque limit is the file's.
        why: Why the others were guessed, in a few words; empty if none was.
    """

    torques: dict[str, float]
    gains: dict[str, float]
    damping: float
    from_file: tuple[str, ...]
    why: str


def motors_of(skeleton: Skeleton, found: Anatomy) -> Motors:
    """The motors of the fingers of a model."""
    stated, gains = _stated(skeleton)
    torques: dict[str, float] = {}
    known, odd, silent = [], [], 0
    for digit in found.digits:
        for drive in digit.drives:
            lever = max(_lever(skeleton, digit, joint) for joint in drive.joints)
            own = stated.get(drive.motor, stated.get(drive.joints[0], 0.0))
            if own > 0 and WEAKEST <= own / lever <= STRONGEST:
                torques.setdefault(drive.motor, own)
                known.append(drive.motor)
                continue
            if own > 0:
                odd.append(own)
            else:
                silent += 1
            torques.setdefault(drive.motor, round(float(np.clip(_GUESS * lever, _LEAST, _MOST)), 2))
    reasons = [f"{max(odd):g} N m in the file is no finger's"] if odd else []
    reasons += ["the file states no effort"] if silent else []
    stiffness = {motor: gains.get(motor, round(_STIFFNESS * torque, 2)) for motor, torque in torques.items()}
    return Motors(
        torques=torques,
        gains=stiffness,
        damping=round(_SETTLING * float(np.median(list(stiffness.values()))), 4),
        from_file=tuple(dict.fromkeys(known)),
        why=" and ".join(reasons),
    )


def _lever(skeleton: Skeleton, digit: Digit, joint: str) -> float:
    """Distance of the fingertip from a joint's axis [m], at least a centimetre.

    A finger that points along the axis of a joint has nearly none until it bends, so several postures count.
    """
    arms = []
    for share in (0.0, 0.3, 0.6):
        tip = tip_of(skeleton, digit, digit.at(share))
        axis, arm = skeleton.axis(joint), tip - skeleton.anchor(joint)
        arms.append(max(float(np.linalg.norm(arm - (arm @ axis) * axis)), 0.4 * float(np.linalg.norm(arm))))
    return max(0.01, *arms)


def _stated(skeleton: Skeleton) -> tuple[dict[str, float], dict[str, float]]:
    """Torque limits [N m] and gains [N m/rad] that the model states, by motor or joint."""
    import mujoco

    m = skeleton.m
    torques: dict[str, float] = {}
    gains: dict[str, float] = {}
    for joint in skeleton.source.joints:
        j = m.joint(joint).id
        if m.jnt_actfrclimited[j]:
            torques[joint] = float(np.abs(m.jnt_actfrcrange[j]).max())
    groups = {frozenset(motor.joints): motor.name for motor in skeleton.motors.values()}
    for a in range(m.nu):
        target = int(m.actuator_trnid[a, 0])
        if m.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT:
            motor = str(m.joint(target).name)
        elif m.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_TENDON:
            first, count = int(m.tendon_adr[target]), int(m.tendon_num[target])
            group = frozenset(str(m.joint(int(j)).name) for j in m.wrap_objid[first : first + count])
            motor = groups.get(group, "")
        else:
            continue
        gear, gain = abs(float(m.actuator_gear[a, 0])), float(m.actuator_gainprm[a, 0])
        servo = m.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE and m.actuator_biasprm[a, 1] < 0
        if servo and gain > 0:
            gains[motor] = gain * gear**2
        if m.actuator_forcelimited[a]:
            torques[motor] = gear * float(np.abs(m.actuator_forcerange[a]).max())
        elif not servo and m.actuator_ctrllimited[a] and motor not in torques:
            torques[motor] = gear * gain * float(np.abs(m.actuator_ctrlrange[a]).max())
    return torques, gains
