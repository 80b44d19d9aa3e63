"""Quick forms of the long runs: a few dozen random objects planned in one go, and a few learners killed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("hardening.objects", reason="the folder hardening is not here")

from hardening import kill, memories, objects, odd_objects
from hardening.blobs import as_obj, blob

from preshape.memory import Memory
from preshape.objects.load import load_object

ROOT = Path(__file__).parents[1]
COUNT = 20
URDF = (
    '<robot name="b"><link name="b"><visual><geometry><mesh filename="{}" scale="{} {} {}"/>'
    "</geometry></visual></link></robot>"
)
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random bodies in millimetres under URDFs that scale them; four are spoiled."""
    place = tmp_path_factory.mktemp("objects")
    for number in range(COUNT):
        mesh = blob(number, size=40.0 + 3.0 * number)
        vertices, triangles = mesh.vertices.copy(), mesh.triangles
        match number:
            case 3:
                vertices[2] = np.nan
            case 4:
                vertices[:, 1] = np.inf
            case 5:
                vertices[:, 2] = 0.0
            case 6:
                triangles = triangles + len(vertices)
        own = place / f"{number:03d}"
        own.mkdir()
        (own / f"{number:03d}.obj").write_text(as_obj(vertices, triangles))
        (own / f"{number:03d}.urdf").write_text(URDF.format(f"{number:03d}.obj", *["0.001"] * 3))
    return place


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "hardening.objects", *arguments],
        cwd=ROOT,
        env={**ENVIRONMENT, "PRESHAPE_CACHE": str(cwd / "cache")},
        capture_output=True,
        text=True,
        check=False,
    )


def test_every_random_object_is_answered_or_refused_with_a_reason(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    before = json.dumps({"name": "000", "outcome": "answer", "reason": "as before", "seconds": 0.5}) + "\n"
    (out / "utah_mit.jsonl").write_text(before)
    whole = run(str(folder), "--hands", "utah_mit", "--out", str(out), cwd=tmp_path)
    assert whole.returncode == 0, whole.stderr
    assert (out / "utah_mit.jsonl").read_text().startswith(before)  # it went on, and not from the start
    rows = [json.loads(line) for line in (out / "utah_mit.jsonl").read_text().splitlines()]
    assert [row["name"] for row in rows] == [f"{number:03d}" for number in range(COUNT)]
    refused = {row["name"]: row["reason"] for row in rows if row["outcome"] == objects.REFUSED}
    assert set(refused) == {"003", "004", "005", "006"}
    for number, said in (
        ("003", "1 of "),
        ("004", "not finite"),
        ("005", "flat"),
        ("006", "refers to vertex"),
    ):
        assert said in refused[number]
    assert all(row["reason"] for row in rows)
    found = json.loads((out / "utah_mit.json").read_text())
    counts = found["outcomes"]
    assert counts["answer"] + counts["no answer"] == COUNT - 4
    assert (counts["refused"], counts["crashed"], counts["hung"]) == (4, 0, 0)
    assert counts["answer"] > 12
    assert 0 < found["seconds"]["p50"] <= found["seconds"]["p99"]


def test_a_lost_or_silent_process_is_seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    rows = [(name, tmp_path / name, 1.0) for name in ("a", "b", "c")]
    program = (
        "import json, os, sys, time\n"
        "for line in sys.stdin:\n"
        "    name = json.loads(line)[0]\n"
        "    if name == 'a': os._exit(7)\n"
        "    if name == 'b': time.sleep(60)\n"
        "    row = {'name': name, 'outcome': 'answer', 'reason': 'x', 'seconds': 1}\n"
        "    print(json.dumps(row), flush=True)\n"
    )
    start = subprocess.Popen

    def pretend(command: list[str], **options: object) -> subprocess.Popen[str]:
        return start([sys.executable, "-c", program], **options)  # type: ignore[call-overload,no-any-return]

    monkeypatch.setattr(objects.subprocess, "Popen", pretend)
    monkeypatch.setattr(objects, "HANG", 3.0)
    (tmp_path / "utah_mit.sqlite").touch()
    found = objects.run(rows, "utah_mit", "lift", tmp_path)
    assert [row["outcome"] for row in found["wrong"]] == ["crashed", "hung"]
    assert "ended with 7" in found["wrong"][0]["reason"]
    assert found["outcomes"]["answer"] == 1


def test_blobs_are_bodies_of_any_form(tmp_path: Path) -> None:
    volumes = set()
    for seed in range(10):
        mesh = blob(seed)
        file = tmp_path / "a.obj"
        file.write_text(as_obj(mesh.vertices, mesh.triangles))
        again = load_object(file)
        assert np.isclose(again.volume, mesh.volume, rtol=1e-6)
        assert again.volume > 0
        assert np.isclose(mesh.extents.max(), 0.08)
        volumes.add(round(again.volume, 9))
    assert len(volumes) == 10


needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork and SIGKILL")


@needs_fork
def test_killed_learners_lose_nothing_that_they_acknowledged(tmp_path: Path) -> None:
    options = ("--kills", "4", "--writers", "4", "--longest", "4", "--out", str(tmp_path))
    done = subprocess.run(
        [sys.executable, "-m", "hardening.kill", *options],
        cwd=ROOT,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads((tmp_path / "kill.json").read_text())
    assert report["kills"] == 4
    assert report["faults"] == []


def test_what_a_kill_could_do_would_be_seen(tmp_path: Path) -> None:
    read, write = os.pipe()
    path = tmp_path / "memory.sqlite"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kill, "range", lambda _: range(2), raising=False)
        kill.learn(path, "a", write)
    os.close(write)
    with os.fdopen(read) as lines:
        told = {line.strip() for line in lines}
    assert told == {"a-0", "a-1"}
    assert kill.faults(path, told) == []
    assert kill.faults(path, {*told, "a-2"}) == ["lost: a-2"]
    with Memory.open(path) as memory:
        (one,) = [e for e in memory.experiences() if (e.object_name, e.kind) == ("a-1", "best")]
        memory.add([one])
    assert kill.faults(path, told) == ["incomplete lesson: a-1"]
    assert kill.faults(tmp_path / "none", {"a-0"}) == ["lost: a-0"]


def test_hostile_memories_do_not_stop_a_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = tmp_path / "model.sqlite"
    memories.taught(model)
    monkeypatch.setattr(memories, "EXPERIENCE_COLUMNS", ("area", "created"))
    assert memories.absurd_cells(tmp_path, model, (1e308,)) == []
    assert memories.foreign_schemas(tmp_path, model) == []
    # And what goes wrong would be seen.
    monkeypatch.setattr(memories, "SCHEMAS", ("ANALYZE",))
    assert memories.foreign_schemas(tmp_path, model)[0] == "opened: ANALYZE"


@pytest.mark.parametrize("kind", [kind for kind in odd_objects.KINDS if kind != "slender"])
def test_an_odd_file_gets_the_right_word(kind: str) -> None:
    for number in (0, 1):
        assert odd_objects.one(kind, number, seed=3) == ""
