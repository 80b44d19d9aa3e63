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
from dataclasses import replace
from itertools import product

import numpy as np

from ..exceptions import HandError
from ..types import Array, value
from .skeleton import Drive, Skeleton

REACH = 0.45
"""Largest distance of a fingertip's joint from the palm's body [m] [C]; a leg or an arm is longer."""

PARALLEL = 0.85
"""Least cosine between the axes of two flexion joints of a finger [C]."""

WRIST = 0.35
"""Largest length of a forearm that stays part of the hand, as an obstacle [m] [C]."""

_CLEAR = 1.3
"""Ratio of the ranges to both sides above which a finger's curling direction is clear [C]."""

_SLACK, _AHEAD, _MOST = 0.05, 1.2, 1.5
"""Bend of a joint of the open finger; least and largest motion of a joint from open to closed [rad] [C]."""

_BACK = -0.5
"""Bend of the first joint of an open finger that stands opposite the others [rad] [C]."""

_OVER = 2.3
"""Largest motion of the first flexion joint of a finger that lies flat when open [rad] [C]."""

_SNAP = 0.992
"""Cosine from which an axis of the palm frame is taken as the nearest axis of the palm's body [C]."""

_TURNED = 0.7
"""Share of its range at which a motor stays that moves palm and thumb at once [C]."""

_SHARES = (0.15, 0.3, 0.5)
"""Shares of the closing motion at which fingers are compared with a thumb [C]."""

_SMALLEST, _LARGEST = 3e-3, 15e-3
"""Range of fingertip radii that is guessed [m] [C]."""

_PAD = 12e-3
"""Length of the end of a link that counts as its fingertip [m] [C]."""

WORDS = (
    ("thumb", r"thumb|pollex|daumen|pouce|(^|[^a-z])(th|thj)([^a-z]|$)|_th_|^th"),
    ("index", r"index|fore_?finger|zeige|pointer|(^|[^a-z])(ff|if|ffj)([^a-z]|$)"),
    ("middle", r"middle_?finger|middle|mittel|(^|[^a-z])(mf|mfj)([^a-z]|$)"),
    ("ring", r"ring|(^|[^a-z])(rf|rfj)([^a-z]|$)"),
    ("little", r"little|pinky|pinkie|klein|(^|[^a-z])(lf|pf|lfj)([^a-z]|$)"),
)


@value
class Tip:
    """The end of a finger's last link, in the frame of its body.

    Attributes:
        pos: (3,) centre of the spherical fingertip [m].
        points: (3,) unit vector outwards along the link.
        radius: Its radius [m].
        solid: Whether shapes that collide gave it; ``None`` if the link has no shape at all.
    """

    pos: Array
    points: Array
    radius: float
    solid: bool | None


@value
class Digit:
    """One finger of the model.

    Attributes:
        joints: Its hinges from the palm outwards.
        flexion: Those that curl it.
        drives: Its motors; the knots of a drive that curls the finger run from straight to curled.
        curls: For every drive, whether it curls the finger.
        sign: +1 or -1: the finger curls about the axis of its last joint in this direction.
        working: For every drive, the shares of its knots between which the finger opens and closes.
        tip_body: Body of the last link.
        tip: Its fingertip.
        label: Names of its bodies and joints, in lower case, for the guess of its name.
    """

    joints: tuple[str, ...]
    flexion: tuple[str, ...]
    drives: tuple[Drive, ...]
    curls: tuple[bool, ...]
    sign: float
    working: tuple[tuple[float, float], ...]
    tip_body: str
    tip: Tip
    label: str

    def at(self, share: float) -> dict[str, float]:
        """Angles of its curling joints [rad] at a share of their working range, 0 open, 1 curled."""
        angles: dict[str, float] = {}
        for drive, curls, (start, end) in zip(self.drives, self.curls, self.working, strict=True):
            if curls:
                angles |= along(drive, start + share * (end - start))
        return angles

    @property
    def spreads(self) -> tuple[Drive, ...]:
        """The drives that do not curl it."""
        return tuple(drive for drive, curls in zip(self.drives, self.curls, strict=True) if not curls)


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


def along(drive: Drive, share: float) -> dict[str, float]:
    """Angles [rad] of a drive's joints at a share of its knots."""
    place = np.linspace(0.0, 1.0, len(drive.knots))
    return {joint: float(np.interp(share, place, drive.knots[:, k])) for k, joint in enumerate(drive.joints)}


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
    palm, chains, fixed = _palm_and_chains(skeleton, root, label)
    if len(chains) < 2:
        raise HandError(
            f"{label}: only {len(chains)} chain of hinges looks like a finger, and a hand needs two or more; "
            "name the hand's mount with --root BODY if the model is a whole robot"
        )
    towards = _bases(skeleton, chains)
    digits = tuple(_digit(skeleton, chain, towards) for chain in chains)
    _refuse_shared_motors(skeleton, digits, label)
    first, score, differs = _thumb(skeleton, digits)
    radial = _radial(skeleton, digits, first)
    z, faces = _palm_axes(skeleton, digits, first, radial)
    if radial:
        digits = tuple(_folded(skeleton, digit) for digit in digits)
    elif _facing(skeleton, digits, first, z):
        digits = tuple(_opened(skeleton, digit) for digit in digits)
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
    mount, held = _mount(skeleton, palm, root)
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


# -- palm and chains --------------------------------------------------------------------------------


def _palm_and_chains(
    skeleton: Skeleton, root: str | None, label: str
) -> tuple[int, list[tuple[str, ...]], dict[str, float]]:
    """The palm's body, the hinges of every finger from the palm outwards, and the joints that stay fixed."""
    m, source = skeleton.m, skeleton.source
    if root is not None and root not in source.bodies:
        listed = ", ".join(source.bodies[:12])
        raise HandError(f"{label}: there is no body {root!r} to be the hand's mount; it has {listed}, …")
    joints = source.joints_under(root)
    paths = {joint: _path(skeleton, joint, joints) for joint in joints}
    parents = {path[-2] for path in paths.values() if len(path) > 1}
    ends = [joint for joint in joints if joint not in parents]
    if ends and all(joint not in source.hinges for joint in ends):
        raise HandError(
            f"{label}: its fingers slide (joints {', '.join(ends[:4])}); preshape closes fingers on hinges, "
            "so a gripper with sliding jaws cannot be planned for"
        )
    groups = _hands(skeleton, [paths[end] for end in ends if end in source.hinges], root)
    if not groups:
        raise HandError(
            f"{label}: no part of the model looks like a hand: a body with two or more chains of hinges that "
            f"end within {REACH:g} m; name the hand's mount with --root BODY"
        )
    if len(groups) > 1:
        bodies = ", ".join(str(m.body(palm).name) for palm, _ in groups)
        raise HandError(
            f"{label}: {len(groups)} parts of the model look like a hand; choose one with --root BODY, "
            f"where BODY is one of {bodies}"
        )
    palm, found = groups[0]
    under = [joint for joint in joints if palm in source.chain(skeleton.body_of(joint))[1:]]
    chains = [tuple(j for j in path if j in under) for path in found]
    chains = _without_branches(skeleton, chains)
    count = {joint: sum(joint in chain for chain in chains) for joint in under}
    shared = {joint for joint in under if count[joint] > 1}
    chains = [tuple(j for j in chain if j not in shared and j in source.hinges) for chain in chains]
    chains = [chain for chain in chains if chain]
    held = {joint for joint in under if not any(joint in chain for chain in chains)}
    held |= _with_their_motors(skeleton, held, chains)
    chains = [tuple(joint for joint in chain if joint not in held) for chain in chains]
    return palm, [chain for chain in chains if chain], {joint: skeleton.neutral[joint] for joint in held}


def _with_their_motors(skeleton: Skeleton, held: set[str], chains: list[tuple[str, ...]]) -> set[str]:
    """The joints that move with joints that stay fixed, and so stay fixed too.

    A motor that bends the palm and turns the thumb at once stays at an angle where the thumb opposes.
    """
    more: set[str] = set()
    ends = {chain[-1] for chain in chains}
    for joint in sorted(held & set(skeleton.motors)):
        motor = skeleton.motors[joint]
        free = set(motor.joints) - held
        if free and not free & ends and joint in motor.joints:
            low, high = (float(bound) for bound in motor.range)
            far = high if abs(high) > abs(low) else low
            angles = motor.angles(_TURNED * far)
            skeleton.neutral |= {name: float(x) for name, x in zip(motor.joints, angles, strict=True)}
            more |= free
    return more


def _path(skeleton: Skeleton, joint: str, among: tuple[str, ...]) -> tuple[str, ...]:
    """The joints that move a joint's body, from the root outwards, that joint last."""
    chain = set(skeleton.source.chain(skeleton.body_of(joint)))
    end = skeleton.m.joint(joint).id
    return tuple(
        other for other in among if skeleton.body_of(other) in chain and skeleton.m.joint(other).id <= end
    )


def _hands(
    skeleton: Skeleton, paths: list[tuple[str, ...]], root: str | None
) -> list[tuple[int, list[tuple[str, ...]]]]:
    """Bodies with two finger-like chains or more, and these chains; none of them within another."""
    source = skeleton.source
    above: dict[int, list[tuple[str, ...]]] = {}
    for path in paths:
        for body in source.chain(skeleton.body_of(path[-1]))[1:]:
            above.setdefault(body, []).append(path)
    found = []
    top = None if root is None else skeleton.m.body(root).id
    for body, chains in above.items():
        if top is not None and top not in source.chain(body):
            continue
        ways = {_branch(skeleton, path, body) for path in chains}
        place = skeleton.frame(body)[:3, 3]
        reach = max(float(np.linalg.norm(skeleton.anchor(path[-1]) - place)) for path in chains)
        if len(ways) > 1 and reach < REACH:
            found.append((body, chains))
    bodies = {body for body, _ in found}
    return [(body, chains) for body, chains in found if not bodies & set(source.chain(body)[1:])]


def _branch(skeleton: Skeleton, path: tuple[str, ...], body: int) -> str:
    """The first joint of a path beyond a body."""
    return next(joint for joint in path if body in skeleton.source.chain(skeleton.body_of(joint))[1:])


def _without_branches(skeleton: Skeleton, chains: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Of chains that share joints and end close to each other, the longest: the others are linkages."""
    kept: list[tuple[str, ...]] = []
    ends = {chain: skeleton.anchor(chain[-1]) for chain in chains}
    for chain in sorted(chains, key=len, reverse=True):
        rivals = [other for other in kept if other[0] == chain[0]]
        alone = [joint for joint in chain if not any(joint in other for other in rivals)]
        close = [other for other in rivals if np.linalg.norm(ends[other] - ends[chain]) < 0.02]
        if not rivals or (len(alone) > 1 and not close):
            kept.append(chain)
    return [chain for chain in chains if chain in kept]


def _mount(skeleton: Skeleton, palm: int, root: str | None) -> tuple[str | None, dict[str, float]]:
    """The body to be named as root, and the wrist joints between it and the palm, fixed."""
    source = skeleton.source
    if root is not None:
        held = [j for j in source.joints_under(root) if skeleton.body_of(j) in source.chain(palm)]
        return root, {joint: skeleton.neutral[joint] for joint in held}
    chain = source.chain(palm)
    top = chain[-1]
    wrist = [joint for joint in source.joints if skeleton.body_of(joint) in chain]
    others = [joint for joint in source.joints if palm not in source.chain(skeleton.body_of(joint))]
    length = float(np.linalg.norm(skeleton.frame(palm)[:3, 3] - skeleton.frame(top)[:3, 3]))
    if len(wrist) <= 2 and length < WRIST and not [j for j in others if j not in wrist]:
        several = len(source.roots) > 1
        return (str(skeleton.m.body(top).name) if several else None), {
            joint: skeleton.neutral[joint] for joint in wrist
        }
    # An arm or a whole robot: the hand begins at the last body that a joint of the arm moves.
    start = next((body for body in chain if skeleton.m.body_jntnum[body] > 0), top)
    return str(skeleton.m.body(start).name), {}


# -- fingers ----------------------------------------------------------------------------------------


def _bases(skeleton: Skeleton, chains: list[tuple[str, ...]]) -> Array:
    """(3,) middle of the fingers' first joints [m]."""
    return np.asarray(np.mean([skeleton.anchor(chain[0]) for chain in chains], axis=0))


def _digit(skeleton: Skeleton, joints: tuple[str, ...], centre: Array) -> Digit:
    skeleton.place({})
    last = joints[-1]
    hinge, anchor = skeleton.axis(last), skeleton.anchor(last)
    flexion = tuple(joint for joint in joints if abs(float(skeleton.axis(joint) @ hinge)) > PARALLEL)
    before = skeleton.anchor(joints[-2]) if len(joints) > 1 else centre
    body = skeleton.body_of(last)
    points, solid = skeleton.vertices(body)
    T = skeleton.frame(body)
    world = points @ T[:3, :3].T + T[:3, 3]
    reach = outwards(world, anchor, hinge, before)
    sign = _curl(skeleton, joints, flexion, hinge, reach, centre)
    tip, end, radius = _tip(world, anchor, hinge, sign, reach)
    drives, curls, working = [], [], []
    for drive in skeleton.drives(joints):
        bends = [joint for joint in drive.joints if joint in flexion]
        curls.append(bool(bends))
        turn = [sign * float(np.sign(skeleton.axis(joint) @ hinge)) for joint in bends]
        columns = [drive.joints.index(joint) for joint in bends]
        total = drive.knots[:, columns] @ np.array(turn) if bends else np.zeros(len(drive.knots))
        knots = drive.knots[::-1] if total[-1] < total[0] else drive.knots
        drives.append(Drive(motor=drive.motor, joints=drive.joints, knots=knots))
        working.append(_working(np.sort(total), len(bends)))
    links = [str(skeleton.m.body(skeleton.body_of(joint)).name) for joint in joints]
    return Digit(
        joints=joints,
        flexion=flexion,
        drives=tuple(drives),
        curls=tuple(curls),
        sign=sign,
        working=tuple(working),
        tip_body=str(skeleton.m.body(body).name),
        tip=Tip(
            pos=T[:3, :3].T @ (tip - T[:3, 3]),
            points=T[:3, :3].T @ end,
            radius=radius,
            solid=solid if len(points) else None,
        ),
        label=" ".join([*links, *joints]).lower(),
    )


def _working(curl: Array, joints: int) -> tuple[float, float]:
    """Shares of a drive's knots at which it opens and closes a finger.

    Args:
        curl: (KNOTS,) sum of the angles of the flexion joints that it moves [rad], ascending.
        joints: Their number.
    """
    if joints == 0 or curl[-1] - curl[0] < 1e-6:
        return 0.0, 1.0
    low, high = float(curl[0]), float(curl[-1])
    # Nearly straight, but with most of the range ahead: some joints bend only backwards from zero.
    start = max(low, min(_SLACK * joints, high - min(0.8 * (high - low), _AHEAD * joints)))
    end = min(low + 0.92 * (high - low), start + _MOST * joints)
    place = np.interp([start, end], curl, np.linspace(0.0, 1.0, len(curl)))
    return float(place[0]), float(place[1])


def outwards(world: Array, anchor: Array, hinge: Array, before: Array) -> Array:
    """(3,) vector from a joint to the far end of its link, across the joint's axis [m]."""
    back = anchor - before
    back -= (back @ hinge) * hinge
    if not len(world):
        length = float(np.linalg.norm(back))
        return np.asarray(back * (0.8 if length > 1e-3 else 0.0) + (length <= 1e-3) * 0.03 * _across(hinge))
    arms = world - anchor
    arms = arms - np.outer(arms @ hinge, hinge)
    length = np.linalg.norm(arms, axis=1)
    ahead = arms @ back > -0.3 * length * max(float(np.linalg.norm(back)), 1e-9)
    # A link may reach behind its joint; its fingertip is there only if it reaches twice as far.
    far = arms[int((length * np.where(ahead, 1.0, 0.5)).argmax())]
    unit = far / max(float(np.linalg.norm(far)), 1e-9)
    end = arms[arms @ unit > 0.75 * float(np.linalg.norm(far))]
    middle = (end.min(axis=0) + end.max(axis=0)) / 2
    middle = middle - (middle @ hinge) * hinge
    return np.asarray(middle / max(float(np.linalg.norm(middle)), 1e-9) * np.linalg.norm(far))


def _across(hinge: Array) -> Array:
    z = np.cross(hinge, np.eye(3)[int(np.abs(hinge).argmin())])
    return np.asarray(z / np.linalg.norm(z))


def _tip(world: Array, anchor: Array, hinge: Array, sign: float, reach: Array) -> tuple[Array, Array, float]:
    """Centre [m], direction and radius [m] of the sphere that stands for the end of a link.

    The sphere touches the end of the link and the side to which the finger curls.
    """
    length = max(float(np.linalg.norm(reach)), 1e-6)
    d = reach / length
    if not len(world):
        radius = 6e-3
        return anchor + (length - radius) * d, d, radius
    arms = world - anchor
    pad = sign * np.cross(hinge, d)
    end = float((arms @ d).max())
    slab = arms[arms @ d > end - _PAD]
    if len(slab) < 8:
        slab = arms[arms @ d > 0.6 * end]
    wide, thick = slab @ hinge, slab @ pad
    radius = float(np.clip(min(np.ptp(wide), np.ptp(thick)) / 2, _SMALLEST, _LARGEST))
    radius = max(min(radius, 0.45 * end), 1.5e-3)
    centre = (end - radius) * d + (wide.min() + wide.max()) / 2 * hinge
    return anchor + centre + max(thick.max() - radius, thick.min()) * pad, d, radius


def _curl(
    skeleton: Skeleton,
    joints: tuple[str, ...],
    flexion: tuple[str, ...],
    hinge: Array,
    reach: Array,
    centre: Array,
) -> float:
    """Direction about the last joint's axis in which a finger curls."""
    more = less = 0.0
    for joint in flexion:
        low, high = sorted(skeleton.source.ranges[joint])
        if skeleton.axis(joint) @ hinge < 0:
            low, high = -high, -low
        more, less = more + max(high, 0.0), less + max(-low, 0.0)
    if more > _CLEAR * less:
        return 1.0
    if less > _CLEAR * more:
        return -1.0
    motion = np.cross(hinge, reach)
    inwards = centre - skeleton.anchor(joints[0])
    return 1.0 if float(motion @ inwards) >= 0 else -1.0


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


# -- thumb, frame, side, names ----------------------------------------------------------------------


def _base(skeleton: Skeleton, digit: Digit) -> Array:
    skeleton.place({})
    return skeleton.anchor(digit.flexion[0])


def tip_of(skeleton: Skeleton, digit: Digit, angles: dict[str, float]) -> Array:
    """(3,) centre of a digit's fingertip [m]; the other fingers do not matter."""
    skeleton.place(angles)
    T = skeleton.frame(int(skeleton.m.body(digit.tip_body).id))
    return np.asarray(T[:3, :3] @ digit.tip.pos + T[:3, 3])


def phalanx(skeleton: Skeleton, digit: Digit) -> float:
    """Length of a finger's proximal phalanx [m]; with one flexion joint, up to its tip."""
    first = skeleton.anchor(digit.flexion[0])
    axis = skeleton.axis(digit.flexion[0])
    if len(digit.flexion) > 1:
        end = skeleton.anchor(digit.flexion[1])
    else:
        T = skeleton.frame(int(skeleton.m.body(digit.tip_body).id))
        end = T[:3, :3] @ digit.tip.pos + T[:3, 3]
    arm = end - first
    return float(np.linalg.norm(arm - (arm @ axis) * axis))


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
        faces = _across(z)
    return np.asarray(z), np.asarray(faces / np.linalg.norm(faces))


def _facing(skeleton: Skeleton, digits: tuple[Digit, ...], first: int, z: Array) -> bool:
    """Whether thumb and fingers stand side by side and close towards each other, as jaws do."""
    own, other = _neutral(skeleton, digits[first]), _neutral(skeleton, digits[first - 1])
    return bool(own[1] @ z > 0.7 and own[2] @ other[2] < -0.3)


def _opened(skeleton: Skeleton, digit: Digit) -> Digit:
    """The digit, whose first flexion joint opens beyond straight as far as its limits allow."""
    k = digit.curls.index(True)
    curl = _curl_along(skeleton, digit, k)
    share = float(np.interp(max(curl[0], _BACK), curl, np.linspace(0.0, 1.0, len(curl))))
    start, end = digit.working[k]
    return _working_at(digit, k, (min(start, share), end))


def _folded(skeleton: Skeleton, digit: Digit) -> Digit:
    """The digit, whose first flexion joint turns on over the palm, because it lies flat when open."""
    k = digit.curls.index(True)
    curl = _curl_along(skeleton, digit, k)
    start, _ = digit.working[k]
    shares = np.linspace(0.0, 1.0, len(curl))
    most = min(float(np.interp(start, shares, curl)) + _OVER, float(curl[0] + 0.92 * (curl[-1] - curl[0])))
    return _working_at(digit, k, (start, float(np.interp(most, curl, shares))))


def _working_at(digit: Digit, k: int, shares: tuple[float, float]) -> Digit:
    return replace(digit, working=(*digit.working[:k], shares, *digit.working[k + 1 :]))


def _curl_along(skeleton: Skeleton, digit: Digit, k: int) -> Array:
    """(KNOTS,) sum of the flexion angles that drive ``k`` of a digit moves [rad], ascending."""
    skeleton.place({})
    drive, hinge = digit.drives[k], skeleton.axis(digit.joints[-1])
    bends = [column for column, joint in enumerate(drive.joints) if joint in digit.flexion]
    turn = [digit.sign * float(np.sign(skeleton.axis(drive.joints[column]) @ hinge)) for column in bends]
    return np.asarray(drive.knots[:, bends] @ np.array(turn))


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
