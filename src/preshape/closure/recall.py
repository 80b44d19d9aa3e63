"""Turn stored grips, of the same object or of others of about its size, into candidates for this object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..hands.hand import Hand
from ..hiis.analyser import MAX_FINGERS, Aim
from ..hiis.fuzzy import FuzzySets
from ..kernels.closing.host import Candidates
from ..objects.mesh import TriangleMesh
from ..objects.shape import attribute_distance
from ..types import Array, BoolArray, Experience, value
from .candidates import DrawnCandidates
from .closed import WRAP

FEW_VALUES = 7
"""With at most this many approach values, an aim means just these values; with more, the whole range."""
SIZE_RATIO = 0.25
"""Grips of another object are recalled if the logarithm of the ratio of extents is at most this [C]."""
_OFF = 1e-9
"""Deviation from the laws and limits that rounding causes [rad]."""
MOST_RECALLED, MOST_OF_ONE = 48, 16
"""Largest number of recalled grips in all, and from any one object [C]."""


@value
class Recalled:
    """n stored grips placed on the current object, those of the most similar objects first.

    Attributes:
        drawn: (n,) the grips as candidates.
        aimed: (n,) True if the grip lies within the aim; False if it lies on one of the planes to recall.
        first: Number of leading grips from the most similar object; only those for this task, if it has any.
        best_quality: Best stored quality of these leading grips.
    """

    drawn: DrawnCandidates
    aimed: BoolArray
    first: int
    best_quality: float


def recalled(
    known: Sequence[Experience], mesh: TriangleMesh, q: Array, aim: Aim, *, hand: Hand, sets: FuzzySets
) -> Recalled | None:
    """The stored grips that fit an object, a task and an aim; ``None`` if there are none.

    1. Select grips of this hand from objects of about this size, on the aim's planes or on those of
       ``aim.recall``. Leave out grips that lost the object in the physics test, with the same model of the
       hand.
    2. Sort by similarity of the object, then this task before others, then quality, then latest first.
    3. Take each grip once, at most ``MOST_OF_ONE`` of one object and ``MOST_RECALLED`` in all.

    Args:
        known: Experiences of the hand, in the order in which they were stored.
        mesh: The current object.
        q: (6,) task Q.
        aim: Where to search.
        hand: The hand.
        sets: Membership functions.
    """
    here, distances = mesh.attributes, dict[bytes, float]()
    outcomes = {(e.model, e.grip.tobytes()): e.outcome for e in known if e.grip is not None and e.outcome}
    sizes = np.array([e.attributes.extents for e in known]).reshape(-1, 3)
    with np.errstate(divide="ignore"):
        near = np.abs(np.log(sizes / here.extents)).max(axis=1) < SIZE_RATIO
    few = len(aim.values) <= FEW_VALUES
    approach_sets = {sets.name_index(float(v)) for v in aim.values} if few else set(range(7))
    # 1. and the keys of 2.
    rows = []
    for k in np.flatnonzero(near).tolist():
        e = known[k]
        if e.grip is None or len(e.grip) != 8 + len(hand.joints):
            continue
        if outcomes.get((e.model, e.grip.tobytes())) == "lost":
            continue
        aimed = e.plane in aim.planes and e.flip in aim.flips and e.approach_set in approach_sets
        # The paper's estimator knows four virtual fingers: a hand's fifth counts as the fourth.
        aimed = aimed and min(e.fingers, MAX_FINGERS) in aim.fingers
        if not aimed and e.plane not in aim.recall:
            continue
        key = sizes[k].tobytes() + np.array([e.attributes.area, e.attributes.volume]).tobytes()
        if key not in distances:
            distances[key] = attribute_distance(here, e.attributes)
        rows.append((distances[key], e.task.tobytes() != q.tobytes(), -e.judged, -k, e, aimed))
    if not rows:
        return None
    rows.sort(key=lambda row: row[:4])
    # 3.
    chosen, of_one = dict[bytes, tuple[Experience, bool]](), dict[float, int]()
    first = 0
    for distance, other_task, _, _, e, aimed in rows:
        assert e.grip is not None
        grip = e.grip.tobytes()
        if grip in chosen or of_one.get(distance, 0) == MOST_OF_ONE or len(chosen) == MOST_RECALLED:
            continue
        chosen[grip] = e, aimed
        of_one[distance] = of_one.get(distance, 0) + 1
        first += (distance, other_task) == rows[0][:2]
    return Recalled(
        drawn=on_object([e for e, _ in chosen.values()], mesh, hand),
        aimed=np.array([aimed for _, aimed in chosen.values()]),
        first=first,
        best_quality=-rows[0][2],
    )


def on_object(experiences: Sequence[Experience], mesh: TriangleMesh, hand: Hand) -> DrawnCandidates:
    """Turn the grips of stored lessons into candidates for the current object.

    A grip that another model of the hand learnt may start where this one's laws or limits do not let it; it
    then starts at the nearest commands.
    """
    grips = np.array([e.grip for e in experiences])
    start = grips[:, 8:]
    lawful = hand.lawful(start)
    return DrawnCandidates(
        candidates=Candidates(
            place=grips[:, :3] + mesh.cog,
            turn=grips[:, 3:7],
            start=np.where(np.abs(lawful - start) > _OFF, lawful, start),
            mask=grips[:, 7].astype(np.int64) & (WRAP | ((1 << len(hand.fingers)) - 1)),
        ),
        plane=np.array([e.plane for e in experiences]),
        flip=np.array([e.flip for e in experiences]),
        value=np.array([e.approach_value for e in experiences]),
        preshape=np.full(len(experiences), -1),
    )
