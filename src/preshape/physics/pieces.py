"""Objects for physics: convex pieces, cut by coacd or read from a folder, and cached.

A cached decomposition is one npz file, named by a hash of the mesh and the settings. It is written
atomically, so several processes may work on the same object at once.
"""

from __future__ import annotations

import hashlib
import math
from importlib.metadata import version
from pathlib import Path

import numpy as np

from ..exceptions import EnvironmentFailure, ObjectError, UnknownObject
from ..files import cache_folder, keep_arrays, read_arrays
from ..objects.mesh import TriangleMesh
from ..types import Array, IntArray, freeze, frozen_array, value

COARSE, FINER, FINE = 0.1, 0.05, 0.03
"""Concavity that coacd accepts. ``FINER``, its default, takes four times as long as ``COARSE`` and gives
three times as many pieces; ``FINE`` takes ten times as long and gives five times as many."""
FILLED, OUTSIDE = 0.15, 0.005
"""Coarse pieces are replaced by fine ones if more than the share ``FILLED`` of their volume lies farther
outside the object than the share ``OUTSIDE`` of its largest extent."""
STANDS_OUT, BUT_FOR = 0.01, 0.01
"""Coarse pieces are replaced by finer ones if more than the share ``BUT_FOR`` of their volume lies farther
outside the object than the share ``STANDS_OUT`` of its largest extent."""
SAMPLES = 4000
"""Number of points in the pieces at which these shares are measured."""
MOST_TRIANGLES = 10_000
"""Number of triangles that a mesh is simplified to before it is cut."""
SEED = 0
RESOLUTION = 30
"""Resolution of coacd's own repair; at its default of 50 a small scan takes minutes."""
SMALLEST = 1e-6
"""Share of the whole volume below which a piece is dropped."""
SUFFIXES = (".obj", ".stl", ".ply", ".off", ".glb", ".gltf")
"""Suffixes of the meshes in a folder of objects."""


@value
class ConvexPieces:
    """An object as convex pieces, in its own frame.

    Attributes:
        name: Name of the object.
        pieces: (n, 3) corners of each convex piece at scale 1 [m].
        volumes: Volume of each piece at scale 1 [m³].

    Raises:
        ObjectError: No piece has a volume.
    """

    name: str
    pieces: tuple[Array, ...]
    volumes: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        from scipy.spatial import ConvexHull, QhullError

        hulls: list[tuple[Array, float]] = []
        for index, piece in enumerate(self.pieces):
            points = frozen_array(piece, (None, 3), f"{self.name}: piece {index}")
            try:
                hull = ConvexHull(points)
            except (QhullError, ValueError):  # flat, or fewer than four points
                continue
            hulls.append((frozen_array(points[hull.vertices], (None, 3), "hull"), float(hull.volume)))
        least = SMALLEST * sum(volume for _, volume in hulls)
        solid = [(corners, volume) for corners, volume in hulls if volume > least]
        if not solid:
            raise ObjectError(f"{self.name}: the object encloses no volume; physics needs a solid body")
        freeze(self, pieces=tuple(p for p, _ in solid), volumes=tuple(v for _, v in solid))

    @property
    def volume(self) -> float:
        """Sum of the volumes of the pieces [m³]; where two pieces overlap, that part counts twice."""
        return float(sum(self.volumes))

    @property
    def bounds(self) -> Array:
        """(2, 3) corners of the bounding box at scale 1 [m]."""
        points = np.concatenate(self.pieces)
        return np.array([points.min(axis=0), points.max(axis=0)])

    @property
    def digest(self) -> str:
        """Hash of the pieces."""
        return hashlib.sha256(b"".join(piece.tobytes() for piece in self.pieces)).hexdigest()


def load_pieces(name: str, folder: str | Path | None = None) -> ConvexPieces:
    """The convex pieces of an object.

    Args:
        name: Name of the object in a grasp array; searched in ``folder``, then as a library object or file.
        folder: Folder that may hold ``NAME/convex/*.obj`` (pieces, used as they are), ``NAME/mesh.obj`` or
            ``NAME.obj`` (or another mesh format; cut into pieces).

    Raises:
        UnknownObject: There is no object of that name.
        ObjectError: The mesh cannot be used.
        EnvironmentFailure: A file cannot be read.
    """
    from ..objects.load import load_object

    if folder is not None:
        base = Path(folder)
        if not base.is_dir():
            raise EnvironmentFailure(f"no folder {base}; give the folder that holds the objects")
        if not Path(name).is_absolute() and ".." not in Path(name).parts:
            if (base / name / "convex").is_dir():
                return pieces_from_folder(base / name / "convex", name)
            for candidate in [base / name / f"mesh{s}" for s in SUFFIXES] + [
                base / f"{name}{s}" for s in SUFFIXES
            ]:
                if candidate.is_file():
                    return decompose(load_object(candidate))
    try:
        return decompose(load_object(name))
    except UnknownObject:
        if folder is None:
            raise
        raise UnknownObject(name, sorted(entry.stem for entry in Path(folder).iterdir())) from None


def pieces_from_folder(folder: str | Path, name: str) -> ConvexPieces:
    """Read pieces that were cut before: the convex hull of each mesh in a folder is one piece.

    Raises:
        ObjectError: The folder holds no mesh, or none with a volume.
    """
    from ..objects.load import load_object

    files = sorted(file for file in Path(folder).iterdir() if file.suffix.lower() in SUFFIXES)
    if not files:
        raise ObjectError(f"{folder}: no convex pieces; expected meshes ({', '.join(SUFFIXES)})")
    return ConvexPieces(name=name, pieces=tuple(load_object(file).vertices for file in files))


def decompose(
    mesh: TriangleMesh, *, threshold: float | None = None, cache: Path | None = None
) -> ConvexPieces:
    """Cut a mesh into convex pieces, or read them from the cache.

    By default the mesh is cut coarsely first. It is cut again, more finely, if the pieces differ from the
    mesh that was used in planning: if they protrude from it, as over the waist of a bottle, or fill much
    space outside it, as the bowl of a spoon or the jaws of a wrench.

    Args:
        mesh: The mesh; it need not be watertight.
        threshold: Accepted concavity, 0.01 (fine) to 1 (one hull); with ``None``, chosen as described above.
        cache: Folder of the cache; by default :func:`preshape.files.cache_folder`. If it is not usable,
            nothing is cached.

    Raises:
        ObjectError: The mesh encloses no volume, or coacd cannot cut it.
        EnvironmentFailure: coacd is not installed.
    """
    folder = (cache or cache_folder()) / "convex"
    rules = (COARSE, FINER, FINE, FILLED, OUTSIDE, STANDS_OUT, BUT_FOR)
    rule = f"{threshold!r}" if threshold is not None else " ".join(map(repr, rules))
    file = folder / f"{_key(mesh, rule)}.npz"
    pieces = _read(file)
    if pieces is None:
        pieces = _cut_to_fit(mesh, cache) if threshold is None else _cut(mesh, threshold)
        keep_arrays(file, corners=np.concatenate(pieces), ends=np.cumsum([len(p) for p in pieces]))
    return ConvexPieces(name=mesh.name, pieces=pieces)


def _cut_to_fit(mesh: TriangleMesh, cache: Path | None) -> tuple[Array, ...]:
    """Coarse pieces, or finer ones if the coarse ones differ from the mesh."""
    coarse = decompose(mesh, threshold=COARSE, cache=cache)
    distance, volume = _distances(mesh, coarse)
    if volume[distance > OUTSIDE].sum() > FILLED:
        return _cut(mesh, FINE)
    return coarse.pieces if volume[distance > STANDS_OUT].sum() <= BUT_FOR else _cut(mesh, FINER)


def filled_share(mesh: TriangleMesh, pieces: ConvexPieces) -> float:
    """Share of the pieces' volume that lies outside the mesh by more than ``OUTSIDE`` of its largest extent.

    Args:
        mesh: The mesh; it need not be watertight.
        pieces: Pieces of the mesh at scale 1.
    """
    distance, share = _distances(mesh, pieces)
    return float(share[distance > OUTSIDE].sum())


def _distances(mesh: TriangleMesh, pieces: ConvexPieces) -> tuple[Array, Array]:
    """(n,) signed distances of points in the pieces from the mesh, in largest extents; (n,) volume shares."""
    from ..kernels.field.host import SurfaceQuery

    rng = np.random.default_rng(SEED)
    shares = np.array(pieces.volumes) / pieces.volume
    points = [
        _inside(corners, max(10, math.ceil(SAMPLES * share)), rng)
        for corners, share in zip(pieces.pieces, shares, strict=True)
    ]
    weights = [np.full(len(own), share / len(own)) for own, share in zip(points, shares, strict=True)]
    distance = SurfaceQuery(mesh).closest(np.concatenate(points)).distance / float(mesh.extents.max())
    return distance, np.concatenate(weights)


def _inside(corners: Array, count: int, rng: np.random.Generator) -> Array:
    """(count, 3) points spread evenly in a convex piece."""
    from scipy.spatial import ConvexHull

    faces = corners[ConvexHull(corners).simplices]
    solids = np.concatenate([np.broadcast_to(corners.mean(axis=0), (len(faces), 1, 3)), faces], axis=1)
    volumes = np.abs(np.linalg.det(solids[:, 1:] - solids[:, :1]))
    which = rng.choice(len(solids), count, p=volumes / volumes.sum())
    return np.asarray(np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(4), count), solids[which]))


def closed(vertices: Array, triangles: IntArray) -> tuple[Array, IntArray]:
    """The mesh with equal positions joined, and each hole closed by a fan to the centre of its rim.

    Without this, coacd would take an open surface for a thin shell.

    Args:
        vertices: (n, 3) positions.
        triangles: (m, 3) vertex indices.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    points, label = np.unique(vertices, axis=0, return_inverse=True)
    faces = label.ravel()[triangles]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = len(points)
    there, back = edges @ [count, 1], edges @ [1, count]
    rim = edges[~np.isin(back, there)]
    if len(rim) == 0:
        return points, faces
    graph = coo_array((np.ones(len(rim)), (rim[:, 0], rim[:, 1])), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    on, hole = np.unique(part[rim[:, 0]], return_inverse=True)
    middles = np.array([points[np.unique(rim[hole == k])].mean(axis=0) for k in range(len(on))])
    lids = np.stack([rim[:, 1], rim[:, 0], count + hole], axis=1)
    return np.concatenate([points, middles]), np.concatenate([faces, lids])


def simplified(vertices: Array, triangles: IntArray, most: int = MOST_TRIANGLES) -> tuple[Array, IntArray]:
    """The mesh with fewer triangles: the vertices in each cell of a grid become their mean.

    The cells grow until few enough triangles are left.

    Args:
        vertices: (n, 3) positions.
        triangles: (m, 3) vertex indices.
        most: Largest number of triangles.
    """
    low, extent = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
    cells = 256.0
    while len(triangles) > most and cells > 4:
        grid = np.floor((vertices - low) / (extent / cells)).astype(np.int64)
        _, label, count = np.unique(grid, axis=0, return_inverse=True, return_counts=True)
        label = label.ravel()
        means = (
            np.stack([np.bincount(label, weights=column) for column in vertices.T], axis=1) / count[:, None]
        )
        merged = label[triangles]
        alive = (
            (merged[:, 0] != merged[:, 1]) & (merged[:, 1] != merged[:, 2]) & (merged[:, 2] != merged[:, 0])
        )
        if alive.sum() <= most:
            return means, merged[alive]
        cells *= 0.8
    return vertices, triangles


def _key(mesh: TriangleMesh, rule: str) -> str:
    # The version of coacd is left out, so that cached pieces can be used where coacd is not installed.
    state = hashlib.sha256(f"convex 2 {rule} {SEED} {MOST_TRIANGLES}".encode())
    for array in (mesh.vertices, mesh.triangles):
        state.update(np.ascontiguousarray(array).tobytes())
    return state.hexdigest()[:40]


def _cut(mesh: TriangleMesh, threshold: float) -> tuple[Array, ...]:
    try:
        import coacd
    except ImportError as error:
        raise EnvironmentFailure(
            f"{mesh.name}: cutting an object into convex pieces needs the package coacd: pip install coacd"
        ) from error
    vertices, triangles = closed(*simplified(*closed(mesh.vertices, mesh.triangles)))
    # With half the extent as unit, coacd's tolerances mean the same for a coin and a chair.
    unit = float(np.ptp(vertices, axis=0).max()) / 2
    if unit <= 0:
        raise ObjectError(f"{mesh.name}: the object has no size")
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    coacd.set_log_level("error")
    try:
        solid = coacd.Mesh((vertices - middle) / unit, triangles)
        parts = coacd.run_coacd(solid, threshold=threshold, preprocess_resolution=RESOLUTION, seed=SEED)
    except Exception as error:
        raise ObjectError(
            f"{mesh.name}: coacd {version('coacd')} cannot cut it into convex pieces: {error}"
        ) from error
    return tuple(np.asarray(corners, dtype=np.float64) * unit + middle for corners, _ in parts)


def _read(file: Path) -> tuple[Array, ...] | None:
    """Cached pieces; ``None`` if the file is missing or damaged."""
    try:
        stored = read_arrays(file)
        ends = stored["ends"].astype(np.int64)
        return tuple(np.split(stored["corners"].astype(np.float64), ends[:-1]))
    except (OSError, ValueError, KeyError, IndexError):
        return None
