"""Datasets: what stands in a shard, and that nothing but the settings decides it.

Run as a script this file makes the dataset on a Ray cluster of two nodes, in a process of its own.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from preshape.cli import main as cli
from preshape.closure.hand_tables import hand_tables
from preshape.dataset import drawing, engines, making
from preshape.dataset.engines import LocalEngine, RayEngine
from preshape.dataset.folder import differences
from preshape.dataset.making import MadeShard, make_shard, versions
from preshape.dataset.run import DatasetReport, run_dataset
from preshape.dataset.schema import (
    COLUMNS,
    DIRECTIONS,
    FORMAT,
    META,
    arrow_schema,
    facts_of,
    markdown,
    parquet_bytes,
)
from preshape.dataset.settings import DatasetSettings, Shard, list_shards
from preshape.exceptions import EnvironmentFailure, InputError, ObjectError, UnknownHand, UnknownObject
from preshape.hands.load import load_hand
from preshape.kernels.chains import joint_frames
from preshape.kernels.field.host import SurfaceQuery
from preshape.kernels.hand_spheres import FINE
from preshape.metrics import Contacts, epsilon, force_closure
from preshape.objects.load import load_object
from preshape.physics.grasps import GraspSet
from preshape.physics.hand import physics_hand
from preshape.physics.hold.runner import run_holds
from preshape.physics.pieces import load_pieces
from preshape.planning.planner_bench import Case
from preshape.tasks import named_task

pq = pytest.importorskip("pyarrow.parquet")

ROOT = Path(__file__).parents[1]
SMALL = DatasetSettings(per=3, per_shard=1, candidates=200, physics=False)
"""Six shards of one grasp each, with the two objects below."""
THINGS = (Case(name="box@1", source="box", scale=1.0), Case(name="cube@1", source="cube", scale=1.0))
COMMAND = (
    "dataset box cube --hands allegro --tasks lift --per 3 --per-shard 1 --candidates 200 --no-physics --out"
).split()
"""The same on the command line."""
ATTEMPTS = "PRESHAPE_TEST_ATTEMPTS"


def make(out: Path, *, engine: engines.Engine | None = None, settings: DatasetSettings = SMALL, **more):
    given = {"cases": THINGS, "hands": ["allegro"], "tasks": ["lift"], **more}
    return run_dataset(**given, out=out, engine=engine or LocalEngine(workers=1), settings=settings)


def content(out: Path) -> dict[str, bytes]:
    """Everything in a dataset but the log."""
    return {
        str(p.relative_to(out)): p.read_bytes()
        for p in sorted(out.rglob("*"))
        if p.is_file() and p.name != "log.jsonl"
    }


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small dataset, made by one process that nobody disturbed."""
    out = tmp_path_factory.mktemp("plain")
    report = make(out)
    assert (report.made, len(report.facts), report.total("rows"), report.damaged) == (6, 6, 6, 0)
    return out


@pytest.fixture(scope="module")
def tested(tmp_path_factory: pytest.TempPathFactory) -> tuple[DatasetReport, list[dict]]:
    """One shard with physics, and its rows as pyarrow reads them."""
    out = tmp_path_factory.mktemp("tested")
    settings = replace(SMALL, per=2, per_shard=2, physics=True)
    report = make(out, settings=settings, cases=THINGS[:1])
    (file,) = (out / "shards").glob("*.parquet")
    return report, pq.read_table(file).to_pylist()


# -- what stands in a row ------------------------------------------------------------------------------


def test_a_shard_has_the_documented_columns_and_no_others(tested) -> None:
    report, rows = tested
    (file,) = (report.folder / "shards").glob("*.parquet")
    schema = pq.read_schema(file)
    assert schema.equals(arrow_schema())
    for row in rows:
        assert [name for name, item in row.items() if item is None and not _column(name).nullable] == []
    text = (ROOT / "docs" / "dataset.md").read_text(encoding="utf-8")
    assert markdown() in text
    assert json.loads(schema.metadata[META])["rows"] == len(rows) == 2


def test_the_documented_way_to_read_it_works(tested, tmp_path: Path, monkeypatch, capsys) -> None:
    text = (ROOT / "docs" / "dataset.md").read_text(encoding="utf-8")
    code = text.partition("```python\n")[2].partition("```")[0]
    assert 5 <= len(code.splitlines()) <= 6
    (tmp_path / "d").symlink_to(tested[0].folder)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "docs/dataset.md", "exec"), {})  # noqa: S102
    first, second = capsys.readouterr().out.splitlines()
    assert int(first.split()[0]) == sum(row["held"] and row["quality"] > 3.0 for row in tested[1]) > 0
    assert second.startswith("box lift:+z [")


def _column(name: str):
    return next(column for column in COLUMNS if column.name == name)


def test_contacts_forces_and_postures_of_a_row_fit_each_other_and_the_object(tested) -> None:
    _, rows = tested
    mesh, hand = load_object("box"), load_hand("allegro")
    surface, tables = SurfaceQuery(mesh), hand_tables(hand, FINE)
    for row in rows:
        points, normals = np.array(row["contact_points"]), np.array(row["contact_normals"])
        forces = np.array(row["forces"])
        assert np.abs(surface.closest(points).point - points).max() < 1e-7
        assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-6
        pressed = np.einsum("ni,ni->n", forces, normals)
        assert (pressed >= 0).all()  # a link of a wrap may touch without a share of the load
        assert (pressed > 0).sum() >= 2
        assert math.isclose(pressed.sum(), row["press"], rel_tol=1e-9)
        assert np.linalg.norm(forces - pressed[:, None] * normals, axis=1).max() <= 0.6 * pressed.max()
        assert np.linalg.norm(forces.sum(axis=0)) < 0.03 * row["press"]
        assert row["fingers"][0] == "thumb"
        assert len(row["fingers"]) == len(points) == len(forces)
        # Palm pose and angles of the grasp bring the finger's own links to its contact, and none into it.
        frames, turns = joint_frames(tables, np.array([row["grasp_q"]]))
        palm = row["grasp_palm"]
        R = _rotation(palm[3:])
        # Fingertips touch. A link of a wrap may be 1 mm away, and its spheres fill its pieces to 1 mm.
        most = 5e-4 if len({*row["fingers"]}) == len(points) and "palm" not in row["fingers"] else 2e-3
        for finger, point in zip(row["fingers"], points, strict=True):
            gaps = []
            if finger == "palm":
                distance = np.linalg.norm(np.array(palm[:3]) + tables.palm[:, :3] @ R.T - point, axis=1)
                gaps += (distance - tables.palm[:, 3]).tolist()
                assert -1e-4 < min(gaps) < most
                continue
            index = tables.fingers.index(finger)
            for joint in range(int(tables.joint_start[index]), int(tables.joint_start[index + 1])):
                spheres = tables.sphere[int(tables.sphere_start[joint]) : int(tables.sphere_start[joint + 1])]
                centres = frames[0, joint] + spheres[:, :3] @ turns[0, joint].T
                distance = np.linalg.norm(np.array(palm[:3]) + centres @ R.T - point, axis=1)
                gaps += (distance - spheres[:, 3]).tolist()
            assert -1e-4 < min(gaps) < most


def _rotation(wxyz: list[float]) -> np.ndarray:
    w, x, y, z = wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_metrics_follow_from_the_contacts_in_the_row(tested) -> None:
    _, rows = tested
    mesh = load_object("box")
    for row in rows:
        contacts = Contacts(
            positions=np.array(row["contact_points"]),
            normals_in=np.array(row["contact_normals"]),
            friction=0.6,
            torsion=0.005,
            reference=mesh.cog,  # of a box also the centre of mass
            length=float(mesh.extents.max()) / 2,
        )
        assert row["metric_closed"] == force_closure(contacts).closed
        assert row["metric_epsilon_l1"] == pytest.approx(epsilon(contacts, "L1").number, rel=0.02)
        assert row["metric_status"]["epsilon_l1"] == "OK"
        assert row["quality"] >= 3.0
        assert sum(row["adi"]) == pytest.approx(row["metric_tfvadi"])
    assert rows[0]["quality"] >= rows[1]["quality"]


def test_the_physics_can_be_repeated_from_the_file_alone(tested) -> None:
    _, rows = tested
    document = json.loads((tested[0].folder / "dataset.json").read_text())
    joints = tuple(document["hands"]["allegro"]["joints"])
    stages = {
        stage: np.array([row[f"{stage}_palm"] + row[f"{stage}_q"] for row in rows])
        for stage in ("pregrasp", "grasp", "squeeze")
    }
    grasps = GraspSet(
        hand="allegro",
        joints=joints,
        objects=("box",) * len(rows),
        scale=np.ones(len(rows)),
        object_pose=np.tile([0.0, 0, 0, 1, 0, 0, 0], (len(rows), 1)),
        frame="palm",
        **stages,
    )
    report = run_holds(
        grasps, physics_hand(load_hand("allegro")), pieces={"box": load_pieces("box")}, workers=1
    )
    assert DIRECTIONS == ("+x", "+y", "+z", "-x", "-y", "-z")
    for row, result in zip(rows, report.results, strict=True):
        assert (row["hold_status"], row["held"]) == (result.status.name.lower(), result.held)
        assert row["held_directions"] == [probe.held for probe in result.probes]
        assert row["hold_displacement"] == [probe.displacement for probe in result.probes]
        assert row["held"] == all(row["held_directions"])
        assert row["penetration"] == result.at_grasp.penetration
        assert row["task_suits"]
        assert row["task_done"] == (row["task_status"] == "done")
        assert row["task_progress"] == 1.0 or not row["task_done"]


def test_a_task_that_does_not_suit_the_object_is_planned_but_not_tested(tmp_path: Path) -> None:
    settings = replace(SMALL, per=1, physics=True)
    report = make(tmp_path, settings=settings, cases=THINGS[1:], tasks=["pour"])
    (row,) = pq.read_table(next((tmp_path / "shards").glob("*.parquet"))).to_pylist()
    assert (row["task_suits"], row["task_status"], row["task_done"]) == (False, None, None)
    assert row["held"] is not None
    assert (report.total("hold_tested"), report.total("task_tested")) == (1, 0)
    assert row["task_q"] == named_task("pour").q.tolist()


def test_files_state_mass_friction_and_scene(tmp_path: Path) -> None:
    settings = replace(SMALL, per=1, mass=0.25, friction=0.4)
    report = make(tmp_path, settings=settings, cases=THINGS[:1])
    conditions = {"mass": 0.25, "friction": 0.4, "table": None, "avoid": []}
    assert conditions.items() <= report.facts[0].items()
    (file,) = (tmp_path / "shards").glob("*.parquet")
    assert conditions.items() <= json.loads(pq.read_schema(file).metadata[META]).items()
    assert conditions.items() <= json.loads((tmp_path / "dataset.json").read_text())["settings"].items()


def test_unranked_grasps_are_planned_with_the_friction_of_the_dataset(tmp_path: Path) -> None:
    settings = replace(SMALL, per=3, per_shard=3, ranked=False, friction=0.2)
    make(tmp_path, settings=settings, cases=THINGS[:1])
    rows = pq.read_table(next((tmp_path / "shards").glob("*.parquet"))).to_pylist()
    assert len(rows) == 3
    for row in rows:
        forces, normals = np.array(row["forces"]), np.array(row["contact_normals"])
        pressed = np.einsum("ni,ni->n", forces, normals)
        sliding = np.linalg.norm(forces - pressed[:, None] * normals, axis=1)
        assert (sliding <= 0.2 * pressed + 1e-6).all()


def test_unranked_grasps_are_of_all_qualities(tmp_path: Path) -> None:
    settings = replace(SMALL, per=6, per_shard=6, ranked=False)
    report = make(tmp_path, settings=settings, cases=THINGS[:1])
    rows = pq.read_table(next((tmp_path / "shards").glob("*.parquet"))).to_pylist()
    assert report.total("rows") == 6
    assert min(row["quality"] for row in rows) < 3.0
    assert not any(row["ranked"] for row in rows)
    assert all(row["press"] <= 10.0 + 1e-5 for row in rows)


# -- never a silent drop -------------------------------------------------------------------------------


def test_what_has_no_answer_is_a_shard_without_rows_and_with_a_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drawing, "MAX_SEARCHES", 1)  # each takes seconds, and finds no more
    (tmp_path / "broken.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    cases = (
        Case(name="box@8", source="box", scale=8.0),
        Case(name="broken@1", source=str(tmp_path / "broken.obj"), scale=1.0),
    )
    out = tmp_path / "out"
    report = make(out, settings=replace(SMALL, per=1, physics=True), cases=cases)
    assert [(f["rows"], f["asked"]) for f in report.facts] == [(0, 1), (0, 1)]
    huge, broken = (f["reason"] for f in report.facts)
    assert "candidates were tried" in huge
    assert "broken.obj" in broken
    assert pq.read_table(out / "shards").num_rows == 0
    assert report.to_json()["status"] == "no_answer"
    assert make(out, settings=replace(SMALL, per=1, physics=True), cases=cases).made == 0


def test_names_that_do_not_exist_are_errors_at_once(tmp_path: Path) -> None:
    for more, error in (
        ({"cases": [Case(name="bocks@1", source="bocks", scale=1.0)]}, UnknownObject),
        ({"cases": [Case(name="none@1", source=str(tmp_path / "none.obj"), scale=1.0)]}, ObjectError),
        ({"hands": ["shadw"]}, UnknownHand),
        ({"tasks": ["0 0 0 0 0 0"]}, InputError),
        ({"tasks": ["lift", "lift"]}, InputError),
        ({"tasks": ["0 0 1 0 0 0", "0 0 1.0 0 0 0"]}, InputError),
        ({"hands": ["allegro", "allegro:right"]}, InputError),
        ({"settings": replace(SMALL, per=10**12)}, InputError),
        ({"cases": [*THINGS, THINGS[0]]}, InputError),
    ):
        with pytest.raises(error):
            make(tmp_path / "out", **more)
    assert not (tmp_path / "out").exists()


# -- shards --------------------------------------------------------------------------------------------


def test_a_shard_is_known_by_its_content_and_not_by_how_much_else_is_asked() -> None:
    few = list_shards(THINGS, ["allegro"], ["lift"], SMALL)
    many = list_shards(
        [*THINGS, Case(name="box@2", source="box", scale=2.0)],
        ["allegro", "leap"],
        ["lift", "pour:-y", "1 1 .1 .05 .8 .05"],
        replace(SMALL, per=5),
    )
    assert len(many) == 3 * 2 * 3 * 5
    assert len({shard.name for shard in many}) == len({shard.seed for shard in many}) == len(many)
    known = {shard.name: shard.seed for shard in many}
    assert all(known[shard.name] == shard.seed for shard in few)
    # Objects take turns.
    assert [shard.object_name for shard in few[:4]] == ["box", "cube", "box", "cube"]
    other = list_shards(THINGS, ["allegro"], ["lift"], replace(SMALL, seed=1))
    assert not {shard.seed for shard in other} & {shard.seed for shard in few}
    uneven = list_shards(THINGS[:1], ["allegro"], ["lift"], replace(SMALL, per=7, per_shard=3))
    assert [shard.count for shard in uneven] == [3, 3, 1]
    assert all(0 <= shard.seed < 2**63 for shard in many)


def test_a_damaged_file_is_no_shard() -> None:
    facts = {"format": FORMAT, "shard": "a", "rows": 0}
    whole = parquet_bytes([], facts)
    assert whole == parquet_bytes([], dict(reversed(facts.items())))
    assert facts_of(whole) == facts
    assert facts_of(parquet_bytes([], {**facts, "rows": 1})) is None
    for broken in (b"", b"PAR1", whole[:-9], whole[: len(whole) // 2], b"x" * 200):
        assert facts_of(broken) is None


def test_a_shard_with_one_wrong_bit_anywhere_is_no_shard(
    tested, plain: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is not given to the reader of Parquet, which reserves gigabytes for a wrong length."""
    random = np.random.default_rng(7)
    for folder in (tested[0].folder, plain):
        stored = next((folder / "shards").glob("*.parquet")).read_bytes()
        assert facts_of(stored) is not None
    monkeypatch.delattr(pq, "read_metadata")
    for folder in (tested[0].folder, plain):
        stored = next((folder / "shards").glob("*.parquet")).read_bytes()
        for place in random.permutation(len(stored))[:200]:
            broken = bytearray(stored)
            broken[place] ^= 1 << int(random.integers(8))
            assert facts_of(bytes(broken)) is None, place


def test_a_process_with_other_versions_or_another_object_refuses() -> None:
    shard = list_shards(THINGS[:1], ["allegro"], ["lift"], SMALL)[0]
    with pytest.raises(EnvironmentFailure, match=r"numpy .* instead of 0\.1"):
        make_shard(shard, SMALL, {**versions(), "numpy": "0.1"})
    with pytest.raises(InputError, match="another object"):
        make_shard(replace(shard, mesh="0"), SMALL, versions())


# -- resuming ------------------------------------------------------------------------------------------


def test_a_finished_dataset_is_left_as_it_is(plain: Path) -> None:
    before = content(plain)
    stamps = {p: p.stat().st_mtime_ns for p in (plain / "shards").iterdir()}
    report = make(plain)
    assert (report.made, report.total("rows")) == (0, 6)
    assert content(plain) == before
    assert {p: p.stat().st_mtime_ns for p in (plain / "shards").iterdir()} == stamps


def test_missing_and_damaged_shards_are_made_again_and_leftovers_cleared(plain: Path, tmp_path: Path) -> None:
    before = content(plain)
    for name, stored in before.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(stored)
    first, second, *_ = sorted((tmp_path / "shards").iterdir())
    first.unlink()
    stored = bytearray(second.read_bytes())
    stored[len(stored) // 3] ^= 0x55
    second.write_bytes(stored)
    (tmp_path / "shards" / f".{first.stem}-abc123.parquet").write_bytes(b"PAR1")
    report = make(tmp_path)
    assert (report.made, report.damaged) == (2, 1)
    assert content(tmp_path) == before


def test_another_dataset_is_refused_and_the_sentence_says_what_differs(plain: Path, tmp_path: Path) -> None:
    before = content(plain)
    with pytest.raises(InputError, match=r"friction was 0\.6, now 0\.3; seed was 0, now 7"):
        make(plain, settings=replace(SMALL, friction=0.3, seed=7))
    with pytest.raises(InputError, match="object cube@1 is missing"):
        make(plain, cases=THINGS[:1])
    with pytest.raises(InputError, match=r"task turn:.* is new"):
        make(plain, tasks=["lift", "turn"])
    assert content(plain) == before
    (tmp_path / "shards").mkdir()
    (tmp_path / "shards" / "mine.parquet").write_bytes(b"")
    (tmp_path / "shards" / ".notes.parquet").write_bytes(b"mine too")
    with pytest.raises(InputError, match="something else"):
        make(tmp_path)
    assert (tmp_path / "shards" / ".notes.parquet").read_bytes() == b"mine too", (
        "nothing of others is touched"
    )
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "dataset.json").write_text('{"format": "preshape dataset 1"}')
    with pytest.raises(InputError, match="not the list of a dataset"):
        make(tmp_path / "other")
    assert [p.name for p in (tmp_path / "other").iterdir()] == ["dataset.json"]
    there = json.loads((plain / "dataset.json").read_text())
    assert differences(there, there) == []
    here = {**there, "versions": {**there["versions"], "mujoco-core": "9"}}
    assert [d.startswith("version of mujoco-core was") for d in differences(there, here)] == [True]


def test_two_runs_do_not_write_the_same_folder(plain: Path) -> None:
    with (plain / "log.jsonl").open("ab") as log:
        import fcntl

        fcntl.flock(log.fileno(), fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another run"):
            make(plain)


# -- killed --------------------------------------------------------------------------------------------


def killed_once(shard: Shard, settings: DatasetSettings, wanted: dict[str, str]) -> MadeShard:
    """Makes a shard, but the first process that makes part 1 of the box dies before it hands it over."""
    folder = Path(os.environ[ATTEMPTS])
    made = make_shard(shard, settings, wanted)
    tried = folder / shard.name
    with tried.open("a") as file:
        file.write(f"{os.getpid()}\n")
    if shard.part == 1 and shard.object_name == "box" and len(tried.read_text().split()) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return made


def attempts(folder: Path) -> dict[str, list[str]]:
    return {p.name: p.read_text().split() for p in folder.iterdir()}


@pytest.mark.slow
def test_two_workers_of_which_one_is_killed_make_the_same_bytes(
    plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tries = tmp_path / "tries"
    tries.mkdir()
    monkeypatch.setenv(ATTEMPTS, str(tries))
    monkeypatch.setattr(engines, "make_shard", killed_once)
    out = tmp_path / "out"
    report = make(out, engine=LocalEngine(workers=2))
    assert report.made == 6
    assert content(out) == content(plain)
    (again,) = (pids for name, pids in attempts(tries).items() if "box" in name and "-0001-" in name)
    assert len(again) == 2
    assert again[0] != again[1]


def test_a_fault_in_one_shard_leaves_the_others_and_is_tried_again(
    plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = making.shard_grasps

    def broken(hand, mesh, task, count, seed, settings):
        if faulty_seed == seed:
            raise IndexError("list index out of range")
        return original(hand, mesh, task, count, seed, settings)

    faulty_seed = list_shards(THINGS, ["allegro"], ["lift"], SMALL)[2].seed
    monkeypatch.setattr(making, "shard_grasps", broken)
    with pytest.raises(
        EnvironmentFailure, match=r"1 of 6 shards.*-0001-.*IndexError: list index out of range"
    ):
        make(tmp_path)
    assert len(content(tmp_path)) == 6  # the list and five shards
    monkeypatch.undo()
    assert make(tmp_path).made == 1
    assert content(tmp_path) == content(plain)


def always_killed(shard: Shard, settings: DatasetSettings, wanted: dict[str, str]) -> MadeShard:
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


@pytest.mark.slow
def test_workers_that_are_always_killed_end_the_run_with_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engines, "make_shard", always_killed)
    monkeypatch.setattr(engines, "MAX_KILLS", 1)
    with pytest.raises(EnvironmentFailure, match=r"killed 1 times .* finished shards are kept"):
        make(tmp_path, engine=LocalEngine(workers=2))


def started(out: Path, cache: Path, workers: int) -> subprocess.Popen[str]:
    environment = {**os.environ, "PRESHAPE_CACHE": str(cache), "COLUMNS": "100"}
    # A shell's background job, as CI may be, starts its children with the signal ignored.
    heeding = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from preshape.cli.main import main; main()"
    )
    return subprocess.Popen(
        [sys.executable, "-c", heeding, *COMMAND, str(out), "--workers", str(workers)],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for(out: Path, shards: int, run: subprocess.Popen[str]) -> None:
    """Until so many shards stand."""
    while len(list((out / "shards").glob("[!.]*.parquet"))) < shards:
        assert run.poll() is None, run.communicate()
        time.sleep(0.005)


def alive(process: int) -> bool:
    stat = Path(f"/proc/{process}/stat")
    try:
        return stat.read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs Linux' /proc")
def test_interrupted_then_killed_then_resumed_gives_the_bytes_of_an_undisturbed_run(
    plain: Path, tmp_path: Path
) -> None:
    out, cache = tmp_path / "out", tmp_path / "cache"  # a cache of its own: nothing in it may matter
    run = started(out, cache, workers=2)
    wait_for(out, 1, run)
    run.send_signal(signal.SIGINT)
    told, said = run.communicate()
    assert run.returncode == 130
    assert told == ""
    assert "the same command goes on from there" in said
    assert "Traceback" not in said
    standing = len(list((out / "shards").iterdir()))
    assert 1 <= standing < 6

    run = started(out, cache, workers=2)
    wait_for(out, standing + 1, run)
    children = [int(p.name) for p in Path("/proc").glob("[0-9]*") if _parent(p) == run.pid]
    assert len(children) >= 2
    run.kill()
    run.communicate()
    assert run.returncode == -signal.SIGKILL
    while any(alive(child) for child in children):  # they end with the one that started them
        time.sleep(0.01)
    stood = {name: stored for name, stored in content(out).items() if "/." not in name}
    assert len(stood) < 7

    assert make(out).made == 7 - len(stood)
    assert content(out) == content(plain)
    assert stood.items() <= content(out).items()
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines() if line[-1] == "}"]
    assert len({line["shard"] for line in lines}) >= 5


def _parent(process: Path) -> int:
    try:
        return int((process / "stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


# -- the command ---------------------------------------------------------------------------------------


def test_the_command_prints_one_json_object_and_says_what_is_missing(plain: Path, capsys) -> None:
    code = cli.run([*COMMAND, str(plain), "--json"])
    document = json.loads(capsys.readouterr().out)
    assert (code, document["status"], document["made"], document["rows"]) == (0, "answer", 0, 6)
    assert document["short"] == []
    code = cli.run([*COMMAND, str(plain), "--friction", "0.3", "--json"])
    document = json.loads(capsys.readouterr().out)
    assert (code, document["status"]) == (2, "error")
    assert "friction was 0.6, now 0.3" in document["reason"]


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["--per", "0"], "--per must be 1 or more"),
        (["--workers", "0"], "--workers must be 1 or more"),
        (["--friction", "nan"], "friction must be a positive, finite number"),
        (["--scales", "0"], "--scales takes positive numbers"),
        (["--engine", "slurm"], "no engine 'slurm'; known: local, ray"),
        (["--engine", "ray", "--workers", "2"], "a Ray cluster has its own number"),
        (["--address", "a:1"], "add --engine ray"),
        (["--host", "0.0.0.0"], "add --engine ray"),
        (["--engine", "ray", "--host", "0.0.0.0", "--address", "a:1"], "give one of them"),
        (["--hands", "allegro,,leap"], "--hands takes names with commas between"),
    ],
)
def test_the_command_refuses_what_it_cannot_use(more, sentence, tmp_path, capsys) -> None:
    assert cli.run([*COMMAND, str(tmp_path / "out"), *more]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# -- ray -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_ray_cluster_of_two_nodes_with_a_killed_worker_makes_the_same_bytes(
    plain: Path, tmp_path: Path
) -> None:
    pytest.importorskip("ray")
    tries, out = tmp_path / "tries", tmp_path / "out"
    tries.mkdir()
    ran = subprocess.run(
        [sys.executable, "-W", "ignore", __file__, str(out)],
        env={**os.environ, ATTEMPTS: str(tries), "RAY_USAGE_STATS_ENABLED": "0"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout.splitlines()[-1])
    assert found["made"] == 6
    assert found["nodes"] == 2
    assert "no bocks here" in found["error"]
    assert content(out) == content(plain)
    (again,) = (pids for name, pids in attempts(tries).items() if "box" in name and "-0001-" in name)
    assert len(set(again)) == 2
    assert all(len(pids) == 1 for name, pids in attempts(tries).items() if "cube" in name)


def test_a_cluster_that_is_not_there_is_a_sentence_at_once(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))  # bound, but nobody listens
        address = f"127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(EnvironmentFailure, match=f"no Ray cluster at {address}"):
            make(tmp_path, engine=RayEngine(address=address))


def test_a_new_cluster_listens_on_loopback_only_and_says_on_which_ports() -> None:
    pytest.importorskip("ray")
    script = "import runpy, sys; print(runpy.run_path(sys.argv[1])['a_new_cluster']())"
    ran = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script, __file__],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    said, heard = json.loads(ran.stdout.splitlines()[-1])
    assert "it listens on 127.0.0.1, ports " in said
    assert len(heard) >= 4
    assert {address for address, _ in heard} == {"127.0.0.1"}
    named = re.search(r"ports (\d+), (\d+), (\d+) and one for each worker", said)
    assert named
    assert set(map(int, named.groups())) <= {port for _, port in heard}


def a_new_cluster() -> str:
    """What the engine says of a new cluster, and the addresses and ports that its processes listen on."""
    import ray

    heard: list[str] = []
    RayEngine(say=heard.append)._join(ray)
    try:
        ray.get(ray.remote(num_cpus=0)(lambda: None).remote())
        return json.dumps([heard[0], listening(str(os.getpid()))])
    finally:
        ray.shutdown()


def listening(root: str) -> list[tuple[str, int]]:
    """Addresses and ports that a process and its descendants listen on."""
    parents = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            parents[status.parent.name] = status.read_text().rpartition(")")[2].split()[1]
    family, grown = {root}, True
    while grown:
        more = {child for child, parent in parents.items() if parent in family} - family
        family, grown = family | more, bool(more)
    sockets = set()
    for process in family:
        for link in Path(f"/proc/{process}/fd").glob("*"):
            with contextlib.suppress(OSError):
                sockets.add(os.readlink(link))
    found = []
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and f"socket:[{fields[9]}]" in sockets:
                address, port = fields[1].split(":")
                last = bytes.fromhex(address)[-4:][::-1]  # of IPv6, the IPv4 address that it stands for
                found.append((".".join(map(str, last)), int(port, 16)))
    return found


def unknown(shard: Shard, settings: DatasetSettings, wanted: dict[str, str]) -> MadeShard:
    raise InputError("no bocks here")


def on_a_cluster(out: Path) -> dict[str, object]:
    """The small dataset on two nodes of one core each, one of whose workers is killed."""
    import ray
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "object_store_memory": 80_000_000}
    cluster = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    cluster.add_node(**node)
    ray.init(address=cluster.address, log_to_driver=False, logging_level="ERROR")
    try:
        nodes = sum(1 for one in ray.nodes() if one["Alive"])
        engines.make_shard = killed_once
        report = make(out, engine=RayEngine())
        engines.make_shard = unknown
        try:
            make(out.with_name("other"), engine=RayEngine())
        except InputError as error:
            said = str(error)
        return {"made": report.made, "nodes": nodes, "error": said}
    finally:
        ray.shutdown()
        cluster.shutdown()


if __name__ == "__main__":
    print(json.dumps(on_a_cluster(Path(sys.argv[1]))))
