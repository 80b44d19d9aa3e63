"""How far a grasp on a partly guessed surface can be trusted, judged by the surface under its contacts."""

from __future__ import annotations

import numpy as np

from ...types import IntArray, value
from .scan import Scan

UNSEEN = 0.5
"""Weight of a contact on guessed surface; a contact on seen surface has weight 1 [C]."""
HALF = 0.45
"""Share of the surface that one good view shows; a larger share adds no trust [C]."""


@value
class Trust:
    """How far an answer can be trusted.

    Attributes:
        points: Number of points of the cloud.
        seen_share: Share of the surface that was seen, by area.
        contacts_seen: Whether each contact is on seen surface; empty if there is no grasp.
        trust: From 0 (all contacts on guessed surface) to 1 (all on seen surface, most of it seen).
        sentence: The same in one sentence.
    """

    points: int
    seen_share: float
    contacts_seen: tuple[bool, ...]
    trust: float
    sentence: str


def seen_weight(scan: Scan, triangles: IntArray) -> float:
    """Weight of a set of contacts, from ``UNSEEN`` (none on seen surface) to 1 (all on seen surface).

    Args:
        scan: How the object was seen.
        triangles: (n,) triangle under each contact.
    """
    return float(UNSEEN + (1.0 - UNSEEN) * scan.seen[triangles].mean())


def trust_of(scan: Scan, triangles: IntArray | None) -> Trust:
    """How far an answer can be trusted.

    Args:
        scan: How the object was seen.
        triangles: (n,) triangle under each contact; ``None`` if there is no grasp.
    """
    whole = min(1.0, scan.seen_share / HALF)
    percent = round(100 * scan.seen_share)
    rest = f"the rest is {scan.guess}" if percent < 100 else "on all sides"
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
        sentence=f"{sum(seen)} of {len(seen)} contacts are on seen surface; {surface}",
    )
