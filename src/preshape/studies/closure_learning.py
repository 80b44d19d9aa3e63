"""``preshape bench learning``: does the memory of the closure analyser save work?

The study has these steps:

1. Stream: plan pairs of object and task one after the other and learn each. Record the share answered at
   mode 0, the number of candidates for each answer, and its quality.
2. Repetition: plan every answered pair again, to see whether any was lost.
3. Held-out objects, which were never in the stream: plan each pair with a fresh memory, which explores all
   planes; with the memory of the stream; and again with the memory of the stream, but with the critic's
   threshold at the margin that exploring reached. The last shows how many candidates the memory needs for the
   same margin.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ..closure.analyser import ClosureAnalyser
from ..closure.finish import margin_of, quality
from ..closure.settings import ClosureSettings
from ..files import write_json, write_whole
from ..hiis.critic import Thresholds
from ..hiis.decision import Settings, Status
from ..memory import Memory
from ..objects.library import load_library_object, names
from ..planning.request import PlanRequest
from ..planning.rules import NONE
from ..planning.session import Session
from ..report import Cell, Table
from ..tasks import Task, family_names, parse_task
from ..types import FIELD_MASS, Array, value
from .plots import OURS, QUIET, THIRD, PlotCanvas

WINDOW = 20
"""Number of consecutive pairs of the stream over which shares are computed."""
LARGEST = 0.16
"""Largest extent of the objects in the study [m]."""
HELD_OUT = 0.2
"""Share of the objects that are held out of the stream."""
SAME = 0.95
"""A margin of at least this share of another counts as the same margin."""

Pair: TypeAlias = tuple[str, float, Task]
"""Library name and scale of an object, and a task."""


@value
class PairResult:
    """The answer for one object and task.

    Attributes:
        name: Name and scale of the object.
        task: Label of the task.
        mode: Last mode of the controller, 0..3.
        answered: Whether there was an answer.
        quality: Quality of the answer, 0..6; 0 without an answer.
        tried: Number of candidates that were closed for the pair.
    """

    name: str
    task: str
    mode: int
    answered: bool
    quality: float
    tried: int


@value
class LearningStudy:
    """Results of the study.

    Attributes:
        stream: The pairs of the stream, in order.
        repeated: The answered pairs of the stream, planned again at the end.
        fresh: Pairs with held-out objects, each planned with a memory that knows only the cube; explores all
            planes.
        held_out: The same pairs, planned with the memory of the stream.
        same_margin: The same pairs and memory, with the margin that exploring reached as threshold.
    """

    stream: tuple[PairResult, ...]
    repeated: tuple[PairResult, ...]
    fresh: tuple[PairResult, ...]
    held_out: tuple[PairResult, ...]
    same_margin: tuple[PairResult, ...]

    def share(self, first: int, last: int) -> float:
        """Share of the pairs ``first`` to ``last`` of the stream that mode 0 answered."""
        part = self.stream[first:last]
        return _at_mode_0(part) / max(1, len(part))

    def ratios(self) -> Array:
        """Candidates with the stream's memory divided by those with a fresh one, for the same margin.

        There is one ratio for each pair that exploring answers. If the memory does not reach the margin, the
        candidates of exploring are added, unless mode 3 has already explored all planes.
        """
        pairs = [(w, f) for w, f in zip(self.same_margin, self.fresh, strict=True) if f.answered]
        return np.array(
            [(w.tried + (0 if w.answered or w.mode == 3 else f.tried)) / f.tried for w, f in pairs]
        )

    def figures(self) -> dict[str, Any]:
        """The figures of the report as plain JSON values."""
        n, ratios = len(self.stream), self.ratios()
        window = min(WINDOW, n)
        return {
            "met": n,
            "answered": _answered(self.stream),
            "mode_0_first_window": self.share(0, window),
            "mode_0_last_window": self.share(n - window, n),
            "learnt": sum(one.answered and one.mode == 3 for one in self.stream),
            "asked_again": len(self.repeated),
            "still_answered": _answered(self.repeated),
            "still_mode_0": _at_mode_0(self.repeated),
            "held_out": len(self.held_out),
            "held_out_answered": _answered(self.held_out),
            "held_out_mode_0": _at_mode_0(self.held_out),
            "fresh_answered": _answered(self.fresh),
            "candidates_as_usual": _median([one.tried for one in self.held_out]),
            "candidates_fresh": _median([one.tried for one in self.fresh]),
            "same_margin_ratio_median": _median(ratios),
            "same_margin_within_a_tenth": int((ratios <= 0.1).sum()),
        }


def _answered(results: Sequence[PairResult]) -> int:
    return sum(one.answered for one in results)


def _at_mode_0(results: Sequence[PairResult]) -> int:
    return sum(one.answered and one.mode == 0 for one in results)


def _median(numbers: Sequence[float] | Array) -> float | None:
    return float(np.median(numbers)) if len(numbers) else None


def study(
    *,
    hand: str = "shadow",
    length: int = 100,
    held_out: int = 20,
    seed: int = 0,
    closure: ClosureSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> LearningStudy:
    """Run the study.

    Args:
        hand: Name of the hand.
        length: Number of pairs in the stream.
        held_out: Number of pairs with held-out objects.
        seed: Seed of the pairs and of the planner.
        closure: Size of the search.
        progress: Called after each planned pair with the number of finished pairs and of all pairs.
    """
    rng = np.random.default_rng(seed)
    usable = [n for n in names() if n != "cube" and load_library_object(n).extents.max() <= LARGEST]
    order = [usable[int(i)] for i in rng.permutation(len(usable))]
    kept_out = max(1, round(HELD_OUT * len(order)))
    pairs, strangers = _pairs(rng, order[kept_out:], length), _pairs(rng, order[:kept_out], held_out)
    # Pairs without an answer are not planned again, but count as finished.
    done, total = 0, 2 * length + 3 * held_out

    def ask(
        memory: Memory,
        pair: Pair,
        *,
        learn: bool = False,
        explore: bool = False,
        threshold: float = Thresholds().estimation,
    ) -> PairResult:
        nonlocal done
        name, scale, task = pair
        request = PlanRequest(
            source=name,
            task=task,
            hand=hand,
            analyser="closure",
            scale=scale,
            mass=FIELD_MASS,
            table=None,
            rules=NONE,
            settings=Settings(seed=seed, thresholds=Thresholds(estimation=threshold)),
            search=closure or ClosureSettings(finished=4),
        )
        ready = Session(memory).prepare(request)
        controller, element = ready.controller, ready.element
        assert isinstance(element, ClosureAnalyser)
        decision = (
            controller.teach(element, task) if explore else controller.run(element, task, may_learn=learn)
        )
        done += 1
        if progress is not None:
            progress(done, total)
        return PairResult(
            name=f"{name}@{scale:g}",
            task=task.label,
            mode=decision.mode,
            answered=decision.status is Status.ANSWER,
            quality=decision.grasp.judged if decision.grasp is not None else 0.0,
            tried=element.tried,
        )

    with Memory.open(":memory:") as memory:
        stream = [ask(memory, pair, learn=True) for pair in pairs]
        answered = [pair for pair, result in zip(pairs, stream, strict=True) if result.answered]
        done += length - len(answered)
        repeated = [ask(memory, pair) for pair in answered]
        fresh = []
        for pair in strangers:
            with Memory.open(":memory:") as empty:
                fresh.append(ask(empty, pair, explore=True))
        known = [ask(memory, pair) for pair in strangers]
        same_margin = [
            ask(memory, pair, threshold=_same_margin_quality(result.quality))
            if result.answered
            else ask(memory, pair)
            for pair, result in zip(strangers, fresh, strict=True)
        ]
    return LearningStudy(
        stream=tuple(stream),
        repeated=tuple(repeated),
        fresh=tuple(fresh),
        held_out=tuple(known),
        same_margin=tuple(same_margin),
    )


def _pairs(rng: np.random.Generator, objects: Sequence[str], count: int) -> list[Pair]:
    """Objects at random sizes with random tasks; all objects occur about equally often."""
    order = np.concatenate([rng.permutation(len(objects)) for _ in range(count // len(objects) + 1)])[:count]
    families = family_names()
    return [
        (
            objects[int(i)],
            float(np.round(rng.uniform(0.9, 1.1), 3)),
            parse_task(families[int(rng.integers(len(families)))]),
        )
        for i in order
    ]


def _same_margin_quality(reached: float) -> float:
    """The quality whose margin is :data:`SAME` times the margin of quality ``reached``."""
    return quality(SAME * margin_of(reached))


def table(found: LearningStudy) -> Table:
    """The figures as a table."""
    f = found.figures()

    def part(count: str, whole: str) -> str:
        return f"{f[count]} of {f[whole]}"

    def number(name: str, form: str) -> str | None:
        return None if f[name] is None else format(f[name], form)

    rows: tuple[tuple[Cell, ...], ...] = (
        ("stream: pairs answered", part("answered", "met")),
        ("stream: at mode 0 in the first window", f"{f['mode_0_first_window']:.0%}"),
        ("stream: at mode 0 in the last window", f"{f['mode_0_last_window']:.0%}"),
        ("stream: learnt in mode 3", part("learnt", "answered")),
        ("asked again: still answered", part("still_answered", "asked_again")),
        ("asked again: at mode 0", part("still_mode_0", "asked_again")),
        ("objects never met: pairs answered", part("held_out_answered", "held_out")),
        ("objects never met: at mode 0", part("held_out_mode_0", "held_out_answered")),
        ("objects never met: answered by a fresh memory that explores", part("fresh_answered", "held_out")),
        ("candidates for one answer, median", number("candidates_as_usual", ".0f")),
        ("candidates for one answer of a fresh memory, median", number("candidates_fresh", ".0f")),
        (
            "candidates for the margin that exploring reaches, ratio to exploring, median",
            number("same_margin_ratio_median", ".3f"),
        ),
        ("ratio of a tenth or less", part("same_margin_within_a_tenth", "fresh_answered")),
    )
    return Table(
        caption=f"The memory over {f['met']} pairs of object and task; a window has {min(WINDOW, f['met'])} "
        "pairs",
        columns=("what", "measured"),
        rows=rows,
    )


def write_learning_report(found: LearningStudy, out: Path) -> list[Path]:
    """Write report.json, with the figures and all planned pairs, and the plot; return the files."""
    rows = {
        part: [asdict(one) for one in getattr(found, part)]
        for part in ("stream", "repeated", "fresh", "held_out", "same_margin")
    }
    files = [out / "report.json", out / "learning.png"]
    write_json(files[0], {"figures": found.figures(), **rows})
    write_whole(files[1], lambda path: _draw(found, path))
    return files


def _draw(found: LearningStudy, path: Path) -> None:
    places = range(1, len(found.stream) + 1)
    with PlotCanvas(path, size=(9.0, 3.6), columns=2) as (left, right):
        for mode, colour, label in ((0, OURS, "mode 0"), (1, THIRD, "mode 1"), (3, QUIET, "mode 3")):
            left.plot(places, _running_share(found.stream, mode), color=colour, label=label)
        left.set(xlabel="pairs of object and task", ylabel=f"share of the last {WINDOW}", ylim=(0, 1))
        left.set_title("Mode of the answers")
        left.legend()
        right.plot(places, [one.tried for one in found.stream], ".", color=OURS)
        right.set(xlabel="pairs of object and task", ylabel="candidates closed", yscale="log")
        right.set_title("Candidates for each answer")


def _running_share(stream: Sequence[PairResult], mode: int) -> Array:
    hit = np.array([one.answered and one.mode == mode for one in stream], dtype=np.float64)
    return np.array([hit[max(0, k - WINDOW + 1) : k + 1].mean() for k in range(len(hit))])
