"""What meta control sets, and what the controller reports to it (§3.4, §3.6)."""

from __future__ import annotations

from dataclasses import field
from enum import Enum

from ..tasks import Task
from ..types import ContactCoefficients, value
from .analyser import Grasp
from .critic import Thresholds
from .estimator import Estimate
from .fuzzy import FuzzySets


class Status(Enum):
    """How a run ended."""

    ANSWER = "answer"
    CORRECTION = "task_correction"
    DEADLOCK = "deadlock"
    NO_GRASP = "no_grasp"

    @property
    def help(self) -> str:
        """What it means and what to do, one sentence."""
        return _HELP[self]


_HELP = {
    Status.ANSWER: "The preshape below matches the task.",
    Status.CORRECTION: "The object is known, but the task does not fit: ask for another, or teach this one.",
    Status.DEADLOCK: "No grasp that is good enough was found and recalled: ask for another task, or less.",
    Status.NO_GRASP: "Nothing that was tried holds it: allow other approaches or more room, or another size.",
}


@value
class Settings:
    """Meta control's settings.

    Attributes:
        thresholds: of the internal critic.
        sets: membership functions.
        coefficients: of the contact model.
        seed: of fresh network weights.
    """

    thresholds: Thresholds = field(default_factory=Thresholds)
    sets: FuzzySets = field(default_factory=FuzzySets)
    coefficients: ContactCoefficients = field(default_factory=ContactCoefficients)
    seed: int = 0


@value
class Transition:
    """One step of the state machine.

    Attributes:
        mode: 0..3.
        outcome: ``reward``, ``penalty``, ``known``, ``unknown``, ``explored``, ``learned``,
            ``no grasp`` or ``deadlock``.
        reason: one sentence.
    """

    mode: int
    outcome: str
    reason: str


@value
class Offer:
    """A task that does fit, offered in place of one that does not (mode 2).

    Attributes:
        task: the task.
        match: TFVADI that it reaches.
        mode: the mode that would answer it, 0 or 1.
        distance: from the task asked for, Euclidean between the two Q.
    """

    task: Task
    match: float
    mode: int
    distance: float


@value
class Decision:
    """The controller's report.

    Attributes:
        status: how it ended.
        reason: the last transition's.
        mode: the execution mode it ended in, 0..3.
        task: what was asked.
        grasp: the answer; ``None`` without one.
        best: the answer, or the best grasp found where that was not good enough.
        alternatives: further answers, best first.
        offers: tasks that fit, nearest first (mode 2).
        transitions: every step with its reason.
        estimate: what the estimator said; ``None`` after mode 3.
    """

    status: Status
    reason: str
    mode: int
    task: Task
    grasp: Grasp | None
    best: Grasp | None
    alternatives: tuple[Grasp, ...]
    offers: tuple[Offer, ...]
    transitions: tuple[Transition, ...]
    estimate: Estimate | None

    @property
    def deadlock(self) -> bool:
        """Whether the controller waits for a reset."""
        return self.status is Status.DEADLOCK


def decided(
    task: Task,
    mode: int,
    status: Status,
    steps: list[Transition],
    estimate: Estimate | None,
    *,
    grasp: Grasp | None = None,
    best: Grasp | None = None,
    alternatives: tuple[Grasp, ...] = (),
    offers: tuple[Offer, ...] = (),
) -> Decision:
    """How a run ended, with the last step's reason."""
    return Decision(
        status=status,
        reason=steps[-1].reason,
        mode=mode,
        task=task,
        grasp=grasp,
        best=best or grasp,
        alternatives=alternatives,
        offers=offers,
        transitions=tuple(steps),
        estimate=estimate,
    )
