"""The task test, in which the hand must move the object along a task's screw, against a load.

1. The hand moves from pregrasp to grasp to squeeze, as in the holding test; no load acts on the object.
2. Load and weight rise linearly from zero, while the hand stands still.
3. The hand's root moves so that an object fixed in the hand would follow the motion (:mod:`.motion`). The
   load opposes the motion, and the finger joints keep the targets of the squeeze.
4. The hand stands still at the end, and load and weight remain.

From step 2 on, every few simulation steps, the object's pose is compared with the pose on the path that is
due at that time: the distance of the COGs and the angle between the orientations. The path begins at the
object's pose before the squeeze, so a grasp that moves the object during the squeeze has less tolerance left.
"""

from __future__ import annotations

import enum
import math
from typing import Any

import numpy as np

from ... import spatial
from ...exceptions import InputError
from ...types import Array, an_instance, finite_number, freeze, positive_number, value, whole_number
from ..grasps import HandPoses
from ..hold.six_directions import Observer, take_hold, unstable
from ..protocol import HoldProtocol
from ..scene import Scene
from .motion import ACCELERATION, TaskMotion, ease

_OF_HOLD = (
    "mass", "friction", "torsion", "gain", "torque_limits", "many_contacts", "timestep", "stages",
    "stage_steps", "displacement_limit", "rotation_limit", "penetration_limit",
)  # fmt: skip


class TaskStatus(enum.Enum):
    """Outcome of a task test; the values are texts for the user."""

    DONE = "moved the object along the task's motion"
    LOST = "lost the object"
    PENETRATES = "the pregrasp cuts too deep into the object or the hand"
    UNSTABLE = "the simulation became unstable"
    NO_ANSWER = "the planner gave no grasp"
    INVALID = "the grasp could not be tested"


@value
class TaskProtocol:
    """Settings of a task test.

    Attributes:
        hold: Mass, friction, gains, steps of the approach, and the two limits (50 mm, 15°).
        acceleration: Load and weight divided by the mass of the object [m/s²].
        strength: Factor on the load; the weight is not scaled.
        rise: Time in which load and weight rise, step 2 [s].
        duration: Time of the motion, step 3 [s].
        rest: Time at rest after the motion, step 4 [s].
        look_steps: Simulation steps between two checks of the object.

    Raises:
        InputError: A number is out of range, or ``hold`` sets pose or size errors, which the task test does
            not support.
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
            positive_number(getattr(self, name), name)
        if finite_number(self.strength, "strength") < 0:
            raise InputError(f"strength must be at least 0, got {self.strength!r}")
        freeze(self, look_steps=whole_number(self.look_steps, "look_steps", 1))
        an_instance(self.hold, HoldProtocol, "hold")
        if any((self.hold.position_error, self.hold.turn_error, self.hold.size_error)):
            raise InputError("the task test does not apply errors of pose or size; leave them at 0")

    def to_json(self) -> dict[str, float | bool]:
        """The settings that this test uses, as plain JSON values."""
        own = ("acceleration", "strength", "rise", "duration", "rest", "look_steps")
        return {
            **{name: getattr(self.hold, name) for name in _OF_HOLD},
            **{name: getattr(self, name) for name in own},
        }

    def schedule(self) -> tuple[Array, Array]:
        """(steps,) share of the load and (steps,) fraction of the path, after each simulation step."""
        rise, move, rest = (
            max(1, round(t / self.hold.timestep)) for t in (self.rise, self.duration, self.rest)
        )
        load = np.concatenate([np.arange(1, rise + 1) / rise, np.ones(move + rest)])
        path = np.concatenate([np.zeros(rise), ease(np.arange(1, move + 1) / move), np.ones(rest)])
        return load, path


@value
class TaskResult:
    """Result of the task test of one grasp.

    Attributes:
        row: Row of the instance in its list.
        object_name: Name of the object.
        scale: Factor on the object's size.
        task: Label of the task, such as ``push:+x``.
        status: Outcome.
        reason: One sentence on the outcome.
        displacement: Largest distance of the COG from its path [m]; ``None`` if no load was applied.
        rotation: Largest angle of the object from its path [rad]; ``None`` if no load was applied.
        final_displacement: Distance of the COG from its target at the end [m]; ``None`` if the test ended
            early.
        final_rotation: Angle of the object from its target at the end [rad]; ``None`` if the test ended
            early.
        progress: Fraction of the path at the end of the test, 0 to 1.
        touching: Number of parts (fingers and palm) that press on the object after the squeeze.
        planned: If this program planned them, pregrasp, grasp and squeeze, each as root pose in the object's
            frame and joint angles (7 + joints); otherwise ``None``.
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
        """Whether the object followed its path to the end."""
        return self.status is TaskStatus.DONE

    @property
    def family(self) -> str:
        """Family of the task, or ``custom``."""
        return self.task.partition(":")[0]


def task_test(
    scene: Scene,
    poses: HandPoses,
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
        scene: Scene of hand and object, built with ``protocol.hold``.
        poses: The grasp.
        motion: Path and load, in the object's frame.
        protocol: Settings of the test.
        row: Row for the result.
        object_name: Name of the object for the result.
        scale: Scale for the result.
        task: Label of the task for the result.
        planned: Poses for the result.
        observer: Called at every check with ``grasp``, ``squeeze``, ``load``, ``path`` or ``rest`` and the
            ``mujoco.MjData``, for pictures and tables.
    """
    import mujoco

    data = mujoco.MjData(scene.model)
    label: dict[str, Any] = {"row": row, "object_name": object_name, "scale": scale, "task": task}
    label["planned"] = planned
    hold = take_hold(scene, data, poses, protocol.hold, observer=observer)
    if hold.failure is not None:
        return TaskResult(status=TaskStatus[hold.failure.name], reason=hold.reason, **label)
    start = spatial.pose_from_seven(poses.object_pose)
    run = TaskRun(scene, data, start, spatial.pose_from_seven(poses.squeeze[:7]), motion, protocol)
    return run.result({**label, "touching": hold.touching_at_squeeze}, observer)


class TaskRun:
    """The load and the motion of one test, from the moment at which the hand holds the object.

    Args:
        scene: Scene of hand and object.
        data: A ``mujoco.MjData`` of it, in which the hand holds the object; its servo targets stay.
        T_world_start: (4, 4) pose of the object in the world at the start of the path [m].
        T_world_root: (4, 4) pose of the hand's root there [m].
        motion: Path and load, in the object's frame.
        protocol: Settings of the test.
        carried: Whether the hand carries the weight already, which then does not rise from zero.
    """

    def __init__(
        self,
        scene: Scene,
        data: Any,
        T_world_start: Array,
        T_world_root: Array,
        motion: TaskMotion,
        protocol: TaskProtocol,
        *,
        carried: bool = False,
    ) -> None:
        self.scene, self.data, self.protocol = scene, data, protocol
        self.share, self.path = protocol.schedule()
        self.target = T_world_start @ motion.path(self.path)  # (steps, 4, 4)
        # A root that is fixed in the object moves by W(f) = X(f) X(0)⁻¹, X being the object's pose.
        T_root = self.target @ spatial.inverse(T_world_start) @ T_world_root
        self.root = spatial.seven_from_pose(T_root)  # q and -q are equal to the weld
        # From the axes of the first pose to world axes. The load is about the COG, the weight acts at the
        # centre of mass.
        R = T_world_start[:3, :3]
        load = motion.load(self.path, scene.mass, protocol.acceleration) * protocol.strength
        self.load = np.concatenate([load[:, :3] @ R.T, load[:, 3:] @ R.T], axis=1) * self.share[:, None]
        bears = np.ones_like(self.share) if carried else self.share
        self.weight = np.outer(bears, R @ motion.weight(scene.mass, protocol.acceleration))
        self.cog = motion.cog
        self.centre_of_mass = np.array(scene.model.body_ipos[scene.object_body])
        self.displacement = self.rotation = 0.0

    def result(self, label: dict[str, Any], observer: Observer | None) -> TaskResult:
        """Move along the whole path, or until the object is lost."""
        limits = self.protocol.hold
        far = turned = 0.0
        for step in range(len(self.path)):
            self.step(step)
            if (step + 1) % self.protocol.look_steps and step + 1 < len(self.path):
                continue
            if observer is not None:
                observer(self.phase(step), self.data)
            far, turned = self.error(step)
            self.displacement = max(self.displacement, far)
            self.rotation = max(self.rotation, turned)
            # MuJoCo resets a scene that has become unstable, and the object would seem not to have moved.
            blown_up = unstable(self.data)
            if blown_up or far > limits.displacement_limit or turned > limits.rotation_limit:
                status = TaskStatus.UNSTABLE if blown_up else TaskStatus.LOST
                reason = status.value if blown_up else self.lost(step, far, turned)
                return self.ended(label, status, reason, float(self.path[step]))
        return self.ended(
            {**label, "final_displacement": far, "final_rotation": turned},
            TaskStatus.DONE,
            f"{TaskStatus.DONE.value}; it ended {far * 1e3:.1f} mm and {math.degrees(turned):.1f}° "
            "from its target",
            1.0,
        )

    def step(self, step: int) -> None:
        """Run one simulation step with its targets and loads."""
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
        """Distance of the COG from its path [m], and angle of the object from its path [rad]."""
        at = self.scene.object_address
        T = spatial.pose_from_seven(self.data.qpos[at : at + 7])
        target = self.target[step]
        off = spatial.transform_points(T, self.cog) - spatial.transform_points(target, self.cog)
        angle = spatial.vector_from_rotation(target[:3, :3].T @ T[:3, :3])
        return float(np.linalg.norm(off)), float(np.linalg.norm(angle))

    def phase(self, step: int) -> str:
        """``load``, ``path`` or ``rest``."""
        if self.share[step] < 1.0 or self.path[step] == 0.0:
            return "load"
        return "path" if self.path[step] < 1.0 else "rest"

    def lost(self, step: int, far: float, turned: float) -> str:
        """Why the object counts as lost."""
        limit = self.protocol.hold.displacement_limit
        off = f"{far * 1e3:.0f} mm" if far > limit else f"{math.degrees(turned):.0f}°"
        when = {
            "load": "under the load, before the hand moved",
            "path": f"after {100 * self.path[step]:.0f} % of the path",
            "rest": "at the end of the path",
        }[self.phase(step)]
        return f"lost the object: it was {off} off its path {when}"

    def ended(self, label: dict[str, Any], status: TaskStatus, reason: str, progress: float) -> TaskResult:
        """The result of the test."""
        return TaskResult(
            status=status,
            reason=reason,
            displacement=self.displacement,
            rotation=self.rotation,
            progress=progress,
            **label,
        )
