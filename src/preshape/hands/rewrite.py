"""Rewrites a compiled model as a self-contained MJCF in one standard form, and makes a hand of it.

The MJCF has one root body and fingers as chains of hinges. Static bodies are merged into the body that
carries them; every colliding shape keeps its form as a capsule, a sphere, a box or convex hulls
(:mod:`preshape.hands.link_pieces`); the palm and every fingertip get a site. Code that reads a hand then
needs to know this form only, and the text needs no other file.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from ..exceptions import HandError
from ..spatial import inverse, pose, rotation_from_quaternion
from ..types import Array
from .compiled import CompiledModel, quiet_mujoco, reason
from .couples import Table, motors_within, per_motor, with_model_couples
from .description import direction, finger_from, hand_from, rounded_to_limits
from .findings import LARGEST_ANGLE, description_findings, model_findings, refuse
from .hand import Hand
from .hulls import ellipsoid_corners
from .link_pieces import Piece, frame_text, geom_pieces, geom_text, mesh_text, numbers_text, outside
from .motors import ADAPTIVE, DIRECT, Motor

_DAMPING, _ARMATURE = 0.05, 2e-4
"""Damping [N m s/rad] and armature [kg m²] of a joint if the model does not state them [C]."""

STIFF = "0.008 1"
"""Time constant [s] and damping ratio of a linkage or a stop of a couple in MuJoCo; twice a time step of 4
ms."""

_RIGID = "0.9999 0.9999 0.001"
"""Impedance of a clutch in MuJoCo, the largest there is: with less, dry friction creeps visibly."""

SPRING, SPRING_DAMPING = 0.05, 0.0
"""Stiffness [N m/rad] and damping [N m s/rad] that keep an adaptive couple on its unloaded path [C]."""

BREAKAWAY = 0.8
"""Share of the motor's torque limit with which it must press a blocked joint that locks before the other
joints of its couple go on without it [C]."""

_SAMPLES, _ALWAYS = 200, 0.9
"""Number of random postures, and share of them above which two colliding links overlap by design [C]."""


def rebuilt(data: Table, model: CompiledModel, label: str) -> Hand:
    """Make the hand of a description and a compiled model.

    Args:
        data: The description, as read from TOML.
        model: The model that it names.
        label: File or name, which begins every message.

    Raises:
        HandError: Description or model has a fault; the first one is reported.
    """
    refuse([*description_findings(data), *model_findings(data, model)], label)
    data = with_model_couples(data, model.couples)
    try:
        with quiet_mujoco():
            mjcf = _mjcf(data, model)
    except (ValueError, TypeError, OverflowError, FloatingPointError) as error:
        raise HandError(
            f"{label}: the model cannot be rebuilt from simple shapes: {reason(error)}"
        ) from error
    bodies = _written_bodies(data, model)
    fingers = []
    for entry in data["finger"]:
        tip = {"tip_site": f"{entry['name']}_tip", "tip_body": bodies[str(entry["tip_body"])]}
        fingers.append({**rounded_to_limits(entry, model.ranges), **tip})
    palm = {"body": bodies[str(data["palm"]["body"])], "site": "palm_frame"}
    return hand_from({**data, "finger": fingers, "palm": palm}, mjcf)


def _mjcf(data: Table, model: CompiledModel) -> str:
    """The hand as MJCF text; description and model must have no findings.

    The text is written twice: the first version shows which pairs of bodies overlap by design, and the second
    one excludes these pairs from collision.
    """
    writer = _Writer(data, model)
    return writer.document(
        _overlapping_pairs(writer.document(()), model, writer.bodies, data.get("ignore", ()))
    )


def _written_bodies(data: Table, model: CompiledModel) -> dict[str, str]:
    """For every body of the hand, the body that it is merged into: itself, or the one that carries it."""
    listed = {str(joint) for entry in data["finger"] for joint in entry["joints"]}
    m = model.model
    root = m.body(data.get("root") or model.roots[0]).id
    written = {int(m.joint(joint).bodyid[0]) for joint in listed} | {root}
    names = {}
    for body in range(1, m.nbody):
        chain = model.chain(body)
        if root in chain:
            names[m.body(body).name] = m.body(next(b for b in chain if b in written)).name
    return names


class _Writer:
    """Writes one model as MJCF text."""

    def __init__(self, data: Table, source: CompiledModel) -> None:
        import mujoco

        self.data, self.source, self.m = data, source, source.model
        listed = [str(joint) for entry in data["finger"] for joint in entry["joints"]]
        self.joints = sorted(listed, key=lambda joint: int(self.m.joint(joint).id))
        self.bodies = _written_bodies(data, source)
        self.state = mujoco.MjData(self.m)
        self.state.qpos[:] = 0.0
        for joint in range(self.m.njnt):
            if self.m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
                self.state.qpos[self.m.jnt_qposadr[joint] + 3] = 1.0
        fixed = data.get("fixed", {})
        for joint, angle in fixed.items() if isinstance(fixed, dict) else ():
            self.state.qpos[self.m.jnt_qposadr[self.m.joint(joint).id]] = float(angle)
        mujoco.mj_kinematics(self.m, self.state)
        mujoco.mj_comPos(self.m, self.state)
        self.frames = {
            self.m.body(b).name: pose(self.state.xmat[b].reshape(3, 3), self.state.xpos[b])
            for b in range(1, self.m.nbody)
        }
        self.written = [name for name in self.frames if self.bodies.get(name) == name]
        self.root = self.written[0]
        fingers = [finger_from(entry) for entry in data["finger"]]
        self.limits, self.motors = motors_within(data, source.ranges, self.joints, fingers)
        self.finger_of = {
            self.m.body(int(self.m.joint(joint).bodyid[0])).name: str(entry["name"])
            for entry in data["finger"]
            for joint in map(str, entry["joints"])
        }

    def document(self, excluded: tuple[tuple[str, str], ...]) -> str:
        """The MJCF, with pairs of bodies that are excluded from collision."""
        self.meshes: list[str] = []
        bodies = self._body(self.root, np.eye(4), 2)
        lines = [
            f"<mujoco model={quoteattr(str(self.data['name']))}>",
            '  <compiler angle="radian" autolimits="true" balanceinertia="true"/>',
            '  <option jacobian="dense"/>',
            "  <default>",
            '    <geom condim="4" friction="1 0.02 0.0001"/>',
            "  </default>",
            *(["  <asset>", *self.meshes, "  </asset>"] if self.meshes else []),
            "  <worldbody>",
            *bodies,
            "  </worldbody>",
            "  <contact>",
        ]
        lines += [f"    <exclude body1={quoteattr(a)} body2={quoteattr(b)}/>" for a, b in excluded]
        return "\n".join([*lines, "  </contact>", *self._drives(), "</mujoco>", ""])

    def _parent(self, name: str) -> str | None:
        parent = int(self.m.body_parentid[self.m.body(name).id])
        return self.bodies.get(self.m.body(parent).name) if parent > 0 else None

    def _body(self, name: str, T_parent_body: Array, depth: int) -> list[str]:
        pad = "  " * depth
        lines = [f"{pad}<body name={quoteattr(name)} {frame_text(T_parent_body)}>"]
        lines += [f"{pad}  {text}" for text in self._inside(name)]
        for child in self.written:
            if child != name and self._parent(child) == name:
                lines += self._body(child, inverse(self.frames[name]) @ self.frames[child], depth + 1)
        return [*lines, f"{pad}</body>"]

    def _inside(self, name: str) -> list[str]:
        """Inertia, joints, shapes and sites of one written body."""
        members = [self.m.body(body).id for body, owner in self.bodies.items() if owner == name]
        T_body_world = inverse(self.frames[name])
        lines = [self._inertia(members, T_body_world)]
        body = self.m.body(name).id
        if name != self.root:
            first = int(self.m.body_jntadr[body])
            found = range(first, first + int(self.m.body_jntnum[body]))
            lines += [self._joint(j) for j in found if self.m.joint(j).name in self.joints]
        owner = self.finger_of.get(name, "palm")
        stem = name if name.startswith(f"{owner}_") else f"{owner}_{name}"
        pieces = self._pieces(members, T_body_world)
        for k, piece in enumerate(pieces):
            label = stem if len(pieces) == 1 else f"{stem}_{k}"
            lines.append(geom_text(label, piece))
            self.meshes += [f"    {mesh_text(label, piece)}"] if piece.kind == "hull" else []
        return lines + self._sites(name, T_body_world, pieces)

    def _joint(self, j: int) -> str:
        m, joint = self.m, self.m.joint(j)
        low, high = self.limits[joint.name]
        dof = int(m.jnt_dofadr[j])
        damping = float(np.ravel(m.dof_damping[dof])[0]) or _DAMPING
        armature, friction = float(m.dof_armature[dof]) or _ARMATURE, float(m.dof_frictionloss[dof])
        return (
            f'<joint name={quoteattr(joint.name)} type="hinge" pos="{numbers_text(m.jnt_pos[j])}" '
            f'axis="{numbers_text(m.jnt_axis[j])}" range="{low:.9g} {high:.9g}" '
            f'damping="{damping:.6g}" armature="{armature:.6g}" frictionloss="{friction:.6g}"/>'
        )

    def _inertia(self, members: list[int], T_body_world: Array) -> str:
        mass = np.array([self.m.body_mass[b] for b in members])
        total = max(float(mass.sum()), 1e-6)
        places = np.array([(T_body_world @ np.append(self.state.xipos[b], 1.0))[:3] for b in members])
        centre = mass @ places / total
        tensor = np.zeros((3, 3))
        for b, weight, place in zip(members, mass, places, strict=True):
            turn = T_body_world[:3, :3] @ self.state.ximat[b].reshape(3, 3)
            arm = place - centre
            tensor += turn @ np.diag(self.m.body_inertia[b]) @ turn.T
            tensor += weight * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        tensor += 1e-9 * np.eye(3)
        six = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
        return (
            f'<inertial pos="{numbers_text(centre)}" mass="{total:.9g}" fullinertia="{numbers_text(six)}"/>'
        )

    def _pieces(self, members: list[int], T_body_world: Array) -> list[Piece]:
        """The pieces of the bodies ``members``, in the frame of the body that is written."""
        found: list[Piece] = []
        for g in range(self.m.ngeom):
            body = int(self.m.geom_bodyid[g])
            if body in members and self.source.is_shape(g):
                T = pose(self.state.xmat[body].reshape(3, 3), self.state.xpos[body])
                T = T @ pose(rotation_from_quaternion(self.m.geom_quat[g]), self.m.geom_pos[g])
                found += geom_pieces(self.m, g, T_body_world @ T)
        return found

    def _sites(self, name: str, T_body_world: Array, pieces: list[Piece]) -> list[str]:
        """Sites of palm and fingertips; a tip also gets a sphere, unless its link has a shape there."""
        lines = []
        palm = self.data["palm"]
        if self.bodies[str(palm["body"])] == name:
            T = T_body_world @ self._palm_frame(palm)
            lines.append(f'<site name="palm_frame" {frame_text(T)} size="0.003"/>')
        for entry in self.data["finger"]:
            if self.bodies[str(entry["tip_body"])] == name:
                T, label = T_body_world @ self._tip_frame(entry), quoteattr(f"{entry['name']}_tip")
                radius = float(entry["tip_radius"])
                if not _has_tip(pieces, T[:3, 3], radius):
                    lines.append(
                        f'<geom name={label} type="sphere" {frame_text(T)} size="{radius:.6g}" mass="0" '
                        'rgba="0.2 0.2 0.22 1"/>'
                    )
                lines.append(f'<site name={label} {frame_text(T)} size="0.002"/>')
        return lines

    def _palm_frame(self, palm: Table) -> Array:
        if "site" in palm:
            return self._site(str(palm["site"]))
        z, y = direction(palm["points"], "palm.points"), -direction(palm["faces"], "palm.faces")
        local = pose(np.stack([np.cross(y, z), y, z], axis=1), palm.get("pos", (0.0, 0.0, 0.0)))
        return np.asarray(self.frames[str(palm["body"])] @ local)

    def _tip_frame(self, entry: Table) -> Array:
        T = self.frames[str(entry["tip_body"])].copy()
        if "tip_pos" in entry:
            T[:3, 3] = T[:3, :3] @ np.asarray(entry["tip_pos"], dtype=np.float64) + T[:3, 3]
        else:
            T = self._site(str(entry["tip_site"]))
        if "tip_points" in entry:
            z = direction(entry["tip_points"], "tip_points")
            x = np.cross(np.eye(3)[int(np.abs(z).argmin())], z)
            x /= np.linalg.norm(x)
            T[:3, :3] = self.frames[str(entry["tip_body"])][:3, :3] @ np.stack([x, np.cross(z, x), z], axis=1)
        return np.asarray(T)

    def _site(self, name: str) -> Array:
        site = self.m.site(name).id
        body = int(self.m.site_bodyid[site])
        local = pose(rotation_from_quaternion(self.m.site_quat[site]), self.m.site_pos[site])
        return np.asarray(pose(self.state.xmat[body].reshape(3, 3), self.state.xpos[body]) @ local)

    def _drives(self) -> list[str]:
        """Equalities of rigid laws, tendons of adaptive ones, and an actuator for every motor.

        An adaptive motor pulls a tendon. Each of its inequalities is a second tendon with a limit. Weak
        springs keep joints that nothing touches on the unloaded path if it is straight, and a clutch does if
        one of the joints locks.
        """
        drives, names = self.data["actuators"], tuple(motor.name for motor in self.motors)
        gains = per_motor(drives, "gain", "gains", names, "it")
        limits = per_motor(drives, "torque_limit", "torque_limits", names, "it")
        equalities, tendons, actuators = [], [], []
        for motor, gain, limit in zip(self.motors, gains, limits, strict=True):
            aim = f"joint={quoteattr(motor.name)}"
            if motor.law == ADAPTIVE:
                aim = f"tendon={quoteattr(motor.name)}"
                tendons += adaptive_tendons(motor, float(limit))
            elif motor.law != DIRECT:
                equalities += [
                    f"    <joint joint1={quoteattr(joint)} joint2={quoteattr(motor.name)} "
                    f'polycoef="{numbers_text(law)}" solref="{STIFF}" solimp="0.99 0.999 0.001"/>'
                    for joint, law in zip(motor.joints, motor.polynomials, strict=True)
                    if joint != motor.name
                ]
            low, high = motor.range
            actuators.append(
                f'    <position name={quoteattr(motor.name)} {aim} kp="{gain:.9g}" '
                f'kv="{float(drives["damping"]):.9g}" forcerange="{-limit:.9g} {limit:.9g}" '
                f'ctrlrange="{low:.9g} {high:.9g}"/>'
            )
        return [
            *(["  <equality>", *equalities, "  </equality>"] if equalities else []),
            *(["  <tendon>", *tendons, "  </tendon>"] if tendons else []),
            *["  <actuator>", *actuators, "  </actuator>"],
        ]


def adaptive_tendons(motor: Motor, torque_limit: float) -> list[str]:
    """The MJCF tendons of an adaptive motor: the one that it pulls, its inequalities and its springs.

    A couple with a joint that locks is one gear train until that joint is blocked (Barrett): it keeps to the
    unloaded path against what pushes a fingertip back. Dry friction between that joint and the others does
    so, up to the torque at which the others go on without it.
    """
    lines = [
        f"    <fixed name={quoteattr(motor.name)}>",
        *_parts(motor.joints, motor.weights),
        "    </fixed>",
    ]
    for low, high in motor.order:
        name = quoteattr(f"{high}-{low}")
        lines += [
            f'    <fixed name={name} limited="true" range="0 {2 * LARGEST_ANGLE:g}" solreflimit="{STIFF}" '
            'solimplimit="0.99 0.999 0.001">',
            *_parts((high, low), (1.0, -1.0)),
            "    </fixed>",
        ]
    laws = dict(zip(motor.joints, motor.polynomials[:, :2].tolist(), strict=True))
    base = motor.locks or motor.joints[0]
    b0, a0 = laws.pop(base)
    if not motor.affine or not a0:
        return lines
    for joint, (b, a) in laws.items():
        clutch = ""
        if motor.locks and a:
            # Of a tendon force F the other joint takes c F. It yields when the clutch cannot hold that.
            pull = BREAKAWAY * torque_limit * abs(float(motor.weights[motor.joints.index(joint)]))
            clutch = f'frictionloss="{pull:.9g}" solreffriction="{STIFF}" solimpfriction="{_RIGID}" '
        lines += [
            f"    <fixed name={quoteattr(f'{joint}~{base}')} {clutch}"
            f'stiffness="{SPRING:g}" damping="{SPRING_DAMPING:g}" springlength="{b - a / a0 * b0:.9g}">',
            *_parts((joint, base), (1.0, -a / a0)),
            "    </fixed>",
        ]
    return lines


def _parts(joints: Sequence[str], weights: Iterable[float]) -> list[str]:
    return [
        f'      <joint joint={quoteattr(joint)} coef="{c:.9g}"/>'
        for joint, c in zip(joints, weights, strict=True)
    ]


def _has_tip(pieces: list[Piece], centre: Array, radius: float) -> bool:
    """Whether a tip's centre is half a radius deep in hulls and boxes, of which a sphere might stand out.

    Together, not one by one: a cut between two pieces of a link may go through the tip.
    """
    solid = [piece for piece in pieces if piece.kind in ("hull", "box")]
    around = centre + ellipsoid_corners(np.full(3, 0.5 * radius))
    depths = [-outside(piece, around) for piece in solid]
    return bool(depths) and bool((np.max(depths, axis=0) >= 0.0).all())


def _overlapping_pairs(
    text: str, source: CompiledModel, bodies: dict[str, str], ignored: Iterable[Sequence[str]]
) -> tuple[tuple[str, str], ...]:
    """Pairs of bodies that are excluded from collision.

    These are neighbours in a chain, bodies that collide in nearly all random postures, and pairs that the
    source model or the description excludes.
    """
    import mujoco

    m = mujoco.MjModel.from_xml_string(text)
    state = mujoco.MjData(m)
    name = {b: m.body(b).name for b in range(m.nbody)}
    pairs = {(int(m.body_parentid[b]), b) for b in range(2, m.nbody)}
    rng = np.random.default_rng(0)
    count: dict[tuple[int, int], int] = {}
    for _ in range(_SAMPLES):
        state.qpos[:] = rng.uniform(m.jnt_range[:, 0], m.jnt_range[:, 1])
        mujoco.mj_kinematics(m, state)
        mujoco.mj_collision(m, state)
        hits = {
            (min(a, b), max(a, b))
            for a, b in (m.geom_bodyid[[c.geom1, c.geom2]].tolist() for c in state.contact if c.dist < 0)
        }
        for hit in hits:
            count[hit] = count.get(hit, 0) + 1
    pairs |= {pair for pair, times in count.items() if times >= _ALWAYS * _SAMPLES}
    own = {tuple(sorted((int(s) >> 16, int(s) & 0xFFFF))) for s in np.ravel(source.model.exclude_signature)}
    back = {label: b for b, label in name.items()}
    named = [(source.model.body(a).name, source.model.body(b).name) for a, b in own]
    for a, b in (*named, *ignored):
        one, other = bodies.get(a), bodies.get(b)
        if one and other and one != other:
            pairs.add((min(back[one], back[other]), max(back[one], back[other])))
    return tuple((name[a], name[b]) for a, b in sorted(pairs))
