"""Membership functions and contact coefficients as curves whose points can be dragged."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..hiis.decision import Settings
from ..hiis.fuzzy import SET_NAMES, SHAPES, FuzzySets
from ..types import ContactCoefficients
from ..viewer import readings
from .curves import COEFFICIENTS, CORNERS, EDGE, coefficient_svg, membership_svg

if TYPE_CHECKING:
    import viser

MOST = 1.5
"""Largest coefficient that can be set."""


class Tuning:
    """The widgets, and the settings that they represent.

    Args:
        gui: The panel; the widgets are added at its current position.
        settings: Settings that the widgets show at first.
    """

    def __init__(self, gui: viser.GuiApi, settings: Settings) -> None:
        self._corners = np.array(settings.sets.corners)
        self.coefficients = settings.coefficients
        gui.add_html(
            readings.wrapped(
                "<h3>Membership functions</h3><p class='quiet'>Seven sets name every number from strongly "
                "backward to strongly forward; a task and a grasp agree where they share sets. "
                "Drag the corners of the chosen set; the next plan uses them.</p>"
            )
        )
        self.which = gui.add_dropdown("Set", SET_NAMES, initial_value="ZERO")
        self.curve = gui.add_html("")
        self.corner = gui.add_text(
            CORNERS, "", hint="Feet and shoulders of the chosen set, from left to right"
        )
        self.kind = gui.add_dropdown("Shape", SHAPES, initial_value=settings.sets.shape)
        self.reset_sets = gui.add_button("Reset the membership functions", color="gray")
        gui.add_html(
            readings.wrapped(
                "<h3>Contact coefficients</h3><p class='quiet'>Force and moment of one finger's contact per "
                "unit of normal force; the net wrench is their sum. ka: friction along the approach, ko: "
                "friction across it, kn: normal force, mn: moment about the normal. Drag the ends.</p>"
            )
        )
        self.lines = gui.add_html("")
        self.numbers = gui.add_text(COEFFICIENTS, "", hint="The four coefficients ka, ko, kn and mn")
        self.reset_coefficients = gui.add_button("Reset the coefficients", color="gray")
        self.choose()
        self._show_coefficients()

    def wire(self, on: Callable[[Any, Callable[[], None]], None]) -> None:
        """Connect the widgets.

        Args:
            on: Connects a widget to a function that is called when the widget changes.
        """
        on(self.which, self.choose)
        on(self.corner, self.drag)
        on(self.numbers, self.drag_coefficients)
        on(self.kind, self._draw)
        on(self.reset_sets, self.undo_sets)
        on(self.reset_coefficients, self.undo_coefficients)

    @property
    def sets(self) -> FuzzySets:
        """The membership functions that the curves show."""
        kind = self.kind.value if self.kind.value in SHAPES else SHAPES[0]
        return FuzzySets(corners=self._corners, shape=kind)

    def choose(self) -> None:
        """Show the corners of the chosen set."""
        self.corner.value = " ".join(f"{c:g}" for c in self._corners[self._index])
        self._draw()

    def drag(self) -> None:
        """Use the corners in the text box, if they are four numbers in ascending order."""
        four = _four_numbers(self.corner.value, -EDGE, EDGE)
        if four is not None and sorted(four) == list(four):
            self._corners[self._index] = four
            self._draw()

    def drag_coefficients(self) -> None:
        """Use the coefficients in the text box, if they are four numbers."""
        four = _four_numbers(self.numbers.value, 0.0, MOST)
        if four is not None:
            self.coefficients = ContactCoefficients(ka=four[0], ko=four[1], kn=four[2], mn=four[3])
            self._draw()

    def undo_sets(self) -> None:
        """Return to the paper's membership functions."""
        usual = FuzzySets()
        self._corners = np.array(usual.corners)
        self.kind.value = usual.shape
        self.choose()

    def undo_coefficients(self) -> None:
        """Return to the default coefficients."""
        self.coefficients = ContactCoefficients()
        self._show_coefficients()

    def _show_coefficients(self) -> None:
        c = self.coefficients
        self.numbers.value = " ".join(f"{number:g}" for number in (c.ka, c.ko, c.kn, c.mn))
        self._draw()

    @property
    def _index(self) -> int:
        return SET_NAMES.index(self.which.value) if self.which.value in SET_NAMES else 3

    def _draw(self) -> None:
        changed = not np.allclose(self._corners, FuzzySets().corners) or self.kind.value != FuzzySets().shape
        note = "<p class='quiet'>Changed: answers no longer compare with the paper's.</p>" if changed else ""
        self.curve.content = readings.wrapped(membership_svg(self.sets, self._index), note)
        self.lines.content = readings.wrapped(coefficient_svg(self.coefficients, MOST))


def _four_numbers(text: str, low: float, high: float) -> tuple[float, float, float, float] | None:
    """Four numbers within bounds; ``None`` for any other text."""
    try:
        a, b, c, d = (float(word) for word in str(text).split())
    except ValueError:
        return None
    return (a, b, c, d) if all(low <= x <= high for x in (a, b, c, d)) else None
