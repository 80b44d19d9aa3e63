"""One object a file: bodies that lie apart, ground planes, specks, depth meshes and open shells.

Planner and physics must see the same solid. So what a file holds besides its object is refused or left out,
and a surface with large holes is closed before anything uses it.
"""

from __future__ import annotations

from dataclasses import field

import numpy as np

from ..exceptions import InputError, ObjectError
from ..types import Array, BoolArray, IntArray, value
from . import checks
from .read_raw import group_rows
from .winding import turned, with_turned

WHOLE = "all"
"""Part of a file that means everything in it."""
SAME = 1e-6
"""Positions closer than this share of the largest extent are one point of the surface [C]."""
CELL = 0.01
"""Cell in which the gaps between bodies are looked for, as a share of the largest extent [C]."""
SAMPLES = 200_000
"""Points on the surface that fill these cells [C]."""
SPECK = 0.05
"""A body that is smaller than this share of the largest is a speck [C]."""
SHEET, SLAB, SLAB_LEAST = 1e-3, 0.05, 0.4
"""Largest thickness of a ground plane and of a table top, as shares of their extent, and least extent of a
table top [m] [C]. A lid with a knob is smaller."""
WIDER_SHEET, WIDER_SLAB = 1.5, 3.0
"""Least factors by which a ground plane and a table top are wider than what stands on them [C]."""
ONE_SIDED = 0.45
"""A surface shows one side if its vector area exceeds this share of its area: 0 for a closed surface,
over 0.5 for the visible side of a convex body [C]."""
LIDS = 0.02
"""Holes are closed by lids if these would have a larger share of the surface's area [C]."""
SOUP = 0.5
"""If more than this share of the triangles' sides is not shared, the triangles are not joined at all [C]."""
_LISTED = 6


@value
class Body:
    """The surface of one object.

    Attributes:
        vertices: (n, 3) positions [m].
        triangles: (m, 3) vertex indices.
        notes: What was left out, reversed or added, one sentence each.
        lids: Number of triangles, the last ones, that were added to close holes.
        whole: Whether this is the whole content of the file.
        kept: Indices of the given triangles that the body has, in their order and without the lids.
    """

    vertices: Array
    triangles: IntArray
    notes: tuple[str, ...] = ()
    lids: int = 0
    whole: bool = True
    kept: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


def one_body(name: str, vertices: Array, triangles: IntArray, part: str | None = None) -> Body:
    """The one object of a file, as a surface without large holes.

    1. Find the connected parts. A flat, wide part with everything else on one side of it is the ground.
    2. Join the parts between which there is no gap, or of which one encloses the other.
    3. Leave out specks. Refuse a file with several bodies, unless one of them was chosen.
    4. Reverse triangles that are wound against their neighbours.
    5. Refuse a surface that shows one side only, and close large holes.

    Args:
        name: Name of the file, for messages.
        vertices: (n, 3) positions [m].
        triangles: (m, 3) vertex indices.
        part: Number of the body that is wanted, counted from 1 in the order of size; ``all`` for everything.

    Raises:
        ObjectError: The file holds several bodies, or a ground plane, or its surface shows one side only.
        InputError: There is no body of that number.
    """
    point = group_rows(np.round((vertices - vertices.min(axis=0)) / (SAME * np.ptp(vertices, axis=0).max())))[
        1
    ]
    notes: tuple[str, ...] = ()
    total = len(triangles)
    kept = np.arange(total)
    if part != WHOLE:
        bodies, plates, specks = _bodies(vertices, triangles, point)
        chosen = _chosen(name, vertices, triangles, bodies, plates, part)
        if specks:
            pieces = "a small piece" if specks == 1 else f"{specks} small pieces"
            notes = (
                f"{pieces} of the file, apart from the object, {'is' if specks == 1 else 'are'} left out",
            )
        triangles, kept = triangles[chosen], kept[chosen]
    whole = len(triangles) == total
    triangles, rim, turning = _wound_alike(vertices, triangles, point)
    vertices, closed, closing = _without_holes(name, vertices, triangles, point, rim)
    return Body(
        vertices=vertices,
        triangles=closed,
        notes=notes + turning + closing,
        lids=len(closed) - len(triangles),
        whole=whole,
        kept=kept,
    )


def _bodies(
    vertices: Array, triangles: IntArray, point: IntArray
) -> tuple[list[BoolArray], list[BoolArray], int]:
    """Triangles of each body, the largest first, and of each ground plane; and the number of specks."""
    part = _connected(point[triangles])
    plates: list[BoolArray] = []
    if part.any():
        wide = [part == one for one in _widest(vertices[triangles], part)]
        plates = [own for own in wide if _is_ground(vertices, triangles, own)]
    rest = ~np.any(plates, axis=0) if plates else np.ones(len(triangles), dtype=bool)
    specks, bodies = 0, [rest]
    while part[rest].min(initial=0) != part[rest].max(initial=0):
        body = np.full(len(triangles), -1)
        body[rest] = _together(vertices, triangles[rest], part[rest])
        bodies = _masks(body)
        extents = [_extents(vertices, triangles[own]).max() for own in bodies]
        small = [own for own, extent in zip(bodies, extents, strict=True) if extent < SPECK * max(extents)]
        if not small:  # a speck far away makes the cells coarse, so that the gaps are looked for again
            bodies = [bodies[k] for k in np.argsort(-np.array(extents), kind="stable")]
            break
        specks += len(small)
        rest = rest & ~np.any(small, axis=0)
        bodies = [rest]
    return bodies, plates, specks


def _chosen(
    name: str,
    vertices: Array,
    triangles: IntArray,
    bodies: list[BoolArray],
    plates: list[BoolArray],
    part: str | None,
) -> BoolArray:
    """Triangles of the body that is wanted.

    Raises:
        ObjectError: There are several, and none was chosen.
        InputError: There is no such body.
    """
    found = [*bodies, *plates]
    if part is None and len(found) == 1:
        return found[0]
    if part is not None and 1 <= int(part) <= len(found):
        return found[int(part) - 1]
    listed = []
    for number, own in enumerate(found[:_LISTED], start=1):
        corners = vertices[triangles[own]].reshape(-1, 3)
        size = checks.in_millimetres(np.ptp(corners, axis=0))
        place = " ".join(f"{x:.3g}" for x in (corners.min(axis=0) + corners.max(axis=0)) / 2 + 0.0)
        listed.append(f"{number}: {size} at {place} m")
    more = f" and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
    parts = "; ".join(listed) + more
    if part is not None:
        raise InputError(f"{name}: there is no part {part} in the file, which holds {parts}")
    held = f"{len(bodies)} bodies that lie apart"
    if plates:
        held = "a flat plate besides the object, such as the ground or a table"
        held += f", and {len(bodies)} bodies that lie apart" if len(bodies) > 1 else ""
    raise ObjectError(
        f"{name}: the file holds {held}, and one object is planned for: choose it with --part-of-file N, or "
        f"all if they are one ({parts})"
    )


def _masks(label: IntArray) -> list[BoolArray]:
    """For each label of zero or more, which triangles have it; of many labels those with most triangles."""
    names, counts = np.unique(label[label >= 0], return_counts=True)
    most = names[np.argsort(-counts, kind="stable")[:1000]]
    return [label == one for one in np.sort(most)]


def _extents(vertices: Array, triangles: IntArray) -> Array:
    return np.asarray(np.ptp(vertices[triangles.ravel()], axis=0))


def _connected(faces: IntArray) -> IntArray:
    """(m,) connected part of each triangle, from 0."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = int(faces.max()) + 1
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_array((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    return np.asarray(np.unique(label[faces[:, 0]], return_inverse=True)[1]).ravel()


def _widest(corners: Array, part: IntArray) -> list[int]:
    """The parts that may be wider than all others; none if too many are alike."""
    count = int(part.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, part, corners.min(axis=1))
    np.maximum.at(high, part, corners.max(axis=1))
    spans = np.linalg.norm(high - low, axis=1)
    found = np.flatnonzero(spans >= 0.5 * spans.max())
    return found.tolist() if len(found) <= _LISTED else []


def _is_ground(vertices: Array, triangles: IntArray, own: BoolArray) -> bool:
    """Whether a part is flat, wide, and has everything else on one side."""
    plate, rest = (vertices[np.unique(triangles[mask])] for mask in (own, ~own))
    middle = plate.mean(axis=0)
    _, _, axes = np.linalg.svd(np.cov((plate - middle).T))
    plate, rest = (plate - middle) @ axes.T, (rest - middle) @ axes.T
    wide, tall = np.ptp(plate, axis=0), np.ptp(rest, axis=0)
    sheet = wide[2] <= SHEET * wide[0]
    slab = wide[2] <= SLAB * wide[1] and wide[0] >= SLAB_LEAST
    wider = wide[:2].min() >= (WIDER_SHEET if sheet else WIDER_SLAB) * tall[:2].max()
    slack = 0.01 * float(tall.max())
    above = rest[:, 2].min() >= plate[:, 2].max() - slack
    below = rest[:, 2].max() <= plate[:, 2].min() + slack
    return bool((sheet or slab) and wider and (above or below))


def _together(vertices: Array, triangles: IntArray, part: IntArray) -> IntArray:
    """(m,) body of each triangle, which joins parts in neighbouring cells and those that enclose each other.

    Args:
        vertices: (n, 3) positions [m].
        triangles: (m, 3) vertex indices.
        part: (m,) connected part of each triangle.
    """
    from scipy.ndimage import label
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    corners = vertices[triangles]
    rng = np.random.default_rng(0)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    drawn = rng.choice(len(corners), SAMPLES, p=areas / areas.sum())
    inside = np.einsum("nk,nki->ni", rng.dirichlet(np.ones(3), SAMPLES), corners[drawn])
    points = np.concatenate([corners.reshape(-1, 3), inside])
    owner = np.concatenate([np.repeat(part, 3), part[drawn]])
    low = points.min(axis=0)
    cell = tuple(((points - low) / (CELL * np.ptp(points, axis=0).max())).astype(np.int64).T)
    filled = np.zeros([int(axis.max()) + 1 for axis in cell], dtype=bool)
    filled[cell] = True
    region = label(filled, structure=np.ones((3, 3, 3)))[0][cell]
    # Parts and regions of cells are the nodes of one graph.
    parts, regions = int(part.max()) + 1, int(region.max()) + 1
    graph = coo_array((np.ones(len(owner)), (owner, parts + region)), shape=(parts + regions,) * 2)
    body = connected_components(graph, directed=False)[1][part]
    for inner in np.unique(body):
        for outer in np.unique(body[body != inner]):
            if _encloses(corners[body == outer], corners[body == inner]):
                body = np.where(body == inner, outer, body)
                break
    return np.asarray(body)


def _encloses(outer: Array, inner: Array) -> bool:
    """Whether a surface encloses another, which is then a cavity: its winding number there is not zero."""
    low, high = outer.min(axis=(0, 1)), outer.max(axis=(0, 1))
    if (inner < low).any() or (inner > high).any():
        return False
    a, b, c = np.moveaxis(outer - inner[0, 0], 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = np.einsum("ni,ni->n", a, np.cross(b, c))
    rest = la * lb * lc + lc * np.einsum("ni,ni->n", a, b)
    rest += la * np.einsum("ni,ni->n", b, c) + lb * np.einsum("ni,ni->n", c, a)
    return bool(abs(np.arctan2(volume, rest).sum()) > np.pi)  # half of the solid angle of a closed surface


def _wound_alike(
    vertices: Array, triangles: IntArray, point: IntArray
) -> tuple[IntArray, IntArray, tuple[str, ...]]:
    """The triangles wound consistently, the edges of one triangle only, and what is said about the winding.

    Volume, mass and the side of a hole's lid follow from the winding. A file that is wound consistently does
    not change, even if all of it is inside out, which makes no difference.
    """
    faces = point[triangles]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = int(point.max()) + 1
    key = edges.min(axis=1) * count + edges.max(axis=1)
    order = np.argsort(key)
    starts = np.flatnonzero(np.r_[True, key[order][1:] != key[order][:-1]])
    sizes = np.diff(np.r_[starts, len(key)])
    alone, pair = order[starts[sizes == 1]], starts[sizes == 2]
    rim = edges[alone]
    alike = pair[edges[order[pair], 0] == edges[order[pair + 1], 0]]
    start, end = edges[order[alike]].T
    if (start == end).all():  # two corners at one point say nothing
        return triangles, rim, ()
    corners = vertices[triangles]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = corners.reshape(-1, 3)
    turn = turned(faces, corners, crosses, (flat.min(axis=0) + flat.max(axis=0)) / 2)
    if not turn.any():
        return triangles, rim, ()
    rim = np.where(turn[alone % len(triangles)][:, None], rim[:, ::-1], rim)
    note = "triangles of the file are wound against their neighbours: "
    return with_turned(triangles, turn), rim, (note + f"{turn.sum()} of {len(turn)} were reversed",)


def _without_holes(
    name: str, vertices: Array, triangles: IntArray, point: IntArray, rim: IntArray
) -> tuple[Array, IntArray, tuple[str, ...]]:
    """The surface with lids on large holes, as its last triangles, and what is said about them.

    Args:
        name: Name of the file, for messages.
        vertices: (n, 3) positions [m].
        triangles: (m, 3) vertex indices.
        point: (n,) point of the surface that each vertex is.
        rim: (k, 2) the points of each edge of one triangle only, in that triangle's direction.

    Raises:
        ObjectError: The surface shows one side only.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = int(point.max()) + 1
    if not len(rim) or len(rim) > SOUP * 3 * len(triangles):
        return vertices, triangles, ()
    crosses = np.cross(
        vertices[triangles[:, 1]] - vertices[triangles[:, 0]],
        vertices[triangles[:, 2]] - vertices[triangles[:, 0]],
    )
    area = float(np.linalg.norm(crosses, axis=1).sum())
    if float(np.linalg.norm(crosses.sum(axis=0))) > ONE_SIDED * area:
        raise ObjectError(
            f"{name}: the surface is open and shows one side only, as the mesh of a depth image does; give "
            "its points (PLY without faces, PCD, XYZ, NPY), whose far side is completed, or a closed surface"
        )
    place = np.zeros((count, 3))
    place[point] = vertices
    graph = coo_array((np.ones(len(rim)), (rim[:, 0], rim[:, 1])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    on, hole = np.unique(label[rim[:, 0]], return_inverse=True)
    hole = hole.ravel()
    middles = np.array([place[np.unique(rim[hole == k])].mean(axis=0) for k in range(len(on))])
    lids = np.linalg.norm(
        np.cross(place[rim[:, 0]] - middles[hole], place[rim[:, 1]] - middles[hole]), axis=1
    )
    if lids.sum() <= LIDS * area:
        return vertices, triangles, ()
    index = np.zeros(count, dtype=np.int64)
    index[point] = np.arange(len(vertices))
    added = np.stack([index[rim[:, 1]], index[rim[:, 0]], len(vertices) + hole], axis=1)
    holes = "a hole" if len(on) == 1 else f"{len(on)} holes"
    note = (
        f"the surface is open: {holes} closed by flat lids; the object is planned and tested as a solid, and "
        "no finger is placed on a lid"
    )
    return np.concatenate([vertices, middles]), np.concatenate([triangles, added]), (note,)
