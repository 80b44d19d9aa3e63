"""Whether a hand is fit for use: every fault, each in one sentence.

The description and the model are checked first (:mod:`preshape.hands.findings`). If they have no fault, the
hand is moved and checked when open, along its closing path, and for thumb and fingers that oppose each other.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..exceptions import HandError
from ..types import Array
from .compiled import read_model
from .description import hand_from
from .findings import DEPTH, Finding, description_findings, model_findings
from .hand import Hand
from .kinematics import HandKinematics
from .load import (
    built_in_text,
    guess,
    hand_names,
    is_description,
    is_model,
    load_hand,
    model_file,
    read_description,
    read_hand_model,
    source_of,
    split_motors,
    with_motors,
)
from .plausible import geometry_findings, motor_findings
from .rewrite import rebuilt
from .trial import trials

LEAST_TRAVEL = 5e-3
"""Least way of a fingertip from open to closed [m] [C]."""

STEPS = 25
"""Steps along a closing path."""

OPPOSED = 0.2
"""Least cosine between a fingertip's motion at half closed and the direction to the opposing tip [C]."""


def check_hand(source: str | Path) -> list[Finding]:
    """All faults of a hand; empty if it is fit for use.

    Args:
        source: A TOML file, a model, or the name of a hand; a file may be followed by ``#motors=FILE``.

    Raises:
        UnknownHand: There is no hand of that name.
        HandError: The description or the model cannot be read at all.
        EnvironmentFailure: A file cannot be read, or a model cannot be fetched.
    """
    return inspect_hand(source)[0]


def inspect_hand(source: str | Path) -> tuple[list[Finding], Hand | None]:
    """The faults as in :func:`check_hand`, and the hand, or ``None`` if it cannot be built."""
    text = str(source)
    file, motors = split_motors(text)
    found: list[Finding] = []
    if is_model(file):
        path = Path(file)
        model = read_hand_model(path)
        data = guess(model, path, motors).data
    elif is_description(file):
        path = Path(file)
        data = with_motors(read_description(path), motors)
        if data.get("name") in hand_names():
            text_of = f"a built-in hand is called {data['name']}: choose another name"
            found.append(Finding(code="name", text=text_of))
        found += description_findings(data)
        model = read_model(model_file(data, path))
        found += model_findings(data, model)
    else:
        hand = load_hand(text)
        name = hand.source.removesuffix(":left").removesuffix(":right")
        found = _built_in_findings(name) if name in hand_names() else []
        return found + motion_findings(hand), hand
    if any(finding.code != "name" for finding in found):
        return found, None
    try:
        hand = rebuilt(data, model, text)
    except HandError as error:
        reason = str(error).removeprefix(f"hand {data['name']!r}: ")
        code = "outside_limits" if "outside the limits" in reason else "contradiction"
        return [*found, Finding(code=code, text=reason)], None
    hand = replace(hand, source=source_of(text))
    found += geometry_findings(data, model)
    return found + shape_findings(hand) + motion_findings(hand), hand


def _built_in_findings(name: str) -> list[Finding]:
    data, mjcf = built_in_text(name)
    hand_from(data, mjcf)
    model = read_model(mjcf)
    return [*description_findings(data), *model_findings(data, model), *geometry_findings(data, model)]


def shape_findings(hand: Hand) -> list[Finding]:
    """Faults of a palm or finger that has no shape that collides."""
    kinematics = HandKinematics(hand)
    model, found = kinematics.model, []
    solid = {shape.body for shape in kinematics.shapes()}
    if hand.palm_body not in solid:
        found.append(Finding(code="no_shape", text=f"the palm {hand.palm_body!r} has no shape that collides"))
    for finger in hand.fingers:
        bodies = {model.body(int(model.joint(joint).bodyid[0])).name for joint in finger.joints}
        if not bodies & (solid - {finger.tip_body}) and len(bodies) > 1:
            text = f"no link of the {finger.name} but its tip has a shape that collides"
            found.append(Finding(code="no_shape", text=text))
    return found


def motion_findings(hand: Hand) -> list[Finding]:
    """Faults that show when the hand moves."""
    kinematics = HandKinematics(hand)
    found = _open_collision(hand, kinematics)
    if not found:
        found = _closing_collisions(hand, kinematics)
    found += _direction_findings(hand, kinematics) + _preshape_findings(hand)
    found += motor_findings(hand, kinematics)
    made = trials(hand)
    if not found and not any(trial.against for trial in made):
        text = f"it holds neither a cylinder nor a cube; {made[0]}, {made[1]}"
        found.append(Finding(code="holds_nothing", text=text))
    return found


def _open_collision(hand: Hand, kinematics: HandKinematics) -> list[Finding]:
    kinematics.set_posture(hand.at(0.0))
    return [
        Finding(
            code="open_collides",
            text=f"two links of the open hand overlap: {one} is {1000 * depth:.1f} mm inside {other}",
        )
        for one, other, depth in kinematics.self_collisions(DEPTH)[:3]
    ]


def _closing_collisions(hand: Hand, kinematics: HandKinematics) -> list[Finding]:
    """Collisions while the thumb closes alone, and while the other fingers close together.

    Contact between thumb and fingers is not a fault, because it is the purpose of closing.
    """
    found = []
    model, owner = kinematics.model, {}
    for finger in hand.fingers:
        for joint in finger.joints:
            owner[model.body(int(model.joint(joint).bodyid[0])).name] = finger.name
    name_of = {
        model.geom(g).name: owner.get(model.body(int(model.geom_bodyid[g])).name) for g in range(model.ngeom)
    }
    first = hand.fingers[0].name
    for thumb in (True, False):
        moving = [(k == 0) == thumb for k in range(len(hand.fingers))]
        for c in np.linspace(0.0, 1.0, STEPS + 1):
            kinematics.set_posture(hand.at(np.where(moving, c, 0.0)))
            hits = [
                hit
                for hit in sorted(kinematics.self_collisions(DEPTH), key=lambda hit: -hit[2])
                if None in (pair := (name_of[hit[0]], name_of[hit[1]]))
                or (pair[0] == first) == (pair[1] == first)
            ]
            if hits:
                one, other, depth = hits[0]
                who = f"the {first}" if thumb else "the fingers"
                text = (
                    f"on the closing path of {who} the hand collides with itself at {c:.2f} of the way: "
                    f"{one} is {1000 * depth:.1f} mm inside {other}"
                )
                found.append(Finding(code="closing_collides", text=text))
                break
    return found


def half_closed(hand: Hand, kinematics: HandKinematics) -> tuple[Array, Array]:
    """(k, 3) positions of the fingertips at half closed [m] and (k, 3) unit directions of their motion."""
    h = 1e-4
    tips = []
    for c in (0.5 - h, 0.5, 0.5 + h):
        kinematics.set_posture(hand.at(c))
        tips.append(kinematics.tips(hand.fingers)[0])
    moves = tips[2] - tips[0]
    length = np.linalg.norm(moves, axis=1, keepdims=True)
    return tips[1], np.divide(moves, length, out=np.zeros_like(moves), where=length > 1e-9)


def opposition(hand: Hand, kinematics: HandKinematics) -> Array:
    """(k - 1,) how well the thumb opposes each of the other fingers at half closed, from -1 to 1 (best).

    It is the smaller of two cosines: between the motion of the thumb's tip and the direction to the finger's
    tip, and between the motion of the finger's tip and the direction to the thumb's tip.
    """
    tips, moves = half_closed(hand, kinematics)
    across = tips[1:] - tips[0]
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return np.asarray(np.minimum(across @ moves[0], -np.einsum("ki,ki->k", across, moves[1:])))


def _direction_findings(hand: Hand, kinematics: HandKinematics) -> list[Finding]:
    found = []
    _, moves = half_closed(hand, kinematics)
    ends = []
    for c in (0.0, 0.5, 1.0):
        kinematics.set_posture(hand.at(c))
        ends.append(kinematics.tips(hand.fingers)[0])
    travel = np.linalg.norm(np.diff(ends, axis=0), axis=2).sum(axis=0)
    for finger, move, way in zip(hand.fingers, moves, travel, strict=True):
        if not move.any():
            text = f"the closing path does not move the {finger.name}'s tip at half closed"
            found.append(Finding(code="does_not_close", text=text))
        elif way < LEAST_TRAVEL:
            text = f"the closing path moves the {finger.name}'s tip by {1000 * way:.1f} mm only"
            found.append(Finding(code="does_not_close", text=text))
    for finger, move in zip(hand.fingers[1:], moves[1:], strict=True):
        # The palm faces -y of its frame, where the thumb is.
        if move[1] > OPPOSED:
            text = (
                f"the {finger.name} closes away from the side that the palm faces: reverse its closing path "
                "or correct the palm frame"
            )
            found.append(Finding(code="closes_outward", text=text))
    best = float(opposition(hand, kinematics).max())
    if not found and best < OPPOSED:
        text = (
            f"the thumb does not oppose: at half closed no fingertip and the {hand.fingers[0].name}'s tip "
            f"move towards each other (cosine {best:.2f}, needed {OPPOSED:g}): change the thumb's first "
            "joint angles, or list another finger first"
        )
        found.append(Finding(code="thumb_not_opposed", text=text))
    return found


def _preshape_findings(hand: Hand) -> list[Finding]:
    found = []
    for finger in hand.fingers:
        limits = hand.limits[hand.columns(finger.name)]
        for k, joint in enumerate(finger.joints):
            low, high = finger.preshape[k]
            if low < high and np.ptp(finger.closing[:, k]) > 0:
                text = (
                    f"{joint} has a preshape range, but the closing path of the {finger.name} moves it too; "
                    "only one of them may"
                )
                found.append(Finding(code="preshape", text=text))
            if low < limits[k, 0] - 1e-9 or high > limits[k, 1] + 1e-9:
                text = f"the preshape range of {joint} goes beyond its limits"
                found.append(Finding(code="outside_limits", text=text))
    return found


def close_empty(hand: Hand) -> Array:
    """(fingers,) closing, 0 to 1, at which each finger of an empty hand meets another part of the hand.

    Only pictures use it.
    """
    kinematics = HandKinematics(hand)
    reached = np.zeros(len(hand.fingers))
    moving = np.ones(len(hand.fingers), dtype=bool)
    for _ in range(STEPS):
        for k in np.flatnonzero(moving):
            ahead = reached.copy()
            ahead[k] = min(1.0, reached[k] + 1.0 / STEPS)
            kinematics.set_posture(hand.at(ahead))
            if kinematics.self_collisions(0.5e-3):
                moving[k] = False
            else:
                reached = ahead
    return reached
