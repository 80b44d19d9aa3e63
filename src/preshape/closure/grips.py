"""Finished grips in the controller's form: with the paper's figures, collected for one aim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from ..hiis.analyser import MAX_FINGERS, Exploration, GraspContacts, Grip, GripPosture, HandLayout
from ..hiis.fuzzy import FuzzySets, approaching_degrees
from ..hiis.planes import plane
from ..hiis.wrench import grasp_wrenches, net_wrench, screw_measures
from ..objects.mesh import TriangleMesh
from ..types import Array, BoolArray, ContactCoefficients, IntArray, value
from .finish import FinishedGrip

_HAND_FIELDS = tuple(f.name for f in fields(GripPosture))


@value
class GripExploration(Exploration):
    """The grips that the closure analyser found.

    Attributes:
        grips: The grips, best first.
        miss: See :attr:`nearest_miss`.
    """

    grips: tuple[Grip, ...]
    miss: Grip | None = None

    @property
    def summary(self) -> str:
        """How many grips were found."""
        return f"{self.tried} candidates were tried and {len(self)} grips finished"

    @property
    def nearest_miss(self) -> Grip | None:
        """The best executable grip if none balances any of the load; otherwise ``None``."""
        return self.miss

    def where(self, keep: BoolArray | IntArray) -> GripExploration:
        """The grips picked by a mask or by indices, in that order."""
        rows = np.arange(len(self))[keep]
        return grip_exploration([self.grips[i] for i in rows], self.tried, self.reason)

    def grasp(self, index: int = 0) -> Grip:
        """One of the grips; the best by default."""
        return self.grips[index]


def grip_exploration(
    grips: Sequence[Grip], tried: int, reason: str = "", miss: Grip | None = None
) -> GripExploration:
    """The exploration of these grips.

    Args:
        grips: The grips, best first.
        tried: Number of candidates that were closed to find them.
        reason: Why no grip was found; empty otherwise.
        miss: The best executable grip if none balances any of the load.
    """
    return GripExploration(
        plane=np.array([g.plane.index for g in grips], dtype=np.int64),
        flip=np.array([g.flip for g in grips], dtype=bool),
        value=np.array([g.approach_value for g in grips]),
        fingers=np.array([g.fingers for g in grips], dtype=np.int64),
        wrench=np.array([g.net_wrench for g in grips]).reshape(-1, 6),
        match=np.array([g.judged for g in grips]),
        tried=tried,
        reason=reason,
        grips=tuple(grips),
        miss=miss,
    )


def of_both_kinds(grips: Sequence[Grip], count: int) -> list[Grip]:
    """The ``count`` best of these grips, best first; of both kinds, if there are wraps and fingertip grips.

    Args:
        grips: The grips, best first.
        count: Largest number of grips.
    """
    best = list(grips[:count])
    others = [grip for grip in grips[count:] if grip.whole_hand != best[0].whole_hand]
    if others and all(grip.whole_hand == best[0].whole_hand for grip in best):
        half = len(best) // 2 + 1
        best[half:] = others[: len(best) - half]
    return best


def described(
    finished: FinishedGrip,
    triangles: IntArray,
    q: Array,
    mesh: TriangleMesh,
    layout: HandLayout,
    coefficients: ContactCoefficients,
    sets: FuzzySets,
) -> Grip:
    """A finished grip with the paper's figures, computed from its contacts.

    Args:
        finished: The grip.
        triangles: (n,) index of the triangle that each contact lies on.
        q: (6,) task Q.
        mesh: The object.
        layout: The hand.
        coefficients: The paper's contact model.
        sets: Membership functions.
    """
    p = plane(finished.plane)
    a = p.approach_axis
    wrenches = grasp_wrenches(
        finished.points,
        finished.normals_in,
        p,
        cog=mesh.cog,
        length_unit=layout.length_unit,
        coefficients=coefficients,
    )
    net = net_wrench(wrenches)
    adi = approaching_degrees(q, net, sets)
    stability, manipulability = screw_measures(wrenches)
    along = float(np.abs(a) @ mesh.extents) / 2
    v = float(np.clip((finished.points.mean(axis=0) - mesh.cog) @ a / max(along, 1e-9), -1.0, 1.0))
    return Grip(
        plane=p,
        flip=finished.flip,
        approach_value=v,
        approach_set=sets.name_index(v),
        fingers=min(len(finished.points), MAX_FINGERS),
        contacts=GraspContacts(
            points=finished.points,
            normals_in=finished.normals_in,
            triangles=triangles,
            wrenches=wrenches,
        ),
        net_wrench=net,
        adi=adi,
        tfvadi=float(adi.sum()),
        stability=stability,
        manipulability=manipulability,
        **{name: getattr(finished, name) for name in _HAND_FIELDS},
    )
