"""Does the closure analyser's memory pay? A stream of objects and tasks, met one after the other.

Along the stream: the share answered at mode 0 (what the estimator names is good enough), what each answer
cost in candidates, and its quality. At the end: every (object, task) that was learnt is asked for again
(nothing may be lost), and held-out pairs are asked for twice, with the memory and with a fresh one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ..closure.analyser import ClosureAnalyser
from ..closure.settings import ClosureSettings
from ..closure_control import closure_controller
from ..decision import Settings, Status
from ..hands.model import load_hand
from ..io import write_json, write_whole
from ..memory import Memory
from ..objects.library import load_library_object, names
from ..objects.mesh import TriangleMesh
from ..planner import layout_of
from ..tasks import Task, family_names, parse_task
from ..types import Array, value
from .plots import OURS, QUIET, THIRD, Canvas

WINDOW = 20
LARGEST = 0.16  # [m], largest extent of an object that takes part


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
        again: those answered in mode 3, asked for again at the end.
        held_out: pairs never learnt, with the memory.
        fresh: the same pairs, each with a memory that knows the cube only and explores everything.
    """

    stream: tuple[Met, ...]
    again: tuple[Met, ...]
    held_out: tuple[Met, ...]
    fresh: tuple[Met, ...]

    def share(self, first: int, last: int) -> float:
        """Share of the stream's answers first..last that came at mode 0."""
        part = self.stream[first:last]
        return sum(m.answered and m.mode == 0 for m in part) / max(1, len(part))

    def figures(self) -> dict[str, object]:
        """Numbers for a table."""
        n = len(self.stream)
        both = [(a, b) for a, b in zip(self.held_out, self.fresh, strict=True) if a.answered and b.answered]
        as_good = [a.quality >= 0.95 * b.quality for a, b in both]
        return {
            "met": n,
            "mode_0_first_window": self.share(0, WINDOW),
            "mode_0_last_window": self.share(n - WINDOW, n),
            "learnt": len(self.again),
            "still_answered": sum(m.answered for m in self.again),
            "still_mode_0": sum(m.answered and m.mode == 0 for m in self.again),
            "held_out": len(self.held_out),
            "held_out_answered": sum(m.answered for m in self.held_out),
            "fresh_answered": sum(m.answered for m in self.fresh),
            "held_out_as_good": sum(as_good),
            "candidates_ratio_median": float(np.median([a.tried / max(1, b.tried) for a, b in both]))
            if both
            else None,
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
        held_out: how many pairs are kept for the end.
        seed: of the stream and of the planner.
        closure: size of the search.
        progress: called after each question.
    """
    rng = np.random.default_rng(seed)
    pairs = _pairs(rng, length + held_out)
    total = length + 2 * held_out
    with Memory.open(":memory:") as memory:
        stream = []
        for k, (name, scale, task) in enumerate(pairs[:length]):
            stream.append(_meet(memory, hand, name, scale, task, seed, closure, learn=True))
            if progress is not None:
                progress(k + 1, total)
        taught = [pair for pair, met in zip(pairs, stream, strict=False) if met.mode == 3 and met.answered]
        again = [_meet(memory, hand, *pair, seed, closure, learn=False) for pair in taught]
        known = []
        for k, pair in enumerate(pairs[length:]):
            known.append(_meet(memory, hand, *pair, seed, closure, learn=False))
            if progress is not None:
                progress(length + k + 1, total)
    fresh = []
    for k, pair in enumerate(pairs[length:]):
        with Memory.open(":memory:") as empty:
            fresh.append(_meet(empty, hand, *pair, seed, closure, learn=True, explore=True))
        if progress is not None:
            progress(length + held_out + k + 1, total)
    return LearningStudy(stream=tuple(stream), again=tuple(again), held_out=tuple(known), fresh=tuple(fresh))


def _pairs(rng: np.random.Generator, count: int) -> list[tuple[str, float, Task]]:
    """Objects at sizes a little apart, with tasks, every object about as often as the others."""
    usable = [n for n in names() if load_library_object(n).extents.max() <= LARGEST]
    order = np.concatenate([rng.permutation(len(usable)) for _ in range(count // len(usable) + 1)])[:count]
    families = family_names()
    return [
        (
            usable[int(i)],
            float(np.round(rng.uniform(0.9, 1.1), 3)),
            parse_task(families[int(rng.integers(len(families)))]),
        )
        for i in order
    ]


def _meet(
    memory: Memory,
    hand: str,
    name: str,
    scale: float,
    task: Task,
    seed: int,
    closure: ClosureSettings | None,
    *,
    learn: bool,
    explore: bool = False,
) -> Met:
    model = load_hand(hand)
    mesh = _scaled(load_library_object(name), scale)
    controller = closure_controller(
        memory,
        model,
        layout_of(model),
        settings=Settings(seed=seed),
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


def write(found: LearningStudy, out: Path) -> None:
    """Figures as JSON, every question as a row, and the plot."""
    rows = {
        part: [
            {"name": m.name, "task": m.task, "mode": m.mode, "quality": m.quality, "tried": m.tried}
            for m in getattr(found, part)
        ]
        for part in ("stream", "again", "held_out", "fresh")
    }
    write_json(out / "closure_learning.json", {"figures": found.figures(), **rows})
    write_whole(out / "closure_learning.png", lambda path: _draw(found, path))


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
