"""A hand as arrays for the closing kernel: joint chains, spheres that fill its links, closing paths.

Everything is in the palm frame. The spheres come from :mod:`preshape.kernels.hand_spheres` and lie inside the
true shapes. The shapes protrude from them by at most 3 mm (``COARSE``; capsules by 1 mm) or 0.5 mm (``FINE``;
capsules by 0.15 mm), edges and corners of boxes and hulls included. Neighbouring spheres share a bounding
sphere, so that most distance queries end at the bounding sphere.

Results that take a second or more to compute are cached on disk, keyed by the hand's content. If a cache file
cannot be read, its result is computed again; if the cache folder cannot be written, nothing is cached.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
from collections.abc import Callable
from dataclasses import fields
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from ..files import cache_folder, keep_arrays, read_arrays
from ..hands.hand import Hand
from ..hands.kinematics import compile_hand, hand_hulls
from ..hands.motors import DEGREE, KNOTS
from ..kernels.hand_spheres import COARSE, FINE, LinkSolid, bound, grouped, link_spheres
from ..kernels.hull_spheres import Polyhedron
from ..kernels.tables import HandTables
from ..types import Array, IntArray

CACHE_VERSION = 8
"""Increased whenever cached tables, preshapes or pinches are computed differently."""
_GROUP = {COARSE: 12, FINE: 16}
"""Largest number of spheres under one bounding sphere [C]."""
_STILL = 1e-6
"""Path bound of a sphere that the closing does not move [m]; positive, because it is used as a divisor."""
_T = TypeVar("_T")


def cached(kind: type[_T], hand: Hand, label: str, compute: Callable[[], _T]) -> _T:
    """A value that depends on a hand, read from the disk cache if it was computed before.

    Args:
        kind: Class of the value: a dataclass of arrays, numbers and tuples of text.
        hand: The hand.
        label: Name of the value, with every setting that it depends on.
        compute: Function that computes the value.
    """
    file = cache_folder() / "hands" / f"{digest(hand, label)}.npz"
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        arrays = read_arrays(file)
        plain = json.loads(str(arrays.pop("plain")))
        plain = {name: tuple(item) if isinstance(item, list) else item for name, item in plain.items()}
        return kind(**plain, **arrays)
    computed = compute()
    values = {field.name: getattr(computed, field.name) for field in fields(computed)}  # type: ignore[arg-type]
    arrays = {name: item for name, item in values.items() if isinstance(item, np.ndarray)}
    plain = {name: item for name, item in values.items() if name not in arrays}
    keep_arrays(file, **arrays, plain=np.array(json.dumps(plain)))
    return computed


def digest(hand: Hand, label: str) -> str:
    """Hash of a hand's content and a label."""
    state = hashlib.sha256(f"{CACHE_VERSION} {label}".encode())

    def add(name: str, item: object) -> None:
        state.update(name.encode())
        state.update(item.tobytes() if isinstance(item, np.ndarray) else repr(item).encode())

    for field in fields(hand):
        if field.name in ("fingers", "motors"):
            for item in getattr(hand, field.name):
                for part in fields(item):
                    add(part.name, getattr(item, part.name))
        elif field.name != "source":  # a copy of the hand in another folder has the same hash
            add(field.name, getattr(hand, field.name))
    return state.hexdigest()


@lru_cache(maxsize=16)
def hand_tables(hand: Hand, detail: float = COARSE) -> HandTables:
    """The tables of a hand.

    Args:
        hand: The hand.
        detail: ``COARSE`` or ``FINE``: distance by which links may protrude from their spheres [m].

    Raises:
        HandError: MuJoCo refuses the model.
    """
    return cached(HandTables, hand, f"tables {detail:g}", lambda: _tables(hand, detail))


def _tables(hand: Hand, detail: float) -> HandTables:
    """Compute the tables.

    1. Compute each joint's frame relative to the joint before it in its chain, all joints at zero.
    2. Fill the shapes of each link and of the palm with spheres, in groups.
    3. Compute the closing path at evenly spaced points, and an upper bound on each sphere's speed along it.
    """
    model = compile_hand(hand)
    # 1. Joint chains.
    joint_of_body = _carrying_joints(model)
    frames = _body_frames(model)
    anchors = _joint_frames(model, frames)
    before = _previous_joints(model, joint_of_body)
    offset, turn = np.zeros((model.njnt, 3)), np.zeros((model.njnt, 4))
    for j, (place, rotation) in enumerate(anchors):
        base_p, base_q = anchors[before[j]] if before[j] >= 0 else (np.zeros(3), np.array([1.0, 0, 0, 0]))
        inverse = base_q * [1, -1, -1, -1]
        offset[j] = _quat_rotate(inverse, place - base_p)
        turn[j] = _quat_multiply(inverse, rotation)
    # 2. Spheres.
    shapes = link_shapes(hand)
    groups = [grouped(link_spheres(link, detail), _GROUP[detail]) for link in shapes]
    # The forearm and its like are behind the palm, in this order too.
    palm_groups, joint_groups = [*groups[-2], *groups[-1]], groups[:-2]
    links = [np.concatenate([np.zeros((0, 4)), *own]) for own in joint_groups]
    # 3. Closing path and speeds.
    path = hand.controls([hand.at(share) for share in np.linspace(0.0, 1.0, _path_points(hand))])
    motor, law, bent, unloaded = _laws(hand)
    rate = _joint_rates(hand, path)
    speed = np.concatenate(_speeds(hand, offset, links, rate))
    flat = [group for own in joint_groups for group in own]
    group_sphere = _run_starts([len(group) for group in flat])
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
        moving=np.array(
            [_first_moving(rate, f, e) for f, e in itertools.pairwise([*firsts, model.njnt])], dtype=np.int64
        ),
        sphere_start=_run_starts([len(link) for link in links]),
        sphere=np.concatenate(links),
        speed=speed,
        group_start=_run_starts([len(own) for own in joint_groups]),
        group_sphere=group_sphere,
        bound=np.array([bound(group) for group in flat]).reshape(-1, 4),
        bound_speed=np.array([speed[a:b].max() for a, b in itertools.pairwise(group_sphere)]),
        palm=np.concatenate([np.zeros((0, 4)), *palm_groups]),
        palm_spheres=sum(len(group) for group in groups[-2]),
        palm_group=_run_starts([len(group) for group in palm_groups]),
        palm_bound=np.array([bound(group) for group in palm_groups]).reshape(-1, 4),
        path=path,
        motor=motor,
        command=hand.command_matrix(),
        range=hand.ranges(),
        law=law,
        bent=bent,
        unloaded=unloaded,
        tip=np.array([_tip(model, finger.tip_site, frames, anchors, joint_of_body) for finger in ordered]),
    )


def _tip(model: Any, site: str, frames: list[Any], anchors: list[Any], carrier: IntArray) -> Array:
    """(3,) centre of a fingertip in the frame of the joint that carries it [m]."""
    index = model.site(site).id
    place, rotation = frames[int(model.site_bodyid[index])]
    centre = _quat_rotate(rotation, model.site_pos[index]) + place
    at, around = anchors[carrier[int(model.site_bodyid[index])]]
    return np.asarray((centre - at) @ _matrix(around))


def _path_points(hand: Hand) -> int:
    """Number of evenly spaced path points that include every point of every finger's path."""
    return int(np.lcm.reduce([len(finger.closing) - 1 for finger in hand.fingers])) + 1


def _carrying_joints(model: Any) -> IntArray:
    """(bodies,) index of the joint that carries each body, -1 for the palm."""
    carrier = np.full(model.nbody, -1, dtype=np.int64)
    for body in range(1, model.nbody):
        own = np.flatnonzero(model.jnt_bodyid == body)
        carrier[body] = own[-1] if len(own) else carrier[model.body_parentid[body]]
    return carrier


def _previous_joints(model: Any, carrier: IntArray) -> list[int]:
    """For each joint the index of the one before it in its chain, -1 for the first."""
    before = []
    for joint in range(model.njnt):
        body = int(model.jnt_bodyid[joint])
        same = [k for k in np.flatnonzero(model.jnt_bodyid == body) if k < joint]
        before.append(int(same[-1]) if same else int(carrier[model.body_parentid[body]]))
    return before


def _body_frames(model: Any) -> list[tuple[Array, Array]]:
    """Position [m] and quaternion wxyz of each body in the palm frame, all joints at zero."""
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


def _run_starts(counts: list[int]) -> IntArray:
    """(n + 1,) first index of each of n consecutive runs, and the end of the last."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int64)


def _first_moving(rate: Array, first: int, end: int) -> int:
    """Index of a finger's first joint that the closing path moves; ``end`` if it moves none."""
    return next((j for j in range(first, end) if rate[j] > 0), end)


def _laws(hand: Hand) -> tuple[IntArray, Array, IntArray, Array]:
    """The motor of each joint and the laws, as in :class:`~preshape.kernels.tables.HandTables`."""
    joints = len(hand.joints)
    motor, bent = np.zeros(joints, dtype=np.int64), np.zeros(joints, dtype=np.int64)
    law, unloaded = np.zeros((joints, DEGREE + 1)), np.zeros((KNOTS, joints))
    for k, (one, columns) in enumerate(zip(hand.motors, hand.motor_columns(), strict=True)):
        motor[columns], law[columns] = k, one.polynomials
        if len(one.path):
            bent[columns], unloaded[:, columns] = 1, one.path
    return motor, law, bent, unloaded if bent.any() else unloaded[:2]


def _joint_rates(hand: Hand, path: Array) -> Array:
    """(j,) the largest derivative of each joint by the place on the closing path, from any preshape [rad]."""
    rate = np.zeros(len(hand.joints))
    of_path = np.abs(np.diff(path, axis=0)).max(axis=0) * (len(path) - 1)
    for k, (motor, columns) in enumerate(zip(hand.motors, hand.motor_columns(), strict=True)):
        samples = [
            motor.rates(m)
            for m in np.linspace(motor.range[0], motor.range[1], 1 if motor.affine else 8 * KNOTS)
        ]
        rate[columns] = np.abs(samples).max(axis=0) * of_path[k]
    return rate


def link_shapes(hand: Hand) -> list[list[LinkSolid]]:
    """The shapes that each joint carries, in the joint's frame; then two lists in the palm frame.

    The first of the two has the shapes of the palm; the second those of bodies that are fixed beside it, such
    as a forearm: they are in the way, and nothing is held with them.
    """
    import mujoco

    model, hulls = compile_hand(hand), hand_hulls(hand)
    carrier, frames = _carrying_joints(model), _body_frames(model)
    anchors = _joint_frames(model, frames)
    links: list[list[LinkSolid]] = [[] for _ in range(model.njnt + 2)]
    aside = _bodies_aside(model, model.body(hand.palm_body).id)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        place, rotation = frames[body]
        centre = _quat_rotate(rotation, model.geom_pos[geom]) + place
        facing = _matrix(_quat_multiply(rotation, model.geom_quat[geom]))
        joint = int(carrier[body])
        if joint >= 0:
            at, around = anchors[joint]
            centre, facing = (centre - at) @ _matrix(around), _matrix(around).T @ facing
        size, kind = model.geom_size[geom], int(model.geom_type[geom])
        box = kind == mujoco.mjtGeom.mjGEOM_BOX
        length = float(size[1]) if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
        links[joint if joint >= 0 else -1 if body in aside else -2].append(
            LinkSolid(
                place=centre,
                facing=facing,
                radius=0.0 if box else float(size[0]),
                half=np.array(size) if box else np.array([0.0, 0.0, length]),
                hull=Polyhedron(own.corners, own.faces, own.planes) if (own := hulls.get(geom)) else None,
            )
        )
    return links


def _bodies_aside(model: Any, palm: int) -> set[int]:
    """Bodies that are neither the palm, nor on the way from it to the root, nor carried by it."""
    behind = set[int]()
    body = palm
    while body > 0:
        behind.add(body)
        body = int(model.body_parentid[body])
    carried = {palm}
    for body in range(palm + 1, model.nbody):
        if int(model.body_parentid[body]) in carried:
            carried.add(body)
    return set(range(1, model.nbody)) - behind - carried


def _joint_frames(model: Any, frames: list[tuple[Array, Array]]) -> list[tuple[Array, Array]]:
    """Anchor [m] and quaternion wxyz of each joint in the palm frame, all joints at zero."""
    return [
        (_quat_rotate(frames[b][1], model.jnt_pos[j]) + frames[b][0], frames[b][1])
        for j, b in enumerate(model.jnt_bodyid)
    ]


def _speeds(hand: Hand, offset: Array, links: list[Array], rate: Array) -> list[Array]:
    """(s,) upper bound on the path length of each sphere's centre over the whole closing [m], by joint."""
    out = []
    for joint, spheres in enumerate(links):
        first = next(hand.columns(f.name).start for f in hand.fingers if hand.joints[joint] in f.joints)
        lever = np.linalg.norm(spheres[:, :3], axis=1)
        total = rate[joint] * lever
        for k in range(joint - 1, first - 1, -1):
            lever = lever + np.linalg.norm(offset[k + 1])
            total = total + rate[k] * lever
        out.append(np.maximum(total, _STILL))
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
