"""The anatomy of an unknown model: which bodies are its palm and its fingers, and how each finger moves.

Geometry comes first, names second:

1. The palm is the body from which the chains of all hinges that end in a fingertip branch off.
2. A finger's flexion joints are those parallel to its last joint; the others spread or turn it. It curls to
   the side on which its joints have more range, or else towards the other fingers.
3. The thumb is the finger that opposes the others best over the range of its joints. Where several do (three
   equal fingers), its name or its place decides.
4. The fingers point along +z of the palm frame and the palm faces -y, where the thumb is.
"""

from __future__ import annotations

import re
from itertools import product

import numpy as np

from ..exceptions import HandError
from ..types import Array, value
from .chains import mount_of, palm_and_chains
from .digits import Digit, across, along, digit_of, folded, middle_of, opened, tip_of
from .skeleton import Skeleton

_SNAP = 0.992
"""Cosine from which an axis of the palm frame is taken as the nearest axis of the palm's body [C]."""

_SHARES = (0.15, 0.3, 0.5)
"""Shares of the closing motion at which fingers are compared with a thumb [C]."""

WORDS = (
    ("thumb", r"thumb|pollex|daumen|pouce|(^|[^a-z])(th|thj)([^a-z]|$)|_th_|^th"),
    ("index", r"index|fore_?finger|zeige|pointer|(^|[^a-z])(ff|if|ffj)([^a-z]|$)"),
    ("middle", r"middle_?finger|middle|mittel|(^|[^a-z])(mf|mfj)([^a-z]|$)"),
    ("ring", r"ring|(^|[^a-z])(rf|rfj)([^a-z]|$)"),
    ("little", r"little|pinky|pinkie|klein|(^|[^a-z])(lf|pf|lfj)([^a-z]|$)"),
)


@value
class Anatomy:
    """Palm and fingers of a model.

    Attributes:
        palm: Body of the palm.
        root: The body that becomes the hand's mount, if it is not the model's own root.
        digits: The thumb, then the other fingers from the index side.
        names: Their names.
        fixed: Joints that belong to no finger, and the angles at which they stay [rad].
        points: (3,) +z of the palm frame in the frame of the palm's body.
        faces: (3,) the direction that the palm faces, in the same frame.
        side: ``right`` or ``left``.
        by: What decided the side: ``geometry``, ``name`` or ``default``.
        opposition: The thumb's score, from -1 to 1.
        radial: Whether the open fingers point away from each other, around the palm.
        thumb: Whether one finger differs from the others as a thumb does.
    """

    palm: str
    root: str | None
    digits: tuple[Digit, ...]
    names: tuple[str, ...]
    fixed: dict[str, float]
    points: Array
    faces: Array
    side: str
    by: str
    opposition: float
    radial: bool
    thumb: bool


def anatomy(skeleton: Skeleton, root: str | None, side: str | None, label: str) -> Anatomy:
    """Read palm and fingers of a model.

    Args:
        skeleton: The model.
        root: The hand's mount, where the user names it.
        side: ``right`` or ``left``, where the user says it.
        label: File name, for messages and for the guess of the side.

    Raises:
        HandError: No subtree looks like a hand, or several do, or its fingers slide.
    """
    palm, chains, fixed = palm_and_chains(skeleton, root, label)
    if len(chains) < 2:
        raise HandError(
            f"{label}: only {len(chains)} chain of hinges looks like a finger, and a hand needs two or more; "
            "name the hand's mount with --root BODY if the model is a whole robot"
        )
    towards = middle_of(skeleton, chains)
    digits = tuple(digit_of(skeleton, chain, towards) for chain in chains)
    _refuse_shared_motors(skeleton, digits, label)
    first, score, differs = _thumb(skeleton, digits)
    radial = _radial(skeleton, digits, first)
    z, faces = _palm_axes(skeleton, digits, first, radial)
    if radial:
        digits = tuple(folded(skeleton, digit) for digit in digits)
    elif _facing(skeleton, digits, first, z):
        digits = tuple(opened(skeleton, digit) for digit in digits)
    own, by = _side(skeleton, digits, first, np.cross(-faces, z), label)
    x = np.cross(-faces, z) * (1.0 if (side or own) == "right" else -1.0)
    others = sorted(
        (k for k in range(len(digits)) if k != first),
        key=lambda k: -float(_base(skeleton, digits[k]) @ x),
    )
    ordered = tuple(digits[k] for k in (first, *others))
    turn = skeleton.frame(palm)[:3, :3]
    up, front = _snapped(turn.T @ z, turn.T @ faces)
    name = str(skeleton.m.body(palm).name)
    mount, held = mount_of(skeleton, palm, root)
    return Anatomy(
        palm=name,
        root=mount,
        digits=ordered,
        names=_names(ordered, differs and not radial),
        fixed={**fixed, **held},
        points=up,
        faces=front,
        side=side or own,
        by="request" if side else by,
        opposition=score,
        radial=radial,
        thumb=differs and not radial,
    )


def _refuse_shared_motors(skeleton: Skeleton, digits: tuple[Digit, ...], label: str) -> None:
    owners: dict[str, int] = {}
    for digit in digits:
        for drive, curls in zip(digit.drives, digit.curls, strict=True):
            if curls:
                owners[drive.motor] = owners.get(drive.motor, 0) + 1
    for motor, count in owners.items():
        if count > 1:
            raise HandError(
                f"{label}: the motor of {motor!r} closes {count} fingers at once; preshape needs a motor for "
                "every finger"
            )


def _base(skeleton: Skeleton, digit: Digit) -> Array:
    skeleton.place({})
    return skeleton.anchor(digit.flexion[0])


def _partway(skeleton: Skeleton, digit: Digit, spread: dict[str, float], share: float) -> tuple[Array, Array]:
    """Tip [m] and unit direction of its motion at a share of its working range."""
    ends = [tip_of(skeleton, digit, {**spread, **digit.at(share + h)}) for h in (-0.02, 0.02)]
    move = ends[1] - ends[0]
    return np.mean(ends, axis=0), move / max(float(np.linalg.norm(move)), 1e-9)


def _spread_postures(digit: Digit, steps: int) -> list[dict[str, float]]:
    """Postures of a digit's spread joints over their range, the neutral one first."""
    drives = digit.spreads[:3]
    grid = product(*[np.linspace(0.0, 1.0, steps)] * len(drives))
    found: list[dict[str, float]] = [{}]
    for shares in grid:
        posture: dict[str, float] = {}
        for drive, share in zip(drives, shares, strict=True):
            posture |= along(drive, float(share))
        found.append(posture)
    return found


def _thumb(skeleton: Skeleton, digits: tuple[Digit, ...]) -> tuple[int, float, bool]:
    """Index of the finger that opposes the others best, its score, and whether it is unlike the others."""
    score = np.full(len(digits), -1.0)
    for share in _SHARES:
        halves = [_partway(skeleton, digit, {}, share) for digit in digits]
        for k, digit in enumerate(digits):
            best = np.full(len(digits), -1.0)
            for posture in _spread_postures(digit, 5):
                tip, move = _partway(skeleton, digit, posture, share)
                for j, (other, back) in enumerate(halves):
                    if j != k:
                        across = other - tip
                        across /= max(float(np.linalg.norm(across)), 1e-9)
                        best[j] = max(best[j], min(float(across @ move), -float(across @ back)))
            score[k] = max(score[k], float(np.delete(best, k).mean()))
    named = np.array([_word(digit.label) == "thumb" for digit in digits])
    # Two equal fingers, or three around a palm: names, then the one opposite fingers that move alike.
    alike = np.zeros(len(digits))
    for k in range(len(digits)):
        moves = np.array([move for j, (_, move) in enumerate(halves) if j != k])
        alike[k] = float(np.linalg.norm(moves.mean(axis=0)))
    if named.sum() == 1 and score[named][0] > score.max() - 0.5:
        first = int(named.argmax())
    else:
        near = score > score.max() - 0.2
        first = int(np.where(near, alike + 0.01 * score, -np.inf).argmax())
    unlike = (
        bool(named.sum() == 1 and named[first]) or float(score[first] - np.delete(score, first).max()) > 0.1
    )
    return first, float(score[first]), unlike


def _neutral(skeleton: Skeleton, digit: Digit) -> tuple[Array, Array, Array]:
    """Neutral first flexion anchor [m], unit vector from it to the tip, and the tip's curling motion."""
    skeleton.place({})
    anchor, axis = skeleton.anchor(digit.flexion[0]), skeleton.axis(digit.flexion[0])
    last = skeleton.axis(digit.joints[-1])
    arm = tip_of(skeleton, digit, {}) - anchor
    turn = digit.sign * (1.0 if axis @ last >= 0 else -1.0) * axis
    arm -= (arm @ axis) * axis
    move = np.cross(turn, arm)
    return anchor, arm / max(float(np.linalg.norm(arm)), 1e-9), move / max(float(np.linalg.norm(move)), 1e-9)


def _radial(skeleton: Skeleton, digits: tuple[Digit, ...], first: int) -> bool:
    """Whether the open fingers point away from each other, as those of a Barrett hand do."""
    thumb, own, _ = _neutral(skeleton, digits[first])
    row = [_neutral(skeleton, digit) for k, digit in enumerate(digits) if k != first]
    away = np.mean([part[0] for part in row], axis=0) - thumb
    mean = np.mean([part[1] for part in row], axis=0)
    length = float(np.linalg.norm(away) * np.linalg.norm(mean))
    return bool(own @ mean < -0.5 and away @ mean > 0.5 * length)


def _palm_axes(
    skeleton: Skeleton, digits: tuple[Digit, ...], first: int, radial: bool
) -> tuple[Array, Array]:
    """+z of the palm frame and the direction that the palm faces, in the model's world."""
    row = [_neutral(skeleton, digit) for k, digit in enumerate(digits) if k != first]
    thumb = _neutral(skeleton, digits[first])
    if radial:
        z = thumb[2] + np.mean([part[2] for part in row], axis=0)
        faces = thumb[0] - np.mean([part[0] for part in row], axis=0)
    else:
        z = np.mean([part[1] for part in row], axis=0)
        faces = np.mean([part[2] for part in row], axis=0)
    z = z / max(float(np.linalg.norm(z)), 1e-9)
    faces = faces - (faces @ z) * z
    if np.linalg.norm(faces) < 0.2:
        faces = thumb[0] - np.mean([part[0] for part in row], axis=0)
        faces = faces - (faces @ z) * z
    if np.linalg.norm(faces) < 1e-6:
        faces = across(z)
    return np.asarray(z), np.asarray(faces / np.linalg.norm(faces))


def _facing(skeleton: Skeleton, digits: tuple[Digit, ...], first: int, z: Array) -> bool:
    """Whether thumb and fingers stand side by side and close towards each other, as jaws do."""
    own, other = _neutral(skeleton, digits[first]), _neutral(skeleton, digits[first - 1])
    return bool(own[1] @ z > 0.7 and own[2] @ other[2] < -0.3)


def _snapped(z: Array, faces: Array) -> tuple[Array, Array]:
    """Both directions, as axes of the palm's body where they nearly are, and perpendicular."""
    found = []
    for vector in (z, faces):
        axis = np.eye(3)[int(np.abs(vector).argmax())] * np.sign(vector[np.abs(vector).argmax()])
        found.append(axis if float(axis @ vector) > _SNAP else vector)
    up, front = found
    front = front - (front @ up) * up
    return up, np.asarray(front / np.linalg.norm(front))


def _side(skeleton: Skeleton, digits: tuple[Digit, ...], first: int, x: Array, label: str) -> tuple[str, str]:
    """The hand's side, and what decided it; ``x`` is the index side of a right hand."""
    skeleton.place({})
    bases = np.array([skeleton.anchor(digit.joints[0]) @ x for digit in digits])
    row = np.delete(bases, first)
    offset, width = float(bases[first] - row.mean()), max(float(np.ptp(row)), 0.02)
    if len(digits) > 3 and abs(offset) > 0.25 * width:
        return ("right" if offset > 0 else "left"), "geometry"
    text = " ".join([label, *skeleton.source.bodies]).lower()
    right = len(re.findall(r"(?<![a-z])(right|rh|r)(?![a-z])", text))
    left = len(re.findall(r"(?<![a-z])(left|lh|l)(?![a-z])", text))
    if right != left:
        return ("right" if right > left else "left"), "name"
    if abs(offset) > 0.25 * width and len(digits) > 2:
        return ("right" if offset > 0 else "left"), "geometry"
    return "right", "default"


def _word(label: str) -> str | None:
    counts = {word: len(re.findall(pattern, label)) for word, pattern in WORDS}
    best = max(counts, key=lambda word: counts[word])
    return best if counts[best] else None


def _names(digits: tuple[Digit, ...], thumb: bool) -> tuple[str, ...]:
    """A short name for each finger: the anatomical one that its links have, else its place."""
    words = [_word(digit.label) for digit in digits]
    usual = ("thumb", "index", "middle", "ring", "little")
    if len(set(words)) == len(words) and None not in words and words[0] == "thumb":
        return tuple(str(word) for word in words)
    if thumb and len(digits) <= len(usual):
        return usual[: len(digits)]
    stems = [_stem(digit) for digit in digits]
    if len(set(stems)) == len(stems) and all(stems):
        return tuple(stems)
    return tuple(f"finger_{k + 1}" for k in range(len(digits)))


def _stem(digit: Digit) -> str:
    """What the names of a finger's joints begin with."""
    stem = digit.joints[0]
    for joint in digit.joints[1:]:
        while not joint.startswith(stem):
            stem = stem[:-1]
    if len(digit.joints) == 1:
        stem = re.sub(r"_?joint$", "", stem)
    stem = re.sub(r"(_?(joint|link|j))?_*$", "", stem)
    return stem if 0 < len(stem) <= 24 and re.fullmatch(r"[A-Za-z][\w.-]*", stem) else ""
