"""What one browser's scene shows: the object, one answer, and the hand somewhere on its way."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..hands.model import load_hand
from ..objects.mesh import TriangleMesh
from ..viewer.draw import draw_hand, draw_object, draw_plan, move_hand
from ..viewer.framing import framing
from ..viewer.hand_motion import HandMotion
from ..viewer.plan_scene import PlanScene
from .browser_canvas import SEE_THROUGH, BrowserCanvas
from .scenes import Document, document_motion, document_scene, friction_of

if TYPE_CHECKING:
    import viser


class Stage:
    """One browser's scene.

    Args:
        client: the browser.
        picked: called with the index of a plane whose card was clicked.
    """

    def __init__(self, client: viser.ClientHandle, picked: Callable[[int], None]) -> None:
        self._client, self._picked = client, picked
        self._canvas = BrowserCanvas(client.scene, clicked=self._clicked)
        self._lock = threading.RLock()
        self.mesh: TriangleMesh | None = None
        self.scene: PlanScene | None = None
        self.motion: HandMotion | None = None
        self.selected: int | None = None

    def put(self, mesh: TriangleMesh) -> None:
        """Another object, alone."""
        with self._lock:
            self.mesh, self.selected = mesh, None
            self.show(None, None)
            if self.scene is not None:
                draw_object(self.scene, self._canvas)
            self.look()

    def show(
        self,
        document: Document | None,
        answer: Document | None,
        *,
        friction: float = 0.6,
        rays: Sequence[Sequence[float]] | None = None,
        share: float = 1.0,
    ) -> None:
        """Show one answer of a plan, or the object alone."""
        with self._lock:
            if self.mesh is None:
                return
            scene = document_scene(
                self.mesh,
                document,
                answer,
                friction=friction_of(answer, friction) if answer else friction,
                rays=rays,
            )
            motion = document_motion(load_hand(answer["hand"]["name"]), answer) if answer else None
            self.scene, self.motion = scene, motion
            with self._client.atomic():
                draw_plan(scene, self._canvas, selected=self.selected)
                draw_hand(motion, self._canvas, share)

    def move(self, share: float) -> None:
        """Move the hand to a share 0..1 of its way."""
        with self._lock:
            if self.motion is not None:
                with self._client.atomic():
                    move_hand(self.motion, self._canvas, share)

    def select(self, plane: int | None) -> None:
        """Mark a plane's card."""
        with self._lock:
            self.selected = plane
            if self.scene is not None:
                with self._client.atomic():
                    draw_plan(self.scene, self._canvas, selected=plane)

    def layer(self, group: str, visible: bool) -> None:
        """Show or hide a group of solids."""
        with self._lock:
            self._canvas.show(group, visible)

    def glass(self, on: bool, share: float) -> None:
        """Make the hand translucent, or solid."""
        with self._lock:
            self._canvas.hand_opacity = SEE_THROUGH if on else 1.0
            draw_hand(self.motion, self._canvas, share)

    def glass_object(self, on: bool) -> None:
        """Make the object translucent, or solid."""
        with self._lock:
            self._canvas.object_opacity = SEE_THROUGH if on else 1.0
            if self.scene is not None:
                draw_object(self.scene, self._canvas)

    def look(self) -> None:
        """Put the camera where everything is in the picture, seen across the approach plane."""
        with self._lock:
            if self.scene is None:
                return
            camera = framing(self.scene, self.motion, self._aspect())
            with self._client.atomic():
                self._client.camera.fov = np.radians(camera.fov)
                self._client.camera.up_direction = (0.0, 0.0, 1.0)
                self._client.camera.position = camera.eye
                self._client.camera.look_at = camera.target

    def _aspect(self) -> float:
        try:
            return float(np.clip(self._client.camera.aspect, 0.4, 3.0))
        except (AssertionError, ZeroDivisionError, AttributeError):
            return 1.2

    def _clicked(self, name: str) -> None:
        self._picked(int(name.split("/")[1]))
