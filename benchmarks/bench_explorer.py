"""The explorer of the ray analyser: 12 planes × 64 approach values × 3 finger counts × 2 thumb sides."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from preshape.hiis.analyser import Aim
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.kernels.rays import cast_plain
from preshape.tasks import parse_task

from .common import layout, median_of, row, scan


def run() -> list[dict[str, Any]]:
    mesh, name = scan()
    q = parse_task("pour").q
    values = np.linspace(-0.95, 0.95, 64)
    hand = layout()

    def explore() -> Any:
        analyser.forget()  # the cache of the last aim
        return analyser.explore(q, Aim(values=values))

    analyser = RayAnalyser(mesh, hand)
    found = explore()
    seconds = median_of(explore, 15)

    # The plain version casts every ray against every triangle; a sixteenth of the values shows its speed.
    few = values[::16]
    plain = RayAnalyser(mesh, hand, cast=lambda o, d: cast_plain(mesh, o, d))
    start = time.perf_counter()
    expected = plain.explore(q, Aim(values=few))
    plain_seconds = (time.perf_counter() - start) * len(values) / len(few)
    fast = RayAnalyser(mesh, hand).explore(q, Aim(values=few))
    same = (
        len(fast) == len(expected)
        and bool(np.allclose(fast.match, expected.match, atol=1e-9))
        and len(found) > 0
    )
    what = f"explorer, {len(mesh.triangles)} triangles ({name}), {found.tried} aims"
    base = f"plain version {plain_seconds:.2g} s, ratio {plain_seconds / seconds:.0f}"
    return [row(what, 1e3 * seconds, "ms", 20.0, base, same)]
