"""Settings, causes and results of the pick test; :mod:`.picking` runs it."""

from __future__ import annotations

import enum
import math

from ...exceptions import InputError
from ...types import FRICTION, finite_number, positive_number, value, whole_number
from ..protocol import HoldProtocol
from ..task.motion import ACCELERATION


class PickStatus(enum.Enum):
    """Outcome of a pick test; the values are texts for the user."""

    PICKED = "picked up and held"
    NO_ANSWER = "no answer"
    DOES_NOT_REST = "does not rest"
    HITS_TABLE = "hits the table"
    PUSHED = "pushed away or over"
    SLIPS = "slips"
    SPINS = "spins"
    DROPS = "drops"
    UNSTABLE = "unstable simulation"
    INVALID = "not tested"


FAILURES = tuple(status for status in PickStatus if status is not PickStatus.PICKED)
"""Every cause of a failure, in the order of the tables."""


@value
class PickProtocol:
    """Settings of a pick test; times in seconds.

    Attributes:
        friction: Sliding friction of every geom, the table's included.
        torsion: Torsional friction of every geom [m].
        many_contacts: Whether two flat faces touch at several points; the field's tests use one.
        gravity: Acceleration of the object; the hand carries its own weight [m/s²].
        timestep: Simulation step [s].
        look_steps: Simulation steps between two checks of the object; the table is checked at every step.
        way_in: Distance by which the hand stands back along its way in at the start [m].
        settle: Time in which the object comes to rest on the table.
        approach: Time from the start to the pregrasp.
        close: Time from the pregrasp to the grasp.
        squeeze: Time from the grasp to the squeeze.
        lift: Time of the lift.
        hold: Time for which the hand then stands still.
        do: Whether the hand then does the task (:mod:`.doing`).
        turn: Time in which the hand turns the object to the task's own gravity.
        height: Height of the lift [m].
        table_force: Largest allowed force between hand and table [N].
        untouched_limit: Largest motion of the object before the hand touches it [m].
        displacement_limit: Largest motion of the object's centre of mass, in the world until the squeeze
            ends, in the hand afterwards [m].
        rotation_limit: Largest rotation, counted in the same way [rad].
        position_error: Distance by which the object stands off, in a random direction along the table [m].
        turn_error: Angle by which it is turned about the vertical, in a random sense [rad].
        seed: Seed of these two errors.

    Raises:
        InputError: A number is out of range.
    """

    friction: float = FRICTION
    torsion: float = 0.02
    many_contacts: bool = False
    gravity: float = ACCELERATION
    timestep: float = 0.002
    look_steps: int = 5
    way_in: float = 0.12
    settle: float = 0.5
    approach: float = 1.0
    close: float = 1.0
    squeeze: float = 0.5
    lift: float = 2.0
    hold: float = 3.0
    do: bool = False
    turn: float = 1.0
    height: float = 0.2
    table_force: float = 1.0
    untouched_limit: float = 0.002
    displacement_limit: float = 0.02
    rotation_limit: float = math.radians(15.0)
    position_error: float = 0.0
    turn_error: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        positive = (
            "gravity", "timestep", "settle", "approach", "close", "squeeze", "lift", "hold", "turn", "height",
            "table_force", "untouched_limit", "displacement_limit", "rotation_limit",
        )  # fmt: skip
        for name in positive:
            positive_number(getattr(self, name), name)
        for name in ("way_in", "position_error", "turn_error"):
            if finite_number(getattr(self, name), name) < 0:
                raise InputError(f"{name} must be at least 0, got {getattr(self, name)!r}")
        for name, least in (("look_steps", 1), ("seed", 0)):
            whole_number(getattr(self, name), name, least)
        self.scene(1.0)

    def scene(self, mass: float) -> HoldProtocol:
        """Settings of the scene of an object: the hand keeps its own gains and torque limits.

        Args:
            mass: Mass of the object [kg].
        """
        return HoldProtocol(
            mass=mass,
            friction=self.friction,
            torsion=self.torsion,
            timestep=self.timestep,
            gain=None,
            torque_limits=True,
            many_contacts=self.many_contacts,
        )


@value
class Motion:
    """How far an object moved: its largest displacement [m] and rotation [rad]."""

    displacement: float
    rotation: float


@value
class Done:
    """What became of the job that the hand did with the object that it had picked up.

    Attributes:
        done: Whether the object followed the task's motion to its end.
        reason: One sentence on the outcome.
        displacement: Largest distance of the COG from its path [m]; ``None`` if the test did not get there.
        rotation: Largest angle of the object from its path [rad]; ``None`` if the test did not get there.
        progress: Fraction of the path at the end of the test, 0 to 1.
    """

    done: bool
    reason: str
    displacement: float | None = None
    rotation: float | None = None
    progress: float = 0.0


@value
class PickResult:
    """Result of the pick test of one object.

    Attributes:
        row: Row of the object in its list.
        object_name: Name of the object.
        scale: Factor on its size.
        mass: Its mass [kg].
        status: Outcome.
        reason: One sentence on the outcome.
        settled: Motion while the object came to rest; ``None`` for an object that was not tested.
        pushed: Motion in the world until the squeeze ended; ``None`` if the test did not get there.
        held: Motion in the hand from then on; ``None`` if the test did not get there.
        table_force: Largest force between hand and table [N].
        touching: Number of parts (fingers and palm) that press on the object after the squeeze.
        planned: Pregrasp, grasp and squeeze, each as root pose in the object's frame and joint angles
            (7 + joints); ``None`` without an answer.
        way_in: Unit vector along which the hand approaches, in the object's frame; ``None`` without an
            answer.
        turn: How the object rested: quaternion wxyz from its frame to the world; ``None`` without an answer.
        job: What became of the task; ``None`` if the test did not ask for it, nothing was picked up, or the
            task asks for no motion.
    """

    row: int
    object_name: str
    scale: float
    mass: float
    status: PickStatus
    reason: str
    settled: Motion | None = None
    pushed: Motion | None = None
    held: Motion | None = None
    table_force: float = 0.0
    touching: int = 0
    planned: tuple[tuple[float, ...], ...] | None = None
    way_in: tuple[float, ...] | None = None
    turn: tuple[float, ...] | None = None
    job: Done | None = None

    @property
    def done(self) -> bool:
        """Whether the object was picked up and the task done with it, if it was asked for."""
        return self.picked and (self.job is None or self.job.done)

    @property
    def picked(self) -> bool:
        """Whether the hand picked the object up and held it."""
        return self.status is PickStatus.PICKED

    @property
    def answered(self) -> bool:
        """Whether there was a grasp to test."""
        return self.planned is not None
