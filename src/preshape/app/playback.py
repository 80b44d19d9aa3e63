"""Motion in one browser: the planned grasp, and the run of an answer in simulated physics."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from ..pictures import Document
from .panel import Panel
from .physics_player import run_of
from .reading import STAGES, Reading
from .stage import Stage
from .trial import Trial

PLAYED = 3.0
"""Duration of the animated grasp [s]."""
RUN_PLAYED = 9.0
"""Longest duration of the playback of a run in simulated physics [s]."""


class Playback:
    """Plays the planned grasp and the run of the shown answer; one of them at a time.

    Args:
        panel: The panel with sliders and buttons.
        stage: The scene.
        reading: The plan.
        trial: The run.
    """

    def __init__(self, panel: Panel, stage: Stage, reading: Reading, trial: Trial) -> None:
        self._panel, self._stage, self._reading, self._trial = panel, stage, reading, trial
        self._playing = threading.Event()
        # What was stopped draws no more.
        self._lock = threading.RLock()
        # The answer that was simulated last, and whether its run plays as soon as it is there.
        self._simulated: Document | None = None
        self._at_once = False

    def stop(self) -> None:
        """Stop what is playing."""
        with self._lock:
            self._playing.clear()

    def slide(self) -> None:
        """Show the hand where the slider is."""
        self.stop()
        self._stage.move(self._reading.share())

    def play(self) -> None:
        """Play the planned grasp; a second call meanwhile stops it."""

        def step(share: float) -> None:
            self._panel.slider.value = STAGES * share
            self._stage.move(share)

        self._animate(step, PLAYED)

    def begin(self, answer: Document, *, at_once: bool) -> None:
        """An answer is about to be simulated.

        Args:
            answer: The answer.
            at_once: Whether its run plays as soon as it is there.
        """
        self._simulated, self._at_once = answer, at_once
        self._trial.drop()

    def take(self, sent: dict[str, Any]) -> bool:
        """Show a run that has been computed; returns False if its answer is no longer shown."""
        if self._reading.answer is not self._simulated:
            return False
        self._reading.headline()
        self._trial.take(run_of(sent))
        return True

    def follow(self) -> None:
        """Play the run that has just come if that was asked for, in a thread of its own."""
        if self._at_once and self._trial.run is not None:
            self._at_once = False
            threading.Thread(target=self.replay, daemon=True).start()

    def seek(self) -> None:
        """Show the run where the slider is."""
        self.stop()
        self._trial.show(float(self._panel.moment.value))

    def replay(self) -> None:
        """Play the run; a second call meanwhile stops it."""
        run = self._trial.run
        if run is not None:
            self._animate(self._trial.show, min(RUN_PLAYED, max(PLAYED, float(run.times[-1]))))

    def _animate(self, step: Callable[[float], None], seconds: float) -> None:
        """Call ``step`` with shares rising from 0 to 1 for some seconds; a second call meanwhile stops it."""
        with self._lock:
            if self._playing.is_set():
                self._playing.clear()
                return
            self._playing.set()
        begun = time.monotonic()
        while self._playing.is_set():
            with self._lock:
                if not self._playing.is_set():
                    return
                passed = min(1.0, (time.monotonic() - begun) / seconds)
                step(passed)
                if passed >= 1.0:
                    self._playing.clear()
            time.sleep(0.05)
