"""The largest cap of wrenches that fits into a wrench space: the search behind epsilon and the task margin.

The cap is the set of all unit wrenches w within an angle of an axis. The search looks for the largest factor
k for which base + k·w is in the space for every w of the cap. A plane that touches the space, with normal y,
permits factors up to φ(y) (see :func:`phi`), so k is the minimum of φ over all y. φ may have several minima:

1. start from faces of a polyhedral approximation of the space (:func:`inscribe`);
2. descend from each to a local minimum (:func:`descend`), finished by Newton's method;
3. probe directions around the best minimum, and descend again where one is lower.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..types import Array, value
from .newton import RIMS, finish
from .wrench_space import CROWDED, EXACT, WrenchSpace, hardest, project

NOTHING = 1e-7
"""A factor up to this, in units of the normal force, counts as zero."""
_ITERATIONS = 150
_POLISH_BELOW = 0.02  # distance below which Newton's method is tried
_PROBES = 8  # largest number of times that a minimum is probed
_PROBE_ANGLES = (0.003, 0.05, 0.4)  # angles of the probed directions from the minimum [rad]
_START_ANGLES = (0.3, 0.8, 1.3, 1.7)  # angles of further starting directions from the axis [rad]
_LOWER = 1e-10  # relative difference from which a probe counts as lower
_APART = 0.45  # least angle between two starting wrenches [rad], or a third of the half-angle


@value
class Fit:
    """The largest factor k for which base + k·w is in the space for every w of the cap, as found.

    Attributes:
        k: The factor; ``inf`` if the search met no bound.
        normal: (6,) normal y of the face that limits k, with φ(y) = k.
        wrench: (6,) wrench w of the cap that meets this face.
        settled: Whether this is a local minimum of φ up to rounding errors.
    """

    k: float
    normal: Array
    wrench: Array
    settled: bool


def phi(
    space: WrenchSpace, base: Array, axis: Array, half_angle: float, normals: Array
) -> tuple[Array, Array]:
    """Factor at which the cap meets the plane with normal y: φ(y) = (height(y) - y·base) / (largest y·w).

    Args:
        space: The wrench space.
        base: (6,) wrench of the space.
        axis: (6,) unit axis of the cap.
        half_angle: Half-angle of the cap [rad].
        normals: (m, 6) directions y.

    Returns:
        (m,) φ, ``inf`` if the cap never meets the plane, and the (m, 6) wrenches that meet the plane.
    """
    far, wrenches = hardest(axis, half_angle, normals)
    meets = far > 0.0
    k = np.where(meets, (space.heights(normals) - normals @ base) / np.where(meets, far, 1.0), np.inf)
    return k, wrenches


def inscribe(space: WrenchSpace, base: Array, axis: Array, half_angle: float, *, starts: int) -> Fit:
    """The smallest φ that the search finds.

    Args:
        space: Wrenches that the grasp can produce, of rank 6.
        base: (6,) wrench of the space.
        axis: (6,) unit axis of the cap.
        half_angle: Half-angle of the cap [rad]; π means all unit wrenches.
        starts: Number of wrenches of the cap that the search starts from.
    """
    # 1. The faces with the smallest φ; of faces that meet nearly the same wrench the best one.
    normals = np.concatenate([axis[None], space.faces(), _around(space, axis, _START_ANGLES)])
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
        # 2. If the best factor so far is too large for this wrench, the face that limits it is lower.
        fit = descend(space, base, axis, half_angle, normals[i], wrench=wrenches[i], below=best.k)
        if fit.k < best.k:
            best = _probed(space, base, axis, half_angle, fit)  # 3.
        if best.k <= NOTHING:
            break
    return best


def _probed(space: WrenchSpace, base: Array, axis: Array, half_angle: float, best: Fit) -> Fit:
    """``best``, or a lower fit near it if there is one.

    At a corner of the wrench space the search can stop although the fit is not the lowest. So the fits
    around it are tried.
    """
    for _ in range(_PROBES):
        around = _around(space, best.normal, _PROBE_ANGLES)
        k, _ = phi(space, base, axis, half_angle, around)
        lowest = int(k.argmin())
        if best.k <= NOTHING or not k[lowest] < best.k - _LOWER * (1.0 + best.k):
            break
        best = min(best, descend(space, base, axis, half_angle, around[lowest]), key=lambda fit: fit.k)
    return best


def _around(space: WrenchSpace, normal: Array, angles: Sequence[float]) -> Array:
    """(m, 6) unit directions at the given angles from ``normal``, towards the wrenches of the contacts."""
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
    """Search for a local minimum of φ from one direction.

    Let y be the best direction so far, and w the wrench of the cap that meets the plane of y. The point
    p = base + φ(y) w then lies on or beyond the boundary of the space. In each iteration

    1. evaluate φ at the current direction, and remember the best;
    2. add the support points of the direction to a hull inside the space;
    3. project p on the hull; if p is in the hull, no direction separates them and φ(y) is a local minimum;
    4. if p is near the hull, try Newton's method on the conditions of a minimum, because a curved boundary
       needs many iterations;
    5. take the vector from the projection to p as the next direction.

    Args:
        space: Wrenches that the grasp can produce.
        base: (6,) wrench of the space.
        axis: (6,) unit axis of the cap.
        half_angle: Half-angle of the cap [rad].
        normal: (6,) first direction.
        wrench: (6,) first wrench of the cap; by default the axis.
        below: Start value of the best factor; only minima below it are of interest.
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
            # The first point, without forces, stays: it keeps ``base`` inside every face when there is no
            # load.
            needed = weights > 0.0
            needed[0] = True
            hull = hull.only(needed)
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
    """The minimum of φ near ``start`` by its first-order conditions; ``None`` if that fails.

    y is scaled so that y·w(y) = 1.
    """

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
        exact, wrench = phi(space, base, axis, half_angle, y[None])
        # Another contact may reach farther, or the solution may be no minimum.
        if exact[0] <= start.k + 1e-13 and abs(exact[0] - k) <= 1e-10 * (1.0 + abs(k)):
            return Fit(k=float(exact[0]), normal=y / np.linalg.norm(y), wrench=wrench[0], settled=True)
    return None


def _cap_curvature(axis: Array, half_angle: float, y: Array) -> Array:
    """(6, 6) second derivative by y of the largest y·w over the cap."""
    along = float(y @ axis)
    across = y - along * axis
    width = float(np.linalg.norm(across))
    if math.atan2(width, along) <= half_angle:
        size = float(np.linalg.norm(y))
        return (np.eye(6) - np.outer(y, y) / size**2) / size
    v = across / width
    return (np.eye(6) - np.outer(axis, axis) - np.outer(v, v)) * (math.sin(half_angle) / width)
