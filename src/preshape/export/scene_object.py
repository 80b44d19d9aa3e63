"""Finds the object of a plan again and scales it to the plan's size."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..exceptions import InputError, ObjectError, PreshapeError
from ..objects.mesh import TriangleMesh
from ..physics.grasps import STAGES, GraspSet
from ..physics.hand import physics_hand
from ..physics.locate import mesh_in, object_extent, object_pieces, plan_object
from ..physics.pieces import ConvexPieces
from ..planning.document import Document
from ..planning.grasp_sets import palm_grasps
from ..types import value
from .planned import PlannedGrasp


@value
class FoundObject:
    """The place where the object of a plan is found.

    Attributes:
        name: Name in the library or in the folder of objects, or a path.
        scale: Factor on the coordinates in the object's file.
        folder: Folder of objects; ``None`` if none was given.
    """

    name: str
    scale: float
    folder: str | None = None


def find_object(document: Document, *, folder: str | None = None, beside: Path | None = None) -> FoundObject:
    """Find the object of a plan, with its scale.

    Args:
        document: The plan.
        folder: Folder of objects, which is searched first.
        beside: Folder of the plan.

    Raises:
        InputError: The document is no plan.
        ObjectError: The object is not found.
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
    """The surface of an object and its convex pieces, both at the plan's size.

    The pieces come from the cache if the object was cut before.

    Raises:
        ObjectError: The mesh cannot be used.
        EnvironmentFailure: A file cannot be read.
    """
    from ..objects.load import load_object

    pieces = object_pieces(found.name, found.folder)
    scaled = ConvexPieces(name=pieces.name, pieces=tuple(found.scale * piece for piece in pieces.pieces))
    file = mesh_in(found.folder, found.name) if found.folder is not None else None
    try:
        mesh = load_object(file or found.name)
    except PreshapeError:
        return _surface(scaled), scaled
    factor = float(np.ptp(scaled.bounds, axis=0).max() / mesh.extents.max())
    # If a file in millimetres was read as metres, surface and pieces differ in size, but not in shape.
    factor = found.scale if abs(factor / found.scale - 1) < 0.2 else factor
    sized = TriangleMesh(
        name=mesh.name, vertices=factor * mesh.vertices, triangles=mesh.triangles, lids=mesh.lids
    )
    return sized, scaled


def grasp_set(grasps: tuple[PlannedGrasp, ...], found: FoundObject) -> GraspSet:
    """The grasps as arrays (``docs/grasp-file.md``): poses of the hand's root, object at the origin."""
    hand, n = physics_hand(grasps[0].hand), len(grasps)
    poses = {stage: np.array([[*g.palm_pose, *getattr(g, stage)] for g in grasps]) for stage in STAGES}
    return palm_grasps(hand, [found.name] * n, [found.scale] * n, poses).for_hand(hand)


def _surface(pieces: ConvexPieces) -> TriangleMesh:
    """The surfaces of the pieces; used if the object's own surface cannot be read."""
    from scipy.spatial import ConvexHull

    vertices, triangles, start = [], [], 0
    for corners in pieces.pieces:
        vertices.append(corners)
        triangles.append(ConvexHull(corners).simplices + start)
        start += len(corners)
    return TriangleMesh(
        name=pieces.name, vertices=np.concatenate(vertices), triangles=np.concatenate(triangles)
    )
