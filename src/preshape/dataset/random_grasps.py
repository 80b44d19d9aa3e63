"""Random grasps of mixed quality: hands closed on an object and accepted without any ranking.

A study of grasp metrics needs bad grasps as well as good ones. The planner ranks candidates by their margins
and refines the best, so its answers hold few bad ones. The steps here are:

1. Draw candidates as the closure analyser does, and close the hand on the object.
2. Shuffle the candidates that closed.
3. Accept those that the hand can execute, in the shuffled order: the way in is free, no link is deep in the
   object, and no two links overlap. Whether the contacts hold the object is not checked.

Every grasp squeezes with the same sum of normal forces.
"""

from __future__ import annotations

import math
import zlib

import numpy as np

from ..closure.candidates import Region, draw_candidates
from ..closure.demand import Demand, inner_centre
from ..closure.finish import FinishedGrip, Finisher, FinishOptions
from ..closure.search import ClosureSearch
from ..closure.settings import ClosureSettings
from ..hands.hand import Hand
from ..kernels.field.host import SurfaceQuery, prepare_field
from ..objects.mesh import TriangleMesh
from ..types import FIELD_MASS, FRICTION, Array, value

PRESS = 10.0
"""Sum of the normal forces of every squeeze [N]; smaller if the joint torques do not suffice."""
BATCH = 400
"""Number of candidates drawn in one round."""
MAX_ROUNDS = 40
"""Largest number of rounds for one hand and object; fewer grasps than requested may then be returned."""
FINISH_FACTOR = 3
"""Number of candidates finished at a time, divided by the number of grasps requested."""


@value
class RandomGrasps:
    """Executable grasps of one hand on one object, in the order in which they were accepted.

    Attributes:
        grasps: Postures, squeeze, contacts and approach plane of each grasp.
        search: The search for this hand and object, from which the planner's score can be computed.
        drawn: Number of candidates drawn.
        closed: Number of candidates that closed on the object.
    """

    grasps: tuple[FinishedGrip, ...]
    search: ClosureSearch
    drawn: int
    closed: int


class _UnrankedSearch(ClosureSearch):
    """A search that gives every closed candidate the same score."""

    def score(self, task: Array, hold: Array, demand: Demand) -> Array:
        return np.ones(len(hold))


def random_grasp_settings(friction: float = FRICTION) -> ClosureSettings:
    """Closure settings in which every grasp presses with :data:`PRESS`.

    Args:
        friction: Sliding friction between hand and object.
    """
    return ClosureSettings(friction=friction, mass=FIELD_MASS, press_least=PRESS, press_most=PRESS, threads=1)


def random_generator(seed: int, hand: str, object_name: str) -> np.random.Generator:
    """Random generator of one hand and object.

    Its seed is made of their names, so the grasps stay the same if other hands and objects are added.
    """
    return np.random.default_rng([seed, zlib.crc32(hand.encode()), zlib.crc32(object_name.encode())])


def draw_random_grasps(
    hand: Hand, mesh: TriangleMesh, count: int, rng: np.random.Generator, settings: ClosureSettings
) -> RandomGrasps:
    """Draw ``count`` grasps, or fewer if the hand rarely closes on the object.

    Args:
        hand: The hand.
        mesh: The object at its size [m].
        count: Number of grasps requested.
        rng: Random generator for the candidates and their order.
        settings: Friction and squeeze, from :func:`random_grasp_settings`.
    """
    field = prepare_field(mesh)
    centre = inner_centre(field, mesh)
    query = SurfaceQuery(mesh)
    search = _UnrankedSearch(hand, field, centre, float(mesh.extents.max()) / 2, settings, query=query)
    finisher = Finisher(search, query)
    finisher.max_imbalance = math.inf  # the planner refuses unbalanced grips; the sample must contain them
    finished: list[FinishedGrip] = []
    drawn = closed = 0
    while len(finished) < count and drawn < MAX_ROUNDS * BATCH:
        candidates = draw_candidates(rng, search.pool, mesh.cog, mesh.extents / 2, BATCH, Region())
        found = search.evaluate(candidates, Demand())
        drawn, closed = drawn + BATCH, closed + len(found)
        found = found.take(rng.permutation(len(found)))
        step = FINISH_FACTOR * count
        for first in range(0, len(found), step):
            part = found.take(np.arange(first, min(first + step, len(found))))
            finished += finisher.finish(part, Demand(), FinishOptions(count=count - len(finished)))
            if len(finished) >= count:
                break
    return RandomGrasps(grasps=tuple(finished), search=search, drawn=drawn, closed=closed)
