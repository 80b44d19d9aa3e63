"""The plan: what a session answers to a request, for people, files and pictures."""

from __future__ import annotations

from pathlib import Path

from ..hands.hand import Hand
from ..hiis.analyser import Grasp
from ..hiis.decision import Decision, Settings
from ..objects.mass import ObjectMass
from ..objects.mesh import TriangleMesh
from ..types import value
from .answers import Answer, Verified
from .hand_simulation import HandResult
from .request import PlanRequest


@value
class Plan:
    """Everything about one run.

    ``repr`` is one line, ``print`` shows what the terminal shows, and a notebook shows the picture with the
    figures.

    Attributes:
        request: What was asked.
        mesh: The object as it was planned with [m].
        hand: The hand.
        mass: The object's mass, and where it comes from.
        decision: The controller's report.
        answer: The answer; ``None`` without one.
        alternatives: Further answers, best first.
        best: Without an answer, the best grasp that was found, which is not good enough; else ``None``.
        seconds: Time of ``load``, ``prepare``, ``search`` and ``total`` [s].
        warnings: What the caller should know about the request: an absurd density, a box out of reach.
        verified: What the holding test in physics said; ``None`` where it was not asked.
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

    @property
    def source(self) -> str:
        """The file or library name of the object."""
        return self.request.object_name

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

    def __repr__(self) -> str:
        what = f"{self.mesh.name}, {self.decision.task.label}, {self.hand.name}"
        if self.answer is None:
            return f"<Plan {what}: {self.decision.status.value.replace('_', ' ')}>"
        g = self.answer.grasp
        return f"<Plan {what}: {g.plane.label}, {g.score_text} of 6>"

    def __str__(self) -> str:
        from .summary import summary_text

        return summary_text(self)

    def _repr_html_(self) -> str:
        """The picture with the figures, as a notebook shows it."""
        from .output import notebook_html

        return notebook_html(self)

    def save(self, folder: str | Path) -> list[Path]:
        """Write plan.json, plan.png and plan.html to a folder, which is made where it is missing.

        An object that has no file of its own (a point cloud's surface, a mesh made in Python) is written
        beside them, so that other commands find it.

        Returns:
            The files that were written.

        Raises:
            EnvironmentFailure: A file cannot be written.
        """
        from .output import save_plan

        return save_plan(self, Path(folder))

    def show(self) -> Path:
        """Open the plan's page in the web browser; returns the page's file.

        Raises:
            EnvironmentFailure: The page cannot be written.
        """
        from .output import show_plan

        return show_plan(self)
