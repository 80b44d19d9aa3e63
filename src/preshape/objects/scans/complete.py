"""A closed surface from a point cloud, with the part of it that was seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...exceptions import InputError, ObjectError, shown
from ...types import Array, IntArray, freeze, frozen_array, value
from .all_round import outward_normals, poisson
from .cleaning import check_enough, cleaned, spacing_of
from .scan import RawCloud, Scan
from .sight import HIDDEN, Sight, hidden_share, sight_of
from .surface import SEEN_SPACINGS, Grid, grid_round, seen_triangles, zero_of_values, zero_surface
from .symmetry import Symmetry, symmetries
from .table import find_table

NEAR = 8.0
"""A node that lies more than this number of spacings in free space is outside [C]."""
PER_SPACING, MARGIN = 0.7, 8
"""Edge of a cell in spacings, and cells of the margin on every side, for points from all sides [C]."""
ALL_ROUND = "all"
"""Value of a camera or view argument that stands for points from all sides."""


@value
class Completed:
    """A closed surface from points.

    Attributes:
        vertices: (v, 3) positions in the frame of the cloud [m].
        triangles: (t, 3) vertex indices, outward by the right-hand rule.
        scan: How the object was seen.
    """

    vertices: Array
    triangles: IntArray
    scan: Scan

    def __post_init__(self) -> None:
        freeze(self, vertices=frozen_array(self.vertices, (None, 3), "vertices"))


def complete(
    name: str,
    cloud: RawCloud,
    camera: Sequence[float] | Array | str | None = None,
    *,
    cut_table: bool | None = None,
    table: Array | None = None,
) -> Completed:
    """Make a closed surface from points.

    Args:
        name: Name of the file, for messages.
        cloud: Points [m], and the camera that the file names.
        camera: (3,) position of the camera in the frame of the cloud [m], or ``all`` for points from all
            sides. ``None`` takes the camera of the file. If the file has none, it takes the origin, provided
            that the origin lies outside the bounding box and few points are hidden from there; otherwise the
            points count as seen from all sides.
        cut_table: Whether a table in the cloud is cut off; ``False`` keeps it as part of the object, and
            ``None`` refuses it.
        table: (4,) plane of a table that is known, as in :class:`Scan`; no guess reaches below it.

    Raises:
        ObjectError: The points do not make one body: too few points, two objects, all points on a plane, or a
            table with the object on it.
        InputError: The camera is among the points, or cannot have seen them.
    """
    points = cloud.echoes
    check_enough(name, len(points), "points")
    if table is None and cut_table is not False:
        points, table = _without_table(name, points, cut=cut_table is True)
    place = _camera(name, points, cloud, camera)
    clean = cleaned(name, points, place)
    if place is None:
        made = _from_all_round(name, len(points), clean)
    else:
        made = _from_one_side(name, len(points), clean, place, table)
    return replace(made, scan=replace(made.scan, table=table))


def _without_table(name: str, points: Array, *, cut: bool) -> tuple[Array, Array | None]:
    """The points of what stands on a table, and its plane (4,); all points if there is no table.

    Raises:
        ObjectError: There is a table, and it is not to be cut off.
    """
    table = find_table(points)
    if table is None:
        return points, None
    if cut:
        return points[table.above], table.plane
    sides = " × ".join(f"{1000 * side:.0f}" for side in table.sides)
    raise ObjectError(
        f"{name}: {100 * table.share:.0f} % of the points lie on one plane of {sides} mm that the others "
        "stand on, probably a table; cut it off with --cut-table, or keep it as part of the object with "
        "--no-cut-table"
    )


def _camera(
    name: str, points: Array, cloud: RawCloud, asked: Sequence[float] | Array | str | None
) -> Array | None:
    """(3,) position of the camera [m]; ``None`` for all sides."""
    if isinstance(asked, str):
        if asked != ALL_ROUND:
            raise InputError(f"a view is a camera's position x,y,z or {ALL_ROUND}, got {shown(asked)}")
        return None
    low, high = points.min(axis=0), points.max(axis=0)
    given = cloud.camera if asked is None else frozen_array(asked, (3,), "the camera's position")
    place = np.zeros(3) if given is None else given
    outside = bool(((place < low) | (place > high)).any())
    share = hidden_share(points, place) if outside else 1.0
    if share <= HIDDEN:
        return place
    if given is None:
        return None
    where = ", ".join(f"{number:g}" for number in place)
    why = f"{100 * share:.0f} % of them are behind others" if outside else "it is among them"
    raise InputError(
        f"{name}: a camera at {where} m cannot have seen these points: {why}; give its position in the "
        f"frame of the cloud, or --view {ALL_ROUND} for points from all sides"
    )


def _from_one_side(name: str, count: int, points: Array, camera: Array, table: Array | None) -> Completed:
    sight = sight_of(points, camera)
    found = symmetries(sight, points)
    far = np.concatenate([points, *(one.apply(points) for one in found)])
    grid = grid_round(far)

    def inside(nodes: Array) -> Array:
        guessed = solid(sight, found, nodes)
        return guessed if table is None else np.maximum(guessed, table[3] - nodes @ table[:3])

    vertices, triangles = zero_surface(inside, grid)
    kinds = {"mirror": "a mirror plane", "turn": "an axis", "point": "a centre"}
    named = [kinds[kind] for kind in dict.fromkeys(one.kind for one in found)]
    guess = f"guessed by symmetry about {' and '.join(named)}"
    return marked(name, count, points, camera, vertices, triangles, grid, guess)


def solid(sight: Sight, found: Sequence[Symmetry], points: Array) -> Array:
    """(n,) distance from the guessed solid, negative inside [m].

    A point is inside if neither the point nor any of its symmetric images lies in space seen to be free.

    Args:
        sight: The view of the camera.
        found: Symmetries of the solid.
        points: (n, 3) points [m].
    """
    free = sight.free(points)
    for one in found:
        # Points far inside free space are outside the solid, wherever their images are.
        near = np.flatnonzero(free < NEAR * sight.spacing)
        free[near] = np.maximum(free[near], sight.free(one.apply(points[near])))
    return free


def _from_all_round(name: str, count: int, points: Array) -> Completed:
    across = float(np.ptp(points, axis=0).max()) / (PER_SPACING * spacing_of(points))
    grid = grid_round(points, cells=int(np.clip(across, 48, 128)) + 2 * MARGIN, margin=MARGIN)
    values = poisson(points, outward_normals(points), grid) * grid.spacing
    vertices, triangles = zero_of_values(values, grid)
    return marked(name, count, points, None, vertices, triangles, grid, "closed by the smoothest surface")


def marked(
    name: str,
    count: int,
    points: Array,
    camera: Array | None,
    vertices: Array,
    triangles: IntArray,
    grid: Grid,
    guess: str,
) -> Completed:
    """A surface together with the part of it that was seen.

    Args:
        name: Name of the file, for messages.
        count: Number of points in the file.
        points: (n, 3) cleaned points [m].
        camera: (3,) position of the camera [m], or ``None``.
        vertices: (v, 3) positions [m].
        triangles: (t, 3) vertex indices.
        grid: Grid that the surface was computed on.
        guess: How the rest was guessed.

    Raises:
        ObjectError: There is no triangle.
    """
    if not len(triangles):
        raise ObjectError(f"{name}: no closed surface fits these points; scan more of the object")
    reach = SEEN_SPACINGS * max(spacing_of(points), grid.spacing)
    seen = seen_triangles(vertices, triangles, points, reach)
    corners = vertices[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    share = float(np.clip(areas[seen].sum() / areas.sum(), 0.0, 1.0))
    scan = Scan(points=count, camera=camera, seen=seen, seen_share=share, guess=guess)
    return Completed(vertices=vertices, triangles=triangles, scan=scan)
