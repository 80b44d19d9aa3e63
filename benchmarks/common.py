"""What the benchmarks share: timing, the object that they plan for, and rows of the table."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from preshape.hands.load import load_hand
from preshape.hiis.analyser import HandLayout
from preshape.objects.load import load_object
from preshape.objects.mesh import TriangleMesh
from preshape.planning.controllers import layout_of
from preshape.planning.request import RAY_HAND


def median_of(work: Callable[[], Any], repeats: int) -> float:
    """Median time of one call [s]; a first call is not counted."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def scan() -> tuple[TriangleMesh, str]:
    """A scan of 16 000 triangles, or the library's dolphin where the reference data are missing."""
    folder = os.environ.get("PRESHAPE_REFERENCE", "")
    mug = Path(folder) / "ycb" / "mug.obj"
    if folder and mug.is_file():
        return load_object(mug), "scanned mug"
    return load_object("dolphin"), "dolphin"


def layout() -> HandLayout:
    """What the ray analyser needs to know of the paper's hand."""
    return layout_of(load_hand(RAY_HAND))


def row(
    name: str, value: float, unit: str, target: float | None, baseline: str | None, ok: bool
) -> dict[str, Any]:
    """One row of the table.

    Args:
        name: What was measured.
        value: The measured value; less is better.
        unit: Its unit.
        target: Value that should not be exceeded; ``None`` for none.
        baseline: Something measured in the same run for comparison.
        ok: Whether the answers were right.
    """
    return {"name": name, "value": value, "unit": unit, "target": target, "baseline": baseline, "ok": ok}
