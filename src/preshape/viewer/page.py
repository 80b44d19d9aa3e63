"""A plan as one HTML page: 3D, readings and the JSON in a single file that opens from disk, offline.

The page carries its own small WebGL code (``web/page.js``); a content security policy in it forbids every
request. Geometry is kept once however often it is used, as whole numbers of 16 bits within its bounding box.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from html import escape
from importlib import resources
from typing import Any

import numpy as np

from ..exceptions import InputError
from ..report.page import base_style
from ..types import value
from . import readings
from .camera import Camera
from .canvas import RecordingCanvas
from .corners import indexed
from .draw import GROUPS, HIDDEN, draw_hand, draw_object, draw_plan
from .framing import framing
from .hand_motion import HandMotion
from .plan_scene import PlanScene
from .raycast import Shape

ASPECT = 1.2
LARGEST = 5_000_000
"""Bytes of a page at most; so many answers are drawn as fit."""

Document = dict[str, Any]


@value
class PageView:
    """One answer on the page.

    Attributes:
        scene: what is drawn.
        motion: the hand; ``None`` without one.
    """

    scene: PlanScene
    motion: HandMotion | None = None


def plan_page(views: Sequence[PageView], document: Document) -> str:
    """The page.

    Args:
        views: the answers of the plan, best first; at least one, of the object alone where there is none.
        document: the plan as JSON.

    Raises:
        InputError: no views.
    """
    if not views:
        raise InputError("a page needs at least one view")
    answers = readings.answers_of(document)
    shown = len(views)
    while True:
        page = _page(views[:shown], answers[:shown], document)
        if len(page.encode()) < LARGEST or shown == 1:
            return page
        shown -= 1


def _page(views: Sequence[PageView], answers: Sequence[Document], document: Document) -> str:
    pool: dict[str, Document] = {}
    thing, task = document["object"], document["task"]
    data = {
        "geometries": pool,
        "views": [_view(view, i, answers, document, pool) for i, view in enumerate(views)],
        "groups": GROUPS,
        "hidden": HIDDEN,
        "file": "plan.json",
    }
    size = " × ".join(f"{1000 * x:.0f}" for x in thing["extents"])
    web = resources.files("preshape.viewer") / "web"
    parts = {
        "title": escape(f"{thing['name']}: {task['name']} · preshape"),
        "style": base_style() + (web / "page.css").read_text(encoding="utf-8") + readings.STYLE,
        "heading": escape(f"{thing['name']}: {task['name']}"),
        "means": escape(str(task.get("means", ""))),
        "subtitle": escape(f"{size} mm · hand {document['hand']['name']} · preshape {document['version']}"),
        "data": _json(data),
        "plan": _json(document, indent=2),
        "script": (web / "page.js").read_text(encoding="utf-8"),
    }
    frame = (web / "page.html").read_text(encoding="utf-8")
    pieces = frame.split("{{")
    filled = [pieces[0]]
    for piece in pieces[1:]:  # one pass: what is filled in is never looked at again
        name, _, rest = piece.partition("}}")
        filled += [parts[name], rest]
    return "".join(filled)


def _view(
    view: PageView, index: int, answers: Sequence[Document], document: Document, pool: dict[str, Document]
) -> Document:
    taken = RecordingCanvas()
    draw_object(view.scene, taken)
    draw_plan(view.scene, taken)
    solids = [_solid(name, shape, pool) for name, shape in taken.solids.items()]
    motion = None
    if view.motion is not None:
        hand = RecordingCanvas()
        draw_hand(view.motion, hand)
        for link, (name, shape) in enumerate(hand.solids.items()):
            solids.append({**_solid(name, shape, pool), "link": link})
        frames, links = view.motion.poses.shape[:2]
        columns = view.motion.poses[:, :, :3].transpose(0, 1, 3, 2)  # column by column
        motion = {
            "stages": view.motion.stages,
            "frames": frames,
            "links": links,
            "poses": _text(columns, "<f4"),
        }
    labels = [
        {"group": name.partition("/")[0], "text": text, "at": [round(float(x), 5) for x in at]}
        for name, (text, at) in taken.labels.items()
    ]
    words = [readings.headline(document)]
    if index < len(answers):
        answer = answers[index]
        words += [readings.why(document, answers, index), readings.ranking(answers, index)]
        words.append(readings.facts(document, answer))
        words.append(readings.bars(document, answer))
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


def _solid(name: str, shape: Shape, pool: dict[str, Document]) -> Document:
    return {
        "group": name.partition("/")[0],
        "g": _geometry(shape, pool),
        "c": [*(round(c, 4) for c in shape.colour), shape.alpha],
        "lit": int(shape.lit),
    }


def _geometry(shape: Shape, pool: dict[str, Document]) -> str:
    """Key of a shape's geometry, which is put into the pool where it is new."""
    content = (shape.vertices.tobytes(), shape.triangles.tobytes(), b"smooth" if shape.smooth else b"flat")
    key = hashlib.blake2b(b"|".join(content), digest_size=8).hexdigest()
    if key in pool:
        return key
    vertices, normals, triangles = indexed(shape)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle, half = (low + high) / 2, max(float((high - low).max()) / 2, 1e-9)
    large = len(vertices) > 65535
    pool[key] = {
        "o": [float(x) for x in middle],
        "s": half,
        "p": _text(np.round((vertices - middle) / half * 32767), "<i2"),
        "n": _text(np.round(normals * 127), "<i1"),
        "t": _text(triangles, "<u4" if large else "<u2"),
        "w": int(large),
    }
    return key


def _text(array: Any, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode("ascii")


def _json(document: Any, indent: int | None = None) -> str:
    """JSON that may stand in a script element: no ``<`` in it can end one."""
    text = json.dumps(document, allow_nan=False, indent=indent, separators=None if indent else (",", ":"))
    return text.replace("<", "\\u003c")
