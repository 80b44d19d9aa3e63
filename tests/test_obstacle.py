"""Obstacles from files: where they stand, what is solid, and that the hand stays away from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from preshape import spatial
from preshape.closure.settings import ClosureSettings
from preshape.exceptions import InputError, ObjectError
from preshape.hands import load_hand
from preshape.hands.kinematics import hand_geometry
from preshape.objects.mesh import TriangleMesh, box_mesh
from preshape.objects.obstacle import REACH, PlacedFile, cube_edge, cubes, obstacle_surface, placed_file
from preshape.physics.task.instances import mesh_text
from preshape.planner import plan
from preshape.planning.request import PlanRequest
from preshape.planning.sizes import misplaced_obstacles

WALL = box_mesh("wall", np.array([0.02, 0.3, 0.3]))
NEAR = np.array([[-0.05, -0.05, -0.05], [0.05, 0.05, 0.05]])


def saved(folder: Path, mesh: TriangleMesh) -> str:
    file = folder / f"{mesh.name}.obj"
    file.write_text(mesh_text(mesh))
    return str(file)


def test_a_text_is_a_file_and_a_pose(tmp_path: Path) -> None:
    assert placed_file("wall.obj").T_object_file.tolist() == np.eye(4).tolist()
    placed = placed_file("a@b/wall.obj@0.1,-0.2,0.3,0,0,0,1")
    assert placed.file == "a@b/wall.obj"
    assert placed.T_object_file == pytest.approx(
        spatial.pose_from_seven(np.array([0.1, -0.2, 0.3, 0, 0, 0, 1.0]))
    )
    assert placed_file("a@b/wall.obj").file == "a@b/wall.obj"
    for text in ("wall.obj@1,2,3", "wall.obj@a,0,0,1,0,0,0", "wall.obj@0,0,0,0,0,0,0", "", "@0,0,0,1,0,0,0"):
        with pytest.raises(InputError, match="an obstacle is FILE or FILE@x,y,z,qw,qx,qy,qz"):
            placed_file(text)


def test_a_closed_mesh_is_solid_where_its_pose_puts_it(tmp_path: Path) -> None:
    turned = spatial.pose_from_seven(np.array([0.1, 0, 0, np.sqrt(0.5), 0, 0, np.sqrt(0.5)]))  # 90° about z
    found = obstacle_surface(PlacedFile(file=saved(tmp_path, WALL), T_object_file=turned), NEAR)
    assert found is not None
    assert found.solid
    assert found.name == "the obstacle wall.obj"
    assert np.ptp(found.vertices, axis=0) == pytest.approx([0.3, 0.02, 0.3])
    assert found.vertices.mean(axis=0) == pytest.approx([0.1, 0, 0])
    body = TriangleMesh(name="w", vertices=found.vertices, triangles=found.triangles)
    assert body.volume == pytest.approx(0.02 * 0.3 * 0.3)


def test_several_bodies_holes_and_what_is_far_away(tmp_path: Path) -> None:
    two = TriangleMesh(
        name="two",
        vertices=np.concatenate([WALL.vertices, WALL.vertices + np.array([0.2, 0, 0])]),
        triangles=np.concatenate([WALL.triangles, WALL.triangles + 8]),
    )
    found = obstacle_surface(placed_file(saved(tmp_path, two)), NEAR)
    assert found is not None
    assert (found.solid, len(found)) == (True, 24)
    open_box = replace(WALL, name="open", triangles=WALL.triangles[:-2])
    found = obstacle_surface(placed_file(saved(tmp_path, open_box)), NEAR)
    assert found is not None
    assert (found.solid, len(found)) == (False, 10)
    file = saved(tmp_path, WALL)
    away = REACH + 0.05
    assert obstacle_surface(placed_file(f"{file}@{away + 0.02},0,0,1,0,0,0"), NEAR) is None
    assert obstacle_surface(placed_file(f"{file}@{away},0,0,1,0,0,0"), NEAR) is not None
    with pytest.raises(ObjectError, match="no such file"):
        obstacle_surface(placed_file(str(tmp_path / "none.obj")), NEAR)


def test_points_fill_cubes_without_gaps(tmp_path: Path) -> None:
    grid = np.stack(np.meshgrid(np.arange(-20, 20), np.arange(-20, 20)), -1).reshape(-1, 2) * 0.004
    points = np.column_stack([np.full(len(grid), 0.12), grid])
    assert cube_edge(points) == pytest.approx(0.008)
    np.save(tmp_path / "scene.npy", np.concatenate([points, [[0, 0, 0], [np.nan] * 3, [9.0, 0, 0]]]))
    found = obstacle_surface(placed_file(str(tmp_path / "scene.npy")), NEAR)
    assert found is not None
    assert found.solid
    low, high = found.vertices.min(axis=0), found.vertices.max(axis=0)
    assert (low <= points.min(axis=0)).all()
    assert (high >= points.max(axis=0)).all()
    assert high[0] - low[0] == pytest.approx(0.008)
    body = TriangleMesh(name="w", vertices=found.vertices, triangles=found.triangles)
    assert body.volume == pytest.approx(float(np.prod(high - low)))  # one sheet of cubes, all outward


def test_cubes_of_any_points_are_closed_and_hold_them() -> None:
    points = np.random.default_rng(0).normal(size=(200, 3)) * 0.05
    vertices, triangles = cubes(points, 0.01)
    body = TriangleMesh(name="c", vertices=vertices, triangles=triangles)
    filled = len(np.unique(np.floor(points / 0.01), axis=0))
    assert body.volume == pytest.approx(filled * 0.01**3)
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all()


def test_the_request_keeps_them_and_the_scene_tells_them_apart(tmp_path: Path) -> None:
    file = saved(tmp_path, WALL)
    asked = PlanRequest(
        source="box", task="lift", hand="leap", obstacle=[f"{file}@0.1,0,0,1,0,0,0"], table=None
    )
    document = asked.to_json()
    assert document["obstacle"] == [f"{file}@0.1,0,0,1,0,0,0"]
    assert PlanRequest.from_json(document).to_json() == document
    assert PlanRequest.from_json({k: v for k, v in document.items() if k != "obstacle"}).obstacle == ()
    mesh = asked.load()
    scenes = {
        replace(asked, obstacle=o).scene(mesh) for o in ((), asked.obstacle, (f"{file}@0.12,0,0,1,0,0,0",))
    }
    assert len(scenes) == 3
    assert [part.name for part in asked.closure(mesh, 0.1).rules.keep_off] == ["the obstacle wall.obj"]
    with pytest.raises(InputError, match="here is rays"):
        PlanRequest(source="box", task="lift", hand="utah_mit", obstacle=file)


def test_the_hand_stays_away_from_a_wall(lesson: Callable[[str], Path], tmp_path: Path) -> None:
    file = saved(tmp_path, WALL)
    quick = ClosureSettings(everywhere=1200, elite=12, rounds=2, finished=4, persistence=0, wraps=0)
    hand = load_hand("allegro")
    made = plan(
        "box", "lift", hand="allegro", memory=lesson("allegro"), learn=False, closure=quick,
        obstacle=f"{file}@-0.07,0,0,1,0,0,0", table=None,
    )  # fmt: skip
    best = made.answer or made.best
    assert best is not None
    for pose in (best.hand_result.pregrasp, best.hand_result.grasp):
        assert pose is not None
        for part in hand_geometry(hand, pose.palm_pose, pose.q):
            reach = part.corners[:, 0].min() - part.radius
            beside = np.abs(part.corners[:, 1:]).min(axis=0) < 0.15
            assert reach > -0.06 or not beside.all()


def test_an_obstacle_that_is_far_away_or_overlaps_the_object_is_named(tmp_path: Path) -> None:
    box = box_mesh("carton", np.array([0.04, 0.05, 0.12]))
    file = saved(tmp_path, box)

    def words(pose: str) -> list[str]:
        return misplaced_obstacles(PlanRequest(source=box, task="lift", obstacle=file + pose), box)

    for pose, said in (("", "100% of the object's surface lies in"), ("@3,0,0,1,0,0,0", "more than 500 mm")):
        (sentence,) = words(pose)
        assert said in sentence
        assert file in sentence
    assert words("@0.041,0,0,1,0,0,0") == []
    assert words("@0,0,-0.1198,1,0,0,0") == []  # the object stands on it, 0.2 mm deep
