"""The unseen side of what was seen from one side: guessed from symmetry.

Most things that a hand holds are symmetric about a plane, an axis or a point. Each candidate maps the points
that were seen to where they would be on the far side; a right one never maps a point to where the camera saw
free space (Thrun and Wegbreit 2005, Shape from symmetry; Bohg et al. 2011, Mind the gap - robotic grasping
under incomplete observation). Of those that are right, one that maps seen points on seen points is better,
and so is one that does not make the thing much deeper than it is wide.
"""

from __future__ import annotations

import numpy as np

from ...spatial import rotation_from_vector
from ...types import Array, freeze, frozen_array, value
from .sight import Sight

SAMPLES = 500
DEPTHS = 28
"""Positions of the symmetry's middle that are tried along the sight [C]."""
DEEPEST = 0.9
"""Farthest middle behind the nearest point, in widths [C]."""
TOLERANCE = 0.015
"""A mapped point is on the surface, and not in free space, within this part of the extent [C]."""
CONTRADICTION, EVIDENCE, DEPTH = 30.0, 1.0, 0.3
"""Weights of the three parts of the cost [C], measured by ``preshape bench clouds``."""
CAP = 0.06
FEWEST_FACING = 0.35
"""Least cosine of a mirror's normal to the sight: one seen edge-on would not show the far side [C]."""
EACH = {"mirror": 2, "turn": 1, "point": 1}
"""How many of each kind are used at most: together they leave less of the far side than one alone [C]."""
APART = 0.6
"""Symmetries of one kind are different where their axes are farther apart than this [rad] [C]."""
ALLOWED = 0.03
"""Contradiction above the least one's that is still allowed [C]."""
KINDS = ("mirror", "turn", "point")


@value
class Symmetry:
    """A motion of space that maps the object on itself.

    Attributes:
        kind: ``mirror`` (about a plane), ``turn`` (half a turn about an axis) or ``point``.
        linear: (3, 3) orthogonal.
        middle: (3,) a point that stays where it is [m].
        cost: what was least.
        evidence: share of the seen points that it maps on seen points.
        contradiction: mean depth of mapped points in free space, 0 to 1.
    """

    kind: str
    linear: Array
    middle: Array
    cost: float
    evidence: float
    contradiction: float

    def __post_init__(self) -> None:
        freeze(
            self,
            linear=frozen_array(self.linear, (3, 3), "symmetry"),
            middle=frozen_array(self.middle, (3,), "middle"),
        )

    def apply(self, points: Array) -> Array:
        """(n, 3) where points are mapped to [m]."""
        return (points - self.middle) @ self.linear.T + self.middle


def symmetries(
    sight: Sight, points: Array, *, kinds: tuple[str, ...] = KINDS, seed: int = 0
) -> tuple[Symmetry, ...]:
    """Symmetries that what was seen allows, the likeliest first.

    Of each kind the best, and others of that kind that are at another direction; of all of them those that
    contradict what was seen hardly more than the least contradicting one.

    Args:
        sight: what the camera saw.
        points: (n, 3) its points, cleaned [m].
        kinds: which kinds are tried.
        seed: of the choice of points that are mapped.
    """
    rng = np.random.default_rng(seed)
    chosen = points[rng.permutation(len(points))[:SAMPLES]]
    width, across = outline_width(sight, points)
    size = float(np.ptp(points, axis=0).max())
    steps = _front(sight) + width * np.linspace(0.05, DEEPEST, DEPTHS)
    middles = sight.camera + steps[:, None] * (np.array([*across, 1.0]) @ sight.axes)
    found: list[Symmetry] = []
    for kind in kinds:
        parts = _linear_parts(kind, sight, points)
        tried = [_best_along(kind, linear, middles, sight, chosen, size, width) for linear in parts]
        kept: list[Symmetry] = []
        for one in sorted(tried, key=lambda s: s.cost):
            if len(kept) < EACH[kind] and all(_differ(one.linear, other.linear) for other in kept):
                kept.append(one)
        found += [_refined(one, sight, chosen, size, width, rng) for one in kept]
    least = min(one.contradiction for one in found)
    allowed = [one for one in found if one.contradiction <= least + ALLOWED]
    return tuple(sorted(allowed, key=lambda s: s.cost))


def _differ(first: Array, second: Array) -> bool:
    """Whether two reflections or half turns have axes more than ``APART`` from each other."""
    # tr(R1 R2') = 4 cos² - 1, of the angle between normals or axes.
    cosine = np.sqrt(max(0.0, (float(np.trace(first @ second.T)) + 1) / 4))
    return bool(cosine < np.cos(APART))


def _best_along(
    kind: str, linear: Array, middles: Array, sight: Sight, points: Array, size: float, width: float
) -> Symmetry:
    mapped = (points[None] - middles[:, None]) @ linear.T + middles[:, None]
    return _cheapest(kind, np.broadcast_to(linear, (len(middles), 3, 3)), middles, mapped, sight, size, width)


def _cheapest(
    kind: str, linear: Array, middles: Array, mapped: Array, sight: Sight, size: float, width: float
) -> Symmetry:
    """The best of several, from where each maps the points: (k, n, 3)."""
    free = sight.free(mapped.reshape(-1, 3)).reshape(mapped.shape[:2]) / size
    tolerance = max(TOLERANCE, sight.spacing / size)
    bad = np.clip(free - tolerance, 0.0, CAP).mean(axis=1) / CAP
    good = (np.abs(free) < tolerance).mean(axis=1)
    along = (mapped - sight.camera) @ sight.forward
    deepest = np.quantile(along, 0.98, axis=1)
    nearest = np.quantile(along, 0.02, axis=1)
    thick = (deepest - np.minimum(nearest, _front(sight))) / width
    off = np.abs(np.log(np.maximum(thick, 0.05)))
    cost = CONTRADICTION * bad - EVIDENCE * good + DEPTH * off
    k = int(cost.argmin())
    return Symmetry(
        kind=kind,
        linear=linear[k],
        middle=middles[k],
        cost=float(cost[k]),
        evidence=float(good[k]),
        contradiction=float(bad[k]),
    )


def _front(sight: Sight) -> float:
    inside = sight.depth[sight.outline < 0]
    return float(np.quantile(inside, 0.02)) if len(inside) else float(sight.depth.min())


def _refined(
    best: Symmetry, sight: Sight, points: Array, size: float, width: float, rng: np.random.Generator
) -> Symmetry:
    """Small turns and shifts of the best, three times smaller each time."""
    for scale in (1.0, 0.5, 0.25):
        turns = np.concatenate([np.zeros((1, 3)), scale * rng.normal(0, 0.12, (39, 3))])
        shifts = np.concatenate([np.zeros((1, 3)), scale * width * rng.normal(0, 0.04, (39, 3))])
        rotations = rotation_from_vector(turns)
        linear = rotations @ best.linear @ rotations.transpose(0, 2, 1)
        middles = best.middle + shifts
        mapped = np.einsum("kij,knj->kni", linear, points[None] - middles[:, None]) + middles[:, None]
        best = _cheapest(best.kind, linear, middles, mapped, sight, size, width)
    return best


def outline_width(sight: Sight, points: Array) -> tuple[float, Array]:
    """Width of the outline across its longer side [m], and its middle (tangents).

    The narrowest box round the outline has the width as its shorter side.

    Args:
        sight: what the camera saw.
        points: (n, 3) its points [m].
    """
    inside = np.argwhere(sight.outline < 0)[:, ::-1] * sight.step + sight.low
    local = (points - sight.camera) @ sight.axes.T
    deep = float(np.median(local[:, 2]))
    boxes = []
    for angle in np.linspace(0, np.pi / 2, 24, endpoint=False):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        turned = inside @ turn
        low, high = turned.min(axis=0), turned.max(axis=0)
        boxes.append((float((high - low).prod()), float((high - low).min()), turn @ ((low + high) / 2)))
    _, width, middle = min(boxes, key=lambda box: box[0])
    return width * deep, middle


def _linear_parts(kind: str, sight: Sight, points: Array) -> list[Array]:
    if kind == "point":
        return [-np.eye(3)]
    ahead = sight.forward
    main = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    level = ahead * np.array([1.0, 1.0, 0.0])
    own = [ahead, level, *np.eye(3), *main]
    directions = [d / np.linalg.norm(d) for d in own if np.linalg.norm(d) > 0.2] + list(_round(24))
    if kind == "mirror":
        facing = [n for n in directions if abs(n @ ahead) > FEWEST_FACING]
        return [np.eye(3) - 2 * np.outer(n, n) for n in facing]
    crossing = [a for a in directions if abs(a @ ahead) < np.sqrt(1 - FEWEST_FACING**2)]
    return [2 * np.outer(a, a) - np.eye(3) for a in crossing]


def _round(count: int) -> Array:
    """(count, 3) directions spread over a half-sphere (Fibonacci)."""
    k = np.arange(count) + 0.5
    z = k / count
    angle = np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
