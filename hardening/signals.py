"""Ctrl-C and SIGTERM at random moments of a run: exit code 130, one line, and one JSON document.

    python -m hardening.signals [--long] [--moments N] [--seed 5] [--out out/signals]

Each run is measured once without a signal. Then it is started again and again, each time with new folders,
and gets a signal at a moment drawn evenly between the start of its process and a little after its end. A
moment is good if

- the exit code is 130, standard error ends with the one line, and standard output is the error object; or the
  run had finished: exit code and document are those of a run without a signal;
- no traceback was shown, no temporary file is left, and the memory is intact.

Python's own start, before any line of preshape, answers a signal in its own way; such moments are counted
apart, and count as faults only with ``--strict``.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from preshape.cli.early import EXIT_INTERRUPTED, INTERRUPTED
from preshape.files import write_json

from .long_runs import show_progress

COMMANDS = {
    "list": ("tasks",),
    "plan": (
        "plan",
        "cylinder",
        "--task",
        "lift",
        "--hand",
        "utah_mit",
        "--memory",
        "{memory}",
        "--out",
        "{out}",
    ),
    "learn": ("learn", "box", "bottle", "--task", "lift", "--hand", "utah_mit", "--memory", "{memory}"),
    "closure": ("plan", "cylinder", "--task", "lift", "--hand", "shadow", "--memory", "{memory}", "--verify"),
    "compile": ("plan", "sphere", "--task", "lift", "--hand", "allegro", "--memory", "{memory}"),
}
"""The runs. All begin with an empty memory, so they include the first lesson; ``compile`` begins without
compiled kernels, so most of it is their compilation."""
SHARES = {"list": 0.25, "plan": 0.4, "learn": 0.2, "closure": 0.12, "compile": 0.03}
QUICK, LONG = 24, 240
AFTER = 1.03
"""The last moment, as a multiple of the time of a whole run."""
_SPARE = re.compile("preshape-kernels-[0-9]*")
LONGEST = 20.0
"""A run that goes on longer than this after its signal has not been interrupted [s]."""


@dataclass
class Ended:
    """How a run ended; see :func:`judge`."""

    code: int
    out: str
    err: str
    seconds: float
    faults: list[str] = field(default_factory=list)


def start(name: str, folder: Path) -> subprocess.Popen[str]:
    """Start a run of the command line with folders of its own."""
    for each in ("out", "tmp", "warp"):
        (folder / each).mkdir()
    places = {"memory": str(folder / "memory.sqlite"), "out": str(folder / "out")}
    given = [part.format(**places) for part in COMMANDS[name]]
    environment = {**os.environ, "TMPDIR": str(folder / "tmp")}
    if name == "compile":
        environment["WARP_CACHE_PATH"] = str(folder / "warp")
    return subprocess.Popen(
        [sys.executable, "-m", "preshape", *given, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )


def interrupted_run(name: str, moment: float | None, number: int) -> Ended:
    """One run, with a signal at a moment or without one.

    Args:
        name: Name of the run.
        moment: Time from the start of the process [s]; ``None`` for no signal.
        number: The signal.
    """
    with tempfile.TemporaryDirectory(prefix="preshape-signals-") as place:
        folder = Path(place)
        begin = time.monotonic()
        process = start(name, folder)
        faults: list[str] = []
        try:
            if moment is not None:
                try:
                    process.wait(max(0.0, begin + moment - time.monotonic()))
                except subprocess.TimeoutExpired:
                    process.send_signal(number)
            out, err = process.communicate(timeout=None if moment is None else LONGEST)
        except subprocess.TimeoutExpired:
            process.kill()
            out, err = process.communicate()
            faults.append("went on after the signal")
        seconds = time.monotonic() - begin
        # A cache that cannot be written has a folder named by the user's number, which stays.
        left = [
            str(f.relative_to(folder)) for f in (folder / "tmp").iterdir() if not _SPARE.fullmatch(f.name)
        ]
        left += [str(file.relative_to(folder)) for file in (folder / "out").glob(".*")]
        faults += [f"left behind: {', '.join(left)}"] if left else []
        faults += _memory_faults(folder / "memory.sqlite")
        return Ended(process.returncode, out, err, seconds, faults)


def _memory_faults(path: Path) -> list[str]:
    if not path.exists():
        return []
    with closing(sqlite3.connect(path)) as base:
        said = base.execute("PRAGMA integrity_check").fetchone()[0]
    return [] if said == "ok" else [f"memory: {said}"]


def judge(ended: Ended, usual: Ended) -> str:
    """``interrupted``, ``finished`` or ``start``, where nothing is wrong; otherwise what is."""
    if ended.faults:
        return "; ".join(ended.faults)
    if not ended.out and ended.code in (-signal.SIGINT, -signal.SIGTERM) and not ended.err:
        return "start"
    if "Traceback" in ended.err or "Exception ignored" in ended.err or "Fatal Python" in ended.err:
        # The guard is started by our main() (Python's site.py has another); before it there are only imports.
        begun = re.search(r'__main__\.py", line \d+, in main\n', ended.err)
        early = not ended.out and not begun and "KeyboardInterrupt" in ended.err
        return "start" if early else f"traceback: {ended.err.strip().splitlines()[-1]:.100}"
    try:
        status = json.loads(ended.out)["status"] if ended.out else ""
    except (ValueError, KeyError, TypeError):
        return f"exit code {ended.code}, and not one JSON document: {ended.out[-60:]!r}"
    if ended.code == EXIT_INTERRUPTED:
        lines = ended.err.splitlines()
        if lines.count(INTERRUPTED) != 1 or lines[-1] != INTERRUPTED:
            return f"not one line: {ended.err[-200:]!r}"
        return "interrupted" if status else "no JSON document"
    same = ended.code == usual.code and status == json.loads(usual.out)["status"]
    return "finished" if same else f"exit code {ended.code}, status {status!r}: {ended.err[-100:]!r}"


def study(
    moments: int, seed: int, *, names: tuple[str, ...], processes: int = 2, until: float | None = None
) -> dict[str, Any]:
    """Interrupt runs at random moments and report.

    Args:
        moments: Number of moments, over all runs.
        seed: Seed of the moments.
        names: The runs.
        processes: Number of runs at a time.
        until: The last moment [s]; ``None`` for a little after the end of a run.
    """
    # A shell starts background processes with Ctrl-C ignored; the runs must not inherit this.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return _study(random.Random(seed), moments, names, processes, until) | {"seed": seed}
    finally:
        signal.signal(signal.SIGINT, before)


def _study(
    rng: random.Random, moments: int, names: tuple[str, ...], processes: int, until: float | None
) -> dict[str, Any]:
    with ThreadPoolExecutor(processes) as pool:  # as many at a time as later
        usual = dict(zip(names, pool.map(lambda name: interrupted_run(name, None, 0), names), strict=True))
    whole = sum(SHARES[name] for name in names)
    jobs = [
        (
            name,
            rng.uniform(0.0, AFTER * usual[name].seconds if until is None else until),
            (signal.SIGINT, signal.SIGTERM)[k % 2],
        )
        for name in names
        for k in range(max(1, round(moments * SHARES[name] / whole)))
    ]
    rng.shuffle(jobs)
    rows: list[dict[str, Any]] = []
    begin = time.monotonic()
    pool = ThreadPoolExecutor(processes)
    with suppress(KeyboardInterrupt):  # what is known so far
        waiting = {pool.submit(interrupted_run, *job): job for job in jobs}
        for future in as_completed(waiting):
            (name, moment, number), ended = waiting[future], future.result()
            said = judge(ended, usual[name])
            rows.append({"run": name, "moment": round(moment, 3), "signal": number.name, "result": said})
            left = (time.monotonic() - begin) / len(rows) * (len(jobs) - len(rows)) / 60
            found = Counter(row["result"] for row in rows)
            words = ", ".join(f"{count} {result}" for result, count in found.items())
            show_progress(f"{len(rows)} of {len(jobs)} moments, about {left:.0f} min left: {words}")
    pool.shutdown(cancel_futures=True)
    good = sum(row["result"] in ("interrupted", "finished") for row in rows)
    early = [row["moment"] for row in rows if row["result"] == "start"]
    return {
        "seconds": {name: round(ended.seconds, 2) for name, ended in usual.items()},
        "moments": len(rows),
        "good": good,
        "interrupted": sum(row["result"] == "interrupted" for row in rows),
        "python_start": len(early),
        "python_start_until": max(early, default=0.0),
        "faults": [row for row in rows if row["result"] not in ("interrupted", "finished", "start")],
        "rows": rows,
    }


def main(arguments: list[str]) -> int:
    """Run from the command line; returns 0 where every moment was good, else 1."""
    parser = argparse.ArgumentParser(
        prog="python -m hardening.signals", description="Interrupt runs at random moments."
    )
    parser.add_argument(
        "--long", action="store_true", help=f"{LONG} moments of all runs; else {QUICK} of two"
    )
    parser.add_argument("--moments", type=int, help="number of moments")
    parser.add_argument("--until", type=float, help="the last moment [s] (default: after the end of a run)")
    parser.add_argument("--runs", nargs="+", choices=tuple(COMMANDS), help="the runs")
    parser.add_argument("--seed", type=int, default=5, help="seed of the moments (default: %(default)s)")
    parser.add_argument("--processes", type=int, default=2, help="runs at a time (default: %(default)s)")
    parser.add_argument("--strict", action="store_true", help="Python's own start counts as a fault too")
    parser.add_argument("--out", type=Path, default=Path("out/signals"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    names = tuple(given.runs or (COMMANDS if given.long else ("list", "plan")))
    moments = given.moments or (LONG if given.long else QUICK)
    report = study(moments, given.seed, names=names, processes=given.processes, until=given.until)
    write_json(given.out / "signals.json", report)
    print(
        f"{report['good']} of {report['moments']} moments good, {report['interrupted']} of them interrupted; "
        f"{report['python_start']} during Python's own start, the last one at "
        f"{report['python_start_until']} s; {len(report['faults'])} faults"
    )
    for row in report["faults"][:20]:
        print(f"  {row['run']} at {row['moment']} s, {row['signal']}: {row['result']}")
    return int(bool(report["faults"]) or (given.strict and bool(report["python_start"])))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
