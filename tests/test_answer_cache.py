"""Answers of the cache: what is kept, when it is used again, and what leaves it unused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from preshape.cli import plan as plan_command
from preshape.cli.main import main
from preshape.memory import Memory
from preshape.planning import answer_cache
from preshape.planning.answer_cache import answer_key
from preshape.planning.request import PlanRequest

BOX = "".join(f"v {x} {y} {z}\n" for x in (0, 0.04) for y in (0, 0.05) for z in (0, 0.06))
BOX += "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
Asked = Callable[..., tuple[Any, bool]]


@pytest.fixture
def ask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Asked:
    """Plans box.obj by the command line; gives the document without times, and whether there was a search."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path / "cache"))
    Path("box.obj").write_text(BOX)
    searched: list[bool] = []
    own = plan_command.session_for

    def session_for(*given: Any) -> Any:
        searched.append(True)
        return own(*given)

    monkeypatch.setattr(plan_command, "session_for", session_for)

    def asked(*more: str, memory: str = "memory.sqlite") -> tuple[Any, bool]:
        searched.clear()
        words = ["plan", "box.obj", "--task", "lift", "--hand", "utah_mit", "--json", "--memory", memory]
        with pytest.raises(SystemExit) as end:
            main([*words, *more])
        document = json.loads(capsys.readouterr().out)
        document.pop("seconds", None)
        document["code"] = end.value.code
        return document, bool(searched)

    return asked


def settled(ask: Asked) -> Any:
    """The answer that no longer teaches the memory anything, kept in the cache."""
    assert ask()[1]
    for _ in range(3):
        document, searched = ask()
        if not searched:
            return document
    raise AssertionError("the answer was never kept")


def test_the_same_request_is_answered_the_same_without_a_search(ask):
    document = settled(ask)
    assert document == ask()[0]
    assert (document["status"], document["code"]) == ("answer", 0)
    for other in (("--count", "2"), ("--seed", "1"), ("--up", "y"), ("--no-learn",)):
        assert ask(*other)[1], other


@pytest.mark.parametrize("change", ["lesson", "mesh", "sidecar", "damage", "program"])
def test_what_changes_leaves_the_answer_unused(ask, change, monkeypatch):
    document = settled(ask)
    if change == "lesson":
        with Memory.open("memory.sqlite") as memory:
            memory.add([memory.experiences()[-1]])
    elif change == "mesh":
        Path("box.obj").write_text(BOX.replace("0.06", "0.07"))
    elif change == "sidecar":
        Path("box.preshape.toml").write_text("mass = 0.2\n")
    elif change == "damage":
        for file in Path("cache/answers").glob("*.json"):
            file.write_text(file.read_text().replace("reward", "rewart", 1))
    else:
        monkeypatch.setattr(answer_cache, "_program", lambda: "another version")
    again, searched = ask()
    assert searched
    if change in ("damage", "program"):
        assert again == document


def test_an_answer_that_depends_on_other_files_is_not_kept(ask, tmp_path):
    ask()
    named = {"task": "lift", "memory": "memory.sqlite"}
    assert answer_key(PlanRequest(source="box.obj", **named)) is not None
    assert answer_key(PlanRequest(source="box.gltf", **named)) is None
    assert answer_key(PlanRequest(source="box.obj", obstacle="wall.glb", **named)) is None
    assert answer_key(PlanRequest(source="box.obj", hand="own.toml", **named)) is None
    assert answer_key(PlanRequest(source="box.obj", task="lift", memory=":memory:")) is None
    assert answer_key(PlanRequest(source="box.obj", task="lift", memory="none.sqlite")) is None
    wall = PlanRequest(source="box.obj", obstacle="wall.obj", **named)
    before = answer_key(wall)
    (tmp_path / "wall.obj").write_text(BOX)
    assert answer_key(wall) != before


def test_the_oldest_answers_go_and_a_cache_that_cannot_be_written_is_no_fault(tmp_path, monkeypatch):
    monkeypatch.setattr(answer_cache, "MOST", 2)
    monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path / "cache"))
    for k in range(4):
        answer_cache.keep_answer(str(k), {"number": k}, 1)
    kept = [answer_cache.known_answer(str(k)) for k in range(4)]
    assert kept[:2] == [None, None]
    assert kept[2:] == [({"number": k}, 1) for k in (2, 3)]
    (tmp_path / "file").touch()
    monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path / "file"))
    answer_cache.keep_answer("5", {}, 0)
    assert answer_cache.known_answer("5") is None
