"""The built-in objects: closed surfaces that a hand can hold, always the same."""

from __future__ import annotations

import pickle
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from preshape.exceptions import ObjectError, UnknownObject
from preshape.objects import library

LIMIT = 4 * 0.043  # 4U of the utah_mit hand [m]
APERTURE = 0.08  # what three phalanges of 43, 33 and 25 mm close over from both sides, with room [m]
TUNNELS = {
    "ring": 1, "mug": 1, "teapot": 1, "pan": 1, "scissors": 2, "nut": 1, "key": 1, "padlock": 1,
    "hand_wheel": 6,
}  # fmt: skip
PLAIN = {"cube": 12, "box": 12, "pyramid": 6, "prism": 20}

every_object = pytest.mark.parametrize("name", library.names())


def surface(name: str) -> trimesh.Trimesh:
    mesh = library.load_library_object(name)
    return trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)


def test_the_library_is_large_and_has_what_the_paper_needs() -> None:
    names = library.names()
    assert len(names) == len(set(names)) >= 24
    assert {"cube", "box", "prism", "cylinder", "sphere", "mug", "bottle", "hammer", "dolphin"} <= set(names)
    assert names[0] == "cube"


@every_object
def test_surface_is_closed_outward_and_in_one_piece(name: str) -> None:
    solid = surface(name)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume > 0
    assert solid.body_count == 1
    assert solid.euler_number == 2 - 2 * TUNNELS.get(name, 0)


@every_object
def test_no_duplicate_vertex_no_unused_vertex_no_triangle_without_area(name: str) -> None:
    mesh = library.load_library_object(name)
    assert np.isfinite(mesh.vertices).all()
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    assert np.array_equal(np.unique(mesh.triangles), np.arange(len(mesh.vertices)))
    assert mesh.areas.min() > 1e-12  # a millionth of a square millimetre
    assert len(mesh.triangles) == PLAIN.get(name, len(mesh.triangles)) <= 16000


def crossings(corners: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights where the line through ``point`` along +z crosses the triangles, -1 inward and +1 outward."""
    flat = corners[..., :2]
    near = ((flat.min(axis=1) <= point) & (point <= flat.max(axis=1))).all(axis=1)
    (ax, ay), (bx, by), (cx, cy) = np.moveaxis(flat[near] - point, 0, -1)
    weights = np.stack([bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx], axis=1)
    hit = (weights > 0).all(axis=1) | (weights < 0).all(axis=1)
    weights, total = weights[hit], weights[hit].sum(axis=1)
    heights = (weights * corners[near][hit, :, 2]).sum(axis=1) / total
    order = np.argsort(heights)
    return heights[order], np.sign(total[order])


@every_object
def test_a_ray_goes_in_and_out_in_turn(name: str) -> None:
    """A surface that folds or intersects itself is entered twice."""
    rng = np.random.default_rng(7)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    corners = library.load_library_object(name).corners @ turn
    low, high = corners.min(axis=(0, 1))[:2], corners.max(axis=(0, 1))[:2]
    for point in rng.uniform(low, high, size=(40, 2)):
        _, signs = crossings(corners, point)
        assert len(signs) % 2 == 0
        assert np.array_equal(signs, np.resize([-1.0, 1.0], len(signs)))


@every_object
def test_thumb_and_two_fingers_can_oppose(name: str) -> None:
    """For some approach plane and value all three fingers hit, within the opening of the hand."""
    mesh = library.load_library_object(name)
    for approach, opposition in ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)):
        axes = [approach, 3 - approach - opposition, opposition]
        for aim in (0.0, 0.25, 0.65, 0.925, -0.25, -0.65, -0.925):
            points = [(aim * mesh.extents[approach] / 2 + 1e-5, side + 1e-5) for side in (0, -0.005, 0.005)]
            lines = [crossings(mesh.corners[..., axes], np.array(point))[0] for point in points]
            if all(len(line) for line in lines):
                top, bottom = lines[0][-1], min(lines[1][0], lines[2][0])
                if top - bottom <= APERTURE:
                    return
    pytest.fail(f"no precision grasp of {name}")


@every_object
def test_size_and_place(name: str) -> None:
    mesh = library.load_library_object(name)
    assert mesh.extents.max() <= LIMIT
    assert mesh.extents.min() >= 0.0025
    assert np.abs(mesh.cog).max() < 1e-12


@every_object
def test_mass_and_tasks(name: str) -> None:
    thing = library.entry(name)
    mesh = library.load_library_object(name)
    assert mesh.mass == thing.mass > 0
    assert 30 < thing.mass / mesh.volume < 12000
    assert len(thing.tasks) == len(set(thing.tasks)) >= 2
    assert set(thing.tasks) <= set(library.TASK_FAMILIES)
    assert thing.name == name == mesh.name
    assert thing.description
    assert "\n" not in thing.description


def test_every_task_family_has_an_object() -> None:
    offered = {task for name in library.names() for task in library.entry(name).tasks}
    assert offered == set(library.TASK_FAMILIES)


@every_object
def test_built_twice_is_the_same(name: str) -> None:
    mesh = library.load_library_object(name)
    vertices, triangles, _ = library.entry(name).build()
    assert vertices.dtype == np.float64
    assert triangles.dtype == np.int64
    assert np.array_equal(vertices, mesh.vertices)
    assert np.array_equal(triangles, mesh.triangles)


def test_another_process_builds_the_same_dolphin() -> None:
    code = (
        "import sys; from preshape.objects.library import entry;"
        "sys.stdout.buffer.write(b''.join(a.tobytes() for a in entry('dolphin').build()))"
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout
    assert other == b"".join(a.tobytes() for a in library.entry("dolphin").build())


def test_importing_the_library_loads_no_geometry_package() -> None:
    code = (
        "import sys, preshape.objects.library as l; l.names(); l.entry('mug');"
        "print([m for m in ('trimesh', 'manifold3d', 'scipy', 'shapely') if m in sys.modules])"
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert other.stdout.strip() == "[]"


def test_cube_is_plain() -> None:
    cube = library.load_library_object("cube")
    assert len(cube.triangles) == 12
    assert len(cube.vertices) == 8
    assert np.allclose(cube.extents, 0.036, rtol=0, atol=1e-15)


def test_dolphin_is_complicated_curved_and_symmetric() -> None:
    dolphin = library.load_library_object("dolphin")
    assert 5000 < len(dolphin.triangles) <= 16000
    length, span, height = dolphin.extents
    assert length > 2 * span > 2 * height * 0.8
    solid = surface("dolphin")
    assert solid.volume < 0.5 * solid.convex_hull.volume  # fins stand out
    x, y, z = dolphin.vertices.T
    assert np.isclose(y.max(), -y.min(), rtol=0, atol=1e-9)
    ends = (x > 0.45 * length) | (x < -0.45 * length)
    assert z[ends].max() < z[np.abs(x) < 0.1 * length].mean()  # arched: nose and tail hang
    assert np.ptp(y[x < -0.4 * length]) > 3 * np.ptp(
        z[x < -0.45 * length]
    )  # flukes lie flat, as a whale's do


def test_scale() -> None:
    plain, double = (library.load_library_object("mug", scale=s) for s in (1.0, 2.0))
    assert np.allclose(double.vertices, 2 * plain.vertices)
    assert plain.mass is not None
    assert double.mass == pytest.approx(8 * plain.mass)
    for bad in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ObjectError, match="scale must be a positive number"):
            library.load_library_object("mug", scale=bad)


def test_unknown_name_lists_the_nearest() -> None:
    with pytest.raises(UnknownObject, match="did you mean hammer") as caught:
        library.load_library_object("hamer")
    assert caught.value.known == library.names()
    assert pickle.loads(pickle.dumps(caught.value)).nearest()[0] == "hammer"  # noqa: S301


def test_entries_and_meshes_cannot_be_changed() -> None:
    mesh = library.load_library_object("sphere")
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0] = 0
    with pytest.raises(AttributeError):
        library.entry("sphere").mass = 2.0  # type: ignore[misc]
