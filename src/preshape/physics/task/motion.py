"""The motion of a task test and the load that opposes it: pure functions of the task.

Definitions [C]:

- *Target.* The displacement D = [R t; 0 1] about the COG c, x' = R (x - c) + c + t, of
  :func:`preshape.tasks.full_motion`. Components of Q at the absence values (|T| ≤ 0.1, |R| ≤ 0.05) are no
  motion. The other translations are scaled so that the largest is 0.1 m, the other rotations so that the
  largest is 45°. The components do not scale the load.
- *Path.* The object follows the screw of D, x(f) = exp(f log D), f from 0 to 1: a constant twist with a fixed
  axis and pitch. A task that both translates and rotates moves the COG along an arc or a helix.
- *Speed.* f is a fifth-order polynomial of time, at rest at both ends.
- *Load.* Where the task translates, a force of ``acceleration × mass`` on the COG opposes the velocity of the
  COG. Where it rotates, a torque of that force times ℓ/2 opposes the angular velocity; ℓ is half the
  object's largest extent. Because the twist is constant, force and torque are constant in the frame of an
  object that follows its path. They never do positive work on the object.
- *Gravity.* A force of ``acceleration × mass`` acts on the centre of mass, in a direction that is fixed in
  the world: the task's direction of gravity in the object's frame at the start.

All quantities are in the frame of the object at the start.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...exceptions import TaskError
from ...spatial import along_screw, pose, rotation_from_vector, twist_log
from ...tasks import Task, full_motion
from ...types import Array, freeze, frozen_array, value

ACCELERATION = 9.8
"""Load and weight divided by the mass of the object [m/s²] (docs/task-benchmark.md)."""
_NOTHING = 1e-9  # a smaller twist [m or rad over the whole path] counts as none


@value
class TaskMotion:
    """The path of an object and the load on it.

    Attributes:
        displacement: (4, 4) displacement D about the COG at the end of the path [m].
        cog: (3,) COG in the object's frame [m].
        half_extent: ℓ, half the object's largest extent [m].
        gravity: (3,) unit direction of gravity; zeros for none.

    Raises:
        TaskError: The displacement moves nothing.
        InputError: An array has the wrong shape or is not finite.
    """

    displacement: Array
    cog: Array
    half_extent: float
    gravity: Array

    def __post_init__(self) -> None:
        freeze(
            self,
            displacement=frozen_array(self.displacement, (4, 4), "task displacement"),
            cog=frozen_array(self.cog, (3,), "COG"),
            half_extent=float(frozen_array(self.half_extent, (), "half extent")),
            gravity=frozen_array(self.gravity, (3,), "gravity"),
        )
        if not (self.translates or self.rotates):
            raise TaskError("the task asks for no motion, which the task test cannot test; give another task")

    @property
    def twist(self) -> Array:
        """(6,) log D, linear and angular about the COG [m, rad over the whole path]."""
        return twist_log(self.displacement)

    @property
    def translates(self) -> bool:
        """Whether the COG moves."""
        return bool(np.abs(self.twist[:3]).max() > _NOTHING)

    @property
    def rotates(self) -> bool:
        """Whether the object rotates."""
        return bool(np.abs(self.twist[3:]).max() > _NOTHING)

    def path(self, fraction: ArrayLike) -> Array:
        """(..., 4, 4) pose of the object in its start frame at ``fraction`` (...) of the path, 0 to 1."""
        about_cog = along_screw(self.displacement, fraction)
        rotation = about_cog[..., :3, :3]
        return pose(rotation, about_cog[..., :3, 3] + self.cog - rotation @ self.cog)

    def velocity(self, fraction: ArrayLike) -> Array:
        """(..., 6) velocity of the COG and angular velocity, for a unit rate of ``fraction`` [m, rad]."""
        f = np.asarray(fraction, dtype=np.float64)
        twist = self.twist
        turned = rotation_from_vector(f[..., None] * twist[3:])
        return np.concatenate([turned @ twist[:3], np.broadcast_to(twist[3:], (*f.shape, 3))], axis=-1)

    def load(self, fraction: ArrayLike, mass: float, acceleration: float = ACCELERATION) -> Array:
        """(..., 6) load that opposes the motion, about the COG [N, N m]; gravity is not part of it.

        Args:
            fraction: (...) fraction of the path, 0 to 1.
            mass: Mass of the object [kg].
            acceleration: Load divided by mass [m/s²].
        """
        velocity = self.velocity(fraction)
        force = acceleration * mass
        out = np.zeros_like(velocity)
        for part, size, present in (
            (slice(0, 3), force, self.translates),
            (slice(3, 6), force * self.half_extent / 2, self.rotates),
        ):
            if present:
                v = velocity[..., part]
                out[..., part] = -size * v / np.linalg.norm(v, axis=-1, keepdims=True)
        return out

    def weight(self, mass: float, acceleration: float = ACCELERATION) -> Array:
        """(3,) weight of the object, a force on its centre of mass [N]."""
        return acceleration * mass * self.gravity


def task_motion(
    task: Task, cog: ArrayLike, half_extent: float, *, gravity: ArrayLike | None = None
) -> TaskMotion:
    """The motion and load of a task on an object.

    Args:
        task: The task.
        cog: (3,) centre of the object's bounding box, in its frame [m].
        half_extent: ℓ, half the object's largest extent [m].
        gravity: (3,) direction of gravity that replaces the task's own; zeros for none.

    Raises:
        TaskError: The task asks for no motion.

    >>> from preshape.tasks import named_task
    >>> motion = task_motion(named_task("lift"), [0.0, 0.0, 0.0], 0.05)
    >>> (motion.path(1.0)[:3, 3] + 0.0).tolist(), motion.load(0.0, 0.1).round(3).tolist()[:3]
    ([0.0, 0.0, 0.1], [-0.0, -0.0, -0.98])
    """
    direction = np.asarray(task.gravity if gravity is None else gravity, dtype=np.float64)
    length = float(np.linalg.norm(direction))
    return TaskMotion(
        displacement=full_motion(task),
        cog=np.asarray(cog, dtype=np.float64),
        half_extent=half_extent,
        gravity=direction / length if length > 0 else direction,
    )


def ease(share: ArrayLike) -> Array:
    """(...) fraction of the path at ``share`` (...) of the time: 10 s³ - 15 s⁴ + 6 s⁵, at rest at both ends.

    >>> ease([0.0, 0.5, 1.0]).tolist()
    [0.0, 0.5, 1.0]
    """
    s = np.clip(np.asarray(share, dtype=np.float64), 0.0, 1.0)
    return np.asarray(s**3 * (10.0 + s * (6.0 * s - 15.0)))
