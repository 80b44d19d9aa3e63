"""Measures of one grasp at rest, and of a set of grasps.

Definitions, after the field's benchmarks (DexGraspBench, BODex, Dexonomy):

- penetration: largest depth of the hand in the object [m]; self-penetration: largest depth in itself;
- links in contact: number of bodies of the hand that are nearer to the object than 2 mm;
- contact distance: mean distance of the fingers from the object [m]; a finger inside counts as 0, one farther
  away than 10 mm as 10 mm [C];
- consistency: largest minus smallest *signed* distance of the fingers [m], each at most 10 mm; a small value
  means that they touch evenly;
- diversity of a set: share of the variance on the first principal axis; a lower share is more diverse. Each
  grasp is a vector of the wrist's pose in the object's frame (position [m], quaternion with w ≥ 0) and the
  joint angles [rad].
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from .. import spatial
from ..types import Array, IntArray, value
from .scene import OBJECT, PALM, Scene

REACH = 0.01
"""Largest distance that is measured [m]; larger distances count as this one."""


@value
class GraspGeometry:
    """Distances between hand and object at one pose, as defined in the module's docstring.

    Attributes:
        penetration: Depth of the hand in the object [m].
        self_penetration: Depth of the hand in itself [m].
        links: Number of links in contact.
        parts: Number of fingers, and the palm, in contact.
        contact_distance: Mean distance of the fingers [m].
        consistency: Largest minus smallest distance of the fingers [m].
    """

    penetration: float
    self_penetration: float
    links: int
    parts: int
    contact_distance: float
    consistency: float


def place(scene: Scene, data: Any, hand: Array, object_pose: Array) -> None:
    """Reset ``data`` and place hand and object at rest.

    Args:
        scene: The scene.
        data: Its ``mujoco.MjData``.
        hand: (7 + joints) root pose x y z w x y z [m] and angles [rad].
        object_pose: (7,) pose of the object in the world.
    """
    import mujoco

    mujoco.mj_resetData(scene.model, data)
    qpos = data.qpos
    if scene.root_address >= 0:
        qpos[scene.root_address : scene.root_address + 7] = hand[:7]
        qpos[scene.joint_address] = hand[7:]
        data.mocap_pos[0], data.mocap_quat[0] = hand[:3], hand[3:7]
        data.ctrl[:] = scene.controls @ hand[7:]
    qpos[scene.object_address : scene.object_address + 7] = object_pose


def depths(scene: Scene, data: Any) -> tuple[float, float]:
    """Penetration of the hand into the object and into itself [m], in the state ``data``."""
    import mujoco

    mujoco.mj_fwdPosition(scene.model, data)
    distance, parts = _contacts(scene, data)
    with_object = (parts == OBJECT).any(axis=1)
    return _depth(distance[with_object]), _depth(distance[~with_object])


def geometry(scene: Scene, data: Any, contact_distance: float) -> GraspGeometry:
    """Distances between hand and object in the state ``data``.

    The object's contact margin is widened during the call, so that MuJoCo also reports geoms up to ``REACH``
    apart.
    """
    import mujoco

    model = scene.model
    own = np.flatnonzero(model.geom_bodyid == scene.object_body)
    model.geom_margin[own] = REACH
    try:
        mujoco.mj_fwdPosition(model, data)
        distance, parts = _contacts(scene, data)
        pairs = np.asarray(data.contact.geom)
    finally:
        model.geom_margin[own] = 0.0
    with_object = (parts == OBJECT).any(axis=1)
    near = distance[with_object]
    bodies = model.geom_bodyid[pairs[with_object]].reshape(-1, 2)
    bodies = np.where(bodies[:, 0] == scene.object_body, bodies[:, 1], bodies[:, 0])
    nearest = np.full(model.nbody, REACH)
    np.minimum.at(nearest, bodies, near)
    fingers = np.full(scene.fingers + 1, REACH)  # the palm first
    links = np.flatnonzero(scene.part_of_body >= PALM)
    np.minimum.at(fingers, scene.part_of_body[links], nearest[links])
    tips = fingers[1:] if scene.fingers else fingers
    return GraspGeometry(
        penetration=_depth(near),
        self_penetration=_depth(distance[~with_object]),
        links=int((nearest[links] < contact_distance).sum()),
        parts=int((fingers < contact_distance).sum()),
        contact_distance=float(np.maximum(tips, 0.0).mean()),
        consistency=float(np.ptp(tips)),
    )


def touching(scene: Scene, data: Any) -> int:
    """Number of parts (fingers and palm) that pressed on the object in the last simulation step."""
    import mujoco

    force = np.zeros(6)
    found: set[int] = set()
    _, parts = _contacts(scene, data)
    for index in np.flatnonzero((parts == OBJECT).any(axis=1) & (parts >= PALM).any(axis=1)):
        mujoco.mj_contactForce(scene.model, data, int(index), force)
        if force[0] > 1e-6:
            found.add(int(parts[index].max()))
    return len(found)


def diversity(hand_poses: Array, object_poses: Array) -> float | None:
    """Share of the variance on the first principal axis; ``None`` for fewer than two different grasps.

    Args:
        hand_poses: (n, 7 + joints) root poses in the world [m] and angles [rad].
        object_poses: (n, 7) poses of the objects in the world.
    """
    if len(hand_poses) < 2:
        return None
    T_object_hand = spatial.inverse(spatial.pose_from_seven(object_poses)) @ spatial.pose_from_seven(
        hand_poses[:, :7]
    )
    rows = np.concatenate([spatial.seven_from_pose(T_object_hand), hand_poses[:, 7:]], axis=1)
    spread = np.linalg.svd(rows - rows.mean(axis=0), compute_uv=False) ** 2
    total = float(spread.sum())
    return float(spread[0] / total) if total > 1e-18 else None


def mean(numbers: Iterable[float]) -> float | None:
    """The mean; ``None`` if there are no numbers."""
    found = list(numbers)
    return float(np.mean(found)) if found else None


def wilson(part: int, whole: int) -> tuple[float, float] | None:
    """95 % confidence interval of the share ``part / whole`` (Wilson's score interval); ``None`` for 0 of 0.

    >>> [round(x, 3) for x in wilson(15, 100)]
    [0.093, 0.233]
    """
    from scipy.stats import binomtest

    if whole == 0:
        return None
    low, high = binomtest(part, whole).proportion_ci(method="wilson")
    return float(low), float(high)


def rate_text(rate: float | None, interval: tuple[float, float] | None) -> str:
    """A rate and its 95 % interval as text; empty if nothing was tested.

    >>> rate_text(0.25, (0.1119, 0.4687))
    '25.0 % (95 %: 11.2 to 46.9 %)'
    """
    if rate is None or interval is None:
        return ""
    low, high = interval
    return f"{100 * rate:.1f} % (95 %: {100 * low:.1f} to {100 * high:.1f} %)"


def _contacts(scene: Scene, data: Any) -> tuple[Array, IntArray]:
    """(n,) distances of all contacts [m], and (n, 2) the parts that each one joins."""
    contact = data.contact
    bodies = scene.model.geom_bodyid[np.asarray(contact.geom).reshape(-1, 2)]
    return np.array(contact.dist, dtype=np.float64).ravel(), scene.part_of_body[bodies]


def _depth(distances: Array) -> float:
    return float(max(0.0, -distances.min())) if len(distances) else 0.0
