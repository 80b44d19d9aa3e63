"""The command line as a client: a running ``preshape serve`` of this user answers ``preshape plan`` for it.

It imports little. Where there is no such server, or it does not answer to the end, the command does its work
by itself; the server sends the same output and exit code, because it runs the same command.
"""

from __future__ import annotations

import json
import os
import socket
import sys
from typing import Any

from ..serve.place import SWITCH, own_socket, server_key, socket_path
from . import interrupts

FORWARDED = ("plan",)
SOON = 2.0
"""Time in which a server must begin to answer [s]."""


def forwarded(arguments: list[str]) -> int | None:
    """Let a server run a command, and print its output; returns the exit code.

    Args:
        arguments: The arguments of the command line.

    Returns:
        ``None`` if no server has answered.
    """
    switched_off = os.environ.get(SWITCH, "").strip().lower() in ("off", "0", "no")
    if switched_off or arguments[:1] != [*FORWARDED] or {"-h", "--help"} & set(arguments):
        return None
    memory = _memory_of(arguments)
    key = "" if memory is None else server_key(memory)
    path = socket_path(key) if key else None
    if path is None or not own_socket(path):
        return None
    output: list[str] = []
    try:
        with socket.socket(socket.AF_UNIX) as server:
            server.settimeout(SOON)
            server.connect(path)
            code = _ask(server, json.dumps({"key": key, **_situation(arguments)}).encode(), output)
    except (OSError, ValueError, KeyError):
        return None
    if code is not None:
        with interrupts.output:
            sys.stdout.write("".join(output))
            sys.stdout.flush()
            interrupts.answered()
    return code


def _memory_of(arguments: list[str]) -> str | None:
    """Path of the memory that the command would use; ``None`` if that is none for a server."""
    found = None
    for word, after in zip(arguments, [*arguments[1:], ""], strict=True):
        found = after if word == "--memory" else word[9:] if word.startswith("--memory=") else found
    if found is None:
        found = os.environ.get("PRESHAPE_MEMORY") or None
    if found is None:
        from ..exceptions import PreshapeError
        from .settings_file import user_settings

        try:
            settings = user_settings()
        except PreshapeError:
            return None
        found = settings.values.get("memory") if settings is not None else None
    if found is None:
        import platformdirs

        found = os.path.join(platformdirs.user_data_dir("preshape", appauthor=False), "memory.sqlite")
    return None if found in ("", ":memory:") else found


def _situation(arguments: list[str]) -> dict[str, Any]:
    """What the output of a command depends on besides its arguments."""
    environment = dict(os.environ)
    for number in (0, 1, 2):  # as rich finds the width of a terminal
        try:
            columns, lines = os.get_terminal_size(number)
        except OSError:
            continue
        environment.setdefault("COLUMNS", str(columns))
        environment.setdefault("LINES", str(lines))
        break
    streams = {
        name: {"terminal": stream.isatty(), "encoding": stream.encoding}
        for name, stream in (("out", sys.stdout), ("err", sys.stderr))
    }
    return {"arguments": arguments, "folder": os.getcwd(), "environment": environment, "streams": streams}


def _ask(server: socket.socket, body: bytes, output: list[str]) -> int | None:
    """Send a command, show its messages as they come, and collect its output; returns the exit code."""
    head = f"POST /command HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(body)}\r\n\r\n"
    server.sendall(head.encode() + body)
    with server.makefile("rb") as answer:
        if answer.readline().split()[1:2] != [b"200"]:
            return None
        while answer.readline().strip():
            pass
        server.settimeout(None)
        for line in answer:
            reply = json.loads(line)
            output.append(reply.get("out", ""))
            if "err" in reply:
                sys.stderr.write(reply["err"])
                sys.stderr.flush()
            if "code" in reply:
                return int(reply["code"])
    return None
