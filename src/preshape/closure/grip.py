"""From a candidate to a grip: exact contacts, squeeze, pregrasp, and a way in that is free (ENGINE §2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..analyser import Grip
from ..hands.kinematics import HandKinematics, cross
from ..kernels.chains import joint_frames, rotations
from ..kernels.closing import Candidates, ClosingKernel, Closings, Fate
from ..kernels.field import SurfaceQuery
from ..kernels.hand_spheres import FINE
from ..planes import APPROACH_AXES, OPPOSITION_AXES
from ..types import Array, value
from .compliance import turn_when_beside
from .hand_tables import hand_tables
from .opening import ALONG, NEAREST, OPENING, Opener, Openings
from .preshapes import posture_at
from .search import ClosureSearch, Demand, Ranked

GAP = 0.0001
"""How far from the surface a finger stops in an answer [m] [C]."""
DEEPEST = 0.0007
"""Deeper than this nothing may be in the object [m] [C]."""
UNBALANCED = 0.03
"""Forces of a squeeze may leave this share of the press unbalanced, torques over ℓ."""
SPARE = 2
"""So many more candidates than grips wanted are looked at side by side: some will not do."""
EVENNESS = 0.1
"""Weight of an even spread of the forces, against ten for their balance [C]."""
EDGES = 8
"""Of a friction cone, where forces are chosen."""
SOFT, TOO_SOFT = float(np.radians(1.0)), float(np.radians(10.0))
"""Where an object turns by the first when the forces are a little beside, what its grip has to spare counts
half; where by the second and stiffer grips may be found elsewhere, all of its margin does [C]."""


@value
class Finished:
    """A grip, the candidate that it came from, and its contacts.

    Attributes:
        grip: the hand.
        row: of the candidate.
        plane: the approach plane that the way in belongs to, 1..12.
        flip: thumb on that plane's -o side.
        points: (n, 3) contacts, the thumb's first [m].
        normals_in: (n, 3) inward unit normals.
        margin: largest load that the strongest squeeze can balance, over the load expected.
    """

    grip: Grip
    row: int
    plane: int
    flip: bool
    points: Array
    normals_in: Array
    margin: float = 0.0


class Finisher:
    """Makes grips of candidates.

    Args:
        search: the search that found them.
        query: the object's exact surface.
    """

    def __init__(self, search: ClosureSearch, query: SurfaceQuery) -> None:
        self.search, self.query = search, query
        self.unbalanced = UNBALANCED
        self.hand, self.settings = search.hand, search.settings
        self.tables = hand_tables(search.hand, FINE)
        self.kernel = ClosingKernel(
            self.tables, search.field, device=self.settings.device, threads=self.settings.threads
        )
        self.opener = Opener(self.tables, self.kernel, HandKinematics(search.hand), self.settings.obstacles)
        joints = list(search.hand.joints)
        self._couples = [(joints.index(a), joints.index(b)) for a, b in search.hand.couplings]
        # One drive sets the sum of a couple's angles: each of the two takes half of what it is told.
        self._sharing = np.ones(len(joints))
        self._sharing[[k for couple in self._couples for k in couple]] = 2.0

    def close(self, found: Ranked, wanted: int) -> Closings:
        """Closed again with the fine spheres, a little off the surface."""
        return self.kernel.close(
            found.sampled.candidates, wanted=wanted, clearance=GAP, palm_clearance=NEAREST, tolerance=5e-5
        )

    def contacts(
        self, candidates: Candidates, closings: Closings, frames: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """(n, f, 3), (n, f, 3) exact contact points and inward normals by finger; NaN where not in use."""
        n, f = closings.sphere.shape
        places, turns = frames
        R = rotations(candidates.turn)
        points, normals = np.full((n, f, 3), np.nan), np.full((n, f, 3), np.nan)
        rows, fingers = np.nonzero(closings.sphere >= 0)
        if len(rows):
            spheres = closings.sphere[rows, fingers]
            joints = np.searchsorted(self.tables.sphere_start, spheres, side="right") - 1
            local = np.einsum("nij,nj->ni", turns[rows, joints], self.tables.sphere[spheres, :3])
            centres = candidates.place[rows] + np.einsum("nij,nj->ni", R[rows], places[rows, joints] + local)
            points[rows, fingers] = near = self.query.closest(centres).point
            # From the sphere's centre to the surface: on an edge this, not a face, is the contact's normal.
            inward = near - centres
            normals[rows, fingers] = inward / np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-9)
        return points, normals

    def finish(
        self,
        found: Ranked,
        demand: Demand,
        *,
        wanted: int = 3,
        enough: int = 1,
        planes: Sequence[int] = tuple(range(1, 13)),
        elsewhere: bool = False,
    ) -> list[Finished]:
        """The grips that the candidates turn into, in their order; what cannot be executed is left out.

        Args:
            found: candidates, a few dozen at most.
            demand: what the grip is asked for.
            wanted: contacts that it must have.
            enough: how many grips are wanted; candidates after that are not looked at.
            planes: approach planes that the way in may belong to.
            elsewhere: there is more to be looked at, so a soft grip is worth less.
        """
        if not len(found):
            return []
        candidates, obstacles = found.sampled.candidates, self.settings.obstacles
        closings = self.close(found, wanted)
        grasp = posture_at(self.tables, candidates.start, closings.closing)
        frames = joint_frames(self.tables, grasp)
        points, normals = self.contacts(candidates, closings, frames)
        packed = self._packed(closings, points, normals)
        task, hold = self.search.strengths(packed, demand)
        score = self.search.score(task, hold, demand)
        to_object, to_rest = self.kernel.clearances(
            candidates.place, candidates.turn, grasp, obstacles, enough=OPENING
        )
        sound = (closings.fate == Fate.CLOSED) & (to_object.min(axis=1) > -DEEPEST)
        sound &= (to_rest > 0) & (score > 0)
        rows, grips = np.flatnonzero(sound), list[Finished]()
        each = enough + SPARE
        for some in (rows[first : first + each] for first in range(0, len(rows), each)):
            free = some[[self.opener.free_of_itself(grasp[row]) for row in some]]
            ways = self.opener.find(candidates, closings.closing, free, found.sampled.plane, planes)
            surely = np.zeros(0)
            for k, row in enumerate(ways.row):
                if k == len(surely):  # as many as are still wanted, side by side
                    some_more = packed.take(ways.row[k : k + enough - len(grips)])
                    surely = np.append(surely, self.search.surely(some_more, demand))
                margins = float(surely[k]) / demand.load, float(hold[row]) / self.settings.hold
                where = frames[0][row], frames[1][row]
                made = self._grip(
                    found, int(row), packed, grasp[row], where, ways, k, margins, planes, elsewhere
                )
                if made is not None:
                    grips.append(made)
                if len(grips) == enough:
                    return grips
        return grips

    def _packed(self, closings: Closings, points: Array, normals: Array) -> Closings:
        """The closings with exact contacts, the thumb's first."""
        order = self._finger_order()
        used = closings.sphere[:, order] >= 0
        place = np.argsort(~used, axis=1, kind="stable")
        P = np.take_along_axis(points[:, order], place[:, :, None], axis=1)
        N = np.take_along_axis(normals[:, order], place[:, :, None], axis=1)
        full_p, full_n = np.zeros_like(closings.points), np.zeros_like(closings.normals_in)
        f = P.shape[1]
        full_p[:, :f], full_n[:, :f] = np.nan_to_num(P), np.nan_to_num(N)
        counts = np.where(closings.fate == Fate.CLOSED, used.sum(axis=1), 0).astype(np.int64)
        return replace(closings, points=full_p, normals_in=full_n, counts=counts)

    def _finger_order(self) -> list[int]:
        """The thumb, then the others: the order of contacts."""
        t = self.tables.thumb
        return [t, *(f for f in range(len(self.tables.fingers)) if f != t)]

    def _grip(
        self,
        found: Ranked,
        row: int,
        packed: Closings,
        q: Array,
        frames: tuple[Array, Array],
        ways: Openings,
        k: int,
        margins: tuple[float, float],
        planes: Sequence[int],
        elsewhere: bool,
    ) -> Finished | None:
        candidates, settings = found.sampled.candidates, self.settings
        n = int(packed.counts[row])
        points = packed.points[row, :n].astype(np.float64)
        normals = packed.normals_in[row, :n].astype(np.float64)
        used = [f for f in self._finger_order() if packed.sphere[row, f] >= 0]
        arms = (points - self.search.cog) / self.search.length
        share = grip_forces(arms, normals, settings.mu)
        left = np.concatenate([share.sum(axis=0), cross(arms, share).sum(axis=0)])
        if np.linalg.norm(left) > self.unbalanced:
            return None
        jacobians, chains = self._jacobians(candidates, packed, row, frames, used, points)
        torques = self._torques(jacobians, chains, share)
        # A joint that would be too weak for the whole squeeze makes it weaker.
        strain = float((np.abs(torques) / self.hand.torque_limits).max())
        most = min(settings.press_most, 1.0 / max(strain, 1e-9))
        needed = settings.safety * settings.weight / max(min(margins), 1e-9)
        press = min(max(settings.press_least, needed), most)
        # A target beyond a joint's limit is meant: a servo that stops at the limit would press with nothing.
        yielding = 1.0 / (self.hand.gains * self._sharing)
        squeeze = q + press * torques * yielding
        turn = turn_when_beside(
            points - self.search.cog, normals, press * share, jacobians, [yielding[chain] for chain in chains]
        )
        margin = min(margins) * most / settings.weight
        grip = Grip(
            approach=ways.approach[k],
            palm_pose=np.concatenate([candidates.place[row], candidates.turn[row]]),
            start=candidates.start[row],
            mask=int(candidates.mask[row]),
            pregrasp=ways.pregrasp[k],
            grasp=q,
            squeeze=squeeze,
            fingers=tuple(self.tables.fingers[f] for f in used),
            forces=press * share,
            torques=press * torques,
            task_margin=margins[0] * press / settings.weight,
            hold_margin=margins[1] * press / settings.weight,
            quality=quality(margin, turn, elsewhere=elsewhere),
            clearance=float(ways.clearance[k]),
        )
        number, flip = counted_to(ways.approach[k], points, int(found.sampled.plane[row]), planes)
        return Finished(
            grip=grip, row=row, plane=number, flip=flip, points=points, normals_in=normals, margin=margin
        )

    def _jacobians(
        self,
        candidates: Candidates,
        packed: Closings,
        row: int,
        frames: tuple[Array, Array],
        used: list[int],
        points: Array,
    ) -> tuple[list[Array], list[slice]]:
        """For each contact (6, k) its motion by the joints behind it, and which of the hand's these are."""
        places, turns = frames
        R = rotations(candidates.turn[row])
        anchors = candidates.place[row] + places @ R.T
        axes = np.einsum("ij,njk,nk->ni", R, turns, self.tables.axis)
        touching = np.searchsorted(self.tables.sphere_start, packed.sphere[row], side="right") - 1
        chains = [slice(int(self.tables.joint_start[f]), int(touching[f]) + 1) for f in used]
        return [
            np.concatenate([cross(axes[chain], point - anchors[chain]).T, axes[chain].T])
            for chain, point in zip(chains, points, strict=True)
        ], chains

    def _torques(self, jacobians: list[Array], chains: list[slice], forces: Array) -> Array:
        """(j,) joint torques that make the contact forces (n, 3), Jᵀ f."""
        torques = np.zeros(len(self.hand.joints))
        for J, chain, force in zip(jacobians, chains, forces, strict=True):
            torques[chain] = force @ J[:3]
        # One tendon: the same torque on both, the nearest to what each should have.
        for a, b in self._couples:
            torques[[a, b]] = (torques[a] + torques[b]) / 2
        return torques


def counted_to(approach: Array, points: Array, own: int, planes: Sequence[int]) -> tuple[int, bool]:
    """The approach plane that a grip belongs to, and whether its thumb stands on the -o side.

    The plane that it was drawn for, where the hand comes along its axis; else the one, of those allowed,
    whose approach axis the way in follows and along whose opposition axis the thumb stands.

    Args:
        approach: (3,) unit vector of the way in.
        points: (n, 3) contacts, the thumb's first.
        own: the plane that it was drawn for.
        planes: those allowed.
    """
    thumb = points[0] - points[1:].mean(axis=0)
    thumb = thumb / max(float(np.linalg.norm(thumb)), 1e-9)
    number = own
    if APPROACH_AXES[own - 1] @ approach < ALONG:
        allowed = np.asarray(planes)
        along = APPROACH_AXES[allowed - 1] @ approach
        fit = np.abs(OPPOSITION_AXES[allowed - 1] @ thumb)
        number = int(allowed[np.argmax(np.where(along > min(ALONG, along.max() - 1e-9), fit, -1.0))])
    return number, bool(OPPOSITION_AXES[number - 1] @ thumb < 0.0)


def quality(margin: float, turn: float = 0.0, *, elsewhere: bool = False) -> float:
    """What the critic judges, 0..6: 3 where the hand can balance just the load expected, 4.5 for twice that.

    What a soft grip has to spare counts in part: the squeeze itself turns the object in it.

    Args:
        margin: largest load that can be balanced, over the load expected.
        turn: of the object when the forces are a little beside [rad].
        elsewhere: a stiffer grip may be found where nobody has looked yet: all of the margin counts in part.

    >>> quality(0.0), quality(1.0), quality(2.0)
    (0.0, 3.0, 4.5)
    >>> quality(2.0, SOFT), quality(0.5, SOFT) == quality(0.5)
    (3.75, True)
    >>> quality(2.0, TOO_SOFT, elsewhere=True)
    3.0
    """
    if elsewhere:
        margin = margin / (1.0 + turn / TOO_SOFT)
    stiff = float(6.0 * (1.0 - 2.0 ** -max(margin, 0.0)))
    if elsewhere:
        return stiff
    return min(stiff, 3.0 + max(stiff - 3.0, 0.0) / (1.0 + turn / SOFT))


def grip_forces(arms: Array, normals_in: Array, mu: float) -> Array:
    """(n, 3) forces of a squeeze that moves nothing: they balance, their normal parts sum to one.

    Of all balanced ones inside the cones (of eight edges) about the one that spreads most evenly over
    contacts and cone: nonnegative least squares with a small penalty.

    Args:
        arms: (n, 3) contact points from the reference, over ℓ.
        normals_in: (n, 3) inward unit normals.
        mu: friction that they may use.
    """
    from scipy.optimize import nnls

    n = len(arms)
    helper = np.where(np.abs(normals_in[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    t1 = cross(normals_in, helper)
    t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
    t2 = cross(normals_in, t1)
    angles = np.arange(EDGES) * 2 * np.pi / EDGES
    edges = normals_in[:, None] + mu * (
        np.cos(angles)[None, :, None] * t1[:, None] + np.sin(angles)[None, :, None] * t2[:, None]
    )
    flat = edges.reshape(-1, 3)
    wrenches = np.concatenate([flat, cross(np.repeat(arms, EDGES, axis=0), flat)], axis=1)
    penalty = EVENNESS * np.sqrt(n * EDGES)
    rows = np.concatenate([10 * wrenches.T, 10 * np.ones((1, n * EDGES)), penalty * np.eye(n * EDGES)])
    wanted = np.concatenate([np.zeros(6), [10.0], np.full(n * EDGES, penalty / (n * EDGES))])
    weights, _ = nnls(rows, wanted)
    weights /= max(weights.sum(), 1e-9)
    return np.asarray(np.einsum("ne,nei->ni", weights.reshape(n, EDGES), edges))
