"""A shape descriptor that does not depend on the triangulation of the surface.

The paper describes an object by its extents and by its counts of vertices and faces. The counts change when
the same object is meshed again. The descriptor here consists of means over the surface. Each mean is exact
for flat triangles, so that subdividing, reordering or flipping triangles changes only rounding errors. The
surface need not be closed.
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
"""Exponents of the first 21 numbers, in their order; (a, b, c) stands for the mean of x^a y^b z^c."""

NORMAL_MOMENTS: _Exponents = _SECOND
"""Exponents of the next 6 numbers, the means of such products of the unit normal's components."""

LENGTH = len(POSITION_MOMENTS) + len(NORMAL_MOMENTS) + 1
"""Number of values of a descriptor, 28."""

# Six points of a triangle and weights that integrate polynomials up to the fourth degree exactly (Dunavant
# 1985, High degree efficient symmetrical Gaussian quadrature rules for the triangle).
_POINTS: Array = np.array(
    [
        np.roll([1.0 - 2.0 * side, side, side], corner)
        for side in (0.445948490915965, 0.091576213509771)
        for corner in range(3)
    ]
)
_WEIGHTS: Array = np.repeat([0.223381589678011, 0.109951743655322], 3)
_QUADRATIC: _Exponents = ((0, 0, 0), *_FIRST, *_SECOND)
# Every monomial up to the fourth degree is the product of two of the ten up to the second.
_FACTORS = {
    tuple(p + q for p, q in zip(a, b, strict=True)): (i, j)
    for i, a in enumerate(_QUADRATIC)
    for j, b in enumerate(_QUADRATIC)
}
_BLOCK = 500  # triangles in a block, so that its arrays stay in the processor's cache


def shape_descriptor(mesh: TriangleMesh) -> Array:
    """Describe the shape in the object's own frame, without its size, by 28 numbers [C].

    Positions are scaled so that the bounding box spans -1 to 1 along each axis (0 along an axis without
    extent). Normals are those of the unscaled object. All means are weighted by area:

    ======= =======================================================================================
    numbers content
    ======= =======================================================================================
    0..20   means of x^a y^b z^c with the exponents ``POSITION_MOMENTS``: where the surface lies
            (first degree), how far it spreads and along which diagonals (second), which end is
            thicker (third), whether it is wide in the middle or at the ends (fourth)
    21..26  means of nx², ny², nz², ny nz, nx nz, nx ny: the directions that the surface faces
    27      area divided by the area of the bounding box; above 1 for a body with inner walls
    ======= =======================================================================================

    All numbers are from -1 to 1, except the last, which is above 0. A rotation by 90° or a mirror image
    permutes the numbers and changes signs. The size has no effect.

    Returns:
        (28,) descriptor.

    Raises:
        ObjectError: The surface has no area.

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
    """(10, 10) contribution of some triangles to the means of the products of two monomials.

    Args:
        axes: (3, n) scaled positions of the vertices, one row for each axis.
        triangles: (m, 3) vertex indices.
        shares: (m,) areas of the triangles divided by the whole area.
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
    """The attributes of a mesh with the descriptor in ``shape``.

    Raises:
        ObjectError: The surface has no area.
    """
    return replace(mesh.attributes, shape=shape_descriptor(mesh))


def shape_distance(a: Array, b: Array) -> float:
    """Distance of two shapes: the Euclidean distance of their descriptors [C].

    Args:
        a: (28,) descriptor.
        b: (28,) descriptor.
    """
    length = (LENGTH,)
    difference = frozen_array(a, length, "shape descriptor") - frozen_array(b, length, "shape descriptor")
    return float(np.linalg.norm(difference))


def attribute_distance(a: Attributes, b: Attributes) -> float:
    r"""Distance of two objects' attributes: how far their scales differ, as the logarithm of a ratio [C].

    It is the largest logarithmic ratio of W, H and D, half that of the areas and a third of that of the
    volumes, so that an object scaled by s has the distance \|log s\|. The counts of table 2 are left out,
    because they change with every new export of the same object. The volume is also left out if both are
    below a thousandth of the bounding box (open sheets).
    """
    ratios = [np.abs(np.log(a.extents / b.extents)).max(), abs(np.log(a.area / b.area)) / 2]
    box_a, box_b = float(np.prod(a.extents)), float(np.prod(b.extents))
    if a.volume > 1e-3 * box_a or b.volume > 1e-3 * box_b:
        ratios.append(abs(np.log(max(a.volume, 1e-6 * box_a) / max(b.volume, 1e-6 * box_b))) / 3)
    return float(max(ratios))
