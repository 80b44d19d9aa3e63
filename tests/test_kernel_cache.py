"""The cache of compiled kernels: whatever is in it, the right kernels are loaded."""

from __future__ import annotations

import os
import random
from pathlib import Path

import numpy as np
import pytest
from hardening import kernel_cache as study

from preshape.exceptions import EnvironmentFailure
from preshape.files import spare_folder, temporary_folder
from preshape.kernels import cache
from preshape.kernels.closing import warp_clearance
from preshape.kernels.launch import announce

CONTENT = {"k.cpu12.o": bytes(range(256)) * 40, "k.meta": b"{}"}


@pytest.fixture
def made(tmp_path: Path) -> dict[str, Path]:
    """Compiled files, as Warp leaves them."""
    folder = tmp_path / "made"
    folder.mkdir()
    for name, content in CONTENT.items():
        (folder / name).write_bytes(content)
    return {name: folder / name for name in CONTENT}


def unpacked(place: Path, folder: Path) -> dict[str, bytes]:
    names = cache._unpack("k", {place: None}, folder)
    return {name: (folder / name).read_bytes() for name in names}


def test_kept_kernels_come_back_to_the_last_bit(made: dict[str, Path], tmp_path: Path) -> None:
    cache._keep("k", {tmp_path / "cache": None}, made)
    assert unpacked(tmp_path / "cache", tmp_path / "out") == CONTENT


@pytest.mark.parametrize("damage", study.DAMAGE)
@pytest.mark.parametrize("seed", range(3))
def test_damaged_kernels_are_never_unpacked(damage, seed: int, made: dict[str, Path], tmp_path: Path) -> None:
    cache._keep("k", {tmp_path: None}, made)
    damage(tmp_path / "k.npz", random.Random(seed))
    assert unpacked(tmp_path, tmp_path / "out") == {}
    assert not (tmp_path / "out").exists()


def test_the_next_place_has_what_the_first_one_lacks(made: dict[str, Path], tmp_path: Path, capsys) -> None:
    announce.cache_clear()
    places = {Path(os.devnull) / "cache": None, tmp_path / "spare": None}
    cache._keep("k", places, made)
    assert f"they are kept in {tmp_path / 'spare'}" in capsys.readouterr().err
    assert cache._unpack("k", places, tmp_path / "out") == set(CONTENT)
    cache._keep("k", {Path(os.devnull) / "cache": None}, made)
    assert "can be kept neither in" in capsys.readouterr().err


def test_a_name_in_the_cache_cannot_leave_the_folder(tmp_path: Path) -> None:
    np.savez(tmp_path / "k.npz", **{"../../out.o": np.zeros(3, np.uint8)})
    assert set(cache._unpack("k", {tmp_path: None}, tmp_path / "a")) == {"out.o"}
    assert (tmp_path / "a" / "out.o").read_bytes() == bytes(3)


def test_a_spare_folder_is_this_user_s_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = spare_folder("kernels")
    assert folder.parent == tmp_path
    assert folder.stat().st_mode & 0o777 == 0o700
    assert spare_folder("kernels") == folder
    folder.chmod(0o777)
    assert not spare_folder("kernels").exists()
    folder.rmdir()
    folder.symlink_to(tmp_path)
    assert not spare_folder("kernels").exists()


def test_a_temporary_folder_that_cannot_be_made_and_a_full_one(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(cache, "ROOM", 2**62)
    with pytest.raises(EnvironmentFailure, match="set TMPDIR to another folder"):
        cache._check_room(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", os.devnull)
    with pytest.raises(EnvironmentFailure, match="no temporary folder can be made"), temporary_folder("x"):
        pass


def test_kernels_are_looked_up_once_in_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    cache.load_kernels(warp_clearance, "cpu")
    monkeypatch.setattr(cache, "temporary_folder", None)
    cache.load_kernels(warp_clearance, "cpu")
    with pytest.raises(TypeError):
        cache.load_kernels.__wrapped__(warp_clearance, "cpu")


@pytest.mark.slow
def test_a_truncated_cache_is_compiled_again(tmp_path: Path) -> None:
    whole, temporary = tmp_path / "warp", tmp_path / "tmp"
    temporary.mkdir()
    told = []
    for _ in range(3):
        done = study._run(("-c", study.LOAD), whole, temporary)
        assert done.returncode == 0, done.stderr
        told.append(done.stderr)
        assert done.stdout.split() == [spare_folder("kernels").name]
        if len(told) == 2:
            study.cut(next(whole.rglob("*.npz")), random.Random(0))
    once = f"{study.COMPILES} for this machine, once: about 20 s ...\n"
    assert told == [once, "", once]
    assert not list(temporary.iterdir()) or [f.name for f in temporary.iterdir()] == [
        spare_folder("kernels").name
    ]
