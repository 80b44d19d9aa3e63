"""Where the objects of grasps are, and how large they are before the factor of a grasp.

A name is looked for in the folder of objects, if one is given (``NAME/convex/``, ``NAME/mesh.*``,
``NAME.*``); then it is a library object or a file. A plan names the object's file as it was called when the
plan was made: that name and the file's bare name are looked for in the folder, then the library, the file as
named, and the plan's own folder.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..exceptions import ObjectError, PreshapeError, UnknownObject
from ..objects.mesh import TriangleMesh
from .pieces import SUFFIXES, ConvexPieces, decompose, load_pieces, pieces_from_folder

MILLI = 1000.0  # a file in millimetres is too large to be read as metres; read so, its numbers are put back


def object_pieces(name: str, folder: str | Path | None) -> ConvexPieces:
    """The pieces of an object by its name, in the numbers of its file, be they metres or millimetres.

    Raises:
        UnknownObject: nothing of that name.
        ObjectError: a mesh that cannot be used.
        EnvironmentFailure: a file cannot be read.
    """
    try:
        return load_pieces(name, folder)
    except UnknownObject:
        raise
    except ObjectError:
        if not Path(name).is_file():
            raise
        mesh = _in_millimetres(Path(name))
        if mesh is None:
            raise
        small = decompose(mesh)
        return ConvexPieces(name=small.name, pieces=tuple(MILLI * piece for piece in small.pieces))


def plan_object(source: str, folder: str | Path | None, beside: Path | None) -> str:
    """The name under which a plan's object is found; ``source`` itself where it is not.

    Args:
        source: as the plan names it: a library object, or a file.
        folder: of objects; goes first.
        beside: the plan's own folder.
    """
    from ..objects.library import names

    bare = Path(source)
    if folder is not None:
        for name in (source, bare.stem):
            if not Path(name).is_absolute() and (
                (Path(folder) / name / "convex").is_dir() or _mesh_in(folder, name)
            ):
                return name
    if source in names() or bare.is_file() or beside is None:
        return source
    return next((str(file) for file in (beside / bare, beside / bare.name) if file.is_file()), source)


def object_extent(name: str, folder: str | Path | None) -> float | None:
    """Largest extent in the numbers of the object's file; ``None`` where it cannot be had."""
    from ..objects.load import load_object

    file = _mesh_in(folder, name) if folder is not None else None
    try:
        if file is None and folder is not None and (Path(folder) / name / "convex").is_dir():
            pieces = pieces_from_folder(Path(folder) / name / "convex", name)
            return float(np.ptp(pieces.bounds, axis=0).max())
        return float(load_object(file or name).extents.max())
    except UnknownObject:
        return None
    except PreshapeError:
        mesh = _in_millimetres(file or Path(name))
        return None if mesh is None else MILLI * float(mesh.extents.max())


def _mesh_in(folder: str | Path, name: str) -> Path | None:
    base = Path(folder)
    candidates = [base / name / f"mesh{s}" for s in SUFFIXES] + [base / f"{name}{s}" for s in SUFFIXES]
    return next((file for file in candidates if file.is_file()), None)


def _in_millimetres(file: Path) -> TriangleMesh | None:
    from ..objects.load import load_object

    try:
        return load_object(file, unit="mm")
    except PreshapeError:
        return None
