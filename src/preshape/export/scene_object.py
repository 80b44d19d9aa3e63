"""The object of a plan as it was planned with: found again, and brought to the plan's size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import InputError, ObjectError, PreshapeError
from ..objects.mesh import TriangleMesh
from ..physics.grasps import GraspSet
from ..physics.locate import object_extent, object_pieces, plan_object
from ..physics.pieces import SUFFIXES, ConvexPieces
from ..spatial import inverse, pose_from_seven, seven_from_pose
from ..types import Array, value
from .planned import PlannedGrasp


@value
class FoundObject:
    """Where the object of a plan is.

    Attributes:
        name: by which it is found: of the library, in the folder of objects, or a path.
        scale: factor on the numbers of its file.
        folder: of objects, if one was given.
    """

    name: str
    scale: float
    folder: str | None = None


def find_object(
    document: dict[str, Any], *, folder: str | None = None, beside: Path | None = None
) -> FoundObject:
    """The object that a plan is about, and its size.

    Args:
        document: a parsed plan.
        folder: of objects; goes first.
        beside: the plan's own folder.

    Raises:
        InputError: not a plan.
        ObjectError: the object is not there.
    """
    try:
        source, extent = str(document["object"]["source"]), float(max(document["object"]["extents"]))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"the plan does not say which object it is about ({error})") from error
    name = plan_object(source, folder, beside)
    size = object_extent(name, folder)
    if size is None:
        raise ObjectError(
            f"the plan's object {source!r} is not here; give the folder of its file with --objects"
        )
    return FoundObject(name=name, scale=extent / size, folder=folder)


def object_parts(found: FoundObject) -> tuple[TriangleMesh, ConvexPieces]:
    """The object's surface and its convex pieces, both at the plan's size; cut if that was not done before.

    Raises:
        ObjectError: a mesh that cannot be used.
        EnvironmentFailure: a file cannot be read.
    """
    from ..objects.load import load_object

    pieces = object_pieces(found.name, found.folder)
    scaled = ConvexPieces(name=pieces.name, pieces=tuple(found.scale * piece for piece in pieces.pieces))
    base = Path(found.folder) if found.folder is not None else None
    places = [base / found.name / f"mesh{s}" for s in SUFFIXES] if base is not None else []
    places += [base / f"{found.name}{s}" for s in SUFFIXES] if base is not None else []
    source = next((str(path) for path in places if path.is_file()), found.name)
    try:
        mesh = load_object(source)
    except PreshapeError:
        return _surface(scaled), scaled
    factor = float(np.ptp(scaled.bounds, axis=0).max() / mesh.extents.max())
    # A file in millimetres was read as metres; pieces and surface then agree in shape, not in size.
    factor = found.scale if abs(factor / found.scale - 1) < 0.2 else factor
    return TriangleMesh(name=mesh.name, vertices=factor * mesh.vertices, triangles=mesh.triangles), scaled


def grasp_set(grasps: tuple[PlannedGrasp, ...], found: FoundObject) -> GraspSet:
    """The grasps as arrays (``docs/grasp-file.md``), poses of the hand's root, the object at the origin."""
    hand = grasps[0].hand
    T_palm_root = inverse(hand.T_root_palm)

    def rows(stage: str) -> Array:
        return np.array(
            [
                [*seven_from_pose(pose_from_seven(g.palm_pose) @ T_palm_root), *getattr(g, stage)]
                for g in grasps
            ]
        )

    return GraspSet(
        hand=hand.source,
        joints=hand.joints,
        objects=(found.name,) * len(grasps),
        scale=np.full(len(grasps), found.scale),
        object_pose=np.tile([0.0, 0, 0, 1, 0, 0, 0], (len(grasps), 1)),
        pregrasp=rows("pregrasp"),
        grasp=rows("grasp"),
        squeeze=rows("squeeze"),
    )


def _surface(pieces: ConvexPieces) -> TriangleMesh:
    """The pieces' own surfaces, where the object's is not to be had."""
    from scipy.spatial import ConvexHull

    vertices, triangles, start = [], [], 0
    for corners in pieces.pieces:
        vertices.append(corners)
        triangles.append(ConvexHull(corners).simplices + start)
        start += len(corners)
    return TriangleMesh(
        name=pieces.name, vertices=np.concatenate(vertices), triangles=np.concatenate(triangles)
    )
