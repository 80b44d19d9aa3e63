"""What later memory schemas added: shape descriptors, grips of real hands, quality, outcome, scene, model."""

from __future__ import annotations

import json
import re
import sqlite3
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from preshape.exceptions import InputError, MemoryFileError
from preshape.memory import FORMAT_VERSION, SCHEMA_VERSION, Memory
from preshape.memory.schema import MIGRATIONS
from preshape.objects.shape import LENGTH
from preshape.types import Array, Attributes, Experience

GRIP = np.array([0.01, -0.02, 0.09, 0.5, -0.5, 0.5, -0.5, 0b10011, 0.3, -0.0, 1.2])
SHAPE = np.linspace(-0.5, 1.0, LENGTH)
MODEL = "01234567deadbeef"


def experience(*, shape: Array | None = None, **changes: Any) -> Experience:
    attributes = Attributes(
        extents=np.array([0.05, 0.06, 0.07]), vertices=8, vertex_normals=6, faces=6, triangles=12,
        area=0.0214, volume=2.1e-4, shape=shape,
    )  # fmt: skip
    plain = Experience(
        kind="task", object_name="cube", hand="shadow", attributes=attributes,
        task=np.array([1, 1, 0.1, 0.05, 0.8, 0.05]), plane=5, flip=True, approach_value=0.01, approach_set=3,
        fingers=3, wrench=np.array([1.35, 1.0, -0.3, -0.06, 0.8, -0.0]), match=4.9,
        created="2020-01-01T00:00:00Z",
    )  # fmt: skip
    return replace(plain, **changes)


def bits(e: Experience) -> tuple[Any, ...]:
    """What is new in an experience, down to the sign of zero."""
    arrays = (None if a is None else (a.shape, a.tobytes()) for a in (e.attributes.shape, e.grip))
    return (*arrays, None if e.quality is None else struct.pack("<d", e.quality), e.outcome, e.scene, e.model)


PLAIN = (None, None, None, "", "", "")
"""Those bits of an experience from before there were such fields."""


finite = st.floats(-1e6, 1e6)


@st.composite
def grips(draw: st.DrawFn) -> Array:
    place = draw(st.lists(finite, min_size=3, max_size=3))
    turn = np.array(draw(st.lists(st.floats(-1, 1), min_size=4, max_size=4)))
    turn = turn / np.linalg.norm(turn) if np.linalg.norm(turn) > 1e-3 else np.array([1.0, 0.0, 0.0, -0.0])
    joints = draw(st.lists(finite, min_size=1, max_size=30))
    return np.array([*place, *turn, draw(st.integers(1, 2**16 - 1)), *joints])


new_fields = st.fixed_dictionaries(
    {
        "shape": st.none() | st.lists(finite, min_size=LENGTH, max_size=LENGTH).map(np.array),
        "grip": st.none() | grips(),
        "quality": st.none() | st.floats(0, 6),
        "outcome": st.sampled_from(["", "held", "lost"]),
        "scene": st.text(st.characters(codec="utf-8"), max_size=40),
        "model": st.text("0123456789abcdef", min_size=16, max_size=16) | st.just(""),
    }
)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(changes=st.lists(new_fields, max_size=4))
def test_what_is_stored_and_exported_comes_back_with_every_bit(
    tmp_path_factory: pytest.TempPathFactory, changes: list[dict[str, Any]]
) -> None:
    document = tmp_path_factory.getbasetemp() / "grips.json"
    content = [experience(**one, object_name=f"object {i}") for i, one in enumerate(changes)]
    with Memory.open(":memory:") as memory, Memory.open(":memory:") as other:
        memory.add(content)
        assert [bits(e) for e in memory.experiences()] == [bits(e) for e in content]
        held = [bits(e) for e in content if e.grip is not None]
        assert [bits(e) for e in memory.experiences("shadow", gripped=True)] == held
        assert memory.experiences("allegro", gripped=True) == ()
        memory.export(document)
        assert other.import_(document) == len(content)
        assert [bits(e) for e in other.experiences()] == [bits(e) for e in content]
        assert other.import_(document) == 0  # the same ones, known as such


def test_an_object_is_summed_up_by_the_quality_of_its_grips_and_the_first_lesson_is_marked() -> None:
    with Memory.open(":memory:") as memory:
        memory.add(
            [
                experience(grip=GRIP, quality=3.5, match=1.2),
                experience(grip=GRIP, quality=4.25, match=6.0, kind="best"),
                experience(grip=GRIP, quality=5.0, object_name="seed", kind="seed"),
                experience(match=4.5, object_name="both", hand="utah_mit"),
                experience(grip=GRIP, quality=3.0, match=6.0, object_name="both"),
            ]
        )
        both, cube, seed = memory.objects()
        assert (cube.best, cube.best_quality, cube.best_match) == ("quality 4.25", 4.25, 6.0)
        assert both.best == "quality 3.00, TFVADI 4.50"
        assert [one.seed for one in (both, cube, seed)] == [False, False, True]


def test_what_is_not_known_is_null() -> None:
    with Memory.open(":memory:") as memory:
        memory.add([experience(), experience(grip=GRIP, shape=SHAPE, quality=2, outcome="held")])
        row = "SELECT shape, grip, quality, outcome FROM experiences ORDER BY id"
        first, second = memory._connection.execute(row).fetchall()
        assert first == (None, None, None, None)
        assert second == (SHAPE.tobytes(), GRIP.tobytes(), 2.0, "held")
        _, read = memory.experiences()
        assert read.grip is not None
        assert not read.grip.flags.writeable
        assert read.attributes.shape is not None
        assert not read.attributes.shape.flags.writeable


def changed(index: int, content: float) -> Array:
    grip = GRIP.copy()
    grip[index] = content
    return grip


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"grip": GRIP[:8]}, "grip must be a pose of 7 numbers, the fingers and joint angles, got 8"),
        ({"grip": np.zeros(0)}, "got 0 numbers"),
        ({"grip": changed(3, 0.6)}, r"quaternion must have length 1, got \[0.6, -0.5"),
        ({"grip": changed(7, 0)}, "fingers must be a whole number from 1, got 0"),
        ({"grip": changed(7, 2.5)}, "fingers must be a whole number from 1, got 2.5"),
        ({"grip": changed(7, -1)}, "fingers"),
        ({"grip": changed(7, 2**17)}, "fingers"),
        ({"shape": SHAPE[:-1]}, "shape must be 28 numbers, got 27"),
        ({"quality": 6.1}, "quality must be a finite number"),
        ({"quality": float("nan")}, "quality"),
        ({"quality": "good"}, "quality"),
        ({"outcome": "dropped"}, "outcome must be empty, held or lost, got 'dropped'"),
        ({"outcome": None}, "outcome"),
        ({"model": MODEL[1:]}, "model must be empty or 16 lower-case hexadecimal digits, got '1"),
        ({"model": MODEL.upper()}, "model must be empty"),
        ({"model": None}, "model"),
    ],
)
def test_what_could_not_be_read_back_is_not_stored(changes: dict[str, Any], words: str) -> None:
    with Memory.open(":memory:") as memory:
        with pytest.raises(InputError, match=words):
            memory.add([experience(grip=GRIP), experience(**changes)])
        assert memory.count() == 0


@pytest.mark.parametrize("bad", [changed(0, np.nan), changed(9, np.inf), GRIP.reshape(1, -1), "a grip"])
def test_a_grip_that_is_not_finite_numbers_in_a_row_is_refused_at_once(bad: Any) -> None:
    with pytest.raises(InputError, match="grip must be"):
        experience(grip=bad)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        ("grip = substr(grip, 1, 87)", "grip must be a whole number of 8-byte numbers, got 87 bytes"),
        ("grip = substr(grip, 1, 64)", "got 8 numbers"),
        ("grip = 'text'", "grip must be a whole number of 8-byte numbers, got 'text'"),
        ("grip = zeroblob(88)", "quaternion"),
        ("grip = x'" + "000000000000f87f" * 11 + "'", "quaternion must have length 1"),
        ("grip = x'" + GRIP.tobytes().hex()[:-16] + "000000000000f87f'", "grip must be finite"),
        ("shape = zeroblob(8)", "shape must be 28 numbers"),
        ("shape = 1.5", "shape"),
        ("quality = 'high'", "quality"),
        ("quality = 9e999", "quality"),
        ("outcome = 'broken'", "outcome"),
        ("outcome = 3", "outcome"),
        ("model = 'another'", "model must be empty or 16"),
        ("model = 3", "model"),
    ],
)
def test_a_damaged_row_is_skipped_and_named(tmp_path: Path, damage: str, words: str) -> None:
    path = tmp_path / "memory.sqlite"
    with Memory.open(path) as memory:
        memory.add([experience(grip=GRIP, shape=SHAPE)] * 2)
    connection = sqlite3.connect(path)
    connection.execute(f"UPDATE experiences SET {damage} WHERE id = 2")
    connection.commit()
    connection.close()
    with Memory.open(path) as memory:
        assert len(memory.experiences()) == 1
        assert re.search(f"experience 2: .*{words}", memory.remark)


# --- versions -------------------------------------------------------------------------------------


def file_of_version(path: Path, version: int, content: list[Experience]) -> None:
    """A file as an older version wrote it: today's, without the columns that came later."""
    with Memory.open(path) as memory:
        memory.add(content)
    connection = sqlite3.connect(path, isolation_level=None)
    later = {
        1: ("area", "volume"),
        2: ("shape", "grip", "quality", "outcome"),
        3: ("scene",),
        4: ("length_unit",),
        5: ("model",),
    }
    for name in (name for since, names in later.items() if since >= version for name in names):
        connection.execute(f"ALTER TABLE experiences DROP COLUMN {name}")
    connection.execute(f"PRAGMA user_version = {version}")
    connection.close()


def columns(path: Path) -> list[Any]:
    connection = sqlite3.connect(path)
    found = connection.execute("PRAGMA table_info(experiences)").fetchall()
    connection.close()
    return found


@pytest.mark.parametrize("version", [1, 2, 3, 4, 5])
def test_an_older_file_is_migrated_and_a_copy_kept(tmp_path: Path, version: int) -> None:
    path, fresh = tmp_path / "memory.sqlite", tmp_path / "fresh.sqlite"
    old = [experience(object_name="old")]
    file_of_version(path, version, old)
    before = columns(path)
    with Memory.open(path, read_only=True) as memory:  # in a copy: the file stays
        assert [bits(e) for e in memory.experiences()] == [PLAIN]
    assert columns(path) == before
    with Memory.open(path) as memory:
        (one,) = memory.experiences()
        assert bits(one) == PLAIN
        assert one.task.tobytes() == old[0].task.tobytes()
        if version > 1:
            assert (one.attributes.area, one.attributes.volume) == (0.0214, 2.1e-4)
        assert memory.statistics().version == SCHEMA_VERSION
        memory.add([experience(grip=GRIP, shape=SHAPE, outcome="lost")])
        assert [e.outcome for e in memory.experiences(gripped=True)] == ["lost"]
    Memory.open(fresh).close()
    assert columns(path) == columns(fresh)
    assert columns(tmp_path / f"memory.sqlite.v{version}-backup") == before


def test_a_failed_migration_leaves_version_2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "memory.sqlite"
    file_of_version(path, 2, [experience()])
    before = columns(path)

    def half(connection: sqlite3.Connection) -> None:
        connection.execute("ALTER TABLE experiences ADD COLUMN shape")
        raise sqlite3.OperationalError("power cut")

    monkeypatch.setitem(MIGRATIONS, 2, half)
    with pytest.raises(MemoryFileError, match="power cut"):
        Memory.open(path)
    assert columns(path) == before


# --- the exported document ------------------------------------------------------------------------


def document_of(tmp_path: Path, content: Experience) -> dict[str, Any]:
    with Memory.open(":memory:") as memory:
        memory.add([content])
        memory.export(tmp_path / "out.json")
    found: dict[str, Any] = json.loads((tmp_path / "out.json").read_text())
    return found


def older_version(document: dict[str, Any], version: int = 1) -> dict[str, Any]:
    (one,) = document["experiences"]
    since = {2: ("grip", "quality", "outcome"), 3: ("scene",), 4: ("length_unit",), 5: ("model",)}
    later = [name for added, names in since.items() if added > version for name in names]
    plain = {name: one[name] for name in one if name not in later}
    if version == 1:
        plain["attributes"] = {name: one["attributes"][name] for name in one["attributes"] if name != "shape"}
    return {**document, "version": version, "experiences": [plain]}


@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_a_document_of_an_older_version_is_read(tmp_path: Path, version: int) -> None:
    document = document_of(tmp_path, experience())
    assert document["version"] == FORMAT_VERSION == 5
    (tmp_path / "in.json").write_text(json.dumps(older_version(document, version)))
    with Memory.open(":memory:") as memory:
        assert memory.import_(tmp_path / "in.json") == 1
        assert [bits(e) for e in memory.experiences()] == [PLAIN]
        assert all(e.outdated == (version < 4) for e in memory.experiences())
        assert memory.import_(tmp_path / "in.json") == 0  # the same experience


@pytest.mark.parametrize("name", ["grip", "quality", "outcome", "shape", "scene", "length_unit", "model"])
def test_each_version_has_exactly_its_fields(tmp_path: Path, name: str) -> None:
    document = document_of(tmp_path, experience(grip=GRIP, shape=SHAPE, quality=3.0, outcome="held"))
    old = older_version(document)
    place, source = (old["experiences"][0], document["experiences"][0])
    if name == "shape":
        place, source = place["attributes"], source["attributes"]
    place[name] = source[name]
    del source[name]
    with Memory.open(":memory:") as memory:
        for content, words in ((old, f"unknown field '{name}'"), (document, f"lacks '{name}'")):
            (tmp_path / "in.json").write_text(json.dumps(content))
            with pytest.raises(MemoryFileError, match=words):
                memory.import_(tmp_path / "in.json")
        assert memory.count() == 0


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("grip", [1.0] * 9, "experience 1: the grip's quaternion"),
        ("grip", [*GRIP.tolist(), "0.1"], "experience 1: grip"),
        ("grip", "none", "grip must be a list"),
        ("grip", [[*GRIP.tolist()]], "grip"),
        ("quality", "3", "quality"),
        ("quality", True, "quality"),
        ("outcome", None, "outcome"),
        ("outcome", ["held"], "outcome"),
        ("model", None, "model must be empty or 16"),
    ],
)
def test_each_fault_of_a_document_is_named(tmp_path: Path, name: str, content: Any, words: str) -> None:
    document = document_of(tmp_path, experience(grip=GRIP))
    document["experiences"][0][name] = content
    (tmp_path / "in.json").write_text(json.dumps(document))
    with Memory.open(":memory:") as memory:
        with pytest.raises(MemoryFileError, match=words):
            memory.import_(tmp_path / "in.json")
        assert memory.count() == 0
