"""The display while a browser's planner works: a description with seconds, a bar, and a cancel button."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from .panel import Panel

LONG = 1.0
"""Time after which the elapsed seconds are shown [s]."""


class Waiting:
    """The time between a request and its last reply.

    Args:
        panel: The panel with the display.
        say: Function that writes a headline with kind, title and words.
    """

    def __init__(self, panel: Panel, say: Callable[[str, str, str], None]) -> None:
        self._panel, self._say = panel, say
        self._words, self._since, self._open = "", 0.0, False
        # The lock prevents an update of the headline after the end of the work.
        self._lock = threading.Lock()
        self._owns_headline: Callable[[], bool] = lambda: True

    def begin(self, words: str, owns_headline: Callable[[], bool]) -> None:
        """Show that work begins; called before the request is sent.

        Args:
            words: Description of the work.
            owns_headline: Function that says whether the headline may show the work; an answer takes it over.
        """
        p = self._panel
        with self._lock:
            self._words, self._since, self._open = words, time.monotonic(), True
            self._owns_headline = owns_headline
            p.progress.value = 2
            p.progress.visible = p.cancel.visible = True
            p.run.disabled = p.teach.disabled = True
            self._say("warn", "Working", f"{words} …")

    def watch(self) -> None:
        """Show the elapsed seconds until the work ends; called after the request was sent."""
        threading.Thread(target=self._tick, daemon=True).start()

    def progress(self, words: str, share: float) -> None:
        """Show the current step of the planner, and the completed share [%]."""
        self._words = words
        self._panel.progress.value = share
        self._tell()

    def quiet(self) -> None:
        """Leave the headline to the new answer although the work goes on."""
        with self._lock:
            self._owns_headline = lambda: False

    def end(self) -> None:
        """Hide bar and button, because the work is done or was stopped."""
        p = self._panel
        with self._lock:
            self._open = False
            p.progress.visible = p.cancel.visible = False
            p.run.disabled = p.teach.disabled = False

    def _tick(self) -> None:
        since = self._since
        while self._open and since == self._since:
            time.sleep(0.5)
            if since == self._since:
                self._tell()

    def _tell(self) -> None:
        with self._lock:
            passed = time.monotonic() - self._since
            if self._open and self._owns_headline():
                seconds = f" {passed:.0f} s" if passed > LONG else ""
                self._say("warn", "Working", f"{self._words} …{seconds}")
