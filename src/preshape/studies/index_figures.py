"""The figures of the index study: areas, calibration and comparisons, from the rows of its grasps."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import Any

import numpy as np

from .._version import __version__
from ..dataset.index_values import INDICES, Index, column
from ..dataset.outcomes import Row
from ..types import Array, BoolArray, value
from .index_statistics import Bin, area, calibration, difference, within, within_difference
from .indices import IndexRows

Figures = dict[str, Any]
"""Plain JSON values."""


@value
class Question:
    """A test outcome to predict, and the grasps for which it is predicted.

    Attributes:
        name: Name in the files.
        title: Name in reports.
        verdict: Key of the rows that holds the outcome.
        among: Key that must be true in a row; ``closed`` for force closure, ``None`` for all grasps.
    """

    name: str
    title: str
    verdict: str
    among: str | None = None


QUESTIONS = (
    Question(name="held", title="holding test", verdict="held"),
    Question(name="done", title="task test", verdict="done"),
    Question(name="held_if_closed", title="holding test, with force closure", verdict="held", among="closed"),
    Question(name="done_if_closed", title="task test, with force closure", verdict="done", among="closed"),
    Question(name="done_if_held", title="task test, of grasps that hold", verdict="done", among="held"),
)

COMPARISONS = (
    ("task_margin", "tfvadi", "done"),
    ("task_margin", "tfvadi", "done_if_closed"),
    ("task_margin", "tfvadi", "done_if_held"),
    ("task_margin", "push_residual", "done"),
    ("task_margin", "push_residual", "done_if_closed"),
    ("task_margin", "push_residual", "done_if_held"),
    ("epsilon_l1", "tfvadi", "done"),
    ("hold_margin", "tfvadi_six", "held"),
    ("contacts", "tfvadi_six", "held"),
)
"""First index, second index and question of each difference of areas."""


def rows_of(rows: tuple[Row, ...], question: Question) -> list[Row]:
    """The rows of the grasps that a question concerns."""
    known = [row for row in rows if row[question.verdict] is not None]
    if question.among is None:
        return known
    if question.among == "closed":
        return [row for row in known if row["indices"]["closed"][0] == 1.0]
    return [row for row in known if row[question.among]]


def index_figures(found: IndexRows) -> Figures:
    """All figures of the report; the same rows give the same document."""
    import mujoco

    run, rows = found.run, found.rows
    return {
        "status": "answer",
        "version": __version__,
        "mujoco": mujoco.__version__,
        "hands": list(run.hands),
        "objects": list(run.objects),
        "count": run.count,
        "seed": run.seed,
        "grasps": len(rows),
        "notes": list(found.notes),
        "protocol": run.protocol.to_json(),
        "statuses": {key: dict(Counter(row[key] for row in rows)) for key in ("hold_status", "task_status")},
        "questions": [_question(rows, question, run.hands) for question in QUESTIONS],
        "rates": [_rates(rows, hand, name) for hand in run.hands for name in run.objects],
        "comparisons": [_comparison(rows, *names) for names in COMPARISONS],
    }


def _rates(rows: tuple[Row, ...], hand: str, object_name: str) -> Figures:
    own = [row for row in rows if (row["hand"], row["object"]) == (hand, object_name)]
    counts = {key: sum(bool(row[key]) for row in own) for key in ("held", "done")}
    return {"hand": hand, "object": object_name, "grasps": len(own), **counts}


def _question(rows: tuple[Row, ...], question: Question, hands: tuple[str, ...]) -> Figures:
    chosen = rows_of(rows, question)
    return {
        "name": question.name,
        "title": question.title,
        "grasps": len(chosen),
        "successes": sum(row[question.verdict] for row in chosen),
        "indices": [_index(chosen, question, index, hands) for index in INDICES],
    }


def _index(rows: list[Row], question: Question, index: Index, hands: tuple[str, ...]) -> Figures:
    scored = _ScoredGrasps(rows, question, index)
    (scores,) = scored.scores
    own = {hand: np.array([name == hand for name in scored.hands], dtype=np.bool_) for hand in hands}
    return {
        "name": index.name,
        "left_out": len(rows) - len(scores),
        "all": asdict(area(scores, scored.passed)),
        "within": asdict(within(scores, scored.passed, scored.groups, scored.objects)),
        "hands": {
            hand: asdict(
                within(scores[mask], scored.passed[mask], scored.objects[mask], scored.objects[mask])
            )
            for hand, mask in own.items()
        },
        "bins": [_bin(one, index) for one in calibration(scores, scored.passed)],
    }


class _ScoredGrasps:
    """Indices and outcomes of one question's grasps, without the grasps for which an index has no value."""

    def __init__(self, rows: list[Row], question: Question, *indices: Index) -> None:
        columns = [column(rows, index) for index in indices]
        known = np.array(~np.isnan(columns).any(axis=0), dtype=np.bool_)
        used = [rows[k] for k in np.flatnonzero(known)]
        self.scores: list[Array] = [one[known] for one in columns]
        self.passed: BoolArray = np.array([bool(row[question.verdict]) for row in used], dtype=np.bool_)
        self.hands = np.array([row["hand"] for row in used])
        self.objects = np.array([row["object"] for row in used])
        self.groups = np.array([f"{row['hand']} {row['object']}" for row in used])


def _comparison(rows: tuple[Row, ...], first: str, second: str, name: str) -> Figures:
    by_name: dict[str, Index] = {index.name: index for index in INDICES}
    question = next(one for one in QUESTIONS if one.name == name)
    both = _ScoredGrasps(rows_of(rows, question), question, by_name[first], by_name[second])
    one, other = both.scores
    return {
        "first": first,
        "second": second,
        "question": name,
        "all": asdict(difference(one, other, both.passed)),
        "within": asdict(within_difference(one, other, both.passed, both.groups, both.objects)),
    }


def _bin(found: Bin, index: Index) -> Figures:
    """A bin, with its limits in the sign of the index; an undefined limit is ``None``."""
    low, high = (None if np.isinf(x) else index.sign * x for x in (found.low, found.high))
    return {
        "from": low,
        "to": high,
        "count": found.count,
        "successes": found.successes,
        "rate": found.rate,
        "interval": list(found.interval),
    }
