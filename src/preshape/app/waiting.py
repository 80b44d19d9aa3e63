"""What a browser reads while its planner works: words and seconds, a bar, and a button that cancels."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from .panel import Panel

LONG = 1.0
"""From when on the seconds are told [s]."""


class Waiting:
    """The time between a request and its last reply.

    Args:
        panel: where it is read.
        say: writes a headline: its kind, its title and words.
    """

    def __init__(self, panel: Panel, say: Callable[[str, str, str], None]) -> None:
        self._panel, self._say = panel, say
        self._words, self._since, self._open = "", 0.0, False
        # What is told last must not come after the end.
        self._lock = threading.Lock()
        self._aloud: Callable[[], bool] = lambda: True

    def begin(self, words: str, aloud: Callable[[], bool]) -> None:
        """A request is about to be sent.

        Args:
            words: what will be done.
            aloud: whether the headline still belongs to it; an answer that has come takes its place.
        """
        p = self._panel
        with self._lock:
            self._words, self._since, self._aloud, self._open = words, time.monotonic(), aloud, True
            p.progress.value = 2
            p.progress.visible = p.cancel.visible = True
            p.run.disabled = p.teach.disabled = True
            self._say("warn", "Working", f"{words} …")

    def watch(self) -> None:
        """It was sent: tell the seconds until it is answered."""
        threading.Thread(target=self._tick, daemon=True).start()

    def progress(self, words: str, share: float) -> None:
        """The planner said what it does, and its share in percent."""
        self._words = words
        self._panel.progress.value = share
        self._tell()

    def quiet(self) -> None:
        """An answer has come: from now on the headline is its own, though the end was not told yet."""
        with self._lock:
            self._aloud = lambda: False

    def end(self) -> None:
        """It was answered, or will not be."""
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
            if self._open and self._aloud():
                seconds = f" {passed:.0f} s" if passed > LONG else ""
                self._say("warn", "Working", f"{self._words} …{seconds}")
