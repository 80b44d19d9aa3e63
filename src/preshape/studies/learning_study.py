"""Twenty objects with two tasks each, learnt one after the other (§3.5): what is still known at the end?"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from ..hiis.learning import explore
from ..objects.library import load_library_object, names
from ..tasks import family_names, parse_task
from .bench import Bench
from .plots import OURS, PAPER, THIRD, Canvas
from .values import Cell, Data, Experiment, Picture, Progress, Section, Table

OBJECTS, TASKS = 20, 2
_MODES = ("mode 0", "mode 1", "neither")


def _measure(bench: Bench, part: Path, progress: Progress) -> Data:
    count = 4 if bench.quick else OBJECTS
    rng = np.random.default_rng(bench.seed)
    drawn = [str(name) for name in rng.permutation(np.array(names()))[:count]]
    asked = [sorted(map(str, rng.choice(family_names(), TASKS, replace=False))) for _ in drawn]
    controller = bench.controller()
    start = controller.weights
    learning: list[Data] = []
    elements: list[Any] = []
    for i, (name, families) in enumerate(zip(drawn, asked, strict=True)):
        progress(i / (2 * count), f"learning {name}, object {i + 1} of {count}")
        element = controller.prepare(load_library_object(name))
        elements.append(element)
        begin = time.perf_counter()
        statuses = []
        for family in families:
            statuses.append(controller.teach(element, parse_task(family)).status.value)
            controller.reset()
        learning.append(
            {
                "object": name,
                "tasks": families,
                "statuses": statuses,
                "error": controller.weights.mean_square_error,
                "samples": controller.weights.trained_on,
                "seconds": time.perf_counter() - begin,
            }
        )
    answers: list[Data] = []
    for i, (name, families) in enumerate(zip(drawn, asked, strict=True)):
        progress(0.5 + i / (2 * count), f"asking again about {name}")
        for family in families:
            answers.append(
                {"order": i, "object": name, "task": family, **_ask(controller, elements[i], family)}
            )
    return {
        "objects": count,
        "families": len({family for families in asked for family in families}),
        "start": {"error": start.mean_square_error, "samples": start.trained_on},
        "learning": learning,
        "answers": answers,
    }


def _ask(controller: Any, element: Any, family: str) -> Data:
    """The mode that answers now, and whether its plane is the explorer's best."""
    task, settings = parse_task(family), controller.settings
    decision = controller.run(element, task, may_learn=False)
    controller.reset()
    found = explore(element, task.q, settings.sets, enough=settings.thresholds.estimation)
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


def _shares(answers: list[Data]) -> tuple[int, int, int]:
    """How many mode 0 answers, how many mode 1 answers, how many neither."""
    zero = sum(a["mode"] == 0 for a in answers)
    one = sum(a["mode"] == 1 for a in answers)
    return zero, one, len(answers) - zero - one


def _groups(data: Data) -> list[tuple[str, list[Data]]]:
    half = data["objects"] // 2
    first = [a for a in data["answers"] if a["order"] < half]
    last = [a for a in data["answers"] if a["order"] >= data["objects"] - half]
    return [("all", data["answers"]), (f"first {half} objects", first), (f"last {half} objects", last)]


def _percent(part: int, whole: int) -> str:
    return f"{part} of {whole} ({100 * part / whole:.0f} %)" if whole else "none"


def _present(data: Data) -> Section:
    groups: list[tuple[Cell, ...]] = []
    for label, answers in _groups(data):
        zero, one, _ = _shares(answers)
        at_zero = [a for a in answers if a["mode"] == 0]
        same = sum(a["plane"] == a["best_plane"] for a in at_zero)
        n = len(answers)
        groups.append((label, _percent(zero, n), _percent(zero + one, n), _percent(same, len(at_zero))))
    rows = tuple(
        (
            i, one["object"], " and ".join(one["tasks"]), one["samples"],
            f"{one['error']:.1e}", f"{one['seconds']:.2f}",
            ", ".join(_shown(a) for a in data["answers"] if a["order"] == i - 1),
        )
        for i, one in enumerate(data["learning"], start=1)
    )  # fmt: skip
    slowest = max(one["seconds"] for one in data["learning"])
    zero, one, _ = _shares(data["answers"])
    total = len(data["answers"])
    return Section(
        headline=f"Of {total} tasks learnt, {_percent(zero, total)} are answered at mode 0 and "
        f"{_percent(zero + one, total)} at mode 0 or 1.",
        text=(
            f"{data['objects']} library objects, drawn by the seed, with {TASKS} task families each "
            f"drawn from {len(family_names())} "
            f"({data['families']} occur, each along its default axis), are taught one after the other "
            "to a system that knows the cube "
            f"only. Then every task is asked again, in order, without learning. The longest time for "
            f"one object was {slowest:.1f} s. "
            "The paper has no such study; it says that old data stay in the training set (§3.5).",
        ),
        tables=(
            Table(
                caption="What the system answers once all have been learnt.",
                columns=("objects", "at mode 0", "at mode 0 or 1", "mode-0 answers on the explorer's "
                "best plane"),
                rows=tuple(groups),
            ),
            Table(
                caption="In the order of learning; the error is the network's after the object was learnt.",
                columns=(
                    "", "object", "tasks", "samples", "mean-square error", "time [s]", "answered at the end",
                ),
                rows=rows,
            ),
        ),
        pictures=(
            Picture(
                name="learning",
                caption="Left: answers at the end, first objects against last. Middle: error after each "
                "object. Right: time for each object.",
                draw=lambda path: _draw(data, path),
            ),
        ),
        disagreements=tuple(_remarks(data)),
    )  # fmt: skip


def _shown(answer: Data) -> str:
    return f"mode {answer['mode']}" if answer["plane"] else answer["status"].replace("_", " ")


def _remarks(data: Data) -> list[str]:
    out = []
    (_, _), (first_name, first), (last_name, last) = _groups(data)
    a, b = _shares(first)[0], _shares(last)[0]
    if a < b:
        out.append(
            f"Of the {first_name} {a} of {len(first)} tasks are answered at mode 0, of the {last_name} "
            f"{b} of {len(last)}: "
            f"{'a difference of one task' if b - a == 1 else 'some forgetting cannot be ruled out'}."
        )
    elsewhere = [x for x in data["answers"] if x["mode"] == 0 and x["plane"] != x["best_plane"]]
    if elsewhere:
        short = [x["best"] - x["tfvadi"] for x in elsewhere]
        out.append(
            f"{len(elsewhere)} mode-0 answers stand on another plane than the explorer's best; their "
            "TFVADI is lower "
            f"by {sum(short) / len(short):.2f} on average and by {max(short):.2f} at most. What is "
            "taught must be "
            "recalled at the crisp value of a fuzzy set, so it may stand on another plane than the best "
            "of all."
        )
    unanswered = [x for x in data["answers"] if x["plane"] is None]
    for x in unanswered:
        reach = (
            "no virtual grasp exists" if x["best"] is None else f"the best of all planes is {x['best']:.2f}"
        )
        if x["best_crisp"] is not None and x["best_crisp"] < x["best"]:
            reach += f", and {x['best_crisp']:.2f} at the crisp value that was taught"
        out.append(f"{x['object']}, {x['task']}: {x['status'].replace('_', ' ')}; {reach}.")
    return out


def _draw(data: Data, path: Path) -> None:
    with Canvas(path, size=(11.0, 3.7), columns=3) as (left, middle, right):
        groups = _groups(data)[1:]
        bottom = [0.0] * len(groups)
        for k, (mode, colour) in enumerate(zip(_MODES, (OURS, PAPER, "#9AA3AD"), strict=True)):
            counts = [_shares(answers)[k] for _, answers in groups]
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
        errors = [data["start"]["error"], *(one["error"] for one in data["learning"])]
        middle.plot(range(len(errors)), errors, "o-", color=OURS, ms=4)
        middle.axhline(5e-4, color="black", lw=0.9, ls="--")
        middle.annotate("target 5e-04", (0, 5e-4), (0, 3), textcoords="offset points", fontsize=8.5)
        middle.set(yscale="log", xlabel="objects learnt after the cube", ylabel="mean-square error")
        middle.set_ylim(min(errors) / 2, 2e-3)
        seconds = [one["seconds"] for one in data["learning"]]
        right.bar(range(1, len(seconds) + 1), seconds, color=THIRD)
        right.set(xlabel="object", ylabel="time to learn it [s]")
        right.grid(axis="x", visible=False)


LEARNING = Experiment(
    name="learning", title="Learning: twenty objects, one after the other",
    version=1, cost=30, measure=_measure, present=_present,
)  # fmt: skip
