"""Results of a pick bench: the score, and every object."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ...types import value
from ..grasps import GraspSet, planned_set
from ..hand import PhysicsHand
from ..hold.report import numbers, poses, read_result, result_to_json
from ..measures import mean, wilson
from .protocol import FAILURES, Done, Motion, PickResult, PickStatus


@value
class PickScore:
    """Figures over the objects of a run.

    Attributes:
        objects: Number of objects.
        answered: Number of objects with a grasp to test.
        picked: Number of objects that were picked up.
        rate: Share of the answered objects that were picked up.
        interval: 95 % interval of this rate (Wilson).
        overall: Share of all objects that were picked up.
        overall_interval: 95 % interval of this share.
        causes: Number of objects for each cause of failure.
        done: Number of objects with which the task was done too; ``None`` if the run did not ask for it.
        done_rate: Share of the picked objects with which it was done.
        done_interval: 95 % interval of this share.
        held_displacement: Motion in the hand, mean over the objects that were picked up [m].
        held_rotation: Rotation in the hand, mean over the objects that were picked up [rad].
    """

    objects: int
    answered: int
    picked: int
    rate: float | None
    interval: tuple[float, float] | None
    overall: float | None
    overall_interval: tuple[float, float] | None
    causes: dict[str, int]
    done: int | None
    done_rate: float | None
    done_interval: tuple[float, float] | None
    held_displacement: float | None
    held_rotation: float | None


@value
class PickReport:
    """The results of a run, in the order of the objects.

    Attributes:
        results: Result of each object.
        hand: The hand that picked.
        seconds: Time of this run [s]; results that an earlier run saved do not count.
    """

    results: tuple[PickResult, ...]
    hand: PhysicsHand
    seconds: float

    def score(self) -> PickScore:
        """Figures over all objects."""
        total, answered = len(self.results), sum(r.answered for r in self.results)
        picked = sum(r.picked for r in self.results)
        done = sum(r.done for r in self.results) if any(r.job for r in self.results) else None
        held = [r.held for r in self.results if r.picked and r.held is not None]
        return PickScore(
            objects=total,
            answered=answered,
            picked=picked,
            rate=picked / answered if answered else None,
            interval=wilson(picked, answered),
            overall=picked / total if total else None,
            overall_interval=wilson(picked, total),
            causes={s.name.lower(): sum(r.status is s for r in self.results) for s in FAILURES},
            done=done,
            done_rate=done / picked if done is not None else None,
            done_interval=wilson(done, picked) if done is not None else None,
            held_displacement=mean(motion.displacement for motion in held),
            held_rotation=mean(motion.rotation for motion in held),
        )

    def failures(self) -> tuple[PickResult, ...]:
        """The objects that were not picked up, or with which the task was not done."""
        return tuple(result for result in self.results if not result.done)

    def to_json(self) -> dict[str, Any]:
        """The score and every object, as JSON values."""
        rows = [result_to_json(result) for result in self.results]
        return {
            "all": asdict(self.score()),
            "objects": [{k: v for k, v in row.items() if k != "planned"} for row in rows],
        }

    def planned_grasps(self) -> GraspSet:
        """The grasps of all answered objects, with each object at the origin."""
        rows = [result for result in self.results if result.answered]
        return planned_set(self.hand, rows)


def result_from_json(document: dict[str, Any]) -> PickResult:
    """A result of the pick test; see :func:`~preshape.physics.hold.report.read_result`."""

    def job(done: dict[str, Any]) -> Done:
        return Done(**done)

    motions = dict.fromkeys(("settled", "pushed", "held"), lambda motion: Motion(**motion))
    return read_result(
        document, PickResult, PickStatus, **motions, planned=poses, way_in=numbers, turn=numbers, job=job
    )
