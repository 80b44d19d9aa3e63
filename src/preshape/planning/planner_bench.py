"""How often the planner's own answers hold: plan every object for a hand, then put the answers to the test.

The grasps that are tested are the plan's, first answer first; nothing is tried in physics before. An object
for which the planner gives no answer counts as lost, and is named.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..closure.settings import ClosureSettings
from ..exceptions import ObjectError
from ..hands.hand import Hand
from ..memory import Memory
from ..objects.load import load_object
from ..physics.grasps import GraspSet
from ..physics.hand import physics_hand
from ..physics.hold.report import HoldReport
from ..physics.hold.runner import run_holds
from ..physics.measures import wilson
from ..physics.pieces import ConvexPieces, load_pieces
from ..physics.protocol import HoldProtocol
from ..planner import plan
from ..planning.plan import Answer, Plan
from ..types import FIELD_MASS, value
from .grasp_sets import palm_grasps, poses_of

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is, and of how much."""


@value
class Case:
    """One object at one size.

    Attributes:
        name: for people.
        source: file or library name.
        scale: factor on its size.
        pieces: folder of objects that are cut already, or ``None``.
    """

    name: str
    source: str
    scale: float
    pieces: Path | None = None

    @property
    def thing(self) -> str:
        """The object's name without its size, as ``mug`` of ``mug@0.8``."""
        return self.name.rpartition("@")[0] or self.name

    def load_pieces(self) -> ConvexPieces:
        """The object's convex pieces at scale 1; see :func:`preshape.physics.pieces.load_pieces`."""
        return load_pieces(self.thing if self.pieces else self.source, self.pieces)


@value
class Planned:
    """The planner's answers for one case.

    Attributes:
        case: the case.
        answers: best first; empty without one.
        mode: the controller's, or -1 where the object was refused.
        reason: why there is no answer, or the controller's reason.
        seconds: as in a plan; ``search`` is what a grasp costs once the object is prepared.
    """

    case: Case
    answers: tuple[Answer, ...]
    mode: int
    reason: str
    seconds: Mapping[str, float]


@value
class PlannerReport:
    """What the answers are worth.

    Attributes:
        hand: The hand.
        planned: every case.
        asked: answers asked for of each case.
        holds: the holding test of all answers, in the order of the cases.
    """

    hand: Hand
    planned: tuple[Planned, ...]
    asked: int
    holds: HoldReport | None

    @property
    def held(self) -> int:
        """Answers that held."""
        return sum(result.held for result in self.holds.results) if self.holds else 0

    @property
    def tested(self) -> int:
        """Answers that count: those tested, and one for each case without any."""
        return sum(max(1, len(p.answers)) for p in self.planned)

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % interval of the share that held."""
        return wilson(self.held, self.tested)

    def row(self) -> dict[str, object]:
        """The figures of one line of a table."""
        geometry = [r.at_grasp for r in self.holds.results if r.at_grasp] if self.holds else []
        search = [p.seconds["search"] for p in self.planned if "search" in p.seconds]
        strengths = [r.strength for r in self.holds.results if r.strength is not None] if self.holds else []
        return {
            "hand": self.hand.name,
            "cases": len(self.planned),
            "without_answer": [p.case.name for p in self.planned if not p.answers],
            "asked": self.asked,
            "tested": self.tested,
            "held": self.held,
            "share": self.held / self.tested if self.tested else None,
            "interval": self.interval,
            "touching": sum(g.parts >= 2 for g in geometry),
            "penetration_max": max((g.penetration for g in geometry), default=None),
            "strength_median": float(np.median(strengths)) if strengths else None,
            "search_median": float(np.median(search)) if search else None,
            "modes": [p.mode for p in self.planned],
        }


def plan_cases(
    cases: Sequence[Case],
    hand: Hand,
    *,
    task: str = "lift",
    analyser: str = "closure",
    count: int = 1,
    seed: int = 0,
    mass: float = FIELD_MASS,
    progress: Progress | None = None,
) -> list[Planned]:
    """Plan every case with a fresh memory, nothing learnt between them.

    Args:
        cases: objects.
        hand: The hand.
        task: a task's name.
        analyser: ``closure`` or ``rays``.
        count: answers asked for.
        seed: of the planner.
        mass: of every object [kg]; the ray analyser knows no load.
        progress: called after each.

    Raises:
        InputError: a bad argument.
    """
    closure = ClosureSettings(mass=mass) if analyser == "closure" else None
    planned: list[Planned] = []
    with Memory.open(":memory:") as memory:
        for number, case in enumerate(cases, start=1):
            planned.append(_plan(case, hand, task, analyser, count, seed, closure, memory))
            if progress is not None:
                progress("planned", number, len(cases))
    return planned


def _plan(
    case: Case,
    hand: Hand,
    task: str,
    analyser: str,
    count: int,
    seed: int,
    closure: ClosureSettings | None,
    memory: Memory,
) -> Planned:
    try:
        mesh = load_object(case.source, scale=case.scale)
        made: Plan = plan(
            mesh,
            task,
            hand=hand,
            analyser=analyser,
            memory=memory,
            learn=False,
            seed=seed,
            count=count,
            closure=closure,
        )
    except ObjectError as error:
        return Planned(case=case, answers=(), mode=-1, reason=str(error), seconds={})
    reached = (a for a in (made.answer, *made.alternatives) if a is not None and a.hand_result.reached)
    return Planned(
        case=case,
        answers=tuple(reached),
        mode=made.decision.mode,
        reason=made.decision.reason,
        seconds=made.seconds,
    )


def grasps_of(planned: Sequence[Planned], hand: Hand) -> GraspSet | None:
    """The answers as grasps of one set; ``None`` when there are none."""
    rows = [(p.case, answer.hand_result) for p in planned for answer in p.answers]
    if not rows:
        return None
    cases, results = zip(*rows, strict=True)
    return palm_grasps(hand, [c.source for c in cases], [c.scale for c in cases], poses_of(results))


def bench_planner(
    cases: Sequence[Case],
    hand: Hand,
    *,
    protocol: HoldProtocol | None = None,
    task: str = "lift",
    analyser: str = "closure",
    count: int = 1,
    seed: int = 0,
    workers: int | None = None,
    pieces: Mapping[str, ConvexPieces] | None = None,
    planned: Sequence[Planned] | None = None,
    progress: Progress | None = None,
) -> PlannerReport:
    """Plan, then test.

    Args:
        cases: objects.
        hand: The hand.
        protocol: default the six directions, a loss ends a grasp's test; its mass is planned for where
            nothing was ``planned`` before.
        task: what is planned for.
        analyser: ``closure`` or ``rays``.
        count: answers of each case.
        seed: of the planner.
        workers: processes of the test.
        pieces: objects already cut, by source.
        planned: answers made before, to be tested again under another protocol.
        progress: called as work is done.

    Raises:
        InputError: a bad argument.
        EnvironmentFailure: a file or a process failed.
    """
    rules = protocol or HoldProtocol(stop_early=True)
    if planned is None:
        planned = plan_cases(
            cases,
            hand,
            task=task,
            analyser=analyser,
            count=count,
            seed=seed,
            mass=rules.mass,
            progress=progress,
        )
    made = list(planned)
    grasps = grasps_of(made, hand)
    if grasps is None:
        return PlannerReport(hand=hand, planned=tuple(made), asked=count, holds=None)
    cut = dict(pieces or {})
    wanted = {p.case.source: p.case for p in made if p.answers}
    for number, (source, case) in enumerate(wanted.items(), start=1):
        if source not in cut:
            cut[source] = case.load_pieces()
        if progress is not None:
            progress("cut into convex pieces", number, len(wanted))
    holds = run_holds(
        grasps,
        physics_hand(hand),
        protocol=rules,
        pieces=cut,
        workers=workers,
        progress=None if progress is None else lambda done, of: progress("tested", done, of),
    )
    return PlannerReport(hand=hand, planned=tuple(made), asked=count, holds=holds)
