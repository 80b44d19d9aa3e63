"""The grasps of a shard: the planner's answers, or random grasps without ranking.

The planner searches all approach planes (mode 3 of the closure analyser) and uses no memory. A shard
therefore depends on no other shard and needs no training.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..closure.analyser import ClosureAnalyser
from ..closure.settings import FRICTION_SHARE, ClosureSettings
from ..hands.hand import Hand
from ..hiis.analyser import Aim, Grip
from ..hiis.decision import Settings
from ..hiis.fuzzy import FuzzySets
from ..hiis.learning import search_values
from ..objects.mesh import TriangleMesh
from ..planning.controllers import closure_analyser
from ..planning.request import PlanRequest
from ..planning.rules import NONE
from ..tasks import Task
from ..types import value
from .random_grasps import draw_random_grasps, random_grasp_settings
from .settings import THRESHOLD, DatasetSettings

MAX_SEARCHES = 4
"""Largest number of searches for a shard, each with another seed; it may then still have too few grasps."""


@value
class ShardGrasps:
    """The grasps of one shard.

    Attributes:
        grasps: The grasps; the planner's answers are sorted by quality, best first.
        analyser: The closure analyser for this hand, object and task.
        reason: Why there are fewer grasps than requested; empty otherwise.
    """

    grasps: tuple[Grip, ...]
    analyser: ClosureAnalyser
    reason: str


def shard_grasps(
    hand: Hand, mesh: TriangleMesh, task: Task, count: int, seed: int, settings: DatasetSettings
) -> ShardGrasps:
    """Make the grasps of one shard.

    Args:
        hand: The hand.
        mesh: The object at its scale [m].
        task: The task to plan for.
        count: Number of grasps requested.
        seed: Seed of every random draw.
        settings: Settings of the dataset.

    Raises:
        ObjectError: The analyser cannot use the object.
    """

    def analyser(search: int) -> ClosureAnalyser:
        request = PlanRequest(
            source=mesh,
            task=task,
            hand=hand,
            analyser="closure",
            mass=settings.mass,
            table=None,
            friction=settings.friction,
            count=count,
            settings=Settings(seed=seed + search),
            rules=NONE,
            search=ClosureSettings(
                everywhere=settings.candidates,
                threads=1,
                bold_share=FRICTION_SHARE,
            ),
        )
        return closure_analyser(request, hand, mesh)

    if settings.ranked:
        return _ranked(analyser, task, count)
    return _unranked(analyser(0), task, count, seed, settings.friction)


def _ranked(analyser: Callable[[int], ClosureAnalyser], task: Task, count: int) -> ShardGrasps:
    """The planner's answers that are good enough for the critic and differ from each other."""
    chosen: list[Grip] = []
    tried, best = 0, 0.0
    for search in range(MAX_SEARCHES):
        element = analyser(search)
        found = element.explore(task.q, Aim(values=search_values(FuzzySets())))
        tried += found.tried
        for k in range(len(found)):
            grasp = found.grasp(k)
            best = max(best, grasp.judged)
            if grasp.judged >= THRESHOLD and not any(grasp.same_as(other) for other in chosen):
                chosen.append(grasp)
        if len(chosen) >= count:
            break
    reason = ""
    if not best:
        reason = f"{tried} candidates were tried; none gives a grasp that the hand can execute"
    elif not chosen:
        reason = (
            f"{tried} candidates were tried; the best has quality {best:.2f}, below the threshold of "
            f"{THRESHOLD:g}"
        )
    elif len(chosen) < count:
        reason = (
            f"{tried} candidates were tried; {len(chosen)} of them have quality {THRESHOLD:g} or more and "
            "differ enough from each other"
        )
    chosen.sort(key=lambda grasp: -grasp.judged)
    return ShardGrasps(grasps=tuple(chosen[:count]), analyser=element, reason=reason)


def _unranked(analyser: ClosureAnalyser, task: Task, count: int, seed: int, friction: float) -> ShardGrasps:
    """Random grasps that the hand can execute, whether or not they hold."""
    found = draw_random_grasps(
        analyser.hand, analyser.mesh, count, np.random.default_rng(seed), random_grasp_settings(friction)
    )
    grasps = analyser.grips(task.q, found.grasps)
    reason = ""
    if len(grasps) < count:
        reason = (
            f"{found.drawn} candidates were drawn; {len(grasps)} of them closed on the object and can be "
            "executed"
        )
    return ShardGrasps(grasps=tuple(grasps), analyser=analyser, reason=reason)
