"""A plan drawn in 3D, solid by solid, on any canvas: one place decides what a plan looks like."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..types import Array
from .canvas import Canvas
from .colours import APPROACH, INK, OBJECT, OPPOSITION, QUIET, TASK, TRANSVERSE, WRENCH, Colour, finger_colour
from .hand_motion import HandMotion
from .plan_scene import PlaneCard, PlanScene, approach_arrow, axis_tips
from .raycast import Shape
from .shading import tangents
from .shapes import arrow, box, card, cone, join, object_shape, sphere, tube

GROUPS = {
    "object": "Object",
    "frame": "Object frame",
    "planes": "Approach planes",
    "axes": "Approach, opposition, transverse",
    "rays": "Rays",
    "contacts": "Contacts and friction cones",
    "forces": "Contact wrenches",
    "net": "Net wrench",
    "task": "Task screw",
    "hand": "Hand",
}
"""Groups of solids, by the first part of their names, and what people call them."""
HIDDEN = ("rays", "frame")
"""Groups that are hidden at first."""
FORCE = 0.45
"""Length of the arrow of a unit force, in units of the scene's size."""
FULL_TRANSLATION, FULL_ROTATION = 0.1, np.pi / 4
_PRESENT = np.array([0.1, 0.1, 0.1, 0.05, 0.05, 0.05])
_LETTERS = "xyz"


def draw_plan(scene: PlanScene, canvas: Canvas, *, selected: int | None = None) -> None:
    """Draw everything but object and hand; what was drawn before under these names is taken away.

    Args:
        scene: the plan.
        canvas: where.
        selected: index of a plane that a person looks at, beside the chosen one.
    """
    for group in GROUPS:
        if group not in ("hand", "object"):
            canvas.remove(group)
    _frame(scene, canvas)
    for entry in scene.planes:
        draw_card(scene, canvas, entry, selected=entry.index == selected)
    _axes(scene, canvas)
    _contacts(scene, canvas)
    _net(scene, canvas)
    _task(scene, canvas)


def draw_object(scene: PlanScene, canvas: Canvas) -> None:
    """Draw the object, in place of the one that is there."""
    canvas.solid("object", object_shape(scene.mesh, OBJECT))


def draw_hand(motion: HandMotion | None, canvas: Canvas, share: float = 1.0) -> None:
    """Draw a hand in place of the one that is there; ``None`` takes it away."""
    canvas.remove("hand")
    if motion is None:
        return
    for name, shape in zip(motion.links, motion.shapes, strict=True):
        canvas.solid(f"hand/{name}", shape)
    move_hand(motion, canvas, share)


def move_hand(motion: HandMotion, canvas: Canvas, share: float) -> None:
    """Move a hand that was drawn to a share 0..1 of its motion."""
    for name, pose in zip(motion.links, motion.at(share), strict=True):
        canvas.place(f"hand/{name}", pose)


def draw_card(scene: PlanScene, canvas: Canvas, entry: PlaneCard, *, selected: bool) -> None:
    """One approach plane: a card before the object, its long side along the opposition axis."""
    a, o, size = entry.approach_axis, entry.opposition_axis, scene.size
    chosen = scene.plane is not None and entry.index == scene.plane.index
    centre = scene.cog - (scene.half(a) + 0.95 * size) * a
    colour: Colour = APPROACH if chosen else OPPOSITION if selected else QUIET
    alpha = 0.7 if chosen or selected else 0.22
    u, v = 0.14 * size * a, 0.26 * size * o
    # Two cards share each approach: one a little behind the other, so that each can be picked.
    centre = centre - (0.0 if abs(o @ np.array([0.31, 0.62, 1.0])) > 0.8 else 0.34 * size) * a
    canvas.solid(f"planes/{entry.index}/card", card(centre, u, v, colour, alpha=alpha))
    canvas.solid(f"planes/{entry.index}/border", _border(centre, u, v, 0.006 * size, colour))
    canvas.label(f"planes/{entry.index}/number", str(entry.index), centre + 1.25 * v)


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
    words = {"a": "approach", "o": "opposition", "t": "transverse"}
    colours = {"a": APPROACH, "o": OPPOSITION, "t": TRANSVERSE}
    for key, tip in axis_tips(scene).items():
        canvas.solid(f"axes/{key}", arrow(scene.cog, tip, 0.012 * size, colours[key]))
        canvas.label(f"axes/{key}-name", words[key], tip)
    canvas.solid("axes/way", arrow(*approach_arrow(scene), 0.03 * size, APPROACH))
    a, o = scene.plane.approach_axis, scene.plane.opposition_axis
    u, v = (scene.half(a) + 0.3 * size) * a, (scene.half(o) + 0.3 * size) * o
    canvas.solid("axes/plane", card(scene.cog, u, v, APPROACH, alpha=0.13))
    canvas.solid("axes/edge", _border(scene.cog, u, v, 0.004 * size, APPROACH))
    if scene.aim is not None and scene.approach_value is not None:
        canvas.solid("axes/aim", sphere(scene.aim, 0.028 * size, APPROACH))
        canvas.label("axes/aim-name", f"v = {scene.approach_value:+.2f}", scene.aim)


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
            # a force that pushes ends at its contact
            start = point - FORCE * size * scene.forces[i]
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
    """The screw of the motion that the task asks for: its axis, and which way it turns and goes."""
    q, size = np.where(np.abs(scene.task) > _PRESENT + 1e-9, scene.task, 0.0), scene.size
    move, turn = q[:3], q[3:]
    if turn.any():
        # The motion of the task test: the largest components 0.1 m and 45°.
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
        way = move / np.linalg.norm(move)
        start = scene.cog + (scene.half(np.abs(way)) + 0.15 * size) * way
        canvas.solid("task/move", arrow(start, start + 0.55 * size * way, 0.02 * size, TASK))
        if not turn.any():
            canvas.label("task/name", "task", start + 0.55 * size * way)


def turning(centre: Array, axis: Array, radius: float, thick: float, colour: Colour) -> Shape:
    """Three quarters of a circle about an axis with an arrow's head: a torque, or a turn.

    Args:
        centre: (3,) of the circle [m].
        axis: (3,) right-handed, any length but zero.
        radius: of the circle [m].
        thick: radius of the line [m].
        colour: its colour.
    """
    z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    x, y = (t[0] for t in tangents(z[None]))
    angles = np.linspace(0.0, 1.5 * np.pi, 19)
    around = np.cos(angles)[:, None] * x + np.sin(angles)[:, None] * y
    sides = 2 * np.pi * np.arange(8) / 8
    # a tube of eight sides, swept along the circle
    tube_points = centre + np.concatenate(
        [
            (radius + thick * np.cos(sides))[:, None] * way + (thick * np.sin(sides))[:, None] * z
            for way in around[:-1]
        ]
    )
    i, j = (a.ravel() for a in np.mgrid[: len(angles) - 2, :8])
    low, high, near, far = 8 * i + j, 8 * i + (j + 1) % 8, 8 * (i + 1) + j, 8 * (i + 1) + (j + 1) % 8
    faces = np.concatenate([np.column_stack([low, near, high]), np.column_stack([high, near, far])])
    swept = Shape(vertices=tube_points, triangles=faces, colour=colour, smooth=True)
    end, along = centre + radius * around[-2], np.cross(z, around[-2])
    return join([swept, cone(end + 5 * thick * along, -along, 5 * thick, 0.5, colour, alpha=1.0)])


def _border(centre: Array, u: Array, v: Array, thick: float, colour: Colour) -> Shape:
    """The border of a card as four thin rods of few triangles."""
    rods = []
    for along, across in ((u, v), (-u, v), (v, u), (-v, u)):
        half = np.abs(across) + thick * (across == 0)
        rods.append(box(centre + along, half, None, colour))
    return replace(join(rods), lit=False)


def _bounded(vector: Array) -> Array:
    """Not longer than 1.4: a long arrow would make everything else small."""
    length = float(np.linalg.norm(vector))
    return vector if length <= 1.4 else vector * (1.4 / length)
