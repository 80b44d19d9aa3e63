"""``preshape bench planner``: what was lost is named, counted and drawn."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from preshape.cli.main import run
from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.settings import ClosureSettings
from preshape.exceptions import ObjectError
from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim, HandLayout
from preshape.objects.load import load_object
from preshape.physics.grasps import read_grasps
from preshape.physics.protocol import HoldProtocol
from preshape.planner import execute
from preshape.planning import planner_bench
from preshape.tasks import parse_task


def planned(cases: list[planner_bench.Case], hand: str, **_: object) -> list[planner_bench.Planned]:
    """As the planner, without the cube's lesson before: a grip of the box, and none of the mug."""
    model, mesh, task = load_hand(hand), load_object("box"), parse_task("lift")
    layout = HandLayout(name=hand, u=0.045, finger_pitch=0.022, fingertip_width=0.016)
    settings = ClosureSettings(everywhere=300, persistence=0, rounds=1, elite=8)
    analyser = ClosureAnalyser(mesh, model, layout, settings=settings)
    found = analyser.explore(task.q, Aim(planes=range(1, 13), values=np.linspace(-0.8, 0.8, 9)))
    grip = execute(model, mesh, found.grasp(), seed=0)
    return [
        planner_bench.Planned(case=case, answers=answers, mode=3, reason="too wide", seconds={})
        for case, answers in zip(cases, ((grip,), ()), strict=True)
    ]


def test_what_was_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With hardly any friction in the test what was planned for 0.6 falls out."""
    monkeypatch.setattr(planner_bench, "plan_cases", planned)
    out = tmp_path / "out"
    words = "bench planner box mug --friction 0.01 --workers 1 --json --out".split()
    assert run([*words, str(out)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert json.loads((out / "report.json").read_text()) == told
    assert (told["held"], told["tested"], told["without_answer"]) == (0, 2, ["mug@1"])
    none, lost = told["failures"]
    assert (none["object"], none["answer"], none["reason"]) == ("mug@1", None, "too wide")
    assert (lost["object"], lost["answer"]) == ("box@1", 1)
    assert lost["reason"].startswith("lost the object")
    (picture,) = told["pictures"]
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert("RGB"))
    assert pixels.shape[1] == 1400
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 500
    assert len(read_grasps(out / "grasps.npz")) == 1
    assert sorted(p.name for p in out.iterdir()) == ["grasps.npz", "lost-000-box.png", "report.json"]


def test_the_mass_is_planned_for_and_tested_with(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    planned_for: list[float] = []
    tested_with: list[float] = []

    def refuse(*_: object, closure: ClosureSettings, **__: object) -> None:
        planned_for.append(closure.mass)
        raise ObjectError("box: too wide")

    monkeypatch.setattr(planner_bench, "plan", refuse)
    assert run("bench planner box --mass 0.4 --json".split()) == 0
    assert planned_for == [0.4]
    assert json.loads(capsys.readouterr().out)["failures"][0]["reason"] == "box: too wide"

    def test(grasps: object, hand: object, *, protocol: HoldProtocol, **_: object) -> None:
        tested_with.append(protocol.mass)

    monkeypatch.setattr(planner_bench, "plan_cases", planned)
    monkeypatch.setattr(planner_bench, "run_holds", test)
    assert run("bench planner box mug --mass 0.4 --json".split()) == 0
    assert tested_with == [0.4]


@pytest.mark.parametrize("name", ["", " "])
def test_a_folder_without_a_name_is_refused_before_anything_is_planned(
    capsys: pytest.CaptureFixture[str], name: str
) -> None:
    assert run(["bench", "planner", "box", "--hand", "leap", "--out", name]) == 2
    assert "--out needs a folder" in capsys.readouterr().err
