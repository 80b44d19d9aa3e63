"""This program's planner as a source of answers for the task benchmark and the pick test."""

from __future__ import annotations

import hashlib
from typing import Any

from .._version import __version__
from ..exceptions import PreshapeError
from ..hands.hand import Hand
from ..hiis.decision import Settings
from ..physics.grasps import HandPoses
from ..physics.hand import PhysicsHand
from ..physics.pick.objects import PickAnswer, PickObject
from ..physics.task.instances import TaskInstance
from ..physics.task.motion import TaskMotion
from ..types import FIELD_MASS, value
from .grasp_sets import palm_grasps, poses_with_gains
from .plan import Plan
from .request import PlanRequest
from .rules import NONE
from .session import Session
from .standing import AUTO
from .verify import work_of


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
        found = _planned(
            self.model,
            source=instance.object_name,
            task=instance.task,
            hand=self.hand,
            analyser=self.analyser,
            scale=instance.scale,
            mass=self.mass if self.analyser == "closure" else None,
            table=None,
            settings=Settings(seed=instance.seed),
            rules=NONE,
        )
        return found if isinstance(found, str) else found[1]


@value
class PlannedPicks:
    """The planner's first answer for each object on a table; each object is planned with a fresh memory.

    Attributes:
        hand: The hand.
        task: Name of the task to plan for.
        model: The hand that picks; another model of the same hand has the same joints and palm frame.
    """

    hand: Hand
    task: str
    model: PhysicsHand

    @property
    def digest(self) -> str:
        """Hash of hand, task and the program's version."""
        return hashlib.sha256(repr((self.hand.name, self.task, __version__)).encode()).hexdigest()

    def answer(self, thing: PickObject) -> PickAnswer | str:
        """The planned answer with the object at the origin, or why there is none."""
        found = _planned(
            self.model,
            source=thing.name,
            task=self.task,
            hand=self.hand,
            analyser="closure",
            scale=thing.scale,
            mass=thing.mass,
            table=AUTO,
            settings=Settings(seed=thing.seed),
        )
        if isinstance(found, str):
            return found
        plan, poses = found
        assert plan.answer is not None
        return PickAnswer(
            poses=poses,
            way_in=tuple(plan.answer.way_in.tolist()),
            turn=tuple(plan.standing.pose[3:].tolist()),
            work=work_of(plan.request, plan.mesh),
        )

    def work(self, thing: PickObject) -> TaskMotion | None:
        """Motion and load of the task for an object, as in its answer."""
        asked = PlanRequest(source=thing.name, task=self.task, hand=self.hand, scale=thing.scale)
        return work_of(asked, asked.load())


def _planned(model: PhysicsHand, **request: Any) -> tuple[Plan, HandPoses] | str:
    """The plan of a request on a fresh memory and its first answer's poses for a model, or why none."""
    try:
        asked = PlanRequest(**request)
        with Session(":memory:") as session:
            made = session.run(asked)
    except PreshapeError as error:
        return str(error)
    result = made.hand_result
    if made.answer is None or result is None:
        return made.decision.reason
    if result.pregrasp is None or result.grasp is None or result.squeeze is None:
        return f"the hand does not reach the grasp: {result.reason}"
    poses = poses_with_gains(made.hand, result, model.gains)
    one = palm_grasps(made.hand, [asked.object_name], [asked.scale], poses)
    return made, one.for_hand(model).poses(0)
