"""Warp, quiet and announced: its import, its compilation, and launches on several CPU threads."""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

SMALLEST_PART = 16
"""Threads are not worth their start for fewer candidates than this."""


@cache
def warp() -> Any:
    """The module ``warp``, without its greeting."""
    import warp as wp

    wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)
    with _quiet():
        wp.init()
    if not any(Path(wp.config.kernel_cache_dir).glob("*preshape.kernels.closing.warp*")):
        print("compiling the kernels for this machine, once: about 20 s ...", file=sys.stderr, flush=True)
    return wp


@contextmanager
def _quiet() -> Iterator[None]:
    """Standard error thrown away: Warp's library tells a machine without a GPU so, whatever the log level."""
    sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:  # no standard error at all
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def usable_threads(device: str) -> int:
    """How many CPU threads a launch is split over: Warp itself uses one; a GPU needs no help."""
    return len(os.sched_getaffinity(0)) if device == "cpu" else 1


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="preshape-kernel")


def part_count(count: int, threads: int) -> int:
    """Into how many parts :func:`in_parts` cuts ``count``."""
    parts = max(1, min(threads, count // SMALLEST_PART))
    # More parts than threads: candidates differ in what they cost.
    return 1 if parts == 1 else 2 * parts


def in_parts(launch: Callable[[int, int], None], count: int, threads: int) -> None:
    """Call ``launch(first, size)`` for parts that cover ``count``, side by side.

    Args:
        launch: starts at ``first`` and does ``size``.
        count: how many there are in all.
        threads: how many parts at most.
    """
    parts = part_count(count, threads)
    if parts == 1:
        if count:
            launch(0, count)
        return
    edges = [count * k // parts for k in range(parts + 1)]
    left = deque(pairwise(edges))

    def work() -> None:
        while left:
            try:
                first, end = left.popleft()
            except IndexError:  # another was quicker
                return
            launch(first, end - first)

    helpers = [_pool(threads).submit(work) for _ in range(min(threads, parts) - 1)]
    try:
        work()
        for helper in helpers:
            helper.result()
    finally:  # interrupted or not, nobody writes on when this returns
        left.clear()
        wait(helpers)
