"""The report of the index study: tables, two plots, and the findings as sentences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..dataset.index_values import INDICES, Index
from ..files import write_json
from ..report import Bullets, Chapter, Figure, Heading, Report, Table, write_report
from .index_figures import Figures
from .plots import OURS, PAPER, QUIET, THIRD, PlotCanvas

GRADES = (("good", 0.8), ("fair", 0.7), ("weak", 0.6))
"""Name of an area by the lower end of its interval; below all limits, the area is poor [C]."""

_TITLES = {index.name: index.title for index in INDICES}
_TESTS = (("holding", "held"), ("task", "done"))  # name in the tables and question of both tests
_PAPER_TEXT = "#A86F00"  # the paper's colour, dark enough for text
_ROWS, _COLUMNS = 3, 6  # of the calibration plots


def area_text(found: Figures) -> str:
    """An area with its interval; a dash if all grasps have the same score.

    >>> area_text({"area": 0.8149, "interval": (0.79, 0.84)})
    '0.81 (0.79-0.84)'
    >>> area_text({"area": None, "interval": None}), area_text({"area": 0.5, "interval": (0.5, 0.5)})
    ('–', '–')
    """
    if found["area"] is None or found["interval"] == (0.5, 0.5):
        return "–"
    interval = found["interval"]
    return f"{found['area']:.2f}" + (f" ({interval[0]:.2f}-{interval[1]:.2f})" if interval else "")


def difference_text(found: Figures) -> str:
    """A difference of areas with its interval and p-value.

    >>> difference_text({"difference": -0.1234, "interval": (-0.2, -0.05), "p": 0.0003})
    '-0.12 (-0.20 to -0.05), p < 0.001'
    """
    if found["difference"] is None:
        return "–"
    text = f"{found['difference']:+.2f}"
    if found["interval"] is None:
        return text
    low, high = found["interval"]
    p = "p < 0.001" if found["p"] < 0.001 else f"p = {found['p']:.3f}"
    return f"{text} ({low:+.2f} to {high:+.2f}), {p}"


def _questions(document: Figures) -> dict[str, Figures]:
    return {question["name"]: question for question in document["questions"]}


def _of(question: Figures, index: Index) -> Figures:
    found: Figures = next(one for one in question["indices"] if one["name"] == index.name)
    return found


def index_tables(document: Figures) -> tuple[Table, ...]:
    """Tables of areas for both tests, for harder choices and for each hand, and of differences."""
    questions = _questions(document)

    def areas(caption: str, columns: dict[str, Callable[[Index], Figures]]) -> Table:
        """A table with one row for each index; the function of each column selects its areas."""
        return Table(
            caption=caption,
            columns=("index", *columns),
            rows=tuple(
                (index.title, *(area_text(pick(index)) for pick in columns.values())) for index in INDICES
            ),
        )

    def pick(name: str, *keys: str) -> Callable[[Index], Figures]:
        def found(index: Index) -> Figures:
            figures = _of(questions[name], index)
            for key in keys:
                figures = figures[key]
            return figures

        return found

    differences = Table(
        caption="Area of the first index less that of the second",
        columns=("first", "second", "predicting", "all", "within objects"),
        rows=tuple(
            (
                _TITLES[one["first"]],
                _TITLES[one["second"]],
                questions[one["question"]]["title"],
                difference_text(one["all"]),
                difference_text(one["within"]),
            )
            for one in document["comparisons"]
        ),
    )
    return (
        areas(
            "Area under the ROC curve with 95 % interval, over all grasps and within objects",
            {f"{test}, {over}": pick(name, over) for test, name in _TESTS for over in ("all", "within")},
        ),
        areas(
            "Within objects, among grasps that meet a condition",
            {
                questions[name]["title"]: pick(name, "within")
                for name in ("held_if_closed", "done_if_closed", "done_if_held")
            },
        ),
        areas(
            "Within objects, for each hand",
            {
                f"{test}, {hand}": pick(name, "hands", hand)
                for test, name in _TESTS
                for hand in document["hands"]
            },
        ),
        differences,
    )


def findings(document: Figures) -> tuple[str, ...]:
    """The findings, each in one or two sentences."""
    questions = _questions(document)
    out = []
    for _, name in _TESTS:
        question = questions[name]
        rate = f"{question['successes']} of {question['grasps']} grasps pass the {question['title']}"
        known = [one for one in question["indices"] if one["within"]["area"] is not None]
        if not known:
            out.append(f"{rate}; there are too few to compute areas.")
            continue
        known.sort(key=lambda one: -one["within"]["area"])
        best, worst = (
            ", ".join(f"{_TITLES[one['name']]} {one['within']['area']:.2f}" for one in part)
            for part in (known[:3], known[-3:])
        )
        out.append(f"{rate}. Within objects the best predictors are {best}; the worst are {worst}.")
    shown = ("tfvadi", "task_margin", "tfvadi_six", "stability", "manipulability")
    for index in (index for index in INDICES if index.name in shown):
        areas = "; ".join(
            f"{questions[name]['title']} {area_text(_of(questions[name], index)['within'])}"
            for name in ("held", "done", "done_if_closed", "done_if_held")
        )
        out.append(f"{index.title}, area within objects: {areas}. {_verdict(questions, index)}")
    return (*out, *_planner_finding(questions))


def _planner_finding(questions: dict[str, Figures]) -> tuple[str, ...]:
    """The success rate of grasps with a planner's score above zero; for most random grasps it is zero."""
    index = next(index for index in INDICES if index.name == "planner")
    shares = []
    for _, name in _TESTS:
        above = [one for one in _of(questions[name], index)["bins"] if one["from"]]
        count, passed = (sum(one[key] for one in above) for key in ("count", "successes"))
        if not count:
            return ()
        shares.append(f"{passed} of {count} pass the {questions[name]['title']}")
    return (
        "The planner's score, which uses a share of the friction, is zero for most random grasps. Of the "
        f"grasps in the tenths where it is above zero, {' and '.join(shares)}. The area does not show this, "
        "because it counts ties at zero as half.",
    )


def _verdict(questions: dict[str, Figures], index: Index) -> str:
    """How well an index predicts the task test if it depends on the task, otherwise the holding test."""
    question = questions["done" if index.of_task else "held"]
    found = _of(question, index)["within"]
    test = question["title"]
    if found["interval"] is None:
        return f"There are too few objects to judge it by the {test}."
    low, high = found["interval"]
    if low <= 0.5 <= high:
        return f"It does not predict the {test}: the interval contains 0.5, which is chance."
    if high < 0.5:
        return f"Larger values go with failure in the {test}."
    grade = next((word for word, least in GRADES if low >= least), "poor")
    return f"It is a {grade} predictor of the {test}."


def index_report(document: Figures) -> Report:
    """The report; its figures are drawn when it is written."""
    tests = document["questions"][:2]
    preface = (
        f"{document['grasps']} grasps, seed {document['seed']}; hands {', '.join(document['hands'])}; "
        f"objects {', '.join(document['objects'])}. The grasps are drawn at random and closed without "
        "ranking; each presses with 10 N. Each went through the holding test (six directions) and the task "
        "test with a random named task that suits the object. "
        f"MuJoCo {document['mujoco']}, preshape {document['version']}.",
        Bullets(items=(*findings(document), *(f"Note: {note}." for note in document["notes"]))),
        "An area of 0.5 is chance, 1 sorts perfectly. *All* compares all grasps (interval: DeLong). "
        "*Within* compares only grasps of the same hand on the same object, so telling easy objects from "
        "hard ones does not count (interval: bootstrap over objects). The sign is turned where less is "
        "better, as for the gap. Predictors are graded by the lower end of the interval: good from 0.8, fair "
        "from 0.7, weak from 0.6, else poor.",
    )
    plots = (
        Figure(
            file="areas.png",
            caption="Area under the ROC curve of each index, for both tests",
            draw=lambda path: _draw_areas(document, path),
        ),
        Figure(
            file="calibration.png",
            caption="Success rate by tenths of each index, for both tests",
            draw=lambda path: _draw_calibration(document, path),
        ),
    )
    left_out = [
        f"{_TITLES[one['name']]}: could not be computed for {one['left_out']} grasps of the {test['title']}."
        for test in tests
        for one in test["indices"]
        if one["left_out"]
    ]
    return Report(
        title="Which index predicts success?",
        preface=preface,
        chapters=(
            *(
                Chapter(title=table.caption, blocks=(replace(table, caption=""),))
                for table in index_tables(document)
            ),
            Chapter(title="Plots", blocks=plots),
            Chapter(
                title="Success rate by tenths of each index",
                blocks=tuple(
                    block
                    for test in tests
                    for block in (Heading(text=test["title"].capitalize()), _bins(test))
                ),
            ),
            Chapter(title="Success by hand and object", blocks=(_rates(document), *left_out)),
        ),
    )


def _bins(question: Figures) -> Table:
    rows = tuple(
        (
            _TITLES[one["name"]],
            " · ".join(f"{100 * each['rate']:.0f} ({each['count']})" for each in one["bins"]),
        )
        for one in question["indices"]
    )
    return Table(
        caption="",
        columns=("index", "% passed (number of grasps), worst tenth first; equal values in one bin"),
        rows=rows,
    )


def _rates(document: Figures) -> Table:
    rates = {(rate["object"], rate["hand"]): rate for rate in document["rates"]}
    rows = []
    for name in document["objects"]:
        found = [rates[name, hand] for hand in document["hands"]]
        rows.append((name, *(f"{one['held']} / {one['done']} of {one['grasps']}" for one in found)))
    columns = ("object", *(f"{hand}, held / task done" for hand in document["hands"]))
    return Table(caption="", columns=columns, rows=tuple(rows))


def _draw_areas(document: Figures, path: Path) -> None:
    """Areas of all indices with their intervals, for both tests."""
    questions = _questions(document)
    places = range(len(INDICES))
    with PlotCanvas(path, size=(10.5, 6.2), columns=2, sharey=True) as panels:
        for axes, (_, name) in zip(panels, _TESTS, strict=True):
            question = questions[name]
            axes.axvline(0.5, color=QUIET, linewidth=1.0, linestyle="--")
            for place, index in zip(places, INDICES, strict=True):
                found = _of(question, index)
                _draw_area(axes, found["all"], place - 0.17, QUIET, "o", 4.5)
                _draw_area(axes, found["within"], place + 0.17, PAPER if index.paper else OURS, "D", 5.0)
            axes.set_title(f"{question['title']}: {question['successes']} of {question['grasps']} pass")
            axes.set_xlabel("area under the ROC curve, 95 %")
            axes.set_xlim(0.25, 1.02)
            axes.grid(axis="y", visible=False)
        panels[0].set_yticks(list(places), [index.title for index in INDICES])
        panels[0].invert_yaxis()
        for label, index in zip(panels[0].get_yticklabels(), INDICES, strict=True):
            label.set_color(_PAPER_TEXT if index.paper else "black")
        kinds = (
            (QUIET, "o", "all grasps"),
            (OURS, "D", "within objects"),
            (PAPER, "D", "within objects, the paper's indices"),
        )
        for colour, marker, text in kinds:
            panels[1].plot([], [], marker, color=colour, label=text)
        panels[1].figure.legend(loc="outside lower center", ncols=3, frameon=False)


def _draw_area(axes: Any, found: Figures, height: float, colour: str, marker: str, size: float) -> None:
    if found["area"] is None:
        return
    if found["interval"] is not None:
        axes.plot(found["interval"], [height, height], color=colour, linewidth=1.6, solid_capstyle="butt")
    axes.plot([found["area"]], [height], marker, color=colour, markersize=size)


def _draw_calibration(document: Figures, path: Path) -> None:
    """Success rate by tenths of each index, for both tests."""
    questions = _questions(document)
    with PlotCanvas(path, size=(13.0, 7.2)) as first:
        figure = first.figure
        figure.clear()
        grid = figure.subplots(_ROWS, _COLUMNS, sharex=True, sharey=True)
        panels: Sequence[Any] = list(grid.flat)
        for axes, index in zip(panels, INDICES, strict=False):
            for name, colour, marker in (("held", OURS, "o"), ("done", THIRD, "s")):
                question = questions[name]
                _draw_bins(axes, _of(question, index)["bins"], colour, marker, question["title"])
            axes.set_title(index.title, fontsize=9.0, color=_PAPER_TEXT if index.paper else "black")
            axes.set_xlim(-3, 103)
            axes.set_ylim(-3, 103)
        for spare in range(len(INDICES), len(panels)):
            panels[spare].axis("off")
            panels[spare - _COLUMNS].tick_params(labelbottom=True)
        handles, labels = panels[0].get_legend_handles_labels()
        panels[-1].legend(handles, labels, loc="center")
        figure.supxlabel("rank of the grasp by the index, from worst to best [%]", fontsize=10.5)
        figure.supylabel("grasps that pass [%], with 95 % interval", fontsize=10.5)


def _draw_bins(axes: Any, bins: Sequence[Figures], colour: str, marker: str, label: str) -> None:
    total = sum(one["count"] for one in bins) or 1
    start, x, y, low, high = 0, [], [], [], []
    for one in bins:
        x.append(100 * (start + one["count"] / 2) / total)
        start += one["count"]
        y.append(100 * one["rate"])
        low.append(100 * max(0.0, one["rate"] - one["interval"][0]))
        high.append(100 * max(0.0, one["interval"][1] - one["rate"]))
    axes.errorbar(
        x, y, yerr=[low, high], color=colour, marker=marker, markersize=3.5, linewidth=1.3,
        elinewidth=0.9, label=label,
    )  # fmt: skip


def write_index_report(document: Figures, rows: Sequence[dict[str, Any]], folder: Path) -> list[Path]:
    """Write report.md, report.html, report.json, grasps.json and the two plots; return their paths.

    Raises:
        EnvironmentFailure: The folder cannot be written.
    """
    report = index_report(document)
    write_json(folder / "report.json", document)
    write_json(folder / "grasps.json", {"format": "preshape indices 1", "rows": list(rows)})
    pages = write_report(folder, report)
    plots = [folder / figure.file for figure in report.figures]
    return [folder / "report.json", folder / "grasps.json", *plots, *pages]
