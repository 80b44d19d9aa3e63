"""The search of wraps: draw, refine for longer than fingertip grips, rank under pose errors, finish."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..hiis.analyser import Aim
from .aiming import AimDraws
from .candidates import RankedCandidates, distinct, merged
from .demand import Demand
from .finish import FinishedGrip, Finisher, FinishOptions
from .search import ClosureSearch

WRAP_ELITE, WRAP_CHILDREN, WRAP_SAMPLES = 32, 6, 4
"""Size of the elite set of wraps, number of children of each of them, and of disturbed poses [C]."""
WRAP_ROUNDS, WRAP_DECAY = 2, 0.8
"""Rounds of refinement of wraps for each round of fingertip grips, and the factor by which their spread
shrinks [C]: few draws balance anything, so they are refined for longer. Measured on wood block and cracker
box with two hands, the best margin doubled."""


def best_wraps(
    search: ClosureSearch,
    draws: AimDraws,
    finisher: Finisher,
    rng: np.random.Generator,
    aim: Aim,
    demand: Demand,
    options: FinishOptions,
) -> tuple[list[FinishedGrip], RankedCandidates]:
    """The best wraps of the whole hand in an aim, and the candidates, best first.

    Where all planes are searched, the search is repeated while no wrap is good enough.

    Args:
        search: The search.
        draws: Draws the wraps of an aim.
        finisher: Finishes them.
        rng: Random generator.
        aim: Where to look.
        demand: What the task asks.
        options: How many are wanted, and which.
    """
    settings, whole = search.settings, len(aim.planes) > 1
    count, grips = round((1.0 if whole else 0.5) * settings.wraps), list[FinishedGrip]()
    every: RankedCandidates | None = None
    for _ in range(1 + settings.persistence if whole else 1):
        drawn = draws.wraps(rng, aim, count)
        found = search.refine(
            rng,
            search.evaluate(drawn, demand),
            demand,
            elite=WRAP_ELITE,
            children=WRAP_CHILDREN,
            rounds=WRAP_ROUNDS * settings.rounds,
            decay=WRAP_DECAY,
        )
        every = found if every is None else merged(every, found)
        examined = found.take(distinct(found, max(16, 4 * options.count)))
        examined = search.steady(rng, examined, demand, samples=WRAP_SAMPLES)
        # The fine spheres touch at other places, so twice as many as wanted are finished.
        wide = replace(options, count=2 * options.count)
        grips += finisher.finish(examined, demand, wide)
        if best_margin(grips) >= 1.0:
            break
    assert every is not None
    grips.sort(key=lambda grip: -grip.margin)
    return grips[: options.count], every


def best_margin(finished: Sequence[FinishedGrip]) -> float:
    """Largest margin of finished grips; -1 if there are none."""
    return max((grip.margin for grip in finished), default=-1.0)
