"""The paper's hand: its description, its MJCF, its kinematics and its collisions."""

from __future__ import annotations

import subprocess
import sys
from importlib import resources
from xml.etree import ElementTree

import numpy as np
import pytest

from preshape.exceptions import HandError, ObjectError, UnknownHand
from preshape.hands import hand_names, load_hand, parse_hand
from preshape.hands.collision import closest_on_triangles, object_collision
from preshape.hands.inverse import InverseKinematics, Placement, Reach, _Problem, rotation_exp
from preshape.hands.kinematics import (
    HandKinematics,
    LinkShape,
    compile_hand,
    hand_geometry,
    pose_matrix,
    pose_vector,
)
from preshape.objects.mesh import TriangleMesh
from preshape.spatial import skew

HAND = load_hand("utah_mit")
BOX_TRIANGLES = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4]]
BOX_TRIANGLES += [[2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]]


def box(extents, centre=(0, 0, 0)) -> TriangleMesh:
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) / 2
    return TriangleMesh(
        name="box", vertices=corners * np.array(extents) + centre, triangles=np.array(BOX_TRIANGLES)
    )


def random_postures(count, seed=0):
    return np.random.default_rng(seed).uniform(HAND.limits[:, 0], HAND.limits[:, 1], (count, 16))


def turned(axis, angle):
    axis = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def tips_by_hand(q):
    """Fingertip centres from the XML alone: rotation matrices down the tree, no MuJoCo."""
    root = ElementTree.fromstring(HAND.mjcf)
    angle = dict(zip(HAND.joints, q, strict=True))
    axes = {
        default.get("class"): [float(x) for x in default.find("joint").get("axis").split()]
        for default in root.iter("default")
        if default.get("class") in ("abduction", "flexion")
    }
    tips = {}

    def walk(body, rotation, origin):
        origin = origin + rotation @ np.array([float(x) for x in body.get("pos", "0 0 0").split()])
        w, x, y, z = (float(part) for part in body.get("quat", "1 0 0 0").split())
        sine = np.linalg.norm([x, y, z])
        if sine > 0:
            rotation = rotation @ turned([x, y, z], 2 * np.arctan2(sine, w))
        for joint in body.findall("joint"):
            rotation = rotation @ turned(axes[joint.get("class")], angle[joint.get("name")])
        for site in body.findall("site"):
            tips[site.get("name")] = origin + rotation @ np.array(
                [float(x) for x in site.get("pos", "0 0 0").split()]
            )
        for child in body.findall("body"):
            walk(child, rotation, origin)

    walk(root.find("worldbody/body"), np.eye(3), np.zeros(3))
    return tips


# -- description ------------------------------------------------------------------------------------


def test_hand_is_known_and_cached():
    assert "utah_mit" in hand_names()
    assert load_hand("utah_mit") is HAND
    with pytest.raises(UnknownHand, match=r"no hand 'utah'; did you mean utah_mit\?"):
        load_hand("utah")


def test_hand_has_sixteen_joints_in_four_fingers_of_four():
    assert [finger.name for finger in HAND.fingers] == ["thumb", "index", "middle", "ring"]
    assert [len(finger.joints) for finger in HAND.fingers] == [4, 4, 4, 4]
    assert len(HAND.joints) == 16
    assert (HAND.limits[:, 0] < HAND.limits[:, 1]).all()
    assert not HAND.limits.flags.writeable
    assert HAND.posture("rest")[HAND.columns("ring")].tolist() == HAND.finger("ring").rest.tolist()
    with pytest.raises(HandError, match="it has thumb, index, middle, ring"):
        HAND.finger("little")
    with pytest.raises(HandError, match="known: open, rest, closed"):
        HAND.posture("flat")


def test_reading_a_hand_imports_nothing_heavy():
    code = (
        "import sys; from preshape.hands import load_hand; load_hand('utah_mit');"
        "import preshape.planning.hand_simulation;"
        "print([m for m in ('mujoco', 'fcl', 'trimesh', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def description() -> str:
    return (resources.files("preshape.hands") / "data" / "utah_mit.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("u = 0.043", "", "lacks 'u'"),
        ("u = 0.043", "u = -1.0", "u must be positive"),
        ("u = 0.043", "u = nan", "u must be positive"),
        (
            '"ring_flexion_3"]',
            '"ring_flexion_9"]',
            "do not name the same joints: ring_flexion_3, ring_flexion_9",
        ),
        ('tip_site = "ring_tip"', 'tip_site = "ring_end"', "no site ring_end"),
        ('tip_body = "ring_distal"', 'tip_body = "ring_end"', "no body ring_end"),
        ('name = "ring"', 'name = "index"', "named twice"),
        ("rest = [0.0, 0.75, 0.40, 0.30]", "rest = [0.0, 3.0, 0.40, 0.30]", "rest is outside the limits"),
        ("rest = [0.0, 0.75, 0.40, 0.30]", "rest = [0.0, 3.0]", "rest must be 4 numbers"),
        ("u = 0.043", "u = ", "cannot be read"),
    ],
)
def test_contradicting_descriptions_are_refused(old, new, said):
    assert old in description()
    with pytest.raises(HandError, match=said):
        parse_hand(description().replace(old, new, 1), HAND.mjcf)


def test_broken_mjcf_is_refused():
    with pytest.raises(HandError, match="cannot be read"):
        parse_hand(description(), HAND.mjcf[:-20])
    with pytest.raises(HandError, match="MuJoCo refuses"):
        compile_hand(parse_hand(description(), HAND.mjcf.replace('type="sphere"', 'type="ball"')))


# -- model ------------------------------------------------------------------------------------------


def test_mjcf_compiles_with_the_joints_in_order():
    model = compile_hand(HAND)
    assert compile_hand(HAND) is model
    assert (model.nq, model.nv, model.nu) == (16, 16, 16)
    assert tuple(model.joint(i).name for i in range(16)) == HAND.joints
    assert np.allclose(model.jnt_range, HAND.limits)
    assert np.allclose(model.actuator_forcerange, [-HAND.torque_limit, HAND.torque_limit])
    assert np.allclose(model.actuator_gainprm[:, 0], HAND.actuator_gain)
    assert np.allclose(-model.actuator_biasprm[:, 2], HAND.actuator_damping)
    assert 0.8 < model.body_mass.sum() < 3.0


def test_u_is_the_proximal_phalanx_of_the_middle_finger_and_sizes_agree():
    import mujoco

    model = compile_hand(HAND)
    data = mujoco.MjData(model)
    data.qpos[:] = random_postures(1)[0]
    mujoco.mj_kinematics(model, data)
    _, first, second, _ = (model.joint(joint).id for joint in HAND.finger("middle").joints)
    assert np.linalg.norm(data.xanchor[second] - data.xanchor[first]) == pytest.approx(HAND.u, abs=1e-9)
    anchors = [data.xanchor[model.joint(finger.joints[0]).id] for finger in HAND.fingers[1:]]
    assert np.allclose(np.linalg.norm(np.diff(anchors, axis=0), axis=1), HAND.finger_pitch)
    assert anchors[0][0] > anchors[2][0]  # +x is the index side
    for finger in HAND.fingers:
        radius = model.geom(f"{finger.name}_tip").size[0]
        assert radius == finger.tip_radius
        assert HAND.fingertip_width >= 2 * radius


def test_palm_frame_and_the_thumb_opposes():
    k = HandKinematics(HAND)
    k.set_posture(HAND.posture("open"))
    tips, axes = k.tips(HAND.fingers)
    assert tips[0, 1] < 0 < tips[1:, 1].min()  # the thumb on -y
    assert (axes[:, 2] > 0.8).all()  # all point along +z
    assert tips[2, 1] - tips[0, 1] > 4 * HAND.u  # opens over the largest object
    k.set_posture(HAND.posture("rest"))
    rest, _ = k.tips(HAND.fingers)
    assert rest[2, 1] - rest[0, 1] < HAND.u
    assert abs(rest[2, 0] - rest[0, 0]) < 1e-9  # the thumb stands opposite the middle finger
    # Flexion closes every finger towards the opposite one.
    assert rest[0, 1] > tips[0, 1]
    assert (rest[1:, 1] < tips[1:, 1]).all()


@pytest.mark.parametrize("kind", ["open", "rest", "closed"])
def test_hand_is_not_in_itself(kind):
    k = HandKinematics(HAND)
    k.set_posture(HAND.posture(kind))
    assert k.self_collisions() == []


def test_self_collision_names_the_links():
    q = HAND.posture("rest")
    q[HAND.columns("thumb")] = q[HAND.columns("middle")] = [0.0, 0.85, 0.5, 0.4]
    k = HandKinematics(HAND)
    k.set_posture(q)
    assert ("thumb_tip", "middle_tip") in {tuple(hit[:2]) for hit in k.self_collisions()}


# -- kinematics -------------------------------------------------------------------------------------


def test_tips_equal_kinematics_from_the_xml():
    k = HandKinematics(HAND)
    for q in random_postures(20):
        k.set_posture(q)
        tips, _ = k.tips(HAND.fingers)
        expected = tips_by_hand(q)
        for finger, tip in zip(HAND.fingers, tips, strict=True):
            assert np.allclose(tip, expected[finger.tip_site], atol=1e-8)


def test_jacobians_equal_finite_differences_and_mujoco():
    import mujoco

    k = HandKinematics(HAND)
    model, h = compile_hand(HAND), 1e-6
    data = mujoco.MjData(model)
    for q in random_postures(5, seed=1):
        k.set_posture(q)
        by_centre, by_axis = k.tip_jacobians(HAND.fingers)
        for j in range(16):
            sides = []
            for sign in (1, -1):
                k.set_posture(q + sign * h * np.eye(16)[j])
                sides.append(k.tips(HAND.fingers))
            for jacobian, plus, minus in zip((by_centre, by_axis), *sides, strict=True):
                assert np.allclose(jacobian[:, :, j], (plus - minus) / (2 * h), atol=1e-8)
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for finger, jacobian in zip(HAND.fingers, by_centre, strict=True):
            position = np.zeros((3, 16))
            mujoco.mj_jacSite(model, data, position, None, model.site(finger.tip_site).id)
            assert np.allclose(jacobian, position, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 9e-5, 1.1e-4, 0.3, 3.0, np.pi - 1e-6])
def test_rotation_exp_and_its_jacobian(angle):
    rng = np.random.default_rng(2)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    rotation, right = rotation_exp(angle * axis)
    assert np.allclose(rotation, turned(axis, angle), atol=1e-14)
    for direction in np.eye(3):
        h = 1e-6
        plus, minus = (rotation_exp(angle * axis + s * h * direction)[0] for s in (1, -1))
        spin = rotation.T @ (plus - minus) / (2 * h)
        assert np.allclose(spin, skew(right @ direction), atol=1e-8)


def test_pose_vector_and_matrix_are_inverse():
    rng = np.random.default_rng(3)
    for angle in (0.0, 1e-8, 1.0, np.pi - 1e-7, np.pi):
        rotation, translation = turned(rng.normal(size=3), angle), rng.normal(size=3)
        pose = pose_vector(rotation, translation)
        back, moved = pose_matrix(pose)
        assert np.allclose(back, rotation, atol=1e-9)
        assert np.allclose(moved, translation)
        assert np.linalg.norm(pose[3:]) == pytest.approx(1)


def test_problem_jacobian_equals_finite_differences():
    rng = np.random.default_rng(4)
    k = HandKinematics(HAND)
    solver = InverseKinematics(k, object_collision(box((0.08, 0.06, 0.10))))
    orientation = turned([1, 2, 3], 0.7)
    reach = Reach(
        fingers=HAND.fingers,
        targets=rng.normal(size=(4, 3)) * 0.03,
        inward=np.array([[0, 1, 0], [0, -1, 0], [0, -1, 0], [0, -1, 0]]) @ orientation.T,
        orientation=orientation,
    )
    start = Placement(
        rotation=orientation @ turned([1, 0.3, -0.2], 0.2),
        translation=np.array([0, 0, -0.05]),
        q=HAND.posture("rest") + 0.1,
        errors=np.zeros(4),
    )
    for move_base in (True, False):
        problem = _Problem(solver, reach, start, HAND.posture("rest"), move_base, True)
        z, h = problem.z0.copy(), 1e-7
        jacobian = problem.jacobian(z).copy()
        assert (problem.residual(z)[12:] > 0).sum() > 20  # hinges are at work
        for j, step in enumerate(h * np.eye(len(z))):
            slope = (problem.residual(z + step) - problem.residual(z - step)) / (2 * h)
            assert np.allclose(jacobian[:, j], slope, atol=1e-4), j


def test_geometry_is_placed_by_the_palm_pose():
    rotation, translation = turned([1, -2, 0.5], 1.1), np.array([0.1, -0.2, 0.3])
    q = random_postures(1, seed=5)[0]
    shapes = hand_geometry(HAND, pose_vector(rotation, translation), q)
    tips = {shape.link: shape for shape in shapes if shape.kind == "sphere"}
    for finger in HAND.fingers:
        expected = rotation @ tips_by_hand(q)[finger.tip_site] + translation
        assert np.allclose(tips[f"{finger.name}_tip"].p0, expected, atol=1e-8)
        proximal = next(shape for shape in shapes if shape.link == f"{finger.name}_proximal")
        along = (proximal.p1 - proximal.p0) / np.linalg.norm(proximal.p1 - proximal.p0)
        assert np.allclose(along, proximal.rotation[:, 2])
    assert {shape.kind for shape in shapes} == {"capsule", "sphere"}


# -- collision --------------------------------------------------------------------------------------


def box_distance(points, half):
    """Signed distance to a box about the origin, exact."""
    q = np.abs(points) - half
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(axis=-1), 0)


def test_closest_point_equals_the_exact_distance_to_a_box():
    half = np.array([0.03, 0.02, 0.05])
    mesh = box(2 * half)
    checker = object_collision(mesh)
    assert object_collision(mesh) is checker
    for point in np.random.default_rng(6).uniform(-0.09, 0.09, (100, 3)):
        distance, hit, triangle = checker.closest(point, 0.5)
        assert distance == pytest.approx(abs(box_distance(point, half)), abs=1e-12)
        assert abs(box_distance(hit, half)) < 1e-12
        on = closest_on_triangles(mesh.corners[triangle][None], hit)[0]
        assert np.allclose(on, hit, atol=1e-12)
        assert np.isinf(checker.closest(point, 0.999 * distance)[0])


def test_capsule_collision_is_exact_to_a_tenth_of_a_millimetre():
    half = np.array([0.03, 0.02, 0.05])
    checker = object_collision(box(2 * half))
    rng = np.random.default_rng(7)
    seen = 0
    while seen < 60:
        p0, p1 = rng.uniform(-0.1, 0.1, (2, 3))
        along = (p1 - p0) / np.linalg.norm(p1 - p0)
        inside = box_distance(p0 + np.linspace(0, 1, 4001)[:, None] * (p1 - p0), half)
        if inside.min() < 1e-3:
            continue
        seen += 1
        side = np.linalg.svd(along[None])[2][1]
        rotation = np.stack([side, np.cross(along, side), along], axis=1)
        for radius, expected in ((inside.min() + 1e-4, True), (inside.min() - 1e-4, False)):
            shape = LinkShape(
                kind="capsule",
                link="",
                body="",
                p0=p0,
                p1=p1,
                radius=radius,
                half=np.zeros(3),
                rotation=rotation,
            )
            assert checker.touches(shape) is expected
            assert checker.touches(shape, 3e-4) is True
            assert checker.touches(shape, -3e-4) is False


def test_soft_distance_is_near_the_exact_one_with_the_right_sign():
    half = np.array([0.03, 0.02, 0.05])
    checker = object_collision(box(2 * half))
    points = np.random.default_rng(8).uniform(-0.09, 0.09, (400, 3))
    distance, away = checker.soft_distance(points)
    exact = box_distance(points, half)
    clear = np.abs(exact) > 4e-3
    assert np.array_equal(np.sign(distance[clear]), np.sign(exact[clear]))
    assert np.abs(np.abs(distance) - np.abs(exact)).max() < 2e-3
    assert np.allclose(np.linalg.norm(away, axis=1), 1)


def test_a_mesh_without_area_is_refused():
    flat = TriangleMesh(name="flat", vertices=np.zeros((3, 3)), triangles=np.array([[0, 1, 2]]))
    with pytest.raises(ObjectError, match="no area"):
        object_collision(flat)
