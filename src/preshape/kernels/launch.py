"""Use of Warp: silent import, and kernel launches on several CPU threads."""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from itertools import pairwise
from typing import Any

from ..exceptions import EnvironmentFailure
from ..files import spare_folder
from ..processes import usable_cores

SMALLEST_PART = 16
"""Least number of candidates per thread for which starting a further thread pays off."""


@cache
def warp() -> Any:
    """The module ``warp``, without its greeting."""
    import warp as wp

    wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)
    # An interrupted compilation would leave them among the temporary files; they save 0.2 s for each module.
    # Kernels are named by this setting too, so it holds for the whole process.
    wp.config.use_precompiled_headers = False
    try:
        with _no_standard_error():
            wp.init()
    except OSError as error:
        usual, spare = error.filename, spare_folder("kernels")
        if not spare.is_dir():
            raise EnvironmentFailure(
                f"no folder for compiled kernels: {usual} cannot be made ({error.strerror}), nor one in "
                f"{spare.parent}; set WARP_CACHE_PATH to a folder that can be written"
            ) from error
        announce(f"compiled kernels cannot be kept in {usual}; they are kept in {spare}")
        wp.config.kernel_cache_dir = str(spare)
        with _no_standard_error():
            wp.init()
    return wp


@cache
def announce(sentence: str) -> None:
    """Say something on standard error, once."""
    print(sentence, file=sys.stderr, flush=True)


@contextmanager
def _no_standard_error() -> Iterator[None]:
    """Discard standard error: on a machine without a GPU Warp's library writes there at any log level."""
    sys.stderr.flush()
    try:
        original = os.dup(2)
    except OSError:  # there is no standard error
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(original, 2)
        os.close(original)
        os.close(nowhere)


def usable_threads(device: str) -> int:
    """Number of CPU threads for a launch: one per core on the CPU, where Warp uses one; 1 for a GPU."""
    return usable_cores() if device == "cpu" else 1


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="preshape-kernel")


def part_count(count: int, threads: int) -> int:
    """Number of parts into which :func:`in_parts` cuts ``count`` candidates."""
    parts = max(1, min(threads, count // SMALLEST_PART))
    # Twice as many parts as threads, because candidates take different times.
    return 1 if parts == 1 else 2 * parts


def in_parts(launch: Callable[[int, int], None], count: int, threads: int) -> None:
    """Call ``launch(first, size)`` for parts that together cover ``count`` candidates, on several threads.

    Args:
        launch: Processes ``size`` candidates from number ``first`` on.
        count: Number of candidates.
        threads: Largest number of threads.
    """
    parts = part_count(count, threads)
    if parts == 1:
        if count:
            launch(0, count)
        return
    edges = [count * k // parts for k in range(parts + 1)]
    pending = deque(pairwise(edges))

    def work() -> None:
        while pending:
            try:
                first, end = pending.popleft()
            except IndexError:  # another thread took the last part
                return
            launch(first, end - first)

    helpers = [_pool(threads).submit(work) for _ in range(min(threads, parts) - 1)]
    try:
        work()
        for helper in helpers:
            helper.result()
    finally:  # even if interrupted, no thread writes after the return
        pending.clear()
        wait(helpers)
