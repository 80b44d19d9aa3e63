"""Fruit: solids of revolution or sweeps, deformed slightly. Lengths in millimetres, stem at the top."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...types import Array
from .shapes import curve, lofted, revolved, tube

if TYPE_CHECKING:
    from manifold3d import Manifold as Solid


def _stem(points: list[tuple[float, float, float]], low: float, high: float) -> Solid:
    path = curve(points, 6)
    return tube(path, np.linspace(low, high, len(path)), segments=12)


def apple() -> Solid:
    """An apple with five faint lobes and a stem."""
    half = [
        (0, 6), (3, 4.5), (8, 1), (15, 0.5), (24, 8), (33, 26), (36, 44), (31, 60), (18, 68), (8, 65),
        (2, 58.5), (0, 58),
    ]  # fmt: skip

    def lobes(points: Array) -> Array:
        x, y, z = points.T
        wave = 1 + 0.035 * np.cos(5 * np.arctan2(y, x)) * np.clip(1 - z / 60, 0, 1)
        lean: Array = np.column_stack([x * wave + 0.03 * z, y * wave, z])
        return lean

    body = revolved(curve(half, 7)).warp_batch(lobes)
    return body + _stem([(1.5, 0, 55), (2.4, 0, 64), (5, 0, 72), (9, 0, 78)], 1.3, 2.0)


def pear() -> Solid:
    """A pear leaning a little, with a stem."""
    half = [
        (0, 3.5), (5, 1), (14, 0.5), (26, 8), (33, 26), (30, 44), (20, 62), (15, 76), (12, 86), (6, 92),
        (1.5, 90.5), (0, 90),
    ]  # fmt: skip

    def lean(points: Array) -> Array:
        x, y, z = points.T
        bent: Array = np.column_stack([x + 6 * (z / 90) ** 2, y, z])
        return bent

    body = revolved(curve(half, 7)).warp_batch(lean)
    return body + _stem([(6, 0, 86), (6.5, 0, 96), (9, 0, 104), (13, 0, 110)], 1.4, 2.1)


def banana() -> Solid:
    """A banana lying on its side, its ends along x."""
    sweep = np.linspace(-1.02, 1.0, 49)
    path = 78 * np.column_stack([np.sin(sweep), -np.cos(sweep), np.zeros(49)])
    along = np.linspace(0, 1, 49)
    girth = np.interp(
        along,
        [0, 0.02, 0.05, 0.12, 0.3, 0.55, 0.78, 0.87, 0.93, 1],
        [2.5, 3.6, 4.6, 9.5, 15, 16.5, 13, 6.5, 4.2, 4.6],
    )
    girth[1:-1] = (girth[:-2] + 2 * girth[1:-1] + girth[2:]) / 4
    angle = 2 * np.pi * np.arange(40) / 40
    ridge = 1 - 0.06 * (1 - np.cos(5 * angle)) / 2
    outward = path / 78
    rings = [
        p + g * (np.outer(ridge * np.cos(angle), o) + np.outer(ridge * np.sin(angle), (0, 0, 1)))
        for p, g, o in zip(path, girth, outward, strict=True)
    ]
    return lofted(rings)
