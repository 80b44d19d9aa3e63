"""Worker processes: how many, and a pool whose workers ignore Ctrl-C and end with the calling process."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TypeVar

from .exceptions import InputError, shown

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor
    from multiprocessing.connection import Connection

R = TypeVar("R")


def usable_cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def process_count(workers: int | None) -> int:
    """Number of processes for an option: ``workers``, or one for each core where it is ``None``.

    Raises:
        InputError: ``workers`` is below 1.
    """
    if workers is not None and workers < 1:
        raise InputError(f"workers must be 1 or more, got {shown(workers)}")
    return workers or usable_cores()


@contextmanager
def worker_pool(
    workers: int, setup: Callable[..., None] | None = None, arguments: tuple[Any, ...] = ()
) -> Iterator[ProcessPoolExecutor]:
    """A pool of worker processes for the length of a ``with`` block.

    Only the calling process receives Ctrl-C. An exception that leaves the block ends the workers at once, and
    what they were computing is lost; they also end when the calling process is killed.

    Args:
        workers: Number of processes.
        setup: Called once in each worker before its first job, with ``arguments``.
        arguments: Values that can be pickled.
    """
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    # Processes are spawned, not forked: this works on every system and beside threads of the caller.
    context = get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(
        workers, mp_context=context, initializer=_start_worker, initargs=(reader, setup, arguments)
    )
    try:
        yield pool
    except BaseException:
        writer.close()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        writer.close()
        reader.close()


def submit_all(
    pool: ProcessPoolExecutor, function: Callable[..., R], *arguments: Iterable[Any]
) -> list[Future[R]]:
    """Submit ``function`` once for each tuple of arguments, as ``map`` calls it."""
    with _interrupts_held_back():  # the workers start here
        return [pool.submit(function, *each) for each in zip(*arguments, strict=False)]


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Hold Ctrl-C back while workers start; they inherit this, so only the calling process receives it."""
    if not hasattr(signal, "pthread_sigmask") or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)  # one that came meanwhile arrives now


def _start_worker(
    lifeline: Connection, setup: Callable[..., None] | None, arguments: tuple[Any, ...]
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_exit_with, args=(lifeline,), daemon=True).start()
    if setup is not None:
        setup(*arguments)


def _exit_with(lifeline: Connection) -> None:
    """End this worker when the other end closes: the run was stopped, or the calling process has ended."""
    with suppress(EOFError, OSError):
        lifeline.recv_bytes()
    os._exit(1)
