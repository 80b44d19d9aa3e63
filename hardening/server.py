"""Attacks on the server of ``preshape view``: what stays behind, what is held in memory, what is let in.

    python -m hardening.server [--long] [--out out/server]

Each attack starts ``preshape view`` as a process of its own and speaks to it as a page does, or as no page
would. The figures are read from /proc, so this needs Linux.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import os
import random
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import msgspec
import viser
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import ClientConnection, connect

from preshape.app.uploads import LARGEST
from preshape.files import write_json

from .long_runs import show_progress

MB = 2**20
PART = 512 * 1024
"""Size of the parts in which a page sends a file [bytes]."""
SETTLED = 10.0
"""Longest time in which what an attack has begun must have ended [s]."""
LATE = 2.0
"""Time in which a planner that nobody waits for would appear [s]."""
MOST_HELD = 60.0
"""Largest growth of the server's memory during an upload [MB]."""
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (1.0, 1.0, 1.0),
    "fov": 1.0,
    "near": 0.1,
    "far": 100.0,
    "image_height": 300,
    "image_width": 400,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}
"""What a page sends first; the server then makes its session."""


class Answer(NamedTuple):
    """What the server answers to a request for a page."""

    status: int
    headers: dict[str, str]
    body: bytes


class App:
    """One ``preshape view``, with everything that it has started and stored.

    Args:
        folder: Folder for its memory and its temporary files.
        options: Further options of the command.
    """

    def __init__(self, folder: Path, *options: str) -> None:
        self.temporary = folder / "temporary"
        self.temporary.mkdir()
        command = [sys.executable, "-m", "preshape", "view", "cube", "--task", "lift", "--port", "0"]
        self.process = subprocess.Popen(
            [*command, "--memory", str(folder / "memory.sqlite"), *options],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "TMPDIR": str(self.temporary), "OPENBLAS_NUM_THREADS": "1"},
        )
        assert self.process.stderr is not None
        said = self.process.stderr.readline()
        found = re.search(r"http://[^/\s]+(/\?token=(\S+))?", said)
        assert found, said + self.process.stderr.read()
        self.address, self.token = found[0].partition("/?")[0], found[2]
        self.port = int(self.address.rpartition(":")[2])
        self.said: list[str] = []
        self._reader = threading.Thread(target=self.said.extend, args=(self.process.stderr,), daemon=True)
        self._reader.start()

    @property
    def known(self) -> dict[str, str]:
        """The header of a page that was opened with the token, where one is needed."""
        return {"Cookie": f"preshape-{self.port}={self.token}"} if self.token else {}

    @property
    def protocol(self) -> Any:
        """The websocket's subprotocol that a page names."""
        return f"viser-v{viser.__version__}"

    def page(self) -> ClientConnection:
        """Open a websocket as a page does, without sending anything."""
        where = self.address.replace("http", "ws")
        return connect(where, subprotocols=[self.protocol], max_size=None, additional_headers=self.known)

    def session(self) -> ClientConnection:
        """Open a page and begin its session; while others are still being closed, try again."""
        end = time.monotonic() + SETTLED
        while True:
            page = self.page()
            try:
                page.send(packed(**CAMERA))
                page.recv(timeout=SETTLED)
                return page
            except ConnectionClosed:
                if time.monotonic() > end:
                    raise
                time.sleep(0.1)

    def get(self, path: str = "/", **headers: str) -> Answer:
        """The answer to a request for a page; ``Host`` among the headers replaces the usual one."""
        where = urlsplit(self.address)
        line = http.client.HTTPConnection(where.hostname or "", self.port, timeout=20)
        with contextlib.closing(line):
            line.request("GET", path, headers={"Host": where.netloc, **headers})
            answer = line.getresponse()
            return Answer(answer.status, dict(answer.headers), answer.read())

    def planners(self) -> list[int]:
        """Process ids of the planners, also of those that the server has left behind."""
        mine = f"TMPDIR={self.temporary}".encode()
        found = []
        for process in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if b"preshape.app.worker" not in (process / "cmdline").read_bytes():
                    continue
                if mine in (process / "environ").read_bytes().split(b"\0"):
                    found.append(int(process.name))
        return found

    def memory(self, key: str = "VmRSS") -> float:
        """Memory that the server's process holds [MB]; ``VmHWM`` is the largest so far."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.findall(rf"{key}:\s+(\d+) kB", status)[0]) / 1024

    def stored(self) -> list[Path]:
        """The uploaded files."""
        return [file for file in self.temporary.rglob("preshape-*/*/*") if file.is_file()]

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        """End the server with a signal; returns its exit code."""
        self.process.send_signal(number)
        code = self.process.wait(timeout=30)
        self._reader.join(timeout=5)
        return code


@contextlib.contextmanager
def served(*options: str) -> Iterator[App]:
    """An app for the length of a ``with`` block; it and its planners are gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="preshape-server-") as folder:
        app = App(Path(folder), *options)
        try:
            yield app
        finally:
            if app.process.poll() is None:
                app.end()
            for left in app.planners():
                os.kill(left, signal.SIGKILL)
            if app.process.stderr is not None:
                app.process.stderr.close()


def packed(**message: Any) -> bytes:
    """A message as a page sends it."""
    return msgspec.msgpack.encode(message)


def settled(true: Callable[[], bool], seconds: float = SETTLED) -> bool:
    """Wait until something is true; returns whether it became so in time."""
    end = time.monotonic() + seconds
    while not true():
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


def opened_and_closed(app: App, count: int) -> dict[str, Any]:
    """Open pages and close them at once: no planner stays."""
    before, refused, most, rng = app.memory(), 0, 0, random.Random(count)
    for number in range(count):
        _progress("pages opened and closed", number, count)
        try:
            with app.page() as page:
                page.send(packed(**CAMERA))
                time.sleep(rng.choice((0.0, 0.0, 0.1, 0.5)))  # before, while and after a planner starts
                most = max(most, len(app.planners()))
        except ConnectionClosed:
            refused += 1
    time.sleep(LATE)
    gone = settled(lambda: not app.planners())
    return {
        "pages": count,
        "refused": refused,
        "most_planners": most,
        "planners_left": len(app.planners()),
        "grown_mb": round(app.memory() - before, 1),
        "faults": [] if gone else ["planners stay although their pages are closed"],
    }


def crowded(app: App, count: int, limit: int) -> dict[str, Any]:
    """Open more pages than there is room for: the others are told so, and there is room again afterwards."""
    faults = []
    pages = [app.session() for _ in range(limit)] + [app.page() for _ in range(count - limit)]
    if not settled(lambda: len(app.planners()) == limit):
        faults.append(f"{len(app.planners())} planners for {limit} pages")
    told = [_reason(page) for page in pages[limit:]]
    if not all("the limit" in words for words in told):
        faults.append(f"a page too many was told {told}")
    answer = app.get()
    if answer.status != 503 or b"Too many pages" not in answer.body:
        faults.append(f"a page too many is answered {answer.status}")
    most = len(app.planners())
    for page in pages:
        page.close()
    if not settled(lambda: not app.planners()) or app.get().status != 200:
        faults.append("no room after all pages were closed")
    return {"pages": count, "limit": limit, "most_planners": most, "faults": faults}


def _reason(page: ClientConnection) -> str:
    try:
        page.recv(timeout=10)
    except ConnectionClosed as closed:
        return closed.rcvd.reason if closed.rcvd else ""
    except TimeoutError:
        pass
    return "nothing"


def uploaded(app: App, size: int, *, declared: int | None = None, name: str = "x.obj") -> dict[str, Any]:
    """Send a file of ``size`` bytes, of which ``declared`` were announced: it is not held in memory."""
    size_told = size if declared is None else declared
    with app.session() as page:
        settled(lambda: bool(app.planners()))
        time.sleep(0.5)
        before, transfer, parts = app.memory(), f"{random.random()}", -(-size // PART)
        common = {"source_component_uuid": "button", "transfer_uuid": transfer}
        start = {"filename": name, "mime_type": "", "part_count": parts, "size_bytes": size_told}
        page.send(packed(type="FileTransferStartUpload", **common, **start))
        most = before
        for index in range(parts):
            content = b"\0" * min(PART, size - index * PART)
            page.send(packed(type="FileTransferPart", **common, part_index=index, content=content))
            if index % 50 == 0:
                _progress("MB sent", index // 2, parts // 2)
                most = max(most, app.memory())
        most = max(most, app.memory())
        wanted = size if declared is None and size <= LARGEST else 0
        whole = settled(lambda: _size(app) >= wanted)
        stored = _size(app)
    gone = settled(lambda: not app.stored())
    held = most - before
    faults = [] if gone else ["an upload stays although its page is closed"]
    if not whole:
        faults.append("a file that may be uploaded is not stored")
    if held > MOST_HELD:
        faults.append(f"{held:.0f} MB were held")
    return {"sent_mb": size // MB, "held_mb": round(held, 1), "stored_mb": stored // MB, "faults": faults}


def _size(app: App) -> int:
    return sum(file.stat().st_size for file in app.stored())


def noise(app: App, count: int, seed: int) -> dict[str, Any]:
    """Send what no page sends: the app still answers, and its terminal says nothing."""
    rng = random.Random(seed)
    for number in range(count):
        _progress("kinds of noise", number, count)
        with contextlib.suppress(OSError, ConnectionClosed, InvalidHandshake):
            if number % 2:
                with socket.create_connection(("127.0.0.1", app.port), timeout=5) as line:
                    line.sendall(rng.randbytes(rng.randrange(200)) + b"\r\n\r\n")
                continue
            with app.page() as page:
                page.send(packed(**CAMERA))
                kind = rng.choice(["ViewerCameraMessage", "FileTransferPart", "GuiUpdateMessage", "Nothing"])
                page.send(
                    rng.choice(
                        [
                            rng.randbytes(rng.randrange(1, 200)),
                            "text",
                            packed(type=kind),
                            packed(**{**CAMERA, "fov": "wide", "position": [None]}),
                            packed(type="FileTransferStartUpload", filename=1, size_bytes="many"),
                            packed(type="GuiUpdateMessage", uuid="none", updates={"value": [1]}),
                            b"\0" * 2 * MB,
                        ]
                    )
                )
    faults = []
    time.sleep(LATE)
    if not settled(lambda: not app.planners()):
        faults.append("planners stay")
    if app.get().status != 200:
        faults.append("the app does not answer")
    faults += [f"the terminal says {line.strip()!r}" for line in app.said[:3]]
    return {"sent": count, "faults": faults}


def strangers(app: App) -> dict[str, Any]:
    """Ask as other sites' pages, other names and without the token: each is refused."""
    own = urlsplit(app.address).netloc
    asked: dict[str, dict[str, str]] = {
        "another origin": {**app.known, "Origin": "http://elsewhere.example"},
        "another port": {**app.known, "Origin": f"http://{own.partition(':')[0]}:1"},
        "no origin at all": {**app.known, "Origin": "null"},
        "a longer name": {**app.known, "Origin": f"http://{own}.elsewhere.example"},
    }
    if app.token:
        asked["no token"] = {}
        asked["another token"] = {"Cookie": f"preshape-{app.port}={app.token[:-1]}"}
    else:
        asked["a name that points here"] = {"Host": "elsewhere.example", "Origin": "http://elsewhere.example"}
    faults = []
    for what, headers in asked.items():
        if app.get(**headers).status != 403:
            faults.append(f"{what}: the page is shown")
        upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
        key = {"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA=="}
        if app.get(**headers, **upgrade, **key).status != 403:
            faults.append(f"{what}: the websocket opens")
    link = app.get("/?websocket=ws://elsewhere.example", **app.known)
    if (link.status, link.headers.get("Location")) != (302, "/"):
        faults.append("a link names another server")
    return {"asked": 2 * len(asked) + 1, "faults": faults}


def ended(app: App, number: signal.Signals, pages: int) -> dict[str, Any]:
    """End the server by a signal while pages are open and an upload is stored: nothing stays."""
    opened = [app.session() for _ in range(pages)]
    settled(lambda: len(app.planners()) == pages)
    start = {"source_component_uuid": "", "transfer_uuid": "t", "mime_type": "", "part_count": 2}
    opened[0].send(packed(type="FileTransferStartUpload", filename="x.obj", size_bytes=2 * PART, **start))
    settled(lambda: bool(app.stored()))
    begin = time.monotonic()
    app.process.send_signal(number)
    gone = settled(lambda: not app.planners(), 5.0)
    seconds = time.monotonic() - begin
    code = app.process.wait(timeout=30)
    left = list(app.temporary.glob("preshape-*"))
    for page in opened:
        page.close()
    faults = [] if gone else ["planners go on"]
    if number != signal.SIGKILL and (left or code):
        faults.append(f"exit code {code}, left: {[path.name for path in left]}")
    return {"signal": number.name, "pages": pages, "planners_gone_s": round(seconds, 2), "faults": faults}


def _progress(what: str, done: int, total: int) -> None:
    if sys.stderr.isatty():
        show_progress(f"{done} of {total} {what}")


def study(*, long: bool) -> dict[str, Any]:
    """Run all attacks and report."""
    pages, size, kinds = (200, 1024, 2000) if long else (20, 300, 60)
    report: dict[str, Any] = {}
    with served("--sessions", str(pages)) as app:
        report["opened and closed"] = opened_and_closed(app, pages)
    with served("--sessions", "4") as app:
        report["too large"] = uploaded(app, size * MB)
        report["larger than said"] = uploaded(app, size * MB, declared=MB)
        report["large"] = uploaded(app, 190 * MB)
        report["noise"] = noise(app, kinds, seed=1)
        report["crowded"] = crowded(app, 8, 4)
        report["strangers"] = strangers(app)
        report["SIGTERM"] = ended(app, signal.SIGTERM, 3)
    for host in ("0.0.0.0", "127.0.0.2"):
        with served("--host", host) as app:
            report[f"strangers at {host}"] = strangers(app)
            if host == "0.0.0.0":
                report["SIGHUP"] = ended(app, signal.SIGHUP, 1)
    with served() as app:
        report["SIGKILL"] = ended(app, signal.SIGKILL, 2)
    return report


def main(arguments: list[str]) -> int:
    """Run from the command line; returns 0 where nothing was found, else 1."""
    parser = argparse.ArgumentParser(prog="python -m hardening.server", description="Attack preshape view.")
    parser.add_argument("--long", action="store_true", help="more pages, more noise, and an upload of 1 GB")
    parser.add_argument("--out", type=Path, default=Path("out/server"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    report = study(long=given.long)
    write_json(given.out / "server.json", report)
    for name, found in report.items():
        print(f"{name}: " + ", ".join(f"{key} {value}" for key, value in found.items() if key != "faults"))
        for fault in found["faults"]:
            print(f"  fault: {fault}")
    return int(any(found["faults"] for found in report.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
