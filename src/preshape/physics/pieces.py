"""Objects for physics: convex pieces, by coacd or from a folder, cached by content.

A cached decomposition is one npz file named by a hash of the mesh and the settings, written whole or not at
all: several processes may work on the same object and folder at once.
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

THRESHOLD = 0.1  # concavity that coacd accepts first
FINER = 0.05  # ... its own default: takes four times as long for three times the pieces
FINE = 0.03  # ... takes ten times as long for five times the pieces
FILLED = 0.15  # share of the pieces' volume that may be outside of the object, by more than
OUTSIDE = 0.005  # ... this share of its largest extent
STANDS_OUT = 0.01  # of that extent may coarse pieces stand out,
BUT_FOR = 0.01  # ... but for this share of their volume
SAMPLES = 4000  # points in the pieces that this is measured with
MOST_TRIANGLES = 10_000
SEED = 0
RESOLUTION = 30  # of coacd's own repair; at its default 50 a small scan takes minutes
SMALLEST = 1e-6  # share of the volume under which a piece is dropped
SUFFIXES = (".obj", ".stl", ".ply", ".off", ".glb", ".gltf")


@value
class ConvexPieces:
    """An object as convex pieces, in its own frame.

    Attributes:
        name: the object's name.
        pieces: (n, 3) corners of each convex piece, at scale 1 [m].
        volumes: volume of each piece at scale 1 [m³].

    Raises:
        ObjectError: no piece has a volume.
    """

    name: str
    pieces: tuple[Array, ...]
    volumes: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        from scipy.spatial import ConvexHull, QhullError

        kept, volumes = [], []
        for index, piece in enumerate(self.pieces):
            points = frozen_array(piece, (None, 3), f"{self.name}: piece {index}")
            try:
                hull = ConvexHull(points)
            except (QhullError, ValueError):  # flat, or fewer than four points
                continue
            kept.append(frozen_array(points[hull.vertices], (None, 3), "hull"))
            volumes.append(float(hull.volume))
        least = SMALLEST * sum(volumes)
        both = [(piece, volume) for piece, volume in zip(kept, volumes, strict=True) if volume > least]
        if not both:
            raise ObjectError(f"{self.name}: the object encloses no volume; physics needs a solid body")
        freeze(self, pieces=tuple(p for p, _ in both), volumes=tuple(v for _, v in both))

    @property
    def volume(self) -> float:
        """Sum of the pieces' volumes [m³]; where pieces overlap that part counts twice."""
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
    """The pieces of an object by its name.

    Args:
        name: the object's name in a grasp array: looked for in ``folder``, then a file or library object.
        folder: may hold ``NAME/convex/*.obj`` (pieces, used as they are), ``NAME/mesh.obj`` or ``NAME.obj``
            (or another mesh format; cut into pieces).

    Raises:
        UnknownObject: nothing of that name.
        ObjectError: a mesh that cannot be used.
        EnvironmentFailure: a file cannot be read.
    """
    from ..objects.load import load_object

    if folder is not None:
        base = Path(folder)
        if not base.is_dir():
            raise EnvironmentFailure(f"no folder {base}; give the one that holds the objects")
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
    """Pieces that were cut before: every mesh in a folder is one, taken as its convex hull.

    Raises:
        ObjectError: no mesh in it, or none with a volume.
    """
    from ..objects.load import load_object

    files = sorted(file for file in Path(folder).iterdir() if file.suffix.lower() in SUFFIXES)
    if not files:
        raise ObjectError(f"{folder}: no convex pieces; expected meshes ({', '.join(SUFFIXES)})")
    return ConvexPieces(name=name, pieces=tuple(load_object(file).vertices for file in files))


def decompose(
    mesh: TriangleMesh, *, threshold: float | None = None, cache: Path | None = None
) -> ConvexPieces:
    """Cut a mesh into convex pieces, or take them from the cache.

    By default it is cut coarsely first, and again finer where the pieces are not the shape that was planned
    for: where they stand out of it, as over the waist of a bottle, or fill much that is outside, as the bowl
    of a spoon or the jaws of a wrench.

    Args:
        mesh: need not be watertight.
        threshold: concavity accepted, 0.01 (fine) to 1 (one hull), whatever is filled.
        cache: folder; default :func:`preshape.files.cache_folder`. It may be unusable: then nothing is kept.

    Raises:
        ObjectError: the mesh encloses no volume, or coacd is not able to cut it.
        EnvironmentFailure: coacd is not installed.
    """
    folder = (cache or cache_folder()) / "convex"
    rules = (THRESHOLD, FINER, FINE, FILLED, OUTSIDE, STANDS_OUT, BUT_FOR)
    rule = f"{threshold!r}" if threshold is not None else " ".join(map(repr, rules))
    file = folder / f"{_key(mesh, rule)}.npz"
    kept = _read(file)
    if kept is None:
        kept = _fitting(mesh, cache) if threshold is None else _cut(mesh, threshold)
        keep_arrays(file, corners=np.concatenate(kept), ends=np.cumsum([len(p) for p in kept]))
    return ConvexPieces(name=mesh.name, pieces=kept)


def _fitting(mesh: TriangleMesh, cache: Path | None) -> tuple[Array, ...]:
    """Coarse pieces, or finer ones where those are not the mesh."""
    coarse = decompose(mesh, threshold=THRESHOLD, cache=cache)
    distance, volume = _distances(mesh, coarse)
    if volume[distance > OUTSIDE].sum() > FILLED:
        return _cut(mesh, FINE)
    return coarse.pieces if volume[distance > STANDS_OUT].sum() <= BUT_FOR else _cut(mesh, FINER)


def filled_share(mesh: TriangleMesh, pieces: ConvexPieces) -> float:
    """Share of the pieces' volume that is outside of the mesh, by more than ``OUTSIDE`` of its extent.

    Args:
        mesh: need not be watertight.
        pieces: of the mesh, at scale 1.
    """
    distance, weight = _distances(mesh, pieces)
    return float(weight[distance > OUTSIDE].sum())


def _distances(mesh: TriangleMesh, pieces: ConvexPieces) -> tuple[Array, Array]:
    """(n,), (n,) signed distance of points in the pieces, in extents of the mesh; their shares."""
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
    """The mesh with equal positions joined and every hole closed by a fan to the middle of its rim.

    A scan's seams vanish and its holes get lids; coacd would take an open surface for a thin shell.

    Args:
        vertices: (n, 3).
        triangles: (m, 3).
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
    """Fewer triangles: vertices in one cell of a grid become their mean; the grid grows until it suffices.

    Args:
        vertices: (n, 3).
        triangles: (m, 3).
        most: triangles wanted at most.
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
    # A piece of another version of coacd is another piece; without coacd what is cached still serves.
    state = hashlib.sha256(f"convex 2 {rule} {SEED} {MOST_TRIANGLES}".encode())
    for array in (mesh.vertices, mesh.triangles):
        state.update(np.ascontiguousarray(array).tobytes())
    return state.hexdigest()[:40]


def _cut(mesh: TriangleMesh, threshold: float) -> tuple[Array, ...]:
    try:
        import coacd
    except ImportError as error:
        raise EnvironmentFailure(
            f"{mesh.name}: cutting an object into convex pieces needs the package coacd; install it"
        ) from error
    vertices, triangles = closed(*simplified(*closed(mesh.vertices, mesh.triangles)))
    # Where half the extent is the unit, coacd's inner tolerances mean the same for a coin and a chair.
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
    """The cached pieces; ``None`` where there are none, or the file is damaged."""
    try:
        stored = read_arrays(file)
        ends = stored["ends"].astype(np.int64)
        return tuple(np.split(stored["corners"].astype(np.float64), ends[:-1]))
    except (OSError, ValueError, KeyError, IndexError):
        return None
