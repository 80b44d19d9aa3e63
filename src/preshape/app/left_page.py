"""What a page leaves when its connection ends: it is the same again after a reload or a lost connection.

A page has a random number, which its browser keeps for one tab and sends with its connection. Only values are
kept for it: its planner process ends with the connection.
"""

from __future__ import annotations

import re
import threading
from contextvars import ContextVar
from dataclasses import replace
from typing import Any
from urllib.parse import parse_qs

from ..pictures import Document
from ..planning.request import PlanRequest
from ..types import value
from .physics_player import Run
from .uploads import Uploads

KEPT = 600.0
"""Time for which a page is kept after its connection has ended [s]."""
PAGE: ContextVar[str] = ContextVar("PAGE", default="")
"""Number of the page whose connection this task serves; empty for a page without one."""


@value
class LeftPage:
    """A page as it was.

    Attributes:
        request: The request in its panel.
        object_label: Name of its object in the list of objects.
        document: Its plan; ``None`` if it has none.
        rays: The rays of each answer.
        shown: Index of the answer that is shown.
        rejected: Indices of the rejected answers.
        deadlock: Whether a deadlock waits for its reset.
        work: ``plan`` or ``teach`` if that was in progress, else empty.
        run: The run in simulated physics that is shown.
        uploads: Its uploaded files, shared with other holders.
        uploaded: Place of each uploaded file by its name in the list of objects.
    """

    request: PlanRequest
    object_label: str
    document: Document | None
    rays: tuple[Any, ...]
    shown: int
    rejected: frozenset[int]
    deadlock: bool
    work: str
    run: Run | None
    uploads: Uploads
    uploaded: tuple[tuple[str, str], ...]

    def shared(self) -> LeftPage:
        """The same for another holder, who closes its ``uploads``."""
        return replace(self, uploads=self.uploads.shared())


class LeftPages:
    """The pages whose connection has ended, each for ``KEPT`` seconds.

    Args:
        most: Largest number of pages; the one that left first gives way.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._lock = threading.Lock()
        self._pages: dict[str, tuple[LeftPage, threading.Timer]] = {}

    def keep(self, page: str, left: LeftPage) -> None:
        """Keep a page in place of what it left before."""
        timer = threading.Timer(KEPT, lambda: self.drop(page, left))
        timer.daemon = True
        self.drop(page)
        with self._lock:
            self._pages[page] = left, timer
            first = next(iter(self._pages)) if len(self._pages) > self._most else ""
        timer.start()
        if first:
            self.drop(first)

    def get(self, page: str) -> LeftPage | None:
        """What a page has left, shared; it stays kept."""
        with self._lock:
            found = self._pages.get(page)
            return found[0].shared() if found else None

    def drop(self, page: str, only: LeftPage | None = None) -> None:
        """Forget a page and delete its uploads.

        Args:
            page: Number of the page.
            only: If given, do nothing unless this is what is kept.
        """
        with self._lock:
            found = self._pages.get(page)
            if found is None or (only is not None and found[0] is not only):
                return
            del self._pages[page]
        found[1].cancel()
        found[0].uploads.close()

    def close(self) -> None:
        """Forget all pages."""
        with self._lock:
            pages = list(self._pages)
        for page in pages:
            self.drop(page)


def page_number(path: str) -> str:
    """The page's number in the address of a connection; empty without one.

    >>> page_number("/?page=" + 32 * "a")[:4], page_number("/?page=../../x")
    ('aaaa', '')
    """
    given = parse_qs(path.partition("?")[2]).get("page", [""])[0]
    return given if re.fullmatch("[0-9a-f]{32}", given) else ""
