"""The memory in numbers: what ``memory show`` prints."""

from __future__ import annotations

import sqlite3

from ..types import value
from .records import KINDS

_OF_HAND = "WHERE ?1 IS NULL OR hand = ?1"


@value
class ObjectSummary:
    """What the memory holds about one object.

    Attributes:
        name: the object's name.
        hands: the hands that have met it, sorted.
        experiences: how many experiences.
        tasks: how many different tasks among them.
        best_match: the largest TFVADI among them, 0..6.
        last_seen: when the newest was stored, ISO 8601 in UTC.
    """

    name: str
    hands: tuple[str, ...]
    experiences: int
    tasks: int
    best_match: float
    last_seen: str


@value
class MemoryStatistics:
    """The memory in numbers.

    Attributes:
        path: the file, or ``:memory:``.
        version: schema version.
        size: of the database [bytes].
        experiences: how many experiences.
        objects: how many different objects.
        kinds: kind and number of experiences of it, in the order of ``KINDS``.
        hands: hand and number of experiences of it, sorted.
        trained: hand and number of samples behind its weights, sorted.
        oldest: when the oldest experience was stored; empty without any.
        newest: when the newest was.
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
    """One summary for each object, sorted by name; inside a transaction, so that they agree."""
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
        "SELECT object_name, count(*), max(match), max(created)"
        f" FROM experiences {_OF_HAND} GROUP BY object_name ORDER BY object_name",
        (hand,),
    )
    return tuple(
        ObjectSummary(
            name=name,
            hands=tuple(hands[name]),
            experiences=count,
            tasks=tasks[name],
            best_match=best,
            last_seen=seen,
        )
        for name, count, best, seen in rows
    )


def statistics(connection: sqlite3.Connection, where: str) -> MemoryStatistics:
    """The memory in numbers; inside a transaction, so that they agree."""
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
