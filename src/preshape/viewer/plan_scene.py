"""The content of a plan's picture as plain arrays, with the proportions and cameras for drawing it."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from ..exceptions import InputError
from ..hands.kinematics import LinkShape
from ..objects.mesh import TriangleMesh
from ..objects.parts import PartSurface
from ..objects.resting import turned_up
from ..types import Array, freeze, frozen_array, value
from .colours import APPROACH, FAINT
from .raycast import Camera, Shape, project
from .shapes import card, card_border, object_shape

FORCE_LENGTH = 0.45
"""Length of the arrow of a unit force, in units of the scene's size."""


@value
class PlaneCard:
    """An approach plane.

    Attributes:
        index: Number of the plane, 1..12.
        approach_axis: (3,) Approach axis a, a signed unit vector.
        opposition_axis: (3,) Opposition axis o of the plane; it does not depend on the side of the thumb.
    """

    index: int
    approach_axis: Array
    opposition_axis: Array

    def __post_init__(self) -> None:
        for name in ("approach_axis", "opposition_axis"):
            freeze(self, **{name: frozen_array(getattr(self, name), (3,), f"plane's {name}")})

    @property
    def transverse_axis(self) -> Array:
        """(3,) Transverse axis t = a × o."""
        return np.cross(self.approach_axis, self.opposition_axis)


@value
class PlanScene:
    """One answer of a plan as plain arrays in the object's frame; unknown values are ``None`` or empty.

    Attributes:
        mesh: The object [m].
        cog: (3,) Centre of gravity [m].
        task_name: Name of the task to display.
        hand_name: Name of the hand to display.
        task: (6,) Task Q.
        status: Result and execution mode of the plan in a few words.
        reasons: Reasons, one sentence each.
        plane: The answer's approach plane.
        way_in: (3,) Unit vector along which the hand moves to the object; ``None`` stands for the plane's
            approach axis.
        approach_value: Approach value v, -1..1.
        approach_set: Name of the fuzzy set of v.
        aim: (3,) Point that the grasp aims at [m].
        points: (n, 3) Contact points [m].
        normals_in: (n, 3) Inward unit normals.
        fingers: (n) Name of the finger at each contact.
        forces: (n, 3) Contact forces as drawn: per unit normal force for a virtual grasp, relative to the
            strongest one for a grip.
        newtons: (n,) Magnitude of each contact force of a grip [N]; ``None`` for a virtual grasp.
        friction: Friction coefficient of the cones that are drawn.
        ray_origins: (n, 3) Origins of the virtual grasp's rays [m].
        net_wrench: (6,) Net wrench about the centre of gravity, lengths in 4U.
        adi: (6,) Agreement of task and net wrench in each dimension (ADI).
        figures: Names, with their units, and values of the numbers that decided the answer.
        facts: Names and values of the facts that decided the answer.
        table: Height of the table along ``up`` [m]; ``None`` in free space.
        up: (3,) Unit vector that is up in the picture.
        boxes: (k, 2, 3) Lower and upper corners of the boxes that the hand must avoid [m].
        obstacles: Surfaces of the other things that it must avoid.
        hand: Links of the hand at their poses.
        planes: All approach planes, for the overview.

    Raises:
        InputError: An array has the wrong shape, or there are fingers without contacts.
    """

    mesh: TriangleMesh
    cog: Array
    task_name: str
    hand_name: str
    task: Array
    status: str
    reasons: tuple[str, ...] = ()
    plane: PlaneCard | None = None
    way_in: Array | None = None
    approach_value: float | None = None
    approach_set: str = ""
    aim: Array | None = None
    points: Array | None = None
    normals_in: Array | None = None
    fingers: tuple[str, ...] = ()
    forces: Array | None = None
    newtons: Array | None = None
    friction: float | None = None
    ray_origins: Array | None = None
    net_wrench: Array | None = None
    adi: Array | None = None
    figures: tuple[tuple[str, str], ...] = ()
    facts: tuple[tuple[str, str], ...] = ()
    table: float | None = None
    up: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    boxes: Array = field(default_factory=lambda: np.zeros((0, 2, 3)))
    obstacles: tuple[PartSurface, ...] = ()
    hand: tuple[LinkShape, ...] = ()
    planes: tuple[PlaneCard, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.fingers)
        shapes: dict[str, tuple[int | None, ...]] = {
            "cog": (3,),
            "task": (6,),
            "boxes": (None, 2, 3),
            "up": (3,),
        }
        shapes |= dict.fromkeys(("aim", "way_in"), (3,)) | dict.fromkeys(("net_wrench", "adi"), (6,))
        shapes |= {"newtons": (n,)}
        shapes |= dict.fromkeys(("points", "normals_in", "forces", "ray_origins"), (n, 3))
        for name, shape in shapes.items():
            given = getattr(self, name)
            if given is not None:
                freeze(self, **{name: frozen_array(given, shape, name.replace("_", " "))})
        if n and (self.points is None or self.normals_in is None):
            raise InputError(f"a scene with {n} fingers needs their contacts and inward normals")
        freeze(self, reasons=tuple(self.reasons), hand=tuple(self.hand), planes=tuple(self.planes))

    @property
    def size(self) -> float:
        """Half the diagonal of the object's bounding box, the unit of all proportions [m]."""
        return float(np.linalg.norm(self.mesh.extents)) / 2

    def half(self, axis: Array) -> float:
        """Half the extent of the object along a coordinate axis (3,) [m]."""
        return float(np.abs(axis) @ self.mesh.extents) / 2


def axis_tips(scene: PlanScene) -> dict[str, Array]:
    """Ends of the axes a, o and t outside the object, each (3,) [m]; empty without a plane."""
    if scene.plane is None:
        return {}
    p = scene.plane
    axes = {"a": p.approach_axis, "o": p.opposition_axis, "t": p.transverse_axis}
    return {k: scene.cog + (scene.half(axis) + 0.55 * scene.size) * axis for k, axis in axes.items()}


def approach_arrow(scene: PlanScene) -> tuple[Array, Array]:
    """Start and tip (3,) of the arrow along the way in, in front of the object [m]; needs a plane."""
    assert scene.plane is not None
    a = scene.plane.approach_axis if scene.way_in is None else scene.way_in
    tip = scene.cog - (scene.half(a) + 0.12 * scene.size) * a
    return tip - 0.85 * scene.size * a, tip


def arrow_segments(scene: PlanScene) -> list[tuple[Array, Array]]:
    """Start and end (3,) of every arrow that labels should not cover [m]."""
    result = [(scene.cog, tip) for tip in axis_tips(scene).values()]
    if scene.plane is not None:
        result.append(approach_arrow(scene))
    if scene.points is not None and scene.forces is not None:
        length = FORCE_LENGTH * scene.size
        result += [(p - length * f, p) for p, f in zip(scene.points, scene.forces, strict=True)]
    return result


def view_direction(scene: PlanScene) -> Array:
    """(3,) Direction from the object to the eye, across the approach plane, 16° to 42° above horizontal."""
    R = turned_up(scene.up)
    direction = np.array([0.62, -0.72, 0.42])
    if scene.plane is not None:
        plane = scene.plane
        a, o, t = (R @ axis for axis in (plane.approach_axis, plane.opposition_axis, plane.transverse_axis))
        t = t if t @ [0.3, -0.5, 1.0] > 0 else -t
        direction = 0.80 * t + 0.30 * a + 0.42 * o
    horizontal = np.hypot(direction[0], direction[1])
    low, high = np.tan(np.radians([16.0, 42.0])) * horizontal
    return np.array([direction[0], direction[1], np.clip(direction[2], low, high)]) @ R


def plane_cards(scene: PlanScene, size: tuple[int, int]) -> tuple[list[Shape], Camera, dict[int, Array]]:
    """The overview of all approach planes: a card for each around the object, the chosen one in colour.

    Args:
        scene: The plan.
        size: Width and height of the picture [pixels].

    Returns:
        Shapes, camera, and the place of each plane's number [pixels from the left and from the top].
    """
    low, high = scene.mesh.bounds
    inside = np.stack(np.meshgrid(*np.linspace(low, high, 6).T), axis=-1).reshape(-1, 3)
    shapes, corners, covered = [object_shape(scene.mesh)], {}, [inside]
    for entry in scene.planes:
        a, o = entry.approach_axis, entry.opposition_axis
        chosen = scene.plane is not None and entry.index == scene.plane.index
        centre = scene.cog - (scene.half(a) + 0.75 * scene.size) * a
        u, v = 0.42 * scene.size * a, 0.42 * scene.size * o
        colour, alpha, edge = (APPROACH, 0.75, 0.022) if chosen else (FAINT, 0.35, 0.012)
        shapes.append(card(centre, u, v, colour, alpha=alpha))
        shapes.append(card_border(centre, u, v, edge * scene.size, colour))
        steps = np.linspace(-1, 1, 7)
        covered.append(np.array([centre + x * u + y * v for x in steps for y in steps]))
        corners[entry.index] = np.array([centre + x * u + y * v for x in (-1.4, 1.4) for y in (-1.4, 1.4)])
    everything = np.concatenate([*(s.vertices for s in shapes), *corners.values()])
    camera = Camera.framing(everything, np.array([0.55, -0.75, 0.45]), aspect=size[0] / size[1])
    taken = project(camera, np.concatenate(covered), size)
    places: dict[int, Array] = {}
    for index, candidates in corners.items():  # put the number at the corner with most free space around it
        pixels = project(camera, candidates, size)
        space = np.linalg.norm(pixels[:, None] - taken[None], axis=2).min(axis=1)
        places[index] = pixels[np.argmax(space)]
        taken = np.concatenate([taken, places[index][None]])
    return shapes, camera, places
