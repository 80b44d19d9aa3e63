"""The two readings of the number of fingers (§2.2), on figs. 11-13 and on figs. 17-18.

The extent along the transverse axis "determines" the number of fingers. Either all fingers that fit are used,
or as many of them as match the task best.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from ..hiis.analyser import FINGER_RULES, Aim, FingerRule
from ..hiis.decision import Settings, Status
from ..report import Cell, Table
from . import printed
from .experiment import Experiment, Progress, Section
from .figs_11_13 import CASES, by_case, equal_to_paper, measure_object, plane_and_mode_counts
from .odd_case_report import rate_text
from .odd_cases import is_odd, with_preshape
from .odd_cases import measure as measure_odd_cases
from .setup import Q1, Data, Setup, grasp_data

TOTAL = sum(map(len, CASES.values()))
"""Number of cases of figs. 11-13."""
NAMES = {"up_to": "up to as many as fit", "all": "all that fit"}
_OUTCOMES = {
    Status.ANSWER: "preshapes",
    Status.CORRECTION: "task corrections (mode 2)",
    Status.DEADLOCK: "deadlocks",
    Status.NO_GRASP: "no virtual grasp",
}
_SPLITS = ("mode", "fingers", "plane")


def _measure(setup: Setup, part: Path, progress: Progress) -> Data:
    data: Data = {}
    for k, rule in enumerate(FINGER_RULES):

        def tell(fraction: float, label: str, *, k: int = k, rule: FingerRule = rule) -> None:
            progress((k + fraction) / len(FINGER_RULES), f"fingers, {NAMES[rule]}: {label}")

        own_part = part.with_name(f"{part.stem}.{rule}.part")
        odd = measure_odd_cases(setup, own_part, tell, rule)
        keys = ("number", "outcome", "mode", "plane", "fingers", "hand")
        data[rule] = {
            "figures": {
                name: measure_object(name, cases, setup, own_part, lambda fraction, label: None, rule)
                for name, cases in CASES.items()
            },
            "rows": [{key: row.get(key) for key in keys} for row in odd["rows"]],
        }
    aim = Aim(planes=[printed.FIG_14_PLANE], values=[0.0], flips=[False])
    found = setup.analyser("hand").explore(Q1.q, aim).with_fingers("all")
    return data | {"all on the cube": grasp_data(found.grasp(), found.analyser)}


def _shares(found: Data) -> tuple[float, float]:
    """Mean number of the nine cases, over the seeds, with the paper's plane, and with its mode."""
    pairs = [equal_to_paper(cases, found["figures"][name]) for name, cases in CASES.items()]
    seeds = len(next(iter(found["figures"].values()))["runs"])
    return sum(p for p, _ in pairs) / seeds, sum(m for _, m in pairs) / seeds


def _agreeing(data: Data) -> tuple[int, int]:
    """Number of experiments with a preshape of the same plane under both rules, and with any under both."""
    one, two = ({row["number"]: row["plane"] for row in with_preshape(data[rule])} for rule in FINGER_RULES)
    both = one.keys() & two.keys()
    return sum(one[number] == two[number] for number in both), len(both)


def _rate(found: Data) -> str:
    rows = with_preshape(found)
    return rate_text(sum(map(is_odd, rows)), len(rows))


def _column(found: Data) -> list[Cell]:
    """What was measured with one rule, in the order of :func:`_labels`."""
    outcomes = Counter(row["outcome"] for row in found["rows"])
    split = [Counter(row[key] for row in with_preshape(found)) for key in _SPLITS]
    return [
        *_shares(found),
        _rate(found),
        *(outcomes[status.value] for status in _OUTCOMES),
        *(", ".join(f"{name}: {counts[name]}" for name in sorted(counts)) for counts in split),
    ]


def _labels() -> list[tuple[str, Cell]]:
    """Labels of the rows, and the paper's numbers."""
    return [
        (f"figs. 11-13: planes as in the paper, of {TOTAL}", TOTAL),
        (f"figs. 11-13: modes as in the paper, of {TOTAL}", TOTAL),
        ("figs. 17-18: odd cases", f"about {100 * printed.ODD_RATE:.0f} %"),
        *((f"figs. 17-18: {text}", None) for text in _OUTCOMES.values()),
        *((f"figs. 17-18: preshapes by {key}", None) for key in _SPLITS),
    ]


def _present(data: Data) -> Section:
    shares = {rule: _shares(data[rule]) for rule in FINGER_RULES}
    grasp = data["all on the cube"]
    same, both = _agreeing(data)
    columns = [_column(data[rule]) for rule in FINGER_RULES]
    cases: list[tuple[Cell, ...]] = []
    for number, (name, printed_cases) in zip((11, 12, 13), CASES.items(), strict=True):
        by_rule = [by_case(data[rule]["figures"][name]) for rule in FINGER_RULES]
        for i, case in enumerate(printed_cases):
            cells = [text for rows in by_rule for text in plane_and_mode_counts(rows[i])]
            cases.append((f"fig. {number} case {i + 1}", case.plane, case.mode, *cells))
    default, other = Settings().finger_rule, next(r for r in FINGER_RULES if r != Settings().finger_rule)
    return Section(
        headline=f"Planes of figs. 11-13 as in the paper: {shares[default][0]:.1f} of {TOTAL} with "
        f"{NAMES[default]} (the default), {shares[other][0]:.1f} with {NAMES[other]}; odd cases "
        f"{_rate(data[default])} and {_rate(data[other])}.",
        text=(
            'The paper says that the extent along the transverse axis "determines" the number of fingers. '
            "Either all fingers that fit are used, or as many of them as match the task best. Both rules are "
            "measured on figs. 11-13, in the mean over the seeds, and on the experiments of figs. 17-18 with "
            "the same draws. The rule applies to the first training too. A mode that ends in a deadlock is "
            "not counted as the paper's.",
            f"On the cube, all that fit are {grasp['fingers']} contacts, whose force along the approach axis "
            f"is {grasp['wrench'][0]:.2f} on plane {grasp['plane']}; fig. 14 prints "
            f"{printed.FIG_14[1].wrench[0]:g} for the same coefficients, which is that of three contacts.",
            f"Of {both} experiments of figs. 17-18 with a preshape under both rules, {same} have the same "
            "plane.",
        ),
        tables=(
            Table(
                caption="Both rules beside the paper.",
                columns=("", "paper", *(NAMES[rule] for rule in FINGER_RULES)),
                rows=tuple(
                    (*label, *cells) for label, *cells in zip(_labels(), *columns, strict=True)
                ),
            ),
            Table(
                caption="The nine cases: planes and modes with the number of seeds, the most frequent first.",
                columns=(
                    "case", "plane, paper", "mode, paper",
                    *(f"{what}, {NAMES[rule]}" for rule in FINGER_RULES for what in ("planes", "modes")),
                ),
                rows=tuple(cases),
            ),
        ),
    )  # fmt: skip


FINGERS = Experiment(
    name="fingers", title="Number of fingers",
    version=1, cost=300, measure=_measure, present=_present,
)  # fmt: skip
