"""Grasps of mixed quality: hands closed at random round an object, not ranked by anything.

Whoever ranks first and measures afterwards learns nothing about the bad half. So candidates are drawn as the
closure analyser draws them, those that closed are put in random order, and the first that a hand can execute
are kept: free way in, nothing cut into, links not in each other. None of this looks at how well the contacts
hold. Every grasp squeezes with the same sum of normal forces, whatever its metrics say.
"""

from __future__ import annotations

import math
import zlib

import numpy as np

from ..closure import grip
from ..closure.analyser import WANTED
from ..closure.holding import inner_centre
from ..closure.sampling import sample
from ..closure.search import ClosureSearch, Demand
from ..closure.settings import ClosureSettings
from ..hands.hand import Hand
from ..hiis.analyser import Grip
from ..kernels.field.host import SurfaceQuery, prepare_field
from ..objects.mesh import TriangleMesh
from ..types import Array, value

PRESS = 10.0
"""Sum of the normal forces of every squeeze [N]; a hand whose joints are too weak presses less."""
DRAWN = 400
"""Candidates drawn at a time."""
MOST_DRAWS = 40
"""Times that candidates are drawn for one hand and object before giving up."""
LOOKED_AT = 3
"""Candidates worked out at a time, for each grasp still wanted."""


@value
class Population:
    """Executable grasps of one hand on one object, in the order in which they were found.

    Attributes:
        grips: the hand's postures and squeeze.
        points: for each (n, 3) contacts in the mesh frame, the thumb's first [m].
        normals_in: for each (n, 3) inward unit normals.
        planes: approach plane that the way in of each belongs to, 1..12.
        search: knows hand and object, and how the planner would rank.
        drawn: candidates drawn.
        closed: how many of them closed on the object.
    """

    grips: tuple[Grip, ...]
    points: tuple[Array, ...]
    normals_in: tuple[Array, ...]
    planes: tuple[int, ...]
    search: ClosureSearch
    drawn: int
    closed: int


class _Unjudged(ClosureSearch):
    """A search to which every candidate that closed is as good as any other."""

    def score(self, task: Array, hold: Array, demand: Demand) -> Array:
        return np.ones(len(hold))


def settings() -> ClosureSettings:
    """What the population is made with: one press for all."""
    return ClosureSettings(press_least=PRESS, press_most=PRESS, threads=1)


def cell_rng(seed: int, hand: str, thing: str) -> np.random.Generator:
    """Random numbers of one hand on one object, whatever else is measured."""
    return np.random.default_rng([seed, zlib.crc32(hand.encode()), zlib.crc32(thing.encode())])


def draw_population(hand: Hand, mesh: TriangleMesh, count: int, rng: np.random.Generator) -> Population:
    """Draw ``count`` grasps; fewer where the hand hardly ever closes on the object.

    Args:
        hand: a hand of the package.
        mesh: the object at its size.
        count: how many are wanted.
        rng: of the draws.
    """
    field = prepare_field(mesh)
    centre = inner_centre(field, mesh)
    search = _Unjudged(hand, field, centre, float(mesh.extents.max()) / 2, settings())
    finisher = grip.Finisher(search, SurfaceQuery(mesh))
    finisher.unbalanced = math.inf  # what the planner refuses belongs to the sample
    grips: list[Grip] = []
    points: list[Array] = []
    normals: list[Array] = []
    planes: list[int] = []
    drawn = closed = 0
    for _ in range(MOST_DRAWS):
        candidates = sample(rng, search.pool, mesh.cog, mesh.extents / 2, DRAWN)
        found = search.evaluate(candidates, Demand(), wanted=WANTED)
        drawn, closed = drawn + DRAWN, closed + len(found)
        found = found.take(rng.permutation(len(found)))
        step = LOOKED_AT * count
        for first in range(0, len(found), step):
            part = found.take(np.arange(first, min(first + step, len(found))))
            finished = finisher.finish(part, Demand(), wanted=WANTED, enough=count - len(grips))
            for made in finished:
                grips.append(made.grip)
                points.append(made.points)
                normals.append(made.normals_in)
                planes.append(made.plane)
            if len(grips) == count:
                break
        if len(grips) == count:
            break
    return Population(
        grips=tuple(grips),
        points=tuple(points),
        normals_in=tuple(normals),
        planes=tuple(planes),
        search=search,
        drawn=drawn,
        closed=closed,
    )
