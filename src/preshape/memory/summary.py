"""Counts of the memory, as ``memory show`` prints them."""

from __future__ import annotations

import sqlite3

from ..types import value
from .records import KINDS

_OF_HAND = "WHERE ?1 IS NULL OR hand = ?1"


@value
class ObjectSummary:
    """What the memory holds about one object.

    Attributes:
        name: Name of the object.
        hands: Hands with experiences of it, sorted.
        experiences: Number of experiences.
        tasks: Number of different tasks among them.
        best_match: Largest TFVADI among the experiences, 0..6.
        best_quality: Largest quality among the grips of real hands, 0..6; ``None`` without one.
        best: Largest score with its name: quality of grips, TFVADI of virtual grasps.
        seed: Whether all experiences are of the first lesson, which every hand gets before its first object.
        last_seen: Time at which the newest experience was stored, ISO 8601 in UTC.
    """

    name: str
    hands: tuple[str, ...]
    experiences: int
    tasks: int
    best_match: float
    best_quality: float | None
    best: str
    seed: bool
    last_seen: str


@value
class MemoryStatistics:
    """Counts and sizes of the memory.

    Attributes:
        path: The file, or ``:memory:``.
        version: Schema version.
        size: Size of the database [bytes].
        experiences: Number of experiences.
        objects: Number of different objects.
        kinds: Each kind with its number of experiences, in the order of ``KINDS``.
        hands: Each hand with its number of experiences, sorted.
        trained: Each hand with the number of samples that its weights were trained on, sorted.
        oldest: Time at which the oldest experience was stored; empty if there is none.
        newest: Time at which the newest experience was stored; empty if there is none.
    """

    path: str
    version: int
    size: int
    experiences: int
    objects: int
    kinds: tuple[tuple[str, int], ...]
    hands: tuple[tuple[str, int], ...]
    trained: tuple[tuple[str, int], ...]
    oldest: str
    newest: str


def objects(connection: sqlite3.Connection, hand: str | None) -> tuple[ObjectSummary, ...]:
    """One summary for each object, sorted by name; called inside a transaction for consistent counts.

    Raises:
        sqlite3.DatabaseError: A column holds a value of another kind, as in a file that was tampered with.
    """
    hands: dict[str, list[str]] = {}
    for name, owner in connection.execute(
        f"SELECT DISTINCT object_name, hand FROM experiences {_OF_HAND} ORDER BY hand", (hand,)
    ):
        hands.setdefault(name, []).append(owner)
    tasks: dict[str, int] = {}
    for name, *_ in connection.execute(
        "SELECT DISTINCT object_name, task_tx, task_ty, task_tz, task_rx, task_ry, task_rz"
        f" FROM experiences {_OF_HAND}",
        (hand,),
    ):
        tasks[name] = tasks.get(name, 0) + 1
    rows = connection.execute(
        "SELECT object_name, count(*), max(match), max(created), max(quality),"
        " max(CASE WHEN quality IS NULL THEN match END), min(kind = 'seed')"
        f" FROM experiences {_OF_HAND} GROUP BY object_name ORDER BY object_name",
        (hand,),
    ).fetchall()
    for name, _, *scores, seen, quality, virtual, _ in rows:
        numbers = [*scores, *(score for score in (quality, virtual) if score is not None)]
        words = [name, seen, *hands.get(name, [None])]  # a damaged index may list other names
        if (
            name not in tasks
            or not all(isinstance(x, float | int) for x in numbers)
            or not all(isinstance(x, str) for x in words)
        ):
            raise sqlite3.DatabaseError(f"a lesson of {name!r:.60} has text or bytes in the wrong column")
    return tuple(
        ObjectSummary(
            name=name,
            hands=tuple(hands[name]),
            experiences=count,
            tasks=tasks[name],
            best_match=best,
            best_quality=quality,
            best=", ".join(
                f"{measure} {number:.2f}"
                for measure, number in (("quality", quality), ("TFVADI", virtual))
                if number is not None
            ),
            seed=bool(seed),
            last_seen=seen,
        )
        for name, count, best, seen, quality, virtual, seed in rows
    )


def statistics(connection: sqlite3.Connection, where: str) -> MemoryStatistics:
    """Counts and sizes; called inside a transaction, so that they are consistent."""
    run = connection.execute
    total, names, oldest, newest = run(
        "SELECT count(*), count(DISTINCT object_name), min(created), max(created) FROM experiences"
    ).fetchone()
    kinds = dict(run("SELECT kind, count(*) FROM experiences GROUP BY kind").fetchall())
    hands = run("SELECT hand, count(*) FROM experiences GROUP BY hand ORDER BY hand").fetchall()
    trained = run("SELECT hand, trained_on FROM weights ORDER BY hand").fetchall()
    (version,) = run("PRAGMA user_version").fetchone()
    (pages,), (page,) = run("PRAGMA page_count").fetchone(), run("PRAGMA page_size").fetchone()
    return MemoryStatistics(
        path=where,
        version=version,
        size=pages * page,
        experiences=total,
        objects=names,
        kinds=tuple((kind, kinds.get(kind, 0)) for kind in KINDS),
        hands=tuple(hands),
        trained=tuple(trained),
        oldest=oldest or "",
        newest=newest or "",
    )
