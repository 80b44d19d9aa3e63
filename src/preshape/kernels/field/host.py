"""The object's signed distance field, computed once and cached on disk, and exact queries of its surface.

The sign comes from the generalised winding number (Jacobson et al. 2013), so even a scan with holes has an
inside. Triangles that are wound against their neighbours are reversed first
(:mod:`preshape.objects.winding`). The function ``field_distance`` reads the field: that of :mod:`.warp` on
the device, that of :mod:`.plain` in NumPy.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...exceptions import InputError, shown
from ...files import cache_folder, keep_arrays, read_arrays
from ...objects.mesh import TriangleMesh
from ...objects.winding import orient, oriented_triangles, reversed_triangles
from ...types import Array, IntArray, freeze, frozen_array, read_only, value
from ..cache import load_kernels
from ..launch import in_parts, usable_threads, warp
from ..packed_launch import FIRST_ROW, DeviceRows, PackedLaunch
from ..rays import Hits, exact_hits

CELLS = 64
LARGEST_CELL = 0.004  # edge of a cell above which a long, thin object gets more of them [m]
PADDING = 0.02
MOST_CELLS = 512
COARSE = 32  # nodes along the longest side of the coarsest grid, all of which are exact
BAND = 0.01  # every grid is exact within this distance of the surface [m], where fingertips' centres are
USER_CACHE = ""
"""Stands for the folder ``PRESHAPE_CACHE``, or for the user's own cache folder if that is not set."""
_WARP_MESHES: WeakKeyDictionary[TriangleMesh, dict[str, Any]] = WeakKeyDictionary()


@value
class DistanceField:
    """Signed distances to one object on a grid of cubic cells, in the mesh frame.

    Attributes:
        origin: (3,) position of node (0, 0, 0) [m].
        spacing: Edge of a cell [m].
        distance: (nx, ny, nz) float32 signed distance at the nodes [m], negative inside.
        digest: Hash of the mesh and of the settings of the field.

    Raises:
        InputError: There are fewer than two nodes along an axis, or numbers that are not finite.
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
    mesh: TriangleMesh,
    *,
    cells: int | None = None,
    padding: float = PADDING,
    signed: bool = True,
    cache: Path | str | None = USER_CACHE,
) -> DistanceField:
    """Get the signed distance field of an object, from the cache if it was computed before.

    A node holds the exact distance within 7 cells or 10 mm of the surface, whichever is larger. Farther away
    it holds a lower bound that is about 5 % too low. Between nodes, the interpolation error is up to a
    quarter of the spacing at an edge of the surface, and up to half the spacing at a wall thinner than the
    spacing. It matters less for fingertips, because their centres stay away from the surface.

    Args:
        mesh: The object; it need be neither watertight nor consistently wound.
        cells: Nodes along the longest side, padding included; ``None`` for 64, or more along a long object
            that is thin enough: cells of 4 mm, or larger ones so that there are no more nodes than in a cube.
        padding: Margin around the object's bounding box [m].
        signed: Whether distances are negative inside; otherwise both sides of the surface are outside.
        cache: Folder of the cache; :data:`USER_CACHE` for the default folder, ``None`` for no cache. A folder
            that cannot be used is ignored.

    Raises:
        InputError: ``cells`` is not in 8..512, or ``padding`` is negative or not finite.
    """
    if not (math.isfinite(padding) and padding >= 0):
        raise InputError(f"padding must be a length of 0 or more [m], got {shown(padding)}")
    if cells is None:
        cells = _usual_cells(mesh, padding)
    if isinstance(cells, bool) or not isinstance(cells, int | np.integer) or not 8 <= cells <= MOST_CELLS:
        raise InputError(f"cells must be a whole number from 8 to {MOST_CELLS}, got {shown(cells)}")
    digest = _digest(mesh, int(cells), float(padding), signed)
    if cache is None:
        return _fill(mesh, int(cells), float(padding), digest, signed)
    file = (Path(cache) if str(cache) else cache_folder()) / "fields" / f"{digest}.npz"
    field = _read(file, digest, mesh)
    if field is None:
        field = _fill(mesh, int(cells), float(padding), digest, signed)
        keep_arrays(
            file,
            origin=field.origin,
            spacing=np.float64(field.spacing),
            distance=field.distance,
            digest=np.array(field.digest),
            turned=reversed_triangles(mesh),
        )
    return field


@value
class Closest:
    """The nearest surface points of n points.

    Attributes:
        distance: (n,) signed distance [m], negative inside.
        point: (n, 3) nearest point of the surface [m].
        normal_out: (n, 3) unit normal of its triangle, towards increasing signed distance.
        triangle: (n,) index of its triangle.
    """

    distance: Array
    point: Array
    normal_out: Array
    triangle: IntArray


class SurfaceQuery:
    """Exact nearest points on one mesh, and first hits of rays, in single precision.

    Args:
        mesh: The object; it need be neither watertight nor consistently wound.
        device: ``cpu`` or a CUDA device's name.

    Attributes:
        mesh: The ``warp.Mesh``, in the mesh frame; its ``id`` is the first argument of
            :func:`preshape.kernels.field.warp.nearest_on_mesh`. It exists as long as this object.
        is_lid: (m,) whether each triangle is a lid, which no finger can touch.
    """

    def __init__(self, mesh: TriangleMesh, device: str = "cpu") -> None:
        self.device = device
        self.mesh = _warp_mesh(mesh, device)
        self.is_lid = mesh.is_lid
        self._source = mesh
        wp, warp_field = _warp()
        self._given = DeviceRows(wp.vec3, device=device)
        kinds = {"distance": wp.float32, "point": wp.vec3, "normal_out": wp.vec3, "triangle": wp.int32}
        self._found = {name: DeviceRows(kind, device=device) for name, kind in kinds.items()}
        arguments = {"mesh": self.mesh.id, "points": self._given, "reach": 0.0, "first": FIRST_ROW}
        self._closest = PackedLaunch(
            warp_field.closest_points,
            {**arguments, **self._found},
            device=device,
            threads=usable_threads(device),
        )
        self._rays = DeviceRows(wp.vec3, device=device), DeviceRows(wp.vec3, device=device)
        self._met = DeviceRows(wp.int32, device=device)
        rays = dict(zip(("origins", "directions"), self._rays, strict=True))
        self._first_hits = PackedLaunch(
            warp_field.first_hits,
            {"mesh": self.mesh.id, **rays, "reach": 0.0, "first": FIRST_ROW, "triangle": self._met},
            device=device,
            threads=usable_threads(device),
        )

    def closest(self, points: ArrayLike, *, within: float = math.inf) -> Closest:
        """The nearest surface point of each point.

        Args:
            points: (n, 3) in the mesh frame [m].
            within: Points that are farther away than this get an infinite distance and triangle -1 [m]; a
                small value is faster.

        Raises:
            InputError: The points are not n×3 finite numbers.
        """
        where = frozen_array(points, (None, 3), "points")
        with self._closest.lock:
            self._given.put(where)
            self._closest(len(where), {"reach": min(self._beyond(where), within)})
            distance, point, normal_out, triangle = (rows.get(len(where)) for rows in self._found.values())
        return Closest(
            distance=read_only(distance.astype(np.float64)),
            point=read_only(point.astype(np.float64)),
            normal_out=read_only(normal_out.astype(np.float64)),
            triangle=read_only(triangle.astype(np.int64)),
        )

    def cast(self, origins: Array, directions: Array) -> Hits:
        """First hit of each ray, as :func:`preshape.kernels.rays.cast_plain` finds it.

        The triangle is found in single precision, the distance to it in double precision. Unlike with
        :class:`preshape.kernels.rays.RayCaster`, the frame's origin must be near the object, and a ray aimed
        exactly at an edge may pass it.

        Args:
            origins: (n, 3) in the mesh frame [m].
            directions: (n, 3) unit vectors.
        """
        with self._first_hits.lock:
            for rows, given in zip(self._rays, (origins, directions), strict=True):
                rows.put(given)
            self._first_hits(len(origins), {"reach": self._beyond(origins)})
            triangle = self._met.get(len(origins)).astype(np.int64)
        return exact_hits(self._source, triangle, origins, directions)

    def _beyond(self, points: Array) -> float:
        """A distance that nothing on the mesh is farther away than from these points [m]."""
        return float(np.abs(self._source.bounds).max() + np.abs(points).max(initial=0.0)) * 4.0


def _warp() -> tuple[Any, Any]:
    wp = warp()
    from . import warp as warp_field

    return wp, warp_field


def _warp_mesh(mesh: TriangleMesh, device: str) -> Any:
    """The mesh on a device, made once for field and query and kept as long as the mesh exists."""
    wp, warp_field = _warp()
    load_kernels(warp_field, device)
    on_devices = _WARP_MESHES.setdefault(mesh, {})
    if device not in on_devices:
        on_devices[device] = wp.Mesh(
            points=wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3, device=device),
            indices=wp.array(oriented_triangles(mesh).astype(np.int32).ravel(), dtype=int, device=device),
            support_winding_number=True,
        )
    return on_devices[device]


def _usual_cells(mesh: TriangleMesh, padding: float) -> int:
    size = mesh.extents + 2 * padding
    # With 64 nodes along a metre, fingertips would sink into a thin plate by more than their radius.
    spacing = max(LARGEST_CELL, float(np.cbrt(size.prod())) / (CELLS - 1))
    return min(max(CELLS, int(size.max() / spacing) + 1), MOST_CELLS)


def _fill(mesh: TriangleMesh, cells: int, padding: float, digest: str, signed: bool) -> DistanceField:
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
            inputs = [query.id, grids[level + 1], first, corner, spacing * 2**level, BAND, grids[level]]
            wp.launch(warp_field.fine_nodes, dim=count, inputs=inputs, device="cpu")

        in_parts(fill, grids[level].size, usable_threads("cpu"))
    distance = grids[0].numpy() if signed else np.abs(grids[0].numpy())
    return DistanceField(origin=origin, spacing=spacing, distance=distance, digest=digest)


def _digest(mesh: TriangleMesh, cells: int, padding: float, signed: bool) -> str:
    state = hashlib.sha256(f"field 3 {cells} {padding!r}{'' if signed else ' unsigned'}".encode())
    for array in (mesh.vertices, mesh.triangles):
        state.update(np.ascontiguousarray(array).tobytes())
    return state.hexdigest()[:40]


def _read(file: Path, digest: str, mesh: TriangleMesh) -> DistanceField | None:
    """The cached field; ``None`` if there is none or its file is damaged.

    With it comes which triangles of the mesh have to be reversed.
    """
    try:
        stored = read_arrays(file)
        if str(stored["digest"]) != digest or stored["distance"].dtype != np.float32:
            return None
        turn = stored["turned"]
        if turn.dtype != bool or turn.shape != (len(mesh.triangles),):
            return None
        field = DistanceField(
            origin=stored["origin"],
            spacing=float(stored["spacing"]),
            distance=stored["distance"],
            digest=digest,
        )
        orient(mesh, turn)
        return field
    except (OSError, ValueError, KeyError, TypeError):
        return None
