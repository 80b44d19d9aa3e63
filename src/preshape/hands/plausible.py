"""Whether a description fits the geometry of its model: fingertips, sides, sizes and motors.

:mod:`preshape.hands.findings` finds what contradicts itself. Here is found what is consistent and
nevertheless cannot be: a fingertip at the wrong end of its link, U three times too large, motors that hold
nothing.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from ..spatial import rotation_from_quaternion
from ..types import Array
from .compiled import CompiledModel
from .couples import Table, couple_joints, couples_of
from .description import direction
from .digits import outwards
from .findings import Finding, fingers_of, joints_of
from .hand import Hand
from .skeleton import Skeleton

_OFF = 8e-3
"""Distance of a fingertip from its link beyond which it is not on it [m] [C]."""

_SHORT = 0.45
"""Share of a link's length by which a fingertip may stop short of its end [C]."""

_ASIDE = 0.5
"""Least cosine between a fingertip's direction and that of its link [C]."""

_TIMES = 2.2
"""Largest ratio of U or pitch to what the model has [C]."""

_WEAKEST, _STRONGEST = 0.2, 500.0
"""Plausible forces of a finger at its tip [N] [C]; the weakest hand that was seen has 1 N."""


def geometry_findings(data: Table, model: CompiledModel) -> list[Finding]:
    """Faults of a description whose names and numbers are right, against its model's geometry."""
    own = couples_of(data, "it")
    taken = {joint for couple in own for joint in couple_joints(couple)}
    more = [couple for couple in model.couples if not taken & set(couple_joints(couple))]
    skeleton = Skeleton(model, [*own, *more])
    fixed = data.get("fixed", {})
    if isinstance(fixed, dict):
        skeleton.neutral |= {str(joint): float(angle) for joint, angle in fixed.items()}
        skeleton.place({})
    found: list[Finding] = []
    for entry in fingers_of(data):
        found += _tip_findings(skeleton, entry)
    return [*found, *_size_findings(skeleton, data), *_side_findings(skeleton, data)]


def _tip_findings(skeleton: Skeleton, entry: Table) -> list[Finding]:
    """A fingertip that is not at the end of its link, or does not point along it."""
    name, joints, radius = str(entry["name"]), joints_of(entry), float(entry["tip_radius"])
    last = joints[-1]
    centre, points = _tip(skeleton, entry)
    body = int(skeleton.m.body(str(entry["tip_body"])).id)
    if skeleton.m.body_weldid[body] != skeleton.m.body_weldid[skeleton.body_of(last)]:
        text = (
            f"the tip of the {name} is on {entry['tip_body']}, which its last joint {last!r} does not move: "
            "list the joints from the palm outwards, and name the last link"
        )
        return [Finding(code="tip_place", text=text)]
    vertices, _ = skeleton.vertices(body)
    if not len(vertices):
        return []
    T = skeleton.frame(body)
    world = vertices @ T[:3, :3].T + T[:3, 3]
    anchor, hinge = skeleton.anchor(last), skeleton.axis(last)
    before = skeleton.anchor(joints[-2]) if len(joints) > 1 else T[:3, 3]
    reach = outwards(world, anchor, hinge, before)
    length = max(float(np.linalg.norm(reach)), 1e-6)
    along = reach / length
    frame = np.stack([along, hinge, np.cross(hinge, along)])
    spans = (world - anchor) @ frame.T
    place = frame @ (centre - anchor)
    beyond = np.maximum(spans.min(axis=0) - place, place - spans.max(axis=0))
    off = float(np.linalg.norm(np.maximum(beyond, 0.0)))
    found = []
    if off > max(_OFF, radius):
        text = (
            f"the tip of the {name} is {1000 * off:.0f} mm off its link {entry['tip_body']}: correct tip_pos"
        )
        found.append(Finding(code="tip_place", text=text))
    elif float(spans[:, 0].max()) - (place[0] + radius) > max(_SHORT * length, 1.5 * radius, 0.01):
        short = float(spans[:, 0].max()) - (place[0] + radius)
        text = (
            f"the tip of the {name} stops {1000 * short:.0f} mm short of the end of {entry['tip_body']}: "
            "correct tip_pos"
        )
        found.append(Finding(code="tip_place", text=text))
    cosine = float(points @ along)
    if cosine < _ASIDE:
        local = T[:3, :3].T @ along
        way = "backwards, to its own joint" if cosine < -_ASIDE else "to the side of its link"
        text = (
            f"the tip of the {name} points {way}: tip_points should be about "
            f"[{', '.join(f'{x + 0.0:.2f}' for x in np.round(local, 2))}] in the frame of {entry['tip_body']}"
        )
        found.append(Finding(code="tip_points", text=text))
    return found


def _tip(skeleton: Skeleton, entry: Table) -> tuple[Array, Array]:
    """Centre [m] and direction of a fingertip as described, in the model's world."""
    body = int(skeleton.m.body(str(entry["tip_body"])).id)
    T = skeleton.frame(body)
    R, p = T[:3, :3], T[:3, 3]
    if "tip_pos" in entry:
        place, turn = R @ np.asarray(entry["tip_pos"], dtype=np.float64) + p, R
    else:
        place, turn = _site(skeleton, str(entry["tip_site"]))
    points = R @ direction(entry["tip_points"], "tip_points") if "tip_points" in entry else turn[:, 2]
    return place, points


def _site(skeleton: Skeleton, name: str) -> tuple[Array, Array]:
    site = skeleton.m.site(name).id
    T = skeleton.frame(int(skeleton.m.site_bodyid[site]))
    turn = T[:3, :3] @ rotation_from_quaternion(skeleton.m.site_quat[site])
    return T[:3, :3] @ skeleton.m.site_pos[site] + T[:3, 3], turn


def _palm(skeleton: Skeleton, palm: Table) -> Array:
    """(3, 3) axes of the palm frame as columns, in the model's world."""
    if "site" in palm:
        return _site(skeleton, str(palm["site"]))[1]
    z, y = direction(palm["points"], "palm.points"), -direction(palm["faces"], "palm.faces")
    R = skeleton.frame(int(skeleton.m.body(str(palm["body"])).id))[:3, :3]
    return np.asarray(R @ np.stack([np.cross(y, z), y, z], axis=1))


def _size_findings(skeleton: Skeleton, data: Table) -> list[Finding]:
    """U or pitch that no part of the model has."""
    skeleton.place({})
    found, bases, phalanges = [], [], []
    entries = fingers_of(data)
    for entry in entries:
        joints = joints_of(entry)
        anchors = np.array([*(skeleton.anchor(joint) for joint in joints), _tip(skeleton, entry)[0]])
        if entry is not entries[0] or len(entries) == 1:  # a thumb's metacarpal is longer than any phalanx
            phalanges += [float(x) for x in np.linalg.norm(np.diff(anchors, axis=0), axis=1) if x > 5e-3]
        bases.append([skeleton.anchor(joint) for joint in joints])
    u, pitch = float(data["u"]), float(data["finger_pitch"])
    if phalanges and not min(phalanges) / _TIMES <= u <= _TIMES * max(phalanges):
        text = (
            f"U is {1000 * u:.0f} mm, but the model's phalanges are {1000 * min(phalanges):.0f} to "
            f"{1000 * max(phalanges):.0f} mm long: U is the length of the middle finger's proximal phalanx"
        )
        found.append(Finding(code="u", text=text))
    apart = [
        float(np.linalg.norm(a - b)) for one, other in pairwise(bases[1:]) for a in one[:2] for b in other[:2]
    ]
    if apart and not min(apart) / _TIMES <= pitch <= _TIMES * max(apart):
        text = (
            f"finger_pitch is {1000 * pitch:.0f} mm, but neighbouring fingers of the model are "
            f"{1000 * min(apart):.0f} mm apart"
        )
        found.append(Finding(code="finger_pitch", text=text))
    return found


def _side_findings(skeleton: Skeleton, data: Table) -> list[Finding]:
    """A palm frame or a side that does not fit the places of the fingers."""
    skeleton.place({})
    palm = _palm(skeleton, data["palm"])
    side = str(data.get("side", "right"))
    entries = fingers_of(data)
    bases = np.array([skeleton.anchor(joints_of(entry)[0]) for entry in entries])
    tips = np.array([_tip(skeleton, entry)[0] for entry in entries])
    found = []
    along = float(np.mean((tips[1:] - bases[1:]) @ palm[:, 2]))
    length = float(np.mean(np.linalg.norm(tips[1:] - bases[1:], axis=1)))
    if along < -0.5 * length:
        text = "the fingers point along -z of the palm frame: reverse palm.points"
        found.append(Finding(code="palm_points", text=text))
    x = bases @ palm[:, 0] * (1.0 if side == "right" else -1.0)
    if len(x) > 2:
        steps = np.diff(x[1:])
        if (steps > 2e-3).all():
            other = "left" if side == "right" else "right"
            text = (
                f"the fingers are listed from the little finger's side of a {side} hand: list them from the "
                f'index side, reverse palm.faces, or say side = "{other}"'
            )
            found.append(Finding(code="side", text=text))
    if len(x) > 3 and not found:
        offset, width = float(x[0] - x[1:].mean()), max(float(np.ptp(x[1:])), 0.02)
        if offset < -0.25 * width:
            text = (
                f"the thumb is on the little finger's side of a {side} hand: correct side or the palm frame"
            )
            found.append(Finding(code="side", text=text))
    return found


def motor_findings(hand: Hand, kinematics: Any) -> list[Finding]:
    """Motors too weak to press, or stronger than any hand's.

    Args:
        hand: The hand.
        kinematics: Its :class:`~preshape.hands.kinematics.HandKinematics`.
    """
    levers = np.full(len(hand.joints), 0.0)
    for share in (0.0, 0.5):
        kinematics.set_posture(hand.at(share))
        jacobians = kinematics.tip_jacobians(hand.fingers)[0]
        for finger, jacobian in zip(hand.fingers, jacobians, strict=True):
            columns = hand.columns(finger.name)
            reach = np.linalg.norm(jacobian[:, columns], axis=0)
            levers[columns] = np.maximum(levers[columns], reach)
    found = []
    at = {joint: k for k, joint in enumerate(hand.joints)}
    for motor, torque in zip(hand.motors, hand.torque_limits, strict=True):
        lever = max(float(max(levers[at[joint]] for joint in motor.joints)), 0.01)
        force = float(torque) / lever
        if not _WEAKEST <= force <= _STRONGEST:
            how = "too weak to hold anything" if force < _WEAKEST else "stronger than any hand's"
            text = (
                f"the motor {motor.name} with {float(torque):g} N m presses with {force:.3g} N at the "
                f"fingertip, {how}: torque_limit is in N m"
            )
            found.append(Finding(code="torque", text=text))
    if len(found) > 2:
        first = found[0].text
        return [Finding(code="torque", text=f"{first} (and {len(found) - 1} more motors)")]
    return found
