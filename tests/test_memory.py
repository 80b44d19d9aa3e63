from __future__ import annotations

import json
import os
import shutil
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from preshape.cli.main import run
from preshape.exceptions import EnvironmentFailure, InputError, MemoryFileError
from preshape.memory import (
    APPLICATION_ID,
    FORMAT_VERSION,
    KINDS,
    MIGRATIONS,
    SCHEMA_VERSION,
    Memory,
    default_path,
    failures,
    schema,
    store,
)
from preshape.types import Attributes, Experience, NetworkWeights

FIELDS = (
    *("kind", "object_name", "hand", "task", "plane", "flip", "approach_value", "approach_set"),
    *("fingers", "wrench", "match"),
)
SHAPE = ("extents", "vertices", "vertex_normals", "faces", "triangles", "area", "volume")


def experience(**changes: Any) -> Experience:
    shape: dict[str, Any] = {
        "extents": [0.05, 0.06, 0.07],
        "vertices": 8,
        "vertex_normals": 6,
        "faces": 6,
        "triangles": 12,
        "area": 0.0214,
        "volume": 2.1e-4,
    }
    shape |= {name: changes.pop(name) for name in list(changes) if name in shape}
    fields: dict[str, Any] = {
        "kind": "task",
        "object_name": "cube",
        "hand": "utah_mit",
        "attributes": Attributes(**shape),
        "task": [1, 1, 0.1, 0.05, 0.8, 0.05],
        "plane": 5,
        "flip": True,
        "approach_value": 0.01,
        "approach_set": 3,
        "fingers": 3,
        "wrench": [1.35, 1.0, -0.3, -0.06, 0.8, -0.0],
        "match": 4.9,
    }
    return Experience(**(fields | changes))


def weights(trained_on: int = 48, seed: int = 3) -> NetworkWeights:
    rng = np.random.default_rng(seed)
    return NetworkWeights(
        w1=rng.normal(size=(45, 13)),
        b1=rng.normal(size=45),
        w2=rng.normal(size=(9, 45)),
        b2=rng.normal(size=9),
        mean_square_error=5e-4,
        trained_on=trained_on,
        epochs=900,
    )


def bits(content: Any) -> Any:
    """Everything down to the sign of zero."""
    if isinstance(content, np.ndarray):
        return (content.shape, content.dtype.str, content.tobytes())
    if isinstance(content, float):
        return struct.pack("<d", content)
    if isinstance(content, Experience):
        return [bits(getattr(content, name)) for name in FIELDS] + [
            bits(getattr(content.attributes, name)) for name in SHAPE
        ]
    if isinstance(content, NetworkWeights):
        names = ("w1", "b1", "w2", "b2", "mean_square_error", "trained_on", "epochs")
        return [bits(getattr(content, name)) for name in names]
    return (type(content), content)


def without_repeats(experiences: tuple[Experience, ...]) -> list[Experience]:
    """The first of those that agree in everything, the time included; -0.0 equals 0.0 there."""
    met: dict[Any, Experience] = {}
    for one in experiences:
        arrays = (*one.task.tolist(), *one.wrench.tolist(), *one.attributes.extents.tolist())
        plain = [getattr(one, name) for name in (*FIELDS, "created") if name not in ("task", "wrench")]
        met.setdefault((arrays, *plain, *(getattr(one.attributes, name) for name in SHAPE[1:])), one)
    return list(met.values())


def with_time(experiences: tuple[Experience, ...]) -> list[Any]:
    return [(bits(one), one.created) for one in experiences]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "new folder" / "memory?#%41.sqlite"


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# --- round trip -----------------------------------------------------------------------------------

finite = st.floats(allow_nan=False, allow_infinity=False)
real = st.floats(-1e9, 1e9)
names = st.text(min_size=1, max_size=20).filter(lambda t: t.isprintable() or "\0" in t)
counts = st.integers(0, 2**63 - 1)
six = st.lists(finite, min_size=6, max_size=6)
experiences_of_any_kind = st.builds(
    experience,
    kind=st.sampled_from(KINDS),
    object_name=names,
    hand=names,
    extents=st.lists(st.floats(1e-12, 1e3), min_size=3, max_size=3),
    vertices=counts,
    vertex_normals=counts,
    faces=counts,
    triangles=counts,
    area=st.floats(1e-24, 1e6),
    volume=real,
    task=six,
    plane=st.integers(1, 12),
    flip=st.booleans(),
    approach_value=st.floats(-1, 1),
    approach_set=st.integers(0, 6),
    fingers=st.integers(2, 4),
    wrench=st.lists(real, min_size=6, max_size=6),
    match=st.floats(0, 6),
)


@settings(max_examples=60, deadline=None)
@given(content=st.lists(experiences_of_any_kind, max_size=4), seed=st.integers(0, 99), trained=counts)
def test_what_is_stored_and_exported_comes_back_with_every_bit(
    tmp_path_factory: pytest.TempPathFactory, content: list[Experience], seed: int, trained: int
) -> None:
    document = tmp_path_factory.getbasetemp() / "property.json"
    with Memory.open(":memory:") as memory, Memory.open(":memory:") as other:
        numbers = memory.add(content)
        assert numbers == tuple(range(1, len(content) + 1))
        assert memory.save_weights("h", weights(trained, seed))
        read = memory.experiences()
        assert [bits(one) for one in read] == [bits(one) for one in content]
        memory.export(document)
        other.import_(document)
        assert [bits(one) for one in other.experiences()] == [bits(one) for one in without_repeats(read)]
        assert bits(other.weights("h")) == bits(weights(trained, seed))


def test_a_file_is_made_with_its_folders_and_keeps_what_it_got(path: Path) -> None:
    with Memory.open(path) as memory:
        first = memory.add([experience(kind=kind) for kind in KINDS])
        second = memory.add([experience(hand="allegro")], weights())
        assert (first, second) == ((1, 2, 3, 4, 5), (6,))
    assert [p.name for p in path.parent.iterdir()] == [path.name]  # the log is written back
    with Memory.open(path) as memory:
        assert [one.kind for one in memory.experiences()] == [*KINDS, "task"]
        assert [one.hand for one in memory.experiences("allegro")] == ["allegro"]
        assert [one.kind for one in memory.experiences(kinds={"seed", "best"})] == ["seed", "best"]
        assert memory.experiences("utah_mit", kinds=()) == ()
        assert (memory.count(), memory.count("allegro"), memory.count("none")) == (6, 1, 0)
        assert bits(memory.weights("allegro")) == bits(weights())
        assert memory.weights("utah_mit") is None
        assert memory.experiences()[0].task.flags.writeable is False
        with pytest.raises(InputError, match="known: seed, task, best, landmark"):
            memory.experiences(kinds=["tasks"])


def test_people_can_query_it_with_sqlite(path: Path) -> None:
    with Memory.open(path) as memory:
        memory.add([experience(match=2.5), experience(match=5)])
    connection = sqlite3.connect(path)
    assert connection.execute("SELECT id, task_ry FROM experiences WHERE match > 3").fetchall() == [(2, 0.8)]
    assert connection.execute("PRAGMA application_id").fetchone() == (APPLICATION_ID,)
    assert connection.execute("PRAGMA user_version").fetchone() == (SCHEMA_VERSION,)
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    connection.close()


def test_commits_are_synchronous(path: Path) -> None:
    with Memory.open(path) as memory:
        assert memory._connection.execute("PRAGMA synchronous").fetchone() == (2,)


def test_time_is_stamped_only_where_it_is_missing() -> None:
    with Memory.open(":memory:") as memory:
        memory.add([experience(), experience(created="2001-02-03T04:05:06Z")])
        stamped, kept = memory.experiences()
        assert stamped.created.endswith("+00:00")
        assert kept.created == "2001-02-03T04:05:06Z"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"kind": "guess"}, "kind must be one of"),
        ({"plane": 13}, "plane must be a whole number 1..12, got 13"),
        ({"plane": 0}, "plane"),
        ({"plane": 5.0}, "plane"),
        ({"approach_set": 7}, "approach_set"),
        ({"fingers": 5}, "fingers"),
        ({"fingers": True}, "fingers"),
        ({"approach_value": 1.5}, "approach_value"),
        ({"match": float("nan")}, "match"),
        ({"match": 6.1}, "match"),
        ({"volume": float("inf")}, "volume"),
        ({"vertices": 2**63}, "vertices"),
        ({"vertices": -1}, "vertices"),
        ({"object_name": ""}, "object_name"),
        ({"hand": "\ud800"}, "Unicode"),
        ({"created": "yesterday"}, "created"),
        ({"created": "2001-02-03T04:05:06+01:00"}, "created"),
        ({"created": "2001-02-03T04:05:06"}, "created"),
    ],
)
def test_what_could_not_be_read_back_is_not_stored(changes: dict[str, Any], words: str) -> None:
    with Memory.open(":memory:") as memory:
        with pytest.raises(InputError, match=words):
            memory.add([experience(), experience(**changes)])
        assert memory.count() == 0


def test_numpy_scalars_are_numbers() -> None:
    with Memory.open(":memory:") as memory:
        memory.add(
            [experience(plane=np.int64(7), flip=np.True_, match=np.float64(3.1), vertices=np.int32(9))]
        )
        (one,) = memory.experiences()
        assert (one.plane, one.flip, one.match, one.attributes.vertices) == (7, True, 3.1, 9)
        assert (type(one.plane), type(one.flip), type(one.match)) == (int, bool, float)


# --- weights --------------------------------------------------------------------------------------


def test_weights_trained_on_fewer_samples_never_replace_those_trained_on_more(path: Path) -> None:
    with Memory.open(path) as memory, Memory.open(path) as other:
        assert memory.save_weights("h", weights(48, 1))
        assert other.save_weights("h", weights(50, 2))
        assert not memory.save_weights("h", weights(49, 3))
        assert bits(memory.weights("h")) == bits(weights(50, 2))
        assert memory.save_weights("h", weights(50, 4))  # as many: the later ones
        assert memory.save_weights("g", weights(1, 5))
        memory.add([experience(hand="h")], weights(2, 6))
        assert bits(other.weights("h")) == bits(weights(50, 4))


def test_weights_come_with_experiences_of_one_hand() -> None:
    with Memory.open(":memory:") as memory:
        for content in ([], [experience(hand="a"), experience(hand="b")]):
            with pytest.raises(InputError, match="one hand"):
                memory.add(content, weights())
        assert memory.count() == 0


def test_weights_whose_layers_do_not_fit_are_refused() -> None:
    bad = NetworkWeights(
        w1=np.ones((4, 3)), b1=np.ones(4), w2=np.ones((2, 5)), b2=np.ones(2),
        mean_square_error=0.1, trained_on=1, epochs=1,
    )  # fmt: skip
    with Memory.open(":memory:") as memory, pytest.raises(InputError, match=r"\(o, h\)"):
        memory.save_weights("h", bad)


@pytest.mark.parametrize(
    "damage",
    [
        "w1 = substr(w1, 1, 800)",
        "b1 = 'text'",
        "b2 = zeroblob(73)",
        "hidden = 44",
        "outputs = 0",
        "inputs = 'many'",
        "b1 = x'" + "000000000000f87f" * 45 + "'",  # NaN
        "trained_on = -1",
        "mean_square_error = 9e999",
    ],
)
def test_damaged_weights_count_as_none_and_are_replaced(path: Path, damage: str) -> None:
    with Memory.open(path) as memory:
        memory.add([experience()], weights())
    connection = sqlite3.connect(path)
    connection.execute(f"UPDATE weights SET {damage}")
    connection.commit()
    connection.close()
    with Memory.open(path) as memory:
        assert memory.weights("utah_mit") is None
        assert memory.export(path.with_name("out.json")) == 1
        assert json.loads(path.with_name("out.json").read_text())["weights"] == []
        assert memory.save_weights("utah_mit", weights())
        assert memory.weights("utah_mit") is not None


@pytest.mark.parametrize(
    "damage", ["plane = 'x'", "flip = 2", "match = 'high'", "created = ''", "kind = x'00'"]
)
def test_damaged_experiences_are_skipped_and_named(path: Path, damage: str) -> None:
    with Memory.open(path) as memory:
        memory.add([experience(), experience()])
    connection = sqlite3.connect(path)
    connection.execute(f"UPDATE experiences SET {damage} WHERE id = 2")
    connection.commit()
    connection.close()
    with Memory.open(path) as memory:
        assert len(memory.experiences()) == 1
        assert list(memory.skipped) == [2]
        assert "experience 2: " in memory.remark


# --- summaries and reset --------------------------------------------------------------------------


def test_objects_and_statistics() -> None:
    with Memory.open(":memory:") as memory:
        memory.add(
            [
                experience(created="2001-01-01T00:00:00Z", match=3.5),
                experience(created="2003-01-01T00:00:00Z", match=2.5, hand="a,b", kind="best"),
                experience(created="2002-01-01T00:00:00Z", match=1.5, task=[0, 1, 0, 0, 0, -0.0]),
                experience(created="2002-01-01T00:00:00Z", match=6.0, object_name="bottle"),
            ],
        )
        memory.save_weights("a,b", weights(7))
        bottle, cube = memory.objects()
        assert (bottle.name, bottle.experiences, bottle.tasks, bottle.best_match) == ("bottle", 1, 1, 6.0)
        assert (cube.name, cube.experiences, cube.tasks, cube.best_match) == ("cube", 3, 2, 3.5)
        assert (cube.best, cube.best_quality, cube.seed) == ("TFVADI 3.50", None, False)
        assert (cube.hands, cube.last_seen) == (("a,b", "utah_mit"), "2003-01-01T00:00:00Z")
        assert [(one.name, one.experiences) for one in memory.objects("a,b")] == [("cube", 1)]
        facts = memory.statistics()
        assert (facts.path, facts.version, facts.experiences, facts.objects) == (
            ":memory:",
            SCHEMA_VERSION,
            4,
            2,
        )
        assert facts.kinds == (("seed", 0), ("task", 3), ("best", 1), ("landmark", 0), ("grip", 0))
        assert facts.hands == (("a,b", 1), ("utah_mit", 3))
        assert facts.trained == (("a,b", 7),)
        assert (facts.oldest, facts.newest) == ("2001-01-01T00:00:00Z", "2003-01-01T00:00:00Z")
        memory.reset()
        assert memory.objects() == ()
        assert memory.statistics().oldest == ""


def test_reset_forgets_one_hand_or_all_and_never_reuses_a_number(path: Path) -> None:
    with Memory.open(path) as memory:
        memory.add([experience(), experience(hand="allegro")], None)
        memory.save_weights("allegro", weights())
        memory.save_weights("utah_mit", weights())
        assert memory.reset("allegro") == 1
        assert memory.weights("allegro") is None
        assert memory.weights("utah_mit") is not None
        assert [one.hand for one in memory.experiences()] == ["utah_mit"]
        assert memory.reset() == 1
        assert memory.weights("utah_mit") is None
    with Memory.open(path) as memory:
        assert memory.count() == 0
        assert memory.add([experience()]) == (3,)


# --- versions and foreign files -------------------------------------------------------------------

VERSION_1 = """
CREATE TABLE experiences (id INTEGER PRIMARY KEY AUTOINCREMENT,
    hand TEXT NOT NULL, kind TEXT NOT NULL, object_name TEXT NOT NULL,
    extent_x NOT NULL, extent_y NOT NULL, extent_z NOT NULL,
    vertices INTEGER NOT NULL, vertex_normals INTEGER NOT NULL,
    faces INTEGER NOT NULL, triangles INTEGER NOT NULL,
    task_tx NOT NULL, task_ty NOT NULL, task_tz NOT NULL,
    task_rx NOT NULL, task_ry NOT NULL, task_rz NOT NULL,
    plane INTEGER NOT NULL, flip INTEGER NOT NULL, approach_value NOT NULL, approach_set INTEGER NOT NULL,
    fingers INTEGER NOT NULL, wrench_fx NOT NULL, wrench_fy NOT NULL, wrench_fz NOT NULL, wrench_mx NOT NULL,
    wrench_my NOT NULL, wrench_mz NOT NULL, match NOT NULL, created TEXT NOT NULL);
CREATE INDEX experiences_by_hand ON experiences (hand, kind);
CREATE TABLE weights (hand TEXT PRIMARY KEY, inputs INTEGER NOT NULL, hidden INTEGER NOT NULL,
    outputs INTEGER NOT NULL, w1 BLOB NOT NULL, b1 BLOB NOT NULL, w2 BLOB NOT NULL, b2 BLOB NOT NULL,
    mean_square_error NOT NULL, trained_on INTEGER NOT NULL, epochs INTEGER NOT NULL);
INSERT INTO experiences VALUES (41, 'utah_mit', 'task', 'cube', 0.1, 0.2, 0.3, 8, 6, 6, 12,
    1.0, 1.0, 0.1, 0.05, 0.8, 0.05, 5, 1, 0.01, 3, 3, 1.35, 1.0, -0.3, -0.06, 0.8, -0.0, 4.9,
    '2020-01-01T00:00:00+00:00');
INSERT INTO weights VALUES ('utah_mit', 2, 1, 1, x'000000000000f03f0000000000000040', x'0000000000000840',
    x'0000000000001040', x'0000000000001440', 0.5, 7, 8);
PRAGMA application_id = 1886545267;
PRAGMA user_version = 1;
"""


def script(path: Path, sql: str) -> None:
    connection = sqlite3.connect(path)
    connection.executescript(sql)
    connection.close()


def columns(path: Path) -> list[Any]:
    connection = sqlite3.connect(path)
    found = [connection.execute(f"PRAGMA table_info({t})").fetchall() for t in ("experiences", "weights")]
    connection.close()
    return found


def check_migrated(memory: Memory) -> None:
    (one,) = memory.experiences()
    assert bits(one) == bits(
        experience(
            extents=[0.1, 0.2, 0.3], area=2 * (0.1 * 0.2 + 0.2 * 0.3 + 0.3 * 0.1), volume=0.1 * 0.2 * 0.3
        )
    )
    assert one.created == "2020-01-01T00:00:00+00:00"
    assert one.outdated
    assert memory.weights("utah_mit") is None  # they are trained again, on wrenches in the new unit


@pytest.mark.parametrize("journal", ["wal", "delete"])
def test_a_version_1_file_is_migrated_and_a_copy_kept(tmp_path: Path, journal: str) -> None:
    path, fresh = tmp_path / "memory.sqlite", tmp_path / "fresh.sqlite"
    script(path, f"PRAGMA journal_mode = {journal}; {VERSION_1}")
    before = columns(path)
    with Memory.open(path) as memory:
        check_migrated(memory)
        assert memory.add([experience()]) == (42,)
        assert memory.statistics().version == SCHEMA_VERSION
    Memory.open(fresh).close()
    assert columns(path) == columns(fresh)
    fresh.unlink()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["memory.sqlite", "memory.sqlite.v1-backup"]
    backup = tmp_path / "memory.sqlite.v1-backup"
    assert columns(backup) == before
    shutil.copy(backup, path)  # gone back to: migrated once more, the first copy untouched
    kept = backup.read_bytes()
    with Memory.open(path) as memory:
        check_migrated(memory)
    assert backup.read_bytes() == kept
    assert (tmp_path / "memory.sqlite.v1-backup-2").exists()


def test_reading_only_migrates_in_a_copy(tmp_path: Path) -> None:
    path = tmp_path / "memory.sqlite"
    script(path, VERSION_1)
    before = snapshot(tmp_path)
    with Memory.open(path, read_only=True) as memory:
        check_migrated(memory)
        with pytest.raises(EnvironmentFailure, match="reading only"):
            memory.reset()
    assert snapshot(tmp_path) == before


def test_a_failed_migration_leaves_version_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "memory.sqlite"
    script(path, VERSION_1)
    before = columns(path)

    def half(connection: sqlite3.Connection) -> None:
        connection.execute("ALTER TABLE experiences ADD COLUMN area NOT NULL DEFAULT 0")
        raise sqlite3.OperationalError("power cut")

    monkeypatch.setitem(MIGRATIONS, 1, half)
    with pytest.raises(MemoryFileError, match="power cut"):
        Memory.open(path)
    assert columns(path) == before
    monkeypatch.undo()
    with Memory.open(path) as memory:
        check_migrated(memory)


def test_there_is_a_migration_from_every_version() -> None:
    assert sorted(MIGRATIONS) == list(range(1, SCHEMA_VERSION))


@pytest.mark.parametrize("read_only", [False, True])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            "PRAGMA application_id = 1886545267; CREATE TABLE t (a);"
            f"PRAGMA user_version = {SCHEMA_VERSION + 1}",
            "upgrade preshape",
        ),
        (
            "PRAGMA application_id = 77; PRAGMA user_version = 2; CREATE TABLE experiences (a)",
            "another program",
        ),
        ("PRAGMA application_id = 77; PRAGMA user_version = 9", "another program"),
        ("CREATE TABLE t (a)", "another program"),
        ("PRAGMA journal_mode = wal; CREATE TABLE t (a)", "another program"),
        ("PRAGMA user_version = 2", "another program"),
        (b"a text file\n" * 1000, "not a SQLite file"),
        *((b"x" * size, "not a SQLite file") for size in (1, 99, 511, 512, 513, 1023, 4095, 4096, 4097)),
        (b"SQLite format 3\0" + bytes(4080), "not a SQLite file|damaged"),
    ],
)
def test_what_is_not_a_memory_is_refused_and_untouched(
    tmp_path: Path, content: str | bytes, words: str, read_only: bool
) -> None:
    path = tmp_path / "file"
    if isinstance(content, str):
        script(path, content)
    else:
        path.write_bytes(content)
    before = snapshot(tmp_path)
    with pytest.raises(MemoryFileError, match=words) as caught:
        Memory.open(path, read_only=read_only)
    assert str(path) in str(caught.value)
    assert "--memory OTHER" in str(caught.value)
    assert caught.value.exit_code == 2
    assert snapshot(tmp_path) == before


def test_another_programs_open_database_with_a_log_is_untouched(tmp_path: Path) -> None:
    path = tmp_path / "file"
    connection = sqlite3.connect(path)
    connection.executescript("PRAGMA journal_mode = wal; CREATE TABLE t (a); INSERT INTO t VALUES (1)")
    before = snapshot(tmp_path)
    assert before["file-wal"]
    with pytest.raises(MemoryFileError, match="another program"):
        Memory.open(path)
    after = snapshot(tmp_path)
    assert {name: after[name] for name in ("file", "file-wal")} == {
        name: before[name] for name in ("file", "file-wal")
    }
    connection.close()


@pytest.mark.parametrize("content", ["", "PRAGMA journal_mode = wal", "VACUUM"])
def test_an_empty_file_or_database_becomes_a_memory(tmp_path: Path, content: str) -> None:
    path = tmp_path / "file"
    path.touch()
    script(path, content)
    with Memory.open(path) as memory:
        memory.add([experience()])
    with Memory.open(path) as memory:
        assert memory.count() == 1


def test_a_torn_file_is_called_damaged(path: Path) -> None:
    with Memory.open(path) as memory:
        memory.add([experience(object_name="x" * 200)] * 200)
    content = bytearray(path.read_bytes())
    content[4096:] = b"\xa5" * (len(content) - 4096)
    path.write_bytes(content)
    with pytest.raises(MemoryFileError, match="damaged"), Memory.open(path) as memory:
        memory.experiences()
    path.write_bytes(content[:5000])
    with pytest.raises(MemoryFileError, match="damaged"), Memory.open(path) as memory:
        memory.experiences()


# --- the surroundings -----------------------------------------------------------------------------


def test_default_path(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PRESHAPE_MEMORY", str(tmp_path / "m.sqlite"))
    assert default_path() == tmp_path / "m.sqlite"
    with Memory.open(None) as memory:
        assert memory.where == str((tmp_path / "m.sqlite").resolve())
    monkeypatch.setenv("PRESHAPE_MEMORY", "")
    assert default_path().name == "memory.sqlite"
    assert "preshape" in str(default_path().parent)


def test_a_missing_memory_read_only_is_empty_and_not_made(path: Path) -> None:
    with Memory.open(path, read_only=True) as memory:
        assert memory.read_only
        assert (memory.count(), memory.experiences(), memory.weights("h")) == (0, (), None)
        for change in (
            lambda: memory.add([experience()]),
            lambda: memory.save_weights("h", weights()),
            memory.reset,
        ):
            with pytest.raises(EnvironmentFailure, match="reading only"):
                change()
    assert not path.parent.exists()


def test_read_only_sees_what_another_connection_adds_and_changes_nothing(path: Path) -> None:
    with Memory.open(path) as memory, Memory.open(path, read_only=True) as reader:
        memory.add([experience()])
        assert reader.count() == 1
        with pytest.raises(sqlite3.OperationalError, match="readonly"):
            reader._connection.execute("DELETE FROM experiences")


@pytest.mark.parametrize("read_only", [False, True])
def test_places_where_no_file_can_be(tmp_path: Path, read_only: bool) -> None:
    (tmp_path / "file").write_text("content")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    os.mkfifo(tmp_path / "pipe")
    for place in ("/dev/null", tmp_path, tmp_path / "pipe", tmp_path / "loop", tmp_path / "loop" / "m"):
        with pytest.raises(EnvironmentFailure):
            Memory.open(place, read_only=read_only)
    for place in ("", "a\0b"):
        with pytest.raises(MemoryFileError, match="path of a file"):
            Memory.open(place)
    if not read_only:
        for place in (tmp_path / "file" / "m.sqlite", Path("/proc/nowhere/m.sqlite"), Path("/proc/m.sqlite")):
            with pytest.raises(EnvironmentFailure, match=r"--memory OTHER") as caught:
                Memory.open(place)
            assert caught.value.exit_code == 3


def test_a_memory_that_may_not_be_written_is_read(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Memory.open(path) as memory:
        memory.add([experience()])
    monkeypatch.setattr(store.os, "access", lambda place, mode: mode != os.W_OK)
    with Memory.open(path) as memory:
        assert memory.read_only
        assert memory.count() == 1
        with pytest.raises(EnvironmentFailure, match="reading only"):
            memory.add([experience()])


READ_ONLY_MOUNT = """
mount --bind "$1" "$1" && mount -o remount,ro,bind "$1" || exit 77
exec "$2" -c '
import sys
from preshape.memory import Memory
from preshape.exceptions import EnvironmentFailure
folder = sys.argv[1]
for read_only in (False, True):
    with Memory.open(folder + "/memory.sqlite", read_only=read_only) as memory:
        print(memory.count(), memory.read_only)
for name, way in (("logged", True), ("new", False)):
    try:
        Memory.open(f"{folder}/{name}.sqlite", read_only=way).close()
        print("opened")
    except EnvironmentFailure as error:
        print("write permission" in str(error), "--memory OTHER" in str(error))
' "$1"
"""


@pytest.mark.skipif(shutil.which("unshare") is None, reason="needs unshare")
def test_a_read_only_file_system(tmp_path: Path) -> None:
    with Memory.open(tmp_path / "memory.sqlite") as memory:
        memory.add([experience()])
    with Memory.open(tmp_path / "other.sqlite") as memory:
        memory.add([experience()])
        for suffix in ("", "-wal"):  # as kill -9 leaves it
            shutil.copy(tmp_path / f"other.sqlite{suffix}", tmp_path / f"logged.sqlite{suffix}")
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", READ_ONLY_MOUNT, "sh", str(tmp_path), sys.executable],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode in {1, 77} and "Traceback" not in done.stderr:
        pytest.skip(f"no mount here: {done.stderr}")
    assert done.stdout.splitlines() == ["1 True", "1 True", "True True", "False True"], done.stderr


def test_a_full_disk_stores_nothing_and_says_so(path: Path) -> None:
    with Memory.open(path) as memory:
        memory.add([experience()])
        (pages,) = memory._connection.execute("PRAGMA page_count").fetchone()
        memory._connection.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(EnvironmentFailure, match="disk is full and nothing was stored") as caught:
            memory.add([experience(object_name="y" * 250)] * 200)
        assert isinstance(caught.value.__cause__, sqlite3.OperationalError)
        assert memory.count() == 1
        memory._connection.execute("PRAGMA max_page_count = 100000")
        memory.add([experience()])
        assert memory.count() == 2


def test_readonly_database_error_is_ours(path: Path) -> None:
    with Memory.open(path) as memory:
        memory._connection.execute("PRAGMA query_only = ON")
        with pytest.raises(EnvironmentFailure, match="readonly"):
            memory.add([experience()])


def test_locked_past_the_timeout(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schema, "BUSY_SECONDS", 0.05)
    with Memory.open(path) as memory:
        other = sqlite3.connect(path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(EnvironmentFailure, match="locked by another process"):
            memory.add([experience()])
        with Memory.open(path) as second:  # opening and reading do not wait for the writer
            assert second.count() == 0
        other.execute("ROLLBACK")
        other.close()
        assert memory.add([experience()]) == (1,)


def test_turning_to_write_ahead_logging_waits_for_readers(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Memory.open(path).close()
    reader = sqlite3.connect(path, isolation_level=None)
    reader.executescript("PRAGMA journal_mode = delete; BEGIN")
    reader.execute("SELECT count(*) FROM experiences").fetchall()
    monkeypatch.setattr(schema.time, "sleep", lambda seconds: reader.close())
    monkeypatch.setattr(schema, "connect", lambda uri: sqlite3.connect(uri, 0.02, 0, None, uri=True))
    with Memory.open(path) as memory:
        assert memory._connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_a_file_made_by_another_process_between_two_looks_at_it(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    turns: list[str] = []

    def another_process(statement: str) -> None:
        if "user_version" in statement and not turns:
            turns.append(statement)
            with suppress(EnvironmentFailure):  # locked out, which is as good
                Memory.open(path).close()

    def connect(uri: str) -> sqlite3.Connection:
        connection = sqlite3.connect(uri, 0.02, 0, None, uri=True)
        connection.set_trace_callback(another_process)
        return connection

    monkeypatch.setattr(schema, "connect", connect)
    monkeypatch.setattr(schema, "BUSY_SECONDS", 0.02)
    with Memory.open(path) as memory:
        assert memory.add([experience()]) == (1,)
    assert turns


def test_waiting_time_is_ten_seconds(path: Path) -> None:
    with Memory.open(path) as memory:
        assert memory._connection.execute("PRAGMA busy_timeout").fetchone() == (10_000,)


def test_a_closed_memory_is_our_error(path: Path) -> None:
    memory = Memory.open(path)
    memory.close()
    memory.close()
    calls: list[Callable[[], Any]] = [
        memory.count,
        memory.experiences,
        memory.objects,
        memory.statistics,
        memory.reset,
        lambda: memory.weights("h"),
        lambda: memory.add([experience()]),
        lambda: memory.export(path.with_name("e.json")),
    ]
    for call in calls:
        with pytest.raises(EnvironmentFailure, match="closed"):
            call()


def test_a_missing_table_is_our_error(path: Path) -> None:
    with Memory.open(path) as memory:
        memory._connection.execute("DROP TABLE experiences")
        for call in (memory.count, memory.objects, lambda: memory.add([experience()])):
            with pytest.raises(MemoryFileError, match="damaged"):
                call()


def test_an_interrupted_transaction_leaves_nothing() -> None:
    with Memory.open(":memory:") as memory:

        def interrupted() -> None:
            with failures.transaction(memory._connection):
                memory._connection.execute("DELETE FROM experiences")
                raise KeyboardInterrupt

        memory.add([experience()])
        with pytest.raises(KeyboardInterrupt):
            interrupted()
        assert memory.count() == 1
        assert memory.add([experience()]) == (2,)


# --- export and import ----------------------------------------------------------------------------


def test_export_and_import_give_the_same_memory(path: Path) -> None:
    document, again = path.with_name("a.json"), path.with_name("b.json")
    with Memory.open(path) as memory, Memory.open(":memory:") as other:
        memory.add([experience(object_name="Würfel"), experience(kind="best", volume=-0.0)])
        memory.add([experience(hand="allegro")], weights(9))
        memory.export(document)
        assert other.import_(document) == 3
        assert with_time(other.experiences()) == with_time(memory.experiences())
        assert bits(other.weights("allegro")) == bits(weights(9))
        other.export(again)
        assert again.read_bytes() == document.read_bytes()
        assert other.import_(document) == 0
        assert memory.import_(document) == 0
        other.add([experience(object_name="Würfel")])  # the same at another time is not the same
        other.export(again)
        assert memory.import_(again) == 1
        assert memory.save_weights("allegro", weights(10, 4))
        memory.import_(document)
        assert bits(memory.weights("allegro")) == bits(weights(10, 4))
    assert sorted(p.name for p in path.parent.iterdir()) == ["a.json", "b.json", path.name]


def test_export_is_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, document = tmp_path / "memory.sqlite", tmp_path / "out.json"
    document.write_text("before")
    with Memory.open(path) as memory:
        memory.add([experience()])

        def full(handle: int) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("preshape.files.os.fsync", full)
        with pytest.raises(EnvironmentFailure, match="No space left"):
            memory.export(document)
        monkeypatch.undo()
        assert document.read_text() == "before"
        assert {p.name for p in tmp_path.iterdir() if "memory" not in p.name} == {"out.json"}
        for place in (path, tmp_path / "memory.sqlite-wal"):
            with pytest.raises(InputError, match="the memory itself"):
                memory.export(place)
        for place in (tmp_path, document / "inside.json", Path("/proc/out.json")):
            with pytest.raises(EnvironmentFailure, match="cannot write"):
                memory.export(place)
        memory.export(document)
    assert json.loads(document.read_text())["version"] == FORMAT_VERSION


def good() -> dict[str, Any]:
    return {
        "format": "preshape-memory",
        "version": 1,
        "experiences": [
            {
                "kind": "task",
                "object_name": "cube",
                "hand": "utah_mit",
                "attributes": {
                    "extents": [0.1, 0.1, 0.1],
                    "vertices": 8,
                    "vertex_normals": 6,
                    "faces": 6,
                    "triangles": 12,
                    "area": 0.06,
                    "volume": 0.001,
                },
                "task": [1, 1, 0.1, 0.05, 0.8, 0.05],
                "plane": 5,
                "flip": False,
                "approach_value": 0,
                "approach_set": 3,
                "fingers": 3,
                "wrench": [1, 1, 0, 0, 0.8, 0],
                "match": 4.9,
                "created": "2020-01-01T00:00:00Z",
            }
        ],
        "weights": [
            {
                "hand": "utah_mit",
                "w1": [[1.0, 2.0]],
                "b1": [3.0],
                "w2": [[4.0]],
                "b2": [5.0],
                "mean_square_error": 0.1,
                "trained_on": 1,
                "epochs": 2,
            }
        ],
    }


def test_a_document_written_by_hand_is_imported(tmp_path: Path) -> None:
    (tmp_path / "in.json").write_text(json.dumps(good()))
    with Memory.open(":memory:") as memory:
        assert memory.import_(tmp_path / "in.json") == 1
        (one,) = memory.experiences()
        assert (one.created, one.plane, one.task.tolist()[:2]) == ("2020-01-01T00:00:00Z", 5, [1.0, 1.0])


MISSING = object()
FAULTS: list[tuple[tuple[str | int, ...], Any, str]] = [
    (("format",), MISSING, "format"),
    (("format",), "other", "format"),
    (("version",), FORMAT_VERSION + 1, "newer .* upgrade preshape"),
    (("version",), 0, "version"),
    (("version",), "1", "version"),
    (("version",), True, "version"),
    (("weights",), MISSING, "lacks 'weights'"),
    (("extra",), 1, "unknown field 'extra'"),
    (("experiences",), {}, "a list was expected"),
    (("experiences", 0), 5, "experience 1: an experience must be an object"),
    *(
        (("experiences", 0, name), MISSING, f"experience 1: .*lacks '{name}'")
        for name in [*FIELDS, "created", "attributes"]
    ),
    *((("experiences", 0, "attributes", name), MISSING, f"attributes lacks '{name}'") for name in SHAPE),
    *((("experiences", 0, name), None, "experience 1: ") for name in [*FIELDS, "created", "attributes"]),
    *((("experiences", 0, "attributes", name), "1", "experience 1: ") for name in SHAPE),
    (("experiences", 0, "id"), 3, "unknown field 'id'"),
    (("experiences", 0, "attributes", "colour"), 3, "unknown field 'colour'"),
    (("experiences", 0, "kind"), "dream", "kind must be one of"),
    (("experiences", 0, "kind"), ["task"], "kind must be one of"),
    (("experiences", 0, "plane"), 13, "plane"),
    (("experiences", 0, "plane"), 5.0, "plane"),
    (("experiences", 0, "flip"), 1, "flip"),
    (("experiences", 0, "match"), True, "match"),
    (("experiences", 0, "match"), 10**400, "match"),
    (("experiences", 0, "task"), [1, 2, 3], "task Q must be 6 numbers"),
    (("experiences", 0, "task"), [1, 2, 3, 4, 5, "6"], "task Q"),
    (("experiences", 0, "wrench"), [[1, 2, 3], [4, 5, 6]], "wrench"),
    (("experiences", 0, "attributes", "extents"), [1, 1, -1], "below 0"),
    (("experiences", 0, "created"), "", "created"),
    (("experiences", 0, "created"), "2020-01-01T00:00:00+02:00", "UTC"),
    (("weights", 0, "w1"), [[1.0, 2.0], [3.0]], "weights 1: hidden weights"),
    (("weights", 0, "w1"), [[1.0], [2.0]], "weights 1: weights must be"),
    (("weights", 0, "w1"), [[]], "weights 1: "),
    (("weights", 0, "b2"), [], "weights 1: "),
    (("weights", 0, "trained_on"), -1, "trained_on"),
    (("weights", 0, "hand"), "", "hand"),
    (("weights", 0, "epochs"), MISSING, "lacks 'epochs'"),
]


@pytest.mark.parametrize(("place", "content", "words"), FAULTS)
def test_each_fault_of_a_document_is_named_and_nothing_imported(
    tmp_path: Path, place: tuple[str | int, ...], content: Any, words: str
) -> None:
    document = good()
    spot: Any = document
    for step in place[:-1]:
        spot = spot[step]
    if content is MISSING:
        del spot[place[-1]]
    else:
        spot[place[-1]] = content
    document["experiences"] = (
        [good()["experiences"][0] | {"object_name": "other"}, *document["experiences"]]
        if isinstance(document["experiences"], list) and place[0] == "weights"
        else document["experiences"]
    )
    (tmp_path / "in.json").write_text(json.dumps(document))
    with Memory.open(":memory:") as memory:
        with pytest.raises(MemoryFileError, match=words) as caught:
            memory.import_(tmp_path / "in.json")
        assert str(tmp_path / "in.json") in str(caught.value)
        assert (memory.count(), memory.weights("utah_mit")) == (0, None)


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"{",
        b"[]",
        b"null",
        b"\xff\xfe",
        b"SQLite format 3\0",
        b"[" * 100_000,
        b'{"format": "preshape-memory", "version": NaN}',
        b'{"format": "preshape-memory", "format": "preshape-memory"}',
        b'{"format": ' + b"9" * 5000 + b"}",
        json.dumps(good()).replace("4.9", "1e999").encode(),
        json.dumps(good()).replace('"cube"', '"\\ud800"').encode(),
        json.dumps(good() | {"weights": good()["weights"] * 2}).encode(),
    ],
)
def test_what_is_not_a_document_is_refused(tmp_path: Path, raw: bytes) -> None:
    (tmp_path / "in.json").write_bytes(raw)
    with Memory.open(":memory:") as memory:
        with pytest.raises(MemoryFileError):
            memory.import_(tmp_path / "in.json")
        assert memory.count() == 0
        with pytest.raises(EnvironmentFailure, match="cannot import"):
            memory.import_(tmp_path / "none.json")
        with pytest.raises(MemoryFileError, match="this is a folder"):
            memory.import_(tmp_path)


def test_reset_forgets_what_a_real_hand_learnt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its lessons carry another name than the hand, and the hand may be a file."""
    file = Path(__file__).parent.parent / "examples" / "hands" / "trident.toml"
    store = str(tmp_path / "memory.sqlite")
    with Memory.open(store) as memory:
        memory.add([experience(hand=hand) for hand in ("trident", "trident+closure", "shadow+closure")])
    assert run(["memory", "reset", "--hand", str(file), "--memory", store, "--yes", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["forgotten"] == 2
    with Memory.open(store) as memory:
        assert [known.hand for known in memory.experiences()] == ["shadow+closure"]
