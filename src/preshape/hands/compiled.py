"""Anyone's hand: a TOML that names an MJCF or a URDF, read through MuJoCo and rebuilt from primitives.

The model is compiled, and written again as an MJCF of our own form: one root body, fingers as chains of
hinges, static bodies joined to the body that carries them, every shape that collides as capsule, sphere or
box, a site in the palm and one in every fingertip. Whatever reads a hand then meets one form, and the text
needs no file beside it.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from html import unescape
from itertools import count
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..exceptions import HandError
from ..objects.read_text import shown
from ..types import Array, value
from .description import Table
from .findings import description_findings, model_findings, refuse
from .hand import Hand
from .load import hand_from, hand_names, read_description

_TINY = 1e-9  # [kg] that MuJoCo gives a massless body here, so that it can be named
_LONGEST_REASON = 600  # characters
_MOST_REPEATS = 1000  # [C]


@value
class ForeignModel:
    """A model as MuJoCo compiled it, with what it would have refused set right and remembered.

    Attributes:
        model: the ``mujoco.MjModel``; do not change it.
        bodies: names of its bodies; those without one have been given one.
        sites: names of its sites.
        roots: names of the bodies that stand on the world.
        joints: names of its joints but free ones, in order.
        hinges: names of those that are hinges.
        ranges: lower and upper limit of every joint as written [rad]; equal without limits.
        massless: names of moving bodies without mass.
    """

    model: Any
    bodies: tuple[str, ...]
    sites: tuple[str, ...]
    roots: tuple[str, ...]
    joints: tuple[str, ...]
    hinges: tuple[str, ...]
    ranges: dict[str, tuple[float, float]]
    massless: tuple[str, ...]

    def joints_under(self, root: str | None) -> tuple[str, ...]:
        """Names of the joints that move a body of the root's tree against it; of all without one."""
        if root is None or root not in self.bodies:
            return self.joints
        top = self.model.body(root).id
        return tuple(
            joint
            for joint in self.joints
            if top in ancestors(self.model, int(self.model.joint(joint).bodyid[0]))[1:]
        )


def load_foreign(path: Path) -> Hand:
    """The hand of a TOML file.

    Raises:
        HandError: no such file, or the first thing that is wrong with it.
        EnvironmentFailure: a file cannot be read.
    """
    data = read_description(path)
    if data.get("name") in hand_names():
        raise HandError(f"{path}: a built-in hand is called {data['name']}; choose another name")
    return rebuilt(data, read_model(model_file(data, path)), str(path))


def model_file(data: Table, path: Path) -> Path:
    """The model that a description names, beside it.

    Raises:
        HandError: it names none, or there is none.
    """
    named = data.get("model", data.get("mjcf"))
    if not isinstance(named, str):
        raise HandError(f"{path}: the description lacks 'model', the MJCF or URDF of the hand")
    file = path.parent / named
    try:
        found = file.is_file()
    except OSError:  # no name for a file at all
        found = False
    if not found:
        raise HandError(f"{path}: there is no model {shown(file, 400)}")
    return file


def read_model(source: Path | str) -> ForeignModel:
    """Compile an MJCF or a URDF; limits the wrong way round and masses of zero are let through and noted.

    Args:
        source: a file, or the text of an MJCF.

    Raises:
        HandError: MuJoCo refuses it.
    """
    with _quietly():
        return _compiled(source)


def _compiled(source: Path | str) -> ForeignModel:
    import mujoco

    label = str(source) if isinstance(source, Path) else "the MJCF"
    if (parts := _repeats(source)) > _MOST_REPEATS:
        raise HandError(f"{label}: it repeats a part {parts:.3g} times; a hand has {_MOST_REPEATS} at most")
    try:
        if isinstance(source, Path) and source.suffix.lower() == ".urdf":
            spec = mujoco.MjSpec.from_string(_urdf_text(source))
        elif isinstance(source, Path):
            spec = mujoco.MjSpec.from_file(str(source))
        else:
            spec = mujoco.MjSpec.from_string(source)
        _name_all(spec)
        spec.compiler.fusestatic = False
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
        return _noted(spec.compile(), ranges)
    except UnicodeDecodeError as error:
        raise HandError(f"{label}: its text or a name in it is not UTF-8; save the model as UTF-8") from error
    except RecursionError as error:
        raise HandError(f"{label}: its elements are nested too deep for a model of a hand") from error
    except (ValueError, ElementTree.ParseError, LookupError, OSError) as error:
        raise HandError(f"{label}: MuJoCo cannot read it: {_reason(error)}") from error


def _repeats(source: Path | str) -> float:
    """How often an MJCF, or what it includes, repeats a part by ``count``, one repetition inside another.

    MuJoCo makes every copy before it says anything: a line can ask for more than there is memory.
    """
    most, seen = 1.0, {source}
    rest: list[tuple[Path | str, float]] = [(source, 1.0)]
    while rest:
        place, times = rest.pop()
        try:
            text = place.read_bytes() if isinstance(place, Path) else place.encode()
        except (OSError, ValueError):
            continue  # MuJoCo says it better
        try:
            root = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError, LookupError):
            # MuJoCo's parser forgives what is not well formed: as if each stood inside those before it.
            for counts in re.findall(
                r"""count\s*=\s*["']([^"']*)""", unescape(text.decode("utf-8", "replace"))
            ):
                for number in counts.split():
                    times *= max(1.0, _number(number))
            most = max(most, times)
            continue
        inside = [(root, times)]
        while inside:
            element, times = inside.pop()
            for number in element.get("count", "").split():
                times *= max(1.0, _number(number))  # so "nan" counts once
            most = max(most, times)
            inside += [(child, times) for child in element]
            if element.tag == "include" and isinstance(place, Path):
                other = place.parent / element.get("file", "")
                if other not in seen:
                    seen.add(other)
                    rest.append((other, times))
    return most


def _number(text: str) -> float:
    """A number, or one where there is none."""
    try:
        return float(text)
    except ValueError:
        return 1.0


def _name_all(spec: Any) -> None:
    """Names for bodies and joints without one, ``body_3``: what has no name cannot be looked up by it."""
    for noun, things in (("body", spec.bodies), ("joint", spec.joints)):
        taken = {thing.name for thing in things}
        free = (name for k in count() if (name := f"{noun}_{k}") not in taken)
        for thing in things:
            if not thing.name:
                thing.name = next(free)


def _reason(error: Exception) -> str:
    """What another library complains of, fit for a message."""
    return shown(str(error).removeprefix("Error: "), _LONGEST_REASON)


@contextmanager
def no_mujoco_log() -> Iterator[None]:
    """MuJoCo's warnings are not written to a MUJOCO_LOG.TXT in the working folder."""
    import mujoco

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


@contextmanager
def _quietly() -> Iterator[None]:
    """Nor on the screen."""
    with no_mujoco_log(), warnings.catch_warnings(action="ignore", category=UserWarning):
        yield


def _urdf_text(path: Path) -> str:
    """A URDF with the paths of its meshes made absolute: ``package://`` means nothing to MuJoCo."""
    root = ElementTree.parse(path).getroot()
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "").removeprefix("file://")
        package = name.startswith("package://")
        # The package is a folder above the URDF, by its own name or by another.
        rest = name.removeprefix("package://").partition("/")[2] if package else name
        folder = path.resolve().parent
        places = (
            [up / part for up in (folder, *folder.parents) for part in (rest, name[10:])] if package else []
        )
        found = next((place for place in [folder / name, *places] if place.is_file()), None)
        mesh.set("filename", str(found) if found is not None else name)
    settings = root.find("mujoco/compiler")
    if settings is None:
        settings = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    settings.set("strippath", "false")
    return ElementTree.tostring(root, encoding="unicode")


def _noted(model: Any, ranges: dict[str, tuple[float, float]]) -> ForeignModel:
    import mujoco

    kinds = {model.joint(j).name: int(model.jnt_type[j]) for j in range(model.njnt)}
    joints = tuple(name for name, kind in kinds.items() if kind != mujoco.mjtJoint.mjJNT_FREE)
    mass = np.zeros(model.nbody)
    np.add.at(mass, model.body_weldid, model.body_mass)
    moving = [body for body in range(1, model.nbody) if model.body_jntnum[body] > 0]
    return ForeignModel(
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
    )


def rebuilt(data: Table, model: ForeignModel, label: str, *, name: str | None = None) -> Hand:
    """The hand of a description and a model.

    Raises:
        HandError: the first thing that is wrong with them; ``label`` stands before it.
    """
    from .rewrite import rewritten

    refuse([*description_findings(data), *model_findings(data, model)], label)
    try:
        with _quietly():
            mjcf = rewritten(data, model)
    except (ValueError, TypeError, OverflowError, FloatingPointError) as error:
        raise HandError(
            f"{label}: the model cannot be rebuilt from simple shapes: {_reason(error)}"
        ) from error
    fingers = [{**entry, "tip_site": f"{entry['name']}_tip"} for entry in data["finger"]]
    bodies = rewritten_bodies(data, model)
    for entry in fingers:
        entry["tip_body"] = bodies[str(entry["tip_body"])]
    palm = {"body": bodies[str(data["palm"]["body"])], "site": "palm_frame"}
    return hand_from({**data, "finger": fingers, "palm": palm}, mjcf, name=name)


def rewritten_bodies(data: Table, model: ForeignModel) -> dict[str, str]:
    """For every body of the hand, the one that stands for it: itself, or what carries it without a joint."""
    listed = {str(joint) for entry in data["finger"] for joint in entry["joints"]}
    m = model.model
    root = m.body(data.get("root") or model.roots[0]).id
    kept = {int(m.joint(joint).bodyid[0]) for joint in listed} | {root}
    names = {}
    for body in range(1, m.nbody):
        chain = ancestors(m, body)
        if root in chain:
            names[m.body(body).name] = m.body(next(b for b in chain if b in kept)).name
    return names


def ancestors(model: Any, body: int) -> list[int]:
    """The body and those that carry it, outwards in, without the world; its own index first."""
    chain = []
    while body > 0:
        chain.append(body)
        body = int(model.body_parentid[body])
    return chain


def direction(axis: Any, label: str) -> Array:
    """(3,) unit vector of ``+x`` … ``-z``, or of three numbers.

    >>> direction("-y", "palm.faces").tolist()
    [0.0, -1.0, 0.0]

    Raises:
        HandError: it is neither.
    """
    if isinstance(axis, str) and len(axis) == 2 and axis[0] in "+-" and axis[1] in "xyz":
        vector = np.zeros(3)
        vector["xyz".index(axis[1])] = 1.0 if axis[0] == "+" else -1.0
        return vector
    if isinstance(axis, (list, tuple)) and len(axis) == 3:
        try:
            vector = np.array([float(x) for x in axis])
        except (TypeError, ValueError):
            vector = np.zeros(3)
        if np.isfinite(vector).all() and np.linalg.norm(vector) > 0:
            return np.asarray(vector / np.linalg.norm(vector))
    raise HandError(f"{label} must be an axis (+x -x +y -y +z -z) or three numbers, got {axis!r}")
