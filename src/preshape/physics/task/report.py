"""Results of a run of the task benchmark: the score of each task family and object, and every instance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from ...tasks import FAMILIES
from ...types import value
from ..grasps import GraspSet, planned_set
from ..hand import PhysicsHand
from ..hold.report import poses, read_result, result_to_json
from ..measures import mean, wilson
from .instances import TaskInstance
from .protocol import TaskResult, TaskStatus


@value
class TaskScore:
    """Figures over a set of instances.

    Attributes:
        instances: Number of instances.
        passed: Number of instances that passed.
        rate: Share of all instances that passed; an instance without an answer counts as a failure.
        interval: 95 % interval of the rate (Wilson).
        answered: Number of instances with a grasp to test.
        no_answer: Number of instances without an answer.
        lost: Number of instances in which the object was lost.
        penetrating: Number of instances whose pregrasp penetrates the object or the hand too deeply.
        unstable: Number of instances whose simulation became unstable.
        invalid: Number of instances that could not be tested.
        displacement: Largest distance from the path [m], mean over the instances that passed.
        rotation: Largest angle from the path [rad], mean over the instances that passed.
    """

    instances: int
    passed: int
    rate: float | None
    interval: tuple[float, float] | None
    answered: int
    no_answer: int
    lost: int
    penetrating: int
    unstable: int
    invalid: int
    displacement: float | None
    rotation: float | None


@value
class TaskReport:
    """The results of a run, in the order of the instances.

    Attributes:
        instances: The instances.
        results: Result of each instance.
        hand: The hand.
        seconds: Time of this run [s]; results that an earlier run saved do not count.
    """

    instances: tuple[TaskInstance, ...]
    results: tuple[TaskResult, ...]
    hand: PhysicsHand
    seconds: float

    def score(self, which: Callable[[TaskResult], bool] = lambda _: True) -> TaskScore:
        """Figures over the results for which ``which`` is true."""
        rows = [result for result in self.results if which(result)]
        count = {status: sum(r.status is status for r in rows) for status in TaskStatus}
        passed = count[TaskStatus.DONE]
        done = [r for r in rows if r.passed]
        return TaskScore(
            instances=len(rows),
            passed=passed,
            rate=passed / len(rows) if rows else None,
            interval=wilson(passed, len(rows)),
            answered=len(rows) - count[TaskStatus.NO_ANSWER] - count[TaskStatus.INVALID],
            no_answer=count[TaskStatus.NO_ANSWER],
            lost=count[TaskStatus.LOST],
            penetrating=count[TaskStatus.PENETRATES],
            unstable=count[TaskStatus.UNSTABLE],
            invalid=count[TaskStatus.INVALID],
            displacement=mean(r.displacement for r in done if r.displacement is not None),
            rotation=mean(r.rotation for r in done if r.rotation is not None),
        )

    def families(self) -> dict[str, TaskScore]:
        """The score of each task family."""
        found = {result.family for result in self.results}
        names = [*(name for name in FAMILIES if name in found), *sorted(found - set(FAMILIES))]
        return {name: self.score(lambda r, n=name: r.family == n) for name in names}  # type: ignore[misc]

    def objects(self) -> dict[str, TaskScore]:
        """The score of each object."""
        names = dict.fromkeys(result.object_name for result in self.results)
        return {name: self.score(lambda r, n=name: r.object_name == n) for name in names}  # type: ignore[misc]

    def failures(self) -> tuple[TaskResult, ...]:
        """The instances that did not pass."""
        return tuple(result for result in self.results if not result.passed)

    def to_json(self) -> dict[str, Any]:
        """Scores over all instances and for each family and object, and every instance, as JSON values."""
        rows = [result_to_json(result) for result in self.results]
        return {
            "all": asdict(self.score()),
            "families": {name: asdict(score) for name, score in self.families().items()},
            "objects": {name: asdict(score) for name, score in self.objects().items()},
            "instances": [{k: v for k, v in row.items() if k != "planned"} for row in rows],
        }

    def planned_grasps(self) -> tuple[GraspSet, tuple[str, ...]]:
        """The grasps that this program planned, and their tasks; a test of these gives the same scores."""
        rows = [result for result in self.results if result.planned is not None]
        return planned_set(self.hand, rows), tuple(result.task for result in rows)


def result_from_json(document: dict[str, Any]) -> TaskResult:
    """A result of the task test; see :func:`~preshape.physics.hold.report.read_result`."""
    return read_result(document, TaskResult, TaskStatus, planned=poses)
