"""Answers of a plan, and what is derived from them: trust, shortfalls, approach direction."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ..closure.calibration import LIKELY
from ..closure.finish import margin_of
from ..hands.hand import Hand
from ..hiis.analyser import Grasp, Grip
from ..hiis.decision import Decision, Settings, Status, Transition
from ..objects.load import stored_source
from ..objects.mass import ObjectMass
from ..objects.mesh import TriangleMesh
from ..objects.scans.trust import Trust, seen_weight, trust_of
from ..tasks.task import COMPONENTS, ROTATION_ABSENT, TRANSLATION_ABSENT
from ..types import Array, value
from ..viewer.words import mismatch
from .hand_simulation import HandResult
from .request import PlanRequest
from .standing import Standing

if TYPE_CHECKING:
    from ..arm.model import Arm
    from ..arm.reach import ArmReach

P = TypeVar("P", bound="PlanRecord")
_ABSENT = np.array([TRANSLATION_ABSENT] * 3 + [ROTATION_ABSENT] * 3)


@value
class Answer:
    """A grasp, and the real hand on it.

    Attributes:
        grasp: The virtual grasp or the grip.
        hand_result: The hand's postures, or why the hand retracted.
        heaviest: Heaviest mass that the grip would still hold for this task [kg]; ``None`` for a virtual
            grasp, whose analysis has no loads.
        arm: Whether the arm serves it, and its path; ``None`` without an arm.
    """

    grasp: Grasp
    hand_result: HandResult
    heaviest: float | None = None
    arm: ArmReach | None = None

    @property
    def way_in(self) -> Array:
        """(3,) unit vector along which the hand approaches, mesh frame."""
        return self.grasp.approach if isinstance(self.grasp, Grip) else self.grasp.plane.approach_axis


@value
class Verified:
    """Result of the holding test.

    Attributes:
        held: Whether the plan's answer held.
        tried: Number of answers that were tested, up to the first that held.
        reason: One sentence.
    """

    held: bool
    tried: int
    reason: str


@value
class ArmOutcome:
    """What the arm made of the answers.

    Attributes:
        arm: The arm with the hand.
        tested: Number of answers that were tested.
        refused: The answers that it does not serve, best first; each says why.
        notes: What was assumed, each in one sentence.
        seconds: Time of ``kinematics``, the inverse kinematics of all way points, and of ``total`` [s].
    """

    arm: Arm
    tested: int
    refused: tuple[Answer, ...]
    notes: tuple[str, ...]
    seconds: dict[str, float]


@value
class PlanRecord:
    """Everything about one run, as data; :class:`~preshape.planning.plan.Plan` also shows and saves it.

    Attributes:
        request: What was asked.
        mesh: The mesh that planning used [m].
        hand: The hand.
        mass: The object's mass, and where it comes from.
        decision: The controller's report.
        answer: The answer; ``None`` if there is none.
        alternatives: Further answers, best first.
        best: Without an answer, the best grasp found, which is not good enough; otherwise ``None``.
        seconds: Time of ``load``, ``prepare``, ``search`` and ``total`` [s].
        warnings: What the caller should know about the request, such as an absurd density or a box out of
            reach.
        arm: What the arm made of the answers; ``None`` without an arm.
        verified: Result of the holding test in physics; ``None`` if the request did not ask for the test.
        known: Whether the memory held an experience of this object and of this model of the hand, of any
            task and scene, before the run.
    """

    request: PlanRequest
    mesh: TriangleMesh
    hand: Hand
    mass: ObjectMass
    decision: Decision
    answer: Answer | None
    alternatives: tuple[Answer, ...]
    best: Answer | None
    seconds: dict[str, float]
    warnings: tuple[str, ...] = ()
    verified: Verified | None = None
    known: bool = False
    arm: ArmOutcome | None = None

    @property
    def arm_tested(self) -> int:
        """Number of answers that were tested with the arm."""
        return 0 if self.arm is None else self.arm.tested

    @property
    def source(self) -> str:
        """The object as documents state it; see :func:`~preshape.objects.load.stored_source`."""
        return stored_source(self.request.source)[0]

    @property
    def standing(self) -> Standing:
        """Where the object stands, and the table below it."""
        return self.request.standing(self.mesh)

    @property
    def settings(self) -> Settings:
        """Meta control's settings."""
        return self.request.settings

    @property
    def grasp(self) -> Grasp | None:
        """The answer's grasp."""
        return self.answer.grasp if self.answer else None

    @property
    def hand_result(self) -> HandResult | None:
        """The answer's hand."""
        return self.answer.hand_result if self.answer else None


def scan_trust(plan: PlanRecord, answer: Answer | None) -> Trust | None:
    """How far to trust an answer on a point cloud; ``None`` for a mesh."""
    scan = plan.mesh.scan
    if scan is None:
        return None
    return trust_of(scan, answer.grasp.contacts.triangles if answer is not None else None)


def shortfalls(plan: PlanRecord, answer: Answer) -> tuple[str, ...]:
    """What an answer lacks: components that the task asks for and a virtual grasp does not give (ADI 0).

    TFVADI sums six components, so a virtual grasp can pass without the most important one. A grip is judged
    by the loads that it balances, so it lacks none of them. With a
    larger share of the friction than usual, it lacks reserve; with few odds, certainty.
    """
    if isinstance(answer.grasp, Grip):
        return tuple(_grip_shortfalls(plan.request.search.friction_share, answer.grasp))
    q, g = plan.decision.task.q, answer.grasp
    return tuple(
        f"{name}: the task asks {asked:+.2f}, the grasp {_gives(name, asked, given)} {given:+.2f}"
        for name, asked, given, degree, limit in zip(COMPONENTS, q, g.net_wrench, g.adi, _ABSENT, strict=True)
        if abs(asked) > limit + 1e-9 and degree <= 1e-9
    )


def _grip_shortfalls(usual: float, grip: Grip) -> Iterator[str]:
    """What a grip lacks: reserve of the friction, and certainty of a pick."""
    share, odds = grip.friction_share, grip.pick_probability
    if share > usual:
        part, left = ("all of it", "no") if share >= 1.0 else (f"{share:g}", "less")
        yield (
            f"no grip is good enough with {usual:g} of the friction; this one is with {part}, which "
            f"leaves {left} reserve for a smoother object"
        )
    if odds is not None and odds < LIKELY:
        yield (
            f"only {odds:.2f} of grips like this one pick their object up in simulated physics: test it "
            "first (--verify)"
        )


def _gives(name: str, asked: float, given: float) -> str:
    """Verb of a shortfall: what opposes the task is said to."""
    return "opposes it with" if mismatch(name, asked, given) == "opposes" else "gives"


def missing_motion(plan: PlanRecord, answer: Answer) -> str:
    """The task's largest component if a virtual grasp does not match it (ADI 0); otherwise empty."""
    if isinstance(answer.grasp, Grip):
        return ""
    share = np.abs(plan.decision.task.q) / [1.0, 1.0, 1.0, 0.8, 0.8, 0.8]
    largest = np.flatnonzero(share >= share.max() - 1e-9)
    if (answer.grasp.adi[largest] > 1e-9).any():
        return ""
    return " and ".join(COMPONENTS[k] for k in largest)


def answers_of(plan: PlanRecord) -> tuple[Answer, ...]:
    """The answer and its alternatives, best first."""
    return tuple(a for a in (plan.answer, *plan.alternatives) if a is not None)


def seen_first(plan: P, *, keep: int) -> P:
    """Order the answers on a point cloud by margin times how much of the surface at the contacts was seen.

    Answers that touch only guessed surface are left out. If there are no others, the plan has no answer, and
    the best of them is what was found.

    Args:
        plan: The plan, with all answers to choose from; a plan for a mesh is returned as it is.
        keep: Number of answers to keep.
    """
    scan = plan.mesh.scan
    if plan.answer is None or scan is None:
        return plan

    def rank(answer: Answer) -> float:
        g = answer.grasp  # a grip is ranked by the margin behind its quality, a virtual grasp by its match
        judged = margin_of(g.judged) if isinstance(g, Grip) else g.judged
        return judged * seen_weight(scan, g.contacts.triangles)

    ranked = sorted(answers_of(plan), key=lambda answer: -rank(answer))
    seen = [answer for answer in ranked if scan.seen[answer.grasp.contacts.triangles].any()]
    if not seen:
        return _untrusted(plan, ranked[0])
    best, *others = seen
    plan = replace(plan, alternatives=tuple(others[: keep - 1]))
    return chosen(plan, best, "its contacts rest most on the surface that was seen")


def _untrusted(plan: P, best: Answer) -> P:
    """The plan without an answer, because its best one has a trust of 0."""
    why = (
        f"{best.grasp.score_text}, but all its contacts are on guessed surface (trust 0): "
        "scan the object from another side, or from several"
    )
    return without_answer(plan, best, why)


def without_answer(plan: P, best: Answer, why: str) -> P:
    """The plan without an answer.

    Args:
        plan: The plan, whose answers cannot be used.
        best: The best of them.
        why: Why not, as a sentence.
    """
    last = Transition(mode=plan.decision.mode, outcome="deadlock", reason=why)
    decision = replace(
        plan.decision,
        status=Status.DEADLOCK,
        reason=why,
        grasp=None,
        best=best.grasp,
        alternatives=(),
        transitions=(*plan.decision.transitions, last),
    )
    return replace(plan, answer=None, alternatives=(), best=best, decision=decision)


def chosen(plan: P, answer: Answer, why: str) -> P:
    """The plan with another of its answers; a last transition then judges that answer and says why.

    Args:
        plan: The plan, with an answer of the controller.
        answer: The answer to give.
        why: Why it was chosen, as a clause.
    """
    decision = plan.decision
    if answer.grasp is not decision.grasp:
        last = Transition(mode=decision.mode, outcome="reward", reason=f"{answer.grasp.score_text}: {why}")
        steps = (*decision.transitions, last)
        decision = replace(decision, reason=last.reason, transitions=steps)
    return replace(plan, answer=answer, decision=decision)
