"""Arrays and packed launches that are reused give what fresh ones give, whatever was computed before."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from preshape.closure.candidates import Region, draw_candidates
from preshape.closure.hand_tables import hand_tables
from preshape.closure.preshapes import preshapes
from preshape.hands import load_hand
from preshape.kernels.closing.host import CLOSING_ARRAYS, Candidates, ClosingKernel, Closings, Fate
from preshape.kernels.field.host import SurfaceQuery, prepare_field
from preshape.kernels.launch import usable_threads, warp
from preshape.kernels.margin.host import MarginKernel
from preshape.kernels.packed_launch import FIRST_ROW, LEAST_CAPACITY, DeviceRows, PackedLaunch
from preshape.objects.library import load_library_object

MESH = load_library_object("mug")
HAND = load_hand("allegro")
TABLES, FIELD = hand_tables(HAND), prepare_field(MESH, cells=48, cache=None)


@pytest.fixture(params=["host memory", "as on a device"], autouse=True)
def memory(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows are written and read through the host's own memory, or copied as from and to a device."""
    if request.param != "host memory":
        plain = DeviceRows.reserve

        def reserve(rows: DeviceRows, count: int) -> None:
            plain(rows, count)
            rows._host_view = None

        monkeypatch.setattr(DeviceRows, "reserve", reserve)


def kernel(threads: int = 1) -> ClosingKernel:
    return ClosingKernel(TABLES, FIELD, threads=threads)


def drawn(seed: int, count: int) -> Candidates:
    rng = np.random.default_rng(seed)
    return draw_candidates(rng, preshapes(HAND), MESH.cog, MESH.extents / 2, count, Region()).candidates


def same(left: Closings, right: Closings) -> None:
    for name in CLOSING_ARRAYS:
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name), err_msg=name)


def test_many_then_few_then_more_than_ever() -> None:
    kept = kernel(2)
    for seed, count in enumerate((200, 3, 1, 0, 64, 700)):
        given = drawn(seed, count)
        same(kept.close(given), kernel().close(given))


def test_settings_of_one_call_do_not_stay() -> None:
    kept, given = kernel(), drawn(1, 60)
    before = kept.close(given)
    other = kept.close(given, wanted=5, clearance=0.01, palm_clearance=0.02, tolerance=1e-3)
    assert (before.fate != other.fate).any()
    same(kept.close(given), before)


def test_only_those_that_closed() -> None:
    kept, given = kernel(), drawn(2, 120)
    whole = kept.close(given)
    rows, closed = kept.closed(given)
    np.testing.assert_array_equal(rows, np.flatnonzero(whole.fate == Fate.CLOSED))
    same(closed, whole.take(rows))
    closed.points[:] = 0.0
    same(kept.close(given), whole)


def test_two_threads_may_share_a_kernel() -> None:
    kept = kernel(2)
    batches = [drawn(seed, 150) for seed in range(6)]
    alone = [kernel().close(given) for given in batches]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(3):
            for left, right in zip(pool.map(kept.close, batches), alone, strict=True):
                same(left, right)


def test_strength_alone_is_the_strength() -> None:
    rows, closed = kernel().closed(drawn(3, 400))
    assert len(rows) > 50
    asked = MarginKernel(np.concatenate([np.eye(6), -np.eye(6)]), friction=0.4, torsion=0.003)
    given = closed.points, closed.normals_in, closed.counts
    full = asked(*given, 0.05, reference=MESH.cog)
    for count in (len(rows), 5, 0):
        part = tuple(array[:count] for array in given)
        alone = asked.strengths(*part, 0.05, MESH.cog)
        # Two searches of the same number, each right to 1 %.
        np.testing.assert_allclose(alone, full["strength"][:count], rtol=0.02, atol=4e-5)
        most = np.linspace(0.0, 2.0, count) * alone
        capped = asked.strengths(*part, 0.05, MESH.cog, most=most)
        np.testing.assert_allclose(capped, np.minimum(alone, most), rtol=0.02, atol=4e-5)


def test_nearest_points_do_not_depend_on_what_was_asked_before() -> None:
    query, rng = SurfaceQuery(MESH), np.random.default_rng(0)
    for count in (300, 2, 0, 50):
        points = rng.normal(0.0, 0.1, (count, 3))
        left, right = query.closest(points), SurfaceQuery(MESH).closest(points)
        for name in ("distance", "point", "normal_out", "triangle"):
            np.testing.assert_array_equal(getattr(left, name), getattr(right, name))


def test_arguments_must_be_those_of_the_kernel_in_its_order() -> None:
    made = kernel()
    given = {"hand": made.hand, "place": 0, "first": FIRST_ROW}
    with pytest.raises(AssertionError):
        PackedLaunch(made._close._kernel, given, device="cpu", threads=1)


def test_threads_where_the_system_does_not_tell_a_process_its_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on macOS, which has no ``sched_getaffinity``."""
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    assert usable_threads("cpu") == 3
    assert usable_threads("cuda:0") == 1
    given = drawn(4, 100)
    same(ClosingKernel(TABLES, FIELD).close(given), kernel().close(given))


@pytest.mark.parametrize("count", [0, 1, LEAST_CAPACITY, LEAST_CAPACITY + 1])
def test_rows_come_back_as_they_were_put(count: int) -> None:
    rows = DeviceRows(warp().vec3, 2, device="cpu")
    values = np.random.default_rng(count).normal(size=(count, 2, 3)).astype(np.float32)
    rows.put(values)
    rows.reserve(1)
    np.testing.assert_array_equal(rows.get(count) if count else np.zeros((0, 2, 3), np.float32), values)
    back = rows.get(np.arange(count)[::-1])
    np.testing.assert_array_equal(back, values[::-1])
