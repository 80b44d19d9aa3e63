"""Files that are no files: every reader refuses pipes, devices, sockets, pointers and oversize at once.

    python -m hardening.files [--long] [--out out/files]

Each reader gets each of these in place of its file and, where a format refers to further files, in place of
those. It must refuse with one printable sentence within seconds, whatever the other end does. The long form
also gives every reader a file just over its limit.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from preshape import files
from preshape.files import write_json

from . import pincer
from .readers import READERS, Fault, attempt_file

DEADLINE = 30
"""Longest time for one refusal [s]; a reader that waits for a pipe never comes back."""
LFS = f"version https://git-lfs.github.com/spec/v1\noid sha256:{'0' * 64}\nsize 1234567\n"
LIMITS = {
    **dict.fromkeys(("obj", "stl", "ply", "off", "gltf", "glb"), files.MOST_OF_MESH),
    **dict.fromkeys(("pcd", "xyz", "npy", "scene-npz", "mask"), files.MOST_OF_MESH),
    **dict.fromkeys(("plan-json", "memory-json"), files.MOST_OF_JSON),
    **dict.fromkeys(("hand-mjcf", "hand-urdf", "arm"), files.MOST_OF_MODEL),
    "grasps-npz": files.MOST_OF_ARRAYS,
    **dict.fromkeys(("hand-toml", "sidecar", "settings"), files.MOST_OF_TOML),
}
"""Largest file of each reader [bytes]; a memory has no limit, because SQLite reads only what is asked for."""
REFERENCES = {
    "gltf": '{"asset": {"version": "2.0"}, "buffers": [{"byteLength": 100, "uri": "other"}]}',
    "hand-mjcf": pincer.MJCF.replace("<worldbody>", '<include file="other"/><worldbody>', 1),
    "hand-urdf": '<robot name="a"><link name="b"><collision><geometry><mesh filename="other.stl"/></geometry>'
    "</collision></link></robot>",
}
"""For formats that refer to other files, a file that does."""


@contextlib.contextmanager
def odd_file(kind: str, path: Path, limit: int = 0) -> Iterator[Path]:
    """Put something that is no proper file at a path.

    Args:
        kind: ``pipe``, ``socket``, ``zero`` (an endless device), ``folder``, ``pointer`` or ``oversize``.
        path: Where to put it.
        limit: For ``oversize``, the size that is exceeded [bytes].
    """
    with contextlib.ExitStack() as stack:
        if kind == "pipe":
            os.mkfifo(path)
        elif kind == "socket":
            server = stack.enter_context(socket.socket(socket.AF_UNIX))
            server.bind(str(path))
        elif kind == "zero":
            path.symlink_to("/dev/zero")
        elif kind == "folder":
            path.mkdir()
        elif kind == "pointer":
            path.write_text(LFS)
        else:
            with path.open("wb") as file:
                file.truncate(limit + 1)
        try:
            yield path
        finally:
            if kind == "folder":
                path.rmdir()
            else:
                path.unlink()


def one(reader: str, kind: str, place: str) -> str:
    """Give one reader one odd file; returns the sentence with which it was refused.

    Args:
        reader: Name of the reader.
        kind: Kind of file, see :func:`odd_file`.
        place: ``file`` for the reader's own file, or the name of a file that it refers to.

    Raises:
        Fault: The file was read, or was refused with something else than one printable sentence.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        own = folder / READERS[reader].file
        odd = own if place == "file" else folder / place
        if place != "file":
            own.write_text(REFERENCES[reader])
        with odd_file(kind, odd, LIMITS.get(reader, 0)):
            said = attempt_file(READERS[reader], own)
    if not said:
        raise Fault(f"a {kind} was read")
    return said


def cases(*, long: bool) -> list[tuple[str, str, str]]:
    """Reader, kind and place of every case."""
    kinds = ["pipe", "socket", "zero", "folder", "pointer"]
    found = [(reader, kind, "file") for reader in READERS for kind in kinds]
    for reader in REFERENCES:
        place = "other.stl" if reader == "hand-urdf" else "other"
        found += [(reader, kind, place) for kind in kinds]
    if long:
        found += [(reader, "oversize", "file") for reader in LIMITS]
    else:
        found.append(("hand-toml", "oversize", "file"))
    return found


def _too_late(*_: object) -> None:
    raise Fault(f"not refused within {DEADLINE} s")


def main(arguments: list[str]) -> int:
    """Run from the command line; returns 0 if every file was refused, else 1."""
    parser = argparse.ArgumentParser(prog="python -m hardening.files", description="Files that are no files.")
    parser.add_argument("--long", action="store_true", help="also files just over the limits of reading")
    parser.add_argument("--out", type=Path, default=Path("out/files"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    rows: list[dict[str, Any]] = []
    signal.signal(signal.SIGALRM, _too_late)
    for reader, kind, place in cases(long=given.long):
        begin = time.monotonic()
        signal.alarm(DEADLINE)
        try:
            said, good = one(reader, kind, place), True
        except Fault as fault:
            said, good = str(fault), False
            print(f"{reader}, {kind} as {place}: {said}")
        finally:
            signal.alarm(0)
        seconds = round(time.monotonic() - begin, 2)
        rows.append({"reader": reader, "kind": kind, "place": place, "good": good, "said": said})
        rows[-1]["seconds"] = seconds
    write_json(given.out / "files.json", rows)
    wrong = sum(not row["good"] for row in rows)
    slowest = max(row["seconds"] for row in rows)
    print(f"{len(rows)} odd files for {len(READERS)} readers: {wrong} not refused; slowest {slowest} s")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
