"""Inputs of the approach estimator: the paper's seven attributes or a shape descriptor?

The estimator learns some library objects and is tested on the held-out others. A second test concerns the
learnt objects: does the estimator still know them after each triangle of their surface was divided in four?
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..exceptions import InputError
from ..hiis.analyser import Analyser, Exploration
from ..hiis.controller import Controller
from ..hiis.critic import judge
from ..hiis.estimator import INPUT_COUNTS, Estimate, InputKind, decode, inputs, predict
from ..hiis.learning import experiences_of, explore, seed_experiences, training_set
from ..hiis.training import train
from ..objects.library import names
from ..objects.mesh import TriangleMesh
from ..objects.shape import described
from ..report import Table
from ..tasks import all_named_tasks
from ..types import Array, Attributes, Experience, NetworkWeights, value
from .experiment import Experiment, Progress, Section
from .setup import CUBE, Data, Setup

TASKS, FOLDS, SEEDS = 8, 5, (0, 1, 2)
QUICK_OBJECTS = ("cube", "box", "cylinder", "wedge", "pyramid", "prism")
RESAMPLES = 2000
"""Number of bootstrap draws of an interval."""

_INPUTS: dict[str, tuple[InputKind, int, str]] = {
    "paper": ("paper", INPUT_COUNTS["paper"], "task, extents, four counts (the paper's 13)"),
    "shape": ("shape", INPUT_COUNTS["shape"], "task, extents, shape descriptor (37)"),
    "extents": ("paper", 9, "task, extents (9)"),
    "task": ("paper", 6, "task alone (6)"),
}
"""Kind, number and description of each estimator's inputs; the last two are for comparison only."""

_COLUMNS = ("mode_0", "mode_1", "same_plane", "learnt", "recut")
"""Shares of (object, task) pairs that are measured for each estimator.

``mode_0``: held-out pairs whose estimated grasp reaches the threshold. ``mode_1``: these, and held-out pairs
for which another grasp on the estimated plane reaches it. ``same_plane``: held-out pairs whose estimated
plane is the one that the explorer teaches.
``learnt``: learnt pairs answered at mode 0. ``recut``: the same pairs with four times as many triangles.
"""


@value
class _Subject:
    """An object, with its attributes and those of its surface with divided triangles."""

    name: str
    analyser: Analyser
    plain: Attributes
    recut: Attributes


@value
class _Pair:
    """One task on one object, and the experience that the explorer teaches."""

    subject: int
    q: Array
    lessons: tuple[Experience, ...]
    plane: int
    possible: bool
    recallable: bool


class _Tally:
    """Which pairs were answered, by estimator and column."""

    def __init__(self) -> None:
        self._marks: dict[tuple[str, str], list[tuple[int, bool]]] = {}

    def note(self, name: str, column: str, pair: _Pair, good: bool) -> None:
        self._marks.setdefault((name, column), []).append((pair.subject, good))

    def share(self, name: str, column: str) -> list[float]:
        """Share of the pairs that were answered, with its interval."""
        marks = self._marks.get((name, column), [])
        return _share([subject for subject, _ in marks], [float(good) for _, good in marks])

    def gain(self, column: str) -> list[float]:
        """Share with the shape descriptor minus share with the paper's attributes, over the same pairs."""
        new, old = self._marks["shape", column], self._marks["paper", column]
        return _share(
            [subject for subject, _ in new],
            [float(a) - float(b) for (_, a), (_, b) in zip(new, old, strict=True)],
        )


def compare(
    setup: Setup,
    *,
    objects: Sequence[str] | None = None,
    tasks: int = TASKS,
    folds: int = FOLDS,
    seeds: Sequence[int] = SEEDS,
    progress: Progress | None = None,
) -> Data:
    """Train each estimator without some objects and test it on these, for all objects and seeds.

    For every seed, each object gets its own random tasks. The training data are the explorer's experiences
    with these tasks (task and best possible task) and the first training on the cube. The training method is
    the planner's own.

    Args:
        setup: Hand and settings.
        objects: Library objects; all by default.
        tasks: Number of tasks for each object.
        folds: Number of parts into which the objects are divided; each part is held out once.
        seeds: Seeds of tasks, folds and networks.
        progress: Called with the completed fraction and the current step.

    Returns:
        Plain JSON values. A share is its mean and the ends of its 95 % interval, 0..1.

    Raises:
        InputError: There are fewer objects than folds, fewer than two folds, or no seed or task.
    """
    chosen = list(names() if objects is None else objects)
    if not 2 <= folds <= len(chosen) or tasks < 1 or not seeds:
        raise InputError(
            f"the study needs 2 or more folds, as many objects, a task and a seed, got {folds} folds, "
            f"{len(chosen)} objects, {tasks} tasks, {len(seeds)} seeds"
        )
    tell = progress or (lambda fraction, label: None)
    system = setup.system()
    ready = setup.prepare(system, CUBE)
    controller, settings = ready.controller, ready.controller.settings
    cube = seed_experiences(ready.element, settings.sets, enough=settings.thresholds.estimation)
    subjects = [_subject(name, setup.prepare(system, name).element) for name in chosen]
    tally = _Tally()
    for number, seed in enumerate(seeds):
        rng = np.random.default_rng(seed)
        pairs: list[_Pair] = []
        for k, subject in enumerate(subjects):
            tell((number + 0.2 * k / len(chosen)) / len(seeds), f"seed {seed}: exploring {subject.name}")
            pairs += _explored(subject, k, tasks, rng, controller)
        fold_of = rng.permutation(len(chosen)) % folds
        for fold in range(folds):
            held_out = [pair for pair in pairs if fold_of[pair.subject] == fold]
            learnt = [pair for pair in pairs if fold_of[pair.subject] != fold]
            material = [*cube, *(lesson for pair in learnt for lesson in pair.lessons)]
            for step, name in enumerate(_INPUTS):
                done = 0.2 + 0.8 * (fold + step / len(_INPUTS)) / folds
                tell((number + done) / len(seeds), f"seed {seed}, fold {fold + 1} of {folds}: {name}")
                estimator = _Estimator(name, material, setup.hand.u, seed)
                _ask_held_out(tally, estimator, held_out, subjects, controller)
                if fold == 0:
                    _ask_learnt(tally, estimator, learnt, subjects, controller)
        for pair in pairs:
            tally.note("any", "possible", pair, pair.possible)
    tell(1.0, "done")
    return {
        "objects": len(chosen),
        "pairs": len(chosen) * tasks * len(seeds),
        "folds": folds,
        "seeds": list(seeds),
        "shares": {name: {column: tally.share(name, column) for column in _COLUMNS} for name in _INPUTS},
        "gain_0": tally.gain("mode_0"),
        "gain_1": tally.gain("mode_1"),
        "possible": tally.share("any", "possible"),
    }


def cut_finer(mesh: TriangleMesh) -> TriangleMesh:
    """The same surface with every triangle divided into four at the midpoints of its edges."""
    count, (a, b, c) = len(mesh.vertices), mesh.triangles.T
    edges = np.sort([(a, b), (b, c), (c, a)], axis=1)  # (3, 2, m)
    keys, middle = np.unique(edges[:, 0] * count + edges[:, 1], return_inverse=True)
    ends = np.stack([keys // count, keys % count])
    vertices = np.concatenate([mesh.vertices, mesh.vertices[ends].mean(axis=0)])
    ab, bc, ca = count + middle.reshape(3, -1)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    triangles = np.concatenate([np.column_stack(part) for part in parts])
    return TriangleMesh(name=mesh.name, vertices=vertices, triangles=triangles, mass=mesh.mass)


def _subject(name: str, analyser: Analyser) -> _Subject:
    mesh = analyser.mesh
    return _Subject(name=name, analyser=analyser, plain=described(mesh), recut=described(cut_finer(mesh)))


def _explored(
    subject: _Subject, number: int, tasks: int, rng: np.random.Generator, controller: Controller
) -> list[_Pair]:
    """Draw random tasks for one object and explore them."""
    every = all_named_tasks()
    sets, threshold = controller.settings.sets, controller.settings.thresholds.estimation
    pairs = []
    for index in rng.choice(len(every), tasks, replace=False):
        q = every[index].q
        found = explore(subject.analyser, q, sets, enough=threshold)
        lessons = experiences_of(subject.analyser, subject.name, q, found, sets)[:2] if found else []
        pairs.append(
            _Pair(
                subject=number,
                q=q,
                lessons=tuple(lessons),
                plane=found.taught.plane.index if found else 0,
                possible=judge(found.answer.tfvadi if found else None, threshold).reward,
                recallable=judge(found.taught.tfvadi if found else None, threshold).reward,
            )
        )
    return pairs


class _Estimator:
    """An estimator with one kind of inputs, trained with the planner's own method."""

    def __init__(self, name: str, material: Sequence[Experience], u: float, seed: int) -> None:
        self.name, self._u = name, u
        self._kind, self._columns, _ = _INPUTS[name]
        x, y = training_set(material, u, kind=self._kind)
        self._weights: NetworkWeights = train(x[:, : self._columns], y, seed=seed)

    def estimate(self, q: Array, attributes: Attributes) -> Estimate:
        x = inputs(q, attributes, self._u, self._kind)[: self._columns]
        return decode(predict(self._weights, x))


def _rewarded(found: Exploration, controller: Controller) -> bool:
    match = float(found.match[0]) if len(found) else None
    return judge(match, controller.settings.thresholds.estimation).reward


def _ask_held_out(
    tally: _Tally,
    estimator: _Estimator,
    pairs: Sequence[_Pair],
    subjects: Sequence[_Subject],
    controller: Controller,
) -> None:
    """Test the estimator on objects that were not learnt."""
    for pair in pairs:
        subject = subjects[pair.subject]
        estimate = estimator.estimate(pair.q, subject.plain)
        zero = _rewarded(controller.at_estimate(subject.analyser, pair.q, estimate), controller)
        one = zero or _rewarded(controller.on_plane(subject.analyser, pair.q, estimate), controller)
        tally.note(estimator.name, "mode_0", pair, zero)
        tally.note(estimator.name, "mode_1", pair, one)
        tally.note(estimator.name, "same_plane", pair, estimate.plane == pair.plane)


def _ask_learnt(
    tally: _Tally,
    estimator: _Estimator,
    pairs: Sequence[_Pair],
    subjects: Sequence[_Subject],
    controller: Controller,
) -> None:
    """Test the estimator on learnt objects, with the original surface and with divided triangles."""
    for pair in pairs:
        if pair.recallable:
            subject = subjects[pair.subject]
            for column, attributes in (("learnt", subject.plain), ("recut", subject.recut)):
                estimate = estimator.estimate(pair.q, attributes)
                found = controller.at_estimate(subject.analyser, pair.q, estimate)
                tally.note(estimator.name, column, pair, _rewarded(found, controller))


def _share(subjects: Sequence[int], marks: Sequence[float]) -> list[float]:
    """Mean and 95 % bootstrap interval over objects, because the tasks of one object are not independent."""
    if not subjects:
        return [math.nan] * 3
    sums = np.bincount(subjects, weights=marks)
    counts = np.bincount(subjects)
    sums, counts = sums[counts > 0], counts[counts > 0]
    drawn = np.random.default_rng(0).integers(len(sums), size=(RESAMPLES, len(sums)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return [float(sums.sum() / counts.sum()), float(low), float(high)]


def _measure(setup: Setup, part: Path, progress: Progress) -> Data:
    if setup.quick:
        return compare(setup, objects=QUICK_OBJECTS, tasks=2, folds=2, seeds=(setup.seed,), progress=progress)
    return compare(setup, seeds=tuple(setup.seed + seed for seed in SEEDS), progress=progress)


def _percent(share: Sequence[float]) -> str:
    mean, low, high = (100 * number for number in share)
    return f"{mean:.1f} ({low:.1f} to {high:.1f})"


def _verdict(gain: Sequence[float]) -> str:
    _, low, high = gain
    if low > 0:
        return "the descriptor is better"
    if high < 0:
        return "the paper's attributes are better"
    return "the difference may be chance"


def _present(data: Data) -> Section:
    shares, gain_0, gain_1 = data["shares"], data["gain_0"], data["gain_1"]
    zero, recut = (
        {name: 100 * own[column][0] for name, own in shares.items()} for column in ("mode_0", "recut")
    )
    return Section(
        headline=f"Mode 0 answers {zero['paper']:.0f} % of the tasks on objects never met with the paper's "
        f"attributes and {zero['shape']:.0f} % with the shape descriptor: {_verdict(gain_0)}. After the "
        f"surface was cut finer, it answers {recut['paper']:.0f} % and {recut['shape']:.0f} % of the tasks "
        "on learnt objects.",
        text=(
            f"{data['objects']} library objects are divided into {data['folds']} parts. Each part is held "
            f"out once while the estimator is trained on the others; {data['pairs']} pairs of object and "
            f"task, seeds {', '.join(map(str, data['seeds']))}. A pair counts as answered where TFVADI "
            f"reaches the threshold. Intervals are 95 %, from {RESAMPLES} bootstrap draws of whole objects. "
            f"For {_percent(data['possible'])} % of the pairs some plane has a good enough virtual grasp; "
            "no estimator can answer more.",
            f"Descriptor less attributes, pair by pair: {_percent(gain_0)} points at mode 0 "
            f"({_verdict(gain_0)}), {_percent(gain_1)} points at modes 0 and 1 ({_verdict(gain_1)}).",
        ),
        tables=(
            Table(
                caption="Share of pairs in per cent, with 95 % interval. The first three columns are for "
                "objects held out, the last two for learnt objects, with tasks that were taught and can be "
                "recalled.",
                columns=(
                    "inputs of the estimator", "answered at mode 0", "at mode 0 or 1",
                    "on the plane that would be taught", "learnt, mode 0", "learnt, cut four times finer",
                ),
                rows=tuple(
                    (_INPUTS[name][2], *(_percent(own[column]) for column in _COLUMNS))
                    for name, own in shares.items()
                ),
            ),
        ),
    )  # fmt: skip


DESCRIPTOR = Experiment(
    name="descriptor", title="Inputs of the estimator: seven attributes or a shape descriptor",
    version=2, cost=200, measure=_measure, present=_present,
)  # fmt: skip
