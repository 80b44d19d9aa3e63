"""Records a test while it runs: poses, contact forces, slip, torques and the gap, over time.

Every probe of a holding test starts from the squeezed grasp; a recording lists the probes one after another.
After a simulation step, MuJoCo's data hold both the poses and the contact forces of the beginning of that
step, so all values of a sample belong to the same moment.

Slip is the net displacement of a part's surface along the object's surface, in the object's frame, since the
part began to press; within a probe, since the end of the squeeze. Slip follows the material points of both
bodies at the contact, so rolling does not count and vibration does not accumulate.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...exceptions import InputError, shown
from ...types import Array, IntArray, freeze, frozen_array, value
from ..grasps import HandPoses
from ..measures import place
from ..protocol import HoldProtocol
from ..scene import OBJECT, PALM, PREFIX, Scene
from .six_directions import HoldResult, Observer, hold_test

APPROACH = ("pregrasp", "grasp", "squeeze")
"""The stages before the probes; ``pregrasp`` is a single sample at the beginning."""
PRESSES = 1e-6
"""A part presses on the object when its normal force exceeds this [N]."""
FAR = 0.2
"""Largest gap that is measured [m]; larger gaps count as this one."""


@value
class Recording:
    """A test over time: n samples, p parts of the hand, b bodies, j joints; all in world axes.

    Attributes:
        hand: Name of the hand.
        joints: (j,) joint names.
        parts: (p,) ``palm`` and the names of the fingers.
        stage: (n,) ``pregrasp``, ``grasp``, ``squeeze`` or the name of the probe.
        times: (n,) time from the beginning [s]; the probes follow one another.
        object_pose: (n, 7) pose of the object, position [m] and quaternion w x y z.
        bodies: (n, b, 7) pose of each body of the scene's model.
        load: (n, 6) load on the object about its centre of mass, force [N] and torque [N m].
        forces: (n, p, 3) contact force of each part on the object [N].
        points: (n, p, 3) point at which the force acts [m]: mean of the contacts weighted by normal force, or
            the object's position if the part does not press.
        normal: (n, p) sum of the normal forces [N].
        tangential: (n, p) length of the sum of the friction forces [N].
        slip: (n, p) slip of each part, as defined in the module's docstring [m].
        torques: (n, j) actuator torques at the joints [N m].
        gap: (n,) least distance between hand and object, negative where they overlap [m].
    """

    hand: str
    joints: tuple[str, ...]
    parts: tuple[str, ...]
    stage: tuple[str, ...]
    times: Array
    object_pose: Array
    bodies: Array
    load: Array
    forces: Array
    points: Array
    normal: Array
    tangential: Array
    slip: Array
    torques: Array
    gap: Array

    def __post_init__(self) -> None:
        n, p, j = len(self.stage), len(self.parts), len(self.joints)
        shapes: dict[str, tuple[int | None, ...]] = {
            "times": (n,), "object_pose": (n, 7), "bodies": (n, None, 7), "load": (n, 6),
            "forces": (n, p, 3), "points": (n, p, 3), "normal": (n, p), "tangential": (n, p),
            "slip": (n, p), "torques": (n, j), "gap": (n,),
        }  # fmt: skip
        for name, shape in shapes.items():
            freeze(self, **{name: frozen_array(getattr(self, name), shape, f"recording: {name}")})

    def __len__(self) -> int:
        return len(self.stage)

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the recorded stages, in their order."""
        return tuple(dict.fromkeys(self.stage))

    def span(self, stage: str) -> slice:
        """The samples of one stage.

        Raises:
            InputError: The stage was not recorded.
        """
        if stage not in self.stage:
            raise InputError(f"no stage {shown(stage)} in the recording; known: {', '.join(self.stages)}")
        start = self.stage.index(stage)
        return slice(start, start + self.stage.count(stage))

    def largest_force(self, stage: str) -> float:
        """Largest normal force of one part in a stage [N]."""
        return float(self.normal[self.span(stage)].max(initial=0.0))

    def largest_slip(self, stage: str) -> float:
        """Largest slip of one part in a stage [m]."""
        return float(self.slip[self.span(stage)].max(initial=0.0))

    def moved(self, stage: str) -> tuple[float, float]:
        """Largest displacement [m] and rotation [rad] of the object in a stage, from its first pose."""
        poses, first = self.object_pose[self.span(stage)], self.object_pose[0]
        away = np.linalg.norm(poses[:, :3] - first[:3], axis=1)
        turn = 2.0 * np.arccos(np.clip(np.abs(poses[:, 3:] @ first[3:]), 0.0, 1.0))
        return float(away.max()), float(turn.max())


@value
class HoldRecording(Recording):
    """A holding test over time.

    Attributes:
        result: Result of the test.
    """

    result: HoldResult


def record_hold(
    scene: Scene,
    poses: HandPoses,
    protocol: HoldProtocol,
    *,
    probes: Sequence[str] | None = None,
    parts: Sequence[str] = (),
    row: int = 0,
    object_name: str = "",
    scale: float = 1.0,
    observer: Observer | None = None,
) -> HoldRecording:
    """Run and record a holding test; recording does not change its result.

    Args:
        scene: Scene of hand and object.
        poses: The grasp.
        protocol: Settings of the test.
        probes: Names of the probes to record; by default all. The other probes run without being recorded.
        parts: Names of palm and fingers in the order of ``scene.part_of_body``; by default ``palm``,
            ``finger 1`` ….
        row: Row for the result.
        object_name: Name of the object for the result.
        scale: Scale for the result.
        observer: Called at every check too, after the recorder.

    Raises:
        InputError: The protocol has no such probe, or the number of names is wrong.
    """
    known = [probe.name for probe in protocol.loads()]
    unknown = [name for name in probes or () if name not in known]
    if unknown:
        raise InputError(f"no probe {unknown[0]!r} in the test; known: {', '.join(known)}")
    recorder = Recorder(scene, {*APPROACH, *(known if probes is None else probes)}, parts)
    recorder.first(poses)
    result = hold_test(
        scene, poses, protocol,
        row=row, object_name=object_name, scale=scale, observer=both(recorder, observer),
    )  # fmt: skip
    return HoldRecording(result=result, **recorder.fields())


def both(first: Observer, second: Observer | None) -> Observer:
    """An observer that calls two, the second if there is one."""

    def observer(stage: str, data: Any) -> None:
        first(stage, data)
        if second is not None:
            second(stage, data)

    return observer


class Recorder:
    """The observer of a test: each call takes one sample.

    Args:
        scene: The scene.
        wanted: Names of the stages to record.
        parts: Names of palm and fingers in the order of ``scene.part_of_body``; by default ``palm``,
            ``finger 1`` ….
        one_run: Names of the stages that follow each other; every other stage is a probe, which starts from
            the end of the last of them.

    Raises:
        InputError: The number of names is wrong.
    """

    def __init__(
        self, scene: Scene, wanted: set[str], parts: Sequence[str] = (), *, one_run: Sequence[str] = APPROACH
    ) -> None:
        self.scene, self.wanted, self.one_run = scene, wanted, one_run
        self.parts = tuple(parts) or ("palm", *(f"finger {k + 1}" for k in range(scene.fingers)))
        if len(self.parts) != scene.fingers + 1:
            raise InputError(f"the hand has a palm and {scene.fingers} fingers, got {len(self.parts)} names")
        self.rows: list[dict[str, Any]] = []
        self.recorded: set[str] = set()
        self.running, self.repeated = "", False
        joints = [scene.model.joint(PREFIX + joint) for joint in scene.joints]
        self.speeds = np.array([int(joint.dofadr[0]) for joint in joints], dtype=np.int64)
        bodies = scene.model.geom_bodyid
        # Visual geoms do not collide, so they are left out of the gap.
        solid = (scene.model.geom_contype | scene.model.geom_conaffinity) != 0
        own = scene.part_of_body[bodies]
        self.geoms = np.flatnonzero((own >= PALM) & solid), np.flatnonzero(own == OBJECT)
        self.end = self.started = 0.0
        self.shift = np.zeros((scene.fingers + 1, 3))
        self.before: _State | None = None
        self.squeezed: _State | None = None

    def first(self, poses: HandPoses) -> None:
        """Sample the pregrasp at rest, before the test."""
        import mujoco

        data = mujoco.MjData(self.scene.model)
        place(self.scene, data, poses.pregrasp, poses.object_pose)
        mujoco.mj_forward(self.scene.model, data)
        self("pregrasp", data)

    def __call__(self, name: str, data: Any) -> None:
        """Take a sample of a stage."""
        scene, begins = self.scene, self.running != name
        # The ladder repeats the probes; the repetitions are not recorded.
        repeated = name in self.recorded if begins else self.repeated
        self.running, self.repeated = name, repeated
        if name not in self.wanted or repeated:
            return
        self.recorded.add(name)
        if begins and self.rows:
            self.end = self.rows[-1]["times"]
            if name not in self.one_run:  # each probe starts from the squeezed grasp
                self.squeezed = self.squeezed or self.before
                self.before, self.shift = self.squeezed, np.zeros_like(self.shift)
        if begins:
            self.started = self.squeezed.time if self.squeezed else (self.before.time if self.before else 0.0)
        state = _State(scene, data)
        if self.before is not None:
            self.shift = self.shift + self.before.slid(state)
        self.before = state
        self.rows.append(
            {
                "stage": name,
                "times": self.end + float(data.time) - self.started,
                "object_pose": state.bodies[scene.object_body],
                "bodies": state.bodies,
                "load": np.array(data.xfrc_applied[scene.object_body]),
                "forces": state.forces,
                "points": state.points,
                "normal": state.normal,
                "tangential": state.tangential,
                "slip": np.linalg.norm(self.shift, axis=1),
                "torques": np.array(data.qfrc_actuator[self.speeds]),
                "gap": self._gap(data),
            }
        )

    def fields(self) -> dict[str, Any]:
        """The fields of a :class:`Recording` with the samples so far."""
        columns = {
            name: np.array([sample[name] for sample in self.rows]) for name in self.rows[0] if name != "stage"
        }
        stage = tuple(sample["stage"] for sample in self.rows)
        scene = self.scene
        return {"hand": scene.hand, "joints": scene.joints, "parts": self.parts, "stage": stage, **columns}

    def _gap(self, data: Any) -> float:
        import mujoco

        geoms, model = np.asarray(data.contact.geom).reshape(-1, 2), self.scene.model
        pairs = self.scene.part_of_body[model.geom_bodyid[geoms]]
        meets = (pairs == OBJECT).any(axis=1) & (pairs >= PALM).any(axis=1)
        if meets.any():
            return float(np.asarray(data.contact.dist)[meets].min())
        least = FAR
        for own in self.geoms[0]:
            for other in self.geoms[1]:
                least = min(least, mujoco.mj_geomDistance(model, data, int(own), int(other), least, None))
        return float(least)


class _State:
    """Poses and contact forces at one sample."""

    def __init__(self, scene: Scene, data: Any) -> None:
        import mujoco

        self.scene, self.time = scene, float(data.time)
        self.bodies = np.concatenate([data.xpos, data.xquat], axis=1)
        self.rotations = np.array(data.xmat).reshape(-1, 3, 3)
        count = scene.fingers + 1
        friction, weighted = np.zeros((count, 3)), np.zeros((count, 3))
        self.forces, self.normal = np.zeros((count, 3)), np.zeros(count)
        self.contacts: list[tuple[int, int, Array, Array, float]] = []  # part, body, point, normal, force
        geoms = np.asarray(data.contact.geom).reshape(-1, 2)
        bodies: IntArray = scene.model.geom_bodyid[geoms].reshape(-1, 2)
        parts = scene.part_of_body[bodies]
        found = np.zeros(6)
        for index in np.flatnonzero((parts == OBJECT).any(axis=1) & (parts >= PALM).any(axis=1)):
            mujoco.mj_contactForce(scene.model, data, int(index), found)
            if found[0] <= PRESSES:
                continue
            # The frame's first axis points from the first geom to the second, on which the force acts.
            second = parts[index, 1] == OBJECT
            axes = np.array(data.contact.frame[index]).reshape(3, 3) * (1.0 if second else -1.0)
            part, body = int(parts[index].max()), int(bodies[index, 0 if second else 1])
            point = np.array(data.contact.pos[index])
            self.forces[part] += found[:3] @ axes
            friction[part] += found[1:3] @ axes[1:]
            self.normal[part] += found[0]
            weighted[part] += found[0] * point
            self.contacts.append((part, body, point, axes[0], float(found[0])))
        self.tangential = np.linalg.norm(friction, axis=1)
        pressing = self.normal > 0
        self.points = np.tile(self.bodies[scene.object_body, :3], (count, 1))
        self.points[pressing] = weighted[pressing] / self.normal[pressing, None]

    def slid(self, after: _State) -> Array:
        """(parts, 3) slip of each part until a later sample, in the object's frame [m].

        It is zero for a part that does not press at both samples.
        """
        total, own = np.zeros_like(self.forces), self.scene.object_body
        for part, body, point, normal, force in self.contacts:
            if after.normal[part] > 0:
                apart = self._carried(after, body, point) - self._carried(after, own, point)
                along = apart - (apart @ normal) * normal
                total[part] += force / self.normal[part] * (self.rotations[own].T @ along)
        return total

    def _carried(self, after: _State, body: int, point: Array) -> Array:
        """(3,) later position of a point that is fixed in a body [m]."""
        local = self.rotations[body].T @ (point - self.bodies[body, :3])
        return np.asarray(after.rotations[body] @ local + after.bodies[body, :3])
