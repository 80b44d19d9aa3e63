"""How objects rest on a table: tip angles by hand, settling of known shapes, and the library in MuJoCo."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from preshape import spatial
from preshape.exceptions import InputError, ObjectError
from preshape.objects.library import entry, load_library_object, names
from preshape.objects.mesh import UP_AXES, TriangleMesh, box_mesh
from preshape.objects.resting import (
    NEAREST,
    centre_of_mass,
    hull_points,
    settled,
    settled_up,
    support,
    turned_up,
    upright,
)

Z = np.array([0.0, 0.0, 1.0])
TALL = box_mesh("tall", np.array([0.02, 0.04, 0.12]))


def tilted(mesh: TriangleMesh, vector: tuple[float, float, float]) -> TriangleMesh:
    """The mesh after a rotation by a rotation vector [degrees]."""
    turn = spatial.rotation_from_vector(np.radians(vector))
    return replace(mesh, vertices=mesh.vertices @ turn.T)


def turn_of(up: np.ndarray) -> float:
    """Angle between a direction and +z [degrees]."""
    return math.degrees(math.acos(np.clip(up[2], -1, 1)))


def test_a_box_tips_over_its_narrow_side() -> None:
    stands = support(hull_points(TALL), centre_of_mass(TALL), Z)
    assert stands.tip_angle == pytest.approx(math.atan2(0.01, 0.06))
    assert stands.height == pytest.approx(0.06)
    assert np.abs(stands.outward) == pytest.approx([1, 0, 0])
    assert stands.edge[:, 2] == pytest.approx([-0.06, -0.06])
    assert np.abs(stands.edge[:, 0]) == pytest.approx([0.01, 0.01])


def test_the_mass_where_it_is_decides() -> None:
    heavy = replace(TALL, com=np.array([0.02, 0.0, 0.0]))
    assert centre_of_mass(heavy).tolist() == [0.02, 0, 0]
    assert support(hull_points(heavy), centre_of_mass(heavy), Z).tip_angle == pytest.approx(
        math.atan2(-0.01, 0.06)
    )
    assert settled_up(heavy, Z) == pytest.approx([-1, 0, 0], abs=1e-9)  # it fell towards +x
    assert settled_up(TALL, Z).tolist() == Z.tolist()


def test_the_centre_of_mass_of_a_solid_is_not_that_of_its_box() -> None:
    cone = load_library_object("cone")
    low, high = cone.bounds[:, 2]
    assert centre_of_mass(cone)[2] == pytest.approx(low + (high - low) / 4, rel=0.01)
    sheet = replace(TALL, triangles=TALL.triangles[:2])
    assert centre_of_mass(sheet) == pytest.approx(sheet.corners[0].mean(axis=0), abs=0.03)


@pytest.mark.parametrize(
    ("vector", "face"), [((0, 8, 0), Z), ((0, 25, 0), [1, 0, 0]), ((35, 0, 0), [0, 1, 0])]
)
def test_a_tilted_box_falls_on_the_side_that_it_leans_to(
    vector: tuple[float, float, float], face: np.ndarray
) -> None:
    leaning = tilted(TALL, vector)
    up = settled_up(leaning, Z)
    # In the box's own frame, the axis that is up is that of a face.
    own = spatial.rotation_from_vector(np.radians(vector)).T @ up
    assert np.abs(own) == pytest.approx(np.abs(face), abs=1e-6)
    assert up[2] > math.cos(math.radians(90))
    stands = support(hull_points(leaning), centre_of_mass(leaning), up)
    assert stands.tip_angle > math.radians(9)


def test_settling_lowers_the_centre_of_mass_and_ends_in_a_rest() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        points = rng.normal(size=(30, 3)) * [0.01, 0.02, 0.03]
        start = rng.normal(size=3)
        start /= np.linalg.norm(start)
        centre = points.mean(axis=0)
        up = settled(points, centre, start, least=0.0)
        before, after = (support(points, centre, u, 1e-7) for u in (start, up))
        assert after.height <= before.height + 1e-12
        assert after.tip_angle >= -1e-6
        assert np.linalg.norm(up) == pytest.approx(1.0)


def test_a_ball_does_not_roll_away_and_a_bumpy_base_is_a_base() -> None:
    assert settled_up(load_library_object("sphere"), Z).tolist() == Z.tolist()
    can = load_library_object("cylinder")
    rng = np.random.default_rng(0)
    bumpy = replace(can, vertices=can.vertices + rng.normal(0, 2e-4, can.vertices.shape))
    assert settled_up(bumpy, Z).tolist() == Z.tolist()


def test_a_pen_on_its_end_lies_down() -> None:
    assert turn_of(settled_up(load_library_object("pen"), Z)) == pytest.approx(90, abs=5)


@pytest.mark.parametrize("up", UP_AXES)
def test_upright_turns_the_axis_up(up: str) -> None:
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up.startswith("-") else 1.0
    R = upright(up)
    assert (R @ axis).tolist() == Z.tolist()
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert set(np.abs(R).ravel()) == {0.0, 1.0}


def test_turned_up_is_the_smallest_rotation() -> None:
    rng = np.random.default_rng(1)
    for up in [*rng.normal(size=(10, 3)), -Z, Z, np.array([1e-9, 0.0, 1.0])]:
        up = up / np.linalg.norm(up)
        R = turned_up(up)
        assert R @ up == pytest.approx(Z, abs=1e-9)
        assert np.linalg.norm(spatial.vector_from_rotation(R)) == pytest.approx(
            math.acos(np.clip(up[2], -1, 1)), abs=1e-6
        )


def test_bad_values() -> None:
    with pytest.raises(InputError, match="up must be one of x, y, z, -x, -y, -z"):
        upright("+z")
    with pytest.raises(ObjectError, match="up"):
        replace(TALL, up="w")
    with pytest.raises(ObjectError, match="rest"):
        replace(TALL, rest=np.zeros(4))
    with pytest.raises(ObjectError, match="com"):
        replace(TALL, com=np.zeros(2))
    assert replace(TALL, rest=np.array([2.0, 0, 0, 0])).rest.tolist() == [1, 0, 0, 0]  # type: ignore[union-attr]
    assert not TALL.same_as(replace(TALL, rest=np.array([1.0, 0, 0, 0])))
    assert not TALL.same_as(replace(TALL, com=np.zeros(3)))


@pytest.mark.parametrize("name", names())
def test_every_library_object_rests(name: str) -> None:
    mesh = load_library_object(name)
    assert mesh.rest == pytest.approx(entry(name).rest, abs=1e-4)
    up = spatial.rotation_from_quaternion(mesh.rest).T @ Z
    stands = support(hull_points(mesh), centre_of_mass(mesh), up, NEAREST)
    assert stands.tip_angle > math.radians(10)
    assert stands.height < 0.09


@pytest.mark.parametrize("name", names())
def test_every_library_object_stays_where_it_rests_in_physics(name: str) -> None:
    mesh = load_library_object(name)
    turn = spatial.rotation_from_quaternion(mesh.rest)
    points = (hull_points(mesh) - centre_of_mass(mesh)) @ turn.T
    low = float(points[:, 2].min())
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1], friction=[0.6, 0.02, 0.001])
    spec.add_mesh(name="hull", uservert=points.ravel())
    body = spec.worldbody.add_body(name="object", pos=[0, 0, -low + 2e-4])
    body.add_freejoint()
    # The mesh's frame is moved to the hull's own centre; its mass counts where the object's is.
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="hull", condim=6, friction=[0.6, 0.02, 0.001])
    size, mass = np.ptp(points, axis=0), 0.1
    body.explicitinertial = True
    body.mass, body.ipos = mass, [0, 0, 0]
    body.inertia = [mass / 12 * float((size**2).sum() - size[k] ** 2) for k in range(3)]
    spec.option.timestep = 0.002
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(750):
        mujoco.mj_step(model, data)
    moved = spatial.pose_from_seven(np.array(data.qpos))
    assert turn_of(moved[2, :3]) < 5.0
