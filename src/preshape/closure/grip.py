"""From a candidate to a grip: exact contacts, squeeze, pregrasp, and a way in that is free (ENGINE §2)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from ..hands.kinematics import HandKinematics
from ..hiis.planes import APPROACH_AXES, OPPOSITION_AXES
from ..kernels.chains import joint_frames, rotations
from ..kernels.closing.host import Candidates, ClosingKernel, Closings, Fate
from ..kernels.field.host import SurfaceQuery
from ..kernels.hand_spheres import FINE
from ..types import Array, value
from .compliance import turn_when_beside
from .hand_tables import hand_tables
from .opening import ALONG, NEAREST, OPENING, Opener, Openings
from .preshapes import posture_at
from .pressing import Press, Pressing, finger_order
from .ranked import Ranked
from .search import ClosureSearch, Demand

GAP = 0.0001
"""How far from the surface a finger stops in an answer [m] [C]."""
DEEPEST = 0.0007
"""Deeper than this nothing may be in the object [m] [C]."""
UNBALANCED = 0.03
"""Forces of a squeeze may leave this share of the press unbalanced, torques over ℓ."""
SPARE = 2
"""So many more candidates than grips wanted are looked at side by side: some will not do."""
FIRM = 3.0
"""Where no grip is enough at the settings' strongest press, one may be pressed so many times as hard [C]."""
ENOUGH = 3.0
"""Quality of a grip that can balance just the load expected."""
SOFT, TOO_SOFT = float(np.radians(1.0)), float(np.radians(10.0))
"""Where an object turns by the first when the forces are a little beside, what its grip has to spare counts
half; where by the second and stiffer grips may be found elsewhere, all of its margin does [C]."""


@value
class Finished:
    """What the hand does in a grip, the candidate that it came from, and its contacts.

    The fields from ``approach`` on are those of :class:`preshape.hiis.analyser.Grip`.

    Attributes:
        row: Row of the candidate.
        plane: The approach plane that the way in belongs to, 1..12.
        flip: Whether the thumb stands on that plane's -o side.
        points: (n, 3) contacts, the thumb's first [m].
        normals_in: (n, 3) inward unit normals.
        margin: Largest load that the strongest usual squeeze can balance, divided by the expected load.
    """

    row: int
    plane: int
    flip: bool
    points: Array
    normals_in: Array
    margin: float
    approach: Array
    palm_pose: Array
    start: Array
    mask: int
    pregrasp: Array
    grasp: Array
    squeeze: Array
    fingers_touching: tuple[str, ...]
    forces: Array
    torques: Array
    task_margin: float
    hold_margin: float
    quality: float
    clearance: float


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
        self.press = Press(search.hand, self.tables, search.cog, search.length, self.settings.mu)

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
        by_joints: bool = False,
        firm: bool = False,
    ) -> list[Finished]:
        """The grips that the candidates turn into, in their order; what cannot be executed is left out.

        Args:
            found: candidates, a few dozen at most.
            demand: what the grip is asked for.
            wanted: contacts that it must have.
            enough: how many grips are wanted; candidates after that are not looked at.
            planes: approach planes that the way in may belong to.
            elsewhere: there is more to be looked at, so a soft grip is worth less.
            by_joints: put them first in the order of what the hand's joints can press them for: the ranking
                does not know these.
            firm: where none is enough with the usual press, they may press harder, until it is just enough.
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
        rows, grips, again = np.flatnonzero(sound), list[Finished](), list[Callable[..., Finished | None]]()
        pressing = cache(partial(self.press, candidates, packed, frames))
        if by_joints:
            strongest = [min(self.settings.strongest, pressing(int(row)).limit) for row in rows]
            rows = rows[np.argsort(-found.score[rows] * strongest, kind="stable")]
        each = enough + SPARE
        for some in (rows[first : first + each] for first in range(0, len(rows), each)):
            free = some[[self.opener.free_of_itself(grasp[row]) for row in some]]
            ways = self.opener.find(candidates, closings.closing, free, found.sampled.plane, planes)
            surely = np.zeros(0)
            for k, row in enumerate(ways.row):
                if k == len(surely):  # as many as are still wanted, side by side
                    more = ways.row[k : k + enough - len(grips)]
                    # The weight is carried by a middling press, or by what the joints can do.
                    carried = [min(self.settings.middling, pressing(int(one)).limit) for one in more]
                    sure = self.search.surely(packed.take(more), demand, np.array(carried))
                    surely = np.append(surely, sure)
                margins = float(surely[k]) / demand.load, float(hold[row]) / self.settings.hold
                make = partial(
                    self._grip, found, int(row), pressing(int(row)), grasp[row], ways, k, margins, planes
                )
                made = make(elsewhere=elsewhere)
                if made is not None:
                    grips.append(made)
                    again.append(make)
                if len(grips) == enough:
                    break
            if len(grips) == enough:
                break
        if firm and all(made.quality < ENOUGH for made in grips):
            harder = [make(elsewhere=elsewhere, firm=True) for make in again]
            return [made for made in harder if made is not None]
        return grips

    def _packed(self, closings: Closings, points: Array, normals: Array) -> Closings:
        """The closings with exact contacts, the thumb's first."""
        order = finger_order(self.tables)
        used = closings.sphere[:, order] >= 0
        place = np.argsort(~used, axis=1, kind="stable")
        P = np.take_along_axis(points[:, order], place[:, :, None], axis=1)
        N = np.take_along_axis(normals[:, order], place[:, :, None], axis=1)
        full_p, full_n = np.zeros_like(closings.points), np.zeros_like(closings.normals_in)
        f = P.shape[1]
        full_p[:, :f], full_n[:, :f] = np.nan_to_num(P), np.nan_to_num(N)
        counts = np.where(closings.fate == Fate.CLOSED, used.sum(axis=1), 0).astype(np.int64)
        return replace(closings, points=full_p, normals_in=full_n, counts=counts)

    def _grip(
        self,
        found: Ranked,
        row: int,
        pressing: Pressing,
        q: Array,
        ways: Openings,
        k: int,
        margins: tuple[float, float],
        planes: Sequence[int],
        *,
        elsewhere: bool,
        firm: bool = False,
    ) -> Finished | None:
        if pressing.left > self.unbalanced:
            return None
        candidates, settings = found.sampled.candidates, self.settings
        points, normals, limit = pressing.points, pressing.normals_in, pressing.limit
        usual, just = min(settings.strongest, limit), settings.weight / max(min(margins), 1e-9)
        margin = min(margins) * usual / settings.weight
        firm = firm and usual < just <= min(FIRM * settings.strongest, limit)
        press = just if firm else min(max(settings.press_least, settings.safety * just), usual)
        # A target beyond a joint's limit is meant: a servo that stops at the limit would press with nothing.
        yielding = 1.0 / (self.hand.gains * self.press.sharing)
        squeeze = q + press * pressing.torques * yielding
        turn = turn_when_beside(
            points - self.search.cog,
            normals,
            press * pressing.forces,
            pressing.jacobians,
            [yielding[chain] for chain in pressing.chains],
        )
        number, flip = counted_to(ways.approach[k], points, int(found.sampled.plane[row]), planes)
        return Finished(
            row=row,
            plane=number,
            flip=flip,
            points=points,
            normals_in=normals,
            margin=margin,
            approach=ways.approach[k],
            palm_pose=np.concatenate([candidates.place[row], candidates.turn[row]]),
            start=candidates.start[row],
            mask=int(candidates.mask[row]),
            pregrasp=ways.pregrasp[k],
            grasp=q,
            squeeze=squeeze,
            fingers_touching=tuple(self.tables.fingers[f] for f in pressing.used),
            forces=press * pressing.forces,
            torques=press * pressing.torques,
            task_margin=margins[0] * press / settings.weight,
            hold_margin=margins[1] * press / settings.weight,
            quality=ENOUGH if firm else quality(margin, turn, elsewhere=elsewhere),
            clearance=float(ways.clearance[k]),
        )


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
    return min(stiff, ENOUGH + max(stiff - ENOUGH, 0.0) / (1.0 + turn / SOFT))


def margin_of(judged: float) -> float:
    """The margin of a stiff grip of that :func:`quality`.

    >>> round(margin_of(quality(1.5)), 12)
    1.5
    """
    return -math.log2(1.0 - min(judged, 6.0 - 1e-9) / 6.0)
