"""How an object rests on a table: centre of mass, support, tip angle, and how it settles by tipping.

A pose is given by ``up``, the unit vector against gravity in the mesh frame. The table touches the object at
its lowest points. The support polygon is the convex hull of what stands on the table, seen from above. The
tip angle is the smallest angle by which the object must be turned, about an edge of that polygon, before its
weight turns it over. A negative tip angle means that it falls by itself.
"""

from __future__ import annotations

import contextlib
import math
from weakref import WeakKeyDictionary

import numpy as np

from .. import spatial
from ..exceptions import InputError, shown
from ..types import Array, read_only, value
from .mesh import UP_AXES, TriangleMesh

STEADY = math.radians(5.0)
"""Least tip angle with which an object stands as it is modelled [C]; with less, it settles."""
NEAR, NEAREST = 0.01, 1e-3
"""What is within this share of the largest extent from the table, but at most the second distance [m], counts
as standing on it [C]: scans are uneven."""
SINKS = 0.01
"""Least share of its height by which the centre of mass sinks when an object tips over [C]; a ball stays."""
SHEET = 1e-3
"""A mesh with less volume than this share of its bounding box has the centre of its surface as its own."""
MOST_ROLLS = 200
_HULLS: WeakKeyDictionary[TriangleMesh, Array] = WeakKeyDictionary()


@value
class Support:
    """How an object stands on a table.

    Attributes:
        tip_angle: The tip angle [rad]; negative if the object falls by itself.
        height: Height of the centre of mass above the table [m].
        edge: (2, 3) ends of the edge over which it tips most easily, mesh frame [m]; equal where it stands on
            a single point.
        outward: (3,) horizontal unit vector in which it tips over that edge, mesh frame.
    """

    tip_angle: float
    height: float
    edge: Array
    outward: Array


def upright(up: str) -> Array:
    """(3, 3) rotation from the mesh frame to a frame with z up, for the axis of the mesh that is up.

    Axes that are horizontal in both frames turn as little as possible, as glTF's y up to z up does.

    Raises:
        InputError: There is no such axis.

    >>> upright("y").astype(int).tolist()
    [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    """
    if up not in UP_AXES:
        raise InputError(f"up must be one of {', '.join(UP_AXES)}, got {shown(up)}")
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up[0] == "-" else 1.0
    if up == "-z":
        return np.diag([1.0, -1.0, -1.0])
    return turned_up(axis).round() + 0.0


def turned_up(up: Array) -> Array:
    """(3, 3) the smallest rotation that turns the unit vector ``up`` (3,) to +z; about x for -z."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(up[2])
    if sine < 1e-12:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    return np.asarray(spatial.rotation_from_vector(axis / sine * math.atan2(sine, cosine)))


def centre_of_mass(mesh: TriangleMesh) -> Array:
    """(3,) centre of mass [m]: the mesh's own, else that of a solid of uniform density.

    A surface that encloses nothing has the centre of its area.
    """
    if mesh.com is not None:
        return mesh.com
    middle = mesh.corners.mean(axis=1)
    if abs(mesh.volume) <= SHEET * float(mesh.extents.prod()):
        return np.asarray(mesh.areas @ middle / mesh.area)
    from_cog = mesh.corners - mesh.cog
    volumes = np.einsum("ij,ij->i", from_cog[:, 0], mesh.crosses) / 6.0
    return np.asarray(mesh.cog + volumes @ (from_cog.sum(axis=1) / 4.0) / volumes.sum())


def hull_points(mesh: TriangleMesh) -> Array:
    """(n, 3) corners of the convex hull [m]; all vertices in use if the mesh is flat."""
    from scipy.spatial import ConvexHull, QhullError

    if mesh not in _HULLS:
        points = np.unique(mesh.corners.reshape(-1, 3), axis=0)
        with contextlib.suppress(QhullError, ValueError):
            points = points[ConvexHull(points).vertices]
        _HULLS[mesh] = read_only(points)
    return _HULLS[mesh]


def support(points: Array, centre: Array, up: Array, near: float = 0.0) -> Support:
    """How an object stands.

    Args:
        points: (n, 3) corners of its convex hull [m].
        centre: (3,) its centre of mass [m].
        up: (3,) unit vector against gravity.
        near: What is at most so far above the table stands on it [m].
    """
    R = turned_up(np.asarray(up, dtype=np.float64))
    at = (points - centre) @ R.T
    low = float(at[:, 2].min())
    standing = at[at[:, 2] <= low + near + 1e-9]
    a, b, outward = _nearest_edge(standing[:, :2])
    inside = float(a @ outward)  # distance of the edge from below the centre of mass, outwards
    ends = np.column_stack([[a, b], [low, low]])
    return Support(
        tip_angle=math.atan2(inside, -low),
        height=-low,
        edge=ends @ R + centre,
        outward=np.append(outward, 0.0) @ R,
    )


def settled(points: Array, centre: Array, up: Array, *, near: float = 0.0, least: float = STEADY) -> Array:
    """(3,) ``up`` after an object has tipped over, edge by edge, until its tip angle is ``least`` or more.

    1. Turn the object about the edge over which it tips most easily, until the next corner touches the table;
       repeat while the tip angle is below ``least``. What is ``near`` the table counts as standing on it, so
       that the bumps of a scan are not taken for edges.
    2. Let it roll on exactly, without ``near``, to where its centre of mass is lowest; repeat from 1.

    An object that finds no rest in ``MOST_ROLLS`` steps stays as it is, and so does one that does not fall by
    itself and whose centre of mass would sink by less than the share ``SINKS`` of its height: it is about as
    stable as before.

    Args:
        points: (n, 3) corners of its convex hull [m].
        centre: (3,) its centre of mass [m].
        up: (3,) unit vector against gravity at the start.
        near: What is at most so far above the table stands on it [m].
        least: Tip angle at which it rests [rad].
    """
    start = np.asarray(up, dtype=np.float64)
    first = support(points, centre, start, near)
    if first.tip_angle >= least:
        return start
    now, stands = start, first
    for _ in range(MOST_ROLLS):
        if stands.tip_angle >= least:
            now = _lowest(points, centre, now)
            stands = support(points, centre, now, near)
            if stands.tip_angle >= least:
                break
        now = _rolled(points, now, stands, near)
        stands = support(points, centre, now, near)
    else:
        return start
    sinks = stands.height < (1.0 - SINKS) * first.height
    return now if sinks or first.tip_angle < 0 else start


def _lowest(points: Array, centre: Array, up: Array) -> Array:
    """(3,) ``up`` after rolling downhill to the nearest pose in which the object does not fall by itself."""
    for _ in range(MOST_ROLLS):
        stands = support(points, centre, up)
        if stands.tip_angle >= -1e-6:
            break
        up = _rolled(points, up, stands, 0.0)
    return up


def settled_up(mesh: TriangleMesh, up: Array) -> Array:
    """(3,) ``up`` of a mesh after it has settled on a table (:func:`settled`), mesh frame.

    Args:
        mesh: The object [m].
        up: (3,) unit vector against gravity as the object is modelled.
    """
    near = min(NEAR * float(mesh.extents.max()), NEAREST)
    return settled(hull_points(mesh), centre_of_mass(mesh), up, near=near)


def _nearest_edge(standing: Array) -> tuple[Array, Array, Array]:
    """Ends (2,) and outward normal (2,) of the edge of a support polygon that is nearest to the origin.

    A negative distance, outside, counts as nearest. A polygon of one point or one line has its own edges.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners = standing[ConvexHull(standing).vertices]  # counter-clockwise
    except (QhullError, ValueError):
        return _nearest_of_line(standing)
    ends = np.roll(corners, -1, axis=0)
    along = ends - corners
    outward = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    k = int(np.einsum("ij,ij->i", corners, outward).argmin())
    return corners[k], ends[k], outward[k]


def _nearest_of_line(standing: Array) -> tuple[Array, Array, Array]:
    """The same for points on a line: what tips does so away from the point nearest to the origin."""
    middle = standing.mean(axis=0)
    along = standing[int(np.linalg.norm(standing - middle, axis=1).argmax())] - middle
    length = float(np.linalg.norm(along))
    if length > 1e-9:
        along = along / length
        reach = (standing - middle) @ along
        a, b = middle + reach.min() * along, middle + reach.max() * along
        across = np.array([along[1], -along[0]])
        side = float(a @ across)
        across = across if side <= 0 else -across  # the centre of mass, at the origin, lies on this side
        if (a @ along) * (b @ along) <= 0:
            return a, b, across
        middle = a if np.linalg.norm(a) < np.linalg.norm(b) else b
    away = float(np.linalg.norm(middle))
    return middle, middle, -middle / away if away > 1e-9 else np.array([1.0, 0.0])


def _rolled(points: Array, up: Array, stands: Support, near: float) -> Array:
    """(3,) ``up`` after the object has turned about an edge until the next corner touches the table."""
    out = (points - stands.edge[0]) @ stands.outward
    high = (points - stands.edge[0]) @ up
    free = (out > 1e-9) | (high > near + 1e-6)
    if not free.any():
        return up
    angle = float(np.arctan2(np.maximum(high[free], 0.0), out[free]).min())
    # The object turns outwards, so that seen from it, up turns inwards.
    turned = math.cos(angle) * up - math.sin(angle) * stands.outward
    return np.asarray(turned / np.linalg.norm(turned))
