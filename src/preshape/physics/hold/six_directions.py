"""The holding test, in which the hand squeezes the object and must hold it while loads push it.

The steps of the test are

1. measure distances at the grasp pose;
2. reset to the pregrasp, and fail if it penetrates the object or the hand too deeply;
3. move to the grasp, then to the squeeze, each in ``stages`` interpolation steps of ``stage_steps``
   simulation steps;
4. for each probe: restore the state of the squeeze, apply the load at the object's centre of mass, and check
   every ``check_steps`` simulation steps how far the object has moved and turned;
5. with the ladder, repeat step 4 with stronger loads until the hand loses the object.

The field's test repeats steps 2 and 3 for each probe. Because MuJoCo is deterministic, they are simulated
only once here. The saved state includes the solver's warm start, so the results are equal to the last bit.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ...types import Array, value
from ..grasps import HandPoses
from ..measures import GraspGeometry, depths, geometry, place, touching
from ..protocol import HoldProtocol, Probe
from ..scene import Scene

Observer = Callable[[str, Any], None]
"""Called while a test runs, with ``grasp``, ``squeeze`` or the name of a probe, and the ``mujoco.MjData``."""


class HoldStatus(enum.Enum):
    """Outcome of a holding test; the values are texts for the user."""

    HELD = "held against every probe"
    LOST = "lost the object"
    PENETRATES = "the pregrasp cuts too deep into the object or the hand"
    UNSTABLE = "the simulation became unstable"
    INVALID = "the grasp could not be tested"


@value
class ProbeResult:
    """Result of one probe.

    Attributes:
        name: Name of the probe.
        held: Whether the object stayed within the limits.
        displacement: Largest displacement of the object's frame at a check [m].
        rotation: Largest rotation of the object at a check [rad].
    """

    name: str
    held: bool
    displacement: float
    rotation: float


@value
class HoldResult:
    """Result of the holding test of one grasp.

    Attributes:
        row: Row of the grasp in its set.
        object_name: Name of the object.
        scale: Factor on the object's size, as given by the grasp.
        status: Outcome.
        reason: One sentence on the outcome.
        probes: Results of the probes, in their order.
        strength: Largest load factor of the ladder at which every probe was held; 0 if a probe was lost at
            factor 1; ``None`` without a ladder.
        at_grasp: Distances at the grasp pose; ``None`` for a grasp that could not be tested.
        touching_at_grasp: Number of parts (fingers and palm) that press on the object at the grasp.
        touching_at_squeeze: Number of parts that press on the object after the squeeze.
        only_by_squeeze: Whether the grasp held although fewer than two parts touch at the grasp pose, so that
            the squeeze rather than the grasp reached the object [C].
        clean: Whether the grasp held, and at the grasp pose has two or more parts in contact and penetrates
            the object less than ``HoldProtocol.clean_penetration``.
    """

    row: int
    object_name: str
    scale: float
    status: HoldStatus
    reason: str
    probes: tuple[ProbeResult, ...] = ()
    strength: float | None = None
    at_grasp: GraspGeometry | None = None
    touching_at_grasp: int = 0
    touching_at_squeeze: int = 0
    only_by_squeeze: bool = False
    clean: bool = False

    @property
    def held(self) -> bool:
        """Whether the grasp held."""
        return self.status is HoldStatus.HELD


@value
class Hold:
    """Result of the motion to the squeeze.

    Attributes:
        at_grasp: Distances at the grasp pose.
        failure: Status with which the test ends here; ``None`` if the hand reached the squeeze.
        reason: One sentence on the failure.
        touching_at_grasp: Number of parts (fingers and palm) that press on the object at the grasp.
        touching_at_squeeze: Number of parts that press on the object after the squeeze.
    """

    at_grasp: GraspGeometry
    failure: HoldStatus | None = None
    reason: str = ""
    touching_at_grasp: int = 0
    touching_at_squeeze: int = 0


def hold_test(
    scene: Scene,
    poses: HandPoses,
    protocol: HoldProtocol,
    *,
    row: int = 0,
    object_name: str = "",
    scale: float = 1.0,
    observer: Observer | None = None,
) -> HoldResult:
    """Test one grasp.

    Args:
        scene: Scene of hand and object, built with the same protocol.
        poses: The grasp.
        protocol: Settings of the test.
        row: Row for the result.
        object_name: Name of the object for the result.
        scale: Scale for the result.
        observer: Called after every few simulation steps, for pictures and tables.
    """
    import mujoco

    model, data = scene.model, mujoco.MjData(scene.model)
    label: dict[str, Any] = {"row": row, "object_name": object_name, "scale": scale}
    hold = take_hold(scene, data, poses, protocol, observer=observer)
    at_grasp = hold.at_grasp
    if hold.failure is not None:
        return HoldResult(status=hold.failure, reason=hold.reason, at_grasp=at_grasp, **label)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)

    def probe(load: Probe, factor: float) -> ProbeResult:
        mujoco.mj_setState(model, data, state, kind)
        return _load(scene, data, load, factor, poses.object_pose, protocol, observer)

    results: list[ProbeResult] = []
    for load in protocol.loads():
        results.append(probe(load, 1.0))
        if protocol.stop_early and not results[-1].held:
            break
    lost = [result for result in results if not result.held]
    strength = None
    if protocol.ladder:
        strength = 0.0 if lost else _climb(probe, protocol)
    blown_up = unstable(data)
    held = not lost and not blown_up
    status = HoldStatus.HELD if held else (HoldStatus.UNSTABLE if blown_up else HoldStatus.LOST)
    touches = at_grasp.parts >= 2
    return HoldResult(
        status=status,
        reason=_reason(status, lost, len(results), protocol),
        probes=tuple(results),
        strength=strength,
        at_grasp=at_grasp,
        touching_at_grasp=hold.touching_at_grasp,
        touching_at_squeeze=hold.touching_at_squeeze,
        only_by_squeeze=held and not touches,
        clean=held and touches and at_grasp.penetration < protocol.clean_penetration,
        **label,
    )


def take_hold(
    scene: Scene,
    data: Any,
    poses: HandPoses,
    protocol: HoldProtocol,
    *,
    observer: Observer | None = None,
) -> Hold:
    """Move the hand from the pregrasp to the grasp and on to the squeeze, as every test begins.

    On return, ``data``, a new ``mujoco.MjData`` of the scene, is in the state of the squeeze, or in that of
    the failure. The other arguments are those of :func:`hold_test`.
    """
    place(scene, data, poses.grasp, poses.object_pose)
    at_grasp = geometry(scene, data, protocol.contact_distance)
    place(scene, data, poses.pregrasp, poses.object_pose)
    into_object, into_itself = depths(scene, data)
    if max(into_object, into_itself) > protocol.penetration_limit:
        body, depth = ("object", into_object) if into_object >= into_itself else ("hand", into_itself)
        reason = (
            f"the pregrasp cuts {depth * 1e3:.1f} mm into the {body}; "
            f"at most {protocol.penetration_limit * 1e3:g} mm are allowed"
        )
        return Hold(at_grasp=at_grasp, failure=HoldStatus.PENETRATES, reason=reason)
    _move(scene, data, poses.pregrasp, poses.grasp, protocol, "grasp", observer)
    touching_at_grasp = touching(scene, data)
    _move(scene, data, poses.grasp, poses.squeeze, protocol, "squeeze", observer)
    touching_at_squeeze = touching(scene, data)
    if unstable(data):
        reason = "the simulation became unstable in the squeeze"
        return Hold(at_grasp=at_grasp, failure=HoldStatus.UNSTABLE, reason=reason)
    return Hold(
        at_grasp=at_grasp, touching_at_grasp=touching_at_grasp, touching_at_squeeze=touching_at_squeeze
    )


def slerp(first: Array, second: Array, share: float | Array) -> Array:
    """(..., 4) quaternion wxyz at fractions ``share`` (...) of the shortest rotation between two."""
    from scipy.spatial.transform import Rotation, Slerp

    ends = Rotation.from_quat(np.array([first, second]), scalar_first=True)
    return np.asarray(Slerp([0.0, 1.0], ends)(share).as_quat(scalar_first=True))


def unstable(data: Any) -> bool:
    """Whether MuJoCo has met numbers that are not finite or too large since the last reset."""
    import mujoco

    bad = (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
    return any(data.warning[int(kind)].number > 0 for kind in bad)


def _move(
    scene: Scene,
    data: Any,
    start: Array,
    end: Array,
    protocol: HoldProtocol,
    name: str,
    observer: Observer | None,
) -> None:
    """Move the hand's targets from ``start`` (not applied itself) to ``end`` in equal steps."""
    import mujoco

    for stage in range(1, protocol.stages + 1):
        share = stage / protocol.stages
        target = (1 - share) * start + share * end
        if scene.root_address >= 0:
            data.mocap_pos[0] = target[:3]
            data.mocap_quat[0] = slerp(start[3:7], end[3:7], share)
            data.ctrl[:] = scene.controls @ target[7:]
        mujoco.mj_step(scene.model, data, protocol.stage_steps)
        if observer is not None:
            observer(name, data)


def _load(
    scene: Scene,
    data: Any,
    load: Probe,
    factor: float,
    object_pose: Array,
    protocol: HoldProtocol,
    observer: Observer | None,
) -> ProbeResult:
    """Apply one load and check the object; ``data`` is at the squeeze."""
    import mujoco

    data.xfrc_applied[scene.object_body] = factor * load.wrench
    at = scene.object_address
    displacement = rotation = 0.0
    for _ in range(protocol.checks):
        if observer is None:
            mujoco.mj_step(scene.model, data, protocol.check_steps)
        else:
            for done in range(0, protocol.check_steps, 10):
                mujoco.mj_step(scene.model, data, min(10, protocol.check_steps - done))
                observer(load.name, data)
        pose = data.qpos[at : at + 7]
        displacement = max(displacement, float(np.linalg.norm(pose[:3] - object_pose[:3])))
        rotation = max(rotation, 2.0 * math.acos(min(1.0, abs(float(pose[3:] @ object_pose[3:])))))
        moved = displacement >= protocol.displacement_limit or rotation >= protocol.rotation_limit
        # MuJoCo resets an unstable scene, so the object would seem not to have moved.
        if moved or unstable(data):
            return ProbeResult(name=load.name, held=False, displacement=displacement, rotation=rotation)
    return ProbeResult(name=load.name, held=True, displacement=displacement, rotation=rotation)


def _climb(probe: Callable[[Probe, float], ProbeResult], protocol: HoldProtocol) -> float:
    """The largest factor on the ladder at which every probe is held."""
    held = 1.0
    for _ in range(protocol.ladder_rungs):
        factor = held * protocol.ladder_factor
        if not all(probe(load, factor).held for load in protocol.loads()):
            break
        held = factor
    return held


def _reason(status: HoldStatus, lost: list[ProbeResult], tried: int, protocol: HoldProtocol) -> str:
    if status is not HoldStatus.LOST:
        return status.value
    first = lost[0]
    motion = f"turned {math.degrees(first.rotation):.0f}°"
    if first.displacement >= protocol.displacement_limit:
        motion = f"moved {first.displacement * 1e3:.0f} mm"
    others = f", and {len(lost) - 1} more of {tried}" if len(lost) > 1 else ""
    return f"lost the object: it {motion} under {first.name}{others}"
