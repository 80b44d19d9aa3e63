"""``preshape bench holds`` from files to exit code: verdicts, measures, bad rows, continuing."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from preshape.cli.main import run
from preshape.physics.grasps import STAGES

JOINTS = [f"{f}_{k}" for f in ("thumb", "index", "middle", "ring") for k in
          ("abduction", "flexion_1", "flexion_2", "flexion_3")]  # fmt: skip
# Thumb and middle finger of the Utah/MIT hand on the library's box, as the planner put them.
PALM = [-0.00033, 0.0011, -0.10317, 0.00085, 0.00074, 0.00831, 0.99996]
ANGLES = {
    "pregrasp": [
        0.00135,
        0.42139,
        0.51371,
        0.41064,
        0,
        0,
        0,
        0,
        -0.00307,
        0.37299,
        0.48525,
        0.39864,
        0,
        0,
        0,
        0,
    ],
    "grasp": [0.0019, 0.68135, 0.36366, 0.26577, 0, 0, 0, 0, -0.00307, 0.63978, 0.33861, 0.25042, 0, 0, 0, 0],
    "squeeze": [
        0.00202,
        0.75044,
        0.30838,
        0.21622,
        0,
        0,
        0,
        0,
        -0.00307,
        0.71322,
        0.28113,
        0.19679,
        0,
        0,
        0,
        0,
    ],
}
HALF = (0.045, 0.018, 0.03)  # of the box [m]


@pytest.fixture(autouse=True)
def apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A separate cache and working folder with ``objects/box``: nothing is cut, nothing remains."""
    monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path / "cache"))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    write_box(Path("objects/box/convex/piece.obj"), HALF)
    return tmp_path / "here"


def write_box(path: Path, half: tuple[float, ...]) -> None:
    x, y, z = half
    corners = [(i * x, j * y, k * z) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [f"v {a} {b} {c}" for a, b, c in corners] + [f"f {a} {b} {c} {d}" for a, b, c, d in faces]
    path.write_text("\n".join(lines) + "\n")


def arrays(kinds: str) -> dict[str, Any]:
    """A row for each letter: g a good grasp, o an open one, s one that holds only by the squeeze."""
    stages = {
        "g": ("pregrasp", "grasp", "squeeze"),
        "o": ("pregrasp", "pregrasp", "pregrasp"),
        "s": ("pregrasp", "pregrasp", "squeeze"),
    }
    n = len(kinds)
    content: dict[str, Any] = {
        "object": np.array(["box"] * n),
        "scale": np.ones(n),
        "obj_pose": np.tile([0.0, 0, 0, 1, 0, 0, 0], (n, 1)),
        "joints": np.array(JOINTS),
        "frame": np.array("palm"),
        "hand": np.array("utah_mit"),
    }
    for index, stage in enumerate(STAGES):
        content[stage] = np.array([[*PALM, *ANGLES[stages[kind][index]]] for kind in kinds])
    return content


def save(name: str, kinds: str, **changes: Any) -> str:
    content = {**arrays(kinds), **changes}
    np.savez(name, **{key: array for key, array in content.items() if array is not None})
    return name


def plan(rows: int, **changes: Any) -> dict[str, Any]:
    """A plan document with a number of answers."""
    poses = {stage: {"palm_pose": PALM, "q": ANGLES[stage]} for stage in STAGES}
    hand = {"name": "utah_mit", "joints": JOINTS, "reason": "reached", **poses}
    thing = {"name": "box", "source": "box", "extents": [2 * h for h in HALF], **changes}
    answer = {"object": thing, "hand": hand, "reason": "fine"}
    return {**answer, "alternatives": [answer] * (rows - 1)}


def bench(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = run(["bench", "holds", *words])
    out, err = capsys.readouterr()
    return code, out, err


def as_json(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    code, out, _ = bench(capsys, *words, "--objects", "objects", "--workers", "1", "--json")
    document: dict[str, Any] = json.loads(out)  # exactly one
    return code, document


class TestVerdicts:
    def test_held_lost_and_only_by_squeeze(self, capsys: pytest.CaptureFixture[str]) -> None:
        code, document = as_json(capsys, save("g.npz", "gos"))
        assert code == 0
        assert document["status"] == "answer"
        [found] = document["hands"]
        good, lost, squeezed = found["grasps"]
        assert [row["status"] for row in (good, lost, squeezed)] == ["held", "lost", "held"]
        assert good["clean"]
        assert not good["only_by_squeeze"]
        assert good["at_grasp"]["parts"] == 2
        assert squeezed["only_by_squeeze"]
        assert not squeezed["clean"]
        assert squeezed["at_grasp"]["parts"] == 0
        assert squeezed["touching_at_squeeze"] == 2
        assert lost["reason"].startswith("lost the object: it moved")
        figures = found["all"]
        assert (figures["held"], figures["tested"], figures["touching"]) == (2, 3, 1)
        assert (figures["clean"], figures["only_by_squeeze"]) == (1, 1)
        assert figures["interval"] == pytest.approx([0.2077, 0.9385], abs=1e-4)
        assert found["objects"] == {"box": figures}
        assert found["warnings"] == [
            "1 grasp held only through the squeeze: at the grasp pose fewer than two parts of the hand touch "
            "the object"
        ]

    def test_an_unstable_one_is_a_failure_without_a_log(self, capsys: pytest.CaptureFixture[str]) -> None:
        squeeze = arrays("gg")["squeeze"]
        squeeze[1, 0] = 1e9
        code, document = as_json(capsys, save("g.npz", "gg", squeeze=squeeze))
        assert code == 0
        assert [row["status"] for row in document["hands"][0]["grasps"]] == ["held", "unstable"]
        assert document["hands"][0]["all"]["unstable"] == 1
        assert "1 grasp failed because the simulation became unstable" in document["hands"][0]["warnings"]
        assert not list(Path().glob("MUJOCO_LOG*"))

    def test_a_fatal_error_of_mujoco_is_of_one_grasp(
        self, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        import mujoco

        from preshape.physics.hold import runner

        def test(*args: Any, row: int, **kwargs: Any) -> Any:
            if row == 1:
                raise mujoco.FatalError("out of memory")
            return hold_test(*args, row=row, **kwargs)

        hold_test = runner.hold_test
        monkeypatch.setattr(runner, "hold_test", test)
        code, document = as_json(capsys, save("g.npz", "ggg"))
        assert code == 2
        assert document["reason"].endswith("g.npz row 1: MuJoCo gave up: out of memory")
        assert [row["status"] for row in document["hands"][0]["grasps"]] == ["held", "invalid", "held"]

    def test_a_plan_and_an_array_of_the_same_grasps(self, capsys: pytest.CaptureFixture[str]) -> None:
        Path("plan.json").write_text(json.dumps(plan(2)))
        code, document = as_json(capsys, "plan.json", save("g.npz", "go"))
        assert code == 0
        [found] = document["hands"]
        assert found["hand"] == "utah_mit"
        rows = found["grasps"]
        assert [(row["file"], row["file_row"], row["status"]) for row in rows] == [
            ("plan.json", 0, "held"),
            ("plan.json", 1, "held"),
            ("g.npz", 0, "held"),
            ("g.npz", 1, "lost"),
        ]
        assert rows[0]["probes"] == rows[1]["probes"]
        assert rows[0]["scale"] == pytest.approx(1.0)
        assert rows[0]["at_grasp"] == pytest.approx(rows[2]["at_grasp"])

    def test_each_hand_apart(self, capsys: pytest.CaptureFixture[str]) -> None:
        left = save("left.npz", "o", hand=np.array("utah_mit:left"), joints=None)
        code, document = as_json(capsys, save("g.npz", "g"), left, "--out", "out")
        assert code == 0
        assert [(hand["hand"], hand["all"]["held"]) for hand in document["hands"]] == [
            ("utah_mit", 1),
            ("utah_mit:left", 0),
        ]
        assert sorted(path.name for path in Path("out").iterdir()) == [
            "report.html",
            "report.json",
            "report.md",
        ]

    def test_each_plan_with_its_own_load(self, capsys: pytest.CaptureFixture[str]) -> None:
        """Plans are tested with the mass and friction that they were made for, arrays with 0.1 kg and 0.6."""
        heavy = {"schema": 2, "mass": 5.0, "request": {"friction": 0.5}}
        Path("heavy.json").write_text(json.dumps({**plan(2), **heavy}))
        Path("plan.json").write_text(json.dumps(plan(1)))
        words = ("plan.json", "heavy.json", save("g.npz", "o"))
        code, document = as_json(capsys, *words, "--out", "out")
        assert code == 0
        assert [
            (hand["hand"], hand["mass"], hand["friction"], [row["status"] for row in hand["grasps"]])
            for hand in document["hands"]
        ] == [("utah_mit", 0.1, 0.6, ["held", "lost"]), ("utah_mit", 5.0, 0.5, ["lost", "lost"])]
        assert [(row["file"], row["file_row"]) for row in document["hands"][0]["grasps"]] == [
            ("plan.json", 0),
            ("g.npz", 0),
        ]
        assert (document["protocol"]["mass"], document["protocol"]["friction"]) == (None, None)
        assert document["protocol"]["torsion"] == 0.02
        page = Path("out/report.md").read_text()
        assert "## utah_mit, 5 kg, friction 0.5: 0 of 2 held" in page
        assert "six directions, 50 N on 5 kg, friction 0.5." in page
        _, alike = as_json(capsys, *words, "--mass", "0.1", "--friction", "0.6")
        [hand] = alike["hands"]
        assert (hand["mass"], alike["protocol"]["mass"], len(hand["grasps"])) == (0.1, 0.1, 4)
        assert [row["status"] for row in hand["grasps"]] == ["held", "held", "held", "lost"]

    def test_harder_is_harder(self, capsys: pytest.CaptureFixture[str]) -> None:
        file = save("g.npz", "g")
        _, hard = as_json(capsys, file, "--probes", "all", "--ladder", "--turn-error", "5", "--seed", "3")
        protocol = hard["protocol"]
        assert protocol["turn_error"] == pytest.approx(np.pi / 36)
        [row] = hard["hands"][0]["grasps"]
        assert len(row["probes"]) == 28
        assert row["strength"] == 0.0 or row["strength"] >= 1.0
        assert (row["strength"] >= 1.0) == (row["status"] == "held")
        _, slippery = as_json(capsys, file, "--friction", "0.01")
        assert slippery["hands"][0]["grasps"][0]["status"] == "lost"
        _, heavy = as_json(capsys, file, "--mass", "5")
        assert heavy["hands"][0]["grasps"][0]["status"] == "lost"
        _, far = as_json(capsys, file, "--position-error", "0.2")
        assert far["hands"][0]["grasps"][0]["status"] in ("lost", "penetrates")


class TestBadRows:
    def test_three_bad_ones_among_many(self, capsys: pytest.CaptureFixture[str]) -> None:
        write_box(Path("objects/sheet.obj"), (0.05, 0.02, 0.0))
        content = arrays("g" * 14)
        content["grasp"][3, 2] = np.nan
        content["object"] = np.array(["box"] * 9 + ["sheet", "nothing"] + ["box"] * 3)
        other = save("h.npz", "oo")
        code, out, err = bench(
            capsys, other, save("g.npz", "g" * 14, grasp=content["grasp"], object=content["object"]),
            "--objects", "objects", "--workers", "1", "--out", "out",
        )  # fmt: skip
        assert code == 2
        assert "11/13" in out
        last = err[err.index("error: ") :]
        assert last.startswith("error: 3 of 16 grasps could not be tested, the other 13 were: ")
        assert "g.npz row 3: grasp is not finite" in last
        assert re.search(r"g.npz row 9: .*sheet.* (flat|volume)", last)
        assert "g.npz row 10: no file or built-in object 'nothing'" in last
        report = json.loads(Path("out/report.json").read_text())
        assert report["status"] == "error"
        statuses = [row["status"] for row in report["hands"][0]["grasps"]]
        assert statuses.count("held") == 11
        assert [k for k, status in enumerate(statuses) if status == "invalid"] == [5, 11, 12]
        page = Path("out/report.md").read_text()
        assert "g.npz row 3: grasp is not finite" in page
        assert page.count("| h.npz |") == 2  # the failures by name

    def test_json_stays_one_object(self, capsys: pytest.CaptureFixture[str]) -> None:
        pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (2, 1))
        pose[1] = np.nan
        code, document = as_json(capsys, save("g.npz", "gg", obj_pose=pose))
        assert code == 2
        assert document["status"] == "error"
        assert document["reason"].endswith("g.npz row 1: obj_pose is not finite")
        assert [row["status"] for row in document["hands"][0]["grasps"]] == ["held", "invalid"]

    def test_rows_of_one_reason_are_named_together(self, capsys: pytest.CaptureFixture[str]) -> None:
        code, out, err = bench(capsys, save("g.npz", "gggg", object=np.array(["no"] * 3 + ["nope"])))
        assert code == 2
        assert "g.npz rows 0-2: no file or built-in object 'no'" in err
        assert "g.npz row 3: no file or built-in object 'nope'" in err
        assert "0/0" in out

    def test_a_plan_without_a_squeeze(self, capsys: pytest.CaptureFixture[str]) -> None:
        document = plan(2)
        document["alternatives"][0] = {"hand": {**document["hand"], "squeeze": None, "reason": "too far"}}
        Path("plan.json").write_text(json.dumps(document))
        code, found = as_json(capsys, "plan.json")
        assert code == 2
        assert "plan.json row 1: the plan has no squeeze: too far" in found["reason"]


class TestBadInput:
    @pytest.mark.parametrize(
        ("changes", "options", "code", "sentence"),
        [
            ({"hand": np.array("shadw")}, (), 2, "no hand 'shadw'; did you mean shadow"),
            ({"hand": None}, (), 2, "does not name the hand of its grasps; add --hand"),
            ({"grasp": np.zeros((2, 9))}, (), 2, "g.npz: grasp must be 2×23 numbers, got 2×9"),
            ({"squeeze": np.zeros((3, 23))}, (), 2, "g.npz: squeeze must be 2×23 numbers, got 3×23"),
            ({"grasp": None}, (), 2, "g.npz: missing arrays grasp; it has"),
            ({"joints": np.array(["x"] * 16)}, (), 2, "g.npz: the grasps are for the joints x, x"),
            ({"frame": np.array("wrist")}, (), 2, "g.npz: no frame 'wrist'; known: root, palm"),
            ({}, ("--mass", "0"), 2, "mass must be above 0, got 0.0"),
            ({}, ("--mass", "nan"), 2, "mass must be"),
            ({}, ("--friction", "-1"), 2, "friction must be at least 0, got -1.0"),
            ({}, ("--probes", "seven"), 2, "no probe set 'seven'; known: six, all"),
            ({}, ("--size-error", "0.5"), 2, "size_error must be a share under 0.5"),
            ({}, ("--seed", "-1"), 2, "seed must be a whole number of at least 0, got -1"),
            ({}, ("--workers", "0"), 2, "--workers must be 1 or more, got 0"),
            ({}, ("--out", " "), 2, "--out needs a folder"),
            ({}, ("--root", "palm"), 2, "--root and --fixed belong to a model"),
            ({}, ("--hand", "model.xml"), 2, "model.xml is a model: add --root BODY"),
            ({}, ("--hand", "none.xml", "--root", "a"), 3, "cannot read none.xml"),
            ({}, ("--objects", "nowhere"), 3, "no folder nowhere"),
        ],
    )  # fmt: skip
    def test_one_sentence(
        self,
        changes: dict[str, Any],
        options: tuple[str, ...],
        code: int,
        sentence: str,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        found, out, err = bench(capsys, save("g.npz", "gg", **changes), *options)
        assert (found, out) == (code, "")
        assert err.startswith("error: ")
        assert sentence in err
        assert err.count("\n") == 1

    def test_files_that_are_none(self, capsys: pytest.CaptureFixture[str]) -> None:
        Path("text").write_text("hello")
        Path("other.json").write_text("[1]")
        np.savez("pickled.npz", object=np.array([{}], dtype=object), allow_pickle=True)
        for name, code, sentence in (
            ("text", 2, "neither an npz of grasps nor a plan"),
            ("other.json", 2, "is not a plan of this program"),
            ("pickled.npz", 2, "expected an npz without pickle"),
            (save("empty.npz", "", pregrasp=np.zeros((0, 23)), grasp=np.zeros((0, 23)),
                  squeeze=np.zeros((0, 23)), object=np.array([], dtype=np.str_)), 2, "no grasp in it"),
            ("none.npz", 3, "cannot read none.npz"),
        ):  # fmt: skip
            found, out, err = bench(capsys, name)
            assert (found, out) == (code, ""), name
            assert sentence in err
            assert err.count("\n") == 1


class TestGoingOn:
    @pytest.mark.slow
    def test_one_process_or_two(self, capsys: pytest.CaptureFixture[str]) -> None:
        file = save("g.npz", "gosgosgos")
        words = [file, "--objects", "objects", "--position-error", "0.003", "--seed", "5"]
        assert bench(capsys, *words, "--workers", "1", "--out", "one")[0] == 0
        code, _, err = bench(capsys, *words, "--workers", "2", "--out", "two")
        assert code == 0
        assert "100 %, 9 of 9 grasps" in err
        one, two = (Path(folder) / "report.json" for folder in ("one", "two"))
        assert one.read_bytes() == two.read_bytes()
        assert (one.parent / "report.md").read_bytes() == (two.parent / "report.md").read_bytes()

    @pytest.mark.slow
    @pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
    @pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
    def test_stopped_and_finished(
        self, how: signal.Signals, apart: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        words = [save("g.npz", "gs" * 5), "--objects", "objects", "--workers", "1"]
        kept = apart / "out" / "unfinished.jsonl"
        code, out, err = _stopped([*words, "--out", "out"], kept, 4, how)
        assert out == ""
        done = kept.read_bytes().count(b"\n") - 1
        assert 3 <= done < 10
        if how is signal.SIGINT:
            assert code == 130
            assert "Traceback" not in err
            [told] = re.findall(r"stopped after (\d+) of 10 grasps; the same command goes on from there", err)
            assert done - int(told) in (0, 1)  # it may be stopped between keeping a result and saying so
        else:
            assert code == -signal.SIGKILL
            with kept.open("ab") as file:  # as a crash may leave it
                file.write(b'{"row": 9, "sta')
        code, _, err = bench(capsys, *words, "--out", "out")
        assert code == 0
        assert err.startswith(f"{10 * done:3d} %, {done} of 10 grasps\n")
        assert not kept.exists()
        assert bench(capsys, *words, "--out", "whole")[0] == 0
        assert Path("out/report.json").read_bytes() == Path("whole/report.json").read_bytes()

    def test_a_checkpoint_stays_and_is_for_one_test_only(self, capsys: pytest.CaptureFixture[str]) -> None:
        file = save("g.npz", "go")
        code, first = as_json(capsys, file, "--checkpoint", "run.jsonl")
        assert code == 0
        kept = Path("run.jsonl").read_bytes()
        assert as_json(capsys, file, "--checkpoint", "run.jsonl") == (0, first)
        assert Path("run.jsonl").read_bytes() == kept
        code, document = as_json(capsys, file, "--checkpoint", "run.jsonl", "--friction", "0.3")
        assert code == 2
        assert "belongs to a test of other grasps" in document["reason"]
        assert Path("run.jsonl").read_bytes() == kept

    @pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
    def test_two_runs_do_not_share_a_checkpoint(self, capsys: pytest.CaptureFixture[str]) -> None:
        import fcntl

        file = save("g.npz", "o")
        with Path("run.jsonl").open("ab") as held:
            fcntl.flock(held.fileno(), fcntl.LOCK_EX)
            code, document = as_json(capsys, file, "--checkpoint", "run.jsonl")
        assert code == 2
        assert "is in use by another run" in document["reason"]


def _stopped(words: list[str], kept: Path, lines: int, how: signal.Signals) -> tuple[int, str, str]:
    """Run the command in a process and stop it when the file has a number of lines."""
    # A shell's background job, as CI may be, starts its children with the signal ignored.
    heeding = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from preshape.cli.main import main; main()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", heeding, "bench", "holds", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
    ) as process:
        deadline = time.monotonic() + 100
        while time.monotonic() < deadline and process.poll() is None:
            if kept.exists() and kept.read_bytes().count(b"\n") >= lines:
                process.send_signal(how)
                break
            time.sleep(0.01)
        out, err = process.communicate(timeout=100)
    return process.returncode, out, err


class TestObjects:
    def test_a_plan_s_object_is_found_in_folder_library_path_and_beside(
        self, apart: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        # The file is in millimetres and 15 m long if read as metres; the plan says how large it is.
        big = tuple(1000 * h for h in HALF)
        other = apart.parent / "elsewhere"
        write_box(other / "case.obj", (big[0] * 10, big[1] * 10, big[2] * 10))
        sources = {
            "folder.json": ("/gone/box.obj", ("--objects", "objects")),
            "library.json": ("box", ()),
            str(other / "beside.json"): ("there/case.obj", ()),
            "path.json": (str(other / "case.obj"), ()),
        }
        seen = {}
        for file, (source, options) in sources.items():
            Path(file).write_text(json.dumps(plan(1, source=source)))
            code, out, err = bench(capsys, file, "--workers", "1", "--json", *options)
            assert code == 0, err
            [row] = json.loads(out)["hands"][0]["grasps"]
            assert row["status"] == "held", (file, row)
            seen[Path(file).stem] = row["scale"]
        assert seen == pytest.approx({"folder": 1.0, "library": 1.0, "beside": 1e-4, "path": 1e-4})

    def test_a_missing_one(self, capsys: pytest.CaptureFixture[str]) -> None:
        Path("plan.json").write_text(json.dumps(plan(1, source="/gone/vase.obj")))
        code, _, err = bench(capsys, "plan.json")
        assert code == 2
        assert "plan.json row 0: " in err
        assert "vase.obj" in err


def test_the_documented_code_writes_a_file_that_is_read(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parent.parent / "docs" / "grasp-file.md").read_text(encoding="utf-8")
    [code] = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert len([line for line in code.splitlines() if line]) == 5
    exec(code, {})  # noqa: S102
    done, document = as_json(capsys, "grasps.npz")
    assert done == 0
    assert [row["object_name"] for row in document["hands"][0]["grasps"]] == ["box", "box"]
    # Every option and every figure is explained.
    from preshape.cli.bench_holds import holds

    for option in holds.params:
        assert option.name == "files" or f"`{option.opts[0]}" in page, option.opts
    for key in document["hands"][0]["all"]:
        assert key in ("grasps", "tested", "held", "rate", "interval") or f"`{key}`" in page, key


def test_what_a_person_sees(capsys: pytest.CaptureFixture[str]) -> None:
    write_box(Path("objects/a_box_with_a_very_long_name_indeed.obj"), HALF)
    names = np.array(["box", "a_box_with_a_very_long_name_indeed"])
    code, out, err = bench(
        capsys, save("g.npz", "gs", object=names), "--objects", "objects", "--workers", "1", "--ladder"
    )
    assert code == 0
    assert out.startswith("utah_mit: six directions, 1 N on 0.1 kg, friction 0.6, strength ladder\n")
    rows = [line.split() for line in out.splitlines()]
    score = next(row for row in rows if row[:1] == ["box"])
    assert score[1:4] == ["1/1", "100.0", "21-100"]
    assert any(row[:2] == ["a_box_with_a_very_long_…", "1/1"] for row in rows)
    assert any(row[:2] == ["all", "2/2"] for row in rows)
    assert "! 1 grasp held only through the squeeze" in out.replace("\n", " ")
    assert err.splitlines()[-1] == "100 %, 2 of 2 grasps"


@pytest.mark.slow
def test_published_grasps_as_the_library_judges_them(
    reference: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from preshape.physics.grasps import read_grasps
    from preshape.physics.hand import hand_from_mjcf
    from preshape.physics.hold.report import result_to_json
    from preshape.physics.hold.runner import run_holds

    folder = reference / "dexgraspbench"
    rows = [41, 146, 237, 249, 326]
    with np.load(folder / "bodex_shadow_grasps.npz") as stored:
        np.savez("few.npz", **{name: stored[name][rows] for name in stored.files})
    model = reference / "hands" / "shadow_hand" / "right_hand.xml"
    code, out, _ = bench(
        capsys, "few.npz", "--hand", str(model), "--root", "rh_wrist",
        "--fixed", "rh_WRJ2", "--fixed", "rh_WRJ1",
        "--objects", str(folder / "objects"), "--workers", "1", "--json",
    )  # fmt: skip
    assert code == 0
    found = json.loads(out)["hands"][0]["grasps"]
    assert [row["status"] == "held" for row in found] == [True, False, True, False, False]
    hand = hand_from_mjcf(model, root="rh_wrist", fixed=("rh_WRJ2", "rh_WRJ1"))
    own = run_holds(read_grasps("few.npz"), hand, objects=folder / "objects", workers=1)
    expected = json.loads(json.dumps([result_to_json(result) for result in own.results]))
    assert [{k: v for k, v in row.items() if k not in ("file", "file_row")} for row in found] == expected
