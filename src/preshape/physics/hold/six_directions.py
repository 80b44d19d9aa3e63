"""The holding test: pregrasp, grasp, squeeze, then a load on the object; does the hand keep it?

For each probe: reset to the pregrasp; move to the grasp, then to the squeeze, each ``stages`` interpolation
steps of ``stage_steps`` simulation steps; apply the load at the object's centre of mass; look at the object
every ``check_steps`` steps. The way to the squeeze is the same for every probe and MuJoCo is deterministic,
so it is simulated once and its state, solver warm start included, is put back for each probe: the same
numbers to the last bit as six full runs.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ...types import Array, value
from ..measures import GraspGeometry, depths, geometry, place, touching
from ..protocol import HoldProtocol, Probe
from ..scene import Scene

Observer = Callable[[str, Any], None]
"""Called with ``grasp``, ``squeeze`` or a probe's name, and the ``mujoco.MjData``, while a test runs."""


class HoldStatus(enum.Enum):
    """How a holding test ended; the value is what people read."""

    HELD = "held against every probe"
    LOST = "lost the object"
    PENETRATES = "the pregrasp cuts too deep into the object or the hand"
    UNSTABLE = "the simulation became unstable"
    INVALID = "the grasp could not be tested"


@value
class ProbeResult:
    """One load.

    Attributes:
        name: the probe's.
        held: whether the object stayed.
        displacement: of the object's frame, the largest seen [m].
        rotation: of the object, the largest seen [rad].
    """

    name: str
    held: bool
    displacement: float
    rotation: float


@value
class HoldResult:
    """Everything about one grasp in one test.

    Attributes:
        row: of the grasp in its set.
        object_name: the object's.
        scale: factor on the object's size, as given.
        status: how it ended.
        reason: one sentence.
        probes: the loads that were tried, in order.
        strength: the last factor on all loads that was held, 0 if not even 1; ``None`` without ladder.
        at_grasp: distances at the grasp pose; ``None`` for a grasp that could not be tested.
        touching_at_grasp: parts (fingers, palm) that press on the object when the hand has come to the grasp.
        touching_at_squeeze: … when it has come to the squeeze.
        only_by_squeeze: it held, but at the grasp pose fewer than two parts touch (are nearer than the
            contact distance): the squeeze, not the grasp, found the object [C].
        clean: it held, with two parts touching, and cuts into the object less than a millimetre.
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
        """Whether the grasp passes."""
        return self.status is HoldStatus.HELD


@value
class Hold:
    """How the way to the squeeze went.

    Attributes:
        at_grasp: distances at the grasp pose.
        failure: why the test ends here; ``None`` where the hand squeezes.
        reason: one sentence on the failure.
        touching_at_grasp: parts (fingers, palm) that press on the object when the hand has come to the grasp.
        touching_at_squeeze: … when it has come to the squeeze.
    """

    at_grasp: GraspGeometry
    failure: HoldStatus | None = None
    reason: str = ""
    touching_at_grasp: int = 0
    touching_at_squeeze: int = 0


def hold_test(
    scene: Scene,
    pregrasp: Array,
    grasp: Array,
    squeeze: Array,
    object_pose: Array,
    protocol: HoldProtocol,
    *,
    row: int = 0,
    object_name: str = "",
    scale: float = 1.0,
    observer: Observer | None = None,
) -> HoldResult:
    """Test one grasp.

    Args:
        scene: of hand and object.
        pregrasp: (7 + joints) root pose x y z w x y z in the world and joint angles [m, rad].
        grasp: the same, where the hand touches.
        squeeze: the same, the targets that press.
        object_pose: (7,) in the world.
        protocol: the test's numbers; friction, mass and gains are the scene's already.
        row: repeated in the result, as are the next two.
        object_name: see there.
        scale: see there.
        observer: called after every few simulation steps, for pictures and tables.
    """
    import mujoco

    model, data = scene.model, mujoco.MjData(scene.model)
    label: dict[str, Any] = {"row": row, "object_name": object_name, "scale": scale}
    hold = take_hold(scene, data, pregrasp, grasp, squeeze, object_pose, protocol, observer=observer)
    at_grasp = hold.at_grasp
    if hold.failure is not None:
        return HoldResult(status=hold.failure, reason=hold.reason, at_grasp=at_grasp, **label)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)

    def probe(load: Probe, factor: float) -> ProbeResult:
        mujoco.mj_setState(model, data, state, kind)
        return _load(scene, data, load, factor, object_pose, protocol, observer)

    results: list[ProbeResult] = []
    for load in protocol.loads():
        results.append(probe(load, 1.0))
        if protocol.stop_early and not results[-1].held:
            break
    lost = [result for result in results if not result.held]
    strength = None
    if protocol.ladder:
        strength = 0.0 if lost else _climb(probe, protocol)
    shaken = unstable(data)
    held = not lost and not shaken
    status = HoldStatus.HELD if held else (HoldStatus.UNSTABLE if shaken else HoldStatus.LOST)
    touches = at_grasp.parts >= 2
    return HoldResult(
        status=status,
        reason=_sentence(status, lost, len(results), protocol),
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
    pregrasp: Array,
    grasp: Array,
    squeeze: Array,
    object_pose: Array,
    protocol: HoldProtocol,
    *,
    observer: Observer | None = None,
) -> Hold:
    """Bring the hand from the pregrasp to the grasp and to the squeeze; every test begins with it.

    ``data``, a fresh ``mujoco.MjData`` of the scene, is left where the hand squeezes, or where it failed. The
    other arguments are those of :func:`hold_test`.
    """
    place(scene, data, grasp, object_pose)
    at_grasp = geometry(scene, data, protocol.contact_distance)
    place(scene, data, pregrasp, object_pose)
    into_object, into_itself = depths(scene, data)
    if max(into_object, into_itself) > protocol.penetration_limit:
        what, depth = ("object", into_object) if into_object >= into_itself else ("hand", into_itself)
        reason = (
            f"the pregrasp cuts {depth * 1e3:.1f} mm into the {what}; "
            f"at most {protocol.penetration_limit * 1e3:g} mm are allowed"
        )
        return Hold(at_grasp=at_grasp, failure=HoldStatus.PENETRATES, reason=reason)
    _move(scene, data, pregrasp, grasp, protocol, "grasp", observer)
    at = touching(scene, data)
    _move(scene, data, grasp, squeeze, protocol, "squeeze", observer)
    squeezed = touching(scene, data)
    if unstable(data):
        reason = "the simulation became unstable in the squeeze"
        return Hold(at_grasp=at_grasp, failure=HoldStatus.UNSTABLE, reason=reason)
    return Hold(at_grasp=at_grasp, touching_at_grasp=at, touching_at_squeeze=squeezed)


def slerp(first: Array, second: Array, share: float) -> Array:
    """(4,) quaternion wxyz a fraction ``share`` of the short way from one rotation to another."""
    from scipy.spatial.transform import Rotation, Slerp

    ends = Rotation.from_quat(np.array([first, second]), scalar_first=True)
    return np.asarray(Slerp([0.0, 1.0], ends)(share).as_quat(scalar_first=True))


def unstable(data: Any) -> bool:
    """Whether MuJoCo met numbers that are not finite or too large since the last reset."""
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
    """Take the hand's targets from ``start`` to ``end``, in equal steps, without ``start`` itself."""
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
    import mujoco

    data.xfrc_applied[scene.object_body] = factor * load.wrench
    at = scene.object_address
    farthest = widest = 0.0
    for _ in range(protocol.checks):
        if observer is None:
            mujoco.mj_step(scene.model, data, protocol.check_steps)
        else:
            for done in range(0, protocol.check_steps, 10):
                mujoco.mj_step(scene.model, data, min(10, protocol.check_steps - done))
                observer(load.name, data)
        pose = data.qpos[at : at + 7]
        farthest = max(farthest, float(np.linalg.norm(pose[:3] - object_pose[:3])))
        widest = max(widest, 2.0 * math.acos(min(1.0, abs(float(pose[3:] @ object_pose[3:])))))
        # MuJoCo resets a scene that blew up, which would look like an object that never moved.
        if unstable(data) or farthest >= protocol.displacement_limit or widest >= protocol.rotation_limit:
            return ProbeResult(name=load.name, held=False, displacement=farthest, rotation=widest)
    return ProbeResult(name=load.name, held=True, displacement=farthest, rotation=widest)


def _climb(probe: Callable[[Probe, float], ProbeResult], protocol: HoldProtocol) -> float:
    """The last factor on the ladder at which every probe was held."""
    held = 1.0
    for _ in range(protocol.ladder_rungs):
        factor = held * protocol.ladder_factor
        if not all(probe(load, factor).held for load in protocol.loads()):
            break
        held = factor
    return held


def _sentence(status: HoldStatus, lost: list[ProbeResult], tried: int, protocol: HoldProtocol) -> str:
    if status is not HoldStatus.LOST:
        return status.value
    first = lost[0]
    far = first.displacement >= protocol.displacement_limit
    how = f"moved {first.displacement * 1e3:.0f} mm" if far else f"turned {math.degrees(first.rotation):.0f}°"
    more = f", and {len(lost) - 1} more of {tried}" if len(lost) > 1 else ""
    return f"lost the object: it {how} under {first.name}{more}"
