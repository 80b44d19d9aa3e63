"""Where the source disagrees with itself or cannot be right, and what preshape does there."""

from __future__ import annotations

from pathlib import Path

from ..hiis.fuzzy import FuzzySets, tfvadi
from . import printed
from .bench import Bench
from .fig_14 import row_3
from .values import Cell, Data, Experiment, Progress, Section, Table

_WIDE = printed.FIG_16[1]

_READINGS: tuple[tuple[str, str, str, str], ...] = (
    ("Fig. 12, case 1", "mode 2 (table)", "mode 3 (text)", "mode 3 is compared: the object is learnt "
    "there"),
    ("Fig. 12, case 2", "TFVADI 2.6 (table)", "TFVADI 3.6 (text)", "3.6 is compared: 2.6 is under the "
    "threshold of 3.0"),
    ("Fig. 13, case 1", "TFVADI 5.3 (table)", "TFVADI 5.89 (text)", "the text's is compared"),
    (
        "Fig. 13, case 3", "rotation about Z (table)", "rotation about X (text)",
        "the table's task is run; its plane 7 approaches along Z and opposes along Y, which a "
        "translation along X and Z does not suggest",
    ),
    ("Fig. 15", "the task has Tx", "plane 7 approaches along Z", "the task is chosen by a stated search"),
    (
        "Fig. 14 row 2, fig. 16", "Rx of the same W_net 0.06", "Rx -0.06",
        "both are golden values; the formula of the contact model gives the negative sign",
    ),
    ("Table 5", "descriptions of FWD-L and FWD-H", "trapezoids of fig. 16", "the descriptions are "
    "swapped; the trapezoids stand"),
    (
        "Fig. 16, sets RWD-H and FWD-H", "end at -1.2 and 1.2", "1.3 and 2.1 score",
        "they are shoulders: beyond 1.2 membership stays 1",
    ),
    ("Eq. 19", "ADI without complement", "TFVADI of fig. 14 and 16", "the complement's bar is lost in "
    "the scan: ADI = min(a•b, 1 - a⊗b)"),
    (
        "Fig. 13, case 1", "plane 11", "its task moves along +X and -Y",
        "approach +X with the thumb on the other side fits better; the paper has no flip, preshape "
        "tries both thumb sides",
    ),
    ("Table 3's example", "counts RWD-H as 1", "codes start at 0", "0 = RWD-H … 6 = FWD-H"),
    ("Fig. 4", "the planes' picture is lost", "1, 5, 6, 7 in the text; 9, 10 by their tasks", "the "
    "other numbers are ours"),
)  # fmt: skip


def _measure(bench: Bench, part: Path, progress: Progress) -> Data:
    return {}


def _computed() -> list[tuple[Cell, ...]]:
    """Contradictions that are numbers, worked out anew."""
    out: list[tuple[Cell, ...]] = [
        ("Fig. 14, row 3", "its coefficients", "its W_net", f"left out: {row_3()}")
    ]
    for row in printed.FIG_15:
        own = float(tfvadi(printed.Q1, row.wrench))
        if row.mode < 2 and abs(own - row.tfvadi) > 0.05:
            out.append(
                (
                    f"Fig. 15, threshold {row.threshold:.1f}", f"TFVADI {row.tfvadi:g}", f"its W_net "
                    f"gives {own:.2f}",
                    "left out of the comparison of wrenches",
                )
            )  # fmt: skip
    sets = FuzzySets().changed(_WIDE.changes)
    other = (1.0, 1.0, 0.21, *printed.Q1[3:])
    with_other, with_q1 = (float(tfvadi(q, _WIDE.wrench, sets)) for q in (other, printed.Q1))
    verdict = (
        f"with ZERO wide 0.21 gives {with_other:.2f} and 0.1 gives {with_q1:.2f}; {_WIDE.tfvadi:g} is printed"
    )
    if abs(with_other - with_q1) < 0.005:
        verdict += ", which decides nothing"
    verdict += "; 0.1 is used"
    out.append(("Fig. 16, heading", "Tz 0.21 (scan: 021)", "Tz 0.1 (fig. 14)", verdict))
    return out


def _present(data: Data) -> Section:
    rows: list[tuple[Cell, ...]] = [*_READINGS, *_computed()]
    return Section(
        headline=f"{len(rows)} places are listed.",
        text=(
            "The scan has lost the figures and garbled some tables; beyond that the source disagrees "
            "with itself in places.",
        ),
        tables=(
            Table(
                caption="Places, the two readings, and what preshape does.",
                columns=("where", "one reading", "the other", "what preshape does"),
                rows=tuple(rows),
            ),
        ),
        pictures=(),
        disagreements=(),
    )


CONTRADICTIONS = Experiment(
    name="contradictions", title="Where the source contradicts itself",
    version=1, cost=0.1, measure=_measure, present=_present,
)  # fmt: skip
