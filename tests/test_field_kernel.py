"""The object's distance field and exact surface queries against brute force, and what breaks a cache."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from preshape.exceptions import InputError
from preshape.kernels.field import plain as field_numpy
from preshape.kernels.field.host import DistanceField, SurfaceQuery, prepare_field
from preshape.kernels.surface_points import surface_points
from preshape.objects.library import load_library_object
from preshape.objects.load import load_object
from preshape.objects.mesh import TriangleMesh
from preshape.objects.winding import oriented_triangles, with_turned
from preshape.spatial import rotation_from_vector
from preshape.types import Array


def made(vertices: Array, triangles: Array, name: str = "made") -> TriangleMesh:
    return TriangleMesh(name=name, vertices=vertices, triangles=triangles)


def box(half: tuple[float, float, float] = (0.03, 0.02, 0.01), centre: float = 0.0) -> TriangleMesh:
    signs = np.array(list(np.ndindex(2, 2, 2))) * 2.0 - 1
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = [t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])]
    mesh = made(signs * half + centre, np.array(triangles), "box")
    assert mesh.volume > 0
    return mesh


def box_distance(half: tuple[float, float, float], points: Array) -> Array:
    q = np.abs(points) - half
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


def around(mesh: TriangleMesh, count: int, room: float = 0.015, seed: int = 0) -> Array:
    low, high = mesh.bounds
    return np.random.default_rng(seed).uniform(low - room, high + room, (count, 3))


def nodes_of(field: DistanceField, count: int, seed: int = 0) -> tuple[Array, Array]:
    """Some nodes of a field: positions and values."""
    chosen = np.random.default_rng(seed).integers(0, field.distance.shape, (count, 3))
    return field.origin + field.spacing * chosen, field.distance[tuple(chosen.T)].astype(float)


def on_device(field: DistanceField, points: Array) -> tuple[Array, Array]:
    """Distance and gradient by the kernel."""
    import warp as wp

    from preshape.kernels.field import warp as warp_field

    distance = wp.zeros(len(points), dtype=float, device="cpu")
    gradient = wp.zeros(len(points), dtype=wp.vec3, device="cpu")
    wp.launch(
        warp_field.sample_field,
        dim=len(points),
        inputs=[
            wp.array(field.distance, dtype=float, device="cpu"),
            wp.vec3(*field.origin.tolist()),
            1.0 / field.spacing,
            wp.array(points.astype(np.float32), dtype=wp.vec3, device="cpu"),
            distance,
            gradient,
        ],
        device="cpu",
    )
    return distance.numpy().astype(float), gradient.numpy().astype(float)


def check_nodes(field: DistanceField, at: Array, value: Array, true: Array) -> None:
    """Exact near the surface; beyond, of the same sign, no larger, and not much smaller."""
    near = np.abs(true) < max(7 * field.spacing, 0.01)
    assert near.any()
    assert np.abs(value - true)[near].max() < 1e-6
    assert (np.sign(value) == np.sign(true))[np.abs(true) > 1e-6].all()
    assert (np.abs(value) < np.abs(true) + 1e-6).all()
    assert (np.abs(value) > 0.93 * np.abs(true) - 2 * field.spacing).all()


# The grid


@pytest.mark.parametrize("cells", [8, 33, 64, 100])
def test_a_box_has_the_distances_of_a_box(cells: int) -> None:
    half = (0.03, 0.02, 0.01)
    field = prepare_field(box(half), cells=cells, cache=None)
    assert max(field.distance.shape) == cells
    assert field.spacing == pytest.approx(0.1 / (cells - 1))
    assert (field.bounds[0] <= np.array(half) * -1 - 0.02 + 1e-9).all()
    assert (field.bounds[1] >= np.array(half) + 0.02 - 1e-9).all()
    at = field.origin + field.spacing * np.argwhere(np.ones(field.distance.shape))
    check_nodes(field, at, field.distance.ravel().astype(float), box_distance(half, at))


@pytest.mark.parametrize("name", ["sphere", "ring", "wedge", "key", "padlock"])
def test_nodes_of_a_library_object_agree_with_brute_force(name: str) -> None:
    mesh = load_library_object(name)
    field = prepare_field(mesh, cells=64, cache=None)
    at, value = nodes_of(field, 300)
    check_nodes(field, at, value, field_numpy.closest_plain(mesh, at).distance)


def test_the_middle_of_a_ball_is_its_radius_deep() -> None:
    mesh = load_library_object("sphere")
    field = prepare_field(mesh, cache=None)
    depth = -field_numpy.field_distance(field, mesh.cog[None])[0]
    assert 0.026 < depth <= 0.03


@pytest.mark.parametrize("name", ["ring", "mug"])
def test_far_from_the_surface_the_field_is_a_lower_bound(name: str) -> None:
    mesh = load_library_object(name)
    field = prepare_field(mesh, cells=64, cache=None)
    points = around(mesh, 20_000, room=0.3)
    true = SurfaceQuery(mesh).closest(points).distance
    value = field_numpy.field_distance(field, points)
    far = np.abs(true) > 3 * field.spacing
    assert (np.abs(value) <= 1.05 * np.abs(true))[far].all()
    assert (np.sign(value) == np.sign(true))[far].all()
    off = ((points < field.bounds[0]) | (points > field.bounds[1])).any(axis=1)
    assert off.any()
    assert (value <= true + 0.05 * field.spacing)[off].all()
    # From the grid's middle a corner of its box is seen at 55 degrees: the bound loses a third at most there.
    assert (value >= 0.6 * true)[off].all()


def test_the_field_is_continuous_across_the_edge_of_the_grid() -> None:
    field = prepare_field(load_library_object("ring"), cells=32, cache=None)
    rng = np.random.default_rng(0)
    points = rng.uniform(*field.bounds, (300, 3))
    axis, side = rng.integers(0, 3, 300), rng.integers(0, 2, 300)
    points[np.arange(300), axis] = field.bounds[side, axis]
    step = np.zeros((300, 3))
    step[np.arange(300), axis] = (2 * side - 1) * 1e-6
    inside, outside = (field_numpy.field_distance(field, points + s) for s in (-step, step))
    assert np.abs(inside - outside).max() < 3e-6


def test_kernel_and_plain_version_agree_in_the_grid_and_off_it() -> None:
    mesh = load_library_object("padlock")
    field = prepare_field(mesh, cells=48, cache=None)
    points = around(mesh, 5000, room=0.05).astype(np.float32).astype(float)
    distance, gradient = on_device(field, points)
    assert np.abs(distance - field_numpy.field_distance(field, points)).max() < 1e-6
    plain = field_numpy.field_gradient(field, points)
    # In single precision a point beside a node may fall into the next cell, where the slope is another.
    cell = (points - field.origin) / field.spacing
    clear = np.abs(cell - cell.round()).min(axis=1) > 1e-3
    assert clear.mean() > 0.9
    assert np.abs(gradient - plain)[clear].max() < 1e-3
    assert np.linalg.norm(gradient, axis=1) == pytest.approx(np.ones(5000), abs=1e-5)


def test_the_gradient_is_the_slope_of_the_distance() -> None:
    mesh = load_library_object("padlock")
    field = prepare_field(mesh, cells=48, cache=None)
    points = around(mesh, 2000, room=0.05)
    cell = (points - field.origin) / field.spacing
    points = points[np.abs(cell - cell.round()).min(axis=1) > 1e-3]
    step = 1e-4 * field.spacing
    slope = np.stack(
        [
            field_numpy.field_distance(field, points + step * e)
            - field_numpy.field_distance(field, points - step * e)
            for e in np.eye(3)
        ],
        axis=1,
    )
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    assert np.abs(slope - field_numpy.field_gradient(field, points)).max() < 1e-4


def test_a_flat_field_has_no_gradient() -> None:
    field = DistanceField(origin=np.zeros(3), spacing=0.1, distance=np.ones((3, 3, 3)), digest="")
    point = np.array([[0.11, 0.12, 0.13]])
    assert (field_numpy.field_gradient(field, point) == 0).all()
    assert (on_device(field, point)[1] == 0).all()


# The same surface, otherwise written


def test_a_rigid_motion_moves_the_distances_with_it() -> None:
    mesh = load_library_object("wedge")
    rotation, shift = rotation_from_vector([0.4, -1.1, 0.7]), np.array([0.5, -0.3, 0.2])
    moved = made(mesh.vertices @ rotation.T + shift, mesh.triangles)
    points = around(mesh, 3000)
    here = SurfaceQuery(mesh).closest(points)
    there = SurfaceQuery(moved).closest(points @ rotation.T + shift)
    assert np.abs(here.distance - there.distance).max() < 1e-5  # needles of triangles, in single precision
    fields = [prepare_field(m, cells=64, cache=None) for m in (mesh, moved)]
    a = field_numpy.field_distance(fields[0], points)
    b = field_numpy.field_distance(fields[1], points @ rotation.T + shift)
    near = np.abs(here.distance) < 0.005
    assert np.abs(a - b)[near].max() < 0.5 * max(f.spacing for f in fields)
    assert np.median(np.abs(a - b)[near]) < 0.05 * fields[0].spacing


def test_other_triangles_of_the_same_surface_give_the_same_field() -> None:
    mesh = load_library_object("ring")
    middle = mesh.corners.mean(axis=1)
    a, b, c = mesh.triangles.T
    m = len(mesh.vertices) + np.arange(len(mesh.triangles))
    finer = made(
        np.concatenate([mesh.vertices, middle]),
        np.concatenate([np.stack(t, axis=1) for t in ((a, b, m), (b, c, m), (c, a, m))]),
    )
    first, second = (prepare_field(o, cells=48, cache=None) for o in (mesh, finer))
    assert first.digest != second.digest
    near = np.abs(first.distance) < 0.01
    assert np.abs(first.distance - second.distance)[near].max() < 1e-6
    assert ((first.distance < 0) == (second.distance < 0))[np.abs(first.distance) > 1e-5].all()


@pytest.mark.parametrize("kind", ["scattered", "patch"])
def test_holes_leave_the_sign_alone_away_from_them(kind: str) -> None:
    mesh = load_library_object("pear")
    count = len(mesh.triangles)
    rng = np.random.default_rng(3)
    middles = mesh.corners.mean(axis=1)
    if kind == "scattered":
        gone = rng.permutation(count)[: count // 20]
    else:
        gone = np.argsort(np.linalg.norm(middles - middles[rng.integers(count)], axis=1))[: count // 20]
    left = np.ones(count, dtype=bool)
    left[gone] = False
    open_mesh = made(mesh.vertices, mesh.triangles[left])
    field = prepare_field(open_mesh, cells=48, cache=None)
    at, value = nodes_of(field, 3000)
    true = SurfaceQuery(mesh).closest(at).distance
    if kind == "scattered":
        away = np.abs(true) > 0.001
    else:
        hole = middles[gone].mean(axis=0)
        size = np.linalg.norm(middles[gone] - hole, axis=1).max()
        away = np.linalg.norm(at - hole, axis=1) > 1.5 * size
    assert away.sum() > 1000
    assert (true[away] < 0).sum() > 100
    assert (np.sign(value) == np.sign(true))[away].all()


@pytest.mark.parametrize("kind", ["some turned", "all turned", "most turned"])
def test_careless_winding_changes_nothing(kind: str) -> None:
    mesh = load_library_object("padlock")
    share = {"some turned": 0.3, "all turned": 1.0, "most turned": 0.8}[kind]
    turned = np.random.default_rng(0).random(len(mesh.triangles)) < share
    wild = made(mesh.vertices, np.where(turned[:, None], mesh.triangles[:, ::-1], mesh.triangles))
    points = around(mesh, 2000)
    right, ours = SurfaceQuery(mesh).closest(points), SurfaceQuery(wild).closest(points)
    assert np.abs(ours.distance - right.distance).max() < 1e-6
    same = ours.triangle == right.triangle
    assert same.mean() > 0.5
    assert np.abs(ours.normal_out - right.normal_out)[same].max() < 1e-4
    spots, normals = surface_points(wild, 0.004, 0)
    assert (SurfaceQuery(mesh).closest(spots + 1e-4 * normals).distance > 0).mean() > 0.99


def test_a_cavity_stays_hollow_and_a_second_body_turned_inside_out_becomes_solid() -> None:
    outer, inner, beside = box((0.03,) * 3), box((0.01,) * 3), box((0.01,) * 3, centre=0.06)
    vertices = np.concatenate([m.vertices for m in (outer, inner, beside)])
    triangles = np.concatenate(
        [outer.triangles, inner.triangles[:, ::-1] + 8, beside.triangles[:, ::-1] + 16]
    )
    found = SurfaceQuery(made(vertices, triangles)).closest([[0, 0, 0], [0, 0, 0.02], [0.06, 0.06, 0.06]])
    assert found.distance == pytest.approx([0.01, -0.01, -0.01], abs=1e-6)


def test_a_consistent_mesh_is_left_as_it_is() -> None:
    mesh = load_library_object("mug")
    assert oriented_triangles(mesh) is mesh.triangles


# Exact queries


@pytest.mark.parametrize("name", ["wedge", "ring", "scissors"])
def test_closest_points_agree_with_brute_force(name: str) -> None:
    mesh = load_library_object(name)
    points = around(mesh, 300)
    ours, plain = SurfaceQuery(mesh).closest(points), field_numpy.closest_plain(mesh, points)
    assert np.abs(ours.distance - plain.distance).max() < 1e-6
    assert np.abs(np.linalg.norm(points - ours.point, axis=1) - np.abs(plain.distance)).max() < 1e-6
    # The point lies on the triangle that is named.
    a, normal = mesh.corners[ours.triangle, 0], mesh.normals[ours.triangle]
    assert np.abs(np.einsum("ij,ij->i", ours.point - a, normal)).max() < 1e-6
    assert np.linalg.norm(ours.normal_out, axis=1) == pytest.approx(np.ones(300), abs=1e-5)
    same = ours.triangle == plain.triangle
    assert same.mean() > 0.5
    assert np.abs(ours.normal_out - plain.normal_out)[same].max() < 1e-3
    # Outward is where the signed distance grows.
    step = 1e-4
    further = SurfaceQuery(mesh).closest(ours.point + step * ours.normal_out).distance
    assert (further > 0).mean() > 0.99


def test_both_sides_of_a_single_sheet_are_outside() -> None:
    sheet = made(
        np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    found = SurfaceQuery(sheet).closest([[0.05, 0.04, 0.01], [0.05, 0.04, -0.01]])
    assert found.distance == pytest.approx([0.01, 0.01], abs=1e-7)
    assert found.normal_out[:, 2] == pytest.approx([1, -1])


def test_queries_at_the_ends_of_the_range() -> None:
    query = SurfaceQuery(box())
    assert query.closest(np.zeros((0, 3))).distance.shape == (0,)
    assert query.closest([[100.0, 0, 0]]).distance == pytest.approx([99.97])
    with pytest.raises(InputError, match="n×3"):
        query.closest([1.0, 2.0, 3.0])
    tiny = box((3e-5, 4e-5, 5e-5))
    assert SurfaceQuery(tiny).closest([[0.0, 0.0, 0.0]]).distance == pytest.approx([-3e-5], rel=1e-3)


# Points of the surface


@pytest.mark.parametrize("name", ["wedge", "plate", "key"])
def test_surface_points_cover_the_surface_evenly(name: str) -> None:
    mesh, spacing = load_library_object(name), 0.003
    points, normals = surface_points(mesh, spacing, 1)
    found = SurfaceQuery(mesh).closest(points)
    # In single precision the nearest point of a needle of a triangle is some hundredths of a millimetre off.
    assert np.abs(found.distance).max() < 5e-5
    assert np.quantile(np.abs(found.distance), 0.95) < 1e-6
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(points)))
    outside = SurfaceQuery(mesh).closest(points + 1e-4 * normals).distance
    assert (outside > 0).mean() > 0.995
    # Wherever one lands on the surface, a point of the same side is near.
    rng = np.random.default_rng(9)
    face = rng.choice(len(mesh.areas), 5000, p=mesh.areas / mesh.areas.sum())
    spot = np.einsum("nk,nkd->nd", rng.dirichlet([1, 1, 1], 5000), mesh.corners[face])
    tree = cKDTree(points)
    near = tree.query_ball_point(spot, 1.2 * spacing)
    alike = [(normals[i] @ mesh.normals[f] > -0.5).any() for i, f in zip(near, face, strict=True)]
    assert np.mean(alike) > 0.999
    assert len(points) < 1.5 * mesh.area / spacing**2 + 0.5 * len(points)
    again = surface_points(mesh, spacing, 1)
    assert (again[0] == points).all()
    assert surface_points(mesh, spacing, 2)[0].tolist() != points.tolist()


def test_surface_points_have_the_corners_and_keep_their_distance() -> None:
    mesh = box()
    points, normals = surface_points(mesh, 0.004, 0)
    assert {tuple(p) for p in points[:8]} == {tuple(v) for v in mesh.vertices}
    assert np.abs(normals[:8] - np.sign(points[:8]) / 3**0.5).max() < 1e-9
    gap = np.linalg.norm(points[:, None] - points[None], axis=2) + np.eye(len(points))
    alike = normals @ normals.T > -0.5
    assert gap[alike].min() >= 0.8 * 0.004
    assert len(points) == pytest.approx(mesh.area / 0.004**2, rel=0.35)
    for spacing in (0.0, -1.0, float("nan"), 1e-7):
        with pytest.raises(InputError, match="spacing must be"):
            surface_points(mesh, spacing, 0)


# Settings and the cache


@pytest.mark.parametrize("cells", [7, 513, 64.0, True])
def test_cells_out_of_range_are_refused(cells: object) -> None:
    with pytest.raises(InputError, match="cells must be a whole number"):
        prepare_field(box(), cells=cells, cache=None)  # type: ignore[arg-type]


@pytest.mark.parametrize("padding", [-0.01, float("nan"), float("inf")])
def test_padding_out_of_range_is_refused(padding: float) -> None:
    with pytest.raises(InputError, match="padding must be"):
        prepare_field(box(), padding=padding, cache=None)


def small(cache: Path | None, **settings: float) -> DistanceField:
    return prepare_field(box(), cells=12, cache=cache, **settings)  # type: ignore[arg-type]


def same(a: DistanceField, b: DistanceField) -> bool:
    return (
        bool((a.distance == b.distance).all() and (a.origin == b.origin).all())
        and a.spacing == b.spacing
        and a.digest == b.digest
    )


def test_the_cache_gives_back_what_was_put_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = small(tmp_path)
    (file,) = (tmp_path / "fields").iterdir()
    assert file.name == f"{first.digest}.npz"
    with monkeypatch.context() as blocked:
        blocked.setattr("preshape.kernels.field.host._fill", None)
        assert same(small(tmp_path), first)
        assert not small(tmp_path).distance.flags.writeable
    assert small(tmp_path, padding=0.03).digest != first.digest
    other = prepare_field(box((0.03, 0.02, 0.0100001)), cells=12, cache=tmp_path)
    assert other.digest != first.digest
    assert len(list((tmp_path / "fields").iterdir())) == 3


def test_the_cache_gives_back_which_triangles_are_wound_the_wrong_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def mesh() -> TriangleMesh:
        one = box((0.03, 0.02, 0.01))
        turned = np.isin(np.arange(len(one.triangles)), (2, 5))
        return replace(one, triangles=with_turned(one.triangles, turned))

    prepare_field(mesh(), cells=12, cache=tmp_path)
    right = oriented_triangles(mesh())
    known = mesh()
    assert (right != known.triangles).any(axis=1).sum() == 2
    monkeypatch.setattr("preshape.objects.winding.turned", None)
    prepare_field(known, cells=12, cache=tmp_path)
    np.testing.assert_array_equal(oriented_triangles(known), right)


def test_the_users_cache_is_used_by_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path))
    made_field = prepare_field(box(), cells=12)
    assert (tmp_path / "fields" / f"{made_field.digest}.npz").is_file()


def test_a_damaged_cache_is_made_anew(tmp_path: Path) -> None:
    right = small(None)
    file = tmp_path / "fields" / f"{right.digest}.npz"
    small(tmp_path)
    whole = file.read_bytes()
    rng = np.random.default_rng(0)
    for trial in range(60):
        damaged = bytearray(whole)
        if trial < 20:
            damaged = damaged[: rng.integers(len(whole))]
        else:
            damaged[rng.integers(len(whole))] ^= 1 << int(rng.integers(8))
        file.write_bytes(bytes(damaged))
        assert same(small(tmp_path), right)
    file.write_bytes(b"")
    assert same(small(tmp_path), right)
    assert file.read_bytes() == whole


def test_another_fields_file_under_this_name_is_not_taken(tmp_path: Path) -> None:
    right, other = small(tmp_path), small(tmp_path, padding=0.03)
    folder = tmp_path / "fields"
    (folder / f"{right.digest}.npz").write_bytes((folder / f"{other.digest}.npz").read_bytes())
    assert same(small(tmp_path), right)


def test_an_unusable_cache_is_none(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    assert same(small(tmp_path / "file"), small(None))


PROGRAM = """
import os, signal, sys
from pathlib import Path
from tests_box import box
from preshape.kernels.field.host import prepare_field
if sys.argv[2] == "kill":
    Path.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
for cells in (12, 13, 14):
    print(prepare_field(box, cells=cells, cache=Path(sys.argv[1])).distance.sum())
"""


def program(tmp_path: Path, how: str) -> subprocess.Popen[str]:
    arrays = f"vertices={box().vertices.tolist()}, triangles={box().triangles.tolist()}"
    (tmp_path / "tests_box.py").write_text(
        f"from preshape.objects.mesh import TriangleMesh\nbox = TriangleMesh(name='box', {arrays})\n"
    )
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n{PROGRAM}"
    return subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path), how], stdout=subprocess.PIPE, text=True
    )


def test_two_processes_share_a_cache_and_a_killed_one_leaves_it_sound(tmp_path: Path) -> None:
    killed = program(tmp_path, "kill")
    killed.communicate(timeout=60)
    assert killed.returncode == -9
    folder = tmp_path / "fields"
    assert [file.name.startswith(".") for file in folder.iterdir()] == [True]
    both = [program(tmp_path, "run") for _ in range(2)]
    said = [process.communicate(timeout=60)[0] for process in both]
    assert [process.returncode for process in both] == [0, 0]
    assert said[0] == said[1]
    assert said[0].splitlines()[0] == str(small(tmp_path).distance.sum())
    assert len([file for file in folder.iterdir() if not file.name.startswith(".")]) == 3


# Scans


@pytest.mark.parametrize("name", ["padlock", "mug", "tennis_ball"])
def test_fields_of_scans_agree_with_exact_queries(name: str, reference: Path) -> None:
    mesh = load_object(reference / "ycb" / f"{name}.obj")
    assert mesh.extents.max() < 0.12
    field = prepare_field(mesh, cache=None)
    query = SurfaceQuery(mesh)
    at, value = nodes_of(field, 3000)
    check_nodes(field, at, value, query.closest(at).distance)
    rng = np.random.default_rng(0)
    face = rng.choice(len(mesh.areas), 5000, p=mesh.areas / mesh.areas.sum())
    spot = np.einsum("nk,nkd->nd", rng.dirichlet([1, 1, 1], 5000), mesh.corners[face])
    step = rng.normal(size=spot.shape)
    points = spot + step * (0.005 * rng.random((5000, 1)) / np.linalg.norm(step, axis=1, keepdims=True))
    error = np.abs(field_numpy.field_distance(field, points) - query.closest(points).distance)
    # A wall thinner than the spacing (2.5 mm) is what the grid cannot show: the mug's is 3 mm.
    middle, tail = {"padlock": (0.05, 0.45), "mug": (0.1, 1.1), "tennis_ball": (0.03, 0.12)}[name]
    assert np.median(error) < middle / 1000
    assert np.quantile(error, 0.99) < tail / 1000
    assert error.max() < 0.6 * field.spacing


def test_what_field_and_queries_share_is_made_once_for_each_mesh() -> None:
    mesh = load_library_object("box")
    again = replace(mesh)
    assert SurfaceQuery(mesh).mesh is SurfaceQuery(mesh).mesh
    assert SurfaceQuery(again).mesh is not SurfaceQuery(mesh).mesh
    assert oriented_triangles(mesh) is oriented_triangles(mesh)
