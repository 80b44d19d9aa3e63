"""What the closure analyser is told: friction, load, and how far it searches."""

from __future__ import annotations

import math
from dataclasses import field

import numpy as np

from ..exceptions import InputError
from ..kernels.closing import Obstacles
from ..types import value

GRAVITY = 9.81
"""[m/s²]."""


@value
class ClosureSettings:
    """Numbers of the closure analyser; one set of defaults serves every object, hand and task.

    Attributes:
        friction: between fingers and object.
        torsion: torsional friction [m].
        friction_share: share of both that is planned with: room for error [C].
        mass: of the object [kg]; its weight and a push of the same size are what a grip is made for.
        press_least: least sum of normal forces of a squeeze [N].
        press_most: largest [N]; the hand's joint torques may allow less.
        safety: the squeeze is this many times what the load needs.
        hold: share of the task's load that plain holding in every other direction is asked for.
        at_aim: candidates for one plane and approach value (mode 0).
        on_plane: candidates for one plane (mode 1).
        everywhere: candidates for all planes (mode 3).
        elite: candidates that a round of refinement starts from.
        children: of each of them.
        rounds: of refinement.
        finished: grips that are worked out in full, at most.
        obstacles: table and boxes that hand and fingers stay out of.
        device: ``cpu`` or a CUDA device.
        threads: CPU threads, default one for each core.

    Raises:
        InputError: a number out of range.
    """

    friction: float = 0.6
    torsion: float = 0.02
    friction_share: float = 0.35
    mass: float = 0.1
    press_least: float = 10.0
    press_most: float = 40.0
    safety: float = 2.0
    hold: float = 0.7
    at_aim: int = 160
    on_plane: int = 500
    everywhere: int = 2000
    elite: int = 32
    children: int = 6
    rounds: int = 3
    finished: int = 24
    obstacles: Obstacles = field(default_factory=Obstacles)
    device: str = "cpu"
    threads: int | None = None

    def __post_init__(self) -> None:
        for name in ("friction", "mass", "press_least", "press_most", "safety", "hold"):
            number = getattr(self, name)
            if not (math.isfinite(number) and number > 0):
                raise InputError(f"{name} must be above zero, got {number!r}")
        if not (math.isfinite(self.torsion) and self.torsion >= 0):
            raise InputError(f"torsion must be zero or more [m], got {self.torsion!r}")
        if not 0 < self.friction_share <= 1:
            raise InputError(f"friction_share must be in 0..1, got {self.friction_share!r}")
        for name in ("at_aim", "on_plane", "everywhere", "elite", "children", "finished"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be 1 or more, got {getattr(self, name)!r}")

    @property
    def mu(self) -> float:
        """Friction that is planned with."""
        return self.friction * self.friction_share

    @property
    def gamma(self) -> float:
        """Torsional friction that is planned with [m]."""
        return self.torsion * self.friction_share

    @property
    def weight(self) -> float:
        """Of the object [N]."""
        return self.mass * GRAVITY


def table_below(height: float, up: str = "z") -> Obstacles:
    """A table: the half-space under ``height`` [m] along an axis of the mesh frame.

    >>> table_below(0.02).planes.tolist()
    [[0.0, 0.0, 1.0, 0.02]]
    """
    normal = np.zeros(4)
    normal["xyz".index(up)], normal[3] = 1.0, height
    return Obstacles(planes=normal[None])
