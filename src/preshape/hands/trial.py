"""A trial of a hand: it closes on a cylinder and on a cube, and what came about is said.

Only kinematics and distances are used: every finger closes along its path until it touches. An object is held
here if a finger touches it opposite the thumb, or opposite the palm. This finds hands that are consistent but
close beside each other or away from the object; it does not judge a grasp.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ..spatial import inverse, quaternion_from_rotation
from ..types import Array, IntArray, value
from .hand import Hand
from .kinematics import HandKinematics

SIZES = (0.06, 0.03)
"""Sizes of the objects that are tried, largest first [m]."""

_LONG = 0.06  # half length of the cylinder [m]
_TOUCH = 1e-3  # distance that counts as contact [m]
_INSIDE = 2e-3  # overlap of the open hand with the object that is still allowed [m]
_STEPS = 20  # steps along a closing path
_OPPOSED = -0.3  # largest cosine between two pushes that oppose each other [C]
_NEAR_PALM = 3e-3  # distance of the palm at which it counts as support [m] [C]
_FAR = 0.02  # distances beyond it are not computed [m]


@value
class ClosingTrial:
    """What came of closing on one kind of object.

    Attributes:
        shape: ``cylinder`` or ``cube``.
        size: Diameter or edge of the largest one that is held, else of the smallest one [m].
        touching: Names of the fingers that touch it.
        against: What they oppose: the name of the thumb, or ``palm``; empty if nothing opposes them.
    """

    shape: str
    size: float
    touching: tuple[str, ...]
    against: str

    def __str__(self) -> str:
        what = f"{self.shape} of {1000 * self.size:.0f} mm"
        if self.against:
            return f"{what}: held by {', '.join(self.touching)}, opposite the {self.against}"
        if self.touching:
            return f"{what}: only touched by {', '.join(self.touching)}; nothing opposes"
        return f"{what}: no finger touches it"


def trials(hand: Hand) -> tuple[ClosingTrial, ...]:
    """The trials on a cylinder across the fingers and on a cube, made once per hand."""
    return _made(hand)


@cache
def _made(hand: Hand) -> tuple[ClosingTrial, ...]:
    return tuple(_Closing(hand, shape).best() for shape in ("cylinder", "cube"))


class _Closing:
    """A hand with one object in front of it, in the palm frame.

    The places of all links along all closing paths are computed once. For each place of the object, exact
    distances are computed only where a sphere around the link comes near it.
    """

    def __init__(self, hand: Hand, shape: str) -> None:
        import mujoco

        self._mujoco, self.hand, self.shape = mujoco, hand, shape
        spec = mujoco.MjSpec.from_string(hand.mjcf)
        kind = mujoco.mjtGeom.mjGEOM_CYLINDER if shape == "cylinder" else mujoco.mjtGeom.mjGEOM_BOX
        spec.worldbody.add_geom(name="trial object", type=kind, size=[0.03, 0.03, 0.03])
        self.m = spec.compile()
        T = inverse(hand.T_root_palm)
        root = 1  # the MJCF of a hand has one root body
        self.m.body_pos[root], self.m.body_quat[root] = T[:3, 3], quaternion_from_rotation(T[:3, :3])
        self.d = mujoco.MjData(self.m)
        self.object = self.m.geom("trial object").id
        # The cylinder's axis lies across the fingers, along x of the palm frame.
        turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]) if shape == "cylinder" else np.eye(3)
        self.turn = turn.ravel()
        self.geoms = {finger.name: self._geoms_of(finger.joints) for finger in hand.fingers}
        moved = {g for geoms in self.geoms.values() for g in geoms}
        still = [g for g in range(self.m.ngeom) if g != self.object and g not in moved and self._solid(g)]
        self.palm = np.array(still, dtype=np.int64)
        self.places = {finger.name: self._along(k) for k, finger in enumerate(hand.fingers)}

    def _solid(self, g: int) -> bool:
        return bool(self.m.geom_contype[g] or self.m.geom_conaffinity[g])

    def _geoms_of(self, joints: tuple[str, ...]) -> IntArray:
        """Shapes that the joints of a finger move."""
        bodies = {int(self.m.joint(joint).bodyid[0]) for joint in joints}
        found = []
        for g in range(self.m.ngeom):
            body = int(self.m.geom_bodyid[g])
            while body > 0 and body not in bodies:
                body = int(self.m.body_parentid[body])
            if body > 0 and g != self.object and self._solid(g):
                found.append(g)
        return np.array(found, dtype=np.int64)

    def _along(self, k: int) -> tuple[Array, Array]:
        """(_STEPS + 1, n, 3) places and (_STEPS + 1, n, 9) turns of finger k's shapes along its path."""
        places, turns = [], []
        for c in np.linspace(0.0, 1.0, _STEPS + 1):
            shares = np.zeros(len(self.hand.fingers))
            shares[k] = c
            self.d.qpos[:] = self.hand.at(shares)
            self._mujoco.mj_kinematics(self.m, self.d)
            geoms = self.geoms[self.hand.fingers[k].name]
            places.append(self.d.geom_xpos[geoms].copy())
            turns.append(self.d.geom_xmat[geoms].copy())
        return np.array(places), np.array(turns)

    def best(self) -> ClosingTrial:
        """The trial of the largest size that is held; of the smallest size, if none is."""
        found = ClosingTrial(shape=self.shape, size=SIZES[-1], touching=(), against="")
        for size in SIZES:
            self.half = np.full(3, size / 2)
            if self.shape == "cylinder":
                self.half[0] = _LONG
            self.m.geom_size[self.object] = (size / 2, _LONG, 0.0) if self.shape == "cylinder" else self.half
            self.m.geom_rbound[self.object] = float(np.linalg.norm(self.half))
            for place in self._candidates(size):
                made = self._close(place, size)
                if (bool(made.against), len(made.touching)) > (bool(found.against), len(found.touching)):
                    found = made
                if found.against and len(found.touching) >= len(self.hand.fingers) - 1:
                    break
            if found.against:
                return found
        return found

    def _candidates(self, size: float) -> list[Array]:
        """Centres of the object, in the palm frame [m]: between the tips, and deeper in the hand."""
        kinematics = HandKinematics(self.hand)
        places = []
        for c in (0.15, 0.35, 0.55, 0.75):
            kinematics.set_posture(self.hand.at(c))
            tips = kinematics.tips(self.hand.fingers)[0]
            for k in (slice(1, None), slice(1, 2)):
                places.append((tips[0] + tips[k].mean(axis=0)) / 2)
        deeper = [place - [0.0, 0.0, 0.5 * size] for place in places]
        return [place for place in (*places, *deeper) if self._free(place)]

    def _free(self, place: Array) -> bool:
        """Whether the open hand does not meet the object."""
        self._set_object(place)
        self.d.qpos[:] = self.hand.at(0.0)
        self._mujoco.mj_kinematics(self.m, self.d)
        self._set_object(place)
        every = np.concatenate([*self.geoms.values(), self.palm])
        near = every[self._least(self.d.geom_xpos[every], every) < -_INSIDE]
        return all(self._gap(int(g))[0] > -_INSIDE for g in near)

    def _set_object(self, place: Array) -> None:
        self.place = place
        self.d.geom_xpos[self.object], self.d.geom_xmat[self.object] = place, self.turn

    def _least(self, centres: Array, geoms: IntArray) -> Array:
        """(...,) at most the distance of shapes with centres (..., 3) from the object's bounding box [m]."""
        outside = np.maximum(np.abs(centres - self.place) - self.half, 0.0)
        return np.asarray(np.linalg.norm(outside, axis=-1) - self.m.geom_rbound[geoms])

    def _gap(self, g: int) -> tuple[float, Array]:
        """Distance of a shape from the object [m], negative inside, and the unit vector towards it."""
        ends = np.zeros(6)
        gap = self._mujoco.mj_geomDistance(self.m, self.d, g, self.object, _FAR, ends)
        across = ends[3:] - ends[:3]
        length = float(np.linalg.norm(across))
        if length < 1e-9:
            across = self.place - ends[:3]
            length = max(float(np.linalg.norm(across)), 1e-9)
        return float(gap), across / length * (1.0 if gap >= 0 else -1.0)

    def _close(self, place: Array, size: float) -> ClosingTrial:
        """Close every finger until it touches the object at a place."""
        self._set_object(place)
        pushes = {}
        for finger in self.hand.fingers:
            push = self._touch(finger.name)
            if push is not None:
                pushes[finger.name] = push
        near = [self._gap(int(g)) for g in self.palm if self._least(self.d.geom_xpos[g], g) < _NEAR_PALM]
        near = [gap for gap in near if gap[0] < _NEAR_PALM]
        first = self.hand.fingers[0].name
        for against, push in (
            (first, pushes.get(first)),
            ("palm", min(near, key=lambda gap: gap[0])[1] if near else None),
        ):
            if push is None:
                continue
            if any(float(own @ push) < _OPPOSED for own in pushes.values()):
                names = tuple(name for name in pushes if name != against)
                return ClosingTrial(shape=self.shape, size=size, touching=names, against=against)
        return ClosingTrial(shape=self.shape, size=size, touching=tuple(pushes), against="")

    def _touch(self, finger: str) -> Array | None:
        """Unit vector of a finger's push where it first touches the object; ``None`` if it never does."""
        geoms, (places, turns) = self.geoms[finger], self.places[finger]
        least = self._least(places, geoms)
        for step in np.flatnonzero((least < _TOUCH).any(axis=1)):
            near = np.flatnonzero(least[step] < _TOUCH)
            self.d.geom_xpos[geoms[near]], self.d.geom_xmat[geoms[near]] = (
                places[step, near],
                turns[step, near],
            )
            gap, push = min((self._gap(int(g)) for g in geoms[near]), key=lambda found: found[0])
            if gap < _TOUCH:
                return push
        return None
