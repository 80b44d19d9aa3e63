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
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import HandError
from ..types import Array, value
from .anatomy import Anatomy, anatomy
from .compiled import CompiledModel
from .couples import Table, couple_joints, couples_of
from .digits import Digit, along, phalanx
from .findings import DEPTH, description_findings, model_findings, refuse, size_findings
from .hand import LONGEST_HAND_NAME, Hand
from .kinematics import HandKinematics
from .motor_guesses import Motors, motors_of
from .rewrite import rebuilt
from .skeleton import Drive, Skeleton

_SAID = 3  # faults of a model that one message names

_STEPS = 20
"""Steps along a closing path in the search for collisions."""

_MARGIN = 0.06
"""Share of the path by which a finger stops before it meets something [C]."""

_SPREAD = 0.3
"""Range to both sides in which a preshape spreads a finger [rad] [C]."""

_NARROW = 0.5
"""Least range of a thumb joint that a preshape may set [rad] [C]."""

_GRID = {0: 1, 1: 13, 2: 7, 3: 5}
"""Angles tried of each of the thumb's first joints, by their number."""

_PARTS = (1.0, 0.7, 0.5, 0.35)
"""Shares of the fingers' paths that are tried."""

_WAYS = ((0.0, 1.0), (0.0, 0.7), (0.25, 1.0), (0.25, 0.7), (0.0, 0.5), (0.0, 0.35))
"""Parts of the thumb's path that are tried."""

_TRIES = 400
"""Largest number of tries of which collisions are computed [C]."""

_NEAR, _FAR = 0.01, 1.5
"""Distance of the tips of thumb and finger at half closed that costs nothing, from [m] to [U] [C]."""


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
        _Path(
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
    search = _Search(hand, found)
    if by_design := search.overlaps(paths):
        data["ignore"] = [list(pair) for pair in by_design]
    paths = search.fingers(paths)
    paths, ranges = search.opposed(paths)
    data["finger"] = [
        _finger(found, k, path, ranges if k == 0 else _spreads(found, path.digit))
        for k, path in enumerate(paths)
    ]
    return Guess(data=data, lines=_lines(source, found, drives, data, motors))


@value
class _Path:
    """The closing path of one finger: its working range between two shares, at fixed spread joints."""

    digit: Digit
    spread: dict[str, float]
    start: float
    end: float

    def at(self, c: float) -> dict[str, float]:
        return {**self.spread, **self.digit.at(self.start + c * (self.end - self.start))}

    def part(self, low: float, high: float) -> _Path:
        """The path between two of its places."""
        start, length = self.start, self.end - self.start
        return replace(self, start=start + low * length, end=start + high * length)


@value
class _Try:
    """One posture of the thumb's first joints with one length of the paths.

    Attributes:
        score: How well the thumb opposes the fingers.
        path: The thumb's path.
        row: Index of the other fingers' length in ``_PARTS``.
        places: Shares of the ranges of the thumb's first joints.
    """

    score: float
    path: _Path
    row: int
    places: tuple[float, ...]


class _Search:
    """Looks for closing paths without collisions on the rebuilt hand."""

    def __init__(self, hand: Hand, found: Anatomy) -> None:
        self.hand, self.found = hand, found
        self.kinematics = HandKinematics(hand)
        model = self.kinematics.model
        owner = {
            int(model.joint(joint).bodyid[0]): k for k, d in enumerate(found.digits) for joint in d.joints
        }
        self._body = {
            model.geom(g).name: str(model.body(int(model.geom_bodyid[g])).name) for g in range(model.ngeom)
        }
        self._first = {
            str(model.body(int(model.joint(joint).bodyid[0])).name)
            for digit in found.digits
            for joint in digit.joints[: digit.joints.index(digit.flexion[0]) + 1]
        }
        self._ignored: set[tuple[str, str]] = set()
        self._owner = {
            model.geom(g).name: owner.get(int(model.geom_bodyid[g]), -1) for g in range(model.ngeom)
        }

    def set(self, angles: dict[str, float]) -> None:
        low, high = self.hand.limits.T
        q = np.array([angles.get(joint, 0.0) for joint in self.hand.joints])
        self.kinematics.set_posture(np.clip(q, low, high))

    def hits(self) -> list[tuple[int, int]]:
        """Pairs of fingers (palm -1) whose links overlap too much."""
        found = self.kinematics.self_collisions(0.75 * DEPTH)
        return [
            (self._owner[one], self._owner[other])
            for one, other, _ in found
            if self._pair(one, other) not in self._ignored
        ]

    def _pair(self, one: str, other: str) -> tuple[str, str]:
        """Names of the bodies of two shapes, sorted."""
        a, b = sorted((self._body[one], self._body[other]))
        return a, b

    def overlaps(self, paths: list[_Path]) -> list[tuple[str, str]]:
        """Bodies whose shapes overlap when the hand is open, because one houses the joint of the other.

        These are the palm and a finger's links up to its first flexion joint, and links of one finger.
        """
        posture: dict[str, float] = {}
        for path in paths:
            posture |= path.at(0.0)
        self.set(posture)
        for one, other, _ in self.kinematics.self_collisions(0.75 * DEPTH):
            owners, pair = {self._owner[one], self._owner[other]}, self._pair(one, other)
            if len(owners) == 1 or (-1 in owners and self._first & set(pair)):
                self._ignored.add(pair)
        return sorted(self._ignored)

    def tips(self, angles: dict[str, float]) -> Array:
        self.set(angles)
        return self.kinematics.tips(self.hand.fingers)[0]

    def fingers(self, paths: list[_Path]) -> list[_Path]:
        """Let all paths begin clear of the palm, and the fingers' end clear of it and of each other."""
        paths = [self._cleared(k, paths) for k in range(len(paths))]
        reach = np.ones(len(paths))
        for c in np.linspace(0.0, 1.0, _STEPS + 1):
            posture = paths[0].at(0.0)
            for path, most in zip(paths[1:], reach[1:], strict=True):
                posture |= path.at(min(c, float(most)))
            self.set(posture)
            for k in {k for pair in self.hits() if 0 not in pair for k in pair if k > 0}:
                reach[k] = min(reach[k], max(c - _MARGIN, 0.3))
        return [path if k == 0 else path.part(0.0, float(reach[k])) for k, path in enumerate(paths)]

    def _cleared(self, k: int, paths: list[_Path]) -> _Path:
        """The path of finger k from where it no longer meets the palm, which may be a little bent."""
        posture: dict[str, float] = {}
        for path in paths:
            posture |= path.at(0.0)
        for start in (0.0, 0.05, 0.1, 0.15, 0.2, 0.3):
            self.set({**posture, **paths[k].at(start)})
            if not any(pair in ((k, -1), (-1, k)) for pair in self.hits()):
                return paths[k].part(start, 1.0)
        return paths[k]

    def opposed(self, paths: list[_Path]) -> tuple[list[_Path], dict[str, list[float]]]:
        """The paths on which the thumb opposes the fingers best, and preshape ranges of its first joints.

        The thumb's first joints are tried over their range; the paths of thumb and fingers may also become
        shorter, where they would cross before they meet.
        """
        digit = paths[0].digit
        drives = digit.spreads[:3]
        shares = np.linspace(0.0, 1.0, _GRID[len(drives)])
        still = paths[0].spread
        rows = [[path.part(0.0, part) for path in paths[1:]] for part in _PARTS]
        halves = [self._row(row) for row in rows]
        tried: list[_Try] = []
        for places in product(shares, repeat=len(drives)):
            spread = dict(still)
            for drive, share in zip(drives, places, strict=True):
                spread |= along(drive, float(share))
            # Of equally good paths, the longer ones, and those with the joints nearer to neutral.
            moved = 0.1 * sum(abs(spread[joint] - still[joint]) for joint in still)
            for start, end in _WAYS:
                path = replace(paths[0].part(start, end), spread=spread)
                own = [self.tips(path.at(c))[0] for c in (0.48, 0.52)]
                for k, part in enumerate(_PARTS):
                    score = self._score(own, halves[k]) + 0.15 * (end - start) + 0.5 * part - moved
                    tried.append(_Try(score=score, path=path, row=k, places=tuple(map(float, places))))
        tried.sort(key=lambda entry: -entry.score)
        chosen, free = self._first_free(tried, rows)
        return [chosen.path.part(0.0, free), *rows[chosen.row]], self._ranges(drives, chosen, tried)

    def _first_free(self, tried: list[_Try], rows: list[list[_Path]]) -> tuple[_Try, float]:
        """The best try that is free of collisions, else the one that is free for longest; and how far."""
        best, most = tried[0], 0.0
        for entry in tried[:_TRIES]:
            free = self._free(entry.path, rows[entry.row])
            if free == 1.0:
                return entry, 1.0
            if free > most:
                best, most = entry, free
        return best, max(most - _MARGIN, 0.4)

    def _row(self, paths: list[_Path]) -> tuple[Array, Array]:
        """Tips [m] and unit directions of motion of the other fingers at half closed."""
        places = []
        for c in (0.48, 0.5, 0.52):
            posture: dict[str, float] = {}
            for path in paths:
                posture |= path.at(c)
            places.append(self.tips(posture)[1:])
        return places[1], _unit(places[2] - places[0])

    def _score(self, ends: list[Array], halves: tuple[Array, Array]) -> float:
        """How well the thumb opposes its two best fingers at half closed, less what is too far apart."""
        tips, moves = halves
        own, move = (ends[0] + ends[1]) / 2, _unit(ends[1] - ends[0])
        across = tips - own
        radii = np.array([finger.tip_radius for finger in self.hand.fingers])
        gap, far = np.linalg.norm(across, axis=1) - radii[1:] - radii[0], max(0.06, _FAR * self.hand.u)
        across = _unit(across)
        opposed = np.minimum(across @ move, -np.einsum("ki,ki->k", across, moves))
        value_of = opposed - 5 * np.maximum(gap - far, 0.0) - 10 * np.maximum(_NEAR - gap, 0.0)
        return float(np.sort(value_of)[::-1][:2].mean())

    def _free(self, path: _Path, row: list[_Path]) -> float:
        """Share of the thumb's path to which the hand is free of collisions, while the fingers are open."""
        posture: dict[str, float] = {}
        for other in row:
            posture |= other.at(0.0)
        for c in np.linspace(0.0, 1.0, _STEPS + 1):
            self.set({**posture, **path.at(float(c))})
            if any(c == 0.0 or pair in ((0, -1), (-1, 0), (0, 0)) for pair in self.hits()):
                return float(c)
        return 1.0

    def _ranges(self, drives: tuple[Drive, ...], chosen: _Try, tried: list[_Try]) -> dict[str, list[float]]:
        """For each of the thumb's first joints, the range around its angle that still opposes a finger."""
        ranges: dict[str, list[float]] = {}
        same = (chosen.row, chosen.path.start, chosen.path.end)
        for k, drive in enumerate(drives):
            joint = drive.joints[0]
            if drive.motor != joint or abs(drive.knots[-1, 0] - drive.knots[0, 0]) < _NARROW:
                continue
            good = {
                entry.places[k]
                for entry in tried
                if entry.score > chosen.score - 0.35
                and (entry.row, entry.path.start, entry.path.end) == same
                and all(entry.places[i] == chosen.places[i] for i in range(len(drives)) if i != k)
            }
            steps = np.linspace(0.0, 1.0, _GRID[len(drives)])
            low = high = int(np.abs(steps - chosen.places[k]).argmin())
            while low > 0 and float(steps[low - 1]) in good:
                low -= 1
            while high < len(steps) - 1 and float(steps[high + 1]) in good:
                high += 1
            ends = sorted(along(drive, float(steps[place]))[joint] for place in (low, high))
            if ends[1] > ends[0]:
                ranges[joint] = ends
        return ranges


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


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


def _finger(found: Anatomy, k: int, path: _Path, ranges: dict[str, list[float]]) -> Table:
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
