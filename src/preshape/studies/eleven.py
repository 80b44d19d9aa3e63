"""The paper's eleven tasks on the cube of the first training: which plane fits each of them best?

The tasks are Q1 and Q2 of table 1 and the three of each of figs. 11, 12 and 13. The paper's answers of
figs. 12 and 13 are for other objects, which are not published.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..hiis.analyser import Aim
from ..hiis.critic import SLACK
from ..hiis.decision import Settings
from ..hiis.planes import axis_name, plane
from ..report import Cell, Table
from ..tasks import task_from_numbers
from ..types import Array
from . import printed
from .experiment import Experiment, Progress, Section, joined, numbers_text
from .figs_11_13 import counted
from .setup import CUBE, PITCHES, Data, Setup, grasp_data

STEPS = 41
"""Number of equal steps of the approach value, both faces included."""
FLIPS = {"without flip": (False,), "with flip": (False, True)}
"""Thumb sides that the explorer tries."""


class _Case(NamedTuple):
    """A task, and the paper's plane and approach value for it."""

    label: str
    task: tuple[float, ...]
    plane: int
    value: float | None


CASES = (
    _Case("Q1", printed.Q1, 5, printed.FIG_14_VALUE),
    _Case("Q2", printed.Q2, 6, None),
    *(
        _Case(f"fig. {figure} case {i}", row.task, row.plane, row.value)
        for figure, rows in ((11, printed.FIG_11), (12, printed.FIG_12), (13, printed.FIG_13))
        for i, row in enumerate(rows, start=1)
    ),
)


def _measure(setup: Setup, part: Path, progress: Progress) -> Data:
    rows = []
    analysers = {pitch: setup.analyser(pitch) for pitch in PITCHES}
    for i, case in enumerate(CASES):
        task = task_from_numbers(case.task)
        explored = {
            pitch: {name: _explored(setup, pitch, task.q, case.plane, flips) for name, flips in FLIPS.items()}
            for pitch in PITCHES
        }
        system = []
        for k, seed in enumerate(setup.seeds):
            progress((i + k / len(setup.seeds)) / len(CASES), f"{case.label}, seed {seed}")
            request = setup.request(CUBE, task, settings=Settings(seed=seed))
            decision = setup.system(seed).run(request).decision
            estimate = decision.estimate.plane if decision.estimate else None
            system.append(
                {
                    "seed": seed,
                    "mode": decision.mode,
                    "plane": decision.grasp.plane.index if decision.grasp else estimate,
                    "answer": grasp_data(decision.grasp, analysers["hand"]),
                }
            )
        rows.append({"explored": explored, "system": system})
    return {"rows": rows}


def _explored(setup: Setup, pitch: str, q: Array, theirs: int, flips: Sequence[bool]) -> Data:
    """The best planes of the explorer, their TFVADI, and that of the paper's plane."""
    aim = Aim(values=np.linspace(-1.0, 1.0, STEPS), flips=flips)
    found = setup.analyser(pitch).explore(q, aim)
    best = found.match >= found.match[0] - SLACK
    return {
        "planes": sorted({int(number) for number in found.plane[best]}),
        "tfvadi": round(float(found.match[0]), 6),
        "paper": round(float(found.match[found.plane == theirs].max()), 6),
    }


def _numbers(explored: Data) -> str:
    """The planes that are best."""
    return joined([str(number) for number in explored["planes"]])


def _best_text(explored: Data) -> str:
    """The planes that are best, with their TFVADI, as part of a sentence."""
    numbers = _numbers(explored)
    verb = f"planes {numbers} tie" if len(explored["planes"]) > 1 else f"plane {numbers} is best"
    return f"{verb} with {explored['tfvadi']:.2f}"


def _present(data: Data) -> Section:
    rows: list[tuple[Cell, ...]] = []
    for case, ours in zip(CASES, data["rows"], strict=True):
        explored, system = ours["explored"]["paper"], ours["system"]
        answer: Data = next((one["answer"] for one in system if one["answer"]), {})
        rows.append(
            (
                case.label, numbers_text(case.task), case.plane,
                *(f"{_numbers(explored[name])}: {explored[name]['tfvadi']:.2f}" for name in FLIPS),
                explored["with flip"]["paper"],
                counted([one["plane"] for one in system]), counted([one["mode"] for one in system]),
                case.value, answer.get("coordinate"), answer.get("value"), answer.get("tfvadi"),
            )
        )  # fmt: skip
    total, seeds = len(CASES), len(data["rows"][0]["system"])
    right = {name: sum(_right(case, ours, name) for case, ours in _pairs(data)) for name in FLIPS}
    system = sum(one["plane"] == case.plane for case, ours in _pairs(data) for one in ours["system"])
    changed = [
        case.label
        for case, ours in _pairs(data)
        if any(
            ours["explored"]["paper"][name]["planes"] != ours["explored"]["hand"][name]["planes"]
            for name in FLIPS
        )
    ]
    pitch = f"changes the best planes of {joined(changed)}" if changed else "gives the same best planes"
    return Section(
        headline=f"The explorer's best plane is the paper's for {right['without flip']} of {total} tasks "
        f"without flip and {right['with flip']} with it (ties included); the whole system has the paper's "
        f"plane in {system} of {total * seeds} runs.",
        text=(
            "Each task is put to the cube of the first training in two ways; the paper's planes of figs. 12 "
            "and 13 are for other objects. The explorer alone tries all planes at "
            f"{STEPS} equal steps of the approach value from face to face, with two, three and "
            "four contacts and fingers 0.14 apart in units of 4U, with the thumb on +o only (without flip, "
            f"as in the paper) and on either side. With the hand's own pitch, 0.145, it {pitch}. The whole "
            f"system (modes 0 to 3) answers with the hand's own pitch from a memory that knows only the "
            f"cube, with {seeds} seeds of the network.",
            "Q2 is a rotation about the approach axis X of plane 5, which table 1 names with opposition Y. "
            "The same six numbers are the Q1 of plane 6, which approaches along Y and opposes along X, and "
            "fig. 11 case 2, a task of this kind, has plane 6 in the paper; so plane 6 is expected.",
        ),
        tables=(
            Table(
                caption="Planes and TFVADI of the explorer, the best TFVADI on the paper's plane, and planes "
                "and modes of the whole system with the number of seeds. Value and TFVADI of the system are "
                "those of the first seed.",
                columns=(
                    "task", "Q", "plane, paper", "explorer without flip", "explorer with flip",
                    "TFVADI on the paper's plane", "planes, system", "modes, system", "value in 4U, paper",
                    "value in 4U, system", "share of the half-extent, system", "TFVADI, system",
                ),
                rows=tuple(rows),
            ),
        ),
        remarks=tuple(_disagreements(data)),
    )  # fmt: skip


def _pairs(data: Data) -> Iterator[tuple[_Case, Data]]:
    yield from zip(CASES, data["rows"], strict=True)


def _right(case: _Case, ours: Data, flips: str) -> bool:
    return case.plane in ours["explored"]["paper"][flips]["planes"]


def _disagreements(data: Data) -> Iterator[str]:
    for case, ours in _pairs(data):
        explored = ours["explored"]["paper"]
        found = {
            name: _best_text(explored[name]) for name in FLIPS if explored[name]["planes"] != [case.plane]
        }
        others = [f"{name} {text}" for name, text in found.items()]
        if len(found) == len(FLIPS) and len(set(found.values())) == 1:
            others = [f"without and with flip {next(iter(found.values()))}"]
        planes = [one["plane"] for one in ours["system"]]
        if any(number != case.plane for number in planes):
            others.append(f"the system has planes {counted(planes)}")
        if others:
            yield (
                f"{case.label}: the paper has plane {case.plane}, which reaches "
                f"{explored['with flip']['paper']:.2f}; {joined(others)}. {_why(case, ours)}"
            )


def _why(case: _Case, ours: Data) -> str:
    """Why another plane than the paper's fits a task."""
    theirs, (t, r) = plane(case.plane), np.split(np.array(case.task), 2)
    o = axis_name(theirs.opposition_axis)[1].upper()
    turns, moves = _present_axes(r), _present_axes(t)
    if not any(turn[1] == o for turn in turns):
        return (
            f"Plane {case.plane} opposes along {o}, so its net wrench has a torque about {o}; the task "
            f"turns about {joined(turns)} and moves along {joined(moves)}."
        )
    if all(_right(case, ours, name) for name in FLIPS):
        return (
            "The network estimates another plane with some seeds, and modes 0 and 1 search the estimated "
            "plane only."
        )
    return f"The task turns about {joined(turns)} and moves along {joined(moves)}."


def _present_axes(numbers: Array) -> list[str]:
    """Signed names of the axes along which a task has a displacement."""
    return [("+" if x > 0 else "-") + name for x, name in zip(numbers, "XYZ", strict=True) if abs(x) > 0.3]


ELEVEN = Experiment(
    name="eleven", title="The paper's eleven tasks on its cube",
    version=1, cost=20, measure=_measure, present=_present,
)  # fmt: skip
