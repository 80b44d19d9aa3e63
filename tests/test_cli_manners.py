"""Manners of the command line: settings of a file, completion in the shell, and what --verbose says."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from preshape.cli.main import main
from preshape.hands.load import hand_names
from preshape.objects.library import names
from preshape.tasks import family_names

CUBE = ["plan", "cube", "--task", "1 1 .1 .05 .8 .05", "--hand", "utah_mit"]
BARE = CUBE[:-2]
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """The command line in a folder of its own, and with a configuration folder of its own."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("PRESHAPE_MEMORY", str(tmp_path / "memory.sqlite"))
    monkeypatch.setenv("COLUMNS", "400")

    def ran(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as end:
            main(list(arguments))
        out, err = capsys.readouterr()
        return int(end.value.code or 0), out, err

    return ran


def write(text: str, folder: str = ".") -> Path:
    file = Path(folder) / "preshape.toml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return file.absolute()


def test_settings_are_those_of_the_working_folder_then_of_the_user(run, tmp_path, monkeypatch):
    monkeypatch.delenv("PRESHAPE_MEMORY")
    user = write('hand = "utah_mit"\nmemory = "user.sqlite"\n', str(tmp_path / "config" / "preshape"))
    code, out, err = run(*BARE, "--json")
    plan = json.loads(out)
    assert (code, err) == (0, "")  # with --json nothing is said
    assert plan["request"]["hand"] == "utah_mit"
    assert plan["request"]["memory"] == str(user.parent / "user.sqlite")
    own = write('hand = "utah_mit:left"\nmemory = "own.sqlite"\n')
    code, out, err = run(*BARE)
    assert code == 0
    assert err.splitlines()[0] == (
        f"settings of {own}: hand utah_mit:left, memory {own.parent / 'own.sqlite'}"
    )
    code, out, err = run(*CUBE, "--memory", ":memory:", "--json")
    plan = json.loads(out)
    assert (plan["request"]["hand"], plan["request"]["memory"]) == ("utah_mit", ":memory:")
    code, out, err = run("memory", "show", "--json")
    assert json.loads(out)["path"] == str(own.parent / "own.sqlite")


def test_a_memory_of_the_environment_wins_over_the_file(run, tmp_path):
    write('hand = "utah_mit"\nmemory = "own.sqlite"\n')
    assert "own.sqlite" not in run(*CUBE)[2]
    assert json.loads(run("memory", "show", "--json")[1])["path"] == str(tmp_path / "memory.sqlite")


def test_table_and_mass_of_the_file_reach_the_request(run):
    write('hand = "utah_mit"\ntable = false\nmass = 0.25\n')
    code, out, _ = run(*CUBE, "--json")
    assert code == 2  # the paper's hand knows no mass, and the message is the usual one
    assert "friction and mass need a real hand" in json.loads(out)["reason"]
    write('hand = "utah_mit"\ntable = -0.02\n')
    assert "a table, boxes to avoid" in json.loads(run(*CUBE, "--json")[1])["reason"]
    assert run(*CUBE, "--table", "none", "--json")[0] == 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('hnad = "leap"', "no key 'hnad'; did you mean hand? Known: hand, table, mass, memory"),
        ("[plan]\nhand = 'leap'", "no key 'plan'; did you mean hand? Known: hand, table, mass, memory"),
        ("hand = 3", "hand must be the name or the file of a hand, got 3"),
        ("mass = 'much'", "mass must be a number of kilograms, got 'much'"),
        ("mass = true", "mass must be a number of kilograms"),
        ("table = []", "table must be auto, none or a height"),
        ("memory = ''", "memory must be the path of a file"),
        ("hand = ", "is no TOML"),
        ("a = " + "[" * 5000, "is no TOML"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(run, text, words):
    file = write(text)
    code, out, _ = run(*CUBE, "--json")
    reason = json.loads(out)["reason"]
    assert code == 2
    assert words in reason
    assert str(file) in reason
    assert run("tasks")[0] == 0  # commands without such settings do not care
    assert run("plan", "--help")[0] == 0


def test_the_app_takes_only_the_memory_for_a_plan_that_exists(run, tmp_path, monkeypatch):
    Path("plan.json").write_text(run(*CUBE, "--json")[1])
    write('hand = "leap"\nmass = 3\n')
    started = []
    monkeypatch.setattr("preshape.app.server.ViewServer", lambda start, **_: started.append(start))
    run("view", "plan.json")
    assert started[0].request.hand_name == "utah_mit"


def completed(run: Run, words: str, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setenv("_PRESHAPE_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", f"preshape {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split(" "))))
    code, out, _ = run()
    assert code == 0
    return out.split()


def test_the_shell_completes_names(run, monkeypatch):
    write("nonsense")  # a faulty file does not disturb
    for words, known in (
        ("plan m", [name for name in names() if name.startswith("m")]),
        ("learn mug pe", [name for name in names() if name.startswith("pe")]),
        ("plan mug --task p", [name for name in family_names() if name.startswith("p")]),
        ("view mug --hand s", [name for name in hand_names() if name.startswith("s")]),
        ("pl", ["plan"]),
    ):
        found = completed(run, words, monkeypatch)
        assert [word.removeprefix("plain,") for word in found if word.startswith("plain,")] == known
    assert completed(run, "plan no_such", monkeypatch) == ["file,no_such"]


def test_verbose_tells_the_stages_in_order(run):
    code, out, err = run(*CUBE, "--json", "--verbose")
    assert code == 0
    assert json.loads(out)["status"] == "answer"
    lines = err.splitlines()
    assert all(re.match(r" +\d+\.\d\d s  ", line) for line in lines)
    told = [line.split(" s  ")[1] for line in lines]
    assert told[0] == "reading object, task and hand"
    assert any(words.startswith("  mode 0, reward: ") for words in told)
    assert told[-1].startswith("the hand tries answer 1")


def test_verbose_tells_what_the_search_finds(run, lesson):
    code, out, err = run(
        "plan", "box", "--task", "lift", "--hand", "allegro", "--memory", str(lesson("allegro")),
        "--no-learn", "--json", "--verbose",
    )  # fmt: skip
    assert code == 0, out
    assert re.search(
        r"\d+ candidates: \d+ closed, \d+ clear of obstacles and rules, \d+ balance the load", err
    )
    assert re.search(r"\d+ examined, \d+ sound, \d+ finished; best quality \d", err)
    plan = json.loads(out)
    for step in plan["transitions"]:
        assert f"mode {step['mode']}, {step['outcome']}: {step['reason']}" in err
