"""Which index predicts success: the statistics, the indices, the population, going on, and the command."""

from __future__ import annotations

import json
import math
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from preshape.cli.main import run
from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.demand import Demand
from preshape.closure.settings import ClosureSettings
from preshape.dataset.index_values import (
    INDICES,
    Index,
    IndexInput,
    column,
    index_values,
    planner_score,
    task_wrench,
)
from preshape.dataset.random_grasps import PRESS, draw_random_grasps, random_generator, random_grasp_settings
from preshape.exceptions import InputError
from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim
from preshape.objects.load import load_object
from preshape.physics.protocol import HoldProtocol
from preshape.physics.task.motion import task_motion
from preshape.physics.task.protocol import TaskProtocol
from preshape.planning.controllers import layout_of
from preshape.report.markdown import markdown
from preshape.studies import indices
from preshape.studies.index_figures import QUESTIONS, index_figures, rows_of
from preshape.studies.index_report import findings, index_report
from preshape.studies.index_statistics import area, calibration, difference, within, within_difference
from preshape.studies.indices import IndexRows, IndexRun, run_indices
from preshape.tasks import named_task

# ---------------------------------------------------------------- statistics


def pairs(scores: np.ndarray, passed: np.ndarray) -> float:
    """The area by its definition."""
    won = [1.0 if a > b else 0.5 if a == b else 0.0 for a in scores[passed] for b in scores[~passed]]
    return float(np.mean(won))


def test_area_is_the_share_of_pairs_in_the_right_order() -> None:
    rng = np.random.default_rng(1)
    for _ in range(30):
        scores = rng.integers(0, 6, 40).astype(float)  # many ties
        scores[rng.random(40) < 0.2] = -np.inf
        passed = rng.random(40) < 0.4
        found = area(scores, passed)
        assert found.area == pytest.approx(pairs(scores, passed), abs=1e-12)
        assert area(-scores, passed).area == pytest.approx(1 - found.area, abs=1e-12)
        low, high = found.interval
        assert 0 <= low < found.area < high <= 1
        assert (found.successes, found.failures) == (passed.sum(), (~passed).sum())


def test_area_by_hand() -> None:
    yes, no = True, False
    assert area(np.array([1.0, 2, 3, 4]), np.array([no, yes, no, yes])).area == 0.75
    assert area(np.ones(6), np.array([no, yes] * 3)).area == 0.5
    nothing = area(np.array([1.0, 2.0]), np.array([yes, yes]))
    assert (nothing.area, nothing.interval, nothing.successes) == (None, None, 2)
    # DeLong by hand: placements of successes 1/2 and 1, of failures 1 and 1/2.
    found = area(np.array([1.0, 2, 3, 4]), np.array([no, yes, no, yes]))
    deviation = math.sqrt(0.125 / 2 + 0.125 / 2)
    half = 1.959964 * deviation / (0.75 * 0.25)
    assert found.interval[1] == pytest.approx(1 / (1 + math.exp(-(math.log(3) + half))), abs=1e-9)


def test_perfect_area_has_an_interval() -> None:
    """Newcombe's: θ from which 1 is Z standard deviations away."""
    scores, passed = np.arange(12.0), np.arange(12) >= 8
    low, high = area(scores, passed).interval
    assert high == 1.0
    n = 12 / 2 - 1
    variance = low * (1 - low) * (1 + n * (1 - low) / (2 - low) + n * low / (1 + low)) / (4 * 8)
    assert (1 - low) == pytest.approx(1.959964 * math.sqrt(variance), rel=1e-6)
    mirrored = area(-scores, passed)
    assert mirrored.area == 0.0
    assert mirrored.interval[0] == 0.0
    assert mirrored.interval[1] == pytest.approx(1 - low, abs=1e-9)


@pytest.mark.parametrize("levels", [0, 4])
def test_area_interval_covers(levels: int) -> None:
    """Of 95 % intervals about 95 % hold the truth, with and without ties."""
    rng = np.random.default_rng(7)
    good, bad, shift, trials = 25, 45, 1.0, 800

    def draw(n: int, mean: float) -> np.ndarray:
        x = rng.normal(mean, 1.0, n)
        return np.digitize(x, [-0.5, 0.5, 1.5]).astype(float) if levels else x

    truth = (
        area(np.append(draw(4000, shift), draw(4000, 0.0)), np.arange(8000) < 4000).area
        if levels
        else 0.5 * (1 + math.erf(shift / 2))
    )
    passed = np.arange(good + bad) < good
    held = 0
    for _ in range(trials):
        low, high = area(np.append(draw(good, shift), draw(bad, 0.0)), passed).interval
        held += low <= truth <= high
    assert 0.925 < held / trials < 0.975


def test_difference_is_paired() -> None:
    """Two numbers that share most of their noise: the interval must use that, and be right."""
    rng = np.random.default_rng(3)
    passed = np.arange(80) < 30
    held = small = 0
    widths, trials = [], 500
    truth = 0.5 * (1 + math.erf(1.2 / 2 / math.sqrt(1.09))) - 0.5 * (1 + math.erf(0.6 / 2 / math.sqrt(1.09)))
    for _ in range(trials):
        common = rng.normal(0, 1, 80)
        first, second = (common + rng.normal(0, 0.3, 80) + shift * passed for shift in (1.2, 0.6))
        found = difference(first, second, passed)
        held += found.interval[0] <= truth <= found.interval[1]
        widths.append(found.interval[1] - found.interval[0])
        null = difference(common + rng.normal(0, 0.3, 80), common + rng.normal(0, 0.3, 80), passed)
        small += null.p < 0.05
    alone = area(first, passed).interval
    assert 0.92 < held / trials < 0.98
    assert 0.02 < small / trials < 0.09
    assert np.mean(widths) < alone[1] - alone[0]
    same = difference(first, first, passed)
    assert (same.difference, same.interval) == (0.0, None)
    swapped = difference(second, first, passed)
    assert swapped.difference == pytest.approx(-difference(first, second, passed).difference, abs=1e-12)


def scene(rng: np.random.Generator, skill: float, spread: float) -> tuple[np.ndarray, ...]:
    """Objects of very different difficulty; the number tells how hard the object is, and ``skill`` more."""
    objects = np.repeat([f"o{k}" for k in range(10)], 40)
    ease = np.repeat(rng.normal(0, spread, 10), 40)
    own = rng.normal(0, 1, 400)
    passed = ease + own > 0
    return 3 * ease + skill * own + rng.normal(0, 1, 400), passed, objects


def test_within_objects_difficulty_is_no_skill() -> None:
    rng = np.random.default_rng(5)
    scores, passed, objects = scene(rng, 0.0, 1.5)
    inside = within(scores, passed, objects, objects)
    assert area(scores, passed).area > 0.8
    assert inside.area == pytest.approx(0.5, abs=0.08)
    assert inside.interval[0] < 0.5 < inside.interval[1]
    constant = within(np.unique(objects, return_inverse=True)[1].astype(float), passed, objects, objects)
    assert constant.area == 0.5
    skilled, passed, objects = scene(rng, 1.0, 1.5)
    found = within(skilled, passed, objects, objects)
    assert found.interval[0] > 0.6
    gap = within_difference(skilled, scores, passed, objects, objects)
    assert gap.difference == pytest.approx(
        found.area - within(scores, passed, objects, objects).area, abs=1e-12
    )
    assert gap.interval[0] > 0
    assert gap.p < 0.01


def test_within_by_hand() -> None:
    """Weights s·f/(s + f); groups with one verdict only do not count."""
    groups = ["a"] * 4 + ["b"] * 3 + ["c"] * 2
    scores = np.array([1.0, 2, 3, 4, 5, 9, 7, 100, 200])
    passed = np.array([0, 1, 0, 1, 1, 0, 0, 1, 1], dtype=bool)
    found = within(scores, passed, groups, groups)
    assert found.area == pytest.approx((1.0 * 0.75 + (2 / 3) * 0.0) / (1.0 + 2 / 3))
    assert found.interval is None  # two objects
    assert (found.successes, found.failures) == (3, 4)
    assert within(scores[7:], passed[7:], groups[7:], groups[7:]).area is None


def test_calibration_bins() -> None:
    rng = np.random.default_rng(2)
    order = rng.permutation(100)
    bins = calibration(order.astype(float), order >= 35)
    assert [b.count for b in bins] == [10] * 10
    assert [b.successes for b in bins] == [0, 0, 0, 5, 10, 10, 10, 10, 10, 10]
    assert [(b.low, b.high) for b in bins] == [(10.0 * k, 10.0 * k + 9) for k in range(10)]
    assert bins[3].rate == 0.5
    assert bins[3].interval == pytest.approx((0.2366, 0.7634), abs=1e-4)  # Wilson of 5 of 10
    assert bins[0].interval == pytest.approx((0.0, 0.2775), abs=1e-4)


def test_calibration_keeps_ties_together() -> None:
    rng = np.random.default_rng(4)
    scores = np.where(rng.random(300) < 0.6, 0.0, rng.random(300))
    scores[:20] = -np.inf
    passed = rng.random(300) < 0.3
    bins = calibration(scores, passed)
    assert sum(b.count for b in bins) == 300
    assert sum(b.successes for b in bins) == passed.sum()
    assert all(a.high < b.low for a, b in pairwise(bins))
    assert sum(b.low <= 0.0 <= b.high for b in bins) == 1
    assert len(calibration(np.ones(50), passed[:50])) == 1


def test_statistics_refuse_nan_and_odd_lengths() -> None:
    with pytest.raises(InputError, match="nan"):
        area(np.array([1.0, np.nan]), np.array([True, False]))
    with pytest.raises(InputError, match="as many"):
        area(np.array([1.0, 2.0]), np.array([True]))
    with pytest.raises(InputError, match="bins"):
        calibration(np.array([1.0]), np.array([True]), 0)


# ---------------------------------------------------------------- indices of one grasp

SETTINGS = ClosureSettings(press_least=PRESS, press_most=PRESS, threads=1)


def pinch(normals: float = 1.0, centre: tuple[float, float, float] = (0.0, 0, 0)) -> IndexInput:
    """Two fingers against each other along x."""
    return IndexInput(
        points=np.array([[0.03, 0, 0], [-0.03, 0, 0]]),
        normals_in=np.array([[-1.0, 0, 0], [normals, 0, 0]]),
        centre=np.array(centre),
        cog=np.zeros(3),
        length=0.05,
        length_unit=0.172,
        plane=1,
    )


def values(grasp: IndexInput, label: str) -> dict[str, tuple[float | None, str]]:
    task = named_task(label)
    motion = task_motion(task, np.zeros(3), 0.05)
    settings = ClosureSettings(torsion=0.01, threads=1)

    def score(demand: Demand) -> float:
        return demand.load

    return index_values(grasp, task.q, motion, mass=0.1, press=PRESS, settings=settings, score=score)


def test_every_index_of_a_pinch() -> None:
    found = values(pinch(), "lift")
    assert set(found) == {index.name for index in INDICES}
    number = {name: value[0] for name, value in found.items()}
    assert number["closed"] == 1.0
    # Turning about the line of the fingers is the weakest: torsion/ℓ.
    assert number["epsilon_l1"] == pytest.approx(0.2, abs=1e-6)
    assert number["hold_margin"] == pytest.approx(0.2, rel=0.02)
    assert number["contacts"] == 2
    assert number["planner"] == pytest.approx(9.8 / 9.81)  # asked for one weight
    assert number["manipulability"] == 2
    # Lifting with 10 N of grip at friction 0.6 leaves 6 N less the weight of 0.98 N, in a cone of 15°.
    assert 3.0 < number["task_margin"] < 5.02
    turned = {name: value[0] for name, value in values(pinch(), "turn:+x").items()}
    assert turned["task_margin"] < number["task_margin"]
    assert turned["planner"] == pytest.approx(0.5 * 9.8 / 9.81)  # a torque of half a weight times ℓ
    same = [i.name for i in INDICES if not i.of_task]
    assert {name: turned[name] for name in same} == {name: number[name] for name in same}


def test_undefined_is_worse_than_any_number_and_unknown_is_left_out() -> None:
    bad = values(pinch(normals=-1.0), "lift:+x")  # both push the same way, and not up
    assert bad["closed"] == (0.0, "NOT_CLOSED")
    assert bad["task_margin"][0] is None
    rows = [
        {"indices": {"m": [3.0, "OK"]}},
        {"indices": {"m": [None, "LOAD_NOT_HELD"]}},
        {"indices": {"m": [None, "NOT_CONVERGED"]}},
    ]
    up, down = (column(rows, Index(name="m", title="m", sign=s)) for s in (1, -1))
    assert up[0] == 3.0
    assert down[0] == -3.0
    assert up[1] == down[1] == -np.inf
    assert np.isnan([up[2], down[2]]).all()


def test_task_wrench_is_the_load_turned_round_and_moved() -> None:
    motion = task_motion(named_task("lever"), np.zeros(3), 0.05)
    off = np.array([0.01, -0.02, 0.004])
    here, weight = task_wrench(pinch(), motion, 0.1)
    there, _ = task_wrench(pinch(centre=tuple(off)), motion, 0.1)
    load = motion.load(0.0, 0.1)
    assert here == pytest.approx(-np.append(load[:3], load[3:] / 0.05))
    assert np.linalg.norm(here[:3]) == pytest.approx(0.98)
    assert np.linalg.norm(here[3:]) == pytest.approx(0.49)
    # Torque about another point: τ - off × f.
    assert there[:3] == pytest.approx(here[:3])
    assert there[3:] * 0.05 == pytest.approx(here[3:] * 0.05 - np.cross(off, here[:3]))
    assert weight[:3] == pytest.approx(0.98 * motion.gravity)


def test_paper_indices_are_the_analysers_own() -> None:
    """TFVADI, stability and manipulability of real grips, against what the planner reports of them."""
    hand, mesh, task = load_hand("allegro"), load_object("cube"), named_task("lift")
    small = ClosureSettings(everywhere=400, elite=8, rounds=1, finished=4, threads=1)
    analyser = ClosureAnalyser(mesh, hand, layout_of(hand), settings=small, gravity=task.gravity)
    aim = Aim(planes=tuple(range(1, 13)), values=tuple(np.linspace(-1, 1, 9)), fingers=(2, 3, 4))
    found = analyser.explore(task.q, aim)
    assert len(found.grips) >= 2
    for grasp in found.grips:
        one = IndexInput(
            points=grasp.contacts.points,
            normals_in=grasp.contacts.normals_in,
            centre=analyser.middle,
            cog=mesh.cog,
            length=analyser.search.length,
            length_unit=4 * hand.u,
            plane=grasp.plane.index,
        )
        motion = task_motion(task, mesh.cog, analyser.search.length)
        # The planner weighs the object against a middling grip.
        score = partial(planner_score, analyser.search, one)
        ours = index_values(
            one, task.q, motion, mass=0.1, press=small.middling, settings=SETTINGS, score=score
        )
        assert ours["tfvadi"][0] == pytest.approx(grasp.tfvadi, abs=1e-9)
        assert (ours["stability"][0], ours["manipulability"][0]) == (grasp.stability, grasp.manipulability)
        press = np.einsum("ni,ni->n", grasp.forces, grasp.contacts.normals_in).sum()
        margin = min(grasp.task_margin, grasp.hold_margin) / press * small.weight
        assert ours["planner"][0] == pytest.approx(margin, rel=0.03)


# ---------------------------------------------------------------- population, run, command

QUICK = TaskProtocol(hold=HoldProtocol(stop_early=True, checks=3), duration=0.6, rise=0.1, rest=0.1)
RUN = IndexRun(hands=("leap",), objects=("cylinder", "sphere"), count=12, seed=2, protocol=QUICK)


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("parts")


@pytest.fixture(scope="module")
def found(parts: Path) -> IndexRows:
    return run_indices(RUN, folder=parts, workers=1)


def test_random_grasps_are_not_ranked() -> None:
    hand, mesh = load_hand("leap"), load_object("cylinder")
    drawn, again, other = (
        draw_random_grasps(
            hand, mesh, count, random_generator(seed, "leap", "cylinder"), random_grasp_settings()
        )
        for count, seed in ((24, 0), (24, 0), (3, 1))
    )
    grips = drawn.grasps
    assert len(grips) == 24
    assert drawn.drawn >= drawn.closed >= 24
    for a, b in zip(grips, again.grasps, strict=True):
        assert np.array_equal(a.squeeze, b.squeeze)
        assert np.array_equal(a.palm_pose, b.palm_pose)
    assert not np.array_equal(grips[0].palm_pose, other.grasps[0].palm_pose)
    holds = np.array([grip.hold_margin for grip in grips])
    left = [np.linalg.norm(grip.forces.sum(axis=0)) for grip in grips]
    assert max(left) > 0.2 * PRESS  # some cannot even be balanced
    assert (holds == 0).sum() >= 3  # the planner would show none of these
    assert not (np.diff(holds) <= 0).all()
    for one in drawn.grasps:
        assert len(one.points) == len(one.fingers_touching) >= 2
        assert np.einsum("ni,ni->n", one.forces, one.normals_in).sum() <= PRESS * (1 + 1e-6)


def test_quick_run(found: IndexRows) -> None:
    rows = found.rows
    assert len(rows) == 12
    assert [row["object"] for row in rows] == ["cylinder"] * 6 + ["sphere"] * 6
    assert found.notes == ()
    assert {row["held"] for row in rows} == {True, False}
    for row in rows:
        assert row["held"] == (row["hold_status"] == "held")
        assert row["done"] == (row["task_status"] == "done")
        assert set(row["indices"]) == {index.name for index in INDICES}
        assert len(row["points"]) == row["indices"]["contacts"][0]
    assert len({row["task"] for row in rows}) > 2


def test_figures_are_those_of_the_rows(found: IndexRows) -> None:
    document = index_figures(found)
    json.dumps(document, allow_nan=False)
    questions = {question["name"]: question for question in document["questions"]}
    held = np.array([row["held"] for row in found.rows])
    scores = np.array([row["indices"]["push_residual"][0] for row in found.rows])
    one = next(i for i in questions["held"]["indices"] if i["name"] == "push_residual")
    assert one["all"]["area"] == pytest.approx(pairs(-scores, held))
    assert sum(b["count"] for b in one["bins"]) == 12
    assert questions["held"]["successes"] == held.sum()
    assert questions["done_if_held"]["grasps"] == held.sum()
    closed = rows_of(found.rows, next(q for q in QUESTIONS if q.name == "held_if_closed"))
    assert all(row["indices"]["closed"][0] == 1.0 for row in closed)
    assert questions["held_if_closed"]["grasps"] == len(closed) < 12
    page = markdown(index_report(document))
    assert all(index.title in page for index in INDICES)
    assert any("TFVADI of the task" in sentence for sentence in findings(document))
    assert sum(rate["held"] for rate in document["rates"]) == held.sum()


def test_a_stopped_run_goes_on(
    found: IndexRows, parts: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for part in parts.glob("*.json"):  # the grasps are drawn already
        (tmp_path / part.name).write_bytes(part.read_bytes())

    def never(*_: object) -> None:
        raise AssertionError("what is kept is not drawn again")

    monkeypatch.setattr(indices, "draw_random_grasps", never)

    def stop(fraction: float, label: str) -> None:
        if label.startswith("holding") and fraction > 0.4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_indices(RUN, folder=tmp_path, workers=1, progress=stop)
    first = (tmp_path / "leap.holds.jsonl").read_text()
    again = run_indices(RUN, folder=tmp_path, workers=1)
    assert (tmp_path / "leap.holds.jsonl").read_text().startswith(first)
    assert 1 < first.count("\n") < 13
    assert json.dumps(again.rows) == json.dumps(found.rows)
    other = IndexRun(hands=RUN.hands, objects=RUN.objects, count=12, seed=3, protocol=QUICK)
    with pytest.raises(InputError, match="another"):
        run_indices(other, folder=tmp_path, workers=1)
    (tmp_path / "leap-cylinder.json").write_text("{")
    with pytest.raises(InputError, match="remove it"):
        run_indices(RUN, folder=tmp_path, workers=1)


def test_command(found: IndexRows, tmp_path: Path, monkeypatch, capsys) -> None:
    asked_for: list[IndexRun] = []

    def given(run: IndexRun, **_: object) -> IndexRows:
        asked_for.append(run)
        return found

    monkeypatch.setattr(indices, "run_indices", given)
    out = tmp_path / "out"
    code = run(
        ["bench", "indices", "--hand", "leap", "--objects", "cylinder,sphere", "--count", "12", "--seed", "2",
         "--out", str(out), "--json"]
    )  # fmt: skip
    document = json.loads(capsys.readouterr().out)
    assert code == 0
    assert document["status"] == "answer"
    assert (asked_for[0].hands, asked_for[0].objects, asked_for[0].count, asked_for[0].seed) == (
        ("leap",), ("cylinder", "sphere"), 12, 2,
    )  # fmt: skip
    assert asked_for[0].protocol.hold.stop_early
    names = {"report.md", "report.html", "report.json", "grasps.json", "areas.png", "calibration.png"}
    assert {Path(path).name for path in document["files"]} == names == {p.name for p in out.iterdir()}
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in out.glob("*.png"))
    assert len(json.loads((out / "grasps.json").read_text())["rows"]) == 12
    assert run(["bench", "indices", "--hand", "leap"]) == 0
    assert "push residual" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--count", "0"], "--count"),
        (["--seed", "-1"], "--seed"),
        (["--workers", "0"], "--workers"),
        (["--hand", ","], "--hand"),
        (["--out", " "], "--out"),
        (["--hand", "paw", "--count", "1"], "paw"),
        (["--objects", "unicorn", "--hand", "leap", "--count", "1"], "unicorn"),
    ],
)
def test_bad_options(options: list[str], said: str, capsys) -> None:
    assert run(["bench", "indices", *options]) == 2
    assert said in capsys.readouterr().err
