"""The server of ``preshape serve``: a port, and a socket file for this user's own command line."""

from __future__ import annotations

import contextlib
import os
import socket
import socketserver
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..app.gate import Gate
from ..exceptions import EnvironmentFailure, InputError
from ..processes import process_count
from .admission import Admission
from .handler import Handler
from .place import socket_path
from .pool import PlannerPool
from .shelf import Shelf

CONNECTIONS, WAITING = 128, 64
"""Largest number of open connections, and of requests that wait for a planner."""


class Desk:
    """What all connections of a server share.

    Args:
        gate: Decides which requests are let in.
        pool: The planner processes.
        shelf: The meshes that clients have sent.
        admission: What requests may name.
        seconds: Time limit of a request [s].
        key: What a command line must have in common with the server; see :mod:`.place`.
    """

    def __init__(
        self, gate: Gate, pool: PlannerPool, shelf: Shelf, admission: Admission, seconds: float, key: str
    ) -> None:
        self.gate, self.pool, self.shelf, self.admission = gate, pool, shelf, admission
        self.seconds, self.key = seconds, key


class _Threads(socketserver.ThreadingMixIn, socketserver.TCPServer):
    """A listening socket with one thread for each connection, and room for so many."""

    daemon_threads, block_on_close = True, False
    allow_reuse_address = True
    request_queue_size = CONNECTIONS
    desk: Desk

    def __init__(self, address: Any, family: int, *, trusted: bool) -> None:
        self.address_family, self.trusted = family, trusted
        self._room = threading.BoundedSemaphore(CONNECTIONS)
        super().__init__(address, Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Start a thread, or close the connection if there is no room."""
        if not self._room.acquire(blocking=False):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except RuntimeError:  # the system has no thread left
            self._room.release()
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer a connection, then make room."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._room.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: a client that sends nonsense or leaves is no news to the user."""


class PlanServer:
    """Serves plans until it is stopped.

    Args:
        program: Module of a planner process, and its arguments.
        host: Address to listen on. Off this machine, a token that is part of ``address`` is needed.
        port: Port to listen on; 0 for any free one.
        workers: Number of planner processes; ``None`` for one for each core.
        seconds: Time limit of a request [s].
        files: Folder whose files requests may name; ``None`` for none.
        key: What command lines must have in common with the server that it runs commands for, through a
            socket file (:mod:`.place`); empty for none.

    Raises:
        InputError: The port is not in 0..65535, or another number is too small.
        EnvironmentFailure: The address cannot be used, or the system refuses a process.
    """

    def __init__(
        self,
        program: Sequence[str],
        *,
        host: str = "127.0.0.1",
        port: int = 8090,
        workers: int | None = None,
        seconds: float = 300.0,
        files: Path | None = None,
        key: str = "",
    ) -> None:
        if not 0 <= port <= 65535:
            raise InputError(f"a port must be 0 to 65535, got {port}")
        if not seconds > 0:
            raise InputError(f"the time limit must be above 0 seconds, got {seconds:g}")
        if files is not None and not files.is_dir():
            raise InputError(f"--files names a folder, and {files} is none")
        count = process_count(workers)
        self.host = host
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self._servers = [_Threads((host, port), family, trusted=False)]
        except OSError as error:
            raise EnvironmentFailure(
                f"cannot listen on {host} port {port} ({error.strerror or error}); choose another with --port"
            ) from error
        self.port = int(self._servers[0].server_address[1])
        self._gate, self._shelf = Gate(host, self.port, CONNECTIONS), Shelf()
        try:
            own = _on_file(local) if key and (local := socket_path(key, make=True)) else None
            self._servers += [own] if own is not None else []
            self._pool = PlannerPool(program, count, WAITING)
        except EnvironmentFailure:
            self._close_sockets()
            raise
        desk = Desk(self._gate, self._pool, self._shelf, Admission(self._shelf, files), seconds, key)
        for server in self._servers:
            server.desk = desk
            threading.Thread(target=server.serve_forever, args=(0.1,), daemon=True).start()

    @property
    def address(self) -> str:
        """The address, with the token if one is needed."""
        return self._gate.address

    def stop(self) -> None:
        """End the planner processes at once, close the sockets and delete what clients have sent."""
        self._pool.close()
        for server in self._servers:
            server.shutdown()
        self._close_sockets()
        self._shelf.close()

    def _close_sockets(self) -> None:
        for server in self._servers:
            server.server_close()
            if server.trusted:
                with contextlib.suppress(OSError):
                    os.unlink(str(server.server_address))


def _on_file(path: str) -> _Threads | None:
    """A server on a socket file that only this user can open; ``None`` where another one uses it.

    Without it the command line does its work by itself.
    """
    before = os.umask(0o177)
    try:
        with socket.socket(socket.AF_UNIX) as probe:
            if probe.connect_ex(path) == 0:
                return None
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
        return _Threads(path, socket.AF_UNIX, trusted=True)
    except OSError:
        return None
    finally:
        os.umask(before)
