"""The learning element: seed tasks, fuzzy explorer, what is remembered, incremental learning, the promise."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise, product

import numpy as np
import pytest

from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim, Exploration, GraspContacts, VirtualGrasp
from preshape.hiis.controller import Controller
from preshape.hiis.critic import Thresholds, recognise
from preshape.hiis.decision import Settings, Status
from preshape.hiis.estimator import decode, encode, inputs, predict
from preshape.hiis.fuzzy import FuzzySets, approaching_degrees, tfvadi
from preshape.hiis.learning import (
    FINE_VALUES,
    experiences_of,
    explore,
    learn,
    search_values,
    seed_experiences,
    seed_tasks,
    training_set,
)
from preshape.hiis.planes import PLANES, allowed_planes, plane
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.memory import Memory
from preshape.objects.library import entry, load_library_object, names
from preshape.objects.mesh import TriangleMesh
from preshape.planning.controllers import layout_of
from preshape.tasks import family_names, parse_task
from preshape.types import ANSWER_KIND, ContactCoefficients, value

LAYOUT = layout_of(load_hand("utah_mit"))
SETS = FuzzySets()
CRISP = SETS.crisp()
FULL = np.ones(6)  # a task on which a wrench component counts 1 where it is 1.0, 1/2 at 0.825, 0 at 0
Q1, Q2 = (1, 1, 0.1, 0.05, 0.8, 0.05), (1, 1, 0.1, 0.8, 0.05, 0.05)


@cache
def prepared(name: str) -> RayAnalyser:
    return RayAnalyser(load_library_object(name), LAYOUT)


@value
class TableExploration(Exploration):
    """What the table's analyser found for a task."""

    task: np.ndarray

    @property
    def summary(self) -> str:
        return f"{len(self)} rows of {self.tried}"

    def grasp(self, index: int = 0) -> VirtualGrasp:
        adi = approaching_degrees(self.task, self.wrench[index], SETS)
        nothing = np.zeros((int(self.fingers[index]), 3))
        return VirtualGrasp(
            plane=plane(int(self.plane[index])),
            flip=bool(self.flip[index]),
            approach_value=float(self.value[index]),
            approach_set=SETS.name_index(float(self.value[index])),
            fingers=int(self.fingers[index]),
            contacts=GraspContacts(
                points=nothing,
                normals_in=nothing,
                triangles=np.zeros(len(nothing), dtype=np.int64),
                wrenches=np.zeros((len(nothing), 6)),
            ),
            net_wrench=self.wrench[index],
            adi=adi,
            tfvadi=float(adi.sum()),
            stability=0,
            manipulability=len(nothing),
            ray_origins=nothing,
        )


class Table:
    """A performance element that looks up: (plane, flip, value, fingers) → a match of 0, 1/2 … 6."""

    mesh: TriangleMesh = load_library_object("cube")
    layout = LAYOUT
    coefficients = ContactCoefficients()

    def __init__(self, matches: dict[tuple[int, bool, float, int], float]) -> None:
        self.matches = matches

    def explore(self, q, aim: Aim) -> Exploration:
        ways = list(product(aim.planes, aim.flips, [float(v) for v in aim.values], aim.fingers))
        hits = [way for way in ways if way in self.matches]
        wrench = np.array([self.wrench(self.matches[way]) for way in hits]).reshape(-1, 6)
        return TableExploration(
            plane=np.array([way[0] for way in hits], dtype=np.int64),
            flip=np.array([way[1] for way in hits], dtype=bool),
            value=np.array([way[2] for way in hits], dtype=np.float64),
            fingers=np.array([way[3] for way in hits], dtype=np.int64),
            wrench=wrench,
            match=tfvadi(q, wrench, SETS),
            tried=len(ways),
            reason="the table has none",
            task=q,
        ).best_first()

    @staticmethod
    def wrench(match: float):
        whole = int(match)
        return np.array([1.0] * whole + [0.825] * int(match > whole) + [0.0] * 6)[:6]


FINE = float(FINE_VALUES[np.abs(FINE_VALUES - 0.4).argmin()])
"""An approach value between the crisp ones."""


def test_the_table_gives_the_matches_that_it_was_given():
    for match in np.arange(0, 6.5, 0.5):
        assert tfvadi(FULL, Table.wrench(match), SETS) == pytest.approx(match, abs=1e-12)
    assert not np.isin(FINE, CRISP)


# -- seed tasks ----------------------------------------------------------------------------------------


def test_the_48_seed_tasks_are_q1_and_q2_of_each_plane_in_both_signs():
    tasks = seed_tasks()
    assert tasks.shape == (48, 6)
    assert len(np.unique(tasks, axis=0)) == 48
    for p, four in zip(PLANES, tasks.reshape(12, 4, 6), strict=True):
        a, o = p.approach_axis, p.opposition_axis
        t = np.abs(p.transverse_axis)
        # Translation along a and ±o in full, nothing across; rotation about o (Q1) or a (Q2), 0.8.
        for (q1, q2), sign in zip(four.reshape(2, 2, 6), (1, -1), strict=True):
            for q, about in ((q1, o), (q2, a)):
                assert q[:3] @ a == pytest.approx(1.0)
                assert q[:3] @ o == pytest.approx(sign)
                assert q[:3] @ t == pytest.approx(0.1)
                assert np.abs(q[3:] @ about) == pytest.approx(0.8)
                rest = [x for x, turned in zip(q[3:], np.abs(about), strict=True) if not turned]
                assert rest == pytest.approx([0.05, 0.05])


def test_the_tasks_of_table_1_are_among_the_seeds():
    for q in (Q1, Q2):
        assert np.isclose(seed_tasks(), q).all(axis=1).any()


def test_the_seeds_are_met_with_the_cube_and_are_answered_by_it():
    seeds = seed_experiences(prepared("cube"), SETS, enough=3.0)
    assert len(seeds) == 48
    assert {(e.kind, e.object_name, e.hand) for e in seeds} == {("seed", "cube", "utah_mit")}
    for e, q in zip(seeds, seed_tasks(), strict=True):
        assert e.task == pytest.approx(q)
        assert np.isclose(e.approach_value, CRISP).any()
        best = explore(prepared("cube"), q, SETS, enough=3.0, values=CRISP)
        assert e.match == pytest.approx(best.answer.tfvadi, abs=1e-12)


def plain_adi(a: float, b: float) -> float:
    """PAPER's ADI of two numbers, written out: trapezoids with shoulders, min(a • b, 1 - a ⊗ b)."""

    def memberships(x):
        return [
            1.0 if p1 <= x <= p2 else max(0.0, (x - p0) / (p1 - p0) if x < p1 else (p3 - x) / (p3 - p2))
            for p0, p1, p2, p3 in (
                (-np.inf, -np.inf, -0.9, -0.75),
                (-0.9, -0.8, -0.5, -0.35),
                (-0.5, -0.35, -0.15, -0.05),
                (-0.15, -0.05, 0.05, 0.15),
                (0.05, 0.15, 0.35, 0.5),
                (0.35, 0.5, 0.8, 0.9),
                (0.75, 0.9, np.inf, np.inf),
            )
        ]

    pairs = list(zip(memberships(a), memberships(b), strict=True))
    return min(max(min(pair) for pair in pairs), 1 - min(max(pair) for pair in pairs))


# -- the fuzzy explorer --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["pyramid", "mug", "wrench"])
@pytest.mark.parametrize("task", [Q1, (0.1, -0.3, 1.25, 0.05, 0.05, -0.8)])
def test_the_explorer_equals_brute_force_over_planes_flips_values_and_fingers(name, task):
    pa, q = prepared(name), np.array(task, dtype=float)
    values = np.sort(np.append(CRISP, [-0.8, 0.4, FINE_VALUES[40]]))
    matches = {}
    for p, flip, v, n in product(range(1, 13), (False, True), values, (2, 3, 4)):
        one = pa.explore(q, Aim(planes=[p], flips=[flip], values=[v], fingers=[n]))
        if len(one):
            (wrench,) = one.wrench
            matches[p, flip, v, n] = sum(plain_adi(a, b) for a, b in zip(q, wrench, strict=True))
    discovery = explore(pa, q, SETS, enough=3.0, values=values)
    assert discovery.found.tried == 12 * 2 * 3 * len(values)
    assert len(discovery.found) == len(matches)
    assert discovery.answer.tfvadi == pytest.approx(max(matches.values()), abs=1e-9)
    f = discovery.found
    ways = zip(f.plane.tolist(), f.flip.tolist(), f.value.tolist(), f.fingers.tolist(), strict=True)
    for way, match in zip(ways, f.match, strict=True):
        assert matches[way] == pytest.approx(match, abs=1e-9)
    assert (np.diff(f.match) <= 1e-9).all()
    g = discovery.answer
    assert matches[g.plane.index, g.flip, g.approach_value, g.fingers] == pytest.approx(g.tfvadi, abs=1e-9)


def test_the_explorer_searches_the_crisp_values_and_values_between_them():
    values = search_values(SETS)
    assert np.isin(CRISP, values).all()
    assert (np.diff(values) > 0).all()
    assert np.abs(values).max() <= 0.95
    for low, high in pairwise(CRISP):
        assert ((values > low) & (values < high)).sum() >= 5
    found = explore(prepared("box"), FULL, SETS, enough=3.0).found
    assert set(np.unique(found.plane)) == set(range(1, 13))
    assert set(np.unique(found.value)) <= set(values)


def test_nothing_found_is_no_discovery():
    assert explore(Table({}), FULL, SETS, enough=3.0) is None
    only_5 = Table({(5, False, 0.0, 2): 4.0})
    assert explore(only_5, FULL, SETS, enough=3.0, allowed=allowed_planes("+z")) is None


def test_the_explorer_stays_on_the_allowed_planes():
    pa = prepared("mug")
    for approaches in ("+z", "-x,+y", "-z"):
        allowed = allowed_planes(approaches)
        discovery = explore(pa, np.array(Q1), SETS, enough=3.0, allowed=allowed)
        assert allowed[discovery.found.plane - 1].all()
        assert allowed[discovery.answer.plane.index - 1]
        assert allowed[discovery.taught.plane.index - 1]


def test_among_equal_matches_a_crisp_value_wins_even_where_another_is_nearer_the_middle():
    nearer = float(FINE_VALUES[np.abs(FINE_VALUES - 0.1).argmin()])
    table = Table({(5, False, nearer, 3): 4.0, (7, True, 0.65, 2): 4.0})
    discovery = explore(table, FULL, SETS, enough=3.0)
    assert discovery.answer.approach_value == 0.65
    assert discovery.answer.plane.index == 7
    assert discovery.taught.approach_value == 0.65


def test_a_better_match_between_the_crisp_values_is_the_answer():
    table = Table({(5, False, FINE, 3): 4.5, (5, False, 0.25, 3): 4.0})
    discovery = explore(table, FULL, SETS, enough=3.0)
    assert (discovery.answer.approach_value, discovery.answer.tfvadi) == (FINE, pytest.approx(4.5))
    assert (discovery.taught.approach_value, discovery.taught.tfvadi) == (0.25, pytest.approx(4.0))


def test_what_is_taught_stays_on_the_answers_plane_where_a_crisp_value_there_is_good_enough():
    table = Table({(5, False, FINE, 3): 5.0, (5, True, 0.25, 2): 3.0, (7, False, 0.0, 3): 4.5})
    discovery = explore(table, FULL, SETS, enough=3.0)
    assert discovery.answer.plane.index == 5
    taught = discovery.taught
    assert (taught.plane.index, taught.flip, taught.approach_value, taught.fingers) == (5, True, 0.25, 2)


def test_else_it_moves_to_the_best_plane_on_which_a_crisp_value_is():
    table = Table({(5, False, FINE, 3): 5.0, (5, False, 0.25, 3): 2.5, (7, False, 0.0, 3): 3.5})
    discovery = explore(table, FULL, SETS, enough=3.0)
    assert discovery.answer.plane.index == 5
    assert (discovery.taught.plane.index, discovery.taught.approach_value) == (7, 0.0)


def test_and_stays_after_all_where_there_is_none():
    table = Table({(5, False, FINE, 3): 5.0, (5, False, 0.25, 3): 2.0, (7, False, 0.0, 3): 2.5})
    taught = explore(table, FULL, SETS, enough=3.0).taught
    assert (taught.plane.index, taught.approach_value) == (5, 0.25)
    alone = Table({(5, False, FINE, 3): 5.0, (7, False, 0.0, 3): 2.5})
    taught = explore(alone, FULL, SETS, enough=3.0).taught
    assert (taught.plane.index, taught.approach_value) == (5, FINE)


# -- what is remembered --------------------------------------------------------------------------------


def test_a_lesson_is_the_task_the_best_possible_task_a_landmark_and_a_better_answer():
    pa, q = prepared("mug"), parse_task("pour").q
    discovery = explore(pa, q, SETS, enough=3.0)
    experiences = experiences_of(pa, "mug", q, discovery, SETS)
    task, best = (next(e for e in experiences if e.kind == kind) for kind in ("task", "best"))
    landmarks = [e for e in experiences if e.kind == "landmark"]
    assert landmarks
    (answer,) = (e for e in experiences if e.kind == ANSWER_KIND)
    assert len(experiences) == 3 + len(landmarks)
    assert answer.match == pytest.approx(discovery.answer.tfvadi)
    assert answer.match > discovery.taught.tfvadi  # else there is nothing to store beside what is taught
    taught = discovery.taught
    for e in (task, best):
        assert (e.plane, e.flip, e.fingers) == (taught.plane.index, taught.flip, taught.fingers)
        assert (e.approach_value, e.approach_set) == (taught.approach_value, taught.approach_set)
        assert e.wrench == pytest.approx(taught.net_wrench)
    assert task.task == pytest.approx(q)
    assert best.task == pytest.approx(taught.net_wrench)
    same = replace(discovery, answer=taught)  # what is taught is the answer: nothing is stored beside it
    kinds = [e.kind for e in experiences_of(pa, "mug", q, same, SETS)]
    assert ANSWER_KIND not in kinds
    assert kinds == [e.kind for e in experiences if e.kind != ANSWER_KIND]
    for e in experiences:
        assert (e.object_name, e.hand) == ("mug", "utah_mit")
        assert e.match == pytest.approx(float(tfvadi(e.task, e.wrench, SETS)), abs=1e-12)
        again = pa.explore(
            e.task, Aim(planes=[e.plane], values=[e.approach_value], fingers=[e.fingers], flips=[e.flip])
        )
        assert again.wrench[0] == pytest.approx(e.wrench, abs=1e-12)


@pytest.mark.parametrize("name", names())
def test_a_landmark_of_every_library_object_resembles_itself_enough_to_be_recognised(name):
    pa = prepared(name)
    q = parse_task(entry(name).tasks[-1]).q
    experiences = experiences_of(pa, name, q, explore(pa, q, SETS, enough=3.0), SETS)
    landmarks = [e for e in experiences if e.kind == "landmark"]
    assert max(float(tfvadi(e.wrench, e.wrench, SETS)) for e in landmarks) >= 5.0
    assert recognise(pa, landmarks, 5.0, SETS).verdict.reward


# -- the training set ----------------------------------------------------------------------------------


def lesson(name: str, task: str, **changes):
    pa, q = prepared(name), parse_task(task).q
    return [
        replace(e, **changes) for e in experiences_of(pa, name, q, explore(pa, q, SETS, enough=3.0), SETS)
    ]


def test_the_training_set_holds_tasks_and_best_possible_tasks_but_no_landmarks():
    experiences = lesson("mug", "pour") + lesson("bowl", "lift")
    x, y = training_set(experiences, LAYOUT.u)
    assert (x.shape, y.shape) == ((4, 13), (4, 9))
    wanted = [e for e in experiences if e.kind in ("task", "best")]
    for row, bits, e in zip(x, y, wanted, strict=True):
        assert row == pytest.approx(inputs(e.task, e.attributes, LAYOUT.u))
        assert bits == pytest.approx(encode(e.plane, e.approach_set, e.fingers))


def test_a_later_lesson_replaces_the_earlier_for_the_same_task_and_object():
    first = [e for e in lesson("mug", "pour") if e.kind == "task"]
    other_plane = first[0].plane % 12 + 1
    later = [replace(first[0], plane=other_plane, approach_set=6, fingers=4)]
    x, y = training_set(first + later, LAYOUT.u)
    assert len(x) == 1
    assert y[0] == pytest.approx(encode(other_plane, 6, 4))
    _, y = training_set(later + first, LAYOUT.u)
    assert y[0] == pytest.approx(encode(first[0].plane, first[0].approach_set, first[0].fingers))
    # Another object, or another task, is another lesson.
    others = [
        replace(later[0], attributes=prepared("bowl").mesh.attributes),
        replace(later[0], task=later[0].task + np.array([0.01, 0, 0, 0, 0, 0])),
    ]
    assert len(training_set(first + others, LAYOUT.u)[0]) == 3


def test_the_later_lesson_is_what_the_network_says():
    seeds = seed_experiences(prepared("cube"), SETS, enough=3.0)
    (first,) = (e for e in lesson("mug", "pour") if e.kind == "task")
    later = replace(first, plane=first.plane % 12 + 1, fingers=2)
    weights = learn([*seeds, first], LAYOUT.u, None)
    weights = learn([*seeds, first, later], LAYOUT.u, weights)
    said = decode(predict(weights, inputs(first.task, first.attributes, LAYOUT.u)))
    assert (said.plane, said.approach_set, said.fingers) == (later.plane, later.approach_set, later.fingers)


# -- incremental learning ------------------------------------------------------------------------------

LESSONS = [
    ("mug", "pour"),
    ("pen", "insert"),
    ("bowl", "lift"),
    ("hammer", "strike"),
    ("apple", "twist"),
    ("key", "turn"),
]


def controller(seed: int = 0, memory: Memory | None = None) -> Controller:
    return Controller(memory or Memory.open(":memory:"), LAYOUT, settings=Settings(seed=seed))


def test_learning_an_object_keeps_the_earlier_ones():
    c = controller()
    before = c.weights.trained_on
    for number, (name, task) in enumerate(LESSONS, start=1):
        assert c.teach(prepared(name), parse_task(task)).status is Status.ANSWER
        assert c.weights.trained_on == before + 2 * number
        for earlier, asked in LESSONS[:number]:
            decision = c.run(prepared(earlier), parse_task(asked), may_learn=False)
            assert decision.mode == 0, (earlier, asked, "after", name)
    for q in seed_tasks():
        estimate = decode(predict(c.weights, inputs(q, prepared("cube").mesh.attributes, LAYOUT.u)))
        seed = next(e for e in c.experiences if e.kind == "seed" and np.allclose(e.task, q))
        assert (estimate.plane, estimate.approach_set, estimate.fingers) == (
            seed.plane,
            seed.approach_set,
            seed.fingers,
        )


def weights_of(c: Controller) -> list:
    w = c.weights
    return [w.w1.tolist(), w.b1.tolist(), w.w2.tolist(), w.b2.tolist(), w.mean_square_error, w.epochs]


def test_the_same_seed_gives_the_same_weights_and_another_seed_others():
    first, second, other = controller(3), controller(3), controller(4)
    assert weights_of(first) == weights_of(second)
    assert weights_of(first) != weights_of(other)
    for c in (first, second, other):
        c.teach(prepared("mug"), parse_task("pour"))
    assert weights_of(first) == weights_of(second)
    assert weights_of(first) != weights_of(other)


def test_learning_goes_on_from_the_weights_that_there_are():
    c = controller()
    before = c.weights
    c.teach(prepared("mug"), parse_task("pour"))
    fresh = learn(c.experiences, LAYOUT.u, None)
    going_on = learn(c.experiences, LAYOUT.u, before)
    assert c.weights.w1.tolist() == going_on.w1.tolist()
    assert c.weights.w1.tolist() != fresh.w1.tolist()


def test_tasks_far_out_of_the_usual_range_are_learnt_without_harm_to_the_others():
    c = controller()
    for task in ("pour", "1000 1 .1 .05 .8 .05", "-1e9 0 0 0 0 1e9"):
        c.teach(prepared("mug"), parse_task(task))
        c.reset()
    assert c.run(prepared("mug"), parse_task("pour"), may_learn=False).mode == 0
    assert np.isfinite(c.weights.w1).all()


def test_even_the_largest_finite_task_is_only_a_task():
    c = controller()
    decision = c.teach(prepared("mug"), parse_task("1e308 1 1 1 1 1"))
    c.reset()
    assert decision.status in (Status.ANSWER, Status.DEADLOCK)
    assert decision.best is not None
    c.teach(prepared("mug"), parse_task("pour"))
    assert c.run(prepared("mug"), parse_task("pour"), may_learn=False).mode == 0


# -- the promise ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12])
def test_twenty_objects_with_two_tasks_each_are_learnt_one_after_the_other(seed):
    """At least 80 % of the 40 at mode 0, 95 % at mode 0 or 1, the first as well as the last.

    And the answer at mode 0 names the plane that the explorer found best in at least 80 %.
    """
    rng = np.random.default_rng(seed)
    c = Controller(Memory.open(":memory:"), LAYOUT, settings=Settings(thresholds=Thresholds(), seed=seed))
    lessons = [
        (str(name), str(family))
        for name in rng.choice([n for n in names() if n != "cube"], 20, replace=False)
        for family in rng.choice(family_names(), 2, replace=False)
    ]
    assert len({family for _, family in lessons}) >= 12
    for name, family in lessons:
        c.teach(prepared(name), parse_task(family))
        c.reset()
    modes, best_plane = [], []
    for name, family in lessons:
        task = parse_task(family)
        decision = c.run(prepared(name), task, may_learn=False)
        c.reset()
        modes.append(decision.mode if decision.grasp is not None else 3)
        if decision.mode == 0:
            best = explore(prepared(name), task.q, SETS, enough=3.0).answer
            best_plane.append(decision.grasp.plane.index == best.plane.index)
    mode_0, answered = np.array(modes) == 0, np.array(modes) <= 1
    assert mode_0.mean() >= 0.80
    assert answered.mean() >= 0.95
    assert np.mean(best_plane) >= 0.80
    for half in (slice(0, 20), slice(20, 40)):
        assert mode_0[half].mean() >= 0.80
        assert answered[half].mean() >= 0.90  # 95 % of twenty is nineteen; one more may fall on one side
