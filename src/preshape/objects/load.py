"""Objects from files and from the built-in library, as the environment sensing element sees them (§2.1)."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import EnvironmentFailure, InputError, ObjectError, PreshapeError, shown
from ..files import MOST_OF_MESH, read_file
from ..types import Array, IntArray, frozen_array
from . import checks, read_gltf, read_obj, read_ply, read_trimesh
from .bodies import one_body
from .mesh import TriangleMesh
from .parts import FILE, ObjectPart
from .read_raw import RawMesh, group_rows
from .read_text import printable, refuse_decimal_commas
from .regions import TriangleSet
from .scans.read_points import read_npy, read_pcd, read_xyz
from .scans.scan import RawCloud
from .scans.scene import object_mask, read_npz, scene_parts
from .sidecar import with_sidecar

_Reader = Callable[[str, bytes, Path], RawMesh | RawCloud]

_READERS: dict[str, _Reader] = {
    ".obj": lambda name, data, path: read_obj.read_obj(name, data),
    ".stl": lambda name, data, path: read_trimesh.read_stl(name, data),
    ".ply": lambda name, data, path: read_ply.read_ply(name, data),
    ".off": lambda name, data, path: read_ply.read_off(name, data),
    ".glb": read_gltf.read_gltf,
    ".gltf": read_gltf.read_gltf,
}

SUFFIXES = tuple(_READERS)
"""Suffixes of the mesh files that can be read; a PLY may also be a point cloud."""

_CLOUD_READERS: dict[str, _Reader] = {
    ".pcd": lambda name, data, path: read_pcd(name, data),
    ".xyz": lambda name, data, path: read_xyz(name, data),
    ".npy": lambda name, data, path: read_npy(name, data),
    ".npz": lambda name, data, path: read_npz(name, data),
}

CLOUD_SUFFIXES = tuple(_CLOUD_READERS)
"""Suffixes of files that hold points only."""

IN_MEMORY = " (in memory)"
"""End of the source of an object that was a mesh in Python; nothing can be found under such a name."""

_Y_UP = "in a glTF file y is up by its standard: task, table and gravity follow it (--up z if z is up here)"

_NO_TABLE = (
    "no table was found under the object of the scene: it is settled as it would come to rest; --table "
    "HEIGHT states the table, --table none is free space"
)

_ALL_READERS = {**_READERS, **_CLOUD_READERS}

_SIGNATURES = {
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"GIF8": "a GIF image",
    b"BM": "a BMP image",
    b"%PDF": "a PDF document",
    b"PK\x03\x04": "a ZIP archive",
    b"\x1f\x8b": "a gzip archive",
    b"\x7fELF": "a program",
}


def load_object(
    source: str | Path,
    *,
    unit: str = "m",
    scale: float = 1.0,
    view: Sequence[float] | Array | str | None = None,
    cut_table: bool | None = None,
    mask: str | None = None,
) -> TriangleMesh:
    """Read an object from a file, or build one of the library.

    All parts, groups and scene nodes of a file become one mesh in the axes of the file. Polygons, also
    concave ones, are cut into triangles. Seams, holes, and parts that touch or overlap are accepted. What
    lies apart is refused or left out, and large holes are closed (:mod:`preshape.objects.bodies`). Triangles
    without area, duplicate triangles and unused vertices are dropped. ``counts`` (table 2) holds the numbers
    **of the file**, if all of it is the object: OBJ, PLY and OFF state them; in STL and glTF equal positions
    count once. If a file has no normals or does not state their number (PLY, OFF, STL, glTF), one normal is
    counted per vertex [C].

    A point cloud (.pcd, .xyz, .npy, or a .ply without faces) or depth image (.npz) becomes a closed surface
    whose unseen side is guessed; ``scan`` says which side (:mod:`preshape.objects.scans.complete`). With a
    mask it is a scene, of which one object is wanted (:mod:`preshape.objects.scans.scene`).

    Groups, objects and materials of OBJ and glTF become parts of the mesh. A file ``NAME.preshape.toml``
    beside it adds parts, mass, centre of mass, up, rest and tasks (:mod:`preshape.objects.sidecar`).

    Args:
        source: File (.obj, .stl, .ply, .off, .glb, .gltf, .pcd, .xyz, .npy, .npz) or name of a library
            object. Of a mesh file with several bodies, ``FILE#2`` is the second, and ``FILE#all`` all as one.
        unit: Unit of the file: m, cm, mm, in or inch; library objects are in metres.
        scale: Further factor on all lengths.
        view: For a point cloud, the position of the camera in the frame and unit of the file, or ``all`` for
            points from all sides. By default the camera of the file is used, or else the origin if a camera
            there could have seen all points; otherwise the points count as seen from all sides.
        cut_table: For a point cloud, whether a table that the object stands on is cut off; ``False`` keeps it
            as part of the object, and ``None`` refuses it. A cloud without a table does not change.
        mask: For a cloud of a scene, which points are the object's: a file (.npy, .png) with a number for
            each point or pixel, not zero for the object, or the number of a label in an NPZ file. The table
            that the object stands on is found, and other points are in the hand's way (``scan.rest``).

    Returns:
        The mesh [m]; the mesh of a library object includes its mass [kg].

    Raises:
        InputError: The unit is unknown, the scale is not a positive, finite number, the view is not a
            possible camera position, ``view``, ``cut_table`` or ``mask`` is given for a mesh, or the scene
            has no such label.
        UnknownObject: There is neither a file nor a library object of that name.
        ObjectError: The file is missing, empty, a folder, not a mesh, or has an unknown suffix; a position is
            not finite; there are no faces or no area; the object is flat; an index is out of range; the size
            is not plausible; or the points do not form one body (too few, on a plane, or two objects).
        EnvironmentFailure: The file cannot be read.
    """
    checks.metres(unit, scale)
    if not isinstance(source, str | Path):
        raise ObjectError(f"an object is a file or the name of a library object, got {shown(source)}")
    if not _is_file(source):
        _check_mesh_options(str(source), view, cut_table, mask)
        return _from_library(str(source), unit, float(scale))
    given, part = split_part(source)
    path, name = Path(given), given
    suffix = path.suffix.lower()
    data = _content(path, name, suffix)
    _refuse_other_kinds(name, suffix, data)
    refuse_decimal_commas(name, data)
    try:
        with np.errstate(all="ignore"):  # the checks find numbers that are not finite, and name them
            raw = _ALL_READERS[suffix](name, data, path)
            if isinstance(raw, RawCloud):
                cloud = _from_cloud(name, _name_of(path), raw, unit, float(scale), view, cut_table, mask)
                return with_sidecar(cloud, path)
            _check_mesh_options(name, view, cut_table, mask)
            mesh = _finish(name, _name_of(path), raw, unit, float(scale), part)
            if suffix not in (".glb", ".gltf"):
                return with_sidecar(mesh, path)
            mesh = with_sidecar(replace(mesh, up="y"), path)
            return replace(mesh, notes=(*mesh.notes, _Y_UP)) if mesh.up == "y" else mesh
    except (PreshapeError, KeyboardInterrupt):
        raise
    except MemoryError as error:
        raise EnvironmentFailure(
            f"{name}: not enough memory for {len(data)} bytes; simplify the {_noun(suffix)}"
        ) from error
    except RecursionError as error:
        raise ObjectError(f"{name}: nested too deeply to be a mesh; the file is damaged") from error
    except Exception as error:
        reason = printable(f"{type(error).__name__}: {error}".strip().splitlines()[0], 120)
        raise ObjectError(
            f"{name}: no {suffix[1:].upper()} {_noun(suffix)}, or a damaged one ({reason}); "
            f"re-export it or convert it to {'PLY' if suffix in CLOUD_SUFFIXES else 'OBJ'}"
        ) from error


def read_content(source: str | Path) -> RawMesh | RawCloud:
    """The triangles or points of a file as they stand there, in metres, whatever they show.

    Raises:
        ObjectError: The file is missing, empty, no mesh and no cloud, or damaged.
        EnvironmentFailure: The file cannot be read.
    """
    name, path = str(source), Path(source)
    suffix = path.suffix.lower()
    data = _content(path, name, suffix)
    _refuse_other_kinds(name, suffix, data)
    refuse_decimal_commas(name, data)
    try:
        with np.errstate(all="ignore"):
            raw = _ALL_READERS[suffix](name, data, path)
    except (PreshapeError, KeyboardInterrupt, MemoryError):
        raise
    except Exception as error:
        reason = printable(f"{type(error).__name__}: {error}".strip().splitlines()[0], 120)
        kind = f"{suffix[1:].upper()} {_noun(suffix)}"
        raise ObjectError(f"{name}: no {kind}, or a damaged one ({reason}); re-export it") from error
    if isinstance(raw, RawMesh) and not (np.isfinite(raw.vertices).all() and len(raw.triangles)):
        raise ObjectError(f"{name}: a mesh needs triangles, and positions that are finite; re-export it")
    return raw


_PART = re.compile(r"(.+)#(\d{1,6}|all)", re.DOTALL)


def split_part(source: str | Path) -> tuple[str, str | None]:
    """The path of a file, and the part of it that is wanted, if one is named at the end of the source.

    >>> split_part("cans.obj#2"), split_part("cans.obj")
    (('cans.obj', '2'), ('cans.obj', None))
    """
    found = _PART.fullmatch(str(source))
    if found is None or os.path.exists(source):  # a file whose name ends so
        return str(source), None
    return found[1], found[2]


def stored_source(source: str | Path | TriangleMesh) -> tuple[str, float]:
    """What a document states so that another program finds the object again.

    A library object keeps its name. A file gets its absolute path, so that it means the same in every folder.
    A mesh in memory cannot be found again and gets its name with ``IN_MEMORY``, unless it is an unchanged
    library object.

    Returns:
        The text, and the factor on the size of a library object that was scaled in Python, otherwise 1.
    """
    from .library import load_library_object, names

    if not isinstance(source, TriangleMesh):
        source = str(source)
        return (str(Path(source).absolute()) if _is_file(source) else source), 1.0
    if source.name in names() and source.same_as(load_library_object(source.name, scale=source.scale)):
        return source.name, source.scale
    return source.name + IN_MEMORY, 1.0


def _is_file(source: str | Path) -> bool:
    """Whether ``source`` is a file: it looks like a path, or exists on the disk."""
    if not isinstance(source, str):
        return True
    from .library import names

    if source in names():
        return False
    return bool(Path(source).suffix) or "/" in source or os.sep in source or os.path.exists(source)


def _from_library(name: str, unit: str, scale: float) -> TriangleMesh:
    from .library import load_library_object

    if unit != "m":
        raise InputError(
            f"library objects such as {name!r} are in metres, and the unit {unit!r} is for files; use scale"
        )
    mesh = load_library_object(name, scale=scale)
    checks.size(name, mesh.extents)
    return mesh


def _name_of(path: Path) -> str:
    r"""Name of the object in a file; bytes of the file's name that are not UTF-8 are shown as ``\x9b``."""
    return os.fsencode(path.stem).decode("utf-8", "backslashreplace")


def _content(path: Path, name: str, suffix: str) -> bytes:
    """The content of a file with a known suffix."""
    if suffix not in _ALL_READERS and not path.is_dir() and path.exists():
        raise ObjectError(
            f"{name}: a file with suffix {shown(suffix)} cannot be read as an object; "
            f"known: {', '.join(_ALL_READERS)}"
        )
    try:
        data = read_file(path, MOST_OF_MESH, f"{_noun(suffix)} file", refusal=ObjectError)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise ObjectError(f"{name}: there is no such file; check the path") from error
    except ValueError as error:
        raise ObjectError(f"{shown(name)}: this is not a path; check it") from error
    except OSError as error:
        raise EnvironmentFailure(
            f"{name}: cannot be read ({error.strerror}); check its permissions"
        ) from error
    if not data or data.isspace():
        raise ObjectError(f"{name}: the file is empty; expected a {_noun(suffix)}")
    return data


def _refuse_other_kinds(name: str, suffix: str, data: bytes) -> None:
    """Refuse a file whose content does not belong to its suffix, and name its format."""
    if suffix == ".stl" and read_trimesh.is_binary_stl(data):  # its first 80 bytes may hold anything
        return
    if suffix == ".npz" and data.startswith(b"PK"):  # a ZIP archive by definition
        return
    for start, kind in _SIGNATURES.items():
        if data.startswith(start):
            noun = _noun(suffix)
            raise ObjectError(f"{name}: expected a {noun}, this is {kind}; give a {noun} file")
    actual = suffix
    if data.startswith(b"glTF"):
        actual = ".glb"
    elif data[:4] in (b"ply\n", b"ply\r"):
        actual = ".ply"
    elif read_ply.is_off(data):
        actual = ".off"
    elif read_trimesh.is_text_stl(data) and b"facet" in data[:4096]:
        actual = ".stl"
    if actual != suffix and {actual, suffix} != {".glb", ".gltf"}:
        raise ObjectError(
            f"{name}: the suffix says {suffix}, the content is {actual[1:].upper()}; "
            f"rename it to end in {actual}"
        )


def _noun(suffix: str) -> str:
    return "point cloud" if suffix in CLOUD_SUFFIXES else "mesh"


def _check_mesh_options(name: str, view: object, cut_table: bool | None, mask: str | None) -> None:
    """Refuse options of point clouds for a mesh.

    Raises:
        InputError: One of them is given.
    """
    for given, what in ((view, "a view"), (cut_table, "cutting off a table"), (mask, "a mask")):
        if given is not None:
            raise InputError(f"{name}: {what} is for a point cloud, this is a mesh; leave it out")


def _from_cloud(
    name: str,
    stem: str,
    raw: RawCloud,
    unit: str,
    scale: float,
    view: Sequence[float] | Array | str | None,
    cut_table: bool | None,
    mask: str | None,
) -> TriangleMesh:
    """Scale a cloud and make a closed surface."""
    from .scans.complete import complete

    factor = checks.metres(unit, scale)
    whole, scene = raw.in_metres(factor), None
    points, camera = whole.points, whole.camera
    if mask is not None:
        scene = scene_parts(name, whole, object_mask(name, raw, mask))
        points, cut_table = scene.points, False
    echoes = RawCloud(points=points).echoes
    if len(echoes) and np.ptp(echoes, axis=0).any():
        checks.size(name, np.ptp(echoes, axis=0), unit)
        checks.place(name, echoes.min(axis=0), echoes.max(axis=0))
    if view is not None and not isinstance(view, str):
        view = factor * frozen_array(view, (3,), "the camera's position")
    known = None if scene is None else scene.table
    made = complete(name, RawCloud(points=points, camera=camera), view, cut_table=cut_table, table=known)
    scan = made.scan if scene is None else replace(made.scan, rest=scene.rest)
    return TriangleMesh(
        name=stem,
        vertices=made.vertices,
        triangles=made.triangles,
        scale=scale,
        unit=unit,
        scan=scan,
        notes=(_NO_TABLE,) if scene is not None and known is None else (),
    )


def mesh_from(other: Any, unit: str = "m", scale: float = 1.0) -> TriangleMesh:
    """The mesh of another library, such as ``trimesh.Trimesh``: any object with ``vertices`` and ``faces``.

    Args:
        other: The mesh, which is copied and cleaned like the mesh of a file.
        unit: Unit of its vertices: m, cm, mm, in or inch.
        scale: Further factor on all lengths.

    Raises:
        InputError: The argument has no vertices or no faces.
        ObjectError: The mesh cannot be grasped as it is.
    """
    vertices, faces = getattr(other, "vertices", None), getattr(other, "faces", None)
    if vertices is None or faces is None:
        raise InputError(
            "an object is a file, the name of a built-in object, a TriangleMesh or a trimesh.Trimesh, "
            f"got {type(other).__name__}"
        )
    metadata = getattr(other, "metadata", None)
    name = str((metadata.get("file_name") if isinstance(metadata, Mapping) else None) or "mesh")
    points = frozen_array(vertices, (None, 3), f"{name}: vertices")
    indices = frozen_array(faces, (None, 3), f"{name}: the corners of the triangles")
    indices = np.clip(indices, -1, 2.0**53)  # a larger number has no int64; the check of the range refuses it
    triangles = indices.astype(np.int64)
    if not len(triangles) or (triangles != indices).any():
        raise ObjectError(f"{name}: a mesh needs triangles, n×3 whole numbers; give a surface mesh")
    checks.in_range(name, triangles.ravel(), np.full(len(triangles), 3), len(points), 0, None)
    raw = RawMesh(vertices=points, triangles=triangles, normals=len(points), faces=len(triangles))
    return _finish(name, _name_of(Path(name)) or "mesh", raw, unit, scale)


def _finish(
    name: str, stem: str, raw: RawMesh, unit: str, scale: float, part: str | None = None
) -> TriangleMesh:
    """Scale, clean and check a mesh, and keep the one object in it."""
    vertices = raw.vertices * checks.metres(unit, scale)
    kept = np.flatnonzero(checks.solid_triangles(name, vertices, raw.triangles, unit))
    triangles = raw.triangles[kept]
    a, b, c = triangles.T
    rolled = triangles.copy()  # with the lowest corner first, equal triangles are equal rows
    for lowest, shift in (((b < a) & (b < c), 1), ((c < a) & (c < b), 2)):
        rolled[lowest] = np.roll(triangles[lowest], -shift, axis=1)
    first = group_rows(rolled)[0]
    triangles, kept = triangles[first], kept[first]
    used = vertices[triangles.reshape(-1)]
    checks.body(name, used.max(axis=0) - used.min(axis=0))
    body = one_body(name, vertices, triangles, part)
    kept = kept[body.kept]
    vertices, triangles = _used(body.vertices, body.triangles)
    extents = vertices.max(axis=0) - vertices.min(axis=0)
    checks.size(name, extents, unit)
    checks.body(name, extents)
    counts = raw.counts if body.whole else None
    return TriangleMesh(
        name=stem,
        vertices=vertices,
        triangles=triangles,
        counts=counts,
        scale=float(scale),
        unit=unit,
        notes=body.notes,
        lids=body.lids,
        parts=_parts(raw, kept),
    )


def _parts(raw: RawMesh, kept: IntArray) -> tuple[ObjectPart, ...]:
    """The groups of a file as parts of the mesh, whose triangles are the kept ones of the file."""
    parts = []
    for name, triangles in raw.groups:
        inside = np.zeros(len(raw.triangles), dtype=bool)
        inside[triangles] = True
        own = np.flatnonzero(inside[kept])
        if len(own):
            parts.append(ObjectPart(name=name, region=TriangleSet(triangles=own), origin=FILE))
    return tuple(parts)


def _used(vertices: Array, triangles: IntArray) -> tuple[Array, IntArray]:
    """The vertices that triangles use, and the triangles with their new indices."""
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles.reshape(-1)] = True
    place = np.cumsum(used) - 1
    return vertices[used], place[triangles]
