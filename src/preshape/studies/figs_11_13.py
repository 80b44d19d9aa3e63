"""Figs. 11-13: three tasks on the cube, on a new primitive object, and on a complicated one (§4.1-4.3)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

from ..hiis.analyser import FingerRule
from ..hiis.decision import Settings
from ..report import Cell, Figure, Table
from ..tasks import task_from_numbers
from . import printed
from .experiment import Experiment, Progress, Section, joined, numbers_text, or_none, status_text
from .plots import OURS, PAPER, PlotCanvas, grouped_bars
from .printed import TaskRow
from .setup import CUBE, Data, Setup, run_case, teach

PRIMITIVE, COMPLICATED = "box", "dolphin"
"""The library objects of figs. 12 and 13 [C]; the paper's objects are not published."""

OTHER_PRIMITIVES = ("prism", "pyramid", "cylinder", "cone", "sphere", "wedge")

T = TypeVar("T")

CASES = {CUBE: printed.FIG_11, PRIMITIVE: printed.FIG_12, COMPLICATED: printed.FIG_13}
"""The nine cases: three tasks on each of the three objects."""


def measure_object(
    name: str,
    cases: Sequence[TaskRow],
    setup: Setup,
    part: Path,
    progress: Progress,
    finger_rule: FingerRule = "up_to",
) -> Data:
    """Run the cases on one object with each of the setup's seeds, on systems that know only the cube.

    The cases of a seed are run one after the other. If case 1 is answered without mode 3, the object is
    taught with that task afterwards. In cases 2 and 3 the object is then known, as in the paper.
    """

    def measure() -> Data:
        runs, extents = [], setup.prepare(setup.system(), name).mesh.extents
        for k, seed in enumerate(setup.seeds):
            system, rows, taught = setup.system(seed, finger_rule), [], ""
            settings = Settings(seed=seed, finger_rule=finger_rule)
            for i, case in enumerate(cases):
                done = (k + i / len(cases)) / len(setup.seeds)
                progress(done, f"seed {seed}, case {i + 1} of {len(cases)} on the {name}")
                ready = setup.prepare(system, name, task_from_numbers(case.task), settings=settings)
                rows.append(run_case(ready))
                if i == 0 and name != CUBE and rows[0]["mode"] != 3:
                    taught = teach(ready)
            runs.append({"seed": seed, "cases": rows, "taught_afterwards": taught})
        return {"object": name, "extents": [round(1000 * float(x), 1) for x in extents], "runs": runs}

    return setup.once((name, finger_rule), measure)


def _measure_12(setup: Setup, part: Path, progress: Progress) -> Data:
    objects = (PRIMITIVE, *OTHER_PRIMITIVES[: 1 if setup.quick else None])
    found = []
    for i, name in enumerate(objects):

        def tell(fraction: float, label: str, *, i: int = i) -> None:
            progress((i + fraction) / len(objects), label)

        found.append(measure_object(name, printed.FIG_12, setup, part, tell))
    return {**found[0], "others": found[1:]}


# Report.


def shown_plane(row: Data) -> int | None:
    """Plane of the answer; in mode 2 the estimated plane."""
    plane: int | None = row["answer"]["plane"] if row["answer"] else row["estimated_plane"]
    return plane


def shown_match(row: Data) -> float | None:
    """TFVADI of the answer; in mode 2 the TFVADI of recognition, as in the paper."""
    match: float | None = row["recognition"] if row["mode"] == 2 else None
    if row["answer"]:
        match = row["answer"]["tfvadi"]
    elif row["mode"] == 3 and row["best"]:
        match = row["best"]["tfvadi"]
    return match


def _outcome(row: Data) -> tuple[int | None, int]:
    """Plane and mode."""
    return shown_plane(row), row["mode"]


def by_case(data: Data) -> list[list[Data]]:
    """For each case, its rows of all seeds."""
    return [list(rows) for rows in zip(*(run["cases"] for run in data["runs"]), strict=True)]


def usual(rows: Sequence[Data]) -> Data:
    """The first of the rows that have the most frequent plane and mode."""
    most = _most_frequent([_outcome(row) for row in rows])
    return next(row for row in rows if _outcome(row) == most)


def _most_frequent(values: Sequence[T]) -> T:
    """The most frequent value; of several, the one that comes first."""
    return Counter(values).most_common(1)[0][0]


def _usual_planes(cases: Sequence[Sequence[Data]]) -> str:
    """For each case, the most frequent plane."""
    return _listed([_most_frequent([shown_plane(row) or "none" for row in rows]) for rows in cases])


def _usual_modes(cases: Sequence[Sequence[Data]]) -> str:
    """For each case, the most frequent mode."""
    return _listed([_most_frequent([row["mode"] for row in rows]) for rows in cases])


def equal_to_paper(cases: Sequence[TaskRow], data: Data) -> tuple[int, int]:
    """Number of rows, over all seeds, with the paper's plane, and with its mode.

    A mode without an answer, such as a deadlock of mode 3, is the paper's only in mode 2.
    """
    pairs = [(case, row) for case, rows in zip(cases, by_case(data), strict=True) for row in rows]
    planes = sum(shown_plane(row) == case.plane for case, row in pairs)
    modes = sum(row["mode"] == case.mode and bool(row["answer"]) == (case.mode != 2) for case, row in pairs)
    return planes, modes


def counted(values: Sequence[object]) -> str:
    """Values with the number of times that each occurs, the most frequent first.

    >>> counted([7, 7, 5]), counted([7, 7])
    ('7 (2), 5 (1)', '7 (2)')
    """
    return ", ".join(f"{value} ({n})" for value, n in Counter(values).most_common())


def plane_and_mode_counts(rows: Sequence[Data]) -> tuple[str, str]:
    """The planes and the modes of several rows, counted."""
    return counted([shown_plane(row) or "none" for row in rows]), counted([row["mode"] for row in rows])


def _listed(values: Sequence[object]) -> str:
    return ", ".join(map(str, values))


def _task_text(task: Sequence[float]) -> str:
    """Translation and rotation in one line each."""
    return f"{numbers_text(task[:3])}\n{numbers_text(task[3:])}"


def _table(cases: Sequence[TaskRow], data: Data) -> Table:
    cells: list[tuple[Cell, ...]] = []
    for i, (case, rows) in enumerate(zip(cases, by_case(data), strict=True), start=1):
        row = usual(rows)
        answer, best = row["answer"] or {}, row["best"]
        planes, modes = plane_and_mode_counts(rows)
        matches = [match for one in rows if (match := shown_match(one)) is not None]
        spread = f" ({min(matches):.2f} to {max(matches):.2f})" if matches else ""
        cells.append(
            (
                i, _task_text(case.task), case.plane, planes, case.mode, modes, case.value,
                answer.get("coordinate"), answer.get("value"), case.tfvadi,
                f"{or_none(shown_match(row))}{spread}",
                f"plane {best['plane']}, {best['tfvadi']:.2f}" if best else None,
            )
        )  # fmt: skip
    size = " × ".join(f"{x:g}" for x in data["extents"])
    return Table(
        caption=f"Three tasks on the {data['object']} ({size} mm): planes and modes with the number of "
        "seeds, the most frequent first. Value and TFVADI are those of the first seed with the most frequent "
        "plane and mode; in mode 2 the TFVADI is that of recognition.",
        columns=(
            "case", "task Q", "plane, paper", "planes, preshape", "mode, paper", "modes, preshape",
            "value in 4U, paper", "value in 4U, preshape", "share of the half-extent, preshape",
            "TFVADI, paper", "TFVADI, preshape (all seeds)", "best of all planes",
        ),
        rows=tuple(cells),
    )  # fmt: skip


def _seeds_table(cases: Sequence[TaskRow], data: Data) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (
            "paper", _listed([case.plane for case in cases]), _listed([case.mode for case in cases]),
            _listed([f"{case.tfvadi:g}" for case in cases]),
        )
    ]  # fmt: skip
    for run in data["runs"]:
        found = run["cases"]
        rows.append(
            (
                run["seed"], _listed([shown_plane(row) or "none" for row in found]),
                _listed([row["mode"] for row in found]),
                _listed([or_none(shown_match(row)) for row in found]),
            )
        )  # fmt: skip
    return Table(
        caption="The three cases with each seed.",
        columns=("seed", "planes", "modes", "TFVADI"),
        rows=tuple(rows),
    )


def _disagreements(cases: Sequence[TaskRow], data: Data) -> Iterator[str]:
    for i, (case, rows) in enumerate(zip(cases, by_case(data), strict=True), start=1):
        row = usual(rows)
        plane, mode, match = shown_plane(row), row["mode"], shown_match(row)
        theirs, ours = [], []
        if plane != case.plane:
            theirs.append(f"plane {case.plane}")
            ours.append(f"plane {plane}" if plane else "no plane")
        if mode != case.mode:
            theirs.append(f"mode {case.mode}")
            ours.append(f"mode {mode}" + ("" if row["answer"] else f" ({status_text(row['status'])})"))
        if match is None or abs(match - case.tfvadi) > 0.3:
            theirs.append(f"TFVADI {case.tfvadi:g}")
            ours.append("no match" if match is None else f"TFVADI {match:.2f}")
        if theirs:
            same = sum(_outcome(one) == _outcome(row) for one in rows)
            yield (
                f"Case {i}: the paper has {', '.join(theirs)}; preshape has {', '.join(ours)} (plane and "
                f"mode with {same} of {len(rows)} seeds). {_why(case, row)}"
            )


def _why(case: TaskRow, row: Data) -> str:
    """The reason for a disagreement, from the measured values."""
    best, answer = row["best"], row["answer"]
    steps = {(mode, outcome): reason for mode, outcome, reason in reversed(row["steps"])}
    if best is None:
        return "On no plane do fingers and thumb meet this object together."
    if case.mode != 2 and best["tfvadi"] < case.tfvadi - 0.3:
        return (
            f"The best TFVADI of all planes for this task is {best['tfvadi']:.2f} (plane {best['plane']}), "
            "so the paper's number is impossible on our object."
        )
    if row["mode"] == 2:
        return (
            f"The estimated plane {row['estimated_plane']} reaches "
            f"{or_none(row['searched'] and row['searched']['tfvadi'])} at most, while plane {best['plane']} "
            f"would reach {best['tfvadi']:.2f}. The object is recognised ({row['recognition'] or 0:.2f}), "
            "so the system asks for task correction."
        )
    if row["mode"] < case.mode:
        return f"At mode {row['mode']} {steps[(row['mode'], 'reward')]}, so mode {case.mode} is not reached."
    if row["mode"] == 1 and (0, "penalty") in steps:
        return (
            f"At mode 0 {steps[(0, 'penalty')]}. The search of mode 1 stays on plane {answer['plane']} and "
            f"finds {answer['tfvadi']:.2f} there; the best of all planes is {best['tfvadi']:.2f} on plane "
            f"{best['plane']}."
        )
    if row["mode"] == 3:
        failed = steps.get((1, "penalty"), "no match")
        return f"Modes 0 and 1 failed ({failed}) and the object is not recognised."
    where = f"The best of all planes is {best['tfvadi']:.2f}, on plane {best['plane']}"
    if row["mode"] == 0 and best["tfvadi"] > answer["tfvadi"] + 0.005:
        return f"{where}; mode 0 answers at the estimated plane and at the crisp value of a fuzzy set."
    return f"{where}; the objects differ."


def _draw(cases: Sequence[TaskRow], rows: Sequence[Data], path: Path) -> None:
    with PlotCanvas(path, size=(8.0, 3.6)) as axes:
        grouped_bars(
            axes,
            [f"case {i}\n{_task_text(case.task)}" for i, case in enumerate(cases, start=1)],
            [
                ("paper", [case.tfvadi for case in cases], PAPER),
                ("preshape", [shown_match(row) for row in rows], OURS),
            ],
            notes=[
                [f"plane {case.plane}\nmode {case.mode}" for case in cases],
                [f"plane {shown_plane(row)}\nmode {row['mode']}" for row in rows],
            ],
        )
        axes.set(ylim=(0, 7.6), ylabel="TFVADI (of 6)", yticks=range(7))
        axes.legend(loc="upper center", ncols=2, bbox_to_anchor=(0.5, 1.14))


def _case_1(data: Data) -> str:
    """What happened to the object in case 1."""
    name, total = data["object"], len(data["runs"])
    ends = Counter(
        "mode 3 learnt it"
        if run["cases"][0]["mode"] == 3 and run["cases"][0]["status"] == "answer"
        else f"mode 3 ended with {status_text(run['cases'][0]['status'])}"
        if run["cases"][0]["mode"] == 3
        else f"it ended at mode {run['cases'][0]['mode']} and the {name} was taught with that task afterwards"
        for run in data["runs"]
    )
    parts = [f"with {n} of {total} seeds {end}" for end, n in ends.most_common()]
    return f"In case 1 the {name} is new: {joined(parts)}."


def _section(name: str, cases: Sequence[TaskRow], data: Data, text: Sequence[str], *tables: Table) -> Section:
    rows = by_case(data)
    planes, modes = equal_to_paper(cases, data)
    seeds = [run["seed"] for run in data["runs"]]
    total = len(cases) * len(seeds)
    return Section(
        headline=f"{planes} of {total} planes and {modes} of {total} modes are the paper's; most often "
        f"planes {_usual_planes(rows)} and modes {_usual_modes(rows)}, in the paper planes "
        f"{_listed([case.plane for case in cases])} and modes {_listed([case.mode for case in cases])}.",
        text=(*text, f"The three cases are run with {len(seeds)} seeds of the network: {_listed(seeds)}."),
        tables=(_table(cases, data), _seeds_table(cases, data), *tables),
        figures=(
            Figure(
                file=f"figures/{name}.png",
                caption=f"TFVADI, plane and mode of the three tasks on the {data['object']}, of the first "
                "seed with the most frequent plane and mode; in mode 2 the TFVADI is that of recognition.",
                draw=partial(_draw, cases, [usual(one) for one in rows]),
            ),
        ),
        remarks=tuple(_disagreements(cases, data)),
    )


def _present_11(data: Data) -> Section:
    text = (
        "The system knows only the cube, from the first training, and gets three tasks on it that are not in "
        "its training set."
    )
    return _section("fig11", printed.FIG_11, data, (text,))


def _present_12(data: Data) -> Section:
    cells: list[tuple[Cell, ...]] = [("paper", "5, 10, 9", None, "3 (table: 2), 1, 0", None, None)]
    for one in (data, *data["others"]):
        cases = by_case(one)
        planes, modes = equal_to_paper(printed.FIG_12, one)
        total = len(cases) * len(one["runs"])
        cells.append(
            (
                one["object"], _usual_planes(cases),
                f"{planes} of {total}",
                _usual_modes(cases), f"{modes} of {total}",
                _listed([rows[0]["best"]["plane"] if rows[0]["best"] else "none" for rows in cases]),
            )
        )  # fmt: skip
    table = Table(
        caption="The three cases on every primitive object tried: the most frequent plane and mode of each "
        "case, and how many of all seeds are the paper's.",
        columns=("object", "planes", "the paper's plane", "modes", "the paper's mode", "best planes"),
        rows=tuple(cells),
    )
    text = (
        f"The new primitive object is the library's {data['object']}, whose proportions differ from the "
        f"cube's; the paper does not name its object. {_case_1(data)}",
        "The last table has the same three cases on the library's other primitive objects. Each is met by "
        "systems that know only the cube.",
    )
    return _section("fig12", printed.FIG_12, data, text, table)


def _present_13(data: Data) -> Section:
    text = f"The complicated object is the library's {data['object']}. {_case_1(data)}"
    return _section("fig13", printed.FIG_13, data, (text,))


FIG_11 = Experiment(
    name="fig11", title="Fig. 11: disturbed tasks on the trained cube",
    version=2, cost=6, measure=partial(measure_object, CUBE, printed.FIG_11), present=_present_11,
)  # fmt: skip
FIG_12 = Experiment(
    name="fig12", title="Fig. 12: learning a primitive object",
    version=2, cost=30, measure=_measure_12, present=_present_12,
)  # fmt: skip
FIG_13 = Experiment(
    name="fig13", title="Fig. 13: learning a complicated object",
    version=2, cost=8, measure=partial(measure_object, COMPLICATED, printed.FIG_13), present=_present_13,
)  # fmt: skip
