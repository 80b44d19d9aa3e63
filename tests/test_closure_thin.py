"""Thin and flat objects: pinches of a hand, patches of an object, hands put there, and pieces that fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from preshape.closure.candidates import (
    DrawnCandidates,
    RankedCandidates,
    Region,
    concatenated,
    draw_candidates,
    quaternions,
)
from preshape.closure.demand import Demand
from preshape.closure.finish import Finisher, FinishOptions
from preshape.closure.hand_pinches import FACING, WIDTHS, Pinches, finger_sets, hand_pinches
from preshape.closure.hand_tables import hand_tables
from preshape.closure.pinching import NEAR, ROOM, AntipodalPatches, Pincher, alternating, antipodal_patches
from preshape.closure.preshapes import preshapes
from preshape.closure.search import ClosureSearch
from preshape.closure.settings import ClosureSettings
from preshape.hands.load import load_hand
from preshape.hiis.planes import APPROACH_AXES, OPPOSITION_AXES
from preshape.kernels.chains import rotations
from preshape.kernels.closing.host import Candidates, ClosingKernel, Fate
from preshape.kernels.field.host import SurfaceQuery, prepare_field
from preshape.kernels.fitting.host import PatchRows, PinchPlacements
from preshape.kernels.fitting.plain import between, fits_plain, frames, place_plain
from preshape.objects.load import load_object
from preshape.objects.mesh import TriangleMesh
from preshape.physics import pieces as pieces_module
from preshape.physics.pieces import COARSE, FILLED, FINE, FINER, ConvexPieces, decompose, filled_share

HANDS = ("shadow", "allegro", "leap")
WIDE = 0.004


def slab(x: float, y: float, z: float, turned: bool = False) -> TriangleMesh:
    """A box of these edges [m]; every second triangle the wrong way round, if so wished."""
    box = load_object("box")
    triangles = np.array(box.triangles)
    if turned:
        triangles[::2] = triangles[::2, ::-1]
    return TriangleMesh(name="slab", vertices=box.vertices / box.extents * [x, y, z], triangles=triangles)


def lidded(mesh: TriangleMesh, axis: int, signs: tuple[float, ...] = (-1.0, 1.0)) -> TriangleMesh:
    """The mesh with its faces along this axis, of these sides, as lids."""
    lid = np.isin(mesh.normals[:, axis].round(6), signs)
    triangles = np.concatenate([mesh.triangles[~lid], mesh.triangles[lid]])
    return replace(mesh, triangles=triangles, lids=int(lid.sum()))


@pytest.fixture(scope="module")
def strip() -> TriangleMesh:
    return slab(0.12, 0.03, 0.003)


def patches_of(mesh: TriangleMesh, pinches: Pinches) -> AntipodalPatches:
    return antipodal_patches(mesh, prepare_field(mesh), float(pinches.tip[0]), pinches.widest)


@pytest.mark.parametrize("name", HANDS)
class TestPinches:
    def test_they_are_what_they_say(self, name: str) -> None:
        hand = load_hand(name)
        pinches = hand_pinches(hand)
        counts = np.histogram(pinches.width, WIDTHS)[0]
        assert (counts >= 10).all(), counts
        assert (np.diff(pinches.width) >= 0).all()
        used = np.isfinite(pinches.pads).all(axis=2)
        assert (used.sum(axis=1) == pinches.fingers).all()
        assert ((used << np.arange(used.shape[1])).sum(axis=1) == pinches.mask).all()
        np.testing.assert_allclose(np.linalg.norm(pinches.opposition, axis=1), 1.0, atol=1e-9)
        thumb = hand_tables(hand).thumb
        np.testing.assert_allclose(pinches.pads[:, thumb], pinches.thumb)
        # The fingers stand in one plane across the opposition; the thumb's pad is a width away from it.
        depth = np.einsum("nfi,ni->nf", pinches.thumb[:, None] - pinches.pads, pinches.opposition)
        others = np.delete(np.where(used, depth, pinches.width[:, None]), thumb, axis=1)
        assert np.abs(others - pinches.width[:, None]).max() < 1e-3
        rate = np.einsum("ni,ni->n", pinches.thumb_rate - pinches.others_rate, pinches.opposition)
        np.testing.assert_allclose(rate, 1.0, atol=1e-6)
        assert np.linalg.norm(pinches.thumb_rate, axis=1).max() <= 0.5 / FACING + 1e-6

    def test_a_small_plate_between_the_pads_is_met_there(self, name: str) -> None:
        """Closed by the kernel, thumb and finger touch where the pinch says, whatever its width."""
        hand = load_hand(name)
        pinches = hand_pinches(hand)
        rows = np.flatnonzero((pinches.fingers == 2) & (np.abs(pinches.width - WIDE) < 0.003))
        middle, opposition = between(pinches.rows, rows, np.full(len(rows), WIDE))
        turn = frames(np.tile([0.0, 0, 1], (len(rows), 1)), np.tile([1.0, 0, 0], (len(rows), 1)))
        turn = turn @ frames(opposition, np.tile([0.3, -0.5, 0.8], (len(rows), 1))).transpose(0, 2, 1)
        place = -np.einsum("nij,nj->ni", turn, middle)
        field = prepare_field(slab(0.014, 0.014, WIDE), cache=None)
        kernel = ClosingKernel(hand_tables(hand), field)
        closed = kernel.close(
            Candidates(
                place=place, turn=quaternions(turn), start=pinches.start[rows], mask=pinches.mask[rows]
            ),
            wanted=2,
        )
        good = closed.fate == Fate.CLOSED
        assert good.mean() > 0.8
        # The thumb on +z, the finger on -z, and next to no way between them along the plate.
        assert (closed.normals_in[good, 0, 2] < -0.9).mean() > 0.9
        aside = np.linalg.norm(closed.points[good, 0, :2] - closed.points[good, 1, :2], axis=1)
        # A flat pad touches anywhere on its face; LEAP's is 8 mm wide.
        assert np.median(aside) < (0.004 if name == "leap" else 0.0007)


def test_sets_of_fingers() -> None:
    assert finger_sets(3, 0) == [0b011, 0b101, 0b111]
    assert all(mask >> 4 & 1 for mask in finger_sets(5, 4))
    assert len(finger_sets(5, 4)) == 4 + 3 + 2 + 1


class TestSpots:
    @pytest.mark.parametrize("turned", [False, True])
    def test_of_a_strip(self, turned: bool) -> None:
        mesh = slab(0.12, 0.03, 0.003, turned)
        patches = antipodal_patches(mesh, prepare_field(mesh, cache=None), 0.008, 0.05)
        flat = np.abs(patches.normal[:, 2]) > 0.999
        assert 0.85 < flat.mean() < 1.0
        np.testing.assert_allclose(patches.width[flat], 0.003, atol=1e-6)
        np.testing.assert_allclose(patches.middle[flat, 2], 0.0, atol=1e-6)
        assert {*np.sign(patches.normal[flat, 2])} == {-1.0, 1.0}
        # Its ends are too far apart for the hand, its long sides are not.
        np.testing.assert_allclose(patches.width[~flat], 0.03, atol=1e-6)
        np.testing.assert_allclose(np.abs(patches.normal[~flat, 1]), 1.0, atol=1e-6)

    def test_only_where_fingertips_have_room(self) -> None:
        """A closed shell has walls that no finger comes behind."""
        outer, inner = slab(0.05, 0.05, 0.05), slab(0.044, 0.044, 0.044)
        shell = TriangleMesh(
            name="shell",
            vertices=np.concatenate([outer.vertices, inner.vertices]),
            triangles=np.concatenate([outer.triangles, inner.triangles[:, ::-1] + len(outer.vertices)]),
        )
        field = prepare_field(shell, cache=None)
        assert len(antipodal_patches(shell, field, 0.005, 0.04))
        patches = antipodal_patches(shell, field, 0.03, 0.04)
        assert not len(patches)

    def test_none_on_a_lid(self) -> None:
        """The flat sides of a strip as lids: only the narrow sides remain."""
        mesh = lidded(slab(0.12, 0.03, 0.003), 2)
        patches = antipodal_patches(mesh, prepare_field(mesh, cache=None), 0.008, 0.05)
        assert len(patches)
        np.testing.assert_allclose(np.abs(patches.normal[:, 1]), 1.0, atol=1e-6)


@pytest.mark.parametrize("name", HANDS)
class TestPinched:
    def drawn(self, name: str, mesh: TriangleMesh, count: int, **where: object) -> DrawnCandidates:
        return pincher(name, mesh).draw(np.random.default_rng(3), count, Region(**where))  # type: ignore[arg-type]

    def test_as_asked(self, name: str, strip: TriangleMesh) -> None:
        first = self.drawn(name, strip, 200, planes=[2, 7], flips=[True], values=[0.0], fingers=[2, 3])
        again = self.drawn(name, strip, 200, planes=[2, 7], flips=[True], values=[0.0], fingers=[2, 3])
        np.testing.assert_array_equal(first.candidates.place, again.candidates.place)
        assert {*first.plane} <= {2, 7}
        assert first.flip.all()
        assert np.abs(first.value).max() <= 0.2
        fingers = np.array([mask.bit_count() for mask in first.candidates.mask.tolist()])
        assert {*fingers} <= {2, 3}

    def test_the_thumb_is_on_its_side(self, name: str, strip: TriangleMesh) -> None:
        found = self.drawn(name, strip, 300)
        search = searched(name, strip)
        closed = search.kernel.close(found.candidates, wanted=2)
        rows = np.flatnonzero(closed.fate == Fate.CLOSED)
        side = np.where(found.flip[:, None], -1, 1) * OPPOSITION_AXES[found.plane - 1]
        inward = np.einsum("ni,ni->n", closed.normals_in[rows, 0], side[rows])
        assert (inward < 0).mean() > 0.9
        assert (np.einsum("ni,ni->n", APPROACH_AXES[found.plane - 1], side) == 0).all()

    def test_far_more_of_them_hold_a_thin_thing(self, name: str, strip: TriangleMesh) -> None:
        search, hand = searched(name, strip), load_hand(name)
        pinching = self.drawn(name, strip, 600)
        assert len(pinching.plane) > 300
        anywhere = draw_candidates(
            np.random.default_rng(3), preshapes(hand), strip.cog, strip.extents / 2, 600, Region()
        )

        def holding(drawn: DrawnCandidates) -> float:
            return float((search.evaluate(drawn, Demand()).hold > 0).sum() / len(drawn.plane))

        assert holding(pinching) > 0.15
        assert holding(pinching) > 8 * holding(anywhere)

    def test_nothing_to_pinch(self, name: str) -> None:
        """A ball larger than the hand: no candidates, and no failure."""
        ball = load_object("sphere", scale=4.0)
        assert len(self.drawn(name, ball, 50).plane) == 0


@pytest.mark.parametrize("name", HANDS)
class TestFitting:
    def test_as_the_plain_version(self, name: str, strip: TriangleMesh) -> None:
        one = pincher(name, strip)
        p, rng, n = one.pinches, np.random.default_rng(5), 2000
        plane = rng.integers(12, size=n)
        placements = PinchPlacements(
            pick=rng.integers(len(p), size=n),
            patch=rng.integers(len(one.patches), size=n),
            approach=APPROACH_AXES[plane],
            side=rng.choice([-1.0, 1.0], size=n)[:, None] * OPPOSITION_AXES[plane],
            tilt=rng.uniform(0.0, 1.2, n),
            off=rng.normal(0.0, [0.4, 0.02, 0.02, 0.02], (n, 4)),
        )
        normal = one.patches.normal
        # Faces across the approach: the frame that the fingers stand in is all rounding.
        placements = PinchPlacements(
            *(
                rows[np.abs((normal[placements.patch] * placements.approach).sum(axis=1)) < 0.99]
                for rows in placements
            )
        )
        fit, place, turn = one.kernel.place(placements)
        patches = PatchRows(one.patches.middle, normal, one.patches.width)
        at, facing = place_plain(p.rows, patches, placements)
        plain = fits_plain(
            prepare_field(strip),
            p.palm,
            p.mask[placements.pick],
            p.pads[placements.pick],
            p.open[placements.pick],
            at,
            facing,
            near=NEAR,
            room=ROOM,
        )
        assert 0.02 < plain.mean() < 0.9
        np.testing.assert_allclose(place, at[fit], atol=2e-6)
        np.testing.assert_allclose(rotations(turn), facing[fit], atol=1e-5)
        # Where a sphere just touches its limit, single precision may say otherwise.
        differ = np.setxor1d(fit, np.flatnonzero(plain))
        assert len(differ) <= 0.002 * n


def pincher(name: str, mesh: TriangleMesh) -> Pincher:
    pinches = hand_pinches(load_hand(name))
    kernel = searched(name, mesh).kernel
    return Pincher(pinches, patches_of(mesh, pinches), mesh.cog, mesh.extents / 2, kernel)


def searched(name: str, mesh: TriangleMesh) -> ClosureSearch:
    field = prepare_field(mesh)
    return ClosureSearch(load_hand(name), field, mesh.cog, float(mesh.extents.max()) / 2, ClosureSettings())


def test_closed_hands_do_not_stand_on_lids() -> None:
    """In the search, and in the finished grips even if the search did not look, nearest misses included."""
    mesh = lidded(slab(0.05, 0.05, 0.07), 0, (1.0,))
    field, query = prepare_field(mesh, cache=None), SurfaceQuery(mesh)
    hand, demand = load_hand("allegro"), Demand()
    blind, search = (
        ClosureSearch(hand, field, mesh.cog, 0.035, ClosureSettings(), query=each) for each in (None, query)
    )
    drawn = draw_candidates(np.random.default_rng(0), search.pool, mesh.cog, mesh.extents / 2, 1500, Region())

    def on_lid(found: RankedCandidates) -> np.ndarray:
        c = found.closings
        return np.array(
            [
                mesh.is_lid[query.closest(p[:n]).triangle].any()
                for p, n in zip(c.points, c.counts, strict=True)
            ]
        )

    every, found = blind.evaluate(drawn, demand), search.evaluate(drawn, demand)
    touching = on_lid(every)
    assert 0 < touching.sum() < len(every)
    assert len(found) == (~touching).sum() > 0
    assert not on_lid(found).any()
    wrong = every.take(np.flatnonzero(touching)[:40])
    options = FinishOptions(count=40, anyway=True)
    grips = Finisher(blind, query).finish(wrong, demand, options)
    assert not any(mesh.is_lid[query.closest(grip.points).triangle].any() for grip in grips)
    bare = replace(mesh, lids=0)  # the same solid, all of which can be touched
    assert len(Finisher(blind, SurfaceQuery(bare)).finish(wrong, demand, options)) > len(grips)


@pytest.mark.parametrize("cells", [None, 64])
def test_contacts_of_a_long_thin_plate_press_into_it(cells: int | None) -> None:
    """With 64 cells along a metre, fingertips sink through 4 mm: such contacts are dropped, not inverted."""
    mesh = slab(0.03, 0.004, 1.0)
    field, query = prepare_field(mesh, cells=cells, cache=None), SurfaceQuery(mesh)
    hand = load_hand("shadow")
    pinches = hand_pinches(hand)
    search = ClosureSearch(hand, field, mesh.cog, 0.5, ClosureSettings())
    patches = antipodal_patches(mesh, field, float(pinches.tip[0]), pinches.widest)
    rng, region = np.random.default_rng(0), Region()
    drawn = concatenated(
        Pincher(pinches, patches, mesh.cog, mesh.extents / 2, search.kernel).draw(rng, 300, region),
        draw_candidates(rng, search.pool, mesh.cog, mesh.extents / 2, 3000, region),
    )
    finisher = Finisher(search, query)
    found = search.evaluate(drawn, Demand())
    hands = finisher.closed(found.drawn)
    used = (np.arange(hands.points.shape[1]) < hands.counts[:, None]) & hands.real[:, None]
    points, normals = hands.points, hands.normals_in
    # A point a little back along an inward normal is outside the plate.
    assert used.any()
    assert (query.closest(points[used] - 1e-4 * normals[used]).distance > 0.0).all()
    sunk = ~hands.real[hands.counts > 0]
    assert sunk.mean() == 0.0 if cells is None else sunk.mean() > 0.2


def test_only_long_thin_objects_get_more_cells() -> None:
    """No object of the usual size changes; a metre of plate is resolved, at no more nodes than a cube's."""
    for size, spacing in (((0.16, 0.16, 0.16), 0.2 / 63), ((0.02, 0.02, 0.2), 0.24 / 63)):
        assert prepare_field(slab(*size), cache=None).spacing == pytest.approx(spacing, rel=1e-9)
    assert prepare_field(slab(0.9, 0.9, 0.9), cache=None).distance.shape == (64, 64, 64)
    plate = prepare_field(slab(0.03, 0.004, 1.0), cache=None)
    assert plate.spacing == pytest.approx(0.004, rel=0.01)
    assert plate.distance.size < 64**3


def test_rows_in_turn() -> None:
    assert alternating(np.array([2, 2, 2, 3, 3])).tolist() == [0, 3, 1, 4, 2]
    assert alternating(np.array([], dtype=np.int64)).tolist() == []


def test_frames_are_rotations() -> None:
    rng = np.random.default_rng(0)
    first = rng.normal(size=(20, 3))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = rng.normal(size=(20, 3))
    R = frames(first, second)
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (20, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    np.testing.assert_allclose(R[:, :, 0], first)
    assert (np.einsum("ni,ni->n", R[:, :, 1], second) > 0).all()


class TestPieces:
    def test_share_that_is_filled(self) -> None:
        cube = load_object("cube")
        corners = np.array(cube.vertices)
        exact = ConvexPieces(name="cube", pieces=(corners,))
        assert filled_share(cube, exact) < 0.001
        double = ConvexPieces(name="cube", pieces=(corners * [2, 1, 1],))
        assert filled_share(cube, double) == pytest.approx(0.5, abs=0.03)
        beside = ConvexPieces(name="cube", pieces=(corners, corners + np.array([0.1, 0, 0])))
        assert filled_share(cube, beside) == pytest.approx(0.5, abs=0.01)

    @pytest.mark.parametrize(
        ("factor", "then"), [(1.0, []), (1.015, []), (1.08, [FINER]), (2.0, [FINE])], ids=str
    )
    def test_cut_finer_only_where_the_pieces_stand_out(
        self, factor: float, then: list[float], tmp_path, monkeypatch
    ) -> None:
        cube = load_object("cube")
        asked: list[float] = []

        def cut(mesh: TriangleMesh, threshold: float) -> tuple[np.ndarray, ...]:
            asked.append(threshold)
            return (np.array(mesh.vertices) * [factor if threshold == COARSE else 1.0, 1, 1],)

        monkeypatch.setattr(pieces_module, "_cut", cut)
        made = decompose(cube, cache=tmp_path)
        assert asked == [COARSE, *then]
        assert filled_share(cube, made) < FILLED
        assert decompose(cube, cache=tmp_path).digest == made.digest
        assert len(asked) <= 2
        # What is asked for by number is not second-guessed, and is another entry of the cache.
        coarse = decompose(cube, threshold=COARSE, cache=tmp_path)
        assert coarse.volume == pytest.approx(factor * cube.volume, rel=1e-6)
