"""A depth camera's scene: the object by a mask, the table below it, and the rest, which is in the way."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...exceptions import EnvironmentFailure, InputError, ObjectError, shown
from ...files import MOST_OF_MESH, array_in, arrays_in, read_file
from ...types import Array, BoolArray, freeze, frozen_array, value
from .cleaning import LEAST
from .scan import RawCloud
from .table import DRAWS, SAMPLED, find_table, fitted, random_planes

ROUND = 0.4
"""Distance from the object within which points decide about the table [m] [C]."""
NEAR = 0.008
"""Largest distance of the table's points from a random plane [m] [C]."""
SUPPORT, LEVEL_SUPPORT = 0.1, 0.03
"""Least share of the points around the object on its table, and where up is known [C]."""
ON_SIDE = 0.97
"""Least share of the object's points above its table [C]."""
TOUCHING, HIDDEN = 0.03, 0.15
"""Largest height above the table of an object's lowest seen points [m] [C]. Where up is known, a wall is told
from a table, and the second number lets the lower part be hidden."""
FITTED = 40
"""Number of random planes that are fitted to their points, the best first, until one is a table [C]."""
LEVEL = float(np.cos(np.radians(20.0)))
"""Least cosine between up, where it is known, and the table's normal [C]."""
BESIDE = 0.004
"""Points nearer to the object than this belong to neither: masks are not exact [m] [C]."""
MOST_LABEL = 2**31
"""Labels of scenes are below this."""
_KEYS = {
    "depth": ("depth", "depth_map", "depth_image"),
    "points": ("points", "xyz", "pc"),
    "K": ("K", "intrinsics", "camera_matrix", "intrinsic_matrix"),
    "T": ("T_world_camera", "camera_pose"),
    "labels": ("labels", "segmap", "segmentation", "mask"),
}
"""Names of the arrays of an NPZ file, the first the one that this project writes."""


@value
class SceneParts:
    """A scene, taken apart.

    Attributes:
        points: (n, 3) points of the object [m].
        rest: (m, 3) points of what is in the way [m].
        table: (4,) unit normal, towards the object, and offset d of the plane n·x = d [m], or ``None``.
    """

    points: Array
    rest: Array
    table: Array | None

    def __post_init__(self) -> None:
        freeze(self, points=frozen_array(self.points, (None, 3), "points of the object"))
        freeze(self, rest=frozen_array(self.rest, (None, 3), "points of the scene"))


def read_npz(name: str, data: bytes) -> RawCloud:
    """Read an NPZ file with a depth image (h, w) and its camera matrix ``K`` (3, 3), or with points (…, 3).

    ``T_world_camera`` (4, 4), in metres whatever the unit of the depth, is the pose of the camera's frame (z
    forward, x right, y down) in a world with z up; ``labels``, of the size of the image or of the points,
    number what each shows. A depth of zero, or one that is not finite, is no echo.

    Raises:
        ObjectError: The file is no NPZ file of numbers, or an array is missing or has the wrong shape.
    """
    try:
        arrays = arrays_in(data)
    except ValueError as error:
        raise ObjectError(f"{name}: expected an NPZ file of arrays, it holds none ({error!s:.80})") from error
    found = {what: next((arrays[key] for key in keys if key in arrays), None) for what, keys in _KEYS.items()}
    for what, array in found.items():
        if array is not None and (not isinstance(array, np.ndarray) or array.dtype.kind not in "fiub"):
            raise ObjectError(f"{name}: {what} must be numbers, this file holds other data")
    points = _points_of(name, found, list(arrays))
    camera = np.zeros(3) if found["depth"] is not None or found["T"] is not None else None
    T = None if found["T"] is None else np.asarray(found["T"], dtype=np.float64)
    if T is not None and (
        T.shape != (4, 4) or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3)
    ):
        raise ObjectError(f"{name}: {_KEYS['T'][0]} must be a pose, a 4 × 4 matrix with a rotation")
    labels = found["labels"]
    if labels is not None and labels.size != len(points):
        raise ObjectError(f"{name}: labels are for {labels.size} pixels, the scene has {len(points)}")
    if labels is not None and not (np.abs(labels.astype(np.float64)) < MOST_LABEL).all():
        raise ObjectError(f"{name}: labels must be whole numbers below {MOST_LABEL:g}")
    numbers = None if labels is None else labels.reshape(-1).astype(np.int64)
    return RawCloud(points=points, camera=camera, labels=numbers, T=T)


def _points_of(name: str, found: Mapping[str, Any], keys: list[str]) -> Array:
    """(n, 3) points in the camera's frame; pixels without an echo are rows of NaN."""
    if (points := found["points"]) is not None:
        if points.ndim not in (2, 3) or points.shape[-1] != 3:
            raise ObjectError(f"{name}: points must be an array n × 3, got {_shape(points)}")
        return np.asarray(points.reshape(-1, 3), dtype=np.float64)
    depth, K = found["depth"], found["K"]
    if depth is None or K is None:
        raise ObjectError(
            f"{name}: expected depth (h × w) and K (3 × 3), or points (n × 3); the file has "
            f"{', '.join(map(shown, keys[:8])) or 'no array'}"
        )
    depth = depth[..., 0] if depth.ndim == 3 and depth.shape[-1] == 1 else depth
    if depth.ndim != 2 or K.shape != (3, 3):
        raise ObjectError(f"{name}: depth must be h × w and K 3 × 3, got {_shape(depth)} and {_shape(K)}")
    z = depth.astype(np.float64)
    z[~np.isfinite(z) | (z <= 0.0)] = np.nan
    fx, fy, cx, cy = (float(K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    if not (np.isfinite([fx, fy, cx, cy]).all() and fx > 0 and fy > 0):
        raise ObjectError(f"{name}: K must have positive focal lengths in pixels, got {fx:g} and {fy:g}")
    rows, columns = np.indices(z.shape)
    with np.errstate(over="ignore"):
        points = np.stack([(columns - cx) * z / fx, (rows - cy) * z / fy, z], axis=-1).reshape(-1, 3)
    points[~np.isfinite(points).all(axis=1)] = np.nan
    return points


def _shape(array: Array) -> str:
    return " × ".join(map(str, array.shape)) or "one number"


def object_mask(name: str, cloud: RawCloud, mask: str) -> BoolArray:
    """(n,) which points of a cloud are the object's.

    Args:
        name: Name of the scene's file, for messages.
        cloud: The scene.
        mask: The number of a label in the scene's file, or a file (.npy or .png) with a number for each point
            or pixel; what is not zero is the object.

    Raises:
        InputError: The scene has no labels, or none of this number.
        ObjectError: The file is no mask, or one of another size.
        EnvironmentFailure: The file cannot be read.
    """
    if mask.strip().removeprefix("-").isdecimal():
        if cloud.labels is None:
            raise InputError(f"{name} has no labels, so the mask must be a file (.npy or .png), got {mask}")
        chosen = cloud.labels == int(mask)
        if not chosen.any():
            some = ", ".join(map(str, np.unique(cloud.labels)[:20].tolist()))
            raise InputError(f"{name}: nothing has the label {mask}; there are {some}")
        return np.asarray(chosen)
    entries = _mask_file(Path(mask))
    if entries.size != len(cloud.points):
        raise ObjectError(
            f"{mask}: a mask has a number for each of the scene's points or pixels, {len(cloud.points)}, and "
            f"this one has {_shape(entries)}"
        )
    return np.asarray(entries.reshape(-1) != 0)


def _mask_file(path: Path) -> Array:
    try:
        data = read_file(path, MOST_OF_MESH, "mask", refusal=ObjectError)
    except (FileNotFoundError, NotADirectoryError, ValueError) as error:
        raise ObjectError(
            f"{shown(str(path))}: there is no such mask; give a .npy or .png file, or the number of a label"
        ) from error
    except OSError as error:
        raise EnvironmentFailure(f"{path}: cannot be read ({error.strerror})") from error
    try:
        if data.startswith(b"\x89PNG"):
            from PIL import Image

            with Image.open(io.BytesIO(data)) as image:
                return np.asarray(image.convert("L") if image.mode not in ("1", "L", "I", "I;16") else image)
        array = array_in(data)
    except Exception as error:
        raise ObjectError(f"{path}: a mask is a .npy or .png file of numbers ({error!s:.80})") from error
    if array.dtype.kind not in "fiub":
        raise ObjectError(f"{path}: a mask is an array of numbers, this file holds other data")
    return array


def scene_parts(name: str, cloud: RawCloud, chosen: BoolArray) -> SceneParts:
    """Take a scene apart into the object, its table and what is in the way.

    1. Find the table: a plane through points around the object, which has the object and the camera on one
          side (:func:`support`).
    2. Leave out what lies on the table, or below it; the object's points on it are the mask's errors.
    3. Leave out of the rest what is nearer to the object than ``BESIDE``.

    Args:
        name: Name of the scene's file, for messages.
        cloud: The scene, in metres.
        chosen: (n,) which points are the object's.

    Raises:
        ObjectError: The mask leaves too few points, or takes in the table.
    """
    from scipy.spatial import KDTree

    echo = np.isfinite(cloud.points).all(axis=1) & cloud.points.any(axis=1)
    points, rest = cloud.points[chosen & echo], cloud.points[~chosen & echo]
    if len(points) < LEAST:
        raise ObjectError(
            f"{name}: the mask leaves {len(points)} points of the object, and {LEAST} are needed"
        )
    if (within := find_table(points)) is not None:
        raise ObjectError(
            f"{name}: {100 * within.share:.0f} % of the mask's points lie on one plane that the others stand "
            "on: the mask takes in the table; correct it"
        )
    table, noise = None, 0.0
    if len(rest) >= LEAST:  # 1.
        up = None if cloud.T is None else np.array([0.0, 0.0, 1.0])
        table, noise = support(points, rest, cloud.camera, up)
    if table is not None:  # 2.
        rest = rest[rest @ table[:3] - table[3] > noise]
        standing = points[points @ table[:3] - table[3] > noise]
        points = standing if len(standing) >= LEAST else points
    if len(rest):  # 3.
        rest = rest[KDTree(points).query(rest, distance_upper_bound=BESIDE)[0] > BESIDE]
    return SceneParts(points=points, rest=rest, table=table)


def support(
    points: Array, rest: Array, camera: Array | None, up: Array | None = None, seed: int = 0
) -> tuple[Array | None, float]:
    """The plane on which an object stands, and the noise of its points [m]; ``None`` if there is none.

    The object is near the plane, so a wall behind it is none.

    Args:
        points: (n, 3) points of the object [m].
        rest: (m, 3) other points of the scene [m].
        camera: (3,) position of the camera [m], or ``None``.
        up: (3,) direction that is up, of which the plane's normal is within ``LEVEL``; ``None`` if unknown.
        seed: Seed of the draws.
    """
    low, high = points.min(axis=0) - ROUND, points.max(axis=0) + ROUND
    around = rest[((rest > low) & (rest < high)).all(axis=1)]
    if len(around) < LEAST:
        return None, 0.0
    rng = np.random.default_rng(seed)
    sample, own = (each[rng.permutation(len(each))[:SAMPLED]] for each in (around, points))
    middles, normals = random_planes(sample, DRAWS, rng)
    if up is not None:  # level planes through single points find a small table beside a large wall
        middles = np.concatenate([middles, sample[:DRAWS]])
        normals = np.concatenate([normals, np.tile(up, (len(middles) - len(normals), 1))])
    offsets = np.einsum("ij,ij->i", normals, middles)
    signs = np.where(np.median(own @ normals.T - offsets, axis=0) < 0, -1.0, 1.0)
    normals, offsets = normals * signs[:, None], offsets * signs
    heights = own @ normals.T - offsets
    above = (heights > -NEAR).mean(axis=0) >= ON_SIDE
    above &= np.percentile(heights, 100 * (1 - ON_SIDE), axis=0) < (TOUCHING if up is None else HIDDEN)
    if up is not None:
        above &= normals @ up > LEVEL
    if camera is not None:
        above &= camera @ normals.T - offsets > 0
    shares = (np.abs(sample @ normals.T - offsets) < NEAR).mean(axis=0) * above
    for best in np.argsort(-shares, kind="stable")[:FITTED]:
        if shares[best] < (SUPPORT if up is None else LEVEL_SUPPORT):
            break
        middle, axes, noise = fitted(around, middles[best], normals[best], NEAR)
        normal = axes[-1] * np.sign(axes[-1] @ normals[best])
        if up is None:
            return np.append(normal, middle @ normal), noise
        if normal @ up > LEVEL:
            # Points of a wall on the table tilt the fit: the plane that more points lie on counts.
            level = np.median((on := around[np.abs((around - middle) @ normal) < noise]) @ up)
            fits = np.abs(on @ normal - middle @ normal), np.abs(on @ up - level)
            tilted, flat = (int((apart < NEAR / 4).sum()) for apart in fits)
            return (np.append(up, level) if flat >= tilted else np.append(normal, middle @ normal)), noise
    return None, 0.0
