"""What the memory's lessons say of the current object: which are its own, and what of them still counts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ..objects.shape import attribute_distance
from ..types import ANSWER_KIND, Attributes, Experience
from .critic import SAME_OBJECT, SLACK, same_shape
from .learning import grasp_key, lesson_key

_THE_VERY_OBJECT = 1e-6


def of_this_mesh(experiences: Iterable[Experience], here: Attributes) -> list[Experience]:
    """The lessons of this very object, in this or in another triangulation with the same surface."""
    return [
        e
        for e in experiences
        if np.allclose(e.attributes.extents, here.extents, rtol=_THE_VERY_OBJECT)
        and attribute_distance(here, e.attributes) < _THE_VERY_OBJECT
    ]


def of_this_object(experiences: Iterable[Experience], here: Attributes) -> list[Experience]:
    """The lessons of objects that may be this one: of the same size within 5 %, and of the same shape.

    Args:
        experiences: Lessons.
        here: Attributes of the current object; with a shape descriptor, shapes are compared too.
    """
    near = [e for e in experiences if attribute_distance(here, e.attributes) <= SAME_OBJECT + SLACK]
    return [e for e in near if same_shape(here, e.attributes)]


def best_first(lessons: Sequence[Experience]) -> list[Experience]:
    """One lesson of each grasp that has not lost the object in physics; outdated ones, then the best, first.

    Landmarks are left out, because they were not chosen for the task.
    """
    lost = {grasp_key(e) for e in lessons if e.outcome == "lost"}
    of_grasp = {grasp_key(e): e for e in lessons if grasp_key(e) not in lost and e.kind != "landmark"}
    return sorted(of_grasp.values(), key=lambda e: (not e.outdated, -e.judged))


def not_yet_learnt(new: Sequence[Experience], known: Sequence[Experience]) -> list[Experience]:
    """The lessons that the memory does not hold yet as the latest for object, task and scene."""
    latest = {_subject(e): lesson_key(e) for e in known}
    return [e for e in new if latest.get(_subject(e)) != lesson_key(e)]


def good_enough(experiences: Iterable[Experience], scene: str, threshold: float) -> list[Experience]:
    """The lessons by which a real hand knows an object: of this scene, with a good enough grip."""
    return [
        e for e in experiences if e.kind != ANSWER_KIND and e.scene == scene and e.judged >= threshold - SLACK
    ]


def _subject(e: Experience) -> tuple[object, ...]:
    """What a lesson is about: its key without the grasp, and its kind."""
    return e.kind, *lesson_key(e)[:-1]
