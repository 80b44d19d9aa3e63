"""The shape descriptor: equal for all triangulations of a surface, different for other shapes."""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from preshape.exceptions import InputError, ObjectError
from preshape.objects.library import load_library_object, names
from preshape.objects.mesh import TriangleMesh
from preshape.objects.shape import (
    LENGTH,
    NORMAL_MOMENTS,
    POSITION_MOMENTS,
    described,
    shape_descriptor,
    shape_distance,
)
from preshape.types import Array, IntArray

EXACT = 1e-10
"""Rounding is all that may differ where the surface is the same."""


@cache
def descriptor(name: str) -> Array:
    return shape_descriptor(load_library_object(name))


def mesh(vertices: Array, triangles: IntArray, name: str = "mesh") -> TriangleMesh:
    return TriangleMesh(name=name, vertices=vertices, triangles=triangles)


def split(thing: TriangleMesh, inside: Array, chosen: IntArray) -> TriangleMesh:
    """The mesh with chosen triangles cut into three at inner points, given in barycentric coordinates."""
    vertices, triangles = list(thing.vertices), [list(t) for t in thing.triangles]
    for index, share in zip(chosen, inside, strict=True):
        a, b, c = triangles[index]
        vertices.append(share @ thing.vertices[[a, b, c]])
        new = len(vertices) - 1
        triangles[index] = [a, b, new]
        triangles += [[b, c, new], [c, a, new]]
    return mesh(np.array(vertices), np.array(triangles))


def solid_again(
    thing: TriangleMesh, *, finer: float | None = None, coarser: float | None = None
) -> TriangleMesh:
    """The solid meshed again, with edges up to ``finer`` or simplified to within ``coarser`` [m]."""
    from manifold3d import Manifold, Mesh64

    solid = Manifold(Mesh64(np.array(thing.vertices), thing.triangles.astype(np.uint64)))
    solid = solid.refine_to_length(finer) if finer is not None else solid.as_original().simplify(coarser)
    found = solid.to_mesh64()
    return mesh(np.array(found.vert_properties[:, :3]), np.array(found.tri_verts, dtype=np.int64))


def prism(corners: Array, height: float) -> TriangleMesh:
    """An upright prism over a convex polygon about the origin."""
    n = len(corners)
    low = np.column_stack([corners, np.full(n, -height / 2)])
    ends = np.array([[0.0, 0.0, -height / 2], [0.0, 0.0, height / 2]])
    vertices = np.concatenate([low, low * np.array([1.0, 1.0, -1.0]), ends])
    triangles = []
    for i in range(n):
        j = (i + 1) % n
        triangles += [[i, j, n + j], [i, n + j, n + i], [j, i, 2 * n], [n + i, n + j, 2 * n + 1]]
    return mesh(vertices, np.array(triangles))


def polygon(sides: int, width: float = 0.06, depth: float = 0.06) -> Array:
    """A polygon with equal angles, stretched to its extents."""
    angle = 2 * np.pi * np.arange(sides) / sides
    corners = np.column_stack([np.cos(angle), np.sin(angle)])
    return corners / np.ptp(corners, axis=0) * [width, depth]


# --- the numbers themselves ---------------------------------------------------------------------------


def test_a_box_by_hand() -> None:
    w, h, d = 0.02, 0.03, 0.07
    corners = np.array([[x, y, z] for x in (-w, w) for y in (-h, h) for z in (-d, d)]) / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([[q[0], *pair] for q in quads for pair in (q[1:3], q[2:4])])
    found = dict(zip(POSITION_MOMENTS, shape_descriptor(mesh(corners, triangles)), strict=False))
    sides = np.array([h * d, w * d, w * h]) * 2
    share = sides / sides.sum()  # of the faces across x, y, z
    for (a, b, c), content in found.items():
        even = all(n % 2 == 0 for n in (a, b, c))
        means = [
            math.prod(1 if n == axis else 1 / (p + 1) for n, p in enumerate((a, b, c))) for axis in range(3)
        ]
        assert content == pytest.approx(float(share @ means) if even else 0.0, abs=1e-14)
    assert shape_descriptor(mesh(corners, triangles))[21:24] == pytest.approx(share)
    assert shape_descriptor(mesh(corners, triangles))[24:] == pytest.approx([0, 0, 0, 1], abs=1e-14)


def test_a_single_triangle_by_sampling() -> None:
    rng = np.random.default_rng(3)
    thing = mesh(rng.normal(size=(3, 3)), np.array([[0, 1, 2]]))
    shares = rng.dirichlet([1, 1, 1], 400_000)
    points = (shares @ thing.vertices - thing.cog) / (thing.extents / 2)
    sampled = [float(np.mean(np.prod(points**exponents, axis=1))) for exponents in POSITION_MOMENTS]
    found = shape_descriptor(thing)
    assert found[:21] == pytest.approx(sampled, abs=5e-3)
    normal = thing.normals[0]
    assert found[21:27] == pytest.approx([float(np.prod(normal**e)) for e in NORMAL_MOMENTS])


@pytest.mark.parametrize("name", names())
def test_every_number_is_within_one(name: str) -> None:
    found = descriptor(name)
    assert found.shape == (LENGTH,) == (28,)
    assert not found.flags.writeable
    assert np.abs(found[:-1]).max() <= 1.0
    assert found[21:24].sum() == pytest.approx(1.0)
    assert found[-1] > 0.0
    again = described(load_library_object(name)).shape
    assert again is not None
    assert again.tobytes() == found.tobytes()


# --- what changes nothing -----------------------------------------------------------------------------

some_objects = st.sampled_from(["cube", "pyramid", "wedge", "mug", "key", "teapot"])


@settings(derandomize=True, deadline=None, max_examples=30)
@given(name=some_objects, seed=st.integers(0, 999), scale=st.floats(0.01, 50.0))
def test_cutting_order_winding_place_and_size_change_nothing(name: str, seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    thing = load_library_object(name)
    chosen = rng.choice(len(thing.triangles), min(40, len(thing.triangles)), replace=False)
    finer = split(thing, rng.dirichlet([1, 1, 1], len(chosen)), chosen)
    order = rng.permutation(len(finer.vertices))
    vertices = finer.vertices[np.argsort(order)]
    triangles = order[finer.triangles][rng.permutation(len(finer.triangles))]
    flipped = rng.random(len(triangles)) < 0.5
    triangles[flipped] = triangles[flipped][:, ::-1]
    changed = mesh(vertices * scale + rng.normal(size=3), triangles)
    assert np.abs(shape_descriptor(changed) - descriptor(name)).max() < EXACT


@pytest.mark.parametrize("name", ["mug", "banana", "scissors"])
def test_cutting_everywhere_changes_nothing(name: str) -> None:
    thing = load_library_object(name)
    finer = solid_again(thing, finer=0.03 * float(thing.extents.max()))
    assert len(finer.triangles) > 1.2 * len(thing.triangles)
    assert np.abs(shape_descriptor(finer) - descriptor(name)).max() < 1e-6  # the kernel rounds a little


def test_unused_vertices_change_nothing() -> None:
    thing = load_library_object("mug")
    more = mesh(np.concatenate([thing.vertices, [[9.0, 9.0, 9.0]]]), thing.triangles)
    assert shape_descriptor(more).tobytes() == descriptor("mug").tobytes()


# --- what changes it as it should ---------------------------------------------------------------------

TURNS = [
    np.eye(3)[list(order)] * np.array(signs)
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1, -1), repeat=3)
]
"""The 48 turns by 90° and mirror images."""


def moved(found: Array, turn: Array) -> Array:
    """The descriptor of a rotated or mirrored object, from that of the original."""
    result = found.copy()
    sources, signs = np.abs(turn).argmax(axis=1), turn.sum(axis=1)
    for first, table in ((0, POSITION_MOMENTS), (21, NORMAL_MOMENTS)):
        for i, exponents in enumerate(table):
            before = [0, 0, 0]
            for new, old in enumerate(sources):
                before[old] = exponents[new]
            sign = float(np.prod(signs ** np.array(exponents)))
            result[first + i] = sign * found[first + table.index(tuple(before))]
    return result


@settings(derandomize=True, deadline=None, max_examples=30)
@given(name=some_objects, turn=st.sampled_from(TURNS))
def test_turns_and_mirror_images_permute_it(name: str, turn: Array) -> None:
    thing = load_library_object(name)
    after = shape_descriptor(mesh(thing.vertices @ turn.T, thing.triangles))
    assert after == pytest.approx(moved(descriptor(name), turn), abs=EXACT)


@pytest.mark.parametrize("name", ["mug", "hammer", "wedge", "spray_bottle"])
def test_an_object_without_symmetry_looks_different_after_every_turn(name: str) -> None:
    thing = load_library_object(name)
    seen = [shape_descriptor(mesh(thing.vertices @ t.T, thing.triangles)) for t in TURNS]
    turned = [s for s, t in zip(seen, TURNS, strict=True) if np.linalg.det(t) > 0]
    distances = [shape_distance(a, b) for a, b in itertools.combinations(turned, 2)]
    assert min(distances) > 0.1


def test_every_two_library_objects_differ() -> None:
    pairs = {
        (a, b): shape_distance(descriptor(a), descriptor(b)) for a, b in itertools.combinations(names(), 2)
    }
    nearest = min(pairs, key=lambda pair: pairs[pair])
    assert nearest == ("prism", "cylinder")
    assert pairs[nearest] > 0.09


@pytest.mark.parametrize("name", names())
def test_an_object_meshed_more_coarsely_is_nearer_to_itself_than_to_any_other(name: str) -> None:
    thing = load_library_object(name)
    coarse = shape_descriptor(solid_again(thing, coarser=0.002 * float(thing.extents.max())))
    own = shape_distance(coarse, descriptor(name))
    others = min(shape_distance(coarse, descriptor(other)) for other in names() if other != name)
    assert own < 0.3 * others
    assert own < 0.05


def test_a_scan_with_a_hole_is_nearest_to_the_whole_object() -> None:
    thing = solid_again(load_library_object("pear"), finer=0.004)
    kept = np.argsort(thing.corners.mean(axis=1) @ [0.3, -0.4, 0.6])[: int(0.97 * len(thing.triangles))]
    scan = shape_descriptor(mesh(thing.vertices, thing.triangles[kept]))
    distances = {name: shape_distance(scan, descriptor(name)) for name in names()}
    assert min(distances, key=lambda name: distances[name]) == "pear"


@pytest.mark.parametrize(
    ("width", "depth", "height"), [(0.06, 0.06, 0.08), (0.06, 0.05196, 0.03), (0.1, 0.04, 0.15)]
)
def test_a_cylinder_and_a_hexagonal_prism_of_equal_extents_differ(
    width: float, depth: float, height: float
) -> None:
    round_, fine = (prism(polygon(n, width, depth), height) for n in (64, 256))
    hexagon = prism(polygon(6, width, depth), height)
    assert hexagon.extents == pytest.approx(round_.extents)
    apart = shape_distance(shape_descriptor(round_), shape_descriptor(hexagon))
    assert apart > 0.05
    assert apart > 20 * shape_distance(shape_descriptor(round_), shape_descriptor(fine))


# --- what has no shape --------------------------------------------------------------------------------


def test_a_surface_without_area_is_refused() -> None:
    line = mesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(ObjectError, match="without area"):
        shape_descriptor(line)


def test_a_flat_sheet_has_a_shape() -> None:
    sheet = mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), np.array([[0, 1, 2], [1, 3, 2]]))
    found = shape_descriptor(sheet)
    assert np.isfinite(found).all()
    assert found[[5, 23, 27]] == pytest.approx([0.0, 1.0, 0.5])


def test_descriptors_of_another_length_are_not_compared() -> None:
    with pytest.raises(InputError, match="shape descriptor must be 28 numbers, got 27"):
        shape_distance(descriptor("cube"), descriptor("cube")[1:])
