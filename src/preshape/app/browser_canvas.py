"""A canvas that draws into the scene of a browser."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..spatial import seven_from_pose
from ..types import Array
from ..viewer.camera import Camera
from ..viewer.canvas import within
from ..viewer.corners import indexed, visible_side
from ..viewer.ground_shadow import GroundShadow
from ..viewer.labels import overlapping_labels
from ..viewer.raycast import Shape

if TYPE_CHECKING:
    import viser

SEE_THROUGH = 0.55
"""Opacity of a translucent hand or object."""


class BrowserCanvas:
    """Draws into one browser; groups of solids and labels can be hidden.

    Args:
        scene: The browser's scene.
        clicked: Called with the name of a ``choosable`` solid that was clicked.
        choosable: Prefix of the names of solids that can be clicked.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        *,
        clicked: Callable[[str], None] | None = None,
        choosable: str = "planes",
    ) -> None:
        self._scene, self._clicked, self._choosable = scene, clicked, choosable
        self._nodes: dict[str, Any] = {}
        self._hidden: set[str] = set()
        self._words: dict[str, tuple[str, Array]] = {}
        self._crowded: set[str] = set()
        self.hand_opacity = self.object_opacity = 1.0

    def solid(self, name: str, shape: Shape) -> None:
        """Draw triangles; an earlier solid of the same name is replaced."""
        self.remove(name)
        vertices, _, triangles = indexed(shape)
        of = {"hand": self.hand_opacity, "object": self.object_opacity}
        alpha = of.get(name.partition("/")[0], shape.alpha)
        node = self._scene.add_mesh_simple(
            f"/{name}",
            vertices,
            triangles,
            color=tuple(round(255 * c) for c in shape.colour),
            opacity=None if alpha >= 1 else alpha,
            # Leaving out invisible back sides halves the work of a browser that renders in software.
            side="front" if within(name, "hand") else visible_side(shape),
            material="standard",
            # Software renderers take seconds to prepare shadows.
            cast_shadow=False,
            receive_shadow=False,
            visible=self._visible(name),
        )
        if self._clicked is not None and within(name, self._choosable):
            clicked = self._clicked

            def on_click(_event: Any) -> None:
                clicked(name)

            node.on_click(on_click)
        self._nodes[name] = node

    def ground(self, name: str, shadow: GroundShadow) -> None:
        """Lay a shadow on the ground; an earlier one of the same name is replaced."""
        self.remove(name)
        seven = seven_from_pose(shadow.place)
        self._nodes[name] = self._scene.add_image(
            f"/{name}",
            shadow.picture,
            shadow.width,
            shadow.width,
            format="png",
            cast_shadow=False,
            receive_shadow=False,
            position=seven[:3],
            wxyz=seven[3:],
            visible=self._visible(name),
        )

    def label(self, name: str, text: str, at: Array) -> None:
        """Write a short text; an earlier label of the same name is replaced."""
        self.remove(name)
        self._words[name] = (text, at)
        self._nodes[name] = self._scene.add_label(
            f"/{name}",
            text,
            position=tuple(float(x) for x in at),
            anchor="center-center",
            font_screen_scale=0.85,
            visible=self._visible(name),
        )

    def place(self, name: str, pose: Array) -> None:
        """Move a solid."""
        node = self._nodes.get(name)
        if node is not None:
            seven = seven_from_pose(pose)
            node.position, node.wxyz = seven[:3], seven[3:]

    def remove(self, prefix: str) -> None:
        """Remove all solids and labels whose name is ``prefix`` or lies under it."""
        for name in [n for n in self._nodes if within(n, prefix)]:
            self._nodes.pop(name).remove()
            self._words.pop(name, None)

    def show(self, group: str, visible: bool) -> None:
        """Hide or show a group, including solids and labels that are drawn into it later."""
        (self._hidden.discard if visible else self._hidden.add)(group)
        for name, node in self._nodes.items():
            if within(name, group):
                node.visible = self._visible(name)

    def declutter(self, camera: Camera, size: tuple[int, int]) -> None:
        """Hide the labels that have no room in a camera's picture of ``size`` (width and height) [pixels]."""
        shown = {n: label for n, label in self._words.items() if not self._behind(n)}
        self._crowded = overlapping_labels(shown, camera, size)
        for name in shown:
            visible = name not in self._crowded
            if self._nodes[name].visible != visible:
                self._nodes[name].visible = visible

    def _visible(self, name: str) -> bool:
        return not self._behind(name) and name not in self._crowded

    def _behind(self, name: str) -> bool:
        return any(within(name, group) for group in self._hidden)
