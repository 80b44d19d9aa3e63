"""Figs. 17-18 in the report: counts, causes, the rate, and two odd cases as pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ..hands.load import load_hand
from ..hiis.analyser import Aim
from ..hiis.decision import Decision, Settings, Status, Transition
from ..hiis.virtual_grasp import RayAnalyser
from ..objects.library import load_library_object, names
from ..physics.measures import wilson
from ..planner import RAY_HAND, Plan, execute, layout_of
from ..planning.hand_simulation import HandStatus
from ..tasks import all_named_tasks, parse_task
from . import odd_cases, printed
from .odd_cases import SCALES, is_odd, preshapes
from .plots import FOURTH, OURS, PAPER, QUIET, THIRD, Canvas
from .values import Cell, Data, Experiment, Picture, Section, Table

CAUSES = {
    HandStatus.OUT_OF_REACH.name: ("out of reach", "#D55E00"),
    HandStatus.JOINT_LIMIT.name: ("joint limit", PAPER),
    HandStatus.COLLISION.name: ("link in the object", FOURTH),
    HandStatus.SELF_COLLISION.name: ("links in each other", "#F0E442"),
}

_OUTCOMES = {
    odd_cases.REFUSED: "refused: an extent over 4U (the sampler draws none)",
    Status.NO_GRASP.value: "no virtual grasp on any plane",
    Status.DEADLOCK.value: "deadlock: the best grasp does not match the task",
    Status.CORRECTION.value: "mode 2: task correction asked for",
    Status.ANSWER.value: "preshape estimated (modes 0, 1, 3)",
}

_SIZE, _QUICK_SIZE = (1400, 900), (840, 540)
"""Of the pictures of odd cases [pixels]."""

LIMIT = printed.ODD_RATE
"""The paper's rate, which ours must not exceed."""


def _interval(odd: int, whole: int) -> tuple[float, float]:
    """95 % interval of the share; of nothing it is all that can be."""
    return wilson(odd, whole) or (0.0, 1.0)


def _rate(odd: int, whole: int) -> str:
    if not whole:
        return "none estimated"
    low, high = _interval(odd, whole)
    return f"{100 * odd / whole:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"


def _present(data: Data) -> Section:
    rows, found = data["rows"], preshapes(data)
    odd = [row for row in found if is_odd(row)]
    outcomes = Counter(row["outcome"] for row in rows)
    causes = Counter(row["hand"] for row in odd)
    share = len(odd) / len(found) if found else 0.0
    counts: list[tuple[Cell, ...]] = [(text, outcomes[key]) for key, text in _OUTCOMES.items()]
    counts += [
        ("of these: reached by the hand", len(found) - len(odd)),
        ("of these: odd cases, fingers retracted", len(odd)),
    ]
    counts += [(f"odd cases: {text}", causes[key]) for key, (text, _) in CAUSES.items()]
    counts.append(("rate of odd cases (95 % interval, Wilson), preshape", _rate(len(odd), len(found))))
    counts.append(
        ("rate of odd cases, paper", f"around {100 * LIMIT:.0f} % over all {printed.ODD_EXPERIMENTS}")
    )
    headline = (
        f"{len(odd)} of {len(found)} estimated preshapes cannot be taken by the hand: "
        f"{_rate(len(odd), len(found))}; the paper says around {100 * LIMIT:.0f} %."
    )
    sessions, each, seed = data["sessions"], data["each"], data["seed"]
    return Section(
        headline=headline,
        text=(
            f"{len(rows)} experiments in {sessions} sessions of {each}, seed {seed}. {headline}",
            f"The sampler: session k (0 … {sessions - 1}) draws from NumPy's default generator with the "
            f"seed ({seed}, k). It begins with a system "
            "that knows the cube only, its network trained from fresh weights of that session's seed. "
            "Each experiment draws, independently and "
            f"uniformly, one of the library's {len(names())} objects, a scale among those of "
            f"{SCALES[0]:g}, {SCALES[1]:g} … {SCALES[-1]:g} with which no extent "
            f"is over 4U, one of the {len(all_named_tasks())} named tasks (families along or about six "
            "signed axes), and a seed of the hand simulation. "
            "The experiments of a session are run one after the other, by whatever mode; what mode 3 "
            "learns stays until the session ends, and a deadlock is reset.",
            "An odd case is an estimated preshape whose contacts the hand's kinematics cannot take: the "
            "fingers retract and the cause is noted. "
            "The paper checks fingertips and joint limits; here every other link must be clear of the "
            "object and of the hand too. Objects that are "
            "refused or have no virtual grasp, deadlocks and requests for task correction estimate no "
            "preshape and are counted apart.",
        ),
        tables=(
            Table(caption="What came of the experiments.", columns=("", "experiments"), rows=tuple(counts)),
            _breakdown(found, "mode", lambda row: f"mode {row['mode']}"),
            _breakdown(found, "virtual fingers", lambda row: f"{row['fingers']} fingers"),
            _breakdown(found, "scale", lambda row: f"{row['scale']:g}"),
            _listed(odd),
        ),
        pictures=(
            Picture(
                name="odd_cases",
                caption="Left: what came of the experiments. Right: causes of the odd cases, and the "
                "rate beside the paper's.",
                draw=lambda path: _draw(data, path),
            ),
            Picture(
                name="odd_cases_by_object",
                caption="Estimated preshapes of each object, and how many of them were retracted, by cause.",
                draw=lambda path: _draw_objects(data, path),
            ),
            *_shown(odd, _SIZE if len(rows) >= printed.ODD_EXPERIMENTS else _QUICK_SIZE),
        ),
        disagreements=tuple(_disagreements(data, share)),
    )


def _breakdown(found: list[Data], noun: str, key: Callable[[Data], str]) -> Table:
    groups: dict[str, list[Data]] = {}
    for row in found:
        groups.setdefault(key(row), []).append(row)
    return Table(
        caption=f"Odd cases by {noun}.",
        columns=(noun, "preshapes", "odd cases", "rate (95 % interval)"),
        rows=tuple(
            (name, len(group), odd := sum(map(is_odd, group)), _rate(odd, len(group)))
            for name, group in sorted(groups.items())
        ),
    )


def _listed(odd: list[Data]) -> Table:
    shown = odd[:15]
    more = (
        ""
        if len(odd) <= len(shown)
        else f" The first {len(shown)} of {len(odd)}; the others stand in the JSON file."
    )
    return Table(
        caption=f"Odd cases one by one.{more}",
        columns=("number", "object", "scale", "task", "mode", "plane", "fingers", "why the hand retracts"),
        rows=tuple(
            (
                row["number"], row["object"], f"{row['scale']:g}", row["task"], row["mode"],
                f"{row['plane']}{' flipped' if row['flip'] else ''}", row["fingers"],
                f"{CAUSES[row['hand']][0]}: {row['hand_reason']}",
            )
            for row in shown
        ),
    )  # fmt: skip


def _disagreements(data: Data, share: float) -> list[str]:
    rows, found = data["rows"], preshapes(data)
    odd = sum(map(is_odd, found))
    if not found:
        return ["No preshape was estimated, so there is no rate to compare."]
    low, high = _interval(odd, len(found))
    out = []
    if low > LIMIT:
        out.append(f"The rate, {_rate(odd, len(found))}, is above the paper's 15 %.")
    elif high < LIMIT:
        out.append(
            f"The rate, {_rate(odd, len(found))}, is below the paper's 15 %: objects, hand and inverse "
            "kinematics are other ones, "
            "and here several postures, finger assignments and tilts of the palm are tried before the "
            "fingers retract."
        )
    if len(found) != len(rows):
        out.append(
            f"The paper's rate is over all its experiments; {len(rows) - len(found)} of ours end "
            f"without a preshape, and over all {len(rows)} the rate is {100 * odd / len(rows):.1f} %."
        )
    if len(rows) != printed.ODD_EXPERIMENTS:
        out.append(
            f"These are {len(rows)} experiments, the paper's {printed.ODD_EXPERIMENTS}: the report is "
            "of the quick form."
        )
    out.append("The paper says neither how its 500 experiments were drawn nor what the causes were.")
    return out


# Pictures.


def _draw(data: Data, path: Path) -> None:
    found = preshapes(data)
    odd = [row for row in found if is_odd(row)]
    outcomes = Counter(row["outcome"] for row in data["rows"])
    with Canvas(path, size=(10.5, 3.9), columns=3, width_ratios=(1.5, 1.1, 0.8)) as (left, middle, right):
        bars = [
            ("reached", len(found) - len(odd), OURS),
            ("odd case: retracted", len(odd), "#D55E00"),
            ("task correction (mode 2)", outcomes[Status.CORRECTION.value], THIRD),
            ("deadlock", outcomes[Status.DEADLOCK.value], QUIET),
            ("no virtual grasp", outcomes[Status.NO_GRASP.value], QUIET),
            ("refused", outcomes[odd_cases.REFUSED], QUIET),
        ]
        _horizontal(left, bars)
        left.set(xlabel="experiments", title="Outcome")
        counts = Counter(row["hand"] for row in odd)
        _horizontal(middle, [(text, counts[key], colour) for key, (text, colour) in CAUSES.items()])
        middle.set(xlabel="odd cases", title="Cause")
        share = 100 * len(odd) / max(len(found), 1)
        low, high = (100 * x for x in _interval(len(odd), len(found)))
        right.bar([0, 1], [100 * LIMIT, share], 0.6, color=[PAPER, OURS])
        right.errorbar([1], [share], [[share - low], [high - share]], color="black", capsize=5, lw=1.3)
        right.set_xticks([0, 1], ["paper\n(around)", "preshape\n(95 %)"])
        for x, y, top in ((0, 100 * LIMIT, 100 * LIMIT), (1, share, high)):
            right.annotate(
                f"{y:.1f} %" if x else f"{y:.0f} %", (x, top), (0, 3), textcoords="offset points", ha="center"
            )
        right.set(
            ylabel="odd cases [% of preshapes]",
            title="Rate",
            ylim=(0, max(high, 100 * LIMIT) * 1.2),
            xlim=(-0.6, 1.6),
        )
        right.grid(axis="x", visible=False)


def _horizontal(drawn: Any, bars: list[tuple[str, int, str]]) -> None:
    at = list(range(len(bars)))[::-1]
    drawn.barh(at, [count for _, count, _ in bars], color=[colour for *_, colour in bars])
    drawn.set_yticks(at, [name for name, *_ in bars])
    for y, (_, count, _) in zip(at, bars, strict=True):
        drawn.annotate(str(count), (count, y), (3, 0), textcoords="offset points", va="center")
    drawn.set_xlim(0, max(1, *(count for _, count, _ in bars)) * 1.18)
    drawn.grid(axis="y", visible=False)


def _draw_objects(data: Data, path: Path) -> None:
    found = preshapes(data)
    order = sorted({row["object"] for row in found}, key=names().index)
    total = Counter(row["object"] for row in found)
    with Canvas(path, size=(11.0, 4.2)) as axes:
        at = range(len(order))
        axes.bar(at, [total[name] for name in order], 0.8, color="#DCE3EA", label="preshapes")
        bottom = [0] * len(order)
        for key, (text, colour) in CAUSES.items():
            counts = Counter(row["object"] for row in found if row["hand"] == key)
            heights = [counts[name] for name in order]
            axes.bar(
                at,
                heights,
                0.8,
                bottom=bottom,
                color=colour,
                label=f"retracted: {text}" if any(heights) else None,
                edgecolor="black",
                lw=0.3,
            )
            bottom = [a + b for a, b in zip(bottom, heights, strict=True)]
        axes.set_xticks(
            at, [name.replace("_", " ") for name in order], rotation=60, ha="right", rotation_mode="anchor"
        )
        axes.set(ylabel="experiments", xlim=(-0.7, len(order) - 0.3))
        axes.yaxis.get_major_locator().set_params(integer=True)
        axes.grid(axis="x", visible=False)
        axes.legend(loc="upper center", ncols=5, fontsize=9, bbox_to_anchor=(0.5, 1.14))


def _shown(odd: list[Data], size: tuple[int, int]) -> tuple[Picture, ...]:
    """Two odd cases: the first of the commonest cause, and the first of the next one on another object."""
    chosen: list[Data] = []
    for cause, _ in Counter(row["hand"] for row in odd).most_common():
        taken = {row["object"] for row in chosen}
        chosen += [row for row in odd if row["hand"] == cause and row["object"] not in taken][:1]
    return tuple(
        Picture(
            name=f"odd_case_{letter}",
            caption=f"An odd case (number {row['number']}): {row['object']} at scale {row['scale']:g}, "
            f"task {row['task']}; the hand has retracted, because {row['hand_reason']}.",
            draw=partial(_draw_case, row, size),
        )
        for letter, row in zip("ab", chosen, strict=False)
    )


def _draw_case(row: Data, size: tuple[int, int], path: Path) -> None:
    """The object, the contacts that were asked for, and the retracted hand; simulated again."""
    from ..pictures import plan_scene
    from ..viewer.plan_picture import plan_picture

    hand = load_hand(RAY_HAND)
    mesh = load_library_object(row["object"], scale=row["scale"])
    task = parse_task(row["task"])
    element = RayAnalyser(mesh, layout_of(hand))
    aim = Aim(planes=[row["plane"]], values=[row["value"]], fingers=[row["fingers"]], flips=[row["flip"]])
    grasp = element.explore(task.q, aim).grasp()
    answer = execute(hand, mesh, grasp, seed=row["hand_seed"])
    steps = tuple(
        Transition(mode=mode, outcome=outcome, reason=reason) for mode, outcome, reason in row["steps"]
    )
    decision = Decision(
        status=Status.ANSWER, reason=row["reason"], mode=row["mode"], task=task, grasp=grasp, best=grasp,
        alternatives=(), offers=(), transitions=steps, estimate=None,
    )  # fmt: skip
    plan = Plan(
        mesh=mesh, source=mesh.name, hand=hand, settings=Settings(), decision=decision, answer=answer,
        alternatives=(), seconds={},
    )  # fmt: skip
    why = answer.hand_result.reason
    scene = replace(
        plan_scene(plan),
        status=f"odd case, retracted: {CAUSES[row['hand']][0]}",
        reasons=(
            f"{why[:1].upper()}{why[1:]}.",
            *(f"Mode {t.mode}, {t.outcome}: {t.reason}." for t in steps),
        ),
    )
    plan_picture(scene, path, title=f"{mesh.name}, odd case {row['number']}", size=size)


ODD_CASES = Experiment(
    name="odd_cases", title="Figs. 17 and 18: odd cases",
    version=1, cost=240, measure=odd_cases.measure, present=_present,
)  # fmt: skip
