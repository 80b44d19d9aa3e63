"""The closure search: draws, ranking, refinement; threads and the world's axes change nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from preshape.closure.candidates import (
    DrawnCandidates,
    RankedCandidates,
    Region,
    distinct,
    draw_candidates,
    merged,
    quaternions,
)
from preshape.closure.closed import touching_spheres
from preshape.closure.demand import LONGEST, Demand, inner_centre
from preshape.closure.preshapes import posture_at
from preshape.closure.search import ClosureSearch
from preshape.closure.settings import ClosureSettings
from preshape.closure.torque_limits import normal_bounds
from preshape.hands.load import load_hand
from preshape.hiis.planes import plane
from preshape.kernels.chains import fingertips, rotations
from preshape.kernels.closing.host import Candidates, Fate
from preshape.kernels.field.host import prepare_field
from preshape.metrics import Contacts, ForceLimits, task_margin
from preshape.objects.library import load_library_object
from preshape.objects.mesh import TriangleMesh
from preshape.spatial import rotation_from_vector
from preshape.types import Array, IntArray

TRIDENT = str(Path(__file__).parent.parent / "examples" / "hands" / "trident.toml")
LIFT = Demand(direction=np.array([0.0, 0, 1, 0, 0, 0]), base=np.array([0.0, 0, 0.04, 0, 0, 0]))
PLAIN = Demand()
DRAWN = 600


def searcher(mesh: TriangleMesh, **settings: object) -> ClosureSearch:
    field = prepare_field(mesh, cache=None)
    made = ClosureSettings(**{"threads": 1, **settings})  # type: ignore[arg-type]
    length = float(mesh.extents.max()) / 2
    return ClosureSearch(load_hand(TRIDENT), field, inner_centre(field, mesh), length, made)


def drawn(search: ClosureSearch, mesh: TriangleMesh, seed: int = 0, **where: object) -> DrawnCandidates:
    rng = np.random.default_rng(seed)
    region = Region(**where)  # type: ignore[arg-type]
    return draw_candidates(rng, search.pool, mesh.cog, mesh.extents / 2, DRAWN, region)


@pytest.fixture(scope="module")
def box() -> TriangleMesh:
    return load_library_object("box")


@pytest.fixture(scope="module")
def search(box: TriangleMesh) -> ClosureSearch:
    return searcher(box)


@pytest.fixture(scope="module")
def found(search: ClosureSearch, box: TriangleMesh) -> RankedCandidates:
    return search.evaluate(drawn(search, box), LIFT)


def path(search: ClosureSearch, s: DrawnCandidates, station: IntArray) -> Array:
    """(n, j) postures of the drawn preshapes at stations of their closing path."""
    share = station / (search.pool.pinch.shape[1] - 1)
    fingers = len(search.tables.fingers)
    return posture_at(search.tables, s.candidates.start, np.repeat(share[:, None], fingers, axis=1))


def same(a: RankedCandidates, b: RankedCandidates) -> bool:
    """Whether all arrays of two rankings are equal, bit by bit."""
    pairs = [(getattr(a, n), getattr(b, n)) for n in ("score", "task", "hold")]
    pairs += [(getattr(a.drawn, n), getattr(b.drawn, n)) for n in ("plane", "flip", "value")]
    pairs += [
        (getattr(a.drawn.candidates, n), getattr(b.drawn.candidates, n))
        for n in ("place", "turn", "start", "mask")
    ]
    pairs += [(getattr(a.closings, n), getattr(b.closings, n)) for n in ("closing", "points", "counts")]
    return all(np.array_equal(x, y) for x, y in pairs)


# -- where it looks ------------------------------------------------------------------------------------


def test_draws_pinch_at_the_aim_with_the_thumb_on_its_side(search: ClosureSearch, box: TriangleMesh) -> None:
    for number, flip, v in ((3, False, 0.5), (9, True, -0.4)):
        s = drawn(search, box, planes=[number], flips=[flip], values=[v])
        p, tables = plane(number), search.tables
        R = rotations(s.candidates.turn)
        # Somewhere on its closing path the hand's pinch is where it was aimed at: value v along a.
        away, station = np.full(DRAWN, np.inf), np.zeros(DRAWN, dtype=int)
        for k in range(search.pool.pinch.shape[1]):
            pinch = s.candidates.place + np.einsum("nij,nj->ni", R, search.pool.pinch[s.preshape, k])
            along = (pinch - box.cog) @ p.approach_axis / (np.abs(p.approach_axis) @ box.extents / 2)
            off = np.abs(along - s.value)
            station = np.where(off < away, k, station)
            away = np.minimum(away, off)
        assert away.max() < 1e-9
        assert abs(s.value.mean() - v) < 0.02
        # There the thumb is on the +o side, or on the -o side where flipped, but for the jitter.
        tips = fingertips(tables, path(search, s, station))
        used = (s.candidates.mask[:, None] >> np.arange(len(tables.fingers))) & 1
        used[:, tables.thumb] = 0
        others = np.einsum("nf,nfi->ni", used / used.sum(axis=1, keepdims=True), tips)
        thumb = np.einsum("nij,nj->ni", R, tips[:, tables.thumb] - others)
        thumb /= np.linalg.norm(thumb, axis=1, keepdims=True)
        side = thumb @ p.opposition_axis * (-1 if flip else 1)
        assert (side > 0).mean() > 0.97
        assert np.median(side) > 0.8
        # Fingers come from behind, never head-on against the approach.
        assert ((R[:, :, 2] @ p.approach_axis) > -0.5).all()


def test_draws_keep_to_planes_sides_and_finger_numbers(search: ClosureSearch, box: TriangleMesh) -> None:
    s = drawn(search, box, planes=[2, 7], flips=[True], fingers=[2])
    assert set(s.plane) == {2, 7}
    assert s.flip.all()
    bits = np.array([bin(m).count("1") for m in s.candidates.mask])
    assert (bits == 2).all()
    assert ((s.candidates.mask >> search.tables.thumb) & 1).all()
    low, high = search.ranges
    assert (s.candidates.start >= low - 1e-12).all()
    assert (s.candidates.start <= high + 1e-12).all()
    assert np.allclose(np.linalg.norm(s.candidates.turn, axis=1), 1.0)


def test_quaternions_are_those_of_the_rotations() -> None:
    rng = np.random.default_rng(1)
    vectors = rng.normal(size=(60, 3)) * np.repeat([1e-9, 1e-3, 0.3, 1.7, 3.1], 12)[:, None]
    R = rotation_from_vector(vectors)
    assert np.abs(rotations(quaternions(R)) - R).max() < 1e-12


# -- ranking -------------------------------------------------------------------------------------------


def test_the_same_draws_give_the_same_ranking_on_one_thread_and_two(
    search: ClosureSearch, box: TriangleMesh, found: RankedCandidates
) -> None:
    assert len(found) > 50
    assert same(found, search.evaluate(drawn(search, box), LIFT))
    assert same(found, searcher(box, threads=2).evaluate(drawn(search, box), LIFT))
    other = search.evaluate(drawn(search, box, seed=1), LIFT)
    assert not np.array_equal(other.score[:5], found.score[:5])


def test_ranked_best_first_by_the_smaller_of_two_margins(
    search: ClosureSearch, found: RankedCandidates
) -> None:
    assert (np.diff(found.score) <= 0).all()
    assert found.tried == DRAWN
    expected = np.minimum(found.task / LIFT.load, found.hold / search.settings.hold)
    # Motors that cannot press a contact with half of the strongest press lower the score, and nothing else.
    _, links = touching_spheres(search.tables, found.closings)
    width, hands, closings = links.shape[1], found.drawn.candidates, found.closings
    bounds = normal_bounds(
        search.tables,
        search.hand,
        hands,
        posture_at(search.tables, hands.start, closings.closing),
        closings.points[:, :width],
        closings.normals_in[:, :width],
        links,
    )
    used = np.arange(width) < closings.counts[:, None]
    strong = (~used | (bounds >= 0.5 * search.settings.strongest)).all(axis=1)
    assert strong.mean() > 0.2
    assert np.array_equal(found.score[strong], expected[strong])
    assert (found.score <= expected).all()
    assert (found.closings.fate == Fate.CLOSED).all()
    assert (found.closings.counts >= 2).all()
    # It tells good from bad: many do not hold at all, and the best a good deal better than most that do.
    holding = found.score[found.score > 0]
    assert 0.01 < len(holding) / len(found) < 0.9
    assert found.score[0] > 1.3 * np.median(holding)


def test_the_task_margin_is_that_of_the_metrics(search: ClosureSearch, found: RankedCandidates) -> None:
    s, agree = search.settings, 0
    rows = np.linspace(0, len(found) - 1, 12).astype(int)
    for i in rows:
        n = found.closings.counts[i]
        contacts = Contacts(
            positions=found.closings.points[i, :n].astype(float),
            normals_in=found.closings.normals_in[i, :n].astype(float),
            friction=s.friction * s.friction_share,
            torsion=s.torsion * s.friction_share,
            reference=search.cog,
            length=search.length,
        )
        task, base = np.asarray(LIFT.direction), np.asarray(LIFT.base)
        exact = task_margin(contacts, task, ForceLimits(total=1.0), load=-base).number or 0.0
        # Both search for a smallest number, so that either may be a little too large.
        assert 0.75 * exact - 2e-3 <= found.task[i] <= 1.06 * exact + 2e-3
        agree += abs(found.task[i] - exact) <= 0.02 * exact + 2e-3
    assert agree >= 10


def test_more_friction_never_holds_less(box: TriangleMesh, found: RankedCandidates) -> None:
    low, high = searcher(box, friction=0.4), searcher(box, friction=0.8)
    weak, strong = (s.strengths(found.closings, LIFT) for s in (low, high))
    for a, b in zip(weak, strong, strict=True):
        assert (b >= a * 0.98 - 1e-4).all()
        assert b.mean() > 1.3 * a.mean()


def test_no_candidates_and_none_that_close(
    search: ClosureSearch, box: TriangleMesh, found: RankedCandidates
) -> None:
    nothing = search.evaluate(drawn(search, box).__class__(**_far(drawn(search, box))), LIFT)
    assert len(nothing) == 0
    assert nothing.tried == DRAWN
    rng = np.random.default_rng(0)
    assert len(search.refine(rng, nothing, LIFT, elite=4, children=2, rounds=2)) == 0
    assert len(search.steady(rng, nothing, LIFT)) == 0
    assert len(distinct(nothing, 5)) == 0
    assert same(merged(nothing, found), found)


def _far(s: DrawnCandidates) -> dict[str, object]:
    c = s.candidates
    away = Candidates(place=c.place + 1.0, turn=c.turn, start=c.start, mask=c.mask)
    return {"candidates": away, "plane": s.plane, "flip": s.flip, "value": s.value, "preshape": s.preshape}


# -- apart, near, refine, steady -----------------------------------------------------------------------


def test_what_stands_apart_really_does_and_nothing_better_is_left_out(found: RankedCandidates) -> None:
    from scipy.spatial.transform import Rotation

    least = 0.8
    rows = distinct(found, 12, least)
    assert len(rows) == 12
    assert rows[0] == 0
    assert (np.diff(rows) > 0).all()

    def distance(i: int, j: int) -> float:
        c = found.drawn.candidates
        a, b = (Rotation.from_quat(c.turn[k], scalar_first=True) for k in (i, j))
        return float(np.linalg.norm(c.place[i] - c.place[j]) / 0.02 + (a.inv() * b).magnitude() / 0.35)

    chosen = list(rows)
    assert min(distance(i, j) for i in chosen for j in chosen if i < j) >= least - 1e-6
    for i in range(chosen[-1]):
        if i not in chosen:
            assert min(distance(i, j) for j in chosen if j < i) < least + 1e-6


def test_children_turn_about_the_contacts(search: ClosureSearch, found: RankedCandidates) -> None:
    parents = found.take(np.arange(6))
    children = search.perturbed(np.random.default_rng(2), parents, 5, 0.0, shift=0.0, turn=0.3)
    assert len(children.candidates) == 30
    moved = 0.0
    for k in range(30):
        i = k // 5
        n = parents.closings.counts[i]
        middle = parents.closings.points[i, :n].mean(axis=0)
        old, new = parents.drawn.candidates, children.candidates
        inside = rotations(old.turn[i]).T @ (middle - old.place[i])  # in the palm frame
        assert np.allclose(new.place[k] + rotations(new.turn[k]) @ inside, middle, atol=1e-6)
        moved = max(moved, float(np.linalg.norm(new.place[k] - old.place[i])))
    assert moved > 0.01
    low, high = search.ranges
    wide = search.perturbed(np.random.default_rng(2), parents, 5, 50.0)
    assert (wide.candidates.start >= low).all()
    assert (wide.candidates.start <= high).all()


def test_refinement_never_makes_the_best_worse_and_mostly_better(
    search: ClosureSearch, found: RankedCandidates
) -> None:
    gains = []
    for seed in range(3):
        best = found.score[0]
        for rounds in range(3):
            refined = search.refine(
                np.random.default_rng(seed), found, LIFT, elite=8, children=4, rounds=rounds
            )
            assert refined.score[0] >= best - 1e-12
            assert (np.diff(refined.score) <= 0).all()
            best = refined.score[0]
        gains.append(best / found.score[0])
    assert max(gains) > 1.02
    assert refined.tried == DRAWN + 2 * 8 * 4


def test_steady_counts_half_of_what_is_lost_when_all_is_lost(
    search: ClosureSearch, found: RankedCandidates
) -> None:
    few = found.take(np.arange(10))
    rng = np.random.default_rng(0)
    nowhere = search.steady(rng, few, LIFT, shift=2.0)
    assert np.allclose(nowhere.score, few.score / 2)
    exact = search.steady(rng, few, LIFT, shift=0.0, turn=0.0)
    assert np.allclose(exact.score, few.score)
    shaken = search.steady(rng, few, LIFT)
    assert (np.diff(shaken.score) <= 0).all()
    assert shaken.score.mean() < few.score.mean()
    assert same(replace(shaken, score=few.score).take(np.arange(0)), few.take(np.arange(0)))


# -- the world's axes mean nothing ---------------------------------------------------------------------

ABOUT_Z = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
ABOUT_X = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


@pytest.mark.parametrize("Q", [ABOUT_Z, ABOUT_X @ ABOUT_Z], ids=["a quarter turn", "two of them"])
def test_a_rigid_motion_of_object_and_hands_changes_no_margin(
    search: ClosureSearch, box: TriangleMesh, found: RankedCandidates, Q: Array
) -> None:
    shift = np.array([0.3, -0.2, 0.1])
    moved = replace(box, vertices=box.vertices @ Q.T + shift)
    there = searcher(moved)
    assert np.allclose(there.cog, Q @ search.cog + shift, atol=2e-4)
    c = found.drawn.candidates
    turned = Candidates(
        place=c.place @ Q.T + shift, turn=quaternions(Q @ rotations(c.turn)), start=c.start, mask=c.mask
    )
    demand = Demand(
        direction=np.concatenate([Q @ LIFT.direction[:3], np.zeros(3)]),
        base=np.concatenate([Q @ np.asarray(LIFT.base)[:3], np.zeros(3)]),
    )
    closings = there.kernel.close(turned, wanted=2)
    closed = closings.fate == Fate.CLOSED
    assert closed.mean() > 0.97
    task, hold = there.strengths(closings, demand)
    score = there.score(task, hold, demand)[closed]
    before = found.score[closed]
    # The grid stands otherwise about the object, so a finger may touch a neighbouring edge instead.
    near = np.abs(score - before) <= 0.03 * before + 2e-3
    assert near.mean() > 0.9
    assert np.sort(score)[-20:].mean() == pytest.approx(np.sort(before)[-20:].mean(), rel=0.03)


def test_plain_holding_is_ranked_by_holding_alone(search: ClosureSearch, box: TriangleMesh) -> None:
    found = search.evaluate(drawn(search, box), PLAIN)
    assert np.array_equal(found.task, found.hold)
    assert (np.diff(found.hold) <= 0).all()


def test_a_longer_object_is_no_harder_to_push_and_harder_to_turn(
    search: ClosureSearch, found: RankedCandidates
) -> None:
    few, turning = found.closings.take(np.arange(40)), replace(LIFT, direction=np.array([0, 0, 1, 0.5, 0, 0]))
    strengths = {}
    for length in (LONGEST, 0.5):
        longer = ClosureSearch(search.hand, search.field, search.cog, length, search.settings)
        press = np.full(40, search.settings.middling)
        for name, demand in (("push", LIFT), ("turn", turning)):
            task, hold = longer.strengths(few, demand)
            strengths[name, length] = [task, hold, longer.thorough_strengths(few, demand, press)]
    for short, long in zip(strengths["push", LONGEST], strengths["push", 0.5], strict=True):
        assert short.max() > 0
        assert np.array_equal(short, long)
    turned = [strengths["turn", length][0] for length in (LONGEST, 0.5)]
    holds = turned[0] > 0
    assert holds.sum() >= 10
    assert (turned[1] < 0.5 * turned[0])[holds].all()
    shorter = ClosureSearch(search.hand, search.field, search.cog, LONGEST / 2, search.settings)
    assert (shorter.strengths(few, LIFT)[0] > 1.01 * strengths["push", LONGEST][0])[holds].all()
