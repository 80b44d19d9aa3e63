"""Counts of the memory, as ``memory show`` prints them."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterable, Sequence

from ..types import LONGEST_NAME, Experience, value
from .records import KINDS


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
        models: Each real hand with the number of models of it that the experiences are of, sorted; those
            of earlier memories, without the hash of a model, count as one.
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
    models: tuple[tuple[str, int], ...]
    trained: tuple[tuple[str, int], ...]
    oldest: str
    newest: str


def objects(experiences: Iterable[Experience]) -> tuple[ObjectSummary, ...]:
    """One summary for each object of these experiences, sorted by name."""
    of_name: dict[str, list[Experience]] = {}
    for experience in experiences:
        of_name.setdefault(experience.object_name, []).append(experience)
    return tuple(_summary(name, of_name[name]) for name in sorted(of_name))


def _summary(name: str, lessons: Sequence[Experience]) -> ObjectSummary:
    quality = max((e.quality for e in lessons if e.quality is not None), default=None)
    virtual = max((e.match for e in lessons if e.quality is None), default=None)
    return ObjectSummary(
        name=name,
        hands=tuple(sorted({e.hand for e in lessons})),
        experiences=len(lessons),
        tasks=len({tuple(e.task.tolist()) for e in lessons}),
        best_match=max(e.match for e in lessons),
        best_quality=quality,
        best=", ".join(
            f"{measure} {number:.2f}"
            for measure, number in (("quality", quality), ("TFVADI", virtual))
            if number is not None
        ),
        seed=all(e.kind == "seed" for e in lessons),
        last_seen=max(e.created for e in lessons),
    )


def statistics(
    connection: sqlite3.Connection, where: str, experiences: Sequence[Experience]
) -> MemoryStatistics:
    """Counts and sizes; called inside the transaction that read the experiences."""
    run = connection.execute
    kinds, hands = (Counter(getattr(e, name) for e in experiences) for name in ("kind", "hand"))
    models = Counter(hand for hand, _ in {(e.hand, e.model) for e in experiences if e.grip is not None})
    trained = run(
        "SELECT hand, trained_on FROM weights WHERE typeof(hand) = 'text' AND length(hand) <= ?"
        " AND typeof(trained_on) = 'integer' ORDER BY hand",
        (LONGEST_NAME,),
    ).fetchall()
    (version,) = run("PRAGMA user_version").fetchone()
    (pages,), (page,) = run("PRAGMA page_count").fetchone(), run("PRAGMA page_size").fetchone()
    return MemoryStatistics(
        path=where,
        version=version,
        size=pages * page,
        experiences=len(experiences),
        objects=len({e.object_name for e in experiences}),
        kinds=tuple((kind, kinds[kind]) for kind in KINDS),
        hands=tuple(sorted(hands.items())),
        models=tuple(sorted(models.items())),
        trained=tuple(trained),
        oldest=min((e.created for e in experiences), default=""),
        newest=max((e.created for e in experiences), default=""),
    )
