"""A plan as one HTML page: 3D scene, readings and JSON in a single file that opens from disk, offline.

The page has its own WebGL code (``web/page.js``), and its content security policy forbids every request. Each
geometry is stored once, with coordinates as 16-bit integers within its bounding box.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from importlib import resources
from typing import Any

import numpy as np

from ..exceptions import InputError
from ..report.page import base_style
from ..report.plain import html_text as escape
from ..types import value
from . import readings
from .camera import Camera
from .canvas import RecordingCanvas, group_of
from .corners import indexed
from .draw import GROUPS, HIDDEN, draw_hand, recorded
from .framing import framing
from .hand_motion import HandMotion
from .plan_scene import PlanScene
from .raycast import Shape
from .words import answers_of

ASPECT = 1.2
"""Width divided by height of the scene's picture; the camera is placed for this ratio."""
MAX_BYTES = 5_000_000
"""Largest size of a page [bytes]; answers that do not fit are left out."""

Document = dict[str, Any]


@value
class PageView:
    """One answer on the page.

    Attributes:
        scene: The scene.
        motion: The motion of the hand; ``None`` without a hand.
    """

    scene: PlanScene
    motion: HandMotion | None = None


def plan_page(views: Sequence[PageView], document: Document) -> str:
    """The HTML of a plan's page.

    Args:
        views: The answers of the plan in its order; if it has none, one view of the object alone.
        document: The plan as JSON.

    Raises:
        InputError: There are no views.
    """
    if not views:
        raise InputError("a page needs at least one view")
    answers = answers_of(document)
    shown = len(views)
    while True:
        page = _page(views[:shown], answers[:shown], document)
        if len(page.encode()) < MAX_BYTES or shown == 1:
            return page
        shown -= 1


def _page(views: Sequence[PageView], answers: Sequence[Document], document: Document) -> str:
    geometries: dict[str, Document] = {}
    planned_object, task = document["object"], document["task"]
    data = {
        "geometries": geometries,
        "views": [_view(view, i, answers, document, geometries) for i, view in enumerate(views)],
        "groups": GROUPS,
        "hidden": HIDDEN,
        "file": "plan.json",
    }
    size = " × ".join(f"{1000 * x:.0f}" for x in planned_object["extents"])
    web = resources.files("preshape.viewer") / "web"
    parts = {
        "title": escape(f"{planned_object['name']}: {task['name']} · preshape"),
        "style": base_style() + (web / "page.css").read_text(encoding="utf-8") + readings.STYLE,
        "heading": escape(f"{planned_object['name']}: {task['name']}"),
        "means": escape(str(task.get("means", ""))),
        "subtitle": escape(f"{size} mm · hand {document['hand']['name']} · preshape {document['version']}"),
        "data": _json(data),
        "plan": _json(document, indent=2),
        "script": (web / "page.js").read_text(encoding="utf-8"),
    }
    template = (web / "page.html").read_text(encoding="utf-8")
    pieces = template.split("{{")
    filled = [pieces[0]]
    for piece in pieces[1:]:  # in one pass, so that inserted text is never searched for placeholders
        name, _, rest = piece.partition("}}")
        filled += [parts[name], rest]
    return "".join(filled)


def _view(
    view: PageView,
    index: int,
    answers: Sequence[Document],
    document: Document,
    geometries: dict[str, Document],
) -> Document:
    """One answer as data for the page's script."""
    canvas = recorded(view.scene)
    solids = [_solid(name, shape, geometries) for name, shape in canvas.solids.items()]
    motion = None
    if view.motion is not None:
        hand = RecordingCanvas()
        draw_hand(view.motion, hand)
        for link, (name, shape) in enumerate(hand.solids.items()):
            solids.append({**_solid(name, shape, geometries), "link": link})
        frames, links = view.motion.poses.shape[:2]
        columns = view.motion.poses[:, :, :3].transpose(
            0, 1, 3, 2
        )  # column by column, as WebGL takes matrices
        motion = {
            "stages": view.motion.stages,
            "frames": frames,
            "links": links,
            "poses": _text(columns, "<f4"),
        }
    labels = [
        {"group": group_of(name), "text": text, "at": [round(float(x), 5) for x in at]}
        for name, (text, at) in canvas.labels.items()
    ]
    words = [readings.headline(document)]
    if index < len(answers):
        why, *rest = readings.answer_parts(document, answers, index)
        words += [why, readings.ranking(answers, index), *rest]
    else:
        words.append(readings.transitions(document))
    words += [readings.offers(document), readings.glossary()]
    return {
        "solids": solids,
        "labels": labels,
        "motion": motion,
        "camera": _camera(framing(view.scene, view.motion, ASPECT)),
        "readings": "".join(words),
    }


def _camera(camera: Camera) -> Document:
    return {"eye": camera.eye.tolist(), "target": camera.target.tolist(), "fov": camera.fov}


def _solid(name: str, shape: Shape, geometries: dict[str, Document]) -> Document:
    return {
        "group": group_of(name),
        "g": _geometry(shape, geometries),
        "c": [*(round(c, 4) for c in shape.colour), shape.alpha],
        "lit": int(shape.lit),
    }


def _geometry(shape: Shape, geometries: dict[str, Document]) -> str:
    """The key of a shape's geometry in ``geometries``; a new geometry is added."""
    content = (shape.vertices.tobytes(), shape.triangles.tobytes(), b"smooth" if shape.smooth else b"flat")
    key = hashlib.blake2b(b"|".join(content), digest_size=8).hexdigest()
    if key in geometries:
        return key
    vertices, normals, triangles = indexed(shape)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle, half = (low + high) / 2, max(float((high - low).max()) / 2, 1e-9)
    large = len(vertices) > 65535
    geometries[key] = {
        "o": [float(x) for x in middle],
        "s": half,
        "p": _text(np.round((vertices - middle) / half * 32767), "<i2"),
        "n": _text(np.round(normals * 127), "<i1"),
        "t": _text(triangles, "<u4" if large else "<u2"),
        "w": int(large),
    }
    return key


def _text(array: Any, kind: str) -> str:
    """An array as base64 text of numbers of a NumPy type."""
    return base64.b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode("ascii")


def _json(document: Any, indent: int | None = None) -> str:
    """JSON for a script element, without ``<``, which could end the element."""
    text = json.dumps(document, allow_nan=False, indent=indent, separators=None if indent else (",", ":"))
    return text.replace("<", "\\u003c")
