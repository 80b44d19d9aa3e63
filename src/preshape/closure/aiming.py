"""Candidates of an aim: drawn in its planes, values, fingers and thumb sides."""

from __future__ import annotations

import numpy as np

from ..hiis.analyser import MAX_FINGERS, Aim
from ..objects.mesh import TriangleMesh
from .candidates import DrawnCandidates, RankedCandidates, Region, concatenated, draw_candidates, merged
from .contact_places import AllowedSurface
from .demand import Demand
from .pinching import PINCHED, Pincher
from .recall import FEW_VALUES
from .search import ClosureSearch

ENOUGH_MARGIN, ENOUGH_CLOSED = 1.5, 100
"""Limits of a poor search [C]. More candidates are drawn if the best margin is below the first number, or if
fewer than the second closed. The best are refined again while the margin is below the first number."""


class AimDraws:
    """Draws candidates of aims for one hand and one object.

    Args:
        search: The search.
        pincher: Draws pinches.
        mesh: The object.
        allowed: The surface that may be touched; ``None`` for all of it.
    """

    def __init__(
        self, search: ClosureSearch, pincher: Pincher, mesh: TriangleMesh, allowed: AllowedSurface | None
    ) -> None:
        self.search, self.pincher, self.mesh, self.allowed = search, pincher, mesh, allowed

    def region(self, aim: Aim) -> Region:
        """The part of the search space that an aim means."""
        numbers = range(2, len(self.search.hand.fingers) + 1)
        fingers = [n for n in numbers if min(n, MAX_FINGERS) in aim.fingers]
        return Region(
            planes=aim.planes,
            flips=aim.flips,
            values=list(aim.values) if len(aim.values) <= FEW_VALUES else None,
            fingers=fingers or None,
            box=self.allowed.box if self.allowed else None,
        )

    def grips(self, rng: np.random.Generator, aim: Aim, count: int) -> DrawnCandidates:
        """Draw fingertip grips: pinches where the object fits between fingers, else preshaped hands."""
        region = self.region(aim)
        pinching = self.pincher.draw(rng, int(PINCHED * count), region)
        half, rest = self.mesh.extents / 2, count - len(pinching)
        anywhere = draw_candidates(rng, self.search.pool, self.mesh.cog, half, rest, region)
        return concatenated(pinching, anywhere)

    def more(
        self, rng: np.random.Generator, aim: Aim, found: RankedCandidates, demand: Demand, times: int
    ) -> RankedCandidates:
        """Draw more, at most ``times`` times, while too few candidates close or the margin is too small."""
        settings = self.search.settings
        for _ in range(times):
            best = float(found.score[0]) if len(found) else 0.0
            enough = best * settings.strongest >= ENOUGH_MARGIN * settings.weight
            if enough and len(found) >= ENOUGH_CLOSED:
                break
            drawn = self.grips(rng, aim, 2 * settings.everywhere)
            found = merged(found, self.search.evaluate(self.search.half_clear(rng, drawn, found), demand))
        return found

    def wraps(self, rng: np.random.Generator, aim: Aim, count: int) -> DrawnCandidates:
        """Draw wraps whose open hand is clear of obstacles; see :meth:`ClosureSearch.draw_wraps`."""
        return self.search.draw_wraps(rng, self.mesh, count, self.region(aim), self.allowed)

    def any_wraps(self, rng: np.random.Generator, aim: Aim, count: int) -> DrawnCandidates:
        """Draw wraps, those in obstacles among them."""
        search, region = self.search, self.region(aim)
        return search.wrapper.draw(rng, search.pool, self.mesh, count, region, self.allowed)
