"""Plans as JSON: the format that other programs read (``schema/plan.schema.json``).

Points and poses are in the mesh file's frame, in metres after scale; wrenches are about the COG in the
paper's units (lengths in U); quaternions are w x y z.
"""

from __future__ import annotations

import json
from importlib import resources
from typing import Any

from .._version import __version__
from ..files import dumps, write_json, write_whole
from ..hiis.analyser import Grasp, Grip
from ..hiis.fuzzy import SET_NAMES
from ..planner import Answer, Plan, scan_trust, shortfalls
from .hand_simulation import HandPose

__all__ = ["dumps", "error_to_json", "plan_schema", "plan_to_json", "write_json", "write_whole"]

GRASP_KEYS = (
    "plane", "flip", "approach_axis", "opposition_axis", "transverse_axis", "approach_value",
    "approach_set", "fingers", "tfvadi", "adi", "net_wrench", "stability", "manipulability",
)  # fmt: skip


def plan_to_json(plan: Plan) -> dict[str, Any]:
    """A plan as plain JSON values; see the schema for each key."""
    document = _answer(plan, plan.answer)
    document["alternatives"] = [_answer(plan, other) for other in plan.alternatives]
    return document


def error_to_json(reason: str) -> dict[str, str]:
    """What standard output holds instead of a plan when the input or the environment failed."""
    return {"status": "error", "reason": reason}


def plan_schema() -> dict[str, Any]:
    """The JSON Schema of a plan."""
    text = (resources.files("preshape") / "schema" / "plan.schema.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


def _answer(plan: Plan, answer: Answer | None) -> dict[str, Any]:
    decision, task, mesh = plan.decision, plan.decision.task, plan.mesh
    attributes = mesh.attributes
    return {
        "status": decision.status.value,
        "reason": decision.reason,
        "mode": decision.mode,
        "deadlock": decision.deadlock,
        **(_grasp(answer.grasp) if answer else dict.fromkeys(GRASP_KEYS)),
        "cog": mesh.cog.tolist(),
        "U": plan.hand.u,
        "contacts": _contacts(answer) if answer else [],
        "warnings": list(shortfalls(plan, answer)) if answer else [],
        "transitions": [
            {"mode": t.mode, "outcome": t.outcome, "reason": t.reason} for t in decision.transitions
        ],
        "hand": _hand(plan, answer),
        "grip": _grip(answer.grasp) if answer else None,
        "verified": _verified(plan) if answer is plan.answer else None,
        "cloud": _cloud(plan, answer),
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
        "task": {"name": task.label, "q": task.q.tolist(), "means": task.means},
        "thresholds": {
            "estimation": plan.settings.thresholds.estimation,
            "recognition": plan.settings.thresholds.recognition,
        },
        "seconds": {key: round(second, 6) for key, second in plan.seconds.items()},
        "version": __version__,
    }


def _grasp(g: Grasp) -> dict[str, Any]:
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


def _grip(grip: Grasp) -> dict[str, Any] | None:
    """What the closure analyser knows beside: how the hand comes, how it presses, what that is good for."""
    if not isinstance(grip, Grip):
        return None
    return {
        "approach": grip.approach.tolist(),
        "forces": grip.forces.tolist(),
        "torques": grip.torques.tolist(),
        "task_margin": grip.task_margin,
        "hold_margin": grip.hold_margin,
        "quality": grip.quality,
        "clearance": grip.clearance,
    }


def _verified(plan: Plan) -> dict[str, Any] | None:
    said = plan.verified
    return None if said is None else {"held": said.held, "tried": said.tried, "reason": said.reason}


def _cloud(plan: Plan, answer: Answer | None) -> dict[str, Any] | None:
    """What of a point cloud's answer was seen."""
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


def _contacts(answer: Answer) -> list[dict[str, Any]]:
    contacts = answer.grasp.contacts
    columns = (contacts.points, contacts.normals_in, contacts.wrenches)
    return [
        {"finger": name, "point": p.tolist(), "normal_in": n.tolist(), "wrench": w.tolist()}
        for name, p, n, w in zip(answer.hand_result.fingers, *columns, strict=True)
    ]


def _hand(plan: Plan, answer: Answer | None) -> dict[str, Any]:
    result = answer.hand_result if answer else None
    return {
        "name": plan.hand.name,
        "source": plan.hand.source or plan.hand.name,
        "joints": list(plan.hand.joints),
        "status": result.status.name.lower() if result else None,
        "reason": result.reason if result else None,
        "pregrasp": _pose(result.pregrasp) if result else None,
        "grasp": _pose(result.grasp) if result else None,
        "squeeze": _pose(result.squeeze) if result else None,
        "retracted": _pose(result.retracted) if result else None,
    }


def _pose(pose: HandPose | None) -> dict[str, Any] | None:
    if pose is None:
        return None
    return {"palm_pose": pose.palm_pose.tolist(), "q": pose.q.tolist()}
