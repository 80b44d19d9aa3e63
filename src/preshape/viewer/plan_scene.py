"""What a picture of a plan shows, as a value, and its triangles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..exceptions import InputError
from ..hands.kinematics import LinkShape
from ..objects.mesh import TriangleMesh
from ..types import Array, freeze, frozen_array, value
from .colours import APPROACH, FAINT, INK, OBJECT, OPPOSITION, TRANSVERSE, finger_colour
from .raycast import Camera, Shape, project
from .shapes import arrow, card, card_border, cone, hand_shape, object_shape, sphere, tube

FORCE = 0.45
"""Length of the arrow of a unit force, in units of the scene's size."""


@value
class PlaneCard:
    """An approach plane.

    Attributes:
        index: 1..12.
        approach_axis: (3,) a, a signed unit vector.
        opposition_axis: (3,) o, as the plane has it, whichever side the thumb is on.
    """

    index: int
    approach_axis: Array
    opposition_axis: Array

    def __post_init__(self) -> None:
        for name in ("approach_axis", "opposition_axis"):
            freeze(self, **{name: frozen_array(getattr(self, name), (3,), f"plane's {name}")})

    @property
    def transverse_axis(self) -> Array:
        """(3,) t = a × o."""
        return np.cross(self.approach_axis, self.opposition_axis)


@value
class PlanScene:
    """A plan, as plain arrays in the object's frame. What there is not is ``None`` or empty.

    Attributes:
        mesh: the object.
        cog: (3,) [m].
        task_name: for people.
        hand_name: for people.
        task: (6,) Q.
        mode: execution mode, 0..3.
        status: how it ended, a word or two.
        reasons: why, one sentence each.
        plane: the chosen plane.
        approach_value: v, -1..1.
        approach_set: name of the fuzzy set of v.
        aim: (3,) the point that the grasp aims at [m].
        points: (n, 3) contacts [m].
        normals_in: (n, 3) inward unit normals.
        fingers: n names.
        forces: (n, 3) contact forces per unit normal force.
        friction: coefficient; draws friction cones.
        ray_origins: (n, 3) where the virtual grasp's rays start [m].
        net_wrench: (6,) about the COG, lengths in U.
        adi: (6,) agreement of task and net wrench in each dimension.
        match: TFVADI, 0..6.
        quality: of a real hand's grip, 0..6, which is judged by it; ``None`` where TFVADI judges.
        stability: index, 0..6.
        manipulability: index, 0..6.
        hand: the hand's parts, placed.
        planes: all the planes, for the small picture.
    """

    mesh: TriangleMesh
    cog: Array
    task_name: str
    hand_name: str
    task: Array
    mode: int | None
    status: str
    reasons: tuple[str, ...] = ()
    plane: PlaneCard | None = None
    approach_value: float | None = None
    approach_set: str = ""
    aim: Array | None = None
    points: Array | None = None
    normals_in: Array | None = None
    fingers: tuple[str, ...] = ()
    forces: Array | None = None
    friction: float | None = None
    ray_origins: Array | None = None
    net_wrench: Array | None = None
    adi: Array | None = None
    match: float | None = None
    quality: float | None = None
    stability: int | None = None
    manipulability: int | None = None
    hand: tuple[LinkShape, ...] = ()
    planes: tuple[PlaneCard, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.fingers)
        shapes: dict[str, tuple[int, ...]] = {"cog": (3,), "task": (6,)}
        shapes |= dict.fromkeys(("aim",), (3,)) | dict.fromkeys(("net_wrench", "adi"), (6,))
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
        """Length that the drawing's proportions follow: half the bounding box's diagonal [m]."""
        return float(np.linalg.norm(self.mesh.extents)) / 2

    def half(self, axis: Array) -> float:
        """The object's half extent along a coordinate axis [m]."""
        return float(np.abs(axis) @ self.mesh.extents) / 2


def axis_tips(scene: PlanScene) -> dict[str, Array]:
    """Where the axes a, o and t end: outside the object, and o and t on the side that is seen [m]."""
    if scene.plane is None:
        return {}
    p = scene.plane
    axes = {"a": p.approach_axis, "o": p.opposition_axis, "t": p.transverse_axis}
    return {k: scene.cog + (scene.half(axis) + 0.55 * scene.size) * axis for k, axis in axes.items()}


def approach_arrow(scene: PlanScene) -> tuple[Array, Array]:
    """Start and tip of the arrow along the approach, before the object [m]; needs a plane."""
    assert scene.plane is not None
    a = scene.plane.approach_axis
    tip = scene.cog - (scene.half(a) + 0.12 * scene.size) * a
    return tip - 0.85 * scene.size * a, tip


def strokes(scene: PlanScene) -> list[tuple[Array, Array]]:
    """Start and end of every arrow that labels should not cover [m]."""
    result = [(scene.cog, tip) for tip in axis_tips(scene).values()]
    if scene.plane is not None:
        result.append(approach_arrow(scene))
    if scene.points is not None and scene.forces is not None:
        result += [(p - FORCE * scene.size * f, p) for p, f in zip(scene.points, scene.forces, strict=True)]
    return result


def plan_shapes(scene: PlanScene) -> list[Shape]:
    """The large picture's triangles."""
    return [object_shape(scene.mesh, OBJECT), *_plane_shapes(scene), *_contact_shapes(scene), *_hand(scene)]


def _hand(scene: PlanScene) -> Iterator[Shape]:
    if scene.hand:
        yield hand_shape(scene.hand, alpha=0.55)


def _plane_shapes(scene: PlanScene) -> Iterator[Shape]:
    if scene.plane is None:
        return
    a, o, size = scene.plane.approach_axis, scene.plane.opposition_axis, scene.size
    for tip, colour in zip(axis_tips(scene).values(), (APPROACH, OPPOSITION, TRANSVERSE), strict=True):
        yield arrow(scene.cog, tip, 0.012 * size, colour)
    yield arrow(*approach_arrow(scene), 0.032 * size, APPROACH)
    u, v = (scene.half(a) + 0.3 * size) * a, (scene.half(o) + 0.3 * size) * o
    yield card(scene.cog, u, v, APPROACH, alpha=0.16)
    yield card_border(scene.cog, u, v, 0.004 * size, APPROACH)


def _contact_shapes(scene: PlanScene) -> Iterator[Shape]:
    if scene.points is None or scene.normals_in is None:
        return
    size = scene.size
    for i, name in enumerate(scene.fingers):
        colour, point, normal = finger_colour(name, i), scene.points[i], scene.normals_in[i]
        yield sphere(point, 0.035 * size, colour)
        if scene.ray_origins is not None:
            yield tube([scene.ray_origins[i], point], 0.007 * size, INK, alpha=0.7)
        if scene.forces is not None:  # a force that pushes ends at its contact
            yield arrow(point - FORCE * size * scene.forces[i], point, 0.02 * size, colour)
        if scene.friction is not None:
            yield cone(point, -normal, 0.22 * size, scene.friction, colour, alpha=0.22)


def plan_camera(scene: PlanScene, shapes: list[Shape], aspect: float) -> Camera:
    """A view across the approach plane, from a little above, that has everything in it."""
    direction = np.array([0.62, -0.72, 0.42])
    if scene.plane is not None:
        a, o, t = scene.plane.approach_axis, scene.plane.opposition_axis, scene.plane.transverse_axis
        t = t if t @ [0.3, -0.5, 1.0] > 0 else -t
        direction = 0.80 * t + 0.30 * a + 0.42 * o
    flat = np.hypot(direction[0], direction[1])
    rise = np.clip(direction[2], np.tan(np.radians(16)) * flat, np.tan(np.radians(42)) * flat)
    direction = np.array([direction[0], direction[1], rise])
    points = np.concatenate([s.vertices for s in shapes])
    return Camera.framing(points, direction, aspect=aspect, margin=1.12)


def plane_cards(scene: PlanScene, size: tuple[int, int]) -> tuple[list[Shape], Camera, dict[int, Array]]:
    """The small picture: a card for each plane around the object, the chosen one in colour.

    Args:
        scene: the plan.
        size: width and height of the picture [pixels].

    Returns:
        Shapes, camera, and where each plane's number belongs [pixels from the left and from the top].
    """
    low, high = scene.mesh.bounds
    inside = np.stack(np.meshgrid(*np.linspace(low, high, 6).T), axis=-1).reshape(-1, 3)
    shapes, corners, spread = [object_shape(scene.mesh, OBJECT)], {}, [inside]
    for entry in scene.planes:
        a, o = entry.approach_axis, entry.opposition_axis
        chosen = scene.plane is not None and entry.index == scene.plane.index
        centre = scene.cog - (scene.half(a) + 0.75 * scene.size) * a
        u, v = 0.42 * scene.size * a, 0.42 * scene.size * o
        colour, alpha, edge = (APPROACH, 0.75, 0.022) if chosen else (FAINT, 0.35, 0.012)
        shapes.append(card(centre, u, v, colour, alpha=alpha))
        shapes.append(card_border(centre, u, v, edge * scene.size, colour))
        steps = np.linspace(-1, 1, 7)
        spread.append(np.array([centre + x * u + y * v for x in steps for y in steps]))
        corners[entry.index] = np.array([centre + x * u + y * v for x in (-1.4, 1.4) for y in (-1.4, 1.4)])
    everything = np.concatenate([*(s.vertices for s in shapes), *corners.values()])
    camera = Camera.framing(everything, np.array([0.55, -0.75, 0.45]), aspect=size[0] / size[1])
    taken = project(camera, np.concatenate(spread), size)
    places: dict[int, Array] = {}
    for index, choices in corners.items():  # the corner with most room about it
        spots = project(camera, choices, size)
        room = np.linalg.norm(spots[:, None] - taken[None], axis=2).min(axis=1)
        places[index] = spots[np.argmax(room)]
        taken = np.concatenate([taken, places[index][None]])
    return shapes, camera, places
