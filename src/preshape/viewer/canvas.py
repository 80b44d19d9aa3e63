"""What drawing goes through: one protocol, with a version that draws nothing and one that records.

A browser's scene and a page on disk implement it too (:mod:`preshape.app`, :mod:`preshape.viewer.page`), so
that a plan is drawn by the same code everywhere, and tests see what was drawn without any display.
"""

from __future__ import annotations

from typing import Protocol

from ..types import Array
from .raycast import Shape


class Canvas(Protocol):
    """Where named solids and labels are drawn; names are paths, as ``contacts/thumb/cone``."""

    def solid(self, name: str, shape: Shape) -> None:
        """Draw triangles, in place of what had that name."""

    def label(self, name: str, text: str, at: Array) -> None:
        """Write a few words at a point (3,) [m]."""

    def place(self, name: str, pose: Array) -> None:
        """Move a solid: ``pose`` (4, 4) takes its vertices to the scene."""

    def remove(self, prefix: str) -> None:
        """Take away what has that name or lies under it; nothing, where there is nothing."""


class NullCanvas:
    """Draws nothing."""

    def solid(self, name: str, shape: Shape) -> None:
        """Nothing."""

    def label(self, name: str, text: str, at: Array) -> None:
        """Nothing."""

    def place(self, name: str, pose: Array) -> None:
        """Nothing."""

    def remove(self, prefix: str) -> None:
        """Nothing."""


class RecordingCanvas:
    """Keeps what was drawn.

    Attributes:
        solids: name and shape, in the order in which they were drawn first.
        labels: name, words and point.
        poses: name and the last pose (4, 4), where one was set.
    """

    def __init__(self) -> None:
        self.solids: dict[str, Shape] = {}
        self.labels: dict[str, tuple[str, Array]] = {}
        self.poses: dict[str, Array] = {}

    def solid(self, name: str, shape: Shape) -> None:
        """Keep a solid."""
        self.solids[name] = shape

    def label(self, name: str, text: str, at: Array) -> None:
        """Keep a label."""
        self.labels[name] = (text, at)

    def place(self, name: str, pose: Array) -> None:
        """Keep a pose."""
        self.poses[name] = pose

    def remove(self, prefix: str) -> None:
        """Forget what has that name or lies under it."""
        for kept in (self.solids, self.labels, self.poses):
            for name in [n for n in kept if within(n, prefix)]:
                del kept[name]


def within(name: str, prefix: str) -> bool:
    """Whether a name is ``prefix`` or lies under it.

    >>> within("contacts/thumb", "contacts"), within("contacts2", "contacts")
    (True, False)
    """
    return name == prefix or name.startswith(prefix.rstrip("/") + "/")
