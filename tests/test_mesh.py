"""The mesh as a value: closed forms, the COG, open and broken surfaces."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from preshape.exceptions import ObjectError
from preshape.objects.mesh import TriangleMesh

Array = NDArray[np.float64]

BOX_TRIANGLES = [
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
]  # fmt: skip
DERIVED = ("corners", "bounds", "extents", "cog", "areas", "normals")


def mesh_of(vertices: object, triangles: object) -> TriangleMesh:
    return TriangleMesh(name="thing", vertices=np.asarray(vertices), triangles=np.asarray(triangles))


def box(
    half: tuple[float, ...] = (0.5, 1.0, 1.5), centre: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> TriangleMesh:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return mesh_of(signs * half + np.array(centre), BOX_TRIANGLES)


def tetrahedron() -> TriangleMesh:
    return mesh_of([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def test_box_in_closed_form() -> None:
    mesh = box(centre=(7.0, -8.0, 9.0))
    assert mesh.extents == pytest.approx([1, 2, 3])
    assert mesh.cog == pytest.approx([7, -8, 9])
    assert mesh.bounds == pytest.approx(np.array([[6.5, -9, 7.5], [7.5, -7, 10.5]]))
    assert mesh.area == pytest.approx(2 * (1 * 2 + 2 * 3 + 3 * 1))
    assert mesh.volume == pytest.approx(6)
    outward = mesh.corners.mean(axis=1) - mesh.cog
    assert (np.einsum("ij,ij->i", outward, mesh.normals) > 0).all()
    assert (
        sorted(map(tuple, np.abs(mesh.normals).round(12)))
        == [(0, 0, 1)] * 4 + [(0, 1, 0)] * 4 + [(1, 0, 0)] * 4
    )
    found = mesh.attributes
    assert found.extents == pytest.approx([1, 2, 3])
    assert (found.vertices, found.vertex_normals, found.faces, found.triangles) == (8, 8, 12, 12)
    assert (found.area, found.volume) == (pytest.approx(22), pytest.approx(6))


def test_tetrahedron_in_closed_form() -> None:
    mesh = tetrahedron()
    assert mesh.areas == pytest.approx([1, 1.5, 3, 0.5 * np.sqrt(6**2 + 3**2 + 2**2)])
    assert mesh.volume == pytest.approx(1)
    assert mesh.normals == pytest.approx(
        np.array([[0, 0, -1], [0, -1, 0], [-1, 0, 0], np.array([6, 3, 2]) / 7])
    )
    # The middle of the bounding box, not the centroid (1/4, 2/4, 3/4) and not that of the vertices.
    assert mesh.cog == pytest.approx([0.5, 1.0, 1.5])


def test_cog_is_the_middle_of_the_box_however_the_vertices_crowd() -> None:
    mesh = tetrahedron()
    crowded = np.vstack([mesh.vertices, np.full((50, 3), 0.01)])
    triangles = [*mesh.triangles.tolist(), [0, 1, 4], [5, 6, 7]]
    assert mesh_of(crowded, triangles).cog == pytest.approx([0.5, 1.0, 1.5])


def test_unused_vertices_count_for_nothing() -> None:
    mesh = box()
    stray = mesh_of(np.vstack([[[99, -99, 99]], mesh.vertices, [[-50, 50, 50]]]), np.array(BOX_TRIANGLES) + 1)
    assert np.array_equal(stray.bounds, mesh.bounds)
    assert np.array_equal(stray.cog, mesh.cog)
    assert stray.volume == pytest.approx(mesh.volume)
    assert stray.attributes.vertices == 8


def test_counts_of_the_file_are_kept() -> None:
    mesh = box()
    made = TriangleMesh(name="b", vertices=mesh.vertices, triangles=mesh.triangles, counts=(24, 6, 6, 12))
    found = made.attributes
    assert (found.vertices, found.vertex_normals, found.faces, found.triangles) == (24, 6, 6, 12)


def test_an_open_box_is_closed_by_cones_to_its_cog() -> None:
    # Without its two triangles at -x, the hole is closed by a cone that reaches the COG: one sixth is lost.
    mesh = mesh_of(box().vertices, BOX_TRIANGLES[2:])
    assert mesh.volume == pytest.approx(6 * 5 / 6)
    assert mesh.area == pytest.approx(22 - 6)
    moved = mesh_of(box(centre=(100.0, 50.0, -30.0)).vertices, BOX_TRIANGLES[2:])
    assert moved.volume == pytest.approx(5)


def test_inside_out_is_negative_and_attributes_are_not() -> None:
    mesh = mesh_of(box().vertices, np.array(BOX_TRIANGLES)[:, ::-1])
    assert mesh.volume == pytest.approx(-6)
    assert mesh.attributes.volume == pytest.approx(6)
    assert np.allclose(mesh.normals, -box().normals)


def test_triangles_without_area_have_no_normal_and_change_nothing() -> None:
    mesh = box()
    flat = [[0, 0, 0], [0, 1, 1], [3, 2, 3]]
    more = mesh_of(mesh.vertices, [*BOX_TRIANGLES, *flat])
    assert not more.normals[-3:].any()
    assert not more.areas[-3:].any()
    assert np.isfinite(more.normals).all()
    assert (more.area, more.volume) == (pytest.approx(22), pytest.approx(6))


@settings(derandomize=True, deadline=None, max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([1e-3, 1.0, 10.0]))
def test_area_and_volume_under_rigid_motion_and_scale(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    R = q * np.sign(np.linalg.det(q))
    d = rng.uniform(-10, 10, 3)
    base = tetrahedron()
    moved = mesh_of(base.vertices @ R.T * size + d, base.triangles)
    assert moved.area == pytest.approx(base.area * size**2, rel=1e-9)
    assert moved.volume == pytest.approx(base.volume * size**3, rel=1e-9)
    assert np.allclose(moved.normals, base.normals @ R.T, atol=1e-9)
    assert np.allclose(np.linalg.norm(moved.normals, axis=1), 1)


def test_arrays_are_copied_and_read_only() -> None:
    vertices, triangles = np.array(box().vertices), np.array(BOX_TRIANGLES)
    mesh = mesh_of(vertices, triangles)
    vertices[0] = 99
    triangles[0] = 0
    assert mesh.vertices[0].tolist() == [-0.5, -1.0, -1.5]
    assert mesh.triangles[0].tolist() == [0, 1, 3]
    assert mesh.vertices.dtype == np.float64
    assert mesh.triangles.dtype == np.int64
    for array in (mesh.vertices, mesh.triangles):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1
    with pytest.raises(AttributeError):
        mesh.name = "other"  # type: ignore[misc]


@pytest.mark.parametrize("name", DERIVED)
def test_what_is_derived_cannot_be_written_either(name: str) -> None:
    # They are computed once and kept: writing into one would move the object for everybody else.
    assert not getattr(box(), name).flags.writeable


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy])
def test_a_copy_is_as_read_only_as_the_original(again: object) -> None:
    mesh = box()
    assert mesh.volume == pytest.approx(6)  # what is cached travels too
    twin = again(mesh)  # type: ignore[operator]
    assert np.array_equal(twin.vertices, mesh.vertices)
    assert not twin.vertices.flags.writeable
    assert not twin.triangles.flags.writeable


@pytest.mark.parametrize(
    ("vertices", "triangles"),
    [
        (np.zeros((4, 2)), [[0, 1, 2]]),
        (np.zeros(12), [[0, 1, 2]]),
        (np.eye(3), [[0, 1]]),
        (np.eye(3), [0, 1, 2]),
    ],
)
def test_wrong_shapes_are_refused(vertices: Array, triangles: object) -> None:
    with pytest.raises(ObjectError, match=r"thing: .* must be [nm]×3.*, got shape"):
        mesh_of(vertices, triangles)


@pytest.mark.parametrize(
    ("vertices", "triangles"),
    [
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]]),
        ([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], [[0, 1, 2]]),
        (np.eye(3), [[0, 1, 3]]),
        (np.eye(3), [[0, 1, -1]]),
        (np.eye(3), np.zeros((0, 3), dtype=int)),
        ([["a", "b", "c"]] * 3, [[0, 1, 2]]),
    ],
    ids=["nan", "inf", "index too large", "index negative", "no triangle", "words"],
)
def test_a_mesh_made_in_code_is_checked_at_once(vertices: object, triangles: object) -> None:
    # TriangleMesh is a public name: what load_object refuses must not get in by the other door.
    with pytest.raises(ObjectError):
        mesh_of(vertices, triangles)
