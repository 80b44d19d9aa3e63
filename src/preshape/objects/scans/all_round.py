"""A closed surface from points on all sides of an object: outward normals, and Poisson's equation on a grid.

Normals are those of planes fitted to neighbours, oriented consistently along a tree of nearest neighbours
(Hoppe et al. 1992, Surface reconstruction from unorganized points). A Fourier transform gives the function
whose gradient matches the normals (Kazhdan 2005, Reconstruction of solid models from oriented point sets).
Gaps are closed smoothly.
"""

from __future__ import annotations

import numpy as np

from ...types import Array, IntArray
from .cleaning import nearest
from .surface import Grid

NEIGHBOURS = 14
"""Number of points that a plane is fitted to [C]."""
BLUR = 1.2
"""Standard deviation of the blur of the normals on the grid, in cells [C]."""


def outward_normals(points: Array) -> Array:
    """(n, 3) outward unit normals of points from all sides of an object.

    Args:
        points: (n, 3) cleaned points [m].
    """
    _, near = nearest(points, min(NEIGHBOURS, len(points)))
    spread = points[near] - points[near].mean(axis=1, keepdims=True)
    normals = np.linalg.svd(spread, full_matrices=False)[2][:, 2]
    signs = _consistent_signs(points, normals, near)
    oriented: Array = normals * signs[:, None]
    # By the divergence theorem the flux of outward normals of a closed surface is positive.
    flux = float(np.einsum("ij,ij->", oriented, points - points.mean(axis=0)))
    return oriented if flux >= 0 else -oriented


def _consistent_signs(points: Array, normals: Array, near: IntArray) -> Array:
    """(n,) factors ±1 that make the normals of neighbours agree, along a tree from the farthest point."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

    count = len(points)
    rows = np.repeat(np.arange(count), near.shape[1] - 1)
    columns = near[:, 1:].ravel()
    cosine = np.abs(np.einsum("ij,ij->i", normals[rows], normals[columns]))
    # The tree prefers flat regions; the small constant keeps edges of weight zero.
    graph = coo_array((1.0 - cosine + 1e-3, (rows, columns)), shape=(count, count)).tocsr()
    tree = minimum_spanning_tree(graph)
    total, part = connected_components(tree, directed=False)
    signs = np.ones(count)
    middle = points.mean(axis=0)
    for k in range(total):
        own = np.flatnonzero(part == k)
        start = own[int(np.linalg.norm(points[own] - middle, axis=1).argmax())]
        order, before = breadth_first_order(tree, int(start), directed=False)
        signs[start] = 1.0 if normals[start] @ (points[start] - middle) >= 0 else -1.0
        for place in order[1:]:
            parent = before[place]
            signs[place] = signs[parent] * (1.0 if normals[parent] @ normals[place] >= 0 else -1.0)
    return signs


def poisson(points: Array, normals: Array, grid: Grid) -> Array:
    """A function on the nodes of a grid, negative inside and on average zero at the points [cells].

    Args:
        points: (n, 3) points inside the grid [m].
        normals: (n, 3) outward unit normals.
        grid: Grid with margins on all sides, because the transform treats it as periodic.
    """
    from scipy.fft import irfftn, rfftn
    from scipy.ndimage import map_coordinates

    place = (points - grid.origin) / grid.spacing
    weight = _areas(points) / grid.spacing**2
    field = [_splat(place, -weight * normals[:, axis], grid.shape) for axis in range(3)]
    waves = np.meshgrid(
        *(2 * np.pi * np.fft.fftfreq(n) for n in grid.shape[:2]),
        2 * np.pi * np.fft.rfftfreq(grid.shape[2]),
        indexing="ij",
    )
    square = sum(wave**2 for wave in waves)
    blur = np.exp(-0.5 * BLUR**2 * square)
    total = sum(1j * wave * rfftn(part) for wave, part in zip(waves, field, strict=True)) * blur
    square[0, 0, 0] = 1.0
    spectrum = -total / square
    spectrum[0, 0, 0] = 0.0
    # The gradient of this function is the inward normals, so it is 1 inside and 0 outside up to a constant.
    inside = irfftn(spectrum, s=grid.shape)
    level = float(np.median(map_coordinates(inside, place.T, order=1, mode="nearest")))
    slope = 1.0 / (np.sqrt(2 * np.pi) * BLUR)
    values: Array = (level - inside) / slope
    return values


def _areas(points: Array) -> Array:
    """(n,) area of each point [m²]: the disc up to its sixth neighbour, shared among its points."""
    distance, _ = nearest(points, 7)
    found: Array = np.pi * distance[:, 6] ** 2 / 6.5
    return found


def _splat(place: Array, weight: Array, shape: tuple[int, int, int]) -> Array:
    """(shape) weights of points at places [cells], each shared by the eight nodes around it."""
    low = np.floor(place).astype(np.int64)
    part = place - low
    total = np.zeros(shape)
    for corner in np.ndindex(2, 2, 2):
        share = np.prod(np.where(corner, part, 1 - part), axis=1)
        where = np.clip(low + corner, 0, np.array(shape) - 1)
        np.add.at(total, tuple(where.T), share * weight)
    return total
