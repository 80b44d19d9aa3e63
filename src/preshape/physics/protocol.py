"""Settings of the holding test, and the probes: loads that push and twist the object.

The default is the field's six-direction test, as in DexGraspBench. The harder variants are our own [C]:
friction 0.3, 28 probes, the strength ladder, and pose and size errors.
"""

from __future__ import annotations

import math

import numpy as np

from ..exceptions import InputError, shown
from ..types import (
    FIELD_MASS,
    FRICTION,
    Array,
    finite_number,
    freeze,
    frozen_array,
    one_of,
    value,
    whole_number,
)

PROBE_SETS = ("six", "all")
"""``six`` has forces along ±x, ±y, ±z; ``all`` has 14 forces, 14 torques, also along 8 diagonals [C]."""


@value
class Probe:
    """A constant load on the object.

    Attributes:
        name: ``force +x``, ``torque +x-y+z`` …, in world axes.
        wrench: (6,) force [N] and torque [N m] about the centre of mass, in world axes, at strength 1.
    """

    name: str
    wrench: Array

    def __post_init__(self) -> None:
        freeze(self, wrench=frozen_array(self.wrench, (6,), "probe wrench"))


@value
class HoldProtocol:
    """Settings of a holding test.

    Attributes:
        mass: Mass of the object [kg].
        friction: Sliding friction of every geom.
        torsion: Torsional friction of every geom [m] (condim 4).
        gain: Gain of the position actuators [N m/rad]; ``None`` keeps those of the hand's model, as do hands
            whose squeezes are aimed for them.
        torque_limits: Whether the actuators keep the torque limits of the hand's model; the field's test
            lifts them.
        many_contacts: Whether two flat faces touch at several points (MuJoCo's multiccd, on by default since
            version 4). The field's test uses one point; several points double the time of a test.
        timestep: Simulation step [s].
        stages: Interpolation steps from pregrasp to grasp, and again from grasp to squeeze.
        stage_steps: Simulation steps for each interpolation step.
        checks: Number of checks of the object while a load acts.
        check_steps: Simulation steps between two checks.
        acceleration: Force of a probe divided by the mass of the object [m/s²].
        lever: Torque of a torque probe divided by the force of a force probe [m].
        displacement_limit: A grasp fails if the object's frame moves this far from its first position [m].
        rotation_limit: A grasp fails if the object turns this far from its first orientation [rad].
        penetration_limit: Largest allowed penetration of the pregrasp into the object or the hand itself [m].
        contact_distance: A link counts as touching if it is nearer to the object than this [m].
        clean_penetration: A clean grasp penetrates the object less than this [m].
        probes: One of ``PROBE_SETS``.
        ladder: Whether to climb the strength ladder: repeat all probes, each time ``ladder_factor`` times as
            strong, until one fails.
        ladder_factor: Ratio of the strengths of two successive rungs.
        ladder_rungs: Number of rungs.
        position_error: Distance by which the object is displaced in a random direction [m].
        turn_error: Angle by which the object is turned about a random axis [rad].
        size_error: Share by which the object is enlarged or shrunk.
        seed: Seed of these three errors.
        stop_early: Whether the first probe that fails ends the test; whether the grasp holds is unaffected.
    """

    mass: float = FIELD_MASS
    friction: float = FRICTION
    torsion: float = 0.02
    gain: float | None = 5.0
    torque_limits: bool = False
    many_contacts: bool = False
    timestep: float = 0.004
    stages: int = 10
    stage_steps: int = 10
    checks: int = 10
    check_steps: int = 50
    acceleration: float = 10.0
    lever: float = 0.05
    displacement_limit: float = 0.05
    rotation_limit: float = math.radians(15.0)
    penetration_limit: float = 0.01
    contact_distance: float = 0.002
    clean_penetration: float = 0.001
    probes: str = "six"
    ladder: bool = False
    ladder_factor: float = 1.4
    ladder_rungs: int = 12
    position_error: float = 0.0
    turn_error: float = 0.0
    size_error: float = 0.0
    seed: int = 0
    stop_early: bool = False

    def __post_init__(self) -> None:
        above = ["mass", "timestep", "acceleration", "lever", "displacement_limit", "rotation_limit"]
        for name in (*above, *(["gain"] if self.gain is not None else [])):
            _number(name, getattr(self, name), least=0.0, open_end=True)
        rest = ("friction", "torsion", "penetration_limit", "contact_distance", "clean_penetration")
        for name in (*rest, "position_error", "turn_error", "size_error"):
            _number(name, getattr(self, name), least=0.0)
        for name in ("stages", "stage_steps", "checks", "check_steps", "ladder_rungs"):
            freeze(self, **{name: whole_number(getattr(self, name), name, 1)})
        freeze(self, seed=whole_number(self.seed, "seed", 0))
        _number("ladder_factor", self.ladder_factor, least=1.0, open_end=True)
        if self.size_error >= 0.5:
            raise InputError(f"size_error must be a share under 0.5, got {shown(self.size_error)}")
        one_of(self.probes, "probe set", PROBE_SETS)

    def loads(self) -> tuple[Probe, ...]:
        """The probes at strength 1."""
        return probes(self.probes, self.acceleration * self.mass, self.lever)


def probes(kind: str, force: float, lever: float) -> tuple[Probe, ...]:
    """The probes of a set.

    Args:
        kind: One of ``PROBE_SETS``.
        force: Force of a probe [N].
        lever: Torque of a torque probe divided by ``force`` [m].

    >>> [probe.name for probe in probes("six", 1.0, 0.05)][:2], len(probes("all", 1.0, 0.05))
    (['force +x', 'force +y'], 28)
    """
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    if kind == "six":
        return tuple(_force(axis, force) for axis in axes)
    corners = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)]) / math.sqrt(3.0)
    directions = np.concatenate([axes, corners])
    torques = tuple(
        Probe(name=f"torque {_name(d)}", wrench=[0.0, 0.0, 0.0, *(force * lever * d)])  # type: ignore[arg-type]
        for d in directions
    )
    return tuple(_force(direction, force) for direction in directions) + torques


def _force(direction: Array, force: float) -> Probe:
    return Probe(name=f"force {_name(direction)}", wrench=[*(force * direction), 0.0, 0.0, 0.0])  # type: ignore[arg-type]


def _name(direction: Array) -> str:
    return "".join(f"{'-' if d < 0 else '+'}{a}" for a, d in zip("xyz", direction, strict=True) if d)


def _number(name: str, given: float, *, least: float, open_end: bool = False) -> None:
    number = finite_number(given, name)
    if number < least or (open_end and number == least):
        raise InputError(f"{name} must be {'above' if open_end else 'at least'} {least:g}, got {number!r}")
