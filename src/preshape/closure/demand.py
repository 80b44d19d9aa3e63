"""The wrenches that a task and plain holding ask of a grip, their levers, and the reference point."""

from __future__ import annotations

import numpy as np

from ..kernels.field.host import DistanceField
from ..objects.mesh import TriangleMesh
from ..tasks.task import ROTATION_ABSENT, TRANSLATION_ABSENT
from ..types import Array, freeze, frozen_array, value

TASK_LEVER = 0.5
"""Torque of a turning task's load divided by the load's force, in units of ℓ (ENGINE §4)."""
HOLD = np.concatenate([np.eye(6), -np.eye(6)])
"""Wrenches of plain holding: forces along the axes, torques about them; torques divided by :data:`LEVER`."""
LEVER = 0.05
"""Torque divided by force in plain holding [m], as in the field's harder test; less on small objects."""
LONGEST = 0.1
"""Largest ℓ by which torques are compared with forces, unless the task itself turns the object [m] [C]. In
the cone of a push or pull, torques are what a disturbance adds to its load. They come from where fingers and
load act, which a longer object does not change; its weight acts at its centre of mass in any case."""
FEWEST_NODES = 50
"""Least number of grid nodes inside the object for a centre of mass; with fewer, the COG is used."""


@value
class Demand:
    """What a grip must produce, in units of the sum of its normal forces.

    Attributes:
        direction: (6,) wrench of the task (force; torque divided by :meth:`unit`), or ``None`` for plain
            holding.
        half_angle: Half-angle of the cone around that wrench [rad].
        base: (6,) wrench that the grip must always produce to carry the object: minus the weight.
        load: Expected load of the task, in weights of the object; for plain holding it is one weight.
    """

    direction: Array | None = None
    half_angle: float = float(np.radians(15.0))
    base: Array | tuple[float, ...] = (0.0,) * 6
    load: float = 1.0

    def __post_init__(self) -> None:
        freeze(self, base=frozen_array(self.base, (6,), "base wrench"))
        if self.direction is not None:
            freeze(self, direction=frozen_array(self.direction, (6,), "task direction"))

    def unit(self, length: float) -> float:
        """Length by which the torques of this demand are divided [m].

        Args:
            length: ℓ, half the object's largest extent [m].
        """
        turns = self.direction is not None and bool(np.any(self.direction[3:]))
        return length if turns else min(length, LONGEST)


def task_demand(q: Array, weight: Array) -> Demand:
    """The demand of a task.

    Args:
        q: (6,) task Q; components at their value for "absent" ask nothing.
        weight: (3,) force of gravity on the object, divided by the planned press.
    """
    move = np.where(np.abs(q[:3]) > TRANSLATION_ABSENT + 1e-9, q[:3], 0.0)
    turn = np.where(np.abs(q[3:]) > ROTATION_ABSENT + 1e-9, q[3:], 0.0)
    force = move / np.linalg.norm(move) if move.any() else move
    torque = TASK_LEVER * turn / np.linalg.norm(turn) if turn.any() else turn
    direction = np.concatenate([force, torque])
    base = np.append(-weight, np.zeros(3))
    if not direction.any():
        return Demand(base=base)
    return Demand(direction=direction, base=base, load=float(np.linalg.norm(direction)))


def turn_levers(mesh: TriangleMesh, cog: Array, length: float) -> list[tuple[float, Array]]:
    """The torques of plain holding about the principal axes of a slender object.

    A push on a pen cannot turn it about its long axis with a lever of ``LEVER``. The lever about each axis is
    therefore at most 1.5 times the largest distance of the object's surface from that axis.

    Args:
        mesh: The object.
        cog: (3,) reference point of torques [m].
        length: ℓ, half the object's largest extent [m].

    Returns:
        Pairs of a lever [m] and the (k, 6) wrenches with that lever; empty if no axis has a shorter lever
        than plain holding.
    """
    whole = min(LEVER, 1.5 * length)
    middle = mesh.corners.mean(axis=1) - cog
    _, axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", mesh.areas / mesh.areas.sum(), middle, middle))
    local = (mesh.vertices - cog) @ axes
    reach = [float(np.linalg.norm(np.delete(local, k, axis=1), axis=1).max()) for k in range(3)]
    levers = [min(whole, round(1.5 * distance, 6)) for distance in reach]
    if min(levers) > 0.999 * whole:
        return []
    turns = np.concatenate([np.zeros((3, 3)), axes]).T
    return [
        (lever, np.concatenate([[turns[k], -turns[k]] for k in range(3) if levers[k] == lever]))
        for lever in sorted(set(levers))
    ]


def inner_centre(field: DistanceField, mesh: TriangleMesh) -> Array:
    """(3,) centre of mass of the solid [m], from the grid nodes inside; the COG if they are too few.

    The object need not be watertight: the sign of the field is the winding number.
    """
    inside = np.argwhere(field.distance < 0)
    if len(inside) < FEWEST_NODES:
        return mesh.cog
    return np.asarray(field.origin + field.spacing * inside.mean(axis=0))
