"""The internal critic (IC, §3.4): rewards and penalties by fuzzy matching, and recognition (§3.6).

The critic only compares a score with a threshold and gives the reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from ..exceptions import InputError
from ..objects.mesh import TriangleMesh
from ..objects.shape import LENGTH, attribute_distance, described, shape_distance
from ..types import Attributes, Experience, freeze, frozen_array, value
from .analyser import Aim, Analyser
from .fuzzy import FuzzySets, tfvadi

SLACK = 1e-9
"""A match that is below a threshold by at most this slack still meets the threshold."""

SAME_OBJECT = -math.log(0.95)
"""Two objects may be the same if their sizes differ by 5 % at most, as the logarithm of a scale [C]."""

SAME_SHAPE = 0.045
"""Largest distance of the shape descriptors of two objects with the same extents and the same shape [C].

Measured with :func:`~preshape.objects.shape.shape_distance`:

- each of the 41 library objects and the same object with smaller triangles: below 1e-6; the same object with
  40 % of its triangles, within 0.2 % of the largest extent: median 0.003, at most 0.032 (the phone);
- two different library objects: at least 0.098 (hexagonal prism and cylinder);
- a cylinder and a hexagonal prism of equal extents, in six sizes: 0.057 to 0.107.

An object is not recognised if simplification has removed a tenth of a thin wall, or if a scan lacks a side.
An object that differs little from itself turned by 180° (teapot 0.031, scissors 0.012) is recognised turned.
"""


@value
class Thresholds:
    """What meta control sets (§3.4).

    Attributes:
        estimation: TFVADI or quality that a preshape must reach; also the paper's execution threshold.
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
    """The critic's signal to the performance element and the learning element.

    Attributes:
        reward: True for a reward, False for a penalty.
        match: The score that was judged, 0..6; ``None`` if there was no grasp.
        reason: One sentence.
    """

    reward: bool
    match: float | None
    reason: str


@value
class Recognition:
    """Whether the object is known (mode 2).

    Attributes:
        verdict: A reward if the object is known.
        candidates: Number of experiences within the attribute distance.
        nearest: Object name of the experience with the best match.
    """

    verdict: Verdict
    candidates: int
    nearest: str | None


def judge(match: float | None, threshold: float, *, subject: str = "TFVADI", why: str = "") -> Verdict:
    """A reward if the match meets the threshold, otherwise a penalty.

    Args:
        match: Score, 0..6, or ``None`` if there is no grasp.
        threshold: Threshold to meet, with a slack of 1e-9.
        subject: Name of the score, for the reason.
        why: Why there is no grasp, for the reason.
    """
    if match is None:
        return Verdict(reward=False, match=None, reason=f"no grasp found{f': {why}' if why else ''}")
    met = match >= threshold - SLACK
    relation = "meets" if met else "is below"
    reason = f"{subject} {match:.2f} {relation} the threshold {threshold:.2f}"
    return Verdict(reward=met, match=match, reason=reason)


def recognise(
    analyser: Analyser,
    experiences: Sequence[Experience],
    threshold: float,
    sets: FuzzySets,
    *,
    distance: Callable[[Attributes, Attributes], float] = attribute_distance,
    within: float = SAME_OBJECT,
) -> Recognition:
    """Mode 2: whether the memory knows the current object.

    Experiences count whose object lies within the attribute distance and whose shape descriptor, where
    one is stored, is that of the same shape: stretched to equal extents, some different objects have
    almost equal net wrenches [C]. For each of them, the analyser makes the stored virtual grasp (plane,
    flip, approach value, fingers) on the **current** mesh. The score of recognition is the largest TFVADI
    between a new net wrench and the stored one; it is 0 if the new grasp has no contact [R].

    Args:
        analyser: Analyser of the current object.
        experiences: Experiences of the current hand.
        threshold: TFVADI at which the object counts as known.
        sets: Membership functions.
        distance: Function that returns the distance between the attributes of two objects.
        within: Largest attribute distance of an experience that is compared.
    """
    current = [e for e in experiences if not e.outdated]
    near = of_this_object(current, analyser.mesh, distance=distance, within=within)
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


def of_this_object(
    experiences: Iterable[Experience],
    mesh: TriangleMesh,
    *,
    distance: Callable[[Attributes, Attributes], float] = attribute_distance,
    within: float = SAME_OBJECT,
) -> list[Experience]:
    """The lessons of objects that may be this one: of the same size, within 5 %, and of the same shape.

    Args:
        experiences: Lessons.
        mesh: The current object. Its shape is described only if a lesson is of its size.
        distance: Function that returns the distance between the attributes of two objects.
        within: Largest distance of the attributes.
    """
    near = [e for e in experiences if distance(mesh.attributes, e.attributes) <= within + SLACK]
    if all(e.attributes.shape is None for e in near):
        return near
    here = described(mesh)
    return [e for e in near if same_shape(here, e.attributes)]


def same_shape(a: Attributes, b: Attributes) -> bool:
    """Whether two shape descriptors are close enough for the same object; True if one is unknown."""
    if a.shape is None or b.shape is None:
        return True
    return shape_distance(a.shape, b.shape) <= SAME_SHAPE + SLACK


def recognise_shape(
    attributes: Attributes, experiences: Sequence[Experience], within: float = SAME_SHAPE
) -> Recognition:
    """Recognition by size and shape alone, without an analyser (mode 2 of real hands) [C].

    An object is known if an experience has W, H and D within 5 % of its own and a shape descriptor at a
    distance of at most ``within``. It gets the name of the nearest shape. Experiences without a descriptor do
    not count.

    Args:
        attributes: Attributes of the current object, with its descriptor.
        experiences: Experiences of the current hand.
        within: Largest distance of the descriptors.

    Returns:
        The result. Its candidates are the experiences with a descriptor and W, H, D within 5 %; its verdict
        has no match, because a distance is not a TFVADI.

    Raises:
        InputError: The attributes have no descriptor, or one of another length.
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
    relation = "is within" if met else "is above"
    reason = f"the distance of its shape to {name}, {distance:.3f}, {relation} {within:.3f}"
    return Recognition(
        verdict=Verdict(reward=met, match=None, reason=reason), candidates=len(near), nearest=name
    )


def _distinct(experiences: Sequence[Experience]) -> list[Experience]:
    """One experience for each different grasp; repetitions would give the same result."""
    ways = {
        (e.plane, e.flip, round(e.approach_value, 6), e.fingers, e.wrench.round(6).tobytes()): e
        for e in experiences
    }
    return list(ways.values())
