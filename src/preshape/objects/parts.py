"""Parts of an object: named regions of its surface, and volumes beside it that are to stay free.

Parts come from the library, from the groups of a file, from the sidecar file, or from a text of the user:

>>> part_of_text("z>0.05").name
'z > 0.05'
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..exceptions import InputError, shown
from ..types import LONGEST_NAME, Array, IntArray, freeze, frozen_array, value
from .read_raw import merge_equal
from .regions import Pieces, SurfaceRegion, beyond, box

if TYPE_CHECKING:
    from .mesh import TriangleMesh

LIBRARY, FILE, SIDECAR, ASKED = ORIGINS = ("library", "file", "sidecar", "asked")
"""Where a part comes from: the built-in object, a group of the mesh file, its sidecar, or the request."""
_BEYOND = re.compile(r"\s*([xyz])\s*([<>])\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*", re.IGNORECASE)
_LISTED = 20
SPECK = 1e-5
"""Size of the piece of a surface that stands for a point of it [m]."""


@value
class PartSurface:
    """The surface of a part, or of a volume beside the object that is to stay free.

    Attributes:
        name: Name of the part in sentences, as ``handle``.
        vertices: (n, 3) positions in the mesh frame [m].
        triangles: (m, 3) vertex indices; for a solid, outward (right-hand rule).
        solid: Whether the triangles bound a closed volume, whose inside belongs to the part too.
        beside: Whether it stands beside the object, and stays there when the object is lifted.

    Raises:
        InputError: The name is empty, an array has the wrong shape, or an index is out of range.
    """

    name: str
    vertices: Array
    triangles: IntArray
    solid: bool = False
    beside: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise InputError(f"a part needs a name, got {shown(self.name)}")
        vertices = frozen_array(self.vertices, (None, 3), f"the part {self.name}: vertices")
        corners = frozen_array(self.triangles, (None, 3), f"the part {self.name}: triangles")
        triangles = corners.astype("int64")
        if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(vertices):
            raise InputError(f"the part {self.name}: an index is outside of the {len(vertices)} vertices")
        triangles.flags.writeable = False
        freeze(self, vertices=vertices, triangles=triangles, solid=bool(self.solid))

    def __len__(self) -> int:
        return len(self.triangles)


@value
class ObjectPart:
    """A named region of an object's surface.

    Attributes:
        name: Name for display and for requests.
        region: The region, in the mesh frame [m].
        origin: Where the part comes from, one of ``ORIGINS``.

    Raises:
        InputError: The name is empty, too long or not printable, or the region is none.
    """

    name: str
    region: SurfaceRegion
    origin: str = ASKED

    def __post_init__(self) -> None:
        name = self.name
        if not (isinstance(name, str) and name.strip() and name.isprintable() and len(name) <= LONGEST_NAME):
            raise InputError(
                f"a part's name is printable text of at most {LONGEST_NAME} characters, got {shown(name)}"
            )
        if not isinstance(self.region, SurfaceRegion):
            raise InputError(f"the part {name}: expected a region, got {shown(self.region)}")
        if self.origin not in ORIGINS:
            raise InputError(f"the part {name}: its origin is one of {ORIGINS}, got {shown(self.origin)}")


@value
class PartRule:
    """Which parts of an object some tasks hold, and which they leave free.

    Attributes:
        tasks: Names of task families.
        hold_on: Names of the parts that may be held, any of them; empty for the whole surface.
        keep_off: Names of the parts that stay free.
    """

    tasks: tuple[str, ...]
    hold_on: tuple[str, ...] = ()
    keep_off: tuple[str, ...] = ()


def whole_surface(mesh: TriangleMesh) -> Pieces:
    """The surface of an object that can be touched: all triangles without its lids."""
    real = np.flatnonzero(~mesh.is_lid)
    return Pieces(corners=mesh.corners[real], owners=real)


def part_pieces(mesh: TriangleMesh, region: SurfaceRegion) -> Pieces:
    """The pieces of an object's surface, without lids, that lie in a region."""
    return region.split(whole_surface(mesh))[0]


def part_surface(mesh: TriangleMesh, part: ObjectPart) -> PartSurface:
    """The surface of an object clipped by a part's region, exactly: triangles are cut at its border.

    Args:
        mesh: The object [m].
        part: The part.

    Returns:
        The surface without lids; it is empty if nothing of the object lies in the region.
    """
    return surface_of(part.name, part_pieces(mesh, part.region))


def surface_of(name: str, pieces: Pieces) -> PartSurface:
    """Pieces as the surface of a part, with corners at equal positions joined."""
    count = len(pieces.corners)
    vertices, triangles = merge_equal(pieces.corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    return PartSurface(name=name, vertices=vertices, triangles=triangles)


def parts_at(mesh: TriangleMesh, points: Array) -> list[str]:
    """The part of an object that each of some points belongs to.

    Where parts overlap, the one that is listed last counts: it is a part of the others, as a face of a head.

    Args:
        mesh: The object [m].
        points: (n, 3) points on or near its surface, in the mesh frame [m].

    Returns:
        n names of parts; empty where no part is.
    """
    names = [""] * len(points)
    if not mesh.parts or not len(points):
        return names
    owners = _nearest_triangles(mesh, points)
    shapes = mesh.corners[owners]
    # A speck of the nearest triangle, around the point, asks the region as a piece of the surface does.
    away = shapes - shapes.mean(axis=1, keepdims=True)
    specks = points[:, None] + away * (SPECK / np.linalg.norm(away, axis=2).max(axis=1)[:, None, None])
    pieces = Pieces(corners=specks, owners=owners)
    for part in mesh.parts:
        inside, outside = (_area_near(found, points) for found in part.region.split(pieces))
        for i in np.flatnonzero(inside > outside):
            names[i] = part.name
    return names


def _area_near(pieces: Pieces, points: Array) -> Array:
    """(n,) area of the pieces of each point's speck [m²]."""
    away = np.linalg.norm(pieces.corners.mean(axis=1) - points[:, None], axis=2)
    return np.asarray((away < SPECK) @ np.linalg.norm(pieces.crosses, axis=1))


def part_of_triangles(mesh: TriangleMesh) -> IntArray:
    """(m,) index of the part that has most of each triangle, -1 for none; the last of overlapping parts."""
    found = np.full(len(mesh.triangles), -1, dtype=np.int64)
    for index, part in enumerate(mesh.parts):
        pieces = part_pieces(mesh, part.region)
        areas = np.linalg.norm(pieces.crosses, axis=1) / 2
        own = np.bincount(pieces.owners, weights=areas, minlength=len(found))
        found[own > mesh.areas / 2] = index
    return found


def _nearest_triangles(mesh: TriangleMesh, points: Array) -> IntArray:
    """(n,) index of the triangle without lids that is nearest to each point."""
    from trimesh.triangles import closest_point

    real = np.flatnonzero(~mesh.is_lid)
    corners = mesh.corners[real]
    middles = corners.mean(axis=1)
    radii = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
    found = np.zeros(len(points), dtype=np.int64)
    for i, point in enumerate(points):
        away = np.linalg.norm(middles - point, axis=1)
        near = np.flatnonzero(away - radii <= (away + radii).min())
        closest = closest_point(corners[near], np.broadcast_to(point, (len(near), 3)))
        found[i] = real[near[np.linalg.norm(closest - point, axis=1).argmin()]]
    return found


def part_of_text(text: str) -> ObjectPart | None:
    """The part that a text describes by numbers; ``None`` if it is a name.

    Args:
        text: A half-space, as ``z>0.05`` or ``x < -0.02`` [m], or the six numbers of a box: its lower, then
            its upper corner [m], with blanks or commas between.

    Raises:
        InputError: A box has not six numbers, or its lower corner is not below its upper.
    """
    if found := _BEYOND.fullmatch(text):
        axis, sign, limit = found[1].lower(), found[2], float(found[3])
        return ObjectPart(name=f"{axis} {sign} {limit:g}", region=beyond(axis, sign, limit))
    try:
        numbers = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        return None
    if not numbers:
        return None
    if len(numbers) != 6:
        raise InputError(f"{_WANTED}, got {len(numbers)} number{'s' if len(numbers) > 1 else ''}")
    return ObjectPart(
        name="the box " + " ".join(f"{x:g}" for x in numbers), region=box(numbers[:3], numbers[3:])
    )


_WANTED = (
    'a part is a name from "preshape objects OBJECT", a half-space such as "z>0.05", '
    "or the six numbers of a box (lower, then upper corner) in metres"
)


def find_part(mesh: TriangleMesh, text: str) -> ObjectPart:
    """The part of an object that a text names or describes.

    Capitals, and whether words are joined by blanks, hyphens or underscores, do not matter in names.

    Args:
        mesh: The object [m].
        text: A part's name, or what :func:`part_of_text` takes.

    Raises:
        InputError: The object has no such part (the message lists its parts), or nothing of its surface lies
            in the region.
    """
    if not isinstance(text, str) or not text.strip():
        raise InputError(f"{_WANTED}, got {shown(text)}")
    named = {part.name: part for part in reversed(mesh.parts)}
    folded = {_folded(name): part for name, part in named.items()}
    part = named.get(text) or folded.get(_folded(text)) or part_of_text(text)
    if part is None:
        raise InputError(
            f"{mesh.name} has no part {shown(text)}; {listed([p.name for p in mesh.parts])}; a half-space is "
            'written as "z>0.05" (x, y or z, > or <, metres), a box as six numbers'
        )
    if not part_pieces(mesh, part.region).area > 0:
        low, high = (" ".join(f"{1000 * x:.3g}" for x in corner) for corner in mesh.bounds)
        raise InputError(
            f"nothing of the surface of {mesh.name} lies in {part.name}; the object reaches from {low} to "
            f"{high} mm (x y z), and regions are in metres; choose a region that it reaches"
        )
    return part


def listed(names: Sequence[str]) -> str:
    """The parts that exist, for messages; how to describe one if there are none."""
    if not names:
        return (
            'it has no named parts: describe one as "z>0.05" or by the six numbers of a box (metres), or '
            "name it in the file NAME.preshape.toml beside the mesh"
        )
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return f"known: {', '.join(names[:_LISTED])}{more}"


def _folded(name: str) -> str:
    return " ".join(name.casefold().replace("-", " ").replace("_", " ").split())
