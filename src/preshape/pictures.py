"""From a plan to its picture: the one place where plans meet the viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .hiis.analyser import Grip, VirtualGrasp
from .hiis.fuzzy import SET_NAMES
from .hiis.planes import PLANES, ApproachPlane
from .planner import Answer, Plan
from .planning.hand_simulation import hand_geometry
from .viewer.plan_picture import plan_picture
from .viewer.plan_scene import PlaneCard, PlanScene


def plan_png(plan: Plan, path: Path) -> None:
    """Draw the object, the planes, the contacts, the wrenches and the hand.

    Raises:
        EnvironmentFailure: the file cannot be written.
    """
    plan_picture(plan_scene(plan), path)


def plan_scene(plan: Plan) -> PlanScene:
    """What the picture of a plan shows."""
    decision, mesh = plan.decision, plan.mesh
    common: dict[str, Any] = {
        "mesh": mesh,
        "cog": mesh.cog,
        "task_name": f"{decision.task.label}: {decision.task.describe()}",
        "hand_name": plan.hand.name,
        "task": decision.task.q,
        "mode": decision.mode,
        "status": decision.status.value.replace("_", " "),
        "reasons": [f"Mode {t.mode}, {t.outcome}: {t.reason}" for t in decision.transitions],
        "planes": tuple(_card(p) for p in PLANES),
    }
    return PlanScene(**common, **(_answer(plan, plan.answer) if plan.answer else {}))


def _answer(plan: Plan, answer: Answer) -> dict[str, Any]:
    g, hand, mesh = answer.grasp, answer.hand_result, plan.mesh
    half = float(abs(g.plane.approach_axis) @ mesh.extents) / 2
    pose = hand.grasp or hand.retracted
    return {
        "plane": _card(g.plane),
        "approach_value": g.approach_value,
        "approach_set": SET_NAMES[g.approach_set],
        "aim": mesh.cog + g.approach_value * half * g.plane.approach_axis,
        "points": g.contacts.points,
        "normals_in": g.contacts.normals_in,
        "fingers": hand.fingers,
        "forces": g.contacts.wrenches[:, :3],
        "friction": 1.0,
        "ray_origins": g.ray_origins if isinstance(g, VirtualGrasp) else None,
        "net_wrench": g.net_wrench,
        "adi": g.adi,
        "match": g.tfvadi,
        "quality": g.quality if isinstance(g, Grip) else None,
        "stability": g.stability,
        "manipulability": g.manipulability,
        "hand": tuple(hand_geometry(plan.hand, pose.palm_pose, pose.q)) if pose else (),
    }


def _card(p: ApproachPlane) -> PlaneCard:
    return PlaneCard(index=p.index, approach_axis=p.approach_axis, opposition_axis=p.opposition_axis)
