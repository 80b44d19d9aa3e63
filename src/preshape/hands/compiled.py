"""A hand's model, an MJCF or a URDF, as MuJoCo compiles it.

MuJoCo refuses or silently repairs reversed limits and massless bodies. Here they are accepted and recorded,
so that :mod:`preshape.hands.findings` can report all faults of a model at once.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from html import unescape
from itertools import count
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..exceptions import HandError
from ..files import MOST_OF_MESH, MOST_OF_MODEL, read_file
from ..objects.read_text import printable
from ..types import value
from .laws import model_couples
from .ros_files import mend_spec, model_text, use_visual_shapes

_TINY = 1e-9  # [kg] given to a massless body, so that the model compiles and the body can be reported
_LONGEST_REASON = 600  # characters
_MOST_REPEATS = 1000  # [C]


@value
class CompiledModel:
    """A compiled model with the names and faults of its parts.

    Attributes:
        model: The ``mujoco.MjModel``; do not change it.
        bodies: Names of its bodies. A body without a name in the file gets one.
        sites: Names of its sites.
        roots: Names of the bodies whose parent is the world.
        joints: Names of its joints in the model's order, without free joints.
        hinges: Names of those joints that are hinges.
        ranges: Lower and upper limit of every joint as written in the file [rad]; equal if it has no limits.
        massless: Names of moving bodies without mass.
        label: File or name, which begins messages.
        notes: What was mended in the file so that it could be used, each in one sentence.
    """

    model: Any
    bodies: tuple[str, ...]
    sites: tuple[str, ...]
    roots: tuple[str, ...]
    joints: tuple[str, ...]
    hinges: tuple[str, ...]
    ranges: dict[str, tuple[float, float]]
    massless: tuple[str, ...]
    label: str = "the model"
    notes: tuple[str, ...] = ()

    @property
    def couples(self) -> tuple[dict[str, Any], ...]:
        """The laws that the model states, as ``[[couple]]`` tables; see :func:`.laws.model_couples`."""
        return model_couples(self.model, self.label)

    def is_shape(self, geom: int) -> bool:
        """Whether a geom is one of the hand's shapes: it collides, as visual ones do where no other does."""
        return bool(self.model.geom_contype[geom] or self.model.geom_conaffinity[geom])

    def joints_under(self, root: str | None) -> tuple[str, ...]:
        """Names of the joints that move bodies relative to the body ``root``; all if it does not exist."""
        if root is None or root not in self.bodies:
            return self.joints
        top = self.model.body(root).id
        return tuple(
            joint for joint in self.joints if top in self.chain(int(self.model.joint(joint).bodyid[0]))[1:]
        )

    def chain(self, body: int) -> list[int]:
        """Indices of a body and of the bodies that carry it, from the body to the root, without the world."""
        chain = []
        while body > 0:
            chain.append(body)
            body = int(self.model.body_parentid[body])
        return chain


def read_model(source: Path | str) -> CompiledModel:
    """Compile an MJCF or a URDF.

    Args:
        source: A file, or the text of an MJCF.

    Raises:
        HandError: MuJoCo cannot read it.
    """
    with quiet_mujoco():
        return _compiled(source)


def read_spec(path: Path, notes: list[str], lost: list[str]) -> Any:
    """The ``mujoco.MjSpec`` of a file, to be added to and compiled with :func:`compiled_spec`.

    Args:
        path: The file.
        notes: What was mended is added to it.
        lost: The names of meshes that do not exist are added to it; their shapes are left out.

    Raises:
        HandError: MuJoCo cannot read it.
    """
    with quiet_mujoco(), _told(str(path)):
        _refuse_repetitions(path, str(path))
        return _named_spec(path, notes, lost)


def _compiled(source: Path | str) -> CompiledModel:
    import mujoco

    label = str(source) if isinstance(source, Path) else "the MJCF"
    _refuse_repetitions(source, label)
    with _told(label):
        notes: list[str] = []
        spec = _named_spec(source, notes, None)
        spec.compiler.boundmass, spec.compiler.boundinertia = _TINY, 1e-3 * _TINY
        degrees = np.pi / 180 if spec.compiler.degree else 1.0
        ranges = {}
        for joint in spec.joints:
            if joint.type == mujoco.mjtJoint.mjJNT_FREE:
                continue
            low, high = (float(bound) for bound in joint.range)
            scale = degrees if joint.type == mujoco.mjtJoint.mjJNT_HINGE else 1.0
            ranges[joint.name] = (low * scale, high * scale)
            if low > high:
                joint.range = [high, low]
        model = compiled_spec(spec)
        if isinstance(source, Path):
            notes += use_visual_shapes(model)
        return _recorded(model, ranges, label, tuple(notes))


def _refuse_repetitions(source: Path | str, label: str) -> None:
    if (parts := _repetitions(source)) > _MOST_REPEATS:
        raise HandError(f"{label}: it repeats a part {parts:.3g} times; at most {_MOST_REPEATS} are allowed")


@contextmanager
def _told(label: str) -> Iterator[None]:
    """Turn what MuJoCo and the readers raise into errors that say what to change."""
    try:
        yield
    except UnicodeDecodeError as error:
        raise HandError(f"{label}: its text or a name in it is not UTF-8; save the model as UTF-8") from error
    except RecursionError as error:
        raise HandError(f"{label}: its elements are nested too deep for a model") from error
    except (ValueError, ElementTree.ParseError, LookupError, OSError) as error:
        raise HandError(f"{label}: MuJoCo cannot read it: {reason(error)}") from error


def _named_spec(source: Path | str, notes: list[str], lost: list[str] | None) -> Any:
    """The ``mujoco.MjSpec`` of a file, or of the text of an MJCF, in which every body has a name."""
    import mujoco

    if isinstance(source, Path):
        spec = _spec_of(source, notes, lost)
        _check_assets(spec, source.parent)
    else:
        spec = mujoco.MjSpec.from_string(source)
    _name_all(spec)
    spec.compiler.fusestatic = False
    return spec


def _spec_of(path: Path, notes: list[str], lost: list[str] | None) -> Any:
    """The ``mujoco.MjSpec`` of a file, mended; what was mended is added to ``notes``."""
    import mujoco

    try:
        found = model_text(path, lost)
    except ElementTree.ParseError:
        if path.suffix.lower() in (".urdf", ".xacro"):
            raise
        return mujoco.MjSpec.from_file(str(path))  # MuJoCo accepts some text that is not well formed
    notes += found.notes
    if found.urdf:
        return mujoco.MjSpec.from_string(found.text, assets=found.assets)
    spec = mujoco.MjSpec.from_file(str(path)) if found.whole else mujoco.MjSpec.from_string(found.text)
    notes += mend_spec(spec, path)
    return spec


def compiled_spec(spec: Any) -> Any:
    """The ``mujoco.MjModel``; flat meshes, which MuJoCo refuses as solids, count as shells."""
    import mujoco

    try:
        return spec.compile()
    except ValueError as error:
        if "too small" not in str(error):
            raise
        for mesh in spec.meshes:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    try:
        return spec.compile()
    except ValueError as error:
        if "too small" not in str(error):
            raise
        raise ValueError(f"{error}; is the scale of this mesh right?") from error


def _recorded(
    model: Any, ranges: dict[str, tuple[float, float]], label: str, notes: tuple[str, ...]
) -> CompiledModel:
    import mujoco

    kinds = {model.joint(j).name: int(model.jnt_type[j]) for j in range(model.njnt)}
    joints = tuple(name for name, kind in kinds.items() if kind != mujoco.mjtJoint.mjJNT_FREE)
    mass = np.zeros(model.nbody)
    np.add.at(mass, model.body_weldid, model.body_mass)
    moving = [body for body in range(1, model.nbody) if model.body_jntnum[body] > 0]
    return CompiledModel(
        model=model,
        bodies=tuple(model.body(b).name for b in range(1, model.nbody)),
        sites=tuple(model.site(s).name for s in range(model.nsite)),
        roots=tuple(model.body(b).name for b in range(1, model.nbody) if model.body_parentid[b] == 0),
        joints=joints,
        hinges=tuple(joint for joint in joints if kinds[joint] == mujoco.mjtJoint.mjJNT_HINGE),
        ranges={joint: ranges.get(joint, (0.0, 0.0)) for joint in joints},
        massless=tuple(
            model.body(b).name for b in moving if mass[b] < 10 * _TINY * (model.body_weldid == b).sum()
        ),
        label=label,
        notes=notes,
    )


def _repetitions(source: Path | str) -> float:
    """How often an MJCF, or a file that it includes, repeats a part through nested ``count`` attributes.

    MuJoCo makes every copy before it checks anything, so a single line could ask for more than all memory.
    """
    most, seen = 1.0, {source}
    pending: list[tuple[Path | str, float]] = [(source, 1.0)]
    while pending:
        place, times = pending.pop()
        try:
            text = place.encode() if isinstance(place, str) else _model_text(place)
        except (OSError, ValueError):
            continue  # MuJoCo's own message is better
        try:
            root = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError, LookupError):
            # MuJoCo's parser accepts some text that is not well formed. Then assume the worst: every count
            # is nested in all counts before it.
            for counts in re.findall(
                r"""count\s*=\s*["']([^"']*)""", unescape(text.decode("utf-8", "replace"))
            ):
                for number in counts.split():
                    times *= max(1.0, _number(number))
            most = max(most, times)
            continue
        elements = [(root, times)]
        while elements:
            element, times = elements.pop()
            for number in element.get("count", "").split():
                times *= max(1.0, _number(number))  # max() in this order turns "nan" into 1
            most = max(most, times)
            elements += [(child, times) for child in element]
            if element.tag == "include" and isinstance(place, Path):
                other = place.parent / element.get("file", "")
                if other not in seen:
                    seen.add(other)
                    pending.append((other, times))
    return most


def _model_text(path: Path) -> bytes:
    return read_file(path, MOST_OF_MODEL, "model", refusal=HandError)


def _check_assets(spec: Any, folder: Path) -> None:
    """Refuse meshes, height fields and textures that MuJoCo would wait for, or that do not fit into memory.

    Raises:
        HandError: One of these files is no regular file, is too large, or is a Git LFS pointer.
    """
    named = [(spec.meshdir, item.file) for item in (*spec.meshes, *spec.hfields, *spec.skins)]
    named += [(spec.texturedir, item.file) for item in spec.textures]
    for place, file in {(place, file) for place, file in named if file}:
        with suppress(OSError, ValueError):  # MuJoCo's own message is better
            read_file(folder / place / file, MOST_OF_MESH, "mesh", refusal=HandError)


def _number(text: str) -> float:
    """The number, or 1 if the text is none."""
    try:
        return float(text)
    except ValueError:
        return 1.0


def _name_all(spec: Any) -> None:
    """Give unnamed bodies and joints a name such as ``body_3``, because parts are looked up by name."""
    for noun, elements in (("body", spec.bodies), ("joint", spec.joints)):
        taken = {element.name for element in elements}
        free = (name for k in count() if (name := f"{noun}_{k}") not in taken)
        for element in elements:
            if not element.name:
                element.name = next(free)


def reason(error: Exception) -> str:
    """The message of another library's error, printable and of bounded length."""
    return printable(str(error).removeprefix("Error: "), _LONGEST_REASON)


@contextmanager
def no_mujoco_log() -> Iterator[None]:
    """Keep MuJoCo from writing its warnings to MUJOCO_LOG.TXT in the working folder."""
    import mujoco

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


@contextmanager
def quiet_mujoco() -> Iterator[None]:
    """Like :func:`no_mujoco_log`, but also suppress Python warnings."""
    with no_mujoco_log(), warnings.catch_warnings(action="ignore", category=UserWarning):
        yield
