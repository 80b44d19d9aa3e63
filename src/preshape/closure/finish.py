"""From a candidate to a grip: exact contacts, squeeze, pregrasp and a collision-free approach (ENGINE §2)."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from functools import cache, partial
from itertools import compress
from typing import NamedTuple

import numpy as np

from ..hands.kinematics import HandKinematics, joint_links
from ..hiis.analyser import GripPosture
from ..hiis.planes import APPROACH_AXES, OPPOSITION_AXES
from ..kernels.chains import joint_frames
from ..kernels.closing.host import ClosingKernel, Fate
from ..kernels.field.host import SurfaceQuery
from ..kernels.hand_spheres import FINE
from ..types import Array, BoolArray, IntArray, value
from .candidates import DrawnCandidates, RankedCandidates
from .closed import ON_PALM, WRAP, ClosedHands, closed_hands, part_name, touching_spheres
from .demand import LONGEST, Demand
from .hand_tables import hand_tables
from .opening import ALONG, BACK, NEAREST, OPENING, Opener
from .preshapes import posture_at
from .pressing import (
    LEAST_MADE,
    MAX_IMBALANCE,
    Squeezer,
    UnitSqueeze,
    made_by_motors,
    turn_from_contact_error,
)
from .rules import breaks
from .search import MIN_CONTACTS, ClosureSearch
from .wrapping import Wrapper, wraps

_log = logging.getLogger("preshape.search")

GAP = 0.0001
"""Distance between finger and surface at which a finger stops closing in a finished grip [m] [C]."""
DEEPEST = 0.0007
"""Largest accepted penetration of any link into the object [m] [C]."""
CONTACT, RETREAT = 0.0008, 0.006
"""Largest distance between a link of a finished wrap and the surface that it touches, and distance from the
object at which the closing of a finished wrap begins [m] [C]."""
INSIDE, OVERLAP = "a link of the closed hand is inside the object", "links of the closed hand overlap"
"""What refuses a candidate because of the closed hand itself."""
SPARE = 2
"""Number of extra candidates that are finished in a batch, because some fail."""
FIRM = 3.0
"""A firm grip presses up to this many times as hard as the settings' strongest press [C]."""
ENOUGH = 3.0
"""Quality of a grip that balances just the expected load."""
SOFT, TOO_SOFT = float(np.radians(1.0)), float(np.radians(10.0))
"""Rotations of the object under a contact error [rad] [C]. At the first, half of a grip's quality above 3
counts. At the second, half of its margin counts, if stiffer grips may still be found on other planes."""


@value
class FinishOptions:
    """How candidates are turned into grips.

    Attributes:
        count: Number of grips wanted; finishing stops there.
        planes: Approach planes that the approach direction may belong to.
        unexplored: Whether other planes have not been searched for this task; soft grips then rank lower.
        by_joints: Whether to start with the candidates whose joints can press hardest; the ranking ignores
            joint torques.
        firm: Whether grips may press harder, just hard enough, if none is good enough with the usual press.
        anyway: Whether candidates that balance none of the load or that the hand cannot execute become grips
            too, with what refused them; for the best grasp of a plan without an answer.
    """

    count: int = 1
    planes: Sequence[int] = tuple(range(1, 13))
    unexplored: bool = False
    by_joints: bool = False
    firm: bool = False
    anyway: bool = False


@value
class FinishedGrip(GripPosture):
    """What the hand does in a grip, the candidate that it came from, and its contacts.

    Attributes:
        row: Index of the candidate.
        plane: Approach plane that the approach direction belongs to, 1..12.
        flip: Whether the thumb stands on that plane's -o side.
        points: (n, 3) contacts, the thumb's first [m].
        normals_in: (n, 3) inward unit normals.
        margin: Largest load that the strongest usual press can balance, divided by the expected load.
    """

    row: int
    plane: int
    flip: bool
    points: Array
    normals_in: Array
    margin: float


class _Executable(NamedTuple):
    """A candidate whose squeeze, pregrasp and straight approach are known.

    Attributes:
        row: Index of the candidate.
        palm_pose: (7,) palm frame in the mesh frame.
        links: (n,) links in contact, as in :class:`ClosedHands`.
        squeeze: The squeeze per newton of press.
        grasp: (j,) joint angles at which the fingers touch [rad].
        pregrasp: (j,) joint angles of the opened hand [rad].
        approach: (3,) unit vector along which the hand approaches, mesh frame.
        clearance: Least distance of the opened hand to the object, at the pregrasp and on the approach [m].
        strengths: Strength for the task and for plain holding, divided by the load, per newton of press.
        refused: What keeps the hand from executing the candidate; empty if nothing does.
    """

    row: int
    palm_pose: Array
    links: IntArray
    squeeze: UnitSqueeze
    grasp: Array
    pregrasp: Array
    approach: Array
    clearance: float
    strengths: tuple[float, float]
    refused: str


class Finisher:
    """Turns candidates into grips.

    Args:
        search: The search that found the candidates.
        query: The object's exact surface.

    Attributes:
        max_imbalance: See :data:`MAX_IMBALANCE`.
    """

    def __init__(self, search: ClosureSearch, query: SurfaceQuery) -> None:
        self.search, self.query = search, query
        self.max_imbalance = MAX_IMBALANCE
        self.hand, self.settings = search.hand, search.settings
        self.tables = hand_tables(search.hand, FINE)
        self.kernel = ClosingKernel(
            self.tables, search.field, device=self.settings.device, threads=self.settings.threads
        )
        self.opener = Opener(
            self.tables,
            self.kernel,
            HandKinematics(search.hand),
            self.settings.obstacles,
            search.blockers.kept_off,
        )
        self.squeezer = Squeezer(
            search.hand,
            self.tables,
            search.cog,
            min(search.length, LONGEST),
            self.settings.mu,
            self.settings.strongest,
        )
        self.wrapper = Wrapper(self.tables, self.kernel, search.field, gap=GAP, near=CONTACT)
        self._links = joint_links(search.hand)

    def closed(self, drawn: DrawnCandidates) -> ClosedHands:
        """Close candidates with the fine spheres, a little off the surface, and find their exact contacts."""
        candidates = drawn.candidates
        closings = self.kernel.close(
            candidates, wanted=MIN_CONTACTS, clearance=GAP, palm_clearance=NEAREST, tolerance=5e-5
        )
        grasp = posture_at(self.tables, candidates.start, closings.closing)
        spheres, links = touching_spheres(self.tables, closings)
        closed = closings.fate == Fate.CLOSED
        return closed_hands(self.tables, self.query, candidates, grasp, spheres, links, closed)

    def wrapped(self, drawn: DrawnCandidates) -> ClosedHands:
        """Close wraps with the fine spheres, from a little outside, and find their exact contacts."""
        hands = self.wrapper.close(drawn.candidates, back=RETREAT)
        return closed_hands(self.tables, self.query, *hands)

    def finish(
        self, found: RankedCandidates, demand: Demand, options: FinishOptions | None = None
    ) -> list[FinishedGrip]:
        """Turn candidates into grips, in order; candidates that the hand cannot execute are dropped.

        1. Close the candidates again with fine spheres, and find their exact contacts.
        2. Drop those that do not close or whose contacts are not real; those that penetrate the object, hit
           an obstacle, break a contact rule, or balance none of the load.
        3. In batches: drop hands whose links overlap, or whose exact shapes are near a part that is kept off;
           then find a pregrasp and a collision-free approach.
        4. For each with both, compute the thorough strength and the squeeze, until there are enough grips.
        5. If a firm press is allowed and no grip is good enough, press harder.

        With ``options.anyway``, steps 2 and 3 drop only candidates that do not close with real contacts.

        Args:
            found: A few dozen candidates at most.
            demand: What the grip must produce.
            options: How many grips are wanted, and which.
        """
        options = options or FinishOptions()
        if not len(found):
            return []
        # 1. Exact contacts.
        hands = self.wrapped(found.drawn) if wraps(found.drawn) else self.closed(found.drawn)
        candidates, grasp = hands.candidates, hands.grasp
        frames = joint_frames(self.tables, grasp)
        # 2. Rough checks of all candidates at once.
        task, hold = self.search.strengths(hands, demand)
        to_object, to_obstacles = self.kernel.clearances(
            candidates.place, candidates.turn, grasp, self.settings.obstacles, enough=OPENING
        )
        closed, outside = hands.real, to_object.min(axis=1) > -DEEPEST
        broken = self._broken(hands)
        sound = outside & (to_obstacles > 0) & (self.search.score(task, hold, demand) > 0)
        sound &= ~broken.any(axis=1)
        rows, apart = np.flatnonzero(closed & (sound | options.anyway)), np.ones(len(closed), dtype=bool)
        squeeze = cache(partial(self.squeezer.squeeze, hands, frames))
        if options.by_joints:
            press = [min(self.settings.strongest, squeeze(int(row)).max_press) for row in rows]
            rows = rows[np.argsort(-found.score[rows] * press, kind="stable")]
        grips, executable = list[FinishedGrip](), list[_Executable]()
        batch = options.count + SPARE
        for part in (rows[first : first + batch] for first in range(0, len(rows), batch)):
            if len(grips) == options.count:
                break
            # 3. Pregrasps and approaches of a batch.
            apart[part] = [self.opener.links_apart(grasp[row]) for row in part]
            if len(kept_off := self.search.blockers.kept_off):
                near = kept_off.exactly_near(candidates.place[part], candidates.turn[part], grasp[part])
                broken[part, -len(kept_off) :] |= near
            ways = self.opener.find(
                candidates,
                grasp,
                part[(apart[part] & ~broken[part].any(axis=1)) | options.anyway],
                found.drawn.plane,
                options.planes,
                wrapping=candidates.mask & WRAP != 0,
                anyway=options.anyway,
            )
            strengths = np.zeros(0)
            for k, row in enumerate(ways.row.tolist()):
                if len(grips) == options.count:
                    break
                # 4. Thorough strengths, computed together for as many as are still wanted. The press that
                # carries the weight is the middling press, or less if the joints limit it.
                if k == len(strengths):
                    more = ways.row[k : k + options.count - len(grips)]
                    press = [min(self.settings.middling, squeeze(int(one)).max_press) for one in more]
                    part_strengths = self.search.thorough_strengths(hands.take(more), demand, np.array(press))
                    strengths = np.append(strengths, part_strengths)
                candidate = _Executable(
                    row=row,
                    palm_pose=np.concatenate([candidates.place[row], candidates.turn[row]]),
                    links=hands.links[row, : hands.counts[row]],
                    squeeze=squeeze(row),
                    grasp=grasp[row],
                    pregrasp=ways.pregrasp[k],
                    approach=ways.approach[k],
                    clearance=float(ways.clearance[k]),
                    strengths=(float(strengths[k]) / demand.load, float(hold[row]) / self.settings.hold),
                    refused=self._refused(outside[row], apart[row], broken[row]) or ways.refused[k],
                )
                grip = self._grip(found, candidate, options, firm=False)
                if grip is not None:
                    grips.append(grip)
                    executable.append(candidate)
        # 5. Firm grips.
        if options.firm and all(grip.quality < ENOUGH for grip in grips):
            firm = [self._grip(found, candidate, options, firm=True) for candidate in executable]
            grips = [grip for grip in firm if grip is not None]
        best = f"; best quality {max(grip.quality for grip in grips):.2f}" if grips else ""
        _log.info("%d examined, %d sound, %d finished%s", len(found), len(rows), len(grips), best)
        return grips

    def _broken(self, hands: ClosedHands) -> BoolArray:
        """(n, m) which contact rules closed hands break.

        Every link and place of the palm within ``CONTACT`` of the object counts as a contact, whether or not
        the grip presses with it.
        """
        places, kept_off = self.search.blockers.places, self.search.blockers.kept_off
        broken = places.broken_by(hands.points, hands.counts)
        if len(places):
            touching = self.wrapper.contacts(hands.candidates, hands.grasp)
            every = closed_hands(
                self.tables, self.query, hands.candidates, hands.grasp, *touching, closed=hands.real
            )
            broken |= places.broken_by(every.points, every.counts)
        if len(kept_off):
            candidates = hands.candidates
            broken[:, -len(kept_off) :] |= kept_off.near(candidates.place, candidates.turn, hands.grasp)
        return broken

    def _refused(self, outside: bool, apart: bool, broken: BoolArray) -> str:
        """What refuses a closed hand, as a clause; empty if nothing does."""
        if not outside or not apart:
            return OVERLAP if outside else INSIDE
        return next((breaks(rule) for rule in compress(self.settings.rules.names, broken)), "")

    def _grip(
        self, found: RankedCandidates, candidate: _Executable, options: FinishOptions, *, firm: bool
    ) -> FinishedGrip | None:
        """The grip of one candidate; ``None`` if its forces do not balance, or motors do not make them.

        The press is ``safety`` times what the load needs, between the settings' least and strongest press and
        within the joint torques. A firm grip presses just hard enough, even beyond the strongest press.
        """
        squeeze, settings, row = candidate.squeeze, self.settings, candidate.row
        if squeeze.imbalance > self.max_imbalance:
            return None
        wrapping = bool(int(found.drawn.candidates.mask[row]) & WRAP)
        if wrapping and made_by_motors(squeeze, self.search.cog, 1.0 / self.hand.gains) < LEAST_MADE:
            return None
        points, weakest = squeeze.points, min(candidate.strengths)
        usual = min(settings.strongest, squeeze.max_press)
        needed = settings.weight / max(weakest, 1e-9)
        firm = firm and usual < needed <= min(FIRM * settings.strongest, squeeze.max_press)
        press = needed if firm else min(max(settings.press_least, settings.safety * needed), usual)
        # A target may lie beyond a joint's limit: a servo whose target is the limit itself would not press.
        compliance = 1.0 / self.hand.gains
        turn = turn_from_contact_error(
            points - self.search.cog,
            squeeze.normals_in,
            press * squeeze.forces,
            squeeze.jacobians,
            [compliance[motors] for motors in squeeze.motors],
        )
        margin = weakest * usual / settings.weight
        drawn = found.drawn
        plane, flip = plane_of(candidate.approach, points, int(drawn.plane[row]), options.planes)
        return FinishedGrip(
            row=row,
            plane=plane,
            flip=flip,
            points=points,
            normals_in=squeeze.normals_in,
            margin=margin,
            approach=candidate.approach,
            palm_pose=candidate.palm_pose,
            start=drawn.candidates.start[row],
            mask=int(drawn.candidates.mask[row]),
            pregrasp=candidate.pregrasp,
            grasp=candidate.grasp,
            squeeze=self.hand.follow(
                self.hand.controls(candidate.grasp) + press * squeeze.drive * compliance
            ),
            fingers_touching=tuple(part_name(self.tables, int(link)) for link in candidate.links),
            links=tuple(
                self.hand.palm_body if link == ON_PALM else self._links[link] for link in candidate.links
            ),
            forces=press * squeeze.forces,
            torques=press * squeeze.torques,
            task_margin=candidate.strengths[0] * press / settings.weight,
            hold_margin=candidate.strengths[1] * press / settings.weight,
            quality=ENOUGH if firm else quality(margin, turn, unexplored=options.unexplored),
            clearance=candidate.clearance,
            friction_share=settings.friction_share,
            refused=candidate.refused,
            back=BACK if wrapping else 0.0,
        )


def plane_of(approach: Array, points: Array, own: int, planes: Sequence[int]) -> tuple[int, bool]:
    """The approach plane that a grip belongs to, and whether its thumb stands on the -o side.

    If the approach direction follows the approach axis of the candidate's own plane, the grip belongs to that
    plane. Otherwise it belongs to an allowed plane whose approach axis the direction follows. If there are
    several, the one whose opposition axis is nearest to the thumb's side counts.

    Args:
        approach: (3,) unit vector along which the hand approaches.
        points: (n, 3) contacts, the thumb's first.
        own: Plane that the candidate was drawn for.
        planes: Allowed planes.
    """
    thumb = points[0] - points[1:].mean(axis=0)
    thumb = thumb / max(float(np.linalg.norm(thumb)), 1e-9)
    plane = own
    if APPROACH_AXES[own - 1] @ approach < ALONG:
        allowed = np.asarray(planes)
        along = APPROACH_AXES[allowed - 1] @ approach
        fit = np.abs(OPPOSITION_AXES[allowed - 1] @ thumb)
        plane = int(allowed[np.argmax(np.where(along > min(ALONG, along.max() - 1e-9), fit, -1.0))])
    return plane, bool(OPPOSITION_AXES[plane - 1] @ thumb < 0.0)


def quality(margin: float, turn: float = 0.0, *, unexplored: bool = False) -> float:
    """Quality for the critic, 0..6: 3 if the hand just balances the expected load, 4.5 for twice that load.

    A soft grip has a lower quality, because the squeeze itself turns the object.

    Args:
        margin: Largest load that can be balanced, divided by the expected load.
        turn: Rotation of the object under a contact error [rad].
        unexplored: Whether a stiffer grip may be found on planes not searched yet. Softness then lowers the
            whole margin instead of the quality above 3.

    >>> quality(0.0), quality(1.0), quality(2.0)
    (0.0, 3.0, 4.5)
    >>> quality(2.0, SOFT), quality(0.5, SOFT) == quality(0.5)
    (3.75, True)
    >>> quality(2.0, TOO_SOFT, unexplored=True)
    3.0
    """
    if unexplored:
        margin = margin / (1.0 + turn / TOO_SOFT)
    stiff = float(6.0 * (1.0 - 2.0 ** -max(margin, 0.0)))
    if unexplored:
        return stiff
    return min(stiff, ENOUGH + max(stiff - ENOUGH, 0.0) / (1.0 + turn / SOFT))


def margin_of(judged: float) -> float:
    """The margin of a stiff grip with the given :func:`quality`; the inverse of that function.

    >>> round(margin_of(quality(1.5)), 12)
    1.5
    """
    return -math.log2(1.0 - min(judged, 6.0 - 1e-9) / 6.0)
