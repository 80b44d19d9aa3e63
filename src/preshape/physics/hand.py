"""A hand as the physics needs it: an MJCF, the body that poses are given for, and the joints in order."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..exceptions import EnvironmentFailure, HandError
from ..hands.hand import Hand
from ..types import Array, freeze, frozen_array, value


@value
class PhysicsHand:
    """A hand model with everything that a scene needs of it.

    The actuators of the MJCF say which joints are driven together: one on a fixed tendon drives all of its
    joints, and is told the sum of their angles times the tendon's coefficients.

    Attributes:
        name: for people.
        mjcf: text of the MJCF.
        assets: file name (no folder) and content of each mesh that the MJCF names.
        root: the body whose pose is given; its subtree is the hand, what stands before it is left out.
        joints: joint names in the order of the angles; other joints below ``root`` are fixed at zero.
        T_root_palm: (4, 4) palm frame in the frame of ``root``, for poses given as palm poses.
        source: What loads the hand again, a name or a file; default the name.
    """

    name: str
    mjcf: str
    assets: tuple[tuple[str, bytes], ...]
    root: str
    joints: tuple[str, ...]
    T_root_palm: Array
    source: str = ""

    def __post_init__(self) -> None:
        freeze(self, T_root_palm=frozen_array(self.T_root_palm, (4, 4), f"{self.name}: palm frame"))
        freeze(self, source=self.source or self.name)

    @property
    def digest(self) -> str:
        """Hash of the content; two hands with the same digest behave the same."""
        state = hashlib.sha256(repr((self.mjcf, self.root, self.joints)).encode())
        for name, content in self.assets:
            state.update(name.encode() + b"\0" + hashlib.sha256(content).digest())
        return state.hexdigest()

    def spec(self) -> Any:
        """The model as a fresh ``mujoco.MjSpec``: only the wanted joints, no parts for show.

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
        for geom in list(spec.geoms):
            if _only_for_show(geom):
                spec.delete(geom)
        return spec


def physics_hand(hand: Hand) -> PhysicsHand:
    """A hand of the package, its poses given for the MJCF's root body."""
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
    )


def hand_from_mjcf(
    path: str | Path, *, root: str, fixed: tuple[str, ...] = (), name: str = ""
) -> PhysicsHand:
    """A hand from an MJCF file and the meshes beside it, for checks against published models.

    Args:
        path: the file.
        root: the body whose pose is given.
        fixed: joints that are left out, fixed at zero.
        name: for people; default the file's name.

    Raises:
        HandError: MuJoCo cannot read the file, or it has no such body.
        EnvironmentFailure: a file is missing or cannot be read.
    """
    import mujoco

    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        spec = mujoco.MjSpec.from_string(text)
        folder = path.parent / spec.meshdir
        files = sorted({mesh.file for mesh in spec.meshes})
        assets = tuple((Path(file).name, (folder / file).read_bytes()) for file in files)
    except OSError as error:
        raise EnvironmentFailure(f"cannot read {error.filename}: {error.strerror}") from error
    except (ValueError, UnicodeDecodeError) as error:
        raise HandError(f"{path}: MuJoCo cannot read it: {error}") from error
    body = spec.body(root)
    if body is None:
        known = ", ".join(body.name for body in spec.bodies)
        raise HandError(f"{path}: no body {root!r}; it has {known}")
    joints = tuple(joint.name for joint in body.find_all("joint") if joint.name not in fixed)
    return PhysicsHand(
        name=name or path.stem, mjcf=text, assets=assets, root=root, joints=joints, T_root_palm=np.eye(4)
    )


def _fix_other_joints(spec: Any, wanted: set[str]) -> None:
    """Delete every joint that is not wanted, with the actuators that drive it."""
    for actuator in list(spec.actuators):
        if actuator.target not in wanted and spec.tendon(actuator.target) is None:
            spec.delete(actuator)
    for joint in list(spec.joints):
        if joint.name not in wanted:
            spec.delete(joint)
    for key in list(spec.keys):  # written for all joints
        spec.delete(key)


def _only_for_show(geom: Any) -> bool:
    """Whether a geom neither touches anything nor weighs anything."""
    massless = geom.parent.explicitinertial or geom.density == 0 or geom.mass == 0
    return geom.contype == 0 and geom.conaffinity == 0 and bool(massless)
