"""Learns twenty objects with two tasks each, one after the other (§3.5): what is still known at the end?"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ..hiis.learning import explore
from ..objects.library import names
from ..planning.session import Prepared
from ..report import Cell, Figure, Table
from ..tasks import family_names, parse_task
from .experiment import Experiment, Progress, Section, status_text
from .plots import OURS, PAPER, THIRD, PlotCanvas
from .setup import CUBE, Data, Setup, teach

OBJECTS, QUICK_OBJECTS, TASKS = 20, 4, 2
_MODES = ("mode 0", "mode 1", "neither")


def _measure(setup: Setup, part: Path, progress: Progress) -> Data:
    count = QUICK_OBJECTS if setup.quick else OBJECTS
    rng = np.random.default_rng(setup.seed)
    drawn = [str(name) for name in rng.permutation(np.array(names()))[:count]]
    tasks = [sorted(map(str, rng.choice(family_names(), TASKS, replace=False))) for _ in drawn]
    system = setup.system()
    start = setup.prepare(system, CUBE).controller.weights
    learning: list[Data] = []
    for i, (name, families) in enumerate(zip(drawn, tasks, strict=True)):
        progress(i / (2 * count), f"learning {name}, object {i + 1} of {count}")
        ready = setup.prepare(system, name)
        begin = time.perf_counter()
        statuses = [teach(ready, parse_task(family)) for family in families]
        weights = ready.controller.weights
        learning.append(
            {
                "object": name,
                "tasks": families,
                "statuses": statuses,
                "error": weights.mean_square_error,
                "samples": weights.trained_on,
                "seconds": time.perf_counter() - begin,
            }
        )
    answers: list[Data] = []
    for i, (name, families) in enumerate(zip(drawn, tasks, strict=True)):
        progress(0.5 + i / (2 * count), f"asking again about {name}")
        for family in families:
            ready = setup.prepare(system, name, parse_task(family))
            answers.append({"order": i, "object": name, "task": family, **_answer(ready)})
    return {
        "objects": count,
        "families": len({family for families in tasks for family in families}),
        "start": {"error": start.mean_square_error, "samples": start.trained_on},
        "learning": learning,
        "answers": answers,
    }


def _answer(ready: Prepared) -> Data:
    """The mode that now answers, and the explorer's best match for comparison."""
    controller, task = ready.controller, ready.task
    decision = controller.run(ready.element, task, may_learn=False)
    controller.reset()
    s = controller.settings
    found = explore(ready.element, task.q, s.sets, enough=s.thresholds.estimation)
    grasp = decision.grasp
    return {
        "mode": decision.mode,
        "status": decision.status.value,
        "plane": grasp and grasp.plane.index,
        "tfvadi": grasp and round(grasp.tfvadi, 6),
        "best_plane": found and found.answer.plane.index,
        "best": found and round(found.answer.tfvadi, 6),
        "best_crisp": found and round(found.taught.tfvadi, 6),
    }


def _counts(answers: list[Data]) -> tuple[int, int, int]:
    """Number of answers at mode 0, at mode 1, and of the others."""
    zero = sum(one["mode"] == 0 for one in answers)
    one = sum(one["mode"] == 1 for one in answers)
    return zero, one, len(answers) - zero - one


def _groups(data: Data) -> list[tuple[str, list[Data]]]:
    half = data["objects"] // 2
    first = [one for one in data["answers"] if one["order"] < half]
    last = [one for one in data["answers"] if one["order"] >= data["objects"] - half]
    return [("all", data["answers"]), (f"first {half} objects", first), (f"last {half} objects", last)]


def _percent(part: int, whole: int) -> str:
    return f"{part} of {whole} ({100 * part / whole:.0f} %)" if whole else "none"


def _present(data: Data) -> Section:
    groups: list[tuple[Cell, ...]] = []
    for label, answers in _groups(data):
        zero, one, _ = _counts(answers)
        at_zero = [answer for answer in answers if answer["mode"] == 0]
        same = sum(answer["plane"] == answer["best_plane"] for answer in at_zero)
        n = len(answers)
        groups.append((label, _percent(zero, n), _percent(zero + one, n), _percent(same, len(at_zero))))
    rows = tuple(
        (
            i, lesson["object"], " and ".join(lesson["tasks"]), lesson["samples"],
            f"{lesson['error']:.1e}", f"{lesson['seconds']:.2f}",
            ", ".join(_answer_text(answer) for answer in data["answers"] if answer["order"] == i - 1),
        )
        for i, lesson in enumerate(data["learning"], start=1)
    )  # fmt: skip
    slowest = max(lesson["seconds"] for lesson in data["learning"])
    zero, one, _ = _counts(data["answers"])
    total = len(data["answers"])
    return Section(
        headline=f"Of {total} tasks learnt, {_percent(zero, total)} are answered at mode 0 and "
        f"{_percent(zero + one, total)} at mode 0 or 1.",
        text=(
            f"The seed draws {data['objects']} library objects and for each of them {TASKS} of the "
            f"{len(family_names())} task families ({data['families']} families occur, each along its "
            "default axis). They are taught one after the other to a system that knows only the cube. Then "
            "every task is asked again in the same order, without learning. The longest time for one "
            f"object was {slowest:.1f} s. The paper has no such study; it says that old data stay in the "
            "training set (§3.5).",
        ),
        tables=(
            Table(
                caption="Answers after all objects were learnt.",
                columns=(
                    "objects", "at mode 0", "at mode 0 or 1", "mode-0 answers on the explorer's best plane",
                ),
                rows=tuple(groups),
            ),
            Table(
                caption="Objects in the order of learning; the error is the network's after the object was "
                "learnt.",
                columns=(
                    "", "object", "tasks", "samples", "mean-square error", "time [s]", "answered at the end",
                ),
                rows=rows,
            ),
        ),
        figures=(
            Figure(
                file="figures/learning.png",
                caption="Left: answers at the end, for the first and the last objects. Middle: error after "
                "each object. Right: time for each object.",
                draw=partial(_draw, data),
            ),
        ),
        remarks=tuple(_remarks(data)),
        remarks_title="Remarks",
    )  # fmt: skip


def _answer_text(answer: Data) -> str:
    return f"mode {answer['mode']}" if answer["plane"] else status_text(answer["status"])


def _remarks(data: Data) -> Iterator[str]:
    _, (first_name, first), (last_name, last) = _groups(data)
    a, b = _counts(first)[0], _counts(last)[0]
    if a < b:
        meaning = "this is a difference of one task" if b - a == 1 else "the system may have forgotten some"
        yield (
            f"Of the {first_name} {a} of {len(first)} tasks are answered at mode 0, of the {last_name} {b} "
            f"of {len(last)}: {meaning}."
        )
    elsewhere = [
        answer
        for answer in data["answers"]
        if answer["mode"] == 0 and answer["plane"] != answer["best_plane"]
    ]
    if elsewhere:
        lower = [answer["best"] - answer["tfvadi"] for answer in elsewhere]
        yield (
            f"{len(elsewhere)} mode-0 answers are on another plane than the explorer's best. Their TFVADI "
            f"is lower by {sum(lower) / len(lower):.2f} on average and by {max(lower):.2f} at most. A grasp "
            "is taught at the crisp value of a fuzzy set, because only that can be recalled, so it may be "
            "on another plane than the best of all."
        )
    for answer in data["answers"]:
        if answer["plane"] is not None:
            continue
        reach = "no virtual grasp exists"
        if answer["best"] is not None:
            reach = f"the best of all planes is {answer['best']:.2f}"
        if answer["best_crisp"] is not None and answer["best_crisp"] < answer["best"]:
            reach += f", and {answer['best_crisp']:.2f} at the crisp value that was taught"
        yield f"{answer['object']}, {answer['task']}: {status_text(answer['status'])}; {reach}."


def _draw(data: Data, path: Path) -> None:
    with PlotCanvas(path, size=(11.0, 3.7), columns=3) as (left, middle, right):
        groups = _groups(data)[1:]
        bottom = [0.0] * len(groups)
        for k, (mode, colour) in enumerate(zip(_MODES, (OURS, PAPER, "#9AA3AD"), strict=True)):
            counts = [_counts(answers)[k] for _, answers in groups]
            left.bar(range(len(groups)), counts, 0.6, bottom=bottom, color=colour, label=mode)
            for i, count in enumerate(counts):
                if count:
                    left.annotate(
                        str(count),
                        (i, bottom[i] + count / 2),
                        ha="center",
                        va="center",
                        color="white" if k == 0 else "black",
                    )
                bottom[i] += count
        left.set_xticks(range(len(groups)), [label for label, _ in groups])
        left.set(ylabel="tasks answered at the end", ylim=(0, max(bottom) * 1.3), xlim=(-0.6, 1.6))
        left.grid(axis="x", visible=False)
        left.legend(loc="upper center", ncols=3, fontsize=9, columnspacing=1.0, handlelength=1.2)
        errors = [data["start"]["error"], *(lesson["error"] for lesson in data["learning"])]
        middle.plot(range(len(errors)), errors, "o-", color=OURS, ms=4)
        middle.axhline(5e-4, color="black", lw=0.9, ls="--")
        middle.annotate("target 5e-04", (0, 5e-4), (0, 3), textcoords="offset points", fontsize=8.5)
        middle.set(yscale="log", xlabel="objects learnt after the cube", ylabel="mean-square error")
        middle.set_ylim(min(errors) / 2, 2e-3)
        seconds = [lesson["seconds"] for lesson in data["learning"]]
        right.bar(range(1, len(seconds) + 1), seconds, color=THIRD)
        right.set(xlabel="object", ylabel="time to learn it [s]")
        right.grid(axis="x", visible=False)


LEARNING = Experiment(
    name="learning", title="Learning: twenty objects, one after the other",
    version=2, cost=30, measure=_measure, present=_present,
)  # fmt: skip
