"""Which parts of an object a task holds and which it leaves free, for library objects and for any mesh.

A rule has one of three origins. **asked**: parts that the request names. **object**: the rules of a library
object, whose parts are known (hold a hammer's handle to strike). **task**: what the task's family says of any
mesh (:data:`FAMILY_RULES`). What is asked comes on top of the rest, except that a part to hold that is asked
replaces the object's; an object's part to keep off replaces the family's leading end or vessel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from ..closure.rules import ContactRules
from ..exceptions import InputError
from ..objects.mesh import TriangleMesh
from ..objects.parts import ASKED, PartSurface, find_part, part_pieces, part_surface
from ..objects.regions import Facing, HalfSpace, SurfaceRegion
from ..tasks import Task
from ..tasks.families import FAMILIES, directions
from ..types import Array, value
from .vessel import vessel

HOLD_ON, KEEP_OFF = "hold_on", "keep_off"
OBJECT, TASK = "object", "task"
MODES = FOLLOW, NONE = "task", "none"
"""Values of a request's ``rules``: those of object and task, or only what the request asks."""
LEADING = 0.15
"""Share of the extent at the leading end that stays free (JOB §1)."""
FACES = 0.5
"""Least cosine between a normal and the direction that a leading surface faces."""
AHEAD = 0.15
"""Length of the free space in front of a leading end [m] [C]."""
BELOW, BESIDE = 0.10, 0.15
"""Depth of the free space below a supporting plane, and how far it reaches beyond the object [m] [C]."""
SAME_PLANE = 0.001, 0.9998
"""A table this near [m], with this cosine or more to it, is the supporting plane."""

_NO_RULE = "none"
FAMILY_RULES: dict[str, str] = {
    **dict.fromkeys(FAMILIES, _NO_RULE),
    "pour": "nothing inside the vessel or over its opening, and nothing on its rim",
    "strike": "nothing on or in front of the striking side: what faces the strike in the last 15 % of the "
    "extent along it; of an object that is longest along the swinging end, only in the half that swings",
    "insert": "nothing on or in front of the leading 15 % of the extent along the motion",
    "press": "nothing beyond the plane that the object is pressed against",
    "slide": "nothing below the plane that the object slides on",
    "roll": "nothing below the plane that the object rolls on",
}
"""What each family's rules say of any mesh, in words."""


@value
class AppliedRule:
    """One rule of a plan.

    Attributes:
        kind: ``hold_on`` or ``keep_off``.
        part: Name of the part, or of the space.
        origin: ``asked``, ``object`` or ``task``.
        table: Whether the table ensures it already, so that the search has nothing to do.
    """

    kind: str
    part: str
    origin: str
    table: bool = False

    @property
    def words(self) -> str:
        """The rule in words, as ``hold on handle``."""
        return f"{self.kind.replace('_', ' ')} {self.part}"


@value
class TaskRules:
    """The rules of one request for one object.

    Attributes:
        contact: What the search obeys.
        applied: Each rule, and where it comes from.
    """

    contact: ContactRules
    applied: tuple[AppliedRule, ...] = ()

    @property
    def key(self) -> tuple[object, ...]:
        """What the surfaces are, for comparing the rules of two requests for one and the same mesh.

        Surfaces are kept as long as their mesh exists, so that equal rules have the same ones.
        """
        return (*map(id, self.contact.hold_on), 0, *map(id, self.contact.keep_off))


Surfaces = list[PartSurface]
_FOUND: WeakKeyDictionary[TriangleMesh, dict[object, Surfaces]] = WeakKeyDictionary()


def task_rules(
    mesh: TriangleMesh,
    task: Task,
    *,
    hold_on: Sequence[str] = (),
    keep_off: Sequence[str] = (),
    follow: bool = True,
    turn: ArrayLike | None = None,
    table: Array | None = None,
) -> TaskRules:
    """The rules for an object and a task.

    Args:
        mesh: The object [m].
        task: The task, along its own axes.
        hold_on: Parts to hold, any of them; see :func:`~preshape.objects.parts.find_part`.
        keep_off: Parts to keep off.
        follow: Whether the rules of object and task hold too.
        turn: (3, 3) rotation from the axes of the task to the mesh frame; ``None`` if they are the same.
        table: (4,) the table as unit normal n and offset d, solid where n · x < d, in the mesh frame [m].

    Raises:
        InputError: The object has no such part, or a part to hold is also to be kept off.
    """
    on: Surfaces = [_named(mesh, text) for text in hold_on]
    off: Surfaces = [_named(mesh, text) for text in keep_off]
    both = {part.name for part in on} & {part.name for part in off}
    if both:
        raise InputError(f"{min(both)} cannot be held and kept off at once; leave one of the two out")
    applied = [AppliedRule(kind=HOLD_ON, part=part.name, origin=ASKED) for part in on]
    applied += [AppliedRule(kind=KEEP_OFF, part=part.name, origin=ASKED) for part in off]
    if not follow:
        return TaskRules(contact=ContactRules(hold_on=tuple(on), keep_off=tuple(off)), applied=tuple(applied))
    own = [rule for rule in mesh.rules if task.name in rule.tasks]
    held = [_named(mesh, name) for rule in own for name in rule.hold_on] if not on else []
    free = [_named(mesh, name) for rule in own for name in rule.keep_off]
    free = [part for part in free if part.name not in {other.name for other in (*on, *off)}]
    applied += [AppliedRule(kind=HOLD_ON, part=part.name, origin=OBJECT) for part in held]
    applied += [AppliedRule(kind=KEEP_OFF, part=part.name, origin=OBJECT) for part in free]
    on, off = on + held, off + free
    rotation = np.eye(3) if turn is None else np.asarray(turn, dtype=np.float64)
    family = FAMILIES.get(task.name)
    if family is not None:
        a, s = (rotation @ direction for direction in directions(task.axis or family.axis)[:2])
        # An object's own part to keep off replaces what is guessed of any mesh, but not the support.
        if task.name in _GUESSED and not free:
            for part in _kept(mesh, task.name, a, s):
                off.append(part)
                applied.append(AppliedRule(kind=KEEP_OFF, part=part.name, origin=TASK))
        if task.name in _SUPPORTED:
            down = a if task.name == "press" else -s
            there = _is_table(mesh, down, table)
            applied.append(AppliedRule(kind=KEEP_OFF, part=SUPPORT, origin=TASK, table=there))
            off += [] if there else [_below(mesh, down)]
    return TaskRules(contact=ContactRules(hold_on=tuple(on), keep_off=tuple(off)), applied=tuple(applied))


def _named(mesh: TriangleMesh, text: str) -> PartSurface:
    """The surface of a part that a text names; it is kept as long as the mesh exists."""
    kept = _FOUND.setdefault(mesh, {})
    if text not in kept:
        kept[text] = [part_surface(mesh, find_part(mesh, text))]
    return kept[text][0]


def _kept(mesh: TriangleMesh, family: str, a: Array, s: Array) -> Surfaces:
    """What a family keeps free of any mesh; it is kept as long as the mesh exists."""
    kept = _FOUND.setdefault(mesh, {})
    key = family, a.tobytes(), s.tobytes()
    if key not in kept:
        kept[key] = _GUESSED[family](mesh, a, s)
    return kept[key]


def _pour(mesh: TriangleMesh, a: Array, s: Array) -> Surfaces:
    """Inside, opening and rim of a vessel."""
    found = vessel(mesh, s)
    if found is None:
        return []
    return [found.inside] if found.rim is None else [found.inside, found.rim]


def _strike(mesh: TriangleMesh, a: Array, s: Array) -> Surfaces:
    """The side that strikes along a, and the space in front of it.

    An object that is longest along s swings about its other end, as a hammer or a bat: only the half towards
    +s strikes, and the rest is there to be held.
    """
    # A file that is inside out faces the other way.
    region: SurfaceRegion = Facing(direction=a if mesh.volume >= 0 else -a, least=FACES)
    across = np.cross(a, s)
    lengths = [float(np.ptp(mesh.vertices @ axis)) for axis in (s, a, across)]
    if lengths[0] > max(lengths[1:]):
        reach = mesh.vertices @ s
        region = region & HalfSpace(normal=s, offset=float(reach.min() + reach.max()) / 2)
    return _leading(mesh, region, a, "the striking side and the space in front of it")


def _insert(mesh: TriangleMesh, a: Array, s: Array) -> Surfaces:
    """What goes into the hole first, all round, and the space in front of it."""
    limit = _limit(mesh.vertices @ a)
    return _swept(mesh, HalfSpace(normal=a, offset=limit), a, "the leading end and the space in front of it")


def _leading(mesh: TriangleMesh, region: SurfaceRegion, a: Array, name: str) -> Surfaces:
    """The last 15 % along a of what lies in a region, and the space in front of it."""
    pieces = part_pieces(mesh, region)
    if not len(pieces.corners):
        return []
    limit = _limit(mesh.vertices @ a)
    return _swept(mesh, region & HalfSpace(normal=a, offset=limit), a, name)


def _limit(along: Array) -> float:
    """Where the leading 15 % of an extent begin [m]."""
    return float(along.max() - LEADING * np.ptp(along))


def _swept(mesh: TriangleMesh, region: SurfaceRegion, a: Array, name: str) -> Surfaces:
    """The hull of what lies in a region together with the space that it sweeps along a."""
    from scipy.spatial import ConvexHull, QhullError

    points = part_pieces(mesh, region).corners.reshape(-1, 3)
    if not len(points):
        return []
    try:
        hull = ConvexHull(np.concatenate([points, points + AHEAD * a]))
    except QhullError:  # an edge or a point leads, which sweeps no volume
        return []
    corners, outward = hull.points[hull.simplices], hull.equations[:, :3]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    backward = np.einsum("ij,ij->i", crosses, outward) < 0
    triangles = np.where(backward[:, None], hull.simplices[:, ::-1], hull.simplices)
    return [PartSurface(name=name, vertices=hull.points, triangles=triangles, solid=True)]


SUPPORT = "the space below the supporting plane"


def _below(mesh: TriangleMesh, down: Array) -> PartSurface:
    """The space below the object's lowest point along ``down``, as a flat box."""
    kept = _FOUND.setdefault(mesh, {})
    key = SUPPORT, down.tobytes()
    if key not in kept:
        from ..objects.mesh import box_mesh

        u = np.eye(3)[np.abs(down).argmin()]
        u = np.cross(down, u) / np.linalg.norm(np.cross(down, u))
        frame = np.column_stack([u, np.cross(down, u), down])
        along = mesh.vertices @ frame
        size = np.ptp(along, axis=0) + 2 * BESIDE
        size[2] = BELOW
        middle = (along.min(axis=0) + along.max(axis=0)) / 2
        middle[2] = along[:, 2].max() + BELOW / 2
        made = box_mesh(SUPPORT, size)
        vertices = (made.vertices + middle) @ frame.T
        kept[key] = [PartSurface(name=SUPPORT, vertices=vertices, triangles=made.triangles, solid=True)]
    return kept[key][0]


def _is_table(mesh: TriangleMesh, down: Array, table: Array | None) -> bool:
    """Whether a table is the plane that supports the object along ``down``, or lies above it."""
    if table is None or -down @ table[:3] < SAME_PLANE[1]:
        return False
    lowest = -float((mesh.vertices @ down).max())
    return lowest - float(table[3]) <= SAME_PLANE[0]


_GUESSED: dict[str, Callable[[TriangleMesh, Array, Array], Surfaces]] = {
    "pour": _pour,
    "strike": _strike,
    "insert": _insert,
}
_SUPPORTED = ("press", "slide", "roll")
