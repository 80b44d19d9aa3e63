"""A hand's description from its model alone: ``preshape hands init``, and ``--hand FILE.urdf`` on the fly.

Outline:

1. Read palm, fingers, thumb and palm frame from the model (:mod:`preshape.hands.anatomy`).
2. Guess what the model does not state: U, pitch, motors (:mod:`preshape.hands.motor_guesses`).
3. Rebuild the hand with the widest closing paths.
4. Shorten the fingers' paths to where they meet the palm or each other.
5. Turn the thumb to where it opposes the fingers best without a collision.
6. State everything as the table of a TOML file, and what was guessed in three lines.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import HandError
from ..types import value
from .anatomy import Anatomy, anatomy
from .compiled import CompiledModel
from .couples import Table, couple_joints, couples_of
from .digits import Digit, phalanx
from .findings import description_findings, model_findings, refuse, size_findings
from .hand import LONGEST_HAND_NAME
from .motor_guesses import Motors, motors_of
from .path_search import FingerPath, PathSearch
from .rewrite import rebuilt
from .skeleton import Skeleton

_SAID = 3  # faults of a model that one message names

_SPREAD = 0.3
"""Range to both sides in which a preshape spreads a finger [rad] [C]."""


@value
class Guess:
    """A description and what was guessed for it.

    Attributes:
        data: The description, as read from TOML.
        lines: Three sentences for people: fingers, palm, motors.
    """

    data: Table
    lines: tuple[str, ...]


def describe(
    source: CompiledModel,
    model: Path,
    *,
    root: str | None = None,
    side: str | None = None,
    motors: Table | None = None,
    taken: Iterable[str] = (),
) -> Guess:
    """Describe the hand of a model.

    Args:
        source: The compiled model.
        model: Its file; only its name is used.
        root: The hand's mount, where the model is a whole robot.
        side: ``right`` or ``left``, where geometry and names do not show it.
        motors: ``[[couple]]`` and ``[actuators]`` tables of a file of motors.
        taken: Names that the hand may not have.

    Raises:
        HandError: No part of the model looks like a hand, or several do; or the model has a fault.
    """
    label, motors = model.name, motors or {}
    refuse(size_findings(source), label)
    own = couples_of(motors, label)
    taken_joints = {joint for couple in own for joint in couple_joints(couple)}
    more = [couple for couple in source.couples if not taken_joints & set(couple_joints(couple))]
    skeleton = Skeleton(source, [*own, *more])
    found = anatomy(skeleton, root, side, label)
    drives = motors_of(skeleton, found)
    paths = [
        FingerPath(
            digit=digit,
            spread={joint: skeleton.neutral[joint] for drive in digit.spreads for joint in drive.joints},
            start=0.0,
            end=1.0,
        )
        for digit in found.digits
    ]
    data = {"name": _hand_name(model, set(taken)), **_table(skeleton, found, drives, model, motors)}
    data["finger"] = [_finger(found, k, path, {}) for k, path in enumerate(paths)]
    if faults := [*description_findings(data), *model_findings(data, source)]:
        rest = f"; and {len(faults) - _SAID} more faults" if len(faults) > _SAID else ""
        raise HandError(f"{label}: {'; '.join(map(str, faults[:_SAID]))}{rest}")
    hand = rebuilt(data, source, label)
    search = PathSearch(hand, found)
    if by_design := search.overlaps(paths):
        data["ignore"] = [list(pair) for pair in by_design]
    paths = search.fingers(paths)
    paths, ranges = search.opposed(paths)
    data["finger"] = [
        _finger(found, k, path, ranges if k == 0 else _spreads(found, path.digit))
        for k, path in enumerate(paths)
    ]
    return Guess(data=data, lines=_lines(source, found, drives, data, motors))


def _spreads(found: Anatomy, digit: Digit) -> dict[str, list[float]]:
    """Preshape ranges of the joints that spread a finger."""
    ranges: dict[str, list[float]] = {}
    for drive in digit.spreads:
        joint = drive.joints[0]
        low, high = sorted((float(drive.knots[0, 0]), float(drive.knots[-1, 0])))
        if drive.motor != joint:
            continue
        if not found.radial:
            # A little to both sides of zero, where neighbours do not meet.
            low, high = max(low, -_SPREAD), min(high, _SPREAD)
        if high - low > 0.1 and low <= 0.0 <= high:
            ranges[joint] = [low, high]
    return ranges


def _finger(found: Anatomy, k: int, path: FingerPath, ranges: dict[str, list[float]]) -> Table:
    digit = path.digit
    knots = [[round(path.at(c)[joint], 5) + 0.0 for joint in digit.joints] for c in _places(digit)]
    entry: Table = {
        "name": found.names[k],
        "joints": list(digit.joints),
        "tip_body": digit.tip_body,
        "tip_pos": [round(float(x), 5) + 0.0 for x in digit.tip.pos],
        "tip_points": [round(float(x), 4) + 0.0 for x in digit.tip.points],
        "tip_radius": round(digit.tip.radius, 5),
        "closing": knots,
    }
    if ranges:
        entry["preshape"] = {joint: [round(x, 4) + 0.0 for x in ends] for joint, ends in ranges.items()}
    return entry


def _places(digit: Digit) -> tuple[float, ...]:
    """Places on the closing path that are written: two, or five where a joint does not move in proportion."""
    middle = np.array([digit.at(0.5)[j] - (digit.at(0.0)[j] + digit.at(1.0)[j]) / 2 for j in digit.at(0.5)])
    return (0.0, 1.0) if np.abs(middle).max(initial=0.0) < 1e-3 else (0.0, 0.25, 0.5, 0.75, 1.0)


def _table(skeleton: Skeleton, found: Anatomy, drives: Motors, model: Path, motors: Table) -> Table:
    """The description without its fingers."""
    torques = sorted(drives.torques.values())
    common, gain = torques[len(torques) // 2], sorted(drives.gains.values())[len(drives.gains) // 2]
    actuators: Table = {
        "gain": gain,
        "damping": drives.damping,
        "torque_limit": common,
        "gains": {motor: x for motor, x in drives.gains.items() if x != gain},
        "torque_limits": {motor: x for motor, x in drives.torques.items() if x != common},
    }
    given = motors.get("actuators", {})
    for key, entry in given.items():
        actuators[key] = {**actuators.get(key, {}), **entry} if isinstance(entry, dict) else entry
        if key in ("gain", "torque_limit"):
            actuators[f"{key}s"] = dict(given.get(f"{key}s", {}))
    data: Table = {
        "title": model.stem.replace("_", " "),
        "description": f"Read from {model.name} by preshape; {len(found.digits)} fingers.",
        "model": model.name,
        "side": found.side,
        "u": _u(skeleton, found),
        "finger_pitch": _pitch(skeleton, found),
        "palm": {
            "body": found.palm,
            "points": [round(float(x), 8) + 0.0 for x in found.points],
            "faces": [round(float(x), 8) + 0.0 for x in found.faces],
        },
        "actuators": {key: entry for key, entry in actuators.items() if entry != {}},
    }
    if found.root is not None:
        data["root"] = found.root
    if found.fixed:
        data["fixed"] = {joint: round(angle, 5) for joint, angle in found.fixed.items()}
    if "couple" in motors:
        data["couple"] = motors["couple"]
    return data


def _hand_name(model: Path, taken: set[str]) -> str:
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", model.stem).strip("_.") or "hand"
    name = name[: LONGEST_HAND_NAME - 10]
    return f"{name}_model" if name in taken else name


def _u(skeleton: Skeleton, found: Anatomy) -> float:
    """Length of the middle finger's proximal phalanx [m], between its first two flexion axes."""
    digit = found.digits[min(2, len(found.digits) - 1)]
    skeleton.place({})
    return round(float(np.clip(phalanx(skeleton, digit), 0.01, 0.2)), 4)


def _pitch(skeleton: Skeleton, found: Anatomy) -> float:
    """Distance of neighbouring fingers [m]; of two fingers, the width of a tip."""
    skeleton.place({})
    bases = np.array([skeleton.anchor(digit.flexion[0]) for digit in found.digits[1:]])
    if len(bases) < 2:
        return round(2 * found.digits[-1].tip.radius + 1e-3, 4)
    apart = np.linalg.norm(np.diff(bases, axis=0), axis=1)
    return round(float(max(np.median(apart), 2e-3)), 4)


# -- what was guessed, in words ---------------------------------------------------------------------


def _lines(
    source: CompiledModel, found: Anatomy, drives: Motors, data: Table, motors: Table
) -> tuple[str, ...]:
    first = found.names[0]
    thumb = (
        f"thumb by opposition ({found.opposition:.2f} of 1)"
        if found.thumb
        else f"no thumb: {first} takes its place opposite the others"
    )
    fingers = f"fingers: {', '.join(found.names)}; {thumb}"
    if found.fixed:
        fingers += f"; fixed: {_some(found.fixed)}"
    if "ignore" in data:
        fingers += f"; overlap by design: {_some(' and '.join(pair) for pair in data['ignore'])}"
    tips = [1000 * digit.tip.radius for digit in found.digits]
    radii = "-".join(dict.fromkeys(f"{radius:.0f}" for radius in (min(tips), max(tips))))
    palm = data["palm"]
    visual = " from visual shapes" if any(digit.tip.solid is False for digit in found.digits) else ""
    frame = (
        f"palm {found.palm}: fingers along {_axis(palm['points'])}, facing {_axis(palm['faces'])}, "
        f"{found.side} hand (by {found.by}); U {1000 * data['u']:.0f} mm, pitch "
        f"{1000 * data['finger_pitch']:.0f} mm, tips of {radii} mm{visual}"
    )
    joints = sum(len(digit.joints) for digit in found.digits)
    laws = "laws of --motors" if "couple" in motors else "laws of the file"
    count = len(drives.torques)
    power = f"motors: {count} for {joints} joints" + (f" ({laws})" if count != joints else "")
    limits = data["actuators"]
    if "torque_limit" in motors.get("actuators", {}):
        power += ", torque limits as given"
    elif drives.why:
        power += f"; torque limits guessed (about {limits['torque_limit']:g} N m), because {drives.why}"
    else:
        power += f"; torque limits of the file (about {limits['torque_limit']:g} N m)"
    return fingers, frame, f"{power}; gain {limits['gain']:g} N m/rad"


def _axis(numbers: list[float]) -> str:
    vector = np.array(numbers)
    best = int(np.abs(vector).argmax())
    sign = "+" if vector[best] > 0 else "-"
    return (
        f"{sign}{'xyz'[best]}"
        if abs(vector[best]) > 0.999
        else "(" + " ".join(f"{x:.2f}" for x in vector) + ")"
    )


def _some(names: Iterable[Any]) -> str:
    listed = [str(name) for name in names]
    return ", ".join(listed[:3]) + (f" and {len(listed) - 3} more" if len(listed) > 3 else "")
