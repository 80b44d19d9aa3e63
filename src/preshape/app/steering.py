"""The request as set in a browser's panel; the task can also be set by dragging in the scene."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..exceptions import InputError, shown
from ..hiis.critic import Thresholds
from ..hiis.planes import AXIS_NAMES
from ..planning.request import PlanRequest, analyser_of
from ..planning.rules import FOLLOW, NONE
from ..planning.standing import AUTO
from ..report.plain import html_text as escape
from ..spatial import vector_from_rotation
from ..tasks import displacement_of, family_names, parse_task, q_of_displacement
from ..types import FRICTION, Array
from ..viewer import readings
from ..viewer.colours import AVOID, TRANSVERSE
from .panel import ALTERNATIVES, ANY, AT_HEIGHT, HOLD, KEEP_OFF, NO_TABLE, SIX, UNITS, USES, USUAL, Panel
from .stage import Stage


class Steering:
    """The request of one browser.

    Args:
        panel: The panel with the request's widgets.
        stage: The scene with the gizmo of the task.
    """

    def __init__(self, panel: Panel, stage: Stage) -> None:
        self._panel, self._stage = panel, stage
        self._first_task = self.task()
        stage.gizmo_dragged = self.dragged

    @property
    def unit(self) -> str:
        """Unit of an uploaded file."""
        unit = self._panel.unit.value
        return unit if unit in UNITS else "m"

    def choose_hand(self) -> None:
        """Select the default analyser of the chosen hand."""
        self._panel.analyser.value = analyser_of(None, self._panel.hand.value)
        self.show_load()

    def show_load(self) -> None:
        """Enable the widgets that the analyser uses, and show table and boxes in the scene."""
        p = self._panel
        closure = p.analyser.value != "rays"
        for handle in (p.table, p.height, p.avoid):
            handle.disabled = not closure
        for handle in (p.mass, p.friction):
            handle.disabled = not (closure or p.verify.value)
        p.height.visible = p.table.value == AT_HEIGHT
        # While numbers are being typed and not yet valid, the scene does not change.
        with contextlib.suppress(InputError):
            self._stage.show_scenery(self._table(), self._boxes())

    def show_parts(self, names: Sequence[str], request: PlanRequest) -> None:
        """Offer an object's parts, and paint those that are asked for."""
        self._panel.show_parts(names, request)
        for handle in self._panel.parts.values():
            handle.on_update(lambda _: self._paint())
        self._paint()

    def ask_for_part(self, index: int) -> tuple[str, str] | None:
        """Ask for a part's next use; returns its name and a sentence, or ``None`` if it is not offered."""
        parts = list(self._panel.parts.items())
        if index >= len(parts):
            return None
        name, handle = parts[index]
        handle.value = USES[(USES.index(handle.value) + 1) % len(USES)]
        self._paint()
        use = str(handle.value)
        return name, f"{use[0].upper()}{use[1:]}. Click it again for another choice, or press Plan."

    def _paint(self) -> None:
        colours = {HOLD: TRANSVERSE, KEEP_OFF: AVOID}
        uses = [handle.value for handle in self._panel.parts.values()]
        self._stage.mark({i: colours[use] for i, use in enumerate(uses) if use in colours})

    def show_task(self) -> None:
        """Show the named task or the six numbers in sliders, words and gizmo."""
        task = parse_task(self.task())
        if self._panel.task.value in family_names():
            for slider, number in zip(self._panel.numbers, task.q, strict=True):
                slider.value = float(number)
        motion = displacement_of(task)
        self._describe(motion, task.means)
        self._stage.move_gizmo(motion)

    def use_numbers(self) -> None:
        """Use the six numbers as the task, because a slider was moved."""
        self._panel.task.value = SIX
        self.show_task()

    def dragged(self, displacement: Array) -> None:
        """Use the Q that the paper derives from the gizmo's displacement (4, 4) as the task."""
        self._panel.task.value = SIX
        for slider, number in zip(self._panel.numbers, q_of_displacement(displacement), strict=True):
            slider.value = float(np.round(number, 3))
        self._describe(displacement, "")

    def switch_gizmo(self) -> None:
        """Show or hide the gizmo."""
        on = bool(self._panel.drag.value)
        self._stage.show_gizmo(displacement_of(parse_task(self.task())) if on else None)

    def take(self, offer: str) -> None:
        """Use an offered task, such as ``lift:+z``."""
        name, _, axis = offer.partition(":")
        self._panel.task.value = name
        self._panel.axis.value = axis if axis in AXIS_NAMES else USUAL
        self.show_task()

    def task(self) -> str:
        """The task as text for :func:`~preshape.tasks.parse_task`."""
        name, axis = self._panel.task.value, self._panel.axis.value
        if name not in family_names():
            return " ".join(f"{slider.value:.3f}" for slider in self._panel.numbers)
        return f"{name}:{axis}" if axis in AXIS_NAMES and axis != USUAL else str(name)

    def request(self, base: PlanRequest) -> PlanRequest:
        """The request with the values of the panel.

        Args:
            base: Request with the values that the panel does not show: object, seed, size of the search and
                memory. Its task is used without rounding until the panel's task is changed.

        Raises:
            InputError: The hand is not in the list, or numbers cannot be used.
        """
        p = self._panel
        if p.hand.value not in p.hand.options:
            raise InputError(f"no hand {shown(p.hand.value)} here; choose one of the list")
        text = self.task()
        own_gravity = not np.array_equal(np.asarray(base.gravity), np.asarray(base.asked.gravity))
        loaded = p.analyser.value != "rays"
        limits = Thresholds(estimation=float(p.estimation.value), recognition=float(p.recognition.value))
        return replace(
            base,
            task=base.asked if text == self._first_task else parse_task(text),
            gravity=base.gravity if own_gravity else None,
            hand=str(p.hand.value),
            analyser=str(p.analyser.value),
            mass=self._mass() if loaded or p.verify.value else None,
            friction=float(p.friction.value) if loaded or p.verify.value else None,
            table=self._table(),
            avoid=self._boxes(),
            hold_on=self._parts(base.hold_on, HOLD),
            keep_off=self._parts(base.keep_off, KEEP_OFF),
            rules=FOLLOW if p.rules.value else NONE,
            approaches=None if p.approach.value == ANY else str(p.approach.value),
            count=1 + ALTERNATIVES,
            learn=bool(p.learn.value),
            verify=bool(p.verify.value),
            settings=replace(
                base.settings,
                thresholds=limits,
                sets=p.tuning.sets,
                coefficients=p.tuning.coefficients,
            ),
            search=replace(base.search, mass=None, friction=FRICTION),
        )

    def _mass(self) -> float | None:
        """The panel's mass [kg]; ``None`` for the object's own."""
        text = str(self._panel.mass.value).strip()
        try:
            mass = float(text or 0.0)
        except ValueError:
            mass = math.nan
        if not 0.0 <= mass < math.inf:
            raise InputError(
                f"mass is a number of kilograms, or empty for the object's own, got {shown(text)}"
            )
        return mass or None

    def _parts(self, stated: Sequence[str], use: str) -> list[str]:
        """The parts with one use in the panel, and what the first request states beside the panel's parts."""
        parts = self._panel.parts
        return [
            *(text for text in stated if text not in parts),
            *(name for name, handle in parts.items() if handle.value == use),
        ]

    def _table(self) -> float | str | None:
        """The panel's table; ``None`` if there is none or the analyser does not use tables."""
        p = self._panel
        if p.analyser.value == "rays" or p.table.value == NO_TABLE:
            return None
        return float(p.height.value) if p.table.value == AT_HEIGHT else AUTO

    def _boxes(self) -> tuple[tuple[float, ...], ...]:
        """The panel's boxes, six numbers each; empty if the analyser does not use boxes."""
        p = self._panel
        lines = [] if p.analyser.value == "rays" else str(p.avoid.value).splitlines()
        try:
            boxes = [tuple(map(float, line.replace(",", " ").split())) for line in lines if line.strip()]
        except ValueError as error:
            raise InputError(f"a box to avoid is six numbers, x0 y0 z0 x1 y1 z1 [m]: {error}") from error
        if any(len(box) != 6 for box in boxes):
            raise InputError("a box to avoid is six numbers on a line of its own, x0 y0 z0 x1 y1 z1 [m]")
        return tuple(boxes)

    def _describe(self, displacement: Array, means: str) -> None:
        first = f"{escape(means)}<br>" if means else ""
        words = f'<p class="quiet">{first}{motion_words(displacement)}</p>'
        self._panel.task_note.content = readings.wrapped(words)


def motion_words(displacement: Any) -> str:
    """T and R of a displacement (4, 4), in millimetres and degrees about an axis.

    >>> motion_words(np.eye(4))
    'T = (0, 0, 0) mm · R = none'
    """
    t = ", ".join(f"{round(1000 * float(x)) + 0:d}" for x in displacement[:3, 3])
    vector = vector_from_rotation(np.asarray(displacement, dtype=np.float64)[:3, :3])
    angle = float(np.linalg.norm(vector))
    if angle < math.radians(0.5):
        return f"T = ({t}) mm · R = none"
    axis = ", ".join(f"{float(x) + 0.0:.2f}" for x in np.round(vector / angle, 2))
    return f"T = ({t}) mm · R = {math.degrees(angle):.0f}° about ({axis})"
