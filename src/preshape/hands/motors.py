"""Motors of a hand, and the laws by which joints follow them.

A hand has motors; a joint follows one of them. There are three laws:

- ``direct``: the joint is the motor's own, q = m.
- ``rigid``: linkages and gears (URDF ``mimic``, MJCF joint equalities). Every joint is a polynomial of the
  motor's command, q = Σ aₖ mᵏ; the command is the angle of the motor's own joint. Where one joint meets its
  limit, all stop.
- ``adaptive``: tendons and differentials. The motor sets a weighted sum of angles, m = Σ cᵢ qᵢ. While nothing
  touches, the joints take the unloaded path q⁰(m). Inequalities between the joints always hold, and a joint
  may lock when it is blocked.

Postures of a hand are planned on these laws, so that the hand can take every one of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import HandError
from ..types import Array, freeze, frozen_array, value

DIRECT, RIGID, ADAPTIVE = "direct", "rigid", "adaptive"

DEGREE = 4
"""Highest power in a rigid law, that of MuJoCo's joint equalities."""

KNOTS = 65
"""Number of evenly spaced commands at which the unloaded path of an adaptive law is stored."""

_STRAIGHT = 1e-9  # deviation from a straight line that counts as none [rad]


@value
class Motor:
    """One motor and the k joints that follow it.

    Attributes:
        name: Name of the motor. For the laws ``direct`` and ``rigid`` it is that of the joint whose angle is
            the command.
        joints: Names of the joints, in the hand's order.
        law: ``direct``, ``rigid`` or ``adaptive``.
        weights: (k,) coefficients c of m = Σ cᵢ qᵢ. With a rigid law, 1 for the motor's own joint, else 0.
        polynomials: (k, 5) coefficients of q in powers of m, lowest first. With an adaptive law they are used
            if the unloaded path is straight.
        path: (p, k) angles of the joints on the unloaded path, at p evenly spaced commands over ``range``
            [rad]; empty if ``polynomials`` describe the law.
        range: (2,) least and largest command [rad]: where every joint is within its limits.
        order: Pairs of joints; the first one's angle is never above the second one's.
        locks: Joint that locks when it is blocked; empty for none.
    """

    name: str
    joints: tuple[str, ...]
    law: str
    weights: Array
    polynomials: Array
    path: Array
    range: Array
    order: tuple[tuple[str, str], ...] = ()
    locks: str = ""

    def __post_init__(self) -> None:
        k, label = len(self.joints), f"motor {self.name}"
        freeze(
            self,
            weights=frozen_array(self.weights, (k,), f"{label}: weights"),
            polynomials=frozen_array(self.polynomials, (k, DEGREE + 1), f"{label}: polynomials"),
            path=frozen_array(self.path, (None, k), f"{label}: unloaded path"),
            range=frozen_array(self.range, (2,), f"{label}: range"),
        )

    @property
    def affine(self) -> bool:
        """Whether every joint is a linear function of the command."""
        return not len(self.path) and not self.polynomials[:, 2:].any()

    def angles(self, m: ArrayLike) -> Array:
        """(..., k) angles of the joints at the commands ``m`` (...), nothing touching [rad]."""
        m = np.asarray(m, dtype=np.float64)
        if not len(self.path):
            q = np.zeros((*m.shape, len(self.joints)))
            for coefficients in self.polynomials.T[::-1]:
                q = q * m[..., None] + coefficients
            return q
        low, high = self.range
        share = (m - low) / (high - low) * (len(self.path) - 1)
        cell = np.clip(share.astype(np.int64), 0, len(self.path) - 2)
        part = (share - cell)[..., None]
        return np.asarray((1.0 - part) * self.path[cell] + part * self.path[cell + 1])

    def rates(self, m: float) -> Array:
        """(k,) derivatives of the angles by the command, at ``m``."""
        if not len(self.path):
            powers = np.arange(1, DEGREE + 1)
            return np.asarray(self.polynomials[:, 1:] @ (powers * float(m) ** (powers - 1)))
        low, high = self.range
        step = (high - low) / (len(self.path) - 1)
        cell = int(np.clip((m - low) / step, 0, len(self.path) - 2))
        return np.asarray((self.path[cell + 1] - self.path[cell]) / step)

    def renamed(self, name: str, joints: dict[str, str]) -> Motor:
        """The same motor with other names of itself and of its joints."""
        return replace(
            self,
            name=name,
            joints=tuple(joints[joint] for joint in self.joints),
            order=tuple((joints[a], joints[b]) for a, b in self.order),
            locks=joints.get(self.locks, ""),
        )


def direct_motor(joint: str, limits: Array) -> Motor:
    """The motor of a joint of its own, with limits (2,) [rad]."""
    identity = np.zeros((1, DEGREE + 1))
    identity[0, 1] = 1.0
    return Motor(
        name=joint,
        joints=(joint,),
        law=DIRECT,
        weights=np.ones(1),
        polynomials=identity,
        path=np.zeros((0, 1)),
        range=limits,
    )


def rigid_motor(name: str, polynomials: dict[str, Array], limits: dict[str, Array]) -> Motor:
    """A motor with a rigid law.

    Args:
        name: The joint whose angle is the command.
        polynomials: For every other joint, up to 5 coefficients in powers of that angle, lowest first.
        limits: (2,) limits of each joint, in the hand's order [rad].

    Raises:
        HandError: A law has too many coefficients, or no command keeps all joints within their limits.
    """
    joints = tuple(joint for joint in limits if joint == name or joint in polynomials)
    rows = np.zeros((len(joints), DEGREE + 1))
    for row, joint in zip(rows, joints, strict=True):
        given = np.array([0.0, 1.0]) if joint == name else np.atleast_1d(polynomials[joint])
        if not 1 <= len(given) <= DEGREE + 1 or not np.isfinite(given).all():
            raise HandError(
                f"motor {name}: the law of {joint} must be one multiplier, or up to {DEGREE + 1} "
                f"coefficients, lowest order first; got {given.tolist()}"
            )
        row[: len(given)] = given
    motor = Motor(
        name=name,
        joints=joints,
        law=RIGID,
        weights=np.array([float(joint == name) for joint in joints]),
        polynomials=rows,
        path=np.zeros((0, len(joints))),
        range=limits[name],
    )
    return replace(motor, range=_common_range(motor, np.array([limits[joint] for joint in joints])))


def adaptive_motor(
    name: str,
    weights: dict[str, float],
    limits: dict[str, Array],
    *,
    free: Array | None = None,
    order: tuple[tuple[str, str], ...] = (),
    locks: str = "",
) -> Motor:
    """A motor with an adaptive law.

    Args:
        name: Name of the motor.
        weights: Coefficient c of every joint in m = Σ cᵢ qᵢ.
        limits: (2,) limits of each joint, in the hand's order [rad].
        free: (p, k) points of the unloaded path, joints in the order of ``weights`` [rad]. By default the
            straight line between the ends of the joints' ranges.
        order: Pairs of joints, of which the first one's angle is never above the second one's.
        locks: Joint that locks when it is blocked.

    Raises:
        HandError: A coefficient is zero, the path is not within the limits, does not increase the command, or
            breaks the order.
    """
    joints = tuple(joint for joint in limits if joint in weights)
    c = np.array([float(weights[joint]) for joint in joints])
    bounds = np.array([limits[joint] for joint in joints])
    if not (np.isfinite(c).all() and c.all()):
        raise HandError(f"motor {name}: every coefficient of its sum must be a number other than zero")
    if free is None:
        knots = np.where(c[:, None] > 0, bounds, bounds[:, ::-1]).T
    else:
        knots = frozen_array(free, (None, len(joints)), f"motor {name}: free")
        knots = knots[:, [list(weights).index(joint) for joint in joints]]
    command = knots @ c
    if len(knots) < 2 or not ((np.diff(command) > 0).all() or (np.diff(command) < 0).all()):
        raise HandError(
            f"motor {name}: its unloaded path needs two points or more, and the sum must grow from each to "
            f"the next; the sums are {np.round(command, 4).tolist()}"
        )
    if command[0] > command[-1]:
        command, knots = command[::-1], knots[::-1]
    m = np.linspace(command[0], command[-1], KNOTS)
    path = np.stack([np.interp(m, command, knot) for knot in knots.T], axis=1)
    outside = (path < bounds[:, 0] - 1e-6) | (path > bounds[:, 1] + 1e-6)
    if outside.any():
        joint = joints[int(outside.any(axis=0).argmax())]
        raise HandError(f"motor {name}: its unloaded path leaves the limits of {joint}")
    at = {joint: k for k, joint in enumerate(joints)}
    for low, high in order:
        if (path[:, at[low]] > path[:, at[high]] + 1e-6).any():
            raise HandError(f"motor {name}: on its unloaded path {low} goes above {high}")
    polynomials = np.zeros((len(joints), DEGREE + 1))
    slope = (path[-1] - path[0]) / (m[-1] - m[0])
    polynomials[:, 0], polynomials[:, 1] = path[0] - slope * m[0], slope
    straight = np.abs(polynomials[:, 0] + m[:, None] * slope - path).max() < _STRAIGHT
    return Motor(
        name=name,
        joints=joints,
        law=ADAPTIVE,
        weights=c,
        polynomials=polynomials,
        path=path[:0] if straight else path,
        range=m[[0, -1]],
        order=order,
        locks=locks,
    )


def _common_range(motor: Motor, limits: Array) -> Array:
    """(2,) the commands about the motor's own range at which all joints (k, 2) are within their limits.

    Raises:
        HandError: There are none.
    """
    m = np.linspace(motor.range[0], motor.range[1], 2001)
    q = motor.angles(m)
    tolerance = 1e-6
    inside = (q >= limits[:, 0] - tolerance) & (q <= limits[:, 1] + tolerance)
    good = np.flatnonzero(inside.all(axis=1))
    if len(good) < 2:
        worst = motor.joints[int(inside.sum(axis=0).argmin())]
        raise HandError(
            f"motor {motor.name}: at no angle of it are all its joints within their limits; {worst} is the "
            "furthest outside: correct its limits or the law"
        )
    # The longest run of commands that all joints can follow; its ends are found exactly.
    runs = np.split(good, np.flatnonzero(np.diff(good) > 1) + 1)
    run = max(runs, key=len)

    def end(inner: float, outer: float) -> float:
        for _ in range(60):
            middle = (inner + outer) / 2
            angles = motor.angles(middle)
            within = (angles >= limits[:, 0] - 1e-9).all() and (angles <= limits[:, 1] + 1e-9).all()
            inner, outer = (middle, outer) if within else (inner, middle)
        return inner

    low = m[run[0]] if run[0] == 0 else end(m[min(run[0] + 1, run[-1])], m[run[0] - 1])
    high = m[run[-1]] if run[-1] == len(m) - 1 else end(m[max(run[-1] - 1, run[0])], m[run[-1] + 1])
    return np.array([low, high])
