"""The sessions of all browsers: each ends with its connection, however early that closes."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

from .browser_session import BrowserSession, Start

if TYPE_CHECKING:
    import viser

THREADS = 8
"""Number of sessions that are made or closed at the same time."""


class Sessions:
    """Makes a session for each connection and closes it when the connection closes.

    A connection may close while its session is being made. So what is stored for a connection is a future,
    from the moment at which the connection is known.

    Args:
        start: What a browser shows first.
    """

    def __init__(self, start: Start) -> None:
        self._start = start
        self._pool = ThreadPoolExecutor(THREADS, thread_name_prefix="session")
        self._lock = threading.Lock()
        self._made: dict[int, Future[BrowserSession]] = {}
        self._open = True

    async def begin(self, client: viser.ClientHandle) -> None:
        """Begin to make the session of a new connection."""
        with self._lock:
            if self._open:
                self._made[client.client_id] = self._pool.submit(self._make, client)

    async def end(self, client: viser.ClientHandle) -> None:
        """Close the session of a connection that has closed; returns when its planner has ended."""
        with self._lock:
            made = self._made.pop(client.client_id, None)
        if made is not None:
            await asyncio.get_running_loop().run_in_executor(self._pool, _close, made)

    def _make(self, client: viser.ClientHandle) -> BrowserSession:
        try:
            return BrowserSession(client, self._start)
        except Exception as error:
            fault = f"{type(error).__name__}: {error}; please report it"
            client.add_notification("Internal fault", fault, color="red")
            raise

    def close(self) -> None:
        """Close all sessions for good."""
        with self._lock:
            self._open = False
            all_made, self._made = list(self._made.values()), {}
        for made in all_made:
            _close(made)


def _close(made: Future[BrowserSession]) -> None:
    """Close a session, or cancel it if nobody has begun to make it."""
    if not made.cancel():
        with contextlib.suppress(Exception):  # a session that could not be made has nothing to close
            made.result().close()
