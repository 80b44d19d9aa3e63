"""One reader under the fuzzer, in a process of its own that may crash; ``hardening.fuzz`` starts it.

The fuzzer is libFuzzer, used through atheris. It keeps inputs that reach new code or branches and makes new
inputs from them. A broken promise is recorded and the run continues; only an input that ends the process
stops it.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import atheris  # type: ignore[import-untyped]

PARSERS = (
    "trimesh.exchange.gltf",
    "trimesh.exchange.ply",
    "trimesh.exchange.stl",
    "tomllib",
    "json",
    "zipfile",
)
"""Modules of other packages whose branches count as reached code too."""

with atheris.instrument_imports(
    include=["preshape", *PARSERS],
    enable_loader_override=False,
):
    import trimesh  # noqa: F401

    import preshape.hands.compiled
    import preshape.hands.rewrite

    from . import readers

MOST_MEMORY = 3 * 2**30
"""Address space beyond that at the start [bytes]; a small input that needs more is a fault."""
SLOW = 20
"""Time after which an input counts as a hang [s]; the machine may be busy with other work."""
EVERY = 200
"""Number of inputs after which the tally is written again."""


class Tally:
    """Counts of inputs, refusals and faults, written to a file."""

    def __init__(self, file: Path, faults: Path, limit: int) -> None:
        self.file, self.faults, self.limit = file, faults, limit
        self.done = self.read = self.refused = 0
        self.reasons: set[str] = set()
        self.seen: dict[str, int] = {}
        self.slowest = 0.0

    def write(self) -> None:
        """Write the file, completely or not at all."""
        content: dict[str, Any] = {
            "inputs": self.done,
            "read": self.read,
            "refused": self.refused,
            "kinds_of_refusal": len(self.reasons),
            "faults": self.seen,
            "slowest_s": round(self.slowest, 4),
            "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        }
        beside = self.file.with_suffix(".new")
        beside.write_text(json.dumps(content))
        beside.replace(self.file)

    def fault(self, fault: BaseException, data: bytes) -> None:
        """Store the smallest input of each kind of fault."""
        kind = _kind(fault)
        self.seen[kind] = self.seen.get(kind, 0) + 1
        name = "".join(c if c.isalnum() else "-" for c in kind)[:100]
        file = self.faults / name
        if not file.exists() or len(data) < file.stat().st_size:
            file.write_bytes(data)
            file.with_suffix(".txt").write_text(f"{fault}\n")


def _kind(fault: BaseException) -> str:
    """Kind of a fault: the error, and the line of preshape that it passed through."""
    cause = fault.__cause__ or fault
    trace, place = cause.__traceback__, ""
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if "preshape" in file:
            place = f"{Path(file).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return f"{type(cause).__name__} {place}" if fault.__cause__ else f"{str(fault)[:40]} {place}"


def main(name: str, work: Path, *options: str) -> None:
    """Fuzz one reader.

    Args:
        name: Name of the reader.
        work: Folder of the reader.
        options: Options of libFuzzer.
    """
    reader = readers.READERS[name]
    preshape.hands.rewrite._SAMPLES = 4  # fewer random samples, which do not depend on the file
    count = next(int(o.removeprefix("-runs=")) for o in options if o.startswith("-runs="))
    tally = Tally(work / "tally.json", work / "faults", count)
    folder = Path(tempfile.gettempdir()) / name  # used by this process only; hardening.fuzz removes it
    folder.mkdir(exist_ok=True)
    os.chdir(folder)  # MuJoCo writes its log to the working directory
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_MEMORY, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    def one(data: bytes) -> None:
        start = time.process_time()
        tally.done += 1
        try:
            message = readers.attempt(reader, folder, data)
            tally.read += not message
            tally.refused += bool(message)
            if message and len(tally.reasons) < 10_000:
                tally.reasons.add("".join(c for c in message if c.isalpha() or c == " ")[:80])
        except readers.Fault as fault:
            tally.fault(fault, data)
        tally.slowest = max(tally.slowest, time.process_time() - start)
        if tally.done % EVERY == 0 or tally.done >= tally.limit:
            tally.write()

    def mutate(data: bytes, largest: int, seed: int) -> bytes:
        assert reader.mutate is not None
        try:
            return reader.mutate(data, largest, random.Random(seed), atheris.Mutate)
        except Exception:  # an input without a valid structure gets random changes
            return bytes(atheris.Mutate(data, largest))

    more: dict[str, Any] = {} if reader.mutate is None else {"custom_mutator": mutate}
    if reader.words:
        lines = (f'"{_quoted(word)}"' for word in reader.words)
        (work / "words").write_text("\n".join(lines) + "\n")
        options = (*options, f"-dict={work / 'words'}")
    arguments = [
        sys.argv[0],
        *options,
        f"-timeout={SLOW}",
        "-rss_limit_mb=4096",
        f"-max_len={reader.largest}",
    ]
    with contextlib.redirect_stdout(sys.stderr):
        atheris.Setup(arguments, one, **more)
        atheris.Fuzz()


def _quoted(word: str) -> str:
    return "".join(c if c.isalnum() or c in " /.<>=-_#" else f"\\x{ord(c):02X}" for c in word)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), *sys.argv[3:])
