"""The scene of a grasp test: hand and object in an otherwise empty world, as one compiled MuJoCo model.

Settings follow the field's test: implicitfast integration, elliptic cones, impratio 10, two no-slip
iterations, no gravity, condim 4. The hand's geoms are stiff (solimp 0.5 0.99 0.0001, solref 0.005 1); the
object's have MuJoCo's defaults. The hand's root is free and welded to a mocap body, which follows the poses.
A table, if there is one, is a plane that both may touch.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..exceptions import HandError, InputError, ObjectError, shown
from ..types import Array, IntArray, value
from .hand import PhysicsHand
from .pieces import ConvexPieces
from .protocol import HoldProtocol

PREFIX = "hand/"
TABLE = "table"
"""Name of the table's geom."""
WORLD, OBJECT, PALM = -2, -1, 0
"""Values of ``Scene.part_of_body``; fingers are numbered from 1."""


@value
class Scene:
    """A compiled scene and the addresses in it; read-only, so that one scene serves many grasps.

    Attributes:
        model: The ``mujoco.MjModel``.
        hand: Name of the hand.
        joints: Joint names in the order of the angles.
        joint_address: (j,) index of each angle in ``qpos``.
        root_address: First index of the pose of the hand's root in ``qpos``; -1 without a hand.
        object_address: First index of the object's pose in ``qpos``.
        object_body: Body id of the object.
        controls: (actuators, j) matrix that maps joint angles to the actuators' targets.
        part_of_body: (bodies,) ``WORLD``, ``OBJECT``, ``PALM`` (for every body fixed to the root), or the
            number of the finger.
        body_names: Name of each body, without the prefix ``PREFIX``.
        mass: Mass of the object [kg].
        friction: Sliding friction of the object.
    """

    model: Any
    hand: str
    joints: tuple[str, ...]
    joint_address: IntArray
    root_address: int
    object_address: int
    object_body: int
    controls: Array
    part_of_body: IntArray
    body_names: tuple[str, ...]
    mass: float
    friction: float

    @property
    def fingers(self) -> int:
        """Number of fingers of the hand."""
        return max(0, int(self.part_of_body.max()))


def build_scene(
    hand: PhysicsHand | None,
    pieces: ConvexPieces,
    scale: float,
    protocol: HoldProtocol,
    *,
    table: float | None = None,
) -> Scene:
    """Compile the scene for one hand and one object at one size.

    Args:
        hand: The hand; ``None`` makes a scene of the object alone.
        pieces: The object at scale 1.
        scale: Factor on the size of the object.
        protocol: Friction, mass and gains.
        table: Height of a table along the world's z [m]; ``None`` for none.

    Raises:
        InputError: The scale is not positive.
        HandError: MuJoCo refuses the hand, or a joint has no actuator.
        ObjectError: MuJoCo refuses the object.
    """
    import mujoco

    if not (np.isfinite(scale) and scale > 0):
        raise InputError(f"{pieces.name}: scale must be a positive number, got {shown(scale)}")
    spec = mujoco.MjSpec()
    if hand is not None:
        _add_hand(spec, hand, protocol)
    _add_object(spec, pieces, float(scale), protocol)
    if table is not None:
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(name=TABLE, type=plane, size=[1, 1, 1], pos=[0, 0, table])
    for geom in spec.geoms:
        geom.condim = 4
        geom.friction[:2] = protocol.friction, protocol.torsion
    _set_options(spec.option, protocol)  # the options of an attached model do not count
    try:
        model = spec.compile()
    except ValueError as error:
        kind = HandError if hand is not None and hand.name in str(error) else ObjectError
        name = hand.name if hand is not None else "no hand"
        raise kind(f"MuJoCo refuses {pieces.name} with {name}: {error}") from error
    return _describe(model, hand, protocol)


def _set_options(option: Any, protocol: HoldProtocol) -> None:
    import mujoco

    option.timestep = protocol.timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10
    option.noslip_iterations = 2
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    if not protocol.many_contacts:
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MULTICCD)
    # MuJoCo 4.0.0 factorises sparse constraint Jacobians wrongly; dense ones are correct in every version.
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE


def _add_hand(spec: Any, hand: PhysicsHand, protocol: HoldProtocol) -> None:
    import mujoco

    child = hand.spec()
    for option in (spec.option, child.option):  # attaching prints a warning if they differ
        _set_options(option, protocol)
    for actuator in child.actuators:
        if protocol.gain is not None and not hand.own_gains:
            actuator.gainprm[0] = protocol.gain
            actuator.biasprm[1] = -protocol.gain
        if hand.damping is not None:
            actuator.biasprm[2] = -hand.damping
        if not protocol.torque_limits:
            actuator.forcelimited = False
    for geom in child.geoms:
        geom.solimp[:3] = 0.5, 0.99, 0.0001
        geom.solref[:2] = 0.005, 1
    assets = dict(hand.assets)
    root = spec.worldbody.add_frame().attach_body(child.body(hand.root), PREFIX, "")
    spec.assets = {**spec.assets, **assets}
    root.pos, root.quat = [0, 0, 0], [1, 0, 0, 0]
    root.add_freejoint(name="root")
    spec.worldbody.add_body(name="mocap", mocap=True)
    weld = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1="mocap", name2=root.name
    )
    weld.solimp = [0.9, 0.95, 0.001, 0.5, 2]
    weld.data[:11] = 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1  # anchor, relative pose, torque scale


def _add_object(spec: Any, pieces: ConvexPieces, scale: float, protocol: HoldProtocol) -> None:
    import mujoco

    body = spec.worldbody.add_body(name="object")
    body.add_freejoint(name="object")
    density = protocol.mass / (pieces.volume * scale**3)
    for index, vertices in enumerate(pieces.pieces):
        mesh = spec.add_mesh(name=f"piece_{index}", uservert=(vertices * scale).ravel())
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, density=density)


def _describe(model: Any, hand: PhysicsHand | None, protocol: HoldProtocol) -> Scene:
    import mujoco

    names = tuple(model.body(index).name.removeprefix(PREFIX) for index in range(model.nbody))
    body = model.body("object").id
    joints = hand.joints if hand is not None else ()
    addresses = np.array([int(model.joint(PREFIX + joint).qposadr[0]) for joint in joints], dtype=np.int64)
    speeds = np.array([int(model.joint(PREFIX + joint).dofadr[0]) for joint in joints], dtype=np.int64)
    for joint in joints:
        if int(model.joint(PREFIX + joint).type[0]) not in (
            int(mujoco.mjtJoint.mjJNT_HINGE),
            int(mujoco.mjtJoint.mjJNT_SLIDE),
        ):
            raise HandError(f"joint {shown(joint)} of the hand is neither a hinge nor a slide")
    controls = _control_matrix(model)[:, speeds] if joints else np.zeros((0, 0))
    following = {
        model.joint(int(model.eq_obj1id[row])).name.removeprefix(PREFIX)
        for row in range(model.neq)
        if model.eq_type[row] == mujoco.mjtEq.mjEQ_JOINT
    }
    for joint, column in zip(joints, controls.T, strict=True):
        if not column.any() and joint not in following:
            raise HandError(f"joint {joint!r} has no actuator in the hand's MJCF; add a position actuator")
    return Scene(
        model=model,
        hand=hand.name if hand is not None else "",
        joints=joints,
        joint_address=addresses,
        root_address=int(model.joint("root").qposadr[0]) if hand is not None else -1,
        object_address=int(model.joint("object").qposadr[0]),
        object_body=int(body),
        controls=controls,
        part_of_body=_parts(model, int(body)),
        body_names=names,
        mass=float(model.body_mass[body]),
        friction=protocol.friction,
    )


def _control_matrix(model: Any) -> Array:
    """(actuators, degrees of freedom) derivative of each actuator's length with respect to each joint."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    dense = np.zeros((model.nu, model.nv))
    for row in range(model.nu):
        start, count = int(data.moment_rowadr[row]), int(data.moment_rownnz[row])
        columns = np.asarray(data.moment_colind).ravel()[start : start + count]
        dense[row, columns] = np.asarray(data.actuator_moment).ravel()[start : start + count]
    return dense


def _parts(model: Any, object_body: int) -> IntArray:
    """(bodies,) part of each body; a finger begins at each first joint below the root, in model order."""
    parts = np.full(model.nbody, WORLD, dtype=np.int64)
    fingers = 0
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        if body == object_body:
            parts[body] = OBJECT
        elif parent == 0:
            parts[body] = WORLD if model.body_mocapid[body] >= 0 else PALM
        elif parts[parent] == PALM and model.body_jntnum[body] > 0:
            fingers += 1
            parts[body] = fingers
        else:
            parts[body] = parts[parent]
    return parts
