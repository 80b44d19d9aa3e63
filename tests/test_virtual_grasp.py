"""The ray analyser against the paper's numbers, closed forms, and a plain twin made of loops."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from preshape.exceptions import InputError, ObjectError
from preshape.hiis.analyser import Aim, Exploration, HandLayout
from preshape.hiis.fuzzy import FuzzySets, tfvadi
from preshape.hiis.learning import experience_of
from preshape.hiis.planes import PLANES, plane
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.hiis.wrench import screw_measures
from preshape.kernels.rays import MISS, Hits, cast_plain
from preshape.objects.library import load_library_object
from preshape.objects.mesh import TriangleMesh
from preshape.studies.printed import FIG_11, FIG_12, FIG_13
from preshape.types import ContactCoefficients

Array = NDArray[np.float64]

Q1 = (1.0, 1.0, 0.1, 0.05, 0.8, 0.05)
Q2 = (1.0, 1.0, 0.1, 0.8, 0.05, 0.05)
U = 0.043
UTAH = HandLayout(name="utah_mit", u=U, finger_pitch=0.022, fingertip_width=0.014)
SLIM = HandLayout(name="slim", u=U, finger_pitch=0.1 * U, fingertip_width=0.02 * U)
HALF, PITCH = 0.21, 0.14
"""Half-extent of the paper's cube, and the paper's finger pitch, in 4U (PAPER.md §5)."""
PAPER = HandLayout(name="paper", u=U, finger_pitch=PITCH * 4 * U, fingertip_width=0.014)
CRISP = FuzzySets().crisp()

BOX_TRIANGLES = [
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
]  # fmt: skip


def box(
    half: tuple[float, ...], centre: tuple[float, ...] = (0.0, 0.0, 0.0), name: str = "box"
) -> TriangleMesh:
    """A box mesh; half-extents [m]."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return TriangleMesh(
        name=name, vertices=signs * half + np.array(centre), triangles=np.array(BOX_TRIANGLES)
    )


def small_box() -> TriangleMesh:
    """A cube with half-extents of 0.2 U."""
    return box((0.2 * U,) * 3)


def paper_cube() -> TriangleMesh:
    """The cube that the paper's torques fit: an edge of 1.68 U."""
    return box((HALF * 4 * U,) * 3)


def row(found: Exploration, k: int) -> tuple[int, bool, float, int]:
    return int(found.plane[k]), bool(found.flip[k]), round(float(found.value[k]), 9), int(found.fingers[k])


def table(found: Exploration) -> dict[tuple[int, bool, float, int], tuple[Array, float]]:
    made = {row(found, k): (found.wrench[k], float(found.match[k])) for k in range(len(found))}
    assert len(made) == len(found)  # no way of grasping comes twice
    return made


def frame(index: int) -> Array:
    p = plane(index)
    return np.column_stack([p.approach_axis, p.opposition_axis, p.transverse_axis])


# --- the paper's numbers ------------------------------------------------------------------------------

ROWS = {
    "fig. 14 row 1": (5, (0.30, 0.20, 1.0, 0.90), 0.01, (0.86, 1.1, -0.22, -0.03, 0.96, 0.06)),
    # Fig. 14 prints the torque about X without its sign, and fig. 16 prints it with one.
    "fig. 14 row 2": (5, (0.45, 0.30, 1.0, 0.80), 0.01, (1.3, 1.1, -0.27, 0.06, 0.86, 0.11)),
    "fig. 15 rows 3-4": (7, (0.45, 0.30, 1.0, 0.80), 0.08, (0.27, 1.1, 1.3, -0.18, 0.87, 0.05)),
}
"""Plane, coefficients, fingertips' coordinate along the approach in 4U, and the printed net wrench."""


@pytest.mark.parametrize("name", ROWS)
def test_the_papers_net_wrenches_through_the_whole_pipeline(name: str) -> None:
    index, four, x, paper = ROWS[name]
    k = ContactCoefficients(ka=four[0], ko=four[1], kn=four[2], mn=four[3])
    analyser = RayAnalyser(paper_cube(), PAPER, coefficients=k)
    aim = Aim(planes=[index], values=[x / HALF], fingers=[3], flips=[False])
    found = analyser.explore(np.array(Q1), aim)
    assert len(found) == 1
    grasp = found.grasp()
    for wrench in (found.wrench[0], grasp.net_wrench):
        assert np.abs(wrench - paper)[:3].max() <= 0.10 + 1e-9
        assert np.abs(wrench - paper)[3:].max() <= 0.02
        assert (
            np.sign(wrench[np.abs(wrench) > 0.02]).tolist() == np.sign(paper)[np.abs(wrench) > 0.02].tolist()
        )
    assert grasp.contacts.points.shape == (3, 3)
    assert grasp.tfvadi == pytest.approx(grasp.adi.sum())
    assert found.match[0] == pytest.approx(grasp.tfvadi, abs=1e-12)
    assert found.match[0] == pytest.approx(float(tfvadi(Q1, wrench)), abs=1e-12)


@pytest.mark.parametrize(
    ("q", "contacts", "best_planes", "best"),
    [
        (Q1, 3, {5}, 4.786),
        (Q2, 3, {6}, 5.286),
        (FIG_11[0].task, 4, {7}, 4.533),
        (FIG_11[0].task, 3, {7}, 3.755),
        (FIG_11[1].task, 3, {6}, 4.600),
        (FIG_11[2].task, 4, {5}, 4.000),
        (FIG_12[0].task, 3, {6}, 3.957),
        (FIG_12[1].task, 3, {10}, 4.600),
        (FIG_12[2].task, 3, {9}, 4.648),
        (FIG_13[0].task, 2, {4, 11}, 4.000),
        (FIG_13[1].task, 3, {5}, 4.648),
        (FIG_13[2].task, 3, {9}, 3.800),
    ],
)
def test_cross_check_with_the_second_implementation(
    q: tuple[float, ...], contacts: int, best_planes: set[int], best: float
) -> None:
    aim = Aim(values=np.linspace(-1, 1, 41), fingers=[contacts], flips=[False])
    found = RayAnalyser(paper_cube(), PAPER).explore(np.array(q), aim)
    assert found.match[0] == pytest.approx(best, abs=1e-3)
    ties = found.match >= found.match[0] - 1e-9
    assert set(found.plane[ties]) == best_planes


# --- closed forms on boxes ----------------------------------------------------------------------------


@pytest.mark.parametrize("index", range(1, 13))
@pytest.mark.parametrize("flip", [False, True])
def test_every_plane_flip_and_finger_count_on_a_box_in_closed_form(index: int, flip: bool) -> None:
    half = np.array([0.3, 0.5, 0.4]) * U
    mesh = box(tuple(half), centre=(0.3, -0.2, 0.1))
    k = ContactCoefficients(ka=0.4, ko=0.25, kn=1.1, mn=0.7)
    analyser = RayAnalyser(mesh, SLIM, coefficients=k)
    found = table(analyser.explore(np.array(Q1), Aim(planes=[index], values=CRISP, flips=[flip])))
    assert len(found) == 7 * 3
    axes = frame(index)
    half_a, h = np.abs(axes[:, :2].T @ half) / (4 * U)
    side = -1.0 if flip else 1.0
    for (_, _, v, fingers), (wrench, _) in found.items():
        n, x = fingers - 1, v * half_a
        aside = SLIM.finger_pitch / (4 * U) if n == 2 else 0.0  # sum of the fingers' places along t
        force = [(n + 1) * k.ka, side * (n - 1) * k.kn, -(n - 1) * k.ko]
        torque = [
            side * ((n + 1) * h * k.ko - aside * k.kn),
            side * (n - 1) * k.mn + (n - 1) * x * k.ko + aside * k.ka,
            side * (n - 1) * (x * k.kn + h * k.ka),
        ]
        assert axes.T @ wrench[:3] == pytest.approx(force, abs=1e-9)
        assert axes.T @ wrench[3:] == pytest.approx(torque, abs=1e-9)


def test_a_box_turned_by_half_a_turn_gives_the_turned_planes() -> None:
    # Half a turn about o keeps the box and the thumb, and turns plane (a, o) into plane (-a, o).
    analyser = RayAnalyser(box((0.02, 0.03, 0.025)), UTAH)
    found = table(analyser.explore(np.array(Q1), Aim(values=CRISP)))
    by_axes = {(tuple(p.approach_axis), tuple(p.opposition_axis)): p.index for p in PLANES}
    for p in PLANES:
        o = p.opposition_axis
        turn = 2 * np.outer(o, o) - np.eye(3)
        other = by_axes[tuple(-p.approach_axis + 0.0), tuple(o)]
        for flip, v, n in product((False, True), CRISP, (2, 3)):
            here, there = (found[i, flip, round(v, 9), n][0] for i in (p.index, other))
            assert there == pytest.approx(np.concatenate([turn @ here[:3], turn @ here[3:]]), abs=1e-9)


def test_flip_on_a_box_reverses_the_opposition() -> None:
    analyser = RayAnalyser(box((0.02, 0.03, 0.025)), UTAH)
    found = table(analyser.explore(np.array(Q1), Aim(values=CRISP)))
    for (index, flip, v, n), (wrench, _) in found.items():
        if flip:
            continue
        axes, other = frame(index), found[index, True, v, n][0]
        assert axes.T @ other[:3] == pytest.approx((axes.T @ wrench[:3]) * [1, -1, 1], abs=1e-9)
        a, _, t = axes.T @ wrench[3:]
        assert (axes.T @ other[3:])[[0, 2]] == pytest.approx([-a, -t], abs=1e-9)


@pytest.mark.parametrize(
    ("widths", "most"), [(0.5, 2), (1.9, 2), (1.99, 2), (2.01, 3), (2.9, 3), (2.99, 3), (3.01, 4), (9.0, 4)]
)
def test_the_extent_along_t_gives_the_number_of_fingers(widths: float, most: int) -> None:
    # Plane 5: t = Z. Two fingers side by side need two widths of a fingertip, three fingers three.
    mesh = box((0.02, 0.02, widths * UTAH.fingertip_width / 2))
    found = RayAnalyser(mesh, UTAH).explore(np.array(Q1), Aim(planes=[5], values=CRISP))
    assert set(found.fingers) == set(range(2, most + 1))
    assert found.tried == 7 * 2 * 3


def test_fingers_stand_at_the_pitch_where_there_is_room_and_closer_where_not() -> None:
    for depth, aside, three in (
        (0.080, 0.022, True),  # room for all at the hand's pitch
        (0.050, 0.018, True),  # 0.025 - 0.014 / 2
        (0.030, 0.014, False),  # not closer than a fingertip's width
    ):
        analyser = RayAnalyser(box((0.02, 0.02, depth / 2)), UTAH)
        found = analyser.explore(np.array(Q1), Aim(planes=[5], values=[0.0], flips=[False]))
        for k in range(len(found)):
            grasp = found.grasp(k)
            t = grasp.contacts.points @ grasp.plane.transverse_axis
            assert t == pytest.approx([0.0, 0.0, aside, -aside][: grasp.fingers], abs=1e-9)
        assert (4 in found.fingers) == three


def test_each_finger_is_drawn_closer_only_where_its_own_side_is_narrow() -> None:
    # A plate that reaches far along -z and little along +z from the aim at its thick part's middle.
    thick, thin = box((0.02, 0.02, 0.02)), box((0.02, 0.02, 0.02), (0.0, 0.0, -0.04))
    mesh = TriangleMesh(
        name="plate",
        vertices=np.vstack([thick.vertices, thin.vertices]),
        triangles=np.vstack([thick.triangles, thin.triangles + 8]),
    )
    assert mesh.extents[2] == pytest.approx(0.08)
    wedge = RayAnalyser(mesh, UTAH)
    found = wedge.explore(np.array(Q1), Aim(planes=[5], values=[0.0], flips=[False], fingers=[4]))
    t = found.grasp().contacts.points @ np.array([0.0, 0.0, 1.0])
    assert t - mesh.cog[2] == pytest.approx([0.0, 0.0, 0.022, -0.022], abs=1e-9)


# --- the plain twin -----------------------------------------------------------------------------------


def plain_cast(mesh: TriangleMesh, origins: Array, directions: Array) -> Hits:
    with np.errstate(invalid="ignore"):
        return cast_plain(mesh, origins, directions)


def plain_hit(mesh: TriangleMesh, origin: Array, direction: Array) -> tuple[Array, Array] | None:
    """Contact point and inward normal of one ray."""
    hits = plain_cast(mesh, origin[None], direction[None])
    k = int(hits.triangle[0])
    if k == MISS:
        return None
    a, b, c = mesh.vertices[mesh.triangles[k]]
    n = np.cross(b - a, c - a)
    n = n / np.linalg.norm(n)
    return origin + hits.distance[0] * direction, n if n @ direction > 0 else -n


def plain_grasps(
    mesh: TriangleMesh, layout: HandLayout, k: ContactCoefficients, index: int, v: float, flip: bool
) -> dict[int, tuple[Array, Array]]:
    """Finger count -> contact points and net wrench, one ray at a time, from PAPER.md §5."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    cog, half = (low + high) / 2, (high - low) / 2
    a, o = PLANES[index - 1].approach_axis, PLANES[index - 1].opposition_axis
    t = np.cross(a, o)
    half_a, half_o, half_t = (float(np.abs(axis) @ half) for axis in (a, o, t))
    target = cog + v * half_a * a
    # How far the object reaches here along +t and -t: looked at from both sides.
    reach = [half_t, half_t]
    ends = [plain_hit(mesh, target + side * 2 * half_t * t, -side * t) for side in (1.0, -1.0)]
    if ends[0] is not None and ends[1] is not None:
        seen = [(ends[0][0] - target) @ t, (target - ends[1][0]) @ t]
        reach = seen if min(seen) > 0 else reach
    width = layout.fingertip_width
    plus, minus = (min(layout.finger_pitch, max(width, r - width / 2)) for r in reach)
    thumb_side = -o if flip else o
    made: dict[int, tuple[Array, Array]] = {}
    for fingers in (2, 3, 4):
        n = fingers - 1
        if n > 1 and 2 * min(reach) < n * width - 1e-9:
            continue
        aims = [(0.0, thumb_side, 1.0)]
        aims += [(ti, -thumb_side, -1.0) for ti in (0.0, plus, -minus)[:n]]
        net, points = np.zeros(6), []
        for ti, side, s in aims:
            hit = plain_hit(mesh, target + ti * t + 2 * half_o * side, -side)
            if hit is None:
                break
            point, normal = hit
            force = (
                k.kn * normal + k.ka * (a - (a @ normal) * normal) + s * k.ko * (t - (t @ normal) * normal)
            )
            moment = k.mn * normal + np.cross((point - cog) / (4 * layout.u), force)
            net += np.concatenate([force, moment])
            points.append(point)
        else:
            made[fingers] = np.array(points), net
    return made


def tilted(mesh: TriangleMesh) -> TriangleMesh:
    """Turned a little about all axes, so that no ray runs along an edge, where rounding would decide."""
    turn = np.eye(3)
    for i, j, angle in ((0, 1, 0.113), (1, 2, -0.207), (0, 2, 0.151)):
        step = np.eye(3)
        step[[i, i, j, j], [i, j, i, j]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
        turn = turn @ step
    return remade(mesh, mesh.vertices @ turn.T, mesh.triangles)


@pytest.mark.parametrize(
    ("name", "turned"),
    [
        *((name, False) for name in ("cube", "pyramid", "wedge")),
        *((name, True) for name in ("cube", "wedge", "ring", "hammer", "mug")),
    ],
)
def test_the_explorer_equals_its_plain_twin(name: str, turned: bool) -> None:
    mesh = load_library_object(name)
    mesh = tilted(mesh) if turned else mesh
    k = ContactCoefficients()
    q = np.array(Q2)
    values = [0.0137, 0.6421] if len(mesh.triangles) > 2000 else [-0.9173, -0.3519, 0.0137, 0.6421]
    indices = [2, 5, 7, 11] if len(mesh.triangles) > 2000 else [p.index for p in PLANES]
    analyser = RayAnalyser(mesh, UTAH)
    explored = analyser.explore(q, Aim(planes=indices, values=values))
    found = table(explored)
    place = {row(explored, i): i for i in range(len(explored))}
    wanted, exact = 0, []
    for index, v, flip in product(indices, values, (False, True)):
        twin = plain_grasps(mesh, UTAH, k, index, v, flip)
        for fingers in (2, 3, 4):
            key = (index, flip, round(v, 9), fingers)
            assert (key in found) == (fingers in twin), key
            if fingers not in twin:
                continue
            points, net = twin[fingers]
            wanted += 1
            # The analyser may look a micrometre aside, which tells where the surface is steep.
            assert found[key][0] == pytest.approx(net, abs=2e-3), key
            exact.append(np.abs(found[key][0] - net).max() < 1e-7)
            assert found[key][1] == pytest.approx(float(tfvadi(q, found[key][0])), abs=1e-9), key
            if wanted % 5 == 0:
                grasp = explored.grasp(place[key])
                apart = np.linalg.norm(grasp.contacts.points[:, None] - points[None], axis=2)
                assert apart.min(axis=1).max() < 1e-4
                assert apart[0, 0] < 1e-4  # the thumb first
    assert wanted == len(found) > 0
    assert np.mean(exact) > 0.9


@pytest.mark.parametrize("name", ["cube", "mug", "dolphin", "scissors"])
def test_a_grasp_in_full_says_what_the_exploration_said(name: str) -> None:
    mesh = load_library_object(name)
    analyser = RayAnalyser(mesh, UTAH)
    q = np.array(Q1)
    aside = 1e-5 * mesh.extents.max()  # so much may the ray stand beside its aim
    found = analyser.explore(q, Aim(values=CRISP))
    for k in range(0, len(found), max(1, len(found) // 25)):
        g = found.grasp(k)
        assert (g.plane.index, g.flip, round(g.approach_value, 9), g.fingers) == row(found, k)
        assert g.net_wrench == pytest.approx(found.wrench[k], abs=1e-12)
        assert g.contacts.wrenches.sum(axis=0) == pytest.approx(g.net_wrench, abs=1e-12)
        assert g.tfvadi == pytest.approx(found.match[k], abs=1e-9)
        assert g.approach_set == int(np.flatnonzero(np.isclose(CRISP, g.approach_value))[0])
        assert (g.stability, g.manipulability) == screw_measures(g.contacts.wrenches)
        o, t = g.plane.opposition_axis, g.plane.transverse_axis
        side = -o if g.flip else o
        assert np.array_equal(g.thumb_side, side)
        for i, (point, normal, triangle, start) in enumerate(
            zip(
                g.contacts.points,
                g.contacts.normals_in,
                g.contacts.triangles,
                g.ray_origins,
                strict=True,
            )
        ):
            came = side if i == 0 else -side
            assert np.cross(point - start, o) == pytest.approx(np.zeros(3), abs=aside)  # straight along o
            assert (start - mesh.cog) @ came > mesh.extents @ np.abs(o) / 2  # from outside
            assert (start - point) @ came >= 0
            assert np.linalg.norm(normal) == pytest.approx(1)
            assert normal @ came < 0  # inward, whoever wound the triangle
            corners, facet = mesh.corners[triangle], mesh.normals[triangle]
            assert abs((point - corners[0]) @ facet) < 1e-9  # on that triangle's plane
            sides = np.roll(corners, -1, axis=0) - corners
            inside = np.cross(sides, point - corners) @ facet / np.linalg.norm(sides, axis=1)
            assert inside.min() > -aside * 10  # and on that triangle, beside which a ray of the ring may pass
            if inside.min() > aside * 10:  # other facets are too far to count
                assert abs(normal @ facet) == pytest.approx(1)
            assert (point - mesh.cog) @ g.plane.approach_axis == pytest.approx(
                g.approach_value * mesh.extents @ np.abs(g.plane.approach_axis) / 2, abs=aside
            )
        along = (g.contacts.points - mesh.cog) @ t
        assert along[:2] == pytest.approx(0, abs=aside)  # the forefinger stands opposite the thumb
        if g.fingers > 2:
            beside = along[2:] * [1, -1][: g.fingers - 2]
            assert beside.min() >= UTAH.fingertip_width - 2 * aside
            assert beside.max() <= UTAH.finger_pitch + 2 * aside


# --- what must not matter -----------------------------------------------------------------------------


def same(first: Exploration, second: Exploration, tolerance: float = 1e-6) -> None:
    one, other = table(first), table(second)
    assert set(one) == set(other)
    for key, (wrench, match) in one.items():
        assert other[key][0] == pytest.approx(wrench, abs=tolerance), key
        assert other[key][1] == pytest.approx(match, abs=20 * tolerance), key


def remade(mesh: TriangleMesh, vertices: Array, triangles: Array) -> TriangleMesh:
    return TriangleMesh(name=mesh.name, vertices=vertices, triangles=triangles)


@pytest.mark.parametrize("name", ["cube", "wedge", "mug", "hammer"])
@pytest.mark.parametrize("shift", [(0.1, -0.05, 0.02), (10.0, -7.0, 3.0)])
def test_moving_the_mesh_in_its_file_changes_nothing(name: str, shift: tuple[float, ...]) -> None:
    mesh = load_library_object(name)
    moved = remade(mesh, mesh.vertices + shift, mesh.triangles)
    q = np.array(Q1)
    aim = Aim(values=CRISP)
    same(RayAnalyser(mesh, UTAH).explore(q, aim), RayAnalyser(moved, UTAH).explore(q, aim))


@pytest.mark.parametrize("name", ["cube", "wedge", "ring", "hammer"])
def test_a_finer_triangulation_of_the_same_surface_changes_nothing(name: str) -> None:
    mesh = load_library_object(name)
    a, b, c = (mesh.corners[:, k] for k in range(3))
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = np.concatenate(
        [np.stack(x, axis=1) for x in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    )
    finer = remade(mesh, quarters.reshape(-1, 3), np.arange(3 * len(quarters)).reshape(-1, 3))
    q = np.array(Q1)
    aim = Aim(values=CRISP)
    same(RayAnalyser(mesh, UTAH).explore(q, aim), RayAnalyser(finer, UTAH).explore(q, aim))


def cylinder(sides: int, turn: float, radius: float = 0.03, height: float = 0.12) -> TriangleMesh:
    """An upright prism of many sides, turned by ``turn`` facets about z, with a fan on each end."""
    angle = 2 * np.pi * (np.arange(sides) + turn) / sides
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = [np.column_stack([ring, np.full(sides, z)]) for z in (-height / 2, height / 2)]
    vertices = np.vstack([*rings, [[0, 0, -height / 2], [0, 0, height / 2]]])
    k, n = np.arange(sides), np.roll(np.arange(sides), -1)
    parts = [(k, n, n + sides), (k, n + sides, k + sides)]
    parts += [(n, k, np.full(sides, 2 * sides)), (k + sides, n + sides, np.full(sides, 2 * sides + 1))]
    triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return TriangleMesh(name="cylinder", vertices=vertices, triangles=triangles)


@pytest.mark.parametrize("sides", [16, 36])
def test_where_the_facets_of_a_round_object_meet_does_not_matter(sides: int) -> None:
    # Opposite the thumb, the rays hit facets of one cylinder in the middle and edges of the other: with the
    # mean normal both say what the round surface says, and only the radius to a facet's middle differs.
    q, aim = np.array([0.1, 0.1, 1.0, 0.05, 0.05, 0.05]), Aim(values=CRISP, fingers=[2])
    found = [table(RayAnalyser(cylinder(sides, turn), UTAH).explore(q, aim)) for turn in (0.0, 0.5)]
    upright = [key for key in found[0] if not (plane(key[0]).approach_axis[:2].any() and key[2] != 0.0)]
    assert len(upright) > 50
    for key in upright:
        (wrench, match), (other, other_match) = (cylinder_found[key] for cylinder_found in found)
        assert other == pytest.approx(wrench, abs=0.02), key
        assert other_match == pytest.approx(match, abs=0.2), key


@pytest.mark.parametrize("turned", [False, True])
def test_where_facets_meet_the_normal_is_their_mean(turned: bool) -> None:
    # A flat spindle whose tips point at thumb and finger: at a tip four facets meet, at an edge two.
    tip = np.array([[0.0, 0.006, 0.0]])
    base = np.array([[x, 0.0, z] for x in (-0.02, 0.02) for z in (-0.02, 0.02)])
    vertices = np.vstack([tip, -tip, base])
    fan = [[0, 2, 3], [0, 3, 5], [0, 5, 4], [0, 4, 2], [1, 3, 2], [1, 5, 3], [1, 4, 5], [1, 2, 4]]
    mesh = TriangleMesh(name="spindle", vertices=vertices, triangles=np.array(fan))
    mesh = remade(mesh, mesh.vertices, mesh.triangles[:, ::-1]) if turned else mesh
    thumb = RayAnalyser(mesh, UTAH).virtual_grasp(np.array(Q1), 5, False, 0.0, 2).contacts
    assert thumb.points[0] == pytest.approx(tip[0], abs=1e-9)
    assert thumb.normals_in == pytest.approx(np.array([[0, -1, 0], [0, 1, 0]]), abs=1e-9)
    # Turned by an eighth about y, an edge of the spindle lies at v along x, where two facets meet.
    c = np.sqrt(0.5)
    eighth = np.array([[c, 0, c], [0, 1, 0], [-c, 0, c]])
    spindle = remade(mesh, mesh.vertices @ eighth.T, mesh.triangles)
    on_edge = RayAnalyser(spindle, UTAH).virtual_grasp(np.array(Q1), 5, False, 0.5, 2).contacts
    normals = np.array([n for n in spindle.normals * (-1 if turned else 1) if n[0] > 0.1 and n[1] > 0.1])
    assert len(normals) == 2
    mean = -normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
    assert on_edge.normals_in[0] == pytest.approx(mean, abs=1e-6)
    # At a sharp edge, which no finger holds as it holds a round surface, one facet's normal counts.
    sharp = remade(spindle, spindle.vertices * [1.0, 8.0, 1.0], spindle.triangles)
    on_edge = RayAnalyser(sharp, UTAH).virtual_grasp(np.array(Q1), 5, False, 0.5, 2).contacts
    off = np.abs(-sharp.normals @ on_edge.normals_in.T).max(axis=0)
    assert off == pytest.approx(np.ones(2), abs=1e-9)
    # At the rim of a face, the face alone is touched, on every side of the cube alike.
    cube = load_library_object("cube")
    half = cube.extents[0] / 2
    for v in (-1.0, 1.0):
        rim = RayAnalyser(cube, UTAH).virtual_grasp(np.array(Q1), 5, False, v, 2).contacts
        assert rim.points[0] == pytest.approx([v * half, half, 0.0], abs=1e-9)
        assert rim.normals_in == pytest.approx(np.array([[0, -1, 0], [0, 1, 0]]), abs=1e-9)


@pytest.mark.parametrize("name", ["cube", "bowl", "hammer"])
def test_the_winding_of_the_triangles_does_not_matter(name: str) -> None:
    mesh = load_library_object(name)
    inside_out = remade(mesh, mesh.vertices, mesh.triangles[:, ::-1])
    mixed = mesh.triangles.copy()
    mixed[::2] = mixed[::2, ::-1]
    q = np.array(Q1)
    aim = Aim(values=CRISP)
    first = RayAnalyser(mesh, UTAH).explore(q, aim)
    for triangles in (inside_out.triangles, mixed):
        other = RayAnalyser(remade(mesh, mesh.vertices, triangles), UTAH)
        second = other.explore(q, aim)
        same(first, second)
        g, h = first.grasp(), second.grasp()
        assert np.allclose(g.contacts.normals_in, h.contacts.normals_in, atol=1e-12)


def test_no_finger_stands_on_a_lid() -> None:
    """A cube whose -x face only closes a hole: no grasp has a contact there, and all others stay."""
    cube = small_box()
    face = cube.normals[:, 0] < -0.5
    triangles = np.concatenate([cube.triangles[~face], cube.triangles[face]])
    solid = replace(cube, triangles=triangles)
    aim, q = Aim(values=CRISP), np.array(Q1)
    lidded = RayAnalyser(replace(solid, lids=2), UTAH).explore(q, aim)
    found = [table(RayAnalyser(solid, UTAH).explore(q, aim)), table(lidded)]
    across = {key for key in found[0] if abs(plane(key[0]).opposition_axis[0]) > 0.5}
    assert 0 < len(across) < len(found[0])
    assert set(found[1]) == set(found[0]) - across
    for k in range(0, len(lidded), 7):
        assert (lidded.grasp(k).contacts.triangles < 10).all()


def test_the_task_chooses_the_order_and_nothing_else() -> None:
    analyser = RayAnalyser(load_library_object("mug"), UTAH)
    aim = Aim(values=CRISP)
    first, second = analyser.explore(np.array(Q1), aim), analyser.explore(np.array(Q2), aim)
    one, other = table(first), table(second)
    assert set(one) == set(other)
    for key in one:
        assert np.array_equal(one[key][0], other[key][0])
        assert one[key][1] == pytest.approx(float(tfvadi(Q1, one[key][0])), abs=1e-12)
        assert other[key][1] == pytest.approx(float(tfvadi(Q2, one[key][0])), abs=1e-12)
    again = analyser.explore(np.array(Q1), aim)
    for field in ("plane", "flip", "value", "fingers", "wrench", "match"):
        assert np.array_equal(getattr(first, field), getattr(again, field))


def test_what_a_caller_writes_into_a_result_does_not_reach_the_next_one() -> None:
    analyser = RayAnalyser(small_box(), SLIM)
    aim = Aim(values=CRISP)
    first = analyser.explore(np.array(Q1), aim)
    kept = first.wrench.copy()
    for array in (first.wrench, first.plane, first.match):
        if array.flags.writeable:
            array[:] = 0
    assert np.array_equal(analyser.explore(np.array(Q1), aim).wrench, kept)


def test_another_aim_is_not_answered_from_the_last_one() -> None:
    analyser = RayAnalyser(small_box(), SLIM)
    q = np.array(Q1)
    wide = analyser.explore(q, Aim(values=CRISP))
    for aim, keep in (
        (Aim(planes=[5], values=CRISP), wide.plane == 5),
        (Aim(values=CRISP[:3]), wide.value <= CRISP[2]),
        (Aim(values=CRISP, fingers=[3]), wide.fingers == 3),
        (Aim(values=CRISP, flips=[True]), wide.flip),
    ):
        same(analyser.explore(q, aim), wide.where(keep))
        assert analyser.explore(q, Aim(values=CRISP)).tried == wide.tried == 12 * 7 * 2 * 3


# --- order --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["cube", "mug", "ring"])
def test_best_match_first_and_among_equals_the_plainest(name: str) -> None:
    found = RayAnalyser(load_library_object(name), UTAH).explore(np.array(Q1), Aim(values=CRISP))
    keys = [
        (-round(m, 9), round(abs(v), 9), -n, f, p)
        for m, v, n, f, p in zip(
            found.match.tolist(), found.value.tolist(), found.fingers.tolist(), found.flip.tolist(),
            found.plane.tolist(), strict=True,
        )
    ]  # fmt: skip
    assert keys == sorted(keys)
    assert (np.diff(found.match) <= 1e-9).all()


def test_the_order_does_not_depend_on_the_order_of_the_aim() -> None:
    analyser = RayAnalyser(load_library_object("mug"), UTAH)
    q = np.array(Q1)
    first = analyser.explore(q, Aim(values=CRISP))
    second = analyser.explore(
        q, Aim(planes=range(12, 0, -1), values=CRISP[::-1], fingers=[4, 2, 3], flips=[True, False])
    )
    # +v and -v may be equally good; everything else is ordered.
    assert [(r[0], r[1], abs(r[2]), r[3]) for r in (row(first, k) for k in range(len(first)))] == [
        (r[0], r[1], abs(r[2]), r[3]) for r in (row(second, k) for k in range(len(second)))
    ]
    assert row(first, 0) == row(second, 0)


# --- no grasp -----------------------------------------------------------------------------------------


def test_no_grasp_through_the_hole_of_a_ring() -> None:
    # Library ring: tube of 9 mm about a circle of 34 mm, lying flat. Plane 9 comes along X, opposes along Z.
    analyser = RayAnalyser(load_library_object("ring"), UTAH)
    values = np.linspace(-0.99, 0.99, 67)
    found = analyser.explore(np.array(Q1), Aim(planes=[9], values=values, flips=[False]))
    x = np.abs(values) * 43
    hole, tube = x < 24.9, (x > 25.1) & (x < 42.9)
    assert (hole | tube).sum() >= 64
    two = found.where(found.fingers == 2)
    assert not np.isin(values[hole], two.value).any()
    assert np.isin(values[tube], two.value).all()
    assert not np.isin(found.value, values[hole]).any()  # the thumb misses: no count helps
    # Opposed along Y the ring is met everywhere.
    sideways = analyser.explore(np.array(Q1), Aim(planes=[5], values=values, fingers=[2]))
    assert len(sideways) == 2 * len(values)


def test_no_grasp_in_the_empty_corner_of_an_l() -> None:
    # An L in the plane of X and Z: a foot along X, a post along Z at -X. Opposition along Y, approach +X.
    foot = box((0.03, 0.01, 0.01), (0.0, 0.0, -0.02))
    post = box((0.01, 0.01, 0.02), (-0.02, 0.0, 0.01))
    mesh = TriangleMesh(
        name="L",
        vertices=np.vstack([foot.vertices, post.vertices]),
        triangles=np.vstack([foot.triangles, post.triangles + 8]),
    )
    assert mesh.extents == pytest.approx([0.06, 0.02, 0.06])
    values = np.array([-0.95, -0.7, -0.5, -0.36, -0.3, 0.0, 0.3, 0.65, 0.95])
    found = RayAnalyser(mesh, UTAH).explore(np.array(Q1), Aim(planes=[5], values=values, fingers=[2]))
    # The middle height is z = 0: above the foot, so only the post, x < -0.01, v < -1/3, is there.
    assert sorted(set(found.value)) == pytest.approx([-0.95, -0.7, -0.5, -0.36])
    along_z = RayAnalyser(mesh, UTAH).explore(np.array(Q1), Aim(planes=[9], values=values, fingers=[2]))
    assert sorted(set(along_z.value)) == pytest.approx(values.tolist())


def test_one_finger_beside_the_object_is_no_grasp() -> None:
    # A T: wide at +o, where the fingers must not land, narrow at -o. Two of three rays miss the stem's side.
    bar = box((0.02, 0.01, 0.03), (0.0, 0.02, 0.0))
    stem = box((0.02, 0.02, 0.004), (0.0, -0.01, 0.0))
    mesh = TriangleMesh(
        name="T",
        vertices=np.vstack([bar.vertices, stem.vertices]),
        triangles=np.vstack([bar.triangles, stem.triangles + 8]),
    )
    analyser = RayAnalyser(mesh, UTAH)
    found = analyser.explore(np.array(Q1), Aim(planes=[5], values=[0.0]))
    for k in range(len(found)):
        g = found.grasp(k)
        assert np.isfinite(g.contacts.points).all()
        assert (g.contacts.triangles >= 0).all()
        t = np.abs(g.contacts.points @ g.plane.transverse_axis)
        assert t.max() <= 0.03


def test_an_object_that_no_ray_meets_has_no_grasp() -> None:
    # Two small triangles in opposite corners of the bounding box.
    corners = (
        np.array([[-1, -1, -1], [-0.98, -1, -1], [-1, -0.98, -1], [1, 1, 1], [0.98, 1, 1], [1, 0.98, 1]])
        * 0.05
    )
    mesh = TriangleMesh(name="crumbs", vertices=corners, triangles=np.array([[0, 1, 2], [3, 4, 5]]))
    found = RayAnalyser(mesh, UTAH).explore(np.array(Q1), Aim(values=CRISP))
    assert len(found) == 0
    assert found.wrench.shape == (0, 6)
    assert found.tried == 12 * 7 * 2 * 3


def test_a_contact_lies_on_the_object_beside_a_wall_along_the_ray() -> None:
    # A plate and, on it, a fin that leans by a hundred-thousandth. The ray passes a few micrometres beside
    # the fin and lands on the plate: 20 mm of air above it are no contact.
    size = 0.06
    plate = box((size / 2, 0.005, size / 2))
    for lean, aside in product((1e-5, 1e-4, 1e-3), np.linspace(-2e-6, 2e-6, 9)):
        top = 0.025
        fin = [[aside, 0.005, -size / 2], [aside, 0.005, size / 2], [aside - lean * 0.02, top, 0.0]]
        mesh = TriangleMesh(
            name="fin",
            vertices=np.vstack([plate.vertices, fin]),
            triangles=np.vstack([plate.triangles, [[8, 9, 10]]]),
        )
        analyser = RayAnalyser(mesh, UTAH)
        found = analyser.explore(np.array(Q1), Aim(planes=[5, 1], values=[0.0]))
        for k in range(len(found)):
            contacts = found.grasp(k).contacts
            for point, triangle in zip(contacts.points, contacts.triangles, strict=True):
                corners = mesh.corners[triangle]
                slack = 1e-4 * size
                assert (point >= corners.min(axis=0) - slack).all(), (lean, aside)
                assert (point <= corners.max(axis=0) + slack).all(), (lean, aside)


# --- refusals -----------------------------------------------------------------------------------------


@settings(derandomize=True, deadline=None, max_examples=100)
@given(
    sizes=st.tuples(*[st.one_of(st.floats(0.01, 10.0), st.floats(0.1715, 0.1745))] * 3),
    u=st.sampled_from([0.043, 0.0545, 0.0243]),
)
def test_over_4u_is_refused_with_extent_limit_and_hand_and_never_with_a_scale_that_fits(
    sizes: tuple[float, ...], u: float
) -> None:
    mesh = box(tuple(s / 2 for s in sizes), name="crate")
    layout = HandLayout(name="some_hand", u=u, finger_pitch=0.022, fingertip_width=0.014)
    limit = 4 * u
    if mesh.extents.max() <= limit:
        RayAnalyser(mesh, layout)
        return
    if mesh.extents.max() <= limit * (1 + 1e-6):
        return
    with pytest.raises(ObjectError) as refused:
        RayAnalyser(mesh, layout)
    text = str(refused.value)
    assert "crate" in text
    assert "some_hand" in text
    axis = re.search(r"along ([xyz])", text)
    assert axis is not None
    assert mesh.extents["xyz".index(axis[1])] == mesh.extents.max()
    extent, most = (float(x) for x in re.findall(r"([\d.]+) mm", text)[:2])
    assert extent == pytest.approx(mesh.extents.max() * 1000, abs=0.51)
    assert most == pytest.approx(limit * 1000, abs=0.51)
    assert extent > most  # "172 mm, over the 172 mm" helps nobody
    for factor in re.findall(r"--scale ([\d.]+)", text):
        assert float(factor) in (1000.0, 100.0, 39.3701)  # the reverse of a unit
    if mesh.extents.max() <= 5 * limit:
        assert "--analyser closure" in text  # the size is plausible


def test_exactly_4u_is_accepted() -> None:
    RayAnalyser(box((2 * U, 0.02, 0.02)), UTAH)


@pytest.mark.parametrize(
    ("aim", "message"),
    [
        ({"planes": [0]}, r"1 to 12, got \[0\]"),
        ({"planes": [5, 13]}, r"1 to 12"),
        ({"fingers": [1]}, r"2 to 4, got \[1\]"),
        ({"fingers": [2, 5]}, r"2 to 4"),
        ({"values": [1.5]}, r"-1\.\.1"),
        ({"values": [np.nan]}, r"-1\.\.1"),
    ],
)
def test_an_aim_that_does_not_exist_is_refused(aim: dict[str, list[float]], message: str) -> None:
    whole = {"planes": [5], "values": [0.0], "fingers": [2], "flips": [False], **aim}
    with pytest.raises(InputError, match=message):
        RayAnalyser(small_box(), SLIM).explore(np.array(Q1), Aim(**whole))  # type: ignore[arg-type]


def test_an_empty_aim_finds_nothing() -> None:
    analyser = RayAnalyser(small_box(), SLIM)
    for aim in (
        Aim(planes=[], values=CRISP),
        Aim(values=[]),
        Aim(values=CRISP, fingers=[]),
        Aim(values=CRISP, flips=[]),
    ):
        assert len(analyser.explore(np.array(Q1), aim)) == 0


# --- what is stored, and what is asked for outside the last aim -----------------------------------------


@pytest.mark.parametrize(
    ("largest", "units"),
    [(0.1721, ""), (0.5, ""), (1.5, "--unit cm makes it 15 ×"), (9.0, "--unit mm makes it 9 ×")],
)
def test_of_an_object_far_beyond_4u_the_unit_that_fits_is_named(largest: float, units: str) -> None:
    with pytest.raises(ObjectError) as refused:
        RayAnalyser(box((largest / 2, 0.1 * largest, 0.1 * largest)), UTAH)
    assert units in str(refused.value)
    assert ("check the unit of the file" in str(refused.value)) == bool(units)


def test_rays_start_twice_the_half_extent_away_on_the_side_of_their_finger() -> None:
    analyser = RayAnalyser(box((0.02, 0.03, 0.025), centre=(0.1, 0.2, 0.3)), UTAH)
    for index, flip in product((1, 5, 6, 9), (False, True)):
        grasp = analyser.virtual_grasp(np.array(Q1), index, flip, 0.25, 3)
        o = grasp.plane.opposition_axis
        away = (grasp.ray_origins - analyser.mesh.cog) @ grasp.thumb_side
        assert away == pytest.approx(2 * (np.abs(o) @ [0.02, 0.03, 0.025]) * np.array([1, -1, -1]))


def test_recalled_grasps_are_those_that_were_stored_in_their_order() -> None:
    analyser = RayAnalyser(load_library_object("mug"), UTAH)
    q = np.array(Q1)
    sets = FuzzySets()
    stored = []
    for index, flip, v, fingers in ((5, False, 0.25, 3), (2, True, -0.65, 2), (8, False, 0.0, 2)):
        grasp = analyser.virtual_grasp(q, index, flip, v, fingers)
        stored.append(experience_of(analyser, "mug", "task", q, grasp, sets, analyser.mesh.attributes))
    # Plane 9 aims through the ring's hole, where there is nothing to grasp.
    gone = replace(stored[0], approach_value=0.0, plane=9, fingers=4)
    for found, e in zip(analyser.recall(q, stored), stored, strict=True):
        assert (found.plane.index, found.flip, found.approach_value, found.fingers) == (
            e.plane, e.flip, e.approach_value, e.fingers,
        )  # fmt: skip
        assert np.allclose(found.net_wrench, e.wrench, atol=1e-12)
    ring = RayAnalyser(load_library_object("ring"), UTAH)
    assert ring.recall(q, [gone]) == []


@pytest.mark.parametrize("values", [[0.25], [-0.65, 0.0, 0.25], [0.25, 0.65]])
def test_a_grasp_in_full_is_the_same_whether_or_not_its_aim_was_explored(values: list[float]) -> None:
    mesh, q = load_library_object("hammer"), np.array(Q1)
    explored, fresh = RayAnalyser(mesh, UTAH), RayAnalyser(mesh, UTAH)
    explored.explore(q, Aim(planes=[3, 7, 5], values=values))
    for index, v in ((5, 0.25), (3, 0.25), (7, values[-1]), (5, 0.1), (11, 0.25)):
        one, other = (pa.virtual_grasp(q, index, False, v, 2) for pa in (explored, fresh))
        assert np.array_equal(one.net_wrench, other.net_wrench)
        assert np.array_equal(one.contacts.points, other.contacts.points)
