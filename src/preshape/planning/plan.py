"""The plan: what a session answers to a request, for people, files and pictures."""

from __future__ import annotations

from pathlib import Path

from ..files import path_of
from ..types import value
from .answers import PlanRecord


@value
class Plan(PlanRecord):
    """Everything about one run; see :class:`~preshape.planning.answers.PlanRecord` for its fields.

    ``repr`` is one line, ``print`` shows what the terminal shows, and a notebook shows the picture with the
    figures.
    """

    def __repr__(self) -> str:
        what = f"{self.mesh.name}, {self.decision.task.label}, {self.hand.name}"
        shown = self.answer or self.best
        found = f"{shown.grasp.plane.label}, {shown.grasp.score_text} of 6" if shown else "nothing found"
        if self.answer is not None:
            return f"<Plan {what}: {found}>"
        status = self.decision.status.value.replace("_", " ")
        return f"<Plan {what}: {status}, the best is {found}; {self.decision.reason}>"

    def __str__(self) -> str:
        from .summary import summary_text  # rich, which a plan for a program does not need

        return summary_text(self)

    def _repr_html_(self) -> str:
        """The picture with the figures, as a notebook shows it."""
        from .output import notebook_html

        return notebook_html(self)

    def save(self, folder: str | Path) -> list[Path]:
        """Write plan.json, plan.png and plan.html to a folder, which is created if it is missing.

        An object without a mesh file of its own (a point cloud's surface, or a mesh made in Python) is
        written to the same folder, so that other commands find it.

        Returns:
            The files that were written.

        Raises:
            InputError: The folder is no path.
            EnvironmentFailure: A file cannot be written.
        """
        from .output import save_plan

        return save_plan(self, path_of(folder, "folder"))

    def show(self) -> Path:
        """Open the plan's page in the web browser; returns the page's file.

        Raises:
            EnvironmentFailure: The page cannot be written.
        """
        from .output import show_plan

        return show_plan(self)
