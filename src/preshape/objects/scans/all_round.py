"""A closed surface round points from all sides: normals turned outward, then Poisson's equation on a grid.

Normals are those of planes through neighbours, turned alike along a tree of nearest neighbours (Hoppe et al.
1992, Surface reconstruction from unorganized points). The function whose gradient they are comes from a
Fourier transform (Kazhdan 2005, Reconstruction of solid models from oriented point sets); gaps are closed by
the smoothest surface.
"""

from __future__ import annotations

import numpy as np

from ...types import Array, IntArray
from .cleaning import nearest
from .surface import Grid

NEIGHBOURS = 14
BLUR = 1.2
"""Standard deviation to which normals are blurred on the grid, in cells [C]."""


def outward_normals(points: Array) -> Array:
    """(n, 3) unit normals of points from all sides of a thing, outward.

    Args:
        points: (n, 3) cleaned [m].
    """
    _, near = nearest(points, min(NEIGHBOURS, len(points)))
    spread = points[near] - points[near].mean(axis=1, keepdims=True)
    normals = np.linalg.svd(spread, full_matrices=False)[2][:, 2]
    signs = _alike(points, normals, near)
    turned: Array = normals * signs[:, None]
    # The divergence theorem: outward normals of a closed surface have the volume's positive flux.
    flux = float(np.einsum("ij,ij->", turned, points - points.mean(axis=0)))
    return turned if flux >= 0 else -turned


def _alike(points: Array, normals: Array, near: IntArray) -> Array:
    """(n,) signs with which neighbours' normals agree, spread from the farthest point along a tree."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

    count = len(points)
    rows = np.repeat(np.arange(count), near.shape[1] - 1)
    columns = near[:, 1:].ravel()
    cosine = np.abs(np.einsum("ij,ij->i", normals[rows], normals[columns]))
    # Flat ways first; the small part keeps equal points linked.
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
    """Function on a grid's nodes, negative inside and zero where the points are, on average [cells].

    Args:
        points: (n, 3) [m], within the grid.
        normals: (n, 3) outward.
        grid: with some cells to spare: the transform takes it as repeated.
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
    # Its gradient is the inward normals: 1 inside, 0 outside, up to a constant.
    inside = irfftn(spectrum, s=grid.shape)
    level = float(np.median(map_coordinates(inside, place.T, order=1, mode="nearest")))
    slope = 1.0 / (np.sqrt(2 * np.pi) * BLUR)
    values: Array = (level - inside) / slope
    return values


def _areas(points: Array) -> Array:
    """(n,) area that each point stands for [m²]: of the disc to its sixth neighbour, shared by six."""
    distance, _ = nearest(points, 7)
    found: Array = np.pi * distance[:, 6] ** 2 / 6.5
    return found


def _splat(place: Array, weight: Array, shape: tuple[int, int, int]) -> Array:
    """Weights shared among the eight nodes round each place."""
    low = np.floor(place).astype(np.int64)
    part = place - low
    total = np.zeros(shape)
    for corner in np.ndindex(2, 2, 2):
        share = np.prod(np.where(corner, part, 1 - part), axis=1)
        where = np.clip(low + corner, 0, np.array(shape) - 1)
        np.add.at(total, tuple(where.T), share * weight)
    return total
