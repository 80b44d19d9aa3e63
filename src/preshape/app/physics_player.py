"""Playback of a run in simulated physics: object, hand, current push, and a table of all pushes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..objects.mesh import TriangleMesh
from ..report.plain import html_text as escape
from ..spatial import pose_from_seven, transform_points
from ..types import Array, value
from ..viewer.canvas import Canvas
from ..viewer.film import LOAD
from ..viewer.shapes import arrow
from .wire_format import decoded

WORDS = {
    "pregrasp": "open before the object",
    "grasp": "closing",
    "squeeze": "squeezing",
    "settle": "the object comes to rest",
    "approach": "coming in",
    "close": "closing",
    "lift": "lifting",
    "hold": "holding still",
    "turn": "turning it for the task",
    "load": "the task's load sets in",
    "path": "doing the task",
    "rest": "holding at the end",
}
QUIET_GROUPS = ("planes", "axes", "rays", "contacts", "forces", "net", "task")
"""Groups that are hidden while a run is shown, because they belong to the planned pose of the object."""


@value
class Run:
    """A recorded run: n samples, m shapes of the hand.

    Attributes:
        stage: (n,) Stage of each sample: a key of ``WORDS`` or the name of the push.
        times: (n,) Times [s].
        load: (n, 6) Force [N] and torque [N m] on the object.
        press: (n,) Sum of the normal forces of the hand on the object [N].
        slip: (n,) Largest slip of a part of the hand on the object [m].
        object_poses: (n, 4, 4) Poses of the object.
        links: (n, m, 4, 4) Poses of the hand's shapes.
        verdict: Verdict in one line of HTML.
        report: Verdict and table of stages or pushes as HTML.
        first_lost: Name of the first push that was not held; empty if all were held.
    """

    stage: tuple[str, ...]
    times: tuple[float, ...]
    load: Array
    press: Array
    slip: Array
    object_poses: Array
    links: Array
    verdict: str
    report: str
    first_lost: str

    def __len__(self) -> int:
        return len(self.stage)

    def words(self, frame: int) -> str:
        """A few words on what happens at a sample."""
        stage = self.stage[frame]
        doing = WORDS.get(stage, f"push: {stage.removeprefix('force ')}")
        words = f"{doing} · {self.times[frame]:.1f} s"
        if self.press[frame] > 0:
            words += f" · {self.press[frame]:.0f} N in all · slip {1000 * self.slip[frame]:.1f} mm"
        return words


def run_of(sent: dict[str, Any]) -> Run:
    """The run in a planner's reply (:func:`~preshape.app.physics_run.answer_run`)."""
    n = len(sent["stage"])
    return Run(
        stage=tuple(sent["stage"]),
        times=tuple(sent["times"]),
        load=np.array(sent["load"], dtype=np.float64).reshape(n, 6),
        press=np.array(sent["press"], dtype=np.float64),
        slip=np.array(sent["slip"], dtype=np.float64),
        object_poses=pose_from_seven(decoded(sent["object"], "<f8", 7)),
        links=pose_from_seven(decoded(sent["links"], "<f8", 7)).reshape(n, -1, 4, 4),
        verdict=verdict(sent),
        report=report(sent),
        first_lost=next((str(row["name"]) for row in sent["rows"] if row["held"] is False), ""),
    )


def verdict(sent: dict[str, Any]) -> str:
    """The verdict with its reason, as HTML."""
    done = "Done in physics" if sent["job"] else "Held in physics"
    kind, title = ("good", f"✓ {done}") if sent["passed"] else ("bad", f"✕ Not {done[0].lower()}{done[1:]}")
    return f'<div class="head {kind}"><b>{title}</b>{escape(str(sent["reason"]))}</div>'


def report(sent: dict[str, Any]) -> str:
    """The verdict and one row for each stage, or for each push, as HTML."""
    head = f"{verdict(sent)}<p class='quiet'>{escape(sent['note'])}</p>"
    rows = "".join(
        f"<tr><td>{escape(row['name'])}</td><td class='num'>{1000 * row['moved']:.1f}</td>"
        f"<td class='num'>{math.degrees(row['turned']):.1f}</td>"
        f"<td class='num'>{_number(row['force'], 1.0)}</td>"
        f"<td class='num'>{_number(row['slip'], 1000.0)}</td>"
        f"<td class='num'>{_HELD[row['held']]}</td></tr>"
        for row in sent["rows"]
    )
    titles = ("stage" if sent["job"] else "push", "moved mm", "turned °", "force N", "slip mm", "held?")
    heads = "".join(f"<th class='{'num' if i else ''}'>{title}</th>" for i, title in enumerate(titles))
    return f"{head}<table><tr>{heads}</tr>{rows}</table>" if rows else head


_HELD = {True: "✓ yes", False: "<b>✕ no</b>", None: ""}


def _number(number: float | None, factor: float) -> str:
    return "–" if number is None else f"{factor * number:.1f}"


class RunPlayer:
    """Shows one sample of a run after another.

    Args:
        canvas: The canvas, with object and hand already drawn.
    """

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._stage = ""

    def show(self, run: Run, links: tuple[str, ...], frame: int, mesh: TriangleMesh) -> None:
        """Place object and hand as they were at a sample, and draw an arrow for the push.

        Args:
            run: The run.
            links: Names under which the hand's shapes were drawn.
            frame: Index of the sample.
            mesh: The object that was drawn.
        """
        self._canvas.place("object", run.object_poses[frame])
        for name, pose in zip(links, run.links[frame], strict=True):
            self._canvas.place(f"hand/{name}", pose)
        force = run.load[frame, :3]
        size = float(np.linalg.norm(force))
        if run.stage[frame] != self._stage:
            self._stage = run.stage[frame]
            self._canvas.remove("push")
            if size > 1e-9:
                way, reach = force / size, float(np.linalg.norm(mesh.extents)) / 2
                self._canvas.solid(
                    "push/arrow", arrow(-1.8 * reach * way, -1.05 * reach * way, 0.035 * reach, LOAD)
                )
        if size > 1e-9:
            at = np.eye(4)
            at[:3, 3] = transform_points(run.object_poses[frame], mesh.cog)
            self._canvas.place("push/arrow", at)

    def leave(self) -> None:
        """Return to the planned pose of the object, and remove the arrow."""
        self._stage = ""
        self._canvas.remove("push")
        self._canvas.place("object", np.eye(4))
