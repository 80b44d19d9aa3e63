"""The forces that a grasp may use, as equations over cones, for the metrics that optimise over them."""

from __future__ import annotations

import numpy as np

from ..exceptions import InputError
from ..types import Array, freeze, frozen_array, value
from .conic import ConicSolution, solve
from .contacts import Contacts, cone_matrix, tangents

PENALTY = 100.0
"""Cost of one unit of wrench that is not produced, while one unit of reach gains 1; see :func:`reach`."""


@value
class ForceLimits:
    """Bounds of the contact forces; ``total`` or ``each`` is needed.

    Attributes:
        total: Largest sum of the normal forces [N] (the L1 bound).
        each: Largest normal force of each contact [N] (the L∞ bound).
        jacobian: (n, 3, j) or (n, 6, j) velocity of each contact point (linear; angular) per unit joint
            speed, in the frame of the contacts; joint torques are Jᵀ f.
        torque: (j,) largest joint torques in either direction [N·m].

    Raises:
        InputError: There is no bound, a bound is not positive, or only one of Jacobian and torques is given.
    """

    total: float | None = None
    each: float | None = None
    jacobian: Array | None = None
    torque: Array | None = None

    def __post_init__(self) -> None:
        if self.total is None and self.each is None:
            raise InputError("force limits need a total or an each [N], got neither")
        for name in ("total", "each"):
            given = getattr(self, name)
            if given is not None and not (np.isfinite(given) and given > 0.0):
                raise InputError(f"the force limit {name} must be positive, got {given:g} N")
        if (self.jacobian is None) != (self.torque is None):
            raise InputError("a Jacobian and joint torque limits must be given together, got only one")
        if self.jacobian is not None and self.torque is not None:
            jacobian = frozen_array(self.jacobian, (None, None, None), "contact Jacobian")
            if jacobian.shape[1] not in (3, 6):
                raise InputError(f"a contact Jacobian is n×3×j or n×6×j, got {jacobian.shape}")
            torque = frozen_array(self.torque, (jacobian.shape[2],), "joint torque limits")
            if torque.size and torque.min() <= 0.0:
                raise InputError(f"joint torque limits must be positive, got {torque.min():g} N·m")
            freeze(self, jacobian=jacobian, torque=torque)

    @property
    def unit(self) -> float:
        """Unit of force in the programs [N]."""
        return float(min(x for x in (self.total, self.each) if x is not None))


@value
class ForceProgram:
    """The set {w = G u: u in the cones, within the limits} as equations.

    Attributes:
        equations: (6 + q, N) left-hand sides, 6 rows for the wrench and q rows for the limits; forces are in
            units of ``unit``.
        limits: (q,) right-hand sides of the limits.
        blocks: Cones of the N unknowns: contacts, then slacks.
        unit: Unit of force [N].
    """

    equations: Array
    limits: Array
    blocks: tuple[tuple[int, int], ...]
    unit: float


def force_program(contacts: Contacts, limits: ForceLimits) -> ForceProgram:
    """The program of contacts under force limits.

    Raises:
        InputError: The Jacobian has another number of contacts.
    """
    n, d, unit = contacts.count, contacts.dimension, limits.unit
    # (n, n·d) matrix that selects the normal forces.
    axial: Array = np.kron(np.eye(n), np.eye(d)[:1]).astype(np.float64, copy=False)
    rows: list[Array] = []
    right: list[Array] = []
    slacks: list[Array] = []
    if limits.total is not None:
        rows, right, slacks = (
            [axial.sum(axis=0, keepdims=True)],
            [np.array([limits.total / unit])],
            [np.eye(1)],
        )
    if limits.each is not None:
        rows.append(axial)
        right.append(np.full(n, limits.each / unit))
        slacks.append(np.eye(n))
    if limits.jacobian is not None and limits.torque is not None:
        if len(limits.jacobian) != n:
            raise InputError(f"the contact Jacobian is of {len(limits.jacobian)} contacts, the grasp has {n}")
        share = _joint_torques(contacts, limits.jacobian) * (unit / limits.torque[:, None])
        # A joint without load needs no equation.
        share = share[np.abs(share).max(axis=1) > 0.0]
        rows += [share, -share]
        right.append(np.ones(2 * len(share)))
        slacks.append(np.eye(2 * len(share)))
    extra = sum(len(s) for s in slacks)
    equations = np.zeros((6 + extra, n * d + extra))
    equations[:6, : n * d] = cone_matrix(contacts)
    equations[6:, : n * d] = np.concatenate(rows)
    equations[6:, n * d :] = np.eye(extra)
    return ForceProgram(
        equations=equations, limits=np.concatenate(right), blocks=((n, d), (extra, 1)), unit=unit
    )


def _joint_torques(contacts: Contacts, jacobian: Array) -> Array:
    """(j, n·d) joint torques [N·m] per unit of each cone coordinate."""
    t1, t2 = tangents(contacts)
    mu = contacts.mu[:, None]
    forces = np.stack([contacts.normals_in, mu * t1, mu * t2], axis=2)  # (n, 3, 3)
    linear = np.einsum("nkj,nkd->jnd", jacobian[:, :3], forces)
    if contacts.dimension == 4:
        # Without the angular half of the Jacobian the moments load no joint.
        moment = np.zeros((jacobian.shape[2], contacts.count, 1))
        if jacobian.shape[1] == 6:
            axes = np.asarray(contacts.torsion)[:, None] * contacts.normals_in
            moment = np.einsum("nkj,nk->jn", jacobian[:, 3:], axes)[..., None]
        linear = np.concatenate([linear, moment], axis=2)
    return linear.reshape(len(linear), -1)


def reach(program: ForceProgram, directions: Array, base: Array) -> tuple[Array, Array, ConicSolution]:
    """How far the producible wrenches reach from ``base``: the largest k with base + k·direction among them.

    The program maximises k - 100 |r|, where r is the part of the wrench that is not produced; so it always
    has a solution. If the load is held, r ≠ 0 costs more than it gains, unless the angle between direction
    and boundary is below 0.6°.

    Args:
        program: Wrenches that the grasp can produce.
        directions: (m, 6) unit wrenches; a row of zeros tests ``base`` alone and gives -100 |r|.
        base: (6,) wrench [N].

    Returns:
        (m,) k [N]; (m, 6) outward normals y of the boundary there, with y·direction = 1; the solution.
    """
    m, size = len(directions), program.equations.shape[1]
    A = np.zeros((m, len(program.equations), size + 1 + 7))
    A[:, :, :size] = program.equations
    A[:, :6, size] = -directions
    A[:, :6, size + 2 :] = np.eye(6)
    b = np.concatenate([base / program.unit, program.limits])
    c = np.zeros((m, size + 8))
    c[:, size] = np.where(directions.any(axis=1), -1.0, 1.0)
    c[:, size + 1] = PENALTY
    solution = solve(c, A, b, (*program.blocks, (1, 1), (1, 7)))
    return -solution.objective * program.unit, solution.y[:, :6], solution
