"""The memory under SIGKILL and under several processes at once.

Run as a script this file is a nursery: a process without threads that forks writers, kills them, and says
on standard output what it found. ``PRESHAPE_KILLS`` sets the number of kills.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from preshape.memory import Memory, records, schema
from preshape.types import Attributes, Experience, NetworkWeights

KILLS = int(os.environ.get("PRESHAPE_KILLS", "30"))
WRITERS = 3
BATCH = 3


def experience(writer: str, batch: int, part: int) -> Experience:
    """Everything in it follows from its name, so that what is read back can be checked."""
    rng = np.random.default_rng([*writer.encode(), batch, part])
    x, y, z = extents = rng.uniform(0.01, 0.2, 3)
    old = writer == "old"  # as migrated from version 1
    return Experience(
        kind="task",
        object_name=f"{writer}/{batch}/{part}",
        hand="utah_mit",
        attributes=Attributes(
            extents=extents,
            vertices=int(rng.integers(8, 99)),
            vertex_normals=6,
            faces=6,
            triangles=12,
            area=float(2 * (x * y + y * z + z * x) if old else rng.uniform()),
            volume=float(x * y * z if old else rng.uniform()),
        ),
        task=rng.uniform(-1.5, 1.5, 6),
        plane=int(rng.integers(1, 13)),
        flip=bool(rng.integers(2)),
        approach_value=float(rng.uniform(-1, 1)),
        approach_set=int(rng.integers(7)),
        fingers=int(rng.integers(2, 5)),
        wrench=rng.normal(size=6),
        match=float(rng.uniform(0, 6)),
    )


def weights(trained_on: int) -> NetworkWeights:
    rng = np.random.default_rng(trained_on)
    return NetworkWeights(
        w1=rng.normal(size=(45, 13)),
        b1=rng.normal(size=45),
        w2=rng.normal(size=(9, 45)),
        b2=rng.normal(size=9),
        mean_square_error=float(rng.uniform()),
        trained_on=trained_on,
        epochs=trained_on * 10,
    )


def same(a: Experience, b: Experience) -> bool:
    plain = (
        "kind",
        "object_name",
        "hand",
        "plane",
        "flip",
        "approach_value",
        "approach_set",
        "fingers",
        "match",
    )
    return (
        all(getattr(a, name) == getattr(b, name) for name in plain)
        and a.task.tobytes() == b.task.tobytes()
        and a.wrench.tobytes() == b.wrench.tobytes()
        and a.attributes.extents.tobytes() == b.attributes.extents.tobytes()
        and (a.attributes.vertices, a.attributes.area, a.attributes.volume)
        == (b.attributes.vertices, b.attributes.area, b.attributes.volume)
    )


def write(path: Path, writer: str, batches: int, acknowledge: int) -> None:
    """Add batches and acknowledge each through a pipe once ``add`` has returned."""
    with Memory.open(path) as memory:
        for batch in range(batches):
            ids = memory.add([experience(writer, batch, part) for part in range(BATCH)], weights(batch))
            os.write(acknowledge, f"{writer} {batch} {' '.join(map(str, ids))}\n".encode())


def fork(task: Callable[[], None]) -> int:
    child = os.fork()
    if child == 0:
        code = 1
        try:
            task()
            code = 0
        except BaseException as error:
            os.write(2, f"{type(error).__name__}: {error}\n".encode())
        finally:
            os._exit(code)
    return child


def started(path: Path, names: list[str], batches: int) -> tuple[list[int], int]:
    """Fork a writer for each name; their process ids and the end of the pipe to read."""
    read, acknowledge = os.pipe()
    children = [fork(lambda name=name: write(path, name, batches, acknowledge)) for name in names]  # type: ignore[misc]
    os.close(acknowledge)
    return children, read


def first_line(pipe: int) -> bytes:
    """What stands in the pipe once a writer has acknowledged something; empty if all ended before."""
    heard = b""
    while b"\n" not in heard and (more := os.read(pipe, 1)):
        heard += more
    return heard


def drained(pipe: int) -> list[list[str]]:
    with os.fdopen(pipe) as lines:
        return [line.split() for line in lines if line.endswith("\n")]


def faults(path: Path, acknowledged: dict[int, tuple[str, int, int]]) -> list[str]:
    """What is wrong with the memory, given what it acknowledged: id -> writer, batch, part."""
    found: list[str] = []
    if not path.exists() and not acknowledged:
        return found
    with Memory.open(path) as memory:
        experiences, stored = memory.experiences(), memory.weights("utah_mit")
    connection = sqlite3.connect(path)
    (verdict,) = connection.execute("PRAGMA integrity_check").fetchone()
    ids = [number for (number,) in connection.execute("SELECT id FROM experiences ORDER BY id")]
    connection.close()
    if verdict != "ok":
        found.append(f"integrity: {verdict}")
    by_id = dict(zip(ids, experiences, strict=True))
    for number, key in acknowledged.items():
        if number not in by_id or not same(by_id[number], experience(*key)):
            found.append(f"lost or changed: {number} {key}")
    batches: dict[str, set[str]] = {}
    for one in experiences:
        writer, batch, part = one.object_name.split("/")
        batches.setdefault(f"{writer}/{batch}", set()).add(part)
        if not same(one, experience(writer, int(batch), int(part))):
            found.append(f"changed: {one.object_name}")
    found += [f"torn: {name}" for name, parts in batches.items() if len(parts) != BATCH]
    if len(experiences) != sum(len(parts) for parts in batches.values()):
        found.append("stored twice")
    if experiences:
        largest = max(int(name.split("/")[1]) for name in batches)
        if stored is None and all(one.outdated for one in experiences):
            pass  # a migration deletes weights, and what is added next is stored with new ones
        elif stored is None or stored.trained_on != largest:
            found.append("weights and experiences of one transaction came apart")
        elif stored.w1.tobytes() != weights(largest).w1.tobytes():
            found.append("weights changed")
    return found


def kill_at_random(folder: Path, kills: int, seed: int) -> dict[str, object]:
    rng = random.Random(seed)
    found: list[str] = []
    acknowledged: dict[int, tuple[str, int, int]] = {}
    total = done = rounds = empty = 0
    path = folder / "memory.sqlite"
    while done < kills:
        if rounds % 4 == 0:  # a new file, so that its making is interrupted too
            path, acknowledged = folder / f"memory-{rounds}.sqlite", {}
        children, pipe = started(path, [f"{rounds}-{k}" for k in range(WRITERS)], 10**6)
        rng.shuffle(children)
        # Every fourth round, from the second on, the killing begins when something has been acknowledged,
        # however slow the machine is; the others begin at any moment.
        heard = first_line(pipe).decode() if rounds % 4 == 1 else ""
        for child in children:
            time.sleep(rng.uniform(0.0, 0.05) if rng.random() < 0.8 else 0.0)
            os.kill(child, signal.SIGKILL)
        for child in children:
            _, status = os.waitpid(child, 0)
            if not os.WIFSIGNALED(status):
                found.append(f"a writer ended by itself: {status}")
            done += 1
        lines = [line.split() for line in heard.splitlines()] + drained(pipe)
        empty += not lines
        for writer, batch, *ids in lines:
            for part, number in enumerate(ids):
                acknowledged[int(number)] = (writer, int(batch), part)
                total += 1
        found += faults(path, acknowledged)
        rounds += 1
    return {"faults": found, "kills": done, "acknowledged": total, "rounds without any": empty}


def make_version_1(path: Path) -> None:
    """A file of version 1 with one batch of a writer called old, as numbers 1 to BATCH."""
    path.parent.mkdir(exist_ok=True)
    connection = sqlite3.connect(path)
    for statement in schema._VERSION_1:
        connection.execute(statement)
    connection.execute(f"PRAGMA application_id = {schema.APPLICATION_ID}")
    connection.execute("PRAGMA user_version = 1")
    names = records.EXPERIENCE_COLUMNS[: records.EXPERIENCE_COLUMNS.index("area")]
    for part in range(BATCH):
        row = records.experience_row(experience("old", 0, part), "2024-05-06T07:08:09Z")[: len(names)]
        marks = ", ".join("?" * len(row))
        connection.execute(f"INSERT INTO experiences ({', '.join(names)}) VALUES ({marks})", row)
    connection.execute(
        f"INSERT INTO weights VALUES ({', '.join('?' * len(records.WEIGHT_COLUMNS))})",
        records.weights_row("utah_mit", weights(0)),
    )
    connection.commit()
    connection.close()


def kill_at_every_statement(folder: Path, version_1: int) -> dict[str, object]:
    """A process kills itself at its nth statement, n = 1, 2 … until it gets through."""
    found: list[str] = []
    n = 0
    survived = False
    while not survived:
        n += 1
        path = folder / f"memory-{version_1}-{n}.sqlite"
        if version_1:
            make_version_1(path)
        read, acknowledge = os.pipe()

        def task(path: Path = path, acknowledge: int = acknowledge, limit: int = n) -> None:
            connect, seen = schema.connect, 0

            def trace(statement: str) -> None:
                nonlocal seen
                seen += 1
                if seen == limit:
                    os.kill(os.getpid(), signal.SIGKILL)

            def traced(uri: str) -> sqlite3.Connection:
                connection = connect(uri)
                connection.set_trace_callback(trace)
                return connection

            schema.connect = traced  # type: ignore[assignment]
            write(path, "a", 1, acknowledge)

        child = fork(task)
        os.close(acknowledge)
        _, status = os.waitpid(child, 0)
        survived = not os.WIFSIGNALED(status)
        if survived and status != 0:
            found.append(f"failed: {status}")
        acknowledged = {
            int(number): (writer, int(batch), part)
            for writer, batch, *ids in drained(read)
            for part, number in enumerate(ids)
        }
        old = {part + 1: ("old", 0, part) for part in range(BATCH)} if version_1 else {}
        found += faults(path, acknowledged | old)
        with Memory.open(path) as memory:  # and it can be used
            memory.add([experience("b", 9, part) for part in range(BATCH)], weights(9))
    return {"faults": found, "statements": n - 1, "acknowledged": len(acknowledged)}


def race(folder: Path, processes: int, batches: int, rounds: int, version_1: int = 0) -> dict[str, object]:
    found: list[str] = []
    counts = []
    for turn in range(rounds):
        path = folder / "new" / f"memory-{turn}.sqlite"
        if version_1:
            make_version_1(path)
        children, pipe = started(path, [f"{turn}-{k}" for k in range(processes)], batches)
        lines = drained(pipe)
        found += [f"status {s}" for s in (os.waitpid(child, 0)[1] for child in children) if s]
        acknowledged = {
            int(number): (writer, int(batch), part)
            for writer, batch, *ids in lines
            for part, number in enumerate(ids)
        }
        found += faults(path, acknowledged)
        counts.append(len(acknowledged))
        copies = len(list(path.parent.glob(f"{path.name}.*backup*")))
        if copies != version_1:
            found.append(f"{copies} copies kept")
    return {"faults": found, "counts": counts}


MODES: dict[str, Callable[..., dict[str, object]]] = {
    "random": kill_at_random,
    "statements": kill_at_every_statement,
    "race": race,
}


def nursery(mode: str, folder: Path, *arguments: int) -> dict[str, object]:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", __file__, mode, str(folder), *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    report = dict(json.loads(done.stdout))
    assert report.pop("faults") == [], done.stderr
    assert done.stderr == ""
    return report


needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork and SIGKILL")


@needs_fork
def test_nothing_acknowledged_is_lost_when_writers_are_killed_at_random(tmp_path: Path) -> None:
    report = nursery("random", tmp_path, KILLS, 7)
    assert report["kills"] >= KILLS
    assert report["acknowledged"] > 0


@needs_fork
@pytest.mark.parametrize("version_1", [0, 1])
def test_killed_at_every_statement_of_making_migrating_and_adding(tmp_path: Path, version_1: int) -> None:
    report = nursery("statements", tmp_path, version_1)
    assert report["statements"] > 15  # type: ignore[operator]
    assert report["acknowledged"] == BATCH


@needs_fork
def test_two_processes_adding_at_once_lose_nothing(tmp_path: Path) -> None:
    assert nursery("race", tmp_path, 2, 40, 1)["counts"] == [2 * 40 * BATCH]


@needs_fork
def test_many_processes_may_make_the_same_new_file_at_once(tmp_path: Path) -> None:
    assert nursery("race", tmp_path, 6, 1, 8)["counts"] == [6 * BATCH] * 8


@needs_fork
def test_many_processes_may_migrate_the_same_file_at_once(tmp_path: Path) -> None:
    assert nursery("race", tmp_path, 6, 1, 4, 1)["counts"] == [6 * BATCH] * 4


if __name__ == "__main__":
    print(json.dumps(MODES[sys.argv[1]](Path(sys.argv[2]), *map(int, sys.argv[3:]))))
