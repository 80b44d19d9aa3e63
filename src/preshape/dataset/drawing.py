"""The grasps of a shard: the planner's answers, or hands closed at random.

The planner is asked as its mode 3 asks the closure analyser: everywhere, without a memory, so that a shard
depends on no other and costs no first lesson.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..closure.analyser import ClosureAnalyser
from ..closure.grip import Finished, counted_to
from ..hands.hand import Hand
from ..hiis.analyser import Aim, VirtualGrasp, same_grip
from ..hiis.fuzzy import FuzzySets
from ..hiis.learning import search_values
from ..objects.mesh import TriangleMesh
from ..planner import layout_of
from ..studies.index_population import draw_population
from ..tasks import Task
from ..types import value
from .settings import THRESHOLD, DatasetSettings

TURNS = 4
"""Searches for the ranked grasps of a shard, at most."""


@value
class Drawn:
    """The grasps of one shard.

    Attributes:
        grasps: of ranked ones the best first.
        analyser: knows hand, object and task.
        reason: why there are fewer than asked for; empty where there are not.
    """

    grasps: tuple[VirtualGrasp, ...]
    analyser: ClosureAnalyser
    reason: str


def draw(
    hand: Hand, mesh: TriangleMesh, task: Task, count: int, seed: int, settings: DatasetSettings
) -> Drawn:
    """The grasps of one shard.

    Args:
        hand: the hand.
        mesh: the object at its scale.
        task: what is planned for.
        count: grasps wanted.
        seed: of everything random.
        settings: the dataset's.

    Raises:
        ObjectError: the object does not suit the analyser.
    """

    def analyser(turn: int) -> ClosureAnalyser:
        return ClosureAnalyser(
            mesh,
            hand,
            layout_of(hand),
            settings=settings.closure(count),
            gravity=task.gravity,
            seed=seed + turn,
        )

    if settings.ranked:
        return _best(analyser, task, count)
    return _any(analyser(0), task, count, seed)


def _best(analyser: Callable[[int], ClosureAnalyser], task: Task, count: int) -> Drawn:
    """What the planner would answer, apart from each other and rewarded by the critic."""
    good: list[VirtualGrasp] = []
    tried, best = 0, 0.0
    for turn in range(TURNS):
        element = analyser(turn)
        found = element.explore(task.q, Aim(values=search_values(FuzzySets())))
        tried += found.aimed
        for k in range(len(found)):
            grasp = element.grasp(task.q, found, k)
            best = max(best, grasp.judged)
            if grasp.judged >= THRESHOLD and not any(same_grip(grasp, other) for other in good):
                good.append(grasp)
        if len(good) >= count:
            break
    reason = ""
    if not best:
        reason = f"none of {tried} hands closed on the object makes a grasp that can be executed"
    elif not good:
        reason = f"the best of {tried} hands closed on the object has quality {best:.2f}, under {THRESHOLD:g}"
    elif len(good) < count:
        reason = f"of {tried} hands closed on the object only {len(good)} are good enough and stand apart"
    good.sort(key=lambda grasp: -grasp.judged)
    return Drawn(grasps=tuple(good[:count]), analyser=element, reason=reason)


def _any(analyser: ClosureAnalyser, task: Task, count: int, seed: int) -> Drawn:
    """Hands closed at random that can be executed, however well they hold."""
    found = draw_population(analyser.hand, analyser.mesh, count, np.random.default_rng(seed))
    made = []
    for grip, points, normals, plane in zip(
        found.grips, found.points, found.normals_in, found.planes, strict=True
    ):
        number, flip = counted_to(grip.approach, points, plane, (plane,))
        made.append(Finished(grip=grip, row=0, plane=number, flip=flip, points=points, normals_in=normals))
    grasps = analyser.virtual_grasps(task.q, made)
    short = f"only {len(grasps)} of {found.drawn} hands drawn close on the object and can be executed"
    return Drawn(grasps=tuple(grasps), analyser=analyser, reason="" if len(grasps) == count else short)
