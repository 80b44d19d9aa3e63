"""No reader waits for a pipe, reads a device without end, or takes a pointer for the file."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from preshape.exceptions import InputError
from preshape.files import MOST_OF_ARRAYS, arrays_in, read_file
from preshape.hands.load import parse_hand, read_description
from preshape.memory.transfer import read_document
from preshape.planning.document import read_plan
from preshape.planning.grasp_sets import read_grasp_file

pytest.importorskip("hardening.files", reason="the folder hardening is not here")

from hardening.files import LFS, REFERENCES, cases, odd_file, one
from hardening.readers import READERS

SAID = {
    "pipe": "regular file",
    "socket": "regular file",
    "zero": "regular file",
    "folder": "folder|directory|regular file",
    "pointer": "Git LFS pointer|not a memory of preshape",
    "oversize": "at most 1 MB are read",
}


@pytest.mark.parametrize(("reader", "kind", "place"), cases(long=False))
def test_what_is_no_file_is_refused(reader: str, kind: str, place: str) -> None:
    assert re.search(SAID[kind], one(reader, kind, place))


def test_every_reader_and_every_reference_has_its_cases() -> None:
    assert {reader for reader, _, _ in cases(long=False)} == set(READERS)
    assert {reader for reader, _, place in cases(long=False) if place != "file"} == set(REFERENCES)


def test_limits_of_reading(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_bytes(b"x" * 2**20)
    assert len(read_file(file, 2**20)) == 2**20
    file.write_bytes(b"x" * (2**20 + 1))
    with pytest.raises(InputError, match="1 MB are too much for a mesh file, of which at most 1 MB are read"):
        read_file(file, 2**20, "mesh file")


def test_an_archive_that_unpacks_to_too_much_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    import io

    import numpy as np

    content = io.BytesIO()
    np.savez_compressed(content, a=np.zeros(1_000_000))
    assert MOST_OF_ARRAYS >= 8_000_000
    monkeypatch.setattr("preshape.files.MOST_OF_ARRAYS", 1_000_000)
    with pytest.raises(ValueError, match="unpacks to 8 MB"):
        arrays_in(content.getvalue())


@pytest.mark.parametrize("kind", ["pipe", "zero", "folder", "pointer"])
def test_a_plan_is_a_regular_file(kind: str, tmp_path: Path) -> None:
    with odd_file(kind, tmp_path / "plan.json") as path, pytest.raises(InputError, match=SAID[kind]):
        read_plan(path)
    assert LFS.startswith("version")


@pytest.mark.parametrize(
    ("read", "start"),
    [
        (read_document, ""),
        (read_plan, ""),
        (read_grasp_file, ""),
        (read_description, "a = "),
        (lambda file: parse_hand(file.read_text(), ""), "a = "),
    ],
    ids=["memory", "plan", "grasps", "hand", "description"],
)
def test_a_text_that_is_nested_too_deeply_is_called_so(
    read: Callable[[Path], object], start: str, tmp_path: Path
) -> None:
    file = tmp_path / "deep"
    file.write_text(start + "[" * 200_000)
    with pytest.raises(InputError, match="nested too deeply"):
        read(file)
