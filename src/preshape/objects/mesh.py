"""A triangle mesh as a value: vertices, triangles, and the quantities that follow from them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..exceptions import InputError, ObjectError, shown
from ..types import (
    LONGEST_NAME,
    Array,
    Attributes,
    BoolArray,
    IntArray,
    freeze,
    frozen_array,
    numbers,
    one_of,
    positive_number,
    read_only,
    rebuilt,
    whole_number,
)
from .parts import ObjectPart, PartRule
from .scans.scan import Scan

UP_AXES = ("x", "y", "z", "-x", "-y", "-z")
"""Names of the axes of a mesh that may be up."""
LEAST_LENGTH = 1e-6
"""A quaternion shorter than this is none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TriangleMesh:
    """Triangles in the object's own frame.

    The COG is the centre of the axis-aligned bounding box (eq. 1-2) [P], **not** the centroid. The axes W, H,
    D of the object are the x, y, z of the file.

    Attributes:
        name: Name of the object for display.
        vertices: (n, 3) positions [m].
        triangles: (m, 3) vertex indices, outward (right-hand rule) if the file is wound consistently.
        counts: Numbers of vertices, vertex normals, faces and triangles **of the file** (table 2); if
            ``None``, they are counted in the arrays.
        mass: Mass [kg]; ``None`` if unknown.
        scale: Factor from the size of the file, already applied to the vertices; for messages only.
        unit: Unit of the file; for messages only.
        scan: How the object was seen, for a mesh made from a point cloud; otherwise ``None``.
        notes: What was left out of the file or added to it, one sentence each.
        lids: Number of triangles, the last ones, that are not of the file but close its holes: they bound the
            solid, but there is nothing to touch.
        com: (3,) centre of mass [m]; ``None`` if unknown.
        up: Axis of the mesh that is up, one of x, y, z, -x, -y, -z.
        rest: (4,) quaternion wxyz that turns the mesh frame as it lies at rest to a world with z up; ``None``
            if unknown.
        tasks: Tasks that suit the object, the most natural one first; empty if unknown.
        parts: Named parts of the surface, the library's or the sidecar's before the groups of a file.
        rules: Which parts some tasks hold or leave free, in place of what :mod:`preshape.planning.rules` says
            of any mesh.

    Raises:
        ObjectError: The name is empty or no text; an array has the wrong shape, no triangle, a position that
            is not finite, or an index that is out of range; mass or scale is not a positive number; the
            number of lids is none; there is no such axis; or the quaternion of the rest has no length.
    """

    name: str
    vertices: Array
    triangles: IntArray
    counts: tuple[int, int, int, int] | None = None
    mass: float | None = None
    scale: float = 1.0
    unit: str = "m"
    scan: Scan | None = None
    notes: tuple[str, ...] = ()
    lids: int = 0
    com: Array | None = None
    up: str = "z"
    rest: Array | None = None
    tasks: tuple[str, ...] = ()
    parts: tuple[ObjectPart, ...] = ()
    rules: tuple[PartRule, ...] = ()

    def __post_init__(self) -> None:
        _check_name(self.name)
        try:
            vertices = numbers(self.vertices, f"{self.name}: vertices")
            corners = numbers(self.triangles, f"{self.name}: triangles")
        except InputError as error:
            raise ObjectError(str(error)) from error
        if not (np.isfinite(corners) & (corners == corners.round())).all():
            raise ObjectError(f"{self.name}: triangles must be whole numbers")
        triangles = np.clip(corners, -(2.0**53), 2.0**53).astype(np.int64)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise ObjectError(f"{self.name}: vertices must be n×3, got shape {vertices.shape}")
        if triangles.ndim != 2 or triangles.shape[1] != 3:
            raise ObjectError(f"{self.name}: triangles must be m×3, got shape {triangles.shape}")
        if not len(triangles):
            raise ObjectError(f"{self.name}: a mesh needs at least one triangle")
        if not np.isfinite(vertices).all():
            raise ObjectError(f"{self.name}: every vertex must be finite")
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise ObjectError(
                f"{self.name}: triangles must refer to vertices 0 to {len(vertices) - 1}, "
                f"got {triangles.min()} to {triangles.max()}"
            )
        try:
            mass = None if self.mass is None else positive_number(self.mass, f"{self.name}: mass")
            scale = positive_number(self.scale, f"{self.name}: scale")
            lids = whole_number(self.lids, f"{self.name}: the number of lids", 0)
            one_of(self.up, f"{self.name}: up", UP_AXES)
            com = None if self.com is None else frozen_array(self.com, (3,), f"{self.name}: com")
            rest = None if self.rest is None else frozen_array(self.rest, (4,), f"{self.name}: rest")
        except InputError as error:
            raise ObjectError(str(error)) from error
        if lids >= len(triangles):
            raise ObjectError(
                f"{self.name}: {shown(lids)} of {len(triangles)} triangles cannot be lids; mark fewer"
            )
        if rest is not None:
            length = float(np.linalg.norm(rest))
            if length < LEAST_LENGTH:
                raise ObjectError(f"{self.name}: rest must be a quaternion w x y z, got {rest.tolist()}")
            rest = read_only(rest / length)
        freeze(
            self,
            com=com,
            rest=rest,
            mass=mass,
            scale=scale,
            lids=lids,
            vertices=read_only(vertices),
            triangles=read_only(triangles),
        )

    __reduce__ = rebuilt

    def same_as(self, other: TriangleMesh) -> bool:
        """Whether planning cannot tell this mesh from another: same content, point clouds excluded."""
        plain = ("name", "counts", "mass", "scale", "lids", "up")
        return (
            self.scan is None
            and other.scan is None
            and all(getattr(self, name) == getattr(other, name) for name in plain)
            and [part.name for part in self.parts] == [part.name for part in other.parts]
            and all(_same(getattr(self, name), getattr(other, name)) for name in ("com", "rest"))
            and np.array_equal(self.vertices, other.vertices)
            and np.array_equal(self.triangles, other.triangles)
        )

    @cached_property
    def corners(self) -> Array:
        """(m, 3, 3) the corners of each triangle [m]."""
        return read_only(self.vertices[self.triangles])

    @cached_property
    def bounds(self) -> Array:
        """(2, 3) lower and upper corner of the bounding box [m]; vertices without a triangle do not count."""
        flat = self.corners.reshape(-1, 3)
        # One column after another is five times faster than both ends of all rows.
        return read_only(np.array([[column.min() for column in flat.T], [column.max() for column in flat.T]]))

    @cached_property
    def extents(self) -> Array:
        """(3,) W, H, D [m]."""
        return read_only(self.bounds[1] - self.bounds[0])

    @cached_property
    def cog(self) -> Array:
        """(3,) centre of the bounding box [m] (eq. 1-2)."""
        return read_only((self.bounds[0] + self.bounds[1]) / 2)

    @cached_property
    def is_lid(self) -> BoolArray:
        """(m,) whether each triangle is a lid (``lids``)."""
        return read_only(np.arange(len(self.triangles)) >= len(self.triangles) - self.lids)

    @cached_property
    def crosses(self) -> Array:
        """(m, 3) normals with twice the areas as lengths [m²]."""
        a, b, c = (self.corners[:, i] for i in range(3))
        return read_only(np.cross(b - a, c - a))

    @cached_property
    def areas(self) -> Array:
        """(m,) triangle areas [m²]."""
        return read_only(np.linalg.norm(self.crosses, axis=1) / 2)

    @cached_property
    def normals(self) -> Array:
        """(m, 3) unit normals by the right-hand rule; zero for triangles without area."""
        length = 2 * self.areas[:, None]
        zero = np.zeros_like(self.crosses)
        return read_only(np.divide(self.crosses, length, out=zero, where=length > 0))

    @cached_property
    def area(self) -> float:
        """Surface area [m²]."""
        return float(self.areas.sum())

    @cached_property
    def volume(self) -> float:
        """Signed volume [m³], positive if the triangles face outward; cones to the COG close any holes."""
        a = self.corners[:, 0] - self.cog
        return float(np.einsum("ij,ij->i", a, self.crosses).sum() / 6)

    @cached_property
    def attributes(self) -> Attributes:
        """The attributes of the paper's table 2, with area and volume."""
        counts = self.counts
        if counts is None:
            n, m = len(np.unique(self.triangles)), len(self.triangles)
            counts = n, n, m, m
        vertices, normals, faces, triangles = counts
        return Attributes(
            extents=self.extents,
            vertices=vertices,
            vertex_normals=normals,
            faces=faces,
            triangles=triangles,
            area=self.area,
            volume=abs(self.volume),
        )


def _same(one: Array | None, other: Array | None) -> bool:
    """Whether two arrays are equal, or both missing."""
    return one is other or (one is not None and other is not None and np.array_equal(one, other))


def box_mesh(name: str, extents: Array) -> TriangleMesh:
    """A centred box of 12 triangles with outward normals; extents [m]."""
    corner = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return TriangleMesh(name=name, vertices=corner * extents, triangles=np.array(triangles))


def _check_name(name: object) -> None:
    """Refuse a name that the memory could not store after the search.

    Raises:
        ObjectError: The name is empty or too long, or no valid Unicode text.
    """
    try:
        if isinstance(name, str) and name.strip() and len(name) <= LONGEST_NAME:
            name.encode()
            return
    except UnicodeEncodeError:
        pass
    if isinstance(name, str) and len(name) > LONGEST_NAME:
        raise ObjectError(
            f"an object's name must have at most {LONGEST_NAME} characters, got {len(name)}; rename it"
        )
    raise ObjectError(f"an object's name must be text that is not empty, got {name!a:.60}; give or rename it")
