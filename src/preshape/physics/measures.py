"""What a grasp looks like before anything moves, and what a set of grasps looks like.

Definitions, after the field's benches (DexGraspBench, BODex, Dexonomy):

- penetration: deepest cut of the hand into the object [m]; self-penetration: of the hand into itself;
- links in contact: bodies of the hand nearer to the object than 2 mm;
- contact distance: mean over the fingers of the distance to the object, 0 where it is inside, and at most
  10 mm [C];
- consistency: largest minus smallest *signed* finger distance, at most 10 mm each: how evenly they touch;
- diversity of a set: share of the variance on the first principal axis of its grasps, wrist pose in the
  object's frame (position [m], quaternion with w ≥ 0) and joint angles [rad]; lower is more diverse.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from .. import spatial
from ..types import Array, IntArray, value
from .scene import OBJECT, PALM, Scene

REACH = 0.01
"""Distances beyond this count as this [m]."""


@value
class GraspGeometry:
    """Distances at a pose of hand and object.

    Attributes:
        penetration: hand into object [m].
        self_penetration: hand into itself [m].
        links: bodies of the hand nearer to the object than the contact distance.
        parts: fingers, and the palm, nearer than that.
        contact_distance: mean over the fingers [m].
        consistency: largest minus smallest finger distance [m].
    """

    penetration: float
    self_penetration: float
    links: int
    parts: int
    contact_distance: float
    consistency: float


def place(scene: Scene, data: object, hand: Array, object_pose: Array) -> None:
    """Reset ``data`` and put hand (7 + joints, root pose and angles) and object (7) there, at rest."""
    import mujoco

    d = data
    mujoco.mj_resetData(scene.model, d)
    qpos = d.qpos  # type: ignore[attr-defined]
    if scene.root_address >= 0:
        qpos[scene.root_address : scene.root_address + 7] = hand[:7]
        qpos[scene.joint_address] = hand[7:]
        d.mocap_pos[0], d.mocap_quat[0] = hand[:3], hand[3:7]  # type: ignore[attr-defined]
        d.ctrl[:] = scene.controls @ hand[7:]  # type: ignore[attr-defined]
    qpos[scene.object_address : scene.object_address + 7] = object_pose


def depths(scene: Scene, data: object) -> tuple[float, float]:
    """Penetration hand-object and hand-hand [m] where things now stand."""
    import mujoco

    mujoco.mj_fwdPosition(scene.model, data)
    distance, parts = _contacts(scene, data)
    with_object = (parts == OBJECT).any(axis=1)
    return _depth(distance[with_object]), _depth(distance[~with_object])


def geometry(scene: Scene, data: object, contact_distance: float) -> GraspGeometry:
    """Distances where things now stand; widens the object's margin while it looks."""
    import mujoco

    model = scene.model
    own = np.flatnonzero(model.geom_bodyid == scene.object_body)
    model.geom_margin[own] = REACH
    try:
        mujoco.mj_fwdPosition(model, data)
        distance, parts = _contacts(scene, data)
        pairs = np.asarray(data.contact.geom)  # type: ignore[attr-defined]
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


def touching(scene: Scene, data: object) -> int:
    """How many parts, fingers and palm, press on the object in the last simulation step."""
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
    """Share of the first principal axis; ``None`` for fewer than two different grasps.

    Args:
        hand_poses: (n, 7 + joints) root pose in the world and angles.
        object_poses: (n, 7).
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
    """Mean, ``None`` of nothing."""
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
    """A rate and its 95 % interval in words; empty where nothing was tested.

    >>> rate_text(0.25, (0.1119, 0.4687))
    '25.0 % (95 %: 11.2 to 46.9 %)'
    """
    if rate is None or interval is None:
        return ""
    low, high = interval
    return f"{100 * rate:.1f} % (95 %: {100 * low:.1f} to {100 * high:.1f} %)"


def _contacts(scene: Scene, data: object) -> tuple[Array, IntArray]:
    """(n,) distances [m] and (n, 2) parts of all contacts."""
    contact = data.contact  # type: ignore[attr-defined]
    bodies = scene.model.geom_bodyid[np.asarray(contact.geom).reshape(-1, 2)]
    return np.array(contact.dist, dtype=np.float64).ravel(), scene.part_of_body[bodies]


def _depth(distances: Array) -> float:
    return float(max(0.0, -distances.min())) if len(distances) else 0.0
