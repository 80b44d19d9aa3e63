from __future__ import annotations

import io
import itertools
import os
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from preshape.exceptions import EnvironmentFailure, InputError
from preshape.hands.kinematics import LinkShape
from preshape.hiis.planes import plane
from preshape.objects.mesh import TriangleMesh
from preshape.viewer import colours, gallery, labels, plan_picture, shading, shapes
from preshape.viewer.camera import directions
from preshape.viewer.picture_file import write_png
from preshape.viewer.raycast import Camera, Shape, project, render, visible

WHITE = ((1.0, 1.0, 1.0), (1.0, 1.0, 1.0))
FRONT = Camera(eye=[0, -5, 0], target=[0, 0, 0], up=[0, 0, 1], fov=30.0)


def wall(y: float, colour: colours.Colour, alpha: float = 1.0, half: float = 0.5) -> Shape:
    return shapes.card([0, y, 0], [half, 0, 0], [0, 0, half], colour, alpha=alpha)


def brick(size: tuple[float, float, float] = (0.06, 0.05, 0.1), name: str = "brick") -> TriangleMesh:
    box = shapes.box([0.01, 0.02, 0.05], np.array(size) / 2, None, colours.OBJECT)
    return TriangleMesh(name=name, vertices=box.vertices, triangles=box.triangles)


def part(kind: str, p0: list[float], p1: list[float], radius: float, half: list[float]) -> LinkShape:
    arrays = {"p0": np.array(p0), "p1": np.array(p1), "half": np.array(half), "rotation": np.eye(3)}
    return LinkShape(kind=kind, link=kind, body=kind, radius=radius, **arrays)


def hand() -> tuple[LinkShape, ...]:
    return (
        part("box", [-0.1, 0.02, 0.05], [-0.1, 0.02, 0.05], 0, [0.01, 0.03, 0.03]),
        part("capsule", [-0.1, 0.05, 0.05], [-0.02, 0.06, 0.05], 0.008, [0, 0, 0]),
        part("sphere", [0.0, 0.055, 0.05], [0.0, 0.055, 0.05], 0.01, [0, 0, 0]),
    )


def card_of(index: int) -> plan_picture.PlaneCard:
    chosen = plane(index)
    return plan_picture.PlaneCard(
        index=index, approach_axis=chosen.approach_axis, opposition_axis=chosen.opposition_axis
    )


def scene(index: int = 5) -> plan_picture.PlanScene:
    mesh, chosen = brick(), card_of(index)
    a, o = chosen.approach_axis, chosen.opposition_axis
    half = np.abs(o) @ mesh.extents / 2
    points = np.array([mesh.cog + half * o, mesh.cog - half * o])
    normals = np.array([-o, o])
    return plan_picture.PlanScene(
        mesh=mesh,
        cog=mesh.cog,
        task_name="Q1",
        hand_name="utah_mit",
        task=[1, 1, 0.1, 0.05, 0.8, 0.05],
        status="success",
        reasons=("it fits",),
        plane=chosen,
        approach_value=-0.25,
        approach_set="RWD-L",
        aim=mesh.cog,
        points=points,
        normals_in=normals,
        fingers=("thumb", "index"),
        forces=normals + 0.45 * a,
        friction=1.0,
        ray_origins=points - 0.03 * normals,
        net_wrench=[0.9, 1.0, -0.2, 0.0, 0.8, 0.1],
        adi=[1, 1, 0.5, 1, 1, 0.5],
        figures=(("TFVADI of 6", "5.00"), ("stability of 6", "2")),
        hand=hand(),
        planes=tuple(card_of(i) for i in range(1, 13)),
    )


# --- camera -----------------------------------------------------------------------------------------------


def test_project_is_the_inverse_of_the_ray_directions() -> None:
    rng = np.random.default_rng(1)
    camera = Camera(eye=[1, -2, 0.7], target=[0.1, 0.2, 0], up=[0, 0.1, 1], fov=35.0)
    pixels = rng.uniform([0, 0], [640, 480], (200, 2))
    points = camera.eye + rng.uniform(0.5, 9, (200, 1)) * directions(camera, pixels, (640, 480))
    np.testing.assert_allclose(project(camera, points, (640, 480)), pixels, atol=1e-8)
    middle = project(camera, camera.target[None], (640, 480))
    np.testing.assert_allclose(middle, [[320, 240]], atol=1e-9)


def test_up_is_up_and_right_is_right() -> None:
    left_up = project(FRONT, np.array([[-1.0, 0.0, 1.0]]), (100, 100))[0]
    assert left_up[0] < 50
    assert left_up[1] < 50


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.5])
def test_framing_touches_the_border_and_cuts_nothing(aspect: float) -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        points = rng.normal(size=(30, 3)) * rng.uniform(0.01, 3, 3) + rng.normal(size=3)
        camera = Camera.framing(points, rng.normal(size=3), aspect=aspect, margin=1.0)
        seen = project(camera, points, (round(1000 * aspect), 1000)) / [1000 * aspect, 1000]
        assert seen.min() > -1e-6
        assert seen.max() < 1 + 1e-6
        reach = np.abs(seen - 0.5).max(axis=0)
        assert reach.max() == pytest.approx(0.5, abs=1e-6)  # no nearer camera would do
        assert np.ptp(seen, axis=0).max() > 0.97  # and the points are in the middle


def test_a_camera_that_looks_along_up_is_refused() -> None:
    with pytest.raises(InputError, match="up"):
        Camera(eye=[0, 0, 1], target=[0, 0, 0], up=[0, 0, 2])
    with pytest.raises(InputError, match="fov"):
        Camera(eye=[0, 1, 1], target=[0, 0, 0], up=[0, 0, 2], fov=180)


# --- render -----------------------------------------------------------------------------------------------


def test_a_spheres_silhouette_has_the_area_of_its_projected_disc() -> None:
    radius, distance, size = 0.8, 5.0, (400, 400)
    ball = replace(shapes.sphere([0, 0, 0], radius, (0, 0, 0)), lit=False)
    light = shading.to_linear(render([ball], FRONT, size, background=WHITE) / 255)[..., 0]
    focal = 200 / np.tan(np.radians(15))
    disc = np.pi * (focal * np.tan(np.arcsin(radius / distance))) ** 2
    sides = shapes.ROUND / (2 * np.pi) * np.sin(2 * np.pi / shapes.ROUND)  # of a polygon, not of a circle
    assert (1 - light).sum() == pytest.approx(disc, rel=0.01)
    assert (1 - light).sum() == pytest.approx(sides * disc, rel=0.004)


def test_an_edge_is_covered_in_proportion() -> None:
    square = wall(0, (0, 0, 0), half=0.503)
    image = render([square], FRONT, (301, 301), background=WHITE, samples=8)
    light = shading.to_linear(image / 255)[..., 0]
    corners = project(FRONT, square.vertices, (301, 301))
    assert (1 - light).sum() == pytest.approx(np.prod(np.ptp(corners, axis=0)), rel=2e-3)


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_the_nearest_opaque_shape_is_seen_whatever_the_order(order: tuple[int, ...]) -> None:
    things = [
        wall(0.0, (1, 0, 0), half=0.9),
        wall(-1.0, (0, 1, 0), half=0.4),
        wall(-2.0, (0, 0, 1), half=0.1),
    ]
    image = render([things[i] for i in order], FRONT, (99, 99), background=WHITE)
    for point, colour in (([0.7, 0, 0], 0), ([0.3, -1, 0], 1), ([0, -2, 0], 2)):
        x, y = project(FRONT, np.array([point]), (99, 99))[0].astype(int)
        assert image[y, x].tolist() == [255 * (k == colour) for k in range(3)]


def over(layers: list[tuple[colours.Colour, float]], ground: colours.Colour) -> np.ndarray:
    light = shading.to_linear(np.array(ground)).astype(float)
    for colour, alpha in layers:  # from the back to the front
        light = alpha * shading.to_linear(np.array(colour)) + (1 - alpha) * light
    return np.round(shading.to_display(light) * 255)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_cards_blend_exactly_and_by_depth(order: tuple[int, ...]) -> None:
    things = [
        wall(0.5, colours.GREEN, half=0.8),
        wall(0.0, colours.BLUE, 0.3),
        wall(-0.5, colours.ORANGE, 0.6),
    ]
    image = render([things[i] for i in order], FRONT, (41, 41), background=WHITE)
    wanted = over([(colours.BLUE, 0.3), (colours.ORANGE, 0.6)], colours.GREEN)
    assert np.abs(image[20, 20] - wanted).max() <= 1
    alone = render([things[1]], FRONT, (41, 41), background=WHITE)
    assert np.abs(alone[20, 20] - over([(colours.BLUE, 0.3)], (1, 1, 1))).max() <= 1


def test_an_opaque_card_shows_its_plain_colour_and_the_background_its_own() -> None:
    image = render([wall(0, colours.SKY)], FRONT, (41, 41), background=WHITE)
    assert image[20, 20].tolist() == [round(255 * c) for c in colours.SKY]
    assert image[0, 0].tolist() == [255, 255, 255]


def test_a_translucent_solid_covers_once() -> None:
    ball = replace(shapes.sphere([0, 0, 0], 0.5, colours.BLUE, alpha=0.4), lit=False)
    two = shapes.join([ball, replace(ball, vertices=ball.vertices * 0.5)])
    image = render([two], FRONT, (41, 41), background=WHITE)
    assert np.abs(image[20, 20] - over([(colours.BLUE, 0.4)], (1, 1, 1))).max() <= 1


def test_the_image_is_the_same_twice_and_does_not_move_with_the_scene() -> None:
    things = [shapes.object_shape(brick()), shapes.sphere([0.1, 0, 0.05], 0.02, colours.ORANGE, alpha=0.5)]
    points = np.concatenate([t.vertices for t in things])
    camera = Camera.framing(points, np.array([1, -1, 0.6]))
    one = render(things, camera, (120, 100), ground=0.0)
    assert one.shape == (100, 120, 3)
    assert one.tobytes() == render(things, camera, (120, 100), ground=0.0).tobytes()
    shift = np.array([3.0, -2.0, 7.0])
    moved = [replace(t, vertices=t.vertices + shift) for t in things]
    there = replace(camera, eye=camera.eye + shift, target=camera.target + shift)
    two = render(moved, there, (120, 100), ground=7.0)
    assert np.abs(one.astype(int) - two).mean() < 0.1


def test_the_floor_takes_shadow_only_under_the_object() -> None:
    ball = shapes.sphere([0, 0, 0.5], 0.5, colours.OBJECT)
    camera = Camera(eye=[0, -8, 4], target=[0, 0, 0.3], up=[0, 0, 1], fov=40.0)
    bare = render([ball], camera, (160, 160), background=WHITE)
    floor = render([ball], camera, (160, 160), background=WHITE, ground=0.0)
    x, y = project(camera, np.array([[0.25, -0.35, 0.0]]), (160, 160))[0].astype(int)
    assert floor[y, x].max() < 225 <= 250 < bare[y, x].min()
    assert floor[-1, 0].min() > 250  # far from it
    assert floor[0, 0].tolist() == bare[0, 0].tolist()  # above the horizon or nearly so


def test_a_hollow_is_darker_than_an_open_face() -> None:
    box = brick((1, 1, 1))
    # an open box: no lid; seen straight from above its floor is darker than the same face without walls
    lid = np.flatnonzero(box.normals[:, 2] > 0.5)
    open_box = shapes.object_shape(
        TriangleMesh(name="o", vertices=box.vertices, triangles=np.delete(box.triangles, lid, axis=0))
    )
    bottom = np.flatnonzero(box.normals[:, 2] < -0.5)
    face = shapes.object_shape(TriangleMesh(name="f", vertices=box.vertices, triangles=box.triangles[bottom]))
    camera = Camera(eye=[0.01, 0.02, 6], target=[0.01, 0.02, 0], up=[0, 1, 0], fov=20.0)
    inside, plain = (render([s], camera, (60, 60))[30, 30].astype(int) for s in (open_box, face))
    assert (inside < plain - 20).all()


def test_visible_tells_front_from_back() -> None:
    ball = shapes.sphere([0, 0, 0], 1.0, colours.OBJECT)
    points = np.array([[0, -1, 0], [0, 1, 0], [0, 0, 0], [2, 3, 0]])
    assert visible([ball], FRONT, points).tolist() == [True, False, False, True]
    assert visible([replace(ball, alpha=0.5)], FRONT, points).all()


def test_bad_shapes_and_pictures_are_refused() -> None:
    with pytest.raises(InputError, match="at least one shape"):
        render([], FRONT)
    with pytest.raises(InputError, match="one pixel"):
        render([wall(0, colours.SKY)], FRONT, (0, 5))
    with pytest.raises(InputError, match="index"):
        Shape(vertices=np.zeros((3, 3)), triangles=[[0, 1, 3]], colour=colours.SKY)
    with pytest.raises(InputError, match="alpha"):
        Shape(vertices=np.zeros((3, 3)), triangles=[[0, 1, 2]], colour=colours.SKY, alpha=1.5)
    with pytest.raises(InputError, match="finite"):
        Shape(vertices=np.full((3, 3), np.nan), triangles=[[0, 1, 2]], colour=colours.SKY)


# --- shading ----------------------------------------------------------------------------------------------


def test_light_coding_round_trips_every_grey() -> None:
    greys = np.arange(256) / 255
    assert np.round(shading.to_display(shading.to_linear(greys)) * 255).tolist() == list(range(256))


def test_hemisphere_is_cosine_weighted_in_every_aligned_block() -> None:
    table = shading.hemisphere(1024)
    np.testing.assert_allclose(np.linalg.norm(table, axis=1), 1)
    assert (table[:, 2] > 0).all()
    for block in table.reshape(16, 64, 3):  # mean of z under a cosine density is 2/3, of x and y 0
        np.testing.assert_allclose(block.mean(axis=0), [0, 0, 2 / 3], atol=0.03)


def test_tangents_make_right_handed_frames() -> None:
    normal = np.random.default_rng(3).normal(size=(500, 3))
    normal[0], normal[1] = [0, 0, 1], [0, 0, -1]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    x, y = shading.tangents(normal)
    np.testing.assert_allclose(np.cross(x, y), normal, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(x, axis=1), 1)


def test_smooth_normals_follow_a_sphere_but_keep_a_boxs_edges() -> None:
    ball = shapes.sphere([0, 0, 0], 1.0, colours.OBJECT)
    found = shading.corner_normals(
        ball.vertices.astype(np.float32), ball.triangles.astype(np.int32), smooth=True
    )
    assert (found * ball.vertices[ball.triangles]).sum(axis=2).min() > 0.995
    mesh = brick()
    box = mesh.vertices.astype(np.float32), mesh.triangles.astype(np.int32)
    sharp, flat = (shading.corner_normals(*box, smooth=smooth) for smooth in (True, False))
    np.testing.assert_allclose(sharp, flat, atol=1e-6)


# --- shapes -----------------------------------------------------------------------------------------------


def volume(shape: Shape) -> float:
    a, b, c = (shape.vertices[shape.triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def test_solids_are_closed_outward_and_of_the_right_size() -> None:
    r, length = 0.3, 2.0
    p, q = np.array([0.1, 0.2, 0.3]), np.array([0.1, 0.2, 0.3]) + length * np.array([2, -1, 2]) / 3
    ball = 4 / 3 * np.pi * r**3
    assert volume(shapes.sphere(p, r, colours.SKY)) == pytest.approx(ball, rel=0.02)
    assert volume(shapes.capsule(p, q, r, colours.SKY)) == pytest.approx(
        ball + np.pi * r**2 * length, rel=0.02
    )
    assert volume(shapes.box(p, [1, 2, 3], None, colours.SKY)) == pytest.approx(48)
    along = (shapes.capsule(p, q, r, colours.SKY).vertices - p) @ (q - p) / length
    assert along.min() == pytest.approx(-r)
    assert along.max() == pytest.approx(length + r)
    tip = shapes.arrow(p, q, 0.02, colours.SKY).vertices
    assert np.linalg.norm(tip - q, axis=1).min() < 1e-12


def test_a_friction_cone_opens_by_the_coefficient() -> None:
    apex = np.array([1.0, 2.0, 3.0])
    found = shapes.cone(apex, [0, 0, -2], 0.5, 0.7, colours.SKY, alpha=0.2).vertices - apex
    rim = found[np.linalg.norm(found, axis=1) > 1e-9]
    np.testing.assert_allclose(np.hypot(rim[:, 0], rim[:, 1]) / -rim[:, 2], 0.7)


def test_a_hand_of_unknown_parts_is_refused() -> None:
    with pytest.raises(InputError, match="'torus'"):
        shapes.hand_shape([replace(hand()[0], kind="torus", link="torus")])
    with pytest.raises(InputError, match="no shapes"):
        shapes.hand_shape([])


# --- labels -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", ["", "short", "a-name-without-any-blank" * 20, "many words " * 60, "日本 $x_1$ \n\t é"]
)
def test_wrapped_text_fits_and_loses_nothing_but_what_it_says(text: str) -> None:
    lines = labels.wrap(text, 200, 11, lines=4)
    assert len(lines) <= 4
    assert all(labels.text_width(line, 11) <= 200 for line in lines)
    whole = labels.wrap(text, 200, 11, lines=1000)
    assert "".join(whole).replace(" ", "") == labels.plain(text).replace(" ", "")
    assert (len(whole) > 4) == (bool(lines) and lines[-1].endswith("…"))


def test_labels_do_not_cover_each_other_or_leave_the_picture() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        anchors = rng.uniform([300, 300], [560, 560], (10, 2))  # a crowd
        boxes = rng.uniform([40, 20], [180, 50], (10, 2))
        low = labels.place(anchors, boxes, (870, 900))
        high = low + boxes
        assert low.min() >= 0
        assert (high <= [870, 900]).all()
        for i, j in itertools.combinations(range(10), 2):
            shared = np.minimum(high[i], high[j]) - np.maximum(low[i], low[j])
            assert shared.min() <= 0, (i, j)
        covered = (anchors[:, None] > low) & (anchors[:, None] < high)
        assert not covered.all(axis=2).any()


# --- pictures ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("index", [5, 12])
def test_a_plan_is_written_in_the_size_wanted(index: int, tmp_path: Path) -> None:
    target = tmp_path / "plan.png"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plan_picture.plan_picture(scene(index), target, size=(840, 540))
    with PIL.Image.open(target) as image:
        assert image.size == (840, 540)
        assert image.format == "PNG"
    assert os.listdir(tmp_path) == ["plan.png"]


def test_what_is_not_there_is_not_drawn_and_long_names_do_no_harm() -> None:
    nothing = plan_picture.PlanScene(
        mesh=brick(name="$a_name_" * 30),
        cog=[0.01, 0.02, 0.05],
        task_name="日本 " * 30,
        hand_name="h" * 300,
        task=np.zeros(6),
        status="deadlock " * 40,
        reasons=("because " * 200,) * 5,
    )
    wide = plan_picture.plan_image(nothing, size=(1000, 450))
    assert wide.shape == (450, 1000, 3)
    assert (wide[:, :100] == 255).all()  # the layout keeps its proportions
    small = plan_picture.plan_image(replace(nothing, task=[1e6, -1e6, 0, 1e-9, 3, 0]), size=(700, 450))
    assert small.shape == (450, 700, 3)
    with pytest.raises(InputError, match="700×450"):
        plan_picture.plan_image(nothing, size=(699, 450))


def test_the_same_plan_gives_the_same_bytes() -> None:
    files = [io.BytesIO(), io.BytesIO()]
    for file in files:
        plan_picture.plan_picture(scene(), file, size=(700, 450))
    assert files[0].getvalue() == files[1].getvalue()
    assert files[0].getvalue().startswith(b"\x89PNG")


def test_a_scene_of_fingers_without_contacts_is_refused() -> None:
    with pytest.raises(InputError, match="contacts"):
        replace(scene(), points=None)
    with pytest.raises(InputError, match="forces must be 2×3"):
        replace(scene(), forces=np.zeros((3, 3)))


def test_a_place_that_cannot_be_written_is_an_environment_failure(tmp_path: Path) -> None:
    image = np.zeros((4, 4, 3), np.uint8)
    with pytest.raises(EnvironmentFailure, match="no directory"):
        plan_picture.plan_picture(scene(), tmp_path / "none" / "plan.png")
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(EnvironmentFailure, match="other than a file"):
        write_png(image, tmp_path / "folder.png")
    with pytest.raises(InputError, match=r"\.png"):
        write_png(image, tmp_path / "plan.jpg")

    class Full(io.BytesIO):
        def write(self, data: object) -> int:
            raise OSError(28, "No space left on device")

    with pytest.raises(EnvironmentFailure, match="No space left"):
        write_png(image, Full())


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "plan.png"
    target.write_bytes(b"old")

    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(EnvironmentFailure, match="Permission denied"):
        write_png(np.zeros((4, 4, 3), np.uint8), target)
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["plan.png"]


def test_a_portrait_of_a_hand() -> None:
    image = gallery.portrait(shapes.hand_shape(hand()), (80, 60), (0.75, -0.55, 0.35))
    assert image.shape == (60, 80, 3)
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 20
