"""What is worked out of a hand once comes back from disk as it was made."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from preshape.closure.hand_tables import COARSE, _tables, cached, digest
from preshape.hands import load_hand
from preshape.kernels.tables import HandTables


def _same(left: object, right: object) -> bool:
    if isinstance(left, np.ndarray) and isinstance(right, np.ndarray):
        return left.dtype == right.dtype and np.array_equal(left, right)
    return left == right


def test_a_value_of_an_empty_cache_is_made_once_and_read_back_bit_for_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path))
    hand, made = load_hand("allegro"), []

    def make() -> HandTables:
        made.append(_tables(hand, COARSE))
        return made[-1]

    first, second = (cached(HandTables, hand, "tables", make) for _ in range(2))
    assert len(made) == 1
    for field in fields(HandTables):
        assert _same(getattr(first, field.name), getattr(second, field.name)), field.name
    (file,) = (tmp_path / "hands").glob("*.npz")
    file.write_bytes(file.read_bytes()[:100])
    cached(HandTables, hand, "tables", make)
    assert len(made) == 2, "a file cut short is made anew"


def test_a_folder_that_cannot_be_written_is_done_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    monkeypatch.setenv("PRESHAPE_CACHE", str(blocked))
    hand = load_hand("allegro")
    assert isinstance(cached(HandTables, hand, "tables", lambda: _tables(hand, COARSE)), HandTables)


def test_another_hand_is_another_file() -> None:
    hand = load_hand("allegro")
    assert digest(hand, "tables") == digest(load_hand("allegro"), "tables")
    others = [replace(hand, mjcf=hand.mjcf + " "), replace(hand, torque_limits=1.01 * hand.torque_limits)]
    assert len({digest(one, "tables") for one in (hand, load_hand("leap"), *others)}) == 4
    assert digest(hand, "tables") != digest(hand, "tables 2")
