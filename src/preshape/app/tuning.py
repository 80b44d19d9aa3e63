"""Membership functions and contact coefficients: curves whose points can be dragged, and a way back."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..hiis.fuzzy import SET_NAMES, SHAPES, FuzzySets
from ..types import ContactCoefficients
from ..viewer import readings
from .curves import COEFFICIENTS, CORNERS, EDGE, coefficient_svg, membership_svg

if TYPE_CHECKING:
    import viser

MOST = 1.5
"""Largest coefficient that can be set."""
WORDS = "Friction along the approach, friction across it, normal force, moment about the normal"


class Tuning:
    """The widgets, and the settings that they stand for.

    Args:
        gui: the panel; the widgets are made where it is just now.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._corners = np.array(FuzzySets().corners)
        self._four = (0.0, 0.0, 0.0, 0.0)
        gui.add_html(
            readings.wrapped(
                "<h3>Membership functions</h3><p class='quiet'>Seven sets name every number from strongly "
                "backward to strongly forward; a task and a grasp agree where they share sets. "
                "Drag the corners of the chosen one; Plan uses them.</p>"
            )
        )
        self.which = gui.add_dropdown("Set", SET_NAMES, initial_value="ZERO")
        self.curve = gui.add_html("")
        self.corner = gui.add_text(
            CORNERS, "", hint="Feet and shoulders of the chosen set, from left to right"
        )
        self.kind = gui.add_dropdown("Shape", SHAPES, initial_value=FuzzySets().shape)
        self.reset_sets = gui.add_button("Reset the membership functions", color="gray")
        gui.add_html(
            readings.wrapped(
                "<h3>Contact coefficients</h3><p class='quiet'>What one finger's contact gives for each unit "
                "that it presses with; the net wrench is their sum. ka: friction along the approach, ko: "
                "across it, kn: normal force, mn: moment about the normal. Drag the ends.</p>"
            )
        )
        self.lines = gui.add_html("")
        self.numbers = gui.add_text(COEFFICIENTS, "", hint=WORDS)
        self.reset_coefficients = gui.add_button("Reset the coefficients", color="gray")
        self.choose()
        self.undo_coefficients()

    def wire(self, on: Callable[[Any, Callable[[], None]], None]) -> None:
        """Answer to the widgets.

        Args:
            on: how a widget is bound to what it does.
        """
        on(self.which, self.choose)
        on(self.corner, self.drag)
        on(self.numbers, self.drag_coefficients)
        on(self.kind, self._draw)
        on(self.reset_sets, self.undo_sets)
        on(self.reset_coefficients, self.undo_coefficients)

    @property
    def sets(self) -> FuzzySets:
        """The membership functions as they are drawn."""
        kind = self.kind.value if self.kind.value in SHAPES else SHAPES[0]
        return FuzzySets(corners=self._corners, shape=kind)

    @property
    def corners(self) -> tuple[float, ...]:
        """28 numbers, four of each set."""
        return tuple(float(c) for c in self._corners.ravel())

    @property
    def shape(self) -> str:
        """Name of the functions' shape."""
        return self.sets.shape

    @property
    def coefficients(self) -> tuple[float, ...]:
        """The four coefficients, in the order of ``PARTS``."""
        return self._four

    def choose(self) -> None:
        """Another set is to be dragged."""
        self.corner.value = " ".join(f"{c:g}" for c in self._corners[self._index])
        self._draw()

    def drag(self) -> None:
        """A corner was dragged, or typed; what is no four numbers in order waits until it is."""
        four = _four_numbers(self.corner.value, -EDGE, EDGE)
        if four is not None and sorted(four) == list(four):
            self._corners[self._index] = four
            self._draw()

    def drag_coefficients(self) -> None:
        """A coefficient was dragged, or typed."""
        four = _four_numbers(self.numbers.value, 0.0, MOST)
        if four is not None:
            self._four = four
            self._draw()

    def undo_sets(self) -> None:
        """The paper's membership functions again."""
        usual = FuzzySets()
        self._corners = np.array(usual.corners)
        self.kind.value = usual.shape
        self.choose()

    def undo_coefficients(self) -> None:
        """The default coefficients again."""
        usual = ContactCoefficients()
        self._four = (usual.ka, usual.ko, usual.kn, usual.mn)
        self.numbers.value = " ".join(f"{c:g}" for c in self._four)
        self._draw()

    @property
    def _index(self) -> int:
        return SET_NAMES.index(self.which.value) if self.which.value in SET_NAMES else 3

    def _draw(self) -> None:
        changed = not np.allclose(self._corners, FuzzySets().corners) or self.kind.value != FuzzySets().shape
        note = "<p class='quiet'>Changed: answers no longer compare with the paper's.</p>" if changed else ""
        self.curve.content = readings.wrapped(membership_svg(self.sets, self._index), note)
        ka, ko, kn, mn = self._four
        drawn = coefficient_svg(ContactCoefficients(ka=ka, ko=ko, kn=kn, mn=mn), MOST)
        self.lines.content = readings.wrapped(drawn)


def _four_numbers(text: str, low: float, high: float) -> tuple[float, float, float, float] | None:
    """Four numbers within bounds; ``None`` where the text is something else."""
    try:
        a, b, c, d = (float(word) for word in str(text).split())
    except ValueError:
        return None
    return (a, b, c, d) if all(low <= x <= high for x in (a, b, c, d)) else None
