"""Grips, checked by other means than those that made them: FCL on the true shapes, MuJoCo, conic programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pytest
from scipy.optimize import nnls

from preshape.closure.analyser import ClosureAnalyser
from preshape.closure.finish import quality
from preshape.closure.pressing import grip_forces, nonnegative_weights
from preshape.closure.settings import ClosureSettings
from preshape.hands.collision import ObjectCollision
from preshape.hands.hand import Hand
from preshape.hands.kinematics import (
    HandKinematics,
    LinkShape,
    compile_hand,
    finger_of,
    hand_geometry,
    move_shape,
    pose_matrix,
)
from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim, Grip
from preshape.kernels.closing.host import Candidates, Obstacles
from preshape.metrics import Contacts, ForceLimits, task_margin
from preshape.objects.library import load_library_object
from preshape.objects.mesh import TriangleMesh
from preshape.planning.controllers import layout_of
from preshape.tasks import parse_task
from preshape.types import Array

pytestmark = pytest.mark.usefixtures("session_cache")
TRIDENT = str(Path(__file__).parent.parent / "examples" / "hands" / "trident.toml")
VALUES = np.linspace(-0.9, 0.9, 19)
SMALL = {"everywhere": 1500, "elite": 32, "children": 4, "rounds": 2, "finished": 8, "threads": 1}
MM = 1e-3
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
SIDES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
SIDES += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]


class Case(NamedTuple):
    hand: Hand
    mesh: TriangleMesh
    analyser: ClosureAnalyser
    q: Array
    grips: tuple[Grip, ...]


def case(hand: str, mesh: TriangleMesh, task: str, **settings: Any) -> Case:
    model, asked = load_hand(hand), parse_task(task)
    made = ClosureSettings(**{**SMALL, **settings})
    analyser = ClosureAnalyser(mesh, model, layout_of(model), settings=made, gravity=asked.gravity)
    found = analyser.explore(asked.q, Aim(values=VALUES))
    return Case(model, mesh, analyser, asked.q, found.grips)


@pytest.fixture(scope="module")
def mug() -> Case:
    return case("shadow", load_library_object("mug"), "pour")


@pytest.fixture(scope="module")
def crowded() -> Case:
    """An upright cylinder on a table, with a wall beside it."""
    mesh = load_library_object("cylinder")
    low, high = mesh.bounds
    wall = [[high[0] + 0.1, -0.3, low[2]], [high[0] + 0.3, 0.3, 0.3]]
    obstacles = Obstacles(planes=np.array([[0.0, 0, 1, low[2]]]), boxes=np.array([wall]))
    return case("shadow", mesh, "lift", obstacles=obstacles)


@pytest.fixture(scope="module")
def trident() -> Case:
    return case(TRIDENT, load_library_object("sphere"), "turn")


@pytest.fixture(params=["mug", "crowded", "trident"])
def any_case(request: pytest.FixtureRequest) -> Case:
    made: Case = request.getfixturevalue(request.param)
    assert len(made.grips) >= 3
    return made


def backed(grip: Grip, way: float) -> Array:
    """The palm's pose that much before the end of the way in [m]."""
    pose = np.array(grip.palm_pose)
    pose[:3] -= way * grip.approach
    return pose


# -- where the hand is ---------------------------------------------------------------------------------


def test_at_the_grasp_nothing_is_in_the_object_and_every_finger_in_use_touches(any_case: Case) -> None:
    surface = ObjectCollision(any_case.mesh)
    for grip in any_case.grips:
        shapes = hand_geometry(any_case.hand, grip.palm_pose, grip.grasp)
        deep = [shape.link for shape in shapes if surface.touches(shape, -1.0 * MM)]
        assert not deep
        near = {finger_of(any_case.hand, shape) for shape in shapes if surface.touches(shape, 1.0 * MM)}
        assert set(grip.fingers_touching) <= near
        assert grip.fingers_touching[0] == any_case.hand.fingers[0].name
        assert len(set(grip.fingers_touching)) == len(grip.fingers_touching) >= 2


def test_the_pregrasp_is_clear_by_what_it_says(any_case: Case) -> None:
    surface = ObjectCollision(any_case.mesh)
    for grip in any_case.grips:
        shapes = hand_geometry(any_case.hand, grip.palm_pose, grip.pregrasp)
        assert not any(surface.touches(shape) for shape in shapes)
        # Boxes have their edges rounded off where the clearance is measured: up to two millimetres.
        least = max(0.0, grip.clearance - (0.3 * MM if no_boxes(shapes) else 2.0 * MM))
        assert not any(surface.touches(shape, least) for shape in shapes)
        assert grip.clearance > 0


def no_boxes(shapes: list[LinkShape]) -> bool:
    return all(shape.kind not in ("box", "hull") for shape in shapes)


def test_the_way_in_is_free_at_steps_other_than_the_kernels(any_case: Case) -> None:
    surface = ObjectCollision(any_case.mesh)
    kinematics = HandKinematics(any_case.hand)
    for grip in any_case.grips:
        assert np.linalg.norm(grip.approach) == pytest.approx(1.0)
        kinematics.set_posture(grip.pregrasp)
        shapes = kinematics.shapes()
        for way in np.arange(0.7 * MM, 0.118, 4.1 * MM):
            placed = pose_matrix(backed(grip, way))
            assert not any(surface.touches(move_shape(shape, *placed)) for shape in shapes), way


def test_the_fingers_close_through_free_space(any_case: Case) -> None:
    """The joints go straight from pregrasp to grasp, as a controller would move them."""
    surface = ObjectCollision(any_case.mesh)
    for grip in any_case.grips:
        for share in (0.13, 0.38, 0.61, 0.87):
            q = (1 - share) * grip.pregrasp + share * grip.grasp
            shapes = hand_geometry(any_case.hand, grip.palm_pose, q)
            assert not [shape.link for shape in shapes if surface.touches(shape, -1.0 * MM)]


def test_no_link_is_in_another_and_every_joint_within_its_limits(any_case: Case) -> None:
    kinematics = HandKinematics(any_case.hand)
    low, high = any_case.hand.limits.T
    for grip in any_case.grips:
        for q in (grip.pregrasp, grip.grasp):
            assert (q >= low - 1e-6).all()
            assert (q <= high + 1e-6).all()
            kinematics.set_posture(q)
            assert not kinematics.self_collisions(1.1 * MM)


def test_table_and_wall_are_kept_out_of(crowded: Case) -> None:
    obstacles = crowded.analyser.settings.obstacles
    height = obstacles.planes[0, 3]
    low, high = obstacles.boxes[0]
    wall = ObjectCollision(TriangleMesh(name="wall", vertices=low + CUBE * (high - low), triangles=SIDES))
    for grip in crowded.grips:
        postures = [(grip.palm_pose, grip.grasp), (grip.palm_pose, grip.pregrasp)]
        postures += [(grip.palm_pose, 0.5 * (grip.grasp + grip.pregrasp))]
        postures += [(backed(grip, way), grip.pregrasp) for way in np.arange(3 * MM, 0.118, 7.3 * MM)]
        for pose, q in postures:
            shapes = hand_geometry(crowded.hand, pose, q)
            assert min(lowest(shape) for shape in shapes) > height - 0.5 * MM
            assert not [shape.link for shape in shapes if wall.touches(shape, -0.5 * MM)]
            centres = np.array([(shape.p0 + shape.p1) / 2 for shape in shapes])
            assert not ((centres > low) & (centres < high)).all(axis=1).any()


def lowest(shape: LinkShape) -> float:
    """The lowest z of a shape [m], exactly."""
    return float(shape.corners[:, 2].min() - shape.radius)


# -- what the hand does --------------------------------------------------------------------------------


def test_contacts_lie_on_the_surface_where_the_finger_is(any_case: Case) -> None:
    surface = ObjectCollision(any_case.mesh)
    for grip in any_case.grips:
        shapes = hand_geometry(any_case.hand, grip.palm_pose, grip.grasp)
        contacts = grip.contacts
        assert len(contacts.points) == len(grip.fingers_touching) == len(grip.forces)
        assert np.allclose(np.linalg.norm(contacts.normals_in, axis=1), 1.0, atol=1e-6)
        for name, point, triangle in zip(
            grip.fingers_touching, contacts.points, contacts.triangles, strict=True
        ):
            assert surface.closest(point, 0.01)[0] < 0.2 * MM
            corners = any_case.mesh.corners[triangle]
            assert abs(float((point - corners[0]) @ any_case.mesh.normals[triangle])) < 0.05 * MM
            own = [shape for shape in shapes if finger_of(any_case.hand, shape) == name]
            assert min(distance(shape, point) for shape in own) < 1.0 * MM


def distance(shape: LinkShape, point: Array) -> float:
    """From a point to a shape's surface [m], negative inside; outside a hull at least that far."""
    if shape.hull is not None:
        planes = shape.hull.planes
        return float((planes[:, :3] @ (shape.rotation.T @ (point - shape.p0)) - planes[:, 3]).max())
    if shape.kind == "box":
        out = np.abs(shape.rotation.T @ (point - shape.p0)) - shape.half
        return float(np.linalg.norm(np.maximum(out, 0)) + min(out.max(), 0.0))
    axis = shape.p1 - shape.p0
    share = np.clip((point - shape.p0) @ axis / max(float(axis @ axis), 1e-18), 0, 1)
    return float(np.linalg.norm(point - shape.p0 - share * axis) - shape.radius)


def test_forces_are_in_their_cones_balance_and_sum_to_the_press(any_case: Case) -> None:
    settings = any_case.analyser.settings
    length = float(any_case.mesh.extents.max()) / 2
    for grip in any_case.grips:
        normals, points = grip.contacts.normals_in, grip.contacts.points
        pressing = np.einsum("ni,ni->n", grip.forces, normals)
        sliding = np.linalg.norm(grip.forces - pressing[:, None] * normals, axis=1)
        press = float(pressing.sum())
        assert (pressing >= 0).all()
        assert (sliding <= settings.friction * settings.friction_share * pressing + 1e-6).all()
        assert 0 < press <= settings.press_most * (1 + 1e-6)
        net = grip.forces.sum(axis=0)
        turning = np.cross(points - points.mean(axis=0), grip.forces).sum(axis=0) / length
        assert np.hypot(np.linalg.norm(net), np.linalg.norm(turning)) < 0.05 * press
        # Every finger that is counted does something.
        assert pressing[0] > 0.1 * press


def test_torques_are_the_virtual_work_of_the_forces(any_case: Case) -> None:
    """A joint moved a little moves each contact's link; force times that way is the torque's work."""
    data = mujoco.MjData(compile_hand(any_case.hand))
    joints = list(any_case.hand.joints)
    for grip in any_case.grips:
        R, t = pose_matrix(grip.palm_pose)
        shapes = hand_geometry(any_case.hand, grip.palm_pose, grip.grasp)
        work = np.zeros(len(joints))
        for name, point, force in zip(grip.fingers_touching, grip.contacts.points, grip.forces, strict=True):
            own = [shape for shape in shapes if finger_of(any_case.hand, shape) == name]
            body = min(own, key=lambda shape: distance(shape, point)).body
            step = 1e-5
            local, carried = R.T @ (point - t), any_case.hand.columns(name)
            for j in range(carried.start, carried.stop):
                there = [moved(data, body, grip.grasp, j, move, local) for move in (step, -step)]
                work[j] += (R.T @ force) @ (there[0] - there[1]) / (2 * step)
        assert grip.torques == pytest.approx(work, abs=0.01 * np.abs(work).max())
        drive = any_case.hand.rates(grip.grasp).T @ grip.torques
        assert (np.abs(drive) <= any_case.hand.torque_limits * (1 + 1e-6)).all()


def moved(data: mujoco.MjData, body: str, q: Array, joint: int, step: float, point: Array) -> Array:
    """Where a point of the palm frame, fixed to a body, goes when one joint moves."""
    data.qpos[:] = q
    mujoco.mj_kinematics(data.model, data)
    there = data.body(body)
    inside = there.xmat.reshape(3, 3).T @ (point - there.xpos)
    data.qpos[joint] += step
    mujoco.mj_kinematics(data.model, data)
    return np.asarray(there.xmat.reshape(3, 3) @ inside + there.xpos)


def test_the_servos_told_to_squeeze_make_these_torques(any_case: Case) -> None:
    hand = any_case.hand
    for grip in any_case.grips:
        pull = hand.controls(grip.squeeze) - hand.controls(grip.grasp)
        assert hand.gains * pull == pytest.approx(hand.rates(grip.grasp).T @ grip.torques, abs=1e-6)


# -- what it is worth ----------------------------------------------------------------------------------


def test_margins_are_what_the_press_can_balance(any_case: Case) -> None:
    analyser, settings = any_case.analyser, any_case.analyser.settings
    demand = analyser.demand(any_case.q)
    agree = 0
    for grip in any_case.grips:
        press = float(np.einsum("ni,ni->", grip.forces, grip.contacts.normals_in))
        contacts = Contacts(
            positions=grip.contacts.points,
            normals_in=grip.contacts.normals_in,
            friction=settings.friction * settings.friction_share,
            torsion=settings.torsion * settings.friction_share,
            reference=analyser.search.cog,
            length=analyser.search.length,
        )
        assert demand.direction is not None
        load = -np.asarray(demand.base) * press
        exact = task_margin(contacts, demand.direction, ForceLimits(total=press), load=load).number
        expected = (exact or 0.0) / demand.load / settings.weight
        assert grip.task_margin <= 1.08 * expected + 0.02
        agree += abs(grip.task_margin - expected) < 0.05 * expected + 0.02
        # Softness takes only from what is above 3; a stronger press only adds.
        assert grip.quality >= min(quality(min(grip.task_margin, grip.hold_margin)), 3.0) - 1e-6
    assert agree >= 0.6 * len(any_case.grips)


def test_quality_is_three_at_just_enough_and_grows_with_the_margin() -> None:
    margins = np.linspace(0, 12, 200)
    judged = np.array([quality(m) for m in margins])
    assert quality(1.0) == pytest.approx(3.0)
    assert quality(0.0) == 0.0
    assert (np.diff(judged) > 0).all()
    assert judged.max() <= 6.0


def test_two_opposite_contacts_press_straight_at_each_other() -> None:
    arms = np.array([[0.5, 0, 0], [-0.5, 0, 0]])
    forces = grip_forces(arms, np.array([[-1.0, 0, 0], [1, 0, 0]]), 0.3)
    assert forces == pytest.approx(np.array([[-0.5, 0, 0], [0.5, 0, 0]]), abs=5e-3)


def test_forces_of_a_hopeless_grip_show_that_they_do_not_balance() -> None:
    """Two contacts that press the same way: no forces balance, and none are made up."""
    arms = np.array([[0.5, 0.1, 0], [0.5, -0.1, 0]])
    forces = grip_forces(arms, np.array([[-1.0, 0, 0], [-1, 0, 0]]), 0.3)
    assert np.linalg.norm(forces.sum(axis=0)) > 0.5


def test_weights_are_those_of_scipy() -> None:
    """Nonnegative least squares over random problems of all kinds, those with columns of zeros among them."""
    rng = np.random.default_rng(1)
    for _ in range(300):
        n = int(rng.integers(1, 41))
        rows = np.concatenate([10 * rng.normal(size=(7, n)), rng.choice([0.03, 0.6]) * np.eye(n)])
        rows[:, rng.random(n) < rng.choice([0.0, 0.3])] = 0.0
        wanted = np.concatenate([rng.normal(size=7) * rng.choice([1.0, 10.0]), np.full(n, 0.01)])
        exact = nnls(rows.copy(), wanted.copy())[0]
        assert nonnegative_weights(rows, wanted) == pytest.approx(exact, abs=1e-9 * max(1.0, exact.max()))


@pytest.mark.parametrize("seed", range(5))
def test_forces_turn_and_balance_with_the_scene(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 3 + seed % 3
    arms = rng.normal(size=(count, 3))
    arms[0] = -arms[1:].sum(axis=0)
    arms /= np.linalg.norm(arms, axis=1, keepdims=True)
    forces = grip_forces(arms, -arms, 0.5)
    normal = np.einsum("ni,ni->n", forces, -arms)
    tangential = np.linalg.norm(forces + normal[:, None] * arms, axis=1)
    assert normal.sum() == pytest.approx(1.0, abs=1e-9)
    assert (tangential <= 0.5 * normal + 1e-9).all()
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    Q *= np.sign(np.linalg.det(Q))
    turned = grip_forces(arms @ Q.T, -arms @ Q.T, 0.5)
    # Eight edges stand otherwise about each normal: the cone is the same but for 8 %.
    assert turned == pytest.approx(forces @ Q.T, abs=0.08)


def test_hands_that_cannot_open_are_no_error(mug: Case) -> None:
    finisher, middle = mug.analyser.finisher, mug.mesh.cog
    inside = Candidates(  # palms in the middle of the object
        place=np.tile(middle, (3, 1)),
        turn=np.tile([1.0, 0, 0, 0], (3, 1)),
        start=np.zeros((3, len(mug.hand.joints))),
        mask=np.full(3, 31),
    )
    grasp = np.tile(mug.hand.at(1.0), (3, 1))
    for rows in (np.arange(3), np.zeros(0, dtype=np.int64)):
        assert len(finisher.opener.find(inside, grasp, rows, np.ones(3, dtype=np.int64), range(1, 13))) == 0


def test_a_rod_of_a_metre_is_lifted_at_its_middle() -> None:
    vertices = (CUBE - 0.5) * [0.018, 0.018, 1.0]
    rod = TriangleMesh(name="rod", vertices=vertices, triangles=np.array(SIDES))
    best = case("shadow", rod, "lift", mass=0.1).grips[0]
    assert min(best.task_margin, best.hold_margin) > 1.0
    assert best.quality >= 3.0
    assert abs(best.contacts.points[:, 2].mean()) < 0.05  # m; elsewhere its weight would turn it
