"""The closing kernel against its plain version, against MuJoCo, and against what closing means."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from preshape.closure.candidates import Region, draw_candidates
from preshape.closure.hand_tables import hand_tables, link_shapes
from preshape.closure.preshapes import posture_at, preshapes
from preshape.hands.kinematics import HandKinematics, LinkShape
from preshape.hands.load import load_hand
from preshape.kernels.chains import fingertips, joint_frames, rotations
from preshape.kernels.closing.host import Candidates, ClosingKernel, Closings, Fate, Obstacles
from preshape.kernels.closing.plain import FAR, clearances_plain, close_plain, link_distances_plain
from preshape.kernels.field.host import DistanceField, prepare_field
from preshape.kernels.field.plain import field_distance
from preshape.kernels.hand_spheres import COARSE, FINE, exposed
from preshape.kernels.tables import HandTables
from preshape.objects.library import load_library_object
from preshape.objects.mesh import TriangleMesh
from preshape.types import Array

HANDS = ("shadow", "allegro", "leap", "utah_mit", "shadow:left")
TOLERANCE = 1e-4


@cache
def field_of(name: str) -> DistanceField:
    return prepare_field(load_library_object(name), cells=48, cache=None)


@cache
def candidates(hand: str, name: str, count: int, seed: int = 0) -> Candidates:
    mesh = load_library_object(name)
    pool = preshapes(load_hand(hand), 32)
    rng = np.random.default_rng(seed)
    return draw_candidates(rng, pool, mesh.bounds.mean(axis=0), mesh.extents / 2, count, Region()).candidates


@cache
def closed(hand: str, name: str, count: int) -> Closings:
    kernel = ClosingKernel(hand_tables(load_hand(hand)), field_of(name))
    return kernel.close(candidates(hand, name, count))


def posture(hand: str, seed: int, count: int) -> Array:
    model = load_hand(hand)
    low, high = model.ranges().T
    return model.follow(np.random.default_rng(seed).uniform(low, high, (count, len(low))))


def spheres_at(tables: HandTables, q: Array) -> Array:
    """(n, s, 3) centres of the fingers' spheres in the palm frame."""
    places, turns = joint_frames(tables, q)
    joint = np.repeat(np.arange(len(tables.axis)), np.diff(tables.sphere_start))
    return places[:, joint] + np.einsum("nsij,sj->nsi", turns[:, joint], tables.sphere[:, :3])


def finger_distance(tables: HandTables, field: DistanceField, at: Candidates, closing: Array) -> Array:
    """(n, f) least distance of each finger's spheres, fingers at ``closing`` (n, f), without any shortcut."""
    local = spheres_at(tables, posture_at(tables, at.start, closing))
    x = at.place[:, None] + np.einsum("nij,nsj->nsi", rotations(at.turn), local)
    d = field_distance(field, x.reshape(-1, 3)).reshape(x.shape[:2]) - tables.sphere[:, 3]
    return np.minimum.reduceat(d, tables.sphere_start[tables.joint_start[:-1]], axis=1)


def shape_distance(shape: LinkShape, points: Array) -> Array:
    local = (points - (shape.p0 + shape.p1) / 2) @ shape.rotation
    if shape.hull is not None:
        return (local @ shape.hull.planes[:, :3].T - shape.hull.planes[:, 3]).max(axis=1)
    if shape.kind == "box":
        out = np.abs(local) - shape.half
        return np.linalg.norm(np.maximum(out, 0), axis=1) + np.minimum(out.max(axis=1), 0)
    half = np.linalg.norm(shape.p1 - shape.p0) / 2
    local[:, 2] -= np.clip(local[:, 2], -half, half)
    return np.linalg.norm(local, axis=1) - shape.radius


# Kernel and plain version


@pytest.mark.parametrize(
    ("hand", "name"),
    [
        ("shadow", "mug"),
        ("shadow", "ring"),
        ("allegro", "ring"),
        ("leap", "cube"),
        ("leap", "mug"),
        ("utah_mit", "mug"),
        ("shadow:left", "cube"),
    ],
)
def test_kernel_and_plain_version_close_alike(hand: str, name: str) -> None:
    tables, field, count = hand_tables(load_hand(hand)), field_of(name), 150
    fast = closed(hand, name, count)
    plain = close_plain(tables, field, candidates(hand, name, count))
    assert (fast.fate == plain.fate).mean() >= 0.995
    same = (fast.fate == plain.fate) & (fast.fate == Fate.CLOSED)
    assert same.sum() > 20
    assert (fast.counts == plain.counts)[same].all()
    assert ((fast.sphere >= 0) == (plain.sphere >= 0))[same].all()
    used = (fast.sphere >= 0) & same[:, None]
    away = np.abs(fast.closing - plain.closing)[used]
    assert (away < 1e-3).mean() >= 0.995
    assert np.median(away) < 1e-5
    filled = same[:, None] & (np.arange(8) < plain.counts[:, None])
    apart = np.linalg.norm(fast.points - plain.points, axis=2)[filled]
    assert (apart < 2e-4).mean() >= 0.995
    facing = np.einsum("nij,nij->ni", fast.normals_in, plain.normals_in)[filled]
    assert (facing > 0.999).mean() >= 0.99


@pytest.mark.parametrize("hand", ["shadow", "leap"])
def test_kernel_and_plain_version_agree_with_clearances_and_another_tolerance(hand: str) -> None:
    tables, field = hand_tables(load_hand(hand)), field_of("mug")
    given = candidates(hand, "mug", 120)
    how = {"clearance": 0.002, "palm_clearance": 0.004, "tolerance": 3e-5, "wanted": 2}
    fast, plain = ClosingKernel(tables, field).close(given, **how), close_plain(tables, field, given, **how)
    assert (fast.fate == plain.fate).mean() >= 0.99
    same = (fast.fate == plain.fate) & (fast.fate == Fate.CLOSED)
    assert same.sum() > 20
    assert np.quantile(np.abs(fast.closing - plain.closing)[same], 0.995) < 1e-3
    distance = finger_distance(tables, field, given, fast.closing)[same]
    touching = fast.sphere[same] >= 0
    assert distance[touching].min() > 0.002 - 1e-6
    assert distance[touching].max() < 0.002 + 3 * 3e-5 + 1e-6


@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize("detail", [COARSE, FINE])
def test_clearances_agree_with_the_plain_version(hand: str, detail: float) -> None:
    tables, field = hand_tables(load_hand(hand), detail), field_of("mug")
    at, q = candidates(hand, "mug", 24), posture(hand, 1, 24)
    rest = Obstacles(
        planes=np.array([[0.0, 0.0, 1.0, -0.2], [0.6, 0.8, 0.0, -0.22]]),
        boxes=np.array([[[0.1, 0.1, -0.1], [0.14, 0.2, 0.1]]]),
    )
    kernel = ClosingKernel(tables, field)
    for obstacles in (None, rest):
        fast = kernel.clearances(at.place, at.turn, q, obstacles)
        plain = clearances_plain(tables, field, at.place, at.turn, q, obstacles)
        assert np.abs(fast[0] - plain[0]).max() < 2e-6
        assert np.abs(fast[1] - plain[1]).max() < 1e-6 * (1e6 if obstacles is None else 2)
        near = kernel.clearances(at.place, at.turn, q, obstacles, enough=0.004)
        for whole, clipped in zip(fast, near, strict=True):
            np.testing.assert_array_equal(clipped, np.minimum(whole, np.float32(0.004)))
    # The hands are spread over both sides of what is to be kept out.
    assert np.ptp(fast[1]) > 0.05


@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize("detail", [COARSE, FINE])
def test_link_distances_agree_with_the_plain_version(hand: str, detail: float) -> None:
    tables, field = hand_tables(load_hand(hand), detail), field_of("mug")
    # The last joint loses its spheres: a link may be without any.
    spheres, groups = int(tables.sphere_start[-2]), int(tables.group_start[-2])
    tables = replace(
        tables,
        sphere_start=np.append(tables.sphere_start[:-1], spheres),
        sphere=tables.sphere[:spheres],
        speed=tables.speed[:spheres],
        group_start=np.append(tables.group_start[:-1], groups),
        group_sphere=tables.group_sphere[: groups + 1],
        bound=tables.bound[:groups],
        bound_speed=tables.bound_speed[:groups],
    )
    at, q = candidates(hand, "mug", 40), posture(hand, 2, 40)
    kernel = ClosingKernel(tables, field)
    distance, sphere = kernel.link_distances(at.place, at.turn, q)
    plain, nearest = link_distances_plain(tables, field, at.place, at.turn, q)
    assert distance.shape == sphere.shape == (40, len(tables.axis) + 1)
    np.testing.assert_array_equal(sphere < 0, nearest < 0)
    np.testing.assert_array_equal(sphere < 0, distance == FAR)
    np.testing.assert_allclose(distance, plain, atol=2e-6)
    assert (distance < 0.0).any()
    # Two spheres may be equally near; the one named is as near as the nearest.
    assert (sphere == nearest).mean() > 0.98
    centre = at.place[:, None] + np.einsum("nij,nsj->nsi", rotations(at.turn), spheres_at(tables, q))
    d = field_distance(field, centre.reshape(-1, 3)).reshape(centre.shape[:2]) - tables.sphere[:, 3]
    rows, columns = np.nonzero(sphere[:, :-1] >= 0)
    np.testing.assert_allclose(d[rows, sphere[rows, columns]], distance[rows, columns], atol=2e-6)
    # The fingers and the palm of ``clearances`` are the nearest of these links.
    whole = kernel.clearances(at.place, at.turn, q)[0]
    fingers = np.minimum.reduceat(distance[:, :-1], tables.joint_start[:-1], axis=1)
    np.testing.assert_array_equal(whole, np.column_stack([fingers, distance[:, -1:]]))
    near, which = kernel.link_distances(at.place, at.turn, q, enough=0.004)
    inside = distance < 0.004
    np.testing.assert_array_equal(near[inside], distance[inside])
    np.testing.assert_array_equal(which, np.where(inside, sphere, -1))
    np.testing.assert_array_equal(near[~inside], np.where(distance[~inside] == FAR, FAR, np.float32(0.004)))
    asked = np.random.default_rng(0).random(distance.shape) < 0.5
    part, which = kernel.link_distances(at.place, at.turn, q, asked=asked)
    np.testing.assert_array_equal(part, np.where(asked, distance, FAR))
    np.testing.assert_array_equal(which, np.where(asked, sphere, -1))


# The tables


@pytest.mark.parametrize("hand", HANDS)
def test_frames_of_the_tables_are_those_of_mujoco(hand: str) -> None:
    model, tables = load_hand(hand), hand_tables(load_hand(hand))
    kinematics = HandKinematics(model)
    postures = posture(hand, 0, 12)
    places, turns = joint_frames(tables, postures)
    tips = fingertips(tables, postures)
    in_order = tuple(model.finger(name) for name in tables.fingers)
    assert tables.fingers[tables.thumb] == model.fingers[0].name
    for k, q in enumerate(postures):
        kinematics.set_posture(q)
        data = kinematics._data
        assert np.abs(places[k] - data.xanchor).max() < 1e-9
        assert np.abs(np.einsum("jab,jb->ja", turns[k], tables.axis) - data.xaxis).max() < 1e-9
        assert np.abs(tips[k] - kinematics.tips(in_order)[0]).max() < 1e-9


@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize("detail", [COARSE, FINE])
def test_no_sphere_stands_out_of_the_hand(hand: str, detail: float) -> None:
    """Against the shapes where MuJoCo puts them, link by link."""
    model, tables = load_hand(hand), hand_tables(load_hand(hand), detail)
    kinematics = HandKinematics(model)
    q = posture(hand, 2, 1)
    kinematics.set_posture(q[0])
    shapes = kinematics.shapes()
    carrier = dict.fromkeys({shape.body for shape in shapes}, -1)
    for body in carrier:
        carries = kinematics._moves[kinematics.model.body(body).id]
        carrier[body] = int(np.flatnonzero(carries)[-1]) if carries.any() else -1
    centres = spheres_at(tables, q)[0]
    for joint in range(-1, len(tables.axis)):
        own = [shape for shape in shapes if carrier[shape.body] == joint]
        part = slice(tables.sphere_start[joint], tables.sphere_start[joint + 1])
        x, radius = (centres[part], tables.sphere[part, 3])
        if joint < 0:
            x, radius = tables.palm[:, :3], tables.palm[:, 3]
        assert bool(len(x)) == bool(own)
        if own:
            least = np.min([shape_distance(shape, x) for shape in own], axis=0)
            assert (least + radius).max() < 1e-9


@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize(
    ("detail", "box", "capsule"), [(COARSE, 0.003, 0.001), (FINE, 0.0005, 0.00015)], ids=["coarse", "fine"]
)
def test_the_hand_stands_out_of_its_spheres_by_no_more_than_stated(
    hand: str, detail: float, box: float, capsule: float
) -> None:
    from scipy.spatial import cKDTree

    tables = hand_tables(load_hand(hand), detail)
    for joint, shapes in enumerate(link_shapes(load_hand(hand))):
        if not shapes:
            continue
        spheres = tables.palm
        if joint < len(tables.axis):
            spheres = tables.sphere[tables.sphere_start[joint] : tables.sphere_start[joint + 1]]
        # Other points than the spheres were chosen by.
        spacing = 0.0011 if detail == COARSE else 0.0017
        points, allowed = exposed(shapes, detail, spacing)
        gap = np.full(len(points), np.inf)
        for radius in np.unique(spheres[:, 3].round(9)):
            row = spheres[np.abs(spheres[:, 3] - radius) < 1e-8]
            gap = np.minimum(gap, cKDTree(row[:, :3]).query(points)[0] - radius)
        on_box = allowed > box / 2
        assert gap[~on_box].max(initial=0.0) <= capsule
        assert gap[on_box].max(initial=0.0) <= box


@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize("detail", [COARSE, FINE])
def test_groups_hold_their_spheres(hand: str, detail: float) -> None:
    tables = hand_tables(load_hand(hand), detail)
    for starts, bounds, spheres in (
        (tables.group_sphere, tables.bound, tables.sphere),
        (tables.palm_group, tables.palm_bound, tables.palm),
    ):
        assert (np.diff(starts) > 0).all()
        assert (starts[0], starts[-1]) == (0, len(spheres))
        around = np.repeat(bounds, np.diff(starts), axis=0)
        reach = np.linalg.norm(spheres[:, :3] - around[:, :3], axis=1) + spheres[:, 3]
        assert (reach <= around[:, 3] + 1e-12).all()
    assert (tables.group_sphere[tables.group_start] == tables.sphere_start).all()
    assert (np.maximum.reduceat(tables.speed, tables.group_sphere[:-1]) == tables.bound_speed).all()


@pytest.mark.parametrize("hand", HANDS)
def test_no_sphere_moves_faster_than_its_bound(hand: str) -> None:
    tables = hand_tables(load_hand(hand))
    rng = np.random.default_rng(5)
    n, fingers = 400, len(tables.fingers)
    start = posture(hand, 6, n)
    first = rng.uniform(0.0, 1.0, (n, 1)) * np.ones(fingers)
    second = np.clip(first + rng.choice([1e-3, 0.03, 0.3], (n, 1)), 0.0, 1.0)
    moved = spheres_at(tables, posture_at(tables, start, second)) - spheres_at(
        tables, posture_at(tables, start, first)
    )
    length = np.linalg.norm(moved, axis=2)
    allowed = tables.speed * (second - first)[:, :1]
    assert (length <= allowed + 1e-12).all()
    # Nor is the bound idle: some sphere of every finger comes within a third of it.
    share = (length / np.maximum(allowed, 1e-9)).max(axis=0)
    for f in range(fingers):
        part = slice(*tables.sphere_start[tables.joint_start[f : f + 2]])
        assert share[part].max() > 0.33


# What closing means


@pytest.mark.parametrize(
    ("hand", "name"),
    [("shadow", "mug"), ("allegro", "ring"), ("leap", "mug"), ("utah_mit", "ring"), ("shadow:left", "ring")],
)
def test_fingers_stop_at_their_first_touch(hand: str, name: str) -> None:
    tables, field = hand_tables(load_hand(hand)), field_of(name)
    every, found = candidates(hand, name, 200), closed(hand, name, 200)
    rows = np.flatnonzero(found.fate == Fate.CLOSED)[:24]
    at, closing = every.take(rows), found.closing[rows]
    touching = found.sphere[rows] >= 0
    distance = finger_distance(tables, field, at, closing)
    assert distance[touching].min() > -2e-6
    assert distance[touching].max() < 3 * TOLERANCE + 2e-6
    used = (at.mask[:, None] >> np.arange(len(tables.fingers))) & 1 == 1
    assert not (touching & ~used).any()
    # Unused fingers, and those that touch nothing, are left open; the latter find nothing all the way.
    assert (closing[~touching] == 0).all()
    deepest = np.inf
    for share in np.linspace(0.0, 1.0, 161):
        here = np.where(touching, share * closing, np.where(used, share, 0.0))
        deepest = min(deepest, float(finger_distance(tables, field, at, here).min()))
    assert deepest > -TOLERANCE


@pytest.mark.parametrize("hand", ["shadow", "allegro"])
def test_contacts_lie_on_the_surface_and_face_the_finger(hand: str) -> None:
    tables, field, given = hand_tables(load_hand(hand)), field_of("mug"), candidates(hand, "mug", 300)
    found = closed(hand, "mug", 300)
    rows = np.flatnonzero(found.fate == Fate.CLOSED)
    filled = np.arange(8) < found.counts[rows][:, None]
    points, normals = found.points[rows][filled], found.normals_in[rows][filled]
    # Where the surface bends within a cell of the grid the straight way along the slope ends beside it.
    assert np.quantile(np.abs(field_distance(field, points)), 0.95) < 0.5 * field.spacing
    assert np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() < 1e-5
    inwards = field_distance(field, points + 0.002 * normals) - field_distance(field, points)
    assert (inwards < 0).mean() > 0.95
    # The thumb's contact is the first, the others follow in the order of the fingers.
    q = posture_at(tables, given.start[rows], found.closing[rows])
    x = given.place[rows, None] + np.einsum(
        "nij,nsj->nsi", rotations(given.turn[rows]), spheres_at(tables, q)
    )
    order = [tables.thumb, *(f for f in range(len(tables.fingers)) if f != tables.thumb)]
    for k in range(len(rows)):
        touching = [found.sphere[rows[k], f] for f in order if found.sphere[rows[k], f] >= 0]
        assert len(touching) == found.counts[rows[k]]
        reach = np.linalg.norm(x[k, touching] - found.points[rows[k], : len(touching)], axis=1)
        assert np.abs(reach - tables.sphere[touching, 3]).max() < 3 * TOLERANCE + 2e-6


def test_fingers_close_independently_of_each_other() -> None:
    tables, field = hand_tables(load_hand("shadow")), field_of("cube")
    kernel, given = ClosingKernel(tables, field), candidates("shadow", "cube", 300)
    every = replace(given, mask=np.full(300, 31))
    whole = kernel.close(every, wanted=1)
    rows = whole.fate == Fate.CLOSED
    assert rows.sum() > 30
    for finger in range(5):
        if finger == tables.thumb:
            continue
        pair = replace(given, mask=np.full(300, (1 << finger) | (1 << tables.thumb)))
        alone = kernel.close(pair, wanted=1)
        for column in (finger, tables.thumb):
            assert (alone.closing[rows, column] == whole.closing[rows, column]).all()
            assert (alone.sphere[rows, column] == whole.sphere[rows, column]).all()
        others = [f for f in range(5) if f not in (finger, tables.thumb)]
        assert (alone.closing[:, others] == 0).all()
        assert (alone.sphere[:, others] == -1).all()


def test_threads_and_company_change_nothing() -> None:
    tables, field = hand_tables(load_hand("shadow")), field_of("mug")
    given = candidates("shadow", "mug", 200)
    whole = ClosingKernel(tables, field, threads=1).close(given)
    for threads in (2, 3, 7):
        parts = ClosingKernel(tables, field, threads=threads).close(given)
        for name in ("fate", "closing", "sphere", "counts", "points", "normals_in"):
            assert np.array_equal(getattr(whole, name), getattr(parts, name))
    order = np.random.default_rng(0).permutation(200)
    mixed = ClosingKernel(tables, field).close(given.take(order))
    assert np.array_equal(mixed.closing, whole.closing[order])
    assert len(ClosingKernel(tables, field).close(given.take(order[:0])).fate) == 0


def turned(mesh: TriangleMesh, R: Array, shift: Array) -> TriangleMesh:
    triangles = mesh.triangles if np.linalg.det(R) > 0 else mesh.triangles[:, ::-1]
    return TriangleMesh(name="turned", vertices=mesh.vertices @ R.T + shift, triangles=triangles)


def moved_alike(first: Closings, second: Closings, R: Array, shift: Array) -> None:
    """The second scene is the first, moved: most closings must be too, to a part of a cell."""
    assert (first.fate == second.fate).mean() > 0.97
    same = (first.fate == second.fate) & (first.fate == Fate.CLOSED)
    assert same.sum() > 40
    away = np.abs(first.closing - second.closing)[same]
    assert np.median(away) < 2e-3
    assert np.quantile(away, 0.9) < 0.02
    filled = same[:, None] & (np.arange(8) < np.minimum(first.counts, second.counts)[:, None])
    apart = np.linalg.norm(first.points @ R.T + shift - second.points, axis=2)[filled]
    assert np.median(apart) < 5e-4


def test_a_quarter_turn_of_the_scene_turns_the_closings_exactly() -> None:
    """The grid turns with the object: not even its error differs."""
    tables, mesh = hand_tables(load_hand("shadow")), load_library_object("mug")
    R, shift = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.3, -0.2, 0.1])
    given = candidates("shadow", "mug", 300)
    half_turn = np.sqrt(0.5)
    w, x, y, z = given.turn.T
    q = half_turn * np.stack([w - z, x - y, y + x, z + w], axis=1)
    there = replace(given, place=given.place @ R.T + shift, turn=q)
    assert np.abs(rotations(q) - R @ rotations(given.turn)).max() < 1e-12
    first = closed("shadow", "mug", 300)
    field = prepare_field(turned(mesh, R, shift), cells=48, cache=None)
    second = ClosingKernel(tables, field).close(there)
    assert (first.fate == second.fate).mean() >= 0.99
    same = (first.fate == second.fate) & (first.fate == Fate.CLOSED)
    assert (np.abs(first.closing - second.closing)[same] < 1e-3).mean() > 0.985
    filled = same[:, None] & (np.arange(8) < first.counts[:, None])
    apart = np.linalg.norm(first.points @ R.T + shift - second.points, axis=2)[filled]
    assert (apart < 2e-4).mean() > 0.99


def test_any_motion_of_the_scene_moves_the_closings_with_it() -> None:
    from preshape.closure.candidates import quaternions
    from preshape.spatial import rotation_from_vector

    tables, mesh = hand_tables(load_hand("shadow")), load_library_object("cube")
    R, shift = rotation_from_vector([0.4, -1.1, 0.7]), np.array([0.5, -0.3, 0.2])
    given = candidates("shadow", "cube", 300)
    fields = [prepare_field(m, cells=64, cache=None) for m in (mesh, turned(mesh, R, shift))]
    there = replace(given, place=given.place @ R.T + shift, turn=quaternions(R @ rotations(given.turn)))
    first, second = (
        ClosingKernel(tables, field).close(at) for field, at in zip(fields, (given, there), strict=True)
    )
    moved_alike(first, second, R, shift)


def test_a_left_hand_closes_as_the_mirror_image_of_a_right_one() -> None:
    right, left = (hand_tables(load_hand(name)) for name in ("shadow", "shadow:left"))
    mesh, M = load_library_object("mug"), np.diag([-1.0, 1.0, 1.0])
    given = candidates("shadow", "mug", 300)
    # M R M of a quaternion: the axis is mirrored, the angle turned round.
    mirrored = replace(given, place=given.place @ M, turn=given.turn * [1.0, 1.0, -1.0, -1.0])
    first = closed("shadow", "mug", 300)
    field = prepare_field(turned(mesh, M, np.zeros(3)), cells=48, cache=None)
    second = ClosingKernel(left, field).close(mirrored)
    assert right.thumb == left.thumb
    assert (first.fate == second.fate).mean() >= 0.99
    same = (first.fate == second.fate) & (first.fate == Fate.CLOSED)
    assert same.sum() > 30
    assert (np.abs(first.closing - second.closing)[same] < 2e-3).mean() > 0.98
    filled = same[:, None] & (np.arange(8) < first.counts[:, None])
    assert (np.linalg.norm(first.points @ M - second.points, axis=2)[filled] < 5e-4).mean() > 0.97


def test_every_fate_is_reached_and_true() -> None:
    tables, field = hand_tables(load_hand("shadow")), field_of("mug")
    given, found = candidates("shadow", "mug", 600), closed("shadow", "mug", 600)
    reached = {Fate(int(f)) for f in found.fate}
    assert reached == {Fate.CLOSED, Fate.PALM_INSIDE, Fate.FINGERS_INSIDE, Fate.THUMB_MISSES, Fate.TOO_FEW}
    opened = finger_distance(tables, field, given, np.zeros((600, 5)))
    palm = np.einsum("nij,sj->nsi", rotations(given.turn), tables.palm[:, :3]) + given.place[:, None]
    palm_distance = field_distance(field, palm.reshape(-1, 3)).reshape(600, -1) - tables.palm[:, 3]
    inside = palm_distance.min(axis=1) < 0
    sure = np.abs(palm_distance.min(axis=1)) > 1e-5
    assert ((found.fate == Fate.PALM_INSIDE) == inside)[sure].all()
    in_fingers = found.fate == Fate.FINGERS_INSIDE
    assert (opened[in_fingers].min(axis=1) < 1e-6).all()
    assert (opened[found.fate == Fate.CLOSED].min(axis=1) > -1e-6).all()
    assert (found.sphere[found.fate == Fate.THUMB_MISSES][:, tables.thumb] == -1).all()
    touching = (found.sphere >= 0).sum(axis=1)
    assert (touching[found.fate == Fate.TOO_FEW] < 3).all()
    assert (found.counts == np.where(found.fate == Fate.CLOSED, touching, 0)).all()
    assert (touching[found.fate == Fate.CLOSED] >= 3).all()
    strict = ClosingKernel(tables, field).close(given, wanted=6)
    assert not (strict.fate == Fate.CLOSED).any()
