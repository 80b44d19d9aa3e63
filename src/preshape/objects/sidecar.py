"""What a person knows about a mesh: mass, centre of mass, up, rest, tasks and parts, in a file beside it.

The file of ``hammer.obj`` is ``hammer.preshape.toml``. Its lengths are in metres in the mesh frame, after
unit and scale, so the same file suits a mesh in millimetres::

    mass = 0.35                     # [kg]
    com = [0.0, 0.0, 0.04]          # centre of mass
    up = "z"                        # the axis that is up: x, y, z, -x, -y or -z
    rest = [0.71, 0.70, 0.0, 0.0]   # quaternion w x y z that turns the mesh as it lies to a world with z up
    tasks = ["strike", "lift"]

    [[part]]
    name = "handle"
    box = [-0.02, -0.02, -0.08, 0.02, 0.02, 0.05]   # or halfspace, cylinder, group
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import EnvironmentFailure, InputError, ObjectError, shown
from ..files import MOST_OF_TOML, read_file
from ..types import Array, finite_number, freeze, positive_number, value
from .mesh import UP_AXES, TriangleMesh
from .parts import SIDECAR, ObjectPart, listed, part_of_text
from .regions import HalfSpace, SurfaceRegion, box, cylinder

SUFFIX = ".preshape.toml"

_KEYS = ("mass", "com", "up", "rest", "tasks", "part")
_REGIONS = ("box", "halfspace", "cylinder", "group")
MOST_PARTS = 500
"""Largest number of parts in a file."""


@value
class Sidecar:
    """The content of a sidecar file.

    Attributes:
        mass: Mass [kg]; ``None`` if the file does not say.
        com: (3,) centre of mass [m], or ``None``.
        up: The axis that is up, one of ``UP_AXES``; empty if the file does not say.
        rest: (4,) unit quaternion w x y z that turns the mesh as it lies at rest to a world with z up, or
            ``None``.
        tasks: Tasks that suit the object, the most natural one first.
        parts: The parts with a region of their own.
        groups: Name of each part that is a group of the mesh file, and the name of the group.
    """

    mass: float | None = None
    com: Array | None = None
    up: str = ""
    rest: Array | None = None
    tasks: tuple[str, ...] = ()
    parts: tuple[ObjectPart, ...] = ()
    groups: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        if self.mass is not None:
            freeze(self, mass=positive_number(self.mass, "mass"))


def sidecar_path(path: str | Path) -> Path:
    """The sidecar file of a mesh file.

    >>> sidecar_path("tools/hammer.obj").name
    'hammer.preshape.toml'
    """
    return Path(os.path.splitext(path)[0] + SUFFIX)


def read_sidecar(path: str | Path) -> Sidecar | None:
    """The sidecar of a mesh file; ``None`` if there is none.

    Args:
        path: The mesh file.

    Raises:
        ObjectError: The sidecar is no regular file, is too large, is not TOML, has an unknown key, or a value
            cannot be used.
        EnvironmentFailure: The sidecar cannot be read.
    """
    file = sidecar_path(path)
    try:
        content = read_file(file, MOST_OF_TOML, "sidecar file", refusal=ObjectError)
    except (FileNotFoundError, NotADirectoryError):
        if file.is_symlink():
            raise ObjectError(
                f"{file}: this is a link to a file that does not exist; correct or remove it"
            ) from None
        return None
    except OSError as error:
        raise EnvironmentFailure(
            f"{file}: cannot be read ({error.strerror}); check its permissions"
        ) from error
    try:
        document = tomllib.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ObjectError(f"{file}: this is not TOML ({error!s:.120}); correct it") from error
    try:
        return _sidecar(document)
    except InputError as error:
        raise ObjectError(f"{file}: {error}") from error


def with_sidecar(mesh: TriangleMesh, path: Path) -> TriangleMesh:
    """A mesh with what its sidecar says, if there is one; parts of the sidecar come before those of the file.

    Args:
        mesh: The mesh, whose parts are the groups of its file.
        path: The mesh file.

    Raises:
        ObjectError: The sidecar cannot be used (:func:`read_sidecar`), or it names a group that the file does
            not have.
        EnvironmentFailure: The sidecar cannot be read.
    """
    sidecar = read_sidecar(path)
    if sidecar is None:
        return mesh
    low, high = mesh.bounds
    if sidecar.com is not None and not ((sidecar.com >= low) & (sidecar.com <= high)).all():
        raise ObjectError(
            f"{sidecar_path(path)}: com must lie within the object, which reaches from "
            f"{' '.join(f'{x:.4g}' for x in low)} to {' '.join(f'{x:.4g}' for x in high)} m, got "
            f"{shown(sidecar.com.tolist())}: is it in another unit?"
        )
    known, parts = {part.name: part.region for part in mesh.parts}, list(sidecar.parts)
    for name, group in sidecar.groups:
        if group not in known:
            raise ObjectError(
                f"{sidecar_path(path)}: the part {shown(name)} is the group {shown(group)}, which "
                f"{path.name} does not have; {listed([*known]) if known else 'it has no groups'}"
            )
        parts.append(ObjectPart(name=name, region=known[group], origin=SIDECAR))
    named = {part.name for part in parts}
    return replace(
        mesh,
        mass=mesh.mass if sidecar.mass is None else sidecar.mass,
        com=mesh.com if sidecar.com is None else sidecar.com,
        up=sidecar.up or mesh.up,
        rest=mesh.rest if sidecar.rest is None else sidecar.rest,
        tasks=sidecar.tasks,
        parts=(*parts, *(part for part in mesh.parts if part.name not in named)),
    )


def _sidecar(document: dict[str, Any]) -> Sidecar:
    _refuse_unknown(document, _KEYS, "key")
    given = document.get("part", [])
    if not isinstance(given, list) or not all(isinstance(part, dict) for part in given):
        raise InputError("part must be a list of tables, each headed [[part]]")
    if len(given) > MOST_PARTS:
        raise InputError(f"there are {len(given)} parts, at most {MOST_PARTS} are read; leave some out")
    parts: list[ObjectPart] = []
    groups: list[tuple[str, str]] = []
    for number, entry in enumerate(given, start=1):
        name, region = _part(entry, number)
        if name in [part.name for part in parts] + [other for other, _ in groups]:
            raise InputError(f"there are two parts of the name {shown(name)}; rename one")
        if isinstance(region, str):
            groups.append((name, region))
        else:
            parts.append(ObjectPart(name=name, region=region, origin=SIDECAR))
    return Sidecar(
        mass=None if "mass" not in document else positive_number(document["mass"], "mass"),
        com=None if "com" not in document else np.array(_numbers(document["com"], 3, "com")),
        up=_up(document["up"]) if "up" in document else "",
        rest=_rest(document["rest"]) if "rest" in document else None,
        tasks=_tasks(document.get("tasks", [])),
        parts=tuple(parts),
        groups=tuple(groups),
    )


def _part(entry: dict[str, Any], number: int) -> tuple[str, SurfaceRegion | str]:
    """Name and region of one part; the region is the name of a group where it is one."""
    _refuse_unknown(entry, ("name", *_REGIONS), f"key in part {number}")
    name = entry.get("name")
    if not isinstance(name, str) or not name.strip():
        raise InputError(f"part {number} needs a name, got {shown(name)}")
    if part_of_text(name) is not None:
        raise InputError(f"the name of a part must not read as a region, got {shown(name)}; rename it")
    kinds = [key for key in _REGIONS if key in entry]
    if len(kinds) != 1:
        raise InputError(
            f"the part {shown(name)} needs exactly one of {', '.join(_REGIONS)}, got "
            f"{' and '.join(kinds) or 'none'}"
        )
    kind, given = kinds[0], entry[kinds[0]]
    if kind == "group":
        if not isinstance(given, str) or not given.strip():
            raise InputError(f"the part {shown(name)}: group is the name of a group, got {shown(given)}")
        return name, given
    try:
        return name, _MAKERS[kind](given)
    except InputError as error:
        raise InputError(f"the part {shown(name)}: {error}") from error


def _box(given: object) -> SurfaceRegion:
    numbers = _numbers(given, 6, "box")
    return box(numbers[:3], numbers[3:])


def _half_space(given: object) -> SurfaceRegion:
    numbers = _numbers(given, 4, "halfspace")
    return HalfSpace(normal=np.array(numbers[:3]), offset=numbers[3])


def _cylinder(given: object) -> SurfaceRegion:
    wanted = "cylinder is [[x, y, z], [x, y, z], radius], the middles of its ends and its radius"
    if not isinstance(given, list) or len(given) != 3:
        raise InputError(f"{wanted}, got {shown(given)}")
    p, q = (_numbers(point, 3, "an end of a cylinder") for point in given[:2])
    return cylinder(p, q, positive_number(given[2], "the radius of a cylinder"))


_MAKERS: dict[str, Callable[[object], SurfaceRegion]] = {
    "box": _box,
    "halfspace": _half_space,
    "cylinder": _cylinder,
}


def _numbers(given: object, count: int, name: str) -> list[float]:
    """So many finite numbers.

    Raises:
        InputError: It is anything else.
    """
    if not isinstance(given, list) or len(given) != count:
        raise InputError(f"{name} must be {count} numbers, got {shown(given)}")
    return [finite_number(item, f"each number of {name}") for item in given]


def _up(given: object) -> str:
    if not isinstance(given, str) or given.lower().removeprefix("+") not in UP_AXES:
        raise InputError(f"up must be one of {', '.join(UP_AXES)}, got {shown(given)}")
    return given.lower().removeprefix("+")


def _rest(given: object) -> Array:
    quaternion = np.array(_numbers(given, 4, "rest (a quaternion w x y z)"))
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) < 0.01:
        raise InputError(f"rest must be a unit quaternion w x y z, got one of length {length:g}")
    return quaternion / length


def _tasks(given: object) -> tuple[str, ...]:
    if not isinstance(given, list) or not all(isinstance(name, str) and name.strip() for name in given):
        raise InputError(f"tasks must be a list of names from preshape tasks, got {shown(given)}")
    return tuple(dict.fromkeys(given))


def _refuse_unknown(table: dict[str, Any], known: Sequence[str], what: str) -> None:
    unknown = [key for key in table if key not in known]
    if unknown:
        raise InputError(f"unknown {what} {shown(unknown[0])}; known: {', '.join(known)}")
