"""The instances of the task benchmark: pairs of an object at some size and a task.

Size [C]: each object is scaled by one factor, so that its middle extent, across which a hand mostly closes,
is 40 to 80 mm and its largest extent at most 160 mm. An object within these limits keeps its size.

Tasks [C]: each family is used with its default axis a; :mod:`preshape.tasks.families` defines the axes s and
u. An object suits a family if its bounding box and upper surface meet a condition:

==================  =======================================================================
families            condition
==================  =======================================================================
screw unscrew roll  round about a: the two extents across a differ by 15 % at most
insert              long along a: no extent is larger than the one along a
strike              long along s, the end that swings: 1.5 times the other extents or more
lever               long along u, towards the fulcrum: 1.5 times the other extents or more
pour                a vessel: with s up it holds liquid, 5 % of its bounding box or more
all others          none
==================  =======================================================================
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...exceptions import InputError
from ...objects.library import names
from ...objects.load import load_object
from ...objects.mesh import TriangleMesh
from ...objects.read_text import printable
from ...spatial import transform_points
from ...tasks import FAMILIES, Task, named_task
from ...tasks.families import directions
from ...types import Array, freeze, frozen_array, value
from .motion import TaskMotion, task_motion

MIDDLE = (0.04, 0.08)
"""Range of the middle extent [m]."""
LARGEST = 0.16
"""Limit of the largest extent [m]."""
ROUND, LONG, VESSEL = 0.85, 1.5, 0.05
"""The limits in the table of the module's docstring, as ratios."""
_CELLS = 40  # cells along the longer side of the grid of columns that are filled


@value
class TaskInstance:
    """One object in one task.

    Attributes:
        object_name: Library object or file.
        scale: Factor on its size.
        task: The task.
        cog: (3,) centre of its scaled bounding box [m].
        half_extent: Half its largest scaled extent [m].
        gravity: (3,) unit direction of gravity in the object's frame at the start; zeros for none.
        seed: Seed for the planner.
    """

    object_name: str
    scale: float
    task: Task
    cog: Array
    half_extent: float
    gravity: Array
    seed: int = 0

    def __post_init__(self) -> None:
        freeze(self, cog=frozen_array(self.cog, (3,), "COG"))
        freeze(self, gravity=frozen_array(self.gravity, (3,), "gravity"))

    @property
    def motion(self) -> TaskMotion:
        """Path and load."""
        return task_motion(self.task, self.cog, self.half_extent, gravity=self.gravity)


def holdable_scale(extents: Array) -> float:
    """The factor that scales an object to the size limits of the module's docstring, to two decimals.

    Args:
        extents: (3,) extents of the object's bounding box [m].

    >>> holdable_scale(np.array([0.05, 0.06, 0.07])), holdable_scale(np.array([0.02, 0.019, 0.138]))
    (1.0, 1.16)
    """
    _, middle, largest = np.sort(extents)
    factor = float(np.clip(middle, *MIDDLE) / middle)
    factor = min(factor, LARGEST / float(largest))
    return round(factor, 2) or factor


def suitable(task: Task, mesh: TriangleMesh) -> bool:
    """Whether the shape of an object suits a named task, by the table in the module's docstring."""
    if task.name not in FAMILIES or not task.axis:
        return True
    a, s, u = directions(task.axis)
    along, up, side = (float(np.abs(d) @ mesh.extents) for d in (a, s, u))
    least = 1.0 - 1e-6  # equal extents stay equal at any scale
    if task.name in ("screw", "unscrew", "roll"):
        return min(up, side) >= least * ROUND * max(up, side)
    if task.name == "insert":
        return along >= least * max(up, side)
    if task.name == "strike":
        return up >= least * LONG * max(along, side)
    if task.name == "lever":
        return side >= least * LONG * max(along, up)
    if task.name == "pour":
        return liquid(mesh, s) >= VESSEL
    return True


def liquid(mesh: TriangleMesh, up: Array) -> float:
    """Volume of the liquid that an object holds, as a share of its bounding box.

    The upper surface is sampled on a grid of columns. Each column is filled to the lowest rim that the liquid
    passes on its way out (priority flood, Barnes et al. 2014); a column that misses the object is an outlet.

    Args:
        mesh: The object.
        up: (3,) unit vector along an axis, against gravity.
    """
    from ...kernels.rays import RayCaster

    z = int(np.abs(up).argmax())
    x, y = (axis for axis in range(3) if axis != z)
    low, extents = mesh.bounds[0], mesh.extents
    cell = max(extents[x], extents[y]) / _CELLS
    shape = tuple(max(1, round(float(extents[axis] / cell))) for axis in (x, y))
    columns = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), -1).reshape(-1, 2)
    origins = np.empty((len(columns), 3))
    origins[:, [x, y]] = low[[x, y]] + (columns + 0.5) / shape * extents[[x, y]]
    origins[:, z] = mesh.cog[z] + up[z] * extents[z]
    fall = RayCaster(mesh).cast(origins, np.tile(-up, (len(columns), 1))).distance
    ground = (1.5 * extents[z] - fall).reshape(shape)  # height above the lowest point; -inf if missed
    depth = np.subtract(_liquid_level(ground), ground, out=np.zeros(shape), where=np.isfinite(ground))
    return float(depth.sum() / (depth.size * extents[z]))


def _liquid_level(ground: Array) -> Array:
    """(n, m) height of the liquid in each cell, from the (n, m) heights of the ground."""
    level = np.full(ground.shape, np.inf)
    n, m = ground.shape
    queue: list[tuple[float, int, int]] = []
    for i, j in np.ndindex(n, m):
        if i in (0, n - 1) or j in (0, m - 1) or not np.isfinite(ground[i, j]):
            level[i, j] = ground[i, j]
            heapq.heappush(queue, (float(ground[i, j]), i, j))
    while queue:
        height, i, j = heapq.heappop(queue)
        for p, q in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            if 0 <= p < n and 0 <= q < m and np.isinf(level[p, q]) and level[p, q] > 0:
                level[p, q] = max(height, float(ground[p, q]))
                heapq.heappush(queue, (float(level[p, q]), p, q))
    return level


def make_instances(
    objects: Sequence[str] | None = None,
    families: Sequence[str] | None = None,
    *,
    seed: int = 0,
    count: int | None = None,
    gravity: Array | None = None,
) -> tuple[TaskInstance, ...]:
    """Make the instances of the benchmark, ordered by object and then by task.

    Args:
        objects: Library names or files; by default all library objects.
        families: Named tasks, with an axis after a colon where it is not the default; by default all
            families. A task that does not suit an object is left out.
        seed: Seed for the planner, and for the choice of ``count`` instances.
        count: Number of instances, spread over the tasks as evenly as possible; by default all.
        gravity: (3,) direction of gravity that replaces each task's own; zeros for none.

    Raises:
        InputError: An object or task is unknown, no instance is left, or ``count`` or ``seed`` is out of
            range.
    """
    if seed < 0 or (count is not None and count < 1):
        raise InputError(f"the seed must be 0 or more and the count 1 or more, got {seed} and {count}")
    tasks = tuple(named_task(name) for name in (families if families is not None else FAMILIES))
    found = []
    for name in dict.fromkeys(objects if objects is not None else names()):
        scale = holdable_scale(load_object(name).extents)
        mesh = load_object(name, scale=scale)
        for task in tasks:
            if suitable(task, mesh):
                direction = np.asarray(task.gravity if gravity is None else gravity, dtype=np.float64)
                found.append(
                    TaskInstance(
                        object_name=name,
                        scale=scale,
                        task=task,
                        cog=mesh.cog,
                        half_extent=float(mesh.extents.max()) / 2,
                        gravity=direction / (np.linalg.norm(direction) or 1.0),
                        seed=seed,
                    )
                )
    if not found:
        raise InputError("no instance is left: none of these tasks suits any of these objects; name others")
    return tuple(found) if count is None else _chosen(found, count, seed)


def _chosen(found: list[TaskInstance], count: int, seed: int) -> tuple[TaskInstance, ...]:
    """``count`` instances, one of each task in turn; those of one task are taken in random order."""
    order = np.random.default_rng(seed).permutation(len(found))
    rounds: dict[str, int] = {}
    draws: list[tuple[int, int, int]] = []
    for index in order.tolist():
        label = found[index].task.label
        rounds[label] = rounds.get(label, -1) + 1
        draws.append((rounds[label], len(draws), index))
    return tuple(found[index] for index in sorted(index for _, _, index in sorted(draws)[:count]))


def instance_to_json(instance: TaskInstance, mass: float) -> dict[str, Any]:
    """An instance as plain JSON values, with all that another planner or simulator needs.

    Args:
        instance: The instance.
        mass: Mass of the object [kg].
    """
    motion = instance.motion
    wrench = motion.load(0.0, mass)
    goal = motion.path(1.0)
    return {
        "object": instance.object_name,
        "scale": instance.scale,
        "task": instance.task.label,
        "means": instance.task.means,
        "Q": instance.task.q.tolist(),
        "cog": instance.cog.tolist(),
        "half_extent": instance.half_extent,
        "motion": {
            "displacement_about_cog": motion.displacement.tolist(),
            "T_start_goal": goal.tolist(),
            "cog_at_goal": transform_points(goal, motion.cog).tolist(),
        },
        "load": {
            "force_at_start": (wrench[:3] + 0.0).tolist(),
            "torque_at_start": (wrench[3:] + 0.0).tolist(),
            "weight": (motion.weight(mass) + 0.0).tolist(),
        },
        "gravity": (instance.gravity + 0.0).tolist(),
        "seed": instance.seed,
    }


def mesh_text(mesh: TriangleMesh) -> str:
    """A mesh as Wavefront OBJ text, in metres and without rounding."""
    lines = [f"# {printable(mesh.name)}, metres"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.triangles + 1).tolist()]
    return "\n".join(lines) + "\n"
