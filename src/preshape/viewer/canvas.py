"""The protocol for drawing a plan, and an implementation that records what is drawn.

The browser's scene (:mod:`preshape.app`) implements it too, and the page and the picture of a plan replay a
recording. A plan is therefore drawn by the same code everywhere, and tests need no display.
"""

from __future__ import annotations

from typing import Protocol

from ..types import Array
from .raycast import Shape


class Canvas(Protocol):
    """A scene of named solids and labels. Names are paths, for example ``contacts/thumb/cone``."""

    def solid(self, name: str, shape: Shape) -> None:
        """Draw triangles; an earlier solid of the same name is replaced."""

    def label(self, name: str, text: str, at: Array) -> None:
        """Write a short text at a point (3,) [m]."""

    def place(self, name: str, pose: Array) -> None:
        """Move a solid: ``pose`` (4, 4) takes its vertices to the scene."""

    def remove(self, prefix: str) -> None:
        """Remove all solids and labels whose name is ``prefix`` or lies under it; none is no error."""


class RecordingCanvas:
    """A canvas that records what is drawn.

    Attributes:
        solids: Shape of each solid by name, in the order in which the names were first drawn.
        labels: Text and point of each label by name.
        poses: Last pose (4, 4) of each solid that was moved, by name.
    """

    def __init__(self) -> None:
        self.solids: dict[str, Shape] = {}
        self.labels: dict[str, tuple[str, Array]] = {}
        self.poses: dict[str, Array] = {}

    def solid(self, name: str, shape: Shape) -> None:
        """Record a solid."""
        self.solids[name] = shape

    def label(self, name: str, text: str, at: Array) -> None:
        """Record a label."""
        self.labels[name] = (text, at)

    def place(self, name: str, pose: Array) -> None:
        """Record a pose."""
        self.poses[name] = pose

    def remove(self, prefix: str) -> None:
        """Forget all solids and labels whose name is ``prefix`` or lies under it."""
        for recorded in (self.solids, self.labels, self.poses):
            for name in [n for n in recorded if within(n, prefix)]:
                del recorded[name]


def within(name: str, prefix: str) -> bool:
    """Whether a name is ``prefix`` or lies under it.

    >>> within("contacts/thumb", "contacts"), within("contacts2", "contacts")
    (True, False)
    """
    return name == prefix or name.startswith(prefix.rstrip("/") + "/")


def group_of(name: str) -> str:
    """The first part of a name, by which solids and labels are shown or hidden together.

    >>> group_of("contacts/thumb/cone")
    'contacts'
    """
    return name.partition("/")[0]
