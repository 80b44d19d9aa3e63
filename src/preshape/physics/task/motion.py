"""The motion that a task test demands and the load that opposes it: pure functions of the task.

The meaning of both, precisely [C]:

- *Where to.* The displacement D = [R t; 0 1] about the COG, x' = R (x - c) + c + t, that
  :func:`preshape.tasks.full_motion` gives: components of Q at the absence values (|T| ≤ 0.1, |R| ≤ 0.05) are
  no motion; the others are proportions, the largest translation 0.1 m, the largest rotation 45°. How strong
  a presence is says how translations and rotations compare among themselves; it does not grade the load.
- *Which way.* Along D's own screw, x(f) = exp(f log D), f from 0 to 1: a constant twist, whose axis and
  pitch stay where they are. A task that both moves and turns takes the COG along an arc or a helix.
- *How fast.* f is a fifth-order polynomial of time, at rest at both ends.
- *Load.* Where the task translates, a force of ``acceleration × mass`` on the COG, against the COG's
  velocity; where it rotates, a torque of that times ℓ/2 against the angular velocity, ℓ being half the
  object's largest extent. Since the twist is constant, both are constant in the frame of an object that
  keeps to its path, and turn with it; they never do positive work on such an object.
- *Gravity.* A force of ``acceleration × mass`` on the centre of mass, in a direction that is fixed in the
  world: the task's, in the object's frame at the start.

The frame of everything here is the object's at the start.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...exceptions import TaskError
from ...spatial import along_screw, pose, rotation_from_vector, twist_log
from ...tasks import Task, full_motion
from ...types import Array, freeze, frozen_array, value

ACCELERATION = 9.8
"""Load and weight over mass [m/s²] (ENGINE.md, task test)."""
_NOTHING = 1e-9  # a smaller twist [m, rad over the whole way] is none


@value
class TaskMotion:
    """A way for the object, and the load on it.

    Attributes:
        displacement: (4, 4) D about the COG at the end of the way [m].
        cog: (3,) the COG in the object's frame [m].
        half_extent: ℓ, half the object's largest extent [m].
        gravity: (3,) unit direction, zeros for none.

    Raises:
        TaskError: the displacement moves nothing.
        InputError: arrays of the wrong shape, or not finite.
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
            raise TaskError("the task asks for no motion: the task test has nothing to do")

    @property
    def twist(self) -> Array:
        """(6,) log D, linear and angular about the COG [m, rad over the whole way]."""
        return twist_log(self.displacement)

    @property
    def translates(self) -> bool:
        """Whether the COG moves."""
        return bool(np.abs(self.twist[:3]).max() > _NOTHING)

    @property
    def rotates(self) -> bool:
        """Whether the object turns."""
        return bool(np.abs(self.twist[3:]).max() > _NOTHING)

    def path(self, fraction: ArrayLike) -> Array:
        """(..., 4, 4) the object's frame on its way, in its frame at the start; ``fraction`` (...) 0 to 1."""
        about_cog = along_screw(self.displacement, fraction)
        rotation = about_cog[..., :3, :3]
        return pose(rotation, about_cog[..., :3, 3] + self.cog - rotation @ self.cog)

    def velocity(self, fraction: ArrayLike) -> Array:
        """(..., 6) velocity of the COG and angular velocity, per unit of ``fraction`` [m, rad]."""
        f = np.asarray(fraction, dtype=np.float64)
        twist = self.twist
        turned = rotation_from_vector(f[..., None] * twist[3:])
        return np.concatenate([turned @ twist[:3], np.broadcast_to(twist[3:], (*f.shape, 3))], axis=-1)

    def load(self, fraction: ArrayLike, mass: float, acceleration: float = ACCELERATION) -> Array:
        """(..., 6) the load that opposes the motion, about the COG [N, N m]; without gravity.

        Args:
            fraction: (...) of the way, 0 to 1.
            mass: of the object [kg].
            acceleration: load over mass [m/s²].
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
        """(3,) the weight, a force on the centre of mass [N]."""
        return acceleration * mass * self.gravity


def task_motion(
    task: Task, cog: ArrayLike, half_extent: float, *, gravity: ArrayLike | None = None
) -> TaskMotion:
    """The motion and load of a task on an object.

    Args:
        task: the task.
        cog: (3,) centre of the object's bounding box, in its frame [m].
        half_extent: ℓ, half its largest extent [m].
        gravity: (3,) direction instead of the task's own; zeros for none.

    Raises:
        TaskError: the task asks for no motion.

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
    """(...) fraction of the way at ``share`` (...) of the time: 10 s³ - 15 s⁴ + 6 s⁵, at rest at both ends.

    >>> ease([0.0, 0.5, 1.0]).tolist()
    [0.0, 0.5, 1.0]
    """
    s = np.clip(np.asarray(share, dtype=np.float64), 0.0, 1.0)
    return np.asarray(s**3 * (10.0 + s * (6.0 * s - 15.0)))
