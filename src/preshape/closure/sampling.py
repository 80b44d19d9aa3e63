"""Where the search looks: hands in a preshape that pinch at an aim point on an approach plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..hands.kinematics import cross
from ..hiis.planes import APPROACH_AXES, OPPOSITION_AXES
from ..kernels.closing.host import Candidates
from ..types import Array, BoolArray, IntArray, value
from .preshapes import STATIONS, Preshapes

TILT = 1.2
"""Largest angle from the fingers (+z of the palm) to the approach, towards the palm's side [rad]."""
JITTER = 0.2
"""Standard deviation of the rotation off the plane [rad]."""
REACH = 0.85
"""Aims lie within this share of the half-extents."""


@value
class Sampled:
    """Candidates and where each comes from.

    Attributes:
        candidates: wrist poses and preshapes.
        plane: (n,) approach plane, 1..12.
        flip: (n,) thumb on the -o side.
        value: (n,) approach value: the aim's place along the approach axis, in half-extents.
        preshape: (n,) row in the pool.
    """

    candidates: Candidates
    plane: IntArray
    flip: BoolArray
    value: Array
    preshape: IntArray


def sample(
    rng: np.random.Generator,
    pool: Preshapes,
    centre: Array,
    half: Array,
    count: int,
    *,
    planes: Sequence[int] = tuple(range(1, 13)),
    flips: Sequence[bool] = (False, True),
    values: Sequence[float] | None = None,
    fingers: Sequence[int] | None = None,
) -> Sampled:
    """Draw candidates.

    Args:
        rng: of the draws.
        pool: preshapes of the hand.
        centre: (3,) middle of the object's bounding box [m].
        half: (3,) half its extents [m].
        count: how many.
        planes: approach planes to draw from.
        flips: thumb sides to draw from.
        values: approach values to scatter about; by default anywhere in ±``REACH``.
        fingers: numbers of fingers to draw from; by default any.
    """
    rows = np.arange(len(pool.start))
    if fingers is not None:
        rows = rows[np.isin(pool.fingers, fingers)]
    pick = rows[rng.integers(len(rows), size=count)]
    plane = np.asarray(planes)[rng.integers(len(planes), size=count)]
    flip = np.asarray(flips)[rng.integers(len(flips), size=count)]
    a, o = APPROACH_AXES[plane - 1], OPPOSITION_AXES[plane - 1]
    t = cross(a, o)
    along, across, aside = (np.abs(x) @ half for x in (a, o, t))
    if values is None:
        v = rng.uniform(-REACH, REACH, count)
    else:
        v = np.asarray(values)[rng.integers(len(values), size=count)] + rng.normal(0.0, 0.1, count)
    u, w = rng.uniform(-REACH, REACH, count), rng.normal(0.0, 0.15, count)
    aim = centre + (v * along)[:, None] * a + (u * aside)[:, None] * t + (w * across)[:, None] * o
    station = _station(rng, pool.aperture[pick], 2 * across)
    each = np.arange(count)
    R = _turns(rng, pool.opposition[pick, station], a, np.where(flip[:, None], -o, o))
    place = aim - np.einsum("nij,nj->ni", R, pool.pinch[pick, station])
    return Sampled(
        candidates=Candidates(place=place, turn=quaternions(R), start=pool.start[pick], mask=pool.mask[pick]),
        plane=plane[each],
        flip=flip[each],
        value=v,
        preshape=pick,
    )


def _station(rng: np.random.Generator, aperture: Array, width: Array) -> IntArray:
    """(n,) the station of the closing path whose aperture is a random part of the object's width."""
    wanted = width * rng.uniform(0.35, 1.15, len(width)) + 0.015
    return np.abs(aperture[:, : STATIONS - 2] - wanted[:, None]).argmin(axis=1)


def _turns(rng: np.random.Generator, opposition: Array, approach: Array, thumb_side: Array) -> Array:
    """(n, 3, 3) R_mesh_palm: the approach along a tilted +z, the thumb on its side, a little off."""
    n = len(opposition)
    tilt = rng.uniform(0.0, TILT, n)
    d = np.stack([np.zeros(n), -np.sin(tilt), np.cos(tilt)], axis=1)
    e = opposition - np.einsum("ni,ni->n", opposition, d)[:, None] * d
    e /= np.maximum(np.linalg.norm(e, axis=1, keepdims=True), 1e-9)
    palm = np.stack([d, e, cross(d, e)], axis=2)
    mesh = np.stack([approach, thumb_side, cross(approach, thumb_side)], axis=2)
    R = mesh @ palm.transpose(0, 2, 1)
    return np.asarray(small_rotations(rng.normal(0.0, JITTER, (n, 3))) @ R)


def small_rotations(vectors: Array) -> Array:
    """(n, 3, 3) rotations of rotation vectors (n, 3) [rad]."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())


def quaternions(R: Array) -> Array:
    """(n, 4) unit quaternions wxyz of rotations (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(R, assume_valid=True).as_quat(scalar_first=True))
