"""Places where the paper contradicts itself or cannot be right, and how preshape handles them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ..hiis.fuzzy import FuzzySets, tfvadi
from ..report import Cell, Table
from . import printed
from .experiment import Experiment, Progress, Section
from .fig_14 import row_3_fault
from .fig_15 import contradicting_rows
from .setup import Data, Setup

_WIDE = printed.FIG_16[1]

_READINGS: tuple[tuple[str, str, str, str], ...] = (
    (
        "Table 1, task Q2", "plane 5: approach X, opposition Y", "its numbers are those of the Q1 of plane 6",
        "expects plane 6, whose torque about the opposition axis is the largest of a grasp; fig. 11 case 2 "
        "has plane 6 for such a task",
    ),
    (
        "§2.2, number of fingers", "\"determined\" by the extent: all that fit", "the extent is the limit",
        "measures both (number of fingers, seed 0). The default is up to as many as fit: it agrees with more "
        "planes of figs. 11-13, ends in fewer deadlocks, and has the three contacts that figs. 14 and 15 "
        "print for a cube that takes four. With all that fit, more modes of figs. 11-13 agree, and the rate "
        "of odd cases is nearer to the paper's",
    ),
    (
        "Fig. 12, case 1", "mode 2 (table)", "mode 3 (text)",
        "compares mode 3, because the object is learnt there",
    ),
    (
        "Fig. 12, case 2", "TFVADI 2.6 (table)", "TFVADI 3.6 (text)",
        "compares 3.6, because 2.6 is below the threshold of 3.0",
    ),
    ("Fig. 13, case 1", "TFVADI 5.3 (table)", "TFVADI 5.89 (text)", "compares the text's"),
    (
        "Fig. 13, case 3", "rotation about Z (table)", "rotation about X (text)",
        "runs the table's task; its plane 7 approaches along Z and opposes along Y, which a translation "
        "along X and Z does not suggest",
    ),
    (
        "Fig. 15", "the task has Tx", "plane 7 approaches along Z",
        "chooses the task by a search that the report describes",
    ),
    (
        "Fig. 14 row 2, fig. 16", "Rx of the same W_net 0.06", "Rx -0.06",
        "uses both as golden values; the contact model gives the positive sign, as fig. 14",
    ),
    (
        "Table 5", "descriptions of FWD-L and FWD-H", "trapezoids of fig. 16",
        "uses the trapezoids; the descriptions are swapped",
    ),
    (
        "Fig. 16, sets RWD-H and FWD-H", "end at -1.2 and 1.2", "1.3 and 2.1 score",
        "uses shoulders: beyond 1.2 the membership stays 1",
    ),
    (
        "Eq. 19", "ADI without complement", "TFVADI of fig. 14 and 16",
        "uses ADI = min(a•b, 1 - a⊗b); the complement's bar is lost in the scan",
    ),
    (
        "Fig. 13, case 1", "plane 11", "its task moves along +X and -Y",
        "tries both thumb sides; approach +X with the thumb on the other side fits better, but the paper "
        "has no flip",
    ),
    ("Table 3's example", "counts RWD-H as 1", "codes start at 0", "counts 0 = RWD-H … 6 = FWD-H"),
    (
        "Fig. 4", "the picture of the planes is lost", "1, 5, 6, 7 in the text; 9, 10 by their tasks",
        "chooses the other numbers itself",
    ),
)  # fmt: skip


def _measure(setup: Setup, part: Path, progress: Progress) -> Data:
    return {}


def _computed() -> Iterator[tuple[Cell, ...]]:
    """Rows for contradictions between printed numbers, which are computed here."""
    yield "Fig. 14, row 3", "its coefficients", "its W_net", f"leaves it out: {row_3_fault()}"
    for row, own in contradicting_rows():
        yield (
            f"Fig. 15, threshold {row.threshold:.1f}", f"TFVADI {row.tfvadi:g}", f"its W_net gives {own:.2f}",
            "does not compare its net wrench",
        )  # fmt: skip
    sets = FuzzySets().changed(_WIDE.changes)
    other = (1.0, 1.0, 0.21, *printed.Q1[3:])
    with_other, with_q1 = (float(tfvadi(q, _WIDE.wrench, sets)) for q in (other, printed.Q1))
    verdict = (
        f"uses 0.1; with ZERO wide, 0.21 gives {with_other:.2f} and 0.1 gives {with_q1:.2f}, and "
        f"{_WIDE.tfvadi:g} is printed"
    )
    if abs(with_other - with_q1) < 0.005:
        verdict += ", which decides nothing"
    yield "Fig. 16, heading", "Tz 0.21 (scan: 021)", "Tz 0.1 (fig. 14)", verdict


def _present(data: Data) -> Section:
    rows: tuple[tuple[Cell, ...], ...] = (*_READINGS, *_computed())
    return Section(
        headline=f"The table lists {len(rows)} places.",
        text=(
            "Figures are missing from the scan of the paper and some of its tables are illegible. In the "
            "following places the paper also contradicts itself.",
        ),
        tables=(
            Table(
                caption="Places, the two readings, and what preshape does.",
                columns=("where", "one reading", "the other", "preshape"),
                rows=rows,
            ),
        ),
    )


CONTRADICTIONS = Experiment(
    name="contradictions", title="Where the paper contradicts itself",
    version=2, cost=0.1, measure=_measure, present=_present,
)  # fmt: skip
