"""What the memory's lessons say of the current object: which are its own, and what of them still counts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ..objects.shape import attribute_distance
from ..types import ANSWER_KIND, Attributes, Experience
from .critic import SLACK
from .learning import grasp_key, lesson_key

_THE_VERY_OBJECT = 1e-6
_SCORED = ("seed", "task", ANSWER_KIND)
"""Kinds of lessons whose score says how well a task was met; the others are compared with themselves."""


def of_this_mesh(experiences: Iterable[Experience], here: Attributes) -> list[Experience]:
    """The lessons of this very object, in this or in another triangulation with the same surface."""
    return [
        e
        for e in experiences
        if np.allclose(e.attributes.extents, here.extents, rtol=_THE_VERY_OBJECT)
        and attribute_distance(here, e.attributes) < _THE_VERY_OBJECT
    ]


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


def well_learnt(experiences: Iterable[Experience], scene: str, threshold: float) -> list[Experience]:
    """The lessons by which an object is known: those of objects with a good enough grasp in this scene.

    A deadlock is a lesson too, but it must not make its object known. Answers that were stored without
    teaching are left out.

    Args:
        experiences: Lessons of one hand.
        scene: The scene.
        threshold: Quality or match that is good enough.
    """
    lessons = [e for e in experiences if e.scene == scene and not e.outdated]
    good = {_object(e) for e in lessons if e.kind in _SCORED and e.judged >= threshold - SLACK}
    return [e for e in lessons if e.kind != ANSWER_KIND and _object(e) in good]


def _object(e: Experience) -> tuple[str, bytes]:
    return e.object_name, e.attributes.extents.tobytes()


def _subject(e: Experience) -> tuple[object, ...]:
    """What a lesson is about: its key without the grasp, and its kind."""
    return e.kind, *lesson_key(e)[:-1]
