"""The shapes of a model's links as they are written: spheres, capsules and boxes as such, hulls of the rest.

A piece is in the frame of the body that is written. MuJoCo moves a mesh into its inertial frame when it
compiles it, and the geom's frame with it; so vertices and frame are used together.
"""

from __future__ import annotations

from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from ..spatial import quaternion_from_rotation
from ..types import Array, value
from .hulls import ellipsoid_corners, few_corners, hull, mesh_pieces, round_corners

_SIDES = 32
"""Sides of the prism for a cylinder: it lies inside, by 0.5 % of the radius at most [C]."""


@value
class Piece:
    """One convex shape.

    Attributes:
        kind: ``sphere``, ``capsule``, ``box`` or ``hull``.
        size: The sizes of an MJCF geom [m]; none for a hull.
        T: (4, 4) its frame in the frame of the body.
        corners: (n, 3) corners of a hull in its own frame [m]; (0, 3) for the others.
    """

    kind: str
    size: tuple[float, ...]
    T: Array
    corners: Array


def geom_pieces(m: Any, g: int, T: Array) -> list[Piece]:
    """The pieces of geom ``g`` of a ``mujoco.MjModel``, with frame ``T``; none for planes, height fields."""
    import mujoco

    kinds, size = mujoco.mjtGeom, [float(x) for x in m.geom_size[g]]
    kind = int(m.geom_type[g])
    plain = {
        int(kinds.mjGEOM_SPHERE): ("sphere", 1),
        int(kinds.mjGEOM_CAPSULE): ("capsule", 2),
        int(kinds.mjGEOM_BOX): ("box", 3),
    }
    if kind in plain:
        word, count = plain[kind]
        return [Piece(kind=word, size=tuple(size[:count]), T=T, corners=np.zeros((0, 3)))]
    if kind == kinds.mjGEOM_CYLINDER:
        corners = [few_corners(round_corners(np.array([size[0], size[0], size[1]]), _SIDES))]
    elif kind == kinds.mjGEOM_ELLIPSOID:
        corners = [few_corners(ellipsoid_corners(np.array(size)))]
    elif kind == kinds.mjGEOM_MESH:
        mesh = int(m.geom_dataid[g])
        first, count = int(m.mesh_vertadr[mesh]), int(m.mesh_vertnum[mesh])
        vertices = m.mesh_vert[first : first + count].astype(np.float64)
        first, count = int(m.mesh_faceadr[mesh]), int(m.mesh_facenum[mesh])
        corners = list(mesh_pieces(vertices, m.mesh_face[first : first + count].astype(np.int64)))
    else:
        return []
    return [Piece(kind="hull", size=(), T=T, corners=piece) for piece in corners]


def outside(piece: Piece, points: Array) -> Array:
    """(n,) how far points (n, 3) are outside a piece [m], negative inside; outside a hull a lower bound."""
    local = (points - piece.T[:3, 3]) @ piece.T[:3, :3]
    if piece.kind == "hull":
        planes = hull(piece.corners).planes
        return np.asarray((local @ planes[:, :3].T - planes[:, 3]).max(axis=1))
    if piece.kind == "box":
        out = np.abs(local) - np.array(piece.size)
        return np.asarray(np.linalg.norm(np.maximum(out, 0.0), axis=1) + np.minimum(out.max(axis=1), 0.0))
    if piece.kind == "capsule":
        local[:, 2] -= np.clip(local[:, 2], -piece.size[1], piece.size[1])
    return np.asarray(np.linalg.norm(local, axis=1) - piece.size[0])


def geom_text(name: str, piece: Piece) -> str:
    """The piece as a geom of an MJCF; a hull is the geom of the mesh of that name, see :func:`mesh_text`."""
    form = f'type="{piece.kind}" size="{" ".join(f"{x:.6g}" for x in piece.size)}"'
    if piece.kind == "hull":
        form = f'type="mesh" mesh={quoteattr(name)}'
    return f'<geom name={quoteattr(name)} {form} {frame_text(piece.T)} mass="0" rgba="0.72 0.74 0.78 1"/>'


def mesh_text(name: str, piece: Piece) -> str:
    """The corners of a hull as a mesh of an MJCF."""
    return f'<mesh name={quoteattr(name)} inertia="convex" vertex="{numbers_text(piece.corners.ravel())}"/>'


def frame_text(T: Array) -> str:
    """A frame (4, 4) as the attributes ``pos`` and ``quat``."""
    return f'pos="{numbers_text(T[:3, 3])}" quat="{numbers_text(quaternion_from_rotation(T[:3, :3]))}"'


def numbers_text(numbers: Any) -> str:
    """Numbers for an MJCF, without a negative zero."""
    return " ".join(f"{float(x) + 0.0:.9g}" for x in numbers)
