"""What a person asks for: object, task, hand and settings, read from the panel; the task also by dragging."""

from __future__ import annotations

import math
from html import escape
from typing import Any

import numpy as np

from ..exceptions import InputError
from ..hiis.planes import AXIS_NAMES
from ..planner import check_analyser
from ..spatial import vector_from_rotation
from ..tasks import displacement_of, family_names, parse_task, q_of_displacement
from ..types import Array
from ..viewer import readings
from .panel import ANY, SIX, UNITS, USUAL, Panel
from .stage import Stage
from .tuning import Tuning
from .worker import Order


class Steering:
    """One browser's wishes.

    Args:
        panel: where they are said.
        stage: where the task can be dragged.
        tuning: membership functions and contact coefficients.
    """

    def __init__(self, panel: Panel, stage: Stage, tuning: Tuning) -> None:
        self._panel, self._stage, self._tuning = panel, stage, tuning
        stage.gizmo_dragged = self.dragged

    @property
    def unit(self) -> str:
        """Of an uploaded file."""
        said = self._panel.unit.value
        return said if said in UNITS else "m"

    def choose_hand(self) -> None:
        """The analyser follows the hand."""
        self._panel.analyser.value = check_analyser(None, self._panel.hand.value)

    def show_task(self) -> None:
        """Sliders, words and gizmo show the task that is named, or the six numbers."""
        task = parse_task(self.task())
        if self._panel.task.value in family_names():
            for slider, number in zip(self._panel.numbers, task.q, strict=True):
                slider.value = float(number)
        motion = displacement_of(task)
        self._say(motion, task.means)
        self._stage.move_gizmo(motion)

    def use_numbers(self) -> None:
        """A slider was moved: the task is six numbers now."""
        self._panel.task.value = SIX
        self.show_task()

    def dragged(self, displacement: Array) -> None:
        """The gizmo was dragged: the task is this displacement's Q, as the paper derives it."""
        self._panel.task.value = SIX
        for slider, number in zip(self._panel.numbers, q_of_displacement(displacement), strict=True):
            slider.value = float(np.round(number, 3))
        self._say(displacement, "")

    def switch_gizmo(self) -> None:
        """Show the gizmo, or take it away."""
        on = bool(self._panel.drag.value)
        self._stage.show_gizmo(displacement_of(parse_task(self.task())) if on else None)

    def take(self, offer: str) -> None:
        """An offered task becomes the task, as ``lift:+z``."""
        name, _, axis = offer.partition(":")
        self._panel.task.value = name
        self._panel.axis.value = axis if axis in AXIS_NAMES else USUAL
        self.show_task()

    def task(self) -> str:
        """The task as text that :func:`~preshape.tasks.parse_task` reads."""
        name, axis = self._panel.task.value, self._panel.axis.value
        if name not in family_names():
            return " ".join(f"{slider.value:.3f}" for slider in self._panel.numbers)
        return f"{name}:{axis}" if axis in AXIS_NAMES and axis != USUAL else str(name)

    def order(self, source: str, unit: str, scale: float, memory: str | None) -> Order:
        """Everything that is asked for.

        Raises:
            InputError: a hand that is not in the list.
        """
        p = self._panel
        if p.hand.value not in p.hand.options:
            raise InputError(f"no hand {p.hand.value!r:.60} here; choose one of the list")
        return Order(
            source=source,
            unit=unit,
            scale=scale,
            task=self.task(),
            hand=str(p.hand.value),
            analyser=str(p.analyser.value),
            estimation=float(p.estimation.value),
            recognition=float(p.recognition.value),
            friction=float(p.friction.value),
            mass=float(p.mass.value),
            approaches="" if p.approach.value == ANY else str(p.approach.value),
            memory=memory,
            corners=self._tuning.corners,
            shape=self._tuning.shape,
            coefficients=self._tuning.coefficients,
        )

    def _say(self, displacement: Array, means: str) -> None:
        told = f"{escape(means)}<br>" if means else ""
        words = f'<p class="quiet">{told}{motion_words(displacement)}</p>'
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
