"""The ray analyser: virtual grasps by ray casting (§2.3, §3.3), the paper's performance element.

Each finger is a ray along the opposition axis, aimed at (v · half-extent along a, tᵢ along t). The thumb
comes from the +o side at t = 0, the fingers from the -o side; in a flipped grasp the sides are exchanged.
The forefinger stands opposite the thumb, at t = 0 [P]; the next fingers stand beside it, at +t and then -t
[C]. The contact is the point where the ray first hits the object from outside. A virtual grasp exists if
the rays of all its fingers hit; a lid over a hole of the surface is nothing to hit. Rules may forbid contacts
at some places; the virtual grasps that have one there are refused, and counted. What the links of a hand are
near is seen only when a hand is put on the virtual grasp.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from ..exceptions import ObjectError
from ..kernels.rays import MISS, Hits, RayCaster, distance_to
from ..objects.checks import other_units
from ..objects.mesh import TriangleMesh
from ..types import Array, BoolArray, ContactCoefficients, Experience, IntArray, told_apart, value
from .analyser import Aim, Exploration, Grasp, GraspContacts, HandLayout, VirtualGrasp
from .fuzzy import FuzzySets, approaching_degrees
from .planes import APPROACH_AXES, OPPOSITION_AXES, TRANSVERSE_AXES, plane
from .wrench import FINGER, THUMB, contact_wrenches, net_wrench, screw_measures

_CACHED_AIMS = 40
"""Number of cached aims: task correction alternates between the planes."""

# On a symmetric object, a ray may hit an edge or a vertex exactly. The facets that meet there are those that
# rays on a ring of this radius, a fraction of the largest extent (1 to 2 µm), hit around it.
_RING_RADIUS = 1e-5
# No spoke lies along an axis or a diagonal, where edges are likely; the ring has the symmetry of the axes.
_SPOKES = np.pi / 8 + np.pi / 4 * np.arange(8)

_SMOOTH = np.cos(np.radians(50.0))
"""Facets at a smaller angle approximate one smooth surface [C]; an octagonal cylinder has 45°."""

# Places along t that a finger can aim at: opposite the thumb, beside that at +t, and at -t.
_PLACES = {2: [0], 3: [0, 1], 4: [0, 1, 2]}


class PointRules(Protocol):
    """Rules about where contacts may be (:class:`preshape.closure.contact_places.ContactPlaces`)."""

    @property
    def names(self) -> tuple[str, ...]:
        """Each of the m rules in words."""

    def broken(self, points: Array) -> BoolArray:
        """(n, m) which rules contacts at points (n, 3) [m] would break."""


@value
class _Field:
    """Contacts at every place of an aim. Array axes: plane P, value V, side 2 (+o, -o), place 3, rule m."""

    origin: Array  # (P, V, 2, 3, 3)
    point: Array  # (P, V, 2, 3, 3)
    normal: Array  # (P, V, 2, 3, 3)
    triangle: IntArray  # (P, V, 2, 3)
    hit: BoolArray  # (P, V, 2, 3)
    broken: BoolArray  # (P, V, 2, 3, m): rules that a contact there breaks
    fits: BoolArray  # (P, V, 3): whether 1, 2, 3 fingers fit side by side
    as_finger: Array  # (P, V, 2, 3, 6): contact wrenches about the COG
    as_thumb: Array  # (P, V, 2, 6): of the middle place, as the thumb


@value
class _Survey:
    """The virtual grasps of an aim; they do not depend on the task."""

    index: IntArray
    values: Array
    field: _Field
    rows: tuple[IntArray, BoolArray, Array, IntArray]  # plane, flip, approach value, fingers
    wrench: Array
    tried: int
    refused: IntArray  # (m,) virtual grasps that break each rule


NO_HIT = "at no aim do the rays of the thumb and of all fingers hit the object"
"""Why there is no virtual grasp."""


@value
class RayExploration(Exploration):
    """The virtual grasps that the ray analyser found.

    Attributes:
        analyser: The analyser that found them.
        task: (6,) the task Q that they were matched with.
    """

    analyser: RayAnalyser
    task: Array
    reason: str = NO_HIT

    @property
    def summary(self) -> str:
        """How many virtual grasps were found."""
        return f"{self.tried} aims were tried and {len(self)} virtual grasps found"

    def grasp(self, index: int = 0) -> VirtualGrasp:
        """One virtual grasp in full: contacts, wrenches, matching degrees, screw measures."""
        return self.analyser.virtual_grasp(
            self.task,
            int(self.plane[index]),
            bool(self.flip[index]),
            float(self.value[index]),
            int(self.fingers[index]),
        )


class RayAnalyser:
    """Virtual grasps of one object with one hand.

    Args:
        mesh: The object.
        layout: The hand.
        coefficients: Contact coefficients Ka, Ko, Kn, Mn.
        sets: Membership functions.
        rules: Rules about where contacts may be; ``None`` for none.
        cast: Returns the first hits of rays; by default the ray caster of the object.

    Raises:
        ObjectError: An extent of the object is over 4U.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        layout: HandLayout,
        *,
        coefficients: ContactCoefficients | None = None,
        sets: FuzzySets | None = None,
        rules: PointRules | None = None,
        cast: Callable[[Array, Array], Hits] | None = None,
    ) -> None:
        _refuse_large(mesh, layout)
        self.mesh = mesh
        self.layout = layout
        self.coefficients = coefficients or ContactCoefficients()
        self.sets = sets or FuzzySets()
        self._rules = rules
        self._cast = cast or RayCaster(mesh).cast
        self._radius = float(mesh.extents.max()) * _RING_RADIUS
        self._cache: dict[tuple[bytes, ...], _Survey] = {}

    measure = "TFVADI"
    patience = 1000

    def explore(self, q: Array, aim: Aim) -> RayExploration:
        """All virtual grasps of an aim, best match first.

        Args:
            q: (6,) task Q.
            aim: Where to look.

        Raises:
            InputError: A plane, finger count or approach value that does not exist.
        """
        survey = self._survey(aim)
        index, flip, values, fingers = survey.rows
        return RayExploration(
            plane=index,
            flip=flip,
            value=values,
            fingers=fingers,
            wrench=survey.wrench,
            match=approaching_degrees(q, survey.wrench, self.sets).sum(axis=-1),  # eq. 22
            tried=survey.tried,
            analyser=self,
            task=q,
            reason=NO_HIT + self._cost(survey.refused),
        ).best_first()

    def forget(self) -> None:
        """Clear the cache of aims."""
        self._cache.clear()

    def recall(self, q: Array, lessons: Sequence[Experience]) -> list[VirtualGrasp]:
        """The virtual grasps of lessons on the current mesh; grasps without contacts there are left out."""
        found = []
        for e in lessons:
            aim = Aim(planes=[e.plane], values=[e.approach_value], fingers=[e.fingers], flips=[e.flip])
            found.append(self.explore(q, aim))
        return [each.grasp() for each in found if len(each)]

    def heaviest(self, q: Array, grasp: Grasp) -> None:
        """``None``: a virtual grasp says nothing about loads."""

    def shortfall(self, q: Array, grasp: Grasp) -> str:
        """Empty, because the plan's warnings compare net wrench and task and show what is lacking."""
        return ""

    def _survey(self, aim: Aim) -> _Survey:
        """All virtual grasps of an aim, without their match; the last few aims are cached."""
        index = np.array(aim.planes, dtype=np.int64)
        values = np.array(aim.values, dtype=np.float64)
        counts = np.array(aim.fingers, dtype=np.int64)
        flips = np.array(aim.flips, dtype=bool)
        key = (index.tobytes(), values.tobytes(), counts.tobytes(), flips.tobytes())
        if key in self._cache:
            return self._cache[key]
        aim.check()
        field = self._aim(index, values)
        shape = (len(index), len(values), len(flips), len(counts))
        refused = np.zeros(field.broken.shape[-1], dtype=np.int64)
        wrench = np.zeros((*shape, 6))
        valid = np.zeros(shape, dtype=bool)
        for i, j in np.ndindex(len(flips), len(counts)):
            thumb, other = (1, 0) if flips[i] else (0, 1)
            places = _PLACES[int(counts[j])]
            fingers = field.as_finger[:, :, other, places].sum(axis=2)
            wrench[:, :, i, j] = field.as_thumb[:, :, thumb] + fingers
            valid[:, :, i, j] = (
                field.hit[:, :, thumb, 0]
                & field.hit[:, :, other, places].all(axis=2)
                & field.fits[:, :, counts[j] - 2]
            )
            broken = field.broken[:, :, thumb, 0] | field.broken[:, :, other, places].any(axis=2)
            refused += (valid[:, :, i, j, None] & broken).sum(axis=(0, 1))
            valid[:, :, i, j] &= ~broken.any(axis=-1)
        p, v, f, c = np.nonzero(valid)
        if len(self._cache) >= _CACHED_AIMS:
            del self._cache[next(iter(self._cache))]
        self._cache[key] = survey = _Survey(
            index=index,
            values=values,
            field=field,
            rows=(index[p], flips[f], values[v], counts[c]),
            wrench=wrench[p, v, f, c],
            tried=valid.size,
            refused=refused,
        )
        return survey

    def _cost(self, refused: IntArray) -> str:
        """How many virtual grasps each rule refused and what would help, as the end of a sentence."""
        if self._rules is None or not refused.any():
            return ""
        counts = zip(self._rules.names, refused.tolist(), strict=True)
        costs = " and ".join(f"{count} for the rule to {name}" for name, count in counts if count)
        helps = "another part, or --rules none for rules that were not asked for, may help"
        return f" where they may touch it; refused were {costs}: {helps}"

    def virtual_grasp(self, q: Array, number: int, flip: bool, v: float, fingers: int) -> VirtualGrasp:
        """One virtual grasp in full: contacts, wrenches, matching degrees, screw measures.

        Args:
            q: (6,) task Q.
            number: Index of the approach plane, 1..12.
            flip: Whether the thumb stands on the -o side.
            v: Approach value, -1..1.
            fingers: Virtual fingers, thumb included, 2..4.
        """
        field, at = self._at(number, v)
        thumb, other = (1, 0) if flip else (0, 1)
        side = np.array([thumb] + [other] * (fingers - 1))
        place = np.array([0, *_PLACES[fingers]])

        def pick(array: Array) -> Array:
            return array[at][side, place]

        wrenches = pick(field.as_finger)
        wrenches[0] = field.as_thumb[at][thumb]
        net = net_wrench(wrenches)
        adi = approaching_degrees(q, net, self.sets)
        stability, manipulability = screw_measures(wrenches)
        return VirtualGrasp(
            plane=plane(number),
            flip=flip,
            approach_value=v,
            approach_set=self.sets.name_index(v),
            fingers=fingers,
            contacts=GraspContacts(
                points=pick(field.point),
                normals_in=pick(field.normal),
                triangles=field.triangle[at][side, place],
                wrenches=wrenches,
            ),
            net_wrench=net,
            adi=adi,
            tfvadi=float(adi.sum()),
            stability=stability,
            manipulability=manipulability,
            ray_origins=pick(field.origin),
        )

    def _at(self, number: int, v: float) -> tuple[_Field, tuple[int, int]]:
        """A cached or new field with this plane and approach value, and the indices of both in that field."""
        for survey in reversed(self._cache.values()):
            p = np.flatnonzero(survey.index == number)
            i = np.flatnonzero(survey.values == v)
            if len(p) and len(i):
                return survey.field, (int(p[0]), int(i[0]))
        return self._aim(np.array([number]), np.array([v])), (0, 0)

    def _aim(self, index: IntArray, values: Array) -> _Field:
        """Cast the rays of all planes and values at once."""
        a, o, t = (axes[index - 1] for axes in (APPROACH_AXES, OPPOSITION_AXES, TRANSVERSE_AXES))
        half = self.mesh.extents / 2
        half_a, half_o, half_t = (np.abs(axes) @ half for axes in (a, o, t))
        target = self.mesh.cog + (half_a[:, None] * values)[..., None] * a[:, None]  # (P, V, 3)
        offsets, fits = self._spread(self._room(target, t, half_t))
        sides = np.stack([o, -o], axis=1)  # (P, 2, 3): where the rays come from
        start = sides * (2.0 * half_o)[:, None, None]
        origin = (
            target[:, :, None, None]
            + start[:, None, :, None]
            + offsets[:, :, None, :, None] * t[:, None, None, None]
        )
        direction = np.broadcast_to(-sides[:, None, :, None], origin.shape)
        point, normal, triangle = self._hit(origin, direction)
        as_finger, as_thumb = self._wrenches(point, normal, a, t)
        rules = 0 if self._rules is None else len(self._rules.names)
        broken = np.zeros((*triangle.shape, rules), dtype=bool)
        if self._rules is not None:
            broken[triangle != MISS] = self._rules.broken(point[triangle != MISS])
        return _Field(
            origin=origin,
            point=point,
            normal=normal,
            triangle=triangle,
            hit=(triangle != MISS) & ~self.mesh.is_lid[triangle],
            broken=broken,
            fits=fits,
            as_finger=as_finger,
            as_thumb=as_thumb,
        )

    def _room(self, target: Array, t: Array, half_t: Array) -> Array:
        """(P, V, 2) the object's reach along +t and -t from each aim [m]; half the extent if rays miss."""
        sides = np.stack([t, -t], axis=1)  # (P, 2, 3)
        origin = target[:, :, None] + (sides * (2.0 * half_t)[:, None, None])[:, None]
        direction = np.broadcast_to(-sides[:, None], origin.shape)
        point, _, triangle = self._hit(origin, direction)
        aside = np.einsum("pvsi,pvsi->pvs", point - target[:, :, None], -direction)
        met = (triangle != MISS).all(axis=2) & (aside > 0).all(axis=2)
        whole = half_t[:, None, None]
        return np.where(met[..., None], np.minimum(aside, whole), whole)

    def _hit(self, origin: Array, direction: Array) -> tuple[Array, Array, IntArray]:
        """First contact of each ray, which runs along a coordinate axis.

        Where facets of a smooth surface meet, the normal is the mean over those that the finger can touch, so
        it does not depend on where the surface is divided into facets. At a sharp edge one side counts.

        Returns:
            (..., 3) point [m], the ray's origin if it misses; (..., 3) inward normal, zero if it misses; and
            (...) one of the triangles that meet there, -1 if the ray misses.
        """
        origins, directions = origin.reshape(-1, 3), direction.reshape(-1, 3)
        # 1. Cast the rays of a ring around each ray. Axis 0 of the arrays is the ring.
        across = [np.roll(np.abs(directions), shift, axis=1) for shift in (1, 2)]
        ring = np.multiply.outer(np.cos(_SPOKES), across[0]) + np.multiply.outer(np.sin(_SPOKES), across[1])
        aside = origins + self._radius * ring
        along = np.broadcast_to(directions, aside.shape)
        hits = self._cast(aside.reshape(-1, 3), along.reshape(-1, 3))
        triangle, reach = (array.reshape(aside.shape[:2]) for array in (hits.triangle, hits.distance))
        # 2. A triangle's plane gives the distance along the true ray, unless they are almost parallel.
        met, near = triangle != MISS, 10 * self._radius
        centre = np.broadcast_to(origins, aside.shape).reshape(-1, 3)
        true = distance_to(self.mesh, hits.triangle, centre, along.reshape(-1, 3)).reshape(reach.shape)
        flat = np.abs(np.subtract(true, reach, out=np.zeros_like(true), where=met)) <= near
        depth = np.where(flat, true, reach)
        # 3. Of what the ring hits, the nearest is the contact; of equally near ones, the first on the ring,
        # or a lid if there is one, because half of the finger would touch nothing.
        front = depth <= depth.min(axis=0) + near
        lid = self.mesh.is_lid[triangle] & met
        first = np.argmax(front * (1 + lid), axis=0), np.arange(len(origins))
        # The inward normal points along the ray, whichever way the triangles of a scan are wound.
        normals = self.mesh.normals[triangle]
        slope = np.einsum("kni,kni->kn", normals, along)
        normals = np.where(slope[..., None] < 0, -normals, normals)
        # 4. The flat facets beside it form one smooth surface with it, unless they meet it at a sharp edge.
        smooth = np.einsum("kni,ni->kn", normals, normals[first]) >= _SMOOTH
        meets = met & flat & front & smooth
        meets[first] = met[first]
        normal = np.einsum("kn,kni->ni", meets, normals)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
        hit = met[first][:, None]
        begin = np.where(flat[first][:, None], origins, aside[first])
        point = np.where(hit, begin + np.where(hit, depth[first][:, None], 0.0) * directions, origins)
        shape = origin.shape
        return point.reshape(shape), normal.reshape(shape), triangle[first].reshape(shape[:-1])

    def _spread(self, reach: Array) -> tuple[Array, BoolArray]:
        """(P, V, 3) offsets of the places along t [m], and (P, V, 3) whether 1, 2, 3 fingers fit.

        The fingers beside the forefinger stand at the hand's finger pitch, or closer where the object ends
        sooner, but at least one fingertip width from it [C].

        Args:
            reach: (P, V, 2) the object's reach along +t and -t [m].
        """
        width, pitch = self.layout.fingertip_width, self.layout.finger_pitch
        aside = np.minimum(pitch, np.maximum(width, reach - width / 2))
        zero = np.zeros_like(aside[..., :1])
        offsets = np.concatenate([zero, aside[..., :1], -aside[..., 1:]], axis=-1)
        across = 2.0 * reach.min(axis=-1)
        fits = np.stack([across >= k * width - 1e-9 for k in (0, 2, 3)], axis=-1)
        return offsets, fits

    def _wrenches(self, point: Array, normal: Array, a: Array, t: Array) -> tuple[Array, Array]:
        """Contact wrenches about the COG: at every place for a finger, and at the middle for the thumb."""
        r = (point - self.mesh.cog) / self.layout.length_unit
        axes = (a[:, None, None], t[:, None, None])
        as_finger = contact_wrenches(r, normal, *axes, np.array([FINGER]), self.coefficients)
        middle = (r[..., :1, :], normal[..., :1, :])
        as_thumb = contact_wrenches(*middle, *axes, np.array([THUMB]), self.coefficients)
        return as_finger, as_thumb[..., 0, :]


_FAR = 5.0  # an object that exceeds the limit by more may be in another unit [C]


def _refuse_large(mesh: TriangleMesh, layout: HandLayout) -> None:
    limit = layout.length_unit
    largest = float(mesh.extents.max())
    if largest > limit * (1 + 1e-9):
        axis = "xyz"[int(np.argmax(mesh.extents))]
        told, most = told_apart(largest * 1000, limit * 1000, digits=0)
        far = largest > _FAR * limit
        units = other_units(mesh.extents, mesh.unit, layout.fingertip_width / 2, limit) if far else ""
        raise ObjectError(
            f"{mesh.name} measures {told} mm along {axis}, over the {most} mm (4U) that the ray analyser "
            f"allows the {layout.name} hand; "
            f"{units or 'the closure analyser (--analyser closure) has no such limit, or take a larger hand'}"
        )
