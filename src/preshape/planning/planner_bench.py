"""How often the planner's own answers hold: plan every object for a hand, then test the answers in physics.

The tested grasps are the plan's answers in their order; none of them was tried in physics before. An object
for which the planner gives no answer counts as lost and is named.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..exceptions import ObjectError
from ..hands.hand import Hand
from ..hiis.decision import Settings
from ..objects.load import load_object
from ..physics.grasps import STAGES, GraspSet
from ..physics.hand import PhysicsHand, physics_hand
from ..physics.hold.report import HoldReport
from ..physics.hold.runner import run_holds
from ..physics.hold.six_directions import HoldResult
from ..physics.measures import wilson
from ..physics.pieces import ConvexPieces, load_pieces
from ..physics.protocol import HoldProtocol
from ..types import FIELD_MASS, value
from .answers import Answer, answers_of
from .grasp_sets import palm_grasps, poses_with_gains
from .request import PlanRequest
from .rules import NONE
from .session import Session

Progress = Callable[[str, int, int], None]
"""Called with the name of the current step, the number of items done, and their total number."""


@value
class Case:
    """One object at one size.

    Attributes:
        name: Name for people, such as ``mug@0.8``.
        source: File or library name.
        scale: Factor on its size.
        pieces: Folder of objects that are already cut into convex pieces, or ``None``.
    """

    name: str
    source: str
    scale: float
    pieces: Path | None = None

    @property
    def object_name(self) -> str:
        """The object's name without its size, such as ``mug`` of ``mug@0.8``."""
        return self.name.rpartition("@")[0] or self.name

    def load_pieces(self) -> ConvexPieces:
        """The object's convex pieces at scale 1; see :func:`preshape.physics.pieces.load_pieces`."""
        return load_pieces(self.object_name if self.pieces else self.source, self.pieces)


@value
class Planned:
    """The planner's answers for one case.

    Attributes:
        case: The case.
        answers: The answers in the plan's order; empty if there is none.
        mode: The controller's mode, or -1 if the object was refused.
        reason: The controller's reason, or why the object was refused.
        seconds: Times as in a plan [s]; ``search`` is the time from the prepared object to the answers.
        mass: Mass that planning used [kg].
    """

    case: Case
    answers: tuple[Answer, ...]
    mode: int
    reason: str
    seconds: Mapping[str, float]
    mass: float = FIELD_MASS


@value
class PlannerReport:
    """How many of the planner's answers held.

    Attributes:
        hand: The hand.
        planned: The answers of every case.
        asked: Number of answers requested for each case.
        masses: Mass that each answer was tested with, in the order of the cases [kg].
        holds: The holding test of all answers, in the order of the cases.
    """

    hand: Hand
    planned: tuple[Planned, ...]
    asked: int
    masses: tuple[float, ...]
    holds: HoldReport | None

    @property
    def held(self) -> int:
        """Number of answers that held."""
        return sum(result.held for result in self.holds.results) if self.holds else 0

    @property
    def tested(self) -> int:
        """Number of answers that count: those tested, and one for each case without any."""
        return sum(max(1, len(p.answers)) for p in self.planned)

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % confidence interval of the share of answers that held."""
        return wilson(self.held, self.tested)

    def row(self) -> dict[str, object]:
        """The figures of this report, as one row of a table."""
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
    mass: float | None = FIELD_MASS,
    progress: Progress | None = None,
) -> list[Planned]:
    """Plan every case with a fresh memory; nothing is learnt.

    Args:
        cases: The objects.
        hand: The hand.
        task: Name of the task.
        analyser: ``closure`` or ``rays``.
        count: Number of answers asked for of each case.
        seed: Seed of the planner.
        mass: Mass of every object [kg]; ``None`` takes each object's own. The ray analyser ignores it.
        progress: Called after each case.

    Raises:
        InputError: An argument cannot be used.
    """
    planned: list[Planned] = []
    with Session(":memory:") as session:
        for number, case in enumerate(cases, start=1):
            try:
                request = PlanRequest(
                    source=load_object(case.source, scale=case.scale),
                    task=task,
                    hand=hand,
                    analyser=analyser,
                    mass=mass if analyser == "closure" else None,
                    table=None,
                    count=count,
                    learn=False,
                    settings=Settings(seed=seed),
                    rules=NONE,
                )
                made = session.run(request)
            except ObjectError as error:
                planned.append(Planned(case=case, answers=(), mode=-1, reason=str(error), seconds={}))
            else:
                planned.append(
                    Planned(
                        case=case,
                        answers=tuple(answer for answer in answers_of(made) if answer.hand_result.reached),
                        mode=made.decision.mode,
                        reason=made.decision.reason,
                        seconds=made.seconds,
                        mass=made.mass.kg,
                    )
                )
            if progress is not None:
                progress("planned", number, len(cases))
    return planned


def grasps_of(planned: Sequence[Planned], hand: Hand, model: PhysicsHand | None = None) -> GraspSet | None:
    """The answers as grasps of one set, squeezed with the gains of ``model``; ``None`` without answers."""
    rows = [(p.case, answer.hand_result) for p in planned for answer in p.answers]
    if not rows:
        return None
    cases, results = zip(*rows, strict=True)
    gains = None if model is None else model.gains
    each = [poses_with_gains(hand, result, gains) for result in results]
    poses = {stage: np.concatenate([one[stage] for one in each]) for stage in STAGES}
    return palm_grasps(hand, [c.source for c in cases], [c.scale for c in cases], poses)


def bench_planner(
    planned: Sequence[Planned],
    hand: Hand,
    *,
    protocol: HoldProtocol,
    own_mass: bool,
    asked: int,
    model: PhysicsHand | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> PlannerReport:
    """Run the holding test on planned answers.

    Args:
        planned: The answers of all cases (:func:`plan_cases`).
        hand: The hand.
        protocol: Settings of the test.
        own_mass: Whether each answer is tested with the mass that it was planned for, not the protocol's.
        asked: Number of answers asked for of each case.
        model: The hand that is tested; another model of the same hand has the same joints and palm frame.
        workers: Number of processes of the test.
        progress: Called as the work advances.

    Raises:
        EnvironmentFailure: A file cannot be read, or a process was killed.
    """
    tested = physics_hand(hand) if model is None else model
    grasps = grasps_of(planned, hand, tested)
    masses = tuple(p.mass if own_mass else protocol.mass for p in planned for _ in p.answers)
    holds = None
    if grasps is not None:
        cut = dict[str, ConvexPieces]()
        wanted = {p.case.source: p.case for p in planned if p.answers}
        for number, (source, case) in enumerate(wanted.items(), start=1):
            cut[source] = case.load_pieces()
            if progress is not None:
                progress("cut into convex pieces", number, len(wanted))
        holds = _tested(grasps, masses, tested, protocol, cut, workers, progress)
    return PlannerReport(hand=hand, planned=tuple(planned), asked=asked, masses=masses, holds=holds)


def _tested(
    grasps: GraspSet,
    masses: Sequence[float],
    hand: PhysicsHand,
    rules: HoldProtocol,
    pieces: Mapping[str, ConvexPieces],
    workers: int | None,
    progress: Progress | None,
) -> HoldReport:
    """The holding test of each grasp with its own mass, as one report in the order of the grasps."""
    own = grasps.for_hand(hand)
    results: dict[int, HoldResult] = {}
    seconds = 0.0
    for mass in dict.fromkeys(masses):
        rows = [row for row, other in enumerate(masses) if other == mass]
        before = len(results)
        report = run_holds(
            own.rows(rows),
            hand,
            protocol=replace(rules, mass=mass),
            pieces=pieces,
            workers=workers,
            progress=None
            if progress is None
            else lambda done, _, before=before: progress("tested", before + done, len(own)),  # type: ignore[misc]
        )
        results |= {row: replace(r, row=row) for row, r in zip(rows, report.results, strict=True)}
        seconds += report.seconds
    return HoldReport(grasps=own, results=tuple(results[row] for row in range(len(own))), seconds=seconds)
