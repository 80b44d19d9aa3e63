"""Candidates of an aim: drawn in its planes, values, fingers and thumb sides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..hiis.analyser import MAX_FINGERS, Aim
from ..hiis.planes import APPROACH_AXES
from ..objects.mesh import TriangleMesh
from .candidates import DrawnCandidates, RankedCandidates, Region, concatenated, draw_candidates, merged
from .contact_places import AllowedSurface
from .demand import Demand
from .hand_pinches import hand_pinches
from .pinching import PINCHED, Pincher, antipodal_patches
from .recall import FEW_VALUES
from .search import LIFTED, ClosureSearch

ENOUGH_MARGIN, ENOUGH_CLOSED = 1.5, 100
"""Limits of a poor search [C]. More candidates are drawn if the best margin is below the first number, or if
fewer than the second closed. The best are refined again while the margin is below the first number."""

GRIP_DRAWS = 3
"""Largest number of fingertip grips drawn for each one wanted, where a table is in the way of some [C]."""

STEEP = 0.5
"""Least share of an approach axis along up or down for a plane from below or from above [C]."""


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
            planes=self._planes(aim),
            flips=aim.flips,
            values=list(aim.values) if len(aim.values) <= FEW_VALUES else None,
            fingers=fingers or None,
            box=self.allowed.box if self.allowed else None,
        )

    def _planes(self, aim: Aim) -> Sequence[int]:
        """The aim's planes; with a table none from below it, if there are others, and those from above more.

        Hardly a hand that comes in along a table is clear of it where the object is flat.
        """
        tables = self.search.settings.obstacles.planes
        if not len(tables):
            return aim.planes
        rises = APPROACH_AXES[np.asarray(aim.planes) - 1] @ tables[0, :3]
        level = [plane for plane, rise in zip(aim.planes, rises, strict=True) if abs(rise) <= STEEP]
        above = [plane for plane, rise in zip(aim.planes, rises, strict=True) if rise < -STEEP]
        times = max(1, len(level) // max(len(above), 1))
        return [*level, *times * above] or aim.planes

    def grips(self, rng: np.random.Generator, aim: Aim, count: int) -> DrawnCandidates:
        """Draw fingertip grips: pinches where the object fits between fingers, else preshaped hands.

        With a table, hands that reach into it by more than they could be lifted off are left out, if not all
        do, and up to ``GRIP_DRAWS`` times as many are drawn for that.
        """
        drawn = self._grips(rng, aim, count)
        if not len(self.search.settings.obstacles.planes) or not count:
            return drawn
        found: list[DrawnCandidates] = []
        for k in range(GRIP_DRAWS):
            more = self._grips(rng, aim, count) if k else drawn
            found.append(more.take(np.flatnonzero(self.search.blockers.liftable(more.candidates, LIFTED))))
            if sum(map(len, found)) >= count:
                break
        clear = concatenated(*found)
        return clear.take(rng.permutation(len(clear))[:count]) if len(clear) else drawn

    def _grips(self, rng: np.random.Generator, aim: Aim, count: int) -> DrawnCandidates:
        """Draw fingertip grips, those in obstacles among them."""
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


def aim_draws(search: ClosureSearch, mesh: TriangleMesh, allowed: AllowedSurface | None) -> AimDraws:
    """What draws candidates for a search, with the antipodal patches of the object.

    Args:
        search: The search.
        mesh: Its object.
        allowed: The surface that may be touched; ``None`` for all of it.
    """
    pinches, places = hand_pinches(search.hand), search.blockers.places
    tip = float(pinches.tip[0])
    patches = antipodal_patches(mesh, search.field, tip, pinches.widest, allowed=allowed, places=places)
    return AimDraws(
        search, Pincher(pinches, patches, mesh.cog, mesh.extents / 2, search.kernel), mesh, allowed
    )
