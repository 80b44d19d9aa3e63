"""Settings of the closure analyser: friction, load, and size of the search."""

from __future__ import annotations

import re
from dataclasses import field
from typing import NamedTuple

import numpy as np

from ..exceptions import InputError, shown
from ..kernels.closing.host import Obstacles
from ..types import FIELD_MASS, FRICTION, GRAVITY, finite_number, freeze, one_of, value, whole_number
from .rules import ContactRules

_DEVICE = re.compile(r"cpu|cuda(:[0-9]+)?")
_NUMBERS = (
    "friction", "torsion", "friction_share", "bold_share", "press_least", "press_most", "safety", "hold",
)  # fmt: skip
_COUNTS = ("at_aim", "on_plane", "everywhere", "elite", "children", "finished", "threads")
FRICTION_SHARE = 0.35
"""Usual share of the friction that planning uses [C]."""
GRASP_TYPES = ("any", "power", "precision")
"""The families of grips: wraps of the whole hand are power grips, fingertip grips precision grips."""
_COUNTS_FROM_ZERO = ("persistence", "rounds", "wraps")


class Effort(NamedTuple):
    """Size of the search for one aim.

    Attributes:
        candidates: Number of candidates in the first draw.
        elite: Size of the elite set.
        rounds: Number of rounds of refinement.
        grips: Number of grips wanted.
        samples: Number of disturbed poses tested for each grip.
    """

    candidates: int
    elite: int
    rounds: int
    grips: int
    samples: int


@value
class ClosureSettings:
    """Numbers of the closure analyser; one set of defaults serves every object, hand and task.

    Attributes:
        friction: Friction coefficient between fingers and object.
        torsion: Torsional friction [m]; a quarter of that of the field's test, because an object creeps
            about the axis of a pinch [C].
        friction_share: Share of both frictions that planning uses; the rest is a reserve for errors [C].
        bold_share: Share that planning uses where no grip is good enough with the usual share [C]. At most
            the usual share, it has no effect.
        mass: Mass of the object [kg]; a grip must carry its weight and resist a push of the same size. With
            ``None``, a plan uses the object's own mass, and the analyser without a plan the field's 0.1 kg.
        press_least: Least sum of the normal forces of a squeeze [N].
        press_most: Largest sum of the normal forces for an object of up to 0.1 kg [N]. It grows in proportion
            to a larger mass; the hand's joint torques may allow less.
        safety: Press of the squeeze divided by the press that the load needs.
        hold: Load of plain holding, in all directions, as a share of the task's load.
        at_aim: Number of candidates for one plane and approach value (mode 0).
        on_plane: Number of candidates for one plane (mode 1).
        everywhere: Number of candidates for all planes (mode 3).
        wraps: Number of wraps of the whole hand, for all planes; half as many for one plane.
        grasp_type: ``power`` for wraps only, ``precision`` for fingertips only, ``any`` for both.
        both: Whether wraps are looked for even where fingertips are strong, for answers of both kinds.
        persistence: Number of times that more candidates are drawn, and that the best are refined again, if
            the margin is too small.
        elite: Size of the elite set of a round of refinement.
        children: Number of children of each candidate in the elite set.
        rounds: Rounds of refinement.
        finished: Largest number of finished grips.
        obstacles: Table and boxes that the hand must avoid.
        rules: Where contacts may be, and what the hand must stay away from.
        device: ``cpu`` or a CUDA device.
        threads: CPU threads; by default one for each core.

    Raises:
        InputError: A number is out of range.
    """

    friction: float = FRICTION
    torsion: float = 0.005
    friction_share: float = FRICTION_SHARE
    bold_share: float = 0.7
    mass: float | None = None
    press_least: float = 12.0
    press_most: float = 20.0
    safety: float = 2.0
    hold: float = 0.7
    at_aim: int = 160
    on_plane: int = 500
    everywhere: int = 2000
    wraps: int = 2400
    grasp_type: str = "any"
    both: bool = False
    persistence: int = 3
    elite: int = 32
    children: int = 6
    rounds: int = 3
    finished: int = 6
    obstacles: Obstacles = field(default_factory=Obstacles)
    rules: ContactRules = field(default_factory=ContactRules)
    device: str = "cpu"
    threads: int | None = None

    def __post_init__(self) -> None:
        for name in _NUMBERS:
            freeze(self, **{name: finite_number(getattr(self, name), name)})
        if self.mass is not None:
            freeze(self, mass=finite_number(self.mass, "mass"))
        for name in (*_COUNTS, *_COUNTS_FROM_ZERO):
            if name != "threads" or self.threads is not None:
                freeze(self, **{name: whole_number(getattr(self, name), name, int(name in _COUNTS))})
        one_of(self.grasp_type, "grasp type", GRASP_TYPES)
        if not isinstance(self.obstacles, Obstacles):
            raise InputError(f"obstacles must be a value of Obstacles, got {shown(self.obstacles)}")
        if not isinstance(self.rules, ContactRules):
            raise InputError(f"rules must be a value of ContactRules, got {shown(self.rules)}")
        if not isinstance(self.device, str) or not _DEVICE.fullmatch(self.device):
            raise InputError(f"device must be cpu, cuda or cuda:N, got {shown(self.device)}")
        if self.press_least > self.press_most:
            raise InputError(
                f"press_least must not be above press_most, got {self.press_least:g} and {self.press_most:g}"
            )
        for name in ("friction", "mass", "press_least", "press_most", "safety", "hold"):
            number = getattr(self, name)
            if number is not None and not number > 0:
                raise InputError(f"{name} must be above zero, got {shown(number)}")
        if not self.torsion >= 0:
            raise InputError(f"torsion must be zero or more [m], got {shown(self.torsion)}")
        for name in ("friction_share", "bold_share"):
            if not 0 < getattr(self, name) <= 1:
                raise InputError(f"{name} must be in 0..1, got {shown(getattr(self, name))}")

    def effort(self, one_plane: bool, at_estimate: bool) -> Effort:
        """Size of the search: small at the estimate, larger on one plane, largest over all planes."""
        if not one_plane:
            return Effort(self.everywhere, self.elite, self.rounds, self.finished, samples=8)
        if not at_estimate:
            return Effort(
                self.on_plane, max(1, self.elite // 2), self.rounds, min(self.finished, 4), samples=8
            )
        return Effort(self.at_aim, max(1, self.elite // 4), min(1, self.rounds), 1, samples=4)

    @property
    def mu(self) -> float:
        """Friction coefficient that planning uses."""
        return self.friction * self.friction_share

    @property
    def gamma(self) -> float:
        """Torsional friction that planning uses [m]."""
        return self.torsion * self.friction_share

    @property
    def weight(self) -> float:
        """Weight of the object [N]."""
        return self.planned_mass * GRAVITY

    @property
    def planned_mass(self) -> float:
        """Mass that planning uses [kg]."""
        return FIELD_MASS if self.mass is None else self.mass

    @property
    def strongest(self) -> float:
        """Largest sum of the normal forces of a squeeze on this object [N]."""
        return self.press_most * self._heavier

    @property
    def middling(self) -> float:
        """Mean of the least and the strongest press; it carries the weight in the ranking [N]."""
        return 0.5 * (self.press_least + self.press_most) * self._heavier

    @property
    def _heavier(self) -> float:
        return max(1.0, self.planned_mass / FIELD_MASS)


def table_below(height: float, up: str = "z") -> Obstacles:
    """A table: the half-space below ``height`` [m] along an axis of the mesh frame.

    >>> table_below(0.02).planes.tolist()
    [[0.0, 0.0, 1.0, 0.02]]
    """
    normal = np.zeros(4)
    normal["xyz".index(up)], normal[3] = 1.0, height
    return Obstacles(planes=normal[None])
