"""Array functions of the ray caster: normals, light directions, noise removal and colour coding."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..types import Array

Floats = NDArray[np.float32]

CREASE = np.cos(np.radians(40.0))
"""Cosine of the angle between two faces above which their common edge stays sharp."""


def to_linear(display: NDArray[Any]) -> Floats:
    """Convert display values 0..1 (sRGB, IEC 61966-2-1) to linear light."""
    x = np.asarray(display, dtype=np.float64)
    return np.asarray(np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4), np.float32)


def to_display(linear: NDArray[Any]) -> Floats:
    """Convert linear light to display values clipped to 0..1; the inverse of :func:`to_linear`."""
    x = np.clip(linear, 0, 1)
    return np.asarray(np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055), np.float32)


def hemisphere(count: int) -> Array:
    """(count, 3) Unit directions about +z; their density is proportional to the cosine of the angle to z.

    They are a Hammersley set in van der Corput order, so every aligned block of 4, 16 or 64 directions covers
    the hemisphere evenly.
    """
    index = np.arange(count)
    reversed_bits, base, remaining = np.zeros(count), 0.5, index.copy()
    while remaining.any():
        reversed_bits += base * (remaining % 2)
        remaining //= 2
        base /= 2
    radius = np.sqrt(reversed_bits + 0.5 / count)
    angle = 2 * np.pi * ((index * 0.6180339887498949) % 1)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)])


def tangents(normal: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Two (n, 3) unit vectors that form a right-handed frame with each unit normal (Duff et al. 2017)."""
    x, y, z = normal.T
    sign = np.where(z < 0, -1, 1).astype(normal.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    return np.stack([1 + sign * x * x * a, sign * b, -sign * x], 1), np.stack([b, sign + y * y * a, -y], 1)


def corner_normals(vertices: Floats, triangles: NDArray[np.int32], *, smooth: bool) -> Floats:
    """Unit normals at the corners of triangles.

    Args:
        vertices: (n, 3) Vertices.
        triangles: (m, 3) Indices of vertices.
        smooth: If true, the normal of a corner is the area-weighted mean over the faces that meet there at
            less than the crease angle; otherwise it is its own face's normal.

    Returns:
        (m, 3, 3) Normals by triangle, corner and axis. A triangle without area has the normal +z.
    """
    a, b, c = (vertices[triangles[:, i]].astype(np.float64) for i in range(3))
    weighted = np.cross(b - a, c - a)
    length = np.linalg.norm(weighted, axis=1, keepdims=True)
    flat = np.where(length > 0, weighted / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
    result = np.repeat(flat[:, None], 3, axis=1)
    if smooth:
        # Files split vertices at texture seams, so corners are matched by position.
        _, position = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
        at = position.ravel()[triangles.ravel()]
        order = np.argsort(at, kind="stable")
        start, count = np.unique(at[order], return_index=True, return_counts=True)[1:]
        # All ordered pairs of corners at the same position.
        own = np.repeat(order, np.repeat(count, count))
        first = np.repeat(np.repeat(start, count), np.repeat(count, count))
        serial = np.arange(len(own)) - np.repeat(np.cumsum(count**2) - count**2, count**2)
        other = order[first + serial % np.repeat(count, count**2)]
        near = (flat[own // 3] * flat[other // 3]).sum(axis=1) > CREASE
        own, other = own[near], other[near]
        total = np.column_stack(
            [np.bincount(own, weighted[other // 3, i], minlength=len(at)) for i in range(3)]
        )
        size = np.linalg.norm(total, axis=1, keepdims=True)
        mean = np.where(size > 0, total / np.maximum(size, 1e-300), flat.repeat(3, axis=0))
        result = mean.reshape(-1, 3, 3)
    return result.astype(np.float32)


def guarded_blur(
    values: Floats, shape: NDArray[Any], point: Floats, normal: Floats, grid: tuple[int, int], stride: int
) -> Floats:
    """Average each pixel over 4 × 4 pixels that show the same surface.

    Args:
        values: (n, k) Values to average.
        shape: (n,) Index of the surface that each pixel shows.
        point: (n, 3) Point of the surface.
        normal: (n, 3) Unit normal of the surface.
        grid: Height and width of the picture; n = height × width.
        stride: Distance between the averaged pixels. Stride 1 followed by stride 2 averages 10 × 10 pixels,
            with most weight in the middle.
    """
    height, width = grid
    planes = [np.ascontiguousarray(a).reshape(grid) for a in (*normal.T, *point.T)]
    offset = (normal * point).sum(axis=1).reshape(grid)
    kinds, layers = shape.reshape(grid), np.ascontiguousarray(values.T).reshape(-1, height, width)
    total, weight = np.zeros_like(layers), np.zeros(grid, np.float32)
    for dy in range(-2 * stride, 2 * stride, stride):
        for dx in range(-2 * stride, 2 * stride, stride):
            to = (slice(max(0, -dy), height - max(0, dy)), slice(max(0, -dx), width - max(0, dx)))
            of = (slice(max(0, dy), height + min(0, dy)), slice(max(0, dx), width + min(0, dx)))
            nx, ny, nz = (plane[to] for plane in planes[:3])
            mx, my, mz, x, y, z = (plane[of] for plane in planes)
            same = kinds[to] == kinds[of]
            same &= nx * mx + ny * my + nz * mz > 0.8
            same &= np.abs(nx * x + ny * y + nz * z - offset[to]) < 0.01
            for into, layer in zip(total, layers, strict=True):
                into[to] += same * layer[of]
            weight[to] += same
    flat, share = total.reshape(len(layers), -1).T, weight.reshape(-1, 1)
    return np.where(share > 0, flat / np.maximum(share, 1), values)
