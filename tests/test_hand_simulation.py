"""The hand on virtual grasps: what it reaches, what it refuses and why."""

from __future__ import annotations

import numpy as np
import pytest

from preshape.exceptions import InputError
from preshape.hands import load_hand
from preshape.hands.collision import closest_on_triangles
from preshape.hands.kinematics import HandKinematics
from preshape.objects.mesh import TriangleMesh
from preshape.planning.hand_simulation import HandStatus, hand_geometry, simulate_hand
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session

HAND = load_hand("utah_mit")
X, Y, Z = np.eye(3)
PLANES = [
    (-X, Y),
    (-X, Z),
    (-Z, Y),
    (-Y, Z),
    (X, Y),
    (Y, X),
    (Z, Y),
    (Y, Z),
    (X, Z),
    (Z, X),
    (-Y, X),
    (-Z, X),
]
BOX_TRIANGLES = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4]]
BOX_TRIANGLES += [[2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]]
CUBE = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) / 2


def boxes(*parts) -> TriangleMesh:
    """Boxes (extents, centre) as one mesh; they may touch."""
    vertices = np.concatenate([CUBE * np.array(extents) + centre for extents, centre in parts])
    triangles = np.concatenate([np.array(BOX_TRIANGLES) + 8 * k for k in range(len(parts))])
    return TriangleMesh(name="boxes", vertices=vertices, triangles=triangles)


def box_distance(points, parts):
    """Signed distance to the union of boxes; exact outside."""
    q = [np.abs(points - np.array(centre)) - np.array(extents) / 2 for extents, centre in parts]
    return np.min([np.linalg.norm(np.maximum(d, 0), axis=-1) + np.minimum(d.max(-1), 0) for d in q], axis=0)


def grasp_at(mesh, a, o, v, along_t):
    """Contacts on the outermost faces along o, as the ray analyser would aim them."""
    t = np.cross(a, o)
    depth = v * (np.abs(a) @ mesh.extents) / 2
    half = (np.abs(o) @ mesh.extents) / 2
    points = [mesh.cog + depth * a + half * o]
    points += [mesh.cog + depth * a - half * o + s * t for s in along_t]
    inward = np.array([-o] + [o] * len(along_t))
    triangles = []
    for point, normal in zip(points, inward, strict=True):
        gap = np.linalg.norm(closest_on_triangles(mesh.corners, point) - point, axis=1)
        triangles.append(int((gap - 1e-6 * (mesh.normals @ -normal)).argmin()))
        assert gap[triangles[-1]] < 1e-9
    return {
        "approach_axis": a,
        "opposition_axis": o,
        "contact_points": np.array(points),
        "normals_in": inward,
        "triangles": np.array(triangles),
    }


def spread(count):
    return (np.arange(count) - (count - 1) / 2) * HAND.finger_pitch


def check(result, mesh, grasp, parts):
    """All that a reached grasp promises, computed without the code that promised it."""
    assert result.status is HandStatus.REACHED, result.reason
    assert result.retracted is None
    pose, q = result.grasp.palm_pose, result.grasp.q
    assert (q >= HAND.limits[:, 0] - 1e-9).all()
    assert (q <= HAND.limits[:, 1] + 1e-9).all()
    shapes = hand_geometry(HAND, pose, q)
    used = {HAND.finger(name).tip_body: name for name in result.fingers}
    tips = {shape.body: shape.p0 for shape in shapes if shape.kind == "sphere"}
    for name, point, inward in zip(result.fingers, grasp["contact_points"], grasp["normals_in"], strict=True):
        finger = HAND.finger(name)
        assert np.linalg.norm(tips[finger.tip_body] + finger.tip_radius * inward - point) < 1e-3
    assert result.tip_errors.max() < 1e-3
    assert result.penetration < 1e-3
    for shape in shapes:
        points = shape.p0 + np.linspace(0, 1, 60)[:, None] * (shape.p1 - shape.p0)
        gap = box_distance(points, parts).min() - shape.radius
        assert gap > (-1e-3 if shape.body in used else 0) - 1e-5, (shape.link, gap)
    for shape in hand_geometry(HAND, result.pregrasp.palm_pose, result.pregrasp.q):
        points = shape.p0 + np.linspace(0, 1, 60)[:, None] * (shape.p1 - shape.p0)
        assert box_distance(points, parts).min() - shape.radius > -1e-5, shape.link
    kinematics = HandKinematics(HAND)
    kinematics.set_posture(q)
    assert kinematics.self_collisions(1e-3) == []
    # The palm: within 30° of the approach plane, thumb on +o, fingers along +a.
    a, o = grasp["approach_axis"], grasp["opposition_axis"]
    w, x, y, z = pose[3:]
    palm_z = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    palm_y = [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]
    assert palm_z @ a > np.cos(np.radians(30)) - 1e-9
    assert palm_y @ -o > np.cos(np.radians(30)) - 1e-9


@pytest.mark.parametrize("plane", range(12))
@pytest.mark.parametrize("flip", [False, True])
def test_every_plane_of_a_box(plane, flip):
    a, o = PLANES[plane]
    parts = [((0.06, 0.09, 0.075), (0.01, -0.02, 0.03))]
    mesh = boxes(*parts)
    grasp = grasp_at(mesh, a, -o if flip else o, -0.25, spread(2))
    check(simulate_hand(HAND, mesh, **grasp), mesh, grasp, parts)


@pytest.mark.parametrize("size", [0.015, 0.03, 0.06, 0.12, 0.17])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_sizes_and_numbers_of_fingers(size, count):
    parts = [((size, 0.09, 0.05), (0, 0, 0))]
    mesh = boxes(*parts)
    grasp = grasp_at(mesh, -Z, X, -0.4, spread(count))
    check(simulate_hand(HAND, mesh, **grasp), mesh, grasp, parts)


def test_random_boxes_mostly_succeed_and_keep_every_promise():
    rng = np.random.default_rng(20)
    reached = 0
    for _ in range(25):
        parts = [(np.exp(rng.uniform(np.log(0.02), np.log(0.16), 3)), np.zeros(3))]
        mesh = boxes(*parts)
        a, o = PLANES[rng.integers(12)]
        room = np.abs(np.cross(a, o)) @ mesh.extents
        count = int(rng.integers(1, min(3, 1 + room // HAND.finger_pitch) + 1))
        grasp = grasp_at(mesh, a, o, rng.uniform(-0.9, 0.9), spread(count))
        result = simulate_hand(HAND, mesh, **grasp)
        if result.reached:
            check(result, mesh, grasp, parts)
            reached += 1
        else:
            assert result.grasp is None
            assert result.reason
    assert reached >= 21


def test_concave_object_is_taken_exactly_not_as_its_hull():
    # An H on its side: the contacts lie in the notches, inside the hull.
    parts = [
        ((0.10, 0.03, 0.03), (0, 0, -0.045)),
        ((0.04, 0.03, 0.06), (0, 0, 0)),
        ((0.10, 0.03, 0.03), (0, 0, 0.045)),
    ]
    mesh = boxes(*parts)
    bar = boxes(parts[1])
    grasp = grasp_at(bar, -Y, X, -0.3, [0.0])
    grasp["triangles"] = grasp["triangles"] + 12
    check(simulate_hand(HAND, mesh, **grasp), mesh, grasp, parts)
    # Through a wide flange the hand cannot pass, whether the notch has room for the tips or not.
    mesh = boxes(parts[0], parts[1], ((0.30, 0.30, 0.03), (0, 0, 0.045)))
    through = grasp_at(bar, -Z, X, 0.0, [0.0])
    through["triangles"] = through["triangles"] + 12
    blocked = simulate_hand(HAND, mesh, **through)
    assert blocked.status is HandStatus.COLLISION
    assert "inside the object" in blocked.reason


def test_fingers_do_not_cross_and_keep_the_contact_order():
    parts = [((0.06, 0.06, 0.09), (0, 0, 0))]
    mesh = boxes(*parts)
    a, o = X, Y  # t = +Z: the index side
    for along, names in (
        ([0.025, 0.0, -0.025], ("thumb", "index", "middle", "ring")),
        ([-0.025, 0.0, 0.025], ("thumb", "ring", "middle", "index")),
        ([0.0, 0.025, -0.025], ("thumb", "middle", "index", "ring")),
        ([0.0], ("thumb", "middle")),
    ):
        grasp = grasp_at(mesh, a, o, -0.25, along)
        result = simulate_hand(HAND, mesh, **grasp)
        assert result.fingers == names
        check(result, mesh, grasp, parts)


def test_pregrasp_opens_and_squeeze_closes():
    parts = [((0.05, 0.05, 0.08), (0, 0, 0))]
    mesh = boxes(*parts)
    grasp = grasp_at(mesh, X, Y, -0.25, spread(2))
    result = simulate_hand(HAND, mesh, **grasp)
    for pose, shift in ((result.pregrasp, -0.015), (result.squeeze, 0.003)):
        assert np.array_equal(pose.palm_pose, result.grasp.palm_pose)
        tips = {s.body: s.p0 for s in hand_geometry(HAND, pose.palm_pose, pose.q) if s.kind == "sphere"}
        for name, point, inward in zip(
            result.fingers, grasp["contact_points"], grasp["normals_in"], strict=True
        ):
            finger = HAND.finger(name)
            goal = point + (shift - finger.tip_radius) * inward
            assert np.linalg.norm(tips[finger.tip_body] - goal) < 1e-3


# -- odd cases --------------------------------------------------------------------------------------


def retracted(result, mesh, a):
    assert result.grasp is None
    assert result.pregrasp is None
    assert result.squeeze is None
    assert np.array_equal(result.retracted.q, HAND.posture("open"))
    shapes = hand_geometry(HAND, result.retracted.palm_pose, result.retracted.q)
    front = max((p @ a) + s.radius for s in shapes for p in (s.p0, s.p1))
    assert front < (mesh.vertices @ a).min()


def test_a_squeeze_that_takes_every_joint_to_its_limit_is_found():
    with Session(":memory:") as session:
        taught = session.teach(
            PlanRequest(source="hand_wheel", task="lift", approaches="+y,-y", hand="utah_mit")
        )
    assert taught.hand_result is not None
    assert taught.hand_result.reached
    assert taught.hand_result.squeeze is not None


def test_out_of_reach():
    mesh = boxes(((0.6, 0.06, 0.06), (0, 0, 0)))
    result = simulate_hand(HAND, mesh, **grasp_at(mesh, -Z, X, -0.3, [0.0]))
    assert result.status is HandStatus.OUT_OF_REACH
    assert "mm from its contact" in result.reason
    assert result.tip_errors.max() > 0.05
    retracted(result, mesh, -Z)


def test_joint_limit():
    # Wider than the open hand, narrower than its fingers could spread without limits.
    mesh = boxes(((0.235, 0.06, 0.02), (0, 0, 0)))
    result = simulate_hand(HAND, mesh, **grasp_at(mesh, -Z, X, -0.3, [0.0]))
    assert result.status is HandStatus.JOINT_LIMIT
    assert "flexion" in result.reason
    retracted(result, mesh, -Z)


def test_collision_of_the_palm_with_a_deep_object():
    mesh = boxes(((0.06, 0.4, 0.5), (0, 0, 0)))
    result = simulate_hand(HAND, mesh, **grasp_at(mesh, -Z, X, 0.3, [0.0]))
    assert result.status is HandStatus.COLLISION
    assert "is inside the object" in result.reason
    retracted(result, mesh, -Z)


def test_collision_of_a_fingertip_that_has_no_room():
    # A slot of 12 mm: the tip is 16 mm thick.
    mesh = boxes(((0.04, 0.04, 0.04), (0, 0, 0)), ((0.04, 0.04, 0.04), (0.052, 0, 0)))
    grasp = grasp_at(boxes(((0.04, 0.04, 0.04), (0, 0, 0))), -Z, X, 0.0, [0.0])
    result = simulate_hand(HAND, mesh, **grasp)
    assert result.status is HandStatus.COLLISION
    assert "thumb's tip has no room" in result.reason
    assert result.attempts == 0
    retracted(result, mesh, -Z)


@pytest.mark.parametrize(("depth", "fits"), [(0.0005, True), (0.002, True), (0.006, False)])
def test_a_fingertip_rests_on_the_rims_of_a_shallow_groove_only(depth, fits):
    core = ((0.04, 0.04, 0.04), (0, 0, 0))
    rims = [((depth, 0.04, 0.012), (0.02 + depth / 2, 0, side)) for side in (-0.009, 0.009)]
    mesh = boxes(core, *rims)  # a groove 6 mm wide on the thumb's side
    result = simulate_hand(HAND, mesh, **grasp_at(boxes(core), Y, X, -0.2, [0.0]))
    if not fits:
        assert result.status is HandStatus.COLLISION
        assert "no room" in result.reason
        return
    assert result.reached, result.reason
    thumb = HAND.finger("thumb")
    shapes = hand_geometry(HAND, result.grasp.palm_pose, result.grasp.q)
    centre = next(s.p0 for s in shapes if s.link == "thumb_tip")
    gap = box_distance(centre, [core, *rims]) - thumb.tip_radius
    assert abs(gap) < 1e-3
    assert centre[0] - thumb.tip_radius < 0.02 + 3e-3


def test_self_collision_of_fingertips_too_close():
    mesh = boxes(((0.06, 0.06, 0.06), (0, 0, 0)))
    result = simulate_hand(HAND, mesh, **grasp_at(mesh, -Z, X, -0.3, [-0.003, 0.003]))
    assert result.status is HandStatus.SELF_COLLISION
    assert "mm inside" in result.reason
    retracted(result, mesh, -Z)


def test_statuses_are_sentences():
    assert len({status.value for status in HandStatus}) == len(HandStatus)
    assert all(" " in status.value for status in HandStatus)


# -- invariance, determinism, bad arguments ---------------------------------------------------------


@pytest.mark.parametrize("case", range(6))
def test_rigid_motion_of_the_scene_changes_nothing(case):
    rng = np.random.default_rng(30 + case)
    mesh = boxes((np.exp(rng.uniform(np.log(0.03), np.log(0.15), 3)), rng.normal(size=3)))
    a, o = PLANES[rng.integers(12)]
    grasp = grasp_at(mesh, a, o, rng.uniform(-0.9, 0.2), [0.0])
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    shift = rng.normal(size=3)
    moved = TriangleMesh(name="m", vertices=mesh.vertices @ rotation.T + shift, triangles=mesh.triangles)
    turned = {
        "approach_axis": rotation @ a,
        "opposition_axis": rotation @ o,
        "contact_points": grasp["contact_points"] @ rotation.T + shift,
        "normals_in": grasp["normals_in"] @ rotation.T,
        "triangles": grasp["triangles"],
    }
    before, after = simulate_hand(HAND, mesh, **grasp), simulate_hand(HAND, moved, **turned)
    assert before.status is after.status
    if before.reached:
        assert np.allclose(before.grasp.q, after.grasp.q, atol=1e-4)
        expected = rotation @ before.grasp.palm_pose[:3] + shift
        assert np.allclose(after.grasp.palm_pose[:3], expected, atol=1e-5)


def test_same_seed_same_result():
    mesh = boxes(((0.15, 0.06, 0.15), (0, 0, 0)))
    grasp = grasp_at(mesh, -Z, X, 0.6, [0.0])
    one, two = (simulate_hand(HAND, mesh, **grasp, seed=3) for _ in range(2))
    assert (one.status, one.reason, one.attempts) == (two.status, two.reason, two.attempts)
    pose = [result.grasp or result.retracted for result in (one, two)]
    assert np.array_equal(pose[0].q, pose[1].q)
    assert np.array_equal(pose[0].palm_pose, pose[1].palm_pose)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"approach_axis": X}, "perpendicular"),
        ({"opposition_axis": np.zeros(3)}, "perpendicular"),
        ({"contact_points": np.zeros((1, 3))}, "2 to 4 contacts, got 1"),
        ({"contact_points": np.full((2, 3), np.nan)}, "must be finite"),
        ({"normals_in": np.zeros((2, 3))}, "must not be zero"),
        ({"normals_in": np.ones((3, 3))}, "must be 2×3 numbers"),
        ({"triangles": [0, 12]}, "0 … 11"),
        ({"triangles": [-1, 0]}, "0 … 11"),
    ],
)
def test_bad_arguments_are_refused(change, said):
    mesh = boxes(((0.06, 0.06, 0.06), (0, 0, 0)))
    with pytest.raises(InputError, match=said):
        simulate_hand(HAND, mesh, **(grasp_at(mesh, -Z, X, -0.3, [0.0]) | change))
