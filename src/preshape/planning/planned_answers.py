"""This program's planner as a source of answers for the task benchmark."""

from __future__ import annotations

import hashlib

from .._version import __version__
from ..exceptions import PreshapeError
from ..hands.hand import Hand
from ..hiis.decision import Settings
from ..physics.grasps import HandPoses
from ..physics.hand import PhysicsHand
from ..physics.task.instances import TaskInstance
from ..types import FIELD_MASS, value
from .grasp_sets import palm_grasps, poses_of
from .request import PlanRequest
from .session import Session


@value
class PlannedAnswers:
    """The planner's first answer to each instance; each instance is planned with a fresh memory.

    Attributes:
        hand: The hand.
        analyser: ``rays`` or ``closure``.
        model: Physics model of the hand.
        mass: Mass of every object [kg]; the ray analyser ignores it.
    """

    hand: Hand
    analyser: str
    model: PhysicsHand
    mass: float = FIELD_MASS

    @property
    def planned(self) -> bool:
        """True: the poses are planned by this program; see :class:`~preshape.physics.task.grasps.Answers`."""
        return True

    @property
    def digest(self) -> str:
        """Hash of hand, analyser, mass and the program's version."""
        decides = (self.hand.name, self.analyser, self.mass, __version__)
        return hashlib.sha256(repr(decides).encode()).hexdigest()

    def answer(self, row: int, instance: TaskInstance) -> HandPoses | str:
        """The poses of the planned answer, with the object at the origin, or why there are none."""
        try:
            request = PlanRequest(
                source=instance.object_name,
                task=instance.task,
                hand=self.hand,
                analyser=self.analyser,
                scale=instance.scale,
                mass=self.mass if self.analyser == "closure" else None,
                settings=Settings(seed=instance.seed),
            )
            with Session(":memory:") as session:
                made = session.run(request)
        except PreshapeError as error:
            return str(error)
        result = made.hand_result
        if result is None:
            return made.decision.reason
        if result.pregrasp is None or result.grasp is None or result.squeeze is None:
            return f"the hand does not reach the grasp: {result.reason}"
        one = palm_grasps(self.model, [instance.object_name], [instance.scale], poses_of([result]))
        return one.for_hand(self.model).poses(0)
