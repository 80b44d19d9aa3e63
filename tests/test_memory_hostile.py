"""Memories from anybody: absurd numbers, foreign schemas, large ones, and first runs side by side."""

from __future__ import annotations

import json
import multiprocessing
import shutil
import sqlite3
import struct
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from preshape.app.memory_browser import memory_html
from preshape.cli.main import run
from preshape.cli.memory import MOST_LISTED
from preshape.exceptions import InputError, MemoryFileError
from preshape.hands.load import load_hand
from preshape.hiis import knowledge, training
from preshape.hiis.controller import Controller
from preshape.hiis.estimator import predict
from preshape.hiis.learning import learn, training_set, usable
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.memory import Memory, bulk, records
from preshape.objects.library import load_library_object
from preshape.objects.shape import LENGTH
from preshape.planning.controllers import layout_of
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session
from preshape.tasks import parse_task
from preshape.types import Attributes, Experience, NetworkWeights

LAYOUT = layout_of(load_hand("utah_mit"))
HUGE = 1e308


def lesson(number: int, *, grip: bool = False, **changes: Any) -> Experience:
    """A lesson whose content follows from its number."""
    rng = np.random.default_rng(number)
    turn = rng.normal(size=4)
    joints = rng.normal(size=5 + number % 2)
    about = Attributes(
        extents=rng.uniform(0.02, 0.1, 3),
        vertices=int(rng.integers(8, 99)),
        vertex_normals=6,
        faces=6,
        triangles=12,
        area=0.02,
        volume=2e-4,
        shape=rng.uniform(-1, 1, LENGTH) if grip else None,
    )
    plain = Experience(
        kind=("task", "best", "landmark", "grip", "seed")[number % 5],
        object_name=f"thing {number % 7}",
        hand="utah_mit" if number % 3 else "shadow",
        attributes=about,
        task=rng.normal(size=6),
        plane=1 + number % 12,
        flip=bool(number % 2),
        approach_value=float(rng.uniform(-1, 1)),
        approach_set=number % 7,
        fingers=2 + number % 3,
        wrench=rng.normal(size=6),
        match=float(rng.uniform(0, 6)),
        created="2026-01-02T03:04:05Z",
        grip=np.concatenate([rng.normal(size=3), turn / np.linalg.norm(turn), [7.0], joints])
        if grip
        else None,
        quality=float(rng.uniform(0, 6)) if grip else None,
        outcome=("", "held", "lost")[number % 3],
        scene="" if number % 2 else "table 0",
        length_unit="U" if number % 11 == 0 else "4U",
        model="0123456789abcdef" if number % 4 == 0 else "",
    )
    return replace(plain, **changes)


def bits(content: Any) -> Any:
    """All of a value, down to the sign of zero."""
    if isinstance(content, np.ndarray):
        return content.shape, content.dtype.str, content.flags.writeable, content.tobytes()
    if isinstance(content, Experience | Attributes | NetworkWeights):
        return [bits(getattr(content, f.name)) for f in fields(content)]
    return struct.pack("<d", content) if isinstance(content, float) else (type(content), content)


def change(path: Path, statement: str) -> None:
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA writable_schema = ON")
    connection.executescript(statement)
    connection.close()


# --- absurd numbers -------------------------------------------------------------------------------

ABSURD = {
    "extent_x": HUGE,
    "extent_y": 0.0,
    "area": HUGE,
    "volume": -HUGE,
    "wrench_fx": HUGE,
    "shape": np.full(LENGTH, HUGE).tobytes(),
    "grip": np.array([HUGE, 0, 0, 1, 0, 0, 0, 1, 0.5]).tobytes(),
}


POUR = PlanRequest(source="mug", task="pour", hand="utah_mit")


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    """A memory that knows the mug, and how good its answer is."""
    path = tmp_path_factory.mktemp("taught") / "memory.sqlite"
    with Session(path) as session:
        session.teach(POUR)
        answer = session.run(POUR).answer
    assert answer is not None
    return path, answer.grasp.judged


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("column", ABSURD)
def test_one_absurd_row_is_skipped_and_named_and_the_hand_answers_on(
    tmp_path: Path, taught: tuple[Path, float], column: str
) -> None:
    path, before = tmp_path / "memory.sqlite", taught[1]
    shutil.copy(taught[0], path)
    connection = sqlite3.connect(path)
    (number,) = connection.execute("SELECT max(id) FROM experiences WHERE kind = 'best'").fetchone()
    connection.execute(f"UPDATE experiences SET {column} = ? WHERE id = ?", (ABSURD[column], number))
    connection.commit()
    connection.close()
    with Session(path) as session:
        plan = session.run(POUR)
        (warning,) = plan.warnings
        assert f"experience {number}: " in warning
        assert plan.answer is not None
        assert plan.answer.grasp.judged == pytest.approx(before)
        assert list(session.memory.skipped) == [number]
        # What is exported can be imported, without that row.
        assert session.memory.export(tmp_path / "out.json") == session.memory.count() - 1
    with Memory.open(":memory:") as other:
        assert other.import_(tmp_path / "out.json") > 0
        assert (other.remark, len(other.experiences())) == ("", other.count())


@pytest.mark.parametrize(
    "changes",
    [
        {"attributes": replace(lesson(1).attributes, extents=np.array([HUGE, 1, 1]))},
        {"attributes": replace(lesson(1).attributes, area=0.0)},
        {"wrench": np.full(6, -HUGE)},
    ],
)
def test_an_absurd_lesson_is_neither_stored_nor_imported(tmp_path: Path, changes: dict[str, Any]) -> None:
    path, document = tmp_path / "memory.sqlite", tmp_path / "out.json"
    with Memory.open(path) as memory:
        with pytest.raises(InputError, match="must lie in"):
            memory.add([lesson(1), lesson(2, **changes)])
        memory.add([lesson(1)])
        memory.export(document)
    content = json.loads(document.read_text())
    bad = lesson(2, **changes)
    about = {"extents": bad.attributes.extents.tolist(), "area": bad.attributes.area}
    first = content["experiences"][0]
    absurd = first | {"wrench": bad.wrench.tolist(), "attributes": first["attributes"] | about}
    content["experiences"].append(absurd)
    document.write_text(json.dumps(content))
    with Memory.open(":memory:") as memory:
        with pytest.raises(MemoryFileError, match=r"experience 2: .* must lie in .*; nothing was imported"):
            memory.import_(document)
        assert memory.count() == 0


def test_the_command_line_says_what_an_export_leaves_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "memory.sqlite"
    with Memory.open(path) as memory:
        memory.add([lesson(1), lesson(2)])
    change(path, f"UPDATE experiences SET area = {HUGE} WHERE id = 1")
    assert run(["memory", "export", str(tmp_path / "a.json"), "--memory", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["exported"] == 1
    assert "experience 1: area must lie in" in told["warnings"][0]


def test_weights_of_no_use_are_trained_again_once(monkeypatch: pytest.MonkeyPatch) -> None:
    trained: list[int] = []
    plain = knowledge.learn

    def counted(*args: Any, **more: Any) -> NetworkWeights:
        trained.append(1)
        return plain(*args, **more)

    with Memory.open(":memory:") as memory:
        good = Controller(memory, LAYOUT).weights
        small = {"w1": good.w1[:1], "b1": good.b1[:1], "w2": good.w2[:, :1]}
        monkeypatch.setattr(knowledge, "learn", counted)
        for bad in (replace(good, **small), replace(good, w2=good.w2[:3], b2=good.b2[:3])):
            memory.save_weights("utah_mit", bad, instead_of=memory.weights("utah_mit"))
            for _ in range(2):
                assert usable(Controller(memory, LAYOUT).weights, "paper")
        memory._connection.execute("UPDATE weights SET w1 = ?", (np.full((45, 13), HUGE).tobytes(),))
        for _ in range(2):
            assert np.abs(Controller(memory, LAYOUT).weights.w1).max() < 1e3
        assert len(trained) == 3
        with pytest.raises(InputError, match="weights must lie in"):
            memory.save_weights("utah_mit", replace(good, b1=np.full(45, HUGE)))


# --- malformed cells ------------------------------------------------------------------------------

TEXTS = ("hand", "kind", "object_name", "created", "outcome", "scene", "length_unit")
LONG = "n" * 5_000_000
MALFORMED = [
    *((name, "text") for name in records.EXPERIENCE_COLUMNS if name not in TEXTS),
    *((name, b"\x9b\0") for name in records.EXPERIENCE_COLUMNS if name != "hand"),
    *((name, HUGE) for name in records.EXPERIENCE_COLUMNS if name not in TEXTS and name[:5] != "task_"),
    *((name, LONG) for name in records.EXPERIENCE_COLUMNS if name != "hand"),
    ("grip", LONG.encode()),
    ("shape", LONG.encode()),
    ("match", LONG.encode()),
    ("object_name", "\0" + LONG),
    ("object_name", ""),
    ("created", "yesterday"),
    ("kind", "other"),
    ("plane", 13),
    ("vertices", -1),
]


def test_a_malformed_cell_of_any_column_costs_one_lesson_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "memory.sqlite"
    content = [lesson(k, grip=True, hand="shadow") for k in range(len(MALFORMED) + 3)]
    with Memory.open(path) as memory:
        memory.add(content)
    connection = sqlite3.connect(path)
    for number, (column, cell) in enumerate(MALFORMED, start=2):
        connection.execute(f"UPDATE experiences SET {column} = ? WHERE id = ?", (cell, number))
    last = len(MALFORMED) + 2  # text that is not UTF-8
    connection.execute("UPDATE experiences SET object_name = CAST(x'6d9b' AS TEXT) WHERE id = ?", (last,))
    connection.commit()
    connection.close()
    with Memory.open(path) as memory:
        good = [bits(content[0]), bits(content[-1])]
        assert [bits(e) for e in memory.experiences("shadow")] == good
        assert sorted(memory.skipped) == list(range(2, last + 1))
        for number, (column, _) in enumerate(MALFORMED, start=2):
            words = {"extent": "extents", "task": "task Q", "wrench": "net wrench"}
            assert words.get(column.partition("_")[0], column) in memory.skipped[number]
        assert all(reason.isprintable() and len(reason) <= 200 for reason in memory.skipped.values())
        assert memory.export(tmp_path / "out.json") == 2
        assert memory.import_(tmp_path / "out.json") == 0
        numbers = memory.statistics()
        assert (numbers.experiences, numbers.hands) == (2, (("shadow", 2),))
    assert run(["memory", "show", "--memory", str(path)]) == 0
    shown = capsys.readouterr().out
    assert len(shown) < 2000
    assert f"and {len(MALFORMED)} more" in shown
    assert run(["memory", "show", "--memory", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["experiences"] == sum(o["experiences"] for o in told["objects"]) == 2
    assert "is skipped" in told["warnings"][0]


def test_a_cell_that_sqlite_may_not_read_costs_one_lesson_only() -> None:
    with Memory.open(":memory:") as memory:
        memory.add([lesson(k, hand="shadow") for k in range(4)])
        memory._connection.execute("UPDATE experiences SET object_name = ? WHERE id = 2", ("n" * 20_000,))
        memory._connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 10_000)
        assert [bits(e) for e in memory.experiences("shadow")] == [
            bits(lesson(k, hand="shadow")) for k in (0, 2, 3)
        ]
        assert "larger than" in memory.skipped[2]


def test_a_hand_without_one_sound_lesson_learns_the_cube_again(tmp_path: Path) -> None:
    with Memory.open(tmp_path / "memory.sqlite") as memory:
        known = Controller(memory, LAYOUT).experiences
        memory._connection.execute("UPDATE experiences SET approach_set = 99")
        again = Controller(memory, LAYOUT).experiences
        assert [e.task.tobytes() for e in again] == [e.task.tobytes() for e in known]
        assert len(memory.skipped) == len(known)
        assert len(memory.experiences()) == len(known)


def test_a_long_list_is_cut_and_the_newest_stay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, count = tmp_path / "memory.sqlite", MOST_LISTED + 5
    with Memory.open(path) as memory:
        memory.add(
            [
                lesson(k, object_name=f"thing {k:03}", created=f"20{k // 12:02}-{1 + k % 12:02}-01T00:00:00Z")
                for k in range(count)
            ]
        )
    assert run(["memory", "show", "--memory", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    named = [line[:9] for line in lines if line.startswith("thing ")]
    assert named == [f"thing {k:03}" for k in range(5, count)]
    assert "and 5 more, which were met earlier; --json lists all" in lines
    page = memory_html(str(path))
    assert page.count("<tr><td>") == MOST_LISTED
    assert "and 5 more" in page
    assert run(["memory", "show", "--memory", str(path), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["objects"]) == count


def test_a_name_forges_no_row(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "memory.sqlite"
    with Memory.open(path) as memory:
        memory.add([lesson(1, object_name="pen\nmug\t99")])
    assert run(["memory", "show", "--memory", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith(r"pen\nmug\t99 ")
    assert not any(line.startswith("mug") for line in lines)


# --- foreign schemas ------------------------------------------------------------------------------


@pytest.mark.parametrize("read_only", [False, True])
@pytest.mark.parametrize(
    ("statement", "words"),
    [
        (
            "CREATE TRIGGER spy AFTER INSERT ON experiences BEGIN DELETE FROM weights; END",
            "a trigger 'spy' on 'experiences' that preshape did not make",
        ),
        ("CREATE VIEW all_of_it AS SELECT * FROM weights", "view 'all_of_it'"),
        (
            "DROP TABLE weights; CREATE VIEW weights AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i+1"
            " FROM n) SELECT i AS hand FROM n",
            "view 'weights'",
        ),
        ("CREATE VIRTUAL TABLE words USING fts5(content)", "table 'words'"),
        ("CREATE TABLE more (a)", "table 'more'"),
        ("CREATE INDEX slow ON experiences (abs(match))", "index 'slow' on 'experiences'"),
        ("DROP INDEX experiences_by_hand", "lacks the index 'experiences_by_hand'"),
        (
            "DROP INDEX experiences_by_hand;"
            "CREATE INDEX experiences_by_hand ON experiences (hand) WHERE kind = 'task'",
            "another index 'experiences_by_hand' on 'experiences' than preshape makes",
        ),
        ("ALTER TABLE weights ADD COLUMN twice AS (epochs * 2)", "another table 'weights'"),
        ("ALTER TABLE experiences ADD COLUMN note TEXT", "another table 'experiences'"),
        (
            "UPDATE sqlite_master SET sql = replace(sql, 'plane INTEGER', 'plane TEXT')"
            " WHERE name = 'experiences'",
            "another table 'experiences'",
        ),
        (
            "UPDATE sqlite_master SET sql = replace(sql, 'match NOT NULL', 'match CHECK (match > 2)')"
            " WHERE name = 'experiences'",
            "another table 'experiences'",
        ),
    ],
)
def test_a_memory_that_brings_its_own_code_is_refused_and_untouched(
    tmp_path: Path, statement: str, words: str, read_only: bool
) -> None:
    path = tmp_path / "memory.sqlite"
    with Memory.open(path) as memory:
        memory.add([lesson(1)])
    change(path, statement)
    before = path.read_bytes()
    with pytest.raises(MemoryFileError, match=words) as caught:
        Memory.open(path, read_only=read_only)
    assert "--memory OTHER" in str(caught.value)
    assert path.read_bytes() == before


@pytest.mark.parametrize("statement", ["ANALYZE", "VACUUM", "REINDEX"])
def test_what_keeps_a_database_tidy_is_no_foreign_code(tmp_path: Path, statement: str) -> None:
    path = tmp_path / "memory.sqlite"
    with Memory.open(path) as memory:
        memory.add([lesson(1)])
    change(path, statement)
    with Memory.open(path) as memory:
        assert bits(memory.experiences()[0]) == bits(lesson(1))


def test_connections_do_not_trust_the_file(tmp_path: Path) -> None:
    path = tmp_path / "memory.sqlite"
    for read_only in (False, True):
        with Memory.open(path, read_only=read_only) as memory:
            assert memory._connection.execute("PRAGMA trusted_schema").fetchone() == (0,)
            assert memory._connection.execute("PRAGMA cell_size_check").fetchone() == (1,)


# --- large ones -----------------------------------------------------------------------------------


@pytest.mark.parametrize("wrong", [None, "area = 3", "area = 2", "scene = ''"])
def test_rows_read_together_are_rows_read_alone(monkeypatch: pytest.MonkeyPatch, wrong: str | None) -> None:
    monkeypatch.setattr(bulk, "BLOCK", 16)
    content = [lesson(k, grip=k % 4 == 0) for k in range(60)]
    with Memory.open(":memory:") as memory:
        memory.add(content)
        if wrong is not None:  # whole numbers in a column of floats: read, but not in bulk
            memory._connection.execute(f"UPDATE experiences SET {wrong} WHERE id = 20")
        together = memory.experiences()
        monkeypatch.setattr(bulk, "_together", lambda cell: None)
        assert [bits(e) for e in memory.experiences()] == [bits(e) for e in together]
    if wrong is None:
        assert [bits(e) for e in together] == [bits(e) for e in content]
        assert [e.hand for e in together] == [e.hand for e in content]


def test_the_lessons_of_one_hand_come_in_their_order() -> None:
    with Memory.open(":memory:") as memory:
        content = [lesson(k) for k in range(40)]
        memory.add(content)
        (plan,) = memory._connection.execute(
            "EXPLAIN QUERY PLAN SELECT * FROM experiences WHERE id IN"
            " (SELECT id FROM experiences WHERE hand = 'shadow') ORDER BY id"
        ).fetchmany(1)
        assert "rowid" in plan[3]  # by the index of hands: no other hand's rows, and nothing to sort
        own = [bits(e) for e in content if e.hand == "shadow"]
        assert [bits(e) for e in memory.experiences("shadow")] == own


def many_samples(count: int, *, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Samples around 30 centres; samples of one centre have one code."""
    rng = np.random.default_rng(seed)
    centres, codes = rng.normal(size=(30, 13)), rng.integers(0, 2, (30, 9)).astype(float)
    which = rng.integers(0, 30, count)
    return centres[which] + rng.normal(0, 0.05, (count, 13)), codes[which]


def test_many_samples_cost_no_more_than_a_bounded_number(monkeypatch: pytest.MonkeyPatch) -> None:
    work: list[int] = []
    plain = training.loss_and_gradient

    def counted(theta: Any, x: Any, y: Any, **more: Any) -> Any:
        work.append(len(x))
        return plain(theta, x, y, **more)

    monkeypatch.setattr(training, "loss_and_gradient", counted)
    x, y = many_samples(6000)
    weights = training.train(x, y)
    assert max(work) <= training.MOST_SAMPLES
    assert weights.trained_on == 6000
    assert weights.mean_square_error == pytest.approx(training.mean_square_error(weights, x, y))
    assert (np.abs(predict(weights, x) - y).max(axis=1) < 0.5).mean() > 0.999
    # Learning one more: the newest is known, and the others are not forgotten.
    rng = np.random.default_rng(6)
    newest = rng.normal(size=(1, 13)), 1.0 - y[:1]
    x, y = np.concatenate([x, newest[0]]), np.concatenate([y, newest[1]])
    work.clear()
    again = training.train(x, y, start=weights)
    right = np.abs(predict(again, x) - y).max(axis=1) < 0.5
    assert right[-1]
    assert right.mean() > 0.999
    assert max(work) <= training.MOST_SAMPLES
    assert training.train(x, y, start=weights).w1.tobytes() == again.w1.tobytes()


def test_contradictions_in_a_large_memory_end_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "MOST_SAMPLES", 60)
    evaluations: list[int] = []
    plain = training.loss_and_gradient

    def counted(*args: Any, **more: Any) -> Any:
        evaluations.append(1)
        return plain(*args, **more)

    monkeypatch.setattr(training, "loss_and_gradient", counted)
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(300, 13)), rng.integers(0, 2, (300, 9)).astype(float)
    weights = training.train(np.concatenate([x, x]), np.concatenate([y, 1 - y]))
    assert np.isfinite(weights.w1).all()
    assert len(evaluations) < 2 * 3 * 250 * 3


def test_an_absurdly_large_object_does_not_spoil_the_training_on_the_others() -> None:
    content = [lesson(k, kind="task", outcome="", scene="") for k in range(40)]
    giant = replace(content[0], attributes=replace(content[0].attributes, extents=np.full(3, 999.0)))
    x, _ = training_set([*content, giant], LAYOUT.u)
    assert np.abs(x).max() == 10.0
    weights = learn([*content, giant], LAYOUT.u, None)
    assert weights.mean_square_error < 2e-3


# --- side by side ---------------------------------------------------------------------------------


def _first_run(path: str, gate: Any) -> None:
    gate.wait()
    with Memory.open(path) as memory:
        Controller(memory, LAYOUT)


@pytest.mark.parametrize("processes", [2, 6])
def test_first_runs_side_by_side_store_the_cube_once(tmp_path: Path, processes: int) -> None:
    context = multiprocessing.get_context("fork")
    gate, path = context.Barrier(processes), tmp_path / "memory.sqlite"
    children = [context.Process(target=_first_run, args=(str(path), gate)) for _ in range(processes)]
    for child in children:
        child.start()
    for child in children:
        child.join()
    assert [child.exitcode for child in children] == [0] * processes
    with Memory.open(path) as memory:
        tasks = [e.task.tobytes() for e in memory.experiences(kinds=["seed"])]
        assert len(tasks) == len(set(tasks)) == 48
        assert memory.weights("utah_mit").trained_on == 48  # type: ignore[union-attr]


def test_the_slower_of_two_first_runs_takes_over_what_the_faster_stored(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = tmp_path / "memory.sqlite"
    plain, ran = knowledge.seed_experiences, []

    def overtaken(*args: Any, **more: Any) -> list[Experience]:
        if not ran:
            ran.append(1)
            with Memory.open(path) as other:
                faster = Controller(other, LAYOUT)
                faster.teach(RayAnalyser(load_library_object("mug"), LAYOUT), parse_task("pour"))
        return plain(*args, **more)

    monkeypatch.setattr(knowledge, "seed_experiences", overtaken)
    with Memory.open(path) as memory:
        slower = Controller(memory, LAYOUT)
        assert [bits(e) for e in slower.experiences] == [bits(e) for e in memory.experiences()]
        assert sum(e.kind == "seed" for e in slower.experiences) == 48
        assert {e.object_name for e in slower.experiences} > {"mug"}
        assert bits(slower.weights) == bits(memory.weights("utah_mit"))
