"""Contacts of a grasp: friction cones, contact wrenches and the grasp matrix.

A contact force is f = fₙ n + fₜ with the inward normal n. A soft finger adds a moment m about n (Howe &
Cutkosky 1996), with √(|fₜ|²/μ² + m²/γ²) ≤ fₙ. Wrenches are (force, torque/ℓ) about the reference point.

Cone coordinates u of a contact are (normal, two tangents, moment), scaled so that its friction cone is the
plain cone ``|u₁| ≤ u₀``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ..exceptions import InputError
from ..types import Array, freeze, frozen_array, value

_NORMAL_TOLERANCE = 1e-3  # largest error of a normal's length; more is a mistake of the caller [C]
_NO_TANGENT = 1e-6  # a vector's part along the surface must be longer than this times ℓ to give a tangent


@value
class Contacts:
    """The contacts of one grasp, in any frame.

    Attributes:
        positions: (n, 3) contact points [m]; n may be 0.
        normals_in: (n, 3) unit normals into the object.
        friction: (n,) sliding coefficients μ ≥ 0, or one number for all.
        torsion: (n,) torsional coefficients γ ≥ 0 [m], the moment about the normal per newton of normal
            force, or one number for all; 0 means a hard finger.
        reference: (3,) reference point of the torques [m].
        length: ℓ > 0 [m], half the object's largest extent; torques are divided by it.

    Raises:
        InputError: An array has the wrong shape or is not finite, a normal is not of unit length, a friction
            coefficient is negative, or the length is not positive.
    """

    positions: Array
    normals_in: Array
    friction: Array | float
    torsion: Array | float = 0.0
    reference: Array | Sequence[float] = (0.0, 0.0, 0.0)
    length: float

    def __post_init__(self) -> None:
        positions = _rows(self.positions, None, "contact positions")
        n = len(positions)
        normals = _rows(self.normals_in, n, "contact normals")
        sizes = np.linalg.norm(normals, axis=1)
        if n and np.abs(sizes - 1.0).max() > _NORMAL_TOLERANCE:
            raise InputError(
                f"contact normals must have length 1, got {sizes[np.abs(sizes - 1.0).argmax()]:g}"
            )
        length = float(frozen_array(self.length, (), "the characteristic length"))
        if length <= 0.0:
            raise InputError(f"the characteristic length must be positive, got {length:g} m")
        freeze(
            self,
            positions=positions,
            normals_in=frozen_array(normals / sizes[:, None], (n, 3), "contact normals"),
            friction=_coefficients(self.friction, n, "friction"),
            torsion=_coefficients(self.torsion, n, "torsional friction"),
            reference=frozen_array(self.reference, (3,), "reference point"),
            length=length,
        )

    @property
    def count(self) -> int:
        """Number of contacts."""
        return len(self.positions)

    @property
    def mu(self) -> Array:
        """(n,) sliding coefficients."""
        return np.asarray(self.friction)

    @property
    def gamma(self) -> Array:
        """(n,) torsional coefficients, divided by ℓ."""
        return np.asarray(self.torsion) / self.length

    @property
    def dimension(self) -> int:
        """Dimension of the friction cones, which is 3, or 4 if any contact is soft."""
        return 4 if self.gamma.any() else 3

    @property
    def arms(self) -> Array:
        """(n, 3) positions relative to the reference point, divided by ℓ."""
        return (self.positions - np.asarray(self.reference)) / self.length


def _rows(given: Array, n: int | None, name: str) -> Array:
    """(n, 3) array of the input; an empty list is no contacts."""
    empty = isinstance(given, list | tuple | np.ndarray) and len(given) == 0
    return frozen_array(np.zeros((0, 3)) if empty else given, (n, 3), name)


def _coefficients(given: Array | float, n: int, name: str) -> Array:
    name = f"{name} coefficients"
    single = isinstance(given, int | float | np.number) or (isinstance(given, np.ndarray) and given.ndim == 0)
    array = frozen_array(np.full(n, frozen_array(given, (), name)) if single else given, (n,), name)
    if n and array.min() < 0.0:
        raise InputError(f"{name} must not be negative, got {array.min():g}")
    return array


def tangents(contacts: Contacts) -> tuple[Array, Array]:
    """Two unit tangents of each contact, (n, 3) each, that rotate and mirror with the scene.

    The first tangent is the arm from the reference point, projected on the surface. If the projection
    vanishes, the vector to another contact or another normal is projected instead. World axes are used only
    if all of these lie on one line, because then the scene has rotational symmetry.
    """
    first, arms = np.empty((contacts.count, 3)), contacts.arms
    for i, n in enumerate(contacts.normals_in):
        for hint in _hints(contacts, arms, i):
            along = hint - (hint @ n) * n
            size = math.sqrt(float(along @ along))
            if size > _NO_TANGENT:
                first[i] = along / size
                break
    return first, np.cross(contacts.normals_in, first)


def _hints(contacts: Contacts, arms: Array, i: int) -> Iterator[Array]:
    """Vectors to project for the tangent of contact i, in order of preference; the last one always works."""
    yield arms[i]
    others = [j for j in range(len(arms)) if j != i]
    yield from (arms[j] - arms[i] for j in others)
    yield from (contacts.normals_in[j] for j in others)
    yield np.eye(3)[np.abs(contacts.normals_in[i]).argmin()]


def grasp_matrix(contacts: Contacts) -> Array:
    """(6, n·d) grasp matrix G: unit forces along the normal and two tangents, and the moment if d is 4.

    The column of the moment is scaled to γ/ℓ, the moment that one newton of normal force can hold; it is zero
    for a hard finger [C].
    """
    return _columns(contacts, np.ones(contacts.count))


def cone_matrix(contacts: Contacts) -> Array:
    """(6, n·d) matrix that maps the cone coordinates of all contacts to a wrench."""
    return _columns(contacts, contacts.mu)


def _columns(contacts: Contacts, scale: Array) -> Array:
    n, arms = contacts.normals_in, contacts.arms
    t1, t2 = tangents(contacts)
    forces = np.stack([n, scale[:, None] * t1, scale[:, None] * t2], axis=1)
    wrenches = np.concatenate([forces, np.cross(arms[:, None], forces)], axis=-1)
    if contacts.dimension == 4:
        moment = np.concatenate([np.zeros_like(n), contacts.gamma[:, None] * n], axis=-1)
        wrenches = np.concatenate([wrenches, moment[:, None]], axis=1)
    return wrenches.reshape(-1, 6).T


def in_space(contacts: Contacts, local: Array) -> Array:
    """(..., n, 3) contact forces of (..., n, d) cone coordinates, in the frame of the contacts."""
    t1, t2 = tangents(contacts)
    axes = np.stack([contacts.normals_in, contacts.mu[:, None] * t1, contacts.mu[:, None] * t2], axis=1)
    return np.einsum("...nd,ndk->...nk", local[..., :3], axes)


def support(contacts: Contacts, directions: Array) -> tuple[Array, Array]:
    """How far each contact reaches along directions with a unit normal force.

    Args:
        contacts: The contacts of the grasp.
        directions: (m, 6) directions in wrench space.

    Returns:
        (m, n) largest d·w over the contact's wrenches with fₙ = 1, and (m, n, 6) those wrenches.
    """
    G = cone_matrix(contacts).reshape(6, contacts.count, contacts.dimension)
    local = np.einsum("mk,knd->mnd", directions, G)
    size = np.linalg.norm(local[..., 1:], axis=-1)
    unit = np.zeros_like(local)
    unit[..., 0] = 1.0
    unit[..., 1:] = local[..., 1:] / np.where(size > 0.0, size, 1.0)[..., None]
    return local[..., 0] + size, np.einsum("knd,mnd->mnk", G, unit)


def rim(contacts: Contacts, edges: int = 8, *, halves: bool = True) -> Array:
    """(k, d) evenly spread cone coordinates on the boundary of the plain cone at height 1.

    A hard finger has ``edges`` of them. A soft finger also has the two pure moments, and with ``halves`` a
    ring halfway (45°) to each.

    Raises:
        InputError: There are fewer than 4 edges or an odd number of them; an odd number would make the result
            of a mirrored scene differ.
    """
    if edges < 4 or edges % 2:
        raise InputError(f"a cone must have an even number of edges, at least 4, got {edges}")
    angles = 2.0 * np.pi * np.arange(edges) / edges
    ring = np.stack([np.ones(edges), np.cos(angles), np.sin(angles)], axis=1)
    if contacts.dimension == 3:
        return ring
    half = math.sqrt(0.5)
    rings = [np.insert(ring, 3, 0.0, axis=1), np.array([[1.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, -1.0]])]
    if halves:
        rings += [np.insert(ring * [1.0, half, half], 3, sign * half, axis=1) for sign in (1.0, -1.0)]
    return np.concatenate(rings)


def generators(contacts: Contacts, edges: int = 8) -> Array:
    """(n, k, 6) wrenches with fₙ = 1 on the boundary of each friction cone: edges of a pyramid inside it."""
    G = cone_matrix(contacts).reshape(6, contacts.count, contacts.dimension)
    return np.einsum("knd,ed->nek", G, rim(contacts, edges))
