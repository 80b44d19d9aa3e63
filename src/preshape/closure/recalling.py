"""Grips that are remembered, put on the object at hand: of itself, or of others about as large."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..hiis.analyser import Aim
from ..hiis.critic import attribute_distance
from ..hiis.fuzzy import FuzzySets
from ..kernels.closing.host import Candidates
from ..objects.mesh import TriangleMesh
from ..types import Array, BoolArray, Experience, value
from .sampling import Sampled

MAX_FINGERS = 4
"""Virtual fingers of the paper's estimator; a hand's fifth counts as the fourth."""
FEW = 7
"""An aim with no more approach values than this means these values; with more, all between them."""
RECALLED = 0.25
"""Grips of objects whose extents are within this ratio (logarithm) are tried again [C]."""
MOST_RECALLED, OF_ONE = 48, 16
"""So many of them at most, of the objects most alike, and so many of one object [C]."""


@value
class Recalled:
    """Remembered grips on the object at hand, those of the objects most alike first.

    Attributes:
        sampled: (n,) candidates.
        aimed: (n,) which of them lie where the aim is; the rest are on other planes.
        first: how many of them come of the object most alike, for this task where it was asked of that one.
        bar: how good the best of these was there.
    """

    sampled: Sampled
    aimed: BoolArray
    first: int
    bar: float


def recalled(
    known: Sequence[Experience], mesh: TriangleMesh, q: Array, aim: Aim, *, joints: int, sets: FuzzySets
) -> Recalled | None:
    """What experience says of an object and a task, ``None`` where it says nothing.

    Args:
        known: experiences of the hand, in the order in which they were met.
        mesh: the object at hand.
        q: (6,) task Q.
        aim: where to look: grips of its planes, values and fingers, and any of the planes ``aim.recall``.
        joints: of the hand.
        sets: membership functions.
    """
    here, away = mesh.attributes, dict[bytes, float]()
    said = {e.grip.tobytes(): e.outcome for e in known if e.grip is not None and e.outcome}
    sizes = np.array([e.attributes.extents for e in known]).reshape(-1, 3)
    with np.errstate(divide="ignore"):
        near = np.abs(np.log(sizes / here.extents)).max(axis=1) < RECALLED
    named = {sets.name_index(float(v)) for v in aim.values} if len(aim.values) <= FEW else set(range(7))
    ranked = []
    for k in np.flatnonzero(near).tolist():
        e = known[k]
        if e.grip is None or len(e.grip) != 8 + joints or said.get(e.grip.tobytes()) == "lost":
            continue
        aimed = e.plane in aim.planes and e.flip in aim.flips and e.approach_set in named
        aimed = aimed and min(e.fingers, MAX_FINGERS) in aim.fingers
        if not aimed and e.plane not in aim.recall:
            continue
        which = sizes[k].tobytes() + np.array([e.attributes.area, e.attributes.volume]).tobytes()
        if which not in away:
            away[which] = attribute_distance(here, e.attributes)
        worth = e.match if e.quality is None else e.quality
        ranked.append((away[which], e.task.tobytes() != q.tobytes(), -worth, -k, e, aimed))
    if not ranked:
        return None
    ranked.sort(key=lambda row: row[:4])
    chosen, of_one = dict[bytes, tuple[Experience, bool]](), dict[float, int]()
    first = 0
    for apart, other, _, _, e, aimed in ranked:
        assert e.grip is not None
        key = e.grip.tobytes()
        if key in chosen or of_one.get(apart, 0) == OF_ONE or len(chosen) == MOST_RECALLED:
            continue
        chosen[key] = e, aimed
        of_one[apart] = of_one.get(apart, 0) + 1
        first += (apart, other) == ranked[0][:2]
    return Recalled(
        sampled=_put([e for e, _ in chosen.values()], mesh),
        aimed=np.array([aimed for _, aimed in chosen.values()]),
        first=first,
        bar=-ranked[0][2],
    )


def _put(rows: Sequence[Experience], mesh: TriangleMesh) -> Sampled:
    grips = np.array([e.grip for e in rows])
    return Sampled(
        candidates=Candidates(
            place=grips[:, :3] + mesh.cog,
            turn=grips[:, 3:7],
            start=grips[:, 8:],
            mask=grips[:, 7].astype(np.int64),
        ),
        plane=np.array([e.plane for e in rows]),
        flip=np.array([e.flip for e in rows]),
        value=np.array([e.approach_value for e in rows]),
        preshape=np.full(len(rows), -1),
    )
