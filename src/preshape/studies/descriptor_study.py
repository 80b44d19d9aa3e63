"""The paper's seven attributes or the shape descriptor: which says more of an object never met?

Some library objects are held out, the estimator learns the others, and is then asked about those held
out. A second question is asked of the objects it did learn: does it still know them once their surface was
cut into four times as many triangles?
"""

from __future__ import annotations

import math
from collections.abc import Sequence

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
from ..tasks import all_named_tasks
from ..types import Array, Attributes, Experience, NetworkWeights, value
from .bench import Bench
from .values import Progress

TASKS, FOLDS, SEEDS = 8, 5, (0, 1, 2)
QUICK_OBJECTS = ("cube", "box", "cylinder", "wedge", "pyramid", "prism")

_COLUMNS: dict[str, tuple[InputKind, int]] = {
    "paper": ("paper", INPUT_COUNTS["paper"]),
    "shape": ("shape", INPUT_COUNTS["shape"]),
    "extents": ("paper", 9),
    "task": ("paper", 6),
}
"""What each estimator is told: kind of inputs, and how many of them. The last two are yardsticks."""

RESAMPLES = 2000


@value
class Share:
    """A share of (object, task) pairs with its 95 % interval, from resampling whole objects.

    Attributes:
        mean: of all pairs, 0..1; of a difference, -1..1.
        low: lower end.
        high: upper end.
    """

    mean: float
    low: float
    high: float


@value
class Told:
    """How well an estimator does that is told so much of an object.

    Attributes:
        name: ``paper``, ``shape``, ``extents`` or ``task``.
        mode_0: held-out pairs whose estimated plane, set and fingers give TFVADI ≥ threshold (mode 0).
        mode_1: held-out pairs whose estimated plane has a virtual grasp of that TFVADI (modes 0 and 1).
        same_plane: held-out pairs whose estimated plane is the one that would have been taught.
        recut: learnt pairs answered at mode 0 once the surface has four times as many triangles.
        learnt: learnt pairs answered at mode 0 with the surface that was learnt.
    """

    name: str
    mode_0: Share
    mode_1: Share
    same_plane: Share
    recut: Share
    learnt: Share


@value
class Comparison:
    """What the study found.

    Attributes:
        objects: how many.
        pairs: held-out (object, task) pairs over all seeds.
        folds: parts into which the objects were divided, each held out once.
        seeds: of tasks, folds and networks.
        told: one entry for each estimator.
        gain_0: ``shape`` less ``paper``, pair by pair, at mode 0.
        gain_1: the same at modes 0 and 1.
        possible: pairs for which some plane has a virtual grasp of that TFVADI.
    """

    objects: int
    pairs: int
    folds: int
    seeds: tuple[int, ...]
    told: tuple[Told, ...]
    gain_0: Share
    gain_1: Share
    possible: Share


@value
class _Subject:
    """An object, as it is and with its surface cut finer."""

    name: str
    analyser: Analyser
    plain: Attributes
    recut: Attributes


@value
class _Case:
    """One task on one object, and what the explorer taught of it."""

    thing: int
    q: Array
    learnt: tuple[Experience, ...]
    plane: int
    possible: bool
    recallable: bool


class _Tally:
    """Which pairs were answered, by estimator and column; keeps the object for the intervals."""

    def __init__(self) -> None:
        self._marks: dict[tuple[str, str], list[tuple[int, bool]]] = {}

    def note(self, name: str, column: str, thing: int, good: bool) -> None:
        self._marks.setdefault((name, column), []).append((thing, good))

    def share(self, name: str, column: str) -> Share:
        marks = self._marks.get((name, column), [])
        return _share([thing for thing, _ in marks], [float(good) for _, good in marks])

    def gain(self, column: str) -> Share:
        new, old = self._marks["shape", column], self._marks["paper", column]
        return _share(
            [thing for thing, _ in new],
            [float(a) - float(b) for (_, a), (_, b) in zip(new, old, strict=True)],
        )


def compare(
    bench: Bench,
    *,
    objects: Sequence[str] | None = None,
    tasks: int = TASKS,
    folds: int = FOLDS,
    seeds: Sequence[int] = SEEDS,
    progress: Progress | None = None,
) -> Comparison:
    """Train each estimator without some objects and ask it about them; over all objects and seeds.

    For every seed each object gets ``tasks`` tasks of its own, drawn from all named tasks along all axes;
    what the explorer teaches for them (task and best possible task) and the first training on the cube are
    the training data, and an estimator is trained as in use.

    Args:
        bench: hand and settings.
        objects: library objects; all by default.
        tasks: for each object.
        folds: parts into which the objects are divided; each is held out once.
        seeds: of tasks, folds and networks.
        progress: called with the fraction done and what is being done.

    Raises:
        InputError: fewer objects than folds, fewer than two folds, or no seed or task.
    """
    chosen = list(names() if objects is None else objects)
    if not 2 <= folds <= len(chosen) or tasks < 1 or not seeds:
        raise InputError(
            f"the study needs 2 or more folds, as many objects, a task and a seed, got {folds} folds, "
            f"{len(chosen)} objects, {tasks} tasks, {len(seeds)} seeds"
        )
    tell = progress or (lambda fraction, label: None)
    controller, settings = bench.controller(), bench.controller().settings
    tally = _Tally()
    subjects = [_subject(name, bench) for name in chosen]
    cube = seed_experiences(bench.library("cube"), settings.sets, enough=settings.thresholds.estimation)
    for number, seed in enumerate(seeds):
        rng = np.random.default_rng(seed)
        cases: list[_Case] = []
        for thing, subject in enumerate(subjects):
            tell((number + 0.2 * thing / len(chosen)) / len(seeds), f"seed {seed}: exploring {subject.name}")
            cases += _cases(subject, thing, tasks, rng, controller)
        fold_of = rng.permutation(len(chosen)) % folds
        for fold in range(folds):
            held = [case for case in cases if fold_of[case.thing] == fold]
            others = [case for case in cases if fold_of[case.thing] != fold]
            material = [*cube, *(e for case in others for e in case.learnt)]
            for step, name in enumerate(_COLUMNS):
                done = 0.2 + 0.8 * (fold + step / len(_COLUMNS)) / folds
                tell((number + done) / len(seeds), f"seed {seed}, fold {fold + 1} of {folds}: {name}")
                weights = _trained(material, name, bench, seed)
                _ask_held(tally, name, weights, held, subjects, controller)
                if fold == 0:
                    _ask_learnt(tally, name, weights, others, subjects, controller)
        for case in cases:
            tally.note("any", "possible", case.thing, case.possible)
    tell(1.0, "done")
    columns = ("mode_0", "mode_1", "same_plane", "learnt", "recut")
    return Comparison(
        objects=len(chosen),
        pairs=len(chosen) * tasks * len(seeds),
        folds=folds,
        seeds=tuple(seeds),
        told=tuple(
            Told(name=name, **{column: tally.share(name, column) for column in columns}) for name in _COLUMNS
        ),
        gain_0=tally.gain("mode_0"),
        gain_1=tally.gain("mode_1"),
        possible=tally.share("any", "possible"),
    )


def cut_finer(mesh: TriangleMesh) -> TriangleMesh:
    """The same surface with every triangle cut into four at the middles of its edges."""
    count, (a, b, c) = len(mesh.vertices), mesh.triangles.T
    edges = np.sort([(a, b), (b, c), (c, a)], axis=1)  # (3, 2, m)
    keys, middle = np.unique(edges[:, 0] * count + edges[:, 1], return_inverse=True)
    ends = np.stack([keys // count, keys % count])
    vertices = np.concatenate([mesh.vertices, mesh.vertices[ends].mean(axis=0)])
    ab, bc, ca = count + middle.reshape(3, -1)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    triangles = np.concatenate([np.column_stack(part) for part in parts])
    return TriangleMesh(name=mesh.name, vertices=vertices, triangles=triangles, mass=mesh.mass)


def _subject(name: str, bench: Bench) -> _Subject:
    analyser = bench.library(name)
    mesh = analyser.mesh
    return _Subject(name=name, analyser=analyser, plain=described(mesh), recut=described(cut_finer(mesh)))


def _cases(
    subject: _Subject, thing: int, tasks: int, rng: np.random.Generator, controller: Controller
) -> list[_Case]:
    """Tasks of an object's own, explored."""
    every = all_named_tasks()
    sets, threshold = controller.settings.sets, controller.settings.thresholds.estimation
    cases = []
    for index in rng.choice(len(every), tasks, replace=False):
        q = every[index].q
        found = explore(subject.analyser, q, sets, enough=threshold)
        learnt = experiences_of(subject.analyser, subject.name, q, found, sets)[:2] if found else []
        cases.append(
            _Case(
                thing=thing,
                q=q,
                learnt=tuple(learnt),
                plane=found.taught.plane.index if found else 0,
                possible=judge(found.answer.tfvadi if found else None, threshold).reward,
                recallable=judge(found.taught.tfvadi if found else None, threshold).reward,
            )
        )
    return cases


def _trained(material: Sequence[Experience], name: str, bench: Bench, seed: int) -> NetworkWeights:
    kind, columns = _COLUMNS[name]
    x, y = training_set(material, bench.layout.u, kind=kind)
    return train(x[:, :columns], y, seed=seed)


def _estimate(
    name: str, weights: NetworkWeights, case: _Case, attributes: Attributes, controller: Controller
) -> Estimate:
    kind, columns = _COLUMNS[name]
    return decode(predict(weights, inputs(case.q, attributes, controller.layout.u, kind)[:columns]))


def _rewarded(found: Exploration, controller: Controller) -> bool:
    match = float(found.match[0]) if len(found) else None
    return judge(match, controller.settings.thresholds.estimation).reward


def _ask_held(
    tally: _Tally,
    name: str,
    weights: NetworkWeights,
    cases: Sequence[_Case],
    subjects: Sequence[_Subject],
    controller: Controller,
) -> None:
    """About objects that were not learnt."""
    for case in cases:
        subject = subjects[case.thing]
        estimate = _estimate(name, weights, case, subject.plain, controller)
        zero = _rewarded(controller.at_estimate(subject.analyser, case.q, estimate), controller)
        one = zero or _rewarded(controller.on_plane(subject.analyser, case.q, estimate), controller)
        tally.note(name, "mode_0", case.thing, zero)
        tally.note(name, "mode_1", case.thing, one)
        tally.note(name, "same_plane", case.thing, estimate.plane == case.plane)


def _ask_learnt(
    tally: _Tally,
    name: str,
    weights: NetworkWeights,
    cases: Sequence[_Case],
    subjects: Sequence[_Subject],
    controller: Controller,
) -> None:
    """About objects that were learnt, as they were and with their surface cut finer."""
    for case in cases:
        if case.recallable:
            subject = subjects[case.thing]
            for column, attributes in (("learnt", subject.plain), ("recut", subject.recut)):
                estimate = _estimate(name, weights, case, attributes, controller)
                found = controller.at_estimate(subject.analyser, case.q, estimate)
                tally.note(name, column, case.thing, _rewarded(found, controller))


def _share(things: Sequence[int], marks: Sequence[float]) -> Share:
    """Mean and 95 % interval; whole objects are drawn anew, as the tasks of one are not independent."""
    if not things:
        return Share(mean=math.nan, low=math.nan, high=math.nan)
    sums = np.bincount(things, weights=marks)
    counts = np.bincount(things)
    sums, counts = sums[counts > 0], counts[counts > 0]
    drawn = np.random.default_rng(0).integers(len(sums), size=(RESAMPLES, len(sums)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return Share(mean=float(sums.sum() / counts.sum()), low=float(low), high=float(high))
