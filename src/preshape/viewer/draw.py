"""Drawing of a plan in 3D on any canvas, so that page, browser and picture show the same solids."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..objects.resting import turned_up
from ..types import Array
from .canvas import Canvas, RecordingCanvas
from .colours import (
    APPROACH,
    AVOID,
    INK,
    OPPOSITION,
    QUIET,
    TABLE,
    TASK,
    TRANSVERSE,
    WRENCH,
    Colour,
    finger_colour,
)
from .hand_motion import HandMotion
from .plan_scene import FORCE_LENGTH, PlaneCard, PlanScene, approach_arrow, axis_tips
from .raycast import Shape
from .shading import tangents
from .shapes import arrow, box, card, card_border, cone, join, object_shape, sphere, tube

GROUPS = {
    "object": "Object",
    "frame": "Object frame",
    "planes": "Approach planes",
    "axes": "Approach, opposition, transverse",
    "rays": "Rays",
    "contacts": "Contacts and friction cones",
    "forces": "Contact forces",
    "net": "Net wrench",
    "task": "Task screw",
    "scene": "Table and obstacles",
    "hand": "Hand",
}
"""Display name of each group of solids; the key is the first part of the solids' names."""
HIDDEN = ("rays", "frame")
"""Groups that are hidden until the user shows them."""
FULL_TRANSLATION, FULL_ROTATION = 0.1, np.pi / 4
"""Motion of the object for the task's largest components, as in the task test [m, rad]."""
_ABSENT = np.array([0.1, 0.1, 0.1, 0.05, 0.05, 0.05])
"""Absolute value of a task component that means "none" in the paper's table 1."""
_LETTERS = "xyz"


def draw_plan(scene: PlanScene, canvas: Canvas, *, selected: int | None = None) -> None:
    """Draw everything except object and hand; an earlier drawing is replaced.

    Args:
        scene: The plan.
        canvas: The canvas.
        selected: Index of a plane to highlight in addition to the chosen one.
    """
    for group in GROUPS:
        if group not in ("hand", "object"):
            canvas.remove(group)
    _frame(scene, canvas)
    draw_scenery(scene, canvas)
    for entry in scene.planes:
        draw_card(scene, canvas, entry, selected=entry.index == selected)
    _axes(scene, canvas)
    _contacts(scene, canvas)
    _net(scene, canvas)
    _task(scene, canvas)


def recorded(scene: PlanScene) -> RecordingCanvas:
    """The object and the plan, recorded."""
    canvas = RecordingCanvas()
    draw_object(scene, canvas)
    draw_plan(scene, canvas)
    return canvas


def draw_object(scene: PlanScene, canvas: Canvas) -> None:
    """Draw the object; an earlier drawing is replaced."""
    canvas.solid("object", object_shape(scene.mesh))


def draw_hand(motion: HandMotion | None, canvas: Canvas, fraction: float = 1.0) -> None:
    """Draw a hand at a fraction 0..1 of its motion and replace the earlier one; ``None`` only removes it."""
    canvas.remove("hand")
    if motion is None:
        return
    for name, shape in zip(motion.links, motion.shapes, strict=True):
        canvas.solid(f"hand/{name}", shape)
    move_hand(motion, canvas, fraction)


def move_hand(motion: HandMotion, canvas: Canvas, fraction: float) -> None:
    """Move a drawn hand to a fraction 0..1 of its motion."""
    for name, pose in zip(motion.links, motion.at(fraction), strict=True):
        canvas.place(f"hand/{name}", pose)


def draw_card(scene: PlanScene, canvas: Canvas, entry: PlaneCard, *, selected: bool) -> None:
    """Draw one approach plane as a card in front of the object, its long side along the opposition axis."""
    a, o, size = entry.approach_axis, entry.opposition_axis, scene.size
    chosen = scene.plane is not None and entry.index == scene.plane.index
    centre = scene.cog - (scene.half(a) + 0.95 * size) * a
    colour: Colour = APPROACH if chosen else OPPOSITION if selected else QUIET
    alpha = 0.7 if chosen or selected else 0.22
    u, v = 0.14 * size * a, 0.26 * size * o
    # Two planes share each approach axis; one card stands behind the other, so that both can be clicked.
    centre = centre - (0.0 if abs(o @ np.array([0.31, 0.62, 1.0])) > 0.8 else 0.34 * size) * a
    canvas.solid(f"planes/{entry.index}/card", card(centre, u, v, colour, alpha=alpha))
    canvas.solid(f"planes/{entry.index}/border", card_border(centre, u, v, 0.006 * size, colour))
    canvas.label(f"planes/{entry.index}/number", str(entry.index), centre + 1.25 * v)


def draw_scenery(scene: PlanScene, canvas: Canvas) -> None:
    """Draw the table and what the hand avoids; an earlier drawing is replaced."""
    canvas.remove("scene")
    size = scene.size
    if scene.table is not None:
        R = turned_up(scene.up)
        at = scene.mesh.bounds if np.array_equal(R, np.eye(3)) else scene.mesh.vertices @ R.T
        low, high = at.min(axis=0), at.max(axis=0)
        centre = np.array([*(low + high)[:2] / 2, scene.table]) @ R
        half = (high - low)[:2] / 2 + 0.8 * size
        sides = half[0] * R[0], half[1] * R[1]
        canvas.solid("scene/table", card(centre, *sides, TABLE, alpha=0.4))
        canvas.solid("scene/table-edge", card_border(centre, *sides, 0.006 * size, TABLE))
        canvas.label("scene/table-name", "table", centre + sides[0] - sides[1])
    for i, (low, high) in enumerate(scene.boxes, start=1):
        solid = replace(box((low + high) / 2, (high - low) / 2, None, AVOID), alpha=0.25)
        canvas.solid(f"scene/box {i}", solid)
        canvas.label(f"scene/box {i}-name", f"box {i}", (low + high) / 2)
    for i, body in enumerate(scene.obstacles, start=1):
        solid = Shape(vertices=body.vertices, triangles=body.triangles, colour=AVOID, alpha=0.35)
        canvas.solid(f"scene/obstacle {i}", solid)
        canvas.label(f"scene/obstacle {i}-name", body.name, body.vertices.mean(axis=0))


def _frame(scene: PlanScene, canvas: Canvas) -> None:
    low = scene.mesh.bounds[0] - 0.25 * scene.size
    for i in range(3):
        tip = low + 0.45 * scene.size * np.eye(3)[i]
        canvas.solid(f"frame/{_LETTERS[i]}", arrow(low, tip, 0.012 * scene.size, INK))
        canvas.label(f"frame/{_LETTERS[i]}-name", _LETTERS[i].upper(), tip)


def _axes(scene: PlanScene, canvas: Canvas) -> None:
    if scene.plane is None:
        return
    size = scene.size
    names = {"a": "approach axis", "o": "opposition", "t": "transverse"}
    colours = {"a": APPROACH, "o": OPPOSITION, "t": TRANSVERSE}
    for key, tip in axis_tips(scene).items():
        canvas.solid(f"axes/{key}", arrow(scene.cog, tip, 0.012 * size, colours[key]))
        canvas.label(f"axes/{key}-name", names[key], tip)
    start, tip = approach_arrow(scene)
    canvas.solid("axes/way", arrow(start, tip, 0.03 * size, APPROACH))
    canvas.label("axes/way-name", "way in", start)
    a, o = scene.plane.approach_axis, scene.plane.opposition_axis
    u, v = (scene.half(a) + 0.3 * size) * a, (scene.half(o) + 0.3 * size) * o
    canvas.solid("axes/plane", card(scene.cog, u, v, APPROACH, alpha=0.16))
    canvas.solid("axes/edge", card_border(scene.cog, u, v, 0.004 * size, APPROACH))
    if scene.aim is not None and scene.approach_value is not None:
        canvas.solid("axes/aim", sphere(scene.aim, 0.028 * size, APPROACH))
        canvas.label("axes/aim-name", f"v = {round(scene.approach_value, 2) + 0.0:+.2f}", scene.aim)


def _contacts(scene: PlanScene, canvas: Canvas) -> None:
    if scene.points is None or scene.normals_in is None:
        return
    size = scene.size
    for i, name in enumerate(scene.fingers):
        colour, point, normal = finger_colour(name, i), scene.points[i], scene.normals_in[i]
        key = f"{i}-{name}"
        canvas.solid(f"contacts/{key}/point", sphere(point, 0.03 * size, colour))
        canvas.label(f"contacts/{key}/name", name, point - 0.16 * size * normal)
        if scene.friction:
            height = 0.22 * size / max(1.0, scene.friction)
            shape = cone(point, -normal, height, scene.friction, colour, alpha=0.3)
            canvas.solid(f"contacts/{key}/cone", shape)
        if scene.ray_origins is not None:
            ray = tube([scene.ray_origins[i], point], 0.005 * size, INK, alpha=0.7)
            canvas.solid(f"rays/{key}", ray)
        if scene.forces is not None and np.linalg.norm(scene.forces[i]) > 1e-9:
            # The force pushes onto the object, so its arrow ends at the contact.
            start = point - FORCE_LENGTH * size * scene.forces[i]
            canvas.solid(f"forces/{key}", arrow(start, point, 0.018 * size, colour))


def _net(scene: PlanScene, canvas: Canvas) -> None:
    if scene.net_wrench is None:
        return
    size = scene.size
    force, torque = (_bounded(part) for part in (scene.net_wrench[:3], scene.net_wrench[3:]))
    if np.linalg.norm(force) > 0.02:
        tip = scene.cog + 0.9 * size * force
        canvas.solid("net/force", arrow(scene.cog, tip, 0.026 * size, WRENCH))
        canvas.label("net/force-name", "net force", tip)
    if np.linalg.norm(torque) > 0.02:
        canvas.solid("net/torque", turning(scene.cog, torque, 0.42 * size, 0.018 * size, WRENCH))


def _task(scene: PlanScene, canvas: Canvas) -> None:
    """Draw the screw of the task's motion: its axis, its rotation and its translation."""
    q, size = np.where(np.abs(scene.task) > _ABSENT + 1e-9, scene.task, 0.0), scene.size
    move, turn = q[:3], q[3:]
    if turn.any():
        w = turn / np.abs(turn).max() * FULL_ROTATION
        v = move / np.abs(move).max() * FULL_TRANSLATION if move.any() else move
        direction = w / np.linalg.norm(w)
        point = scene.cog + np.cross(w, v) / float(w @ w)
        reach = scene.half(np.abs(direction)) + 0.7 * size
        line = tube([point - reach * direction, point + reach * direction], 0.007 * size, TASK)
        canvas.solid("task/axis", line)
        canvas.solid(
            "task/turn", turning(point + 0.8 * reach * direction, w, 0.22 * size, 0.014 * size, TASK)
        )
        canvas.label("task/name", "task", point + reach * direction)
    if move.any():
        direction = move / np.linalg.norm(move)
        start = scene.cog + (scene.half(np.abs(direction)) + 0.15 * size) * direction
        tip = start + 0.55 * size * direction
        canvas.solid("task/move", arrow(start, tip, 0.02 * size, TASK))
        if not turn.any():
            canvas.label("task/name", "task", tip)


def turning(centre: Array, axis: Array, radius: float, thick: float, colour: Colour) -> Shape:
    """The arrow of a torque or of a rotation: three quarters of a circle about an axis, with an arrow head.

    Args:
        centre: (3,) Centre of the circle [m].
        axis: (3,) Axis of the right-handed rotation; any length but zero.
        radius: Radius of the circle [m].
        thick: Radius of the line [m].
        colour: Colour.
    """
    z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    x, y = (t[0] for t in tangents(z[None]))
    angles = np.linspace(0.0, 1.5 * np.pi, 19)
    around = np.cos(angles)[:, None] * x + np.sin(angles)[:, None] * y
    sides = 2 * np.pi * np.arange(8) / 8
    # A tube with eight sides, swept along the circle.
    tube_points = centre + np.concatenate(
        [
            (radius + thick * np.cos(sides))[:, None] * outward + (thick * np.sin(sides))[:, None] * z
            for outward in around[:-1]
        ]
    )
    i, j = (a.ravel() for a in np.mgrid[: len(angles) - 2, :8])
    low, high, near, far = 8 * i + j, 8 * i + (j + 1) % 8, 8 * (i + 1) + j, 8 * (i + 1) + (j + 1) % 8
    faces = np.concatenate([np.column_stack([low, near, high]), np.column_stack([high, near, far])])
    swept = Shape(vertices=tube_points, triangles=faces, colour=colour, smooth=True)
    end, along = centre + radius * around[-2], np.cross(z, around[-2])
    return join([swept, cone(end + 5 * thick * along, -along, 5 * thick, 0.5, colour, alpha=1.0)])


def _bounded(vector: Array) -> Array:
    """A vector, shortened to length 1.4 if longer; a long arrow would make everything else small."""
    length = float(np.linalg.norm(vector))
    return vector if length <= 1.4 else vector * (1.4 / length)
