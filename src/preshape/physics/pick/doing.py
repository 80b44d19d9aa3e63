"""The do test: after the pick test, the hand does the job with the object that it holds.

1. ``turn``: the hand turns the object about its centre of mass, until the weight acts along the task's own
   gravity; the smallest rotation that does it. The table is gone: the job is done elsewhere.
2. ``load``, ``path``, ``rest``: load, motion and limits of :mod:`preshape.physics.task`, on a path that
   begins at the object's pose after the turn. The weight acts all the time.
"""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any

import numpy as np

from ... import spatial
from ...types import Array
from ..hold.six_directions import Observer, unstable
from ..scene import TABLE, Scene
from ..task.motion import TaskMotion, ease
from ..task.protocol import TaskProtocol, TaskRun
from .protocol import Done, PickProtocol

JOB_STAGES = ("turn", "load", "path", "rest")
"""Stages of the do test, in their order."""


def do_job(
    scene: Scene, data: Any, work: TaskMotion, protocol: PickProtocol, *, observer: Observer | None = None
) -> Done:
    """Do a task with the object that the hand holds at rest.

    Args:
        scene: Scene of the pick test.
        data: The ``mujoco.MjData`` in which :func:`~preshape.physics.pick.picking.pick_up` left it.
        work: Path, load and gravity of the task, in the object's frame.
        protocol: Settings of the test.
        observer: Called at every check with the stage and the data.
    """
    scene = _without_table(scene)
    rules = TaskProtocol(hold=protocol.scene(scene.mass), look_steps=protocol.look_steps)
    held = _relative(scene, data)
    if work.gravity.any():
        _turn(scene, data, work.gravity, protocol, observer)
    if unstable(data):
        return Done(done=False, reason="the simulation became unstable while the hand turned the object")
    moved = spatial.inverse(held) @ _relative(scene, data)
    far = float(np.linalg.norm(moved[:3, 3]))
    angle = float(np.linalg.norm(spatial.vector_from_rotation(moved[:3, :3])))
    if far > rules.hold.displacement_limit or angle > rules.hold.rotation_limit:
        return Done(
            done=False,
            reason=f"the hand lost the object while it turned it to the task's gravity: it moved "
            f"{1e3 * far:.0f} mm and {math.degrees(angle):.0f}°",
            displacement=far,
            rotation=angle,
        )
    T_object, _ = _poses(scene, data)
    # The weight acts downwards, wherever the turn ended.
    down = replace(work, gravity=-T_object[2, :3])
    run = TaskRun(scene, data, T_object, _target(data), down, rules, carried=True)
    result = run.result({"row": 0, "object_name": "", "scale": 1.0, "task": ""}, observer)
    return Done(
        done=result.passed,
        reason=result.reason,
        displacement=result.displacement,
        rotation=result.rotation,
        progress=result.progress,
    )


def _turn(scene: Scene, data: Any, gravity: Array, protocol: PickProtocol, observer: Observer | None) -> None:
    """Turn hand and object until gravity (3,), in the object's frame, points down."""
    import mujoco

    T_object, _ = _poses(scene, data)
    start = _target(data)
    now = T_object[:3, :3] @ gravity
    sine = np.cross(now, [0.0, 0.0, -1.0])
    angle = math.atan2(float(np.linalg.norm(sine)), float(-now[2]))
    if angle < math.radians(0.5):
        return
    length = float(np.linalg.norm(sine))
    # Opposite directions: any horizontal axis will do.
    axis = sine / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    centre = spatial.transform_points(T_object, np.array(scene.model.body_ipos[scene.object_body]))
    steps = max(1, round(protocol.turn / protocol.timestep))
    for step, share in enumerate(ease(np.arange(1, steps + 1) / steps)):
        R = spatial.rotation_from_vector(float(share) * angle * axis)
        seven = spatial.seven_from_pose(spatial.pose(R, centre - R @ centre) @ start)
        data.mocap_pos[0], data.mocap_quat[0] = seven[:3], seven[3:]
        mujoco.mj_step(scene.model, data)
        if observer is not None and ((step + 1) % protocol.look_steps == 0 or step + 1 == steps):
            observer("turn", data)


def _without_table(scene: Scene) -> Scene:
    """The same scene, whose table nothing touches."""
    model = copy.copy(scene.model)
    table = model.geom(TABLE).id
    model.geom_contype[table] = model.geom_conaffinity[table] = 0
    return replace(scene, model=model)


def _poses(scene: Scene, data: Any) -> tuple[Array, Array]:
    """(4, 4) poses of the object and of the hand's root in the world [m]."""
    first, root = scene.object_address, scene.root_address
    return (
        spatial.pose_from_seven(np.array(data.qpos[first : first + 7])),
        spatial.pose_from_seven(np.array(data.qpos[root : root + 7])),
    )


def _target(data: Any) -> Array:
    """(4, 4) pose in the world that the hand's root is welded to [m]."""
    return spatial.pose_from_seven(np.array([*data.mocap_pos[0], *data.mocap_quat[0]]))


def _relative(scene: Scene, data: Any) -> Array:
    """(4, 4) pose of the object in the frame of the hand's root [m]."""
    T_object, T_root = _poses(scene, data)
    return np.asarray(spatial.inverse(T_root) @ T_object)
