"""The command line on bad input: exit code 2 or 3, one clear sentence, never a traceback."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from papers_hand import of_the_papers_hand
from preshape.cli import main as cli
from preshape.hands.load import load_hand
from preshape.hiis.controller import Controller
from preshape.memory import SCHEMA_VERSION, Memory
from preshape.objects.library import load_library_object, names
from preshape.planning.controllers import layout_of
from preshape.tasks import family_names

Q1 = "1 1 .1 .05 .8 .05"
LIMIT = 4 * load_hand("utah_mit").u

CORNERS = [(x, y, z) for x in (0, 0.05) for y in (0, 0.05) for z in (0, 0.05)]
FACES = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]


def obj(vertices=CORNERS, faces=FACES) -> str:
    rows = ["v " + " ".join(str(x) for x in vertex) for vertex in vertices]
    return "\n".join([*rows, *(f"f {face}" for face in faces)]) + "\n"


MESHES = {
    "good.obj": obj(),
    "empty.obj": "",
    "blank.obj": " \n\n",
    "words.obj": "this is a letter to somebody\nand not a mesh\n",
    "nan.obj": obj([("nan", 0, 0), *CORNERS[1:]]),
    "inf.obj": obj([("inf", 0, 0), *CORNERS[1:]]),
    "points.obj": obj(faces=[]),
    "line.obj": obj([(0, 0, 0), (0.01, 0, 0), (0.02, 0, 0)], ["1 2 3"]),
    "flat.obj": obj([(0, 0, 0), (0.05, 0, 0), (0, 0.05, 0)], ["1 2 3"]),
    "index.obj": obj(faces=[*FACES, "1 2 99"]),
    "large.obj": obj([(10 * x, 4 * y, z) for x, y, z in CORNERS]),
    "notes.txt": "v 0 0 0\n",
}


@pytest.fixture(scope="session")
def cube_only(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("bad") / "cube.sqlite"
    with Memory.open(path) as memory:
        Controller(memory, layout_of(load_hand("utah_mit")))
    return path


@pytest.fixture(autouse=True)
def folder(cube_only, tmp_path, monkeypatch) -> Path:
    """The working folder: the meshes above, and a memory of its own as the default one."""
    for name, text in MESHES.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "picture.obj").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(64))
    (tmp_path / "letter.sqlite").write_text("this is no memory but a letter\n" * 40)
    monkeypatch.setenv("PRESHAPE_MEMORY", str(shutil.copy(cube_only, tmp_path / "default.sqlite")))
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def refused(capsys):
    """Run a command line that must be refused, twice, with and without --json; returns the sentence."""

    def call(*arguments: str, code: int = 2) -> str:
        capsys.readouterr()
        given = cli.run(of_the_papers_hand(arguments))
        out, err = capsys.readouterr()
        assert given == code, (arguments, out, err)
        assert err.strip().startswith("error: ")
        reason = err.strip().removeprefix("error: ")
        assert out == ""
        assert_clear(reason)

        given = cli.run([*of_the_papers_hand(arguments), "--json"])
        out, err = capsys.readouterr()
        assert given == code
        document = json.loads(out)
        assert document == {"status": "error", "reason": document["reason"]}
        assert plain(document["reason"]) == plain(reason)
        assert err.strip() == ""
        return reason

    return call


def plain(text: str) -> str:
    return " ".join(re.sub(r"\x1b\[[0-9;]*m", "", text).split())


def assert_clear(reason: str) -> None:
    assert "\n" not in reason
    assert len(reason) > 15
    for word in ("Traceback", "internal fault", "Error:", "Exception", "site-packages", "<class", "0x"):
        assert word not in reason, reason


# -- objects -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("thing", "says"),
    [
        ("missing.obj", "no such file"),
        ("no/folder/at/all.stl", "no such file"),
        (".", "folder"),
        ("empty.obj", "empty"),
        ("blank.obj", "empty"),
        ("words.obj", "not an OBJ mesh"),
        ("picture.obj", "PNG"),
        ("notes.txt", ".obj, .stl, .ply"),
        ("nan.obj", "vertex 1"),
        ("inf.obj", "not finite"),
        ("points.obj", "no faces"),
        ("line.obj", "zero area"),
        ("flat.obj", "flat"),
        ("index.obj", "vertex 99"),
    ],
)
def test_a_file_that_is_no_object(thing, says, refused):
    reason = refused("plan", thing, "--task", "lift")
    assert says in reason
    assert thing in reason


def test_the_good_mesh_of_these_tests_is_good(capsys):
    assert cli.run(of_the_papers_hand(["plan", "good.obj", "--task", Q1, "--no-learn", "--json"])) in (0, 1)
    assert json.loads(capsys.readouterr().out)["status"] != "error"


def test_an_unknown_object_lists_the_nearest_names(refused):
    reason = refused("plan", "mugg", "--task", "lift")
    assert "did you mean mug" in reason
    assert all(name in reason for name in names())
    assert "did you mean scissors" in refused("plan", "scisors", "--task", "lift")


@pytest.mark.parametrize("scale", ["0", "-1", "nan", "inf", "-inf", "1e9", "1e-9", "big", ""])
@pytest.mark.parametrize("thing", ["good.obj", "mug"])
def test_an_absurd_scale(thing, scale, refused):
    assert "scale" in refused("plan", thing, "--task", "lift", "--scale", scale)


@pytest.mark.parametrize("unit", ["furlong", "MM", "", "ft"])
def test_an_unknown_unit_lists_the_known_ones(unit, refused):
    reason = refused("plan", "good.obj", "--task", "lift", "--unit", unit)
    assert all(known in reason for known in ("m", "cm", "mm", "in"))


def test_a_unit_for_a_library_object(refused):
    assert "metres" in refused("plan", "mug", "--task", "lift", "--unit", "mm")


@pytest.mark.parametrize(
    ("thing", "options", "extent"),
    [
        ("large.obj", [], 0.5),
        ("large.obj", ["--scale", "0.5"], 0.25),
        ("large.obj", ["--scale", "40", "--unit", "cm"], 0.2),
        ("mug", ["--scale", "2"], 2 * load_library_object("mug").extents.max()),
    ],
)
def test_an_object_over_4_u_is_refused_without_a_scale_that_happens_to_fit(thing, options, extent, refused):
    reason = refused("plan", thing, "--task", "lift", *options)
    assert "4U" in reason
    assert "utah_mit" in reason
    assert f"{1000 * extent:.0f} mm" in reason
    assert f"{1000 * LIMIT:.0f} mm" in reason
    assert "--scale" not in reason
    assert "--analyser closure" in reason


# -- tasks, hands, options -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("task", "says"),
    [
        ("1 2 3", "six numbers"),
        ("1 2 3 4 5 6 7", "got 7"),
        ("1 1 1 1 1 nan", "Rz"),
        ("inf 1 1 1 1 1", "Tx"),
        ("1 1 x 1 1 1", "Tz"),
        ("", "lift"),
        ("lift:+q", "+x -x +y"),
        ("lift:", "+x -x +y"),
    ],
)
def test_a_task_that_is_none(task, says, refused):
    assert says in refused("plan", "mug", "--task", task)


def test_even_the_largest_finite_task_is_answered_or_not_but_no_fault(capsys):
    assert cli.run(of_the_papers_hand(["plan", "mug", "--task", "1e308 1 1 1 1 -1e308", "--json"])) in (0, 1)
    assert json.loads(capsys.readouterr().out)["status"] != "error"


def test_an_unknown_task_lists_the_nearest_names(refused):
    reason = refused("plan", "mug", "--task", "lfit")
    assert "did you mean lift" in reason
    assert all(name in reason for name in family_names())


def test_an_unknown_hand_lists_the_nearest_names(refused):
    reason = refused("plan", "mug", "--task", "lift", "--hand", "utah")
    assert "did you mean utah_mit" in reason


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--analyser", "magic"], "rays, closure"),
        (["--table"], "closure"),
        (["--avoid", "0 0 1"], "six numbers"),
        (["--mass", "0"], "mass"),
        (["--friction", "nan"], "friction"),
        (["--approach", "up"], "+x, -x, +y, -y, +z, -z"),
        (["--approach", "+z,-w"], "-w"),
        (["--approach", ""], "+z,-x"),
        (["--approach", ","], "+z,-x"),
        (["--count", "0"], "at least 1"),
        (["--count", "-3"], "at least 1"),
        (["--count", "many"], "--count"),
        (["--estimation-threshold", "7"], "0..6"),
        (["--estimation-threshold", "nan"], "finite"),
        (["--recognition-threshold", "-1"], "0..6"),
        (["--recognition-threshold", "high"], "--recognition-threshold"),
        (["--seed", "-1"], "--seed"),
        (["--seed", "1.5"], "--seed"),
        (["--frobnicate"], "--frobnicate"),
        (["extra"], "extra"),
    ],
)
def test_a_bad_option_of_plan(options, says, refused):
    assert says in refused("plan", "mug", "--task", "lift", *options)


def test_what_is_missing_is_named(refused):
    assert "--task" in refused("plan", "mug")
    assert "OBJECT" in refused("plan", "--task", "lift")
    assert "OBJECT" in refused("learn")
    assert "FILE" in refused("memory", "export")


@pytest.mark.parametrize("command", [["frob"], ["memory", "frob"], ["plann", "mug", "--task", "lift"]])
def test_an_unknown_command(command, refused):
    reason = refused(*command)
    assert "no such command" in reason
    assert "--help" in reason
    assert "known: " in reason.lower()
    assert ("did you mean plan" in reason) == (command[0] == "plann")


HUGE = int("9" * 400)


@pytest.mark.parametrize(
    ("path", "content"),
    [
        (("hand",), [1]),
        (("hand",), None),
        (("object",), "mug"),
        (("object", "extents"), HUGE),
        (("object", "extents"), [HUGE, 1, 1]),
    ],
)
@pytest.mark.parametrize("command", ["view", "export", "simulate"])
def test_a_plan_with_a_part_of_another_kind(command, path, content, folder, capsys):
    document = json.loads((Path(__file__).parent.parent / "docs" / "plan.example.json").read_text())
    part = document
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = content
    file = folder / "plan.json"
    file.write_text(json.dumps(document))
    options = ["--format", "npz", "--out", "x.npz"] if command == "export" else []
    assert cli.run([command, str(file), *options]) == 2
    said = capsys.readouterr().err
    assert said.strip().startswith("error: ")
    assert "plan" in said
    assert "Traceback" not in said
    assert "internal fault" not in said


def test_json_nested_without_end_is_no_plan(folder, capsys):
    file = folder / "deep.json"
    file.write_text('{"a":' * 100_000)
    for command in ("view", "export", "simulate"):
        assert cli.run([command, str(file)]) == 2
        assert capsys.readouterr().err.strip().startswith("error: ")


def test_bad_lessons_are_refused_before_anything_is_learnt(refused, folder):
    before = (folder / "default.sqlite").read_bytes()
    assert "no task 'foo'" in refused("learn", "mug", "--task", "lift", "--task", "foo")
    assert "mugg" in refused("learn", "mugg", "--task", "lift")
    assert "scale" in refused("learn", "mug", "--task", "lift", "--scale", "0")
    assert "4U" in refused("learn", "large.obj", "--task", "lift")
    assert "no hand" in refused("learn", "mug", "--hand", "claw")
    assert "axis" in refused("learn", "mug", "--task", "lift", "--approach", "up")
    assert (folder / "default.sqlite").read_bytes() == before


def test_a_refused_plan_leaves_the_memory_as_it_was(refused, folder):
    before = (folder / "default.sqlite").read_bytes()
    refused("plan", "mug", "--task", "lift", "--count", "0")
    refused("plan", "large.obj", "--task", "lift")
    refused("plan", "mug", "--task", "lift", "--approach", "up")
    assert (folder / "default.sqlite").read_bytes() == before


# -- the memory file -----------------------------------------------------------------------------------

USES = [["plan", "cube", "--task", Q1], ["learn", "cube", "--task", "lift"], ["memory", "show"]]


@pytest.mark.parametrize("use", USES, ids=lambda use: use[0])
def test_a_memory_of_a_newer_version_is_refused_and_untouched(use, refused, folder):
    path = folder / "newer.sqlite"
    shutil.copy(folder / "default.sqlite", path)
    connection = sqlite3.connect(path)
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    connection.close()
    before = path.read_bytes()
    reason = refused(*use, "--memory", path)
    assert "newer" in reason
    assert str(SCHEMA_VERSION + 1) in reason
    assert path.read_bytes() == before


@pytest.mark.parametrize("use", USES, ids=lambda use: use[0])
def test_a_file_that_is_no_memory_is_refused_and_untouched(use, refused, folder):
    connection = sqlite3.connect(folder / "other.sqlite")
    connection.execute("CREATE TABLE birds (name TEXT)")
    connection.close()
    for name in ("letter.sqlite", "other.sqlite", "good.obj"):
        before = (folder / name).read_bytes()
        assert "not a memory" in refused(*use, "--memory", name)
        assert (folder / name).read_bytes() == before


def test_an_import_of_something_else(refused, folder):
    assert "JSON" in refused("memory", "import", "words.obj")
    (folder / "list.json").write_text("[1, 2]")
    assert "preshape-memory" in refused("memory", "import", "list.json")
    (folder / "newer.json").write_text(
        '{"format": "preshape-memory", "version": 99, "experiences": [], "weights": []}'
    )
    assert "newer" in refused("memory", "import", "newer.json")


def test_reset_without_yes_and_for_a_hand_that_is_none(refused, folder):
    before = (folder / "default.sqlite").read_bytes()
    assert "--yes" in refused("memory", "reset")
    assert "no hand" in refused("memory", "reset", "--hand", "claw", "--yes")
    assert (folder / "default.sqlite").read_bytes() == before


# -- files, disk, environment: exit code 3 ---------------------------------------------------------------


@pytest.mark.parametrize("place", ["good.obj/memory.sqlite", "/proc/memory.sqlite", "/dev/full", "."])
def test_a_memory_where_none_can_be(place, refused):
    if place.startswith("/") and not Path(place).parent.is_dir():
        pytest.skip("not on this system")
    named = place if place != "." else str(Path.cwd())
    for use in USES[:2]:
        assert named in refused(*use, "--memory", place, code=3)


@pytest.mark.parametrize("place", ["good.obj/out", "/proc/out", "good.obj"])
def test_an_out_folder_that_cannot_be_written(place, refused):
    if place.startswith("/proc") and not Path("/proc").is_dir():
        pytest.skip("not on this system")
    assert place in refused("plan", "cube", "--task", Q1, "--out", place, code=3)


def test_an_export_that_cannot_be_written_and_an_import_that_cannot_be_read(refused):
    assert "good.obj" in refused("memory", "export", "good.obj/learnt.json", code=3)
    assert "missing.json" in refused("memory", "import", "missing.json", code=3)


def test_a_full_disk_under_out(refused, monkeypatch, folder):
    def full(handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("preshape.files.os.fsync", full)
    reason = refused("plan", "cube", "--task", Q1, "--no-learn", "--out", "out", code=3)
    assert "No space left" in reason
    assert list((folder / "out").iterdir()) == []


def limited(*arguments: str, size: int, folder: Path) -> subprocess.CompletedProcess:
    """Run in a process that may write no file beyond so many bytes, as on a full disk."""
    program = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size}));"
        "from preshape.cli.main import main; main(sys.argv[1:])"
    )
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=300,
        check=False,
    )


@pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")
def test_a_full_disk_under_the_memory_keeps_what_was_there(folder):
    path = folder / "default.sqlite"
    with Memory.open(path, read_only=True) as memory:
        before = memory.count()
    done = limited(
        "learn", "mug", "--task", "lift", "--memory", str(path), "--json", size=20_000, folder=folder
    )
    assert done.returncode == 3, done.stderr
    document = json.loads(done.stdout)
    assert document["status"] == "error"
    assert str(path) in document["reason"]
    assert_clear(document["reason"])
    assert "Traceback" not in done.stderr
    connection = sqlite3.connect(path)
    assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    connection.close()
    with Memory.open(path) as memory:
        assert memory.count() == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("options", [["--json"], []])
def test_standard_output_on_a_full_disk(options):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "preshape", "tasks", *options],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=300,
            check=False,
        )
    assert done.returncode == 3
    assert "No space left" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_fault_of_ours_is_reported_in_a_sentence(capsys, monkeypatch):
    def fault(*args, **kwargs):
        raise ZeroDivisionError("division by zero")

    monkeypatch.delenv("PRESHAPE_DEBUG", raising=False)
    monkeypatch.setattr("preshape.planning.session.Session.run", fault)
    assert cli.run(of_the_papers_hand(["plan", "cube", "--task", Q1, "--json"])) == 3
    document = json.loads(capsys.readouterr().out)
    assert document["status"] == "error"
    assert "PRESHAPE_DEBUG" in document["reason"]
    monkeypatch.setenv("PRESHAPE_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        cli.run(of_the_papers_hand(["plan", "cube", "--task", Q1]))


# -- as a process ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["plan", "missing.obj", "--task", "lift"], 2),
        (["plan", "mug", "--task", "lift", "--memory", "good.obj/m.sqlite"], 3),
        ([], 2),
    ],
)
def test_a_process_leaves_with_the_same_code_and_one_object(arguments, code, folder):
    command = [sys.executable, "-m", "preshape", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=300, check=False)
    assert done.returncode == code
    assert "Traceback" not in done.stderr
    if arguments:
        assert done.stdout == ""
        assert len(done.stderr.strip().splitlines()) == 1
        done = subprocess.run(
            [*command, "--json"], capture_output=True, text=True, cwd=folder, timeout=300, check=False
        )
        assert done.returncode == code
        assert json.loads(done.stdout)["status"] == "error"
        assert done.stderr == ""
    else:
        assert "Usage" in done.stdout + done.stderr or "usage" in done.stdout + done.stderr


def test_the_corner_table_of_this_file_is_a_cube():
    assert np.ptp(np.array(CORNERS), axis=0).tolist() == [0.05, 0.05, 0.05]
