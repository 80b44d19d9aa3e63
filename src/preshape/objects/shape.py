"""What an object is shaped like, in numbers that do not depend on how its surface was cut into triangles.

The paper describes an object by its extents and by counts of vertices and faces; the counts change whenever
the same object is meshed anew. The descriptor here consists of means over the surface instead. Each is
exact for flat triangles, so that cutting them finer, listing them in another order or winding them the
other way changes nothing but the last digits. None needs a closed surface.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..exceptions import ObjectError
from ..types import Array, Attributes, IntArray, frozen_array, read_only
from .mesh import TriangleMesh

_Exponents = tuple[tuple[int, int, int], ...]

_FIRST: _Exponents = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
_SECOND: _Exponents = ((2, 0, 0), (0, 2, 0), (0, 0, 2), (0, 1, 1), (1, 0, 1), (1, 1, 0))
_THIRD: _Exponents = (
    *((3, 0, 0), (0, 3, 0), (0, 0, 3)),
    *((1, 2, 0), (1, 0, 2), (2, 1, 0), (0, 1, 2), (2, 0, 1), (0, 2, 1)),
)
_FOURTH: _Exponents = ((0, 2, 2), (2, 0, 2), (2, 2, 0))

POSITION_MOMENTS: _Exponents = _FIRST + _SECOND + _THIRD + _FOURTH
"""Exponents of the first 21 numbers, in their order: the mean of x^a y^b z^c for (a, b, c)."""

NORMAL_MOMENTS: _Exponents = _SECOND
"""Exponents of the next 6 numbers: the same of the unit normal's components."""

LENGTH = len(POSITION_MOMENTS) + len(NORMAL_MOMENTS) + 1
"""How many numbers describe a shape: 28."""

# Six points of a triangle whose weighted sum is exact for polynomials to the fourth degree (Dunavant 1985,
# High degree efficient symmetrical Gaussian quadrature rules for the triangle).
_POINTS: Array = np.array(
    [
        np.roll([1.0 - 2.0 * side, side, side], corner)
        for side in (0.445948490915965, 0.091576213509771)
        for corner in range(3)
    ]
)
_WEIGHTS: Array = np.repeat([0.223381589678011, 0.109951743655322], 3)
_QUADRATIC: _Exponents = ((0, 0, 0), *_FIRST, *_SECOND)
# Every monomial to the fourth degree is the product of two of the ten to the second.
_FACTORS = {
    tuple(p + q for p, q in zip(a, b, strict=True)): (i, j)
    for i, a in enumerate(_QUADRATIC)
    for j, b in enumerate(_QUADRATIC)
}
_BLOCK = 500  # triangles at a time: what is computed for them stays in the cache


def shape_descriptor(mesh: TriangleMesh) -> Array:
    """Shape in the object's own frame, without size: 28 numbers between -1 and 1 [C], the last over 0.

    Positions run from -1 to 1 across the bounding box along each axis (0 along an axis without extent),
    normals are unit vectors of the object as it is, and means are weighted by area:

    ======= =======================================================================================
    numbers what
    ======= =======================================================================================
    0..20   means of x^a y^b z^c, exponents ``POSITION_MOMENTS``: where the surface lies (first), how
            widely it is spread and along which diagonals (second), which end is the thicker one (third),
            whether it is wide in the middle or at the ends (fourth degree)
    21..26  means of nx², ny², nz², ny nz, nx nz, nx ny: which way the surface faces
    27      area over that of the bounding box; a body with inner walls has more than 1
    ======= =======================================================================================

    A turn by 90° or a mirror image permutes the numbers and changes signs; a change of size changes nothing.

    Returns:
        (28,) numbers.

    Raises:
        ObjectError: the surface has no area.

    >>> from preshape.objects.library import load_library_object
    >>> shape_descriptor(load_library_object("cube"))[[0, 3, 6, 21, 27]].round(6) + 0.0
    array([0.      , 0.555556, 0.      , 0.333333, 1.      ])
    """
    area = mesh.area
    if not area > 0.0:
        raise ObjectError(f"{mesh.name}: a surface without area has no shape")
    shares = mesh.areas / area
    half = np.where(mesh.extents > 0.0, mesh.extents / 2.0, 1.0)
    axes = np.ascontiguousarray(((mesh.vertices - mesh.cog) / half).T)
    products = np.zeros((len(_QUADRATIC), len(_QUADRATIC)))
    for start in range(0, len(shares), _BLOCK):
        part = slice(start, start + _BLOCK)
        products += _products(axes, mesh.triangles[part], shares[part])
    means = [products[_FACTORS[exponents]] for exponents in POSITION_MOMENTS]
    facing = (mesh.normals.T * shares) @ mesh.normals
    across = [facing[i, i] for i in range(3)] + [facing[1, 2], facing[0, 2], facing[0, 1]]
    x, y, z = mesh.extents
    return read_only(np.array([*means, *across, area / (2.0 * (x * y + y * z + z * x))]))


def _products(axes: Array, triangles: IntArray, shares: Array) -> Array:
    """(10, 10) contribution of some triangles to the mean of the products of all quadratic monomials.

    Args:
        axes: (3, n) positions in the bounding box, one row an axis.
        triangles: (m, 3) their corners.
        shares: (m,) their areas over the whole area.
    """
    first, second, third = np.ascontiguousarray(triangles.T)
    monomials = np.ones((len(_QUADRATIC), len(_WEIGHTS) * len(shares)))
    for axis, row in zip(axes, monomials[1:4], strict=True):
        np.matmul(_POINTS, np.stack([axis[first], axis[second], axis[third]]), out=row.reshape(6, -1))
    x, y, z = monomials[1:4]
    for row, (a, b) in zip(monomials[4:], ((x, x), (y, y), (z, z), (y, z), (x, z), (x, y)), strict=True):
        np.multiply(a, b, out=row)
    product: Array = (monomials * np.outer(_WEIGHTS, shares).ravel()) @ monomials.T
    return product


def described(mesh: TriangleMesh) -> Attributes:
    """The mesh's attributes with the descriptor in ``shape``.

    Raises:
        ObjectError: the surface has no area.
    """
    return replace(mesh.attributes, shape=shape_descriptor(mesh))


def shape_distance(a: Array, b: Array) -> float:
    """How unlike two shapes are: the root of the sum of squared differences of their descriptors [C].

    Args:
        a: (28,) descriptor.
        b: (28,) another one.
    """
    length = (LENGTH,)
    difference = frozen_array(a, length, "shape descriptor") - frozen_array(b, length, "shape descriptor")
    return float(np.linalg.norm(difference))


def attribute_distance(a: Attributes, b: Attributes) -> float:
    """Distance of two objects' attributes: the largest logarithmic ratio of W, H, D, area and volume [C].

    The counts of table 2 are left out, because they change with every new export of the same object. A volume
    below a thousandth of the bounding box (an open sheet) means nothing and is left out as well.
    """
    ratios = [np.abs(np.log(a.extents / b.extents)).max(), abs(np.log(a.area / b.area))]
    box_a, box_b = float(np.prod(a.extents)), float(np.prod(b.extents))
    if a.volume > 1e-3 * box_a or b.volume > 1e-3 * box_b:
        ratios.append(abs(np.log(max(a.volume, 1e-6 * box_a) / max(b.volume, 1e-6 * box_b))))
    return float(max(ratios))
