"""The internal critic (IC, §3.4): rewards and penalties by fuzzy matching, and recognition (§3.6).

The critic compares with a threshold and says why; it decides nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..exceptions import InputError
from ..objects.shape import LENGTH
from ..types import Attributes, Experience, freeze, frozen_array, value
from .analyser import Aim, Analyser
from .fuzzy import FuzzySets, tfvadi

SLACK = 1e-9
"""A match this close under a threshold still meets it."""

SAME_OBJECT = 0.05
"""Attribute distance within which two objects may be the same one [C]."""

SAME_SHAPE = 0.045
"""Distance of shape descriptors within which two objects of the same extents have the same shape [C].

Measured (distance as of :func:`~preshape.objects.shape.shape_distance`):

- the 41 library objects against themselves cut finer: under 1e-6; simplified within 0.2 % of their largest
  extent, to 40 % of their triangles: 0.003 in the median, 0.032 at most (the phone);
- two different library objects: 0.098 at least (hexagonal prism and cylinder);
- a cylinder and a hexagonal prism of equal extents, six sizes: 0.057 to 0.107.

A mesh simplified so far that a thin wall loses a tenth of its thickness is not recognised; nor is a scan that
lacks a side. Where a turn by 180° changes an object but little (teapot 0.031, scissors 0.012) it is taken for
the turned one.
"""


@value
class Thresholds:
    """What meta control sets (§3.4).

    Attributes:
        estimation: TFVADI that a preshape must reach; the paper's execution threshold too.
        recognition: TFVADI at which an object counts as known.
    """

    estimation: float = 3.0
    recognition: float = 5.0

    def __post_init__(self) -> None:
        both = frozen_array([self.estimation, self.recognition], (2,), "thresholds")
        if not ((both >= 0) & (both <= 6)).all():
            raise InputError(f"thresholds must lie in 0..6, got {both.tolist()}")
        freeze(self, estimation=float(both[0]), recognition=float(both[1]))


@value
class Verdict:
    """The critic's signal to performance and learning element.

    Attributes:
        reward: True for success, False for a penalty.
        match: what was judged, 0..6; ``None`` where there was nothing to judge.
        reason: one sentence.
    """

    reward: bool
    match: float | None
    reason: str


@value
class Recognition:
    """Whether the object is known (mode 2).

    Attributes:
        verdict: reward when it is known.
        candidates: how many experiences lay within the attribute distance.
        nearest: the name of the experience that matched best.
    """

    verdict: Verdict
    candidates: int
    nearest: str | None


def judge(match: float | None, threshold: float, *, subject: str = "TFVADI", why: str = "") -> Verdict:
    """Reward when the match meets the threshold, else a penalty.

    Args:
        match: 0..6, or ``None`` when there is no virtual grasp.
        threshold: to be met, with 1e-9 of slack.
        subject: what the number is called in the reason.
        why: there is no virtual grasp.
    """
    if match is None:
        return Verdict(reward=False, match=None, reason=f"no virtual grasp: {why or 'none was found'}")
    met = match >= threshold - SLACK
    relation = "meets" if met else "is under"
    reason = f"{subject} {match:.2f} {relation} the threshold {threshold:.2f}"
    return Verdict(reward=met, match=match, reason=reason)


def attribute_distance(a: Attributes, b: Attributes) -> float:
    """How unlike two objects are: the largest ratio of W, H, D, area or volume, as a logarithm [C].

    The counts of table 2 are left out: they change whenever the same object is exported anew. A volume
    under a thousandth of the bounding box (an open sheet) says nothing and is left out as well.
    """
    ratios = [np.abs(np.log(a.extents / b.extents)).max(), abs(np.log(a.area / b.area))]
    box_a, box_b = float(np.prod(a.extents)), float(np.prod(b.extents))
    if a.volume > 1e-3 * box_a or b.volume > 1e-3 * box_b:
        ratios.append(abs(np.log(max(a.volume, 1e-6 * box_a) / max(b.volume, 1e-6 * box_b))))
    return float(max(ratios))


def recognise(
    analyser: Analyser,
    experiences: Sequence[Experience],
    threshold: float,
    sets: FuzzySets,
    *,
    distance: Callable[[Attributes, Attributes], float] = attribute_distance,
    within: float = SAME_OBJECT,
) -> Recognition:
    """Mode 2: is the present object one that the memory knows?

    For each experience of an object within the attribute distance, the analyser runs on the
    **present** mesh at the stored plane, flip, approach value and fingers; recognition is the largest
    TFVADI between that new net wrench and the stored one, no contact counting 0 [R].

    Args:
        analyser: prepared for the present object.
        experiences: of the present hand.
        threshold: to be met.
        sets: membership functions.
        distance: between two objects' attributes.
        within: largest distance of a candidate.
    """
    here = analyser.mesh.attributes
    near = [e for e in experiences if distance(here, e.attributes) <= within]
    best, name = 0.0, None
    for e in _distinct(near):
        aim = Aim(planes=[e.plane], values=[e.approach_value], fingers=[e.fingers], flips=[e.flip])
        found = analyser.explore(e.wrench, aim)
        match = float(tfvadi(e.wrench, found.wrench[0], sets)) if len(found) else 0.0
        if match > best:
            best, name = match, e.object_name
    if not near:
        return Recognition(
            verdict=Verdict(reward=False, match=None, reason="no known object has its size and shape"),
            candidates=0,
            nearest=None,
        )
    verdict = judge(best, threshold, subject=f"recognition as {name or near[0].object_name}:")
    return Recognition(verdict=verdict, candidates=len(near), nearest=name)


def recognise_shape(
    attributes: Attributes, experiences: Sequence[Experience], within: float = SAME_SHAPE
) -> Recognition:
    """Recognition by size and shape alone, without an analyser (mode 2 for hands of more than rays) [C].

    Known is an object of which an experience has W, H and D within 5 % and a shape descriptor within
    ``within``; the name is that of the nearest shape among these. Experiences from before there were
    descriptors do not count.

    Args:
        attributes: of the present object, with its descriptor.
        experiences: of the present hand.
        within: largest distance of descriptors.

    Returns:
        Candidates are the experiences with a descriptor and W, H, D within 5 %. The verdict has no match: a
        distance is not a TFVADI.

    Raises:
        InputError: the attributes have no descriptor, or one of another length.
    """
    here = attributes.shape
    if here is None or here.shape != (LENGTH,):
        got = "none" if here is None else f"{len(here)} numbers"
        raise InputError(f"recognition by shape needs a descriptor of {LENGTH} numbers, got {got}")
    known = [(e.object_name, e.attributes.extents, e.attributes.shape) for e in experiences]
    known = [(name, size, shape) for name, size, shape in known if shape is not None]
    extents = np.array([size for _, size, _ in known]).reshape(-1, 3)
    shapes = np.array([shape for _, _, shape in known]).reshape(-1, LENGTH)
    with np.errstate(divide="ignore"):
        sizes = np.abs(np.log(extents / attributes.extents)).max(axis=1, initial=0.0)
    near = np.flatnonzero(sizes <= SAME_OBJECT)
    if not len(near):
        reason = "no known object has its size"
        return Recognition(
            verdict=Verdict(reward=False, match=None, reason=reason), candidates=0, nearest=None
        )
    distances = np.linalg.norm(shapes[near] - here, axis=1)
    first = int(np.argmin(distances))
    name, distance = known[near[first]][0], float(distances[first])
    met = distance <= within
    relation = "is within" if met else "is over"
    reason = f"its shape's distance to {name}, {distance:.3f}, {relation} {within:.3f}"
    return Recognition(
        verdict=Verdict(reward=met, match=None, reason=reason), candidates=len(near), nearest=name
    )


def _distinct(experiences: Sequence[Experience]) -> list[Experience]:
    """One experience for each way of grasping: repeated ones would be tried for nothing."""
    ways = {
        (e.plane, e.flip, round(e.approach_value, 6), e.fingers, e.wrench.round(6).tobytes()): e
        for e in experiences
    }
    return list(ways.values())
