"""A depth camera's scene: reading, masks, the table, what is in the way, and a plan that keeps clear."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from hardening.clutter import depth_image, standing, touched
from PIL import Image

from preshape.cli import main as cli
from preshape.closure.settings import ClosureSettings
from preshape.exceptions import InputError, ObjectError
from preshape.objects.load import load_object
from preshape.objects.mesh import TriangleMesh
from preshape.objects.scans.scene import object_mask, read_npz, scene_parts, support
from preshape.planner import plan
from preshape.planning.request import PlanRequest

BODIES = [
    standing("cylinder", (0.0, 0.0), 0.3),
    standing("box", (0.1, 0.06), 0.5),
    standing("apple", (-0.02, -0.1), 0),
]
CAMERA = np.array([0.4, -0.45, 0.4])


@pytest.fixture(scope="module")
def arrays() -> dict[str, np.ndarray]:
    return depth_image(BODIES, CAMERA, np.random.default_rng(0))


@pytest.fixture(scope="module")
def scene(arrays: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("scene") / "table.npz"
    np.savez_compressed(file, **arrays)
    return file


def npz(**arrays: object) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def test_a_depth_image_becomes_points_where_they_are(arrays: dict[str, np.ndarray]) -> None:
    raw = read_npz("s", npz(**arrays))
    cloud = raw.in_metres(1.0)
    assert cloud.camera == pytest.approx(CAMERA)
    millimetres = {**arrays, "depth": 1000 * arrays["depth"]}  # the pose stays in metres
    assert read_npz("s", npz(**millimetres)).in_metres(0.001).points == pytest.approx(
        cloud.points, nan_ok=True
    )
    on_table = cloud.points[cloud.labels == 0]
    on_table = on_table[np.isfinite(on_table).all(axis=1)]
    assert np.abs(on_table[:, 2]).max() < 6 * 0.0007  # the noise along the rays
    body = cloud.points[cloud.labels == 1]
    assert (np.linalg.norm(body - BODIES[0].cog, axis=1) < np.linalg.norm(BODIES[0].extents)).all()
    assert len(cloud.points) == arrays["depth"].size  # pixels without an echo keep their places


def test_a_depth_in_millimetres_without_a_pose_is_in_the_camera_s_frame() -> None:
    depth = np.array([[0, 2000], [1000, 0]], dtype=np.uint16)
    K = np.array([[100, 0, 1], [0, 200, 0], [0, 0, 1]])
    cloud = read_npz("s", npz(depth=depth, intrinsics=K))
    assert cloud.echoes.tolist() == [[0.0, 0.0, 2000.0], [-10.0, 5.0, 1000.0]]
    assert cloud.camera is not None
    assert not cloud.camera.any()


@pytest.mark.parametrize(
    ("arrays", "word"),
    [
        ({"colour": np.zeros(3)}, "expected depth .* the file has 'colour'"),
        ({"depth": np.ones((4, 5))}, "expected depth"),
        ({"depth": np.ones((4, 5)), "K": np.eye(2)}, "K 3 × 3, got 4 × 5 and 2 × 2"),
        ({"depth": np.ones((4, 5)), "K": np.zeros((3, 3))}, "positive focal lengths"),
        ({"depth": np.ones((4, 5)), "K": np.eye(3), "T_world_camera": np.ones((4, 4))}, "must be a pose"),
        ({"depth": np.ones((4, 5)), "K": np.eye(3), "labels": np.ones(3)}, "labels are for 3 pixels"),
        ({"points": np.ones((4, 2))}, "n × 3, got 4 × 2"),
        ({"depth": np.array([["a"]]), "K": np.eye(3)}, "must be numbers"),
    ],
)
def test_a_file_that_is_no_scene_is_refused(arrays: dict[str, np.ndarray], word: str) -> None:
    with pytest.raises(ObjectError, match=word):
        read_npz("s.npz", npz(**arrays))
    for data in (b"", b"PK\x03\x04 cut short", npz(**arrays)[:40]):
        with pytest.raises(ObjectError, match="expected an NPZ file"):
            read_npz("s.npz", data)


def test_a_mask_is_a_label_or_a_file_of_any_of_two_kinds(
    arrays: dict[str, np.ndarray], scene: Path, tmp_path: Path
) -> None:
    cloud = read_npz("s", npz(**arrays))
    mask = arrays["labels"] == 1
    np.save(tmp_path / "m.npy", mask)
    Image.fromarray((255 * mask).astype(np.uint8)).save(tmp_path / "m.png")
    for text in ("1", str(tmp_path / "m.npy"), str(tmp_path / "m.png")):
        assert (object_mask("s", cloud, text) == mask.reshape(-1)).all()
    np.save(tmp_path / "small.npy", mask[1:])
    (tmp_path / "letter.png").write_bytes(b"\x89PNG and no more")
    for text, error, word in (
        ("9", InputError, "nothing has the label 9; there are 0, 1, 2, 3"),
        (str(tmp_path / "small.npy"), ObjectError, "307200, and this one has 479 × 640"),
        (str(tmp_path / "letter.png"), ObjectError, "a mask is a .npy or .png file"),
        ("gone.npy", ObjectError, "no such mask"),
    ):
        with pytest.raises(error, match=word):
            object_mask("s", cloud, text)
    bare = read_npz("s", npz(**{key: arrays[key] for key in ("depth", "K")}))
    with pytest.raises(InputError, match="has no labels"):
        object_mask("s", bare, "1")
    with pytest.raises(ObjectError, match="the mask leaves 0 points"):
        scene_parts("s", bare, np.zeros(len(bare.points), dtype=bool))
    assert scene.is_file()


def test_the_table_is_found_and_the_rest_is_neither_table_nor_object(arrays: dict[str, np.ndarray]) -> None:
    cloud = read_npz("s", npz(**arrays)).in_metres(1.0)
    found = scene_parts("s", cloud, np.asarray(cloud.labels) == 1)
    assert found.table == pytest.approx([0, 0, 1, 0], abs=1e-3)
    assert found.points[:, 2].min() > 0.0005
    assert found.rest[:, 2].min() > 0.0005
    own = BODIES[0]
    assert (np.linalg.norm((found.rest - own.cog)[:, :2], axis=1) > own.extents[0] / 2 - 0.002).all()
    near = [np.linalg.norm((found.rest - body.cog)[:, :2], axis=1).min() for body in BODIES[1:]]
    assert max(near) < 0.03  # both neighbours are there


def test_a_wall_is_no_table_and_a_mask_without_an_edge_is_refused(arrays: dict[str, np.ndarray]) -> None:
    cloud = read_npz("s", npz(**arrays)).in_metres(1.0)
    own = np.asarray(cloud.labels) == 1
    body = cloud.points[own]
    u, v = np.meshgrid(np.linspace(-0.2, 0.2, 90), np.linspace(0.0, 0.3, 90))
    away = -CAMERA * [1, 1, 0] / np.linalg.norm(CAMERA[:2])
    across = np.array([-away[1], away[0], 0.0])
    wall = BODIES[0].cog * [1, 1, 0] + 0.06 * away + u.reshape(-1, 1) * across + v.reshape(-1, 1) * [0, 0, 1]
    assert support(body, wall, CAMERA, np.array([0.0, 0.0, 1.0]))[0] is None
    assert support(body, wall, CAMERA)[0] is None  # it does not touch the wall
    labels = np.asarray(cloud.labels)
    shelf = cloud.points[(labels == 0) & (np.linalg.norm(cloud.points[:, :2], axis=1) < 0.06)][::4]
    found, _ = support(body, np.concatenate([wall, shelf]), CAMERA, np.array([0.0, 0.0, 1.0]))
    assert len(shelf) < 0.1 * len(wall)
    assert found == pytest.approx([0, 0, 1, 0], abs=2e-3)
    with pytest.raises(ObjectError, match="the mask takes in the table"):
        scene_parts("s", cloud, (np.asarray(cloud.labels) <= 1))


def test_a_guess_does_not_reach_below_the_table(scene: Path) -> None:
    for label, body in enumerate(BODIES, start=1):
        mesh = load_object(scene, mask=str(label))
        assert mesh.bounds[0, 2] > -1e-3
        assert np.abs(mesh.bounds - body.bounds).max() < 0.025
        assert mesh.scan is not None
        assert mesh.scan.table == pytest.approx([0, 0, 1, 0], abs=1e-3)


def test_a_plan_for_a_scene_stays_clear_of_what_really_stands_there(scene: Path) -> None:
    quick = ClosureSettings(everywhere=3000, finished=3)
    asked = {"hand": "leap", "memory": ":memory:", "learn": False, "closure": quick}
    made = plan(scene, "lift", mask=1, mass=0.2, **asked)  # type: ignore[arg-type]
    assert made.answer is not None, made.decision.reason
    assert made.standing.table == pytest.approx([0, 0, 1, 0], abs=1e-3)
    assert touched(made, BODIES[1:]) == []
    wall = TriangleMesh(  # the same hand would touch something that stands where it is
        name="wall",
        vertices=BODIES[0].vertices * [3, 3, 3] - 2 * BODIES[0].cog,
        triangles=BODIES[0].triangles,
    )
    assert touched(made, [wall]) == ["wall"]
    again = PlanRequest.from_json(made.request.to_json())
    assert again.mask == "1"
    assert again.scene(again.load()) == made.request.scene(made.mesh)


def test_the_command_line_takes_a_scene_in_place_of_an_object(
    scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = ["--task", "lift", "--memory", ":memory:", "--no-learn", "--json"]
    for words, said in (
        (["--scene", str(scene)], "--scene needs --mask"),
        (["cylinder", "--mask", "1"], "--mask needs --scene"),
        (["cylinder", "--scene", str(scene), "--mask", "1"], "not both"),
        ([], "OBJECT"),
        (["--scene", str(scene), "--mask", "7"], "nothing has the label 7"),
    ):
        assert cli.run(["plan", *words, *more]) == 2
        assert said in json.loads(capsys.readouterr().out)["reason"]
    with pytest.raises(InputError, match="a mask is for a point cloud"):
        load_object("cylinder", mask="1")
    with pytest.raises(InputError, match="leave cut_table out"):
        PlanRequest(source=str(scene), task="lift", mask="1", cut_table=True)
