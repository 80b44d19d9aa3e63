"""The command line on good input: modes, exit codes, JSON, memory, lists, help, interruption."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import click
import jsonschema
import numpy as np
import pytest
from click.core import ParameterSource

from papers_hand import of_the_papers_hand
from preshape.cli import main as cli
from preshape.cli.commands import app
from preshape.exceptions import InputError
from preshape.hands.load import load_hand
from preshape.hiis.controller import Controller
from preshape.hiis.learning import seed_cube
from preshape.hiis.planes import allowed_planes
from preshape.memory import Memory
from preshape.objects.library import load_library_object, names
from preshape.planning.controllers import layout_of
from preshape.planning.document import plan_schema
from preshape.studies.run import EXPERIMENTS
from preshape.tasks import FAMILIES, all_named_tasks, parse_task

pytestmark = pytest.mark.usefixtures("small_pictures")

LAYOUT = layout_of(load_hand("utah_mit"))
Q1 = "1 1 .1 .05 .8 .05"
UNFIT = "0 0 0 2 2 2"
"""A task that no grasp of the cube comes near (2.0 of 6 at most)."""

PLAN = jsonschema.Draft202012Validator(plan_schema())
COMMANDS = (
    "plan",
    "dataset",
    "learn",
    "objects",
    "tasks",
    "hands",
    "memory",
    "view",
    "serve",
    "simulate",
    "bench",
    "export",
    "reproduce",
)
HELPS = [
    [],
    *([command] for command in COMMANDS),
    *(["memory", command] for command in ("show", "export", "import", "reset")),
    *(
        ["bench", command]
        for command in (
            "holds",
            "hands",
            "planner",
            "pick",
            "tasks",
            "critic",
            "indices",
            "clouds",
            "learning",
        )
    ),
    ["hands", "check"],
    ["hands", "init"],
]


@pytest.fixture(scope="session")
def cube_only(tmp_path_factory) -> Path:
    """A memory after its first training."""
    path = tmp_path_factory.mktemp("cli") / "cube.sqlite"
    with Memory.open(path) as memory:
        Controller(memory, LAYOUT)
    return path


@pytest.fixture(scope="session")
def with_mug(cube_only, tmp_path_factory) -> Path:
    """One that has met the mug too."""
    path = Path(shutil.copy(cube_only, tmp_path_factory.mktemp("cli") / "mug.sqlite"))
    with Memory.open(path) as memory:
        Controller(memory, LAYOUT).teach(load_library_object("mug"), parse_task("pour"))
    return path


@pytest.fixture(autouse=True)
def own_memory(cube_only, tmp_path, monkeypatch) -> Path:
    """The default memory of every test: its own copy; the user's is never touched."""
    path = Path(shutil.copy(cube_only, tmp_path / "default.sqlite"))
    monkeypatch.setenv("PRESHAPE_MEMORY", str(path))
    monkeypatch.setenv("COLUMNS", "100")
    return path


@pytest.fixture(scope="module")
def known_cube(tmp_path_factory) -> str:
    """A file of the cube of the first lesson, which every memory knows."""
    mesh = seed_cube(LAYOUT)
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.triangles.tolist()]
    path = tmp_path_factory.mktemp("known") / "known.obj"
    path.write_text("\n".join(lines))
    return str(path)


@pytest.fixture
def run(capsys):
    """Run a command line: exit code, standard output, standard error."""

    def call(*arguments: str) -> tuple[int, str, str]:
        capsys.readouterr()
        code = cli.run(of_the_papers_hand(arguments))
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return code, out, err

    return call


@pytest.fixture
def run_json(run):
    """Run with --json: exit code and the one object on standard output; nothing on standard error."""

    def call(*arguments: str) -> tuple[int, dict]:
        code, out, err = run(*arguments, "--json")
        document = json.loads(out)
        assert isinstance(document, dict)
        assert err.strip() == ""
        if arguments[0] == "plan":
            PLAN.validate(document)
            assert code == (0 if document["status"] == "answer" else 1)
        return code, document

    return call


def timeless(document: dict) -> dict:
    """A plan without what may differ from run to run."""
    return {
        **{key: content for key, content in document.items() if key != "seconds"},
        "request": {key: content for key, content in document["request"].items() if key != "memory"},
        "alternatives": [timeless(other) for other in document["alternatives"]],
    }


def process(*arguments: str, **options) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "preshape", *of_the_papers_hand(arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, encoding="utf-8", timeout=300, **options, check=False
    )


# -- the four modes ------------------------------------------------------------------------------------


def test_a_trained_task_is_answered_at_mode_0(run, run_json):
    code, document = run_json("plan", "cube", "--task", Q1)
    assert (code, document["mode"], document["status"]) == (0, 0, "answer")
    assert document["task"]["q"] == [1, 1, 0.1, 0.05, 0.8, 0.05]
    code, out, err = run("plan", "cube", "--task", Q1)
    assert code == 0
    assert err == ""
    assert f"plane {document['plane']}" in out
    assert document["reason"] in " ".join(out.replace("│", " ").split())


def test_a_task_beside_the_trained_ones_is_answered_at_mode_1(cube_only, run_json):
    c = Controller(Memory.open(cube_only, read_only=True), LAYOUT)
    cube = c.prepare(load_library_object("cube"))
    task = next(t for t in all_named_tasks() if c.run(cube, t, may_learn=False).mode == 1)
    code, document = run_json("plan", "cube", "--task", task.label)
    assert (code, document["mode"], document["status"]) == (0, 1, "answer")
    assert [(t["mode"], t["outcome"]) for t in document["transitions"]] == [(0, "penalty"), (1, "reward")]


def test_task_correction_and_then_the_first_offer(run, run_json, known_cube):
    code, document = run_json("plan", known_cube, "--task", UNFIT)
    assert (code, document["mode"], document["status"]) == (1, 2, "task_correction")
    assert 1 <= len(document["offers"]) <= 3
    _, out, _ = run("plan", known_cube, "--task", UNFIT)
    assert "The known object does not fit this task" in out
    for offer in document["offers"]:
        assert offer["task"] in out
        code, answer = run_json("plan", known_cube, "--task", offer["task"])
        assert (code, answer["mode"]) == (0, offer["mode"])
        assert answer["tfvadi"] == pytest.approx(offer["tfvadi"])
        assert answer["task"]["q"] == offer["q"]


def test_an_unknown_object_is_learnt_at_mode_3_and_known_from_then_on(run_json):
    name, first = next(
        (name, document)
        for name in ("mug", "bowl", "pen", "dolphin")
        for _, document in [run_json("plan", name, "--task", "lift", "--no-learn")]
        if document["mode"] == 3 and document["status"] == "answer"
    )
    code, learnt = run_json("plan", name, "--task", "lift")
    assert (code, learnt["mode"]) == (0, 3)
    assert "learned" in [t["outcome"] for t in learnt["transitions"]]
    assert "learned" not in [t["outcome"] for t in first["transitions"]]
    code, again = run_json("plan", name, "--task", "lift")
    assert (code, again["mode"] <= 1) == (0, True)
    # Known now: an impossible demand is no longer explored.
    code, correction = run_json("plan", name, "--task", "lift", "--estimation-threshold", "6")
    assert (code, correction["mode"]) == (1, 2)


def test_a_deadlock_is_no_answer(run, run_json):
    arguments = ("plan", "apple", "--task", "lift", "--estimation-threshold", "5.99")
    code, out, _ = run(*arguments, "--no-learn")
    assert code == 1
    assert "deadlock" in out
    code, document = run_json(*arguments, "--no-learn")
    assert (code, document["status"], document["deadlock"]) == (1, "deadlock", True)
    assert document["thresholds"] == {"estimation": 5.99, "recognition": 5.0}
    # The next process starts at mode 0 again.
    code, document = run_json("plan", "cube", "--task", Q1)
    assert (code, document["mode"]) == (0, 0)


def test_no_grasp_is_no_answer(run_json, tmp_path):
    cube = load_library_object("cube")
    corners = np.concatenate([cube.vertices * 0.2 - 0.03, cube.vertices * 0.2 + 0.03])
    faces = np.concatenate([cube.triangles, cube.triangles + len(cube.vertices)]) + 1
    path = tmp_path / "corners.obj"
    path.write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "".join(f"f {a} {b} {c}\n" for a, b, c in faces)
    )
    code, document = run_json("plan", f"{path}#all", "--task", "lift")
    assert (code, document["status"], document["mode"]) == (1, "no_grasp", 3)
    assert document["object"]["source"] == f"{path}#all"


# -- options of plan -----------------------------------------------------------------------------------


def test_no_learn_leaves_the_memory_as_it_was(run_json, own_memory):
    before = own_memory.read_bytes()
    for name in ("mug", "cube"):
        run_json("plan", name, "--task", "lift", "--no-learn")
    assert own_memory.read_bytes() == before
    run_json("plan", "apple", "--task", "lift", "--estimation-threshold", "5.9")
    assert own_memory.read_bytes() != before


def test_no_learn_makes_no_memory(run_json, tmp_path):
    missing = tmp_path / "folder" / "none.sqlite"
    code, _ = run_json("plan", "cube", "--task", Q1, "--no-learn", "--memory", missing)
    assert code == 0
    assert not missing.parent.exists()
    run_json("plan", "cube", "--task", Q1, "--memory", missing)
    assert missing.is_file()


def test_fewer_answers_than_were_asked_for_are_told(run, run_json):
    arguments = ("plan", "cube", "--task", Q1, "--no-learn", "--count")
    given = 1 + len(run_json(*arguments, "99")[1]["alternatives"])
    assert 1 < given < 99
    code, _, told = run(*arguments, "99")
    assert (code, told) == (
        0,
        f"{given} of the 99 answers asked for: no other is different enough and good enough\n",
    )
    assert run(*arguments, str(given))[2] == ""


def test_count_gives_so_many_different_answers(run, run_json):
    code, document = run_json("plan", "cube", "--task", Q1, "--count", "3")
    assert code == 0
    everything = [document, *document["alternatives"]]
    assert len({(d["plane"], d["flip"], d["fingers"]) for d in everything}) == 3
    assert all(d["tfvadi"] >= 3 - 1e-9 for d in everything)
    code, out, _ = run("plan", "cube", "--task", Q1, "--count", "3")
    assert "answer 2" in out
    assert "answer 3" in out
    _, single = run_json("plan", "cube", "--task", Q1)
    assert single["alternatives"] == []


def test_out_writes_the_plan_and_its_picture(run_json, tmp_path):
    folder = tmp_path / "new" / "out"
    code, document = run_json("plan", "cube", "--task", Q1, "--out", folder)
    assert code == 0
    assert {p.name for p in folder.iterdir()} == {"plan.json", "plan.png", "plan.html"}
    assert json.loads((folder / "plan.json").read_text()) == document
    picture = (folder / "plan.png").read_bytes()
    assert picture.startswith(b"\x89PNG\r\n\x1a\n")
    assert picture.rstrip().endswith(b"IEND\xaeB`\x82")


@pytest.mark.parametrize("approaches", ["+z", "-x,+y"])
def test_approach_restricts_the_planes(run_json, approaches):
    allowed = {int(i) + 1 for i in np.flatnonzero(allowed_planes(approaches))}
    for name in ("cube", "mug"):
        _, document = run_json(
            "plan", name, "--task", "lift", "--approach", approaches, "--count", "3", "--no-learn",
            "--estimation-threshold", "2",
        )  # fmt: skip
        assert document["status"] == "answer"
        assert {d["plane"] for d in [document, *document["alternatives"]]} <= allowed


def test_the_same_seed_gives_the_same_result(run_json, tmp_path):
    results = []
    for number in range(2):
        memory = tmp_path / f"{number}.sqlite"  # trained from nothing, with this seed
        arguments = ("--task", "lift", "--seed", "7", "--count", "2", "--memory", memory)
        results.append([timeless(run_json("plan", name, *arguments)[1]) for name in ("mug", "cube")])
    assert results[0] == results[1]


def test_unit_and_scale_make_metres(run_json, tmp_path):
    mug = load_library_object("mug")
    path = tmp_path / "mug.obj"
    path.write_text(
        "".join(f"v {x:.3f} {y:.3f} {z:.3f}\n" for x, y, z in mug.vertices * 1000)
        + "".join(f"f {a} {b} {c}\n" for a, b, c in mug.triangles + 1)
    )
    for unit, scale, factor in (
        ("mm", "1", 1.0),
        ("mm", "0.5", 0.5),
        ("m", "0.001", 1.0),
        ("cm", "0.1", 1.0),
    ):
        _, document = run_json("plan", path, "--task", "lift", "--unit", unit, "--scale", scale, "--no-learn")
        assert document["object"]["extents"] == pytest.approx((mug.extents * factor).tolist(), abs=2e-6)
        assert document["object"]["triangles"] == len(mug.triangles)


def test_the_mug_from_a_file_is_the_mug_from_the_library(run_json, with_mug, tmp_path):
    mug = load_library_object("mug")
    path = tmp_path / "my_cup.obj"
    path.write_text(
        "".join(f"v {x:.7f} {y:.7f} {z:.7f}\n" for x, y, z in mug.vertices)
        + "".join(f"f {a} {b} {c}\n" for a, b, c in mug.triangles + 1)
    )
    _, document = run_json(
        "plan", path, "--task", "lift", "--estimation-threshold", "5.99", "--memory", with_mug, "--no-learn"
    )
    assert (document["mode"], document["status"]) == (2, "task_correction")
    assert "mug" in document["reason"]


def test_the_analyser_can_be_named(run_json):
    default = run_json("plan", "cube", "--task", Q1)[1]
    named = run_json("plan", "cube", "--task", Q1, "--analyser", "rays", "--hand", "utah_mit")[1]
    assert timeless(default) == timeless(named)


# -- learn and memory ----------------------------------------------------------------------------------


def test_learn_then_show_export_reset_import(run, run_json, tmp_path, own_memory):
    code, document = run_json("learn", "mug", "pen", "--task", "lift", "--task", "turn:-y")
    assert [(row["object"], row["task"]) for row in document["lessons"]] == [
        ("mug", "lift"), ("mug", "turn:-y"), ("pen", "lift"), ("pen", "turn:-y"),
    ]  # fmt: skip
    good = all(row["status"] == "answer" for row in document["lessons"])
    assert (code, document["status"]) == ((0, "answer") if good else (1, "incomplete"))
    samples = [row["samples"] for row in document["lessons"]]
    assert samples == sorted(samples)

    code, shown = run_json("memory", "show")
    assert code == 0
    assert shown["path"] == str(own_memory)
    assert {o["name"] for o in shown["objects"]} == {"seed_cube", "mug", "pen"}
    assert shown["experiences"] == sum(o["experiences"] for o in shown["objects"])
    assert shown["trained_on"] == {"utah_mit": samples[-1]}
    code, out, _ = run("memory", "show")
    assert code == 0
    assert all(name in out for name in ("mug", "pen", "TFVADI", str(shown["experiences"])))
    assert "seed_cube *" in out
    assert "mug *" not in out
    assert "* the first lesson" in out

    learnt = tmp_path / "sub" / "learnt.json"
    code, exported = run_json("memory", "export", learnt)
    assert (code, exported["exported"]) == (0, shown["experiences"])
    assert len(json.loads(learnt.read_text())["experiences"]) == shown["experiences"]

    other = tmp_path / "other.sqlite"
    code, imported = run_json("memory", "import", learnt, "--memory", other)
    assert (code, imported["imported"]) == (0, shown["experiences"])
    assert run_json("memory", "import", learnt, "--memory", other)[1]["imported"] == 0
    before = run_json("plan", "mug", "--task", "lift")[1]
    after = run_json("plan", "mug", "--task", "lift", "--memory", other)[1]
    assert timeless(after) == timeless(before)

    code, forgotten = run_json("memory", "reset", "--yes")
    assert (code, forgotten["forgotten"]) == (0, shown["experiences"])
    assert run_json("memory", "show")[1]["objects"] == []
    assert run_json("memory", "show", "--memory", other)[1]["experiences"] == shown["experiences"]


def test_learn_says_each_lesson_and_where_it_went(run, own_memory):
    code, out, _ = run("learn", "apple", "--task", "lift", "--task", "turn")
    lines = [line for line in out.splitlines() if line.startswith(("✓", "✗"))]
    assert len(lines) == 2
    assert ["apple" in line for line in lines] == [True, True]
    assert str(own_memory) in out.replace("\n", "")
    assert code == (0 if all(line.startswith("✓") for line in lines) else 1)


def test_learn_teaches_a_known_object_a_task_that_did_not_fit(run_json):
    assert run_json("learn", "hammer", "--task", "lift")[0] == 0
    c = Controller(Memory.open(os.environ["PRESHAPE_MEMORY"], read_only=True), LAYOUT)
    hammer = c.prepare(load_library_object("hammer"))
    task = next(
        t.label
        for t in all_named_tasks()
        if c.run(hammer, t, may_learn=False).mode == 2 and hammer.explore(t.q, _everywhere()).match[0] >= 3.5
    )
    assert run_json("plan", "hammer", "--task", task)[0] == 1
    assert run_json("learn", "hammer", "--task", task)[0] == 0
    assert run_json("plan", "hammer", "--task", task)[0] == 0


def _everywhere():
    from preshape.hiis.analyser import Aim
    from preshape.hiis.fuzzy import FuzzySets

    return Aim(values=FuzzySets().crisp())


def test_reset_asks_for_confirmation(run, own_memory):
    before = own_memory.read_bytes()
    code, _, err = run("memory", "reset")
    assert code == 2
    assert "--yes" in err
    assert own_memory.read_bytes() == before


# -- lists ---------------------------------------------------------------------------------------------


def test_objects(run, run_json):
    code, document = run_json("objects")
    assert code == 0
    assert [o["name"] for o in document["objects"]] == list(names())
    for o in document["objects"]:
        assert min(o["extents"]) > 0
        assert max(o["extents"]) <= 0.172 + 1e-9
        assert o["mass"] > 0
        assert o["triangles"] > 0
        for task in o["tasks"]:
            parse_task(task)
    code, out, _ = run("objects")
    assert code == 0
    assert all(name in out for name in names())


def test_tasks(run, run_json):
    code, document = run_json("tasks")
    assert code == 0
    assert [t["name"] for t in document["tasks"]] == list(FAMILIES)
    for t in document["tasks"]:
        assert parse_task(f"{t['name']}:{t['axis']}").q.tolist() == t["q"]
        assert t["means"]
    code, out, _ = run("tasks")
    assert all(name in out for name in FAMILIES)


def test_hands(run, run_json):
    code, document = run_json("hands")
    assert code == 0
    for hand in document["hands"]:
        model = load_hand(hand["name"])
        assert hand["U"] == model.u
        assert hand["largest_object"] == pytest.approx(4 * model.u)
        assert hand["joints"] == len(model.joints)
        assert hand["licence"]
        assert hand["name"] in run("hands")[1]


# -- help ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", HELPS, ids=" ".join)
def test_every_help_has_an_example_that_the_command_line_accepts(command, run):
    code, out, err = run(*command, "--help")
    assert (code, err) == (0, "")
    assert "Usage: preshape" in out
    examples = _examples(out.split("Example")[1])
    assert examples
    for example in examples:
        assert set(_named(_parsed(example))) <= {"file", "hand", "object", "task", "experiment"}
    if not command:
        assert all(name in out for name in COMMANDS)


def test_every_command_s_help_is_looked_at_and_its_examples_name_every_kind_of_thing():
    found, waiting = [], [([], app)]
    named: set[str] = set()
    while waiting:
        path, command = waiting.pop()
        found.append(path)
        for example in _examples(command.epilog):
            named |= set(_named(_parsed(example)))
        if isinstance(command, click.Group):
            context = click.Context(command)
            children = ((name, command.get_command(context, name)) for name in command.list_commands(context))
            waiting += [([*path, name], child) for name, child in children]
    assert sorted(found) == sorted(HELPS)
    assert named == {"file", "hand", "object", "task", "experiment"}


def test_an_example_that_names_what_is_not_there_is_found_out():
    for example in (
        "preshape plan mugg --task pour",
        "preshape plan mug --task poor",
        "preshape dataset mug --hands shadow,alegro --tasks lift --per 1 --out d",
        "preshape bench tasks --objects cube,hamer",
        "preshape learn mug --task lift --task poor",
        "preshape reproduce --only fig99",
    ):
        with pytest.raises((InputError, AssertionError)):
            _named(_parsed(example))


def _examples(text: str) -> list[str]:
    return re.findall(r"(preshape .+?)(?=,? or preshape | · |$)", " ".join(text.split()))


def _named(context: click.Context) -> list[str]:
    """The kinds of things that a command line names; those that the program should know, it knows."""
    kinds = []
    for option in context.command.params:
        if option.metavar == "DIR" or context.get_parameter_source(option.name) is ParameterSource.DEFAULT:
            continue
        given = context.params[option.name]
        for text in given if isinstance(given, tuple) else [given]:
            words = [text] if " " in str(text) else str(text).split(",")
            if option.name in ("hand", "hands"):
                kinds += ["hand" for word in words if load_hand(word)]
            elif option.name in ("task", "tasks"):
                kinds += ["task" for word in words if parse_task(word)]
            elif option.name == "only":
                assert set(words) <= set(EXPERIMENTS)
                kinds.append("experiment")
            elif option.name in ("thing", "things", "objects"):
                files = [word for word in words if Path(word).suffix]
                assert set(words) - set(files) <= set(names()), words
                kinds += ["file" if word in files else "object" for word in words]
    return kinds


def _parsed(example: str) -> click.Context:
    """Parse a command line without running it."""
    program, *arguments = shlex.split(example)
    assert program == "preshape"
    command: click.Command = app
    context = None
    while isinstance(command, click.Group):
        context = command.make_context(arguments[0], [], parent=context, resilient_parsing=True)
        found = command.get_command(context, arguments[0])
        assert found is not None, example
        command, arguments = found, arguments[1:]
    return command.make_context(command.name, arguments, parent=context)


def test_version_and_short_help(run):
    from preshape import __version__

    code, out, _ = run("--version")
    assert code == 0
    assert __version__ in out
    assert run("-h")[1] == run("--help")[1]


# -- as a process --------------------------------------------------------------------------------------


def test_the_module_and_the_installed_command_do_the_same(run_json, own_memory, known_cube):
    here = run_json("plan", "cube", "--task", Q1)[1]
    done = process("plan", "cube", "--task", Q1, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert timeless(json.loads(done.stdout)) == timeless(here)
    installed = Path(sys.executable).with_name("preshape")
    if installed.exists():
        done = subprocess.run(
            [installed, "plan", "--hand", "utah_mit", known_cube, "--task", UNFIT, "--json"],
            capture_output=True,
            text=True,
            check=False,
        )
        assert (done.returncode, done.stderr) == (1, "")
        assert json.loads(done.stdout)["status"] == "task_correction"


@pytest.mark.parametrize("options", [["--json"], []])
def test_a_reader_that_has_left_is_no_error(options):
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "preshape", "tasks", *options],
        stdout=writer,
        stderr=subprocess.PIPE,
        text=True,
        timeout=300,
        check=False,
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


def test_an_interrupted_plan_says_so(run, monkeypatch):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("preshape.planning.session.Session.run", interrupted)
    code, out, err = run("plan", "cube", "--task", Q1)
    assert code == 130
    assert out == ""
    assert "interrupted" in err


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_an_interrupted_lesson_loses_nothing_that_was_acknowledged(own_memory):
    # A shell's background job, as CI may be, starts its children with the signal ignored.
    heeding = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from preshape.cli.main import main; main()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", heeding, "learn", "ALL", "--hand", "utah_mit", "--memory", str(own_memory)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        env={**os.environ, "COLUMNS": "200"},
    ) as learning:
        lines: list[str] = []
        assert learning.stdout is not None
        for line in learning.stdout:
            lines.append(line)
            if sum(line.startswith(("✓", "✗")) for line in lines) == 7:
                learning.send_signal(signal.SIGINT)
                break
        rest, err = learning.communicate(timeout=120)
    assert learning.returncode == 130
    assert "interrupted" in err
    assert "Traceback" not in err
    lessons = [line.split()[1:3] for line in [*lines, *rest.splitlines()] if line.startswith(("✓", "✗"))]
    assert 7 <= len(lessons) < 60
    with sqlite3.connect(own_memory) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    connection.close()
    with Memory.open(own_memory) as memory:
        kept = {(e.object_name, e.task.tobytes()) for e in memory.experiences() if e.kind == "task"}
        for name, task in lessons:
            assert (name, parse_task(task).q.tobytes()) in kept, (name, task)
        # A lesson that was not acknowledged is there whole or not at all.
        grasps: dict[str, set[tuple[str, bytes]]] = {"task": set(), "best": set()}
        for e in memory.experiences():
            grasps.get(e.kind, set()).add((e.object_name, e.wrench.tobytes()))
        assert grasps["task"] == grasps["best"]  # two tasks with one grasp share its best possible task
        c = Controller(memory, LAYOUT)
        for name, task in lessons:
            assert c.run(load_library_object(name), parse_task(task), may_learn=False).mode <= 2
            c.reset()
