"""Models as ROS packages and other programs write them, made into text that MuJoCo reads.

What is mended is said in a note; what cannot be mended is refused with the sentence that helps:

- xacro files are expanded by the package xacrodoc.
- ``package://`` is looked up as ROS does, and in the folders above the file.
- Meshes that MuJoCo cannot read (COLLADA, PLY, glTF, OFF, text STL, large STL) are converted by trimesh.
- A group of fixed links without a collision shape gets its visual ones.
- A fragment of an MJCF becomes a whole one, and angles in the wrong unit are recognised.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from copy import deepcopy
from itertools import chain
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from ..exceptions import HandError, shown
from ..files import MOST_OF_MESH, MOST_OF_MODEL, read_file
from ..objects.read_text import printable
from ..types import value

_READ_BY_MUJOCO = (".stl", ".obj", ".msh")
_CONVERTED = (".dae", ".ply", ".glb", ".gltf", ".off", ".3mf", ".stl")
_MOST_FACES = 200_000  # MuJoCo's limit of a binary STL
_HIGHEST = 12  # folders above a file in which its package is looked for
_STRAIGHT_ANGLES = 6.4
"""Largest joint limit that can be an angle in rad [C]; larger ones are in degrees."""
_LEAST_RANGE = 0.12
"""Total range of a hand's widest joint [rad] below which the file's angles were no degrees [C]."""


@value
class ModelText:
    """A model as MuJoCo reads it.

    Attributes:
        text: MJCF or URDF.
        urdf: Whether it is a URDF.
        whole: Whether it is a whole MJCF, which MuJoCo reads from its own file and folder.
        assets: Converted meshes by the names that the text uses.
        notes: What was mended, each in one sentence.
    """

    text: str
    urdf: bool
    whole: bool
    assets: dict[str, bytes]
    notes: tuple[str, ...]


def model_text(path: Path, lost: list[str] | None = None) -> ModelText:
    """The text of a model's file, mended where it must be.

    Args:
        path: The file.
        lost: If given, shapes of a URDF whose meshes are missing or cannot be read are left out, and the
            names of the meshes are added to it.

    Raises:
        HandError: It is a xacro that cannot be expanded, or a mesh is missing or cannot be read.
        ElementTree.ParseError: It is not XML.
        OSError: The file cannot be read.
    """
    content = read_file(path, MOST_OF_MODEL, "model", refusal=HandError)
    if path.suffix.lower() == ".xacro" or b"<xacro:" in content:
        content = _expanded(path)
    root = ElementTree.fromstring(content)
    if root.tag == "robot":
        _require_mimicked(root, path)
        assets: dict[str, bytes] = {}
        notes: list[str] = [*_visual_shapes(root), *_resolved_meshes(root, path, assets, lost)]
        return ModelText(text=_for_mujoco(root), urdf=True, whole=False, assets=assets, notes=tuple(notes))
    whole = root.tag == "mujoco"
    if root.tag == "mujocoinclude":
        root.tag = "mujoco"
    if root.tag in ("worldbody", "body"):
        inner, root = root, Element("mujoco")
        (root if inner.tag == "worldbody" else ElementTree.SubElement(root, "worldbody")).append(inner)
    if root.tag != "mujoco":
        raise HandError(
            f"{path}: it begins with <{printable(root.tag, 40)}>, which is neither a URDF nor an MJCF"
        )
    text = ElementTree.tostring(root, encoding="unicode")
    return ModelText(text=text, urdf=False, whole=whole, assets={}, notes=())


def _expanded(path: Path) -> bytes:
    """The URDF that a xacro stands for."""
    try:
        from xacrodoc import XacroDoc, packages
    except ImportError as error:
        raise HandError(
            f"{path} is a xacro, a template of a URDF: expand it first, in a ROS shell by "
            f'"xacro {path.name} > hand.urdf", or install the package xacrodoc, which preshape then uses'
        ) from error
    try:
        packages.look_in([str(place) for place in _package_places(path)])
        return str(XacroDoc.from_file(str(path)).to_urdf_string()).encode()
    except Exception as error:  # a xacro may contain any expression
        raise HandError(
            f"{path}: its xacro cannot be expanded: {printable(error, 400)}; expand it where its packages "
            f'are, by "xacro {path.name} > hand.urdf"'
        ) from error


def _require_mimicked(root: Element, path: Path) -> None:
    """Refuse a joint that follows one that is missing or fixed, because MuJoCo drops such a law silently."""
    kinds = {str(joint.get("name")): joint.get("type") for joint in root.findall("joint")}
    for joint in root.findall("joint"):
        law = joint.find("mimic")
        followed = None if law is None else str(law.get("joint"))
        if followed is not None and kinds.get(followed, "fixed") == "fixed":
            what = "is fixed" if followed in kinds else "the model does not have"
            raise HandError(
                f"{path}: the joint {shown(str(joint.get('name')))} mimics {shown(followed)}, which {what}: "
                "correct the name, or make the joint fixed too"
            )


def _for_mujoco(root: Element) -> str:
    settings = root.find("mujoco/compiler")
    if settings is None:
        settings = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    settings.set("strippath", "false")
    settings.set("discardvisual", "true")
    settings.set("balanceinertia", "true")
    return ElementTree.tostring(root, encoding="unicode")


# -- shapes -----------------------------------------------------------------------------------------


def _visual_shapes(root: Element) -> list[str]:
    """Give links that carry no collision shape, nor does what is fixed to them, their visual shapes.

    All other visual shapes are removed, so that their meshes need not be readable.
    """
    links = {str(link.get("name")): link for link in root.findall("link")}
    carrier = {name: name for name in links}

    def top(name: str) -> str:
        while carrier[name] != name:
            name = carrier[name]
        return name

    for joint in root.findall("joint"):
        ends = [joint.find(end) for end in ("parent", "child")]
        names = [str(end.get("link")) if end is not None else "" for end in ends]
        if joint.get("type") == "fixed" and set(names) <= links.keys() and top(names[0]) != top(names[1]):
            carrier[top(names[1])] = top(names[0])
    solid = {top(name) for name, link in links.items() if link.find("collision/geometry") is not None}
    used = []
    for name, link in links.items():
        for visual in link.findall("visual"):
            link.remove(visual)
            if top(name) not in solid and visual.find("geometry") is not None:
                shape = deepcopy(visual)
                shape.tag = "collision"
                link.append(shape)
                used.append(name)
    return [visual_note(dict.fromkeys(used))] if used else []


def visual_note(links: Iterable[str]) -> str:
    """The note that links collide by their visual shapes."""
    names = list(links)
    listed = ", ".join(printable(name, 40) for name in names[:4])
    listed += f" and {len(names) - 4} more" if len(names) > 4 else ""
    return f"no collision shapes: the visual shapes of {listed} are used"


def use_visual_shapes(model: Any) -> list[str]:
    """Let the shapes of a compiled model collide where nothing that is fixed to their body does.

    Args:
        model: The ``mujoco.MjModel``; its ``geom_contype`` is changed.
    """
    import mujoco

    group = model.body_weldid[model.geom_bodyid]
    collides = (model.geom_contype > 0) | (model.geom_conaffinity > 0)
    bare = ~np.isin(group, group[collides]) & (model.geom_bodyid > 0)
    bare &= (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE) & (
        model.geom_type != mujoco.mjtGeom.mjGEOM_HFIELD
    )
    model.geom_contype[bare] = model.geom_conaffinity[bare] = 1
    bodies = dict.fromkeys(str(model.body(int(b)).name) for b in model.geom_bodyid[bare])
    return [visual_note(bodies)] if bodies else []


# -- meshes -----------------------------------------------------------------------------------------


def _resolved_meshes(
    root: Element, path: Path, assets: dict[str, bytes], lost: list[str] | None
) -> list[str]:
    """Name the meshes' files by absolute paths, or by assets where MuJoCo cannot read them."""
    notes: dict[str, None] = {}
    settings = root.find("mujoco/compiler")
    meshdir = settings.get("meshdir", "") if settings is not None else ""
    done: dict[str, str | None] = {}
    for link in root.iter("link"):
        for shape in link.findall("collision"):
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            name = mesh.get("filename", "")
            if name not in done:
                try:
                    done[name] = _resolved(find_mesh(name, path, meshdir), assets, notes)
                except HandError:
                    if lost is None:
                        raise
                    lost.append(name)
                    done[name] = None
            if (file := done[name]) is None:
                link.remove(shape)
            else:
                mesh.set("filename", file)
    return list(notes)


def _resolved(file: Path, assets: dict[str, bytes], notes: dict[str, None]) -> str:
    """The absolute path of a mesh, or the name of the asset that it was converted to."""
    kind = _conversion(file)
    if not kind:
        return str(file)
    label = f"converted_{len(assets)}.obj"
    assets[label] = _converted(file)
    notes[f"{kind} meshes were converted"] = None
    return label


def find_mesh(name: str, path: Path, meshdir: str = "") -> Path:
    """The file of a mesh that a model names.

    Args:
        name: What the model says: a path, or a URI of the kind ``package://`` or ``file://``.
        path: The model's file.
        meshdir: The folder that the model names for its meshes.

    Raises:
        HandError: There is no such file; the message says where it was looked for.
    """
    folder = path.resolve().parent
    package = re.match(r"(package|model)://([^/]+)/(.*)", name)
    if package is None:
        plain = name.removeprefix("file://")
        places: Iterator[Path] = chain(
            (folder / plain, folder / meshdir / plain),
            (folder / meshdir / Path(plain).name, folder / Path(plain).name),
            (up / plain for up in folder.parents[:2]),
        )
    else:
        owner, rest = package[2], package[3]
        places = chain(
            (place / rest for place in _package_places(path) if _is_package(place, owner)),
            (place / owner / rest for place in _package_places(path)),
            (up / rest for up in (folder, *folder.parents[:_HIGHEST])),
            (folder / meshdir / Path(rest).name,),
        )
    tried = list(places)
    for place in tried:
        found = _as_written(place)
        if found is not None:
            return found
    for place in tried:
        with suppress(OSError):
            read_file(place, MOST_OF_MESH, "mesh", refusal=HandError)  # says what is no regular file
    where = (
        f'in the package "{printable(package[2], 60)}": put its folder above the model, or name the folder '
        "that contains it in ROS_PACKAGE_PATH"
        if package is not None
        else "beside the model"
    )
    raise HandError(f"{path}: the mesh {printable(name, 200)} is not found {where}")


def _as_written(place: Path) -> Path | None:
    """The file, also where only the case of its name differs, as on other systems."""
    try:
        if place.is_file():
            return place
        wanted = place.name.lower()
        return next(
            (file for file in place.parent.iterdir() if file.name.lower() == wanted and file.is_file()), None
        )
    except (OSError, ValueError):
        return None


def _package_places(path: Path) -> list[Path]:
    """Folders that may be a package or contain packages: those of ROS, and those above the model."""
    folder = path.resolve().parent
    named = [Path(part) for part in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if part]
    shared = [
        Path(part) / "share"
        for variable in ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH")
        for part in os.environ.get(variable, "").split(os.pathsep)
        if part
    ]
    return [*named, *shared, folder, *folder.parents[:_HIGHEST]]


def _is_package(folder: Path, name: str) -> bool:
    """Whether a folder is the package of that name: by its package.xml, else by its own name."""
    try:
        content = read_file(folder / "package.xml", MOST_OF_MODEL, "package.xml")
        return (ElementTree.fromstring(content).findtext("name") or "").strip() == name
    except (OSError, ValueError, ElementTree.ParseError, HandError):
        return folder.name == name


def _conversion(file: Path) -> str:
    """Kind of a mesh that MuJoCo cannot read; empty if it can."""
    suffix = file.suffix.lower()
    if suffix not in _READ_BY_MUJOCO:
        return suffix.removeprefix(".").upper() or "unnamed"
    if suffix != ".stl":
        return ""
    try:
        with file.open("rb") as stream:
            head = stream.read(84)
        size = file.stat().st_size
    except OSError:
        return ""  # MuJoCo's own message is better
    count = int.from_bytes(head[80:84], "little") if len(head) == 84 else 0
    binary = size == 84 + 50 * count
    if binary:
        return "large STL" if count > _MOST_FACES else ""
    return "text STL" if head.lstrip().startswith(b"solid") else ""


def _converted(file: Path) -> bytes:
    """The mesh as OBJ.

    Raises:
        HandError: It cannot be read; for COLLADA the message names the package that reads it.
    """
    import trimesh

    if file.suffix.lower() not in _CONVERTED:
        raise HandError(
            f"the mesh {file} is of a kind that cannot be read: convert it to STL or OBJ, as Blender can"
        )
    if file.suffix.lower() == ".dae":
        try:
            import collada  # noqa: F401
        except ImportError as error:
            raise HandError(
                f"the mesh {file} is a COLLADA file: install the package pycollada, which reads it, or "
                "convert it to STL or OBJ"
            ) from error
    read_file(file, MOST_OF_MESH, "mesh", refusal=HandError)
    try:
        mesh = trimesh.load(file, force="mesh", process=False)
        return str(mesh.export(file_type="obj", include_texture=False)).encode()
    except Exception as error:  # readers of foreign formats fail in many ways
        raise HandError(f"the mesh {file} cannot be read: {printable(error, 300)}") from error


# -- MJCF -------------------------------------------------------------------------------------------


def mend_spec(spec: Any, path: Path) -> list[str]:
    """Mend a parsed MJCF before it is compiled: folders of meshes, inertias, the unit of angles."""
    import mujoco

    notes: list[str] = []
    spec.compiler.balanceinertia = True
    folder = path.resolve().parent
    for mesh in spec.meshes:
        if mesh.file and not (folder / spec.meshdir / mesh.file).is_file():
            mesh.file = str(find_mesh(mesh.file, path, spec.meshdir))
    hinges = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
    limits = np.array([joint.range for joint in hinges]).reshape(-1, 2)
    if not len(limits) or not limits.any():
        return notes
    widest = float((limits[:, 1] - limits[:, 0]).max())
    if spec.compiler.degree and np.deg2rad(widest) < _LEAST_RANGE and np.abs(limits).max() < _STRAIGHT_ANGLES:
        spec.compiler.degree = False
        notes.append('its joint limits are no plausible degrees: read in rad, as angle="radian" says')
    elif not spec.compiler.degree and np.median(np.abs(limits).max(axis=1)) > _STRAIGHT_ANGLES:
        spec.compiler.degree = True
        notes.append('its joint limits are no plausible rad: read in degrees, as angle="degree" says')
    return notes
