"""One connection of ``preshape serve``: requests within limits of size and time, answers in JSON."""

from __future__ import annotations

import io
import json
import math
import select
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from itertools import chain
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from .._version import __version__
from ..app.gate import HEADERS, Fault
from ..app.uploads import LARGEST
from ..exceptions import Cancelled, EnvironmentFailure, InputError, PreshapeError, shown
from ..files import loads
from .openapi import document, page
from .pool import OutOfTime, PoolBusy

if TYPE_CHECKING:
    from .server import Desk

LARGEST_REQUEST = 2**20
"""Largest request [bytes]."""
PATIENCE, SLOWEST = 30.0, 2**17
"""Time for the head of a request, for the pause before it and for each write [s], and the least mean speed of
a body after as much time [bytes/s]."""
_PART = 2**16
_FAULTS: dict[Fault, tuple[HTTPStatus, str]] = {
    "host": (HTTPStatus.FORBIDDEN, "use the address that preshape serve has printed"),
    "origin": (HTTPStatus.FORBIDDEN, "pages of other sites may not use this server"),
    "token": (
        HTTPStatus.UNAUTHORIZED,
        "a token is needed: send the one that preshape serve has printed as Authorization: Bearer TOKEN",
    ),
}


class Refusal(Exception):
    """A request that is answered with an error.

    Args:
        status: The status of the answer.
        reason: One sentence.
        headers: Further headers of the answer.
    """

    def __init__(self, status: HTTPStatus, reason: str, **headers: str) -> None:
        super().__init__(reason)
        self.status, self.reason, self.headers = status, reason, headers


class _TimedReader(io.RawIOBase):
    """What comes from a socket, up to a point in time."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self.end = 0.0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        left = self.end - time.monotonic()
        if left <= 0:
            raise TimeoutError
        self._connection.settimeout(left)
        try:
            return self._connection.recv_into(buffer)
        finally:
            self._connection.settimeout(PATIENCE)


class Handler(BaseHTTPRequestHandler):
    """Answers the requests of one connection, one after the other."""

    protocol_version, default_request_version = "HTTP/1.1", "HTTP/1.0"
    server_version, sys_version = f"preshape/{__version__}", ""
    timeout = PATIENCE
    wbufsize = -1  # an answer leaves as one piece
    server: Any

    @property
    def desk(self) -> Desk:
        """What all connections share."""
        desk: Desk = self.server.desk
        return desk

    def setup(self) -> None:
        """Put a limit of time on what is read."""
        super().setup()
        if self.connection.family != getattr(socket, "AF_UNIX", None):
            self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, True)
        self._timed = _TimedReader(self.connection)
        self.rfile.close()
        self.rfile = io.BufferedReader(self._timed)

    def handle_one_request(self) -> None:
        """Answer one request; a client that leaves or is too slow ends the connection."""
        self._timed.end = time.monotonic() + PATIENCE
        self._left = 0
        with suppress(OSError):
            super().handle_one_request()
            if self._left:
                self._drain()
            return
        self.close_connection = True

    def handle_expect_100(self) -> bool:
        """Ask for the body of a request later, once its head has been checked."""
        return True

    def do_GET(self) -> None:
        """Answer with the page, the OpenAPI document or the state."""
        self._answer({"/": self._page, "/openapi.json": self._document, "/health": self._health})

    do_HEAD = do_GET  # noqa: N815

    def do_DELETE(self) -> None:
        """Refuse another method, with those that there are."""
        self._answer({})

    do_PUT = do_PATCH = do_OPTIONS = do_DELETE  # noqa: N815

    def do_POST(self) -> None:
        """Plan, keep a mesh, or run a command."""
        routes: dict[str, Callable[[], None]] = {"/plan": self._plan, "/objects": self._keep}
        if self.server.trusted:
            routes["/command"] = self._command
        self._answer(routes)

    def _answer(self, routes: dict[str, Callable[[], None]]) -> None:
        """Check a request and answer it; each error is answered with the object that ``--json`` prints."""
        try:
            self._check_head()
            path = urlsplit(self.path).path
            if path not in routes:
                others = {"/", "/openapi.json", "/health", "/plan", "/objects"} - set(routes)
                if path in others:
                    allowed = "POST" if path in ("/plan", "/objects") else "GET"
                    words = f"{path} takes {allowed}, not {self.command}"
                    raise Refusal(HTTPStatus.METHOD_NOT_ALLOWED, words, Allow=allowed)
                raise Refusal(HTTPStatus.NOT_FOUND, f"there is no {path:.80}; / lists what there is")
            routes[path]()
        except Refusal as refusal:
            self._refuse(refusal.status, refusal.reason, **refusal.headers)
        except Cancelled:
            self.close_connection = True
        except PoolBusy as busy:
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, str(busy), **{"Retry-After": "1"})
        except OutOfTime as late:
            self._refuse(HTTPStatus.GATEWAY_TIMEOUT, str(late))
        except TimeoutError:
            self.close_connection = True
            self._refuse(HTTPStatus.REQUEST_TIMEOUT, "the request came too slowly")
        except PreshapeError as error:
            self._refuse(_status(error.exit_code), str(error))

    def _check_head(self) -> None:
        """Refuse strangers, and bodies that are too large, before anything of a body is read."""
        every = self.headers.get_all
        if not self.server.trusted:
            bearer = [text[7:] for text in every("Authorization", []) if text[:7].lower() == "bearer "]
            tokens = [*bearer, *parse_qs(urlsplit(self.path).query).get("token", [])]
            fault = self.desk.gate.fault(every("Host", []), every("Origin", []), tokens)
            if fault is not None:
                self._left = 1
                raise Refusal(*_FAULTS[fault])
        lengths = every("Content-Length", [])
        if every("Transfer-Encoding") or len(lengths) > 1 or (self.command == "POST" and not lengths):
            self._left = 1
            raise Refusal(HTTPStatus.LENGTH_REQUIRED, "send the body with one Content-Length, not in chunks")
        if not lengths:
            return
        if not (lengths[0].isascii() and lengths[0].isdecimal()):
            self._left = 1
            raise Refusal(
                HTTPStatus.BAD_REQUEST, f"Content-Length must be a whole number, got {lengths[0]:.40}"
            )
        self._left = int(lengths[0][:20])
        sent = urlsplit(self.path).path == "/objects"
        most, what = (LARGEST, "mesh") if sent else (LARGEST_REQUEST, "request")
        if self._left > most:
            words = f"a {what} may have {most // 2**20} MB, got {self._left / 2**20:.0f} MB"
            raise Refusal(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, words)

    def _body(self) -> Iterator[bytes]:
        """The body in parts; the client must send it at a reasonable speed."""
        if self.headers.get("Expect", "").lower() == "100-continue":
            self.send_response_only(HTTPStatus.CONTINUE)
            self.end_headers()
            self.wfile.flush()
        self._timed.end = time.monotonic() + PATIENCE + self._left / SLOWEST
        while self._left:
            part = self.rfile.read1(min(self._left, _PART))
            if not part:
                raise Cancelled("the client has left")
            self._left -= len(part)
            yield part

    def _object(self) -> dict[str, Any]:
        """The JSON object in the body.

        Raises:
            InputError: The body is something else.
        """
        try:
            data = loads(b"".join(self._body()))
        except ValueError as error:
            raise InputError(f"the body is no JSON ({error!s:.80})") from error
        if not isinstance(data, dict):
            raise InputError(f"the body must be a JSON object, got {shown(data)}")
        return data

    def _plan(self) -> None:
        data, names = self._object(), dict[str, str]()
        if not self.server.trusted:
            data, names = self.desk.admission.admit(data)
        key = json.dumps([data.get("object"), data.get("hand"), data.get("task")])
        message, desk = {"do": "plan", "request": data, "names": names}, self.desk
        *_, reply = desk.pool.replies(message, key=key, seconds=desk.seconds, gone=self._gone)
        if "error" in reply:
            self._refuse(_status(reply.get("exit", 3)), reply["error"])
        else:
            self._send(HTTPStatus.OK, reply["text"])

    def _command(self) -> None:
        """Run a command of the command line for the same user, and send its output as it comes."""
        data = self._object()
        if data.pop("key", None) != self.desk.key:
            raise Refusal(HTTPStatus.CONFLICT, "this server has another version, memory or environment")
        message, desk = {"do": "command", "command": data}, self.desk
        with closing(
            desk.pool.replies(message, key="", seconds=math.inf, gone=self._gone, waits=False)
        ) as replies:
            first = next(replies)  # before it, the request may still be refused
            self.send_response(HTTPStatus.OK)
            self.send_header("Connection", "close")
            self.end_headers()
            for reply in chain([first], replies):
                self.wfile.write(json.dumps(reply).encode() + b"\n")
                self.wfile.flush()

    def _keep(self) -> None:
        named = parse_qs(urlsplit(self.path).query).get("name", [])
        if len(named) != 1:
            raise InputError("name the mesh as in POST /objects?name=part.stl; the ending says the format")
        number = self.desk.shelf.put(named[0], self._left, self._body())
        self._send(HTTPStatus.CREATED, json.dumps({"object": number}))

    def _page(self) -> None:
        self._send(HTTPStatus.OK, page(), "text/html; charset=utf-8")

    def _document(self) -> None:
        self._send(HTTPStatus.OK, json.dumps(document()))

    def _health(self) -> None:
        state = {"status": "ok", "version": __version__, **self.desk.pool.state}
        self._send(HTTPStatus.OK, json.dumps(state))

    def _gone(self) -> bool:
        """Whether the client has closed the connection."""
        if not select.select([self.connection], [], [], 0)[0]:
            return False
        try:
            return not self.connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except BlockingIOError:
            return False
        except OSError:
            return True

    def _refuse(self, status: HTTPStatus, reason: str, **headers: str) -> None:
        self._send(status, json.dumps({"status": "error", "reason": reason}), **headers)

    def _send(self, status: HTTPStatus, text: str, kind: str = "application/json", **headers: str) -> None:
        body = text.encode("utf-8", "replace")
        if self._left:  # what is left of a body would be read as the next request
            self.close_connection = True
        self.send_response(status)
        for name, content in {**HEADERS, **headers, "Content-Type": kind}.items():
            self.send_header(name, content)
        self.send_header("Content-Length", str(len(body)))
        if status == HTTPStatus.UNAUTHORIZED:
            self.send_header("WWW-Authenticate", "Bearer")
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)
        self.wfile.flush()

    def _drain(self) -> None:
        """Read some of what a refused client still sends, or it would not see the answer."""
        self.connection.shutdown(socket.SHUT_WR)
        self._timed.end = time.monotonic() + 1.0
        for _ in range(LARGEST_REQUEST // _PART):
            if not self.rfile.read1(_PART):
                return

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer a request that is no HTTP, as every other error is answered."""
        self._left, self.close_connection = 1, True
        self.command = getattr(self, "command", None) or "GET"
        status = HTTPStatus(code)
        self._refuse(status, f"{message or status.phrase:.120}")

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Say nothing: what clients do is no news to the user."""


def _status(exit_code: int) -> HTTPStatus:
    """The status of an error with an exit code of the command line."""
    return (
        HTTPStatus.INTERNAL_SERVER_ERROR
        if exit_code == EnvironmentFailure.exit_code
        else HTTPStatus.BAD_REQUEST
    )
