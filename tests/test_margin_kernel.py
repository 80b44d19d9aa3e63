"""The wrench-margin kernel against conic programs, its NumPy twin, and cases known by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from preshape.exceptions import InputError
from preshape.kernels.margin.host import MarginKernel, Margins, cone_starts, margins
from preshape.kernels.margin.plain import SoftContacts, margin_plain
from preshape.metrics import HALF_ANGLE, Contacts, ForceLimits, six_pushes, task_margin
from preshape.spatial import rotation_from_quaternion
from preshape.types import Array

PUSHES = six_pushes()


class Batch:
    """Random candidates with 2..5 contacts on an ellipsoid, some of them odd."""

    def __init__(self, count: int, seed: int, *, odd: bool = True) -> None:
        rng = np.random.default_rng(seed)
        self.friction = float(rng.uniform(0.18, 0.6))
        self.torsion = float(rng.choice([0.0, rng.uniform(0.0, 0.012)], p=[0.3, 0.7]))
        self.points, self.normals = np.zeros((count, 8, 3)), np.zeros((count, 8, 3))
        self.counts, self.length = rng.integers(2, 6, count), rng.uniform(0.03, 0.1, count)
        for i, (n, ell) in enumerate(zip(self.counts, self.length, strict=True)):
            axes = np.array([1.0, rng.uniform(0.4, 1.0), rng.uniform(0.3, 1.0)]) * ell
            u = rng.normal(size=(n, 3))
            u /= np.linalg.norm(u, axis=1, keepdims=True)
            if rng.random() < 0.7:  # a thumb opposite the others
                u[0] = -u[1:].mean(axis=0)
                u[0] /= np.linalg.norm(u[0])
            p, q = u * axes, -u / axes
            q /= np.linalg.norm(q, axis=1, keepdims=True)
            kind = rng.integers(0, 12) if odd else -1
            if kind == 0:  # coincident contacts
                p[1], q[1] = p[0], q[0]
            elif kind == 1:  # coplanar
                p[:, 2] = 0.0
            elif kind == 2:  # parallel normals
                q = np.where(q @ q[0] < 0.0, -1.0, 1.0)[:, None] * q[0]
            elif kind == 3:  # exactly opposed
                p[1], q[0] = -p[0], -p[0] / np.linalg.norm(p[0])
                q[1] = -q[0]
            elif kind == 4:  # all in one place
                p = p * 0.05
            self.points[i, :n], self.normals[i, :n] = p, q

    def margins(self, wrenches: Array = PUSHES, **more: object) -> Margins:
        return margins(
            self.points,
            self.normals,
            self.counts,
            wrenches=wrenches,
            friction=self.friction,
            torsion=self.torsion,
            length=self.length,
            **more,  # type: ignore[arg-type]
        )

    def contacts(self, i: int) -> Contacts:
        n = self.counts[i]
        return Contacts(
            positions=self.points[i, :n],
            normals_in=self.normals[i, :n],
            friction=self.friction,
            torsion=self.torsion,
            length=self.length[i],
        )

    def soft_contacts(self, i: int) -> SoftContacts:
        n, ell = self.counts[i], self.length[i]
        return SoftContacts(self.points[i, :n] / ell, self.normals[i, :n], self.friction, self.torsion / ell)


def asked(seed: int) -> tuple[Array, Array | None]:
    """The six pushes, or ten random wrenches; alone or on top of a small force."""
    rng = np.random.default_rng(100 + seed)
    base = np.append(rng.normal(size=3), np.zeros(3))
    base *= rng.uniform(0.0, 0.1) / np.linalg.norm(base)
    return PUSHES if seed % 3 else 0.1 * rng.normal(size=(10, 6)), base if seed % 2 else None


def distance(contacts: Contacts, point: Array) -> float:
    """From what a unit of grip produces, by Clarabel."""
    from test_metrics_programs import clarabel_solve, force_columns

    n = contacts.count
    A = np.zeros((7, 4 * n + 7))
    A[:6, : 4 * n], A[:6, 4 * n + 1 :], A[6, : 4 * n : 4] = force_columns(contacts), np.eye(6), 1.0
    c = np.zeros(4 * n + 7)
    c[4 * n] = 1.0
    number, _, good = clarabel_solve(c, A, np.append(point, 1.0), [(n, 4), (1, 7)])
    assert good
    return number


@pytest.mark.parametrize("seed", range(12))
def test_against_clarabel(seed: int):
    pytest.importorskip("clarabel")
    from test_metrics_programs import reach

    batch, (wrenches, base) = Batch(10, seed), asked(seed)
    found = batch.margins(wrenches, base=base)
    b = np.zeros(6) if base is None else base
    for i in range(10):
        contacts = batch.contacts(i)
        each = np.array([distance(contacts, b + w) for w in wrenches])
        assert found.residual[i] == pytest.approx(max(each.max(), 0.0), rel=0.005, abs=5e-6)
        if found.residual_worst[i] >= 0:
            assert each[found.residual_worst[i]] == pytest.approx(each.max(), rel=0.005, abs=5e-6)
        if base is not None:
            from preshape.metrics.distance import distance as exactly
            from preshape.metrics.wrench_space import WrenchSpace

            held = exactly(WrenchSpace(contacts), b)[0] < 1e-6
            assert held or found.strength[i] == 0.0
            if not held:
                continue
        each = np.array([reach(contacts, w / np.linalg.norm(w), b) for w in wrenches])
        assert found.strength[i] == pytest.approx(max(each.min(), 0.0), rel=0.005, abs=3e-5)
        if found.strength[i] > 0.0:
            assert each[found.strength_worst[i]] == pytest.approx(each.min(), rel=0.005, abs=3e-5)


@pytest.mark.parametrize("seed", range(4))
def test_kernel_against_its_twin(seed: int):
    batch, (wrenches, base) = Batch(20, 50 + seed), asked(seed)
    found = batch.margins(wrenches, base=base)
    for i in range(20):
        plain = margin_plain(batch.soft_contacts(i), wrenches, np.zeros(6) if base is None else base)
        assert found.residual[i] == pytest.approx(plain.residual, rel=0.006, abs=6e-6)
        assert found.strength[i] == pytest.approx(plain.strength, rel=0.006, abs=5e-5)


@pytest.mark.parametrize("thorough", [False, True])
def test_cone_against_its_twin(thorough: bool):
    batch = Batch(20, 9)
    axis = np.array([0.2, -0.1, 0.9, 0.3, 0.1, -0.2])
    axis /= np.linalg.norm(axis)
    found = strengths(batch, axis, thorough=thorough)
    starts = cone_starts(axis, HALF_ANGLE)
    np.testing.assert_allclose(np.linalg.norm(starts, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(starts[1:] @ axis, math.cos(HALF_ANGLE), atol=1e-12)
    first = len(starts)
    if thorough:
        starts = np.concatenate([starts, starts, cone_starts(axis, HALF_ANGLE, rotated=True)])
        assert len(np.unique(starts.round(9), axis=0)) == 21
    cone = axis, HALF_ANGLE
    plain = np.array(
        [
            margin_plain(batch.soft_contacts(i), starts, np.zeros(6), cone=cone, restart=first).strength
            for i in range(20)
        ]
    )
    # Either may miss a minimum that the other meets on its way.
    assert (np.abs(found.strength - plain) <= 0.006 * plain + 5e-5).mean() >= 0.9


def strengths(batch: Batch, axis: Array, **more: object) -> SimpleNamespace:
    """Strengths of the batch against a cone, and the wrenches that decided them."""
    given = {"friction": batch.friction, "torsion": batch.torsion, "half_angle": HALF_ANGLE, **more}
    kernel = MarginKernel(axis[None], **given)  # type: ignore[arg-type]
    return SimpleNamespace(**kernel(batch.points, batch.normals, batch.counts, batch.length))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("thorough", [False, True])
def test_cone_against_the_task_margin(seed: int, thorough: bool):
    pytest.importorskip("clarabel")
    from test_metrics_programs import reach

    batch = Batch(24, 20 + seed, odd=False)
    axis = np.random.default_rng(seed).normal(size=6)
    axis /= np.linalg.norm(axis)
    found = strengths(batch, 3.0 * axis, thorough=thorough)
    off = []
    for i in range(24):
        exact = task_margin(batch.contacts(i), axis, ForceLimits(total=1.0)).number
        assert exact is not None
        off.append(abs(found.strength[i] - exact) / max(exact, 0.01))
        wrench = found.wrench[i]
        assert np.linalg.norm(wrench) == pytest.approx(1.0, abs=1e-5)
        assert math.acos(min(float(wrench @ axis), 1.0)) <= math.radians(15.0) + 1e-3
        # The wrench said to decide is stopped there: too large is possible, too small is not.
        if found.strength[i] > 0.0:
            reached = reach(batch.contacts(i), wrench, np.zeros(6))
            assert reached == pytest.approx(found.strength[i], rel=0.01, abs=5e-5)
    assert np.mean(np.array(off) < 0.01) > 0.9
    assert max(off) < (0.03 if thorough else 0.3)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("thorough", [False, True])
def test_what_is_worth_little_is_not_worked_out(share: float, thorough: bool):
    """With a floor the same above it; under it something between the strength and the floor."""
    batch = Batch(200, 11)
    how = {"half_angle": HALF_ANGLE, "thorough": thorough}
    for more in (how, {}):
        wrenches = PUSHES[2:3] if more else PUSHES
        kernel = MarginKernel(wrenches, friction=batch.friction, torsion=batch.torsion, **more)  # type: ignore[arg-type]
        given = batch.points, batch.normals, batch.counts, float(np.mean(batch.length)), np.zeros(3)
        whole = kernel.strengths(*given)
        floor = float(np.quantile(whole[whole > 0], share))
        found = kernel.strengths(*given, least=floor)
        above = whole > floor
        assert 0.05 < above.mean() < 0.9
        np.testing.assert_array_equal(found[above], whole[above])
        assert (found[~above] <= floor).all()
        assert (found[~above] >= whole[~above]).all()


class BoundedBatch:
    """Random candidates with 5..24 contacts on an ellipsoid, each with a largest normal force of its own."""

    def __init__(self, count: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.friction, self.torsion = float(rng.uniform(0.2, 0.8)), float(rng.uniform(0.0, 0.01)) * (seed % 2)
        self.length, self.base = float(rng.uniform(0.03, 0.1)), 4.0 * rng.normal(size=6) * (seed % 3)
        self.base[3:] *= 0.3
        self.points, self.normals = np.zeros((count, 24, 3)), np.zeros((count, 24, 3))
        self.bounds, self.counts = np.zeros((count, 24)), rng.integers(5, 25, count)
        for i, n in enumerate(self.counts):
            axes = np.array([1.0, rng.uniform(0.3, 1.0), rng.uniform(0.2, 1.0)]) * 0.06
            u = rng.normal(size=(n, 3))
            if i % 4 == 1:  # neighbours in pairs
                u[n // 2 :] = u[: n - n // 2] + 0.05 * rng.normal(size=(n - n // 2, 3))
            u /= np.linalg.norm(u, axis=1, keepdims=True)
            p, q = u * axes, -u / axes
            if i % 4 == 2:  # opposed pairs
                p[1::2], q[1::2] = -p[::2][: n // 2], -q[::2][: n // 2]
            self.points[i, :n], self.normals[i, :n] = p, q / np.linalg.norm(q, axis=1, keepdims=True)
            self.bounds[i, :n] = np.exp(rng.uniform(np.log(0.5), np.log(60.0), n))
            self.bounds[i, 0] *= i % 5 > 0
        # What lies beyond the counts must not matter.
        beyond = np.arange(24) >= self.counts[:, None]
        self.points[beyond], self.normals[beyond], self.bounds[beyond] = 1.0, 0.5, 30.0

    def kernel(self, wrenches: Array, **more: object) -> MarginKernel:
        given = {"base": self.base, "friction": self.friction, "torsion": self.torsion, **more}
        return MarginKernel(wrenches, **given)  # type: ignore[arg-type]

    def strengths(self, kernel: MarginKernel, factor: float = 1.0, **more: object) -> Array:
        given = self.points, self.normals, self.counts, self.length, np.zeros(3)
        return kernel.strengths(*given, bounds=factor * self.bounds, **more)  # type: ignore[arg-type]

    def soft_contacts(self, i: int) -> SoftContacts:
        n, ell = self.counts[i], self.length
        arms, normals = self.points[i, :n] / ell, self.normals[i, :n]
        return SoftContacts(arms, normals, self.friction, self.torsion / ell, self.bounds[i, :n])

    def reach(self, i: int, wrench: Array) -> float:
        """Largest k with base + k·wrench producible [N], by Clarabel; 0 if the base is not."""
        from test_metrics_programs import clarabel_solve, force_columns

        n = self.counts[i]
        bounds, total = self.bounds[i, :n], self.bounds[i, :n].sum()
        contacts = Contacts(
            positions=self.points[i, :n],
            normals_in=self.normals[i, :n],
            friction=self.friction,
            torsion=self.torsion,
            length=self.length,
        )
        A = np.zeros((6 + n, 5 * n + 1))
        A[:6, : 4 * n], A[:6, -1] = force_columns(contacts), -wrench
        A[6:, : 4 * n], A[6:, 4 * n : -1] = np.kron(np.eye(n), np.eye(4)[:1]), np.eye(n)
        c, b = np.zeros(5 * n + 1), np.append(self.base, bounds) / total
        c[-1] = -1.0
        number, _, good = clarabel_solve(c, A, b, [(n, 4), (n + 1, 1)])
        return -number * total if good else 0.0


@pytest.mark.parametrize("seed", range(5))
def test_bounded_contacts_against_clarabel_and_the_twin(seed: int):
    pytest.importorskip("clarabel")
    batch = BoundedBatch(12, seed)
    wrenches = PUSHES if seed % 2 else np.random.default_rng(seed).normal(size=(5, 6))
    kernel = batch.kernel(wrenches)
    found = batch.strengths(kernel)
    floors = 1e-4 * np.where(np.arange(24) < batch.counts[:, None], batch.bounds, 0.0).sum(axis=1)
    for i, floor in enumerate(floors):
        exact = min(batch.reach(i, w / np.linalg.norm(w)) for w in wrenches)
        assert found[i] == pytest.approx(exact, rel=0.01, abs=floor)
        plain = margin_plain(batch.soft_contacts(i), wrenches, batch.base)
        assert found[i] == pytest.approx(plain.strength, rel=0.01, abs=floor)
    assert (found > 1.0).sum() > 3
    # Newtons are newtons: with all forces doubled, the base among them, the results double.
    doubled = batch.strengths(kernel, 2.0, base=2.0 * batch.base)
    np.testing.assert_allclose(doubled, 2.0 * found, rtol=1e-6)
    floor = float(np.median(found[found > 0.0]))
    above = found > floor
    cut = batch.strengths(kernel, most=floor)[above]
    np.testing.assert_allclose(cut, floor, rtol=1e-6)
    assert (cut <= np.float32(floor)).all()
    np.testing.assert_array_equal(batch.strengths(kernel, least=floor)[above], found[above])
    out = kernel(batch.points, batch.normals, batch.counts, batch.length, bounds=batch.bounds)
    np.testing.assert_allclose(out["strength"], found, rtol=0.006, atol=1e-4 * floors.max())
    assert margin_plain(batch.soft_contacts(0), wrenches, batch.base).residual == pytest.approx(
        out["residual"][0], rel=0.01, abs=1e-4
    )


def test_bounded_contacts_against_a_cone():
    pytest.importorskip("clarabel")
    batch, axis = BoundedBatch(8, 4), np.array([0.2, -0.1, 0.9, 0.3, 0.1, -0.2])
    axis /= np.linalg.norm(axis)
    kernel = batch.kernel(axis[None], half_angle=HALF_ANGLE, thorough=True)
    out = kernel(batch.points, batch.normals, batch.counts, batch.length, bounds=batch.bounds)
    assert (out["strength"] > 1.0).sum() > 3
    np.testing.assert_array_equal(batch.strengths(kernel), out["strength"])
    starts = cone_starts(axis, HALF_ANGLE)
    for i, strength in enumerate(out["strength"]):
        if strength > 0.0:
            assert batch.reach(i, out["wrench"][i]) == pytest.approx(strength, rel=0.01)
        assert strength <= 1.01 * min(batch.reach(i, w) for w in starts) + 1e-2


def test_bounded_contacts_by_hand():
    """Two fingers of 10 and 4 N, opposed: what they hold together, sideways and along their line."""
    points, normals = np.zeros((4, 2, 3)), np.zeros((4, 2, 3))
    points[:, :, 0], normals[:, :, 0] = [-0.05, 0.05], [1.0, -1.0]
    bounds = np.array([[10.0, 4.0], [10.0, 0.0], [0.0, 0.0], [np.nan, 4.0]])
    one = MarginKernel(np.eye(6)[2:3], base=np.zeros(6), friction=0.5)
    given = points, normals, np.array([2, 2, 2, 2]), 0.05, np.zeros(3)
    found = one.strengths(*given, bounds=bounds)
    np.testing.assert_allclose(
        found, [4.0, 0.0, 0.0, 0.0], rtol=0.005
    )  # both hold alike, or the object turns
    along = MarginKernel(np.eye(6)[:1], friction=0.5).strengths(*given, bounds=bounds)
    np.testing.assert_allclose(along, [10.0, 10.0, 0.0, 0.0], rtol=0.005)
    for wrong, words in ((-bounds[:2], "at least 0 N"), (bounds[:, :1], "largest normal forces")):
        with pytest.raises(InputError, match=words):
            one(points[:2], normals[:2], [2, 2], 0.05, bounds=wrong)
    many = np.zeros((1, 25, 3))
    with pytest.raises(InputError, match="up to 24 contacts, got 25"):
        one(many, many, [25], 0.05)


def test_the_form_for_many_contacts_gives_the_same_for_few_and_right_for_many():
    batch, many = Batch(40, 7), BoundedBatch(40, 1)
    kernel = MarginKernel(PUSHES, base=0.02 * PUSHES[0], friction=batch.friction, torsion=batch.torsion)
    few = batch.counts, float(np.mean(batch.length)), np.zeros(3)
    alone = kernel.strengths(batch.points, batch.normals, *few)
    points, normals = many.points.copy(), many.normals.copy()
    points[:20, :8], normals[:20, :8] = batch.points[:20], batch.normals[:20]
    counts = np.where(np.arange(40) < 20, batch.counts, many.counts)
    together = kernel.strengths(points, normals, counts, *few[1:])
    np.testing.assert_array_equal(together[:20], alone[:20])
    assert (alone[:20] > 0.0).sum() > 5
    for i in range(20, 30):
        n, ell = counts[i], few[1]
        soft = SoftContacts(points[i, :n] / ell, normals[i, :n], batch.friction, batch.torsion / ell)
        plain = margin_plain(soft, PUSHES, 0.02 * PUSHES[0])
        assert together[i] == pytest.approx(plain.strength, rel=0.006, abs=5e-5)


def test_a_cone_without_width_is_its_axis():
    batch = Batch(40, 3)
    narrow = strengths(batch, PUSHES[2], half_angle=0.0)
    np.testing.assert_allclose(narrow.strength, batch.margins(PUSHES[2:3]).strength, rtol=0.006, atol=5e-5)
    assert (strengths(batch, PUSHES[2]).strength <= narrow.strength * 1.006 + 5e-5).all()


def test_threads_do_not_change_the_results():
    batch = Batch(203, 1)
    one, three = batch.margins(threads=1), batch.margins(threads=3)
    for name in ("residual", "strength", "residual_worst", "strength_worst"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))
    assert (one.residual > 1e-3).any()
    assert (one.strength > 0.1).any()


def test_results_do_not_depend_on_the_neighbours():
    batch = Batch(40, 2)
    all_at_once = batch.margins()
    for i in (0, 7, 39):
        alone = margins(
            batch.points[i : i + 1],
            batch.normals[i : i + 1],
            batch.counts[i : i + 1],
            wrenches=PUSHES,
            friction=batch.friction,
            torsion=batch.torsion,
            length=float(batch.length[i]),
        )
        assert alone.residual[0] == all_at_once.residual[i]
        assert alone.strength[0] == all_at_once.strength[i]


def test_the_bound_ends_only_what_is_above_it():
    batch, bound = Batch(200, 4), 0.05
    full, cut = batch.margins(), batch.margins(bound=bound)
    inside = full.residual <= bound
    assert 20 < inside.sum() < 180
    np.testing.assert_array_equal(cut.residual[inside], full.residual[inside])
    np.testing.assert_array_equal(cut.strength[inside], full.strength[inside])
    over = full.residual > 1.01 * bound
    assert (cut.residual[over] > bound).all()
    assert (cut.residual[over] <= full.residual[over] * 1.001).all()
    assert not cut.strength[over].any()


def test_moving_the_scene_changes_nothing():
    batch, rng = Batch(120, 5), np.random.default_rng(0)
    q = rng.normal(size=4)
    R, away = rotation_from_quaternion(q / np.linalg.norm(q)), np.array([0.3, -0.2, 0.4])
    turned = np.concatenate([PUSHES[:, :3] @ R.T, PUSHES[:, 3:]], axis=1)
    before = batch.margins()
    batch.points, batch.normals = batch.points @ R.T + away, batch.normals @ R.T
    after = batch.margins(turned, reference=away)
    np.testing.assert_allclose(after.residual, before.residual, rtol=0.006, atol=1e-5)
    np.testing.assert_allclose(after.strength, before.strength, rtol=0.008, atol=5e-5)


def two_opposed(friction: float, torsion: float = 0.0, wrenches: Array = PUSHES) -> Margins:
    points, normals = np.zeros((1, 8, 3)), np.zeros((1, 8, 3))
    points[0, :2, 0], normals[0, :2, 0] = [-0.05, 0.05], [1.0, -1.0]
    return margins(points, normals, [2], wrenches=wrenches, friction=friction, torsion=torsion, length=0.05)


@pytest.mark.parametrize("friction", [0.05, 0.2, 0.6])
def test_two_opposed_fingers_by_hand(friction: float):
    found = two_opposed(friction)
    assert found.strength[0] == pytest.approx(friction, rel=0.004)
    assert found.strength_worst[0] in (1, 2, 4, 5)
    # Both fingers push up with μ in all; what of the 0.1 they cannot hold is missing.
    assert found.residual[0] == pytest.approx(max(0.1 - friction, 0.0), rel=0.004, abs=5e-6)
    # A twist about the line through hard fingers is held by nothing, through soft ones by γ/ℓ.
    twist = np.array([[0, 0, 0, 1.0, 0, 0], [0, 0, 0, -1.0, 0, 0]])
    assert two_opposed(friction, wrenches=twist).strength[0] == 0.0
    assert two_opposed(friction, wrenches=twist).residual[0] == pytest.approx(1.0, rel=0.004)
    assert two_opposed(friction, 0.01, twist).strength[0] == pytest.approx(0.2, rel=0.004)
    assert two_opposed(friction, 0.01, 0.5 * twist).residual[0] == pytest.approx(0.3, rel=0.004)


def test_few_contacts_by_hand():
    points, normals = np.zeros((3, 8, 3)), np.zeros((3, 8, 3))
    normals[:, :, 0] = 1.0
    found = margins(points, normals, [0, 1, 8], wrenches=PUSHES, friction=0.5, length=0.05)
    assert found.residual[0] == math.inf
    assert found.residual_worst[0] == found.strength_worst[0] == -1
    # One contact, or eight in the same place, that push along +x with 1: -x is missed by 1.1.
    np.testing.assert_allclose(found.residual[1:], 1.1, rtol=1e-5)
    assert (found.residual_worst[1:] == 3).all()
    np.testing.assert_array_equal(found.strength, 0.0)
    # The only wrench that one contact has to spare.
    found = margins(points, normals, [0, 1, 8], wrenches=[PUSHES[0]], friction=0.5, length=0.05)
    np.testing.assert_allclose(found.strength, [0.0, 1.0, 1.0], rtol=0.004)


def test_a_base_that_is_not_held_leaves_no_strength():
    batch = Batch(60, 7)
    found = batch.margins(base=[0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
    assert not found.strength.any()
    assert (found.residual > 1.0).all()


@pytest.mark.parametrize("friction", [0.0, 1e-6, 0.3, 50.0])
@pytest.mark.parametrize("torsion", [0.0, 1.0])
def test_never_a_number_that_is_none(friction: float, torsion: float):
    batch = Batch(300, 11)
    rng = np.random.default_rng(0)
    batch.points[::7] *= rng.choice([1e-6, 1e3])
    batch.normals[::11] = batch.normals[::11, :1]
    batch.normals[::13] = 0.0
    batch.friction, batch.torsion = friction, torsion
    wrenches = np.concatenate([PUSHES, np.zeros((1, 6)), 1e-7 * np.eye(6), 1e4 * np.eye(6)])
    for base in (None, [0.0, 0.0, 0.05, 0.0, 0.0, 0.0]):
        found = batch.margins(wrenches, base=base)
        for array in (found.residual, found.strength):
            assert np.isfinite(array).all()
            assert (array >= 0.0).all()
        assert np.isfinite(strengths(batch, np.ones(6), base=base).strength).all()


def test_a_contact_that_is_not_finite_gives_no_strength_and_changes_no_other():
    batch = Batch(64, 8)
    kernel = MarginKernel(PUSHES, friction=batch.friction, torsion=batch.torsion, threads=2)
    points = batch.points + 1.0
    points[3, 0, 1] = math.nan  # what a kernel before this one may leave behind
    given = batch.normals, batch.counts, batch.length, np.ones(3)
    found = kernel.strengths(points, *given)  # type: ignore[arg-type]
    expected = batch.margins().strength
    rest = np.arange(64) != 3
    np.testing.assert_allclose(found[rest], expected[rest], rtol=0.008, atol=5e-5)
    assert found[3] == 0.0


def test_no_candidates():
    assert (
        len(margins(np.zeros((0, 8, 3)), np.zeros((0, 8, 3)), [], wrenches=PUSHES, friction=0.5, length=1.0))
        == 0
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wrenches": np.zeros((0, 6))}, "1 to 32 wrenches"),
        ({"wrenches": np.zeros((33, 6))}, "1 to 32 wrenches"),
        ({"wrenches": np.zeros((2, 5))}, "wrenches asked for must be n×6"),
        ({"base": np.zeros(3)}, "base wrench must be 6"),
        ({"friction": -0.1}, "friction must be"),
        ({"torsion": math.nan}, "torsional friction must be"),
        ({"length": 0.0}, "lengths must be positive"),
        ({"length": [0.1]}, "lengths must be 2"),
        ({"bound": math.nan}, "bound"),
        ({"device": "cuda:99"}, "no device 'cuda:99' here; known: cpu"),
        ({"counts": [1, 9]}, "whole and 0..8"),
        ({"counts": [1, 1.5]}, "whole and 0..8"),
        ({"points": np.full((2, 8, 3), math.nan)}, "contact points must be finite"),
        ({"normals_in": np.zeros((3, 8, 3))}, "contact normals must be 2×8×3"),
    ],
)
def test_bad_input(change: dict[str, object], message: str):
    given: dict[str, object] = {
        "points": np.zeros((2, 8, 3)),
        "normals_in": np.zeros((2, 8, 3)),
        "counts": [1, 1],
        "wrenches": PUSHES,
        "friction": 0.5,
        "length": 0.1,
    }
    with pytest.raises(InputError, match=message):
        margins(**(given | change))  # type: ignore[arg-type]


def test_bad_cones():
    batch = Batch(2, 0)
    with pytest.raises(InputError, match="not six zeros"):
        strengths(batch, np.zeros(6))
    with pytest.raises(InputError, match="half-angle"):
        strengths(batch, np.ones(6), half_angle=2.0)
