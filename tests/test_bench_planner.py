"""``preshape bench planner``: what was lost is named, counted and drawn."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from preshape.cli.bench_planner import cases_of
from preshape.cli.main import run
from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.settings import ClosureSettings
from preshape.exceptions import ObjectError
from preshape.hands.hand import Hand
from preshape.hiis.analyser import Aim, HandLayout
from preshape.objects.load import load_object
from preshape.physics.grasps import GraspSet, read_grasps
from preshape.physics.hold.report import HoldReport
from preshape.physics.hold.six_directions import HoldResult, HoldStatus
from preshape.physics.protocol import HoldProtocol
from preshape.planning import planner_bench
from preshape.planning.answers import Answer
from preshape.planning.hand_simulation import execute
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session
from preshape.tasks import parse_task

EXAMPLE = Path(__file__).parents[1] / "examples" / "hands" / "trident.toml"


def planned(cases: list[planner_bench.Case], hand: Hand, **_: object) -> list[planner_bench.Planned]:
    """As the planner, without the cube's lesson before: a grip of the box, and none of the mug."""
    mesh, task = load_object("box"), parse_task("lift")
    layout = HandLayout(name=hand.name, u=0.045, finger_pitch=0.022, fingertip_width=0.016)
    settings = ClosureSettings(everywhere=300, persistence=0, rounds=1, elite=8)
    analyser = ClosureAnalyser(mesh, hand, layout, settings=settings)
    found = analyser.explore(task.q, Aim(planes=range(1, 13), values=np.linspace(-0.8, 0.8, 9)))
    grasp = found.grasp()
    grip = Answer(grasp=grasp, hand_result=execute(hand, mesh, grasp, seed=0))
    return [
        planner_bench.Planned(case=case, answers=answers, mode=3, reason="too wide", seconds={}, mass=0.7)
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


def test_a_hand_of_a_file_to_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The hand is not looked up again by its bare name, and its grasps say which file it is."""
    monkeypatch.setattr(planner_bench, "plan_cases", planned)
    for file in EXAMPLE.parent.glob("trident.*"):
        shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)
    words = "bench planner box mug --hand trident.toml --friction 0.01 --workers 1 --out out"
    assert run(words.split()) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert (report["hand"], report["tested"], len(report["pictures"])) == ("trident", 2, 1)
    assert read_grasps("out/grasps.npz").hand == str(tmp_path / "trident.toml")
    capsys.readouterr()
    assert run("bench holds out/grasps.npz --workers 1 --json".split()) == 0
    assert json.loads(capsys.readouterr().out)["hands"][0]["hand"] == "trident"


def test_the_mass_is_planned_for_and_tested_with(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    planned_for: list[float | None] = []
    tested_with: list[float] = []

    def refuse(_: Session, request: PlanRequest) -> None:
        planned_for.append(request.mass)
        raise ObjectError("box: too wide")

    monkeypatch.setattr(Session, "run", refuse)
    assert run("bench planner box --mass 0.4 --json".split()) == 0
    assert json.loads(capsys.readouterr().out)["failures"][0]["reason"] == "box: too wide"
    assert run("bench planner box --json".split()) == 0
    assert run("bench planner box --mass own --json".split()) == 0
    assert planned_for == [0.4, 0.1, None]
    assert run("bench planner box --mass heavy".split()) == 2
    assert "--mass takes a number of kilograms or own, got 'heavy'" in capsys.readouterr().err

    def test(grasps: GraspSet, hand: object, *, protocol: HoldProtocol, **_: object) -> HoldReport:
        tested_with.append(protocol.mass)
        held = HoldResult(row=0, object_name="box", scale=1.0, status=HoldStatus.HELD, reason="held")
        return HoldReport(grasps=grasps, results=(held,) * len(grasps), seconds=0.0)

    monkeypatch.setattr(planner_bench, "plan_cases", planned)
    monkeypatch.setattr(planner_bench, "run_holds", test)
    assert run("bench planner box mug --mass 0.4 --json".split()) == 0
    assert run("bench planner box mug --mass own --json".split()) == 0
    assert tested_with == [0.4, 0.7]
    assert [json.loads(part + "}")["mass"] for part in capsys.readouterr().out.split("\n}")[:-1]] == [
        0.4,
        "own",
    ]


def test_a_folder_does_not_shadow_a_library_object(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("bottle", "scans"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.obj").write_text("")
    monkeypatch.chdir(tmp_path)
    sources = [case.source for case in cases_of(("bottle", "scans", "bottle/"), "1", None)]
    assert sources == ["bottle", str(Path("scans") / "a.obj"), str(Path("bottle") / "a.obj")]


@pytest.mark.parametrize("name", ["", " "])
def test_a_folder_without_a_name_is_refused_before_anything_is_planned(
    capsys: pytest.CaptureFixture[str], name: str
) -> None:
    assert run(["bench", "planner", "box", "--hand", "leap", "--out", name]) == 2
    assert "--out needs a folder" in capsys.readouterr().err
