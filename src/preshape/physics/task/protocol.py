"""The task test: the hand takes the object along a task's screw, against a load; does the object follow?

1. Pregrasp, grasp, squeeze, as in the holding test: the object floats, nothing pulls at it.
2. The load and the weight come, growing evenly from nothing; the hand stands still.
3. The hand's root moves so that an object fixed in it would follow the motion (:mod:`.task_motion`), the
   load keeping against it; the finger joints keep the targets of the squeeze.
4. The hand stands still at the end, load and weight still there.

From 2 on the object is compared with its path every few steps: the distance of its COG from where it
should be, and the angle between its orientation and the one it should have. The path begins where the
object stood before the squeeze, so a grasp that shoves the object has used up part of its margin.
"""

from __future__ import annotations

import enum
import math
from typing import Any

import numpy as np

from ... import spatial
from ...exceptions import InputError
from ...types import Array, value
from ..hold.six_directions import HoldStatus, Observer, take_hold, unstable
from ..protocol import HoldProtocol
from ..scene import Scene
from .motion import ACCELERATION, TaskMotion, ease

_OF_HOLD = (
    "mass", "friction", "torsion", "gain", "torque_limits", "many_contacts", "timestep", "stages",
    "stage_steps", "displacement_limit", "rotation_limit", "penetration_limit",
)  # fmt: skip


class TaskStatus(enum.Enum):
    """How a task test ended; the value is what people read."""

    DONE = "took the object along the task's motion"
    LOST = "lost the object"
    PENETRATES = "the pregrasp cuts too deep into the object or the hand"
    UNSTABLE = "the simulation became unstable"
    NO_ANSWER = "the planner gave no grasp"
    INVALID = "the grasp could not be tested"


@value
class TaskProtocol:
    """Everything that decides a task test.

    Attributes:
        hold: mass, friction, gains, steps of the approach, and the two limits (50 mm, 15°).
        acceleration: load and weight over mass [m/s²].
        strength: factor on the load; the weight stays.
        rise: time in which load and weight come [s].
        duration: of the motion [s].
        rest: time at the end [s].
        look_steps: simulation steps between two looks at the object.

    Raises:
        InputError: a number out of range, or a ``hold`` with errors of pose or size, which this test lacks.
    """

    hold: HoldProtocol = HoldProtocol()
    acceleration: float = ACCELERATION
    strength: float = 1.0
    rise: float = 0.4
    duration: float = 2.0
    rest: float = 0.4
    look_steps: int = 5

    def __post_init__(self) -> None:
        for name in ("acceleration", "rise", "duration", "rest"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"{name} must be above 0, got {getattr(self, name)!r}")
        if not (math.isfinite(self.strength) and self.strength >= 0):
            raise InputError(f"strength must be at least 0, got {self.strength!r}")
        if self.look_steps < 1:
            raise InputError(f"look_steps must be 1 or more, got {self.look_steps!r}")
        if any((self.hold.position_error, self.hold.turn_error, self.hold.size_error)):
            raise InputError("the task test has no errors of pose or size; leave them at 0")

    def to_json(self) -> dict[str, float | bool]:
        """The numbers that count in this test, as plain JSON values."""
        own = ("acceleration", "strength", "rise", "duration", "rest", "look_steps")
        return {
            **{name: getattr(self.hold, name) for name in _OF_HOLD},
            **{name: getattr(self, name) for name in own},
        }

    def schedule(self) -> tuple[Array, Array]:
        """Share of the load, and fraction of the way, after each simulation step; two (steps,) arrays."""
        rise, move, rest = (
            max(1, round(t / self.hold.timestep)) for t in (self.rise, self.duration, self.rest)
        )
        up = np.arange(1, rise + 1) / rise
        load = np.concatenate([up, np.ones(move + rest)])
        way = np.concatenate([np.zeros(rise), ease(np.arange(1, move + 1) / move), np.ones(rest)])
        return load, way


@value
class TaskResult:
    """Everything about one grasp in one task.

    Attributes:
        row: of the instance in its list.
        object_name: the object's.
        scale: factor on the object's size.
        task: the task's label, ``push:+x``.
        status: how it ended.
        reason: one sentence.
        displacement: the COG's largest distance from its path [m]; ``None`` where nothing moved.
        rotation: the object's largest angle from its path [rad].
        final_displacement: the COG's distance from its target at the end [m]; ``None`` where the test
            ended before.
        final_rotation: the angle from the target [rad].
        progress: fraction of the way when the test ended, 0 to 1.
        touching: parts (fingers, palm) that press on the object after the squeeze.
        planned: (3 rows of 7 + joints) pregrasp, grasp and squeeze in the object's frame, as root pose and
            angles, where this program planned them.
    """

    row: int
    object_name: str
    scale: float
    task: str
    status: TaskStatus
    reason: str
    displacement: float | None = None
    rotation: float | None = None
    final_displacement: float | None = None
    final_rotation: float | None = None
    progress: float = 0.0
    touching: int = 0
    planned: tuple[tuple[float, ...], ...] | None = None

    @property
    def passed(self) -> bool:
        """Whether the grasp passes."""
        return self.status is TaskStatus.DONE

    @property
    def family(self) -> str:
        """The task's family, or ``custom``."""
        return self.task.partition(":")[0]


def task_test(
    scene: Scene,
    pregrasp: Array,
    grasp: Array,
    squeeze: Array,
    object_pose: Array,
    motion: TaskMotion,
    protocol: TaskProtocol,
    *,
    row: int = 0,
    object_name: str = "",
    scale: float = 1.0,
    task: str = "",
    planned: tuple[tuple[float, ...], ...] | None = None,
    observer: Observer | None = None,
) -> TaskResult:
    """Test one grasp in one task.

    Args:
        scene: of hand and object, built with ``protocol.hold``.
        pregrasp: (7 + joints) root pose x y z w x y z in the world and joint angles [m, rad].
        grasp: the same, where the hand touches.
        squeeze: the same, the targets that press.
        object_pose: (7,) in the world.
        motion: way and load, in the object's frame.
        protocol: the test's numbers.
        row: repeated in the result, as are the next four.
        object_name: see there.
        scale: see there.
        task: see there.
        planned: see there.
        observer: called with ``grasp``, ``squeeze``, ``load``, ``way`` or ``rest`` and the
            ``mujoco.MjData`` at every look, for pictures and tables.
    """
    import mujoco

    data = mujoco.MjData(scene.model)
    label: dict[str, Any] = {"row": row, "object_name": object_name, "scale": scale, "task": task}
    label["planned"] = planned
    hold = take_hold(scene, data, pregrasp, grasp, squeeze, object_pose, protocol.hold, observer=observer)
    if hold.failure is not None:
        found = {
            HoldStatus.PENETRATES: TaskStatus.PENETRATES,
            HoldStatus.UNSTABLE: TaskStatus.UNSTABLE,
        }[hold.failure]
        return TaskResult(status=found, reason=hold.reason, **label)
    run = _Run(scene, data, squeeze, object_pose, motion, protocol)
    return run.result({**label, "touching": hold.touching_at_squeeze}, observer)


class _Run:
    """The way from the squeeze on, of one test."""

    def __init__(
        self,
        scene: Scene,
        data: Any,
        squeeze: Array,
        object_pose: Array,
        motion: TaskMotion,
        protocol: TaskProtocol,
    ) -> None:
        self.scene, self.data, self.protocol = scene, data, protocol
        self.share, self.way = protocol.schedule()
        T_world_start = spatial.pose_from_seven(object_pose)
        self.target = T_world_start @ motion.path(self.way)  # (steps, 4, 4)
        # A root that is fixed in the object: W(f) = X(f) X(0)⁻¹ takes it along.
        T_root = self.target @ spatial.inverse(T_world_start) @ spatial.pose_from_seven(squeeze[:7])
        self.root = spatial.seven_from_pose(T_root)  # the weld takes q and -q alike
        # From the start's axes to the world's. The load is about the COG, the weight at the centre of mass.
        R = T_world_start[:3, :3]
        load = motion.load(self.way, scene.mass, protocol.acceleration) * protocol.strength
        self.load = np.concatenate([load[:, :3] @ R.T, load[:, 3:] @ R.T], axis=1) * self.share[:, None]
        self.weight = np.outer(self.share, R @ motion.weight(scene.mass, protocol.acceleration))
        self.cog = motion.cog
        self.centre_of_mass = np.array(scene.model.body_ipos[scene.object_body])
        self.displacement = self.rotation = 0.0

    def result(self, label: dict[str, Any], observer: Observer | None) -> TaskResult:
        """Go the whole way, or as far as the object comes along."""
        limits = self.protocol.hold
        far = turned = 0.0
        for step in range(len(self.way)):
            self.step(step)
            if (step + 1) % self.protocol.look_steps and step + 1 < len(self.way):
                continue
            if observer is not None:
                observer(self.phase(step), self.data)
            far, turned = self.error(step)
            self.displacement = max(self.displacement, far)
            self.rotation = max(self.rotation, turned)
            # MuJoCo resets a scene that blew up, which would look like an object that never moved.
            shaken = unstable(self.data)
            if shaken or far > limits.displacement_limit or turned > limits.rotation_limit:
                status = TaskStatus.UNSTABLE if shaken else TaskStatus.LOST
                reason = status.value if shaken else self.sentence(step, far, turned)
                return self.made(label, status, reason, float(self.way[step]))
        return self.made(
            {**label, "final_displacement": far, "final_rotation": turned},
            TaskStatus.DONE,
            f"{TaskStatus.DONE.value}; it ended {far * 1e3:.1f} mm and {math.degrees(turned):.1f}° "
            "from its target",
            1.0,
        )

    def step(self, step: int) -> None:
        """One simulation step with its targets and loads."""
        import mujoco

        scene, data = self.scene, self.data
        if scene.root_address >= 0:
            data.mocap_pos[0], data.mocap_quat[0] = self.root[step, :3], self.root[step, 3:]
        T = spatial.pose_from_seven(data.qpos[scene.object_address : scene.object_address + 7])
        arm = T[:3, :3] @ (self.cog - self.centre_of_mass)
        force, torque = self.load[step, :3], self.load[step, 3:]
        data.xfrc_applied[scene.object_body, :3] = force + self.weight[step]
        data.xfrc_applied[scene.object_body, 3:] = torque + np.cross(arm, force)
        mujoco.mj_step(scene.model, data)

    def error(self, step: int) -> tuple[float, float]:
        """The COG's distance from where it should be [m], and the object's angle from its orientation."""
        at = self.scene.object_address
        T = spatial.pose_from_seven(self.data.qpos[at : at + 7])
        target = self.target[step]
        off = spatial.transform_points(T, self.cog) - spatial.transform_points(target, self.cog)
        angle = spatial.vector_from_rotation(target[:3, :3].T @ T[:3, :3])
        return float(np.linalg.norm(off)), float(np.linalg.norm(angle))

    def phase(self, step: int) -> str:
        """``load``, ``way`` or ``rest``."""
        if self.share[step] < 1.0 or self.way[step] == 0.0:
            return "load"
        return "way" if self.way[step] < 1.0 else "rest"

    def sentence(self, step: int, far: float, turned: float) -> str:
        """Why the object counts as lost."""
        limit = self.protocol.hold.displacement_limit
        off = f"{far * 1e3:.0f} mm" if far > limit else f"{math.degrees(turned):.0f}°"
        when = {
            "load": "when the load came, before the hand moved",
            "way": f"after {100 * self.way[step]:.0f} % of the way",
            "rest": "at the end of the way",
        }[self.phase(step)]
        return f"lost the object: it was {off} off its path {when}"

    def made(self, label: dict[str, Any], status: TaskStatus, reason: str, progress: float) -> TaskResult:
        """The result."""
        return TaskResult(
            status=status,
            reason=reason,
            displacement=self.displacement,
            rotation=self.rotation,
            progress=progress,
            **label,
        )
