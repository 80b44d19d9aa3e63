"""A hand for the physics tests: its MJCF, the body whose pose is given, and the joints in order."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..exceptions import EnvironmentFailure, HandError
from ..files import MOST_OF_MESH, MOST_OF_MODEL, read_file
from ..hands import menagerie
from ..hands.compiled import read_model
from ..hands.findings import LARGEST_ANGLE
from ..hands.hand import Hand
from ..hands.load import built_in_text, hand_names
from ..hands.motors import ADAPTIVE
from ..hands.rewrite import STIFF, rebuilt
from ..types import Array, freeze, frozen_array, value


@value
class PhysicsHand:
    """A hand model with all that a scene needs.

    An actuator on a fixed tendon drives all joints of the tendon. Its target is the sum of the joint angles,
    each times its coefficient in the tendon.

    Attributes:
        name: Name of the hand.
        mjcf: Text of the MJCF.
        assets: Content of each mesh that the MJCF names, by file name without folder.
        root: Name of the body whose pose is given. Its subtree is the hand; bodies above it are left out.
        joints: Joint names in the order of the angles; other joints below ``root`` are fixed at zero.
        T_root_palm: (4, 4) palm frame in the frame of ``root``, for poses that are given as palm poses.
        source: Name or file that the hand is loaded from; by default its name.
        order: Pairs of joints, of which the first one's angle is never above the second one's, that the MJCF
            itself does not enforce.
        gains: (m,) gains of the motors [N m/rad], in the order of :class:`~preshape.hands.hand.Hand`'s, where
            they differ from those of the hand that plans; a squeeze is aimed again for them.
        own_gains: Whether squeezes are aimed for the gains of the model, so that no test may replace them.
        damping: Damping of the position servos that replaces the model's [N m s/rad]; ``None`` keeps it.
    """

    name: str
    mjcf: str
    assets: tuple[tuple[str, bytes], ...]
    root: str
    joints: tuple[str, ...]
    T_root_palm: Array
    source: str = ""
    order: tuple[tuple[str, str], ...] = ()
    gains: Array | None = None
    own_gains: bool = False
    damping: float | None = None

    def __post_init__(self) -> None:
        if self.gains is not None:
            freeze(self, gains=frozen_array(self.gains, (None,), f"{self.name}: gains"))
        freeze(self, T_root_palm=frozen_array(self.T_root_palm, (4, 4), f"{self.name}: palm frame"))
        freeze(self, source=self.source or self.name)

    @property
    def digest(self) -> str:
        """Hash of the content; hands with equal digests behave identically."""
        content = self.mjcf, self.root, self.joints, self.own_gains, self.damping, *self.order
        state = hashlib.sha256(repr(content).encode())
        for name, asset in self.assets:
            state.update(name.encode() + b"\0" + hashlib.sha256(asset).digest())
        return state.hexdigest()

    def spec(self) -> Any:
        """A new ``mujoco.MjSpec`` of the model with the joints in ``joints`` only and without visual geoms.

        Raises:
            HandError: MuJoCo cannot read the MJCF, or it lacks the root or a joint.
        """
        import mujoco

        try:
            spec = mujoco.MjSpec.from_string(self.mjcf)
        except ValueError as error:
            raise HandError(f"{self.name}: MuJoCo cannot read the hand's MJCF: {error}") from error
        for mesh in spec.meshes:
            mesh.file = Path(mesh.file).name
        spec.meshdir = ""
        spec.assets = dict(self.assets)
        known = {joint.name for joint in spec.joints}
        for joint in self.joints:
            if joint not in known:
                raise HandError(
                    f"{self.name}: the MJCF has no joint {joint!r}; it has {', '.join(sorted(known))}"
                )
        if spec.body(self.root) is None:
            raise HandError(f"{self.name}: the MJCF has no body {self.root!r}")
        _fix_other_joints(spec, set(self.joints))
        for low, high in self.order:
            _add_order(spec, low, high)
        for geom in list(spec.geoms):
            if _is_visual(geom):
                spec.delete(geom)
        return spec


def physics_hand(hand: Hand) -> PhysicsHand:
    """Convert a hand of :mod:`preshape.hands`; its poses are those of the first body of its MJCF.

    Raises:
        HandError: The MJCF cannot be read, or its first body has no name.
    """
    try:
        root = ElementTree.fromstring(hand.mjcf).find("worldbody/body")
    except ElementTree.ParseError as error:
        raise HandError(f"{hand.name}: the MJCF is not XML: {error}") from error
    if root is None or not root.get("name"):
        raise HandError(f"{hand.name}: the MJCF's first body has no name; give it one")
    return PhysicsHand(
        name=hand.name,
        mjcf=hand.mjcf,
        assets=(),
        root=str(root.get("name")),
        joints=hand.joints,
        T_root_palm=hand.T_root_palm,
        source=hand.source,
        # The field's test prescribes a gain; squeezes for built-in hands are aimed for it or for none.
        own_gains=hand.source.partition(":")[0] not in hand_names(),
    )


def hand_from_mjcf(
    path: str | Path, *, root: str, fixed: tuple[str, ...] = (), name: str = ""
) -> PhysicsHand:
    """Make a hand from an MJCF file and the meshes beside it, for comparison with published models.

    Args:
        path: The MJCF file.
        root: Name of the body whose pose is given.
        fixed: Names of joints that are fixed at zero.
        name: Name of the hand; by default that of the file.

    Raises:
        HandError: MuJoCo cannot read the file, or it has no such body.
        EnvironmentFailure: A file is missing or cannot be read.
    """
    import mujoco

    path = Path(path)
    try:
        text = read_file(path, MOST_OF_MODEL, "model of a hand", refusal=HandError).decode("utf-8")
        spec = mujoco.MjSpec.from_string(text)
        folder = path.parent / spec.meshdir
        files = sorted({mesh.file for mesh in spec.meshes})
        assets = tuple(
            (Path(file).name, read_file(folder / file, MOST_OF_MESH, "mesh", refusal=HandError))
            for file in files
        )
    except OSError as error:
        raise EnvironmentFailure(f"cannot read {error.filename}: {error.strerror}") from error
    except (ValueError, UnicodeDecodeError) as error:
        raise HandError(f"{path}: MuJoCo cannot read it: {error}") from error
    body = spec.body(root)
    if body is None:
        known = ", ".join(body.name for body in spec.bodies)
        raise HandError(f"{path}: no body {root!r}; it has {known}")
    # A joint of the root itself moves the whole hand; here the root is free.
    inner = [joint for joint in body.find_all("joint") if joint.parent.name != root]
    joints = tuple(joint.name for joint in inner if joint.name not in fixed)
    return PhysicsHand(
        name=name or path.stem, mjcf=text, assets=assets, root=root, joints=joints, T_root_palm=np.eye(4)
    )


def published_hand(hand: Hand, path: str | Path) -> PhysicsHand:
    """The published model of a built-in hand, with its own meshes, gains and torque limits.

    It takes the poses of the built-in hand: joints have the same names, and the palm frame is the same. The
    inequalities of its couples, which MJCF models leave out, are added.

    Args:
        hand: The built-in hand.
        path: ``right_hand.xml`` of its model in MuJoCo Menagerie.

    Raises:
        HandError: No published model of the hand is known, or the file is not that model.
        EnvironmentFailure: A file is missing or cannot be read.
    """
    data = menagerie.adapted(built_in_text(hand.name)[0], menagerie.model_of(hand.name))
    compiled = read_model(Path(path))
    own = physics_hand(rebuilt(data, compiled, str(path)))
    fixed = tuple(str(joint) for joint in data.get("fixed", ()))
    model = hand_from_mjcf(path, root=own.root, fixed=fixed, name=f"{hand.name} ({Path(path).name})")
    order = tuple(pair for motor in hand.motors for pair in motor.order)
    return replace(
        model,
        T_root_palm=own.T_root_palm,
        order=order,
        gains=_motor_gains(hand, compiled.model, str(path)),
        own_gains=True,
    )


def _motor_gains(hand: Hand, model: Any, label: str) -> Array:
    """(m,) gains of the position actuators of a model that drive the same joints as the hand's motors [N
    m/rad].

    Raises:
        HandError: A motor has no such actuator.
    """
    import mujoco

    gains = {}
    for k in range(model.nu):
        target = int(model.actuator_trnid[k, 0])
        if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_TENDON:
            first = int(model.tendon_adr[target])
            wraps = range(first, first + int(model.tendon_num[target]))
            joints = frozenset(model.joint(int(model.wrap_objid[w])).name for w in wraps)
        else:
            joints = frozenset([model.joint(target).name])
        gains[joints] = float(model.actuator_gainprm[k, 0])
    found = []
    for motor in hand.motors:
        driven = frozenset(motor.joints if motor.law == ADAPTIVE else [motor.name])
        if driven not in gains:
            raise HandError(f"{label}: no position actuator drives what the motor {motor.name} drives")
        found.append(gains[driven])
    return np.array(found)


def _add_order(spec: Any, low: str, high: str) -> None:
    """Add a tendon whose limit keeps the angle of one joint at or below that of another."""
    tendon = spec.add_tendon(name=f"{high}-{low}", limited=True, range=[0.0, 2 * LARGEST_ANGLE])
    stiff = [float(x) for x in STIFF.split()]
    tendon.solref_limit[:2], tendon.solimp_limit[:3] = stiff, [0.99, 0.999, 0.001]
    tendon.wrap_joint(high, 1.0)
    tendon.wrap_joint(low, -1.0)


def _fix_other_joints(spec: Any, wanted: set[str]) -> None:
    """Delete all joints but the wanted ones, with the actuators that drive them."""
    for actuator in list(spec.actuators):
        if actuator.target not in wanted and spec.tendon(actuator.target) is None:
            spec.delete(actuator)
    for joint in list(spec.joints):
        if joint.name not in wanted:
            spec.delete(joint)
    for key in list(spec.keys):  # keyframes hold the angles of all joints
        spec.delete(key)


def _is_visual(geom: Any) -> bool:
    """Whether a geom neither collides nor has mass."""
    massless = geom.parent.explicitinertial or geom.density == 0 or geom.mass == 0
    return geom.contype == 0 and geom.conaffinity == 0 and bool(massless)
