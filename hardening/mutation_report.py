"""The report of a mutation check: scores with intervals, then every mutant that was not noticed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from preshape.report.values import Block, Chapter, Heading, Report, Table

if TYPE_CHECKING:
    from .mutants import Mutant, Project

KILLED, TIMEOUT, SURVIVED, UNCOVERED, SAME = "killed", "timeout", "survived", "uncovered", "equivalent"
NOTICED = (KILLED, TIMEOUT)


def summary(rows: Sequence[dict[str, Any]]) -> tuple[int, int, int, int, int, float | None, str]:
    """Mutants, noticed, survived, not covered and equivalent; the score and its 95 % interval (Wilson).

    The score is the share of noticed mutants among all that are not equivalent.
    """
    from preshape.physics.measures import wilson

    count = Counter(row["outcome"] for row in rows)
    noticed, counted = sum(count[name] for name in NOTICED), len(rows) - count[SAME]
    interval = wilson(noticed, counted)
    words = "" if interval is None else f"{interval[0]:.2f} to {interval[1]:.2f}"
    score = noticed / counted if counted else None
    return len(rows), noticed, count[SURVIVED], count[UNCOVERED], count[SAME], score, words


def report(project: Project, pairs: Sequence[tuple[Mutant, dict[str, Any]]], how: str) -> Report:
    """The report of a study: scores by module, then every mutant that was not noticed."""
    columns = (
        "module",
        "mutants",
        "noticed",
        "survived",
        "not covered",
        "equivalent",
        "score",
        "95 % interval",
    )
    rows = [row for _, row in pairs]
    by_module = [
        (name, *summary([row for mutant, row in pairs if mutant.module == name]))
        for name in sorted({mutant.module for mutant, _ in pairs})
    ]
    chapters = [
        Chapter(
            title="Modules",
            blocks=(Table(caption="", columns=columns, rows=(*by_module, ("all", *summary(rows)))),),
        )
    ]
    for title, outcome in (("Survivors", SURVIVED), ("Not covered", UNCOVERED), ("Equivalent", SAME)):
        blocks: list[Block] = []
        listed = [mutant for mutant, row in pairs if row["outcome"] == outcome]
        for mutant in sorted(listed, key=lambda m: (m.module, m.mutation.start)):
            place = f"{project.source}/{project.package}/{mutant.module}:{mutant.mutation.line}"
            blocks.append(Heading(text=f"`{place}` {mutant.mutation.operator}"))
            blocks.append(f"```diff\n{mutant.difference}\n```")
            if outcome == SAME:
                blocks.append(project.equivalent[mutant.change])
        chapters.append(Chapter(title=title, blocks=tuple(blocks) or ("None.",)))
    stopped = sum(row["outcome"] == TIMEOUT for row in rows)
    preface = (
        f"{how} A mutant is noticed if one of the tests that cover its statement fails"
        f"{f'; {stopped} were stopped because they took too long' if stopped else ''}. Tests: "
        f"{', '.join(project.tests)}."
    )
    return Report(title="Mutation check", preface=(preface,), chapters=tuple(chapters))
