"""The built-in objects: everyday objects in the size of a small robot hand, made by a generator of our own.

Each object is one watertight surface whose triangles face outward (right-hand rule). The centre of its
bounding box is the origin, and no extent exceeds 0.172 m = 4U of the ``utah_mit`` hand (§2.1). Upright
objects have +z up. On a table, an object stands as it is modelled or lies as ``rest`` says; it tips only over
10°. An object is built when it is first needed.

>>> entry("mug").tasks[:2]
('lift', 'pour')
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from ..exceptions import ObjectError, UnknownObject, shown
from ..types import Array, IntArray, value
from .generator import dolphin, fruit, hardware, primitives, tools, vessels
from .generator.shapes import finish
from .library_parts import part_rules, parts_in_millimetres
from .mesh import TriangleMesh
from .parts import ObjectPart

if TYPE_CHECKING:
    from manifold3d import Manifold as Solid

TASK_FAMILIES = (
    "lift", "push", "pull", "pour", "turn", "screw", "unscrew", "strike",
    "insert", "twist", "lever", "hand_over", "press", "slide", "shake",
)  # fmt: skip
"""Names of the task families that library objects offer."""

AS_MODELLED = (1.0, 0.0, 0.0, 0.0)
"""Rest of an object that stands as it is modelled, a quaternion wxyz."""


@value
class LibraryObject:
    """A built-in object.

    Attributes:
        name: Name in snake_case.
        description: One line for display.
        mass: Mass of a real object of this kind and size [kg].
        tasks: Task families that suit it, the most natural one first.
        build: Function that returns the (n, 3) vertices [m], the (m, 3) outward triangles, and (3,) their
            origin in the generator's frame [m]; deterministic.
        rest: Quaternion wxyz that turns the object from the frame it is modelled in to how it lies on a table
            (:mod:`preshape.objects.resting` found it).
    """

    name: str
    description: str
    mass: float
    tasks: tuple[str, ...]
    build: Callable[[], tuple[Array, IntArray, Array]]
    rest: tuple[float, float, float, float] = AS_MODELLED


def _object(
    shape: Callable[[], Solid],
    mass: float,
    tasks: str,
    description: str,
    rest: tuple[float, float, float, float] = AS_MODELLED,
) -> LibraryObject:
    """An entry whose name is that of the function that makes its shape."""
    return LibraryObject(
        name=shape.__name__,
        description=description,
        mass=mass,
        tasks=tuple(tasks.split()),
        build=lambda: finish(shape()),
        rest=rest,
    )


_OBJECTS = (
    _object(
        primitives.cube, 0.034, "lift push turn twist hand_over", "wooden cube, the first training's object"
    ),
    _object(primitives.box, 0.10, "lift push pull slide hand_over", "carton lying on its long side"),
    _object(primitives.prism, 0.09, "lift turn insert hand_over", "hexagonal wooden prism, upright"),
    _object(primitives.pyramid, 0.06, "lift push hand_over", "square wooden pyramid"),
    _object(primitives.cylinder, 0.11, "lift turn push hand_over", "wooden cylinder, upright"),
    _object(primitives.cone, 0.06, "lift push hand_over", "wooden cone, upright"),
    _object(primitives.sphere, 0.08, "lift turn hand_over shake", "wooden ball"),
    _object(primitives.ring, 0.06, "lift turn hand_over", "torus, a toy ring, lying flat"),
    _object(primitives.wedge, 0.06, "insert push slide hand_over", "door wedge, its thin edge towards -x"),
    _object(primitives.brick, 0.03, "lift press pull hand_over", "toy building brick with two by four studs"),
    _object(
        primitives.domino, 0.03, "lift slide push hand_over", "domino stone, three over five, lying flat"
    ),
    _object(vessels.mug, 0.30, "lift pour hand_over turn", "coffee mug, its handle on +x"),
    _object(vessels.bowl, 0.14, "lift pour push hand_over", "cereal bowl on a foot ring"),
    _object(vessels.plate, 0.16, "lift slide push hand_over", "dinner plate with a broad rim, lying flat"),
    _object(vessels.wine_glass, 0.10, "lift pour hand_over", "wine glass, upright"),
    _object(
        vessels.bottle,
        0.36,
        "lift pour shake unscrew screw hand_over",
        "full water bottle with a ribbed screw cap",
    ),
    _object(
        vessels.jar, 0.33, "unscrew screw lift shake hand_over", "full jam jar, its ribbed lid screwed on"
    ),
    _object(
        vessels.teapot, 0.28, "pour lift hand_over", "round teapot with its lid on, spout on +x, handle on -x"
    ),
    _object(vessels.pan, 0.15, "lift pour shake slide hand_over", "small frying pan, its handle on +x"),
    _object(
        vessels.spray_bottle,
        0.30,
        "press lift shake hand_over",
        "spray bottle, nozzle on +x, trigger below it",
    ),
    _object(
        tools.hammer,
        0.35,
        "strike lift lever pull hand_over",
        "claw hammer, handle along z, face on +x",
        rest=(0.7141, 0.70001, -0.00692, 0.0),
    ),
    _object(
        tools.screwdriver,
        0.06,
        "screw unscrew insert turn hand_over",
        "flat-blade screwdriver along z, blade down",
        rest=(0.70711, 0.70711, 0, 0),
    ),
    _object(tools.wrench, 0.10, "turn lever pull push hand_over", "double open-ended spanner along x"),
    _object(
        tools.spoon,
        0.035,
        "lift pour turn hand_over",
        "table spoon along x, its bowl on -x",
        rest=(0.99819, 0.00922, 0.05941, 0.0),
    ),
    _object(tools.scissors, 0.07, "lift press hand_over", "household scissors, slightly open, lying flat"),
    _object(
        tools.pen,
        0.02,
        "lift insert pull slide hand_over",
        "marker pen along z, its cap at the top",
        rest=(0.72351, 0.0, 0.69031, 0.0),
    ),
    _object(tools.dumbbell, 1.00, "lift turn shake hand_over", "hexagonal dumbbell along x"),
    _object(
        tools.phone,
        0.17,
        "lift slide press hand_over",
        "mobile phone lying on its back",
        rest=(0.99997, 0.00776, 0.0, 0.0),
    ),
    _object(
        tools.flashlight,
        0.12,
        "lift twist press shake hand_over",
        "pocket torch along z, its lamp at the top",
        rest=(0.73112, 0.68225, 0.0, 0.0),
    ),
    _object(
        tools.toothbrush,
        0.02,
        "lift slide hand_over",
        "toothbrush along x, its bristles up",
        rest=(0.99845, -0.05567, 0.00069, 0.0),
    ),
    _object(
        hardware.bolt,
        0.24,
        "screw unscrew turn insert",
        "hexagon-head bolt, its head at the top",
        rest=(0.73814, 0.67464, 0.00262, 0.0),
    ),
    _object(hardware.nut, 0.10, "screw unscrew turn lift", "hexagon nut, lying flat"),
    _object(hardware.knob, 0.35, "turn twist pull push", "door knob on its rose, its axis along z"),
    _object(hardware.key, 0.012, "insert turn pull hand_over", "door key along x, lying flat"),
    _object(hardware.padlock, 0.20, "pull lift turn hand_over", "closed padlock, its shackle at the top"),
    _object(
        hardware.light_bulb,
        0.05,
        "screw unscrew lift hand_over",
        "light bulb, its screw base at the bottom",
        rest=(0.79436, 0.60672, 0.02981, 0.0),
    ),
    _object(hardware.hand_wheel, 0.30, "turn twist lift", "hand wheel of a valve, lying flat"),
    _object(fruit.apple, 0.17, "lift twist pull hand_over", "apple with its stem, upright"),
    _object(fruit.pear, 0.15, "lift twist pull hand_over", "pear with its stem, upright"),
    _object(
        fruit.banana, 0.12, "lift pull hand_over", "banana lying flat", rest=(0.98982, -0.14231, 0.00379, 0.0)
    ),
    _object(
        dolphin.dolphin,
        0.07,
        "lift push turn hand_over",
        "rubber dolphin, leaping, its nose on +x",
        rest=(0.49753, 0.86683, 0.03259, 0.0),
    ),
)

_BY_NAME = {one.name: one for one in _OBJECTS}


def names() -> tuple[str, ...]:
    """Names of the built-in objects, simple ones first."""
    return tuple(_BY_NAME)


def entry(name: str) -> LibraryObject:
    """The built-in object of that name.

    Raises:
        UnknownObject: There is none; the message lists the known names.
    """
    if name not in _BY_NAME:
        raise UnknownObject(name, _BY_NAME)
    return _BY_NAME[name]


@cache
def _arrays(name: str) -> tuple[Array, IntArray, Array]:
    return entry(name).build()


@lru_cache(maxsize=256)
def _parts(name: str, scale: float) -> tuple[ObjectPart, ...]:
    """The parts of an object in its mesh frame [m]."""
    offset = -scale * _arrays(name)[2]
    return tuple(
        replace(part, region=part.region.moved(scale / 1000.0, offset)) for part in parts_in_millimetres(name)
    )


def load_library_object(name: str, *, scale: float = 1.0) -> TriangleMesh:
    """Build one object.

    Args:
        name: One of :func:`names`.
        scale: Factor on all lengths; the mass grows with its cube.

    Returns:
        The mesh [m] with its mass [kg], rest, tasks and parts.

    Raises:
        UnknownObject: There is no object of that name.
        ObjectError: The scale is not a positive, finite number.
    """
    found = entry(name)
    if not (math.isfinite(scale) and scale > 0):
        raise ObjectError(f"scale must be a positive number, got {shown(scale)}")
    vertices, triangles, _ = _arrays(name)
    return TriangleMesh(
        name=name,
        vertices=vertices * scale,
        triangles=triangles,
        mass=found.mass * scale**3,
        scale=scale,
        rest=np.array(found.rest),
        tasks=found.tasks,
        parts=_parts(name, float(scale)),
        rules=part_rules(name),
    )
