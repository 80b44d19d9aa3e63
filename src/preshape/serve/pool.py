"""The server's planner processes: who is free, how many may wait, time limits, and cancellation."""

from __future__ import annotations

import queue
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from ..app.link import PlannerLink, Reply
from ..exceptions import Cancelled, EnvironmentFailure

REMEMBERED = 16
"""Number of requests for which it is known which process has them prepared."""
WATCH = 0.1
"""Time between two looks whether the client is still there [s]."""


class PoolBusy(EnvironmentFailure):
    """As many requests wait as may, or a request has waited for too long."""


class OutOfTime(EnvironmentFailure):
    """The answer took longer than the limit; the planner process was ended, and another one starts."""


class _Seat:
    """One planner process, and what it has prepared."""

    def __init__(self, program: Sequence[str]) -> None:
        self.link = PlannerLink(self._heard, program)
        self.replies: queue.SimpleQueue[Reply] = queue.SimpleQueue()
        self.prepared: OrderedDict[str, None] = OrderedDict()
        self.free = True

    def _heard(self, reply: Reply) -> None:
        self.replies.put(reply)


class PlannerPool:
    """Warm planner processes; each works on one message at a time.

    Args:
        program: Module of a planner process, and its arguments.
        workers: Number of processes.
        waiting: Largest number of messages that wait for a free process.

    Raises:
        EnvironmentFailure: The system refuses a process.
    """

    def __init__(self, program: Sequence[str], workers: int, waiting: int) -> None:
        self._seats = [_Seat(program) for _ in range(workers)]
        self._most_waiting, self._waiting, self._open = waiting, 0, True
        self._changed = threading.Condition()
        try:
            for seat in self._seats:
                seat.link.start()
        except EnvironmentFailure:
            self.close()
            raise

    @property
    def state(self) -> dict[str, int]:
        """Number of processes, of those at work, and of messages that wait."""
        with self._changed:
            busy = sum(not seat.free for seat in self._seats)
            return {"workers": len(self._seats), "busy": busy, "waiting": self._waiting}

    def replies(
        self,
        message: dict[str, Any],
        *,
        key: str,
        seconds: float,
        gone: Callable[[], bool],
        waits: bool = True,
    ) -> Generator[Reply]:
        """The replies to a message, the last with ``done`` or ``error``.

        If nobody takes them to the end, the work is cancelled.

        Args:
            message: The message, with its kind of work as ``do``.
            key: What the message is about; a process that has it prepared is preferred.
            seconds: Time limit for waiting and work together [s].
            gone: Whether the client has left.
            waits: Whether to wait if no process is free.

        Raises:
            PoolBusy: There is no free process in time, and too many wait.
            OutOfTime: The work took too long.
            Cancelled: The client has left, or the pool was closed.
            EnvironmentFailure: The system refuses another process.
        """
        end = time.monotonic() + seconds
        with self._seat(key, end, gone, self._most_waiting if waits else 0) as seat:
            number, last = seat.link.ask(**message), False
            try:
                while not last:
                    try:
                        reply = seat.replies.get(timeout=WATCH)
                    except queue.Empty:
                        if gone() or not self._open:
                            raise Cancelled("cancelled; everything that was acknowledged is kept") from None
                        if time.monotonic() > end:
                            raise OutOfTime(
                                f"no answer within {seconds:g} s (--timeout); ask for less"
                            ) from None
                        continue
                    if reply.pop("id", None) == number:
                        last = "done" in reply or "error" in reply
                        yield reply
            finally:
                if not last:
                    seat.link.cancel()
                    seat.prepared.clear()

    @contextmanager
    def _seat(self, key: str, end: float, gone: Callable[[], bool], most: int) -> Iterator[_Seat]:
        """A free process for the length of a ``with`` block."""
        seat = self._free(key)
        if seat is None:
            with self._changed:
                if self._waiting >= most:
                    raise PoolBusy(
                        f"{self._waiting} requests are waiting, which is the limit; ask again later"
                    )
                self._waiting += 1
                try:
                    while (seat := self._free(key)) is None:
                        self._changed.wait(WATCH)
                        if gone() or not self._open:
                            raise Cancelled("cancelled; nothing was begun")
                        if time.monotonic() > end:
                            raise PoolBusy("all planners are busy; ask again later")
                finally:
                    self._waiting -= 1
        try:
            yield seat
        finally:
            with self._changed:
                seat.prepared.pop(key, None)
                seat.prepared[key] = None
                while len(seat.prepared) > REMEMBERED:
                    seat.prepared.popitem(last=False)
                seat.free = True
                self._changed.notify()

    def _free(self, key: str) -> _Seat | None:
        """Take a free process: one that has prepared this, or else the one that has least prepared."""
        with self._changed:
            free = [seat for seat in self._seats if seat.free]
            if not free:
                return None
            seat = min(free, key=lambda seat: (key not in seat.prepared, len(seat.prepared)))
            seat.free = False
            return seat

    def close(self) -> None:
        """End all processes at once, for good."""
        with self._changed:
            self._open = False
            self._changed.notify_all()
        for seat in self._seats:
            seat.link.close()
