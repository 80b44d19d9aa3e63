"""Metrics against independent computations: another solver, linear programs, brute-force hulls, sampling."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog, minimize
from scipy.spatial import ConvexHull

import preshape.metrics as metrics
from preshape.metrics import Contacts, ForceLimits
from preshape.metrics.conic import solve
from preshape.metrics.wrench_space import WrenchSpace, hardest, project
from preshape.types import Array
from test_metrics import UP, closed_grasp, random_grasp, six_on_cube, three_on_disc, two_soft

clarabel = pytest.importorskip("clarabel")


def clarabel_solve(c: Array, A: Array, b: Array, blocks: list[tuple[int, int]]) -> tuple[float, Array, bool]:
    """min c·x, A x = b, x in the cones, by the interior-point solver Clarabel."""
    from scipy.sparse import csc_matrix

    size = len(c)
    cones = [clarabel.ZeroConeT(len(b))]
    for count, dim in blocks:
        cones += [clarabel.SecondOrderConeT(dim) if dim > 1 else clarabel.NonnegativeConeT(1)] * count
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    rows = csc_matrix(np.vstack([A, -np.eye(size)]))
    result = clarabel.DefaultSolver(
        csc_matrix((size, size)), c, rows, np.append(b, np.zeros(size)), cones, settings
    ).solve()
    good = str(result.status) in ("Solved", "AlmostSolved")
    return float(result.obj_val), np.array(result.x), good


def force_columns(contacts: Contacts) -> Array:
    """(6, 4n) wrenches of normal, two scaled tangents and scaled moment, with independent tangents."""
    columns = []
    for r, n, mu, gamma in zip(contacts.arms, contacts.normals_in, contacts.mu, contacts.gamma, strict=True):
        t1 = np.linalg.svd(n[None])[2][1]
        for f in (n, mu * t1, mu * np.cross(n, t1)):
            columns.append(np.append(f, np.cross(r, f)))
        columns.append(np.append(np.zeros(3), gamma * n))
    return np.array(columns).T


def reach(
    contacts: Contacts, w: Array, base: Array, *, each: bool = False, joint: Array | None = None
) -> float:
    """Largest k with base + k w producible; forces bounded by one."""
    n = contacts.count
    G = force_columns(contacts)
    axial = np.kron(np.eye(n), np.eye(4)[:1])
    bounds = axial if each else axial.sum(axis=0, keepdims=True)
    if joint is not None:
        bounds = np.vstack([bounds, joint, -joint])
    q = len(bounds)
    A = np.zeros((6 + q, 4 * n + q + 1))
    A[:6, : 4 * n], A[:6, -1], A[6:, : 4 * n], A[6:, 4 * n : -1] = G, -w, bounds, np.eye(q)
    c = np.zeros(4 * n + q + 1)
    c[-1] = -1.0
    value, _, good = clarabel_solve(c, A, np.append(base, np.ones(q)), [(n, 4), (q + 1, 1)])
    assert good
    return -value


def cap_sample(axis: Array, half_angle: float, count: int, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed + 1000)
    across = rng.normal(size=(count, 6))
    across -= (across @ axis)[:, None] * axis
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = half_angle * rng.uniform(size=(count, 1)) ** 0.2
    return np.cos(angle) * axis + np.sin(angle) * across


def lowest(space: WrenchSpace, seed: int = 0) -> float:
    """Least height of the space over unit directions: sampled, the best refined by a general optimiser."""
    d = np.random.default_rng(seed).normal(size=(60_000, 6))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    heights = space.heights(d)
    best = float(heights.min())
    for start in d[np.argsort(heights)[:6]]:
        found = minimize(
            lambda v: float(space.heights(v[None] / np.linalg.norm(v))[0]),
            start,
            method="Nelder-Mead",
            options={"xatol": 1e-7, "fatol": 1e-9, "maxfev": 1500},
        )
        best = min(best, float(found.fun))
    return best


def test_conic_solver_against_clarabel():
    rng = np.random.default_rng(0)
    blocks = [(4, 4), (3, 1), (1, 7)]
    for _ in range(10):
        A = rng.normal(size=(5, 8, 26))
        inside = []
        for _ in range(2):
            point = rng.normal(size=(5, 26))
            for start in (0, 4, 8, 12, 16, 17, 18, 19):
                stop = 26 if start == 19 else start + (4 if start < 16 else 1)
                point[:, start] = np.linalg.norm(point[:, start + 1 : stop], axis=1) + rng.uniform(
                    0.1, 1.0, 5
                )
            inside.append(point)
        b = (A @ inside[0][..., None])[..., 0]
        c = inside[1] + (rng.normal(size=(5, 1, 8)) @ A)[:, 0]
        solution = solve(c, A, b, blocks)
        assert solution.converged.all()
        for i in range(5):
            value, _, good = clarabel_solve(c[i], A[i], b[i], blocks)
            assert good
            assert solution.objective[i] == pytest.approx(value, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("seed", range(24))
def test_force_closure_against_programs(seed: int):
    grasp = random_grasp(seed)
    cone, linear = metrics.force_closure(grasp), metrics.force_closure_linear(grasp, 16)
    # A separating direction, sought by another solver: max s with d·w ≤ -s on every wrench and |d| ≤ 1.
    best = WrenchSpace(grasp, full=True)
    d = np.random.default_rng(seed).normal(size=(20_000, 6))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    if cone.closed:
        assert best.heights(d).min() > 0.0
    if linear.closed:
        assert cone.closed
    # The cones cut into 16 from the outside: open there means open.
    wider = replace(grasp, friction=grasp.mu / math.cos(math.pi / 16))
    if grasp.dimension == 3 and not metrics.force_closure_linear(wider, 16).closed:
        assert not cone.closed
    n = grasp.count
    G = force_columns(grasp)
    A = np.zeros((7, 4 * n + 2))
    A[:6, : 4 * n], A[:6, -2] = G, G[:, ::4].sum(axis=1)
    A[6, : 4 * n : 4], A[6, -2], A[6, -1] = 1.0, n, 1.0
    c = np.zeros(4 * n + 2)
    c[-2] = -1.0
    value, _, good = clarabel_solve(c, A, np.append(np.zeros(6), 1.0), [(n, 4), (2, 1)])
    assert good
    assert cone.margin == pytest.approx(-value, abs=1e-6)
    assert cone.closed == (-value > 1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_linear_force_closure_is_the_origin_inside_the_hull(seed: int):
    grasp = random_grasp(seed, torsion=0.0)
    points = metrics.generators(grasp, 8).reshape(-1, 6)
    inside = bool((ConvexHull(points).equations[:, 6] < -1e-9).all())
    assert metrics.force_closure_linear(grasp, 8).closed == inside


GRASPS = [two_soft(), three_on_disc(), six_on_cube(), *(closed_grasp(seed) for seed in range(4))]


@pytest.mark.parametrize("grasp", GRASPS)
@pytest.mark.parametrize("norm", metrics.NORMS)
def test_epsilon_against_directions(grasp: Contacts, norm: str):
    measure = metrics.epsilon(grasp, norm)
    assert measure.number is not None
    assert measure.lower is not None
    found = lowest(WrenchSpace(grasp, each=norm == "Linf"))
    assert measure.lower - 1e-9 <= measure.number <= found + 1e-7
    # The ball touches where it says, and no wrench a little farther can be produced.
    assert measure.worst is not None
    assert reach(grasp, measure.worst, np.zeros(6), each=norm == "Linf") == pytest.approx(
        measure.number, abs=1e-6
    )


@pytest.mark.parametrize("seed", range(3))
def test_epsilon_between_cones_cut_inside_and_outside(seed: int):
    grasp = closed_grasp(seed, 4, torsion=0.0)
    wider = replace(grasp, friction=grasp.mu / math.cos(math.pi / 16))
    inner, outer = (
        -ConvexHull(metrics.generators(g, 16).reshape(-1, 6)).equations[:, 6].max() for g in (grasp, wider)
    )
    number = metrics.epsilon(grasp).number
    assert inner - 1e-9 <= number <= outer + 1e-9
    assert outer - inner < 0.06 * outer


def test_epsilon_linf_against_the_hull_of_all_sums():
    grasp = closed_grasp(2, 3, torsion=0.0, mu=0.8)
    bounds = []
    for g in (grasp, replace(grasp, friction=grasp.mu / math.cos(math.pi / 6))):
        parts = [np.concatenate([np.zeros((1, 6)), rim]) for rim in metrics.generators(g, 6)]
        sums = np.array([sum(corner) for corner in itertools.product(*parts)])
        bounds.append(-ConvexHull(sums).equations[:, 6].max())
    number = metrics.epsilon(grasp, "Linf").number
    assert bounds[0] - 1e-9 <= number <= bounds[1] + 1e-9


@pytest.mark.parametrize("seed", range(1))
def test_volume_against_monte_carlo(seed: int):
    grasp = closed_grasp(seed, 4, torsion=0.0)
    measure = metrics.volume(grasp, edges=6)
    assert measure.lower is not None
    assert measure.upper is not None
    assert measure.lower < measure.upper
    # Volume = mean over directions of reach⁶ times the unit ball's volume; the reach from a linear program.
    points = metrics.generators(grasp, 6).reshape(-1, 6)
    rng = np.random.default_rng(seed)
    # Directions drawn like the points themselves, weighted back to uniform ones.
    root = np.linalg.cholesky(points.T @ points / len(points))
    samples = []
    for _ in range(700):
        v = root @ rng.normal(size=6)
        d = v / np.linalg.norm(v)
        density = np.linalg.norm(np.linalg.solve(root, d)) ** -6 / np.prod(np.diag(root))
        result = linprog(
            np.append(np.zeros(len(points)), -1.0),
            A_eq=np.column_stack([points.T, -d]),
            b_eq=np.zeros(6),
            A_ub=np.append(np.ones(len(points)), 0.0)[None],
            b_ub=[1.0],
        )
        samples.append(result.x[-1] ** 6 / density)
    estimate = math.pi**3 / 6 * np.mean(samples)
    error = math.pi**3 / 6 * np.std(samples) / math.sqrt(len(samples))
    assert error < 0.1 * estimate
    assert measure.number == pytest.approx(estimate, abs=4 * error)


@pytest.mark.parametrize("seed", range(16))
def test_push_residual_against_clarabel(seed: int):
    grasp = random_grasp(seed)
    measure = metrics.push_residual(grasp)
    assert measure.per_wrench is not None
    weaker = replace(grasp, friction=grasp.mu * 0.6, torsion=np.asarray(grasp.torsion) * 0.6)
    n, G = grasp.count, force_columns(weaker)
    for push, residual in zip(metrics.six_pushes(), measure.per_wrench, strict=True):
        A = np.zeros((7, 4 * n + 7))
        A[:6, : 4 * n], A[:6, 4 * n + 1 :] = G, np.eye(6)
        A[6, : 4 * n : 4] = 1.0
        c = np.zeros(4 * n + 7)
        c[4 * n] = 1.0
        value, _, good = clarabel_solve(c, A, np.append(push, 1.0), [(n, 4), (1, 7)])
        assert good
        assert residual == pytest.approx(value, abs=1e-6)
    assert measure.number == measure.per_wrench.max()
    # The forces are in the cones, sum to one, and leave no less than the residual.
    forces = measure.forces
    assert forces is not None
    normal = np.einsum("mnk,nk->mn", forces, grasp.normals_in)
    sliding = np.linalg.norm(forces - normal[..., None] * grasp.normals_in, axis=-1)
    np.testing.assert_allclose(normal.sum(axis=1), 1.0, atol=1e-9)
    assert (sliding <= 0.6 * grasp.mu * normal + 1e-9).all()
    made = forces.sum(axis=1)
    assert (np.linalg.norm(made - metrics.six_pushes()[:, :3], axis=1) <= measure.per_wrench + 1e-9).all()


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("each", [False, True])
def test_task_margin_against_sampled_wrenches(seed: int, each: bool):
    grasp = closed_grasp(seed)
    axis = np.random.default_rng(seed).normal(size=6)
    axis /= np.linalg.norm(axis)
    load = -0.02 * UP
    limits = ForceLimits(each=1.0) if each else ForceLimits(total=1.0)
    measure = metrics.task_margin(grasp, axis, limits, load=load)
    if not measure.ok:
        pytest.skip("this grasp does not hold the load")
    assert measure.worst is not None
    assert measure.number == pytest.approx(reach(grasp, measure.worst, -load, each=each), abs=1e-6)
    assert math.acos(min(float(measure.worst @ axis), 1.0)) <= metrics.HALF_ANGLE + 1e-9
    space = WrenchSpace(grasp, each=each)
    # No direction separates a smaller cone ...
    y = np.random.default_rng(seed).normal(size=(60_000, 6))
    far, _ = hardest(axis, metrics.HALF_ANGLE, y)
    y, far = y[far > 1e-3], far[far > 1e-3]
    assert ((space.heights(y) + y @ load) / far).min() >= measure.number - 1e-9
    # ... and no wrench of the cone is out of reach before.
    for w in cap_sample(axis, metrics.HALF_ANGLE, 40, seed):
        assert reach(grasp, w, -load, each=each) >= measure.number - 1e-6


@pytest.mark.parametrize("seed", range(12))
def test_task_margin_between_faces_of_cut_cones(seed: int):
    """Exact for cut cones: the smallest of (offset of a face) / (cone's reach across it)."""
    grasp = closed_grasp(seed, torsion=0.0)
    axis = np.random.default_rng(seed + 100).normal(size=6)
    axis /= np.linalg.norm(axis)
    bounds = []
    for mu in (grasp.mu, grasp.mu / math.cos(math.pi / 12)):
        points = metrics.generators(replace(grasp, friction=mu), 12).reshape(-1, 6)
        faces = ConvexHull(points).equations
        far, _ = hardest(axis, metrics.HALF_ANGLE, faces[:, :6])
        bounds.append((-faces[far > 1e-9, 6] / far[far > 1e-9]).min())
    number = metrics.task_margin(grasp, axis, ForceLimits(total=1.0)).number
    assert max(bounds[0], 0.0) - 1e-9 <= number <= bounds[1] + 1e-9


@pytest.mark.parametrize("seed", range(2))
def test_joint_torque_limits(seed: int):
    rng = np.random.default_rng(seed)
    grasp = closed_grasp(seed)
    n = grasp.count
    jacobian = np.zeros((n, 6, 3 * n))
    for i in range(n):
        jacobian[i, :, 3 * i : 3 * i + 3] = rng.normal(size=(6, 3)) * 0.05
    free = metrics.task_margin(grasp, UP, ForceLimits(total=1.0)).number
    assert free is not None
    loose = ForceLimits(total=1.0, jacobian=jacobian, torque=np.full(3 * n, 1e3))
    assert metrics.task_margin(grasp, UP, loose).number == pytest.approx(free, rel=1e-6, abs=1e-7)
    last = free
    for torque in (0.05, 0.01):
        limits = ForceLimits(total=1.0, jacobian=jacobian, torque=np.full(3 * n, torque))
        measure = metrics.task_margin(grasp, UP, limits)
        assert measure.number is not None
        assert measure.number <= last + 1e-7
        last = measure.number
    # Another solver, with its own tangents: joint torques from the forces' own frame.
    columns = np.zeros((3 * n, 4 * n))
    for i, (normal, mu, gamma) in enumerate(
        zip(grasp.normals_in, grasp.mu, np.asarray(grasp.torsion), strict=True)
    ):
        t1 = np.linalg.svd(normal[None])[2][1]
        local = np.column_stack([normal, mu * t1, mu * np.cross(normal, t1)])
        columns[:, 4 * i : 4 * i + 3] = jacobian[i, :3].T @ local
        columns[:, 4 * i + 3] = jacobian[i, 3:].T @ (gamma * normal)
    assert measure.worst is not None
    joint = columns / 0.01
    assert reach(grasp, measure.worst, np.zeros(6), joint=joint) == pytest.approx(last, abs=1e-6)
    for w in cap_sample(UP, metrics.HALF_ANGLE, 40, seed):
        assert reach(grasp, w, np.zeros(6), joint=joint) >= last - 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_gap_against_linear_programs(seed: int):
    grasp = random_grasp(seed)
    directions = metrics.force_directions(20)
    measure = metrics.tdg_gap(grasp, directions)
    G, n = force_columns(grasp), grasp.count
    for d, gap in zip(directions, measure.per_wrench, strict=True):  # type: ignore[arg-type]
        # max d·w, each normal force at most one: every cone on its own
        wrench = np.zeros(6)
        for i in range(n):
            A = np.array([[1.0, 0, 0, 0, 1.0]])
            _, x, good = clarabel_solve(
                np.append(-d @ G[:, 4 * i : 4 * i + 4], 0.0), A, np.ones(1), [(1, 4), (1, 1)]
            )
            assert good
            wrench += G[:, 4 * i : 4 * i + 4] @ x[:4]
        assert gap == pytest.approx(1 - wrench @ d / np.linalg.norm(wrench), abs=1e-4)


def test_singular_values_against_the_eigenvalues_of_the_gram_matrix():
    for seed in range(6):
        grasp = random_grasp(seed)
        G = force_columns(replace(grasp, friction=1.0))
        values = np.sqrt(np.maximum(np.linalg.eigvalsh(G @ G.T), 0.0))
        assert metrics.smallest_singular_value(grasp).number == pytest.approx(values[0], rel=1e-7)
        assert metrics.isotropy(grasp).number == pytest.approx(values[0] / values[-1], rel=1e-7)


def test_projection_on_a_hull_is_the_nearest_point():
    rng = np.random.default_rng(0)
    for _ in range(20):
        hull, point = rng.normal(size=(12, 6)), 2 * rng.normal(size=6)
        away, weights = project(hull, point)
        assert weights.min() >= 0.0
        assert weights.sum() == pytest.approx(1.0)
        np.testing.assert_allclose(point - weights @ hull, away, atol=1e-12)
        # Nearest exactly when no point of the hull is on the near side of the plane across the way.
        assert (hull @ away).max() <= (point - away) @ away + 1e-9
