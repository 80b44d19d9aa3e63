"""The unseen side of an object that was seen from one side, guessed by symmetry.

Most objects that a hand holds are symmetric about a plane, an axis or a point. A candidate symmetry maps the
seen points to the far side. A valid one never maps a point into space that the camera saw to be free (Thrun
and Wegbreit 2005, Shape from symmetry; Bohg et al. 2011, Mind the gap - robotic grasping under incomplete
observation). A valid candidate is better if it maps seen points onto seen points, and if the completed object
is about as deep as it is wide. The search has these steps:

1. Make the linear parts: reflections, half turns and the point reflection (:func:`_linear_parts`).
2. For each, try positions of its centre along the line of sight and take the cheapest (:func:`_best_along`).
3. Of each kind, keep the cheapest candidates with different directions and refine them (:func:`_refined`).
4. Keep the candidates whose contradiction is at most ``ALLOWED`` above the least one.
"""

from __future__ import annotations

import numpy as np

from ...spatial import rotation_from_vector
from ...types import Array, freeze, frozen_array, value
from .sight import Sight

SAMPLES = 500
"""Number of points that a candidate maps [C]."""
DEPTHS = 28
"""Number of positions of the centre that are tried along the line of sight [C]."""
DEEPEST = 0.9
"""Largest distance of a centre behind the nearest point, in widths of the outline [C]."""
TOLERANCE = 0.015
"""A mapped point within this share of the extent from the surface is on it, and not in free space [C]."""
CONTRADICTION, EVIDENCE, DEPTH = 30.0, 1.0, 0.3
"""Weights of the three parts of the cost, tuned with ``preshape bench clouds`` [C]."""
CAP = 0.06
"""Depth in free space at which a point contradicts fully, as a share of the extent [C]."""
FEWEST_FACING = 0.35
"""Least cosine of the angle between a mirror's normal and the line of sight; a mirror seen edge-on would not
show the far side [C]."""
EACH = {"mirror": 2, "turn": 1, "point": 1}
"""Largest number of symmetries of each kind; several together remove more of the far side than one [C]."""
APART = 0.6
"""Symmetries of one kind are different when the angle between their axes exceeds this [rad] [C]."""
ALLOWED = 0.03
"""Contradiction above the least one that is accepted [C]."""
KINDS = ("mirror", "turn", "point")


@value
class Symmetry:
    """An isometry that maps the object onto itself.

    Attributes:
        kind: ``mirror`` (about a plane), ``turn`` (half a turn about an axis) or ``point``.
        linear: (3, 3) orthogonal matrix.
        middle: (3,) fixed point [m].
        cost: Cost that the search minimises.
        evidence: Share of the seen points that are mapped onto the seen surface.
        contradiction: Mean depth of the mapped points in free space, divided by ``CAP``, from 0 to 1.
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
        """(n, 3) images of points [m]."""
        return (points - self.middle) @ self.linear.T + self.middle


def symmetries(
    sight: Sight, points: Array, *, kinds: tuple[str, ...] = KINDS, seed: int = 0
) -> tuple[Symmetry, ...]:
    """The symmetries that the view permits, the likeliest first.

    Args:
        sight: The view of the camera.
        points: (n, 3) its cleaned points [m].
        kinds: Kinds of symmetry that are tried.
        seed: Seed of the points that are mapped and of the refinement.
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
        candidates = [_best_along(kind, linear, middles, sight, chosen, size, width) for linear in parts]
        best: list[Symmetry] = []
        for candidate in sorted(candidates, key=lambda s: s.cost):
            if len(best) < EACH[kind] and all(_differ(candidate.linear, other.linear) for other in best):
                best.append(candidate)
        found += [_refined(candidate, sight, chosen, size, width, rng) for candidate in best]
    least = min(symmetry.contradiction for symmetry in found)
    allowed = [symmetry for symmetry in found if symmetry.contradiction <= least + ALLOWED]
    return tuple(sorted(allowed, key=lambda s: s.cost))


def _differ(first: Array, second: Array) -> bool:
    """Whether the angle between the axes of two reflections or half turns exceeds ``APART``."""
    # tr(R1 R2ᵀ) = 4 cos² - 1, of the angle between normals or axes.
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
    """The cheapest of k candidates, from the images (k, n, 3) of the points under each."""
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
    """The cheapest of random small rotations and shifts of a candidate, in three rounds of halved size."""
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
    """Shorter side of the smallest box around the outline [m], and its centre (tangents).

    Args:
        sight: The view of the camera.
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
    """Linear parts to try: about the line of sight, axes, principal axes and evenly spread directions."""
    if kind == "point":
        return [-np.eye(3)]
    ahead = sight.forward
    main = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    level = ahead * np.array([1.0, 1.0, 0.0])
    own = [ahead, level, *np.eye(3), *main]
    directions = [d / np.linalg.norm(d) for d in own if np.linalg.norm(d) > 0.2] + list(_half_sphere(24))
    if kind == "mirror":
        facing = [n for n in directions if abs(n @ ahead) > FEWEST_FACING]
        return [np.eye(3) - 2 * np.outer(n, n) for n in facing]
    crossing = [a for a in directions if abs(a @ ahead) < np.sqrt(1 - FEWEST_FACING**2)]
    return [2 * np.outer(a, a) - np.eye(3) for a in crossing]


def _half_sphere(count: int) -> Array:
    """(count, 3) directions spread over a half-sphere (Fibonacci)."""
    k = np.arange(count) + 0.5
    z = k / count
    angle = np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
