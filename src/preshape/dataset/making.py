"""Makes one shard, from its description to the bytes of its file, in any process."""

from __future__ import annotations

import os
import socket
import time
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from .._version import __version__
from ..exceptions import EnvironmentFailure, InputError, ObjectError, PreshapeError
from ..hands.hand import Hand
from ..hands.load import load_hand
from ..hiis.analyser import Grip
from ..hiis.fuzzy import SET_NAMES
from ..objects.mesh import TriangleMesh
from ..physics.task.instances import suitable
from ..physics.task.motion import task_motion
from ..planning.answers import Answer
from ..planning.hand_simulation import execute
from ..tasks import Task, parse_task
from ..types import LENGTH_UNIT, value
from .drawing import ShardGrasps, shard_grasps
from .index_values import INDICES, IndexInput, index_values, planner_score
from .outcomes import Row, tested, untested
from .schema import FORMAT, METRICS, parquet_bytes
from .settings import DatasetSettings, Shard, mesh_digest, task_label, usable_object

LIBRARIES = ("numpy", "scipy", "warp-lang", "mujoco-core", "coacd", "pyarrow")
"""Libraries whose version may affect the numbers or the bytes of a file."""


@value
class MadeShard:
    """The file of a shard, not yet written.

    Attributes:
        name: Name of the shard.
        content: Bytes of the file.
        facts: The shard's metadata, see :func:`make_shard`.
        seconds: Times of ``plan``, ``metrics``, ``physics`` and ``total``, and ``processor``, the CPU time
            [s].
        process: Process id of the worker.
        host: Name of the worker's machine.
        fault: The internal error because of which the shard could not be made; empty otherwise.
    """

    name: str
    content: bytes
    facts: dict[str, Any]
    seconds: dict[str, float]
    process: int
    host: str
    fault: str = ""


def versions() -> dict[str, str]:
    """Versions of preshape and of :data:`LIBRARIES`."""
    found = {"preshape": __version__}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def make_shard(shard: Shard, settings: DatasetSettings, expected: dict[str, str]) -> MadeShard:
    """Plan the grasps of one shard, compute their indices and test them in physics.

    The same arguments give the same bytes in every process. An internal error is returned as ``fault``
    instead of being raised, so that it does not stop the other shards.

    Args:
        shard: The shard.
        settings: Settings of the dataset.
        expected: Versions that this process must have, from :func:`versions`.

    Raises:
        InputError: The object's mesh has changed since the shard was listed.
        EnvironmentFailure: This process has other versions, or a file or package is missing.
    """
    from threadpoolctl import threadpool_limits

    present = versions()
    if present != expected:
        differing = [
            f"{name} {present.get(name)} instead of {expected.get(name)}"
            for name in {**present, **expected}
            if present.get(name) != expected.get(name)
        ]
        raise EnvironmentFailure(
            f"{socket.gethostname()} has {', '.join(differing)}; install the same versions on every machine"
        )
    clock = _Clock()
    facts, content, fault = {}, b"", ""
    try:
        with threadpool_limits(1):  # one core for each shard
            rows, reason, suits = _rows(shard, settings, clock)
        facts = _facts(shard, settings, rows, reason, suits)
        content = parquet_bytes(rows, facts)
    except PreshapeError:
        raise
    except Exception as error:  # a long run must not stop because of one shard
        if os.environ.get("PRESHAPE_DEBUG"):
            raise
        fault = f"{type(error).__name__}: {error}"
    return MadeShard(
        name=shard.name,
        content=content,
        facts=facts,
        seconds=clock.seconds(),
        process=os.getpid(),
        host=socket.gethostname(),
        fault=fault,
    )


class _Clock:
    def __init__(self) -> None:
        self.start = self.last = time.perf_counter()
        self.processor = time.process_time()
        self.laps: dict[str, float] = {}

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name], self.last = now - self.last, now

    def seconds(self) -> dict[str, float]:
        return {
            **self.laps,
            "total": time.perf_counter() - self.start,
            "processor": time.process_time() - self.processor,
        }


def _rows(shard: Shard, settings: DatasetSettings, clock: _Clock) -> tuple[list[Row], str, bool | None]:
    """The rows, the reason if there are too few of them, and whether the task suits the object's shape."""
    hand, task = load_hand(shard.hand), parse_task(shard.task)
    mesh, why = usable_object(shard.source, shard.scale)
    if mesh_digest(mesh) != shard.mesh:
        raise InputError(
            f"{shard.source} holds another object on {socket.gethostname()}; "
            "every machine needs the same file at the same path"
        )
    try:
        if mesh is None:
            return [], why, None
        found = shard_grasps(hand, mesh, task, shard.count, shard.seed, settings)
    except ObjectError as error:
        return [], str(error), None
    finally:
        clock.lap("plan")
    answers = tuple(
        Answer(grasp=grasp, hand_result=execute(hand, mesh, grasp, seed=shard.seed)) for grasp in found.grasps
    )
    suits = suitable(task, mesh)
    place = {
        "shard": shard.name,
        "object": shard.object_name,
        "scale": shard.scale,
        "hand": hand.name,
        "task": task_label(task),
        "part": shard.part,
        "seed": shard.seed,
        "ranked": settings.ranked,
        "task_q": task.q.tolist(),
        "task_suits": suits,
    }
    rows = [
        {**place, "row": k, **_of_grasp(answer), **_metrics(grasp, found, hand, mesh, task, settings)}
        for k, (answer, grasp) in enumerate(zip(answers, found.grasps, strict=True))
    ]
    clock.lap("metrics")
    outcomes = (
        tested(shard, hand, mesh, task, answers, settings) if settings.physics else untested(len(answers))
    )
    clock.lap("physics")
    return [row | outcome for row, outcome in zip(rows, outcomes, strict=True)], found.reason, suits


def _of_grasp(answer: Answer) -> Row:
    """The columns with the planner's results."""
    g, result = answer.grasp, answer.hand_result
    assert isinstance(g, Grip)
    poses: Row = {}
    for stage in ("pregrasp", "grasp", "squeeze"):
        pose = getattr(result, stage)
        poses |= {f"{stage}_palm": pose.palm_pose.tolist(), f"{stage}_q": pose.q.tolist()}
    return {
        **poses,
        "plane": g.plane.index,
        "approach_axis": (g.plane.approach_axis + 0.0).tolist(),
        "opposition_axis": (g.plane.opposition_axis + 0.0).tolist(),
        "flip": g.flip,
        "approach_value": g.approach_value,
        "approach_set": SET_NAMES[g.approach_set],
        "virtual_fingers": g.fingers,
        "fingers": list(g.fingers_touching),
        "approach": g.approach.tolist(),
        "torques": g.torques.tolist(),
        "contact_points": g.contacts.points.tolist(),
        "contact_normals": g.contacts.normals_in.tolist(),
        "forces": g.forces.tolist(),
        "press": g.press,
        "net_wrench": g.net_wrench.tolist(),
        "adi": g.adi.tolist(),
        "clearance": g.clearance,
        "quality": g.quality,
        "task_margin": g.task_margin,
        "hold_margin": g.hold_margin,
    }


def _metrics(
    grasp: Grip,
    found: ShardGrasps,
    hand: Hand,
    mesh: TriangleMesh,
    task: Task,
    settings: DatasetSettings,
) -> Row:
    """The columns ``metric_…``."""
    analyser, length = found.analyser, float(mesh.extents.max()) / 2
    seen = IndexInput(
        points=grasp.contacts.points,
        normals_in=grasp.contacts.normals_in,
        centre=analyser.middle,
        cog=mesh.cog,
        length=length,
        length_unit=LENGTH_UNIT * hand.u,
        plane=grasp.plane.index,
    )
    values = index_values(
        seen,
        task.q,
        task_motion(task, mesh.cog, length),
        mass=settings.mass,
        press=grasp.press,
        settings=analyser.settings,
        score=partial(planner_score, analyser.search, seen),
    )
    closed = values["closed"][0]
    return {
        "metric_closed": None if closed is None else bool(closed),
        **{f"metric_{index.name}": values[index.name][0] for index in METRICS},
        "metric_status": {index.name: values[index.name][1] for index in INDICES},
    }


def _facts(
    shard: Shard, settings: DatasetSettings, rows: list[Row], reason: str, suits: bool | None
) -> dict[str, Any]:
    """The facts of a shard, which are stored in its file as metadata."""
    return {
        "format": FORMAT,
        "shard": shard.name,
        **settings.conditions(),
        "asked": shard.count,
        "rows": len(rows),
        "reason": reason,
        "held": sum(row["held"] is True for row in rows),
        "hold_tested": sum(row["held"] is not None for row in rows),
        "task_done": sum(row["task_done"] is True for row in rows),
        "task_tested": sum(row["task_done"] is not None for row in rows),
        "task_suits": suits,
    }
