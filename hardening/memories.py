"""Memory files from anybody: absurd cells, foreign schemas, damaged bytes, and first runs side by side.

    python -m hardening.memories [--long] [--seed 7] [--out out/memories]

- Each cell of a lesson gets values that it cannot have. The hand must answer as before, with a warning that
  names the lesson, or the memory must be refused in one sentence that names it.
- Each schema that is not ours must be refused, and the file must stay as it was.
- A file with changed bytes must be read or refused (``--long``).
- Processes that use a hand for the first time at the same moment must store its first lesson once.

Warnings of NumPy count as faults.
"""

from __future__ import annotations

import argparse
import multiprocessing
import random
import shutil
import sqlite3
import sys
import tempfile
import warnings
from contextlib import closing
from pathlib import Path
from typing import Any

from preshape.exceptions import PreshapeError
from preshape.files import write_json
from preshape.memory import Memory
from preshape.memory.records import EXPERIENCE_COLUMNS
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session

from .long_runs import show_progress

REQUEST = PlanRequest(source="mug", task="pour", hand="utah_mit")
ABSURD: tuple[Any, ...] = (1e308, -1e308, 0.0)
MORE_ABSURD: tuple[Any, ...] = (
    5e-324,
    float("inf"),
    -1,
    2**63 - 1,
    "text",
    "",
    None,
    b"",
    bytes(224),
    b"\xff" * 72,
)
SCHEMAS = (
    "CREATE TRIGGER t AFTER INSERT ON experiences BEGIN DELETE FROM weights; END",
    "CREATE TRIGGER t BEFORE UPDATE ON weights BEGIN SELECT RAISE(IGNORE); END",
    "CREATE VIEW v AS SELECT * FROM weights",
    "CREATE TABLE t (a)",
    "CREATE VIRTUAL TABLE t USING fts5(a)",
    "CREATE VIRTUAL TABLE t USING rtree(a, b, c)",
    "CREATE INDEX i ON experiences (abs(match))",
    "CREATE UNIQUE INDEX i ON experiences (id)",
    "DROP TABLE weights",
    "DROP INDEX experiences_by_hand",
    "DROP TABLE weights; CREATE VIEW weights AS SELECT * FROM experiences",
    "ALTER TABLE experiences ADD COLUMN a",
    "ALTER TABLE experiences ADD COLUMN a AS (zeroblob(1000000000))",
    "ALTER TABLE experiences RENAME COLUMN match TO matched",
)
SIDE_BY_SIDE = (2, 6)


def taught(path: Path) -> None:
    """Make a memory that knows the first lesson and a mug."""
    with Session(path) as session:
        session.teach(REQUEST)


def use(path: Path) -> str:
    """Plan with a memory; what is wrong with how that went, or nothing."""
    try:
        with warnings.catch_warnings(), Session(path) as session:
            warnings.simplefilter("error")
            plan = session.run(REQUEST)
            if session.memory.skipped and not any("experience" in told for told in plan.warnings):
                return "skipped a lesson without a word"
            return "" if plan.answer is not None else "no answer"
    except PreshapeError as error:
        return "" if str(path) in str(error) and "\n" not in str(error) else f"a poor refusal: {error}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def absurd_cells(folder: Path, model: Path, values: tuple[Any, ...]) -> list[str]:
    """Put each value into each column of one lesson, and use the memory."""
    found, path = [], folder / "cell.sqlite"
    for column in EXPERIENCE_COLUMNS:
        show_progress(f"absurd values in {column}")
        for value in values:
            shutil.copy(model, path)
            with closing(sqlite3.connect(path)) as connection, connection:
                try:
                    connection.execute(
                        f"UPDATE experiences SET {column} = ? WHERE id = (SELECT max(id) FROM experiences"
                        " WHERE kind = 'task')",
                        (value,),
                    )
                except sqlite3.IntegrityError:  # a NULL that SQLite itself refuses
                    continue
            wrong = use(path)
            found += [f"{column} = {value!r:.40}: {wrong}"] if wrong else []
    return found


def foreign_schemas(folder: Path, model: Path) -> list[str]:
    """Add what is not ours to the schema, and open the memory."""
    found, path = [], folder / "schema.sqlite"
    for statement in SCHEMAS:
        shutil.copy(model, path)
        with closing(sqlite3.connect(path, isolation_level=None)) as connection:
            connection.executescript(statement)
        before = path.read_bytes()
        for read_only in (False, True):
            try:
                Memory.open(path, read_only=read_only).close()
                found.append(f"opened: {statement}")
            except PreshapeError as error:
                found += [] if str(path) in str(error) else [f"a poor refusal: {statement}: {error}"]
        found += [] if path.read_bytes() == before else [f"changed: {statement}"]
    return found


def changed_bytes(folder: Path, model: Path, count: int, seed: int) -> list[str]:
    """Change a few bytes of the file, and use it."""
    rng, found, path = random.Random(seed), [], folder / "bytes.sqlite"
    for number in range(count):
        show_progress(f"{number} of {count} files with changed bytes")
        content = bytearray(model.read_bytes())
        for _ in range(rng.choice((1, 4, 64))):
            content[rng.randrange(100, len(content))] = rng.randrange(256)
        path.write_bytes(content)
        for beside in folder.glob("bytes.sqlite-*"):
            beside.unlink()
        wrong = use(path)
        found += [f"changed bytes {number} (seed {seed}): {wrong}"] if wrong not in ("", "no answer") else []
    return found


def _first_run(path: Path, gate: Any) -> None:
    gate.wait()
    with Session(path) as session:
        session.prepare(REQUEST)


def side_by_side(folder: Path, rounds: int) -> list[str]:
    """Use a hand for the first time in several processes at the same moment."""
    context, found = multiprocessing.get_context("fork"), []
    for turn in range(rounds):
        for processes in SIDE_BY_SIDE:
            show_progress(f"first runs side by side, {turn + 1} of {rounds}")
            gate, path = context.Barrier(processes), folder / f"first-{turn}-{processes}.sqlite"
            children = [context.Process(target=_first_run, args=(path, gate)) for _ in range(processes)]
            for child in children:
                child.start()
            for child in children:
                child.join()
            codes = {child.exitcode for child in children}
            with Memory.open(path) as memory:
                seeds = [e.task.tobytes() for e in memory.experiences(kinds=["seed"])]
            if codes != {0} or len(seeds) != len(set(seeds)) or not seeds:
                found.append(f"{processes} first runs: exit codes {codes}, {len(seeds)} lessons of the cube")
    return found


def study(folder: Path, *, long: bool, seed: int) -> dict[str, Any]:
    """Run everything; the report says how much was tried and which faults were found.

    Args:
        folder: Folder for the memory files.
        long: Whether to try more values, files and rounds.
        seed: Seed of the changed bytes.
    """
    model = folder / "model.sqlite"
    taught(model)
    values = ABSURD + (MORE_ABSURD if long else ())
    files, rounds = (500, 10) if long else (0, 1)
    faults = absurd_cells(folder, model, values)
    faults += foreign_schemas(folder, model)
    faults += changed_bytes(folder, model, files, seed)
    faults += side_by_side(folder, rounds)
    return {
        "cells": len(EXPERIENCE_COLUMNS) * len(values),
        "schemas": len(SCHEMAS),
        "files": files,
        "first runs": rounds * sum(SIDE_BY_SIDE),
        "faults": faults,
    }


def main(arguments: list[str]) -> int:
    """Run from the command line; returns 0 without a fault, else 1."""
    parser = argparse.ArgumentParser(prog="python -m hardening.memories", description="Hostile memory files.")
    parser.add_argument("--long", action="store_true", help="more values, files and rounds")
    parser.add_argument(
        "--seed", type=int, default=7, help="seed of the changed bytes (default: %(default)s)"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/memories"), help="folder (default: %(default)s)"
    )
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="preshape-memories-") as folder:
        report = study(Path(folder), long=given.long, seed=given.seed)
    write_json(given.out / "memories.json", report)
    faults = report["faults"]
    print(
        f"\n{report['cells']} absurd cells, {report['schemas']} schemas, {report['files']} files with "
        f"changed bytes, {report['first runs']} first runs side by side; {len(faults)} faults"
    )
    for fault in faults[:20]:
        print(f"  {fault}")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
