"""One request, one answer: command line, Python and the browser's worker give the same plan."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import preshape
from preshape.app.worker import Worker
from preshape.cli.main import run
from preshape.objects.load import load_object
from preshape.planning.document import plan_to_json
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session

BY_CHANCE = ("seconds", "version")
"""Keys that differ from run to run."""


def plain(document: dict[str, Any]) -> dict[str, Any]:
    """The document without times."""
    out = {key: content for key, content in document.items() if key not in BY_CHANCE}
    out["alternatives"] = [plain(one) for one in document["alternatives"]]
    out["best"] = document["best"] and plain(document["best"])
    return json.loads(json.dumps(out))  # type: ignore[no-any-return]


def scan_of(tmp_path: Path) -> Path:
    """A mesh file as a scan has it: another name than the library's, cut anew by its own writer."""
    import trimesh

    mesh = load_object("pear")
    file = tmp_path / "scan.ply"
    file.write_bytes(trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).export(file_type="ply"))
    return file


def cloud_of(tmp_path: Path) -> Path:
    """Points on the side of a can that a camera at +x sees."""
    rng = np.random.default_rng(3)
    angle, height = rng.uniform(-1.4, 1.4, 4000), rng.uniform(-0.045, 0.045, 4000)
    side = np.stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), height], axis=1)
    disc = rng.uniform(-0.03, 0.03, (3000, 2))
    disc = disc[np.linalg.norm(disc, axis=1) < 0.03]
    points = np.concatenate([side, np.column_stack([disc, np.full(len(disc), 0.045)])])
    file = tmp_path / "can.xyz"
    np.savetxt(file, points, fmt="%.6f")
    return file


def memory_of(folder: Path, asked: dict[str, Any], lesson: Callable[[str], Path], old: bool) -> Path | None:
    """What every door's memory begins with: the hand's first lesson, or an old memory that met two objects.

    There is none for the paper's hand, which learns its first lesson at once, and for the plainest request.
    """
    hand = asked["hand"]
    first = None if hand == "utah_mit" or set(asked) == {"source", "task", "hand"} else lesson(hand)
    if not old:
        return first
    file = folder / "old.sqlite"
    if first is not None:
        shutil.copy(first, file)
    with Session(file) as session:
        for name in ("box", "bottle"):
            session.teach(PlanRequest(source=name, task="lift", hand=hand))
    return file


CASES: list[tuple[str, dict[str, Any]]] = [
    ("library object, the paper's hand", {"source": "mug", "task": "pour", "hand": "utah_mit"}),
    ("library object, six numbers, two answers", {"source": "cube", "task": "1 1 .1 .05 .8 .05",
                                                "hand": "utah_mit", "count": 2}),
    ("library object, its own mass", {"source": "mug", "task": "pour", "hand": "shadow"}),
    ("a mass and a friction, three answers", {"source": "box", "task": "lift", "hand": "allegro", "mass": 0.4,
                                              "friction": 0.8, "count": 3, "grasp_type": "precision"}),
    ("a low table and a box to avoid", {"source": "pear", "task": "lift", "hand": "allegro", "table": -0.09,
                                        "avoid": [[0.03, -0.1, -0.1, 0.2, 0.1, 0.1]]}),
    ("a table, approaches and a seed", {"source": "jar", "task": "lift", "hand": "shadow", "table": "auto",
                                        "approaches": "-z", "seed": 3}),
    ("a scan in another unit", {"source": "scan", "task": "lift", "hand": "shadow", "unit": "cm",
                                "scale": 100.0}),
    ("a point cloud", {"source": "cloud", "task": "lift", "hand": "shadow", "view": [0.5, 0.0, 0.3]}),
    ("a heavy object that no grip holds", {"source": "mug", "task": "lift", "hand": "leap", "mass": 30.0,
                                              "table": "none", "grasp_type": "precision"}),
    ("an old memory that knows the object", {"source": "box", "task": "lift", "hand": "shadow", "old": True}),
    ("an old memory of the paper's hand", {"source": "bottle", "task": "lift", "hand": "utah_mit",
                                           "old": True}),
]  # fmt: skip


def by_command_line(asked: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    words = ["plan", str(asked["source"]), "--task", asked["task"], "--json", "--memory", asked["memory"]]
    flags = {"hand": "hand", "mass": "mass", "friction": "friction", "count": "count", "unit": "unit",
             "scale": "scale", "approaches": "approach", "seed": "seed", "grasp_type": "type"}  # fmt: skip
    for key, flag in flags.items():
        if key in asked:
            words += [f"--{flag}", str(asked[key])]
    if "table" in asked:
        words += ["--table"] + ([] if asked["table"] == "auto" else [str(asked["table"])])
    for box in asked.get("avoid", ()):
        words += ["--avoid", " ".join(map(str, box))]
    if "view" in asked:
        words += ["--view", ",".join(map(str, asked["view"]))]
    code = run(words)
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert code == (0 if found["status"] == "answer" else 1), found
    return found


def by_python(asked: dict[str, Any]) -> dict[str, Any]:
    rest = {key: content for key, content in asked.items() if key not in ("source", "task")}
    return plan_to_json(preshape.plan(asked["source"], asked["task"], **rest))


def request_of(asked: dict[str, Any]) -> dict[str, Any]:
    rest = {key: content for key, content in asked.items() if key != "seed"}
    return PlanRequest(**rest, settings=preshape.Settings(seed=asked.get("seed", 0))).to_json()


def by_browser(asked: dict[str, Any]) -> dict[str, Any]:
    replies: list[dict[str, Any]] = []
    Worker(replies.append).answer({"do": "plan", "id": 1, "request": request_of(asked)})
    assert replies[-1] == {"done": True, "id": 1}, replies[-1]
    return [reply["document"] for reply in replies if "document" in reply][-1]  # type: ignore[no-any-return]


@pytest.mark.parametrize("asked", [pytest.param(case, id=name) for name, case in CASES])
def test_every_door_gives_the_same_plan(
    asked: dict[str, Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    lesson: Callable[[str], Path],
) -> None:
    asked = dict(asked)
    makers = {"scan": scan_of, "cloud": cloud_of}
    if asked["source"] in makers:
        asked["source"] = str(makers[asked["source"]](tmp_path))
    old = asked.pop("old", False)
    begun = memory_of(tmp_path, asked, lesson, old)
    found = []
    for name, door in (("line", None), ("python", by_python), ("browser", by_browser)):
        memory = tmp_path / f"{name}.sqlite"
        if begun is not None:
            shutil.copy(begun, memory)
        mine = {**asked, "memory": str(memory)}
        document = by_command_line(mine, capsys) if door is None else door(mine)
        for one in (document, *document["alternatives"], document["best"] or document):
            assert one["request"].pop("memory", str(memory)) == str(memory)
        found.append(plain(document))
    line, python, browser = found
    assert line == python
    assert line == browser
    if old:
        assert line["mode"] == 0
    # The plan holds its request, and by the same request the browser's worker found the same plan.
    memory = asked["memory"] = str(tmp_path / "again.sqlite")
    assert PlanRequest.from_json({**line["request"], "memory": memory}).to_json() == request_of(asked)
