"""Decides which requests reach the app: of its own pages only, with its token, while there is room for more.

A page of another site must not drive the app through the user's browser. So a request must name this machine
(``Host``), and where a browser says which page asks (``Origin``), that must be a page of the same address.
Where other machines can reach the app, a request must also carry the token that is printed with the address:
first as ``?token=``, then as a cookie.
"""

from __future__ import annotations

import contextlib
import ipaddress
import re
import secrets
from collections.abc import Iterator
from html import escape
from http import HTTPStatus
from typing import Any, Literal
from urllib.parse import parse_qs

HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Headers of every response: no other site shows the app in a frame, and no link tells the address to one."""
RETRY = 3
"""Time after which a page that found no room asks again [s]."""
_PAGE = (
    '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>preshape</title>{head}<style>'
    "body{{font:16px/1.5 sans-serif;max-width:36em;margin:15vh auto;padding:0 1em}}</style></head>"
    "<body><h1>{title}</h1><p>{words}</p></body></html>"
)
_ASK_FOR_TOKEN = (
    "preshape view prints its address with a token; open that address, or enter the token here.</p>"
    '<form action="/"><input name="token" aria-label="token" autofocus> <button>Open</button></form><p>'
)
_REFUSED = {
    "host": ("Wrong address", "Open the address that preshape view has printed."),
    "origin": ("Another page", "Only the app's own page may use the app."),
    "token": ("A token is needed", _ASK_FOR_TOKEN),
}
WILDCARDS = ("", "0.0.0.0", "::")
"""Addresses that stand for all of this machine."""
Fault = Literal["host", "origin", "token"]


class Gate:
    """The door of one server.

    Args:
        host: Address that the server listens on.
        port: Port that the server listens on.
        limit: Largest number of pages that are open at the same time.

    Attributes:
        token: What a request must show; ``None`` on loopback.
        address: The address to open in a browser, with the token if one is needed.
    """

    def __init__(self, host: str, port: int, limit: int) -> None:
        self.token = None if is_loopback(host) else secrets.token_urlsafe(24)
        name = "localhost" if host in (*WILDCARDS, "127.0.0.1") else host
        token = f"/?token={self.token}" if self.token else ""
        self.address = f"http://{f'[{name}]' if ':' in name else name}:{port}{token}"
        self.limit = limit
        self._cookie = f"preshape-{port}"
        self._open = 0

    @property
    def full(self) -> bool:
        """Whether as many pages are open as may be."""
        return self._open >= self.limit

    @property
    def full_words(self) -> str:
        """Why there is no room, in one sentence of at most 120 letters."""
        return f"{self.limit} pages are open, which is the limit (--sessions); close one of them"

    @contextlib.contextmanager
    def place(self) -> Iterator[None]:
        """Count a page as open for the length of a ``with`` block."""
        self._open += 1
        try:
            yield
        finally:
            self._open -= 1

    def answer(self, request: Any) -> Any:
        """The answer to a request that does not reach the app, or ``None`` if it does.

        Args:
            request: A ``websockets`` request for a page or a websocket.
        """
        headers = request.headers
        query = request.path.partition("?")[2]
        given = [*parse_qs(query).get("token", []), *self._kept(headers)]
        fault = self.fault(headers.get_all("Host"), headers.get_all("Origin"), given)
        if fault is not None:
            return _refusal(*_REFUSED[fault])
        if "Upgrade" in headers:
            return None  # a websocket that finds no room is told so after its handshake, and shows it
        if query:
            # viser's page would let a link name another server, which may run scripts in the page.
            moved = response(HTTPStatus.FOUND, "", Location="/")
            if self.token is not None:
                moved.headers["Set-Cookie"] = f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Lax"
            return moved
        if self.full:
            words = f"{escape(self.full_words)}. This page then opens by itself."
            refresh = f'<meta http-equiv="refresh" content="{RETRY}">'
            return response(HTTPStatus.SERVICE_UNAVAILABLE, _page("Too many pages", words, refresh))
        return None

    def fault(self, hosts: list[str], origins: list[str], tokens: list[str]) -> Fault | None:
        """What a request is refused for: its name of this machine, its page, or its token; else ``None``.

        Args:
            hosts: The contents of the request's headers ``Host``.
            origins: The contents of its headers ``Origin``.
            tokens: The tokens that it carries.
        """
        named = [host.lower() for host in hosts]
        if len(named) != 1 or (self.token is None and not is_loopback(_name(named[0]))):
            return "host"
        own = (f"http://{named[0]}", f"https://{named[0]}")
        if any(origin.lower() not in own for origin in origins):
            return "origin"
        return "token" if self.token is not None and not self._known(tokens) else None

    def _kept(self, headers: Any) -> list[str]:
        """The tokens among a request's cookies."""
        pairs = [
            part.strip().partition("=") for line in headers.get_all("Cookie") for part in line.split(";")
        ]
        return [content for name, _, content in pairs if name == self._cookie]

    def _known(self, given: list[str]) -> bool:
        wanted = str(self.token).encode()
        return any(secrets.compare_digest(one.encode("utf-8", "replace"), wanted) for one in given)


def is_loopback(host: str) -> bool:
    """Whether a host's address or name can be reached from this machine only.

    >>> [is_loopback(host) for host in ("localhost", "127.0.0.2", "::1", "0.0.0.0", "example.org")]
    [True, True, True, False, False]
    """
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def response(status: HTTPStatus, page: str, **headers: str) -> Any:
    """A ``websockets`` response with a page of HTML."""
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    body = page.encode()
    content = {"Content-Type": "text/html; charset=utf-8", "Content-Length": str(len(body))}
    return Response(int(status), status.phrase, Headers({**content, **headers}), body)


def _refusal(title: str, words: str) -> Any:
    return response(HTTPStatus.FORBIDDEN, _page(title, words))


def _page(title: str, words: str, head: str = "") -> str:
    return _PAGE.format(head=head, title=title, words=words)


def _name(host: str) -> str:
    """The name in a ``Host`` header, without port and brackets."""
    return re.sub(r":\d+$", "", host).removeprefix("[").removesuffix("]")
