"""One finger of an unknown model: which joints curl it, to which side and how far, and where its tip is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..types import Array, value
from .skeleton import Drive, Skeleton

PARALLEL = 0.85
"""Least cosine between the axes of two flexion joints of a finger [C]."""

_CLEAR = 1.3
"""Ratio of the ranges to both sides above which a finger's curling direction is clear [C]."""

_SLACK, _AHEAD, _MOST = 0.05, 1.2, 1.5
"""Bend of a joint of the open finger; least and largest motion of a joint from open to closed [rad] [C]."""

_BACK = -0.5
"""Bend of the first joint of an open finger that stands opposite the others [rad] [C]."""

_OVER = 2.3
"""Largest motion of the first flexion joint of a finger that lies flat when open [rad] [C]."""

_SMALLEST, _LARGEST = 3e-3, 15e-3
"""Range of fingertip radii that is guessed [m] [C]."""

_PAD = 12e-3
"""Length of the end of a link that counts as its fingertip [m] [C]."""


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


def along(drive: Drive, share: float) -> dict[str, float]:
    """Angles [rad] of a drive's joints at a share of its knots."""
    place = np.linspace(0.0, 1.0, len(drive.knots))
    return {joint: float(np.interp(share, place, drive.knots[:, k])) for k, joint in enumerate(drive.joints)}


def middle_of(skeleton: Skeleton, chains: list[tuple[str, ...]]) -> Array:
    """(3,) middle of the fingers' first joints [m]."""
    return np.asarray(np.mean([skeleton.anchor(chain[0]) for chain in chains], axis=0))


def digit_of(skeleton: Skeleton, joints: tuple[str, ...], centre: Array) -> Digit:
    """The finger of a chain of joints.

    Args:
        skeleton: The model.
        joints: Its hinges from the palm outwards.
        centre: (3,) middle of the fingers' first joints [m]; a finger that could curl both ways curls to it.
    """
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
        return np.asarray(back * (0.8 if length > 1e-3 else 0.0) + (length <= 1e-3) * 0.03 * across(hinge))
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


def across(hinge: Array) -> Array:
    """(3,) a unit vector perpendicular to another one."""
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


def opened(skeleton: Skeleton, digit: Digit) -> Digit:
    """The digit, whose first flexion joint opens beyond straight as far as its limits allow."""
    k = digit.curls.index(True)
    curl = _curl_along(skeleton, digit, k)
    share = float(np.interp(max(curl[0], _BACK), curl, np.linspace(0.0, 1.0, len(curl))))
    start, end = digit.working[k]
    return _working_at(digit, k, (min(start, share), end))


def folded(skeleton: Skeleton, digit: Digit) -> Digit:
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
