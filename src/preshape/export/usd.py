"""A planned grasp as a USD stage with physics: hand, object and, if the plan has one, the table.

Masses, inertia, frames, limits and shapes are read from the compiled model of the MuJoCo scene
(:mod:`.mjcf`). Units are metres, kilograms and, as UsdPhysics has it, degrees for the angles of joints and
drives; +z is up. The prims and the names of the attributes are listed in ``docs/ros.md``.

This module needs the package ``usd-core`` (extra ``usd``), but no simulator.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .._version import __version__
from ..exceptions import EnvironmentFailure, HandError, InputError
from ..files import temporary_folder
from ..hands.hand import Hand
from ..hands.motors import ADAPTIVE
from ..objects.mesh import TriangleMesh
from ..physics.pieces import ConvexPieces
from ..planning.document import Document
from ..report.plain import escaped_line
from ..spatial import (
    inverse,
    pose,
    pose_from_seven,
    seven_from_pose,
    transform_points,
)
from ..types import Array, freeze, frozen_array, value
from .mjcf import scene_mjcf
from .planned import PlannedGrasp
from .usd_prims import (
    add_geoms,
    double_vector,
    float_quaternion,
    float_vector,
    identifiers,
    make_rigid,
    place,
    set_attribute,
    turn_between,
    value_type,
)

WORLD, HAND, OBJECT, TABLE, GRASP = "/World", "/World/Hand", "/World/Object", "/World/Table", "/World/Grasp"
GRAVITY = 9.81
TABLE_SIZE = np.array([1.0, 1.0, 0.02])
"""Size of the slab that stands for a table [m]."""
TABLE_COLOUR = (0.55, 0.55, 0.58)


@value
class WorldPlace:
    """How the mesh frame of a plan lies in a world with z up.

    Attributes:
        T_world_mesh: (4, 4) Pose of the mesh frame.
        table: (4,) Table in the mesh frame: unit normal, which is up, and distance [m]; ``None`` without one.

    Raises:
        InputError: An array has the wrong shape, or the normal is no unit vector.
    """

    T_world_mesh: Array
    table: Array | None = None

    def __post_init__(self) -> None:
        freeze(self, T_world_mesh=frozen_array(self.T_world_mesh, (4, 4), "pose of the object"))
        if self.table is not None:
            freeze(self, table=frozen_array(self.table, (4,), "table"))
            if abs(float(np.linalg.norm(self.table[:3])) - 1.0) > 0.01:
                raise InputError(f"the table's normal must have length 1, got {self.table[:3]}")


def standing(document: Document, grasp: PlannedGrasp) -> WorldPlace:
    """How the object of a plan stands: at rest on its table, or as it was planned in free space.

    Args:
        document: The plan. Older ones say only which way is up; the object's origin is then the world's.
        grasp: A grasp of the plan.

    Raises:
        InputError: The plan's scene is damaged.
    """
    scene = document.get("scene")
    if scene is not None:
        try:
            seven, table = frozen_array(scene["T_world_object"], (7,), "T_world_object"), scene["table"]
        except (KeyError, TypeError) as error:
            raise InputError(f"the plan's scene does not say how the object stands ({error})") from error
        if abs(float(np.linalg.norm(seven[3:])) - 1.0) > 0.01:
            raise InputError(f"T_world_object must have a unit quaternion, got {seven[3:]}")
        return WorldPlace(T_world_mesh=pose_from_seven(seven), table=table)
    return WorldPlace(T_world_mesh=pose(turn_between(grasp.up, np.array([0.0, 0.0, 1.0])), np.zeros(3)))


def require_usd() -> None:
    """Import the USD library.

    Raises:
        EnvironmentFailure: It is not installed.
    """
    try:
        from pxr import Usd, UsdPhysics  # noqa: F401
    except ImportError as error:
        raise EnvironmentFailure(
            'USD needs the package usd-core: pip install "preshape[usd]"; --format mjcf needs nothing'
        ) from error


def stage_bytes(stage: Any, suffix: str) -> bytes:
    """The content of a file of the stage: text for ``.usda``, USD's binary format for ``.usdc`` and ``.usd``.

    Raises:
        EnvironmentFailure: There is no place for a temporary file.
    """
    if suffix.lower() == ".usda":
        return str(stage.GetRootLayer().ExportToString()).encode()
    from pxr import Tf

    with temporary_folder("usd") as folder:
        path = folder / "scene.usdc"
        try:
            written = stage.GetRootLayer().Export(str(path))
            return path.read_bytes() if written else b""
        except (OSError, Tf.ErrorException) as error:
            raise EnvironmentFailure(f"USD cannot write a temporary file in {folder}: {error}") from error


def scene_stage(grasp: PlannedGrasp, mesh: TriangleMesh, pieces: ConvexPieces, stands: WorldPlace) -> Any:
    """The ``pxr.Usd.Stage`` of a grasp, in memory.

    1. The world: units, gravity (none without a table, as in the holding test), one material with the
       plan's friction, a light.
    2. The hand, fixed to the world at the pose of the grasp and open as in the pregrasp: a rigid body for
       each link, and a joint with limits and a drive for each joint.
    3. The object at rest, and the table.
    4. The postures and contacts of the grasp, and the laws of the motors, as attributes.

    Args:
        grasp: Hand, postures, mass and friction.
        mesh: The object as planned [m]; it is only drawn.
        pieces: The same object as convex pieces, which are used for collisions.
        stands: How the object stands.

    Raises:
        EnvironmentFailure: ``usd-core`` is not installed.
        InputError: Mass or friction is out of range.
        HandError: MuJoCo refuses the hand, or a link has several joints.
        ObjectError: MuJoCo refuses the object.
    """
    require_usd()
    import mujoco
    from pxr import Usd

    model = mujoco.MjModel.from_xml_string(scene_mjcf(grasp, mesh, pieces))
    stage = Usd.Stage.CreateInMemory()
    _add_world(stage, grasp, gravity=stands.table is not None)
    _add_hand(stage, model, grasp, stands.T_world_mesh)
    _add_object(stage, model, grasp, stands.T_world_mesh)
    if stands.table is not None:
        _add_table(stage, mesh, stands)
    _add_grasp(stage, grasp, stands.T_world_mesh)
    return stage


def _add_world(stage: Any, grasp: PlannedGrasp, *, gravity: bool) -> None:
    from pxr import UsdGeom, UsdLux, UsdPhysics, UsdShade

    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    layer, hand = stage.GetRootLayer(), grasp.hand
    layer.customLayerData = {"creator": f"preshape {__version__}"}
    notes = [f"hand: {hand.credit}; {hand.licence}", *([grasp.warning] if grasp.warning else [])]
    layer.documentation = "\n".join(escaped_line(note) for note in notes)
    world = UsdGeom.Xform.Define(stage, WORLD).GetPrim()
    stage.SetDefaultPrim(world)
    world.SetDisplayName(escaped_line(f"{hand.name} at {grasp.object_name}"))
    physics = UsdPhysics.Scene.Define(stage, f"{WORLD}/Physics")
    physics.CreateGravityDirectionAttr((0.0, 0.0, -1.0))
    physics.CreateGravityMagnitudeAttr(GRAVITY if gravity else 0.0)
    # One material for all: the friction of a contact is then the plan's, however a simulator combines two.
    material = UsdShade.Material.Define(stage, f"{WORLD}/Material")
    friction = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    friction.CreateStaticFrictionAttr(grasp.friction)
    friction.CreateDynamicFrictionAttr(grasp.friction)
    friction.CreateRestitutionAttr(0.0)
    UsdShade.MaterialBindingAPI.Apply(world).Bind(
        material, bindingStrength=UsdShade.Tokens.weakerThanDescendants, materialPurpose="physics"
    )
    UsdLux.DomeLight.Define(stage, f"{WORLD}/Light").CreateIntensityAttr(1000.0)


def _add_hand(stage: Any, model: Any, grasp: PlannedGrasp, T_world_mesh: Array) -> None:
    from pxr import UsdGeom, UsdPhysics

    hand = UsdGeom.Xform.Define(stage, HAND).GetPrim()
    hand.SetDisplayName(escaped_line(grasp.hand.name))
    UsdPhysics.ArticulationRootAPI.Apply(hand)
    UsdGeom.Scope.Define(stage, f"{HAND}/Joints")
    bodies = [b for b in range(1, model.nbody) if model.body(b).name != "object"]
    zero = _body_poses(model, model.qpos0)
    shown = T_world_mesh @ _body_poses(model, model.key("pregrasp").qpos)
    names = dict(zip(bodies, identifiers(model.body(b).name for b in bodies), strict=True))
    paths: dict[int, str] = {}
    carrier = {0: 0}  # the rigid body that carries each body
    for b in bodies:
        parent = carrier[int(model.body_parentid[b])]
        count, name = int(model.body_jntnum[b]), names[b]
        if count > 1:
            raise HandError(
                f"{grasp.hand.name}: the link {model.body(b).name} has {count} joints, but USD has one "
                "between two links; put a link between them in the hand's model"
            )
        frame = not count and parent != 0 and model.body_mass[b] == 0
        carrier[b] = parent if frame else b
        paths[b] = f"{paths[parent]}/{name}" if frame else f"{HAND}/{name}"
        prim = UsdGeom.Xform.Define(stage, paths[b]).GetPrim()
        prim.SetDisplayName(escaped_line(model.body(b).name))
        place(prim, inverse(shown[parent]) @ shown[b] if frame else shown[b])
        add_geoms(stage, model, b, paths[b])
        if not frame:
            make_rigid(prim, model, b)
            T_parent_child = shown[b] if parent == 0 else inverse(zero[parent]) @ zero[b]
            _add_joint(stage, model, b, paths.get(parent), paths[b], T_parent_child)
    _add_drives(stage, grasp)
    _filter(stage, model, {b: paths[b] for b in bodies if carrier[b] == b})


def _add_joint(
    stage: Any, model: Any, body: int, parent_path: str | None, path: str, T_parent_child: Array
) -> None:
    """The joint between a rigid body and its parent, or the world; its axis is the x of its frames.

    Args:
        stage: The stage.
        model: The scene.
        body: The body, with one joint or none.
        parent_path: Path of its parent; ``None`` for the world.
        path: Path of the body.
        T_parent_child: (4, 4) Pose of the body in its parent where ``qpos`` is ``qpos0``.
    """
    import mujoco
    from pxr import UsdPhysics

    folder = f"{HAND}/Joints"
    if not model.body_jntnum[body]:
        joint = UsdPhysics.FixedJoint.Define(stage, f"{folder}/{path.rsplit('/', 1)[1]}_fixed")
        T_child, T_parent = np.eye(4), T_parent_child
    else:
        j = int(model.body_jntadr[body])
        turns = mujoco.mjtJoint(int(model.jnt_type[j])) == mujoco.mjtJoint.mjJNT_HINGE
        kind = UsdPhysics.RevoluteJoint if turns else UsdPhysics.PrismaticJoint
        joint = kind.Define(stage, f"{folder}/{_joint_names(model)[j]}")
        joint.GetPrim().SetDisplayName(escaped_line(model.joint(j).name))
        joint.CreateAxisAttr(UsdPhysics.Tokens.x)
        T_child = pose(turn_between(np.array([1.0, 0.0, 0.0]), model.jnt_axis[j]), model.jnt_pos[j])
        # USD counts from where both frames coincide, MuJoCo from qpos0.
        back, start = np.eye(4), float(model.qpos0[model.jnt_qposadr[j]])
        if turns:
            c, s = np.cos(-start), np.sin(-start)
            back[1:3, 1:3] = [[c, -s], [s, c]]
        else:
            back[0, 3] = -start
        T_parent = T_parent_child @ T_child @ back
        if model.jnt_limited[j]:
            low, high = np.rad2deg(model.jnt_range[j]) if turns else model.jnt_range[j]
            joint.CreateLowerLimitAttr(float(low))
            joint.CreateUpperLimitAttr(float(high))
        dof = int(model.jnt_dofadr[j])
        set_attribute(joint.GetPrim(), "armature", "Double", float(model.dof_armature[dof]))
        set_attribute(joint.GetPrim(), "damping", "Double", float(model.dof_damping[dof]))
        set_attribute(joint.GetPrim(), "frictionloss", "Double", float(model.dof_frictionloss[dof]))
    if parent_path is not None:
        joint.CreateBody0Rel().SetTargets([parent_path])
    joint.CreateBody1Rel().SetTargets([path])
    for T, at, turned in (
        (T_parent, joint.CreateLocalPos0Attr, joint.CreateLocalRot0Attr),
        (T_child, joint.CreateLocalPos1Attr, joint.CreateLocalRot1Attr),
    ):
        seven = seven_from_pose(T)
        at(float_vector(seven[:3]))
        turned(float_quaternion(seven[3:]))


def _add_drives(stage: Any, grasp: PlannedGrasp) -> None:
    """A servo for each joint, whose target is the pregrasp, and the laws of the motors."""
    from pxr import UsdGeom, UsdPhysics

    hand = grasp.hand
    names = dict(zip(hand.joints, identifiers(hand.joints), strict=True))
    for name, target, numbers in zip(hand.joints, grasp.pregrasp, joint_servos(hand), strict=True):
        prim = stage.GetPrimAtPath(f"{HAND}/Joints/{names[name]}")
        turns = prim.IsA(UsdPhysics.RevoluteJoint)
        kind, unit = ("angular", np.pi / 180) if turns else ("linear", 1.0)
        stiffness, damping, limit = (float(number) for number in numbers)
        drive = UsdPhysics.DriveAPI.Apply(prim, kind)
        drive.CreateTypeAttr(UsdPhysics.Tokens.force)
        drive.CreateStiffnessAttr(stiffness * unit)
        drive.CreateDampingAttr(damping * unit)
        drive.CreateMaxForceAttr(limit)
        drive.CreateTargetPositionAttr(float(target) / unit)
        # Isaac Sim starts a joint there; other programs take the poses of the links.
        prim.AddAppliedSchema(f"PhysicsJointStateAPI:{kind}")
        state = prim.CreateAttribute(f"state:{kind}:physics:position", value_type("Float"), False)
        state.Set(float(target) / unit)
    UsdGeom.Scope.Define(stage, f"{HAND}/Motors")
    motors = identifiers(motor.name for motor in hand.motors)
    for name, motor, fact in zip(motors, hand.motors, hand.motor_facts(), strict=True):
        prim = UsdGeom.Scope.Define(stage, f"{HAND}/Motors/{name}").GetPrim()
        prim.SetDisplayName(escaped_line(motor.name))
        prim.CreateRelationship("preshape:joints").SetTargets(
            [f"{HAND}/Joints/{names[joint]}" for joint in motor.joints]
        )
        set_attribute(prim, "law", "Token", motor.law)
        for label, numbers in (
            ("weights", motor.weights),
            ("polynomials", motor.polynomials),
            ("unloaded", motor.path),
            ("range", motor.range),
        ):
            if np.size(numbers):
                set_attribute(prim, label, "DoubleArray", np.ravel(numbers).tolist())
        for label in ("gain", "damping", "torque_limit"):
            set_attribute(prim, label, "Double", fact[label])


def joint_servos(hand: Hand) -> Array:
    """(n, 3) Stiffness [N m/rad], damping [N m s/rad] and torque limit [N m] of a servo for each joint.

    USD knows no motor that moves several joints. Its joints get servos of their own instead. Those of a
    rigid law with the rates r (over the motor's range) have the stiffness K / (r · r) and the limits
    T |r| / (r · r): along the law, they do the work of the motor. Those of an adaptive motor, m = Σ cᵢ qᵢ,
    have K cᵢ² and T |cᵢ|.
    """
    servos = np.zeros((len(hand.joints), 3))
    per_motor = zip(hand.motors, hand.motor_columns(), hand.gains, hand.torque_limits, strict=True)
    for motor, columns, gain, limit in per_motor:
        if motor.law == ADAPTIVE:
            shares, limits = motor.weights**2, np.abs(motor.weights) * limit
        else:
            low, high = motor.range
            rates = np.abs(np.diff(motor.angles(motor.range), axis=0)[0]) / (high - low)
            shares = np.full(len(columns), 1.0 / (rates @ rates))
            limits = np.where(rates > 0, rates, 1.0) / (rates @ rates) * limit
        servos[columns] = np.stack([gain * shares, hand.actuator_damping * shares, limits], axis=1)
    return servos


def _filter(stage: Any, model: Any, paths: dict[int, str]) -> None:
    """Name the pairs of links that MuJoCo lets pass through each other; those of a joint do so in USD too."""
    from pxr import UsdPhysics

    excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
    weld, parents = model.body_weldid, model.body_weldid[model.body_parentid[model.body_weldid]]
    for a in paths:
        others = []
        for b in (b for b in paths if b > a):
            welded = weld[a] == weld[b]
            parent = weld[a] and weld[b] and (parents[a] == weld[b] or parents[b] == weld[a])
            if welded or parent or (a, b) in excluded or (b, a) in excluded:
                others.append(paths[b])
        if others:
            pairs = UsdPhysics.FilteredPairsAPI.Apply(stage.GetPrimAtPath(paths[a]))
            pairs.CreateFilteredPairsRel().SetTargets(others)


def _add_object(stage: Any, model: Any, grasp: PlannedGrasp, T_world_mesh: Array) -> None:
    from pxr import UsdGeom

    prim = UsdGeom.Xform.Define(stage, OBJECT).GetPrim()
    prim.SetDisplayName(grasp.object_name)
    place(prim, T_world_mesh)
    body = int(model.body("object").id)
    make_rigid(prim, model, body)
    add_geoms(stage, model, body, OBJECT)


def _add_table(stage: Any, mesh: TriangleMesh, stands: WorldPlace) -> None:
    """A slab below the object, whose upper face is the table."""
    from pxr import UsdGeom, UsdPhysics

    assert stands.table is not None
    normal, distance = stands.table[:3], stands.table[3]
    below = mesh.cog - (normal @ mesh.cog - distance) * normal
    T = stands.T_world_mesh
    up = T[:3, :3] @ normal
    centre = transform_points(T, below) - TABLE_SIZE[2] / 2 * up
    cube = UsdGeom.Cube.Define(stage, TABLE)
    cube.CreateSizeAttr(1.0)
    cube.CreateExtentAttr([(-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)])
    place(cube.GetPrim(), pose(turn_between(np.array([0.0, 0.0, 1.0]), up), centre), TABLE_SIZE)
    cube.CreateDisplayColorAttr([TABLE_COLOUR])
    UsdPhysics.CollisionAPI.Apply(cube.GetPrim())


def _add_grasp(stage: Any, grasp: PlannedGrasp, T_world_mesh: Array) -> None:
    """Postures [rad] in the order of ``preshape:joints``, and the contacts in the world's frame."""
    from pxr import UsdGeom

    prim, turn = UsdGeom.Scope.Define(stage, GRASP).GetPrim(), T_world_mesh[:3, :3]
    names = dict(zip(grasp.hand.joints, identifiers(grasp.hand.joints), strict=True))
    prim.CreateRelationship("preshape:joints").SetTargets(
        [f"{HAND}/Joints/{names[joint]}" for joint in grasp.hand.joints]
    )
    for name in ("pregrasp", "grasp", "squeeze", "efforts"):
        set_attribute(prim, name, "DoubleArray", getattr(grasp, name).tolist())
    set_attribute(prim, "approach", "Vector3d", double_vector(turn @ grasp.approach))
    points = transform_points(T_world_mesh, grasp.points)
    set_attribute(prim, "contact_points", "Point3dArray", [double_vector(p) for p in points])
    set_attribute(
        prim, "contact_normals", "Vector3dArray", [double_vector(n) for n in grasp.normals_in @ turn.T]
    )
    set_attribute(prim, "contact_fingers", "StringArray", list(grasp.fingers))
    for name, kind, content in (
        ("answer", "String", grasp.label),
        ("task", "String", grasp.task),
        ("mass", "Double", grasp.mass),
        ("friction", "Double", grasp.friction),
        ("quality", "Double", grasp.quality),
        ("executable", "Bool", not grasp.lacking),
        ("lacking", "String", grasp.lacking),
    ):
        set_attribute(prim, name, kind, content)


def _body_poses(model: Any, q: Array) -> Array:
    """(bodies, 4, 4) Poses of the bodies in the frame of the scene."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    return pose(data.xmat.reshape(-1, 3, 3), data.xpos)


def _joint_names(model: Any) -> list[str]:
    """Prim names of all joints of the scene; the last one is the object's free joint."""
    return identifiers(model.joint(j).name for j in range(model.njnt))
