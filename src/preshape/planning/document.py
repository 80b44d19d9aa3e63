"""Plans as JSON: the format that other programs read (``schema/plan.schema.json``).

Points and poses are in the mesh file's frame, in metres after scaling. Wrenches are about the COG in the
paper's units (lengths in 4U, the ``length_unit``). Quaternions are w x y z. Version 2 contains the
request. A document without the key ``schema`` is version 1 and was made for 0.1 kg, friction 0.6 and free
space.
"""

from __future__ import annotations

import json
import math
import re
import sys
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

from .._version import __version__
from ..exceptions import EnvironmentFailure, InputError, shown
from ..files import MEGABYTE, MOST_OF_JSON, loads, read_file
from ..hands.hand import Hand
from ..hiis.analyser import PALM, Grasp, Grip
from ..hiis.critic import Thresholds, judge
from ..hiis.decision import Settings
from ..hiis.fuzzy import SET_NAMES
from ..tasks import family_names, full_motion
from ..types import FIELD_MASS, FRICTION, LENGTH_UNIT, an_instance
from ..viewer.words import answers_of
from .answers import Answer, PlanRecord, missing_motion, scan_trust, shortfalls
from .grasp_type import grasp_type, held_part
from .hand_simulation import HandPose
from .request import SCHEMA, PlanRequest, analyser_of

Document = dict[str, Any]

GRASP_KEYS = (
    "plane", "flip", "approach_axis", "opposition_axis", "transverse_axis", "approach_value",
    "approach_set", "fingers", "tfvadi", "adi", "net_wrench", "stability", "manipulability",
)  # fmt: skip
_PLAN_KEYS = {"status", "hand", "object", "task", "plane"}


def plan_to_json(plan: PlanRecord) -> Document:
    """A plan as plain JSON values; see the schema for each key.

    Raises:
        InputError: It is no plan.
    """
    an_instance(plan, PlanRecord, "plan")
    document = _answer(plan, plan.answer)
    document["alternatives"] = [
        {**_answer(plan, other), "reason": _own_reason(plan, other)} for other in plan.alternatives
    ]
    document["best"] = None if plan.best is None else {**_answer(plan, plan.best), "executable": False}
    return document


def plan_schema() -> Document:
    """The JSON Schema of a plan."""
    text = (resources.files("preshape") / "schema" / "plan.schema.json").read_text(encoding="utf-8")
    schema: Document = json.loads(text)
    return schema


def read_plan(path: str | Path) -> Document:
    """Read a plan of any version, and check the parts that every reader needs.

    Args:
        path: The file, or ``-`` for standard input.

    Raises:
        InputError: The file is not JSON, not a plan, or a plan of a newer version.
        EnvironmentFailure: The file cannot be read.
    """
    advice = "give a plan.json that preshape plan --out wrote"
    try:
        if str(path) == "-":
            content = sys.stdin.buffer.read(MOST_OF_JSON + 1)
        else:
            content = read_file(path, MOST_OF_JSON, "plan")
        if len(content) > MOST_OF_JSON:
            raise InputError(f"{path} is over {MOST_OF_JSON // MEGABYTE} MB, more than a plan has; {advice}")
        document = loads(content.decode("utf-8"))
    except OSError as error:
        raise EnvironmentFailure(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(f"{path} is no JSON ({error!s:.80}); {advice}") from error
    if isinstance(document, list):
        raise InputError(f"{path} is not one plan but a list; give one plan at a time")
    if isinstance(document, dict) and document.get("status") == "error":
        raise InputError(f"{path} holds no plan but an error: {document.get('reason')}")
    if not isinstance(document, dict) or not set(document) >= _PLAN_KEYS:
        raise InputError(f"{path} is not a plan of this program; {advice}")
    version_of(document)
    return document


def version_of(document: Document) -> int:
    """Version of a plan's format; 1 if the document does not state it.

    Raises:
        InputError: The version is not a whole number, or is newer than this program's.
    """
    version = document.get("schema", 1)
    if isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise InputError(
            f"schema, the version of the plan's format, must be a whole number, got {shown(version)}"
        )
    if version > SCHEMA:
        raise InputError(
            f"the plan has format version {version}, newer than the {SCHEMA} known here; upgrade preshape"
        )
    return version


def request_of(document: Document, **changes: Any) -> PlanRequest:
    """The request that a plan answered.

    A plan of version 1 does not contain its request: it is read as 0.1 kg, friction 0.6 and free space, and
    its content shows which analyser made it. The caller derives ``scale`` from the object's extents and
    passes it among the changes.

    Args:
        document: The plan.
        changes: Fields of the request that differ, such as ``source`` if the object's file has moved.

    Raises:
        InputError: The document is not a plan of this program.
    """
    if version_of(document) >= 2:
        return PlanRequest.from_json(document.get("request") or {}, **changes)
    try:
        task = document["task"]
        known = str(task["name"]).partition(":")[0] in family_names()
        limits = document.get("thresholds") or {}
        hand = str(document["hand"]["name"])
        analyser = _analyser_of_version_1(document) or analyser_of("", hand)
        read: Document = {
            "source": str(document["object"]["source"]),
            "task": str(task["name"]) if known else [float(x) for x in task["q"]],
            "hand": hand,
            "analyser": analyser,
            "table": None,
            "mass": FIELD_MASS if analyser == "closure" else None,
            "settings": Settings(thresholds=Thresholds(**limits)),
        }
        return PlanRequest(**(read | changes))
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(
            f"this is no plan of preshape ({type(error).__name__}: {error!s:.80}); "
            "give a plan.json that preshape plan --out wrote"
        ) from error


def _analyser_of_version_1(document: Document) -> str:
    """The analyser that made a plan of version 1; empty if the plan does not show it.

    An answer of the closure analyser has a grip. Without an answer, the reasons of the steps name the score
    that the analyser gives or the hands that it closed.
    """
    answers = answers_of(document)
    if answers:
        return "closure" if any(answer.get("grip") for answer in answers) else "rays"
    reasons = " ".join(str(step["reason"]) for step in document.get("transitions", []))
    if "the grip's quality" in reasons or re.search(r"\d hands (tried|closed)", reasons):
        return "closure"
    return "rays" if "TFVADI" in reasons or "virtual grasps" in reasons else ""


def planned_load(document: Document) -> tuple[float, float]:
    """Mass [kg] and friction that a plan was made for.

    Raises:
        InputError: One of the two is not a positive number.
    """
    if version_of(document) < 2:
        return FIELD_MASS, FRICTION
    try:
        mass, friction = float(document["mass"]), float(document["request"]["friction"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"the plan does not say its mass and friction ({type(error).__name__}: {error})"
        ) from error
    if not (mass > 0 and friction > 0):
        raise InputError(f"a plan's mass and friction must be positive, got {mass:g} and {friction:g}")
    return mass, friction


def obstacles_of(document: Document, *, table: bool = True) -> str:
    """What is around the object of a plan, such as ``the table and 2 boxes``; empty for free space.

    Args:
        document: The plan.
        table: Whether to name the table as well.
    """
    request = document.get("request") or {}
    boxes = len(request.get("avoid") or ())
    parts = ["the table"] if table and request.get("table") is not None else []
    parts += [f"{boxes} box{'es' if boxes > 1 else ''}"] if boxes else []
    parts += ["the rest of the scene"] if (request.get("object") or {}).get("mask") is not None else []
    files = len(request.get("obstacle") or ())
    parts += [f"{files} obstacle{'s' if files > 1 else ''}"] if files else []
    return " and ".join(parts)


def lacking(document: Document) -> str:
    """Why the best grasp of a plan without an answer is not good enough.

    The last step may say only that the object is known; then the step before it that judged a grasp says it.
    """
    judged = [
        t["reason"] for t in document["transitions"] if t["outcome"] in ("penalty", "deadlock", "no grasp")
    ]
    reason = str(document["reason"])
    return reason if not judged or judged[-1] in reason else f"{judged[-1]}; {reason}"


def no_answer(document: Document) -> str:
    """One sentence on a plan without an answer; it names ``--best`` if the plan contains a best grasp."""
    words = f"the plan has no grasp ({document.get('status')}: {document.get('reason')})"
    if document.get("best"):
        words += "; --best takes the best grasp that was found, which is not good enough"
    return words


def _answer(plan: PlanRecord, answer: Answer | None) -> Document:
    decision, task, mesh = plan.decision, plan.decision.task, plan.mesh
    attributes = mesh.attributes
    return {
        "schema": SCHEMA,
        "status": decision.status.value,
        "executable": answer is not None and answer.hand_result.reached,
        "reason": decision.reason,
        "mode": decision.mode,
        "deadlock": decision.deadlock,
        "known": plan.known,
        **(_grasp(answer.grasp) if answer else dict.fromkeys(GRASP_KEYS)),
        "way_in": answer.way_in.tolist() if answer else None,
        "fingers_touching": len({*answer.hand_result.fingers} - {PALM}) if answer else None,
        "mass": plan.mass.kg,
        "mass_source": plan.mass.source,
        "heaviest_mass": answer.heaviest if answer else None,
        "cog": mesh.cog.tolist(),
        "U": plan.hand.u,
        "length_unit": LENGTH_UNIT * plan.hand.u,
        "contacts": _contacts(plan, answer) if answer else [],
        "warnings": [*plan.warnings, *(shortfalls(plan, answer) if answer else ())],
        "missing_motion": missing_motion(plan, answer) if answer else "",
        "transitions": [
            {"mode": t.mode, "outcome": t.outcome, "reason": t.reason} for t in decision.transitions
        ],
        "hand": _hand(plan, answer),
        "grip": _grip(plan, answer.grasp) if answer else None,
        "part": (held_part(mesh, answer.grasp.contacts.points) or None) if answer else None,
        "verified": asdict(plan.verified) if plan.verified and answer is plan.answer else None,
        "cloud": _cloud(plan, answer),
        "arm": _arm(plan, answer),
        "best": None,
        "alternatives": [],
        "offers": [
            {"task": o.task.label, "q": o.task.q.tolist(), "tfvadi": o.match, "mode": o.mode}
            for o in decision.offers
        ],
        "object": {
            "name": mesh.name,
            "source": plan.source,
            "extents": mesh.extents.tolist(),
            "vertices": attributes.vertices,
            "vertex_normals": attributes.vertex_normals,
            "faces": attributes.faces,
            "triangles": attributes.triangles,
        },
        "scene": _scene(plan),
        "task": {"name": task.label, "q": task.q.tolist(), "means": task.means},
        "thresholds": asdict(plan.settings.thresholds),
        "request": plan.request.to_json(),
        "rules": _rules(plan),
        "seconds": {key: round(second, 6) for key, second in plan.seconds.items()},
        "version": __version__,
    }


def _own_reason(plan: PlanRecord, answer: Answer) -> str:
    """Why an alternative is an answer: its own score, and what it is."""
    threshold = plan.settings.thresholds.estimation
    grasp = answer.grasp
    measure = "the grip's quality (3 is just enough)" if isinstance(grasp, Grip) else "TFVADI"
    return f"{judge(grasp.judged, threshold, subject=measure).reason}: {grasp.description}"


def _rules(plan: PlanRecord) -> list[Document]:
    """The rules that were applied, and where each comes from."""
    applied = plan.request.rules_for(plan.mesh).applied
    return [
        {"kind": rule.kind, "part": rule.part, "origin": rule.origin, "table": rule.table} for rule in applied
    ]


def _scene(plan: PlanRecord) -> Document:
    """The object in a world with z up; up, table, and gravity and motion of the task in the mesh frame."""
    stands = plan.standing
    return {
        "T_world_object": stands.pose.tolist(),
        "up": (stands.up + 0.0).tolist(),
        "table": None if stands.table is None else (stands.table + 0.0).tolist(),
        "gravity": (plan.request.task_gravity(plan.mesh) + 0.0).tolist(),
        "motion": full_motion(plan.decision.task).tolist(),
        "turned": round(math.degrees(stands.turned), 3),
    }


def _grasp(g: Grasp) -> Document:
    return {
        "plane": g.plane.index,
        "flip": g.flip,
        "approach_axis": g.plane.approach_axis.tolist(),
        "opposition_axis": g.plane.opposition_axis.tolist(),
        "transverse_axis": (g.plane.transverse_axis + 0.0).tolist(),
        "approach_value": g.approach_value,
        "approach_set": SET_NAMES[g.approach_set],
        "fingers": g.fingers,
        "tfvadi": g.tfvadi,
        "adi": g.adi.tolist(),
        "net_wrench": g.net_wrench.tolist(),
        "stability": g.stability,
        "manipulability": g.manipulability,
    }


def _grip(plan: PlanRecord, grip: Grasp) -> Document | None:
    """Approach, press and margins of a real hand's grip; ``None`` for a virtual grasp."""
    if not isinstance(grip, Grip):
        return None
    return {
        "type": {
            **asdict(kind := grasp_type(grip, plan.hand.fingers[0].name, plan.mesh.extents)),
            "virtual_fingers": [list(group) for group in kind.virtual_fingers],
        },
        "approach": grip.approach.tolist(),
        "forces": grip.forces.tolist(),
        "torques": grip.torques.tolist(),
        "task_margin": grip.task_margin,
        "hold_margin": grip.hold_margin,
        "quality": grip.quality,
        "clearance": grip.clearance,
        "friction_share": grip.friction_share,
        "pick_probability": grip.pick_probability,
    }


def _cloud(plan: PlanRecord, answer: Answer | None) -> Document | None:
    """How much of the surface under a point cloud's answer was seen."""
    said = scan_trust(plan, answer)
    if said is None:
        return None
    return {
        "points": said.points,
        "seen_share": said.seen_share,
        "contacts_seen": list(said.contacts_seen),
        "trust": said.trust,
        "sentence": said.sentence,
    }


def _arm(plan: PlanRecord, answer: Answer | None) -> Document | None:
    """The arm on an answer, and what it made of all answers; ``None`` without an arm."""
    if plan.arm is None:
        return None
    arm, found = plan.arm.arm, answer.arm if answer else None
    path = None
    if found is not None and found.reached:
        path = {"stages": list(found.stages), "times": found.times.tolist(), "q": found.q.tolist()}
    return {
        "name": arm.name,
        "tip": arm.tip,
        "joints": list(arm.joints),
        "status": found.status.name.lower() if found else None,
        "reason": found.reason if found else None,
        "path": path,
        "limit_room": found.limit_room if found and math.isfinite(found.limit_room) and path else None,
        "condition": found.condition if found and path else None,
        "tested": plan.arm.tested,
        "refused": [
            {
                "plane": other.grasp.plane.index,
                "way_in": other.way_in.tolist(),
                "score": other.grasp.judged,
                "status": other.arm.status.name.lower(),
                "reason": other.arm.reason,
            }
            for other in plan.arm.refused
            if other.arm is not None
        ],
        "notes": list(plan.arm.notes),
        "seconds": {name: round(second, 6) for name, second in plan.arm.seconds.items()},
    }


def _contacts(plan: PlanRecord, answer: Answer) -> list[Document]:
    grasp, contacts, names = answer.grasp, answer.grasp.contacts, answer.hand_result.fingers
    if isinstance(grasp, Grip):
        links: list[str | None] = list(grasp.links)
        forces: list[list[float] | None] = list(grasp.forces.tolist())
    else:
        tips = {finger.name: finger.tip_body for finger in plan.hand.fingers}
        links, forces = [tips.get(name) for name in names], [None] * len(names)
    columns = (contacts.points, contacts.normals_in, contacts.wrenches)
    return [
        {
            "finger": name,
            "link": link,
            "point": p.tolist(),
            "normal_in": n.tolist(),
            "force": force,
            "wrench": w.tolist(),
        }
        for name, link, force, p, n, w in zip(names, links, forces, *columns, strict=True)
    ]


def _hand(plan: PlanRecord, answer: Answer | None) -> Document:
    result = answer.hand_result if answer else None
    return {
        "name": plan.hand.name,
        "source": plan.hand.source or plan.hand.name,
        "joints": list(plan.hand.joints),
        "motors": plan.hand.motor_facts(),
        "status": result.status.name.lower() if result else None,
        "reason": result.reason if result else None,
        "pregrasp": _pose(result.pregrasp, plan.hand) if result else None,
        "grasp": _pose(result.grasp, plan.hand) if result else None,
        "squeeze": _pose(result.squeeze, plan.hand) if result else None,
        "retracted": _pose(result.retracted, plan.hand) if result else None,
    }


def _pose(pose: HandPose | None, hand: Hand) -> Document | None:
    """Palm pose, joint angles, and the commands of the motors for them."""
    if pose is None:
        return None
    return {
        "palm_pose": pose.palm_pose.tolist(),
        "q": pose.q.tolist(),
        "motors": hand.controls(pose.q).tolist(),
    }
