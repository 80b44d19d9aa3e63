"""Hands that have closed on the object: their postures and exact contacts, on fingertips, links and palm."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..hiis.analyser import PALM
from ..kernels.chains import joint_frames, rotations
from ..kernels.closing.host import CLOSING_ARRAYS, Candidates, Closings, Fate
from ..kernels.field.host import SurfaceQuery
from ..kernels.margin.host import MOST_CONTACTS
from ..kernels.tables import HandTables
from ..types import Array, BoolArray, IntArray, value
from .candidates import CANDIDATE_ARRAYS, columns

SUNK, OUTSIDE = 0.003, 1e-5
"""Largest penetration of a touching sphere, which is the error of a grid that resolves the object, and least
distance of its centre from the surface [m] [C]."""
WRAP = 1 << 16
"""Bit of a candidate's mask: the hand wraps; without it, it grips with its fingertips."""
ON_PALM = -1
"""Link of a contact on the palm."""


@value
class ClosedHands:
    """n closed hands with up to c contacts each.

    Attributes:
        candidates: (n,) the hands before they closed, at the place where they closed.
        grasp: (n, j) joint angles [rad].
        points: (n, c, 3) contacts [m], the thumb's first if it touches; only the first ``counts`` are filled.
        normals_in: (n, c, 3) inward unit normals.
        links: (n, c) index of the joint that carries the touching link; ``ON_PALM`` for the palm.
        counts: (n,) number of contacts; 0 where a hand did not close.
        real: (n,) whether the hand closed and every contact is real: not on a lid, and on the outside.
    """

    candidates: Candidates
    grasp: Array
    points: Array
    normals_in: Array
    links: IntArray
    counts: IntArray
    real: BoolArray

    def take(self, rows: IntArray) -> ClosedHands:
        """The hands with these indices, in that order."""
        own = {name: getattr(self, name)[rows] for name in _ROWS}
        return ClosedHands(candidates=self.candidates.take(rows), **own)


_ROWS = ("grasp", "points", "normals_in", "links", "counts", "real")


class ClosedCandidates(NamedTuple):
    """k of the candidates, which closed on the object.

    Attributes:
        rows: (k,) their indices.
        closings: (k,) how they closed.
        candidates: (k,) the hands where they closed, which for a wrap is where its palm stopped.
        grasp: (k, j) joint angles [rad].
        links: (k, c) joint that carries each contact; ``ON_PALM`` for the palm.
    """

    rows: IntArray
    closings: Closings
    candidates: Candidates
    grasp: Array
    links: IntArray

    def take(self, rows: IntArray) -> ClosedCandidates:
        """The hands with these indices, in that order."""
        closings, candidates = self.closings.take(rows), self.candidates.take(rows)
        return ClosedCandidates(self.rows[rows], closings, candidates, self.grasp[rows], self.links[rows])

    def joined(self, other: ClosedCandidates) -> ClosedCandidates:
        """These hands, then the others."""
        return ClosedCandidates(
            closings=Closings(**columns((self.closings, other.closings), CLOSING_ARRAYS)),
            candidates=Candidates(**columns((self.candidates, other.candidates), CANDIDATE_ARRAYS)),
            **columns((self, other), ("rows", "grasp", "links")),
        )


def closed_hands(
    tables: HandTables,
    query: SurfaceQuery,
    candidates: Candidates,
    grasp: Array,
    spheres: IntArray,
    links: IntArray,
    closed: BoolArray,
) -> ClosedHands:
    """Exact contacts of the touching spheres of closed hands.

    A contact is not real if it lies on a lid, or if the centre of the touching sphere is not outside.
    Where a wall is too thin for the grid of distances, the sphere sinks into it; with the centre inside,
    the normal would point out of the object.

    Args:
        tables: Tables of the hand.
        query: The object's exact surface.
        candidates: n hands.
        grasp: (n, j) their joint angles [rad].
        spheres: (n, c) touching spheres, those of the palm by ``links``; -1 after the last.
        links: (n, c) joint that carries each sphere; ``ON_PALM`` for the palm.
        closed: (n,) whether the hand closed.
    """
    n = len(grasp)
    places, turns = joint_frames(tables, grasp)
    R = rotations(candidates.turn)
    points, normals = np.zeros((n, MOST_CONTACTS, 3)), np.zeros((n, MOST_CONTACTS, 3))
    behind, real = np.full((n, MOST_CONTACTS), ON_PALM, dtype=np.int64), closed.copy()
    rows, columns = np.nonzero(spheres >= 0)
    if len(rows):
        picked, joints = spheres[rows, columns], links[rows, columns]
        on_palm = joints == ON_PALM
        local = np.empty((len(rows), 4))
        local[on_palm] = tables.palm[picked[on_palm]]
        local[~on_palm] = tables.sphere[picked[~on_palm]]
        centres = np.where(
            on_palm[:, None],
            local[:, :3],
            places[rows, joints] + np.einsum("nij,nj->ni", turns[rows, joints], local[:, :3]),
        )
        centres = candidates.place[rows] + np.einsum("nij,nj->ni", R[rows], centres)
        closest = query.closest(centres)
        sunk = closest.distance < np.maximum(local[:, 3] - SUNK, OUTSIDE)
        real[rows[sunk | query.is_lid[closest.triangle]]] = False
        # The normal points from the sphere's centre to the surface, because an edge has no face normal.
        inward = closest.point - centres
        points[rows, columns] = closest.point
        normals[rows, columns] = inward / np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-9)
        behind[rows, columns] = joints
    counts = np.where(closed, (spheres >= 0).sum(axis=1), 0).astype(np.int64)
    return ClosedHands(
        candidates=candidates,
        grasp=grasp,
        points=points.astype(np.float32),
        normals_in=normals.astype(np.float32),
        links=behind,
        counts=counts,
        real=real,
    )


def finger_order(tables: HandTables) -> list[int]:
    """Indices of the fingers in the order of contacts: the thumb, then the others."""
    t = tables.thumb
    return [t, *(f for f in range(len(tables.fingers)) if f != t)]


def touching_spheres(tables: HandTables, closings: Closings) -> tuple[IntArray, IntArray]:
    """(n, f) touching spheres of fingertip grips, the thumb's first, else -1; and (n, f) their joints."""
    order = finger_order(tables)
    spheres = closings.sphere[:, order]
    used = (spheres >= 0) & (closings.fate == Fate.CLOSED)[:, None]
    place = np.argsort(~used, axis=1, kind="stable")  # the thumb's first, then the others in use
    spheres = np.where(
        np.take_along_axis(used, place, axis=1), np.take_along_axis(spheres, place, axis=1), -1
    )
    return spheres, np.searchsorted(tables.sphere_start, spheres, side="right") - 1


def link_chain(tables: HandTables, link: int) -> slice:
    """The joints between the palm and a link; none for the palm."""
    if link == ON_PALM:
        return slice(0, 0)
    finger = int(np.searchsorted(tables.joint_start, link, side="right")) - 1
    return slice(int(tables.joint_start[finger]), int(link) + 1)


def part_name(tables: HandTables, link: int) -> str:
    """Name of the finger that a link belongs to, or that of the palm."""
    if link == ON_PALM:
        return PALM
    return tables.fingers[int(np.searchsorted(tables.joint_start, link, side="right")) - 1]
