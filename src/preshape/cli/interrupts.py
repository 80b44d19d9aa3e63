"""Ctrl-C and SIGTERM: the process ends at once, with one line and exit code 130.

Python raises ``KeyboardInterrupt`` wherever the main thread is. An import, a destructor or a callback may
swallow it, a module written in C++ may abort, and a long call into C is not interrupted at all. Therefore
the signal raises nothing here: a thread that waits for signals writes the line, removes temporary files and
ends the process. This loses nothing that was acknowledged, because memory and files are written whole or not
at all (``python -m hardening.kill`` and ``python -m hardening.signals`` test it).

Commands that finish their current work first say so with :func:`patient`.

Before this guard starts, :mod:`.early` ends the process in the main thread.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from .early import EXIT_INTERRUPTED, tell

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
PATIENCE = 1.0
"""Longest time that the end waits for a document which is being written, and shortest time between a first
signal and a second one, where the first is to be handled with patience [s]."""

output = threading.RLock()
"""Held while a command writes its one JSON document, so that it is never cut short by another."""


class _Guard:
    """What the guard has to know; there is one guard in a process."""

    installed = False
    as_json = False
    answered = False
    pending = False
    raised = -PATIENCE
    passed_on = 0
    out, err = 1, 2


def install(as_json: bool) -> None:
    """Start the guard; call it once, from the main thread of a command line.

    Args:
        as_json: Whether the one JSON document on standard output must then be the error object.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    _Guard.installed, _Guard.as_json = True, as_json
    # Libraries' own messages are discarded by moving descriptor 2 elsewhere for a while.
    _Guard.out, _Guard.err = os.dup(1), os.dup(2)
    # First the pipe: a signal between these lines is then kept for the thread.
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup and shells ask for
            signal.signal(number, _at_once)
    threading.Thread(target=_watch, args=(reader,), name="preshape-signals", daemon=True).start()


def finished() -> None:
    """Ignore signals from now on: the answer is complete, and only Python's own end follows."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def answered() -> None:
    """State that the one JSON document has been written."""
    _Guard.answered = True


def swallowed() -> bool:
    """Whether a signal arrived in a :func:`patient` block; code in between may have lost its exception."""
    return _Guard.pending


@contextmanager
def patient() -> Iterator[None]:
    """Within this block the first signal raises ``KeyboardInterrupt``; a second one ends the process at once.

    A signal during an import ends the process at once, because imports do not survive exceptions.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _Guard.pending = False
    hang_up = getattr(signal, "SIGHUP", signal.SIGTERM)  # a terminal that is closed
    before = {number: signal.getsignal(number) for number in (*SIGNALS, hang_up)}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN and (_Guard.installed or number == signal.SIGINT):
            signal.signal(number, _raise)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _at_once(number: int, frame: FrameType | None) -> None:
    """Do nothing: the thread of the guard has been told too, and ends the process."""


def _raise(number: int, frame: FrameType | None) -> None:
    _Guard.pending, _Guard.raised = True, time.monotonic()
    if _Guard.installed:
        for each in SIGNALS:
            signal.signal(each, _at_once)
        if _importing(frame):
            _end()
    raise KeyboardInterrupt


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _watch(reader: int) -> None:
    """Wait for signals; one whose handler is not this module's is left to that handler.

    The system may hand a signal to any thread, and does so if the main thread is slow to wake while another
    one is just being started. Python's handler then waits for the main thread, which sleeps on. So a signal
    for a :func:`patient` block is passed on to the main thread itself.
    """
    main = threading.main_thread().ident
    while number := os.read(reader, 1):
        handler = signal.getsignal(number[0])
        if _Guard.passed_on:
            _Guard.passed_on -= 1  # this is the same signal again
        elif handler is _raise and main is not None and hasattr(signal, "pthread_kill"):
            _Guard.passed_on += 1
            signal.pthread_kill(main, number[0])
        # The thread may come late and find the handler that follows on the one of a patient block.
        elif handler is _at_once and time.monotonic() - _Guard.raised > PATIENCE:
            _end()


def _end() -> None:
    output.acquire(timeout=PATIENCE)
    tell(_Guard.out, _Guard.err, _Guard.as_json and not _Guard.answered)
    with suppress(Exception):
        files = sys.modules.get("preshape.files")
        if files is not None:
            files.remove_temporaries()
    os._exit(EXIT_INTERRUPTED)
