"""The arm: kinematics against MuJoCo, inverse kinematics, what is in the way, and the path that comes out."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import arm_models
from preshape import spatial
from preshape.arm.collision import ArmScene, Surface
from preshape.arm.inverse import (
    LEVER,
    TOLERANCE,
    branches,
    conditions,
    jacobian,
    random_starts,
    screw_frames,
    solve,
)
from preshape.arm.model import Arm, read_arm
from preshape.arm.reach import (
    JOINT_SPEED,
    SINGULAR,
    SPACING,
    TIP_SPEED,
    ArmReach,
    ArmStatus,
    HandPath,
    reach,
    ways_of,
)
from preshape.exceptions import ArmError
from preshape.hands.load import load_hand
from preshape.objects.mesh import TriangleMesh
from preshape.types import Array

HAND = load_hand("utah_mit")
OWN = {"six": arm_models.six_joints(), "seven": arm_models.seven_joints()}
ARMS = [*OWN, *(name for name, _, _ in arm_models.PACKAGED)]
AHEAD = spatial.pose(np.eye(3), [0.45, 0.0, 0.0])
"""Pose of the object in the base."""


@cache
def arm_of(name: str, folder: Path, hand: str = "utah_mit") -> Arm:
    carried = load_hand(hand)
    mount = spatial.pose_from_seven(arm_models.mount_along(carried))
    if name in OWN:
        return read_arm(arm_models.written(folder, OWN[name], f"{name}.urdf"), "tip", carried, mount)
    tip = next(tip for file, tip, _ in arm_models.PACKAGED if file == name)
    return read_arm(arm_models.packaged(name), tip, carried, mount)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("arms")


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest, folder: Path) -> Arm:
    return arm_of(request.param, folder)


@pytest.fixture
def six(folder: Path) -> Arm:
    return arm_of("six", folder)


def tip_in_mujoco(arm: Arm, q: Array) -> Array:
    data = mujoco.MjData(arm.model)
    data.qpos[:] = arm.rest
    data.qpos[arm.columns] = q
    mujoco.mj_kinematics(arm.model, data)
    body = arm.model.body(arm.tip).id
    return spatial.pose(data.xmat[body].reshape(3, 3), data.xpos[body])


def poses_at(arm: Arm, q: Array) -> Array:
    R, p, _, _ = screw_frames(arm, q)
    return np.stack([spatial.pose(r, x) for r, x in zip(R, p, strict=True)])


def straight(height: float = 0.2, back: float = 0.12, way: tuple[float, ...] = (0, 0, -1.0)) -> HandPath:
    """A hand whose fingers point along ``way`` with its palm 15 cm before the object's origin."""
    z = np.array(way)
    x = np.array([1.0, 0, 0]) if abs(z[2]) > 0.5 else np.array([0.0, 0, 1])
    R = np.stack([x, np.cross(z, x), z], axis=1)
    return HandPath(
        palm_pose=spatial.seven_from_pose(spatial.pose(R, -0.15 * z)),
        way_in=z,
        back=back,
        up=np.array([0.0, 0, 1]),
        height=height,
        pregrasp=HAND.posture("open"),
        grasp=HAND.at(0.5),
    )


def box(centre: tuple[float, ...], half: tuple[float, ...]) -> TriangleMesh:
    import trimesh

    made = trimesh.creation.box(extents=2 * np.array(half))
    return TriangleMesh(name="box", vertices=made.vertices + centre, triangles=made.faces)


def reached(arm: Arm, *paths: HandPath, T: Array = AHEAD, **scene: Any) -> tuple[ArmReach, ...]:
    return reach(arm, ArmScene(arm, T, **scene), paths, T, 0)[0]


def test_the_tip_is_where_mujoco_has_it(arm: Arm) -> None:
    q = random_starts(arm, 20, np.random.default_rng(1))
    for row, T in zip(q, poses_at(arm, q), strict=True):
        assert pytest.approx(tip_in_mujoco(arm, row), abs=1e-12) == T


def test_the_jacobian_is_the_derivative(arm: Arm) -> None:
    q = random_starts(arm, 5, np.random.default_rng(2))
    R, p, axes, points = screw_frames(arm, q)
    J, step = jacobian(arm, p, axes, points), 1e-6
    for k in range(len(arm.joints)):
        moved = q.copy()
        moved[:, k] += step
        R1, p1, _, _ = screw_frames(arm, moved)
        turn = spatial.vector_from_rotation(R1 @ R.transpose(0, 2, 1))
        assert J[:, :3, k] == pytest.approx((p1 - p) / step, abs=1e-5)
        assert J[:, 3:, k] == pytest.approx(turn / step, abs=1e-5)


def test_a_slide_moves_along_its_axis(tmp_path: Path) -> None:
    rail = arm_models.Joint((0, 0, 0.2), axis=(0, 1, 0), limits=(-0.5, 0.5), kind="prismatic")
    joints = [rail, arm_models.Joint((0.3, 0, 0)), arm_models.Joint((0.3, 0, 0), axis=(0, 1, 0))]
    file = arm_models.written(tmp_path, arm_models.urdf("rail", joints, (0.1, 0, 0)))
    arm = read_arm(file, "tip", HAND, np.eye(4))
    assert arm.hinges.tolist() == [False, True, True]
    q = np.array([[0.4, 0.3, -0.2]])
    assert poses_at(arm, q)[0] == pytest.approx(tip_in_mujoco(arm, q[0]), abs=1e-12)
    goal = poses_at(arm, q)
    found = solve(arm, goal, np.array([[0.0, 0.0, 0.0]]))
    assert found.solved.all()
    assert found.q == pytest.approx(q, abs=1e-3)


def test_what_a_posture_reaches_is_found_again(arm: Arm) -> None:
    goals = poses_at(arm, random_starts(arm, 40, np.random.default_rng(3)))
    q, owner, _ = branches(arm, goals, seed=0)
    assert len(set(owner.tolist())) >= 39
    low, high = arm.limits.T
    assert (q >= low).all()
    assert (q <= high).all()
    for posture, target in zip(q[::7], owner[::7], strict=True):
        T = tip_in_mujoco(arm, posture)
        assert np.linalg.norm(T[:3, 3] - goals[target, :3, 3]) <= TOLERANCE
        turn = spatial.vector_from_rotation(T[:3, :3] @ goals[target, :3, :3].T)
        assert LEVER * np.linalg.norm(turn) <= 1.01 * TOLERANCE


def test_six_joints_have_eight_postures_and_all_are_found_sooner_or_later(six: Arm) -> None:
    # A wrist in reach of both shoulders, both elbows and both wrists has eight postures, and never more.
    goal = poses_at(six, np.array([[0.4, -1.2, 1.3, -0.8, 1.1, 0.3]]))
    met: list[Array] = []
    for seed in range(6):
        for q in branches(six, goal, seed)[0]:
            once = np.remainder(q + math.pi, 2 * math.pi) - math.pi
            if all(np.abs(np.exp(1j * once) - np.exp(1j * other)).max() > 1e-2 for other in met):
                met.append(once)
    assert len(met) == 8


def test_the_path_is_straight_in_and_up_and_keeps_limits_and_speeds(arm: Arm) -> None:
    path = straight()
    T = spatial.pose(np.eye(3), [0.4, 0.1, 0.0])
    result = reached(arm, path, T=T)[0]
    assert result.status is ArmStatus.REACHED, result.reason
    ways = ways_of(arm, [path], T)
    T_tip_palm = arm.T_tip_root @ arm.hand.T_root_palm
    palm = spatial.pose_from_seven(path.palm_pose)
    for k, (q, stage) in enumerate(zip(result.q, result.stages, strict=True)):
        held = tip_in_mujoco(arm, q) @ T_tip_palm
        in_object = spatial.inverse(T) @ held
        assert in_object[:3, :3] == pytest.approx(palm[:3, :3], abs=2e-4)
        shift = in_object[:3, 3] - palm[:3, 3]
        axis = path.way_in if stage == "way_in" else path.up
        assert shift == pytest.approx(axis * (shift @ axis), abs=3e-5)
        assert (shift @ axis <= 1e-4) == (stage == "way_in" or k == ways.at_grasp)
    g = result.stages.count("way_in") - 1
    ends = [spatial.inverse(T) @ tip_in_mujoco(arm, q) @ T_tip_palm for q in result.q[[0, g, -1]]]
    assert [T[:3, 3] - palm[:3, 3] for T in ends] == [
        pytest.approx(shift, abs=3e-5) for shift in (-0.12 * path.way_in, np.zeros(3), 0.2 * path.up)
    ]
    low, high = arm.limits.T
    assert (result.q >= low).all()
    assert (result.q <= high).all()
    assert result.limit_room == pytest.approx(np.minimum(result.q - low, high - result.q).min())
    assert result.condition == pytest.approx(conditions(arm, result.q).max())
    assert result.condition < SINGULAR
    steps = np.diff(result.times)
    assert (np.abs(np.diff(result.q, axis=0)) <= JOINT_SPEED * steps[:, None] + 1e-9).all()
    tips = np.stack([tip_in_mujoco(arm, q)[:3, 3] for q in result.q])
    moved = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    assert (moved <= TIP_SPEED * steps + 1e-9).all()
    assert (moved <= SPACING + 1e-4).all()


def test_the_same_seed_gives_the_same_path(six: Arm) -> None:
    once, again = reached(six, straight()), reached(six, straight())
    assert np.array_equal(once[0].q, again[0].q)


def test_a_grasp_does_not_depend_on_its_neighbours(six: Arm) -> None:
    others = [straight(way=(1.0, 0, 0)), straight(), straight(way=(-1.0, 0, 0))]
    assert reached(six, *others)[1].q == pytest.approx(reached(six, straight())[0].q, abs=1e-9)


def test_what_is_too_far_says_by_how_much(six: Arm) -> None:
    far = spatial.pose(np.eye(3), [1.6, 0.0, 0.3])
    result = reached(six, straight(), T=far)[0]
    assert result.status is ArmStatus.OUT_OF_REACH
    away = int(result.reason.split(" cm")[0].split()[-1])
    # No posture is nearer than the sphere that the whole chain, stretched, sweeps.
    target = ways_of(six, [straight()], far).poses[0, 6, :3, 3]
    assert away >= 100 * (np.linalg.norm(target - six.points[0]) - six.length) - 1
    assert not len(result.q)


def test_a_limit_is_named_by_its_joint(folder: Path) -> None:
    free = arm_of("six", folder)
    q = reached(free, straight())[0].q[6]
    mount = spatial.seven_from_pose(free.T_tip_root)
    # Without room about joint 1, only that joint keeps the arm from a goal 0.6 rad aside.
    text = arm_models.six_joints(joint_1=(q[0] - 0.1, q[0] + 0.1))
    tight = read_arm(
        arm_models.written(folder, text, "tight.urdf"), "tip", HAND, spatial.pose_from_seven(mount)
    )
    turn = spatial.rotation_from_vector([0, 0, 0.6])
    aside = spatial.pose(turn, np.zeros(3)) @ AHEAD
    result = reached(tight, straight(), T=aside)[0]
    assert result.status is ArmStatus.JOINT_LIMIT
    assert "joint_1 would have to turn" in result.reason
    beyond = int(result.reason.split("°")[0].split()[-1])
    assert abs(beyond - math.degrees(0.5)) < 3
    assert reached(free, straight(), T=aside)[0].reached


def test_a_stretched_arm_is_near_a_singular_posture(six: Arm) -> None:
    # The lift leads to where the arm is stretched; beyond that it cannot go.
    most = 0.0
    statuses = []
    for height in (0.2, 0.6, 0.75, 0.9):
        result = reached(six, straight(height=height))[0]
        statuses.append(result.status)
        most = max(most, result.condition)
    assert statuses[0] is ArmStatus.REACHED
    assert {*statuses[1:]} & {ArmStatus.SINGULAR, ArmStatus.OUT_OF_REACH}
    assert most < SINGULAR


def points_of(arm: Arm, q: Array, fingers: Array) -> dict[str, Array]:
    """Points on every moving shape that collides, in the base, by MuJoCo alone."""
    model, data = arm.model, mujoco.MjData(arm.model)
    data.qpos[:] = arm.rest
    data.qpos[arm.columns], data.qpos[arm.hand_columns] = q, fingers
    mujoco.mj_kinematics(model, data)
    found: dict[str, list[Array]] = {}
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(200, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if not model.body_weldid[body] or not model.geom_contype[geom]:
            continue
        kind, size = int(model.geom_type[geom]), model.geom_size[geom]
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            first = int(model.mesh_vertadr[mesh])
            local = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(float)
        elif kind == mujoco.mjtGeom.mjGEOM_BOX:
            local = np.sign(ball) * size
        else:
            local = ball * size[0]
            if kind != mujoco.mjtGeom.mjGEOM_SPHERE:
                along = np.array([0, 0, size[1]])
                local = np.concatenate([local + along, local - along])
        R = data.geom_xmat[geom].reshape(3, 3)
        found.setdefault(model.body(body).name, []).append(local @ R.T + data.geom_xpos[geom])
    return {name: np.concatenate(parts) for name, parts in found.items()}


@pytest.mark.parametrize("name", ARMS)
def test_a_free_path_is_above_the_table_and_out_of_a_wall(name: str, folder: Path) -> None:
    arm = arm_of(name, folder)
    T = spatial.pose(np.eye(3), [0.4, 0.1, 0.0])
    table = np.array([0.0, 0.0, 1.0, -0.1])
    wall = box((0.0, 0.35, 0.0), (0.6, 0.02, 0.6))
    results = reached(
        arm,
        straight(),
        straight(way=(1.0, 0, 0)),
        T=T,
        table=table,
        surfaces=(Surface(name="the wall", mesh=wall),),
    )
    assert results[0].reached, results[0].reason
    for result in results:
        for k, q in enumerate(result.q):
            fingers = HAND.posture("open") if k < 6 else HAND.at(0.5)
            for link, points in points_of(arm, q, fingers).items():
                local = spatial.transform_points(spatial.inverse(T), points)
                least = -0.003 if link.startswith("hand/") else 0.0
                assert local[:, 2].min() > -0.1 + least, link
                inside = (np.abs(local - [0, 0.35, 0]) < [0.6, 0.02, 0.6]).all(axis=1)
                assert not inside.any(), link


def test_a_box_round_the_way_is_hit(six: Arm) -> None:
    plate = box((0.0, 0.0, 0.25), (0.4, 0.4, 0.01))  # between the shoulder and the hand
    result = reached(six, straight(), surfaces=(Surface(name="a plate", mesh=plate),))[0]
    assert result.status is ArmStatus.COLLISION
    assert "would hit a plate" in result.reason


def test_the_object_counts_until_the_lift_and_not_for_the_hand(six: Arm) -> None:
    around = box((0.0, 0.0, 0.1), (0.02, 0.02, 0.02))  # under the palm, and above it after the lift
    palm = straight()
    solid = Surface(name="it", mesh=around, hand_too=True)
    held = Surface(name="it", mesh=around, hand_too=False, lifted=True)
    assert reached(six, palm, surfaces=(solid,))[0].status is ArmStatus.COLLISION
    assert reached(six, palm, surfaces=(held,))[0].reached
    shelf = box((0.0, 0.0, 0.52), (0.15, 0.15, 0.01))  # the arm comes there at the end of the lift only
    once = Surface(name="shelf", mesh=shelf)
    late = replace(once, lifted=True)
    result = reached(six, straight(back=0.02), surfaces=(once,))[0]
    if result.status is ArmStatus.COLLISION and "lift" in result.reason:
        assert reached(six, straight(back=0.02), surfaces=(late,))[0].reached


def test_hulls_that_overlap_where_the_meshes_do_not_are_no_collision(folder: Path) -> None:
    arm = arm_of("ur5_robot.urdf", folder)
    scene = ArmScene(arm, AHEAD)
    data = scene.data
    hulls, meshes = 0, 0
    for q in random_starts(arm, 100, np.random.default_rng(4)):
        scene._set(q, HAND.posture("open"))
        mujoco.mj_collision(scene.model, data)
        for one, other in data.contact.geom[data.contact.dist < 0].tolist():
            # The upper arm's hull fills the bend at the shoulder, into which the base reaches.
            if {scene.names[one], scene.names[other]} == {"base_link", "upper_arm_link"}:
                hulls += 1
                meshes += scene._meet(one, other)
    assert hulls > 40 > 10 > meshes


def test_two_links_that_meet_are_named(folder: Path) -> None:
    arm = arm_of("ur5_robot.urdf", folder)
    scene = ArmScene(arm, AHEAD)
    folded = np.array([[0.0, -1.0, 3.1, 0.0, 0.0, 0.0]])  # the forearm lies on the upper arm
    hit = scene.first_hit(folded, HAND.posture("open")[None], np.array([False]))
    assert hit is not None
    assert hit.itself
    assert "upper_arm_link" in (hit.one, hit.other) or "shoulder_link" in (hit.one, hit.other)


def test_a_base_below_the_table_sees_the_table_near_the_object_only(six: Arm) -> None:
    T = spatial.pose(np.eye(3), [0.45, 0.0, 0.25])
    table = np.array([0.0, 0.0, 1.0, -0.1])  # 15 cm above the base
    low = straight(height=0.04, back=0.04)
    whole = reached(six, low, T=T, table=table)[0]
    near = reached(six, low, T=T, table=table, table_radius=0.15)[0]
    assert whole.status is ArmStatus.COLLISION
    assert "the table" in whole.reason
    assert near.reached, near.reason


def test_missing_meshes_are_left_out_and_named(tmp_path: Path) -> None:
    text = Path(arm_models.packaged("ur5_robot.urdf")).read_text()
    file = arm_models.written(tmp_path, text.replace("example-robot-data/robots", "nowhere"), "ur5.urdf")
    arm = read_arm(file, "tool0", HAND, np.eye(4))
    assert "meshes that are missing: base.stl, shoulder.stl" in arm.notes[0]
    assert "upper_arm_link" in arm.notes[0]
    whole = read_arm(arm_models.packaged("ur5_robot.urdf"), "tool0", HAND, np.eye(4))
    q = random_starts(arm, 3, np.random.default_rng(5))
    assert poses_at(arm, q) == pytest.approx(poses_at(whole, q), abs=1e-12)


def test_what_hangs_on_the_tip_makes_room_for_the_hand(folder: Path) -> None:
    panda = arm_of("panda.urdf", folder)
    assert any("panda_hand, panda_leftfinger, panda_rightfinger" in note for note in panda.notes)
    moving = {
        panda.model.body(int(b)).name
        for b, bits in zip(panda.model.geom_bodyid, panda.model.geom_contype, strict=True)
        if bits
    }
    assert not {"panda_hand", "panda_leftfinger"} & moving


def test_a_mount_inside_the_wrist_is_noted() -> None:
    arm = read_arm(arm_models.packaged("xarm7.urdf"), "link_eef", load_hand("leap"), np.eye(4))
    assert any("overlaps" in note and "--mount" in note for note in arm.notes)


FLOATING = '<joint name="free" type="floating"><parent link="link_0"/><child link="link_1"/></joint>'


@pytest.mark.parametrize(
    ("text", "tip", "said"),
    [
        (OWN["six"], "tool", r"no link 'tool' for --arm-tip; .*tip"),
        (OWN["six"], "link_0", "no joint moves link_0"),
        (OWN["six"], "", "no link ''"),
        ("<robot name='x'><link name='tip'/></robot>", "tip", "no joint moves|no link"),
        ("<robot", "tip", "cannot read it"),
        (
            OWN["six"].replace('upper="6.2', 'upper="-8.2', 1),
            "tip",
            "limits of the joint 'joint_1' are reversed",
        ),
        ("plain text", "tip", "cannot read it"),
        ("<mujoco><worldbody/></mujoco>", "tip", "no link 'tip'"),
    ],
)
def test_a_bad_arm_is_refused_by_what_is_wrong(text: str, tip: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(ArmError, match=said) as error:
        read_arm(arm_models.written(tmp_path, text), tip, HAND, np.eye(4))
    assert len(str(error.value)) < 900


def test_joints_that_carry_no_hand_are_refused(tmp_path: Path) -> None:
    text = OWN["six"]
    start = text.index('<joint name="joint_2"')
    free = text[:start] + text[start:].replace('type="revolute"', 'type="floating"', 1)
    with pytest.raises(ArmError, match="'joint_2' between the base and tip is floating"):
        read_arm(arm_models.written(tmp_path, free), "tip", HAND, np.eye(4))
    follows = text.replace(
        'axis xyz="0 0 1"/><limit lower="-6', 'axis xyz="0 0 1"/><mimic joint="joint_6"/><limit lower="-6', 1
    )
    with pytest.raises(ArmError, match="mimics 'joint_6'"):
        read_arm(arm_models.written(tmp_path, follows), "tip", HAND, np.eye(4))
    with pytest.raises(ArmError, match="there is no arm"):
        read_arm(tmp_path / "none.urdf", "tip", HAND, np.eye(4))
    with pytest.raises(ArmError, match="is no regular file"):
        read_arm(tmp_path, "tip", HAND, np.eye(4))


def test_an_mjcf_with_a_floor_keyframes_and_any_shape_is_an_arm(tmp_path: Path) -> None:
    text = """<mujoco><compiler angle="radian"/><worldbody><geom name="table" type="plane" size="1 1 1"/>
      <geom type="hfield" hfield="hills"/>
      <body name="a"><geom type="capsule" size=".05 .1"/><joint name="j1" axis="0 0 1" range="-2 2"/>
      <body name="b" pos="0 0 .3"><geom type="ellipsoid" size=".05 .06 .1"/><joint name="j2" axis="0 1 0"/>
      <body name="tip" pos="0 0 .3"><geom type="cylinder" size=".05 .1"/><joint name="j3" axis="0 1 0"/>
      </body></body></body></worldbody>
      <asset><hfield name="hills" nrow="3" ncol="3" size="1 1 .1 .1"/></asset>
      <actuator><position joint="j1"/></actuator><keyframe><key qpos="0 0 0"/></keyframe></mujoco>"""
    arm = read_arm(arm_models.written(tmp_path, text, "arm.xml"), "tip", HAND, np.eye(4))
    assert arm.joints == ("j1", "j2", "j3")
    goal = poses_at(arm, np.array([[0.3, 0.5, 0.4]]))
    assert len(branches(arm, goal, 0)[0])
    scene = ArmScene(arm, np.eye(4))
    floor = scene.first_hit(np.array([[0.0, 0.1, 0.1]]), HAND.posture("open")[None], np.array([False]))
    assert floor is None or floor.other not in ("world", "the table")
    folded = scene.first_hit(np.array([[0.0, 3.1, 0.0]]), HAND.posture("open")[None], np.array([False]))
    assert folded is not None
    assert folded.itself


def test_a_joint_without_end_has_no_limit(tmp_path: Path) -> None:
    text = OWN["six"].replace('type="revolute"', 'type="continuous"', 1)
    arm = read_arm(arm_models.written(tmp_path, text), "tip", HAND, np.eye(4))
    assert arm.limits[0].tolist() == [-np.inf, np.inf]
    assert np.isfinite(arm.limits[1:]).all()
    assert reached(arm, straight())[0].reached
