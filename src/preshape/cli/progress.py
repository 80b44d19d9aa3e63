"""Progress of a command on standard error: a bar in a terminal, lines in a log, a sentence at Ctrl-C.

:class:`Steps` counts the work of long commands; :func:`waiting` shows what a single answer is waiting for.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ..exceptions import Cancelled
from ..report.plain import escaped_line
from ..report.terminal import terminal
from . import interrupts
from .printing import say

if TYPE_CHECKING:
    from rich.progress import Progress

LINES = 20
"""Number of lines in a log for each kind of work."""
PAUSE = 5.0
"""Shortest time between two log lines about preparations [s]."""
WINDOW, LEAST = 120.0, 10
"""The remaining time is estimated from the last ``WINDOW`` seconds, and from at least ``LEAST`` steps."""

DELAY = 1.0
"""Work that takes less time than this shows nothing [s]."""

PREPARED = 30.0
"""Progress of a session from which it is no longer preparing [%]."""

GOES_ON = "the same command goes on from there"


def duration(seconds: float) -> str:
    """A duration in words.

    >>> duration(89.4), duration(90), duration(5400)
    ('89 s', '2 min', '1.5 h')
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


class Steps:
    """Shows the progress of a command.

    Attributes:
        reached: The progress so far, in words.
    """

    def __init__(self, bar: Progress) -> None:
        self._bar, self._task = bar, bar.add_task("preparing", total=None)
        self._what, self._lines, self._line = "", -1, time.perf_counter()
        self._recent: deque[tuple[float, float]] = deque()
        self.reached = "while preparing"

    def prepare(self, words: str) -> None:
        """Show what is being prepared."""
        self._bar.update(self._task, description=escaped_line(words))
        if not self._bar.console.is_terminal and time.perf_counter() - self._line > PAUSE:
            self._line = time.perf_counter()
            say(words, err=True)

    def step(self, what: str, done: float, of: float, last: str = "") -> None:
        """Show the number of finished units of work.

        Args:
            what: Name of the units, such as ``grasps``; ``%`` for percent.
            done: Number of finished units.
            of: Number of all units.
            last: The unit that was finished last or is being worked on.
        """
        now = time.perf_counter()
        if what != self._what:  # the first count may include an earlier run: no speed follows from it
            self._what, self._lines = what, -1
            self._recent.clear()
            self._bar.reset(self._task, total=of, completed=int(done))
        self._recent.append((now, done))
        while len(self._recent) > LEAST and now - self._recent[1][0] > WINDOW:
            self._recent.popleft()
        percent = f"{100 * done // of:.0f} %"
        counted = "" if what == "%" else f"{done} of {of} {what}"
        self.reached = f"after {counted}" if counted else f"at {percent}"
        (then, before), left = self._recent[0], ""
        if before < done < of:
            left = f"about {duration((now - then) / (done - before) * (of - done))} left"
        words = ", ".join(filter(None, (counted, left))) + (f": {last}" if last else "")
        self._bar.update(self._task, completed=done, description=escaped_line(words.removeprefix(": ")))
        if not self._bar.console.is_terminal and int(LINES * done // of) > self._lines:
            self._lines = int(LINES * done // of)
            say(f"{percent:>5}{'' if words.startswith(':') else ', '}{words}", err=True)
        if interrupts.swallowed() and done < of:  # a destructor or a callback has lost the exception
            raise KeyboardInterrupt


class TimeLeft:
    """Estimates the remaining time of work whose steps take different times.

    Within a step that tells its progress several times, the estimate follows that step's own speed; otherwise
    it follows the speed since the start.
    """

    def __init__(self) -> None:
        self._step, self._start = "", (time.perf_counter(), 0.0)
        self._begin = self._start

    def words(self, step: str, share: float) -> str:
        """The remaining time in words, before those of the step; empty where it cannot be known.

        Args:
            step: Name of the step; what follows a digit in it is a part of the step.
            share: The whole work's progress, 0..100.
        """
        now = time.perf_counter()
        name = step[: next((k for k, letter in enumerate(step) if letter.isdigit()), len(step))]
        if name != self._step:
            self._step, self._start = name, (now, share)
        then, before = self._start if share > self._start[1] else self._begin
        if not before < share < 100.0 or now - then < DELAY:
            return ""
        return f"about {duration((now - then) / (share - before) * (100.0 - share))} left: "


@contextmanager
def narrated() -> Iterator[Callable[[str, float], None]]:
    """Print what planning and searching do, line by line with the seconds so far, on standard error.

    Yields:
        A function as that of :func:`waiting`.
    """
    import logging

    start = time.perf_counter()

    def line(words: str) -> None:
        say(f"{time.perf_counter() - start:7.2f} s  {words}", err=True)

    class StageLines(logging.Handler):
        searching = False  # the first lesson with the cube would write hundreds of lines

        def emit(self, record: logging.LogRecord) -> None:
            if self.searching:
                line(f"  {record.getMessage()}")

        def told(self, words: str, share: float) -> None:
            self.searching = share >= PREPARED
            line(words)

    log, handler = logging.getLogger("preshape"), StageLines(logging.INFO)
    before = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield handler.told
    finally:
        log.removeHandler(handler)
        log.setLevel(before)


@contextmanager
def waiting() -> Iterator[Callable[[str, float], None]]:
    """Show a spinner, a bar and the remaining time on a terminal, from one second on; elsewhere nothing.

    Yields:
        A function that takes the name of the current step and the whole work's progress, 0..100.
    """
    if not sys.stderr.isatty() and not {"FORCE_COLOR", "TTY_INTERACTIVE", "TTY_COMPATIBLE"} & set(os.environ):
        yield lambda words, share: None  # as below, without importing rich
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = terminal(stderr=True)
    if not console.is_interactive:
        yield lambda words, share: None
        return
    columns = (
        SpinnerColumn(),
        BarColumn(20),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
    )
    bar, left = Progress(*columns, console=console, transient=True), TimeLeft()
    task = bar.add_task("loading", total=100)
    timer = threading.Timer(DELAY, bar.start)
    timer.daemon = True
    timer.start()

    def told(words: str, share: float) -> None:
        bar.update(task, completed=share, description=escaped_line(left.words(words, share) + words))

    try:
        yield told
    finally:
        timer.cancel()
        timer.join()
        bar.stop()


@contextmanager
def steps(kept: str) -> Iterator[Steps]:
    """Show the progress of one command.

    Args:
        kept: End of the sentence at Ctrl-C, which says what happens to the finished work.

    Raises:
        Cancelled: The work was interrupted; the message says how far it came.
    """
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
    )
    console = terminal(stderr=True)
    shown = None
    try:
        with (
            interrupts.patient(),
            Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar,
        ):
            shown = Steps(bar)
            yield shown
    except KeyboardInterrupt as stop:
        reached = shown.reached if shown is not None else "while preparing"
        raise Cancelled(f"stopped {reached}; {kept}") from stop
