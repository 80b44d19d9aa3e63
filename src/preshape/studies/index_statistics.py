"""How well a number sorts successes from failures: areas under the ROC curve, intervals, calibration.

The area (AUC) is the share of pairs of one success and one failure in which the success has the larger
number, ties counting half: the statistic of Mann and Whitney (1947). Its variance, and that of the difference
of two areas over the same grasps, is DeLong's (1988). Grasps of one object succeed or fail together more
often than grasps of different ones, so a number that only tells easy objects from hard ones has a high area
over all of them. The area *within objects* compares only grasps of the same hand on the same object; its
interval is a bootstrap over objects and says how the figure would vary with other objects.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..exceptions import InputError
from ..physics.measures import wilson
from ..types import Array, BoolArray, IntArray, value

Z = 1.959964
"""Of 95 %."""
DRAWS = 4000
"""Of the bootstrap."""
FEWEST_OBJECTS = 5
"""With fewer objects the bootstrap over objects says nothing."""


@value
class Area:
    """An area under the ROC curve.

    Attributes:
        area: 0..1; 0.5 is no better than chance. ``None`` where there are not both successes and failures.
        interval: 95 %; ``None`` where there are too few to say.
        successes: grasps, or groups' grasps, that succeeded.
        failures: … that did not.
    """

    area: float | None
    interval: tuple[float, float] | None
    successes: int
    failures: int


@value
class Difference:
    """How much larger the area of one number is than that of another over the same grasps.

    Attributes:
        difference: of the areas; ``None`` where there are none.
        interval: 95 %; ``None`` where there are too few to say.
        p: that a difference as large comes of chance alone, two-sided; ``None`` with the interval.
    """

    difference: float | None
    interval: tuple[float, float] | None
    p: float | None


@value
class Bin:
    """Grasps of neighbouring numbers.

    Attributes:
        low: smallest number; minus infinity for an undefined one.
        high: largest.
        count: grasps.
        successes: of them.
        interval: of the rate, 95 % (Wilson).
    """

    low: float
    high: float
    count: int
    successes: int
    interval: tuple[float, float]

    @property
    def rate(self) -> float:
        """Share that succeeded."""
        return self.successes / self.count


def _checked(scores: Array, passed: BoolArray) -> tuple[Array, BoolArray]:
    x, y = np.asarray(scores, dtype=np.float64), np.asarray(passed)
    if x.ndim != 1 or y.shape != x.shape or y.dtype != np.bool_:
        raise InputError(
            f"an area needs as many numbers as verdicts (true or false), got {x.shape} and {y.shape}"
        )
    if np.isnan(x).any():
        raise InputError("an area cannot be computed from numbers that are nan; leave those grasps out")
    return x, y


def placements(scores: Array, passed: BoolArray) -> tuple[Array, Array]:
    """For each success the share of failures below it, for each failure the share of successes above it.

    Ties count half. Both have the area as their mean.

    Args:
        scores: (n,) numbers, infinite ones too; more is better.
        passed: (n,) verdicts.

    Returns:
        (successes,) and (failures,).
    """
    from scipy.stats import rankdata

    x, y = _checked(scores, passed)
    good, bad = x[y], x[~y]
    if not len(good) or not len(bad):
        return np.zeros(0), np.zeros(0)
    ranks = rankdata(x)  # infinite numbers have ranks like any other
    above = (ranks[y] - rankdata(good)) / len(bad)
    below = 1.0 - (ranks[~y] - rankdata(bad)) / len(good)
    return above, below


def area(scores: Array, passed: BoolArray) -> Area:
    """The area over all grasps, with DeLong's interval on the logit scale.

    Where one number sorts perfectly DeLong's variance is zero; the interval is then the score interval of
    Newcombe (2006, method 5), which has a width.

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
    """The areas θ from which ``found`` is no farther than Z standard deviations, by Newcombe's variance."""
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


def difference(first: Array, second: Array, passed: BoolArray) -> Difference:
    """Area of ``first`` minus area of ``second``, with DeLong's paired interval.

    Args:
        first: (n,) numbers; more is better.
        second: (n,) other numbers of the same grasps.
        passed: (n,) verdicts.
    """
    from scipy.stats import norm

    above_1, below_1 = placements(first, passed)
    above_2, below_2 = placements(second, passed)
    if not len(above_1):
        return Difference(difference=None, interval=None, p=None)
    found = float(above_1.mean() - above_2.mean())
    if min(len(above_1), len(below_1)) < 2:
        return Difference(difference=found, interval=None, p=None)
    variance = (above_1 - above_2).var(ddof=1) / len(above_1) + (below_1 - below_2).var(ddof=1) / len(below_1)
    deviation = float(np.sqrt(variance))
    if deviation == 0:
        return Difference(difference=found, interval=None, p=None)
    return Difference(
        difference=found,
        interval=(found - Z * deviation, found + Z * deviation),
        p=float(2 * norm.sf(abs(found) / deviation)),
    )


def within(
    scores: Array, passed: BoolArray, groups: Sequence[str], objects: Sequence[str], *, seed: int = 0
) -> Area:
    """The mean area over groups, grasps compared within their group only, and a bootstrap over objects.

    A group of s successes and f failures has the weight s·f/(s + f), about the inverse of its variance.

    Args:
        scores: (n,) numbers; more is better.
        passed: (n,) verdicts.
        groups: (n,) what must be the same for two grasps to be compared: hand and object.
        objects: (n,) what is drawn anew by the bootstrap.
        seed: of the bootstrap.
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
    groups: Sequence[str],
    objects: Sequence[str],
    *,
    seed: int = 0,
) -> Difference:
    """As :func:`difference`, within objects: the same bootstrap draws serve both numbers."""
    found, draws, _ = _within((first, second), passed, groups, objects, seed)
    if not found:
        return Difference(difference=None, interval=None, p=None)
    if draws is None:
        return Difference(difference=found[0] - found[1], interval=None, p=None)
    gap = draws[0] - draws[1]
    beyond = min(float((gap <= 0).mean()), float((gap >= 0).mean()))
    return Difference(
        difference=found[0] - found[1],
        interval=_percentiles(gap),
        # A bootstrap of this many draws cannot tell a smaller chance from none.
        p=min(1.0, max(2 * beyond, 2 / DRAWS)),
    )


def _within(
    scores: tuple[Array, ...],
    passed: BoolArray,
    groups: Sequence[str],
    objects: Sequence[str],
    seed: int,
) -> tuple[list[float], Array | None, BoolArray]:
    """Mean areas, (numbers, draws) of the bootstrap, and which grasps are in a group with both verdicts."""
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
        share = good * bad / (good + bad)
        at = int(np.searchsorted(names, of_object[rows][0]))
        weight[at] += share
        for k, numbers in enumerate(scores):
            total[k, at] += share * placements(np.asarray(numbers)[rows], y[rows])[0].mean()
    if not weight.any():
        return [], None, used
    found = [float(x) for x in total.sum(axis=1) / weight.sum()]
    there = weight > 0
    if there.sum() < FEWEST_OBJECTS:
        return found, None, used
    m = int(there.sum())
    drawn: IntArray = np.random.default_rng(seed).multinomial(m, np.full(m, 1 / m), size=DRAWS)
    return found, (total[:, there] @ drawn.T) / (weight[there] @ drawn.T), used


def _percentiles(draws: Array) -> tuple[float, float]:
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(low), float(high)


def calibration(scores: Array, passed: BoolArray, bins: int = 10) -> tuple[Bin, ...]:
    """Rate of success by tenths of the number, worst first.

    Equal numbers stay together, so that a number which is often the same, as the epsilon of grasps that are
    not closed, gives fewer and larger bins.

    Args:
        scores: (n,) numbers; more is better.
        passed: (n,) verdicts.
        bins: how many, at most.
    """
    x, y = _checked(scores, passed)
    if bins < 1:
        raise InputError(f"the bins must be 1 or more, got {bins}")
    values, where = np.unique(x, return_inverse=True)
    counts = np.bincount(where, minlength=len(values))
    middle = np.cumsum(counts) - (counts + 1) / 2  # mean rank of each number, from 0
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
