"""Rules of tasks and objects: what is held, what stays free, and what a request makes of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from preshape.closure.contact_places import PartQuery
from preshape.closure.settings import ClosureSettings
from preshape.exceptions import InputError
from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim
from preshape.objects import library
from preshape.objects.mesh import TriangleMesh, box_mesh
from preshape.objects.parts import PartSurface, find_part, part_surface
from preshape.planning.controllers import closure_analyser
from preshape.planning.request import PlanRequest
from preshape.planning.rules import FAMILY_RULES, SUPPORT, task_rules
from preshape.planning.vessel import OVER, vessel
from preshape.tasks import FAMILIES, named_task

BLOCK = box_mesh("block", np.array([0.06, 0.04, 0.1]))
Z = np.array([0.0, 0.0, 1.0])
DOCS = Path(__file__).parent.parent / "docs" / "tasks.md"


def solid(part: PartSurface) -> trimesh.Trimesh:
    made = trimesh.Trimesh(part.vertices, part.triangles)
    assert made.is_watertight
    assert made.volume > 0  # outward
    return made


def cup(*, height: float = 0.08, wall: float = 0.003, dent: float = 0.0) -> TriangleMesh:
    """A square cup, open upwards; ``dent`` lowers one wall."""
    outer = trimesh.creation.box((0.06, 0.06, height))
    inner = trimesh.creation.box((0.06 - 2 * wall, 0.06 - 2 * wall, height))
    inner.apply_translation([0, 0, wall + 0.001])
    made = trimesh.boolean.difference([outer, inner], engine="manifold")
    if dent:
        notch = trimesh.creation.box((0.02, 0.02, 2 * dent))
        notch.apply_translation([0.03, 0, height / 2])
        made = trimesh.boolean.difference([made, notch], engine="manifold")
    return TriangleMesh(name="cup", vertices=np.array(made.vertices), triangles=np.array(made.faces))


def test_every_family_has_a_row_in_the_document_that_agrees_with_the_code() -> None:
    rows = {}
    for line in DOCS.read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| `") and len(cells) == 5:
            rows[cells[0].strip("`")] = cells[1:]
    assert set(rows) == set(FAMILIES) == set(FAMILY_RULES)
    for name, (axis, motion, load, rules) in rows.items():
        means = FAMILIES[name].means.replace("{", "").replace("}", "")
        said, _, weight = means.partition(" Load: ")
        assert (axis, motion, load) == (f"`{FAMILIES[name].axis}`", said, weight)
        assert rules == FAMILY_RULES[name]


# --- vessels ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("up", [Z, -Z, np.array([0, 1.0, 0])])
def test_the_inside_of_a_cup_is_found_whichever_way_it_is_up(up) -> None:
    mesh = cup()
    turn = trimesh.geometry.align_vectors(Z, up)[:3, :3]
    mesh = replace(mesh, vertices=mesh.vertices @ turn.T)
    found = vessel(mesh, up)
    assert found is not None
    volume = solid(found.inside)
    inner = 0.054 * 0.054
    # The volume stays 2.5 to 5 mm from the walls, and reaches 0.1 m above the rim.
    assert 0.7 * inner * (0.07 + OVER) < volume.volume < inner * (0.08 + OVER)
    top, bottom = (found.inside.vertices @ up).max(), (found.inside.vertices @ up).min()
    assert 0.04 + OVER - 0.005 < top < 0.04 + OVER + 0.01
    assert -0.04 + 0.004 < bottom < -0.04 + 0.014
    assert volume.contains([0.02 * up, 0.08 * up]).all()
    rim = found.rim.vertices @ up
    assert rim.max() == pytest.approx(0.04)
    assert rim.min() > 0.03


def test_no_contact_on_the_outside_of_a_thin_wall_is_within_three_millimetres() -> None:
    found = vessel(cup(wall=0.0012), Z)
    grid = np.meshgrid([0.03], np.linspace(-0.02, 0.02, 5), np.linspace(-0.03, 0.02, 6))
    outside = np.stack(grid, axis=-1).reshape(-1, 3)
    inside = PartQuery(found.inside)
    assert not inside.nearer(outside, 0.003).any()
    assert inside.nearer(outside - [0.0062, 0, 0], 0.0).all()  # 5 mm from the wall it is inside


def test_water_stands_no_higher_than_a_dent_in_the_rim() -> None:
    # A notch 20 mm deep and wide: the level is there, and the walls above it are not full.
    found = vessel(cup(dent=0.02), Z)
    assert found is not None
    assert found.rim.vertices[:, 2].min() < 0.022


@pytest.mark.parametrize("mesh", [BLOCK, replace(cup(), vertices=cup().vertices * [1, 1, -1])])
def test_a_block_and_an_upturned_cup_hold_no_water(mesh) -> None:
    assert vessel(mesh, Z) is None


def test_a_closed_cavity_is_not_open_upwards() -> None:
    inner = trimesh.creation.box((0.04, 0.02, 0.08))
    inner.invert()
    both = trimesh.util.concatenate([trimesh.Trimesh(BLOCK.vertices, BLOCK.triangles), inner])
    assert vessel(TriangleMesh(name="hollow", vertices=both.vertices, triangles=both.faces), Z) is None


# --- rules of the families -------------------------------------------------------------------------------


def names(mesh: TriangleMesh, task: str, **more) -> list[tuple[str, str, str]]:
    return [(r.kind, r.part, r.origin) for r in task_rules(mesh, named_task(task), **more).applied]


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_a_family_has_rules_for_a_bare_mesh_exactly_if_it_says_so(family) -> None:
    found = task_rules(cup() if family == "pour" else BLOCK, named_task(family))
    assert bool(found.applied) == (FAMILY_RULES[family] != "none")
    assert {rule.origin for rule in found.applied} <= {"task"}


@pytest.mark.parametrize(("axis", "a"), [("-z", [0, 0, -1]), ("+x", [1, 0, 0]), ("-y", [0, -1, 0])])
def test_insert_keeps_the_leading_end_and_the_space_in_front_free(axis, a) -> None:
    (part,) = task_rules(BLOCK, named_task(f"insert:{axis}")).contact.keep_off
    volume, a = solid(part), np.array(a, dtype=float)
    half = float(BLOCK.extents @ np.abs(a)) / 2
    limit = half - 0.15 * 2 * half
    assert (part.vertices @ a).min() == pytest.approx(limit)
    assert volume.contains([(limit + 0.001) * a, (half + 0.05) * a]).all()
    assert not volume.contains([(limit - 0.001) * a]).any()


def test_strike_keeps_only_the_swinging_half_of_a_stick_free_and_all_of_a_lying_one() -> None:
    (part,) = task_rules(BLOCK, named_task("strike:+x")).contact.keep_off
    assert part.vertices[:, 2].min() == pytest.approx(0.0)  # longest along z, which leads
    assert part.vertices[:, 0].min() == pytest.approx(0.03)  # the face; the sides do not face the strike
    lying = box_mesh("lying", np.array([0.06, 0.1, 0.04]))
    (part,) = task_rules(lying, named_task("strike:+x")).contact.keep_off
    assert np.ptp(part.vertices[:, 2]) == pytest.approx(0.04)


def test_a_file_that_is_inside_out_strikes_with_the_same_face() -> None:
    turned = replace(BLOCK, triangles=BLOCK.triangles[:, ::-1])
    (part,) = task_rules(turned, named_task("strike:+x")).contact.keep_off
    assert part.vertices[:, 0].min() == pytest.approx(0.03)


@pytest.mark.parametrize(("task", "down"), [("press", -Z), ("press:+x", np.array([1.0, 0, 0])), ("slide", -Z),
                                            ("roll", -Z)])  # fmt: skip
def test_nothing_is_below_the_supporting_plane(task, down) -> None:
    (part,) = task_rules(BLOCK, named_task(task)).contact.keep_off
    volume = solid(part)
    half = float(BLOCK.extents @ np.abs(down)) / 2
    assert part.name == SUPPORT
    assert (part.vertices @ down).min() == pytest.approx(half)
    sideways = np.roll(down, 1)
    assert volume.contains([(half + 0.001) * down + 0.15 * sideways]).all()


def test_a_table_is_the_supporting_plane() -> None:
    under = {"table": np.array([0, 0, 1, -0.05])}
    found = task_rules(BLOCK, named_task("press"), **under)
    assert not found.contact.keep_off
    assert [rule.table for rule in found.applied] == [True]
    # Another side is pressed, or the table is far below.
    assert len(task_rules(BLOCK, named_task("press:+x"), **under).contact.keep_off) == 1
    assert len(task_rules(BLOCK, named_task("press"), table=np.array([0, 0, 1, -0.2])).contact.keep_off) == 1


def test_rules_follow_the_turned_axes_of_the_task() -> None:
    # y is up: the task's -z is the mesh's -y.
    turn = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    (part,) = task_rules(BLOCK, named_task("insert"), turn=turn).contact.keep_off
    assert part.vertices[:, 1].min() < -0.15
    assert part.vertices[:, 1].max() == pytest.approx(-0.02 + 0.15 * 0.04)


# --- objects' own rules and the request's ----------------------------------------------------------------


def test_the_objects_own_rules_override_the_family() -> None:
    load = library.load_library_object
    assert names(load("hammer"), "strike") == [
        ("hold_on", "handle", "object"),
        ("keep_off", "head", "object"),
    ]
    assert names(load("bottle"), "unscrew") == [("hold_on", "cap", "object")]
    assert names(load("jar"), "screw") == [("hold_on", "lid", "object")]
    assert names(load("light_bulb"), "screw")[0] == ("hold_on", "bulb", "object")
    assert names(load("bolt"), "unscrew")[0] == ("hold_on", "head", "object")
    assert names(load("hammer"), "lift") == []
    bare = replace(load("hammer"), rules=())
    assert [origin for *_, origin in names(bare, "strike")] == ["task"]
    # A pan is held by its handle, and its inside stays free as that of any vessel.
    assert [row[::2] for row in names(load("pan"), "pour")] == [
        ("hold_on", "object"),
        ("keep_off", "task"),
        ("keep_off", "task"),
    ]


def test_what_is_asked_comes_on_top_and_none_leaves_it_alone() -> None:
    hammer = library.load_library_object("hammer")
    asked = {"hold_on": ["z<0"], "keep_off": ["claw"]}
    assert names(hammer, "strike", **asked) == [
        ("hold_on", "z < 0", "asked"),
        ("keep_off", "claw", "asked"),
        ("keep_off", "head", "object"),
    ]
    assert names(hammer, "strike", follow=False, **asked) == [
        ("hold_on", "z < 0", "asked"),
        ("keep_off", "claw", "asked"),
    ]
    assert names(hammer, "strike", follow=False) == []
    with pytest.raises(InputError, match="head cannot be held and kept off"):
        task_rules(hammer, named_task("lift"), hold_on=["head"], keep_off=["Head"])
    with pytest.raises(InputError, match="known: handle, head, face, claw"):
        task_rules(hammer, named_task("lift"), hold_on=["hadle"])


def test_a_request_keeps_its_rules_in_json_and_old_ones_have_none() -> None:
    asked = PlanRequest(
        source="mug", task="pour", hand="shadow", hold_on="handle", keep_off=["z<0", "rim"], table=None
    )
    document = asked.to_json()
    again = PlanRequest.from_json(document)
    assert (again.hold_on, again.keep_off, again.rules) == (("handle",), ("z<0", "rim"), "task")
    for name in ("hold_on", "keep_off", "rules"):
        del document[name]
    old = PlanRequest.from_json(document)
    assert (old.hold_on, old.keep_off, old.rules) == ((), (), "none")
    assert not old.rules_for(library.load_library_object("mug")).applied


def test_rules_are_part_of_the_scene_so_that_lessons_are_not_mixed() -> None:
    hammer = library.load_library_object("hammer")

    def scene(task: str, **more) -> str:
        return PlanRequest(source=hammer, task=task, hand="shadow", table="none", **more).scene(hammer)

    assert scene("lift") == ""
    assert scene("strike") == "hold on handle; keep off head"
    assert scene("strike", rules="none") == ""
    assert scene("lift", hold_on="handle", keep_off="head") == scene("strike")
    assert scene("lift", keep_off="head") != scene("lift", keep_off="face")
    rays = PlanRequest(source=hammer, task="strike", hand="utah_mit")
    assert rays.analyser == "rays"
    assert rays.scene(hammer) == scene("strike")


def test_a_box_may_be_given_as_numbers() -> None:
    asked = PlanRequest(source="hammer", task="lift", hold_on=[[-1, -1, -1, 1, 1, 0]])  # type: ignore[list-item]
    assert asked.hold_on == ("-1.0 -1.0 -1.0 1.0 1.0 0.0",)
    same = PlanRequest(source="hammer", task="lift", hold_on="-1 -1 -1 1 1 0")
    hammer = library.load_library_object("hammer")
    ours, theirs = (request.rules_for(hammer).applied for request in (asked, same))
    assert (
        [rule.words for rule in ours] == [rule.words for rule in theirs] == ["hold on the box -1 -1 -1 1 1 0"]
    )
    with pytest.raises(InputError, match="a box of six numbers, got 2 items"):
        PlanRequest(source="hammer", task="lift", keep_off=[[1, 2]])  # type: ignore[list-item]


def test_equal_rules_have_equal_keys() -> None:
    hammer = library.load_library_object("hammer")
    keys = [
        task_rules(hammer, named_task(task)).key for task in ("strike", "pull", "lift", "push", "strike:-x")
    ]
    assert keys[0] == keys[1] == keys[4]
    assert keys[2] == keys[3] != keys[0]
    bare = replace(hammer, rules=())
    one, other = (task_rules(bare, named_task(task)).key for task in ("strike", "strike:-x"))
    assert one != other


# --- end to end ------------------------------------------------------------------------------------------

EVERYWHERE = Aim(planes=range(1, 13), values=np.linspace(-0.8, 0.8, 9))


@pytest.mark.parametrize(
    ("name", "task"),
    [("hammer", "strike"), ("mug", "pour"), ("bottle", "unscrew"), ("bolt", "screw")],
)
def test_a_request_for_an_object_and_a_task_gives_grips_that_obey_its_rules(name, task) -> None:
    """From the names alone: parts of the library, rules, and what the search makes of them."""
    hand, mesh = load_hand("shadow"), library.load_library_object(name)
    small = ClosureSettings(everywhere=1200, wraps=300, persistence=0, rounds=1, elite=8)
    request = PlanRequest(source=mesh, task=task, hand=hand, table="none", search=small)
    found = closure_analyser(request, hand, mesh).explore(request.asked.q, EVERYWHERE)
    assert len(found.grips)
    part = {"hammer": "handle", "bottle": "cap", "bolt": "head"}.get(name)
    for grasp in found.grips:
        for point in grasp.contacts.points:
            if part is not None:
                on = part_surface(mesh, find_part(mesh, part))
                assert PartQuery(on).nearer(point[None], 0.001)[0]
            if name == "mug":  # neither inside nor on the rim
                assert point[2] < 0.04
                assert np.hypot(point[0] + 0.0154, point[1]) > 0.038 or point[2] < -0.04
