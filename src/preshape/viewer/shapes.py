"""Triangles of all solids in a picture: object, hand, arrows, cards, cones and tubes; lengths in metres."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError
from ..hands.kinematics import LinkShape
from ..objects.mesh import TriangleMesh
from ..types import Array, IntArray
from .colours import HAND, OBJECT, Colour
from .raycast import Shape
from .shading import tangents

ROUND = 32
"""Sides of the polygon that approximates a circle."""


def _revolve(start: ArrayLike, end: ArrayLike, profile: ArrayLike) -> tuple[Array, IntArray]:
    """Revolve a profile about the axis from ``start`` to ``end``.

    Args:
        start: (3,) Point of height 0.
        end: (3,) Point of height |end - start|; if it equals ``start``, the axis is z.
        profile: (k, 2) Height and radius along the axis.

    Returns:
        Vertices (k · ROUND, 3) and triangles that face outwards.
    """
    start, end = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(end - start))
    z = (end - start) / length if length > 0 else np.array([0.0, 0.0, 1.0])
    x, y = (axis[0] for axis in tangents(z[None]))
    height, radius = np.asarray(profile, dtype=np.float64).T
    angle = 2 * np.pi * np.arange(ROUND) / ROUND
    ring = np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * y
    vertices = start + height[:, None, None] * z + radius[:, None, None] * ring
    i, j = (a.ravel() for a in np.mgrid[: len(height) - 1, :ROUND])
    near, far = i * ROUND + j, i * ROUND + (j + 1) % ROUND
    low = np.column_stack([near, far, far + ROUND])
    high = np.column_stack([near, far + ROUND, near + ROUND])
    proper = np.concatenate([radius[i] > 0, radius[i + 1] > 0])  # at the axis a quad is one triangle
    return vertices.reshape(-1, 3), np.concatenate([low, high])[proper]


def join(shapes: Iterable[Shape]) -> Shape:
    """Join shapes into one that has the colour and the other properties of the first.

    Raises:
        InputError: There are no shapes.
    """
    parts = list(shapes)
    if not parts:
        raise InputError("there are no shapes to join")
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    triangles = [part.triangles + n for part, n in zip(parts, offsets, strict=True)]
    vertices = np.concatenate([part.vertices for part in parts])
    return replace(parts[0], vertices=vertices, triangles=np.concatenate(triangles))


def capsule(p0: ArrayLike, p1: ArrayLike, radius: float, colour: Colour, *, alpha: float = 1) -> Shape:
    """A capsule between the centres ``p0`` and ``p1`` (3,) of its caps; equal points give a sphere."""
    angle = np.linspace(0, np.pi / 2, ROUND // 4 + 1)
    length = float(np.linalg.norm(np.subtract(p1, p0)))
    cap = radius * np.column_stack([np.sin(angle), np.cos(angle)])
    cap[-1, 1] = 0
    profile = np.concatenate([cap[::-1] * [-1, 1], cap + np.array([length, 0.0])])
    vertices, triangles = _revolve(p0, p1, profile if length > 0 else np.delete(profile, len(cap), axis=0))
    return Shape(vertices=vertices, triangles=triangles, colour=colour, alpha=alpha, smooth=True)


def sphere(centre: ArrayLike, radius: float, colour: Colour, *, alpha: float = 1) -> Shape:
    """A sphere about ``centre`` (3,)."""
    return capsule(centre, centre, radius, colour, alpha=alpha)


def arrow(start: ArrayLike, end: ArrayLike, radius: float, colour: Colour) -> Shape:
    """An arrow from ``start`` to its tip at ``end`` (3,); ``radius`` is that of the shaft."""
    length = float(np.linalg.norm(np.subtract(end, start)))
    neck = length - min(7 * radius, 0.6 * length)
    profile = [(0, 0), (0, radius), (neck, radius), (neck, 2.6 * radius), (length, 0)]
    vertices, triangles = _revolve(start, end, profile)
    return Shape(vertices=vertices, triangles=triangles, colour=colour, smooth=True)


def tube(points: Sequence[ArrayLike], radius: float, colour: Colour, *, alpha: float = 1) -> Shape:
    """A polyline through ``points`` (n, 3), n ≥ 2, drawn as rods of ``radius``."""
    rods = (capsule(p, q, radius, colour, alpha=alpha) for p, q in pairwise(points))
    return join(rods)


def cone(
    apex: ArrayLike, axis: ArrayLike, height: float, slope: float, colour: Colour, *, alpha: float
) -> Shape:
    """A friction cone.

    Args:
        apex: (3,) Contact point [m].
        axis: (3,) Direction from the apex into the cone.
        height: Length along the axis [m].
        slope: Tangent of the half angle, which is the friction coefficient.
        colour: Colour.
        alpha: Opacity.
    """
    apex, axis = np.asarray(apex, dtype=np.float64), np.asarray(axis, dtype=np.float64)
    vertices, triangles = _revolve(
        apex, apex + height * axis / np.linalg.norm(axis), [(0, 0), (height, slope * height)]
    )
    return Shape(vertices=vertices, triangles=triangles, colour=colour, alpha=alpha, smooth=True)


def card(centre: ArrayLike, u: ArrayLike, v: ArrayLike, colour: Colour, *, alpha: float = 0.3) -> Shape:
    """An unshaded rectangle; ``u`` and ``v`` (3,) reach from its centre to the middle of two sides."""
    centre, u, v = (np.asarray(a, dtype=np.float64) for a in (centre, u, v))
    vertices = np.array([centre - u - v, centre + u - v, centre + u + v, centre - u + v])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    return Shape(vertices=vertices, triangles=triangles, colour=colour, alpha=alpha, lit=False)


def card_border(centre: ArrayLike, u: ArrayLike, v: ArrayLike, radius: float, colour: Colour) -> Shape:
    """The border of :func:`card`, whose ``u`` and ``v`` are at right angles, as four thin rods."""
    centre, u, v = (np.asarray(a, dtype=np.float64) for a in (centre, u, v))
    lengths = np.array([np.linalg.norm(u), np.linalg.norm(v), radius])
    axes = np.array([u / lengths[0], v / lengths[1], np.cross(u, v) / (lengths[0] * lengths[1])]).T
    rods = []
    for offset, along in ((u, 1), (-u, 1), (v, 0), (-v, 0)):
        half = np.full(3, radius)
        half[along] = lengths[along]
        rods.append(box(centre + offset, half, axes, colour))
    return replace(join(rods), lit=False)


def box(centre: ArrayLike, half: ArrayLike, rotation: ArrayLike | None, colour: Colour) -> Shape:
    """A box with ``half`` (3,) extents along its own axes, the columns of ``rotation`` (3, 3)."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    turn = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    vertices = np.asarray(centre, dtype=np.float64) + (signs * np.asarray(half, dtype=np.float64)) @ turn.T
    return Shape(vertices=vertices, triangles=triangles, colour=colour)


def object_shape(mesh: TriangleMesh, colour: Colour = OBJECT) -> Shape:
    """The shape of an object."""
    return Shape(vertices=mesh.vertices, triangles=mesh.triangles, colour=colour, smooth=True, name=mesh.name)


def link_shape(part: LinkShape, colour: Colour = HAND, *, own_frame: bool = False) -> Shape:
    """The shape of one link.

    Args:
        part: The link.
        colour: Colour.
        own_frame: If true, the shape is in the link's own frame, with origin in the link's middle and z along
            the axis of a capsule; otherwise it is at the pose of ``part``.

    Raises:
        InputError: The link is neither a capsule nor a sphere nor a box nor a hull.
    """
    if part.hull is not None:
        return Shape(
            vertices=part.hull.corners if own_frame else part.corners,
            triangles=part.hull.faces,
            colour=colour,
        )
    if part.kind == "box":
        if own_frame:
            return box(np.zeros(3), part.half, None, colour)
        return box(part.p0, part.half, part.rotation, colour)
    if part.kind in ("capsule", "sphere"):
        half = np.array([0.0, 0.0, float(np.linalg.norm(part.p1 - part.p0)) / 2])
        start, end = (-half, half) if own_frame else (part.p0, part.p1)
        return capsule(start, end, part.radius, colour)
    raise InputError(f"link {part.link!r} must be a capsule, sphere, box or hull, got {part.kind!r}")


def hand_shape(parts: Sequence[LinkShape], *, alpha: float = 1) -> Shape:
    """The hand as one shape, so that a translucent hand shows no inner surfaces.

    Raises:
        InputError: There are no links, or one is neither a capsule nor a sphere nor a box nor a hull.
    """
    return replace(join(link_shape(part) for part in parts), alpha=alpha, smooth=True, name="hand")
