"""First hits: Embree, its NumPy twin, and a third computation by signed volumes, on meshes of every kind."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from preshape.kernels.field.host import SurfaceQuery
from preshape.kernels.rays import MISS, Hits, RayCaster, cast_plain
from preshape.objects.mesh import TriangleMesh

Array = NDArray[np.float64]
Cast = Callable[[TriangleMesh, Array, Array], Hits]

BOX_TRIANGLES = [
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
]  # fmt: skip


def mesh_of(vertices: Array, triangles: object, name: str = "thing") -> TriangleMesh:
    return TriangleMesh(name=name, vertices=np.asarray(vertices), triangles=np.array(triangles))


def box(half: tuple[float, float, float] = (0.02, 0.03, 0.05)) -> TriangleMesh:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return mesh_of(signs * half, BOX_TRIANGLES, "box")


def icosphere(radius: float = 0.05, rounds: int = 2) -> TriangleMesh:
    g = (1 + 5**0.5) / 2
    v = [[s, t * g, 0] for s in (-1, 1) for t in (-1, 1)]
    v += [[0, s, t * g] for s in (-1, 1) for t in (-1, 1)]
    v += [[t * g, 0, s] for s in (-1, 1) for t in (-1, 1)]
    vertices = np.array(v, dtype=np.float64)
    near = np.linalg.norm(vertices[:, None] - vertices[None], axis=2) < 2.1
    triangles = [
        [i, j, k]
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    corners = vertices[np.array(triangles)]
    for _ in range(rounds):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        corners = np.concatenate(
            [np.stack(x, axis=1) for x in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    corners = corners / np.linalg.norm(corners, axis=2, keepdims=True) * radius
    flat, index = np.unique(corners.reshape(-1, 3).round(15), axis=0, return_inverse=True)
    return mesh_of(flat, index.reshape(-1, 3), "icosphere")


def torus(major: float = 0.04, minor: float = 0.015, n: int = 20, m: int = 10) -> TriangleMesh:
    u, v = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    ring = major + minor * np.cos(v)
    vertices = np.stack([ring * np.cos(u), ring * np.sin(u), minor * np.sin(v)], axis=2).reshape(-1, 3)
    triangles = []
    for i in range(n):
        for j in range(m):
            a, b = i * m + j, (i + 1) % n * m + j
            c, d = i * m + (j + 1) % m, (i + 1) % n * m + (j + 1) % m
            triangles += [[a, b, d], [a, d, c]]
    return mesh_of(vertices, triangles, "torus")


def soup(seed: int, count: int = 60) -> TriangleMesh:
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-0.05, 0.05, (count, 1, 3))
    corners = middle + rng.normal(0, 0.02, (count, 3, 3))
    return mesh_of(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), "soup")


MESHES = {"icosphere": icosphere(), "torus": torus(), "soup": soup(1), "other soup": soup(2), "box": box()}
every_mesh = pytest.mark.parametrize("name", MESHES)


def random_rays(mesh: TriangleMesh, count: int, seed: int) -> tuple[Array, Array]:
    """Rays from around the mesh and from inside it, aimed near its middle."""
    rng = np.random.default_rng(seed)
    size = mesh.extents.max()
    origins = rng.normal(size=(count, 3))
    origins *= (rng.uniform(0, 2, count) * size / np.linalg.norm(origins, axis=1))[:, None]
    aims = rng.uniform(-0.6, 0.6, (count, 3)) * mesh.extents
    directions = aims - origins
    return mesh.cog + origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def by_signed_volumes(mesh: TriangleMesh, origins: Array, directions: Array) -> tuple[Array, Array]:
    """Distance and clearance of the first hits: a ray meets a triangle when it passes all edges on one side.

    The clearance is how far, in parts of the triangle, the first hit is from an edge, and how far the nearest
    near-miss is from being a hit: where it is tiny, rounding decides and nothing can be asked.
    """
    a, b, c = (mesh.corners[:, k] for k in range(3))
    distance, clearance = np.full(len(origins), np.inf), np.full(len(origins), np.inf)
    for i, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        va, vb, vc = a - origin, b - origin, c - origin
        w = np.stack([np.cross(vb, vc), np.cross(vc, va), np.cross(va, vb)]) @ direction
        total = w.sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            inside = (w / total).min(axis=0)
            t = (w[0, :, None] * va + w[1, :, None] * vb + w[2, :, None] * vc) @ direction / total
        met = (inside > 0) & (t > 0)
        if met.any():
            distance[i] = t[met].min()
        close = (t > 0) & (t <= distance[i] * (1 + 1e-6))
        clearance[i] = np.abs(inside[close]).min(initial=np.inf)
    return distance, clearance


def embree(mesh: TriangleMesh, origins: Array, directions: Array) -> Hits:
    return RayCaster(mesh).cast(origins, directions)


def plain(mesh: TriangleMesh, origins: Array, directions: Array) -> Hits:
    return cast_plain(mesh, origins, directions)


def on_device(mesh: TriangleMesh, origins: Array, directions: Array) -> Hits:
    return SurfaceQuery(mesh).cast(origins, directions)


both = pytest.mark.parametrize("cast", [embree, plain])
every_cast = pytest.mark.parametrize("cast", [embree, plain, on_device])


def lies_on_its_triangle(
    mesh: TriangleMesh, origins: Array, directions: Array, hits: Hits, slack: float
) -> None:
    """Barycentric coordinates of every hit, by least squares, in 0..1."""
    for o, d, t, k in zip(origins, directions, hits.distance, hits.triangle, strict=True):
        if k == MISS:
            continue
        a, b, c = mesh.corners[k]
        solution = np.linalg.lstsq(np.column_stack([b - a, c - a]), o + t * d - a, rcond=None)[0]
        foot = a + np.column_stack([b - a, c - a]) @ solution
        assert np.linalg.norm(foot - (o + t * d)) <= 1e-9 * np.linalg.norm(mesh.extents)
        assert solution.min() >= -slack
        assert solution.sum() <= 1 + slack


@every_mesh
@every_cast
def test_equals_an_independent_computation(name: str, cast: Cast) -> None:
    mesh = MESHES[name]
    origins, directions = random_rays(mesh, 300, 11)
    wanted, clearance = by_signed_volumes(mesh, origins, directions)
    sure = clearance > 1e-4
    assert sure.mean() > 0.95
    assert np.isfinite(wanted[sure]).sum() > 20
    hits = cast(mesh, origins, directions)
    assert np.array_equal(np.isfinite(hits.distance[sure]), np.isfinite(wanted[sure]))
    assert np.array_equal(np.isfinite(hits.distance), hits.triangle != MISS)
    met = sure & np.isfinite(wanted)
    assert np.allclose(hits.distance[met], wanted[met], rtol=1e-9, atol=1e-12)
    lies_on_its_triangle(mesh, origins, directions, hits, 1e-4)


@every_mesh
def test_embree_equals_its_twin(name: str) -> None:
    mesh = MESHES[name]
    origins, directions = random_rays(mesh, 500, 12)
    _, clearance = by_signed_volumes(mesh, origins, directions)
    sure = clearance > 1e-4
    fast, slow = embree(mesh, origins, directions), plain(mesh, origins, directions)
    assert np.array_equal(fast.triangle[sure], slow.triangle[sure])
    assert np.allclose(fast.distance[sure], slow.distance[sure], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("size", [1e-3, 1.0])
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (10.0, -10.0, 10.0)])
@both  # on the device, vertices are in single precision and in the frame of the object
def test_tiny_and_far_objects_are_hit_as_well(size: float, place: tuple[float, ...], cast: Cast) -> None:
    base = icosphere(0.5)
    mesh = mesh_of(base.vertices * size + place, base.triangles)
    origins, directions = random_rays(base, 300, 13)
    near = cast(base, origins, directions)
    _, clearance = by_signed_volumes(base, origins, directions)
    sure = clearance > 1e-4
    far = cast(mesh, origins * size + place, directions)
    assert np.array_equal(far.triangle[sure], near.triangle[sure])
    met = sure & (near.triangle != MISS)
    # 10 m away, a double knows a millimetre to 1e-12 of it.
    assert np.allclose(far.distance[met], near.distance[met] * size, rtol=1e-9, atol=2e-14)


def axis_rays(mesh: TriangleMesh, steps: int) -> tuple[Array, Array, Array]:
    """Rays along every signed axis onto a grid over the face: corners, edges, both diagonals."""
    half = mesh.extents / 2
    grid = np.linspace(-1, 1, steps)
    origins, directions, depth = [], [], []
    for k in range(3):
        i, j = (q for q in range(3) if q != k)
        for sign in (1.0, -1.0):
            direction = np.zeros(3)
            direction[k] = -sign
            for u in grid:
                for v in (u, -u, 0.0, 1.0, -1.0):
                    origin = np.zeros(3)
                    origin[[k, i, j]] = 3 * sign * half[k], u * half[i], v * half[j]
                    origins.append(mesh.cog + origin)
                    directions.append(direction)
                    depth.append(2 * half[k])
    return np.array(origins), np.array(directions), np.array(depth)


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (0.013, -0.21, 5.3)])
@every_cast
def test_rays_exactly_on_the_diagonals_and_edges_of_a_box_hit_it(
    shift: tuple[float, ...], cast: Cast
) -> None:
    plain_box = box()
    mesh = mesh_of(plain_box.vertices + shift, plain_box.triangles)
    origins, directions, depth = axis_rays(mesh, 41)
    on_outline = (np.abs(np.abs(origins - mesh.cog) - mesh.extents / 2) < 1e-9).any(axis=1)
    hits = cast(mesh, origins, directions)
    assert (hits.triangle[~on_outline] != MISS).all()  # nothing leaks between the two halves of a face
    met = hits.triangle != MISS
    if not any(shift):
        assert met.all()  # the outline itself belongs to the box
    assert np.allclose(hits.distance[met], depth[met], rtol=0, atol=1e-12 + 1e-14 * np.abs(shift).max())
    along = np.einsum("ij,ij->i", mesh.normals[hits.triangle[met]], directions[met])
    assert along == pytest.approx(-np.ones(met.sum()))  # the face that is looked at, never one seen edge-on


def test_no_ray_from_inside_leaks_out_through_an_edge() -> None:
    rng = np.random.default_rng(6)
    for mesh in (box(), icosphere(rounds=1), torus()):
        if mesh.name == "torus":
            inside = np.repeat([[0.04, 0.0, 0.0]], 900, axis=0)
            choice = rng.integers(len(mesh.triangles), size=900)
        else:
            inside = rng.uniform(-0.1, 0.1, (900, 3)) * mesh.extents
            choice = rng.integers(len(mesh.triangles), size=900)
        corners = mesh.corners[choice]
        share = rng.random((900, 1))
        share[:100] = 0  # exactly at a vertex
        targets = corners[:, 0] + share * (corners[:, 1] - corners[:, 0])
        length = np.linalg.norm(targets - inside, axis=1)
        directions = (targets - inside) / length[:, None]
        for cast in (embree, plain):
            hits = cast(mesh, inside, directions)
            assert (hits.triangle != MISS).all()
            assert (hits.distance <= length * (1 + 1e-5)).all()


@every_cast
def test_misses(cast: Cast) -> None:
    mesh = icosphere()
    origins = np.array([[0, 0, 0.2], [0, 0, 0.2], [0.2, 0, 0.0501], [0.2, 0, 0]], dtype=np.float64)
    directions = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [1, 0, 0]], dtype=np.float64)
    hits = cast(mesh, origins, directions)
    assert (hits.triangle == MISS).all()
    assert np.isposinf(hits.distance).all()
    none = cast(mesh, np.zeros((0, 3)), np.zeros((0, 3)))
    assert none.distance.shape == none.triangle.shape == (0,)


@every_cast
def test_through_the_hole_of_a_torus(cast: Cast) -> None:
    mesh = torus()
    x = np.linspace(-0.06, 0.06, 49)
    origins = np.column_stack([x, np.zeros(49), np.full(49, 0.1)])
    hits = cast(mesh, origins, np.tile([0.0, 0.0, -1.0], (49, 1)))
    hole, tube = np.abs(x) < 0.0245, (np.abs(x) > 0.0255) & (np.abs(x) < 0.0545)
    assert (hits.triangle[hole | (np.abs(x) > 0.0555)] == MISS).all()
    assert (hits.triangle[tube] != MISS).all()


@every_cast
def test_the_nearest_of_many_parallel_sheets(cast: Cast) -> None:
    heights = np.random.default_rng(4).permutation(np.linspace(-0.05, 0.05, 40))
    sheet = np.array([[-1, -1], [1, -1], [0, 2]]) * 0.05
    corners = np.array([[[x, y, h] for x, y in sheet] for h in heights])
    mesh = mesh_of(corners.reshape(-1, 3), np.arange(120).reshape(-1, 3))
    start = np.linspace(-0.052, 0.049, 37)
    up = cast(mesh, np.column_stack([np.zeros((37, 2)), start]), np.tile([0.0, 0.0, 1.0], (37, 1)))
    for z, t, k in zip(start, up.distance, up.triangle, strict=True):
        assert z + t == pytest.approx(heights[heights > z].min(), abs=1e-12)
        assert heights[k] == pytest.approx(z + t, abs=1e-12)


@pytest.mark.parametrize("slope", [1e-2, 1e-3, 1e-4, 1e-5, 4e-6])
@every_cast
def test_a_grazing_hit_lies_on_its_triangle(slope: float, cast: Cast) -> None:
    # A ray that sinks by `slope` onto a plate: it lands where the geometry says, or slips over the end.
    mesh = box((0.05, 0.05, 0.005))
    y = np.linspace(-0.04, 0.04, 9)
    land = np.linspace(-0.04, 0.04, 9)
    direction = np.array([1.0, 0.0, -slope])
    direction /= np.linalg.norm(direction)
    origins = np.column_stack([np.full(9, -0.2), y, 0.005 + (land + 0.2) * slope])
    hits = cast(mesh, origins, np.tile(direction, (9, 1)))
    assert (hits.triangle != MISS).all()
    found = origins + hits.distance[:, None] * direction
    assert found[:, 0] == pytest.approx(land, abs=1e-9)
    assert found[:, 2] == pytest.approx(np.full(9, 0.005), abs=1e-12)


@every_cast
def test_a_hit_never_lies_outside_the_object(cast: Cast) -> None:
    # Rays that almost touch: wherever rounding lets one hit, the hit must still be on the object.
    mesh = MESHES["icosphere"]
    rng = np.random.default_rng(9)
    edges = np.unique(np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    for slope in (1e-2, 1e-4, 1e-5, 3e-6):
        pick = edges[rng.integers(len(edges), size=200)]
        p = mesh.vertices[pick].mean(axis=1)
        out = p / np.linalg.norm(p, axis=1, keepdims=True)
        along = np.cross(out, rng.normal(size=(200, 3)))
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        directions = along - slope * out
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        origins = p - 0.2 * directions
        hits = cast(mesh, origins, directions)
        met = hits.triangle != MISS
        points = (origins + np.where(met, hits.distance, 0.0)[:, None] * directions)[met]
        assert (np.linalg.norm(points, axis=1) <= 0.05 * (1 + 1e-4)).all()


@every_cast
def test_a_face_seen_edge_on_does_not_hide_what_is_behind_it(cast: Cast) -> None:
    # A fin that leans by less than a millionth stands over a plate: the ray passes it and lands on the plate.
    lean = 5e-7
    plate = [[-1, -1, 0], [1, -1, 0], [0, 2, 0]]
    fin = [[0, -1, 0.1], [0, 1, 0.1], [lean, 0, 1.1]]
    mesh = mesh_of(np.array([*plate, *fin]), [[0, 1, 2], [3, 4, 5]])
    down = np.array([[0.0, 0.0, -1.0]])
    hits = cast(mesh, np.array([[lean / 4, 0.0, 3.0]]), down)
    assert hits.triangle.tolist() == [0]
    assert hits.distance == pytest.approx([3.0])


def test_a_ray_in_the_plane_of_a_face_raises_no_warning() -> None:
    # Axis-aligned rays along the faces of a box are what the analyser casts all day.
    mesh = box()
    half = mesh.extents / 2
    origins = np.array([[half[0], 0, 0.2], [half[0], half[1], 0.2], [half[0], 0.01, 0.2]])
    hits = cast_plain(mesh, origins, np.tile([0.0, 0.0, -1.0], (3, 1)))
    assert np.isfinite(hits.distance).all()


def test_a_caster_can_be_used_again_and_leaves_its_arguments_alone() -> None:
    mesh = torus()
    caster = RayCaster(mesh)
    origins, directions = random_rays(mesh, 50, 3)
    copies = origins.copy(), directions.copy()
    first, second = caster.cast(origins, directions), caster.cast(origins, directions)
    assert np.array_equal(first.distance, second.distance)
    assert np.array_equal(first.triangle, second.triangle)
    assert np.array_equal(origins, copies[0])
    assert np.array_equal(directions, copies[1])
    backwards = caster.cast(origins[::-1], directions[::-1])
    assert np.array_equal(backwards.distance[::-1], first.distance)
