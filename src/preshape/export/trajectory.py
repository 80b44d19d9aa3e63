"""A planned grasp as a trajectory of the hand's motors: open, touch, squeeze, hold while the arm lifts.

Where the plan has an arm, the trajectory begins where the straight way in does, and has the arm's joints.
"""

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

    Without an arm, the hand is at the grasp pose, with its fingers in the pregrasp, when the trajectory
    begins; with one, it is where the way in begins. During the last stage the command of the squeeze stays,
    while the arm lifts the object.

    Attributes:
        names: (m,) Names of the motors, or of the driver's channels.
        unit: Unit of the positions.
        stages: (n,) Name of the stage that ends at each point.
        times: (n,) Time of each point [s].
        positions: (n, m) Commands.
        efforts: (m,) Torques of the motors in the squeeze [N m].
        cut: Names of the channels of which a command was cut to the driver's limits.
        whole: Whether the commands are whole numbers.
        arm: (a,) Names of the arm's joints; empty without an arm.
        arm_positions: (n, a) Positions of the arm's joints [rad or m].

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
    arm: tuple[str, ...] = ()
    arm_positions: Array | None = None

    def __post_init__(self) -> None:
        n, m, a = len(self.stages), len(self.names), len(self.arm)
        arm = np.zeros((n, a)) if self.arm_positions is None else self.arm_positions
        freeze(
            self,
            times=frozen_array(self.times, (n,), "times"),
            positions=frozen_array(self.positions, (n, m), "positions"),
            efforts=frozen_array(self.efforts, (m,), "efforts"),
            arm_positions=frozen_array(arm, (n, a), "positions of the arm"),
        )

    def sampled(self) -> tuple[Array, Array, tuple[str, ...]]:
        """Times (k,) [s], positions (k, m) and the stage of each, ``STEP`` apart."""
        count = int(np.floor(self.times[-1] / STEP + 1e-6))
        times = np.unique(np.concatenate([STEP * np.arange(count + 1), self.times]).round(9))
        positions = self._at(times, self.positions)
        at = np.minimum(np.searchsorted(self.times, times - 1e-9), len(self.stages) - 1)
        return times, positions.round() if self.whole else positions, tuple(self.stages[k] for k in at)

    def arm_sampled(self) -> Array:
        """(k, a) positions of the arm's joints at the times of :meth:`sampled`."""
        assert self.arm_positions is not None
        return self._at(self.sampled()[0], self.arm_positions)

    def _at(self, times: Array, positions: Array) -> Array:
        columns = [np.interp(times, self.times, column) for column in positions.T]
        return np.stack(columns, axis=1) if columns else np.zeros((len(times), 0))


def motor_trajectory(
    grasp: PlannedGrasp, driver: Driver | None = None, duration: float | None = None
) -> MotorTrajectory:
    """The trajectory of a planned grasp.

    Args:
        grasp: The grasp.
        driver: Driver whose names, order and numbers are used; ``None`` for the motors of the hand's model
            [rad].
        duration: Time from the first point to the end of the lift [s]; ``None`` for ``DURATION``, or with an
            arm for the time that its path takes.

    Raises:
        InputError: The duration is not positive or too long, or the driver does not fit the hand.
    """
    stages, times, share, arm = _points(grasp)
    if duration is not None:
        duration = positive_number(duration, "the duration")
        if duration > LONGEST:
            raise InputError(f"the duration must be at most {LONGEST:g} s, got {duration:g}")
        times = times * (duration / times[-1])
    postures = np.stack([grasp.pregrasp, grasp.grasp, grasp.squeeze])[share]
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
        stages=stages,
        times=times,
        positions=commands,
        efforts=efforts,
        cut=cut,
        whole=driver is not None and driver.whole,
        arm=grasp.arm.joints if grasp.arm is not None else (),
        arm_positions=arm,
    )


def _points(grasp: PlannedGrasp) -> tuple[tuple[str, ...], Array, list[int], Array | None]:
    """Stage, time [s], posture of the hand (0 pregrasp, 1 grasp, 2 squeeze) and the arm's at each point."""
    stages, steps = tuple(stage for stage, _ in STAGES), np.array([seconds for _, seconds in STAGES])
    if grasp.arm is None:
        return stages, np.cumsum(steps), [0, 1, 2, 2], None
    path, g = grasp.arm, grasp.arm.at_grasp
    up = len(path.times) - g - 1
    closing = np.cumsum(steps[1:3])
    times = np.concatenate([path.times[: g + 1], path.times[g] + closing, path.times[g + 1 :] + closing[1]])
    named = (stages[0], *("way_in",) * g, *stages[1:3], *(stages[3],) * up)
    arm = np.concatenate([path.q[: g + 1], path.q[[g, g]], path.q[g + 1 :]])
    return named, times, [0] * (g + 1) + [1, 2] + [2] * up, arm


def trajectory_message(trajectory: MotorTrajectory) -> dict[str, Any]:
    """The trajectory as ``trajectory_msgs/msg/JointTrajectory``: one point a stage, without efforts."""
    rows = zip(trajectory.positions, trajectory.times.tolist(), strict=True)
    return joint_trajectory(trajectory.names, [trajectory_point(q, None, seconds) for q, seconds in rows])


def arm_message(trajectory: MotorTrajectory) -> dict[str, Any] | None:
    """The arm's ``trajectory_msgs/msg/JointTrajectory``, on the same clock; ``None`` without an arm."""
    if not trajectory.arm:
        return None
    assert trajectory.arm_positions is not None
    rows = zip(trajectory.arm_positions, trajectory.times.tolist(), strict=True)
    return joint_trajectory(trajectory.arm, [trajectory_point(q, None, seconds) for q, seconds in rows])


def trajectory_csv(trajectory: MotorTrajectory) -> str:
    """The sampled trajectory as CSV: time [s], stage, a column for each joint of the arm and each motor."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["time", "stage", *trajectory.arm, *trajectory.names])
    for time, positions, stage, arm in zip(*trajectory.sampled(), trajectory.arm_sampled(), strict=True):
        rows.writerow([f"{time:.6g}", stage, *(f"{x:.9g}" for x in (*arm, *positions))])
    return text.getvalue()


def trajectory_arrays(trajectory: MotorTrajectory) -> dict[str, Any]:
    """Arrays of the samples: times (k,), positions (k, m), stages (k,), names (m,) and efforts (m,).

    With an arm, also arm_positions (k, a) and arm_names (a,).
    """
    times, positions, stages = trajectory.sampled()
    arm = bool(trajectory.arm)
    return {
        "times": times,
        "positions": positions,
        "stages": np.array(stages),
        "names": np.array(trajectory.names),
        "unit": np.array(trajectory.unit),
        "efforts": trajectory.efforts,
        **({"arm_positions": trajectory.arm_sampled(), "arm_names": np.array(trajectory.arm)} if arm else {}),
    }
