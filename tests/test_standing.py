"""Where an object stands: the axes of a task under ``up``, rest on a table, poses in the mesh frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from preshape import spatial
from preshape.exceptions import InputError
from preshape.objects.library import load_library_object
from preshape.objects.mesh import UP_AXES, TriangleMesh, box_mesh
from preshape.objects.resting import upright
from preshape.planning.request import PlanRequest
from preshape.planning.standing import AUTO, standing, turned_task
from preshape.tasks import all_named_tasks, named_task, task_from_displacement, task_from_numbers
from preshape.tasks.displacement import full_motion

BOX = box_mesh("carton", np.array([0.03, 0.05, 0.12]))


def request(**changes: object) -> PlanRequest:
    made: dict[str, object] = {"source": BOX, "task": "lift", "hand": "shadow", "table": AUTO}
    return PlanRequest(**(made | changes))  # type: ignore[arg-type]


def turned(mesh: TriangleMesh, up: str) -> TriangleMesh:
    """The mesh as a file would have it whose ``up`` is up."""
    return replace(mesh, vertices=mesh.vertices @ upright(up))


@pytest.mark.parametrize("up", UP_AXES)
def test_the_same_object_with_another_axis_up_is_the_same_question(up: str) -> None:
    R = upright(up)
    for name in ("lift", "push:-x", "pour", "screw", "lever:-y"):
        usual, other = request(task=name), request(task=name, up=up, source=turned(BOX, up))
        mesh = turned(BOX, up)
        asked, now = usual.standing(BOX).task(usual.asked), other.standing(mesh).task(other.asked)
        assert full_motion(now)[:3, 3] @ R.T == pytest.approx(full_motion(asked)[:3, 3])
        turn, expected = (spatial.vector_from_rotation(full_motion(t)[:3, :3]) for t in (now, asked))
        assert R @ turn == pytest.approx(expected)
        assert R @ now.gravity == pytest.approx(asked.gravity)
        assert R @ other.task_gravity(mesh) == pytest.approx(usual.task_gravity(BOX))
        plane = other.obstacles(mesh).planes[0]
        assert [*(R @ plane[:3]), plane[3]] == pytest.approx(usual.obstacles(BOX).planes[0])


def test_absent_components_keep_their_values() -> None:
    for task in all_named_tasks():
        made = turned_task(task, upright("-y"))
        assert sorted(np.abs(made.q)) == pytest.approx(sorted(np.abs(task.q)))
        absent = np.isclose(task.q, [0.1] * 3 + [0.05] * 3)
        assert np.isclose(made.q, [0.1] * 3 + [0.05] * 3).sum() == absent.sum()
        assert turned_task(made, upright("-y").T).q == pytest.approx(task.q)


def test_words_numbers_and_displacements_are_turned_too() -> None:
    assert "along +Y, which is up" in turned_task(named_task("lift"), upright("y")).means
    numbers = turned_task(task_from_numbers("0 0 1 0 0 0.8"), upright("y"))
    assert numbers.q.tolist() == [0, 1, 0, 0, 0.8, 0]
    task = task_from_displacement(rotation=[0, 0, 0.5], translation=[0.01, 0, 0.02])
    made = turned_task(task, upright("y"))
    assert made.displacement is not None
    assert made.displacement[:3, 3] == pytest.approx([0.01, 0.02, 0])
    assert spatial.vector_from_rotation(made.displacement[:3, :3]) == pytest.approx([0, 0.5, 0])


def test_a_library_object_lies_as_the_library_says_and_other_tasks_keep_their_axes() -> None:
    hammer = load_library_object("hammer")
    asked = request(source="hammer")
    stands = asked.standing(hammer)
    assert stands.turned == pytest.approx(np.pi / 2, abs=0.05)
    assert not stands.settled
    plane = asked.obstacles(hammer).planes[0]
    heights = hammer.vertices @ plane[:3] - plane[3]
    assert heights.min() == pytest.approx(0.0, abs=1e-9)
    assert plane[:3] == pytest.approx([0, 1, 0], abs=0.03)
    world = spatial.pose_from_seven(stands.pose)
    assert world[:3, :3] @ plane[:3] == pytest.approx([0, 0, 1])
    lifted = stands.task(asked.asked)
    assert lifted.q[:3] == pytest.approx([0.1, 1, 0.1], abs=0.03)
    assert lifted.gravity == pytest.approx(-plane[:3])
    assert asked.task_gravity(hammer) == pytest.approx(-plane[:3])
    strike = request(source="hammer", task="strike")
    assert strike.standing(hammer).task(strike.asked) is strike.asked
    assert strike.task_gravity(hammer).tolist() == [0, 0, -1]
    sideways = request(source="hammer", task="lift:+x")
    assert sideways.standing(hammer).task(sideways.asked) is sideways.asked


def test_in_free_space_and_over_a_stated_table_the_object_is_as_modelled() -> None:
    hammer = load_library_object("hammer")
    assert request(table=None).standing(hammer).turned == 0.0
    over = request(table=-0.1).standing(hammer)
    assert over.turned == 0.0
    assert over.table is not None
    assert over.table.tolist() == [0, 0, 1, -0.1]
    assert request(table=-0.1, up="y").standing(hammer).table.tolist() == [0, 1, 0, -0.1]  # type: ignore[union-attr]
    with pytest.raises(
        InputError, match=r"the table at y = 0 m is above the lowest point of hammer, -0\.012 m"
    ):
        request(table=0.0, up="y").standing(hammer)


def test_what_is_stated_goes_before_what_is_found() -> None:
    pen = replace(load_library_object("pen"), rest=None)
    found = request().standing(pen)
    assert found.settled
    assert found.turned > 1.4
    stated = np.array([1.0, 0, 0, 0])
    assert request(rest=stated).standing(pen).turned == 0.0
    assert not request().standing(replace(pen, rest=stated)).settled
    lying = request(up="x").standing(replace(pen, rest=stated))  # up says how it stands; rest is for another
    assert lying.up[0] > 0.99
    slightly = replace(BOX, vertices=BOX.vertices @ spatial.rotation_from_vector(np.array([0.05, 0, 0])).T)
    assert request().standing(slightly).turned == 0.0


def test_a_scene_tells_rests_apart() -> None:
    hammer = load_library_object("hammer")
    scenes = {request(table=t).scene(hammer) for t in (None, AUTO, -0.1)} | {request(up="x").scene(hammer)}
    assert len(scenes) == 4
    assert request().scene(BOX) == "table 0 mm under the object"


def test_gravity_that_does_not_point_into_the_table_is_refused() -> None:
    assert request(gravity=(0, 0, -1)).obstacles(BOX).planes.shape == (1, 4)
    with pytest.raises(InputError, match="does not point into the table"):
        request(gravity=(1, 0, 0)).obstacles(BOX)
    # A task's own gravity acts after the lift.
    assert request(task="lift:+x").obstacles(BOX).planes.shape == (1, 4)
    assert request(gravity=(1, 0, 0), table=None).task_gravity(BOX).tolist() == [1, 0, 0]


def test_up_and_rest_are_in_the_request_and_older_requests_have_none() -> None:
    asked = request(source="pen", up="-y", rest=[0.6, 0.8, 0, 0])
    document = asked.to_json()
    assert PlanRequest.from_json(document).to_json() == document
    assert (document["up"], document["rest"]) == ("-y", [0.6, 0.8, 0, 0])
    old = {name: value for name, value in document.items() if name not in ("up", "rest")}
    read = PlanRequest.from_json(old)
    assert (read.up, read.rest) == (None, None)


def test_standing_of_a_mesh_with_y_up() -> None:
    gltf = replace(turned(BOX, "y"), up="y")
    assert standing(gltf, table=AUTO).up.tolist() == [0, 1, 0]
    assert standing(gltf, up="z", table=None).up.tolist() == [0, 0, 1]


def test_a_real_hand_plans_for_an_object_on_a_table_and_the_papers_hand_in_free_space() -> None:
    def table(**asked: object) -> object:
        return PlanRequest(source=BOX, task="lift", **asked).table  # type: ignore[arg-type]

    assert PlanRequest(source=BOX, task="lift").hand == "shadow"
    assert table() == AUTO
    assert table(hand="leap:left") == AUTO
    assert table(table=None) is None
    assert table(table="none") is None
    assert table(table=-0.3) == -0.3
    for words in (
        {"hand": "utah_mit"},
        {"hand": "utah_mit", "analyser": "closure"},
        {"hand": "shadow", "analyser": "rays"},
        {"gravity": [0, 1, 0]},  # a stated gravity is a scene of its own
    ):
        assert table(**words) is None
    free = PlanRequest(source=BOX, task="lift", table=None).to_json()
    assert PlanRequest.from_json(free, source=BOX).table is None
