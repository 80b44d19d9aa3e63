"""What long commands say on the way: lines of a log, the time left, and the last word at Ctrl-C."""

from __future__ import annotations

import re
import threading

import pytest
from rich.progress import Progress

from preshape.cli import main as cli
from preshape.cli import progress
from preshape.cli.progress import GOES_ON, LINES, WINDOW, TimeLeft, duration, steps, waiting
from preshape.exceptions import Cancelled
from preshape.planning import planner_bench


class Clock:
    """Stands still until it is moved."""

    now = 0.0

    def perf_counter(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    found = Clock()
    monkeypatch.setattr(progress, "time", found)
    return found


def test_a_log_gets_a_line_every_twentieth_with_the_time_that_is_left(clock: Clock, capsys) -> None:
    with steps(GOES_ON) as told:
        for done in range(1000, 2001):  # 1000 are of an earlier run and say nothing of the speed
            told.step("grasps", done, 2000)
            clock.now += 0.2
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == " 50 %, 1000 of 2000 grasps"
    assert lines[1] == " 55 %, 1100 of 2000 grasps, about 3 min left"
    assert lines[-2] == " 95 %, 1900 of 2000 grasps, about 20 s left"
    assert lines[-1] == "100 %, 2000 of 2000 grasps"
    assert len(lines) == LINES // 2 + 1


def test_each_kind_of_work_has_its_own_lines_and_speed(clock: Clock, capsys) -> None:
    with steps(GOES_ON) as told:
        for what, seconds in (("planned", 1.0), ("tested", 20.0)):
            for done in range(5):
                told.step(what, done, 4)
                clock.now += seconds
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(", ")[1] for line in lines] == [
        f"{done} of 4 {what}" for what in ("planned", "tested") for done in range(5)
    ]
    assert [re.findall(r"about (.*) left", line) for line in lines] == [
        [], ["3 s"], ["2 s"], ["1 s"], [], [], ["60 s"], ["40 s"], ["20 s"], []
    ]  # fmt: skip


def test_the_estimate_follows_the_last_minutes(clock: Clock, capsys) -> None:
    with steps(GOES_ON) as told:
        for done in range(1, 101):
            told.step("grasps", done, 400)  # in no time: an earlier run's
        for done in range(101, 121 + int(WINDOW)):
            clock.now += 1.0
            told.step("grasps", done, 400)
    assert capsys.readouterr().err.splitlines()[-1].endswith("240 of 400 grasps, about 3 min left")


def test_a_share_is_told_without_a_count_and_with_what_is_done(clock: Clock, capsys) -> None:
    with steps(GOES_ON) as told:
        told.step("%", 0.0, 1.0, "drawing")
        clock.now = 10.0
        told.step("%", 0.25, 1.0, "testing")
        told.step("%", 0.26, 1.0, "testing")
    assert capsys.readouterr().err.splitlines() == ["  0 %: drawing", " 25 %, about 30 s left: testing"]


def test_what_is_prepared_is_told_now_and_then(clock: Clock, capsys) -> None:
    with steps(GOES_ON) as told:
        for k in range(10):
            told.prepare(f"convex pieces of {k}")
            clock.now += 2.0
    assert capsys.readouterr().err.splitlines() == [f"convex pieces of {k}" for k in (3, 6, 9)]


@pytest.mark.parametrize(
    ("done", "sentence"),
    [
        ([], "stopped while preparing; it is kept"),
        ([("shards made", 2, 9)], "stopped after 2 of 9 shards made; it is kept"),
        ([("%", 0.5, 1.0)], "stopped at 50 %; it is kept"),
    ],
)
def test_the_last_word_says_how_far_it_came(done, sentence: str) -> None:
    def work() -> None:
        with steps("it is kept") as told:
            for step in done:
                told.step(*step)
            raise KeyboardInterrupt

    with pytest.raises(Cancelled) as stopped:
        work()
    assert str(stopped.value) == sentence


def test_a_terminal_shows_one_bar_and_a_file_s_name_as_it_is(monkeypatch, capsys) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with steps(GOES_ON) as told:
        told.prepare("convex pieces of a[bold].obj")
        told._bar.refresh()
        first = capsys.readouterr().err
        told.step("objects", 3, 4, "mug[1]")
        told._bar.refresh()
    second = capsys.readouterr().err
    assert "convex pieces of a[bold].obj" in first
    assert "3 of 4 objects: mug[1]" in second
    assert "75 %" in second
    assert "75 %," not in second  # no line of a log


def test_the_planner_s_bench_says_how_far_it_came(monkeypatch, capsys) -> None:
    def interrupted(cases, hand, *, progress, **_: object) -> None:
        progress("planned", 1, len(cases))
        raise KeyboardInterrupt

    monkeypatch.setattr(planner_bench, "plan_cases", interrupted)
    assert cli.run(["bench", "planner", "mug", "box"]) == 130
    assert capsys.readouterr().err.splitlines() == [
        " 50 %, 1 of 2 planned",
        "stopped after 1 of 2 planned; this bench keeps nothing before its end",
    ]


def test_the_time_left_follows_the_step_that_tells_its_progress_and_else_the_whole(clock: Clock) -> None:
    left = TimeLeft()
    assert left.words("reading", 0.0) == ""
    clock.now = 2.0
    assert left.words("looking for grasps", 20.0) == "about 8 s left: "
    assert left.words("trying answer 1 of 2: squeeze", 40.0) == "about 3 s left: "
    clock.now = 12.0  # ten seconds for ten hundredths, whatever the earlier steps took
    assert left.words("trying answer 1 of 2: force +x", 50.0) == "about 50 s left: "
    clock.now = 22.0
    assert left.words("trying answer 2 of 2: squeeze", 60.0) == "about 40 s left: "
    assert left.words("trying answer 2 of 2: done", 100.0) == ""


def test_waiting_shows_nothing_before_its_time_and_nothing_without_a_terminal(monkeypatch, capsys) -> None:
    with waiting() as told:
        told("looking for grasps", 35.0)
    assert capsys.readouterr().err == ""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TTY_INTERACTIVE", "1")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(progress, "DELAY", 3600.0)
    with waiting() as told:
        told("looking for grasps", 35.0)
    assert capsys.readouterr().err.strip() == ""
    monkeypatch.setattr(progress, "DELAY", 0.0)
    shown = threading.Event()
    monkeypatch.setattr(Progress, "start", lambda bar, start=Progress.start: (start(bar), shown.set()))
    with waiting() as told:
        assert shown.wait(30.0)
        told("looking at \x1b[2J[bold]", 35.0)
        told("trying answer 1 of 6", 40.0)
    said = capsys.readouterr().err
    assert "loading" in said
    assert "trying answer 1 of 6" in said
    assert "\x1b[2J" not in said


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.4, "0 s"), (89.4, "89 s"), (90, "2 min"), (3600, "60 min"), (5400, "1.5 h"), (36000, "10.0 h")],
)
def test_times_for_people(seconds: float, words: str) -> None:
    assert duration(seconds) == words
