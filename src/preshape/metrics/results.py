"""Results of the metrics: a number if it is defined, and a status that says why it is or is not."""

from __future__ import annotations

import enum

from ..types import Array, freeze, frozen_array, value


class MetricStatus(enum.Enum):
    """Whether a metric has a value; the members' values are sentences for the user."""

    OK = "The number is the value of the metric."
    NO_CONTACTS = "Nothing touches the object, so there is no grasp to measure."
    RANK_DEFICIENT = "The contacts cannot produce wrenches in some direction, whatever their forces."
    NOT_CLOSED = "The contacts reach every direction but cannot balance every wrench."
    LOAD_NOT_HELD = "The contacts cannot balance the load even before the task asks for anything."
    NO_MARGIN = "Some wrench of the task cannot be produced at all."
    NOT_CONVERGED = "The optimisation stopped before it was accurate, so there is no number."


@value
class Measure:
    """The value of a metric for one grasp.

    Attributes:
        number: Value of the metric; ``None`` if it is undefined.
        status: Whether the value is defined, and why not.
        lower: Lower bound of the exact value, if the metric gives one.
        upper: Upper bound of the exact value, if the metric gives one.
        worst: (6,) wrench or direction at which the value is reached (force; torque divided by ℓ), if there
            is one.
        per_wrench: (m,) value for each wrench or direction of the input, if there are several.
        forces: (m, n, 3) or (n, 3) contact forces that give the value, in the frame and unit of the input.
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
        """Whether the number is the value of the metric."""
        return self.status is MetricStatus.OK


@value
class ForceClosure:
    """Whether a grasp is force closed.

    Attributes:
        closed: Whether the contacts can balance every wrench; false with every status but ``OK``.
        status: Whether the grasp is closed, and why not.
        margin: Largest depth along the axes that all contact forces can have inside their cones while they
            balance one another; a share of the total normal force, 0..1/n; ``None`` if undefined.
    """

    closed: bool
    status: MetricStatus
    margin: float | None
