"""What the headline says while the planner works, and that an answer's words are not written over."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from preshape.app.browser_session import BrowserSession
from preshape.app.waiting import Waiting
from preshape.app.wire_format import encoded


class Headline:
    """What was said, in order."""

    def __init__(self) -> None:
        self.said: list[tuple[str, str]] = []

    def __call__(self, kind: str, title: str, words: str) -> None:
        self.said.append((title, words))


def widget() -> SimpleNamespace:
    return SimpleNamespace(value=0.0, visible=False, disabled=False, content="")


@pytest.fixture
def panel() -> Any:
    names = ("progress", "cancel", "run", "teach", "headline", "memory", "reset")
    return SimpleNamespace(**{name: widget() for name in names}, show_parts=lambda *_: None)


def test_the_seconds_are_told_until_the_answer_comes(panel: Any) -> None:
    say = Headline()
    waiting = Waiting(panel, say)
    waiting.begin("planning", lambda: True)
    assert panel.cancel.visible
    assert panel.run.disabled
    waiting.progress("looking at plane 3", 40.0)
    assert say.said == [("Working", "planning …"), ("Working", "looking at plane 3 …")]
    assert panel.progress.value == 40.0
    waiting.quiet()
    say("good", "Grasp found", "mode 0")
    waiting.progress("working out others", 90.0)  # more is done, but the words are the answer's
    assert say.said[-1] == ("Grasp found", "mode 0")
    assert panel.cancel.visible
    waiting.end()
    assert not panel.cancel.visible
    waiting.progress("late", 99.0)
    assert say.said[-1] == ("Grasp found", "mode 0")


def test_a_new_request_tells_its_seconds_again(panel: Any) -> None:
    say = Headline()
    waiting = Waiting(panel, say)
    waiting.begin("planning", lambda: True)
    waiting.quiet()
    waiting.end()
    waiting.begin("simulating", lambda: True)
    waiting.progress("pushing from six sides", 10.0)
    assert say.said[-1] == ("Working", "pushing from six sides …")


def replies() -> list[dict[str, Any]]:
    mesh = {
        "name": "cube",
        "vertices": encoded(np.zeros((3, 3)), "<f8"),
        "triangles": encoded([[0, 1, 2]], "<i8"),
        "extents": [0.04, 0.04, 0.04],
        "whole": 1,
        "parts": [],
        "part_of": encoded([-1], "<i8"),
    }
    return [{"mesh": mesh}, {"document": {"deadlock": False}}, {"run": {}}]


@pytest.mark.parametrize("reply", replies(), ids=["object", "plan", "physics"])
def test_no_tick_between_an_answer_and_its_end_writes_over_it(reply: dict[str, Any], panel: Any) -> None:
    """The planner says that it is done only after its answer, and the clock ticks whenever it likes."""
    say = Headline()
    session: Any = object.__new__(BrowserSession)
    session.panel, session._lock, session._say = panel, threading.RLock(), say
    session._waiting = waiting = Waiting(panel, say)
    session._after = session._pending = None
    session._start = SimpleNamespace(request=SimpleNamespace(memory=":memory:"))

    def headline(*_: Any) -> None:
        say("good", "Its own", "words")

    def run_taken(_: Any) -> bool:
        headline()
        return True

    session.playback = SimpleNamespace(stop=lambda: None, take=run_taken, follow=lambda: None)
    reading = SimpleNamespace(document=None, answer="answer", take=headline, forget=lambda: None)
    session.reading = SimpleNamespace(**vars(reading), headline=headline)
    session.trial = SimpleNamespace(drop=lambda: None, take=lambda run: None)
    session.stage = SimpleNamespace(put=lambda *_: None, look=lambda: None)
    session.steering = SimpleNamespace(show_parts=lambda *_: None)
    waiting.begin("working", lambda: True)
    session._heard(reply)
    own = say.said[-1]
    assert own[0] in ("cube", "Its own")
    waiting._tell()  # as the clock does, every half second
    assert say.said[-1] == own
    assert panel.cancel.visible  # it is not done yet
