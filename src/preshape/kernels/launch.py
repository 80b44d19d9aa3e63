"""Warp, quiet and announced: its import, its compilation, and launches on several CPU threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

SMALLEST_PART = 16
"""Threads are not worth their start for fewer candidates than this."""


@cache
def warp() -> Any:
    """The module ``warp``, without its greeting."""
    import warp as wp

    wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)
    wp.init()
    return wp


def usable_threads(device: str) -> int:
    """How many CPU threads a launch is split over: Warp itself uses one; a GPU needs no help."""
    return len(os.sched_getaffinity(0)) if device == "cpu" else 1


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="preshape-kernel")


def in_parts(launch: Callable[[int, int], None], count: int, threads: int) -> None:
    """Call ``launch(first, size)`` for parts that cover ``count``, side by side.

    Args:
        launch: starts at ``first`` and does ``size``.
        count: how many there are in all.
        threads: how many parts at most.
    """
    parts = max(1, min(threads, count // SMALLEST_PART))
    if parts == 1:
        if count:
            launch(0, count)
        return
    # More parts than threads: candidates differ in what they cost.
    edges = [count * k // (2 * parts) for k in range(2 * parts + 1)]
    tasks = [
        _pool(threads).submit(launch, first, end - first)
        for first, end in zip(edges[:-1], edges[1:], strict=True)
    ]
    for task in tasks:
        task.result()
