"""What every metric returns: a number that means something, or none, and a status that says why."""

from __future__ import annotations

import enum

from ..types import Array, freeze, frozen_array, value


class MetricStatus(enum.Enum):
    """How a metric came out; the values are sentences for the user."""

    OK = "The number is what its metric says."
    NO_CONTACTS = "Nothing touches the object, so there is no grasp to measure."
    RANK_DEFICIENT = "The contacts cannot produce wrenches in some direction, whatever their forces."
    NOT_CLOSED = "The contacts reach every direction but cannot balance every wrench."
    LOAD_NOT_HELD = "The contacts cannot balance the load even before the task asks for anything."
    NO_MARGIN = "Some wrench of the task cannot be produced at all."
    NOT_CONVERGED = "The optimisation stopped before it was accurate; there is no number."


@value
class Measure:
    """One number of a grasp.

    Attributes:
        number: the metric; ``None`` where the status leaves it undefined.
        status: why.
        lower: a bound that the exact value is not below, where the metric gives one.
        upper: a bound that the exact value is not above, where the metric gives one.
        worst: (6,) the wrench or direction that decided (force; torque over ℓ), where there is one.
        per_wrench: (m,) the number for each wrench asked for, where several were.
        forces: (m, n, 3) or (n, 3) contact forces behind it, in the frame and unit of the input.
    """

    number: float | None
    status: MetricStatus
    lower: float | None = None
    upper: float | None = None
    worst: Array | None = None
    per_wrench: Array | None = None
    forces: Array | None = None

    def __post_init__(self) -> None:
        for name in ("worst", "per_wrench", "forces"):
            array = getattr(self, name)
            if array is not None:
                freeze(self, **{name: frozen_array(array, (None,) * array.ndim, name)})

    @property
    def ok(self) -> bool:
        """Whether the number is what its metric says."""
        return self.status is MetricStatus.OK


@value
class ForceClosure:
    """Whether a grasp is force closed.

    Attributes:
        closed: whether the contacts can balance every wrench; false with every status but OK.
        status: why.
        margin: the largest share of the total normal force by which every contact can stay inside its cone
            along the axis while all contacts balance each other; 0..1/n, ``None`` where undefined.
    """

    closed: bool
    status: MetricStatus
    margin: float | None
