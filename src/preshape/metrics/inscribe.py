"""How large a cap of wrenches fits into a wrench space: the search behind epsilon and the task margin."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..types import Array, value
from .newton import RIMS, finish
from .wrench_space import CROWDED, EXACT, WrenchSpace, hardest, project

NOTHING = 1e-7
"""A factor up to this, in units of the normal force, is rounding."""
_ITERATIONS = 150
_POLISH_BELOW = 0.02  # distance at which Newton's method is tried
_PROBES = 8
_ANGLES = (0.003, 0.05, 0.4)  # of the directions probed round a minimum [rad]
_WIDE = (0.3, 0.8, 1.3, 1.7)  # and round the axis, to start from
_LOWER = 1e-10
_APART = 0.45  # angle between the wrenches that a search starts from [rad], or a third of the half-angle
_SHARE = 1e-4  # of the normal force, below which a contact does not touch the face


@value
class Fit:
    """The largest k found for which base + k·w is in the space for every w of the cap.

    Attributes:
        k: the factor; ``inf`` where the search met no bound.
        normal: (6,) y of the face that stops it, with φ(y) = k.
        wrench: (6,) the w that meets this face.
        settled: whether no face near this one is worse (to rounding).
    """

    k: float
    normal: Array
    wrench: Array
    settled: bool


def phi(
    space: WrenchSpace, base: Array, axis: Array, half_angle: float, normals: Array
) -> tuple[Array, Array]:
    """φ(y) = (height(y) - y·base) / (largest y·w): the factor at which the cap meets the plane across y.

    Returns:
        (m,) φ, ``inf`` where the cap never meets the plane, and the (m, 6) wrenches that meet it.
    """
    far, wrenches = hardest(axis, half_angle, normals)
    meets = far > 0.0
    k = np.where(meets, (space.heights(normals) - normals @ base) / np.where(meets, far, 1.0), np.inf)
    return k, wrenches


def inscribe(space: WrenchSpace, base: Array, axis: Array, half_angle: float, *, starts: int) -> Fit:
    """The smallest φ found, from the faces of the space with coarsely cut cones that have the smallest φ.

    Args:
        space: the producible wrenches, of rank 6; ``base`` is one of them.
        base: (6,).
        axis: (6,) unit.
        half_angle: [rad]; π asks for all unit wrenches.
        starts: how many wrenches of the cap, those that the lowest faces meet, the search starts from.
    """
    normals = np.concatenate([axis[None], space.faces(), _around(space, axis, _WIDE)])
    k, wrenches = phi(space, base, axis, half_angle, normals)
    apart = math.cos(min(_APART, half_angle / 3))
    chosen: list[int] = []
    for i in np.argsort(k, kind="stable"):
        if all(wrenches[i] @ wrenches[j] < apart for j in chosen):
            chosen.append(int(i))
            if len(chosen) == starts:
                break
    best = Fit(k=math.inf, normal=axis, wrench=axis, settled=False)
    for i in chosen:
        # Is this wrench producible at the best factor so far? If not, what stops it lies lower.
        fit = descend(space, base, axis, half_angle, normals[i], wrench=wrenches[i], below=best.k)
        if fit.k < best.k:
            best = _probed(space, base, axis, half_angle, fit)
        if best.k <= NOTHING:
            break
    return best


def _probed(space: WrenchSpace, base: Array, axis: Array, half_angle: float, best: Fit) -> Fit:
    """``best``, or what lies below it: a corner of the space satisfies the conditions of a minimum too."""
    for _ in range(_PROBES):
        around = _around(space, best.normal, _ANGLES)
        k, _ = phi(space, base, axis, half_angle, around)
        lowest = int(k.argmin())
        if best.k <= NOTHING or not k[lowest] < best.k - _LOWER * (1.0 + best.k):
            break
        best = min(best, descend(space, base, axis, half_angle, around[lowest]), key=lambda fit: fit.k)
    return best


def _around(space: WrenchSpace, normal: Array, angles: Sequence[float]) -> Array:
    """(m, 6) unit directions at some angles off ``normal``, towards the contacts' wrenches."""
    ways = np.concatenate([space.by_contact.reshape(-1, 6), space.support(normal)[1].points])
    ways = ways - (ways @ normal)[:, None] * normal
    size = np.sqrt((ways * ways).sum(axis=1))
    ways = ways[size > 1e-6] / size[size > 1e-6, None]
    return np.concatenate(
        [math.cos(a) * normal + math.sin(a) * s * ways for a in angles for s in (1.0, -1.0)]
    )


def descend(
    space: WrenchSpace,
    base: Array,
    axis: Array,
    half_angle: float,
    normal: Array,
    *,
    wrench: Array | None = None,
    below: float = math.inf,
) -> Fit:
    """Search for the smallest φ from one direction (6,), or for one ``below`` from a wrench of the cap.

    With w the hardest wrench of the best y so far, base + φ(y) w lies on or beyond the boundary of the space;
    the way to it from the nearest wrench of a growing hull of support points is the next y. When the point is
    in the hull, nothing separates it and φ is a local minimum. Where the boundary is curved that takes long,
    so Newton's method on the conditions of the minimum finishes.
    """
    best = Fit(k=below, normal=normal, wrench=axis if wrench is None else wrench, settled=False)
    hull, weights, tried = space.hull, np.zeros(len(space.hull.points)), math.inf
    for _ in range(_ITERATIONS):
        _, points = space.support(normal)
        k, hard = phi(space, base, axis, half_angle, normal[None])
        if k[0] < best.k:
            best = Fit(k=float(k[0]), normal=normal, wrench=hard[0], settled=False)
        if not math.isfinite(best.k):
            return best
        if best.k <= NOTHING:
            return Fit(k=max(best.k, 0.0), normal=best.normal, wrench=best.wrench, settled=True)
        if len(hull.points) > CROWDED:
            # The empty force stays: it keeps ``base`` on the inner side of every face when there is no load.
            needed = weights > 0.0
            needed[0] = True
            hull = hull.kept(needed)
        hull = hull.grown(points)
        away, weights = project(hull.points, base + best.k * best.wrench)
        size = math.sqrt(float(away @ away))
        if size <= EXACT:
            return Fit(k=best.k, normal=best.normal, wrench=best.wrench, settled=True)
        if size < _POLISH_BELOW and best.k < tried and best.k < below:
            tried = best.k
            finished = _polished(
                space, base, axis, half_angle, best, np.tensordot(weights, hull.forces, axes=1)
            )
            if finished is not None:
                return finished
        normal = away / size
    return best


def _polished(
    space: WrenchSpace, base: Array, axis: Array, half_angle: float, start: Fit, force: Array
) -> Fit | None:
    """The minimum of φ near ``start`` from its first-order conditions, scaled so that y·w(y) = 1, or none."""

    def wanted(y: Array, k: float) -> tuple[Array, Array, Array, float, Array, float]:
        far, wrench = hardest(axis, half_angle, y[None])
        w = wrench[0]
        return base + k * w, k * _cap_curvature(axis, half_angle, y), w, float(far[0]) - 1.0, w, 0.0

    scaled = start.normal / float(hardest(axis, half_angle, start.normal[None])[0][0])
    for rim in RIMS:
        found = finish(space, force, rim, scaled, start.k, wanted)
        if found is None:
            continue
        y, k, _ = found
        again, wrench = phi(space, base, axis, half_angle, y[None])
        # Another contact may reach farther, or the point be no minimum.
        if again[0] <= start.k + 1e-13 and abs(again[0] - k) <= 1e-10 * (1.0 + abs(k)):
            return Fit(k=float(again[0]), normal=y / np.linalg.norm(y), wrench=wrench[0], settled=True)
    return None


def _cap_curvature(axis: Array, half_angle: float, y: Array) -> Array:
    """(6, 6) second derivative of the largest y·w over the cap."""
    along = float(y @ axis)
    across = y - along * axis
    width = float(np.linalg.norm(across))
    if math.atan2(width, along) <= half_angle:
        size = float(np.linalg.norm(y))
        return (np.eye(6) - np.outer(y, y) / size**2) / size
    v = across / width
    return (np.eye(6) - np.outer(axis, axis) - np.outer(v, v)) * (math.sin(half_angle) / width)
