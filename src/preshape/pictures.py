"""Pictures of a plan from its document (its JSON): the scene, the moving hand, PNG and page.

Every picture of a plan is made here: plan.png, plan.html and the browser app use the same functions. They
take documents, meshes and hands, so a plan read from a file is drawn like one that was just made.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .exceptions import InputError, PreshapeError
from .hands.hand import Hand
from .hands.kinematics import hand_geometry
from .hiis.planes import PLANES, ApproachPlane, plane
from .objects.mesh import TriangleMesh
from .objects.obstacle import obstacle_surface, placed_file, rest_of_scene
from .objects.parts import PartSurface, part_pieces, surface_of, whole_surface
from .objects.resting import upright
from .tasks import task_from_numbers
from .types import FRICTION, Array, frozen_array
from .viewer import words
from .viewer.hand_motion import HandMotion, hand_motion
from .viewer.plan_picture import plan_picture
from .viewer.plan_scene import PlaneCard, PlanScene
from .viewer.readings import fact_rows
from .viewer.reduce import reduced

AWAY = 0.10
"""Distance from the pregrasp at which the hand's motion starts, against the way in [m]."""
RAY_FRICTION = 1.0
"""Friction coefficient of the paper's contact model, whose cones are drawn for a virtual grasp."""
_STAGES = (("open", "pregrasp"), ("closed", "grasp"), ("squeeze", "squeeze"))

Document = dict[str, Any]


def light_mesh(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh reduced to at most 20 000 triangles, for display in a browser."""
    vertices, triangles = reduced(mesh.vertices, mesh.triangles)
    if vertices is mesh.vertices:
        return mesh
    scan = mesh.scan
    if scan is not None:  # which triangles were seen is not known of the reduced surface
        scan = replace(scan, seen=np.zeros(len(triangles), dtype=bool))
    return replace(
        mesh,
        vertices=vertices,
        triangles=triangles,
        counts=None,
        scan=scan,
        notes=(),
        lids=0,
        parts=(),
        rules=(),
    )


def plan_scene(
    document: Document | None,
    mesh: TriangleMesh,
    hand: Hand | None = None,
    answer: Document | None = None,
    *,
    rays: Sequence[Sequence[float]] | None = None,
) -> PlanScene:
    """The scene of one answer of a plan, or of the object alone.

    Args:
        document: The plan; ``None`` before there is one.
        mesh: The object, reduced or not [m].
        hand: The plan's hand, to draw its posture too; ``None`` to leave it out.
        answer: One of the plan's answers (``words.answers_of``); ``None`` if the plan has none.
        rays: (n, 3) Origins of this answer's aiming rays [m]; ``None`` if unknown.

    Raises:
        InputError: The document is no plan of preshape.
    """
    drawn: dict[str, Any] = {"mesh": mesh, "cog": mesh.cog, "planes": tuple(_card(p) for p in PLANES)}
    if document is None:
        nothing: dict[str, Any] = {
            "task_name": "",
            "hand_name": "",
            "task": np.zeros(6),
            "status": "",
        }
        return PlanScene(**drawn, **nothing)
    try:
        name, q, request = document["task"]["name"], document["task"]["q"], document.get("request") or {}
        table = request.get("table")
        drawn |= {
            "cog": np.array(document["cog"], dtype=np.float64),
            "task_name": f"{name}: {task_from_numbers(q).describe()}",
            "hand_name": document["hand"]["name"],
            "task": q,
            "status": f"{words.result(document)[2]}  ·  {words.plan_mode(document)}",
            "reasons": [
                *([] if document["plane"] else [str(document["reason"])]),
                *(f"{words.step_words(t)}: {t['reason']}" for t in document["transitions"]),
            ],
            **_table(document, mesh, table),
            "boxes": np.array(request.get("avoid") or [], dtype=np.float64).reshape(-1, 2, 3),
            "obstacles": _obstacles(request.get("obstacle") or (), mesh),
        }
        if answer is not None:
            drawn |= _answer(mesh, document, answer, rays)
            pose = answer["hand"]["grasp"] or answer["hand"]["retracted"]
            if hand is not None and pose is not None:
                drawn["hand"] = tuple(hand_geometry(hand, *_pose(pose)))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"this is no plan of preshape: {type(error).__name__} at {error}") from error
    return PlanScene(**drawn)


def document_motion(hand: Hand, answer: Document | None) -> HandMotion | None:
    """The hand's motion in an answer: away, open in front of the object, closed, squeezing.

    The motion of a retracted hand is a single pose. The result is ``None`` if the answer has no hand pose.

    Raises:
        InputError: The hand's poses are missing, or are those of another hand.
    """
    if answer is None:
        return None
    posed = answer["hand"]
    try:
        if list(posed["joints"]) != list(hand.joints):
            raise InputError(f"the plan's joints are not those of {hand.name}")
        if posed["grasp"] is None:
            if posed["retracted"] is None:
                return None
            return hand_motion(hand, [("retracted", *_pose(posed["retracted"]))])
        stages = [(name, *_pose(posed[key])) for name, key in _STAGES if posed[key] is not None]
        way = frozen_array(words.way_in(answer), (3,), "way in")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"the plan's hand cannot be shown: {type(error).__name__} at {error}") from error
    name, palm, q = stages[0]
    away = palm.copy()
    away[:3] -= AWAY * way
    return hand_motion(hand, [("away", away, q), (name, palm, q), *stages[1:]])


def plan_picture_of(
    document: Document,
    mesh: TriangleMesh,
    hand: Hand,
    path: Path,
    rays: Sequence[Sequence[Sequence[float]]] = (),
) -> None:
    """Write a plan's picture as PNG: its first answer, else the best grasp found, else the object alone.

    Args:
        document: The plan.
        mesh: The object [m].
        hand: The plan's hand.
        path: The file to write.
        rays: For each answer, the origins of its aiming rays [m]; may be shorter.

    Raises:
        InputError: The document is no plan of preshape.
        EnvironmentFailure: The file cannot be written.
    """
    answers = words.answers_of(document)
    scene = plan_scene(
        document, mesh, hand, answers[0] if answers else None, rays=rays[0] if len(rays) else None
    )
    plan_picture(scene, path)


def parts_picture_of(mesh: TriangleMesh, path: Path) -> None:
    """Write a picture of an object's parts as PNG, upright, each in its colour and with its name.

    Where parts overlap, the smaller one is drawn.

    Args:
        mesh: The object [m].
        path: The file to write.

    Raises:
        InputError: The name does not end in ``.png``.
        EnvironmentFailure: The file cannot be written.
    """
    from .viewer.parts_picture import PartPiece, parts_picture

    rest, pieces = whole_surface(mesh), []
    for part in sorted(mesh.parts, key=lambda part: part_pieces(mesh, part.region).area):
        inside, rest = part.region.split(rest)
        if len(inside.corners):
            pieces.append((part.name, inside))
    turn = upright(mesh.up).T
    shown = [
        PartPiece(name=name, vertices=surface.vertices @ turn, triangles=surface.triangles)
        for name, surface in [(name, surface_of(name or "rest", p)) for name, p in [*pieces, ("", rest)]]
    ]
    size = " × ".join(f"{1000 * x:.3g}" for x in mesh.extents)
    parts_picture(shown, path, title=mesh.name, facts=f"{size} mm")


def document_html(
    mesh: TriangleMesh, hand: Hand, document: Document, rays: Sequence[Sequence[Sequence[float]]] = ()
) -> str:
    """One self-contained page about a plan: 3D scene, readings and JSON; it opens from disk, offline.

    Args:
        mesh: The object [m].
        hand: The plan's hand.
        document: The plan.
        rays: For each answer, the origins of its aiming rays [m]; may be shorter.

    Raises:
        InputError: The document is no plan of preshape, or is one of another hand.
    """
    from .viewer.page import PageView, plan_page

    light = light_mesh(mesh)
    views = [
        PageView(
            scene=plan_scene(document, light, None, answer, rays=rays[i] if i < len(rays) else None),
            motion=document_motion(hand, answer),
        )
        for i, answer in enumerate(words.answers_of(document))
    ]
    return plan_page(views or [PageView(scene=plan_scene(document, light))], document)


def drawn_friction(document: Document, answer: Document) -> float:
    """Friction coefficient of an answer's cones: the plan's for a grip, the paper's for a virtual grasp."""
    if not answer.get("grip"):
        return RAY_FRICTION
    return float((document.get("request") or {"friction": FRICTION})["friction"])


def _answer(
    mesh: TriangleMesh, document: Document, answer: Document, rays: Sequence[Sequence[float]] | None
) -> Document:
    p, grip, contacts = plane(int(answer["plane"])), answer.get("grip"), answer["contacts"]
    half = float(abs(p.approach_axis) @ mesh.extents) / 2
    cog = np.array(answer["cog"], dtype=np.float64)
    drawn: Document = {
        "plane": _card(p),
        "way_in": words.way_in(answer),
        "approach_value": float(answer["approach_value"]),
        "approach_set": answer["approach_set"],
        "aim": cog + float(answer["approach_value"]) * half * p.approach_axis,
        "points": np.array([c["point"] for c in contacts]).reshape(-1, 3),
        "normals_in": np.array([c["normal_in"] for c in contacts]).reshape(-1, 3),
        "fingers": tuple(c["finger"] for c in contacts),
        "friction": drawn_friction(document, answer),
        "ray_origins": None if rays is None else np.array(rays, dtype=np.float64).reshape(-1, 3),
        "facts": tuple(fact_rows(document, answer)),
        "figures": tuple((f"{name} {unit}", number) for name, number, unit in words.figures(answer)),
    }
    if not grip:
        forces = np.array([c["wrench"][:3] for c in contacts]).reshape(-1, 3)
        return drawn | {"forces": forces, "net_wrench": answer["net_wrench"], "adi": answer["adi"]}
    # The arrows of a grip show its contact forces divided by the strongest one.
    newtons = np.array(grip["forces"], dtype=np.float64).reshape(-1, 3)
    strengths = np.linalg.norm(newtons, axis=1)
    return drawn | {"forces": newtons / max(float(strengths.max(initial=0.0)), 1e-9), "newtons": strengths}


def _table(document: Document, mesh: TriangleMesh, table: float | str | None) -> Document:
    """Height of the table along up, and up; older plans know z only."""
    scene = document.get("scene")
    if scene is None:
        return {"table": float(mesh.bounds[0, 2]) if table == "auto" else table}
    return {"table": None if scene["table"] is None else float(scene["table"][3]), "up": scene["up"]}


def _obstacles(texts: Sequence[str], mesh: TriangleMesh) -> tuple[PartSurface, ...]:
    """What is in the way near the object, reduced for a browser; files that are gone are left out."""
    found = [rest_of_scene(mesh)]
    for text in texts:
        with suppress(PreshapeError):
            found.append(obstacle_surface(placed_file(text), mesh.bounds))
    light = [(body, *reduced(body.vertices, body.triangles)) for body in found if body is not None]
    return tuple(replace(body, vertices=v, triangles=t) for body, v, t in light)


def _pose(posed: Document) -> tuple[Array, Array]:
    return np.array(posed["palm_pose"], dtype=np.float64), np.array(posed["q"], dtype=np.float64)


def _card(p: ApproachPlane) -> PlaneCard:
    return PlaneCard(index=p.index, approach_axis=p.approach_axis, opposition_axis=p.opposition_axis)
