"""The planner's public face: keyword arguments become a request, and one session answers it.

>>> from preshape import plan
>>> answer = plan("cube", "1 1 .1 .05 .8 .05", hand="utah_mit", memory=":memory:")
>>> answer.grasp.plane.index, answer.decision.mode
(5, 0)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .closure.settings import ClosureSettings
from .exceptions import InputError, shown
from .hands.hand import Hand
from .hiis.decision import Settings
from .memory import Memory
from .objects.load import mesh_from
from .objects.mesh import TriangleMesh
from .planning.plan import Plan
from .planning.request import HAND, PlanRequest
from .planning.request_values import checked_parts
from .planning.session import Session
from .planning.standing import DEFAULT
from .tasks import Task
from .types import whole_number

if TYPE_CHECKING:
    import trimesh


def plan(
    thing: str | Path | TriangleMesh | trimesh.Trimesh,
    task: str | Sequence[float] | Task,
    *,
    hand: str | Hand = HAND,
    analyser: str | None = None,
    scale: float = 1.0,
    unit: str = "m",
    mass: float | None = None,
    friction: float | None = None,
    memory: str | Path | Memory | None = None,
    learn: bool = True,
    seed: int = 0,
    count: int = 1,
    approaches: str | None = None,
    grasp_type: str = "any",
    settings: Settings | None = None,
    closure: ClosureSettings | None = None,
    table: float | str | None = DEFAULT,
    avoid: Sequence[Sequence[float]] = (),
    verify: bool = False,
    view: Sequence[float] | str | None = None,
    cut_table: bool | None = None,
    mask: str | Path | int | None = None,
    hold_on: str | Sequence[str | Sequence[float]] = (),
    keep_off: str | Sequence[str | Sequence[float]] = (),
    rules: str = "task",
    up: str | None = None,
    rest: Sequence[float] | None = None,
    obstacle: str | Sequence[str] = (),
    arm: str | Path | None = None,
    arm_tip: str | None = None,
    mount: Sequence[float] | None = None,
    base_pose: Sequence[float] | None = None,
) -> Plan:
    """Plan a preshape.

    Args:
        thing: A mesh or point-cloud file, the name of a library object, or a mesh [m].
        task: A task's name, six numbers, or a task.
        hand: A hand's name, its description file, or a loaded hand.
        analyser: ``rays`` or ``closure``; by default the hand's own.
        scale: Factor on the object's size.
        unit: Unit of the file: ``m``, ``cm``, ``mm``, ``in``.
        mass: Mass of the object [kg]; by default the object's own, or an estimate from its volume.
        friction: Friction coefficient between hand and object; by default 0.6.
        memory: The memory's file, an open memory, ``":memory:"``, or ``None`` for the user's.
        learn: Whether a new object is taught to the memory.
        seed: Seed of every random draw; the same seed gives the same plan.
        count: Number of different answers.
        approaches: Allowed approach axes, such as ``+z,-x``.
        grasp_type: ``power`` for wraps of the whole hand only, ``precision`` for fingertips only, or ``any``;
            closure only.
        settings: Thresholds, membership functions and contact coefficients.
        closure: Size and safety of the closure search.
        table: ``auto`` for a table that the object rests on, the height of one along ``up`` [m], or ``None``
            for free space; closure only. By default ``auto`` for a real hand, else free space.
        avoid: Boxes that hand and fingers stay out of, six numbers each: lower and upper corner in the mesh
            frame [m]; closure only.
        verify: Whether the best answers go through the holding test in physics; the first that holds is
            the answer.
        view: Camera position of a point cloud, in the file's frame and unit, or ``all`` for points from all
            round; by default what the file says, else its origin where that can be.
        cut_table: Whether a table in a point cloud is cut off; ``False`` keeps it as part of the object. By
            default a cloud with a table is refused.
        mask: Which points of a depth camera's scene are the object's: a file (.npy, .png) with a number for
            each point or pixel, not zero for the object, or the number of a label in an NPZ file.
        hold_on: Parts of the object to hold, any of them: names (``preshape objects NAME`` lists them),
            half-spaces such as ``z>0.05``, or boxes of six numbers [m].
        keep_off: Parts that contacts and links stay away from.
        rules: ``task`` for the rules of object and task too, or ``none``.
        up: Axis of the mesh that is up, such as ``y`` or ``-x``; task, table and gravity follow it. By
            default z, and y for a glTF file.
        rest: (4,) quaternion wxyz that turns the mesh, as it lies at rest on a table, to a world with z up;
            by default the object's own, or else it is settled.
        obstacle: Meshes or point clouds that hand and fingers stay away from by 3 mm, each ``FILE`` or
            ``FILE@x,y,z,qw,qx,qy,qz``, its pose in the mesh frame [m]; closure only.
        arm: URDF of the arm that carries the hand; answers that it does not reach are left out.
        arm_tip: Link of the arm that carries the hand.
        mount: (7,) pose of the hand's root on that link, xyz [m] and wxyz; by default the link's own.
        base_pose: (7,) pose of the arm's base in the world, whose z is up and whose origin is that of the
            mesh frame, xyz [m] and wxyz.

    Raises:
        InputError: An argument that cannot be used; the message says what to change.
        EnvironmentFailure: A file could not be read or written.
    """
    seed = whole_number(seed, "seed", 0)
    chosen = Settings(seed=seed) if settings is None else settings
    if seed and isinstance(chosen, Settings):
        chosen = replace(chosen, seed=seed)
    if not isinstance(thing, str | Path | TriangleMesh):
        thing, unit, scale = mesh_from(thing, unit, scale), "m", 1.0
    request = PlanRequest(
        source=thing,
        task=task,
        hand=hand,
        analyser="" if analyser is None else analyser,
        scale=scale,
        unit=unit,
        view=view,
        cut_table=cut_table,
        mask=mask,
        up=up,
        obstacle=obstacle,
        arm=arm,
        arm_tip=arm_tip,
        mount=mount,
        base_pose=base_pose,
        rest=rest,
        mass=mass,
        friction=friction,
        table=table,
        avoid=avoid,
        approaches=approaches,
        grasp_type=grasp_type,
        count=count,
        learn=learn,
        verify=verify,
        settings=chosen,
        search=ClosureSettings() if closure is None else closure,
        hold_on=checked_parts(hold_on, "hold_on"),
        keep_off=checked_parts(keep_off, "keep_off"),
        rules=rules,
        memory=_file_of(memory),
    )
    with Session(memory, learn=learn) as session:
        return session.run(request)


def _file_of(memory: Any) -> str | None:
    """The memory's file as it stands in the request.

    Raises:
        InputError: Not a file, a memory or ``None``.
    """
    if isinstance(memory, Memory):
        return memory.where
    if memory is None or isinstance(memory, str | Path):
        return None if memory is None else str(memory)
    raise InputError(f"memory must be a file, an open memory or None, got {shown(memory)}")
