"""The closure analyser: a performance element that closes the real hand instead of casting rays (ENGINE §2).

It answers the controller as the ray analyser does. An aim is a set of approach planes, values and numbers of
fingers; candidates are drawn there, closed, ranked by their margin for the task, refined, and the best that
stand apart are worked out in full. TFVADI is computed for each beside the margin.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from ..exceptions import InputError
from ..hands.hand import Hand
from ..hiis.analyser import Aim, Grasp, GraspContacts, Grip, HandLayout
from ..hiis.fuzzy import FuzzySets, approaching_degrees
from ..hiis.planes import plane
from ..hiis.wrench import contact_wrenches, net_wrench, screw_measures
from ..kernels.field.host import SurfaceQuery, prepare_field
from ..objects.mesh import TriangleMesh
from ..tasks.task import ROTATION_ABSENT, TRANSLATION_ABSENT
from ..types import KEPT, Array, ContactCoefficients, Experience, IntArray, frozen_array
from .grip import ENOUGH, Finished, Finisher
from .grips import GripExploration, grip_exploration
from .holding import inner_centre, turn_levers
from .pinches import hand_pinches
from .pinching import PINCHED, Pincher
from .ranked import Ranked, apart, beside, best_of, joined, take
from .recalling import FEW, MAX_FINGERS, recalled
from .sampling import Sampled, sample
from .search import ClosureSearch, Demand
from .settings import ClosureSettings
from .spots import THINNEST, find_spots

ASIDE = 0.5
"""Torque of a task's load over its force, in ℓ (ENGINE §4)."""
WANTED = 2
"""Contacts that a grip must have, the thumb's included; the margin decides whether they are enough."""
AS_GOOD = 0.95
"""A grip of experience that is this share as good as it was is the answer of mode 0 [C]."""
LIKELY, TRIED = 8, 2
"""Remembered grips that are looked at, and that are worked out: those that rank first on this object [C]."""
EASY, FEWEST = 1.5, 100
"""More candidates are drawn where the best margin is under ``EASY`` or fewer than ``FEWEST`` closed, and the
best are refined again where it still is [C]."""
_KEPT = 24
_HAND_FIELDS = tuple({f.name for f in fields(Grip)} - {f.name for f in fields(Grasp)})


class ClosureAnalyser:
    """Grips of one object with one real hand.

    Args:
        mesh: the object.
        hand: the hand.
        layout: what the controller knows of it.
        settings: friction, load, size of the search.
        coefficients: the paper's contact model, for TFVADI.
        sets: membership functions.
        gravity: (3,) its unit direction in the mesh frame, zeros for none.
        seed: of the draws.
        known: experiences of this hand that grips may be recalled from.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        hand: Hand,
        layout: HandLayout,
        *,
        settings: ClosureSettings | None = None,
        coefficients: ContactCoefficients | None = None,
        sets: FuzzySets | None = None,
        gravity: Array | Sequence[float] = (0.0, 0.0, -1.0),
        seed: int = 0,
        known: Callable[[], Sequence[Experience]] = tuple,
    ) -> None:
        self.mesh, self.hand, self.layout = mesh, hand, layout
        self.settings = settings or ClosureSettings()
        self.coefficients = coefficients or ContactCoefficients()
        self.sets = sets or FuzzySets()
        self.gravity = np.asarray(gravity, dtype=np.float64)
        self.seed, self._known = seed, known
        self.field = prepare_field(mesh)
        self.query = SurfaceQuery(mesh, device=self.settings.device)
        self.middle = inner_centre(self.field, mesh)
        length = float(mesh.extents.max()) / 2
        self.search = ClosureSearch(
            hand, self.field, self.middle, length, self.settings, turns=turn_levers(mesh, self.middle, length)
        )
        pinches = hand_pinches(hand)
        spots = find_spots(mesh, self.field, float(pinches.tip[0]), pinches.widest)
        self.pincher = Pincher(pinches, spots, mesh.cog, mesh.extents / 2, self.search.kernel)
        self.finisher = Finisher(self.search, self.query)
        self._kept: dict[bytes, GripExploration] = {}
        self._everywhere: set[bytes] = set()  # tasks for which all planes that are allowed were looked at
        self._asked: tuple[bytes, Demand] | None = None

    measure = "the grip's quality (3 is just enough)"
    patience = 8

    @property
    def tried(self) -> int:
        """Candidates closed for all aims that are kept."""
        return sum(found.tried for found in self._kept.values())

    def demand(self, q: Array) -> Demand:
        """What a task asks of a grip: its wrench, the load along it, and the weight.

        The same object for the same task: kernels are kept for it.
        """
        if self._asked is None or self._asked[0] != q.tobytes():
            self._asked = q.tobytes(), self._demand(q)
        return self._asked[1]

    def _demand(self, q: Array) -> Demand:
        move = np.where(np.abs(q[:3]) > TRANSLATION_ABSENT + 1e-9, q[:3], 0.0)
        turn = np.where(np.abs(q[3:]) > ROTATION_ABSENT + 1e-9, q[3:], 0.0)
        force = move / np.linalg.norm(move) if move.any() else move
        torque = ASIDE * turn / np.linalg.norm(turn) if turn.any() else turn
        direction = np.concatenate([force, torque])
        base = np.append(-self.gravity * self.settings.weight / self.settings.middling, np.zeros(3))
        if not direction.any():
            return Demand(base=base)
        return Demand(direction=direction, base=base, load=float(np.linalg.norm(direction)))

    def explore(self, q: Array, aim: Aim) -> GripExploration:
        """The best grips of an aim for a task, best first; every one of them can be executed.

        Args:
            q: (6,) task Q.
            aim: where to look.
        """
        task = frozen_array(q, (6,), "task Q")
        _check(aim)
        key = task.tobytes() + _key(aim)
        elsewhere = len(aim.planes) == 1 and not self._settled(task)
        if len(aim.planes) == 1:  # experience may have come since, and is asked first
            key += len(self._known()).to_bytes(8, "little") + bytes([elsewhere, *aim.recall])
        if key not in self._kept:
            if len(self._kept) >= _KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = self._explore(task, aim, elsewhere)
        if len(aim.planes) > 1:
            self._everywhere.add(task.tobytes())
        return self._kept[key]

    def _explore(self, q: Array, aim: Aim, elsewhere: bool) -> GripExploration:
        if self.mesh.extents.max() < THINNEST:
            size = f"{1e3 * self.mesh.extents.max():.2g} mm long, under the {1e3 * THINNEST:.0f} mm"
            return grip_exploration([], 0, f"the object is {size} that fingers are placed to; check its unit")
        demand, settings = self.demand(q), self.settings
        known = recalled(self._known(), self.mesh, q, aim, joints=len(self.hand.joints), sets=self.sets)
        part = len(aim.planes) == 1
        few = part and len(aim.values) <= FEW
        how: dict[str, Any] = {"wanted": WANTED, "elsewhere": elsewhere}
        remembered, asked = list[Finished](), 0
        if few and known is not None:
            own, rest = np.split(np.arange(len(known.aimed)), [known.first])
            for rows in (own, rest):
                asked += len(rows)
                remembered += self._again(demand, take(known.sampled, rows), aim, **how)
                if _worth(remembered) >= max(AS_GOOD * known.bar, ENOUGH):
                    best = max(remembered, key=lambda made: made.quality)
                    return grip_exploration(self.grips(q, [best]), asked)
        rng = np.random.default_rng([self.seed, zlib.crc32(_key(aim))])
        count, elite, rounds, enough = self._effort(aim)
        drawn = self._draw(rng, aim, count)
        if known is not None and known.aimed.any():
            drawn = joined(drawn, take(known.sampled, np.flatnonzero(known.aimed)))
        found = self._evaluate(drawn, demand)
        if not part:
            found = self._persist(rng, aim, found, demand, settings.persistence)
        how |= {"enough": enough, "planes": aim.planes}
        finished, last, pool = list[Finished](), found, found
        last_round = 0 if part else settings.persistence
        for again in range(1 + last_round):
            found = self.search.refine(
                rng, found, demand, elite=elite, each=settings.children, rounds=rounds, wanted=WANTED
            )
            standing = found.take(apart(found, max(8, 4 * enough)))
            standing = self.search.steady(rng, standing, demand, samples=4 if few else 8, wanted=WANTED)
            made = self.finisher.finish(standing, demand, by_joints=again > 0, **how)
            if not again or _best(made) > _best(finished):
                finished, last = made, standing
            if _best(finished) >= EASY or again == last_round:
                break
            if len(made) < enough:  # all were looked at: what fails leads nowhere
                done = [one.row for one in made]
                found = beside(found, standing, done)
                more = self._persist(rng, aim, beside(pool, standing, done), demand, times=1)
                fresh = replace(more, tried=more.tried - pool.tried, blocked=more.blocked - pool.blocked)
                found, pool = best_of(found, fresh), more
        if not elsewhere and _best(finished) < 1.0:
            finished = self.finisher.finish(last, demand, by_joints=True, firm=True, **how)
        grips = self.grips(q, sorted([*remembered, *finished], key=lambda made: -made.margin))
        grips.sort(key=lambda g: -g.judged)
        return grip_exploration(grips[:enough], asked + found.tried, self._why_none(found))

    def _why_none(self, found: Ranked) -> str:
        """What became of the candidates, where none of them became a grip."""
        n = len(found) + found.blocked
        if not n:
            return f"of {found.tried} hands tried, none closes on the object with thumb and finger"
        closed = f"of {found.tried} hands tried, {n} close on the object"
        if not len(found):
            return f"{closed}, all of them in the table or a box to keep out of"
        blocked = f", {found.blocked} of them in the table or a box to keep out of" if found.blocked else ""
        if found.score[0] <= 0:
            rest = "none of the rest balances" if blocked else "none balances"
            return f"{closed}{blocked}; {rest} the load at {self.settings.mu:.2f} friction"
        return (
            f"{closed}{blocked}; those that balance the load cannot be opened and brought in without touching"
        )

    def _again(self, demand: Demand, known: Sampled, aim: Aim, **how: Any) -> list[Finished]:
        """What becomes of remembered grips on this object."""
        if not len(known.plane):
            return []
        found = self._evaluate(known, demand)
        likely = found.take(apart(found, LIKELY))
        planes = sorted({*aim.planes, *aim.recall})
        firm = not how["elsewhere"]
        return self.finisher.finish(likely, demand, planes=planes, firm=firm, enough=TRIED, **how)

    def _settled(self, q: Array) -> bool:
        """Whether everything was looked at for a task: here, or when this very object was taught it."""
        asked, extents = q.tobytes(), self.mesh.attributes.extents
        return asked in self._everywhere or any(
            e.kind != KEPT
            and e.task.tobytes() == asked
            and np.allclose(e.attributes.extents, extents, rtol=1e-6)
            for e in self._known()
        )

    def _persist(
        self, rng: np.random.Generator, aim: Aim, found: Ranked, demand: Demand, times: int
    ) -> Ranked:
        """More draws for an object on which the first ones found little."""
        for _ in range(times):
            best = float(found.score[0]) if len(found) else 0.0
            if best * self.settings.strongest >= EASY * self.settings.weight and len(found) >= FEWEST:
                break
            more = self._evaluate(self._draw(rng, aim, 2 * self.settings.everywhere), demand)
            found = best_of(found, more)
        return found

    def _effort(self, aim: Aim) -> tuple[int, int, int, int]:
        """Candidates, elite, rounds, grips: few where experience points, many where nothing is known."""
        s = self.settings
        if len(aim.planes) > 1:
            return s.everywhere, s.elite, s.rounds, s.finished
        if len(aim.values) > FEW:
            return s.on_plane, max(1, s.elite // 2), s.rounds, min(s.finished, 4)
        return s.at_aim, max(1, s.elite // 4), min(1, s.rounds), 1

    def _draw(self, rng: np.random.Generator, aim: Aim, count: int) -> Sampled:
        fingers = [n for n in range(2, len(self.hand.fingers) + 1) if min(n, MAX_FINGERS) in aim.fingers]
        where: dict[str, Any] = {
            "planes": list(aim.planes),
            "flips": list(aim.flips),
            "values": list(aim.values) if len(aim.values) <= FEW else None,
            "fingers": fingers or None,
        }
        pinching = self.pincher.draw(rng, int(PINCHED * count), **where)
        anywhere = sample(
            rng,
            self.search.pool,
            self.mesh.cog,
            self.mesh.extents / 2,
            count - len(pinching.plane),
            **where,
        )
        return joined(pinching, anywhere)

    def _evaluate(self, sampled: Sampled, demand: Demand) -> Ranked:
        return self.search.evaluate(sampled, demand, wanted=WANTED)

    def grips(self, q: Array, finished: Sequence[Finished]) -> list[Grip]:
        """The finished grips with the paper's description: net wrench, TFVADI and indices of each.

        Args:
            q: (6,) task Q.
            finished: by this analyser's finisher.
        """
        if not finished:
            return []
        triangles = self.query.closest(np.concatenate([made.points for made in finished])).triangle
        ends = np.cumsum([len(made.points) for made in finished])[:-1]
        each = zip(finished, np.split(triangles, ends), strict=True)
        return [self._grip(q, made, own) for made, own in each]

    def _grip(self, q: Array, made: Finished, triangles: IntArray) -> Grip:
        p = plane(made.plane)
        a, t = p.approach_axis, p.transverse_axis
        arms = (made.points - self.mesh.cog) / self.layout.u
        signs = -np.sign(np.round(arms @ t, 9))
        signs[0] = -1.0
        wrenches = contact_wrenches(arms, made.normals_in, a, t, signs, self.coefficients)
        net = net_wrench(wrenches)
        adi = approaching_degrees(q, net, self.sets)
        stability, manipulability = screw_measures(wrenches)
        along = float(np.abs(a) @ self.mesh.extents) / 2
        v = float(np.clip((made.points.mean(axis=0) - self.mesh.cog) @ a / max(along, 1e-9), -1.0, 1.0))
        return Grip(
            plane=p,
            flip=made.flip,
            approach_value=v,
            approach_set=self.sets.name_index(v),
            fingers=min(len(made.points), MAX_FINGERS),
            contacts=GraspContacts(
                points=made.points,
                normals_in=made.normals_in,
                triangles=triangles,
                wrenches=wrenches,
            ),
            net_wrench=net,
            adi=adi,
            tfvadi=float(adi.sum()),
            stability=stability,
            manipulability=manipulability,
            **{name: getattr(made, name) for name in _HAND_FIELDS},
        )


def _check(aim: Aim) -> None:
    planes, values = np.asarray(aim.planes), np.asarray(aim.values, dtype=np.float64)
    if not planes.size or not ((planes >= 1) & (planes <= 12)).all():
        raise InputError(f"approach plane indices must be 1 to 12, got {planes.tolist()}")
    if not values.size or not (np.abs(values) <= 1).all():
        raise InputError(f"approach values must lie in -1..1, got {values.tolist()!s:.80}")
    counts = list(aim.fingers)
    if not counts or not all(2 <= n <= MAX_FINGERS for n in counts):
        raise InputError(f"virtual fingers must be 2 to {MAX_FINGERS}, got {counts}")
    if not len(aim.flips):
        raise InputError("an aim needs a thumb side at least")


def _best(finished: Sequence[Finished]) -> float:
    """The best margin among them."""
    return max((made.margin for made in finished), default=-1.0)


def _worth(finished: Sequence[Finished]) -> float:
    """The best quality among them."""
    return max((made.quality for made in finished), default=-1.0)


def _key(aim: Aim) -> bytes:
    """An aim as bytes: the same aim draws the same candidates."""
    parts = (aim.planes, np.round(np.asarray(aim.values, dtype=np.float64), 9), aim.fingers, aim.flips)
    return b"|".join(np.asarray(part, dtype=np.float64).tobytes() for part in parts)
