"""The calibrated critic: how probably a grip picks its object up from a table (ENGINE §7).

A share of the friction, a reserve of the press and pushes from all sides are three safety factors that
multiply, so grips that hold are refused. Here they become one probability: a logistic model of the pick test
(docs/pick-test.md), fitted to grips of all margins by ``preshape bench critic``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from ..hiis.analyser import Grip
from ..kernels.margin.host import MarginKernel
from ..objects.mesh import TriangleMesh
from ..types import Array, BoolArray, value
from .demand import Demand
from .finish import ENOUGH
from .search import ClosureSearch

LIKELY = 0.9
"""Least probability of a grip that needs no reserve of friction to be good enough."""
WHOLE = 1.0
"""Share of the friction with which the pick test itself is done."""
LOW, HIGH = 1 / 16, 16.0
"""Margins outside this range count as its ends [C]: of margins this small nothing is left to tell apart, and
nothing is gained by larger ones."""
FLATTEST, TALL = 0.005, 0.05
"""Heights of objects outside this range count as its ends [m] [C]."""


@value
class PickModel:
    """Probability that a grip passes the pick test: a logistic model.

    Attributes:
        constant: Log odds of fingertips on a tall object whose margin with the whole friction is 1.
        margin: For each doubling of that margin.
        wrap: For a grip that holds with palm or several links of a finger.
        height: For each halving of the object's height above the table, from ``TALL`` on; with fingers so
            near to the table, less goes as planned.
    """

    constant: float
    margin: float
    wrap: float
    height: float

    @staticmethod
    def features(margin: Array, wrap: BoolArray, height: Array) -> Array:
        """(n, 4) what the four numbers of the model are multiplied by.

        Args:
            margin: (n,) margins with the whole friction.
            wrap: (n,) whether each is a wrap.
            height: (n,) heights of the objects [m].
        """
        doublings = np.log2(np.clip(margin, LOW, HIGH))
        halvings = -np.log2(np.clip(height, FLATTEST, TALL) / TALL)
        return np.column_stack([np.ones(len(margin)), doublings, wrap, halvings]).astype(np.float64)

    def probability(self, features: Array) -> Array:
        """(n,) probabilities of grips with these :meth:`features`."""
        told = features @ np.array([self.constant, self.margin, self.wrap, self.height])
        return np.asarray(1.0 / (1.0 + np.exp(-told)))


FITTED = PickModel(constant=2.337, margin=0.938, wrap=-1.54, height=-0.62)
"""The model of ``preshape bench critic`` [M]; docs/results.md has its data and how reliable it is."""


class PickCritic:
    """Judges finished grips of one object on a table by the probability that they pick it up.

    Args:
        search: The search that found them.
        height: Height of the object above the table [m].
    """

    def __init__(self, search: ClosureSearch, height: float) -> None:
        self.search, self.height = search, height
        self._holding: dict[float, list[tuple[float, MarginKernel]]] = {}
        self._cones: dict[float, tuple[Demand, MarginKernel | None]] = {}

    def with_odds(self, grips: Sequence[Grip], demand: Demand) -> list[Grip]:
        """The grips with their probabilities; those that were refused have none.

        Args:
            grips: Finished grips.
            demand: What the task asks.
        """
        n, wrap = len(grips), np.array([grip.whole_hand for grip in grips], dtype=bool)
        margin = self.margins(grips, demand, WHOLE).min(axis=1)
        told = FITTED.probability(PickModel.features(margin, wrap, np.full(n, self.height))).tolist()
        return [
            grip if grip.refused else replace(grip, pick_probability=p)
            for grip, p in zip(grips, told, strict=True)
        ]

    def with_more_friction(self, grips: Sequence[Grip], demand: Demand, bold_share: float) -> list[Grip]:
        """The grips that balance the load with more of the friction than usual, with the quality for that.

        Grips that balance it with the bold share, which leaves some reserve, are good enough, and so are
        those that balance it with the whole friction and are ``LIKELY`` to pick the object up. The quality of
        the others is below that in proportion to their probability. Each states its share and its margins.
        Likely ones with some reserve come first, then likely ones, then unlikely ones with some reserve, each
        by probability.

        Args:
            grips: Grips with their probabilities.
            demand: What the task asks.
            bold_share: The larger share of the friction.
        """
        found, left = list[Grip](), [grip for grip in grips if not grip.refused]
        for share in (bold_share, WHOLE):
            margins = self.margins(left, demand, share)
            balanced = margins.min(axis=1, initial=np.inf) >= 1.0
            found += [
                replace(
                    grip,
                    quality=ENOUGH if share < WHOLE else ENOUGH * min(1.0, odds(grip) / LIKELY),
                    task_margin=float(task),
                    hold_margin=float(hold),
                    friction_share=share,
                )
                for grip, (task, hold) in compress(zip(left, margins, strict=True), balanced)
            ]
            left = list(compress(left, ~balanced))
        return sorted(found, key=lambda g: (odds(g) < LIKELY, g.friction_share, -odds(g)))

    def margins(self, grips: Sequence[Grip], demand: Demand, share: float) -> Array:
        """(n, 2) loads along the task's cone and pushes that the squeezes balance, divided by the expected.

        Args:
            grips: Finished grips.
            demand: What the task asks.
            share: Share of the friction that may be used.
        """
        search, settings = self.search, self.search.settings
        if share not in self._holding:
            self._holding[share] = search.holding(share)
        if share not in self._cones or self._cones[share][0] is not demand:
            self._cones[share] = demand, search.cone(demand, share)
        cone, found = self._cones[share][1], np.zeros((len(grips), 2))
        for row, grip in enumerate(grips):
            points, normals = grip.contacts.points, grip.contacts.normals_in
            contacts = points[None], normals[None], np.array([len(points)])
            hold = math.inf
            for lever, kernel in self._holding[share]:
                hold = float(kernel.strengths(*contacts, lever, search.cog, most=hold)[0])
            task = hold / settings.hold
            if cone is not None:  # the squeeze's own press carries the weight
                base = np.asarray(demand.base) * settings.middling / grip.press
                unit = demand.unit(search.length)
                task = float(cone.strengths(*contacts, unit, search.cog, base=base)[0]) / demand.load
            found[row] = task, hold / settings.hold
            found[row] *= grip.press / settings.weight
        return found


def pick_critic(search: ClosureSearch, mesh: TriangleMesh) -> PickCritic | None:
    """The critic for an object on a table; ``None`` without one.

    Args:
        search: The search of the object's grips.
        mesh: The object.
    """
    tables = search.settings.obstacles.planes
    if not len(tables):
        return None
    return PickCritic(search, float((mesh.vertices @ tables[0, :3]).max() - tables[0, 3]))


def unlikely(grip: Grip) -> str:
    """What a grip lacks that is not likely enough to pick the object up; empty for others."""
    if grip.friction_share < WHOLE or not 0.0 < odds(grip) < LIKELY:
        return ""
    return (
        f"the best grip balances the load with all of the friction only, and {odds(grip):.2f} of grips like "
        f"it pick their object up in simulated physics, where {LIKELY:g} are asked; a lighter object "
        "(--mass), more friction (--friction) or another hand would help"
    )


def odds(grip: Grip) -> float:
    """The grip's probability; 0 if it has none."""
    return grip.pick_probability or 0.0
