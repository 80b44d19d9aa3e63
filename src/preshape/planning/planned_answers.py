"""This program's planner as one that answers the task benchmark's instances."""

from __future__ import annotations

import hashlib

from .._version import __version__
from ..exceptions import PreshapeError
from ..hands.hand import Hand
from ..physics.hand import PhysicsHand
from ..physics.task.grasps import HandPoses
from ..physics.task.instances import TaskInstance
from ..planner import plan
from ..types import value
from .grasp_sets import palm_grasps, poses_of


@value
class PlannedAnswers:
    """The first answer of this program's planner, each instance with a fresh memory.

    Attributes:
        hand: The hand.
        analyser: ``rays`` or ``closure``; ``None`` for the hand's own.
        model: the hand in physics.
    """

    hand: Hand
    analyser: str | None
    model: PhysicsHand

    @property
    def planned(self) -> bool:
        """The poses are made here."""
        return True

    @property
    def digest(self) -> str:
        """Hash of hand, analyser and this version."""
        return hashlib.sha256(repr((self.hand.name, self.analyser, __version__)).encode()).hexdigest()

    def answer(self, row: int, instance: TaskInstance) -> HandPoses | str:
        """Plan, and take the hand's poses; object at the origin."""
        try:
            made = plan(
                instance.object_name,
                instance.task,
                hand=self.hand,
                analyser=self.analyser,
                scale=instance.scale,
                memory=":memory:",
                seed=instance.seed,
            )
        except PreshapeError as error:
            return str(error)
        result = made.hand_result
        if result is None:
            return made.decision.reason
        if result.pregrasp is None or result.grasp is None or result.squeeze is None:
            return f"the hand does not reach the grasp: {result.reason}"
        one = palm_grasps(self.model, [instance.object_name], [instance.scale], poses_of([result]))
        return HandPoses.of(one.for_hand(self.model), 0)
