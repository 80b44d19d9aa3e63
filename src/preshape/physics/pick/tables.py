"""Presents a pick bench as tables and as a report."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ...report import Chapter, Figure, Report, Table
from ..hold.tables import short_name
from ..measures import rate_text
from .protocol import FAILURES, Motion, PickProtocol, PickResult
from .report import PickReport, PickScore

NOT_DONE = "picked up, task not done"


def cause_table(score: PickScore) -> Table:
    """How many objects were picked up, and how many failed of each cause."""
    rows = [("picked up", str(score.picked))]
    rows += [("picked up and the task done", str(score.done))] if score.done is not None else []
    rows += [(cause.value, str(score.causes[cause.name.lower()])) for cause in FAILURES]
    return Table(
        caption=f"Outcomes of {score.objects} objects",
        columns=("outcome", "objects"),
        rows=tuple(row for row in rows if row[1] != "0"),
    )


def object_table(results: Sequence[PickResult]) -> Table:
    """The outcome of each object; lengths in mm."""
    rows = tuple(
        (
            short_name(r.object_name),
            f"{r.mass:.3g}",
            r.status.value,
            _text(r.settled),
            _text(r.pushed),
            _text(r.held),
            str(r.touching) if r.answered else "–",
        )
        for r in results
    )
    return Table(
        caption="Motions: at rest on the table, until the squeeze ends, then in the hand",
        columns=("object", "kg", "outcome", "at rest", "on the table", "in the hand", "touching"),
        rows=rows,
    )


def failure_table(failures: Sequence[PickResult]) -> Table:
    """The objects that were not picked up, or with which the task was not done, with the reason of each."""
    rows = tuple(
        (short_name(r.object_name), NOT_DONE if r.picked else r.status.value, r.reason) for r in failures
    )
    return Table(caption="Failures", columns=("object", "cause", "reason"), rows=rows)


def pick_settings_line(protocol: PickProtocol, planner: str) -> str:
    """Planner and settings of the test in one line.

    >>> pick_settings_line(PickProtocol(position_error=0.005), "leap, lift, own masses")
    'leap, lift, own masses; friction 0.6, off by 5 mm and 0° (seed 0)'
    """
    off = ""
    if protocol.position_error or protocol.turn_error:
        angle = math.degrees(protocol.turn_error)
        off = f", off by {1e3 * protocol.position_error:g} mm and {angle:g}° (seed {protocol.seed})"
    return f"{planner}; friction {protocol.friction:g}{off}"


def rate_line(score: PickScore) -> str:
    """``4 of 5 answered were picked up, 80.0 % (95 %: 37.6 to 96.4 %); 4 of 6 objects in all``.

    If the task was asked for, it goes on: ``; done with 3 of the 4, 75.0 % (95 %: 30.1 to 95.4 %)``.
    """
    rate = rate_text(score.rate, score.interval)
    answered = f"{score.picked} of {score.answered} answered were picked up"
    whole = f"{score.picked} of {score.objects} objects in all"
    if score.done is not None:
        share = rate_text(score.done_rate, score.done_interval)
        whole += f"; done with {score.done} of the {score.picked}, {share}"
    return f"{answered}, {rate}; {whole}" if rate else f"none of {score.objects} objects was answered"


def pick_report(
    report: PickReport, protocol: PickProtocol, planner: str, versions: str, pictures: Sequence[Figure] = ()
) -> Report:
    """The report: outcomes, every object, and the reason of each failure.

    Args:
        report: The results.
        protocol: Settings of the tests.
        planner: Names of the hand and of the task.
        versions: Sentence that names the versions of the programs.
        pictures: Filmstrips of failures.
    """
    score = report.score()
    return Report(
        title="Pick test",
        preface=(
            f"{pick_settings_line(protocol, planner)}. {versions}",
            f"{rate_line(score)}. `docs/pick-test.md` says what is tested and counted.",
        ),
        chapters=(
            Chapter(title="Scores", blocks=(cause_table(score), object_table(report.results))),
            Chapter(title="Failures", blocks=(failure_table(report.failures()), *pictures)),
        ),
    )


def _text(motion: Motion | None) -> str:
    """``1.2 mm, 3°``."""
    if motion is None:
        return "–"
    return f"{1e3 * motion.displacement:.1f} mm, {math.degrees(motion.rotation):.0f}°"
