"""The scene of one browser: the object, one answer, and the moving hand."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..exceptions import InputError
from ..hands.load import recorded_hand
from ..kernels.rays import MISS, cast_plain
from ..objects.mesh import TriangleMesh
from ..pictures import Document, document_motion, plan_scene
from ..planning.standing import AUTO, standing
from ..spatial import transform_points
from ..types import Array, IntArray
from ..viewer.camera import Camera
from ..viewer.colours import Colour
from ..viewer.draw import draw_hand, draw_object, draw_plan, draw_scenery, move_hand, recorded
from ..viewer.framing import fitting, following
from ..viewer.ground_shadow import ground_shadow
from ..viewer.hand_motion import HandMotion
from ..viewer.plan_scene import PlanScene
from ..viewer.raycast import Shape
from .browser_canvas import SEE_THROUGH, BrowserCanvas
from .gizmo import TaskGizmo
from .physics_player import QUIET_GROUPS, Run, RunPlayer

if TYPE_CHECKING:
    import viser

SHADOW = "shadow"
"""Name of the object's shadow on the ground."""
PARTS = "parts"
"""Group of the paint on parts that are asked for."""
PAINT = 0.0004
"""Distance of the paint from the surface [m]."""
LIFTED = 0.004
"""Height above its place from which on an object has no shadow there [m]."""

SOON = 0.25
"""Delay between a camera move and the next choice of visible labels [s]."""


class Stage:
    """One browser's scene.

    Args:
        client: The browser.
        picked: Called with the index of a plane whose card was clicked.
        part_picked: Called with the index of the object's part that was clicked.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        picked: Callable[[int], None],
        part_picked: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._client, self._picked, self._part_picked = client, picked, part_picked
        self._share = 1.0
        self._part_of: IntArray = np.zeros(0, dtype=np.int64)
        self._waiting = False
        client.camera.on_update(lambda _: self._moved())
        self._canvas = BrowserCanvas(client.scene, clicked=self._clicked)
        client.scene.on_click()(self._pressed)
        self._gizmo = TaskGizmo(client.scene, self._dragged)
        self._player = RunPlayer(self._canvas)
        self._hidden: set[str] = set()
        self._shaded: tuple[TriangleMesh, bytes, float] | None = None
        self._scenery: tuple[float | str | None, Array] = (None, np.zeros((0, 2, 3)))
        self.gizmo_dragged: Callable[[Array], None] = lambda _: None
        self.run: Run | None = None
        self._lock = threading.RLock()
        self.mesh: TriangleMesh | None = None
        self.scene: PlanScene | None = None
        self.motion: HandMotion | None = None
        self.selected: int | None = None

    def put(self, mesh: TriangleMesh, part_of: IntArray) -> None:
        """Show another object, alone.

        Args:
            mesh: The object, as it is drawn.
            part_of: (m,) index of the part of each triangle, -1 for none.
        """
        with self._lock:
            self.mesh, self._part_of, self.selected = mesh, part_of, None
            self._canvas.remove(PARTS)
            self._gizmo.remove()
            self.show(None, None)
            if self.scene is not None:
                draw_object(self.scene, self._canvas)
            self.look()

    def show(
        self,
        document: Document | None,
        answer: Document | None,
        *,
        rays: Sequence[Sequence[float]] | None = None,
        share: float = 1.0,
    ) -> None:
        """Show one answer of a plan; without a plan, the object with the panel's table and boxes."""
        with self._lock:
            if self.mesh is None:
                return
            self.leave_run()
            scene = plan_scene(document, self.mesh, None, answer, rays=rays)
            if document is None:
                scene = self._with_scenery(scene)
            motion = document_motion(recorded_hand(answer["hand"]), answer) if answer else None
            self.scene, self.motion, self._share = scene, motion, share
            with self._client.atomic():
                draw_plan(scene, self._canvas, selected=self.selected)
                draw_hand(motion, self._canvas, share)
                self._shade(scene)
            self._moved()

    def show_scenery(self, table: float | str | None, boxes: Sequence[Sequence[float]]) -> None:
        """Show the panel's table and boxes instead of the shown ones.

        Args:
            table: Height along up [m], ``auto`` for the table that the object rests on, or ``None``.
            boxes: Six numbers each: lower and upper corner [m].
        """
        with self._lock:
            self._scenery = table, np.array(boxes, dtype=np.float64).reshape(-1, 2, 3)
            if self.scene is not None:
                self.scene = self._with_scenery(self.scene)
                with self._client.atomic():
                    draw_scenery(self.scene, self._canvas)
                    self._shade(self.scene)
                self._moved()

    def mark(self, uses: Mapping[int, Colour]) -> None:
        """Paint parts of the object, by index; an earlier paint is removed."""
        with self._lock, self._client.atomic():
            self._canvas.remove(PARTS)
            for part, colour in uses.items():
                own = np.flatnonzero(self._part_of == part)
                if self.mesh is None or not len(own):
                    continue
                # Neighbours stay joined, because each vertex moves along the mean normal of its triangles.
                triangles, outward = self.mesh.triangles[own], np.zeros_like(self.mesh.vertices)
                for k in range(3):
                    np.add.at(outward, triangles[:, k], self.mesh.normals[own])
                lengths = np.linalg.norm(outward, axis=1, keepdims=True)
                lifted = self.mesh.vertices + PAINT * outward / np.maximum(lengths, 1e-12)
                shape = Shape(vertices=lifted, triangles=triangles, colour=colour, smooth=True)
                self._canvas.solid(f"{PARTS}/{part}", shape)

    def _shade(self, scene: PlanScene) -> None:
        """Draw the object's shadow on the table, else on a ground that it stands on."""
        lowest = float((scene.mesh.vertices @ scene.up).min())
        ground = lowest if scene.table is None else float(scene.table)
        key = scene.mesh, scene.up.tobytes(), ground
        if key != self._shaded:
            self._shaded = key
            height = ground + 0.002 * scene.size  # above the table's sheet
            self._canvas.ground(SHADOW, ground_shadow(scene.mesh, scene.up, height))

    def _with_scenery(self, scene: PlanScene) -> PlanScene:
        table, boxes = self._scenery
        # A height that is being typed may still be above the lowest point; the request refuses it.
        stands = standing(scene.mesh, table=AUTO if table is not None else None)
        if isinstance(table, str):
            assert stands.table is not None
            return replace(scene, table=float(stands.table[3]), boxes=boxes, up=stands.up)
        return replace(scene, table=table, boxes=boxes, up=stands.upright[2])

    def move(self, share: float) -> None:
        """Move the hand to a fraction 0..1 of its motion."""
        with self._lock:
            self.leave_run()
            self._share = share
            if self.motion is not None:
                with self._client.atomic():
                    move_hand(self.motion, self._canvas, share)

    def select(self, plane: int | None) -> None:
        """Highlight a plane's card."""
        with self._lock:
            self.selected = plane
            if self.scene is not None:
                with self._client.atomic():
                    draw_plan(self.scene, self._canvas, selected=plane)
                self._moved()

    def layer(self, group: str, visible: bool) -> None:
        """Show or hide a group of solids."""
        with self._lock:
            (self._hidden.discard if visible else self._hidden.add)(group)
            if self.run is None or group not in QUIET_GROUPS:
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

    def show_run(self, run: Run, frame: int) -> None:
        """Show a sample of a run in simulated physics; the plan's drawing is hidden meanwhile."""
        with self._lock:
            if self.motion is None or self.mesh is None or self.scene is None:
                return
            with self._client.atomic():
                if self.run is not run:
                    for group in QUIET_GROUPS:
                        self._canvas.show(group, False)
                    self._canvas.show(PARTS, False)
                    self.run = run
                    self._put(following(self.scene, run.object_poses, run.links, self._size()))
                self._player.show(run, self.motion.links, frame, self.mesh)
                # The shadow is that of the object where it stands.
                risen = (run.object_poses[frame][:3, 3] - run.object_poses[0][:3, 3]) @ self.scene.up
                self._canvas.show(SHADOW, bool(risen < LIFTED))

    def leave_run(self) -> None:
        """Return from a run in simulated physics to the plan."""
        with self._lock:
            if self.run is None:
                return
            self.run = None
            self._player.leave()
            self._canvas.show(SHADOW, True)
            self._canvas.show(PARTS, True)
            for group in QUIET_GROUPS:
                self._canvas.show(group, group not in self._hidden)
            if self.motion is not None:
                move_hand(self.motion, self._canvas, 1.0)
            self.look()

    def show_gizmo(self, displacement: Array | None) -> None:
        """Show the gizmo of the task at a displacement (4, 4), or remove it."""
        with self._lock:
            if displacement is None or self.mesh is None:
                self._gizmo.remove()
            else:
                self._gizmo.put(self.mesh, displacement)

    def move_gizmo(self, displacement: Array) -> None:
        """Move the gizmo, if it is shown."""
        with self._lock:
            self._gizmo.move(displacement)

    def look(self) -> None:
        """Place the camera so that everything is in the picture, seen across the approach plane."""
        with self._lock:
            if self.scene is None:
                return
            with self._client.atomic():
                self._put(fitting(self.scene, self.motion, self._size()))
            self._moved()

    def _put(self, camera: Camera) -> None:
        seen = self._client.camera
        seen.fov = np.radians(camera.fov)
        seen.up_direction = camera.up
        seen.position, seen.look_at = camera.eye, camera.target

    def _moved(self) -> None:
        """Schedule a new choice of the visible labels, because camera or labels have changed."""
        if not self._waiting:
            self._waiting = True
            timer = threading.Timer(SOON, self._declutter)
            timer.daemon = True
            timer.start()

    def _declutter(self) -> None:
        self._waiting = False
        seen = self._client.camera
        # A browser that has disconnected, or has sent no usable camera yet, needs no choice of labels.
        with contextlib.suppress(AssertionError, InputError, TypeError, ValueError), self._lock:
            camera = Camera(
                eye=seen.position, target=seen.look_at, up=seen.up_direction, fov=np.degrees(seen.fov)
            )
            with self._client.atomic():
                self._canvas.declutter(camera, (seen.image_width, seen.image_height))

    def _size(self) -> tuple[int, int]:
        """Width and height of the browser's picture [pixels]; a guess before the browser has sent them."""
        try:
            seen = self._client.camera
            return max(1, int(seen.image_width)), max(1, int(seen.image_height))
        except (AssertionError, AttributeError):
            return 890, 742

    def _dragged(self, displacement: Array) -> None:
        self.gizmo_dragged(displacement)

    def _clicked(self, name: str) -> None:
        self._picked(int(name.split("/")[1]))

    def _pressed(self, event: Any) -> None:
        """A click anywhere in the scene; a click on a card is heard beside it."""
        direction = np.array(event.ray_direction, dtype=np.float64)
        part = self._part_met(np.array(event.ray_origin), direction / np.linalg.norm(direction))
        if part >= 0:
            self._part_picked(part)

    def _part_met(self, origin: Array, direction: Array) -> int:
        """Index of the part that a ray meets first; -1 where it meets none, or hand or card before."""
        with self._lock:
            mesh, motion = self.mesh, self.motion
            if mesh is None or self.scene is None or self.run is not None:
                return -1
            ray = origin[None], direction[None]
            hit = cast_plain(mesh, *ray)
            if hit.triangle[0] == MISS:
                return -1
            before = [s for name, s in recorded(self.scene).solids.items() if name.startswith("planes/")]
            if motion is not None:
                before += [
                    replace(shape, vertices=transform_points(pose, shape.vertices))
                    for shape, pose in zip(motion.shapes, motion.at(self._share), strict=True)
                ]
            for shape in before:
                solid = TriangleMesh(name="before", vertices=shape.vertices, triangles=shape.triangles)
                if cast_plain(solid, *ray).distance[0] < hit.distance[0]:
                    return -1
            return int(self._part_of[hit.triangle[0]])
