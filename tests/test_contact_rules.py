"""Contact rules in the search: contacts are on the parts to hold, and no link is near a part to keep off."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import trimesh

from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.contact_places import ON_PART, SAMPLES, ContactPlaces, PartQuery, allowed_surface
from preshape.closure.finish import FinishOptions
from preshape.closure.hand_tables import hand_tables
from preshape.closure.keeping_off import BY_SPHERES, KeptOff
from preshape.closure.preshapes import preshapes
from preshape.closure.rules import KEEP_OFF, ContactRules
from preshape.closure.settings import ClosureSettings, table_below
from preshape.closure.wrap_search import best_wraps
from preshape.exceptions import InputError
from preshape.hands import load_hand
from preshape.hands.collision import ObjectCollision
from preshape.hands.kinematics import hand_geometry, move_shape
from preshape.hiis.analyser import Aim, Grip, HandLayout
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.kernels.field.host import prepare_field
from preshape.kernels.field.plain import closest_plain, field_distance
from preshape.objects.mesh import TriangleMesh
from preshape.objects.parts import PartSurface
from preshape.planner import plan
from preshape.planning.hand_simulation import simulate_hand
from preshape.tasks import parse_task
from preshape.types import Array

ALL = Aim(planes=range(1, 13), values=np.linspace(-0.8, 0.8, 9))
FAR = 2 * KEEP_OFF
QUICK = {"everywhere": 400, "persistence": 1, "rounds": 2, "elite": 12, "wraps": 0, "finished": 3}


class Case(NamedTuple):
    """An object, the parts to hold and to keep off, and a task."""

    mesh: TriangleMesh
    hold: tuple[PartSurface, ...]
    off: tuple[PartSurface, ...]
    table: bool = False

    @property
    def rules(self) -> ContactRules:
        return ContactRules(hold_on=self.hold, keep_off=self.off)


def mesh_of(solid: trimesh.Trimesh, name: str) -> TriangleMesh:
    return TriangleMesh(name=name, vertices=solid.vertices, triangles=solid.faces)


def cut(mesh: TriangleMesh, name: str, normal: tuple[float, ...], at: tuple[float, ...]) -> PartSurface:
    """The part of the surface in front of a plane, cut exactly there."""
    made = trimesh.intersections.slice_faces_plane(mesh.vertices, mesh.triangles, normal, at)
    return PartSurface(name=name, vertices=made[0], triangles=made[1])


@cache
def hammer() -> Case:
    """A handle of 110 mm with a square head on top."""
    handle = trimesh.creation.cylinder(radius=0.012, height=0.12, sections=20)
    head = trimesh.creation.box(
        (0.08, 0.024, 0.024), transform=trimesh.transformations.translation_matrix((0, 0, 0.06))
    )
    mesh = mesh_of(trimesh.boolean.union([handle, head]), "hammer")
    return Case(
        mesh,
        (cut(mesh, "handle", (0, 0, -1), (0, 0, 0.048)),),
        (cut(mesh, "head", (0, 0, 1), (0, 0, 0.048)),),
    )


@cache
def mug() -> Case:
    """A cup without a handle on a table: its outside may be held, its inside and rim may not."""
    profile = [(0, -45), (38, -45), (38, 45), (33.5, 45), (33.5, -40), (0, -40)]
    mesh = mesh_of(trimesh.creation.revolve(np.array(profile) * 1e-3, sections=24), "mug")
    space = trimesh.creation.cylinder(radius=0.0335, height=0.085, sections=24)
    space.apply_translation((0, 0, 0.0025))
    inside = PartSurface(name="inside", vertices=space.vertices, triangles=space.faces, solid=True)
    return Case(mesh, (), (inside, cut(mesh, "rim", (0, 0, 1), (0, 0, 0.043))), table=True)


@cache
def can() -> Case:
    """A cylinder of which only the upper half may be held."""
    mesh = mesh_of(trimesh.creation.cylinder(radius=0.02, height=0.14, sections=24), "can")
    return Case(mesh, (cut(mesh, "cap", (0, 0, 1), (0, 0, 0.01)),), ())


CASES = {"hammer": hammer, "mug": mug, "can": can}


@cache
def analyser(hand: str, name: str, seed: int = 0, **changed: Any) -> ClosureAnalyser:
    case = CASES[name]()
    table = {"obstacles": table_below(float(case.mesh.bounds[0, 2]))} if case.table else {}
    settings = ClosureSettings(**{**QUICK, "rules": case.rules, **table, **changed})
    layout = HandLayout(name=hand, u=0.045, finger_pitch=0.022, fingertip_width=0.016)
    return ClosureAnalyser(case.mesh, load_hand(hand), layout, settings=settings, seed=seed)


def distance(part: PartSurface, points: Array) -> Array:
    """(n,) distance of points from the triangles of a part [m], by comparing all with all."""
    corners, rows = part.vertices[part.triangles], len(part.triangles)
    least = np.full(len(points), np.inf)
    for some in np.array_split(np.arange(len(points)), 1 + len(points) * rows // 400_000):
        pairs = np.tile(corners, (len(some), 1, 1)), np.repeat(points[some], rows, axis=0)
        nearest = trimesh.triangles.closest_point(*pairs)
        least[some] = np.linalg.norm(nearest - pairs[1], axis=1).reshape(len(some), rows).min(axis=1)
    return least


def apart(part: PartSurface, points: Array) -> Array:
    """The same, -1 inside a convex volume, and without the points beyond ``FAR`` of the part's box."""
    corners = part.vertices[part.triangles].reshape(-1, 3)
    points = points[((points > corners.min(axis=0) - FAR) & (points < corners.max(axis=0) + FAR)).all(axis=1)]
    if not len(points):
        return np.array([np.inf])
    gap = distance(part, points)
    if part.solid:
        corners = part.vertices[part.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        inside = np.einsum("nmi,mi->nm", points[:, None] - corners[:, 0], normals) < 0
        gap[inside.all(axis=1)] = -1.0
    return gap


BALL = np.array(trimesh.creation.icosphere(1).vertices)


@cache
def spread(hand: str, index: int, count: int) -> Array:
    """(count + k, corners) weights of a link's corners in points all over its hull, and in its corners.

    They do not depend on where the link is, so a hull is sampled once.
    """
    pose = np.array([0, 0, 0, 1.0, 0, 0, 0])
    corners = hand_geometry(load_hand(hand), pose, load_hand(hand).posture("open"))[index].corners
    solid = trimesh.convex.convex_hull(corners)
    points, face = trimesh.sample.sample_surface(solid, count, seed=0)
    own = np.linalg.norm(solid.vertices[:, None] - corners, axis=2).argmin(axis=1)
    weights = np.zeros((count, len(corners)))
    shares = trimesh.triangles.points_to_barycentric(solid.triangles[face], points)
    np.add.at(weights, (np.arange(count)[:, None], own[solid.faces[face]]), shares)
    assert np.abs(weights @ corners - points).max() < 1e-6
    return np.concatenate([weights, np.eye(len(corners))[own]])


def surfaces(hand: str, pose: Array, q: Array, count: int = 150) -> Array:
    """Points of all links of a hand: all over their shapes, and their corners."""
    found = []
    for index, shape in enumerate(hand_geometry(load_hand(hand), pose, q)):
        if shape.kind in ("box", "hull"):
            found.append(spread(hand, index, count) @ shape.corners)
        else:
            along = shape.p0 + np.linspace(0, 1, 8)[:, None] * (shape.p1 - shape.p0)
            found.append((along[:, None] + BALL * shape.radius).reshape(-1, 3))
    return np.concatenate(found)


def links(hand: str, grip: Grip, share: float, back: float = 0.0) -> Array:
    """Points of the links of a hand between pregrasp (0) and grasp (1), moved back along its way in [m]."""
    q = grip.pregrasp + share * (grip.grasp - grip.pregrasp)
    pose = grip.palm_pose.copy()
    pose[:3] -= (back + (1 - share) * grip.back) * grip.approach
    return surfaces(hand, pose, q)


def obeys(hand: str, grip: Grip, case: Case) -> None:
    """Assert that a grip obeys the rules, by distances that nothing in the package computes."""
    points = grip.contacts.points
    if case.hold:
        assert np.min([distance(part, points) for part in case.hold], axis=0).max() < 0.0006
    ends = [links(hand, grip, share) for share in (1.0, 0.0)]
    # On the way, spheres are checked: half a millimetre and the error of the grid are allowed.
    way = [links(hand, grip, 0.0, back) for back in (0.02, 0.06, 0.12)]
    way += [links(hand, grip, share) for share in (0.3, 0.6, 0.9)]
    for part in case.off:
        assert apart(part, points).min() > KEEP_OFF
        assert all(apart(part, found).min() > KEEP_OFF - 1e-5 for found in ends), part.name
        assert all(apart(part, found).min() > KEEP_OFF - 5e-4 for found in way), part.name


@pytest.mark.parametrize("hand", ["shadow", "allegro", "leap"])
@pytest.mark.parametrize("name", list(CASES))
def test_every_grip_obeys(hand: str, name: str) -> None:
    """Answers and alternatives of all planes, and of one plane and one value, where the hand finds any."""
    case, found = CASES[name](), 0
    for seed in (0, 1):
        made = analyser(hand, name, seed)
        one = [Aim(planes=[1], values=ALL.values), Aim(planes=[3], values=[0.3])]
        for aim in [ALL, *(one if seed == 0 else ())]:
            for grip in made.explore(parse_task("lift").q, aim).grips:
                obeys(hand, grip, case)
                found += 1
    assert found >= 2


def test_the_rules_bind() -> None:
    """The same searches without rules break each of them, so the test above can fail."""
    for name, case in (("hammer", hammer()), ("mug", mug()), ("can", can())):
        made = analyser("shadow", name, rules=ContactRules())
        places = ContactPlaces(case.rules)
        drawn = made.draws.grips(np.random.default_rng(0), ALL, 600)
        found = made.search.evaluate(drawn, made.demand(parse_task("lift").q))
        broken = places.broken_by(found.closings.points, found.closings.counts)
        assert broken.any(axis=0).all(), name


@pytest.mark.parametrize("hand", ["shadow", "leap"])
def test_wraps_obey(hand: str) -> None:
    case, made = can(), analyser(hand, "can", wraps=1200)
    demand, options = made.demand(parse_task("lift").q), FinishOptions(count=4)
    rng = np.random.default_rng(0)
    wrapped, closed = best_wraps(made.search, made.draws, made.finisher, rng, ALL, demand, options)
    assert len(wrapped)
    assert closed.tally[4] > 0  # some were refused
    for grip in made.grips(parse_task("lift").q, wrapped):
        assert len(grip.contacts.points) >= 3
        obeys(hand, grip, case)


def test_a_small_part_is_drawn_as_densely_as_a_bare_one() -> None:
    """Candidates for a hammer held by its handle close as often as those for the handle alone."""
    case, made = hammer(), analyser("shadow", "hammer")
    bare = trimesh.creation.cylinder(radius=0.012, height=0.108, sections=20)
    bare.apply_translation((0, 0, -0.006))
    layout = HandLayout(name="shadow", u=0.045, finger_pitch=0.022, fingertip_width=0.016)
    alone = ClosureAnalyser(
        mesh_of(bare, "handle"), load_hand("shadow"), layout, settings=ClosureSettings(**QUICK)
    )
    shares = []
    for one in (made, alone):
        drawn = one.draws.grips(np.random.default_rng(0), ALL, 1500)
        clear = one.search.evaluate(drawn, one.demand(parse_task("lift").q))
        shares.append(int(clear.tally[2]))
    assert shares[0] > 0.5 * shares[1]
    assert len(made.draws.pincher.patches) > 0.6 * len(alone.draws.pincher.patches)
    assert not ContactPlaces(case.rules).broken(made.draws.pincher.patches.middle + 0.0).any(axis=1).all()


def test_allowed_points_are_spread_over_what_may_be_touched() -> None:
    case = hammer()
    tiny = cut(case.mesh, "end", (0, 0, -1), (0, 0, -0.058))  # 8 % of the surface
    for hold in (case.hold, (tiny,)):
        places = ContactPlaces(ContactRules(hold_on=hold, keep_off=case.off))
        allowed = allowed_surface(case.mesh, places)
        assert len(allowed) == SAMPLES
        assert distance(hold[0], allowed.points[::10]).max() <= ON_PART + 1e-6
        assert distance(case.off[0], allowed.points[::10]).min() >= KEEP_OFF
        box = np.stack([hold[0].vertices[hold[0].triangles].reshape(-1, 3).min(axis=0), allowed.box[1]])
        assert np.abs(allowed.box - box).max() < 0.002


def test_places_of_surfaces_and_volumes() -> None:
    """On a surface both sides are near; a volume has an inside."""
    sheet = PartSurface(name="sheet", vertices=[[0, 0, 0], [1, 0, 0], [0, 1, 0]], triangles=[[0, 1, 2]])
    ball = trimesh.creation.icosphere(2, radius=0.02)
    solid = PartSurface(name="ball", vertices=ball.vertices, triangles=ball.faces, solid=True)
    shell = PartSurface(name="ball", vertices=ball.vertices, triangles=ball.faces)
    at = np.array([[0.2, 0.2, 0.002], [0.2, 0.2, -0.002], [0.2, 0.2, 0.004]])
    assert ContactPlaces(ContactRules(keep_off=(sheet,))).broken(at)[:, 0].tolist() == [True, True, False]
    held = ContactPlaces(ContactRules(hold_on=(sheet,)))
    assert held.broken(at)[:, 0].tolist() == [True, True, True]
    assert held.broken(at, slack=0.002)[:, 0].tolist() == [False, False, True]
    at = np.array([[0.0, 0, 0], [0.0, 0, 0.0225], [0.0, 0, 0.024]])
    assert ContactPlaces(ContactRules(keep_off=(solid,))).broken(at)[:, 0].tolist() == [True, True, False]
    assert ContactPlaces(ContactRules(keep_off=(shell,))).broken(at)[:, 0].tolist() == [False, True, False]
    two = ContactPlaces(ContactRules(hold_on=(sheet, solid)))
    assert not two.broken(np.array([[0.0, 0, 0.01], [0.2, 0.2, 0.0]])).any()


def test_a_distance_field_without_sign_has_two_outsides() -> None:
    """A bowl that opens upwards: the field is the distance on both sides, above its opening too."""
    ball = trimesh.creation.icosphere(3, radius=0.03)
    part = cut(mesh_of(ball, "ball"), "bowl", (0, 0, -1), (0, 0, 0.01))
    bowl = TriangleMesh(name="bowl", vertices=part.vertices, triangles=part.triangles)
    field = prepare_field(bowl, cells=64, signed=False, cache=None)
    points = np.random.default_rng(0).uniform(-0.03, 0.03, (300, 3))
    exact = np.abs(closest_plain(bowl, points).distance)
    near = (exact < 0.01) & (exact > field.spacing)
    assert near.sum() > 60
    assert np.abs(field_distance(field, points) - exact)[near].max() < 0.5 * field.spacing
    assert field.distance.min() >= 0
    assert prepare_field(bowl, cells=64, cache=None).distance.min() < 0  # a sign would have one inside


@pytest.mark.parametrize("hand", ["shadow", "allegro", "utah_mit"])
def test_links_and_their_spheres_agree_about_nearness(hand: str) -> None:
    """Exact shapes are compared with dense samples of them, and the spheres see whatever is too near."""
    plate = trimesh.creation.box((0.3, 0.3, 0.02))
    part = PartSurface(name="plate", vertices=plate.vertices, triangles=plate.faces, solid=True)
    kept = KeptOff([PartQuery(part)], load_hand(hand), ClosureSettings())
    rng, n = np.random.default_rng(0), 40
    pool, tables = preshapes(load_hand(hand)).start, hand_tables(load_hand(hand))
    q, turn = pool[rng.integers(len(pool), size=n)], rng.normal(size=(n, 4))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    low, place = np.zeros(n), np.zeros((n, 3))
    for k in range(n):  # the hand's lowest point is 1 to 8 mm over the plate
        pose = np.concatenate([place[k], turn[k]])
        points = surfaces(hand, pose, q[k], 600)
        low[k] = 0.001 + 0.007 * k / n
        place[k] = [0, 0, 0.01 + low[k]] - points[points[:, 2].argmin()]
    exact = kept.exactly_near(place, turn, q)[:, 0]
    clear = np.abs(low - KEEP_OFF) > 3e-4  # a sample of a round shape misses its lowest point by less
    assert (exact == (low < KEEP_OFF))[clear].all()
    spheres = kept.near(place, turn, q)[:, 0]
    assert spheres[exact].all()
    assert not spheres[low > BY_SPHERES + 0.003].any()  # far from large spheres the grid has lower bounds
    assert kept.exactly_near(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), pool[:1]).all()
    assert len(tables.fingers)


def test_exact_distances_of_shapes() -> None:
    """A ball, a capsule, a box and a hull over a plane of triangles."""
    sheet = TriangleMesh(
        name="sheet",
        vertices=np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]]),
        triangles=np.array([[0, 1, 2], [0, 2, 3]]),
    )
    plane, seen = ObjectCollision(sheet), set()
    for hand in ("shadow", "leap", "utah_mit"):
        for shape in hand_geometry(
            load_hand(hand), np.array([0, 0, 0.4, 1.0, 0, 0, 0]), load_hand(hand).posture("open")
        ):
            low = float((shape.corners[:, 2]).min()) - shape.radius
            over = move_shape(shape, np.eye(3), np.array([0.0, 0, 0.003 - low]))
            assert plane.distance(over) == pytest.approx(0.003, abs=2e-6)
            seen.add(shape.kind)
    assert {"capsule", "box", "hull", "sphere"} == seen


def test_impossible_rules_say_what_each_cost() -> None:
    """Only the bottom of a blind hole may be held, which no finger reaches."""
    case = hammer()
    hole = ContactRules(hold_on=case.off, keep_off=(cut(case.mesh, "front", (0, -1, 0), (0, 0.005, 0)),))
    made = analyser("shadow", "hammer", rules=hole, everywhere=300, persistence=0)
    found = made.explore(parse_task("lift").q, ALL)
    assert not len(found)
    assert "against the rule to hold on head (" in found.reason
    assert "to keep off front (" in found.reason
    assert found.reason.endswith(
        "another part, or --rules none for rules that were not asked for, would help"
    )
    assert found.miss is not None
    assert found.miss.refused.startswith("it would break the rule to ")
    everything = ContactRules(keep_off=(cut(case.mesh, "all of it", (0, 0, 1), (0, 0, -1.0)),))
    none = analyser("shadow", "hammer", rules=everything).explore(parse_task("lift").q, ALL)
    assert (len(none), none.tried) == (0, 0)
    assert none.reason.startswith("the rules to keep off all of it leave no surface to touch; another part")


def test_a_weak_answer_says_what_the_rules_cost() -> None:
    made = analyser("shadow", "hammer", mass=3.0)
    q = parse_task("lift").q
    found = made.explore(q, ALL)
    said = made.shortfall(q, found.grips[0])
    tally = made._tallies[q.tobytes()]
    assert (
        f"of {tally[1]} hands that closed, {tally[4]} break the rule to hold on handle and {tally[5]}" in said
    )
    assert said.endswith("another part, or --rules none for rules that were not asked for, may help")
    assert "--rules" not in analyser("shadow", "hammer", mass=3.0, rules=ContactRules()).shortfall(
        q, found.grips[0]
    )


def test_what_the_memory_recalls_obeys_too(lesson: Callable[[str], Path]) -> None:
    """A hammer is taught freely, and then planned with rules: a recalled grip on its head is no answer."""
    case, where = hammer(), str(lesson("shadow"))
    small = ClosureSettings(**{**QUICK, "finished": 2})
    ask = partial(
        plan, case.mesh, "lift", hand="shadow", memory=where, closure=small, mass=0.1, count=2, table=None
    )
    free = ask()
    assert free.answer is not None
    ruled = ask(hold_on="z<0.048", keep_off="z>0.048")
    answers = [a for a in (ruled.answer, *ruled.alternatives, ruled.best) if a is not None]
    assert answers
    for answer in answers:
        if isinstance(answer.grasp, Grip) and not answer.grasp.refused:
            obeys("shadow", answer.grasp, case)


def test_rays_obey_and_count() -> None:
    case = can()
    hand = load_hand("utah_mit")
    layout = HandLayout(
        name="utah_mit", u=hand.u, finger_pitch=hand.finger_pitch, fingertip_width=hand.fingertip_width
    )
    aim = Aim(planes=range(1, 13), values=np.linspace(-0.8, 0.8, 9))
    free = RayAnalyser(case.mesh, layout).explore(parse_task("lift").q, aim)
    ruled = RayAnalyser(case.mesh, layout, rules=ContactPlaces(case.rules)).explore(parse_task("lift").q, aim)
    assert 0 < len(ruled) < len(free)
    for k in range(len(ruled)):
        assert distance(case.hold[0], ruled.grasp(k).contacts.points).max() < 0.0006
    # Exactly those that obey are left.
    lawful = [distance(case.hold[0], free.grasp(k).contacts.points).max() < 0.0005 for k in range(len(free))]
    assert sum(lawful) == len(ruled)
    nowhere = ContactRules(keep_off=(cut(case.mesh, "all of it", (0, 0, 1), (0, 0, -1.0)),))
    none = RayAnalyser(case.mesh, layout, rules=ContactPlaces(nowhere)).explore(parse_task("lift").q, aim)
    assert not len(none)
    assert none.reason.endswith(
        f"may touch it; refused were {len(free)} for the rule to keep off all of it: another part, "
        "or --rules none for rules that were not asked for, may help"
    )


def test_the_hand_on_a_virtual_grasp_keeps_off() -> None:
    case, hand = can(), load_hand("utah_mit")
    layout = HandLayout(
        name="utah_mit", u=hand.u, finger_pitch=hand.finger_pitch, fingertip_width=hand.fingertip_width
    )
    grasp = RayAnalyser(case.mesh, layout).explore(parse_task("lift").q, ALL).grasp()
    given: dict[str, Any] = {
        "approach_axis": grasp.plane.approach_axis,
        "opposition_axis": grasp.thumb_side,
        "contact_points": grasp.contacts.points,
        "normals_in": grasp.contacts.normals_in,
        "triangles": grasp.contacts.triangles,
    }
    assert simulate_hand(hand, case.mesh, **given).reached
    blocked = simulate_hand(hand, case.mesh, **given, kept_off=[case.mesh], room=KEEP_OFF)
    assert not blocked.reached
    assert "too near to a part to keep off" in blocked.reason


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"hold_on": "handle"}, "hold_on must be parts of an object"),
        ({"keep_off": (1,)}, "keep_off must be parts of an object"),
        (
            {"keep_off": (PartSurface(name="dot", vertices=np.zeros((3, 3)), triangles=[[0, 1, 2]]),)},
            "no surface",
        ),
        (
            {"hold_on": (PartSurface(name="nil", vertices=np.zeros((0, 3)), triangles=np.zeros((0, 3))),)},
            "the part nil has no surface; choose a larger region",
        ),
    ],
)
def test_bad_rules_are_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        ContactRules(**given)
    with pytest.raises(InputError, match="rules must be a value of ContactRules"):
        ClosureSettings(rules="none")  # type: ignore[arg-type]


def test_names_of_rules() -> None:
    case = hammer()
    assert case.rules.names == ("hold on handle", "keep off head")
    assert (len(case.rules), len(ContactRules())) == (2, 0)
    assert ContactRules(hold_on=(*case.hold, *case.off)).names == ("hold on handle or head",)
