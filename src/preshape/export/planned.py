"""The grasps of a plan that its hand can execute."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..exceptions import InputError
from ..hands.hand import Hand
from ..hands.load import load_hand, recorded_hand
from ..hiis.analyser import PALM
from ..physics.grasps import Fault
from ..planning.document import Document, lacking, no_answer, planned_load, request_of, version_of
from ..report.plain import escaped_line
from ..types import Array, freeze, frozen_array, value
from ..viewer.words import answers_of

FULL = 6.0
"""Largest quality of a grip and largest TFVADI of a virtual grasp."""


@value
class ArmPath:
    """The way of the arm that carries the hand to a grasp, and up.

    Attributes:
        joints: (n,) Names of the arm's joints.
        times: (k,) Time of each way point, which increases [s]; closing and squeezing take none here.
        q: (k, n) Positions of the joints [rad or m].
        at_grasp: Index of the way point of the grasp; those after it are the lift.

    Raises:
        InputError: An array has the wrong shape, or the times or the way points are in no order.
    """

    joints: tuple[str, ...]
    times: Array
    q: Array
    at_grasp: int

    def __post_init__(self) -> None:
        times = frozen_array(self.times, (None,), "times of the arm")
        q = frozen_array(self.q, (len(times), len(self.joints)), "way points of the arm")
        freeze(self, times=times, q=q)
        if len(times) < 2 or times[0] != 0.0 or (np.diff(times) <= 0).any():
            raise InputError("the times of the arm's way points must begin at 0 and increase")
        if not 0 <= self.at_grasp < len(times):
            raise InputError("the arm's path has no way point at the grasp")


@value
class PlannedGrasp:
    """One grasp of a plan that the hand can execute; everything in the mesh frame.

    Attributes:
        number: 0 for the plan's answer, from 1 for its alternatives.
        hand: The hand.
        object_name: Name of the object.
        task: Label of the task, such as ``lift:+z``.
        mass: Mass of the object in the plan [kg].
        friction: Friction coefficient in the plan.
        up: (3,) Unit vector against gravity.
        approach: (3,) Unit vector along which the open hand moves straight to the object.
        palm_pose: (7,) Pose of the palm frame at the grasp, xyz [m] and quaternion wxyz.
        pregrasp: (j,) Joint angles of the open hand, clear of the object [rad].
        grasp: (j,) Joint angles at which the fingers touch the object [rad].
        squeeze: (j,) Servo targets of the squeeze [rad]; they may lie beyond a joint's limit.
        efforts: (j,) Torques that the motors put on the joints in the squeeze, within their limits [N m].
        points: (n, 3) Contact points [m].
        normals_in: (n, 3) Inward unit normals at the contact points.
        fingers: (n,) Name of the finger at each contact.
        lacking: Why the grasp must not be executed, if it is the best of a plan without an answer.
        forces: (n, 3) Force of each contact on the object in the squeeze [N]; ``None`` if the plan does not
            state it.
        arm: Path of the arm; ``None`` without an arm, or one that does not reach the grasp.
        quality: Quality 0..1; at 0.5, the grasp just balances the load (see ``docs/ros.md``).

    Raises:
        InputError: An array has the wrong shape, a direction is no unit vector, or the hand does not have a
            named finger.
    """

    number: int
    hand: Hand
    object_name: str
    task: str
    mass: float
    friction: float
    up: Array
    approach: Array
    palm_pose: Array
    pregrasp: Array
    grasp: Array
    squeeze: Array
    efforts: Array
    points: Array
    normals_in: Array
    fingers: tuple[str, ...]
    quality: float
    forces: Array | None = None
    lacking: str = ""
    arm: ArmPath | None = None

    @property
    def motor_torques(self) -> Array:
        """(m,) Torques of the motors in the squeeze, within their limits [N m]."""
        return motor_torques(self.hand, self.grasp, self.squeeze)

    @property
    def label(self) -> str:
        """``best`` for the best grasp of a plan without an answer, else the answer's number."""
        return "best" if self.lacking else str(self.number)

    @property
    def warning(self) -> str:
        """What a reader of the export must know of a grasp that is no answer; empty for an answer."""
        return f"best grasp of a plan without an answer; executable: false; {self.lacking}" * bool(
            self.lacking
        )

    def __post_init__(self) -> None:
        joints, contacts = len(self.hand.joints), len(self.fingers)
        for finger in self.fingers:
            if finger != PALM:
                self.hand.finger(finger)
        freeze(
            self,
            up=frozen_array(self.up, (3,), "up"),
            approach=frozen_array(self.approach, (3,), "approach axis"),
            palm_pose=frozen_array(self.palm_pose, (7,), "palm pose"),
            points=frozen_array(self.points, (contacts, 3), "contact points"),
            normals_in=frozen_array(self.normals_in, (contacts, 3), "contact normals"),
            forces=None
            if self.forces is None
            else frozen_array(self.forces, (contacts, 3), "contact forces"),
            **{
                name: frozen_array(getattr(self, name), (joints,), name)
                for name in ("pregrasp", "grasp", "squeeze", "efforts")
            },
        )
        for name, vector in (
            ("the palm pose's quaternion", self.palm_pose[3:]),
            ("the approach axis", self.approach),
        ):
            if abs(float(np.linalg.norm(vector)) - 1.0) > 0.01:
                raise InputError(f"{name} must have length 1, got {vector}")
        frozen_array(self.quality, (), "the quality")


def planned_grasps(
    document: Document,
    name: str,
    *,
    hand: str | None = None,
    answer: int | None = None,
    best: bool = False,
) -> tuple[tuple[PlannedGrasp, ...], tuple[Fault, ...]]:
    """The grasps of a plan that can be exported, in the plan's order, and the answers that cannot.

    Args:
        document: The plan (``preshape/schema/plan.schema.json``).
        name: File of the plan, for messages.
        hand: Name or TOML file of a hand to use instead of the plan's own.
        answer: Number of the single answer to take, 0 for the plan's answer, from 1 for the alternatives;
            ``None`` takes all.
        best: Whether to take the best grasp that was found if the plan has no answer.

    Raises:
        InputError: The document is no plan, has no such answer or no executable one, or was made for another
            hand.
    """
    try:
        answers = answers_of(document, best=best)
        if not answers:
            raise InputError(f"{name}: {no_answer(document)}")
        if answer is not None and not 0 <= answer < len(answers):
            raise InputError(f"--answer must be 0 to {len(answers) - 1} in {name}, got {answer}")
        model = load_hand(hand) if hand else recorded_hand(document["hand"])
        chosen = range(len(answers)) if answer is None else [answer]
        mass, friction = planned_load(document)
        facts = {"mass": mass, "friction": friction, "up": _up(document)}
        if answers[0] is document.get("best"):
            facts["lacking"] = escaped_line(lacking(document))
        candidates = [_planned(answers[k], k, model, facts, name) for k in chosen]
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise InputError(f"{name} is not a plan of this program ({type(error).__name__}: {error})") from error
    grasps = tuple(each for each in candidates if isinstance(each, PlannedGrasp))
    left_out = tuple(each for each in candidates if isinstance(each, Fault))
    if not grasps:
        which = "its best grasp has no" if "lacking" in facts else f"answer {chosen[0]} has no"
        which = "none of its answers has a" if len(candidates) > 1 else which
        raise InputError(
            f"{name}: {which} posture that the hand can execute ({left_out[0].reason}); "
            "take another answer, or plan again with another hand or approach"
        )
    return grasps, left_out


def _planned(
    answer: Document, number: int, hand: Hand, facts: dict[str, Any], name: str
) -> PlannedGrasp | Fault:
    tried = answer["hand"]
    grip: Any = answer.get("grip") or {}
    if any(tried[stage] is None for stage in ("pregrasp", "grasp", "squeeze")):
        return Fault(row=number, reason=str(tried["reason"] or tried["status"]))
    if set(tried["joints"]) != set(hand.joints):
        raise InputError(
            f"{name} was planned for the joints {', '.join(tried['joints'])}; "
            f"the hand {hand.name} has {', '.join(hand.joints)}: give the right one with --hand"
        )
    order = [tried["joints"].index(joint) for joint in hand.joints]
    try:
        q: dict[str, Any] = {
            stage: frozen_array(tried[stage]["q"], (len(order),), f"{stage} angles")[order]
            for stage in ("pregrasp", "grasp", "squeeze")
        }
        return PlannedGrasp(
            number=number,
            hand=hand,
            object_name=escaped_line(answer["object"]["name"]),
            task=escaped_line(answer["task"]["name"]),
            # The way in of a grip may differ from the approach axis of its plane.
            approach=grip.get("approach", answer["approach_axis"]),
            palm_pose=tried["grasp"]["palm_pose"],
            # An actuator acts on its joints in proportion to their part in its command.
            efforts=motor_torques(hand, q["grasp"], q["squeeze"]) @ hand.command_matrix(),
            points=np.array([c["point"] for c in answer["contacts"]], dtype=np.float64).reshape(-1, 3),
            normals_in=np.array([c["normal_in"] for c in answer["contacts"]]).reshape(-1, 3),
            fingers=tuple(str(c["finger"]) for c in answer["contacts"]),
            # The number that the critic judges: quality of a grip, TFVADI of a virtual grasp.
            quality=float(np.clip(float(grip.get("quality", answer["tfvadi"])) / FULL, 0.0, 1.0)),
            forces=grip.get("forces"),
            arm=_arm_path(answer.get("arm")),
            **q,
            **facts,
        )
    except InputError as error:
        raise InputError(f"{name}: answer {number}: {error}") from error


def _arm_path(arm: Document | None) -> ArmPath | None:
    """The path of the ``arm`` of an answer."""
    path = (arm or {}).get("path")
    if arm is None or path is None:
        return None
    names = tuple(escaped_line(name) for name in arm["joints"])
    at_grasp = list(path["stages"]).count("way_in") - 1
    return ArmPath(joints=names, times=path["times"], q=path["q"], at_grasp=at_grasp)


def motor_torques(hand: Hand, grasp: Array, squeeze: Array) -> Array:
    """(m,) Servo torques of a hand that stands at ``grasp`` (j,) and aims at ``squeeze`` (j,) [N m]."""
    lead = hand.controls(squeeze) - hand.controls(grasp)
    return np.clip(hand.gains * lead, -hand.torque_limits, hand.torque_limits)


def _up(document: Document) -> Array:
    """(3,) Unit vector against gravity while the object is lifted; +z if the plan has none."""
    scene = document.get("scene")
    if scene is not None and scene["table"] is not None:
        return frozen_array(scene["up"], (3,), "up")
    if scene is not None:
        gravity = frozen_array(scene["gravity"], (3,), "gravity")
        return 0.0 - gravity if gravity.any() else frozen_array(scene["up"], (3,), "up")
    request = document["request"] if version_of(document) >= 2 else request_of(document).to_json()
    gravity = frozen_array(request["gravity"], (3,), "gravity")
    return 0.0 - gravity if gravity.any() else np.array([0.0, 0.0, 1.0])
