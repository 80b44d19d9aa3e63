"""Fig. 14: three sets of contact coefficients, one task (§4.4)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from ..hiis.decision import Settings
from ..hiis.fuzzy import tfvadi
from ..report import Cell, Figure, Table
from ..types import ContactCoefficients
from . import printed
from .experiment import Experiment, Progress, Section, joined, numbers_text
from .plots import COMPONENTS, OURS, PAPER, THIRD, PlotCanvas, grouped_bars
from .setup import CUBE, PITCHES, Data, Setup, run_case

LEFT_OUT = 2
"""Index of the row whose forces fit no number of contacts; it is not compared [R]."""

FORCE_LIMIT, TORQUE_LIMIT = 0.10, 0.02
"""Largest differences from a printed net wrench with the paper's finger pitch, lengths in 4U [R]."""

OBJECT_TEXT = (
    "The paper does not describe its object. Its torques fit a cube of 1.68 U, the cube of the first "
    "training, with fingers 0.14 apart in units of 4U; the hand's own fingers are 0.145 apart. The printed "
    "approach value is taken as coordinate of the fingertips in 4U."
)


def _measure(setup: Setup, part: Path, progress: Progress) -> Data:
    rows: list[Data] = []
    for i, row in enumerate(printed.FIG_14):
        progress(i / len(printed.FIG_14), f"coefficient set {i + 1} of {len(printed.FIG_14)}")
        ka, ko, kn, mn = row.coefficients
        settings = Settings(coefficients=ContactCoefficients(ka=ka, ko=ko, kn=kn, mn=mn), seed=setup.seed)
        ready = setup.prepare(setup.system(), CUBE, settings=settings)
        rows.append(
            {
                "aimed": setup.on_cube(printed.FIG_14_PLANE, printed.FIG_14_VALUE, settings),
                "pipeline": run_case(ready, may_learn=False),
                "typed": float(tfvadi(printed.Q1, row.wrench)),
            }
        )
    return {"rows": rows}


def wrench_text(w: Sequence[float] | None) -> str:
    """Force and torque in one line each."""
    if w is None:
        return "none"
    return "\n".join(" ".join(f"{x:.2f}" for x in half) for half in (w[:3], w[3:]))


def differences(theirs: Sequence[float], ours: Data | None) -> tuple[float | None, float | None]:
    """Largest differences of the forces and of the torques of two net wrenches; ``None`` without a grasp."""
    if ours is None:
        return None, None
    off = np.abs(np.subtract(theirs, ours["wrench"]))
    return float(off[:3].max()), float(off[3:].max())


def aimed_table(
    column: str, rows: Sequence[tuple[Cell, Sequence[float], Data]], *, left_out: Sequence[int] = ()
) -> Table:
    """Net wrenches at the paper's plane and value on the cube, beside the printed ones.

    Args:
        column: Heading of the first column.
        rows: For each printed row, its label, its net wrench, and the grasps of both finger pitches.
        left_out: Indices of rows that are not compared.
    """
    cells: list[tuple[Cell, ...]] = []
    for i, (label, theirs, aimed) in enumerate(rows):
        for pitch in PITCHES:
            grasp = aimed[pitch] or {}
            off: Sequence[Cell] = ("left out",) * 2
            if i not in left_out:
                off = [None if x is None else f"{x:.3f}" for x in differences(theirs, aimed[pitch])]
            cells.append(
                (
                    label, pitch, grasp.get("coordinate"), grasp.get("value"), wrench_text(theirs),
                    wrench_text(grasp.get("wrench")), *off, float(tfvadi(printed.Q1, theirs)),
                    grasp.get("tfvadi"),
                )
            )  # fmt: skip
    return Table(
        caption="Net wrench Tx Ty Tz Rx Ry Rz on the cube at the paper's plane and value, with a thumb and "
        "two fingers, for the finger pitch that fits the paper (0.14) and for the hand's own (0.145).",
        columns=(
            column, "finger pitch", "value in 4U", "share of the half-extent", "W_net, paper",
            "W_net, preshape", "largest difference, force", "largest difference, torque",
            "TFVADI of the paper's W_net", "TFVADI, preshape",
        ),
        rows=tuple(cells),
    )  # fmt: skip


def agreement(pairs: Sequence[tuple[Sequence[float], Data]], pitch: str = "paper") -> str:
    """How far the forces and torques of several net wrenches are from the printed ones."""
    found = [differences(theirs, aimed[pitch]) for theirs, aimed in pairs]
    force = max((f for f, _ in found if f is not None), default=None)
    torque = max((t for _, t in found if t is not None), default=None)
    if force is None or torque is None or None in (f for f, _ in found):
        return "there is no virtual grasp at the paper's plane and value"
    return f"every force is within {force:.2f} and every torque within {torque:.3f} of the paper's"


def _compared(data: Data) -> list[tuple[Sequence[float], Data]]:
    rows = zip(printed.FIG_14, data["rows"], strict=True)
    return [(row.wrench, ours["aimed"]) for i, (row, ours) in enumerate(rows) if i != LEFT_OUT]


def _present(data: Data) -> Section:
    labels = [f"{i}: {numbers_text(row.coefficients)}" for i, row in enumerate(printed.FIG_14, start=1)]
    answers: list[tuple[Cell, ...]] = []
    for label, row, ours in zip(labels, printed.FIG_14, data["rows"], strict=True):
        answer = ours["pipeline"]["answer"] or {}
        answers.append(
            (
                label, ours["pipeline"]["mode"], answer.get("plane"), answer.get("coordinate"),
                answer.get("value"), row.tfvadi, answer.get("tfvadi"), wrench_text(answer.get("wrench")),
            )
        )  # fmt: skip
    compared = _compared(data)
    return Section(
        headline=f"On the cube, at the paper's plane and value, {agreement(compared)}.",
        text=(
            f"Task Q1 with three sets of contact coefficients Ka Ko Kn Mn. {OBJECT_TEXT} The first table is "
            f"for the paper's plane {printed.FIG_14_PLANE} and value {printed.FIG_14_VALUE:g}, the second "
            f"for the whole pipeline. With the hand's own finger pitch {agreement(compared, 'hand')}.",
            f"Row {LEFT_OUT + 1} of the paper is left out of the comparison: {row_3_fault()}",
        ),
        tables=(
            aimed_table(
                "row: Ka Ko Kn Mn",
                [
                    (label, row.wrench, ours["aimed"])
                    for label, row, ours in zip(labels, printed.FIG_14, data["rows"], strict=True)
                ],
                left_out=(LEFT_OUT,),
            ),
            Table(
                caption="Answers of the pipeline on the cube; the paper has mode 0, plane 5 and value 0.01 "
                "(in 4U) in every row.",
                columns=(
                    "row: Ka Ko Kn Mn", "mode", "plane", "value in 4U", "share of the half-extent",
                    "TFVADI, paper", "TFVADI, preshape", "W_net",
                ),
                rows=tuple(answers),
            ),
        ),
        figures=(
            Figure(
                file="figures/fig14.png",
                caption="Net wrenches of the three sets: the paper's, and ours on the cube.",
                draw=partial(_draw, data),
            ),
        ),
        remarks=tuple(_disagreements(data)),
    )  # fmt: skip


def row_3_fault() -> str:
    """The reason why the paper's row 3 fits no number of contacts: its normal forces do not add up."""
    row = printed.FIG_14[LEFT_OUT]
    ka, _, kn, _ = row.coefficients
    contacts = max(2, round(row.wrench[0] / ka))
    return (
        f"its Tx {row.wrench[0]:g} is that of {contacts} contacts ({contacts} Ka = {contacts * ka:.2f}), "
        f"but then Ty would be {contacts - 2} Kn = {(contacts - 2) * kn:.1f} and not {row.wrench[1]:g}."
    )


def beyond_limits(label: str, theirs: Sequence[float], aimed: Data) -> Iterator[str]:
    """A sentence if a net wrench with the paper's finger pitch exceeds a limit, or does not exist."""
    force, torque = differences(theirs, aimed["paper"])
    if force is None or torque is None:
        yield f"{label}: there is no virtual grasp at the paper's plane and value."
    elif force > FORCE_LIMIT + 1e-9 or torque > TORQUE_LIMIT:
        yield (
            f"{label}: the net wrench differs by {force:.2f} in the forces and {torque:.3f} in the torques, "
            f"more than {FORCE_LIMIT:g} and {TORQUE_LIMIT:g}."
        )


def _disagreements(data: Data) -> Iterator[str]:
    for i, (row, ours) in enumerate(zip(printed.FIG_14, data["rows"], strict=True)):
        aimed = ours["aimed"]
        if i == LEFT_OUT:
            continue
        yield from beyond_limits(f"Row {i + 1}", row.wrench, aimed)
        if aimed["paper"] and row.tfvadi is not None and abs(aimed["paper"]["tfvadi"] - row.tfvadi) > 0.05:
            yield (
                f"Row {i + 1}: TFVADI is {row.tfvadi:g} in the paper and {aimed['paper']['tfvadi']:.2f} "
                "here. The net wrenches are the only reason: the paper's own net wrench gives "
                f"{ours['typed']:.2f}."
            )
    cases = [row["pipeline"] for row in data["rows"]]
    others = [
        f"row {i}: mode {case['mode']}, "
        + (f"plane {case['answer']['plane']}" if case["answer"] else "no answer")
        for i, case in enumerate(cases, start=1)
        if case["mode"] != 0 or not case["answer"] or case["answer"]["plane"] != printed.FIG_14_PLANE
    ]
    if others:
        yield f"The pipeline departs from the paper's mode 0 and plane 5: {joined(others)}."
    values = {case["answer"]["coordinate"] for case in cases if case["answer"]}
    if values - {printed.FIG_14_VALUE}:
        yield (
            f"The pipeline answers at value {joined([f'{v:.3g}' for v in sorted(values)])} in 4U, the paper "
            f"at {printed.FIG_14_VALUE:g}: mode 0 answers at the crisp value of a fuzzy set."
        )


def _draw(data: Data, path: Path) -> None:
    with PlotCanvas(path, size=(10.5, 3.9), columns=3, sharey=True) as panels:
        for i, (axes, row, ours) in enumerate(zip(panels, printed.FIG_14, data["rows"], strict=True)):
            series: list[tuple[str, Sequence[float | None], str]] = [("paper", row.wrench, PAPER)]
            for grasp, label, colour in (
                (ours["aimed"]["paper"], "preshape, at the paper's plane and value", OURS),
                (ours["pipeline"]["answer"], "preshape, pipeline", THIRD),
            ):
                series.append((label, grasp["wrench"] if grasp else [None] * 6, colour))
            grouped_bars(axes, COMPONENTS, series, numbers=False)
            title = f"row {i + 1}: {numbers_text(row.coefficients)}"
            axes.set_title(title + (" (left out)" if i == LEFT_OUT else ""))
            axes.axhline(0, color="black", lw=0.8)
        panels[0].set_ylabel("net wrench (lengths in 4U)")
        handles, labels = panels[0].get_legend_handles_labels()
        panels[0].figure.legend(handles, labels, loc="outside lower center", ncols=3)


FIG_14 = Experiment(
    name="fig14", title="Fig. 14: contact coefficients",
    version=2, cost=2, measure=_measure, present=_present,
)  # fmt: skip
