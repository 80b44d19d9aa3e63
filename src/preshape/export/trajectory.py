"""A planned grasp as a trajectory of the hand's motors: open, touch, squeeze, hold while the arm lifts."""

from __future__ import annotations

import csv
import io
from typing import Any

import numpy as np

from ..exceptions import InputError
from ..types import Array, freeze, frozen_array, positive_number, value
from .drivers import Driver
from .moveit import joint_trajectory, trajectory_point
from .planned import PlannedGrasp

STAGES = (("pregrasp", 0.0), ("touch", 1.0), ("squeeze", 0.5), ("lift", 2.0))
"""The stages, with the time from the one before [s]; those of the pick test."""
DURATION = sum(seconds for _, seconds in STAGES)
"""Time from the pregrasp to the end of the lift [s]."""
LONGEST = 600.0
"""Longest duration [s]."""
STEP = 0.01
"""Time between two samples [s]."""


@value
class MotorTrajectory:
    """Commands of the motors over time; between two points they are linear.

    The arm has brought the hand to the grasp pose, with its fingers in the pregrasp, when the trajectory
    begins. During the last stage the command of the squeeze stays, while the arm lifts the object.

    Attributes:
        names: (m,) Names of the motors, or of the driver's channels.
        unit: Unit of the positions.
        stages: (n,) Name of the stage that ends at each point.
        times: (n,) Time of each point [s].
        positions: (n, m) Commands.
        efforts: (m,) Torques of the motors in the squeeze [N m].
        cut: Names of the channels of which a command was cut to the driver's limits.
        whole: Whether the commands are whole numbers.

    Raises:
        InputError: An array has the wrong shape.
    """

    names: tuple[str, ...]
    unit: str
    stages: tuple[str, ...]
    times: Array
    positions: Array
    efforts: Array
    cut: tuple[str, ...] = ()
    whole: bool = False

    def __post_init__(self) -> None:
        n, m = len(self.stages), len(self.names)
        freeze(
            self,
            times=frozen_array(self.times, (n,), "times"),
            positions=frozen_array(self.positions, (n, m), "positions"),
            efforts=frozen_array(self.efforts, (m,), "efforts"),
        )

    def sampled(self) -> tuple[Array, Array, tuple[str, ...]]:
        """Times (k,) [s], positions (k, m) and the stage of each, ``STEP`` apart."""
        count = int(np.floor(self.times[-1] / STEP + 1e-6))
        times = np.unique(np.concatenate([STEP * np.arange(count + 1), self.times]).round(9))
        columns = [np.interp(times, self.times, column) for column in self.positions.T]
        positions = np.stack(columns, axis=1)
        at = np.minimum(np.searchsorted(self.times, times - 1e-9), len(self.stages) - 1)
        return times, positions.round() if self.whole else positions, tuple(self.stages[k] for k in at)


def motor_trajectory(
    grasp: PlannedGrasp, driver: Driver | None = None, duration: float = DURATION
) -> MotorTrajectory:
    """The trajectory of a planned grasp.

    Args:
        grasp: The grasp.
        driver: Driver whose names, order and numbers are used; ``None`` for the motors of the hand's model
            [rad].
        duration: Time from the pregrasp to the end of the lift [s].

    Raises:
        InputError: The duration is not positive or too long, or the driver does not fit the hand.
    """
    duration = positive_number(duration, "the duration")
    if duration > LONGEST:
        raise InputError(f"the duration must be at most {LONGEST:g} s, got {duration:g}")
    times = np.cumsum([seconds for _, seconds in STAGES]) * (duration / DURATION)
    postures = np.stack([grasp.pregrasp, grasp.grasp, grasp.squeeze, grasp.squeeze])
    commands = grasp.hand.controls(postures)
    names, unit, efforts = tuple(m.name for m in grasp.hand.motors), "rad", grasp.motor_torques
    cut: tuple[str, ...] = ()
    if driver is not None:
        mapped = driver.commands(grasp.hand, commands)
        names, unit, commands, cut = mapped.names, driver.unit, mapped.numbers, mapped.cut
        efforts = efforts[list(mapped.columns)]
    return MotorTrajectory(
        names=names,
        unit=unit,
        stages=tuple(stage for stage, _ in STAGES),
        times=times,
        positions=commands,
        efforts=efforts,
        cut=cut,
        whole=driver is not None and driver.whole,
    )


def trajectory_message(trajectory: MotorTrajectory) -> dict[str, Any]:
    """The trajectory as ``trajectory_msgs/msg/JointTrajectory``: one point a stage, without efforts."""
    rows = zip(trajectory.positions, trajectory.times.tolist(), strict=True)
    return joint_trajectory(trajectory.names, [trajectory_point(q, None, seconds) for q, seconds in rows])


def trajectory_csv(trajectory: MotorTrajectory) -> str:
    """The sampled trajectory as CSV: time [s], stage, and a column for each motor."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["time", "stage", *trajectory.names])
    for time, positions, stage in zip(*trajectory.sampled(), strict=True):
        rows.writerow([f"{time:.6g}", stage, *(f"{x:.9g}" for x in positions)])
    return text.getvalue()


def trajectory_arrays(trajectory: MotorTrajectory) -> dict[str, Any]:
    """Arrays of the samples: times (k,), positions (k, m), stages (k,), names (m,) and efforts (m,)."""
    times, positions, stages = trajectory.sampled()
    return {
        "times": times,
        "positions": positions,
        "stages": np.array(stages),
        "names": np.array(trajectory.names),
        "unit": np.array(trajectory.unit),
        "efforts": trajectory.efforts,
    }
