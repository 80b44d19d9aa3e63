"""Plans for many objects in one run: no crash, no hang, a reason for every refusal; time and memory of each.

    python -m hardening.objects [FOLDER] [--hands utah_mit,shadow] [--task lift] [--out out/objects]

FOLDER holds URDF files that name a mesh each, or mesh files, at any depth. Without it, the thousand random
objects of the PyPI package ``pybullet`` are used where that is installed (it is not a dependency). An
interrupted run is resumed.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from preshape.files import write_json
from preshape.objects.load import SUFFIXES

from .long_runs import show_progress, stored_rows

HANG = 180.0
"""Time after which an object counts as hanging [s]; the machine may be busy with other work."""
QUANTILES = (50, 90, 99, 100)
ANSWER, NONE, REFUSED, CRASHED, HUNG = "answer", "no answer", "refused", "crashed", "hung"


def found_objects(folder: Path) -> list[tuple[str, Path, float]]:
    """Name, mesh file and scale of every object in a folder, sorted."""
    rows = []
    for urdf in sorted(folder.rglob("*.urdf")):
        mesh = ElementTree.parse(urdf).getroot().find(".//mesh")
        if mesh is not None:
            factor = float(mesh.get("scale", "1").split()[0])
            rows.append((urdf.stem, urdf.parent / mesh.get("filename", ""), factor))
    if not rows:
        files = sorted(file for file in folder.rglob("*") if file.suffix.lower() in SUFFIXES)
        rows = [(str(file.relative_to(folder)), file, 1.0) for file in files]
    return rows


def default_folder() -> Path | None:
    """The folder of the thousand objects of pybullet, where it is installed."""
    spec = find_spec("pybullet_data")
    places = spec.submodule_search_locations if spec is not None else None
    return next((Path(place) / "random_urdfs" for place in places or ()), None)


def serve(hand: str, task: str, memory: str) -> None:
    """Plan for the objects named on standard input; write one JSON line for each to standard output."""
    from preshape import plan
    from preshape.exceptions import PreshapeError
    from preshape.memory import Memory
    from preshape.planning.request import RAY_HAND
    from preshape.types import FIELD_MASS

    mass = None if hand == RAY_HAND else FIELD_MASS  # the ray analyser knows no loads
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # other prints go to standard error
    with Memory.open(memory, read_only=True) as store:
        for line in sys.stdin:
            name, file, factor = json.loads(line)
            row: dict[str, Any] = {"name": name, "reason": ""}
            _reset_peak()
            begin, work = time.perf_counter(), time.process_time()
            try:
                made = plan(
                    file, task, hand=hand, scale=factor, mass=mass, table=None, memory=store, learn=False
                )
            except PreshapeError as error:
                row |= {"outcome": REFUSED, "reason": str(error)}
            except Exception as error:
                row |= {"outcome": CRASHED, "reason": f"{type(error).__name__}: {error}"}
            else:
                status = made.decision.status.value
                row |= {"outcome": ANSWER if status == "answer" else NONE, "status": status}
                row |= {"mode": made.decision.mode, "reason": made.decision.reason}
                reached = made.hand_result
                row["hand"] = None if reached is None else reached.status.name.lower()
            row["seconds"] = round(time.perf_counter() - begin, 4)
            row["work_seconds"] = round(time.process_time() - work, 4)
            row["memory_mb"] = _peak()
            print(json.dumps(row), file=answers)


def _reset_peak() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak() -> int | None:
    """Peak memory since the last reset [MB]; ``None`` where the system does not report it."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) // 1024
    return None


class Server:
    """A worker process that plans and may crash."""

    def __init__(self, hand: str, task: str, memory: Path) -> None:
        command = [sys.executable, "-m", "hardening.objects", "--serve", hand, task, str(memory)]
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=environment,
        )
        self.lines: queue.Queue[str] = queue.Queue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.put(line)
        self.lines.put("")

    def ask(self, name: str, file: Path, factor: float) -> dict[str, Any]:
        """Plan for one object; returns its row."""
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.write(json.dumps([name, str(file), factor]) + "\n")
            self.process.stdin.flush()
        try:
            line = self.lines.get(timeout=HANG)
        except queue.Empty:
            return {
                "name": name,
                "outcome": HUNG,
                "reason": f"not finished after {HANG:.0f} s",
                "seconds": HANG,
            }
        if line:
            return dict(json.loads(line))
        code = self.process.wait()
        return {"name": name, "outcome": CRASHED, "reason": f"the process ended with {code}", "seconds": 0.0}

    def end(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.wait()
        self._reader.join()
        for stream in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(BrokenPipeError):
                if stream is not None:
                    stream.close()


def run(rows: list[tuple[str, Path, float]], hand: str, task: str, out: Path) -> dict[str, Any]:
    """Plan with one hand for every object that an earlier run has not planned for, and summarise."""
    out.mkdir(parents=True, exist_ok=True)
    store, memory = out / f"{hand}.jsonl", out / f"{hand}.sqlite"
    done = {row["name"]: row for row in stored_rows(store)}
    if not memory.exists():
        from preshape import plan

        plan("cube", task, hand=hand, table=None, memory=memory)
    server, begin, shown, before = Server(hand, task, memory), time.monotonic(), 0.0, len(done)
    try:
        with store.open("a") as file:
            for name, mesh, factor in rows:
                if name in done:
                    continue
                row = server.ask(name, mesh, factor)
                done[name] = row
                file.write(json.dumps(row) + "\n")
                file.flush()
                if row["outcome"] == HUNG or server.process.poll() is not None:
                    server.end()
                    server = Server(hand, task, memory)
                now = time.monotonic()
                if now - shown > (0.5 if sys.stderr.isatty() else 30) or len(done) == len(rows):
                    shown = now
                    _progress(hand, len(done), len(rows), (now - begin) / (len(done) - before))
    finally:
        server.end()
    return summary(hand, [done[name] for name, _, _ in rows])


def summary(hand: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The results in numbers; ``work_seconds`` is CPU time."""
    import numpy as np

    outcomes = Counter(row["outcome"] for row in rows)
    peaks = [row["memory_mb"] for row in rows if row.get("memory_mb") is not None]
    planned = [row for row in rows if row["outcome"] in (ANSWER, NONE)]
    seconds = [row["seconds"] for row in planned]
    work = [row["work_seconds"] for row in planned if "work_seconds" in row]
    without = [row["name"] for row in rows if row["outcome"] in (NONE, REFUSED) and not row["reason"].strip()]
    return {
        "hand": hand,
        "objects": len(rows),
        "outcomes": {name: outcomes[name] for name in (ANSWER, NONE, REFUSED, CRASHED, HUNG)},
        "without_reason": without,
        "reached": sum(row.get("hand") == "reached" for row in rows),
        "modes": dict(sorted(Counter(str(row.get("mode")) for row in rows if "mode" in row).items())),
        "seconds": {f"p{q}": round(float(np.percentile(seconds or [0.0], q)), 3) for q in QUANTILES},
        "work_seconds": {f"p{q}": round(float(np.percentile(work or [0.0], q)), 3) for q in QUANTILES},
        "memory_mb": {f"p{q}": int(np.percentile(peaks or [0], q)) for q in QUANTILES},
        "wrong": [row for row in rows if row["outcome"] in (CRASHED, HUNG)],
        "refused": [row for row in rows if row["outcome"] == REFUSED][:20],
    }


def _progress(hand: str, done: int, total: int, each: float) -> None:
    left = f", about {(total - done) * each / 60:.0f} min left" if done < total else ""
    show_progress(f"{hand}: {done} of {total} objects{left}", last=done >= total)


def main(arguments: list[str]) -> int:
    """Run from the command line; returns 0 where all is well, 1 for a crash or hang, 2 without objects."""
    if arguments[:1] == ["--serve"]:
        serve(*arguments[1:])
        return 0
    parser = argparse.ArgumentParser(prog="python -m hardening.objects", description="Plan for many objects.")
    parser.add_argument("folder", nargs="?", type=Path, default=default_folder(), help="URDF or mesh files")
    parser.add_argument("--hands", default="utah_mit,shadow", help="default: %(default)s")
    parser.add_argument("--task", default="lift", help="default: %(default)s")
    parser.add_argument("--limit", type=int, help="largest number of objects")
    parser.add_argument("--out", type=Path, default=Path("out/objects"), help="default: %(default)s")
    given = parser.parse_args(arguments)
    rows = found_objects(given.folder)[: given.limit] if given.folder is not None else []
    if not rows:
        print(
            f"no objects in {given.folder}; give a folder with URDF or mesh files, such as the thousand "
            "random objects of pybullet: pip download --no-deps pybullet, unpack it, give "
            "pybullet_data/random_urdfs",
            file=sys.stderr,
        )
        return 2
    wrong = False
    try:
        for hand in given.hands.split(","):
            found = run(rows, hand, given.task, given.out)
            write_json(given.out / f"{hand}.json", found)
            wrong |= bool(found["wrong"] or found["without_reason"])
            counts = ", ".join(f"{count} {name}" for name, count in found["outcomes"].items())
            print(
                f"{hand}: {found['objects']} objects: {counts}; {len(found['without_reason'])} without reason"
            )
            for what, unit in (("seconds", "s"), ("work_seconds", "s"), ("memory_mb", "MB")):
                print(f"  {what}: " + ", ".join(f"{q} {value} {unit}" for q, value in found[what].items()))
    except KeyboardInterrupt:
        print("\ninterrupted; the same command resumes from here", file=sys.stderr)
        return 130
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
