"""A planner process of ``preshape serve``: plans for HTTP, and commands for this user's command line."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..serve.worker import Say, WarmPlanner, serve
from . import plan as plan_command
from .main import run
from .streams import prepare_encodings

if TYPE_CHECKING:
    from ..planning.request import PlanRequest
    from ..planning.session import Progress, Session


class _Sent(io.TextIOBase):
    """A standard stream whose text is sent to the command line that has asked.

    Args:
        send: Sends a text.
        terminal: Whether the stream is a terminal there.
        encoding: Its encoding.
    """

    def __init__(self, send: Callable[[str], None], *, terminal: bool, encoding: str) -> None:
        self._send, self._terminal, self._encoding = send, terminal, encoding

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The encoding of the stream there, which decides what a table is drawn with."""
        return self._encoding

    def isatty(self) -> bool:
        """Whether the stream is a terminal there."""
        return self._terminal

    def writable(self) -> bool:
        """Always."""
        return True

    def write(self, text: str) -> int:
        """Send a text."""
        if not isinstance(text, str):  # Click finds out what a stream takes by trying
            raise TypeError(f"a text stream takes no {type(text).__name__}")
        if text:
            self._send(text)
        return len(text)


def main(arguments: list[str]) -> None:
    """Serve until standard input ends.

    Args:
        arguments: The memory's file, or nothing for the user's, and the hands to warm up for.
    """
    memory, *hands = arguments
    planner = WarmPlanner(memory or None)
    prepare_encodings()

    @contextmanager
    def lent(request: PlanRequest, learn: bool, told: Progress) -> Iterator[Session]:
        kept = None if request.memory is None else os.path.abspath(os.path.expanduser(request.memory))
        session = planner.session(replace(request, memory=kept)).session
        session.progress = told
        try:
            yield session
        finally:
            session.progress = None

    plan_command.session_for = lent

    def answer(message: dict[str, Any], say: Say) -> None:
        if message["do"] == "command":
            _run_command(message["command"], say)
        else:
            say({"text": planner.plan(message["request"], message["names"]), "done": True})

    serve(answer, lambda: planner.warm(hands))


def _run_command(command: dict[str, Any], say: Say) -> None:
    """Run a command in the folder and the environment of the command line that has asked."""
    from ..hands.load import say_guesses_again

    say({"begun": True})  # what takes long is the command, not a server that is busy
    environment, streams = dict(os.environ), (sys.stdout, sys.stderr)
    try:
        os.chdir(command["folder"])
        os.environ.clear()
        os.environ.update(command["environment"])
        sys.stdout, sys.stderr = (
            _Sent(lambda text, name=name: say({name: text}), **command["streams"][name])  # type: ignore[misc]
            for name in ("out", "err")
        )
        say_guesses_again()
        code = run(command["arguments"])
    finally:
        os.environ.clear()
        os.environ.update(environment)
        sys.stdout, sys.stderr = streams
        os.chdir(os.sep)
    say({"code": code, "done": True})


if __name__ == "__main__":
    main(sys.argv[1:])
