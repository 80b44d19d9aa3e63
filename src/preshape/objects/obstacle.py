"""An obstacle from a file, a mesh or a point cloud, placed in the frame of an object.

An obstacle is what is around the object: it may have any number of bodies, and holes. A closed surface is
solid; the inside of an open one is free. Points become cubes that they fill. What is farther than ``REACH``
from the object is left out: no hand comes there.
"""

from __future__ import annotations

import os
import re

import numpy as np

from .. import spatial
from ..exceptions import InputError, ObjectError, shown
from ..types import Array, BoolArray, IntArray, frozen_array, value
from .load import read_content, split_part
from .mesh import TriangleMesh
from .parts import PartSurface
from .scans.scan import RawCloud
from .winding import oriented_triangles

REACH = 0.5
"""Distance from the object's bounding box beyond which nothing is an obstacle [m] [C]."""
LEAST_CUBE, MOST_CUBE = 0.003, 0.02
"""Least and greatest edge of the cubes that points fill [m] [C]."""
SPACINGS = 2.0
"""Edge of these cubes, in distances between neighbouring points [C]; there are no gaps in a surface."""
REST = "the rest of the scene"
"""Name of the obstacle that consists of a scene's other points."""
_SAMPLED = 2000
_WANTED = "FILE or FILE@x,y,z,qw,qx,qy,qz (position in metres and unit quaternion, in the mesh frame)"
_SIDES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


@value
class PlacedFile:
    """The file of an obstacle, and its pose in the frame of the object.

    Attributes:
        file: Path of the file.
        T_object_file: (4, 4) pose of its frame [m].
    """

    file: str
    T_object_file: Array


def placed_file(text: object) -> PlacedFile:
    """The file and pose of a text ``FILE`` or ``FILE@x,y,z,qw,qx,qy,qz``.

    Raises:
        InputError: It is no such text.

    >>> placed_file("wall.obj@0.1,0,0,1,0,0,0").T_object_file[:3, 3].tolist()
    [0.1, 0.0, 0.0]
    """
    if not isinstance(text, str) or not text.strip():
        raise InputError(f"an obstacle is {_WANTED}, got {shown(text)}")
    file, at, numbers = text.rpartition("@")
    if not at or os.path.exists(text) or not re.search(r"[,\d]", numbers) or "/" in numbers:
        return PlacedFile(file=text, T_object_file=np.eye(4))
    try:
        seven = frozen_array([float(x) for x in numbers.split(",")], (7,), "the pose of an obstacle")
    except (ValueError, InputError) as error:
        raise InputError(f"an obstacle is {_WANTED}, got {shown(text)}") from error
    length = float(np.linalg.norm(seven[3:]))
    if not abs(length - 1.0) < 0.01 or not file:
        raise InputError(
            f"an obstacle is {_WANTED}, got {shown(text)}"
            + (f", whose quaternion has the length {length:.3g}" if file else "")
        )
    unit = np.concatenate([seven[:3], seven[3:] / length])
    return PlacedFile(file=file, T_object_file=spatial.pose_from_seven(unit))


def obstacle_surface(placed: PlacedFile, near: Array) -> PartSurface | None:
    """The surface of an obstacle in the frame of the object; ``None`` if all of it is out of reach.

    Args:
        placed: File and pose.
        near: (2, 3) lower and upper corner of the object's bounding box [m].

    Raises:
        ObjectError: The file is missing, no mesh or cloud, or encloses and shows nothing.
        EnvironmentFailure: The file cannot be read.
    """
    raw = read_content(placed.file)
    name = f"the obstacle {os.path.basename(split_part(placed.file)[0])}"
    low, high = near[0] - REACH, near[1] + REACH
    if isinstance(raw, RawCloud):
        echoes = raw.in_metres(1.0).echoes
        return surface_of_points(name, spatial.transform_points(placed.T_object_file, echoes), near)
    vertices, triangles = _merged(raw.vertices, raw.triangles)
    vertices = spatial.transform_points(placed.T_object_file, vertices)
    corners = vertices[triangles]
    close = ((corners.max(axis=1) > low) & (corners.min(axis=1) < high)).all(axis=1)
    if not close.any():
        return None
    if not np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).any():
        raise ObjectError(
            f"{placed.file}: an obstacle needs a surface, and all its triangles are points or lines"
        )
    closed = _is_closed(triangles)
    if closed:  # every body of it faces outward
        body = TriangleMesh(name="obstacle", vertices=vertices, triangles=triangles)
        triangles = oriented_triangles(body)
    used, inverse = np.unique(triangles if closed else triangles[close], return_inverse=True)
    return PartSurface(
        name=name, vertices=vertices[used], triangles=inverse.reshape(-1, 3), solid=closed, beside=True
    )


def surface_of_points(name: str, points: Array, near: Array) -> PartSurface | None:
    """The surface around cubes that points (n, 3) [m] fill; ``None`` if all are out of reach.

    Args:
        name: Name of the obstacle in sentences.
        points: The points [m].
        near: (2, 3) lower and upper corner of the object's bounding box [m].
    """
    points = points[((points > near[0] - REACH) & (points < near[1] + REACH)).all(axis=1)]
    if not len(points):
        return None
    vertices, triangles = cubes(points, cube_edge(points))
    return PartSurface(name=name, vertices=vertices, triangles=triangles, solid=True, beside=True)


def rest_of_scene(mesh: TriangleMesh, near: Array | None = None) -> PartSurface | None:
    """What else a depth camera saw around an object; ``None`` if there is nothing.

    Args:
        mesh: The object.
        near: (2, 3) as in :func:`surface_of_points`; by default the object's bounding box [m].
    """
    rest = None if mesh.scan is None else mesh.scan.rest
    return None if rest is None else surface_of_points(REST, rest, mesh.bounds if near is None else near)


def cube_edge(points: Array) -> float:
    """Edge of the cubes that points (n, 3) fill [m], from the distances between neighbours."""
    from scipy.spatial import KDTree

    if len(points) < 2:
        return LEAST_CUBE
    some = points[:: max(1, len(points) // _SAMPLED)]
    distance = np.asarray(KDTree(points).query(some, k=2)[0])
    return float(np.clip(SPACINGS * np.median(distance[:, 1]), LEAST_CUBE, MOST_CUBE))


def cubes(points: Array, edge: float) -> tuple[Array, IntArray]:
    """Vertices (n, 3) [m] and outward triangles (m, 3) around all cubes of a grid that hold points."""
    cells = np.unique(np.floor(points / edge).astype(np.int64), axis=0)
    filled = {tuple(cell) for cell in cells.tolist()}
    quads = []
    for side in _SIDES:
        free = np.array([tuple(cell) not in filled for cell in (cells + side).tolist()])
        axis = int(np.abs(side).argmax())
        u, v = np.eye(3, dtype=np.int64)[(axis + 1) % 3], np.eye(3, dtype=np.int64)[(axis + 2) % 3]
        if side[axis] < 0:
            u, v = v, u
        base = cells[free] + np.maximum(side, 0)
        quads.append(np.stack([base, base + u, base + u + v, base + v], axis=1))
    corners, index = np.unique(np.concatenate(quads).reshape(-1, 3), axis=0, return_inverse=True)
    quad = index.reshape(-1, 4)
    return corners * edge, np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])


def _merged(vertices: Array, triangles: IntArray) -> tuple[Array, IntArray]:
    """The same surface, in which equal positions are one vertex and no triangle is a line."""
    unique, index = np.unique(vertices, axis=0, return_inverse=True)
    triangles = index.reshape(-1)[triangles]
    a, b, c = triangles.T
    return unique, triangles[(a != b) & (b != c) & (c != a)]


def _is_closed(triangles: IntArray) -> bool:
    """Whether every edge belongs to two triangles."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    every: BoolArray = counts == 2
    return bool(every.all())
