"""The exact check of grips finds what is wrong with one, and nothing wrong with the planner's."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("hardening.grips", reason="the folder hardening is not here")

from hardening import grips

from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.settings import ClosureSettings
from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim, Grip
from preshape.objects.library import load_library_object
from preshape.planning.controllers import layout_of
from preshape.tasks import parse_task

pytestmark = pytest.mark.usefixtures("session_cache")
HAND, MESH = load_hand("allegro"), load_library_object("box")


@pytest.fixture(scope="module")
def grip() -> Grip:
    task = parse_task("lift")
    settings = ClosureSettings(everywhere=600, elite=8, rounds=1, finished=2, persistence=0)
    analyser = ClosureAnalyser(MESH, HAND, layout_of(HAND), settings=settings, gravity=task.gravity)
    found = analyser.explore(task.q, Aim(values=np.linspace(-0.9, 0.9, 19)))
    return found.grasp()


def moved(grip: Grip, way: np.ndarray) -> Grip:
    """The whole hand moved [m]."""
    pose = np.array(grip.palm_pose)
    pose[:3] += way
    return replace(grip, palm_pose=pose)


def test_the_planner_s_grip_has_no_flaw(grip: Grip) -> None:
    assert grips.flaws(HAND, MESH, grip) == []


def test_a_thumb_in_the_object_is_deep_and_a_hand_far_away_does_not_touch(grip: Grip) -> None:
    thumb = grip.forces[0] / np.linalg.norm(grip.forces[0])
    assert any("deep in the object" in flaw for flaw in grips.flaws(HAND, MESH, moved(grip, 0.003 * thumb)))
    away = grips.flaws(HAND, MESH, moved(grip, -0.3 * grip.approach))
    assert away == [f"{finger} does not touch" for finger in grip.fingers_touching]


def test_one_finger_that_does_not_touch_is_found_out(grip: Grip) -> None:
    for finger in grip.fingers_touching:
        opened = np.array(grip.grasp)
        opened[HAND.columns(finger)] = grip.pregrasp[HAND.columns(finger)]
        found = grips.flaws(HAND, MESH, replace(grip, grasp=opened))
        assert f"{finger} does not touch" in found


def test_a_hand_that_opens_or_comes_the_wrong_way_is_found_out(grip: Grip) -> None:
    closed = replace(grip, pregrasp=grip.squeeze)
    assert any("touches when opened" in flaw for flaw in grips.flaws(HAND, MESH, closed))
    through = replace(grip, approach=-grip.approach)
    assert any("before the end of its way in" in flaw for flaw in grips.flaws(HAND, MESH, through))


def test_a_run_counts_every_answer_and_a_finished_one_begins_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    looked: list[str] = []

    def look(file: str, factor: float, hand: str, task: str, count: int, seed: int) -> dict[str, object]:
        looked.append(f"{Path(file).name} {hand} {task}")
        if file == "mug":
            return {"answers": 0, "flaws": [], "reason": "too wide"}
        return {
            "answers": 3,
            "flaws": [["palm is deep in the object"]] if hand == "leap" else [],
            "reason": "",
        }

    monkeypatch.setattr(grips, "look", look)
    words = ["--hands", "shadow,leap", "--tasks", "lift,turn", "--out", str(tmp_path)]
    monkeypatch.setattr("preshape.objects.library.names", lambda: ("box", "mug"))
    assert grips.main([*words, "--limit", "1"]) == 1
    assert looked == ["box shadow lift", "box shadow turn", "box leap lift", "box leap turn"]
    assert grips.main(words) == 1
    assert looked[4:8] == looked[:4]
    assert looked[8:] == ["mug shadow lift", "mug shadow turn", "mug leap lift", "mug leap turn"]
    told = json.loads((tmp_path / "grips.json").read_text())
    assert (told["asked"], told["answered"], told["answers"], told["sound"]) == (8, 4, 12, 10)
    assert [row["reason"] for row in told["without_answer"]] == ["too wide"] * 4
    assert "answered 4 of 8; sound 10 of 12" in capsys.readouterr().out
    assert grips.main(["--hands", "shadow", "--out", str(tmp_path)]) == 0


def test_a_run_that_was_stopped_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[str] = []

    def look(file: str, factor: float, hand: str, task: str, count: int, seed: int) -> dict[str, object]:
        if len(looked) == 2:
            looked.append("stopped")
            raise KeyboardInterrupt
        looked.append(hand)
        return {"answers": 1, "flaws": [], "reason": ""}

    monkeypatch.setattr(grips, "look", look)
    words = ["--hands", "shadow,leap,allegro", "--limit", "1", "--out", str(tmp_path)]
    assert grips.main(words) == 130
    with (tmp_path / "grips.jsonl").open("a") as log:
        log.write('{"key": "torn')
    assert grips.main(words) == 0
    assert looked == ["shadow", "leap", "stopped", "allegro"]
    assert json.loads((tmp_path / "grips.json").read_text())["answers"] == 3


@pytest.mark.parametrize("words", [["--hands", "shadw"], ["--tasks", "lit"]])
def test_a_slip_of_the_pen_is_no_sound_run(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert grips.main([*words, "--out", str(tmp_path)]) == 2
    assert "did you mean" in capsys.readouterr().err


def test_nothing_to_plan_for_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert grips.main([str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "no objects" in capsys.readouterr().err


def test_one_object_is_planned_and_checked() -> None:
    row = grips.look("box", 1.0, "allegro", "lift", 1, 0)
    assert (row["answers"], row["flaws"]) == (1, [])
    refused = grips.look("box", 1e-9, "allegro", "lift", 1, 0)
    assert refused["answers"] == 0
    assert refused["reason"]
