"""Fig. 14: three sets of contact coefficients, one task (§4.4)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from ..hiis.analyser import Aim, Analyser
from ..hiis.decision import Settings
from ..hiis.fuzzy import tfvadi
from ..objects.mesh import TriangleMesh, box_mesh
from ..report import Cell, Figure, Table
from ..types import Array, ContactCoefficients
from . import printed
from .experiment import Experiment, Progress, Section, joined, numbers_text
from .plots import COMPONENTS, OURS, PAPER, THIRD, PlotCanvas, grouped_bars
from .setup import Q1, Data, Setup, grasp_data, run_case, teach

BOX_IN_U = (1.0, 0.4, 1.0)
"""Extents of the box with the paper's proportions [U]: half-height 0.2 along plane 5's opposition axis
[R]."""
BOX_SIZE = " × ".join(f"{x:g}" for x in BOX_IN_U)

LEFT_OUT = 2
"""Index of the row whose forces fit no number of contacts; it is not compared [R]."""


def paper_box(setup: Setup) -> TriangleMesh:
    """The box with the paper's proportions, for this hand [m]."""
    return box_mesh("paper's box", np.array(BOX_IN_U) * setup.hand.u)


def _measure(setup: Setup, part: Path, progress: Progress) -> Data:
    rows: list[Data] = []
    for i, row in enumerate(printed.FIG_14):
        progress(i / len(printed.FIG_14), f"coefficient set {i + 1} of {len(printed.FIG_14)}")
        ka, ko, kn, mn = row.coefficients
        settings = Settings(coefficients=ContactCoefficients(ka=ka, ko=ko, kn=kn, mn=mn), seed=setup.seed)
        cube = setup.prepare(setup.system(), "cube", settings=settings)
        box = setup.prepare(setup.system(), paper_box(setup), settings=settings)
        aimed = at_paper(box.element, Q1.q)
        teach(box)
        rows.append(
            {
                "aimed": aimed,
                "box": run_case(box, may_learn=False),
                "cube": run_case(cube, may_learn=False),
                "typed": float(tfvadi(printed.Q1, row.wrench)),
            }
        )
    return {"rows": rows}


def at_paper(element: Analyser, q: Array) -> Data | None:
    """The virtual grasp at the paper's plane and approach value, with a thumb and two fingers."""
    aim = Aim(planes=[printed.FIG_14_PLANE], values=[printed.FIG_14_VALUE], fingers=[3], flips=[False])
    found = element.explore(q, aim)
    return grasp_data(found.grasp()) if len(found) else None


def wrench_text(w: Sequence[float] | None) -> str:
    """Force and torque in one line each."""
    if w is None:
        return "none"
    return "\n".join(" ".join(f"{x:.2f}" for x in half) for half in (w[:3], w[3:]))


def _compared(data: Data) -> Iterator[tuple[int, printed.CoefficientRow, Data, float | None]]:
    """For each compared row: number, the paper's row, our row, largest difference of their net wrenches."""
    for i, (row, ours) in enumerate(zip(printed.FIG_14, data["rows"], strict=True)):
        if i != LEFT_OUT:
            yield i + 1, row, ours, _difference(row.wrench, ours["aimed"])


def _difference(theirs: Sequence[float], ours: Data | None) -> float | None:
    return None if ours is None else float(np.abs(np.subtract(theirs, ours["wrench"])).max())


def _present(data: Data) -> Section:
    wrenches: list[tuple[Cell, ...]] = []
    pipeline: list[tuple[Cell, ...]] = []
    for i, (row, ours) in enumerate(zip(printed.FIG_14, data["rows"], strict=True)):
        aimed = ours["aimed"]
        wrenches.append(
            (
                i + 1, numbers_text(row.coefficients), wrench_text(row.wrench),
                wrench_text(aimed and aimed["wrench"]),
                "left out" if i == LEFT_OUT else _difference(row.wrench, aimed),
                row.tfvadi, ours["typed"], aimed and aimed["tfvadi"],
            )
        )  # fmt: skip
        for name, noun in (("box", "paper's box"), ("cube", "trained cube")):
            answer = ours[name]["answer"] or {}
            pipeline.append(
                (
                    i + 1, noun, ours[name]["mode"], answer.get("plane"), answer.get("value"),
                    answer.get("tfvadi"), wrench_text(answer.get("wrench")),
                )
            )  # fmt: skip
    largest = [difference for *_, difference in _compared(data) if difference is not None]
    headline = "There is no virtual grasp at the paper's plane and value."
    if largest:
        headline = (
            "At the paper's plane and value every component of the net wrench is within "
            f"{max(largest):.2f} of the paper's."
        )
    return Section(
        headline=headline,
        text=(
            "Task Q1 with three sets of contact coefficients Ka Ko Kn Mn. The paper does not describe its "
            f"object. Its net wrenches fit a box with a half-height of 0.2 U, so a box of {BOX_SIZE} U is "
            f"used. The first table is for the paper's plane {printed.FIG_14_PLANE} and value "
            f"{printed.FIG_14_VALUE:g} with a thumb and two fingers. The second is for the whole pipeline: "
            "the box after it was learnt with Q1, and the cube of the first training.",
            f"Row {LEFT_OUT + 1} of the paper is left out of the comparison: {row_3_fault()}",
        ),
        tables=(
            Table(
                caption="Net wrench Tx Ty Tz Rx Ry Rz at the paper's plane and value. The last column but "
                "one is the TFVADI of the paper's net wrench.",
                columns=(
                    "row", "Ka Ko Kn Mn", "W_net, paper", "W_net, preshape", "largest difference",
                    "TFVADI, paper", "of the paper's W_net", "TFVADI, preshape",
                ),
                rows=tuple(wrenches),
            ),
            Table(
                caption="Answers of the pipeline; the paper has mode 0, plane 5 and value 0.01 in every row.",
                columns=("row", "object", "mode", "plane", "value", "TFVADI", "W_net"),
                rows=tuple(pipeline),
            ),
        ),
        figures=(
            Figure(
                file="figures/fig14.png",
                caption="Net wrenches of the three sets: the paper's, and ours on the box and on the cube.",
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


def _disagreements(data: Data) -> Iterator[str]:
    for number, row, ours, difference in _compared(data):
        aimed = ours["aimed"]
        if difference is None:
            yield f"Row {number}: there is no virtual grasp at the paper's plane and value."
            continue
        if difference > 0.005:
            worst = int(np.argmax(np.abs(np.subtract(row.wrench, aimed["wrench"]))))
            yield (
                f"Row {number}: the net wrench differs by {difference:.2f} or less ({COMPONENTS[worst]}: "
                f"{row.wrench[worst]:g} in the paper, {aimed['wrench'][worst]:.2f} here). The paper "
                "measured its contacts on a model whose size is not given."
            )
        if row.tfvadi is not None and abs(aimed["tfvadi"] - row.tfvadi) > 0.05:
            yield (
                f"Row {number}: TFVADI is {row.tfvadi:g} in the paper and {aimed['tfvadi']:.2f} here. The "
                f"net wrenches are the only reason: the paper's own net wrench gives {ours['typed']:.2f}."
            )
    for name in ("box", "cube"):
        cases = [row[name] for row in data["rows"]]
        others = [
            f"row {i}: mode {case['mode']}, "
            + (
                f"plane {case['answer']['plane']} at {case['answer']['value']:g}"
                if case["answer"]
                else "no answer"
            )
            for i, case in enumerate(cases, start=1)
            if case["mode"] != 0 or not case["answer"] or case["answer"]["plane"] != printed.FIG_14_PLANE
        ]
        if others:
            yield f"On the {name} the pipeline departs from the paper's mode 0 and plane 5: {joined(others)}."
        values = {case["answer"]["value"] for case in cases if case["answer"]}
        if values - {printed.FIG_14_VALUE}:
            yield (
                f"On the {name} the pipeline answers at value {joined([f'{v:g}' for v in sorted(values)])}, "
                f"the paper at {printed.FIG_14_VALUE:g}: mode 0 answers at the crisp value of a fuzzy set."
            )


def _draw(data: Data, path: Path) -> None:
    with PlotCanvas(path, size=(10.5, 3.9), columns=3, sharey=True) as panels:
        for i, (axes, row, ours) in enumerate(zip(panels, printed.FIG_14, data["rows"], strict=True)):
            series: list[tuple[str, Sequence[float | None], str]] = [("paper", row.wrench, PAPER)]
            for grasp, label, colour in (
                (ours["aimed"], "preshape, box, at the paper's plane and value", OURS),
                (ours["cube"]["answer"], "preshape, cube, pipeline", THIRD),
            ):
                series.append((label, grasp["wrench"] if grasp else [None] * 6, colour))
            grouped_bars(axes, COMPONENTS, series, numbers=False)
            title = f"row {i + 1}: {numbers_text(row.coefficients)}"
            axes.set_title(title + (" (left out)" if i == LEFT_OUT else ""))
            axes.axhline(0, color="black", lw=0.8)
        panels[0].set_ylabel("net wrench (lengths in U)")
        handles, labels = panels[0].get_legend_handles_labels()
        panels[0].figure.legend(handles, labels, loc="outside lower center", ncols=3)


FIG_14 = Experiment(
    name="fig14", title="Fig. 14: contact coefficients",
    version=1, cost=3, measure=_measure, present=_present,
)  # fmt: skip
