"""The task test on cases with known results."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from preshape.exceptions import InputError
from preshape.physics.hand import PhysicsHand
from preshape.physics.pieces import ConvexPieces
from preshape.physics.protocol import HoldProtocol
from preshape.physics.scene import build_scene
from preshape.physics.task.motion import TaskMotion, task_motion
from preshape.physics.task.protocol import TaskProtocol, TaskResult, TaskStatus, task_test
from preshape.spatial import inverse, pose_from_seven, seven_from_pose
from preshape.tasks import named_task
from test_physics_scene import BOX, CORNERS, HAND, HERE, SIDE, clamp, grasp_of

# Flat faces must touch at their corners, or the box turns about the one point that is left.
SURE = TaskProtocol(hold=HoldProtocol(many_contacts=True))
SMOOTH = TaskProtocol(hold=HoldProtocol(many_contacts=True, friction=0.0))
NONE = np.zeros(3)
HALF = float(SIDE.max())
AWAY = np.array(
    [0.3, -0.2, 0.5, *(np.array([0.02, 0.9, -0.3, 0.4]) / np.linalg.norm([0.02, 0.9, -0.3, 0.4]))]
)
SCREWS = ("lift", "pour", "lever", "unscrew:+x", "strike:-y")


def cage(half: np.ndarray, gap: float = 0.001) -> PhysicsHand:
    """Six fixed walls around a box with these half extents at the root."""
    walls = ""
    for axis in range(3):
        for sign in (-1, 1):
            size = half + gap + 0.01
            size[axis] = 0.005
            at = np.zeros(3)
            at[axis] = sign * (half[axis] + gap + 0.005)
            walls += f'<geom type="box" size="{_text(size)}" pos="{_text(at)}" mass="0.05"/>'
    mjcf = f'<mujoco model="cage"><worldbody><body name="root">{walls}</body></worldbody></mujoco>'
    return PhysicsHand(name="cage", mjcf=mjcf, assets=(), root="root", joints=(), T_root_palm=np.eye(4))


def _text(numbers: np.ndarray) -> str:
    return " ".join(f"{x:.6f}" for x in numbers)


def way(name: str, gravity: np.ndarray | None = None, cog: np.ndarray = NONE) -> TaskMotion:
    return task_motion(named_task(name), cog, HALF, gravity=gravity)


def caged(
    name: str, protocol: TaskProtocol = SMOOTH, where: np.ndarray = HERE, observer=None, pieces=BOX, cog=NONE
) -> TaskResult:
    """Test the box in the cage, whose root is at the centre of the box."""
    scene = build_scene(cage(SIDE), pieces, 1.0, protocol.hold)
    T = pose_from_seven(where)
    root = np.array([*(T[:3, :3] @ cog + T[:3, 3]), *where[3:]])
    return task_test(
        scene, grasp_of(root, root, root, where), way(name, cog=cog), protocol, observer=observer
    )


def clamped(name: str, protocol: TaskProtocol = SURE, squeeze: float = 0.012, gravity=None) -> TaskResult:
    scene = build_scene(HAND, BOX, 1.0, protocol.hold)
    poses = clamp(0.0), clamp(0.0052), clamp(squeeze)
    return task_test(scene, grasp_of(*poses), way(name, gravity), protocol)


@pytest.mark.parametrize("name", SCREWS)
def test_a_cage_takes_the_box_along_without_friction(name: str) -> None:
    result = caged(name)
    assert result.status is TaskStatus.DONE
    assert result.progress == 1.0
    assert result.final_displacement is not None
    assert result.final_rotation is not None
    # A millimetre of play, and at the fastest the hand trails its target by some 4 mm and 2°.
    assert result.final_displacement < 0.0035
    assert result.final_rotation < math.radians(4)
    assert result.final_displacement <= result.displacement < 0.008
    assert result.final_rotation <= result.rotation < math.radians(6)


@pytest.mark.parametrize("where", [HERE, AWAY])
def test_where_the_object_ends_in_the_world(where: np.ndarray) -> None:
    """The simulator's poses, not those of the test, end at T_start · D about the COG."""
    last: list[np.ndarray] = []
    result = caged("lever", where=where, observer=lambda _, data: last.append(np.array(data.qpos[-7:])))
    assert result.passed
    moved = inverse(pose_from_seven(where)) @ pose_from_seven(last[-1])
    assert moved[:3, 3] == pytest.approx([0, 0, 0.1], abs=0.004)  # the way is along +z
    c, s = math.cos(math.pi / 4), math.sin(math.pi / 4)
    assert moved[:3, :3] == pytest.approx(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), abs=0.06)


def test_the_frame_of_the_file_does_not_matter() -> None:
    """The same box with its frame half a metre away gives the same result, because all is about the COG."""
    offset = np.array([0.5, -0.3, 0.2])
    far = ConvexPieces(name="far", pieces=(CORNERS * SIDE + offset,))
    here = caged("pour")
    there = caged("pour", pieces=far, cog=offset, where=np.array([*-offset, 1, 0, 0, 0]))
    assert there.passed
    assert there.displacement == pytest.approx(here.displacement, abs=5e-4)
    assert there.rotation == pytest.approx(here.rotation, abs=5e-3)


@pytest.mark.parametrize("where", [HERE, AWAY])
def test_the_work_done_is_against_the_load(where: np.ndarray) -> None:
    """Along the path the load does the negative work of force and torque, wherever the centre of mass is.

    Half of the box's mass is in its last tenth, so COG and centre of mass differ.
    """
    tip = CORNERS * SIDE * [0.1, 1, 1] + [SIDE[0] * 0.9, 0, 0]
    heavy = ConvexPieces(name="heavy", pieces=(CORNERS * SIDE, tip, tip * [1, 0.999, 1], tip * [1, 1, 0.999]))
    protocol = replace(SMOOTH, look_steps=1)
    work = {"path": 0.0, "load": 0.0, "rest": 0.0}

    def look(phase: str, data: mujoco.MjData) -> None:
        if phase in work:
            v = np.zeros(6)  # angular, linear at the centre of mass, as the applied wrench
            mujoco.mj_objectVelocity(scene.model, data, mujoco.mjtObj.mjOBJ_BODY, scene.object_body, v, 0)
            force, torque = np.split(data.xfrc_applied[scene.object_body], 2)
            work[phase] += 0.004 * float(force @ v[3:] + torque @ v[:3])

    scene = build_scene(cage(SIDE), heavy, 1.0, protocol.hold)
    assert abs(scene.model.body_ipos[scene.object_body][0]) > 0.004
    result = task_test(scene, grasp_of(*[where] * 4), way("lever", NONE), protocol, observer=look)
    assert result.passed
    arc = 0.05 / math.sin(math.pi / 8) * math.pi / 4
    expected = -9.8 * 0.1 * (arc + HALF / 2 * math.pi / 4)
    assert work["path"] + work["rest"] == pytest.approx(expected, rel=0.02)


class TestAlone:
    """A free object: the time at which it is lost shows the size and the rise of load and weight."""

    def lost_after(
        self, name: str, gravity: np.ndarray | None, strength: float = 1.0
    ) -> tuple[float, TaskResult]:
        protocol = replace(SURE, look_steps=1, strength=strength)
        scene = build_scene(None, BOX, 1.0, protocol.hold)
        times: list[float] = []
        result = task_test(
            scene, grasp_of(HERE, HERE, HERE), way(name, gravity), protocol,
            observer=lambda phase, data: times.append(data.time) if phase == "load" else None,
        )  # fmt: skip
        return times[-1] - (times[0] - 0.004), result

    @pytest.mark.parametrize(
        ("gravity", "strength", "acceleration"),
        [(NONE, 1, 9.8), (None, 1, 19.6), (NONE, 2, 19.6), (-NONE, 3, 29.4)],
    )
    def test_force(self, gravity, strength: float, acceleration: float) -> None:
        after, result = self.lost_after("lift", gravity, strength)
        assert result.status is TaskStatus.LOST
        # The load grows evenly over 0.4 s: s = a t³ / (6 · 0.4) is 50 mm.
        assert after == pytest.approx((0.05 * 6 * 0.4 / acceleration) ** (1 / 3), abs=0.009)
        assert 0.05 < result.displacement < 0.06
        assert result.rotation == pytest.approx(0.0, abs=1e-6)
        assert (result.final_displacement, result.progress) == (None, 0.0)
        assert result.reason.endswith("off its path under the load, before the hand moved")

    @pytest.mark.parametrize("gravity", [[0.0, 0, 0], [-1.0, 0, 0]])
    def test_both_are_given_in_the_object_s_frame(self, gravity: list[float]) -> None:
        scene = build_scene(None, BOX, 1.0, SURE.hold)
        last: list[np.ndarray] = []
        motion = way("push:+y", np.array(gravity))  # along +y and, less, -z
        task_test(
            scene,
            grasp_of(*[AWAY] * 4),
            motion,
            SURE,
            observer=lambda _, data: last.append(np.array(data.qpos[-7:])),
        )
        fell = (inverse(pose_from_seven(AWAY)) @ pose_from_seven(last[-1]))[:3, 3]
        expected = motion.load(0.0, 1.0)[:3] / 9.8 + gravity
        assert fell / np.linalg.norm(fell) == pytest.approx(expected / np.linalg.norm(expected), abs=1e-6)

    def test_torque(self) -> None:
        after, result = self.lost_after("turn", NONE)
        inertia = 0.1 / 3 * (SIDE[0] ** 2 + SIDE[1] ** 2)
        torque = 9.8 * 0.1 * HALF / 2
        assert after == pytest.approx((math.radians(15) * 6 * 0.4 * inertia / torque) ** (1 / 3), abs=0.009)
        assert result.displacement == pytest.approx(0.0, abs=1e-6)
        assert "15° off" in result.reason or "16° off" in result.reason


class TestClamp:
    @pytest.mark.parametrize("name", ["lift", "turn:+x", "press"])
    def test_a_firm_one_passes(self, name: str) -> None:
        result = clamped(name)
        assert result.status is TaskStatus.DONE
        assert result.touching == 2

    def test_a_weak_one_fails_under_double_load(self) -> None:
        """Two plates at 2000 N/m, 0.6 mm beyond the touch: 0.6 · 2 · 1.2 N = 1.44 N of friction."""
        once, twice = (clamped("lift", replace(SURE, strength=s), 0.0056, NONE) for s in (1.0, 2.0))
        assert once.status is TaskStatus.DONE
        assert twice.status is TaskStatus.LOST

    def test_the_weight_counts_as_much_as_the_load(self) -> None:
        assert clamped("lift", squeeze=0.0056, gravity=NONE).passed
        assert not clamped("lift", squeeze=0.0056).passed
        assert clamped("lift", squeeze=0.0056, gravity=np.array([0.0, 0, 1])).passed  # it lifts by itself

    def test_without_friction_only_the_plates_hold(self) -> None:
        assert clamped("lift:+x", SMOOTH, gravity=NONE).passed
        lost = clamped("lift:+z", SMOOTH, gravity=NONE)
        assert lost.status is TaskStatus.LOST

    def test_a_pregrasp_in_the_object(self) -> None:
        scene = build_scene(HAND, BOX, 1.0, SURE.hold)
        result = task_test(
            scene, grasp_of(*[clamp(0.016)] * 3), way("lift"), SURE, row=3, object_name="box", task="lift:+z"
        )
        assert result.status is TaskStatus.PENETRATES
        assert "11.0 mm into the object" in result.reason
        assert (result.displacement, result.rotation, result.progress) == (None, None, 0.0)
        assert (result.row, result.object_name, result.family) == (3, "box", "lift")

    def test_too_fast_for_the_hand(self) -> None:
        """0.1 m in 50 ms: the hand lags behind its target by more than the limit."""
        result = clamped("lift", replace(SURE, duration=0.05))
        assert result.status is TaskStatus.LOST
        assert 0.0 < result.progress <= 1.0

    def test_phases_and_that_an_observer_changes_nothing(self) -> None:
        seen: list[str] = []
        watched = caged("turn", observer=lambda phase, _: seen.append(phase))
        assert list(dict.fromkeys(seen)) == ["grasp", "squeeze", "load", "path", "rest"]
        alone = caged("turn")
        assert (alone.displacement, alone.rotation) == (watched.displacement, watched.rotation)


class TestProtocol:
    @pytest.mark.parametrize(
        "wrong",
        [{"duration": 0.0}, {"rise": math.nan}, {"rest": -1.0}, {"strength": -0.1}, {"look_steps": 0}],
    )
    def test_wrong_numbers(self, wrong: dict[str, float]) -> None:
        with pytest.raises(InputError, match=next(iter(wrong))):
            TaskProtocol(**wrong)  # type: ignore[arg-type]

    def test_errors_of_pose_are_not_for_this_test(self) -> None:
        with pytest.raises(InputError, match="does not apply errors of pose"):
            TaskProtocol(hold=HoldProtocol(position_error=0.005))

    def test_schedule(self) -> None:
        share, way_ = SURE.schedule()
        assert len(share) == len(way_) == 100 + 500 + 100
        assert (np.diff(share) >= 0).all()
        assert (np.diff(way_) >= 0).all()
        assert (share[49], way_[99], share[99]) == (0.5, 0.0, 1.0)
        assert (way_[349], way_[599], way_[-1]) == (pytest.approx(0.5), 1.0, 1.0)


def test_poses_go_there_and_back() -> None:
    assert seven_from_pose(pose_from_seven(AWAY)) == pytest.approx(AWAY)
