"""``preshape serve``: plans over HTTP, for robots and other programs."""

from __future__ import annotations

from pathlib import Path

import click

from ..exceptions import InputError
from . import interrupts
from .options import memory_option, names_in, workers_option
from .printing import wait_at


@click.command(epilog="Example: preshape serve --hand shadow,leap")
@click.option(
    "--host",
    default="127.0.0.1",
    help="Address to listen on; if others can reach it, the printed address has a token.",
)
@click.option("--port", type=int, default=8090, help="Port to listen on; 0 for any free one.")
@click.option("--hand", default="shadow", metavar="HAND,…", help="Hands that are loaded in advance.")
@click.option("--files", metavar="DIR", help="Folder whose files requests may name as objects and hands.")
@click.option("--timeout", type=float, default=300.0, metavar="S", help="Time limit of a request [s].")
@workers_option
@memory_option
def serve(
    host: str,
    port: int,
    hand: str,
    files: str | None,
    timeout: float,
    workers: int | None,
    memory: str | None,
) -> int:
    """Answer requests over HTTP: POST /plan with the keywords of preshape.plan() as JSON gives plan.json.

    curl localhost:8090/plan -d '{"object": "mug", "task": "pour", "hand": "shadow"}' asks for one; GET /
    describes all, /openapi.json for programs. A client cancels by closing the connection. While it runs,
    `preshape plan` of this user with this memory is answered by it too. Ctrl-C or SIGTERM ends it with exit
    code 130 and keeps what was learnt.
    """
    from ..hands.load import load_hand
    from ..memory import Memory, default_path
    from ..serve.place import server_key
    from ..serve.server import PlanServer

    if memory == ":memory:":
        raise InputError(
            "the planners of a server share one memory, which must be a file; give --memory FILE"
        )
    hands = names_in(hand, "--hand")
    for name in hands:
        load_hand(name)
    Memory.open(memory).close()  # what is wrong with it is said now
    kept = None if memory is None else str(Path(memory).expanduser().absolute())
    with interrupts.patient():  # SIGTERM and SIGHUP too stop the server, which ends its processes
        server = PlanServer(
            ("preshape.cli.worker", kept or "", *hands),
            host=host,
            port=port,
            workers=workers,
            seconds=timeout,
            files=None if files is None else Path(files),
            key=server_key(kept or str(default_path())),
        )
        try:
            wait_at("preshape serve", server.address, host)
        finally:
            server.stop()
