"""The instances of the task benchmark: which object, at which size, in which task.

Size [C]: one factor an object brings its middle extent, across which a hand mostly closes, into 40 to 80 mm,
and then its largest to at most 160 mm; an object that is there already keeps its size.

Which tasks [C]: a family takes part with its default axis a; s and u are those of
:mod:`preshape.tasks.families`. An object is fit for a family by its shape alone, judged from its
bounding box and its upper surface:

==================  =======================================================================
families            fit where
==================  =======================================================================
screw unscrew roll  round about a: the two extents across a differ by 15 % at most
insert              it leads with an end: no extent is larger than the one along a
strike              long along s, the end that swings: 1.5 times the other extents or more
lever               long along u, towards the fulcrum: 1.5 times the other extents or more
pour                a vessel: with s up it holds liquid, 5 % of its bounding box or more
the others          always: any object can be moved so
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
from ...spatial import transform_points
from ...tasks import FAMILIES, Task, named_task
from ...tasks.families import _directions
from ...types import Array, freeze, frozen_array, value
from .motion import TaskMotion, task_motion

MIDDLE = (0.04, 0.08)
"""Range of the middle extent [m]."""
LARGEST = 0.16
"""Largest extent [m]."""
ROUND, LONG, VESSEL = 0.85, 1.5, 0.05
_CELLS = 40  # of the grid on which liquid is poured, along the longer side


@value
class TaskInstance:
    """One object in one task.

    Attributes:
        object_name: a library object or a file.
        scale: factor on its size.
        task: the task.
        cog: (3,) centre of its bounding box after scale [m].
        half_extent: half its largest extent after scale [m].
        gravity: (3,) unit direction in its frame at the start, zeros for none.
        seed: for the planner.
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
        """Way and load."""
        return task_motion(self.task, self.cog, self.half_extent, gravity=self.gravity)


def holdable_scale(extents: Array) -> float:
    """The factor that makes an object holdable, see the module; to two digits after the point.

    Args:
        extents: (3,) of its bounding box [m].

    >>> holdable_scale(np.array([0.05, 0.06, 0.07])), holdable_scale(np.array([0.02, 0.019, 0.138]))
    (1.0, 1.16)
    """
    _, middle, largest = np.sort(extents)
    factor = float(np.clip(middle, *MIDDLE) / middle)
    factor = min(factor, LARGEST / float(largest))
    return round(factor, 2) or factor


def makes_sense(task: Task, mesh: TriangleMesh) -> bool:
    """Whether an object's shape is fit for a named task, by the rule in the module."""
    if task.name not in FAMILIES or not task.axis:
        return True
    a, s, u = _directions(task.axis)
    along, up, side = (float(np.abs(d) @ mesh.extents) for d in (a, s, u))
    least = 1.0 - 1e-6  # what is equal stays equal at any scale
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
    """How much liquid stands on an object, as a share of its bounding box.

    Its upper surface is sampled on a grid of columns, and every column is filled to the lowest rim on the way
    out (priority flood, Barnes et al. 2014); a column that misses the object lets everything run out.

    Args:
        mesh: the object.
        up: (3,) a unit vector along an axis.
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
    ground = (1.5 * extents[z] - fall).reshape(shape)  # height over the lowest point; -inf beside the object
    filled = _filled(ground)
    under = np.isfinite(ground)
    deep = np.subtract(filled, ground, out=np.zeros(shape), where=under)
    return float(deep.sum() / (deep.size * extents[z]))


def _filled(ground: Array) -> Array:
    """The height to which liquid stands in every cell of a (n, m) grid of heights."""
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
    """The benchmark's instances: objects in their order, and the tasks of each in theirs.

    Args:
        objects: library names or files; default all library objects.
        families: named tasks, with an axis after a colon where not the default; default all families. One
            that is unfit for an object is left out.
        seed: given to the planner, and of the choice of ``count``.
        count: only so many, the same number of each task as far as there are; default all.
        gravity: (3,) direction for all instead of each task's own; zeros for none.

    Raises:
        InputError: an unknown object or task, no instance at all, or a count or seed out of range.
    """
    if seed < 0 or (count is not None and count < 1):
        raise InputError(f"the seed must be 0 or more and the count 1 or more, got {seed} and {count}")
    tasks = tuple(named_task(name) for name in (families if families is not None else FAMILIES))
    found = []
    for name in dict.fromkeys(objects if objects is not None else names()):
        scale = holdable_scale(load_object(name).extents)
        mesh = load_object(name, scale=scale)
        for task in tasks:
            if makes_sense(task, mesh):
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
        raise InputError("no instance: none of these objects is fit for any of these tasks")
    return tuple(found) if count is None else _chosen(found, count, seed)


def _chosen(found: list[TaskInstance], count: int, seed: int) -> tuple[TaskInstance, ...]:
    """``count`` of them, in turns one of each task, those of a task in random order."""
    order = np.random.default_rng(seed).permutation(len(found))
    turns: dict[str, int] = {}
    ranked: list[tuple[int, int, int]] = []
    for index in order.tolist():
        label = found[index].task.label
        turns[label] = turns.get(label, -1) + 1
        ranked.append((turns[label], len(ranked), index))
    kept = sorted(index for _, _, index in sorted(ranked)[:count])
    return tuple(found[index] for index in kept)


def instance_to_json(instance: TaskInstance, mass: float) -> dict[str, Any]:
    """Everything that another planner or simulator needs of an instance, as plain JSON values.

    Args:
        instance: one.
        mass: of the object [kg].
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
    """A mesh as Wavefront OBJ, in metres, every digit kept."""
    lines = [f"# {mesh.name}, metres"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.triangles + 1).tolist()]
    return "\n".join(lines) + "\n"
