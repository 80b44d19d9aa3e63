"""Closing paths of an unknown hand: towards the palm, opposed to the thumb, and free of collisions.

:func:`preshape.hands.init.describe` begins with the widest paths; here they are shortened and chosen on the
rebuilt hand, whose shapes collide.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from ..types import Array, value
from .anatomy import Anatomy
from .digits import Digit, along
from .findings import DEPTH
from .hand import Hand
from .kinematics import HandKinematics
from .skeleton import Drive

_STEPS = 20
"""Steps along a closing path in the search for collisions."""

_MARGIN = 0.06
"""Share of the path by which a finger stops before it meets something [C]."""

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
class FingerPath:
    """The closing path of one finger: its working range between two shares, at fixed spread joints."""

    digit: Digit
    spread: dict[str, float]
    start: float
    end: float

    def at(self, c: float) -> dict[str, float]:
        """Angles of the finger's joints [rad] at a place of the path, 0 open to 1 closed."""
        return {**self.spread, **self.digit.at(self.start + c * (self.end - self.start))}

    def part(self, low: float, high: float) -> FingerPath:
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
    path: FingerPath
    row: int
    places: tuple[float, ...]


class PathSearch:
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
        """Set the posture [rad]; joints that are not given stand at zero."""
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

    def overlaps(self, paths: list[FingerPath]) -> list[tuple[str, str]]:
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
        """(fingers, 3) centres of the fingertips [m], palm frame, in a posture [rad]."""
        self.set(angles)
        return self.kinematics.tips(self.hand.fingers)[0]

    def fingers(self, paths: list[FingerPath]) -> list[FingerPath]:
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

    def _cleared(self, k: int, paths: list[FingerPath]) -> FingerPath:
        """The path of finger k from where it no longer meets the palm, which may be a little bent."""
        posture: dict[str, float] = {}
        for path in paths:
            posture |= path.at(0.0)
        for start in (0.0, 0.05, 0.1, 0.15, 0.2, 0.3):
            self.set({**posture, **paths[k].at(start)})
            if not any(pair in ((k, -1), (-1, k)) for pair in self.hits()):
                return paths[k].part(start, 1.0)
        return paths[k]

    def opposed(self, paths: list[FingerPath]) -> tuple[list[FingerPath], dict[str, list[float]]]:
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

    def _first_free(self, tried: list[_Try], rows: list[list[FingerPath]]) -> tuple[_Try, float]:
        """The best try that is free of collisions, else the one that is free for longest; and how far."""
        best, most = tried[0], 0.0
        for entry in tried[:_TRIES]:
            free = self._free(entry.path, rows[entry.row])
            if free == 1.0:
                return entry, 1.0
            if free > most:
                best, most = entry, free
        return best, max(most - _MARGIN, 0.4)

    def _row(self, paths: list[FingerPath]) -> tuple[Array, Array]:
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

    def _free(self, path: FingerPath, row: list[FingerPath]) -> float:
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
