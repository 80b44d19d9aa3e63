"""A gizmo to set the task by dragging: handles at the object, and a ghost of the object at its goal."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..objects.mesh import TriangleMesh
from ..spatial import pose, rotation_from_quaternion, seven_from_pose
from ..types import Array
from ..viewer.colours import TASK
from ..viewer.reduce import reduced

if TYPE_CHECKING:
    import viser

GHOST = 4_000
"""Largest number of triangles of the ghost."""


class TaskGizmo:
    """A transform gizmo at the COG; dragging it sets the displacement of the object in the task.

    Args:
        scene: The browser's scene.
        dragged: Called on every move with the displacement (4, 4) about the COG c: x' = R(x - c) + c + t [m].
    """

    def __init__(self, scene: viser.SceneApi, dragged: Callable[[Array], None]) -> None:
        self._scene, self._dragged = scene, dragged
        self._handle: Any = None
        self._cog = np.zeros(3)

    @property
    def shown(self) -> bool:
        """Whether the gizmo is shown."""
        return self._handle is not None

    def put(self, mesh: TriangleMesh, displacement: Array) -> None:
        """Show the gizmo for an object, at a displacement (4, 4) about the COG."""
        self.remove()
        self._cog = np.array(mesh.cog)
        handle = self._scene.add_transform_controls(
            "/gizmo",
            scale=0.75 * float(np.linalg.norm(mesh.extents)) / 2,
            line_width=3.0,
            disable_sliders=True,
            depth_test=False,
        )
        vertices, triangles = reduced(mesh.vertices, mesh.triangles, GHOST)
        self._scene.add_mesh_simple(
            "/gizmo/ghost",
            vertices - self._cog,
            triangles,
            color=tuple(round(255 * c) for c in TASK),
            opacity=0.25,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

        def moved(event: Any) -> None:
            if event.client is not None:
                rotation = rotation_from_quaternion(np.array(handle.wxyz, dtype=np.float64))
                self._dragged(pose(rotation, np.array(handle.position, dtype=np.float64) - self._cog))

        handle.on_update(moved)
        self._handle = handle
        self.move(displacement)

    def move(self, displacement: Array) -> None:
        """Move the gizmo to a displacement (4, 4), if it is shown."""
        if self._handle is not None:
            seven = seven_from_pose(pose(displacement[:3, :3], self._cog + displacement[:3, 3]))
            self._handle.position, self._handle.wxyz = seven[:3], seven[3:]

    def remove(self) -> None:
        """Remove the gizmo."""
        if self._handle is not None:
            self._handle.remove()
            self._handle = None
