"""Statistics of a score that predicts success: areas under the ROC curve, their intervals, and calibration.

Take all pairs of one success and one failure. The area (AUC) is the share of pairs in which the success has
the larger score; a tie counts half (Mann and Whitney 1947). The variance of an area, and of the difference of
two areas over the same grasps, is that of DeLong (1988).

Grasps on one object succeed or fail together more often than grasps on different objects. A score that only
distinguishes easy objects from hard ones therefore has a large area over all grasps. The area *within
objects* compares only grasps of the same hand on the same object. Its interval is a bootstrap over objects
and shows how much the area would vary with other objects.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import InputError
from ..physics.measures import wilson
from ..types import Array, BoolArray, IntArray, value

Z = 1.959964
"""Quantile of the normal distribution for two-sided intervals of 95 %."""
DRAWS = 4000
"""Number of bootstrap draws."""
MIN_OBJECTS = 5
"""Smallest number of objects for the bootstrap over objects; with fewer there is no interval."""


@value
class Area:
    """An area under the ROC curve.

    Attributes:
        area: The area, 0..1; 0.5 is chance. ``None`` unless there are both successes and failures.
        interval: 95 % interval; ``None`` if there are too few grasps or objects.
        successes: Number of grasps that succeeded.
        failures: Number of grasps that failed.
    """

    area: float | None
    interval: tuple[float, float] | None
    successes: int
    failures: int


@value
class AreaDifference:
    """Difference of the areas of two scores over the same grasps.

    Attributes:
        difference: First area minus second area; ``None`` if an area is missing.
        interval: 95 % interval; ``None`` if there are too few grasps or objects.
        p: Two-sided p-value for "no difference"; ``None`` without an interval.
    """

    difference: float | None
    interval: tuple[float, float] | None
    p: float | None


@value
class Bin:
    """Grasps with neighbouring scores.

    Attributes:
        low: Smallest score; minus infinity if it is undefined.
        high: Largest score.
        count: Number of grasps.
        successes: Number of grasps that succeeded.
        interval: 95 % interval of the success rate (Wilson).
    """

    low: float
    high: float
    count: int
    successes: int
    interval: tuple[float, float]

    @property
    def rate(self) -> float:
        """Share of the grasps that succeeded."""
        return self.successes / self.count


def _checked(scores: Array, passed: BoolArray) -> tuple[Array, BoolArray]:
    x, y = np.asarray(scores, dtype=np.float64), np.asarray(passed)
    if x.ndim != 1 or y.shape != x.shape or y.dtype != np.bool_:
        raise InputError(
            f"scores and verdicts (true or false) must be as many, got {x.shape} and {y.shape} {y.dtype}"
        )
    if np.isnan(x).any():
        raise InputError("a score must not be nan; leave those grasps out")
    return x, y


def placements(scores: Array, passed: BoolArray) -> tuple[Array, Array]:
    """For each success the share of failures below it; for each failure the share of successes above it.

    Ties count half. The mean of either array is the area.

    Args:
        scores: (n,) Scores, which may be infinite; larger is better.
        passed: (n,) Whether each grasp succeeded.

    Returns:
        Arrays (successes,) and (failures,).
    """
    from scipy.stats import rankdata

    x, y = _checked(scores, passed)
    good, bad = x[y], x[~y]
    if not len(good) or not len(bad):
        return np.zeros(0), np.zeros(0)
    ranks = rankdata(x)  # infinite scores are ranked like any other
    above = (ranks[y] - rankdata(good)) / len(bad)
    below = 1.0 - (ranks[~y] - rankdata(bad)) / len(good)
    return above, below


def area(scores: Array, passed: BoolArray) -> Area:
    """The area over all grasps, with DeLong's interval on the logit scale.

    If the score separates successes and failures perfectly, DeLong's variance is zero. The interval is then
    the score interval of Newcombe (2006, method 5), which is not empty.

    >>> area(np.array([1.0, 2.0, 3.0, 4.0]), np.array([False, True, False, True])).area
    0.75
    """
    above, below = placements(scores, passed)
    successes = int(np.sum(passed))
    failures = len(passed) - successes
    if not len(above):
        return Area(area=None, interval=None, successes=successes, failures=failures)
    found = float(above.mean())
    interval = None
    if min(successes, failures) > 1:
        deviation = float(np.sqrt(above.var(ddof=1) / successes + below.var(ddof=1) / failures))
        if deviation > 0 and 0 < found < 1:
            interval = _logit_interval(found, deviation)
        else:
            interval = _score_interval(found, successes, failures)
    return Area(area=found, interval=interval, successes=successes, failures=failures)


def _logit_interval(found: float, deviation: float) -> tuple[float, float]:
    middle, half = np.log(found / (1 - found)), Z * deviation / (found * (1 - found))
    low, high = 1 / (1 + np.exp(-(middle + np.array([-half, half]))))
    return float(low), float(high)


def _score_interval(found: float, successes: int, failures: int) -> tuple[float, float]:
    """All areas θ at most Z standard deviations from ``found``, with Newcombe's variance."""
    from scipy.optimize import brentq

    n = (successes + failures) / 2 - 1

    def off(theta: float) -> float:
        spread = 1 + n * (1 - theta) / (2 - theta) + n * theta / (1 + theta)
        variance = theta * (1 - theta) * spread / (successes * failures)
        return float((found - theta) ** 2 - Z * Z * variance)

    tiny = 1e-12
    low = 0.0 if found <= tiny else float(brentq(off, tiny, found - tiny))
    high = 1.0 if found >= 1 - tiny else float(brentq(off, found + tiny, 1 - tiny))
    return low, high


def difference(first: Array, second: Array, passed: BoolArray) -> AreaDifference:
    """Area of ``first`` minus area of ``second``, with DeLong's paired interval.

    Args:
        first: (n,) Scores; larger is better.
        second: (n,) Other scores of the same grasps.
        passed: (n,) Whether each grasp succeeded.
    """
    from scipy.stats import norm

    above_1, below_1 = placements(first, passed)
    above_2, below_2 = placements(second, passed)
    if not len(above_1):
        return AreaDifference(difference=None, interval=None, p=None)
    found, deviation = float(above_1.mean() - above_2.mean()), 0.0
    if min(len(above_1), len(below_1)) > 1:
        above, below = above_1 - above_2, below_1 - below_2
        deviation = float(np.sqrt(above.var(ddof=1) / len(above) + below.var(ddof=1) / len(below)))
    if deviation == 0:
        return AreaDifference(difference=found, interval=None, p=None)
    return AreaDifference(
        difference=found,
        interval=(found - Z * deviation, found + Z * deviation),
        p=float(2 * norm.sf(abs(found) / deviation)),
    )


def within(scores: Array, passed: BoolArray, groups: ArrayLike, objects: ArrayLike, *, seed: int = 0) -> Area:
    """The weighted mean of the areas of groups; only grasps of the same group are compared.

    A group with s successes and f failures has the weight s·f/(s + f), about the inverse of its variance. The
    interval is a bootstrap over objects.

    Args:
        scores: (n,) Scores; larger is better.
        passed: (n,) Whether each grasp succeeded.
        groups: (n,) Group of each grasp: its hand and object.
        objects: (n,) Object of each grasp; the bootstrap draws whole objects.
        seed: Seed of the bootstrap.
    """
    found, draws, used = _within((scores,), passed, groups, objects, seed)
    good = int(np.sum(np.asarray(passed)[used]))
    return Area(
        area=found[0] if found else None,
        interval=None if draws is None else _percentiles(draws[0]),
        successes=good,
        failures=int(used.sum()) - good,
    )


def within_difference(
    first: Array,
    second: Array,
    passed: BoolArray,
    groups: ArrayLike,
    objects: ArrayLike,
    *,
    seed: int = 0,
) -> AreaDifference:
    """Like :func:`difference`, but within objects; both scores use the same bootstrap draws."""
    found, draws, _ = _within((first, second), passed, groups, objects, seed)
    if not found:
        return AreaDifference(difference=None, interval=None, p=None)
    if draws is None:
        return AreaDifference(difference=found[0] - found[1], interval=None, p=None)
    gap = draws[0] - draws[1]
    beyond = min(float((gap <= 0).mean()), float((gap >= 0).mean()))
    return AreaDifference(
        difference=found[0] - found[1],
        interval=_percentiles(gap),
        # This many draws cannot show a smaller p-value.
        p=min(1.0, max(2 * beyond, 2 / DRAWS)),
    )


def _within(
    scores: tuple[Array, ...],
    passed: BoolArray,
    groups: ArrayLike,
    objects: ArrayLike,
    seed: int,
) -> tuple[list[float], Array | None, BoolArray]:
    """Mean area of each score, its areas (scores, draws) in the bootstrap, and which grasps were used.

    A grasp is used if its group has both successes and failures.
    """
    y, of_group, of_object = np.asarray(passed), np.asarray(groups), np.asarray(objects)
    names = np.unique(of_object)
    weight = np.zeros(len(names))
    total = np.zeros((len(scores), len(names)))
    used = np.zeros(len(y), dtype=bool)
    for group in np.unique(of_group):
        rows = of_group == group
        good = int(y[rows].sum())
        bad = int(rows.sum()) - good
        if not good or not bad:
            continue
        used |= rows
        group_weight = good * bad / (good + bad)
        at = int(np.searchsorted(names, of_object[rows][0]))
        weight[at] += group_weight
        for k, one in enumerate(scores):
            total[k, at] += group_weight * placements(np.asarray(one)[rows], y[rows])[0].mean()
    if not weight.any():
        return [], None, used
    found = [float(x) for x in total.sum(axis=1) / weight.sum()]
    counted = weight > 0
    m = int(counted.sum())
    if m < MIN_OBJECTS:
        return found, None, used
    drawn: IntArray = np.random.default_rng(seed).multinomial(m, np.full(m, 1 / m), size=DRAWS)
    return found, (total[:, counted] @ drawn.T) / (weight[counted] @ drawn.T), used


def _percentiles(draws: Array) -> tuple[float, float]:
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(low), float(high)


def calibration(scores: Array, passed: BoolArray, bins: int = 10) -> tuple[Bin, ...]:
    """Success rate by tenths of the score, lowest scores first.

    Grasps with the same score are in the same bin. A score with many equal values, such as the epsilon of
    grasps without force closure, therefore gives fewer and larger bins.

    Args:
        scores: (n,) Scores; larger is better.
        passed: (n,) Whether each grasp succeeded.
        bins: Largest number of bins.
    """
    x, y = _checked(scores, passed)
    if bins < 1:
        raise InputError(f"the number of bins must be 1 or more, got {bins}")
    values, where = np.unique(x, return_inverse=True)
    counts = np.bincount(where, minlength=len(values))
    middle = np.cumsum(counts) - (counts + 1) / 2  # mean rank of each score, from 0
    label = np.minimum((middle * bins / max(len(x), 1)).astype(int), bins - 1)
    out = []
    for k in np.unique(label):
        rows = label[where] == k
        successes, count = int(y[rows].sum()), int(rows.sum())
        interval = wilson(successes, count)
        assert interval is not None
        out.append(
            Bin(
                low=float(x[rows].min()),
                high=float(x[rows].max()),
                count=count,
                successes=successes,
                interval=interval,
            )
        )
    return tuple(out)
