"""Figs. 17-18: the report on odd cases, which are preshapes that the hand cannot take (§4.7)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ..hiis.analyser import Aim
from ..hiis.decision import Decision, Status, Transition
from ..objects.library import names
from ..physics.measures import wilson
from ..planning.answers import Answer
from ..planning.hand_simulation import HandStatus, execute
from ..planning.plan import Plan
from ..report import Cell, Figure, Table
from ..tasks import all_named_tasks, parse_task
from . import printed
from .experiment import Experiment, Section
from .odd_cases import REFUSED, SCALES, is_odd, measure, with_preshape
from .plots import FOURTH, OURS, PAPER, QUIET, THIRD, PlotCanvas
from .setup import Data, Setup

_RED, _YELLOW = "#D55E00", "#F0E442"
CAUSES = {
    HandStatus.OUT_OF_REACH.name: ("out of reach", _RED),
    HandStatus.JOINT_LIMIT.name: ("joint limit", PAPER),
    HandStatus.COLLISION.name: ("link in the object", FOURTH),
    HandStatus.SELF_COLLISION.name: ("links in each other", _YELLOW),
}
"""Description and colour of each cause of an odd case."""

_OUTCOMES = {
    REFUSED: "refused: an extent above 4U (not drawn by the sampler)",
    Status.NO_GRASP.value: "no virtual grasp on any plane",
    Status.DEADLOCK.value: "deadlock: the best grasp does not match the task",
    Status.CORRECTION.value: "mode 2: task correction asked for",
    Status.ANSWER.value: "preshape estimated (modes 0, 1, 3)",
}

_SIZE, _QUICK_SIZE = (1400, 900), (840, 540)
"""Sizes of the pictures of odd cases: in the full form, in the quick form [pixels]."""
_MAX_LISTED = 15

LIMIT = printed.ODD_RATE
"""The paper's rate of odd cases, which ours should not exceed."""


def _interval(odd: int, whole: int) -> tuple[float, float]:
    """95 % interval of a share; 0..1 if there are no cases."""
    return wilson(odd, whole) or (0.0, 1.0)


def rate_text(odd: int, whole: int) -> str:
    """Share of odd cases with its 95 % interval."""
    if not whole:
        return "none estimated"
    low, high = _interval(odd, whole)
    return f"{100 * odd / whole:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"


def _present(data: Data) -> Section:
    rows, found = data["rows"], with_preshape(data)
    odd = [row for row in found if is_odd(row)]
    outcomes = Counter(row["outcome"] for row in rows)
    causes = Counter(row["hand"] for row in odd)
    counts: list[tuple[Cell, ...]] = [(text, outcomes[key]) for key, text in _OUTCOMES.items()]
    counts += [
        ("of these: reached by the hand", len(found) - len(odd)),
        ("of these: odd cases, fingers retracted", len(odd)),
        *((f"odd cases: {text}", causes[key]) for key, (text, _) in CAUSES.items()),
        ("rate of odd cases (95 % interval, Wilson), preshape", rate_text(len(odd), len(found))),
        ("rate of odd cases, paper", f"about {100 * LIMIT:.0f} % of {printed.ODD_EXPERIMENTS}"),
    ]
    headline = (
        f"The hand cannot take {len(odd)} of {len(found)} estimated preshapes: "
        f"{rate_text(len(odd), len(found))}; the paper reports about {100 * LIMIT:.0f} %."
    )
    runs, each, seed = data["sessions"], data["each"], data["seed"]
    return Section(
        headline=headline,
        text=(
            f"{len(rows)} experiments in {runs} runs of {each}, seed {seed}. {headline}",
            f"Run k (0 … {runs - 1}) draws from NumPy's default generator with the seed ({seed}, k). It "
            "begins with a system that knows only the cube, whose network is trained from the weights of "
            "the run's seed. Each experiment draws, independently and uniformly, one of the library's "
            f"{len(names())} objects, a scale of {SCALES[0]:g}, {SCALES[1]:g} … {SCALES[-1]:g} with which "
            f"no extent exceeds 4U, one of the {len(all_named_tasks())} named tasks (families along or "
            "about six signed axes), and a seed of the hand simulation. The experiments of a run follow "
            "each other on one system, which answers by any mode. What mode 3 learns stays until the run "
            "ends, and a deadlock is reset.",
            "An odd case is an estimated preshape whose contacts the hand's kinematics cannot reach; the "
            "fingers retract, and the cause is recorded. The paper checks fingertips and joint limits. Here "
            "every other link must also be clear of the object and of the hand. Refused objects, objects "
            "without a virtual grasp, deadlocks and requests for task correction give no preshape and are "
            "counted separately.",
        ),
        tables=(
            Table(caption="Results of the experiments.", columns=("", "experiments"), rows=tuple(counts)),
            _breakdown(found, "mode", lambda row: f"mode {row['mode']}"),
            _breakdown(found, "virtual fingers", lambda row: f"{row['fingers']} fingers"),
            _breakdown(found, "scale", lambda row: f"{row['scale']:g}"),
            _listed(odd),
        ),
        figures=(
            Figure(
                file="figures/odd_cases.png",
                caption="Left: results of the experiments. Right: causes of the odd cases, and their rate "
                "beside the paper's.",
                draw=partial(_draw, data),
            ),
            Figure(
                file="figures/odd_cases_by_object.png",
                caption="Estimated preshapes of each object, and those that were retracted, by cause.",
                draw=partial(_draw_objects, data),
            ),
            *_pictures(odd, _SIZE if len(rows) >= printed.ODD_EXPERIMENTS else _QUICK_SIZE),
        ),
        remarks=tuple(_disagreements(data)),
    )


def _breakdown(found: list[Data], noun: str, key: Callable[[Data], str]) -> Table:
    groups: dict[str, list[Data]] = {}
    for row in found:
        groups.setdefault(key(row), []).append(row)
    return Table(
        caption=f"Odd cases by {noun}.",
        columns=(noun, "preshapes", "odd cases", "rate (95 % interval)"),
        rows=tuple(
            (name, len(group), odd := sum(map(is_odd, group)), rate_text(odd, len(group)))
            for name, group in sorted(groups.items())
        ),
    )


def _listed(odd: list[Data]) -> Table:
    more = ""
    if len(odd) > _MAX_LISTED:
        more = f" These are the first {_MAX_LISTED} of {len(odd)}; the JSON file has all."
    return Table(
        caption=f"Odd cases one by one.{more}",
        columns=("number", "object", "scale", "task", "mode", "plane", "fingers", "why the hand retracts"),
        rows=tuple(
            (
                row["number"], row["object"], f"{row['scale']:g}", row["task"], row["mode"],
                f"{row['plane']}{' flipped' if row['flip'] else ''}", row["fingers"],
                f"{CAUSES[row['hand']][0]}: {row['hand_reason']}",
            )
            for row in odd[:_MAX_LISTED]
        ),
    )  # fmt: skip


def _disagreements(data: Data) -> Iterator[str]:
    rows, found = data["rows"], with_preshape(data)
    odd = sum(map(is_odd, found))
    if not found:
        yield "No preshape was estimated, so there is no rate to compare."
        return
    low, high = _interval(odd, len(found))
    if low > LIMIT:
        yield f"The rate, {rate_text(odd, len(found))}, is above the paper's {100 * LIMIT:.0f} %."
    elif high < LIMIT:
        yield (
            f"The rate, {rate_text(odd, len(found))}, is below the paper's {100 * LIMIT:.0f} %. Objects, "
            "hand and inverse kinematics differ, and several postures, finger assignments and tilts of the "
            "palm are tried here before the fingers retract."
        )
    if len(found) != len(rows):
        yield (
            f"The paper's rate is over all its experiments. {len(rows) - len(found)} of ours end without a "
            f"preshape; over all {len(rows)} the rate is {100 * odd / len(rows):.1f} %."
        )
    if len(rows) != printed.ODD_EXPERIMENTS:
        yield (
            f"These are {len(rows)} experiments, the paper's are {printed.ODD_EXPERIMENTS}: this is the "
            "quick form of the report."
        )
    yield "The paper does not say how its 500 experiments were drawn or what the causes were."


# Figures.


def _draw(data: Data, path: Path) -> None:
    found = with_preshape(data)
    odd = [row for row in found if is_odd(row)]
    outcomes = Counter(row["outcome"] for row in data["rows"])
    causes = Counter(row["hand"] for row in odd)
    share = 100 * len(odd) / max(len(found), 1)
    low, high = (100 * x for x in _interval(len(odd), len(found)))
    limit = 100 * LIMIT
    with PlotCanvas(path, size=(10.5, 3.9), columns=3, width_ratios=(1.5, 1.1, 0.8)) as (left, middle, right):
        _horizontal_bars(
            left,
            [
                ("reached", len(found) - len(odd), OURS),
                ("odd case: retracted", len(odd), _RED),
                ("task correction (mode 2)", outcomes[Status.CORRECTION.value], THIRD),
                ("deadlock", outcomes[Status.DEADLOCK.value], QUIET),
                ("no virtual grasp", outcomes[Status.NO_GRASP.value], QUIET),
                ("refused", outcomes[REFUSED], QUIET),
            ],
        )
        left.set(xlabel="experiments", title="Outcome")
        _horizontal_bars(middle, [(text, causes[key], colour) for key, (text, colour) in CAUSES.items()])
        middle.set(xlabel="odd cases", title="Cause")
        right.bar([0, 1], [limit, share], 0.6, color=[PAPER, OURS])
        right.errorbar([1], [share], [[share - low], [high - share]], color="black", capsize=5, lw=1.3)
        right.set_xticks([0, 1], ["paper\n(about)", "preshape\n(95 %)"])
        for x, text, top in ((0, f"{limit:.0f} %", limit), (1, f"{share:.1f} %", high)):
            right.annotate(text, (x, top), (0, 3), textcoords="offset points", ha="center")
        right.set(
            ylabel="odd cases [% of preshapes]",
            title="Rate",
            ylim=(0, max(high, limit) * 1.2),
            xlim=(-0.6, 1.6),
        )
        right.grid(axis="x", visible=False)


def _horizontal_bars(axes: Any, bars: list[tuple[str, int, str]]) -> None:
    at = list(range(len(bars)))[::-1]
    axes.barh(at, [count for _, count, _ in bars], color=[colour for *_, colour in bars])
    axes.set_yticks(at, [name for name, *_ in bars])
    for y, (_, count, _) in zip(at, bars, strict=True):
        axes.annotate(str(count), (count, y), (3, 0), textcoords="offset points", va="center")
    axes.set_xlim(0, max(1, *(count for _, count, _ in bars)) * 1.18)
    axes.grid(axis="y", visible=False)


def _draw_objects(data: Data, path: Path) -> None:
    found = with_preshape(data)
    order = sorted({row["object"] for row in found}, key=names().index)
    total = Counter(row["object"] for row in found)
    with PlotCanvas(path, size=(11.0, 4.2)) as axes:
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


def _pictures(odd: list[Data], size: tuple[int, int]) -> tuple[Figure, ...]:
    """Two odd cases: the first of the most common cause, and the first of the next one on another object."""
    chosen: list[Data] = []
    for cause, _ in Counter(row["hand"] for row in odd).most_common():
        taken = {row["object"] for row in chosen}
        chosen += [row for row in odd if row["hand"] == cause and row["object"] not in taken][:1]
    return tuple(
        Figure(
            file=f"figures/odd_case_{letter}.png",
            caption=f"An odd case (number {row['number']}): {row['object']} at scale {row['scale']:g}, task "
            f"{row['task']}. The hand has retracted: {row['hand_reason']}.",
            draw=partial(_draw_case, row, size),
        )
        for letter, row in zip("ab", chosen, strict=False)
    )


def _draw_case(row: Data, size: tuple[int, int], path: Path) -> None:
    """Simulate an odd case again, and draw object, contacts and retracted hand."""
    from ..pictures import plan_scene
    from ..planning.document import plan_to_json
    from ..planning.output import ray_origins
    from ..viewer.plan_picture import plan_picture
    from ..viewer.words import answers_of

    setup = Setup()
    ready = setup.prepare(setup.system(), row["object"], parse_task(row["task"]), scale=row["scale"])
    task = ready.task
    aim = Aim(planes=[row["plane"]], values=[row["value"]], fingers=[row["fingers"]], flips=[row["flip"]])
    grasp = ready.element.explore(task.q, aim).grasp()
    hand = execute(ready.hand, ready.mesh, grasp, seed=row["hand_seed"])
    steps = tuple(
        Transition(mode=mode, outcome=outcome, reason=reason) for mode, outcome, reason in row["steps"]
    )
    decision = Decision(
        status=Status.ANSWER, reason=row["reason"], mode=row["mode"], task=task, grasp=grasp, best=grasp,
        alternatives=(), offers=(), transitions=steps, estimate=None,
    )  # fmt: skip
    plan = Plan(
        request=ready.request, mesh=ready.mesh, hand=ready.hand, mass=ready.mass, decision=decision,
        answer=Answer(grasp=grasp, hand_result=hand), alternatives=(), best=None, seconds=ready.seconds,
    )  # fmt: skip
    document = plan_to_json(plan)
    scene = plan_scene(document, ready.mesh, ready.hand, answers_of(document)[0], rays=ray_origins(plan)[0])
    scene = replace(
        scene,
        status=f"odd case, retracted: {CAUSES[row['hand']][0]}",
        reasons=(f"{hand.reason[:1].upper()}{hand.reason[1:]}.", *scene.reasons),
    )
    plan_picture(scene, path, title=f"{ready.mesh.name}, odd case {row['number']}", size=size)


ODD_CASES = Experiment(
    name="odd_cases", title="Figs. 17 and 18: odd cases",
    version=2, cost=240, measure=measure, present=_present,
)  # fmt: skip
