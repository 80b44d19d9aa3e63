"""Wraps: the palm goes to the object, and the fingers close round it link by link (ENGINE §6).

A fingertip grip stops each finger at its first touch. In a wrap, a link that touches stops its own joint and
those before it; the joints after it go on until they touch or end. Every link, and several places of the
palm, may be contacts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..hiis.planes import APPROACH_AXES, OPPOSITION_AXES
from ..kernels.chains import rotations
from ..kernels.closing.host import Candidates, ClosingKernel
from ..kernels.field.host import DistanceField
from ..kernels.field.plain import field_distance
from ..kernels.margin.host import MOST_CONTACTS
from ..kernels.tables import HandTables
from ..objects.mesh import TriangleMesh
from ..spatial import rotation_from_vector
from ..types import Array, BoolArray, IntArray
from .candidates import DrawnCandidates, Region, quaternions
from .closed import ON_PALM, WRAP
from .contact_places import AllowedSurface
from .opening import ALONG
from .preshapes import Preshapes, posture_of

STANDOFF = 0.15
"""Distance from the surface at which the palm of a drawn wrap begins [m] [C]."""
JITTER = 0.15
"""Standard deviation of the palm's tilt off the surface's normal [rad] [C] (ENGINE §6)."""
MOVES, STEPS = 24, 60
"""Largest number of steps of the palm towards the object, and of the fingers round it."""
PALM_CONTACTS, PALM_APART = 4, 0.012
"""Largest number of contacts of the palm, and their least distance from each other [m] [C]."""
FURTHEST = 0.06
"""Distances of links are computed up to this one [m]; a step of the fingers is not longer in any case."""
FEWEST = 3
"""Least number of contacts of a wrap."""


class ClosedWraps(NamedTuple):
    """n wraps after closing.

    Attributes:
        candidates: (n,) the wraps; the palm stands where it stopped.
        grasp: (n, j) joint angles [rad].
        spheres: (n, c) touching spheres, the thumb's first; -1 after the last.
        links: (n, c) joint that carries each; ``ON_PALM`` for the palm.
        closed: (n,) whether the hand closed on the object.
    """

    candidates: Candidates
    grasp: Array
    spheres: IntArray
    links: IntArray
    closed: BoolArray


def wraps(drawn: DrawnCandidates) -> bool:
    """Whether candidates, which are all of one family, are wraps."""
    return len(drawn) > 0 and bool(drawn.candidates.mask[0] & WRAP)


def families(drawn: DrawnCandidates) -> list[DrawnCandidates]:
    """The fingertip grips and the wraps among candidates; families without any are left out."""
    wrapping = drawn.candidates.mask & WRAP != 0
    parts = [np.flatnonzero(~wrapping), np.flatnonzero(wrapping)]
    return [drawn.take(rows) for rows in parts if len(rows)]


class Wrapper:
    """Draws and closes wraps of one hand round one object.

    Args:
        tables: Tables of the hand.
        kernel: Closing kernel of the hand and the object.
        field: Distance field of the object.
        gap: Distance from the surface at which links and palm stop [m].
        near: Largest distance of a link or a place of the palm that counts as contact [m].
    """

    def __init__(
        self, tables: HandTables, kernel: ClosingKernel, field: DistanceField, *, gap: float, near: float
    ) -> None:
        self.tables, self.kernel, self.field, self.gap, self.near = tables, kernel, field, gap, near
        starts, ends = tables.sphere_start[:-1], tables.sphere_start[1:]
        self._speed = np.array(
            [tables.speed[a:b].max(initial=0.0) for a, b in zip(starts, ends, strict=True)]
        )
        self._rate = tables.path[-1] - tables.path[0]
        self._finger = np.searchsorted(tables.joint_start, np.arange(len(tables.axis)), side="right") - 1
        # (j, m) whether a motor moves a joint, and whether it moves a joint at or before it in its finger.
        joints = np.arange(len(tables.axis))
        self._moves = tables.motor[:, None] == np.arange(len(tables.range))
        self._finger_of_motor = self._finger[self._moves.argmax(axis=0)]
        same = self._finger[:, None] == self._finger
        self._carries = ((same & (joints[None] <= joints[:, None])) @ self._moves) > 0

    def draw(
        self,
        rng: np.random.Generator,
        pool: Preshapes,
        mesh: TriangleMesh,
        count: int,
        region: Region,
        surface: AllowedSurface | None = None,
    ) -> DrawnCandidates:
        """Draw wraps: the palm faces a random place of the surface, turned at random about its normal.

        The approach follows the approach axis of an allowed plane, and the thumb stands on an allowed side of
        it. Draws for which this is impossible are left out.

        Args:
            rng: Random generator.
            pool: Preshapes of the hand; the wraps begin with their postures.
            mesh: The object.
            count: Number of draws.
            region: Allowed planes and sides.
            surface: The surface that may be touched; ``None`` for all of it.
        """
        # 1. Places of the surface, by area, and inward normals with a tilt.
        if surface is None:
            spot, triangle = _spots(rng, mesh, count)
        else:
            pick = rng.integers(len(surface), size=count)
            spot, triangle = surface.points[pick], surface.triangle[pick]
        tilt = rotation_from_vector(rng.normal(0.0, JITTER, (count, 3)))
        approach = np.einsum("nij,nj->ni", tilt, -mesh.normals[triangle])
        # 2. Any turn about it: +z of the palm is where the fingers point, -y where the palm faces.
        helper = np.where(np.abs(approach[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
        side = np.cross(approach, helper)
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        angle = rng.uniform(0.0, 2 * np.pi, count)
        z = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(approach, side)
        R = np.stack([np.cross(-approach, z), -approach, z], axis=2)
        # 3. A place of the palm's front that faces the spot.
        palm = self._palm_front()[rng.integers(len(self._palm_front()), size=count)]
        place = spot - STANDOFF * approach - np.einsum("nij,nj->ni", R, palm)
        # 4. Planes and sides.
        allowed = np.asarray(region.planes)
        along = APPROACH_AXES[allowed - 1] @ approach.T
        thumb = -R[:, :, 1]  # the thumb stands before the palm; its side is decided by the contacts
        fit = np.where(
            along > ALONG, np.abs(OPPOSITION_AXES[allowed - 1] @ z.T) + rng.random(along.shape), -1.0
        )
        plane = allowed[fit.argmax(axis=0)]
        keep = np.flatnonzero(fit.max(axis=0) > 0)
        pick = rng.integers(len(pool.start), size=count)
        everyone = (1 << len(self.tables.fingers)) - 1
        half = mesh.extents / 2
        reach = np.abs(APPROACH_AXES[plane - 1]) @ half
        value = np.einsum("ni,ni->n", spot - mesh.cog, APPROACH_AXES[plane - 1]) / np.maximum(reach, 1e-9)
        return DrawnCandidates(
            candidates=Candidates(
                place=place[keep],
                turn=quaternions(R[keep]),
                start=pool.start[pick[keep]],
                mask=np.full(len(keep), everyone | WRAP, dtype=np.int64),
            ),
            plane=plane[keep],
            flip=np.einsum("ni,ni->n", OPPOSITION_AXES[plane - 1], thumb)[keep] < 0,
            value=np.clip(value[keep], -1.0, 1.0),
            preshape=pick[keep],
        )

    def arrived(self, candidates: Candidates) -> Candidates:
        """Drawn wraps with the palm at its place on the surface, where nothing else stops it before."""
        facing = -rotations(candidates.turn)[:, :, 1]
        return replace(candidates, place=candidates.place + STANDOFF * facing)

    def close(self, candidates: Candidates, *, back: float = 0.0) -> ClosedWraps:
        """Close wraps.

        1. Move the open hand along the way that its palm faces until palm or fingers touch.
        2. Close all motors that the closing path moves, each at its own rate. A link that touches stops the
           motors of its own joint and of those before it. The others go on until their links touch or their
           paths end.
        3. A motor none of whose links touches goes back to where it began: closed round nothing, a finger
           would only be in the way of the others.
        4. Every link within ``near`` of the object is a contact, and up to four places of the palm.

        Args:
            candidates: n hands.
            back: Distance by which they are first moved back [m].
        """
        n, tables = len(candidates), self.tables
        facing = -rotations(candidates.turn)[:, :, 1]
        place = candidates.place - back * facing
        commands = candidates.start @ tables.command.T
        # 1. The way in.
        posture, going, free = posture_of(tables, commands), np.arange(n), np.ones(n, dtype=bool)
        travelled = np.zeros(n)
        for k in range(MOVES):
            if not len(going):
                break
            distance, _ = self.kernel.link_distances(
                place[going], candidates.turn[going], posture[going], enough=STANDOFF
            )
            least = distance.min(axis=1) - self.gap
            if k == 0:
                free[going[least < 0.0]] = False
            step = np.maximum(least, 0.0)
            place[going] += step[:, None] * facing[going]
            travelled[going] += step
            going = going[(least > 0.5 * self.gap) & (travelled[going] < 2 * STANDOFF)]
        free &= travelled < 2 * STANDOFF
        # 2. and 3. The closing.
        opened, rows = commands, np.flatnonzero(free)
        commands = self._round(place, candidates.turn, commands, rows)
        commands[rows] = self._back_open(place[rows], candidates.turn[rows], opened[rows], commands[rows])
        # 4. Contacts.
        grasp = posture_of(tables, commands)
        spheres = np.full((n, MOST_CONTACTS), -1, dtype=np.int64)
        links = np.full((n, MOST_CONTACTS), ON_PALM, dtype=np.int64)
        moved = Candidates(place=place, turn=candidates.turn, start=candidates.start, mask=candidates.mask)
        if len(rows):
            spheres[rows], links[rows] = self.contacts(moved.take(rows), grasp[rows])
        touching = (spheres >= 0).sum(axis=1)
        return ClosedWraps(moved, grasp, spheres, links, free & (touching >= FEWEST))

    def _round(self, place: Array, turn: Array, commands: Array, rows: IntArray) -> Array:
        """(n, m) commands [rad] at which the fingers of the hands ``rows`` have closed round the object."""
        tables, commands = self.tables, commands.copy()
        low, high = tables.range.T
        last = commands + self._rate
        active = np.broadcast_to(self._rate != 0.0, commands.shape).copy()
        for _ in range(STEPS):
            rows = rows[active[rows].any(axis=1)]
            if not len(rows):
                break
            on = active[rows]
            moving = on @ self._carries.T > 0
            distance = self.kernel.link_distances(
                place[rows],
                turn[rows],
                posture_of(tables, commands[rows]),
                asked=np.concatenate([moving, np.zeros((len(rows), 1), dtype=bool)], axis=1),
                enough=FURTHEST,
            )[0][:, :-1]
            distance = distance - self.gap
            # A touching link that still moves stops the motors of its own joint and of those before it.
            touching = moving & (distance <= self.gap)
            on &= touching @ self._carries == 0
            moving = on @ self._carries.T > 0
            # The distance of a link divided by its speed bounds how far its finger may go on.
            room = np.where(moving, distance / np.maximum(self._speed, 1e-9), np.inf)
            step = np.full((len(rows), len(tables.fingers)), np.inf)
            for f in range(len(tables.fingers)):
                own = slice(tables.joint_start[f], tables.joint_start[f + 1])
                step[:, f] = room[:, own].min(axis=1)
            step = np.clip(step, 2e-3, 0.25)
            forward = np.where(on, step[:, self._finger_of_motor] * self._rate, 0.0)
            told = np.clip(
                commands[rows] + forward,
                np.maximum(low, np.minimum(commands[rows], last[rows])),
                np.minimum(high, np.maximum(commands[rows], last[rows])),
            )
            on &= np.abs(told - commands[rows]) > 1e-9
            commands[rows], active[rows] = told, on
        return commands

    def _back_open(self, place: Array, turn: Array, opened: Array, closed: Array) -> Array:
        """(n, m) commands [rad] where the motors that touch nothing are open again, if that is clear."""
        if not len(place):
            return closed
        distance = self.kernel.link_distances(place, turn, posture_of(self.tables, closed))[0][:, :-1]
        # (n, m) whether a link that the motor carries touches, and whether one is in its way when it is open.
        idle = (distance <= self.near) @ self._carries == 0
        back = np.where(idle, opened, closed)
        distance = self.kernel.link_distances(place, turn, posture_of(self.tables, back))[0][:, :-1]
        blocked = (distance < self.gap) @ self._carries > 0
        finger = self._finger_of_motor
        stays = (idle & blocked) @ (finger[:, None] == finger) > 0
        return np.where(stays, closed, back)

    def contacts(self, hands: Candidates, grasp: Array) -> tuple[IntArray, IntArray]:
        """(n, c) touching spheres, the thumb's first and the palm's last, and the joints that carry them."""
        n, tables = len(hands), self.tables
        distance, sphere = self.kernel.link_distances(hands.place, hands.turn, grasp)
        spheres = np.full((n, MOST_CONTACTS), -1, dtype=np.int64)
        links = np.full((n, MOST_CONTACTS), ON_PALM, dtype=np.int64)
        t = tables.thumb
        joints = np.arange(len(tables.axis))
        order = np.concatenate([joints[self._finger == t][::-1], joints[self._finger != t]])
        order = order[: MOST_CONTACTS - PALM_CONTACTS]
        touching = (distance[:, order] <= self.near) & (sphere[:, order] >= 0)
        place = np.argsort(~touching, axis=1, kind="stable")
        counts = touching.sum(axis=1)
        used = np.arange(len(order)) < counts[:, None]
        spheres[:, : len(order)] = np.where(used, np.take_along_axis(sphere[:, order], place, axis=1), -1)
        links[:, : len(order)] = np.where(used, order[place], ON_PALM)
        near_palm = np.flatnonzero(distance[:, -1] <= self.near)
        if len(near_palm):
            R = rotations(hands.turn[near_palm])
            palm = tables.palm[: tables.palm_spheres]
            x = hands.place[near_palm, None] + np.einsum("nij,sj->nsi", R, palm[:, :3])
            away = field_distance(self.field, x.reshape(-1, 3)).reshape(x.shape[:2]) - palm[:, 3]
            for row, d in zip(near_palm, away, strict=True):
                for s in self._apart(d):
                    spheres[row, counts[row]] = s
                    counts[row] += 1
        return spheres, links

    def _apart(self, distance: Array) -> list[int]:
        """Up to four spheres of the palm that touch, the nearest first, apart from each other."""
        found: list[int] = []
        centres = self.tables.palm[:, :3]
        for s in np.argsort(distance, kind="stable"):
            if distance[s] > self.near or len(found) == PALM_CONTACTS:
                break
            if all(np.linalg.norm(centres[s] - centres[other]) > PALM_APART for other in found):
                found.append(int(s))
        return found

    def _palm_front(self) -> Array:
        """(k, 3) foremost points of the palm that no other sphere of it covers, palm frame [m]."""
        palm = self.tables.palm[: self.tables.palm_spheres]
        front = palm[:, :3] - palm[:, 3:] * [0.0, 1.0, 0.0]
        aside = np.linalg.norm((palm[:, None, :3] - palm[None, :, :3])[..., [0, 2]], axis=2)
        ahead = (palm[:, 1] - palm[:, 3])[:, None] - (palm[:, 1] - palm[:, 3])[None] > 0.002
        covered = (ahead & (aside < palm[None, :, 3])).any(axis=1)
        return np.asarray(front[~covered])


def _spots(rng: np.random.Generator, mesh: TriangleMesh, count: int) -> tuple[Array, IntArray]:
    """(count, 3) random points of the surface [m], by area, and (count,) their triangles."""
    triangle = rng.choice(len(mesh.areas), size=count, p=mesh.areas / mesh.areas.sum())
    u, v = rng.random((2, count))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    corners = mesh.corners[triangle]
    spot = corners[:, 0] + u[:, None] * (corners[:, 1] - corners[:, 0])
    return spot + v[:, None] * (corners[:, 2] - corners[:, 0]), triangle
