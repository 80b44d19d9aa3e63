"""The built-in hands against the models they were rebuilt from, and against what a hand must be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from preshape.closure.hand_tables import hand_tables
from preshape.closure.wrapping import Wrapper
from preshape.exceptions import HandError, InputError, UnknownHand
from preshape.hands import hand_names, load_hand
from preshape.hands.check import check_hand, close_empty, motion_findings, opposition
from preshape.hands.collision import closest_on_triangles
from preshape.hands.kinematics import HandKinematics, hand_hulls
from preshape.kernels.closing.host import ClosingKernel, Obstacles
from preshape.kernels.field.host import prepare_field
from preshape.objects.library import load_library_object
from preshape.spatial import inverse, pose

HANDS = ("allegro", "leap", "shadow", "utah_mit")
# Folder, the body that is our root, and the way a finger points in the frame of its last body.
REFERENCE = {
    "shadow": ("shadow_hand", "rh_wrist", 2, 1.0),
    "allegro": ("wonik_allegro", "palm", 2, 1.0),
    "leap": ("leap_hand", "palm", 1, -1.0),
}
SHADOW_JOINTS = [
    f"rh_{f}J{k}" for f, n in (("FF", 4), ("MF", 4), ("RF", 4), ("LF", 5), ("TH", 5)) for k in range(n, 0, -1)
]


def random_postures(hand, count, seed=0):
    return np.random.default_rng(seed).uniform(
        hand.limits[:, 0], hand.limits[:, 1], (count, len(hand.joints))
    )


def frame(data, body):
    return pose(data.xmat[body].reshape(3, 3), data.xpos[body])


def farthest(model, body, axis, sign):
    """How far the colliding shapes of a last body reach along an axis of its frame [m].

    Allegro's fingertips collide 2.3 mm farther out than they look; physics grasps with what collides.
    """
    import mujoco

    kinds, reach = mujoco.mjtGeom, []
    for g in range(model.ngeom):
        owner = int(model.geom_bodyid[g])
        fixed = model.body_parentid[owner] == body and not model.body_jntnum[owner]
        if (owner == body or fixed) and (model.geom_contype[g] or model.geom_conaffinity[g]):
            assert owner == body or np.allclose(model.body_quat[owner], [1, 0, 0, 0])
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, model.geom_quat[g])
            row, size = sign * turn.reshape(3, 3)[axis], model.geom_size[g]
            if model.geom_type[g] == kinds.mjGEOM_MESH:
                mesh = int(model.geom_dataid[g])
                start = int(model.mesh_vertadr[mesh])
                out = (model.mesh_vert[start : start + int(model.mesh_vertnum[mesh])] @ row).max()
            elif model.geom_type[g] == kinds.mjGEOM_CAPSULE:
                out = size[0] + size[1] * abs(row[2])
            else:
                assert model.geom_type[g] == kinds.mjGEOM_BOX
                out = np.abs(row) @ size
            place = model.geom_pos[g] + (model.body_pos[owner] if owner != body else 0.0)
            reach.append(float(sign * place[axis] + out))
    return max(reach)


def last_mesh(model, body):
    """(n, 3), (m, 3, 3) vertices and triangles of a last body's visible meshes, in its frame [m]."""
    import mujoco

    vertices, triangles = [], []
    for g in range(model.ngeom):
        owner = int(model.geom_bodyid[g])
        fixed = owner != body and model.body_parentid[owner] == body and not model.body_jntnum[owner]
        # Shapes for collision may stand elsewhere.
        if (owner == body or fixed) and model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH:
            if model.geom_contype[g] and model.geom_group[g] != 2:
                continue
            assert owner == body or not model.body_pos[owner].any()
            mesh, turn = int(model.geom_dataid[g]), np.zeros(9)
            mujoco.mju_quat2Mat(turn, model.geom_quat[g])
            start, first = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
            points = model.mesh_vert[start : start + int(model.mesh_vertnum[mesh])].astype(float)
            points = points @ turn.reshape(3, 3).T + model.geom_pos[g]
            vertices.append(points)
            triangles.append(points[model.mesh_face[first : first + int(model.mesh_facenum[mesh])]])
    return np.concatenate(vertices), np.concatenate(triangles)


@pytest.mark.parametrize("name", REFERENCE)
def test_fingertips_agree_with_the_reference_model(name, reference):
    import mujoco

    folder, root, axis, sign = REFERENCE[name]
    theirs = mujoco.MjModel.from_xml_path(str(reference / "hands" / folder / "right_hand.xml"))
    hand = load_hand(name)
    ours = mujoco.MjModel.from_xml_string(hand.mjcf)
    a, b = mujoco.MjData(ours), mujoco.MjData(theirs)
    columns = [int(theirs.jnt_qposadr[theirs.joint(joint).id]) for joint in hand.joints]
    assert columns == sorted(columns)  # the same order
    for joint, limits in zip(hand.joints, hand.limits, strict=True):
        assert np.allclose(theirs.joint(joint).range, limits, atol=1e-9), joint
    ends = {}
    for finger in hand.fingers:
        ends[finger.name] = farthest(theirs, theirs.body(finger.tip_body).id, axis, sign)
    worst_body = worst_end = 0.0
    for q in random_postures(hand, 1000):
        a.qpos[:], b.qpos[:] = q, theirs.qpos0
        b.qpos[columns] = q
        mujoco.mj_kinematics(ours, a)
        mujoco.mj_kinematics(theirs, b)
        T_root = inverse(frame(a, ours.body(root).id))
        T_their_root = inverse(frame(b, theirs.body(root).id))
        for finger in hand.fingers:
            T_last = T_their_root @ frame(b, theirs.body(finger.tip_body).id)
            own = T_root @ frame(a, ours.body(finger.tip_body).id)
            worst_body = max(worst_body, float(np.abs(T_last - own)[:3, 3].max()))
            site = ours.site(finger.tip_site).id
            end = a.site_xpos[site] + finger.tip_radius * a.site_xmat[site].reshape(3, 3)[:, 2]
            # Our fingertip's end, in the frame of their last body.
            end = (inverse(T_last) @ T_root @ np.append(end, 1.0))[:3]
            worst_end = max(worst_end, abs(float(sign * end[axis]) - ends[finger.name]))
    print(f"{name}: last bodies {1000 * worst_body:.5f} mm, ends of fingertips {1000 * worst_end:.3f} mm")
    assert worst_body < 1e-4
    assert worst_end < 1e-3


@pytest.mark.parametrize("name", ["shadow"])
def test_the_end_of_a_fingertip_lies_on_the_reference_mesh(name, reference):
    # LEAP's fingertip is a wedge; Allegro's capsules that collide are longer than its meshes.
    import mujoco

    folder, _, _, _ = REFERENCE[name]
    theirs = mujoco.MjModel.from_xml_path(str(reference / "hands" / folder / "right_hand.xml"))
    hand = load_hand(name)
    ours = mujoco.MjModel.from_xml_string(hand.mjcf)
    for finger in hand.fingers:
        _, triangles = last_mesh(theirs, theirs.body(finger.tip_body).id)
        site, turn = ours.site(finger.tip_site), np.zeros(9)
        mujoco.mju_quat2Mat(turn, site.quat)
        end = site.pos + finger.tip_radius * turn.reshape(3, 3)[:, 2]
        gap = np.linalg.norm(closest_on_triangles(triangles, end) - end, axis=1).min()
        assert gap < 1e-3, finger.name


def test_the_shadow_s_forearm_fills_that_of_the_reference(reference):
    """No corner of the published one is more than 17 mm away; only the block at the wrist stands out."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(reference / "hands" / "shadow_hand" / "right_hand.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mesh = model.mesh("forearm_collision")
    (geom,) = (g for g in range(model.ngeom) if model.geom_dataid[g] == mesh.id and model.geom_contype[g])
    corners = model.mesh_vert[int(mesh.vertadr[0]) : int(mesh.vertadr[0] + mesh.vertnum[0])].astype(float)
    corners = corners @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    corners = corners @ frame(data, model.body("rh_palm").id)[:3, :3]
    corners -= data.xpos[model.body("rh_palm").id] @ frame(data, model.body("rh_palm").id)[:3, :3]
    tables = hand_tables(load_hand("shadow"))
    ours = tables.palm[tables.palm_spheres :]
    outside = np.linalg.norm(corners[:, None] - ours[None, :, :3], axis=2) - ours[:, 3]
    assert outside.min(axis=1).max() < 0.017
    hull = ConvexHull(corners).equations
    beyond = (ours[:, :3] @ hull[:, :3].T + hull[:, 3] + ours[:, 3:]).max(axis=1)
    assert beyond[ours[:, 2] < -0.08].max() < 1e-3
    assert beyond.max() < 0.03


@pytest.mark.parametrize("name", ["shadow", "shadow:left"])
def test_the_forearm_is_in_the_way_and_nothing_is_held_with_it(name):
    hand = load_hand(name)
    tables = hand_tables(hand)
    palm, forearm = np.split(tables.palm, [tables.palm_spheres])
    assert (forearm[:, 2] + forearm[:, 3] < -0.03).all()
    assert (palm[:, 2] > -0.05).all()
    field = prepare_field(load_library_object("cube"), cells=32, cache=None)
    wrapper = Wrapper(tables, ClosingKernel(tables, field), field, gap=0.0005, near=0.003)
    assert wrapper._palm_front()[:, 2].min() > -0.06
    # The hand stands upright over a table: the forearm is in it, the palm far above.
    upright, q = np.array([[1.0, 0, 0, 0]]), hand.at(0.0)[None]
    table = Obstacles(planes=np.array([[0.0, 0.0, 1.0, -0.2]]))
    _, free = wrapper.kernel.clearances(np.array([[0.0, 0.0, 0.5]]), upright, q, table)
    assert free[0] == pytest.approx(0.7 - 0.213 - 0.034, abs=0.003)
    _, free = wrapper.kernel.clearances(np.array([[0.0, 0.0, 0.0]]), upright, q, table)
    assert free[0] < -0.04
    assert (palm[:, 2] - palm[:, 3] + 0.2).min() > 0.1


def test_menagerie_models_rebuilt_from_primitives_move_like_ours(reference, monkeypatch):
    from preshape.hands import load, menagerie

    monkeypatch.setattr(load, "_by_name", load._by_name.__wrapped__)  # caches nothing from this test
    monkeypatch.setattr(menagerie, "fetch", lambda name: reference / "hands" / name / "right_hand.xml")
    for theirs, ours in (("shadow_hand", "shadow"), ("wonik_allegro", "allegro"), ("leap_hand", "leap")):
        hand, own = load_hand(f"menagerie:{theirs}"), load_hand(ours)
        assert hand.name == hand.source == f"menagerie:{theirs}"
        assert hand.joints == own.joints
        assert np.allclose(hand.limits, own.limits)
        assert [(m.name, m.law, m.joints) for m in hand.motors] == [
            (m.name, m.law, m.joints) for m in own.motors
        ]
        a, b = HandKinematics(hand), HandKinematics(own)
        for q in random_postures(own, 50):
            a.set_posture(q)
            b.set_posture(q)
            for x, y in zip(a.tips(hand.fingers), b.tips(own.fingers), strict=True):
                assert np.allclose(x, y, atol=1e-4)
        assert motion_findings(hand) == []


# -- what every hand must be ------------------------------------------------------------------------


def test_the_hands_are_these():
    assert hand_names() == HANDS
    with pytest.raises(UnknownHand, match=r"did you mean shadow\?.* Known: allegro, leap, shadow, utah_mit"):
        load_hand("shadw")


def test_shadow_has_the_published_joints_in_their_order():
    hand = load_hand("shadow")
    assert list(hand.joints) == SHADOW_JOINTS
    assert [finger.name for finger in hand.fingers] == ["thumb", "index", "middle", "ring", "little"]
    names = [motor.name for motor in hand.motors]
    assert len(names) == 18
    assert hand.motors[2].joints == ("rh_FFJ2", "rh_FFJ1")
    # The root is the wrist frame; the palm stands 34 mm along its z.
    assert np.allclose(hand.T_root_palm, pose(np.eye(3), [0, 0, 0.034]))
    assert hand.torque_limits[names.index("rh_THJ5")] == 3.0
    assert hand.torque_limits[names.index("rh_FFJ0")] == 1.0


@pytest.mark.parametrize("name", HANDS)
def test_mjcf_and_description_agree(name):
    import mujoco

    hand = load_hand(name)
    model = HandKinematics(hand).model
    assert tuple(model.joint(j).name for j in range(model.njnt)) == hand.joints
    assert np.allclose(model.jnt_range, hand.limits)
    assert model.nu == len(hand.motors)
    for k, motor in enumerate(hand.motors):
        assert model.actuator(k).name == motor.name
        assert model.actuator_gainprm[k, 0] == pytest.approx(hand.gains[k])
        assert model.actuator_ctrlrange[k] == pytest.approx(motor.range, abs=1e-4)
        assert -model.actuator_biasprm[k, 2] == pytest.approx(hand.actuator_damping)
        assert model.actuator_forcerange[k, 1] == pytest.approx(hand.torque_limits[k])
    for finger in hand.fingers:
        tip = model.geom(f"{finger.name}_tip")
        assert model.body(int(tip.bodyid[0])).name == finger.tip_body
        if name == "leap":  # a wedge; the sphere of the description lies in it and touches its pad
            solid = hand_hulls(hand)[int(tip.id)]
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, tip.quat)
            centre = (model.site(finger.tip_site).pos - tip.pos) @ turn.reshape(3, 3)
            depth = (solid.planes[:, 3] - solid.planes[:, :3] @ centre).min()
            assert finger.tip_radius < depth < finger.tip_radius + 3e-4
        else:
            assert tip.size[0] == pytest.approx(finger.tip_radius)
            assert np.allclose(tip.pos, model.site(finger.tip_site).pos)
    width = max(finger.tip_radius for finger in hand.fingers[1:])
    assert hand.fingertip_width >= 2 * width
    middle = hand.finger("middle")
    k = HandKinematics(hand)
    k.set_posture(hand.at(0.0))
    # U: between two neighbouring flexion axes of the middle finger, across them.
    data = k._data
    hinges = [model.joint(joint).id for joint in middle.joints]
    gaps = []
    for one in hinges:
        for other in hinges:
            x = data.xaxis[one]
            if one < other and abs(x @ data.xaxis[other]) > 1 - 1e-6 and abs(x[0]) > 0.9:
                arm = data.xanchor[other] - data.xanchor[one]
                gaps.append(float(np.linalg.norm(arm - (arm @ x) * x)))
                break
    assert gaps[0] == pytest.approx(hand.u, abs=2e-4)
    assert len(hand.licence) > 2
    assert len(hand.credit) > 20


@pytest.mark.parametrize("name", HANDS)
def test_the_palm_frame_is_as_written_down(name):
    hand = load_hand(name)
    k = HandKinematics(hand)
    k.set_posture(hand.at(0.0))
    model = k.model
    base = {f.name: k._data.xanchor[model.joint(f.joints[0]).id].copy() for f in hand.fingers}
    open_tips, axes = k.tips(hand.fingers)
    assert (axes[1:, 2] > 0.7).all()  # fingers point along +z
    assert base["index"][0] > base["middle"][0] > base["ring"][0]  # +x is the index side
    k.set_posture(hand.at(0.5))
    half, _ = k.tips(hand.fingers)
    assert (half[1:, 1] < open_tips[1:, 1] - 0.02).all()  # fingers flex towards -y, where the palm faces
    assert opposition(hand, k)[:2].max() > 0.3
    # The site of the palm frame is the world's origin of the compiled model, turned as it.
    site = model.site(hand.palm_site).id
    assert np.allclose(k._data.site_xpos[site], 0, atol=1e-12)
    assert np.allclose(k._data.site_xmat[site].reshape(3, 3), np.eye(3), atol=1e-7)


@pytest.mark.parametrize("name", HANDS)
def test_every_built_in_hand_passes_its_own_check(name):
    assert check_hand(name) == []
    assert check_hand(f"{name}:left") == []
    hand = load_hand(name)
    reached = close_empty(hand)
    assert (reached > 0.4).all()
    k = HandKinematics(hand)
    k.set_posture(hand.at(reached))
    assert k.self_collisions(0.5e-3) == []


@pytest.mark.parametrize("name", [*HANDS, "shadow:left"])
def test_the_servos_bring_the_hand_where_they_are_told(name):
    import mujoco

    hand = load_hand(name)
    model = mujoco.MjModel.from_xml_string(hand.mjcf)
    model.opt.timestep, model.opt.integrator = 0.004, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    data.qpos[:] = hand.at(0.0)
    target = hand.at(0.45)
    data.ctrl[:] = hand.controls(target)
    mujoco.mj_step(model, data, 250)
    assert data.warning.number.sum() == 0
    assert np.abs(hand.controls(data.qpos) - hand.controls(target)).max() < 0.02  # against gravity
    assert np.abs(data.qpos - target).max() < 0.06
    assert np.abs(data.qvel).max() < 0.05


# -- closing path -----------------------------------------------------------------------------------


def test_the_closing_path_goes_through_its_points():
    finger = load_hand("shadow").finger("index")
    assert np.array_equal(finger.at(0.0), finger.closing[0])
    assert np.array_equal(finger.at(1.0), finger.closing[-1])
    assert np.allclose(finger.at(0.25), [0, 0.05 + 1.35 * 0.25, 0.35 + 0.7 * 0.25, 0.35 + 0.7 * 0.25])
    assert np.array_equal(finger.at([-1.0, 2.0]), finger.closing[[0, -1]])
    spread = finger.closing[0].copy()
    spread[0] = -0.2
    assert np.allclose(finger.at(0.5, spread) - finger.at(0.5), [-0.2, 0, 0, 0])
    assert finger.preshape[0].tolist() == [-0.3, 0.0]
    assert (finger.preshape[1:, 0] == finger.preshape[1:, 1]).all()


def test_each_finger_closes_by_itself_and_stands_where_its_joints_do():
    hand = load_hand("shadow")
    q = hand.at([0, 1, 0, 0, 0])
    assert np.array_equal(q[hand.columns("index")], hand.finger("index").closing[-1])
    assert np.array_equal(q[hand.columns("thumb")], hand.finger("thumb").closing[0])
    assert hand.columns("thumb") == slice(17, 22)
    assert hand.columns("index") == slice(0, 4)


def test_a_coupled_drive_is_told_the_sum():
    hand = load_hand("shadow")
    q = random_postures(hand, 3)
    controls = hand.controls(q)
    assert controls.shape == (3, 18)
    k = [motor.joints for motor in hand.motors].index(("rh_MFJ2", "rh_MFJ1"))
    at = hand.joints.index("rh_MFJ2")
    assert np.allclose(controls[:, k], q[:, at] + q[:, at + 1])
    assert np.allclose(hand.controls(q[0]), controls[0])
    utah = load_hand("utah_mit")
    assert np.array_equal(utah.controls(utah.posture("rest")), utah.posture("rest"))
    with pytest.raises(InputError):
        hand.controls(np.zeros(3))


# -- left hands -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", HANDS)
def test_a_left_hand_is_the_mirror_image(name):
    right, left = load_hand(name), load_hand(f"{name}:left")
    assert left is load_hand(name, side="left")
    assert (left.side, left.name) == ("left", f"{name}:left")
    assert np.array_equal(right.limits, left.limits)
    flip = np.array([-1.0, 1.0, 1.0])
    a, b = HandKinematics(right), HandKinematics(left)
    for q in random_postures(right, 20):
        a.set_posture(q)
        b.set_posture(q)
        for x, y in zip(a.tips(right.fingers), b.tips(left.fingers), strict=True):
            assert np.allclose(x * flip, y, atol=1e-9)
        for one, other in zip(a.shapes(), b.shapes(), strict=True):
            assert (one.kind, one.radius) == (other.kind, other.radius)
            assert np.array_equal(one.half, other.half)
            mirrored = np.diag(flip) @ one.rotation @ np.diag(flip)
            assert np.allclose(mirrored, other.rotation, atol=1e-8) or one.kind != "box"
            ends = {tuple(np.round(p, 8) + 0.0) for p in (one.p0 * flip, one.p1 * flip)}
            assert ends == {tuple(np.round(p, 8) + 0.0) for p in (other.p0, other.p1)}
            if one.hull is not None:
                points = {tuple(np.round(p, 6) + 0.0) for p in one.corners * flip}
                assert points == {tuple(np.round(p, 6) + 0.0) for p in other.corners}
        # How deep two hulls are in each other depends on the order of their corners, if they are deep.
        hits = [sorted(hit[2] for hit in k.self_collisions(1e-5)) for k in (a, b)]
        assert np.allclose(hits[0], hits[1], atol=1e-5, rtol=0.1 if hand_hulls(right) else 0.0)
    mass = [k.model.body_mass for k in (a, b)]
    assert np.allclose(mass[0], mass[1])
    assert np.allclose(a.model.body_ipos * flip, b.model.body_ipos, atol=1e-9)


def test_names_of_a_left_hand():
    left = load_hand("shadow", side="left")
    assert left.joints[0] == "lh_FFJ4"
    assert (left.motors[2].name, left.motors[2].joints) == ("lh_FFJ0", ("lh_FFJ2", "lh_FFJ1"))
    assert left.motors[2].order == (("lh_FFJ1", "lh_FFJ2"),)
    assert load_hand("shadow:right") is load_hand("shadow") is load_hand("shadow", side="right")
    with pytest.raises(HandError, match="side must be right or left"):
        load_hand("shadow", side="upper")
    with pytest.raises(HandError, match="the name says left"):
        load_hand("shadow:left", side="right")
