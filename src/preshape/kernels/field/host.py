"""The object's signed distance field, prepared once and kept on disk, and exact queries of its surface.

The sign is the generalised winding number (Jacobson et al. 2013), so a scan with holes has an inside too. A
triangle that is wound against its neighbours is turned first (:mod:`preshape.kernels.field.winding`).

The grid is :func:`preshape.kernels.field.warp.field_distance` on the device and
:func:`preshape.kernels.field.plain.field_distance` in NumPy.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...exceptions import InputError
from ...files import cache_folder, keep_arrays, read_arrays
from ...objects.mesh import TriangleMesh
from ...types import Array, IntArray, freeze, frozen_array, read_only, value
from ..launch import in_parts, usable_threads, warp
from ..packed_launch import FIRST, Launch, Rows
from ..surface_points import surface_points as surface_points
from .winding import oriented_triangles

CELLS = 64
PADDING = 0.02
MOST_CELLS = 512
COARSE = 32  # nodes of the coarsest grid along the longest side, which is exact throughout
BAND = 0.01  # exact this near the surface [m] in every grid: where the middle of a fingertip comes
USER_CACHE = ""
"""The user's own cache folder, or ``PRESHAPE_CACHE``."""


@value
class DistanceField:
    """Signed distances to one object on a grid of cubic cells, in the object's frame.

    Attributes:
        origin: (3,) position of node (0, 0, 0) [m].
        spacing: edge of a cell [m].
        distance: (nx, ny, nz) float32 signed distance at the nodes [m], negative inside.
        digest: hash of the mesh and the settings that it was made from.

    Raises:
        InputError: fewer than two nodes along an axis, or numbers that are not finite.
    """

    origin: Array
    spacing: float
    distance: NDArray[np.float32]
    digest: str

    def __post_init__(self) -> None:
        distance = np.array(self.distance, dtype=np.float32, order="C")
        if distance.ndim != 3 or min(distance.shape) < 2 or not np.isfinite(distance).all():
            raise InputError(
                f"a distance field is finite and has two nodes or more along each axis, got {distance.shape}"
            )
        if not (math.isfinite(self.spacing) and self.spacing > 0):
            raise InputError(f"spacing must be positive, got {self.spacing}")
        freeze(self, origin=frozen_array(self.origin, (3,), "origin"), distance=read_only(distance))

    @property
    def bounds(self) -> Array:
        """(2, 3) corners of the grid's box [m]."""
        reach = self.spacing * (np.array(self.distance.shape) - 1)
        return np.array([self.origin, self.origin + reach])


def prepare_field(
    mesh: TriangleMesh, *, cells: int = CELLS, padding: float = PADDING, cache: Path | str | None = USER_CACHE
) -> DistanceField:
    """The signed distance field of an object, from the cache where it has been made before.

    The nodes hold the exact distance within 7 cells and within 10 mm of the surface, beyond both a lower
    bound, some 5 % low. Between nodes the interpolant errs by up to about a quarter of the spacing where
    the surface has an edge, and by half of it where a wall is thinner than that; round fingertips, whose
    middles stay away from the surface, notice less.

    Args:
        mesh: need not be watertight, nor wound consistently.
        cells: nodes along the longest side, padding included.
        padding: room round the object's bounding box [m].
        cache: folder; :data:`USER_CACHE` for the user's own, ``None`` to keep nothing. It may be
            unusable: then nothing is kept.

    Raises:
        InputError: ``cells`` not in 8..512, or ``padding`` negative or not finite.
    """
    if isinstance(cells, bool) or not isinstance(cells, int | np.integer) or not 8 <= cells <= MOST_CELLS:
        raise InputError(f"cells must be a whole number from 8 to {MOST_CELLS}, got {cells!r}")
    if not (math.isfinite(padding) and padding >= 0):
        raise InputError(f"padding must be a length of 0 or more [m], got {padding!r}")
    digest = _digest(mesh, int(cells), float(padding))
    if cache is None:
        return _fill(mesh, int(cells), float(padding), digest)
    file = (Path(cache) if str(cache) else cache_folder()) / "fields" / f"{digest}.npz"
    field = _read(file, digest)
    if field is None:
        field = _fill(mesh, int(cells), float(padding), digest)
        keep_arrays(
            file,
            origin=field.origin,
            spacing=np.float64(field.spacing),
            distance=field.distance,
            digest=np.array(field.digest),
        )
    return field


@value
class Closest:
    """Nearest surface points of n points.

    Attributes:
        distance: (n,) signed [m], negative inside.
        point: (n, 3) on the surface [m].
        normal_out: (n, 3) unit normal of the face, towards increasing signed distance.
        triangle: (n,) index of the face.
    """

    distance: Array
    point: Array
    normal_out: Array
    triangle: IntArray


class SurfaceQuery:
    """Exact nearest points on one mesh, in single precision.

    Args:
        mesh: need not be watertight, nor wound consistently.
        device: Warp's name of the device.

    Attributes:
        mesh: the ``warp.Mesh``, in the object's frame; its ``id`` is the first argument of
            :func:`preshape.kernels.field.warp.nearest_on_mesh`. It lives as long as this object.
    """

    def __init__(self, mesh: TriangleMesh, device: str = "cpu") -> None:
        self.device = device
        self.mesh = _warp_mesh(mesh, device)
        self._bounds = mesh.bounds
        wp, warp_field = _warp()
        self._given = Rows(wp.vec3, device=device)
        kinds = (wp.float32, wp.vec3, wp.vec3, wp.int32)
        self._found = [Rows(kind, device=device) for kind in kinds]
        arguments = [self.mesh.id, FIRST, 0.0, self._given, *self._found]
        self._closest = Launch(
            warp_field.closest_points, arguments, device=device, threads=usable_threads(device)
        )

    def closest(self, points: ArrayLike) -> Closest:
        """The nearest surface point of each point.

        Args:
            points: (n, 3) [m], object frame.

        Raises:
            InputError: not n×3 finite numbers.
        """
        where = frozen_array(points, (None, 3), "points")
        far = float(np.abs(self._bounds).max() + np.abs(where).max(initial=0.0)) * 4.0
        with self._closest.lock:
            self._given.put(where)
            self._closest(len(where), {2: far})
            distance, point, normal_out, triangle = (rows.get(len(where)) for rows in self._found)
        return Closest(
            distance=read_only(distance.astype(np.float64)),
            point=read_only(point.astype(np.float64)),
            normal_out=read_only(normal_out.astype(np.float64)),
            triangle=read_only(triangle.astype(np.int64)),
        )


def _warp() -> tuple[Any, Any]:
    wp = warp()
    from . import warp as warp_field

    return wp, warp_field


def _warp_mesh(mesh: TriangleMesh, device: str) -> Any:
    wp, warp_field = _warp()
    wp.load_module(warp_field, device=device)  # before any thread asks for it
    triangles = oriented_triangles(mesh)
    return wp.Mesh(
        points=wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3, device=device),
        indices=wp.array(triangles.astype(np.int32).ravel(), dtype=int, device=device),
        support_winding_number=True,
    )


def _fill(mesh: TriangleMesh, cells: int, padding: float, digest: str) -> DistanceField:
    wp, warp_field = _warp()
    size = mesh.extents + 2 * padding
    spacing = float(size.max()) / (cells - 1)
    shape = np.maximum(np.ceil(size / spacing - 1e-6).astype(int) + 1, 2)
    origin = mesh.cog - spacing * (shape - 1) / 2
    query = _warp_mesh(mesh, "cpu")
    corner, reach = wp.vec3(*origin.tolist()), 4.0 * float(np.linalg.norm(size))
    doublings = max(1, round(math.log2(cells / COARSE)))
    shapes = [shape]
    for _ in range(doublings):
        shapes.append((shapes[-1] - 1) // 2 + 2)
    grids = [wp.empty(tuple(nodes.tolist()), dtype=float, device="cpu") for nodes in shapes]

    def fill_coarsest(first: int, count: int) -> None:
        inputs = [query.id, first, corner, spacing * 2**doublings, reach, grids[-1]]
        wp.launch(warp_field.coarse_nodes, dim=count, inputs=inputs, device="cpu")

    in_parts(fill_coarsest, grids[-1].size, usable_threads("cpu"))
    for level in reversed(range(doublings)):

        def fill(first: int, count: int, level: int = level) -> None:
            inputs = [query.id, first, corner, spacing * 2**level, BAND, grids[level + 1], grids[level]]
            wp.launch(warp_field.fine_nodes, dim=count, inputs=inputs, device="cpu")

        in_parts(fill, grids[level].size, usable_threads("cpu"))
    return DistanceField(origin=origin, spacing=spacing, distance=grids[0].numpy(), digest=digest)


def _digest(mesh: TriangleMesh, cells: int, padding: float) -> str:
    state = hashlib.sha256(f"field 3 {cells} {padding!r}".encode())
    for array in (mesh.vertices, mesh.triangles):
        state.update(np.ascontiguousarray(array).tobytes())
    return state.hexdigest()[:40]


def _read(file: Path, digest: str) -> DistanceField | None:
    """The cached field; ``None`` where there is none, or the file is damaged."""
    try:
        stored = read_arrays(file)
        if str(stored["digest"]) != digest or stored["distance"].dtype != np.float32:
            return None
        return DistanceField(
            origin=stored["origin"],
            spacing=float(stored["spacing"]),
            distance=stored["distance"],
            digest=digest,
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None
