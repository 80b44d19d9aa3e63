"""The closure analyser: what it answers the controller, and that odd objects get a result, not a crash."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from preshape.closure.analyser import ClosureAnalyser, GripExploration
from preshape.closure.candidates import RankedCandidates, without_failed
from preshape.closure.demand import inner_centre
from preshape.closure.finish import FinishOptions
from preshape.closure.search import LIFTED
from preshape.closure.settings import FRICTION_SHARE, ClosureSettings, table_below
from preshape.exceptions import InputError
from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim, wrist_distance
from preshape.hiis.fuzzy import FuzzySets, approaching_degrees
from preshape.hiis.planes import APPROACH_AXES
from preshape.kernels.closing.host import Candidates, Obstacles
from preshape.kernels.field.host import prepare_field
from preshape.objects.library import load_library_object
from preshape.objects.mesh import TriangleMesh
from preshape.planning.controllers import layout_of
from preshape.tasks import parse_task
from preshape.types import Array, Attributes, Experience

pytestmark = pytest.mark.usefixtures("session_cache")
HAND = load_hand(str(Path(__file__).parent.parent / "examples" / "hands" / "trident.toml"))
VALUES = np.linspace(-0.9, 0.9, 19)
EVERYWHERE = Aim(values=VALUES)
SMALL = {"everywhere": 800, "on_plane": 400, "elite": 16, "children": 4, "rounds": 2, "finished": 6}
LIFT = parse_task("lift").q
PLAIN = np.array([0.1, 0.1, 0.1, 0.05, 0.05, 0.05])


def analyser(mesh: TriangleMesh, *, seed: int = 0, known: Any = tuple, **settings: Any) -> ClosureAnalyser:
    made = ClosureSettings(**{"threads": 1, **SMALL, **settings})
    return ClosureAnalyser(mesh, HAND, layout_of(HAND), settings=made, seed=seed, known=known)


def solid(name: str) -> TriangleMesh:
    return load_library_object(name)


@pytest.fixture(scope="module")
def sphere() -> ClosureAnalyser:
    return analyser(solid("sphere"))


@pytest.fixture(scope="module")
def found(sphere: ClosureAnalyser) -> GripExploration:
    grips = sphere.explore(LIFT, EVERYWHERE)
    assert isinstance(grips, GripExploration)
    assert len(grips) >= 3
    return grips


def poses(found: GripExploration) -> Array:
    return np.array([np.concatenate([g.palm_pose, g.squeeze]) for g in found.grips])


# -- the answer ----------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_grips_on_any_number_of_threads(found: GripExploration) -> None:
    again = analyser(solid("sphere"), threads=2).explore(LIFT, EVERYWHERE)
    assert isinstance(again, GripExploration)
    assert np.array_equal(poses(again), poses(found))
    other = analyser(solid("sphere"), seed=1).explore(LIFT, EVERYWHERE)
    assert isinstance(other, GripExploration)
    assert not np.array_equal(poses(other)[:1], poses(found)[:1])


def test_best_first_and_each_row_is_its_grip(sphere: ClosureAnalyser, found: GripExploration) -> None:
    assert (np.diff(found.match) <= 0).all()
    assert found.tried >= SMALL["everywhere"]
    for i, g in enumerate(found.grips):
        assert found.grasp(i) is g
        assert (found.plane[i], found.flip[i], found.fingers[i]) == (g.plane.index, g.flip, g.fingers)
        assert found.match[i] == g.judged == g.quality
        assert 0.0 <= g.quality <= 6.0
        assert 2 <= g.fingers <= 4
        assert -1.0 <= g.approach_value <= 1.0
    kept = found.where(np.array([2, 0]))
    assert isinstance(kept, GripExploration)
    assert (kept.grips[0], kept.grips[1]) == (found.grips[2], found.grips[0])
    assert len(found.where(found.match > 99)) == 0
    assert len(found.best_first()) == len(found)


def test_the_papers_match_is_computed_beside(found: GripExploration) -> None:
    for g in found.grips:
        adi = approaching_degrees(LIFT, g.net_wrench, FuzzySets())
        assert g.tfvadi == pytest.approx(float(adi.sum()))
        assert np.allclose(g.net_wrench, g.contacts.wrenches.sum(axis=0))


def test_the_thumb_is_on_the_side_that_the_answer_says(found: GripExploration) -> None:
    for g in found.grips:
        across = g.contacts.points[0] - g.contacts.points[1:].mean(axis=0)
        assert across @ g.thumb_side > 0


def test_an_aim_is_kept_to(sphere: ClosureAnalyser) -> None:
    for aim in (Aim(planes=[3], values=VALUES, flips=[True]), Aim(planes=[5, 8], values=VALUES, fingers=[2])):
        some = sphere.explore(LIFT, aim)
        assert len(some) > 0
        assert set(some.plane) <= set(aim.planes)
        assert set(some.flip) <= set(aim.flips)
    assert (some.fingers == 2).all()


def test_an_aim_is_worked_out_once(sphere: ClosureAnalyser, found: GripExploration) -> None:
    assert sphere.explore(LIFT, Aim(values=VALUES.copy())) is found
    assert sphere.explore(parse_task("turn").q, EVERYWHERE) is not found


@pytest.mark.parametrize(
    "wrong", [{"planes": (13,)}, {"planes": ()}, {"values": ()}, {"values": (1.5,)}, {"flips": ()}]
)
def test_a_wrong_aim_is_an_input_error(sphere: ClosureAnalyser, wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        sphere.explore(LIFT, Aim(**{"values": VALUES, **wrong}))


def test_a_wrong_task_is_refused(sphere: ClosureAnalyser) -> None:
    with pytest.raises(InputError):
        sphere.explore(np.full(6, np.nan), EVERYWHERE)


# -- what is asked of a grip ---------------------------------------------------------------------------


def test_the_demand_is_the_tasks_direction_and_minus_the_weight(sphere: ClosureAnalyser) -> None:
    lift = sphere.demand(LIFT)
    assert lift.direction is not None
    assert np.allclose(lift.direction, [0, 0, 1, 0, 0, 0])
    base = np.asarray(lift.base)
    assert base[2] > 0  # the hand must carry: upwards
    assert np.count_nonzero(base) == 1
    turn = sphere.demand(parse_task("turn:-x").q)
    assert turn.direction is not None
    assert np.allclose(turn.direction[:3], 0)
    assert turn.direction[3] < 0
    assert turn.load == pytest.approx(np.linalg.norm(turn.direction))
    assert sphere.demand(PLAIN).direction is None


def test_a_heavier_object_is_held_worse(sphere: ClosureAnalyser, found: GripExploration) -> None:
    heavy = analyser(solid("sphere"), mass=0.4).explore(LIFT, EVERYWHERE)
    assert len(heavy) > 0
    assert heavy.match[0] < found.match[0]


def test_plain_holding_has_answers(sphere: ClosureAnalyser) -> None:
    held = sphere.explore(PLAIN, EVERYWHERE)
    assert isinstance(held, GripExploration)
    assert len(held) > 0
    for g in held.grips:
        assert g.task_margin * 1.0 == pytest.approx(g.hold_margin * 0.7, rel=1e-5)


# -- grips recalled ------------------------------------------------------------------------------------


def test_a_grip_that_held_before_is_tried_again(found: GripExploration) -> None:
    """With hardly a draw of its own, the search finds the grip that was remembered; else nothing as good."""
    mesh, best = solid("sphere"), found.grips[0]
    grip = np.concatenate([best.palm_pose[:3] - mesh.cog, best.palm_pose[3:], [best.mask], best.start])
    remembered = Experience(
        kind="task",
        object_name="ball",
        hand=HAND.name,
        attributes=mesh.attributes,
        task=LIFT,
        plane=best.plane.index,
        flip=best.flip,
        approach_value=best.approach_value,
        approach_set=best.approach_set,
        fingers=best.fingers,
        wrench=best.net_wrench,
        match=best.tfvadi,
        grip=grip,
    )
    aim = Aim(planes=[best.plane.index], values=[best.approach_value])
    little = {"at_aim": 1, "elite": 3, "children": 1, "rounds": 0}
    recalled = analyser(mesh, known=lambda: [remembered], **little).explore(LIFT, aim)
    assert isinstance(recalled, GripExploration)
    assert len(recalled) >= 1
    pose = recalled.grips[0].palm_pose  # type: ignore[union-attr]
    assert np.allclose(pose, best.palm_pose, atol=1e-9)
    # Of another size it says nothing.
    other = replace(remembered, attributes=_sized(mesh, 2.0))
    assert len(analyser(mesh, known=lambda: [other], **little).explore(LIFT, aim)) == 0


def _sized(mesh: TriangleMesh, factor: float) -> Attributes:
    return replace(mesh, vertices=mesh.vertices * factor).attributes


# -- what cannot be executed ---------------------------------------------------------------------------


def test_hands_like_those_that_cannot_be_executed_are_not_refined_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    element = analyser(solid("sphere"), persistence=2, wraps=0, bold_share=FRICTION_SHARE)
    rounds: list[Candidates] = []

    def refuse(found: RankedCandidates, demand: object, options: FinishOptions) -> list[object]:
        if not options.anyway and not options.firm:
            rounds.append(found.drawn.candidates)
        return []

    monkeypatch.setattr(element.finisher, "finish", refuse)
    grips = element.explore(LIFT, EVERYWHERE)
    assert len(grips) == 0
    assert len(rounds) == 3
    for earlier, later in ((0, 1), (0, 2), (1, 2)):
        one, other = rounds[earlier], rounds[later]
        nearest = [
            wrist_distance(one.place, one.turn, place, turn).min()
            for place, turn in zip(other.place, other.turn, strict=True)
        ]
        assert np.mean(np.array(nearest) < 1.0) < 0.1


def test_beside_keeps_what_is_nearer_to_a_hand_that_can_be_executed(sphere: ClosureAnalyser) -> None:
    ranked = sphere.search.evaluate(
        sphere.draws.grips(np.random.default_rng(3), EVERYWHERE, 300), sphere.demand(LIFT)
    )
    looked_at = ranked.take(np.array([0, 1]))
    assert len(without_failed(ranked, looked_at, [0, 1])) == len(ranked)
    left = without_failed(ranked, looked_at, [0])
    wrists = ranked.drawn.candidates
    away = np.stack(
        [wrist_distance(wrists.place, wrists.turn, wrists.place[k], wrists.turn[k]) for k in (0, 1)]
    )
    kept = (away[1] >= 1.0) | (away[0] <= away[1])
    assert not kept[1]
    assert kept[0]
    np.testing.assert_array_equal(left.score, ranked.score[kept])


# -- odd objects ---------------------------------------------------------------------------------------


def test_a_scan_with_holes_is_held(found: GripExploration) -> None:
    mesh = solid("sphere")
    rng = np.random.default_rng(0)
    kept = mesh.triangles[rng.random(len(mesh.triangles)) > 0.08]
    holey = replace(mesh, triangles=kept, counts=None)
    grips = analyser(holey).explore(LIFT, EVERYWHERE)
    assert len(grips) >= 1
    assert grips.match[0] > 0.6 * found.match[0]


def test_a_mesh_wound_inside_out_is_held_as_well(found: GripExploration) -> None:
    mesh = solid("sphere")
    turned = analyser(replace(mesh, triangles=mesh.triangles[:, ::-1])).explore(LIFT, EVERYWHERE)
    assert isinstance(turned, GripExploration)
    assert turned.match[0] == pytest.approx(found.match[0], rel=0.05)
    for g in turned.grips:
        inward = mesh.cog - g.contacts.points
        assert (np.einsum("ni,ni->n", inward, g.contacts.normals_in) > 0).all()


@pytest.mark.parametrize("factor", [20.0, 1e4])
def test_far_too_large_is_no_grip_and_no_crash(factor: float) -> None:
    cube = solid("cube")
    large = replace(cube, vertices=cube.vertices * factor)
    grips = analyser(large, persistence=0, wraps=200).explore(LIFT, EVERYWHERE)
    assert len(grips) == 0
    assert grips.tried >= SMALL["everywhere"]


@pytest.mark.parametrize("factor", [1e-4, 0.01])
def test_what_fingers_cannot_be_placed_to_is_told_to_be_too_small(factor: float) -> None:
    cube = solid("cube")
    grips = analyser(replace(cube, vertices=cube.vertices * factor)).explore(LIFT, EVERYWHERE)
    assert len(grips) == 0
    assert f"{1e3 * factor * cube.extents.max():.2g} mm long" in grips.reason
    assert "check its unit" in grips.reason


def test_a_single_triangle_is_no_crash() -> None:
    flat = TriangleMesh(
        name="flat", vertices=np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0]]), triangles=[[0, 1, 2]]
    )
    analyser(flat, persistence=0, wraps=200).explore(LIFT, EVERYWHERE)


def test_where_the_object_stands_in_its_file_means_nothing(found: GripExploration) -> None:
    mesh, away = solid("sphere"), np.array([1.0, -2.0, 0.5])
    there = analyser(replace(mesh, vertices=mesh.vertices + away)).explore(LIFT, EVERYWHERE)
    assert isinstance(there, GripExploration)
    assert there.match[0] == pytest.approx(found.match[0], rel=0.05)
    for g in there.grips:
        assert np.linalg.norm(g.palm_pose[:3] - away) < 0.3


def test_the_centre_of_mass_is_that_of_the_solid() -> None:
    cone = solid("cone")
    field = prepare_field(cone, cache=None)
    low, high = cone.bounds[:, 2]
    centre = inner_centre(field, cone)
    assert centre[2] == pytest.approx(low + (high - low) / 4, abs=1e-3)
    assert abs(centre[2] - cone.cog[2]) > 0.01
    assert np.abs(centre[:2] - cone.cog[:2]).max() < 1e-3


def test_a_table_over_the_object_leaves_nothing() -> None:
    mesh = solid("sphere")
    covered = analyser(mesh, obstacles=table_below(float(mesh.vertices[:, 2].max()) + 0.3))
    assert len(covered.explore(LIFT, EVERYWHERE)) == 0


# -- settings ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("friction", 0.0),
        ("friction", float("nan")),
        ("friction", "0.6"),
        ("torsion", -0.01),
        ("friction_share", 1.2),
        ("mass", -1.0),
        ("safety", float("inf")),
        ("everywhere", 0),
        ("everywhere", 2.5),
        ("rounds", -1),
        ("threads", 0),
        ("press_least", 1e3),
        ("device", "abacus"),
    ],
)
def test_a_setting_out_of_range_is_an_input_error_that_names_it(name: str, given: object) -> None:
    with pytest.raises(InputError, match=name):
        ClosureSettings(**{name: given})  # type: ignore[arg-type]


def test_settings_say_what_is_planned_with() -> None:
    s = ClosureSettings(friction=0.5, torsion=0.01, friction_share=0.4, mass=0.2)
    assert (s.mu, s.gamma) == (pytest.approx(0.2), pytest.approx(0.004))
    assert s.weight == pytest.approx(0.2 * 9.81)
    assert table_below(0.02, "y").planes.tolist() == [[0.0, 1.0, 0.0, 0.02]]


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, -1.0, 0.0)])
def test_no_grip_is_drawn_from_below_a_table(up: tuple[float, ...]) -> None:
    """Half of them come from above, and none reaches further into the table than it can be lifted."""
    mesh = solid("hammer")
    table = Obstacles(planes=np.append(up, (mesh.vertices @ up).min())[None])
    element = analyser(mesh, obstacles=table)
    drawn = element.draws.grips(np.random.default_rng(0), EVERYWHERE, 400)
    rise = APPROACH_AXES[drawn.plane - 1] @ up
    assert len(drawn) > 40
    assert rise.max() < 0.5
    assert (rise < -0.5).mean() > 0.5
    hands, search = drawn.candidates, element.search
    apart = search.kernel.clearances(hands.place, hands.turn, hands.start, table)[1]
    assert apart.min() > -LIFTED
    # An aim from below stays what it is, and nothing is lost in free space.
    below = replace(EVERYWHERE, planes=[int(np.flatnonzero(APPROACH_AXES @ up > 0.9)[0]) + 1])
    assert list(element.draws.region(below).planes) == list(below.planes)
    assert list(analyser(mesh).draws.region(EVERYWHERE).planes) == list(EVERYWHERE.planes)
