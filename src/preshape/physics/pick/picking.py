"""The pick test, in which the hand takes an object from a table, open loop.

1. ``settle``: the object stands on the table, with gravity, and comes to rest. The hand waits in its
   pregrasp, moved back along its way in.
2. ``approach``: the hand moves along its way in to the pregrasp.
3. ``close``, ``squeeze``: the fingers move to the grasp and to the squeeze.
4. ``lift``: the hand moves up; ``hold``: it stands still.

The planned poses belong to the object as it was planned for. They are carried along with the object's motion
in step 1, as for a robot that looks at the object at rest; errors of position and angle are not seen. Every
motion starts and ends at rest. The hand's servos have the gains and torque limits of its description, and
gravity acts on the object only.

From the end of ``squeeze`` on, an object that leaves its limits is watched further: if the hand touches it no
more it was dropped, otherwise it slipped or turned.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ... import spatial
from ...types import Array, value
from ..grasps import HandPoses
from ..hold.six_directions import Observer, slerp, unstable
from ..measures import place, touching
from ..scene import PALM, TABLE, Scene
from ..task.motion import TaskMotion, ease
from .doing import do_job
from .protocol import Motion, PickProtocol, PickResult, PickStatus

STAGES = ("settle", "approach", "close", "squeeze", "lift", "hold")
"""Stages of the test, in their order."""
_WHEN = {
    "settle": "before the hand moved",
    "approach": "on the way in",
    "close": "while the fingers closed",
    "squeeze": "in the squeeze",
    "lift": "while it was lifted",
    "hold": "while it was held",
}


@value
class Pick:
    """State of a test after its last stage.

    Attributes:
        failure: Cause with which the test ends; ``None`` if the object was picked up.
        reason: One sentence on the failure; empty without one.
        settled: Motion of the object while it came to rest.
        pushed: Motion in the world until the squeeze ended, if the test got there.
        held: Motion in the hand from then on, if the test got there.
        table_force: Largest force between hand and table [N].
        touching: Number of parts (fingers and palm) that press on the object after the squeeze.
    """

    failure: PickStatus | None
    reason: str
    settled: Motion
    pushed: Motion | None
    held: Motion | None
    table_force: float
    touching: int


def pick_test(
    scene: Scene,
    poses: HandPoses,
    way_in: Array,
    protocol: PickProtocol,
    *,
    row: int = 0,
    object_name: str = "",
    scale: float = 1.0,
    work: TaskMotion | None = None,
    observer: Observer | None = None,
) -> PickResult:
    """Test one grasp.

    Args:
        scene: Scene of hand, object and table, built with ``protocol.scene``.
        poses: The grasp and the pose in which the object rests on the table, both in the world.
        way_in: (3,) unit vector along which the hand approaches, in the world.
        protocol: Settings of the test.
        row: Row for the result; it also decides the errors.
        object_name: Name of the object for the result.
        scale: Scale for the result.
        work: Motion and load of the task, in the object's frame; it is done if the protocol asks for it.
        observer: Called at every check with the stage and the ``mujoco.MjData``.
    """
    import mujoco

    data = mujoco.MjData(scene.model)
    pick = pick_up(scene, data, poses, way_in, protocol, row=row, observer=observer)
    job = None
    if protocol.do and work is not None and pick.failure is None:
        job = do_job(scene, data, work, protocol, observer=observer)
    reason = pick.reason
    if pick.failure is None and pick.held is not None:
        reason = f"{PickStatus.PICKED.value}; in the hand it {_moved(pick.held)}"
        reason += f"; then it {job.reason}" if job else ""
    return PickResult(
        row=row,
        object_name=object_name,
        scale=scale,
        mass=scene.mass,
        status=pick.failure or PickStatus.PICKED,
        reason=reason,
        settled=pick.settled,
        pushed=pick.pushed,
        held=pick.held,
        table_force=pick.table_force,
        touching=pick.touching,
        job=job,
        **planned_fields(poses, way_in),
    )


def planned_fields(poses: HandPoses, way_in: Array) -> dict[str, Any]:
    """The fields of a result that say what was planned, in the frame of the object.

    Args:
        poses: The grasp and the pose in which the object rests, both in the world.
        way_in: (3,) unit vector along which the hand approaches, in the world.
    """
    T = spatial.pose_from_seven(poses.object_pose)
    own = poses.moved(spatial.inverse(T))
    return {
        "planned": own.rows(),
        "way_in": tuple((np.asarray(way_in) @ T[:3, :3]).tolist()),
        "turn": tuple(poses.object_pose[3:].tolist()),
    }


def pick_up(
    scene: Scene,
    data: Any,
    poses: HandPoses,
    way_in: Array,
    protocol: PickProtocol,
    *,
    row: int = 0,
    observer: Observer | None = None,
) -> Pick:
    """Run all stages, or those before the failure.

    On return, ``data``, a new ``mujoco.MjData`` of the scene, is in the state in which the test ended; after
    a successful pick the hand holds the object at rest. The other arguments are those of :func:`pick_test`.
    """
    return _Pick(scene, data, poses, way_in, protocol, row).run(observer)


def placed_off(pose: Array, centre: Array, protocol: PickProtocol, row: int) -> Array:
    """(4, 4) motion in the world by which the object stands off its planned pose.

    It is drawn from the seed and the row alone: a shift along the table in a direction that is uniform, and a
    turn about the vertical through the centre of mass, in either sense with equal probability [C].

    Args:
        pose: (4, 4) planned pose of the object.
        centre: (3,) its centre of mass, in its own frame [m].
        protocol: Size of the errors, and the seed.
        row: Row of the object.
    """
    random = np.random.default_rng([protocol.seed, row])
    angle, sense = random.uniform(0.0, 2.0 * math.pi), random.choice([-1.0, 1.0])
    shift = protocol.position_error * np.array([math.cos(angle), math.sin(angle), 0.0])
    turn = spatial.rotation_from_vector(np.array([0.0, 0.0, sense * protocol.turn_error]))
    axis = spatial.transform_points(pose, centre)
    return spatial.pose(turn, axis - turn @ axis + shift)


class _Pick:
    """One test."""

    def __init__(
        self, scene: Scene, data: Any, poses: HandPoses, way_in: Array, protocol: PickProtocol, row: int
    ) -> None:
        self.scene, self.data, self.poses, self.protocol = scene, data, poses, protocol
        self.back = np.append(-protocol.way_in * np.asarray(way_in), np.zeros(4 + len(scene.joints)))
        self.table = int(scene.model.geom(TABLE).id)
        self.centre = np.array(scene.model.body_ipos[scene.object_body])
        self.planned = spatial.pose_from_seven(poses.object_pose)
        self.off = placed_off(self.planned, self.centre, protocol, row)
        self.from_pose = self.off @ self.planned  # the limits count from here
        self.table_force, self.touched, self.in_hand = 0.0, False, False
        self.most = Motion(displacement=0.0, rotation=0.0)
        self.lost: tuple[PickStatus, str] | None = None

    def run(self, observer: Observer | None) -> Pick:
        """Run the stages until one ends with a failure."""
        start = self.poses.pregrasp + self.back
        place(self.scene, self.data, start, spatial.seven_from_pose(self.from_pose))
        weight = -self.protocol.gravity * self.scene.mass
        self.data.xfrc_applied[self.scene.object_body, 2] = weight
        motions: dict[str, Motion] = {}
        failure: tuple[PickStatus, str] | None = None
        pressing = 0
        for stage, end in self._ends(start):
            failure = self._stage(stage, start, end, observer)
            start = end
            motions["settled" if stage == "settle" else "held" if self.in_hand else "pushed"] = self.most
            if failure is not None:
                break
            if stage in ("settle", "squeeze"):  # from here on, motion counts from the pose that it has now
                self.in_hand = stage == "squeeze"
                self.from_pose = self._object()
                self.most = Motion(displacement=0.0, rotation=0.0)
                pressing = touching(self.scene, self.data) if self.in_hand else 0
        failure = failure or self.lost or self._on_table()
        return Pick(
            failure=failure[0] if failure else None,
            reason=failure[1] if failure else "",
            settled=motions["settled"],
            pushed=motions.get("pushed"),
            held=motions.get("held"),
            table_force=self.table_force,
            touching=pressing,
        )

    def _ends(self, start: Array) -> Iterator[tuple[str, Array]]:
        """Each stage with the hand's pose and joint angles at its end."""
        yield "settle", start
        T = spatial.inverse(self.off) @ self._object() @ spatial.inverse(self.planned)
        pregrasp, grasp, squeeze = (
            np.append(spatial.seven_from_pose(T @ spatial.pose_from_seven(stage[:7])), stage[7:])
            for stage in (self.poses.pregrasp, self.poses.grasp, self.poses.squeeze)
        )
        lifted = squeeze.copy()
        lifted[2] += self.protocol.height
        yield from (("approach", pregrasp), ("close", grasp), ("squeeze", squeeze))
        yield from (("lift", lifted), ("hold", lifted))

    def _stage(
        self, stage: str, start: Array, end: Array, observer: Observer | None
    ) -> tuple[PickStatus, str] | None:
        """Move the hand's targets from ``start`` to ``end``; the failure that ends the test, if any."""
        import mujoco

        scene, data = self.scene, self.data
        steps = max(1, round(getattr(self.protocol, stage) / self.protocol.timestep))
        share = ease(np.arange(1, steps + 1) / steps)
        targets = (1 - share[:, None]) * start + share[:, None] * end
        turns = slerp(start[3:7], end[3:7], share)
        controls = targets[:, 7:] @ scene.controls.T
        for step in range(steps):
            data.mocap_pos[0], data.mocap_quat[0] = targets[step, :3], turns[step]
            data.ctrl[:] = controls[step]
            mujoco.mj_step(scene.model, data)
            self.table_force = max(self.table_force, self._force_on_table())
            if (step + 1) % self.protocol.look_steps and step + 1 < steps:
                continue
            if observer is not None:
                observer(stage, data)
            failure = self._judge(stage)
            if failure is not None:
                return failure
        return None

    def _judge(self, stage: str) -> tuple[PickStatus, str] | None:
        limits, when = self.protocol, _WHEN[stage]
        # MuJoCo resets a scene that has become unstable, and the object would seem not to have moved.
        if unstable(self.data):
            return PickStatus.UNSTABLE, f"the simulation became unstable {when}"
        if self.table_force > limits.table_force:
            return PickStatus.HITS_TABLE, f"the hand hit the table with {self.table_force:.1f} N {when}"
        touches = touching(self.scene, self.data) > 0
        self.touched |= touches
        now = self._motion()
        self.most = Motion(
            displacement=max(self.most.displacement, now.displacement),
            rotation=max(self.most.rotation, now.rotation),
        )
        far = now.displacement >= limits.displacement_limit
        off = far or now.rotation >= limits.rotation_limit
        if not self.in_hand:
            alone = off if stage == "settle" else off or now.displacement >= limits.untouched_limit
            if alone and not self.touched:
                return PickStatus.DOES_NOT_REST, f"untouched, the object {_moved(now)} {when}"
            return (PickStatus.PUSHED, f"the object {_moved(now)} {when}") if off else None
        if off and self.lost is None:
            verb, cause = ("slipped", PickStatus.SLIPS) if far else ("turned", PickStatus.SPINS)
            self.lost = cause, f"the object {verb} in the hand {when}: it {_moved(now)}"
        if self.lost is not None and not touches:
            never = "" if self.touched else "; the hand never touched it"
            return PickStatus.DROPS, f"the hand lost the object {when}{never}"
        return None

    def _on_table(self) -> tuple[PickStatus, str] | None:
        """The failure of an object that touches the table at the end."""
        pairs = np.asarray(self.data.contact.geom).reshape(-1, 2)
        bodies = self.scene.model.geom_bodyid[pairs[(pairs == self.table).any(axis=1)]]
        if (bodies == self.scene.object_body).any():
            return PickStatus.DROPS, "the object is still on the table at the end"
        return None

    def _force_on_table(self) -> float:
        """Sum of the normal forces between hand and table [N]."""
        import mujoco

        pairs = np.asarray(self.data.contact.geom).reshape(-1, 2)
        found = np.flatnonzero((pairs == self.table).any(axis=1))
        parts = self.scene.part_of_body[self.scene.model.geom_bodyid[pairs[found]]]
        total, force = 0.0, np.zeros(6)
        for index in found[(parts >= PALM).any(axis=1)]:
            mujoco.mj_contactForce(self.scene.model, self.data, int(index), force)
            total += float(force[0])
        return total

    def _object(self) -> Array:
        """(4, 4) pose of the object, in the world or in the hand."""
        qpos, at = self.data.qpos, self.scene.object_address
        T = spatial.pose_from_seven(np.array(qpos[at : at + 7]))
        if not self.in_hand:
            return T
        root = self.scene.root_address
        return np.asarray(spatial.inverse(spatial.pose_from_seven(np.array(qpos[root : root + 7]))) @ T)

    def _motion(self) -> Motion:
        """How far the object is from the pose from which its limits count."""
        now, then = self._object(), self.from_pose
        away = spatial.transform_points(now, self.centre) - spatial.transform_points(then, self.centre)
        turn = spatial.vector_from_rotation(then[:3, :3].T @ now[:3, :3])
        return Motion(displacement=float(np.linalg.norm(away)), rotation=float(np.linalg.norm(turn)))


def _moved(motion: Motion) -> str:
    """The motion in words: ``moved 12.0 mm and 3°``."""
    return f"moved {1e3 * motion.displacement:.1f} mm and {math.degrees(motion.rotation):.0f}°"
