"""The figures on the indices as a page for people: tables, two plots, and what they say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..dataset.index_values import INDICES, Index
from ..physics.hold.tables import TextTable
from .index_figures import Figures
from .plots import OURS, PAPER, QUIET, THIRD, Canvas

GRADES = (("good", 0.8), ("fair", 0.7), ("weak", 0.6))
"""Words for an area, by the lower end of its interval; below them it is poor [C]."""

_TITLES = {index.name: index.title for index in INDICES}
_ROWS, _COLUMNS = 3, 6  # of the calibration's small plots


def area_text(found: Figures) -> str:
    """An area with its interval; a dash where every grasp has the same number.

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
    """A difference of areas with its interval and its chance.

    >>> difference_text({"difference": -0.1234, "interval": (-0.2, -0.05), "p": 0.0003})
    '-0.12 (-0.20 to -0.05), p < 0.001'
    """
    if found["difference"] is None:
        return "–"
    text = f"{found['difference']:+.2f}"
    if found["interval"] is None:
        return text
    low, high = found["interval"]
    p = found["p"]
    chance = "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
    return f"{text} ({low:+.2f} to {high:+.2f}), {chance}"


def _by_name(document: Figures) -> dict[str, Figures]:
    return {question["name"]: question for question in document["questions"]}


def _of(question: Figures, index: Index) -> Figures:
    found: Figures = next(i for i in question["indices"] if i["name"] == index.name)
    return found


def lines(table: TextTable) -> list[str]:
    """A table as lines of Markdown."""
    rule = f"|{'---|' * len(table.columns)}"
    return [f"| {' | '.join(table.columns)} |", rule, *(f"| {' | '.join(row)} |" for row in table.rows)]


def tables(document: Figures) -> tuple[TextTable, ...]:
    """Areas, areas over harder choices, areas of each hand, and duels."""
    questions = _by_name(document)
    held, done = questions["held"], questions["done"]
    both = (("holding", held), ("task", done))
    main = TextTable(
        caption="Area under the ROC curve with 95 % interval: over all grasps, and within objects",
        columns=("index", *(f"{name}, {over}" for name, _ in both for over in ("all", "within"))),
        rows=tuple(
            (index.title, *(area_text(_of(q, index)[over]) for _, q in both for over in ("all", "within")))
            for index in INDICES
        ),
    )
    hard = ("held_if_closed", "done_if_closed", "done_if_held")
    harder = TextTable(
        caption="Within objects, among grasps that have passed something already",
        columns=("index", *(questions[name]["title"] for name in hard)),
        rows=tuple(
            (index.title, *(area_text(_of(questions[name], index)["within"]) for name in hard))
            for index in INDICES
        ),
    )
    hands = TextTable(
        caption="Within objects, for each hand",
        columns=("index", *(f"{name}, {hand}" for name, _ in both for hand in document["hands"])),
        rows=tuple(
            (index.title, *(area_text(_of(q, index)["hands"][h]) for _, q in both for h in document["hands"]))
            for index in INDICES
        ),
    )
    duels = TextTable(
        caption="By how much the first index' area is larger than the second's",
        columns=("first", "second", "predicting", "all", "within objects"),
        rows=tuple(
            (
                _TITLES[duel["first"]],
                _TITLES[duel["second"]],
                questions[duel["question"]]["title"],
                difference_text(duel["all"]),
                difference_text(duel["within"]),
            )
            for duel in document["duels"]
        ),
    )
    return main, harder, hands, duels


def findings(document: Figures) -> tuple[str, ...]:
    """What the figures say, one sentence each."""
    questions = _by_name(document)
    out = []
    for name in ("held", "done"):
        question = questions[name]
        ranked = [i for i in question["indices"] if i["within"]["area"] is not None]
        ranked.sort(key=lambda i: -i["within"]["area"])
        rate = f"{question['successes']} of {question['grasps']} grasps pass the {question['title']}"
        if not ranked:
            out.append(f"{rate}; no area can be given.")
            continue
        best = ", ".join(f"{_TITLES[i['name']]} {i['within']['area']:.2f}" for i in ranked[:3])
        worst = ", ".join(f"{_TITLES[i['name']]} {i['within']['area']:.2f}" for i in ranked[-3:])
        out.append(f"{rate}. Within objects the best predictors are {best}; the worst are {worst}.")
    names = ("tfvadi", "task_margin", "tfvadi_six", "stability", "manipulability")
    for index in (index for index in INDICES if index.name in names):
        spoken = "; ".join(
            f"{questions[name]['title']} {area_text(_of(questions[name], index)['within'])}"
            for name in ("held", "done", "done_if_closed", "done_if_held")
        )
        out.append(f"{index.title}, within objects: {spoken}. {_verdict(questions, index)}")
    return (*out, *_planner(questions))


def _planner(questions: dict[str, Figures]) -> tuple[str, ...]:
    """The planner's score is zero for most random grasps: what it is worth above zero."""
    index = next(index for index in INDICES if index.name == "planner")
    shares = []
    for name in ("held", "done"):
        above = [b for b in _of(questions[name], index)["bins"] if b["from"]]
        count, passed = (sum(b[key] for b in above) for key in ("count", "successes"))
        if not count:
            return ()
        shares.append(f"{passed} of {count} pass the {questions[name]['title']}")
    return (
        "The planner's score, at a share of the friction, is a sieve: of the grasps in the tenths where it "
        f"is above zero, {' and '.join(shares)}. An area, which counts the ties at zero as half, hides that.",
    )


def _verdict(questions: dict[str, Figures], index: Index) -> str:
    """In words, by the task test where the index knows the task, else by the holding test."""
    question = questions["done" if index.of_task else "held"]
    found = _of(question, index)["within"]
    test = question["title"]
    if found["interval"] is None:
        return f"Too few objects to judge it by the {test}."
    low, high = found["interval"]
    if low <= 0.5 <= high:
        return f"It does not predict the {test}: its interval holds 0.5, which is chance."
    if high < 0.5:
        return f"More of it goes with failure in the {test}."
    grade = next((word for word, least in GRADES if low >= least), "poor")
    return f"It is a {grade} predictor of the {test}."


def markdown(document: Figures) -> str:
    """The page."""
    things = ", ".join(document["objects"])
    page = [
        "# Which index predicts success?",
        "",
        f"{document['grasps']} grasps, seed {document['seed']}; hands {', '.join(document['hands'])}; "
        f"objects {things}; "
        "drawn at random, closed, not ranked; every grasp presses with 10 N. Each was put to the holding "
        "test (six directions) and, with a random named task that suits the object, to the task test. "
        f"MuJoCo {document['mujoco']}, preshape {document['version']}.",
        "",
        *(f"- {sentence}" for sentence in findings(document)),
        *(f"- Note: {note}." for note in document["notes"]),
        "",
        "An area of 0.5 is chance, 1 sorts perfectly. *All* compares all grasps (interval: DeLong); *within* "
        "only grasps of the same hand on the same object, so that telling easy objects from hard ones is no "
        "skill (interval: bootstrap over objects). Where less is better, as of the gap, the sign is turned. "
        "Words go by the lower end of the interval: good from 0.8, fair from 0.7, weak from 0.6, else poor.",
        "",
    ]
    for table in tables(document):
        page += [f"## {table.caption}", "", *lines(table), ""]
    page += ["## Plots", "", "![areas](areas.png)", "", "![calibration](calibration.png)", ""]
    page += ["## Rate of success by tenths", ""]
    for question in document["questions"][:2]:
        page += [f"### {question['title'].capitalize()}", "", *lines(_bins(question)), ""]
    page += ["## Success by hand and object", "", *lines(_rates(document)), ""]
    left_out = [
        f"{_TITLES[i['name']]}: its computation did not end for {i['left_out']} grasps of the {q['title']}."
        for q in document["questions"][:2]
        for i in q["indices"]
        if i["left_out"]
    ]
    return "\n".join([*page, *left_out]).rstrip() + "\n"


def _bins(question: Figures) -> TextTable:
    rows = tuple(
        (_TITLES[i["name"]], " · ".join(f"{100 * b['rate']:.0f} ({b['count']})" for b in i["bins"]))
        for i in question["indices"]
    )
    return TextTable(
        caption="",
        columns=("index", "% passed (grasps), the index' worst tenth first; ties together"),
        rows=rows,
    )


def _rates(document: Figures) -> TextTable:
    rows = []
    for thing in document["objects"]:
        cells = {rate["hand"]: rate for rate in document["rates"] if rate["object"] == thing}
        texts = (f"{c['held']} / {c['done']} of {c['grasps']}" for c in (cells[h] for h in document["hands"]))
        rows.append((thing, *texts))
    columns = ("object", *(f"{hand}, held / task done" for hand in document["hands"]))
    return TextTable(caption="", columns=columns, rows=tuple(rows))


def draw_areas(document: Figures, path: Path) -> None:
    """Every index' areas with intervals, for both tests."""
    questions = _by_name(document)
    at = range(len(INDICES))
    with Canvas(path, size=(10.5, 6.2), columns=2, sharey=True) as panels:
        for axes, name in zip(panels, ("held", "done"), strict=True):
            question = questions[name]
            axes.axvline(0.5, color=QUIET, linewidth=1.0, linestyle="--")
            for row, index in zip(at, INDICES, strict=True):
                found = _of(question, index)
                strong = PAPER if index.paper else OURS
                _dot(axes, found["all"], row - 0.17, QUIET, "o", 4.5)
                _dot(axes, found["within"], row + 0.17, strong, "D", 5.0)
            axes.set_title(f"{question['title']}: {question['successes']} of {question['grasps']} pass")
            axes.set_xlabel("area under the ROC curve, 95 %")
            axes.set_xlim(0.25, 1.02)
            axes.grid(axis="y", visible=False)
        panels[0].set_yticks(list(at), [index.title for index in INDICES])
        panels[0].invert_yaxis()
        for label, index in zip(panels[0].get_yticklabels(), INDICES, strict=True):
            label.set_color("black" if not index.paper else "#A86F00")
        kinds = ((QUIET, "o", "all grasps"), (OURS, "D", "within objects"), (PAPER, "D", "… the paper's"))
        for colour, marker, text in kinds:
            panels[1].plot([], [], marker, color=colour, label=text)
        panels[1].figure.legend(loc="outside lower center", ncols=3, frameon=False)


def _dot(axes: Any, found: Figures, height: float, colour: str, marker: str, size: float) -> None:
    if found["area"] is None:
        return
    if found["interval"] is not None:
        axes.plot(found["interval"], [height, height], color=colour, linewidth=1.6, solid_capstyle="butt")
    axes.plot([found["area"]], [height], marker, color=colour, markersize=size)


def draw_calibration(document: Figures, path: Path) -> None:
    """Rate of success by tenths of each index, for both tests."""
    questions = _by_name(document)
    kinds = (("held", OURS, "o"), ("done", THIRD, "s"))
    with Canvas(path, size=(13.0, 7.2)) as first:
        figure = first.figure
        figure.clear()
        grid = figure.subplots(_ROWS, _COLUMNS, sharex=True, sharey=True)
        places: Sequence[Any] = list(grid.flat)
        for axes, index in zip(places, INDICES, strict=False):
            for name, colour, marker in kinds:
                question = questions[name]
                _curve(axes, _of(question, index)["bins"], colour, marker, question["title"])
            axes.set_title(index.title, fontsize=9.0, color="#A86F00" if index.paper else "black")
            axes.set_xlim(-3, 103)
            axes.set_ylim(-3, 103)
        for spare in range(len(INDICES), len(places)):
            places[spare].axis("off")
            places[spare - _COLUMNS].tick_params(labelbottom=True)
        handles, labels = places[0].get_legend_handles_labels()
        places[-1].legend(handles, labels, loc="center")
        figure.supxlabel("rank of the grasp by the index, from worst to best [%]", fontsize=10.5)
        figure.supylabel("grasps that pass [%], with 95 % interval", fontsize=10.5)


def _curve(axes: Any, bins: Sequence[Figures], colour: str, marker: str, label: str) -> None:
    total = sum(b["count"] for b in bins) or 1
    start, x, y, low, high = 0, [], [], [], []
    for b in bins:
        x.append(100 * (start + b["count"] / 2) / total)
        start += b["count"]
        y.append(100 * b["rate"])
        low.append(100 * max(0.0, b["rate"] - b["interval"][0]))
        high.append(100 * max(0.0, b["interval"][1] - b["rate"]))
    axes.errorbar(
        x, y, yerr=[low, high], color=colour, marker=marker, markersize=3.5, linewidth=1.3,
        elinewidth=0.9, label=label,
    )  # fmt: skip


def write_report(document: Figures, rows: Sequence[dict[str, Any]], folder: Path) -> list[Path]:
    """report.md, report.json, grasps.json and the two plots, each whole or not at all.

    Raises:
        EnvironmentFailure: the folder cannot be written.
    """
    from ..planning.document import write_json, write_whole
    from .report import write_pages

    page = markdown(document)
    files = [folder / name for name in ("report.json", "grasps.json", "areas.png", "calibration.png")]
    write_json(files[0], document)
    write_json(files[1], {"format": "preshape indices 1", "rows": list(rows)})
    write_whole(files[2], lambda path: draw_areas(document, path))
    write_whole(files[3], lambda path: draw_calibration(document, path))
    files += write_pages(folder, page)
    return files
