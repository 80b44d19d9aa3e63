"""Forward kinematics of many postures at once, in NumPy; it specifies that of the closing kernel."""

from __future__ import annotations

import numpy as np

from ..spatial import skew
from ..types import Array
from .tables import HandTables


def joint_frames(tables: HandTables, q: Array) -> tuple[Array, Array]:
    """Frames of all joints, in the palm frame.

    Args:
        tables: Tables of the hand.
        q: (n, j) joint angles [rad].

    Returns:
        (n, j, 3) anchors [m] and (n, j, 3, 3) rotations, the joint's own rotation included.
    """
    n, joints = q.shape
    places, turns = np.empty((n, joints, 3)), np.empty((n, joints, 3, 3))
    own = rotations(tables.turn) @ about(tables.axis, q)
    for first, end in zip(tables.joint_start[:-1], tables.joint_start[1:], strict=True):
        p, R = np.broadcast_to(tables.offset[first], (n, 3)), own[:, first]
        places[:, first], turns[:, first] = p, R
        for j in range(first + 1, end):
            p = p + R @ tables.offset[j]
            R = R @ own[:, j]
            places[:, j], turns[:, j] = p, R
    return places, turns


def fingertips(tables: HandTables, q: Array) -> Array:
    """(n, f, 3) centres of the fingertips in the palm frame [m], fingers in the tables' order."""
    places, turns = joint_frames(tables, q)
    last = tables.joint_start[1:] - 1
    return np.asarray(places[:, last] + np.einsum("nfij,fj->nfi", turns[:, last], tables.tip))


def rotations(quaternions: Array) -> Array:
    """(..., 3, 3) rotations of unit quaternions wxyz (..., 4)."""
    w, x, y, z = np.moveaxis(np.asarray(quaternions, dtype=np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def about(axes: Array, angles: Array) -> Array:
    """(n, j, 3, 3) rotations by ``angles`` (n, j) [rad] about unit axes (j, 3)."""
    k = skew(axes)
    s, c = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    return np.asarray(np.eye(3) + s * k + (1.0 - c) * (k @ k))
