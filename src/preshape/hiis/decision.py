"""Settings of the controller, and its report (§3.4, §3.6)."""

from __future__ import annotations

import logging
from dataclasses import field
from enum import Enum

from ..tasks import Task
from ..types import ContactCoefficients, an_instance, freeze, one_of, value, whole_number
from .analyser import FINGER_RULES, Exploration, FingerRule, Grasp, Grip
from .critic import Thresholds, judge
from .estimator import Estimate
from .fuzzy import FuzzySets

_log = logging.getLogger("preshape.modes")


class Status(Enum):
    """How a run ended."""

    ANSWER = "answer"
    CORRECTION = "task_correction"
    DEADLOCK = "deadlock"
    NO_GRASP = "no_grasp"

    @property
    def help(self) -> str:
        """What the status means and what to do, in one sentence."""
        return _HELP[self]


_HELP = {
    Status.ANSWER: "The preshape below matches the task.",
    Status.CORRECTION: "The object is known, but this task does not fit it.",
    Status.DEADLOCK: "No grasp is good enough for this task: ask for another task, or for less.",
    Status.NO_GRASP: "No grasp was found; the reason says what would help.",
}


@value
class Settings:
    """Meta control's settings.

    Attributes:
        thresholds: Thresholds of the internal critic.
        sets: Membership functions.
        coefficients: Coefficients of the contact model.
        seed: Seed of fresh network weights and of the analysers.
        finger_rule: Virtual fingers that the search for virtual grasps may use: ``up_to`` as many as fit, or
            ``all`` that fit.

    Raises:
        InputError: A part is of another type, the seed is no whole number of 0 or more, or there is no such
            finger rule.
    """

    thresholds: Thresholds = field(default_factory=Thresholds)
    sets: FuzzySets = field(default_factory=FuzzySets)
    coefficients: ContactCoefficients = field(default_factory=ContactCoefficients)
    seed: int = 0
    finger_rule: FingerRule = "up_to"

    def __post_init__(self) -> None:
        an_instance(self.thresholds, Thresholds, "thresholds of the settings")
        an_instance(self.sets, FuzzySets, "sets of the settings")
        an_instance(self.coefficients, ContactCoefficients, "coefficients of the settings")
        one_of(self.finger_rule, "finger rule", FINGER_RULES)
        freeze(self, seed=whole_number(self.seed, "seed", 0))


@value
class Transition:
    """One step of the state machine.

    Attributes:
        mode: Execution mode, 0..3.
        outcome: ``reward``, ``penalty``, ``known``, ``unknown``, ``explored``, ``learned``,
            ``no grasp`` or ``deadlock``.
        reason: One sentence.
    """

    mode: int
    outcome: str
    reason: str


def reached(mode: int, outcome: str, reason: str) -> Transition:
    """A step of the state machine, which is also logged."""
    _log.info("mode %d, %s: %s", mode, outcome, reason)
    return Transition(mode=mode, outcome=outcome, reason=reason)


@value
class Offer:
    """A task that some grasp fits, offered in place of the requested task (mode 2).

    Attributes:
        task: The task.
        match: TFVADI or quality that its grasp reaches.
        mode: The mode that would answer it, 0 or 1.
        distance: Euclidean distance of its Q from the Q of the requested task.
    """

    task: Task
    match: float
    mode: int
    distance: float


@value
class Decision:
    """The controller's report.

    Attributes:
        status: How the run ended.
        reason: Reason of the last transition.
        mode: Execution mode in which the run ended, 0..3.
        task: The requested task.
        grasp: The answer; ``None`` without one.
        best: The answer; without an answer, the best grasp found, which is not good enough.
        alternatives: Further answers, best first.
        offers: Tasks that some grasp fits, nearest to the requested task first (task correction).
        transitions: Every step with its reason.
        estimate: The estimator's estimate; ``None`` after mode 3.
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


def different_answers(first: Grasp, found: Exploration, count: int, threshold: float) -> tuple[Grasp, ...]:
    """The best other answers that differ from each other and from the first (:meth:`Grasp.same_as`).

    If wraps and fingertip grips are good enough, both are among the answers: the best of the other kind takes
    the last place.

    Args:
        first: The answer.
        found: All grasps that were found, best first.
        count: Largest number of other answers.
        threshold: Score that an answer must reach.
    """
    answers = [first]
    for i in range(len(found)):
        if not judge(float(found.match[i]), threshold).reward:
            break
        other = found.grasp(i)
        if len(answers) > count and any(_whole_hand(other) == _whole_hand(one) for one in answers):
            continue
        if not any(other.same_as(answer) for answer in answers):
            answers[count:] = [other]
    return tuple(answers[1:])


def _whole_hand(grasp: Grasp) -> bool:
    return isinstance(grasp, Grip) and grasp.whole_hand


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
    """The report of a run; its reason is the reason of the last step."""
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
