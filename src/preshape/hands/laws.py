"""The laws that a hand's model states itself: URDF ``mimic``, MJCF joint equalities and fixed tendons."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..exceptions import HandError
from .motors import ADAPTIVE, DEGREE, RIGID

if TYPE_CHECKING:
    from numpy.polynomial import Polynomial

_ZERO = 1e-12  # a coefficient below this counts as none


def model_couples(model: Any, label: str) -> tuple[dict[str, Any], ...]:
    """The couples of a compiled ``mujoco.MjModel``, in the form of ``[[couple]]`` tables.

    A joint that follows a joint which itself follows another one gets the law of both.

    Args:
        model: The model.
        label: File or name, which begins messages.

    Raises:
        HandError: A law cannot be expressed; the message names the joint.
    """
    laws = _equalities(model, label)
    motors: dict[str, dict[str, list[float]]] = {}
    for joint in laws:
        motor, law = _resolved(joint, laws, label)
        motors.setdefault(motor, {})[joint] = law
    rigid = [{"law": RIGID, "motor": motor, "follow": follow} for motor, follow in motors.items()]
    return (*rigid, *_tendons(model, set(laws)))


def _equalities(model: Any, label: str) -> dict[str, tuple[str, Polynomial]]:
    """For each joint that follows another one: that joint, and the law."""
    import mujoco
    from numpy.polynomial import Polynomial

    laws: dict[str, tuple[str, Polynomial]] = {}
    for row in range(model.neq):
        if model.eq_type[row] != mujoco.mjtEq.mjEQ_JOINT or not model.eq_active0[row]:
            continue
        first, second = int(model.eq_obj1id[row]), int(model.eq_obj2id[row])
        follower = model.joint(first).name
        if follower in laws:
            raise HandError(f"{label}: the joint {follower!r} follows two laws; only one is possible")
        if second < 0:
            raise HandError(
                f"{label}: an equality holds the joint {follower!r} at one angle: name it under fixed instead"
            )
        # MuJoCo's law is between deviations from the reference angles: q1 - r1 = P(q2 - r2).
        r1, r2 = (float(model.qpos0[model.jnt_qposadr[j]]) for j in (first, second))
        law = Polynomial(model.eq_data[row][:5])(Polynomial([-r2, 1.0])) + r1
        laws[follower] = model.joint(second).name, law
    return laws


def _resolved(joint: str, laws: dict[str, tuple[str, Polynomial]], label: str) -> tuple[str, list[float]]:
    """The joint that no law moves and that the given one follows, and the law as coefficients."""
    motor, law = laws[joint]
    seen = {joint}
    while motor in laws:
        if motor in seen:
            raise HandError(f"{label}: the joints {', '.join(sorted(seen))} follow each other in a circle")
        seen.add(motor)
        motor, inner = laws[motor]
        law = law(inner)
    coefficients = np.append(np.where(np.abs(law.coef) < _ZERO, 0.0, law.coef), 0.0)
    used = max(2, int(np.flatnonzero(coefficients).max(initial=0)) + 1)
    if used > DEGREE + 1:
        raise HandError(
            f"{label}: the joint {joint!r} follows {motor!r} by a polynomial of degree {used - 1}; at most "
            f"{DEGREE} is possible"
        )
    return motor, coefficients[:used].tolist()


def _tendons(model: Any, following: set[str]) -> list[dict[str, Any]]:
    """An adaptive couple for every fixed tendon over two joints or more that an actuator pulls."""
    import mujoco

    found = []
    for actuator in range(model.nu):
        if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_TENDON:
            continue
        tendon = int(model.actuator_trnid[actuator, 0])
        first = int(model.tendon_adr[tendon])
        wraps = range(first, first + int(model.tendon_num[tendon]))
        if any(model.wrap_type[w] != mujoco.mjtWrap.mjWRAP_JOINT for w in wraps):
            continue
        parts = {model.joint(int(model.wrap_objid[w])).name: float(model.wrap_prm[w]) for w in wraps}
        if len(parts) > 1 and not following & set(parts):
            name = model.actuator(actuator).name or model.tendon(tendon).name or "+".join(parts)
            found.append({"law": ADAPTIVE, "motor": name, "sum": parts})
    return found
