"""One browser's run in simulated physics: the moment that is shown, the words and the table."""

from __future__ import annotations

from html import escape
from typing import Any

from ..viewer import readings
from .panel import Panel
from .physics_player import Run, run_of
from .stage import Stage


class Trial:
    """The run of the shown answer, where it was simulated.

    Args:
        panel: where it is read.
        stage: where it is seen.
    """

    def __init__(self, panel: Panel, stage: Stage) -> None:
        self._panel, self._stage = panel, stage
        self._run: Run | None = None

    def take(self, said: dict[str, Any]) -> None:
        """A run has come: the table is shown, and the end of the first push that was not held, or of all."""
        p = self._panel
        self._run = run_of(said)
        p.run_report.content = readings.wrapped(self._run.report)
        p.moment.visible = p.replay.visible = True
        lost = [i for i, stage in enumerate(self._run.stage) if stage == self._run.first_lost]
        self.show(lost[-1] / max(1, len(self._run) - 1) if lost else 1.0)

    def drop(self) -> None:
        """Another answer is shown: it has no run yet."""
        p = self._panel
        self._run = None
        p.moment.visible = p.replay.visible = False
        p.run_words.content = p.run_report.content = ""
        self._stage.leave_run()

    def show(self, share: float) -> None:
        """Show the moment at a share 0..1 of the run."""
        run = self._run
        if run is not None:
            frame = round(min(1.0, max(0.0, share)) * (len(run) - 1))
            self._panel.moment.value = share
            self._panel.run_words.content = readings.wrapped(f"<b>{escape(run.words(frame))}</b>")
            self._stage.show_run(run, frame)
