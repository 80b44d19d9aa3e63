"""Progress of long work on standard error: a bar in a terminal, lines in a log, and a last word at Ctrl-C."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.progress import Progress

LINES = 20  # of a log, for each kind of work
PAUSE = 5.0  # between lines on what is being prepared [s]
WINDOW, LEAST = 120.0, 10  # the estimate goes by the last seconds, and by so many steps at least

GOES_ON = "the same command goes on from there"


def duration(seconds: float) -> str:
    """A time for people.

    >>> duration(89.4), duration(90), duration(5400)
    ('89 s', '2 min', '1.5 h')
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


class Steps:
    """Says how far the work has come."""

    def __init__(self, bar: Progress) -> None:
        self._bar, self._task = bar, bar.add_task("preparing", total=None)
        self._what, self._said, self._line = "", -1, time.perf_counter()
        self._lately: deque[tuple[float, float]] = deque()
        self.reached = "while preparing"

    def prepare(self, words: str) -> None:
        """Say what is being made ready."""
        self._bar.update(self._task, description=words)
        if not self._bar.console.is_terminal and time.perf_counter() - self._line > PAUSE:
            self._line = time.perf_counter()
            click.echo(words, err=True)

    def step(self, what: str, done: float, of: float, last: str = "") -> None:
        """Say how much is done.

        Args:
            what: is counted, as ``grasps``; ``%`` for a share.
            done: how much is done.
            of: how much there is.
            last: what was done last, or is being done.
        """
        now = time.perf_counter()
        if what != self._what:  # what an earlier run has done says nothing of the speed
            self._what, self._said = what, -1
            self._lately.clear()
            self._bar.reset(self._task, total=of, completed=int(done))
        self._lately.append((now, done))
        while len(self._lately) > LEAST and now - self._lately[1][0] > WINDOW:
            self._lately.popleft()
        percent = f"{100 * done // of:.0f} %"
        counted = "" if what == "%" else f"{done} of {of} {what}"
        self.reached = f"after {counted}" if counted else f"at {percent}"
        (then, before), left = self._lately[0], ""
        if before < done < of:
            left = f"about {duration((now - then) / (done - before) * (of - done))} left"
        words = ", ".join(filter(None, (counted, left))) + (f": {last}" if last else "")
        self._bar.update(self._task, completed=done, description=words.removeprefix(": "))
        if not self._bar.console.is_terminal and int(LINES * done // of) > self._said:
            self._said = int(LINES * done // of)
            click.echo(f"{percent:>5}{'' if words.startswith(':') else ', '}{words}", err=True)


@contextmanager
def steps(kept: str) -> Iterator[Steps]:
    """Progress of one command.

    Args:
        kept: what becomes of the work that is done at Ctrl-C.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        told = Steps(bar)
        try:
            yield told
        except KeyboardInterrupt:
            bar.stop()
            click.echo(f"stopped {told.reached}; {kept}", err=True)
            raise
