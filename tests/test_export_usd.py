"""USD stages, opened again and compared with the MuJoCo scene by code that reads nothing but the stage."""

from __future__ import annotations

import copy
import itertools
import json
import re
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdPhysics, UsdValidation

from coupled_hands import coupled_hand
from preshape.exceptions import HandError, InputError
from preshape.export.mjcf import scene_mjcf
from preshape.export.planned import PlannedGrasp
from preshape.export.usd import WorldPlace, joint_servos, scene_stage, stage_bytes, standing
from preshape.hands.hand import Hand
from preshape.hands.motors import direct_motor
from preshape.objects.library import load_library_object
from preshape.physics.pieces import ConvexPieces
from preshape.planner import plan
from preshape.planning.document import plan_to_json
from preshape.spatial import pose, pose_from_seven, rotation_from_vector
from test_export import CLOSURE, HOSTILE, SHOWN, grasps_of, run

HANDS = ("shadow", "leap", "tendon")
"""An adaptive hand, one with a mesh, and one with rigid laws of every kind."""
TURNED = pose(rotation_from_vector([0.3, -0.8, 1.1]), [0.4, -0.2, 0.7])


def odd_hand() -> Hand:
    """LEAP with a joint that does not count from 0, one that slides, a cylinder and an ellipsoid."""
    leap = coupled_hand("leap")
    text = leap.mjcf
    for old, new in (
        ('<joint name="if_mcp"', '<joint name="if_mcp" ref="0.2"'),
        ('<joint name="if_dip"', '<joint name="if_dip" type="slide" ref="-0.1"'),
        (
            'name="index_base_ear_side" class="link" type="capsule"',
            'name="side" class="link" type="cylinder"',
        ),
        ('name="palm_body" class="palm" type="box"', 'name="ball" class="palm" type="ellipsoid"'),
    ):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return replace(leap, mjcf=text)


@cache
def grasp_with(name: str) -> PlannedGrasp:
    """The stored grasp with another hand in postures of its own."""
    (base,) = grasps_of(CLOSURE, answer=0)
    hand = odd_hand() if name == "odd" else coupled_hand(name)
    q = {stage: hand.at(c) for stage, c in (("pregrasp", 0.2), ("grasp", 0.5), ("squeeze", 0.6))}
    nothing = {"points": np.zeros((0, 3)), "normals_in": np.zeros((0, 3)), "fingers": (), "forces": None}
    return replace(base, hand=hand, efforts=np.zeros(len(hand.joints)), **q, **nothing)


@cache
def made(name: str) -> tuple[Any, Any]:
    """The stage, opened again from its text, and the model of the same scene."""
    grasp, mesh = grasp_with(name), load_library_object("prism")
    parts = mesh, ConvexPieces(name="prism", pieces=(mesh.vertices,))
    table = np.array([0.0, 0.0, 1.0, mesh.bounds[0, 2]])
    stage = scene_stage(grasp, *parts, WorldPlace(T_world_mesh=TURNED, table=table))
    again = Usd.Stage.CreateInMemory("again.usda")
    assert again.GetRootLayer().ImportFromString(stage_bytes(stage, ".usda").decode())
    return again, mujoco.MjModel.from_xml_string(scene_mjcf(grasp, *parts))


def state_of(model: Any, q: np.ndarray) -> Any:
    data = mujoco.MjData(model)
    data.qpos[:] = [*q, 0, 0, 0, 1, 0, 0, 0]
    mujoco.mj_kinematics(model, data)
    return data


def attribute(prim: Any, name: str) -> Any:
    found = prim.GetAttribute(name)
    assert found.HasAuthoredValue(), f"{prim.GetPath()} has no {name}"
    return found.Get()


def seven(at: Any, turn: Any) -> np.ndarray:
    return pose_from_seven([*at, turn.GetReal(), *turn.GetImaginary()])


def placed(prim: Any) -> np.ndarray:
    """World matrix of a prim, for column vectors."""
    return np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())).T


def joints_of(stage: Any) -> dict[str, Any]:
    """The moving joints by the names of the hand's model."""
    moving = (UsdPhysics.RevoluteJoint, UsdPhysics.PrismaticJoint)
    return {p.GetDisplayName(): p for p in stage.Traverse() if any(p.IsA(kind) for kind in moving)}


def links_of(stage: Any) -> dict[str, Any]:
    return {link_name(p): p for p in stage.Traverse() if p.HasAPI(UsdPhysics.RigidBodyAPI)}


def link_name(prim: Any) -> str:
    """The name of the body in MuJoCo's scene."""
    return "object" if prim.GetPath() == "/World/Object" else prim.GetDisplayName()


def forward(stage: Any, angles: dict[str, float]) -> dict[str, np.ndarray]:
    """Poses of the rigid bodies by path, from the joints' frames alone; angles in radians."""
    joints = [UsdPhysics.Joint(p) for p in stage.Traverse() if p.IsA(UsdPhysics.Joint)]
    poses: dict[str, np.ndarray] = {"": np.eye(4)}
    while len(poses) <= len(joints):
        for joint in joints:
            (child,) = joint.GetBody1Rel().GetTargets()
            parent = str(next(iter(joint.GetBody0Rel().GetTargets()), ""))
            if str(child) in poses or parent not in poses:
                continue
            turn = np.eye(4)
            if joint.GetPrim().IsA(UsdPhysics.PrismaticJoint):
                assert attribute(joint.GetPrim(), "physics:axis") == "X"
                turn[0, 3] = angles[joint.GetPrim().GetDisplayName()]
            if joint.GetPrim().IsA(UsdPhysics.RevoluteJoint):
                assert attribute(joint.GetPrim(), "physics:axis") == "X"
                turn[:3, :3] = rotation_from_vector([angles[joint.GetPrim().GetDisplayName()], 0, 0])
            before = seven(joint.GetLocalPos0Attr().Get(), joint.GetLocalRot0Attr().Get())
            after = seven(joint.GetLocalPos1Attr().Get(), joint.GetLocalRot1Attr().Get())
            poses[str(child)] = poses[parent] @ before @ turn @ np.linalg.inv(after)
    return poses


with_hands = pytest.mark.parametrize("name", [*HANDS, "odd"])


@with_hands
def test_pixars_own_parser_and_validators_find_no_fault(name: str) -> None:
    stage, model = made(name)
    context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
    faults = [error for error in context.Validate(stage) if "FileExtension" not in error.GetName()]
    assert [error.GetMessage() for error in faults] == []
    parsed = UsdPhysics.UsdPhysicsLoadStageFromPrimRange(stage, ["/World"])
    assert all(one.isValid for _, found in parsed.values() for one in found)
    found = {str(kind).rsplit(".", 1)[-1]: len(paths) for kind, (paths, _) in parsed.items()}
    collide = model.geom_contype | model.geom_conaffinity
    shapes = sum(number for kind, number in found.items() if kind.endswith("Shape"))
    moving = found["RevoluteJoint"] + found.get("PrismaticJoint", 0)
    assert (found["Articulation"], moving) == (1, model.njnt - 1)
    assert shapes == np.count_nonzero(collide) + 1  # the table
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == UsdPhysics.GetStageKilogramsPerUnit(stage) == 1.0
    assert stage.GetDefaultPrim().GetPath() == "/World"


@with_hands
def test_frames_are_those_of_mujoco_in_any_posture(name: str) -> None:
    stage, model = made(name)
    grasp, links = grasp_with(name), links_of(stage)
    rng, limits = np.random.default_rng(0), grasp.hand.limits
    postures = [grasp.pregrasp, *rng.uniform(*limits.T, size=(3, len(limits)))]
    for number, q in enumerate(postures):
        data = state_of(model, q)
        poses = forward(stage, dict(zip(grasp.hand.joints, q, strict=True)))
        assert len(poses) == len(links)  # the world, all links, not the object
        for b in range(1, model.nbody):
            link = model.body(b).name
            expected = TURNED @ pose(data.xmat[b].reshape(3, 3), data.xpos[b])
            if link in links and link != "object":
                np.testing.assert_allclose(poses[str(links[link].GetPath())], expected, atol=2e-6)
            if number == 0:  # the stage shows the pregrasp
                prim = links.get(link) or next(p for p in stage.Traverse() if link_name(p) == link)
                np.testing.assert_allclose(placed(prim), expected, atol=1e-9)


@with_hands
def test_masses_inertia_and_limits(name: str) -> None:
    stage, model = made(name)
    links, total = links_of(stage), 0.0
    for b in range(1, model.nbody):
        if model.body_mass[b] == 0:
            continue
        api = UsdPhysics.MassAPI(links[model.body(b).name])
        total += (mass := api.GetMassAttr().Get())
        assert mass == pytest.approx(model.body_mass[b], rel=1e-6)
        frame = seven(api.GetCenterOfMassAttr().Get(), api.GetPrincipalAxesAttr().Get())
        np.testing.assert_allclose(frame[:3, 3], model.body_ipos[b], atol=1e-7)
        R = pose_from_seven([0, 0, 0, *model.body_iquat[b]])[:3, :3]
        tensor = frame[:3, :3] @ np.diag(api.GetDiagonalInertiaAttr().Get()) @ frame[:3, :3].T
        expected = R @ np.diag(model.body_inertia[b]) @ R.T
        np.testing.assert_allclose(tensor, expected, atol=1e-5 * model.body_inertia[b].max())
    assert total == pytest.approx(model.body_mass.sum(), rel=1e-6)
    joints = joints_of(stage)
    assert list(joints) == list(grasp_with(name).hand.joints)
    for joint, prim in joints.items():
        low, high = attribute(prim, "physics:lowerLimit"), attribute(prim, "physics:upperLimit")
        unit = np.pi / 180 if prim.IsA(UsdPhysics.RevoluteJoint) else 1.0
        np.testing.assert_allclose(unit * np.array([low, high]), model.joint(joint).range, atol=1e-7)
        if name == "odd":
            assert prim.IsA(UsdPhysics.RevoluteJoint) == (joint != "if_dip")


def shape_numbers(prim: Any) -> tuple[np.ndarray, float]:
    """Points that determine a shape of the stage, in the world, and its radius."""
    T = placed(prim)
    if prim.IsA(UsdGeom.Mesh):
        points, radius = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(), dtype=float), 0.0
    elif prim.IsA(UsdGeom.Cube):
        half = UsdGeom.Cube(prim).GetSizeAttr().Get() / 2
        points, radius = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]), 0.0
    elif prim.IsA(UsdGeom.Sphere):
        points, radius = np.zeros((1, 3)), UsdGeom.Sphere(prim).GetRadiusAttr().Get()
    else:
        kind = UsdGeom.Capsule if prim.IsA(UsdGeom.Capsule) else UsdGeom.Cylinder
        shape = kind(prim)
        assert shape.GetAxisAttr().Get() == "Z"
        half, radius = shape.GetHeightAttr().Get() / 2, shape.GetRadiusAttr().Get()
        points = np.array([[0, 0, -half], [0, 0, half]])
    return points @ T[:3, :3].T + T[:3, 3], radius


@with_hands
def test_every_shape_is_where_mujoco_has_it(name: str) -> None:
    stage, model = made(name)
    data = state_of(model, grasp_with(name).pregrasp)
    shapes = [p for p in stage.Traverse() if p.IsA(UsdGeom.Gprim) and p.GetPath() != "/World/Table"]
    assert len(shapes) == model.ngeom
    links, kinds = {link_name(p): p for p in stage.Traverse() if p.IsA(UsdGeom.Xform)}, mujoco.mjtGeom
    for b in range(1, model.nbody):
        own = [p for p in links[model.body(b).name].GetChildren() if p.IsA(UsdGeom.Gprim)]
        first = model.body_geomadr[b]
        assert len(own) == model.body_geomnum[b]
        for g, prim in zip(range(first, first + len(own)), own, strict=True):
            points, radius = shape_numbers(prim)
            kind, size = kinds(int(model.geom_type[g])), model.geom_size[g]
            collides = bool(model.geom_contype[g] or model.geom_conaffinity[g])
            assert prim.HasAPI(UsdPhysics.CollisionAPI) == collides
            expected = np.zeros((1, 3))
            if kind == kinds.mjGEOM_MESH:
                start = model.mesh_vertadr[model.geom_dataid[g]]
                expected = model.mesh_vert[start : start + model.mesh_vertnum[model.geom_dataid[g]]]
                assert prim.HasAPI(UsdPhysics.MeshCollisionAPI) == collides
                assert attribute(prim, "physics:approximation") == "convexHull" if collides else True
            elif kind == kinds.mjGEOM_ELLIPSOID:
                R, at = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g]
                inside = (np.linalg.inv(TURNED) @ np.append(points, np.ones((len(points), 1)), axis=1).T)[
                    :3
                ].T
                on = np.linalg.norm((inside - at) @ R / size, axis=1)
                np.testing.assert_allclose(on, 1.0, atol=1e-4)
                assert attribute(prim, "physics:approximation") == "convexHull"
                continue
            elif kind == kinds.mjGEOM_BOX:
                expected = size * [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
            elif kind in (kinds.mjGEOM_CAPSULE, kinds.mjGEOM_CYLINDER):
                expected = np.array([[0, 0, -size[1]], [0, 0, size[1]]])
            if kind not in (kinds.mjGEOM_MESH, kinds.mjGEOM_BOX):
                assert radius == size[0]
            there = expected @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g]
            np.testing.assert_allclose(points, there @ TURNED[:3, :3].T + TURNED[:3, 3], atol=1e-6)


def test_the_object_has_the_points_of_its_mesh_and_the_table_is_below_it() -> None:
    stage, _ = made("shadow")
    mesh = load_library_object("prism")
    surface = UsdGeom.Mesh(stage.GetPrimAtPath("/World/Object/geom_object"))
    points = np.array(surface.GetPointsAttr().Get())
    faces = np.array(surface.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    np.testing.assert_allclose(points[faces], mesh.vertices[mesh.triangles], atol=1e-7)
    corners, _ = shape_numbers(stage.GetPrimAtPath("/World/Table"))
    on_table = np.linalg.inv(TURNED) @ np.append(corners, np.ones((8, 1)), axis=1).T
    assert sorted(on_table[2].round(6)) == pytest.approx(
        [mesh.bounds[0, 2] - 0.02] * 4 + [mesh.bounds[0, 2]] * 4
    )
    assert attribute(stage.GetPrimAtPath("/World/Physics"), "physics:gravityMagnitude") == pytest.approx(9.81)


def test_drives_have_the_gains_and_limits_of_the_motors() -> None:
    for name in HANDS:
        stage, model = made(name)
        hand, joints = grasp_with(name).hand, joints_of(stage)
        for k, (motor, columns) in enumerate(zip(hand.motors, hand.motor_columns(), strict=True)):
            gain, limit = model.actuator_gainprm[k, 0], model.actuator_forcerange[k, 1]
            drives = [UsdPhysics.DriveAPI(joints[joint], "angular") for joint in motor.joints]
            stiffness = np.rad2deg([drive.GetStiffnessAttr().Get() for drive in drives])
            damping = np.rad2deg([drive.GetDampingAttr().Get() for drive in drives])
            most = np.array([drive.GetMaxForceAttr().Get() for drive in drives])
            np.testing.assert_allclose(
                joint_servos(hand)[columns], np.stack([stiffness, damping, most], 1), rtol=1e-6
            )
            np.testing.assert_allclose(damping / stiffness, -model.actuator_biasprm[k, 2] / gain, rtol=1e-6)
            if motor.law == "rigid" and motor.affine:
                # Virtual work along the law is that of the motor, and so is the greatest force.
                rates = motor.rates(0.0)
                assert rates @ (stiffness * rates) == pytest.approx(gain)
                assert np.abs(rates) @ most == pytest.approx(limit)
            elif motor.law == "adaptive":
                np.testing.assert_allclose(stiffness, gain * motor.weights**2, rtol=1e-6)
                np.testing.assert_allclose(most, limit * np.abs(motor.weights), rtol=1e-6)
            elif motor.law == "direct":
                assert (stiffness[0], most[0]) == pytest.approx((gain, limit))
            prim = next(
                p
                for p in stage.Traverse()
                if p.HasAttribute("preshape:law") and p.GetDisplayName() == motor.name
            )
            targets = prim.GetRelationship("preshape:joints").GetTargets()
            assert [stage.GetPrimAtPath(path).GetDisplayName() for path in targets] == list(motor.joints)
            assert attribute(prim, "preshape:law") == motor.law
            if not len(motor.path):
                assert list(attribute(prim, "preshape:polynomials")) == motor.polynomials.ravel().tolist()
            assert list(attribute(prim, "preshape:weights")) == motor.weights.tolist()


def test_links_pass_through_each_other_where_they_do_in_mujoco() -> None:
    """The pairs of links that are not filtered are those that MuJoCo lets collide."""
    for name in HANDS:
        stage, model = made(name)
        model, links, filtered = copy.copy(model), links_of(stage), set()
        for link, prim in links.items():
            for path in UsdPhysics.FilteredPairsAPI(prim).GetFilteredPairsRel().GetTargets():
                filtered.add(frozenset((link, stage.GetPrimAtPath(path).GetDisplayName())))
        # With margins larger than the hand, MuJoCo finds a contact for every pair that it does not filter.
        model.geom_margin[:] = 2.0
        if hasattr(model, "body_margin"):
            model.body_margin[:] = 2.0
        data = state_of(model, grasp_with(name).pregrasp)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        meeting = {
            frozenset(model.body(model.geom_bodyid[g]).name for g in (contact.geom1, contact.geom2))
            for contact in data.contact
        }
        shapes = {model.body(b).name for b in range(1, model.nbody) if model.body_geomnum[b]} - {"object"}
        assert shapes <= links.keys()
        joined = set()  # USD lets the two links of a joint pass, unless the joint says otherwise
        for prim in stage.Traverse():
            if prim.IsA(UsdPhysics.Joint):
                joint = UsdPhysics.Joint(prim)
                assert not joint.GetCollisionEnabledAttr().Get()
                paths = [*joint.GetBody0Rel().GetTargets(), *joint.GetBody1Rel().GetTargets()]
                joined.add(frozenset(stage.GetPrimAtPath(path).GetDisplayName() for path in paths))
        pairs = {frozenset(pair) for pair in itertools.combinations(sorted(shapes), 2)}
        assert pairs - filtered - joined == {pair for pair in meeting if pair <= shapes} - joined
        assert len(pairs - filtered - joined) > 30
        assert {frozenset((link, "object")) for link in shapes} <= meeting


# The command


def test_the_command_writes_both_kinds_of_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path / "cache"))
    document = plan_to_json(plan("prism", "lift", hand="utah_mit", memory=":memory:"))
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(document))
    names = ("grasp.usda", "grasp.usdc", "GRASP2.USDA", "grasp.usd")
    outs = [part for name in names for part in ("--out", str(tmp_path / name))]
    code, out, err = run("export", str(file), "--format", "usd", *outs, "--json")
    assert code == 0, err
    report = json.loads(out)
    assert (report["format"], report["mass"], report["answers"]) == ("usd", document["mass"], [0])
    assert report["prims"] == [
        f"/World/{p}" for p in ("Physics", "Material", "Light", "Hand", "Object", "Grasp")
    ]
    # The stages are kept: without its stage a layer is gone, and asking it ends the process.
    stages = [Usd.Stage.Open(str(tmp_path / n)) for n in names if n.islower()]
    texts = {each.GetRootLayer().ExportToString() for each in stages}
    assert len(texts) == 1
    assert texts == {(tmp_path / "GRASP2.USDA").read_text()}
    assert (tmp_path / "grasp.usdc").read_bytes().startswith(b"PXR-USDC")
    stage = Usd.Stage.Open(str(tmp_path / "grasp.usdc"))
    (grasp,) = grasps_of(document)
    kept = stage.GetPrimAtPath("/World/Grasp")
    for posture in ("pregrasp", "grasp", "squeeze", "efforts"):
        assert list(attribute(kept, f"preshape:{posture}")) == getattr(grasp, posture).tolist()
    paths = kept.GetRelationship("preshape:joints").GetTargets()
    assert [stage.GetPrimAtPath(path).GetDisplayName() for path in paths] == list(grasp.hand.joints)
    assert list(attribute(kept, "preshape:contact_fingers")) == list(grasp.fingers)
    assert attribute(kept, "preshape:executable") is True
    for joint, angle in zip(grasp.hand.joints, grasp.pregrasp, strict=True):
        prim = joints_of(stage)[joint]
        for name in ("drive:angular:physics:targetPosition", "state:angular:physics:position"):
            assert np.deg2rad(attribute(prim, name)) == pytest.approx(angle, abs=1e-6)
    # Without a file the text goes to standard output.
    code, text, _ = run("export", str(file), "--format", "usd", "--mass", "0.5")
    assert (code, text.startswith("#usda 1.0")) == (0, True)
    again = Usd.Stage.CreateInMemory("again.usda")
    assert again.GetRootLayer().ImportFromString(text)
    mass = UsdPhysics.MassAPI(again.GetPrimAtPath("/World/Object")).GetMassAttr().Get()
    assert mass == pytest.approx(0.5, rel=1e-4)
    # A target that cannot be written leaves nothing behind.
    code, _, err = run("export", str(file), "--format", "usd", "--out", f"{file}/grasp.usdc")
    assert (code, "cannot write" in err) == (3, True)
    code, _, err = run("export", str(file), "--format", "usd", "--out", str(tmp_path / "grasp.usdz"))
    assert code == 2
    assert "usd has the endings .usda, .usdc, .usd" in " ".join(err.split())
    assert not list(tmp_path.glob(".*")) + list(tmp_path.glob("*.usdz"))
    # Without the library nothing is cut or written.
    monkeypatch.setitem(sys.modules, "pxr", None)
    code, out, err = run("export", str(file), "--format", "usd", "--out", str(tmp_path / "none.usda"))
    assert (code, out) == (3, "")
    assert re.search(r'pip install "preshape\[usd\]"', err)
    assert not (tmp_path / "none.usda").exists()


def test_how_the_object_stands(tmp_path: Path) -> None:
    (grasp,) = grasps_of(CLOSURE, answer=0)
    free = standing(CLOSURE, grasp)  # written before plans had a scene
    assert free.table is None
    np.testing.assert_allclose(free.T_world_mesh[:3, :3] @ grasp.up, [0, 0, 1], atol=1e-12)
    for up in ([0.0, 0, -1], [0.0, 1, 0], [0.6, 0, -0.8]):
        turned = standing(CLOSURE, replace(grasp, up=np.array(up))).T_world_mesh[:3, :3]
        np.testing.assert_allclose(turned @ up, [0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(turned) == pytest.approx(1.0)
    scene = {"T_world_object": [0, 0, 0.2, 1, 0, 0, 0], "table": [0, 0, 1, -0.2], "up": [0, 0, 1]}
    found = standing({**CLOSURE, "scene": scene}, grasp)
    assert found.T_world_mesh[2, 3] == 0.2
    for name, damage in (
        ("T_world_object", [0, 0, 0, 0, 0, 0, 0]),
        ("T_world_object", [0, 0, 0]),
        ("T_world_object", None),
        ("table", [0, 0, 0, 1]),
        ("table", "auto"),
    ):
        with pytest.raises(InputError):
            standing({**CLOSURE, "scene": {**scene, name: damage}}, grasp)
    with pytest.raises(InputError, match="does not say how the object stands"):
        standing({**CLOSURE, "scene": {}}, grasp)


def test_two_joints_of_one_link_are_refused_by_name() -> None:
    grasp, mesh = grasp_with("leap"), load_library_object("prism")
    two = grasp.hand.mjcf.replace(
        '<joint name="if_pip"', '<joint name="extra" range="0 1"/><joint name="if_pip"'
    )
    assert two != grasp.hand.mjcf
    model = mujoco.MjModel.from_xml_string(two)
    names = tuple(model.joint(k).name for k in range(model.njnt))
    at, body = names.index("extra"), model.body(model.joint("extra").bodyid[0]).name
    motors = (*grasp.hand.motors, direct_motor("extra", np.array([0.0, 1.0])))
    longer = {n: np.insert(getattr(grasp, n), at, 0.5) for n in ("pregrasp", "grasp", "squeeze", "efforts")}
    hand = replace(
        grasp.hand,
        mjcf=two.replace("</actuator>", '<position name="extra" joint="extra" kp="1"/></actuator>'),
        joints=names,
        limits=np.insert(grasp.hand.limits, at, [0.0, 1.0], axis=0),
        motors=motors,
        gains=[*grasp.hand.gains, 1.0],
        torque_limits=[*grasp.hand.torque_limits, 1.0],
    )
    parts = mesh, ConvexPieces(name="prism", pieces=(mesh.vertices,))
    with pytest.raises(HandError, match=f"the link {body} has 2 joints"):
        scene_stage(replace(grasp, hand=hand, **longer), *parts, WorldPlace(T_world_mesh=np.eye(4)))


def test_names_that_usd_does_not_take() -> None:
    mesh, grasp = load_library_object("prism"), grasp_with("leap")
    document = copy.deepcopy(CLOSURE)
    document["object"]["name"] = HOSTILE
    (named,) = grasps_of(document, answer=0)
    hand = replace(grasp.hand, credit=HOSTILE, name=HOSTILE.replace("\ud800", "").replace("\0", ""))
    stage = scene_stage(
        replace(grasp, hand=hand, object_name=named.object_name, lacking='too "weak"'),
        mesh,
        ConvexPieces(name="prism", pieces=(mesh.vertices,)),
        WorldPlace(T_world_mesh=np.eye(4)),
    )
    assert stage.GetPrimAtPath("/World/Object").GetDisplayName() == SHOWN
    layer = stage.GetRootLayer()
    assert layer.documentation.count("\n") == 1
    assert "executable: false" in layer.documentation
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]", stage_bytes(stage, ".usda").decode())
    assert attribute(stage.GetPrimAtPath("/World/Grasp"), "preshape:answer") == "best"
    assert attribute(stage.GetPrimAtPath("/World/Physics"), "physics:gravityMagnitude") == 0.0
