"""The sessions of all browsers: each ends with its connection, however early that closes.

What a page leaves is kept for a while, so that it is the same again after a reload or a lost connection.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

from .browser_session import BrowserSession, Start
from .left_page import PAGE, LeftPage, LeftPages

if TYPE_CHECKING:
    import viser

THREADS = 8
"""Number of sessions that are made or closed at the same time."""


class Sessions:
    """Makes a session for each connection and closes it when the connection closes.

    A connection may close while its session is being made. So what is stored for a connection is a future,
    from the moment at which the connection is known, until what its page leaves is kept.

    Args:
        start: What a browser shows first.
        most: Largest number of pages that are kept after their connection has closed.
    """

    def __init__(self, start: Start, most: int) -> None:
        self._start = start
        self._pool = ThreadPoolExecutor(THREADS, thread_name_prefix="session")
        self._lock = threading.Lock()
        self._made: dict[int, tuple[str, Future[BrowserSession]]] = {}
        self._left = LeftPages(most)
        self._open = True

    async def begin(self, client: viser.ClientHandle) -> None:
        """Begin to make the session of a new connection."""
        page = PAGE.get()
        with self._lock:
            if self._open:
                self._made[client.client_id] = page, self._pool.submit(self._make, client, page)

    async def end(self, client: viser.ClientHandle) -> None:
        """Close the session of a connection that has closed; returns when its planner has ended."""
        with self._lock:
            known = client.client_id in self._made
        if known:
            await asyncio.get_running_loop().run_in_executor(self._pool, self._leave, client.client_id)

    def _make(self, client: viser.ClientHandle, page: str) -> BrowserSession:
        try:
            return BrowserSession(client, self._start, self._found(page))
        except Exception as error:
            fault = f"{type(error).__name__}: {error}; please report it"
            client.add_notification("Internal fault", fault, color="red")
            raise

    def _found(self, page: str) -> LeftPage | None:
        """What a page has left, or what its connection shows that has not closed yet."""
        if not page:
            return None
        with self._lock:
            own = [made for number, made in self._made.values() if number == page and made.done()]
        for made in reversed(own):
            with contextlib.suppress(Exception):  # a session that could not be made leaves nothing
                return made.result().left()
        return self._left.get(page)

    def _leave(self, client_id: int) -> None:
        """Keep what a page leaves, and close its session."""
        with self._lock:
            page, made = self._made[client_id]
        if page and not made.cancel():
            with contextlib.suppress(Exception):
                left = made.result().left()
                if left is not None:
                    self._left.keep(page, left)
        with self._lock:
            self._made.pop(client_id, None)
            is_open = self._open
        _close(made)
        if not is_open:
            self._left.close()

    def close(self) -> None:
        """Close all sessions for good."""
        with self._lock:
            self._open = False
            all_made, self._made = [made for _, made in self._made.values()], {}
        for made in all_made:
            _close(made)
        self._left.close()


def _close(made: Future[BrowserSession]) -> None:
    """Close a session, or cancel it if nobody has begun to make it."""
    if not made.cancel():
        with contextlib.suppress(Exception):  # a session that could not be made has nothing to close
            made.result().close()
