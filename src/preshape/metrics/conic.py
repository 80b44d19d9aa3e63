"""Batches of small second-order-cone programs: a primal-dual interior-point method in NumPy.

    minimise c·x  subject to  A x = b,  x in K,
    maximise b·y  subject to  Aᵀ y + s = c,  s in K,

where K is a product of second-order cones {(u₀, u₁): |u₁| ≤ u₀}; a cone of dimension 1 is the half line. The
method is Mehrotra's predictor-corrector with the scaling of Nesterov and Todd. The programs have at most a
few dozen unknowns, so all matrices are dense; the programs of a batch share their cones. Both the primal and
the dual program must have interior points, which the metrics ensure.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..types import Array, BoolArray, value

TOLERANCE = 1e-10
"""Residuals and gap at which a program is solved, relative to 1 + the size of its data."""
_ACCEPTED = 1e-7  # accuracy that is accepted if rounding errors stop the progress earlier
_ITERATIONS = 60
_Blocks = Sequence[tuple[int, int]]


@value
class ConicSolution:
    """Solutions of a batch of programs.

    Attributes:
        x: (m, N) primal solutions.
        y: (m, p) multipliers of the equations.
        objective: (m,) values c·x.
        converged: (m,) whether residuals and gap are small; rows with False have no meaning.
    """

    x: Array
    y: Array
    objective: Array
    converged: BoolArray


class _Cones:
    """A product of cones; ``blocks`` lists (number of cones, dimension) in the order of the unknowns."""

    def __init__(self, blocks: _Blocks) -> None:
        self.groups: list[tuple[slice, int, int]] = []
        start = 0
        for count, dim in blocks:
            if count:
                self.groups.append((slice(start, start + count * dim), count, dim))
                start += count * dim
        self.size, self.degree = start, sum(count for count, _ in blocks)
        self.unit = np.zeros(start)
        for part, _, dim in self.groups:
            self.unit[part.start : part.stop : dim] = 1.0

    def split(self, u: Array) -> list[Array]:
        """A view (..., count, dim) for each block."""
        return [u[..., part].reshape(*u.shape[:-1], count, dim) for part, count, dim in self.groups]

    def join(self, parts: list[Array]) -> Array:
        return np.concatenate([p.reshape(*p.shape[:-2], -1) for p in parts], axis=-1)

    def depth(self, u: Array) -> Array:
        """(m,) smallest u₀ - |u₁| over all cones."""
        return np.min([(b[..., 0] - _length(b[..., 1:])).min(axis=-1) for b in self.split(u)], axis=0)

    def product(self, u: Array, v: Array) -> Array:
        """The Jordan product u ∘ v = (u·v, u₀ v₁ + v₀ u₁)."""
        out = []
        for a, b in zip(self.split(u), self.split(v), strict=True):
            w = a[..., :1] * b + b[..., :1] * a
            w[..., 0] = (a * b).sum(axis=-1)
            out.append(w)
        return self.join(out)

    def divide(self, u: Array, v: Array) -> Array:
        """The w with u ∘ w = v."""
        out = []
        for a, b in zip(self.split(u), self.split(v), strict=True):
            first = (a[..., 0] * b[..., 0] - (a[..., 1:] * b[..., 1:]).sum(axis=-1)) / _det(a)
            w = (b - first[..., None] * a) / a[..., :1]
            w[..., 0] = first
            out.append(w)
        return self.join(out)

    def step(self, u: Array, du: Array) -> Array:
        """(m,) largest t with u + t du in the cone."""
        out = []
        for a, d in zip(self.split(u), self.split(du), strict=True):
            b = a[..., 0] * d[..., 0] - (a[..., 1:] * d[..., 1:]).sum(axis=-1)
            c = _det(a)
            root = b * b - _det(d) * c if a.shape[-1] > 1 else np.zeros_like(b)
            q = np.sqrt(np.maximum(root, 0.0)) - b
            hit = (root >= 0.0) & (q > 0.0)
            out.append(np.where(hit, c / np.where(hit, q, 1.0), np.inf).min(axis=-1))
        return np.min(out, axis=0)


def _length(u: Array) -> Array:
    return np.sqrt((u * u).sum(axis=-1))


def _det(u: Array) -> Array:
    r = _length(u[..., 1:])
    return (u[..., 0] - r) * (u[..., 0] + r)


class _Scaling:
    """The Nesterov-Todd scaling W of a pair of interior points, with W s = W⁻¹ x."""

    def __init__(self, cones: _Cones, x: Array, s: Array) -> None:
        self.cones = cones
        self.w: list[Array] = []
        self.eta: list[Array] = []
        for a, b in zip(cones.split(x), cones.split(s), strict=True):
            da, db = np.sqrt(_det(a))[..., None], np.sqrt(_det(b))[..., None]
            xb, sb = a / da, b / db
            gamma = np.sqrt((1.0 + (xb * sb).sum(axis=-1, keepdims=True)) / 2.0)
            w = xb - sb
            w[..., 0] = xb[..., 0] + sb[..., 0]
            self.w.append(w / (2.0 * gamma))
            self.eta.append(np.sqrt(da / db))

    def apply(self, u: Array, *, invert: bool = False) -> Array:
        """W u or W⁻¹ u for u (m, N), or for each row of u (m, p, N)."""
        out = []
        for b, w, eta in zip(self.cones.split(u), self.w, self.eta, strict=True):
            if u.ndim == 3:
                w, eta = w[:, None], eta[:, None]
            tail = -w[..., 1:] if invert else w[..., 1:]
            dot = (tail * b[..., 1:]).sum(axis=-1, keepdims=True)
            first = w[..., :1] * b[..., :1] + dot
            rest = b[..., 1:] + (b[..., :1] + dot / (1.0 + w[..., :1])) * tail
            scaled = np.concatenate([first, rest], axis=-1)
            out.append(scaled / eta if invert else scaled * eta)
        return self.cones.join(out)


def solve(c: Array, A: Array, b: Array, blocks: _Blocks) -> ConicSolution:
    """Solve a batch of programs over one product of cones.

    1. Start from the least-squares points of both programs, shifted into the cone.
    2. Compute residuals and gap of each program, and remember its best point so far.
    3. Stop a program that is solved, or whose best point has not improved for five iterations.
    4. Move the others along Mehrotra's direction, and continue with step 2.

    Args:
        c: (N,) or (m, N) costs.
        A: (p, N) or (m, p, N) equations with independent rows.
        b: (p,) or (m, p) right-hand sides.
        blocks: (number of cones, dimension) in the order of the unknowns.
    """
    cones = _Cones(blocks)
    m = max(np.atleast_2d(c).shape[0], np.atleast_2d(b).shape[0], A.shape[0] if A.ndim == 3 else 1)
    p = A.shape[-2]
    c, b = np.broadcast_to(c, (m, cones.size)), np.broadcast_to(b, (m, p))
    A = np.broadcast_to(A, (m, p, cones.size))
    x, y, s = _start(cones, c, A, b)  # 1.
    size_b, size_c = 1.0 + np.abs(b).max(axis=1), 1.0 + np.abs(c).max(axis=1)
    best_x, best_y, best = x, y, np.full(m, np.inf)
    worse = np.zeros(m, dtype=np.int64)
    for _ in range(_ITERATIONS):
        # 2. Residuals and gap.
        rp, rd = b - _mul(A, x), c - _mul_t(A, y) - s
        gap, objective = (x * s).sum(axis=1), (c * x).sum(axis=1)
        error = np.maximum(np.abs(rp).max(axis=1) / size_b, np.abs(rd).max(axis=1) / size_c)
        error = np.maximum(error, gap / (1.0 + np.abs(objective)))
        better = error < best
        worse = np.where(better, 0, worse + 1)
        best = np.where(better, error, best)
        best_x = np.where(better[:, None], x, best_x)
        best_y = np.where(better[:, None], y, best_y)
        # 3. Programs that still run.
        running = (best > TOLERANCE) & (worse < 5)
        if not running.any():
            break
        # 4. The next point. A program that has stopped may divide by zero.
        with np.errstate(all="ignore"):
            dx, dy, ds, t = _direction(cones, A, x, s, rp, rd)
            size = np.abs(dx).max(axis=1) + np.abs(dy).max(axis=1) + np.abs(ds).max(axis=1) + t
        moves = running & np.isfinite(size) & (t > 0.0)
        if not moves.any():
            break
        t = np.where(moves, t, 0.0)[:, None]
        x = np.where(moves[:, None], x + t * dx, x)
        y = np.where(moves[:, None], y + t * dy, y)
        s = np.where(moves[:, None], s + t * ds, s)
    return ConicSolution(
        x=best_x,
        y=best_y,
        objective=(c * best_x).sum(axis=1),
        converged=best <= _ACCEPTED,
    )


def _mul(A: Array, x: Array) -> Array:
    return (A @ x[..., None])[..., 0]


def _mul_t(A: Array, y: Array) -> Array:
    return (y[..., None, :] @ A)[..., 0, :]


def _start(cones: _Cones, c: Array, A: Array, b: Array) -> tuple[Array, Array, Array]:
    """The least-squares points x and (y, s) of both programs, shifted along the axes into the cone."""
    gram = A @ np.swapaxes(A, 1, 2)
    inverse: Array = np.linalg.inv(gram).astype(np.float64, copy=False)
    x = _mul_t(A, _mul(inverse, b))
    y = _mul(inverse, _mul(A, c))
    s = c - _mul_t(A, y)
    for point in (x, s):
        depth = cones.depth(point)
        shift = np.where(depth > 0.1, 0.0, 1.0 - depth)
        point += shift[:, None] * cones.unit
    return x, y, s


def _direction(
    cones: _Cones, A: Array, x: Array, s: Array, rp: Array, rd: Array
) -> tuple[Array, Array, Array, Array]:
    """Mehrotra's direction (dx, dy, ds) and its step length.

    1. Scale both points to the same vector λ = W s.
    2. Predictor: the Newton step towards a gap of zero, and how far it stays in the cone.
    3. Corrector: the Newton step towards a smaller gap, with the predictor's second-order error removed. The
       farther the predictor went, the smaller this gap is.
    """
    W = _Scaling(cones, x, s)
    lam = W.apply(s)
    # A W = Rᵀ Qᵀ avoids forming A W² Aᵀ, whose rounding errors end the progress where forces vanish.
    Q, R = np.linalg.qr(np.swapaxes(W.apply(A), 1, 2))
    try:
        solved = np.linalg.inv(R)
    except np.linalg.LinAlgError:
        nothing = np.full_like(x, np.nan)
        return nothing, np.full_like(rp, np.nan), nothing, np.full(len(x), np.nan)
    wanted, dual = _mul_t(solved, rp), W.apply(rd)

    def newton(q: Array) -> tuple[Array, Array, Array]:
        # dx = W u with u = q - W ds, ds = rd - Aᵀ dy and A W u = rp
        v = q - dual
        move = wanted - _mul_t(Q, v)
        dy = _mul(solved, move)
        return W.apply(v + _mul(Q, move)), dy, rd - _mul_t(A, dy)

    def length(dx: Array, ds: Array) -> Array:
        return np.minimum(cones.step(x, dx), cones.step(s, ds))

    # 2. Predictor.
    dx, dy, ds = newton(-lam)
    t = np.minimum(1.0, length(dx, ds))
    # 3. Corrector.
    sigma = (1.0 - t)[:, None] ** 3
    mu = (lam * lam).sum(axis=1, keepdims=True) / cones.degree
    second = cones.product(W.apply(dx, invert=True), W.apply(ds))
    dx, dy, ds = newton(cones.divide(lam, sigma * mu * cones.unit - second) - lam)
    return dx, dy, ds, np.minimum(1.0, 0.99 * length(dx, ds))
