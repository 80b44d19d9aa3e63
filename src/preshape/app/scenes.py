"""From a plan's document (the JSON of a plan) to what a scene draws: shapes, wrenches, the hand's motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..exceptions import InputError
from ..hands.hand import Hand
from ..hiis.analyser import VirtualGrasp
from ..hiis.planes import PLANES, ApproachPlane, plane
from ..objects.mesh import TriangleMesh
from ..types import Array, frozen_array
from ..viewer.hand_motion import HandMotion, hand_motion
from ..viewer.plan_scene import PlaneCard, PlanScene
from ..viewer.readings import answers_of
from ..viewer.reduce import reduced

if TYPE_CHECKING:
    from ..planner import Plan

AWAY = 0.10
"""How far the hand stands back along the approach before it comes [m]."""
RAY_FRICTION = 1.0
"""Friction of the cones that are drawn where a grasp was found by rays."""

Document = dict[str, Any]


def light_mesh(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh as it is sent to a browser: at most 20 000 triangles, the same bounding box in effect."""
    vertices, triangles = reduced(mesh.vertices, mesh.triangles)
    if vertices is mesh.vertices:
        return mesh
    return TriangleMesh(name=mesh.name, vertices=vertices, triangles=triangles, scale=mesh.scale)


def document_scene(
    mesh: TriangleMesh,
    document: Document | None,
    answer: Document | None,
    *,
    friction: float = RAY_FRICTION,
    rays: Sequence[Sequence[float]] | None = None,
) -> PlanScene:
    """The scene of one answer of a plan; of the object alone without one.

    Args:
        mesh: the object, reduced or not [m].
        document: the plan; ``None`` before there is one.
        answer: which of its answers (``readings.answers_of``); ``None`` where it has none.
        friction: of the cones.
        rays: (n, 3) where the aiming rays of this answer start [m], where they are known.

    Raises:
        InputError: the document is not a plan of this version.
    """
    common: dict[str, Any] = {"mesh": mesh, "cog": mesh.cog, "planes": tuple(_card(p) for p in PLANES)}
    if document is None:
        none: dict[str, Any] = {
            "task_name": "",
            "hand_name": "",
            "task": np.zeros(6),
            "mode": None,
            "status": "",
        }
        return PlanScene(**common, **none)
    try:
        common |= {
            "cog": np.array(document["cog"], dtype=np.float64),
            "task_name": document["task"]["name"],
            "hand_name": document["hand"]["name"],
            "task": document["task"]["q"],
            "mode": document["mode"],
            "status": document["status"].replace("_", " "),
            "reasons": [f"Mode {t['mode']}, {t['outcome']}: {t['reason']}" for t in document["transitions"]],
        }
        if answer is not None:
            common |= _answer(mesh, answer, friction, rays)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"this is no plan of preshape: {type(error).__name__} at {error}") from error
    return PlanScene(**common)


def document_motion(hand: Hand, answer: Document | None) -> HandMotion | None:
    """The hand on its way: away, open before the object, closed, squeezing; one pose where it gave up.

    Raises:
        InputError: the hand's poses are missing or of another hand.
    """
    if answer is None:
        return None
    said = answer["hand"]
    try:
        if list(said["joints"]) != list(hand.joints):
            raise InputError(f"the plan's joints are not those of {hand.name}")
        if said["grasp"] is None:
            if said["retracted"] is None:
                return None
            return hand_motion(hand, [("retracted", *_pose(said["retracted"]))])
        stages = [(name, *_pose(said[key])) for name, key in _STAGES if said[key] is not None]
        grip = answer.get("grip")
        way = frozen_array(grip["approach"] if grip else answer["approach_axis"], (3,), "approach")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"the plan's hand cannot be shown: {type(error).__name__} at {error}") from error
    name, palm, q = stages[0]
    away = palm.copy()
    away[:3] -= AWAY * way
    return hand_motion(hand, [("away", away, q), (name, palm, q), *stages[1:]])


_STAGES = (("open", "pregrasp"), ("closed", "grasp"), ("squeeze", "squeeze"))


def plan_html(plan: Plan, document: Document) -> str:
    """One self-contained page about a plan: 3D, readings and the JSON; opens from disk, offline.

    Args:
        plan: the plan.
        document: its JSON (:func:`preshape.planning.document.plan_to_json`).
    """
    made = [a for a in (plan.answer, *plan.alternatives) if a is not None]
    rays = [a.grasp.ray_origins.tolist() for a in made if isinstance(a.grasp, VirtualGrasp)]
    return document_html(light_mesh(plan.mesh), plan.hand, document, rays)


def document_html(
    mesh: TriangleMesh, hand: Hand, document: Document, rays: Sequence[Sequence[Sequence[float]]] = ()
) -> str:
    """The page of :func:`plan_html` for a plan that is there as JSON.

    Args:
        mesh: the object, reduced or not [m].
        hand: the plan's hand.
        document: the plan.
        rays: for each answer, where its rays start [m]; may be shorter.
    """
    from ..viewer.page import PageView, plan_page

    views = [
        PageView(
            scene=document_scene(
                mesh, document, answer, friction=friction_of(answer), rays=rays[i] if i < len(rays) else None
            ),
            motion=document_motion(hand, answer),
        )
        for i, answer in enumerate(answers_of(document))
    ]
    return plan_page(views or [PageView(scene=document_scene(mesh, document, None))], document)


def friction_of(answer: Document, friction: float = 0.6) -> float:
    """Friction of an answer's cones: the planned one of a grip, else of the ray analyser's picture."""
    return friction if answer.get("grip") else RAY_FRICTION


def _answer(
    mesh: TriangleMesh, answer: Document, friction: float, rays: Sequence[Sequence[float]] | None
) -> Document:
    p = plane(int(answer["plane"]))
    contacts = answer["contacts"]
    half = float(abs(p.approach_axis) @ mesh.extents) / 2
    cog = np.array(answer["cog"], dtype=np.float64)
    points = np.array([c["point"] for c in contacts]).reshape(-1, 3)
    return {
        "plane": _card(p),
        "approach_value": float(answer["approach_value"]),
        "approach_set": answer["approach_set"],
        "aim": cog + float(answer["approach_value"]) * half * p.approach_axis,
        "points": points,
        "normals_in": np.array([c["normal_in"] for c in contacts]).reshape(-1, 3),
        "fingers": tuple(c["finger"] for c in contacts),
        "forces": np.array([c["wrench"][:3] for c in contacts]).reshape(-1, 3),
        "friction": friction,
        "ray_origins": None if rays is None else np.array(rays, dtype=np.float64).reshape(-1, 3),
        "net_wrench": answer["net_wrench"],
        "adi": answer["adi"],
        "match": answer["tfvadi"],
        "stability": answer["stability"],
        "manipulability": answer["manipulability"],
    }


def _pose(said: Document) -> tuple[Array, Array]:
    return np.array(said["palm_pose"], dtype=np.float64), np.array(said["q"], dtype=np.float64)


def _card(p: ApproachPlane) -> PlaneCard:
    return PlaneCard(index=p.index, approach_axis=p.approach_axis, opposition_axis=p.opposition_axis)
