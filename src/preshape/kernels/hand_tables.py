"""A hand as arrays for the closing kernel: joint chains, spheres that fill its links, closing paths.

Spheres stand for the links: along a capsule's axis; on the faces of a box, a little under them. Their spacing
sets how far the true shape can stand out between them. Everything is in the palm frame.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from ..hands.hand import Hand
from ..hands.kinematics import compile_hand
from ..types import Array, IntArray, value

COARSE, FINE = 0.006, 0.0025
"""Spacing of spheres [m]: for the search, and for the answers [C]."""
_EDGE = {COARSE: 0.4, FINE: 0.08}  # radius of the spheres on a box, over its smallest half size: rounds it off
_SPREAD = {COARSE: 2.0, FINE: 1.4}  # spacing on a face over that along a capsule


@value
class HandTables:
    """Arrays over fingers f, joints j (in the hand's order) and spheres s (by joint).

    Attributes:
        name: the hand's.
        fingers: names, in the order of their joints.
        thumb: which of them is the thumb.
        joint_start: (f + 1,) first joint of each finger.
        offset: (j, 3) the joint's anchor in the frame of the joint before it, or of the palm [m].
        turn: (j, 4) orientation at zero angle in that frame, quaternion wxyz.
        axis: (j, 3) unit axis in the joint's own frame.
        sphere_start: (j + 1,) first sphere of each joint.
        sphere: (s, 4) centre in the joint's frame, and radius [m].
        speed: (s,) bound on how far a sphere moves for a unit of the closing path [m].
        bound: (j, 4) a sphere around all spheres of the joint.
        bound_speed: (j,) the largest of their speeds [m].
        palm: (p, 4) spheres of what no joint moves [m].
        path: (k, j) closing path, k evenly spaced points from open to closed [rad].
        limits: (j, 2) lower and upper joint limit [rad].
        tip: (f, 3) centre of each fingertip in the frame of its last joint [m].
    """

    name: str
    fingers: tuple[str, ...]
    thumb: int
    joint_start: IntArray
    offset: Array
    turn: Array
    axis: Array
    sphere_start: IntArray
    sphere: Array
    speed: Array
    bound: Array
    bound_speed: Array
    palm: Array
    path: Array
    limits: Array
    tip: Array


@lru_cache(maxsize=16)
def hand_tables(hand: Hand, spacing: float = COARSE) -> HandTables:
    """The tables of a hand.

    Args:
        hand: which hand.
        spacing: between spheres [m].

    Raises:
        HandError: MuJoCo refuses the model.
    """
    model = compile_hand(hand)
    joint_of_body = _carriers(model)
    frames = _frames(model)
    anchors = [
        (_quat_rotate(frames[b][1], model.jnt_pos[j]) + frames[b][0], frames[b][1])
        for j, b in enumerate(model.jnt_bodyid)
    ]
    before = _joint_before(model, joint_of_body)
    offset, turn = np.zeros((model.njnt, 3)), np.zeros((model.njnt, 4))
    for j, (place, rotation) in enumerate(anchors):
        base_p, base_q = anchors[before[j]] if before[j] >= 0 else (np.zeros(3), np.array([1.0, 0, 0, 0]))
        inverse = base_q * [1, -1, -1, -1]
        offset[j] = _quat_rotate(inverse, place - base_p)
        turn[j] = _quat_multiply(inverse, rotation)
    filled: list[list[Array]] = [[] for _ in range(model.njnt + 1)]
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        place, rotation = frames[body]
        centre = _quat_rotate(rotation, model.geom_pos[geom]) + place
        facing = _matrix(_quat_multiply(rotation, model.geom_quat[geom]))
        spheres = _spheres(model, geom, spacing)
        spheres[:, :3] = spheres[:, :3] @ facing.T + centre
        joint = joint_of_body[body]
        if joint >= 0:
            at, around = anchors[joint]
            spheres[:, :3] = (spheres[:, :3] - at) @ _matrix(around)
        filled[joint].append(spheres)
    groups = [np.concatenate(group) if group else np.zeros((0, 4)) for group in filled]
    palm, links = groups[-1], groups[:-1]
    path = np.stack([hand.at(share) for share in np.linspace(0.0, 1.0, _knots(hand))])
    speed = _speeds(hand, offset, links, path)
    bounds = np.array([_bound(group) for group in links])
    starts = np.concatenate([[0], np.cumsum([len(group) for group in links])])
    ordered = sorted(hand.fingers, key=lambda finger: hand.columns(finger.name).start)
    firsts = [hand.columns(finger.name).start for finger in ordered]
    return HandTables(
        name=hand.name,
        fingers=tuple(finger.name for finger in ordered),
        thumb=[finger.name for finger in ordered].index(hand.fingers[0].name),
        joint_start=np.array([*firsts, model.njnt], dtype=np.int64),
        offset=offset,
        turn=turn,
        axis=np.array(model.jnt_axis),
        sphere_start=starts.astype(np.int64),
        sphere=np.concatenate(links),
        speed=np.concatenate(speed),
        bound=bounds,
        bound_speed=np.array([s.max() if len(s) else 0.0 for s in speed]),
        palm=palm,
        path=path,
        limits=np.array(hand.limits),
        tip=np.array([_tip(model, finger.tip_site, frames, anchors, joint_of_body) for finger in ordered]),
    )


def _tip(model: Any, site: str, frames: list[Any], anchors: list[Any], carrier: IntArray) -> Array:
    """(3,) centre of a fingertip in the frame of the joint that carries it [m]."""
    index = model.site(site).id
    place, rotation = frames[int(model.site_bodyid[index])]
    centre = _quat_rotate(rotation, model.site_pos[index]) + place
    at, around = anchors[carrier[int(model.site_bodyid[index])]]
    return np.asarray((centre - at) @ _matrix(around))


def _knots(hand: Hand) -> int:
    """Points that hold every finger's path: all of two unless a finger's has more."""
    return int(np.lcm.reduce([len(finger.closing) - 1 for finger in hand.fingers])) + 1


def _carriers(model: Any) -> IntArray:
    """(bodies,) the joint that carries each body, -1 for the palm."""
    carrier = np.full(model.nbody, -1, dtype=np.int64)
    for body in range(1, model.nbody):
        own = np.flatnonzero(model.jnt_bodyid == body)
        carrier[body] = own[-1] if len(own) else carrier[model.body_parentid[body]]
    return carrier


def _joint_before(model: Any, carrier: IntArray) -> list[int]:
    before = []
    for joint in range(model.njnt):
        body = int(model.jnt_bodyid[joint])
        same = [k for k in np.flatnonzero(model.jnt_bodyid == body) if k < joint]
        before.append(int(same[-1]) if same else int(carrier[model.body_parentid[body]]))
    return before


def _frames(model: Any) -> list[tuple[Array, Array]]:
    """Place and orientation of each body in the palm frame, all joints at zero."""
    frames = [(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))]
    for body in range(1, model.nbody):
        place, rotation = frames[model.body_parentid[body]]
        frames.append(
            (
                place + _quat_rotate(rotation, model.body_pos[body]),
                _quat_multiply(rotation, model.body_quat[body]),
            )
        )
    return frames


def _spheres(model: Any, geom: int, spacing: float) -> Array:
    """(n, 4) spheres of one shape in its own frame."""
    import mujoco

    size, kind = model.geom_size[geom], int(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return _box_spheres(size, spacing)
    length = size[1] if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
    # Between two spheres of radius r the capsule stands out by about spacing²/8r.
    step = min(spacing, float(np.sqrt(8 * size[0] * spacing / 20)))
    count = max(1, int(np.ceil(2 * length / step)) + 1) if length > 1e-6 else 1
    out = np.zeros((count, 4))
    out[:, 2] = np.linspace(-length, length, count) if count > 1 else 0.0
    out[:, 3] = size[0]
    return out


def _box_spheres(half: Array, spacing: float) -> Array:
    """(n, 4) spheres just under the faces of a box."""
    radius = _EDGE[spacing] * float(half.min())
    inner = half - radius
    axes = [np.linspace(-h, h, max(2, int(np.ceil(2 * h / (_SPREAD[spacing] * spacing))) + 1)) for h in inner]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    on_face = (np.abs(np.abs(grid) - inner) < 1e-9).any(axis=1)
    points = grid[on_face]
    return np.concatenate([points, np.full((len(points), 1), radius)], axis=1)


def _bound(spheres: Array) -> Array:
    if not len(spheres):
        return np.zeros(4)
    middle = (spheres[:, :3].min(axis=0) + spheres[:, :3].max(axis=0)) / 2
    return np.append(middle, (np.linalg.norm(spheres[:, :3] - middle, axis=1) + spheres[:, 3]).max())


def _speeds(hand: Hand, offset: Array, links: list[Array], path: Array) -> list[Array]:
    """A bound on the path length of every sphere's centre for a unit of closing, by joint."""
    rate = np.abs(np.diff(path, axis=0)).max(axis=0) * (len(path) - 1)
    out = []
    for joint, spheres in enumerate(links):
        first = next(hand.columns(f.name).start for f in hand.fingers if hand.joints[joint] in f.joints)
        lever = np.linalg.norm(spheres[:, :3], axis=1)
        total = rate[joint] * lever
        for k in range(joint - 1, first - 1, -1):
            lever = lever + np.linalg.norm(offset[k + 1])
            total = total + rate[k] * lever
        out.append(total)
    return out


def _quat_multiply(a: Array, b: Array) -> Array:
    w, x, y, z = a
    return np.array(
        [
            w * b[0] - x * b[1] - y * b[2] - z * b[3],
            w * b[1] + x * b[0] + y * b[3] - z * b[2],
            w * b[2] - x * b[3] + y * b[0] + z * b[1],
            w * b[3] + x * b[2] - y * b[1] + z * b[0],
        ]
    )


def _matrix(q: Array) -> Array:
    from ..spatial import rotation_from_quaternion

    return rotation_from_quaternion(q)


def _quat_rotate(q: Array, v: Array) -> Array:
    return np.asarray(_matrix(q) @ v)
