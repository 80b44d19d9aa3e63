"""Processes learn into one memory file and are killed at random moments: no acknowledged lesson is lost.

    python -m hardening.kill [--kills 200] [--writers 4] [--seed 7] [--out out/kill]

Each process learns one box after another, as ``preshape learn`` does, and acknowledges each lesson after it
has returned. After each round of kills the file is checked: SQLite finds it intact, every acknowledged
lesson is there as it was learnt, no lesson is incomplete, and all rows and the weights can be used.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from contextlib import closing
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from preshape.files import write_json
from preshape.memory import Memory
from preshape.objects.mesh import TriangleMesh
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session
from preshape.tasks import parse_task
from preshape.types import ANSWER_KIND

from .long_runs import show_progress

HAND = "utah_mit"
TASKS = ("lift", "push:+x", "turn:+z")
KINDS = Counter(["task", "best", "landmark"])
"""Experiences of every lesson; some lessons also store the best answer."""
STORED = Counter([ANSWER_KIND])
ROUNDS = 5
"""Rounds of kills with one file. Then a new file follows, so that its creation is interrupted too."""
LONGEST = 8.0
"""Time until the last process of a round is killed [s]."""

_SIDES = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
_QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def box(name: str) -> TriangleMesh:
    """A box whose size follows from its name, so that lessons in the memory can be checked."""
    extents = np.random.default_rng([*name.encode()]).uniform(0.02, 0.08, 3)
    triangles = [triangle for a, b, c, d in _QUADS for triangle in ((a, b, c), (a, c, d))]
    return TriangleMesh(name=name, vertices=_SIDES * extents, triangles=np.array(triangles))


def task_of(name: str) -> str:
    """The task of a lesson, which also follows from its name."""
    return TASKS[sum(name.encode()) % len(TASKS)]


def learn(path: Path, writer: str, acknowledge: int) -> None:
    """Learn boxes until the process is killed; write the name of each to a pipe after it was learnt."""
    with Session(path) as session:
        for number in range(10**6):
            name = f"{writer}-{number}"
            ready = session.prepare(PlanRequest(source=box(name), task=task_of(name), hand=HAND))
            decision = ready.controller.teach(ready.element, ready.task)
            ready.controller.reset()
            if decision.best is not None:
                os.write(acknowledge, f"{name}\n".encode())


def forked(path: Path, writer: str, acknowledge: int) -> int:
    """Start a process that learns; returns its process id."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            learn(path, writer, acknowledge)
            code = 0
        except BaseException as error:
            os.write(2, f"{type(error).__name__}: {error}\n".encode())
        finally:
            os._exit(code)
    return child


def faults(path: Path, acknowledged: set[str]) -> list[str]:
    """Every fault of the memory, in words."""
    if not path.exists():
        return [f"lost: {name}" for name in acknowledged]
    with Memory.open(path) as memory:
        experiences, weights = memory.experiences(HAND), memory.weights(HAND)
    with closing(sqlite3.connect(path)) as connection:
        verdict = connection.execute("PRAGMA integrity_check").fetchone()[0]
    found = [] if verdict == "ok" else [f"damaged: {verdict}"]
    lessons: dict[str, Counter[str]] = {}
    for one in experiences:
        if one.kind == "seed" or one.object_name == "cube":
            continue
        lessons.setdefault(one.object_name, Counter())[one.kind] += 1
        if not np.array_equal(one.attributes.extents, box(one.object_name).extents):
            found.append(f"changed: {one.object_name}")
        asked = parse_task(task_of(one.object_name)).q
        if one.kind == "task" and not np.array_equal(one.task, asked):
            found.append(f"another task: {one.object_name}")
    found += [f"lost: {name}" for name in sorted(acknowledged - set(lessons))]
    found += [f"incomplete lesson: {name}" for name, kinds in lessons.items() if kinds - STORED != KINDS]
    if lessons and (weights is None or not weights.trained_on):
        found.append("experiences without weights")
    return found


def study(folder: Path, kills: int, writers: int, seed: int, *, longest: float = LONGEST) -> dict[str, Any]:
    """Kill learning processes and report.

    Args:
        folder: Folder for the memory files.
        kills: Number of processes to kill.
        writers: Number of processes that learn at the same time.
        seed: Seed of the moments of the kills.
        longest: Time until the last process of a round is killed [s].
    """
    for module in ("scipy.optimize", "trimesh", "embreex", "preshape.hiis.virtual_grasp"):
        import_module(module)  # imported here, so that the processes are killed while they learn
    rng = random.Random(seed)
    report: dict[str, Any] = {"kills": 0, "rounds": 0, "acknowledged": 0, "at_work": 0, "faults": []}
    path, acknowledged, begin, shown = folder / "none", set[str](), time.monotonic(), 0.0
    while report["kills"] < kills:
        number = report["rounds"]
        if number % ROUNDS == 0:
            path, acknowledged = folder / f"memory-{number}.sqlite", set()
        read, write = os.pipe()
        children = [forked(path, f"{number}-{k}", write) for k in range(writers)]
        os.close(write)
        start = time.monotonic()
        for moment, child in sorted((rng.uniform(0.0, longest), child) for child in children):
            time.sleep(max(0.0, start + moment - time.monotonic()))
            os.kill(child, signal.SIGKILL)
        for child in children:
            _, status = os.waitpid(child, 0)
            if not os.WIFSIGNALED(status):
                report["faults"].append(f"a learner ended by itself: {status}")
        with os.fdopen(read) as lines:
            names = {line.strip() for line in lines if line.endswith("\n")}
        acknowledged |= names
        report["acknowledged"] += len(names)
        report["at_work"] += sum(any(n.startswith(f"{number}-{k}-") for n in names) for k in range(writers))
        report["faults"] += faults(path, acknowledged)
        report["kills"] += len(children)
        report["rounds"] += 1
        if time.monotonic() - shown > (0.5 if sys.stderr.isatty() else 30):
            shown = time.monotonic()
            _progress(report["kills"], kills, shown - begin)
    report["seconds"] = round(time.monotonic() - begin, 1)
    return report


def _progress(done: int, total: int, seconds: float) -> None:
    left = max(0.0, (total - done) * seconds / done / 60)
    show_progress(f"{done} of {total} kills, about {left:.0f} min left")


def main(arguments: list[str]) -> int:
    """Run from the command line; returns 0 where nothing was lost, else 1."""
    parser = argparse.ArgumentParser(prog="python -m hardening.kill", description="Kill learning processes.")
    parser.add_argument("--kills", type=int, default=200, help="number of kills (default: %(default)s)")
    parser.add_argument("--writers", type=int, default=4, help="processes at a time (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=7, help="seed of the moments (default: %(default)s)")
    parser.add_argument(
        "--longest",
        type=float,
        default=LONGEST,
        help="time to a round's last kill [s] (default: %(default)s)",
    )
    parser.add_argument("--out", type=Path, default=Path("out/kill"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="preshape-kill-") as folder:
        report = study(Path(folder), given.kills, given.writers, given.seed, longest=given.longest)
    write_json(given.out / "kill.json", report)
    print(
        f"\n{report['kills']} kills of {given.writers} processes at a time, {report['at_work']} of them "
        f"after the first lesson; {report['acknowledged']} lessons acknowledged; {len(report['faults'])} "
        "faults"
    )
    for fault in report["faults"][:20]:
        print(f"  {fault}")
    return int(bool(report["faults"]))


if __name__ == "__main__":
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    sys.exit(main(sys.argv[1:]))
