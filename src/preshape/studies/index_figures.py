"""From rows of grasps to figures: areas, calibration and comparisons, as plain JSON values."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import Any

import numpy as np

from .._version import __version__
from ..dataset.index_values import INDICES, Index, column
from ..types import Array, BoolArray, value
from .index_statistics import Area, Bin, area, calibration, difference, within, within_difference
from .indices import IndexRows, Row

Figures = dict[str, Any]


@value
class Question:
    """What is to be predicted, and over which grasps.

    Attributes:
        name: as in the files.
        title: for people.
        verdict: key of the rows.
        among: key of the rows that must be true, or an index that must be above zero; ``None``: all grasps.
    """

    name: str
    title: str
    verdict: str
    among: str | None = None


QUESTIONS = (
    Question(name="held", title="holding test", verdict="held"),
    Question(name="done", title="task test", verdict="done"),
    Question(
        name="held_if_closed", title="holding test, of the force closed", verdict="held", among="closed"
    ),
    Question(name="done_if_closed", title="task test, of the force closed", verdict="done", among="closed"),
    Question(name="done_if_held", title="task test, of those that hold", verdict="done", among="held"),
)

DUELS = (
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
"""Index, index, question: whose area is larger, and by how much."""


def asked(rows: tuple[Row, ...], question: Question) -> list[Row]:
    """The rows that a question is about."""
    known = [row for row in rows if row[question.verdict] is not None]
    if question.among is None:
        return known
    if question.among == "closed":
        return [row for row in known if row["indices"]["closed"][0] == 1.0]
    return [row for row in known if row[question.among]]


def figures(found: IndexRows) -> Figures:
    """Everything that the report tells; the same rows give the same document."""
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
        "rates": [_rates(rows, hand, thing) for hand in run.hands for thing in run.objects],
        "duels": [_duel(rows, *duel) for duel in DUELS],
    }


def _rates(rows: tuple[Row, ...], hand: str, thing: str) -> Figures:
    cell = [row for row in rows if (row["hand"], row["object"]) == (hand, thing)]
    counts = {key: sum(bool(row[key]) for row in cell) for key in ("held", "done")}
    return {"hand": hand, "object": thing, "grasps": len(cell), **counts}


def _question(rows: tuple[Row, ...], question: Question, hands: tuple[str, ...]) -> Figures:
    chosen = asked(rows, question)
    return {
        "name": question.name,
        "title": question.title,
        "grasps": len(chosen),
        "successes": sum(row[question.verdict] for row in chosen),
        "indices": [_index(chosen, question, index, hands) for index in INDICES],
    }


def _index(rows: list[Row], question: Question, index: Index, hands: tuple[str, ...]) -> Figures:
    one = Answers(rows, question, index)
    return {
        "name": index.name,
        "left_out": len(rows) - len(one.scores),
        "all": asdict(area(one.scores, one.passed)),
        "within": asdict(within(one.scores, one.passed, one.groups, one.objects)),
        "hands": {hand: asdict(_of_hand(one, hand)) for hand in hands},
        "bins": [_bin(b, index) for b in calibration(one.scores, one.passed)],
    }


class Answers:
    """One index over the grasps of one question, without those where it could not be computed."""

    def __init__(self, rows: list[Row], question: Question, *indices: Index) -> None:
        numbers = [column(rows, index) for index in indices]
        known = np.array(~np.isnan(numbers).any(axis=0), dtype=np.bool_)
        kept = [rows[k] for k in np.flatnonzero(known)]
        self.all: list[Array] = [each[known] for each in numbers]
        self.scores = self.all[0]
        self.passed: BoolArray = np.array([bool(row[question.verdict]) for row in kept], dtype=np.bool_)
        self.hands = [row["hand"] for row in kept]
        self.objects = [row["object"] for row in kept]
        self.groups = [f"{row['hand']} {row['object']}" for row in kept]


def _of_hand(one: Answers, hand: str) -> Area:
    """Within the objects of one hand; its groups are the objects."""
    rows = np.array([name == hand for name in one.hands], dtype=bool)
    objects = [name for name, mine in zip(one.objects, rows, strict=True) if mine]
    return within(one.scores[rows], one.passed[rows], objects, objects)


def _duel(rows: tuple[Row, ...], first: str, second: str, name: str) -> Figures:
    by_name: dict[str, Index] = {index.name: index for index in INDICES}
    question = next(q for q in QUESTIONS if q.name == name)
    both = Answers(asked(rows, question), question, by_name[first], by_name[second])
    over_all = difference(both.all[0], both.all[1], both.passed)
    inside = within_difference(both.all[0], both.all[1], both.passed, both.groups, both.objects)
    return {
        "first": first,
        "second": second,
        "question": name,
        "all": asdict(over_all),
        "within": asdict(inside),
    }


def _bin(found: Bin, index: Index) -> Figures:
    """Limits as the index counts, undefined ones as ``None``."""
    low, high = (None if np.isinf(x) else index.sign * x for x in (found.low, found.high))
    return {
        "from": low,
        "to": high,
        "count": found.count,
        "successes": found.successes,
        "rate": found.rate,
        "interval": list(found.interval),
    }
