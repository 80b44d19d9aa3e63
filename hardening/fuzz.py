"""Fuzzing of every reader; an interrupted run is resumed.

    python -m hardening.fuzz [READER …] [--runs 100000] [--out out/fuzz]

It needs atheris, which is not a dependency of the project: ``pip install atheris``.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from preshape.files import write_json

from .long_runs import show_progress
from .readers import READERS
from .seeds import CORPUS

RUNS = 100_000
KILLED = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
"""Signals from outside; they are no fault where the input at that moment does no harm."""
LAST = "last"
"""File of the input at which a process ended."""


def main(arguments: list[str]) -> int:
    """Run from the command line; returns 0 without faults, 1 with a fault, 3 without atheris."""
    known = sorted(folder.name for folder in CORPUS.iterdir())
    parser = argparse.ArgumentParser(prog="python -m hardening.fuzz", description="Fuzz the readers.")
    parser.add_argument("readers", nargs="*", metavar="READER", help=f"default: all of {', '.join(known)}")
    parser.add_argument(
        "--runs", type=int, default=RUNS, help="number of inputs for each reader (default: %(default)s)"
    )
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="folder (default: %(default)s)")
    parser.add_argument("--afresh", action="store_true", help="discard earlier runs")
    given = parser.parse_args(arguments)
    wrong = set(given.readers) - set(known)
    if wrong:
        parser.error(f"no reader {', '.join(sorted(wrong))}; known: {', '.join(known)}")
    if find_spec("atheris") is None:
        print("fuzzing needs atheris; run .venv/bin/pip install atheris", file=sys.stderr)
        return 3
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # also in the background
    rows = []
    for name in given.readers or known:
        work = given.out.resolve() / name
        if given.afresh:
            shutil.rmtree(work, ignore_errors=True)
        rows.append(fuzz(name, work, given.runs))
        write_json(given.out / f"{name}.json", rows[-1])
    print(
        f"\n{'reader':12} {'inputs':>8} {'read':>8} {'refused':>8} {'code reached':>12} {'slowest':>9} faults"
    )
    for row in rows:
        print(
            f"{row['reader']:12} {row['inputs']:8} {row['read']:8} {row['refused']:8} {row['reached']:12} "
            f"{1000 * row['slowest_s']:6.0f} ms {sum(row['faults'].values())}"
        )
    return int(any(row["faults"] for row in rows))


def fuzz(name: str, work: Path, runs: int) -> dict[str, Any]:
    """Run one reader with the wanted number of inputs; an input that ends the process counts as a fault.

    Args:
        name: Name of the reader.
        work: Folder of this reader.
        runs: Number of inputs, including those of earlier runs.
    """
    for folder in ("corpus", "faults", "ended"):
        (work / folder).mkdir(parents=True, exist_ok=True)
    total: dict[str, Any] = {
        "reader": name,
        "inputs": 0,
        "read": 0,
        "refused": 0,
        "reached": 0,
        "seconds": 0.0,
    }
    total |= {"kinds_of_refusal": 0, "slowest_s": 0.0, "memory_mb": 0, "faults": {}}
    store = work / "total.json"
    if store.is_file():
        total = json.loads(store.read_text())
    while total["inputs"] < runs:
        for file in (work / "tally.json", work / "ended" / LAST):
            file.unlink(missing_ok=True)
        begin, before = time.monotonic(), total["inputs"]
        code = _segment(name, work, runs, total)
        _add(total, work, time.monotonic() - begin)
        if -code in KILLED and _harmless(name, work):
            total["killed"] = total.get("killed", 0) + 1
        elif code:
            reason = _ending(work, code)
            total["faults"][reason] = total["faults"].get(reason, 0) + 1
            total["inputs"] = max(total["inputs"], before + 1)
            for file in [file for file in (work / "ended").iterdir() if file.name in (LAST, "log")]:
                file.rename(file.with_name(f"{file.name}-{total['inputs']}"))
        write_json(store, total)
        ends = sum(count for reason, count in total["faults"].items() if reason.startswith("ended"))
        if ends + total.get("killed", 0) > 50:
            break
    total["corpus"] = len(list((work / "corpus").iterdir()))
    return total


def _segment(name: str, work: Path, runs: int, total: dict[str, Any]) -> int:
    """Run one process; returns its exit code."""
    command = [sys.executable, "-m", "hardening.fuzz_one", name, str(work)]
    command += [f"-runs={runs - total['inputs']}", f"-seed={1 + total['inputs']}", "-print_final_stats=1"]
    command += [f"-artifact_prefix={work / 'ended'}/", str(work / "corpus"), str(CORPUS / name)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None  # a file system in memory is faster
    with (
        tempfile.TemporaryDirectory(prefix=f"fuzz-{name}-", dir=memory) as scratch,
        (work / "log").open("wb") as log,
    ):
        environment["TMPDIR"] = scratch
        process = subprocess.Popen(command, stdout=log, stderr=log, env=environment)
        begin, shown = time.monotonic(), 0.0
        try:
            while process.poll() is None:
                time.sleep(0.5)
                if time.monotonic() - shown > (2 if sys.stderr.isatty() else 30):
                    shown = time.monotonic()
                    _progress(name, total["inputs"], _tally(work).get("inputs", 0), runs, shown - begin)
        except KeyboardInterrupt:
            process.kill()
            process.wait()
            _add(total, work, time.monotonic() - begin)
            write_json(work / "total.json", total)
            raise SystemExit(130) from None
        last = Path(scratch) / name / READERS[name].file
        if process.returncode and last.is_file():
            shutil.copyfile(last, work / "ended" / LAST)
            shutil.copyfile(work / "log", work / "ended" / "log")
    _progress(name, total["inputs"], _tally(work).get("inputs", 0), runs, time.monotonic() - begin, last=True)
    return process.returncode


def _add(total: dict[str, Any], work: Path, seconds: float) -> None:
    """Add the figures of one process to those of the reader."""
    tally = _tally(work)
    log = (work / "log").read_bytes().decode("utf-8", "replace")
    for key in ("inputs", "read", "refused"):
        total[key] += tally.get(key, 0)
    for key in ("kinds_of_refusal", "slowest_s", "memory_mb"):
        total[key] = max(total[key], tally.get(key, 0))
    total["reached"] = max([total["reached"], *map(int, re.findall(r"cov: (\d+)", log))])
    total["seconds"] = round(total["seconds"] + seconds, 1)
    for kind, count in tally.get("faults", {}).items():
        total["faults"][kind] = total["faults"].get(kind, 0) + count


def _tally(work: Path) -> dict[str, Any]:
    try:
        return dict(json.loads((work / "tally.json").read_text()))
    except (OSError, ValueError):
        return {}


def _harmless(name: str, work: Path) -> bool:
    """Whether another process survives the last input; also true where there was no input."""
    last = work / "ended" / LAST
    if not last.is_file():
        return True
    command = [sys.executable, "-m", "hardening.fuzz_one", name, str(work), "-runs=1", str(last)]
    with tempfile.TemporaryDirectory() as scratch:
        environment = {**os.environ, "TMPDIR": scratch}
        return not subprocess.run(command, check=False, env=environment).returncode


def _ending(work: Path, code: int) -> str:
    """Why the process ended: libFuzzer's report, or the exit code."""
    log = (work / "log").read_bytes().decode("utf-8", "replace")
    found = re.search(r"SUMMARY: libFuzzer: (.*)|ERROR: libFuzzer: (.*)", log)
    return f"ended: {(found[1] or found[2])[:60] if found else f'without a report, code {code}'}"


def _progress(name: str, before: int, now: int, runs: int, seconds: float, *, last: bool = False) -> None:
    done = before + now
    left = f", about {(runs - done) * seconds / now / 60:.0f} min left" if now and not last else ""
    show_progress(f"{name}: {done} of {runs}{left}", last=last)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
