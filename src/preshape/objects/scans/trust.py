"""How much an answer on a guessed surface can be trusted: it is as good as what its contacts rest on."""

from __future__ import annotations

import numpy as np

from ...types import IntArray, value
from .scan import Scan

UNSEEN = 0.5
"""What a contact on guessed surface is worth, where one on seen surface is worth 1 [C]."""
HALF = 0.45
"""Share of the surface that one good view shows: more than this adds no trust [C]."""


@value
class Trust:
    """How much of an answer was seen.

    Attributes:
        points: of the cloud.
        seen_share: of the surface, by area.
        contacts_seen: of each contact, whether the surface was seen there; empty without an answer.
        trust: 0 (guessed) to 1 (seen).
        sentence: the same for people.
    """

    points: int
    seen_share: float
    contacts_seen: tuple[bool, ...]
    trust: float
    sentence: str


def worth(scan: Scan, triangles: IntArray) -> float:
    """What contacts are worth by what was seen: 1 for all seen, ``UNSEEN`` for none.

    Args:
        scan: how the surface was seen.
        triangles: (n,) the triangle under each contact.
    """
    return float(UNSEEN + (1.0 - UNSEEN) * scan.seen[triangles].mean())


def trust_of(scan: Scan, triangles: IntArray | None) -> Trust:
    """How much an answer can be trusted.

    Args:
        scan: how the surface was seen.
        triangles: (n,) the triangle under each contact; ``None`` without an answer.
    """
    whole = min(1.0, scan.seen_share / HALF)
    percent = round(100 * scan.seen_share)
    rest = f"the rest is {scan.guess}" if percent < 100 else "all round"
    surface = f"{percent} % of the surface was seen, {rest}"
    if triangles is None:
        return Trust(
            points=scan.points,
            seen_share=scan.seen_share,
            contacts_seen=(),
            trust=0.0,
            sentence=f"there is no answer to trust; {surface}",
        )
    seen = tuple(bool(s) for s in scan.seen[triangles])
    trust = float(np.mean(seen)) * whole
    return Trust(
        points=scan.points,
        seen_share=scan.seen_share,
        contacts_seen=seen,
        trust=trust,
        sentence=f"{sum(seen)} of {len(seen)} contacts are on surface that was seen; {surface}",
    )
