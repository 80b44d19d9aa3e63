"""The run in simulated physics in one browser: the shown sample, its description and the table of pushes."""

from __future__ import annotations

from ..report.plain import html_text as escape
from ..viewer import readings
from .panel import Panel
from .physics_player import Run
from .stage import Stage


class Trial:
    """The run of the shown answer, if it was simulated.

    Attributes:
        run: The run.

    Args:
        panel: The panel that shows description and table.
        stage: The scene that shows the sample.
    """

    def __init__(self, panel: Panel, stage: Stage) -> None:
        self._panel, self._stage = panel, stage
        self.run: Run | None = None

    def take(self, run: Run) -> None:
        """Show a run's table, and the end of its first push that was not held, else the end of the run."""
        p = self._panel
        self.run = run
        p.run_report.content = readings.wrapped(run.report)
        p.moment.visible = p.replay.visible = True
        lost = [i for i, stage in enumerate(run.stage) if stage == run.first_lost]
        self.show(lost[-1] / max(1, len(run) - 1) if lost else 1.0)

    def drop(self) -> None:
        """Remove the run, because another answer is shown."""
        p = self._panel
        self.run = None
        p.moment.visible = p.replay.visible = False
        p.run_words.content = p.run_report.content = ""
        self._stage.leave_run()

    def show(self, share: float) -> None:
        """Show the sample at a fraction 0..1 of the run, if there is a run."""
        run = self.run
        if run is not None:
            frame = round(min(1.0, max(0.0, share)) * (len(run) - 1))
            self._panel.moment.value = share
            self._panel.run_words.content = readings.wrapped(
                f"<p><b>{escape(run.words(frame))}</b></p>{run.verdict}"
            )
            self._stage.show_run(run, frame)
