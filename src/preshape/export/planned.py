"""From a plan's JSON to the grasps in it that a hand can execute."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import EnvironmentFailure, InputError
from ..hands.hand import Hand
from ..hands.load import load_hand
from ..tasks import Task, parse_task
from ..types import Array, freeze, frozen_array, value

FULL = 6.0
"""The largest quality and the largest TFVADI."""


@value
class PlannedGrasp:
    """One answer of a plan that the hand can execute; everything in the mesh frame.

    Attributes:
        number: 0 the plan's answer, 1 … its alternatives.
        hand: whose postures these are.
        object_name: the object's name.
        task: the task's label, as ``lift:+z``.
        up: (3,) unit vector against gravity.
        approach: (3,) unit vector along which the open hand comes straight in.
        palm_pose: (7,) palm frame at the grasp, xyz [m] and quaternion wxyz.
        pregrasp: (j,) joint angles, open and clear of the object [rad].
        grasp: (j,) where the fingers touch [rad].
        squeeze: (j,) targets of the servos that press [rad]; they may lie beyond a joint's limit.
        efforts: (j,) torques of the squeeze within the hand's limits [N m].
        points: (n, 3) contacts [m].
        normals_in: (n, 3) inward unit normals there.
        fingers: (n,) the finger at each contact.
        forces: (n, 3) of each contact on the object in the squeeze [N]; ``None`` where the plan does not say.
        quality: 0..1; 0.5 is just enough (see ``docs/ros.md``).
    """

    number: int
    hand: Hand
    object_name: str
    task: str
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

    def __post_init__(self) -> None:
        joints, contacts = len(self.hand.joints), len(self.fingers)
        for finger in self.fingers:
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


@value
class LeftOut:
    """An answer that cannot be exported.

    Attributes:
        number: 0 the plan's answer, 1 … its alternatives.
        reason: why not.
    """

    number: int
    reason: str


def read_plan(file: str | Path) -> dict[str, Any]:
    """A plan's JSON from a file, or from standard input for ``-``.

    Raises:
        InputError: not JSON, or not one plan.
        EnvironmentFailure: the file cannot be read.
    """
    try:
        text = sys.stdin.read() if str(file) == "-" else Path(file).read_text(encoding="utf-8")
    except OSError as error:
        raise EnvironmentFailure(f"cannot read {file}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{file} is not text; expected a plan in JSON (preshape plan … --json)") from error
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file} is not JSON; expected a plan (preshape plan … --json)") from error
    if not isinstance(document, dict):
        raise InputError(f"{file} is not one plan but a {type(document).__name__}; give one plan at a time")
    return document


def planned_grasps(
    document: dict[str, Any], name: str, *, hand: str | None = None, answer: int | None = None
) -> tuple[tuple[PlannedGrasp, ...], tuple[LeftOut, ...]]:
    """What of a plan can be exported, best first, and what cannot.

    Args:
        document: a parsed plan (``preshape/schema/plan.schema.json``).
        name: where it comes from, for messages.
        hand: a name or TOML file to use instead of the plan's own.
        answer: only this one, 0 the answer, 1 … the alternatives; ``None`` all.

    Raises:
        InputError: not a plan, no such answer, another hand's joints, or nothing that can be executed.
    """
    if document.get("status") == "error":
        raise InputError(f"{name} holds no plan but an error: {document.get('reason')}")
    try:
        answers = [document, *document["alternatives"]] if document["status"] == "answer" else []
        reason = str(document["reason"])
        if not answers:
            raise InputError(f"{name}: the plan has no grasp ({document['status']}: {reason})")
        if answer is not None and not 0 <= answer < len(answers):
            raise InputError(f"--answer must be 0 to {len(answers) - 1} in {name}, got {answer}")
        model = load_hand(hand or str(document["hand"]["name"]))
        picked = range(len(answers)) if answer is None else [answer]
        made = [_planned(answers[k], k, model, name) for k in picked]
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise InputError(f"{name} is not a plan of this program ({type(error).__name__}: {error})") from error
    grasps = tuple(each for each in made if isinstance(each, PlannedGrasp))
    left_out = tuple(each for each in made if isinstance(each, LeftOut))
    if not grasps:
        which = "none of its answers has" if len(made) > 1 else f"answer {made[0].number} has not"
        raise InputError(
            f"{name}: {which} a posture that the hand can execute ({left_out[0].reason}); "
            "take another answer, or plan again with another hand or approach"
        )
    return grasps, left_out


def _planned(answer: dict[str, Any], number: int, hand: Hand, name: str) -> PlannedGrasp | LeftOut:
    tried, grip = answer["hand"], answer.get("grip") or {}
    if any(tried[stage] is None for stage in ("pregrasp", "grasp", "squeeze")):
        return LeftOut(number=number, reason=str(tried["reason"] or tried["status"]))
    if set(tried["joints"]) != set(hand.joints):
        raise InputError(
            f"{name} was planned for the joints {', '.join(tried['joints'])}; "
            f"the hand {hand.name} has {', '.join(hand.joints)}: give the right one with --hand"
        )
    order = [tried["joints"].index(joint) for joint in hand.joints]
    try:
        q = {
            stage: frozen_array(tried[stage]["q"], (len(order),), f"{stage} angles")[order]
            for stage in ("pregrasp", "grasp", "squeeze")
        }
        return PlannedGrasp(
            number=number,
            hand=hand,
            object_name=str(answer["object"]["name"]),
            task=str(answer["task"]["name"]),
            up=_up(str(answer["task"]["name"])),
            # A hand that was closed may come in another way than along its plane's axis.
            approach=grip.get("approach", answer["approach_axis"]),
            palm_pose=tried["grasp"]["palm_pose"],
            efforts=_efforts(hand, q["squeeze"] - q["grasp"]),
            points=np.array([c["point"] for c in answer["contacts"]], dtype=np.float64).reshape(-1, 3),
            normals_in=np.array([c["normal_in"] for c in answer["contacts"]]).reshape(-1, 3),
            fingers=tuple(str(c["finger"]) for c in answer["contacts"]),
            # What the critic judged: the grip's quality where a hand was closed, else TFVADI.
            quality=float(np.clip(float(grip.get("quality", answer["tfvadi"])) / FULL, 0.0, 1.0)),
            forces=grip.get("forces"),
            **q,
        )
    except InputError as error:
        raise InputError(f"{name}: answer {number}: {error}") from error


def _efforts(hand: Hand, ahead: Array) -> Array:
    """(j,) torques [N m] of servos whose targets are ``ahead`` (j,) [rad] of joints that are held.

    One drive of two joints is told the sum of their angles and pulls both alike.
    """
    lead = ahead.copy()
    for couple in hand.couplings:
        both = [hand.joints.index(joint) for joint in couple]
        lead[both] = ahead[both].sum()
    return np.clip(hand.gains * lead, -hand.torque_limits, hand.torque_limits)


def _up(label: str) -> Array:
    """(3,) against the task's gravity; +z for a task that has no name."""
    try:
        gravity = parse_task(label).gravity
    except InputError:
        gravity = Task(name="custom", q=np.zeros(6)).gravity
    gravity = np.asarray(gravity, dtype=np.float64)
    return 0.0 - gravity if gravity.any() else np.array([0.0, 0.0, 1.0])
