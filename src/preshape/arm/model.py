"""An arm from a URDF or MJCF, with the hand on its tip: a chain of screws and a MuJoCo model of shapes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import ArmError, EnvironmentFailure, HandError, shown
from ..hands.compiled import compiled_spec, quiet_mujoco, read_spec
from ..hands.hand import Hand
from ..hands.kinematics import compile_hand
from ..hands.ros_files import use_visual_shapes
from ..objects.read_text import printable
from ..spatial import pose, quaternion_from_rotation
from ..types import Array, BoolArray, IntArray, freeze, frozen_array, value

HAND = "hand/"
"""Prefix of the names of the hand's bodies in the arm's model."""
TABLE = "preshape/table"
"""Name of the table's geom, a plane."""
MOST_JOINTS = 20
"""Largest number of joints between base and tip [C]."""
_SAMPLES = 64
"""Random postures in which two links must always overlap to count as neighbours [C]."""
_SLIDE_METRES = 10.0  # a slide without limits moves at most this far [m]
_ARM, _HAND = 1, 2  # bits of MuJoCo's contact filter


@value
class Arm:
    """An arm with a hand on its tip.

    At zero, the i-th joint turns about an axis, or slides along it; the tip is then at ``home``. So the pose
    of the tip is the product of the joints' screw displacements and ``home``.

    Attributes:
        name: The file's name without its ending.
        tip: Link that carries the hand.
        joints: (n,) Names of the joints from base to tip.
        hinges: (n,) Whether a joint is a hinge; else it is a slide.
        axes: (n, 3) Unit vector of each joint's axis at zero.
        points: (n, 3) A point on each axis at zero [m].
        limits: (n, 2) Least and largest position [rad or m]; infinite for a joint that turns without end.
        home: (4, 4) Pose of the tip at zero [m].
        T_tip_root: (4, 4) Pose of the hand's root on the tip [m].
        hand: The hand.
        model: ``mujoco.MjModel`` of arm and hand; do not change it.
        columns: (n,) Place of each joint in the model's ``qpos``.
        hand_columns: (m,) Place of each joint of the hand in the model's ``qpos``.
        rest: The model's ``qpos`` at zero, within the limits of all joints.
        neighbours: Pairs of groups of bodies that are fixed together, the smaller first, whose overlap means
            nothing.
        notes: What a user should know of the model, each in one sentence.
    """

    name: str
    tip: str
    joints: tuple[str, ...]
    hinges: BoolArray
    axes: Array
    points: Array
    limits: Array
    home: Array
    T_tip_root: Array
    hand: Hand
    model: Any
    columns: IntArray
    hand_columns: IntArray
    rest: Array
    neighbours: frozenset[tuple[int, int]] = frozenset()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.joints)
        freeze(
            self,
            axes=frozen_array(self.axes, (n, 3), "axes"),
            points=frozen_array(self.points, (n, 3), "points"),
            home=frozen_array(self.home, (4, 4), "home"),
            T_tip_root=frozen_array(self.T_tip_root, (4, 4), "mount"),
            rest=frozen_array(self.rest, (None,), "rest"),
        )

    @property
    def length(self) -> float:
        """Largest distance of the tip from the first joint [m]; no posture reaches farther."""
        places = np.vstack([self.points, self.home[:3, 3]])
        span = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
        slides = np.minimum(np.ptp(self.limits[~self.hinges], axis=1), _SLIDE_METRES)
        return span + float(slides.sum())


def read_arm(file: str | Path, tip: str, hand: Hand, T_tip_root: Array) -> Arm:
    """Read an arm and put a hand on its tip.

    Args:
        file: URDF, xacro or MJCF of the arm. Shapes whose meshes are missing are left out, with a note.
        tip: Link that carries the hand. What else hangs on it, such as a gripper, is left out.
        hand: The hand.
        T_tip_root: (4, 4) Pose of the hand's root on the tip [m].

    Raises:
        ArmError: There is no such file or link, or the joints from base to tip cannot carry a hand.
        EnvironmentFailure: The file cannot be read.
    """
    path = Path(file)
    try:
        found, exists = path.is_file(), path.exists()
    except (OSError, ValueError):
        found = exists = False
    if exists and not found:
        raise ArmError(f"{printable(path, 400)} is no regular file: --arm takes the URDF of an arm")
    if not found:
        raise ArmError(f"there is no arm {printable(path, 400)}: --arm takes the URDF of an arm")
    notes: list[str] = []
    lost: list[str] = []
    try:
        spec = read_spec(path, notes, lost)
    except HandError as error:
        raise ArmError(str(error)) from error
    except OSError as error:
        raise EnvironmentFailure(f"{path} cannot be read: {error.strerror or error}") from error
    _check_tip(spec, tip, path)
    laws = _joint_laws(spec)
    bare = _links_without_shape(spec)
    try:
        with quiet_mujoco():
            model = _with_hand(spec, tip, hand, T_tip_root)
            if not any(model.geom_contype[model.geom_bodyid > 0]):
                use_visual_shapes(model)
    except ValueError as error:
        raise ArmError(f"{path}: MuJoCo refuses the arm with this hand: {printable(error, 400)}") from error
    if lost:
        names = ", ".join(printable(Path(name).name, 60) for name in lost[:4])
        names += f" and {len(lost) - 4} more" if len(lost) > 4 else ""
        missing = f"; {', '.join(bare)} then have no shape" if bare else ""
        notes.append(f"its collision does not count the meshes that are missing: {names}{missing}")
    return _described(path, tip, hand, T_tip_root, model, laws, notes)


def _check_tip(spec: Any, tip: str, path: Path) -> None:
    """Refuse a tip that the model does not have."""
    names = [body.name for body in spec.bodies if body.name != "world"]
    if not names:
        raise ArmError(
            f"{path}: there is no link {shown(tip)} for --arm-tip, nor any other; an arm is a URDF, a xacro "
            "or an MJCF"
        )
    if tip in names:
        return _check_joints(spec.body(tip), tip, path)
    import difflib

    near = difflib.get_close_matches(tip, names, n=3, cutoff=0.4)
    guess = f"did you mean {' or '.join(near)}? It has" if near else "it has"
    listed = ", ".join(printable(name, 60) for name in names[:40])
    raise ArmError(f"{path}: the arm has no link {shown(tip)} for --arm-tip; {guess} {listed}")


def _check_joints(body: Any, tip: str, path: Path) -> None:
    """Refuse joints that no motor of an arm turns or slides."""
    import mujoco

    kinds = mujoco.mjtJoint
    while body.name != "world":
        for joint in body.joints:
            if joint.type not in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE):
                raise ArmError(
                    f"{path}: the joint {shown(joint.name)} between the base and {tip} is floating or a "
                    "ball; give an arm whose joints are revolute, continuous or prismatic, and its base fixed"
                )
            low, high = (float(bound) for bound in joint.range)
            if low > high:
                raise ArmError(
                    f"{path}: the limits of the joint {shown(joint.name)} are reversed: {low:g} to {high:g}"
                )
        body = body.parent


def _joint_laws(spec: Any) -> dict[str, str]:
    """The joint that each joint follows, by names."""
    import mujoco

    return {
        str(law.name1): str(law.name2)
        for law in spec.equalities
        if law.type == mujoco.mjtEq.mjEQ_JOINT and law.name2
    }


def _links_without_shape(spec: Any) -> list[str]:
    """Names of the moving links that have no shape."""
    return [printable(b.name, 60) for b in spec.bodies if b.name != "world" and b.joints and not b.geoms]


def _with_hand(spec: Any, tip: str, hand: Hand, T_tip_root: Array) -> Any:
    """The compiled model of the arm with the hand on its tip and a table."""
    import mujoco

    child = mujoco.MjSpec.from_string(hand.mjcf)
    root = compile_hand(hand).body(1).name
    child.option = spec.option  # attaching prints a warning if they differ
    frame = spec.body(tip).add_frame(
        pos=T_tip_root[:3, 3].tolist(), quat=quaternion_from_rotation(T_tip_root[:3, :3]).tolist()
    )
    frame.attach_body(child.body(root), HAND, "")
    spec.worldbody.add_geom(name=TABLE, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1])
    spec.compiler.boundmass, spec.compiler.boundinertia = 1e-9, 1e-12
    for key in tuple(spec.keys):  # they lack the hand's joints
        spec.delete(key)
    return compiled_spec(spec)


def _described(
    path: Path, tip: str, hand: Hand, T_tip_root: Array, model: Any, laws: dict[str, str], notes: list[str]
) -> Arm:
    """The arm of a compiled model."""
    import mujoco

    chain = _chain(model, model.body(tip).id)
    moving = [int(j) for body in chain for j in np.flatnonzero(model.jnt_bodyid == body)]
    names = [model.joint(j).name for j in moving]
    for name in names:
        if name in laws:
            raise ArmError(
                f"{path}: the joint {shown(name)} between the base and {tip} mimics {shown(laws[name])}; "
                "an arm's joints must each have a motor"
            )
    if not moving:
        raise ArmError(f"{path}: no joint moves {tip}; --arm-tip is the last link of the arm, not its base")
    if len(moving) > MOST_JOINTS:
        raise ArmError(f"{path}: {len(moving)} joints move {tip}, at most {MOST_JOINTS} can be planned for")
    rest = _rest(model)
    data = mujoco.MjData(model)
    data.qpos[:] = rest
    columns = model.jnt_qposadr[moving].astype(np.int64)
    data.qpos[columns] = 0.0
    mujoco.mj_kinematics(model, data)
    limited = np.array([bool(model.jnt_limited[j]) for j in moving])
    hinges = model.jnt_type[moving] == mujoco.mjtJoint.mjJNT_HINGE
    limits = np.where(limited[:, None], model.jnt_range[moving], [-np.inf, np.inf])
    free = ~limited & ~hinges
    limits[free] = [-_SLIDE_METRES, _SLIDE_METRES]
    body = model.body(tip).id
    _set_filter(model, body, notes)
    made = Arm(
        name=path.stem,
        tip=tip,
        joints=tuple(names),
        hinges=hinges,
        axes=data.xaxis[moving].copy(),
        points=data.xanchor[moving].copy(),
        limits=limits,
        home=pose(data.xmat[body].reshape(3, 3), data.xpos[body]),
        T_tip_root=T_tip_root,
        hand=hand,
        model=model,
        columns=columns,
        hand_columns=np.array([int(model.joint(HAND + joint).qposadr[0]) for joint in hand.joints]),
        rest=rest,
        notes=tuple(notes),
    )
    beside, always = _neighbours(made)
    if always:
        met = ", ".join(sorted({model.body(one).name for one, _ in always}))
        notes.append(
            f"the hand overlaps {met} in every posture, which then does not count: is --mount right?"
        )
    return replace(made, neighbours=beside | always, notes=tuple(notes))


def _chain(model: Any, body: int) -> list[int]:
    """Indices of the bodies from the base to a body."""
    chain = []
    while body > 0:
        chain.append(body)
        body = int(model.body_parentid[body])
    return chain[::-1]


def _rest(model: Any) -> Array:
    """The ``qpos`` of a model at zero, within the limits of its joints."""
    rest = np.array(model.qpos0)
    for j in range(model.njnt):
        if model.jnt_limited[j]:
            at = int(model.jnt_qposadr[j])
            rest[at] = np.clip(rest[at], *model.jnt_range[j])
    return rest


def _set_filter(model: Any, tip: int, notes: list[str]) -> None:
    """Let the arm collide with itself, the hand and the table, and the hand with the arm and the table.

    Whatever else hangs on the tip takes part in nothing, because the hand takes its place.
    """
    import mujoco

    hanging = set()
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        name = model.body(body).name
        if body == 0 and model.geom(geom).name == TABLE:
            kind = 2 * _ARM, 0
        elif name.startswith(HAND):
            kind = 1, 2
        elif not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            continue
        elif int(model.geom_type[geom]) in (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD):
            kind = 0, 0  # a floor in the arm's file is no part of the arm
        elif tip in _chain(model, body)[:-1]:
            hanging.add(printable(name, 60))
            kind = 0, 0
        else:
            kind = 1, 3
        model.geom_contype[geom], model.geom_conaffinity[geom] = kind
    if hanging:
        notes.append(
            f"{', '.join(sorted(hanging))} on {model.body(tip).name} are left out: the hand takes their place"
        )


def _neighbours(arm: Arm) -> tuple[frozenset[tuple[int, int]], frozenset[tuple[int, int]]]:
    """Pairs of groups of bodies whose overlap means nothing.

    Returns:
        The groups of the arm that a joint connects or that overlap in every random posture, and pairs of one
        of the arm, first, and one of the hand that do so.
    """
    import mujoco

    model = arm.model
    group = model.body_weldid
    beside = {_pair(int(group[b]), int(group[model.body_parentid[b]])) for b in range(1, model.nbody)}
    rng = np.random.default_rng(0)
    low, high = np.clip(arm.limits, -np.pi, np.pi).T
    data = mujoco.MjData(model)
    table = model.geom(TABLE).id
    always: set[tuple[int, int]] | None = None
    for _ in range(_SAMPLES):
        data.qpos[:] = arm.rest
        data.qpos[arm.columns] = rng.uniform(np.minimum(low, high), high)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        met = {
            _pair(*group[model.geom_bodyid[geoms]].tolist())
            for geoms in data.contact.geom[data.contact.dist < 0]
            if table not in geoms
        }
        always = met if always is None else always & met
    rest = (always or set()) - beside
    of_hand = {pair for pair in rest if model.body(pair[1]).name.startswith(HAND)}
    return frozenset(beside | (rest - of_hand)), frozenset(of_hand)


def _pair(one: int, other: int) -> tuple[int, int]:
    return min(one, other), max(one, other)
