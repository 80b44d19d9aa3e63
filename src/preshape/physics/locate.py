"""Finds the objects of grasps, and their size at scale 1.

An object's name is searched in the folder of objects first, if one is given (``NAME/convex/``,
``NAME/mesh.*``, ``NAME.*``). Otherwise it is a library object or a file. A plan stores the name or path of
its object at the time of planning. This object is searched in the folder of objects, in the library, in the
folder of the plan, and then as a file from the working directory; in the two folders also by its file name
alone. An absolute path is first searched as it stands.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..exceptions import ObjectError, PreshapeError, UnknownObject
from ..objects.mesh import TriangleMesh
from .pieces import SUFFIXES, ConvexPieces, decompose, load_pieces, pieces_from_folder

MILLI = 1000.0
"""Millimetres in a metre. A mesh that is too large in metres is read in millimetres and then multiplied by
this factor, which restores the numbers of its file."""


def object_pieces(name: str, folder: str | Path | None) -> ConvexPieces:
    """Convex pieces of an object, with the numbers of its file, whether these are metres or millimetres.

    Args:
        name: Name of the object in a grasp array.
        folder: Folder of objects, or ``None``.

    Raises:
        UnknownObject: There is no object of that name.
        ObjectError: The mesh cannot be used.
        EnvironmentFailure: A file cannot be read.
    """
    from ..objects.load import split_part

    try:
        return load_pieces(name, folder)
    except UnknownObject:
        raise
    except ObjectError:
        if not Path(split_part(name)[0]).is_file():
            raise
        mesh = _in_millimetres(Path(name))
        if mesh is None:
            raise
        small = decompose(mesh)
        return ConvexPieces(name=small.name, pieces=tuple(MILLI * piece for piece in small.pieces))


def plan_object(source: str, folder: str | Path | None, beside: Path | None) -> str:
    """The name under which the object of a plan is found; ``source`` itself if it is not found.

    Args:
        source: Library object or file, as the plan names it.
        folder: Folder of objects, searched first; ``None`` for none.
        beside: Folder of the plan, searched before the working directory; ``None`` for none.
    """
    from ..objects.library import names
    from ..objects.load import IN_MEMORY, split_part

    bare = Path(source)
    if folder is not None:
        named = source.removesuffix(IN_MEMORY)  # somebody may have saved the mesh under its name
        for name in (named, Path(named).stem):
            if not Path(name).is_absolute() and (
                (Path(folder) / name / "convex").is_dir() or mesh_in(folder, name)
            ):
                return name
    if source in names() or beside is None:
        return source
    # Joined to a folder, an absolute path stays as it is.
    places = (beside / bare, bare, beside / bare.name)
    return next((str(file) for file in places if os.path.isfile(split_part(file)[0])), source)


def object_extent(name: str, folder: str | Path | None) -> float | None:
    """Largest extent of an object, with the numbers of its file; ``None`` if the file cannot be read."""
    from ..objects.load import load_object

    file = mesh_in(folder, name) if folder is not None else None
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


def mesh_in(folder: str | Path, name: str) -> Path | None:
    """The mesh of an object in a folder of objects; ``None`` if it has none."""
    base = Path(folder)
    candidates = [base / name / f"mesh{s}" for s in SUFFIXES] + [base / f"{name}{s}" for s in SUFFIXES]
    return next((file for file in candidates if file.is_file()), None)


def _in_millimetres(file: Path) -> TriangleMesh | None:
    from ..objects.load import load_object

    try:
        return load_object(file, unit="mm")
    except PreshapeError:
        return None
