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
from preshape.planner import layout_of


def median_of(work: Callable[[], Any], repeats: int) -> float:
    """Median seconds of one call, after one that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def scan() -> tuple[TriangleMesh, str]:
    """A 16 k-triangle scan, or the library's dolphin where the reference data are missing."""
    folder = os.environ.get("PRESHAPE_REFERENCE", "")
    mug = Path(folder) / "ycb" / "mug.obj"
    if folder and mug.is_file():
        return load_object(mug), "scanned mug"
    return load_object("dolphin"), "dolphin"


def layout() -> HandLayout:
    return layout_of(load_hand("utah_mit"))


def row(
    name: str, value: float, unit: str, target: float | None, baseline: str | None, ok: bool
) -> dict[str, Any]:
    return {"name": name, "value": value, "unit": unit, "target": target, "baseline": baseline, "ok": ok}
