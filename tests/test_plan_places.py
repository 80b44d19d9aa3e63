"""Where things are: a plan's object and files, and files that change under an open session."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import preshape
from preshape.app.worker import Worker
from preshape.cli.main import run
from preshape.cli.view import start_of_plan
from preshape.closure.settings import ClosureSettings
from preshape.exceptions import EnvironmentFailure, InputError, ObjectError
from preshape.export.scene_object import find_object
from preshape.files import file_stem
from preshape.memory import Memory
from preshape.objects.library import load_library_object
from preshape.objects.load import load_object
from preshape.objects.mesh import TriangleMesh
from preshape.physics.locate import plan_object
from preshape.physics.task.instances import mesh_text
from preshape.planning.document import plan_to_json, request_of
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session

TRIDENT = Path(__file__).parents[1] / "examples" / "hands" / "trident.toml"
QUICK = ClosureSettings(everywhere=300, on_plane=120, at_aim=60, persistence=0, rounds=1, elite=8, finished=3)
Q1 = "1 1 .1 .05 .8 .05"
pytestmark = pytest.mark.usefixtures("session_cache", "small_pictures")


def block(name: str = "part", size: float = 1.0, **more: Any) -> TriangleMesh:
    """A cube that is not the library's."""
    cube = load_library_object("cube")
    return TriangleMesh(name=name, vertices=0.9 * size * cube.vertices, triangles=cube.triangles, **more)


def rays(source: Any = "cube", **changes: Any) -> PlanRequest:
    return PlanRequest(**{"source": source, "task": Q1, "hand": "utah_mit", **changes})


# -- names in files -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("part", "part"), ("a/b", "a_b"), ("../../up", "_.._up"), ("..", "unnamed"), (".", "unnamed"),
        ("a\\b:c*?", "a_b_c__"), ("\0\n", "__"), ("Gehäuse 2", "Gehäuse 2"), (".hidden", "hidden"),
    ],
)  # fmt: skip
def test_any_name_makes_a_file_name(name: str, stem: str) -> None:
    assert file_stem(name) == stem


@pytest.mark.parametrize("name", ["../../up", ".."])
def test_a_plan_of_a_mesh_of_any_name_stays_in_its_folder(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "in" / "out"
    files = preshape.plan(block(name), Q1, memory=":memory:", hand="utah_mit").save(folder)
    assert files[-1] == folder / f"{file_stem(name)}-surface.obj"
    assert sorted(path for path in tmp_path.rglob("*") if path.is_file()) == sorted(files)
    document = json.loads((folder / "plan.json").read_text())
    assert document["object"]["source"] == files[-1].name
    assert find_object(document, beside=folder).name == str(files[-1])


def test_a_long_name_makes_a_file_that_a_file_system_takes() -> None:
    assert len(f"{file_stem('ä' * 999)}-surface.obj".encode()) < 255


def test_the_name_of_a_mesh_adds_no_line_to_its_file(tmp_path: Path) -> None:
    file = tmp_path / "part.obj"
    file.write_text(mesh_text(block("part\nv 9 9 9\nf 1 2 9")))
    assert load_object(file).extents == pytest.approx(block().extents)


# -- where a plan's object is ---------------------------------------------------------------------------


def test_a_file_is_stored_by_its_absolute_path_and_a_name_as_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "part.obj").write_text(mesh_text(block()))
    monkeypatch.chdir(tmp_path)
    words = ["plan", "part.obj", "--task", Q1, "--memory", ":memory:", "--out", "out"]
    assert run(words) == 0
    document = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert document["object"]["source"] == str(tmp_path / "part.obj")
    assert document["request"]["object"]["source"] == str(tmp_path / "part.obj")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    assert start_of_plan(tmp_path / "out" / "plan.json").request.source == str(tmp_path / "part.obj")
    (elsewhere / "mug").mkdir()
    assert rays("mug").to_json()["object"]["source"] == "mug"
    assert rays("no such thing").to_json()["object"]["source"] == "no such thing"


def test_the_folder_of_the_plan_comes_before_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
        (folder / "part.obj").write_text(mesh_text(block()))
    monkeypatch.chdir(here)
    assert plan_object("part.obj", None, there) == str(there / "part.obj")
    assert plan_object("old/part.obj", None, there) == str(there / "part.obj")
    assert plan_object(str(here / "part.obj"), None, there) == str(here / "part.obj")
    assert plan_object(str(here / "gone" / "part.obj"), None, there) == str(there / "part.obj")
    (there / "part.obj").unlink()
    assert plan_object("part.obj", None, there) == "part.obj"
    assert plan_object("mug", None, there) == "mug"


def test_a_library_mesh_that_was_scaled_in_python_is_found_again(tmp_path: Path) -> None:
    mug = load_library_object("mug", scale=1.2)
    made = preshape.plan(mug, "pour", memory=":memory:", hand="utah_mit")
    document = plan_to_json(made)
    assert document["request"]["object"] == {
        "source": "mug",
        "unit": "m",
        "scale": 1.2,
        "view": None,
        "cut_table": None,
        "mask": None,
    }
    assert document["object"]["source"] == "mug"
    again = request_of(document)
    with Session(":memory:") as session:
        assert (session.mesh(again).vertices == mug.vertices).all()
        second = plan_to_json(session.run(again))
    for one in (document, second):
        one.pop("seconds")
        one["request"].pop("memory")
    assert json.dumps(second["contacts"]) == json.dumps(document["contacts"])
    assert second == document
    assert len(made.save(tmp_path)) == 3


@pytest.mark.parametrize("mesh", [
    block("mug"),
    TriangleMesh(name="cube", vertices=load_library_object("cube").vertices,
                 triangles=load_library_object("cube").triangles, mass=9.0),
])  # fmt: skip
def test_a_mesh_in_memory_says_that_it_cannot_be_found_again(mesh: TriangleMesh, tmp_path: Path) -> None:
    made = preshape.plan(mesh, Q1, memory=":memory:", hand="utah_mit")
    document = plan_to_json(made)
    with pytest.raises(InputError, match="was a mesh in Python"):
        request_of(document)
    assert request_of(document, source=mesh).source is mesh
    with pytest.raises(ObjectError, match=r"in memory.*--objects"):
        find_object(document)
    file = tmp_path / "alone" / "plan.json"
    file.parent.mkdir()
    file.write_text(json.dumps(document))
    for words in (["view", str(file)], ["simulate", str(file)]):
        assert run(words) == 2
    folder = tmp_path / "objects"
    folder.mkdir()
    (folder / f"{mesh.name}.obj").write_text(mesh_text(mesh))
    assert find_object(document, folder=str(folder)).scale == pytest.approx(1.0)
    made.save(tmp_path / "saved")
    saved = json.loads((tmp_path / "saved" / "plan.json").read_text())
    assert find_object(saved, beside=tmp_path / "saved").name.endswith(f"{mesh.name}-surface.obj")


def test_view_plans_on_with_the_mass_of_a_mesh_in_memory(
    tmp_path: Path, lesson: Callable[[str], Path]
) -> None:
    made = preshape.plan(
        block(mass=0.4), "lift", hand="leap", closure=QUICK, memory=lesson("leap"), learn=False, table=None
    )
    made.save(tmp_path)
    request = start_of_plan(tmp_path / "plan.json").request
    assert (request.source, request.mass) == (str(tmp_path / "part-surface.obj"), 0.4)
    assert start_of_plan(tmp_path / "plan.json", mass=0.3).request.mass == 0.3


# -- files that change under an open session --------------------------------------------------------------


def known(path: Path) -> set[str]:
    with Memory.open(path, read_only=True) as store:
        return {e.object_name for e in store.experiences(kinds=["task"])}


def test_a_session_opens_a_memory_again_that_was_replaced(tmp_path: Path) -> None:
    file, other, aside = tmp_path / "m.sqlite", tmp_path / "other.sqlite", tmp_path / "aside.sqlite"
    with Session(other) as session:
        session.teach(rays("bottle", task="lift"))
    with Session(file) as session:
        session.teach(rays("box", task="lift"))
        file.rename(aside)
        other.rename(file)
        assert session.run(rays("bottle", task="lift")).decision.mode == 0
        session.teach(rays("mug", task="pour"))
        assert session.memory.read_only is False
    assert known(file) == {"bottle", "mug"}
    assert known(aside) == {"box"}  # what was acknowledged went where it belonged
    with sqlite3.connect(file) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_a_session_makes_a_memory_that_was_deleted_again(tmp_path: Path) -> None:
    file = tmp_path / "m.sqlite"
    with Session(file) as session:
        session.teach(rays("box", task="lift"))
        for part in tmp_path.iterdir():
            part.unlink()
        session.teach(rays("mug", task="pour"))
    assert known(file) == {"mug"}


def test_a_session_that_only_reads_sees_a_memory_that_appears(tmp_path: Path) -> None:
    file = tmp_path / "m.sqlite"
    with Session(file, learn=False) as session:
        session.prepare(rays("mug"))
        assert session.memory.count() == 0
        with Session(file) as other:
            other.teach(rays("mug", task="pour"))
        assert session.run(rays("mug", task="pour")).decision.mode == 0


def test_a_session_follows_a_link_to_another_memory(tmp_path: Path) -> None:
    first, second, link = (tmp_path / name for name in ("a.sqlite", "b.sqlite", "link.sqlite"))
    link.symlink_to(first)
    with Session(link) as session:
        session.teach(rays("box", task="lift"))
        link.unlink()
        link.symlink_to(second)
        session.teach(rays("mug", task="pour"))
    assert (known(first), known(second)) == ({"box"}, {"mug"})


def test_a_worker_opens_a_memory_again_that_was_replaced(tmp_path: Path) -> None:
    file, other = tmp_path / "m.sqlite", tmp_path / "other.sqlite"
    with Session(other) as session:
        session.teach(rays("bottle", task="lift"))
    replies: list[dict[str, Any]] = []
    worker = Worker(replies.append)

    def ask(do: str, name: str, task: str) -> dict[str, Any]:
        request = rays(name, task=task, memory=str(file)).to_json()
        worker.answer({"do": do, "id": 1, "request": request})
        assert replies[-1] == {"done": True, "id": 1}, replies[-1]
        return [reply["document"] for reply in replies if "document" in reply][-1]  # type: ignore[no-any-return]

    ask("teach", "box", "lift")
    other.replace(file)
    assert ask("plan", "bottle", "lift")["mode"] == 0
    worker.close()


def test_an_open_memory_of_the_caller_stays_open(tmp_path: Path) -> None:
    file = tmp_path / "m.sqlite"
    with Memory.open(file) as memory, Session(memory) as session:
        session.prepare(rays())
        file.rename(tmp_path / "aside.sqlite")
        session.prepare(rays("box"))
        assert session.memory is memory


@pytest.mark.parametrize("changed", ["trident.toml", "trident.urdf"])
def test_a_session_sees_a_hand_whose_files_changed(changed: str, tmp_path: Path) -> None:
    for file in TRIDENT.parent.glob("trident.*"):
        shutil.copy(file, tmp_path)
    request = rays(hand=str(tmp_path / "trident.toml"), analyser="rays")
    with Session(":memory:") as session:
        first = session.hand(request)
        assert session.hand(request) is first  # so that what was prepared for it stays
        (tmp_path / changed).write_text(edited((tmp_path / changed).read_text(), changed))
        second = session.hand(request)
        assert second is not first
        assert session.hand(request) is second


def edited(text: str, name: str) -> str:
    """The file of a hand with another U, or with another mass of a link."""
    before, after = (
        ("\nu = 0.05", "\nu = 0.06") if name.endswith(".toml") else ('value="0.03"', 'value="0.04"')
    )
    assert before in text
    return text.replace(before, after, 1)


def test_a_session_sees_a_mesh_that_was_replaced_at_the_same_time_and_size(tmp_path: Path) -> None:
    file, other = tmp_path / "part.obj", tmp_path / "other.obj"
    file.write_text("# a\n" + mesh_text(block()))
    other.write_text("# a\n" + mesh_text(block()).replace("v -0.", "v -1.", 1))
    stat = file.stat()
    assert other.stat().st_size == stat.st_size
    os.utime(other, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    with Session(":memory:") as session:
        first = session.mesh(rays(str(file)))
        assert session.mesh(rays(str(file))) is first
        other.replace(file)
        assert session.mesh(rays(str(file))).extents.max() > first.extents.max()


def test_a_session_sees_the_buffer_of_a_gltf_that_changed(tmp_path: Path) -> None:
    mesh = block()
    index = mesh.triangles.astype("<u4").tobytes()

    def buffer(size: float) -> bytes:
        return index + (size * mesh.vertices).astype("<f4").tobytes()

    low, high = (mesh.vertices.min(axis=0).tolist(), mesh.vertices.max(axis=0).tolist())
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": len(index)},
             {"buffer": 0, "byteOffset": len(index), "byteLength": 12 * len(mesh.vertices)}]  # fmt: skip
    accessors = [
        {"bufferView": 0, "componentType": 5125, "count": mesh.triangles.size, "type": "SCALAR"},
        {"bufferView": 1, "componentType": 5126, "count": len(mesh.vertices), "type": "VEC3", "min": low,
         "max": high},
    ]  # fmt: skip
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0}]}],
        "buffers": [{"uri": "part.bin", "byteLength": len(buffer(1.0))}], "bufferViews": views,
        "accessors": accessors,
    }  # fmt: skip
    file = tmp_path / "part.gltf"
    file.write_text(json.dumps(tree))
    (tmp_path / "part.bin").write_bytes(buffer(1.0))
    with Session(":memory:") as session:
        first = session.mesh(rays(str(file)))
        assert session.mesh(rays(str(file))) is first
        (tmp_path / "part.bin").write_bytes(buffer(0.5))
        assert session.mesh(rays(str(file))).extents == pytest.approx(0.5 * first.extents, rel=1e-5)


# -- what must not be written -----------------------------------------------------------------------------


@pytest.mark.parametrize("hand", ["utah_mit", "leap"])
def test_nothing_is_written_if_the_request_says_so(hand: str, tmp_path: Path) -> None:
    quick = {"search": QUICK} if hand == "leap" else {}
    request = PlanRequest(source="box", task="lift", hand=hand, table=None, learn=False, **quick)
    with Memory.open(tmp_path / "m.sqlite") as memory:
        before = memory.state()
        preshape.plan(
            "box", "lift", hand=hand, memory=memory, learn=False, closure=quick.get("search"), table=None
        )
        with Session(memory) as session:
            session.run(request)
            assert (memory.count(), memory.state()) == (0, before)
            assert memory.weights("utah_mit") is None
            # The next request may learn, and finds the first lesson missing.
            session.run(replace(request, learn=True))
        kinds = {e.kind for e in memory.experiences()}
        assert {"seed"} <= kinds


def test_weights_of_a_memory_that_grew_are_not_written_either(tmp_path: Path) -> None:
    with Session(tmp_path / "a.sqlite") as session:
        session.teach(rays("box", task="lift"))
        session.memory.export(tmp_path / "a.json")
    with Memory.open(tmp_path / "b.sqlite") as memory:
        memory.import_(tmp_path / "a.json")
        memory._connection.execute("DELETE FROM weights")
        before = memory.state()
        preshape.plan("box", "lift", memory=memory, learn=False, hand="utah_mit")
        assert memory.state() == before


def test_to_teach_a_memory_that_only_reads_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "m.sqlite"
    with Session(file) as session:
        session.prepare(rays())
        with pytest.raises(InputError, match="learn=False"):
            session.teach(rays("box", learn=False))
    with Session(file, learn=False) as session, pytest.raises(EnvironmentFailure, match="reading only"):
        session.teach(rays("box", task="lift"))
    # The test may run as a user to whom every file is writable.
    monkeypatch.setattr("preshape.memory.store.os.access", lambda path, mode: False)
    assert run(["learn", "box", "--task", "lift", "--memory", str(file), "--json"]) == 3
    said = json.loads(capsys.readouterr().out)
    assert said["status"] == "error"
    assert "--memory OTHER" in said["reason"]
    assert known(file) == set()
