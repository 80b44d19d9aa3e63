"""Does the closure analyser's memory pay? A stream of objects and tasks, met one after the other.

Along the stream: the share answered at mode 0 (what the estimator names is good enough), what each answer
cost in candidates, and its quality. At the end every (object, task) that was answered is asked for again:
nothing may be lost. Then come objects that were never in the stream. A fresh memory explores everything for
each; with the memory the same is asked for, once as usual, and once with the critic's threshold at the margin
that exploring reached: how many candidates does experience need for it?
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..closure.analyser import ClosureAnalyser
from ..closure.finish import margin_of, quality
from ..closure.settings import ClosureSettings
from ..closure_control import closure_controller
from ..hands.load import load_hand
from ..hiis.critic import Thresholds
from ..hiis.decision import Settings, Status
from ..memory import Memory
from ..objects.library import load_library_object, names
from ..objects.mesh import TriangleMesh
from ..physics.hold.tables import TextTable
from ..planner import layout_of
from ..planning.document import write_json, write_whole
from ..tasks import Task, family_names, parse_task
from ..types import Array, value
from .plots import OURS, QUIET, THIRD, Canvas

WINDOW = 20
LARGEST = 0.16
"""Largest extent of an object that takes part [m]."""
HELD_OUT = 0.2
"""Share of the objects that are kept out of the stream."""
SAME = 0.95
"""Share of a margin that counts as the same."""


@value
class Met:
    """One object and task, and how they were answered.

    Attributes:
        name: the object's.
        task: the task's label.
        mode: the controller's last, 0..3.
        answered: whether there was an answer.
        quality: of the answer, 0..6; 0 without.
        tried: candidates closed for it.
    """

    name: str
    task: str
    mode: int
    answered: bool
    quality: float
    tried: int


@value
class LearningStudy:
    """What the stream showed.

    Attributes:
        stream: in the order met.
        again: those answered along the stream, asked for again at the end.
        fresh: objects held out, each with a memory that knows the cube only and explores everything.
        held_out: the same pairs, never learnt, with the memory.
        wanting: the same with the memory, asked for the margin that exploring reached.
    """

    stream: tuple[Met, ...]
    again: tuple[Met, ...]
    fresh: tuple[Met, ...]
    held_out: tuple[Met, ...]
    wanting: tuple[Met, ...]

    def share(self, first: int, last: int) -> float:
        """Share of the stream's answers first..last that came at mode 0."""
        part = self.stream[first:last]
        return sum(m.answered and m.mode == 0 for m in part) / max(1, len(part))

    def ratios(self) -> Array:
        """Candidates with the memory over those without, for each held-out pair that exploring answers.

        Both for the margin that exploring reaches. Where experience does not reach it, and mode 3 has not
        explored everything already, that has to be done after all.
        """
        pairs = [(w, f) for w, f in zip(self.wanting, self.fresh, strict=True) if f.answered]
        return np.array(
            [(w.tried + (0 if w.answered or w.mode == 3 else f.tried)) / f.tried for w, f in pairs]
        )

    def figures(self) -> dict[str, Any]:
        """Numbers for a table."""
        n, ratios = len(self.stream), self.ratios()
        window = min(WINDOW, n)
        return {
            "met": n,
            "answered": sum(m.answered for m in self.stream),
            "mode_0_first_window": self.share(0, window),
            "mode_0_last_window": self.share(n - window, n),
            "learnt": sum(m.answered and m.mode == 3 for m in self.stream),
            "asked_again": len(self.again),
            "still_answered": sum(m.answered for m in self.again),
            "still_mode_0": sum(m.answered and m.mode == 0 for m in self.again),
            "held_out": len(self.held_out),
            "held_out_answered": sum(m.answered for m in self.held_out),
            "held_out_mode_0": sum(m.answered and m.mode == 0 for m in self.held_out),
            "fresh_answered": sum(m.answered for m in self.fresh),
            "candidates_as_usual": _median([m.tried for m in self.held_out]),
            "candidates_fresh": _median([m.tried for m in self.fresh]),
            "same_margin_ratio_median": _median(ratios),
            "same_margin_within_a_tenth": int((ratios <= 0.1).sum()),
        }


def study(
    *,
    hand: str = "shadow",
    length: int = 100,
    held_out: int = 20,
    seed: int = 0,
    closure: ClosureSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> LearningStudy:
    """Run the stream.

    Args:
        hand: whose memory.
        length: how many objects and tasks are met.
        held_out: how many pairs are asked for of objects that are never met.
        seed: of the stream and of the planner.
        closure: size of the search.
        progress: called after each question.
    """
    rng = np.random.default_rng(seed)
    usable = [n for n in names() if n != "cube" and load_library_object(n).extents.max() <= LARGEST]
    order = [usable[int(i)] for i in rng.permutation(len(usable))]
    kept_out = max(1, round(HELD_OUT * len(order)))
    pairs, strangers = _pairs(rng, order[kept_out:], length), _pairs(rng, order[:kept_out], held_out)
    done, total = 0, 2 * length + 3 * held_out  # at most: what was answered is asked for again

    def meet(memory: Memory, pair: tuple[str, float, Task], **how: Any) -> Met:
        nonlocal done
        met = _meet(memory, hand, *pair, seed, closure, **how)
        done += 1
        if progress is not None:
            progress(done, total)
        return met

    with Memory.open(":memory:") as memory:
        stream = [meet(memory, pair, learn=True) for pair in pairs]
        answered = [pair for pair, met in zip(pairs, stream, strict=True) if met.answered]
        done += length - len(answered)
        again = [meet(memory, pair) for pair in answered]
        fresh = []
        for pair in strangers:
            with Memory.open(":memory:") as empty:
                fresh.append(meet(empty, pair, explore=True))
        known = [meet(memory, pair) for pair in strangers]
        wanting = [
            meet(memory, pair, threshold=_nearly(met.quality) if met.answered else None)
            for pair, met in zip(strangers, fresh, strict=True)
        ]
    return LearningStudy(
        stream=tuple(stream),
        again=tuple(again),
        fresh=tuple(fresh),
        held_out=tuple(known),
        wanting=tuple(wanting),
    )


def _pairs(rng: np.random.Generator, things: Sequence[str], count: int) -> list[tuple[str, float, Task]]:
    """Objects at sizes a little apart, with tasks, every object about as often as the others."""
    order = np.concatenate([rng.permutation(len(things)) for _ in range(count // len(things) + 1)])[:count]
    families = family_names()
    return [
        (
            things[int(i)],
            float(np.round(rng.uniform(0.9, 1.1), 3)),
            parse_task(families[int(rng.integers(len(families)))]),
        )
        for i in order
    ]


def _nearly(judged: float) -> float:
    """The quality of :data:`SAME` of its margin."""
    return quality(SAME * margin_of(judged))


def _median(numbers: Sequence[float] | Array) -> float | None:
    return float(np.median(numbers)) if len(numbers) else None


def _meet(
    memory: Memory,
    hand: str,
    name: str,
    scale: float,
    task: Task,
    seed: int,
    closure: ClosureSettings | None,
    *,
    learn: bool = False,
    explore: bool = False,
    threshold: float | None = None,
) -> Met:
    model = load_hand(hand)
    mesh = _scaled(load_library_object(name), scale)
    controller = closure_controller(
        memory,
        model,
        layout_of(model),
        settings=Settings(
            seed=seed, thresholds=Thresholds() if threshold is None else Thresholds(estimation=threshold)
        ),
        closure=closure or ClosureSettings(finished=4),
        gravity=task.gravity,
    )
    element = controller.prepare(mesh)
    decision = controller.teach(element, task) if explore else controller.run(element, task, may_learn=learn)
    grasp = decision.grasp
    return Met(
        name=f"{name}@{scale:g}",
        task=task.label,
        mode=decision.mode,
        answered=decision.status is Status.ANSWER,
        quality=grasp.judged if grasp is not None else 0.0,
        tried=element.tried if isinstance(element, ClosureAnalyser) else 0,
    )


def _scaled(mesh: TriangleMesh, scale: float) -> TriangleMesh:
    return TriangleMesh(
        name=mesh.name, vertices=mesh.vertices * scale, triangles=mesh.triangles, counts=mesh.counts
    )


def table(found: LearningStudy) -> TextTable:
    """The figures for people."""
    f = found.figures()

    def part(count: str, of: str) -> str:
        return f"{f[count]} of {f[of]}"

    def number(name: str, form: str) -> str:
        return "-" if f[name] is None else format(f[name], form)

    rows = (
        ("answered along the stream", part("answered", "met")),
        ("of the first window at mode 0", f"{f['mode_0_first_window']:.0%}"),
        ("of the last window at mode 0", f"{f['mode_0_last_window']:.0%}"),
        ("learnt in mode 3", part("learnt", "answered")),
        ("answered, and still answered at the end", part("still_answered", "asked_again")),
        ("... at mode 0", part("still_mode_0", "asked_again")),
        ("objects never met: pairs answered", part("held_out_answered", "held_out")),
        ("... of these at mode 0", part("held_out_mode_0", "held_out_answered")),
        ("... exploring everything with a fresh memory", part("fresh_answered", "held_out")),
        ("candidates closed for one, median", number("candidates_as_usual", ".0f")),
        ("... exploring everything", number("candidates_fresh", ".0f")),
        (
            "candidates for the margin that exploring reaches, share",
            number("same_margin_ratio_median", ".3f"),
        ),
        ("... a tenth or less", part("same_margin_within_a_tenth", "fresh_answered")),
    )
    return TextTable(
        caption=f"The memory along {f['met']} objects and tasks; a window is {min(WINDOW, f['met'])} of them",
        columns=("what", "measured"),
        rows=rows,
    )


def write(found: LearningStudy, out: Path) -> list[Path]:
    """Figures as JSON, every question as a row, and the plot; returns the files."""
    rows = {
        part: [
            {"name": m.name, "task": m.task, "mode": m.mode, "quality": m.quality, "tried": m.tried}
            for m in getattr(found, part)
        ]
        for part in ("stream", "again", "fresh", "held_out", "wanting")
    }
    files = [out / "report.json", out / "learning.png"]
    write_json(files[0], {"figures": found.figures(), **rows})
    write_whole(files[1], lambda path: _draw(found, path))
    return files


def _draw(found: LearningStudy, path: Path) -> None:
    n = len(found.stream)
    with Canvas(path, size=(9.0, 3.6), columns=2) as (left, right):
        for mode, colour, label in ((0, OURS, "mode 0"), (1, THIRD, "mode 1"), (3, QUIET, "mode 3")):
            left.plot(range(1, n + 1), _running(found.stream, mode), color=colour, label=label)
        left.set(xlabel="objects and tasks met", ylabel=f"share of the last {WINDOW}", ylim=(0, 1))
        left.set_title("Where the answers come from")
        left.legend()
        right.plot(range(1, n + 1), [m.tried for m in found.stream], ".", color=OURS)
        right.set(xlabel="objects and tasks met", ylabel="candidates closed", yscale="log")
        right.set_title("What an answer costs")


def _running(stream: Sequence[Met], mode: int) -> Array:
    hit = np.array([m.answered and m.mode == mode for m in stream], dtype=np.float64)
    return np.array([hit[max(0, k - WINDOW + 1) : k + 1].mean() for k in range(len(hit))])
