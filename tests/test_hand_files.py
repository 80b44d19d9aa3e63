"""A hand that is a file: every command takes it to its end, from whatever folder its plans are read."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from preshape.cli.main import run
from preshape.cli.view import start_of_plan
from preshape.physics.grasps import read_grasps
from preshape.planning.request import PlanRequest

EXAMPLE = Path(__file__).parents[1] / "examples" / "hands" / "trident.toml"
pytestmark = pytest.mark.usefixtures("session_cache", "small_pictures")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, which holds the hand ``trident.toml``."""
    for file in EXAMPLE.parent.glob("trident.*"):
        shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def planned(folder: Path, once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """A plan of the hand given by a relative path; the working folder is another one now."""

    def make(path: Path) -> None:
        words = "plan box --task lift --hand trident.toml --memory :memory: --out"
        assert run([*words.split(), str(path)]) == 0

    made = once("plan-of-a-hand-file", make) / "plan.json"
    document = json.loads(made.read_text())
    # The folder of the hand is this test's.
    text = made.read_text().replace(document["hand"]["source"], str(folder / "trident.toml"))
    (folder / "elsewhere").mkdir()
    plan = folder / "elsewhere" / "plan.json"
    plan.write_text(text)
    return plan


def test_a_request_and_a_plan_name_the_file(planned: Path) -> None:
    document = json.loads(planned.read_text())
    source = document["hand"]["source"]
    assert (document["hand"]["name"], Path(source).is_absolute()) == ("trident", True)
    assert document["request"]["hand"] == source
    assert PlanRequest(source="box", task="lift", hand="trident.toml", table=None).to_json()["hand"] == source
    left = PlanRequest(source="box", task="lift", hand="trident.toml:left", table=None)
    assert left.hand_name == f"{source}:left"


@pytest.mark.parametrize(
    "words",
    [
        "simulate {plan}",
        "bench holds {plan} --workers 1",
        "export {plan} --format moveit --out out.yaml",
        "export {plan} --format mjcf --out out.xml",
    ],
)
def test_of_a_plan(words: str, planned: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(planned.parent)
    assert run(words.format(plan="plan.json").split()) == 0


def test_grasps_that_were_exported_name_the_file(planned: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(planned.parent)
    assert run("export plan.json --format npz --out grasps.npz".split()) == 0
    assert read_grasps("grasps.npz").hand == json.loads(planned.read_text())["hand"]["source"]
    assert run("simulate grasps.npz".split()) == 0


def test_the_app_starts_with_the_plan(planned: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(planned.parent)
    start = start_of_plan(Path("plan.json"))
    assert start.request.hand_name == json.loads(planned.read_text())["hand"]["source"]


def test_bench_tasks(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = "bench tasks --hand trident.toml --objects box --tasks lift --workers 1 --out out"
    assert run(words.split()) == 0
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir(folder / "elsewhere")
    assert run("bench tasks --grasps ../out/grasps.npz --objects box --tasks lift --workers 1".split()) == 0


def test_learn_and_forget(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("learn box --task lift --hand trident.toml --memory m.sqlite".split()) == 0
    capsys.readouterr()
    assert run("memory reset --hand trident.toml --yes --json --memory m.sqlite".split()) == 0
    assert json.loads(capsys.readouterr().out)["forgotten"] > 0


def test_dataset(folder: Path) -> None:
    assert run("dataset box --hands trident.toml --tasks lift --per 1 --out out --workers 1".split()) == 0
    assert len(list((folder / "out" / "shards").glob("*.parquet"))) == 1
