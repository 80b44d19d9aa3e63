"""Every reader keeps its promise on the corpus, on what fuzzing found, and on files cut and changed."""

from __future__ import annotations

import contextlib
import io
import json
import random
import re
import sqlite3
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from preshape.exceptions import EnvironmentFailure, HandError, InputError, MemoryFileError, ObjectError
from preshape.hands.check import check_hand
from preshape.hands.load import load_hand, parse_hand
from preshape.memory import Memory
from preshape.objects.load import load_object
from preshape.physics.grasps import GraspSet, read_grasps
from preshape.planning.grasp_sets import read_grasp_file

hardening = pytest.importorskip("hardening.readers", reason="the folder hardening is not here")

from hardening import fuzz, mutate, pincer  # noqa: E402
from hardening.readers import READERS, Fault, Reader, attempt  # noqa: E402
from hardening.seeds import CORPUS  # noqa: E402

FILES = [file for folder in sorted(CORPUS.iterdir()) for file in sorted(folder.iterdir())]
EACH = 60
"""New inputs for each reader; ``make fuzz`` tries a hundred thousand."""


def changed(data: bytes, largest: int, rng: random.Random) -> bytes:
    """A file with a few bytes changed, dropped or doubled, as a fuzzer does it."""
    out = bytearray(data or b"\0")
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(out))
        match rng.randrange(5):
            case 0:
                out[at] = rng.randrange(256)
            case 1:
                del out[at : at + rng.randrange(1, 20)]
            case 2:
                out[at:at] = out[at : at + rng.randrange(1, 40)]
            case 3:
                out[at] ^= 1 << rng.randrange(8)
            case _:
                out[at:at] = rng.choice((b"nan", b"-1", b"1e999", b"\0", b"\xff\xff\xff\xff", b"99999999999"))
        out = out or bytearray(b"\0")
    return bytes(out[:largest])


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parent.name}/{file.name}")
def test_the_corpus(file: Path, tmp_path: Path) -> None:
    refused = attempt(READERS[file.parent.name], tmp_path, file.read_bytes())
    assert bool(refused) == file.name.startswith("found-"), refused


def test_the_corpus_is_small_and_every_reader_has_one() -> None:
    assert {folder.name for folder in CORPUS.iterdir()} == set(READERS)
    assert sum(file.stat().st_size for file in FILES) < 200_000


@pytest.mark.parametrize("name", READERS)
def test_changed_files(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("preshape.hands.rewrite._SAMPLES", 4)
    reader, rng = READERS[name], random.Random(f"17 {name}")
    seeds = [file.read_bytes() for file in FILES if file.parent.name == name]
    refused = 0
    for number in range(EACH):
        data = rng.choice(seeds)
        if reader.mutate is not None and number % 3:
            step = random.Random(rng.random())
            with contextlib.suppress(OverflowError, ValueError, TypeError, UnicodeError):
                data = reader.mutate(data, reader.largest, step, partial(changed, rng=step))
        else:
            data = changed(data, reader.largest, rng)
        refused += bool(attempt(reader, tmp_path, data))
    assert refused > EACH // 4  # else nothing was damaged


@pytest.mark.parametrize("name", READERS)
def test_files_cut_short(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("preshape.hands.rewrite._SAMPLES", 4)
    for file in (file for file in FILES if file.parent.name == name and not file.name.startswith("found-")):
        data = file.read_bytes()
        for part in range(12):
            attempt(READERS[name], tmp_path, data[: part * len(data) // 12])


@pytest.mark.parametrize(
    ("reader", "said"),
    [
        (Reader(file="a", read=lambda path: int("x")), "ValueError"),
        (Reader(file="a", read=lambda path: _refuse("")), "message of 0 characters"),
        (Reader(file="a", read=lambda path: _refuse("a\nb")), "not one printable line"),
        (Reader(file="a", read=lambda path: _refuse("\x1b[31m")), "not one printable line"),
        (Reader(file="a", read=lambda path: _refuse("x" * 3000)), "message of 3000"),
        (Reader(file="a", read=lambda path: _exhaust()), "exhausted the memory"),
        (Reader(file="a", read=lambda path: np.sqrt(np.array(-1.0))), "a warning reaches the user"),
    ],
    ids=["foreign", "silent", "two lines", "escape", "long", "memory", "warning"],
)
def test_a_broken_promise_is_seen(reader: Reader, said: str, tmp_path: Path) -> None:
    with pytest.raises(Fault, match=said):
        attempt(reader, tmp_path, b"")


def _refuse(message: str) -> None:
    raise ObjectError(message)


def _exhaust() -> None:
    try:
        raise MemoryError
    except MemoryError as error:
        raise EnvironmentFailure("not enough memory") from error


def test_structured_changes_keep_the_framing() -> None:
    rng = random.Random(3)

    def bytewise(data: bytes, largest: int) -> bytes:
        return changed(data, largest, rng)

    npz = (CORPUS / "grasps-npz" / "cube").read_bytes()
    whole = 0
    for _ in range(40):
        with contextlib.suppress(zipfile.BadZipFile):
            whole += (
                zipfile.ZipFile(io.BytesIO(mutate.mutated_npz(npz, 99999, rng, bytewise))).testzip() is None
            )
    assert whole > 30
    glb = (CORPUS / "glb" / "tetra").read_bytes()
    made = [mutate.mutated_glb(glb, 99999, rng, bytewise) for _ in range(40)]
    assert sum(int.from_bytes(one[8:12], "little") == len(one) for one in made) > 30
    assert len(set(made)) > 20


# What fuzzing found, in words.


def test_an_archive_member_that_is_no_array(tmp_path: Path) -> None:
    file = tmp_path / "a.npz"
    with zipfile.ZipFile(CORPUS / "grasps-npz" / "cube") as old, zipfile.ZipFile(file, "w") as new:
        for name in old.namelist():
            new.writestr(name, b"no array" if name == "object.npy" else old.read(name))
    with pytest.raises(InputError, match="'object' cannot be read as arrays"):
        read_grasps(file)


def test_a_quaternion_beyond_all_measure_is_a_fault_of_its_row() -> None:
    row = [[0.0, 0, 0, 1e200, 1e200, 0, 0]]
    good = [[0.0, 0, 0, 1, 0, 0, 0]]
    made = GraspSet(
        hand="",
        joints=(),
        objects=("a",),
        scale=np.array([1.0]),
        object_pose=np.array(good),
        pregrasp=np.array(row),
        grasp=np.array(good),
        squeeze=np.array(good),
    )
    assert [fault.reason for fault in made.faults] == ["pregrasp: the quaternion's length is inf, not 1"]


@pytest.mark.parametrize(
    "change",
    [
        lambda plan: plan["hand"].update(joints=[{}, []]),
        lambda plan: plan["hand"]["grasp"].update(q=[{"a": 1}] * 24),
        lambda plan: plan["hand"]["grasp"].update(q=[10**400] * 24),
        lambda plan: plan["object"].update(extents=[10**400]),
        lambda plan: plan["object"].update(source="9" * 5000),
        lambda plan: plan["alternatives"][0]["hand"].update(name="\0\x1b[31m"),
    ],
)
def test_plans_with_things_that_are_no_numbers(change, tmp_path: Path) -> None:
    plan = json.loads((CORPUS / "plan-json" / "cube").read_text())
    change(plan)
    file = tmp_path / "a.json"
    file.write_text(json.dumps(plan))
    with pytest.raises(InputError, match=r"numbers|not a plan|different hands") as caught:
        read_grasp_file(file)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("gain = 5.0", f"gain = {10**400}", "gain must be a positive number"),
        ("gain = 5.0", f"gain = 1{'0' * 5000}", "not valid TOML"),
        ("u = 0.05", f"u = {'[' * 3000}{']' * 3000}", "not valid TOML"),
        ("pos = [0.0, 0.0, 0.0]", f"pos = [{10**400}, 0, 0]", "palm.pos must be three numbers"),
    ],
    ids=["huge", "endless", "deep", "huge place"],
)
def test_hands_beyond_all_measure(old: str, new: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "pincer.xml").write_text(pincer.MJCF)
    file = tmp_path / "hand.toml"
    assert old in pincer.TOML
    file.write_text(pincer.TOML.replace(old, new))
    with pytest.raises(HandError, match=said):
        load_hand(file)
    with pytest.raises(HandError):
        parse_hand(file.read_text(), pincer.MJCF)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('lower="-1" upper="1.5"', 'lower="-1e308" upper="1e308"', "no plausible angles in rad"),
        ('lower="-1" upper="1.5"', 'lower="nan" upper="1.5"', "no plausible angles in rad|cannot read"),
        ('mass value="0.05"', 'mass value="1e-308"', "mass"),
        ('<?xml version="1.0"?>', '<?xml version="1.0" encoding="klingon"?>', "cannot read"),
        ('<robot name="pincer">', f'<robot name="pincer">{"<a>" * 3000}{"</a>" * 3000}', "nested too deep"),
    ],
)
def test_models_beyond_all_measure(old: str, new: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "hand.toml").write_text(pincer.TOML.replace("pincer.xml", "pincer.urdf"))
    assert old in pincer.URDF
    (tmp_path / "pincer.urdf").write_text(pincer.URDF.replace(old, new))
    with pytest.raises(HandError, match=said):
        load_hand(tmp_path / "hand.toml")


def test_links_without_a_name_are_links_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "hand.toml").write_text(pincer.TOML)
    (tmp_path / "pincer.xml").write_text(pincer.MJCF)
    named = load_hand(tmp_path / "hand.toml")
    (tmp_path / "pincer.xml").write_bytes((CORPUS / "hand-mjcf" / "unnamed-bodies").read_bytes())
    unnamed = load_hand(tmp_path / "hand.toml")
    bodies = re.findall('<body name="([^"]*)"', unnamed.mjcf)
    assert len(set(bodies)) == 5
    assert {"palm", "a", "b"} < set(bodies)
    numbers = [
        re.findall(r'(?:pos|quat|size|range|fullinertia)="([^"]*)"', it.mjcf) for it in (named, unnamed)
    ]
    assert numbers[0] == numbers[1]


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (b'<mujoco><worldbody><body name="\xffpalm"/></worldbody></mujoco>', "not UTF-8; save the model"),
        (b'<mujoco><worldbody><body name="\x1b[31m"/></worldbody></mujoco>', r"it has \?\[31m"),
        (b"<m\xc2\x96", r"MuJoCo cannot read it.*name=m\?"),
        (b'<mujoco><worldbody><body name="' + b"x" * 4000 + b'"/></worldbody></mujoco>', "it has x{60} "),
    ],
    ids=["latin-1", "escape", "control", "long"],
)
def test_names_in_a_model_reach_a_message_as_text(model: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "hand.toml").write_text(pincer.TOML)
    (tmp_path / "pincer.xml").write_bytes(model)
    with pytest.raises(HandError, match=said) as caught:
        load_hand(tmp_path / "hand.toml")
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1000


_ENDLESS = [
    '<replicate count="1000000000"><body/></replicate>',
    '<replicate count="40"><replicate count="40"><body/></replicate></replicate>',
    '<body><composite type="grid" count="4000 4000 1"/></body>',
    '<include file="more.xml"/>',
    '\a<!-- -- --><replicate count="&#49;000000000"><body/></replicate>',
]


@pytest.mark.parametrize("part", _ENDLESS, ids=["many", "nested", "grid", "included", "not well formed"])
def test_a_part_repeated_without_measure_is_refused_at_once(part: str, tmp_path: Path) -> None:
    (tmp_path / "hand.toml").write_text(pincer.TOML)
    (tmp_path / "more.xml").write_text(f"<mujoco><worldbody>{_ENDLESS[0]}</worldbody></mujoco>")
    (tmp_path / "pincer.xml").write_text(f"<mujoco><worldbody>{part}</worldbody></mujoco>")
    with pytest.raises(HandError, match="at most 1000 are allowed"):
        load_hand(tmp_path / "hand.toml")


def test_a_part_repeated_with_measure_is_read(tmp_path: Path) -> None:
    (tmp_path / "hand.toml").write_text(pincer.TOML)
    pads = '<replicate count="3" offset="0 0.01 0"><geom type="sphere" size="0.004"/></replicate>'
    old = '<body name="palm">'
    assert old in pincer.MJCF
    (tmp_path / "pincer.xml").write_text(pincer.MJCF.replace(old, old + 12 * pads))
    assert load_hand(tmp_path / "hand.toml").mjcf.count('size="0.004"') == 36


def test_a_finding_is_one_printable_line(tmp_path: Path) -> None:
    (tmp_path / "pincer.xml").write_text(pincer.MJCF)
    file = tmp_path / "hand.toml"
    file.write_text(pincer.TOML.replace('"index"', r'"\u001b[31m\nindex"').replace('"b2"]', '"b9"]'))
    found = check_hand(file)
    assert found
    assert all(str(finding).isprintable() for finding in found)
    with pytest.raises(HandError) as caught:
        parse_hand(file.read_text(), pincer.MJCF)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(("code", "harmless", "faults"), [(-9, True, 0), (-9, False, 1), (-11, True, 1)])
def test_a_fuzzer_killed_from_outside_is_no_fault_of_the_reader(
    code: int, harmless: bool, faults: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends = iter([code, 0])

    def segment(name: str, work: Path, runs: int, total: dict[str, Any]) -> int:
        (work / "tally.json").write_text(json.dumps({"inputs": 5, "refused": 5}))
        (work / "log").write_text("")
        return next(ends)

    monkeypatch.setattr(fuzz, "_segment", segment)
    monkeypatch.setattr(fuzz, "_harmless", lambda name, work: harmless)
    total = fuzz.fuzz("obj", tmp_path, 10)
    assert total["inputs"] == 10
    assert sum(total["faults"].values()) == faults
    assert total.get("killed", 0) == 1 - faults


def test_a_model_with_nan_leaves_no_log_behind_and_says_nothing_beside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hand.toml").write_text(pincer.TOML)
    (tmp_path / "pincer.xml").write_text(pincer.MJCF.replace('range="-1 1.5"', 'range="-1 nan"'))
    with pytest.raises(HandError):
        load_hand(tmp_path / "hand.toml")
    assert {file.name for file in tmp_path.iterdir()} == {"hand.toml", "pincer.xml"}
    assert capfd.readouterr() == ("", "")


def test_a_damaged_memory_is_refused_in_one_line(tmp_path: Path) -> None:
    file = tmp_path / "a.sqlite"
    file.write_bytes((CORPUS / "memory" / "two").read_bytes().replace(b"fingers INTEGER", b'"ingers INTEGER'))
    for read_only in (True, False):
        with (
            pytest.raises(MemoryFileError, match="damaged") as caught,
            Memory.open(file, read_only=read_only) as memory,
        ):
            memory.statistics()
        assert str(caught.value).isprintable()


def test_a_damaged_row_is_named_in_one_line(tmp_path: Path) -> None:
    file = tmp_path / "a.sqlite"
    file.write_bytes((CORPUS / "memory" / "two").read_bytes())
    with contextlib.closing(sqlite3.connect(file)) as connection:
        connection.execute("UPDATE experiences SET shape = ?", (np.full(28, np.nan).tobytes(),))
        connection.commit()
    with Memory.open(file) as memory:
        assert memory.experiences() == ()
        assert "shape" in memory.remark
        assert memory.remark.isprintable()


def test_what_a_mesh_file_says_of_itself_is_shown_as_text(tmp_path: Path) -> None:
    file = tmp_path / "a.ply"
    file.write_bytes(
        b"ply\nformat ascii 1.0\nelement \x1b[31mred 4\nproperty int a\nelement face 1\n"
        b"property list uchar int vertex_indices\nend_header\n1\n"
    )
    with pytest.raises(ObjectError) as caught:
        load_object(file)
    assert str(caught.value).isprintable()
