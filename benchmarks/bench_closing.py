"""Closing and margin kernels: candidates per second for several hands and objects.

The table shows the time of one candidate, so that less is better as in every row; the name of the row has
the rate. Every row also runs the plain version on some of the candidates and compares the results.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from preshape.closure.candidates import Region, draw_candidates
from preshape.closure.hand_tables import hand_tables
from preshape.closure.preshapes import preshapes
from preshape.hands.load import load_hand
from preshape.kernels.closing.host import ClosingKernel, Closings, Fate
from preshape.kernels.closing.plain import close_plain
from preshape.kernels.field.host import prepare_field
from preshape.kernels.margin.host import margins
from preshape.kernels.margin.plain import SoftContacts, margin_plain
from preshape.objects.library import load_library_object
from preshape.processes import usable_cores

from .common import median_of, row

OBJECTS = ("mug", "cube", "hammer", "bottle")
CANDIDATES, PLAIN_CLOSINGS, PLAIN_MARGINS = 3000, 250, 12
"""Candidates of each object, those closed by the plain version, and those with a margin by the plain
version."""
FRICTION, TORSION = 0.36, 0.0072
"""Sliding friction and torsional friction [m] of the margins."""
HOLD = np.concatenate([np.eye(6), -np.eye(6)])
"""Wrenches of the margins: forces along the axes and torques about them."""
CLOSING_TARGET, MARGIN_TARGET = 1e6 / 40_000, 1e6 / 20_000
"""Target times of one candidate on two threads [µs]."""


def run() -> list[dict[str, Any]]:
    threads = min(2, usable_cores())
    rows = []
    for name in ("shadow", "allegro", "leap"):
        target = CLOSING_TARGET if name == "shadow" else None
        for count in dict.fromkeys((threads, 1)):
            rows.append(_closing(name, count, target if count == 2 else None))
        rows.append(
            _with_margins(name, threads, MARGIN_TARGET if name == "shadow" and threads == 2 else None)
        )
    return rows


class _Scenes:
    """A hand before each of the objects."""

    def __init__(self, name: str, threads: int) -> None:
        self.threads, hand = threads, load_hand(name)
        self.tables, pool = hand_tables(hand), preshapes(hand)
        self.meshes = [load_library_object(one) for one in OBJECTS]
        self.fields = [prepare_field(mesh) for mesh in self.meshes]
        self.kernels = [ClosingKernel(self.tables, field, threads=threads) for field in self.fields]
        self.given = [
            draw_candidates(
                np.random.default_rng(0),
                pool,
                mesh.bounds.mean(axis=0),
                mesh.extents / 2,
                CANDIDATES,
                Region(),
            ).candidates
            for mesh in self.meshes
        ]

    def close(self) -> list[Closings]:
        return [kernel.close(given) for kernel, given in zip(self.kernels, self.given, strict=True)]

    def resist(self) -> list[Any]:
        return [
            _margins(closed, np.flatnonzero(closed.fate == Fate.CLOSED), mesh, self.threads)
            for closed, mesh in zip(self.close(), self.meshes, strict=True)
        ]

    def plain(self, index: int) -> tuple[Closings, float]:
        """The plain version's closings of a few candidates, and its seconds."""
        few = self.given[index].take(np.arange(PLAIN_CLOSINGS))
        start = time.perf_counter()
        return close_plain(self.tables, self.fields[index], few), time.perf_counter() - start


def _closing(name: str, threads: int, target: float | None) -> dict[str, Any]:
    scenes = _Scenes(name, threads)
    total = CANDIDATES * len(OBJECTS)
    seconds = median_of(scenes.close, 5)
    same, plain_seconds, closed = True, 0.0, 0
    for index, fast in enumerate(scenes.close()):
        plain, spent = scenes.plain(index)
        plain_seconds += spent
        same &= _alike(fast, plain)
        closed += int((fast.fate == Fate.CLOSED).sum())
    what = (
        f"closing, {name}, {_threads(threads)}: {_rate(total / seconds)}, {100 * closed / total:.0f} % close"
    )
    return _row(
        what, seconds / total, plain_seconds / (PLAIN_CLOSINGS * len(OBJECTS)), target, same and closed > 0
    )


def _with_margins(name: str, threads: int, target: float | None) -> dict[str, Any]:
    scenes = _Scenes(name, threads)
    total = CANDIDATES * len(OBJECTS)
    seconds = median_of(scenes.resist, 5)
    same, plain_close, plain_margin, compared = True, 0.0, 0.0, 0
    closings = scenes.close()
    for index, (fast, mesh) in enumerate(zip(closings, scenes.meshes, strict=True)):
        plain, spent = scenes.plain(index)
        plain_close += spent
        same &= _alike(fast, plain)
        rows = np.flatnonzero(fast.fate == Fate.CLOSED)[:PLAIN_MARGINS]
        if not len(rows):
            continue
        compared += len(rows)
        found, length = _margins(fast, rows, mesh, threads), _length(mesh)
        start = time.perf_counter()
        for k, i in enumerate(rows):
            n = int(fast.counts[i])
            plain_margins = margin_plain(
                SoftContacts(
                    arms=(fast.points[i, :n].astype(np.float64) - mesh.cog) / length,
                    normals=fast.normals_in[i, :n].astype(np.float64),
                    mu=FRICTION,
                    gamma=TORSION / length,
                ),
                HOLD,
                np.zeros(6),
            )
            same &= (
                abs(float(found.strength[k]) - plain_margins.strength) <= 0.02 * plain_margins.strength + 1e-4
            )
        plain_margin += time.perf_counter() - start
    closed = sum(int((fast.fate == Fate.CLOSED).sum()) for fast in closings)
    plain_each = (
        plain_close / (PLAIN_CLOSINGS * len(OBJECTS)) + plain_margin / max(1, compared) * closed / total
    )
    what = f"closing and margins, {name}, {_threads(threads)}: {_rate(total / seconds)}"
    return _row(what, seconds / total, plain_each, target, same and compared > 0)


def _margins(closed: Closings, rows: Any, mesh: Any, threads: int) -> Any:
    return margins(
        closed.points[rows],
        closed.normals_in[rows],
        closed.counts[rows],
        wrenches=HOLD,
        friction=FRICTION,
        torsion=TORSION,
        length=_length(mesh),
        reference=mesh.cog,
        threads=threads,
    )


def _length(mesh: Any) -> float:
    return float(mesh.extents.max()) / 2


def _alike(fast: Closings, plain: Closings) -> bool:
    few = slice(0, len(plain.fate))
    same = fast.fate[few] == plain.fate
    both = same & (plain.fate == Fate.CLOSED)
    near = np.abs(fast.closing[few] - plain.closing)[both] < 1e-3
    return bool((~same).sum() <= 1 and near.mean() > 0.98) if both.any() else bool((~same).sum() <= 1)


def _threads(count: int) -> str:
    return "1 thread" if count == 1 else f"{count} threads"


def _rate(rate: float) -> str:
    return f"{rate:,.0f}/s".replace(",", " ")


def _row(what: str, each: float, plain: float, target: float | None, ok: bool) -> dict[str, Any]:
    base = f"plain version {1e3 * plain:.2g} ms, ratio {plain / each:.0f}"
    return row(what, 1e6 * each, "µs", target, base, ok)
